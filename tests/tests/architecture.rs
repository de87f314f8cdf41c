//! Who may use whom: the table of docs/architecture.md, held to the crates' `Cargo.toml`. No crate uses one that stands
//! below it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// A crate's place in the table, and whom it uses; with `(`…`)` what is only for its tests or its build.
type Crates = Vec<(String, BTreeSet<String>)>;

fn table() -> Crates {
    let page = std::fs::read_to_string(Path::new(ROOT).join("docs/architecture.md")).unwrap();
    let rows = page.lines().filter(|line| line.starts_with("| `"));
    rows.map(|row| {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let name = cells[1].trim_matches('`').to_owned();
        let uses = cells[2].split(',').map(|name| name.trim().replace('`', ""));
        (name, uses.filter(|name| !name.is_empty()).collect())
    })
    .collect()
}

fn manifest(folder: &str) -> toml::Table {
    let path = Path::new(ROOT).join(folder).join("Cargo.toml");
    std::fs::read_to_string(&path).unwrap().parse().unwrap()
}

/// Every crate of the workspace, with the crates of the workspace that its manifest names.
fn crates() -> BTreeMap<String, BTreeSet<String>> {
    let workspace = manifest(".");
    let members = workspace["workspace"]["members"].as_array().unwrap().iter();
    let folders =
        members.map(|member| member.as_str().unwrap().to_owned()).chain(["tests/fixed-input".to_owned()]);
    let manifests: Vec<(String, toml::Table)> = folders
        .map(|folder| {
            let manifest = manifest(&folder);
            (manifest["package"]["name"].as_str().unwrap().to_owned(), manifest)
        })
        .collect();
    let names: BTreeSet<&String> = manifests.iter().map(|(name, _)| name).collect();
    let used = |manifest: &toml::Table, kind: &str| -> Vec<String> {
        let table = manifest.get(kind).and_then(toml::Value::as_table);
        table
            .into_iter()
            .flat_map(|table| table.keys())
            .filter(|name| names.contains(name))
            .cloned()
            .collect()
    };
    let of = |manifest: &toml::Table| {
        let mut uses: BTreeSet<String> = used(manifest, "dependencies").into_iter().collect();
        for kind in ["dev-dependencies", "build-dependencies"] {
            let more: Vec<String> =
                used(manifest, kind).into_iter().filter(|name| !uses.contains(name)).collect();
            uses.extend(more.into_iter().map(|name| format!("({name})")));
        }
        uses
    };
    manifests.iter().map(|(name, manifest)| (name.clone(), of(manifest))).collect()
}

#[test]
fn crates_use_only_what_stands_above_them() {
    let mut above: BTreeSet<String> = BTreeSet::new();
    for (name, uses) in table() {
        for used in &uses {
            let used = used.trim_matches(['(', ')']);
            assert!(above.contains(used), "{name} uses {used}, which does not stand above it");
        }
        above.insert(name);
    }
}

#[test]
fn the_table_is_that_of_the_manifests() {
    let table: BTreeMap<_, _> = table().into_iter().collect();
    assert_eq!(table, crates());
}
