//! Dryden gusts at low altitude (MIL-F-8785C, section 3.7.3.4).
//!
//! The turbulence is frozen into the air, which passes the vehicle at the speed V. The components are along the mean
//! wind (u), across it (v) and down (w); h is the height and W₂₀ the wind at 20 ft:
//!
//! | | σ | L | spectrum over τω, τ = L/V |
//! |---|---|---|---|
//! | u | σ_w/(0.177 + 0.000823 h)^0.4 | h/(0.177 + 0.000823 h)^1.2 | σ² (2τ/π)/(1 + (τω)²) |
//! | v | as u | as u | σ² (τ/π)(1 + 3(τω)²)/(1 + (τω)²)² |
//! | w | 0.1 W₂₀ | h | as v |
//!
//! h and L are in ft inside the powers, W₂₀ in knots or any other unit of speed. The specification covers h from 10
//! to 1,000 ft. Outside this range the value at the nearer end applies (σ_u = 0.196 W₂₀ and L_u = 23 m below 3 m).
//!
//! # Discretisation
//! In the normalised time s = t/τ, with the Wiener process W, the shaping filters are
//!
//! ```text
//!  u: du = −u ds + √2 dW                                   variance 1
//!  v: dp = −p ds + dW,  dq = (p − q) ds,  v = √3 p + (1 − √3) q    1/2, 1/4, covariance 1/4; of v 1
//! ```
//!
//! and their solutions over a step of ε = h_step/τ are exact for any ε. The state decays by e^(−ε)
//! (times \[\[1, 0\], \[ε, 1\]\] for p, q), and normal random numbers with the covariances ∫₀^ε s^k e^(−2s) ds,
//! k = 0, 1, 2, are added. The filters start in their stationary state and have variance 1 for any τ, so a change
//! of height causes no transient. σ scales their output.
//!
//! Source: MIL-F-8785C, *Flying qualities of piloted airplanes*, 1980.

use flight_core::geometry::{Vec3, vec3};
use serde::Deserialize;

use super::{VehicleEffect, WindEffect};
use crate::effects::{BuildContext, EffectParams, Snapshot};
use input::InputError;
use input::check;
use random::NormalStream;

/// `[effects.wind.dryden]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dryden {
    /// Speed V at which the gusts pass, m/s. For a vehicle that holds its position it is the speed of the wind.
    pub airspeed_m_s: f64,
    /// Wind at 20 ft, W₂₀, m/s; default `airspeed_m_s`.
    pub wind_20ft_m_s: Option<f64>,
    /// Direction in which the mean wind blows, degrees from north, positive to the east; default 0. u is along it.
    #[serde(default)]
    pub towards_deg: f64,
}

impl EffectParams for Dryden {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "airspeed_m_s", self.airspeed_m_s, 0.1, 100.0, "m/s")?;
        if let Some(wind_m_s) = self.wind_20ft_m_s {
            check::key_in_range(key, "wind_20ft_m_s", wind_m_s, 0.0, 100.0, "m/s")?;
        }
        check::key_in_range(key, "towards_deg", self.towards_deg, -360.0, 360.0, "deg")
    }

    fn build(&self, context: &BuildContext) -> VehicleEffect {
        let [mut u, mut v, mut v2, mut w, mut w2] =
            [0, 1, 2, 3, 4].map(|axis| NormalStream::new(context.seed, context.name, axis));
        let along = FirstOrder(u.draw());
        let [across, down] = [[&mut v, &mut v2], [&mut w, &mut w2]]
            .map(|[first, second]| SecondOrder::stationary(first.draw(), second.draw()));
        let towards_rad = self.towards_deg.to_radians();
        VehicleEffect::Wind(Box::new(Gusts {
            step_per_speed_m: self.airspeed_m_s * context.interval_s(),
            wind_20ft_m_s: self.wind_20ft_m_s.unwrap_or(self.airspeed_m_s),
            towards: [libm::cos(towards_rad), libm::sin(towards_rad)],
            field: None,
            along,
            across,
            down,
            streams: [u, v, v2, w, w2],
        }))
    }
}

const FT_M: f64 = 0.3048;

/// Turbulence by the specification at one height.
struct Turbulence {
    sigma_horizontal_m_s: f64,
    sigma_down_m_s: f64,
    length_horizontal_m: f64,
    length_down_m: f64,
}

impl Turbulence {
    fn at(height_ft: f64, wind_20ft_m_s: f64) -> Self {
        let base = 0.177 + 0.000_823 * height_ft;
        let sigma_down_m_s = 0.1 * wind_20ft_m_s;
        Self {
            sigma_horizontal_m_s: sigma_down_m_s / libm::pow(base, 0.4),
            sigma_down_m_s,
            length_horizontal_m: height_ft / libm::pow(base, 1.2) * FT_M,
            length_down_m: height_ft * FT_M,
        }
    }
}

/// The state of a stationary first-order filter with variance 1.
struct FirstOrder(f64);

/// Coefficients of the filters for one step.
#[derive(Clone, Copy)]
struct Step {
    epsilon: f64,
    decay: f64,
    /// Factor of the noise of the first order, √(1 − decay²).
    first: f64,
    /// The Cholesky factor of the noise of p and q.
    p: f64,
    q_with_p: f64,
    q: f64,
}

/// Returns ∫₀^ε s^k e^(−2s) ds by its power series. In the closed forms ε^(k+1) cancels between numbers of order 1.
fn moment_of_decay(k: u32, epsilon: f64) -> f64 {
    let mut term = (0..k).fold(epsilon, |product, _| product * epsilon);
    let mut sum = 0.0;
    // |term| ≤ (2ε)ⁿ/n!, which for ε ≤ 2 is below 1e-16 before n = 36.
    for n in 0..36_u32 {
        sum += term / f64::from(n + k + 1);
        term *= -2.0 * epsilon / f64::from(n + 1);
    }
    sum
}

impl Step {
    /// Computes the coefficients for the time in which `passed_m` of air passes, for turbulence of this length.
    fn new(passed_m: f64, length_m: f64) -> Self {
        // The shortest length is 3 m, so at 1 kHz and 100 m/s ε is 0.03. Beyond 2 successive samples are nearly
        // independent.
        let epsilon = (passed_m / length_m).min(2.0);
        let [c11, c12, c22] = [0, 1, 2].map(|k| moment_of_decay(k, epsilon));
        let p = c11.sqrt();
        let q_with_p = c12 / p;
        Self {
            epsilon,
            decay: libm::exp(-epsilon),
            first: (2.0 * c11).sqrt(),
            p,
            q_with_p,
            q: (c22 - q_with_p * q_with_p).sqrt(),
        }
    }
}

impl FirstOrder {
    fn step(&mut self, by: &Step, noise: f64) -> f64 {
        self.0 = by.decay * self.0 + by.first * noise;
        self.0
    }
}

/// The state p, q of a stationary second-order filter with variance 1.
struct SecondOrder {
    p: f64,
    q: f64,
}

/// √3.
const SQRT_3: f64 = 1.732_050_807_568_877_2;

impl SecondOrder {
    /// Creates the stationary state from two standard normal numbers: var p = 1/2, and q = p/2 plus an independent
    /// part that makes its variance 1/4.
    fn stationary(first: f64, second: f64) -> Self {
        let p = std::f64::consts::FRAC_1_SQRT_2 * first;
        Self { p, q: 0.5 * p + 0.5 * std::f64::consts::FRAC_1_SQRT_2 * second }
    }

    fn step(&mut self, by: &Step, first: f64, second: f64) -> f64 {
        self.q = by.decay * (self.q + by.epsilon * self.p) + by.q_with_p * first + by.q * second;
        self.p = by.decay * self.p + by.p * first;
        SQRT_3 * self.p + (1.0 - SQRT_3) * self.q
    }
}

/// Turbulence and filter coefficients for heights near `height_ft`.
struct Field {
    height_ft: f64,
    sigma_horizontal_m_s: f64,
    sigma_down_m_s: f64,
    horizontal: Step,
    down: Step,
}

struct Gusts {
    /// Length of air that passes in a step, m.
    step_per_speed_m: f64,
    wind_20ft_m_s: f64,
    /// North and east parts of the mean wind's direction.
    towards: [f64; 2],
    field: Option<Field>,
    along: FirstOrder,
    across: SecondOrder,
    down: SecondOrder,
    streams: [NormalStream; 5],
}

impl Gusts {
    fn field_at(&self, height_ft: f64) -> Field {
        let turbulence = Turbulence::at(height_ft, self.wind_20ft_m_s);
        Field {
            height_ft,
            sigma_horizontal_m_s: turbulence.sigma_horizontal_m_s,
            sigma_down_m_s: turbulence.sigma_down_m_s,
            horizontal: Step::new(self.step_per_speed_m, turbulence.length_horizontal_m),
            down: Step::new(self.step_per_speed_m, turbulence.length_down_m),
        }
    }
}

impl WindEffect for Gusts {
    fn velocity(&mut self, at: &Snapshot) -> Vec3<f64> {
        let height_ft = (-at.state.position.z / FT_M).clamp(10.0, 1000.0);
        // No value of the field changes by more than 1.2 % over 1 % of the height.
        let field = match self.field.take() {
            Some(field) if (height_ft - field.height_ft).abs() <= 0.01 * field.height_ft => field,
            _ => self.field_at(height_ft),
        };
        let [n1, n2, n3, n4, n5] = &mut self.streams;
        let along = field.sigma_horizontal_m_s * self.along.step(&field.horizontal, n1.draw());
        let across = field.sigma_horizontal_m_s * self.across.step(&field.horizontal, n2.draw(), n3.draw());
        let down = field.sigma_down_m_s * self.down.step(&field.down, n4.draw(), n5.draw());
        self.field = Some(field);
        let [north, east] = self.towards;
        vec3(north * along - east * across, east * along + north * across, down)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::vehicle::testing::{STATE, snapshot, wind};
    use crate::state::State;

    #[test]
    fn gust_intensity_and_length_meet_the_specification() {
        // At 20 ft and 15 knots σ_w is 1.5 knots. The powers of the base 0.19346 are computed by its logarithm.
        let t = Turbulence::at(20.0, 15.0 * 0.514_444);
        let base: f64 = 0.177 + 0.000823 * 20.0;
        assert!((t.sigma_down_m_s - 0.771_67).abs() < 1e-5);
        assert!((t.sigma_horizontal_m_s / t.sigma_down_m_s - (-0.4 * base.ln()).exp()).abs() < 1e-12);
        assert!((t.length_horizontal_m / 0.3048 - 20.0 * (-1.2 * base.ln()).exp()).abs() < 1e-9);
        // At 1,000 ft the specification agrees with its model for medium altitude: the turbulence is
        // isotropic, with a length of 1,000 ft.
        let t = Turbulence::at(1000.0, 10.0);
        assert!((t.sigma_horizontal_m_s - 1.0).abs() < 1e-9 && (t.length_horizontal_m - 304.8).abs() < 1e-6);
    }

    #[test]
    fn step_noise_has_the_closed_form_covariances() {
        for epsilon in [2.0, 1.0, 0.3] {
            let e = (-2.0_f64 * epsilon).exp();
            let closed = [
                (1.0 - e) / 2.0,
                0.25 - e * (0.5 * epsilon + 0.25),
                0.25 - e * (0.5 * epsilon * epsilon + 0.5 * epsilon + 0.25),
            ];
            for (k, closed) in closed.into_iter().enumerate() {
                assert!((moment_of_decay(k as u32, epsilon) - closed).abs() < 1e-14);
            }
        }
        // The stationary covariances (1/2, 1/4, 1/4) reproduce themselves over a step of any length.
        for epsilon in [1e-6, 1e-3, 0.5, 2.0] {
            let s = Step::new(epsilon, 1.0);
            let a = s.decay * s.decay;
            assert!((a * 0.5 + s.p * s.p - 0.5).abs() < 1e-14);
            let pq = a * (0.25 + epsilon * 0.5) + s.p * s.q_with_p;
            let qq =
                a * (0.25 + epsilon * 0.5 + epsilon * epsilon * 0.5) + s.q_with_p * s.q_with_p + s.q * s.q;
            assert!((pq - 0.25).abs() < 1e-14 && (qq - 0.25).abs() < 1e-14, "{epsilon}: {pq} {qq}");
            assert!((a + s.first * s.first - 1.0).abs() < 1e-14);
        }
    }

    /// Returns gusts along, across and down, m/s, at 1 kHz, at this height.
    fn record(params: &Dryden, height_m: f64, seed: u64, steps: usize) -> [Vec<f64>; 3] {
        let mut gusts = wind(params, seed);
        let state = State { position: vec3(0.0, 0.0, -height_m), ..STATE };
        let mut record = [vec![], vec![], vec![]];
        for _ in 0..steps {
            let gust = gusts.velocity(&snapshot(&state, 0.0, [0.0; 4]));
            record.iter_mut().zip(<[f64; 3]>::from(gust)).for_each(|(axis, x)| axis.push(x));
        }
        record
    }

    /// The autocorrelation is e^(−x) along and (1 − x/2) e^(−x) across and down, with x = t/τ. These are the
    /// transforms of the spectra. The variance is the value at 0.
    #[test]
    fn gust_variance_and_correlation_match_the_spectra() {
        let params = Dryden { airspeed_m_s: 20.0, wind_20ft_m_s: Some(8.0), towards_deg: 0.0 };
        let t = Turbulence::at(6.096 / 0.3048, 8.0);
        let sigmas = [t.sigma_horizontal_m_s, t.sigma_horizontal_m_s, t.sigma_down_m_s];
        let taus = [t.length_horizontal_m, t.length_horizontal_m, t.length_down_m].map(|l| l / 20.0);
        // There are 40 records of 100 s; the longest τ is 2.2 s, the shortest 0.3 s.
        let lags = [0.0, 0.5, 1.0, 2.0];
        let mut sums = [[0.0; 4]; 3];
        let (records, steps) = (40, 100_000);
        for seed in 0..records {
            let record = record(&params, 6.096, seed, steps);
            for axis in 0..3 {
                for (sum, lag) in sums[axis].iter_mut().zip(lags) {
                    let shift = (lag * taus[axis] * 1e3).round() as usize;
                    let pairs = record[axis].iter().zip(&record[axis][shift..]);
                    *sum += pairs.map(|(a, b)| a * b).sum::<f64>() / (steps - shift) as f64;
                }
            }
        }
        for axis in 0..3 {
            let total_s = records as f64 * steps as f64 * 1e-3;
            // An estimate of variance from T seconds has the relative error √(2 ∫ρ² dt/T) with ∫ρ² ≤ τ.
            let error = (2.0 * taus[axis] / total_s).sqrt();
            for (sum, x) in sums[axis].iter().zip(lags) {
                let rho = if axis == 0 { (-x).exp() } else { (1.0 - 0.5 * x) * (-x).exp() };
                let got = sum / records as f64 / (sigmas[axis] * sigmas[axis]);
                assert!((got - rho).abs() < 5.0 * error, "axis {axis}, lag {x} τ: {got} for {rho} ± {error}");
            }
        }
    }

    #[test]
    fn first_gusts_have_the_full_variance() {
        let params = Dryden { airspeed_m_s: 5.0, wind_20ft_m_s: None, towards_deg: 0.0 };
        let t = Turbulence::at(10.0, 5.0);
        let mut squares = [0.0; 3];
        for seed in 0..20_000 {
            let record = record(&params, 1.0, seed, 1);
            squares.iter_mut().zip(&record).for_each(|(sum, axis)| *sum += axis[0] * axis[0]);
        }
        let sigmas = [t.sigma_horizontal_m_s, t.sigma_horizontal_m_s, t.sigma_down_m_s];
        for (sum, sigma) in squares.into_iter().zip(sigmas) {
            // The bound is five standard errors of a variance from 20,000 draws, 5 √(2/20,000).
            assert!((sum / 20_000.0 / (sigma * sigma) - 1.0).abs() < 0.05);
        }
    }

    #[test]
    fn gusts_turn_with_the_mean_wind() {
        let at = |towards_deg| {
            let params = Dryden { airspeed_m_s: 5.0, wind_20ft_m_s: None, towards_deg };
            record(&params, 10.0, 3, 100).map(|axis| axis[99])
        };
        let ([north, east, down], turned) = (at(0.0), at(90.0));
        assert!((turned[0] + east).abs() < 1e-12 && (turned[1] - north).abs() < 1e-12 && turned[2] == down);
    }
}
