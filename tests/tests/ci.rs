//! `.ci/run` or `.ci/nightly` runs every ignored test, and the workflow runs every job of both scripts.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use test_support::pages::{read, workspace};

/// Collects the Rust sources below `directory`.
fn test_sources(directory: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() && !matches!(name, "target" | ".git") {
            test_sources(&path, found);
        } else if name.ends_with(".rs") {
            found.push(path);
        }
    }
}

/// Returns the package and the test target of a source: `A/tests/B.rs` and `A/tests/B/C.rs` belong to target B of the
/// package in A.
fn target(source: &Path) -> Option<(String, String)> {
    let tests = source.ancestors().find(|folder| folder.file_name().is_some_and(|name| name == "tests"))?;
    let manifest = fs::read_to_string(tests.parent()?.join("Cargo.toml")).ok()?;
    let package =
        manifest.lines().find_map(|line| line.strip_prefix("name = "))?.trim_matches('"').to_owned();
    let target = source.strip_prefix(tests).ok()?.iter().next()?.to_str()?;
    Some((package, target.trim_end_matches(".rs").to_owned()))
}

#[test]
fn every_ignored_test_is_run_by_ci() {
    let scripts = [read(".ci/run"), read(".ci/nightly")].concat();
    let runs = |package: &str, target: &str| {
        scripts.lines().any(|line| {
            let words: Vec<&str> = line.split_whitespace().collect();
            let pair = |option: &str, value: &str| words.windows(2).any(|pair| pair == [option, value]);
            words.starts_with(&["cargo", "test"])
                && pair("-p", package)
                && pair("--test", target)
                && (words.contains(&"--ignored") || words.contains(&"--include-ignored"))
        })
    };
    let mut sources = Vec::new();
    test_sources(&workspace(), &mut sources);
    let mut targets = BTreeSet::new();
    for source in sources {
        // Written in two parts, so that this file itself does not count.
        if fs::read_to_string(&source).unwrap().contains(concat!("#[", "ignore")) {
            let target = target(&source);
            targets.insert(target.unwrap_or_else(|| panic!("{}: not an integration test", source.display())));
        }
    }
    assert!(targets.len() >= 8, "{targets:?}");
    for (package, target) in targets {
        assert!(runs(&package, &target), "no line of .ci runs the ignored tests of {target} in {package}");
    }
}

#[test]
fn workflow_runs_every_job_of_both_scripts() {
    let workflow = read(".github/workflows/ci.yml");
    for (script, place) in
        [(".ci/run", ".ci/run ${{ matrix.job }}"), (".ci/nightly", ".ci/nightly ${{ matrix.job }}")]
    {
        assert!(workflow.contains(place), "{place}");
        let text = read(script);
        // The default `jobs=(a b c)` lists all jobs.
        let jobs = text.split_once("|| jobs=(").unwrap().1.split_once(')').unwrap().0.replace(' ', ", ");
        assert!(workflow.contains(&format!("job: [{jobs}]")), "{script}: [{jobs}]");
        for job in jobs.split(", ") {
            assert!(text.contains(&format!("\n{job}() {{")), "{script} has no function {job}");
        }
    }
}
