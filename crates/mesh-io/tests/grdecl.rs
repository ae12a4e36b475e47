//! Corner-point grids from text, sound and damaged.

use std::collections::BTreeMap;

use mesh::{Mesh, MeshData};
use mesh_io::{FileError, Grdecl, read_grdecl};

#[path = "../examples/throw.rs"]
#[expect(dead_code, reason = "its main function")]
mod throw;

/// Two columns of two cells, the right one 0.25 m lower, with what such files have.
const SECTION: &str = "-- Ünits: metres
GRIDUNIT
 'METRES' /
NOECHO
SPECGRID
 2 1 2 1 F /   cells
COORDSYS
 1 2 'INCOMP' /
COORD
 0 0 10  0 0 12   1 0 1.0D1  1 0 12   2 0 10  2 0 12
 0 1 10  0 1 12   1 1 10.0E0 1 1 12   2 1 10  2 1 12 /
ZCORN
 2*10 2*10.25 2*10 2*10.25 -- the top
 2*11 2*11.25 2*11 2*11.25
 2*11 2*11.25 2*11 2*11.25
 2*12 2*12.25 2*12 2*12.25/
PORO
 4*0.1 /
EQUALS
 'PERMX' 100 /
/
ACTNUM
3*1 1 /
SATNUM
 2*1 2*7 /
FAULTS
 'north' 1 1 1 1 1 2 'X' /
 south 2 2 1 1 2 2 I- /
/
";

fn read(text: impl AsRef<[u8]>, options: &Grdecl) -> Result<MeshData, FileError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("grid.grdecl");
    std::fs::write(&path, text).unwrap();
    read_grdecl(&path, options)
}

fn section() -> Grdecl {
    Grdecl { section: true, regions: Some("SATNUM".into()), ..Grdecl::default() }
}

#[test]
fn a_file_with_all_it_may_have() {
    let names = BTreeMap::from([("7".to_owned(), "sand".to_owned())]);
    let options = Grdecl { elevation: 100.0, names, faults: Some(vec!["north".into()]), ..section() };
    let data = read(SECTION, &options).unwrap();
    assert_eq!((data.regions.clone(), data.cell_region.clone()), (vec!["1".into(), "sand".into()], vec![0, 0, 1, 1]));
    assert_eq!(data.fractures, ["north"]);
    let mesh = Mesh::new(data).unwrap();
    assert_eq!((mesh.dim(), mesh.cell_count(), mesh.network().face_count()), (2, 4, 3));
    let highest = mesh.vertices().iter().fold(f64::MIN, |m, x| m.max(x.y));
    let lowest = mesh.vertices().iter().fold(f64::MAX, |m, x| m.min(x.y));
    assert_eq!((highest, lowest), (90.0, 87.75));
    // Both faults; later ones win.
    let data = read(SECTION, &section()).unwrap();
    assert_eq!(data.fractures, ["north", "south"]);
    assert_eq!(data.face_fracture.iter().filter(|f| **f == Some(1)).count(), 1);
    // In three dimensions, with one cell less.
    let solid = Grdecl { section: false, regions: None, ..section() };
    let mesh = Mesh::new(read(SECTION.replace("3*1 1 /", "1 2*1 0 /"), &solid).unwrap()).unwrap();
    assert_eq!((mesh.dim(), mesh.cell_count(), &*mesh.data().regions), (3, 3, &["rock".to_owned()][..]));
    assert!((mesh.geometry().cell_measure.iter().sum::<f64>() - 3.0).abs() < 1e-12);
}

#[test]
fn the_grid_of_the_fault_with_a_throw() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/fault-reactivation/throw.grdecl");
    assert!(std::fs::read_to_string(path).unwrap() == throw::text(), "made by `cargo run -p mesh-io --example throw`");
    let options = Grdecl { elevation: 2500.0, regions: Some("FACIES".into()), ..section() };
    let mesh = Mesh::new(read_grdecl(path, &options).unwrap()).unwrap();
    let g = mesh.geometry();
    assert!((g.cell_measure.iter().sum::<f64>() / 4e6 - 1.0).abs() < 1e-9);
    let network = mesh.network();
    let length: f64 = network.faces.iter().map(|&f| g.face_measure[f]).sum();
    assert!((length - 1000.0_f64.hypot(176.32)).abs() < 1e-6, "{length}");
    assert!(network.faces.iter().all(|&f| g.face_measure[f] > 4.99));
    // The reservoir is 50 m lower on the left: along so much of the fault it meets caprock, above and below.
    let region = |cell: usize| &*mesh.data().regions[mesh.data().cell_region[cell]];
    let met = |wanted: [&str; 2]| -> f64 {
        let height =
            |f: usize| (mesh.vertices()[mesh.face_vertices(f)[0]] - mesh.vertices()[mesh.face_vertices(f)[1]]).y.abs();
        let sides = |f: usize| (mesh.face_cells(f).0, mesh.face_cells(f).1.unwrap());
        let left = |(a, b): (usize, usize)| if g.cell_center[a].x < g.cell_center[b].x { (a, b) } else { (b, a) };
        let on = |f: usize| {
            let (a, b) = left(sides(f));
            [region(a), region(b)] == wanted
        };
        network.faces.iter().filter(|&&f| on(f)).map(|&f| height(f)).sum()
    };
    assert!((met(["3", "3"]) - 50.0).abs() < 1e-9 && (met(["3", "2"]) - 50.0).abs() < 1e-9);
    assert!((met(["2", "3"]) - 50.0).abs() < 1e-9 && met(["3", "1"]) + met(["1", "3"]) == 0.0);
}

#[test]
fn damaged_files_are_refused_with_all_that_is_wrong() {
    let refused = |text: String, options: &Grdecl, parts: &[&str]| {
        let found = read(text, options).unwrap_err().to_string();
        assert!(found.contains("grid.grdecl: "), "{found}");
        assert!(parts.iter().all(|part| found.contains(part)), "{found}");
        assert_eq!(found.lines().count(), 1 + parts.len(), "{found}");
    };
    let with = |changes: &[(&str, &str)]| {
        changes.iter().fold(SECTION.to_owned(), |text, (from, to)| {
            assert!(text.contains(from), "{from}");
            text.replace(from, to)
        })
    };
    assert!(matches!(read_grdecl("nowhere.grdecl", &section()), Err(FileError::Io { .. })));
    refused(
        String::new(),
        &section(),
        &["SPECGRID: this keyword, or DIMENS, is missing", "COORD: this", "ZCORN: this", "SATNUM: this"],
    );
    let text = with(&[
        ("'METRES'", "'FEET'"),
        ("12.25/", "12.25 1 /"),
        ("1.0D1", "ten"),
        ("3*1 1 /", "3*1 2 /"),
        ("2*7", "x*7"),
        ("'PERMX' 100 /", "'SATNUM' 100 /"),
        ("1 1 1 1 1 2 'X'", "1 1 1 1 1 2 'W'"),
        ("NOECHO", "INCLUDE\n 'more.inc' /"),
    ]);
    let parts = [
        "line 3: GRIDUNIT: the unit is FEET; only METRES",
        "line 4: INCLUDE: other files are not read",
        "line 11: COORD: `ten` is not a number",
        "line 13: ZCORN: there are 33 values; 32 are needed",
        "line 21: EQUALS: it changes SATNUM",
        "line 24: ACTNUM: `2` is not 0 or 1",
        "line 26: SATNUM: `x*7` is not a whole number",
        "line 28: FAULTS: `north 1 1 1 1 1 2 W` is not a name",
    ];
    refused(text, &section(), &parts);
    refused(with(&[("2 1 2 1 F", "2 1 2 2 T")]), &section(), &["reservoirs is 2", "cylindrical"]);
    refused(with(&[("2 1 2 1 F", "2 1 99999999 1 F")]), &section(), &["SPECGRID: there must be 1 to 16777216 cells"]);
    refused(with(&[("2 1 2 1 F", "2 1 0 1 F")]), &section(), &["not 2 x 1 x 0"]);
    refused(with(&[("4*0.1 /", "4*0.1 /\nDIMENS\n 2 2 1 /")]), &section(), &["DIMENS: it has other numbers"]);
    let parts = ["line 18: SATNUM: `4*0.1` is not a whole", "line 24: SATNUM: it stands in line 17 already"];
    refused(with(&[("PORO", "SATNUM")]), &section(), &parts);
    refused(with(&[("12.25/", "12.25")]), &section(), &["line 17: ZCORN: there is no `/` before PORO"]);
    refused(with(&[("I- /\n/", "I- /\n")]), &section(), &["there is no `/` before the end of the file"]);
    refused(with(&[("2*10 2*10.25 2*10", "99999999999999999999*10 2*10")]), &section(), &["`99999999999999999999*10`"]);
    refused(with(&[("2*10 2*10.25 2*10", "9999999999999999*10 2*10")]), &section(), &["32 are needed"]);
    let options = Grdecl { faults: Some(vec!["east".into()]), ..section() };
    refused(SECTION.into(), &options, &["FAULTS: there is no fault \"east\""]);
    // What only the grid shows.
    let text = with(&[
        ("2*12 2*12.25 2*12 2*12.25/", "2*10.5 2*12.25 2*10.5 2*12.25/"),
        ("1 1 1 1 1 2 'X'", "1 3 1 1 1 2 'X'"),
    ]);
    let found = read(&text, &section()).unwrap_err();
    assert!(matches!(&found, FileError::Grid { source, .. } if source.problems.len() == 1), "{found}");
    let found = read(text.replace("1 3 1 1 1 2 'X'", "1 1 1 1 1 2 'X'"), &section()).unwrap_err().to_string();
    assert!(found.contains("cell (1, 1, 2) is inverted"), "{found}");
}

#[test]
fn no_damage_makes_it_panic() {
    let bytes = SECTION.as_bytes();
    for options in [section(), Grdecl::default()] {
        for at in (0..bytes.len()).step_by(5) {
            let _ = read(&bytes[..at], &options);
            for wrong in [b'9', b'*', b'/', b'\n', b'-', b'\'', 0xff] {
                let mut damaged = bytes.to_vec();
                damaged[at] = wrong;
                if let Ok(data) = read(damaged, &options) {
                    // Sound or not, it says so.
                    let _ = Mesh::new(data);
                }
            }
        }
    }
}
