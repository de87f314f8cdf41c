//! A flight whose motion is integrated again by other methods.
//!
//! The scene `steps` is flown in closed loop. Between take-off and landing the commands to the rotors are recorded, and
//! the truth at the start. From there every method integrates the same motion with the same commands: 16 s with
//! doublets of 30° in roll and in pitch and a yaw pulse. The equations are written here a second time, independently of
//! [`sim_host::dynamics`]; a test compares the two.
//!
//! The commands, and with them the rotors' accelerations, change every millisecond. So a step cannot be longer, and an
//! adaptive method must restart at each command.

use flight_core::geometry::{Quaternion, Vec3, vec3};

use super::methods::{Fixed, Motion, dormand_prince};
use input::InputError;
use sim_host::dynamics::{GRAVITY, State, VehicleParams};
use sim_host::flight::{Flight, Observer, STEP_US, StepView};
use sim_host::scene::Scene;

/// The scene, and the start and end of the part that is integrated, s.
const SCENE: &str = "steps";
const FROM_S: f64 = 13.0;
const TO_S: f64 = 29.0;
/// Time between two commands, s.
pub const INTERVAL_S: f64 = STEP_US as f64 * 1e-6;
/// Intervals between two comparisons: a second.
const COMPARISON_INTERVALS: usize = 1000;

/// Settings of the two references: tolerance of Dormand-Prince, and steps of RKMK4 in a millisecond.
pub const REFERENCE_TOLERANCE: f64 = 1e-13;
pub const REFERENCE_STEPS: u32 = 8;

/// The commands of a flight, and the state at their start.
pub struct Replay {
    params: VehicleParams,
    drag: Vec3<f64>,
    tau_s: f64,
    start: State,
    rotors: [f64; 4],
    commands: Vec<[f64; 4]>,
    /// States in the flight itself, one a second.
    pub flown: Vec<State>,
}

struct ReplayRecorder {
    max_rad_s: f64,
    replay: Replay,
    steps: usize,
}

impl Observer for ReplayRecorder {
    fn step(&mut self, view: &StepView) {
        let at_s = view.time_us as f64 * 1e-6;
        if !(FROM_S - 1e-9..TO_S - 1e-9).contains(&at_s) {
            // The step after the last one gives the state at the end of the last second.
            if self.steps > 0 && self.replay.flown.len() < self.steps / COMPARISON_INTERVALS {
                self.replay.flown.push(*view.truth);
            }
            return;
        }
        if self.steps == 0 {
            self.replay.start = *view.truth;
            self.replay.rotors = view.rotors_rad_s;
        } else if self.steps.is_multiple_of(COMPARISON_INTERVALS) {
            self.replay.flown.push(*view.truth);
        }
        let speed = |us: f32| self.max_rad_s * ((f64::from(us) - 1000.0) * 1e-3).clamp(0.0, 1.0);
        self.replay.commands.push(view.output.pulses_us.map(speed));
        self.steps += 1;
    }
}

impl Replay {
    /// Flies the scene and records its commands.
    ///
    /// # Errors
    /// The built-in scene cannot be read.
    pub fn fly() -> Result<Self, InputError> {
        let scene = Scene::load(SCENE)?;
        let mut recorder = ReplayRecorder {
            max_rad_s: scene.vehicle.max_rad_s,
            replay: Self {
                params: scene.vehicle,
                drag: scene.vehicle.drag_kg_per_s,
                tau_s: scene.vehicle.lag_s,
                start: State {
                    position: Vec3::ZERO,
                    velocity: Vec3::ZERO,
                    attitude: Quaternion::IDENTITY,
                    rates: Vec3::ZERO,
                },
                rotors: [0.0; 4],
                commands: Vec::new(),
                flown: Vec::new(),
            },
            steps: 0,
        };
        Flight::new(&scene, scene.seed).run(&mut recorder);
        Ok(recorder.replay)
    }

    /// Returns the time that is integrated, s.
    pub fn seconds(&self) -> f64 {
        self.commands.len() as f64 * INTERVAL_S
    }

    /// Advances through all intervals and returns the state at the end of each second. In each interval, time starts at
    /// zero.
    fn through(&self, mut advance: impl FnMut(&Interval, &State) -> State) -> Vec<State> {
        let (mut state, mut rotors) = (self.start, self.rotors);
        let mut compared = Vec::with_capacity(self.commands.len() / COMPARISON_INTERVALS);
        for (k, &wanted) in self.commands.iter().enumerate() {
            let interval = Interval { replay: self, rotors, wanted };
            state = advance(&interval, &state);
            rotors = interval.rotors_at(INTERVAL_S);
            if (k + 1).is_multiple_of(COMPARISON_INTERVALS) {
                compared.push(state);
            }
        }
        compared
    }

    /// Integrates with `steps` steps of a fixed method in each interval.
    pub fn fixed(&self, method: Fixed, steps: u32) -> Vec<State> {
        let h = INTERVAL_S / f64::from(steps);
        self.through(|interval, state| {
            (0..steps).fold(*state, |state, k| method.step(interval, f64::from(k) * h, &state, h))
        })
    }

    /// Integrates with the Dormand-Prince method; also returns the number of evaluations.
    pub fn adaptive(&self, tolerance: f64) -> (Vec<State>, u32) {
        let mut evaluations = 0;
        let compared = self.through(|interval, state| {
            let (state, count) = dormand_prince(interval, (0.0, INTERVAL_S), state, tolerance, INTERVAL_S);
            evaluations += count;
            state
        });
        (compared, evaluations)
    }
}

/// The motion between two commands.
struct Interval<'a> {
    replay: &'a Replay,
    rotors: [f64; 4],
    wanted: [f64; 4],
}

impl Interval<'_> {
    fn rotors_at(&self, t_s: f64) -> [f64; 4] {
        let left = libm::exp(-t_s / self.replay.tau_s);
        std::array::from_fn(|i| self.wanted[i] + (self.rotors[i] - self.wanted[i]) * left)
    }
}

impl Motion for Interval<'_> {
    /// Eqs 8-14 with body rates, as in docs/paper.md, with the signs of eqs 4-7.
    #[inline]
    fn accelerations(&self, t_s: f64, state: &State) -> (Vec3<f64>, Vec3<f64>) {
        let Replay { params: p, drag, .. } = self.replay;
        let [o1, o2, o3, o4] = self.rotors_at(t_s);
        let [f1, f2, f3, f4] = [o1, o2, o3, o4].map(|speed| p.thrust_coefficient * speed * speed);
        let lever = p.right_m;
        let reaction = p.torque_coefficient / p.thrust_coefficient;
        let w = state.rates;
        let spin = p.rotor_inertia_kg_m2 * (o1 - o2 + o3 - o4);
        let gyroscopic = vec3(w.y * spin, -w.x * spin, 0.0);
        let torque =
            vec3(lever * (f1 - f2 - f3 + f4), lever * (f1 + f2 - f3 - f4), reaction * (f1 - f2 + f3 - f4))
                + gyroscopic
                - w.cross(w.scale_by(p.inertia_kg_m2));
        let thrust = state.attitude.rotate(vec3(0.0, 0.0, -(f1 + f2 + f3 + f4)));
        let force = thrust - drag.scale_by(state.velocity);
        let Vec3 { x, y, z } = p.inertia_kg_m2;
        let linear = force * (1.0 / p.mass_kg) + vec3(0.0, 0.0, GRAVITY);
        (linear, vec3(torque.x / x, torque.y / y, torque.z / z))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sim_host::attitude_error::AttitudeError;

    fn apart(a: &[State], b: &[State]) -> (f64, f64) {
        assert_eq!(a.len(), b.len());
        a.iter().zip(b).fold((0.0, 0.0), |(angle, position), (a, b)| {
            let error = AttitudeError::between(a.attitude, b.attitude).total_rad;
            (f64::max(angle, error), f64::max(position, (a.position - b.position).norm()))
        })
    }

    #[test]
    fn equations_match_those_of_the_simulator() {
        let replay = Replay::fly().unwrap();
        assert_eq!((replay.commands.len(), replay.flown.len()), (16_000, 16));
        // The method and the step are the same. What differs is rounding, and the order in which the rotors' lag is
        // computed.
        let (angle, position) = apart(&replay.fixed(Fixed::Rk4, 1), &replay.flown);
        assert!(angle < 1e-10 && position < 1e-9, "{angle} rad, {position} m");
    }

    #[test]
    fn reference_is_confirmed_by_another_method() {
        let replay = Replay::fly().unwrap();
        let (reference, _) = replay.adaptive(REFERENCE_TOLERANCE);
        let (angle, position) = apart(&replay.fixed(Fixed::Rkmk4, REFERENCE_STEPS), &reference);
        assert!(angle < 1e-11 && position < 1e-10, "{angle} rad, {position} m");
    }
}
