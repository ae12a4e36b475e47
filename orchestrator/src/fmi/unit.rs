//! An FMU as a [`Unit`].

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use coupling::{Role, Sizes, WORK, Work, WorkVariable};
use model::Parameter;
use tempfile::TempDir;

use super::FmuError;
use super::description::{Description, Variable, VariableType, Version};
use super::library::{Instance, Status};
use super::role::Fit;
use crate::unit::{Calls, StepOutcome, Unit, UnitError};

/// The name under which a unit publishes the Newton iterations of its last time step.
const NEWTON: &str = "newton.iterations";
/// Time steps that differ by less than this part are of one size.
const SAME: f64 = 1e-9;

/// An unpacked FMU; its files go with the last of its clones and instances.
#[derive(Clone, Debug)]
pub struct Fmu {
    path: PathBuf,
    folder: Arc<TempDir>,
    description: Arc<Description>,
}

impl Fmu {
    /// Unpacks an FMU into a temporary folder and reads its description.
    ///
    /// # Errors
    /// [`FmuError`]: no such file, no archive, or a description that cannot be used.
    pub fn open(path: &Path) -> Result<Self, FmuError> {
        let fail = |reason: String| FmuError { path: path.to_owned(), reason };
        let file = File::open(path).map_err(|e| fail(e.to_string()))?;
        let mut archive = zip::ZipArchive::new(file).map_err(|e| fail(format!("it is no FMU: {e}")))?;
        let folder = tempfile::Builder::new().prefix("fmu-").tempdir().map_err(|e| fail(e.to_string()))?;
        archive.extract(folder.path()).map_err(|e| fail(format!("it cannot be unpacked: {e}")))?;
        let xml = std::fs::read_to_string(folder.path().join("modelDescription.xml"))
            .map_err(|e| fail(format!("modelDescription.xml: {e}")))?;
        let description = Description::parse(&xml).map_err(|e| fail(format!("modelDescription.xml: {e}")))?;
        Ok(Self { path: path.to_owned(), folder: Arc::new(folder), description: Arc::new(description) })
    }

    /// What it says of itself.
    pub fn description(&self) -> &Description {
        &self.description
    }

    /// Compares it with what a role asks for. From then on its variables are in the role's units of measure.
    pub fn fit(&mut self, role: Role, sizes: Sizes) -> Fit {
        Arc::make_mut(&mut self.description).fit(role, sizes)
    }

    /// Makes an instance. Start values may be set before [`FmuUnit::initialise`].
    ///
    /// # Errors
    /// [`FmuError`]: no library for this platform, or the unit refuses, as for corrupt resources.
    pub fn instantiate(&self, name: &str) -> Result<FmuUnit, FmuError> {
        let instance = Some(self.instance(name)?);
        let fmu = self.clone();
        Ok(FmuUnit {
            name: name.to_owned(),
            instance,
            fmu,
            starts: Vec::new(),
            span: None,
            step: None,
            said: Vec::new(),
        })
    }

    fn instance(&self, name: &str) -> Result<Instance, FmuError> {
        use std::env::consts::{ARCH, DLL_SUFFIX, OS};
        let fail = |reason: String| FmuError { path: self.path.clone(), reason };
        let Description { version, identifier, token, .. } = &*self.description;
        let platform = match (version, OS, ARCH) {
            (Version::Three, "macos", _) => format!("{ARCH}-darwin"),
            (Version::Three, ..) => format!("{ARCH}-{OS}"),
            (Version::Two, "macos", _) => "darwin64".into(),
            (Version::Two, "windows", _) => "win64".into(),
            (Version::Two, ..) => format!("{OS}64"),
        };
        let library = self.folder.path().join("binaries").join(&platform).join(format!("{identifier}{DLL_SUFFIX}"));
        if !library.is_file() {
            return Err(fail(format!("it has no library for {platform}")));
        }
        Instance::new(*version, &library, name, token, &self.folder.path().join("resources")).map_err(fail)
    }
}

/// An instance of an FMU.
pub struct FmuUnit {
    name: String,
    /// There is none while it is made anew.
    instance: Option<Instance>,
    fmu: Fmu,
    /// What was set before initialisation.
    starts: Vec<(String, Parameter)>,
    /// Start and stop (s), once it is initialised.
    span: Option<[f64; 2]>,
    /// The only time step (s) that it takes.
    step: Option<f64>,
    /// Messages of calls that succeeded.
    said: Vec<String>,
}

impl FmuUnit {
    /// Sets a parameter or the start value of an input, before [`initialise`](Self::initialise).
    ///
    /// # Errors
    /// [`UnitError`].
    pub fn set_start(&mut self, variable: &str, value: &Parameter) -> Result<(), UnitError> {
        match value {
            Parameter::Number(value) => self.set(variable, &[*value])?,
            Parameter::Numbers(values) => self.set(variable, values)?,
            Parameter::Flag(value) => self.set(variable, &[f64::from(u8::from(*value))])?,
            Parameter::Text(text) => {
                let description = Arc::clone(&self.fmu.description);
                let found = known(&description, variable)?;
                if found.ty != VariableType::String {
                    return Err(UnitError::Refused { message: format!("\"{variable}\" is no text") });
                }
                let status = self.instance()?.set_text(found.references[0], text);
                let status = status.map_err(|message| UnitError::Refused { message })?;
                self.done(status)?;
            }
        }
        self.starts.push((variable.to_owned(), value.clone()));
        Ok(())
    }

    /// Ends the setting of start values: computes the initial state at `start` (s). Time will not go past `stop` (s).
    ///
    /// # Errors
    /// [`UnitError::Refused`].
    pub fn initialise(&mut self, start: f64, stop: f64) -> Result<(), UnitError> {
        let status = self.instance()?.initialise(start, stop);
        self.done(status)?;
        let work = self.work();
        self.instance()?.calls.start_computing = work.map_or(0.0, |work| work.total);
        self.span = Some([start, stop]);
        Ok(())
    }

    /// Makes the instance anew, with the start values that it had, and initialises it.
    pub(crate) fn renew(&mut self) -> Result<(), UnitError> {
        let calls = self.calls();
        // The old one goes first: some FMUs cannot be there twice.
        self.instance = None;
        let instance = self.fmu.instance(&self.name);
        let mut instance = instance.map_err(|error| UnitError::Refused { message: error.to_string() })?;
        instance.calls = calls.and(&instance.calls);
        self.instance = Some(instance);
        for (variable, value) in std::mem::take(&mut self.starts) {
            self.set_start(&variable, &value)?;
        }
        match self.span {
            Some([start, stop]) => self.initialise(start, stop),
            None => Ok(()),
        }
    }

    /// The FMU it is an instance of.
    pub fn fmu(&self) -> &Fmu {
        &self.fmu
    }

    /// The text in a variable.
    ///
    /// # Errors
    /// [`UnitError`].
    pub fn text(&mut self, variable: &str) -> Result<String, UnitError> {
        let reference = known(&self.fmu.description, variable)?.references[0];
        self.instance()?.get_text(reference).map_err(|_| self.refused())
    }

    fn instance(&mut self) -> Result<&mut Instance, UnitError> {
        self.instance.as_mut().ok_or_else(|| UnitError::Refused { message: "it could not be made anew".into() })
    }

    fn refused(&self) -> UnitError {
        let message = self.instance.as_ref().map_or_else(String::new, Instance::take_messages);
        UnitError::Refused { message: if message.is_empty() { "it gives no reason".into() } else { message } }
    }

    fn done(&self, status: Status) -> Result<(), UnitError> {
        if status == Status::Ok { Ok(()) } else { Err(self.refused()) }
    }
}

fn known<'a>(description: &'a Description, name: &str) -> Result<&'a Variable, UnitError> {
    description.variables.get(name).ok_or_else(|| UnitError::UnknownVariable { variable: name.to_owned() })
}

impl std::fmt::Debug for FmuUnit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FmuUnit").field("name", &self.name).field("fmu", &self.fmu.path).finish()
    }
}

impl Unit for FmuUnit {
    fn name(&self) -> &str {
        &self.name
    }

    fn has(&self, variable: &str) -> bool {
        self.fmu.description.variables.contains_key(variable)
    }

    fn set(&mut self, variable: &str, values: &[f64]) -> Result<(), UnitError> {
        let description = Arc::clone(&self.fmu.description);
        let found = known(&description, variable)?;
        if !found.is_number() {
            return Err(UnitError::Unsupported { what: "setting numbers in a variable that has none" });
        }
        if values.len() != found.size {
            return Err(UnitError::Length { variable: variable.to_owned(), found: values.len(), expected: found.size });
        }
        let mut values = std::borrow::Cow::Borrowed(values);
        if let Some(inverse) = found.conversion.inverse() {
            inverse.apply(values.to_mut());
        }
        let status = self.instance()?.set(found.ty, &found.references, &values);
        self.done(status)
    }

    fn get(&mut self, variable: &str, values: &mut Vec<f64>) -> Result<(), UnitError> {
        let description = Arc::clone(&self.fmu.description);
        let found = known(&description, variable)?;
        if !found.is_number() {
            return Err(UnitError::Unsupported { what: "numbers from a variable that has none" });
        }
        values.clear();
        values.resize(found.size, 0.0);
        let status = self.instance()?.get(found.ty, &found.references, values);
        found.conversion.apply(values);
        self.done(status)
    }

    fn step(&mut self, time: f64, step: f64) -> Result<StepOutcome, UnitError> {
        let only = *self.step.get_or_insert(step);
        if !self.fmu.description.takes_any_step && (step - only).abs() > SAME * only {
            let message = format!(
                "it takes time steps of one size only (canHandleVariableCommunicationStepSize), {only} s, and cannot do \
                 one of {step} s: fixed steps are needed, and a coupling that converges in them"
            );
            return Err(UnitError::Refused { message });
        }
        let instance = self.instance()?;
        match instance.step(time, step) {
            (Status::Ok, false) => {
                let said = instance.take_list();
                self.said.extend(said);
                Ok(StepOutcome::Done)
            }
            (Status::Ok, true) => Err(UnitError::Refused { message: "it wants the simulation to end".into() }),
            (Status::Discard, _) => Ok(StepOutcome::Discarded { reason: instance.take_messages() }),
            (Status::Error, _) => Err(self.refused()),
        }
    }

    fn can_roll_back(&self) -> bool {
        self.fmu.description.has_state
    }

    fn save(&mut self) -> Result<(), UnitError> {
        let status = self.instance()?.save();
        self.done(status)
    }

    fn restore(&mut self) -> Result<(), UnitError> {
        match self.instance()?.restore() {
            Some(status) => self.done(status),
            None => Err(UnitError::Unsupported { what: "going back where no state was kept" }),
        }
    }

    fn can_serialise(&self) -> bool {
        self.fmu.description.serialises_state
    }

    fn serialise(&mut self) -> Result<Vec<u8>, UnitError> {
        if !self.can_serialise() {
            return Err(UnitError::Unsupported { what: "states as bytes" });
        }
        self.instance()?.serialise().map_err(|_| self.refused())
    }

    fn deserialise(&mut self, bytes: &[u8]) -> Result<(), UnitError> {
        if !self.can_serialise() {
            return Err(UnitError::Unsupported { what: "states as bytes" });
        }
        self.instance()?.deserialise(bytes).map_err(|_| self.refused())
    }

    fn newton_iterations(&mut self) -> Option<u64> {
        let mut values = Vec::new();
        self.get(NEWTON, &mut values).ok()?;
        values.first().map(|&n| n as u64)
    }

    fn calls(&self) -> Calls {
        self.instance.as_ref().map_or_else(Calls::default, |instance| instance.calls)
    }

    fn work(&mut self) -> Option<Work> {
        let mut work = Work::default();
        for WorkVariable { name, place, .. } in WORK.into_iter().filter(|row| self.has(row.name)).collect::<Vec<_>>() {
            let mut values = Vec::new();
            self.get(name, &mut values).ok()?;
            *place(&mut work) = *values.first()?;
        }
        // Without its total nothing is known of what is the interface's.
        self.has(WORK[0].name).then_some(work)
    }

    fn take_messages(&mut self) -> Vec<String> {
        std::mem::take(&mut self.said)
    }

    fn derivative(&mut self, outputs: &[&str], inputs: &[(&str, &[f64])]) -> Result<Option<Vec<Vec<f64>>>, UnitError> {
        let description = Arc::clone(&self.fmu.description);
        if !description.has_derivatives {
            return Ok(None);
        }
        let (mut knowns, mut seed) = (Vec::new(), Vec::new());
        for &(input, values) in inputs {
            let variable = known(&description, input)?;
            if values.len() != variable.size {
                let (found, expected) = (values.len(), variable.size);
                return Err(UnitError::Length { variable: input.to_owned(), found, expected });
            }
            knowns.extend_from_slice(&variable.references);
            seed.extend(values.iter().map(|v| v / variable.conversion.factor));
        }
        let variables = outputs.iter().map(|output| known(&description, output)).collect::<Result<Vec<_>, _>>()?;
        let unknowns: Vec<u32> = variables.iter().flat_map(|v| v.references.iter().copied()).collect();
        let mut sensitivity = vec![0.0; variables.iter().map(|v| v.size).sum()];
        let status = self.instance()?.derivative(&unknowns, &knowns, &seed, &mut sensitivity);
        self.done(status)?;
        let mut rest = sensitivity.into_iter();
        let of = |v: &&Variable| rest.by_ref().take(v.size).map(|s| s * v.conversion.factor).collect();
        Ok(Some(variables.iter().map(of).collect()))
    }
}
