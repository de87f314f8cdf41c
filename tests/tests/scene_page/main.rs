//! `docs/scene.md` against the parser: tables, keys, types, units, ranges, defaults, examples and error messages.
//!
//! The keys come from the parser's error messages (`parser.rs`). Each key is set to a table with an unknown key,
//! `{ no_such_key = 1 }`. For a table the error lists the keys, and each of them is tried in turn. For a word it lists the
//! permitted words, for any other value it names the type. **Any other error fails the test.** So no table can be missed,
//! neither one that accepts unknown keys nor one of a new type.
//!
//! Ranges and defaults are tried in a few scenes that together have every key (`document.rs`).

mod document;
mod parser;
mod rows;

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::Path;

use document::{VEHICLE, bases, content, digest, get, parsed, with};
use parser::{Kind, Parser, quoted};
use rows::{Row, allowed, beside, end, literal, number, rows, same};
use sim_host::scene::{BUILT_IN, Scene};
use test_support::pages::read;
use toml::{Table, Value};

fn page() -> String {
    read("docs/scene.md")
}

#[test]
fn page_has_exactly_the_keys_of_the_parser() {
    let (parser, page) = (Parser::all(), page());
    let rows = rows(&page);
    let mut seen = BTreeSet::new();
    for row in &rows {
        let key = &row.key;
        assert!(seen.insert(key.clone()), "the page has {key} twice");
        let kind = parser.keys.get(key).unwrap_or_else(|| panic!("the parser has no key {key}"));
        let parent = key.rsplit_once('.').map_or("", |(parent, _)| parent);
        assert_eq!(
            row.in_array,
            parser.arrays.contains(parent),
            "the heading of {key} has as many brackets as its table"
        );
        assert!(row.meaning.ends_with('.'), "{key} has no meaning");
        match kind {
            Kind::Words(words) => {
                assert_eq!(row.type_name, "string", "type of {key}");
                assert_eq!(row.words(), *words, "words of {key}");
            }
            Kind::Value(name) => assert_eq!(row.type_name, *name, "type of {key}"),
            Kind::Table(_) | Kind::Tables(_) => unreachable!("a table is no leaf"),
        }
    }
    let missing: Vec<&String> = parser.keys.keys().filter(|key| !seen.contains(*key)).collect();
    assert!(missing.is_empty(), "the page lacks {missing:?}");
}

/// Returns the bases that have the table of a key, or in which the key needs no table.
fn usable<'a>(bases: &'a [Table], row: &Row) -> impl Iterator<Item = &'a Table> {
    let parent = row.key.rsplit_once('.').map(|(parent, _)| match parent.strip_prefix("vehicle") {
        Some(below) => format!("{VEHICLE}{below}"),
        None => parent.into(),
    });
    let needs_none = row.key.starts_with("tolerances.");
    bases
        .iter()
        .filter(move |base| needs_none || parent.as_ref().is_none_or(|parent| get(base, parent).is_some()))
}

/// The error for a value outside the range has the range and the unit of the page. If the error names no range, the ends
/// of the page's range must be accepted.
#[test]
fn ranges_and_units_equal_those_of_the_errors() {
    let (bases, page) = (bases(), page());
    let mut checked = 0;
    for row in rows(&page) {
        if row.type_name.contains("number") || row.type_name == "integer" {
            for clause in row.range.split("; ") {
                check_range(&bases, &row, clause);
                checked += 1;
            }
        }
    }
    assert!(checked > 200, "only {checked} ranges");
}

fn check_range(bases: &[Table], row: &Row, clause: &str) {
    let key = &row.key;
    let errors = |value: &dyn Fn(&Table) -> Option<Value>| -> Vec<(&Table, String)> {
        usable(bases, row)
            .filter_map(|base| {
                let error = parsed(&with(base, key, Some(value(base)?))).err()?;
                row.is_in(&error).then_some((base, error.0))
            })
            .collect()
    };
    if clause == "refused" {
        let refused = errors(&|base| Some(row.value(base, 1.0)));
        assert_eq!(refused.len(), bases.len(), "{key} is not refused");
        return;
    }
    if let Some(count) = clause.strip_suffix(" entries") {
        let (low, high) = count.split_once(" to ").expect("two numbers");
        for count in [low.parse::<usize>().unwrap() - 1, high.parse::<usize>().unwrap() + 1] {
            let said = errors(&|_| Some(Value::Array(vec![1.0.into(); count])));
            assert!(
                !said.is_empty()
                    && said.iter().all(|(_, said)| said.ends_with(&format!("must have {clause}")))
            );
        }
        return;
    }

    let property =
        ["determinant ", "squared length of a row "].into_iter().find(|name| clause.starts_with(name));
    let ends_of = |base: &Table| {
        let clause = clause.strip_prefix(property.unwrap_or_default()).unwrap_or(clause);
        let (low, high, exclusive) =
            row.ends(clause).unwrap_or_else(|| panic!("{key}: not a range: {clause}"));
        Some((end(base, row, low)?, end(base, row, high)?, exclusive))
    };
    for above in [false, true] {
        let outside = |base: &Table| {
            let (low, high, exclusive) = ends_of(base)?;
            let at = if above { high } else { low };
            match property {
                Some("determinant ") => {
                    // The determinant of this matrix is 4, that of s times the matrix 4 s³.
                    let scale = 1.01 * libm::cbrt(high / 4.0) * if above { 1.0 } else { -1.0 };
                    let rows = [[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0]];
                    let row = |row: [f64; 3]| Value::from(row.map(|x| x * scale).to_vec());
                    return Some(Value::from(rows.map(row).to_vec()));
                }
                Some(_) if above => {
                    let long = 1.01 * libm::sqrt(high);
                    return Some(literal(&format!("[[{long}, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]")));
                }
                // A square is never below zero.
                Some(_) => return None,
                None => {}
            }
            if row.type_name == "integer" {
                // Parsed from the text, because a float of this size is not exact.
                let written = if above { clause.rsplit(' ').next() } else { clause.split(' ').next() };
                let at: i128 = written?.parse().expect("an integer");
                // `None` above the largest integer of `toml::Value`.
                return i64::try_from(at + if above { 1 } else { -1 }).ok().map(Value::from);
            }
            let step = if exclusive {
                0.0
            } else if at == 0.0 {
                1e-6
            } else {
                1e-3 * at.abs()
            };
            Some(row.value(base, if above { at + step } else { at - step }))
        };
        if bases.iter().all(|base| outside(base).is_none()) {
            continue;
        }
        let errors = errors(&outside);
        assert!(!errors.is_empty(), "{key}: a value outside {clause} is not refused");
        for (base, said) in errors {
            let (low, high, exclusive) = ends_of(base).expect("it was outside of them");
            let Some((said_low, said_high, said_exclusive, unit)) = allowed(&said) else {
                let outside = |base: &Table| outside(base).map(|value| parsed(&with(base, key, value)));
                assert!(
                    usable(bases, row).all(|base| outside(base).is_none_or(|answer| answer.is_err())),
                    "{key}: a value outside {clause} is not refused"
                );
                for end in [low, high] {
                    let inside = |base: &Table| parsed(&with(base, key, row.value(base, end))).is_ok();
                    assert!(usable(bases, row).any(inside), "{key} = {end} is refused");
                }
                continue;
            };
            assert!(
                same(low, said_low) && same(high, said_high) && exclusive == said_exclusive,
                "{key}: the page has {clause}, the parser says: {said}"
            );
            if let Some(property) = property {
                assert!(said.contains(property.trim()), "{key}: {said}");
                continue;
            }
            let unit = unit.trim().replace("deg", "°");
            assert!(
                // The error about a whole number has no unit.
                if unit.is_empty() {
                    row.unit == "–" || row.type_name == "integer"
                } else {
                    row.unit == unit
                } || row.unit.starts_with(&format!("{unit} per ")),
                "{key}: the page has the unit {}, the parser says: {said}",
                row.unit
            );
        }
    }
}

/// The error for an unknown word lists all permitted words. `any` accepts every word.
#[test]
fn words_equal_those_of_the_errors() {
    let (bases, page) = (bases(), page());
    for row in rows(&page) {
        let key = &row.key;
        let answers = |value: Value| -> Vec<_> {
            usable(&bases, &row).map(|base| parsed(&with(base, key, value.clone()))).collect()
        };
        let accepted = |value: Value| answers(value).iter().any(Result::is_ok);
        let refused = |word: &str| {
            let value = if row.type_name == "3 strings" { vec![word; 3].into() } else { word.into() };
            let errors: Vec<_> =
                answers(value).into_iter().filter_map(Result::err).filter(|e| row.is_in(e)).collect();
            let (said, _) = errors.first().unwrap_or_else(|| panic!("{key} takes {word}"));
            said.clone()
        };
        match (row.type_name.as_str(), row.range.as_str()) {
            ("boolean", range) => {
                assert_eq!(range, "any", "{key}");
                assert!(accepted(true.into()) && accepted(false.into()), "{key}");
            }
            ("string", "any") => assert!(accepted("no such word".into()), "{key} does not take any word"),
            ("string", "the capital letters A, E, T and R in any order") => {
                refused("AETT");
                refused("AETRA");
                assert!(accepted("RETA".into()), "{key}");
            }
            ("number or string", _) => {
                let said = refused("no such word");
                let (_, allowed) = said.split_once(": must be ").unwrap_or_else(|| panic!("{key}: {said}"));
                let named: Vec<&str> = allowed.split('"').skip(1).step_by(2).collect();
                assert_eq!(row.words(), named, "words of {key}");
                assert!(named.iter().all(|word| accepted((*word).into())), "{key}: {said}");
            }
            ("string" | "3 strings", _) if key == "include" => {
                assert!(refused("no such word").contains("is not a built-in scene"));
                assert_eq!(row.words(), BUILT_IN.iter().map(|scene| scene.name).collect::<Vec<_>>());
            }
            ("string" | "3 strings", _) => {
                let said = refused("no such word");
                let (_, list) = said.split_once("must be one of ").unwrap_or_else(|| panic!("{key}: {said}"));
                // A path may be given, too.
                let list = list.split_once("; or ").map_or(list, |(list, _)| list);
                assert_eq!(row.words(), list.split(", ").collect::<Vec<_>>(), "{key}");
            }
            _ => {}
        }
    }
}

/// A key that is left out has the default of the page. A required key causes an error.
#[test]
fn defaults_hold_when_the_key_is_left_out() {
    let (bases, page) = (bases(), page());
    for row in rows(&page) {
        let Row { key, default, .. } = &row;
        let without: Vec<_> = usable(&bases, &row).map(|base| parsed(&with(base, key, None))).collect();
        let name = key.rsplit('.').next().unwrap_or_default();
        let missed = without
            .iter()
            .filter(|answer| answer.as_ref().is_err_and(|(said, _)| said.contains(name)))
            .count();
        if let Some(condition) = default.strip_prefix("required") {
            let all = condition.is_empty();
            assert!(missed > 0 && (!all || missed == without.len()), "{key} is not required: {without:?}");
            if let Some((_, text)) = condition.split_once("else ") {
                check_default(&bases, &row, &|_| Some(literal(text.trim_matches('`'))));
            }
            continue;
        }
        assert!(without.iter().any(Result::is_ok), "{key} cannot be left out: {without:?}");
        match default.as_str() {
            "no included scene" | "does not land" | "the base's" | "not built" | "not drawn" => {}
            "for good" => {
                check_default(&bases, &row, &|_| Some(row.ends(&row.range)?.1.parse::<f64>().ok()?.into()))
            }
            "the hover speed" => {
                check_default(&bases, &row, &|base| Some(parsed(base).ok()?.vehicle.hover_rad_s().into()));
            }
            "the file's" => check_default(&bases, &row, &|base| beside(base, &row, key)),
            _ if default.starts_with("as ") => check_default(&bases, &row, &|base| {
                let value = beside(base, &row, &quoted(default)[0])?;
                Some(if default.ends_with(", in s") { (number(&value) / 1000.0).into() } else { value })
            }),
            _ => check_default(&bases, &row, &|_| Some(literal(default.trim_matches('`')))),
        }
    }
}

/// Asserts that leaving the key out gives the same result as this value, and that another value gives a different one.
/// The results are scenes; if a scene distinguishes an explicit value from a default, they are flights.
fn check_default(bases: &[Table], row: &Row, value: &dyn Fn(&Table) -> Option<Value>) {
    let key = &row.key;
    let (mut compared, mut differs) = (0, false);
    for base in usable(bases, row) {
        let Some(value) = value(base) else { continue };
        let (Ok(without), Ok(said)) =
            (parsed(&with(base, key, None)), parsed(&with(base, key, value.clone())))
        else {
            continue;
        };
        let scenes = content(&without) == content(&said);
        assert!(scenes || digest(&without) == digest(&said), "{key}: the default is not {value}");
        let other_differs = |other: Value| {
            parsed(&with(base, key, other)).is_ok_and(|other| {
                if scenes { content(&without) != content(&other) } else { digest(&without) != digest(&other) }
            })
        };
        differs |= others(base, row, &value).into_iter().any(other_differs);
        compared += 1;
    }
    assert!(compared > 0, "{key}: no scene to try its default in");
    assert!(differs, "{key}: no value does anything else than its default");
}

/// Returns other values, of which some are in range.
fn others(base: &Table, row: &Row, value: &Value) -> Vec<Value> {
    fn scaled(value: &Value) -> Option<Value> {
        Some(match value {
            Value::Float(number) => (number * 1.01).into(),
            Value::Integer(number) => (number + 1).into(),
            Value::Array(entries) => Value::Array(entries.iter().map(scaled).collect::<Option<_>>()?),
            Value::Boolean(is) => (!is).into(),
            _ => return None,
        })
    }
    let mut others: Vec<Value> = row.words().into_iter().map(Value::from).collect();
    others.extend(["another".into(), "RETA".into(), vec!["left", "forward", "down"].into()]);
    others.extend(get(base, &row.key).cloned());
    others.extend(scaled(value));
    if row.type_name.contains("number") {
        let ends = row.ends(row.range.split("; ").next().unwrap_or_default());
        let ends = ends.into_iter().flat_map(|(low, high, _)| [low, high]);
        others.extend(ends.filter_map(|end| end.parse().ok()).map(|end| row.value(base, end)));
        // A larger entry or row.
        others.extend([0.9, 1.1].map(|number| row.value(base, number)));
    }
    others.retain(|other| other != value);
    others
}

/// Returns the fenced blocks of a language.
fn blocks<'a>(page: &'a str, language: &str) -> Vec<&'a str> {
    let fence = format!("```{language}\n");
    page.split(&fence as &str).skip(1).map(|rest| rest.split_once("```").expect("a closed block").0).collect()
}

/// Each TOML block is a scene, or a file that a scene on the page names.
#[test]
fn examples_are_scenes() {
    let page = page();
    let files: BTreeMap<&str, &str> = blocks(&page, "toml")
        .into_iter()
        .map(|block| (block.strip_prefix("# ").and_then(|b| b.split_once('\n')).expect("a name").0, block))
        .collect();
    assert_eq!(files.len(), blocks(&page, "toml").len(), "two examples of one name");
    let used = std::cell::RefCell::new(BTreeSet::new());
    let read = |path: &Path| {
        let name = path.to_str().unwrap_or_default();
        let (name, text) = files.get_key_value(name).ok_or_else(|| io::Error::other("not on the page"))?;
        used.borrow_mut().insert(*name);
        Ok((*text).to_owned())
    };
    let answers: Vec<_> = files
        .iter()
        .map(|(name, text)| (*name, Scene::parse_with(name, text, &read).map_err(|e| e.to_string())))
        .collect();
    for (name, answer) in &answers {
        assert!(answer.is_ok() || used.borrow().contains(name), "{name}: {:?}", answer.as_ref().err());
    }
    assert!(answers.iter().filter(|(_, answer)| answer.is_ok()).count() >= 4);
}

/// Each line of the block under "Errors" causes the error below it.
#[test]
fn errors_equal_those_of_the_page() {
    let page = page();
    let (_, section) = page.split_once("\n## Errors\n").expect("the section");
    let block = blocks(section, "text")[0];
    let lines: Vec<&str> = block.lines().collect();
    for pair in lines.chunks(2) {
        let [written, error] = pair else { panic!("a line without its error") };
        let text = format!("include = \"hover\"\n{written}\n");
        let said = Scene::parse("my-scene.toml", &text).expect_err(written).to_string();
        assert_eq!(error.trim(), said);
    }
    assert!(lines.len() >= 10);
}
