//! Sampling jitter: a sample is taken at t + δ while its time stamp says t.
//!
//! The sensors then read the truth, extrapolated by its derivatives:
//!
//! ω(t + δ) = ω + ω̇ δ, f(t + δ) = f + ḟ δ
//!
//! ω̇ is the vehicle's angular acceleration. ḟ is the difference to the previous sample, divided by the interval. A
//! vehicle that turns at a constant rate shows no error; at ω̇ = 100 rad/s², δ = 20 µs is 2 mrad/s.
//!
//! δ has the standard deviation σ, and a normal or uniform distribution (on ±√3 σ). It never exceeds half an
//! interval, so samples stay in order.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use super::ImuEffect;
use crate::effects::{BuildContext, EffectParams, Snapshot};
use crate::state::State;
use input::InputError;
use input::check;
use random::{NormalStream, UniformStream};

/// `[effects.imu.sampling_jitter]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SamplingJitter {
    /// Standard deviation σ, µs.
    pub sigma_us: f64,
    /// `"normal"` (the default) or `"uniform"`.
    #[serde(default)]
    pub distribution: Distribution,
}

/// Distribution of δ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distribution {
    /// Normal: the sum of many small delays, as by interrupts of other tasks.
    #[default]
    Normal,
    /// Uniform: a sensor's clock that is not synchronised with the controller's.
    Uniform,
}

impl EffectParams for SamplingJitter {
    type Effect = ImuEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "sigma_us", self.sigma_us, 0.0, 1e5, "µs")
    }

    fn build(&self, context: &BuildContext) -> ImuEffect {
        let sigma_s = self.sigma_us * 1e-6;
        let draws = match self.distribution {
            Distribution::Normal => Draws::Normal(NormalStream::new(context.seed, context.name, 0), sigma_s),
            Distribution::Uniform => {
                Draws::Uniform(UniformStream::new(context.seed, context.name, 0), libm::sqrt(3.0) * sigma_s)
            }
        };
        ImuEffect::Sampling(Jitter {
            draws,
            interval_s: context.interval_s(),
            rate_hz: context.rate_hz,
            before: None,
        })
    }
}

enum Draws {
    /// Standard deviation, s.
    Normal(NormalStream, f64),
    /// Largest magnitude, s.
    Uniform(UniformStream, f64),
}

/// Jitter of the time at which samples are taken.
pub struct Jitter {
    draws: Draws,
    interval_s: f64,
    rate_hz: f64,
    /// Specific force at the previous sample, m/s².
    before: Option<Vec3<f64>>,
}

impl Jitter {
    /// Returns δ of the next sample, s.
    fn draw(&mut self) -> f64 {
        let delta_s = match &mut self.draws {
            Draws::Normal(stream, sigma_s) => stream.draw() * *sigma_s,
            Draws::Uniform(stream, largest_s) => (2.0 * stream.draw() - 1.0) * *largest_s,
        };
        delta_s.clamp(-0.5 * self.interval_s, 0.5 * self.interval_s)
    }

    /// Returns the truth at the time at which the sample is really taken. `state` is a copy of the true state, which
    /// is moved to that time.
    #[inline]
    pub fn displaced<'a>(&mut self, at: &Snapshot, state: &'a mut State) -> Snapshot<'a> {
        let delta_s = self.draw();
        let change = self.before.map_or(Vec3::ZERO, |before| at.specific_force - before);
        self.before = Some(at.specific_force);
        state.rates += at.angular_acceleration * delta_s;
        Snapshot {
            time_s: at.time_s + delta_s,
            state,
            specific_force: at.specific_force + change * (delta_s * self.rate_hz),
            ..*at
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{STATE, build_with, snapshot};
    use flight_core::geometry::vec3;

    fn jitter(sigma_us: f64, distribution: Distribution) -> Jitter {
        match build_with(&SamplingJitter { sigma_us, distribution }, "imu.sampling_jitter", 1000.0, 1) {
            ImuEffect::Sampling(jitter) => jitter,
            ImuEffect::Delivery(_) => unreachable!("a jitter moves the time of sampling"),
        }
    }

    #[test]
    fn jitter_has_its_deviation_and_keeps_order() {
        let n = 200_000;
        // The fourth moment is 3 σ⁴ of a normal distribution, 9/5 σ⁴ of a uniform one.
        for (distribution, fourth) in [(Distribution::Normal, 3.0), (Distribution::Uniform, 1.8)] {
            let mut jitter = jitter(20.0, distribution);
            let draws: Vec<f64> = (0..n).map(|_| jitter.draw() * 1e6).collect();
            let mean = draws.iter().sum::<f64>() / f64::from(n);
            let square = draws.iter().map(|x| x * x).sum::<f64>() / f64::from(n);
            assert!(mean.abs() < 5.0 * 20.0 / f64::from(n).sqrt(), "{mean}");
            let error = 5.0 * ((fourth - 1.0_f64) / f64::from(n)).sqrt();
            assert!((square / 400.0 - 1.0).abs() < error, "{distribution:?}: {square}");
        }
        let mut wild = jitter(5000.0, Distribution::Normal);
        assert!((0..1000).all(|_| wild.draw().abs() <= 0.5e-3));
    }

    #[test]
    fn jitter_error_is_derivative_times_delay() {
        // Rates and force change linearly with time, so the extrapolation is exact at any δ.
        let (acceleration, jerk) = (vec3(100.0, -50.0, 20.0), vec3(-3.0, 7.0, 11.0));
        let truth = |t: f64| (acceleration * t, vec3(0.0, 0.0, -9.8) + jerk * t);
        let mut jitter = jitter(50.0, Distribution::Uniform);
        for k in 0..1000 {
            let t = f64::from(k) * 1e-3;
            let (rates, specific_force) = truth(t);
            let state = State { rates, ..STATE };
            let at = Snapshot { specific_force, angular_acceleration: acceleration, ..snapshot(&state, t) };
            let mut moved = state;
            let got = jitter.displaced(&at, &mut moved);
            let (wanted_rates, wanted_force) = truth(got.time_s);
            assert!((got.state.rates - wanted_rates).norm() < 1e-9);
            // The first sample has no previous one.
            assert!(k == 0 || (got.specific_force - wanted_force).norm() < 1e-9);
            assert!((got.time_s - t).abs() <= 3.0_f64.sqrt() * 50e-6 && (k > 3 || got.time_s != t));
        }
    }
}
