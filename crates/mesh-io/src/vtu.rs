//! Results for ParaView: VTK XML unstructured grids (`.vtu`), binary, and lists of them over time (`.pvd`).
//!
//! Points are the nodes of the mesh, not its vertices: where a fracture passes, each side has its own, so that
//! a displacement on the nodes opens the fracture when the grid is warped by it. Cells are triangles and polygons in 2D,
//! tetrahedra and polyhedra in 3D.

use std::fmt::Write as _;
use std::path::Path;

use mesh::{Mesh, Vec3};
use rustc_hash::FxHashMap;

use crate::FileError;
use crate::error::replace;

/// Values of a field.
#[derive(Clone, Copy, Debug)]
pub enum Values<'a> {
    /// One number each.
    Scalars(&'a [f64]),
    /// One vector each.
    Vectors(&'a [Vec3]),
}

/// A named field.
#[derive(Clone, Copy, Debug)]
pub struct Field<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its values.
    pub values: Values<'a>,
}

impl<'a> Field<'a> {
    /// A field of numbers.
    pub fn scalars(name: &'a str, values: &'a [f64]) -> Self {
        Self { name, values: Values::Scalars(values) }
    }

    /// A field of vectors.
    pub fn vectors(name: &'a str, values: &'a [Vec3]) -> Self {
        Self { name, values: Values::Vectors(values) }
    }

    fn check(&self, entity: &'static str, expected: usize) -> Result<(), FileError> {
        let found = match self.values {
            Values::Scalars(list) => list.len(),
            Values::Vectors(list) => list.len(),
        };
        if found == expected {
            Ok(())
        } else {
            Err(FileError::FieldLength { name: self.name.into(), entity, found, expected })
        }
    }
}

/// VTK's numbers for the kinds of cells.
const TRIANGLE: u8 = 5;
const POLYGON: u8 = 7;
const TETRAHEDRON: u8 = 10;
const LINE: u8 = 3;
const POLYHEDRON: u8 = 42;

/// Writes the cells, with `node_fields` on [`Mesh::nodes`] and `cell_fields` on the cells; the region's number is
/// added as `region`.
///
/// # Errors
/// [`FileError::FieldLength`], [`FileError::Io`].
pub fn write_vtu(
    path: impl AsRef<Path>,
    mesh: &Mesh,
    node_fields: &[Field],
    cell_fields: &[Field],
) -> Result<(), FileError> {
    node_fields.iter().try_for_each(|field| field.check("nodes", mesh.nodes().count()))?;
    cell_fields.iter().try_for_each(|field| field.check("cells", mesh.cell_count()))?;
    let mut grid =
        Grid { points: mesh.nodes().vertices().iter().map(|&v| mesh.vertices()[v]).collect(), ..Grid::default() };
    for cell in 0..mesh.cell_count() {
        let own = mesh.cell_vertices(cell);
        let nodes = mesh.nodes().of_cell(cell);
        let node = |v: usize| nodes[own.binary_search(&v).unwrap_or_else(|_| unreachable!("a cell has its vertices"))];
        if mesh.dim() == 2 {
            let polygon = mesh.cell_polygon(cell);
            let kind = if polygon.len() == 3 { TRIANGLE } else { POLYGON };
            grid.add(kind, polygon.into_iter().map(node), &[]);
        } else if own.len() == 4 {
            // The vertices of a face seen from outside are counter-clockwise; VTK wants them so seen from the fourth.
            let face = mesh.cell_faces(cell)[0];
            let mut list = mesh.face_vertices(face).to_vec();
            if mesh.cell_face_signs(cell)[0] > 0.0 {
                list.reverse();
            }
            list.extend(own.iter().filter(|&v| !mesh.face_vertices(face).contains(v)));
            grid.add(TETRAHEDRON, list.into_iter().map(node), &[]);
        } else {
            let faces: Vec<Vec<usize>> = (mesh.cell_faces(cell).iter().zip(mesh.cell_face_signs(cell)))
                .map(|(&face, &sign)| {
                    let list = mesh.face_vertices(face).iter().map(|&v| node(v));
                    if sign > 0.0 { list.collect() } else { list.rev().collect() }
                })
                .collect();
            grid.add(POLYHEDRON, nodes.iter().copied(), &faces);
        }
    }
    let region: Vec<i64> = mesh.data().cell_region.iter().map(|&r| r as i64).collect();
    grid.write(path.as_ref(), node_fields, cell_fields, ("region", &region))
}

/// Writes the fracture faces, with fields on them in the order of [`mesh::Network::faces`]; the fracture's number is
/// added as `fracture`. Points are vertices.
///
/// # Errors
/// [`FileError::FieldLength`], [`FileError::Io`].
pub fn write_fracture_vtu(path: impl AsRef<Path>, mesh: &Mesh, face_fields: &[Field]) -> Result<(), FileError> {
    let network = mesh.network();
    face_fields.iter().try_for_each(|field| field.check("fracture faces", network.face_count()))?;
    let mut grid = Grid::default();
    let mut number = FxHashMap::default();
    for &face in &network.faces {
        let list: Vec<usize> = (mesh.face_vertices(face).iter())
            .map(|&v| {
                *number.entry(v).or_insert_with(|| {
                    grid.points.push(mesh.vertices()[v]);
                    grid.points.len() - 1
                })
            })
            .collect();
        let kind = match list.len() {
            2 => LINE,
            3 => TRIANGLE,
            _ => POLYGON,
        };
        grid.add(kind, list.into_iter(), &[]);
    }
    let fracture: Vec<i64> = network.fracture.iter().map(|&i| i as i64).collect();
    grid.write(path.as_ref(), &[], face_fields, ("fracture", &fracture))
}

/// Writes a list of files with their times (s), which ParaView opens as one series. The file names count from where
/// the list lies.
///
/// # Errors
/// [`FileError::Io`].
pub fn write_pvd(path: impl AsRef<Path>, files: &[(f64, String)]) -> Result<(), FileError> {
    let mut text =
        String::from("<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\">\n<Collection>\n");
    for (time, file) in files {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "<DataSet timestep=\"{time}\" file=\"{}\"/>", escaped(file));
    }
    text.push_str("</Collection>\n</VTKFile>\n");
    save(path.as_ref(), &text)
}

fn save(path: &Path, text: &str) -> Result<(), FileError> {
    replace(path, |part| std::fs::write(part, text).map_err(FileError::io(path)))
}

#[derive(Default)]
struct Grid {
    points: Vec<Vec3>,
    connectivity: Vec<i64>,
    offsets: Vec<i64>,
    types: Vec<u8>,
    /// For each polyhedron the number of its faces, and for each of these their number of points and the points.
    faces: Vec<i64>,
    /// Where the entry of each cell in `faces` ends; −1 for one that is no polyhedron.
    face_offsets: Vec<i64>,
}

impl Grid {
    fn add(&mut self, kind: u8, points: impl Iterator<Item = usize>, faces: &[Vec<usize>]) {
        self.connectivity.extend(points.map(|p| p as i64));
        self.offsets.push(self.connectivity.len() as i64);
        self.types.push(kind);
        if faces.is_empty() {
            self.face_offsets.push(-1);
        } else {
            self.faces.push(faces.len() as i64);
            for face in faces {
                self.faces.push(face.len() as i64);
                self.faces.extend(face.iter().map(|&p| p as i64));
            }
            self.face_offsets.push(self.faces.len() as i64);
        }
    }

    fn write(
        &self,
        path: &Path,
        point_fields: &[Field],
        cell_fields: &[Field],
        (name, numbers): (&str, &[i64]),
    ) -> Result<(), FileError> {
        let mut text = String::from(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" \
             header_type=\"UInt64\">\n<UnstructuredGrid>\n",
        );
        let (points, cells) = (self.points.len(), self.types.len());
        text.push_str(&format!("<Piece NumberOfPoints=\"{points}\" NumberOfCells=\"{cells}\">\n<Points>\n"));
        field(&mut text, &Field::vectors("Points", &self.points));
        text.push_str("</Points>\n<Cells>\n");
        integers(&mut text, "connectivity", &self.connectivity);
        integers(&mut text, "offsets", &self.offsets);
        array(&mut text, "UInt8", "types", 1, &self.types);
        if !self.faces.is_empty() {
            integers(&mut text, "faces", &self.faces);
            integers(&mut text, "faceoffsets", &self.face_offsets);
        }
        text.push_str("</Cells>\n<PointData>\n");
        point_fields.iter().for_each(|f| field(&mut text, f));
        text.push_str("</PointData>\n<CellData>\n");
        integers(&mut text, name, numbers);
        cell_fields.iter().for_each(|f| field(&mut text, f));
        text.push_str("</CellData>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n");
        save(path, &text)
    }
}

fn field(text: &mut String, field: &Field) {
    let (components, bytes): (usize, Vec<u8>) = match field.values {
        Values::Scalars(list) => (1, list.iter().flat_map(|x| x.to_le_bytes()).collect()),
        Values::Vectors(list) => (3, list.iter().flat_map(|v| v.to_array()).flat_map(f64::to_le_bytes).collect()),
    };
    array(text, "Float64", field.name, components, &bytes);
}

fn integers(text: &mut String, name: &str, list: &[i64]) {
    array(text, "Int64", name, 1, &list.iter().flat_map(|i| i.to_le_bytes()).collect::<Vec<_>>());
}

/// One array: its length in bytes (8 bytes), then the bytes, together in base64.
fn array(text: &mut String, kind: &str, name: &str, components: usize, bytes: &[u8]) {
    let name = escaped(name);
    text.push_str(&format!(
        "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" format=\"binary\">"
    ));
    let mut all = (bytes.len() as u64).to_le_bytes().to_vec();
    all.extend_from_slice(bytes);
    base64(text, &all);
    text.push_str("</DataArray>\n");
}

fn base64(text: &mut String, bytes: &[u8]) {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    text.reserve(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let bits = group.iter().fold(0_u32, |bits, &b| bits << 8 | u32::from(b)) << (8 * (3 - group.len()));
        for i in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * i) & 63) as usize];
            text.push(if i <= group.len() { char::from(digit) } else { '=' });
        }
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
