//! The bubble virtual element space.
//!
//! | entity | unknowns | meaning |
//! |---|---|---|
//! | node (vertex and class of cells around it) | u_Ks ∈ R^d | displacement seen from these cells (m) |
//! | fracture face, two-sided bubbles only | u_K⁻σ ∈ R^d | bubble on the minus side (m) |
//! | inner face off the fractures, where wanted | w_σ ∈ R | normal bubble: flux through the face over its area (m) |
//! | fracture face | ⟦u⟧_σ ∈ R^d | jump in the basis (n⁺, t₁, t₂) of the face (m) |
//!
//! The entities are numbered in this order. The literature has the bubble u_K⁺σ of the plus side where this space has the
//! jump. They determine each other through
//!
//! ```text
//! ⟦v⟧_σ,n = (1/|σ|) [Σ_s (v_K⁺s − v_K⁻s)·∫ω_s n + (v_K⁺σ − v_K⁻σ)·∫n],   ⟦v⟧_σ,τ = Σ_s ω_s^σ (v_K⁺s − v_K⁻s)_τ + (v_K⁺σ − v_K⁻σ)_τ
//! ```
//!
//! (v_K⁻σ with two-sided bubbles only), integrals over the face; on a planar face both are components of
//! Σ_s ω_s^σ (v_K⁺s − v_K⁻s) + v_K⁺σ − v_K⁻σ. The normal jump is a flux also where the face is not planar, and so what a
//! fracture takes up is what its two sides give (deviation: the literature has planar faces).
//!
//! With the jump as unknown, contact laws concern single unknowns, the multiplier is what its equation leaves
//! over, and a stiffness matrix in which all jumps are given is symmetric positive definite whatever the contact
//! states are.
//!
//! Local operators (Droniou, Enchéry, Faille, Haidar, Masson, CMAME 2024, arXiv 2312.09319, section 3; weights in
//! [`mesh::Geometry`]):
//!
//! ```text
//! ∇^K v    = Σ_i v_i ⊗ G_i,  G_s = (1/|K|) Σ_{σ∋s} |σ| ω_s^σ n_Kσ,  G_bubble = (|σ|/|K|) n_Kσ,  v_bubble = w_σ n_σ of normal ones
//! Π^K v(x) = ∇^K v (x − x_K) + Σ_s ω_s^K v_Ks
//! ```
//!
//! **Normal bubbles** make the pair of displacements and cell-wise constant pressures stable: with them div maps onto all
//! pressures as that of the Raviart–Thomas space does (the argument of Bernardi, Raugel, Math. Comp. 44, 1985, for simplices),
//! so that nothing locks where the rock is nearly incompressible or undrained and no pressure oscillates. On a boundary face
//! there is none: those of the inner faces reach every cell, and boundary data concern nodes alone.

use std::borrow::Cow;
use std::ops::Range;

use mesh::{Lists, Mat3, Mesh, Side, Vec3, tangents};

use crate::model::Bubbles;

/// A fracture face counts as planar where its vertices' normals differ by less than this part of it: round-off.
const PLANAR: f64 = 1e-12;

/// Numbering of the unknowns and what links bubbles to jumps.
#[derive(Clone, Debug)]
pub struct Space {
    dim: usize,
    node_count: usize,
    minus_bubbles: bool,
    face_count: usize,
    /// Mesh face of each normal bubble, ascending.
    normal_faces: Vec<u32>,
    /// Basis (n⁺, t₁, t₂) of each fracture face.
    basis: Vec<[Vec3; 3]>,
    /// |σ|/|∫n| of each fracture face; 1 where it is planar.
    warp: Vec<f64>,
    /// Nodes of each fracture face with their weights in the jump: ω_s^σ on the plus side, −ω_s^σ on the minus side.
    jump_nodes: Lists,
    jump_weights: Vec<JumpWeight>,
    /// Bubbles of each cell, as fracture faces.
    plus: Lists,
    minus: Lists,
}

/// What the displacement of a node adds to the jump of a fracture face.
#[derive(Clone, Copy, Debug)]
struct JumpWeight {
    /// ±ω_s^σ.
    mean: f64,
    /// ±∫ω_s n/|∫n|, for the normal component, where the face is not planar.
    flux: Option<Vec3>,
}

/// Local operators of a cell. Its functions are the nodes of the cell, its vector bubbles, and its normal bubbles.
#[derive(Clone, Debug, Default)]
pub struct CellOperators {
    /// Number of vertices; the further functions are bubbles.
    pub vertex_count: usize,
    /// Number of vertices and vector bubbles; the further functions are normal bubbles.
    pub vector_count: usize,
    /// Cell measure |K|.
    pub measure: f64,
    /// Cell diameter h_K (m).
    pub diameter: f64,
    /// G_i of each function (1/m).
    pub gradient: Vec<Vec3>,
    /// n_σ of each normal bubble.
    pub direction: Vec<Vec3>,
    /// ω_i^K of each vector function; 0 for bubbles.
    pub weight: Vec<f64>,
    /// Row s, column i: the coefficient of v_i in v_Ks − Π^K v(x_s) without normal bubbles; vertices × vector functions.
    pub residual: Vec<f64>,
}

/// The unknowns that the functions of a cell depend on.
#[derive(Clone, Debug, Default)]
pub struct CellUnknowns {
    /// Entities, those of normal bubbles last.
    pub entities: Vec<u32>,
    /// Number of entities with d unknowns; the further ones have one.
    pub vectors: usize,
    /// v = P ṽ, values of the functions × unknowns by rows; `None` for the identity.
    pub bubbles: Option<Vec<f64>>,
}

impl Space {
    /// The space on a mesh, without normal bubbles.
    pub fn new(mesh: &Mesh, bubbles: Bubbles) -> Self {
        Self::with_normal_bubbles(mesh, bubbles, |_| false)
    }

    /// The space with a normal bubble on each inner face off the fractures that `wanted` tells.
    pub fn with_normal_bubbles(mesh: &Mesh, bubbles: Bubbles, wanted: impl Fn(usize) -> bool) -> Self {
        let dim = mesh.dim();
        let network = mesh.network();
        let geometry = mesh.geometry();
        let nodes = mesh.nodes();
        let two_sided = bubbles == Bubbles::TwoSided;
        let inner = |&f: &usize| !mesh.is_boundary(f) && network.number_of_face[f].is_none();
        let normal_faces = (0..mesh.face_count()).filter(inner).filter(|&f| wanted(f)).map(|f| f as u32).collect();
        let (mut basis, mut warp) = (Vec::new(), Vec::new());
        let mut jump_nodes = Lists::new();
        let mut jump_weights = Vec::new();
        let (mut plus, mut minus) = (Vec::new(), Vec::new());
        for (i, &face) in network.faces.iter().enumerate() {
            let n = geometry.face_normal(face);
            let [t1, t2] = tangents(dim, n);
            basis.push([n, t1, t2]);
            let (first, second) = mesh.face_cells(face);
            let range = mesh.data().faces.range(face);
            let (weights, vectors) = (&geometry.face_weight[range.clone()], &geometry.face_vertex_vector[range]);
            let (measure, length) = (geometry.face_measure[face], geometry.face_vector[face].length());
            let planar = weights.iter().zip(vectors).all(|(w, v)| v.distance(w * measure * n) <= PLANAR * measure);
            warp.push(if planar { 1.0 } else { measure / length });
            let mut list = Vec::new();
            for (cell, sign) in [(Some(first), 1.0), (second, -1.0)] {
                let Some(cell) = cell else { continue };
                for ((v, w), vector) in mesh.face_vertices(face).iter().zip(weights).zip(vectors) {
                    if let Ok(k) = mesh.cell_vertices(cell).binary_search(v) {
                        list.push(nodes.of_cell(cell)[k]);
                        let flux = (!planar).then(|| sign / length * *vector);
                        jump_weights.push(JumpWeight { mean: sign * w, flux });
                    }
                }
            }
            jump_nodes.push(list);
            plus.push((first, i));
            if let (Some(second), true) = (second, two_sided) {
                minus.push((second, i));
            }
        }
        Self {
            dim,
            node_count: nodes.count(),
            minus_bubbles: two_sided,
            face_count: network.face_count(),
            normal_faces,
            basis,
            warp,
            jump_nodes,
            jump_weights,
            plus: by_cell(mesh.cell_count(), plus),
            minus: by_cell(mesh.cell_count(), minus),
        }
    }

    /// 2 or 3.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// Number of entities; there are d unknowns for each, but one for a normal bubble.
    pub fn entity_count(&self) -> usize {
        self.first_jump() + self.face_count
    }

    /// Number of unknowns.
    pub fn unknown_count(&self) -> usize {
        self.first_jump_unknown() + self.face_count * self.dim
    }

    /// The unknowns of an entity.
    pub fn unknowns_of(&self, entity: usize) -> Range<usize> {
        let (first, last) = (self.first_normal(), self.first_jump());
        let start = self.dim * entity - (self.dim - 1) * (entity.clamp(first, last) - first);
        start..start + if (first..last).contains(&entity) { 1 } else { self.dim }
    }

    /// Number of nodes, which are the first entities.
    pub fn node_count(&self) -> usize {
        self.node_count
    }

    /// Number of fracture faces, whose jumps are the last entities.
    pub fn face_count(&self) -> usize {
        self.face_count
    }

    /// Entity of normal bubble 0.
    fn first_normal(&self) -> usize {
        self.node_count + if self.minus_bubbles { self.face_count } else { 0 }
    }

    /// Entity of the jump of fracture face 0.
    pub fn first_jump(&self) -> usize {
        self.first_normal() + self.normal_faces.len()
    }

    /// The first unknown of the jumps, which are the last unknowns.
    pub fn first_jump_unknown(&self) -> usize {
        self.first_normal() * self.dim + self.normal_faces.len()
    }

    /// Number of normal bubbles.
    pub fn normal_bubble_count(&self) -> usize {
        self.normal_faces.len()
    }

    /// The faces of a cell that have a normal bubble: entity, mesh face, and 1 where n_σ is outward, else −1.
    pub fn normal_bubbles<'a>(&'a self, mesh: &'a Mesh, cell: usize) -> impl Iterator<Item = (usize, usize, f64)> + 'a {
        let faces = if self.normal_faces.is_empty() { &[][..] } else { mesh.cell_faces(cell) };
        faces.iter().zip(mesh.cell_face_signs(cell)).filter_map(move |(&face, &sign)| {
            let number = self.normal_faces.binary_search(&(face as u32)).ok()?;
            Some((self.first_normal() + number, face, sign))
        })
    }

    /// Basis (n⁺, t₁, t₂) of a fracture face; in 2D the last is not used.
    pub fn basis(&self, face: usize) -> &[Vec3; 3] {
        &self.basis[face]
    }

    /// Local operators of a cell.
    pub fn operators(&self, mesh: &Mesh, cell: usize) -> CellOperators {
        let mut operators = CellOperators::default();
        self.fill_operators(mesh, cell, &mut operators);
        operators
    }

    /// As [`operators`](Self::operators), in the storage of an earlier cell.
    pub(crate) fn fill_operators(&self, mesh: &Mesh, cell: usize, out: &mut CellOperators) {
        let geometry = mesh.geometry();
        let vertices = mesh.cell_vertices(cell);
        let n = vertices.len();
        let center = geometry.cell_center[cell];
        let CellOperators { gradient, direction, weight, residual, .. } = out;
        self.fill_gradients(mesh, cell, gradient, direction);
        let m = gradient.len() - direction.len();
        weight.clear();
        weight.extend_from_slice(&geometry.cell_weight[mesh.cell_vertex_lists().range(cell)]);
        weight.resize(m, 0.0);
        residual.clear();
        let first = first_with_residual(self.dim, n);
        for (s, &v) in vertices.iter().enumerate() {
            let arm = mesh.vertices()[v] - center;
            residual.resize(s * m + first, 0.0);
            residual.extend((first..m).map(|i| f64::from(i == s) - gradient[i].dot(arm) - weight[i]));
        }
        (out.vertex_count, out.vector_count) = (n, m);
        (out.measure, out.diameter) = (geometry.cell_measure[cell], geometry.cell_diameter[cell]);
    }

    /// G_i of each function of a cell, and n_σ of its normal bubbles.
    pub(crate) fn fill_gradients(&self, mesh: &Mesh, cell: usize, gradient: &mut Vec<Vec3>, direction: &mut Vec<Vec3>) {
        let geometry = mesh.geometry();
        let vertices = mesh.cell_vertices(cell);
        let measure = geometry.cell_measure[cell];
        gradient.clear();
        gradient.resize(vertices.len(), Vec3::ZERO);
        for (&face, &sign) in mesh.cell_faces(cell).iter().zip(mesh.cell_face_signs(cell)) {
            let vectors = &geometry.face_vertex_vector[mesh.data().faces.range(face)];
            for (v, &vector) in mesh.face_vertices(face).iter().zip(vectors) {
                if let Ok(k) = vertices.binary_search(v) {
                    gradient[k] += sign / measure * vector;
                }
            }
        }
        let faces = &mesh.network().faces;
        for (list, sign) in [(self.plus.get(cell), 1.0), (self.minus.get(cell), -1.0)] {
            gradient.extend(list.iter().map(|&i| sign / measure * geometry.face_vector[faces[i]]));
        }
        direction.clear();
        for (_, face, sign) in self.normal_bubbles(mesh, cell) {
            gradient.push(sign / measure * geometry.face_vector[face]);
            direction.push(geometry.face_normal(face));
        }
    }

    /// The unknowns that a cell's functions depend on.
    pub fn unknowns(&self, mesh: &Mesh, cell: usize) -> CellUnknowns {
        let mut unknowns = CellUnknowns::default();
        self.fill_unknowns(mesh, cell, &mut unknowns);
        unknowns
    }

    /// As [`unknowns`](Self::unknowns), in the storage of an earlier cell.
    pub(crate) fn fill_unknowns(&self, mesh: &Mesh, cell: usize, out: &mut CellUnknowns) {
        let own = mesh.nodes().of_cell(cell);
        let (plus, minus) = (self.plus.get(cell), self.minus.get(cell));
        let d = self.dim;
        out.entities.clear();
        out.entities.extend(own.iter().map(|&e| e as u32));
        out.vectors = own.len();
        out.bubbles = None;
        let normal = |entities: &mut Vec<u32>| {
            entities.extend(self.normal_bubbles(mesh, cell).map(|(entity, ..)| entity as u32));
        };
        if plus.is_empty() && minus.is_empty() {
            normal(&mut out.entities);
            return;
        }
        let mut entities: Vec<usize> = own.to_vec();
        // Terms of the bubbles: what an entity adds to a function.
        let mut terms: Vec<(usize, usize, Mat3)> = Vec::new();
        let mut function = own.len();
        for &i in plus {
            let weights = &self.jump_weights[self.jump_nodes.range(i)];
            let nodes = self.jump_nodes.get(i).iter().zip(weights);
            terms.extend(nodes.map(|(&node, w)| (function, node, w.in_bubble(self.basis[i][0]))));
            if self.minus_bubbles {
                terms.push((function, self.node_count + i, Mat3::IDENTITY));
            }
            function += 1;
        }
        for &i in minus {
            terms.push((function, self.node_count + i, Mat3::IDENTITY));
            function += 1;
        }
        for &(_, entity, _) in &terms {
            if !entities.contains(&entity) {
                entities.push(entity);
            }
        }
        let before_jumps = entities.len();
        entities.extend(plus.iter().map(|&i| self.first_jump() + i));
        out.entities.extend(entities[own.len()..].iter().map(|&e| e as u32));
        out.vectors = entities.len();
        normal(&mut out.entities);
        let normal_count = out.entities.len() - out.vectors;
        let width = out.vectors * d + normal_count;
        let mut p = vec![0.0; (function * d + normal_count) * width];
        for a in 0..own.len() * d {
            p[a * width + a] = 1.0;
        }
        for (function, entity, weight) in terms {
            let column = entities.iter().position(|&e| e == entity).unwrap_or_else(|| unreachable!("listed above"));
            for a in 0..d {
                for b in 0..d {
                    p[(function * d + a) * width + column * d + b] += weight.col(b)[a];
                }
            }
        }
        for (k, &i) in plus.iter().enumerate() {
            for c in 0..d {
                let stretch = if c == 0 { self.warp[i] } else { 1.0 };
                for a in 0..d {
                    p[((own.len() + k) * d + a) * width + (before_jumps + k) * d + c] = stretch * self.basis[i][c][a];
                }
            }
        }
        for k in 0..normal_count {
            p[(function * d + k) * width + out.vectors * d + k] = 1.0;
        }
        out.bubbles = Some(p);
    }

    /// Number of unknowns that a cell's functions depend on.
    pub(crate) fn cell_unknown_count(&self, mesh: &Mesh, cell: usize) -> usize {
        if self.plus.get(cell).is_empty() && self.minus.get(cell).is_empty() {
            self.dim * mesh.nodes().of_cell(cell).len() + self.normal_bubbles(mesh, cell).count()
        } else {
            let CellUnknowns { entities, vectors, .. } = self.unknowns(mesh, cell);
            vectors * self.dim + entities.len() - vectors
        }
    }

    /// The side of a fracture face on which a cell has a bubble of its own.
    pub fn bubble_sides(&self, cell: usize) -> impl Iterator<Item = (usize, Side)> + '_ {
        let plus = self.plus.get(cell).iter().map(|&i| (i, Side::Plus));
        plus.chain(self.minus.get(cell).iter().map(|&i| (i, Side::Minus)))
    }
}

/// The second of each pair by the first, a cell.
fn by_cell(cells: usize, mut pairs: Vec<(usize, usize)>) -> Lists {
    pairs.sort_unstable();
    let mut pairs = pairs.into_iter().peekable();
    let own = |cell| std::iter::from_fn(|| pairs.next_if(|pair| pair.0 == cell)).map(|pair| pair.1).collect::<Vec<_>>();
    (0..cells).map(own).collect()
}

/// The first function of a cell that Π^K may not reproduce: on a simplex it reproduces those of all vertices.
pub(crate) fn first_with_residual(dim: usize, vertices: usize) -> usize {
    if vertices == dim + 1 { vertices } else { 0 }
}

impl JumpWeight {
    /// What a node's displacement adds to the bubble on the plus side of a face of normal n where the jump is given: −ω_s on a
    /// planar face, elsewhere −n ⊗ ∫ω_s n/|∫n| − ω_s (I − n ⊗ n).
    fn in_bubble(&self, n: Vec3) -> Mat3 {
        let outer = |a: Vec3, b: Vec3| Mat3::from_cols(b.x * a, b.y * a, b.z * a);
        let mean = Mat3::from_diagonal(Vec3::splat(-self.mean));
        self.flux.map_or(mean, |flux| mean + outer(n, self.mean * n - flux))
    }
}

impl CellUnknowns {
    /// The entity of the unknown with this number in the cell.
    pub(crate) fn entity_of(&self, dim: usize, unknown: usize) -> u32 {
        let vectors = self.vectors * dim;
        self.entities[if unknown < vectors { unknown / dim } else { unknown - vectors + self.vectors }]
    }

    /// Pᵀ A P for a matrix over the cell's functions: (entities·d)² by rows.
    pub fn reduce_matrix<'a>(&self, a: &'a [f64]) -> Cow<'a, [f64]> {
        let Some(p) = &self.bubbles else { return Cow::Borrowed(a) };
        let rows = a.len().isqrt();
        let width = p.len() / rows;
        let mut ap = vec![0.0; rows * width];
        for i in 0..rows {
            for k in 0..rows {
                let v = a[i * rows + k];
                for j in 0..width {
                    ap[i * width + j] += v * p[k * width + j];
                }
            }
        }
        let mut out = vec![0.0; width * width];
        for k in 0..rows {
            for i in 0..width {
                let v = p[k * width + i];
                if v != 0.0 {
                    for j in 0..width {
                        out[i * width + j] += v * ap[k * width + j];
                    }
                }
            }
        }
        Cow::Owned(out)
    }

    /// Pᵀ v for a functional over the cell's functions.
    pub fn reduce_vector(&self, v: Vec<f64>) -> Vec<f64> {
        let Some(p) = &self.bubbles else { return v };
        let width = p.len() / v.len();
        let mut out = vec![0.0; width];
        for (row, v) in p.chunks_exact(width).zip(v) {
            for (o, p) in out.iter_mut().zip(row) {
                *o += p * v;
            }
        }
        out
    }
}
