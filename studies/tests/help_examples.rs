//! Runs the examples in the help of `cost` and `paper`.
//!
//! The commands are those that `studies --help` lists. The examples name `sim-host`, which runs this program.

use std::path::Path;
use std::process::{Command, Output};

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
    let program = help(&["--help"]);
    let list =
        program.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    let names = list
        .filter_map(|line| line.strip_prefix("  ")?.split(' ').next())
        .filter(|name| !["", "help"].contains(name));
    for command in names {
        let help = help(&[command, "--help"]);
        assert!(help.contains(&format!("Usage: sim-host {command} ")), "{help}");
        let section = help.lines().skip_while(|line| *line != "Example:").skip(1);
        let examples: Vec<&str> = section.map_while(|line| line.strip_prefix("  sim-host ")).collect();
        assert!(!examples.is_empty(), "{command}: the help has no example");
        let directory = tempfile::tempdir().unwrap();
        for example in examples {
            let arguments: Vec<&str> = example.split(' ').collect();
            let output = studies(&arguments, directory.path());
            assert_eq!(output.status.code(), Some(0), "{example}: {output:?}");
            for file in arguments.iter().filter(|argument| argument.contains('.')) {
                assert!(directory.path().join(file).is_file(), "{example}: {file} does not exist");
            }
        }
    }
}
