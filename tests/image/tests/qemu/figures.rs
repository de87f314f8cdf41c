//! Measures the figures of `studies/src/cost/m4.toml` and compares them with the file.
//!
//! Instructions are means over a figure's inputs, of calls that are not inlined. Flash is the code of the called
//! function and of all functions that it calls, including their literals: the size that it would have alone, counted in
//! full even if other code shares it. Setup code, tables elsewhere and the code that reports a panic are not included.
//! To write the file again after a change:
//! `KESTREL_WRITE_DOCS=1 cargo test -p image-tests --test qemu figures -- --ignored`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;

use crate::{alternatives_image, board_image, fresh_directory, run, workspace};
use image_tests::image::Image;
use image_tests::program::Program;

/// Path of the file in the workspace.
const FILE: &str = "studies/src/cost/m4.toml";

/// Allowed change: above this share the test fails if a figure rises, and prints a note if it falls.
const TOLERANCE: f64 = 0.05;
/// The allowed change is at least this many instructions of four bytes: a call's register moves depend on the code
/// around it.
const TOLERANCE_INSTRUCTIONS: f64 = 4.0;

/// Stages of the flight code whose figures the studies take from the image `icount`.
const STAGES: [&str; 4] = ["calibration of 3 sensors", "sticks", "control", "mixer and ESC"];

/// Units and values: `instructions`, and `flash_bytes` for what has code of its own.
type Figure = Vec<(&'static str, f64)>;

#[test]
#[ignore = "needs qemu-system-arm"]
fn figures_of_the_alternatives_equal_the_file() {
    let measured = measure();
    let path = workspace().join(FILE);
    if std::env::var_os("KESTREL_WRITE_DOCS").is_some() {
        fs::write(&path, text(&measured)).unwrap();
        return;
    }
    let mut committed: BTreeMap<String, BTreeMap<String, f64>> =
        toml::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
    let mut risen = Vec::new();
    for (name, figure) in measured {
        let mut file = committed.remove(&name).unwrap_or_else(|| panic!("{FILE} has no {name}"));
        for (unit, now) in figure {
            let then = file.remove(unit).unwrap_or_else(|| panic!("{FILE}: {name} has no {unit}"));
            let change = now - then;
            let instruction = if unit == "flash_bytes" { 4.0 } else { 1.0 };
            let tolerance = (TOLERANCE * then).max(TOLERANCE_INSTRUCTIONS * instruction);
            if change != 0.0 {
                println!("{name}: {now} {unit}, {change:+.1} since {then} ({:+.1} %)", 100.0 * change / then);
            }
            if change > tolerance {
                risen.push(format!("{name}: {now} {unit}, and the file has {then}"));
            } else if change < -tolerance {
                println!("{name}: the file is out of date: update it with KESTREL_WRITE_DOCS=1");
            }
        }
        assert!(file.is_empty(), "{FILE}: nothing measures {file:?} of {name}");
    }
    assert!(committed.is_empty(), "{FILE}: nothing measures {committed:?}");
    assert!(
        risen.is_empty(),
        "figures have risen; KESTREL_WRITE_DOCS=1 updates the file:\n{}",
        risen.join("\n")
    );
}

fn text(figures: &[(String, Figure)]) -> String {
    let mut text = String::from(
        "# Costs on the Cortex-M4F of QEMU: mean number of instructions over the inputs, and bytes of flash.
# Written by a test, which documents how they are measured: tests/image/tests/qemu/figures.rs.
",
    );
    for (name, figure) in figures {
        writeln!(text, "\n[\"{name}\"]").unwrap();
        for (unit, value) in figure {
            writeln!(text, "{unit} = {value}").unwrap();
        }
    }
    text
}

/// Measures all figures, in the order of the file.
fn measure() -> Vec<(String, Figure)> {
    let path = alternatives_image();
    let output = run(&path, &fresh_directory("alternatives"));
    let codes: BTreeMap<&str, u32> = output
        .lines()
        .filter_map(|line| line.strip_prefix("code,")?.rsplit_once(",0x"))
        .map(|(name, address)| (name, u32::from_str_radix(address, 16).unwrap() & !1))
        .collect();
    let image = Image::read(&path);
    let program = Program::new(&image);
    let mut figures = Vec::new();
    for (name, mean, _) in counts(&output) {
        let Some(&start) = codes.get(name.as_str()) else {
            // The counter must count a thousand instructions as a thousand.
            assert_eq!((name.as_str(), mean), ("1000 nops", 1_000.0));
            continue;
        };
        let bytes = code_bytes(&image, &program, start).unwrap_or_else(|why| panic!("{name}: {why}"));
        figures.push((name, vec![instructions(mean), ("flash_bytes", f64::from(bytes))]));
    }
    assert_eq!(figures.len(), codes.len());

    let stages = run(&board_image("icount"), &fresh_directory("figures-icount"));
    for (name, mean, _) in counts(&stages).into_iter().filter(|(name, ..)| STAGES.contains(&name.as_str())) {
        figures.push((name, vec![instructions(mean)]));
    }
    let flight = run(&board_image("firmware"), &fresh_directory("figures-firmware"));
    for (name, mean, max) in counts(&flight) {
        figures.push((format!("{name} mean"), vec![instructions(mean)]));
        figures.push((format!("{name} worst"), vec![instructions(max)]));
    }
    figures
}

/// Returns an instruction count rounded to a tenth.
fn instructions(count: f64) -> (&'static str, f64) {
    ("instructions", (10.0 * count).round() / 10.0)
}

/// Parses name, mean and maximum of each line `icount,<name>,<inputs>,<total instructions>,<maximum>`.
fn counts(output: &str) -> Vec<(String, f64, f64)> {
    let lines = output.lines().filter_map(|line| line.strip_prefix("icount,"));
    lines
        .map(|line| {
            let [name, inputs, total, max] = line.split(',').collect::<Vec<_>>()[..] else {
                panic!("{line}")
            };
            let number = |digits: &str| digits.parse::<f64>().unwrap();
            (name.to_owned(), number(total) / number(inputs), number(max))
        })
        .collect()
}

/// Returns the bytes of the function at `start` and of all functions that it calls.
fn code_bytes(image: &Image, program: &Program, start: u32) -> Result<u32, String> {
    let panics = |function: u32| image.name(function).starts_with("core::panicking::");
    let reached = program.reached(start, panics)?;
    let code = reached.keys().filter(|&&function| !panics(function));
    Ok(code.map(|function| image.functions[function].size).sum())
}
