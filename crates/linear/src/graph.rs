//! Which blocks of unknowns are coupled.

use std::ops::Range;

use crate::error::{Error, check_index, index};

/// The graph of blocks of unknowns.
///
/// Blocks are numbered from 0; block `k` holds the consecutive unknowns `unknowns(k)`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BlockGraph {
    /// First unknown of each block, and the number of unknowns.
    start: Vec<u32>,
    /// Blocks ≥ b coupled to b, ascending, b first.
    ptr: Vec<usize>,
    row: Vec<u32>,
}

impl BlockGraph {
    /// The graph of `blocks` blocks of `size` unknowns each. See [`BlockGraph::with_sizes`].
    ///
    /// # Errors
    /// Those of [`BlockGraph::with_sizes`].
    pub fn uniform<I>(blocks: usize, size: usize, cells: I) -> Result<Self, Error>
    where
        I: IntoIterator,
        I::Item: AsRef<[u32]>,
    {
        Self::with_sizes(&vec![size; blocks], cells)
    }

    /// The graph in which all blocks of a cell are coupled with each other.
    ///
    /// `sizes[k]` is the number of unknowns of block `k` (0 is allowed); `cells` yields the blocks
    /// of each cell (or of whatever else adds a dense contribution), in any order. A block is
    /// always coupled with itself.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if a cell names a block that does not exist, [`Error::TooLarge`].
    pub fn with_sizes<I>(sizes: &[usize], cells: I) -> Result<Self, Error>
    where
        I: IntoIterator,
        I::Item: AsRef<[u32]>,
    {
        let n_blocks = sizes.len();
        index(n_blocks)?;
        let mut start = Vec::with_capacity(n_blocks + 1);
        let mut n = 0usize;
        start.push(0);
        for &size in sizes {
            n = n.checked_add(size).ok_or(Error::TooLarge)?;
            start.push(index(n)?);
        }

        // Cells of each block.
        let mut cell_ptr = vec![0usize];
        let mut cell_blocks = Vec::new();
        for cell in cells {
            for &block in cell.as_ref() {
                check_index("block of a cell", block as usize, n_blocks)?;
            }
            cell_blocks.extend_from_slice(cell.as_ref());
            cell_ptr.push(cell_blocks.len());
        }
        let mut incident_ptr = vec![0usize; n_blocks + 1];
        for &block in &cell_blocks {
            incident_ptr[block as usize + 1] += 1;
        }
        for k in 0..n_blocks {
            incident_ptr[k + 1] += incident_ptr[k];
        }
        let mut incident = vec![0u32; cell_blocks.len()];
        let mut next = incident_ptr.clone();
        for cell in 0..cell_ptr.len() - 1 {
            for &block in &cell_blocks[cell_ptr[cell]..cell_ptr[cell + 1]] {
                incident[next[block as usize]] = index(cell)?;
                next[block as usize] += 1;
            }
        }

        let mut ptr = vec![0usize];
        let mut row: Vec<u32> = Vec::new();
        let mut seen_from = vec![u32::MAX; n_blocks];
        for b in 0..n_blocks as u32 {
            let begin = row.len();
            row.push(b);
            seen_from[b as usize] = b;
            let around = incident_ptr[b as usize]..incident_ptr[b as usize + 1];
            for &cell in &incident[around] {
                let cell = cell as usize;
                for &a in &cell_blocks[cell_ptr[cell]..cell_ptr[cell + 1]] {
                    if a > b && seen_from[a as usize] != b {
                        seen_from[a as usize] = b;
                        row.push(a);
                    }
                }
            }
            row[begin..].sort_unstable();
            ptr.push(row.len());
        }

        Ok(Self { start, ptr, row })
    }

    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.start[self.blocks()] as usize
    }

    /// Whether there are no unknowns.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of blocks.
    pub fn blocks(&self) -> usize {
        self.start.len() - 1
    }

    /// The unknowns of a block.
    ///
    /// # Panics
    /// If there is no such block.
    pub fn unknowns(&self, block: usize) -> Range<usize> {
        self.start[block] as usize..self.start[block + 1] as usize
    }

    /// The blocks ≥ `b` coupled to it, ascending, `b` first.
    pub(crate) fn neighbours_from(&self, b: usize) -> &[u32] {
        &self.row[self.ptr[b]..self.ptr[b + 1]]
    }
}
