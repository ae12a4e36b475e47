//! Boxes of quadrilaterals or hexahedra.

use crate::random::Random;
use crate::{EdgeKind, Mesh, MeshData, Vec3};

/// A Cartesian mesh of the box from `low` to `high` (m, above `low` in each direction) with `n` cells, at least one, in each
/// direction. In 2D, say with `n[2] = 0`, z is not looked at. Boundary tags `left`, `right` (x), `front`, `back` (y) and `bottom`,
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

/// Moves every vertex by a random distance, in each direction at most `amplitude` times its shortest edge.
/// Boundary and fractures keep their shape: a vertex on them moves within their planes and along the lines
/// in which these meet, and tips of fractures stay. Up to 0.2 hexahedra stay sound.
pub fn perturb(mesh: &Mesh, amplitude: f64, seed: u64) -> MeshData {
    let mut data = mesh.data().clone();
    let n = data.vertices.len();
    let mut shortest = vec![f64::INFINITY; n];
    let mut normals: Vec<Vec<Vec3>> = vec![Vec::new(); n];
    for face in 0..mesh.face_count() {
        let list = mesh.face_vertices(face);
        for (i, &a) in list.iter().enumerate() {
            let b = list[(i + 1) % list.len()];
            let length = data.vertices[a].distance(data.vertices[b]);
            [a, b].into_iter().for_each(|v| shortest[v] = shortest[v].min(length));
        }
        if mesh.is_boundary(face) || data.face_fracture[face].is_some() {
            let normal = mesh.geometry().face_normal(face);
            list.iter().for_each(|&v| normals[v].push(normal));
        }
    }
    let network = mesh.network();
    for edge in (0..network.edge_count()).filter(|&e| network.edge_kind(e) == EdgeKind::Tip) {
        network.edge_vertices.get(edge).iter().for_each(|&v| normals[v] = vec![Vec3::X, Vec3::Y, Vec3::Z]);
    }
    let mut random = Random::new(seed);
    for (v, normals) in normals.iter().enumerate() {
        let mut shift = Vec3::new(random.signed(), random.signed(), random.signed()) * (amplitude * shortest[v]);
        if data.dim == 2 {
            shift.z = 0.0;
        }
        let mut basis: Vec<Vec3> = Vec::new();
        for &normal in normals {
            let rest = basis.iter().fold(normal, |rest, &e| rest - rest.dot(e) * e);
            // What is left of a normal that is known but for round-off is no direction.
            if rest.length() > 1e-6 {
                basis.push(rest.normalize());
            }
        }
        data.vertices[v] += basis.iter().fold(shift, |shift, &e| shift - shift.dot(e) * e);
    }
    data
}

/// A box as [`cartesian`], distorted by a map after Kershaw (J. Comput. Phys. 39, 1981): along x the cells
/// are pressed alternately to the lower and the upper sides in y and z. `epsilon` in (0, 1] is the ratio of
/// the thinnest layer to a Cartesian one; 1 does not distort, 0.3 distorts heavily. x keeps its planes; six
/// cells in x or a multiple of it follow the map best.
pub fn kershaw(low: Vec3, high: Vec3, n: [usize; 3], epsilon: f64) -> MeshData {
    let mut data = cartesian(low, high, n);
    let right = |t: f64| if t <= 0.5 { (2.0 - epsilon) * t } else { 1.0 + epsilon * (t - 1.0) };
    let left = |t: f64| 1.0 - right(1.0 - t);
    let dim = data.dim;
    data.map_vertices(|x| {
        let mut t = (x - low) / (high - low);
        let layer = 6.0 * t.x;
        // How far the pattern has gone from the lower (0) to the upper (1) side.
        let toward = match layer {
            l if l <= 1.0 => 0.0,
            l if l <= 2.0 => smooth(l - 1.0),
            l if l <= 4.0 => 1.0 - smooth(0.5 * (l - 2.0)),
            l if l <= 5.0 => smooth(l - 4.0),
            _ => 1.0,
        };
        for axis in 1..dim {
            t[axis] = left(t[axis]) + toward * (right(t[axis]) - left(t[axis]));
        }
        if dim == 2 { (low + t * (high - low)).with_z(0.0) } else { low + t * (high - low) }
    });
    data
}

/// A step from 0 to 1 with two continuous derivatives.
fn smooth(t: f64) -> f64 {
    t * t * t * (t * (6.0 * t - 15.0) + 10.0)
}
