//! A model as the command line names it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use mesh::Mesh;
use mesh_io::Grdecl;
use model::{CornerPoint, Document, ForeignUnit};
use orchestrator::counted;

use super::error::CliError;

/// Faces that are planar up to this part of their diameter are not worth a word: the round-off of generated coordinates.
const ROUND_OFF: f64 = 1e-10;

/// A model with its variants and changes.
pub(crate) struct Case {
    /// Name of its folder.
    pub(crate) name: String,
    pub(crate) folder: PathBuf,
    pub(crate) document: Document,
    pub(crate) variants: Vec<String>,
    /// Pieces of TOML.
    pub(crate) changes: Vec<String>,
}

impl Case {
    /// Reads a model: `path` is a folder with a `model.toml`, or that file, or the name of a folder in `models`.
    pub(crate) fn load(path: &Path, variants: &[String], changes: &[String]) -> Result<Self, CliError> {
        let folder = find(path)?;
        let changes: Vec<String> = changes.iter().map(|change| quoted(change)).collect();
        let mut document = Document::load(&folder, &as_strs(variants), &as_strs(&changes))?;
        for unit in document.model.units.values_mut() {
            unit.fmu = folder.join(&unit.fmu);
        }
        let name = folder.canonicalize().unwrap_or_else(|_| folder.clone());
        let name = name.file_name().map_or_else(|| "model".into(), |name| name.to_string_lossy().into_owned());
        Ok(Self { name, folder, document, variants: variants.to_vec(), changes })
    }

    pub(crate) fn mesh(&self) -> Result<Mesh, CliError> {
        let read = |path: &Path, grid: Option<&CornerPoint>| {
            let data = match grid {
                Some(grid) => mesh_io::read_grdecl(path, &grdecl(grid)),
                None if path.extension().is_some_and(|e| e == "h5") => mesh_io::read_hdf5(path),
                None => mesh_io::read_gmsh(path),
            };
            data.map_err(|error| error.to_string())
        };
        Ok(self.document.mesh(&self.folder, &read)?)
    }

    /// Puts an FMU into a role.
    pub(crate) fn put(&mut self, name: &str, fmu: PathBuf) {
        let units = &mut self.document.model.units;
        let parameters = units.remove(name).map_or_else(BTreeMap::new, |unit| unit.parameters);
        units.insert(name.to_owned(), ForeignUnit { fmu, parameters });
    }

    /// The units that are made from the model.
    pub(crate) fn units(&self) -> impl Iterator<Item = &'static str> {
        let model = &self.document.model;
        let units = [("mechanics", model.mechanics.is_some()), ("flow", model.flow.is_some())];
        units.into_iter().filter(|(name, is_own)| *is_own && !model.units.contains_key(*name)).map(|unit| unit.0)
    }

    /// A few lines for people.
    pub(crate) fn describe(&self, mesh: &Mesh) -> String {
        let network = mesh.network();
        let units = self.document.model.unit_names();
        format!(
            "{}\n{}D, {}, {} faces, {} vertices; {}, {}{}\nunits: {}",
            self.document.model.title,
            mesh.dim(),
            counted(mesh.cell_count(), "cell"),
            mesh.face_count(),
            mesh.vertices().len(),
            counted(mesh.data().fractures.len(), "fracture"),
            counted(network.face_count(), "fracture face"),
            self.describe_warps(mesh),
            if units.is_empty() { "none".to_owned() } else { units.join(", ") },
        )
    }

    /// A line on the faces that are not planar, where there are such.
    fn describe_warps(&self, mesh: &Mesh) -> String {
        let planar = self.document.model.mesh.planarity();
        let mut bent: Vec<f64> =
            (0..mesh.face_count()).map(|face| mesh.warp(face)).filter(|&w| w > ROUND_OFF).collect();
        bent.sort_by(f64::total_cmp);
        let Some(worst) = bent.last().filter(|_| self.document.model.flow.is_some()) else { return String::new() };
        let split = bent.len() - bent.partition_point(|&warp| warp <= planar);
        let faces = if bent.len() == 1 { "1 face is".to_owned() } else { format!("{} faces are", bent.len()) };
        format!(
            "\n{faces} not planar, by up to {worst:.1e} of the diameter; flow splits {split} of them into triangles, those \
             beyond {planar:e} (mesh.planarity)"
        )
    }
}

pub(crate) fn as_strs(list: &[String]) -> Vec<&str> {
    list.iter().map(String::as_str).collect()
}

fn grdecl(grid: &CornerPoint) -> Grdecl {
    let (regions, names) = grid.regions.clone().map_or_else(Default::default, |r| (Some(r.keyword), r.names));
    Grdecl { section: grid.section, elevation: grid.elevation.0, regions, names, faults: grid.faults.clone() }
}

fn find(path: &Path) -> Result<PathBuf, CliError> {
    const FILE: &str = "model.toml";
    if path.is_file() && path.file_name().is_some_and(|name| name == FILE) {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
        return Ok(folder.unwrap_or(Path::new(".")).to_owned());
    }
    let folders = [path.to_owned(), Path::new("models").join(path)];
    if let Some(folder) = folders.iter().find(|folder| folder.join(FILE).is_file()) {
        return Ok(folder.clone());
    }
    // They are one where the path is absolute.
    let mut looked: Vec<PathBuf> = folders.iter().map(|folder| folder.join(FILE)).collect();
    looked.dedup();
    Err(CliError::NoModel { name: path.display().to_string(), looked })
}

/// A change with its value in quotes where it is no TOML without them, as shells take them from words and expressions.
fn quoted(change: &str) -> String {
    let is_toml = |text: &str| text.parse::<toml::Table>().is_ok();
    let with_quotes = |(key, value): (&str, &str)| {
        let value = value.trim();
        let is_bare = !value.is_empty() && !value.starts_with(['[', '{', '"', '\'']);
        is_bare.then(|| format!("{key}=\"{value}\"")).filter(|text| is_toml(text))
    };
    let quoted = if is_toml(change) { None } else { change.split_once('=').and_then(with_quotes) };
    quoted.unwrap_or_else(|| change.to_owned())
}

#[cfg(test)]
mod tests {
    use super::quoted;

    #[test]
    fn what_is_no_toml_gets_quotes() {
        assert_eq!(quoted("coupling.split=drained"), "coupling.split=\"drained\"");
        assert_eq!(quoted("time.end= 20*day"), "time.end=\"20*day\"");
        for change in [
            "time.step=50",
            "a=true",
            "a=nan",
            "a='b'",
            "coupling.acceleration.iqn_ils={}",
            "a=",
            "a",
            "a=[b",
            "a=b\"c",
        ] {
            assert_eq!(quoted(change), change);
        }
    }
}
