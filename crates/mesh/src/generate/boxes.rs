//! Boxes of quadrilaterals or hexahedra.

use crate::{MeshData, Vec3};

/// A Cartesian mesh of the box from `low` to `high` (m) with `n` cells in each direction. In 2D, say with
/// `n[2] = 0`, z is not looked at. Boundary tags `left`, `right` (x), `front`, `back` (y) and `bottom`,
/// `top` (z); in 2D `bottom` and `top` are those of y.
pub fn cartesian(low: Vec3, high: Vec3, n: [usize; 3]) -> MeshData {
    let dim = if n[2] == 0 { 2 } else { 3 };
    let [nx, ny, nz] = n;
    let number = |i: usize, j: usize, k: usize| i + (nx + 1) * (j + (ny + 1) * k);
    let mut vertices = Vec::new();
    for k in 0..=nz {
        for j in 0..=ny {
            for i in 0..=nx {
                let t = Vec3::new(
                    i as f64 / nx as f64,
                    j as f64 / ny as f64,
                    if dim == 3 { k as f64 / nz as f64 } else { 0.0 },
                );
                let p = low + t * (high - low);
                vertices.push(if dim == 3 { p } else { p.with_z(0.0) });
            }
        }
    }
    let mut data = if dim == 2 {
        let quads = (0..ny).flat_map(|j| (0..nx).map(move |i| (i, j)));
        MeshData::from_polygons(
            vertices,
            quads.map(|(i, j)| [number(i, j, 0), number(i + 1, j, 0), number(i + 1, j + 1, 0), number(i, j + 1, 0)]),
        )
    } else {
        let cells = (0..nz).flat_map(|k| (0..ny).flat_map(move |j| (0..nx).map(move |i| (i, j, k))));
        MeshData::from_polyhedra(
            vertices,
            cells.map(|(i, j, k)| {
                let v = |a, b, c| number(i + a, j + b, k + c);
                [
                    [v(0, 0, 0), v(0, 1, 0), v(0, 1, 1), v(0, 0, 1)],
                    [v(1, 0, 0), v(1, 1, 0), v(1, 1, 1), v(1, 0, 1)],
                    [v(0, 0, 0), v(1, 0, 0), v(1, 0, 1), v(0, 0, 1)],
                    [v(0, 1, 0), v(1, 1, 0), v(1, 1, 1), v(0, 1, 1)],
                    [v(0, 0, 0), v(1, 0, 0), v(1, 1, 0), v(0, 1, 0)],
                    [v(0, 0, 1), v(1, 0, 1), v(1, 1, 1), v(0, 1, 1)],
                ]
            }),
        )
    };
    tag_box(&mut data, low, high);
    data
}

/// Tags the boundary faces of a box by the side they lie on.
pub fn tag_box(data: &mut MeshData, low: Vec3, high: Vec3) {
    const SIDES_2D: [[&str; 2]; 2] = [["left", "right"], ["bottom", "top"]];
    const SIDES_3D: [[&str; 2]; 3] = [["left", "right"], ["front", "back"], ["bottom", "top"]];
    let sides: &[[&'static str; 2]] = if data.dim == 2 { &SIDES_2D } else { &SIDES_3D };
    // Coordinates of a box are exact to round-off of its size.
    let tolerance = 1e-9 * (high - low).length();
    data.tag_boundary(|x| {
        sides.iter().enumerate().find_map(|(axis, names)| {
            let near = |bound: Vec3| (x[axis] - bound[axis]).abs() < tolerance;
            if near(low) {
                Some(names[0])
            } else if near(high) {
                Some(names[1])
            } else {
                None
            }
        })
    });
}
