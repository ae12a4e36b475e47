//! The factorisation against dense linear algebra.

mod common;

use std::sync::Arc;

use common::{Random, System, grid, pattern};
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use linear::{BlockGraph, Cholesky, Error, Forward, Method, Ordering, Par, Scratch, SparseSymmetric, Symbolic};

const METHODS: [Method; 2] = [Method::Metis, Method::Amd];

fn symbolic(a: &SparseSymmetric) -> Arc<Symbolic> {
    Arc::new(Symbolic::new(a.pattern()).unwrap())
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
        assert!((f - e).abs() <= 1e-11 * scale, "{what}: at {i} {f}, not {e}");
    }
}

fn part(a: &Mat<f64>, rows: &[u32], cols: &[u32]) -> Mat<f64> {
    Mat::from_fn(rows.len(), cols.len(), |i, j| a[(rows[i] as usize, cols[j] as usize)])
}

/// Everything a factorisation offers, against dense blocks.
fn check(system: &System, trailing: &[u32], method: Method, par: Par) {
    let sparse = &system.sparse(method, trailing);
    let dense = &system.dense;
    let trailing: &[u32] =
        &trailing.iter().flat_map(|&b| system.graph.unknowns(b as usize)).map(|u| u as u32).collect::<Vec<_>>();
    let n = sparse.len();
    let mut random = Random(7);
    let cholesky = Cholesky::new(&symbolic(sparse), sparse, par).unwrap();
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

    let (schur, inverse) = cholesky.schur().unwrap();
    let expected = &gg - ug.transpose() * dense_solve(&uu, &ug);
    let m = trailing.len();
    assert_eq!((schur.len(), inverse.len()), (m, m));
    for j in 0..m {
        let unit: Vec<f64> = (0..m).map(|i| f64::from(u8::from(i == j))).collect();
        let mut found = vec![0.0; m];
        cholesky.add_schur_product(&unit, &mut found).unwrap();
        assert_close(&found, &expected.subcols(j, 1).to_owned(), "schur product");
        // In single precision.
        let column: Vec<f32> = (0..m).map(|i| schur.get(i, j)).collect();
        assert!(found.iter().zip(&column).all(|(f, c)| (f - f64::from(*c)).abs() < 1e-5 * sparse.norm()));
        let mut back = vec![0.0; m];
        inverse.mul(&column, &mut back);
        assert!(back.iter().zip(&unit).all(|(b, u)| (f64::from(*b) - u).abs() < 1e-3), "{back:?}");
    }
}

fn check_all(sizes: &[usize], cells: &[Vec<u32>], seed: u64) {
    let mut random = Random(seed);
    let system = System::new(sizes, cells, &mut random);
    let n = sizes.len();
    for m in [0, 1, n / 5, n / 2, n] {
        let trailing = random.choose(n, m);
        for method in METHODS {
            check(&system, &trailing, method, Par::Seq);
            check(&system, &trailing, method, Par::rayon(2));
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
    let system = System::new(&[2; 400], &grid(20, 20, 1), &mut random);
    let trailing = random.choose(400, 30);
    for method in METHODS {
        check(&system, &trailing, method, Par::Seq);
        check(&system, &trailing, method, Par::rayon(2));
    }
}

#[test]
fn agrees_with_dense_where_threads_pay() {
    let mut random = Random(31);
    let system = System::new(&[75; 8], &grid(2, 2, 2), &mut random);
    check(&system, &[6, 1], Method::Metis, Par::rayon(2));
}

#[test]
fn empty_system() {
    let graph = BlockGraph::uniform(0, 3, [[0u32; 0]]).unwrap();
    let a = SparseSymmetric::zeros(pattern(&graph, Method::Metis, &[]));
    let cholesky = Cholesky::new(&symbolic(&a), &a, Par::Seq).unwrap();
    cholesky.solve(&mut [], &mut Scratch::default()).unwrap();
    assert_eq!(cholesky.schur().unwrap().0.len(), 0);
}

fn bits(v: &[f64]) -> Vec<u64> {
    v.iter().map(|v| v.to_bits()).collect()
}

#[test]
fn refactorising_repeats_the_bits_of_a_fresh_factor() {
    // Small supernodes; and one large enough to be factorised in parallel.
    for (sizes, cells, trailing) in [([3; 125].to_vec(), grid(5, 5, 5), 14), ([75; 8].to_vec(), grid(2, 2, 2), 1)] {
        let mut random = Random(40);
        let [first, second] = [(); 2].map(|()| System::new(&sizes, &cells, &mut random));
        let trailing = random.choose(sizes.len(), trailing);
        let first = first.sparse(Method::Metis, &trailing);
        let second = second.on(first.pattern());
        let symbolic = symbolic(&first);
        let b = random.vector(first.len());
        for par in [Par::Seq, Par::rayon(2)] {
            let solve = |cholesky: &Cholesky| {
                let mut x = b.clone();
                cholesky.solve(&mut x, &mut Scratch::default()).unwrap();
                let (schur, _) = cholesky.schur().unwrap();
                let m = schur.len();
                let schur = (0..m * m).map(|k| f64::from(schur.get(k / m, k % m)));
                bits(&x.into_iter().chain(schur).collect::<Vec<_>>())
            };
            let fresh = solve(&Cholesky::new(&symbolic, &second, par).unwrap());
            let mut cholesky = Cholesky::new(&symbolic, &first, par).unwrap();
            assert_ne!(solve(&cholesky), fresh);
            cholesky.refactorise(&second).unwrap();
            assert_eq!(solve(&cholesky), fresh);
            // And after a failure in between.
            let mut bad = first.clone();
            bad.values_mut().fill(-1.0);
            cholesky.refactorise(&bad).unwrap_err();
            cholesky.refactorise(&second).unwrap();
            assert_eq!(solve(&cholesky), fresh);
        }
    }
}

#[test]
fn orders_repeat_and_keep_trailing_blocks_last() {
    let mut sizes = vec![3; 1000];
    sizes[4] = 0;
    let graph = BlockGraph::with_sizes(&sizes, grid(10, 10, 10)).unwrap();
    for method in METHODS {
        let once = Ordering::new(&graph, method, &[5, 2]).unwrap();
        assert_eq!(once, Ordering::new(&graph, method, &[5, 2]).unwrap());
        assert_eq!(once.trailing(), 2);
        assert_eq!(once.blocks()[998..], [5, 2]);
        let mut sorted = once.blocks().to_vec();
        sorted.sort_unstable();
        assert!(sorted.into_iter().eq(0..1000));
        let pattern = pattern(&graph, method, &[5, 2]);
        assert_eq!(pattern.trailing(), 6);
        assert_eq!(pattern.unknowns()[2991..], [12, 13, 14, 6, 7, 8]);
    }
}

#[test]
fn dissection_beats_minimum_degree_in_space() {
    let entries = |cells: Vec<Vec<u32>>, blocks: usize, method| {
        let graph = BlockGraph::uniform(blocks, 3, cells).unwrap();
        Symbolic::new(&pattern(&graph, method, &[])).unwrap().factor_entries()
    };
    let space = METHODS.map(|method| entries(grid(20, 20, 20), 8000, method));
    assert!(space[0] * 10 < space[1] * 8, "{space:?}");
    let plane = METHODS.map(|method| entries(grid(64, 64, 1), 4096, method));
    assert!(plane[0] < plane[1] * 12 / 10 && plane[1] < plane[0] * 12 / 10, "{plane:?}");
    // A natural order of the plane would fill its band: 64 · 3 rows in each column.
    assert!(plane[0] < 3 * 4096 * 192 * 2 / 3, "{plane:?}");
}

#[test]
fn accounts_for_memory() {
    let mut random = Random(50);
    let a = System::new(&[1; 4], &[vec![0, 1, 2, 3]], &mut random).sparse(Method::Amd, &[]);
    let cholesky = Cholesky::new(&symbolic(&a), &a, Par::Seq).unwrap();
    let memory = cholesky.memory();
    assert_eq!((memory.factor_entries, memory.factor_bytes), (16, 128));
    assert!(memory.total_bytes > 128 + 80);
}

#[test]
fn wrong_input_is_reported() {
    let mut random = Random(60);
    let system = System::new(&[2; 36], &grid(6, 6, 1), &mut random);
    assert_eq!(
        Ordering::new(&system.graph, Method::Amd, &[3, 36]).unwrap_err(),
        Error::OutOfRange { what: "trailing block", index: 36, bound: 36 }
    );
    assert_eq!(
        Ordering::new(&system.graph, Method::Amd, &[3, 4, 3]).unwrap_err(),
        Error::Repeated { what: "trailing block", index: 3 }
    );
    let a = system.sparse(Method::Metis, &[7]);
    let pattern = a.pattern();
    let symbolic = symbolic(&a);
    let other = system.sparse(Method::Metis, &[3]);
    assert_eq!(Cholesky::new(&symbolic, &other, Par::Seq).unwrap_err(), Error::PatternMismatch);

    // An equal pattern built elsewhere is accepted.
    let mut same = SparseSymmetric::zeros(Arc::new((**pattern).clone()));
    same.values_mut().copy_from_slice(a.values());
    let mut cholesky = Cholesky::new(&symbolic, &same, Par::Seq).unwrap();

    let mut scratch = Scratch::default();
    let mut forward = Forward::default();
    assert!(matches!(
        cholesky.solve(&mut [0.0; 71], &mut scratch),
        Err(Error::Dimension { expected: 72, found: 71, .. })
    ));
    assert!(matches!(
        cholesky.solve_many(Mat::zeros(73, 2).as_mut(), &mut scratch),
        Err(Error::Dimension { expected: 72, found: 73, .. })
    ));
    assert!(cholesky.forward(&[0.0; 71], &mut forward, &mut scratch).is_err());
    let x = &mut [0.0; 72];
    assert!(matches!(
        cholesky.backward(&forward, &[0.0; 2], x, &mut scratch),
        Err(Error::Dimension { what: "forward", .. })
    ));
    cholesky.forward(&[0.0; 72], &mut forward, &mut scratch).unwrap();
    assert!(matches!(
        cholesky.backward(&forward, &[0.0; 3], x, &mut scratch),
        Err(Error::Dimension { what: "trailing values", expected: 2, found: 3 })
    ));

    // Entry k of the values: its row and column.
    let (ptr, row) = pattern.lower();
    let k = ptr[20] as usize + 1;
    same.values_mut()[k] = f64::INFINITY;
    let (i, j) = (pattern.unknowns()[row[k] as usize] as usize, pattern.unknowns()[20] as usize);
    assert_eq!(cholesky.refactorise(&same).unwrap_err(), Error::NonFinite { row: i.max(j), column: i.min(j) });
    assert_eq!(cholesky.solve(x, &mut scratch).unwrap_err(), Error::NotFactorised);
    assert_eq!(cholesky.schur().unwrap_err(), Error::NotFactorised);

    for (&start, &unknown) in ptr.iter().zip(pattern.unknowns()) {
        same.values_mut().copy_from_slice(a.values());
        same.values_mut()[start as usize] = -1.0;
        let unknown = unknown as usize;
        let error = cholesky.refactorise(&same).unwrap_err();
        // Without this unknown the matrix is positive definite, so it is the one to break down.
        assert_eq!(error, Error::NotPositiveDefinite { unknown });
    }
}

#[test]
fn inaccuracy_is_reported() {
    // Subnormal pivots are positive, but the solution overflows.
    let graph = BlockGraph::uniform(1, 2, [[0u32]]).unwrap();
    let mut a = SparseSymmetric::zeros(pattern(&graph, Method::Amd, &[]));
    a.add(&[0], &[1e-320, 0.0, 0.0, 1e-320]).unwrap();
    let error = Cholesky::new(&symbolic(&a), &a, Par::Seq).unwrap_err();
    assert!(matches!(error, Error::Inaccurate { tolerance: linear::MAX_RESIDUAL, .. }));
}
