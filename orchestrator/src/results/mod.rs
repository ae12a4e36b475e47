//! What a run leaves in its folder.
//!
//! | file | written | content |
//! |---|---|---|
//! | `manifest.json` | at the start | versions, model, mesh, command: what it takes to repeat the run ([`Manifest`]) |
//! | `mesh.h5` | at the start | the mesh ([`mesh_io::write_hdf5`]) |
//! | `journal` | each time step | every time step, to the last bit: what all that follows is made from |
//! | `checkpoint` | when the caller says | what the caller needs to go on |
//! | `series.csv` | each time step | all scalars against time |
//! | `attempts.csv`, `iterations.csv`, `timings.csv` | each time step | attempts, coupling iterations, their seconds |
//! | `fields/` | output times | cells and fracture faces for ParaView: open `matrix.pvd`, `fractures.pvd` |
//! | `run.h5` | at the end | all of it in HDF5 (layout: see the source of `results/hdf5.rs`) |
//! | `plots/` | at the end | SVG |
//! | `summary.json` | at the end | outcome and counts |
//! | `index.html` | at the end | a page with all this, in one piece |
//!
//! Nothing is lost when the process is killed: an entry of the journal counts once it is complete on the disk, and all else
//! can be made from the entries. Whole files are written under temporary names and moved. [`Folder::reopen`] drops what
//! lies beyond the time step that a run goes on from, so that afterwards all files are those of a run that was not
//! interrupted, but for `timings.csv` and the other records of wall time.

pub(crate) mod chart;
mod error;
mod fields;
pub(crate) mod files;
pub(crate) mod hdf5;
mod journal;
mod manifest;
pub(crate) mod page;
pub(crate) mod plots;
pub(crate) mod tables;
#[cfg(test)]
mod tests;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use mesh::Mesh;
use serde::{Deserialize, Serialize};

pub use error::ResultsError;
pub use manifest::{Manifest, MeshNumbers, ModelSource, Quantity, UnitVersion};

use crate::cost::Cost;
use crate::energy::EnergyEstimate;
use crate::record::{Failure, StepRecord};
use fields::Fields;
use journal::{Entries, Entry, Journal};
use tables::Tables;

const MANIFEST: &str = "manifest.json";
const JOURNAL: &str = "journal";
const CHECKPOINT: &str = "checkpoint";
const MESH: &str = "mesh.h5";
const PAGE: &str = "index.html";
const PLOTS: &str = "plots";
const RUN: &str = "run.h5";
const SUMMARY: &str = "summary.json";

/// A number at a time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scalar {
    /// Its name, as `aperture.mean`.
    pub name: String,
    /// Its unit of measure.
    pub unit: String,
    /// Its value.
    pub value: f64,
}

impl Scalar {
    /// Of its parts.
    pub fn new(name: impl Into<String>, unit: impl Into<String>, value: f64) -> Self {
        Self { name: name.into(), unit: unit.into(), value }
    }
}

/// What an array lives on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Shape {
    /// Cells.
    Cells,
    /// Fracture faces, in the order of [`mesh::Network::faces`].
    FractureFaces,
    /// Fracture faces × dimension: normal and tangential parts in the basis of each face, n⁺ and [`mesh::tangents`].
    FractureVectors,
    /// Cells × dimension: components in space.
    CellVectors,
}

impl Shape {
    /// Whether it lives on cells.
    pub fn is_on_cells(self) -> bool {
        matches!(self, Self::Cells | Self::CellVectors)
    }

    /// Number of values for each cell or fracture face, in `dim` dimensions.
    pub fn columns(self, dim: usize) -> usize {
        match self {
            Self::Cells | Self::FractureFaces => 1,
            Self::CellVectors | Self::FractureVectors => dim,
        }
    }

    /// Number of values on a mesh.
    pub fn length(self, mesh: &Mesh) -> usize {
        let entities = if self.is_on_cells() { mesh.cell_count() } else { mesh.network().face_count() };
        entities * self.columns(mesh.dim())
    }
}

/// A field at a time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Array {
    /// Its name, as `matrix.pressure`. Contact states are `fracture.contact_state`: 0 open, 1 stick, 2 slip.
    pub name: String,
    /// Its unit of measure.
    pub unit: String,
    /// What it lives on.
    pub shape: Shape,
    /// Its values; vectors one behind the other.
    pub values: Vec<f64>,
}

impl Array {
    /// Of its parts.
    pub fn new(name: impl Into<String>, unit: impl Into<String>, shape: Shape, values: Vec<f64>) -> Self {
        Self { name: name.into(), unit: unit.into(), shape, values }
    }
}

/// The state at the end of a time step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    /// Time (s).
    pub time: f64,
    /// The same ones, in the same order, in all snapshots of a run.
    pub scalars: Vec<Scalar>,
    /// At output times all fields; at other times none.
    pub arrays: Vec<Array>,
}

/// How a run ended, and what only its caller knows.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Why the run stopped before its end.
    pub failure: Option<Failure>,
    /// Wall seconds of its parts, as `packing`, `coupling`. Those in each unit and in output are added.
    pub seconds: Vec<(String, f64)>,
    /// Where that of each unit went, since this process made it.
    pub units: Vec<Cost>,
}

/// The folder of a run, open to be written to.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
    manifest: Manifest,
    mesh: Mesh,
    journal: Journal,
    tables: Tables,
    fields: Fields,
    /// Names and units of the scalars.
    scalars: Vec<(String, String)>,
    last: usize,
    /// After the time steps that were there when the folder was opened.
    energy: EnergyEstimate,
    seconds: f64,
}

impl Folder {
    /// Makes a folder with the state at the start. Until it is complete it has another name, `path` with `.part`. With
    /// `overwrite`, the results of another run give way to it.
    ///
    /// # Errors
    /// [`ResultsError::Exists`] where there is something at `path`; with `overwrite` [`ResultsError::Foreign`] where
    /// that is not the results of a run, and [`ResultsError::InUse`]; [`ResultsError::Content`] for a snapshot that does
    /// not fit the mesh; those of files.
    pub fn create(
        path: impl AsRef<Path>,
        manifest: &Manifest,
        mesh: Mesh,
        start: &Snapshot,
        overwrite: bool,
    ) -> Result<Self, ResultsError> {
        let clock = Instant::now();
        let path = path.as_ref();
        let occupied = !is_free(path)?;
        if occupied {
            if !overwrite {
                return Err(ResultsError::Exists(path.into()));
            }
            if !path.join(MANIFEST).is_file() || !path.join(JOURNAL).is_file() {
                return Err(ResultsError::Foreign(path.into()));
            }
            // Fails where it is in use.
            Journal::probe(&path.join(JOURNAL))?;
        }
        let beside = |end: &str| {
            let mut name = path.as_os_str().to_owned();
            name.push(end);
            PathBuf::from(name)
        };
        let [part, old] = [files::PART, ".old"].map(beside);
        let left_over = [MANIFEST, "manifest.json.part"].iter().any(|name| part.join(name).is_file());
        if left_over {
            fs::remove_dir_all(&part).map_err(ResultsError::io(&part))?;
        } else if !is_free(&part)? {
            return Err(ResultsError::Foreign(part));
        }
        let filled = Self::fill(&part, manifest, mesh, start);
        if filled.is_err() {
            // The error is what matters; the part may not even exist.
            let _ = fs::remove_dir_all(&part);
        }
        let mut folder = filled?;
        if occupied {
            fs::rename(path, &old).map_err(ResultsError::io(path))?;
        }
        fs::rename(&part, path).map_err(ResultsError::io(path))?;
        files::sync_folder(path.parent().unwrap_or(path))?;
        folder.path = path.into();
        folder.journal.moved_to(path.join(JOURNAL));
        folder.tables.moved_to(path);
        if occupied {
            fs::remove_dir_all(&old).map_err(ResultsError::io(&old))?;
        }
        folder.seconds = clock.elapsed().as_secs_f64();
        Ok(folder)
    }

    fn fill(path: &Path, manifest: &Manifest, mesh: Mesh, start: &Snapshot) -> Result<Self, ResultsError> {
        let scalars = names(start);
        let record = StepRecord { number: 0, time: start.time, attempts: Vec::new() };
        check(manifest, &mesh, &scalars, &record, start)?;
        fs::create_dir_all(path).map_err(ResultsError::io(path))?;
        files::replace(&path.join(MANIFEST), manifest.to_json().as_bytes())?;
        mesh_io::write_hdf5(path.join(MESH), mesh.data())?;
        fs::create_dir_all(path.join(fields::FOLDER)).map_err(ResultsError::io(path))?;
        let mut journal = Journal::create(&path.join(JOURNAL))?;
        journal.append(&record, start)?;
        let mut fields = Fields::default();
        fields.write(path, &mesh, 0, start)?;
        let tables = Tables::create(path, manifest, start, &tables::rows(&record, start))?;
        let manifest = manifest.clone();
        let energy = EnergyEstimate::default();
        Ok(Self { path: path.into(), manifest, mesh, journal, tables, fields, scalars, last: 0, energy, seconds: 0.0 })
    }

    /// Opens a folder to go on after time step number `last`, or after the last that is complete: drops what lies
    /// beyond, and makes tables and fields anew. What is made at the end is removed until [`finish`](Self::finish).
    ///
    /// # Errors
    /// [`ResultsError::Incomplete`] where the journal does not get that far, [`ResultsError::InUse`],
    /// [`ResultsError::Damaged`], those of files.
    pub fn reopen(path: impl AsRef<Path>, last: Option<usize>) -> Result<Self, ResultsError> {
        let clock = Instant::now();
        let path = path.as_ref();
        if !path.join(MANIFEST).is_file() {
            return Err(ResultsError::Foreign(path.to_owned()));
        }
        let manifest = Manifest::read(&path.join(MANIFEST))?;
        let file = path.join(MESH);
        let mesh = Mesh::new(mesh_io::read_hdf5(&file)?).map_err(|error| ResultsError::damaged(&file, error))?;
        if mesh.fingerprint() != manifest.mesh.fingerprint {
            return Err(ResultsError::damaged(&file, "its fingerprint is not that of the manifest"));
        }
        let mut rows = <[String; 4]>::default();
        let (mut start, mut reached) = (None, 0);
        let mut fields = Fields::default();
        let mut energy = EnergyEstimate::default();
        let journal = Journal::reopen(&path.join(JOURNAL), last, |entry| {
            tables::add(&mut rows, &entry);
            reached = entry.record.number;
            let Entry { snapshot, .. } = entry;
            energy.see(&snapshot.scalars);
            fields.write(path, &mesh, reached, &snapshot)?;
            start.get_or_insert(snapshot);
            Ok(())
        })?;
        let start = start.ok_or_else(|| ResultsError::damaged(&path.join(JOURNAL), "it has no start"))?;
        files::remove(path, |name| [PAGE, RUN, SUMMARY].contains(&name) || name.ends_with(files::PART))?;
        if path.join(PLOTS).is_dir() {
            files::remove(&path.join(PLOTS), |file| file.ends_with(".svg"))?;
        }
        fields.remove_others(path)?;
        let tables = Tables::create(path, &manifest, &start, &rows)?;
        Ok(Self {
            path: path.into(),
            manifest,
            mesh,
            journal,
            tables,
            fields,
            scalars: names(&start),
            last: reached,
            energy,
            seconds: clock.elapsed().as_secs_f64(),
        })
    }

    /// Number of the last time step in the folder; 0 at the start.
    pub fn last(&self) -> usize {
        self.last
    }

    /// The energy estimate, to go on with after [`reopen`](Self::reopen).
    pub fn energy(&self) -> &EnergyEstimate {
        &self.energy
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What the run is.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The mesh.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// Wall seconds that were spent here.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Records an accepted time step. When this returns, it is on the disk.
    ///
    /// # Errors
    /// [`ResultsError::Content`] where the time step is not the next one, or scalars and arrays are not those they must be;
    /// [`ResultsError::Io`].
    pub fn append(&mut self, record: &StepRecord, snapshot: &Snapshot) -> Result<(), ResultsError> {
        let clock = Instant::now();
        if record.number != self.last + 1 {
            let reason = format!("the one after {} is expected", self.last);
            return Err(ResultsError::Content { number: record.number, reason });
        }
        check(&self.manifest, &self.mesh, &self.scalars, record, snapshot)?;
        self.journal.append(record, snapshot)?;
        self.last = record.number;
        self.tables.append(&tables::rows(record, snapshot))?;
        self.fields.write(&self.path, &self.mesh, record.number, snapshot)?;
        self.seconds += clock.elapsed().as_secs_f64();
        Ok(())
    }

    /// Replaces the checkpoint, in one move.
    ///
    /// # Errors
    /// [`ResultsError::Io`]; the previous checkpoint then stays.
    pub fn checkpoint(&mut self, bytes: &[u8]) -> Result<(), ResultsError> {
        let clock = Instant::now();
        files::replace(&self.path.join(CHECKPOINT), bytes)?;
        self.seconds += clock.elapsed().as_secs_f64();
        Ok(())
    }

    /// The last checkpoint in a folder; `None` before the first.
    ///
    /// # Errors
    /// [`ResultsError::Io`].
    pub fn read_checkpoint(path: impl AsRef<Path>) -> Result<Option<Vec<u8>>, ResultsError> {
        let path = path.as_ref().join(CHECKPOINT);
        match fs::read(&path) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(ResultsError::Io { path, source }),
        }
    }

    /// Writes what is made at the end: `run.h5`, plots, summary and page. Gives the path of the page.
    ///
    /// # Errors
    /// Those of files and of drawing.
    pub fn finish(&mut self, summary: &Summary) -> Result<PathBuf, ResultsError> {
        let clock = Instant::now();
        let journal = self.path.join(JOURNAL);
        hdf5::write(&self.path.join(RUN), &self.manifest, Entries::open(&journal)?)?;
        let history = plots::History::read(&journal)?;
        let plots = plots::draw(&self.manifest, &self.mesh, &history, summary.failure.as_ref())?;
        let folder = self.path.join(PLOTS);
        fs::create_dir_all(&folder).map_err(ResultsError::io(&folder))?;
        files::remove(&folder, |name| name.ends_with(".svg"))?;
        for plot in &plots {
            files::replace(&folder.join(&plot.name).with_extension("svg"), plot.svg.as_bytes())?;
        }
        let totals = page::Totals::new(&self.manifest, &history, summary, self.seconds + clock.elapsed().as_secs_f64());
        files::replace(&self.path.join(SUMMARY), totals.to_json(summary).as_bytes())?;
        let page = self.path.join(PAGE);
        files::replace(&page, page::page(&self.manifest, &history, &totals, summary, &plots).as_bytes())?;
        self.seconds += clock.elapsed().as_secs_f64();
        Ok(page)
    }
}

/// Whether there is nothing at a path, or an empty folder.
fn is_free(path: &Path) -> Result<bool, ResultsError> {
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(true),
        Err(source) => Err(ResultsError::Io { path: path.into(), source }),
        Ok(metadata) if !metadata.is_dir() => Ok(false),
        Ok(_) => Ok(fs::read_dir(path).map_err(ResultsError::io(path))?.next().is_none()),
    }
}

fn names(snapshot: &Snapshot) -> Vec<(String, String)> {
    snapshot.scalars.iter().map(|s| (s.name.clone(), s.unit.clone())).collect()
}

/// Whether a time step fits the run.
fn check(
    manifest: &Manifest,
    mesh: &Mesh,
    scalars: &[(String, String)],
    record: &StepRecord,
    snapshot: &Snapshot,
) -> Result<(), ResultsError> {
    let fail = |reason| Err(ResultsError::Content { number: record.number, reason });
    if names(snapshot) != scalars {
        return fail("its scalars are not those of the start".into());
    }
    let mut residuals = record.attempts.iter().flat_map(|a| &a.iterations).map(|i| i.residuals.len());
    if let Some(found) = residuals.find(|&n| n != manifest.fields.len()) {
        return fail(format!("there are {found} residuals for {} coupled fields", manifest.fields.len()));
    }
    let units = manifest.units.len();
    if record.attempts.iter().flat_map(|a| &a.iterations).any(|i| [i.seconds.len(), i.newton.len()] != [units; 2]) {
        return fail(format!("there are not {units} seconds and Newton iterations for the units"));
    }
    for array in &snapshot.arrays {
        let (found, expected) = (array.values.len(), array.shape.length(mesh));
        if found != expected {
            return fail(format!("\"{}\" has {found} values; there must be {expected}", array.name));
        }
    }
    Ok(())
}
