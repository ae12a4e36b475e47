//! Tests of the mechanics, in one program.

mod common;
mod contact;
mod coupling;
mod input;
mod invariance;
mod operators;
mod patch;
mod work;
