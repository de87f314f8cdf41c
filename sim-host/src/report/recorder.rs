//! Records a flight for its report.

use flight_core::arming::Event;
use flight_core::geometry::{Quaternion, Vec3};

use super::trace::Trace;
use crate::attitude_error::AttitudeError;
use crate::flight::{Observer, StepView};

/// A recorded quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// True roll, pitch, yaw (0 to 2), degrees, without jumps at ±180.
    AttitudeTruth(usize),
    /// Estimated roll, pitch, yaw (0 to 2), degrees, within 180 of the truth.
    AttitudeEstimate(usize),
    /// Error of the estimated heading, degrees.
    HeadingError,
    /// Error of the estimated tilt, degrees.
    InclinationError,
    /// True tilt, degrees.
    TiltTruth,
    /// Estimated tilt, degrees.
    TiltEstimate,
    /// True body rate about x, y, z (0 to 2), °/s.
    RateTruth(usize),
    /// Body rate about x, y, z (0 to 2) after prefilter and gyro zero, as the rate controller gets it, °/s.
    RateFiltered(usize),
    /// ESC pulse of rotors 1 to 4 (0 to 3), µs.
    Pulse(usize),
    /// True speed of rotors 1 to 4 (0 to 3), rad/s.
    Rotor(usize),
    /// Height above the start, m.
    Height,
    /// Height of the pilot's target above the start, at least 0, m.
    HeightTarget,
    /// Distance to the north of the pilot's target, m. Without a pilot, it is measured from the start.
    North,
    /// Distance to the east of the pilot's target, m. Without a pilot, it is measured from the start.
    East,
}

const CHANNELS: usize = 28;

impl Channel {
    fn index(self) -> usize {
        match self {
            Self::AttitudeTruth(axis) => axis,
            Self::AttitudeEstimate(axis) => 3 + axis,
            Self::RateTruth(axis) => 6 + axis,
            Self::RateFiltered(axis) => 9 + axis,
            Self::Pulse(rotor) => 12 + rotor,
            Self::Rotor(rotor) => 16 + rotor,
            Self::HeadingError => 20,
            Self::InclinationError => 21,
            Self::TiltTruth => 22,
            Self::TiltEstimate => 23,
            Self::Height => 24,
            Self::HeightTarget => 25,
            Self::North => 26,
            Self::East => 27,
        }
    }
}

/// Maximum number of recorded events; further events are only counted.
const MAX_EVENTS: usize = 24;

/// An observer that records a flight for its report, in less than 5 MB for any duration.
#[derive(Clone, Debug, Default)]
pub struct Recorder {
    trace: Trace<CHANNELS>,
    /// Position at the first step; `None` before it.
    home: Option<Vec3<f64>>,
    /// True roll, pitch, yaw of the previous step, degrees.
    attitude_deg: [f64; 3],
    events: Vec<(f64, Event)>,
    further_events: usize,
}

impl Recorder {
    /// Creates a recorder for a flight.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns times, s, and values of a channel for a plot: the lowest and the highest value of each interval. A value
    /// that is not finite is a gap.
    pub fn points(&self, channel: Channel) -> Vec<(f64, f64)> {
        self.trace.points(channel.index())
    }

    /// Returns the recorded events of the arm state, with times, s.
    pub fn events(&self) -> &[(f64, Event)] {
        &self.events
    }

    /// Returns the number of events that were not recorded.
    pub fn further_events(&self) -> usize {
        self.further_events
    }
}

impl Observer for Recorder {
    fn step(&mut self, view: &StepView) {
        let time_s = view.time_us as f64 * 1e-6;
        let truth = view.truth;
        let home = *self.home.get_or_insert(truth.position);
        if let Some(event) = view.output.event {
            if self.events.len() < MAX_EVENTS {
                self.events.push((time_s, event));
            } else {
                self.further_events += 1;
            }
        }

        let true_deg = nearest_turn(roll_pitch_yaw_deg(truth.attitude), self.attitude_deg);
        if true_deg.iter().all(|angle| angle.is_finite()) {
            self.attitude_deg = true_deg;
        }
        let estimated_deg = nearest_turn(roll_pitch_yaw_deg(view.estimate), true_deg);
        let error = AttitudeError::between(view.estimate, truth.attitude);
        let place = truth.position - view.target_m.unwrap_or(home);

        let mut row = [f64::NAN; CHANNELS];
        let mut set = |channel: Channel, value: f64| row[channel.index()] = value;
        let rates_true = <[f64; 3]>::from(truth.rates);
        // A gap if the autopilot does not report its rates.
        let rates_filtered =
            view.output.rates_rad_s.map_or([f64::NAN; 3], |rates| <[f32; 3]>::from(rates).map(f64::from));
        for axis in 0..3 {
            set(Channel::AttitudeTruth(axis), true_deg[axis]);
            set(Channel::AttitudeEstimate(axis), estimated_deg[axis]);
            set(Channel::RateTruth(axis), rates_true[axis].to_degrees());
            set(Channel::RateFiltered(axis), rates_filtered[axis].to_degrees());
        }
        for rotor in 0..4 {
            set(Channel::Pulse(rotor), f64::from(view.output.pulses_us[rotor]));
            set(Channel::Rotor(rotor), view.rotors_rad_s[rotor]);
        }
        set(Channel::HeadingError, error.heading_rad.to_degrees());
        set(Channel::InclinationError, error.inclination_rad.to_degrees());
        set(Channel::TiltTruth, tilt_deg(truth.attitude));
        set(Channel::TiltEstimate, tilt_deg(view.estimate));
        set(Channel::Height, home.z - truth.position.z);
        if let Some(target) = view.target_m {
            // During a landing the target is below the ground, so that the vehicle settles on it.
            set(Channel::HeightTarget, (home.z - target.z).max(0.0));
        }
        set(Channel::North, place.x);
        set(Channel::East, place.y);
        self.trace.push(time_s, row);
    }
}

/// Returns roll, pitch and yaw, degrees.
fn roll_pitch_yaw_deg(attitude: Quaternion<f64>) -> [f64; 3] {
    let m = attitude.to_matrix();
    let cos_pitch = libm::sqrt(m[2].y * m[2].y + m[2].z * m[2].z);
    [libm::atan2(m[2].y, m[2].z), libm::atan2(-m[2].x, cos_pitch), libm::atan2(m[1].x, m[0].x)]
        .map(f64::to_degrees)
}

fn tilt_deg(attitude: Quaternion<f64>) -> f64 {
    let down = attitude.down();
    libm::atan2(libm::sqrt(down.x * down.x + down.y * down.y), down.z).to_degrees()
}

/// Adds whole turns to each angle, so that it is within half a turn of `near`, degrees. A line of such angles does not
/// jump at ±180°.
fn nearest_turn(angles: [f64; 3], near: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| angles[k] + 360.0 * libm::rint((near[k] - angles[k]) / 360.0))
}

#[cfg(test)]
mod tests {
    use flight_core::ArmState;

    use super::*;
    use crate::flight::Flight;
    use crate::scene::Scene;

    #[test]
    fn every_channel_has_a_unique_index() {
        let three = (0..3).flat_map(|k| {
            [
                Channel::AttitudeTruth(k),
                Channel::AttitudeEstimate(k),
                Channel::RateTruth(k),
                Channel::RateFiltered(k),
            ]
        });
        let four = (0..4).flat_map(|k| [Channel::Pulse(k), Channel::Rotor(k)]);
        let rest = [
            Channel::HeadingError,
            Channel::InclinationError,
            Channel::TiltTruth,
            Channel::TiltEstimate,
            Channel::Height,
            Channel::HeightTarget,
            Channel::North,
            Channel::East,
        ];
        let mut all: Vec<usize> = three.chain(four).chain(rest).map(Channel::index).collect();
        all.sort_unstable();
        assert_eq!(all, (0..CHANNELS).collect::<Vec<_>>());
    }

    #[test]
    fn angles_are_continuous_past_half_a_turn() {
        let mut near = [0.0; 3];
        for k in 0..800 {
            let heading = f64::from(k);
            let half = (0.5 * heading).to_radians();
            let q = Quaternion::new(libm::cos(half), 0.0, 0.0, libm::sin(half));
            near = nearest_turn(roll_pitch_yaw_deg(q), near);
            assert!((near[2] - heading).abs() < 1e-9 && near[0] == 0.0 && near[1] == 0.0, "{near:?}");
        }
    }

    #[test]
    fn recorded_extremes_match_the_outcome() {
        let scene = Scene::load("hover").unwrap();
        let mut recorder = Recorder::new();
        let outcome = Flight::new(&scene, 3).run(&mut recorder);
        let highest =
            |channel| recorder.points(channel).iter().fold(0.0, |high: f64, point| high.max(point.1));
        assert!((highest(Channel::InclinationError) - outcome.tilt_error_max_deg).abs() < 1e-12);
        assert!((highest(Channel::TiltTruth) - outcome.tilt_max_deg).abs() < 1e-6);
        assert_eq!(highest(Channel::HeightTarget), 2.0);
        let states: Vec<_> = recorder.events().iter().map(|(_, event)| event.to).collect();
        assert_eq!(states, [ArmState::Arming, ArmState::Armed, ArmState::Disarmed]);
        assert_eq!(recorder.further_events(), 0);
    }
}
