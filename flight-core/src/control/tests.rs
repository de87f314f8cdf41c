//! Tests of the controller: signs and limits in single cases, and the whole against a second implementation.

use super::*;
use crate::geometry::Quaternion;
use core::f64::consts::PI;
use proptest::prelude::*;

const INERTIA: Vec3<f32> = vec3(7.5e-3, 7.5e-3, 1.3e-2);
const FREE: Saturation = Saturation { roll_pitch: false, yaw: false };

fn controller(sticks: Sticks) -> Controller {
    let mut c = Controller::new(&ControlParams::OS4, INERTIA).unwrap();
    c.set_sticks(&sticks, FlightMode::Angle);
    c
}

const CENTRED: Sticks = Sticks { throttle: 0.5, roll: 0.0, pitch: 0.0, yaw: 0.0 };

#[test]
fn torque_has_the_sign_of_the_stick() {
    for (sticks, axis) in [
        (Sticks { roll: 0.5, ..CENTRED }, vec3(1.0, 0.0, 0.0)),
        (Sticks { pitch: 0.5, ..CENTRED }, vec3(0.0, -1.0, 0.0)), // stick forward, nose down
        (Sticks { yaw: 0.5, ..CENTRED }, vec3(0.0, 0.0, 1.0)),
    ] {
        let torque = controller(sticks).step(Vec3::Z, 0.0, Vec3::ZERO, FREE, 1e-3);
        assert!(torque.dot(axis) > 0.9 * torque.norm() && torque.norm() > 0.0, "{torque:?}");
    }
}

#[test]
fn torque_opposes_tilt_heading_and_rate() {
    // The vehicle is rolled by 0.1 rad to the right, so down points to +y.
    let torque = controller(CENTRED).step(vec3(0.0, 0.0998, 0.995), 0.0, Vec3::ZERO, FREE, 1e-3);
    assert!(torque.x < 0.0 && torque.y == 0.0);
    let torque = controller(CENTRED).step(Vec3::Z, 0.1, Vec3::ZERO, FREE, 1e-3);
    assert!(torque.z < 0.0);
    let torque = controller(CENTRED).step(Vec3::Z, 0.0, vec3(0.1, 0.2, 0.3), FREE, 1e-3);
    assert!(torque.x < 0.0 && torque.y < 0.0 && torque.z < 0.0);
}

#[test]
fn rate_mode_commands_the_rate_of_the_sticks() {
    let mut c = controller(CENTRED);
    c.set_sticks(&CENTRED, FlightMode::Rate);
    assert_eq!(c.step(vec3(0.0, 0.6, 0.8), 2.0, Vec3::ZERO, FREE, 1e-3), Vec3::ZERO);
    c.set_sticks(&Sticks { roll: 0.5, pitch: -0.25, yaw: 1.0, ..CENTRED }, FlightMode::Rate);
    let p = ControlParams::OS4;
    let commanded = vec3(0.5 * p.max_stick_rate_rad_s, 0.25 * p.max_stick_rate_rad_s, p.max_yaw_rate_rad_s);
    c.reset(commanded, 0.0);
    assert_eq!(c.step(vec3(0.0, 0.6, 0.8), 2.0, commanded, FREE, 1e-3), Vec3::ZERO);
    // After the change back to angle mode, the setpoint is level at the present heading.
    c.set_sticks(&CENTRED, FlightMode::Angle);
    c.reset(Vec3::ZERO, 2.0);
    assert_eq!(c.step(Vec3::Z, 2.0, Vec3::ZERO, FREE, 1e-3), Vec3::ZERO);
}

#[test]
fn upside_down_gives_a_roll_torque() {
    let torque = controller(CENTRED).step(vec3(0.0, 0.0, -1.0), 0.0, Vec3::ZERO, FREE, 1e-3);
    assert!(torque.x.abs() > 0.1 && torque.x.is_finite());
}

#[test]
#[cfg_attr(miri, ignore = "120,000 steps")]
fn integrator_freezes_in_saturation_and_is_bounded() {
    let tilted = vec3(0.0, 0.5, 0.866_025_4);
    let full = Saturation { roll_pitch: true, yaw: true };
    let mut c = controller(CENTRED);
    for _ in 0..60_000 {
        c.step(tilted, 1.0, Vec3::ZERO, full, 1e-3);
    }
    assert_eq!(c.integral, Vec3::ZERO);
    for _ in 0..60_000 {
        c.step(tilted, 1.0, Vec3::ZERO, FREE, 1e-3);
    }
    assert_eq!(c.integral.x, -ControlParams::OS4.max_integral_rad_s2.x);
}

#[test]
fn gesture_does_not_turn_the_vehicle() {
    let mut c = controller(CENTRED);
    c.step(Vec3::Z, 0.0, Vec3::ZERO, FREE, 1e-3);
    c.set_sticks(&Sticks { throttle: 0.0, yaw: -1.0, ..CENTRED }, FlightMode::Angle);
    assert_eq!(c.step(Vec3::Z, 0.0, Vec3::ZERO, FREE, 1e-3), Vec3::ZERO);
    c.set_sticks(&Sticks { throttle: 0.1, yaw: -1.0, ..CENTRED }, FlightMode::Angle);
    assert!(c.step(Vec3::Z, 0.0, Vec3::ZERO, FREE, 1e-3).z < 0.0);
}

#[test]
fn nothing_winds_up_before_take_off() {
    let mut c = controller(Sticks { throttle: 0.05, ..CENTRED });
    for _ in 0..1000 {
        assert_eq!(c.step(vec3(0.0, 0.1, 0.995), 0.3, vec3(0.1, 0.1, 0.1), FREE, 1e-3), Vec3::ZERO);
    }
    // After take-off a low throttle does not switch the controller off.
    c.set_sticks(&CENTRED, FlightMode::Angle);
    c.step(Vec3::Z, 0.3, Vec3::ZERO, FREE, 1e-3);
    c.set_sticks(&Sticks { throttle: 0.0, ..CENTRED }, FlightMode::Angle);
    assert!(c.step(vec3(0.0, 0.1, 0.995), 0.3, Vec3::ZERO, FREE, 1e-3).x < 0.0);
}

/// The controller in f64, written from the documentation of [`ControlParams`] and not from the code: the tilt error
/// is the angle between the two directions, the setpoint comes from a quaternion, and each axis is computed
/// separately.
struct InDouble {
    params: ControlParams,
    inertia: [f64; 3],
    integral: [f64; 3],
    last_rates: [f64; 3],
    heading_target: f64,
    flying: bool,
}

/// The input of a step.
#[derive(Clone, Copy, Debug)]
struct StepInput {
    sticks: Sticks,
    mode: FlightMode,
    /// Roll and pitch of the vehicle, rad.
    tilt: (f64, f64),
    heading: f32,
    rates: Vec3<f32>,
    saturation: Saturation,
    dt_s: f32,
}

fn double(v: Vec3<f32>) -> [f64; 3] {
    <[f32; 3]>::from(v).map(f64::from)
}

/// Returns the direction of down in body axes at a roll and a pitch (rad).
fn down_at(roll: f64, pitch: f64) -> Vec3<f64> {
    let half = |angle: f64| (0.5 * angle).sin_cos();
    Quaternion::from_half_angles(half(roll), half(pitch), (0.0, 1.0)).conjugate().rotate(Vec3::Z)
}

fn remainder(x: f64) -> f64 {
    x - 2.0 * PI * (x / (2.0 * PI)).round()
}

impl InDouble {
    /// Returns the torques, and the sum of the magnitudes of their terms, to which the rounding error is
    /// proportional. `None` where rounding decides the direction of the rotation.
    fn step(&mut self, now: &StepInput) -> Option<([f64; 3], [f64; 3])> {
        let p = &self.params;
        let rates = double(now.rates);
        let heading = f64::from(now.heading);
        if !self.flying && now.sticks.throttle < p.begin_throttle {
            (self.integral, self.last_rates, self.heading_target) = ([0.0; 3], rates, heading);
            return Some(([0.0; 3], [0.0; 3]));
        }
        self.flying = true;

        let gesture = now.sticks.throttle < 0.05 && now.sticks.yaw.abs() > 0.9;
        let yaw_commanded = now.sticks.yaw.abs() > YAW_DEADBAND && !gesture;
        let yaw_stick =
            if yaw_commanded { f64::from(now.sticks.yaw) * f64::from(p.max_yaw_rate_rad_s) } else { 0.0 };
        let (roll, pitch) = (f64::from(now.sticks.roll), -f64::from(now.sticks.pitch));
        let wanted_rates = match now.mode {
            FlightMode::Rate => {
                self.heading_target = heading;
                let max = f64::from(p.max_stick_rate_rad_s);
                [roll * max, pitch * max, yaw_stick]
            }
            FlightMode::Angle => {
                let max = f64::from(p.max_tilt_rad);
                let (wanted, down) = (down_at(roll * max, pitch * max), down_at(now.tilt.0, now.tilt.1));
                let angle = wanted.cross(down).norm().atan2(wanted.dot(down));
                let off = wanted.dot(down) + 1.0;
                if (0.9e-3..1.1e-3).contains(&off) {
                    return None;
                }
                let (axis, error) = if off < 1.0e-3 {
                    (Vec3::X, PI)
                } else if angle > 0.0 {
                    (wanted.cross(down) * (1.0 / angle.sin()), 2.0 * (0.5 * angle).tan())
                } else {
                    (Vec3::ZERO, 0.0)
                };
                let tilt_rate = (f64::from(p.tilt_p) * error).min(f64::from(p.max_tilt_rate_rad_s));
                let yaw_rate = if yaw_commanded {
                    self.heading_target = heading;
                    yaw_stick
                } else {
                    let off = remainder(self.heading_target - heading);
                    if off.abs() > PI - 1.0e-3 {
                        return None;
                    }
                    let max = f64::from(p.max_yaw_rate_rad_s);
                    (f64::from(p.heading_p) * off).clamp(-max, max)
                };
                <[f64; 3]>::from(axis * tilt_rate + down * yaw_rate)
            }
        };

        let dt_s = f64::from(now.dt_s);
        let mut torque = [0.0; 3];
        let mut scale = [0.0; 3];
        for axis in 0..3 {
            let gain = |gains: Vec3<f32>| double(gains)[axis];
            let error = wanted_rates[axis] - rates[axis];
            let slope = if dt_s > 0.0 { (rates[axis] - self.last_rates[axis]) / dt_s } else { 0.0 };
            self.last_rates[axis] = rates[axis];
            let is_saturated = if axis == 2 { now.saturation.yaw } else { now.saturation.roll_pitch };
            if !is_saturated {
                let max = gain(p.max_integral_rad_s2);
                self.integral[axis] = (self.integral[axis] + gain(p.rate_i) * error * dt_s).clamp(-max, max);
            }
            torque[axis] =
                self.inertia[axis] * (gain(p.rate_p) * error + self.integral[axis] - gain(p.rate_d) * slope);
            // The derivative amplifies the rounding error of a rate in the same way as the rate.
            let rate = 70.0 + rates[axis].abs();
            let steep = if dt_s > 0.0 { 100.0 / dt_s } else { 0.0 };
            scale[axis] = self.inertia[axis]
                * (gain(p.rate_p) * rate
                    + gain(p.rate_i) * rate
                    + self.integral[axis].abs()
                    + gain(p.rate_d) * steep);
        }
        Some((torque, scale))
    }
}

fn params() -> impl Strategy<Value = ControlParams> {
    let gains = |max: f32| [0.0..=max, 0.0..=max, 0.0..=max].prop_map(Vec3::from);
    let limits = (0.01..=1.4_f32, 0.01..=35.0_f32, 0.01..=35.0_f32, 0.01..=35.0_f32, 0.0..=0.5_f32);
    let angle = (0.0..=100.0_f32, 0.0..=100.0_f32);
    let rate = (gains(1.0e3), gains(1.0e4), gains(10.0), gains(1.0e3));
    let any = (limits, angle, rate).prop_map(|(limits, angle, rate)| ControlParams {
        max_tilt_rad: limits.0,
        max_stick_rate_rad_s: limits.1,
        max_yaw_rate_rad_s: limits.2,
        max_tilt_rate_rad_s: limits.3,
        tilt_p: angle.0,
        heading_p: angle.1,
        rate_p: rate.0,
        rate_i: rate.1,
        rate_d: rate.2,
        max_integral_rad_s2: rate.3,
        begin_throttle: limits.4,
    });
    prop_oneof![Just(ControlParams::OS4), any]
}

fn step_input() -> impl Strategy<Value = StepInput> {
    let marks = || prop::sample::select(&[0.0, YAW_DEADBAND, -YAW_DEADBAND, 0.9, -1.0, 1.0][..]);
    let stick = || prop_oneof![2 => -1.0..=1.0_f32, 1 => marks()];
    let throttle = prop_oneof![4 => 0.0..=1.0_f32, 1 => prop::sample::select(&[0.0, 0.04, ControlParams::OS4.begin_throttle][..])];
    let sticks = (throttle, stick(), stick(), stick());
    let sticks = sticks.prop_map(|(throttle, roll, pitch, yaw)| Sticks { throttle, roll, pitch, yaw });
    let mode = prop_oneof![3 => Just(FlightMode::Angle), 1 => Just(FlightMode::Rate)];
    let tilt = prop_oneof![(-0.3..0.3, -0.3..0.3), (-PI..PI, -1.5..1.5), Just((PI, 0.0))];
    let rates = [-35.0..35.0_f32, -35.0..35.0, -35.0..35.0].prop_map(Vec3::from);
    let saturation =
        (any::<bool>(), any::<bool>()).prop_map(|(roll_pitch, yaw)| Saturation { roll_pitch, yaw });
    let dt_s = prop_oneof![4 => 3.0e-5..0.1_f32, 1 => Just(0.0_f32)];
    (sticks, mode, tilt, -3.1..3.1_f32, rates, saturation, dt_s).prop_map(
        |(sticks, mode, tilt, heading, rates, saturation, dt_s)| StepInput {
            sticks,
            mode,
            tilt,
            heading,
            rates,
            saturation,
            dt_s,
        },
    )
}

proptest! {
    /// For any gains, sticks, attitudes and rates: the torque is the documented one.
    #[test]
    fn torque_equals_a_second_controller_in_f64(
        params in params(),
        inertia in [1.0e-6..1.0_f32, 1.0e-6..1.0_f32, 1.0e-6..1.0_f32],
        heading in -3.0..3.0_f32,
        inputs in prop::collection::vec(step_input(), 1..12),
    ) {
        let mut ours = Controller::new(&params, inertia.into()).unwrap();
        let mut second = InDouble {
            params,
            inertia: inertia.map(f64::from),
            integral: [0.0; 3],
            last_rates: [0.0; 3],
            heading_target: f64::from(heading),
            flying: false,
        };
        ours.reset(Vec3::ZERO, heading);
        for now in &inputs {
            let Some((expected, scale)) = second.step(now) else { return Ok(()) };
            let [x, y, z] = <[f64; 3]>::from(down_at(now.tilt.0, now.tilt.1)).map(|part| part as f32);
            ours.set_sticks(&now.sticks, now.mode);
            prop_assert_eq!(ours.throttle(), now.sticks.throttle);
            let torque = double(ours.step(vec3(x, y, z), now.heading, now.rates, now.saturation, now.dt_s));
            for axis in 0..3 {
                let off = (torque[axis] - expected[axis]).abs();
                prop_assert!(off <= 2.0e-5 * scale[axis], "axis {}: {} of {}", axis, torque[axis], expected[axis]);
            }
            prop_assert_eq!(ours.holds_tilt(), second.flying && now.mode == FlightMode::Angle);
        }
        // A reset clears the state.
        ours.reset(Vec3::ZERO, 0.5);
        prop_assert!(!ours.holds_tilt());
        ours.set_sticks(&CENTRED, FlightMode::Angle);
        prop_assert_eq!(ours.step(Vec3::Z, 0.5, Vec3::ZERO, FREE, 1e-3), Vec3::ZERO);
    }

    /// `set_level` gives level flight with held heading, for any previous sticks.
    #[test]
    fn set_level_equals_centred_sticks(now in step_input(), throttle in 0.1..=1.0_f32) {
        let [mut level, mut centred] = [controller(now.sticks); 2];
        level.set_level(throttle);
        centred.set_sticks(&Sticks { throttle, ..CENTRED }, FlightMode::Angle);
        let step = |c: &mut Controller| c.step(vec3(0.1, 0.2, 0.97), now.heading, now.rates, now.saturation, now.dt_s);
        prop_assert_eq!(step(&mut level), step(&mut centred));
        prop_assert_eq!(level.throttle(), throttle);
    }
}

#[test]
fn non_finite_rate_leaves_a_bounded_integral() {
    for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN] {
        let mut c = controller(CENTRED);
        c.step(Vec3::Z, 0.0, vec3(odd, odd, odd), FREE, 1e-3);
        let max = ControlParams::OS4.max_integral_rad_s2;
        for (held, max) in double(c.integral).into_iter().zip(double(max)) {
            assert!(held.abs() <= max, "{odd}: {held}");
        }
    }
}

/// Every field, at the ends of its range and beyond them.
#[test]
fn parameters_out_of_range_are_rejected_by_name() {
    type Set = fn(&mut ControlParams, f32);
    let fields: [(&str, f32, f32, Set); 18] = [
        ("control.max_tilt_rad", 0.01, 1.4, |p, x| p.max_tilt_rad = x),
        ("control.max_stick_rate_rad_s", 0.01, 35.0, |p, x| p.max_stick_rate_rad_s = x),
        ("control.max_yaw_rate_rad_s", 0.01, 35.0, |p, x| p.max_yaw_rate_rad_s = x),
        ("control.max_tilt_rate_rad_s", 0.01, 35.0, |p, x| p.max_tilt_rate_rad_s = x),
        ("control.tilt_p", 0.0, 100.0, |p, x| p.tilt_p = x),
        ("control.heading_p", 0.0, 100.0, |p, x| p.heading_p = x),
        ("control.rate_p", 0.0, 1.0e3, |p, x| p.rate_p.x = x),
        ("control.rate_p", 0.0, 1.0e3, |p, x| p.rate_p.y = x),
        ("control.rate_p", 0.0, 1.0e3, |p, x| p.rate_p.z = x),
        ("control.rate_i", 0.0, 1.0e4, |p, x| p.rate_i.x = x),
        ("control.rate_i", 0.0, 1.0e4, |p, x| p.rate_i.y = x),
        ("control.rate_i", 0.0, 1.0e4, |p, x| p.rate_i.z = x),
        ("control.rate_d", 0.0, 10.0, |p, x| p.rate_d.x = x),
        ("control.rate_d", 0.0, 10.0, |p, x| p.rate_d.y = x),
        ("control.rate_d", 0.0, 10.0, |p, x| p.rate_d.z = x),
        ("control.max_integral_rad_s2", 0.0, 1.0e3, |p, x| p.max_integral_rad_s2.x = x),
        ("control.max_integral_rad_s2", 0.0, 1.0e3, |p, x| p.max_integral_rad_s2.y = x),
        ("control.max_integral_rad_s2", 0.0, 1.0e3, |p, x| p.max_integral_rad_s2.z = x),
    ];
    for (field, min, max, set) in fields {
        let with = |value| {
            let mut params = ControlParams::OS4;
            set(&mut params, value);
            Controller::new(&params, INERTIA).map(|_| ()).map_err(|error| error.field)
        };
        assert_eq!((with(min), with(max)), (Ok(()), Ok(())), "{field}");
        for odd in [min.next_down(), max.next_up(), f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(with(odd), Err(field), "{odd}");
        }
    }
    for axis in 0..3 {
        for odd in [0.0, -1.0, f32::NAN, 1.1e6] {
            let mut inertia = [1.0e-2; 3];
            inertia[axis] = odd;
            let error = Controller::new(&ControlParams::OS4, inertia.into()).unwrap_err();
            assert_eq!(error.field, "airframe.inertia_kg_m2");
        }
    }
}
