//! What can be wrong with a model.

use std::fmt;
use std::path::PathBuf;

/// Where something stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The file, or the change on the command line.
    pub source: String,
    /// From 1.
    pub line: usize,
    /// From 1, in characters.
    pub column: usize,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}", self.source, self.line, self.column)
    }
}

/// One thing that is wrong with a model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Path of the key, such as `regions.rock.young_modulus`; empty for the whole file.
    pub key: String,
    /// Where it stands; `None` where it is left out altogether.
    pub place: Option<Place>,
    /// What is wrong, and what is allowed.
    pub message: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(place) = &self.place {
            write!(f, "{place}: ")?;
        }
        if !self.key.is_empty() {
            write!(f, "{}: ", self.key)?;
        }
        f.write_str(&self.message)
    }
}

/// Everything that is wrong with a model, in the order of the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problems(pub Vec<Problem>);

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let n = self.0.len();
        write!(f, "the model has {n} problem{}:", if n == 1 { "" } else { "s" })?;
        self.0.iter().try_for_each(|problem| write!(f, "\n  {problem}"))
    }
}

impl std::error::Error for Problems {}

/// Why there is no model or no mesh.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The description is wrong.
    #[error(transparent)]
    Invalid(#[from] Problems),
    /// A file cannot be read.
    #[error("{} cannot be read: {error}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// The mesh cannot be made.
    #[error("{place}: the mesh cannot be made: {error}")]
    Generator {
        /// The entry of the model that asks for it, with its place.
        place: String,
        /// What is wrong with it.
        error: mesh::generate::InputError,
    },
    /// The mesh is not sound.
    #[error("{place}: {error}")]
    Mesh {
        /// The entry of the model that made it, with its place, or the file that it was read from.
        place: String,
        /// What is wrong with it.
        error: mesh::MeshError,
    },
    /// The reader of mesh files refused.
    #[error("the mesh cannot be read: {reason}")]
    MeshFile {
        /// The file.
        path: PathBuf,
        /// The file and why.
        reason: String,
    },
}
