//! HDF5 against the reference library in C: what it reads of our files, and what we read of its files, sound and
//! damaged.
//!
//! `HDF5_DAMAGES=100000 HDF5_SEED=7 cargo test -p mesh-io --test hdf5_reference damage` damages more files, in another
//! way.

use hdf5_metno::{File, Group, H5Type, Location};
use mesh::{Lists, MeshData, Vec3, zoo};
use mesh_io::{read_hdf5, write_hdf5};

/// How the reference library is to lay a mesh out.
#[derive(Clone, Copy, Debug)]
enum Layout {
    /// One block a dataset, in the format of HDF5 1.6 with symbol tables and no checksums.
    OldAndContiguous,
    /// Chunks that are found by a B-tree of version 1, with checksums and compression.
    OldAndCompressed,
    /// One block a dataset, in the format of HDF5 1.10.
    NewAndContiguous,
    /// Chunks of the format of HDF5 1.10, some with a fixed array and some alone.
    NewAndChunked,
    /// The same with unlimited extent: extensible arrays.
    NewAndUnlimited,
    /// As a program that thinks in 32 bits and big-endian numbers may write.
    Narrow,
}

const LAYOUTS: [Layout; 6] = [
    Layout::OldAndContiguous,
    Layout::OldAndCompressed,
    Layout::NewAndContiguous,
    Layout::NewAndChunked,
    Layout::NewAndUnlimited,
    Layout::Narrow,
];

impl Layout {
    fn put<T: H5Type>(self, group: &Group, name: &str, values: &[T], columns: Option<usize>) {
        let rows = values.len() / columns.unwrap_or(1);
        let shape: Vec<usize> = [rows].into_iter().chain(columns).collect();
        let chunk: Vec<usize> = [rows.div_ceil(3).max(1)].into_iter().chain(columns).collect();
        let builder = group.new_dataset::<T>();
        let dataset = match self {
            _ if values.is_empty() => builder.shape(shape).create(name),
            Self::OldAndContiguous | Self::NewAndContiguous | Self::Narrow => builder.shape(shape).create(name),
            Self::OldAndCompressed => builder.chunk(chunk).shuffle().deflate(6).fletcher32().shape(shape).create(name),
            Self::NewAndChunked => builder.chunk(chunk).fletcher32().shape(shape).create(name),
            Self::NewAndUnlimited => {
                let rest = columns.into_iter().map(hdf5_metno::Extent::from);
                let extents: Vec<_> = [hdf5_metno::Extent::resizable(rows)].into_iter().chain(rest).collect();
                builder.chunk(chunk).fletcher32().shape(extents).create(name)
            }
        };
        let dataset = dataset.unwrap();
        if !values.is_empty() {
            dataset.as_writer().write_raw(values).unwrap();
        }
    }

    fn put_numbers(self, group: &Group, name: &str, values: impl Iterator<Item = i64>) {
        let values: Vec<i64> = values.collect();
        match self {
            Self::Narrow => self.put(group, name, &values.iter().map(|&i| i as i32).collect::<Vec<_>>(), None),
            _ => self.put(group, name, &values, None),
        }
    }

    fn write(self, path: &std::path::Path, data: &MeshData) {
        let old = matches!(self, Self::OldAndContiguous | Self::OldAndCompressed);
        let mut options = File::with_options();
        if !old {
            options.with_fapl(|access| access.libver_v110());
        }
        let file = options.create(path).unwrap();
        let attribute = |place: &Location, name: &str, value: u32| {
            place.new_attr::<u32>().create(name).unwrap().write_scalar(&value).unwrap();
        };
        attribute(&file, "version", 1);
        attribute(&file, "dimension", data.dim as u32);
        let coordinates: Vec<f64> = data.vertices.iter().flat_map(|x| x.to_array()).collect();
        match self {
            Self::Narrow => {
                self.put(&file, "vertices", &coordinates.iter().map(|&x| x as f32).collect::<Vec<_>>(), Some(3));
            }
            _ => self.put(&file, "vertices", &coordinates, Some(3)),
        }
        let optional = |list: &[Option<usize>]| list.iter().map(|i| i.map_or(-1, |i| i as i64)).collect::<Vec<_>>();
        for (name, lists, items) in [("faces", &data.faces, "vertices"), ("cells", &data.cells, "faces")] {
            let group = file.create_group(name).unwrap();
            self.put_numbers(&group, "offsets", lists.offsets().iter().map(|&i| i as i64));
            self.put_numbers(&group, items, lists.items().iter().map(|&i| i as i64));
        }
        let faces = file.group("faces").unwrap();
        self.put_numbers(&faces, "tag", optional(&data.face_tag).into_iter());
        self.put_numbers(&faces, "fracture", optional(&data.face_fracture).into_iter());
        let cells = file.group("cells").unwrap();
        self.put_numbers(&cells, "region", data.cell_region.iter().map(|&i| i as i64));
        for (entry, names) in [("regions", &data.regions), ("tags", &data.tags), ("fractures", &data.fractures)] {
            let text: String = names.iter().flat_map(|name| [name, "\n"]).collect();
            self.put(&file, entry, text.as_bytes(), None);
        }
        file.close().unwrap();
    }
}

/// The mesh as the reference library finds it in one of our files.
fn read_by_reference(path: &std::path::Path) -> MeshData {
    let file = File::open(path).unwrap();
    let attribute = |name: &str| file.attr(name).unwrap().read_scalar::<u32>().unwrap();
    assert_eq!(attribute("version"), 1);
    let numbers = |name: &str| {
        let dataset = file.dataset(name).unwrap();
        assert!(dataset.dtype().unwrap().is::<i64>(), "{name}");
        dataset.read_raw::<i64>().unwrap()
    };
    let whole = |name: &str| numbers(name).into_iter().map(|i| i as usize).collect::<Vec<_>>();
    let optional = |name: &str| numbers(name).into_iter().map(|i| (i >= 0).then_some(i as usize)).collect::<Vec<_>>();
    let names = |name: &str| {
        let text = String::from_utf8(file.dataset(name).unwrap().read_raw::<u8>().unwrap()).unwrap();
        text.lines().map(str::to_owned).collect::<Vec<_>>()
    };
    let vertices = file.dataset("vertices").unwrap();
    let coordinates = vertices.read_raw::<f64>().unwrap();
    if !coordinates.is_empty() {
        assert_eq!(vertices.shape(), [coordinates.len() / 3, 3]);
        assert!(vertices.filters().contains(&hdf5_metno::filters::Filter::Fletcher32));
    }
    MeshData {
        dim: attribute("dimension") as usize,
        vertices: coordinates.chunks_exact(3).map(Vec3::from_slice).collect(),
        faces: Lists::from_offsets(whole("faces/offsets"), whole("faces/vertices")).unwrap(),
        cells: Lists::from_offsets(whole("cells/offsets"), whole("cells/faces")).unwrap(),
        cell_region: whole("cells/region"),
        regions: names("regions"),
        face_tag: optional("faces/tag"),
        tags: names("tags"),
        face_fracture: optional("faces/fracture"),
        fractures: names("fractures"),
    }
}

#[test]
fn the_reference_library_reads_what_we_write() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.h5");
    for specimen in zoo::all() {
        write_hdf5(&path, &specimen.data).unwrap();
        assert_eq!(read_by_reference(&path), specimen.data, "{}", specimen.name);
    }
    let empty = MeshData { dim: 3, ..MeshData::default() };
    write_hdf5(&path, &empty).unwrap();
    assert_eq!(read_by_reference(&path), empty);
}

/// More than one chunk, the last of them not full.
#[test]
fn the_reference_library_reads_large_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.h5");
    let data = mesh::generate::cartesian(Vec3::ZERO, Vec3::ONE, [200, 200, 0]);
    write_hdf5(&path, &data).unwrap();
    assert!(data.cells.items().len() > 2 << 16);
    assert_eq!(read_by_reference(&path), data);
    assert_eq!(read_hdf5(&path).unwrap(), data);
}

#[test]
fn we_read_what_the_reference_library_writes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.h5");
    for specimen in zoo::all() {
        for layout in LAYOUTS {
            layout.write(&path, &specimen.data);
            let mut expected = specimen.data.clone();
            if let Layout::Narrow = layout {
                expected.vertices.iter_mut().for_each(|x| *x = x.as_vec3().as_dvec3());
            }
            assert_eq!(read_hdf5(&path).unwrap(), expected, "{}, {layout:?}", specimen.name);
        }
    }
}

/// SplitMix64.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) % bound as u64) as usize
    }

    /// One to three changes of the kinds that disks, transfers and foes make.
    fn damage(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut damaged = bytes.to_vec();
        for _ in 0..=self.below(3) {
            let at = self.below(damaged.len().max(1));
            match self.below(6) {
                0 => damaged.truncate(at),
                1 => damaged[at..].iter_mut().take(1).for_each(|byte| *byte ^= 1 << self.below(8)),
                2 => damaged[at..].iter_mut().take(1).for_each(|byte| *byte = self.below(256) as u8),
                3 => damaged[at..].iter_mut().take(8).for_each(|byte| *byte = 0xff),
                4 => damaged[at..].iter_mut().take(4).zip([0, 0, 0, 0x7f]).for_each(|(byte, new)| *byte = new),
                _ => {
                    // A piece of the file at another place.
                    let from = self.below(damaged.len().max(1));
                    let piece = damaged[from..].iter().copied().take(1 + self.below(64)).collect::<Vec<_>>();
                    damaged[at..].iter_mut().zip(piece).for_each(|(byte, new)| *byte = new);
                }
            }
        }
        damaged
    }
}

fn setting(name: &str, default: usize) -> usize {
    std::env::var(name).map_or(default, |value| value.parse().unwrap())
}

/// Bytes of address space that the process has had at most.
fn peak() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmPeak:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<usize>().unwrap() * 1024
}

/// A damaged file is refused or read, without a panic and without asking for much memory. Ours notice every damage.
#[test]
fn damage_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.h5");
    let data = zoo::all().into_iter().find(|s| s.name == "hanging vertex on a fracture").unwrap().data;
    let damages = setting("HDF5_DAMAGES", 4000);
    let seed = setting("HDF5_SEED", 1) as u64;
    let before = peak();
    let mut refused = [0; 1 + LAYOUTS.len()];
    for (which, refused) in refused.iter_mut().enumerate() {
        match which.checked_sub(1) {
            None => write_hdf5(&path, &data).unwrap(),
            Some(layout) => LAYOUTS[layout].write(&path, &data),
        }
        let bytes = std::fs::read(&path).unwrap();
        let mut random = Random(seed);
        for number in 0..damages / (1 + LAYOUTS.len()) {
            let damaged = random.damage(&bytes);
            std::fs::write(&path, &damaged).unwrap();
            match read_hdf5(&path) {
                Ok(read) if which == 0 && read != data => {
                    // Fletcher-32 is a sum modulo 65535, which takes 0xffff for 0.
                    let mut changed = bytes.iter().zip(&damaged).filter(|(old, new)| old != new);
                    let unseen = changed.all(|change| matches!(change, (0, 0xff) | (0xff, 0)));
                    assert!(unseen, "seed {seed}, damage {number} was not noticed");
                }
                Ok(_) => {}
                Err(_) => *refused += 1,
            }
        }
    }
    println!("{refused:?} of {} refused, for each layout", damages / (1 + LAYOUTS.len()));
    assert!(refused.iter().all(|&n| n > damages / 50), "{refused:?}");
    assert!(peak() - before < 1 << 30, "{} bytes", peak() - before);
}
