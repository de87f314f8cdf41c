//! Known values of the core registers along a path, and accesses to fixed addresses.
//!
//! A register's value is known if it is built from constants: `movw` and `movt`, literals, additions and the like.
//! After an instruction that is not decoded here, no register is known. So a value that is given as known is right on
//! every path, and a missing value only makes the check refuse more.

use image_tests::image::Image;
use image_tests::thumb::{Condition, LR, PC, SP, bit, expanded_immediate, twelve_bits};

/// A register's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Value {
    Unknown,
    Known(u32),
    /// The value that was read at this address.
    Read(u32),
    /// Zero if this bit of the value read at this address was zero, otherwise not zero.
    Bit(u32, u32),
}
use Value::{Known, Unknown};

/// The meaning of the flags for a bit of a value that was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Test {
    address: u32,
    bit: u32,
    /// The flag that depends on it: if `true`, N equals the bit; otherwise Z is its inverse.
    by_sign: bool,
}

/// A bit of a value read at an address, and its state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitRead {
    pub address: u32,
    pub bit: u32,
    pub set: bool,
}

/// An access to a known address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    Read(u32),
    Write(u32, Value),
}

impl Access {
    pub fn address(self) -> u32 {
        match self {
            Self::Read(address) | Self::Write(address, _) => address,
        }
    }
}

/// Registers and flags at a point of a path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Registers {
    values: [Value; 15],
    test: Option<Test>,
}

impl Registers {
    pub fn unknown() -> Self {
        Self { values: [Unknown; 15], test: None }
    }

    /// Returns what holds for both.
    pub fn join(&self, other: &Self) -> Self {
        let either = |n: usize| if self.values[n] == other.values[n] { self.values[n] } else { Unknown };
        Self { values: std::array::from_fn(either), test: self.test.filter(|_| self.test == other.test) }
    }

    /// Forgets the registers that a callee may change by the calling convention.
    pub fn forget_volatile(&mut self) {
        for register in [0, 1, 2, 3, 12, LR] {
            self.set(register, Unknown);
        }
        self.test = None;
    }

    pub fn get(&self, register: u32) -> Value {
        self.values.get(register as usize).copied().unwrap_or(Unknown)
    }

    fn set(&mut self, register: u32, value: Value) {
        // The stack pointer's value is never known.
        if register < PC && register != SP {
            self.values[register as usize] = value;
        }
    }

    fn forget_all(&mut self) {
        *self = Self::unknown();
    }

    /// Returns what the condition implies for a bit that was read.
    pub fn bit_if(&self, condition: Condition) -> Option<BitRead> {
        let Test { address, bit, by_sign } = self.test?;
        let set = match (condition, by_sign) {
            (0, false) => false, // eq
            (1, false) => true,  // ne
            (4, true) => true,   // mi
            (5, true) => false,  // pl
            _ => return None,
        };
        Some(BitRead { address, bit, set })
    }

    /// Returns what a register of zero implies for a bit that was read.
    fn bit_if_zero(&self, register: u32) -> Option<BitRead> {
        match self.get(register) {
            Value::Bit(address, bit) => Some(BitRead { address, bit, set: false }),
            _ => None,
        }
    }

    /// Returns what the branch implies for a bit if it is taken; the opposite holds if it is not taken.
    pub fn bit_if_taken(&self, first: u16, second: u16) -> Option<BitRead> {
        let (first, second) = (u32::from(first), u32::from(second));
        match first >> 8 {
            0xb1 | 0xb3 => self.bit_if_zero(first & 7),
            0xb9 | 0xbb => self.bit_if_zero(first & 7).map(BitRead::opposite),
            0xd0..=0xdd => self.bit_if(first >> 8 & 15),
            0xf0..=0xf7 if !bit(second, 12) && !bit(second, 14) => self.bit_if(first >> 6 & 15),
            _ => None,
        }
    }

    /// Executes the instruction at `at`, without its effect on the program counter, and returns the accesses to known
    /// addresses. `in_block` is whether it is in an `it` block.
    pub fn execute(&mut self, image: &Image, at: u32, in_block: bool) -> Vec<Access> {
        let half_word = |address| u32::from(image.half_word(address).unwrap_or(0));
        let (first, second) = (half_word(at), half_word(at + 2));
        let mut accesses = Vec::new();
        let mut machine = Machine { registers: self, image, at, in_block, accesses: &mut accesses };
        if first >> 11 < 0b11101 {
            machine.narrow(first);
        } else {
            machine.wide(first, second);
        }
        accesses
    }
}

impl BitRead {
    pub fn opposite(self) -> Self {
        Self { set: !self.set, ..self }
    }
}

/// The execution of one instruction.
struct Machine<'a> {
    registers: &'a mut Registers,
    image: &'a Image,
    at: u32,
    in_block: bool,
    accesses: &'a mut Vec<Access>,
}

// These are the operation codes of the wide arithmetic.
const AND: u32 = 0;
const BIC: u32 = 1;
const ORR: u32 = 2;
const ORN: u32 = 3;
const EOR: u32 = 4;
const ADD: u32 = 8;
const SUB: u32 = 13;
const RSB: u32 = 14;

/// Returns the result of an operation.
fn result(operation: u32, one: Value, other: Value) -> Value {
    match (operation, one, other) {
        (AND, Value::Read(address), Known(mask)) | (AND, Known(mask), Value::Read(address)) => {
            if mask.is_power_of_two() { Value::Bit(address, mask.trailing_zeros()) } else { Unknown }
        }
        (_, Known(one), Known(other)) => match operation {
            AND => Known(one & other),
            BIC => Known(one & !other),
            ORR => Known(one | other),
            ORN => Known(one | !other),
            EOR => Known(one ^ other),
            ADD => Known(one.wrapping_add(other)),
            SUB => Known(one.wrapping_sub(other)),
            RSB => Known(other.wrapping_sub(one)),
            _ => Unknown,
        },
        _ => Unknown,
    }
}

/// Returns the meaning of the flags after a result that is tested for zero.
fn zero_test(value: Value) -> Option<Test> {
    match value {
        Value::Bit(address, bit) => Some(Test { address, bit, by_sign: false }),
        _ => None,
    }
}

/// Returns the meaning of the flags after a shift to the left: the sign is one of the bits.
fn sign_test(value: Value, shift: u32) -> Option<Test> {
    match value {
        Value::Read(address) => Some(Test { address, bit: 31 - shift, by_sign: true }),
        _ => None,
    }
}

/// Returns the value shifted by an immediate; kind 0 is to the left.
fn shifted(value: Value, kind: u32, by: u32) -> Value {
    match (value, kind, by) {
        (value, 0, 0) => value,
        (Known(value), 0, _) => Known(value << by),
        (Known(value), 1, 1..) => Known(value >> by),
        _ => Unknown,
    }
}

impl Machine<'_> {
    fn get(&self, register: u32) -> Value {
        self.registers.get(register)
    }

    fn set(&mut self, register: u32, value: Value) {
        self.registers.set(register, value);
    }

    /// Sets register and flags: a 16-bit instruction sets the flags outside an `it` block only.
    fn set_with_flags(&mut self, register: u32, value: Value, test: Option<Test>) {
        self.set(register, value);
        if !self.in_block {
            self.registers.test = test;
        }
    }

    /// Executes a load or a store of one register. Accesses to unknown addresses are left out: the check cannot use
    /// them.
    fn access(&mut self, load: bool, register: u32, address: Value, word: bool) {
        let Known(address) = address else {
            if load {
                self.set(register, Unknown);
            }
            return;
        };
        if load {
            let literal = self.literal(address).filter(|_| word);
            self.accesses.push(Access::Read(address));
            self.set(register, literal.unwrap_or(Value::Read(address)));
        } else {
            self.accesses.push(Access::Write(address, self.get(register)));
        }
    }

    /// Returns the word at the address, if it is a literal of the function, which is never written.
    fn literal(&self, address: u32) -> Option<Value> {
        let half = |address| (!self.image.is_code(address)).then(|| self.image.half_word(address)).flatten();
        let near = address.abs_diff(self.at) <= 4_096 + 4;
        near.then(|| Some(Known(u32::from(half(address)?) | u32::from(half(address + 2)?) << 16)))?
    }

    fn narrow(&mut self, code: u32) {
        let (low, middle) = (code & 7, code >> 3 & 7);
        let immediate = code >> 6 & 31;
        match code >> 8 {
            // lsl, lsr, asr by an immediate
            0x00..=0x17 => {
                let value = self.get(middle);
                let kind = code >> 11;
                let test = if kind == 0 { sign_test(value, immediate) } else { None };
                self.set_with_flags(low, shifted(value, kind, immediate), test);
            }
            // add, sub
            0x18..=0x1f => {
                let operation = if bit(code, 9) { SUB } else { ADD };
                let other = if bit(code, 10) { Known(code >> 6 & 7) } else { self.get(code >> 6 & 7) };
                let value = result(operation, self.get(middle), other);
                self.set_with_flags(low, value, None);
            }
            0x20..=0x27 => self.set_with_flags(code >> 8 & 7, Known(code & 0xff), None),
            // cmp
            0x28..=0x2f => {
                let value = self.get(code >> 8 & 7);
                self.registers.test = zero_test(value).filter(|_| code & 0xff == 0);
            }
            // add, sub
            0x30..=0x3f => {
                let operation = if bit(code, 11) { SUB } else { ADD };
                let register = code >> 8 & 7;
                let value = result(operation, self.get(register), Known(code & 0xff));
                self.set_with_flags(register, value, None);
            }
            0x40..=0x43 => {
                let (one, other) = (self.get(low), self.get(middle));
                match code >> 6 & 15 {
                    0 => {
                        self.set_with_flags(low, result(AND, one, other), zero_test(result(AND, one, other)))
                    }
                    1 => self.set_with_flags(low, result(EOR, one, other), None),
                    8 => self.registers.test = zero_test(result(AND, one, other)),
                    10 | 11 => self.registers.test = None,
                    12 => self.set_with_flags(low, result(ORR, one, other), None),
                    14 => self.set_with_flags(low, result(BIC, one, other), None),
                    15 => self.set_with_flags(low, result(ORN, Known(0), other), None),
                    _ => self.set_with_flags(low, Unknown, None),
                }
            }
            // add, cmp, mov of any register
            0x44..=0x46 => {
                let (to, from) = (code >> 4 & 8 | low, code >> 3 & 15);
                match code >> 8 {
                    0x44 => self.set(to, result(ADD, self.get(to), self.get(from))),
                    0x45 => self.registers.test = None,
                    _ => self.set(to, self.get(from)),
                }
            }
            // bx, blx: only the program counter
            0x47 => {}
            0x48..=0x4f => {
                let address = ((self.at + 4) & !3) + 4 * (code & 0xff);
                self.access(true, code >> 8 & 7, Known(address), true);
            }
            // With a register offset: str, strh, strb, ldrsb, ldr, ldrh, ldrb, ldrsh
            0x50..=0x5f => {
                let address = result(ADD, self.get(middle), self.get(code >> 6 & 7));
                let kind = code >> 9 & 7;
                self.access(kind >= 3, low, address, kind == 0 || kind == 4);
                if kind == 3 || kind == 7 {
                    self.set(low, Unknown);
                }
            }
            // With an immediate offset: words, bytes, half-words
            0x60..=0x8f => {
                let scale = match code >> 12 {
                    6 => 4,
                    7 => 1,
                    _ => 2,
                };
                let address = result(ADD, self.get(middle), Known(scale * immediate));
                self.access(bit(code, 11), low, address, scale == 4);
            }
            // Relative to the stack pointer
            0x90..=0x97 => {}
            0x98..=0x9f => self.set(code >> 8 & 7, Unknown),
            // adr
            0xa0..=0xa7 => self.set(code >> 8 & 7, Known(((self.at + 4) & !3) + 4 * (code & 0xff))),
            0xa8..=0xaf => self.set(code >> 8 & 7, Unknown),
            // Only sp; cbz, cbnz; push; cps; it, hints
            0xb0 | 0xb1 | 0xb3 | 0xb4 | 0xb5 | 0xb6 | 0xb9 | 0xbb | 0xbf => {}
            // Extension, reversal
            0xb2 | 0xba => self.set(low, Unknown),
            // pop
            0xbc | 0xbd => (0..8).filter(|&n| bit(code, n)).for_each(|n| self.set(n, Unknown)),
            0xc0..=0xcf => {
                let (base, list) = (code >> 8 & 7, code & 0xff);
                let load = bit(code, 11);
                let write_back = !load || !bit(list, base);
                self.several(load, base, 0, list, write_back);
            }
            // Branches
            0xd0..=0xe7 => {}
            _ => self.registers.forget_all(),
        }
    }

    /// stm, ldm: the registers of the list, at `base` plus `offset`
    fn several(&mut self, load: bool, base: u32, offset: i32, list: u32, write_back: bool) {
        let start = result(ADD, self.get(base), Known(offset as u32));
        let listed: Vec<u32> = (0..16).filter(|&n| bit(list, n)).collect();
        for (n, &register) in listed.iter().enumerate() {
            self.access(load, register, result(ADD, start, Known(4 * n as u32)), true);
        }
        if write_back {
            // The direction does not matter: the base is unknown from here on.
            self.set(base, Unknown);
        }
    }

    fn wide(&mut self, first: u32, second: u32) {
        match first >> 8 {
            0xe8 | 0xe9 if bit(first, 6) => self.pair_or_exclusive(first, second),
            0xe8 | 0xe9 => {
                let (load, write_back) = (bit(first, 4), bit(first, 5));
                let down = -4 * second.count_ones() as i32;
                let offset = if first >> 7 & 3 == 0b10 { down } else { 0 };
                self.several(load, first & 15, offset, second, write_back);
            }
            0xea | 0xeb => {
                let by = second >> 10 & 0x1c | second >> 6 & 3;
                let kind = second >> 4 & 3;
                let other = shifted(self.get(second & 15), kind, by);
                // `lsls.w` is coded as a move of a shifted register.
                let is_shift = first >> 5 & 15 == ORR && first & 15 == PC && kind == 0;
                let test = if is_shift { sign_test(self.get(second & 15), by) } else { None };
                self.arithmetic(first, second, other, test);
            }
            0xec | 0xed => self.float_memory(first, second),
            0xee => {
                // vmov to a core register; vmrs to the flags.
                if bit(second, 4) && bit(first, 4) {
                    match second >> 12 {
                        PC => self.registers.test = None,
                        register => self.set(register, Unknown),
                    }
                }
            }
            0xf0..=0xf7 if bit(second, 15) => {
                // A branch, a barrier, msr, or mrs.
                if first == 0xf3ef {
                    self.set(second >> 8 & 15, Unknown);
                } else if first & 0xfff0 == 0xf380 {
                    self.registers.test = None;
                }
            }
            0xf0..=0xf7 if bit(first, 9) => self.plain_immediate(first, second),
            0xf0..=0xf7 => {
                let immediate = Known(expanded_immediate(first, second) as u32);
                self.arithmetic(first, second, immediate, None);
            }
            0xf8 | 0xf9 => self.single(first, second),
            0xfa => {
                self.set(second >> 8 & 15, Unknown);
                // A shift by a register may set the flags.
                self.registers.test = None;
            }
            0xfb => {
                self.set(second >> 8 & 15, Unknown);
                if bit(first, 7) {
                    self.set(second >> 12, Unknown);
                }
            }
            _ => self.registers.forget_all(),
        }
    }

    fn arithmetic(&mut self, first: u32, second: u32, other: Value, shift_test: Option<Test>) {
        let (operation, sets_flags) = (first >> 5 & 15, bit(first, 4));
        let (from, to) = (first & 15, second >> 8 & 15);
        // Without a first operand these are mov and mvn.
        let value = match (operation, from) {
            (ORR, PC) => other,
            (ORN, PC) => result(ORN, Known(0), other),
            _ => result(operation, self.get(from), other),
        };
        let only_flags = to == PC && matches!(operation, AND | EOR | ADD | SUB);
        if !only_flags {
            self.set(to, value);
        }
        if sets_flags {
            let compared = operation == SUB && only_flags && other == Known(0);
            self.registers.test = match operation {
                AND => zero_test(value),
                SUB if compared => zero_test(self.get(from)),
                _ => shift_test,
            };
        }
    }

    /// addw, subw, movw, movt, bit fields, saturation
    fn plain_immediate(&mut self, first: u32, second: u32) {
        let (from, to, value) = (first & 15, second >> 8 & 15, twelve_bits(first, second));
        let low_bit = second >> 10 & 0x1c | second >> 6 & 3;
        let pc = Known((self.at + 4) & !3);
        let base = if from == PC { pc } else { self.get(from) };
        let value = match first >> 4 & 31 {
            0 => result(ADD, base, Known(value)),
            10 => result(SUB, base, Known(value)),
            4 => Known(from << 12 | value),
            12 => match self.get(to) {
                Known(low) => Known((from << 12 | value) << 16 | low & 0xffff),
                _ => Unknown,
            },
            // ubfx of one bit
            28 if second & 31 == 0 => match self.get(from) {
                Value::Read(address) => Value::Bit(address, low_bit),
                Known(value) => Known(value >> low_bit & 1),
                _ => Unknown,
            },
            _ => Unknown,
        };
        self.set(to, value);
    }

    /// strd, ldrd, strex, ldrex
    fn pair_or_exclusive(&mut self, first: u32, second: u32) {
        let (before, up, write_back, load) = (bit(first, 8), bit(first, 7), bit(first, 5), bit(first, 4));
        let (base, one, other) = (first & 15, second >> 12, second >> 8 & 15);
        if before || write_back {
            let bytes = 4 * (second & 0xff);
            let moved = result(if up { ADD } else { SUB }, self.get(base), Known(bytes));
            let address = if before { moved } else { self.get(base) };
            let next = result(ADD, address, Known(4));
            self.access(load, one, address, true);
            self.access(load, other, next, true);
            if write_back {
                self.set(base, moved);
            }
            return;
        }
        // tbb, tbh
        if up && load && second >> 5 & 7 == 0 {
            return;
        }
        // An exclusive store may fail, so it does not count as an access. Every register that may be written is
        // unknown.
        for register in [one, other, second & 15] {
            self.set(register, Unknown);
        }
    }

    /// ldr and str of a byte, a half-word or a word
    fn single(&mut self, first: u32, second: u32) {
        let (signed, load, size) = (bit(first, 8), bit(first, 4), first >> 5 & 3);
        let (base, register) = (first & 15, second >> 12);
        let mut moved = None;
        let address = if base == PC {
            let offset = second & 0xfff;
            result(if bit(first, 7) { ADD } else { SUB }, Known((self.at + 4) & !3), Known(offset))
        } else if bit(first, 7) {
            result(ADD, self.get(base), Known(second & 0xfff))
        } else if bit(second, 11) {
            let (before, up, write_back) = (bit(second, 10), bit(second, 9), bit(second, 8));
            let there = result(if up { ADD } else { SUB }, self.get(base), Known(second & 0xff));
            moved = write_back.then_some(there);
            if before { there } else { self.get(base) }
        } else {
            let index = shifted(self.get(second & 15), 0, second >> 4 & 3);
            result(ADD, self.get(base), index)
        };
        // A load to pc is a preload, or a return.
        if !(load && register == PC) {
            self.access(load, register, address, size == 2);
            if signed {
                self.set(register, Unknown);
            }
        }
        if let Some(there) = moved {
            self.set(base, there);
        }
    }

    /// vstr, vldr, vpush, vpop, and moves of two core registers. Stores of the floating-point unit are not among the
    /// accesses that are checked.
    fn float_memory(&mut self, first: u32, second: u32) {
        let (write_back, load) = (bit(first, 5), bit(first, 4));
        if first & 0xffe0 == 0xec40 {
            if load {
                self.set(second >> 12, Unknown);
                self.set(first & 15, Unknown);
            }
        } else if write_back {
            self.set(first & 15, Unknown);
        }
    }
}
