//! Compares a run with the reference of its model, `reference.csv` in the model's folder.

use std::io::{self, Write};
use std::process::ExitCode;

use super::case::Case;
use super::error::CliError;
use super::pack;
use super::run::{fmus, start};

/// Largest relative difference from the reference. It was made with another program on other meshes of the same
/// resolution, which differ by about 1 %.
const TOLERANCE: f64 = 0.02;
/// Coupling iterations a time step of the reference, with fixed stress and probed compliances.
const MOST_ITERATIONS: usize = 9;

/// What is claimed of a model and not checked by this command, and what shows it.
const ELSEWHERE: [(&str, &str); 9] = [
    ("six-fractures", "order 1.5 of pressure and displacement against a fine reference: not checked"),
    ("six-fractures", "polygons agree with triangles: compare `run --variant polygons`"),
    (
        "manufactured-contact",
        "orders on all kinds of 3D meshes: `mechanics-study manufactured`, tests/manufactured_contact.rs",
    ),
    (
        "single-crack",
        "slip and traction against the exact curves: `mechanics-study single-crack`, tests/single_crack.rs",
    ),
    ("network-3d", "contact states, slip, Newton iterations with both bubbles: `mechanics-study network-3d`"),
    ("fault-reactivation", "onset near 15 days at 9.9 MPa, slip against the hand check: not checked"),
    ("terzaghi", "order against the closed solution: not checked"),
    ("mandel", "order against the closed solution: not checked"),
    ("sneddon", "order against the closed solution: not checked"),
];

/// A line of the reference: a time (s) and expected scalars by name.
struct Row {
    time: f64,
    expected: Vec<(String, f64)>,
}

/// `orchestrator verify`.
pub(crate) fn verify(case: &Case, variants: &[String], changes: &[String]) -> Result<ExitCode, CliError> {
    let path = case.folder.join("reference.csv");
    let rows = if path.is_file() {
        let text = std::fs::read_to_string(&path).map_err(CliError::file(&path))?;
        let variant = if variants.is_empty() { "default".to_owned() } else { variants.join("+") };
        parse(&text, &variant).map_err(|reason| CliError::Unfit(format!("{}: {reason}", path.display())))?
    } else {
        Vec::new()
    };
    let mut out = io::stdout();
    let mut say = |line: &str| writeln!(out, "{line}").map_err(CliError::Output);
    let mut failed = rows.is_empty();
    if rows.is_empty() {
        say("nothing was verified: this model has no reference that a run could be compared with")?;
    } else {
        if !changes.is_empty() {
            say("the model is changed; the reference is for the model as it is")?;
        }
        failed = compare(case, &rows, &mut say)? > 0;
    }
    for (_, claim) in ELSEWHERE.iter().filter(|(name, _)| *name == case.name) {
        say(&format!("elsewhere  {claim}"))?;
    }
    Ok(if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Runs the model and prints each claim; gives the number of those that do not hold.
fn compare(case: &Case, rows: &[Row], say: &mut dyn FnMut(&str) -> Result<(), CliError>) -> Result<usize, CliError> {
    let mesh = case.mesh()?;
    let temporary = pack::temporary("fmus-")?;
    let paths = fmus(&case.document, &mesh, temporary.path())?;
    let (mut run, series) = start(&paths, &case.document, &mesh)?.run()?;
    let (mut largest, mut wrong, mut checked) = (0, 0, 0);
    let mut claim = |holds: bool, text: String| {
        wrong += usize::from(!holds);
        say(&format!("{}  {text}", if holds { "pass" } else { "FAIL" }))
    };
    while !run.is_finished() {
        let record = run.advance()?;
        largest = largest.max(record.iterations().len());
        for row in rows.iter().filter(|row| row.time == record.time) {
            checked += 1;
            let snapshot = series.of(&mut run)?;
            for (name, expected) in &row.expected {
                let scalar = snapshot.scalars.iter().find(|s| s.name == *name);
                let (found, measure) = scalar.map_or((f64::NAN, ""), |s| (s.value, s.unit.as_str()));
                let difference = (found - expected) / expected.abs();
                let percent = 100.0 * difference;
                claim(
                    difference.abs() <= TOLERANCE,
                    format!(
                        "t = {} s: {name} {found:.4e} {measure}, reference {expected:.4e} ({percent:+.2} %)",
                        row.time
                    ),
                )?;
            }
        }
    }
    claim(checked == rows.len(), format!("{checked} of {} times of the reference were reached", rows.len()))?;
    let text = format!("at most {MOST_ITERATIONS} coupling iterations a time step; there were at most {largest}");
    claim(largest <= MOST_ITERATIONS, text)?;
    Ok(wrong)
}

/// The rows of a variant. The first line that is no comment has the names; the first two columns are variant and time.
fn parse(text: &str, variant: &str) -> Result<Vec<Row>, String> {
    let mut lines = text.lines().filter(|line| !line.starts_with('#') && !line.trim().is_empty());
    let names: Vec<&str> = lines.next().ok_or("it has no names of columns")?.split(',').skip(2).collect();
    let mut rows = Vec::new();
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        if cells.len() != names.len() + 2 {
            return Err(format!("\"{line}\" does not have {} columns", names.len() + 2));
        }
        if cells[0] != variant {
            continue;
        }
        let number = |text: &str| text.trim().parse::<f64>().map_err(|error| format!("\"{text}\": {error}"));
        let expected = names.iter().zip(&cells[2..]).map(|(name, cell)| Ok(((*name).to_owned(), number(cell)?)));
        rows.push(Row { time: number(cells[1])?, expected: expected.collect::<Result<_, String>>()? });
    }
    Ok(rows)
}

/// Keeps the table above and the models together.
#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use super::*;

    fn models() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../models")
    }

    #[test]
    fn claims_are_of_models_that_there_are() {
        for (name, _) in ELSEWHERE {
            assert!(models().join(name).join("model.toml").is_file(), "{name}");
        }
    }

    #[test]
    fn the_reference_of_six_fractures_is_read() {
        let text = std::fs::read_to_string(models().join("six-fractures/reference.csv")).unwrap();
        for variant in ["default", "h0.02", "h0.01"] {
            let rows = parse(&text, variant).unwrap();
            assert_eq!(rows.iter().map(|r| r.time).collect::<Vec<_>>(), [100.0, 500.0, 1000.0, 2000.0]);
            assert!(rows.iter().all(|r| r.expected.len() == 3 && r.expected[0].0 == "aperture.mean"));
        }
        assert!(parse(&text, "polygons").unwrap().is_empty());
        assert!(parse("variant,time,a\ndefault,1", "default").is_err());
        assert!(parse("variant,time,a\ndefault,1,x", "default").is_err());
    }
}
