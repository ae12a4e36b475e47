//! flow-fmu
