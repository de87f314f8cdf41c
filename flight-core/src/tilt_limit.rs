//! The tilt limit: detects a vehicle that does not follow its sticks.

use crate::arithmetic::{sin_cos, sqrt};

/// Cosine and sine of the margin, 20°.
const MARGIN: (f32, f32) = (0.939_692_6, 0.342_020_14);
/// Time beyond the limit after which the limit counts as exceeded, µs.
const LIMIT_US: u32 = 500_000;

/// The tilt limit. In angle mode it is exceeded if the vehicle has been tilted by 20° more than both sticks together
/// can command for half a second. Time below the limit reduces the count at half speed, so that a tumbling vehicle,
/// which passes through level in each turn, is still detected.
///
/// The difference between commanded and actual tilt would detect this sooner, but with false alarms: when both sticks
/// move from stop to stop, 120° apart, an intact vehicle lags behind for just as long.
#[derive(Clone, Copy, Debug)]
pub struct TiltLimit {
    /// Cosine of the largest permitted tilt.
    cos_limit: f32,
    beyond_us: u32,
}

impl TiltLimit {
    /// Creates the limit for sticks that command up to `max_tilt_rad` (rad) each.
    pub fn new(max_tilt_rad: f32) -> Self {
        // Roll and pitch of φ each give a tilt whose cosine is cos² φ.
        let (_, cos) = sin_cos(max_tilt_rad);
        let (cos_max, sin_max) = (cos * cos, sqrt(1.0 - cos * cos * (cos * cos)));
        Self { cos_limit: cos_max * MARGIN.0 - sin_max * MARGIN.1, beyond_us: 0 }
    }

    /// Updates the count with the cosine of the estimated tilt, after `dt_us` (µs). `None` clears the count: the
    /// sticks command no tilt, or the vehicle does not fly.
    #[inline(always)]
    pub fn update(&mut self, cos_tilt: Option<f32>, dt_us: u32) {
        self.beyond_us = match cos_tilt {
            None => 0,
            Some(cos_tilt) if cos_tilt < self.cos_limit => self.beyond_us.saturating_add(dt_us),
            Some(_) => self.beyond_us.saturating_sub(dt_us / 2),
        };
    }

    /// Returns whether the vehicle has been beyond the limit for too long.
    #[inline(always)]
    pub fn exceeded(&self) -> bool {
        self.beyond_us > LIMIT_US
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f32::consts::FRAC_PI_4;
    use proptest::num::f32::ANY;
    use proptest::prelude::*;

    proptest! {
        /// The limit computed from the angles themselves, in f64: the tilt of both sticks together, plus 20°.
        #[test]
        fn limit_is_20_degrees_beyond_both_sticks(max_tilt_rad in 0.01..=1.4_f32) {
            let both = f64::from(max_tilt_rad).cos().powi(2).acos();
            let limit = f64::from(TiltLimit::new(max_tilt_rad).cos_limit);
            // For small φ the sine √(1 − cos⁴ φ) is about √2 φ, with a rounding error of ε/(√2 φ): 8e-6 at 0.01 rad.
            // A third of that, by sin 20°, is in the limit.
            prop_assert!((limit - (both + 20.0_f64.to_radians()).cos()).abs() < 4e-6);
        }

        /// Compares the count with a second one, in half microseconds and without saturation. A NaN tilt does not count
        /// as beyond the limit; the filters return none.
        #[test]
        fn time_below_the_limit_counts_back_at_half_speed(
            past in prop::collection::vec((
                prop::option::weighted(0.95, prop_oneof![8 => -1.0..1.0_f32, 1 => ANY]),
                prop_oneof![4 => 0..200_000_u32, 2 => Just(250_000), 1 => Just(500_000), 1 => Just(u32::MAX)],
            ), 1..60),
        ) {
            let mut limit = TiltLimit::new(FRAC_PI_4);
            let mut beyond_us = 0_u64;
            for (cos_tilt, dt_us) in past {
                limit.update(cos_tilt, dt_us);
                // 45° on both sticks is a tilt of 60°, plus 20°: cos 80°.
                let Some(cos_tilt) = cos_tilt else {
                    beyond_us = 0;
                    prop_assert!(!limit.exceeded());
                    continue;
                };
                prop_assume!((cos_tilt - 0.173_648_18).abs() > 1e-6);
                beyond_us = if cos_tilt < 0.173_648_18 {
                    (beyond_us + u64::from(dt_us)).min(u64::from(u32::MAX))
                } else {
                    beyond_us.saturating_sub(u64::from(dt_us / 2))
                };
                prop_assert_eq!(limit.exceeded(), beyond_us > 500_000);
            }
        }
    }

    /// Returns the time at which a vehicle with this tilt over time (degrees, s) exceeds the limit, s.
    fn exceeded_after(tilt_deg: impl Fn(f32) -> f32) -> Option<f32> {
        let mut limit = TiltLimit::new(FRAC_PI_4);
        (1..=5_000_u16).map(|k| f32::from(k) * 1.0e-3).find(|&t| {
            limit.update(Some(tilt_deg(t).to_radians().cos()), 1_000);
            limit.exceeded()
        })
    }

    #[test]
    fn limit_is_exceeded_after_half_a_second_beyond() {
        // 45° in roll and in pitch is a tilt of 60°, plus 20°.
        assert_eq!(exceeded_after(|_| 79.9), None);
        for degrees in [80.1, 90.0, 180.0] {
            let after = exceeded_after(|_| degrees).unwrap();
            assert!((after - 0.501).abs() < 2.0e-3, "{degrees}: {after}");
        }
        // Tumbling at 720 °/s: 200° of each turn are beyond the limit, so that 200/360 − ½ · 160/360 = ⅓ of the time
        // counts.
        let after = exceeded_after(|t| 720.0 * t).unwrap();
        assert!((1.0..1.6).contains(&after), "{after}");
    }

    #[test]
    fn tilt_at_the_limit_does_not_count() {
        let mut limit = TiltLimit::new(FRAC_PI_4);
        limit.update(Some(limit.cos_limit), u32::MAX);
        assert!(!limit.exceeded());
        limit.update(Some(limit.cos_limit.next_down()), u32::MAX);
        assert!(limit.exceeded());
    }

    #[test]
    fn rate_mode_clears_the_count() {
        let mut limit = TiltLimit::new(FRAC_PI_4);
        (0..600).for_each(|_| limit.update(Some(-1.0), 1_000));
        assert!(limit.exceeded());
        limit.update(None, 1_000);
        assert!(!limit.exceeded());
    }

    #[test]
    fn largest_max_tilt_leaves_room_for_the_margin() {
        // 80.2° on both sticks is a tilt of 88.3°.
        let limit = TiltLimit::new(1.4).cos_limit.acos().to_degrees();
        assert!((limit - 108.3).abs() < 0.1, "{limit}");
    }
}
