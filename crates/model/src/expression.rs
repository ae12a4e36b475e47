//! Expressions of position, time and names, as models hold them.
//!
//! ```text
//! or    = and { "or" and }            and  = not { "and" not }         not = "not" not | compare
//! compare = sum [ ("<" | "<=" | ">" | ">=" | "==" | "!=") sum ]
//! sum   = product { ("+" | "-") product }     product = sign { ("*" | "/") sign }
//! sign  = ("-" | "+") sign | power            power   = atom [ "^" sign ]
//! atom  = number | name | function "(" or { "," or } ")" | "(" or ")"
//! ```
//!
//! So −2^2 is −4 and 2^3^2 is 512, as written in mathematics. Truth is 1 and falsehood 0; what is not 0 counts as
//! true. Functions: `sin cos tan asin acos atan sinh cosh tanh exp ln log10 sqrt abs floor ceil sign` of one argument,
//! `atan2` of two, `min` and `max` of two or more, `if(condition, then, else)`, and the closed solutions of
//! [`closed`](crate::closed); `pi` is a number.
//!
//! It is our own because the crates that exist read −2^2 as 4 or refuse 2e-3 (exmex 0.21), are no longer kept (meval,
//! fasteval) or have a licence that does not fit (evalexpr); and none says at which column an error is.

use std::sync::Arc;

use mesh::Vec3;

use crate::closed;

/// A name that takes its value from the place where an expression is evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variable {
    /// Position x (m).
    X,
    /// Position y (m).
    Y,
    /// Position z (m); 0 in 2D.
    Z,
    /// Time t (s).
    T,
    /// Distance (m) to the nearest tip of the fracture.
    TipDistance,
    /// Largest distance (m) to the nearest tip on the fracture.
    MaxTipDistance,
    /// x (m) of the centre of the cell that a boundary point is seen from.
    CellX,
    /// y (m) of it.
    CellY,
    /// z (m) of it.
    CellZ,
}

use Variable::{CellX, CellY, CellZ, MaxTipDistance, T, TipDistance, X, Y, Z};

const NAMES: [(&str, Variable); 9] = [
    ("x", X),
    ("y", Y),
    ("z", Z),
    ("t", T),
    ("tip_distance", TipDistance),
    ("max_tip_distance", MaxTipDistance),
    ("cell_x", CellX),
    ("cell_y", CellY),
    ("cell_z", CellZ),
];

/// What an expression may depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// Nothing.
    Constant,
    /// `t`.
    Time,
    /// `x`, `y`, `z`.
    Place,
    /// `x`, `y`, `z`, `t`.
    PlaceAndTime,
    /// `x`, `y`, `z`, `t`, and `cell_x`, `cell_y`, `cell_z`, which tell the sides of a fracture apart.
    Boundary,
    /// `x`, `y`, `z`, `tip_distance` and `max_tip_distance`.
    Fracture,
    /// All of them: for what is asked of results.
    All,
}

impl Scope {
    /// The variables that may be used.
    pub fn variables(self) -> &'static [Variable] {
        match self {
            Self::Constant => &[],
            Self::Time => &[T],
            Self::Place => &[X, Y, Z],
            Self::PlaceAndTime => &[X, Y, Z, T],
            Self::Boundary => &[X, Y, Z, T, CellX, CellY, CellZ],
            Self::Fracture => &[X, Y, Z, TipDistance, MaxTipDistance],
            Self::All => &[X, Y, Z, T, TipDistance, MaxTipDistance, CellX, CellY, CellZ],
        }
    }
}

/// Where an expression is evaluated. What is not known there stays 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point {
    /// Position (m).
    pub at: Vec3,
    /// Time (s).
    pub time: f64,
    /// Distance (m) to the nearest tip of the fracture.
    pub tip_distance: f64,
    /// Largest distance (m) to the nearest tip on the fracture.
    pub max_tip_distance: f64,
    /// Centre (m) of the cell that a boundary point is seen from.
    pub cell: Vec3,
}

impl Point {
    /// A position (m) at a time (s).
    pub fn new(at: Vec3, time: f64) -> Self {
        Self { at, time, ..Self::default() }
    }

    fn get(&self, variable: Variable) -> f64 {
        match variable {
            X => self.at.x,
            Y => self.at.y,
            Z => self.at.z,
            T => self.time,
            TipDistance => self.tip_distance,
            MaxTipDistance => self.max_tip_distance,
            CellX => self.cell.x,
            CellY => self.cell.y,
            CellZ => self.cell.z,
        }
    }
}

/// An expression ready to be evaluated; cheap to clone.
#[derive(Clone, Debug)]
pub struct Function(Arc<Node>);

impl Function {
    /// The same value everywhere.
    pub fn constant(value: f64) -> Self {
        Self(Arc::new(Node::Number(value)))
    }

    /// Its value.
    pub fn at(&self, point: &Point) -> f64 {
        self.0.at(point, &[])
    }

    /// Its value, where it was made with names ([`Model::formula`](crate::Model::formula)) that have these values.
    pub fn with(&self, point: &Point, values: &[f64]) -> f64 {
        self.0.at(point, values)
    }

    /// Whether it holds: its value is not 0.
    pub fn holds(&self, point: &Point) -> bool {
        self.at(point) != 0.0
    }

    /// Its value, where it depends on nothing.
    pub fn as_constant(&self) -> Option<f64> {
        if let Node::Number(value) = *self.0 { Some(value) } else { None }
    }
}

/// What is wrong with an expression.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{message} (character {column})")]
pub struct ExpressionError {
    /// What is wrong, and what is allowed.
    pub message: String,
    /// Which character, from 1.
    pub column: usize,
}

type Unary = fn(f64) -> f64;
type Binary = fn(f64, f64) -> f64;
type Ternary = fn(f64, f64, f64) -> f64;

#[derive(Clone, Debug)]
pub(crate) enum Node {
    Number(f64),
    Variable(Variable),
    /// One of the values that are given at each evaluation.
    Given(usize),
    One(Unary, Box<Node>),
    Two(Binary, Box<[Node; 2]>),
    Three(Ternary, Box<[Node; 3]>),
    If(Box<[Node; 3]>),
}

impl Node {
    fn at(&self, point: &Point, given: &[f64]) -> f64 {
        let at = |node: &Self| node.at(point, given);
        match self {
            Self::Number(value) => *value,
            Self::Variable(variable) => point.get(*variable),
            Self::Given(i) => given.get(*i).copied().unwrap_or(f64::NAN),
            Self::One(f, a) => f(at(a)),
            Self::Two(f, ab) => f(at(&ab[0]), at(&ab[1])),
            Self::Three(f, abc) => f(at(&abc[0]), at(&abc[1]), at(&abc[2])),
            Self::If(abc) => at(&abc[if at(&abc[0]) != 0.0 { 1 } else { 2 }]),
        }
    }

    /// Replaced by its value, where all that it is made from is a number.
    fn folded(self) -> Self {
        let number = |node: &Self| matches!(node, Self::Number(_));
        let constant = match &self {
            Self::Number(_) | Self::Variable(_) | Self::Given(_) => false,
            Self::One(_, a) => number(a),
            Self::Two(_, ab) => ab.iter().all(number),
            Self::Three(_, abc) | Self::If(abc) => abc.iter().all(number),
        };
        if constant { Self::Number(self.at(&Point::default(), &[])) } else { self }
    }
}

/// Parses an expression; `define` gives the meaning of names that are not variables, if they have one.
pub(crate) fn parse(
    source: &str,
    scope: Scope,
    define: &mut dyn FnMut(&str) -> Option<Result<Node, String>>,
) -> Result<Function, ExpressionError> {
    let mut parser = Parser { source, at: 0, depth: 0, scope, define };
    let node = parser.or()?;
    match parser.peek() {
        None => Ok(Function(Arc::new(node))),
        Some(c) => Err(parser.error(format!("\"{c}\" is not expected here"))),
    }
}

impl From<Function> for Node {
    fn from(function: Function) -> Self {
        Arc::unwrap_or_clone(function.0)
    }
}

/// Parentheses and signs within one another: far beyond any formula, and far below the stack.
const MAX_DEPTH: usize = 100;

struct Parser<'a> {
    source: &'a str,
    at: usize,
    depth: usize,
    scope: Scope,
    define: &'a mut dyn FnMut(&str) -> Option<Result<Node, String>>,
}

type Parsed = Result<Node, ExpressionError>;

impl<'a> Parser<'a> {
    fn error(&self, message: impl Into<String>) -> ExpressionError {
        ExpressionError { message: message.into(), column: self.source[..self.at].chars().count() + 1 }
    }

    fn peek(&mut self) -> Option<char> {
        let rest = &self.source[self.at..];
        self.at += rest.len() - rest.trim_start().len();
        self.source[self.at..].chars().next()
    }

    /// Takes `symbol` if it comes next.
    fn take(&mut self, symbol: &str) -> bool {
        self.peek();
        let found = self.source[self.at..].starts_with(symbol);
        if found {
            self.at += symbol.len();
        }
        found
    }

    /// The name or keyword that comes next.
    fn word(&mut self) -> &'a str {
        self.peek();
        let rest = &self.source[self.at..];
        let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(rest.len());
        &rest[..end]
    }

    fn keyword(&mut self, keyword: &str) -> bool {
        let found = self.word() == keyword;
        if found {
            self.at += keyword.len();
        }
        found
    }

    fn chain(&mut self, part: fn(&mut Self) -> Parsed, next: impl Fn(&mut Self) -> Option<Binary>) -> Parsed {
        let mut node = part(self)?;
        while let Some(f) = next(self) {
            node = Node::Two(f, Box::new([node, part(self)?])).folded();
        }
        Ok(node)
    }

    fn deeper(&mut self, part: fn(&mut Self) -> Parsed) -> Parsed {
        self.depth += 1;
        if self.depth > MAX_DEPTH {
            return Err(self.error(format!("the expression is nested deeper than {MAX_DEPTH} levels")));
        }
        let node = part(self)?;
        self.depth -= 1;
        Ok(node)
    }

    fn or(&mut self) -> Parsed {
        self.chain(Self::and, |p| p.keyword("or").then_some(|a, b| truth(a != 0.0 || b != 0.0)))
    }

    fn and(&mut self) -> Parsed {
        self.chain(Self::not, |p| p.keyword("and").then_some(|a, b| truth(a != 0.0 && b != 0.0)))
    }

    fn not(&mut self) -> Parsed {
        if self.keyword("not") { self.changed(Self::not, |a| truth(a == 0.0)) } else { self.compare() }
    }

    fn compare(&mut self) -> Parsed {
        // The longer symbols first.
        const COMPARISONS: [(&str, Binary); 6] = [
            ("<=", |a, b| truth(a <= b)),
            (">=", |a, b| truth(a >= b)),
            ("==", |a, b| truth(a == b)),
            ("!=", |a, b| truth(a != b)),
            ("<", |a, b| truth(a < b)),
            (">", |a, b| truth(a > b)),
        ];
        let left = self.sum()?;
        match COMPARISONS.iter().find(|(symbol, _)| self.take(symbol)) {
            Some((_, f)) => Ok(Node::Two(*f, Box::new([left, self.sum()?])).folded()),
            None => Ok(left),
        }
    }

    fn sum(&mut self) -> Parsed {
        self.chain(
            Self::product,
            |p| {
                if p.take("+") { Some(|a, b| a + b) } else { p.take("-").then_some(|a, b| a - b) }
            },
        )
    }

    fn product(&mut self) -> Parsed {
        self.chain(Self::sign, |p| if p.take("*") { Some(|a, b| a * b) } else { p.take("/").then_some(|a, b| a / b) })
    }

    fn changed(&mut self, part: fn(&mut Self) -> Parsed, f: Unary) -> Parsed {
        Ok(Node::One(f, Box::new(self.deeper(part)?)).folded())
    }

    fn sign(&mut self) -> Parsed {
        if self.take("-") {
            self.changed(Self::sign, |a| -a)
        } else if self.take("+") {
            self.deeper(Self::sign)
        } else {
            self.power()
        }
    }

    fn power(&mut self) -> Parsed {
        let base = self.atom()?;
        if !self.take("^") {
            return Ok(base);
        }
        let exponent = self.deeper(Self::sign)?;
        if let Node::Number(n) = exponent
            && n == 2.0
        {
            return Ok(Node::One(|a| a * a, Box::new(base)).folded());
        }
        Ok(Node::Two(f64::powf, Box::new([base, exponent])).folded())
    }

    fn atom(&mut self) -> Parsed {
        match self.peek() {
            Some('(') => {
                self.at += 1;
                let node = self.deeper(Self::or)?;
                self.close()?;
                Ok(node)
            }
            Some(c) if c.is_ascii_digit() || c == '.' => self.number(),
            Some(c) if c.is_ascii_alphabetic() || c == '_' => {
                let word = self.word();
                let start = self.at;
                self.at += word.len();
                let node = if self.peek() == Some('(') { self.call(word) } else { self.name(word) };
                node.map_err(|error| match error {
                    Named::At(error) => error,
                    Named::Here(message) => {
                        self.at = start;
                        self.error(message)
                    }
                })
            }
            Some(c) => Err(self.error(format!("a number, a name or \"(\" is expected, not \"{c}\""))),
            None => Err(self.error("the expression ends too early")),
        }
    }

    fn close(&mut self) -> Result<(), ExpressionError> {
        if self.take(")") { Ok(()) } else { Err(self.error("\")\" is missing")) }
    }

    fn number(&mut self) -> Parsed {
        let rest = &self.source.as_bytes()[self.at..];
        let digits = |from: usize| rest[from..].iter().take_while(|c| c.is_ascii_digit()).count();
        let mut end = digits(0);
        if rest.get(end) == Some(&b'.') {
            end += 1 + digits(end + 1);
        }
        if matches!(rest.get(end), Some(b'e' | b'E')) {
            let sign = usize::from(matches!(rest.get(end + 1), Some(b'+' | b'-')));
            let count = digits((end + 1 + sign).min(rest.len()));
            if count > 0 {
                end += 1 + sign + count;
            }
        }
        let text = &self.source[self.at..self.at + end];
        let value = text.parse().map_err(|_| self.error(format!("\"{text}\" is not a number")))?;
        self.at += end;
        Ok(Node::Number(value))
    }

    fn name(&mut self, name: &str) -> Result<Node, Named> {
        if name == "pi" {
            return Ok(Node::Number(std::f64::consts::PI));
        }
        let allowed = self.scope.variables();
        match NAMES.iter().find(|(n, _)| *n == name) {
            Some((_, variable)) if allowed.contains(variable) => return Ok(Node::Variable(*variable)),
            Some(_) => {}
            None => {
                if let Some(node) = (self.define)(name) {
                    return node.map_err(Named::Here);
                }
            }
        }
        let names: Vec<_> = NAMES.iter().filter(|(_, v)| allowed.contains(v)).map(|(n, _)| *n).collect();
        let names = if names.is_empty() { "only".into() } else { names.join(", ") + "," };
        Err(Named::Here(format!("\"{name}\" is not known here; {names} pi and names under [define] are")))
    }

    fn call(&mut self, function: &str) -> Result<Node, Named> {
        let one: Option<Unary> = match function {
            "sin" => Some(f64::sin),
            "cos" => Some(f64::cos),
            "tan" => Some(f64::tan),
            "asin" => Some(f64::asin),
            "acos" => Some(f64::acos),
            "atan" => Some(f64::atan),
            "sinh" => Some(f64::sinh),
            "cosh" => Some(f64::cosh),
            "tanh" => Some(f64::tanh),
            "exp" => Some(f64::exp),
            "ln" => Some(f64::ln),
            "log10" => Some(f64::log10),
            "sqrt" => Some(f64::sqrt),
            "abs" => Some(f64::abs),
            "floor" => Some(f64::floor),
            "ceil" => Some(f64::ceil),
            "sign" => Some(|a| if a == 0.0 { 0.0 } else { a.signum() }),
            _ => None,
        };
        let two: Option<Binary> = match function {
            "atan2" => Some(f64::atan2),
            "min" => Some(f64::min),
            "max" => Some(f64::max),
            "terzaghi_pressure" => Some(closed::terzaghi_pressure),
            "mandel_strain" => Some(closed::mandel_strain),
            _ => None,
        };
        let three: Option<Ternary> = match function {
            "mandel_pressure" => Some(closed::mandel_pressure),
            "mandel_displacement" => Some(closed::mandel_displacement),
            _ => None,
        };
        if one.is_none() && two.is_none() && three.is_none() && function != "if" {
            return Err(Named::Here(format!("\"{function}\" is not a function")));
        }
        self.take("(");
        let mut arguments = vec![self.deeper(Self::or)?];
        while self.take(",") {
            arguments.push(self.deeper(Self::or)?);
        }
        self.close()?;
        let count = arguments.len();
        let wrong = |wanted: &str| Err(Named::Here(format!("{function} has {wanted}, not {count}")));
        if let Some(f) = one {
            return match <[Node; 1]>::try_from(arguments) {
                Ok([a]) => Ok(Node::One(f, Box::new(a)).folded()),
                Err(_) => wrong("one argument"),
            };
        }
        if let Some(f) = two {
            if count < 2 || (!["min", "max"].contains(&function) && count > 2) {
                return wrong("two arguments");
            }
            let mut rest = arguments.into_iter();
            let first = rest.next().unwrap_or(Node::Number(f64::NAN));
            return Ok(rest.fold(first, |a, b| Node::Two(f, Box::new([a, b])).folded()));
        }
        match (<[Node; 3]>::try_from(arguments), three) {
            (Ok(abc), Some(f)) => Ok(Node::Three(f, Box::new(abc)).folded()),
            (Ok(abc), None) => Ok(Node::If(Box::new(abc)).folded()),
            (Err(_), _) => wrong("three arguments"),
        }
    }
}

/// An error at the name itself, or at a place that is known already.
enum Named {
    Here(String),
    At(ExpressionError),
}

impl From<ExpressionError> for Named {
    fn from(error: ExpressionError) -> Self {
        Self::At(error)
    }
}

fn truth(b: bool) -> f64 {
    f64::from(u8::from(b))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(source: &str, scope: Scope) -> Result<Function, ExpressionError> {
        parse(source, scope, &mut |name| (name == "two").then_some(Ok(Node::Number(2.0))))
    }

    #[test]
    fn precedence_and_functions() {
        for (source, wanted) in [
            ("-2^2", -4.0),
            ("2^3^2", 512.0),
            ("2^-1", 0.5),
            ("1 - 2 - 3", -4.0),
            ("12 / 2 / 3 * 2", 4.0),
            ("2e-3 + 1E+2 + .5 + 2.", 102.502),
            ("2 - -3", 5.0),
            ("min(3, 1, 2) + max(1, 4)", 5.0),
            ("if(1 < 2 and not 2 <= 1, 7, 8)", 7.0),
            ("1 == 2 or 3 != 4", 1.0),
            ("sign(-3) + sign(0)", -1.0),
            ("atan2(1, 1) * 4 - pi", 0.0),
            ("two * (1 + two)", 6.0),
            ("two^two^0.5", 2.0_f64.powf(2.0_f64.sqrt())),
        ] {
            let value = read(source, Scope::Constant).map(|f| f.as_constant());
            assert_eq!(value, Ok(Some(wanted)), "{source}");
        }
    }

    #[test]
    fn variables() {
        let f = read("x + 10*y + 100*t + if(cell_x > 0, 1000, 0)", Scope::Boundary).unwrap();
        let mut point = Point::new(Vec3::new(1.0, 2.0, 9.0), 3.0);
        assert_eq!(f.at(&point), 321.0);
        point.cell = Vec3::X;
        assert_eq!(f.at(&point), 1321.0);
        assert_eq!(f.as_constant(), None);
    }

    #[test]
    fn errors_say_where() {
        for (source, column, part) in [
            ("1 + * 2", 5, "number, a name"),
            ("1 + qq", 5, "\"qq\" is not known"),
            ("t", 1, "x, y, z, pi and names"),
            ("sin(1", 6, "\")\" is missing"),
            ("sin(1, 2)", 1, "one argument"),
            ("foo(1)", 1, "not a function"),
            ("1 2", 3, "not expected"),
            ("", 1, "ends too early"),
            ("if(1, 2)", 1, "three arguments"),
            ("mandel_pressure(1, 2)", 1, "three arguments"),
            ("terzaghi_pressure(1, 2, 3)", 1, "two arguments"),
            ("1 + é", 5, "not \"é\""),
            ("..", 1, "not a number"),
        ] {
            let error = read(source, Scope::Place).unwrap_err();
            assert_eq!(error.column, column, "{source}: {error}");
            assert!(error.message.contains(part), "{source}: {error}");
        }
        for deep in [
            "(".repeat(100_000),
            "-".repeat(100_000),
            "not ".repeat(100_000),
            "2^-".repeat(100_000),
            "2^".repeat(100_000),
        ] {
            assert!(read(&deep, Scope::Place).unwrap_err().message.contains("deeper"));
        }
    }
}
