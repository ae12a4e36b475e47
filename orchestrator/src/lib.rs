//! Couples units.
