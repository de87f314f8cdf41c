//! Analysis of a linked image: its instructions, functions, calls and stack.

pub mod function;
pub mod image;
pub mod program;
pub mod thumb;

/// Prints a figure beside its entry in `budgets.toml`. Panics if it exceeds its budget, or has no entry.
pub fn budget(table: &str, name: &str, measured: u32) {
    let file: toml::Table = include_str!("../budgets.toml").parse().expect("budgets.toml is TOML");
    let entry: Option<[u32; 2]> =
        file.get(table).and_then(|table| table.get(name)).and_then(|entry| entry.clone().try_into().ok());
    let [budget, last] = entry.unwrap_or_else(|| panic!("budgets.toml has no [{table}] {name}"));
    let change = i64::from(measured) - i64::from(last);
    let note = if change == 0 { String::new() } else { format!(", {change:+} since {last}") };
    println!("budget: {name}: {measured} of {budget} {table}{note}");
    assert!(measured <= budget, "{name}: {measured} {table}, budget {budget}");
}
