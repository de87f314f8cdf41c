//! The study `attitude`: attitude from gyroscope samples alone.
//!
//! The algorithms are those of the crate `alternatives`; the instructions of the same code are counted on
//! QEMU. A sample is the exact integral of the rates since the last one, so that the whole error is that of the
//! algorithm and its number format.

use std::f64::consts::TAU;
use std::hint::black_box;

use alternatives::Real;
use alternatives::integration::{Coning, EulerAngles};
use flight_core::geometry::{Quaternion, Vec3, vec3};

use super::integrator::top::{Top, tops};
use super::timing::shortest_ns;
use super::{Axis, Options, Progress, Setting, Study, m4};
use input::InputError;
use sim_host::attitude_error::AttitudeError;

/// Time integrated, s.
const SECONDS: u32 = 10;
/// Rate of the flight code's step, Hz.
const STEP_HZ: u32 = 1000;

/// Coning motion (Goodman and Robinson 1958): the attitude is a rotation by `a` about an axis that rotates in the
/// world's y-z plane at `w`.
#[derive(Clone, Copy)]
struct Cone {
    /// rad.
    a: f64,
    /// rad/s.
    w: f64,
}

#[derive(Clone, Copy)]
enum Motion {
    Cone(Cone),
    Top(Top),
}

impl Motion {
    /// Returns the true attitude.
    fn attitude(&self, t_s: f64) -> Quaternion<f64> {
        match self {
            Self::Cone(Cone { a, w }) => {
                let ((s, c), (sin, cos)) = (libm::sincos(0.5 * a), libm::sincos(w * t_s));
                Quaternion::new(c, 0.0, s * cos, s * sin)
            }
            Self::Top(top) => top.at(t_s).attitude,
        }
    }

    /// Returns the integral of the body rates from `t_s` over `h_s`, rad.
    fn turn(&self, t_s: f64, h_s: f64) -> Vec3<f64> {
        match self {
            Self::Cone(Cone { a, w }) => {
                let half = libm::sin(0.5 * a);
                let ((s0, c0), (s1, c1)) = (libm::sincos(w * t_s), libm::sincos(w * (t_s + h_s)));
                vec3(-2.0 * half * half * w * h_s, libm::sin(*a) * (c1 - c0), libm::sin(*a) * (s1 - s0))
            }
            Self::Top(top) => top.turn(t_s, h_s),
        }
    }
}

fn narrowed<T: Real>(v: Vec3<f64>) -> Vec3<T> {
    vec3(T::of(v.x), T::of(v.y), T::of(v.z))
}

fn start<T: Real>(q: Quaternion<f64>) -> Quaternion<T> {
    Quaternion { w: T::of(q.w), v: narrowed(q.v) }
}

fn by_coning<T: Real, const N: usize>(from: Quaternion<f64>, turns: &[Vec3<T>]) -> Quaternion<T> {
    let mut algorithm = Coning::<T, N>::new(start(from));
    turns.iter().for_each(|&turn| algorithm.step(turn));
    algorithm.attitude()
}

fn by_euler_angles<T: Real>(from: Quaternion<f64>, turns: &[Vec3<T>]) -> Quaternion<T> {
    let m = from.to_matrix();
    let roll = libm::atan2(m[2].y, m[2].z);
    let pitch = -libm::asin(m[2].x.clamp(-1.0, 1.0));
    let yaw = libm::atan2(m[1].x, m[0].x);
    let mut algorithm = EulerAngles { angles: narrowed(vec3(roll, pitch, yaw)) };
    turns.iter().for_each(|&turn| algorithm.step(turn));
    algorithm.attitude()
}

/// The algorithms: the name in `m4.toml`, and the number of samples for one attitude.
const ALGORITHMS: [(&str, u32); 4] =
    [("Euler angles", 1), ("1 sample", 1), ("2 samples", 2), ("3 samples", 3)];

fn integrated<T: Real>(algorithm: usize, from: Quaternion<f64>, turns: &[Vec3<T>]) -> Quaternion<T> {
    match algorithm {
        0 => by_euler_angles(from, turns),
        1 => by_coning::<T, 1>(from, turns),
        2 => by_coning::<T, 2>(from, turns),
        _ => by_coning::<T, 3>(from, turns),
    }
}

/// Returns the error at the end, rad, and the run time of the whole integration, ns.
fn judged<T: Real + Into<f64>>(
    options: &Options,
    algorithm: usize,
    motion: &Motion,
    turns: &[Vec3<f64>],
    end_s: f64,
) -> (f64, Option<f64>) {
    let turns: Vec<Vec3<T>> = turns.iter().map(|&turn| narrowed(turn)).collect();
    let from = motion.attitude(0.0);
    let [w, x, y, z] = integrated(algorithm, from, &turns).to_array().map(T::into);
    let error = AttitudeError::between(Quaternion::new(w, x, y, z), motion.attitude(end_s)).total_rad;
    let time = shortest_ns(options, || {
        black_box(integrated(algorithm, from, black_box(&turns)));
    });
    (error, time)
}

/// Runs the study.
///
/// # Errors
/// None.
pub fn study(options: &Options, progress: Progress) -> Result<Study, InputError> {
    let all = [250, 500, 1000, 2000, 4000, 8000];
    let rates: &[u32] = if options.quick { &all[1..4] } else { &all };
    let cone = Cone { a: 1.0_f64.to_radians(), w: TAU * 20.0 };
    let problems = [("coning, 1° at 20 Hz", Motion::Cone(cone)), ("tumbling top", Motion::Top(tops()[1].1))];
    let mut settings = Vec::new();
    for (n, (problem, motion)) in problems.iter().enumerate() {
        for (k, &rate_hz) in rates.iter().enumerate() {
            let h = 1.0 / f64::from(rate_hz);
            let turns: Vec<Vec3<f64>> =
                (0..rate_hz * SECONDS).map(|k| motion.turn(f64::from(k) * h, h)).collect();
            for (algorithm, (name, samples)) in ALGORITHMS.iter().enumerate() {
                let count = turns.len() / *samples as usize * *samples as usize;
                let (turns, end_s) = (&turns[..count], count as f64 * h);
                for bits in ["f32", "f64"] {
                    let (error, time) = if bits == "f32" {
                        judged::<f32>(options, algorithm, motion, turns, end_s)
                    } else {
                        judged::<f64>(options, algorithm, motion, turns, end_s)
                    };
                    let series = format!("{name}, {bits}");
                    let figure = m4::figure(&format!("integration {name} {bits}"));
                    settings.push(Setting {
                        problem,
                        setting: format!("{series}, {rate_hz} Hz"),
                        error: Some(error),
                        error_unit: "rad after 10 s",
                        host_ns: time.map(|ns| ns / end_s),
                        m4_instructions: figure.map(|f| f.instructions * f64::from(rate_hz)),
                        flash_bytes: figure.and_then(|figure| figure.flash_bytes),
                        also: vec![("attitude_hz", f64::from(rate_hz / samples))],
                        default: series == "1 sample, f32" && rate_hz == STEP_HZ,
                        series,
                        ..Setting::default()
                    });
                }
            }
            progress((n as f64 + (k + 1) as f64 / rates.len() as f64) / problems.len() as f64);
        }
    }
    // Sorted by problem, so that each problem's settings follow each other.
    settings.sort_by_key(|s: &Setting| problems.iter().position(|(problem, _)| *problem == s.problem));
    Ok(Study {
        name: "attitude",
        title: "Attitude from gyroscope samples",
        about: "The error is the angle between the computed and the true attitude after 10 s, from samples of a perfect \
                gyroscope that integrates between them. A shaken vehicle moves in coning motion: the axis of rotation \
                itself rotates."
            .into(),
        reference: "Closed forms of the attitude: for coning motion by Goodman and Robinson (1958), for the free top by \
                    elliptic functions."
            .into(),
        per: "a second of flight",
        axis: Axis::M4,
        axis_title: "instructions per second on the Cortex-M4F",
        settings,
        remarks: vec![
            "For the tumbling top f32 reaches 1e-6 to 2e-5 rad, the rounding of thousands of samples; beyond that, more \
             samples a second increase the error. f64 has no such limit here, but this chip computes it in software, with 70 to \
             100 times as many instructions."
                .into(),
            "The algorithms of two and three samples update the attitude only once in as many samples: this is cheaper and \
             more accurate, but later. The controller needs an attitude at every step of 1 kHz. Of the quaternion algorithms \
             that deliver it, one sample at 1 kHz costs least. In this coning motion, which is strong for a vehicle in flight, \
             it drifts by a²ω β²/12, half a milliradian in 10 s: as much as a gyroscope bias of 0.003 °/s."
                .into(),
            "Euler angles are a method of first order, and fail where the top's axis passes the vertical.".into(),
        ],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coning_drift_matches_the_closed_form() {
        // For one sample at 500 Hz the error is sin²a/2 (β − sin β)/h, with β = ω h.
        let cone = Cone { a: 1.0_f64.to_radians(), w: TAU * 20.0 };
        let motion = Motion::Cone(cone);
        let h = 1.0 / 500.0;
        let turns: Vec<Vec3<f64>> = (0..5000).map(|k| motion.turn(f64::from(k) * h, h)).collect();
        let options = Options { quick: true, timed: false, recordings: None };
        let (error, _) = judged::<f64>(&options, 1, &motion, &turns, 10.0);
        let beta = cone.w * h;
        let expected = 10.0 * 0.5 * cone.a.sin().powi(2) * (beta - beta.sin()) / h;
        assert!((error / expected - 1.0).abs() < 0.02, "{error} against {expected}");
    }

    #[test]
    fn three_samples_follow_the_top_closely() {
        let (_, top) = tops()[1];
        let motion = Motion::Top(top);
        let h = 1.0 / 3000.0;
        let turns: Vec<Vec3<f64>> = (0..9000).map(|k| motion.turn(f64::from(k) * h, h)).collect();
        let options = Options { quick: true, timed: false, recordings: None };
        let (error, _) = judged::<f64>(&options, 3, &motion, &turns, 3.0);
        assert!(error < 1e-10, "{error}");
    }
}
