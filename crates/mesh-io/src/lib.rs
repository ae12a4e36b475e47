//! Meshes and results in files.
//!
//! | format | functions | for |
//! |---|---|---|
//! | HDF5 | [`read_hdf5`], [`write_hdf5`] | meshes, exactly as they are |
//! | Gmsh MSH 4.1 | [`read_gmsh`] | meshes made by Gmsh, with their physical groups |
//! | GRDECL | [`read_grdecl`] | corner-point grids, with their faults |
//! | VTK XML | [`write_vtu`], [`write_fracture_vtu`], [`write_pvd`] | results, for ParaView |
//!
//! Readers give [`mesh::MeshData`], which [`mesh::Mesh::new`] checks.

mod error;
mod gmsh;
mod grdecl;
mod hdf5;
mod vtu;

pub use error::FileError;
pub use gmsh::read_gmsh;
pub use grdecl::{Grdecl, read_grdecl};
pub use hdf5::{read_hdf5, write_hdf5};
pub use vtu::{Field, Values, write_fracture_vtu, write_pvd, write_vtu};
