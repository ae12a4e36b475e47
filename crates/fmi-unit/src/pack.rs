//! Builds an `.fmu` file.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use quick_xml::escape::escape;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use crate::description::Description;
use crate::error::Error;
use crate::instance::{AnyUnit, build, factory, guard};
use crate::token::{files, read};
use crate::unit::{Environment, Log, Unit, Value};
use crate::variables::{Start, TIME, Type, Variable};
use crate::xml::{model_description, terminals_and_icons};

/// Level of compression: three times as quick as the usual one, and the archive a third larger.
const QUICK: i64 = 1;

/// What goes into an FMU besides what the unit says about itself.
#[derive(Clone, Debug, Default)]
pub struct Contents {
    /// The library in which [`export_unit!`](crate::export_unit) was called, for this machine.
    pub library: PathBuf,
    /// A folder that becomes `resources`.
    pub resources: Option<PathBuf>,
    /// A PNG image.
    pub icon: Option<Vec<u8>>,
}

/// Writes the FMU of a unit to `path` and returns its instantiation token.
///
/// The unit is instantiated with the resources; its description is checked, and so is that each
/// variable has the start value that the description declares. The same input gives the same bytes. The
/// file appears under its name only when it is complete.
///
/// # Errors
/// The unit cannot be instantiated, or breaks its description, or a file cannot be read or written.
pub fn pack<U: Unit>(path: &Path, contents: &Contents) -> Result<String, Error> {
    let environment =
        Environment { instance_name: "pack".to_owned(), resources: contents.resources.clone(), log: Log::default() };
    let (mut unit, description, token) = build(factory::<U>, &environment)?;
    guard(|| check_starts(unit.as_mut(), &description))?;

    let mut entries = vec![
        ("modelDescription.xml".to_owned(), model_description(&description, &token).into_bytes()),
        ("documentation/index.html".to_owned(), page(&description).into_bytes()),
        (library_name(&description), read(&contents.library)?),
    ];
    if contents.icon.is_some() || !description.terminals.is_empty() {
        let xml = terminals_and_icons(&description, contents.icon.is_some());
        entries.push(("terminalsAndIcons/terminalsAndIcons.xml".to_owned(), xml.into_bytes()));
    }
    if let Some(icon) = &contents.icon {
        entries.push(("terminalsAndIcons/icon.png".to_owned(), icon.clone()));
    }
    if let Some(folder) = &contents.resources {
        for name in files(folder)? {
            let bytes = read(&folder.join(&name))?;
            entries.push((format!("resources/{name}"), bytes));
        }
    }
    entries.sort();
    write(path, &entries)?;
    Ok(token)
}

/// `binaries/x86_64-linux/NAME.so`
fn library_name(description: &Description) -> String {
    let system = if cfg!(target_os = "macos") { "darwin" } else { std::env::consts::OS };
    let arch = std::env::consts::ARCH;
    format!("binaries/{arch}-{system}/{}.{}", description.identifier, std::env::consts::DLL_EXTENSION)
}

fn write(path: &Path, entries: &[(String, Vec<u8>)]) -> Result<(), Error> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let part = path.with_file_name(name);
    let written = write_entries(&part, entries)
        .and_then(|()| fs::rename(&part, path).map_err(|source| Error::File { path: path.to_owned(), source }));
    if written.is_err() {
        // The first error is the one to report; the file may not even exist.
        let _ = fs::remove_file(&part);
    }
    written
}

fn write_entries(path: &Path, entries: &[(String, Vec<u8>)]) -> Result<(), Error> {
    let failed = |source| Error::File { path: path.to_owned(), source };
    let mut archive = ZipWriter::new(File::create(path).map_err(failed)?);
    for (name, bytes) in entries {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(QUICK))
            .last_modified_time(DateTime::default())
            .unix_permissions(if name.starts_with("binaries/") { 0o755 } else { 0o644 })
            .large_file(bytes.len() > u32::MAX as usize);
        archive.start_file(name.as_str(), options)?;
        archive.write_all(bytes).map_err(failed)?;
    }
    archive.finish()?.sync_all().map_err(failed)
}

fn check_starts(unit: &mut dyn AnyUnit, description: &Description) -> Result<(), Error> {
    description.variables.iter().try_for_each(|variable| check_start(unit, variable))
}

fn check_start(unit: &mut dyn AnyUnit, variable: &Variable) -> Result<(), Error> {
    match (&variable.start, variable.ty) {
        (None, _) => Ok(()),
        (Some(Start::Float(s)), Type::Float32) => same(unit, variable, s, |x| x as f32),
        (Some(Start::Float(s)), _) => same(unit, variable, s, |x| x),
        (Some(Start::Integer(s)), ty) => same_integer(unit, variable, s, ty),
        (Some(Start::Unsigned(s)), Type::UInt64) => same(unit, variable, s, |x| x),
        (Some(Start::Unsigned(s)), ty) => {
            let signed: Vec<_> = s.iter().map(|&x| x as i64).collect();
            same_integer(unit, variable, &signed, ty)
        }
        (Some(Start::Boolean(s)), _) => same(unit, variable, s, |x| x),
        (Some(Start::String(s)), _) => same(unit, variable, s, |x| x),
        (Some(Start::Binary(s)), _) => same(unit, variable, s, |x| x),
    }
}

/// The casts lose nothing: the description has been checked for range.
fn same_integer(unit: &mut dyn AnyUnit, variable: &Variable, start: &[i64], ty: Type) -> Result<(), Error> {
    match ty {
        Type::Int8 => same(unit, variable, start, |x| x as i8),
        Type::UInt8 => same(unit, variable, start, |x| x as u8),
        Type::Int16 => same(unit, variable, start, |x| x as i16),
        Type::UInt16 => same(unit, variable, start, |x| x as u16),
        Type::Int32 => same(unit, variable, start, |x| x as i32),
        Type::UInt32 => same(unit, variable, start, |x| x as u32),
        Type::UInt64 => same(unit, variable, start, |x| x as u64),
        _ => same(unit, variable, start, |x| x),
    }
}

fn same<S: Clone, T: Value + PartialEq + std::fmt::Debug>(
    unit: &mut dyn AnyUnit,
    variable: &Variable,
    start: &[S],
    cast: impl Fn(S) -> T,
) -> Result<(), Error> {
    let mut values = vec![T::default(); variable.size()];
    unit.get(variable.reference, T::wrap_mut(&mut values)).map_err(Error::Unit)?;
    for (i, value) in values.iter().enumerate() {
        let expected = cast(start[i.min(start.len() - 1)].clone());
        // A value that is not equal to itself is NaN, on purpose.
        let both_nan = expected != expected.clone() && *value != value.clone();
        if *value != expected && !both_nan {
            return Err(Error::Contract(format!(
                "variable `{}` starts with {value:?} at element {i}, declared is {expected:?}",
                variable.name
            )));
        }
    }
    Ok(())
}

fn page(description: &Description) -> String {
    let text = &description.documentation;
    let title = escape(description.model_name.as_str());
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head><meta charset=\"utf-8\"><title>{title}</title></head>\n\
         <body>\n<h1>{title}</h1>\n<p>{}</p>\n{text}\n<h2>Variables</h2>\n<table>\n\
         <tr><th>name</th><th>type</th><th>shape</th><th>unit</th><th>causality</th><th>meaning</th></tr>\n",
        escape(description.about.as_str())
    );
    for v in description.all_variables().filter(|v| v.reference != TIME) {
        let shape: Vec<_> = v.dimensions.iter().map(ToString::to_string).collect();
        let ty = v.declared_type.clone().unwrap_or_else(|| format!("{:?}", v.ty));
        let (unit, about) = (v.unit.as_deref().unwrap_or_default(), v.description.as_str());
        let cells = [v.name.as_str(), &ty, &shape.join(" × "), unit, v.causality.name(), about];
        let cells: String = cells.iter().map(|cell| format!("<td>{}</td>", escape(*cell))).collect();
        let _ = writeln!(page, "<tr>{cells}</tr>");
    }
    page.push_str("</table>\n</body>\n</html>\n");
    page
}
