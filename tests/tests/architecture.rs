//! Allowed dependencies: diagram and table of docs/architecture.md equal the crates' `Cargo.toml`, no crate uses one
//! that stands below it in the table, and no modules of a crate import each other in a cycle.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// The crates in the order of the table, each with the crates that it uses; those only for tests or build in `(`…`)`.
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

/// Returns the folders of the workspace's crates.
fn crates_folders() -> Vec<String> {
    let workspace = manifest(".");
    let members = workspace["workspace"]["members"].as_array().unwrap().iter();
    members.map(|member| member.as_str().unwrap().to_owned()).collect()
}

/// Returns every crate of the workspace, with the workspace crates in its manifest.
fn crates() -> BTreeMap<String, BTreeSet<String>> {
    let manifests: Vec<(String, toml::Table)> = crates_folders()
        .into_iter()
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
fn crates_use_only_crates_above_them() {
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
fn crate_table_equals_the_manifests() {
    let table: BTreeMap<_, _> = table().into_iter().collect();
    assert_eq!(table, crates());
}

/// Returns the layer of every crate in the diagram. Each row starts with the number of its layer.
fn diagram() -> BTreeMap<String, u32> {
    let page = std::fs::read_to_string(Path::new(ROOT).join("docs/architecture.md")).unwrap();
    let diagram = page.split("```").nth(1).unwrap();
    let (mut layer, mut layers) = (None, BTreeMap::new());
    for line in diagram.lines() {
        let Some((number, cells)) = line.split_once('│') else { continue };
        layer = number.trim().parse().ok().or(layer);
        let names = cells.split(['│', ',']).map(str::trim).filter(|name| !name.is_empty());
        for name in names {
            let before = layers.insert(name.to_owned(), layer.unwrap());
            assert_eq!(before, None, "{name} is in the diagram twice");
        }
    }
    layers
}

#[test]
fn diagram_has_every_crate_above_those_it_uses() {
    let (layers, crates) = (diagram(), crates());
    assert_eq!(layers.keys().collect::<Vec<_>>(), crates.keys().collect::<Vec<_>>());
    for (name, uses) in &crates {
        for used in uses {
            let used = used.trim_matches(['(', ')']);
            assert!(layers[name] > layers[used], "{name} uses {used}, which is not in a lower layer");
        }
    }
}

/// The top-level modules of a crate, and the modules that each imports.
type Imports = BTreeMap<String, BTreeSet<String>>;

/// Adds the modules that a source of `module` imports from its crate, as `crate::name` or `use crate::{name, …}`.
/// Comments and the tests in the file do not count.
fn add_imports(module: &str, source: &str, imports: &mut Imports) {
    let code = source.split("#[cfg(test)]\nmod tests {").next().unwrap_or(source);
    let lines = code.lines().map(str::trim_start).filter(|line| !line.starts_with("//"));
    let code: String = lines.flat_map(|line| [line, "\n"]).collect();
    for (at, found) in code.match_indices("crate::") {
        // `$crate` and `some_crate` are not this crate.
        if code[..at].ends_with(|before: char| before == '_' || before == '$' || before.is_alphanumeric()) {
            continue;
        }
        let rest = &code[at + found.len()..];
        let mut depth = 0;
        let list = match rest.strip_prefix('{') {
            None => rest.split(|c: char| c != '_' && !c.is_alphanumeric()).next().unwrap_or("").to_owned(),
            // These are the first segments of the paths in the list.
            Some(list) => list
                .chars()
                .take_while(|c| {
                    depth += i32::from(*c == '{') - i32::from(*c == '}');
                    depth >= 0
                })
                .collect(),
        };
        for path in list.split(',') {
            let name = path.trim().split("::").next().unwrap_or("");
            let is_module =
                name.starts_with(char::is_lowercase) && name.chars().all(|c| c == '_' || c.is_alphanumeric());
            if is_module && name != module {
                imports.entry(module.into()).or_default().insert(name.into());
            }
        }
    }
}

/// Returns a cycle of imports, from a module back to itself, if there is one.
fn cycle(imports: &Imports) -> Option<Vec<String>> {
    fn reaches(first: &str, path: &mut Vec<String>, seen: &mut BTreeSet<String>, imports: &Imports) -> bool {
        let Some(next) = path.last().and_then(|last| imports.get(last)) else { return false };
        for module in next {
            if module == first {
                return true;
            }
            if seen.insert(module.clone()) {
                path.push(module.clone());
                if reaches(first, path, seen, imports) {
                    return true;
                }
                path.pop();
            }
        }
        false
    }
    imports.keys().find_map(|first| {
        let mut path = vec![first.clone()];
        reaches(first, &mut path, &mut BTreeSet::new(), imports).then_some(path)
    })
}

fn sources(folder: &Path, module: Option<&str>, imports: &mut Imports) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let stem = path.file_stem().unwrap().to_str().unwrap().to_owned();
        let module = module.unwrap_or(&stem);
        if path.is_dir() && stem != "bin" {
            sources(&path, Some(module), imports);
        } else if path.extension().is_some_and(|extension| extension == "rs")
            && !["lib", "main", "tests"].contains(&stem.as_str())
        {
            add_imports(module, &std::fs::read_to_string(&path).unwrap(), imports);
        }
    }
}

#[test]
fn modules_have_no_import_cycles() {
    for folder in crates_folders() {
        let source = Path::new(ROOT).join(&folder).join("src");
        if !source.exists() {
            continue;
        }
        let mut imports = Imports::new();
        sources(&source, None, &mut imports);
        assert_eq!(cycle(&imports), None, "{folder}");
    }
}

#[test]
fn import_cycle_is_detected() {
    let mut imports = Imports::new();
    add_imports("config", "use crate::{control::Gains, mixer};\n// use crate::loop_;\n", &mut imports);
    add_imports(
        "mixer",
        "fn f() { crate::range::check() }\n#[cfg(test)]\nmod tests {\nuse crate::config;\n",
        &mut imports,
    );
    assert_eq!(cycle(&imports), None);
    assert_eq!(imports["config"], BTreeSet::from(["control".into(), "mixer".into()]));
    add_imports("range", "use crate::config::Config;", &mut imports);
    assert_eq!(cycle(&imports), Some(vec!["config".into(), "mixer".into(), "range".into()]));
}
