//! The mixer: conversion between thrust and torques and the speeds of the rotors, equations 4-7 of the paper.
//!
//! A is the 4×4 sign matrix of eqs 4-7, a Hadamard matrix with A⁻¹ = Aᵀ/4. f and r are the distances of the rotors
//! from the centre of gravity, forward and to the right; the square of the paper has f = r = l sin(π/4).
//!
//! ```text
//!            U1 = b Σ Ω²                  rotor   roll  pitch  yaw    seen from above, forward is up
//!  roll    = l U2 = r b Σ ±Ω²               1      +     +     +        1 ↺     2 ↻
//!  pitch   = l U3 = f b Σ ±Ω²               2      −     +     −            ╳          Spin::PropsOut
//!  yaw     =   U4 = d Σ ±Ω²                 3      −     −     +        4 ↻     3 ↺
//!                                           4      +     −     −
//! ```
//!
//! The inverse is Ωᵢ² = U1/4b ± roll/4br ± pitch/4bf ± yaw/4d. With [`Spin::PropsIn`] the signs of yaw are reversed.
//!
//! Each Ω² is limited to Ω_idle² to Ω_max². A demand that does not fit is reduced in a fixed order: roll and pitch
//! are kept, the collective is shifted into range, then yaw is scaled, and last roll and pitch are scaled together.
//! No rotor is clipped individually, because that would turn a yaw demand into roll.

use crate::arithmetic::{max, min, sqrt};
use crate::geometry::{Vec3, vec3};
use crate::range::{ConfigError, check};

/// Direction of rotation of the rotors, seen from above.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Spin {
    /// Front left and rear right anticlockwise, the others clockwise: as in the paper, and "props out" in Betaflight.
    #[default]
    PropsOut,
    /// Front left and rear right clockwise, the others anticlockwise: "props in", the default of PX4 and Betaflight.
    PropsIn,
}

impl Spin {
    /// Returns the sign of the yaw torque (about z, down) of the front left rotor: 1 or −1.
    pub const fn sign(self) -> f32 {
        match self {
            Self::PropsOut => 1.0,
            Self::PropsIn => -1.0,
        }
    }
}

/// Parameters of the vehicle for thrust, torques and angular acceleration (symbols of table 1 of the paper).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Airframe {
    /// Thrust coefficient b, N·s²: 10⁻⁹ to 1. The thrust of a rotor is b Ω².
    pub thrust_coefficient: f32,
    /// Torque coefficient d, N·m·s²: 10⁻¹¹ to 1. The reaction torque of a rotor is d Ω².
    pub torque_coefficient: f32,
    /// Distance f of the front rotors forward of the centre of gravity, and of the rear rotors behind it, m: 0.005
    /// to 10.
    pub forward_m: f32,
    /// Distance r of the right rotors to the right of the centre of gravity, and of the left rotors to its left, m:
    /// 0.005 to 10.
    pub right_m: f32,
    /// Direction of rotation.
    pub spin: Spin,
    /// Moments of inertia I_xx, I_yy, I_zz, kg·m²: 10⁻⁹ to 10⁶.
    pub inertia_kg_m2: Vec3<f32>,
    /// Idle speed, the slowest speed of an armed rotor, rad/s: 0 to half of `max_rad_s`.
    pub idle_rad_s: f32,
    /// Maximum speed of a rotor, rad/s: 1 to 10,000.
    pub max_rad_s: f32,
}

impl Airframe {
    /// OS4 (Bouabdallah, *Design and control of quadrotors with application to autonomous flying*, EPFL thesis 3727,
    /// 2007). Idle and maximum speed are our choice: a thrust-to-weight ratio of 2, and idle at 2 % of the hover
    /// thrust.
    pub const OS4: Self = Self {
        thrust_coefficient: 3.13e-5,
        torque_coefficient: 7.5e-7,
        // l sin(π/4), with l = 0.23 m.
        forward_m: 0.23 * core::f32::consts::FRAC_1_SQRT_2,
        right_m: 0.23 * core::f32::consts::FRAC_1_SQRT_2,
        spin: Spin::PropsOut,
        inertia_kg_m2: vec3(7.5e-3, 7.5e-3, 1.3e-2),
        idle_rad_s: 32.0,
        max_rad_s: 319.0,
    };
}

/// Thrust and torques of the four rotors together: demanded or produced.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// U1: thrust, N, upward along −z of the body.
    pub thrust_n: f32,
    /// l U2, l U3, U4: torques about x, y, z of the body, N·m.
    pub torque_n_m: Vec3<f32>,
}

/// The parts of a demand that the mixer reduced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Saturation {
    /// Whether roll and pitch were scaled down.
    pub roll_pitch: bool,
    /// Whether yaw was scaled down.
    pub yaw: bool,
}

/// The mixer of one airframe.
#[derive(Clone, Copy, Debug)]
pub struct Mixer {
    /// 1/4b: Ω² per N.
    per_thrust: f32,
    /// 1/(4 b r): Ω² per N·m of roll.
    per_roll_torque: f32,
    /// 1/(4 b f): Ω² per N·m of pitch.
    per_pitch_torque: f32,
    /// ±1/4d: Ω² of the front left rotor per N·m of yaw.
    per_yaw_torque: f32,
    min_square: f32,
    max_square: f32,
}

impl Mixer {
    /// Creates the mixer of an airframe.
    ///
    /// # Errors
    /// Returns the first coefficient, distance or speed outside the range that [`Airframe`] gives. The inertia is not
    /// checked here.
    pub fn new(airframe: &Airframe) -> Result<Self, ConfigError> {
        let Airframe { thrust_coefficient: b, torque_coefficient: d, forward_m, right_m, .. } = *airframe;
        check("airframe.thrust_coefficient", b, 1.0e-9, 1.0)?;
        check("airframe.torque_coefficient", d, 1.0e-11, 1.0)?;
        check("airframe.forward_m", forward_m, 0.005, 10.0)?;
        check("airframe.right_m", right_m, 0.005, 10.0)?;
        check("airframe.max_rad_s", airframe.max_rad_s, 1.0, 1.0e4)?;
        check("airframe.idle_rad_s", airframe.idle_rad_s, 0.0, 0.5 * airframe.max_rad_s)?;
        Ok(Self {
            per_thrust: 0.25 / b,
            per_roll_torque: 0.25 / (b * right_m),
            per_pitch_torque: 0.25 / (b * forward_m),
            per_yaw_torque: airframe.spin.sign() * 0.25 / d,
            min_square: airframe.idle_rad_s * airframe.idle_rad_s,
            max_square: airframe.max_rad_s * airframe.max_rad_s,
        })
    }

    /// Returns the thrust of all four rotors at maximum speed, N.
    pub fn max_thrust_n(&self) -> f32 {
        self.max_square / self.per_thrust
    }

    /// Returns the squared speeds of rotors 1 to 4 (rad²/s²) that produce `demand`, and the parts of the demand that
    /// were reduced because they did not fit. The module documentation gives the order of reduction.
    ///
    /// Roll and pitch add ±A to rotors 1 and 3 and ±B to rotors 2 and 4; yaw adds +Y and −Y. The spread of the
    /// squared speeds is therefore max(2|A|, 2|B|, |A| + |B| + 2|Y|), which gives each limit in closed form.
    ///
    /// A NaN thrust gives the smallest possible thrust. A torque that is NaN, or too large for an Ω² in f32, gives
    /// NaN squares, which [`Self::speeds`] converts to zero.
    #[inline]
    pub fn mix(&self, demand: &Wrench) -> ([f32; 4], Saturation) {
        let span = self.max_square - self.min_square;
        let roll = demand.torque_n_m.x * self.per_roll_torque;
        let pitch = demand.torque_n_m.y * self.per_pitch_torque;
        let mut a = pitch + roll;
        let mut b = pitch - roll;

        let widest = 2.0 * max(a.abs(), b.abs());
        let roll_pitch = widest > span;
        if roll_pitch {
            let share = span / widest;
            a *= share;
            b *= share;
        }
        let wanted = demand.torque_n_m.z * self.per_yaw_torque;
        // Rounding may give −ε.
        let room = max(0.5 * (span - a.abs() - b.abs()), 0.0);
        let yaw = wanted.abs() > room;
        let y = if yaw { room.copysign(wanted) } else { wanted };

        let highest = max(a.abs() + y, b.abs() - y);
        let deepest = max(a.abs() - y, b.abs() + y);
        // This order of operands gives a NaN thrust the smallest value and not the largest: `min` returns its second
        // operand.
        let wanted = min(self.max_square - highest, demand.thrust_n * self.per_thrust);
        let collective = max(wanted, self.min_square + deepest);

        let (up, down) = (collective + y, collective - y);
        ([up + a, down + b, up - a, down - b], Saturation { roll_pitch, yaw })
    }

    /// Returns the thrust and torques of rotors at these squared speeds (rad²/s²): eqs 4-7 as written in the paper.
    pub fn produce(&self, squares: [f32; 4]) -> Wrench {
        let [s1, s2, s3, s4] = squares;
        let quarter = |sum: f32, per: f32| 0.25 * sum / per;
        Wrench {
            thrust_n: quarter(s1 + s2 + s3 + s4, self.per_thrust),
            torque_n_m: vec3(
                quarter(s1 - s2 - s3 + s4, self.per_roll_torque),
                quarter(s1 + s2 - s3 - s4, self.per_pitch_torque),
                quarter(s1 - s2 + s3 - s4, self.per_yaw_torque),
            ),
        }
    }

    /// Returns the square roots of squared speeds, rad/s. A negative square, which rounding can give, and NaN give
    /// zero.
    #[inline]
    pub fn speeds(squares: [f32; 4]) -> [f32; 4] {
        squares.map(|s| sqrt(max(s, 0.0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::num::f32::ANY;
    use proptest::prelude::*;

    fn mixer() -> Mixer {
        Mixer::new(&Airframe::OS4).unwrap()
    }

    /// Eqs 4-7 copied from the paper in f64, with p_i/4 read as π/4 and the lever arm of eqs 8-9.
    fn paper(s: [f32; 4]) -> [f64; 4] {
        let [s1, s2, s3, s4] = s.map(f64::from);
        let (b, d, l) = (3.13e-5, 7.5e-7, 0.23);
        let lever = b * core::f64::consts::FRAC_PI_4.sin();
        [
            b * (s1 + s2 + s3 + s4),
            l * lever * (s1 - s2 - s3 + s4),
            l * lever * (s1 + s2 - s3 - s4),
            d * (s1 - s2 + s3 - s4),
        ]
    }

    fn parts(w: &Wrench) -> [f64; 4] {
        [w.thrust_n, w.torque_n_m.x, w.torque_n_m.y, w.torque_n_m.z].map(f64::from)
    }

    fn wrench(thrust_n: f32, x: f32, y: f32, z: f32) -> Wrench {
        Wrench { thrust_n, torque_n_m: vec3(x, y, z) }
    }

    /// Largest torques from hover, N·m: roll or pitch with 2 · Ω_h² per side, yaw likewise.
    const MAX_TILT_TORQUE: f32 = 1.04;
    const MAX_YAW_TORQUE: f32 = 0.153;

    #[test]
    fn sign_matrix_is_hadamard_with_determinant_16() {
        let signs = [[1, 1, 1, 1], [1, -1, -1, 1], [1, 1, -1, -1], [1, -1, 1, -1]];
        for (i, p) in signs.iter().enumerate() {
            for (j, q) in signs.iter().enumerate() {
                let dot: i32 = p.iter().zip(q).map(|(a, b)| a * b).sum();
                assert_eq!(dot, if i == j { 4 } else { 0 });
            }
        }
        // |det| of a 4×4 Hadamard matrix is 16; rows scaled by b, b/√2, b/√2, d: 16 · b³d/2 = 8 b³d.
        let minor = |m: [[i32; 3]; 3]| {
            m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
                - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
                + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
        };
        let cofactor = |c: usize| {
            let mut m = [[0; 3]; 3];
            for (row, signs) in m.iter_mut().zip(&signs[1..]) {
                let mut kept = signs.iter().enumerate().filter(|(j, _)| *j != c).map(|(_, s)| *s);
                *row = [kept.next().unwrap(), kept.next().unwrap(), kept.next().unwrap()];
            }
            minor(m)
        };
        let det: i32 = (0..4).map(|c| if c % 2 == 0 { cofactor(c) } else { -cofactor(c) }).sum();
        assert_eq!(det, -16);
    }

    proptest! {
        #[test]
        fn produced_wrench_equals_the_paper(s in prop::array::uniform4(0.0_f32..1.0e5)) {
            let scale = [13.0, 1.0, 1.0, 0.15];
            for ((ours, theirs), scale) in parts(&mixer().produce(s)).into_iter().zip(paper(s)).zip(scale) {
                prop_assert!((ours - theirs).abs() < 2e-6 * scale, "{} {}", ours, theirs);
            }
        }

        #[test]
        fn mixed_then_produced_is_the_demand_in_range(
            thrust in 5.0_f32..8.0, x in -0.2_f32..0.2, y in -0.2_f32..0.2, z in -0.02_f32..0.02,
        ) {
            let (squares, saturation) = mixer().mix(&wrench(thrust, x, y, z));
            prop_assert_eq!(saturation, Saturation::default());
            let back = paper(squares);
            for ((got, want), scale) in back.into_iter().zip(parts(&wrench(thrust, x, y, z))).zip([13.0, 1.0, 1.0, 0.15]) {
                prop_assert!((got - want).abs() < 4e-6 * scale, "{} {}", got, want);
            }
        }

        #[test]
        fn any_demand_is_reduced_in_the_fixed_order(
            thrust in -5.0_f32..20.0, x in -3.0_f32..3.0, y in -3.0_f32..3.0, z in -0.5_f32..0.5,
        ) {
            let mixer = mixer();
            let (squares, saturation) = mixer.mix(&wrench(thrust, x, y, z));
            for s in squares {
                prop_assert!(s >= mixer.min_square - 0.05 && s <= mixer.max_square + 0.05, "{}", s);
            }
            let [got_thrust, got_x, got_y, got_z] = paper(squares);
            let (x, y, z) = (f64::from(x), f64::from(y), f64::from(z));
            // Roll and pitch keep their ratio, and their size unless they alone exceed the range.
            prop_assert!((got_x * y - got_y * x).abs() < 1e-5 * (1.0 + x.abs() + y.abs()));
            if saturation.roll_pitch {
                prop_assert!(got_x.hypot(got_y) <= x.hypot(y) + 1e-6);
                let spread = squares.iter().fold(0.0_f32, |m, s| m.max(*s)) - squares.iter().fold(1e9_f32, |m, s| m.min(*s));
                prop_assert!((spread - (mixer.max_square - mixer.min_square)).abs() < 0.1);
            } else {
                prop_assert!((got_x - x).abs() < 1e-5 && (got_y - y).abs() < 1e-5);
            }
            // Yaw never changes its sign, never exceeds the demand, and is reduced only if the range is full.
            prop_assert!(got_z * z >= -1e-9 && got_z.abs() <= z.abs() + 1e-6);
            prop_assert_eq!(saturation.yaw, (got_z - z).abs() > 1e-6);
            // The collective equals the demand unless a rotor is at its limit.
            let inside = squares.iter().all(|s| *s > mixer.min_square + 0.1 && *s < mixer.max_square - 0.1);
            if inside {
                prop_assert!((got_thrust - f64::from(thrust)).abs() < 1e-4);
            }
        }

        /// Finds the same result in an independent way, by bisection on the share of yaw, with the range checked for
        /// each rotor.
        #[test]
        fn yaw_is_reduced_no_more_than_needed(x in -1.0_f32..1.0, y in -1.0_f32..1.0, z in -0.5_f32..0.5) {
            let mixer = mixer();
            let (squares, saturation) = mixer.mix(&wrench(6.4, x, y, z));
            // Nearly half of the cases. Counted as passed, because proptest limits the number of rejected cases.
            if saturation.roll_pitch {
                return Ok(());
            }
            let fits = |share: f32| {
                let r = x * mixer.per_roll_torque;
                let p = y * mixer.per_pitch_torque;
                let w = share * z * mixer.per_yaw_torque;
                let rotors = [r + p + w, p - r - w, w - r - p, r - p - w];
                let spread = rotors.iter().fold(f32::MIN, |m, s| m.max(*s)) - rotors.iter().fold(f32::MAX, |m, s| m.min(*s));
                spread <= mixer.max_square - mixer.min_square
            };
            let (mut low, mut high) = (0.0_f32, 1.0_f32);
            if fits(1.0) { low = 1.0; }
            for _ in 0..40 {
                let middle = 0.5 * (low + high);
                if fits(middle) { low = middle } else { high = middle }
            }
            prop_assert!((paper(squares)[3] - f64::from(low * z)).abs() < 1e-5);
        }
    }

    fn airframe() -> impl Strategy<Value = Airframe> {
        let coefficients =
            (-9.0..0.0_f32, -11.0..0.0_f32).prop_map(|(b, d)| (10.0_f32.powf(b), 10.0_f32.powf(d)));
        let place =
            (0.006..10.0_f32, 0.006..10.0_f32, prop::sample::select(&[Spin::PropsOut, Spin::PropsIn][..]));
        (coefficients, place, 1.0..1.0e4_f32, 0.0..0.499_f32).prop_map(
            |((b, d), (forward_m, right_m, spin), max_rad_s, idle)| Airframe {
                thrust_coefficient: b.max(1.0e-9),
                torque_coefficient: d.max(1.0e-11),
                forward_m,
                right_m,
                spin,
                idle_rad_s: idle * max_rad_s,
                max_rad_s,
                ..Airframe::OS4
            },
        )
    }

    proptest! {
        /// For any vehicle the mixer inverts the equations where the demand fits; a demand that does not fit gives
        /// speeds in range. The four parts of the demand are drawn as shares of the range of Ω².
        #[test]
        fn any_airframe_mixes_within_its_range(airframe in airframe(), share in prop::array::uniform4(-0.6..0.6_f32)) {
            let mixer = Mixer::new(&airframe).unwrap();
            let Airframe { thrust_coefficient: b, torque_coefficient: d, forward_m, right_m, .. } = airframe;
            let [b, d, forward, right] = [b, d, forward_m, right_m].map(f64::from);
            let (min, max) = (f64::from(airframe.idle_rad_s).powi(2), f64::from(airframe.max_rad_s).powi(2));
            prop_assert!((f64::from(mixer.max_thrust_n()) / (4.0 * b * max) - 1.0).abs() < 1e-6);

            // Eqs 4-7 for squares of c ± r ± p ± y, each a share of the range.
            let [c, r, p, y] = share.map(f64::from);
            let (middle, span) = (0.5 * (min + max), max - min);
            let anticlockwise = if airframe.spin == Spin::PropsOut { 1.0 } else { -1.0 };
            let units = [4.0 * b, 4.0 * b * right, 4.0 * b * forward, 4.0 * d * anticlockwise];
            let wanted = [middle + 0.5 * c * span, r * span, p * span, y * span];
            let demand: [f64; 4] = core::array::from_fn(|part| units[part] * wanted[part]);
            let [thrust_n, x, yy, z] = demand.map(|part| part as f32);
            let (squares, saturation) = mixer.mix(&wrench(thrust_n, x, yy, z));
            let rounding = 2e-6 * max;
            for square in squares.map(f64::from) {
                prop_assert!(square >= min - rounding && square <= max + rounding, "{}", square);
            }
            let exact: [f64; 4] = {
                let [c, r, p, y] = wanted;
                [c + r + p + y, c - r + p - y, c - r - p + y, c + r - p - y]
            };
            let fits = exact.iter().all(|square| *square > min + rounding && *square < max - rounding);
            if fits {
                prop_assert_eq!(saturation, Saturation::default());
                for (ours, exact) in squares.into_iter().zip(exact) {
                    prop_assert!((f64::from(ours) - exact).abs() < rounding, "{} {}", ours, exact);
                }
            }
            // The equations give the wrench of the squares, also where the demand did not fit.
            let [s1, s2, s3, s4] = squares.map(f64::from);
            let sums = [s1 + s2 + s3 + s4, s1 - s2 - s3 + s4, s1 + s2 - s3 - s4, s1 - s2 + s3 - s4];
            for ((ours, sum), unit) in parts(&mixer.produce(squares)).into_iter().zip(sums).zip(units) {
                prop_assert!((ours - 0.25 * unit * sum).abs() < 1e-6 * unit.abs() * max, "{} {}", ours, sum);
            }
        }

        /// Any demand, also NaN or infinite, gives speeds in the range of the rotors.
        #[test]
        fn any_demand_gives_speeds_in_range(
            demand in prop::array::uniform4(prop_oneof![ANY, -20.0..20.0_f32]), squares in prop::array::uniform4(ANY),
        ) {
            let [thrust_n, x, y, z] = demand;
            for speed in Mixer::speeds(mixer().mix(&wrench(thrust_n, x, y, z)).0) {
                prop_assert!((0.0..=319.001).contains(&speed), "{}", speed);
            }
            for (speed, square) in Mixer::speeds(squares).into_iter().zip(squares) {
                let exact = if square > 0.0 { f64::from(square).sqrt() } else { 0.0 };
                prop_assert_eq!(speed, exact as f32);
            }
        }

        #[test]
        fn any_airframe_is_valid_or_rejected(
            numbers in prop::array::uniform6(prop_oneof![
                3 => Just(None), 1 => ANY.prop_map(Some), 1 => (-1.0..20.0_f32).prop_map(Some),
            ]),
        ) {
            let [b, d, forward, right, idle, max] = numbers;
            let os4 = Airframe::OS4;
            let airframe = Airframe {
                thrust_coefficient: b.unwrap_or(os4.thrust_coefficient),
                torque_coefficient: d.unwrap_or(os4.torque_coefficient),
                forward_m: forward.unwrap_or(os4.forward_m),
                right_m: right.unwrap_or(os4.right_m),
                idle_rad_s: idle.unwrap_or(os4.idle_rad_s),
                max_rad_s: max.unwrap_or(os4.max_rad_s),
                ..os4
            };
            let valid = (1.0e-9..=1.0).contains(&airframe.thrust_coefficient)
                && (1.0e-11..=1.0).contains(&airframe.torque_coefficient)
                && (0.005..=10.0).contains(&airframe.forward_m)
                && (0.005..=10.0).contains(&airframe.right_m)
                && (1.0..=1.0e4).contains(&airframe.max_rad_s)
                && (0.0..=0.5 * airframe.max_rad_s).contains(&airframe.idle_rad_s);
            let mixer = Mixer::new(&airframe);
            prop_assert_eq!(mixer.is_ok(), valid);
            if let Ok(mixer) = mixer {
                prop_assert!(mixer.max_thrust_n().is_finite() && mixer.max_thrust_n() > 0.0);
            }
        }
    }

    /// Rotors with an idle speed of 2 rad/s and a maximum of 4 rad/s, 1 N per rad²/s² of the four together and
    /// likewise 1 N·m on each axis: the range of Ω² is 12 rad²/s².
    #[test]
    fn demand_that_just_fits_is_not_reduced() {
        let airframe = Airframe {
            thrust_coefficient: 0.25,
            torque_coefficient: 0.25,
            forward_m: 1.0,
            right_m: 1.0,
            idle_rad_s: 2.0,
            max_rad_s: 4.0,
            ..Airframe::OS4
        };
        let mixer = Mixer::new(&airframe).unwrap();
        for (x, z) in [(6.0, 0.0), (0.0, 6.0), (3.0, 3.0)] {
            assert_eq!(mixer.mix(&wrench(10.0, x, 0.0, z)).1, Saturation::default(), "{x} {z}");
        }
        assert!(mixer.mix(&wrench(10.0, 6.001, 0.0, 0.0)).1.roll_pitch);
        assert!(mixer.mix(&wrench(10.0, 0.0, 0.0, 6.001)).1.yaw);
        assert_eq!(mixer.max_thrust_n(), 16.0);
    }

    #[test]
    fn nan_thrust_gives_the_smallest_thrust() {
        let none = mixer().mix(&wrench(0.0, 0.1, 0.0, 0.0));
        assert_eq!(mixer().mix(&wrench(f32::NAN, 0.1, 0.0, 0.0)), none);
        assert_eq!(mixer().mix(&wrench(f32::NEG_INFINITY, 0.1, 0.0, 0.0)), none);
    }

    #[test]
    fn full_roll_full_yaw_and_hover() {
        let mixer = mixer();
        // Full thrust and full roll: the collective is reduced, the roll is kept.
        let (squares, saturation) = mixer.mix(&wrench(12.7, 0.5 * MAX_TILT_TORQUE, 0.0, 0.0));
        assert!((paper(squares)[1] - 0.52).abs() < 1e-4 && !saturation.roll_pitch);
        // With no thrust and full yaw, the collective thrust rises.
        let (squares, _) = mixer.mix(&wrench(0.0, 0.0, 0.0, 0.5 * MAX_YAW_TORQUE));
        assert!(paper(squares)[0] > 3.0);
        // In hover, the four rotors have an equal speed of 225.7 rad/s.
        let (squares, _) = mixer.mix(&wrench(0.65 * 9.80665, 0.0, 0.0, 0.0));
        for speed in Mixer::speeds(squares) {
            assert!((speed - 225.7).abs() < 0.1, "{speed}");
        }
    }

    #[test]
    fn rotor_positions_and_spins_give_the_signs() {
        // The expected values are from the geometry alone: cross products of lever arm and thrust, and reaction
        // torques of the rotors.
        let rotors = [(1.0, -1.0, 1.0), (1.0, 1.0, -1.0), (-1.0, 1.0, 1.0), (-1.0, -1.0, -1.0)];
        for (spin, turned) in [(Spin::PropsOut, 1.0), (Spin::PropsIn, -1.0)] {
            let airframe = Airframe { forward_m: 0.1, right_m: 0.2, spin, ..Airframe::OS4 };
            let mixer = Mixer::new(&airframe).unwrap();
            for (i, (forward, right, anticlockwise)) in rotors.into_iter().enumerate() {
                let mut squares = [0.0; 4];
                squares[i] = 1.0e4;
                let w = mixer.produce(squares);
                let thrust = vec3(0.0, 0.0, -3.13e-5 * 1.0e4);
                let torque = vec3(forward * 0.1, right * 0.2, 0.0).cross(thrust);
                let expected = vec3(torque.x, torque.y, turned * anticlockwise * 7.5e-7 * 1.0e4);
                assert!((w.torque_n_m - expected).norm() < 1e-6, "rotor {}", i + 1);
            }
        }
    }
}
