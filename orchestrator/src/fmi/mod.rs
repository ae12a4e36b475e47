//! Importer of FMI 3.0 co-simulation units: the other side of [`Unit`] is a C library.
//!
//! - [`Description`]: what `modelDescription.xml` says.
//! - `library`: the C functions that are used; the only unsafe code.
//! - [`Fmu`]: an unpacked unit; [`FmuUnit`]: an instance of it.
//!
//! It is our own because it is small: about 20 of the 75 functions. (fmi-rs 0.3.4 asks for all of them.)

mod description;
mod library;
mod measure;
mod unit;
mod wiring;

pub use description::{Causality, Description, Variable, VariableType};
pub use measure::{Conversion, Measure};
pub use unit::{Fmu, FmuUnit};
pub use wiring::{WiringError, connections};

use std::path::PathBuf;

use crate::CouplingError;
use crate::unit::Unit;

/// Makes units ready for a model: refuses different meshes, sets the parameters of the coupling that the units have and
/// those that the model gives, and initialises them.
///
/// # Errors
/// [`CouplingError::Mesh`]; [`CouplingError::Unit`].
pub fn start(units: &mut [FmuUnit], model: &model::Model) -> Result<(), CouplingError> {
    const FINGERPRINT: &str = "mesh.fingerprint";
    let fail = |unit: &FmuUnit, error| CouplingError::unit(unit, error);
    let mut first: Option<String> = None;
    for unit in units.iter_mut().filter(|unit| unit.has(FINGERPRINT)) {
        let found = unit.text(FINGERPRINT).map_err(|error| fail(unit, error))?;
        let expected = first.get_or_insert_with(|| found.clone());
        if found != *expected {
            return Err(CouplingError::Mesh { fingerprints: [expected.clone(), found] });
        }
    }
    let sensitivity = &model.coupling.sensitivity;
    let parameters = [
        ("porosity_compliance.factor", sensitivity.matrix_compliance_factor),
        ("aperture_compliance.floor", sensitivity.fracture_compliance_floor_factor),
    ];
    for unit in &mut *units {
        for (name, value) in parameters.iter().filter(|(name, _)| unit.has(name)).collect::<Vec<_>>() {
            unit.set(name, &[value.0]).map_err(|error| fail(unit, error))?;
        }
        for (name, value) in model.units.get(unit.name()).map(|unit| &unit.parameters).into_iter().flatten() {
            unit.set_start(name, value).map_err(|error| fail(unit, error))?;
        }
    }
    // What mechanics has at the start belongs to the initial state of flow.
    let mut deformation: Vec<(&str, Vec<f64>)> = Vec::new();
    let mut order: Vec<_> = units.iter_mut().collect();
    order.sort_by_key(|unit| unit.name() != "mechanics");
    for unit in order {
        if unit.name() == "flow" {
            for (name, values) in &deformation {
                if unit.has(name) {
                    unit.set(name, values).map_err(|error| fail(unit, error))?;
                }
            }
        }
        unit.initialise(model.time.start.0, model.time.end.0).map_err(|error| fail(unit, error))?;
        if unit.name() == "mechanics" {
            for name in ["matrix.porosity_change", "fracture.aperture"] {
                if unit.has(name) {
                    let mut values = Vec::new();
                    unit.get(name, &mut values).map_err(|error| fail(unit, error))?;
                    deformation.push((name, values));
                }
            }
        }
    }
    Ok(())
}

/// Why an FMU cannot be loaded.
#[derive(Debug, thiserror::Error)]
#[error("{}: {reason}", path.display())]
pub struct FmuError {
    /// The FMU.
    pub path: PathBuf,
    /// Why.
    pub reason: String,
}
