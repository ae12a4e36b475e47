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
//! HDF5 1.10 has checksums on all that leads to them.
//!
//! Files are read and written by hdf5-pure, which has no C in it: a unit's library that brought the C library along
//! would load only beside the one it was built with, and not into a host that has another.

use std::fs::File as Handle;
use std::path::Path;

use hdf5_pure::{
    AttrValue, Chunk, ChunkIndex, DType, Dataset, DatasetBuilder, Error, File, FileBuilder, H5Element, Layout, LibVer,
};
use mesh::{Lists, MeshData, Vec3};

use crate::FileError;
use crate::error::replace;

const VERSION: u32 = 1;
/// Entries per chunk: some hundred kilobytes.
const CHUNK: usize = 1 << 16;

/// Writes a mesh, under a temporary name first. The same mesh gives the same bytes.
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
    let file = file(data);
    replace(path, |part| {
        let handle = Handle::create(part).map_err(FileError::io(path))?;
        file.finish_to(handle).map_err(|source| hdf5_error(path, "/", source))
    })
}

fn file(data: &MeshData) -> FileBuilder {
    let mut file = FileBuilder::new();
    file.with_libver_bounds(LibVer::V110, LibVer::V110);
    file.set_attr("version", AttrValue::U32(VERSION));
    file.set_attr("dimension", AttrValue::U32(data.dim as u32));
    let coordinates: Vec<f64> = data.vertices.iter().flat_map(|x| x.to_array()).collect();
    put(file.create_dataset("vertices"), &coordinates, Some(3));
    let numbers = |list: &[usize]| list.iter().map(|&i| i as i64).collect::<Vec<_>>();
    let optional = |list: &[Option<usize>]| list.iter().map(|i| i.map_or(-1, |i| i as i64)).collect::<Vec<_>>();
    let mut faces = file.create_group("faces");
    put(faces.create_dataset("offsets"), &numbers(data.faces.offsets()), None);
    put(faces.create_dataset("vertices"), &numbers(data.faces.items()), None);
    put(faces.create_dataset("tag"), &optional(&data.face_tag), None);
    put(faces.create_dataset("fracture"), &optional(&data.face_fracture), None);
    file.add_group(faces.finish());
    let mut cells = file.create_group("cells");
    put(cells.create_dataset("offsets"), &numbers(data.cells.offsets()), None);
    put(cells.create_dataset("faces"), &numbers(data.cells.items()), None);
    put(cells.create_dataset("region"), &numbers(&data.cell_region), None);
    file.add_group(cells.finish());
    for (entry, names) in [("regions", &data.regions), ("tags", &data.tags), ("fractures", &data.fractures)] {
        let text: String = names.iter().flat_map(|name| [name, "\n"]).collect();
        put(file.create_dataset(entry), text.as_bytes(), None);
    }
    file
}

/// Makes values one dataset, in rows of `columns` where that is given.
fn put<T: H5Element>(dataset: &mut DatasetBuilder, values: &[T], columns: Option<usize>) {
    dataset.with_data(values);
    if values.is_empty() {
        dataset.with_shape(&[0]);
        return;
    }
    let rows = values.len() / columns.unwrap_or(1);
    let of = |rows: usize| [rows].into_iter().chain(columns).map(|n| n as u64).collect::<Vec<_>>();
    dataset.with_shape(&of(rows)).with_chunks(&of(rows.min(CHUNK))).with_fletcher32();
}

/// Reads a mesh.
///
/// # Errors
/// [`FileError::Io`] and [`FileError::Hdf5`] for a file that cannot be read, [`FileError::Version`],
/// and [`FileError::Content`] for entries that do not have their form. Whether the mesh is sound is not looked at.
pub fn read_hdf5(path: impl AsRef<Path>) -> Result<MeshData, FileError> {
    let path = path.as_ref();
    // A device or a pipe has no end, or none that comes.
    if !std::fs::metadata(path).map_err(FileError::io(path))?.is_file() {
        return Err(FileError::io(path)(std::io::Error::other("this is no file")));
    }
    // As a whole: read piece by piece, a damaged file makes the library ask for as much memory as the damage says.
    let bytes = std::fs::read(path).map_err(FileError::io(path))?;
    let size = bytes.len() as u64;
    let file = File::from_bytes(bytes).map_err(|source| hdf5_error(path, "/", source))?;
    let reader = Reader { path, size, file };
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

fn hdf5_error(path: &Path, entry: &str, source: Error) -> FileError {
    FileError::Hdf5 { path: path.into(), entry: entry.into(), source: Box::new(source) }
}

/// What is read into.
trait Element: H5Element {
    /// Its name in messages.
    const NAME: &'static str;

    /// Whether values of a type become this one without loss. The library would clamp them and cut off fractions
    /// without a word.
    fn takes(found: &DType) -> bool;
}

impl Element for f64 {
    const NAME: &'static str = "f64";

    fn takes(found: &DType) -> bool {
        is_whole(found) || matches!(found, DType::F32 | DType::F64)
    }
}

impl Element for i64 {
    const NAME: &'static str = "i64";

    fn takes(found: &DType) -> bool {
        is_whole(found)
    }
}

impl Element for u8 {
    const NAME: &'static str = "u8";

    fn takes(found: &DType) -> bool {
        is_whole(found)
    }
}

fn is_whole(found: &DType) -> bool {
    use DType::{I8, I16, I32, I64, U8, U16, U32, U64};
    matches!(found, I8 | I16 | I32 | I64 | U8 | U16 | U32 | U64)
}

struct Reader<'a> {
    path: &'a Path,
    /// Bytes in the file.
    size: u64,
    file: File,
}

impl Reader<'_> {
    fn attribute(&self, name: &str) -> Result<u32, FileError> {
        let attributes = self.file.root().attrs().map_err(|source| hdf5_error(self.path, name, source))?;
        let value = attributes.get(name).ok_or_else(|| self.content(name, "the attribute is missing"))?;
        (value.as_u64().and_then(|value| u32::try_from(value).ok()))
            .ok_or_else(|| self.content(name, format!("the attribute is {value:?}; it must be a whole number")))
    }

    fn content(&self, entry: &str, problem: impl Into<String>) -> FileError {
        FileError::content(self.path, entry, problem)
    }

    fn values<T: Element>(&self, entry: &str) -> Result<Vec<T>, FileError> {
        Ok(self.shaped(entry)?.1)
    }

    /// The extent of a dataset, and its values.
    fn shaped<T: Element>(&self, entry: &str) -> Result<(Vec<u64>, Vec<T>), FileError> {
        let failed = |source| hdf5_error(self.path, entry, source);
        let dataset: Dataset = self.file.dataset(entry).map_err(failed)?;
        let found = dataset.dtype().map_err(failed)?;
        if !T::takes(&found) {
            return Err(self.content(entry, format!("its type is {found}; it must be {}", T::NAME)));
        }
        let shape = dataset.shape().map_err(failed)?;
        // Damage must not ask for all of the memory; compression that halves the size three times is allowed.
        let is_large = |shape: &[u64]| {
            let bytes = shape.iter().try_fold(size_of::<T>() as u64, |n, &extent| n.checked_mul(extent));
            bytes.is_none_or(|bytes| bytes > self.size.saturating_mul(8))
        };
        if is_large(&shape) {
            return Err(self.content(entry, format!("its extent {shape:?} exceeds 8 times the file")));
        }
        // The library trusts what a file of an old format, without checksums, says of its chunks.
        if let Layout::Chunked { chunk_shape, index } = dataset.layout().map_err(failed)? {
            if is_large(&chunk_shape) {
                return Err(self.content(entry, format!("its chunks of {chunk_shape:?} exceed 8 times the file")));
            }
            let chunks = if index == ChunkIndex::BTreeV2 { Vec::new() } else { dataset.chunks().map_err(failed)? };
            let outside = |chunk: &&Chunk| chunk.offset.iter().zip(&shape).any(|(start, extent)| start >= extent);
            if let Some(Chunk { offset, .. }) = chunks.iter().find(outside) {
                return Err(self.content(entry, format!("a chunk starts at {offset:?}, but the extent is {shape:?}")));
            }
        }
        Ok((shape, dataset.read().map_err(failed)?))
    }

    fn numbers(&self, entry: &str) -> Result<Vec<usize>, FileError> {
        (self.values::<i64>(entry)?.into_iter())
            .map(|i| usize::try_from(i).map_err(|_| self.content(entry, format!("{i} is no number"))))
            .collect()
    }

    fn optional(&self, entry: &str) -> Result<Vec<Option<usize>>, FileError> {
        (self.values::<i64>(entry)?.into_iter())
            .map(|i| match i {
                -1 => Ok(None),
                _ => usize::try_from(i)
                    .map(Some)
                    .map_err(|_| self.content(entry, format!("{i} is neither a number nor -1"))),
            })
            .collect()
    }

    fn lists(&self, offsets: &str, items: &str) -> Result<Lists, FileError> {
        Lists::from_offsets(self.numbers(offsets)?, self.numbers(items)?)
            .ok_or_else(|| self.content(offsets, format!("must ascend from 0 to the length of {items}")))
    }

    fn names(&self, entry: &str) -> Result<Vec<String>, FileError> {
        let text = String::from_utf8(self.values(entry)?).map_err(|error| self.content(entry, error.to_string()))?;
        if !(text.is_empty() || text.ends_with('\n')) {
            return Err(self.content(entry, "the last name must be ended by a line feed"));
        }
        Ok(text.lines().map(str::to_owned).collect())
    }
}
