//! Meshes to HDF5 and back.

use hdf5_metno::File;
use mesh::{Lists, MeshData, zoo};
use mesh_io::{FileError, read_hdf5, write_hdf5};

fn specimen(name: &str) -> MeshData {
    zoo::all().into_iter().find(|s| s.name == name).unwrap().data
}

#[test]
fn every_mesh_comes_back_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.h5");
    for specimen in zoo::all() {
        let mut data = specimen.data;
        data.tags.push("Süd < \"x\"".into());
        write_hdf5(&path, &data).unwrap();
        assert_eq!(read_hdf5(&path).unwrap(), data, "{}", specimen.name);
    }
    // Only the file itself is left.
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    let empty = MeshData { dim: 3, ..MeshData::default() };
    write_hdf5(&path, &empty).unwrap();
    assert_eq!(read_hdf5(&path).unwrap(), empty);
}

/// FMUs are compared by their bytes.
#[test]
fn the_same_mesh_gives_the_same_bytes_at_another_time() {
    let folder = tempfile::tempdir().unwrap();
    let data = specimen("squares with a T");
    let bytes = |name: &str| {
        let path = folder.path().join(name);
        write_hdf5(&path, &data).unwrap();
        std::fs::read(path).unwrap()
    };
    let first = bytes("first.h5");
    // HDF5 counts seconds.
    std::thread::sleep(std::time::Duration::from_millis(1100));
    assert_eq!(first, bytes("second.h5"));
}

#[test]
fn what_cannot_be_written_leaves_the_old_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.h5");
    let data = specimen("squares with a T");
    write_hdf5(&path, &data).unwrap();
    let mut bad = data.clone();
    bad.regions[0] = "a\nb".into();
    let error = write_hdf5(&path, &bad).unwrap_err();
    assert!(matches!(&error, FileError::Content { entry, .. } if entry == "regions"), "{error}");
    assert_eq!(read_hdf5(&path).unwrap(), data);
    let nowhere = folder.path().join("no such folder").join("mesh.h5");
    assert!(matches!(write_hdf5(&nowhere, &data), Err(FileError::Io { .. })));
}

/// The message for a sound file after a change.
fn message(change: impl FnOnce(&File)) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("changed.h5");
    write_hdf5(&path, &specimen("squares with a T")).unwrap();
    let file = File::open_rw(&path).unwrap();
    change(&file);
    file.close().unwrap();
    let text = read_hdf5(&path).unwrap_err().to_string();
    assert!(text.contains("changed.h5"), "{text}");
    text
}

#[test]
fn errors_name_file_and_entry() {
    let has = |text: String, parts: &[&str]| assert!(parts.iter().all(|part| text.contains(part)), "{text}");
    has(message(|file| file.attr("version").unwrap().write_scalar(&7_u32).unwrap()), &["version 7", "reads version 1"]);
    has(message(|file| file.unlink("vertices").unwrap()), &["vertices"]);
    has(message(|file| file.unlink("cells/region").unwrap()), &["cells/region"]);
    let put = |file: &File, name: &str, values: &[i64]| file.dataset(name).unwrap().write_raw(values).unwrap();
    let offsets = |file: &File| file.dataset("faces/offsets").unwrap().read_raw::<i64>().unwrap();
    has(
        message(|file| {
            let mut values = offsets(file);
            values.swap(1, 2);
            put(file, "faces/offsets", &values);
        }),
        &["faces/offsets", "ascend"],
    );
    has(
        message(|file| {
            let mut values = offsets(file);
            values[1] = -2;
            put(file, "faces/offsets", &values);
        }),
        &["faces/offsets", "-2"],
    );
    has(
        message(|file| {
            let n = file.dataset("faces/tag").unwrap().size();
            put(file, "faces/tag", &vec![-3; n]);
        }),
        &["faces/tag", "-3"],
    );
    has(
        message(|file| {
            file.unlink("tags").unwrap();
            file.new_dataset::<u8>().shape([2]).create("tags").unwrap().write_raw(b"ab").unwrap();
        }),
        &["tags", "line feed"],
    );
    has(
        message(|file| {
            file.unlink("vertices").unwrap();
            file.new_dataset::<f64>().shape([1_usize << 50, 3]).chunk([64, 3]).create("vertices").unwrap();
        }),
        &["vertices", "exceeds"],
    );
    // What the library would turn into something else.
    has(
        message(|file| {
            file.unlink("vertices").unwrap();
            file.new_dataset::<f64>().shape([30, 2]).create("vertices").unwrap();
        }),
        &["vertices", "its extent is [30, 2]; it must be [vertices, 3]"],
    );
    has(
        message(|file| {
            let values: Vec<f64> = offsets(file).iter().map(|&i| i as f64 + 0.3).collect();
            file.unlink("faces/offsets").unwrap();
            file.new_dataset::<f64>()
                .shape([values.len()])
                .create("faces/offsets")
                .unwrap()
                .write_raw(&values)
                .unwrap();
        }),
        &["faces/offsets", "its type is f64; it must be i64"],
    );
}

#[test]
fn damaged_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.h5");
    let data = specimen("hanging vertex on a fracture");
    write_hdf5(&path, &data).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert!(matches!(read_hdf5(folder.path().join("none.h5")), Err(FileError::Io { .. })));
    for cut in (0..bytes.len()).step_by(bytes.len() / 40) {
        std::fs::write(&path, &bytes[..cut]).unwrap();
        assert!(matches!(read_hdf5(&path), Err(FileError::Hdf5 { .. })), "cut at {cut}");
    }
    // A changed byte is noticed, or lies where nothing is stored.
    let mut noticed = 0;
    for i in (0..bytes.len()).step_by(3) {
        let mut damaged = bytes.clone();
        damaged[i] ^= 0x55;
        std::fs::write(&path, &damaged).unwrap();
        match read_hdf5(&path) {
            Ok(read) => assert_eq!(read, data, "byte {i}"),
            Err(_) => noticed += 1,
        }
    }
    assert!(noticed > 10, "{noticed}");
}

#[test]
fn lists_are_checked() {
    assert!(Lists::from_offsets(vec![0, 2, 2, 3], vec![5, 6, 7]).is_some());
    for offsets in [vec![], vec![0], vec![1, 3], vec![0, 2], vec![0, 3, 2, 3], vec![0, 4]] {
        assert!(Lists::from_offsets(offsets.clone(), vec![5, 6, 7]).is_none(), "{offsets:?}");
    }
}
