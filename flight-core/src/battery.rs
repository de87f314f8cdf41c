//! Whether the battery will do.

use crate::sample::Battery;

/// Age of the last measurement at which the voltage counts as unknown, µs.
const STALE_US: u32 = 2_000_000;
/// How long the voltage must have been critical, µs: longer than a full throttle burst lasts.
const CRITICAL_US: u32 = 3_000_000;

/// The last measurement, its age, and how long it has been critical.
#[derive(Clone, Copy, Debug)]
pub struct BatteryMonitor {
    min_arm_v: f32,
    critical_v: f32,
    voltage_v: f32,
    age_us: u32,
    critical_us: u32,
}

impl BatteryMonitor {
    /// Before the first measurement. Below `min_arm_v` no flight starts; below `critical_v` one ends.
    pub fn new(min_arm_v: f32, critical_v: f32) -> Self {
        Self { min_arm_v, critical_v, voltage_v: 0.0, age_us: u32::MAX, critical_us: 0 }
    }

    /// Takes what was measured in a step that comes `dt_us` after the last. `flying`: a flight is under way; on
    /// the ground the battery may be changed, and what was critical is forgotten.
    #[inline]
    pub fn update(&mut self, measured: Option<Battery>, flying: bool, dt_us: u32) {
        self.age_us = self.age_us.saturating_add(dt_us);
        if let Some(battery) = measured {
            self.voltage_v = battery.voltage_v;
            self.age_us = 0;
        }
        if !flying || (self.critical_us < CRITICAL_US && !self.below_critical()) {
            self.critical_us = 0;
        } else {
            self.critical_us = self.critical_us.saturating_add(dt_us);
        }
    }

    #[inline(always)]
    fn below_critical(&self) -> bool {
        // A supply that is no longer measured is no reason to come down.
        self.age_us <= STALE_US && self.voltage_v < self.critical_v
    }

    /// Too low to start with, or unknown; a voltage that is not a number is not enough.
    #[inline(always)]
    pub fn low(&self) -> bool {
        let enough = self.voltage_v >= self.min_arm_v && self.age_us <= STALE_US;
        !enough
    }

    /// Too low to fly on, since 3 s ago; then until the flight is over.
    #[inline(always)]
    pub fn critical(&self) -> bool {
        self.critical_us >= CRITICAL_US
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::num::f32::ANY;
    use proptest::prelude::*;

    fn volts() -> impl Strategy<Value = f32> {
        prop_oneof![6 => 7.0..13.0_f32, 2 => prop::sample::select(&[9.0, 10.5, f32::NAN][..]), 1 => ANY]
    }

    proptest! {
        /// From the whole past, told with absolute times: which measurement was the last, and since when it has been
        /// critical.
        #[test]
        fn what_is_said_follows_from_the_measurements_and_their_times(
            past in prop::collection::vec((
                prop::option::weighted(0.4, volts()),
                prop::bool::weighted(0.9),
                prop_oneof![3 => 0..400_000_u32, 2 => Just(500_000), 2 => Just(1_000_000), 1 => Just(u32::MAX)],
            ), 1..60),
        ) {
            let mut watch = BatteryMonitor::new(10.5, 9.0);
            prop_assert!(watch.low() && !watch.critical());
            let mut now_us = 0_u64;
            let mut last: Option<(u64, f32)> = None;
            // When each unbroken time began in which the voltage was known and critical; `latched`: it was long enough.
            let (mut since_us, mut latched) = (None, false);
            for (measured, flying, dt_us) in past {
                let before_us = now_us;
                now_us += u64::from(dt_us);
                if let Some(voltage_v) = measured {
                    last = Some((now_us, voltage_v));
                }
                watch.update(measured.map(|voltage_v| Battery { voltage_v }), flying, dt_us);

                let known = last.filter(|(at_us, _)| now_us - at_us <= 2_000_000);
                prop_assert_eq!(watch.low(), known.is_none_or(|(_, v)| v.is_nan() || v < 10.5));
                // What is measured now is taken to have been so since the last step.
                let below = known.is_some_and(|(_, v)| v < 9.0);
                if !flying {
                    (since_us, latched) = (None, false);
                } else if below {
                    let began_us = *since_us.get_or_insert(before_us);
                    latched |= now_us - began_us >= 3_000_000;
                } else {
                    since_us = None;
                }
                prop_assert_eq!(watch.critical(), latched);
            }
        }
    }

    fn run(watch: &mut BatteryMonitor, voltage_v: Option<f32>, flying: bool, ms: u32) -> (bool, bool) {
        for _ in 0..ms {
            watch.update(voltage_v.map(|voltage_v| Battery { voltage_v }), flying, 1_000);
        }
        (watch.low(), watch.critical())
    }

    #[test]
    fn unknown_is_low_and_so_is_what_is_not_a_number() {
        let mut watch = BatteryMonitor::new(10.5, 9.0);
        assert_eq!(run(&mut watch, None, false, 1), (true, false));
        assert_eq!(run(&mut watch, Some(10.5), false, 1), (false, false));
        assert_eq!(run(&mut watch, None, false, 2_000), (false, false));
        assert_eq!(run(&mut watch, None, false, 1), (true, false));
        assert_eq!(run(&mut watch, Some(f32::NAN), false, 1), (true, false));
        assert_eq!(run(&mut watch, Some(10.4), false, 1), (true, false));
    }

    #[test]
    #[cfg_attr(miri, ignore = "27,000 steps")]
    fn a_dip_is_not_critical_and_what_is_stays_so_until_the_flight_is_over() {
        let mut watch = BatteryMonitor::new(10.5, 9.0);
        assert!(!run(&mut watch, Some(8.0), true, 2_999).1);
        assert!(!run(&mut watch, Some(9.5), true, 1).1);
        assert!(!run(&mut watch, Some(8.0), true, 2_999).1);
        assert!(run(&mut watch, Some(8.0), true, 1).1);
        assert!(run(&mut watch, Some(12.0), true, 10_000).1);
        assert!(!run(&mut watch, Some(12.0), false, 1).1);
        // Not measured any more: no reason to come down.
        run(&mut watch, Some(8.0), true, 900);
        assert!(!run(&mut watch, None, true, 10_000).1);
    }
}
