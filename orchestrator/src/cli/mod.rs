//! The command line.
//!
//! | exit code | meaning |
//! |---|---|
//! | 0 | done |
//! | 1 | it failed: the coupling, a unit, a file; or a claim does not hold |
//! | 2 | the command or the model is wrong |

mod case;
mod compare;
mod error;
mod memory;
mod pack;
mod places;
mod progress;
mod run;
mod series;
mod unit;
mod verify;

use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, CommandFactory, Parser, Subcommand};
use clap_complete::Shell;
use coupling::Role;

use case::Case;
use error::CliError;
use progress::Voice;

const EXAMPLES: &str = "\
Examples:
  orchestrator run models/six-fractures
  orchestrator run models/six-fractures --variant h0.01 --output results/fine
  orchestrator run models/six-fractures --set coupling.split=drained --set time.step=50
  orchestrator resume results/fine
  orchestrator compare models/six-fractures --split fixed_stress,undrained --acceleration none,iqn_ils
  orchestrator check models/network-3d
  orchestrator verify six-fractures";

const RUN_EXAMPLES: &str = "\
Examples:
  orchestrator run models/six-fractures
  orchestrator run models/six-fractures --variant polygons --output results/polygons
  orchestrator run models/six-fractures --set mesh.triangles.fracture_size=0.02
  orchestrator run models/six-fractures --flow other.fmu   # with a flow unit of another kind
  orchestrator run models/six-fractures --json > steps.jsonl";

const CHANGE_EXAMPLES: &str = "\
Examples:
  orchestrator check models/six-fractures --variant h0.02
  orchestrator pack models/six-fractures --output fmus
  orchestrator check models/six-fractures --set time.step=50 --set 'output.times=[1000, 2000]'";

const COMPARE_EXAMPLES: &str = "\
Examples:
  orchestrator compare models/six-fractures --split fixed_stress,undrained --acceleration none,aitken,iqn_ils
  orchestrator compare models/six-fractures --dt 1,10,100 --steps 5 --acceleration anderson:depth=2,iqn_ils:reuse=0
  orchestrator compare models/terzaghi --variant n20,default --set coupling.extrapolation=constant,linear
  orchestrator compare --study models/terzaghi/studies/stability.toml --jobs 1

Every combination is a run, in a process of its own. A run that fails is a result; the others go on. The same command
goes on with a comparison that was stopped.";

const COMPLETIONS: &str = "\
Examples:
  orchestrator completions bash > ~/.local/share/bash-completion/completions/orchestrator
  orchestrator completions zsh > ~/.zfunc/_orchestrator";

/// Couples the mechanics and the flow of fractured rock, each an FMI 3.0 unit.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Checks a model, its mesh and its units, and reports everything that is wrong
    #[command(after_help = CHANGE_EXAMPLES)]
    Check {
        #[command(flatten)]
        model: ModelArguments,
    },
    /// Writes the units of a model as FMUs, for this or any other host
    #[command(after_help = CHANGE_EXAMPLES)]
    Pack {
        #[command(flatten)]
        model: ModelArguments,
        /// Folder for NAME-mechanics.fmu and NAME-flow.fmu, the mesh NAME-mesh.h5 and the model NAME-model.toml
        #[arg(short, long, default_value = ".")]
        output: PathBuf,
        /// Also writes NAME.ssp: all units and their wiring as an archive of the standard SSP 2.0
        #[arg(long)]
        ssp: bool,
    },
    /// Tries an FMU as flow or mechanics of a model: what it offers and lacks, and a coupled time step
    #[command(after_help = "Examples:\n  orchestrator check-unit other.fmu six-fractures\n  \
                            orchestrator check-unit other.fmu models/terzaghi --role mechanics")]
    CheckUnit {
        /// The FMU, of FMI 3.0 or 2.0
        fmu: PathBuf,
        #[command(flatten)]
        model: ModelArguments,
        /// What it is to be [default: what it fits better]
        #[arg(long, value_parser = ["flow", "mechanics"])]
        role: Option<String>,
    },
    /// Runs a model: packs its units, couples them, writes results
    #[command(after_help = RUN_EXAMPLES)]
    Run {
        #[command(flatten)]
        model: ModelArguments,
        /// Folder for the results [default: results/NAME]
        #[arg(short, long)]
        output: Option<PathBuf>,
        /// Replaces the results of an earlier run in that folder
        #[arg(long)]
        overwrite: bool,
        /// An FMU in place of the mechanics
        #[arg(long, value_name = "FMU")]
        mechanics: Option<PathBuf>,
        /// An FMU in place of the flow
        #[arg(long, value_name = "FMU")]
        flow: Option<PathBuf>,
        #[command(flatten)]
        voice: VoiceArguments,
    },
    /// Goes on with a run that was stopped, from its last checkpoint
    #[command(after_help = "Examples:\n  orchestrator resume results/six-fractures")]
    Resume {
        /// Folder of the results
        folder: PathBuf,
        #[command(flatten)]
        voice: VoiceArguments,
    },
    /// Runs a model, in all variants that its reference.toml is about, and says of each claim whether it holds
    #[command(after_help = "Examples:\n  orchestrator verify six-fractures\n  \
                            orchestrator verify six-fractures --variant default   # this one only")]
    Verify {
        #[command(flatten)]
        model: ModelArguments,
    },
    /// Runs a model with every combination of some choices, and compares them
    #[command(after_help = COMPARE_EXAMPLES)]
    Compare {
        #[command(flatten)]
        comparison: compare::CompareArguments,
        #[command(flatten)]
        voice: VoiceArguments,
    },
    /// One of the runs of a comparison
    #[command(hide = true)]
    CompareRun {
        folder: PathBuf,
        units: PathBuf,
        #[arg(long)]
        arrays: bool,
    },
    /// Prints the JSON schema of model.toml, for editors
    #[command(after_help = "Examples:\n  orchestrator schema > model.schema.json")]
    Schema,
    /// Prints the completions of this program for a shell
    #[command(after_help = COMPLETIONS)]
    Completions {
        /// The shell
        shell: Shell,
    },
}

#[derive(Args)]
struct ModelArguments {
    /// Folder with a model.toml, or the name of one in models/
    model: PathBuf,
    /// A variant of the model; several are laid over it in their order
    #[arg(long, value_name = "NAME")]
    variant: Vec<String>,
    /// A change of the model, as time.step=50 or initial.pressure=1e5*y; values are TOML or expressions
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

impl ModelArguments {
    fn load(&self) -> Result<Case, CliError> {
        Case::load(&self.model, &self.variant, &self.set)
    }
}

#[derive(Args)]
struct VoiceArguments {
    /// Prints errors only
    #[arg(short, long, conflicts_with = "json")]
    quiet: bool,
    /// Prints a line of JSON for each time step, and one at the end
    #[arg(long)]
    json: bool,
}

impl VoiceArguments {
    fn voice(&self) -> Voice {
        match (self.quiet, self.json) {
            (true, _) => Voice::Quiet,
            (_, true) => Voice::Json,
            _ if io::stderr().is_terminal() => Voice::Bar,
            _ => Voice::Lines,
        }
    }
}

/// Runs the program.
pub(crate) fn main() -> ExitCode {
    match Cli::parse().command.perform() {
        Ok(code) => code,
        // Whoever reads the output has had enough.
        Err(CliError::Output(error)) if error.kind() == io::ErrorKind::BrokenPipe => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            error.code()
        }
    }
}

impl Command {
    fn perform(self) -> Result<ExitCode, CliError> {
        match self {
            Self::Check { model } => {
                let case = model.load()?;
                let mesh = case.mesh()?;
                let text = format!("{}\nmesh fingerprint: {}", case.describe(&mesh), mesh.fingerprint());
                writeln!(io::stdout(), "{text}").map_err(CliError::Output)?;
                // Units know best what they refuse.
                let temporary = pack::temporary("fmus-")?;
                let paths = run::fmus(&case.document, &mesh, temporary.path())?;
                for about in run::open(&paths, &case.document, &mesh)?.about() {
                    writeln!(io::stdout(), "{about}").map_err(CliError::Output)?;
                }
            }
            Self::Pack { model, output, ssp } => {
                let case = model.load()?;
                let mesh = case.mesh()?;
                std::fs::create_dir_all(&output).map_err(CliError::file(&output))?;
                let path = |rest: String| output.join(format!("{}{rest}", case.name));
                let units: Vec<_> = case.units().map(|unit| (unit, path(format!("-{unit}.fmu")))).collect();
                pack::pack(&case.document, &mesh, &units)?;
                let mut written: Vec<PathBuf> = units.iter().map(|(_, path)| path.clone()).collect();
                written.extend(pack::resources(
                    &case.document,
                    &mesh,
                    &path("-model.toml".into()),
                    &path("-mesh.h5".into()),
                )?);
                if ssp {
                    let path = path(".ssp".into());
                    run::open(&run::placed(&case.document, &units), &case.document, &mesh)?.write_ssp(
                        &case.name,
                        &case.document,
                        &path,
                    )?;
                    written.push(path);
                }
                for path in written {
                    writeln!(io::stdout(), "{}", path.display()).map_err(CliError::Output)?;
                }
            }
            Self::CheckUnit { fmu, model, role } => {
                let role = role.map(|name| if name == "flow" { Role::Flow } else { Role::Mechanics });
                return unit::check_unit(model.load()?, fmu, role);
            }
            Self::Run { model, output, overwrite, mechanics, flow, voice } => {
                let mut case = model.load()?;
                for (name, fmu) in [("flow", flow), ("mechanics", mechanics)] {
                    if let Some(fmu) = fmu {
                        case.put(name, fmu);
                    }
                }
                let output = output.unwrap_or_else(|| PathBuf::from("results").join(&case.name));
                run::run(&case, &output, overwrite, voice.voice())?;
            }
            Self::Resume { folder, voice } => run::resume(&folder, voice.voice())?,
            Self::Verify { model } => return verify::verify(&model.model, &model.variant, &model.set),
            Self::Compare { comparison, voice } => return compare::compare(&comparison, voice.voice()),
            Self::CompareRun { folder, units, arrays } => compare::run(&folder, &units, arrays)?,
            Self::Schema => write!(io::stdout(), "{}", model::schema()).map_err(CliError::Output)?,
            Self::Completions { shell } => {
                let mut script = Vec::new();
                clap_complete::generate(shell, &mut Cli::command(), "orchestrator", &mut script);
                io::stdout().write_all(&script).map_err(CliError::Output)?;
            }
        }
        Ok(ExitCode::SUCCESS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_sound() {
        Cli::command().debug_assert();
    }
}
