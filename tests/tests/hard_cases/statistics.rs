//! Records so long, so far from zero or so coloured that a plain sum loses what it is to show.

use allan::{Phase, Point, Statistic, Taus, deviations};
use flight_core::geometry::{Quaternion, Vec3, vec3};
use random::NormalStream;
use sim_host::dynamics::{State, VehicleParams};
use sim_host::effects::sensor::AccelBiasInstability;
use sim_host::effects::{Build, Recipe, Snapshot};

/// Overlapping deviations at octaves.
fn octaves(samples: Vec<f64>, interval_s: f64) -> Vec<Point> {
    let phase = Phase::of_rate(samples, interval_s);
    let factors = Taus::Octave.factors(Statistic::Overlapping.largest_factor(phase.samples()));
    deviations(&phase, Statistic::Overlapping, &factors, 2, &|_, _| ())
}

/// Every deviation lies within 4.5 of its own standard deviations, 1/√(2 edf) of it, of what it should be; and a share more
/// that is `known`.
fn are(points: &[Point], known: f64, expected: impl Fn(f64) -> f64) {
    for p in points.iter().filter(|p| p.edf > 5.0) {
        let off = p.deviation / expected(p.tau_s) - 1.0;
        let within = 4.5 / (2.0 * p.edf).sqrt() + known;
        assert!(off.abs() < within, "τ = {} s: off by {off}, {within} is allowed", p.tau_s);
    }
}

/// White noise of σ = 1 on a mean of 10⁶: σ(τ) is 1/√m at every m, and that of the same noise without the mean.
fn white_on_a_large_mean(samples: usize) {
    let deviations = |mean: f64| {
        let mut noise = NormalStream::new(8, "long", 0);
        octaves((0..samples).map(|_| mean + noise.draw()).collect(), 1.0)
    };
    let (without, with) = (deviations(0.0), deviations(1e6));
    assert!(with.last().unwrap().tau_s > samples as f64 / 6.0);
    are(&with, 0.0, |m| 1.0 / m.sqrt());
    for (without, with) in without.iter().zip(&with) {
        // The mean's last place, 1.2e-10 σ, is part of each sample.
        let apart = with.deviation / without.deviation - 1.0;
        assert!(apart.abs() < 1e-8, "τ = {} s: {apart:e} apart", with.tau_s);
    }
}

#[test]
fn a_mean_of_a_million_sigma() {
    white_on_a_large_mean(4_000_000);
}

#[test]
#[ignore = "10⁸ samples: 0.8 GB, most of a minute; .ci/run runs it"]
fn a_hundred_million_samples_on_a_mean_of_a_million_sigma() {
    white_on_a_large_mean(100_000_000);
}

#[test]
fn flicker_is_level_over_six_decades() {
    // 4·10⁷ samples at 10 Hz are 46 days. The generator's spectrum is within 7 % of 1/f (its page says where), its deviation
    // within 3.5 %; below four samples it is that of a sampled process.
    let (rate_hz, samples) = (10.0, 40_000_000);
    let vehicle = VehicleParams::OS4;
    let duration_s = samples as f64 / rate_hz;
    let with = Build { name: "accel.bias_instability", seed: 3, rate_hz, duration_s, vehicle: &vehicle };
    let mut flicker = AccelBiasInstability { b_m_s2: [1.0; 3] }.build(&with);
    let state = State {
        position: Vec3::ZERO,
        velocity: Vec3::ZERO,
        attitude: Quaternion::IDENTITY,
        rates: Vec3::ZERO,
    };
    let at = Snapshot {
        time_s: 0.0,
        state: &state,
        specific_force: vec3(0.0, 0.0, -9.80665),
        angular_acceleration: Vec3::ZERO,
        rotors: [0.0; 4],
    };
    let points = octaves((0..samples).map(|_| flicker.apply(Vec3::ZERO, &at).x).collect(), 1.0 / rate_hz);
    let level: Vec<Point> = points.into_iter().filter(|p| p.tau_s >= 0.4 && p.edf > 5.0).collect();
    let decades = (level.last().unwrap().tau_s / level[0].tau_s).log10();
    assert!(decades > 5.9, "{decades} decades");
    let plateau = (2.0 * std::f64::consts::LN_2 / std::f64::consts::PI).sqrt();
    are(&level, 0.035, |_| plateau);
}
