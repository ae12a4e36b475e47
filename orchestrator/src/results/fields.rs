//! Fields for ParaView: a series of files for the cells and one for the fracture faces.

use std::path::Path;

use mesh::{Mesh, Vec3, tangents};
use mesh_io::{Field, write_fracture_vtu, write_pvd, write_vtu};

use super::{Array, ResultsError, Shape, Snapshot, files};

pub(crate) const FOLDER: &str = "fields";

/// The files written so far.
#[derive(Debug, Default)]
pub(crate) struct Fields {
    matrix: Vec<(f64, String)>,
    fractures: Vec<(f64, String)>,
}

impl Fields {
    /// Writes the arrays of a snapshot, if it has any, and the lists of all files.
    pub(crate) fn write(
        &mut self,
        folder: &Path,
        mesh: &Mesh,
        number: usize,
        snapshot: &Snapshot,
    ) -> Result<(), ResultsError> {
        if snapshot.arrays.is_empty() {
            return Ok(());
        }
        let folder = folder.join(FOLDER);
        let name = |kind: &str| format!("{kind}-{number:06}.vtu");
        let on_cells = |wanted: bool| -> Vec<Parts> {
            let arrays = snapshot.arrays.iter().filter(|array| array.shape.is_on_cells() == wanted);
            arrays.map(|array| Parts::new(mesh, array)).collect()
        };
        let cells = on_cells(true);
        let cells: Vec<Field> = cells.iter().flat_map(Parts::fields).collect();
        write_vtu(folder.join(name("matrix")), mesh, &[], &cells)?;
        self.matrix.push((snapshot.time, name("matrix")));
        write_pvd(folder.join("matrix.pvd"), &self.matrix)?;
        if mesh.network().face_count() > 0 {
            let parts = on_cells(false);
            let fields: Vec<Field> = parts.iter().flat_map(Parts::fields).collect();
            write_fracture_vtu(folder.join(name("fractures")), mesh, &fields)?;
            self.fractures.push((snapshot.time, name("fractures")));
            write_pvd(folder.join("fractures.pvd"), &self.fractures)?;
        }
        Ok(())
    }

    /// Removes the files of other time steps.
    pub(crate) fn remove_others(&self, folder: &Path) -> Result<(), ResultsError> {
        let mine = |name: &str| self.matrix.iter().chain(&self.fractures).any(|(_, file)| file == name);
        files::remove(&folder.join(FOLDER), |name| {
            name.ends_with(files::PART) || (name.ends_with(".vtu") && !mine(name))
        })
    }
}

/// An array as ParaView shows it best: vectors in space, and those on fracture faces also as `.normal` and `.tangential`,
/// their part along n⁺ and the length of the rest.
pub(crate) struct Parts<'a> {
    array: &'a Array,
    vectors: Vec<Vec3>,
    names: [String; 2],
    values: [Vec<f64>; 2],
}

impl<'a> Parts<'a> {
    pub(crate) fn new(mesh: &Mesh, array: &'a Array) -> Self {
        let names = ["normal", "tangential"].map(|part| format!("{}.{part}", array.name));
        let mut parts = Self { array, vectors: Vec::new(), names, values: [Vec::new(), Vec::new()] };
        if array.shape == Shape::CellVectors {
            let vector = |v: &[f64]| Vec3::new(v[0], v[1], v.get(2).copied().unwrap_or(0.0));
            parts.vectors = array.values.chunks_exact(mesh.dim()).map(vector).collect();
        }
        if array.shape == Shape::FractureVectors {
            for (&face, v) in mesh.network().faces.iter().zip(array.values.chunks_exact(mesh.dim())) {
                let n = mesh.geometry().face_normal(face);
                let tangential: Vec3 = v[1..].iter().zip(tangents(mesh.dim(), n)).map(|(&v, t)| v * t).sum();
                parts.vectors.push(v[0] * n + tangential);
                parts.values[0].push(v[0]);
                parts.values[1].push(tangential.length());
            }
        }
        parts
    }

    #[cfg(test)]
    pub(crate) fn vectors(&self) -> &[Vec3] {
        &self.vectors
    }

    fn fields(&self) -> Vec<Field<'_>> {
        let name = &self.array.name;
        match self.array.shape {
            Shape::Cells | Shape::FractureFaces => vec![Field::scalars(name, &self.array.values)],
            Shape::CellVectors => vec![Field::vectors(name, &self.vectors)],
            Shape::FractureVectors => {
                let parts = self.names.iter().zip(&self.values).map(|(name, values)| Field::scalars(name, values));
                [Field::vectors(name, &self.vectors)].into_iter().chain(parts).collect()
            }
        }
    }
}
