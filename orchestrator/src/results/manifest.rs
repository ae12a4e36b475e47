//! What it takes to repeat a run.

use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use mesh::Mesh;
use model::{Document, Plot};
use serde::{Deserialize, Serialize};

use super::ResultsError;
use crate::interface::Interface;

/// Version of the folder's layout.
const VERSION: u32 = 1;

/// What it takes to repeat a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of the folder's layout.
    pub version: u32,
    /// Name and version of the program.
    pub program: String,
    /// The command with its arguments.
    pub command: Vec<String>,
    /// Date and time (UTC).
    pub started: String,
    /// The units, in the order of their numbers.
    pub units: Vec<UnitVersion>,
    /// The fields that they exchange, in the order of the interface.
    pub fields: Vec<Quantity>,
    /// How the run was adapted to its units.
    #[serde(default)]
    pub notes: Vec<String>,
    /// The model.
    pub model: ModelSource,
    /// The mesh.
    pub mesh: MeshNumbers,
    /// Plots to draw; none: all for which there are data, but profiles.
    pub plots: Vec<Plot>,
}

/// A unit that took part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnitVersion {
    /// Its name, for tables and plots.
    pub name: String,
    /// What it says of its version and the tool that made it.
    pub version: String,
}

/// A name and a unit of measure.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Quantity {
    /// Its name.
    pub name: String,
    /// Its unit of measure.
    pub unit: String,
}

/// A model as it was run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModelSource {
    /// What it was called on the command line.
    pub name: String,
    /// Its title.
    pub title: String,
    /// Its description.
    pub description: String,
    /// Variants laid over it.
    pub variants: Vec<String>,
    /// Changes laid over it, pieces of TOML.
    pub changes: Vec<String>,
    /// The model with all of them.
    pub toml: String,
}

/// Size and identity of a mesh.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MeshNumbers {
    /// 2 or 3.
    pub dimension: usize,
    /// Number of cells.
    pub cells: usize,
    /// Number of faces, those of fractures included.
    pub faces: usize,
    /// Number of vertices.
    pub vertices: usize,
    /// Names of the fractures, and the number of their faces.
    pub fractures: Vec<(String, usize)>,
    /// [`Mesh::fingerprint`].
    pub fingerprint: String,
}

impl MeshNumbers {
    /// Those of a mesh.
    pub fn of(mesh: &Mesh) -> Self {
        let count = |i| mesh.network().fracture.iter().filter(|&&f| f == i).count();
        let fractures = mesh.data().fractures.iter().enumerate().map(|(i, name)| (name.clone(), count(i)));
        Self {
            dimension: mesh.dim(),
            cells: mesh.cell_count(),
            faces: mesh.face_count(),
            vertices: mesh.vertices().len(),
            fractures: fractures.collect(),
            fingerprint: mesh.fingerprint(),
        }
    }

    /// Number of fracture faces.
    pub fn fracture_faces(&self) -> usize {
        self.fractures.iter().map(|(_, faces)| faces).sum()
    }
}

impl Manifest {
    /// That of this program, called as it was, now. `name`, `variants` and `changes` are those the model was read with.
    pub fn new(
        name: &str,
        document: &Document,
        variants: &[&str],
        changes: &[&str],
        mesh: &Mesh,
        interface: &Interface,
        units: Vec<UnitVersion>,
    ) -> Self {
        let model = &document.model;
        let owned = |list: &[&str]| list.iter().map(|&text| text.to_owned()).collect();
        let quantity = |f: &crate::Field| Quantity { name: f.name.clone(), unit: f.unit.clone() };
        Self {
            version: VERSION,
            program: concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).into(),
            command: std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect(),
            started: date(SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())),
            units,
            fields: interface.fields.iter().map(quantity).collect(),
            notes: Vec::new(),
            model: ModelSource {
                name: name.to_owned(),
                title: model.title.clone(),
                description: model.description.clone(),
                variants: owned(variants),
                changes: owned(changes),
                toml: document.to_toml(),
            },
            mesh: MeshNumbers::of(mesh),
            plots: model.output.plots.clone(),
        }
    }

    /// Reads `manifest.json`.
    ///
    /// # Errors
    /// [`ResultsError::Io`], [`ResultsError::Damaged`].
    pub fn read(path: &Path) -> Result<Self, ResultsError> {
        let text = std::fs::read_to_string(path).map_err(ResultsError::io(path))?;
        let manifest: Self = serde_json::from_str(&text).map_err(|error| ResultsError::damaged(path, error))?;
        if manifest.version != VERSION {
            let reason = format!("version {}; this program reads version {VERSION}", manifest.version);
            return Err(ResultsError::damaged(path, reason));
        }
        Ok(manifest)
    }

    /// As JSON.
    pub(crate) fn to_json(&self) -> String {
        // Text and whole numbers only: it cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}

/// Date and time (UTC) from seconds since 1970: days to civil dates after Hinnant, chrono-compatible date algorithms.
pub(crate) fn date(seconds: u64) -> String {
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    // Years start in March, so that the leap day is the last; eras have 400 years.
    let shifted = days + 719_468;
    let (era, day) = (shifted / 146_097, shifted % 146_097);
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = year + 400 * era + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}Z", rest / 3600, rest / 60 % 60, rest % 60)
}
