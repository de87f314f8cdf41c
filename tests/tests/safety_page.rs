//! Checks that the two generated lists of `docs/safety.md` equal those of the arming table in the program.
//!
//! To write the lists again after a change: `KESTREL_WRITE_DOCS=1 cargo test -p tests --test safety_page`.

use std::fmt::Write;
use std::path::Path;

use flight_core::ArmState;
use flight_core::arming::table::{Conditions, Row, rows};

/// Returns the meaning of each condition: the doc comment of its constant in the table's source, in one line.
fn meanings() -> Vec<(String, String)> {
    let source = include_str!("../../flight-core/src/arming/table.rs");
    let mut found = vec![];
    let mut comment = String::new();
    for line in source.lines().map(str::trim) {
        if let Some(text) = line.strip_prefix("/// ") {
            comment = [comment.as_str(), text].join(" ").trim().to_owned();
        } else if let Some((name, _)) =
            line.strip_prefix("const ").and_then(|rest| rest.split_once(" = 1 <<"))
        {
            found.push((name.to_owned(), std::mem::take(&mut comment)));
        } else {
            comment.clear();
        }
    }
    found
}

fn names(conditions: Conditions) -> String {
    let names: Vec<String> = conditions.iter_names().map(|(name, _)| format!("`{name}`")).collect();
    if names.is_empty() { "–".into() } else { names.join(", ") }
}

fn conditions() -> String {
    let mut text = String::from("| condition | holds when |\n|---|---|\n");
    for (name, meaning) in meanings() {
        writeln!(text, "| `{name}` | {meaning} |").unwrap();
    }
    text
}

fn table() -> String {
    let mut text = String::from(
        "| state | all of these hold | none of these holds | next state | cause in the log |\n|---|---|---|---|---|\n",
    );
    for Row { from, when, unless, to, cause } in ArmState::ALL.into_iter().flat_map(rows) {
        let to = if from == to { "refused".to_owned() } else { format!("`{}`", to.name()) };
        let from = from.name();
        writeln!(text, "| `{from}` | {} | {} | {to} | {} |", names(*when), names(*unless), cause.text())
            .unwrap();
    }
    text
}

/// Returns the page with the text between `<!-- mark -->` and the next `<!-- end -->` replaced by `list`.
fn replace_list(page: &str, mark: &str, list: &str) -> String {
    let opening = format!("<!-- {mark} -->\n");
    let (before, rest) = page.split_once(&opening).expect("the mark on the page");
    let (_, after) = rest.split_once("<!-- end -->").expect("the end mark on the page");
    format!("{before}{opening}{list}<!-- end -->{after}")
}

#[test]
fn safety_page_equals_the_arming_table() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/safety.md");
    let page = std::fs::read_to_string(&path).unwrap();
    let expected = replace_list(&replace_list(&page, "conditions", &conditions()), "table", &table());
    if std::env::var_os("KESTREL_WRITE_DOCS").is_some() {
        return std::fs::write(&path, &expected).unwrap();
    }
    assert!(
        page == expected,
        "docs/safety.md differs from the arming table; KESTREL_WRITE_DOCS=1 updates it"
    );
}

#[test]
fn every_condition_and_state_is_described() {
    let meanings = meanings();
    let bits: Vec<&str> = Conditions::all().iter_names().map(|(name, _)| name).collect();
    assert_eq!(meanings.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(), bits);
    assert!(meanings.iter().all(|(_, meaning)| meaning.len() > 10));

    let page = include_str!("../../docs/safety.md");
    for state in ArmState::ALL {
        assert!(page.contains(&format!("\n| `{}` | ", state.name())), "{}", state.name());
    }
}

#[test]
fn test_files_named_by_the_page_exist() {
    let page = include_str!("../../docs/safety.md");
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let files = page.split('`').skip(1).step_by(2).filter(|quoted| quoted.ends_with(".rs"));
    assert!(files.clone().count() > 10);
    for file in files {
        assert!(root.join(file).is_file(), "{file}");
    }
}
