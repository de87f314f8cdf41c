//! Fuzzes a recording of a sensor at rest. The input is a byte that sets the layout options, then columns of numbers.
//!
//! The samples read are finite and evenly spaced. Each deviation lies between its bounds. A scene accepts the preset
//! that results.
#![no_main]

use allan::{Phase, Statistic, Taus};
use libfuzzer_sys::fuzz_target;
use sim_host::identify::model::{Analysed, Provenance, Role, kalibr, preset};
use sim_host::identify::recording::{Column, Layout, Recording};
use sim_host::scene::Scene;

/// Longer recordings are not analysed: that would test statistics instead of parsing.
const MAX_SAMPLES: usize = 400;

const BARE: &str = "[scene]\nduration_s = 1.0\nseed = 1\nvehicle = \"os4\"\nimu = \"my-imu.toml\"\n";

fuzz_target!(|data: &[u8]| {
    let (options, bytes) = data.split_first().unwrap_or((&0, &[]));
    let layout = Layout {
        separator: [None, Some(b','), Some(b';'), Some(b'\t')][usize::from(options & 3)],
        header: [None, None, Some(true), Some(false)][usize::from(options >> 2 & 3)],
    };
    let found = Recording::of(bytes.to_vec(), bytes.len() as u64, "log.csv", layout);
    let Ok(recording) = found else { return };
    let names = recording.names();
    assert!(!names.is_empty() && recording.columns_at_once() > 0);
    let time = names.iter().position(|name| name == "time_s");
    let mut analysed = Vec::new();
    // One column at a time, so that a refused column does not hide the others.
    for (place, name) in names.iter().enumerate().filter(|(place, _)| Some(*place) != time) {
        let Ok(contents) = recording.read(&[(place, name.clone())], time, None, &|_| ()) else { continue };
        let interval_s = contents.stamps.map_or(0.01, |stamps| stamps.interval_s);
        for column in contents.columns {
            assert!(column.samples.len() >= 3 && column.samples.iter().all(|y| y.is_finite()), "{column:?}");
            assert!(column.mean.is_finite() && column.step.is_none_or(|step| step > 0.0), "{column:?}");
            assert!(interval_s > 0.0 && interval_s.is_finite(), "{interval_s} s");
            if column.samples.len() <= MAX_SAMPLES {
                analysed.push(analyse(column, interval_s));
            }
        }
    }
    let provenance = Provenance { file: "log.csv".into(), temperature: None };
    let _ = kalibr(&analysed, &provenance);
    if let Ok(text) = preset(&analysed, &provenance) {
        let taken = Scene::parse_with("scene.toml", BARE, &|_| Ok(text.clone()));
        // The scene refuses values out of an effect's range, by name. Any other error means a broken preset.
        if let Err(error) = taken {
            let message = error.to_string();
            assert!(message.contains(": must be from "), "{message} of\n{text}");
        }
    }
});

fn analyse(column: Column, interval_s: f64) -> Analysed {
    let Column { name, samples, rows_per_value, mean, step } = column;
    let interval_s = interval_s * rows_per_value as f64;
    let phase = Phase::of_rate(samples, interval_s);
    let octaves = Taus::Octave.factors(Statistic::Overlapping.largest_factor(phase.samples()));
    let points = allan::deviations(&phase, Statistic::Overlapping, &octaves, 1, &|_, _| ());
    for point in &points {
        assert!(point.deviation >= 0.0 && point.edf > 0.0, "{name}: {point:?}");
        assert!(point.lower <= point.deviation && point.deviation <= point.upper, "{name}: {point:?}");
    }
    let _ = Role::of(&name);
    Analysed {
        rate_hz: 1.0 / interval_s,
        samples: phase.samples(),
        mean,
        step,
        rises: phase.rises(),
        fit: allan::fitted(&points, phase.length_s(), step),
        name,
    }
}
