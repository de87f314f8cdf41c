//! The examples in the help of a program.

use std::path::Path;
use std::process::Output;

/// Returns the commands in the list of a program's help, without `help` itself.
pub fn commands(help: &str) -> Vec<String> {
    let list =
        help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    // A wrapped line of a description begins with more than two spaces.
    let names = list.filter_map(|line| line.strip_prefix("  ")?.split(' ').next());
    names.filter(|name| !["", "help"].contains(name)).map(str::to_owned).collect()
}

/// Returns the indented lines of the section "Example:".
pub fn examples(help: &str) -> Vec<&str> {
    let section = help.lines().skip_while(|line| *line != "Example:").skip(1);
    section.map_while(|line| line.strip_prefix("  ")).collect()
}

/// Runs an example `sim-host …` in a directory. Asserts that it succeeds and that the files that it names exist.
pub fn run_example(example: &str, directory: &Path, program: impl Fn(&[&str], &Path) -> Output) {
    let words: Vec<&str> = example.split(' ').collect();
    assert_eq!(words[0], "sim-host", "{example}");
    let output = program(&words[1..], directory);
    assert_eq!(output.status.code(), Some(0), "{example}: {output:?}");
    for file in words.iter().filter(|word| word.contains('.')) {
        assert!(directory.join(file).is_file(), "{example}: {file} does not exist");
    }
}
