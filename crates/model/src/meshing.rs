//! The mesh that a model describes.

use std::path::{Path, PathBuf};

use mesh::generate::{self, InputError, Triangles};
use mesh::{EdgeKind, Mesh, MeshData, Vec3};

use crate::check::MOST_CELLS;
use crate::document::Document;
use crate::expression::{Function, Point, Scope};
use crate::{Cells, CornerPoint, Extrude, MeshSource, ModelError, Value};

/// Reads a mesh file; with the second argument, a corner-point grid. What goes wrong begins with the file's name.
pub type ReadMesh<'a> = &'a dyn Fn(&Path, Option<&CornerPoint>) -> Result<MeshData, String>;

impl Document {
    /// Makes the mesh, and checks that the model fits it. Files are relative to `folder` and read by `read`.
    ///
    /// # Errors
    /// [`ModelError`]: what the generators, the reader or [`Mesh`] refuse, with the entry of the model; names that do not fit;
    /// contact apertures that are not positive.
    pub fn mesh(&self, folder: &Path, read: ReadMesh<'_>) -> Result<Mesh, ModelError> {
        let source = &self.model.mesh;
        let unsound = |key: &str| {
            let place = match source.file_read() {
                Some(file) if key == source.key() => folder.join(file).display().to_string(),
                _ => self.place(key),
            };
            |error| ModelError::Mesh { place, error }
        };
        // What made the present `data`.
        let mut key = source.key();
        let mut data = self.base(folder, read)?;
        let has_marks = [&source.fractures, &source.regions, &source.tags].iter().any(|marks| !marks.is_empty());
        if source.file_read().is_some() && has_marks {
            // Marks need entities that exist.
            data = Mesh::new(data).map_err(unsound(key))?.into_data();
        }
        for (name, place) in self.marks(source.fractures.iter())? {
            data.mark_fracture(&name, |x| place.holds(&Point::new(x, 0.0)));
        }
        if let Some(extrude) = &source.extrude {
            let plane = Mesh::new(data).map_err(unsound(key))?;
            let layers = extrude.layers.iter().fold(0_usize, |sum, &n| sum.saturating_add(n));
            if plane.cell_count().saturating_mul(layers) > MOST_CELLS {
                let message = format!(
                    "{layers} layers over {} cells; at most {MOST_CELLS} cells are allowed",
                    plane.cell_count()
                );
                return Err(self.invalid("mesh.extrude.layers", &message));
            }
            key = "mesh.extrude";
            data = extruded(&plane, extrude).map_err(self.refused(key))?;
        }
        let regions = self.marks(source.regions.iter())?;
        for cell in 0..data.cells.len() {
            let faces = data.cells.get(cell);
            let mean = faces.iter().map(|&f| data.face_mean(f)).sum::<Vec3>() / faces.len() as f64;
            if let Some((name, _)) = regions.iter().find(|(_, place)| place.holds(&Point::new(mean, 0.0))) {
                data.cell_region[cell] = data.region(name);
            }
        }
        if let Some(perturb) = &source.perturb {
            let still = Mesh::new(data).map_err(unsound(key))?;
            key = "mesh.perturb";
            data = generate::perturb(&still, perturb.amplitude.0, perturb.seed);
        }
        if source.cells != Cells::AsMade {
            let cells = Mesh::new(data).map_err(unsound(key))?;
            key = "mesh.cells";
            data = generate::simplices(&cells).map_err(self.refused(key))?;
            if source.cells != Cells::Simplices {
                let simplices = Mesh::new(data).map_err(unsound(key))?;
                let united = match source.cells {
                    Cells::Agglomerate(n) => generate::agglomerate(&simplices, n),
                    _ => generate::dual(&simplices),
                };
                data = united.map_err(self.refused(key))?;
            }
        }
        let tags = self.marks(source.tags.iter())?;
        let mut uses = vec![0_u32; data.faces.len()];
        data.cells.items().iter().for_each(|&f| uses[f] += 1);
        for face in (0..uses.len()).filter(|&f| uses[f] == 1 && !tags.is_empty()) {
            let mean = Point::new(data.face_mean(face), 0.0);
            if let Some((name, _)) = tags.iter().find(|(_, place)| place.holds(&mean)) {
                data.face_tag[face] = Some(data.tag(name));
            }
        }
        let mesh = Mesh::new(data).map_err(unsound(key))?;
        self.check_mesh(&mesh)?;
        Ok(mesh)
    }

    fn marks<'a>(
        &self,
        list: impl Iterator<Item = (&'a String, &'a Value)>,
    ) -> Result<Vec<(String, Function)>, ModelError> {
        list.map(|(name, value)| Ok((name.clone(), self.place_function(value)?))).collect()
    }

    fn place_function(&self, value: &Value) -> Result<Function, ModelError> {
        self.model.function(value, Scope::Place).map_err(|error| self.invalid("mesh", &error.to_string()))
    }

    fn base(&self, folder: &Path, read: ReadMesh<'_>) -> Result<MeshData, ModelError> {
        let source = &self.model.mesh;
        if let Some(b) = &source.cartesian {
            let count = |i: usize| b.cells.get(i).copied().unwrap_or(0);
            let n = [count(0), count(1), count(2)];
            let (low, high) = (b.low.vector(), b.high.vector());
            return Ok(match b.kershaw {
                None => generate::cartesian(low, high, n),
                Some(epsilon) => generate::kershaw(low, high, n, epsilon.0),
            });
        }
        if let Some(t) = &source.triangles {
            let mut triangles = Triangles::rectangle(t.low.0, t.high.0, t.size.0).growth(t.growth.0);
            for (name, line) in &t.fractures {
                let points: Vec<[f64; 2]> = line.points.iter().map(|p| p.0).collect();
                let size = line.size.or(t.fracture_size).unwrap_or(t.size);
                triangles = triangles.fracture(name, &points, size.0);
            }
            for (name, line) in &t.interfaces {
                let points: Vec<[f64; 2]> = line.points.iter().map(|p| p.0).collect();
                triangles = triangles.interface(name, &points, line.size.map(|s| s.0));
            }
            if let Some(limit) = &t.size_limit {
                let limit = self.place_function(limit)?;
                triangles = triangles.size(move |x| limit.at(&Point::new(x, 0.0)));
            }
            return triangles.build().map_err(self.refused("mesh.triangles"));
        }
        let Some(file) = source.file_read() else {
            return Err(self.invalid("mesh", "one of `box`, `triangles`, `corner_point` and `file` is required"));
        };
        let path = folder.join(file);
        read(&path, source.corner_point.as_ref()).map_err(|reason| ModelError::MeshFile { path, reason })
    }

    /// What a generator refuses, with the entry that asks for it.
    fn refused(&self, key: &str) -> impl FnOnce(InputError) -> ModelError + use<> {
        let place = self.place(key);
        |error| ModelError::Generator { place, error }
    }
}

impl MeshSource {
    /// The warp up to which a face counts as planar, see [`Mesh::warp`].
    pub fn planarity(&self) -> f64 {
        self.planarity.map_or(Mesh::PLANAR, |number| number.0)
    }

    /// The file that the mesh is read from.
    fn file_read(&self) -> Option<&PathBuf> {
        self.corner_point.as_ref().map(|grid| &grid.file).or(self.file.as_ref())
    }

    /// The entry that the mesh begins with.
    fn key(&self) -> &'static str {
        match (&self.cartesian, &self.triangles, &self.corner_point) {
            (Some(_), ..) => "mesh.box",
            (_, Some(_), _) => "mesh.triangles",
            (.., Some(_)) => "mesh.corner_point",
            _ => "mesh.file",
        }
    }
}

fn extruded(mesh: &Mesh, extrude: &Extrude) -> Result<MeshData, InputError> {
    let mut levels = Vec::new();
    for (pair, &layers) in extrude.levels.windows(2).zip(&extrude.layers) {
        let (low, high) = (pair[0].0, pair[1].0);
        levels.extend((0..layers).map(|i| low + (high - low) * i as f64 / layers as f64));
    }
    levels.extend(extrude.levels.last().map(|z| z.0));
    let middle: Vec<f64> = levels.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
    let exists = |fracture: &str, layer: usize| {
        let range = extrude.fractures.get(fracture);
        range.is_none_or(|range| range.0[0] < middle[layer] && middle[layer] < range.0[1])
    };
    generate::extrude(mesh, &levels, exists)
}

/// Distances to the tips of fractures, which expressions know as `tip_distance` and `max_tip_distance`. Where a
/// fracture ends on the boundary, bends or crosses another is no tip.
#[derive(Clone, Debug)]
pub struct TipDistances {
    /// The tips of each fracture: points in 2D (both ends the same), edges in 3D (m).
    tips: Vec<Vec<[Vec3; 2]>>,
    /// Largest distance (m) on the vertices of each fracture.
    largest: Vec<f64>,
}

impl TipDistances {
    /// Finds the tips in a mesh: the edges that are the end of a fracture and do not lie on the boundary, whether or
    /// not other fractures meet there.
    pub fn new(mesh: &Mesh) -> Self {
        let network = mesh.network();
        let count = mesh.data().fractures.len();
        let mut tips = vec![Vec::new(); count];
        for edge in (0..network.edge_count()).filter(|&e| network.edge_kind(e) != EdgeKind::Boundary) {
            let faces = network.edge_faces.get(edge);
            for &face in faces {
                let fracture = network.fracture[face];
                if faces.iter().filter(|&&f| network.fracture[f] == fracture).count() == 1 {
                    let list = network.edge_vertices.get(edge);
                    tips[fracture].push([list[0], list[list.len() - 1]].map(|v| mesh.vertices()[v]));
                }
            }
        }
        let mut distances = Self { tips, largest: vec![0.0; count] };
        for (i, &face) in network.faces.iter().enumerate() {
            let fracture = network.fracture[i];
            for &v in mesh.face_vertices(face) {
                let distance = distances.distance(fracture, mesh.vertices()[v]);
                if distance.is_finite() {
                    distances.largest[fracture] = distances.largest[fracture].max(distance);
                }
            }
        }
        distances
    }

    /// Distance (m) from x to the nearest tip of a fracture, by its number in the mesh; infinite if it has none.
    pub fn distance(&self, fracture: usize, x: Vec3) -> f64 {
        (self.tips[fracture].iter())
            .map(|&[a, b]| {
                let along = b - a;
                let length = along.length_squared();
                let t = if length > 0.0 { ((x - a).dot(along) / length).clamp(0.0, 1.0) } else { 0.0 };
                x.distance(a + t * along)
            })
            .fold(f64::INFINITY, f64::min)
    }

    /// A point (m) on a fracture, for expressions.
    pub fn point(&self, fracture: usize, x: Vec3) -> Point {
        Point {
            tip_distance: self.distance(fracture, x),
            max_tip_distance: self.largest[fracture],
            ..Point::new(x, 0.0)
        }
    }
}
