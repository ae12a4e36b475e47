//! Importer of FMI 3.0 and 2.0 co-simulation units: the other side of [`Unit`] is a C library.
//!
//! - [`Description`]: what `modelDescription.xml` says; [`Fit`]: whether that is what a role asks for.
//! - `library`, `fmi3`, `fmi2`: the C functions that are used; the only unsafe code.
//! - [`Fmu`]: an unpacked unit; [`FmuUnit`]: an instance of it; [`Replay`]: one that cannot go back.
//! - [`connections`]: connections by names; [`Measure`]: units of measure.
//!
//! It is our own because it is small: about 25 of the 75 functions. (fmi-rs 0.3.4 asks for all of them.)

mod description;
mod fmi2;
mod fmi3;
mod library;
mod measure;
mod replay;
mod role;
mod unit;
mod wiring;

pub use description::{Causality, Description, Variable, VariableType, Version};
pub use measure::{Conversion, Measure};
pub use replay::Replay;
pub use role::Fit;
pub use unit::{Fmu, FmuUnit};
pub use wiring::{WiringError, connections};

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::PathBuf;

use model::Parameter;

use crate::unit::Unit;
use crate::{CouplingError, Field, Interface};

/// The name under which a unit publishes the fingerprint of its mesh.
const FINGERPRINT: &str = "mesh.fingerprint";

/// Makes units ready for a model: sets the parameters of the coupling that they have and those that the model gives,
/// initialises them, and refuses different meshes. Mechanics comes before flow, own units before those from elsewhere: what
/// later ones take of earlier ones they are given as it is at the start, before their initialisation ends.
///
/// # Errors
/// [`CouplingError::Mesh`]; [`CouplingError::Unit`].
pub fn start(units: &mut [FmuUnit], interface: &Interface, model: &model::Model) -> Result<(), CouplingError> {
    let foreign = |unit: &FmuUnit| model.units.contains_key(unit.name());
    let mut order: Vec<usize> = (0..units.len()).collect();
    order.sort_by_key(|&unit| (foreign(&units[unit]), Reverse(unit)));
    let mut started = vec![false; units.len()];
    for number in order {
        let mut starts: Vec<(String, Parameter)> = Vec::new();
        let from_partner = |f: &&Field| {
            let both = [f.from, number].iter().all(|&unit| units[unit].has(&f.name));
            number < interface.coupled && f.from != number && started[f.from] && both
        };
        let fields = interface.fields.iter().filter(from_partner);
        let fields = fields.map(|f| (f.from, &f.name, &f.name, Conversion::NONE));
        let wires = interface.connections.iter().filter(|c| c.to.0 == number && started[c.from.0]);
        let wires = wires.map(|c| (c.from.0, &c.from.1, &c.to.1, c.conversion));
        for (from, variable, to, conversion) in fields.chain(wires).collect::<Vec<_>>() {
            let (mut values, giver) = (Vec::new(), &mut units[from]);
            giver.get(variable, &mut values).map_err(|error| CouplingError::unit(giver, error))?;
            conversion.apply(&mut values);
            starts.push((to.clone(), Parameter::Numbers(values)));
        }
        starts.extend(parameters(units[number].name(), units[number].fmu().description(), model));
        let unit = &mut units[number];
        let result = starts.iter().try_for_each(|(name, value)| unit.set_start(name, value));
        let result = result.and_then(|()| unit.initialise(model.time.start.0, model.time.end.0));
        result.map_err(|error| CouplingError::unit(unit, error))?;
        started[number] = true;
    }
    let mut first: Option<String> = None;
    for unit in units.iter_mut() {
        let Some(found) = fingerprint(unit)? else { continue };
        let expected = first.get_or_insert_with(|| found.clone());
        if found != *expected {
            return Err(CouplingError::Mesh { fingerprints: [expected.clone(), found] });
        }
    }
    Ok(())
}

/// The parameters that a model sets in a unit: those of the coupling that it has, and those under its name.
pub fn parameters(name: &str, description: &Description, model: &model::Model) -> BTreeMap<String, Parameter> {
    let sensitivity = &model.coupling.sensitivity;
    let coupling = [
        ("porosity_compliance.factor", sensitivity.matrix_compliance_factor),
        ("aperture_compliance.floor", sensitivity.fracture_compliance_floor_factor),
    ];
    let own = coupling.iter().filter(|(name, _)| description.variables.contains_key(*name));
    let mut parameters: BTreeMap<_, _> =
        own.map(|(name, value)| ((*name).to_owned(), Parameter::Number(value.0))).collect();
    parameters.extend(model.units.get(name).map(|unit| unit.parameters.clone()).unwrap_or_default());
    parameters
}

/// The fingerprint of a unit's mesh, if it publishes one.
///
/// # Errors
/// [`CouplingError::Unit`].
pub fn fingerprint(unit: &mut FmuUnit) -> Result<Option<String>, CouplingError> {
    if !unit.has(FINGERPRINT) {
        return Ok(None);
    }
    unit.text(FINGERPRINT).map(Some).map_err(|error| CouplingError::unit(unit, error))
}

/// Makes a unit of an instance. Where it cannot go back, or its state cannot be bytes, replaying stands in for that, unless
/// it `goes_on` without.
pub fn adapted(unit: FmuUnit, goes_on: bool) -> Box<dyn Unit> {
    let is_able = unit.can_roll_back() && unit.can_serialise();
    if is_able || goes_on { Box::new(unit) } else { Box::new(Replay::new(unit)) }
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
