//! Attitude from gyroscope, accelerometer and magnetometer: by the complementary filter of eq 18, or by
//! [`RobustFilter`].
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
//! | [`EstimatorParams::ROBUST`] | quaternion | see [`RobustFilter`] | flight with a gyroscope that drifts, logs |
//!
//! Why `paper` cannot fly: in free flight the accelerometer shows tilt only through drag (without drag it
//! always reads level), so a held tilt φ decays at φ/τ. `docs/paper.md` shows it.

mod at_rest;
mod euler;
mod quaternion;
mod robust;

pub use at_rest::GyroZero;
pub use euler::EulerFilter;
pub use quaternion::QuaternionFilter;
pub use robust::RobustFilter;

use crate::arithmetic::atan2;
use crate::geometry::{Quaternion, Vec3};
use crate::range::{ConfigError, check};

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
    /// The paper's 0.97, taken at 100 Hz: τ = 0.97 · 0.01 s / 0.03 = 0.3233 s.
    pub const PAPER: Self = Self::TimeConstant { tau_s: 0.97 * 0.01 / 0.03 };

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

/// The time constants of [`RobustFilter`]. What else it holds are figures of sensors and of the Earth's field.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RobustParams {
    /// τ of the tilt, s: the gyroscope above 1/(√2 π τ) Hz, the accelerometer below. In steps longer than τ more is
    /// turned back than there is to turn.
    pub tilt_tau_s: f32,
    /// τ of the heading, s.
    pub heading_tau_s: f32,
}

/// A kind of filter.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Method {
    /// Eq 18.
    Complementary {
        /// Coordinates.
        kinematics: Kinematics,
        /// Weights.
        weight: Weight,
    },
    /// [`RobustFilter`].
    Robust(RobustParams),
}

/// Which filter to run.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct EstimatorParams {
    /// Kind of filter, and its own parameters.
    pub method: Method,
    /// Magnetic declination at the place of flight, rad, positive east.
    pub declination_rad: f32,
}

impl EstimatorParams {
    /// The paper's filter.
    pub const PAPER: Self = Self::complementary(Kinematics::Euler, Weight::PAPER);
    /// The paper's filter, 0.97 at whatever rate the data has.
    pub const PAPER_LITERAL: Self = Self::complementary(Kinematics::Euler, Weight::Fixed { alpha: 0.97 });
    /// The filter that flies.
    pub const FLIGHT: Self =
        Self::complementary(Kinematics::Quaternion, Weight::TimeConstant { tau_s: 10.0 });
    /// The filter that learns bias and disturbances.
    pub const ROBUST: Self = Self {
        method: Method::Robust(RobustParams { tilt_tau_s: 5.0, heading_tau_s: 9.0 }),
        declination_rad: 0.0,
    };

    /// The presets by the names that scenes and the command line use.
    pub const PRESETS: [(&'static str, Self); 4] = [
        ("paper", Self::PAPER),
        ("paper-literal", Self::PAPER_LITERAL),
        ("flight", Self::FLIGHT),
        ("robust", Self::ROBUST),
    ];

    /// Eq 18 with a declination of 0.
    pub const fn complementary(kinematics: Kinematics, weight: Weight) -> Self {
        Self { method: Method::Complementary { kinematics, weight }, declination_rad: 0.0 }
    }

    fn validate(&self) -> Result<(), ConfigError> {
        match self.method {
            Method::Complementary { weight: Weight::TimeConstant { tau_s }, .. } => {
                check("estimator.tau_s", tau_s, 1.0e-3, 1.0e4)?;
            }
            Method::Complementary { weight: Weight::Fixed { alpha }, .. } => {
                check("estimator.alpha", alpha, 0.0, 1.0)?;
            }
            Method::Robust(RobustParams { tilt_tau_s, heading_tau_s }) => {
                check("estimator.tilt_tau_s", tilt_tau_s, 0.1, 100.0)?;
                check("estimator.heading_tau_s", heading_tau_s, 0.1, 1.0e3)?;
            }
        }
        check(
            "estimator.declination_rad",
            self.declination_rad,
            -core::f32::consts::PI,
            core::f32::consts::PI,
        )
    }
}

/// A running filter.
// With a number of its own for the kind: hidden in a field of one of them it takes four instructions to read, each time.
#[derive(Clone, Copy, Debug)]
#[repr(u32)]
pub enum Estimator {
    /// In Euler angles.
    Euler(EulerFilter),
    /// On a quaternion.
    Quaternion(QuaternionFilter),
    /// On a quaternion, with estimates of bias and disturbances.
    Robust(RobustFilter),
}

impl Estimator {
    /// A filter that starts from its first sample.
    ///
    /// # Errors
    /// τ outside 1 ms to 10⁴ s, α outside 0 to 1, a time constant of [`RobustParams`] outside 0.1 to
    /// 100 s (tilt) or 1,000 s (heading), a declination outside ±π.
    pub fn new(params: &EstimatorParams) -> Result<Self, ConfigError> {
        params.validate()?;
        let declination_rad = params.declination_rad;
        Ok(match params.method {
            Method::Complementary { kinematics: Kinematics::Euler, weight } => {
                Self::Euler(EulerFilter::new(weight, declination_rad))
            }
            Method::Complementary { kinematics: Kinematics::Quaternion, weight } => {
                Self::Quaternion(QuaternionFilter::new(weight, declination_rad))
            }
            Method::Robust(params) => Self::Robust(RobustFilter::new(params, declination_rad)),
        })
    }

    /// Takes one sample: angular rate (rad/s), specific force (m/s²), and field (µT) if there is a new one,
    /// all in body axes, `dt_s` after the last. The first sample sets the attitude.
    ///
    /// A sample is one if it turns the body by less than 1,000 rad, shows less than 10⁸ m/s² and µT, and
    /// comes after the last one. Of others nothing is promised, and of these, that the attitude stays finite.
    /// [`crate::FlightController`] has no others: [`crate::calibration::SensorModel`] bounds what counts can
    /// become.
    #[inline]
    pub fn update(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, mag: Option<Vec3<f32>>, dt_s: f32) {
        match self {
            Self::Euler(f) => f.update(gyro, accel, mag, dt_s),
            Self::Quaternion(f) => f.update(gyro, accel, mag, dt_s),
            Self::Robust(f) => f.update(gyro, accel, mag, dt_s),
        }
    }

    /// Begins again, as new: from the next sample.
    pub fn restart(&mut self) {
        match self {
            Self::Euler(f) => f.restart(),
            Self::Quaternion(f) => f.restart(),
            Self::Robust(f) => f.restart(),
        }
    }

    /// The rates that go in were zeroed at rest just now ([`GyroZero`]): they have no bias left. A filter that
    /// learns a bias looks for rest no more from here on, because the caller knows better: a hover is as still
    /// as a bench, and a slow steady turn reads like a bias.
    #[inline]
    pub fn gyro_zeroed(&mut self) {
        if let Self::Robust(f) = self {
            f.gyro_zeroed();
        }
    }

    /// The gyroscope's bias as this filter has learnt it, rad/s, body axes: to be subtracted from what went in.
    #[inline(always)]
    pub fn gyro_bias(&self) -> Vec3<f32> {
        match self {
            Self::Robust(f) => f.gyro_bias(),
            _ => Vec3::ZERO,
        }
    }

    /// Whether what goes in needs no prefilter, because the filter averages over seconds whatever is not turned
    /// by the gyroscope. A prefilter only makes its attitude late: 30 Hz by √2/(2π · 30 Hz) = 7.5 ms, which
    /// at 200 °/s is 1.5°.
    #[inline(always)]
    pub fn is_a_low_pass(&self) -> bool {
        matches!(self, Self::Robust(_))
    }

    /// Whether a first sample has set the attitude.
    pub fn started(&self) -> bool {
        match self {
            Self::Euler(f) => f.started(),
            Self::Quaternion(f) => f.started(),
            Self::Robust(f) => f.started(),
        }
    }

    /// The world's down direction in body axes: the tilt, without any heading.
    #[inline]
    pub fn down(&self) -> Vec3<f32> {
        match self {
            Self::Euler(f) => f.down(),
            Self::Quaternion(f) => f.down(),
            Self::Robust(f) => f.down(),
        }
    }

    /// Heading of the body's x axis, rad, clockwise from true north, in [−π, π]. Of [`Kinematics::Euler`] it is the
    /// yaw, which does not turn round where the pitch goes over the vertical.
    #[inline]
    pub fn heading(&self) -> f32 {
        let q = match self {
            Self::Euler(f) => return f.heading(),
            Self::Quaternion(f) => f.attitude(),
            Self::Robust(f) => f.attitude(),
        };
        let [w, x, y, z] = q.to_array();
        atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    }

    /// The attitude, body to world.
    pub fn attitude(&self) -> Quaternion<f32> {
        match self {
            Self::Euler(f) => f.attitude(),
            Self::Quaternion(f) => f.attitude(),
            Self::Robust(f) => f.attitude(),
        }
    }
}

#[cfg(test)]
mod tests;
