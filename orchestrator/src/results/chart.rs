//! Charts as SVG, through plotters: axes with units and round numbers, legends above the chart where they cover nothing,
//! colours that the colour-blind tell apart (Okabe, Ito, 2008).
//!
//! plotters places everything on whole pixels. Charts are drawn [`SCALE`] times larger than they are shown.

use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::ResultsError;

/// Drawn pixels for one shown.
pub(crate) const SCALE: i32 = 4;
/// Width of all charts as shown: a phone shows them at some 75 %, still readable.
pub(crate) const WIDTH: i32 = 480;
/// Least room left of a chart, for numbers and label, apart from [`MARGIN`].
const LEFT: i32 = 60;
/// Room for the label beside the numbers.
const LABEL: f64 = 30.5;
/// Width of a letter: sans-serif ones are a bit more than half as wide as high.
const LETTER: f64 = 7.3;
/// Room at the left edge, for what different programs make of turned text.
const MARGIN: i32 = 8;
/// Room right of a chart: half a number.
const RIGHT: i32 = 18;
/// Room below a chart.
const BELOW: i32 = 42;
/// Room above a chart: half a number.
const ABOVE: i32 = 8;

pub(crate) const BLUE: RGBColor = RGBColor(0, 114, 178);
pub(crate) const VERMILION: RGBColor = RGBColor(213, 94, 0);
pub(crate) const ORANGE: RGBColor = RGBColor(230, 159, 0);
pub(crate) const GREEN: RGBColor = RGBColor(0, 158, 115);
pub(crate) const PURPLE: RGBColor = RGBColor(204, 121, 167);
pub(crate) const SKY: RGBColor = RGBColor(86, 180, 233);
pub(crate) const GREY: RGBColor = RGBColor(130, 130, 130);
pub(crate) const INK: RGBColor = RGBColor(40, 40, 40);

pub(crate) type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
pub(crate) type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;
pub(crate) type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Axis, Axis>>;

/// A length as shown in pixels of the drawing.
pub(crate) fn px(shown: f64) -> u32 {
    (shown * f64::from(SCALE)).round() as u32
}

/// A colour between early (0) and late (1): viridis without its yellow, which is too light on white.
pub(crate) fn ramp(t: f64) -> RGBColor {
    const ANCHORS: [[f64; 3]; 4] = [[68., 1., 84.], [59., 82., 139.], [33., 145., 140.], [110., 206., 88.]];
    let x = t.clamp(0.0, 1.0) * 3.0;
    let i = (x as usize).min(2);
    let mixed = [0, 1, 2].map(|k| (ANCHORS[i][k] + (x - i as f64) * (ANCHORS[i + 1][k] - ANCHORS[i][k])) as u8);
    RGBColor(mixed[0], mixed[1], mixed[2])
}

/// How an entry of the legend looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Mark {
    Line,
    Dashes,
    Box,
}

/// An entry of the legend.
#[derive(Clone, Debug)]
pub(crate) struct Key {
    pub(crate) label: String,
    pub(crate) color: RGBColor,
    pub(crate) mark: Mark,
}

impl Key {
    pub(crate) fn new(label: impl Into<String>, color: RGBColor, mark: Mark) -> Self {
        Self { label: label.into(), color, mark }
    }

    fn width(&self) -> i32 {
        28 + (LETTER * self.label.chars().count() as f64) as i32 + 8
    }
}

/// A drawing with a title and a legend; `draw` is given the part below them.
pub(crate) fn svg(
    title: &str,
    keys: &[Key],
    height: i32,
    draw: impl FnOnce(&Area<'_>) -> Drawn,
) -> Result<String, ResultsError> {
    let mut places = Vec::new();
    let (mut x, mut y) = (12, 34);
    for key in keys {
        if x + key.width() > WIDTH && x > 12 {
            (x, y) = (12, y + 20);
        }
        places.push((x, y));
        x += key.width();
    }
    let top = if keys.is_empty() { 36 } else { y + 22 };
    let size = (px(WIDTH.into()), px((top + height).into()));
    let mut text = String::new();
    let make = || -> Drawn {
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        area.fill(&WHITE)?;
        let at = |x: i32, y: i32| (x * SCALE, y * SCALE);
        let bold = FontDesc::new(FontFamily::SansSerif, letters(15.0), FontStyle::Bold);
        area.draw(&Text::new(title.to_owned(), at(12, 10), TextStyle::from(bold).color(&INK)))?;
        for (key, &(x, y)) in keys.iter().zip(&places) {
            let y = y + 7;
            match key.mark {
                Mark::Box => area.draw(&Rectangle::new([at(x + 5, y - 6), at(x + 17, y + 6)], key.color.filled()))?,
                Mark::Line => {
                    area.draw(&PathElement::new([at(x, y), at(x + 22, y)], key.color.stroke_width(px(3.0))))?;
                }
                Mark::Dashes => {
                    for i in 0..3 {
                        let (a, b) = (at(x + 8 * i, y), at(x + 8 * i + 5, y));
                        area.draw(&PathElement::new([a, b], key.color.stroke_width(px(3.0))))?;
                    }
                }
            }
            let style = font(13.0).pos(Pos::new(HPos::Left, VPos::Center));
            area.draw(&Text::new(key.label.clone(), at(x + 28, y), style))?;
        }
        draw(&area.margin(px(top.into()), 0, 0, 0))?;
        area.present()
    };
    make().map_err(|error| ResultsError::Drawing { plot: title.into(), reason: error.to_string() })?;
    let large = format!("width=\"{}\" height=\"{}\"", size.0, size.1);
    let shown = format!("width=\"{WIDTH}\" height=\"{}\" role=\"img\" aria-label=\"{}\"", top + height, escaped(title));
    Ok(text.replacen(&large, &shown, 1))
}

/// What plotters must be told for letters of a size (shown): it divides by this to allow for the whole line.
fn letters(size: f64) -> f64 {
    1.24 * f64::from(px(size))
}

pub(crate) fn font(size: f64) -> TextStyle<'static> {
    TextStyle::from(("sans-serif", letters(size)).into_font()).color(&INK)
}

/// Text for XML.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// An axis with its ticks.
#[derive(Clone, Debug)]
pub(crate) struct Axis {
    label: String,
    pub(crate) low: f64,
    pub(crate) high: f64,
    ticks: Vec<(f64, String)>,
}

impl Axis {
    /// From `low` to `high`, with room around.
    pub(crate) fn new(label: impl Into<String>, low: f64, high: f64) -> Self {
        // A constant still has a height.
        let margin = 0.04 * (high - low).max(1e-2 * high.abs().max(low.abs())).max(f64::MIN_POSITIVE);
        Self::exact(label, low - margin, high + margin, 8)
    }

    /// From `low` to `high`, with about `count` ticks.
    pub(crate) fn exact(label: impl Into<String>, low: f64, high: f64, count: usize) -> Self {
        let step = round_step((high - low) / count as f64);
        Self::with_step(label, low, high, step)
    }

    /// For whole numbers from `low`.
    pub(crate) fn counts(label: impl Into<String>, low: f64, high: f64) -> Self {
        let margin = 0.04 * (high - low).max(1.0);
        let step = round_step((high - low) / 7.0).max(1.0);
        Self::with_step(label, low, high + margin, step)
    }

    fn with_step(label: impl Into<String>, low: f64, high: f64, step: f64) -> Self {
        let decimals = (-step.log10().floor()).clamp(0.0, 12.0) as usize;
        let ticks = ((low / step).ceil() as i64..=(high / step).floor() as i64).map(|i| i as f64 * step);
        let name = |v: f64| format!("{v:.decimals$}").replace('-', "−");
        Self { label: label.into(), low, high, ticks: ticks.map(|v| (v, name(v))).collect() }
    }

    /// For decimal logarithms; the ticks show powers.
    pub(crate) fn powers(label: impl Into<String>, low: f64, high: f64) -> Self {
        let step = ((high - low) / 8.0).ceil().max(1.0) as usize;
        let ticks = (low.ceil() as i64..=high.floor() as i64).rev().step_by(step);
        Self { label: label.into(), low, high, ticks: ticks.map(|i| (i as f64, power(i))).collect() }
    }

    /// For decimal logarithms: numbers where all are easy to read, and where they are few also 2 and 5 times them; else powers.
    pub(crate) fn decades(label: impl Into<String>, low: f64, high: f64) -> Self {
        const FEW: f64 = 2.0;
        let mut axis = Self::powers(label, low, high);
        if low > -3.0 && high < 5.0 {
            axis.ticks.iter_mut().for_each(|(i, name)| *name = number(10_f64.powf(*i)));
        }
        if high - low < FEW {
            let all = (low.floor() as i32..=high.floor() as i32).flat_map(|i| [1.0, 2.0, 5.0].map(|m| (m, i)));
            let named = all.map(|(m, i): (f64, i32)| (m.log10() + f64::from(i), number(m * 10_f64.powi(i))));
            axis.ticks = named.filter(|t| (low..=high).contains(&t.0)).collect();
        }
        axis
    }

    /// For things with names, at 0, 1, …
    pub(crate) fn names(label: impl Into<String>, names: &[String]) -> Self {
        let ticks = names.iter().enumerate().map(|(i, name)| (i as f64, name.clone())).collect();
        Self { label: label.into(), low: -0.5, high: names.len() as f64 - 0.5, ticks }
    }

    /// Without numbers.
    pub(crate) fn bare(low: f64, high: f64) -> Self {
        Self { label: String::new(), low, high, ticks: Vec::new() }
    }

    /// Room (shown) left of a chart with these numbers.
    fn left(&self) -> i32 {
        let longest = self.ticks.iter().map(|(_, name)| name.chars().count()).max().unwrap_or(0);
        LEFT.max((LABEL + LETTER * longest as f64).ceil() as i32)
    }

    fn name(&self, value: f64) -> String {
        self.ticks.iter().find(|t| t.0 == value).map_or_else(String::new, |t| t.1.clone())
    }
}

impl Ranged for Axis {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (from, to): (i32, i32)) -> i32 {
        from + (f64::from(to - from) * (value - self.low) / (self.high - self.low)).round() as i32
    }

    fn key_points<H: KeyPointHint>(&self, hint: H) -> Vec<f64> {
        // Light points are grid lines between the ticks.
        if hint.weight().allow_light_points() { Vec::new() } else { self.ticks.iter().map(|t| t.0).collect() }
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.low..self.high
    }
}

/// 1, 2 or 5 times a power of ten, at least `least`.
fn round_step(least: f64) -> f64 {
    if !(least > 0.0 && least.is_finite()) {
        return 1.0;
    }
    let power = 10_f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|&s| s >= least).unwrap_or(10.0 * power)
}

/// 10ⁱ.
pub(crate) fn power(i: i64) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let raised = i.to_string().chars().map(|c| c.to_digit(10).map_or('⁻', |d| DIGITS[d as usize])).collect::<String>();
    if i == 0 { "1".into() } else { format!("10{raised}") }
}

/// Axes and grid; `free` is room (shown pixels) left on the right.
pub(crate) fn axes<'a, 'b>(
    area: &'a Area<'b>,
    x: &Axis,
    y: &Axis,
    free: i32,
) -> Result<Chart<'a, 'b>, DrawingAreaErrorKind<std::io::Error>> {
    let mut chart = ChartBuilder::on(area)
        .margin_top(px(ABOVE.into()))
        .margin_left(px(MARGIN.into()))
        .margin_right(px((RIGHT + free).into()))
        .x_label_area_size(px(BELOW.into()))
        .y_label_area_size(px(y.left().into()))
        .build_cartesian_2d(x.clone(), y.clone())?;
    chart
        .configure_mesh()
        .bold_line_style(INK.mix(0.12).stroke_width(px(0.75)))
        .light_line_style(TRANSPARENT)
        .axis_style(INK.mix(0.6).stroke_width(px(1.0)))
        .label_style(font(13.0))
        .axis_desc_style(font(14.0))
        .set_all_tick_mark_size(px(4.0))
        .x_desc(&x.label)
        .y_desc(&y.label)
        .x_label_formatter(&|v| x.name(*v))
        .y_label_formatter(&|v| y.name(*v))
        .draw()?;
    Ok(chart)
}

/// Height (shown) of the area, and room on the right, with which axes have the same scale in x and y.
pub(crate) fn equal_scale(x: &Axis, y: &Axis) -> (i32, i32) {
    const HIGHEST: f64 = 420.0;
    let width = f64::from(WIDTH - MARGIN - y.left() - RIGHT);
    let ratio = (y.high - y.low) / (x.high - x.low);
    let height = (width * ratio).min(HIGHEST);
    ((height.round() as i32) + ABOVE + BELOW, (width - height / ratio).round() as i32)
}

/// A curve.
#[derive(Clone, Debug)]
pub(crate) struct Curve {
    /// Its name in the legend, or none.
    pub(crate) label: Option<String>,
    pub(crate) color: RGBColor,
    pub(crate) dashed: bool,
    /// Circles on its points.
    pub(crate) circles: bool,
    pub(crate) points: Vec<(f64, f64)>,
}

impl Curve {
    pub(crate) fn new(label: impl Into<String>, color: RGBColor, points: Vec<(f64, f64)>) -> Self {
        // Circles on a dense curve hide it.
        let circles = points.len() <= 30;
        Self { label: Some(label.into()), color, dashed: false, circles, points }
    }
}

/// Smallest and largest of some values that are finite, if there are.
pub(crate) fn extent(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    let (low, high) = (values.into_iter().filter(|v| v.is_finite()))
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    (low <= high).then_some((low, high))
}

/// A chart of curves. Points that are not finite interrupt them.
pub(crate) fn curves(title: &str, x: &Axis, y: &Axis, curves: &[Curve]) -> Result<String, ResultsError> {
    curves_with(title, x, y, curves, |_| Ok(()))
}

/// [`curves`], with what `more` draws on top.
pub(crate) fn curves_with(
    title: &str,
    x: &Axis,
    y: &Axis,
    curves: &[Curve],
    more: impl FnOnce(&mut Chart<'_, '_>) -> Drawn,
) -> Result<String, ResultsError> {
    let mark = |c: &Curve| if c.dashed { Mark::Dashes } else { Mark::Line };
    let keys: Vec<Key> = curves.iter().filter_map(|c| Some(Key::new(c.label.clone()?, c.color, mark(c)))).collect();
    svg(title, &keys, 270, |area| {
        let mut chart = axes(area, x, y, 0)?;
        for curve in curves {
            let style = curve.color.stroke_width(px(2.0));
            for piece in curve.points.split(|p| !(p.0.is_finite() && p.1.is_finite())) {
                let points = piece.iter().copied();
                if curve.dashed {
                    chart.draw_series(DashedLineSeries::new(points, px(6.0), px(4.0), style))?;
                } else {
                    chart.draw_series(LineSeries::new(points, style))?;
                }
                if curve.circles {
                    chart.draw_series(piece.iter().map(|&p| Circle::new(p, px(2.75), curve.color.filled())))?;
                }
            }
        }
        more(&mut chart)
    })
}

/// A factor that makes values up to `largest` easy to read, and the unit that they then have.
pub(crate) fn scaled(unit: &str, largest: f64) -> (f64, String) {
    const DAY: f64 = 86_400.0;
    let table: &[(f64, f64, &str)] = match unit {
        "s" => &[(3.0 * 365.25 * DAY, 365.25 * DAY, "years"), (3.0 * DAY, DAY, "days"), (1e4, 3600.0, "h")],
        "Pa" => &[(1e9, 1e9, "GPa"), (1e6, 1e6, "MPa"), (1e3, 1e3, "kPa")],
        "m" => &[(1e4, 1e3, "km"), (0.1, 1.0, "m"), (1e-3, 1e-3, "mm"), (0.0, 1e-6, "µm")],
        _ => &[],
    };
    if let Some(&(_, size, name)) = table.iter().find(|row| largest >= row.0) {
        return (1.0 / size, name.to_owned());
    }
    let unit = pretty(unit);
    if largest > 0.0 && !(1e-2..1e5).contains(&largest) {
        let i = largest.log10().floor() as i64;
        return (10_f64.powi(-i as i32), format!("{} {unit}", power(i)).trim_end().to_owned());
    }
    (1.0, unit)
}

/// A unit of measure as it is printed.
pub(crate) fn pretty(unit: &str) -> String {
    if unit == "1" {
        return String::new();
    }
    unit.replace("m2", "m²").replace("m3", "m³").replace("s2", "s²").replace('.', " ").replace("-1", "⁻¹")
}

/// A label with its unit of measure.
pub(crate) fn label(name: &str, unit: &str) -> String {
    if unit.is_empty() { name.to_owned() } else { format!("{name} ({unit})") }
}

/// A number for text: four significant digits.
pub(crate) fn number(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    if !value.is_finite() {
        return value.to_string().replace("inf", "∞").replace('-', "−");
    }
    let size = value.abs().log10().floor();
    if !(-3.0..5.0).contains(&size) {
        let text = format!("{value:.3e}");
        let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
        let mantissa = mantissa.trim_end_matches('0').trim_end_matches('.');
        return match exponent.parse() {
            Ok(i) => format!("{mantissa} × {}", power(i)).replace('-', "−"),
            Err(_) => text,
        };
    }
    let decimals = (3.0 - size).max(0.0) as usize;
    let text = format!("{value:.decimals$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    text.replace('-', "−")
}

/// A time (s) for text.
pub(crate) fn time(value: f64) -> String {
    let (factor, unit) = scaled("s", value.abs());
    format!("{} {unit}", number(value * factor))
}
