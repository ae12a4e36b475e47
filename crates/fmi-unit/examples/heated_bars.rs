//! Bars that are heated at one end: a unit with arrays whose sizes come from its resources.
//!
//! Each bar has cells with C dTᵢ/dt = k (Tᵢ₋₁ − 2Tᵢ + Tᵢ₊₁), heat enters its first cell, the ends are
//! insulated. Explicit Euler, one evaluation per step. The surface of the first cell is hotter than
//! the cell by R·heat and radiates `loss` = σ (T₀ + R·heat)⁴ (reported, not fed back).
//!
//! The parameter `fault` makes the unit misbehave on purpose, for the tests of the layer.

use fmi_unit::{
    Capabilities, DefaultExperiment, Description, Enumeration, Environment, Experiment, Log, Reference, StepOutcome,
    Terminal, Type, Unit, UnitDefinition, UnitError, Values, ValuesMut, Variable,
};

const HEAT: Reference = 1;
const ENABLED: Reference = 2;
const TEMPERATURE: Reference = 3;
const LOSS: Reference = 4;
const HOTTEST: Reference = 5;
const PHASE: Reference = 6;
const STEPS: Reference = 7;
const AMBIENT: Reference = 8;
const MAX_STEP: Reference = 9;
const LABEL: Reference = 10;
const BLOB: Reference = 11;
const FAULT: Reference = 12;

const CAPACITY: f64 = 10.0;
const CONDUCTANCE: f64 = 0.5;
const RESISTANCE: f64 = 0.1;
const SIGMA: f64 = 5.67e-8;
const MELTING: f64 = 310.0;

/// More are taken for a corrupt file.
const MOST_CELLS: usize = 10_000_000;

const PANIC: i64 = 1;
const ERROR: i64 = 2;
const WARNING: i64 = 3;

/// All of it is state, so it is its own saved state.
#[derive(Clone, Debug)]
pub struct HeatedBars {
    bars: usize,
    cells: usize,
    heat: Vec<f64>,
    temperature: Vec<f64>,
    enabled: bool,
    steps: u64,
    ambient: f64,
    max_step: f64,
    fault: i64,
    label: String,
    blob: Vec<u8>,
    log: Log,
}

impl HeatedBars {
    /// Temperature of the first cell of each bar.
    fn heads(&self) -> impl Iterator<Item = f64> {
        self.temperature.iter().copied().step_by(self.cells)
    }

    fn loss_slope(&self) -> Vec<f64> {
        let slope = |(t, q): (f64, &f64)| 4.0 * SIGMA * RESISTANCE * (t + RESISTANCE * q).powi(3);
        self.heads().zip(&self.heat).map(slope).collect()
    }
}

impl Unit for HeatedBars {
    type State = HeatedBars;

    fn instantiate(environment: &Environment) -> Result<Self, UnitError> {
        let path = environment.resource("size.txt")?;
        let text = std::fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        let sizes = text.split_whitespace().map(str::parse).collect::<Result<Vec<usize>, _>>()?;
        let (bars, cells) = match sizes[..] {
            [bars, cells] if (1..=MOST_CELLS).contains(&bars.saturating_mul(cells)) => (bars, cells),
            _ => {
                return Err(format!("{}: expected two sizes, found `{text}`", path.display()).into());
            }
        };
        Ok(HeatedBars {
            bars,
            cells,
            heat: vec![0.0; bars],
            temperature: vec![300.0; bars * cells],
            enabled: true,
            steps: 0,
            ambient: 300.0,
            max_step: 10.0,
            fault: 0,
            label: "bars".to_owned(),
            blob: vec![1, 2, 3],
            log: environment.log.clone(),
        })
    }

    fn description(&self) -> Description {
        let (bars, cells) = (self.bars, self.cells);
        Description::new("Heated bars", "heated_bars")
            .about("Bars that are heated at one end.")
            .documentation("<p>An example.</p>")
            .version(env!("CARGO_PKG_VERSION"))
            .capabilities(Capabilities {
                state: true,
                serialize: true,
                directional_derivative: true,
                adjoint_derivative: true,
                ..Capabilities::default()
            })
            .default_experiment(DefaultExperiment { start: 0.0, stop: 10.0, step: 0.5 })
            .log_category("solver", "What the solver does")
            .units([
                UnitDefinition::new("s").second(1),
                UnitDefinition::new("K").kelvin(1),
                UnitDefinition::new("W").kilogram(1).metre(2).second(-3),
            ])
            .time_unit("s")
            .enumerations([
                Enumeration::new("Phase").item("solid", 1).item("liquid", 2),
                Enumeration::new("Fault")
                    .item("none", 0)
                    .item("panic", PANIC)
                    .item("error", ERROR)
                    .item("warning", WARNING),
            ])
            .variables([
                Variable::input(HEAT, "bars.heat", Type::Float64)
                    .dimensions(&[bars])
                    .unit("W")
                    .start(0.0)
                    .describe("Heat into the first cell of each bar"),
                Variable::input(ENABLED, "enabled", Type::Boolean).start(true).describe("Whether heat flows"),
                Variable::output(TEMPERATURE, "bars.temperature", Type::Float64)
                    .dimensions(&[bars, cells])
                    .unit("K")
                    .describe("Temperature of each cell")
                    .depends_on(&[]),
                Variable::output(LOSS, "bars.loss", Type::Float64)
                    .dimensions(&[bars])
                    .unit("W")
                    .describe("Radiated heat")
                    .depends_on(&[HEAT]),
                Variable::output(HOTTEST, "hottest", Type::Float64).unit("K").describe("Highest temperature"),
                Variable::output(PHASE, "bars.phase", Type::Int64)
                    .enumeration("Phase")
                    .dimensions(&[bars])
                    .describe("Phase of the first cell"),
                Variable::output(STEPS, "steps", Type::UInt64).describe("Number of steps made"),
                Variable::parameter(AMBIENT, "ambient", Type::Float64)
                    .unit("K")
                    .start(300.0)
                    .describe("Initial temperature"),
                Variable::parameter(MAX_STEP, "max_step", Type::Float64)
                    .unit("s")
                    .start(10.0)
                    .tunable()
                    .describe("Longer steps are discarded"),
                Variable::parameter(LABEL, "label", Type::String).start("bars").describe("Any text"),
                Variable::parameter(BLOB, "blob", Type::Binary).start(vec![1u8, 2, 3]).describe("Any bytes"),
                Variable::parameter(FAULT, "fault", Type::Int64)
                    .enumeration("Fault")
                    .start(0)
                    .tunable()
                    .describe("What goes wrong in the next step"),
            ])
            .terminals([Terminal::new("bars", "What the bars exchange")
                .member("heat", "bars.heat")
                .member("temperature", "bars.temperature")])
    }

    fn get(&mut self, variable: Reference, values: ValuesMut<'_>) -> Result<(), UnitError> {
        match variable {
            HEAT => values.write(&self.heat),
            ENABLED => values.write(&[self.enabled]),
            TEMPERATURE => values.write(&self.temperature),
            LOSS => {
                let loss = |(t, q): (f64, &f64)| SIGMA * (t + RESISTANCE * q).powi(4);
                values.write(&self.heads().zip(&self.heat).map(loss).collect::<Vec<_>>())
            }
            HOTTEST => values.write(&[self.temperature.iter().copied().fold(f64::MIN, f64::max)]),
            PHASE => values.write(&self.heads().map(|t| if t < MELTING { 1 } else { 2i64 }).collect::<Vec<_>>()),
            STEPS => values.write(&[self.steps]),
            AMBIENT => values.write(&[self.ambient]),
            MAX_STEP => values.write(&[self.max_step]),
            LABEL => values.write(std::slice::from_ref(&self.label)),
            BLOB => values.write(std::slice::from_ref(&self.blob)),
            _ => values.write(&[self.fault]),
        }
    }

    fn set(&mut self, variable: Reference, values: Values<'_>) -> Result<(), UnitError> {
        match variable {
            HEAT => values.read(&mut self.heat)?,
            ENABLED => self.enabled = values.scalar()?,
            AMBIENT => self.ambient = values.scalar()?,
            MAX_STEP => self.max_step = values.scalar()?,
            LABEL => self.label = values.scalar()?,
            BLOB => self.blob = values.scalar()?,
            _ => self.fault = values.scalar()?,
        }
        Ok(())
    }

    fn initialize(&mut self, _experiment: &Experiment) -> Result<(), UnitError> {
        self.temperature.fill(self.ambient);
        self.steps = 0;
        self.log.info("solver", "initial temperatures are set");
        Ok(())
    }

    fn step(&mut self, _time: f64, step: f64) -> Result<StepOutcome, UnitError> {
        match self.fault {
            PANIC => panic!("the bars have a fault"),
            ERROR => return Err("the bars have a fault".into()),
            WARNING => self.log.warn("the bars are about to have a fault #1"),
            _ => {}
        }
        if step > self.max_step {
            return Ok(StepOutcome::Discarded(format!("{step} s is longer than {} s", self.max_step)));
        }
        for (bar, heat) in self.temperature.chunks_mut(self.cells).zip(&self.heat) {
            let old = bar.to_vec();
            for i in 0..old.len() {
                let (left, right) = (old[i.saturating_sub(1)], old[(i + 1).min(old.len() - 1)]);
                let source = if i == 0 && self.enabled { *heat } else { 0.0 };
                bar[i] += step / CAPACITY * (CONDUCTANCE * (left - 2.0 * old[i] + right) + source);
            }
        }
        self.steps += 1;
        self.log.info("solver", format!("step {} of {step} s", self.steps));
        Ok(StepOutcome::Completed)
    }

    fn save(&mut self) -> Result<HeatedBars, UnitError> {
        Ok(self.clone())
    }

    fn restore(&mut self, state: &HeatedBars) -> Result<(), UnitError> {
        self.clone_from(state);
        Ok(())
    }

    fn serialize(&self, state: &HeatedBars) -> Result<Vec<u8>, UnitError> {
        let mut bytes = Vec::new();
        let floats = state.heat.iter().chain(&state.temperature).chain([&state.ambient, &state.max_step]);
        floats.for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
        bytes.extend_from_slice(&state.steps.to_le_bytes());
        bytes.extend_from_slice(&state.fault.to_le_bytes());
        bytes.push(state.enabled.into());
        bytes.extend_from_slice(&(state.label.len() as u64).to_le_bytes());
        bytes.extend_from_slice(state.label.as_bytes());
        bytes.extend_from_slice(&state.blob);
        Ok(bytes)
    }

    fn deserialize(&self, bytes: &[u8]) -> Result<HeatedBars, UnitError> {
        let mut state = self.clone();
        let mut rest = bytes;
        let mut word = || -> Result<[u8; 8], UnitError> {
            let (word, tail) = rest.split_first_chunk::<8>().ok_or("the state is too short")?;
            rest = tail;
            Ok(*word)
        };
        let floats = state.heat.iter_mut().chain(&mut state.temperature);
        for x in floats.chain([&mut state.ambient, &mut state.max_step]) {
            *x = f64::from_le_bytes(word()?);
        }
        state.steps = u64::from_le_bytes(word()?);
        state.fault = i64::from_le_bytes(word()?);
        let (enabled, tail) = rest.split_first().ok_or("the state is too short")?;
        state.enabled = *enabled != 0;
        let (length, tail) = tail.split_first_chunk::<8>().ok_or("the state is too short")?;
        let length = usize::try_from(u64::from_le_bytes(*length))?;
        let (label, blob) = tail.split_at_checked(length).ok_or("the state is too short")?;
        state.label = String::from_utf8(label.to_vec())?;
        state.blob = blob.to_vec();
        Ok(state)
    }

    fn directional_derivative(
        &mut self,
        unknowns: &[Reference],
        knowns: &[Reference],
        seed: &[f64],
        sensitivity: &mut [f64],
    ) -> Result<(), UnitError> {
        if (unknowns, knowns) != (&[LOSS], &[HEAT]) {
            return Err("only the derivative of bars.loss with respect to bars.heat is known".into());
        }
        let slope = self.loss_slope();
        sensitivity.iter_mut().zip(slope).zip(seed).for_each(|((out, slope), seed)| *out = slope * seed);
        Ok(())
    }

    /// The Jacobian is diagonal, hence its own transpose.
    fn adjoint_derivative(
        &mut self,
        unknowns: &[Reference],
        knowns: &[Reference],
        seed: &[f64],
        sensitivity: &mut [f64],
    ) -> Result<(), UnitError> {
        self.directional_derivative(unknowns, knowns, seed, sensitivity)
    }
}

fmi_unit::export_unit!(HeatedBars);
