//! Meshes made without any file.

mod arrangement;
mod boxes;
mod input;
mod size;
mod triangles;

pub use boxes::{cartesian, tag_box};
pub use input::{InputError, InputProblem};
pub use triangles::Triangles;
