//! Meshes made without any file.

mod arrangement;
mod boxes;
mod coarsen;
mod corner_point;
mod extrude;
mod input;
mod polytopes;
mod simplices;
mod size;
mod triangles;

pub(crate) use arrangement::side;
pub use boxes::{cartesian, kershaw, perturb, tag_box};
pub use corner_point::{CornerPoint, Fault};
pub use extrude::extrude;
pub use input::{InputError, InputProblem};
pub use polytopes::{agglomerate, dual, unite_cells};
pub use simplices::simplices;
pub use triangles::Triangles;
