//! The invariants of ARCHITECTURE.md.

use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// What a package lists under `[dependencies]`.
fn dependencies(package: &str) -> Vec<String> {
    let path = root().join(package).join("Cargo.toml");
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let section = text.split("\n[dependencies]\n").nth(1).unwrap_or_default();
    let lines = section.lines().take_while(|line| !line.starts_with('['));
    lines.filter_map(|line| line.split(['.', ' ', '=']).next()).map(str::to_owned).collect()
}

/// All Rust sources below a folder.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() && path.file_name().is_some_and(|name| name != "target") {
            found.extend(sources(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
    found
}

#[test]
fn units_do_not_know_each_other_and_fmi_unit_knows_no_physics() {
    assert!(dependencies("mechanics-fmu").contains(&"mesh".to_owned()));
    assert!(!dependencies("mechanics-fmu").contains(&"flow-fmu".to_owned()));
    assert!(!dependencies("flow-fmu").contains(&"mechanics-fmu".to_owned()));
    for own in ["mesh", "mesh-io", "linear", "model", "coupling", "mechanics-fmu", "flow-fmu"] {
        assert!(!dependencies("crates/fmi-unit").contains(&own.to_owned()), "{own}");
    }
    for numerics in ["crates/mesh", "crates/linear"] {
        for outer in ["fmi-unit", "coupling", "model", "mesh-io"] {
            assert!(!dependencies(numerics).contains(&outer.to_owned()), "{numerics} uses {outer}");
        }
    }
}

#[test]
fn the_orchestrator_links_no_unit() {
    for unit in ["mechanics-fmu", "flow-fmu", "mechanics-unit", "flow-unit"] {
        assert!(!dependencies("orchestrator").contains(&unit.to_owned()), "{unit}");
    }
}

#[test]
fn numerics_know_neither_fmi_nor_files() {
    for unit in ["mechanics-fmu", "flow-fmu"] {
        for path in sources(&root().join(unit).join("src")) {
            if path.file_name().is_some_and(|name| name == "unit.rs") {
                continue;
            }
            let text = std::fs::read_to_string(&path).unwrap();
            for word in ["fmi_unit", "coupling::", "Document", "mesh_io", "std::fs", "std::io"] {
                assert!(!text.contains(word), "{} uses {word}", path.display());
            }
        }
    }
}

#[test]
fn unsafe_code_stands_at_the_c_boundary_only() {
    let boundary = ["crates/fmi-unit/src/ffi.rs", "crates/fmi-unit/src/functions.rs", "orchestrator/src/fmi"];
    for package in ["crates", "mechanics-fmu", "flow-fmu", "orchestrator"] {
        for path in sources(&root().join(package)) {
            let relative = path.strip_prefix(root()).unwrap().to_string_lossy().into_owned();
            let is_source = relative.contains("/src/");
            if !is_source || boundary.iter().any(|allowed| relative.starts_with(allowed)) {
                continue;
            }
            let text = std::fs::read_to_string(&path).unwrap();
            let code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
            let found = code.filter(|line| line.contains("unsafe ") && !line.contains('"')).collect::<Vec<_>>();
            assert!(found.is_empty(), "{relative}: {found:?}");
        }
    }
}
