//! What is in an FMU, and that it is always the same bytes.

use std::fs;

use fmi_unit::{
    Contents, Description, Environment, Error, Reference, StepOutcome, Type, Unit, UnitError, ValuesMut, Variable, pack,
};

#[allow(unreachable_pub, reason = "public where it is a library")]
#[path = "../examples/heated_bars.rs"]
mod heated_bars;

use heated_bars::HeatedBars;

fn contents(folder: &std::path::Path) -> Contents {
    let library = folder.join("lib.so");
    fs::write(&library, b"library").unwrap();
    let resources = folder.join("resources");
    fs::create_dir_all(resources.join("b")).unwrap();
    fs::write(resources.join("size.txt"), "2 2").unwrap();
    fs::write(resources.join("b/mesh"), [0; 10_000]).unwrap();
    Contents { library, resources: Some(resources), icon: Some(vec![137]) }
}

#[test]
fn the_same_input_gives_the_same_bytes() {
    let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let [first, second] = [&a, &b].map(|folder| {
        let path = folder.path().join("bars.fmu");
        let token = pack::<HeatedBars>(&path, &contents(folder.path())).unwrap();
        (token, fs::read(path).unwrap())
    });
    assert_eq!(first, second);
    // Nothing is left of the temporary file.
    let files = fs::read_dir(a.path()).unwrap().count();
    assert_eq!(files, 3);
}

#[test]
fn the_archive_is_sorted_and_complete() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bars.fmu");
    let token = pack::<HeatedBars>(&path, &contents(folder.path())).unwrap();
    let mut archive = zip::ZipArchive::new(fs::File::open(path).unwrap()).unwrap();
    let names: Vec<_> = (0..archive.len()).map(|i| archive.by_index(i).unwrap().name().unwrap().into_owned()).collect();
    let library = if cfg!(all(target_arch = "x86_64", target_os = "linux")) {
        "binaries/x86_64-linux/heated_bars.so".to_owned()
    } else {
        names[0].clone()
    };
    let expected = [
        &library,
        "documentation/index.html",
        "modelDescription.xml",
        "resources/b/mesh",
        "resources/size.txt",
        "terminalsAndIcons/icon.png",
        "terminalsAndIcons/terminalsAndIcons.xml",
    ];
    assert_eq!(names, expected);
    let xml = std::io::read_to_string(archive.by_name("modelDescription.xml").unwrap()).unwrap();
    assert!(xml.contains(&token));
    assert!(xml.contains(r#"<Dimension start="2"/>"#));
}

#[test]
fn other_resources_give_another_token() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bars.fmu");
    let contents = contents(folder.path());
    let token = pack::<HeatedBars>(&path, &contents).unwrap();
    fs::write(contents.resources.as_ref().unwrap().join("b/mesh"), [1; 10_000]).unwrap();
    assert_ne!(pack::<HeatedBars>(&path, &contents).unwrap(), token);
}

#[test]
fn a_failure_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut contents = contents(folder.path());
    contents.library = folder.path().join("missing.so");
    let path = folder.path().join("bars.fmu");
    let error = pack::<HeatedBars>(&path, &contents).unwrap_err();
    assert!(error.to_string().contains("missing.so"), "{error}");
    assert!(!path.exists());
}

/// Says that it starts with 1, but starts with 2.
struct Liar;

impl Unit for Liar {
    type State = ();
    fn instantiate(_: &Environment) -> Result<Self, UnitError> {
        Ok(Liar)
    }
    fn description(&self) -> Description {
        Description::new("Liar", "liar").variables([Variable::parameter(1, "p", Type::Int8).start(1)])
    }
    fn get(&mut self, _: Reference, values: ValuesMut<'_>) -> Result<(), UnitError> {
        values.write(&[2i8])
    }
    fn step(&mut self, _: f64, _: f64) -> Result<StepOutcome, UnitError> {
        Ok(StepOutcome::Completed)
    }
}

#[test]
fn a_start_value_that_is_not_kept_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let contents = contents(folder.path());
    let error = pack::<Liar>(&folder.path().join("liar.fmu"), &contents).unwrap_err();
    assert!(matches!(&error, Error::Contract(text) if text.contains("starts with 2")), "{error}");
}
