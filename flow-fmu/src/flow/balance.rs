//! How well volume is conserved.

use serde::{Deserialize, Serialize};

use super::Flow;
use crate::report::StepReport;
use crate::scheme::{Coefficients, Evaluation};

/// How well volume is conserved (m³/s, 2D: m²/s), with one flux for both sides of each facet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Balance {
    /// Largest error of a cell.
    pub cell: f64,
    /// Largest error of a fracture face.
    pub fracture_face: f64,
    /// Largest sum of outflows into a fracture edge.
    pub edge: f64,
    /// Storage − sources − wells − inflow of the whole.
    pub total: f64,
    /// Largest volume rate through a cell or fracture face.
    pub throughput: f64,
    /// What one unit of round-off in a pressure can make of a balance: the errors are some of these. It is far below
    /// the throughput unless pressures are large and differ little.
    pub round_off: f64,
}

impl Flow {
    pub(super) fn balance(
        &self,
        c: &Coefficients,
        report: &StepReport,
        traces: &[f64],
        evaluation: &Evaluation,
        face_flux: &[f64],
    ) -> Balance {
        let (mesh, space) = (&self.scheme.mesh, &self.scheme.space);
        let network = mesh.network();
        let mut balance = Balance { round_off: f64::EPSILON * evaluation.size, ..Balance::default() };
        // Storage − sources, wells included.
        let mut whole = 0.0;
        for cell in 0..mesh.cell_count() {
            let net = c.cell_diagonal[cell] * evaluation.matrix_pressure[cell] - c.cell_source[cell];
            let (mut sum, mut size) = (net, net.abs());
            for (&face, &sign) in mesh.cell_faces(cell).iter().zip(mesh.cell_face_signs(cell)) {
                let flux = match (network.number_of_face[face], sign > 0.0) {
                    (Some(i), plus) => evaluation.exchange[i][usize::from(!plus)],
                    (None, _) => sign * face_flux[face],
                };
                sum += flux;
                size += flux.abs();
            }
            whole += net;
            balance.cell = balance.cell.max(sum.abs());
            balance.throughput = balance.throughput.max(0.5 * size);
        }
        let mut at_edge = vec![0.0; network.edge_count()];
        for i in 0..network.face_count() {
            let net = c.fracture_diagonal[i] * traces[space.fracture_trace(i)] - c.fracture_source[i];
            let [plus, minus] = evaluation.exchange[i];
            let (mut sum, mut size) = (net - plus - minus, net.abs() + plus.abs() + minus.abs());
            for (&e, k) in network.face_edges.get(i).iter().zip(network.face_edges.range(i)) {
                let flux = evaluation.edge_flux[k];
                sum += flux;
                size += flux.abs();
                at_edge[e] += flux;
            }
            whole += net;
            balance.fracture_face = balance.fracture_face.max(sum.abs());
            balance.throughput = balance.throughput.max(0.5 * size);
        }
        let first = space.edge_trace(0);
        self.pressures.iter().filter(|d| d.trace >= first).for_each(|d| at_edge[d.trace - first] = 0.0);
        for d in self.inflows.iter().filter(|d| d.trace >= first) {
            at_edge[d.trace - first] += d.measure * d.function.at(d.point, report.time);
        }
        balance.edge = at_edge.iter().fold(0.0, |m, v| m.max(v.abs()));
        let through_boundary: f64 = report.inflow.iter().map(|i| i.matrix + i.fracture).sum();
        balance.total = (whole - through_boundary).abs();
        balance
    }
}
