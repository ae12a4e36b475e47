//! The plots of a run.

use std::path::Path;

use mesh::{Mesh, Vec3};
use model::Plot;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::chart::{
    self, Axis, BLUE, Curve, GREY, INK, Key, Mark, ORANGE, VERMILION, equal_scale, extent, label, px, ramp, scaled,
};
use super::journal::Entries;
use super::{Array, Manifest, Quantity, ResultsError, Shape};
use crate::energy::SLACK;
use crate::record::{Attempt, Failure, StepRecord};

/// Output times that are drawn, at most: the last one and others evenly before it.
const SHOWN: usize = 6;
/// Time steps whose convergence is drawn, at most.
const CURVES: usize = 100;
/// Fractures whose profiles are drawn, at most.
const PROFILES: usize = 12;
const TRACTION: &str = "fracture.traction";
/// Tractions up to this times the largest violation of a contact law are no more than that: an open fracture's.
const NOISE: f64 = 10.0;
/// Name and colour of each contact state, in the order of their numbers.
const STATES: [(&str, RGBColor); 3] = [("open", BLUE), ("stick", GREY), ("slip", VERMILION)];

/// A drawn plot.
#[derive(Debug)]
pub(crate) struct Figure {
    /// Its file name without `.svg`.
    pub(crate) name: String,
    /// What is to be seen.
    pub(crate) caption: String,
    pub(crate) svg: String,
}

/// The fields at an output time.
#[derive(Debug)]
pub(crate) struct Shown {
    pub(crate) number: usize,
    pub(crate) time: f64,
    /// Those on fractures only.
    pub(crate) arrays: Vec<Array>,
}

/// A run without its larger fields.
#[derive(Debug)]
pub(crate) struct History {
    /// The accepted time steps.
    pub(crate) records: Vec<StepRecord>,
    /// Times (s), the start first.
    pub(crate) times: Vec<f64>,
    /// Scalars, each with its value at each of `times`.
    pub(crate) series: Vec<(Quantity, Vec<f64>)>,
    /// Some output times.
    pub(crate) shown: Vec<Shown>,
}

impl History {
    pub(crate) fn read(journal: &Path) -> Result<Self, ResultsError> {
        let mut history = Self { records: Vec::new(), times: Vec::new(), series: Vec::new(), shown: Vec::new() };
        let mut outputs = Vec::new();
        for entry in Entries::open(journal)? {
            let entry = entry?;
            if !entry.snapshot.arrays.is_empty() {
                outputs.push(entry.record.number);
            }
            history.times.push(entry.snapshot.time);
            if history.series.is_empty() {
                let quantity = |s: &super::Scalar| Quantity { name: s.name.clone(), unit: s.unit.clone() };
                history.series = entry.snapshot.scalars.iter().map(|s| (quantity(s), Vec::new())).collect();
            }
            history.series.iter_mut().zip(&entry.snapshot.scalars).for_each(|(s, scalar)| s.1.push(scalar.value));
            if entry.record.number > 0 {
                history.records.push(entry.record);
            }
        }
        if outputs.len() > 1 {
            outputs.retain(|&number| number > 0);
        }
        let n = outputs.len();
        let chosen: Vec<usize> = (1..=n.min(SHOWN)).map(|i| outputs[(i * n).div_ceil(n.min(SHOWN)) - 1]).collect();
        for entry in Entries::open(journal)? {
            let mut entry = entry?;
            let number = entry.record.number;
            if chosen.contains(&number) {
                entry.snapshot.arrays.retain(|array| !array.shape.is_on_cells());
                history.shown.push(Shown { number, time: entry.snapshot.time, arrays: entry.snapshot.arrays });
            }
        }
        Ok(history)
    }

    /// A scalar by name.
    pub(crate) fn series(&self, name: &str) -> Option<&(Quantity, Vec<f64>)> {
        self.series.iter().find(|s| s.0.name == name)
    }

    /// An axis of time, and the factor on seconds.
    fn time_axis(&self) -> (Axis, f64) {
        let (low, high) = extent(self.times.iter().copied()).unwrap_or((0.0, 1.0));
        let (factor, unit) = scaled("s", high);
        (Axis::exact(label("time", &unit), low * factor, high.max(low + 1e-9) * factor, 6), factor)
    }
}

/// Draws what the manifest asks for and the run has data for.
pub(crate) fn draw(
    manifest: &Manifest,
    mesh: &Mesh,
    history: &History,
    failure: Option<&Failure>,
) -> Result<Vec<Figure>, ResultsError> {
    let asked = |plot: Plot| manifest.plots.contains(&plot);
    let wanted = |plot: Plot| manifest.plots.is_empty() || asked(plot);
    let mut figures = Vec::new();
    if wanted(Plot::MeanAperture) {
        figures.extend(series(
            history,
            "mean-aperture",
            "Mean aperture",
            "aperture",
            &[("aperture.mean", "mean", BLUE)],
            0,
        )?);
    }
    if wanted(Plot::MeanPressure) {
        let names = [("matrix_pressure.mean", "matrix", BLUE), ("fracture_pressure.mean", "fractures", VERMILION)];
        figures.extend(series(history, "mean-pressure", "Mean pressures", "pressure", &names, 0)?);
    }
    if wanted(Plot::ContactStates) {
        figures.extend(contact_counts(history)?);
        for shown in &history.shown {
            figures.extend(contact_map(mesh, shown)?);
        }
    }
    if asked(Plot::PressureProfiles) {
        figures.extend(profiles(mesh, history, &[("fracture.pressure", "pressure")])?);
    }
    if asked(Plot::FractureProfiles) {
        let arrays = [("fracture.displacement_jump", "displacement jump"), (TRACTION, "traction")];
        figures.extend(profiles(mesh, history, &arrays)?);
    }
    if wanted(Plot::Energy) {
        let names = [(SLACK[1], "slack", BLUE)];
        let title = "Slack of the energy estimate";
        let figure = series(history, "energy-slack", title, "slack / largest term", &names, 1)?;
        figures.extend(figure.map(|figure| Figure {
            caption: "What the discrete energy estimate leaves in each time step, as a part of its largest term up to then: \
                      what implicit Euler and closing fractures lose. It is not negative, but for the tolerance of the \
                      coupling."
                .into(),
            ..figure
        }));
    }
    if wanted(Plot::CouplingConvergence) && !manifest.fields.is_empty() {
        figures.extend(iterations(history)?);
        figures.extend(convergence(history, failure)?);
    }
    Ok(figures)
}

/// Scalars of one unit of measure against time, from time step `first` on; each with its name, label and colour.
fn series(
    history: &History,
    name: &str,
    title: &str,
    quantity: &str,
    names: &[(&str, &str, RGBColor)],
    first: usize,
) -> Result<Option<Figure>, ResultsError> {
    let found: Vec<_> =
        names.iter().filter_map(|(name, label, color)| Some((history.series(name)?, *label, *color))).collect();
    let values = found.iter().flat_map(|f| f.0.1.iter().skip(first).copied());
    let Some((low, high)) = extent(values) else { return Ok(None) };
    let (x, seconds) = history.time_axis();
    let (factor, unit) = scaled(&found[0].0.0.unit, low.abs().max(high.abs()));
    let curves: Vec<Curve> = (found.iter())
        .map(|((_, values), label, color)| {
            let points = history.times.iter().zip(values).skip(first);
            let points = points.map(|(t, v)| (t * seconds, v * factor)).collect();
            let curve = Curve::new(*label, *color, points);
            // One curve needs no legend.
            if found.len() == 1 { Curve { label: None, ..curve } } else { curve }
        })
        .collect();
    let y = Axis::new(label(quantity, &unit), low * factor, high * factor);
    let caption = format!("{title} against time.");
    Ok(Some(Figure { name: name.into(), caption, svg: chart::curves(title, &x, &y, &curves)? }))
}

fn contact_counts(history: &History) -> Result<Option<Figure>, ResultsError> {
    let (x, seconds) = history.time_axis();
    let mut curves = Vec::new();
    for (name, color) in STATES {
        if let Some((_, values)) = history.series(&format!("contact.{name}")) {
            let points = history.times.iter().zip(values).map(|(t, v)| (t * seconds, *v)).collect();
            curves.push(Curve::new(name, color, points));
        }
    }
    let Some((_, high)) = extent(curves.iter().flat_map(|c| c.points.iter().map(|p| p.1))) else { return Ok(None) };
    let y = Axis::counts("fracture faces", 0.0, high);
    let svg = chart::curves("Contact states", &x, &y, &curves)?;
    let caption = "Number of fracture faces that are open, stick or slip.".into();
    Ok(Some(Figure { name: "contact-counts".into(), caption, svg }))
}

/// Contact states on the network: in 2D where it lies in the domain, in 3D in an isometric projection.
fn contact_map(mesh: &Mesh, shown: &Shown) -> Result<Option<Figure>, ResultsError> {
    let Some(array) = shown.arrays.iter().find(|a| a.name == "fracture.contact_state") else { return Ok(None) };
    let state = |face: usize| (array.values[face] as usize).min(STATES.len() - 1);
    let count = |s: usize| (0..array.values.len()).filter(|&f| state(f) == s).count();
    let keys: Vec<Key> = (STATES.iter().enumerate())
        .map(|(s, (name, color))| Key::new(format!("{name}: {}", count(s)), *color, Mark::Box))
        .collect();
    let title = format!("Contact states at t = {}", chart::time(shown.time));
    let svg =
        if mesh.dim() == 2 { flat(mesh, &title, &keys, &state)? } else { isometric(mesh, &title, &keys, &state)? };
    let caption = format!("Contact on the fractures after time step {}, with the number of faces.", shown.number);
    Ok(Some(Figure { name: format!("contact-{:06}", shown.number), caption, svg }))
}

fn flat(mesh: &Mesh, title: &str, keys: &[Key], state: &dyn Fn(usize) -> usize) -> Result<String, ResultsError> {
    let x = mesh.vertices();
    let axis = |name: &str, of: fn(&Vec3) -> f64| {
        let (low, high) = extent(x.iter().map(of)).unwrap_or((0.0, 1.0));
        let (factor, unit) = scaled("m", low.abs().max(high.abs()));
        (Axis::exact(label(name, &unit), low * factor, high * factor, 6), factor)
    };
    let ((x_axis, fx), (y_axis, fy)) = (axis("x", |p| p.x), axis("y", |p| p.y));
    let point = |v: usize| (x[v].x * fx, x[v].y * fy);
    let (height, free) = equal_scale(&x_axis, &y_axis);
    let segment = |face: usize| [mesh.face_vertices(face)[0], mesh.face_vertices(face)[1]];
    let boundary: Vec<[usize; 2]> = (0..mesh.face_count()).filter(|&f| mesh.is_boundary(f)).map(segment).collect();
    chart::svg(title, keys, height, |area| {
        let mut chart = chart::axes(area, &x_axis, &y_axis, free)?;
        for chain in chains(&boundary) {
            let points = chain_points(&chain).into_iter().map(point).collect::<Vec<_>>();
            chart.draw_series([PathElement::new(points, GREY.stroke_width(px(1.0)))])?;
        }
        // Those that stick first: what moves stands out where fractures meet.
        for s in [1, 0, 2] {
            let network = mesh.network();
            for fracture in 0..mesh.data().fractures.len() {
                let faces = (0..network.face_count()).filter(|&f| network.fracture[f] == fracture && state(f) == s);
                let segments: Vec<[usize; 2]> = faces.map(|f| segment(network.faces[f])).collect();
                for chain in chains(&segments) {
                    let points = chain_points(&chain).into_iter().map(point).collect::<Vec<_>>();
                    chart.draw_series([PathElement::new(points, STATES[s].1.stroke_width(px(4.0)))])?;
                }
            }
        }
        Ok(())
    })
}

/// Seen from in front, right and above; faces that are farther away are drawn first.
fn isometric(mesh: &Mesh, title: &str, keys: &[Key], state: &dyn Fn(usize) -> usize) -> Result<String, ResultsError> {
    // Azimuth −52°, elevation 28°: rarely along a fracture.
    let (a, e) = (-52_f64.to_radians(), 28_f64.to_radians());
    let right = Vec3::new(-a.sin(), a.cos(), 0.0);
    let towards = Vec3::new(a.cos() * e.cos(), a.sin() * e.cos(), e.sin());
    let up = towards.cross(right);
    let project = |p: Vec3| (p.dot(right), p.dot(up));
    let vertices = mesh.vertices();
    let low = vertices.iter().copied().fold(Vec3::INFINITY, Vec3::min);
    let high = vertices.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
    let corner = |bits: usize| {
        let pick = |k: usize| if bits >> k & 1 == 1 { high[k] } else { low[k] };
        Vec3::new(pick(0), pick(1), pick(2))
    };
    let corners: Vec<(f64, f64)> = (0..8).map(|i| project(corner(i))).collect();
    let (x0, x1) = extent(corners.iter().map(|c| c.0)).unwrap_or((0.0, 1.0));
    let (y0, y1) = extent(corners.iter().map(|c| c.1)).unwrap_or((0.0, 1.0));
    // Room (shown pixels) at the sides, above and below.
    const ROOM: [f64; 3] = [60.0, 10.0, 20.0];
    let scale = ((f64::from(chart::WIDTH) - 2.0 * ROOM[0]) / (x1 - x0)).min(380.0 / (y1 - y0));
    let height = ((y1 - y0) * scale + ROOM[1] + ROOM[2]) as i32;
    let left = 0.5 * (f64::from(chart::WIDTH) - (x1 - x0) * scale);
    let pixel = |(x, y): (f64, f64)| {
        let (x, y) = (left + (x - x0) * scale, ROOM[1] + (y1 - y) * scale);
        ((x * f64::from(chart::SCALE)) as i32, (y * f64::from(chart::SCALE)) as i32)
    };
    let network = mesh.network();
    let mut order: Vec<(f64, usize)> = (network.faces.iter().enumerate())
        .map(|(f, &face)| (mesh.geometry().face_center[face].dot(towards), f))
        .collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    chart::svg(title, keys, height, |area| {
        for i in 0..8 {
            for k in (0..3).filter(|k| i >> k & 1 == 0) {
                let ends = [pixel(corners[i]), pixel(corners[i | 1 << k])];
                area.draw(&PathElement::new(ends, GREY.mix(0.7).stroke_width(px(1.0))))?;
            }
        }
        for &(_, f) in &order {
            let polygon: Vec<_> =
                mesh.face_vertices(network.faces[f]).iter().map(|&v| pixel(project(vertices[v]))).collect();
            let color = STATES[state(f)].1;
            area.draw(&Polygon::new(polygon.clone(), color.mix(0.9).filled()))?;
            let closed: Vec<_> = polygon.iter().chain(polygon.first()).copied().collect();
            area.draw(&PathElement::new(closed, WHITE.mix(0.8).stroke_width(px(0.5))))?;
        }
        // The lengths of three edges that lie in front.
        let edges = [
            (0b000, HPos::Right, VPos::Top, -6),
            (0b001, HPos::Left, VPos::Top, 6),
            (0b011, HPos::Left, VPos::Center, 8),
        ];
        for (k, (from, h, v, shift)) in edges.into_iter().enumerate() {
            let (p, q) = (corners[from], corners[from | 1 << k]);
            let (factor, unit) = scaled("m", high[k] - low[k]);
            let name = format!("{}: {} {unit}", ["x", "y", "z"][k], chart::number((high[k] - low[k]) * factor));
            let (x, y) = pixel((0.5 * (p.0 + q.0), 0.5 * (p.1 + q.1)));
            let below = if k == 2 { 0 } else { 5 };
            let at = (x + shift * chart::SCALE, y + below * chart::SCALE);
            area.draw(&Text::new(name, at, chart::font(13.0).pos(Pos::new(h, v))))?;
        }
        Ok(())
    })
}

/// Fields along each fracture (2D) at the shown times, with their name and quantity. Of vectors, the normal part is solid
/// and the tangential one dashed.
fn profiles(mesh: &Mesh, history: &History, arrays: &[(&str, &str)]) -> Result<Vec<Figure>, ResultsError> {
    let mut figures = Vec::new();
    let count = if mesh.dim() == 2 { mesh.data().fractures.len().min(PROFILES) } else { 0 };
    let network = mesh.network();
    let violation = history.series("contact.violation").and_then(|s| extent(s.1.iter().copied()));
    let noise = NOISE * violation.map_or(0.0, |(_, largest)| largest);
    for fracture in 0..count {
        let faces: Vec<usize> = (0..network.face_count()).filter(|&f| network.fracture[f] == fracture).collect();
        let ends = |&f: &usize| [mesh.face_vertices(network.faces[f])[0], mesh.face_vertices(network.faces[f])[1]];
        let segments: Vec<[usize; 2]> = faces.iter().map(ends).collect();
        for (name, quantity) in arrays {
            let found: Vec<(f64, &Array)> = (history.shown.iter())
                .filter_map(|s| Some((s.time, s.arrays.iter().find(|a| a.name == *name)?)))
                .collect();
            let Some((_, first)) = found.first() else { continue };
            let columns = if first.shape == Shape::FractureVectors { 2 } else { 1 };
            let values =
                found.iter().flat_map(|f| faces.iter().flat_map(|&i| &f.1.values[i * columns..(i + 1) * columns]));
            let Some((mut low, mut high)) = extent(values.copied()) else { continue };
            if *name == TRACTION && low.abs().max(high.abs()) <= noise {
                (low, high) = (-1.0, 1.0);
            }
            let (factor, unit) = scaled(&first.unit, low.abs().max(high.abs()));
            let mut curves = Vec::new();
            let mut length = 0.0_f64;
            for (i, (time, array)) in found.iter().enumerate() {
                for column in 0..columns {
                    // Pieces of a fracture follow one another, with a gap.
                    let mut points = Vec::new();
                    let mut s = 0.0;
                    for chain in chains(&segments) {
                        for &(k, ..) in &chain {
                            let h = mesh.geometry().face_measure[network.faces[faces[k]]];
                            points.push((s + 0.5 * h, array.values[faces[k] * columns + column] * factor));
                            s += h;
                        }
                        points.push((f64::NAN, f64::NAN));
                    }
                    length = length.max(s);
                    let color = ramp(i as f64 / (found.len() - 1).max(1) as f64);
                    let label = (column == 0).then(|| chart::time(*time));
                    curves.push(Curve { label, color, dashed: column == 1, circles: false, points });
                }
            }
            let (x_factor, x_unit) = scaled("m", length);
            curves.iter_mut().flat_map(|c| &mut c.points).for_each(|p| p.0 *= x_factor);
            let x = Axis::exact(label("along the fracture", &x_unit), 0.0, length * x_factor, 6);
            let y = Axis::new(label(quantity, &unit), low * factor, high * factor);
            let name = &mesh.data().fractures[fracture];
            let mut capital = quantity[..1].to_uppercase();
            capital += &quantity[1..];
            let sign = if *name == TRACTION { "in compression" } else { "where open" };
            let parts = if columns == 2 { format!("; the normal part is negative {sign}") } else { String::new() };
            if columns == 2 {
                // For the legend only.
                for (part, dashed) in [("normal", false), ("tangential", true)] {
                    let label = Some(part.into());
                    curves.push(Curve { label, color: INK, dashed, circles: false, points: Vec::new() });
                }
            }
            figures.push(Figure {
                name: format!("{}-fracture-{}", quantity.replace(' ', "-"), fracture + 1),
                caption: format!("{capital} along fracture {name}{parts}."),
                svg: chart::curves(&format!("{capital} along fracture {name}"), &x, &y, &curves)?,
            });
        }
    }
    Ok(figures)
}

/// Coupling iterations of each time step.
fn iterations(history: &History) -> Result<Option<Figure>, ResultsError> {
    let counts: Vec<(f64, f64, f64)> = (history.records.iter())
        .map(|record| {
            let all: usize = record.attempts.iter().map(|a| a.iterations.len()).sum();
            (record.number as f64, record.iterations().len() as f64, all as f64)
        })
        .collect();
    let (Some((first, ..)), Some((last, ..))) = (counts.first(), counts.last()) else { return Ok(None) };
    let highest = counts.iter().map(|c| c.2).fold(1.0, f64::max);
    let x = Axis::counts("time step", first - 0.6, last + 0.6);
    let y = Axis::counts("coupling iterations", 0.0, highest);
    let mut keys = vec![Key::new("accepted attempt", BLUE, Mark::Box)];
    if counts.iter().any(|c| c.2 > c.1) {
        keys.push(Key::new("failed attempts", ORANGE, Mark::Box));
    }
    let svg = chart::svg("Coupling iterations of each time step", &keys, 270, |area| {
        let mut chart = chart::axes(area, &x, &y, 0)?;
        for &(number, accepted, all) in &counts {
            let bar =
                |from, to, color: RGBColor| Rectangle::new([(number - 0.4, from), (number + 0.4, to)], color.filled());
            chart.draw_series([bar(0.0, accepted, BLUE)])?;
            if all > accepted {
                chart.draw_series([bar(accepted, all, ORANGE)])?;
            }
        }
        Ok(())
    })?;
    let caption = "Coupling iterations of each time step.".into();
    Ok(Some(Figure { name: "coupling-iterations".into(), caption, svg }))
}

/// The largest residual/limit of all fields in each coupling iteration.
fn convergence(history: &History, failure: Option<&Failure>) -> Result<Option<Figure>, ResultsError> {
    // The last one is among them.
    let mut drawn: Vec<&StepRecord> =
        history.records.iter().rev().step_by(history.records.len().div_ceil(CURVES).max(1)).collect();
    drawn.reverse();
    let points = |attempt: &Attempt| -> Vec<(f64, f64)> {
        // The logarithm of a residual that vanishes is not finite: the curve ends there.
        (1..).zip(&attempt.iterations).map(|(i, iteration)| (f64::from(i), iteration.ratio().log10())).collect()
    };
    let plain = |color, points| Curve { label: None, color, dashed: false, circles: false, points };
    let mut curves = Vec::new();
    for (i, record) in drawn.iter().enumerate() {
        let label = match i {
            0 => Some(format!("time step {}", record.number)),
            _ if i + 1 == drawn.len() || i == drawn.len() / 2 => Some(record.number.to_string()),
            _ => None,
        };
        let color = ramp(i as f64 / (drawn.len() - 1).max(1) as f64);
        let accepted = record.attempts.last().map_or_else(Vec::new, points);
        curves.push(Curve { label, circles: drawn.len() <= 30, ..plain(color, accepted) });
    }
    let before = drawn.iter().flat_map(|record| &record.attempts);
    let failed = before.chain(failure.iter().flat_map(|f| &f.attempts)).filter(|a| !a.outcome.is_accepted());
    for (i, attempt) in failed.enumerate() {
        let label = (i == 0).then(|| "failed".into());
        curves.push(Curve { label, dashed: true, ..plain(ORANGE, points(attempt)) });
    }
    let Some((low, high)) = extent(curves.iter().flat_map(|c| c.points.iter().map(|p| p.1))) else { return Ok(None) };
    let most = curves.iter().map(|c| c.points.len()).max().unwrap_or(0).max(2) as f64;
    let limit = plain(INK, vec![(0.8, 0.0), (most, 0.0)]);
    curves.insert(0, Curve { label: Some("limit".into()), dashed: true, ..limit });
    let x = Axis::counts("coupling iteration", 0.8, most);
    let y = Axis::powers("largest residual/limit", low.min(-1.0) - 0.2, high.max(0.0) + 0.3);
    let svg = chart::curves("Convergence of the coupling", &x, &y, &curves)?;
    let caption = "The largest residual of all coupled fields, as a part of what it must not exceed, in each coupling \
                   iteration; one curve for each time step.";
    Ok(Some(Figure { name: "coupling-convergence".into(), caption: caption.into(), svg }))
}

/// Segments put one behind the other, with the vertices at which each begins and ends: lines from end or branch to end or
/// branch, then loops.
pub(crate) fn chains(segments: &[[usize; 2]]) -> Vec<Vec<(usize, usize, usize)>> {
    let mut at = std::collections::BTreeMap::<usize, Vec<usize>>::new();
    for (i, ends) in segments.iter().enumerate() {
        ends.iter().for_each(|&v| at.entry(v).or_default().push(i));
    }
    let mut used = vec![false; segments.len()];
    let mut list = Vec::new();
    let mut follow = |start: usize, first: usize, used: &mut Vec<bool>| {
        let (mut chain, mut v, mut next) = (Vec::new(), start, Some(first));
        while let Some(i) = next {
            used[i] = true;
            let end = if segments[i][0] == v { segments[i][1] } else { segments[i][0] };
            chain.push((i, v, end));
            v = end;
            next = if at[&v].len() == 2 { at[&v].iter().copied().find(|&i| !used[i]) } else { None };
        }
        list.push(chain);
    };
    for (&v, own) in at.iter().filter(|(_, own)| own.len() != 2) {
        for &i in own {
            if !used[i] {
                follow(v, i, &mut used);
            }
        }
    }
    for i in 0..segments.len() {
        if !used[i] {
            follow(segments[i][0], i, &mut used);
        }
    }
    list
}

/// The vertices of a chain.
fn chain_points(chain: &[(usize, usize, usize)]) -> Vec<usize> {
    chain.first().map(|c| c.1).into_iter().chain(chain.iter().map(|c| c.2)).collect()
}
