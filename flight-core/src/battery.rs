//! Supervision of the battery voltage.

use crate::sample::Battery;

/// The voltage counts as unknown if the last measurement is older than this, µs.
const STALE_US: u32 = 2_000_000;
/// Time for which the voltage must have been critical, µs: longer than a burst of full throttle lasts.
const CRITICAL_US: u32 = 3_000_000;

/// The battery monitor: the last measurement, its age, and the time for which the voltage has been critical.
#[derive(Clone, Copy, Debug)]
pub struct BatteryMonitor {
    min_arm_v: f32,
    critical_v: f32,
    voltage_v: f32,
    age_us: u32,
    critical_us: u32,
}

impl BatteryMonitor {
    /// Creates a monitor without a measurement. A flight must not start below `min_arm_v` (V) and must end below
    /// `critical_v` (V).
    pub fn new(min_arm_v: f32, critical_v: f32) -> Self {
        Self { min_arm_v, critical_v, voltage_v: 0.0, age_us: u32::MAX, critical_us: 0 }
    }

    /// Updates the monitor with the measurement of a step, if there is one; the step comes `dt_us` (µs) after the
    /// last one. `flying` states whether a flight is in progress. On the ground the critical state is cleared,
    /// because the battery may be replaced there.
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
        // A battery that is no longer measured is no reason to end a flight.
        self.age_us <= STALE_US && self.voltage_v < self.critical_v
    }

    /// Returns whether the voltage is too low to start a flight, or unknown. A NaN voltage counts as low.
    #[inline(always)]
    pub fn low(&self) -> bool {
        let enough = self.voltage_v >= self.min_arm_v && self.age_us <= STALE_US;
        !enough
    }

    /// Returns whether the voltage has been too low to fly for 3 s. The result then stays true until the flight is
    /// over.
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
        /// Computed from the whole history with absolute times: the last measurement, and the time since which the
        /// voltage has been critical.
        #[test]
        fn low_and_critical_follow_from_the_history(
            past in prop::collection::vec((
                prop::option::weighted(0.4, volts()),
                prop::bool::weighted(0.9),
                prop_oneof![3 => 0..400_000_u32, 2 => Just(500_000), 2 => Just(1_000_000), 1 => Just(u32::MAX)],
            ), 1..60),
        ) {
            let mut monitor = BatteryMonitor::new(10.5, 9.0);
            prop_assert!(monitor.low() && !monitor.critical());
            let mut now_us = 0_u64;
            let mut last: Option<(u64, f32)> = None;
            // `since_us` is the start of the present unbroken time with a known, critical voltage. `latched` is true if
            // such a time was long enough.
            let (mut since_us, mut latched) = (None, false);
            for (measured, flying, dt_us) in past {
                let before_us = now_us;
                now_us += u64::from(dt_us);
                if let Some(voltage_v) = measured {
                    last = Some((now_us, voltage_v));
                }
                monitor.update(measured.map(|voltage_v| Battery { voltage_v }), flying, dt_us);

                let known = last.filter(|(at_us, _)| now_us - at_us <= 2_000_000);
                prop_assert_eq!(monitor.low(), known.is_none_or(|(_, v)| v.is_nan() || v < 10.5));
                // The present measurement counts for the whole time since the last step.
                let below = known.is_some_and(|(_, v)| v < 9.0);
                if !flying {
                    (since_us, latched) = (None, false);
                } else if below {
                    let began_us = *since_us.get_or_insert(before_us);
                    latched |= now_us - began_us >= 3_000_000;
                } else {
                    since_us = None;
                }
                prop_assert_eq!(monitor.critical(), latched);
            }
        }
    }

    fn run(monitor: &mut BatteryMonitor, voltage_v: Option<f32>, flying: bool, ms: u32) -> (bool, bool) {
        for _ in 0..ms {
            monitor.update(voltage_v.map(|voltage_v| Battery { voltage_v }), flying, 1_000);
        }
        (monitor.low(), monitor.critical())
    }

    #[test]
    fn unknown_and_nan_voltages_count_as_low() {
        let mut monitor = BatteryMonitor::new(10.5, 9.0);
        assert_eq!(run(&mut monitor, None, false, 1), (true, false));
        assert_eq!(run(&mut monitor, Some(10.5), false, 1), (false, false));
        assert_eq!(run(&mut monitor, None, false, 2_000), (false, false));
        assert_eq!(run(&mut monitor, None, false, 1), (true, false));
        assert_eq!(run(&mut monitor, Some(f32::NAN), false, 1), (true, false));
        assert_eq!(run(&mut monitor, Some(10.4), false, 1), (true, false));
    }

    #[test]
    #[cfg_attr(miri, ignore = "27,000 steps")]
    fn critical_needs_three_seconds_and_then_latches() {
        let mut monitor = BatteryMonitor::new(10.5, 9.0);
        assert!(!run(&mut monitor, Some(8.0), true, 2_999).1);
        assert!(!run(&mut monitor, Some(9.5), true, 1).1);
        assert!(!run(&mut monitor, Some(8.0), true, 2_999).1);
        assert!(run(&mut monitor, Some(8.0), true, 1).1);
        assert!(run(&mut monitor, Some(12.0), true, 10_000).1);
        assert!(!run(&mut monitor, Some(12.0), false, 1).1);
        // A voltage that is no longer measured does not become critical.
        run(&mut monitor, Some(8.0), true, 900);
        assert!(!run(&mut monitor, None, true, 10_000).1);
    }
}
