//! What can go wrong in the mechanical unit.

use std::fmt;

/// One thing that is wrong with a mechanical model, or that does not fit its mesh.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ModelProblem {
    /// A parameter is out of its range.
    #[error("{place}: {parameter} is {value}; it must be {allowed}")]
    Parameter {
        /// Region, fracture or group of settings.
        place: String,
        /// Name of the parameter.
        parameter: &'static str,
        /// What was given.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// A region, fracture or tag of the mesh has no data, or data name one that the mesh lacks.
    #[error("{kind} \"{name}\" {fault}; the mesh has {known}")]
    Name {
        /// Region, fracture or boundary tag.
        kind: &'static str,
        /// Its name.
        name: String,
        /// What is wrong with it.
        fault: &'static str,
        /// The names that the mesh has.
        known: String,
    },
    /// A direction does not exist in this dimension.
    #[error("Dirichlet data on {place} fix component {component}; there are only {dim}")]
    Component {
        /// Where.
        place: String,
        /// The component given.
        component: usize,
        /// Dimension.
        dim: usize,
    },
    /// A point is none.
    #[error("Dirichlet data hold at {place}, which is not finite")]
    Point {
        /// Where.
        place: String,
    },
    /// The Dirichlet data leave a piece of the body free to move.
    #[error(
        "the piece of the body around ({x:.4e}, {y:.4e}, {z:.4e}) m, of {cells} cells, can move as a rigid body: its Dirichlet data \
         leave {free} of {modes} rigid motions free"
    )]
    Floating {
        /// Centre of its first cell (m).
        x: f64,
        /// Centre of its first cell (m).
        y: f64,
        /// Centre of its first cell (m).
        z: f64,
        /// Number of its cells.
        cells: usize,
        /// Number of rigid motions that nothing prevents.
        free: usize,
        /// Number of rigid motions in this dimension.
        modes: usize,
    },
    /// A function of space (and time) gave something that cannot be used.
    #[error("{what} at ({x}, {y}, {z}) m, t = {time} s, is {value}; it must be {allowed}")]
    Function {
        /// Name of the function.
        what: String,
        /// Where (m).
        x: f64,
        /// Where (m).
        y: f64,
        /// Where (m).
        z: f64,
        /// When (s).
        time: f64,
        /// What it gave.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
}

/// An error of the mechanical unit.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MechanicsError {
    /// Invalid input: everything that is wrong with the model.
    #[error("{}", Listing(.0))]
    Model(Vec<ModelProblem>),
    /// Invalid input: an array that is exchanged has the wrong length.
    #[error("{field} has {found} values; it needs {expected}")]
    Length {
        /// Name of the field.
        field: &'static str,
        /// Its length.
        found: usize,
        /// The length needed.
        expected: usize,
    },
    /// Invalid input: an exchanged value cannot be used.
    #[error("{field}[{index}] is {value}; it must be {allowed}")]
    Value {
        /// Name of the field.
        field: &'static str,
        /// Place in the field.
        index: usize,
        /// What was given.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// Singular: the linearised contact problem has no unique solution, for instance because open
    /// fractures set a piece of the body free.
    #[error(
        "the linearised contact problem is singular ({open} faces open, {slipping} slipping): a piece of the body may be free to move"
    )]
    Singular {
        /// Open faces.
        open: usize,
        /// Slipping faces.
        slipping: usize,
    },
    /// There is no factorisation, as the last call that was to make one failed.
    #[error(
        "the stiffness is not factorised, as the last attempt failed; call `follow` with a matrix stiffness of the partner that can be"
    )]
    Unfactorised,
    /// The bulk stiffness could not be factorised.
    #[error("the stiffness could not be factorised: {0}")]
    Linear(#[from] linear::Error),
}

struct Listing<'a>(&'a [ModelProblem]);

impl fmt::Display for Listing<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let n = self.0.len();
        write!(f, "the mechanical model has {n} problem{}:", if n == 1 { "" } else { "s" })?;
        self.0.iter().try_for_each(|problem| write!(f, "\n  {problem}"))
    }
}
