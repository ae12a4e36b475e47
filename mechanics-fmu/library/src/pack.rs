//! Packs the unit: `pack-mechanics RESOURCES FMU`, with `model.toml` and `mesh.h5` in the folder RESOURCES. The library
//! is expected beside this program.

use mechanics_fmu::unit::MechanicsUnit;

fn main() -> std::process::ExitCode {
    coupling::pack_main::<MechanicsUnit>("mechanics_unit", include_bytes!("../icon.png"))
}
