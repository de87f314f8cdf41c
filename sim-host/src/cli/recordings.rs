//! The commands `sense`, which writes logs, and `estimate`, which reads them.

use std::time::Instant;

use input::InputError;
use serde_json::json;
use sim_host::log::{Axes, LogWriter};
use sim_host::output_file::check_outputs;
use sim_host::{estimate, sense};

use super::{Answer, EstimateArguments, SenseArguments, load};

pub fn sense(arguments: &SenseArguments) -> Result<Answer, InputError> {
    let scene = load(&arguments.scene, arguments.vehicle.as_deref(), arguments.seed, arguments.duration)?;
    check_outputs(&scene.inputs(), &[("--out", arguments.out.as_deref())])?;
    let mut writer = arguments.out.as_ref().map(LogWriter::create).transpose()?;
    let start = Instant::now();
    let samples = sense::run(&scene, scene.seed, arguments.rate_hz, writer.as_mut())?;
    if let Some(writer) = writer {
        writer.finish()?;
    }
    let wall_s = start.elapsed().as_secs_f64();
    let samples_per_s = samples as f64 / wall_s;
    let place = arguments.out.as_ref().map_or("not written".into(), |path| path.display().to_string());
    Ok(Answer {
        json: json!({ "samples": samples, "wall_s": wall_s, "samples_per_s": samples_per_s }),
        text: format!(
            "{samples} samples of {} at {} Hz in {wall_s:.3} s ({:.2} million a second): {place}",
            scene.name,
            arguments.rate_hz,
            samples_per_s * 1e-6,
        ),
        failed: false,
    })
}

pub fn estimate(arguments: &EstimateArguments) -> Result<Answer, InputError> {
    let report = estimate::run(&estimate::Request {
        log: arguments.log.clone(),
        axes: Axes { frame: arguments.frame.into(), accel_sign: arguments.accel_sign.into() },
        estimators: arguments.estimator.clone(),
        prefilter_hz: arguments.prefilter_hz,
        out: arguments.out.clone(),
    })?;
    let json = serde_json::to_value(&report).map_err(|error| InputError::new(error.to_string()))?;
    Ok(Answer { json, text: report.to_string(), failed: false })
}
