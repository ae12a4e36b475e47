//! Sparse symmetric matrices assembled from cells.
//!
//! Only the lower triangle is stored, by columns, row indices ascending. The unknowns come in
//! blocks, and the pattern couples whole blocks, so the entries that a block `a` has in the columns
//! of a block `b` form a run in each column: a single search finds the place of a dense sub-block.

use std::sync::Arc;

use rayon::prelude::*;

use crate::error::{Error, check_index, check_len, index};

/// Which unknowns of a symmetric matrix are coupled.
///
/// Blocks are numbered from 0; block `k` holds the consecutive unknowns `unknowns(k)`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pattern {
    /// First unknown of each block, and the number of unknowns.
    pub(crate) block_start: Vec<u32>,
    /// Blocks ≥ b coupled to b, ascending, b first.
    pub(crate) block_ptr: Vec<usize>,
    pub(crate) block_row: Vec<u32>,
    /// Number of unknowns in the earlier blocks of the same list.
    offset: Vec<u32>,
    /// Scalar lower triangle by columns.
    pub(crate) col_ptr: Vec<u32>,
    pub(crate) row_idx: Vec<u32>,
}

impl Pattern {
    /// The pattern of `blocks` blocks of `size` unknowns each. See [`Pattern::with_sizes`].
    ///
    /// # Errors
    /// Those of [`Pattern::with_sizes`].
    pub fn uniform<I>(blocks: usize, size: usize, cells: I) -> Result<Self, Error>
    where
        I: IntoIterator,
        I::Item: AsRef<[u32]>,
    {
        Self::with_sizes(&vec![size; blocks], cells)
    }

    /// The pattern in which all blocks of a cell are coupled with each other.
    ///
    /// `sizes[k]` is the number of unknowns of block `k` (0 is allowed); `cells` yields the blocks
    /// of each cell (or of whatever else adds a dense contribution), in any order. The diagonal is
    /// always part of the pattern.
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
        let mut block_start = Vec::with_capacity(n_blocks + 1);
        let mut n = 0usize;
        block_start.push(0);
        for &size in sizes {
            n = n.checked_add(size).ok_or(Error::TooLarge)?;
            block_start.push(index(n)?);
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

        let mut block_ptr = vec![0usize];
        let mut block_row: Vec<u32> = Vec::new();
        let mut seen_from = vec![u32::MAX; n_blocks];
        for b in 0..n_blocks as u32 {
            let begin = block_row.len();
            block_row.push(b);
            seen_from[b as usize] = b;
            let around = incident_ptr[b as usize]..incident_ptr[b as usize + 1];
            for &cell in &incident[around] {
                let cell = cell as usize;
                for &a in &cell_blocks[cell_ptr[cell]..cell_ptr[cell + 1]] {
                    if a > b && seen_from[a as usize] != b {
                        seen_from[a as usize] = b;
                        block_row.push(a);
                    }
                }
            }
            block_row[begin..].sort_unstable();
            block_ptr.push(block_row.len());
        }

        let mut offset = Vec::with_capacity(block_row.len());
        let mut nnz = 0usize;
        for b in 0..n_blocks {
            let mut height = 0usize;
            for &a in &block_row[block_ptr[b]..block_ptr[b + 1]] {
                offset.push(index(height)?);
                height += sizes[a as usize];
            }
            nnz += (0..sizes[b]).map(|c| height - c).sum::<usize>();
            index(nnz)?;
        }
        let mut col_ptr = Vec::with_capacity(n + 1);
        let mut row_idx = Vec::with_capacity(nnz);
        col_ptr.push(0);
        for b in 0..n_blocks {
            for column in block_start[b]..block_start[b + 1] {
                for &a in &block_row[block_ptr[b]..block_ptr[b + 1]] {
                    let begin = block_start[a as usize].max(column);
                    row_idx.extend(begin..block_start[a as usize + 1]);
                }
                col_ptr.push(row_idx.len() as u32);
            }
        }
        Ok(Self { block_start, block_ptr, block_row, offset, col_ptr, row_idx })
    }

    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.col_ptr.len() - 1
    }

    /// Whether there are no unknowns.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of blocks.
    pub fn blocks(&self) -> usize {
        self.block_start.len() - 1
    }

    /// The unknowns of a block.
    ///
    /// # Panics
    /// If there is no such block.
    pub fn unknowns(&self, block: usize) -> std::ops::Range<usize> {
        self.block_start[block] as usize..self.block_start[block + 1] as usize
    }

    /// Number of entries of the lower triangle with the diagonal.
    pub fn entries(&self) -> usize {
        self.row_idx.len()
    }

    /// Column pointers (length `len() + 1`) and row indices (length `entries()`, ascending in each
    /// column) of the lower triangle.
    pub fn lower(&self) -> (&[u32], &[u32]) {
        (&self.col_ptr, &self.row_idx)
    }

    /// Adds the contribution of a cell to the columns of some consecutive blocks, whose entries are `values`.
    fn scatter(
        &self,
        columns: std::ops::Range<usize>,
        values: &mut [f64],
        blocks: &[u32],
        local: &[f64],
    ) -> Result<(), Error> {
        let mut width = 0;
        for &block in blocks {
            check_index("block", block as usize, self.blocks())?;
            width += self.unknowns(block as usize).len();
        }
        check_len("local matrix", width * width, local.len())?;
        let first = self.col_ptr[self.block_start[columns.start] as usize] as usize;
        let mut at_column = 0;
        for &b in blocks {
            let own = self.unknowns(b as usize);
            if !columns.contains(&(b as usize)) {
                at_column += own.len();
                continue;
            }
            let begin = self.block_ptr[b as usize];
            let list = self.rows_of_block(b as usize);
            let mut at_row = 0;
            for &a in blocks {
                let rows = self.unknowns(a as usize);
                if a >= b {
                    let place = list
                        .binary_search(&a)
                        .map_err(|_| Error::NotInPattern { row: a as usize, column: b as usize })?;
                    let offset = self.offset[begin + place] as usize;
                    for c in 0..own.len() {
                        // Within the diagonal block, column c starts at its own row.
                        let skip = if a == b { c } else { 0 };
                        let start = self.col_ptr[own.start + c] as usize + offset + skip - c - first;
                        let values = &mut values[start..start + rows.len() - skip];
                        let from = (at_column + c) * width + at_row + skip;
                        for (value, add) in values.iter_mut().zip(&local[from..from + rows.len() - skip]) {
                            *value += add;
                        }
                    }
                }
                at_row += rows.len();
            }
            at_column += own.len();
        }
        Ok(())
    }

    /// The block neighbours ≥ `b`, `b` first.
    pub(crate) fn rows_of_block(&self, b: usize) -> &[u32] {
        &self.block_row[self.block_ptr[b]..self.block_ptr[b + 1]]
    }
}

/// Dense symmetric contributions of cells, one behind the other.
#[derive(Clone, Debug, Default)]
pub struct CellMatrices {
    blocks: Vec<u32>,
    values: Vec<f64>,
    /// Ends of each cell's blocks and values.
    ends: Vec<(usize, usize)>,
}

impl CellMatrices {
    /// Forgets the cells and keeps the memory.
    pub fn clear(&mut self) {
        self.blocks.clear();
        self.values.clear();
        self.ends.clear();
    }

    /// Appends a cell, as [`SparseSymmetric::add`] takes it.
    pub fn push(&mut self, blocks: impl IntoIterator<Item = u32>, local: impl IntoIterator<Item = f64>) {
        self.blocks.extend(blocks);
        self.values.extend(local);
        self.ends.push((self.blocks.len(), self.values.len()));
    }

    fn iter(&self) -> impl Iterator<Item = (&[u32], &[f64])> {
        let starts = std::iter::once(&(0, 0)).chain(&self.ends);
        starts.zip(&self.ends).map(|(a, b)| (&self.blocks[a.0..b.0], &self.values[a.1..b.1]))
    }
}

/// A sparse symmetric matrix: values on a shared [`Pattern`], lower triangle by columns.
#[derive(Clone, Debug)]
pub struct SparseSymmetric {
    pattern: Arc<Pattern>,
    values: Vec<f64>,
}

impl SparseSymmetric {
    /// The zero matrix on a pattern.
    pub fn zeros(pattern: Arc<Pattern>) -> Self {
        let values = vec![0.0; pattern.entries()];
        Self { pattern, values }
    }

    /// The pattern.
    pub fn pattern(&self) -> &Arc<Pattern> {
        &self.pattern
    }

    /// Number of rows and columns.
    pub fn len(&self) -> usize {
        self.pattern.len()
    }

    /// Whether there are no unknowns.
    pub fn is_empty(&self) -> bool {
        self.pattern.is_empty()
    }

    /// The stored values, in the order of [`Pattern::lower`].
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The stored values, in the order of [`Pattern::lower`].
    pub fn values_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    /// Sets all values to zero and keeps the pattern.
    pub fn set_zero(&mut self) {
        self.values.fill(0.0);
    }

    /// Adds the dense symmetric contribution of a cell.
    ///
    /// `local` is a square matrix by rows over the unknowns of `blocks`, in the order of that list.
    /// Only one triangle per pair of unknowns is read: the one whose column is the larger global
    /// unknown. A block may occur twice, its contributions are then all added.
    ///
    /// # Errors
    /// [`Error::Dimension`], [`Error::OutOfRange`], or [`Error::NotInPattern`]; earlier sub-blocks
    /// of the same call may then have been added.
    pub fn add(&mut self, blocks: &[u32], local: &[f64]) -> Result<(), Error> {
        self.pattern.scatter(0..self.pattern.blocks(), &mut self.values, blocks, local)
    }

    /// Adds the contributions of many cells, in the order given, as [`SparseSymmetric::add`] does one by one. Threads share
    /// the columns, so the sums do not depend on their number.
    ///
    /// # Errors
    /// Those of [`SparseSymmetric::add`]; some of the contributions may then have been added.
    pub fn add_cells(&mut self, parts: &[&CellMatrices]) -> Result<(), Error> {
        let pattern = &*self.pattern;
        let shares = rayon::current_num_threads();
        let mut pieces = Vec::with_capacity(shares);
        let mut rest = &mut self.values[..];
        let (mut first, mut begin) = (0, 0);
        for share in 1..=shares {
            let entry = (pattern.entries() * share / shares) as u32;
            let start = |b: usize| pattern.col_ptr[pattern.block_start[b] as usize];
            let mut end = first;
            while end < pattern.blocks() && start(end) < entry {
                end += 1;
            }
            // Blocks without unknowns at the end belong to the last share.
            if share == shares {
                end = pattern.blocks();
            }
            let until = start(end) as usize;
            let (own, after) = std::mem::take(&mut rest).split_at_mut(until - begin);
            pieces.push((first..end, own));
            (rest, first, begin) = (after, end, until);
        }
        (pieces.into_par_iter())
            .map(|(columns, values)| {
                parts.iter().try_for_each(|part| {
                    part.iter().try_for_each(|(blocks, local)| pattern.scatter(columns.clone(), values, blocks, local))
                })
            })
            .collect()
    }

    /// y ← A x, both of length `len()`.
    ///
    /// # Errors
    /// [`Error::Dimension`].
    pub fn mul(&self, x: &[f64], y: &mut [f64]) -> Result<(), Error> {
        check_len("x", self.len(), x.len())?;
        check_len("y", self.len(), y.len())?;
        y.fill(0.0);
        let (col_ptr, row_idx) = self.pattern.lower();
        for j in 0..x.len() {
            let range = col_ptr[j] as usize..col_ptr[j + 1] as usize;
            let (rows, values) = (&row_idx[range.clone()], &self.values[range]);
            // The diagonal is the first entry of a column.
            let mut sum = values[0] * x[j];
            for (&i, &a) in rows.iter().zip(values).skip(1) {
                y[i as usize] += a * x[j];
                sum += a * x[i as usize];
            }
            y[j] += sum;
        }
        Ok(())
    }

    /// The largest sum of absolute values in a row, ‖A‖ in the maximum norm.
    pub fn norm(&self) -> f64 {
        let (col_ptr, row_idx) = self.pattern.lower();
        let mut sums = vec![0.0; self.len()];
        for j in 0..self.len() {
            for k in col_ptr[j] as usize..col_ptr[j + 1] as usize {
                let i = row_idx[k] as usize;
                sums[i] += self.values[k].abs();
                if i != j {
                    sums[j] += self.values[k].abs();
                }
            }
        }
        sums.into_iter().fold(0.0, f64::max)
    }

    /// The position of the first infinite or undefined entry, as an error.
    pub(crate) fn check_finite(&self) -> Result<(), Error> {
        let Some(k) = self.values.iter().position(|v| !v.is_finite()) else {
            return Ok(());
        };
        let (col_ptr, row_idx) = self.pattern.lower();
        Err(Error::NonFinite { row: row_idx[k] as usize, column: col_ptr.partition_point(|&p| p as usize <= k) - 1 })
    }
}
