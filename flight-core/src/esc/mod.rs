//! Rotor speed to ESC pulse, and the pulse to what goes over the wire ([`protocol`]).

pub mod protocol;

use crate::arithmetic::{max, min};
use crate::range::{ConfigError, check};

/// The ESC's pulse map: linear in rotor speed from `stop_us` (no rotation) to `full_us` (`max_rad_s`).
///
/// The map of a real ESC and motor is measured on a stand; a straight line through its ends is our choice
/// for the default vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct EscParams {
    /// Pulse at which the motor stands still, µs.
    pub stop_us: f32,
    /// Pulse of full speed, µs.
    pub full_us: f32,
}

impl EscParams {
    /// 1,000 to 2,000 µs, the servo pulse that every ESC understands.
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
    /// The map for rotors that do `idle_rad_s` to `max_rad_s`.
    ///
    /// # Errors
    /// Pulses outside 100 to 3,000 µs, or full not above stop.
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

    /// The pulse of a disarmed motor, µs.
    #[inline(always)]
    pub fn stop_us(&self) -> f32 {
        self.stop_us
    }

    /// The pulse for a share (0 to 1) of the largest speed, without idling: for one motor on the bench, µs.
    pub fn pulse_of_share_us(&self, share: f32) -> f32 {
        min(max(self.stop_us + (self.full_us - self.stop_us) * share, self.stop_us), self.full_us)
    }

    /// The pulse for a speed (rad/s), between idle and full, µs.
    #[inline(always)]
    pub fn pulse_us(&self, speed_rad_s: f32) -> f32 {
        // `min` and `max` here also keep a NaN from reaching a motor: they return the limit.
        min(max(self.stop_us + self.us_per_rad_s * speed_rad_s, self.idle_us), self.full_us)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::num::f32::ANY;
    use proptest::prelude::*;

    proptest! {
        /// Any map that is taken: its pulses are those of the straight line, cut at idle and full, for any speed; and
        /// a speed that is not a number idles.
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
            let line = |share: f64, least: f64| stop + span * share.clamp(least, 1.0);
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
        fn any_pulses_are_a_map_or_refused(
            stop_us in prop_oneof![0.0..4000.0_f32, ANY], full_us in prop_oneof![0.0..4000.0_f32, ANY],
        ) {
            let good = (100.0..=3000.0).contains(&stop_us) && full_us >= stop_us + 1.0 && full_us <= 3000.0;
            prop_assert_eq!(Esc::new(&EscParams { stop_us, full_us }, 32.0, 320.0).is_ok(), good);
        }
    }

    #[test]
    fn line_and_limits() {
        let esc = Esc::new(&EscParams::STANDARD, 32.0, 320.0).unwrap();
        assert_eq!(esc.pulse_us(160.0), 1500.0);
        assert_eq!(esc.pulse_us(0.0), 1100.0);
        assert_eq!(esc.pulse_us(1.0e6), 2000.0);
        assert_eq!(esc.pulse_us(f32::NAN), 1100.0);
        assert_eq!(esc.stop_us(), 1000.0);
    }

    #[test]
    fn refuses_a_map_that_does_not_rise() {
        let falling = EscParams { stop_us: 2000.0, full_us: 1000.0 };
        assert_eq!(Esc::new(&falling, 32.0, 320.0).unwrap_err().field, "esc.full_us");
    }
}
