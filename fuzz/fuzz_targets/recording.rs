//! A recording of a sensor at rest: a byte for what is said of its layout, and columns of numbers.
//!
//! What is read of it is finite and evenly sampled; its deviations have bounds around them; and the preset that
//! comes of it is one that a scene takes.
#![no_main]

use allan::{Phase, Statistic, Taus};
use libfuzzer_sys::fuzz_target;
use sim_host::identify::model::{Analysed, Provenance, Role, kalibr, preset};
use sim_host::identify::recording::{Column, Layout, Recording};
use sim_host::scene::Scene;

/// Statistics over more than this are no parsing any more.
const MAX_SAMPLES: usize = 400;

const BARE: &str = "[scene]\nduration_s = 1.0\nseed = 1\nvehicle = \"os4\"\nimu = \"my-imu.toml\"\n";

fuzz_target!(|data: &[u8]| {
    let (said, bytes) = data.split_first().unwrap_or((&0, &[]));
    let layout = Layout {
        separator: [None, Some(b','), Some(b';'), Some(b'\t')][usize::from(said & 3)],
        header: [None, None, Some(true), Some(false)][usize::from(said >> 2 & 3)],
    };
    let found = Recording::of(bytes.to_vec(), bytes.len() as u64, "log.csv", layout);
    let Ok(recording) = found else { return };
    let names = recording.names();
    assert!(!names.is_empty() && recording.columns_at_once() > 0);
    let time = names.iter().position(|name| name == "time_s");
    let mut analysed = Vec::new();
    // One at a time, so that one that is refused hides no other.
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
        // Figures beyond what an effect's table takes are refused there, by name; anything else is a broken file.
        if let Err(error) = taken {
            let said = error.to_string();
            assert!(said.contains(": must be from "), "{said} of\n{text}");
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
