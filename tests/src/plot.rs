//! Tables and plots of the studies.

use std::error::Error;
use std::fmt::Write as _;
use std::path::Path;

use plotters::prelude::*;

/// Points of a curve.
pub type Curve = Vec<(f64, f64)>;
/// What a study gives.
pub type Outcome<T> = Result<T, Box<dyn Error>>;

/// A curve with its name.
#[derive(Clone, Debug)]
pub struct Series {
    /// For the legend.
    pub label: String,
    /// Its points.
    pub points: Curve,
    /// Drawn thin and grey, to compare with.
    pub reference: bool,
}

impl Series {
    /// A curve to compare with.
    pub fn reference(label: impl Into<String>, points: Curve) -> Self {
        Self { label: label.into(), points, reference: true }
    }
}

impl From<(String, Curve)> for Series {
    fn from((label, points): (String, Curve)) -> Self {
        Self { label, points, reference: false }
    }
}

/// The line of this order below a curve of errors, from its last point on.
pub fn slope(order: f64, errors: &Curve) -> Series {
    let [first, last] = [errors[0], errors[errors.len() - 1]];
    let points = vec![(first.0, 0.7 * last.1 * (first.0 / last.0).powf(order)), (last.0, 0.7 * last.1)];
    Series::reference(format!("order {order}"), points)
}

/// Prints a table and writes it as CSV.
///
/// # Errors
/// Of the file system.
pub fn table(output: &Path, name: &str, head: &[&str], rows: &[Vec<String>]) -> Outcome<()> {
    let mut csv = head.join(",") + "\n";
    let width =
        |k: usize| rows.iter().map(|r| r[k].chars().count()).chain([head[k].chars().count()]).max().unwrap_or(0);
    let line = |cells: &[&str]| -> String {
        cells.iter().enumerate().map(|(k, c)| format!("{c:>w$}  ", w = width(k))).collect()
    };
    println!("{}", line(head));
    for row in rows {
        println!("{}", line(&row.iter().map(String::as_str).collect::<Vec<_>>()));
        writeln!(csv, "{}", row.join(","))?;
    }
    println!();
    std::fs::write(output.join(name).with_extension("csv"), csv)?;
    Ok(())
}

/// The order between two sizes and errors, as a table shows it.
pub fn order(previous: Option<(f64, f64)>, h: f64, error: f64) -> String {
    previous.map_or_else(String::new, |(h0, e0)| format!("{:.2}", (e0 / error).ln() / (h0 / h).ln()))
}

/// Log-log plots of errors, or linear plots of curves, as SVG.
///
/// # Errors
/// Of the file system and the drawing.
pub fn plot<S: Clone + Into<Series>>(
    output: &Path,
    name: &str,
    title: &str,
    axes: [&str; 2],
    curves: &[S],
    log: bool,
) -> Outcome<()> {
    let curves: Vec<Series> = curves.iter().cloned().map(Into::into).collect();
    let of = |k: usize| {
        let all = curves.iter().flat_map(|c| &c.points).map(move |p| if k == 0 { p.0 } else { p.1 });
        let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if log {
            (low / 1.3, high * 1.3)
        } else {
            // A constant still has a height.
            let margin = 0.03 * (high - low).max(1e-3 * high.abs());
            (low - margin, high + margin)
        }
    };
    let ((x0, x1), (y0, y1)) = (of(0), of(1));
    let file = output.join(name).with_extension("svg");
    let area = SVGBackend::new(&file, (900, 600)).into_drawing_area();
    area.fill(&WHITE)?;
    let mut builder = ChartBuilder::on(&area);
    builder.caption(title, ("sans-serif", 22)).margin(12).x_label_area_size(45).y_label_area_size(75);
    macro_rules! draw {
        ($chart:expr) => {{
            let mut chart = $chart;
            chart
                .configure_mesh()
                .x_desc(axes[0])
                .y_desc(axes[1])
                .x_label_formatter(&|v| short(*v, x1))
                .y_label_formatter(&|v| if log { format!("{v:.0e}") } else { short(*v, y1.abs().max(y0.abs())) })
                .light_line_style(if log { BLACK.mix(0.08) } else { TRANSPARENT })
                .draw()?;
            let mut colors = 0..;
            for Series { label, points, reference } in &curves {
                let color = if *reference {
                    BLACK.mix(0.5)
                } else {
                    Palette99::pick(colors.next().unwrap_or_default()).to_rgba()
                };
                let style = color.stroke_width(if *reference { 1 } else { 2 });
                chart
                    .draw_series(LineSeries::new(points.iter().copied(), style))?
                    .label(label)
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
                if points.len() < 15 && !reference {
                    chart.draw_series(points.iter().map(|&p| Circle::new(p, 4, color.filled())))?;
                }
            }
            let corner = if log { SeriesLabelPosition::LowerRight } else { SeriesLabelPosition::LowerMiddle };
            chart
                .configure_series_labels()
                .position(corner)
                .background_style(WHITE.mix(0.8))
                .border_style(BLACK)
                .draw()?;
        }};
    }
    if log {
        draw!(builder.build_cartesian_2d((x0..x1).log_scale(), (y0..y1).log_scale())?);
    } else {
        draw!(builder.build_cartesian_2d(x0..x1, y0..y1)?);
    }
    area.present()?;
    Ok(())
}

/// A number on an axis that goes up to `largest`.
fn short(v: f64, largest: f64) -> String {
    if (1e-2..1e4).contains(&largest) {
        let text = format!("{v:.4}");
        let text = text.trim_end_matches('0').trim_end_matches('.');
        return if text == "-0" { "0".into() } else { text.into() };
    }
    if v == 0.0 { "0".into() } else { format!("{v:.2e}") }
}
