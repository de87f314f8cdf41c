//! The built-in scenes.

/// A built-in scene.
#[derive(Clone, Copy, Debug)]
pub struct BuiltIn {
    /// Name on the command line.
    pub name: &'static str,
    /// Text of the TOML file.
    pub text: &'static str,
}

macro_rules! scenes {
    ($($name:literal),+ $(,)?) => {
        &[$(BuiltIn { name: $name, text: include_str!(concat!("../../scenes/", $name, ".toml")) }),+]
    };
}

/// All built-in scenes; the first is the default.
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
