//! Boundary data on traces, and what flows in through each tag.

use mesh::{Mesh, Vec3};

use super::Flow;
use crate::model::{Condition, FlowModel, SpaceTimeFunction};
use crate::report::Inflow;
use crate::scheme::Evaluation;
use crate::space::Space;

/// A boundary datum on a trace.
#[derive(Debug)]
pub(super) struct Datum {
    pub(super) trace: usize,
    pub(super) tag: usize,
    pub(super) measure: f64,
    pub(super) point: Vec3,
    pub(super) function: SpaceTimeFunction,
}

impl Flow {
    pub(super) fn boundary_inflow(&self, evaluation: &Evaluation, inflow: &[f64]) -> Vec<Inflow> {
        let mut by_tag = vec![Inflow::default(); self.scheme.mesh.data().tags.len()];
        let facets = self.scheme.space.facet_count();
        let mut add = |d: &Datum, rate: f64| {
            let entry = &mut by_tag[d.tag];
            *(if d.trace < facets { &mut entry.matrix } else { &mut entry.fracture }) += rate;
        };
        // What arrives at a trace of given pressure leaves through it.
        self.pressures.iter().for_each(|d| add(d, -evaluation.residual[d.trace]));
        self.inflows.iter().for_each(|d| add(d, inflow[d.trace]));
        by_tag
    }
}

pub(super) fn boundary_data(mesh: &Mesh, space: &Space, model: &FlowModel) -> (Vec<Datum>, Vec<Datum>) {
    let condition_of = |face: usize| {
        let tag = mesh.data().face_tag[face]?;
        let name = &mesh.data().tags[tag];
        model.boundaries.iter().find(|b| b.0 == *name).map(|b| (tag, &b.1))
    };
    let (mut pressures, mut inflows) = (Vec::new(), Vec::new());
    let mut push = |trace, tag, measure, point, condition: &Condition| {
        let (list, function) = match condition {
            Condition::Pressure(function) => (&mut pressures, function.clone()),
            Condition::Inflow(function) => (&mut inflows, function.clone()),
        };
        list.push(Datum { trace, tag, measure, point, function });
    };
    for face in (0..mesh.face_count()).filter(|&f| mesh.is_boundary(f)) {
        if let Some((tag, boundary)) = condition_of(face) {
            for facet in space.facets(face) {
                push(facet, tag, space.facet_vector(facet).length(), space.facet_center(facet), &boundary.matrix);
            }
        }
    }
    for e in 0..mesh.network().edge_count() {
        let faces = mesh.network().edge_boundary.get(e).iter();
        let conditions: Vec<_> =
            faces.filter_map(|&f| condition_of(f)).filter_map(|(t, b)| Some((t, b.fracture_condition()?))).collect();
        let pressure = conditions.iter().find(|(_, c)| matches!(c, Condition::Pressure(_)));
        if let Some(&(tag, condition)) = pressure.or(conditions.first()) {
            push(space.edge_trace(e), tag, space.edge_length[e], space.edge_center[e], condition);
        }
    }
    (pressures, inflows)
}
