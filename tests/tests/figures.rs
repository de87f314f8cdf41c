//! Where the figures on the pages come from: `docs/figures.toml` says it for each section that has one, and this test
//! checks that the list is complete and lists the sections whose figures nothing holds.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use serde::Deserialize;
use test_support::pages::{read, workspace};

/// Units of quantities that a program can measure. Bare numbers, counts of rows and the like are not figures.
const UNITS: [&str; 25] = [
    "ns",
    "µs",
    "ms",
    "s",
    "min",
    "hours",
    "%",
    "°",
    "°/s",
    "mm",
    "m",
    "m/s",
    "KiB",
    "kB",
    "MB",
    "bytes",
    "instructions",
    "steps",
    "samples",
    "flights",
    "runs",
    "times",
    "ppm",
    "µT",
    "LSB",
];

/// The source of the figures in a section.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Source {
    /// Tests that compare the figures, as `path/of/file.rs`, or `path/of/file.rs::name`.
    #[serde(default)]
    tests: Vec<String>,
    /// Command that prints or writes the figures.
    command: Option<String>,
    /// Document or source file that sets the figures: nothing measures them.
    constant: Option<String>,
    /// Reason that nothing holds the figures.
    unheld: Option<String>,
}

/// Returns the pages, except those that list words or changes.
fn pages() -> Vec<String> {
    let all = test_support::pages::pages().into_iter();
    all.filter(|page| !["CHANGELOG.md", "docs/glossary.md"].contains(&page.as_str())).collect()
}

/// Returns whether a line has a number with one of [`UNITS`].
fn has_figure(line: &str) -> bool {
    let words: Vec<&str> = line.split(|c: char| c.is_whitespace() || "|()[],;:*`".contains(c)).collect();
    words.windows(2).any(|pair| {
        let number = pair[0].trim_start_matches(['±', '−', '≤', '<', '~']);
        number.starts_with(|c: char| c.is_ascii_digit()) && UNITS.contains(&pair[1].trim_end_matches('.'))
    }) || words.iter().any(|word| {
        let end = word.trim_end_matches('.');
        end.starts_with(|c: char| c.is_ascii_digit()) && (end.ends_with('°') || end.ends_with('%'))
    })
}

/// Returns the sections of a page that have a figure outside of code blocks: the headings `## …`, or "" before the first.
fn sections_with_figures(page: &str) -> BTreeSet<String> {
    let text = read(page);
    let (mut section, mut code, mut found) = (String::new(), false, BTreeSet::new());
    for line in text.lines() {
        if line.starts_with("```") {
            code = !code;
        } else if let Some(heading) = line.strip_prefix("## ").filter(|_| !code) {
            section = heading.to_owned();
        } else if !code && has_figure(line) {
            found.insert(section.clone());
        }
    }
    found
}

#[test]
fn every_section_with_figures_names_their_source() {
    let sources: BTreeMap<String, BTreeMap<String, Source>> =
        toml::from_str(&read("docs/figures.toml")).unwrap();
    let (mut wrong, mut unheld) = (Vec::new(), Vec::new());
    for page in pages() {
        let found = sections_with_figures(&page);
        let empty = BTreeMap::new();
        let listed = sources.get(&page).unwrap_or(&empty);
        for section in &found {
            if !listed.contains_key(section) {
                wrong.push(format!("{page}: the section {section:?} has figures and is not listed"));
            }
        }
        for (section, source) in listed {
            let place = format!("{page}, {section:?}");
            if !found.contains(section) {
                wrong.push(format!("{place}: is listed and has no figures"));
            }
            for test in &source.tests {
                let (file, name) = test.split_once("::").unwrap_or((test, ""));
                match fs::read_to_string(workspace().join(file)) {
                    Ok(text) if name.is_empty() || text.contains(&format!("fn {name}(")) => {}
                    _ => wrong.push(format!("{place}: there is no test {test}")),
                }
            }
            let given = usize::from(!source.tests.is_empty() || source.command.is_some());
            match given + usize::from(source.constant.is_some()) + usize::from(source.unheld.is_some()) {
                0 => wrong.push(format!("{place}: names no source")),
                _ if source.unheld.is_some() => {
                    unheld.push(format!("{place}: {}", source.unheld.as_deref().unwrap_or_default()));
                }
                _ => {}
            }
        }
    }
    for page in sources.keys() {
        if !pages().contains(page) {
            wrong.push(format!("{page}: no such page"));
        }
    }
    println!("{} sections have figures that nothing holds:\n{}", unheld.len(), unheld.join("\n"));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
