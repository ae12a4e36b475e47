//! From text to a typed model: parsing, variants, and all problems with their places.
//!
//! serde stops at the first error. To find all, what an error points to is taken out of the tree, or a required key
//! is put in, and the tree is read again, until nothing is left to complain about; models are small.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::Range;

use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::error::{Place, Problem, Problems};
use crate::value::reading_with;
use crate::{Model, ModelError, Value};

/// A model with its text, to say where things stand.
#[derive(Clone, Debug)]
pub struct Document {
    /// The model, with the variant and the changes in it.
    pub model: Model,
    sources: Vec<Source>,
    /// Where each key or entry stands, by its path.
    places: BTreeMap<String, Range<usize>>,
}

#[derive(Clone, Debug)]
struct Source {
    name: String,
    text: String,
    /// Where it starts in the row of all sources; spans count from there.
    start: usize,
}

impl Document {
    /// Reads a model from its text. `name` is that of the file, for messages; The `variants` are laid over it, and then
    /// the `changes`, in order, each a piece of TOML such as `mesh.triangles.fracture_size = 0.02`.
    ///
    /// # Errors
    /// [`ModelError::Invalid`] with everything that is wrong, as far as it can be told without a mesh.
    pub fn read(name: &str, text: &str, variants: &[&str], changes: &[&str]) -> Result<Self, ModelError> {
        let mut sources = vec![Source { name: name.to_owned(), text: text.to_owned(), start: 0 }];
        for change in changes {
            let start = sources.last().map_or(0, |s| s.start + s.text.len() + 1);
            sources.push(Source { name: (*change).to_owned(), text: (*change).to_owned(), start });
        }
        // Blanks in front make spans count from `start`.
        let padded: Vec<String> = sources.iter().map(|s| " ".repeat(s.start) + &s.text).collect();
        let mut reader = Reader { sources, problems: Vec::new(), changed: Vec::new() };
        let mut tree = reader.parse(&padded[0]);
        for variant in variants {
            match named_variant(&tree, variant) {
                Ok(table) => lay_over(&mut tree, table),
                Err(message) => reader.problem("variants".into(), None, message),
            }
        }
        for change in &padded[1..] {
            lay_over(&mut tree, reader.parse(change));
        }
        reader.fail()?;
        let Some(model) = reader.deserialise(&tree) else {
            reader.fail()?;
            let message = "the model cannot be read".to_owned();
            return Err(Problems(vec![Problem { key: String::new(), place: None, message }]).into());
        };
        let mut places = BTreeMap::new();
        list_places("", &tree, &mut places);
        let document = Self { model, sources: reader.sources.clone(), places };
        for (key, message) in document.model.problems() {
            if !reader.has_caused(&key, &message) {
                reader.problem(key.clone(), document.span(&key), message);
            }
        }
        reader.fail()?;
        Ok(document)
    }

    /// The text of the model as it is, with variant and changes, and without the variants.
    pub fn to_toml(&self) -> String {
        let mut model = self.model.clone();
        model.variants.clear();
        toml::to_string(&model).unwrap_or_else(|error| format!("# {error}\n"))
    }

    /// Everything in the model that does not fit a mesh.
    ///
    /// # Errors
    /// [`ModelError::Invalid`].
    pub fn check_mesh(&self, mesh: &mesh::Mesh) -> Result<(), ModelError> {
        self.report(self.model.mesh_problems(mesh))
    }

    /// Fails on problems, given as path of the key and message, with their places.
    fn report(&self, problems: Vec<(String, String)>) -> Result<(), ModelError> {
        let mut problems: Vec<(usize, Problem)> = (problems.into_iter())
            .map(|(key, message)| {
                let span = self.span(&key);
                let start = span.as_ref().map_or(usize::MAX, |s| s.start);
                (start, Problem { place: span.map(|span| place(&self.sources, &span)), key, message })
            })
            .collect();
        problems.sort_by_key(|p| p.0);
        if problems.is_empty() { Ok(()) } else { Err(Problems(problems.into_iter().map(|p| p.1).collect()).into()) }
    }

    /// An error at a key.
    pub(crate) fn invalid(&self, key: &str, message: &str) -> ModelError {
        let place = self.span(key).map(|span| place(&self.sources, &span));
        Problems(vec![Problem { key: key.to_owned(), place, message: message.to_owned() }]).into()
    }

    /// A key with its place, as a message begins.
    pub(crate) fn place(&self, key: &str) -> String {
        self.span(key).map_or_else(|| key.to_owned(), |span| format!("{}: {key}", place(&self.sources, &span)))
    }

    /// Where a key, or else the nearest table or list around it, stands.
    fn span(&self, key: &str) -> Option<Range<usize>> {
        let mut names = split(key);
        while !names.is_empty() {
            let path: Vec<_> = names.iter().map(|n| quote(n)).collect();
            if let Some(span) = self.places.get(&path.join(".")) {
                return Some(span.clone());
            }
            names.pop();
        }
        None
    }
}

/// Where all keys and entries of a table stand: tables at their key, all else at its value.
fn list_places(path: &str, table: &DeTable<'_>, places: &mut BTreeMap<String, Range<usize>>) {
    fn value(path: String, span: Range<usize>, of: &DeValue<'_>, places: &mut BTreeMap<String, Range<usize>>) {
        match of {
            DeValue::Table(table) => list_places(&path, table, places),
            DeValue::Array(list) => {
                for (i, entry) in list.iter().enumerate() {
                    value(join(&path, &i.to_string()), entry.span(), entry.get_ref(), places);
                }
            }
            _ => {}
        }
        places.insert(path, span);
    }
    for (key, entry) in table {
        let span = if entry.get_ref().is_table() { key.span() } else { entry.span() };
        value(join(path, key.get_ref()), span, entry.get_ref(), places);
    }
}

/// The names in a path of keys. A name with dots is in quotes.
fn split(key: &str) -> Vec<String> {
    let mut names = vec![String::new()];
    let mut quoted = false;
    for c in key.chars() {
        match c {
            '"' => quoted = !quoted,
            '.' if !quoted => names.push(String::new()),
            c => names.iter_mut().last().into_iter().for_each(|n| n.push(c)),
        }
    }
    names
}

/// A name as it stands in a path of keys.
pub(crate) fn quote(name: &str) -> Cow<'_, str> {
    if name.contains('.') { format!("\"{name}\"").into() } else { name.into() }
}

fn place(sources: &[Source], span: &Range<usize>) -> Place {
    let source = sources.iter().rfind(|s| s.start <= span.start);
    let (name, before) = source.map_or(("", ""), |s| {
        let end = (span.start - s.start).min(s.text.len());
        (&s.name, s.text.get(..end).unwrap_or(&s.text))
    });
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
    Place { source: name.to_owned(), line, column }
}

/// Lays a variant or change over a model. One with another source of the mesh replaces all of `mesh`: what is said there
/// of regions, tags and fractures belongs to the source.
fn lay_over<'a>(tree: &mut DeTable<'a>, over: DeTable<'a>) {
    let source = |tree: &DeTable<'a>| {
        let mesh = tree.get("mesh")?.get_ref().as_table()?;
        ["box", "triangles", "corner_point", "file"].into_iter().find(|&source| mesh.contains_key(source))
    };
    if source(&over).is_some_and(|new| source(tree).is_some_and(|old| old != new)) {
        tree.remove("mesh");
    }
    merge(tree, over);
}

/// Lays one table over another: tables are united, all else is replaced.
fn merge<'a>(into: &mut DeTable<'a>, over: DeTable<'a>) {
    for (key, value) in over {
        let span = value.span();
        match (into.get_mut(key.get_ref().as_ref()).map(Spanned::get_mut), value.into_inner()) {
            (Some(DeValue::Table(old)), DeValue::Table(new)) => merge(old, new),
            (_, value) => {
                // An equal key would keep its old place.
                into.remove(key.get_ref().as_ref());
                into.insert(key, Spanned::new(span, value));
            }
        }
    }
}

fn named_variant<'a>(tree: &DeTable<'a>, name: &str) -> Result<DeTable<'a>, String> {
    let variants = tree.get("variants").and_then(|v| v.get_ref().as_table());
    match variants.and_then(|v| v.get(name)).map(Spanned::get_ref) {
        Some(DeValue::Table(table)) => Ok(table.clone()),
        _ => {
            let known: Vec<_> = variants.into_iter().flat_map(|v| v.keys()).map(|k| k.get_ref().as_ref()).collect();
            let known = if known.is_empty() { "there are none".into() } else { known.join(", ") };
            Err(format!("there is no variant \"{name}\"; known: {known}"))
        }
    }
}

struct Reader {
    sources: Vec<Source>,
    problems: Vec<Problem>,
    /// Paths of what was taken out or put in to read on.
    changed: Vec<String>,
}

/// What a required key is given, to read on, where it is left out.
const GUESSES: [&str; 5] = ["0.5", "1", "'1'", "[]", "{}"];
/// Where it stands then.
const NOWHERE: Range<usize> = usize::MAX..usize::MAX;
/// What toml says of a choice with entries of its own that is only named, and what is said for it.
const NAME_ALONE: &str = "invalid type: unit variant, expected struct variant";
const TABLE: &str = "this choice has entries: it must be a table, { NAME = {} } where all have defaults";
/// What it says of a choice without a name.
const EMPTY_CHOICE: &str = "wanted exactly 1 element, found 0 elements";
/// Times that the tree is read again: more problems than this do not help anyone.
const MAX_PROBLEMS: usize = 200;

impl Reader {
    fn problem(&mut self, key: String, span: Option<Range<usize>>, message: String) {
        let place = span.map(|span| place(&self.sources, &span));
        self.problems.push(Problem { key, place, message });
    }

    fn fail(&mut self) -> Result<(), ModelError> {
        if self.problems.is_empty() {
            return Ok(());
        }
        let order = |p: &Problem| {
            let source = |of: &Place| self.sources.iter().position(|s| s.name == of.source);
            p.place.as_ref().map_or((None, usize::MAX, 0), |p| (source(p), p.line, p.column))
        };
        // What has no place comes last.
        self.problems.sort_by_key(|p| (p.place.is_none(), order(p)));
        Err(Problems(std::mem::take(&mut self.problems)).into())
    }

    /// Whether a problem with what was read may come of what was taken out or put in: what stands at, in or around it,
    /// what names it, and uses of a definition.
    fn has_caused(&self, key: &str, message: &str) -> bool {
        let within = |inner: &str, outer: &str| {
            outer.is_empty() || inner.strip_prefix(outer).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
        };
        let names = |changed: &String| changed.contains('.') && message.contains(changed);
        let about = |changed: &String| within(key, changed) || within(changed, key) || names(changed);
        self.uses_unread(message) || self.changed.iter().any(about)
    }

    /// Whether a message complains of a definition that was taken out.
    fn uses_unread(&self, message: &str) -> bool {
        let unread = |changed: &String| {
            let name = changed.strip_prefix("define.")?;
            Some(message.contains(&format!("\"{name}\" is not known")))
        };
        self.changed.iter().filter_map(unread).any(|is| is)
    }

    fn parse<'a>(&mut self, padded: &'a str) -> DeTable<'a> {
        let (tree, errors) = DeTable::parse_recoverable(padded);
        for error in errors {
            self.problem(String::new(), error.span(), error.message().to_owned());
        }
        tree.into_inner()
    }

    fn deserialise(&mut self, whole: &DeTable<'_>) -> Option<Model> {
        let mut tree = whole.clone();
        let mut removed: Vec<String> = Vec::new();
        while self.problems.len() < MAX_PROBLEMS {
            let error = match read(&tree) {
                Ok(model) => return Some(model),
                Err(error) => error,
            };
            let span = error.span().unwrap_or(0..0);
            let missing = error.message().strip_prefix("missing field `").and_then(|m| m.strip_suffix('`'));
            let (path, found) = find(&tree, &span).unwrap_or_default();
            // Entries of a list move up where one before them was taken out: messages name them as in the file.
            let shown = find(whole, &span).map_or_else(|| path.clone(), |found| found.0);
            if let Some(missing) = missing {
                let key = join(&path, missing);
                if !removed.contains(&key) {
                    let span = (!path.is_empty()).then(|| span.clone());
                    self.problem(join(&shown, missing), span, "this key is required".into());
                }
                // Filled in, to see what else is wrong; where no guess fits, its table is taken out.
                let fits = GUESSES.iter().find(|guess| {
                    let mut trial = tree.clone();
                    insert(&mut trial, &key, guess);
                    read(&trial).err().is_none_or(|e| {
                        e.span() != Some(NOWHERE) && (e.message(), e.span()) != (error.message(), error.span())
                    })
                });
                if let Some(guess) = fits {
                    insert(&mut tree, &key, guess);
                    self.changed.push(join(&shown, missing));
                    continue;
                }
                self.changed.push(shown);
            } else {
                // The entries of a list move up where one is taken out: none of them is looked at further.
                let list = shown.rsplit_once('.').filter(|(_, last)| last.parse::<usize>().is_ok());
                if !error.message().starts_with("unknown field") {
                    self.changed.push(list.map_or(shown.as_str(), |list| list.0).to_owned());
                }
                let message = error.message();
                // What is left of a choice whose name was taken out.
                let is_rest = message == EMPTY_CHOICE
                    && removed.iter().any(|r| r.rsplit_once('.').is_some_and(|(around, _)| around == path));
                if !is_rest && !self.uses_unread(message) {
                    let message = if message == NAME_ALONE { TABLE } else { message };
                    self.problem(shown, Some(found.unwrap_or(span)), message.to_owned());
                }
            }
            if path.is_empty() || !remove(&mut tree, &path) {
                return None;
            }
            removed.push(path);
        }
        None
    }
}

fn read(tree: &DeTable<'_>) -> Result<Model, toml::de::Error> {
    #[derive(Default, Deserialize)]
    struct Definitions {
        #[serde(default)]
        define: BTreeMap<String, toml::Value>,
    }
    let deserializer = || toml::Deserializer::from(Spanned::new(0..0, tree.clone()));
    // What is not readable is an error of the model.
    let definitions = Definitions::deserialize(deserializer()).unwrap_or_default().define.into_iter();
    let define = definitions.filter_map(|(name, value)| Some((name, Value::deserialize(value).ok()?))).collect();
    reading_with(define, || Model::deserialize(deserializer()))
}

fn join(path: &str, name: &str) -> String {
    if path.is_empty() { quote(name).into_owned() } else { format!("{path}.{}", quote(name)) }
}

/// The path of the innermost key or value that a span points to, and the span of its key.
fn find(tree: &DeTable<'_>, span: &Range<usize>) -> Option<(String, Option<Range<usize>>)> {
    fn in_value(path: String, value: &Spanned<DeValue<'_>>, span: &Range<usize>) -> Option<String> {
        let inner = match value.get_ref() {
            DeValue::Table(table) => table.iter().find_map(|(key, value)| {
                let path = join(&path, key.get_ref());
                if key.span() == *span { Some(path) } else { in_value(path, value, span) }
            }),
            DeValue::Array(list) => {
                list.iter().enumerate().find_map(|(i, entry)| in_value(join(&path, &i.to_string()), entry, span))
            }
            _ => None,
        };
        inner.or_else(|| (value.span() == *span).then_some(path))
    }
    tree.iter().find_map(|(key, value)| {
        let path = quote(key.get_ref()).into_owned();
        if key.span() == *span {
            return Some((path, Some(key.span())));
        }
        in_value(path, value, span).map(|path| (path, None))
    })
}

/// Takes what a path leads to out of the tree.
fn remove(tree: &mut DeTable<'_>, path: &str) -> bool {
    with_parent(tree, path, |parent, name| match parent {
        Parent::Table(table) => table.remove(name).is_some(),
        Parent::List(list) => {
            let index = name.parse().unwrap_or(usize::MAX);
            if index < list.len() {
                *list = list.iter().enumerate().filter(|(i, _)| *i != index).map(|(_, v)| v.clone()).collect();
            }
            true
        }
    })
}

fn insert(tree: &mut DeTable<'_>, path: &str, guess: &'static str) {
    let Ok(value) = DeValue::parse(guess) else { return };
    let value = Spanned::new(NOWHERE, value.into_inner());
    with_parent(tree, path, |parent, name| {
        if let Parent::Table(table) = parent {
            table.insert(Spanned::new(NOWHERE, Cow::Owned(name.to_owned())), value);
        }
        true
    });
}

enum Parent<'a, 'i> {
    Table(&'a mut DeTable<'i>),
    List(&'a mut toml::de::DeArray<'i>),
}

fn with_parent<'i>(tree: &mut DeTable<'i>, path: &str, act: impl FnOnce(Parent<'_, 'i>, &str) -> bool) -> bool {
    let names = split(path);
    let Some((last, names)) = names.split_last() else { return false };
    let mut parent = Parent::Table(tree);
    for name in names {
        let next = match parent {
            Parent::Table(table) => table.get_mut(name.as_str()),
            Parent::List(list) => name.parse().ok().and_then(|i: usize| list.get_mut(i)),
        };
        parent = match next.map(Spanned::get_mut) {
            Some(DeValue::Table(table)) => Parent::Table(table),
            Some(DeValue::Array(list)) => Parent::List(list),
            _ => return false,
        };
    }
    act(parent, last)
}
