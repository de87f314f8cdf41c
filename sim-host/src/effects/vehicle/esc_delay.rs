//! ESC delay: the command takes effect `delay_s` later.
//!
//! A pulse train carries a value once in each period (2.5 ms at 400 Hz), and the ESC applies it some tenths of a
//! millisecond later. The command is constant over a step, so after a delay of n steps and a fraction f it changes
//! at f inside a step. That step uses the mean, (1 − f) c\[k − n\] + f c\[k − n − 1\].
//!
//! Source: pure transport delay, e^(−s·delay).

use serde::Deserialize;

use super::{CommandEffect, VehicleEffect};
use crate::effects::{BuildContext, EffectParams, Snapshot};
use input::InputError;
use input::check;

/// `[effects.vehicle.esc_delay]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EscDelay {
    /// Delay, s.
    pub delay_s: f64,
}

impl EffectParams for EscDelay {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "delay_s", self.delay_s, 0.0, 1.0, "s")
    }

    fn build(&self, context: &BuildContext) -> VehicleEffect {
        let steps = self.delay_s * context.rate_hz;
        // 0.003 s at 1 kHz is 3 steps, not 2.999...
        let nearest = libm::rint(steps);
        let steps = if (steps - nearest).abs() < 1e-9 { nearest } else { steps };
        let whole = libm::floor(steps);
        VehicleEffect::Command(Box::new(DelayLine {
            past: vec![[0.0; 4]; whole as usize + 2],
            newest: 0,
            fraction: steps - whole,
        }))
    }
}

/// The last commands, in a ring: the present one and one for each full or partial step of the delay.
struct DelayLine {
    past: Vec<[f64; 4]>,
    newest: usize,
    fraction: f64,
}

impl CommandEffect for DelayLine {
    fn apply(&mut self, wanted: &mut [f64; 4], _: &Snapshot) {
        let slots = self.past.len();
        let after = |slot: usize| if slot + 1 == slots { 0 } else { slot + 1 };
        self.newest = after(self.newest);
        self.past[self.newest] = *wanted;
        // The slot after the newest holds the oldest.
        let oldest = after(self.newest);
        let (before, now) = (self.past[oldest], self.past[after(oldest)]);
        for (wanted, (before, now)) in wanted.iter_mut().zip(before.into_iter().zip(now)) {
            *wanted = now + self.fraction * (before - now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::vehicle::testing::{STATE, command, snapshot};

    /// Returns the response to a step from 0 to 100 rad/s.
    fn step_through(delay_s: f64) -> Vec<f64> {
        let mut delay = command(&EscDelay { delay_s });
        (0..8)
            .map(|k| {
                let mut wanted = [100.0; 4];
                delay.apply(&mut wanted, &snapshot(&STATE, f64::from(k) * 1e-3, [0.0; 4]));
                assert!(wanted.iter().all(|w| *w == wanted[0]));
                wanted[0]
            })
            .collect()
    }

    #[test]
    fn step_command_is_delayed() {
        assert_eq!(step_through(0.0), [100.0; 8]);
        assert_eq!(step_through(0.003), [0.0, 0.0, 0.0, 100.0, 100.0, 100.0, 100.0, 100.0]);
        // The delay is 2.25 steps, so during a quarter of the third step the value is still the old one.
        let out = step_through(0.002_25);
        assert!((out[2] - 75.0).abs() < 1e-9 && out[1] == 0.0 && out[3] == 100.0, "{out:?}");
    }
}
