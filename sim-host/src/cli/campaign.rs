//! The command `fly` with `--runs`, and the command `merge`.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;

use input::InputError;
use serde_json::json;
use sim_host::campaign::{self, Campaign, Run, Shard, Summary};
use sim_host::interrupt;
use sim_host::output_file::{OutputFile, check_outputs};
use sim_host::scene::Scene;

use super::{Answer, FlyArguments, MergeArguments, progress};

/// Flies the campaign, or one shard of it, and writes the file of results.
pub fn fly(scene: &Scene, arguments: &FlyArguments) -> Result<Answer, InputError> {
    let campaign = Campaign::new(scene, arguments.runs);
    let shard = arguments.shard.unwrap_or(Shard::ALL);
    if shard.parts() > campaign.runs {
        let allowed = format!("must have at most as many shards as there are runs, {}", campaign.runs);
        return Err(InputError::new(allowed).field("--shard").value(shard));
    }
    let last_seed = u64::MAX - (campaign.runs - 1);
    if scene.seed > last_seed {
        let allowed = format!("must be from 0 to {last_seed} for {} runs", campaign.runs);
        return Err(InputError::new(allowed).field("--seed").value(scene.seed));
    }
    check_outputs(&scene.inputs(), &[("--out", arguments.out.as_deref())])?;
    let runs = shard.runs(campaign.runs);
    let runs_to_fly = runs.end - runs.start;
    let jobs = match arguments.jobs {
        Some(jobs) => NonZeroUsize::new(jobs.into()),
        None => std::thread::available_parallelism().ok(),
    };
    let jobs = jobs.unwrap_or(NonZeroUsize::MIN);

    let stop = interrupt::stop_flag();
    // Created before the flights: a file that cannot be written is an error now, not after hours of flying.
    let file = arguments.out.as_ref().map(OutputFile::create).transpose()?;
    let bar = progress::bar(runs_to_fly, &scene.name);
    let start = Instant::now();
    let flown = campaign::fly(scene, &campaign, runs, jobs, &stop, &|| bar.inc(1));
    let wall_s = start.elapsed().as_secs_f64();
    bar.finish_and_clear();
    if stop.load(Ordering::Relaxed) && (flown.len() as u64) < runs_to_fly {
        let summary = Summary::new(&campaign, &flown);
        interrupt::exit(&format!("interrupted, no file written: {summary}"));
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

/// Merges the shards of a campaign. The result equals that of the whole campaign, flown by one call.
pub fn merge(arguments: &MergeArguments) -> Result<Answer, InputError> {
    let parts: Vec<&Path> = arguments.parts.iter().map(PathBuf::as_path).collect();
    check_outputs(&parts, &[("--out", arguments.out.as_deref())])?;
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
