//! A short text that differs where meshes do.

use sha2::{Digest, Sha256};

use crate::{Lists, Mesh};

impl Mesh {
    /// SHA-256, in hexadecimal digits, of the dimension, the coordinates, the vertices of the faces, the faces of the
    /// cells and the fracture of each face: meshes with the same one have the same entities under the same numbers.
    /// Names, regions and tags are left out.
    pub fn fingerprint(&self) -> String {
        let mut hash = Sha256::new();
        let mut add = |numbers: &mut dyn Iterator<Item = u64>| {
            let bytes: Vec<u8> = numbers.flat_map(u64::to_le_bytes).collect();
            hash.update((bytes.len() as u64).to_le_bytes());
            hash.update(bytes);
        };
        let data = self.data();
        add(&mut [data.dim as u64].into_iter());
        // Adding zero turns −0 into +0.
        add(&mut data.vertices.iter().flat_map(|x| x.to_array()).map(|x| (x + 0.0).to_bits()));
        let mut lists = |lists: &Lists| {
            add(&mut lists.offsets().iter().map(|&i| i as u64));
            add(&mut lists.items().iter().map(|&i| i as u64));
        };
        lists(&data.faces);
        lists(&data.cells);
        add(&mut data.face_fracture.iter().map(|fracture| fracture.map_or(0, |i| i as u64 + 1)));
        hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }
}
