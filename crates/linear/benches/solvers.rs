//! Times of analysis, factorisation, and solves on grids: `cargo bench -p linear [-- WORD]` runs
//! the cases whose name contains the word.

use std::sync::Arc;
use std::time::Instant;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::perm::PermRef;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{CholeskySymbolicParams, LltRef, SymmetricOrdering, factorize_symbolic_cholesky};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Side};
use linear::{BlockGraph, Cholesky, Forward, Method, Ordering, Par, Pattern, Scratch, SparseSymmetric, Symbolic};

/// Cells of a grid of `n` vertices along each of `dim` axes.
fn grid(n: usize, dim: usize) -> Vec<Vec<u32>> {
    let layers = if dim == 3 { n - 1 } else { 1 };
    let corners = 1usize << dim;
    let mut cells = Vec::new();
    for z in 0..layers {
        for y in 0..n - 1 {
            for x in 0..n - 1 {
                let corner = |k: usize| x + (k & 1) + n * (y + (k >> 1 & 1) + n * (z + (k >> 2)));
                cells.push((0..corners).map(|k| corner(k) as u32).collect());
            }
        }
    }
    cells
}

/// Couples all unknowns of a cell: a Laplacian for each component, their sum of divergence kind,
/// and a little mass so that no boundary condition is needed.
fn local(corners: usize, d: usize) -> Vec<f64> {
    let n = corners * d;
    let g = |i: usize| {
        let (corner, axis) = (i / d, i % d);
        if corner >> axis & 1 == 1 { 1.0 } else { -1.0 }
    };
    let mut k = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..n {
            k[i * n + j] = 0.3 * g(i) * g(j) / n as f64;
            if i % d == j % d {
                k[i * n + j] -= 1.0 / corners as f64;
            }
        }
        k[i * n + i] += 1.0 + 1e-3;
    }
    k
}

/// The shortest of several runs, seconds.
fn time(runs: usize, mut f: impl FnMut()) -> f64 {
    (0..runs)
        .map(|_| {
            let start = Instant::now();
            f();
            start.elapsed().as_secs_f64()
        })
        .fold(f64::MAX, f64::min)
}

fn case(name: &str, n: usize, dim: usize, d: usize, m: usize, method: Method) {
    let cells = grid(n, dim);
    let blocks = n.pow(dim as u32);
    let start = Instant::now();
    let graph = BlockGraph::uniform(blocks, d, &cells).unwrap();
    let t_graph = start.elapsed().as_secs_f64();
    let k = local(1 << dim, d);
    let unknowns = graph.len();
    println!("\n{name}: {unknowns} unknowns, {method:?}, graph {t_graph:.3} s");

    // Trailing: the blocks of a plane through the middle, as a fracture would have.
    let plane = (blocks / 2) as u32;
    let trailing: Vec<u32> = (plane..plane + (m / d) as u32).collect();
    for trailing in [&[][..], &trailing] {
        let start = Instant::now();
        let pattern = Arc::new(Pattern::new(&graph, &Ordering::new(&graph, method, trailing).unwrap()).unwrap());
        let t_order = start.elapsed().as_secs_f64();
        let mut a = SparseSymmetric::zeros(Arc::clone(&pattern));
        let t_assembly = time(3, || {
            a.set_zero();
            for cell in &cells {
                a.add(cell, &k).unwrap();
            }
        });
        let start = Instant::now();
        let symbolic = Arc::new(Symbolic::new(&pattern).unwrap());
        let t_symbolic = start.elapsed().as_secs_f64();
        let entries = symbolic.factor_entries();
        println!(
            "  trailing {}: order and pattern {t_order:.3} s, {} entries, assembly {t_assembly:.3} s, analysis {t_symbolic:.3} s, {:.2} M factor entries",
            pattern.trailing(),
            pattern.entries(),
            entries as f64 * 1e-6
        );
        for par in [Par::Seq, Par::rayon(2)] {
            let mut cholesky = Cholesky::new(&symbolic, &a, par).unwrap();
            let t_factor = time(1, || cholesky.refactorise(&a).unwrap());
            let mut scratch = Scratch::default();
            let mut x: Vec<f64> = (0..unknowns).map(|i| (i % 17) as f64).collect();
            cholesky.solve(&mut x, &mut scratch).unwrap();
            let t_solve = time(5, || cholesky.solve(&mut x, &mut scratch).unwrap());
            println!(
                "    {} thread(s): factor {t_factor:.3} s, solve {t_solve:.4} s: {:.2} ns/entry, {:.1} GB/s",
                par.degree(),
                t_solve / entries as f64 * 1e9,
                16e-9 * entries as f64 / t_solve
            );
            if trailing.is_empty() {
                bare(&a, par, t_factor, t_solve);
            } else {
                let mut forward = Forward::default();
                let t_forward = time(5, || {
                    cholesky.forward(&x, &mut forward, &mut scratch).unwrap();
                });
                let x_g = forward.condensed().to_vec();
                let t_backward = time(5, || {
                    (cholesky.backward(&forward, &x_g, &mut x, &mut scratch)).unwrap();
                });
                let t_schur = time(1, || drop(cholesky.schur().unwrap()));
                println!("      forward {t_forward:.4} s, backward {t_backward:.4} s, schur {t_schur:.3} s");
            }
        }
    }
}

/// The same with faer's own interface, and the time of reading the factor twice.
fn bare(a: &SparseSymmetric, par: Par, t_factor: f64, t_solve: f64) {
    let n = a.len();
    let (ptr, row) = a.pattern().lower();
    let structure = SymbolicSparseColMatRef::new_checked(n, n, ptr, None, &row);
    // faer 0.24 does not take a lower triangle with `SymmetricOrdering::Identity`.
    let identity: Vec<u32> = (0..n as u32).collect();
    let symbolic = factorize_symbolic_cholesky(
        structure,
        Side::Lower,
        SymmetricOrdering::Custom(PermRef::new_checked(&identity, &identity, n)),
        CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..Default::default()
        },
    )
    .unwrap();
    let mut values = vec![0.0; symbolic.len_val()];
    let scratch = symbolic.factorize_numeric_llt_scratch::<f64>(par, Default::default());
    let mut memory = MemBuffer::new(scratch);
    let t_bare = time(2, || {
        symbolic
            .factorize_numeric_llt(
                &mut values,
                SparseColMatRef::new(structure, a.values()),
                Side::Lower,
                LltRegularization::default(),
                par,
                MemStack::new(&mut memory),
                Default::default(),
            )
            .unwrap();
    });
    let factor = LltRef::new(&symbolic, &values);
    let mut memory = MemBuffer::new(symbolic.solve_in_place_scratch::<f64>(1, par));
    let mut x: Vec<f64> = (0..n).map(|i| (i % 17) as f64).collect();
    let t_bare_solve = time(3, || {
        let x = MatMut::from_column_major_slice_mut(&mut x, n, 1);
        factor.solve_in_place_with_conj(Conj::No, x, par, MemStack::new(&mut memory));
    });
    let t_read = time(5, || {
        let sum = if par.degree() > 1 {
            let (left, right) = values.split_at(values.len() / 2);
            let (left, right) = rayon::join(|| sum(left), || sum(right));
            left + right
        } else {
            sum(&values)
        };
        std::hint::black_box(sum);
    });
    println!(
        "      bare faer: factor {t_bare:.3} s (ratio {:.2}), solve {t_bare_solve:.4} s (ratio {:.2})",
        t_factor / t_bare,
        t_solve / t_bare_solve
    );
    println!("      reading the factor twice {:.4} s (ratio {:.2})", 2.0 * t_read, t_solve / (2.0 * t_read));
}

/// Reads all values with independent sums.
fn sum(values: &[f64]) -> f64 {
    let mut sums = [0.0; 16];
    for chunk in values.chunks_exact(16) {
        for (s, v) in sums.iter_mut().zip(chunk) {
            *s += v;
        }
    }
    sums.iter().sum()
}

fn main() {
    let word = std::env::args().skip(1).find(|a| !a.starts_with('-'));
    for (name, n, dim, d, m) in [
        ("plane, scalar", 400, 2, 1, 400),
        ("plane, elasticity", 250, 2, 2, 500),
        ("space, scalar", 40, 3, 1, 1600),
        ("space, elasticity", 24, 3, 3, 1728),
    ] {
        for method in [Method::Metis, Method::Amd] {
            if word.as_ref().is_none_or(|w| name.contains(w.as_str())) {
                case(name, n, dim, d, m, method);
            }
        }
    }
}
