//! The instantiation token: a hash of all that makes an instance what it is.

use std::fs;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::description::Description;
use crate::error::Error;
use crate::xml::{model_description, terminals_and_icons};

/// The token of a unit with this description and these resources, as hexadecimal SHA-256.
///
/// The description contains every name, size and start value, so a library can only be instantiated
/// with the `modelDescription.xml` and the `resources` that it was packed with.
///
/// # Errors
/// A resource cannot be read.
pub fn token(description: &Description, resources: Option<&Path>) -> Result<String, Error> {
    let mut hash = Sha256::new();
    let mut part = |bytes: &[u8]| {
        hash.update((bytes.len() as u64).to_le_bytes());
        hash.update(bytes);
    };
    part(b"fmi-unit token 1");
    part(model_description(description, "").as_bytes());
    part(terminals_and_icons(description, false).as_bytes());
    if let Some(folder) = resources {
        for name in files(folder)? {
            part(name.as_bytes());
            part(&read(&folder.join(&name))?);
        }
    }
    Ok(hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

/// The files below `folder`, sorted, with `/` between folders; none if there is no such folder.
pub(crate) fn files(folder: &Path) -> Result<Vec<String>, Error> {
    let mut found = Vec::new();
    if folder.is_dir() {
        collect(folder, "", &mut found)?;
    }
    found.sort();
    Ok(found)
}

fn collect(folder: &Path, prefix: &str, found: &mut Vec<String>) -> Result<(), Error> {
    let failed = |source| Error::File { path: folder.to_owned(), source };
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let Some(name) = path.file_name().and_then(|n| n.to_str()) else {
            let source = std::io::Error::other("the name is not UTF-8");
            return Err(Error::File { path, source });
        };
        let name = format!("{prefix}{name}");
        if path.is_dir() {
            collect(&path, &format!("{name}/"), found)?;
        } else {
            found.push(name);
        }
    }
    Ok(())
}

pub(crate) fn read(path: &PathBuf) -> Result<Vec<u8>, Error> {
    fs::read(path).map_err(|source| Error::File { path: path.clone(), source })
}
