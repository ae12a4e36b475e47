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

use std::fmt::Write as _;

pub use pack::pack_main;

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
pub const QUANTITIES: [Quantity; 11] = {
    use Role::{Flow, Mechanics};
    use Shape::{Cells, FractureFaces, FractureVectors};
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
        }
    }
}

/// Writes the values of a variable of a unit.
pub type Get<U> = fn(&mut U, ValuesMut<'_>) -> Result<(), UnitError>;
/// Takes values of a variable of a unit.
pub type Set<U> = fn(&mut U, Values<'_>) -> Result<(), UnitError>;

struct Row<U> {
    variable: Variable,
    get: Get<U>,
    set: Option<Set<U>>,
    terminal: Option<&'static str>,
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
        let variable = make(self.rows.len() as Reference + 1);
        self.rows.push(Row { variable, get, set, terminal: None });
    }

    /// Adds a quantity of [`QUANTITIES`]: an output of its owner, an input of the partner. Arrays without entries are
    /// left out, since the standard forbids them.
    ///
    /// # Panics
    /// If there is no quantity of this name.
    pub fn quantity(&mut self, name: &str, get: Get<U>, set: Option<Set<U>>) {
        let q = find(name);
        self.array(q, q.name.to_owned(), q.meaning.to_owned(), get, set);
    }

    /// Adds the reference of a quantity, an input of its owner.
    ///
    /// # Panics
    /// If there is no quantity of this name.
    pub fn reference_of(&mut self, name: &str, get: Get<U>, set: Set<U>) {
        let q = find(name);
        let meaning = format!("{} at which {} was last evaluated", q.meaning, self.role.partner().name());
        self.array(q, format!("{name}_reference"), meaning, get, Some(set));
    }

    fn array(&mut self, q: &'static Quantity, name: String, meaning: String, get: Get<U>, set: Option<Set<U>>) {
        let dimensions = self.sizes.of(q.shape);
        if dimensions.contains(&0) {
            return;
        }
        let state = q.name == "fracture.contact_state";
        let ty = if state { Type::Int64 } else { Type::Float64 };
        let is_input = set.is_some();
        let make = |reference| {
            let variable = if is_input {
                Variable::input(reference, &name, ty).start(0.0)
            } else {
                Variable::output(reference, &name, ty)
            };
            let variable = if state { variable.enumeration(CONTACT_STATE) } else { variable.unit(q.unit) };
            variable.dimensions(&dimensions).describe(&meaning)
        };
        self.add(make, get, set);
        if let Some(row) = self.rows.last_mut() {
            row.terminal = q.name.split('.').next();
        }
    }

    /// The variables.
    pub fn variables(&self) -> Vec<Variable> {
        self.rows.iter().map(|row| row.variable.clone()).collect()
    }

    /// The terminals `matrix` and `fracture`, with the arrays that belong to them.
    pub fn terminals(&self) -> Vec<Terminal> {
        let about = [("matrix", "Fields in the rock, by cell"), ("fracture", "Fields on the fractures, by face")];
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

    /// How a variable is read.
    ///
    /// # Errors
    /// There is no such variable.
    pub fn get(&self, reference: Reference) -> Result<Get<U>, UnitError> {
        self.row(reference).map(|row| row.get).ok_or_else(|| format!("there is no variable {reference}").into())
    }

    /// How a variable is written.
    ///
    /// # Errors
    /// There is no such variable, or it takes no values.
    pub fn set(&self, reference: Reference) -> Result<Set<U>, UnitError> {
        let row = self.row(reference).ok_or_else(|| format!("there is no variable {reference}"))?;
        row.set.ok_or_else(|| format!("{} takes no values", row.variable.name()).into())
    }

    fn row(&self, reference: Reference) -> Option<&Row<U>> {
        self.rows.get((reference as usize).checked_sub(1)?)
    }
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
        table.quantity("matrix.pressure", |(), _| Ok(()), None);
        table.quantity("fracture.pressure", |(), _| Ok(()), None);
        assert_eq!(table.variables().len(), 1);
        assert_eq!(table.size(1), 5);
        assert!(table.get(2).is_err());
        assert!(table.set(1).is_err());
    }

    #[test]
    fn names_are_unique_and_units_are_known() {
        let known = format!("{:?}", units());
        for (i, q) in QUANTITIES.iter().enumerate() {
            assert!(QUANTITIES[..i].iter().all(|other| other.name != q.name));
            assert!(known.contains(&format!("{:?}", q.unit)), "{}", q.unit);
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
