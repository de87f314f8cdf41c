//! Checks of the flight board's linked image: what its interrupt handlers can reach, and how much stack they take. The
//! image is checked with the default log level, errors only, and with all levels, because that is more code.
//!
//! Four statements are derived from the machine code, and hold for every input:
//!
//! - **The fast loop reaches no panic.** From each handler in [`FAST_LOOP`], all calls are followed. None leads to a
//!   function of [`PANICS`], none to an undefined instruction, and none goes by a register, so that all calls are seen.
//!   The same image shows that the search finds panics: the initialisation of the board can panic, and does so if a
//!   setting is out of range.
//! - **The stack holds the worst nesting of handlers.** Each path through each function is followed with the depth of
//!   the stack at each instruction; a path must return with the stack pointer with which it began. The bound is the sum
//!   of the deepest path of calls from reset, of the deepest path from the worst handler of each priority in
//!   [`HANDLERS`], and of the registers that the processor saves at each interruption.
//! - **Every handler acknowledges its interrupt on every path.** A table lists the accesses that do so, and the vectors
//!   that need none with the reason. No path of the handler returns before these accesses (`acknowledge.rs`).
//!   Interrupts without a handler of their own go to the default handler, which never returns.
//! - **On a desk the motor pads stay inputs.** In the image that flies with `sim-host hil --serial`, no number is an
//!   address of their port, or an address from which an offset reaches it.
//!
//! Everything unknown is an error and is not skipped: an instruction that writes `sp` or `pc` in a way that `thumb.rs`
//! does not know, a jump into the middle of a function, a cycle of calls, a vector that is not in [`HANDLERS`].
//!
//! # What this does not show
//! - That the code is reached at all, or in time: endless loops and waiting are not panics.
//! - Faults: a load from a bad address is not detected. Faults stop the motors (`firmware/src/fault.rs`).
//! - The stack *after* a panic has begun. If a panic overflows the stack, a fault follows, which resets the stack
//!   pointer and stops the motors, as the panic would have done.
//! - The priorities, which the firmware writes at run time. A second bound, in which each handler interrupts all
//!   others, does not depend on them, and is printed too.
//! - How deep formatted values are nested: [`FORMATTED_DEPTH`] follows from their types.
//!
//! A call by a register is assumed to reach any function whose address occurs in the image, in data or in a
//! pair of `movw` and `movt`. An address that is computed in another way would be missed; the compiler generates none.

mod acknowledge;
mod crafted;
mod crafted_handlers;
mod values;

use std::collections::{BTreeMap, BTreeSet};
use std::env;
use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

use acknowledge::{Found, NotAsserted, Source};
use image_tests::function::{self, Callee, Function};
use image_tests::image::Image;
use image_tests::program::{Depth, Program};

/// The handlers between a sample and the motors' pulses: the control loop, and the handlers that start it.
const FAST_LOOP: [&str; 3] = ["DMA2_STREAM0", "EXTI4", "TIM5"];

/// The RTIC priority of each handler. Tasks: `#[task]` in `firmware/src/main.rs`; asynchronous tasks run in
/// the vector of the dispatcher of their priority, of which the lowest comes first in `dispatchers`. The
/// board's own interrupts: `SAMPLING_PRIORITY` in `firmware/src/board/mod.rs`.
const HANDLERS: [(&str, u8); 10] = [
    ("CRYP", 1),         // magnetometer
    ("DCMI", 2),         // imu_setup, health, log_event
    ("HASH_RNG", 3),     // battery
    ("SysTick", 4),      // tick
    ("DMA2_STREAM0", 5), // control_loop
    ("EXTI4", 6),        // data ready
    ("TIM5", 6),         // sample overdue
    ("USART2", 6),       // receive
    ("PVD", 7),          // the supply is too low
    // A failure of the crystal oscillator is above all priorities.
    ("NonMaskableInt", 17),
];

/// Prefixes of the names of functions with which a panic begins.
const PANICS: [&str; 9] = [
    "__rustc::rust_begin_unwind",
    "core::cell::panic_",
    "core::option::expect_failed",
    "core::option::unwrap_failed",
    "core::panicking::",
    "core::result::unwrap_failed",
    "core::slice::index::slice_",
    "core::str::slice_error_fail",
    "defmt::export::panic",
];

/// Assumed nesting depth of values formatted by `core::fmt`, whose functions call each other in cycles. The log formats
/// no values this way. A panic message does, but nothing is counted after a panic has begun. So this is a reserve.
const FORMATTED_DEPTH: u32 = 4;

/// Bytes that the processor saves at an interrupt: 8 words, 18 of the floating-point unit (reserved even if they need
/// not be saved), and one that aligns the stack.
const SAVED_BYTES: u32 = 4 * (8 + 18 + 1);

#[test]
#[ignore = "builds the firmware for the board"]
fn fast_loop_reaches_no_panic() {
    for (log, image) in flight_images() {
        let program = Program::new(image);
        for root in FAST_LOOP {
            check_free_of_panics(image, &program, root).unwrap_or_else(|why| panic!("log {log}: {why}"));
        }
        // The search reached the largest part of the control loop, so it did not end early.
        let (functions, instructions) = extent(image, &program, image.find(FAST_LOOP[0]).unwrap());
        assert!(instructions > 1_500, "log {log}: {instructions} instructions in the control loop");
        println!(
            "log {log}: no panic in {functions} functions, {instructions} instructions of {}",
            FAST_LOOP[0]
        );

        // The initialisation of the board can panic, and the search finds that.
        let found = check_free_of_panics(image, &program, "Reset").unwrap_err();
        assert!(found.contains("core::panicking::"), "{found}");
    }
}

/// Checks that `root` reaches no panic, no undefined instruction, and no call by a register.
fn check_free_of_panics(image: &Image, program: &Program, root: &str) -> Result<(), String> {
    let start = image.find(root).ok_or(format!("{root} is not in the image"))?;
    let reached = program.reached(start, |_| false)?;
    // Nearest first, because the shortest chain explains most.
    let mut nearest: Vec<(usize, u32)> = reached
        .keys()
        .map(|&function| (program.chain(&reached, function).lines().count(), function))
        .collect();
    nearest.sort_unstable();
    for (_, function) in nearest {
        let chain = program.chain(&reached, function);
        if is_panic(image.name(function)) {
            return Err(format!("a panic can be reached:\n  {chain}"));
        }
        let Function { traps, calls, .. } = program.function(function)?;
        if let Some(at) = traps.first() {
            return Err(format!("an undefined instruction can be reached at {at:#x}:\n  {chain}"));
        }
        if let Some(call) = calls.iter().find(|call| matches!(call.callee, Callee::Register)) {
            return Err(format!("a call by a register at {:#x}:\n  {chain}", call.at));
        }
    }
    Ok(())
}

fn is_panic(name: &str) -> bool {
    PANICS.iter().any(|beginning| name.starts_with(beginning))
}

#[test]
#[ignore = "builds the firmware for the board"]
fn stack_holds_the_worst_nesting_of_handlers() {
    for (log, image) in flight_images() {
        println!("log {log}");
        let bound = stack_bound(image).unwrap_or_else(|why| panic!("log {log}: {why}"));
        assert!(
            bound <= image.stack_bytes,
            "stack bound {bound} bytes, available {} bytes",
            image.stack_bytes
        );
        if *log == "trace" {
            image_tests::budget("bytes", "stack", bound);
        }
    }
}

#[test]
#[ignore = "builds the firmware for the board"]
fn flash_and_ram_keep_their_budgets() {
    let image = flight_image("info");
    image_tests::budget("bytes", "flash", image.flash_bytes);
    image_tests::budget("bytes", "static RAM", image.ram_bytes);
}

#[test]
#[ignore = "builds the firmware for the board"]
fn every_handler_acknowledges_on_every_path() {
    let named: BTreeSet<&str> = acknowledge::SOURCES.iter().map(|(name, _)| *name).collect();
    assert_eq!(named, HANDLERS.iter().map(|(name, _)| *name).collect(), "a source for each handler");
    for (log, image) in flight_images() {
        let program = Program::new(image);
        let returns = |name: &str| program.function(image.find(name).unwrap()).unwrap().returns;
        let mut failures = Vec::new();
        for (name, source) in &acknowledge::SOURCES {
            match source {
                Source::Acknowledged { by, unless } => {
                    match acknowledge::check(image, name, by, *unless) {
                        Ok(found) if unless.is_some() != found.excused => {
                            failures.push(format!("{name}: no path uses its exception any more"));
                        }
                        Ok(Found { instructions, .. }) => {
                            println!(
                                "log {log}: {name:14} acknowledges, {instructions} instructions examined"
                            );
                        }
                        Err(why) => failures.push(why),
                    }
                    if let Some(NotAsserted { address, bit, why }) = unless {
                        println!("  except with bit {bit} of {address:#x} clear: {why}");
                    }
                }
                Source::ByItself(why) => println!("log {log}: {name:14} needs no acknowledgement: {why}"),
                Source::NeverReturns(why) => {
                    failures.extend(returns(name).then(|| format!("{name} can return")));
                    println!("log {log}: {name:14} never returns: {why}");
                }
            }
        }
        for name in ["DefaultHandler", "HardFault"] {
            failures.extend(returns(name).then(|| format!("{name} can return")));
        }
        assert!(failures.is_empty(), "log {log}:\n{}", failures.join("\n"));
    }
}

/// Addresses of the motor pads' port, GPIOB, and the addresses below it from which an instruction's offset (12 bits)
/// reaches it.
const NEAR_MOTOR_PADS: std::ops::Range<u32> = 0x4002_0400 - 0xfff..0x4002_0428;
/// The same port in the bit-band alias of the registers from 0x4000_0000 on.
const BITS_OF_MOTOR_PADS: std::ops::Range<u32> =
    0x4200_0000 + 32 * 0x2_0400 - 0xfff..0x4200_0000 + 32 * 0x2_0428;

#[test]
#[ignore = "builds the firmware for the board"]
fn hil_image_cannot_configure_the_motor_pads() {
    let knows_motor_pads = |image: &Image| {
        let built = image.functions.keys().flat_map(|&start| function::pairs(image, start));
        image
            .data_words()
            .chain(built)
            .any(|number| NEAR_MOTOR_PADS.contains(&number) || BITS_OF_MOTOR_PADS.contains(&number))
    };
    // After a reset the pads are inputs, and only a register of their port can change that.
    assert!(!knows_motor_pads(&built_image("info", &["--no-default-features", "--features", "hil"])));
    assert!(knows_motor_pads(&flight_image("info")));
}

/// Returns the largest stack use of reset with the worst nesting of handlers, and prints its parts.
fn stack_bound(image: &Image) -> Result<u32, String> {
    let program = Program::new(image);
    // Every vector is in the table. Vectors without a handler of their own go to the default handler.
    let vectors: BTreeSet<&str> = image.vectors.iter().map(|&handler| image.name(handler)).collect();
    let handlers = HANDLERS.iter().map(|&(name, _)| name);
    assert_eq!(
        vectors,
        handlers.chain(["Reset", "HardFault", "DefaultHandler"]).collect(),
        "vectors of the image and of the table"
    );

    println!("{:16} {:>8} {:>6} {:>12}   deepest calls", "root", "priority", "bytes", "instructions");
    let bytes_of = |name: &str, priority: &str| {
        let start = image.find(name).unwrap();
        let depth = depth(image, &program, start)?;
        let (_, instructions) = extent(image, &program, start);
        let path: Vec<&str> = depth.path.iter().skip(1).map(|&function| image.name(function)).collect();
        println!("{name:16} {priority:>8} {:>6} {instructions:>12}   {}", depth.bytes, path.join(" → "));
        Ok::<u32, String>(depth.bytes)
    };
    // From reset to the idle task, which never ends. The initialisation is the deepest part and runs with interrupts
    // off, so the sum is an upper bound.
    let base = bytes_of("Reset", "0")?;
    let mut levels: BTreeMap<u8, u32> = BTreeMap::new();
    let mut each_on_top = 0;
    for (name, priority) in HANDLERS {
        let bytes = bytes_of(name, &priority.to_string())?;
        let level = levels.entry(priority).or_default();
        *level = bytes.max(*level);
        each_on_top += SAVED_BYTES + bytes;
    }
    // An unexpected interrupt or a fault can come on top. Neither returns.
    let last = SAVED_BYTES + bytes_of("DefaultHandler", "any")?.max(bytes_of("HardFault", "fault")?);

    let bound = base + levels.values().map(|level| SAVED_BYTES + level).sum::<u32>() + last;
    println!("bound {bound} of {} bytes; {SAVED_BYTES} of them for each interruption", image.stack_bytes);
    println!("if each handler interrupted all others, {}\n", base + each_on_top + last);
    Ok(bound)
}

/// Returns the stack use of `start`, up to where a panic begins.
fn depth(image: &Image, program: &Program, start: u32) -> Result<Depth, String> {
    let nested = |name: &str| name.contains("core::fmt::").then_some(FORMATTED_DEPTH);
    program.depth(start, |function| is_panic(image.name(function)), nested)
}

/// Returns the numbers of reachable functions and instructions, without those of a panic.
fn extent(image: &Image, program: &Program, root: u32) -> (usize, usize) {
    let reached = program.reached(root, |function| is_panic(image.name(function))).unwrap();
    let instructions: Vec<usize> = reached
        .keys()
        .filter(|&&function| !is_panic(image.name(function)))
        .map(|&function| program.function(function).unwrap().instructions)
        .collect();
    (instructions.len(), instructions.iter().sum())
}

/// Returns the images with their log levels, which `DEFMT_LOG` sets at build time. They are built once, in a separate
/// target directory, because the outer build holds the lock of its own.
fn flight_images() -> &'static [(&'static str, Image)] {
    static IMAGES: OnceLock<[(&str, Image); 2]> = OnceLock::new();
    IMAGES.get_or_init(|| ["error", "trace"].map(|log| (log, flight_image(log))))
}

fn flight_image(log: &str) -> Image {
    built_image(log, &[])
}

fn built_image(log: &str, features: &[&str]) -> Image {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("linked-image");
    let status = Command::new(env::var_os("CARGO").as_deref().unwrap_or(OsStr::new("cargo")))
        .current_dir(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")))
        .args(["build", "--profile", "flash", "--package", "firmware", "--target", "thumbv7em-none-eabihf"])
        .args(features)
        .arg("--target-dir")
        .arg(&target)
        .env("DEFMT_LOG", log)
        // These would replace the link arguments of .cargo/config.toml.
        .env_remove("RUSTFLAGS")
        .env_remove("CARGO_ENCODED_RUSTFLAGS")
        .status()
        .expect("cargo runs");
    assert!(status.success(), "the image does not build");
    Image::read(&target.join("thumbv7em-none-eabihf/flash/firmware"))
}
