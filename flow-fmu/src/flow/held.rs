//! Parts that nothing but the partner holds: a sealed fracture, or tight rock, with an incompressible fluid.
//!
//! There the balance says how much the fluid's place must grow, and not at which pressure: with C = C_f = 0 in all of such a part the
//! flow alone has no solution. The pressure follows from the partner, which must be asked again and again. Where the host does
//! that, with references p* that follow the pressures until they agree, such a part is taken to give way around its reference,
//!
//! ```text
//! φ = φ* + C (p − p*),   d_f = d* + C_f (p_f − p_f*),   C ≥ b²/E,   C_f ≥ ℓ/E
//! ```
//!
//! with a stiffness E that is that of some rock and the extent ℓ of the fracture; rock with b = 0 has no partner. In the solution p = p*, and neither has a part in it:
//! what does not fit raises the pressure until it does. What is next to nothing counts as nothing, or the pressure would go through all
//! magnitudes on its way.

use std::borrow::Cow;

use mesh::Side;

use super::parts::Sets;
use super::{Flow, Inputs};
use crate::model::Control;
use crate::wells::Spot;

/// E (Pa): too small, and pressures creep; too large, and they overshoot. Newton's method on the interface makes up for some powers
/// of ten.
const ROCK: f64 = 1e10;
/// A fluid or rock that is stiffer than this (Pa) has no storage.
const STIFFEST: f64 = 1e13;
/// A way on which less than this part of what a part gives way flows in a time step is none.
const TIGHT: f64 = 1e-6;

impl Flow {
    /// Whether there are parts that only references can hold, in time steps of a second or more.
    pub fn needs_references(&self) -> bool {
        !self.without_hold(1.0, &self.inputs()).is_empty()
    }

    /// Inputs with which no part is without hold, where references are followed; `rate` is 1/δt, or 0.
    pub(super) fn held<'a>(&self, rate: f64, inputs: &'a Inputs) -> Cow<'a, Inputs> {
        let without = if inputs.references_follow && rate > 0.0 { self.without_hold(rate, inputs) } else { Vec::new() };
        if without.is_empty() {
            return Cow::Borrowed(inputs);
        }
        let mut held = inputs.clone();
        let cells = held.porosity_compliance.len();
        for (k, compliance) in without {
            let own = match k.checked_sub(cells) {
                None => &mut held.porosity_compliance[k],
                Some(i) => &mut held.aperture_compliance[i],
            };
            *own = own.max(compliance);
        }
        Cow::Owned(held)
    }

    /// Cells and, after them, fracture faces that neither have storage nor are linked, by others without, to some that have or to a
    /// given pressure; with b²/E or ℓ/E of each.
    fn without_hold(&self, rate: f64, inputs: &Inputs) -> Vec<(usize, f64)> {
        let (mesh, network) = (&self.scheme.mesh, self.scheme.mesh.network());
        let (geometry, cells) = (mesh.geometry(), mesh.cell_count());
        let mut measure = vec![0.0; mesh.data().fractures.len()];
        network.faces.iter().zip(&network.fracture).for_each(|(&f, &of)| measure[of] += geometry.face_measure[f]);
        let extent = |i: usize| measure[network.fracture[i]].powf(1.0 / (mesh.dim() - 1) as f64);
        let c_f = self.model.fluid.compressibility();
        // None where storage or a well holds the pressure.
        let of_cell = |k: usize| {
            let b = self.rocks[mesh.data().cell_region[k]].biot_coefficient;
            let is_stiff = b > 0.0 && self.storage(k) + inputs.porosity_compliance[k] < STIFFEST.recip();
            is_stiff.then_some(b * b / ROCK)
        };
        let mut compliance: Vec<Option<f64>> = (0..cells)
            .map(of_cell)
            .chain((0..network.face_count()).map(|i| {
                let d = self.state.aperture[i];
                (c_f * d + inputs.aperture_compliance[i] < d / STIFFEST).then_some(extent(i) / ROCK)
            }))
            .collect();
        for (well, control) in self.wells.iter().zip(&inputs.wells) {
            if let Control::Pressure(_) = control {
                compliance[match well.spot {
                    Spot::Cell(cell) => cell,
                    Spot::FractureFace(i) => cells + i,
                }] = None;
            }
        }
        if compliance.iter().all(Option::is_none) {
            return Vec::new();
        }
        self.links(rate, &compliance)
    }

    /// Which of the entities with a compliance are linked to none without and to no given pressure.
    fn links(&self, rate: f64, compliance: &[Option<f64>]) -> Vec<(usize, f64)> {
        let (mesh, space) = (&self.scheme.mesh, &self.scheme.space);
        let (geometry, network, cells) = (mesh.geometry(), mesh.network(), mesh.cell_count());
        let size = |k: usize| {
            let face = |i: usize| geometry.face_measure[network.faces[i]];
            k.checked_sub(cells).map_or_else(|| geometry.cell_measure[k], face)
        };
        let traces_of_face = |i: usize| {
            let face = network.faces[i];
            let sides = [Side::Plus, Side::Minus].into_iter().flat_map(move |side| space.side_traces(face, i, side));
            sides.chain(network.face_edges.get(i).iter().map(|&e| space.edge_trace(e)))
        };
        // What must flow through a trace at least (m³/(s Pa), 2D: m²/(s Pa)) so that it links; none where it links nothing.
        let mut least: Vec<Option<f64>> = vec![None; space.trace_count()];
        for (k, compliance) in compliance.iter().enumerate() {
            let Some(compliance) = compliance else { continue };
            let wanted = TIGHT * rate * compliance * size(k);
            let mut raise = |t: usize| least[t] = Some(least[t].map_or(wanted, |least: f64| least.max(wanted)));
            match k.checked_sub(cells) {
                None => space.cell_traces.get(k).iter().for_each(|&t| raise(t)),
                Some(i) => traces_of_face(i).for_each(raise),
            }
        }
        let mut sets = Sets::new(compliance.len() + least.len());
        let mut link = |k: usize, trace: usize, conductance: f64| {
            if least[trace].is_some_and(|least| conductance > least) {
                sets.join(k, compliance.len() + trace);
            }
        };
        let viscosity = self.model.fluid.viscosity;
        for cell in 0..cells {
            let permeability = self.rocks[mesh.data().cell_region[cell]].permeability;
            let traces = space.cell_traces.get(cell).iter();
            for (&trace, facet) in traces.zip(space.cell_local_facets(cell)) {
                let through = facet.vector.dot(permeability * facet.vector) / geometry.cell_measure[cell];
                link(cell, trace, through / viscosity);
            }
        }
        for i in 0..network.face_count() {
            let (d, measure) = (self.state.aperture[i], size(cells + i));
            for side in [Side::Plus, Side::Minus] {
                let across = 2.0 * measure * self.normal_permeability[i] / (viscosity * d);
                space.side_traces(network.faces[i], i, side).for_each(|t| link(cells + i, t, across));
            }
            for &e in network.face_edges.get(i) {
                let along = d.powi(3) / (12.0 * viscosity) * space.edge_length[e].powi(2) / measure;
                link(cells + i, space.edge_trace(e), along);
            }
        }
        let mut is_held = vec![false; compliance.len() + least.len()];
        for (k, _) in compliance.iter().enumerate().filter(|(_, c)| c.is_none()) {
            is_held[sets.root(k)] = true;
        }
        for datum in &self.pressures {
            is_held[sets.root(compliance.len() + datum.trace)] = true;
        }
        let own = compliance.iter().enumerate().filter_map(|(k, c)| Some((k, (*c)?)));
        own.filter(|&(k, _)| !is_held[sets.root(k)]).collect()
    }
}
