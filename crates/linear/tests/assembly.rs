//! Patterns, symmetric matrices, and rectangular operators against dense sums.

mod common;

use std::sync::Arc;

use common::{Random, System, grid, local, pattern};
use linear::{BlockGraph, Csr, Error, Method, Ordering, Pattern, SparseSymmetric};
use proptest::prelude::*;

/// Block sizes, and cells over these blocks (repetitions allowed).
fn systems() -> impl Strategy<Value = (Vec<usize>, Vec<Vec<u32>>)> {
    (1usize..12).prop_flat_map(|blocks| {
        let sizes = prop::collection::vec(0usize..4, blocks);
        let cell = prop::collection::vec(0..blocks as u32, 0..6);
        (sizes, prop::collection::vec(cell, 0..10))
    })
}

proptest! {
    #[test]
    fn assembly_equals_dense_sum((sizes, cells) in systems(), seed in 1u64..1000) {
        let mut random = Random(seed);
        let system = System::new(&sizes, &cells, &mut random);
        let trailing = random.choose(sizes.len(), sizes.len() / 3);
        let (sparse, dense) = (system.sparse(Method::Amd, &trailing), &system.dense);
        let n = sparse.len();
        prop_assert_eq!(n, sizes.iter().sum::<usize>());
        let order = sparse.pattern().unknowns();
        let (ptr, row) = sparse.pattern().lower();
        let mut rebuilt = faer::Mat::<f64>::zeros(n, n);
        for j in 0..n {
            let range = ptr[j] as usize..ptr[j + 1] as usize;
            prop_assert!(row[range.clone()].is_sorted_by(|a, b| a < b));
            prop_assert_eq!(row[range.start] as usize, j);
            for k in range {
                let [i, j] = [row[k] as usize, j].map(|position| order[position] as usize);
                rebuilt[(i, j)] = sparse.values()[k];
                rebuilt[(j, i)] = sparse.values()[k];
            }
        }
        prop_assert!((&rebuilt - dense).norm_max() <= 1e-12 * dense.norm_max());

        let x = random.vector(n);
        let mut y = vec![f64::NAN; n];
        sparse.mul(&x, &mut y).unwrap();
        let mut norm = 0.0f64;
        for i in 0..n {
            let expected: f64 = (0..n).map(|j| dense[(i, j)] * x[j]).sum();
            prop_assert!((y[i] - expected).abs() <= 1e-12 * dense.norm_max() * n as f64);
            norm = norm.max((0..n).map(|j| dense[(i, j)].abs()).sum());
        }
        prop_assert!((sparse.norm() - norm).abs() <= 1e-12 * norm);
    }

    #[test]
    fn pattern_couples_exactly_the_blocks_of_a_cell((sizes, cells) in systems()) {
        let graph = BlockGraph::with_sizes(&sizes, &cells).unwrap();
        let pattern = pattern(&graph, Method::Metis, &[]);
        let mut coupled = 0;
        for a in 0..sizes.len() {
            for b in 0..=a {
                let (i, j) = (a as u32, b as u32);
                if a == b {
                    coupled += sizes[a] * (sizes[a] + 1) / 2;
                } else if cells.iter().any(|c| c.contains(&i) && c.contains(&j)) {
                    coupled += sizes[a] * sizes[b];
                }
            }
        }
        prop_assert_eq!(pattern.entries(), coupled);
    }

    #[test]
    fn csr_equals_dense_sum(
        rows in 1usize..8,
        cols in 1usize..8,
        places in prop::collection::vec((0u32..8, 0u32..8), 0..30),
        seed in 1u64..1000,
    ) {
        let mut random = Random(seed);
        let triplets: Vec<(u32, u32, f64)> = (places.iter())
            .map(|&(i, j)| (i % rows as u32, j % cols as u32, random.next()))
            .collect();
        let csr = Csr::from_triplets(rows, cols, &triplets).unwrap();
        let (x, z) = (random.vector(cols), random.vector(rows));
        let (mut y, mut w) = (vec![0.0; rows], vec![0.0; cols]);
        for &(i, j, v) in &triplets {
            y[i as usize] += v * x[j as usize];
            w[j as usize] += v * z[i as usize];
        }
        let (mut y2, mut w2) = (vec![f64::NAN; rows], vec![f64::NAN; cols]);
        csr.mul(&x, &mut y2).unwrap();
        csr.mul_transpose(&z, &mut w2).unwrap();
        for (a, b) in y.iter().chain(&w).zip(y2.iter().chain(&w2)) {
            prop_assert!((a - b).abs() <= 1e-13);
        }
        csr.mul_add(-1.0, &x, &mut y2).unwrap();
        csr.mul_transpose_add(-1.0, &z, &mut w2).unwrap();
        prop_assert!(y2.iter().chain(&w2).all(|v| v.abs() <= 1e-13));
        prop_assert!((0..rows).all(|i| csr.row(i).0.is_sorted_by(|a, b| a < b)));
    }
}

#[test]
fn refilling_repeats_the_same_bits() {
    let cells = grid(5, 4, 3);
    let graph = BlockGraph::uniform(60, 3, &cells).unwrap();
    let mut a = SparseSymmetric::zeros(pattern(&graph, Method::Metis, &[7]));
    let fill = |a: &mut SparseSymmetric| {
        let mut random = Random(3);
        for cell in &cells {
            a.add(cell, &local(&mut random, 24)).unwrap();
        }
        a.values().to_vec()
    };
    let first = fill(&mut a);
    a.set_zero();
    assert!(a.values().iter().all(|&v| v == 0.0));
    assert_eq!(first, fill(&mut a));
}

#[test]
fn parts_of_the_columns_add_up_as_the_whole() {
    let cells = grid(5, 4, 3);
    let mut random = Random(4);
    let matrices: Vec<Vec<f64>> = cells.iter().map(|_| local(&mut random, 24)).collect();
    let graph = BlockGraph::uniform(60, 3, &cells).unwrap();
    let mut one_by_one = SparseSymmetric::zeros(pattern(&graph, Method::Metis, &[7, 3]));
    cells.iter().zip(&matrices).for_each(|(cell, k)| one_by_one.add(cell, k).unwrap());
    for parts in [1, 2, 3, 70] {
        let mut a = SparseSymmetric::zeros(Arc::clone(one_by_one.pattern()));
        for mut columns in a.columns(parts) {
            for (cell, k) in cells.iter().zip(&matrices).filter(|(cell, _)| columns.concern(cell)).collect::<Vec<_>>() {
                columns.add(cell, k).unwrap();
            }
        }
        assert!(a.values() == one_by_one.values());
    }
}

#[test]
fn wrong_input_is_reported() {
    let cells = [[0u32, 1], [1, 2]];
    assert_eq!(
        BlockGraph::uniform(2, 2, cells).unwrap_err(),
        Error::OutOfRange { what: "block of a cell", index: 2, bound: 2 }
    );
    assert_eq!(BlockGraph::with_sizes(&[usize::MAX, 1], [[0u32]]).unwrap_err(), Error::TooLarge);
    let graph = BlockGraph::uniform(3, 2, cells).unwrap();
    let other = Ordering::new(&BlockGraph::uniform(2, 3, [[0u32, 1]]).unwrap(), Method::Amd, &[]).unwrap();
    assert_eq!(Pattern::new(&graph, &other).unwrap_err(), Error::Dimension { what: "ordering", expected: 3, found: 2 });
    let mut a = SparseSymmetric::zeros(pattern(&graph, Method::Amd, &[]));
    assert_eq!(a.add(&[0, 2], &[0.0; 16]).unwrap_err(), Error::NotInPattern { row: 2, column: 0 });
    assert_eq!(
        a.add(&[0, 1], &[0.0; 4]).unwrap_err(),
        Error::Dimension { what: "local matrix", expected: 16, found: 4 }
    );
    assert!(matches!(a.add(&[3], &[0.0; 4]), Err(Error::OutOfRange { index: 3, .. })));
    assert!(matches!(a.mul(&[0.0; 6], &mut [0.0; 5]), Err(Error::Dimension { expected: 6, found: 5, .. })));
    assert!(matches!(a.mul(&[0.0; 7], &mut [0.0; 6]), Err(Error::Dimension { expected: 6, found: 7, .. })));
    assert_eq!(Csr::from_triplets(2, 2, &[(0, 1, f64::NAN)]).unwrap_err(), Error::NonFinite { row: 0, column: 1 });
    assert!(matches!(Csr::from_triplets(2, 2, &[(0, 2, 1.0)]), Err(Error::OutOfRange { what: "column", .. })));
    assert!(matches!(Csr::from_triplets(2, 2, &[(2, 0, 1.0)]), Err(Error::OutOfRange { what: "row", .. })));
    let by_rows = |columns: [u32; 2], value: f64| {
        Csr::by_rows(
            3,
            [0, 2].into_iter(),
            || (),
            |(), row, own, values| {
                assert_eq!((row, own.len()), if own.is_empty() { (0, 0) } else { (1, 2) });
                own.iter_mut().zip(columns).for_each(|(own, column)| *own = column);
                values.iter_mut().zip([1.0, value]).for_each(|(own, value)| *own = value);
            },
        )
    };
    assert_eq!(by_rows([2, 0], 4.0), Csr::from_triplets(2, 3, &[(1, 0, 4.0), (1, 2, 1.0)]));
    assert_eq!(by_rows([2, 2], 4.0).unwrap_err(), Error::Repeated { what: "column", index: 2 });
    assert_eq!(by_rows([1, 0], f64::NAN).unwrap_err(), Error::NonFinite { row: 1, column: 0 });
    assert_eq!(by_rows([0, 3], 4.0).unwrap_err(), Error::OutOfRange { what: "column", index: 3, bound: 3 });
    let csr = Csr::from_triplets(2, 3, &[]).unwrap();
    assert!(csr.mul(&[0.0; 2], &mut [0.0; 2]).is_err());
    assert!(csr.mul_transpose(&[0.0; 2], &mut [0.0; 2]).is_err());
}
