//! Packs a model as FMUs: `pack-case MODEL FOLDER [CHANGE…]`.
//!
//! MODEL is the folder of a `model.toml`; changes are pieces of TOML laid over it, as
//! `mesh.triangles.fracture_size = 0.1`. Writes `FOLDER/resources`, and the FMU of each unit that the model has:
//! `FOLDER/mechanics.fmu` and `FOLDER/flow.fmu`. The programs that pack them are expected beside this one.

use std::error::Error;
use std::path::Path;
use std::process::{Command, ExitCode};

use model::Document;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [model, folder, changes @ ..] = &arguments[..] else {
        eprintln!("two arguments are needed: the folder of the model, and the folder to write");
        return ExitCode::from(2);
    };
    let changes: Vec<&str> = changes.iter().map(String::as_str).collect();
    match pack(Path::new(model), Path::new(folder), &changes) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn pack(model: &Path, folder: &Path, changes: &[&str]) -> Result<(), Box<dyn Error>> {
    let document = Document::load(model, &[], changes)?;
    let read =
        |file: &Path, _: Option<&model::CornerPoint>| mesh_io::read_gmsh(file).map_err(|error| error.to_string());
    let mesh = document.mesh(model, &read)?;
    let resources = folder.join("resources");
    std::fs::create_dir_all(&resources)?;
    std::fs::write(resources.join("model.toml"), document.to_toml())?;
    mesh_io::write_hdf5(resources.join("mesh.h5"), mesh.data())?;
    println!("{} cells, {} fracture faces", mesh.cell_count(), mesh.network().face_count());
    let units = [("mechanics", document.model.mechanics.is_some()), ("flow", document.model.flow.is_some())];
    for (name, _) in units.iter().filter(|unit| unit.1) {
        let program = std::env::current_exe()?.with_file_name(format!("pack-{name}"));
        let status = Command::new(&program).arg(&resources).arg(folder.join(format!("{name}.fmu"))).status()?;
        if !status.success() {
            return Err(format!("{} failed", program.display()).into());
        }
    }
    Ok(())
}
