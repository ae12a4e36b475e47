//! Why a command fails.

use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use model::ModelError;
use orchestrator::CouplingError;
use orchestrator::fmi::FmuError;
use orchestrator::results::ResultsError;

/// Why a command fails.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CliError {
    /// The model is wrong.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// No such model.
    #[error("there is no model \"{name}\"; looked for {}", list(looked))]
    NoModel { name: String, looked: Vec<PathBuf> },
    /// The model lacks what the command needs.
    #[error("{0}")]
    Unfit(String),
    /// What packing needs is not there.
    #[error(
        "the units cannot be packed: {} not in {}, where this program is (cargo build -p mechanics-unit -p flow-unit \
         makes them)",
        names.join(", "), folder.display()
    )]
    NoUnits { folder: PathBuf, names: Vec<String> },
    /// A program that packs a unit failed.
    #[error("{} failed: {reason}", program.display())]
    Pack { program: PathBuf, reason: String },
    /// An FMU cannot be loaded.
    #[error(transparent)]
    Fmu(#[from] FmuError),
    /// The coupling stopped.
    #[error("{error}{places}{left}")]
    Coupling { error: CouplingError, places: String, left: String },
    /// The results cannot be written or read.
    #[error("{error}{hint}")]
    Results { error: ResultsError, hint: &'static str },
    /// The operating system refused.
    #[error("{}: {error}", path.display())]
    File { path: PathBuf, error: io::Error },
    /// Standard output is closed.
    #[error("standard output: {0}")]
    Output(io::Error),
    /// A mesh cannot be written.
    #[error(transparent)]
    Mesh(#[from] mesh_io::FileError),
}

impl CliError {
    pub(crate) fn file(path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |error| Self::File { path: path.to_owned(), error }
    }

    pub(crate) fn code(&self) -> ExitCode {
        match self {
            Self::Model(_) | Self::NoModel { .. } | Self::Unfit(_) => ExitCode::from(2),
            _ => ExitCode::FAILURE,
        }
    }
}

impl From<CouplingError> for CliError {
    fn from(error: CouplingError) -> Self {
        Self::Coupling { error, places: String::new(), left: String::new() }
    }
}

impl From<ResultsError> for CliError {
    fn from(error: ResultsError) -> Self {
        let hint = match error {
            ResultsError::Exists(_) => "; --output names another folder, --overwrite replaces earlier results",
            _ => "",
        };
        Self::Results { error, hint }
    }
}

fn list(paths: &[PathBuf]) -> String {
    paths.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(" and ")
}
