//! Eq 18's gains for noise and bias: random numbers of the simulator through the estimators of the flight code, without
//! the prefilter.
//!
//! With o\[k\] = α (o\[k−1\] + ω Δt) + (1 − α) b\[k\] and independent errors in each sample, the output o is a
//! first-order autoregression, whose closed forms are:
//!
//! | error | of o | at α = 0.97 |
//! |---|---|---|
//! | white noise σ of b | σ √((1 − α)/(1 + α)) | 0.12340 σ |
//! | white noise σ of ω | σ Δt α/√(1 − α²) | 3.990 σ Δt |
//! | constant β of ω | β Δt α/(1 − α) | 32.33 β Δt |
//!
//! Its autocorrelation is α^|k|. The error of a deviation depends on Σρ² = (1 + α²)/(1 − α²): that many samples count
//! as one (33 at 0.97). The error of a mean depends on Σρ = (1 + α)/(1 − α) (66).

use flight_core::STANDARD_GRAVITY;
use flight_core::estimator::{Estimator, EstimatorParams};
use flight_core::geometry::{Vec3, vec3};
use random::NormalStreams;

use crate::spread::Spread;

struct Case {
    params: EstimatorParams,
    rate_hz: f32,
    alpha: f64,
}

/// Time constant τ of the estimator `paper`: 32.33 steps at 100 Hz.
const TAU_S: f64 = 0.97 / 0.03 * 0.01;

/// At 100 Hz the estimators `paper` and `paper-literal` are the same filter. At 1 kHz the first keeps its τ, the second
/// its α.
const CASES: [Case; 4] = [
    Case { params: EstimatorParams::PAPER, rate_hz: 100.0, alpha: 0.97 },
    Case { params: EstimatorParams::PAPER_LITERAL, rate_hz: 100.0, alpha: 0.97 },
    Case { params: EstimatorParams::PAPER, rate_hz: 1000.0, alpha: TAU_S / (TAU_S + 0.001) },
    Case { params: EstimatorParams::PAPER_LITERAL, rate_hz: 1000.0, alpha: 0.97 },
];

const UPDATES: u32 = 2_000_000;
/// A horizontal field, as at the magnetic equator, µT: there a tilt error causes no heading error.
const FIELD_UT: f64 = 35.0;

impl Case {
    fn estimator(&self) -> Estimator {
        Estimator::new(&self.params).unwrap_or_else(|error| panic!("{error}"))
    }

    /// Returns the number of updates after which the start has decayed to e⁻²⁰.
    fn settling(&self) -> u32 {
        (20.0 / (1.0 - self.alpha)) as u32
    }

    fn samples_per_independent_square(&self) -> f64 {
        let square = self.alpha * self.alpha;
        (1.0 + square) / (1.0 - square)
    }
}

/// Returns roll, pitch and heading. They stay below 0.01 rad here, where an angle and its sine differ by 2e-5 of it.
fn angles(estimator: &Estimator) -> [f64; 3] {
    let down = estimator.down();
    [f64::from(down.y), -f64::from(down.x), f64::from(estimator.heading())]
}

/// Returns the reading of a perfect accelerometer at rest.
fn at_rest(roll: f64, pitch: f64) -> Vec3<f32> {
    let g = f64::from(STANDARD_GRAVITY);
    let (sin, cos) = (libm::sin, libm::cos);
    vec3((g * sin(pitch)) as f32, (-g * sin(roll) * cos(pitch)) as f32, (-g * cos(roll) * cos(pitch)) as f32)
}

/// Returns the reading of a perfect magnetometer on a level vehicle.
fn pointing_north_from(heading: f64) -> Vec3<f32> {
    vec3((FIELD_UT * libm::cos(heading)) as f32, (-FIELD_UT * libm::sin(heading)) as f32, 0.0)
}

#[test]
fn white_angle_noise_gain_is_0_1234() {
    assert!((libm::sqrt(0.03 / 1.97) - 0.12340).abs() < 1e-5);
    let sigma = 0.01;
    for (n, case) in CASES.iter().enumerate() {
        let mut streams = NormalStreams::new(1, "paper.angle_noise");
        let mut estimator = case.estimator();
        let mut spreads = [Spread::default(); 3];
        for k in 0..UPDATES {
            let noise = streams.draw() * sigma;
            let field = pointing_north_from(noise.z);
            estimator.update(Vec3::ZERO, at_rest(noise.x, noise.y), Some(field), 1.0 / case.rate_hz);
            if k >= case.settling() {
                for (spread, angle) in spreads.iter_mut().zip(angles(&estimator)) {
                    spread.add(angle);
                }
            }
        }
        let gain = libm::sqrt((1.0 - case.alpha) / (1.0 + case.alpha));
        for spread in spreads {
            println!("case {n}: {:.5}", spread.deviation() / sigma);
            spread.assert_deviation(gain * sigma, case.samples_per_independent_square());
        }
    }
}

#[test]
fn rate_noise_gain_is_3_99_steps_and_bias_gain_is_32_33() {
    assert!((0.97 / libm::sqrt(1.0 - 0.97 * 0.97) - 3.990).abs() < 1e-4);
    assert!((0.97_f64 / 0.03 - 32.33).abs() < 0.01);
    let (sigma, bias) = (0.01, 0.001);
    for (n, case) in CASES.iter().enumerate() {
        let mut streams = NormalStreams::new(2, "paper.rate_noise");
        let mut estimator = case.estimator();
        let mut spreads = [Spread::default(); 3];
        let (level, north) = (at_rest(0.0, 0.0), pointing_north_from(0.0));
        for k in 0..UPDATES {
            let rate = <[f64; 3]>::from(streams.draw()).map(|w| (bias + sigma * w) as f32);
            estimator.update(rate.into(), level, Some(north), 1.0 / case.rate_hz);
            if k >= case.settling() {
                for (spread, angle) in spreads.iter_mut().zip(angles(&estimator)) {
                    spread.add(angle);
                }
            }
        }
        let dt_s = 1.0 / f64::from(case.rate_hz);
        let a = case.alpha;
        let deviation = sigma * dt_s * a / libm::sqrt(1.0 - a * a);
        let offset = bias * dt_s * a / (1.0 - a);
        for spread in spreads {
            println!("case {n}: {:.4} {:.3}", spread.deviation() / sigma / dt_s, spread.mean() / bias / dt_s);
            spread.assert_deviation(deviation, case.samples_per_independent_square());
            let error = deviation * libm::sqrt((1.0 + a) / (1.0 - a) / spread.count());
            // The Euler rates couple the axes' offsets in proportion to their size, by at most 3.3e-4 rad.
            assert!(
                (spread.mean() - offset).abs() < 5.0 * error + 1e-3 * offset,
                "{} {offset}",
                spread.mean()
            );
        }
    }
}
