//! The flight board's image as it was linked: what its interrupt handlers can reach, and how much stack they take.
//!
//! Two statements are read off the machine code, and hold for every input:
//!
//! - **No panic can be reached from the fast loop.** From each handler in [`FAST_LOOP`], all calls are followed.
//!   None leads to a function of [`PANICS`], none to an undefined instruction, and none goes by a register, so that
//!   all of them are seen. That the search finds panics is checked on the same image: bringing the board up may
//!   panic, and does so on a setting that is out of range.
//! - **The stack holds the worst nesting of handlers.** Each path through each function is followed with the
//!   depth of the stack at each instruction; a path must come back with the stack pointer with which it began. The
//!   deepest path of calls from reset, and from the worst handler of each priority in [`HANDLERS`], are added up, with
//!   the registers that the processor saves at each interruption.
//!
//! Whatever is not understood is an error and not skipped: an instruction that writes `sp` or `pc` in a way
//! that `thumb.rs` does not know, a jump into the middle of a function, a cycle of calls, a vector that is not in
//! [`HANDLERS`].
//!
//! # What this does not show
//! - That the compiler's code is reached at all, or in time: endless loops, and waiting, are not panics.
//! - Faults: a load from a bad address is not seen. They stop the motors (`firmware/src/fault.rs`).
//! - The stack *after* a panic has begun. One that runs out of it is a fault, which begins the stack anew and
//!   stops the motors, as the panic was about to do.
//! - The priorities, which the firmware writes at run time. The bound in which each handler interrupts all
//!   others needs none of them, and is printed beside.
//! - How deep values that are formatted are nested: [`FORMATTED_DEPTH`] is taken from their types.
//!
//! A call by a register is taken to reach any function whose address occurs in the image, in data or in a pair of
//! `movw` and `movt`. An address that is computed otherwise would be missed, and the compiler makes none.

mod crafted;
mod function;
mod image;
mod program;
mod thumb;

use std::collections::{BTreeMap, BTreeSet};
use std::env;
use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

use function::Callee;
use image::Image;
use program::{Depth, Program};

/// The handlers between a sample and the motors' pulses: the flight task, and what wakes it.
const FAST_LOOP: [&str; 3] = ["DMA2_STREAM0", "EXTI4", "TIM5"];

/// The RTIC priority of each handler. Tasks: `#[task]` in `firmware/src/main.rs`; asynchronous tasks run in the
/// vector of the dispatcher of their priority, of which the lowest comes first in `dispatchers`. The board's own
/// interrupts: `SENSE_PRIORITY` in `firmware/src/board/mod.rs`.
const HANDLERS: [(&str, u8); 4] = [
    ("CRYP", 1),         // announce, health
    ("DMA2_STREAM0", 4), // flight
    ("EXTI4", 5),        // data ready
    ("TIM5", 5),         // sample overdue
];

/// Where a panic begins: beginnings of names.
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

/// How many values within values the log formats through `core::fmt`, whose functions call each other in cycles: an
/// error of the inertial sensor, in it the bus's, in it the peripheral's; and one for the reference around it.
const FORMATTED_DEPTH: u32 = 4;

/// What the processor saves when an interrupt comes: 8 words, 18 of the floating-point unit (for which it
/// leaves room even if it need not save them), and one that aligns the stack.
const SAVED_BYTES: u32 = 4 * (8 + 18 + 1);

#[test]
#[ignore = "builds the firmware for the board"]
fn no_panic_can_be_reached_from_the_fast_loop() {
    let image = flight_image();
    let program = Program::new(image);
    for root in FAST_LOOP {
        check_free_of_panics(image, &program, root).unwrap_or_else(|why| panic!("{why}"));
    }
    // The largest part of the flight task is there, so the search did not end early.
    let (_, instructions) = extent(&program, image.find("DMA2_STREAM0").unwrap());
    assert!(instructions > 1_500, "{instructions} instructions in the flight task");

    // Bringing the board up can panic, and that is found.
    let found = check_free_of_panics(image, &program, "Reset").unwrap_err();
    assert!(found.contains("core::panicking"), "{found}");
    println!("not in the fast loop: {found}");
}

/// Whether `root` neither panics, nor runs into an undefined instruction, nor calls anything by a register.
fn check_free_of_panics(image: &Image, program: &Program, root: &str) -> Result<(), String> {
    let start = image.find(root).ok_or(format!("{root} is not in the image"))?;
    let mut reached = program.reached(start, |_| false);
    if let Ok(reached) = &mut reached {
        // Nearest first: the shortest chain says most.
        let mut nearest: Vec<u32> = reached.keys().copied().collect();
        nearest.sort_by_key(|&function| program.chain(reached, function).lines().count());
        for function in nearest {
            let chain = program.chain(reached, function);
            if is_panic(image.name(function)) {
                return Err(format!("a panic can be reached:\n  {chain}"));
            }
            if let Some(at) = program.function(function)?.traps.first() {
                return Err(format!("an undefined instruction can be reached at {at:#x}:\n  {chain}"));
            }
            let mut calls = program.function(function)?.calls.iter();
            if let Some(call) = calls.find(|call| matches!(call.callee, Callee::Register)) {
                return Err(format!("a call by a register at {:#x}:\n  {chain}", call.at));
            }
        }
    }
    reached.map(|_| ())
}

fn is_panic(name: &str) -> bool {
    PANICS.iter().any(|beginning| name.starts_with(beginning))
}

#[test]
#[ignore = "builds the firmware for the board"]
fn the_stack_holds_the_worst_nesting_of_handlers() {
    let image = flight_image();
    let program = Program::new(image);
    let depth_of = |name: &str| -> Depth {
        let start = image.find(name).unwrap_or_else(|| panic!("{name} is not in the image"));
        depth(image, &program, start).unwrap_or_else(|why| panic!("{why}"))
    };

    // Every vector is accounted for. What has no handler of its own goes to the default one.
    let vectors: BTreeSet<&str> = image.vectors.iter().map(|&handler| image.name(handler)).collect();
    let known = HANDLERS.map(|(name, _)| name);
    let others = ["Reset", "HardFault", "DefaultHandler"];
    assert_eq!(vectors, known.into_iter().chain(others).collect(), "the image's vectors, and the table's");

    println!("{:16} {:>8} {:>6} {:>12}   deepest calls", "root", "priority", "bytes", "instructions");
    let show = |name: &str, priority: &str, depth: &Depth| {
        let (functions, instructions) = extent(&program, image.find(name).unwrap());
        let path: Vec<&str> = depth.path.iter().skip(1).map(|&function| image.name(function)).collect();
        let path = path.join(" → ");
        println!(
            "{name:16} {priority:>8} {:>6} {instructions:>12}   {functions} functions; {path}",
            depth.bytes
        );
    };
    // From here to the idle task, which never ends: bringing the board up is the deepest of it. That runs with interrupts
    // off, so the sum is more than can come together.
    let base = depth_of("Reset");
    show("Reset", "0", &base);
    let mut levels: BTreeMap<u8, u32> = BTreeMap::new();
    let mut each_on_top = 0;
    for (name, priority) in HANDLERS {
        let depth = depth_of(name);
        show(name, &priority.to_string(), &depth);
        let level = levels.entry(priority).or_default();
        *level = depth.bytes.max(*level);
        each_on_top += SAVED_BYTES + depth.bytes;
    }
    // The last level: an interrupt that nobody expected, or a fault. Neither comes back.
    let last = depth_of("DefaultHandler");
    show("DefaultHandler", "any", &last);
    let fault = depth_of("HardFault");
    show("HardFault", "fault", &fault);
    let last = SAVED_BYTES + last.bytes.max(fault.bytes);

    let bound = base.bytes + levels.values().map(|level| SAVED_BYTES + level).sum::<u32>() + last;
    let without_priorities = base.bytes + each_on_top + last;
    println!(
        "bound {bound} of {} bytes, {SAVED_BYTES} saved at each of {} interruptions among them; if each handler \
         interrupted all others, {without_priorities}",
        image.stack_bytes,
        levels.len() + 1,
    );
    assert!(bound <= image.stack_bytes, "{bound} bytes of stack, and there are {}", image.stack_bytes);
}

/// The stack of `start`, up to where a panic begins.
fn depth(image: &Image, program: &Program, start: u32) -> Result<Depth, String> {
    let nested = |name: &str| name.contains("core::fmt::").then_some(FORMATTED_DEPTH);
    program.depth(start, |function| is_panic(image.name(function)), nested)
}

/// Functions and instructions that can be reached.
fn extent(program: &Program, root: u32) -> (usize, usize) {
    let reached = program.reached(root, |_| false).unwrap();
    (reached.len(), reached.keys().map(|&function| program.function(function).unwrap().instructions).sum())
}

/// Builds the image once, in a target directory of its own: the outer build's is locked.
fn flight_image() -> &'static Image {
    static IMAGE: OnceLock<Image> = OnceLock::new();
    IMAGE.get_or_init(|| {
        let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("linked-image");
        let status = Command::new(env::var_os("CARGO").as_deref().unwrap_or(OsStr::new("cargo")))
            .current_dir(Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap())
            .args(["build", "--release", "--package", "firmware", "--target", "thumbv7em-none-eabihf"])
            .arg("--target-dir")
            .arg(&target)
            // These would replace the link arguments of .cargo/config.toml.
            .env_remove("RUSTFLAGS")
            .env_remove("CARGO_ENCODED_RUSTFLAGS")
            .status()
            .expect("cargo runs");
        assert!(status.success(), "the image does not build");
        Image::read(&target.join("thumbv7em-none-eabihf/release/firmware"))
    })
}
