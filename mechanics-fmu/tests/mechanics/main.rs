//! Tests of the mechanics, in one program.

mod boundary;
mod common;
mod contact;
mod coupling;
mod derivatives;
mod failures;
mod history;
mod input;
mod invariance;
mod operators;
mod patch;
mod random;
mod unit;
mod work;
