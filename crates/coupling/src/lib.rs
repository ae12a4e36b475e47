//! The variables through which mechanics and flow see each other.
//!
//! [`QUANTITIES`] is the one table: names, units, shapes and directions. From it come the variables of both units
//! ([`Table`]), their terminals and units ([`units`]), and the documentation ([`documentation`]).
//!
//! Each unit sees its partner as an affine function around the last exchange,
//!
//! ```text
//! flow sees      φ(p) = φ* + C (p − p*),   d_f(p_f) = d* + C_f (p_f − p_f*)
//! mechanics sees p(φ) = p* − S (φ − φ*),   p_f(d)  = p_f* − S_f (d − d*)
//! ```
//!
//! where C, C_f, S, S_f are the compliances and stiffnesses that the partner publishes, zero if they are not
//! connected, and a star marks the references.

mod pack;
mod resources;
mod work;

use std::fmt::Write as _;

pub use pack::pack_main;
pub use resources::read_resources;
pub use work::{WORK, Work, WorkVariable, Worker, timed};

use fmi_unit::{Reference, Terminal, Type, UnitDefinition, UnitError, Values, ValuesMut, Variable};

/// The two units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Contact mechanics.
    Mechanics,
    /// Darcy flow.
    Flow,
}

impl Role {
    /// The other unit.
    pub fn partner(self) -> Self {
        if self == Role::Mechanics { Role::Flow } else { Role::Mechanics }
    }

    /// `mechanics` or `flow`.
    pub fn name(self) -> &'static str {
        if self == Role::Mechanics { "mechanics" } else { "flow" }
    }
}

/// What a quantity has a value for; arrays are in the order of the mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Each cell.
    Cells,
    /// Each fracture face.
    FractureFaces,
    /// Each fracture face and each component in its basis (n⁺, t₁[, t₂]).
    FractureVectors,
    /// Each cell and each component in space.
    CellVectors,
    /// Each cell, each row and each column of a tensor in space.
    CellTensors,
}

/// A row of [`QUANTITIES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quantity {
    /// `terminal.name` of the variable.
    pub name: &'static str,
    /// Unit of measure.
    pub unit: &'static str,
    /// What it has values for.
    pub shape: Shape,
    /// Whose output it is.
    pub from: Role,
    /// Whether it is an input of the partner.
    pub exchanged: bool,
    /// Whether its owner also takes it back as `…_reference`, the value that the partner was last evaluated at.
    pub referenced: bool,
    /// What it is, with its sign.
    pub meaning: &'static str,
}

const fn quantity(
    name: &'static str,
    unit: &'static str,
    shape: Shape,
    from: Role,
    [exchanged, referenced]: [bool; 2],
    meaning: &'static str,
) -> Quantity {
    Quantity { name, unit, shape, from, exchanged, referenced, meaning }
}

/// All quantities that units publish for each other, and arrays for anyone.
pub const QUANTITIES: [Quantity; 13] = {
    use Role::{Flow, Mechanics};
    use Shape::{CellTensors, CellVectors, Cells, FractureFaces, FractureVectors};
    const FIELD: [bool; 2] = [true, true];
    const SENSITIVITY: [bool; 2] = [true, false];
    const RESULT: [bool; 2] = [false, false];
    [
        quantity("matrix.pressure", "Pa", Cells, Flow, FIELD, "Pressure p_m in the rock"),
        quantity("fracture.pressure", "Pa", FractureFaces, Flow, FIELD, "Pressure p_f in the fractures"),
        quantity(
            "matrix.porosity_change",
            "1",
            Cells,
            Mechanics,
            FIELD,
            "b (div u - div u at the initial state): porosity caused by deformation",
        ),
        quantity(
            "fracture.aperture",
            "m",
            FractureFaces,
            Mechanics,
            FIELD,
            "Hydraulic aperture d_f, dilation included",
        ),
        quantity(
            "matrix.porosity_compliance",
            "1/Pa",
            Cells,
            Mechanics,
            SENSITIVITY,
            "What mechanics believes d(porosity change)/d(pressure) is",
        ),
        quantity(
            "fracture.aperture_compliance",
            "m/Pa",
            FractureFaces,
            Mechanics,
            SENSITIVITY,
            "What mechanics believes d(aperture)/d(fracture pressure) is",
        ),
        quantity(
            "matrix.pressure_stiffness",
            "Pa",
            Cells,
            Flow,
            SENSITIVITY,
            "What flow believes -d(pressure)/d(porosity change) is",
        ),
        quantity(
            "fracture.pressure_stiffness",
            "Pa/m",
            FractureFaces,
            Flow,
            SENSITIVITY,
            "What flow believes -d(fracture pressure)/d(aperture) is",
        ),
        quantity(
            "fracture.displacement_jump",
            "m",
            FractureVectors,
            Mechanics,
            RESULT,
            "Jump u+ - u- in the basis of the face; the normal part is negative where open",
        ),
        quantity(
            "fracture.traction",
            "Pa",
            FractureVectors,
            Mechanics,
            RESULT,
            "Traction on the plus side in the basis of the face; the normal part is negative in compression",
        ),
        quantity("fracture.contact_state", "1", FractureFaces, Mechanics, RESULT, "Open, stick or slip"),
        quantity("matrix.displacement", "m", CellVectors, Mechanics, RESULT, "Displacement at the centre of the cell"),
        quantity(
            "matrix.displacement_gradient",
            "1",
            CellTensors,
            Mechanics,
            RESULT,
            "Gradient of the displacement; row i is that of component i",
        ),
    ]
};

/// Name of the enumeration of `fracture.contact_state`.
pub const CONTACT_STATE: &str = "ContactState";

/// Sizes of the arrays, from the mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// Number of cells.
    pub cells: usize,
    /// Number of fracture faces.
    pub fracture_faces: usize,
    /// 2 or 3.
    pub dim: usize,
}

impl Sizes {
    /// Dimensions of an array.
    pub fn of(&self, shape: Shape) -> Vec<usize> {
        match shape {
            Shape::Cells => vec![self.cells],
            Shape::FractureFaces => vec![self.fracture_faces],
            Shape::FractureVectors => vec![self.fracture_faces, self.dim],
            Shape::CellVectors => vec![self.cells, self.dim],
            Shape::CellTensors => vec![self.cells, self.dim, self.dim],
        }
    }

    /// Unit of an energy; in 2D per metre of thickness.
    pub fn energy_unit(&self) -> &'static str {
        if self.dim == 2 { "J/m" } else { "J" }
    }

    /// Unit of a moment; in 2D per metre of thickness.
    pub fn moment_unit(&self) -> &'static str {
        if self.dim == 2 { "N" } else { "N.m" }
    }
}

/// Writes the values of a variable of a unit.
pub type Get<U> = fn(&mut U, ValuesMut<'_>) -> Result<(), UnitError>;
/// Takes values of a variable of a unit.
pub type Set<U> = fn(&mut U, Values<'_>) -> Result<(), UnitError>;
/// As [`Get`], of one of several alike.
pub type GetNumbered<U> = fn(&mut U, usize, ValuesMut<'_>) -> Result<(), UnitError>;
/// As [`Set`], of one of several alike.
pub type SetNumbered<U> = fn(&mut U, usize, Values<'_>) -> Result<(), UnitError>;

struct Row<U> {
    variable: Variable,
    access: Access<U>,
    terminal: Option<&'static str>,
}

enum Access<U> {
    Single(Get<U>, Option<Set<U>>),
    Numbered(usize, GetNumbered<U>, Option<SetNumbered<U>>),
}

/// The variables of a unit, each with how its values are read and written. References count from 1.
pub struct Table<U> {
    role: Role,
    sizes: Sizes,
    rows: Vec<Row<U>>,
}

impl<U> Table<U> {
    /// No variable yet.
    pub fn new(role: Role, sizes: Sizes) -> Self {
        Self { role, sizes, rows: Vec::new() }
    }

    /// Adds a variable; `make` is given its reference.
    pub fn add(&mut self, make: impl FnOnce(Reference) -> Variable, get: Get<U>, set: Option<Set<U>>) {
        self.push(make, Access::Single(get, set), None);
    }

    /// Adds a variable of the entity `number`, in a terminal if one is named.
    pub fn add_numbered(
        &mut self,
        terminal: Option<&'static str>,
        number: usize,
        make: impl FnOnce(Reference) -> Variable,
        get: GetNumbered<U>,
        set: Option<SetNumbered<U>>,
    ) {
        self.push(make, Access::Numbered(number, get, set), terminal);
    }

    fn push(&mut self, make: impl FnOnce(Reference) -> Variable, access: Access<U>, terminal: Option<&'static str>) {
        let variable = make(self.rows.len() as Reference + 1);
        self.rows.push(Row { variable, access, terminal });
    }

    /// Adds a quantity of [`QUANTITIES`] as an output. Arrays without entries are left out, since the standard forbids
    /// them.
    ///
    /// # Panics
    /// If there is no quantity of this name.
    pub fn output(&mut self, name: &str, get: Get<U>) {
        let q = find(name);
        self.array(q, q.name.to_owned(), q.meaning.to_owned(), None, get, None);
    }

    /// Adds a quantity of [`QUANTITIES`] as an input, with its values at the start.
    ///
    /// # Panics
    /// If there is no quantity of this name.
    pub fn input(&mut self, name: &str, start: &[f64], get: Get<U>, set: Set<U>) {
        let q = find(name);
        self.array(q, q.name.to_owned(), q.meaning.to_owned(), Some(start), get, Some(set));
    }

    /// Adds the reference of a quantity, an input of its owner, with its values at the start.
    ///
    /// # Panics
    /// If there is no quantity of this name.
    pub fn reference_of(&mut self, name: &str, start: &[f64], get: Get<U>, set: Set<U>) {
        let q = find(name);
        let meaning = format!("{} at which {} was last evaluated", q.meaning, self.role.partner().name());
        self.array(q, format!("{name}_reference"), meaning, Some(start), get, Some(set));
    }

    fn array(
        &mut self,
        q: &'static Quantity,
        name: String,
        meaning: String,
        start: Option<&[f64]>,
        get: Get<U>,
        set: Option<Set<U>>,
    ) {
        let dimensions = self.sizes.of(q.shape);
        if dimensions.contains(&0) {
            return;
        }
        let state = q.name == "fracture.contact_state";
        let ty = if state { Type::Int64 } else { Type::Float64 };
        let make = |reference| {
            let variable = match start {
                // One value stands for all.
                Some([first, rest @ ..]) if rest.iter().all(|v| v == first) => {
                    Variable::input(reference, &name, ty).start(*first)
                }
                Some(start) => Variable::input(reference, &name, ty).start(start.to_vec()),
                None => Variable::output(reference, &name, ty),
            };
            let variable = if state { variable.enumeration(CONTACT_STATE) } else { variable.unit(q.unit) };
            variable.dimensions(&dimensions).describe(&meaning)
        };
        self.push(make, Access::Single(get, set), q.name.split('.').next());
    }

    /// The variables.
    pub fn variables(&self) -> Vec<Variable> {
        self.rows.iter().map(|row| row.variable.clone()).collect()
    }

    /// The terminals `matrix`, `fracture` and `wells`, with what belongs to them.
    pub fn terminals(&self) -> Vec<Terminal> {
        let about = [
            ("matrix", "Fields in the rock, by cell"),
            ("fracture", "Fields on the fractures, by face"),
            ("wells", "What wells are to do, and what they do"),
        ];
        let members = |name: &str| self.rows.iter().filter(|row| row.terminal == Some(name)).collect::<Vec<_>>();
        (about.iter())
            .filter(|(name, _)| !members(name).is_empty())
            .map(|(name, about)| {
                members(name).iter().fold(Terminal::new(name, about), |terminal, row| {
                    let variable = row.variable.name();
                    terminal.member(&variable[name.len() + 1..], variable)
                })
            })
            .collect()
    }

    /// Name of a variable.
    pub fn name(&self, reference: Reference) -> &str {
        self.row(reference).map_or("", |row| row.variable.name())
    }

    /// Number of values of a variable.
    pub fn size(&self, reference: Reference) -> usize {
        self.row(reference).map_or(0, |row| row.variable.size())
    }

    /// Reads a variable.
    ///
    /// # Errors
    /// There is no such variable; what the unit says.
    pub fn get(&self, unit: &mut U, reference: Reference, values: ValuesMut<'_>) -> Result<(), UnitError> {
        match self.known(reference)?.access {
            Access::Single(get, _) => get(unit, values),
            Access::Numbered(number, get, _) => get(unit, number, values),
        }
    }

    /// Writes a variable.
    ///
    /// # Errors
    /// There is no such variable, or it takes no values, or not these: with its name.
    pub fn set(&self, unit: &mut U, reference: Reference, values: Values<'_>) -> Result<(), UnitError> {
        let row = self.known(reference)?;
        let result = match row.access {
            Access::Single(_, Some(set)) => set(unit, values),
            Access::Numbered(number, _, Some(set)) => set(unit, number, values),
            _ => Err("it takes no values".into()),
        };
        result.map_err(|error| format!("{}: {error}", row.variable.name()).into())
    }

    fn known(&self, reference: Reference) -> Result<&Row<U>, UnitError> {
        self.row(reference).ok_or_else(|| format!("there is no variable {reference}").into())
    }

    fn row(&self, reference: Reference) -> Option<&Row<U>> {
        self.rows.get((reference as usize).checked_sub(1)?)
    }
}

/// What the numbers of a variable must be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Allowed {
    /// Finite.
    Finite,
    /// Finite and at least 0.
    NotNegative,
    /// Finite and above 0.
    Positive,
}

impl Allowed {
    fn problem(self, value: f64) -> Option<&'static str> {
        match self {
            _ if !value.is_finite() => Some("finite"),
            Self::NotNegative if value < 0.0 => Some("at least 0"),
            Self::Positive if value <= 0.0 => Some("above 0"),
            _ => None,
        }
    }

    /// Copies an array into `target`, or leaves `target` as it is.
    ///
    /// # Errors
    /// The first number that is not allowed; a wrong type or size.
    pub fn read(self, values: Values<'_>, target: &mut [f64]) -> Result<(), UnitError> {
        for (i, &value) in values.slice::<f64>()?.iter().enumerate() {
            if let Some(must) = self.problem(value) {
                return Err(format!("entry {i} is {value}; it must be {must}").into());
            }
        }
        values.read(target)
    }

    /// The value of a scalar.
    ///
    /// # Errors
    /// It is not allowed; a wrong type or size.
    pub fn scalar(self, values: Values<'_>) -> Result<f64, UnitError> {
        let value = values.scalar()?;
        match self.problem(value) {
            Some(must) => Err(format!("{value} must be {must}").into()),
            None => Ok(value),
        }
    }
}

/// A name from a model or mesh as part of a variable's name: letters, digits and underscores, no digit first.
pub fn identifier(name: &str) -> String {
    let digit = name.starts_with(|c: char| c.is_ascii_digit());
    let plain = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' });
    (if digit || name.is_empty() { "_" } else { "" }).chars().chain(plain).collect()
}

fn find(name: &str) -> &'static Quantity {
    QUANTITIES.iter().find(|q| q.name == name).unwrap_or_else(|| panic!("there is no quantity {name}"))
}

/// The units of measure of both units' variables.
pub fn units() -> Vec<UnitDefinition> {
    let unit = UnitDefinition::new;
    vec![
        unit("1"),
        unit("s").second(1),
        unit("m").metre(1),
        unit("m2").metre(2),
        unit("m3").metre(3),
        unit("Pa").kilogram(1).metre(-1).second(-2),
        unit("1/Pa").kilogram(-1).metre(1).second(2),
        unit("m/Pa").kilogram(-1).metre(2).second(2),
        unit("Pa/m").kilogram(1).metre(-2).second(-2),
        unit("m2/s").metre(2).second(-1),
        unit("m3/s").metre(3).second(-1),
        unit("kg").kilogram(1),
        unit("kg/s").kilogram(1).second(-1),
        unit("N").kilogram(1).metre(1).second(-2),
        unit("N.m").kilogram(1).metre(2).second(-2),
        unit("J").kilogram(1).metre(2).second(-2),
        unit("J/m").kilogram(1).metre(1).second(-2),
    ]
}

/// A page (HTML) on the quantities, as a unit with arrays of these sizes has them.
pub fn documentation(role: Role, sizes: Sizes) -> String {
    let mut page = format!(
        "<p>Arrays are in the order of cells ({}) and fracture faces ({}) of the mesh in the resources.</p>\n<table>\n\
         <tr><th>variable</th><th>shape</th><th>unit</th><th>is</th><th>meaning</th></tr>\n",
        sizes.cells, sizes.fracture_faces
    );
    for q in &QUANTITIES {
        let is = match (q.from == role, q.exchanged) {
            (true, _) => "output",
            (false, true) => "input",
            (false, false) => continue,
        };
        let shape = sizes.of(q.shape).iter().map(usize::to_string).collect::<Vec<_>>().join(" × ");
        // Writing to a string cannot fail.
        let _ = writeln!(
            page,
            "<tr><td>{}</td><td>{shape}</td><td>{}</td><td>{is}</td><td>{}</td></tr>",
            q.name, q.unit, q.meaning
        );
        if q.from == role && q.referenced {
            let _ = writeln!(
                page,
                "<tr><td>{}_reference</td><td>{shape}</td><td>{}</td><td>input</td><td>the same, where {} was last evaluated</td></tr>",
                q.name,
                q.unit,
                role.partner().name()
            );
        }
    }
    page + "</table>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZES: Sizes = Sizes { cells: 5, fracture_faces: 2, dim: 3 };

    #[test]
    fn an_array_without_entries_is_left_out() {
        let mut table = Table::<()>::new(Role::Flow, Sizes { fracture_faces: 0, ..SIZES });
        table.output("matrix.pressure", |(), _| Ok(()));
        table.output("fracture.pressure", |(), _| Ok(()));
        assert_eq!(table.variables().len(), 1);
        assert_eq!(table.size(1), 5);
        assert!(table.get(&mut (), 1, ValuesMut::Float64(&mut [])).is_ok());
        assert!(table.get(&mut (), 2, ValuesMut::Float64(&mut [])).is_err());
        assert!(table.set(&mut (), 1, Values::Float64(&[])).is_err());
    }

    #[test]
    fn numbers_that_are_not_allowed_leave_the_old_ones() {
        let read = |allowed: Allowed, value: f64| {
            let mut target = [1.0, 2.0];
            let result = allowed.read(Values::Float64(&[3.0, value]), &mut target);
            assert_eq!(target, if result.is_ok() { [3.0, value] } else { [1.0, 2.0] });
            result.map_err(|e| e.to_string())
        };
        assert_eq!(read(Allowed::Finite, -1.0), Ok(()));
        assert_eq!(read(Allowed::Finite, f64::NAN), Err("entry 1 is NaN; it must be finite".into()));
        assert_eq!(read(Allowed::Positive, f64::INFINITY), Err("entry 1 is inf; it must be finite".into()));
        assert_eq!(read(Allowed::NotNegative, 0.0), Ok(()));
        assert_eq!(read(Allowed::NotNegative, -1.0), Err("entry 1 is -1; it must be at least 0".into()));
        assert_eq!(read(Allowed::Positive, 0.0), Err("entry 1 is 0; it must be above 0".into()));
        assert!(Allowed::Finite.scalar(Values::Float64(&[f64::NAN])).is_err());
    }

    #[test]
    fn names_become_identifiers() {
        assert_eq!(["left", "inj-1", "7", "a b.c", ""].map(identifier), ["left", "inj_1", "_7", "a_b_c", "_"]);
    }

    #[test]
    fn one_start_value_stands_for_equal_ones() {
        let mut table = Table::<()>::new(Role::Flow, SIZES);
        table.input("fracture.aperture", &[1.0, 1.0], |(), _| Ok(()), |(), _| Ok(()));
        table.input("fracture.aperture", &[1.0, 2.0], |(), _| Ok(()), |(), _| Ok(()));
        let starts = table.variables().iter().map(|v| format!("{v:?}").matches(".0").count()).collect::<Vec<_>>();
        assert_eq!(starts, [1, 2]);
    }

    /// Models speak of the fields that are exchanged.
    #[test]
    fn models_know_the_fields() {
        let fields: Vec<&str> = QUANTITIES.iter().filter(|q| q.referenced).map(|q| q.name).collect();
        assert_eq!(fields, model::FIELDS);
    }

    #[test]
    fn names_are_unique_and_units_are_known() {
        let known = format!("{:?}", units());
        for (i, q) in QUANTITIES.iter().enumerate() {
            assert!(QUANTITIES[..i].iter().all(|other| other.name != q.name));
            assert!(known.contains(&format!("{:?}", q.unit)), "{}", q.unit);
        }
        for sizes in [SIZES, Sizes { dim: 2, ..SIZES }] {
            for unit in [sizes.energy_unit(), sizes.moment_unit()] {
                assert!(known.contains(&format!("{unit:?}")), "{unit}");
            }
        }
    }

    #[test]
    fn the_documentation_lists_inputs_and_references() {
        let page = documentation(Role::Mechanics, SIZES);
        assert!(page.contains("<td>matrix.pressure</td><td>5</td><td>Pa</td><td>input</td>"), "{page}");
        assert!(page.contains("<td>fracture.aperture_reference</td><td>2</td>"), "{page}");
        assert!(page.contains("<td>fracture.traction</td><td>2 × 3</td>"), "{page}");
        assert!(!page.contains("matrix.pressure_reference"));
    }
}
