//! Files that are there as a whole or not at all.

use std::fs::{self, File};
use std::io::Write as _;
use std::path::Path;

use super::ResultsError;

/// How names end that are not yet those of files.
pub(crate) const PART: &str = ".part";

/// Lets `write` make a file under a temporary name beside `path`, brings it to the disk and moves it there. Until then
/// the old file stays.
pub(crate) fn replace_with(
    path: &Path,
    write: impl FnOnce(&Path) -> Result<(), ResultsError>,
) -> Result<(), ResultsError> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(PART);
    let part = path.with_file_name(name);
    let finish = || {
        File::open(&part).and_then(|file| file.sync_all()).map_err(ResultsError::io(&part))?;
        fs::rename(&part, path).map_err(ResultsError::io(path))
    };
    let result = write(&part).and_then(|()| finish());
    if result.is_err() {
        // The error is what matters; the part may not even exist.
        let _ = fs::remove_file(&part);
    }
    result.and_then(|()| sync_folder(path.parent().unwrap_or(path)))
}

/// [`replace_with`] of bytes.
pub(crate) fn replace(path: &Path, bytes: &[u8]) -> Result<(), ResultsError> {
    replace_with(path, |part| {
        File::create(part).and_then(|mut file| file.write_all(bytes)).map_err(ResultsError::io(path))
    })
}

/// Brings the names in a folder to the disk.
pub(crate) fn sync_folder(path: &Path) -> Result<(), ResultsError> {
    let path = if path.as_os_str().is_empty() { Path::new(".") } else { path };
    File::open(path).and_then(|folder| folder.sync_all()).map_err(ResultsError::io(path))
}

/// Removes the files of a folder whose name satisfies `which`.
pub(crate) fn remove(folder: &Path, which: impl Fn(&str) -> bool) -> Result<(), ResultsError> {
    for entry in fs::read_dir(folder).map_err(ResultsError::io(folder))? {
        let path = entry.map_err(ResultsError::io(folder))?.path();
        if path.is_file() && path.file_name().and_then(|name| name.to_str()).is_some_and(&which) {
            fs::remove_file(&path).map_err(ResultsError::io(&path))?;
        }
    }
    Ok(())
}
