//! The scenes that come with the program.

/// A built-in scene.
#[derive(Clone, Copy, Debug)]
pub struct BuiltIn {
    /// What it is called on the command line.
    pub name: &'static str,
    /// Its TOML.
    pub text: &'static str,
}

macro_rules! scenes {
    ($($name:literal),+ $(,)?) => {
        &[$(BuiltIn { name: $name, text: include_str!(concat!("../../scenes/", $name, ".toml")) }),+]
    };
}

/// All of them, the default first.
pub const BUILT_IN: &[BuiltIn] = scenes![
    "hover",
    "steps",
    "stand-steps",
    "static",
    "bench-static",
    "windy-landing",
    "hot-day",
    "weak-battery",
    "magnetic-site",
    "motor-out",
    "shaky-frame",
    "bad-link",
    "rough-sampling",
    "whole-drive",
];
