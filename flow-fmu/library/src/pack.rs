//! Packs the unit: `pack-flow RESOURCES FMU`, with `model.toml` and `mesh.h5` in the folder RESOURCES. The library
//! is expected beside this program.

use flow_fmu::unit::FlowUnit;

fn main() -> std::process::ExitCode {
    coupling::pack_main::<FlowUnit>("flow_unit", include_bytes!("../icon.png"))
}
