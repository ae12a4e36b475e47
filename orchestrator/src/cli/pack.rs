//! Makes FMUs of a model by the programs `pack-mechanics` and `pack-flow`, which lie beside this one with the units'
//! libraries: this program links no unit.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX, EXE_SUFFIX};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use mesh::Mesh;
use model::Document;

use super::error::CliError;

/// Packs units: each its name, `mechanics` or `flow`, and the FMU to write.
pub(crate) fn pack(document: &Document, mesh: &Mesh, units: &[(&str, PathBuf)]) -> Result<(), CliError> {
    if units.is_empty() {
        return Ok(());
    }
    let programs = programs(units)?;
    let folder = temporary("resources-")?;
    resources(document, mesh, &folder.path().join("model.toml"), &folder.path().join("mesh.h5"))?;
    let mut running = Vec::new();
    for ((_, fmu), program) in units.iter().zip(programs) {
        let mut command = Command::new(&program);
        command.arg(folder.path()).arg(fmu).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        let child = command.spawn().map_err(CliError::file(&program))?;
        running.push((program, child));
    }
    // All are waited for: none is left behind.
    let mut first = Ok(());
    for (program, child) in running {
        let result = child.wait_with_output().map_err(CliError::file(&program)).and_then(|output| {
            if output.status.success() {
                return Ok(());
            }
            let text = String::from_utf8_lossy(&output.stderr);
            let reason = if text.trim().is_empty() { output.status.to_string() } else { text.trim().to_owned() };
            Err(CliError::Pack { program, reason })
        });
        first = first.and(result);
    }
    first
}

/// Writes what travels in units: the mesh, and the model without its other units.
pub(crate) fn resources(
    document: &Document,
    mesh: &Mesh,
    model_file: &Path,
    mesh_file: &Path,
) -> Result<[PathBuf; 2], CliError> {
    let mut document = document.clone();
    document.model.units.clear();
    document.model.connections.clear();
    let part = model_file.with_extension("toml.part");
    let write = || std::fs::write(&part, document.to_toml()).and_then(|()| std::fs::rename(&part, model_file));
    write().map_err(CliError::file(model_file))?;
    mesh_io::write_hdf5(mesh_file, mesh.data())?;
    Ok([model_file.to_owned(), mesh_file.to_owned()])
}

/// A temporary folder.
pub(crate) fn temporary(prefix: &str) -> Result<tempfile::TempDir, CliError> {
    let make = || tempfile::Builder::new().prefix(prefix).tempdir();
    make().map_err(CliError::file(&std::env::temp_dir()))
}

/// The program that packs a unit, and the unit's library, beside this program.
pub(crate) fn files_of(unit: &str) -> [String; 2] {
    [format!("pack-{unit}{EXE_SUFFIX}"), format!("{DLL_PREFIX}{unit}_unit{DLL_SUFFIX}")]
}

/// The programs that pack units; fails with all that is missing.
fn programs(units: &[(&str, PathBuf)]) -> Result<Vec<PathBuf>, CliError> {
    let own = std::env::current_exe().map_err(CliError::file(Path::new("this program")))?;
    let folder = own.parent().unwrap_or(Path::new(".")).to_owned();
    let (mut programs, mut names) = (Vec::new(), Vec::new());
    for (unit, _) in units {
        let needed = files_of(unit);
        programs.push(folder.join(&needed[0]));
        names.extend(needed.into_iter().filter(|name| !folder.join(name).is_file()));
    }
    if names.is_empty() { Ok(programs) } else { Err(CliError::NoUnits { folder, names }) }
}
