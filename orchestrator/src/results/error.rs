//! Why results cannot be written or read.

use std::path::{Path, PathBuf};

/// Why results cannot be written or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ResultsError {
    /// The operating system refused: a full disk, a missing permission.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Its reason.
        source: std::io::Error,
    },
    /// The folder is there and not empty.
    #[error("{} exists and is not empty; it was left as it is", .0.display())]
    Exists(PathBuf),
    /// What should be overwritten does not hold the results of a run.
    #[error("{} does not hold the results of a run; it was left as it is", .0.display())]
    Foreign(PathBuf),
    /// Another process writes to the folder.
    #[error("{} is in use by another process", .0.display())]
    InUse(PathBuf),
    /// A file is not what it should be.
    #[error("{}: {reason}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The journal ends before the time step that the run is to go on from.
    #[error("{} ends before time step {wanted}", path.display())]
    Incomplete {
        /// The journal.
        path: PathBuf,
        /// Number of the time step.
        wanted: usize,
    },
    /// A snapshot or record does not fit the run.
    #[error("time step {number}: {reason}")]
    Content {
        /// Number of the time step.
        number: usize,
        /// What does not fit.
        reason: String,
    },
    /// Mesh or ParaView files.
    #[error(transparent)]
    File(#[from] mesh_io::FileError),
    /// The HDF5 library refused.
    #[error("{}: {source}", path.display())]
    Hdf5 {
        /// The file.
        path: PathBuf,
        /// Its reason.
        source: hdf5_metno::Error,
    },
    /// A plot cannot be drawn.
    #[error("plot \"{plot}\": {reason}")]
    Drawing {
        /// What it shows.
        plot: String,
        /// Why not.
        reason: String,
    },
}

impl ResultsError {
    /// For `map_err`.
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        |source| Self::Io { path: path.into(), source }
    }

    pub(crate) fn damaged(path: &Path, reason: impl ToString) -> Self {
        Self::Damaged { path: path.into(), reason: reason.to_string() }
    }
}
