//! What the firmware asked of the board that no model answers, or that the manual forbids.

use std::collections::BTreeMap;

use rigless::session::Session;

use crate::board::FlightBoard;
use crate::rules::Rules;

/// Gaps that are known, each with its reason after a tab: `gaps.txt`.
const EXPLAINED: &str = include_str!("../gaps.txt");

/// All of them, a line each, without those that are explained.
pub fn list(
    session: &Session<FlightBoard>,
    in_ccm: &BTreeMap<(usize, usize), u64>,
    rules: &Rules,
) -> Vec<String> {
    let mut gaps = Vec::new();
    for unmapped in session.unmapped() {
        gaps.push(format!("nothing at {:#010x}, from {:#010x}", unmapped.address, unmapped.program_counter));
    }
    for (address, fault) in session.refused() {
        gaps.push(format!("refused at {address:#010x}: {fault:?}"));
    }
    for found in session.unimplemented().values() {
        gaps.push(format!(
            "no model of {}.{}: {} reads, {} writes, from {:#010x}",
            found.instance, found.register, found.reads, found.writes, found.program_counter
        ));
    }
    for (address, found) in session.undefined() {
        gaps.push(format!(
            "no register at {address:#010x} of {}, from {:#010x}",
            found.instance, found.program_counter
        ));
    }
    for told in session.told() {
        gaps.push(format!("{}.{}: {}", told.instance, told.register, told.reason));
    }
    for (instance, number) in session.unrouted() {
        gaps.push(format!("no line {number} for {instance}"));
    }
    for ((controller, stream), from) in in_ccm {
        gaps.push(format!("DMA{controller} stream {stream} reaches for the CCM, from {from:#010x}"));
    }
    gaps.extend(rules.violations());
    gaps.retain(|gap| !explained().any(|known| gap.starts_with(known)));
    gaps
}

fn explained() -> impl Iterator<Item = &'static str> {
    EXPLAINED
        .lines()
        .filter(|line| !line.starts_with('#') && !line.is_empty())
        .filter_map(|line| line.split('\t').next())
}
