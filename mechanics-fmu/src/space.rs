//! The bubble virtual element space.
//!
//! | entity | unknowns | meaning |
//! |---|---|---|
//! | node (vertex and class of cells around it) | u_Ks ∈ R^d | displacement seen from these cells (m) |
//! | fracture face, two-sided bubbles only | u_K⁻σ ∈ R^d | bubble on the minus side (m) |
//! | fracture face | ⟦u⟧_σ ∈ R^d | jump in the basis (n⁺, t₁, t₂) of the face (m) |
//!
//! The entities are numbered in this order, d unknowns each. The literature has the bubble u_K⁺σ of the plus
//! side where this space has the jump. They determine each other through
//!
//! ```text
//! ⟦v⟧_σ = Σ_s ω_s^σ (v_K⁺s − v_K⁻s) + v_K⁺σ (− v_K⁻σ if two-sided)
//! ```
//!
//! With the jump as unknown, contact laws concern single unknowns, the multiplier is what its equation leaves
//! over, and a stiffness matrix in which all jumps are given is symmetric positive definite whatever the contact
//! states are.
//!
//! Local operators (Droniou, Enchéry, Faille, Haidar, Masson, CMAME 2024, arXiv 2312.09319, section 3; weights in
//! [`mesh::Geometry`]):
//!
//! ```text
//! ∇^K v    = Σ_i v_i ⊗ G_i,  G_s = (1/|K|) Σ_{σ∋s} |σ| ω_s^σ n_Kσ,  G_bubble = (|σ|/|K|) n_Kσ
//! Π^K v(x) = ∇^K v (x − x_K) + Σ_s ω_s^K v_Ks
//! a_K(u,v) = |K| (2μ ε:ε + λ div div) + s_K S_K(u,v)
//! S_K(u,v) = Σ_s (u_Ks − Π^K u(x_s))·(v_Ks − Π^K v(x_s)) + Σ_bubbles u_Kσ·v_Kσ
//! s_K      = ⅔ (1 + 1/d) μ (h_K/(2√d))^{d−2}
//! ```
//!
//! The literature has s_K = h_K^{d−2} (2μ+λ). Any multiple serves its theory, but that one is far too stiff: 3 times in
//! 2D and 12 times in 3D at λ = μ. Ours is derived: on a square or cube, with a = h_K/(2√d) half its edge, S_K gives the
//! functions ξη c, which Π^K does not see, the shear energy that they have as (bi-, tri-)linear functions,
//!
//! ```text
//! ∫ 2μ ε(ξη c):ε(ξη c) = μ ∫ |∇ξη|² |c|² + (∇ξη·c)² = ⅔ 2^d a^{d−2} μ (1 + 1/d) |c|²   (mean over the directions of c),
//! ```
//!
//! where S_K(ξη c, ξη c) = 2^d |c|². Their change of volume is left out, as in reduced integration, so that nearly
//! incompressible rock does not lock.

use std::borrow::Cow;

use mesh::{Lists, Mesh, Side, Vec3, tangents};

use crate::model::Bubbles;

/// Numbering of the unknowns and what links bubbles to jumps.
#[derive(Clone, Debug)]
pub struct Space {
    dim: usize,
    node_count: usize,
    minus_bubbles: bool,
    face_count: usize,
    /// Basis (n⁺, t₁, t₂) of each fracture face.
    basis: Vec<[Vec3; 3]>,
    /// Nodes of each fracture face with their weights in the jump: ω_s^σ on the plus side, −ω_s^σ on the minus side.
    jump_nodes: Lists,
    jump_weights: Vec<f64>,
    /// Bubbles of each cell, as fracture faces.
    plus: Lists,
    minus: Lists,
}

/// Local operators of a cell. Its functions are the nodes of the cell and then its bubbles.
#[derive(Clone, Debug, Default)]
pub struct CellOperators {
    /// Number of vertices; the further functions are bubbles.
    pub vertex_count: usize,
    /// Cell measure |K|.
    pub measure: f64,
    /// Cell diameter h_K (m).
    pub diameter: f64,
    /// G_i of each function (1/m).
    pub gradient: Vec<Vec3>,
    /// ω_i^K of each function; 0 for bubbles.
    pub weight: Vec<f64>,
    /// Row s, column i: the coefficient of v_i in v_Ks − Π^K v(x_s); vertices × functions.
    pub residual: Vec<f64>,
}

/// The unknowns that the functions of a cell depend on.
#[derive(Clone, Debug, Default)]
pub struct CellUnknowns {
    /// Entities, d unknowns each.
    pub entities: Vec<u32>,
    /// v = P ṽ, (functions·d) × (entities·d) by rows; `None` for the identity.
    pub bubbles: Option<Vec<f64>>,
}

impl Space {
    /// The space on a mesh.
    pub fn new(mesh: &Mesh, bubbles: Bubbles) -> Self {
        let dim = mesh.dim();
        let network = mesh.network();
        let geometry = mesh.geometry();
        let nodes = mesh.nodes();
        let two_sided = bubbles == Bubbles::TwoSided;
        let mut basis = Vec::new();
        let mut jump_nodes = Lists::new();
        let mut jump_weights = Vec::new();
        let (mut plus, mut minus) = (Vec::new(), Vec::new());
        for (i, &face) in network.faces.iter().enumerate() {
            let n = geometry.face_normal(face);
            let [t1, t2] = tangents(dim, n);
            basis.push([n, t1, t2]);
            let (first, second) = mesh.face_cells(face);
            let weights = &geometry.face_weight[mesh.data().faces.range(face)];
            let mut list = Vec::new();
            for (cell, sign) in [(Some(first), 1.0), (second, -1.0)] {
                let Some(cell) = cell else { continue };
                for (v, w) in mesh.face_vertices(face).iter().zip(weights) {
                    if let Ok(k) = mesh.cell_vertices(cell).binary_search(v) {
                        list.push(nodes.of_cell(cell)[k]);
                        jump_weights.push(sign * w);
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
            basis,
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

    /// Number of entities; there are d unknowns for each.
    pub fn entity_count(&self) -> usize {
        self.first_jump() + self.face_count
    }

    /// Number of nodes, which are the first entities.
    pub fn node_count(&self) -> usize {
        self.node_count
    }

    /// Number of fracture faces, whose jumps are the last entities.
    pub fn face_count(&self) -> usize {
        self.face_count
    }

    /// Entity of the jump of fracture face 0.
    pub fn first_jump(&self) -> usize {
        self.node_count + if self.minus_bubbles { self.face_count } else { 0 }
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
        let CellOperators { gradient, weight, residual, .. } = out;
        self.fill_gradients(mesh, cell, gradient);
        let m = gradient.len();
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
        (out.vertex_count, out.measure, out.diameter) = (n, geometry.cell_measure[cell], geometry.cell_diameter[cell]);
    }

    /// G_i of each function of a cell.
    pub(crate) fn fill_gradients(&self, mesh: &Mesh, cell: usize, gradient: &mut Vec<Vec3>) {
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
        out.entities.clear();
        out.entities.extend(own.iter().map(|&e| e as u32));
        out.bubbles = None;
        if plus.is_empty() && minus.is_empty() {
            return;
        }
        let mut entities: Vec<usize> = own.to_vec();
        let d = self.dim;
        // Terms of the bubbles: (function, entity, weight), or the jump with the basis as weight.
        let mut terms: Vec<(usize, usize, f64)> = Vec::new();
        let mut function = own.len();
        for &i in plus {
            let weights = &self.jump_weights[self.jump_nodes.range(i)];
            terms.extend(self.jump_nodes.get(i).iter().zip(weights).map(|(&node, &w)| (function, node, -w)));
            if self.minus_bubbles {
                terms.push((function, self.node_count + i, 1.0));
            }
            function += 1;
        }
        for &i in minus {
            terms.push((function, self.node_count + i, 1.0));
            function += 1;
        }
        for &(_, entity, _) in &terms {
            if !entities.contains(&entity) {
                entities.push(entity);
            }
        }
        let before_jumps = entities.len();
        entities.extend(plus.iter().map(|&i| self.first_jump() + i));
        let width = entities.len() * d;
        let mut p = vec![0.0; function * d * width];
        for a in 0..own.len() * d {
            p[a * width + a] = 1.0;
        }
        for (function, entity, weight) in terms {
            let column = entities.iter().position(|&e| e == entity).unwrap_or_else(|| unreachable!("listed above"));
            for a in 0..d {
                p[(function * d + a) * width + column * d + a] += weight;
            }
        }
        for (k, &i) in plus.iter().enumerate() {
            for c in 0..d {
                for a in 0..d {
                    p[((own.len() + k) * d + a) * width + (before_jumps + k) * d + c] = self.basis[i][c][a];
                }
            }
        }
        out.entities.extend(entities[own.len()..].iter().map(|&e| e as u32));
        out.bubbles = Some(p);
    }

    /// Number of entities that a cell's functions depend on.
    pub(crate) fn cell_entity_count(&self, mesh: &Mesh, cell: usize) -> usize {
        if self.plus.get(cell).is_empty() && self.minus.get(cell).is_empty() {
            mesh.nodes().of_cell(cell).len()
        } else {
            self.unknowns(mesh, cell).entities.len()
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
fn first_with_residual(dim: usize, vertices: usize) -> usize {
    if vertices == dim + 1 { vertices } else { 0 }
}

impl CellOperators {
    /// a_K for Lamé's parameters λ, μ (Pa), with `extra` ≥ 0 (Pa) added to λ in the consistent part only:
    /// (functions·d)² by rows.
    pub fn stiffness(&self, dim: usize, lambda: f64, mu: f64, extra: f64) -> Vec<f64> {
        let mut a = Vec::new();
        self.fill_stiffness(dim, lambda, mu, extra, &mut a);
        a
    }

    pub(crate) fn fill_stiffness(&self, dim: usize, lambda: f64, mu: f64, extra: f64, a: &mut Vec<f64>) {
        match dim {
            2 => self.fill::<2>(lambda, mu, extra, a),
            _ => self.fill::<3>(lambda, mu, extra, a),
        }
    }

    fn fill<const D: usize>(&self, lambda: f64, mu: f64, extra: f64, a: &mut Vec<f64>) {
        let m = self.gradient.len();
        let width = m * D;
        a.clear();
        a.resize(width * width, 0.0);
        let volume = self.measure;
        let d = D as f64;
        let half_edge = self.diameter / (2.0 * d.sqrt());
        let penalty = 2.0 / 3.0 * (1.0 + 1.0 / d) * mu * half_edge.powi(D as i32 - 2);
        let [shear, consistent] = [volume * mu, volume * (lambda + extra)];
        let first = first_with_residual(D, self.vertex_count);
        for i in 0..m {
            let gi = self.gradient[i].to_array();
            for j in 0..=i {
                let gj = self.gradient[j].to_array();
                let mut diagonal = shear * self.gradient[i].dot(self.gradient[j]);
                if j >= first {
                    let mut s = f64::from(i == j && i >= self.vertex_count);
                    for row in self.residual.chunks_exact(m) {
                        s += row[i] * row[j];
                    }
                    diagonal += penalty * s;
                }
                for b in 0..D {
                    for c in 0..D {
                        let mut v = shear * gi[c] * gj[b] + consistent * gi[b] * gj[c];
                        if b == c {
                            v += diagonal;
                        }
                        a[(i * D + b) * width + j * D + c] = v;
                        a[(j * D + c) * width + i * D + b] = v;
                    }
                }
            }
        }
    }
}

impl CellUnknowns {
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
