//! Temperature: bias and scale factor follow the chip's temperature while it warms up.
//!
//! ```text
//!  T(t) = T_end + (T_0 − T_end) e^(−t/τ)        y ← (1 + s (T − T_ref)) y + b (T − T_ref)
//! ```
//!
//! The chip heats at a constant power and loses heat in proportion to its temperature above the air's (Newton's law
//! of cooling). b and s are a datasheet's temperature coefficients of the zero error and of the sensitivity. They are
//! linear about the temperature of the calibration.

use flight_core::geometry::{Vec3, vec3};
use serde::Deserialize;

use super::DEG;
use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// Returns the usual calibration temperature of datasheets, °C.
fn default_reference_c() -> f64 {
    25.0
}

/// `[effects.gyro.temperature]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GyroTemperature {
    /// Temperature T_0 at the start, °C.
    pub start_c: f64,
    /// Final temperature T_end, °C.
    pub end_c: f64,
    /// Time constant τ, s.
    pub tau_s: f64,
    /// Temperature T_ref of the calibration, °C; default 25.
    #[serde(default = "default_reference_c")]
    pub reference_c: f64,
    /// Coefficient b of the bias, deg/s/K.
    #[serde(default)]
    pub bias_deg_s_per_k: [f64; 3],
    /// Coefficient s of the scale factor, ppm/K.
    #[serde(default)]
    pub scale_ppm_per_k: [f64; 3],
}

/// `[effects.accel.temperature]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccelTemperature {
    /// Temperature T_0 at the start, °C.
    pub start_c: f64,
    /// Final temperature T_end, °C.
    pub end_c: f64,
    /// Time constant τ, s.
    pub tau_s: f64,
    /// Temperature T_ref of the calibration, °C; default 25.
    #[serde(default = "default_reference_c")]
    pub reference_c: f64,
    /// Coefficient b of the bias, m/s²/K.
    #[serde(default)]
    pub bias_m_s2_per_k: [f64; 3],
    /// Coefficient s of the scale factor, ppm/K.
    #[serde(default)]
    pub scale_ppm_per_k: [f64; 3],
}

fn validate_curve(key: &str, temperatures_c: [(&str, f64); 3], tau_s: f64) -> Result<(), InputError> {
    for (field, celsius) in temperatures_c {
        check::key_in_range(key, field, celsius, -100.0, 200.0, "°C")?;
    }
    check::key_in_range(key, "tau_s", tau_s, 0.01, 1e6, "s")
}

impl EffectParams for GyroTemperature {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        let temperatures_c =
            [("start_c", self.start_c), ("end_c", self.end_c), ("reference_c", self.reference_c)];
        validate_curve(key, temperatures_c, self.tau_s)?;
        check::keys_in_range(key, "bias_deg_s_per_k", self.bias_deg_s_per_k, -10.0, 10.0, "deg/s/K")?;
        check::keys_in_range(key, "scale_ppm_per_k", self.scale_ppm_per_k, -1e4, 1e4, "ppm/K")
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        Box::new(WarmUp {
            excess_k: self.start_c - self.reference_c,
            end_excess_k: self.end_c - self.reference_c,
            approach: approach(context, self.tau_s),
            bias_per_k: self.bias_deg_s_per_k.map(|b| b * DEG).into(),
            scale_per_k: self.scale_ppm_per_k.map(|ppm| ppm * 1e-6).into(),
        })
    }
}

impl EffectParams for AccelTemperature {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        let temperatures_c =
            [("start_c", self.start_c), ("end_c", self.end_c), ("reference_c", self.reference_c)];
        validate_curve(key, temperatures_c, self.tau_s)?;
        check::keys_in_range(key, "bias_m_s2_per_k", self.bias_m_s2_per_k, -1.0, 1.0, "m/s²/K")?;
        check::keys_in_range(key, "scale_ppm_per_k", self.scale_ppm_per_k, -1e4, 1e4, "ppm/K")
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        Box::new(WarmUp {
            excess_k: self.start_c - self.reference_c,
            end_excess_k: self.end_c - self.reference_c,
            approach: approach(context, self.tau_s),
            bias_per_k: self.bias_m_s2_per_k.into(),
            scale_per_k: self.scale_ppm_per_k.map(|ppm| ppm * 1e-6).into(),
        })
    }
}

/// Returns 1 − e^(−Δt/τ): the fraction of the distance to T_end that is covered in one sample.
fn approach(context: &BuildContext, tau_s: f64) -> f64 {
    -libm::expm1(-context.interval_s() / tau_s)
}

struct WarmUp {
    /// T − T_ref now, K.
    excess_k: f64,
    end_excess_k: f64,
    approach: f64,
    /// SI unit/K.
    bias_per_k: Vec3<f64>,
    /// 1/K.
    scale_per_k: Vec3<f64>,
}

impl SensorEffect for WarmUp {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, _: &Snapshot) {
        let scale = vec3(1.0, 1.0, 1.0) + self.scale_per_k * self.excess_k;
        *reading = reading.scale_by(scale) + self.bias_per_k * self.excess_k;
        // A recursion, because the exponential of the time would cost more than the rest. It is exact except for
        // rounding, which stays below 10⁻¹⁶ T τ/Δt: 3e-8 K for 30 K, 1,000 s and 10 kHz.
        self.excess_k += (self.end_excess_k - self.excess_k) * self.approach;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{at_rest, build};

    #[test]
    fn warm_up_is_exponential_over_ten_time_constants() {
        let mut gyro = build(
            &GyroTemperature {
                start_c: 20.0,
                end_c: 45.0,
                tau_s: 120.0,
                reference_c: default_reference_c(),
                bias_deg_s_per_k: [0.01, -0.02, 0.0],
                scale_ppm_per_k: [0.0, 0.0, 300.0],
            },
            100.0,
        );
        at_rest(|at| {
            for k in 0..120_000 {
                let got = gyro.apply(Vec3::Z, at);
                let celsius = 45.0 - 25.0 * (-f64::from(k) * 0.01 / 120.0).exp();
                let want = vec3(0.01 * DEG, -0.02 * DEG, 300e-6) * (celsius - 25.0) + Vec3::Z;
                assert!((got - want).norm() < 1e-11, "sample {k}: {got:?} {want:?}");
            }
        });
    }

    #[test]
    fn accel_drifts_by_its_own_temperature_coefficients() {
        let mut accel = build(
            &AccelTemperature {
                start_c: 35.0,
                end_c: 35.0,
                tau_s: 10.0,
                reference_c: 25.0,
                bias_m_s2_per_k: [0.0, 0.002, 0.0],
                scale_ppm_per_k: [100.0, 0.0, 0.0],
            },
            100.0,
        );
        let got = at_rest(|at| (0..10).fold(Vec3::ZERO, |_, _| accel.apply(vec3(10.0, 10.0, 10.0), at)));
        assert!((got - vec3(10.01, 10.02, 10.0)).norm() < 1e-12, "{got:?}");
    }
}
