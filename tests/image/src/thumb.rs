//! Decoder of ARMv7E-M instructions, restricted to their effect on the program counter and the stack pointer.
//!
//! The encodings are those of the ARMv7-M Architecture Reference Manual (ARM DDI 0403), chapters A5 and A6.
//! Every class that can write a core register is checked for writing `sp` or `pc`. An unknown way of doing so is an
//! error, and so is an encoding that the manual does not define for this core.

use std::ops::Not as _;

/// The effect on the program counter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Flow {
    Next,
    Jump(u32),
    /// The program continues at the target or at the next instruction.
    Branch(u32),
    Call(u32),
    /// `blx` of a register.
    CallRegister,
    /// `bx` of a register other than `lr`.
    JumpRegister,
    /// `tbb` or `tbh`: through a table of offsets behind the instruction, with `entry` bytes each.
    JumpTable {
        entry: u32,
    },
    Return,
    /// A permanently undefined instruction, which is a fault.
    Trap,
}

/// The effect on the stack pointer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stack {
    Keep,
    /// The stack grows by this many bytes; a pop is negative.
    Grow(i32),
    /// Set to an address that does not belong to the function's stack.
    Reset,
}

/// Half of a 32-bit constant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Half {
    Low,
    High,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instruction {
    pub length: u32,
    pub flow: Flow,
    pub stack: Stack,
    /// `movw` or `movt`: register, half, value.
    pub constant: Option<(u32, Half, u32)>,
    /// An `it` block: the next instructions depend on conditions.
    pub block: Option<Block>,
}

const PLAIN: Instruction =
    Instruction { length: 2, flow: Flow::Next, stack: Stack::Keep, constant: None, block: None };

/// A condition code: 0 is `eq`, 1 `ne`, 4 `mi`, 5 `pl`; the lowest bit inverts it.
pub type Condition = u32;

/// The conditions that an `it` gives to the instructions after it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    first: Condition,
    mask: u32,
}

impl Block {
    /// Returns the condition of each instruction in the block: between one and four.
    pub fn conditions(self) -> impl Iterator<Item = Condition> {
        // The lowest set bit ends the mask. The bits above it are the lowest bits of the further conditions.
        let further = (1..4 - self.mask.trailing_zeros()).map(move |n| self.mask >> (4 - n) & 1);
        std::iter::once(self.first).chain(further.map(move |lowest| self.first & !1 | lowest))
    }
}

pub const SP: u32 = 13;
pub const LR: u32 = 14;
pub const PC: u32 = 15;

type Decoded = Result<Instruction, &'static str>;

/// Decodes the instruction at `address`; `second` matters only if `first` starts a 32-bit instruction.
pub fn decode(address: u32, first: u16, second: u16) -> Decoded {
    let (first, second) = (u32::from(first), u32::from(second));
    if first >> 11 < 0b11101 {
        narrow(address, first)
    } else {
        wide(address, first, second).map(|wide| Instruction { length: 4, ..wide })
    }
}

fn flow(flow: Flow) -> Instruction {
    Instruction { flow, ..PLAIN }
}

fn grow(bytes: i32) -> Instruction {
    Instruction { stack: Stack::Grow(bytes), ..PLAIN }
}

/// Returns an instruction that pushes the registers of the list, 4 bytes each.
fn push(list: u32) -> Instruction {
    grow(4 * list.count_ones() as i32)
}

fn pop(list: u32) -> Instruction {
    let flow = if list & 1 << PC == 0 { Flow::Next } else { Flow::Return };
    Instruction { flow, ..grow(-4 * list.count_ones() as i32) }
}

/// Returns an instruction that writes a register; an error for `sp` and `pc`.
fn writes(register: u32) -> Decoded {
    match register {
        SP => Err("writes sp"),
        PC => Err("writes pc"),
        _ => Ok(PLAIN),
    }
}

pub fn bit(value: u32, n: u32) -> bool {
    value >> n & 1 == 1
}

/// Returns the target of a branch; `value` is its offset, a signed number of `bits` bits.
fn target(address: u32, value: u32, bits: u32) -> u32 {
    let offset = ((value << (32 - bits)) as i32) >> (32 - bits);
    (address + 4).wrapping_add_signed(offset)
}

fn narrow(address: u32, code: u32) -> Decoded {
    Ok(match code >> 8 {
        // Shifts, arithmetic and comparison of r0 to r7
        0x00..=0x43 => PLAIN,
        // add, mov of any register
        0x44 | 0x46 => writes(code >> 4 & 8 | code & 7)?,
        0x45 => PLAIN,
        0x47 => flow(match (bit(code, 7), code >> 3 & 15) {
            (true, _) => Flow::CallRegister,
            (false, LR) => Flow::Return,
            (false, _) => Flow::JumpRegister,
        }),
        // Loads and stores of r0 to r7 without write-back, adr, add of sp to r0 to r7
        0x48..=0xaf => PLAIN,
        0xb0 => {
            let bytes = 4 * (code & 0x7f) as i32;
            grow(if bit(code, 7) { bytes } else { -bytes })
        }
        // cbz, cbnz: forward only
        0xb1 | 0xb3 | 0xb9 | 0xbb => flow(Flow::Branch(address + 4 + (code >> 3 & 0x40 | code >> 2 & 0x3e))),
        // Extension
        0xb2 => PLAIN,
        0xb4 | 0xb5 => push(code & 0x1ff),
        // cps
        0xb6 if code & 0xffe8 == 0xb660 => PLAIN,
        // Reversal
        0xba if code >> 6 & 3 != 2 => PLAIN,
        0xbc => pop(code & 0xff),
        0xbd => pop(code & 0xff | 1 << PC),
        // Hints, and it
        0xbf => match code & 15 {
            0 => PLAIN,
            mask => Instruction { block: Some(Block { first: code >> 4 & 15, mask }), ..PLAIN },
        },
        // stm, ldm of r0 to r7, based on one of them
        0xc0..=0xcf => PLAIN,
        0xd0..=0xdd => flow(Flow::Branch(target(address, code << 1 & 0x1fe, 9))),
        0xde => flow(Flow::Trap),
        0xe0..=0xe7 => flow(Flow::Jump(target(address, code << 1 & 0xffe, 12))),
        _ => return Err("bkpt, svc, or not a 16-bit instruction of this core"),
    })
}

fn wide(address: u32, first: u32, second: u32) -> Decoded {
    match first >> 8 {
        0xe8 | 0xe9 if bit(first, 6) => pair_or_exclusive(first, second),
        0xe8 | 0xe9 => multiple(first, second),
        0xea | 0xeb => arithmetic(first, second, None),
        0xec | 0xed => float_memory(first, second),
        0xee => float_arithmetic(first, second),
        0xf0..=0xf7 if bit(second, 15) => branch(address, first, second),
        0xf0..=0xf7 if bit(first, 9) => plain_immediate(first, second),
        0xf0..=0xf7 => arithmetic(first, second, Some(expanded_immediate(first, second))),
        0xf8 | 0xf9 => single(first, second),
        0xfa if second >> 12 == 15 => writes(second >> 8 & 15),
        0xfb => {
            // A division has ones in the field of a long multiplication's low result.
            if bit(first, 7) && second >> 12 == SP {
                return Err("writes sp");
            }
            writes(second >> 8 & 15)
        }
        _ => Err("not a 32-bit instruction of this core"),
    }
}

/// stm, ldm
fn multiple(first: u32, list: u32) -> Decoded {
    let (load, write_back, base) = (bit(first, 4), bit(first, 5), first & 15);
    if bit(list, SP) {
        return Err("sp in a list of registers");
    }
    match (first >> 7 & 3, load) {
        (0b01, true) if base == SP && write_back => Ok(pop(list)),
        (0b10, false) if base == SP && write_back => Ok(push(list)),
        (0b01 | 0b10, _) if base == SP && write_back => Err("sp written back, but neither push nor pop"),
        (0b01 | 0b10, true) if bit(list, PC) => Err("loads pc"),
        (0b01 | 0b10, _) => Ok(PLAIN),
        _ => Err("not a 32-bit instruction of this core"),
    }
}

/// strd, ldrd, strex, ldrex, tbb, tbh
fn pair_or_exclusive(first: u32, second: u32) -> Decoded {
    let (before, up, write_back, load) = (bit(first, 8), bit(first, 7), bit(first, 5), bit(first, 4));
    let (base, one, other) = (first & 15, second >> 12, second >> 8 & 15);
    if before || write_back {
        if load {
            writes(one)?;
            writes(other)?;
        }
        let bytes = 4 * (second & 0xff) as i32;
        return Ok(if write_back && base == SP { grow(if up { -bytes } else { bytes }) } else { PLAIN });
    }
    match (up, load, second >> 4 & 15) {
        (false, false, _) => writes(other),
        (false, true, _) => writes(one),
        (true, true, size @ (0 | 1)) if base == PC => Ok(flow(Flow::JumpTable { entry: 1 + size })),
        (true, true, 0 | 1) => Err("a jump table that does not follow its instruction"),
        (true, true, 4 | 5) => writes(one),
        (true, false, 4 | 5) => writes(second & 15),
        _ => Err("not a 32-bit instruction of this core"),
    }
}

/// Arithmetic of registers, or of a register and an immediate
fn arithmetic(first: u32, second: u32, immediate: Option<i32>) -> Decoded {
    let (operation, sets_flags, from, to) = (first >> 5 & 15, bit(first, 4), first & 15, second >> 8 & 15);
    match (operation, immediate) {
        // tst, teq, cmn, cmp
        (0 | 4 | 8 | 13, _) if to == PC && sets_flags => Ok(PLAIN),
        (8, Some(bytes)) if to == SP && from == SP => Ok(grow(-bytes)),
        (13, Some(bytes)) if to == SP && from == SP => Ok(grow(bytes)),
        _ => writes(to),
    }
}

pub fn twelve_bits(first: u32, second: u32) -> u32 {
    (first & 0x400) << 1 | second >> 4 & 0x700 | second & 0xff
}

/// Expands a modified immediate: a byte in one of four patterns, or a byte with its highest bit set, rotated.
pub fn expanded_immediate(first: u32, second: u32) -> i32 {
    let coded = twelve_bits(first, second);
    let byte = coded & 0xff;
    let value = match coded >> 8 {
        0 => byte,
        1 => byte * 0x0001_0001,
        2 => byte * 0x0100_0100,
        3 => byte * 0x0101_0101,
        _ => (byte | 0x80).rotate_right(coded >> 7),
    };
    value as i32
}

/// addw, subw, movw, movt, bit fields, saturation
fn plain_immediate(first: u32, second: u32) -> Decoded {
    let (from, to, value) = (first & 15, second >> 8 & 15, twelve_bits(first, second));
    match first >> 4 & 31 {
        0 if to == SP && from == SP => Ok(grow(-(value as i32))),
        10 if to == SP && from == SP => Ok(grow(value as i32)),
        half @ (4 | 12) => {
            let half = if half == 4 { Half::Low } else { Half::High };
            Ok(Instruction { constant: Some((to, half, from << 12 | value)), ..writes(to)? })
        }
        0 | 10 | 16 | 18 | 20 | 22 | 24 | 26 | 28 => writes(to),
        _ => Err("not a 32-bit instruction of this core"),
    }
}

fn branch(address: u32, first: u32, second: u32) -> Decoded {
    let sign = first >> 10 & 1;
    let (j1, j2, low) = (second >> 13 & 1, second >> 11 & 1, second << 1 & 0xffe);
    let far = || {
        let (i1, i2) = (!(j1 ^ sign) & 1, !(j2 ^ sign) & 1);
        target(address, sign << 24 | i1 << 23 | i2 << 22 | first << 12 & 0x3f_f000 | low, 25)
    };
    match (bit(second, 14), bit(second, 12)) {
        (false, true) => Ok(flow(Flow::Jump(far()))),
        (true, true) => Ok(flow(Flow::Call(far()))),
        (true, false) => Err("a call into ARM code"),
        (false, false) if first >> 7 & 7 == 7 => system(first, second),
        (false, false) => {
            let near = sign << 20 | j2 << 19 | j1 << 18 | first << 12 & 0x3_f000 | low;
            Ok(flow(Flow::Branch(target(address, near, 21))))
        }
    }
}

fn system(first: u32, second: u32) -> Decoded {
    const MSP: u32 = 8;
    const PSP: u32 = 9;
    const CONTROL: u32 = 20;
    match first {
        // msr
        0xf380..=0xf38f => match second & 0xff {
            MSP => Ok(Instruction { stack: Stack::Reset, ..PLAIN }),
            PSP | CONTROL => Err("another stack"),
            _ => Ok(PLAIN),
        },
        // Hints, barriers
        0xf3af | 0xf3bf => Ok(PLAIN),
        // mrs
        0xf3ef => writes(second >> 8 & 15),
        0xf7f0..=0xf7ff if second >> 12 == 0b1010 => Ok(flow(Flow::Trap)),
        _ => Err("not a system instruction of this core"),
    }
}

/// ldr and str of a byte, a half-word or a word
fn single(first: u32, second: u32) -> Decoded {
    let (signed, load, size) = (bit(first, 8), bit(first, 4), first >> 5 & 3);
    let (base, register) = (first & 15, second >> 12);
    if size == 3 || signed && !load {
        return Err("not a 32-bit instruction of this core");
    }
    let by_literal_or_offset = base == PC || bit(first, 7);
    let write_back = by_literal_or_offset.not() && bit(second, 11) && bit(second, 8);
    if by_literal_or_offset.not() && bit(second, 11).not() && second & 0x7c0 != 0 {
        return Err("not a 32-bit instruction of this core");
    }
    let moved = if write_back && base == SP {
        let bytes = (second & 0xff) as i32;
        grow(if bit(second, 9) { -bytes } else { bytes })
    } else {
        PLAIN
    };
    match (load, register) {
        (true, SP) => Err("writes sp"),
        (true, PC) if size < 2 => Ok(moved), // a preload
        (true, PC) if base == SP && write_back && second & 0xfff == 0xb04 => {
            Ok(Instruction { flow: Flow::Return, ..moved })
        }
        (true, PC) => Err("loads pc"),
        _ => Ok(moved),
    }
}

fn is_float_unit(second: u32) -> bool {
    second >> 9 & 7 == 0b101
}

/// vstr, vldr, vpush, vpop, and moves of two core registers
fn float_memory(first: u32, second: u32) -> Decoded {
    let (before, up, write_back, load) = (bit(first, 8), bit(first, 7), bit(first, 5), bit(first, 4));
    if is_float_unit(second).not() {
        return Err("a coprocessor that this core does not have");
    }
    if first & 0xffe0 == 0xec40 {
        if load {
            writes(second >> 12)?;
            writes(first & 15)?;
        }
        return Ok(PLAIN);
    }
    let bytes = 4 * (second & 0xff) as i32;
    match (before, up, write_back, load) {
        (true, _, false, _) | (false, true, false, _) => Ok(PLAIN),
        (true, false, true, _) | (false, true, true, _) if first & 15 != SP => Ok(PLAIN),
        (true, false, true, false) => Ok(grow(bytes)),
        (false, true, true, true) => Ok(grow(-bytes)),
        _ => Err("sp written back, but neither vpush nor vpop, or not an instruction of this core"),
    }
}

fn float_arithmetic(first: u32, second: u32) -> Decoded {
    if is_float_unit(second).not() {
        return Err("a coprocessor that this core does not have");
    }
    let to_core = bit(second, 4) && bit(first, 4);
    // vmrs to the flags is coded as a write to pc.
    if to_core && (first, second >> 12) != (0xeef1, PC) { writes(second >> 12) } else { Ok(PLAIN) }
}
