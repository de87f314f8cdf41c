//! Runs the examples of every command's help.
//!
//! The commands are those that `sim-host --help` lists, so the test covers a new command without a change. The examples
//! of one command run in order in one temporary directory, so an example can use the files of those before it.

use std::path::Path;
use std::process::{Command, Output};

use test_support::help::{commands, examples, run_example};

/// Examples that do not run here, with the reason. A test in `src/cli/mod.rs` parses them.
const NOT_RUN: [(&str, &str); 4] = [
    ("sim-host hil hover --qemu", "builds the firmware and needs QEMU; tests/tests/hil.rs flies it"),
    ("sim-host hil hover --serial /dev/ttyUSB0 --log hover.csv", "needs a board at a serial port"),
    ("sim-host cost estimator --quick", "builds the program studies; its tests run the example"),
    ("sim-host paper --out paper", "builds the program studies; its tests run the example"),
];

/// Commands whose `--help` is printed by the program `studies`. Calling it would build that program, so the test takes
/// their examples from `sim-host help`.
const FORWARDED: [&str; 2] = ["cost", "paper"];

fn sim_host(arguments: &[&str], directory: &Path) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_sim-host"));
    program.args(arguments).current_dir(directory).env_remove("KESTREL_DATA").output().unwrap()
}

fn help(arguments: &[&str]) -> String {
    let output = sim_host(arguments, Path::new("."));
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn examples_of_every_help_run_and_write_their_files() {
    let commands = commands(&help(&["--help"]));
    assert!(commands.len() >= 12, "{commands:?}");
    let mut not_run = Vec::new();
    for command in commands.iter().map(String::as_str).chain(["--help"]) {
        let help = match command {
            "--help" => help(&["--help"]),
            forwarded if FORWARDED.contains(&forwarded) => help(&["help", forwarded]),
            command => help(&[command, "--help"]),
        };
        let examples = examples(&help);
        assert!(!examples.is_empty(), "{command}: the help has no example");
        let directory = tempfile::tempdir().unwrap();
        for example in examples {
            if NOT_RUN.iter().any(|(listed, _)| *listed == example) {
                not_run.push(example.to_owned());
                continue;
            }
            run_example(example, directory.path(), sim_host);
        }
    }
    let listed: Vec<&str> = NOT_RUN.iter().map(|(example, _)| *example).collect();
    not_run.sort_by_key(|example| listed.iter().position(|listed| listed == example));
    assert_eq!(not_run, listed, "NOT_RUN lists an example that no help has");
}
