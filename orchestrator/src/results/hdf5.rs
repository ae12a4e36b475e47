//! A run in HDF5.
//!
//! | entry | type | shape | meaning |
//! |---|---|---|---|
//! | attribute `version` | u32 | scalar | version of this layout, 1 |
//! | attribute `manifest` | text | scalar | what `manifest.json` holds |
//! | `series/time_step`, `series/time` | i64, f64 | entries | number of the time step, 0 at the start; time (s) |
//! | `series/NAME` | f64 | entries | a scalar, such as `series/aperture.mean` |
//! | `attempts/time_step`, `…/attempt`, `…/iterations` | i64 | attempts | keys; number of coupling iterations |
//! | `attempts/step` | f64 | attempts | δt (s) |
//! | `attempts/outcome` | i64 | attempts | attribute `outcomes` names them, separated by commas |
//! | `iterations/time_step`, `…/attempt`, `…/iteration` | i64 | iterations | keys |
//! | `iterations/FIELD/residual`, `…/limit` | f64 | iterations | norm, and what it must not exceed (unit of the field) |
//! | `iterations/FIELD/ratio` | f64 | iterations | residual/limit |
//! | `iterations/FIELD/worst` | i64 | iterations | entry with the largest residual, −1 where there is none |
//! | `iterations/UNIT/seconds` | f64 | iterations | wall seconds in the unit |
//! | `iterations/UNIT/newton_iterations` | i64 | iterations | −1 where the unit does not tell |
//! | `iterations/derivatives` | i64 | iterations | directional derivatives of each unit taken after it |
//! | `fields/NUMBER/NAME` | f64 | any, or × components | a field after that time step; attribute `time` (s) on the group |
//!
//! Datasets with a unit of measure have it as attribute `unit`. The mesh is in `mesh.h5`.

use std::path::Path;

use hdf5_metno::types::VarLenUnicode;
use hdf5_metno::{Dataset, File, Group, H5Type, Location, Result as Hdf5Result};

use super::journal::{Entries, Entry};
use super::{Manifest, ResultsError, files, tables};
use crate::record::{AttemptOutcome, IterationRecord, StepRecord};

const VERSION: u32 = 1;
const OUTCOMES: [&str; 5] = ["converged", "not_converged", "diverged", "not_finite", "discarded"];

/// Makes the file from a journal; fields pass through one at a time.
pub(crate) fn write(path: &Path, manifest: &Manifest, entries: Entries) -> Result<(), ResultsError> {
    let refused = |source| ResultsError::Hdf5 { path: path.into(), source };
    files::replace_with(path, |part| {
        let file = File::with_options().with_fapl(|access| access.libver_v110()).create(part).map_err(refused)?;
        let fields = file.create_group("fields").map_err(refused)?;
        let mut rest = Vec::new();
        for entry in entries {
            let mut entry = entry?;
            put_fields(&fields, manifest.mesh.dimension, &entry).map_err(refused)?;
            entry.snapshot.arrays.clear();
            rest.push(entry);
        }
        put_rest(&file, manifest, &rest).and_then(|()| file.close()).map_err(refused)
    })
}

fn put_fields(fields: &Group, dim: usize, entry: &Entry) -> Hdf5Result<()> {
    if entry.snapshot.arrays.is_empty() {
        return Ok(());
    }
    let group = fields.create_group(&format!("{:06}", entry.record.number))?;
    group.new_attr::<f64>().create("time")?.write_scalar(&entry.snapshot.time)?;
    for array in &entry.snapshot.arrays {
        let columns = Some(array.shape.columns(dim)).filter(|&columns| columns > 1);
        let dataset = put(&group, &array.name, &array.values, columns)?;
        text(&dataset, "unit", &array.unit)?;
    }
    Ok(())
}

fn put_rest(file: &File, manifest: &Manifest, entries: &[Entry]) -> Hdf5Result<()> {
    file.new_attr::<u32>().create("version")?.write_scalar(&VERSION)?;
    text(file, "manifest", &manifest.to_json())?;

    let series = file.create_group("series")?;
    integers(&series, "time_step", entries.iter().map(|e| e.record.number))?;
    floats(&series, "time", "s", entries.iter().map(|e| e.snapshot.time))?;
    for (i, scalar) in entries.first().iter().flat_map(|e| &e.snapshot.scalars).enumerate() {
        floats(&series, &scalar.name, &scalar.unit, entries.iter().map(|e| e.snapshot.scalars[i].value))?;
    }

    let attempts = file.create_group("attempts")?;
    let rows =
        || entries.iter().flat_map(|e| (1..).zip(&e.record.attempts).map(|(a, attempt)| (&e.record, a, attempt)));
    integers(&attempts, "time_step", rows().map(|(record, ..)| record.number))?;
    integers(&attempts, "attempt", rows().map(|(_, a, _)| a))?;
    integers(&attempts, "iterations", rows().map(|(.., attempt)| attempt.iterations.len()))?;
    floats(&attempts, "step", "s", rows().map(|(.., attempt)| attempt.step))?;
    let outcome = put(&attempts, "outcome", &rows().map(|(.., a)| code(&a.outcome)).collect::<Vec<_>>(), None)?;
    text(&outcome, "outcomes", &OUTCOMES.join(","))?;

    let iterations = file.create_group("iterations")?;
    let mut list: Vec<(&StepRecord, usize, usize, &IterationRecord)> = Vec::new();
    for (record, a, attempt) in rows() {
        list.extend((1..).zip(&attempt.iterations).map(|(i, iteration)| (record, a, i, iteration)));
    }
    let rows = list;
    integers(&iterations, "time_step", rows.iter().map(|r| r.0.number))?;
    integers(&iterations, "attempt", rows.iter().map(|r| r.1))?;
    integers(&iterations, "iteration", rows.iter().map(|r| r.2))?;
    integers(&iterations, "derivatives", rows.iter().map(|r| r.3.derivatives))?;
    for (f, field) in manifest.fields.iter().enumerate() {
        let group = iterations.create_group(&field.name)?;
        let residuals = || rows.iter().map(|r| r.3.residuals[f]);
        floats(&group, "residual", &field.unit, residuals().map(|r| r.norm))?;
        floats(&group, "limit", &field.unit, residuals().map(|r| r.limit))?;
        floats(&group, "ratio", "1", residuals().map(|r| r.ratio()))?;
        put(&group, "worst", &residuals().map(|r| r.worst.map_or(-1, |w| w as i64)).collect::<Vec<_>>(), None)?;
    }
    for (u, unit) in manifest.units.iter().enumerate() {
        let group = iterations.create_group(&unit.name)?;
        floats(&group, "seconds", "s", rows.iter().map(|r| r.3.seconds[u]))?;
        let newton: Vec<i64> = rows.iter().map(|r| r.3.newton[u].map_or(-1, |n| n as i64)).collect();
        put(&group, "newton_iterations", &newton, None)?;
    }
    Ok(())
}

fn code(outcome: &AttemptOutcome) -> i64 {
    OUTCOMES.iter().position(|&name| name == tables::outcome(outcome)).map_or(-1, |i| i as i64)
}

pub(crate) fn integers(group: &Group, name: &str, values: impl Iterator<Item = usize>) -> Hdf5Result<Dataset> {
    put(group, name, &values.map(|v| v as i64).collect::<Vec<_>>(), None)
}

pub(crate) fn floats(group: &Group, name: &str, unit: &str, values: impl Iterator<Item = f64>) -> Hdf5Result<()> {
    let dataset = put(group, name, &values.collect::<Vec<_>>(), None)?;
    text(&dataset, "unit", unit)
}

/// Writes values as one dataset, in rows of `columns` where that is given.
pub(crate) fn put<T: H5Type>(group: &Group, name: &str, values: &[T], columns: Option<usize>) -> Hdf5Result<Dataset> {
    let builder = group.new_dataset::<T>();
    let dataset = match columns {
        Some(columns) => builder.shape([values.len() / columns, columns]).create(name)?,
        None => builder.shape([values.len()]).create(name)?,
    };
    if !values.is_empty() {
        dataset.as_writer().write_raw(values)?;
    }
    Ok(dataset)
}

pub(crate) fn text(location: &Location, name: &str, value: &str) -> Hdf5Result<()> {
    let value: VarLenUnicode = value.parse().map_err(|error| hdf5_metno::Error::from(format!("{name}: {error}")))?;
    location.new_attr::<VarLenUnicode>().create(name)?.write_scalar(&value)
}
