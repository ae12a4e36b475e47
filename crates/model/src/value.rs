//! What stands right of the equals sign: numbers, expressions, points and tensors.

use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{self, Deserializer, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};

use crate::expression::{ExpressionError, Function, Node, Scope, parse};

/// A number, or an expression of what its place allows ([`Scope`]).
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Value {
    /// A number.
    Number(f64),
    /// An expression.
    Expression(String),
}

impl From<f64> for Value {
    fn from(value: f64) -> Self {
        Self::Number(value)
    }
}

impl<'de> Deserialize<'de> for Value {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Of;
        impl Visitor<'_> for Of {
            type Value = Value;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number or an expression in quotes")
            }
            fn visit_f64<E: de::Error>(self, v: f64) -> Result<Value, E> {
                if v.is_finite() { Ok(Value::Number(v)) } else { Err(E::custom("the number must be finite")) }
            }
            fn visit_i64<E: de::Error>(self, v: i64) -> Result<Value, E> {
                Ok(Value::Number(v as f64))
            }
            fn visit_str<E: de::Error>(self, v: &str) -> Result<Value, E> {
                Ok(Value::Expression(v.to_owned()))
            }
        }
        deserializer.deserialize_any(Of)
    }
}

impl JsonSchema for Value {
    fn schema_name() -> Cow<'static, str> {
        "Value".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "description": "A number (SI unit) or an expression.", "type": ["number", "string"] })
    }
}

/// What is under `[define]`, by name.
type Definitions = BTreeMap<String, Value>;

/// Makes a value ready to be evaluated. Names under `[define]` whose meaning is being looked up are in `open`.
pub(crate) fn compile(
    define: &Definitions,
    value: &Value,
    scope: Scope,
    open: &mut Vec<String>,
) -> Result<Function, ExpressionError> {
    match value {
        Value::Number(value) => Ok(Function::constant(*value)),
        Value::Expression(text) => parse(text, scope, &mut |name| {
            let value = define.get(name)?;
            if open.iter().any(|n| n == name) {
                return Some(Err(format!("\"{name}\" is defined by itself: {} → {name}", open.join(" → "))));
            }
            open.push(name.to_owned());
            let node = compile(define, value, scope, open).map(Node::from);
            open.pop();
            Some(node.map_err(|error| format!("in \"{name}\": {}", error.message)))
        }),
    }
}

thread_local! {
    /// The definitions of the model that is being read: serde hands nothing down to a value.
    static DEFINE: RefCell<Definitions> = RefCell::default();
}

/// Reads with these definitions for constant expressions.
pub(crate) fn reading_with<T>(define: Definitions, read: impl FnOnce() -> T) -> T {
    DEFINE.set(define);
    let result = read();
    DEFINE.take();
    result
}

/// The value of a constant expression.
fn constant<E: de::Error>(text: &str) -> Result<f64, E> {
    let value = Value::Expression(text.to_owned());
    let function = DEFINE.with_borrow(|define| compile(define, &value, Scope::Constant, &mut Vec::new()));
    Ok(function.map_err(E::custom)?.as_constant().unwrap_or(f64::NAN))
}

/// A number; in the file also a constant expression such as `"tan(25*pi/180)"` or, with `day` under `[define]`,
/// `"20*day"`.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize)]
#[serde(transparent)]
pub struct Number(pub f64);

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = match Value::deserialize(deserializer)? {
            Value::Number(value) => value,
            Value::Expression(text) => constant(&text)?,
        };
        if value.is_finite() { Ok(Self(value)) } else { Err(de::Error::custom("the expression is not finite")) }
    }
}

impl JsonSchema for Number {
    fn schema_name() -> Cow<'static, str> {
        "Number".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "description": "A number (SI unit) or a constant expression.", "type": ["number", "string"] })
    }
}

/// `N` numbers. (An array of serde would leave further ones unseen.)
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Numbers<const N: usize>(#[serde(serialize_with = "as_list")] pub [f64; N]);

fn as_list<S: serde::Serializer, const N: usize>(list: &[f64; N], serializer: S) -> Result<S::Ok, S::Error> {
    list.as_slice().serialize(serializer)
}

impl<'de, const N: usize> Deserialize<'de> for Numbers<N> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let list: Vec<Number> = Vec::deserialize(deserializer)?;
        let list: Vec<f64> = list.into_iter().map(|n| n.0).collect();
        <[f64; N]>::try_from(list)
            .map(Self)
            .map_err(|list| de::Error::custom(format!("expected a list of {N} numbers, not {}", list.len())))
    }
}

impl<const N: usize> JsonSchema for Numbers<N> {
    fn schema_name() -> Cow<'static, str> {
        format!("Numbers{N}").into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let number = generator.subschema_for::<Number>();
        json_schema!({ "type": "array", "items": number, "minItems": N, "maxItems": N })
    }
}

/// Two or three numbers, one for each dimension.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Coordinates(pub Vec<f64>);

impl Coordinates {
    /// As a vector; z = 0 in 2D.
    pub fn vector(&self) -> mesh::Vec3 {
        let at = |i: usize| self.0.get(i).copied().unwrap_or(0.0);
        mesh::Vec3::new(at(0), at(1), at(2))
    }
}

impl<'de> Deserialize<'de> for Coordinates {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let list: Vec<Number> = Vec::deserialize(deserializer)?;
        if matches!(list.len(), 2 | 3) {
            Ok(Self(list.into_iter().map(|n| n.0).collect()))
        } else {
            Err(de::Error::custom(format!("expected two or three numbers, not {}", list.len())))
        }
    }
}

impl JsonSchema for Coordinates {
    fn schema_name() -> Cow<'static, str> {
        "Coordinates".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let number = generator.subschema_for::<Number>();
        json_schema!({ "type": "array", "items": number, "minItems": 2, "maxItems": 3 })
    }
}

/// A symmetric tensor: one number for all directions, a list of the diagonal, or a list of rows.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Tensor {
    /// The same in all directions.
    Isotropic(f64),
    /// The diagonal: x, y and, in 3D, z.
    Diagonal(Vec<f64>),
    /// The rows.
    Full(Vec<Vec<f64>>),
}

impl Tensor {
    /// As rows; in `dim` 2 what belongs to z is zero.
    pub fn rows(&self, dim: usize) -> [[f64; 3]; 3] {
        let mut rows = [[0.0; 3]; 3];
        for (i, row) in rows.iter_mut().enumerate().take(dim) {
            match self {
                Self::Isotropic(k) => row[i] = *k,
                Self::Diagonal(k) => row[i] = k.get(i).copied().unwrap_or(0.0),
                Self::Full(k) => {
                    for (j, entry) in row.iter_mut().enumerate().take(dim) {
                        *entry = k.get(i).and_then(|r| r.get(j)).copied().unwrap_or(0.0);
                    }
                }
            }
        }
        rows
    }

    /// What is wrong with it in `dim` dimensions: its shape, its symmetry, or that it is not positive definite.
    pub fn problem(&self, dim: usize) -> Option<String> {
        let fits = match self {
            Self::Isotropic(_) => true,
            Self::Diagonal(k) => k.len() == dim,
            Self::Full(k) => k.len() == dim && k.iter().all(|row| row.len() == dim),
        };
        if !fits {
            return Some(format!("the tensor must be a number, {dim} numbers, or {dim} rows of {dim} numbers"));
        }
        let k = self.rows(dim);
        let largest = k.iter().flatten().fold(0.0_f64, |m, v| m.max(v.abs()));
        // Entries that should be equal may differ by round-off of the largest.
        if (0..dim).any(|i| (0..i).any(|j| (k[i][j] - k[j][i]).abs() > 1e-12 * largest)) {
            return Some("the tensor must be symmetric".into());
        }
        // Sylvester's criterion.
        let second = k[0][0] * k[1][1] - k[0][1] * k[1][0];
        let third = k[0][0] * (k[1][1] * k[2][2] - k[1][2] * k[2][1])
            - k[0][1] * (k[1][0] * k[2][2] - k[1][2] * k[2][0])
            + k[0][2] * (k[1][0] * k[2][1] - k[1][1] * k[2][0]);
        let minors = [k[0][0], second, if dim == 3 { third } else { 1.0 }];
        if minors.iter().all(|&m| m > 0.0) { None } else { Some("the tensor must be positive definite".into()) }
    }
}

impl<'de> Deserialize<'de> for Tensor {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Of;
        impl<'de> Visitor<'de> for Of {
            type Value = Tensor;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number, a list of numbers (the diagonal) or a list of rows")
            }
            fn visit_f64<E: de::Error>(self, v: f64) -> Result<Tensor, E> {
                Ok(Tensor::Isotropic(v))
            }
            fn visit_i64<E: de::Error>(self, v: i64) -> Result<Tensor, E> {
                Ok(Tensor::Isotropic(v as f64))
            }
            fn visit_str<E: de::Error>(self, v: &str) -> Result<Tensor, E> {
                constant(v).map(Tensor::Isotropic)
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Tensor, A::Error> {
                let (mut numbers, mut rows) = (Vec::new(), Vec::new());
                while let Some(entry) = list.next_element::<Tensor>()? {
                    match entry {
                        Tensor::Isotropic(k) => numbers.push(k),
                        Tensor::Diagonal(row) => rows.push(row),
                        Tensor::Full(_) => return Err(de::Error::custom("a row must consist of numbers")),
                    }
                }
                match (numbers.is_empty(), rows.is_empty()) {
                    (false, true) => Ok(Tensor::Diagonal(numbers)),
                    (true, false) => Ok(Tensor::Full(rows)),
                    _ => Err(de::Error::custom("expected numbers (the diagonal) or rows, and at least one")),
                }
            }
        }
        deserializer.deserialize_any(Of)
    }
}

impl JsonSchema for Tensor {
    fn schema_name() -> Cow<'static, str> {
        "Tensor".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let number = generator.subschema_for::<Number>();
        json_schema!({
            "description": "A symmetric tensor: one number, the diagonal, or the rows.",
            "anyOf": [number, { "type": "array", "items": number },
                      { "type": "array", "items": { "type": "array", "items": number } }],
        })
    }
}
