//! Volume rates of a solved time step.

use mesh::Vec3;

use super::Flow;
use crate::error::FlowError;
use crate::scheme::Evaluation;

/// Volume rates of the last time step, m³/s (2D: m²/s).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fluxes {
    /// Each mesh face, out of its first cell; on a fracture face out of the plus cell into the fracture.
    pub face: Vec<f64>,
    /// Each fracture face, from plus and from minus cell into it.
    pub exchange: Vec<[f64; 2]>,
    /// Out of each fracture face through its edges, aligned with the network's lists of edges of faces.
    pub fracture_edge: Vec<f64>,
    /// (1/|K|) ∫ V over each cell (m/s), for plots: Σ_i F_Ki (x_i − x_K)/|K|, exact for a uniform flux.
    pub cell_velocity: Vec<mesh::Vec3>,
    /// The same over each fracture face, times its aperture (m²/s).
    pub fracture_velocity: Vec<mesh::Vec3>,
}

impl Flow {
    /// Volume rates of the last time step.
    ///
    /// # Errors
    /// [`FlowError::NothingSolved`] before the first time step, after [`set_state`](Self::set_state) and
    /// [`resume`](Self::resume).
    pub fn fluxes(&self) -> Result<&Fluxes, FlowError> {
        let solved = self.solved.as_ref().and_then(|s| Some((s.end.as_ref()?, &s.fluxes)));
        let ((evaluation, face), fluxes) = solved.ok_or(FlowError::NothingSolved)?;
        Ok(fluxes.get_or_init(|| self.fluxes_of(evaluation, face)))
    }

    /// One flux for both sides of each face; on fracture faces that of the plus side.
    pub(super) fn face_fluxes(&self, evaluation: &Evaluation, inflow: &[f64]) -> Vec<f64> {
        let (mesh, space, network) = (&self.scheme.mesh, &self.scheme.space, self.scheme.mesh.network());
        let mut fluxes = vec![0.0; mesh.face_count()];
        // Whether the flux of a boundary facet is given: nothing flows where nothing is said.
        let mut given = vec![true; space.facet_count()];
        for datum in self.pressures.iter().filter(|d| d.trace < space.facet_count()) {
            given[datum.trace] = false;
        }
        for (&(facet, sign), flux) in space.cell_facets.iter().zip(&evaluation.cell_flux) {
            let face = space.face_of_facet(facet);
            fluxes[face] += match (mesh.is_boundary(face), given[facet]) {
                (false, _) => 0.5 * sign * flux,
                (true, false) => sign * flux,
                (true, true) => -inflow[facet],
            };
        }
        for (&face, exchange) in network.faces.iter().zip(&evaluation.exchange) {
            fluxes[face] = exchange[0];
        }
        fluxes
    }

    pub(super) fn fluxes_of(&self, evaluation: &Evaluation, face: &[f64]) -> Fluxes {
        let (mesh, space) = (&self.scheme.mesh, &self.scheme.space);
        let (geometry, network) = (mesh.geometry(), mesh.network());
        let mut fluxes = Fluxes {
            face: face.to_vec(),
            exchange: evaluation.exchange.clone(),
            fracture_edge: evaluation.edge_flux.clone(),
            ..Fluxes::default()
        };
        for cell in 0..mesh.cell_count() {
            let moment = |k: usize| {
                evaluation.cell_flux[k] * (space.facet_center(space.cell_facets[k].0) - space.cell_point[cell])
            };
            let moments: Vec3 = space.cell_traces.range(cell).map(moment).sum();
            fluxes.cell_velocity.push(moments / geometry.cell_measure[cell]);
        }
        for (i, &face) in network.faces.iter().enumerate() {
            let edges = network.face_edges.get(i).iter().zip(network.face_edges.range(i));
            let moment: Vec3 =
                edges.map(|(&e, k)| evaluation.edge_flux[k] * (space.edge_center[e] - space.fracture_point[i])).sum();
            fluxes.fracture_velocity.push(moment / geometry.face_measure[face]);
        }
        fluxes
    }
}
