//! `docs/hard-cases.md` against the tests and the patches that it names.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use test_support::pages::{read, workspace};

fn patches() -> Vec<PathBuf> {
    let files = std::fs::read_dir(workspace().join("tests/protections")).unwrap();
    let paths = files.map(|file| file.unwrap().path());
    paths.filter(|path| path.extension().is_some_and(|extension| extension == "patch")).collect()
}

/// Returns all Rust sources below a folder.
fn sources(folder: &Path) -> String {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let of = |path: PathBuf| match path.extension() {
        Some(extension) if extension == "rs" => read(&path),
        _ if path.is_dir() => sources(&path),
        _ => String::new(),
    };
    entries.map(of).collect()
}

/// Returns the cells of the page's tables by row, without headings.
fn rows() -> Vec<Vec<String>> {
    let page = read("docs/hard-cases.md");
    let cells = |line: &str| line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect();
    let rows = page.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| case "));
    rows.map(cells).collect()
}

#[test]
fn every_case_names_existing_tests_and_protections() {
    let mut protections = BTreeSet::new();
    let rows = rows();
    assert!(rows.len() > 35, "{} cases", rows.len());
    for row in &rows {
        let [case, why, bound, tested, taken_out] = &row[..] else { panic!("{row:?}: must have five cells") };
        assert!(!why.is_empty() && !bound.is_empty(), "{case}");
        let mut tests = 0;
        for link in tested.split("[`").skip(1) {
            let (name, rest) = link.split_once("`](").unwrap();
            let file = workspace().join("docs").join(rest.split_once(')').unwrap().0);
            let source = read(&file);
            let at = source.find(&format!("fn {name}(")).unwrap_or_else(|| panic!("{case}: no {name}"));
            // The attribute of a property test stands a line higher.
            let before = &source[at.saturating_sub(200)..at];
            assert!(before.contains("#[test]"), "{case}: {name} is not a test");
            tests += 1;
        }
        assert!(tests > 0, "{case} has no test");
        let named: Vec<_> = taken_out.split('`').skip(1).step_by(2).map(str::to_owned).collect();
        // Cases without a protection say "nothing to protect".
        assert_eq!(named.is_empty(), bound.contains("nothing to protect"), "{case}: {taken_out}");
        protections.extend(named);
    }
    let there: BTreeSet<_> =
        patches().iter().map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned()).collect();
    assert_eq!(protections, there);
}

#[test]
fn every_protection_patch_applies_and_names_a_test() {
    // A patch names the start of a test's name, or a module.
    let sources: String = ["tests/tests", "tests/support", "flight-core", "sim-host/src"]
        .map(|folder| sources(&workspace().join(folder)))
        .concat();
    for path in patches() {
        let text = read(&path);
        let fails: Vec<&str> = text.lines().map_while(|line| line.strip_prefix("fails: ")).collect();
        assert!(!fails.is_empty(), "{} names no test", path.display());
        for arguments in fails {
            let name = arguments.rsplit(' ').next().unwrap();
            let module = ["estimator", "log::read"].contains(&name);
            assert!(module || sources.contains(&format!("fn {name}")), "{}: no {name}", path.display());
        }
        let applies =
            Command::new("git").args(["apply", "--check"]).arg(&path).current_dir(workspace()).output();
        let applies = applies.unwrap();
        assert!(applies.status.success(), "{}: {}", path.display(), String::from_utf8_lossy(&applies.stderr));
    }
}
