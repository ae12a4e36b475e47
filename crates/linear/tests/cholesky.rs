//! The factorisation against dense linear algebra.

mod common;

use std::sync::Arc;

use common::{Random, assemble, grid};
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use linear::{
    Cholesky, Error, Forward, Method, Ordering, Par, Pattern, Scratch, SparseSymmetric, Symbolic,
};

const METHODS: [Method; 2] = [Method::Metis, Method::Amd];

fn symbolic(pattern: &Arc<Pattern>, method: Method, trailing: &[u32]) -> Arc<Symbolic> {
    let ordering = Ordering::new(pattern, method, trailing).unwrap();
    Arc::new(Symbolic::new(pattern, ordering).unwrap())
}

fn dense_solve(a: &Mat<f64>, b: &Mat<f64>) -> Mat<f64> {
    a.llt(Side::Lower).unwrap().solve(b)
}

fn column(v: &[f64]) -> Mat<f64> {
    Mat::from_fn(v.len(), 1, |i, _| v[i])
}

fn assert_close(found: &[f64], expected: &Mat<f64>, what: &str) {
    assert_eq!(found.len(), expected.nrows(), "{what}");
    let scale = (expected.col(0).iter()).fold(1.0f64, |m, v| m.max(v.abs()));
    for (i, f) in found.iter().enumerate() {
        let e = expected[(i, 0)];
        assert!(
            (f - e).abs() <= 1e-11 * scale,
            "{what}: at {i} {f}, not {e}"
        );
    }
}

fn part(a: &Mat<f64>, rows: &[u32], cols: &[u32]) -> Mat<f64> {
    Mat::from_fn(rows.len(), cols.len(), |i, j| {
        a[(rows[i] as usize, cols[j] as usize)]
    })
}

/// Everything a factorisation offers, against dense blocks.
fn check(sparse: &SparseSymmetric, dense: &Mat<f64>, trailing: &[u32], method: Method, par: Par) {
    let n = sparse.len();
    let mut random = Random(7);
    let symbolic = symbolic(sparse.pattern(), method, trailing);
    let cholesky = Cholesky::new(&symbolic, sparse, par).unwrap();
    let mut scratch = Scratch::default();

    let b = random.vector(n);
    let mut x = b.clone();
    cholesky.solve(&mut x, &mut scratch).unwrap();
    assert_close(&x, &dense_solve(dense, &column(&b)), "solve");

    let many = Mat::from_fn(n, 3, |i, j| b[i] + j as f64);
    let mut solved = many.clone();
    cholesky.solve_many(solved.as_mut(), &mut scratch).unwrap();
    let expected = dense_solve(dense, &many);
    for j in 0..3 {
        let found: Vec<f64> = solved.col(j).iter().copied().collect();
        assert_close(&found, &expected.subcols(j, 1).to_owned(), "solve_many");
    }

    let leading: Vec<u32> = (0..n as u32).filter(|u| !trailing.contains(u)).collect();
    let uu = part(dense, &leading, &leading);
    let ug = part(dense, &leading, trailing);
    let gg = part(dense, trailing, trailing);
    let b_u = Mat::from_fn(leading.len(), 1, |i, _| b[leading[i] as usize]);
    let b_g = Mat::from_fn(trailing.len(), 1, |i, _| b[trailing[i] as usize]);

    let mut forward = Forward::default();
    cholesky.forward(&b, &mut forward, &mut scratch).unwrap();
    let condensed = &b_g - ug.transpose() * dense_solve(&uu, &b_u);
    assert_close(forward.condensed(), &condensed, "forward");

    for _ in 0..2 {
        let x_g = random.vector(trailing.len());
        let x_u = dense_solve(&uu, &(&b_u - &ug * column(&x_g)));
        (cholesky.backward(&forward, &x_g, &mut x, &mut scratch)).unwrap();
        let found: Vec<f64> = leading.iter().map(|&u| x[u as usize]).collect();
        assert_close(&found, &x_u, "backward");
        let found: Vec<f64> = trailing.iter().map(|&u| x[u as usize]).collect();
        assert_eq!(found, x_g);
    }

    let schur = cholesky.schur().unwrap();
    let expected = &gg - ug.transpose() * dense_solve(&uu, &ug);
    assert_eq!(schur.nrows(), trailing.len());
    for j in 0..schur.ncols() {
        let found: Vec<f64> = schur.col(j).iter().copied().collect();
        assert_close(&found, &expected.subcols(j, 1).to_owned(), "schur");
    }
}

fn check_all(sizes: &[usize], cells: &[Vec<u32>], seed: u64) {
    let mut random = Random(seed);
    let (sparse, dense) = assemble(sizes, cells, &mut random);
    let n = sparse.len();
    for m in [0, 1, n / 5, n / 2, n] {
        let trailing = random.choose(n, m);
        for method in METHODS {
            check(&sparse, &dense, &trailing, method, Par::Seq);
            check(&sparse, &dense, &trailing, method, Par::rayon(2));
        }
    }
}

#[test]
fn agrees_with_dense_on_a_plane_grid() {
    check_all(&[2; 49], &grid(7, 7, 1), 11);
}

#[test]
fn agrees_with_dense_on_a_space_grid() {
    check_all(&[3; 64], &grid(4, 4, 4), 12);
}

#[test]
fn agrees_with_dense_on_scattered_parts() {
    // Two chains, a pair, and blocks coupled to nothing or without unknowns.
    let cells = [&[0, 2][..], &[2, 4], &[4, 6], &[1, 3, 5], &[5, 7], &[9, 11]];
    let cells: Vec<Vec<u32>> = cells.iter().map(|c| c.to_vec()).collect();
    check_all(&[1, 2, 3, 1, 0, 2, 1, 4, 1, 2, 0, 3, 1], &cells, 13);
}

#[test]
fn agrees_with_dense_on_random_graphs() {
    for seed in 20..26 {
        let mut random = Random(seed);
        let sizes: Vec<usize> = (0..25).map(|_| random.below(4)).collect();
        let cells: Vec<Vec<u32>> = (0..20)
            .map(|_| {
                let k = 1 + random.below(4);
                random.choose(25, k)
            })
            .collect();
        check_all(&sizes, &cells, seed);
    }
}

#[test]
fn agrees_with_dense_across_many_supernodes() {
    // Large enough for subtrees of the elimination tree to be swept apart.
    let mut random = Random(30);
    let (sparse, dense) = assemble(&[2; 400], &grid(20, 20, 1), &mut random);
    let trailing = random.choose(800, 60);
    for method in METHODS {
        check(&sparse, &dense, &trailing, method, Par::Seq);
        check(&sparse, &dense, &trailing, method, Par::rayon(2));
    }
}

#[test]
fn empty_system() {
    let pattern = Arc::new(Pattern::uniform(0, 3, [[0u32; 0]]).unwrap());
    let a = SparseSymmetric::zeros(Arc::clone(&pattern));
    let cholesky = Cholesky::new(&symbolic(&pattern, Method::Metis, &[]), &a, Par::Seq).unwrap();
    cholesky.solve(&mut [], &mut Scratch::default()).unwrap();
    assert_eq!(cholesky.schur().unwrap().nrows(), 0);
}
