//! What can go wrong.

use std::fmt;

use crate::model::Well;

/// One thing that is wrong with the description of a flow problem.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// A number is outside its range, infinite or undefined.
    #[error("{of}: {quantity} is {value:e}; it must be {must}")]
    Value {
        /// What it belongs to, with its name.
        of: String,
        /// What it is.
        quantity: &'static str,
        /// What was given.
        value: f64,
        /// The range.
        must: &'static str,
    },
    /// A permeability is not symmetric.
    #[error("{of}: the permeability is not symmetric (entries differ by {difference:e} m²)")]
    NotSymmetric {
        /// The region.
        of: String,
        /// Largest difference of two entries that should be equal (m²).
        difference: f64,
    },
    /// A permeability is not positive definite.
    #[error("{of}: the permeability is not positive definite (a leading minor is {minor:e})")]
    NotDefinite {
        /// The region.
        of: String,
        /// The first leading minor that is not positive.
        minor: f64,
    },
    /// A name refers to nothing in the mesh.
    #[error("there is no {kind} \"{name}\" in the mesh; it has {known:?}")]
    Unknown {
        /// Region, boundary tag or fracture.
        kind: &'static str,
        /// The name.
        name: String,
        /// The names there are.
        known: Vec<String>,
    },
    /// Something in the mesh got no properties.
    #[error("{kind} \"{name}\" of the mesh has no properties")]
    Missing {
        /// Region or fracture.
        kind: &'static str,
        /// The name.
        name: String,
    },
    /// The same name is given twice, or is empty.
    #[error("{kind} \"{name}\" is given twice, or its name is empty")]
    Repeated {
        /// Region, fracture, boundary tag or well.
        kind: &'static str,
        /// The name.
        name: String,
    },
    /// A well is in no cell, or on no fracture face.
    #[error("well \"{well}\" at ({x}, {y}, {z}) lies {outside}")]
    WellOutside {
        /// Its name.
        well: String,
        /// Outside of what.
        outside: &'static str,
        /// Where it is (m).
        x: f64,
        /// Where it is (m).
        y: f64,
        /// Where it is (m).
        z: f64,
    },
    /// A well lacks an index, or has none from its radius.
    #[error("well \"{well}\": {reason}")]
    WellIndex {
        /// Its name.
        well: String,
        /// Why.
        reason: String,
    },
    /// An array has the wrong length.
    #[error("{array} has {found} entries; it needs {expected}")]
    Length {
        /// The array.
        array: &'static str,
        /// Its length.
        found: usize,
        /// One for each entity.
        expected: usize,
    },
    /// Nothing fixes the pressure in a part of rock and fractures.
    #[error(
        "nothing fixes the pressure in {}, linked to each other and to nothing else: the first is {first}. They have neither a \
         boundary pressure nor a well that holds a pressure, and neither fluid nor rock there can be compressed. Give the fluid \
         a bulk modulus, give the rock a Biot modulus, or couple the flow to mechanics with a Biot \
         coefficient above 0, in an iteration in which the pressure follows from the rock (a host says so by the parameter pressure_references.follow)",
        isolated(*cells, *fracture_faces)
    )]
    Isolated {
        /// Number of cells.
        cells: usize,
        /// Number of fracture faces.
        fracture_faces: usize,
        /// The first of them, with its place.
        first: String,
    },
}

impl Problem {
    /// A well without an index that allows it is to hold a pressure.
    pub(crate) fn lacks_index(well: &Well) -> Self {
        let reason =
            "to hold a pressure, or to be limited by one, it needs an index, or a radius that gives one".into();
        Self::WellIndex { well: well.name.clone(), reason }
    }
}

/// "3 cells and 1 fracture face".
fn isolated(cells: usize, fracture_faces: usize) -> String {
    let counted = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
    match (cells, fracture_faces) {
        (0, faces) => counted(faces, "fracture face"),
        (cells, 0) => counted(cells, "cell"),
        (cells, faces) => format!("{} and {}", counted(cells, "cell"), counted(faces, "fracture face")),
    }
}

/// An error of the flow.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum FlowError {
    /// The description or the inputs are wrong: all that was found, never empty.
    Invalid(Vec<Problem>),
    /// An aperture falls to zero or below when the pressures of the time step close it. A smaller time step, a
    /// smaller compliance or a better reference may help.
    Closed {
        /// The fracture face.
        fracture_face: usize,
        /// What its aperture would be (m).
        aperture: f64,
    },
    /// The wells keep changing between rate and pressure.
    WellLimits {
        /// How often they changed.
        changes: usize,
    },
    /// There is no solved time step that this could refer to.
    NothingSolved,
    /// The linear system could not be solved.
    Linear(linear::Error),
}

/// How many problems a message spells out.
const SHOWN: usize = 20;

impl fmt::Display for FlowError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Invalid(problems) => {
                let n = problems.len();
                write!(f, "the flow problem has {n} fault{}:", if n == 1 { "" } else { "s" })?;
                for problem in problems.iter().take(SHOWN) {
                    write!(f, "\n  {problem}")?;
                }
                if n > SHOWN {
                    write!(f, "\n  and {} more", n - SHOWN)?;
                }
                Ok(())
            }
            Self::Closed { fracture_face, aperture } => {
                write!(f, "fracture face {fracture_face} would get an aperture of {aperture:e} m in this time step")
            }
            Self::WellLimits { changes } => {
                write!(f, "after {changes} changes the wells still switch between rate and pressure")
            }
            Self::NothingSolved => write!(f, "no time step has been solved from this state yet"),
            Self::Linear(error) => write!(f, "the linear system of the flow: {error}"),
        }
    }
}

impl std::error::Error for FlowError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Linear(error) => Some(error),
            _ => None,
        }
    }
}

impl From<linear::Error> for FlowError {
    fn from(error: linear::Error) -> Self {
        Self::Linear(error)
    }
}
