//! Rectangular sparse operators.

use crate::error::{Error, check_index, check_len, index};

/// A rectangular sparse matrix by rows, column indices ascending in each row.
#[derive(Clone, Debug, PartialEq)]
pub struct Csr {
    cols: usize,
    row_ptr: Vec<usize>,
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
        Self::from_rows(cols, by_row)
    }

    /// A matrix with `cols` columns from its rows, each a list of (column, value) in any order; repeated places are
    /// summed, in the order given.
    ///
    /// # Errors
    /// [`Error::OutOfRange`], [`Error::NonFinite`], [`Error::TooLarge`].
    pub fn from_rows<R>(cols: usize, rows: impl IntoIterator<Item = R>) -> Result<Self, Error>
    where
        R: IntoIterator<Item = (u32, f64)>,
    {
        index(cols)?;
        let mut csr = Self { cols, row_ptr: vec![0], col_idx: Vec::new(), values: Vec::new() };
        let mut row = Vec::new();
        for (i, entries) in rows.into_iter().enumerate() {
            row.clear();
            row.extend(entries);
            row.sort_by_key(|&(j, _)| j);
            let start = csr.col_idx.len();
            for &(j, v) in &row {
                check_index("column", j as usize, cols)?;
                if !v.is_finite() {
                    return Err(Error::NonFinite { row: i, column: j as usize });
                }
                if csr.col_idx.len() > start && csr.col_idx.last() == Some(&j) {
                    csr.values.last_mut().into_iter().for_each(|sum| *sum += v);
                } else {
                    csr.col_idx.push(j);
                    csr.values.push(v);
                }
            }
            csr.row_ptr.push(csr.col_idx.len());
        }
        index(csr.row_ptr.len() - 1)?;
        Ok(csr)
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
        let range = self.row_ptr[i]..self.row_ptr[i + 1];
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
