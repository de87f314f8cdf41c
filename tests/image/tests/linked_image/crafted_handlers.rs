//! Tests of the acknowledgement check on small handlers with known results, above all on those that it must refuse.

use crate::acknowledge::{Kind, NotAsserted, Step, check};
use image_tests::image::Image;

const CLEAR: Step = Step { register: "LIFCR", address: 0x4002_6408, kind: Kind::WriteOnes(1 << 5) };

const BASE: [u16; 4] = [0xf246, 0x4000, 0xf2c4, 0x0002]; // movw, movt: r0 = 0x40026400
const FLAG: u16 = 0x2120; // movs r1, #32
const WRITE: u16 = 0x6081; // str r1, [r0, #8]
const RETURN: u16 = 0x4770; // bx lr
const NOP: u16 = 0xbf00;
const PUSH: u16 = 0xb510; // push {r4, lr}
const POP: u16 = 0xbd10; // pop {r4, pc}
const CALL_NEXT: [u16; 2] = [0xf000, 0xf801]; // bl, over one half-word
const SKIP_ONE_IF_R3: u16 = 0xb903; // cbnz r3, over one half-word

fn code(parts: &[&[u16]]) -> Vec<u16> {
    parts.concat()
}

fn by(steps: &[Step], unless: Option<NotAsserted>, functions: &[(&str, &[u16])]) -> Result<bool, String> {
    check(&Image::of(functions), "handler", steps, unless).map(|found| found.excused)
}

fn acknowledges(functions: &[(&str, &[u16])]) -> Result<bool, String> {
    by(&[CLEAR], None, functions)
}

fn handler(parts: &[&[u16]]) -> Result<bool, String> {
    acknowledges(&[("handler", &code(parts))])
}

#[track_caller]
fn refuses(parts: &[&[u16]]) {
    let message = handler(parts).unwrap_err();
    assert!(
        message.contains("handler can return without a write of 0x20 to LIFCR (0x40026408)"),
        "{message}"
    );
}

#[test]
fn write_is_found_for_every_form_of_its_address() {
    assert_eq!(handler(&[&BASE, &[FLAG, WRITE, RETURN]]), Ok(false));
    // movw, movt: 0x40026000; then add.w r0, r0, #0x400
    assert_eq!(handler(&[&[0xf246, 0x0000, 0xf2c4, 0x0002, 0xf500, 0x6080, FLAG, WRITE, RETURN]]), Ok(false));
    // mov r4, r0; str r1, [r4, #8]
    assert_eq!(handler(&[&BASE, &[FLAG, 0x4604, 0x60a1, RETURN]]), Ok(false));
    // str r1, [r0], #8 writes elsewhere, and moves the base so that str r1, [r0] is right.
    assert_eq!(handler(&[&BASE, &[FLAG, 0xf840, 0x1b08, 0x6001, RETURN]]), Ok(false));
    refuses(&[&BASE, &[FLAG, 0xf840, 0x1b08, RETURN]]);
    // strd r1, r1, [r0, #4] writes it with its second word; stm r0!, {r1, r2} does not.
    assert_eq!(handler(&[&BASE, &[FLAG, 0xe9c0, 0x1101, RETURN]]), Ok(false));
    refuses(&[&BASE, &[FLAG, 0xc006, RETURN]]);
    // strh.w r1, [r0, #8]
    assert_eq!(handler(&[&BASE, &[FLAG, 0xf8a0, 0x1008, RETURN]]), Ok(false));
    // ldr r0, [pc, #4] loads a literal that is behind the code.
    let by_literal = [0x4801, FLAG, WRITE, RETURN, 0x6400, 0x4002];
    let image = Image::of(&[("handler", &by_literal)]).with_data(8..12);
    assert!(check(&image, "handler", &[CLEAR], None).is_ok());
}

#[test]
fn path_without_the_write_is_reported() {
    let message = handler(&[&BASE, &[0x6802, FLAG, SKIP_ONE_IF_R3, WRITE, RETURN]]).unwrap_err();
    assert_eq!(
        message,
        "handler can return without a write of 0x20 to LIFCR (0x40026408):\n  \
         0x00000000 to 0x0000000c handler, reads 0x40026400\n  \
         0x00000010 to 0x00000010 handler"
    );
    // The same branch after a write, and the write under a condition: `it ne`, `strne`.
    assert_eq!(handler(&[&BASE, &[FLAG, WRITE, SKIP_ONE_IF_R3, WRITE, RETURN]]), Ok(false));
    refuses(&[&BASE, &[FLAG, 0xbf18, WRITE, RETURN]]);
    // The return is under a condition, and by pop.
    refuses(&[&BASE, &[FLAG, 0xbf18, RETURN, WRITE, RETURN]]);
    refuses(&[&[PUSH, POP]]);
}

#[test]
fn path_that_does_not_return_needs_no_write() {
    // `cbnz r3` over a trap to the write; an endless loop.
    assert_eq!(handler(&[&BASE, &[FLAG, SKIP_ONE_IF_R3, 0xde00, WRITE, RETURN]]), Ok(false));
    assert_eq!(handler(&[&[0xe7fe]]), Ok(false));
}

#[test]
fn constant_without_the_bit_is_no_acknowledgement() {
    // movs r1, #29 does not have the bit; the value of ldr r1, [r0] is unknown and accepted.
    refuses(&[&BASE, &[0x211d, WRITE, RETURN]]);
    assert_eq!(handler(&[&BASE, &[0x6801, WRITE, RETURN]]), Ok(false));
    let zeros = Step { kind: Kind::WriteZeros(1 << 5), ..CLEAR };
    let with = |constant| {
        by(&[zeros], None, &[("handler", &code(&[&BASE, &[constant, WRITE, RETURN]]))]).map_err(|_| ())
    };
    assert_eq!((with(FLAG), with(0x211d)), (Err(()), Ok(false)));
}

#[test]
fn address_that_may_differ_is_unknown() {
    // ldr r0, [r0]
    refuses(&[&BASE, &[FLAG, 0x6800, WRITE, RETURN]]);
    // `it ne`, `movne r0, r3`
    refuses(&[&BASE, &[FLAG, 0xbf18, 0x4618, WRITE, RETURN]]);
    // cbnz r3 over movs r0, #0
    refuses(&[&BASE, &[FLAG, SKIP_ONE_IF_R3, 0x2000, WRITE, RETURN]]);
    // A called function may change r0 to r3, but not r4.
    let next: (&str, &[u16]) = ("next", &[NOP, RETURN]);
    let calls = |store| code(&[&[PUSH], &BASE, &[0x4604, FLAG, CALL_NEXT[0], CALL_NEXT[1] + 1, store, POP]]);
    assert!(acknowledges(&[("handler", &calls(WRITE)), next]).is_err());
    assert_eq!(acknowledges(&[("handler", &calls(0x60a1)), next]), Ok(false));
}

#[test]
fn called_function_may_acknowledge() {
    let calls = [PUSH, CALL_NEXT[0], CALL_NEXT[1], POP];
    let clears = code(&[&BASE, &[FLAG, WRITE, RETURN]]);
    let may_clear = code(&[&BASE, &[FLAG, SKIP_ONE_IF_R3, WRITE, RETURN]]);
    assert_eq!(acknowledges(&[("handler", &calls), ("clear", &clears)]), Ok(false));
    let message = acknowledges(&[("handler", &calls), ("clear", &may_clear)]).unwrap_err();
    assert!(
        message.contains("to 0x00000012 clear\n") && message.ends_with("0x00000006 handler"),
        "{message}"
    );
    // The same with a jump at the end; the return of its target is the handler's.
    assert_eq!(acknowledges(&[("handler", &[0xe7ff]), ("clear", &clears)]), Ok(false));
    assert!(acknowledges(&[("handler", &[0xe7ff]), ("clear", &may_clear)]).is_err());
    // With a call by register the callee is unknown.
    assert!(acknowledges(&[("handler", &[PUSH, 0x4798, POP]), ("clear", &clears)]).is_err());
    // The function calls itself before the write.
    let itself = [PUSH, 0xf7ff, 0xfffd, POP];
    let message = acknowledges(&[("handler", &itself)]).unwrap_err();
    assert!(message.contains("nested too deep"), "{message}");
}

#[test]
fn each_entry_of_a_jump_table_is_followed() {
    // tbb [pc, r3] with two entries: to the write, and to the return behind it.
    let table = |second| {
        let handler = code(&[&BASE, &[FLAG, 0xe8df, 0xf003, second, WRITE, RETURN]]);
        let image = Image::of(&[("handler", &handler)]).with_data(14..16);
        check(&image, "handler", &[CLEAR], None).is_ok()
    };
    assert!(table(0x0101));
    assert!(!table(0x0201));
}

#[test]
fn two_steps_count_only_in_order() {
    const STATUS: Step = Step { register: "SR", address: 0x4000_4400, kind: Kind::Read };
    const DATA: Step = Step { register: "DR", address: 0x4000_4404, kind: Kind::Read };
    let read = |loads: &[u16]| {
        let port = [0xf244, 0x4000, 0xf2c4, 0x0000]; // r0 = 0x40004400
        by(&[STATUS, DATA], None, &[("handler", &code(&[&port, loads, &[RETURN]]))])
    };
    const LOAD_STATUS: u16 = 0x8802; // ldrh r2, [r0]
    const LOAD_DATA: u16 = 0x8883; // ldrh r3, [r0, #4]
    assert_eq!(read(&[LOAD_STATUS, LOAD_DATA]), Ok(false));
    assert_eq!(read(&[0xe9d0, 0x2300]), Ok(false)); // ldrd r2, r3, [r0]
    assert!(read(&[LOAD_DATA, LOAD_STATUS]).unwrap_err().contains("without a read of DR (0x40004404)"));
    assert!(read(&[LOAD_DATA]).unwrap_err().contains("without a read of SR (0x40004400)"));
    // Writes are no reads: str r2, [r0]
    assert!(read(&[0x6002, LOAD_DATA]).is_err());
}

#[test]
fn cleared_flag_excuses_a_path_if_the_table_allows() {
    const STATUS: u32 = 0x4000_0c10;
    const ZEROS: Step = Step { register: "SR", address: STATUS, kind: Kind::WriteZeros(1 << 1) };
    const EXCUSE: NotAsserted = NotAsserted { address: STATUS, bit: 1, why: "it was not asserted" };
    let timer = [0xf640, 0x4010, 0xf2c4, 0x0000, 0x2100]; // r0 = 0x40000c10; movs r1, #0
    let with = |unless, parts: &[u16]| {
        by(&[ZEROS], unless, &[("handler", &code(&[&timer, parts, &[0x6001, RETURN]]))]) // str r1, [r0]
    };
    const LOAD: u16 = 0x6802; // ldr r2, [r0]
    const SHIFT: u16 = 0x0792; // lsls r2, r2, #30: the flag is the sign
    const IF_PLUS: u16 = 0xbf58; // it pl
    let early_return = [LOAD, SHIFT, IF_PLUS, RETURN];
    assert_eq!(with(Some(EXCUSE), &early_return), Ok(true));
    assert!(with(None, &early_return).is_err());
    assert!(with(Some(NotAsserted { bit: 2, ..EXCUSE }), &early_return).is_err());
    assert!(with(Some(NotAsserted { address: STATUS + 4, ..EXCUSE }), &early_return).is_err());
    // The result shows that the excuse is not used: no path tests the flag here.
    assert_eq!(with(Some(EXCUSE), &[]), Ok(false));

    // tst.w r2, #2; ubfx r2, r2, #1, #1; and, with r3 = 2, tst r2, r3. Each skips the write if the flag is clear.
    const SKIP_IF_ZERO: u16 = 0xd000; // beq, over one half-word
    const SKIP_UNLESS_ZERO: u16 = 0xd100; // bne
    assert_eq!(with(Some(EXCUSE), &[LOAD, 0xf012, 0x0f02, SKIP_IF_ZERO]), Ok(true));
    assert_eq!(with(Some(EXCUSE), &[LOAD, 0xf3c2, 0x0240, 0xb102]), Ok(true)); // cbz r2
    assert_eq!(with(Some(EXCUSE), &[LOAD, 0x2302, 0x421a, SKIP_IF_ZERO]), Ok(true));
    assert_eq!(with(Some(EXCUSE), &[LOAD, 0xf3c2, 0x0240, 0x2a00, SKIP_IF_ZERO]), Ok(true)); // cmp r2, #0

    // Skips the write if the flag is set, on another bit, or with flags that another instruction has changed.
    assert!(with(Some(EXCUSE), &[LOAD, 0xf012, 0x0f02, SKIP_UNLESS_ZERO]).is_err());
    assert!(with(Some(EXCUSE), &[LOAD, 0xf3c2, 0x0240, 0xb902]).is_err()); // cbnz r2
    assert!(with(Some(EXCUSE), &[LOAD, 0xf3c2, 0x0280, 0xb102]).is_err()); // bit 2
    assert!(with(Some(EXCUSE), &[LOAD, 0xf012, 0x0f06, SKIP_IF_ZERO]).is_err()); // either of two bits
    assert!(with(Some(EXCUSE), &[LOAD, 0xf012, 0x0f02, 0x2b00, SKIP_IF_ZERO]).is_err()); // cmp r3, #0
    assert!(with(Some(EXCUSE), &[LOAD, SHIFT, 0x0792, IF_PLUS, RETURN]).is_err());
    // The register is loaded again from another address before the test.
    assert!(with(Some(EXCUSE), &[LOAD, 0x6842, SHIFT, IF_PLUS, RETURN]).is_err()); // ldr r2, [r0, #4]
}
