//! Who may use whom: the table of docs/architecture.md, held to the crates' `Cargo.toml`. No crate uses one that stands
//! below it, and no modules of a crate import each other in a circle.

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

/// The folders of the workspace's crates.
fn crates_folders() -> Vec<String> {
    let workspace = manifest(".");
    let members = workspace["workspace"]["members"].as_array().unwrap().iter();
    members.map(|member| member.as_str().unwrap().to_owned()).collect()
}

/// Every crate of the workspace, with the crates of the workspace that its manifest names.
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

/// Modules at the top of a crate, and those that each imports.
type Imports = BTreeMap<String, BTreeSet<String>>;

/// Adds what a source of `module` imports from its crate: `crate::name`, and `use crate::{name, …}`. Comments and tests in
/// the file do not count.
fn add_imports(module: &str, source: &str, imports: &mut Imports) {
    let code = source.split("#[cfg(test)]\nmod tests {").next().unwrap_or(source);
    let lines = code.lines().map(str::trim_start).filter(|line| !line.starts_with("//"));
    let code: String = lines.flat_map(|line| [line, "\n"]).collect();
    for (at, found) in code.match_indices("crate::") {
        // `$crate` and `some_crate` are others.
        if code[..at].ends_with(|before: char| before == '_' || before == '$' || before.is_alphanumeric()) {
            continue;
        }
        let rest = &code[at + found.len()..];
        let mut depth = 0;
        let list = match rest.strip_prefix('{') {
            None => rest.split(|c: char| c != '_' && !c.is_alphanumeric()).next().unwrap_or("").to_owned(),
            // The first names of the list's paths.
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

/// A way from a module back to itself, if there is one.
fn circle(imports: &Imports) -> Option<Vec<String>> {
    fn back_to(first: &str, way: &mut Vec<String>, seen: &mut BTreeSet<String>, imports: &Imports) -> bool {
        let Some(next) = way.last().and_then(|last| imports.get(last)) else { return false };
        for module in next {
            if module == first {
                return true;
            }
            if seen.insert(module.clone()) {
                way.push(module.clone());
                if back_to(first, way, seen, imports) {
                    return true;
                }
                way.pop();
            }
        }
        false
    }
    imports.keys().find_map(|first| {
        let mut way = vec![first.clone()];
        back_to(first, &mut way, &mut BTreeSet::new(), imports).then_some(way)
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
fn no_modules_import_each_other_in_a_circle() {
    for folder in crates_folders() {
        let source = Path::new(ROOT).join(&folder).join("src");
        if !source.exists() {
            continue;
        }
        let mut imports = Imports::new();
        sources(&source, None, &mut imports);
        assert_eq!(circle(&imports), None, "{folder}");
    }
}

#[test]
fn a_circle_is_found() {
    let mut imports = Imports::new();
    add_imports("config", "use crate::{control::Gains, mixer};\n// use crate::loop_;\n", &mut imports);
    add_imports(
        "mixer",
        "fn f() { crate::range::check() }\n#[cfg(test)]\nmod tests {\nuse crate::config;\n",
        &mut imports,
    );
    assert_eq!(circle(&imports), None);
    assert_eq!(imports["config"], BTreeSet::from(["control".into(), "mixer".into()]));
    add_imports("range", "use crate::config::Config;", &mut imports);
    assert_eq!(circle(&imports), Some(vec!["config".into(), "mixer".into(), "range".into()]));
}
