//! The integration methods that are compared.

use flight_core::geometry::{Quaternion, Vec3, vec3};
use ode_solvers::{Dopri5, OutputType, SVector, System};

use sim_host::dynamics::State;

/// The motion of a body, given by its accelerations.
pub trait Motion {
    /// Returns the linear acceleration in world axes, m/s², and the angular acceleration in body axes, rad/s².
    fn accelerations(&self, t_s: f64, state: &State) -> (Vec3<f64>, Vec3<f64>);
}

/// A method with a fixed step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fixed {
    /// Rates and velocity first, then position and attitude from the new values; the attitude by the exact rotation.
    SemiImplicitEuler,
    /// The classical Runge-Kutta method on the components of the quaternion, which is normalised after each step:
    /// the method of [`sim_host::dynamics`].
    Rk4,
    /// The same tableau on the rotation vector of the step (Munthe-Kaas 1998): the attitude always stays a
    /// unit quaternion.
    Rkmk4,
}

impl Fixed {
    /// All methods.
    pub const ALL: [Self; 3] = [Self::SemiImplicitEuler, Self::Rk4, Self::Rkmk4];

    /// Returns the name for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::SemiImplicitEuler => "semi-implicit Euler",
            Self::Rk4 => "RK4",
            Self::Rkmk4 => "RKMK4 (Lie group)",
        }
    }

    /// Returns the number of evaluations of the accelerations in a step.
    pub fn evaluations(self) -> u32 {
        match self {
            Self::SemiImplicitEuler => 1,
            Self::Rk4 | Self::Rkmk4 => 4,
        }
    }

    /// Advances the state by one step of `h` seconds.
    #[inline]
    pub fn step(self, motion: &impl Motion, t: f64, at: &State, h: f64) -> State {
        match self {
            Self::SemiImplicitEuler => {
                let (linear, angular) = motion.accelerations(t, at);
                let (velocity, rates) = (at.velocity + linear * h, at.rates + angular * h);
                State {
                    position: at.position + velocity * h,
                    velocity,
                    attitude: (at.attitude * rotation(rates * h)).normalized(),
                    rates,
                }
            }
            Self::Rk4 => rk4(motion, t, at, h),
            Self::Rkmk4 => rkmk4(motion, t, at, h),
        }
    }
}

/// Returns the rotation by the rotation vector r, rad.
fn rotation(r: Vec3<f64>) -> Quaternion<f64> {
    let angle = r.norm();
    // sin(x/2)/x = ½ − x²/48 to f64 below 1e-3: x⁴/3840 is 3e-16.
    let ratio = if angle < 1e-3 { 0.5 - angle * angle / 48.0 } else { libm::sin(0.5 * angle) / angle };
    Quaternion { w: libm::cos(0.5 * angle), v: r * ratio }
}

/// The derivative of a state.
struct Slope {
    velocity: Vec3<f64>,
    linear: Vec3<f64>,
    /// Of the quaternion, or of the rotation vector.
    turn: [f64; 4],
    angular: Vec3<f64>,
}

/// ½ q ⊗ ω.
fn quaternion_slope(q: Quaternion<f64>, w: Vec3<f64>) -> [f64; 4] {
    (q * Quaternion { w: 0.0, v: w * 0.5 }).to_array()
}

fn rk4(motion: &impl Motion, t: f64, at: &State, h: f64) -> State {
    let moved = |slope: &Slope, h: f64| {
        let [w, x, y, z] = slope.turn;
        State {
            position: at.position + slope.velocity * h,
            velocity: at.velocity + slope.linear * h,
            attitude: Quaternion { w: at.attitude.w + w * h, v: at.attitude.v + vec3(x, y, z) * h },
            rates: at.rates + slope.angular * h,
        }
    };
    let slope = |t: f64, state: &State| {
        let (linear, angular) = motion.accelerations(t, state);
        Slope {
            velocity: state.velocity,
            linear,
            turn: quaternion_slope(state.attitude, state.rates),
            angular,
        }
    };
    let k1 = slope(t, at);
    let k2 = slope(t + 0.5 * h, &moved(&k1, 0.5 * h));
    let k3 = slope(t + 0.5 * h, &moved(&k2, 0.5 * h));
    let k4 = slope(t + h, &moved(&k3, h));
    let mut end = moved(&mean(&[k1, k2, k3, k4]), h);
    end.attitude = end.attitude.normalized();
    end
}

fn mean([k1, k2, k3, k4]: &[Slope; 4]) -> Slope {
    let sum = |f: fn(&Slope) -> Vec3<f64>| (f(k1) + (f(k2) + f(k3)) * 2.0 + f(k4)) * (1.0 / 6.0);
    Slope {
        velocity: sum(|k| k.velocity),
        linear: sum(|k| k.linear),
        turn: std::array::from_fn(|i| (k1.turn[i] + (k2.turn[i] + k3.turn[i]) * 2.0 + k4.turn[i]) / 6.0),
        angular: sum(|k| k.angular),
    }
}

fn rkmk4(motion: &impl Motion, t: f64, at: &State, h: f64) -> State {
    let moved = |slope: &Slope, h: f64| {
        let [x, y, z, _] = slope.turn;
        let turned = vec3(x, y, z) * h;
        let state = State {
            position: at.position + slope.velocity * h,
            velocity: at.velocity + slope.linear * h,
            attitude: at.attitude * rotation(turned),
            rates: at.rates + slope.angular * h,
        };
        (state, turned)
    };
    let slope = |t: f64, (state, turned): &(State, Vec3<f64>)| {
        let (linear, angular) = motion.accelerations(t, state);
        // The rotation vector u of the step grows at ω + ½ u × ω + 1/12 u × (u × ω) + O(u⁴).
        let w = state.rates;
        let cross = turned.cross(w);
        let turn = w + cross * 0.5 + turned.cross(cross) * (1.0 / 12.0);
        Slope { velocity: state.velocity, linear, turn: [turn.x, turn.y, turn.z, 0.0], angular }
    };
    let k1 = slope(t, &(*at, Vec3::ZERO));
    let k2 = slope(t + 0.5 * h, &moved(&k1, 0.5 * h));
    let k3 = slope(t + 0.5 * h, &moved(&k2, 0.5 * h));
    let k4 = slope(t + h, &moved(&k3, h));
    let (mut end, _) = moved(&mean(&[k1, k2, k3, k4]), h);
    end.attitude = end.attitude.normalized();
    end
}

type Vector = SVector<f64, 13>;

struct Equations<'a, M>(&'a M);

impl<M: Motion> System<f64, Vector> for Equations<'_, M> {
    fn system(&self, t: f64, y: &Vector, slope: &mut Vector) {
        let state = unpacked(y);
        let (linear, angular) = self.0.accelerations(t, &state);
        let turn = quaternion_slope(state.attitude, state.rates);
        *slope = packed(state.velocity, linear, turn, angular);
    }
}

fn packed(position: Vec3<f64>, velocity: Vec3<f64>, turn: [f64; 4], rates: Vec3<f64>) -> Vector {
    let [p, v, w] = [position, velocity, rates].map(<[f64; 3]>::from);
    Vector::from_iterator(p.into_iter().chain(v).chain(turn).chain(w))
}

fn unpacked(y: &Vector) -> State {
    State {
        position: vec3(y[0], y[1], y[2]),
        velocity: vec3(y[3], y[4], y[5]),
        attitude: Quaternion::new(y[6], y[7], y[8], y[9]),
        rates: vec3(y[10], y[11], y[12]),
    }
}

/// Integrates with the Dormand-Prince method of order 5 (4) of the crate `ode_solvers`, which chooses its own steps.
/// Returns the state at `end` and the number of evaluations. The first step is tried with `first_s`; with 0 the method
/// estimates one.
///
/// # Panics
/// The method fails, or its last point is not at `end`. Neither happens for smooth motions.
pub fn dormand_prince(
    motion: &impl Motion,
    (start, end): (f64, f64),
    at: &State,
    tolerance: f64,
    first_s: f64,
) -> (State, u32) {
    let y = packed(at.position, at.velocity, at.attitude.to_array(), at.rates);
    // The dense output of version 0.6.2 ends with a wrong state. The sparse output has every step, the last one at
    // the end. The other parameters are the crate's defaults.
    let mut solver = Dopri5::from_param(
        Equations(motion),
        start,
        end,
        end - start,
        y,
        tolerance,
        tolerance,
        0.9,
        0.04,
        0.2,
        10.0,
        end - start,
        first_s,
        1_000_000,
        1000,
        OutputType::Sparse,
    );
    let done = solver.integrate().unwrap_or_else(|error| panic!("Dormand-Prince: {error}"));
    let (t, y) =
        solver.x_out().last().zip(solver.y_out().last()).expect("the sparse output has the last point");
    assert!((t - end).abs() <= 1e-12 * end.abs().max(1.0), "Dormand-Prince ended at {t}, not at {end}");
    let mut state = unpacked(y);
    state.attitude = state.attitude.normalized();
    (state, done.num_eval)
}
