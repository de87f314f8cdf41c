//! Costs on the Cortex-M4F: instructions counted on QEMU, and bytes of flash.
//!
//! The figures are committed in `m4.toml`. A test measures them again and keeps the file up to date.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use serde::Deserialize;

/// The cost of one function.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
pub struct Figure {
    /// Mean number of instructions over its inputs.
    pub instructions: f64,
    /// Bytes of flash that it takes, if they were measured.
    pub flash_bytes: Option<u32>,
}

static FIGURES: LazyLock<BTreeMap<String, Figure>> = LazyLock::new(|| {
    let text = include_str!("m4.toml");
    toml::from_str(text).unwrap_or_else(|error| panic!("m4.toml: {error}"))
});

/// Returns the figure of this name; `None` if it has not been measured.
pub fn figure(name: &str) -> Option<Figure> {
    FIGURES.get(name).copied()
}

/// Returns the instructions of this name; `None` if they have not been counted.
pub fn instructions(name: &str) -> Option<f64> {
    figure(name).map(|figure| figure.instructions)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_figure_is_a_plausible_count() {
        assert!(!FIGURES.is_empty());
        for (name, figure) in FIGURES.iter() {
            assert!(figure.instructions > 0.0 && figure.instructions < 1e6, "{name}: {figure:?}");
        }
        assert_eq!(figure("no such thing"), None);
    }
}
