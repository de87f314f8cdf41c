//! Runs the examples in the help of `cost` and `paper`.
//!
//! The commands are those that `studies --help` lists. The examples name `sim-host`, which runs this program.

use std::path::Path;
use std::process::{Command, Output};

use test_support::help::{commands, examples, run_example};

fn studies(arguments: &[&str], directory: &Path) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_studies"));
    program.args(arguments).current_dir(directory).env_remove("KESTREL_DATA").output().unwrap()
}

fn help(arguments: &[&str]) -> String {
    let output = studies(arguments, Path::new("."));
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn examples_of_every_help_run() {
    for command in commands(&help(&["--help"])) {
        let help = help(&[&command, "--help"]);
        assert!(help.contains(&format!("Usage: sim-host {command} ")), "{help}");
        let examples = examples(&help);
        assert!(!examples.is_empty(), "{command}: the help has no example");
        let directory = tempfile::tempdir().unwrap();
        for example in examples {
            run_example(example, directory.path(), studies);
        }
    }
}
