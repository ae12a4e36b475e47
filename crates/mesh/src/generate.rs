//! Meshes made without any file.

mod boxes;

pub use boxes::{cartesian, tag_box};
