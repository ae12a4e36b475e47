//! Meshes for tests: sound, but none of them easy.

use crate::generate::{
    CornerPoint, Fault, Triangles, agglomerate, cartesian, dual, extrude, kershaw, perturb, simplices, unite_cells,
};
use crate::{Mesh, MeshData, Vec3};

/// A mesh of the zoo.
#[derive(Clone, Debug)]
pub struct Specimen {
    /// What it is called.
    pub name: &'static str,
    /// The mesh.
    pub data: MeshData,
    /// Area or volume of the domain.
    pub measure: f64,
}

/// All meshes, in two and three dimensions.
///
/// # Panics
/// Never: the input is fixed.
pub fn all() -> Vec<Specimen> {
    let mut zoo = plane();
    zoo.extend(solid());
    zoo
}

fn made<T, E: std::fmt::Display>(result: Result<T, E>) -> T {
    result.unwrap_or_else(|error| panic!("the zoo is sound: {error}"))
}

fn mesh(data: MeshData) -> Mesh {
    made(Mesh::new(data))
}

fn points<const N: usize>(list: [[f64; 2]; N]) -> Vec<Vec3> {
    list.iter().map(|&[x, y]| Vec3::new(x, y, 0.0)).collect()
}

/// The meshes in two dimensions.
///
/// # Panics
/// Never: the input is fixed.
pub fn plane() -> Vec<Specimen> {
    let unit = |n| cartesian(Vec3::ZERO, Vec3::new(1.0, 1.0, 0.0), n);
    let mut zoo = Vec::new();
    let mut add = |name, measure, data| zoo.push(Specimen { name, data, measure });

    let mut squares = unit([4, 4, 0]);
    squares.mark_fracture("flat", |x| x.y == 0.5);
    squares.mark_fracture("upright", |x| x.x == 0.5 && x.y <= 0.5);
    add("squares with a T", 1.0, squares.clone());
    squares.mark_fracture("upright", |x| x.x == 0.5);
    add("perturbed quadrilaterals with an X", 1.0, perturb(&mesh(squares), 0.25, 1));
    let mut kershaw = kershaw(Vec3::ZERO, Vec3::ONE, [6, 6, 0], 0.2);
    kershaw.mark_fracture("upright", |x| (x.x - 0.5).abs() < 1e-12 && x.y > 0.2);
    add("Kershaw quadrilaterals with a tip", 1.0, kershaw);

    let network = mesh(network_plane());
    add("triangles with T, X, L, bend and tips", 3.0, network.data().clone());
    add("dual polygons with T, X, L, bend and tips", 3.0, made(dual(&network)));
    add("agglomerated triangles with T, X, L, bend and tips", 3.0, made(agglomerate(&network, 6)));

    // Two small squares right of one large, and a fracture between them that passes the hanging vertex.
    let mut hanging = MeshData::from_polygons(
        points([[0., 0.], [1., 0.], [1.5, 0.], [1., 0.5], [1.5, 0.5], [0., 1.], [1., 1.], [1.5, 1.]]),
        [vec![0, 1, 3, 6, 5], vec![1, 2, 4, 3], vec![3, 4, 7, 6]],
    );
    hanging.mark_fracture("between", |x| x.x == 1.0);
    add("hanging vertex on a fracture", 1.5, hanging);

    let e = 1e-6;
    let mut tiny = MeshData::from_polygons(
        points([[0., 0.], [1., 0.], [2., 0.], [1., 1.], [1. + e, 1.], [0., 2.], [1., 2.], [2., 2.]]),
        [vec![0, 1, 4, 3, 5], vec![1, 2, 7, 4], vec![3, 4, 7, 6, 5]],
    );
    tiny.mark_fracture("through the tiny face", |x| x.y == 1.0);
    add("tiny face", 4.0, tiny);

    let mut thin = cartesian(Vec3::ZERO, Vec3::new(1.0, 1e-4, 0.0), [2, 2, 0]);
    thin.mark_fracture("flat", |x| x.y == 0.5e-4);
    add("thin quadrilaterals", 1e-4, thin);

    let mut bent = MeshData::from_polygons(
        points([[0., 0.], [2., 0.], [4., 0.], [1., 1.], [3., 1.], [2., 1e-3], [0., 2.], [2., 2.], [4., 2.]]),
        [vec![0, 1, 5, 3], vec![1, 2, 4, 5], vec![0, 3, 5, 4, 2, 8, 7, 6]],
    );
    bent.mark_fracture("crooked", |x| x.x == 3.0 || x == Vec3::new(2.0, 1e-3, 0.0));
    add("non-convex cells, nearly touching", 8.0, bent);

    add("star around a square", 8.0, star());
    add("corner-point section with a throw", 1.0, section());
    zoo
}

/// A star with eight points around its square core, in a frame.
fn star() -> MeshData {
    let outer: Vec<[f64; 2]> = [[-1., -1.], [0., -1.], [1., -1.], [1., 0.], [1., 1.], [0., 1.], [-1., 1.], [-1., 0.]]
        .map(|[x, y]: [f64; 2]| [x * 2.0_f64.sqrt(), y * 2.0_f64.sqrt()])
        .to_vec();
    let mut vertices: Vec<Vec3> = outer.iter().map(|&[x, y]| Vec3::new(x, y, 0.0)).collect();
    for i in 0..16 {
        let angle = std::f64::consts::PI * (f64::from(i) / 8.0 - 0.75);
        let r = if i % 2 == 0 { 1.0 } else { 0.45 };
        vertices.push(Vec3::new(r * angle.cos(), r * angle.sin(), 0.0));
    }
    let mut cells = vec![(8..24).collect::<Vec<_>>()];
    for i in 0..8 {
        let star = |k: usize| 8 + (2 * i + k) % 16;
        cells.push(vec![i, (i + 1) % 8, star(2), star(1), star(0)]);
    }
    MeshData::from_polygons(vertices, cells)
}

fn network_plane() -> MeshData {
    let mut data = made(
        Triangles::rectangle([0.0, 0.0], [3.0, 1.0], 0.25)
            .fracture("x1", &[[0.2, 0.2], [0.8, 0.8]], 0.15)
            .fracture("x2", &[[0.2, 0.8], [0.8, 0.2]], 0.15)
            .fracture("t1", &[[1.2, 0.5], [1.8, 0.5]], 0.15)
            .fracture("t2", &[[1.5, 0.1], [1.5, 0.5]], 0.15)
            .fracture("l1", &[[2.2, 0.2], [2.8, 0.2]], 0.15)
            .fracture("l2", &[[2.8, 0.2], [2.8, 0.8]], 0.15)
            .fracture("bent", &[[1.9, 1.0], [2.1, 0.7], [2.6, 0.6]], 0.15)
            .interface("horizon", &[[0.0, 0.9], [3.0, 0.9]], None)
            .build(),
    );
    data.assign_regions(|x| (x.y > 0.9).then_some("cap"));
    data
}

/// A unit square in section, its layers displaced along a fault that the pillars follow.
fn section() -> MeshData {
    const HEIGHTS: [[f64; 6]; 2] = [[1.0, 0.75, 0.6, 0.4, 0.25, 0.0], [1.0, 0.75, 0.53, 0.33, 0.25, 0.0]];
    let pillar = |i: usize, j: usize| {
        let at = |x: f64, z: f64| Vec3::new(x, j as f64, z);
        let bend = [0.0, 0.5, 1.0, 0.5, 0.0][i];
        [at(0.25 * i as f64 - 0.1 * bend, 0.0), at(0.25 * i as f64 + 0.1 * bend, 1.0)]
    };
    let mut grid = CornerPoint::new([4, 1, 5], pillar, |[i, _, k], [_, _, lower]| HEIGHTS[i / 2][k + lower]);
    let name = "fault".into();
    grid.faults.push(Fault { name, first: [1, 0, 1], last: [1, 0, 3], axis: 0, upper: true });
    made(grid.build(true)).0
}

/// A cube whose layers are displaced along two faults that meet, more at one end than at the other, so that lines
/// cross between the pillars; some of these are skew, one layer is pinched out.
fn faulted() -> MeshData {
    let pillar = |i: usize, j: usize| {
        let at = |lean: f64, z: f64| {
            let inner = |n: usize| if n == 0 || n == 3 { 0.0 } else { lean };
            // Skew where there is no fracture: contact is exact on planar ones only.
            let (lean_i, lean_j) = (inner(i) * if i == 2 { 1.0 + 0.3 * j as f64 } else { 1.0 }, 0.5 * inner(j));
            Vec3::new(i as f64 / 3.0 + lean_i, j as f64 / 3.0 + lean_j, z)
        };
        [at(-0.05, 0.0), at(0.05, 1.0)]
    };
    let height = |[i, j, k]: [usize; 3], [di, dj, dk]: [usize; 3]| {
        let (x, y) = ((i + di) as f64 / 3.0, (j + dj) as f64 / 3.0);
        let level = [1.0, 0.75, 0.5, 0.4 + 0.1 * f64::max(0.0, 1.0 - 3.0 * y), 0.2, 0.0][k + dk];
        let throw = if i == 0 {
            0.35 * y - 0.17
        } else if j == 2 {
            0.4 * (x - 0.6)
        } else {
            0.0
        };
        level + throw * 2.0 * level * (1.0 - level)
    };
    let mut grid = CornerPoint::new([3, 3, 5], pillar, height);
    let mut fault = |name: &str, first, last, axis| {
        grid.faults.push(Fault { name: name.into(), first, last, axis, upper: true });
    };
    fault("along j", [0, 0, 1], [0, 2, 3], 0);
    fault("along i", [1, 1, 0], [2, 1, 4], 1);
    made(grid.build(false)).0
}

/// The meshes in three dimensions.
///
/// # Panics
/// Never: the input is fixed.
pub fn solid() -> Vec<Specimen> {
    let mut zoo = Vec::new();
    let mut add = |name, measure, data| zoo.push(Specimen { name, data, measure });
    let cube = |n: usize| cartesian(Vec3::splat(-1.0), Vec3::ONE, [n; 3]);

    let mut t = cube(4);
    t.mark_fracture("flat", |x| x.z == 0.0);
    t.mark_fracture("upright", |x| x.x == 0.0 && x.z <= 0.0);
    let t = mesh(t);
    add("cubes with a T", 8.0, t.data().clone());
    add("perturbed hexahedra with a T, faces not planar", 8.0, perturb(&t, 0.2, 2));
    let tets = mesh(made(simplices(&mesh(perturb(&t, 0.15, 3)))));
    add("tetrahedra with a T", 8.0, tets.data().clone());
    add("dual polyhedra with a T, faces not planar", 8.0, made(dual(&tets)));
    add("agglomerated tetrahedra with a T", 8.0, made(agglomerate(&tets, 8)));

    let mut planes = cube(2);
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        planes.mark_fracture(name, |x| x[axis] == 0.0);
    }
    add("three planes through one point", 8.0, planes);
    let mut corner = cube(4);
    corner.mark_fracture("flat", |x| x.z == 0.0 && x.x <= 0.0 && x.y.abs() <= 0.5);
    corner.mark_fracture("upright", |x| x.x == 0.0 && x.z <= 0.0 && x.y.abs() <= 0.5);
    add("cubes with an L and tips", 8.0, corner);
    let mut kershaw = kershaw(Vec3::ZERO, Vec3::ONE, [6, 3, 3], 0.3);
    kershaw.mark_fracture("upright", |x| (x.x - 0.5).abs() < 1e-12);
    add("Kershaw hexahedra with a fracture", 1.0, kershaw);

    // One large cube beside eight small.
    let small = cartesian(Vec3::ZERO, Vec3::new(2.0, 1.0, 1.0), [4, 2, 2]);
    let group: Vec<usize> = (0..16).map(|cell| if cell % 4 < 2 { 0 } else { cell }).collect();
    let mut hanging = unite_cells(&small, &group);
    hanging.mark_fracture("between", |x| x.x == 1.0);
    add("hanging vertices on a fracture", 2.0, hanging);

    let network = mesh(network_plane());
    let levels = [0.0, 0.3, 0.5, 0.5 + 1e-4, 1.0];
    let some = |_: &str, layer: usize| (1..3).contains(&layer);
    add("prisms with T, X, L, bend and tips, one layer thin", 3.0, made(extrude(&network, &levels, some)));
    let prisms = mesh(made(extrude(&network, &[0.0, 0.3, 0.7, 1.0], |_, layer| layer == 1)));
    let tets = mesh(made(simplices(&prisms)));
    add("tetrahedra with T, X, L, bend and tips", 3.0, tets.data().clone());
    add("dual polyhedra with T, X, L, bend and tips", 3.0, made(dual(&tets)));
    add("agglomerated tetrahedra with T, X, L, bend and tips", 3.0, made(agglomerate(&tets, 12)));
    let polygons = mesh(made(dual(&network)));
    add("prisms of polygons", 3.0, made(extrude(&polygons, &[0.0, 0.4, 1.0], |_, layer| layer == 0)));
    let tiny = plane().into_iter().find(|specimen| specimen.name == "tiny face").map(|s| mesh(s.data));
    add("tiny faces", 4.0, made(extrude(&tiny.unwrap_or_else(|| unreachable!()), &[0.0, 0.5, 1.0], |_, _| true)));
    add("star-shaped prisms", 8.0, made(extrude(&mesh(star()), &[0.0, 1.0], |_, _| true)));
    let fault = mesh(section());
    add("corner-point section with a throw, in depth", 1.0, made(extrude(&fault, &[0.0, 0.5, 1.0], |_, _| true)));
    add("corner-point grid with crossing lines and skew pillars", 1.0, faulted());

    let mut flat = tets.data().clone();
    flat.map_vertices(|x| Vec3::new(x.x, x.y, 1e-3 * x.z));
    add("flat tetrahedra", 3e-3, flat);
    zoo
}
