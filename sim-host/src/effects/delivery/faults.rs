//! Faults of a sensor or its bus: for some time, the delivered samples differ from the converted ones.

use super::{Delivery, Window};

/// A function that selects the counts of one sensor in a sample.
pub type Counts<T> = fn(&mut T) -> &mut [i16; 3];

/// A fault that delivers no sample.
#[derive(Clone, Copy, Debug)]
pub struct Dead(pub Window);

impl<T> Delivery<T> for Dead {
    fn pass(&mut self, sample: &mut Option<T>) {
        // This call counts the steps, so it runs at every step, with or without a sample.
        if self.0.next_is_inside() {
            *sample = None;
        }
    }
}

/// A fault that replaces every sample by the chip's code for invalid data.
#[derive(Clone, Copy, Debug)]
pub struct InvalidCode<T> {
    /// The steps in which the fault acts.
    pub window: Window,
    /// The sample with 0x8000 on all axes.
    pub sample: T,
}

impl<T: Copy + Send> Delivery<T> for InvalidCode<T> {
    fn pass(&mut self, sample: &mut Option<T>) {
        if self.window.next_is_inside()
            && let Some(sample) = sample
        {
            *sample = self.sample;
        }
    }
}

/// A fault in which one axis keeps the count that it had when the fault began.
#[derive(Clone, Copy, Debug)]
pub struct StuckAxis<T> {
    /// The steps in which the fault acts.
    pub window: Window,
    /// The sensor whose counts are affected.
    pub counts: Counts<T>,
    /// The axis: 0 for x, 1 for y, 2 for z.
    pub axis: usize,
    /// The count that is held; `None` before the fault begins.
    pub held: Option<i16>,
}

impl<T: Send> Delivery<T> for StuckAxis<T> {
    fn pass(&mut self, sample: &mut Option<T>) {
        if self.window.next_is_inside()
            && let Some(sample) = sample
        {
            let count = &mut (self.counts)(sample)[self.axis];
            *count = *self.held.get_or_insert(*count);
        }
    }
}

/// A fault that adds a constant to one axis. The sum saturates at 16 bits.
#[derive(Clone, Copy, Debug)]
pub struct Spike<T> {
    /// The steps in which the fault acts.
    pub window: Window,
    /// The sensor whose counts are affected.
    pub counts: Counts<T>,
    /// The axis: 0 for x, 1 for y, 2 for z.
    pub axis: usize,
    /// Counts to add.
    pub by: i16,
}

impl<T: Send> Delivery<T> for Spike<T> {
    fn pass(&mut self, sample: &mut Option<T>) {
        if self.window.next_is_inside()
            && let Some(sample) = sample
        {
            let count = &mut (self.counts)(sample)[self.axis];
            *count = count.saturating_add(self.by);
        }
    }
}

/// A fault that repeats the last sample before it, like a buffer that is no longer filled.
#[derive(Clone, Copy, Debug)]
pub struct RepeatedSample<T> {
    /// The steps in which the fault acts.
    pub window: Window,
    /// The last sample before the fault.
    pub last: Option<T>,
}

impl<T: Copy + Send> Delivery<T> for RepeatedSample<T> {
    fn pass(&mut self, sample: &mut Option<T>) {
        let inside = self.window.next_is_inside();
        let Some(sample) = sample else { return };
        match self.last {
            Some(last) if inside => *sample = last,
            _ => self.last = Some(*sample),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flight_core::sample::ImuSample;

    /// Returns the sample of step k. All its counts are different, and they differ at every step.
    fn sample(k: i16) -> ImuSample {
        ImuSample { gyro: [k, 100 + k, 200 + k], accel: [-k, -100 - k, -200 - k] }
    }

    /// Passes twenty samples through a fault that lasts from step 5 to 9. Returns the steps whose output differs.
    fn changed(mut fault: impl Delivery<ImuSample>) -> Vec<(i16, Option<ImuSample>)> {
        (0..20)
            .map(|k| (k, fault.step(Some(sample(k)))))
            .filter(|(k, got)| *got != Some(sample(*k)))
            .collect()
    }

    fn window() -> Window {
        Window::new(0.005, Some(0.005), 1000.0)
    }

    #[test]
    fn dead_sensor_delivers_nothing() {
        assert_eq!(changed(Dead(window())), [5, 6, 7, 8, 9].map(|k| (k, None)));
    }

    #[test]
    fn steps_without_a_sample_count() {
        // There is a sample at every second step, from 0 on. The sensor is dead from step 5 to step 9.
        let mut dead = Dead(window());
        let came = (0..20).filter(|k| dead.step((k % 2 == 0).then_some(*k)).is_some());
        assert_eq!(came.collect::<Vec<_>>(), [0, 2, 4, 10, 12, 14, 16, 18]);
    }

    #[test]
    fn invalid_code_is_on_all_axes() {
        let invalid = ImuSample { gyro: [i16::MIN; 3], accel: [i16::MIN; 3] };
        let fault = InvalidCode { window: window(), sample: invalid };
        assert_eq!(changed(fault), [5, 6, 7, 8, 9].map(|k| (k, Some(invalid))));
    }

    #[test]
    fn stuck_axis_keeps_its_first_count() {
        let fault =
            StuckAxis { window: window(), counts: |s: &mut ImuSample| &mut s.gyro, axis: 1, held: None };
        // At step 5 the held count is still the true one.
        let stuck = |k: i16| ImuSample { gyro: [k, 105, 200 + k], ..sample(k) };
        assert_eq!(changed(fault), [6, 7, 8, 9].map(|k| (k, Some(stuck(k)))));
    }

    #[test]
    fn spike_adds_its_counts_and_saturates() {
        let spike = |by| Spike { window: window(), counts: |s: &mut ImuSample| &mut s.accel, axis: 2, by };
        let raised = |k: i16| ImuSample { accel: [-k, -100 - k, 800 - k], ..sample(k) };
        assert_eq!(changed(spike(1000)), [5, 6, 7, 8, 9].map(|k| (k, Some(raised(k)))));
        assert_eq!(changed(spike(-32_700))[0].1.unwrap().accel[2], i16::MIN);
    }

    #[test]
    fn last_good_sample_repeats() {
        let fault = RepeatedSample { window: window(), last: None };
        assert_eq!(changed(fault), [5, 6, 7, 8, 9].map(|k| (k, Some(sample(4)))));
    }
}
