//! The models of the project: they are sound, and say what the case list says.

use std::path::{Path, PathBuf};

use mesh::{Mesh, MeshData, Vec3};
use model::{CornerPoint, Document, Point, Scope, TipDistances};

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models").join(name)
}

fn load(name: &str, variants: &[&str]) -> Document {
    Document::load(&folder(name), variants, &[]).unwrap_or_else(|e| panic!("{name}: {e}"))
}

fn no_files(_: &Path, _: Option<&CornerPoint>) -> Result<MeshData, String> {
    Err("no files here".into())
}

fn mesh(name: &str, variants: &[&str]) -> (Document, Mesh) {
    let document = load(name, variants);
    let mesh = document.mesh(&folder(name), &no_files).unwrap_or_else(|e| panic!("{name}: {e}"));
    (document, mesh)
}

#[test]
fn all_models_and_variants_are_sound() {
    let mut names: Vec<_> = std::fs::read_dir(folder("")).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert!(names.len() >= 8);
    for name in names {
        let name = name.to_str().unwrap();
        let (document, mesh) = mesh(name, &[]);
        println!("{name}: {} cells, {} fracture faces", mesh.cell_count(), mesh.network().face_count());
        for variant in document.model.variants.keys() {
            let variant = load(name, &[variant]);
            let again = Document::read("again", &variant.to_toml(), &[], &[]).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert!(again.model.variants.is_empty());
            assert_eq!(again.to_toml(), variant.to_toml());
        }
    }
}

#[test]
fn another_source_of_the_mesh_replaces_all_of_it() {
    let mesh = load("fault-reactivation", &["throw"]).model.mesh;
    assert!(mesh.triangles.is_none() && mesh.regions.is_empty() && mesh.corner_point.is_some());
    assert_eq!(load("fault-reactivation", &["throw"]).model.dim(), Some(2));
    // The same source is only changed.
    let fine = load("fault-reactivation", &["fine"]).model.mesh;
    assert!(fine.triangles.is_some_and(|t| t.size.0 == 60.0 && t.growth.0 == 0.2) && fine.regions.len() == 2);
}

#[test]
fn six_fractures_have_the_aperture_of_the_case() {
    let (document, mesh) = mesh("six-fractures", &[]);
    let tips = TipDistances::new(&mesh);
    let network = mesh.network();
    // Two ends of a line, or one where the other lies on the boundary.
    let wanted = [0.302, 0.403113, 0.201556, 0.416083, 0.509902, 0.111803];
    for (fracture, wanted) in wanted.into_iter().enumerate() {
        let law = &document.model.fractures[&mesh.data().fractures[fracture]];
        let aperture = document.model.function(&law.contact_aperture, Scope::Fracture).unwrap();
        let mut largest: f64 = 0.0;
        for (i, &face) in network.faces.iter().enumerate().filter(|(i, _)| network.fracture[*i] == fracture) {
            let point = tips.point(fracture, mesh.geometry().face_center[face]);
            let value = aperture.at(&point);
            assert!(value > 0.0 && value < 1.001e-4, "{value}");
            largest = largest.max(value);
            assert!((point.max_tip_distance - wanted).abs() < 0.021, "{fracture}: {}", point.max_tip_distance);
            assert!(point.tip_distance < wanted, "{i}");
        }
        assert!(largest > 0.97e-4);
    }
    // The boundary end of fracture 5 is no tip: there d_c = 1e-4 m.
    let five = mesh.data().fractures.iter().position(|f| f == "5").unwrap();
    assert!((tips.distance(five, Vec3::new(2.0, 0.55, 0.0)) - 0.509902).abs() < 1e-6);
}

#[test]
fn manufactured_contact_has_the_force_of_its_displacement() {
    let model = load("manufactured-contact", &[]).model;
    let mechanics = model.mechanics.as_ref().unwrap();
    let u: Vec<_> =
        mechanics.displacement[0].components().map(|(_, _, v)| model.function(v, Scope::Boundary).unwrap()).collect();
    let f: Vec<_> = mechanics
        .body_force
        .as_ref()
        .unwrap()
        .iter()
        .map(|v| model.function(v, Scope::PlaceAndTime).unwrap())
        .collect();
    // f = −Δu − 2 ∇ div u for λ = μ = 1, by central differences.
    const H: f64 = 1e-4;
    for x in [Vec3::new(0.3, -0.4, 0.6), Vec3::new(0.5, 0.2, -0.7), Vec3::new(-0.6, 0.1, -0.5)] {
        let at = |c: usize, y: Vec3| u[c].at(&Point { cell: x, ..Point::new(y, 0.0) });
        let e = [Vec3::X, Vec3::Y, Vec3::Z].map(|e| e * H);
        let second = |c: usize, i: usize, j: usize| {
            (at(c, x + e[i] + e[j]) - at(c, x + e[i] - e[j]) - at(c, x - e[i] + e[j]) + at(c, x - e[i] - e[j]))
                / (4.0 * H * H)
        };
        for c in 0..3 {
            let laplace: f64 = (0..3).map(|i| second(c, i, i)).sum();
            let gradient: f64 = (0..3).map(|i| second(i, i, c)).sum();
            let wanted = -laplace - 2.0 * gradient;
            let found = f[c].at(&Point::new(x, 0.0));
            assert!((found - wanted).abs() < 1e-5 * (1.0 + wanted.abs()), "{c} at {x}: {found} {wanted}");
        }
    }
}

#[test]
fn plate_of_mandel_moves_from_undrained_to_drained() {
    let model = load("mandel", &[]).model;
    let plate = &model.mechanics.as_ref().unwrap().displacement[2];
    let strain = model.function(plate.y.as_ref().unwrap(), Scope::Boundary).unwrap();
    let at = |t: f64| strain.at(&Point::new(Vec3::Y, t));
    let number = |name: &str| model.function(&model.define[name], Scope::Constant).unwrap().as_constant().unwrap();
    let per = number("force") / (2.0 * number("mu") * number("a"));
    let (undrained, drained) = (-per * (1.0 - number("nu_u")), -per * (1.0 - number("nu")));
    assert!((at(1e9) / drained - 1.0).abs() < 1e-9);
    let first = at(model.time.step.unwrap().0);
    assert!(first < undrained && first > 0.5 * (undrained + drained), "{first} {undrained} {drained}");
}

#[test]
fn the_section_can_be_extruded() {
    let (_, mesh) = mesh("fault-reactivation", &["extruded"]);
    assert_eq!(mesh.dim(), 3);
    assert!(mesh.tagged_faces("inlet").count() > 4);
    let data = mesh.data();
    let height: f64 = mesh.network().faces.iter().map(|&f| mesh.geometry().face_measure[f]).sum();
    assert!((height / 200.0 - 1015.4).abs() < 0.1, "{height}");
    assert_eq!(data.regions.len(), 3);
}
