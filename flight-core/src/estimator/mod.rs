//! Attitude from gyroscope, accelerometer and magnetometer by the complementary filter of eq 18.
//!
//! o\[k\] = α a\[k\] + (1 − α) b\[k\], where a\[k\] = o\[k−1\] + ωΔt is what the gyroscope predicts and
//! b\[k\] is what accelerometer (tilt) and magnetometer (heading) measure. The gyroscope is trusted over
//! times shorter than τ = αΔt/(1 − α), the other two over longer ones.
//!
//! | preset | kinematics | α | for |
//! |---|---|---|---|
//! | [`EstimatorParams::PAPER`] | Euler angles | τ/(τ + Δt), τ = 0.3233 s: 0.97 at 100 Hz | bench, stand, near hover |
//! | [`EstimatorParams::PAPER_LITERAL`] | Euler angles | 0.97 at whatever rate the data has | comparison with the paper |
//! | [`EstimatorParams::FLIGHT`] | quaternion | τ = 10 s | flight |
//!
//! Why `paper` cannot fly: in free flight the accelerometer shows tilt only through drag (without drag it
//! always reads level), so a held tilt φ decays at φ/τ. `docs/paper.md` shows it.

mod at_rest;
mod euler;
mod quaternion;

pub use at_rest::GyroZero;
pub use euler::EulerFilter;
pub use quaternion::QuaternionFilter;

use crate::config::{ConfigError, check};
use crate::geometry::{Quaternion, Vec3};

/// Below a tenth of standard gravity the direction of the specific force says nothing about tilt
/// (free fall), and the correction is left out. m²/s⁴.
const MIN_SPECIFIC_FORCE_SQUARED: f32 = 0.980_665 * 0.980_665;

/// Below 1 µT of horizontal field (the Earth's is 10 to 40 away from the magnetic poles) the direction says
/// nothing about heading, and the correction is left out. µT².
const MIN_HORIZONTAL_FIELD_SQUARED: f32 = 1.0;

/// How the two sides of eq 18 are weighted.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Weight {
    /// α = τ/(τ + Δt): the same behaviour in time at any rate.
    TimeConstant {
        /// τ, s.
        tau_s: f32,
    },
    /// α as given, at whatever rate the data has.
    Fixed {
        /// α, the weight of the gyroscope.
        alpha: f32,
    },
}

impl Weight {
    /// 1 − α for a step of `dt_s`.
    #[inline(always)]
    fn of_measurement(self, dt_s: f32) -> f32 {
        match self {
            Weight::TimeConstant { tau_s } => dt_s / (tau_s + dt_s),
            Weight::Fixed { alpha } => 1.0 - alpha,
        }
    }
}

/// The coordinates in which the gyroscope is integrated and eq 18 is applied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Kinematics {
    /// Roll, pitch and yaw, each blended by itself, as in the paper. Singular at a pitch of ±90°.
    Euler,
    /// A quaternion, blended along the shortest rotation. No singularity.
    Quaternion,
}

/// Which complementary filter to run.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct EstimatorParams {
    /// Coordinates.
    pub kinematics: Kinematics,
    /// Weights.
    pub weight: Weight,
    /// Magnetic declination at the place of flight, rad, positive east.
    pub declination_rad: f32,
}

impl EstimatorParams {
    /// The paper's filter, its 0.97 taken at 100 Hz: τ = 0.97 · 0.01 s / 0.03 = 0.3233 s.
    pub const PAPER: Self = Self {
        kinematics: Kinematics::Euler,
        weight: Weight::TimeConstant { tau_s: 0.97 * 0.01 / 0.03 },
        declination_rad: 0.0,
    };
    /// The paper's filter, 0.97 at whatever rate the data has.
    pub const PAPER_LITERAL: Self = Self { weight: Weight::Fixed { alpha: 0.97 }, ..Self::PAPER };
    /// The filter that flies.
    pub const FLIGHT: Self = Self {
        kinematics: Kinematics::Quaternion,
        weight: Weight::TimeConstant { tau_s: 10.0 },
        declination_rad: 0.0,
    };

    /// The presets by the names that scenes and the command line use.
    pub const PRESETS: [(&'static str, Self); 3] =
        [("paper", Self::PAPER), ("paper-literal", Self::PAPER_LITERAL), ("flight", Self::FLIGHT)];

    fn validate(&self) -> Result<(), ConfigError> {
        match self.weight {
            Weight::TimeConstant { tau_s } => check("estimator.tau_s", tau_s, 1.0e-3, 1.0e4)?,
            Weight::Fixed { alpha } => check("estimator.alpha", alpha, 0.0, 1.0)?,
        }
        check(
            "estimator.declination_rad",
            self.declination_rad,
            -core::f32::consts::PI,
            core::f32::consts::PI,
        )
    }
}

/// A running complementary filter.
#[derive(Clone, Copy, Debug)]
pub enum Estimator {
    /// In Euler angles.
    Euler(EulerFilter),
    /// On a quaternion.
    Quaternion(QuaternionFilter),
}

impl Estimator {
    /// A filter that starts from its first sample.
    ///
    /// # Errors
    /// τ outside 1 ms to 10⁴ s, α outside 0 to 1, a declination outside ±π.
    pub fn new(params: &EstimatorParams) -> Result<Self, ConfigError> {
        params.validate()?;
        Ok(match params.kinematics {
            Kinematics::Euler => Self::Euler(EulerFilter::new(params)),
            Kinematics::Quaternion => Self::Quaternion(QuaternionFilter::new(params)),
        })
    }

    /// Takes one sample: angular rate (rad/s), specific force (m/s²), and field (µT) if there is a new one,
    /// all in body axes, `dt_s` after the last. The first sample sets the attitude.
    #[inline]
    pub fn update(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, mag: Option<Vec3<f32>>, dt_s: f32) {
        match self {
            Self::Euler(f) => f.update(gyro, accel, mag, dt_s),
            Self::Quaternion(f) => f.update(gyro, accel, mag, dt_s),
        }
    }

    /// Whether a first sample has set the attitude.
    pub fn started(&self) -> bool {
        match self {
            Self::Euler(f) => f.started(),
            Self::Quaternion(f) => f.started(),
        }
    }

    /// The world's down direction in body axes: the tilt, without any heading.
    #[inline]
    pub fn down(&self) -> Vec3<f32> {
        match self {
            Self::Euler(f) => f.down(),
            Self::Quaternion(f) => f.down(),
        }
    }

    /// Heading of the body's x axis, rad, clockwise from true north, in [−π, π].
    #[inline]
    pub fn heading(&self) -> f32 {
        match self {
            Self::Euler(f) => f.heading(),
            Self::Quaternion(f) => f.heading(),
        }
    }

    /// The attitude, body to world.
    pub fn attitude(&self) -> Quaternion<f32> {
        match self {
            Self::Euler(f) => f.attitude(),
            Self::Quaternion(f) => f.attitude(),
        }
    }
}

#[cfg(test)]
mod tests;
