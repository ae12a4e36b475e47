//! Packs the example unit: `cargo run --example pack_heated_bars -- FOLDER` writes `heated_bars.fmu` and,
//! for the tests, the C declarations of what it exports.

#[allow(unreachable_pub, reason = "public where it is a library")]
#[path = "heated_bars.rs"]
mod heated_bars;

use std::path::{Path, PathBuf};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).ok_or("usage: pack_heated_bars FOLDER")?);
    let here = std::env::current_exe()?;
    let library = format!("{}heated_bars{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    std::fs::create_dir_all(&folder)?;
    let contents = fmi_unit::Contents {
        library: here.with_file_name(library),
        resources: Some(Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/heated_bars_resources")),
        icon: None,
    };
    let token = fmi_unit::pack::<heated_bars::HeatedBars>(&folder.join("heated_bars.fmu"), &contents)?;
    std::fs::write(folder.join("fmi_unit.h"), fmi_unit::ffi::c_header())?;
    println!("{}: {token}", folder.join("heated_bars.fmu").display());
    Ok(())
}
