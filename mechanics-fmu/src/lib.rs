//! mechanics-fmu
