//! The description of a case, `models/NAME/model.toml`, with its types, checks and mesh.
//!
//! - [`Document::read`] turns text into a [`Model`], with named variants and changes laid over it, and reports
//!   everything that is wrong at once: line and column, path of the key, what is allowed.
//! - [`Value`]s are numbers or expressions of position, time and names ([`Model::function`]); all units are SI.
//! - [`Document::mesh`] makes the mesh and checks that names fit it.
//! - [`schema`] gives the JSON schema of the file, for editors.
//!
//! Orchestrator and units share it: each takes its part of a model. It knows neither FMI nor the numerics.

mod check;
pub mod closed;
mod description;
mod document;
mod error;
mod expression;
mod meshing;
mod value;

use std::path::Path;

pub use check::FIELDS;
pub use description::*;
pub use document::Document;
pub use error::{ModelError, Place, Problem, Problems};
pub use expression::{ExpressionError, Function, Point, Scope, Variable};
pub use meshing::{ReadMesh, TipDistances};
pub use value::{Coordinates, Number, Numbers, Tensor, Value};

impl Document {
    /// Reads `model.toml` in a folder; see [`Document::read`].
    ///
    /// # Errors
    /// [`ModelError::File`], and those of [`Document::read`].
    pub fn load(folder: &Path, variants: &[&str], changes: &[&str]) -> Result<Self, ModelError> {
        let path = folder.join("model.toml");
        match std::fs::read_to_string(&path) {
            Ok(text) => Self::read(&path.display().to_string(), &text, variants, changes),
            Err(error) => Err(ModelError::File { path, error }),
        }
    }
}

/// The JSON schema of `model.toml`.
pub fn schema() -> String {
    let schema = schemars::schema_for!(Model);
    format!("{:#}\n", schema.as_value())
}
