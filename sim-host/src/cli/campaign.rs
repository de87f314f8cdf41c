//! The command `fly` with `--runs`, and the command `merge`.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;

use input::InputError;
use serde_json::json;
use sim_host::campaign::{self, Campaign, Run, Shard, Summary};
use sim_host::interrupt;
use sim_host::output_file::{OutputFile, spare};
use sim_host::scene::Scene;

use super::{Answer, FlyArguments, MergeArguments, progress};

/// Flights with seeds counting up from the scene's.
pub fn fly(scene: &Scene, arguments: &FlyArguments) -> Result<Answer, InputError> {
    let campaign = Campaign::new(scene, arguments.runs);
    let shard = arguments.shard.unwrap_or(Shard::WHOLE);
    if shard.parts() > campaign.runs {
        let allowed = format!("must be no more parts than the {} runs", campaign.runs);
        return Err(InputError::new(allowed).field("--shard").value(format!("…/{}", shard.parts())));
    }
    spare(&scene.inputs(), &[("--out", arguments.out.as_deref())])?;
    let runs = shard.runs(campaign.runs);
    let wanted = runs.end - runs.start;
    let jobs = match arguments.jobs {
        Some(jobs) => NonZeroUsize::from(jobs),
        None => std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN),
    };

    let stop = interrupt::flag();
    // Begun now: a file that cannot be written is told of before hours of flying.
    let file = arguments.out.as_ref().map(OutputFile::create).transpose()?;
    let bar = progress::bar(wanted, &scene.name);
    let start = Instant::now();
    let flown = campaign::fly(scene, &campaign, runs, jobs, &stop, &|| bar.inc(1));
    let wall_s = start.elapsed().as_secs_f64();
    bar.finish_and_clear();
    if stop.load(Ordering::Relaxed) && (flown.len() as u64) < wanted {
        let summary = Summary::new(&campaign, &flown);
        interrupt::end(&format!("interrupted, no file written: {summary}"));
    }

    let mut answer = answer(&campaign, &flown, arguments.max_failures);
    if let Some(file) = file {
        campaign::write(file, &campaign, &flown)?;
    }
    let steps: u64 = flown.iter().map(|run| run.outcome.control_steps).sum();
    answer.json["wall_s"] = json!(wall_s);
    answer.json["steps_per_s"] = json!(steps as f64 / wall_s);
    Ok(answer)
}

/// The parts of a campaign as if it had been flown in one go.
pub fn merge(arguments: &MergeArguments) -> Result<Answer, InputError> {
    let parts: Vec<&Path> = arguments.parts.iter().map(PathBuf::as_path).collect();
    spare(&parts, &[("--out", arguments.out.as_deref())])?;
    let (campaign, runs) = campaign::merge(&arguments.parts)?;
    if let Some(path) = &arguments.out {
        campaign::write(OutputFile::create(path)?, &campaign, &runs)?;
    }
    Ok(answer(&campaign, &runs, arguments.max_failures))
}

fn answer(campaign: &Campaign, runs: &[Run], max_failures: u64) -> Answer {
    let summary = Summary::new(campaign, runs);
    Answer { json: summary.to_json(), text: summary.to_string(), failed: summary.crashes() > max_failures }
}
