//! The free asymmetric top in closed form.
//!
//! Euler's equations without torque have Jacobi's elliptic functions as their solution (Landau and Lifshitz,
//! *Mechanics*, § 37). With the angular momentum L along the world's z axis, nutation and spin follow from the
//! direction of L in the body. The precession is the integral of a known smooth function of time, computed by
//! Gauss's rule. No differential equation is solved.

use flight_core::geometry::{Quaternion, Vec3, vec3};

use super::elliptic::{Jacobi, jacobi, quarter_period};
use super::methods::Motion;
use sim_host::dynamics::State;

/// Gauss's rule of five points on [−1, 1]: two pairs of points with their weights, and the weight of the middle point.
const GAUSS: [(f64, f64); 2] =
    [(0.538_469_310_105_683_1, 0.478_628_670_499_366_5), (0.906_179_845_938_664, 0.236_926_885_056_189_1)];
const GAUSS_MIDDLE: f64 = 0.568_888_888_888_888_9;

/// A rigid body without torque. I_x < I_y < I_z.
#[derive(Clone, Copy, Debug)]
pub struct Top {
    inertia: Vec3<f64>,
    /// Largest rates about the three axes, rad/s.
    amplitudes: Vec3<f64>,
    /// Rate of the elliptic functions' argument, 1/s, and the argument at time 0.
    rate: f64,
    start: f64,
    /// Their complementary parameter 1 − k².
    m1: f64,
    /// Whether the rate that never vanishes is that about x; otherwise it is that about z.
    about_x: bool,
    momentum: f64,
}

impl Top {
    /// Creates the motion that starts with these body rates, rad/s. Either the rate about y must be 0, or the rate
    /// about the other axis whose rate changes its sign.
    pub fn new(inertia: Vec3<f64>, rates: Vec3<f64>) -> Self {
        let Vec3 { x: a, y: b, z: c } = inertia;
        // In Landau and Lifshitz the third axis is the one whose rate never vanishes if L² > 2 E I_y; otherwise first
        // and third axis are exchanged. These are sums of I ω² times differences of inertias. Unlike L² − 2 E I_y they
        // do not cancel near the separatrix.
        let weighed = |by: fn(f64, f64) -> f64, with: f64| {
            let each = vec3(by(a, with), by(b, with), by(c, with));
            rates.scale_by(rates).scale_by(inertia).dot(each)
        };
        let excess = weighed(|i, b| i - b, b);
        let about_x = excess < 0.0;
        let (first, third) = if about_x { (c, a) } else { (a, c) };
        let near = weighed(|i, third| third - i, third);
        let far = weighed(|i, first| i - first, first);
        let one = libm::sqrt(near / (first * (third - first)));
        let two = libm::sqrt(near / (b * (third - b)));
        let three = libm::sqrt(far / (third * (third - first)));
        let m1 = (third - first) * excess / ((third - b) * far);
        Self {
            inertia,
            amplitudes: if about_x { vec3(three, two, one) } else { vec3(one, two, three) },
            rate: libm::sqrt((third - b) * far / (a * b * c)),
            start: if rates.y == 0.0 { 0.0 } else { quarter_period(m1) },
            m1,
            about_x,
            momentum: rates.scale_by(inertia).norm(),
        }
    }

    /// Returns the body rates, rad/s.
    fn rates(&self, t_s: f64) -> Vec3<f64> {
        let Jacobi { sn, cn, dn } = jacobi(self.start + self.rate * t_s, self.m1);
        let functions = if self.about_x { vec3(dn, sn, cn) } else { vec3(cn, sn, dn) };
        // ω̇_y = (I_z − I_x)/I_y ω_z ω_x is positive at sn = 0 in both cases.
        self.amplitudes.scale_by(functions)
    }

    /// Returns the integral of the rates from `t_s` over `h_s`, as a gyroscope integrates them, rad, by Gauss's rule.
    pub fn turn(&self, t_s: f64, h_s: f64) -> Vec3<f64> {
        let at = |x: f64| self.rates(t_s + 0.5 * h_s * (1.0 + x));
        let sides = GAUSS.iter().fold(Vec3::ZERO, |sum, &(x, w)| sum + (at(-x) + at(x)) * w);
        (at(0.0) * GAUSS_MIDDLE + sides) * (0.5 * h_s)
    }

    /// Returns the precession rate, φ̇ = L (I_x ω_x² + I_y ω_y²)/(I_x² ω_x² + I_y² ω_y²).
    fn precession_rate(&self, t_s: f64) -> f64 {
        let w = self.rates(t_s);
        let l = w.scale_by(self.inertia);
        self.momentum * (l.x * w.x + l.y * w.y) / (l.x * l.x + l.y * l.y)
    }

    /// Returns the precession after a time, by Gauss's rule of five points in pieces of 1/50 of the functions' time
    /// scale.
    fn precession(&self, t_s: f64) -> f64 {
        let pieces = libm::ceil((t_s * self.rate * 50.0).max(1.0));
        let h = 0.5 * t_s / pieces;
        let piece = |k: u32| {
            let at = h * (2.0 * f64::from(k) + 1.0);
            let sides: f64 = GAUSS
                .iter()
                .map(|(x, w)| w * (self.precession_rate(at - x * h) + self.precession_rate(at + x * h)))
                .sum();
            h * (GAUSS_MIDDLE * self.precession_rate(at) + sides)
        };
        (0..pieces as u32).map(piece).sum()
    }

    /// Returns attitude and rates after this time. The world's z axis is along the angular momentum.
    pub fn at(&self, t_s: f64) -> State {
        let rates = self.rates(t_s);
        let l = rates.scale_by(self.inertia);
        let level = libm::sqrt(l.x * l.x + l.y * l.y);
        let nutation = libm::atan2(level, l.z);
        let spin = libm::atan2(l.x, l.y);
        let turn = |about: Vec3<f64>, angle: f64| Quaternion {
            w: libm::cos(0.5 * angle),
            v: about * libm::sin(0.5 * angle),
        };
        let attitude = turn(Vec3::Z, self.precession(t_s)) * turn(Vec3::X, nutation) * turn(Vec3::Z, spin);
        State { position: Vec3::ZERO, velocity: Vec3::ZERO, attitude, rates }
    }
}

impl Motion for Top {
    fn accelerations(&self, _: f64, state: &State) -> (Vec3<f64>, Vec3<f64>) {
        let torque = -state.rates.cross(state.rates.scale_by(self.inertia));
        let Vec3 { x, y, z } = self.inertia;
        (Vec3::ZERO, vec3(torque.x / x, torque.y / y, torque.z / z))
    }
}

/// Inertia of the tops, kg·m²: OS4's smallest and largest, and a value between them.
pub const INERTIA: Vec3<f64> = vec3(7.5e-3, 1.0e-2, 1.3e-2);

/// Returns the three tops: one that turns about the z axis with nutation, one that tumbles about the x axis, and one
/// that starts about the intermediate axis near the separatrix, so that the body turns over again and again.
pub fn tops() -> [(&'static str, Top); 3] {
    [
        ("top about its major axis", Top::new(INERTIA, vec3(3.0, 0.0, 8.0))),
        ("tumbling top", Top::new(INERTIA, vec3(8.0, 0.0, 3.0))),
        ("top about its intermediate axis", Top::new(INERTIA, vec3(0.0, 8.0, 0.01))),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The closed form satisfies its differential equations: 4th-order central differences equal the right sides of
    /// Euler's equations and of q̇ = ½ q ω.
    #[test]
    fn closed_form_solves_the_equations() {
        for (name, top) in tops() {
            for t in [0.0, 0.7, 3.3, 9.9] {
                let h = 1e-3;
                let difference = |f: &dyn Fn(f64) -> Vec3<f64>| {
                    ((f(t + h) - f(t - h)) * 8.0 - (f(t + 2.0 * h) - f(t - 2.0 * h))) * (1.0 / (12.0 * h))
                };
                let state = top.at(t);
                let (_, acceleration) = top.accelerations(t, &state);
                let slope = difference(&|t| top.at(t).rates);
                assert!((slope - acceleration).norm() < 1e-7, "{name} at {t}: {slope:?} {acceleration:?}");
                // In the world, a body axis b moves with R (ω × b).
                for axis in [Vec3::X, Vec3::Z] {
                    let moves = state.attitude.rotate(state.rates.cross(axis));
                    let slope = difference(&|t| top.at(t).attitude.rotate(axis));
                    assert!((slope - moves).norm() < 1e-7, "{name} at {t}: {slope:?} {moves:?}");
                }
                // The angular momentum stays along the world's z axis.
                let momentum = state.attitude.rotate(state.rates.scale_by(INERTIA));
                assert!((momentum - Vec3::Z * top.momentum).norm() < 1e-14, "{name} at {t}");
            }
        }
    }

    #[test]
    fn third_top_starts_on_its_intermediate_axis_and_flips() {
        let (_, top) = tops()[2];
        let start = top.at(0.0).rates;
        assert!((start - vec3(0.0, 8.0, 0.01)).norm() < 1e-9, "{start:?}");
        let turned: Vec<f64> = (0..100).map(|k| top.at(f64::from(k) * 0.1).rates.y).collect();
        assert!(turned.iter().any(|y| *y < -7.9) && turned.iter().any(|y| *y > 7.9));
    }
}
