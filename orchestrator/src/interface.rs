//! What two units exchange, and the split: an order and a choice of sensitivities.

use crate::error::CouplingError;
use crate::fmi::Conversion;
use crate::unit::Unit;
use coupling::{QUANTITIES, Role};
use model::{Criterion, Norm, Number, Split};

/// A field that one unit gives and the other takes, under one name.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Its name in both units.
    pub name: String,
    /// Its unit of measure.
    pub unit: String,
    /// Which unit gives it: 0 or 1.
    pub from: usize,
    /// How it follows the partner's field, as its giver believes.
    pub sensitivity: Option<Sensitivity>,
    /// When it has converged.
    pub criterion: Criterion,
}

impl Field {
    /// Whether a variable of the taker or the giver is set by the coupling of this field.
    pub(crate) fn sets(&self, variable: &str) -> bool {
        let own = variable.strip_suffix("_reference").unwrap_or(variable);
        own == self.name || self.sensitivity.as_ref().is_some_and(|s| s.variable == variable)
    }
}

/// The taker sees the field as `value + sign · variable · (p − p*)`, with p its own field `partner` and p* its value
/// at the giver's last evaluation, which it takes as `{partner}_reference`. The sign is the units' convention.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensitivity {
    /// Name of the variable that the giver publishes and the taker takes.
    pub variable: String,
    /// Which field of the interface goes the other way.
    pub partner: usize,
}

/// An output of a unit that an input of another is set to, outside the coupling. An input of a coupled unit is set
/// before each time step and stays as it is in it (zero-order hold); that of a unit that follows, when it steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Connection {
    /// Number of the unit, and the variable that is read.
    pub from: (usize, String),
    /// Number of the unit, and the variable that is set.
    pub to: (usize, String),
    /// Between their units of measure.
    pub conversion: Conversion,
}

/// What units exchange.
#[derive(Clone, Debug, PartialEq)]
pub struct Interface {
    /// How many units are coupled: one or two, the first ones. Further ones step once for each accepted time step, after
    /// them and in their order.
    pub coupled: usize,
    /// The fields between the coupled units.
    pub fields: Vec<Field>,
    /// All other connections.
    pub connections: Vec<Connection>,
}

/// Number of the flow unit in [`Interface::poroelastic`].
pub const FLOW: usize = 0;
/// Number of the mechanics unit in [`Interface::poroelastic`].
pub const MECHANICS: usize = 1;

impl Interface {
    /// The interface of flow and mechanics:
    ///
    /// | field | from | sensitivity | partner |
    /// |---|---|---|---|
    /// | `matrix.pressure` (Pa) | flow | `matrix.pressure_stiffness` (Pa) | porosity change |
    /// | `fracture.pressure` (Pa) | flow | `fracture.pressure_stiffness` (Pa/m) | aperture |
    /// | `matrix.porosity_change` (1) | mechanics | `matrix.porosity_compliance` (1/Pa) | matrix pressure |
    /// | `fracture.aperture` (m) | mechanics | `fracture.aperture_compliance` (m/Pa) | fracture pressure |
    ///
    /// The floors of the criteria, by which what is left of a field may be taken for nothing: 100 Pa, and what they do to rock of
    /// 10 GPa, a porosity of 1e-8, 10 nm.
    pub fn poroelastic() -> Self {
        let table = [
            ("matrix.pressure_stiffness", 2, 1e2),
            ("fracture.pressure_stiffness", 3, 1e2),
            ("matrix.porosity_compliance", 0, 1e-8),
            ("fracture.aperture_compliance", 1, 1e-8),
        ];
        let fields = QUANTITIES.iter().filter(|quantity| quantity.referenced);
        let fields = fields.zip(table).map(|(quantity, (variable, partner, floor))| Field {
            name: quantity.name.into(),
            unit: quantity.unit.into(),
            from: if quantity.from == Role::Flow { FLOW } else { MECHANICS },
            sensitivity: Some(Sensitivity { variable: variable.into(), partner }),
            criterion: Criterion { tolerance: Number(1e-5), floor: Number(floor), norm: Norm::Largest },
        });
        Self { coupled: 2, fields: fields.collect(), connections: Vec::new() }
    }

    /// One unit alone: there is nothing to couple, and a time step is one pass.
    pub fn single() -> Self {
        Self { coupled: 1, fields: Vec::new(), connections: Vec::new() }
    }

    /// Leaves out the fields that neither unit has, as those on fractures where there are none, and the sensitivities
    /// that one of them lacks.
    ///
    /// # Errors
    /// [`CouplingError::Field`] where one unit has a field and the other does not.
    pub fn fitted(self, units: &[Box<dyn Unit>]) -> Result<Self, CouplingError> {
        self.fitted_by(&|unit, variable| units[unit].has(variable), &|unit| units[unit].name().to_owned())
    }

    /// As [`fitted`](Self::fitted), of units by number: whether one has a variable, and its name.
    ///
    /// # Errors
    /// As there.
    pub fn fitted_by(
        self,
        has: &dyn Fn(usize, &str) -> bool,
        name: &dyn Fn(usize) -> String,
    ) -> Result<Self, CouplingError> {
        let mut kept = Vec::new();
        for field in &self.fields {
            let both = [0, 1].map(|unit| has(unit, &field.name));
            if both[0] != both[1] {
                let unit = name(usize::from(both[0]));
                return Err(CouplingError::Field { unit, field: field.name.clone() });
            }
            kept.push(both[0]);
        }
        // Fields go with their partners: what is on fractures is there for both or neither.
        let number = |old: usize| kept[..old].iter().filter(|&&k| k).count();
        let names: Vec<String> = self.fields.iter().map(|f| f.name.clone()).collect();
        let mut fields = self.fields;
        let mut keep = kept.iter();
        fields.retain(|_| keep.next() == Some(&true));
        for field in &mut fields {
            let (giver, taker) = (field.from, 1 - field.from);
            field.sensitivity = field.sensitivity.take().filter(|s| {
                let reference = format!("{}_reference", names[s.partner]);
                kept[s.partner] && has(giver, &s.variable) && has(taker, &s.variable) && has(taker, &reference)
            });
            if let Some(sensitivity) = &mut field.sensitivity {
                sensitivity.partner = number(sensitivity.partner);
            }
        }
        Ok(Self { fields, ..self })
    }

    /// Replaces the criteria of fields by name; names that there are not are left alone.
    #[must_use]
    pub fn with_criteria<'a>(mut self, criteria: impl IntoIterator<Item = (&'a String, &'a Criterion)>) -> Self {
        for (name, criterion) in criteria {
            self.fields.iter_mut().filter(|f| f.name == *name).for_each(|f| f.criterion = *criterion);
        }
        self
    }

    /// Numbers of the fields that a unit gives.
    pub(crate) fn given_by(&self, unit: usize) -> impl Iterator<Item = usize> + '_ {
        (0..self.fields.len()).filter(move |&f| self.fields[f].from == unit)
    }
}

impl Scheme {
    /// Without units of whose sensitivities none is there for both.
    pub(crate) fn fitted(mut self, interface: &Interface) -> Self {
        for unit in 0..interface.coupled {
            let mut own = interface.given_by(unit).map(|f| interface.fields[f].sensitivity.is_some()).peekable();
            self.connected[unit] &= own.peek().is_none() || own.any(|has| has);
        }
        self
    }
}

/// Which unit goes first, and whose sensitivities are passed on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scheme {
    /// The unit that goes first.
    pub first: usize,
    /// For each unit, whether the sensitivities that it publishes are passed on.
    pub connected: [bool; 2],
}

impl From<Split> for Scheme {
    fn from(split: Split) -> Self {
        match split {
            Split::FixedStrain => Self { first: FLOW, connected: [false, false] },
            Split::Drained => Self { first: MECHANICS, connected: [false, false] },
            Split::FixedStress => Self { first: FLOW, connected: [false, true] },
            Split::Undrained => Self { first: MECHANICS, connected: [true, false] },
        }
    }
}
