//! A flight: the simulated world and the flight controller, step by step, evaluated against the truth.
//!
//! ```text
//!  t_k:  truth ──► sensors ──► counts ─┐
//!        truth, 0.2 s late ──► pilot ──┴──► Autopilot::step ──► permitted, pulses ──► ESC, rotors
//!  t_k → t_k+1:  vehicle.advance()
//! ```
//!
//! Gyroscope and accelerometer are sampled at every step, the magnetometer at 100 Hz, the receiver and the battery at
//! 50 Hz. Time is in integer microseconds.
//!
//! Samples of the magnetometer arrive at multiples of 10 ms, readings of the battery at multiples of 20 ms, in every
//! scene. So the board's tasks, which poll every 5 ms and every 20 ms, deliver them in the same step. Frames of the
//! receiver may arrive in any step.
//!
//! The vehicle is flown by an [`Autopilot`]: the flight code in this process, or the firmware at the other end of a
//! link ([`crate::hil`]).

mod autopilot;
mod log;
pub mod summary;

use std::convert::Infallible;

use flight_core::geometry::{Quaternion, Vec3, vec3};
use flight_core::sample::{Battery, Health, Input, RcFrame};
use flight_core::{ArmState, FlightController};
use xxhash_rust::xxh3::Xxh3;

use crate::attitude_error::{AttitudeError, AttitudeRmse};
use crate::dynamics::{State, Vehicle};
use crate::effects::delivery::BoxedDelivery;
use crate::effects::{OPTIONAL_EFFECTS, Snapshot};
use crate::pilot::{FRAME_RATE_HZ, Pilot};
use crate::scene::{DEFAULT_RATE_HZ, MAG_RATE_HZ, Scene};
use crate::sensors::{Sensors, deliver};

pub use autopilot::{Autopilot, AutopilotOutput};
pub use log::FlightLog;

/// Length of a step, µs.
pub const STEP_US: u64 = 1_000_000 / DEFAULT_RATE_HZ as u64;
const MAG_US: u64 = 1_000_000 / MAG_RATE_HZ as u64;
const RC_US: u64 = 1_000_000 / FRAME_RATE_HZ as u64;
/// Time between two readings of the battery, µs.
const BATTERY_US: u64 = 20_000;

/// Voltage of a battery cell in a scene without the effect `battery_sag`, V.
const CELL_V: f64 = 3.7;

/// Maximum speed of a touch-down, m/s; a faster one is a crash.
const MAX_TOUCH_DOWN_M_S: f64 = 2.0;
/// Cosine of the maximum tilt at touch-down, 45°; a larger tilt is a crash.
const MIN_TOUCH_DOWN_COS: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Maximum distance from the pilot's target, m; a larger one is a crash.
const MAX_DISTANCE_M: f64 = 20.0;

/// The cause of a crash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Crash {
    /// A number of the state is not finite.
    NotFinite,
    /// Touch-down above 2 m/s.
    HardTouchDown,
    /// Touch-down at more than 45°.
    TiltedTouchDown,
    /// Tilt above 90° in a scene that is not aerobatic.
    TippedOver,
    /// More than 20 m from the pilot's target.
    FlownAway,
}

impl Crash {
    /// All causes.
    pub const ALL: [Self; 5] =
        [Self::NotFinite, Self::HardTouchDown, Self::TiltedTouchDown, Self::TippedOver, Self::FlownAway];

    /// Returns the name for programs.
    pub fn name(self) -> &'static str {
        match self {
            Self::NotFinite => "not_finite",
            Self::HardTouchDown => "hard_touch_down",
            Self::TiltedTouchDown => "tilted_touch_down",
            Self::TippedOver => "tipped_over",
            Self::FlownAway => "flown_away",
        }
    }

    /// Returns the description for users.
    pub fn text(self) -> &'static str {
        match self {
            Self::NotFinite => "a number of the state is not finite",
            Self::HardTouchDown => "touch-down above 2 m/s",
            Self::TiltedTouchDown => "touch-down at more than 45°",
            Self::TippedOver => "tilt above 90°",
            Self::FlownAway => "more than 20 m from the pilot's target",
        }
    }
}

/// The data of a step, for observers.
#[derive(Debug)]
pub struct StepView<'a> {
    /// Time, µs.
    pub time_us: u64,
    /// The truth at this time.
    pub truth: &'a State,
    /// The truth as input of sensors and effects.
    pub snapshot: Snapshot<'a>,
    /// The pilot's target, north, east, down, m.
    pub target_m: Option<Vec3<f64>>,
    /// True rotor speeds, rad/s.
    pub rotors_rad_s: [f64; 4],
    /// Input of the flight controller.
    pub input: &'a Input,
    /// Output of the flight controller.
    pub output: &'a AutopilotOutput,
    /// Estimated attitude.
    pub estimate: Quaternion<f64>,
}

/// An observer of a flight, such as a log, a report or a progress bar.
pub trait Observer {
    /// Receives a step. Called at every step, before the vehicle advances.
    fn step(&mut self, view: &StepView);
}

/// No observer.
impl Observer for () {
    fn step(&mut self, _: &StepView) {}
}

impl<A: Observer, B: Observer> Observer for (A, B) {
    fn step(&mut self, view: &StepView) {
        self.0.step(view);
        self.1.step(view);
    }
}

impl<T: Observer> Observer for Option<T> {
    fn step(&mut self, view: &StepView) {
        if let Some(observer) = self {
            observer.step(view);
        }
    }
}

impl<T: Observer> Observer for &mut T {
    fn step(&mut self, view: &StepView) {
        (*self).step(view);
    }
}

/// The result of a flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Steps flown.
    pub control_steps: u64,
    /// RMSE of the estimated attitude over the whole flight, degrees.
    pub attitude_rmse_deg: f64,
    /// RMSE of the estimated heading, degrees.
    pub heading_rmse_deg: f64,
    /// RMSE of the estimated tilt, degrees.
    pub inclination_rmse_deg: f64,
    /// Largest error of the estimated tilt, degrees.
    pub tilt_error_max_deg: f64,
    /// Largest true tilt, degrees.
    pub tilt_max_deg: f64,
    /// Largest true distance from the pilot's target while airborne, m.
    pub position_error_max_m: f64,
    /// Cause and time (s) of the crash, if the flight crashed.
    pub crash: Option<(Crash, f64)>,
    /// Arm state at the end.
    pub final_state: ArmState,
    /// Hash of the whole trajectory: truth and pulses of every step.
    pub digest: u64,
}

impl Outcome {
    /// Returns the duration flown, s.
    pub fn flown_s(&self) -> f64 {
        (self.control_steps * STEP_US) as f64 * 1e-6
    }
}

/// A flight in progress: the world and the autopilot.
pub struct Flight<A = FlightController> {
    world: World,
    autopilot: A,
    steps: u64,
}

/// Everything except the flight controller: vehicle, sensors, pilot, radio link and statistics.
///
/// A step is [`World::sense`], then a step of the flight controller, then [`World::act`].
pub struct World {
    vehicle: Vehicle,
    sensors: Sensors,
    pilot: Option<Pilot>,
    link: Vec<BoxedDelivery<RcFrame>>,
    state: ArmState,
    max_rotor_rad_s: f64,
    aerobatic: bool,
    time_us: u64,
    next_mag_us: u64,
    next_rc_us: u64,
    supply: Battery,
    next_battery_us: u64,
    airborne: bool,
    statistics: Statistics,
}

/// Running statistics for the [`Outcome`].
#[derive(Default)]
struct Statistics {
    rmse: AttitudeRmse,
    inclination_max_rad: f64,
    min_cos_tilt: f64,
    position_error_max_m: f64,
    digest: Xxh3,
}

impl Flight {
    /// Prepares a flight of this scene with this seed, with the flight code in this process.
    pub fn new(scene: &Scene, seed: u64) -> Self {
        Self::with_autopilot(scene.controller(), scene, seed)
    }
}

impl<A: Autopilot<Error = Infallible>> Flight<A> {
    /// Flies to the end or to a crash.
    pub fn run(self, observer: &mut impl Observer) -> Outcome {
        let (outcome, Ok(())) = self.fly(observer);
        outcome
    }
}

impl<A: Autopilot> Flight<A> {
    /// Prepares a flight of this scene with this seed and this autopilot.
    pub fn with_autopilot(autopilot: A, scene: &Scene, seed: u64) -> Self {
        Self { world: World::new(scene, seed), autopilot, steps: step_count(scene.duration_s) }
    }

    /// Returns the sensors, to add effects that no scene can name: see the example `own_effect`.
    pub fn sensors_mut(&mut self) -> &mut Sensors {
        &mut self.world.sensors
    }

    /// Flies to the end, to a crash, or until the autopilot fails. After a failure the outcome covers the steps before
    /// it.
    pub fn fly(mut self, observer: &mut impl Observer) -> (Outcome, Result<(), A::Error>) {
        for step in 0..self.steps {
            match self.step(observer) {
                Ok(None) => {}
                Ok(Some(crash)) => return (self.world.outcome(step + 1, Some(crash)), Ok(())),
                Err(error) => return (self.world.outcome(step, None), Err(error)),
            }
        }
        (self.world.outcome(self.steps, None), Ok(()))
    }

    #[inline(always)]
    fn step(&mut self, observer: &mut impl Observer) -> Result<Option<(Crash, f64)>, A::Error> {
        let input = self.world.sense();
        let answer = self.autopilot.step(&input)?;
        Ok(self.world.act(&input, &answer, observer))
    }
}

/// Returns the number of steps of a flight of this length.
pub fn step_count(duration_s: f64) -> u64 {
    (duration_s * f64::from(DEFAULT_RATE_HZ)).round() as u64
}

impl World {
    /// Creates the world of this scene with this seed, before its first step.
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let step_s = STEP_US as f64 * 1e-6;
        let rate_hz = f64::from(DEFAULT_RATE_HZ);
        let knowledge = scene.pilot_knowledge();
        let (scene, _) = scene.for_run(seed);
        let vehicle =
            Vehicle::at_rest(scene.vehicle, scene.mount(), scene.vehicle_effects(seed, rate_hz), step_s);
        let pilot = scene.pilot.as_ref().map(|p| Pilot::new(p, scene.duration_s, knowledge, vehicle.state()));
        Self {
            vehicle,
            sensors: scene.sensors(seed, rate_hz, f64::from(MAG_RATE_HZ)),
            pilot,
            link: scene.link(seed, rate_hz).into_iter().map(|(_, effect)| effect).collect(),
            state: ArmState::default(),
            max_rotor_rad_s: scene.vehicle.max_rad_s,
            aerobatic: scene.aerobatic,
            time_us: 0,
            next_mag_us: 0,
            next_rc_us: 0,
            supply: Battery { voltage_v: (CELL_V * f64::from(scene.design.cells)) as f32 },
            next_battery_us: 0,
            airborne: false,
            statistics: Statistics { min_cos_tilt: 1.0, ..Statistics::default() },
        }
    }

    /// Returns the time of the present step, µs.
    pub fn time_us(&self) -> u64 {
        self.time_us
    }

    /// Returns the vehicle's true state.
    pub fn truth(&self) -> &State {
        self.vehicle.state()
    }

    /// Applies the flight controller's `output` for `input`, and advances the vehicle by a step. Returns cause and time
    /// (s) of a crash.
    #[inline(always)]
    pub fn act(
        &mut self,
        input: &Input,
        output: &AutopilotOutput,
        observer: &mut impl Observer,
    ) -> Option<(Crash, f64)> {
        self.state = output.state;
        let estimate = to_f64(output.attitude);
        self.statistics.add(self.vehicle.state(), estimate, output);
        observer.step(&StepView {
            time_us: self.time_us,
            truth: self.vehicle.state(),
            snapshot: self.vehicle.snapshot(),
            target_m: self.pilot.as_ref().map(|pilot| pilot.target_m(self.time_us as f64 * 1e-6)),
            rotors_rad_s: self.vehicle.rotors(),
            input,
            output,
            estimate,
        });
        let wanted = self.commanded_speeds(output);
        self.vehicle.command(wanted);
        self.vehicle.advance();
        self.time_us += STEP_US;
        self.crash().map(|crash| (crash, self.time_us as f64 * 1e-6))
    }

    /// Returns the input of the flight controller at this time.
    #[inline(always)]
    pub fn sense(&mut self) -> Input {
        let imu = if OPTIONAL_EFFECTS && !self.sensors.imu_is_perfect() {
            self.sensors.imu(&self.vehicle.snapshot())
        } else {
            Some(self.sensors.perfect_imu(self.vehicle.state().rates, self.vehicle.specific_force()))
        };
        let mag = if self.time_us >= self.next_mag_us {
            self.next_mag_us += MAG_US;
            self.sensors.mag(&self.vehicle.snapshot())
        } else {
            None
        };
        let mut rc = if self.time_us >= self.next_rc_us {
            self.next_rc_us += RC_US;
            self.rc_frame()
        } else {
            None
        };
        if OPTIONAL_EFFECTS && !self.link.is_empty() {
            deliver(&mut self.link, &mut rc);
        }
        let battery = if self.time_us >= self.next_battery_us {
            self.next_battery_us += BATTERY_US;
            match self.vehicle.battery_v() {
                Some(voltage_v) if OPTIONAL_EFFECTS => Some(Battery { voltage_v: voltage_v as f32 }),
                _ => Some(self.supply),
            }
        } else {
            None
        };
        Input { time_us: self.time_us, imu, mag, rc, battery, bench: None, health: Health::default() }
    }

    fn rc_frame(&mut self) -> Option<RcFrame> {
        let t_s = self.time_us as f64 * 1e-6;
        self.pilot.as_mut().map(|pilot| pilot.frame(t_s, self.vehicle.state()))
    }

    /// Returns the rotor speeds that the ESCs command, rad/s: the inverse of flight-core's pulse map, or zero without a
    /// permit.
    #[inline(always)]
    fn commanded_speeds(&self, output: &AutopilotOutput) -> [f64; 4] {
        if !output.driven {
            return [0.0; 4];
        }
        output.pulses_us.map(|us| self.max_rotor_rad_s * ((f64::from(us) - 1000.0) * 1e-3).clamp(0.0, 1.0))
    }

    #[inline(always)]
    fn crash(&mut self) -> Option<Crash> {
        let state = self.vehicle.state();
        if !state.is_finite() {
            return Some(Crash::NotFinite);
        }
        let was_airborne = self.airborne;
        self.airborne = !self.vehicle.touches_ground();
        let cos_tilt = state.cos_tilt();
        if was_airborne && !self.airborne {
            if state.velocity.norm() > MAX_TOUCH_DOWN_M_S {
                return Some(Crash::HardTouchDown);
            }
            if cos_tilt < MIN_TOUCH_DOWN_COS {
                return Some(Crash::TiltedTouchDown);
            }
        }
        if !self.aerobatic && cos_tilt < 0.0 {
            return Some(Crash::TippedOver);
        }
        let pilot = self.pilot.as_ref()?;
        if !self.airborne || self.vehicle.is_held() {
            return None;
        }
        // The distance of a state that is still finite may not be.
        let distance_m = (state.position - pilot.target_m(self.time_us as f64 * 1e-6)).norm();
        self.statistics.position_error_max_m =
            self.statistics.position_error_max_m.max(distance_m.min(f64::MAX));
        (distance_m > MAX_DISTANCE_M).then_some(Crash::FlownAway)
    }

    /// Returns the outcome of the flight after this many steps.
    pub fn outcome(&self, control_steps: u64, crash: Option<(Crash, f64)>) -> Outcome {
        let statistics = &self.statistics;
        // If the autopilot failed in its first step, there is no error yet.
        let none = AttitudeError { total_rad: 0.0, heading_rad: 0.0, inclination_rad: 0.0 };
        let rmse = statistics.rmse.root().unwrap_or(none);
        Outcome {
            control_steps,
            attitude_rmse_deg: rmse.total_rad.to_degrees(),
            heading_rmse_deg: rmse.heading_rad.to_degrees(),
            inclination_rmse_deg: rmse.inclination_rad.to_degrees(),
            tilt_error_max_deg: statistics.inclination_max_rad.to_degrees(),
            tilt_max_deg: libm::acos(statistics.min_cos_tilt.clamp(-1.0, 1.0)).to_degrees(),
            position_error_max_m: statistics.position_error_max_m,
            crash,
            final_state: self.state,
            digest: statistics.digest.digest(),
        }
    }
}

impl Statistics {
    #[inline(always)]
    fn add(&mut self, truth: &State, estimate: Quaternion<f64>, output: &AutopilotOutput) {
        let error = AttitudeError::between(estimate, truth.attitude);
        self.rmse.add(error);
        self.inclination_max_rad = self.inclination_max_rad.max(error.inclination_rad);
        self.min_cos_tilt = self.min_cos_tilt.min(truth.cos_tilt());

        let mut bytes = [0; 13 * 8 + 4 * 4];
        let [w, x, y, z] = truth.attitude.to_array();
        let vectors = [truth.position, truth.velocity, truth.rates];
        let numbers = vectors.into_iter().flat_map(<[f64; 3]>::from).chain([w, x, y, z]);
        for (slot, number) in bytes.as_chunks_mut().0.iter_mut().zip(numbers) {
            *slot = number.to_bits().to_le_bytes();
        }
        for (slot, pulse) in bytes[13 * 8..].as_chunks_mut().0.iter_mut().zip(output.pulses_us) {
            *slot = pulse.to_bits().to_le_bytes();
        }
        self.digest.update(&bytes);
    }
}

fn to_f64(q: Quaternion<f32>) -> Quaternion<f64> {
    let Vec3 { x, y, z } = q.v;
    Quaternion { w: f64::from(q.w), v: vec3(f64::from(x), f64::from(y), f64::from(z)) }
}
