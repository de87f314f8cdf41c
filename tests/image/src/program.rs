//! All functions of an image, and their calls.

use std::collections::{BTreeMap, BTreeSet};

use crate::function::{Callee, Function, analyse, constants};
use crate::image::Image;

pub struct Program<'a> {
    image: &'a Image,
    functions: BTreeMap<u32, Result<Function, String>>,
    /// Functions whose address occurs in the image: a call by register goes to one of them.
    addresses_taken: Vec<u32>,
}

/// The reachable functions, each with the caller from which it was first reached.
type Reached = BTreeMap<u32, Option<u32>>;

/// The largest stack use of a function and its callees.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Depth {
    pub bytes: u32,
    /// The functions along the deepest path.
    pub path: Vec<u32>,
}

impl<'a> Program<'a> {
    pub fn new(image: &'a Image) -> Self {
        // A function counts as returning only once a path to a return has been found.
        let mut returning = BTreeSet::new();
        let functions = loop {
            let functions: BTreeMap<u32, Result<Function, String>> =
                image.functions.keys().map(|&start| (start, analyse(image, start, &returning))).collect();
            let seen: BTreeSet<u32> = functions
                .iter()
                .filter(|(_, function)| function.as_ref().is_ok_and(|function| function.returns))
                .map(|(&start, _)| start)
                .collect();
            if seen == returning {
                break functions;
            }
            returning = seen;
        };
        let built = image.functions.keys().flat_map(|&start| constants(image, start));
        let numbers: BTreeSet<u32> =
            image.data_words().chain(built).filter(|number| number & 1 == 1).collect();
        // Handlers are entered by the processor and never called.
        let addresses_taken = numbers
            .iter()
            .map(|number| number & !1)
            .filter(|start| image.functions.contains_key(start) && !image.vectors.contains(start))
            .collect();
        Self { image, functions, addresses_taken }
    }

    pub fn function(&self, start: u32) -> Result<&Function, String> {
        self.functions[&start].as_ref().map_err(String::clone)
    }

    /// Returns the calls of a function: the bytes of its stack in use, and the callee.
    fn calls(&self, start: u32) -> Result<Vec<(u32, u32)>, String> {
        let mut calls = Vec::new();
        for call in &self.function(start)?.calls {
            match call.callee {
                Callee::Function(callee) => calls.push((call.depth, callee)),
                Callee::Register => {
                    calls.extend(self.addresses_taken.iter().map(|&taken| (call.depth, taken)))
                }
            }
        }
        Ok(calls)
    }

    /// Returns all functions that can be reached from `root`. Functions for which `ends` holds are not searched.
    pub fn reached(&self, root: u32, ends: impl Fn(u32) -> bool) -> Result<Reached, String> {
        let mut reached = Reached::from([(root, None)]);
        let mut open = std::collections::VecDeque::from([root]);
        while let Some(caller) = open.pop_front() {
            if ends(caller) {
                continue;
            }
            for (_, callee) in self.calls(caller)? {
                reached.entry(callee).or_insert_with(|| {
                    open.push_back(callee);
                    Some(caller)
                });
            }
        }
        Ok(reached)
    }

    /// Returns the chain of calls `root → … → function`, with names.
    pub fn chain(&self, reached: &Reached, function: u32) -> String {
        let names = std::iter::successors(Some(function), |at| reached[at]).map(|at| self.image.name(at));
        names.collect::<Vec<_>>().into_iter().rev().collect::<Vec<_>>().join("\n  → ")
    }

    /// Returns the largest stack use of `root`, up to calls of functions for which `ends` holds. A cycle of calls is an
    /// error, unless `nested` gives for each of its functions how often it can be active at once.
    pub fn depth(
        &self,
        root: u32,
        ends: impl Fn(u32) -> bool + Copy,
        nested: impl Fn(&str) -> Option<u32>,
    ) -> Result<Depth, String> {
        let mut calls: BTreeMap<u32, Vec<(u32, u32)>> = BTreeMap::new();
        for &function in self.reached(root, ends)?.keys().filter(|&&function| !ends(function)) {
            let counted = self.calls(function)?.into_iter().filter(|&(_, callee)| !ends(callee));
            calls.insert(function, counted.collect());
        }
        let mut below: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
        for &function in calls.keys() {
            let mut seen = BTreeSet::new();
            let mut open = vec![function];
            while let Some(caller) = open.pop() {
                open.extend(
                    calls[&caller].iter().map(|&(_, callee)| callee).filter(|&callee| seen.insert(callee)),
                );
            }
            below.insert(function, seen);
        }
        // Callees first: a caller can reach at least what its callees can reach, and the callees.
        let mut order: Vec<u32> = calls.keys().copied().collect();
        order.sort_by_key(|function| below[function].len());
        let mut depths: BTreeMap<u32, Depth> = BTreeMap::new();
        for &function in &order {
            if depths.contains_key(&function) {
                continue;
            }
            let cycle: BTreeSet<u32> =
                below[&function].iter().copied().filter(|other| below[other].contains(&function)).collect();
            let group = if cycle.is_empty() { BTreeSet::from([function]) } else { cycle.clone() };
            let mut within = 0;
            for &member in &cycle {
                let Some(times) = nested(self.image.name(member)) else {
                    let names: Vec<&str> = cycle.iter().map(|&member| self.image.name(member)).collect();
                    return Err(format!("a cycle of calls:\n  {}", names.join("\n  ")));
                };
                within += times * self.function(member)?.frame;
            }
            let mut deepest = Depth {
                bytes: if cycle.is_empty() { self.function(function)?.frame } else { within },
                path: Vec::new(),
            };
            for &(taken, callee) in group.iter().flat_map(|member| &calls[member]) {
                if group.contains(&callee) {
                    continue;
                }
                let bytes = if cycle.is_empty() { taken } else { within } + depths[&callee].bytes;
                if bytes > deepest.bytes {
                    deepest = Depth { bytes, path: depths[&callee].path.clone() };
                }
            }
            for member in group {
                let mut path = vec![member];
                path.extend(&deepest.path);
                depths.insert(member, Depth { bytes: deepest.bytes, path });
            }
        }
        Ok(depths.remove(&root).unwrap_or_default())
    }
}
