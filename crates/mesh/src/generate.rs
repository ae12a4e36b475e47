//! Meshes made without any file.

mod arrangement;
mod boxes;
mod coarsen;
mod extrude;
mod input;
mod polytopes;
mod simplices;
mod size;
mod triangles;

pub use boxes::{cartesian, kershaw, perturb, tag_box};
pub use extrude::extrude;
pub use input::{InputError, InputProblem};
pub use polytopes::{agglomerate, dual};
pub use simplices::simplices;
pub use triangles::Triangles;
