//! What can go wrong with files.

use std::path::{Path, PathBuf};

/// What went wrong with a file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FileError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Its reason.
        source: std::io::Error,
    },
    /// The file is no HDF5, or is damaged.
    #[error("{}: {entry}: {source}", path.display())]
    Hdf5 {
        /// The file.
        path: PathBuf,
        /// The dataset, group or attribute.
        entry: String,
        /// Its reason.
        source: Box<hdf5_pure::Error>,
    },
    /// The file is of another version of the format.
    #[error("{}: version {found} of the format; this program reads version {supported}", path.display())]
    Version {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: String,
        /// The version that can be read.
        supported: &'static str,
    },
    /// An entry does not have the form it must have.
    #[error("{}: {entry}: {problem}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// The dataset or section.
        entry: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A text is not what it must be.
    #[error("{}: {} problem{}:{}", path.display(), problems.len(), if problems.len() == 1 { "" } else { "s" }, listed(problems))]
    Problems {
        /// The file.
        path: PathBuf,
        /// All that is wrong, each with line and keyword.
        problems: Vec<String>,
    },
    /// The grid in a file cannot be made a mesh.
    #[error("{}: {source}", path.display())]
    Grid {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: mesh::generate::InputError,
    },
    /// A field to be written has not one value for each entity.
    #[error("field \"{name}\" has {found} values; there are {expected} {entity}")]
    FieldLength {
        /// Name of the field.
        name: String,
        /// What it lives on.
        entity: &'static str,
        /// Number of its values.
        found: usize,
        /// Number of entities.
        expected: usize,
    },
}

impl FileError {
    pub(crate) fn content(path: &Path, entry: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Content { path: path.into(), entry: entry.into(), problem: problem.into() }
    }

    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        |source| Self::Io { path, source }
    }
}

fn listed(problems: &[String]) -> String {
    problems.iter().map(|problem| format!("\n  {problem}")).collect()
}

/// Lets `write` make a file under a temporary name beside `path`, then moves it there: whoever looks finds the old
/// file, the new one, or none, but never a part.
pub(crate) fn replace(path: &Path, write: impl FnOnce(&Path) -> Result<(), FileError>) -> Result<(), FileError> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let part = path.with_file_name(name);
    let result = write(&part).and_then(|()| std::fs::rename(&part, path).map_err(FileError::io(path)));
    if result.is_err() {
        // The error is what matters; the part may not even exist.
        let _ = std::fs::remove_file(&part);
    }
    result
}
