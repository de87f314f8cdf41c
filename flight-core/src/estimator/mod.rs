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
pub use robust::{RobustFilter, RobustParams};

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

    fn setting(&mut self) -> Setting<'_> {
        match self {
            Weight::TimeConstant { tau_s } => Setting::new("estimator.tau_s", tau_s, 1.0e-3, 1.0e4),
            Weight::Fixed { alpha } => Setting::new("estimator.alpha", alpha, 0.0, 1.0),
        }
    }

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

    /// The numbers that the filter is set by, each with its range: those of its kind, and the declination.
    pub fn settings(&mut self) -> impl Iterator<Item = Setting<'_>> {
        const PI: f32 = core::f32::consts::PI;
        let [first, second] = match &mut self.method {
            Method::Complementary { weight, .. } => [Some(weight.setting()), None],
            Method::Robust(params) => params.settings().map(Some),
        };
        let declination = Setting::new("estimator.declination_rad", &mut self.declination_rad, -PI, PI);
        first.into_iter().chain(second).chain([declination])
    }
}

/// A number that a filter is set by.
#[derive(Debug, PartialEq)]
pub struct Setting<'a> {
    /// Its name, as errors have it, with its unit.
    pub name: &'static str,
    /// The number.
    pub value: &'a mut f32,
    /// Smallest and largest that it may be.
    pub range: [f32; 2],
}

impl<'a> Setting<'a> {
    fn new(name: &'static str, value: &'a mut f32, minimum: f32, maximum: f32) -> Self {
        Self { name, value, range: [minimum, maximum] }
    }
}

/// What every filter takes and gives. A new one is a file with a struct that does this, and its line in this file's
/// [`Method`], [`Filters`], [`with_filter!`](crate::with_filter) and [`Estimator::new`].
pub trait Filter {
    /// Whether it averages accelerometer and magnetometer over seconds, and so needs no prefilter.
    const IS_A_LOW_PASS: bool = false;

    /// See [`Estimator::update`].
    fn update(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, mag: Option<Vec3<f32>>, dt_s: f32);

    /// Begins again, as new.
    fn restart(&mut self);

    /// Whether a first sample has set the attitude.
    fn started(&self) -> bool;

    /// Down in body axes.
    fn down(&self) -> Vec3<f32>;

    /// The attitude, body to world.
    fn attitude(&self) -> Quaternion<f32>;

    /// Heading of the body's x axis, rad, clockwise from true north, in [−π, π].
    #[inline(always)]
    fn heading(&self) -> f32 {
        let [w, x, y, z] = self.attitude().to_array();
        atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    }

    /// See [`Estimator::gyro_zeroed`]: nothing, for a filter that learns no bias.
    #[inline(always)]
    fn gyro_zeroed(&mut self) {}

    /// The gyroscope's bias as it was learnt, rad/s, body axes.
    #[inline(always)]
    fn gyro_bias(&self) -> Vec3<f32> {
        Vec3::ZERO
    }
}

/// A filter of any kind.
// With a number of its own for the kind: hidden in a field of one of them it takes four instructions to read, each time.
#[derive(Clone, Copy, Debug)]
#[repr(u32)]
pub enum Filters {
    /// On a quaternion. First, because it is what mostly flies: a comparison with 0 takes no second instruction.
    Quaternion(QuaternionFilter),
    /// In Euler angles.
    Euler(EulerFilter),
    /// On a quaternion, with estimates of bias and disturbances.
    Robust(RobustFilter),
}

/// `with_filter!(filters, filter => expression)`: the expression with the [`Filter`] of whichever kind it is.
#[macro_export]
macro_rules! with_filter {
    ($filters:expr, $filter:ident => $what:expr) => {
        match $filters {
            $crate::estimator::Filters::Euler($filter) => $what,
            $crate::estimator::Filters::Quaternion($filter) => $what,
            $crate::estimator::Filters::Robust($filter) => $what,
        }
    };
}

/// A running filter.
#[derive(Clone, Copy, Debug)]
pub struct Estimator {
    filter: Filters,
    /// Down in body axes, kept from the last update: the controller asks for it each time.
    down: Vec3<f32>,
}

impl Estimator {
    /// A filter that starts from its first sample.
    ///
    /// # Errors
    /// τ outside 1 ms to 10⁴ s, α outside 0 to 1, a time constant of [`RobustParams`] outside 0.1 to
    /// 100 s (tilt) or 1,000 s (heading), a declination outside ±π.
    pub fn new(params: &EstimatorParams) -> Result<Self, ConfigError> {
        for Setting { name, value, range: [minimum, maximum] } in { *params }.settings() {
            check(name, *value, minimum, maximum)?;
        }
        let declination_rad = params.declination_rad;
        let filter = match params.method {
            Method::Complementary { kinematics: Kinematics::Euler, weight } => {
                Filters::Euler(EulerFilter::new(weight, declination_rad))
            }
            Method::Complementary { kinematics: Kinematics::Quaternion, weight } => {
                Filters::Quaternion(QuaternionFilter::new(weight, declination_rad))
            }
            Method::Robust(params) => Filters::Robust(RobustFilter::new(params, declination_rad)),
        };
        Ok(Self { filter, down: Vec3::Z })
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
        self.down = with_filter!(&mut self.filter, filter => {
            filter.update(gyro, accel, mag, dt_s);
            filter.down()
        });
    }

    /// Begins again, as new: from the next sample.
    pub fn restart(&mut self) {
        with_filter!(&mut self.filter, filter => filter.restart());
        self.down = Vec3::Z;
    }

    /// The rates that go in were zeroed at rest just now ([`GyroZero`]): they have no bias left. A filter that
    /// learns a bias looks for rest no more from here on, because the caller knows better: a hover is as still
    /// as a bench, and a slow steady turn reads like a bias.
    #[inline]
    pub fn gyro_zeroed(&mut self) {
        with_filter!(&mut self.filter, filter => filter.gyro_zeroed());
    }

    /// The gyroscope's bias as this filter has learnt it, rad/s, body axes: to be subtracted from what went in.
    #[inline(always)]
    pub fn gyro_bias(&self) -> Vec3<f32> {
        with_filter!(&self.filter, filter => filter.gyro_bias())
    }

    /// Whether what goes in needs no prefilter, because the filter averages over seconds whatever is not turned
    /// by the gyroscope. A prefilter only makes its attitude late: 30 Hz by √2/(2π · 30 Hz) = 7.5 ms, which
    /// at 200 °/s is 1.5°.
    #[inline(always)]
    pub fn is_a_low_pass(&self) -> bool {
        fn of<F: Filter>(_: &F) -> bool {
            F::IS_A_LOW_PASS
        }
        with_filter!(&self.filter, filter => of(filter))
    }

    /// Whether a first sample has set the attitude.
    pub fn started(&self) -> bool {
        with_filter!(&self.filter, filter => filter.started())
    }

    /// The world's down direction in body axes: the tilt, without any heading.
    #[inline(always)]
    pub fn down(&self) -> Vec3<f32> {
        self.down
    }

    /// Heading of the body's x axis, rad, clockwise from true north, in [−π, π]. Of [`Kinematics::Euler`] it is the
    /// yaw, which does not turn round where the pitch goes over the vertical.
    #[inline]
    pub fn heading(&self) -> f32 {
        with_filter!(&self.filter, filter => filter.heading())
    }

    /// The attitude, body to world.
    pub fn attitude(&self) -> Quaternion<f32> {
        with_filter!(&self.filter, filter => filter.attitude())
    }

    /// The filter that runs.
    pub fn filter(&self) -> &Filters {
        &self.filter
    }
}

#[cfg(test)]
mod tests;
