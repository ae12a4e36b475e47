//! docs/interface.md says what the code has.

use std::path::Path;

use coupling::{QUANTITIES, Role, Shape};

fn document() -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/interface.md")).unwrap()
}

/// The table of variables in Markdown.
fn table() -> String {
    let mut text =
        String::from("| variable | shape | unit | output of | input of | meaning |\n|---|---|---|---|---|---|\n");
    for q in &QUANTITIES {
        let shape = match q.shape {
            Shape::Cells => "cells",
            Shape::CellVectors => "cells × dimension",
            Shape::CellTensors => "cells × dimension × dimension",
            Shape::FractureFaces => "fracture faces",
            Shape::FractureVectors => "fracture faces × dimension",
        };
        let (from, to) = (q.from.name(), if q.exchanged { q.from.partner().name() } else { "" });
        text += &format!("| `{}` | {shape} | {} | {from} | {to} | {} |\n", q.name, q.unit, q.meaning);
        if q.referenced {
            let partner = q.from.partner().name();
            let meaning = format!("the same, where {partner} was last evaluated");
            text += &format!("| `{}_reference` | {shape} | {} | | {from} | {meaning} |\n", q.name, q.unit);
        }
    }
    text
}

#[test]
fn the_table_is_that_of_the_code() {
    let document = document();
    let rest = document.split_once("interface_document.rs -->\n").unwrap().1;
    let found = rest.split_once("<!-- end -->").unwrap().0;
    assert!(found == table(), "the table must be:\n{}", table());
}

#[test]
fn the_minimum_is_that_of_the_code() {
    let document = document();
    for role in [Role::Flow, Role::Mechanics] {
        let fields = |from: Role| {
            let names = QUANTITIES.iter().filter(|q| q.referenced && q.from == from).map(|q| format!("`{}`", q.name));
            names.collect::<Vec<_>>().join(", ")
        };
        let row = format!("| {} | {} | {} |\n", role.name(), fields(role), fields(role.partner()));
        assert!(document.contains(&row), "{row}");
    }
}
