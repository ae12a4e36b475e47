//! The 75 functions of FMI 3.0 for [`FlowUnit`]. They are in a library of their own, so that a program can link
//! both units' numerics.

use flow_fmu::unit::FlowUnit;

fmi_unit::export_unit!(FlowUnit);
