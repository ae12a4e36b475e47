//! What can be wrong with the input of a generator.

use std::fmt;

use crate::error::SHOWN;

/// One thing that is wrong with the input of a generator.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InputProblem {
    /// A number that must be finite and positive is not.
    #[error("{what} is {value}; it must be finite and positive")]
    NotPositive {
        /// What the number is.
        what: String,
        /// Its value.
        value: f64,
    },
    /// A point has a coordinate that is NaN, infinite, or of a magnitude that products of coordinates cannot bear.
    #[error("point {index} of {what} is ({x}, {y}); coordinates must be finite and below 1e60")]
    Coordinate {
        /// The line, or the domain.
        what: String,
        /// Number of the point.
        index: usize,
        /// Its x (m).
        x: f64,
        /// Its y (m).
        y: f64,
    },
    /// A line has less than two points, or the domain less than three corners.
    #[error("{what} has {count} points; it needs at least {least}")]
    TooFewPoints {
        /// The line, or the domain.
        what: String,
        /// Number of its points.
        count: usize,
        /// How many it needs.
        least: usize,
    },
    /// Two points of a line that follow one another coincide.
    #[error("segment {index} of {what} has no length: both its ends lie at ({x}, {y})")]
    ZeroLength {
        /// The line, or the domain.
        what: String,
        /// Number of the segment.
        index: usize,
        /// Common x (m).
        x: f64,
        /// Common y (m).
        y: f64,
    },
    /// A line leaves the domain.
    #[error("{what} leaves the domain at ({x}, {y})")]
    Outside {
        /// The line.
        what: String,
        /// x of a point outside (m).
        x: f64,
        /// y of a point outside (m).
        y: f64,
    },
    /// Two lines have a piece in common.
    #[error("{first} and {second} overlap along ({}, {}) to ({}, {})", from[0], from[1], to[0], to[1])]
    Overlap {
        /// One line (or the domain's boundary).
        first: String,
        /// The other.
        second: String,
        /// One end of the common piece (m).
        from: [f64; 2],
        /// The other end (m).
        to: [f64; 2],
    },
    /// The boundary of the domain crosses or touches itself.
    #[error("the boundary of the domain meets itself at ({x}, {y})")]
    DomainCrosses {
        /// Where, x (m).
        x: f64,
        /// Where, y (m).
        y: f64,
    },
    /// A name is empty, or two fractures have the same.
    #[error("the fracture name \"{name}\" is empty or occurs twice")]
    Name {
        /// The name.
        name: String,
    },
    /// A list of levels does not ascend.
    #[error("level {index} is {value}; levels must be finite and ascend, and there must be two of them")]
    Levels {
        /// Number of the level.
        index: usize,
        /// Its height (m).
        value: f64,
    },
    /// The mesh would have too many vertices.
    #[error("the sizes ask for more than {limit} vertices")]
    TooFine {
        /// Largest number of vertices.
        limit: usize,
    },
    /// A mesh of another dimension is needed.
    #[error("a mesh of dimension {needed} is needed, this one has {found}")]
    Dimension {
        /// What is needed.
        needed: usize,
        /// What was given.
        found: usize,
    },
    /// A cell that cannot be cut into simplices from its lowest vertex.
    #[error("cell {cell} is not strictly convex; it cannot be cut into simplices")]
    NotConvex {
        /// Number of the cell.
        cell: usize,
    },
    /// A mesh that does not consist of simplices.
    #[error("cell {cell} has {faces} faces: simplices are needed")]
    NoSimplex {
        /// Number of the cell.
        cell: usize,
        /// How many faces it has.
        faces: usize,
    },
    /// A corner-point grid has too few or too many of something.
    #[error("the grid has {found} {what}; it needs {expected}")]
    Count {
        /// Of what.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many there must be.
        expected: usize,
    },
    /// A pillar of a corner-point grid is not sound.
    #[error("pillar ({}, {}) {problem}", pillar[0] + 1, pillar[1] + 1)]
    Pillar {
        /// Its numbers along i and j, from 0 (in the message from 1, as in files).
        pillar: [usize; 2],
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A cell of a corner-point grid is not sound.
    #[error("cell ({}, {}, {}) {problem}", cell[0] + 1, cell[1] + 1, cell[2] + 1)]
    GridCell {
        /// Its numbers along i, j and k, from 0 (in the message from 1, as in files).
        cell: [usize; 3],
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A fault of a corner-point grid lies beside a block of cells that is not there.
    #[error("the cells of fault \"{name}\" must be ascending and in 1..{} x 1..{} x 1..{}", cells[0], cells[1], cells[2])]
    Fault {
        /// Its name.
        name: String,
        /// Number of cells of the grid.
        cells: [usize; 3],
    },
}

/// Everything that is wrong with the input of a generator.
#[derive(Clone, Debug, PartialEq)]
pub struct InputError {
    /// The problems; never empty.
    pub problems: Vec<InputProblem>,
}

impl InputError {
    /// `Ok` where there is no problem.
    pub(crate) fn check(problems: Vec<InputProblem>) -> Result<(), Self> {
        if problems.is_empty() { Ok(()) } else { Err(Self { problems }) }
    }
}

impl From<InputProblem> for InputError {
    fn from(problem: InputProblem) -> Self {
        Self { problems: vec![problem] }
    }
}

impl fmt::Display for InputError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let n = self.problems.len();
        write!(f, "the geometry has {n} problem{}:", if n == 1 { "" } else { "s" })?;
        self.problems.iter().take(SHOWN).try_for_each(|problem| write!(f, "\n  {problem}"))?;
        if n > SHOWN { write!(f, "\n  and {} more", n - SHOWN) } else { Ok(()) }
    }
}

impl std::error::Error for InputError {}
