//! Attitude estimators: attitude from gyroscope, accelerometer and magnetometer, by the complementary filter of eq 18
//! of the paper or by [`RobustFilter`].
//!
//! Eq 18 is o\[k\] = α a\[k\] + (1 − α) b\[k\]. a\[k\] = o\[k−1\] + ωΔt is the prediction from the gyroscope, b\[k\]
//! the measurement by accelerometer (tilt) and magnetometer (heading). For times shorter than τ = αΔt/(1 − α) the
//! gyroscope dominates, for longer ones the other two sensors.
//!
//! | preset | kinematics | α | use |
//! |---|---|---|---|
//! | [`EstimatorParams::PAPER`] | Euler angles | τ/(τ + Δt), τ = 0.3233 s: 0.97 at 100 Hz | bench, test stand, near hover |
//! | [`EstimatorParams::PAPER_LITERAL`] | Euler angles | 0.97 at any sample rate | comparison with the paper |
//! | [`EstimatorParams::FLIGHT`] | quaternion | τ = 10 s | flight |
//! | [`EstimatorParams::ROBUST`] | quaternion | see [`RobustFilter`] | flight with a drifting gyroscope, recordings |
//!
//! The estimator `paper` is not suitable for flight: in free flight the accelerometer shows tilt only through drag
//! (without drag it always reads level), so the estimate of a held tilt φ decays at the rate φ/τ. `docs/paper.md` shows
//! this.

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

/// Square of the smallest specific force used for tilt, a tenth of standard gravity, m²/s⁴. Below it, as in free
/// fall, the direction contains no information about tilt, and the correction is omitted.
const MIN_SPECIFIC_FORCE_SQUARED: f32 = 0.980_665 * 0.980_665;

/// Square of the smallest horizontal field used for heading, 1 µT, in µT² (the Earth's horizontal field is 10 to
/// 40 µT away from the magnetic poles). Below it the direction contains no information about heading, and the correction
/// is omitted.
const MIN_HORIZONTAL_FIELD_SQUARED: f32 = 1.0;

/// The weight α of eq 18.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Weight {
    /// α = τ/(τ + Δt): the same time response at any sample rate.
    TimeConstant {
        /// Time constant τ, s: 10⁻³ to 10⁴.
        tau_s: f32,
    },
    /// A fixed α, at any sample rate.
    Fixed {
        /// α, the weight of the gyroscope, 0 to 1.
        alpha: f32,
    },
}

impl Weight {
    /// The paper's α = 0.97, taken as the value at 100 Hz. Therefore τ = 0.97 · 0.01 s / 0.03 = 0.3233 s.
    pub const PAPER: Self = Self::TimeConstant { tau_s: 0.97 * 0.01 / 0.03 };

    fn setting(&mut self) -> Setting<'_> {
        match self {
            Weight::TimeConstant { tau_s } => Setting::new("estimator.tau_s", tau_s, 1.0e-3, 1.0e4),
            Weight::Fixed { alpha } => Setting::new("estimator.alpha", alpha, 0.0, 1.0),
        }
    }

    /// Returns 1 − α for a step of `dt_s` (s).
    #[inline(always)]
    fn measurement_weight(self, dt_s: f32) -> f32 {
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
    /// Roll, pitch and yaw, each blended separately, as in the paper. Singular at a pitch of ±90°.
    Euler,
    /// A quaternion, blended along the shortest rotation. No singularity.
    Quaternion,
}

/// The method of an estimator, with its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Method {
    /// The complementary filter of eq 18.
    Complementary {
        /// Coordinates of the attitude.
        kinematics: Kinematics,
        /// Weight of the gyroscope.
        weight: Weight,
    },
    /// The [`RobustFilter`].
    Robust(RobustParams),
}

/// Parameters of an estimator.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct EstimatorParams {
    /// Method, with its own parameters.
    pub method: Method,
    /// Magnetic declination at the place of flight, positive east, rad: −π to π.
    pub declination_rad: f32,
}

impl EstimatorParams {
    /// The filter of the paper, with a time constant.
    pub const PAPER: Self = Self::complementary(Kinematics::Euler, Weight::PAPER);
    /// The filter of the paper, with α = 0.97 at any sample rate.
    pub const PAPER_LITERAL: Self = Self::complementary(Kinematics::Euler, Weight::Fixed { alpha: 0.97 });
    /// The filter for flight.
    pub const FLIGHT: Self =
        Self::complementary(Kinematics::Quaternion, Weight::TimeConstant { tau_s: 10.0 });
    /// The filter that estimates gyroscope bias and disturbances.
    pub const ROBUST: Self = Self {
        method: Method::Robust(RobustParams { speed_m_s: 0.3, heading_noise_rad: 0.13 }),
        declination_rad: 0.0,
    };

    /// The presets with the names that scenes and the command line use.
    pub const PRESETS: [(&'static str, Self); 4] = [
        ("paper", Self::PAPER),
        ("paper-literal", Self::PAPER_LITERAL),
        ("flight", Self::FLIGHT),
        ("robust", Self::ROBUST),
    ];

    /// Returns the parameters of eq 18 with a declination of 0.
    pub const fn complementary(kinematics: Kinematics, weight: Weight) -> Self {
        Self { method: Method::Complementary { kinematics, weight }, declination_rad: 0.0 }
    }

    /// Returns the numeric parameters with their ranges: those of the method, then the declination.
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

/// A numeric parameter of an estimator, with its range.
#[derive(Debug, PartialEq)]
pub struct Setting<'a> {
    /// Name with unit, as errors show it.
    pub name: &'static str,
    /// Value.
    pub value: &'a mut f32,
    /// Smallest and largest permitted value.
    pub range: [f32; 2],
}

impl<'a> Setting<'a> {
    fn new(name: &'static str, value: &'a mut f32, minimum: f32, maximum: f32) -> Self {
        Self { name, value, range: [minimum, maximum] }
    }
}

/// Which inputs a filter takes after the prefilter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FilterInput {
    /// All, in the order of the paper.
    Prefiltered,
    /// None: the filter averages specific force and field over seconds itself. A prefilter takes a fast oscillation out of
    /// the rates and leaves the rotation that it causes in the mean (coning), which then looks like a bias. It also delays
    /// the attitude: 30 Hz by √2/(2π · 30 Hz) = 7.5 ms, which is 1.5° at 200 °/s.
    Calibrated,
}

/// Interface of all filters. A new filter is a file with a struct that implements this trait, plus one line in
/// [`Method`], [`EstimatorParams::settings`], [`Filters`], [`with_filter!`](crate::with_filter) and [`Estimator::new`]. A
/// preset of it, which scenes and vehicle files select by name, is a line in [`EstimatorParams::PRESETS`].
pub trait Filter {
    /// Which of its inputs the filter takes after the prefilter.
    const INPUT: FilterInput = FilterInput::Prefiltered;

    /// Processes one sample: see [`Estimator::update`].
    fn update(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, mag: Option<Vec3<f32>>, dt_s: f32);

    /// Resets the filter to its initial state.
    fn restart(&mut self);

    /// Returns whether a first sample has set the attitude.
    fn started(&self) -> bool;

    /// Returns the direction of down in body axes, unit vector.
    fn down(&self) -> Vec3<f32>;

    /// Returns the attitude, body to world, unit quaternion.
    fn attitude(&self) -> Quaternion<f32>;

    /// Returns the heading of the body's x axis, rad, clockwise from true north, in [−π, π].
    #[inline(always)]
    fn heading(&self) -> f32 {
        let [w, x, y, z] = self.attitude().to_array();
        atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    }

    /// Informs the filter that the gyroscope was zeroed: see [`Estimator::on_gyro_zeroed`]. No effect in a filter
    /// without bias estimation.
    #[inline(always)]
    fn on_gyro_zeroed(&mut self) {}

    /// Returns the estimated bias of the gyroscope, rad/s, body axes; zero in a filter without bias estimation.
    #[inline(always)]
    fn gyro_bias(&self) -> Vec3<f32> {
        Vec3::ZERO
    }
}

/// A filter of any method.
// `repr(u32)` gives the enum an explicit discriminant. Without it the compiler stores the discriminant in unused values
// of a field, and each read of it takes four instructions.
#[derive(Clone, Copy, Debug)]
#[repr(u32)]
#[allow(
    clippy::large_enum_variant,
    reason = "without a heap there is nothing to put the largest filter into"
)]
pub enum Filters {
    /// Complementary filter on a quaternion. It is the first variant, so that its
    /// discriminant is 0, because a comparison with 0 takes one instruction less than one with another number.
    Quaternion(QuaternionFilter),
    /// Complementary filter in Euler angles.
    Euler(EulerFilter),
    /// Filter on a quaternion that estimates bias and disturbances.
    Robust(RobustFilter),
}

/// `with_filter!(filters, filter => expression)` evaluates the expression with `filter` bound to the [`Filter`]
/// inside `filters`.
#[macro_export]
macro_rules! with_filter {
    ($filters:expr, $filter:ident => $expression:expr) => {
        match $filters {
            $crate::estimator::Filters::Euler($filter) => $expression,
            $crate::estimator::Filters::Quaternion($filter) => $expression,
            $crate::estimator::Filters::Robust($filter) => $expression,
        }
    };
}

/// A running attitude estimator.
#[derive(Clone, Copy, Debug)]
pub struct Estimator {
    filter: Filters,
    /// Direction of down in body axes after the last update. Stored, because the controller reads it in each step.
    down: Vec3<f32>,
}

impl Estimator {
    /// Creates an estimator that starts from its first sample.
    ///
    /// # Errors
    /// Returns the first parameter outside its range: τ 10⁻³ to 10⁴ s, α 0 to 1, of [`RobustParams`] the speed
    /// 0.05 to 50 m/s and the noise of the heading 0.001 to 10 rad/√Hz, declination ±π.
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

    /// Processes one sample, `dt_s` (s) after the last one: angular rate (rad/s), specific force (m/s²), and the
    /// magnetic field (µT) if there is a new one, all in body axes. The first sample sets the attitude.
    ///
    /// Valid samples have `dt_s` above 0, turn the body by less than 1,000 rad, and have components below 10⁸ m/s²
    /// and µT. With valid samples the attitude stays finite; with others it is unspecified, except that `robust` ignores
    /// them.
    /// [`crate::FlightController`] passes only valid samples, because [`crate::calibration::SensorModel`] bounds the
    /// readings.
    #[inline]
    pub fn update(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, mag: Option<Vec3<f32>>, dt_s: f32) {
        self.down = with_filter!(&mut self.filter, filter => {
            filter.update(gyro, accel, mag, dt_s);
            filter.down()
        });
    }

    /// Resets the estimator: it starts again from the next sample.
    pub fn restart(&mut self) {
        with_filter!(&mut self.filter, filter => filter.restart());
        self.down = Vec3::Z;
    }

    /// Informs the estimator that the input rates were just zeroed at rest ([`GyroZero`]) and have no bias left. A
    /// filter that estimates a bias then stops its own detection of rest, because the caller has better information:
    /// a hover can be as still as a bench, and a slow steady turn looks like a bias.
    #[inline]
    pub fn on_gyro_zeroed(&mut self) {
        with_filter!(&mut self.filter, filter => filter.on_gyro_zeroed());
    }

    /// Returns the bias of the gyroscope as this filter has estimated it, rad/s, body axes. Subtract it from the
    /// input rates.
    #[inline(always)]
    pub fn gyro_bias(&self) -> Vec3<f32> {
        with_filter!(&self.filter, filter => filter.gyro_bias())
    }

    /// Returns which inputs the filter takes after the prefilter.
    #[inline(always)]
    pub fn input(&self) -> FilterInput {
        fn of<F: Filter>(_: &F) -> FilterInput {
            F::INPUT
        }
        with_filter!(&self.filter, filter => of(filter))
    }

    /// Returns whether a first sample has set the attitude.
    pub fn started(&self) -> bool {
        with_filter!(&self.filter, filter => filter.started())
    }

    /// Returns the direction of down in body axes, unit vector: the tilt, without heading.
    #[inline(always)]
    pub fn down(&self) -> Vec3<f32> {
        self.down
    }

    /// Returns the heading of the body's x axis, rad, clockwise from true north, in [−π, π]. With
    /// [`Kinematics::Euler`] it is the yaw angle, which does not change by half a turn where the pitch passes the
    /// vertical.
    #[inline]
    pub fn heading(&self) -> f32 {
        with_filter!(&self.filter, filter => filter.heading())
    }

    /// Returns the attitude, body to world, unit quaternion.
    pub fn attitude(&self) -> Quaternion<f32> {
        with_filter!(&self.filter, filter => filter.attitude())
    }

    /// Returns the running filter.
    pub fn filter(&self) -> &Filters {
        &self.filter
    }
}

#[cfg(test)]
mod tests;
