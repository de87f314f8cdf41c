//! `docs/safety.md` against the arming table: the page's two lists are the program's, word for word.
//!
//! To write them anew after a change: `KESTREL_WRITE_DOCS=1 cargo test -p tests --test safety_page`.

use std::fmt::Write;
use std::path::Path;

use flight_core::ArmState;
use flight_core::arming::table::{Conditions, Row, rows};

/// What a condition means, from the table's own comments: each constant's doc comment, in one line.
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
    let mut text = String::from("| in | when | unless | go to | and say |\n|---|---|---|---|---|\n");
    for Row { from, when, unless, to, cause } in ArmState::ALL.into_iter().flat_map(rows) {
        let to = if from == to { "stay: refused".to_owned() } else { format!("`{}`", to.name()) };
        let from = from.name();
        writeln!(text, "| `{from}` | {} | {} | {to} | {} |", names(*when), names(*unless), cause.text())
            .unwrap();
    }
    text
}

/// The page with what stands between `<!-- mark -->` and the next `<!-- end -->` exchanged.
fn with(page: &str, mark: &str, list: &str) -> String {
    let opening = format!("<!-- {mark} -->\n");
    let (before, rest) = page.split_once(&opening).expect("the page has the mark");
    let (_, after) = rest.split_once("<!-- end -->").expect("and its end");
    format!("{before}{opening}{list}<!-- end -->{after}")
}

#[test]
fn the_page_is_the_table() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/safety.md");
    let page = std::fs::read_to_string(&path).unwrap();
    let should = with(&with(&page, "conditions", &conditions()), "table", &table());
    if std::env::var_os("KESTREL_WRITE_DOCS").is_some() {
        return std::fs::write(&path, &should).unwrap();
    }
    assert!(page == should, "docs/safety.md is not what the arming table says: see this test's first lines");
}

#[test]
fn every_condition_has_its_meaning_and_every_state_its_line() {
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
fn every_test_that_the_page_names_exists() {
    let page = include_str!("../../docs/safety.md");
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let files = page.split('`').skip(1).step_by(2).filter(|quoted| quoted.ends_with(".rs"));
    assert!(files.clone().count() > 10);
    for file in files {
        assert!(root.join(file).is_file(), "{file}");
    }
}
