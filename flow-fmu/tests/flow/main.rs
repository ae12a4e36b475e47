//! Tests of the flow, in one program.

mod common;
mod convergence;
mod coupling;
mod fractures;
mod input;
mod patch;
mod radial;
mod transient;
mod warped;
mod wells;
