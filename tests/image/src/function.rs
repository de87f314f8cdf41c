//! Analysis of one function: every path through its instructions, with the depth of the stack at each.

use std::collections::{BTreeMap, BTreeSet};

use crate::image::Image;
use crate::thumb::{Condition, Flow, Half, Instruction, Stack, decode};

pub enum Callee {
    Function(u32),
    /// The function whose address is in a register.
    Register,
}

pub struct Call {
    pub at: u32,
    /// Bytes of stack in use by the caller at the call.
    pub depth: u32,
    pub callee: Callee,
}

pub struct Function {
    /// The largest stack use of the function itself, bytes.
    pub frame: u32,
    pub calls: Vec<Call>,
    /// Addresses of the reachable permanently undefined instructions.
    pub traps: Vec<u32>,
    pub instructions: usize,
    /// Whether some path returns to the caller.
    pub returns: bool,
}

/// A function's instructions by address, and the condition of each one in an `it` block. An instruction that cannot be
/// decoded is an error only if a path reaches it.
pub type Listing = BTreeMap<u32, (Result<Instruction, &'static str>, Option<Condition>)>;

pub fn listing(image: &Image, start: u32) -> Listing {
    let end = start + image.functions[&start].size;
    let mut listing = Listing::new();
    let mut address = start;
    // Conditions of the next instructions, in reverse order.
    let mut conditions = Vec::new();
    while address < end {
        if !image.is_code(address) {
            conditions.clear();
            address += 2;
            continue;
        }
        let half_word = |address| image.half_word(address).unwrap_or(0);
        let decoded = decode(address, half_word(address), half_word(address + 2));
        listing.insert(address, (decoded, conditions.pop()));
        if let Some(block) = decoded.ok().and_then(|decoded| decoded.block) {
            conditions = block.conditions().collect();
            conditions.reverse();
        }
        address += decoded.map_or(2, |decoded| decoded.length);
    }
    listing
}

/// Returns every number that the function may build with any of its `movw` and `movt`, among them addresses of
/// functions.
pub fn constants(image: &Image, start: u32) -> Vec<u32> {
    let halves: BTreeSet<(u32, bool, u32)> = listing(image, start)
        .values()
        .filter_map(|(decoded, _)| decoded.ok()?.constant)
        .map(|(register, half, value)| (register, half == Half::High, value))
        .collect();
    let of = |wanted| halves.iter().filter(move |(_, high, _)| *high == wanted);
    of(false)
        .flat_map(|low| of(true).filter(move |high| high.0 == low.0).map(move |high| high.2 << 16 | low.2))
        .collect()
}

/// Returns the numbers that a `movw` and the next `movt` to the same register build, which is how compilers do it.
pub fn pairs(image: &Image, start: u32) -> Vec<u32> {
    let mut low = BTreeMap::new();
    let mut numbers = Vec::new();
    for (decoded, _) in listing(image, start).values() {
        match decoded.ok().and_then(|decoded| decoded.constant) {
            Some((register, Half::High, value)) => {
                numbers.extend(low.get(&register).map(|low| value << 16 | low));
            }
            Some((register, _, value)) => {
                low.insert(register, value);
            }
            None => {}
        }
    }
    numbers
}

/// Analyses the function at `start`. `returning` holds the functions that return: after a call of any other function
/// the path ends.
pub fn analyse(image: &Image, start: u32, returning: &BTreeSet<u32>) -> Result<Function, String> {
    let listing = listing(image, start);
    let mut function =
        Function { frame: 0, calls: Vec::new(), traps: Vec::new(), instructions: 0, returns: false };
    let mut resets_stack = false;
    // Bytes of stack taken at each instruction.
    let mut depths = BTreeMap::from([(start, 0_u32)]);
    let mut open = vec![start];
    while let Some(at) = open.pop() {
        let fail = |why: &str| Err(format!("{} at {at:#x}: {why}", image.name(start)));
        let depth = depths[&at];
        let (instruction, conditional) = match listing.get(&at) {
            Some((Ok(instruction), condition)) => (instruction, condition.is_some()),
            Some((Err(why), _)) => return fail(why),
            None => return fail("a path leaves the function's instructions"),
        };
        function.instructions += 1;

        let after = match instruction.stack {
            Stack::Keep => depth,
            _ if conditional && instruction.flow == Flow::Next => return fail("sp moves under a condition"),
            Stack::Grow(bytes) => match depth.checked_add_signed(bytes) {
                Some(after) => after,
                None => return fail("more is popped than was pushed"),
            },
            Stack::Reset => {
                resets_stack = true;
                0
            }
        };
        function.frame = function.frame.max(after);

        let next = at + instruction.length;
        let mut to = Vec::new();
        if conditional {
            // The path on which the condition does not hold.
            to.push((next, depth));
        }
        let mut jumps = Vec::new();
        match instruction.flow {
            Flow::Next => to.push((next, after)),
            Flow::Jump(target) => jumps.push(target),
            Flow::Branch(target) => {
                to.push((next, after));
                jumps.push(target);
            }
            Flow::JumpTable { entry } => {
                jumps = jump_table(image, &listing, next, entry);
                if jumps.is_empty() {
                    return fail("an unknown kind of jump table");
                }
            }
            Flow::Call(target) => {
                function.calls.push(Call { at, depth: after, callee: Callee::Function(target) });
                if !image.functions.contains_key(&target) {
                    return fail("a call into the middle of a function");
                }
                if returning.contains(&target) {
                    to.push((next, after));
                }
            }
            Flow::CallRegister => {
                function.calls.push(Call { at, depth: after, callee: Callee::Register });
                to.push((next, after));
            }
            Flow::JumpRegister | Flow::Return => {
                if after != 0 {
                    return fail("leaves with another sp than it was entered with");
                }
                function.returns = true;
                if instruction.flow == Flow::JumpRegister {
                    function.calls.push(Call { at, depth: after, callee: Callee::Register });
                }
            }
            Flow::Trap => function.traps.push(at),
        }
        for target in jumps {
            if listing.contains_key(&target) {
                to.push((target, after));
            } else if image.functions.contains_key(&target) {
                function.calls.push(Call { at, depth: after, callee: Callee::Function(target) });
                if returning.contains(&target) {
                    if after != 0 {
                        return fail("leaves with another sp than it was entered with");
                    }
                    function.returns = true;
                }
            } else {
                return fail("a jump into the middle of a function");
            }
        }
        for (target, depth) in to {
            match depths.get(&target) {
                None => {
                    depths.insert(target, depth);
                    open.push(target);
                }
                Some(&before) if before != depth => {
                    return fail(&format!("reaches {target:#x} with another sp than another path"));
                }
                Some(_) => {}
            }
        }
    }
    if resets_stack && function.returns {
        return Err(format!("{}: returns with a stack of its own", image.name(start)));
    }
    Ok(function)
}

/// Returns the targets of the jump table at `table`. Literals may follow the table without a mark. So the table is read
/// up to its first target, or up to the first entry that leads to no instruction of the function. A literal that looks
/// like one more entry adds a path and hides none.
pub fn jump_table(image: &Image, listing: &Listing, table: u32, entry: u32) -> Vec<u32> {
    let mut targets = Vec::new();
    let mut first = u32::MAX;
    for at in (table..).step_by(entry as usize) {
        let offset =
            if entry == 1 { image.byte(at).map(u32::from) } else { image.half_word(at).map(u32::from) };
        let target = offset.map(|offset| table + 2 * offset).filter(|target| listing.contains_key(target));
        let Some(target) = target.filter(|_| at < first && !image.is_code(at)) else { break };
        targets.push(target);
        first = first.min(target);
    }
    targets
}
