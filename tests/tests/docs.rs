//! Checks that the code and tests which `docs/paper.md` names exist in the linked files. Also checks figures
//! of the firmware on several pages.
//!
//! In `docs/paper.md` a paragraph that starts with **Implemented.** or **Tested by** lists names in backticks, each
//! followed, directly or after more names, by a link to the file that has them.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use test_support::pages::{anchors, pages, read, workspace};

/// Returns the paragraphs of the page, without its formulas.
fn paragraphs() -> Vec<String> {
    let page = read("docs/paper.md");
    let outside = page.split("```").step_by(2).collect::<Vec<_>>().join("\n\n");
    outside.split("\n\n").map(|p| p.trim().to_owned()).filter(|p| !p.is_empty()).collect()
}

/// Returns the names in backticks, each with the file of the next link: `name` in \[text\](file).
fn named(paragraph: &str) -> Vec<(String, PathBuf)> {
    let (mut found, mut waiting) = (vec![], vec![]);
    let mut rest = paragraph;
    while let Some(at) = rest.find(['`', '[']) {
        let (opening, after) = rest[at..].split_at(1);
        let closing = if opening == "`" { "`" } else { "]" };
        let (inside, after) = after.split_once(closing).unwrap_or_else(|| panic!("not closed: {rest}"));
        rest = after;
        if opening == "`" {
            waiting.push(inside.to_owned());
        } else if let Some((target, after)) = rest.strip_prefix('(').and_then(|r| r.split_once(')')) {
            rest = after;
            let file = workspace().join("docs").join(target);
            found.extend(waiting.drain(..).map(|name| (name, file.clone())));
        }
    }
    // Behind the last link there are only remarks, such as the name of a scene.
    let stray = waiting.iter().find(|name| name.contains(['_', ':']));
    assert!(stray.is_none(), "{stray:?} has no file");
    found
}

/// Returns the text behind `word` if `text` starts with that whole word.
fn after_word<'a>(text: &'a str, word: &str) -> Option<&'a str> {
    let rest = text.strip_prefix(word)?;
    (!rest.starts_with(|c: char| c.is_alphanumeric() || c == '_')).then_some(rest)
}

/// Returns the functions of a source that have the attribute `#[test]`.
fn tests_in(source: &str) -> BTreeSet<String> {
    let mut tests = BTreeSet::new();
    let mut is_test = false;
    for line in source.lines().map(str::trim) {
        if line == "#[test]" {
            is_test = true;
        } else if let Some(name) = line.strip_prefix("fn ") {
            if is_test {
                tests.extend(name.split_once('(').map(|(name, _)| name.to_owned()));
            }
            is_test = false;
        }
    }
    tests
}

/// Returns whether the source defines the last part of `name` (a function, type, constant, field or variant) and
/// contains the other parts.
fn defines(source: &str, name: &str) -> bool {
    let mut parts: Vec<&str> = name.split("::").collect();
    let last = parts.pop().unwrap_or_default();
    let is_definition = |line: &str| {
        let line = line.trim();
        let line = line.strip_prefix("pub").map_or(line, |rest| {
            rest.strip_prefix('(').and_then(|r| r.split_once(')')).map_or(rest, |(_, rest)| rest).trim_start()
        });
        let line = line.strip_prefix("const fn").map_or(line, |_| &line["const ".len()..]);
        ["fn", "struct", "enum", "const", "trait"].iter().any(|keyword| {
            after_word(line, keyword).is_some_and(|rest| after_word(rest.trim_start(), last).is_some())
        }) || after_word(line, last).is_some_and(|rest| rest.starts_with([':', '(', ',', ' ']))
    };
    source.lines().any(is_definition) && parts.iter().all(|part| source.contains(part))
}

#[test]
fn paper_page_names_existing_tests() {
    let mut names = BTreeSet::new();
    for paragraph in paragraphs().iter().filter(|p| p.starts_with("**Tested by**")) {
        for (name, file) in named(paragraph) {
            // Names without an underscore are scenes or estimators in the remarks.
            if !name.contains('_') {
                continue;
            }
            assert!(tests_in(&read(&file)).contains(&name), "{} has no test {name}", file.display());
            names.insert(name);
        }
    }
    assert!(names.len() > 60, "only {} tests are named", names.len());

    // The page names every test of the paper.
    let own = std::fs::read_dir(workspace().join("tests/tests/paper")).unwrap();
    for file in own.map(|entry| entry.unwrap().path()) {
        for test in tests_in(&read(&file)) {
            assert!(names.contains(&test), "docs/paper.md does not name {test} of {}", file.display());
        }
    }
}

#[test]
fn paper_page_names_existing_code() {
    let mut count = 0;
    for paragraph in paragraphs().iter().filter(|p| p.starts_with("**Implemented.**")) {
        for (name, file) in named(paragraph) {
            assert!(defines(&read(&file), &name), "{} does not define {name}", file.display());
            count += 1;
        }
    }
    assert!(count > 25, "only {count} names");
}

#[test]
fn every_equation_has_its_four_parts() {
    let paragraphs = paragraphs();
    let sections: Vec<_> = paragraphs.split(|p| p.starts_with('#')).collect();
    let titles = paragraphs.iter().filter(|p| p.starts_with('#'));
    let mut equations = 0;
    for (title, body) in titles.zip(&sections[1..]).filter(|(title, _)| title.starts_with("### ")) {
        for part in ["**Printed.**", "**Wrong or ambiguous.**", "**Implemented.**", "**Tested by**"] {
            assert_eq!(body.iter().filter(|p| p.starts_with(part)).count(), 1, "{title}: {part}");
        }
        equations += 1;
    }
    assert_eq!(equations, 12);
}

#[test]
fn links_of_every_page_resolve() {
    for page in pages() {
        let text = read(&page);
        let outside = text.split("```").step_by(2).collect::<String>();
        for (target, _) in outside.split("](").skip(1).filter_map(|rest| rest.split_once(')')) {
            if target.starts_with("http") {
                continue;
            }
            let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
            let path =
                if file.is_empty() { page.clone().into() } else { Path::new(&page).with_file_name(file) };
            assert!(workspace().join(&path).exists(), "{page}: no file {target}");
            assert!(
                anchor.is_empty() || anchors(&read(&path)).contains(anchor),
                "{page}: no heading for {target}"
            );
        }
    }
}

/// Formats a count with a comma before every three digits.
fn grouped(count: i64) -> String {
    if count < 1_000 { count.to_string() } else { format!("{},{:03}", grouped(count / 1_000), count % 1_000) }
}

/// Figures of the firmware on the pages are the last measured ones, in `tests/image/budgets.toml` and
/// `studies/src/cost/m4.toml`, which the image tests check.
#[test]
fn firmware_figures_on_pages_equal_the_budgets() {
    let budgets: toml::Table = read("tests/image/budgets.toml").parse().unwrap();
    let last = |kind: &str, name: &str| budgets[kind][name][1].as_integer().unwrap();
    let instructions = |name: &str| grouped(last("instructions", name));
    let means: toml::Table = read("studies/src/cost/m4.toml").parse().unwrap();
    let mean = |name: &str| {
        let mean = &means[name]["instructions"];
        mean.as_float().map_or_else(|| mean.as_integer().unwrap(), |mean| mean.round() as i64)
    };
    for (page, places) in [
        (
            "README.md",
            &[
                "9-axis update of `paper` takes {estimator paper 9-axis} instructions",
                "ESCs' pulses takes {chain of paper} with `paper` and {chain of flight} with `flight`",
                "the whole firmware takes {sample to motors} instructions",
                "takes {KiB flash} KiB of flash and {KiB static RAM} KiB of static RAM",
            ][..],
        ),
        (
            "docs/timing.md",
            &[
                "| **{sample to motors}** |",
                "instead of four products | 550 more: {4 DShot frames} instead of 60 |",
                "conversion of a receiver frame to sticks takes {sticks}.",
                "calibrated | {calibration of 3 sensors} | {calibration of 3 sensors} |",
                "| 9 prefilters | {9 prefilters} | {9 prefilters} |",
                "| attitude from 9 axes | {estimator paper 9-axis} | {estimator flight 9-axis} |",
                "| control: angle and rate loops | {control} | {control} |",
                "| mixer, ESC | {mixer and ESC} | {mixer and ESC} |",
                "| **sum** | **{chain of paper}** | **{chain of flight}** |",
            ],
        ),
        (
            "docs/estimators.md",
            &[
                "| bench, stand, near hover | {estimator paper 9-axis} |",
                "| comparison with the paper | {estimator paper 9-axis} |",
                "flight; the default | {estimator flight 9-axis} |",
                "that drifts or vibrates; recordings | {estimator robust 9-axis}, mean",
            ],
        ),
        (
            "docs/accuracy.md",
            &[
                "over recordings | {mean estimator flight 9-axis} instructions |",
                "7.0°, {mean estimator robust 9-axis} |",
            ],
        ),
    ] {
        let text = read(page).split_whitespace().collect::<Vec<_>>().join(" ");
        for place in places {
            let mut parts = place.split(['{', '}']).enumerate();
            let expected: String = parts.by_ref().fold(String::new(), |text, (k, part)| match part {
                part if k % 2 == 0 => text + part,
                part => match (part.strip_prefix("KiB "), part.strip_prefix("mean ")) {
                    (Some(name), _) => text + &grouped((last("bytes", name) as f64 / 1024.0).round() as i64),
                    (_, Some(name)) => text + &grouped(mean(name)),
                    _ => text + &instructions(part),
                },
            });
            assert!(text.contains(&expected), "{page}: must contain: {expected}");
        }
    }
}
