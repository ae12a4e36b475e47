//! What is claimed of a model: `reference.toml` in its folder.
//!
//! | entry | is |
//! |---|---|
//! | `define.NAME` | a named expression, beside those of the model |
//! | `measures.NAME` | a number made of a field: of which expression, on cells or fractures, where, which norm |
//! | `tables` | CSV files with columns `variant`, `time` and scalars: each number is claimed, to a relative tolerance |
//! | `claims` | an expression and what must hold for it: a bound, a value, or an order over variants |
//! | `elsewhere` | what other commands show |
//!
//! Expressions of claims know the scalars of `series.csv` and the measures, a dot in a name written as an underscore;
//! `previous_NAME`, a scalar one time step before; `t`; and `step` (s), `number`, `iterations` (of the coupling),
//! `newton`, `last` (1 in the last time step), `cells`, `fracture_faces`, `h` and `fracture_h` (mean size of cells and
//! fracture faces, m). Expressions of measures know, instead of measures, the fields there without `matrix.` or
//! `fracture.`, components as `displacement_x`, `displacement_gradient_xy`, `traction_n`, `traction_t1`; `x`, `y`, `z`;
//! `cell_x`, … (centre of the cell); `tip_distance`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use model::Value;
use serde::Deserialize;

use crate::cli::error::CliError;

const FILE: &str = "reference.toml";
/// Name of the model without variants.
pub(super) const DEFAULT: &str = "default";

/// What is claimed of a model.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Reference {
    #[serde(default)]
    pub(super) define: BTreeMap<String, Value>,
    #[serde(default)]
    pub(super) measures: BTreeMap<String, Measure>,
    #[serde(default)]
    tables: Vec<Table>,
    #[serde(default)]
    pub(super) claims: Vec<Claim>,
    #[serde(default)]
    pub(super) elsewhere: Vec<String>,
}

/// A number made of a field.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Measure {
    /// The expression.
    pub(super) of: String,
    /// Where it is looked at.
    pub(super) on: Domain,
    /// Only where this holds.
    pub(super) only: Option<String>,
    pub(super) take: Take,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Domain {
    /// At points of a quadrature of degree 2 in each cell.
    Cells,
    /// At the centre of each fracture face.
    Fractures,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Take {
    Integral,
    Mean,
    /// √∫ v².
    L2,
    Min,
    Max,
    /// Number of points where it is not 0.
    Count,
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    file: PathBuf,
    /// Largest relative difference.
    within: f64,
    /// Variants for which the rows of another one hold.
    #[serde(default)]
    also: BTreeMap<String, String>,
}

/// What must hold, at all time steps for which `when` does, or only at the first of them.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Claim {
    /// What it means.
    pub(super) says: String,
    pub(super) value: String,
    /// Measures cannot be used here.
    pub(super) when: Option<String>,
    #[serde(default)]
    pub(super) first: bool,
    pub(super) at_least: Option<Value>,
    pub(super) at_most: Option<Value>,
    pub(super) equals: Option<Value>,
    /// Largest relative difference from `equals`.
    pub(super) within: Option<f64>,
    /// The value falls with this power of `size` over the variants; 0.1 less counts as such between the last two.
    pub(super) order: Option<f64>,
    pub(super) size: Option<String>,
    /// For which variants, joined by `+`; left out: the model as it is.
    #[serde(default = "only_default")]
    pub(super) variants: Vec<String>,
}

fn only_default() -> Vec<String> {
    vec![DEFAULT.to_owned()]
}

impl Reference {
    /// That of a model; `None` where it has none.
    pub(super) fn load(folder: &Path) -> Result<Option<Self>, CliError> {
        let path = folder.join(FILE);
        if !path.is_file() {
            return Ok(None);
        }
        let text = std::fs::read_to_string(&path).map_err(CliError::file(&path))?;
        let unfit = |path: &Path, reason: String| CliError::Unfit(format!("{}: {reason}", path.display()));
        let mut reference: Self = toml::from_str(&text).map_err(|error| unfit(&path, error.to_string()))?;
        for table in std::mem::take(&mut reference.tables) {
            let path = folder.join(&table.file);
            let text = std::fs::read_to_string(&path).map_err(CliError::file(&path))?;
            let claims = table.claims(&text).map_err(|reason| unfit(&path, reason))?;
            reference.claims.extend(claims);
        }
        if let Some(reason) = reference.claims.iter().find_map(Claim::problem) {
            return Err(unfit(&path, reason));
        }
        Ok(Some(reference))
    }

    /// All variants that something is claimed of, in the order in which they appear.
    pub(super) fn variants(&self) -> Vec<String> {
        let mut list: Vec<String> = Vec::new();
        for variant in self.claims.iter().flat_map(|claim| &claim.variants) {
            if !list.contains(variant) {
                list.push(variant.clone());
            }
        }
        list
    }
}

impl Table {
    /// The first line that is no comment has the names; the first two columns are variant and time.
    fn claims(&self, text: &str) -> Result<Vec<Claim>, String> {
        let mut lines = text.lines().filter(|line| !line.starts_with('#') && !line.trim().is_empty());
        let names: Vec<&str> = lines.next().ok_or("it has no names of columns")?.split(',').skip(2).collect();
        let mut claims = Vec::new();
        for line in lines {
            let cells: Vec<&str> = line.split(',').collect();
            if cells.len() != names.len() + 2 {
                return Err(format!("\"{line}\" does not have {} columns", names.len() + 2));
            }
            let also = self.also.iter().filter(|(_, of)| *of == cells[0]).map(|(variant, _)| variant.as_str());
            let variants: Vec<String> = also.chain([cells[0]]).map(str::to_owned).collect();
            let number = |text: &str| text.trim().parse::<f64>().map_err(|error| format!("\"{text}\": {error}"));
            let time = number(cells[1])?;
            for (name, cell) in names.iter().zip(&cells[2..]) {
                claims.push(Claim {
                    says: format!("{name} at {time} s"),
                    value: name.replace('.', "_"),
                    when: Some(format!("t == {time}")),
                    equals: Some(Value::Number(number(cell)?)),
                    within: Some(self.within),
                    variants: variants.clone(),
                    ..Claim::default()
                });
            }
        }
        Ok(claims)
    }
}

impl Claim {
    /// What is wrong with it.
    fn problem(&self) -> Option<String> {
        let bounds = self.at_least.is_some() || self.at_most.is_some();
        let kinds = [bounds, self.equals.is_some(), self.order.is_some()];
        let problem = if kinds.iter().filter(|&&is| is).count() != 1 {
            "one of `at_least` or `at_most`, `equals`, and `order` is required"
        } else if self.equals.is_some() != self.within.is_some() {
            "`equals` and `within` belong together"
        } else if self.order.is_some() != self.size.is_some() {
            "`order` and `size` belong together"
        } else if self.order.is_some() && self.variants.len() < 2 {
            "an order needs at least two variants"
        } else {
            return None;
        };
        Some(format!("claim \"{}\": {problem}", self.says))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::case::Case;

    fn models() -> impl Iterator<Item = PathBuf> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models");
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).filter(|p| p.join("model.toml").is_file())
    }

    #[test]
    fn claims_are_about_variants_that_there_are() {
        let mut count = 0;
        for folder in models() {
            let Some(reference) = Reference::load(&folder).unwrap() else { continue };
            assert!(!reference.claims.is_empty());
            for variant in reference.variants() {
                let names: Vec<String> = variant.split('+').filter(|v| *v != DEFAULT).map(str::to_owned).collect();
                Case::load(&folder, &names, &[]).unwrap_or_else(|error| panic!("{variant}: {error}"));
            }
            count += 1;
        }
        // C1 to C5, and the three of C6.
        assert_eq!(count, 8);
    }

    #[test]
    fn tables_become_claims() {
        let also = BTreeMap::from([("polygons".to_owned(), "default".to_owned())]);
        let table = Table { file: PathBuf::new(), within: 0.02, also };
        let claims = table.claims("# note\nvariant,time,a.b\ndefault,1,2\nfine,3,4\n").unwrap();
        assert_eq!(claims.len(), 2);
        assert_eq!(claims[0].variants, ["polygons", "default"]);
        assert_eq!((claims[0].value.as_str(), claims[0].when.as_deref()), ("a_b", Some("t == 1")));
        assert_eq!(claims[1].variants, ["fine"]);
        assert_eq!(claims[1].equals, Some(Value::Number(4.0)));
        assert!(table.claims("variant,time,a\ndefault,1").is_err());
        assert!(table.claims("variant,time,a\ndefault,1,x").is_err());
    }

    #[test]
    fn a_claim_is_of_one_kind() {
        let good = Claim { at_most: Some(1.0.into()), variants: only_default(), ..Claim::default() };
        assert_eq!(good.problem(), None);
        for bad in [
            Claim::default(),
            Claim { order: Some(1.0), ..good.clone() },
            Claim { at_most: None, equals: Some(1.0.into()), ..good.clone() },
            Claim { within: Some(0.1), ..good.clone() },
            Claim { at_most: None, order: Some(1.0), size: Some("h".into()), ..good.clone() },
        ] {
            assert!(bad.problem().is_some(), "{bad:?}");
        }
    }
}
