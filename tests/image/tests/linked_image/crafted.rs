//! Tests of the analysis on instructions and small programs with known results, above all on those that it must
//! refuse.

use crate::{FORMATTED_DEPTH, check_free_of_panics, depth};
use image_tests::image::Image;
use image_tests::program::Program;
use image_tests::thumb::{Condition, Flow, Half, Stack, decode};

#[test]
fn instructions_that_move_sp_or_pc_are_decoded() {
    // Addresses, codes and meaning as a disassembler shows them.
    for (address, first, second, length, flow, stack) in [
        (0x0801_0000, 0xf005, 0xfe2c, 4, Flow::Call(0x0801_5c5c), Stack::Keep), // bl
        (0x0801_005e, 0xf004, 0xbe11, 4, Flow::Jump(0x0801_4c84), Stack::Keep), // b.w
        (0x0801_21f8, 0xf200, 0x8095, 4, Flow::Branch(0x0801_2326), Stack::Keep), // bhi.w
        (0x0801_0236, 0xdb4c, 0, 2, Flow::Branch(0x0801_02d2), Stack::Keep),    // blt
        (0x0801_0076, 0xb1a9, 0, 2, Flow::Branch(0x0801_00a4), Stack::Keep),    // cbz r1
        (0x0801_2200, 0xe8df, 0xf012, 4, Flow::JumpTable { entry: 2 }, Stack::Keep), // tbh
        (0x0801_2cd0, 0xe8df, 0xf000, 4, Flow::JumpTable { entry: 1 }, Stack::Keep), // tbb
        (0, 0x4798, 0, 2, Flow::CallRegister, Stack::Keep),                     // blx r3
        (0, 0x4718, 0, 2, Flow::JumpRegister, Stack::Keep),                     // bx r3
        (0, 0x4770, 0, 2, Flow::Return, Stack::Keep),                           // bx lr
        (0, 0xde00, 0, 2, Flow::Trap, Stack::Keep),                             // udf
        (0, 0xf7f0, 0xa000, 4, Flow::Trap, Stack::Keep),                        // udf.w
        (0, 0xb510, 0, 2, Flow::Next, Stack::Grow(8)),                          // push {r4, lr}
        (0, 0xbdf0, 0, 2, Flow::Return, Stack::Grow(-20)),                      // pop {r4-r7, pc}
        (0, 0xe92d, 0x0f00, 4, Flow::Next, Stack::Grow(16)),                    // push.w {r8-r11}
        (0, 0xe8bd, 0x0f00, 4, Flow::Next, Stack::Grow(-16)),                   // pop.w {r8-r11}
        (0, 0xed2d, 0x8b10, 4, Flow::Next, Stack::Grow(64)),                    // vpush {d8-d15}
        (0, 0xecbd, 0x8b10, 4, Flow::Next, Stack::Grow(-64)),                   // vpop {d8-d15}
        (0, 0xf84d, 0x8d04, 4, Flow::Next, Stack::Grow(4)),                     // str r8, [sp, #-4]!
        (0, 0xf85d, 0x8b04, 4, Flow::Next, Stack::Grow(-4)),                    // ldr r8, [sp], #4
        (0, 0xf85d, 0xfb04, 4, Flow::Return, Stack::Grow(-4)),                  // ldr pc, [sp], #4
        (0, 0xb084, 0, 2, Flow::Next, Stack::Grow(16)),                         // sub sp, #16
        (0, 0xf5ad, 0x6db8, 4, Flow::Next, Stack::Grow(1_472)),                 // sub.w sp, sp, #1472
        (0, 0xf50d, 0x6db8, 4, Flow::Next, Stack::Grow(-1_472)),                // add.w sp, sp, #1472
        (0, 0xf2ad, 0x4dbc, 4, Flow::Next, Stack::Grow(1_212)),                 // subw sp, sp, #1212
        (0, 0xf380, 0x8808, 4, Flow::Next, Stack::Reset),                       // msr msp, r0
        (0, 0xeef1, 0xfa10, 4, Flow::Next, Stack::Keep),                        // vmrs APSR_nzcv, fpscr
        (0, 0xfbb3, 0xf2f1, 4, Flow::Next, Stack::Keep),                        // udiv r2, r3, r1
    ] {
        let decoded = decode(address, first, second).unwrap();
        assert_eq!(
            (decoded.length, decoded.flow, decoded.stack),
            (length, flow, stack),
            "{first:04x} {second:04x}"
        );
    }
    let constant = |first, second| decode(0, first, second).unwrap().constant;
    assert_eq!(constant(0xf244, 0x004c), Some((0, Half::Low, 16_460))); // movw r0, #16460
    assert_eq!(constant(0xf2c2, 0x0000), Some((0, Half::High, 8_192))); // movt r0, #8192
    let block = |first| decode(0, first, 0).unwrap().block.unwrap().conditions().collect::<Vec<_>>();
    const LO: Condition = 3;
    const HS: Condition = 2;
    assert_eq!(block(0xbf38), [LO]); // it lo
    assert_eq!(block(0xbf3f), [LO; 4]); // itttt lo
    assert_eq!(block(0xbf36), [LO, HS, LO]); // itet lo
}

#[test]
fn other_ways_to_write_sp_or_pc_are_refused() {
    for (first, second, what) in [
        (0x46a5, 0, "mov sp, r4"),
        (0x46a7, 0, "mov pc, r4"),
        (0x44a5, 0, "add sp, r4"),
        (0xebad, 0x0d04, "sub.w sp, sp, r4"),
        (0xf1a7, 0x0d18, "sub.w sp, r7, #24"),
        (0xf36f, 0x0d02, "bfc sp, #0, #3"),
        (0xf8d0, 0xd000, "ldr.w sp, [r0]"),
        (0xf8d0, 0xf000, "ldr.w pc, [r0]"),
        (0xf85f, 0xf004, "ldr.w pc, [pc, #-4]"),
        (0xe890, 0x8010, "ldm.w r0, {r4, pc}"),
        (0xe8ad, 0x0030, "stm.w sp!, {r4, r5}"),
        (0xecad, 0x8b02, "vstmia sp!, {d8}"),
        (0xf380, 0x8809, "msr psp, r0"),
        (0xf380, 0x8814, "msr control, r0"),
        (0xe8d0, 0xf001, "tbb [r0, r1]"),
        (0xdf00, 0, "svc #0"),
        (0xbe00, 0, "bkpt #0"),
        (0xf000, 0xe800, "blx into ARM code"),
    ] {
        assert!(decode(0, first, second).is_err(), "{what}");
    }
}

const PUSH: u16 = 0xb510; // push {r4, lr}
const POP: u16 = 0xbd10; // pop {r4, pc}
const RETURN: u16 = 0x4770; // bx lr
const FOREVER: u16 = 0xe7fe; // b to itself
const CALL_NEXT: [u16; 2] = [0xf000, 0xf801]; // bl, over one half-word
const CALL_BACK: [u16; 2] = [0xf7ff, 0xfffd]; // bl, to the half-word before

fn stack(functions: &[(&str, &[u16])]) -> Result<u32, String> {
    let image = Image::of(functions);
    depth(&image, &Program::new(&image), 0).map(|depth| depth.bytes)
}

fn panics(functions: &[(&str, &[u16])]) -> Result<(), String> {
    let image = Image::of(functions);
    check_free_of_panics(&image, &Program::new(&image), "root")
}

#[test]
fn panic_is_found_through_calls_and_jumps() {
    let panic: (&str, &[u16]) = ("core::panicking::panic_fmt", &[FOREVER]);
    let called = [PUSH, CALL_NEXT[0], CALL_NEXT[1], POP];
    // The middle function is left by a jump that only one of its paths takes.
    let functions: [(&str, &[u16]); 3] = [("root", &called), ("middle", &[0xb900, RETURN]), panic];
    let found = panics(&functions).unwrap_err();
    assert_eq!(found, "a panic can be reached:\n  root\n  → middle\n  → core::panicking::panic_fmt");

    assert_eq!(panics(&[("root", &called), ("middle", &[RETURN, RETURN]), panic]), Ok(()));
    assert!(panics(&[("root", &[0xde00])]).unwrap_err().starts_with("an undefined instruction"));
    assert!(panics(&[("root", &[PUSH, 0x4798, POP])]).unwrap_err().starts_with("a call by a register"));
}

#[test]
fn stack_is_the_sum_along_the_deepest_calls() {
    // 8 bytes pushed and 16 for variables, and 8 of the callee for floating point.
    let root = [PUSH, 0xb084, CALL_NEXT[0], CALL_NEXT[1] + 1, 0xb004, POP];
    let callee = [0xed2d, 0x8b02, 0xecbd, 0x8b02, RETURN];
    assert_eq!(stack(&[("root", &root), ("callee", &callee)]), Ok(8 + 16 + 8));

    // After a call that does not return, other bytes may follow.
    assert_eq!(stack(&[("root", &[PUSH, CALL_NEXT[0], CALL_NEXT[1], 0x46a5]), ("ends", &[FOREVER])]), Ok(8));
    // A conditional return: `it lo`, `poplo {r4, pc}`.
    assert_eq!(stack(&[("root", &[PUSH, 0xbf38, POP, POP])]), Ok(8));
}

#[test]
fn register_call_reaches_functions_with_a_stored_address() {
    // movw r3, #15; movt r3, #0; blx r3: the address of the next function, with the Thumb bit.
    let root = [PUSH, 0xf240, 0x030f, 0xf2c0, 0x0300, 0x4798, POP];
    assert_eq!(stack(&[("root", &root), ("next", &[PUSH, 0xb084, 0xb004, POP])]), Ok(8 + 24));
}

#[test]
fn formatting_recursion_is_bounded_by_the_nesting_depth() {
    let within_itself = [PUSH, CALL_BACK[0], CALL_BACK[1], POP];
    assert_eq!(stack(&[("core::fmt::write", &within_itself)]), Ok(8 * FORMATTED_DEPTH));
}

#[test]
fn unbounded_stack_is_refused() {
    let refused = |functions: &[(&str, &[u16])], why: &str| {
        let message = stack(functions).unwrap_err();
        assert!(message.contains(why), "{message}");
    };
    refused(&[("root", &[PUSH, RETURN])], "another sp than it was entered with");
    refused(&[("root", &[POP])], "more is popped");
    refused(&[("root", &[0x46a5, RETURN])], "writes sp");
    refused(&[("root", &[PUSH])], "leaves the function's instructions");
    refused(&[("root", &[0xbf38, PUSH, POP])], "under a condition");
    // `cbnz` over a `push`.
    refused(&[("root", &[0xb900, PUSH, RETURN])], "than another path");
    refused(&[("root", &[PUSH, CALL_BACK[0], CALL_BACK[1], POP])], "a cycle of calls");
    refused(&[("root", &[0xe000]), ("next", &[RETURN, RETURN])], "the middle of a function");
}

#[test]
fn jump_table_ends_before_the_literals_behind_it() {
    // tbb [pc, r0]; two entries; a literal; then the targets of the entries, one of which is a panic.
    let root = [0xe8df, 0xf000, 0x0403, 0x0000, 0x0000, RETURN, 0xe7ff];
    let image = Image::of(&[("root", &root), ("core::panicking::panic_fmt", &[FOREVER])]).with_data(4..10);
    let found = check_free_of_panics(&image, &Program::new(&image), "root").unwrap_err();
    assert!(found.starts_with("a panic can be reached"), "{found}");
}
