//! Rectangular sparse operators.

use crate::error::{Error, check_index, check_len, index};

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
        let mut by_row = vec![Vec::new(); rows];
        for &(i, j, v) in triplets {
            check_index("row", i as usize, rows)?;
            by_row[i as usize].push((j, v));
        }
        let mut csr = Self::empty(cols)?;
        by_row.into_iter().try_for_each(|row| csr.push_row(row))?;
        csr.shrink();
        Ok(csr)
    }

    /// A matrix with `cols` columns and no rows yet.
    ///
    /// # Errors
    /// [`Error::TooLarge`].
    pub fn empty(cols: usize) -> Result<Self, Error> {
        index(cols)?;
        Ok(Self { cols, row_ptr: vec![0], col_idx: Vec::new(), values: Vec::new() })
    }

    /// Appends a row of (column, value) in any order, the quicker if columns ascend; repeated places are summed, in the
    /// order given.
    ///
    /// # Errors
    /// [`Error::OutOfRange`], [`Error::NonFinite`], [`Error::TooLarge`]. The matrix must then not be used.
    pub fn push_row(&mut self, entries: impl IntoIterator<Item = (u32, f64)>) -> Result<(), Error> {
        let start = self.col_idx.len();
        for (j, v) in entries {
            check_index("column", j as usize, self.cols)?;
            if !v.is_finite() {
                return Err(Error::NonFinite { row: self.rows(), column: j as usize });
            }
            self.col_idx.push(j);
            self.values.push(v);
        }
        if !self.col_idx[start..].is_sorted_by(|a, b| a < b) {
            let columns = self.col_idx.drain(start..);
            let mut row: Vec<(u32, f64)> = columns.zip(self.values.drain(start..)).collect();
            row.sort_by_key(|&(j, _)| j);
            for (j, v) in row {
                if self.col_idx.len() > start && self.col_idx.last() == Some(&j) {
                    self.values.last_mut().into_iter().for_each(|sum| *sum += v);
                } else {
                    self.col_idx.push(j);
                    self.values.push(v);
                }
            }
        }
        index(self.row_ptr.len())?;
        self.row_ptr.push(index(self.col_idx.len())?);
        Ok(())
    }

    /// Appends the rows of a matrix with as many columns.
    ///
    /// # Errors
    /// [`Error::Dimension`], [`Error::TooLarge`].
    pub fn append(&mut self, other: &Self) -> Result<(), Error> {
        check_len("columns", self.cols, other.cols)?;
        let entries = self.col_idx.len();
        index(self.row_ptr.len() + other.rows())?;
        index(entries + other.col_idx.len())?;
        self.row_ptr.extend(other.row_ptr[1..].iter().map(|&end| entries as u32 + end));
        self.col_idx.extend_from_slice(&other.col_idx);
        self.values.extend_from_slice(&other.values);
        Ok(())
    }

    /// Forgets the rows and keeps the memory.
    pub fn clear(&mut self) {
        self.row_ptr.truncate(1);
        self.col_idx.clear();
        self.values.clear();
    }

    /// Makes room for further rows and entries.
    pub fn reserve(&mut self, rows: usize, entries: usize) {
        self.row_ptr.reserve_exact(rows);
        self.col_idx.reserve_exact(entries);
        self.values.reserve_exact(entries);
    }

    /// Gives back the memory that further rows would take.
    pub fn shrink(&mut self) {
        self.row_ptr.shrink_to_fit();
        self.col_idx.shrink_to_fit();
        self.values.shrink_to_fit();
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
