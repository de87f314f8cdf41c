//! Attitude from gyroscope samples alone.
//!
//! A sample is the integral of the body rates since the last sample, rad: the mean rate times the sample period.
//!
//! | | drift in coning motion of half-angle a at ω, β = ω × sample period | attitude every |
//! |---|---|---|
//! | [`EulerAngles`] | first order, singular at a pitch of ±90° | sample |
//! | [`Coning`] of 1 sample | a²ω β²/12 | sample |
//! | [`Coning`] of 2 samples | a²ω β⁴/60 | 2 samples |
//! | [`Coning`] of 3 samples | a²ω β⁶/280 | 3 samples |
//!
//! While the axis of rotation itself moves, rotations about the body's axes must not be added: a sample holds their
//! sum, and the error is ½ ∫ α × dα over the update. In coning motion, as of a shaken vehicle, this error has a mean,
//! and the attitude drifts. Two samples give the change of the rates, three also the change of that change. The
//! integral follows from these changes (R. B. Miller, *A new strapdown attitude algorithm*, Journal of Guidance 6,
//! 1983; the coefficients for three samples are those that are best for coning motion).

use flight_core::geometry::{Quaternion, Vec3};

use crate::Real;

/// Euler angles, integrated by a first-order step of their kinematics.
#[derive(Clone, Copy, Debug)]
pub struct EulerAngles<T> {
    /// Roll, pitch and yaw, rad.
    pub angles: Vec3<T>,
}

impl<T: Real> EulerAngles<T> {
    /// Adds one sample, rad. Within 0.06° of the vertical, 1/cos θ is limited, as in `flight-core`'s filter.
    #[inline(always)]
    pub fn step(&mut self, turn: Vec3<T>) {
        let (sin_roll, cos_roll) = self.angles.x.sin_cos();
        let (sin_pitch, cos_pitch) = self.angles.y.sin_cos();
        let min_cos = T::of(0.001);
        let cos_pitch = if cos_pitch >= T::ZERO {
            if cos_pitch > min_cos { cos_pitch } else { min_cos }
        } else if cos_pitch < -min_cos {
            cos_pitch
        } else {
            -min_cos
        };
        let yaw = (turn.y * sin_roll + turn.z * cos_roll) / cos_pitch;
        let pitch = turn.y * cos_roll - turn.z * sin_roll;
        self.angles += Vec3 { x: turn.x + yaw * sin_pitch, y: pitch, z: yaw };
    }

    /// Returns the attitude, body to world.
    pub fn attitude(&self) -> Quaternion<T> {
        let half = |angle: T| (angle * T::of(0.5)).sin_cos();
        Quaternion::from_half_angles(half(self.angles.x), half(self.angles.y), half(self.angles.z))
    }
}

/// A quaternion that is rotated by the rotation vector of `N` samples: 1, 2 or 3.
#[derive(Clone, Copy, Debug)]
pub struct Coning<T, const N: usize> {
    attitude: Quaternion<T>,
    turns: [Vec3<T>; N],
    taken: usize,
}

impl<T: Real, const N: usize> Coning<T, N> {
    const KNOWN: () = assert!(N >= 1 && N <= 3, "a coning algorithm of 1, 2 or 3 samples");

    /// Returns the integrator with this attitude, body to world.
    pub fn new(attitude: Quaternion<T>) -> Self {
        let () = Self::KNOWN;
        Self { attitude, turns: [Vec3::ZERO; N], taken: 0 }
    }

    /// Adds one sample, rad. Every `N`th sample updates the attitude.
    #[inline(always)]
    pub fn step(&mut self, turn: Vec3<T>) {
        if let Some(slot) = self.turns.get_mut(self.taken) {
            *slot = turn;
        }
        self.taken += 1;
        if self.taken < N {
            return;
        }
        self.taken = 0;
        let rotation = match self.turns[..] {
            [a, b] => a + b + a.cross(b) * T::of(2.0 / 3.0),
            [a, b, c] => a + b + c + a.cross(c) * T::of(9.0 / 20.0) + b.cross(c - a) * T::of(27.0 / 40.0),
            _ => turn,
        };
        let q = self.attitude * T::rotation(rotation);
        // One Newton step for 1/√n, at n = 1, normalizes the quaternion.
        self.attitude = q.scaled(T::of(1.5) - T::of(0.5) * q.norm_squared());
    }

    /// Returns the attitude, body to world, as of the last complete update.
    pub fn attitude(&self) -> Quaternion<T> {
        self.attitude
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flight_core::geometry::vec3;
    use std::vec::Vec;

    /// Coning motion (Goodman and Robinson 1958): the attitude is a rotation by `a` about an axis that rotates in the
    /// world's y-z plane at `w`. Its body rates are (−2ω sin²(a/2), −ω sin a sin ωt, ω sin a cos ωt).
    #[derive(Clone, Copy)]
    struct Cone {
        a: f64,
        w: f64,
    }

    impl Cone {
        fn attitude(self, t: f64) -> Quaternion<f64> {
            let (s, c) = (0.5 * self.a).sin_cos();
            let (sin, cos) = (self.w * t).sin_cos();
            Quaternion::new(c, 0.0, s * cos, s * sin)
        }

        /// Returns the integral of the body rates from `t` over `h`.
        fn turn(self, t: f64, h: f64) -> Vec3<f64> {
            let Self { a, w } = self;
            let half = (0.5 * a).sin();
            let (s0, c0) = (w * t).sin_cos();
            let (s1, c1) = (w * (t + h)).sin_cos();
            vec3(-2.0 * half * half * w * h, a.sin() * (c1 - c0), a.sin() * (s1 - s0))
        }

        /// Returns the drift about x, rad/s, of an algorithm with updates of `n` samples of `h` and these coefficients
        /// of the cross products (`adjacent` of neighbours, `apart` of the first and third). In closed form: the
        /// error ½ ∫ α × dα is ½ sin²a (nβ − sin nβ), and the product of samples m apart is
        /// 4 sin²(β/2) sin²a sin mβ.
        fn drift(self, n: f64, h: f64, adjacent: f64, apart: f64) -> f64 {
            let beta = self.w * h;
            let missing = 0.5 * (n * beta - (n * beta).sin());
            let estimated =
                4.0 * (0.5 * beta).sin().powi(2) * (adjacent * beta.sin() + apart * (2.0 * beta).sin());
            self.a.sin().powi(2) * (missing - estimated) / (n * h)
        }
    }

    /// Returns the error angle about x after `updates` updates.
    fn error<const N: usize>(cone: Cone, h: f64, updates: u32) -> f64 {
        let mut algorithm = Coning::<f64, N>::new(cone.attitude(0.0));
        let samples = updates * N as u32;
        for k in 0..samples {
            algorithm.step(cone.turn(f64::from(k) * h, h));
        }
        let exact = cone.attitude(f64::from(samples) * h);
        let off = algorithm.attitude() * exact.conjugate();
        2.0 * off.v.x.atan2(off.w)
    }

    #[test]
    fn coning_drifts_match_the_closed_form() {
        let cone = Cone { a: 0.01, w: 100.0 };
        for h in [2e-3, 4e-3] {
            let drift = |n: usize, error: f64| error / (f64::from(3_000 / n as u32) * n as f64 * h);
            for (name, measured, expected) in [
                ("1 sample", drift(1, error::<1>(cone, h, 3_000)), cone.drift(1.0, h, 0.0, 0.0)),
                ("2 samples", drift(2, error::<2>(cone, h, 1_500)), cone.drift(2.0, h, 2.0 / 3.0, 0.0)),
                ("3 samples", drift(3, error::<3>(cone, h, 1_000)), cone.drift(3.0, h, 1.35, 0.45)),
            ] {
                let ratio = -measured / expected;
                std::println!("{name}, {h} s: {measured:e} rad/s, closed form {expected:e}, {ratio}");
                assert!((ratio - 1.0).abs() < 0.02, "{name}: {measured:e} against {expected:e} rad/s");
            }
        }
    }

    #[test]
    fn leading_terms_match_the_table() {
        let cone = Cone { a: 1e-3, w: 1.0 };
        // Expressed with the update ΔT = nh, the errors are (ωΔT)²/12, (ωΔT)⁴/960 and (ωΔT)⁶/204,120.
        let a2 = cone.a.sin().powi(2);
        let beta: f64 = 0.05;
        for (n, adjacent, apart, leading) in [
            (1.0, 0.0, 0.0, beta.powi(2) / 12.0),
            (2.0, 2.0 / 3.0, 0.0, beta.powi(4) / 60.0),
            (3.0, 1.35, 0.45, beta.powi(6) / 280.0),
        ] {
            let ratio = cone.drift(n, beta, adjacent, apart) / (a2 * leading);
            assert!((ratio - 1.0).abs() < 0.01, "{n} samples: {ratio}");
        }
    }

    /// Returns the gyroscope's sample in a tumbling motion without symmetry.
    fn tumbling(t: f64, h: f64) -> Vec3<f64> {
        let swing = |amplitude: f64, w: f64, phase: f64| {
            amplitude * ((w * (t + h) + phase).sin() - (w * t + phase).sin())
        };
        vec3(swing(0.6, 2.0, 0.0), swing(0.5, 3.1, 1.0), swing(0.7, 1.3, 2.0))
    }

    #[test]
    fn euler_angles_converge_to_the_quaternion_at_first_order() {
        let euler = |h: f64| {
            let mut e = EulerAngles::<f64> { angles: Vec3::ZERO };
            for k in 0..(3.0 / h) as u32 {
                e.step(tumbling(f64::from(k) * h, h));
            }
            e.attitude()
        };
        let mut fine = Coning::<f64, 3>::new(Quaternion::IDENTITY);
        let h = 3.0 / 24_576.0;
        for k in 0..24_576 {
            fine.step(tumbling(f64::from(k) * h, h));
        }
        let errors: Vec<f64> = [1.0 / 128.0, 1.0 / 256.0, 1.0 / 512.0]
            .iter()
            .map(|&h| 2.0 * (euler(h) * fine.attitude().conjugate()).v.norm())
            .collect();
        for pair in errors.windows(2) {
            let order = (pair[0] / pair[1]).log2();
            assert!((0.8..1.2).contains(&order), "{errors:?}: order {order}");
        }
    }

    #[test]
    fn f32_integration_matches_f64() {
        let cone = Cone { a: 0.05, w: 60.0 };
        let (h, samples) = (1e-3, 3_000);
        let narrow = |v: Vec3<f64>| vec3(v.x as f32, v.y as f32, v.z as f32);
        let mut short = Coning::<f32, 3>::new(Quaternion::new(1.0, 0.0, 0.0, 0.0));
        let mut long = Coning::<f64, 3>::new(Quaternion::IDENTITY);
        let mut angles =
            (EulerAngles { angles: Vec3::<f32>::ZERO }, EulerAngles { angles: Vec3::<f64>::ZERO });
        for k in 0..samples {
            let turn = cone.turn(f64::from(k) * h, h);
            short.step(narrow(turn));
            long.step(turn);
            angles.0.step(narrow(turn));
            angles.1.step(turn);
        }
        let apart = |a: Quaternion<f32>, b: Quaternion<f64>| {
            let [w, x, y, z] = a.to_array().map(f64::from);
            2.0 * (Quaternion::new(w, x, y, z) * b.conjugate()).v.norm()
        };
        // The difference is below the sum of 3,000 roundings of 6e-8.
        assert!(apart(short.attitude(), long.attitude()) < 2e-5);
        assert!(apart(angles.0.attitude(), angles.1.attitude()) < 2e-5);
    }

    #[test]
    fn rotation_series_matches_the_closed_form() {
        for angle in [1e-9, 0.01, 0.3, 0.499, 0.501, 3.0_f64] {
            let q = f64::rotation(vec3(0.6 * angle, 0.0, 0.8 * angle));
            let (s, c) = (0.5 * angle).sin_cos();
            assert!((q.w - c).abs() < 3e-16 && (q.v.norm() - s).abs() < 3e-16, "{angle}");
        }
    }
}
