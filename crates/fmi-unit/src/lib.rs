//! fmi-unit
