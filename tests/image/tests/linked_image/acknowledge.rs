//! Checks that each handler acknowledges its interrupt before it returns.
//!
//! A peripheral's interrupt is a level or a latch: while it is set, a handler that returns is entered again at once,
//! and no task of its priority or a lower one runs. [`SOURCES`] lists for each vector the accesses to registers that
//! clear it. From the handler's first instruction every path is followed, also into called functions, with the known
//! values of the registers ([`crate::values`]), until the accesses have occurred in their order. A path that reaches
//! the handler's return earlier is an error.
//!
//! # What this does not show
//! - That the written value is right, if it is not a constant: a handler may write back the flags that it has read.
//! - That the source stays cleared: it may be set again by the next event.
//! - Paths that never return: an endless loop, a panic.
//! - Writes through the bit-band alias (0x4200_0000) or by DMA. They are not seen, so the check refuses such a handler.
//!
//! A call by a register is assumed to acknowledge nothing and to return.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use crate::values::{Access, BitRead, Registers, Value};
use image_tests::function::{Listing, jump_table, listing};
use image_tests::image::Image;
use image_tests::thumb::Flow;

/// How a vector's interrupt is acknowledged.
pub enum Source {
    /// The handler acknowledges the interrupt by these accesses, in this order.
    Acknowledged {
        by: &'static [Step],
        /// A path on which this flag was read as zero needs no acknowledgement.
        unless: Option<NotAsserted>,
    },
    /// No acknowledgement is needed; the text gives the reason.
    ByItself(&'static str),
    /// No acknowledgement, because the handler does not return, which is checked.
    NeverReturns(&'static str),
}

/// An access that is part of an acknowledgement.
#[derive(Clone, Copy)]
pub struct Step {
    pub register: &'static str,
    pub address: u32,
    pub kind: Kind,
}

#[derive(Clone, Copy)]
pub enum Kind {
    Read,
    /// Ones in these bits clear the flag.
    WriteOnes(u32),
    /// Zeros in these bits clear the flag.
    WriteZeros(u32),
}

/// A flag that was read as zero, which means that the interrupt was not asserted.
#[derive(Clone, Copy)]
pub struct NotAsserted {
    pub address: u32,
    pub bit: u32,
    pub why: &'static str,
}

const fn step(register: &'static str, address: u32, kind: Kind) -> Step {
    Step { register, address, kind }
}

/// Every vector with a handler of its own. Register numbers and bits: RM0090, sections 10.5.3 (LIFCR), 12.3.6
/// (EXTI_PR), 18.4.5 (TIM5_SR), 30.6.1 (USART2_SR).
pub const SOURCES: [(&str, Source); 10] = [
    ("PVD", Source::NeverReturns("it stops the motors")),
    ("NonMaskableInt", Source::NeverReturns("it stops the motors")),
    ("CRYP", Source::ByItself("software pends it; the F405 has no such peripheral")),
    ("DCMI", Source::ByItself("software pends it; the F405 has no such peripheral")),
    ("HASH_RNG", Source::ByItself("software pends it; the random number generator is off")),
    ("SysTick", Source::ByItself("an exception of the processor, no longer pending once it is entered")),
    (
        "DMA2_STREAM0",
        Source::Acknowledged {
            // The flag of a complete transfer. The error flag is cleared by the same write or by another one.
            by: &[step("DMA2_LIFCR", 0x4002_6408, Kind::WriteOnes(1 << 5))],
            unless: None,
        },
    ),
    (
        "EXTI4",
        Source::Acknowledged { by: &[step("EXTI_PR", 0x4001_3c14, Kind::WriteOnes(1 << 4))], unless: None },
    ),
    (
        "TIM5",
        Source::Acknowledged { by: &[step("TIM5_SR", 0x4000_0c10, Kind::WriteZeros(1 << 1))], unless: None },
    ),
    (
        "USART2",
        Source::Acknowledged {
            by: &[step("USART2_SR", 0x4000_4400, Kind::Read), step("USART2_DR", 0x4000_4404, Kind::Read)],
            unless: None,
        },
    ),
];

impl Step {
    fn is_done_by(&self, access: Access) -> bool {
        match (self.kind, access) {
            _ if access.address() != self.address => false,
            (Kind::Read, Access::Read(_)) => true,
            (Kind::WriteOnes(bits), Access::Write(_, Value::Known(value))) => value & bits == bits,
            (Kind::WriteZeros(bits), Access::Write(_, Value::Known(value))) => value & bits == 0,
            // Not a constant.
            (Kind::WriteOnes(_) | Kind::WriteZeros(_), Access::Write(..)) => true,
            _ => false,
        }
    }

    fn describe(&self) -> String {
        let Self { register, address, kind } = self;
        match kind {
            Kind::Read => format!("a read of {register} ({address:#010x})"),
            Kind::WriteOnes(bits) => format!("a write of {bits:#x} to {register} ({address:#010x})"),
            Kind::WriteZeros(bits) => {
                format!("a write to {register} ({address:#010x}) with {bits:#x} clear")
            }
        }
    }
}

/// Largest nesting of calls on the head to the acknowledgement.
const DEEPEST: usize = 24;
/// Limit of the examined places; the handlers acknowledge within some dozens of instructions.
const MAX_PLACES: usize = 1_000_000;

/// The progress of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Progress {
    /// Whether it has accessed the peripheral. Such a path explains an error better than one that has not.
    touched: bool,
    /// Number of completed steps.
    steps: usize,
}

/// A point of a path: an instruction, and the point before.
struct Place {
    before: Option<usize>,
    /// The start of the instruction's function.
    function: u32,
    at: u32,
    /// The next instruction's address.
    next: u32,
    accesses: Vec<Access>,
}

/// The head of a path: the next instruction, and what is known there.
#[derive(Clone)]
struct PathHead {
    at: u32,
    progress: Progress,
    registers: Registers,
    /// The place before.
    before: Option<usize>,
}

/// The continuations of the paths after one instruction.
#[derive(Default)]
struct Continuations {
    within: Vec<PathHead>,
    /// Paths to the start of a function, and whether it is called; after a jump its return is this function's.
    calls: Vec<(PathHead, bool)>,
    returns: Vec<(Progress, usize)>,
}

struct Search<'a> {
    image: &'a Image,
    steps: &'a [Step],
    unless: Option<NotAsserted>,
    places: Vec<Place>,
    excused: bool,
}

/// The result of a successful check.
#[derive(Debug, PartialEq)]
pub struct Found {
    /// Examined instructions; an instruction counts again each time it is examined.
    pub instructions: usize,
    /// Whether a path was accepted because its flag was not asserted.
    pub excused: bool,
}

/// Follows every path of the handler called `name`.
///
/// # Errors
/// A path returns without the acknowledging accesses, or cannot be analysed.
pub fn check(image: &Image, name: &str, by: &[Step], unless: Option<NotAsserted>) -> Result<Found, String> {
    let start = image.find(name).ok_or(format!("{name} is not in the image"))?;
    let mut search = Search { image, steps: by, unless, places: Vec::new(), excused: false };
    let progress = Progress { touched: false, steps: 0 };
    let head = PathHead { at: start, progress, registers: Registers::unknown(), before: None };
    match search.function(head, 0)?.last_key_value() {
        None => Ok(Found { instructions: search.places.len(), excused: search.excused }),
        Some((progress, &place)) => {
            let missing = by[progress.steps].describe();
            Err(format!("{name} can return without {missing}:\n{}", search.describe(place)))
        }
    }
}

impl Search<'_> {
    /// Follows all paths of the function at the path's head. Returns those that return before the last step, one for
    /// each progress, with the place of the return.
    fn function(&mut self, head: PathHead, depth: usize) -> Result<BTreeMap<Progress, usize>, String> {
        let start = head.at;
        if depth > DEEPEST {
            return Err(format!("{}: calls are nested too deep", self.image.name(start)));
        }
        let listing = listing(self.image, start);
        let mut returns = BTreeMap::new();
        // What holds on all paths that reach an instruction with the same progress.
        let mut known: BTreeMap<(u32, Progress), PathHead> = BTreeMap::new();
        let mut open = VecDeque::new();
        let mut waiting = BTreeSet::new();
        let mut arrived = vec![head];
        loop {
            for head in arrived {
                let key = (head.at, head.progress);
                let is_new = match known.get_mut(&key) {
                    None => {
                        known.insert(key, head);
                        true
                    }
                    Some(before) => {
                        let joined = before.registers.join(&head.registers);
                        let is_new = joined != before.registers;
                        before.registers = joined;
                        is_new
                    }
                };
                if is_new && waiting.insert(key) {
                    open.push_back(key);
                }
            }
            let Some(key) = open.pop_front() else { break Ok(returns) };
            waiting.remove(&key);
            let head = known[&key].clone();
            let at = head.at;
            let fail = |why: &str| format!("{} at {at:#x}: {why}", self.image.name(start));
            let mut continuations = self.instruction(&listing, start, head).map_err(|why| fail(&why))?;
            for (head, comes_back) in std::mem::take(&mut continuations.calls) {
                if !self.image.functions.contains_key(&head.at) {
                    return Err(format!("{} at {at:#x}: goes to no function", self.image.name(start)));
                }
                let mut registers = head.registers.clone();
                registers.forget_volatile();
                for (progress, place) in self.function(head, depth + 1)? {
                    if comes_back {
                        let (registers, before) = (registers.clone(), Some(place));
                        continuations.within.push(PathHead { at: at + 4, progress, registers, before });
                    } else {
                        continuations.returns.push((progress, place));
                    }
                }
            }
            for (progress, place) in continuations.returns {
                returns.entry(progress).or_insert(place);
            }
            arrived = continuations.within;
        }
    }

    /// Executes the instruction at the path's head.
    fn instruction(
        &mut self,
        listing: &Listing,
        start: u32,
        head: PathHead,
    ) -> Result<Continuations, String> {
        let PathHead { at, progress, registers, before } = head;
        let (instruction, condition) = match listing.get(&at) {
            Some((Ok(instruction), condition)) => (instruction, *condition),
            Some((Err(why), _)) => return Err((*why).into()),
            None => return Err("a path leaves the function's instructions".into()),
        };
        if self.places.len() >= MAX_PLACES {
            return Err("too many paths".into());
        }
        let here = self.places.len();
        let next = at + instruction.length;
        self.places.push(Place { before, function: start, at, next, accesses: Vec::new() });
        let mut continuations = Continuations::default();

        if let Some(condition) = condition {
            // The lowest bit inverts a condition.
            if !self.is_excuse(registers.bit_if(condition ^ 1)) {
                let registers = registers.clone();
                continuations.within.push(PathHead { at: next, progress, registers, before: Some(here) });
            }
            if self.is_excuse(registers.bit_if(condition)) {
                return Ok(continuations);
            }
        }

        let mut after = registers;
        let accesses = after.execute(self.image, at, condition.is_some());
        let mut progress = progress;
        for &access in &accesses {
            progress.touched |= self.is_of_peripheral(access);
            if self.steps[progress.steps].is_done_by(access) {
                progress.steps += 1;
                if progress.steps == self.steps.len() {
                    // This path is complete.
                    return Ok(continuations);
                }
            }
        }
        self.places[here].accesses = accesses;

        let to = |at| PathHead { at, progress, registers: after.clone(), before: Some(here) };
        let mut jumps = Vec::new();
        let half_word = |address| self.image.half_word(address).unwrap_or(0);
        match instruction.flow {
            Flow::Next => continuations.within.push(to(next)),
            Flow::Jump(target) => jumps.push(target),
            Flow::Branch(target) => {
                let taken = after.bit_if_taken(half_word(at), half_word(at + 2));
                if !self.is_excuse(taken.map(BitRead::opposite)) {
                    continuations.within.push(to(next));
                }
                if !self.is_excuse(taken) {
                    jumps.push(target);
                }
            }
            Flow::JumpTable { entry } => {
                jumps = jump_table(self.image, listing, next, entry);
                if jumps.is_empty() {
                    return Err("an unknown kind of jump table".into());
                }
            }
            Flow::Call(target) => continuations.calls.push((to(target), true)),
            Flow::CallRegister => {
                let mut head = to(next);
                head.registers.forget_volatile();
                continuations.within.push(head);
            }
            Flow::JumpRegister | Flow::Return => continuations.returns.push((progress, here)),
            Flow::Trap => {}
        }
        for target in jumps {
            if listing.contains_key(&target) {
                continuations.within.push(to(target));
            } else {
                continuations.calls.push((to(target), false));
            }
        }
        Ok(continuations)
    }

    /// Returns whether this read shows that the interrupt was not asserted, so that the path needs no acknowledgement.
    fn is_excuse(&mut self, read: Option<BitRead>) -> bool {
        let is_excuse = self.unless.zip(read).is_some_and(|(unless, read)| {
            !read.set && (read.address, read.bit) == (unless.address, unless.bit)
        });
        self.excused |= is_excuse;
        is_excuse
    }

    /// Returns whether the access is to the peripheral of the first step; each peripheral has a kilobyte.
    fn is_of_peripheral(&self, access: Access) -> bool {
        access.address() >> 10 == self.steps[0].address >> 10
    }

    /// Describes the path to its end: each stretch without a jump, and its accesses to the peripheral.
    fn describe(&self, place: usize) -> String {
        let mut path: Vec<&Place> =
            std::iter::successors(Some(&self.places[place]), |place| Some(&self.places[place.before?]))
                .collect();
        path.reverse();
        let follows = |one: &&Place, other: &&Place| one.function == other.function && one.next == other.at;
        let line = |stretch: &[&Place]| {
            let (first, last) = (stretch[0], stretch[stretch.len() - 1]);
            let name = self.image.name(first.function);
            let accesses = stretch.iter().flat_map(|place| &place.accesses);
            let accesses: String = accesses
                .filter(|access| self.is_of_peripheral(**access))
                .map(|access| match access {
                    Access::Read(address) => format!(", reads {address:#010x}"),
                    Access::Write(address, _) => format!(", writes {address:#010x}"),
                })
                .collect();
            format!("  {:#010x} to {:#010x} {name}{accesses}", first.at, last.at)
        };
        let mut lines: Vec<String> = path.chunk_by(follows).map(line).collect();
        // The start, where the path leaves the others, explains more than the rest.
        const SHOWN: usize = 12;
        if lines.len() > SHOWN {
            let left_out = lines.len() - SHOWN;
            lines.splice(SHOWN - 1..lines.len() - 1, [format!("  ... {left_out} stretches more ...")]);
        }
        lines.join("\n")
    }
}
