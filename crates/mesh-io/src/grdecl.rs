//! Corner-point grids, as GRDECL text.
//!
//! | keyword | values | meaning |
//! |---|---|---|
//! | `SPECGRID` or `DIMENS` | NI NJ NK | number of cells along i, j and k |
//! | `COORD` | 6 (NI+1)(NJ+1) | x, y, z (m, z downward) of two points of each pillar, those along i first |
//! | `ZCORN` | 8 NI NJ NK | depth (m) of the corners, see [`CornerPoint::heights`] |
//! | `ACTNUM` | NI NJ NK | 1 for cells that are there, 0 for others; left out: all are |
//! | any, by choice | NI NJ NK | a number that tells regions |
//! | `FAULTS` | records | name, I1 I2, J1 J2, K1 K2, face (`X`, `X-`, `I`, … `K-`): these become fractures |
//!
//! Keywords begin in the first column; values end with `/`; `n*v` stands for n times v; `--` begins a comment, and so does
//! what follows `/` in a line. All other keywords are skipped, but where they would change what is read: `INCLUDE`, feet,
//! and `EQUALS` and the like on one of these arrays are refused.

use std::collections::BTreeMap;
use std::path::Path;

use mesh::generate::{CornerPoint, Fault};
use mesh::{MeshData, Vec3};

use crate::FileError;

/// More cells than this are taken for damage.
const MOST_CELLS: usize = 1 << 24;

/// Keywords that change arrays which stand elsewhere.
const EDITS: [&str; 8] = ["ADD", "COPY", "EQUALS", "MAXVALUE", "MINVALUE", "MULTIPLY", "EQUALREG", "OPERATE"];

/// How a corner-point grid is taken.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Grdecl {
    /// Whether a grid of one row of cells along j is a section in two dimensions, of x and height.
    pub section: bool,
    /// Height (m) of depth 0: depths turn into heights below it.
    pub elevation: f64,
    /// The keyword whose numbers tell regions; without it there is one, `rock`.
    pub regions: Option<String>,
    /// Names of regions by their number; others are called by their number.
    pub names: BTreeMap<String, String>,
    /// The faults that are fractures; without it, all.
    pub faults: Option<Vec<String>>,
}

/// Reads a mesh. See [`CornerPoint::build`] for its boundary tags.
///
/// # Errors
/// [`FileError::Io`]; [`FileError::Problems`] with all that is wrong with the text, or else [`FileError::Grid`] with
/// all that is wrong with the grid.
pub fn read_grdecl(path: impl AsRef<Path>, options: &Grdecl) -> Result<MeshData, FileError> {
    let path = path.as_ref();
    let bytes = std::fs::read(path).map_err(FileError::io(path))?;
    // Comments may have any encoding.
    let text = String::from_utf8_lossy(&bytes);
    let mut file = File { problems: Vec::new(), sections: BTreeMap::new() };
    file.split(&text, options);
    let content = file.content(options);
    let (Some((grid, regions)), true) = (content, file.problems.is_empty()) else {
        file.problems.sort();
        let problems = file.problems.into_iter().map(|problem| problem.1).collect();
        return Err(FileError::Problems { path: path.into(), problems });
    };
    let refused = |source| FileError::Grid { path: path.into(), source };
    let (mut data, cells) = grid.build(options.section).map_err(refused)?;
    if let Some(regions) = regions {
        data.regions.clear();
        for (cell, number) in cells.into_iter().enumerate() {
            let number = regions[number].to_string();
            data.cell_region[cell] = data.region(options.names.get(&number).unwrap_or(&number));
        }
    }
    Ok(data)
}

/// What stands between a keyword and its end.
#[derive(Default)]
struct Section<'a> {
    line: usize,
    /// Words with their lines; in `FAULTS`, an empty one ends a record.
    words: Vec<(usize, &'a str)>,
}

struct File<'a> {
    /// Lines (0 where there is none) and messages.
    problems: Vec<(usize, String)>,
    sections: BTreeMap<&'a str, Section<'a>>,
}

impl<'a> File<'a> {
    fn problem(&mut self, line: usize, keyword: &str, problem: impl AsRef<str>) {
        let place = if line == 0 { String::new() } else { format!("line {line}: ") };
        self.problems.push((line, format!("{place}{keyword}: {}", problem.as_ref())));
    }

    /// Finds the keywords that are read.
    fn split(&mut self, text: &'a str, options: &Grdecl) {
        let arrays = |word: &str| {
            ["SPECGRID", "DIMENS", "COORD", "ZCORN", "ACTNUM"].contains(&word)
                || options.regions.as_deref() == Some(word)
        };
        // The keyword that values now belong to, and whether it is read.
        let mut current: Option<(&str, bool)> = None;
        for (number, line) in text.lines().enumerate().map(|(number, line)| (number + 1, line)) {
            let (words, ended) = words(line);
            let mut words = words.as_slice();
            if let (true, [keyword, rest @ ..]) = (line.starts_with(|c: char| c.is_ascii_alphabetic()), words) {
                if let Some((unfinished, true)) = current {
                    self.problem(number, unfinished, format!("there is no `/` before {keyword}"));
                }
                let mut is_read = arrays(keyword) || *keyword == "FAULTS";
                if let (true, Some(first)) = (arrays(keyword), self.sections.get(keyword).map(|first| first.line)) {
                    self.problem(number, keyword, format!("it stands in line {first} already"));
                    is_read = false;
                }
                if *keyword == "INCLUDE" {
                    self.problem(number, keyword, "other files are not read; put their text here");
                }
                if is_read {
                    self.sections.entry(keyword).or_insert_with(|| Section { line: number, words: Vec::new() });
                }
                current = Some((keyword, is_read));
                words = rest;
            }
            let Some((keyword, is_read)) = current else { continue };
            for word in words {
                if EDITS.contains(&keyword) && arrays(word) {
                    self.problem(
                        number,
                        keyword,
                        format!("it changes {word}, which is not followed; write out {word}"),
                    );
                } else if keyword == "GRIDUNIT"
                    && (word.eq_ignore_ascii_case("feet") || word.eq_ignore_ascii_case("cm"))
                {
                    self.problem(number, keyword, format!("the unit is {word}; only METRES is read"));
                }
            }
            if let Some(section) = self.sections.get_mut(keyword).filter(|_| is_read) {
                let before = section.words.last().is_some_and(|word| !word.1.is_empty());
                let records = keyword == "FAULTS";
                section.words.extend(words.iter().map(|&word| (number, word)));
                if ended && records && (before || !words.is_empty()) {
                    section.words.push((number, ""));
                } else if ended {
                    current = None;
                }
            }
        }
        if let Some((unfinished, true)) = current {
            self.problem(text.lines().count(), unfinished, "there is no `/` before the end of the file");
        }
    }

    fn content(&mut self, options: &Grdecl) -> Option<(CornerPoint, Option<Vec<i64>>)> {
        let cells = self.cells();
        let count = cells.map(|cells| cells.into_iter().product::<usize>());
        let pillars = cells.map(|[ni, nj, _]| (ni + 1) * (nj + 1));
        let coord = self.array("COORD", pillars.map(|n| 6 * n), |_| true, "a number");
        let depth = self.array("ZCORN", count.map(|n| 8 * n), |_| true, "a number");
        let flag = |v| v == 0.0 || v == 1.0;
        let active = match self.sections.contains_key("ACTNUM") {
            true => self.array("ACTNUM", count, flag, "0 or 1"),
            false => count.map(|n| vec![1.0; n]),
        };
        let whole = |v: f64| v.fract() == 0.0 && v.abs() < 1e15;
        let region = options.regions.as_ref().map(|keyword| self.array(keyword, count, whole, "a whole number"));
        let mut faults = self.faults();
        if let Some(chosen) = &options.faults {
            for name in chosen.iter().filter(|&name| faults.iter().all(|fault| fault.name != *name)) {
                self.problem(0, "FAULTS", format!("there is no fault \"{name}\""));
            }
            faults.retain(|fault| chosen.contains(&fault.name));
        }
        let point = |p: &[f64]| Vec3::new(p[0], p[1], options.elevation - p[2]);
        let grid = CornerPoint {
            cells: cells?,
            pillars: coord?.chunks_exact(6).map(|pillar| [point(&pillar[..3]), point(&pillar[3..])]).collect(),
            heights: depth?.into_iter().map(|z| options.elevation - z).collect(),
            active: active?.into_iter().map(|flag| flag == 1.0).collect(),
            faults,
        };
        let regions = match region {
            Some(region) => Some(region?.into_iter().map(|v| v as i64).collect()),
            None => None,
        };
        Some((grid, regions))
    }

    fn cells(&mut self) -> Option<[usize; 3]> {
        let mut found: Option<[usize; 3]> = None;
        for keyword in ["SPECGRID", "DIMENS"] {
            let Some(Section { line, words }) = self.sections.remove(keyword) else { continue };
            let numbers: Vec<Option<usize>> = words.iter().take(3).map(|word| word.1.parse().ok()).collect();
            let &[Some(ni), Some(nj), Some(nk)] = numbers.as_slice() else {
                self.problem(line, keyword, "three numbers of cells are needed");
                return None;
            };
            if ni.checked_mul(nj).and_then(|n| n.checked_mul(nk)).is_none_or(|n| n == 0 || n > MOST_CELLS) {
                self.problem(line, keyword, format!("there must be 1 to {MOST_CELLS} cells, not {ni} x {nj} x {nk}"));
                return None;
            }
            if let [_, _, _, (_, reservoirs), ..] = words[..]
                && reservoirs != "1"
            {
                self.problem(line, keyword, format!("the number of reservoirs is {reservoirs}; it must be 1"));
            }
            if let [.., (_, kind)] = words[..]
                && kind.eq_ignore_ascii_case("t")
            {
                self.problem(line, keyword, "coordinates are cylindrical (T); they must be Cartesian (F)");
            }
            if found.is_some_and(|found| found != [ni, nj, nk]) {
                self.problem(line, keyword, "it has other numbers of cells than SPECGRID");
            }
            found = found.or(Some([ni, nj, nk]));
        }
        if found.is_none() {
            self.problem(0, "SPECGRID", "this keyword, or DIMENS, is missing");
        }
        found
    }

    /// The values of a keyword; `None` where it is missing or damaged, or their number is not known.
    fn array(&mut self, keyword: &str, count: Option<usize>, ok: impl Fn(f64) -> bool, what: &str) -> Option<Vec<f64>> {
        let Some(Section { line, words }) = self.sections.remove(keyword) else {
            self.problem(0, keyword, "this keyword is missing");
            return None;
        };
        let (mut runs, mut total, mut damaged) = (Vec::with_capacity(words.len()), 0_usize, Vec::new());
        for &(line, word) in &words {
            let (times, value) = word.split_once('*').map_or((Some(1), word), |(n, v)| (n.parse().ok(), v));
            // Fortran's exponent of double precision.
            let value = value.replace(['d', 'D'], "e").parse().ok().filter(|&v: &f64| v.is_finite() && ok(v));
            match (times, value) {
                (Some(times), Some(value)) => {
                    total = total.saturating_add(times);
                    runs.push((times, value));
                }
                _ => damaged.push((line, word)),
            }
        }
        if let Some(&(line, word)) = damaged.first() {
            let more = if damaged.len() > 1 { format!(", nor are {} more", damaged.len() - 1) } else { String::new() };
            self.problem(line, keyword, format!("`{word}` is not {what}, nor n*{what}{more}"));
            return None;
        }
        let count = count?;
        if total != count {
            self.problem(line, keyword, format!("there are {total} values; {count} are needed"));
            return None;
        }
        Some(runs.into_iter().flat_map(|(times, value)| std::iter::repeat_n(value, times)).collect())
    }

    fn faults(&mut self) -> Vec<Fault> {
        let mut faults = Vec::new();
        let words = self.sections.remove("FAULTS").unwrap_or_default().words;
        for record in words.split(|word| word.1.is_empty()).filter(|record| !record.is_empty()) {
            let words: Vec<&str> = record.iter().map(|word| word.1).collect();
            let fault = || {
                let &[name, i1, i2, j1, j2, k1, k2, face] = words.as_slice() else { return None };
                let number = |word: &str| word.parse().ok().and_then(|n: usize| n.checked_sub(1));
                let (first, last) = ([number(i1)?, number(j1)?, number(k1)?], [number(i2)?, number(j2)?, number(k2)?]);
                let (axis, side) = face.split_at_checked(1)?;
                let axis = "XYZIJKxyzijk".find(axis)? % 3;
                let upper = ["", "+"].contains(&side);
                (upper || side == "-").then(|| Fault { name: name.to_owned(), first, last, axis, upper })
            };
            match fault() {
                Some(fault) => faults.push(fault),
                None => {
                    let problem = format!("`{}` is not a name, I1 I2 J1 J2 K1 K2 and a face", words.join(" "));
                    self.problem(record[0].0, "FAULTS", problem);
                }
            }
        }
        faults
    }
}

/// The words of a line, without quotation marks, and whether a `/` ends what they belong to.
fn words(line: &str) -> (Vec<&str>, bool) {
    let mut words = Vec::new();
    let mut rest = line.trim_start();
    while !rest.is_empty() && !rest.starts_with("--") {
        if rest.starts_with('/') {
            return (words, true);
        }
        let (word, after) = match rest.strip_prefix('\'') {
            Some(quoted) => quoted.split_once('\'').unwrap_or((quoted, "")),
            None => {
                let end = |c: char| c.is_whitespace() || c == '/' || c == '\'';
                let end = rest.find(end).unwrap_or(rest.len());
                let end = rest[..end].find("--").filter(|&at| at > 0).unwrap_or(end);
                rest.split_at(end)
            }
        };
        words.push(word);
        rest = after.trim_start();
    }
    (words, false)
}
