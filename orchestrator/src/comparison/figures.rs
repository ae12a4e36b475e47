//! The plots of a comparison.

use std::collections::BTreeMap;

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use serde::{Deserialize, Serialize};

use super::tables::worst;
use super::{Choice, Comparison, Measures, Row};
use crate::record::{Attempt, AttemptOutcome};
use crate::results::ResultsError;
use crate::results::chart::{
    self, Axis, BLUE, Curve, GREEN, GREY, INK, Key, Mark, ORANGE, PURPLE, SKY, VERMILION, extent, label, px, ramp,
};
use crate::results::plots::Figure;

const COLORS: [RGBColor; 7] = [BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, INK];
/// Curves in a plot, at most: each colour once solid and once dashed.
const CURVES: usize = 2 * COLORS.len();
/// Runs in a plot with a line for each, at most.
const LINES: usize = 40;
/// Coupling iterations a time step that have the lightest colour of a map.
const MANY: f64 = 50.0;

/// A plot to draw.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FigureSpec {
    /// Its file name without `.svg`.
    pub name: String,
    /// Its title.
    pub title: String,
    /// What is to be seen.
    #[serde(default)]
    pub caption: String,
    /// What is drawn.
    pub kind: Kind,
    /// The choice along x, of numbers; for curves and maps.
    pub x: Option<String>,
    /// The choice along y; for maps.
    pub y: Option<String>,
    /// The choice of which there is a curve for each option; left out: one for all that else varies.
    pub series: Option<String>,
    /// The choice of which there is a plot for each option.
    pub panels: Option<String>,
    /// What is shown along y, or in the cells of a map.
    #[serde(default)]
    pub value: Value,
    /// Only runs with these options, by the name of their choice.
    #[serde(default)]
    pub only: BTreeMap<String, Vec<String>>,
    /// Whether x is logarithmic.
    #[serde(default)]
    pub log_x: bool,
    /// Whether y is logarithmic.
    #[serde(default)]
    pub log_y: bool,
    /// An order in x, drawn as a dashed line.
    pub order: Option<f64>,
    /// A dashed line at a number of x.
    pub line: Option<Line>,
}

/// What a plot shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A value against a choice.
    Curves,
    /// A value over two choices.
    Map,
    /// Coupling iterations of each time step.
    Steps,
    /// Residuals in the time step with the most coupling iterations.
    Residuals,
    /// Wall seconds.
    Seconds,
    /// Contraction of each field.
    Contraction,
}

/// A line across a plot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Line {
    /// Where.
    pub at: f64,
    /// What it is.
    pub label: String,
    /// In the plots for these options; none: in all.
    #[serde(default)]
    pub panels: Vec<String>,
}

/// What can be shown of a run: `iterations` (mean of a time step), `largest_iterations`, `all_iterations`, `newton`,
/// `contraction`, `error`, `seconds`; of a field or unit with its name behind, as `error.matrix.pressure`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Value {
    what: What,
    /// A field or a unit; `None`: the worst, or all.
    of: Option<String>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum What {
    #[default]
    Iterations,
    LargestIterations,
    AllIterations,
    Newton,
    Contraction,
    Error,
    Seconds,
}

impl What {
    const ALL: [(&'static str, Self); 7] = [
        ("iterations", Self::Iterations),
        ("largest_iterations", Self::LargestIterations),
        ("all_iterations", Self::AllIterations),
        ("newton", Self::Newton),
        ("contraction", Self::Contraction),
        ("error", Self::Error),
        ("seconds", Self::Seconds),
    ];
}

impl TryFrom<String> for Value {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let (name, of) = text.split_once('.').map_or((text.as_str(), None), |(name, of)| (name, Some(of.to_owned())));
        match What::ALL.iter().find(|w| w.0 == name) {
            Some(&(_, what)) => Ok(Self { what, of }),
            None => {
                let known = What::ALL.map(|w| w.0).join(", ");
                Err(format!("\"{text}\" is not measured; known: {known}, each with .FIELD or .UNIT where it has one"))
            }
        }
    }
}

impl From<Value> for String {
    fn from(value: Value) -> Self {
        let name = What::ALL.iter().find(|w| w.1 == value.what).map_or("", |w| w.0);
        value.of.map_or_else(|| name.to_owned(), |of| format!("{name}.{of}"))
    }
}

impl Value {
    fn label(&self) -> String {
        let what = match self.what {
            What::Iterations => "coupling iterations a time step",
            What::LargestIterations => "most coupling iterations of a time step",
            What::AllIterations => "coupling iterations in all",
            What::Newton => "Newton iterations in all",
            What::Contraction => "contraction a coupling iteration",
            What::Error => "relative error",
            What::Seconds => "seconds",
        };
        match &self.of {
            // There is no more room along an axis.
            Some(of) if self.what == What::Error => format!("error of {of}"),
            Some(of) => format!("{what}, {of}"),
            None => what.to_owned(),
        }
    }

    /// Of a run; `None` where there is none. Counts of runs that stopped early are none.
    fn of(&self, row: &Row<'_>) -> Option<f64> {
        let (measures, outcome) = (row.measures.as_ref()?, row.entry.outcome.as_ref().ok()?);
        let of = self.of.as_deref();
        let field = |values: &[Option<f64>]| match of {
            Some(name) => values[outcome.fields.iter().position(|f| f.name == name)?],
            None => worst(values),
        };
        let unit = |name: &str| outcome.units.iter().position(|u| u == name);
        let m: &Measures = measures;
        if self.what == What::Contraction {
            return field(&m.contraction);
        }
        if outcome.failure.is_some() {
            return None;
        }
        match self.what {
            What::Iterations => Some(m.mean),
            What::LargestIterations => Some(m.largest as f64),
            What::AllIterations => Some(m.iterations as f64),
            What::Newton => of
                .map_or_else(|| m.newton.iter().flatten().copied().reduce(|a, b| a + b), |name| m.newton[unit(name)?])
                .map(|n| n as f64),
            What::Contraction => None,
            What::Error => field(&m.errors),
            What::Seconds => of.map_or(Some(m.total), |name| m.seconds.get(unit(name)?).copied()),
        }
    }
}

impl FigureSpec {
    fn new(name: &str, title: &str, caption: &str, kind: Kind) -> Self {
        Self {
            name: name.into(),
            title: title.into(),
            caption: caption.into(),
            kind,
            x: None,
            y: None,
            series: None,
            panels: None,
            value: Value::default(),
            only: BTreeMap::new(),
            log_x: false,
            log_y: false,
            order: None,
            line: None,
        }
    }

    /// What does not fit the choices.
    pub fn problems(&self, choices: &[Choice]) -> Vec<String> {
        let mut list = Vec::new();
        let known = choices.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ");
        let mut check = |key: &str, name: &Option<String>| {
            if let Some(name) = name
                && !choices.iter().any(|c| c.name == *name)
            {
                list.push(format!("figure \"{}\": {key} = \"{name}\" is no choice; known: {known}", self.name));
            }
        };
        check("x", &self.x);
        check("y", &self.y);
        check("series", &self.series);
        check("panels", &self.panels);
        self.only.keys().for_each(|name| check("only", &Some(name.clone())));
        for (name, options) in &self.only {
            let Some(choice) = choices.iter().find(|c| c.name == *name) else { continue };
            for option in options.iter().filter(|o| !choice.options.contains(o)) {
                let known = choice.options.join(", ");
                list.push(format!("figure \"{}\": {name} has no option \"{option}\"; known: {known}", self.name));
            }
        }
        let needs_x = matches!(self.kind, Kind::Curves | Kind::Map);
        let x = self.x.as_ref().and_then(|x| choices.iter().find(|c| c.name == *x));
        if needs_x && x.is_none_or(|x| x.numbers().is_none()) {
            list.push(format!("figure \"{}\": x must be a choice of numbers", self.name));
        }
        if self.kind == Kind::Map && self.y.is_none() {
            list.push(format!("figure \"{}\": a map needs a choice y", self.name));
        }
        list
    }
}

/// The plots that fit the choices.
fn usual(comparison: &Comparison, runs: usize) -> Vec<FigureSpec> {
    let mut list = Vec::new();
    let varying = comparison.choices.iter().filter(|c| c.varies());
    for choice in varying.filter(|c| c.options.len() > 2) {
        let Some(numbers) = choice.numbers() else { continue };
        let (low, high) = extent(numbers).unwrap_or((0.0, 1.0));
        let title = format!("Coupling iterations over {}", choice.label);
        let caption =
            "Mean number of coupling iterations of a time step; a cross at the upper edge is a run that failed.";
        let spec = FigureSpec::new(&format!("iterations-over-{}", choice.name), &title, caption, Kind::Curves);
        list.push(FigureSpec { x: Some(choice.name.clone()), log_x: low > 0.0 && high > 20.0 * low, ..spec });
    }
    if runs <= CURVES {
        let caption = "Coupling iterations of each time step, those of failed attempts included.";
        list.push(FigureSpec::new("iterations", "Coupling iterations of each time step", caption, Kind::Steps));
        let caption = "The largest residual of all fields, as a part of what it must not exceed, in the time step that \
                       took the most coupling iterations.";
        list.push(FigureSpec::new("residuals", "Residuals in the hardest time step", caption, Kind::Residuals));
    }
    if runs <= LINES {
        let caption = "Geometric mean of the ratios of successive residuals, from the second coupling iteration of each \
                       time step on: right of 1 they grow.";
        list.push(FigureSpec::new("contraction", "Contraction of each field", caption, Kind::Contraction));
        let caption = "Wall seconds in each unit, and all else from the start of the units to the end.";
        list.push(FigureSpec::new("seconds", "Seconds", caption, Kind::Seconds));
    }
    list
}

/// Draws what is asked for, or what fits.
pub(crate) fn draw(comparison: &Comparison, rows: &[Row<'_>]) -> Result<Vec<Figure>, ResultsError> {
    let usual = usual(comparison, rows.len());
    let specs = if comparison.figures.is_empty() { &usual } else { &comparison.figures };
    let mut figures = Vec::new();
    for spec in specs {
        let option = |row: &Row<'_>, name: &str| {
            let c = comparison.choices.iter().position(|c| c.name == name);
            c.map(|c| comparison.choices[c].options[row.entry.options[c]].as_str())
        };
        let kept = |row: &&Row<'_>| {
            spec.only.iter().all(|(name, list)| option(row, name).is_some_and(|o| list.iter().any(|l| l == o)))
        };
        let chosen: Vec<&Row<'_>> = rows.iter().filter(kept).collect();
        let panels = match spec.panels.as_ref().and_then(|p| comparison.choices.iter().find(|c| c.name == *p)) {
            Some(choice) => choice.options.iter().map(|o| Some((choice, o.as_str()))).collect(),
            None => vec![None],
        };
        for panel in panels {
            let here = |row: &&&Row<'_>| panel.is_none_or(|(choice, o)| option(row, &choice.name) == Some(o));
            let rows: Vec<&Row<'_>> = chosen.iter().filter(here).copied().collect();
            if rows.is_empty() {
                continue;
            }
            let (mut name, mut title, mut caption) = (spec.name.clone(), spec.title.clone(), spec.caption.clone());
            if let Some((choice, option)) = panel {
                name += &format!("-{}", option.replace(['/', ' ', ':', '='], "-"));
                title += &format!(": {option}");
                caption += &format!(" {}: {option}.", choice.label);
            }
            let picture = Picture { comparison, spec, rows, title, panel: panel.map(|p| p.1) };
            let svg = match spec.kind {
                Kind::Curves => picture.curves()?,
                Kind::Map => Some(picture.map()?),
                Kind::Steps => picture.steps()?,
                Kind::Residuals => picture.residuals()?,
                Kind::Seconds => Some(picture.seconds()?),
                Kind::Contraction => picture.contraction()?,
            };
            figures.extend(svg.map(|svg| Figure { name, caption, svg }));
        }
    }
    Ok(figures)
}

/// A plot being drawn.
struct Picture<'a> {
    comparison: &'a Comparison,
    spec: &'a FigureSpec,
    rows: Vec<&'a Row<'a>>,
    title: String,
    panel: Option<&'a str>,
}

impl Picture<'_> {
    fn choice(&self, name: Option<&String>) -> Option<(usize, &Choice)> {
        self.comparison.choices.iter().enumerate().find(|(_, c)| Some(&c.name) == name)
    }

    /// What of a run is not said by title, x and y: the options of the choices `left_out` are left out, and those that
    /// all runs of the plot share.
    fn name(&self, row: &Row<'_>, left_out: &[usize]) -> String {
        let mut parts = Vec::new();
        for (c, choice) in self.comparison.choices.iter().enumerate() {
            let shared = self.rows.iter().all(|r| r.entry.options[c] == row.entry.options[c]);
            if !shared && !left_out.contains(&c) {
                let option = &choice.options[row.entry.options[c]];
                let bare = option.parse::<f64>().is_err() && !["true", "false"].contains(&option.as_str());
                parts.push(if bare { option.clone() } else { format!("{} {option}", choice.label) });
            }
        }
        parts.join(", ")
    }

    /// The line across, if this plot has one.
    fn line(&self) -> Option<&Line> {
        let here =
            |line: &&Line| line.panels.is_empty() || self.panel.is_some_and(|p| line.panels.iter().any(|l| l == p));
        self.spec.line.as_ref().filter(here)
    }

    fn curves(&self) -> Result<Option<String>, ResultsError> {
        let Some((cx, x)) = self.choice(self.spec.x.as_ref()) else { return Ok(None) };
        let Some(numbers) = x.numbers() else { return Ok(None) };
        let scale = |log: bool, v: f64| if log { v.log10() } else { v };
        let mut names: Vec<String> = Vec::new();
        // (x, y) of each series; y is NaN where the run has none.
        let mut lists: Vec<Vec<(f64, f64)>> = Vec::new();
        for row in &self.rows {
            let name = match self.choice(self.spec.series.as_ref()) {
                Some((c, choice)) => choice.options[row.entry.options[c]].clone(),
                None => self.name(row, &[cx]),
            };
            let value = self.spec.value.of(row).map_or(f64::NAN, |v| scale(self.spec.log_y, v));
            let point = (scale(self.spec.log_x, numbers[row.entry.options[cx]]), value);
            match names.iter().position(|n| *n == name) {
                Some(i) => lists[i].push(point),
                None => {
                    names.push(name);
                    lists.push(vec![point]);
                }
            }
        }
        if lists.len() > CURVES {
            return Ok(None);
        }
        let all = || lists.iter().flatten();
        let Some((x_low, x_high)) = extent(all().map(|p| p.0)) else { return Ok(None) };
        let (low, high) = extent(all().map(|p| p.1)).unwrap_or((0.0, 1.0));
        let room = 0.04 * (x_high - x_low).max(0.1);
        let x_axis = if self.spec.log_x {
            Axis::decades(&x.label, x_low - room, x_high + room)
        } else {
            Axis::new(&x.label, x_low, x_high)
        };
        let y_label = self.spec.value.label();
        let above = 0.12 * (high - low).max(0.1);
        let y_axis = if self.spec.log_y {
            Axis::decades(y_label, low - above, high + above)
        } else {
            let bottom = if low >= 0.0 { 0.0 } else { low };
            Axis::exact(y_label, bottom, high + 0.12 * (high - bottom), 7)
        };
        let mut curves: Vec<Curve> = Vec::new();
        for (i, (name, points)) in names.iter().zip(&lists).enumerate() {
            let mut points = points.clone();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            let curve = Curve::new(name, COLORS[i % COLORS.len()], points);
            let label = curve.label.clone().filter(|l| !l.is_empty());
            curves.push(Curve { dashed: i >= COLORS.len(), label, circles: true, ..curve });
        }
        let mut extra = Vec::new();
        let plain =
            |label: String, color, points| Curve { label: Some(label), color, dashed: true, circles: false, points };
        if let Some(line) = self.line() {
            let at = scale(self.spec.log_x, line.at);
            extra.push(plain(line.label.clone(), INK, vec![(at, y_axis.low), (at, y_axis.high)]));
        }
        if let Some(order) = self.spec.order {
            // Below the curve with the smallest error.
            let start = all().filter(|p| p.1.is_finite()).map(|p| (p.1 - order * (p.0 - x_low), p.0));
            if let Some((at, _)) = start.min_by(|a, b| a.0.total_cmp(&b.0)) {
                let shift = at - 0.06 * (y_axis.high - y_axis.low);
                let y = |x: f64| shift + order * (x - x_low);
                let from = x_low.max(x_low + (y_axis.low - shift) / order);
                extra.push(plain(format!("order {order}"), GREY, vec![(from, y(from)), (x_high, y(x_high))]));
            }
        }
        let failed: Vec<(f64, RGBColor)> = (lists.iter().enumerate())
            .flat_map(|(i, l)| l.iter().filter(|p| !p.1.is_finite()).map(move |p| (p.0, COLORS[i % COLORS.len()])))
            .collect();
        let drawn: Vec<Curve> = curves.into_iter().chain(extra).collect();
        let edge = y_axis.high - 0.05 * (y_axis.high - y_axis.low);
        chart::curves_with(&self.title, &x_axis, &y_axis, &drawn, |chart| {
            let mark = |&(x, color): &(f64, RGBColor)| Cross::new((x, edge), px(5.0), color.stroke_width(px(2.0)));
            chart.draw_series(failed.iter().map(mark)).map(drop)
        })
        .map(Some)
    }

    fn map(&self) -> Result<String, ResultsError> {
        let empty = Choice { name: String::new(), label: String::new(), options: Vec::new() };
        let (cx, x) = self.choice(self.spec.x.as_ref()).unwrap_or((0, &empty));
        let (cy, y) = self.choice(self.spec.y.as_ref()).unwrap_or((0, &empty));
        let (x_axis, y_axis) = (Axis::names(&x.label, &x.options), Axis::names(&y.label, &y.options));
        let mut keys = vec![Key::new(self.spec.value.label(), ramp(0.4), Mark::Box)];
        let ends: Vec<RGBColor> =
            self.rows.iter().filter(|r| self.spec.value.of(r).is_none()).map(|r| unfinished(r).0).collect();
        for (label, color) in [("× diverged or failed", VERMILION), ("> not in so many iterations", ORANGE)] {
            if ends.contains(&color) {
                keys.push(Key::new(label, color, Mark::Box));
            }
        }
        let line = self.line().and_then(|line| Some((place(line.at, &x.numbers()?)?, line)));
        if let Some((_, line)) = line {
            keys.push(Key::new(&line.label, INK, Mark::Dashes));
        }
        chart::svg(&self.title, &keys, 56 + 30 * y.options.len() as i32, |area| {
            let mut chart = chart::axes(area, &x_axis, &y_axis, 0)?;
            for row in &self.rows {
                let (i, j) = (row.entry.options[cx] as f64, row.entry.options[cy] as f64);
                let (color, text) = match self.spec.value.of(row) {
                    Some(v) => (
                        ramp(v.max(1.0).ln() / MANY.ln()),
                        if v < 10.0 { format!("{v:.1}") } else { format!("{v:.0}") },
                    ),
                    None => unfinished(row),
                };
                let corners = [(i - 0.48, j - 0.46), (i + 0.48, j + 0.46)];
                chart.draw_series([Rectangle::new(corners, color.filled())])?;
                let style = chart::font(13.0).color(&WHITE).pos(Pos::new(HPos::Center, VPos::Center));
                chart.draw_series([Text::new(text, (i, j), style)])?;
            }
            if let Some((at, _)) = line {
                let ends = [(at, y_axis.low), (at, y_axis.high)];
                let style = INK.stroke_width(px(3.0));
                chart.draw_series(DashedLineSeries::new(ends, px(7.0), px(4.0), style))?;
            }
            Ok(())
        })
    }

    fn steps(&self) -> Result<Option<String>, ResultsError> {
        let points = |row: &Row<'_>| -> Vec<(f64, f64)> {
            let mut counts = BTreeMap::<usize, usize>::new();
            for (number, attempt) in row.entry.outcome.iter().flat_map(super::Outcome::attempts) {
                *counts.entry(number).or_default() += attempt.iterations.len();
            }
            counts.into_iter().map(|(n, count)| (n as f64, count as f64)).collect()
        };
        let curves = self.each(points);
        let Some((_, high)) = extent(curves.iter().flat_map(|c| c.points.iter().map(|p| p.1))) else { return Ok(None) };
        let last = curves.iter().flat_map(|c| c.points.iter().map(|p| p.0)).fold(2.0, f64::max);
        let x = Axis::counts("time step", 0.6, last);
        let y = Axis::counts("coupling iterations", 0.0, high);
        chart::curves(&self.title, &x, &y, &curves).map(Some)
    }

    fn residuals(&self) -> Result<Option<String>, ResultsError> {
        let points = |row: &Row<'_>| -> Vec<(f64, f64)> {
            let attempts = row.entry.outcome.iter().flat_map(super::Outcome::attempts).map(|a| a.1);
            // One that failed is the hardest of all.
            let hardest = attempts.max_by_key(|a| (!a.outcome.is_accepted(), a.iterations.len()));
            let list = |a: &Attempt| (1..).zip(&a.iterations).map(|(i, r)| (f64::from(i), r.ratio().log10())).collect();
            hardest.map_or_else(Vec::new, list)
        };
        let mut curves = self.each(points);
        let all = || curves.iter().flat_map(|c| c.points.iter());
        let Some((low, high)) = extent(all().map(|p| p.1)) else { return Ok(None) };
        let most = all().map(|p| p.0).fold(2.0, f64::max);
        let points = vec![(0.8, 0.0), (most, 0.0)];
        curves.insert(0, Curve { label: Some("limit".into()), color: INK, dashed: true, circles: false, points });
        let x = Axis::counts("coupling iteration", 0.8, most);
        let y = Axis::powers("largest residual/limit", low.min(-1.0) - 0.2, high.max(0.0) + 0.3);
        chart::curves(&self.title, &x, &y, &curves).map(Some)
    }

    /// A curve for each run.
    fn each(&self, points: impl Fn(&Row<'_>) -> Vec<(f64, f64)>) -> Vec<Curve> {
        let curve = |(i, row): (usize, &&Row<'_>)| {
            let curve = Curve::new(self.name(row, &[]), COLORS[i % COLORS.len()], points(row));
            Curve { dashed: i >= COLORS.len(), ..curve }
        };
        self.rows.iter().take(CURVES).enumerate().map(curve).collect()
    }

    /// A line for each run, with its name above what `mark` draws at a height.
    fn lines(
        &self,
        keys: &[Key],
        x: &Axis,
        mark: impl Fn(&Row<'_>, f64, &mut chart::Chart<'_, '_>) -> chart::Drawn,
    ) -> Result<String, ResultsError> {
        const HEIGHT: i32 = 38;
        let n = self.rows.len() as i32;
        let y = Axis::bare(0.0, f64::from(n));
        chart::svg(&self.title, keys, 56 + HEIGHT * n, |area| {
            let mut chart = chart::axes(area, x, &y, 0)?;
            for (i, row) in (1..=n).rev().map(f64::from).zip(&self.rows) {
                let name = self.name(row, &[]);
                let failed = row.state() != "complete";
                let name = if failed { format!("{name} ({})", row.state()) } else { name };
                let style = chart::font(13.0).pos(Pos::new(HPos::Left, VPos::Center));
                let style = if failed { style.color(&VERMILION) } else { style };
                let at = x.low + 0.01 * (x.high - x.low);
                mark(row, i - 0.7, &mut chart)?;
                chart.draw_series([Text::new(name, (at, i - 0.26), style)])?;
            }
            Ok(())
        })
    }

    fn seconds(&self) -> Result<String, ResultsError> {
        let units = self.rows.iter().find_map(|r| r.entry.outcome.as_ref().ok()).map(|o| o.units.clone());
        let mut keys: Vec<Key> =
            (units.iter().flatten().zip(COLORS)).map(|(unit, color)| Key::new(unit, color, Mark::Box)).collect();
        keys.push(Key::new("all else", GREY, Mark::Box));
        let most = self.rows.iter().filter_map(|r| Some(r.measures.as_ref()?.total)).fold(0.0, f64::max);
        let x = Axis::exact(label("wall time", "s"), 0.0, 1.04 * most.max(1e-3), 6);
        self.lines(&keys, &x, |row, height, chart| {
            let Some(m) = &row.measures else { return Ok(()) };
            let rest = (m.total - m.seconds.iter().sum::<f64>()).max(0.0);
            let parts = m.seconds.iter().copied().chain([rest]);
            let mut from = 0.0;
            for (key, part) in keys.iter().zip(parts) {
                let corners = [(from, height - 0.2), (from + part, height + 0.2)];
                chart.draw_series([Rectangle::new(corners, key.color.filled())])?;
                from += part;
            }
            Ok(())
        })
    }

    fn contraction(&self) -> Result<Option<String>, ResultsError> {
        let Some(outcome) = self.rows.iter().find_map(|r| r.entry.outcome.as_ref().ok()) else { return Ok(None) };
        let keys: Vec<Key> =
            (outcome.fields.iter().zip(COLORS)).map(|(field, color)| Key::new(&field.name, color, Mark::Box)).collect();
        let rates = |row: &&Row<'_>| {
            row.measures.iter().flat_map(|m| m.contraction.iter().flatten().copied()).collect::<Vec<_>>()
        };
        let Some((_, high)) = extent(self.rows.iter().flat_map(rates)) else { return Ok(None) };
        let x = Axis::exact("residual over the one before", 0.0, 1.04 * high.max(1.0), 6);
        self.lines(&keys, &x, |row, height, chart| {
            chart.draw_series([PathElement::new(
                vec![(1.0, height - 0.3), (1.0, height + 0.3)],
                INK.stroke_width(px(1.5)),
            )])?;
            let Some(m) = &row.measures else { return Ok(()) };
            for (key, rate) in keys.iter().zip(&m.contraction) {
                if let Some(rate) = rate {
                    chart.draw_series([Circle::new((*rate, height), px(4.5), key.color.mix(0.85).filled())])?;
                }
            }
            Ok(())
        })
        .map(Some)
    }
}

/// Colour and text of a run that is not complete in a map.
fn unfinished(row: &Row<'_>) -> (RGBColor, String) {
    let failure = row.entry.outcome.as_ref().ok().and_then(|o| o.failure.as_ref());
    match failure.and_then(|f| f.attempts.last()) {
        Some(a) if a.outcome == AttemptOutcome::NotConverged => (ORANGE, format!("> {}", a.iterations.len())),
        Some(_) => (VERMILION, "×".into()),
        None => (GREY, "?".into()),
    }
}

/// Where a number lies among the numbers of names: on its own, or between two, on a logarithmic scale.
fn place(at: f64, numbers: &[f64]) -> Option<f64> {
    let pair = numbers.windows(2).position(|p| (p[0]..=p[1]).contains(&at))?;
    let (a, b) = (numbers[pair], numbers[pair + 1]);
    let part = if a > 0.0 { (at / a).ln() / (b / a).ln() } else { (at - a) / (b - a) };
    Some(pair as f64 + part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_known_by_name() {
        for text in ["iterations", "error.matrix.pressure", "seconds.flow", "contraction"] {
            assert_eq!(String::from(Value::try_from(text.to_owned()).unwrap()), text);
        }
        let error = Value::try_from("speed".to_owned()).unwrap_err();
        assert!(error.contains("speed") && error.contains("largest_iterations"), "{error}");
    }

    #[test]
    fn lines_lie_between_their_neighbours() {
        assert_eq!(place(1.0, &[0.1, 1.0, 10.0]), Some(1.0));
        assert!((place(10_f64.sqrt(), &[0.1, 1.0, 10.0]).unwrap() - 1.5).abs() < 1e-12);
        assert_eq!(place(0.5, &[0.0, 1.0]), Some(0.5));
        assert_eq!(place(200.0, &[0.1, 1.0, 10.0]), None);
    }
}
