//! The grid of the variant `throw` of models/fault-reactivation, as GRDECL text:
//!
//!     cargo run -p mesh-io --example throw > models/fault-reactivation/throw.grdecl
//!
//! A section of 2000 × 2000 m; depths count from the ground, 500 m above it. Pillars follow the fault where they are
//! near, and stand upright at the sides. On the left of the fault the layers lie lower: by 50 m at its middle, by less
//! towards its ends, where they meet, and towards the left side, where the reservoir is at its height.

use std::fmt::Write;

/// Depth (m) of the bottom, and size (m) of the section.
const BOTTOM: f64 = 2500.0;
const SIZE: f64 = 2000.0;
/// Heights (m) above the bottom between which the fault is; x there follows from its dip.
const FAULT: [f64; 2] = [500.0, 1500.0];
/// Thickness (m) of the layers there.
const LAYER: f64 = 25.0;
const THROW: f64 = 50.0;

/// x (m) of the fault's line.
fn fault_x(z: f64) -> f64 {
    500.0 + 0.17632 * (z - 1000.0)
}

/// 0 to 1 in steps that grow.
fn graded(steps: i32, growth: f64) -> Vec<f64> {
    (0..=steps).map(|i| (growth.powi(i) - 1.0) / (growth.powi(steps) - 1.0)).collect()
}

/// How much lower (m) the layer boundary at height `z` lies on the left of the fault: a parabola, in steps of 5 m so that
/// no face on the fault is shorter.
fn throw(z: f64) -> f64 {
    let t = ((z - FAULT[0]) / (FAULT[1] - FAULT[0])).clamp(0.0, 1.0);
    (THROW * 4.0 * t * (1.0 - t) / 5.0).round() * 5.0
}

/// The text of the file.
pub(crate) fn text() -> String {
    // From the top down.
    let outer = graded(7, 1.3);
    let above = outer.iter().rev().map(|d| (FAULT[1] + d * (SIZE - FAULT[1])).round());
    let between = (1..40).map(|i| FAULT[1] - LAYER * f64::from(i));
    let below = outer.iter().map(|d| (FAULT[0] * (1.0 - d)).round());
    let heights: Vec<f64> = above.chain(between).chain(below).collect();
    // For each pillar its place from a side (0) to the fault (1).
    let left: Vec<f64> = graded(11, 1.2).iter().rev().map(|d| 1.0 - d).collect();
    let right: Vec<f64> = graded(17, 1.2).iter().map(|d| 1.0 - d).collect();
    let x = |pillar: usize, z: f64| match pillar {
        p if p < left.len() => left[p] * fault_x(z),
        p => SIZE - right[p + 1 - left.len()] * (SIZE - fault_x(z)),
    };
    let columns = left.len() + right.len() - 2;
    let depth = &|column: usize, side: usize, z: f64| {
        let share = if column + 1 < left.len() { left[column + side] } else { 0.0 };
        BOTTOM - z + share * throw(z)
    };

    let mut text = String::from(
        "-- Section across a fault with a throw of 50 m (chosen). Made by:\n\
         -- cargo run -p mesh-io --example throw\n\n",
    );
    let layers = heights.len() - 1;
    let _ = write!(text, "SPECGRID\n{columns} 1 {layers} 1 F /\n\n");
    let pillars = |y: u8| {
        let pillar = |p: usize| {
            let ends = [(SIZE, BOTTOM - SIZE), (0.0, BOTTOM)];
            ends.map(|(z, depth)| format!("{:.3} {y} {depth}", x(p, z))).join(" ")
        };
        (0..=columns).map(pillar).collect::<Vec<_>>()
    };
    write_values(&mut text, "COORD", [0, 1].into_iter().flat_map(pillars));
    let corners = heights.windows(2).flat_map(|layer| {
        layer.iter().flat_map(|&z| {
            // In front and at the back.
            (0..4 * columns).map(move |c| c % (2 * columns)).map(move |c| {
                let text = format!("{:.2}", depth(c / 2, c % 2, z));
                text.trim_end_matches('0').trim_end_matches('.').to_owned()
            })
        })
    });
    write_values(&mut text, "ZCORN", corners);
    text.push_str("-- 1 aquifer, 2 caprock, 3 reservoir\n");
    let facies = heights.windows(2).flat_map(|layer| {
        let middle = 0.5 * (layer[0] + layer[1]);
        let number = match middle {
            z if z > 950.0 && z < 1050.0 => "3",
            z if z > 800.0 && z < 1200.0 => "2",
            _ => "1",
        };
        std::iter::repeat_n(number.to_owned(), columns)
    });
    write_values(&mut text, "FACIES", facies);
    let (column, first, last) = (left.len() - 1, outer.len(), outer.len() + 39);
    let _ = write!(text, "FAULTS\n'fault' {column} {column} 1 1 {first} {last} X /\n/\n");
    text
}

/// A keyword with its values, equal ones as n*v.
fn write_values(text: &mut String, keyword: &str, values: impl Iterator<Item = String>) {
    let values: Vec<String> = values.collect();
    let mut line = String::new();
    let _ = writeln!(text, "{keyword}");
    for run in values.chunk_by(|a, b| a == b) {
        let word = if run.len() > 1 { format!("{}*{}", run.len(), run[0]) } else { run[0].clone() };
        if line.len() + word.len() > 110 {
            let _ = writeln!(text, "{}", line.trim_end());
            line.clear();
        }
        line += &word;
        line.push(' ');
    }
    let _ = write!(text, "{line}/\n\n");
}

fn main() {
    print!("{}", text());
}
