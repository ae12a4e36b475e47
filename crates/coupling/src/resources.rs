//! What travels in the resources of both units.

use std::path::Path;

use fmi_unit::UnitError;
use mesh::Mesh;
use model::Document;

/// Reads `model.toml` and `mesh.h5` from a folder of resources.
///
/// # Errors
/// A file is missing or corrupt, or the two do not fit.
pub fn read_resources(folder: &Path) -> Result<(Document, Mesh), UnitError> {
    let document = Document::load(folder, &[], &[])?;
    let mesh = Mesh::new(mesh_io::read_hdf5(folder.join("mesh.h5"))?)?;
    document.check_mesh(&mesh)?;
    Ok((document, mesh))
}
