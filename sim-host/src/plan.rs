//! The command `plan`: lists the effects that a scene simulates, in order, and measures the time of each.
//!
//! The time of an effect is measured by applying it alone to a vehicle in flight, as often as one step of a flight does. The
//! shortest of several batches counts, because other work of the machine only makes a batch longer.

use std::hint::black_box;
use std::time::Instant;

use flight_core::geometry::{Quaternion, Vec3, vec3};
use flight_core::sample::{ImuSample, LinkStatus, MagSample, RcFrame};

use crate::dynamics::{GRAVITY, State};
use crate::effects::Snapshot;
use crate::effects::delivery::{Delivery, ImuEffect, MagEffect};
use crate::effects::vehicle::{BodyEffect as _, Load, Point, Stage, VehicleEffect};
use crate::scene::{DEFAULT_RATE_HZ, MAG_RATE_HZ, Scene};
use crate::sensors::Sensor;

/// An effect and its computing time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Full name of the effect.
    pub name: &'static str,
    /// Mean time that the effect adds to a step of the flight, ns.
    pub ns_per_step: f64,
}

/// Calls in a batch.
const CALLS: u32 = 20_000;
/// Batches, of which the shortest counts.
const BATCHES: u32 = 7;

/// Evaluations of the derivative in a step of the integration: three stages, and one at the end of the step.
const STAGES: f64 = 4.0;

/// State of the measurement: all parts are in motion, so that no effect takes a shortcut.
const IN_FLIGHT: State = State {
    position: vec3(1.0, -2.0, -0.4),
    velocity: vec3(3.0, -1.0, 0.5),
    attitude: Quaternion::new(0.982, 0.1, -0.12, 0.1),
    rates: vec3(0.5, -0.8, 0.3),
};

/// Rotor speeds in flight, rad/s, and their rates of change, rad/s².
const ROTORS: [f64; 4] = [220.0, 231.0, 226.0, 224.0];
const ROTOR_ACCELERATIONS: [f64; 4] = [100.0, -50.0, 30.0, -80.0];

/// Returns the mean time of a call, ns, in the shortest batch.
fn time(mut call: impl FnMut(u32)) -> f64 {
    let batch = |call: &mut dyn FnMut(u32)| {
        let start = Instant::now();
        (0..CALLS).for_each(&mut *call);
        start.elapsed().as_nanos() as f64 / f64::from(CALLS)
    };
    (0..BATCHES).map(|_| batch(&mut call)).fold(f64::INFINITY, f64::min)
}

/// Returns the truth in flight, `k` milliseconds after the start.
fn moment(k: u32) -> Snapshot<'static> {
    Snapshot {
        time_s: f64::from(k) * 1e-3,
        state: &IN_FLIGHT,
        specific_force: vec3(0.5, -0.4, -GRAVITY),
        angular_acceleration: vec3(3.0, -2.0, 1.0),
        rotors: ROTORS,
    }
}

/// Measures the effects of a scene, in the order in which they are applied.
pub fn measure(scene: &Scene) -> Vec<Cost> {
    let scene = &*scene.for_run(scene.seed).0;
    let (seed, rate_hz, mag_rate_hz) = (scene.seed, f64::from(DEFAULT_RATE_HZ), f64::from(MAG_RATE_HZ));
    let mut costs = Vec::new();
    let mut note = |name, ns_per_step| costs.push(Cost { name, ns_per_step });
    for (name, mut effect) in scene.link(seed, rate_hz) {
        let frame =
            RcFrame { channels: [992; 4], arm_switch: 992, mode_switch: 992, status: LinkStatus::Good };
        // A frame every twentieth step.
        note(name, delivery(&mut *effect, |k| k.is_multiple_of(20).then_some(frame)));
    }
    for (name, effect) in scene.vehicle_effects(seed, rate_hz) {
        note(name, vehicle(effect));
    }
    for (sensor, share) in [
        (&mut scene.gyro(seed, rate_hz), 1.0),
        (&mut scene.accel(seed, rate_hz), 1.0),
        (&mut scene.mag(seed, mag_rate_hz), mag_rate_hz / rate_hz),
    ] {
        readings(sensor, share).for_each(|one| note(one.name, one.ns_per_step));
    }
    for (name, effect) in scene.mag_effects(seed, mag_rate_hz) {
        if let MagEffect::Delivery(mut effect) = effect {
            let ns = delivery(&mut *effect, |_| Some(MagSample { counts: [750, 80, 1230] }));
            note(name, ns * mag_rate_hz / rate_hz);
        }
    }
    for (name, effect) in scene.imu_effects(seed, rate_hz) {
        match effect {
            ImuEffect::Sampling(mut jitter) => note(
                name,
                cost(|k, with| {
                    let (at, mut state) = (moment(k), IN_FLIGHT);
                    black_box(if with { jitter.displaced(&at, &mut state) } else { at });
                }),
            ),
            ImuEffect::Delivery(mut effect) => {
                let sample = ImuSample { gyro: [30, -20, 10], accel: [50, -40, -2048] };
                note(name, delivery(&mut *effect, |_| Some(sample)));
            }
        }
    }
    costs
}

/// Measures the time that an effect on a stream of samples takes in a step, ns.
fn delivery<T>(effect: &mut dyn Delivery<T>, stream: impl Fn(u32) -> Option<T>) -> f64 {
    cost(|k, with| {
        let sample = black_box(stream(k));
        black_box(if with { effect.step(sample) } else { sample });
    })
}

/// Measures the time of a call with the effect, and subtracts the time of the same call without it, ns.
fn cost(mut call: impl FnMut(u32, bool)) -> f64 {
    let with = time(|k| call(k, black_box(true)));
    let without = time(|k| call(k, black_box(false)));
    (with - without).max(0.0)
}

/// Measures the effects of a sensor; `share` is its rate as a share of the rate of the steps.
fn readings(sensor: &mut Sensor, share: f64) -> impl Iterator<Item = Cost> {
    sensor.effects_mut().iter_mut().map(move |(name, effect)| {
        let ns = cost(|k, with| {
            let (mut reading, at) = (black_box(vec3(0.1, 0.2, -9.0)), moment(k));
            if with {
                effect.apply_to(&mut reading, &at);
            }
            black_box((reading, at.time_s));
        });
        Cost { name, ns_per_step: ns * share }
    })
}

/// Measures the time that an effect on the vehicle takes in a step, ns.
fn vehicle(effect: VehicleEffect) -> f64 {
    let matrix = IN_FLIGHT.attitude.to_matrix();
    let stage = Stage {
        state: &IN_FLIGHT,
        matrix: &matrix,
        rotors: ROTORS,
        rotor_accelerations: ROTOR_ACCELERATIONS,
        airspeed: IN_FLIGHT.velocity,
    };
    match effect {
        VehicleEffect::Command(mut effect) => cost(|k, with| {
            let (mut wanted, at) = (black_box(ROTORS), moment(k));
            if with {
                effect.apply(&mut wanted, &at);
            }
            black_box((wanted, at.time_s));
        }),
        // This effect is applied twice in a step, in the middle and at the end.
        VehicleEffect::Lag(lag) => {
            2.0 * cost(|_, with| {
                let mut rotors = black_box(ROTORS);
                if with {
                    rotors = rotors.map(|speed| lag.at(Point::Middle, speed, 225.0));
                }
                black_box(rotors);
            })
        }
        VehicleEffect::Wind(mut effect) => cost(|k, with| {
            let (mut wind, at) = (black_box(Vec3::ZERO), moment(k));
            if with {
                wind += effect.velocity(&at);
            }
            black_box((wind, at.time_s));
        }),
        VehicleEffect::Thrust(effect) => {
            STAGES
                * cost(|_, with| {
                    let mut thrusts = black_box([1.6; 4]);
                    if with {
                        effect.apply(&mut thrusts, &stage);
                    }
                    black_box(thrusts);
                })
        }
        VehicleEffect::Body(effect) => {
            STAGES
                * cost(|_, with| {
                    let mut load = black_box(Load { force: Vec3::ZERO, torque: Vec3::ZERO });
                    if with {
                        effect.apply(&mut load, &[1.6; 4], &stage);
                    }
                    black_box(load);
                })
        }
    }
}
