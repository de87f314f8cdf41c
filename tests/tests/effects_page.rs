//! `docs/effects.md` against the program: the page has a row for every effect, in order, with every key.

use std::collections::BTreeSet;

use sim_host::scene::{BUILT_IN, Scene};
use test_support::pages::read;

/// The shortest valid scene.
const BARE: &str = "[scene]\nduration_s = 1.0\nseed = 1\nvehicle = \"os4\"\nimu = \"paper\"\n";

fn page() -> String {
    read("docs/effects.md")
}

/// Returns every effect, in order of application.
fn every_effect() -> Vec<&'static str> {
    let text = include_str!("../../sim-host/benches/every_effect.toml");
    let scene = Scene::parse("every_effect.toml", text).expect("a valid scene");
    assert!(scene.left_out().is_empty(), "not in every_effect.toml: {:?}", scene.left_out());
    scene.effects()
}

/// Returns the table rows about effects: the name and the row.
fn rows(text: &str) -> Vec<(&str, &str)> {
    let row = |line| Some((str::split_once(str::strip_prefix(line, "| `")?, "` |")?.0, line));
    text.lines().filter_map(row).collect()
}

/// Returns the section with one row for each effect.
fn section(page: &str) -> &str {
    let (_, from) = page.split_once("\n## The effects\n").expect("the section of the effects");
    from.split_once("\n## ").expect("a section after it").0
}

/// Returns the texts in backticks.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

/// Returns the keys of a scene table, as the error for an unknown key lists them.
fn keys(header: &str) -> BTreeSet<String> {
    let message =
        Scene::parse("bare", &format!("{BARE}{header}\nno_such_key = 1\n")).unwrap_err().to_string();
    let (_, keys) = message.split_once("no_such_key: unknown key: ").expect(&message);
    let keys = keys.split(" (did you mean").next().unwrap_or_default();
    keys.strip_prefix("must be one of ").iter().flat_map(|keys| keys.split(", ")).map(str::to_owned).collect()
}

#[test]
fn effects_table_has_exactly_the_effects_in_order() {
    let page = page();
    let named: Vec<&str> = rows(section(&page)).into_iter().map(|(name, _)| name).collect();
    assert_eq!(named, every_effect());

    let exist: BTreeSet<&str> = every_effect().into_iter().collect();
    for built_in in BUILT_IN {
        let scene = Scene::load(built_in.name).unwrap();
        let all: BTreeSet<&str> = scene.effects().into_iter().chain(scene.left_out()).collect();
        assert_eq!(all, exist, "{}", built_in.name);
    }
    for (name, _) in rows(&page) {
        assert!(exist.contains(name), "unknown effect {name}");
    }
}

#[test]
fn every_effect_row_lists_its_keys() {
    let page = page();
    let mut count = 0;
    for (name, row) in rows(section(&page)).into_iter().filter(|(name, _)| !name.starts_with("fault.")) {
        for key in keys(&format!("[effects.{name}]")) {
            assert!(quoted(row).any(|quoted| quoted == key), "the row of {name} has no `{key}`");
            count += 1;
        }
    }
    assert!(count > 70, "only {count} keys");

    let (_, faults) = section(&page).split_once("\n### Faults\n").expect("the faults");
    for key in keys("[[fault]]") {
        assert!(quoted(faults).any(|quoted| quoted == key), "the faults have no `{key}`");
    }
}

/// The ablation tables list exactly the effects of their scenes.
#[test]
fn ablation_tables_list_the_effects_of_their_scenes() {
    let page = page();
    let mut scenes = 0;
    for built_in in BUILT_IN {
        let Some((_, table)) = page.split_once(&format!("\n### `{}`\n", built_in.name)) else { continue };
        let table = table.split_once("\n#").map_or(table, |(table, _)| table);
        let named: Vec<&str> = rows(table).into_iter().map(|(name, _)| name).collect();
        assert_eq!(named, Scene::load(built_in.name).unwrap().effects(), "{}", built_in.name);
        scenes += 1;
    }
    assert_eq!(scenes, 3);
}

#[test]
fn footnotes_are_defined_and_used() {
    let page = page();
    let notes = |text: &str| -> BTreeSet<String> {
        text.split("[^")
            .skip(1)
            .filter_map(|rest| rest.split_once(']'))
            .map(|(note, _)| note.into())
            .collect()
    };
    let is_definition = |line: &&str| line.starts_with("[^");
    let text: Vec<&str> = page.lines().filter(|line| !is_definition(line)).collect();
    let definitions: BTreeSet<String> = page
        .lines()
        .filter(is_definition)
        .map(|line| line.trim_start_matches("[^").split_once("]: ").expect("a footnote").0.to_owned())
        .collect();
    assert_eq!(notes(&text.join("\n")), definitions);
}
