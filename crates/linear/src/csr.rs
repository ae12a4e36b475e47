//! Rectangular sparse operators.

use rayon::prelude::*;

use crate::error::{Error, check_index, check_len, index};
use crate::pattern::bucket_starts;

/// A rectangular sparse matrix by rows, column indices ascending in each row.
#[derive(Clone, Debug, PartialEq)]
pub struct Csr {
    cols: usize,
    row_ptr: Vec<u32>,
    col_idx: Vec<u32>,
    values: Vec<f64>,
}

impl Csr {
    /// A `rows` × `cols` matrix from triplets (row, column, value); repeated places are summed, in
    /// the order given.
    ///
    /// # Errors
    /// [`Error::OutOfRange`], [`Error::NonFinite`], [`Error::TooLarge`].
    pub fn from_triplets(rows: usize, cols: usize, triplets: &[(u32, u32, f64)]) -> Result<Self, Error> {
        index(rows)?;
        index(cols)?;
        index(triplets.len())?;
        for &(i, j, v) in triplets {
            check_index("row", i as usize, rows)?;
            check_index("column", j as usize, cols)?;
            if !v.is_finite() {
                return Err(Error::NonFinite { row: i as usize, column: j as usize });
            }
        }
        let start = bucket_starts(rows, triplets.iter().map(|&(i, ..)| i as usize));
        let mut by_row = vec![(0, 0.0); triplets.len()];
        let mut next = start.clone();
        for &(i, j, v) in triplets {
            by_row[next[i as usize] as usize] = (j, v);
            next[i as usize] += 1;
        }
        let mut csr = Self { cols, row_ptr: vec![0], col_idx: Vec::new(), values: Vec::new() };
        for range in start.windows(2) {
            let row = &mut by_row[range[0] as usize..range[1] as usize];
            row.sort_by_key(|&(j, _)| j);
            for same in row.chunk_by(|a, b| a.0 == b.0) {
                csr.col_idx.push(same[0].0);
                csr.values.push(same.iter().map(|(_, v)| v).sum());
            }
            csr.row_ptr.push(csr.col_idx.len() as u32);
        }
        Ok(csr)
    }

    /// A matrix with `cols` columns whose rows have so many entries: `write` gives the columns, in any order and none twice,
    /// and the values of a row; threads share the rows, each with a `scratch` of its own.
    ///
    /// # Errors
    /// [`Error::OutOfRange`], [`Error::Repeated`], [`Error::NonFinite`], [`Error::TooLarge`].
    pub fn by_rows<S>(
        cols: usize,
        lengths: impl Iterator<Item = usize>,
        scratch: impl Fn() -> S + Sync,
        write: impl Fn(&mut S, usize, &mut [u32], &mut [f64]) + Sync,
    ) -> Result<Self, Error> {
        index(cols)?;
        let mut row_ptr = vec![0];
        let mut entries = 0;
        for length in lengths {
            entries += length;
            row_ptr.push(index(entries)?);
        }
        let rows = index(row_ptr.len() - 1)? as usize;
        let (mut col_idx, mut values) = (vec![0; entries], vec![0.0; entries]);
        let parts = rayon::current_num_threads();
        let mut rest = (&mut col_idx[..], &mut values[..]);
        let parts: Vec<_> = (0..parts)
            .map(|part| {
                let own = rows * part / parts..rows * (part + 1) / parts;
                let (columns, values) = std::mem::take(&mut rest);
                let until = (row_ptr[own.end] - row_ptr[own.start]) as usize;
                let (columns, values) = (columns.split_at_mut(until), values.split_at_mut(until));
                rest = (columns.1, values.1);
                (own, columns.0, values.0)
            })
            .collect();
        parts.into_par_iter().try_for_each(|(own, columns, values)| {
            let mut scratch = scratch();
            let first = row_ptr[own.start];
            for row in own {
                let range = (row_ptr[row] - first) as usize..(row_ptr[row + 1] - first) as usize;
                let (columns, values) = (&mut columns[range.clone()], &mut values[range]);
                write(&mut scratch, row, columns, values);
                if !columns.is_sorted() {
                    let mut pairs: Vec<(u32, f64)> = columns.iter().copied().zip(values.iter().copied()).collect();
                    pairs.sort_unstable_by_key(|&(j, _)| j);
                    columns.iter_mut().zip(values.iter_mut()).zip(pairs).for_each(|((j, v), pair)| (*j, *v) = pair);
                }
                if let Some(&j) = columns.last() {
                    check_index("column", j as usize, cols)?;
                }
                if let Some(pair) = columns.windows(2).find(|pair| pair[0] == pair[1]) {
                    return Err(Error::Repeated { what: "column", index: pair[0] as usize });
                }
                if let Some(k) = values.iter().position(|v| !v.is_finite()) {
                    return Err(Error::NonFinite { row, column: columns[k] as usize });
                }
            }
            Ok(())
        })?;
        Ok(Self { cols, row_ptr, col_idx, values })
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.row_ptr.len() - 1
    }

    /// Number of columns.
    pub fn cols(&self) -> usize {
        self.cols
    }

    /// Number of stored entries.
    pub fn entries(&self) -> usize {
        self.values.len()
    }

    /// The columns and values of a row.
    ///
    /// # Panics
    /// If there is no such row.
    pub fn row(&self, i: usize) -> (&[u32], &[f64]) {
        let range = self.row_ptr[i] as usize..self.row_ptr[i + 1] as usize;
        (&self.col_idx[range.clone()], &self.values[range])
    }

    /// y ← B x, with x of length `cols()` and y of length `rows()`.
    ///
    /// # Errors
    /// [`Error::Dimension`].
    pub fn mul(&self, x: &[f64], y: &mut [f64]) -> Result<(), Error> {
        check_len("y", self.rows(), y.len())?;
        y.fill(0.0);
        self.mul_add(1.0, x, y)
    }

    /// y ← y + s B x.
    ///
    /// # Errors
    /// [`Error::Dimension`].
    pub fn mul_add(&self, s: f64, x: &[f64], y: &mut [f64]) -> Result<(), Error> {
        check_len("x", self.cols, x.len())?;
        check_len("y", self.rows(), y.len())?;
        for i in 0..y.len() {
            let (cols, values) = self.row(i);
            let dot: f64 = cols.iter().zip(values).map(|(&j, v)| v * x[j as usize]).sum();
            y[i] += s * dot;
        }
        Ok(())
    }

    /// y ← Bᵀ x, with x of length `rows()` and y of length `cols()`.
    ///
    /// # Errors
    /// [`Error::Dimension`].
    pub fn mul_transpose(&self, x: &[f64], y: &mut [f64]) -> Result<(), Error> {
        check_len("y", self.cols, y.len())?;
        y.fill(0.0);
        self.mul_transpose_add(1.0, x, y)
    }

    /// y ← y + s Bᵀ x.
    ///
    /// # Errors
    /// [`Error::Dimension`].
    pub fn mul_transpose_add(&self, s: f64, x: &[f64], y: &mut [f64]) -> Result<(), Error> {
        check_len("x", self.rows(), x.len())?;
        check_len("y", self.cols, y.len())?;
        for i in 0..x.len() {
            let (cols, values) = self.row(i);
            for (&j, v) in cols.iter().zip(values) {
                y[j as usize] += s * v * x[i];
            }
        }
        Ok(())
    }
}
