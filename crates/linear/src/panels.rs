//! Triangular solves with the supernodal factor.
//!
//! A *panel* is a dense trapezoid of the factor, stored by columns: a lower triangle over
//! consecutive unknowns and the rows below it. Panels are faer's supernodes, except that one which
//! straddles the first trailing unknown is cut there in two.
//!
//! A single right-hand side is bound by reading the factor, so each entry is read once, in groups
//! of [`GROUP`] columns. Disjoint subtrees of the elimination tree are contiguous ranges of the
//! vector and are swept in parallel; large panels above them are split by rows or columns. How the
//! work is cut depends on the factor alone, so the result does not depend on the number of threads.

use faer::linalg::{matmul, triangular_solve};
use faer::prelude::{Reborrow, ReborrowMut};
use faer::sparse::linalg::cholesky::supernodal::SymbolicSupernodalCholesky;
use faer::{Accum, MatMut, MatRef, Par};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use crate::buffer::Buffer;
use crate::tiles::Triangle;

/// Multiplications per update of one panel by another from which faer's parallel kernels pay:
/// on two cores they doubled the time of plane grids (1e4 to 5e4), broke even at 1e6, and saved a
/// fifth at 2e6 and a third at 1e7.
const PARALLEL_UPDATE: f64 = 1e6;
/// Columns swept together, so that the vector is read and written once for all of them.
const GROUP: usize = 4;
/// Columns of a large panel between two parallel sections.
const STRIP: usize = 64;
/// Entries below which a parallel section costs more than it gains.
const PARALLEL_ENTRIES: usize = 1 << 16;
/// A subtree swept by one thread has at most this share of all entries …
const SUBTREE_MAX_SHARE: usize = 16;
/// … and at least this share, to be worth its own copy of the rows above.
const SUBTREE_MIN_SHARE: usize = 1024;

#[derive(Clone, Debug)]
struct Panel {
    /// First unknown of the triangle, and number of columns.
    start: usize,
    cols: usize,
    /// Rows below the triangle: a range of the rows of all supernodes, or of `Panels::cut_rows`.
    rows: std::ops::Range<usize>,
    cut: bool,
    /// Place of the first entry, and distance of columns.
    value: usize,
    stride: usize,
}

impl Panel {
    fn height(&self) -> usize {
        self.cols + self.rows.len()
    }

    /// Column `j` from its diagonal down.
    fn column<'a>(&self, factor: &'a [f64], j: usize) -> &'a [f64] {
        let begin = self.value + j * self.stride;
        &factor[begin + j..begin + self.height()]
    }

    fn view<'a>(&self, factor: &'a [f64]) -> MatRef<'a, f64> {
        let len = (self.cols - 1) * self.stride + self.height();
        MatRef::from_column_major_slice_with_stride(
            &factor[self.value..self.value + len],
            self.height(),
            self.cols,
            self.stride,
        )
    }
}

/// A subtree of leading panels: `panels` eliminates `unknowns` and touches only those and `top`.
#[derive(Clone, Debug)]
struct Subtree {
    panels: std::ops::Range<usize>,
    unknowns: std::ops::Range<usize>,
}

/// The factor's structure, in elimination order.
#[derive(Debug)]
pub(crate) struct Panels {
    supernodes: SymbolicSupernodalCholesky<u32>,
    panels: Vec<Panel>,
    /// Rows of the leading part of a supernode that was cut.
    cut_rows: Vec<u32>,
    /// Panels before this one eliminate the leading unknowns.
    leading: usize,
    /// Number of leading unknowns, and of all.
    split: usize,
    len: usize,
    subtrees: Vec<Subtree>,
    /// Unknowns outside the subtrees, and the place of each such unknown in this list.
    top: Vec<u32>,
    top_place: Vec<u32>,
    /// Panels outside the subtrees, ascending.
    top_panels: Vec<usize>,
    tallest: usize,
    threads_pay: bool,
}

/// Work space of a sweep; grows on first use.
#[derive(Clone, Debug, Default)]
pub(crate) struct Work {
    /// One column of the tallest panel per subtree.
    columns: Buffer<f64>,
    /// Contributions of each subtree to `top`, or the values there.
    above: Buffer<f64>,
}

impl Work {
    /// A buffer of some length and any content.
    fn buffer(&mut self, len: usize) -> &mut [f64] {
        grow(&mut self.columns, len);
        &mut self.columns[..len]
    }
}

fn grow(buffer: &mut Buffer<f64>, len: usize) {
    if buffer.len() < len {
        *buffer = Buffer::zeros(len);
    }
}

impl Panels {
    /// Cuts the supernodes at `split`, the number of leading unknowns.
    pub(crate) fn new(supernodes: SymbolicSupernodalCholesky<u32>, split: usize) -> Self {
        let len = supernodes.nrows();
        let mut panels: Vec<Panel> = Vec::with_capacity(supernodes.n_supernodes() + 1);
        let mut cut_rows: Vec<u32> = Vec::new();
        let mut leading = None;
        for s in 0..supernodes.n_supernodes() {
            let start = supernodes.supernode_begin()[s] as usize;
            let end = supernodes.supernode_end()[s] as usize;
            let rows_of = |s: usize| supernodes.col_ptr_for_row_idx()[s] as usize;
            let rows = rows_of(s)..rows_of(s + 1);
            let value = supernodes.col_ptr_for_val()[s] as usize;
            let stride = end - start + rows.len();
            let cut = split.clamp(start, end);
            if start < cut && cut < end {
                cut_rows.extend(cut as u32..end as u32);
                cut_rows.extend_from_slice(&supernodes.row_idx()[rows.clone()]);
                panels.push(Panel { start, cols: cut - start, rows: 0..cut_rows.len(), cut: true, value, stride });
            }
            let from = if cut < end { cut } else { start };
            if cut < end {
                leading.get_or_insert(panels.len());
            }
            let value = value + (from - start) * (stride + 1);
            panels.push(Panel { start: from, cols: end - from, rows, cut: false, value, stride });
        }
        let leading = leading.unwrap_or(panels.len());
        let tallest = panels.iter().map(Panel::height).max().unwrap_or(0);
        let mut result = Self {
            supernodes,
            panels,
            cut_rows,
            leading,
            split,
            len,
            subtrees: Vec::new(),
            top: Vec::new(),
            top_place: Vec::new(),
            top_panels: Vec::new(),
            tallest,
            threads_pay: false,
        };
        result.find_subtrees();
        result
    }

    /// What was cut.
    pub(crate) fn supernodes(&self) -> &SymbolicSupernodalCholesky<u32> {
        &self.supernodes
    }

    /// The rows below the triangle of a panel.
    fn rows(&self, panel: &Panel) -> &[u32] {
        let all = if panel.cut { &self.cut_rows } else { self.supernodes.row_idx() };
        &all[panel.rows.clone()]
    }

    fn find_subtrees(&mut self) {
        // A panel's parent holds its first row. Trailing panels are all on top.
        let mut panel_of = vec![0u32; self.len];
        for (p, panel) in self.panels.iter().enumerate() {
            panel_of[panel.start..panel.start + panel.cols].fill(p as u32);
        }
        let parent: Vec<Option<usize>> = (self.panels.iter())
            .map(|panel| self.rows(panel).first())
            .map(|row| row.map(|&row| panel_of[row as usize] as usize))
            .collect();
        self.threads_pay = self.work_per_update(&panel_of) >= PARALLEL_UPDATE;
        let mut entries: Vec<usize> = (self.panels.iter()).map(|panel| panel.height() * panel.cols).collect();
        let total: usize = entries.iter().sum();
        let mut first: Vec<usize> = (0..self.panels.len()).collect();
        for p in 0..self.panels.len() {
            if let Some(q) = parent[p] {
                entries[q] += entries[p];
                first[q] = first[q].min(first[p]);
            }
        }
        let fits = |p: usize| p < self.leading && entries[p] <= total / SUBTREE_MAX_SHARE;
        for p in 0..self.leading {
            if fits(p) && !parent[p].is_some_and(fits) && entries[p] >= total / SUBTREE_MIN_SHARE {
                let (a, b) = (&self.panels[first[p]], &self.panels[p]);
                self.subtrees.push(Subtree { panels: first[p]..p + 1, unknowns: a.start..b.start + b.cols });
            }
        }
        self.top_place = vec![0; self.len];
        let mut next = 0;
        let mut next_panel = 0;
        let end = Subtree { panels: self.panels.len()..self.panels.len(), unknowns: self.len..self.len };
        for subtree in self.subtrees.iter().chain([&end]) {
            for unknown in next..subtree.unknowns.start {
                self.top_place[unknown] = self.top.len() as u32;
                self.top.push(unknown as u32);
            }
            self.top_panels.extend(next_panel..subtree.panels.start);
            next = subtree.unknowns.end;
            next_panel = subtree.panels.end;
        }
    }

    /// Multiplications of the factorisation per update of one panel by another.
    fn work_per_update(&self, panel_of: &[u32]) -> f64 {
        let mut work = 0.0;
        let mut updates = self.panels.len();
        for panel in &self.panels {
            let (cols, height) = (panel.cols as f64, panel.height() as f64);
            work += cols * (height * (height - cols) + cols * cols / 3.0) / 2.0;
            let rows = self.rows(panel);
            let panels = rows.chunk_by(|&a, &b| panel_of[a as usize] == panel_of[b as usize]);
            updates += panels.count();
        }
        work / updates.max(1) as f64
    }

    #[cfg(test)]
    pub(crate) fn subtrees(&self) -> usize {
        self.subtrees.len()
    }

    /// The threads to factorise with, out of those offered.
    pub(crate) fn factor_par(&self, par: Par) -> Par {
        if self.threads_pay { par } else { Par::Seq }
    }

    /// Bytes of the structure.
    pub(crate) fn bytes(&self) -> usize {
        let s = &self.supernodes;
        let indices = [s.row_idx(), s.supernode_begin(), s.col_ptr_for_row_idx(), s.col_ptr_for_val()];
        size_of_val(&self.panels[..])
            + indices.iter().map(|list| size_of_val(*list)).sum::<usize>()
            + (self.cut_rows.len() + self.top_place.len() + self.top.len()) * size_of::<u32>()
            + self.top_panels.len() * size_of::<usize>()
    }

    fn resize(&self, work: &mut Work) {
        let tasks = self.subtrees.len();
        grow(&mut work.columns, (tasks + 1) * self.tallest);
        grow(&mut work.above, tasks.max(1) * self.top.len());
    }

    /// x ← L⁻¹ x for all unknowns; if only `leading`, [y_u; b_g − L21 y_u] with y_u = L11⁻¹ b_u.
    pub(crate) fn forward(&self, factor: &[f64], x: &mut [f64], leading: bool, par: Par, work: &mut Work) {
        self.resize(work);
        let Work { columns, above } = work;
        let n_top = self.top.len();
        let (column, columns) = columns.split_at_mut(self.tallest);
        let above = &mut above[..self.subtrees.len() * n_top];
        self.forward_subtrees(factor, &self.subtrees, (x, 0), columns, above, par);
        for above in above.chunks_exact(n_top.max(1)) {
            for (&unknown, a) in self.top.iter().zip(above) {
                x[unknown as usize] -= a;
            }
        }
        for &p in &self.top_panels {
            if leading && p >= self.leading {
                break;
            }
            let panel = &self.panels[p];
            let (triangle, below) = column[..panel.height()].split_at_mut(panel.cols);
            triangle.copy_from_slice(&x[panel.start..panel.start + panel.cols]);
            below.fill(0.0);
            panel.forward(factor, &mut column[..panel.height()], par);
            let (triangle, below) = column.split_at(panel.cols);
            x[panel.start..panel.start + panel.cols].copy_from_slice(triangle);
            for (&row, b) in self.rows(panel).iter().zip(below) {
                x[row as usize] += b;
            }
        }
    }

    /// Sweeps `subtrees`; `x` is the part of the vector from unknown `x.1` on.
    fn forward_subtrees(
        &self,
        factor: &[f64],
        subtrees: &[Subtree],
        x: (&mut [f64], usize),
        columns: &mut [f64],
        above: &mut [f64],
        par: Par,
    ) {
        let (x, from) = x;
        match subtrees {
            [] => {}
            [subtree] => {
                let Subtree { panels, unknowns } = subtree;
                above.fill(0.0);
                for panel in &self.panels[panels.clone()] {
                    let own = panel.start - from..panel.start - from + panel.cols;
                    let column = &mut columns[..panel.height()];
                    let (triangle, below) = column.split_at_mut(panel.cols);
                    triangle.copy_from_slice(&x[own.clone()]);
                    below.fill(0.0);
                    panel.forward(factor, column, Par::Seq);
                    let (triangle, below) = column.split_at(panel.cols);
                    x[own].copy_from_slice(triangle);
                    for (&row, b) in self.rows(panel).iter().zip(below) {
                        let row = row as usize;
                        if row < unknowns.end {
                            x[row - from] += b;
                        } else {
                            above[self.top_place[row] as usize] -= b;
                        }
                    }
                }
            }
            _ => {
                let (left, right) = subtrees.split_at(subtrees.len() / 2);
                let cut = right[0].unknowns.start;
                let (x_left, x_right) = x.split_at_mut(cut - from);
                let (c_left, c_right) = columns.split_at_mut(left.len() * self.tallest);
                let (a_left, a_right) = above.split_at_mut(left.len() * self.top.len());
                join(
                    par,
                    || self.forward_subtrees(factor, left, (x_left, from), c_left, a_left, par),
                    || self.forward_subtrees(factor, right, (x_right, cut), c_right, a_right, par),
                );
            }
        }
    }

    /// x ← L⁻ᵀ x for all unknowns; if only `leading`, x_u ← L11⁻ᵀ (x_u − L21ᵀ x_g).
    pub(crate) fn backward(&self, factor: &[f64], x: &mut [f64], leading: bool, par: Par, work: &mut Work) {
        self.resize(work);
        let Work { columns, above } = work;
        let (column, columns) = columns.split_at_mut(self.tallest);
        for &p in self.top_panels.iter().rev() {
            if leading && p >= self.leading {
                continue;
            }
            let panel = &self.panels[p];
            let own = panel.start..panel.start + panel.cols;
            let column = &mut column[..panel.height()];
            column[..panel.cols].copy_from_slice(&x[own.clone()]);
            for (&row, c) in (self.rows(panel).iter()).zip(&mut column[panel.cols..]) {
                *c = x[row as usize];
            }
            panel.backward(factor, column, par);
            x[own].copy_from_slice(&column[..panel.cols]);
        }
        let top = &mut above[..self.top.len()];
        for (&unknown, t) in self.top.iter().zip(&mut *top) {
            *t = x[unknown as usize];
        }
        self.backward_subtrees(factor, &self.subtrees, (x, 0), columns, top, par);
    }

    fn backward_subtrees(
        &self,
        factor: &[f64],
        subtrees: &[Subtree],
        x: (&mut [f64], usize),
        columns: &mut [f64],
        top: &[f64],
        par: Par,
    ) {
        let (x, from) = x;
        match subtrees {
            [] => {}
            [subtree] => {
                let Subtree { panels, unknowns } = subtree;
                for panel in self.panels[panels.clone()].iter().rev() {
                    let own = panel.start - from..panel.start - from + panel.cols;
                    let column = &mut columns[..panel.height()];
                    column[..panel.cols].copy_from_slice(&x[own.clone()]);
                    let rows = self.rows(panel).iter();
                    for (&row, c) in rows.zip(&mut column[panel.cols..]) {
                        let row = row as usize;
                        *c = if row < unknowns.end { x[row - from] } else { top[self.top_place[row] as usize] };
                    }
                    panel.backward(factor, column, Par::Seq);
                    x[own].copy_from_slice(&column[..panel.cols]);
                }
            }
            _ => {
                let (left, right) = subtrees.split_at(subtrees.len() / 2);
                let cut = right[0].unknowns.start;
                let (x_left, x_right) = x.split_at_mut(cut - from);
                let (c_left, c_right) = columns.split_at_mut(left.len() * self.tallest);
                join(
                    par,
                    || self.backward_subtrees(factor, left, (x_left, from), c_left, top, par),
                    || self.backward_subtrees(factor, right, (x_right, cut), c_right, top, par),
                );
            }
        }
    }

    /// X ← A⁻¹ X for several right-hand sides.
    pub(crate) fn solve_many(&self, factor: &[f64], mut x: MatMut<'_, f64>, par: Par, work: &mut Work) {
        let k = x.ncols();
        let buffer = work.buffer(self.tallest * k);
        for panel in &self.panels {
            let (triangle, below) = panel.view(factor).split_at_row(panel.cols);
            let mut own = x.rb_mut().subrows_mut(panel.start, panel.cols);
            triangular_solve::solve_lower_triangular_in_place(triangle, own.rb_mut(), par);
            let rows = self.rows(panel);
            let update = &mut buffer[..rows.len() * k];
            let mut update = MatMut::from_column_major_slice_mut(update, rows.len(), k);
            matmul::matmul(update.rb_mut(), Accum::Replace, below, own.rb(), 1.0, par);
            for j in 0..k {
                for (i, &row) in rows.iter().enumerate() {
                    x[(row as usize, j)] -= update[(i, j)];
                }
            }
        }
        for panel in self.panels.iter().rev() {
            let (triangle, below) = panel.view(factor).split_at_row(panel.cols);
            let rows = self.rows(panel);
            let values = &mut buffer[..rows.len() * k];
            let mut values = MatMut::from_column_major_slice_mut(values, rows.len(), k);
            for j in 0..k {
                for (i, &row) in rows.iter().enumerate() {
                    values[(i, j)] = x[(row as usize, j)];
                }
            }
            let mut own = x.rb_mut().subrows_mut(panel.start, panel.cols);
            let below = below.transpose();
            matmul::matmul(own.rb_mut(), Accum::Add, below, values.rb(), -1.0, par);
            triangular_solve::solve_upper_triangular_in_place(triangle.transpose(), own, par);
        }
    }

    /// The factor of the trailing unknowns, L22.
    pub(crate) fn trailing_factor(&self, factor: &[f64]) -> Triangle {
        let mut lower = Triangle::identity_border(self.len - self.split);
        for (column, top, below, rows) in self.trailing_columns(factor) {
            lower.set_column(column, top);
            for (&row, &v) in rows.iter().zip(below) {
                lower.set(row as usize - self.split, column, v as f32);
            }
        }
        lower
    }

    /// y += L22 L22ᵀ x, reading the factor once. Threads share the columns, in parts that the factor alone decides.
    pub(crate) fn trailing_product(&self, factor: &[f64], x: &[f64], y: &mut [f64]) {
        const PARTS: usize = 8;
        let (m, split) = (x.len(), self.split);
        let parts = if m * m / 2 > PARALLEL_ENTRIES { PARTS } else { 1 };
        // Of about equal area.
        let cut = |p: usize| (m as f64 * (1.0 - (1.0 - p as f64 / parts as f64).sqrt())).round() as usize;
        let sums: Vec<Vec<f64>> = (0..parts)
            .into_par_iter()
            .map(|p| {
                let mut sum = vec![0.0; m];
                let columns = self.trailing_columns(factor).take(cut(p + 1)).skip(cut(p));
                pulp::Arch::new().dispatch(ColumnProducts { columns, split, x, sum: &mut sum });
                sum
            })
            .collect();
        for sum in sums {
            y.iter_mut().zip(sum).for_each(|(y, s)| *y += s);
        }
    }

    /// The columns of the trailing factor: number, the entries from the diagonal to the end of the panel's triangle, those
    /// below, and the positions of the latter's rows.
    fn trailing_columns<'a>(
        &'a self,
        factor: &'a [f64],
    ) -> impl Iterator<Item = (usize, &'a [f64], &'a [f64], &'a [u32])> {
        self.panels[self.leading..].iter().flat_map(move |panel| {
            (0..panel.cols).map(move |j| {
                let (top, below) = panel.column(factor, j).split_at(panel.cols - j);
                (panel.start + j - self.split, top, below, self.rows(panel))
            })
        })
    }
}

/// What some columns of the trailing factor, and their transposes, add to a product.
struct ColumnProducts<'a, I> {
    columns: I,
    split: usize,
    x: &'a [f64],
    sum: &'a mut [f64],
}

impl<'a, I: Iterator<Item = (usize, &'a [f64], &'a [f64], &'a [u32])>> WithSimd for ColumnProducts<'_, I> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { columns, split, x, sum } = self;
        for (column, top, below, rows) in columns {
            let mut t = dot(simd, top, &x[column..][..top.len()]);
            t += rows.iter().zip(below).map(|(&row, v)| v * x[row as usize - split]).sum::<f64>();
            add_multiple(simd, t, top, &mut sum[column..][..top.len()]);
            rows.iter().zip(below).for_each(|(&row, v)| sum[row as usize - split] += t * v);
        }
    }
}

/// Σ a_i b_i.
#[inline(always)]
fn dot<S: Simd>(simd: S, a: &[f64], b: &[f64]) -> f64 {
    // Several sums, since one would wait for itself.
    const SUMS: usize = 4;
    let ((a, a_rest), (b, b_rest)) = (S::as_simd_f64s(a), S::as_simd_f64s(b));
    let mut sums = [simd.splat_f64s(0.0); SUMS];
    let (groups, others) = (a.chunks_exact(SUMS).zip(b.chunks_exact(SUMS)), a.len() / SUMS * SUMS);
    for (a, b) in groups {
        for k in 0..SUMS {
            sums[k] = simd.mul_add_e_f64s(a[k], b[k], sums[k]);
        }
    }
    for (&a, &b) in a[others..].iter().zip(&b[others..]) {
        sums[0] = simd.mul_add_e_f64s(a, b, sums[0]);
    }
    let sum = simd.add_f64s(simd.add_f64s(sums[0], sums[1]), simd.add_f64s(sums[2], sums[3]));
    simd.reduce_sum_f64s(sum) + a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f64>()
}

/// y += t a.
#[inline(always)]
fn add_multiple<S: Simd>(simd: S, t: f64, a: &[f64], y: &mut [f64]) {
    let ((a, a_rest), (y, y_rest)) = (S::as_simd_f64s(a), S::as_mut_simd_f64s(y));
    let factor = simd.splat_f64s(t);
    for (y, &a) in y.iter_mut().zip(a) {
        *y = simd.mul_add_e_f64s(a, factor, *y);
    }
    for (y, &a) in y_rest.iter_mut().zip(a_rest) {
        *y += a * t;
    }
}

impl Panel {
    /// The first `cols` entries of `x` become L⁻¹ x, the others lose L21 times that.
    fn forward(&self, factor: &[f64], x: &mut [f64], par: Par) {
        let mut j = 0;
        while j < self.cols {
            let strip = STRIP.min(self.cols - j);
            let (head, tail) = x[j..].split_at_mut(strip);
            // The triangle of the strip …
            let mut i = 0;
            while i + GROUP <= strip {
                let columns = self.group::<GROUP>(factor, j + i, 0, strip - i);
                forward_group(columns, &mut head[i..]);
                i += GROUP;
            }
            while i < strip {
                forward_group(self.group::<1>(factor, j + i, 0, strip - i), &mut head[i..]);
                i += 1;
            }
            // … and the rows below it.
            self.subtract(factor, (j, strip), 0, head, tail, par);
            j += strip;
        }
    }

    /// `tail`, which starts `skip` rows below the strip of columns `(j, strip)`, loses the strip
    /// times `head`.
    fn subtract(
        &self,
        factor: &[f64],
        (j, strip): (usize, usize),
        skip: usize,
        head: &[f64],
        tail: &mut [f64],
        par: Par,
    ) {
        if par.degree() > 1 && tail.len() * strip > PARALLEL_ENTRIES {
            let half = (tail.len() / 2).next_multiple_of(8);
            let (upper, lower) = tail.split_at_mut(half);
            join(
                par,
                || self.subtract(factor, (j, strip), skip, head, upper, par),
                || self.subtract(factor, (j, strip), skip + half, head, lower, par),
            );
            return;
        }
        let mut i = 0;
        while i + GROUP <= strip {
            let columns = self.group::<GROUP>(factor, j + i, strip - i + skip, tail.len());
            subtract_group(columns, &head[i..], tail);
            i += GROUP;
        }
        while i < strip {
            let columns = self.group::<1>(factor, j + i, strip - i + skip, tail.len());
            subtract_group(columns, &head[i..], tail);
            i += 1;
        }
    }

    /// The first `cols` entries of `x` become L11⁻ᵀ (x_u − L21ᵀ x_g).
    fn backward(&self, factor: &[f64], x: &mut [f64], par: Par) {
        let mut end = self.cols;
        while end > 0 {
            let strip = (end - 1) % STRIP + 1;
            let j = end - strip;
            let (head, tail) = x[j..].split_at_mut(strip);
            self.subtract_transposed(factor, j, strip, head, tail, par);
            let mut i = strip;
            while !i.is_multiple_of(GROUP) {
                i -= 1;
                backward_group(self.group::<1>(factor, j + i, 0, strip - i), &mut head[i..]);
            }
            while i > 0 {
                i -= GROUP;
                let columns = self.group::<GROUP>(factor, j + i, 0, strip - i);
                backward_group(columns, &mut head[i..]);
            }
            end = j;
        }
    }

    /// `head`, for the columns from `j` on, loses their transposes times `tail`, whose first row is
    /// `below` rows below the diagonal entry of column `j`.
    fn subtract_transposed(&self, factor: &[f64], j: usize, below: usize, head: &mut [f64], tail: &[f64], par: Par) {
        if par.degree() > 1 && head.len() * tail.len() > PARALLEL_ENTRIES && head.len() > GROUP {
            let half = (head.len() / 2).next_multiple_of(GROUP);
            let (left, right) = head.split_at_mut(half);
            join(
                par,
                || self.subtract_transposed(factor, j, below, left, tail, par),
                || self.subtract_transposed(factor, j + half, below - half, right, tail, par),
            );
            return;
        }
        let mut i = 0;
        while i + GROUP <= head.len() {
            let columns = self.group::<GROUP>(factor, j + i, below - i, tail.len());
            let sums = dot_group(columns, tail);
            for (h, s) in head[i..].iter_mut().zip(sums) {
                *h -= s;
            }
            i += GROUP;
        }
        while i < head.len() {
            let [sum] = dot_group(self.group::<1>(factor, j + i, below - i, tail.len()), tail);
            head[i] -= sum;
            i += 1;
        }
    }

    /// `B` columns from `j` on, `len` rows from `skip` rows below the diagonal entry of column `j`.
    fn group<'a, const B: usize>(&self, factor: &'a [f64], j: usize, skip: usize, len: usize) -> [&'a [f64]; B] {
        std::array::from_fn(|b| {
            let begin = self.value + (j + b) * self.stride + j + skip;
            &factor[begin..begin + len]
        })
    }
}

/// Forward substitution with `B` columns whose rows are those of `x`.
fn forward_group<const B: usize>(columns: [&[f64]; B], x: &mut [f64]) {
    let (head, tail) = x.split_at_mut(B);
    for b in 0..B {
        head[b] /= columns[b][b];
        for i in b + 1..B {
            head[i] -= columns[b][i] * head[b];
        }
    }
    subtract_group(columns.map(|c| &c[B..]), head, tail);
}

fn backward_group<const B: usize>(columns: [&[f64]; B], x: &mut [f64]) {
    let (head, tail) = x.split_at_mut(B);
    let sums = dot_group(columns.map(|c| &c[B..]), tail);
    for b in (0..B).rev() {
        let mut value = head[b] - sums[b];
        for i in b + 1..B {
            value -= columns[b][i] * head[i];
        }
        head[b] = value / columns[b][b];
    }
}

/// tail ← tail − columns · head.
fn subtract_group<const B: usize>(columns: [&[f64]; B], head: &[f64], tail: &mut [f64]) {
    let columns = columns.map(|c| &c[..tail.len()]);
    let factors: [f64; B] = std::array::from_fn(|b| head[b]);
    for i in 0..tail.len() {
        let mut value = tail[i];
        for b in 0..B {
            value -= columns[b][i] * factors[b];
        }
        tail[i] = value;
    }
}

/// columnsᵀ · tail.
fn dot_group<const B: usize>(columns: [&[f64]; B], tail: &[f64]) -> [f64; B] {
    // Independent sums that the compiler can keep in vector registers.
    const LANES: usize = 4;
    let columns = columns.map(|c| &c[..tail.len()]);
    let mut sums = [[0.0; LANES]; B];
    let whole = tail.len() - tail.len() % LANES;
    for i in (0..whole).step_by(LANES) {
        let t: [f64; LANES] = std::array::from_fn(|l| tail[i + l]);
        for b in 0..B {
            let c = &columns[b][i..i + LANES];
            for l in 0..LANES {
                sums[b][l] += c[l] * t[l];
            }
        }
    }
    let mut result = sums.map(|s| (s[0] + s[1]) + (s[2] + s[3]));
    for i in whole..tail.len() {
        for b in 0..B {
            result[b] += columns[b][i] * tail[i];
        }
    }
    result
}

/// Runs both, in parallel if `par` has several threads.
fn join(par: Par, a: impl FnOnce() + Send, b: impl FnOnce() + Send) {
    if par.degree() > 1 {
        rayon::join(a, b);
    } else {
        a();
        b();
    }
}
