//! The covariance matrix of [`super::RobustFilter`].

#![allow(clippy::needless_range_loop, reason = "an index stands for a row and for a column")]

use crate::arithmetic::sqrt;
use crate::geometry::{Vec3, vec3};

/// Number of states: attitude 3, velocity 2, bias 3, scale 3.
pub const STATES: usize = 11;
/// Index of the first state of each kind: attitude error about north, east and down (rad), velocity north and east
/// (m/s), bias (rad/s) and scale error (1) of the gyroscope about the axes of the body.
pub const ATTITUDE: usize = 0;
pub const VELOCITY: usize = 3;
pub const BIAS: usize = 5;
pub const SCALE: usize = 8;

/// What the motion over some time does to the errors of the states.
#[derive(Clone, Copy, Debug, Default)]
pub struct Transition {
    /// ∫ R dt, s, by rows: a bias turns the attitude by its negative.
    pub rotation: [Vec3<f32>; 3],
    /// ∫ R diag(ω) dt, rad, by rows: the same for an error of the scale.
    pub turned: [Vec3<f32>; 3],
    /// ∫ R f dt, m/s: a tilt error turns it.
    pub speed_change: Vec3<f32>,
}

impl Transition {
    /// Multiplies a column of errors by the transition matrix. The attitude error grows evenly over the time, so its
    /// mean acts on the velocity.
    #[inline(always)]
    fn apply(&self, error: [f32; STATES]) -> [f32; STATES] {
        let [a0, a1, a2, v0, v1, b0, b1, b2, s0, s1, s2] = error;
        let (bias, scale) = (vec3(b0, b1, b2), vec3(s0, s1, s2));
        let turn = |axis: usize| self.rotation[axis].dot(bias) + self.turned[axis].dot(scale);
        let (t0, t1, t2) = (turn(0), turn(1), turn(2));
        let (m0, m1, m2) = (a0 - 0.5 * t0, a1 - 0.5 * t1, a2 - 0.5 * t2);
        let Vec3 { x, y, z } = self.speed_change;
        [a0 - t0, a1 - t1, a2 - t2, v0 + m1 * z - m2 * y, v1 + m2 * x - m0 * z, b0, b1, b2, s0, s1, s2]
    }
}

/// A symmetric matrix of covariances. Both halves are stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariance([[f32; STATES]; STATES]);

impl Covariance {
    /// Returns independent states with these variances.
    pub fn diagonal(variances: [f32; STATES]) -> Self {
        let mut matrix = [[0.0; STATES]; STATES];
        for (i, variance) in variances.into_iter().enumerate() {
            matrix[i][i] = variance;
        }
        Self(matrix)
    }

    /// Returns the variance of a state.
    #[inline(always)]
    pub fn variance(&self, state: usize) -> f32 {
        self.0[state][state]
    }

    /// Returns all covariances.
    #[cfg(test)]
    pub fn matrix(&self) -> [[f32; STATES]; STATES] {
        self.0
    }

    /// Makes a state independent of the others, with a new variance.
    pub fn set(&mut self, state: usize, variance: f32) {
        for other in 0..STATES {
            self.0[state][other] = 0.0;
            self.0[other][state] = 0.0;
        }
        self.0[state][state] = variance;
    }

    /// First half of P ← A P Aᵀ, with the matrix A of the transition: P ← P Aᵀ, for some of the rows. The matrix is
    /// symmetric again after all rows and [`Self::predict_columns`].
    #[inline(never)]
    pub fn predict_rows(&mut self, rows: core::ops::Range<usize>, transition: &Transition) {
        for row in self.0.iter_mut().take(rows.end).skip(rows.start) {
            *row = transition.apply(*row);
        }
    }

    /// Second half: P ← A P. Bias and scale have unit rows in A, so that their rows are final after the first half.
    /// One half of the result is copied to the other, because rounding differs between them.
    #[inline(never)]
    pub fn predict_columns(&mut self, transition: &Transition) {
        let p = &mut self.0;
        for column in 0..BIAS {
            let moved = transition.apply(core::array::from_fn(|row| p[row][column]));
            for row in 0..BIAS {
                p[row][column] = moved[row];
            }
        }
        for row in 0..BIAS {
            for column in row + 1..STATES {
                p[row][column] = p[column][row];
            }
        }
    }

    /// Adds to the variance of a state, and limits it. The limit scales the state's row and column alike, so that the
    /// matrix stays a covariance.
    #[inline(always)]
    pub fn add(&mut self, state: usize, variance: f32, maximum: f32) {
        self.0[state][state] += variance;
        if self.0[state][state] > maximum {
            self.limit(state, maximum);
        }
    }

    #[cold]
    fn limit(&mut self, state: usize, maximum: f32) {
        let share = sqrt(maximum / self.0[state][state]);
        for other in 0..STATES {
            self.0[state][other] *= share;
            self.0[other][state] = self.0[state][other];
        }
        self.0[state][state] = maximum;
    }

    /// Processes a measurement of one state with this noise variance, and returns the gains of all states: the
    /// difference between measurement and state, times the gain, is the correction of a state.
    #[inline(always)]
    pub fn correct(&mut self, state: usize, noise: f32) -> [f32; STATES] {
        let p = &mut self.0;
        let measured = p[state];
        let scale = 1.0 / (measured[state] + noise);
        let gains = measured.map(|covariance| covariance * scale);
        for row in 0..STATES {
            for column in row..STATES {
                let reduced = p[row][column] - gains[row] * measured[column];
                p[row][column] = reduced;
                p[column][row] = reduced;
            }
        }
        // Rounding leaves a variance that the measurement makes very small at a tiny or even negative value. The exact
        // result is the noise times the gain.
        p[state][state] = noise * gains[state];
        gains
    }
}
