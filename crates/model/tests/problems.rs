//! What is wrong with a model is found at once, with its place.

use std::path::Path;

use model::{Document, ModelError, Value};

const GOOD: &str = r#"title = "good"
[define]
c = 2
[mesh.box]
low = [0, 0]
high = [1, 1]
cells = [4, 4]
[regions.rock]
young_modulus = 1e9
poisson_ratio = "1/4"
permeability = [[2e-15, 1e-16], [1e-16, 1e-15]]
[mechanics]
[[mechanics.traction]]
on = ["top"]
y = "-c*x"
[flow]
boundary.left.pressure = 1e5
[time]
end = 10
[variants]
fine.mesh.box.cells = [8, 8]
soft.regions.rock.young_modulus = 1e8
"#;

fn problems(text: &str, changes: &[&str]) -> Vec<String> {
    match Document::read("model.toml", text, &[], changes) {
        Ok(_) => Vec::new(),
        Err(ModelError::Invalid(problems)) => problems.0.iter().map(ToString::to_string).collect(),
        Err(error) => panic!("{error}"),
    }
}

#[track_caller]
fn assert_all(found: &[String], wanted: &[(&str, &str)]) {
    for (line, (place, part)) in found.iter().zip(wanted) {
        assert!(line.starts_with(place) && line.contains(part), "{place} {part}: {line}\nof {found:#?}");
    }
    assert_eq!(found.len(), wanted.len(), "{found:#?}");
}

#[test]
fn a_good_model_has_none() {
    assert_eq!(problems(GOOD, &[]), [""; 0]);
}

#[test]
fn everything_at_once() {
    let text = r#"titel = "x"
[mesh.box]
low = [0, 0, 0, 0]
high = "a"
cells = [4, 4]
colour = 3
[regions.rock]
young_modulus = "1 +"
poissons_ratio = 0.25
permeability = [1, [2, 3]]
[regions.salt]
young_modulus = true
[fractures.a]
friction.coulomb.coefficent = 0.5
[fractures.b]
friction = "glue"
contact_aperture = 1
[mechanics]
displacement = [{ at = 1 }, { at = [1, 2, 3, 4] }]
[flow.wells]
w = { cell = [0.5, 0.5], rat = 1 }
[coupling]
split = "fixed"
max_iterations = -1
"#;
    assert_all(
        &problems(text, &[]),
        &[
            ("model.toml:1:1: titel", "unknown field `titel`, expected one of `title`"),
            ("model.toml:3:7: mesh.box.low", "two or three numbers, not 4"),
            ("model.toml:4:8: mesh.box.high", "expected a sequence"),
            ("model.toml:6:1: mesh.box.colour", "unknown field `colour`"),
            ("model.toml:7:10: regions.rock.poisson_ratio", "there is a [mechanics]"),
            ("model.toml:8:17: regions.rock.young_modulus", "ends too early (character 4)"),
            ("model.toml:9:1: regions.rock.poissons_ratio", "unknown field"),
            ("model.toml:10:16: regions.rock.permeability", "numbers (the diagonal) or rows"),
            ("model.toml:11:10: regions.salt.poisson_ratio", "there is a [mechanics]"),
            ("model.toml:11:10: regions.salt.permeability", "there is a [flow]"),
            ("model.toml:12:17: regions.salt.young_modulus", "a number or an expression in quotes"),
            ("model.toml:13:1: fractures.a.contact_aperture", "required"),
            ("model.toml:13:12: fractures.a.normal_permeability", "there is a [flow]"),
            ("model.toml:14:10: fractures.a.friction.coulomb.coefficient", "required"),
            ("model.toml:14:18: fractures.a.friction.coulomb.coefficent", "coefficient"),
            ("model.toml:15:12: fractures.b.normal_permeability", "there is a [flow]"),
            ("model.toml:16:12: fractures.b.friction", "unknown variant `glue`, expected"),
            ("model.toml:19:24: mechanics.displacement.0.at", "expected a sequence"),
            ("model.toml:19:36: mechanics.displacement.1.at", "two or three numbers, not 4"),
            ("model.toml:21:1: flow.wells.w", "exactly one of `rate` and `pressure`"),
            ("model.toml:21:1: flow.wells.w", "exactly one of `index` and `radius`"),
            ("model.toml:21:26: flow.wells.w.rat", "unknown field `rat`"),
            ("model.toml:23:9: coupling.split", "expected one of `fixed_strain`"),
            ("model.toml:24:18: coupling.max_iterations", "usize"),
            ("title", "this key is required"),
        ],
    );
}

/// What the tables allow is checked although they have keys that they do not know, and what was not readable is not
/// complained of twice.
#[test]
fn unknown_keys_and_ranges_together() {
    let changes = [
        "regions.rock.poisson_ratio = 0.5",
        "regions.rock.colour = 1",
        "define.c = true",
        "time.end = -1",
        "time.ende = 1",
        "mechanics.traction = [{ on = ['top'], y = 'q' }, { on = 1 }]",
    ];
    assert_all(
        &problems(GOOD, &changes),
        &[
            ("regions.rock.poisson_ratio = 0.5:1:30", "must be between"),
            ("regions.rock.colour = 1:1:14", "unknown field `colour`"),
            ("define.c = true:1:12", "a number or an expression"),
            ("time.end = -1:1:12", "after time.start"),
            ("time.ende = 1:1:6", "unknown field `ende`"),
            ("mechanics.traction = [{ on = ['top'], y = 'q' }, { on = 1 }]:1:43", "\"q\" is not known"),
            ("mechanics.traction = [{ on = ['top'], y = 'q' }, { on = 1 }]:1:57", "expected a sequence"),
        ],
    );
}

#[test]
fn corner_point_grids_are_checked() {
    let grid = "mesh.corner_point = { file = 'a.grdecl', regions = { keyword = 'FACIES', names = { sand = 'sand' } } }";
    let found = problems(GOOD, &[grid, "mesh.extrude = { levels = [0, 1], layers = [1] }"]);
    for part in ["names.sand: the key must be a whole number", "only a 2D mesh can be extruded", "3 rows of 3 numbers"]
    {
        assert!(found.iter().any(|f| f.contains(part)), "{part}: {found:#?}");
    }
    assert_eq!(found.len(), 3, "{found:#?}");
}

#[test]
fn contradictions_and_ranges() {
    let changes = [
        "mesh = { box = {}, triangles = { low = [0, 0], high = [1, 1], size = 0 } }",
        "regions.rock.poisson_ratio = 0.5",
        "regions.rock.permeability = [[1, 2], [2, 1]]",
        "define = { c = 'd + 1', d = 'c', x = 3 }",
        "initial.pressure = '1e5*t'",
        "flow.boundary.right = { pressure = 1, inflow = 1 }",
        "flow.wells.w = { cell = [1, 1, 1], rate = 1, index = 1 }",
        "coupling = { loose = true, acceleration = 'aitken', criteria = { pressure = { tolerance = 1, floor = 1 } } }",
    ];
    // `aitken` takes a table, which does not hide the rest.
    let found = problems(GOOD, &changes);
    assert!(
        found.len() > 10 && found.iter().any(|f| f.contains("acceleration: this choice has entries")),
        "{found:#?}"
    );
    let mut changes = changes;
    changes[7] = "coupling = { loose = true, acceleration.aitken = {}, criteria.p = { tolerance = 0, floor = 1 } }";
    let found = problems(GOOD, &changes);
    for part in [
        ":4:2: mesh: exactly one of `box`, `triangles`, `corner_point` and `file` is required, not 2",
        "mesh.triangles.size: 0 is out of range",
        "regions.rock.poisson_ratio: 0.5 is out of range; it must be between",
        "regions.rock.permeability: the tensor must be positive definite",
        "define.c: in \"d\": in \"c\": \"d\" is defined by itself",
        "define.x: this name cannot be defined",
        "initial.pressure: \"t\" is not known here; x, y, z, pi",
        "flow.boundary.right: `pressure` and `inflow` contradict",
        "flow.wells.w.cell: 2 numbers are required, not 3",
        "coupling.acceleration: loose coupling",
        "coupling.criteria.p: there is no coupling field of this name; known: matrix.pressure",
        "coupling.criteria.p.tolerance: 0 is out of range",
    ] {
        assert!(found.iter().any(|f| f.contains(part)), "{part}: {found:#?}");
    }
}

/// What is a number once and for all may use constant definitions.
#[test]
fn numbers_use_definitions() {
    let day = "define = { day = '24*hour', hour = 3600, depth = '10 - y' }";
    let changes = [day, "time.end = '20*day'", "output.times = ['hour']", "regions.rock.permeability = 'hour*1e-18'"];
    let model = Document::read("model.toml", GOOD, &[], &changes).unwrap().model;
    assert_eq!((model.time.end.0, model.output.times[0].0), (1_728_000.0, 3600.0));
    assert_eq!(model.regions["rock"].permeability, Some(model::Tensor::Isotropic(3600.0 * 1e-18)));
    assert_all(
        &problems(GOOD, &[day, "time.end = '20*dya'", "time.step = '-day'", "output.times = ['depth']"]),
        &[
            ("time.end = '20*dya':1:12: time.end", "\"dya\" is not known here; only pi and names under [define] are"),
            ("time.step = '-day':1:13: time.step", "-86400 is out of range; it must be positive"),
            ("output.times = ['depth']:1:16: output.times", "in \"depth\": \"y\" is not known here"),
        ],
    );
    // What comes of another problem is not told again, as that the name of a choice is not known, and that it has none.
    let found = problems(GOOD, &["output.times = [5]", "time.end = 'q'", "coupling.acceleration.foo = {}"]);
    assert_all(
        &found,
        &[
            ("time.end = 'q':1:12: time.end", "\"q\" is not known here"),
            ("coupling.acceleration.foo = {}:1:23: coupling.acceleration.foo", "unknown variant `foo`"),
        ],
    );
    let found = problems(GOOD, &["output.times = [5, 20, 30]"]);
    assert_all(&found, &[("output.times = [5, 20, 30]:1:16: output.times", "0 to 10 s: 20, 30; []")]);
    let found = problems(GOOD, &["define = { day = true }", "time.end = '20*day'"]);
    assert_all(&found, &[("define = { day = true }:1:18: define.day", "a number or an expression")]);
}

#[test]
fn required_keys_depend_on_the_units() {
    let text = "title = ''\nmesh.box = { low = [0, 0], high = [1, 1], cells = [1, 1] }\nregions.rock = {}\n";
    assert_all(&problems(text, &[]), &[("[mechanics] or [flow] is required", "")]);
    assert_all(
        &problems(text, &["flow = {}", "mechanics = {}"]),
        &[
            ("model.toml:3:9: regions.rock.young_modulus", "there is a [mechanics]"),
            ("model.toml:3:9: regions.rock.poisson_ratio", "there is a [mechanics]"),
            ("model.toml:3:9: regions.rock.permeability", "there is a [flow]"),
        ],
    );
}

#[test]
fn syntax_errors_have_places() {
    assert_all(&problems("title = \n[mesh\nx = 1\n", &[])[..1], &[("model.toml:1:", "")]);
    let found = problems(GOOD, &["time.end = = 2"]);
    assert!(found.iter().all(|f| f.starts_with("time.end = = 2:1:")) && !found.is_empty(), "{found:?}");
}

#[test]
fn names_must_fit_the_mesh() {
    let changes = [
        "mechanics.traction = [{ on = ['up', 'left'], x = 1 }]",
        "regions.salt = { permeability = 1, \
        young_modulus = 1, poisson_ratio = 0 }",
        "mesh.fractures.crack = 'x == 0.5'",
        "flow.boundary.lid.inflow = 1",
    ];
    let document = Document::read("model.toml", GOOD, &[], &changes).unwrap();
    let error = document.mesh(Path::new("."), &|_, _| Err(String::new())).unwrap_err().to_string();
    for part in [
        "mechanics.traction.0.on.0: no boundary face has the tag \"up\"; the mesh has bottom, left, right, top",
        "regions.salt: the mesh has nothing of this name; the mesh has rock",
        "fractures.crack: the mesh has it, but it is not described here",
        "flow.boundary.lid: no boundary face",
    ] {
        assert!(error.contains(part), "{part}: {error}");
    }
}

/// The message about the mesh of a model after changes.
fn mesh_error(changes: &[&str]) -> String {
    let document = Document::read("model.toml", GOOD, &[], changes).unwrap();
    document.mesh(Path::new("folder"), &|_, _| Ok(mesh::MeshData::default())).unwrap_err().to_string()
}

#[test]
fn what_is_wrong_with_the_mesh_has_its_place() {
    let triangles = "[mesh.triangles]\nlow = [0, 0]\nhigh = [1, 1]\nsize = 0.5\n\
                     fractures.a = { points = [[0.5, 0.5], [1.5, 0.5]], size = 0.1 }";
    let with = |mesh: &str, data: &mesh::MeshData| {
        let text = GOOD.replace("[mesh.box]\nlow = [0, 0]\nhigh = [1, 1]\ncells = [4, 4]", mesh);
        let document = Document::read("model.toml", &text, &[], &[]).unwrap();
        document.mesh(Path::new("folder"), &|_, _| Ok(data.clone())).unwrap_err().to_string()
    };
    let empty = mesh::MeshData::default();
    let error = with(triangles, &empty);
    let wanted =
        "model.toml:4:7: mesh.triangles: the mesh cannot be made: the geometry has 1 problem:\n  fracture \"a\" leaves";
    assert!(error.starts_with(wanted), "{error}");
    let error = with("[mesh]\nfile = 'a.msh'", &empty);
    assert!(error.starts_with("folder/a.msh: the mesh has 2 problems:\n  the dimension is 0"), "{error}");
    // Marks do not look at what is not there.
    let mut broken = mesh::generate::cartesian(mesh::Vec3::ZERO, mesh::Vec3::ONE, [2, 1, 0]);
    broken.cells = [vec![0, 1, 2, 99], vec![1, 4, 5, 6]].into_iter().collect();
    broken.cell_region.pop();
    for mark in ["fractures", "regions", "tags"] {
        let error = with(&format!("[mesh]\nfile = 'a.msh'\n{mark}.new = 'x == 0.5'"), &broken);
        assert!(error.starts_with("folder/a.msh: the mesh has 2 problems:"), "{error}");
        assert!(error.contains("cell 0 refers to face 99, but there are only 7"), "{error}");
    }
    let error = mesh_error(&["mesh.perturb.amplitude = 0.49", "mesh.perturb.seed = 3", "mesh.box.kershaw = 0.1"]);
    assert!(error.contains(":1:6: mesh.perturb: the mesh has 1 problem:\n  faces 2 and 14 of cell 4 cross"), "{error}");
    let levels = "mesh.extrude = { levels = [0, 1], layers = [1250001] }";
    let error = mesh_error(&[levels, "regions.rock.permeability = 1"]);
    assert!(
        error.contains("mesh.extrude.layers: 1250001 layers over 16 cells; at most 20000000 cells are allowed"),
        "{error}"
    );
    let error = problems(GOOD, &["mesh.box.cells = [4000000000000, 4000000000000]"]);
    assert_all(
        &error,
        &[(
            "mesh.box.cells = [4000000000000, 4000000000000]:1:18: mesh.box.cells",
            "more cells than the 20000000 that are allowed",
        )],
    );
}

/// The dimension is that of the mesh, whether the model tells it or a file.
#[test]
fn only_a_well_that_holds_a_pressure_needs_an_index() {
    let with = |well: &str| problems(GOOD, &[&format!("flow.wells.w = {{ cell = [0.1, 0.1], {well} }}")]);
    assert_eq!(with("rate = 1"), [""; 0]);
    let needed = "exactly one of `index` and `radius` is required";
    for well in ["pressure = 1", "rate = 1, limit = 2", "rate = 1, index = 1, radius = 1"] {
        assert!(with(well).iter().any(|line| line.contains(needed)), "{well}: {:?}", with(well));
    }
}

#[test]
fn vectors_have_as_many_components_as_the_mesh_dimensions() {
    let changes = [
        "mechanics.traction = [{ on = ['top'], z = 1 }]",
        "mechanics.displacement = [{ at = [0, 0, 1], x = 0, z = 0 }]",
        "mechanics.body_force = [1, 2, 3]",
        "flow.gravity = [0, 0, -9.81]",
        "flow.wells.w = { cell = [0, 0, 0], rate = 1, radius = 1, direction = [0, 0, 1] }",
        "regions.rock.permeability = [1, 2, 3]",
    ];
    let found = problems(GOOD, &changes);
    let number = "2 numbers are required, not 3: the mesh has 2 dimensions";
    let wanted = [
        ("mechanics.traction.0.z", "the mesh has two dimensions"),
        ("mechanics.displacement.0.at", number),
        ("mechanics.displacement.0.z", "the mesh has two dimensions"),
        ("mechanics.body_force", number),
        ("flow.gravity", number),
        ("flow.wells.w.cell", number),
        ("flow.wells.w.direction", "the mesh has two dimensions"),
        ("regions.rock.permeability", "2 numbers"),
    ];
    assert_eq!(found.len(), wanted.len(), "{found:#?}");
    for (line, (key, message)) in found.iter().zip(wanted) {
        assert!(line.contains(&format!(" {key}: ")) && line.contains(message), "{key}: {line}");
    }
    let text = GOOD.replace("[mesh.box]\nlow = [0, 0]\nhigh = [1, 1]\ncells = [4, 4]", "[mesh]\nfile = 'a.msh'");
    let document = Document::read("model.toml", &text, &[], &changes).unwrap();
    let read = |_: &Path, _: Option<&model::CornerPoint>| {
        Ok(mesh::generate::cartesian(mesh::Vec3::ZERO, mesh::Vec3::ONE, [2, 2, 0]))
    };
    match document.mesh(Path::new("."), &read) {
        Err(ModelError::Invalid(problems)) => {
            assert_eq!(problems.0.iter().map(ToString::to_string).collect::<Vec<_>>(), found);
        }
        other => panic!("{:?}", other.map(drop)),
    }
}

#[test]
fn contact_apertures_are_positive_on_all_faces() {
    let law = |aperture: &str| {
        let fracture = format!("fractures.crack = {{ normal_permeability = 1, contact_aperture = '{aperture}' }}");
        let changes = ["mesh.fractures.crack = 'x == 0.5'", &fracture];
        let document = Document::read("model.toml", GOOD, &[], &changes).unwrap();
        document.mesh(Path::new("."), &|_, _| Err(String::new())).map(drop).map_err(|error| error.to_string())
    };
    assert_eq!(law("y"), Ok(()));
    let error = law("y - 0.5").unwrap_err();
    let wanted = "fractures.crack.contact_aperture: it is -3.750e-1 at (5.0000e-1, 1.2500e-1, 0.0000e0) m, the middle of one of 2 \
                  such faces; it must be positive and finite (m)";
    assert!(error.contains(wanted), "{error}");
    // The fracture has no tip.
    let error = law("tip_distance").unwrap_err();
    assert!(error.contains("it is inf") && error.contains("one of 4 such faces"), "{error}");
    let joint = "y', normal_stiffness = 1e10, residual_aperture = 0.2, largest_closure = '0.5";
    let error = law(joint).unwrap_err();
    let place = "at (5.0000e-1, 1.2500e-1, 0.0000e0) m, the middle of one of";
    for wanted in [
        format!(
            "it is 1.250e-1 {place} 2 such faces; it must be above largest_closure, 5.000e-1 m: else the fracture closes to nothing"
        ),
        format!("it is 1.250e-1 {place} 1 such faces; it must be at least residual_aperture, 2.000e-1 m"),
    ] {
        assert!(error.contains(&wanted), "{error}");
    }
}

#[test]
fn laws_of_joints_are_checked() {
    let found = |law: &str| {
        let fracture = format!("fractures.crack = {{ normal_permeability = 1, contact_aperture = 1, {law} }}");
        problems(GOOD, &["mesh.fractures.crack = 'x == 0.5'", &fracture])
    };
    let mechanical = "dilation = 'mechanical', dilation_angle = 0.3";
    assert!(found(&format!("friction.coulomb.coefficient = 0.4, {mechanical}")).is_empty());
    assert!(found("normal_stiffness = 1, largest_closure = 0.5, residual_aperture = 0, dilation_limit = 0").is_empty());
    let energy = "mechanical dilation by tan ψ = 0.3093 needs coulomb friction with a coefficient of at least as much";
    for (law, key, wanted) in [
        (format!("friction.coulomb.coefficient = 0.3, {mechanical}"), "dilation", energy),
        (format!("friction.tresca.bound = 1e9, {mechanical}"), "dilation", energy),
        (mechanical.to_owned(), "dilation", energy),
        ("dilation = 'both'".to_owned(), "dilation", "expected `hydraulic` or `mechanical`"),
        ("dilation_limit = -1".to_owned(), "dilation_limit", "must be at least 0"),
        ("residual_aperture = -1".to_owned(), "residual_aperture", "must be at least 0"),
        ("normal_stiffness = 1, largest_closure = 0".to_owned(), "largest_closure", "must be positive"),
        ("largest_closure = 0.5".to_owned(), "largest_closure", "it needs a normal_stiffness"),
    ] {
        let found = found(&law);
        assert_eq!(found.len(), 1, "{law}: {found:#?}");
        assert!(
            found[0].contains(&format!(" fractures.crack.{key}: ")) && found[0].contains(wanted),
            "{law}: {found:#?}"
        );
    }
}

#[test]
fn a_run_has_an_end() {
    let first = |found: Vec<String>| {
        assert!(found.len() == 1, "{found:?}");
        found.into_iter().next().unwrap()
    };
    let step = first(problems(GOOD, &["time.step = 1e-30"]));
    let wanted = "time.step = 1e-30:1:13: time.step: 1e-30 s is too small from 0 to 10 s; it must be at \
                  least 1.000e-6 s, so that there are at most 10000000 time steps and none is lost in round-off";
    assert_eq!(step, wanted);
    assert_eq!(problems(GOOD, &["time.step = 1e-6"]), [""; 0]);
    // Few steps, but none of them would change the time.
    let late = ["time.start = 1e9", "time.end = 1000000001", "time.step = 0.1"];
    assert!(
        first(problems(GOOD, &late))
            .contains("time.step: 1e-1 s is too small from 1000000000 to 1000000001 s; it must be at least 1.000e0")
    );
    // Where steps adapt, the first may be as small as it likes, the largest not.
    let adaptive = "time.adaptive = {}";
    assert_eq!(problems(GOOD, &[adaptive, "time.step = 1e-30"]), [""; 0]);
    let largest = first(problems(GOOD, &[adaptive, "time.step = 1e-30", "time.adaptive.maximum = 1e-20"]));
    assert!(largest.contains("time.adaptive.maximum: 1e-20 s is too small from 0 to 10 s"), "{largest}");
    let from = first(problems(GOOD, &["time.step = 1e-8", "time.adaptive.from = 5"]));
    assert!(from.contains("time.step: 1e-8 s is too small from 0 to 5 s; it must be at least 5.000e-7"), "{from}");
}

#[test]
fn variants_and_changes() {
    let read = |variants: &[&str], changes: &[&str]| Document::read("model.toml", GOOD, variants, changes);
    let cells = |d: &Document| d.model.mesh.cartesian.as_ref().unwrap().cells.clone();
    assert_eq!(cells(&read(&[], &[]).unwrap()), [4, 4]);
    let both = read(&["fine", "soft"], &["time.step = 5", "define.c = 'pi'"]).unwrap();
    assert_eq!(cells(&both), [8, 8]);
    assert_eq!(both.model.regions["rock"].young_modulus.unwrap().0, 1e8);
    assert_eq!(both.model.regions["rock"].poisson_ratio.unwrap().0, 0.25);
    assert_eq!(both.model.define["c"], Value::Expression("pi".into()));
    let error = read(&["coarse"], &[]).unwrap_err().to_string();
    assert!(error.contains("there is no variant \"coarse\"; known: fine, soft"), "{error}");
    let error = read(&[], &["mesh.box.cells = [1]"]).unwrap_err().to_string();
    assert!(error.contains("model.toml:4:7: mesh.box: `low`, `high` and `cells`"), "{error}");
    let error = read(&[], &["mesh.box.cells = [0, 1]"]).unwrap_err().to_string();
    assert!(error.contains("mesh.box.cells = [0, 1]:1:18: mesh.box.cells: every"), "{error}");
}

#[test]
fn schema_knows_all_keys() {
    let schema = model::schema();
    for key in ["young_modulus", "fracture_compliance_floor_factor", "tip_distance", "iqn_ils"] {
        assert!(schema.contains(key), "{key}");
    }
}
