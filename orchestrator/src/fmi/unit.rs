//! An FMU as a [`Unit`].

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use model::Parameter;
use tempfile::TempDir;

use super::FmuError;
use super::description::{Description, Variable, VariableType};
use super::library::{Instance, Status};
use crate::unit::{StepOutcome, Unit, UnitError};

/// The name under which a unit publishes the Newton iterations of its last time step.
const NEWTON: &str = "newton.iterations";

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

    /// Makes an instance. Start values may be set before [`FmuUnit::initialise`].
    ///
    /// # Errors
    /// [`FmuError`]: no library for this platform, or the unit refuses, as for corrupt resources.
    pub fn instantiate(&self, name: &str) -> Result<FmuUnit, FmuError> {
        use std::env::consts::{ARCH, DLL_SUFFIX, OS};
        let fail = |reason: String| FmuError { path: self.path.clone(), reason };
        let system = if OS == "macos" { "darwin" } else { OS };
        let library = self
            .folder
            .path()
            .join(format!("binaries/{ARCH}-{system}"))
            .join(format!("{}{DLL_SUFFIX}", self.description.identifier));
        if !library.is_file() {
            return Err(fail(format!("it has no library for {ARCH}-{system}")));
        }
        let resources = self.folder.path().join("resources");
        let instance = Instance::new(&library, name, &self.description.token, &resources).map_err(fail)?;
        Ok(FmuUnit { name: name.to_owned(), instance, fmu: self.clone() })
    }
}

/// An instance of an FMU.
pub struct FmuUnit {
    name: String,
    instance: Instance,
    fmu: Fmu,
}

impl FmuUnit {
    /// Ends the setting of start values: computes the initial state at `start` (s). Time will not go past `stop` (s).
    ///
    /// # Errors
    /// [`UnitError::Refused`].
    pub fn initialise(&mut self, start: f64, stop: f64) -> Result<(), UnitError> {
        let status = self.instance.initialise(start, stop);
        self.done(status)
    }

    /// Sets a parameter or the start value of an input, before [`initialise`](Self::initialise).
    ///
    /// # Errors
    /// [`UnitError`].
    pub fn set_start(&mut self, variable: &str, value: &Parameter) -> Result<(), UnitError> {
        match value {
            Parameter::Number(value) => self.set(variable, &[*value]),
            Parameter::Numbers(values) => self.set(variable, values),
            Parameter::Flag(_) | Parameter::Text(_) => {
                Err(UnitError::Unsupported { what: "parameters that are no numbers" })
            }
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
        let Variable { reference, .. } = *self.variable(variable)?;
        self.instance.get_string(reference).map_err(|_| self.refused())
    }

    fn variable(&self, name: &str) -> Result<&Variable, UnitError> {
        self.fmu.description.variables.get(name).ok_or_else(|| UnitError::UnknownVariable { variable: name.to_owned() })
    }

    fn refused(&self) -> UnitError {
        let message = self.instance.take_messages();
        UnitError::Refused { message: if message.is_empty() { "it gives no reason".into() } else { message } }
    }

    fn done(&self, status: Status) -> Result<(), UnitError> {
        if status == Status::Ok { Ok(()) } else { Err(self.refused()) }
    }
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
        let &Variable { reference, size, ty, .. } = self.variable(variable)?;
        if ty != VariableType::Float64 {
            return Err(UnitError::Unsupported { what: "setting a variable that is no Float64" });
        }
        if values.len() != size {
            return Err(UnitError::Length { variable: variable.to_owned(), found: values.len(), expected: size });
        }
        let status = self.instance.set_f64(reference, values);
        self.done(status)
    }

    fn get(&mut self, variable: &str, values: &mut Vec<f64>) -> Result<(), UnitError> {
        let &Variable { reference, size, ty, .. } = self.variable(variable)?;
        values.clear();
        let status = match ty {
            VariableType::Float64 => {
                values.resize(size, 0.0);
                self.instance.get_f64(reference, values)
            }
            VariableType::Int64 => {
                let mut list = vec![0; size];
                let status = self.instance.get_i64(reference, &mut list);
                values.extend(list.into_iter().map(|v| v as f64));
                status
            }
            VariableType::UInt64 => {
                let mut list = vec![0; size];
                let status = self.instance.get_u64(reference, &mut list);
                values.extend(list.into_iter().map(|v| v as f64));
                status
            }
            VariableType::Int32 => {
                let mut list = vec![0; size];
                let status = self.instance.get_i32(reference, &mut list);
                values.extend(list.into_iter().map(f64::from));
                status
            }
            VariableType::String | VariableType::Other => {
                return Err(UnitError::Unsupported { what: "numbers from a variable that has none" });
            }
        };
        self.done(status)
    }

    fn step(&mut self, time: f64, step: f64) -> Result<StepOutcome, UnitError> {
        match self.instance.step(time, step) {
            (Status::Ok, false) => Ok(StepOutcome::Done),
            (Status::Ok, true) => Err(UnitError::Refused { message: "it wants the simulation to end".into() }),
            (Status::Discard, _) => Ok(StepOutcome::Discarded { reason: self.instance.take_messages() }),
            (Status::Error, _) => Err(self.refused()),
        }
    }

    fn can_roll_back(&self) -> bool {
        self.fmu.description.has_state
    }

    fn save(&mut self) -> Result<(), UnitError> {
        let status = self.instance.save();
        self.done(status)
    }

    fn restore(&mut self) -> Result<(), UnitError> {
        match self.instance.restore() {
            Some(status) => self.done(status),
            None => Err(UnitError::Unsupported { what: "going back where no state was kept" }),
        }
    }

    fn serialise(&mut self) -> Result<Vec<u8>, UnitError> {
        if !self.fmu.description.serialises_state {
            return Err(UnitError::Unsupported { what: "states as bytes" });
        }
        self.instance.serialise().map_err(|_| self.refused())
    }

    fn deserialise(&mut self, bytes: &[u8]) -> Result<(), UnitError> {
        if !self.fmu.description.serialises_state {
            return Err(UnitError::Unsupported { what: "states as bytes" });
        }
        self.instance.deserialise(bytes).map_err(|_| self.refused())
    }

    fn newton_iterations(&mut self) -> Option<u64> {
        let mut values = Vec::new();
        self.get(NEWTON, &mut values).ok()?;
        values.first().map(|&n| n as u64)
    }

    fn derivative(&mut self, output: &str, input: &str, seed: &[f64]) -> Result<Option<Vec<f64>>, UnitError> {
        if !self.fmu.description.has_derivatives {
            return Ok(None);
        }
        let &Variable { reference: unknown, size, .. } = self.variable(output)?;
        let &Variable { reference: known, size: expected, .. } = self.variable(input)?;
        if seed.len() != expected {
            return Err(UnitError::Length { variable: input.to_owned(), found: seed.len(), expected });
        }
        let mut result = vec![0.0; size];
        let status = self.instance.derivative(unknown, known, seed, &mut result);
        self.done(status).map(|()| Some(result))
    }
}
