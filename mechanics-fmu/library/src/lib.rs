//! The 75 functions of FMI 3.0 for [`MechanicsUnit`]. They are in a library of their own, so that a program can link
//! both units' numerics.

use mechanics_fmu::unit::MechanicsUnit;

fmi_unit::export_unit!(MechanicsUnit);
