//! `[tolerances]`: how far the vehicle and the sensors of a run may differ from those of the scene.
//!
//! Each run of a scene flies its own vehicle, drawn once from the tolerances. The flight code and the pilot know only the
//! values of the scene. This models several vehicles that are built from one parts list.
//!
//! | key | bound of the deviation | distribution |
//! |---|---|---|
//! | `uniform` | ± this, in the unit of the quantity | uniform |
//! | `normal` | ± this, in the unit of the quantity | normal, σ is a third of the bound; a draw beyond the bound is repeated |
//! | `uniform_percent` | ± this share of the scene's value, % | uniform |
//! | `normal_percent` | ± this share of the scene's value, % | as `normal` |
//!
//! A quantity that is not named is not drawn. Each axis or rotor of a quantity has its own random stream, seeded by (seed
//! of the run, quantity, axis). So naming one quantity does not change the draws of another, and `--seed` alone
//! reproduces a run.

use flight_core::geometry::vec3;
use serde::Deserialize;

use super::{Scene, check};
use crate::effects::sensor::{HardIron, Misalignment, ScaleFactor};
use crate::effects::vehicle::CgOffset;
use input::InputError;
use random::{NormalStream, UniformStream};

/// A bound with its distribution: exactly one of the four keys is given.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Tolerance {
    uniform: Option<f64>,
    normal: Option<f64>,
    uniform_percent: Option<f64>,
    normal_percent: Option<f64>,
}

/// Bound of a normal draw, in standard deviations.
const SIGMAS: f64 = 3.0;

/// Largest share of the scene's value, %.
const MAX_PERCENT: f64 = 50.0;

impl Tolerance {
    const KEYS: [&str; 4] = ["uniform", "normal", "uniform_percent", "normal_percent"];

    fn values(&self) -> [Option<f64>; 4] {
        [self.uniform, self.normal, self.uniform_percent, self.normal_percent]
    }

    fn is_normal(&self) -> bool {
        self.normal.is_some() || self.normal_percent.is_some()
    }

    /// Returns the bound around this value, in its unit.
    fn bound(&self, value: f64) -> f64 {
        let percent = self.uniform_percent.or(self.normal_percent);
        let absolute = self.uniform.or(self.normal);
        absolute.or(percent.map(|percent| percent * 0.01 * value)).unwrap_or(0.0)
    }

    /// Formats distribution and bound, for example `normal ±3 %`.
    fn text(&self, unit: &str) -> String {
        let distribution = if self.is_normal() { "normal" } else { "uniform" };
        let (bound, unit) = match (self.uniform.or(self.normal), self.uniform_percent.or(self.normal_percent))
        {
            (Some(bound), _) => (bound, unit),
            (None, percent) => (percent.unwrap_or(0.0), "%"),
        };
        format!("{distribution} ±{bound} {unit}")
    }

    /// Draws the deviation from this value for one axis of a run.
    fn draw(&self, quantity: &str, seed: u64, axis: usize, value: f64) -> f64 {
        let stream = format!("tolerances.{quantity}");
        let share = if self.is_normal() {
            let mut stream = NormalStream::new(seed, &stream, axis);
            // One draw in 370 is beyond 3 σ.
            let within = std::iter::repeat_with(|| stream.draw()).find(|x| x.abs() <= SIGMAS);
            within.unwrap_or(0.0) / SIGMAS
        } else {
            2.0 * UniformStream::new(seed, &stream, axis).draw() - 1.0
        };
        share * self.bound(value)
    }
}

/// A quantity that can have a tolerance.
struct Quantity {
    name: &'static str,
    unit: &'static str,
    /// Suffixes of the names of its axes or rotors.
    axes: &'static [&'static str],
    /// Largest absolute bound, for a quantity without a value in the scene; `None` if it is half of the scene's value.
    largest: Option<f64>,
    /// Returns the scene's values, one for each axis; zeros for a quantity that is added to an error.
    values: fn(&Scene) -> Vec<f64>,
    /// Replaces these values by the drawn ones, or adds the drawn ones to the error.
    set: fn(&mut Scene, &[f64]),
}

const ONE: &[&str] = &[""];
const AXES: &[&str] = &[".x", ".y", ".z"];
/// Axes of the centre of gravity. Thrust is along z, so an offset along z causes no torque.
const LEVEL: &[&str] = &[".x", ".y"];
const ROTORS: &[&str] = &[".1", ".2", ".3", ".4"];

macro_rules! tolerances {
    ($($(#[$doc:meta])* $key:ident: $unit:literal, $axes:ident, $largest:expr, $values:expr, $set:expr;)+) => {
        /// `[tolerances]`
        #[derive(Clone, Debug, Default, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub(super) struct Tolerances {
            $($(#[$doc])* $key: Option<Tolerance>,)+
        }

        impl Tolerances {
            /// Returns the quantities that the scene names.
            fn named(&self) -> Vec<(Quantity, Tolerance)> {
                let mut list = Vec::new();
                $(if let Some(tolerance) = self.$key {
                    let (name, unit, axes, largest) = (stringify!($key), $unit, $axes, $largest);
                    list.push((
                        Quantity { name, unit, axes, largest, values: $values, set: $set },
                        tolerance,
                    ));
                })+
                list
            }
        }
    };
}

tolerances! {
    /// Mass m.
    mass_kg: "kg", ONE, None, |s| vec![s.vehicle.mass_kg], |s, drawn| s.vehicle.mass_kg = drawn[0];
    /// Moments of inertia I_xx, I_yy and I_zz, each drawn separately.
    inertia_kg_m2: "kg m²", AXES, None,
        |s| <[f64; 3]>::from(s.vehicle.inertia_kg_m2).into(),
        |s, drawn| s.vehicle.inertia_kg_m2 = vec3(drawn[0], drawn[1], drawn[2]);
    /// Moment of inertia J_r, the same for all rotors.
    rotor_inertia_kg_m2: "kg m²", ONE, None,
        |s| vec![s.vehicle.rotor_inertia_kg_m2], |s, drawn| s.vehicle.rotor_inertia_kg_m2 = drawn[0];
    /// Arm length l.
    arm_m: "m", ONE, None, |s| vec![s.vehicle.arm_m()], |s, drawn| s.vehicle.set_arm_m(drawn[0]);
    /// Thrust coefficient b, drawn separately for each rotor.
    thrust_coefficient_n_s2: "N s²", ROTORS, None,
        |s| vec![s.vehicle.thrust_coefficient; 4],
        |s, drawn| s.thrust_shares = Some([0, 1, 2, 3].map(|i| drawn[i] / s.vehicle.thrust_coefficient));
    /// Torque coefficient d, the same for all rotors.
    torque_coefficient_n_m_s2: "N m s²", ONE, None,
        |s| vec![s.vehicle.torque_coefficient], |s, drawn| s.vehicle.torque_coefficient = drawn[0];
    /// Time constant τ of the motor lag, the same for all rotors. If braking has its own τ, it changes by the same factor.
    motor_lag_tau_s: "s", ONE, None,
        |s| s.effects.vehicle.motor_lag.iter().map(|lag| lag.tau_s).collect(),
        |s, drawn| if let Some(lag) = &mut s.effects.vehicle.motor_lag {
            let factor = drawn[0] / lag.tau_s;
            lag.tau_s = drawn[0];
            lag.tau_down_s = lag.tau_down_s.map(|tau_s| tau_s * factor);
        };
    /// Offset of the centre of gravity, added to that of the scene.
    cg_offset_m: "m", LEVEL, Some(0.1), |_| vec![0.0; 2],
        |s, drawn| {
            let none = CgOffset { offset_m: [0.0; 3] };
            add(&mut s.effects.vehicle.cg_offset.get_or_insert(none).offset_m, drawn);
        };
    /// Scale-factor error of the gyroscope, added to that of the scene.
    gyro_scale_ppm: "ppm", AXES, Some(1e5), |_| vec![0.0; 3],
        |s, drawn| {
            let none = ScaleFactor { error_ppm: [0.0; 3] };
            add(&mut s.effects.gyro.scale_factor.get_or_insert(none).error_ppm, drawn);
        };
    /// Scale-factor error of the accelerometer, added to that of the scene.
    accel_scale_ppm: "ppm", AXES, Some(1e5), |_| vec![0.0; 3],
        |s, drawn| {
            let none = ScaleFactor { error_ppm: [0.0; 3] };
            add(&mut s.effects.accel.scale_factor.get_or_insert(none).error_ppm, drawn);
        };
    /// Rotation of the IMU chip on the board, added to that of the scene. Gyroscope and accelerometer share the draw.
    imu_mounting_mrad: "mrad", AXES, Some(100.0), |_| vec![0.0; 3],
        |s, drawn| {
            for misalignment in [&mut s.effects.gyro.misalignment, &mut s.effects.accel.misalignment] {
                let none = Misalignment { mounting_mrad: [0.0; 3], non_orthogonality_mrad: [0.0; 3] };
                add(&mut misalignment.get_or_insert(none).mounting_mrad, drawn);
            }
        };
    /// Hard iron that appeared after the calibration, added to that of the scene.
    mag_hard_iron_ut: "µT", AXES, Some(1e3), |_| vec![0.0; 3],
        |s, drawn| {
            let none = HardIron { field_ut: [0.0; 3] };
            add(&mut s.effects.mag.hard_iron.get_or_insert(none).field_ut, drawn);
        };
}

fn add(to: &mut [f64; 3], drawn: &[f64]) {
    to.iter_mut().zip(drawn).for_each(|(to, drawn)| *to += drawn);
}

/// The drawn values of a run, with names such as `inertia_kg_m2.x`. For a quantity that is added to an error of the scene
/// it is the added part.
pub type Drawn = Vec<(String, f64)>;

impl Tolerances {
    pub fn is_empty(&self) -> bool {
        self.named().is_empty()
    }

    /// Returns each named quantity with its distribution and bound as text.
    pub fn described(&self) -> Vec<(&'static str, String)> {
        self.named().into_iter().map(|(quantity, t)| (quantity.name, t.text(quantity.unit))).collect()
    }

    /// Checks the bounds against the values of the scene.
    pub fn validate(&self, scene: &Scene) -> Result<(), InputError> {
        for (Quantity { name, unit, largest, values, .. }, tolerance) in self.named() {
            let field = format!("tolerances.{name}");
            let given = tolerance.values();
            let [(key, value)] = Tolerance::KEYS
                .into_iter()
                .zip(given)
                .filter_map(|(key, value)| Some((key, value?)))
                .collect::<Vec<_>>()[..]
            else {
                return Err(InputError::new(format!(
                    "must have exactly one of {}",
                    Tolerance::KEYS.join(", ")
                ))
                .field(field));
            };
            let values = values(scene);
            if values.is_empty() {
                return Err(InputError::new("needs effects.vehicle.motor_lag").field(field));
            }
            let field = format!("{field}.{key}");
            match (key.ends_with("_percent"), largest) {
                (true, Some(_)) => {
                    return Err(InputError::new(
                        "must be uniform or normal: the scene has no value to take a share of",
                    )
                    .field(field)
                    .value(value));
                }
                (true, None) => check::in_range(&field, value, 0.0, MAX_PERCENT, "%")?,
                (false, Some(largest)) => check::in_range(&field, value, 0.0, largest, unit)?,
                (false, None) => {
                    let smallest = values.iter().copied().fold(f64::INFINITY, f64::min);
                    check::in_range(&field, value, 0.0, 0.01 * MAX_PERCENT * smallest, unit)?;
                }
            }
        }
        self.check_inertia(scene)
    }

    /// Checks that every drawn inertia is that of a possible body, which has no moment of inertia above the sum of the
    /// other two: ∫(y² + z²) ≤ ∫(x² + z²) + ∫(x² + y²).
    fn check_inertia(&self, scene: &Scene) -> Result<(), InputError> {
        let Some(tolerance) = self.inertia_kg_m2 else { return Ok(()) };
        let moments = <[f64; 3]>::from(scene.vehicle.inertia_kg_m2);
        let sum = |end: f64| moments.map(|moment| moment + end * tolerance.bound(moment));
        let (low, high) = (sum(-1.0), sum(1.0));
        for i in 0..3 {
            let others = low[(i + 1) % 3] + low[(i + 2) % 3];
            if high[i] > others {
                return Err(InputError::new(format!(
                    "must be smaller: it allows {} kg m² about {} with a sum of {others} kg m² about the other axes, and no body has a \
                     moment of inertia above the sum of the other two",
                    high[i],
                    ["x", "y", "z"][i],
                ))
                .field("tolerances.inertia_kg_m2"));
            }
        }
        Ok(())
    }

    /// Draws the values of a run and changes the scene to them. Returns the drawn values.
    pub fn apply(&self, scene: &mut Scene, seed: u64) -> Drawn {
        let mut all = Vec::new();
        for (Quantity { name, axes, values, set, .. }, tolerance) in self.named() {
            let drawn: Vec<f64> = values(scene)
                .into_iter()
                .enumerate()
                .map(|(axis, value)| value + tolerance.draw(name, seed, axis, value))
                .collect();
            set(scene, &drawn);
            all.extend(axes.iter().zip(drawn).map(|(axis, value)| (format!("{name}{axis}"), value)));
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::Flight;

    const BARE: &str = "include = \"hover\"\n[tolerances]\n";

    fn scene(lines: &str) -> Scene {
        Scene::parse("spread", &format!("{BARE}{lines}\n")).unwrap()
    }

    /// Returns lines that name each quantity with this bound and distribution, in percent where the scene has a value.
    fn every(bound: f64, distribution: &str) -> String {
        [
            ("mass_kg", "_percent"),
            ("inertia_kg_m2", "_percent"),
            ("rotor_inertia_kg_m2", "_percent"),
            ("arm_m", "_percent"),
            ("thrust_coefficient_n_s2", "_percent"),
            ("torque_coefficient_n_m_s2", "_percent"),
            ("motor_lag_tau_s", "_percent"),
            ("cg_offset_m", ""),
            ("gyro_scale_ppm", ""),
            ("accel_scale_ppm", ""),
            ("imu_mounting_mrad", ""),
            ("mag_hard_iron_ut", ""),
        ]
        .map(|(name, suffix)| {
            let bound = if name == "cg_offset_m" { bound * 1e-3 } else { bound };
            format!("{name} = {{ {distribution}{suffix} = {bound} }}\n")
        })
        .concat()
    }

    fn drawn(scene: &Scene, seed: u64) -> Drawn {
        scene.for_run(seed).1
    }

    #[test]
    fn draws_stay_within_the_bound_and_come_near_it() {
        for distribution in ["uniform", "normal"] {
            let scene = scene(&every(5.0, distribution));
            let middle = drawn(&self::scene(&every(0.0, distribution)), 0);
            assert_eq!(middle.len(), 26);
            let (mut min, mut max) = (vec![f64::INFINITY; 26], vec![f64::NEG_INFINITY; 26]);
            for seed in 0..3_000 {
                for (i, (_, value)) in drawn(&scene, seed).into_iter().enumerate() {
                    (min[i], max[i]) = (min[i].min(value), max[i].max(value));
                }
            }
            for (i, (name, value)) in middle.iter().enumerate() {
                let bound = match name.as_str() {
                    name if name.starts_with("cg_offset_m") => 5e-3,
                    _ if *value == 0.0 => 5.0,
                    _ => 0.05 * value,
                };
                // About 40 of 3,000 normal draws are beyond 2.4 σ, which is 0.8 of the bound.
                for end in [value - min[i], max[i] - value] {
                    assert!(end <= bound * (1.0 + 1e-12) && end > 0.8 * bound, "{name}: {end} of {bound}");
                }
            }
        }
    }

    #[test]
    fn draws_have_the_documented_standard_deviation() {
        // Uniform on ±b: b/√3. Normal with σ = b/3 cut at 3 σ: 0.9866 σ, as 1 − 2·3 φ(3)/(2Φ(3) − 1) of σ².
        for (distribution, expected) in [("uniform", 1.0 / libm::sqrt(3.0)), ("normal", 0.986_6 / 3.0)] {
            let scene = scene(&format!("mass_kg = {{ {distribution} = 0.065 }}"));
            let runs = 20_000;
            let mut squares = 0.0;
            for seed in 0..runs {
                let [(_, mass_kg)] = drawn(&scene, seed)[..] else { panic!("one quantity") };
                squares += (mass_kg - 0.65) * (mass_kg - 0.65);
            }
            let deviation = libm::sqrt(squares / runs as f64) / 0.065;
            // The bound is five standard errors of a deviation from 20,000 draws, 5/√40,000.
            assert!((deviation / expected - 1.0).abs() < 0.025, "{distribution}: {deviation}");
        }
    }

    #[test]
    fn quantity_changes_no_other_draw_and_no_effect() {
        let lines = every(5.0, "normal");
        let all = drawn(&scene(&lines), 7);
        for line in lines.lines() {
            let alone = drawn(&scene(line), 7);
            assert!(!alone.is_empty());
            assert!(alone.iter().all(|one| all.contains(one)), "{line}");
        }
        // Deviations of 0 change nothing, although all their effects are built: the noise is that of the scene.
        let nothing = scene(&every(0.0, "uniform"));
        let [nothing, hover] =
            [&nothing, &Scene::load("hover").unwrap()].map(|scene| Flight::new(scene, 7).run(&mut ()));
        assert_eq!(nothing, hover);
        // A drawn value changes the flight.
        assert_ne!(Flight::new(&scene("arm_m = { uniform = 0.01 }"), 7).run(&mut ()).digest, hover.digest);
    }

    #[test]
    fn flight_code_and_pilot_keep_the_values_of_the_scene() {
        let scene = scene(&every(5.0, "uniform"));
        let run_scene = scene.for_run(3).0;
        assert_eq!(run_scene.config.params.airframe, scene.config.params.airframe);
        assert_ne!(run_scene.vehicle, scene.vehicle);
    }

    #[test]
    fn each_rotor_has_its_own_thrust_and_all_the_same_torque() {
        let scene = scene("thrust_coefficient_n_s2 = { uniform_percent = 10 }");
        let (run_scene, drawn) = scene.for_run(11);
        let mut vehicle = crate::dynamics::Vehicle::at_rest(
            run_scene.vehicle,
            run_scene.mount(),
            run_scene.vehicle_effects(11, 1e3),
            1e-3,
        );
        let high = crate::dynamics::State { position: vec3(0.0, 0.0, -100.0), ..*vehicle.state() };
        let speed = 200.0;
        vehicle.set_state(high, [speed; 4]);
        let [b1, b2, b3, b4] = [0, 1, 2, 3].map(|i| drawn[i].1);
        // Eqs 4-7 with a thrust coefficient for each rotor: lift, roll, pitch and yaw.
        let square = speed * speed;
        let lift = -(b1 + b2 + b3 + b4) * square / 0.65;
        let lever = 0.23 * std::f64::consts::FRAC_1_SQRT_2;
        let roll = lever * (b1 - b2 - b3 + b4) * square / 7.5e-3;
        let pitch = lever * (b1 + b2 - b3 - b4) * square / 7.5e-3;
        let turn = vehicle.angular_acceleration();
        assert!((vehicle.specific_force().z / lift - 1.0).abs() < 1e-12);
        assert!((turn.x / roll - 1.0).abs() < 1e-9 && (turn.y / pitch - 1.0).abs() < 1e-9);
        assert!(turn.z.abs() < 1e-12);
    }

    #[test]
    fn errors_are_one_line_with_the_field() {
        for (line, wanted) in [
            ("mas_kg = { uniform = 0.1 }", "(did you mean `mass_kg`?)"),
            ("mass_kg = { unifrom = 0.1 }", "(did you mean `uniform`?)"),
            ("mass_kg = { }", "spread:3: tolerances.mass_kg: must have exactly one of uniform, normal, "),
            ("mass_kg = { uniform = 0.1, normal = 0.1 }", "tolerances.mass_kg: must have exactly one of"),
            ("mass_kg = { uniform = 0.5 }", "tolerances.mass_kg.uniform = 0.5: must be from 0 to 0.325 kg"),
            (
                "mass_kg = { normal_percent = -1 }",
                "tolerances.mass_kg.normal_percent = -1: must be from 0 to 50 %",
            ),
            ("arm_m = { uniform = nan }", "tolerances.arm_m.uniform = nan: must be from 0 to 0.115 m"),
            ("gyro_scale_ppm = { uniform_percent = 1 }", "must be uniform or normal: the scene has no value"),
            (
                "inertia_kg_m2 = { uniform_percent = 8 }",
                "no body has a moment of inertia above the sum of the other two",
            ),
        ] {
            let error = Scene::parse("spread", &format!("{BARE}{line}\n")).unwrap_err().to_string();
            assert!(error.contains(wanted), "{line}: {error}");
        }
        let without_lag = "[scene]\nduration_s = 1.0\nseed = 1\nvehicle = \"os4\"\nimu = \"paper\"\n[tolerances]\n\
                       motor_lag_tau_s = { uniform_percent = 10 }\n";
        let error = Scene::parse("spread", without_lag).unwrap_err().to_string();
        assert!(error.contains("needs effects.vehicle.motor_lag"), "{error}");
    }
}
