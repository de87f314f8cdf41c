//! Conversion of rotor speed into ESC pulses. [`protocol`] converts the pulses into timer values.

pub mod protocol;

use crate::arithmetic::{max, min};
use crate::range::{ConfigError, check};

/// The pulse map of an ESC: linear in rotor speed from `stop_us` (no rotation) to `full_us` (`max_rad_s`).
///
/// The map of a real ESC and motor is measured on a test stand. The straight line is our assumption for the default
/// vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct EscParams {
    /// Pulse at which the motor stands still, µs: 100 to 3,000.
    pub stop_us: f32,
    /// Pulse of full speed, µs: `stop_us + 1` to 3,000.
    pub full_us: f32,
}

impl EscParams {
    /// 1,000 to 2,000 µs, the range of servo pulses that every ESC accepts.
    pub const STANDARD: Self = Self { stop_us: 1000.0, full_us: 2000.0 };
}

/// The map from rotor speed to pulse.
#[derive(Clone, Copy, Debug)]
pub struct Esc {
    stop_us: f32,
    us_per_rad_s: f32,
    idle_us: f32,
    full_us: f32,
}

impl Esc {
    /// Creates the map for rotors that turn at `idle_rad_s` to `max_rad_s`.
    ///
    /// # Errors
    /// Returns the pulse that is outside its range: `stop_us` 100 to 3,000 µs, `full_us` from `stop_us + 1` to
    /// 3,000 µs.
    pub fn new(params: &EscParams, idle_rad_s: f32, max_rad_s: f32) -> Result<Self, ConfigError> {
        check("esc.stop_us", params.stop_us, 100.0, 3000.0)?;
        check("esc.full_us", params.full_us, params.stop_us + 1.0, 3000.0)?;
        let us_per_rad_s = (params.full_us - params.stop_us) / max_rad_s;
        Ok(Self {
            stop_us: params.stop_us,
            us_per_rad_s,
            idle_us: params.stop_us + us_per_rad_s * idle_rad_s,
            full_us: params.full_us,
        })
    }

    /// Returns the pulse of a stopped motor, µs.
    #[inline(always)]
    pub fn stop_us(&self) -> f32 {
        self.stop_us
    }

    /// Returns the pulse for a share (0 to 1) of the maximum speed, µs. Unlike [`Self::pulse_us`] it does not keep
    /// the rotor at idle: for one motor on the bench.
    pub fn pulse_of_share_us(&self, share: f32) -> f32 {
        min(max(self.stop_us + (self.full_us - self.stop_us) * share, self.stop_us), self.full_us)
    }

    /// Returns the pulse for a speed (rad/s), limited to the range from idle to full, µs.
    #[inline(always)]
    pub fn pulse_us(&self, speed_rad_s: f32) -> f32 {
        // `min` and `max` of `arithmetic` return the limit for a NaN, so that no NaN reaches a motor.
        min(max(self.stop_us + self.us_per_rad_s * speed_rad_s, self.idle_us), self.full_us)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::num::f32::ANY;
    use proptest::prelude::*;

    proptest! {
        /// For any valid map and any speed: the pulse is on the straight line, limited to idle and full. NaN gives
        /// idle.
        #[test]
        fn pulses_of_any_speed(
            stop_us in 100.0..2000.0_f32, span_us in 1.0..1000.0_f32,
            max_rad_s in 1.0..1.0e4_f32, idle in 0.0..=0.5_f32,
            share in prop_oneof![-0.5..1.5_f32, ANY],
            any in ANY,
        ) {
            let (full_us, idle_rad_s) = (stop_us + span_us, idle * max_rad_s);
            prop_assume!(full_us >= stop_us + 1.0);
            let esc = Esc::new(&EscParams { stop_us, full_us }, idle_rad_s, max_rad_s).unwrap();
            prop_assert_eq!(esc.stop_us(), stop_us);
            let (stop, span) = (f64::from(stop_us), f64::from(full_us) - f64::from(stop_us));
            let line = |share: f64, min_share: f64| stop + span * share.clamp(min_share, 1.0);
            let near = |ours: f32, exact: f64| (f64::from(ours) - exact).abs() < 1e-3;
            if !share.is_nan() {
                let speed = f64::from(share * max_rad_s) / f64::from(max_rad_s);
                prop_assert!(near(esc.pulse_us(share * max_rad_s), line(speed, f64::from(idle_rad_s) / f64::from(max_rad_s))));
                prop_assert!(near(esc.pulse_of_share_us(share), line(f64::from(share), 0.0)));
            }
            for us in [esc.pulse_us(any), esc.pulse_of_share_us(any)] {
                prop_assert!(us >= stop_us && us <= full_us, "{}: {}", any, us);
            }
            prop_assert_eq!(esc.pulse_us(f32::NAN), esc.pulse_us(0.0));
            prop_assert_eq!(esc.pulse_of_share_us(f32::NAN), stop_us);
        }

        #[test]
        fn any_pulses_form_a_map_or_are_rejected(
            stop_us in prop_oneof![0.0..4000.0_f32, ANY], full_us in prop_oneof![0.0..4000.0_f32, ANY],
        ) {
            let valid = (100.0..=3000.0).contains(&stop_us) && full_us >= stop_us + 1.0 && full_us <= 3000.0;
            prop_assert_eq!(Esc::new(&EscParams { stop_us, full_us }, 32.0, 320.0).is_ok(), valid);
        }
    }

    #[test]
    fn pulses_on_the_line_and_at_its_limits() {
        let esc = Esc::new(&EscParams::STANDARD, 32.0, 320.0).unwrap();
        assert_eq!(esc.pulse_us(160.0), 1500.0);
        assert_eq!(esc.pulse_us(0.0), 1100.0);
        assert_eq!(esc.pulse_us(1.0e6), 2000.0);
        assert_eq!(esc.pulse_us(f32::NAN), 1100.0);
        assert_eq!(esc.stop_us(), 1000.0);
    }

    #[test]
    fn falling_map_is_rejected() {
        let falling = EscParams { stop_us: 2000.0, full_us: 1000.0 };
        assert_eq!(Esc::new(&falling, 32.0, 320.0).unwrap_err().field, "esc.full_us");
    }
}
