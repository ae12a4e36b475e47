//! Sparse symmetric matrices assembled from cells.
//!
//! Only the lower triangle is stored, by columns, row indices ascending, in the order of elimination. The unknowns come in
//! blocks, and the pattern couples whole blocks, so the entries that a block `a` has in the columns
//! of a block `b` form a run in each column: a single search finds the place of a dense sub-block.

use std::ops::{Deref, Range};
use std::sync::Arc;

use crate::buffer::Buffer;
use crate::error::{Error, check_index, check_len, index};
use crate::graph::BlockGraph;
use crate::ordering::Ordering;

/// The places of the entries of a symmetric matrix, in an order of elimination.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pattern {
    /// Place of each block in the order.
    place: Vec<u32>,
    /// The caller's unknown at each position.
    unknown: Vec<u32>,
    /// First position of the block at each place, and the number of unknowns.
    start: Vec<u32>,
    /// Places ≥ p coupled to p, ascending, p first; and the number of unknowns in the earlier ones of the same list.
    list_ptr: Vec<u32>,
    list: Vec<u32>,
    offset: Vec<u32>,
    /// Start of each column of the lower triangle.
    col_ptr: Vec<u32>,
    /// Number of unknowns that are not trailing.
    leading: usize,
}

impl Pattern {
    /// The pattern of a graph in an order of its blocks.
    ///
    /// # Errors
    /// [`Error::Dimension`] if the order is for another number of blocks, [`Error::TooLarge`].
    pub fn new(graph: &BlockGraph, ordering: &Ordering) -> Result<Self, Error> {
        let blocks = graph.blocks();
        check_len("ordering", blocks, ordering.blocks().len())?;
        let mut place = vec![0; blocks];
        let (mut start, mut unknown) = (vec![0], Vec::with_capacity(graph.len()));
        for (p, &block) in ordering.blocks().iter().enumerate() {
            place[block as usize] = p as u32;
            unknown.extend(graph.unknowns(block as usize).map(|u| u as u32));
            start.push(unknown.len() as u32);
        }
        let leading = start[blocks - ordering.trailing()] as usize;

        let pairs = || {
            (0..blocks).flat_map(|b| {
                let place = &place;
                graph.neighbours_from(b).iter().map(move |&a| {
                    let (p, q) = (place[a as usize], place[b]);
                    (p.min(q) as usize, p.max(q))
                })
            })
        };
        let list_ptr = bucket_starts(blocks, pairs().map(|(column, _)| column));
        let mut next = list_ptr.clone();
        let mut list = vec![0; list_ptr[blocks] as usize];
        for (column, row) in pairs() {
            list[next[column] as usize] = row;
            next[column] += 1;
        }
        let mut offset = Vec::with_capacity(list.len());
        let mut col_ptr = Vec::with_capacity(unknown.len() + 1);
        col_ptr.push(0);
        let size = |p: usize| (start[p + 1] - start[p]) as usize;
        let mut entries = 0usize;
        for p in 0..blocks {
            let own = &mut list[list_ptr[p] as usize..list_ptr[p + 1] as usize];
            own.sort_unstable();
            let mut height = 0;
            for &q in &*own {
                offset.push(index(height)?);
                height += size(q as usize);
            }
            for c in 0..size(p) {
                entries += height - c;
                col_ptr.push(index(entries)?);
            }
        }
        Ok(Self { place, unknown, start, list_ptr, list, offset, col_ptr, leading })
    }

    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.unknown.len()
    }

    /// Whether there are no unknowns.
    pub fn is_empty(&self) -> bool {
        self.unknown.is_empty()
    }

    /// Number of unknowns that are eliminated last.
    pub fn trailing(&self) -> usize {
        self.len() - self.leading
    }

    pub(crate) fn leading(&self) -> usize {
        self.leading
    }

    /// The unknown, in the caller's numbering, at each position of the order.
    pub fn unknowns(&self) -> &[u32] {
        &self.unknown
    }

    /// Number of entries of the lower triangle with the diagonal.
    pub fn entries(&self) -> usize {
        self.col_ptr.last().map_or(0, |&entries| entries as usize)
    }

    /// Column pointers (length `len() + 1`) and row positions (length `entries()`, ascending in each
    /// column) of the lower triangle, which are made anew at each call.
    pub fn lower(&self) -> (&[u32], impl Deref<Target = [u32]> + use<>) {
        let mut rows = Buffer::zeros(self.entries());
        let mut places = rows.iter_mut();
        for p in 0..self.place.len() {
            for column in self.start[p]..self.start[p + 1] {
                let lists = self.list_of(p).iter().map(|q| (self.start[*q as usize], self.start[*q as usize + 1]));
                let own = lists.flat_map(|(start, end)| start.max(column)..end);
                own.zip(&mut places).for_each(|(row, place)| *place = row);
            }
        }
        (&self.col_ptr, rows)
    }

    /// The positions of the block at a place.
    fn positions(&self, place: u32) -> Range<usize> {
        self.start[place as usize] as usize..self.start[place as usize + 1] as usize
    }

    /// The places ≥ `place` that are coupled to it.
    fn list_of(&self, place: usize) -> &[u32] {
        &self.list[self.list_ptr[place] as usize..self.list_ptr[place + 1] as usize]
    }

    /// The first entry in the columns of the blocks from a place on.
    fn first_entry(&self, place: usize) -> usize {
        self.col_ptr[self.start[place] as usize] as usize
    }

    /// The rows of a column below its diagonal, as runs of positions.
    fn runs(&self, place: usize, column: usize) -> impl Iterator<Item = Range<usize>> + '_ {
        let below = move |q: &u32| {
            let rows = self.positions(*q);
            rows.start.max(column + 1)..rows.end
        };
        self.list_of(place).iter().map(below)
    }

    /// Writes a vector in the caller's numbering by positions.
    pub(crate) fn gather(&self, x: &[f64], ordered: &mut [f64]) {
        ordered.iter_mut().zip(&self.unknown).for_each(|(o, &u)| *o = x[u as usize]);
    }

    /// Writes a vector by positions in the caller's numbering.
    pub(crate) fn spread(&self, ordered: &[f64], x: &mut [f64]) {
        ordered.iter().zip(&self.unknown).for_each(|(&o, &u)| x[u as usize] = o);
    }

    /// Bytes of the structure.
    pub(crate) fn bytes(&self) -> usize {
        let arrays = [&self.place, &self.unknown, &self.start, &self.list_ptr, &self.list, &self.offset, &self.col_ptr];
        arrays.iter().map(|array| size_of_val(&array[..])).sum()
    }
}

/// Where each of some buckets starts in a list sorted by them, and the list's length: `of` is the bucket of each item.
pub(crate) fn bucket_starts(buckets: usize, of: impl Iterator<Item = usize>) -> Vec<u32> {
    let mut start = vec![0; buckets + 1];
    of.for_each(|bucket| start[bucket + 1] += 1);
    for bucket in 0..buckets {
        start[bucket + 1] += start[bucket];
    }
    start
}

/// Some columns of a [`SparseSymmetric`] that is being assembled.
#[derive(Debug)]
pub struct Columns<'a> {
    pattern: &'a Pattern,
    places: Range<usize>,
    /// Number of the first value.
    first: usize,
    values: &'a mut [f64],
    /// The blocks of a cell: place, first position, and rows of the local matrix.
    cell: Vec<(u32, usize, Range<usize>)>,
}

impl Columns<'_> {
    /// Whether [`add`](Self::add) for these blocks would change anything here.
    ///
    /// # Panics
    /// If there is no such block.
    pub fn concern(&self, blocks: &[u32]) -> bool {
        blocks.iter().any(|&b| self.places.contains(&(self.pattern.place[b as usize] as usize)))
    }

    /// Adds the part in these columns of the dense symmetric contribution of a cell.
    ///
    /// `local` is a symmetric matrix over the unknowns of `blocks`, in the order of that list; one triangle is read. A block
    /// may occur twice, its contributions are then all added.
    ///
    /// # Errors
    /// [`Error::Dimension`], [`Error::OutOfRange`], or [`Error::NotInPattern`]; earlier sub-blocks
    /// of the same call may then have been added.
    pub fn add(&mut self, blocks: &[u32], local: &[f64]) -> Result<(), Error> {
        let Self { pattern, places, first, values, cell } = self;
        cell.clear();
        let mut width = 0;
        for &block in blocks {
            check_index("block", block as usize, pattern.place.len())?;
            let place = pattern.place[block as usize];
            let positions = pattern.positions(place);
            cell.push((place, positions.start, width..width + positions.len()));
            width += positions.len();
        }
        check_len("local matrix", width * width, local.len())?;
        for (b, (p, position, columns)) in cell.iter().enumerate() {
            if !places.contains(&(*p as usize)) {
                continue;
            }
            let (begin, list) = (pattern.list_ptr[*p as usize] as usize, pattern.list_of(*p as usize));
            for (a, (q, _, rows)) in cell.iter().enumerate().filter(|(_, (q, ..))| q >= p) {
                let Ok(found) = list.binary_search(q) else {
                    let [a, b] = [blocks[a] as usize, blocks[b] as usize];
                    return Err(Error::NotInPattern { row: a.max(b), column: a.min(b) });
                };
                let offset = pattern.offset[begin + found] as usize;
                for (c, column) in columns.clone().enumerate() {
                    // Within the diagonal block, column c starts at its own row.
                    let skip = if p == q { c } else { 0 };
                    let start = pattern.col_ptr[position + c] as usize + offset + skip - c - *first;
                    let add = &local[column * width + rows.start + skip..column * width + rows.end];
                    values[start..start + add.len()].iter_mut().zip(add).for_each(|(value, add)| *value += add);
                }
            }
        }
        Ok(())
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

    /// Adds the dense symmetric contribution of a cell. See [`Columns::add`].
    ///
    /// # Errors
    /// As there.
    pub fn add(&mut self, blocks: &[u32], local: &[f64]) -> Result<(), Error> {
        let places = 0..self.pattern.place.len();
        Columns { pattern: &self.pattern, places, first: 0, values: &mut self.values, cell: Vec::new() }
            .add(blocks, local)
    }

    /// The columns in so many parts of about as many entries, for threads to fill: if each adds all cells that
    /// [concern](Columns::concern) its part, in the same order, then the sums do not depend on their number.
    pub fn columns(&mut self, parts: usize) -> Vec<Columns<'_>> {
        let pattern = &*self.pattern;
        let blocks = pattern.place.len();
        let mut rest = &mut self.values[..];
        let (mut start, mut first) = (0, 0);
        (1..=parts)
            .map(|part| {
                let wanted = pattern.entries() * part / parts;
                let mut end = start;
                // Blocks without unknowns at the end belong to the last part.
                while end < blocks && (part == parts || pattern.first_entry(end) < wanted) {
                    end += 1;
                }
                let until = pattern.first_entry(end);
                let (values, after) = std::mem::take(&mut rest).split_at_mut(until - first);
                let columns = Columns { pattern, places: start..end, first, values, cell: Vec::new() };
                (rest, start, first) = (after, end, until);
                columns
            })
            .collect()
    }

    /// y ← A x, both of length `len()`, in the caller's numbering.
    ///
    /// # Errors
    /// [`Error::Dimension`].
    pub fn mul(&self, x: &[f64], y: &mut [f64]) -> Result<(), Error> {
        check_len("x", self.len(), x.len())?;
        check_len("y", self.len(), y.len())?;
        let (mut ordered, mut product) = (vec![0.0; x.len()], vec![0.0; x.len()]);
        self.pattern.gather(x, &mut ordered);
        self.mul_ordered(&ordered, &mut product);
        self.pattern.spread(&product, y);
        Ok(())
    }

    /// y ← A x by positions.
    pub(crate) fn mul_ordered(&self, x: &[f64], y: &mut [f64]) {
        y.fill(0.0);
        self.for_each_column(|column, mut values, runs| {
            let mut sum = values[0] * x[column];
            values = &values[1..];
            for rows in runs {
                let (own, rest) = values.split_at(rows.len());
                values = rest;
                for ((a, xi), yi) in own.iter().zip(&x[rows.clone()]).zip(&mut y[rows]) {
                    *yi += a * x[column];
                    sum += a * xi;
                }
            }
            y[column] += sum;
        });
    }

    /// The largest sum of absolute values in a row, ‖A‖ in the maximum norm.
    pub fn norm(&self) -> f64 {
        let mut sums = vec![0.0; self.len()];
        self.for_each_column(|column, mut values, runs| {
            sums[column] += values.iter().map(|a| a.abs()).sum::<f64>();
            values = &values[1..];
            for rows in runs {
                let (own, rest) = values.split_at(rows.len());
                values = rest;
                own.iter().zip(&mut sums[rows]).for_each(|(a, s)| *s += a.abs());
            }
        });
        sums.into_iter().fold(0.0, f64::max)
    }

    /// Calls `act` with each column, its values, the diagonal first, and the runs of its other rows.
    fn for_each_column<'a>(&'a self, mut act: impl FnMut(usize, &'a [f64], &mut dyn Iterator<Item = Range<usize>>)) {
        let pattern = &*self.pattern;
        for place in 0..pattern.place.len() {
            for column in pattern.positions(place as u32) {
                let entries = pattern.col_ptr[column] as usize..pattern.col_ptr[column + 1] as usize;
                act(column, &self.values[entries], &mut pattern.runs(place, column));
            }
        }
    }

    /// The place of the first infinite or undefined entry, in the caller's numbering, as an error.
    pub(crate) fn check_finite(&self) -> Result<(), Error> {
        let Some(k) = self.values.iter().position(|v| !v.is_finite()) else {
            return Ok(());
        };
        let (col_ptr, rows) = self.pattern.lower();
        let column = col_ptr.partition_point(|&p| p as usize <= k) - 1;
        let [i, j] = [rows[k] as usize, column].map(|position| self.pattern.unknown[position] as usize);
        Err(Error::NonFinite { row: i.max(j), column: i.min(j) })
    }
}
