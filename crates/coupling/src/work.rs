//! What a unit tells of the work it has done: local variables, which any unit may have and none must.

use std::time::{Duration, Instant};

use fmi_unit::{Type, Variable};
use serde::{Deserialize, Serialize};

use crate::{GetNumbered, Table};

/// Wall seconds, and counts, of an instance's computing since it was made. They are no part of its state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Work {
    /// Seconds of all computing: set-up, time steps, derivatives, sensitivities. What a host waits beyond that is the
    /// interface's.
    pub total: f64,
    /// Of it, seconds of fill-reducing orders and symbolic analyses.
    pub analysis: f64,
    /// Seconds of local matrices and their sums.
    pub assembly: f64,
    /// Seconds of factorisations.
    pub factorisation: f64,
    /// Seconds of triangular solves: both halves, with a whole factor.
    pub solves: f64,
    /// Seconds of Newton's method and linearised problems on the fracture.
    pub newton: f64,
    /// Number of factorisations.
    pub factorisations: f64,
    /// Number of triangular solves.
    pub solve_count: f64,
}

/// A row of [`WORK`].
#[derive(Clone, Copy)]
pub struct WorkVariable {
    /// Name of the variable.
    pub name: &'static str,
    /// Unit of measure.
    pub unit: &'static str,
    /// What it is.
    pub meaning: &'static str,
    /// Its place in [`Work`].
    pub place: fn(&mut Work) -> &mut f64,
}

/// The variables that [`Work`] is told by.
pub const WORK: [WorkVariable; 8] = [
    row("work.total", "s", "Wall seconds of computing since the instance was made", |w| &mut w.total),
    row("work.analysis", "s", "Of them, orders and symbolic analyses", |w| &mut w.analysis),
    row("work.assembly", "s", "Of them, assembly", |w| &mut w.assembly),
    row("work.factorisation", "s", "Of them, factorisations", |w| &mut w.factorisation),
    row("work.solves", "s", "Of them, triangular solves", |w| &mut w.solves),
    row("work.newton", "s", "Of them, Newton's method and linearised problems on the fracture", |w| &mut w.newton),
    row("work.factorisation_count", "1", "Factorisations since the instance was made", |w| &mut w.factorisations),
    row("work.solve_count", "1", "Triangular solves since the instance was made", |w| &mut w.solve_count),
];

const fn row(
    name: &'static str,
    unit: &'static str,
    meaning: &'static str,
    place: fn(&mut Work) -> &mut f64,
) -> WorkVariable {
    WorkVariable { name, unit, meaning, place }
}

impl<U: Worker> Table<U> {
    /// Adds the variables of [`WORK`], as locals.
    pub fn work(&mut self) {
        for (number, WorkVariable { name, unit, meaning, .. }) in WORK.into_iter().enumerate() {
            let make = |r| Variable::local(r, name, Type::Float64).unit(unit).describe(meaning);
            let get: GetNumbered<U> = |u, number, values| values.write(&[*(WORK[number].place)(&mut u.work())]);
            self.add_numbered(None, number, make, get, None);
        }
    }
}

/// A unit that tells of its work.
pub trait Worker {
    /// What it has done up to now.
    fn work(&self) -> Work;
}

/// Computes in the pool of threads, and adds the wall time. From outside of the pool each parallel loop would be handed over
/// to it, which takes longer than many of them.
pub fn timed<T: Send>(sum: &mut Duration, act: impl FnOnce() -> T + Send) -> T {
    let clock = Instant::now();
    let result = rayon::scope(|_| act());
    *sum += clock.elapsed();
    result
}
