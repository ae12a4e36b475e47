//! What can be wrong with a mesh.

use std::fmt;

/// One thing that is wrong with a mesh, with the entities it concerns.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// The dimension is neither 2 nor 3.
    #[error("the dimension is {dimension}; it must be 2 or 3")]
    Dimension {
        /// What was given.
        dimension: usize,
    },
    /// There is no cell.
    #[error("there is no cell")]
    Empty,
    /// An array that goes with the cells or faces has another length.
    #[error("{array} has {found} entries, one is needed for each of the {expected} {entity}s")]
    Length {
        /// Name of the array.
        array: &'static str,
        /// What it goes with.
        entity: &'static str,
        /// Its length.
        found: usize,
        /// Number of entities.
        expected: usize,
    },
    /// An entity refers to another that does not exist.
    #[error("{entity} {number} refers to {target} {index}, but there are only {count}")]
    OutOfRange {
        /// Kind of the referring entity.
        entity: &'static str,
        /// Its number.
        number: usize,
        /// Kind of what it refers to.
        target: &'static str,
        /// The number it gives.
        index: usize,
        /// How many of them there are.
        count: usize,
    },
    /// A coordinate is NaN or infinite, or z is not zero in two dimensions.
    #[error("vertex {vertex} lies at ({x}, {y}, {z}): coordinates must be finite, and z = 0 in 2D")]
    Coordinate {
        /// Its number.
        vertex: usize,
        /// Its x (m).
        x: f64,
        /// Its y (m).
        y: f64,
        /// Its z (m).
        z: f64,
    },
    /// Two vertices lie at the same point, so that the cells there do not match.
    #[error(
        "vertices {first} and {second} lie at the same point ({x}, {y}, {z}): cells that meet there must share one vertex"
    )]
    CoincidentVertices {
        /// The lower number.
        first: usize,
        /// The higher number.
        second: usize,
        /// Common x (m).
        x: f64,
        /// Common y (m).
        y: f64,
        /// Common z (m).
        z: f64,
    },
    /// No face uses this vertex.
    #[error("vertex {vertex} belongs to no face")]
    UnusedVertex {
        /// Its number.
        vertex: usize,
    },
    /// A face has too few vertices.
    #[error("face {face} has {count} vertices; a face has 2 in 2D and at least 3 in 3D")]
    VertexCount {
        /// Its number.
        face: usize,
        /// How many vertices it has.
        count: usize,
    },
    /// A face names one vertex twice.
    #[error("face {face} names vertex {vertex} twice")]
    RepeatedVertex {
        /// Number of the face.
        face: usize,
        /// Number of the vertex.
        vertex: usize,
    },
    /// A face has no extent.
    #[error("face {face} is degenerate: its measure is {measure:e} (diameter {diameter:e} m)")]
    DegenerateFace {
        /// Its number.
        face: usize,
        /// Length or area.
        measure: f64,
        /// Largest distance of two of its vertices (m).
        diameter: f64,
    },
    /// Two faces have the same vertices.
    #[error("faces {first} and {second} have the same vertices")]
    DuplicateFaces {
        /// The lower number.
        first: usize,
        /// The higher number.
        second: usize,
    },
    /// A face belongs to no cell, or to more than two, or twice to one.
    #[error("face {face} belongs to the cells {cells:?}; it must belong to one (boundary) or two")]
    FaceCells {
        /// Its number.
        face: usize,
        /// The cells that name it.
        cells: Vec<usize>,
    },
    /// The faces of a cell do not close its surface.
    #[error("cell {cell} is not closed: at vertices {ridge:?} meet {count} of its faces instead of 2")]
    OpenCell {
        /// Its number.
        cell: usize,
        /// The vertex (2D) or the two vertices of the edge (3D).
        ridge: Vec<usize>,
        /// How many faces meet.
        count: usize,
    },
    /// The surface of a cell falls into pieces or is not orientable.
    #[error("the surface of cell {cell} is not one closed orientable piece")]
    CellSurface {
        /// Its number.
        cell: usize,
    },
    /// A cell has no volume.
    #[error("cell {cell} is degenerate: its measure is {measure:e} (diameter {diameter:e} m)")]
    DegenerateCell {
        /// Its number.
        cell: usize,
        /// Area or volume.
        measure: f64,
        /// Largest distance of two of its vertices (m).
        diameter: f64,
    },
    /// Two faces of a cell of a 2D mesh cross.
    #[error("faces {first} and {second} of cell {cell} cross")]
    CrossingFaces {
        /// Number of the cell.
        cell: usize,
        /// One face.
        first: usize,
        /// The other.
        second: usize,
    },
    /// Two cells lie on the same side of their common face: one is inverted or they overlap.
    #[error(
        "cells {first} and {second} lie on the same side of their common face {face}: one is inverted, or they overlap"
    )]
    SameSide {
        /// Number of the face.
        face: usize,
        /// The lower cell.
        first: usize,
        /// The higher cell.
        second: usize,
    },
    /// A fracture face has a cell on one side only.
    #[error(
        "face {face} of fracture \"{fracture}\" lies on the outer boundary; a fracture face needs a cell on both sides"
    )]
    FractureOnBoundary {
        /// Number of the face.
        face: usize,
        /// Name of the fracture.
        fracture: String,
    },
    /// A boundary tag sits on a face inside the mesh.
    #[error("face {face} carries the boundary tag \"{tag}\", but has a cell on both sides")]
    TagInside {
        /// Number of the face.
        face: usize,
        /// The tag.
        tag: String,
    },
    /// A name occurs twice, or is empty.
    #[error("{kind} name \"{name}\" is empty or occurs twice")]
    Name {
        /// Region, tag or fracture.
        kind: &'static str,
        /// The name.
        name: String,
    },
}

/// Everything that is wrong with a mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshError {
    /// The problems, in the order in which they were found; never empty.
    pub problems: Vec<Problem>,
}

/// How many problems a message spells out.
pub(crate) const SHOWN: usize = 20;

impl fmt::Display for MeshError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let n = self.problems.len();
        write!(f, "the mesh has {n} problem{}:", if n == 1 { "" } else { "s" })?;
        for problem in self.problems.iter().take(SHOWN) {
            write!(f, "\n  {problem}")?;
        }
        if n > SHOWN {
            write!(f, "\n  and {} more", n - SHOWN)?;
        }
        Ok(())
    }
}

impl std::error::Error for MeshError {}
