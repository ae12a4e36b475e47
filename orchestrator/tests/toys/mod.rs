//! Analytic units: columns of poroelastic rock, each a scalar problem of its own.
//!
//! Flow: (φ − φ_n) + (p − p_n)/M + δt k (p − p⁰) = 0. Mechanics: K ε + L ε³ = σ(t) + b (p − p⁰), φ = b ε.
//! Partners are affine functions around the last exchange (project's `coupling.md`, section 1).

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use orchestrator::{StepOutcome, Unit, UnitError};
use serde::{Deserialize, Serialize};

/// Data of a column.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Column {
    pub(crate) biot_coefficient: f64,
    pub(crate) biot_modulus: f64,
    /// K_dr.
    pub(crate) stiffness: f64,
    /// L: 0 for a linear column.
    pub(crate) hardening: f64,
    /// k (1/(Pa s)).
    pub(crate) leakage: f64,
    /// p⁰ (Pa), that of the start.
    pub(crate) background: f64,
}

impl Column {
    /// With the coupling strength τ = b²M/K_dr.
    pub(crate) fn of_strength(tau: f64) -> Self {
        let (b, k) = (0.8, 1e9);
        Self {
            biot_coefficient: b,
            biot_modulus: tau * k / (b * b),
            stiffness: k,
            hardening: 0.0,
            leakage: 0.0,
            background: 0.0,
        }
    }
}

/// σ (Pa) at time t (s): a load that is put on within one second and then varies a little.
pub(crate) fn load(t: f64) -> f64 {
    -1e6 * t.min(1.0) * (1.0 + 0.1 * t.sin())
}

#[derive(Clone, Default, PartialEq, Serialize, Deserialize)]
struct State {
    values: BTreeMap<String, Vec<f64>>,
    /// φ at the last time level (flow).
    porosity: Vec<f64>,
    /// −∂p/∂φ (flow) or ∂φ/∂p (mechanics) at the end of the last time step.
    slope: Vec<f64>,
}

pub(crate) struct Toy {
    is_flow: bool,
    columns: Vec<Column>,
    /// Factor on the published compliance b²/K_dr.
    pub(crate) compliance_factor: f64,
    /// A time step above this (s) that ends after `rejects_after` is discarded.
    pub(crate) rejects_above: f64,
    pub(crate) rejects_after: f64,
    /// A porosity change below this is refused.
    pub(crate) least_porosity: f64,
    pub(crate) rolls_back: bool,
    /// Whether it has directional derivatives.
    pub(crate) differentiates: bool,
    /// From this time on (s) the load stays as it is.
    pub(crate) held_from: f64,
    /// From this time on (s) the porosity is not a number.
    pub(crate) breaks_at: f64,
    state: State,
    kept: Option<State>,
    newton: u64,
    pub(crate) log: Arc<Mutex<Vec<String>>>,
}

impl Toy {
    pub(crate) fn new(is_flow: bool, columns: &[Column]) -> Self {
        let n = columns.len();
        let mut values = BTreeMap::new();
        let cells = [
            "matrix.pressure",
            "matrix.porosity_change",
            "matrix.pressure_stiffness",
            "matrix.porosity_compliance",
            "matrix.pressure_reference",
            "matrix.porosity_change_reference",
        ];
        let faces = [
            "fracture.pressure",
            "fracture.aperture",
            "fracture.pressure_stiffness",
            "fracture.aperture_compliance",
            "fracture.pressure_reference",
            "fracture.aperture_reference",
        ];
        cells.iter().for_each(|v| drop(values.insert((*v).to_owned(), vec![0.0; n])));
        faces.iter().for_each(|v| drop(values.insert((*v).to_owned(), Vec::new())));
        let mut toy = Self {
            is_flow,
            columns: columns.to_vec(),
            compliance_factor: 1.0,
            rejects_above: f64::INFINITY,
            rejects_after: 0.0,
            least_porosity: f64::NEG_INFINITY,
            rolls_back: true,
            differentiates: true,
            held_from: f64::INFINITY,
            breaks_at: f64::INFINITY,
            state: State { values, porosity: vec![0.0; n], slope: vec![0.0; n] },
            kept: None,
            newton: 0,
            log: Default::default(),
        };
        let background: Vec<f64> = columns.iter().map(|c| c.background).collect();
        toy.state.values.insert("matrix.pressure".into(), background);
        if is_flow {
            let stiffness = columns.iter().map(|c| c.biot_modulus).collect();
            toy.state.values.insert("matrix.pressure_stiffness".into(), stiffness);
        }
        toy
    }

    /// Gives it one more variable.
    pub(crate) fn set_new(&mut self, name: &str) {
        self.state.values.insert(name.to_owned(), Vec::new());
    }

    fn value(&self, name: &str, i: usize) -> f64 {
        self.state.values[name][i]
    }

    fn flow(&mut self, step: f64) {
        for i in 0..self.columns.len() {
            let c = self.columns[i];
            let (compliance, reference) =
                (self.value("matrix.porosity_compliance", i), self.value("matrix.pressure_reference", i));
            let (before, given) = (self.value("matrix.pressure", i), self.value("matrix.porosity_change", i));
            // φ* + C (p − p*) − φ_n + (p − p_n)/M + δt k (p − p⁰) = 0
            let right = self.state.porosity[i] - given
                + compliance * reference
                + before / c.biot_modulus
                + step * c.leakage * c.background;
            let diagonal = compliance + 1.0 / c.biot_modulus + step * c.leakage;
            let p = right / diagonal;
            self.state.slope[i] = 1.0 / diagonal;
            self.state.porosity[i] = given + compliance * (p - reference);
            self.state.values.get_mut("matrix.pressure").unwrap()[i] = p;
        }
    }

    fn mechanics(&mut self, end: f64) {
        self.newton = 0;
        for i in 0..self.columns.len() {
            let c = self.columns[i];
            let b = c.biot_coefficient;
            let (given, stiffness) = (self.value("matrix.pressure", i), self.value("matrix.pressure_stiffness", i));
            let reference = self.value("matrix.porosity_change_reference", i);
            let load = load(end.min(self.held_from));
            // K ε + L ε³ = σ + b (p* − S (b ε − φ*) − p⁰)
            let mut strain = self.value("matrix.porosity_change", i) / b;
            for _ in 0..50 {
                let pressure = given - stiffness * (b * strain - reference) - c.background;
                let defect = c.stiffness * strain + c.hardening * strain.powi(3) - load - b * pressure;
                let slope = c.stiffness + 3.0 * c.hardening * strain * strain + b * b * stiffness;
                strain -= defect / slope;
                self.newton += 1;
                if defect.abs() < 1e-9 {
                    break;
                }
            }
            let porosity = if end >= self.breaks_at { f64::NAN } else { b * strain };
            self.state.values.get_mut("matrix.porosity_change").unwrap()[i] = porosity;
            let tangent = c.stiffness + 3.0 * c.hardening * strain * strain;
            self.state.slope[i] = b * b / (tangent + b * b * stiffness);
            self.state.values.get_mut("matrix.porosity_compliance").unwrap()[i] =
                self.compliance_factor * b * b / tangent;
        }
    }
}

impl Unit for Toy {
    fn name(&self) -> &str {
        if self.is_flow { "toy flow" } else { "toy mechanics" }
    }

    fn has(&self, variable: &str) -> bool {
        self.state.values.contains_key(variable)
    }

    fn set(&mut self, variable: &str, values: &[f64]) -> Result<(), UnitError> {
        let Some(own) = self.state.values.get_mut(variable) else {
            return Err(UnitError::UnknownVariable { variable: variable.into() });
        };
        if own.len() != values.len() {
            return Err(UnitError::Length { variable: variable.into(), found: values.len(), expected: own.len() });
        }
        self.log.lock().unwrap().push(format!("{} set {variable}", self.name()));
        self.state.values.insert(variable.to_owned(), values.to_vec());
        Ok(())
    }

    fn get(&mut self, variable: &str, values: &mut Vec<f64>) -> Result<(), UnitError> {
        let own = self.state.values.get(variable);
        *values = own.ok_or(UnitError::UnknownVariable { variable: variable.into() })?.clone();
        if !self.is_flow && variable == "matrix.porosity_compliance" && values.iter().all(|&c| c == 0.0) {
            let factor = self.compliance_factor;
            *values = self.columns.iter().map(|c| factor * c.biot_coefficient.powi(2) / c.stiffness).collect();
        }
        Ok(())
    }

    fn step(&mut self, time: f64, step: f64) -> Result<StepOutcome, UnitError> {
        self.log.lock().unwrap().push(format!("{} step", self.name()));
        if step > self.rejects_above && time + step > self.rejects_after {
            return Ok(StepOutcome::Discarded { reason: format!("{step} s is too long") });
        }
        if self.is_flow {
            if self.state.values["matrix.porosity_change"].iter().any(|&p| p < self.least_porosity) {
                return Ok(StepOutcome::Discarded { reason: "there is no pore left".into() });
            }
            self.flow(step);
        } else {
            self.mechanics(time + step);
        }
        Ok(StepOutcome::Done)
    }

    fn can_roll_back(&self) -> bool {
        self.rolls_back
    }

    fn save(&mut self) -> Result<(), UnitError> {
        self.kept = Some(self.state.clone());
        Ok(())
    }

    fn restore(&mut self) -> Result<(), UnitError> {
        let kept = self.kept.clone().ok_or(UnitError::Unsupported { what: "going back to no state" })?;
        self.log.lock().unwrap().push(format!("{} restore", self.name()));
        self.state = kept;
        Ok(())
    }

    fn serialise(&mut self) -> Result<Vec<u8>, UnitError> {
        postcard::to_stdvec(&self.state).map_err(|e| UnitError::Refused { message: e.to_string() })
    }

    fn deserialise(&mut self, bytes: &[u8]) -> Result<(), UnitError> {
        self.state = postcard::from_bytes(bytes).map_err(|e| UnitError::Refused { message: e.to_string() })?;
        Ok(())
    }

    fn derivative(&mut self, outputs: &[&str], inputs: &[(&str, &[f64])]) -> Result<Option<Vec<Vec<f64>>>, UnitError> {
        if !self.differentiates {
            return Ok(None);
        }
        self.log.lock().unwrap().push(format!("{} derivative", self.name()));
        let mut sum = vec![0.0; self.columns.len()];
        for (input, change) in inputs {
            for (i, change) in change.iter().enumerate() {
                let slope = self.state.slope[i];
                sum[i] += change
                    * match *input {
                        "matrix.porosity_change" => -slope,
                        "matrix.pressure_reference" => slope * self.value("matrix.porosity_compliance", i),
                        "matrix.pressure" => slope,
                        "matrix.porosity_change_reference" => slope * self.value("matrix.pressure_stiffness", i),
                        other => panic!("{other}"),
                    };
            }
        }
        Ok(Some(outputs.iter().map(|o| if o.starts_with("matrix") { sum.clone() } else { Vec::new() }).collect()))
    }

    fn newton_iterations(&mut self) -> Option<u64> {
        (!self.is_flow).then_some(self.newton)
    }
}
