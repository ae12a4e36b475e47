//! Units of measure, as the `UnitDefinitions` of FMI define them.

/// A unit of measure: value in SI base units = `factor` · value + `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measure {
    /// Exponents of kg, m, s, A, K, mol, cd, rad.
    pub exponents: [i32; 8],
    /// Factor.
    pub factor: f64,
    /// Offset.
    pub offset: f64,
}

impl Measure {
    /// Base units with their exponents.
    pub fn base(&self) -> impl Iterator<Item = (&'static str, i32)> + '_ {
        BASE_UNITS.into_iter().zip(self.exponents)
    }
}

/// Names of the attributes of a `BaseUnit`.
pub(crate) const BASE_UNITS: [&str; 8] = ["kg", "m", "s", "A", "K", "mol", "cd", "rad"];

/// value in another unit = `factor` · value + `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conversion {
    /// Factor.
    pub factor: f64,
    /// Offset.
    pub offset: f64,
}

impl Conversion {
    /// Changes nothing.
    pub const NONE: Self = Self { factor: 1.0, offset: 0.0 };

    /// From one unit to another: each its name and its definition, if it has one. A variable without unit is taken as
    /// it is.
    ///
    /// # Errors
    /// The units are of different kinds, or their definitions are missing.
    pub fn between(
        (from, definition): (Option<&str>, Option<Measure>),
        (to, wanted): (Option<&str>, Option<Measure>),
    ) -> Result<Self, String> {
        let (Some(from), Some(to)) = (from, to) else { return Ok(Self::NONE) };
        match (definition, wanted) {
            (Some(a), Some(b)) if a.exponents == b.exponents && b.factor != 0.0 => {
                Ok(Self { factor: a.factor / b.factor, offset: (a.offset - b.offset) / b.factor })
            }
            (Some(_), Some(_)) => {
                Err(format!("\"{from}\" cannot be converted to \"{to}\": they measure different things"))
            }
            _ if from == to => Ok(Self::NONE),
            (None, _) => Err(format!("\"{from}\" cannot be converted to \"{to}\": \"{from}\" has no definition")),
            (_, None) => Err(format!("\"{from}\" cannot be converted to \"{to}\": \"{to}\" has no definition")),
        }
    }

    /// The way back, where there is something to change.
    pub(crate) fn inverse(self) -> Option<Self> {
        (self != Self::NONE).then(|| Self { factor: 1.0 / self.factor, offset: -self.offset / self.factor })
    }

    /// Changes values.
    pub fn apply(self, values: &mut [f64]) {
        if self != Self::NONE {
            values.iter_mut().for_each(|v| *v = self.factor * *v + self.offset);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn measure(exponents: [i32; 3], factor: f64, offset: f64) -> Measure {
        let [kg, m, s] = exponents;
        Measure { exponents: [kg, m, s, 0, 0, 0, 0, 0], factor, offset }
    }

    #[test]
    fn units_of_one_kind_are_converted() {
        let pascal = measure([1, -1, -2], 1.0, 0.0);
        let bar = measure([1, -1, -2], 1e5, 0.0);
        // Over atmospheric pressure.
        let gauge = measure([1, -1, -2], 1e3, 101_325.0);
        let convert = |(from, a), (to, b), value| {
            let mut values = [value];
            Conversion::between((Some(from), a), (Some(to), b)).map(|c| c.apply(&mut values)).map(|()| values[0])
        };
        assert_eq!(convert(("bar", Some(bar)), ("Pa", Some(pascal)), 2.0), Ok(2e5));
        assert_eq!(convert(("kPa over", Some(gauge)), ("bar", Some(bar)), 100.0), Ok(2.01325));
        assert_eq!(convert(("Pa", Some(pascal)), ("kPa over", Some(gauge)), 101_325.0), Ok(0.0));
        assert_eq!(convert(("Pa", None), ("Pa", Some(pascal)), 3.0), Ok(3.0));
        let metre = measure([0, 1, 0], 1.0, 0.0);
        assert!(convert(("m", Some(metre)), ("Pa", Some(pascal)), 1.0).unwrap_err().contains("different things"));
        assert!(convert(("bar", None), ("Pa", Some(pascal)), 1.0).unwrap_err().contains("\"bar\" has no definition"));
        assert_eq!(Conversion::between((None, None), (Some("Pa"), Some(pascal))), Ok(Conversion::NONE));
    }
}
