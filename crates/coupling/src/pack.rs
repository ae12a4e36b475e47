//! The program that packs a unit.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use fmi_unit::{Contents, Unit, UnitError};

/// The `main` of a program `pack-… RESOURCES FMU` for a unit whose library is called `library` and lies beside the
/// program. `icon` is a PNG.
pub fn pack_main<U: Unit>(library: &str, icon: &[u8]) -> ExitCode {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [resources, fmu] = &arguments[..] else {
        eprintln!("two arguments are needed: the folder of the resources, and the FMU to write");
        return ExitCode::from(2);
    };
    match pack::<U>(library, icon, resources, fmu) {
        Ok(token) => {
            println!("{token}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("{}: {error}", fmu.display());
            ExitCode::FAILURE
        }
    }
}

fn pack<U: Unit>(library: &str, icon: &[u8], resources: &Path, fmu: &Path) -> Result<String, UnitError> {
    let name = format!("{}{library}{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    let library = std::env::current_exe()?.with_file_name(name);
    if !library.exists() {
        return Err(format!("the unit's library is not where it was looked for: {}", library.display()).into());
    }
    let contents = Contents { library, resources: Some(resources.to_owned()), icon: Some(icon.to_vec()) };
    Ok(fmi_unit::pack::<U>(fmu, &contents)?)
}
