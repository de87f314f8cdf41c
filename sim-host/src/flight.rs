//! A flight: the world and the flight controller, step by step, judged on the truth.
//!
//! ```text
//!  t_k:  truth ──► sensors ──► counts ─┐
//!        truth, 0.2 s late ──► pilot ──┴──► Autopilot::step ──► permitted, pulses ──► ESC, rotors
//!  t_k → t_k+1:  vehicle.advance()
//! ```
//!
//! Gyroscope and accelerometer are sampled every step, the magnetometer a hundred times a second, the
//! receiver and the battery fifty times. Time is integer microseconds.
//!
//! Samples of the magnetometer arrive at multiples of 10 ms, readings of the battery at multiples of 20 ms,
//! whatever a scene names: so the board's tasks, which look every 5 and every 20 ms, bring them in the same
//! step. Frames of the receiver may arrive in any step.
//!
//! Who flies is an [`Autopilot`]: the flight code in this process, or the firmware at the far end of a link
//! ([`crate::hil`]).

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
use crate::effects::{OPTIONAL, Snapshot};
use crate::pilot::{FRAME_RATE_HZ, Pilot};
use crate::scene::{DEFAULT_RATE_HZ, MAG_RATE_HZ, Scene};
use crate::sensors::{Sensors, deliver};

pub use autopilot::{Answer, Autopilot};
pub use log::FlightLog;

/// Length of a step, µs.
pub const STEP_US: u64 = 1_000_000 / DEFAULT_RATE_HZ as u64;
const MAG_US: u64 = 1_000_000 / MAG_RATE_HZ as u64;
const RC_US: u64 = 1_000_000 / FRAME_RATE_HZ as u64;
/// Time between two readings of the battery, µs.
const BATTERY_US: u64 = 20_000;

/// A cell of the battery where the scene names no sag, V.
const CELL_V: f64 = 3.7;

/// Touch-down faster than this is a crash, m/s.
const MAX_TOUCH_DOWN_M_S: f64 = 2.0;
/// Touch-down further from level than this is a crash: cos 45°.
const MIN_TOUCH_DOWN_COS: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Further from the pilot's target than this is a crash, m.
const MAX_ASTRAY_M: f64 = 20.0;

/// Why a flight counts as crashed.
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
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::NotFinite, Self::HardTouchDown, Self::TiltedTouchDown, Self::TippedOver, Self::FlownAway];

    /// For programs.
    pub fn name(self) -> &'static str {
        match self {
            Self::NotFinite => "not_finite",
            Self::HardTouchDown => "hard_touch_down",
            Self::TiltedTouchDown => "tilted_touch_down",
            Self::TippedOver => "tipped_over",
            Self::FlownAway => "flown_away",
        }
    }

    /// For people.
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

/// What an observer sees of a step.
#[derive(Debug)]
pub struct StepView<'a> {
    /// Time, µs.
    pub time_us: u64,
    /// The truth at this time.
    pub truth: &'a State,
    /// The truth as the sensors and effects see it.
    pub moment: Snapshot<'a>,
    /// Where the pilot wants the vehicle, north, east, down, m.
    pub target_m: Option<Vec3<f64>>,
    /// True rotor speeds, rad/s.
    pub rotors_rad_s: [f64; 4],
    /// What went into the flight controller.
    pub input: &'a Input,
    /// What came out.
    pub output: &'a Answer,
    /// Estimated attitude.
    pub estimate: Quaternion<f64>,
}

/// Someone who watches a flight: a log, a report, a progress bar.
pub trait Observer {
    /// Called at every step, before the vehicle moves on.
    fn step(&mut self, view: &StepView);
}

/// Nobody watches.
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

/// How a flight went.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Steps flown.
    pub control_steps: u64,
    /// Estimated attitude against the truth, degrees, over the whole flight.
    pub attitude_rmse_deg: f64,
    /// The heading's part of it, degrees.
    pub heading_rmse_deg: f64,
    /// The tilt's part of it, degrees.
    pub inclination_rmse_deg: f64,
    /// Largest error of the estimated tilt, degrees.
    pub tilt_error_max_deg: f64,
    /// Largest true tilt, degrees.
    pub tilt_max_deg: f64,
    /// Largest true distance from the pilot's target while airborne, m.
    pub position_error_max_m: f64,
    /// Why and when it crashed, s.
    pub crash: Option<(Crash, f64)>,
    /// The flight controller's state at the end.
    pub final_state: ArmState,
    /// Hash of the whole trajectory: truth and pulses of every step.
    pub digest: u64,
}

impl Outcome {
    /// Time flown, s.
    pub fn flown_s(&self) -> f64 {
        (self.control_steps * STEP_US) as f64 * 1e-6
    }
}

/// A flight under way: the world, and who flies in it.
pub struct Flight<A = FlightController> {
    world: World,
    autopilot: A,
    steps: u64,
}

/// Everything but the flight controller: vehicle, sensors, pilot, radio link and the judge.
///
/// A step is [`World::sense`], then whatever the flight controller makes of it, then [`World::act`].
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
    judge: Judge,
}

/// Running sums of what an [`Outcome`] says.
#[derive(Default)]
struct Judge {
    rmse: AttitudeRmse,
    inclination_max_rad: f64,
    min_cos_tilt: f64,
    position_error_max_m: f64,
    digest: Xxh3,
}

impl Flight {
    /// The start of a flight of this scene with this seed, flown in this process.
    pub fn new(scene: &Scene, seed: u64) -> Self {
        Self::flown_by(scene.controller(), scene, seed)
    }
}

impl<A: Autopilot<Error = Infallible>> Flight<A> {
    /// Flies to the end, or to the crash.
    pub fn run(self, observer: &mut impl Observer) -> Outcome {
        let (outcome, Ok(())) = self.fly(observer);
        outcome
    }
}

impl<A: Autopilot> Flight<A> {
    /// The start of a flight of this scene with this seed, flown by this autopilot.
    pub fn flown_by(autopilot: A, scene: &Scene, seed: u64) -> Self {
        Self { world: World::new(scene, seed), autopilot, steps: steps_of(scene) }
    }

    /// Flies to the end, to the crash, or until the autopilot fails; then with the outcome up to there.
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

/// How many steps a flight of this scene takes.
pub fn steps_of(scene: &Scene) -> u64 {
    (scene.duration_s * f64::from(DEFAULT_RATE_HZ)).round() as u64
}

impl World {
    /// The world of this scene with this seed, before its first step.
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let step_s = STEP_US as f64 * 1e-6;
        let rate_hz = f64::from(DEFAULT_RATE_HZ);
        let knowledge = scene.pilot_knowledge();
        let (scene, _) = scene.of_run(seed);
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
            judge: Judge { min_cos_tilt: 1.0, ..Judge::default() },
        }
    }

    /// Time of the present step, µs.
    pub fn time_us(&self) -> u64 {
        self.time_us
    }

    /// The vehicle's true state.
    pub fn truth(&self) -> &State {
        self.vehicle.state()
    }

    /// What the flight controller made of `input`: the vehicle moves on by a step. Returns why and when the flight
    /// counts as crashed (s), if it does.
    #[inline(always)]
    pub fn act(
        &mut self,
        input: &Input,
        output: &Answer,
        observer: &mut impl Observer,
    ) -> Option<(Crash, f64)> {
        self.state = output.state;
        let estimate = to_f64(output.attitude);
        self.judge.take(self.vehicle.state(), estimate, output);
        observer.step(&StepView {
            time_us: self.time_us,
            truth: self.vehicle.state(),
            moment: self.vehicle.moment(),
            target_m: self.pilot.as_ref().map(|pilot| pilot.target_m(self.time_us as f64 * 1e-6)),
            rotors_rad_s: self.vehicle.rotors(),
            input,
            output,
            estimate,
        });
        let wanted = self.esc(output);
        self.vehicle.command(wanted);
        self.vehicle.advance();
        self.time_us += STEP_US;
        self.crash().map(|crash| (crash, self.time_us as f64 * 1e-6))
    }

    /// What arrives at the flight controller at this time.
    #[inline(always)]
    pub fn sense(&mut self) -> Input {
        let imu = if OPTIONAL && !self.sensors.imu_is_perfect() {
            self.sensors.imu(&self.vehicle.moment())
        } else {
            Some(self.sensors.perfect_imu(self.vehicle.state().rates, self.vehicle.specific_force()))
        };
        let mag = if self.time_us >= self.next_mag_us {
            self.next_mag_us += MAG_US;
            self.sensors.mag(&self.vehicle.moment())
        } else {
            None
        };
        let mut rc = if self.time_us >= self.next_rc_us {
            self.next_rc_us += RC_US;
            self.rc_frame()
        } else {
            None
        };
        if OPTIONAL && !self.link.is_empty() {
            deliver(&mut self.link, &mut rc);
        }
        let battery = if self.time_us >= self.next_battery_us {
            self.next_battery_us += BATTERY_US;
            match self.vehicle.battery_v() {
                Some(voltage_v) if OPTIONAL => Some(Battery { voltage_v: voltage_v as f32 }),
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

    /// Rotor speeds that the ESCs ask for: the inverse of flight-core's pulse map, or none at all without a
    /// permit.
    #[inline(always)]
    fn esc(&self, output: &Answer) -> [f64; 4] {
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
        let astray = (state.position - pilot.target_m(self.time_us as f64 * 1e-6)).norm();
        self.judge.position_error_max_m = self.judge.position_error_max_m.max(astray);
        (astray > MAX_ASTRAY_M).then_some(Crash::FlownAway)
    }

    /// How the flight went, after so many steps.
    pub fn outcome(&self, control_steps: u64, crash: Option<(Crash, f64)>) -> Outcome {
        let judge = &self.judge;
        // Without a step, which is a flight whose autopilot failed at once, there is no error either.
        let none = AttitudeError { total_rad: 0.0, heading_rad: 0.0, inclination_rad: 0.0 };
        let rmse = judge.rmse.root().unwrap_or(none);
        Outcome {
            control_steps,
            attitude_rmse_deg: rmse.total_rad.to_degrees(),
            heading_rmse_deg: rmse.heading_rad.to_degrees(),
            inclination_rmse_deg: rmse.inclination_rad.to_degrees(),
            tilt_error_max_deg: judge.inclination_max_rad.to_degrees(),
            tilt_max_deg: libm::acos(judge.min_cos_tilt.clamp(-1.0, 1.0)).to_degrees(),
            position_error_max_m: judge.position_error_max_m,
            crash,
            final_state: self.state,
            digest: judge.digest.digest(),
        }
    }
}

impl Judge {
    #[inline(always)]
    fn take(&mut self, truth: &State, estimate: Quaternion<f64>, output: &Answer) {
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
