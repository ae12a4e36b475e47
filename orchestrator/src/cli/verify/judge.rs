//! Holds claims against a run, time step by time step.

use mesh::{Mesh, Vec3};
use model::{ExpressionError, Function, Model, Point, TipDistances, Value};

use super::reference::{Claim, Domain, Measure, Reference, Take};
use crate::cli::error::CliError;

/// Names that every claim knows besides scalars and measures.
const BASIC: [&str; 9] =
    ["step", "number", "iterations", "newton", "last", "cells", "fracture_faces", "h", "fracture_h"];

/// What a time step gives.
pub(super) struct Now<'a> {
    pub(super) time: f64,
    pub(super) step: f64,
    pub(super) number: usize,
    pub(super) iterations: usize,
    pub(super) newton: u64,
    pub(super) last: bool,
    /// Scalars, in the order in which the judge was given their names.
    pub(super) scalars: &'a [f64],
    /// Gives a field by its name.
    pub(super) field: &'a mut dyn FnMut(&str) -> Result<Vec<f64>, CliError>,
}

/// The claims of one variant.
pub(super) struct Judge<'a> {
    mesh: &'a Mesh,
    tips: TipDistances,
    /// Mean sizes of cells and fracture faces (m).
    sizes: [f64; 2],
    measures: Vec<Prepared<'a>>,
    verdicts: Vec<Verdict<'a>>,
    previous: Option<Vec<f64>>,
}

/// A measure with what it is made of.
struct Prepared<'a> {
    name: &'a str,
    measure: &'a Measure,
    of: Function,
    only: Option<Function>,
    /// Names of the fields, and the number of values that each has at a point.
    fields: Vec<(String, usize)>,
    /// How many names of scalars come before those of the fields.
    scalars: usize,
}

/// What was found of a claim.
pub(super) struct Verdict<'a> {
    pub(super) claim: &'a Claim,
    value: Function,
    when: Option<Function>,
    bounds: Vec<(Kind, Function)>,
    size: Option<Function>,
    /// How often it was looked at.
    count: usize,
    fails: usize,
    /// The value that is nearest to being wrong, or farthest beyond it.
    worst: Option<Worst>,
    /// The last value with its size, for orders.
    pub(super) level: Option<[f64; 2]>,
}

#[derive(Clone, Copy)]
struct Worst {
    value: f64,
    bound: Bound,
    time: f64,
}

/// What a value must be to a bound.
#[derive(Clone, Copy)]
enum Kind {
    AtLeast,
    AtMost,
    Equals,
}

/// A bound as it is at a time step.
#[derive(Clone, Copy)]
struct Bound {
    kind: Kind,
    at: f64,
    /// What is left to it, relative to itself; below 0 where it does not hold.
    margin: f64,
}

impl<'a> Judge<'a> {
    /// Prepares the claims of a variant. `scalars` and `fields` are the names that the units publish.
    pub(super) fn new(
        reference: &'a Reference,
        variant: &str,
        model: &Model,
        mesh: &'a Mesh,
        scalars: &[&str],
        fields: &[&str],
    ) -> Result<Self, CliError> {
        let mut model = model.clone();
        model.define.extend(reference.define.clone());
        let plain = |name: &str| name.replace('.', "_");
        let mut names: Vec<String> = BASIC.iter().map(|name| (*name).to_owned()).collect();
        names.extend(scalars.iter().map(|name| plain(name)));
        names.extend(scalars.iter().map(|name| format!("previous_{}", plain(name))));
        let measures: Vec<Prepared> = (reference.measures.iter())
            .map(|(name, measure)| Prepared::new(name, measure, &model, mesh, &names, fields))
            .collect::<Result<_, _>>()?;
        let before_measures = names.clone();
        names.extend(reference.measures.keys().cloned());
        let claims = reference.claims.iter().filter(|claim| claim.variants.iter().any(|v| v == variant));
        let verdicts =
            claims.map(|claim| Verdict::new(claim, &model, &names, &before_measures)).collect::<Result<_, _>>()?;
        let size = |measures: f64, count: usize, dim: usize| (measures / count.max(1) as f64).powf(1.0 / dim as f64);
        let geometry = mesh.geometry();
        let faces = &mesh.network().faces;
        let sizes = [
            size(geometry.cell_measure.iter().sum(), mesh.cell_count(), mesh.dim()),
            size(faces.iter().map(|&f| geometry.face_measure[f]).sum(), faces.len(), mesh.dim() - 1),
        ];
        Ok(Self { mesh, tips: TipDistances::new(mesh), sizes, measures, verdicts, previous: None })
    }

    /// Looks at the start, or at the time step after the last one seen.
    pub(super) fn see(&mut self, now: Now<'_>) -> Result<(), CliError> {
        let Now { time, step, number, iterations, newton, last, scalars, field } = now;
        let previous = self.previous.replace(scalars.to_vec());
        let Some(previous) = previous else { return Ok(()) };
        let counts = [self.mesh.cell_count(), self.mesh.network().face_count()].map(|n| n as f64);
        let mut values = vec![step, number as f64, iterations as f64, newton as f64, f64::from(u8::from(last))];
        values.extend([counts[0], counts[1], self.sizes[0], self.sizes[1]]);
        values.extend(scalars.iter().chain(&previous));
        let point = Point::new(Vec3::ZERO, time);
        let due: Vec<bool> = self.verdicts.iter().map(|v| v.is_due(&point, &values)).collect();
        let mut measured = Vec::new();
        for measure in &self.measures {
            let needed = self.verdicts.iter().zip(&due).any(|(v, due)| *due && v.claim.mentions(measure.name));
            measured.push(if needed { measure.take(self.mesh, &self.tips, time, &values, field)? } else { f64::NAN });
        }
        values.extend(measured);
        for (verdict, due) in self.verdicts.iter_mut().zip(due) {
            if due {
                verdict.add(&point, &values);
            }
        }
        Ok(())
    }

    pub(super) fn verdicts(self) -> Vec<Verdict<'a>> {
        self.verdicts
    }
}

fn formula(model: &Model, what: &str, text: &str, names: &[String]) -> Result<Function, CliError> {
    let unfit = |error: ExpressionError| CliError::Unfit(format!("reference.toml: {what}: \"{text}\": {error}"));
    model.formula(text, names).map_err(unfit)
}

/// Whether a name stands in an expression.
fn mentions(text: &str, name: &str) -> bool {
    text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_').any(|word| word == name)
}

impl Claim {
    fn mentions(&self, name: &str) -> bool {
        let bounds = [&self.at_least, &self.at_most, &self.equals];
        let bounds = bounds.into_iter().flatten().filter_map(|b| match b {
            Value::Expression(text) => Some(text.as_str()),
            Value::Number(_) => None,
        });
        bounds.chain([self.value.as_str()]).chain(self.size.as_deref()).any(|text| mentions(text, name))
    }
}

impl<'a> Verdict<'a> {
    fn new(claim: &'a Claim, model: &Model, names: &[String], before_measures: &[String]) -> Result<Self, CliError> {
        let what = format!("claim \"{}\"", claim.says);
        let read = |text: &str, names: &[String]| formula(model, &what, text, names);
        let kinds = [(Kind::AtLeast, &claim.at_least), (Kind::AtMost, &claim.at_most), (Kind::Equals, &claim.equals)];
        let mut bounds = Vec::new();
        for (kind, value) in kinds {
            match value {
                None => {}
                Some(Value::Number(value)) => bounds.push((kind, Function::constant(*value))),
                Some(Value::Expression(text)) => bounds.push((kind, read(text, names)?)),
            }
        }
        Ok(Self {
            claim,
            value: read(&claim.value, names)?,
            when: claim.when.as_deref().map(|text| read(text, before_measures)).transpose()?,
            bounds,
            size: claim.size.as_deref().map(|text| read(text, names)).transpose()?,
            count: 0,
            fails: 0,
            worst: None,
            level: None,
        })
    }

    fn is_due(&self, point: &Point, values: &[f64]) -> bool {
        let holds = self.when.as_ref().is_none_or(|when| when.with(point, values) != 0.0);
        holds && !(self.claim.first && self.count > 0)
    }

    fn add(&mut self, point: &Point, values: &[f64]) {
        let at = |f: &Function| f.with(point, values);
        let value = at(&self.value);
        self.count += 1;
        self.level = self.size.as_ref().map(|size| [at(size), value]);
        let within = self.claim.within.unwrap_or(f64::NAN);
        for (kind, bound) in &self.bounds {
            let (kind, at) = (*kind, at(bound));
            let relative = |difference: f64| difference / at.abs().max(f64::MIN_POSITIVE);
            let margin = match kind {
                Kind::AtLeast => relative(value - at),
                Kind::AtMost => relative(at - value),
                Kind::Equals => within - relative(value - at).abs(),
            };
            // What is not a number is wrong, and worse than all else.
            let margin = if margin.is_nan() { f64::NEG_INFINITY } else { margin };
            self.fails += usize::from(margin < 0.0);
            if self.worst.is_none_or(|worst| margin < worst.bound.margin) {
                self.worst = Some(Worst { value, bound: Bound { kind, at, margin }, time: point.time });
            }
        }
    }

    /// Whether it holds, and a line about it; `None` for an order, which one variant cannot tell.
    pub(super) fn line(&self) -> Option<(bool, String)> {
        let claim = self.claim;
        if claim.order.is_some() {
            return None;
        }
        let Some(worst) = self.worst else {
            let when = claim.when.as_deref().unwrap_or("any time");
            return Some((false, format!("{}: never looked at ({when} was not reached)", claim.says)));
        };
        let Bound { kind, at, .. } = worst.bound;
        let (value, at_text) = (number(worst.value), number(at));
        let must = match kind {
            Kind::AtLeast => format!("at least {at_text}"),
            Kind::AtMost => format!("at most {at_text}"),
            Kind::Equals => {
                let (difference, within) = (worst.value / at - 1.0, claim.within.unwrap_or(f64::NAN));
                format!("{at_text} ({:+.2} %, allowed {} %)", 100.0 * difference, 100.0 * within)
            }
        };
        let often = match (self.count, self.fails) {
            (1, _) => String::new(),
            (count, 0) => format!(" (the nearest of {count})"),
            (count, fails) => format!(" (the worst of {fails} wrong ones of {count})"),
        };
        Some((self.fails == 0, format!("{}: {value} at t = {} s{often}, must be {must}", claim.says, worst.time)))
    }
}

/// A value with five digits.
fn number(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e5).contains(&value.abs()) {
        return format!("{value:.4e}");
    }
    // Five digits: a bound and what misses it narrowly must look different.
    let decimals = if value == 0.0 { 0 } else { 4 - value.abs().log10().floor() as i32 };
    let text = format!("{value:.*}", decimals.max(0) as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// The verdict on an order, from size and value at each level.
pub(super) fn order(claim: &Claim, levels: &[[f64; 2]]) -> (bool, String) {
    /// What a finite mesh may lack of the order.
    const SLACK: f64 = 0.1;
    let wanted = claim.order.unwrap_or(f64::NAN);
    let orders: Vec<f64> = levels.windows(2).map(|w| (w[0][1] / w[1][1]).ln() / (w[0][0] / w[1][0]).ln()).collect();
    let list = |values: &mut dyn Iterator<Item = String>| values.collect::<Vec<_>>().join(", ");
    let holds = levels.len() == claim.variants.len() && orders.last().is_some_and(|&o| o >= wanted - SLACK);
    let text = format!(
        "{}: {} for sizes {}, orders {}; the last must be {wanted} (or {SLACK} less)",
        claim.says,
        list(&mut levels.iter().map(|l| format!("{:.3e}", l[1]))),
        list(&mut levels.iter().map(|l| format!("{:.3e}", l[0]))),
        list(&mut orders.iter().map(|o| format!("{o:.2}"))),
    );
    (holds, text)
}

impl<'a> Prepared<'a> {
    fn new(
        name: &'a str,
        measure: &'a Measure,
        model: &Model,
        mesh: &Mesh,
        scalars: &[String],
        fields: &[&str],
    ) -> Result<Self, CliError> {
        let dim = mesh.dim();
        let (terminal, count) = match measure.on {
            Domain::Cells => ("matrix.", mesh.cell_count()),
            Domain::Fractures => ("fracture.", mesh.network().face_count()),
        };
        let axes = if measure.on == Domain::Cells { ["x", "y", "z"] } else { ["n", "t1", "t2"] };
        let texts = [Some(measure.of.as_str()), measure.only.as_deref()];
        let mut names = scalars.to_vec();
        let mut used = Vec::new();
        for field in fields {
            let Some(short) = field.strip_prefix(terminal) else { continue };
            let vector = (0..dim).map(|i| format!("{short}_{}", axes[i]));
            let tensor = (0..dim * dim).map(|k| format!("{short}_{}{}", axes[k / dim], axes[k % dim]));
            let parts = [vec![short.to_owned()], vector.collect(), tensor.collect()];
            let is_used = |name: &String| texts.into_iter().flatten().any(|text| mentions(text, name));
            // How it is named tells how many values it must have.
            if let Some(parts) = parts.iter().find(|parts| parts.iter().any(is_used)).filter(|_| count > 0) {
                used.push(((*field).to_owned(), parts.len()));
                names.extend(parts.iter().cloned());
            }
        }
        let what = format!("measure \"{name}\"");
        Ok(Self {
            name,
            measure,
            of: formula(model, &what, &measure.of, &names)?,
            only: measure.only.as_deref().map(|text| formula(model, &what, text, &names)).transpose()?,
            fields: used,
            scalars: scalars.len(),
        })
    }

    fn take(
        &self,
        mesh: &Mesh,
        tips: &TipDistances,
        time: f64,
        scalars: &[f64],
        field: &mut dyn FnMut(&str) -> Result<Vec<f64>, CliError>,
    ) -> Result<f64, CliError> {
        let geometry = mesh.geometry();
        let count = match self.measure.on {
            Domain::Cells => mesh.cell_count(),
            Domain::Fractures => mesh.network().face_count(),
        };
        let mut fields = Vec::new();
        for (name, columns) in &self.fields {
            let values = field(name)?;
            if values.len() != count * columns {
                let found = values.len() / count.max(1);
                let reason = format!("measure \"{}\": {name} has {found} values at a point, not {columns}", self.name);
                return Err(CliError::Unfit(format!("reference.toml: {reason}")));
            }
            fields.push((values, *columns));
        }
        let mut sums = Sums::default();
        let mut values = scalars[..self.scalars].to_vec();
        let mut at = |entity: usize, point: &Point, weight: f64| {
            values.truncate(self.scalars);
            for (field, columns) in &fields {
                values.extend(&field[entity * columns..(entity + 1) * columns]);
            }
            if self.only.as_ref().is_none_or(|only| only.with(point, &values) != 0.0) {
                sums.add(self.of.with(point, &values), weight);
            }
        };
        for entity in 0..count {
            if self.measure.on == Domain::Cells {
                let cell = geometry.cell_center[entity];
                for (x, weight) in mesh.quadrature(entity) {
                    at(entity, &Point { cell, ..Point::new(x, time) }, weight);
                }
            } else {
                let face = mesh.network().faces[entity];
                let point = tips.point(mesh.network().fracture[entity], geometry.face_center[face]);
                at(entity, &Point { time, ..point }, geometry.face_measure[face]);
            }
        }
        Ok(match self.measure.take {
            Take::Integral => sums.integral,
            Take::Mean => sums.integral / sums.size,
            Take::L2 => sums.square.sqrt(),
            Take::Min => sums.ends.map_or(f64::NAN, |e| e[0]),
            Take::Max => sums.ends.map_or(f64::NAN, |e| e[1]),
            Take::Count => sums.count as f64,
        })
    }
}

#[derive(Default)]
struct Sums {
    integral: f64,
    square: f64,
    size: f64,
    /// Smallest and largest value, once there is one.
    ends: Option<[f64; 2]>,
    count: usize,
}

impl Sums {
    fn add(&mut self, value: f64, weight: f64) {
        self.integral += weight * value;
        self.square += weight * value * value;
        self.size += weight;
        let [low, high] = self.ends.unwrap_or([value; 2]);
        // What is not a number stays one, unlike in `f64::min`.
        let is_number = !(low.is_nan() || value.is_nan());
        self.ends = Some(if is_number { [low.min(value), high.max(value)] } else { [f64::NAN; 2] });
        self.count += usize::from(value != 0.0);
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::cli::case::Case;

    /// Terzaghi's column, 1 m by 10 m, on which the pressure is y at cell centres and the displacement (1, 2).
    fn verdicts(claims: &str, scalars: &[f64]) -> Vec<Option<(bool, String)>> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/terzaghi");
        let case = Case::load(&folder, &[], &[]).unwrap();
        let mesh = case.mesh().unwrap();
        let measures = r#"
            [measures]
            total = { on = "cells", of = "pressure", take = "integral" }
            norm = { on = "cells", of = "displacement_y + 0*displacement_x", take = "l2" }
            upper = { on = "cells", of = "pressure", only = "cell_y > 5", take = "mean" }
            error = { on = "cells", of = "pressure - cell_y", take = "max" }
            none = { on = "cells", of = "pressure", only = "y > 11", take = "max" }
        "#;
        let reference: Reference = toml::from_str(&format!("{measures}{claims}")).unwrap();
        let fields = ["matrix.pressure", "matrix.displacement"];
        let model = &case.document.model;
        let mut judge = Judge::new(&reference, "default", model, &mesh, &["a.b"], &fields).unwrap();
        let centers = mesh.geometry().cell_center.clone();
        let mut field = |name: &str| {
            Ok(match name {
                "matrix.pressure" => centers.iter().map(|x| x.y).collect(),
                _ => [1.0, 2.0].repeat(centers.len()),
            })
        };
        for (number, value) in scalars.iter().enumerate() {
            let (last, scalars) = (number + 1 == scalars.len(), &[*value][..]);
            let (time, field) = (number as f64, &mut field);
            let now = Now { time, step: 1.0, number, iterations: 3, newton: 0, last, scalars, field };
            judge.see(now).unwrap();
        }
        judge.verdicts().iter().map(Verdict::line).collect()
    }

    #[test]
    fn measures_are_integrals_norms_and_ends() {
        let claim = |value: &str, equals: f64| {
            format!(
                "[[claims]]\nsays = \"\"\nvalue = \"{value}\"\nequals = {equals}\nwithin = 1e-12\nwhen = \"last\"\n"
            )
        };
        let right = [("total", 50.0), ("norm^2", 40.0), ("upper", 7.5), ("1 + error", 1.0), ("h", 0.125_f64.sqrt())];
        let text: String = right.map(|(value, equals)| claim(value, equals)).concat();
        assert!(verdicts(&text, &[0.0, 1.0]).iter().all(|v| v.as_ref().is_some_and(|v| v.0)), "{text}");
        let wrong = [("total", 50.1), ("none", 0.0), ("1/error", 0.0)];
        let text: String = wrong.map(|(value, equals)| claim(value, equals)).concat();
        assert!(verdicts(&text, &[0.0, 1.0]).iter().all(|v| v.as_ref().is_some_and(|v| !v.0)), "{text}");
    }

    #[test]
    fn claims_hold_at_all_times_at_the_first_or_at_none() {
        let claim = |rest: &str| format!("[[claims]]\nsays = \"\"\nvalue = \"a_b - previous_a_b\"\n{rest}\n");
        let text = [
            "at_least = 0",
            "at_least = 0\nwhen = \"t < 2.5\"",
            "at_least = 1\nat_most = 1\nwhen = \"a_b > 0\"\nfirst = true",
            "at_most = 9\nwhen = \"t > 9\"",
            "at_most = \"iterations - 1\"",
        ]
        .map(claim)
        .concat();
        let found = verdicts(&text, &[0.0, 1.0, 3.0, 2.0]);
        let holds: Vec<bool> = found.iter().flatten().map(|v| v.0).collect();
        assert_eq!(holds, [false, true, true, false, true], "{found:?}");
        let lines: Vec<&str> = found.iter().flatten().map(|v| v.1.as_str()).collect();
        assert!(
            lines[0].contains("-1 at t = 3 s (the worst of 1 wrong ones of 3), must be at least 0"),
            "{}",
            lines[0]
        );
        assert!(lines[3].contains("never looked at"), "{}", lines[3]);
        assert_eq!(
            [1.4518e-3, 1.45e-3, -0.5, 0.0, 4976.0, 12_345.678].map(number),
            ["0.0014518", "0.00145", "-0.5", "0", "4976", "12346"]
        );
        // What is not a number holds nothing.
        let found = verdicts(&claim("at_least = 0"), &[0.0, f64::NAN]);
        assert!(found.iter().flatten().all(|v| !v.0), "{found:?}");
    }

    #[test]
    fn an_order_is_that_of_the_last_levels() {
        let claim = Claim { order: Some(2.0), variants: vec![String::new(); 3], ..Claim::default() };
        let levels = |last: f64| [[0.4, 8.0], [0.2, 4.0], [0.1, last]];
        assert!(order(&claim, &levels(1.0)).0);
        assert!(order(&claim, &levels(1.07)).0);
        assert!(!order(&claim, &levels(1.08)).0);
        assert!(!order(&claim, &levels(1.0)[1..]).0, "a level is missing");
        assert!(!order(&claim, &levels(f64::NAN)).0);
    }
}
