//! What wells do in a time step: rate, pressure, limits.

use super::{Flow, Inputs};
use crate::model::Control;
use crate::report::WellReport;
use crate::scheme::{Coefficients, Evaluation};
use crate::wells::{Placed, Spot};

impl Flow {
    /// W/η; `None` for a well of which only the rate is known.
    pub(super) fn well_mobility(&self, well: &Placed) -> Option<f64> {
        well.mobility(self.model.fluid.viscosity, |i| self.state.aperture[i])
    }

    /// What a well does, given whether it is at its limit.
    pub(super) fn active(&self, well: usize, inputs: &Inputs, limited: &[bool]) -> Control {
        match (self.model.wells[well].limit, limited[well]) {
            (Some(limit), true) => Control::Pressure(limit),
            _ => inputs.wells[well],
        }
    }

    pub(super) fn add_wells(&self, c: &mut Coefficients, inputs: &Inputs, limited: &[bool]) {
        for (w, well) in self.wells.iter().enumerate() {
            let (diagonal, source) = match well.spot {
                Spot::Cell(cell) => (&mut c.cell_diagonal[cell], &mut c.cell_source[cell]),
                Spot::FractureFace(i) => (&mut c.fracture_diagonal[i], &mut c.fracture_source[i]),
            };
            match self.active(w, inputs, limited) {
                Control::Rate(q) => *source += q,
                Control::Pressure(p) => {
                    // Inputs and limits are checked: it has one, and it is positive.
                    let mobility = self.well_mobility(well).unwrap_or_default();
                    *diagonal += mobility;
                    *source += mobility * p;
                }
            }
        }
    }

    pub(super) fn pressure_at(&self, spot: Spot, evaluation: &Evaluation, traces: &[f64]) -> f64 {
        match spot {
            Spot::Cell(cell) => evaluation.matrix_pressure[cell],
            Spot::FractureFace(i) => traces[self.scheme.space.fracture_trace(i)],
        }
    }

    pub(super) fn well_reports(
        &self,
        inputs: &Inputs,
        limited: &[bool],
        evaluation: &Evaluation,
        traces: &[f64],
    ) -> Vec<WellReport> {
        (self.wells.iter().enumerate())
            .map(|(w, well)| {
                let p = self.pressure_at(well.spot, evaluation, traces);
                let mobility = self.well_mobility(well);
                let (rate, pressure) = match self.active(w, inputs, limited) {
                    Control::Rate(q) => (q, p + mobility.map_or(0.0, |mobility| q / mobility)),
                    Control::Pressure(held) => (mobility.map_or(0.0, |mobility| mobility * (held - p)), held),
                };
                WellReport { rate, pressure, limited: limited[w] }
            })
            .collect()
    }

    /// Which wells are to be held at their limits, after what they did.
    pub(super) fn limits(&self, inputs: &Inputs, reports: &[WellReport]) -> Vec<bool> {
        (reports.iter().enumerate())
            .map(|(w, report)| match (inputs.wells[w], self.model.wells[w].limit) {
                (Control::Rate(q), Some(limit)) => {
                    let sign = if q < 0.0 { -1.0 } else { 1.0 };
                    if report.limited {
                        // It stays while the limit lets less through than is wanted.
                        sign * report.rate < sign * q
                    } else {
                        sign * report.pressure > sign * limit
                    }
                }
                _ => false,
            })
            .collect()
    }
}
