//! The commands `cost` and `paper`, which run the program `studies`. It is a program of its own because the
//! dependencies of these two commands would double the build time of `sim-host`.

use std::env;
use std::path::Path;
use std::process::{Command, ExitCode};

use input::InputError;
use sim_host::command::BAD_INPUT;
use sim_host::output_file::print_note;

/// Arguments that are forwarded to `studies`, which parses them.
#[derive(clap::Args)]
#[command(disable_help_flag = true)]
pub struct ForwardedArguments {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    arguments: Vec<String>,
}

/// Builds `studies` if it is not up to date, runs it, and returns its exit code.
pub fn run(command: &str, forwarded: &ForwardedArguments, json: bool) -> ExitCode {
    let json: &[&str] = if json { &["--json"] } else { &[] };
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut studies = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    studies.args(["run", "--quiet", "--release", "--package", "studies", "--manifest-path"]);
    studies.arg(workspace.join("Cargo.toml")).arg("--").args(json).arg(command).args(&forwarded.arguments);
    let status = studies.status();
    match status.map(|status| status.code()) {
        Ok(Some(code)) => ExitCode::from(u8::try_from(code).unwrap_or(BAD_INPUT)),
        // The program was ended by a signal, nearly always by Ctrl-C. As in shells, the code is 128 + 2 (SIGINT).
        Ok(None) => ExitCode::from(130),
        Err(error) => {
            let allowed = format!("needs cargo, to build the program `studies`: {error}");
            print_note(&format!("error: {}", InputError::new(allowed).field(command)));
            ExitCode::from(BAD_INPUT)
        }
    }
}
