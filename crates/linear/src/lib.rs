//! Linear algebra glue over faer: sparse symmetric assembly, fill-reducing orders, a Cholesky
//! factorisation with partial elimination, and small rectangular operators.
//!
//! The systems are symmetric positive definite and come from meshes. Their unknowns are grouped
//! into *blocks* (the unknowns of one vertex, face or cell), numbered consecutively. In
//!
//! ```text
//! [ A_uu  A_ug ] [ x_u ]   [ b_u ]
//! [ A_gu  A_gg ] [ x_g ] = [ b_g ]
//! ```
//!
//! g are the *trailing* unknowns, eliminated last. With P A Pᵀ = L Lᵀ, P putting g at the end and
//! L = [L11 0; L21 L22], one factorisation gives plain solves, the condensed right-hand side
//! b_g − A_gu A_uu⁻¹ b_u, and the Schur complement A_gg − A_gu A_uu⁻¹ A_ug = L22 L22ᵀ.
//!
//! 1. [`BlockGraph`] tells which blocks the cells couple, [`Ordering`] chooses the elimination order.
//! 2. [`Pattern`] has the places of the entries in that order; [`SparseSymmetric`] holds values on
//!    it and can be refilled. So a matrix is never copied to be ordered.
//! 3. [`Symbolic`] analyses a pattern; [`Cholesky`] factorises, refactorises, and solves.
//!
//! Nothing here reads or writes files, knows a mesh, or has hidden global state; parallelism is
//! the explicit [`Par`] argument. Indices are `u32`: at most 2³¹ − 1 unknowns, matrix entries, and
//! factor entries.

mod buffer;
mod cholesky;
mod csr;
mod error;
mod gmres;
mod graph;
mod ordering;
mod panels;
mod pattern;
mod tiles;

pub use cholesky::{Cholesky, Forward, MAX_RESIDUAL, Memory, Scratch, Symbolic};
pub use csr::Csr;
pub use error::Error;
pub use faer::{Mat, MatMut, MatRef, Par};
pub use gmres::{Krylov, gmres};
pub use graph::BlockGraph;
pub use ordering::{Method, Ordering};
pub use pattern::{Columns, Pattern, SparseSymmetric};
pub use tiles::DenseSymmetric;
