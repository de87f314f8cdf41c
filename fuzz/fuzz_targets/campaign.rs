//! Fuzzes the result files of a campaign. The input is the shards' files, separated by zero bytes.
//!
//! Shards that merge are the same after they are written and read again, and can be summarised.
#![no_main]

use std::path::{Path, PathBuf};

use libfuzzer_sys::fuzz_target;
use sim_host::campaign::{Summary, merge_with, to_csv};

fuzz_target!(|data: &[u8]| {
    let shards: Vec<&[u8]> = data.split(|byte| *byte == 0).collect();
    let paths: Vec<PathBuf> = (0..shards.len()).map(|n| n.to_string().into()).collect();
    let open = |path: &Path| Ok(shards[paths.iter().position(|other| other == path).unwrap_or(0)]);
    let (campaign, runs) = match merge_with(&paths, open) {
        Ok(merged) => merged,
        Err(error) => {
            let message = error.to_string();
            assert!(!message.is_empty() && !message.contains('\n'), "{message:?}");
            return;
        }
    };
    assert_eq!(runs.len() as u64, campaign.runs);
    assert!(runs.iter().zip(0..).all(|(run, number)| run.number == number));
    let text = to_csv(&campaign, &runs).unwrap();
    let (same, again) = merge_with(&paths[..1], |_| Ok(text.as_slice())).unwrap();
    assert_eq!((&same, &again), (&campaign, &runs));
    let summary = Summary::new(&campaign, &runs);
    assert_eq!(summary.to_json()["runs"].as_array().map(Vec::len), Some(runs.len()));
    assert!(summary.to_string().starts_with(&campaign.scene));
});
