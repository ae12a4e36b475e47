//! Benchmarks of the literature and what the studies and the tests share.

pub mod contact_cases;
pub mod locking;
pub mod memory;
pub mod monolithic;
pub mod norms;
pub mod plot;
pub mod six_fractures;
