//! The page: one file of XHTML that needs no other, readable on a phone and on paper.

use std::fmt::Write as _;

use serde_json::json;

use super::chart::{escaped, number, pretty, time};
use super::plots::{Figure, History};
use super::{Manifest, Summary};
use crate::cost::Cost;
use crate::energy::SLACK;
use crate::record::{Attempt, AttemptOutcome, counted, plural};

pub(crate) const STYLE: &str = "
body{margin:0;background:#f6f7f8;color:#222;font:16px/1.5 system-ui,-apple-system,'Segoe UI',Roboto,'DejaVu Sans',sans-serif}
main{max-width:1180px;margin:0 auto;padding:1.25rem}
h1{font-size:1.7rem;line-height:1.2;margin:.3rem 0}h2{font-size:1.2rem;margin:2rem 0 .6rem}
p{margin:.4rem 0}.about{max-width:46rem;color:#444}
.state{display:inline-block;padding:.1rem .7rem;border-radius:1rem;color:#fff;font-size:.9rem;background:#00704f}
.state.failed{background:#a84300}
.facts{display:grid;grid-template-columns:repeat(auto-fit,minmax(10.5rem,1fr));gap:.75rem;margin:1rem 0;padding:0}
.facts div{background:#fff;border:1px solid #dfe3e6;border-radius:.5rem;padding:.6rem .8rem}
.facts b{display:block;white-space:nowrap;font-size:1.35rem;font-weight:600}.facts span{font-size:.85rem;color:#555}
.plots{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,30rem),1fr));gap:1rem;align-items:start}
figure{margin:0;background:#fff;border:1px solid #dfe3e6;border-radius:.5rem;padding:.6rem;break-inside:avoid}
figure svg{display:block;width:100%;height:auto;max-width:640px;margin:0 auto}
figcaption{font-size:.88rem;color:#555;padding:.3rem .4rem 0}
.wide{overflow-x:auto;background:#fff;border:1px solid #dfe3e6;border-radius:.5rem}
table{border-collapse:collapse;width:100%;font-size:.93rem}
th,td{text-align:left;padding:.35rem .8rem;border-bottom:1px solid #eceff1;vertical-align:top}
tr:last-child>*{border-bottom:0}td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
thead th{background:#eef1f3;font-weight:600}
pre{background:#fff;border:1px solid #dfe3e6;border-radius:.5rem;padding:.8rem;overflow-x:auto;font-size:.85rem;line-height:1.4;white-space:pre-wrap}
code{overflow-wrap:anywhere;font-size:.9em}summary{cursor:pointer;font-weight:600;margin:.8rem 0}
@media(max-width:640px){main{padding:.75rem}h1{font-size:1.35rem}th,td{padding:.3rem .4rem}
.x{display:none}
figure{padding:.2rem}}
";

/// The files beside the page, with what is in them.
const FILES: [(&str, &str); 10] = [
    ("series.csv", "scalars against time"),
    ("attempts.csv", "attempts at time steps"),
    ("iterations.csv", "residuals and Newton iterations of each coupling iteration"),
    ("timings.csv", "seconds of each coupling iteration"),
    ("run.h5", "all of it, with the fields (HDF5)"),
    ("mesh.h5", "the mesh (HDF5)"),
    ("fields/matrix.pvd", "fields in the rock, for ParaView"),
    ("fields/fractures.pvd", "fields on the fractures, for ParaView"),
    ("manifest.json", "what it takes to repeat the run"),
    ("summary.json", "outcome and counts"),
];

/// Counts and seconds of a whole run.
#[derive(Clone, Debug, Default)]
pub(crate) struct Totals {
    /// Accepted time steps.
    pub(crate) time_steps: usize,
    /// Attempts at them that failed.
    pub(crate) failed_attempts: usize,
    /// Time steps in which tolerances lay below round-off.
    pub(crate) at_round_off: usize,
    /// Coupling iterations of all attempts.
    pub(crate) iterations: usize,
    /// Directional derivatives of each unit.
    pub(crate) derivatives: usize,
    /// Smallest and largest number of those of an accepted attempt.
    pub(crate) range: (usize, usize),
    /// Newton iterations of each unit, where it tells.
    pub(crate) newton: Vec<Option<u64>>,
    /// Smallest slack of the energy estimate, relative to the largest term up to then.
    pub(crate) slack: Option<f64>,
    /// Name and wall seconds of parts; the units first.
    pub(crate) seconds: Vec<(String, f64)>,
}

impl Totals {
    pub(crate) fn new(manifest: &Manifest, history: &History, summary: &Summary, output: f64) -> Self {
        let given_up = summary.failure.iter().flat_map(|f| &f.attempts);
        let attempts = || history.records.iter().flat_map(|r| &r.attempts).chain(given_up.clone());
        let iterations = || attempts().flat_map(|a| &a.iterations);
        let accepted = || history.records.iter().map(|r| r.iterations().len());
        let newton = |u: usize| iterations().filter_map(|i| i.newton[u]).reduce(|a, b| a + b);
        let mut seconds: Vec<(String, f64)> = (manifest.units.iter().enumerate())
            .map(|(u, unit)| (unit.name.clone(), iterations().map(|i| i.seconds[u]).sum()))
            .collect();
        seconds.push(("output".into(), output));
        seconds.extend(summary.seconds.iter().cloned());
        Self {
            time_steps: history.records.len(),
            failed_attempts: attempts().filter(|a| !a.outcome.is_accepted()).count(),
            at_round_off: attempts().filter(|a| a.outcome == AttemptOutcome::RoundOff).count(),
            iterations: iterations().count(),
            derivatives: iterations().map(|i| i.derivatives).sum(),
            range: (accepted().min().unwrap_or(0), accepted().max().unwrap_or(0)),
            newton: (0..manifest.units.len()).map(newton).collect(),
            slack: history.series(SLACK[1]).and_then(|s| s.1.iter().skip(1).copied().reduce(f64::min)),
            seconds,
        }
    }

    /// `summary.json`.
    pub(crate) fn to_json(&self, summary: &Summary) -> String {
        let seconds: serde_json::Map<_, _> = self.seconds.iter().map(|(name, s)| (name.clone(), json!(s))).collect();
        let summary = json!({
            "complete": summary.failure.is_none(),
            "failure": summary.failure.as_ref().map(ToString::to_string),
            "time_steps": self.time_steps,
            "failed_attempts": self.failed_attempts,
            "time_steps_at_round_off": self.at_round_off,
            "coupling_iterations": self.iterations,
            "derivatives": self.derivatives,
            "newton_iterations": self.newton,
            "smallest_energy_slack": self.slack,
            "seconds": seconds,
            "units": Cost::by_unit(&summary.units),
        });
        format!("{summary:#}\n")
    }

    fn mean_iterations(&self, history: &History) -> f64 {
        let accepted: usize = history.records.iter().map(|r| r.iterations().len()).sum();
        accepted as f64 / self.time_steps.max(1) as f64
    }
}

/// The whole page.
pub(crate) fn page(
    manifest: &Manifest,
    history: &History,
    totals: &Totals,
    summary: &Summary,
    figures: &[Figure],
) -> String {
    let title = escaped(&manifest.model.title);
    let mut html = format!(
        "<!DOCTYPE html>\n<html lang=\"en\" xmlns=\"http://www.w3.org/1999/xhtml\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n<title>{title}</title>\n\
         <style>{STYLE}</style>\n</head>\n<body>\n<main>\n"
    );
    let reached = time(history.times.last().copied().unwrap_or(0.0));
    let state = match summary.failure {
        None => format!("<span class=\"state\">complete up to t = {reached}</span>"),
        Some(_) => format!("<span class=\"state failed\">stopped at t = {reached}</span>"),
    };
    html += &format!("{state}\n<h1>{title}</h1>\n");
    for paragraph in manifest.model.description.split("\n\n").filter(|p| !p.trim().is_empty()) {
        html += &format!("<p class=\"about\">{}</p>\n", escaped(paragraph.trim()));
    }
    for note in &manifest.notes {
        html += &format!("<p class=\"about\">Note: {}</p>\n", escaped(note));
    }
    html += &facts(manifest, history, totals);
    if let Some(failure) = &summary.failure {
        html += &format!("<h2>Why it stopped</h2>\n<pre>{}</pre>\n", escaped(&failure.to_string()));
    }
    if !figures.is_empty() {
        html += "<h2>Plots</h2>\n<div class=\"plots\">\n";
        for figure in figures {
            html += &format!("<figure>{}<figcaption>{}</figcaption></figure>\n", figure.svg, escaped(&figure.caption));
        }
        html += "</div>\n";
    }
    html += &scalars(history);
    html += &timings(manifest, totals, summary);
    html += &failed(history);
    html += &repeat(manifest);
    html += "<h2>Files</h2>\n<div class=\"wide\"><table><tbody>\n";
    for (file, content) in FILES.iter().filter(|f| f.0 != "fields/fractures.pvd" || manifest.mesh.fracture_faces() > 0)
    {
        html += &format!("<tr><th><a href=\"{file}\">{}</a></th><td>{content}</td></tr>\n", breakable(file));
    }
    html + "</tbody></table></div>\n</main>\n</body>\n</html>\n"
}

fn facts(manifest: &Manifest, history: &History, totals: &Totals) -> String {
    let mesh = &manifest.mesh;
    let mut list = vec![
        (grouped(mesh.cells), format!("cells ({}D)", mesh.dimension)),
        (grouped(mesh.fracture_faces()), format!("faces on {}", counted(mesh.fractures.len(), "fracture"))),
        (grouped(totals.time_steps), plural(totals.time_steps, "time step")),
        (grouped(totals.failed_attempts), plural(totals.failed_attempts, "failed attempt")),
    ];
    if !manifest.fields.is_empty() {
        list.push((format!("{:.1}", totals.mean_iterations(history)), "coupling iterations a time step".into()));
    }
    if totals.at_round_off > 0 {
        let what = format!("{} as good as it gets, not to the tolerance", plural(totals.at_round_off, "time step"));
        list.push((grouped(totals.at_round_off), what));
    }
    for (unit, newton) in manifest.units.iter().zip(&totals.newton) {
        if let Some(newton) = newton {
            list.push((grouped(*newton as usize), format!("Newton iterations, {}", unit.name)));
        }
    }
    if let Some(slack) = totals.slack {
        list.push((number(slack), "smallest slack of the energy estimate, relative".into()));
    }
    let in_units: f64 = totals.seconds.iter().take(manifest.units.len()).map(|s| s.1).sum();
    list.push((format!("{} s", short(in_units)), "in the units".into()));
    let boxes: String =
        list.iter().map(|(value, what)| format!("<div><b>{value}</b><span>{}</span></div>\n", escaped(what))).collect();
    format!("<div class=\"facts\">\n{boxes}</div>\n")
}

/// Each scalar at the start, at the end, and its extremes.
fn scalars(history: &History) -> String {
    if history.series.is_empty() {
        return String::new();
    }
    let mut html = String::from(
        "<h2>Scalars</h2>\n<div class=\"wide\"><table><thead><tr><th>name</th><th>unit</th><th class=\"n\">start</th>\
         <th class=\"n\">end</th><th class=\"n x\">smallest</th><th class=\"n x\">largest</th></tr></thead><tbody>\n",
    );
    for (quantity, values) in &history.series {
        let value = |v: Option<f64>| v.map_or_else(String::new, number);
        let unit = if quantity.unit == "1" { "–".into() } else { pretty(&quantity.unit) };
        // Writing to a string cannot fail.
        let _ = writeln!(
            html,
            "<tr><th>{}</th><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n x\">{}</td>\
             <td class=\"n x\">{}</td></tr>",
            breakable(&quantity.name),
            escaped(&unit),
            value(values.first().copied()),
            value(values.last().copied()),
            value(values.iter().copied().reduce(f64::min)),
            value(values.iter().copied().reduce(f64::max)),
        );
    }
    html + "</tbody></table></div>\n"
}

fn timings(manifest: &Manifest, totals: &Totals, summary: &Summary) -> String {
    let mut html = String::from(
        "<h2>Wall time</h2>\n<div class=\"wide\"><table><thead><tr><th>part</th><th class=\"n\">seconds</th>\
         <th class=\"n\">ms an iteration</th></tr></thead><tbody>\n",
    );
    for (i, (name, seconds)) in totals.seconds.iter().enumerate() {
        let unit = i < manifest.units.len();
        let each = if unit { short(1e3 * seconds / totals.iterations.max(1) as f64) } else { String::new() };
        let name = if unit { format!("unit {name}") } else { name.clone() };
        let name = escaped(&name);
        html +=
            &format!("<tr><th>{name}</th><td class=\"n\">{}</td><td class=\"n\">{each}</td></tr>\n", short(*seconds));
    }
    html += "</tbody></table></div>\n";
    if !manifest.fields.is_empty() {
        let (low, high) = totals.range;
        let all = counted(totals.iterations, "coupling iteration");
        html += &format!("<p>{all} in all; {low} to {high} in an accepted attempt.</p>\n");
    }
    html + &costs(&summary.units)
}

/// Where the time of each unit went.
fn costs(costs: &[Cost]) -> String {
    let mut html = String::new();
    for cost in costs {
        let [step, derivative, solve] = cost.milliseconds();
        let mut rows: Vec<(String, String)> = Vec::new();
        let mut each =
            |name: String, ms: Option<f64>| rows.extend(ms.map(|ms| (name, format!("{} ms each", short(ms)))));
        each(format!("{} time steps", grouped(cost.calls.step.count as usize)), step);
        each(format!("{} directional derivatives", grouped(cost.calls.derivative.count as usize)), derivative);
        let solves = cost.work.map_or(0.0, |work| work.solve_count);
        each(format!("{} triangular solves in them", grouped(solves as usize)), solve);
        let parts = cost.parts().into_iter().filter(|part| part.1 != 0.0);
        rows.extend(parts.map(|(name, seconds)| (name.into(), format!("{} s", short(seconds)))));
        html +=
            &format!("<details><summary>unit {}</summary><div class=\"wide\"><table><tbody>\n", escaped(&cost.unit));
        for (name, value) in rows {
            html += &format!("<tr><th>{name}</th><td class=\"n\">{value}</td></tr>\n");
        }
        html += "</tbody></table></div></details>\n";
    }
    html
}

/// Attempts that failed before one was accepted.
fn failed(history: &History) -> String {
    let rows: Vec<(usize, f64, &Attempt)> = (history.records.iter())
        .flat_map(|r| r.attempts.iter().map(|a| (r.number, r.time, a)))
        .filter(|row| !row.2.outcome.is_accepted())
        .collect();
    if rows.is_empty() {
        return String::new();
    }
    // A page is no log: attempts.csv has them all.
    const ROWS: usize = 50;
    let mut html = String::from(
        "<h2>Failed attempts</h2>\n<div class=\"wide\"><table><thead><tr><th class=\"n\">time step</th>\
         <th class=\"n\">δt</th><th class=\"n\">iterations</th><th>outcome</th></tr></thead><tbody>\n",
    );
    for (number, _, attempt) in rows.iter().take(ROWS) {
        let (step, n) = (time(attempt.step), attempt.iterations.len());
        let outcome = escaped(&attempt.outcome.to_string());
        html += &format!(
            "<tr><td class=\"n\">{number}</td><td class=\"n\">{step}</td><td class=\"n\">{n}</td><td>{outcome}</td></tr>\n"
        );
    }
    html += "</tbody></table></div>\n";
    if rows.len() > ROWS {
        html += &format!("<p>{} more are in attempts.csv.</p>\n", rows.len() - ROWS);
    }
    html
}

/// Manifest and model.
fn repeat(manifest: &Manifest) -> String {
    let model = &manifest.model;
    let list = |items: &[String]| if items.is_empty() { "none".into() } else { items.join("; ") };
    let fractures: Vec<String> =
        manifest.mesh.fractures.iter().map(|(name, faces)| format!("{name}: {faces}")).collect();
    let mut rows = vec![
        ("command", manifest.command.join(" "), true),
        ("started", manifest.started.clone(), false),
        ("program", manifest.program.clone(), false),
        ("model", model.name.clone(), false),
        ("variants", list(&model.variants), false),
        ("changes", list(&model.changes), true),
        (
            "cells, faces, vertices",
            [manifest.mesh.cells, manifest.mesh.faces, manifest.mesh.vertices].map(grouped).join(", "),
            false,
        ),
        ("faces of each fracture", list(&fractures), false),
        ("fingerprint of the mesh", manifest.mesh.fingerprint.clone(), true),
    ];
    for unit in &manifest.units {
        rows.push(("unit", format!("{} {}", unit.name, unit.version), false));
    }
    let mut html = String::from("<h2>To repeat this run</h2>\n<div class=\"wide\"><table><tbody>\n");
    for (name, value, code) in rows {
        let value = escaped(&value);
        let value = if code { format!("<code>{value}</code>") } else { value };
        html += &format!("<tr><th>{name}</th><td>{value}</td></tr>\n");
    }
    html + &format!(
        "</tbody></table></div>\n<details><summary>The model as it was run</summary>\n<pre>{}</pre></details>\n",
        escaped(&model.toml)
    )
}

/// A name that narrow tables may break at its joints.
fn breakable(name: &str) -> String {
    escaped(name).replace('_', "_<wbr/>").replace('.', ".<wbr/>")
}

/// A count with thin spaces.
pub(crate) fn grouped(n: usize) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push('\u{202f}');
        }
        text.push(c);
    }
    text
}

/// A duration: three significant digits or so.
pub(crate) fn short(seconds: f64) -> String {
    match seconds {
        s if s < 1.0 => format!("{s:.3}"),
        s if s < 10.0 => format!("{s:.2}"),
        s if s < 100.0 => format!("{s:.1}"),
        s => format!("{s:.0}"),
    }
}
