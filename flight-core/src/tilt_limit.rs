//! Whether the vehicle follows its sticks at all.

use crate::arithmetic::{sin_cos, sqrt};

/// Cosine and sine of 20°.
const MARGIN: (f32, f32) = (0.939_692_6, 0.342_020_14);
/// How long it may be beyond, µs.
const LIMIT_US: u32 = 500_000;

/// Looks at the tilt: in angle mode a vehicle that is tilted by 20° more than both sticks together can ask for, for
/// half a second, does not follow. Time in which it is nearer to level counts half, backwards: who tumbles comes by
/// there in each turn.
///
/// The error of the tilt would show it sooner, and wrongly: with both sticks from stop to stop, 120° apart, a vehicle
/// in order is behind for as long as that.
#[derive(Clone, Copy, Debug)]
pub struct TiltLimit {
    /// Cosine of the tilt that is too much.
    cos_limit: f32,
    beyond_us: u32,
}

impl TiltLimit {
    /// For sticks that ask for up to `max_tilt_rad` each.
    pub fn new(max_tilt_rad: f32) -> Self {
        // Roll and pitch of φ are a tilt whose cosine is cos² φ.
        let (_, cos) = sin_cos(max_tilt_rad);
        let (cos_most, sin_most) = (cos * cos, sqrt(1.0 - cos * cos * (cos * cos)));
        Self { cos_limit: cos_most * MARGIN.0 - sin_most * MARGIN.1, beyond_us: 0 }
    }

    /// Takes the cosine of the estimated tilt after `dt_us`; `None` where the sticks ask for no tilt, or nobody flies.
    #[inline(always)]
    pub fn update(&mut self, cos_tilt: Option<f32>, dt_us: u32) {
        self.beyond_us = match cos_tilt {
            None => 0,
            Some(cos_tilt) if cos_tilt < self.cos_limit => self.beyond_us.saturating_add(dt_us),
            Some(_) => self.beyond_us.saturating_sub(dt_us / 2),
        };
    }

    /// Whether the vehicle does not follow.
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
        /// The limit by the angles themselves, in f64: the tilt of both sticks together, and 20°.
        #[test]
        fn the_limit_is_twenty_degrees_beyond_both_sticks(max_tilt_rad in 0.01..=1.4_f32) {
            let both = f64::from(max_tilt_rad).cos().powi(2).acos();
            let limit = f64::from(TiltLimit::new(max_tilt_rad).cos_limit);
            // For small φ the sine √(1 − cos⁴ φ) is about √2 φ, and has ε/(√2 φ) of rounding: 8e-6 at 0.01 rad, and a
            // third of it here.
            prop_assert!((limit - (both + 20.0_f64.to_radians()).cos()).abs() < 4e-6);
        }

        /// A second count, in half microseconds and without a limit. A tilt that is not a number is not one that is
        /// too much: the filters give none.
        #[test]
        fn time_beyond_counts_and_time_within_counts_half_backwards(
            past in prop::collection::vec((
                prop::option::weighted(0.95, prop_oneof![8 => -1.0..1.0_f32, 1 => ANY]),
                prop_oneof![4 => 0..200_000_u32, 2 => Just(250_000), 1 => Just(500_000), 1 => Just(u32::MAX)],
            ), 1..60),
        ) {
            let mut watch = TiltLimit::new(FRAC_PI_4);
            let mut beyond_us = 0_u64;
            for (cos_tilt, dt_us) in past {
                watch.update(cos_tilt, dt_us);
                // 45° each are 60°, and 20° more: cos 80°.
                let Some(cos_tilt) = cos_tilt else {
                    beyond_us = 0;
                    prop_assert!(!watch.exceeded());
                    continue;
                };
                prop_assume!((cos_tilt - 0.173_648_18).abs() > 1e-6);
                beyond_us = if cos_tilt < 0.173_648_18 {
                    (beyond_us + u64::from(dt_us)).min(u64::from(u32::MAX))
                } else {
                    beyond_us.saturating_sub(u64::from(dt_us / 2))
                };
                prop_assert_eq!(watch.exceeded(), beyond_us > 500_000);
            }
        }
    }

    /// When a vehicle with this tilt over time (degrees, s) is found to be upset, s.
    fn found_after(tilt_deg: impl Fn(f32) -> f32) -> Option<f32> {
        let mut watch = TiltLimit::new(FRAC_PI_4);
        (1..=5_000_u16).map(|k| f32::from(k) * 1.0e-3).find(|&t| {
            watch.update(Some(tilt_deg(t).to_radians().cos()), 1_000);
            watch.exceeded()
        })
    }

    #[test]
    fn who_is_too_far_for_half_a_second_is_upset() {
        // 45° in roll and in pitch are 60°, and 20° more.
        assert_eq!(found_after(|_| 79.9), None);
        for degrees in [80.1, 90.0, 180.0] {
            let after = found_after(|_| degrees).unwrap();
            assert!((after - 0.501).abs() < 2.0e-3, "{degrees}: {after}");
        }
        // Tumbling at 720 °/s: of each turn 200° are too far, so that 200/360 − ½ · 160/360 = ⅓ of the time counts.
        let after = found_after(|t| 720.0 * t).unwrap();
        assert!((1.0..1.6).contains(&after), "{after}");
    }

    #[test]
    fn the_limit_itself_is_not_too_far() {
        let mut watch = TiltLimit::new(FRAC_PI_4);
        watch.update(Some(watch.cos_limit), u32::MAX);
        assert!(!watch.exceeded());
        watch.update(Some(watch.cos_limit.next_down()), u32::MAX);
        assert!(watch.exceeded());
    }

    #[test]
    fn who_flies_rates_is_not_watched() {
        let mut watch = TiltLimit::new(FRAC_PI_4);
        (0..600).for_each(|_| watch.update(Some(-1.0), 1_000));
        assert!(watch.exceeded());
        watch.update(None, 1_000);
        assert!(!watch.exceeded());
    }

    #[test]
    fn the_largest_tilt_that_may_be_set_leaves_room_for_its_margin() {
        // 80.2° each are 88.3°.
        let limit = TiltLimit::new(1.4).cos_limit.acos().to_degrees();
        assert!((limit - 108.3).abs() < 0.1, "{limit}");
    }
}
