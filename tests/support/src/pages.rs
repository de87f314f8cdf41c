//! The pages of the project, README.md and docs/*.md, and the other files of the workspace.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Returns the root of the workspace.
pub fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Reads a file; a relative path starts at the root of the workspace.
pub fn read(path: impl AsRef<Path>) -> String {
    let path = workspace().join(path);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Returns the paths of all pages, relative to the root of the workspace, in alphabetical order.
pub fn pages() -> Vec<String> {
    let mut pages: Vec<String> = [".", "docs"]
        .into_iter()
        .flat_map(|folder| fs::read_dir(workspace().join(folder)).unwrap())
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "md"))
        .map(|path| {
            path.strip_prefix(workspace()).unwrap().to_str().unwrap().trim_start_matches("./").to_owned()
        })
        .collect();
    pages.sort();
    pages
}

/// Returns the anchors of a page's headings: lower case, without punctuation, hyphens for spaces.
pub fn anchors(page: &str) -> BTreeSet<String> {
    let titles =
        page.lines().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#').trim());
    let kept = |c: &char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
    titles
        .map(|title| {
            title.to_lowercase().chars().filter(kept).map(|c| if c == ' ' { '-' } else { c }).collect()
        })
        .collect()
}
