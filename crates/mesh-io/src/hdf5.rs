//! Meshes in HDF5.
//!
//! | entry | type | shape | meaning |
//! |---|---|---|---|
//! | attribute `version` | u32 | scalar | version of this layout, 1 |
//! | attribute `dimension` | u32 | scalar | 2 or 3 |
//! | `vertices` | f64 | vertices × 3 | coordinates (m), z = 0 in 2D |
//! | `faces/offsets` | i64 | faces + 1 | where the vertices of each face start, and end |
//! | `faces/vertices` | i64 | any | vertices of the faces, one face behind the other |
//! | `faces/tag` | i64 | faces | index into `tags`, −1 where there is none |
//! | `faces/fracture` | i64 | faces | index into `fractures`, −1 where there is none |
//! | `cells/offsets` | i64 | cells + 1 | where the faces of each cell start, and end |
//! | `cells/faces` | i64 | any | faces of the cells, one cell behind the other |
//! | `cells/region` | i64 | cells | index into `regions` |
//! | `regions`, `tags`, `fractures` | u8 | any | names in UTF-8, each ended by a line feed |
//!
//! Damage is noticed: datasets that are not empty are chunked and carry Fletcher-32 checksums, and the file format of
//! HDF5 1.10 has checksums on all that leads to them (on damaged files of the older one the library may crash).

use std::path::Path;

use hdf5_metno::types::TypeDescriptor;
use hdf5_metno::{Dataset, File, Group, H5Type, Result as Hdf5Result};
use mesh::{Lists, MeshData, Vec3};

use crate::FileError;
use crate::error::replace;

const VERSION: u32 = 1;
/// Entries per chunk: some hundred kilobytes.
const CHUNK: usize = 1 << 16;

/// Writes a mesh, under a temporary name first.
///
/// # Errors
/// [`FileError::Io`] and [`FileError::Hdf5`]; [`FileError::Content`] for a name with a line feed.
pub fn write_hdf5(path: impl AsRef<Path>, data: &MeshData) -> Result<(), FileError> {
    let path = path.as_ref();
    for (entry, names) in [("regions", &data.regions), ("tags", &data.tags), ("fractures", &data.fractures)] {
        if let Some(name) = names.iter().find(|name| name.contains('\n')) {
            return Err(FileError::content(path, entry, format!("the name {name:?} has a line feed")));
        }
    }
    replace(path, |part| {
        write(part, data).map_err(|(entry, source)| FileError::Hdf5 { path: path.into(), entry, source })
    })
}

type Named<T> = Result<T, (String, hdf5_metno::Error)>;

fn write(path: &Path, data: &MeshData) -> Named<()> {
    // Without times, so that the same mesh gives the same bytes.
    let mut options = File::with_options();
    options.with_fapl(|access| access.libver_v110()).with_fcpl(|file| file.obj_track_times(false));
    let file = named("/", options.create(path))?;
    let group = |name: &str| named(name, file.create_group_builder().obj_track_times(false).create(name));
    let attribute = |name: &str, value: u32| {
        named(name, file.new_attr::<u32>().create(name).and_then(|attribute| attribute.write_scalar(&value)))
    };
    attribute("version", VERSION)?;
    attribute("dimension", data.dim as u32)?;
    let coordinates: Vec<f64> = data.vertices.iter().flat_map(|x| x.to_array()).collect();
    put(&file, "vertices", &coordinates, Some(3))?;
    let numbers = |list: &[usize]| list.iter().map(|&i| i as i64).collect::<Vec<_>>();
    let optional = |list: &[Option<usize>]| list.iter().map(|i| i.map_or(-1, |i| i as i64)).collect::<Vec<_>>();
    let faces = group("faces")?;
    put(&faces, "offsets", &numbers(data.faces.offsets()), None)?;
    put(&faces, "vertices", &numbers(data.faces.items()), None)?;
    put(&faces, "tag", &optional(&data.face_tag), None)?;
    put(&faces, "fracture", &optional(&data.face_fracture), None)?;
    let cells = group("cells")?;
    put(&cells, "offsets", &numbers(data.cells.offsets()), None)?;
    put(&cells, "faces", &numbers(data.cells.items()), None)?;
    put(&cells, "region", &numbers(&data.cell_region), None)?;
    for (entry, names) in [("regions", &data.regions), ("tags", &data.tags), ("fractures", &data.fractures)] {
        let text: String = names.iter().flat_map(|name| [name, "\n"]).collect();
        put(&file, entry, text.as_bytes(), None)?;
    }
    named("/", file.flush())
}

fn named<T>(entry: &str, result: Hdf5Result<T>) -> Named<T> {
    result.map_err(|error| (entry.to_owned(), error))
}

/// Writes values as one dataset, in rows of `columns` where that is given.
fn put<T: H5Type>(group: &Group, name: &str, values: &[T], columns: Option<usize>) -> Named<()> {
    let make = || -> Hdf5Result<()> {
        let builder = group.new_dataset::<T>().obj_track_times(false);
        let rows = values.len() / columns.unwrap_or(1);
        let chunk = rows.clamp(1, CHUNK);
        let dataset = match columns {
            _ if values.is_empty() => return builder.shape([0]).create(name).map(drop),
            Some(columns) => builder.chunk([chunk, columns]).fletcher32().shape([rows, columns]).create(name)?,
            None => builder.chunk([chunk]).fletcher32().shape([rows]).create(name)?,
        };
        dataset.as_writer().write_raw(values)
    };
    named(&format!("{}/{name}", group.name().trim_end_matches('/')), make())
}

/// Reads a mesh.
///
/// # Errors
/// [`FileError::Io`] and [`FileError::Hdf5`] for a file that cannot be read, [`FileError::Version`],
/// and [`FileError::Content`] for entries that do not have their form. Whether the mesh is sound is not looked at.
pub fn read_hdf5(path: impl AsRef<Path>) -> Result<MeshData, FileError> {
    let path = path.as_ref();
    let size = std::fs::metadata(path).map_err(FileError::io(path))?.len();
    let reader = Reader { path, size, file: File::open(path).map_err(|source| hdf5_error(path, "/", source))? };
    let version = reader.attribute("version")?;
    if version != VERSION {
        return Err(FileError::Version { path: path.into(), found: version.to_string(), supported: "1" });
    }
    let (shape, coordinates): (_, Vec<f64>) = reader.shaped("vertices")?;
    if !coordinates.is_empty() && !matches!(shape[..], [_, 3]) {
        let problem = format!("its extent is {shape:?}; it must be [vertices, 3]");
        return Err(FileError::content(path, "vertices", problem));
    }
    Ok(MeshData {
        dim: reader.attribute("dimension")? as usize,
        vertices: coordinates.chunks_exact(3).map(Vec3::from_slice).collect(),
        faces: reader.lists("faces/offsets", "faces/vertices")?,
        cells: reader.lists("cells/offsets", "cells/faces")?,
        cell_region: reader.numbers("cells/region")?,
        regions: reader.names("regions")?,
        face_tag: reader.optional("faces/tag")?,
        tags: reader.names("tags")?,
        face_fracture: reader.optional("faces/fracture")?,
        fractures: reader.names("fractures")?,
    })
}

fn hdf5_error(path: &Path, entry: &str, source: hdf5_metno::Error) -> FileError {
    FileError::Hdf5 { path: path.into(), entry: entry.into(), source }
}

struct Reader<'a> {
    path: &'a Path,
    /// Bytes in the file.
    size: u64,
    file: File,
}

impl Reader<'_> {
    fn attribute(&self, name: &str) -> Result<u32, FileError> {
        (self.file.attr(name).and_then(|attribute| attribute.read_scalar()))
            .map_err(|source| hdf5_error(self.path, name, source))
    }

    fn values<T: H5Type>(&self, entry: &str) -> Result<Vec<T>, FileError> {
        Ok(self.shaped(entry)?.1)
    }

    /// The extent of a dataset, and its values.
    fn shaped<T: H5Type>(&self, entry: &str) -> Result<(Vec<usize>, Vec<T>), FileError> {
        let read = |dataset: Dataset| -> Result<(Vec<usize>, Vec<T>), FileError> {
            let failed = |source| hdf5_error(self.path, entry, source);
            let found = dataset.dtype().and_then(|kind| kind.to_descriptor()).map_err(failed)?;
            let wanted = T::type_descriptor();
            let is_whole =
                |kind: &TypeDescriptor| matches!(kind, TypeDescriptor::Integer(_) | TypeDescriptor::Unsigned(_));
            // The library would cut off fractions without a word.
            if !(is_whole(&found) || (matches!(found, TypeDescriptor::Float(_)) && !is_whole(&wanted))) {
                return Err(FileError::content(self.path, entry, format!("its type is {found}; it must be {wanted}")));
            }
            let shape = dataset.get_shape().map_err(failed)?;
            // Damage must not ask for all of the memory; compression that halves the size three times is allowed.
            let bytes = shape.iter().try_fold(size_of::<T>() as u64, |n, &extent| n.checked_mul(extent as u64));
            if bytes.is_none_or(|bytes| bytes > self.size.saturating_mul(8)) {
                return Err(FileError::content(
                    self.path,
                    entry,
                    format!("its extent {shape:?} exceeds 8 times the file"),
                ));
            }
            Ok((shape, dataset.read_raw().map_err(failed)?))
        };
        self.file.dataset(entry).map_err(|source| hdf5_error(self.path, entry, source)).and_then(read)
    }

    fn numbers(&self, entry: &str) -> Result<Vec<usize>, FileError> {
        (self.values::<i64>(entry)?.into_iter())
            .map(|i| usize::try_from(i).map_err(|_| FileError::content(self.path, entry, format!("{i} is no number"))))
            .collect()
    }

    fn optional(&self, entry: &str) -> Result<Vec<Option<usize>>, FileError> {
        (self.values::<i64>(entry)?.into_iter())
            .map(|i| match i {
                -1 => Ok(None),
                _ => usize::try_from(i)
                    .map(Some)
                    .map_err(|_| FileError::content(self.path, entry, format!("{i} is neither a number nor -1"))),
            })
            .collect()
    }

    fn lists(&self, offsets: &str, items: &str) -> Result<Lists, FileError> {
        Lists::from_offsets(self.numbers(offsets)?, self.numbers(items)?).ok_or_else(|| {
            FileError::content(self.path, offsets, format!("must ascend from 0 to the length of {items}"))
        })
    }

    fn names(&self, entry: &str) -> Result<Vec<String>, FileError> {
        let text = String::from_utf8(self.values(entry)?)
            .map_err(|error| FileError::content(self.path, entry, error.to_string()))?;
        if !(text.is_empty() || text.ends_with('\n')) {
            return Err(FileError::content(self.path, entry, "the last name must be ended by a line feed"));
        }
        Ok(text.lines().map(str::to_owned).collect())
    }
}
