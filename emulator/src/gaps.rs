//! Gaps: accesses of the firmware that no model covers, or that the manual forbids.

use std::collections::BTreeMap;

use rigless::session::Session;

use crate::board::FlightBoard;
use crate::rules::Rules;

/// Known gaps, each with its reason after a tab.
const EXPLAINED: &str = include_str!("../gaps.txt");

/// Returns all gaps except the known ones, one line each.
pub fn list(
    session: &Session<FlightBoard>,
    in_ccm: &BTreeMap<(usize, usize), u64>,
    rules: &Rules,
) -> Vec<String> {
    let mut gaps = Vec::new();
    for unmapped in session.unmapped() {
        gaps.push(format!(
            "unmapped address {:#010x}, accessed from {:#010x}",
            unmapped.address, unmapped.program_counter
        ));
    }
    for (address, fault) in session.refused() {
        gaps.push(format!("refused access at {address:#010x}: {fault:?}"));
    }
    for found in session.unimplemented().values() {
        gaps.push(format!(
            "no model of {}.{}: {} reads, {} writes, accessed from {:#010x}",
            found.instance, found.register, found.reads, found.writes, found.program_counter
        ));
    }
    for (address, found) in session.undefined() {
        gaps.push(format!(
            "no register at {address:#010x} of {}, accessed from {:#010x}",
            found.instance, found.program_counter
        ));
    }
    for told in session.told() {
        gaps.push(format!("{}.{}: {}", told.instance, told.register, told.reason));
    }
    for (instance, number) in session.unrouted() {
        gaps.push(format!("no interrupt line {number} for {instance}"));
    }
    for ((controller, stream), from) in in_ccm {
        gaps.push(format!(
            "DMA{controller} stream {stream}: the memory address is in the CCM, which DMA cannot reach; set from {from:#010x}"
        ));
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
