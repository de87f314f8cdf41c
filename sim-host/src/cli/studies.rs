//! The commands `cost` and `paper`, which are the program `studies`: what only they need would double the time to build
//! this one.

use std::env;
use std::path::Path;
use std::process::{Command, ExitCode};

use input::InputError;
use sim_host::command::BAD_INPUT;

/// Arguments that the other program reads.
#[derive(clap::Args)]
#[command(disable_help_flag = true)]
pub struct Passed {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    arguments: Vec<String>,
}

/// Builds the program, if it is not up to date, and runs it in this one's place.
pub fn run(command: &str, passed: &Passed, json: bool) -> ExitCode {
    let json: &[&str] = if json { &["--json"] } else { &[] };
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut studies = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    studies.args(["run", "--quiet", "--release", "--package", "studies", "--manifest-path"]);
    studies.arg(workspace.join("Cargo.toml")).arg("--").args(json).arg(command).args(&passed.arguments);
    let status = studies.status();
    match status.map(|status| status.code()) {
        Ok(Some(code)) => ExitCode::from(u8::try_from(code).unwrap_or(BAD_INPUT)),
        // Ended by a signal: 128 and its number, as a shell says; here nearly always Ctrl-C.
        Ok(None) => ExitCode::from(130),
        Err(error) => {
            let allowed = format!("is in the program `studies`, which cargo must build: {error}");
            eprintln!("error: {}", InputError::new(allowed).field(command));
            ExitCode::from(BAD_INPUT)
        }
    }
}
