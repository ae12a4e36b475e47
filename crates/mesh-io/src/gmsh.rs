//! Meshes of Gmsh, format MSH 4.1, as text or binary.
//!
//! Physical groups give the names: those of dimension d name regions; those of dimension d − 1 name boundary tags where
//! their faces lie on the outer boundary, and fractures where they lie inside. A group without a name is called
//! by its number; cells without a group are region `rock`. Of several groups on one entity the first counts.
//! Only straight elements are read: triangles, quadrilaterals, tetrahedra, hexahedra, prisms and pyramids; of partitioned
//! meshes none.
//!
//! The crate `mshio` is not used: it takes nodes with gapless numbers as lying in the order of their numbers,
//! which Gmsh does not promise, skips the names of groups, and panics on some damaged files.

use std::path::Path;

use mesh::{MeshData, Vec3};
use rustc_hash::FxHashMap;

use crate::FileError;

/// Names of physical groups by dimension and number.
type Names = FxHashMap<(i32, i32), String>;
/// A section, and what is wrong with it.
type Problem = (&'static str, String);

/// What [`Shape::of`] knows.
const KINDS: &str = "points, lines, triangles, quadrilaterals, tetrahedra, hexahedra, prisms and pyramids";

/// Reads a mesh. Nodes that no cell uses are left out.
///
/// # Errors
/// [`FileError::Io`], [`FileError::Version`], and [`FileError::Content`] for what cannot be read.
pub fn read_gmsh(path: impl AsRef<Path>) -> Result<MeshData, FileError> {
    let path = path.as_ref();
    let bytes = std::fs::read(path).map_err(FileError::io(path))?;
    let content = |(entry, problem): Problem| FileError::content(path, entry, problem);
    let format = section(&bytes, "$MeshFormat").map_err(content)?;
    let (line, rest) = format.split_at(format.iter().position(|&b| b == b'\n').unwrap_or(format.len()));
    let line = String::from_utf8_lossy(line);
    let words: Vec<&str> = line.split_whitespace().collect();
    let &[version, kind, size] = &words[..] else {
        return Err(content(("$MeshFormat", format!("{line:?} is not a version, a kind and a size"))));
    };
    if version != "4.1" {
        return Err(FileError::Version { path: path.into(), found: version.to_owned(), supported: "4.1" });
    }
    let binary = kind == "1";
    // In binary files the number 1 follows the line.
    if size != "8" || (binary && rest.get(1..5) != Some(&[1, 0, 0, 0])) {
        return Err(content(("$MeshFormat", "numbers must be little-endian, of 8 bytes".into())));
    }
    read(&bytes, binary).and_then(|file| convert(&file)).map_err(content)
}

/// What stands between `$Name` and `$EndName`.
fn section<'a>(bytes: &'a [u8], name: &'static str) -> Result<&'a [u8], Problem> {
    let find = |text: &str, from: usize| {
        let pattern = text.as_bytes();
        let at = bytes[from..].windows(pattern.len()).position(|window| window == pattern)?;
        Some(at + from)
    };
    let body = || {
        let start = find(&format!("{name}\n"), 0).map(|at| at + name.len() + 1);
        let start = start.or_else(|| find(&format!("{name}\r\n"), 0).map(|at| at + name.len() + 2))?;
        let end = find(&name.replace('$', "$End"), start)?;
        Some(&bytes[start..end])
    };
    body().ok_or_else(|| (name, "the section is missing or has no end".into()))
}

/// Numbers one after another, as text or binary.
struct Numbers<'a> {
    name: &'static str,
    rest: &'a [u8],
    binary: bool,
}

impl Numbers<'_> {
    fn problem(&self) -> Problem {
        (self.name, format!("a number is missing or damaged, {} bytes before the end", self.rest.len()))
    }

    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], Problem> {
        let (first, rest) = self.rest.split_first_chunk().ok_or_else(|| self.problem())?;
        self.rest = rest;
        Ok(*first)
    }

    fn word<T: std::str::FromStr>(&mut self) -> Result<T, Problem> {
        let rest = self.rest.trim_ascii_start();
        let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        let word = std::str::from_utf8(&rest[..end]).ok().and_then(|word| word.parse().ok());
        let value = word.ok_or_else(|| self.problem())?;
        self.rest = &rest[end..];
        Ok(value)
    }

    fn int(&mut self) -> Result<i32, Problem> {
        if self.binary { Ok(i32::from_le_bytes(self.bytes()?)) } else { self.word() }
    }

    fn size(&mut self) -> Result<u64, Problem> {
        if self.binary { Ok(u64::from_le_bytes(self.bytes()?)) } else { self.word() }
    }

    fn float(&mut self) -> Result<f64, Problem> {
        if self.binary { Ok(f64::from_le_bytes(self.bytes()?)) } else { self.word() }
    }

    /// A number of things, of which each takes at least one byte.
    fn count(&mut self) -> Result<usize, Problem> {
        let count = self.size()?;
        let fits = usize::try_from(count).ok().filter(|&count| count <= self.rest.len());
        fits.ok_or_else(|| (self.name, format!("the count {count} exceeds the section")))
    }
}

/// Elements of one kind on one geometric entity.
struct Block {
    kind: i32,
    /// The first physical group of the entity.
    group: Option<i32>,
    /// Number and nodes of each element.
    elements: Vec<(u64, Vec<u64>)>,
}

struct Content {
    names: Names,
    points: FxHashMap<u64, Vec3>,
    blocks: Vec<Block>,
}

fn read(bytes: &[u8], binary: bool) -> Result<Content, Problem> {
    const NAMES: &str = "$PhysicalNames";
    let has = |name: &str| bytes.windows(name.len()).any(|window| window == name.as_bytes());
    let names = if has(NAMES) { physical_names(section(bytes, NAMES)?)? } else { Names::default() };
    let numbers = |name| section(bytes, name).map(|rest| Numbers { name, rest, binary });

    if has("$PartitionedEntities") {
        // Its elements lie on other entities than those that have groups.
        return Err(("$PartitionedEntities", "partitioned meshes are not read; unite the partitions".into()));
    }
    // Without this section there are no groups.
    let mut groups = FxHashMap::default();
    if has("$Entities") {
        let mut file = numbers("$Entities")?;
        let counts = [file.count()?, file.count()?, file.count()?, file.count()?];
        for (dimension, count) in (0..).zip(counts) {
            for _ in 0..count {
                let entity = file.int()?;
                for _ in 0..if dimension == 0 { 3 } else { 6 } {
                    file.float()?;
                }
                for place in 0..file.count()? {
                    // A minus sign tells the sense of the entity.
                    let group = file.int()?.saturating_abs();
                    if place == 0 {
                        groups.insert((dimension, entity), group);
                    }
                }
                let bounds = if dimension == 0 { 0 } else { file.count()? };
                for _ in 0..bounds {
                    file.int()?;
                }
            }
        }
    }

    let mut points = FxHashMap::default();
    let mut file = numbers("$Nodes")?;
    let [blocks, ..] = [file.count()?, file.size()? as usize, file.size()? as usize, file.size()? as usize];
    for _ in 0..blocks {
        let (dimension, _, parametric) = (file.int()?, file.int()?, file.int()?);
        let tags: Vec<u64> = (0..file.count()?).map(|_| file.size()).collect::<Result<_, _>>()?;
        for tag in tags {
            points.insert(tag, Vec3::new(file.float()?, file.float()?, file.float()?));
            for _ in 0..if parametric == 0 { 0 } else { dimension } {
                file.float()?;
            }
        }
    }

    let mut file = numbers("$Elements")?;
    let [count, ..] = [file.count()?, file.size()? as usize, file.size()? as usize, file.size()? as usize];
    let mut blocks = Vec::new();
    for _ in 0..count {
        let (dimension, entity, kind) = (file.int()?, file.int()?, file.int()?);
        let unknown = || (file.name, format!("elements of type {kind} are not read; {KINDS} are, of order 1"));
        let shape = Shape::of(kind).ok_or_else(unknown)?;
        let mut elements = Vec::new();
        for _ in 0..file.count()? {
            let number = file.size()?;
            elements.push((number, (0..shape.corners).map(|_| file.size()).collect::<Result<_, _>>()?));
        }
        blocks.push(Block { kind, group: groups.get(&(dimension, entity)).copied(), elements });
    }
    Ok(Content { names, points, blocks })
}

/// Also in binary files these are text.
fn physical_names(body: &[u8]) -> Result<Names, Problem> {
    let text = std::str::from_utf8(body).map_err(|error| ("$PhysicalNames", error.to_string()))?;
    let mut names = Names::default();
    for line in text.lines().skip(1) {
        let mut words = line.splitn(3, ' ');
        let mut number = || words.next().and_then(|word| word.parse().ok());
        let (dimension, group) = (number(), number());
        let name = words.next().and_then(|name| name.trim().strip_prefix('"')?.strip_suffix('"'));
        let (Some(dimension), Some(group), Some(name)) = (dimension, group, name) else {
            let problem = format!("{line:?} is not a dimension, a number and a name in quotation marks");
            return Err(("$PhysicalNames", problem));
        };
        names.insert((dimension, group), name.to_owned());
    }
    Ok(names)
}

/// A straight element, in Gmsh's numbering of its corners.
struct Shape {
    dimension: i32,
    corners: usize,
    faces: &'static [&'static [usize]],
}

impl Shape {
    fn of(kind: i32) -> Option<Self> {
        let (dimension, corners, faces): (_, _, &[&[usize]]) = match kind {
            15 => (0, 1, &[]),
            1 => (1, 2, &[]),
            2 => (2, 3, &[&[0, 1], &[1, 2], &[2, 0]]),
            3 => (2, 4, &[&[0, 1], &[1, 2], &[2, 3], &[3, 0]]),
            4 => (3, 4, &[&[0, 1, 2], &[0, 1, 3], &[1, 2, 3], &[0, 2, 3]]),
            5 => (3, 8, &[&[0, 1, 2, 3], &[4, 5, 6, 7], &[0, 1, 5, 4], &[1, 2, 6, 5], &[2, 3, 7, 6], &[3, 0, 4, 7]]),
            6 => (3, 6, &[&[0, 1, 2], &[3, 4, 5], &[0, 1, 4, 3], &[1, 2, 5, 4], &[2, 0, 3, 5]]),
            7 => (3, 5, &[&[0, 1, 2, 3], &[0, 1, 4], &[1, 2, 4], &[2, 3, 4], &[3, 0, 4]]),
            _ => return None,
        };
        Some(Self { dimension, corners, faces })
    }
}

fn convert(file: &Content) -> Result<MeshData, Problem> {
    const SECTION: &str = "$Elements";
    let shapes = || file.blocks.iter().filter_map(|block| Some((Shape::of(block.kind)?, block)));
    let dim = shapes().map(|(shape, _)| shape.dimension).max().unwrap_or(0);
    if dim < 2 {
        return Err((SECTION, format!("the elements have dimension {dim}; a mesh has 2 or 3")));
    }
    let mut vertices = Vec::new();
    let mut number: FxHashMap<u64, usize> = FxHashMap::default();
    let mut cells: Vec<Vec<Vec<usize>>> = Vec::new();
    let mut cell_group = Vec::new();
    for (shape, block) in shapes().filter(|(shape, _)| shape.dimension == dim) {
        for (element, nodes) in &block.elements {
            let mut corners = Vec::new();
            for node in nodes {
                let unknown = || (SECTION, format!("element {element} has node {node}, which is not there"));
                let x = *file.points.get(node).ok_or_else(unknown)?;
                corners.push(*number.entry(*node).or_insert_with(|| {
                    vertices.push(x);
                    vertices.len() - 1
                }));
            }
            cells.push(shape.faces.iter().map(|face| face.iter().map(|&i| corners[i]).collect()).collect());
            cell_group.push(block.group);
        }
    }

    let name =
        |dimension, group: i32| file.names.get(&(dimension, group)).cloned().unwrap_or_else(|| group.to_string());
    let mut data = if dim == 3 {
        MeshData::from_polyhedra(vertices, cells)
    } else {
        // The corners of a polygon are the first ends of its edges.
        let polygons = cells.iter().map(|cell| cell.iter().map(|edge| edge[0]).collect::<Vec<_>>());
        MeshData::from_polygons(vertices, polygons)
    };
    data.regions.clear();
    for (cell, group) in cell_group.into_iter().enumerate() {
        data.cell_region[cell] = data.region(&group.map_or("rock".into(), |group| name(dim, group)));
    }
    let key = |list: &[usize]| {
        let mut key = list.to_vec();
        key.sort_unstable();
        key
    };
    let face_of: FxHashMap<Vec<usize>, usize> =
        data.faces.iter().enumerate().map(|(face, list)| (key(list), face)).collect();
    let cells_of_face = data.cells.transpose(data.faces.len());
    for (_, block) in shapes().filter(|(shape, _)| shape.dimension == dim - 1) {
        let Some(group) = block.group else { continue };
        let name = name(dim - 1, group);
        for (element, nodes) in &block.elements {
            let corners: Option<Vec<usize>> = nodes.iter().map(|node| number.get(node).copied()).collect();
            let face = corners.and_then(|corners| face_of.get(&key(&corners)).copied());
            let Some(face) = face else {
                return Err((SECTION, format!("element {element}, of group \"{name}\", is no face of any cell")));
            };
            if cells_of_face.get(face).len() > 1 {
                data.face_fracture[face] = Some(data.fracture(&name));
            } else {
                data.face_tag[face] = Some(data.tag(&name));
            }
        }
    }
    Ok(data)
}
