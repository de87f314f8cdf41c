//! Vibration: tones at the rotors' speeds and their harmonics, and broadband noise.
//!
//! ```text
//!  x, z:  a Σ_rotors (Ω_i/Ω_ref)² Σ_h r_h cos(h φ_i)        φ_i = φ_i0 + ∫ Ω_i dt
//!  y:     a Σ_rotors (Ω_i/Ω_ref)² Σ_h r_h sin(h φ_i) s_i    s_i: sign of the rotor's direction of rotation
//!  noise: n √f_s w · mean of (Ω_i/Ω_ref)²
//! ```
//!
//! The force of an unbalanced rotor turns with it and grows as Ω². The phase is the integral of the true rotor
//! speed, and the tone is evaluated at the time of the sample. So sampling folds tones above half the sample rate:
//! a two-bladed rotor at 225.7 rad/s vibrates at 71.8 Hz, which reads as 28.2 Hz at 100 Hz. The broadband part, from
//! the flow and the bearings, is white in the band of the samples.

use flight_core::geometry::{Vec3, vec3};
use serde::Deserialize;
use wide::f64x4;

use super::DEG;
use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use ::vehicle::{GRAVITY, VehicleParams};
use input::InputError;
use input::check;
use random::{NormalStream, NormalStreams};

/// Returns the default of `harmonics`: only the rotor's own frequency.
fn fundamental_only() -> Vec<f64> {
    vec![1.0]
}

/// `[effects.gyro.vibration]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GyroVibration {
    /// Amplitude a of one rotor's tone at the reference speed, deg/s.
    #[serde(default)]
    pub tone_deg_s: [f64; 3],
    /// r_h: amplitudes at 1, 2, 3 … times the rotor's speed, relative to a.
    #[serde(default = "fundamental_only")]
    pub harmonics: Vec<f64>,
    /// Density n of the broadband noise at the reference speed, deg/s/√Hz (two-sided, as N).
    #[serde(default)]
    pub broadband_deg_s_per_sqrt_hz: [f64; 3],
    /// Reference speed Ω_ref, rad/s; default: the vehicle's hover speed.
    pub reference_rad_s: Option<f64>,
}

/// `[effects.accel.vibration]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccelVibration {
    /// Amplitude a of one rotor's tone at the reference speed, m/s².
    #[serde(default)]
    pub tone_m_s2: [f64; 3],
    /// r_h: amplitudes at 1, 2, 3 … times the rotor's speed, relative to a.
    #[serde(default = "fundamental_only")]
    pub harmonics: Vec<f64>,
    /// Density n of the broadband noise at the reference speed, m/s²/√Hz (two-sided, as N).
    #[serde(default)]
    pub broadband_m_s2_per_sqrt_hz: [f64; 3],
    /// Reference speed Ω_ref, rad/s; default: the vehicle's hover speed.
    pub reference_rad_s: Option<f64>,
}

fn validate_spectrum(key: &str, harmonics: &[f64], reference_rad_s: Option<f64>) -> Result<(), InputError> {
    if !(1..=8).contains(&harmonics.len()) {
        return Err(InputError::new("must have 1 to 8 entries")
            .field(format!("{key}.harmonics"))
            .value(format!("{harmonics:?}")));
    }
    check::keys_in_range(key, "harmonics", harmonics.iter().copied(), -100.0, 100.0, "times the tone")?;
    reference_rad_s
        .map_or(Ok(()), |speed| check::key_in_range(key, "reference_rad_s", speed, 1.0, 1e4, "rad/s"))
}

impl EffectParams for GyroVibration {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "tone_deg_s", self.tone_deg_s, 0.0, 1e3, "deg/s")?;
        let noise = self.broadband_deg_s_per_sqrt_hz;
        check::keys_in_range(key, "broadband_deg_s_per_sqrt_hz", noise, 0.0, 100.0, "deg/s/√Hz")?;
        validate_spectrum(key, &self.harmonics, self.reference_rad_s)
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        Box::new(Vibration::new(
            self.tone_deg_s.map(|a| a * DEG).into(),
            &self.harmonics,
            self.broadband_deg_s_per_sqrt_hz.map(|n| n * DEG).into(),
            self.reference_rad_s,
            context,
        ))
    }
}

impl EffectParams for AccelVibration {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "tone_m_s2", self.tone_m_s2, 0.0, 1e3, "m/s²")?;
        let noise = self.broadband_m_s2_per_sqrt_hz;
        check::keys_in_range(key, "broadband_m_s2_per_sqrt_hz", noise, 0.0, 100.0, "m/s²/√Hz")?;
        validate_spectrum(key, &self.harmonics, self.reference_rad_s)
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        Box::new(Vibration::new(
            self.tone_m_s2.into(),
            &self.harmonics,
            self.broadband_m_s2_per_sqrt_hz.into(),
            self.reference_rad_s,
            context,
        ))
    }
}

/// Returns the speed at which the rotors carry the vehicle, rad/s: 4 b Ω² = m g.
fn hover_rad_s(vehicle: &VehicleParams) -> f64 {
    libm::sqrt(vehicle.mass_kg * GRAVITY / (4.0 * vehicle.thrust_coefficient))
}

/// Sign of each rotor's rotation about the body's z (down): rotors 1 and 3 turn counter-clockwise seen from above.
const SPIN_SIGNS: f64x4 = f64x4::new([-1.0, 1.0, -1.0, 1.0]);

/// Vibration of the four rotors. The rotors are the lanes of SIMD vectors, because the compiler does not vectorise
/// loops over them.
struct Vibration {
    tone: Vec3<f64>,
    /// Amplitude r_h of the highest harmonic.
    highest: f64x4,
    /// Amplitudes r_h of the other harmonics, beginning with the first.
    lower: Box<[f64]>,
    deviation: Vec3<f64>,
    streams: NormalStreams,
    /// Phases φ_i in turns, within ±½.
    turns: f64x4,
    /// Speeds Ω_i at the previous sample; `None` before the first.
    speeds: Option<f64x4>,
    /// Turns in half a sample at 1 rad/s.
    half_step: f64,
    per_reference_squared: f64,
}

impl Vibration {
    fn new(
        tone: Vec3<f64>,
        harmonics: &[f64],
        noise: Vec3<f64>,
        reference_rad_s: Option<f64>,
        context: &BuildContext,
    ) -> Self {
        let reference_rad_s = reference_rad_s.unwrap_or_else(|| hover_rad_s(context.vehicle));
        // The initial angles of the rotors are random. A normal angle with a standard deviation of ten turns, wrapped,
        // is uniform to e^(−2π² 100).
        let start = format!("{}.phase", context.name);
        let (&highest, lower) = harmonics.split_last().unwrap_or((&0.0, &[]));
        let turns = [0, 1, 2, 3].map(|i| 10.0 * NormalStream::new(context.seed, &start, i).draw());
        Self {
            tone,
            highest: f64x4::splat(highest),
            lower: lower.into(),
            deviation: noise * libm::sqrt(context.rate_hz),
            streams: NormalStreams::new(context.seed, context.name),
            turns: wrapped(turns.into()),
            speeds: None,
            half_step: 0.5 * context.interval_s() / std::f64::consts::TAU,
            per_reference_squared: 1.0 / (reference_rad_s * reference_rad_s),
        }
    }
}

/// Wraps angles to ±½ turn.
#[inline(always)]
fn wrapped(turns: f64x4) -> f64x4 {
    // Adding and subtracting 1.5 · 2⁵² rounds to the nearest integer.
    const ROUNDER: f64x4 = f64x4::splat(6_755_399_441_055_744.0);
    turns - ((turns + ROUNDER) - ROUNDER)
}

/// Returns sin 2πu and cos 2πu for u within ±¼ turn, with errors below 3.4e-9 and 2.3e-10. They are
/// computed by an odd and an even minimax polynomial.
#[inline(always)]
fn sine_and_cosine(u: f64x4) -> (f64x4, f64x4) {
    const S: [f64x4; 5] = [
        f64x4::splat(6.283_185_160_088_909),
        f64x4::splat(-41.341_655_031_294_21),
        f64x4::splat(81.601_004_066_223_17),
        f64x4::splat(-76.549_782_143_338_79),
        f64x4::splat(39.536_704_996_732_83),
    ];
    const C: [f64x4; 6] = [
        f64x4::splat(0.999_999_999_780_651_7),
        f64x4::splat(-19.739_208_548_913_513),
        f64x4::splat(64.939_346_629_487_45),
        f64x4::splat(-85.453_571_626_789_62),
        f64x4::splat(60.144_015_092_246_654),
        f64x4::splat(-24.982_237_802_386_635),
    ];
    // Estrin's scheme is used, because its operations depend less on each other than those of Horner's.
    let v = u * u;
    let v2 = v * v;
    let v4 = v2 * v2;
    let sine = u * (((S[0] + v * S[1]) + v2 * (S[2] + v * S[3])) + v4 * S[4]);
    let cosine = ((C[0] + v * C[1]) + v2 * (C[2] + v * C[3])) + v4 * (C[4] + v * C[5]);
    (sine, cosine)
}

#[inline(always)]
fn sum(x: f64x4) -> f64 {
    let [x1, x2, x3, x4] = x.to_array();
    (x1 + x3) + (x2 + x4)
}

impl SensorEffect for Vibration {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, at: &Snapshot) {
        const QUARTER: f64x4 = f64x4::splat(0.25);
        let speeds = f64x4::from(at.rotors);
        if let Some(last) = self.speeds {
            // Integral of the speed by the trapezoidal rule.
            self.turns = wrapped(self.turns + (last + speeds) * f64x4::splat(self.half_step));
        }
        self.speeds = Some(speeds);

        // In turns, cos φ = sin(¼ − |φ|) and sin |φ| = cos(¼ − |φ|). φ is within ±½, so ¼ − |φ| is within ±¼.
        let (cosines, sines) = sine_and_cosine(QUARTER - self.turns.abs());
        let sines = sines.flip_signs(self.turns);
        // Σ r_h cos hφ = cos φ b₁ − b₂ and Σ r_h sin hφ = sin φ b₁ with b_h = r_h + 2 cos φ b_h+1 − b_h+2
        // (Clenshaw 1955).
        let twice = cosines + cosines;
        let (mut b1, mut b2) = (self.highest, f64x4::ZERO);
        for &amplitude in self.lower.iter().rev() {
            (b1, b2) = (twice * b1 + (f64x4::splat(amplitude) - b2), b1);
        }
        let strengths = speeds * speeds * f64x4::splat(self.per_reference_squared);
        let along = sum(strengths * (cosines * b1 - b2));
        let across = sum(strengths * SPIN_SIGNS * (sines * b1));
        let noise = self.deviation.scale_by(self.streams.draw()) * (0.25 * sum(strengths));
        *reading += self.tone.scale_by(vec3(along, across, along)) + noise;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{STATE, build, snapshot};
    use std::f64::consts::TAU;

    fn turning(rotors: [f64; 4]) -> Snapshot<'static> {
        Snapshot { rotors, ..snapshot(&STATE, 0.0) }
    }

    /// Returns the amplitude at this frequency in samples of x, y, z at 100 Hz, over whole periods in 10 s.
    fn amplitudes(effect: &mut BoxedSensorEffect, rotors: [f64; 4], frequency_hz: f64) -> [f64; 3] {
        let (mut real, mut imaginary) = (Vec3::ZERO, Vec3::ZERO);
        for k in 0..1000 {
            let angle = TAU * frequency_hz * f64::from(k) / 100.0;
            let got = effect.apply(Vec3::ZERO, &turning(rotors));
            real += got * (angle.cos() / 500.0);
            imaginary += got * (angle.sin() / 500.0);
        }
        <[f64; 3]>::from(real.scale_by(real) + imaginary.scale_by(imaginary)).map(f64::sqrt)
    }

    fn tones() -> AccelVibration {
        AccelVibration {
            tone_m_s2: [1.0, 2.0, 3.0],
            harmonics: vec![1.0, 0.5, 0.25],
            broadband_m_s2_per_sqrt_hz: [0.0; 3],
            reference_rad_s: Some(TAU * 40.0),
        }
    }

    #[test]
    fn tones_are_at_aliases_and_grow_as_speed_squared() {
        for rotor in 0..4 {
            let mut rotors = [0.0; 4];
            // The tones are at 36 Hz, at 72 Hz folded to 28 Hz, and at 108 Hz folded to 8 Hz.
            rotors[rotor] = TAU * 36.0;
            for (frequency_hz, harmonic) in [(36.0, 1.0), (28.0, 0.5), (8.0, 0.25), (17.0, 0.0)] {
                let got = amplitudes(&mut build(&tones(), 100.0), rotors, frequency_hz);
                for (got, tone) in got.into_iter().zip([1.0, 2.0, 3.0]) {
                    let want = tone * harmonic * (36.0_f64 / 40.0).powi(2);
                    assert!((got - want).abs() < 1e-7, "{frequency_hz} Hz: {got} {want}");
                }
            }
        }
    }

    #[test]
    fn vibration_phase_is_the_integral_of_the_speed() {
        // Ω(t) = 200 + 50 t rad/s for 2 s at 100 Hz. The trapezoidal rule is exact for a linear speed.
        let mut effect = build(&AccelVibration { harmonics: vec![1.0], ..tones() }, 100.0);
        let strength = |speed: f64| (speed / (TAU * 40.0)).powi(2);
        let start = effect.apply(Vec3::ZERO, &turning([200.0, 0.0, 0.0, 0.0]));
        // x: cos φ; y: −2 sin φ for rotor 1.
        let phase = (-start.y / 2.0).atan2(start.x);
        for k in 1..=200 {
            let t = f64::from(k) * 0.01;
            let speed = 200.0 + 50.0 * t;
            let got = effect.apply(Vec3::ZERO, &turning([speed, 0.0, 0.0, 0.0]));
            let want = phase + 200.0 * t + 25.0 * t * t;
            assert!((got.x - strength(speed) * want.cos()).abs() < 1e-7, "at {t} s");
            assert!((got.y + 2.0 * strength(speed) * want.sin()).abs() < 1e-7, "at {t} s");
        }
    }

    #[test]
    fn broadband_noise_has_its_density_at_hover() {
        let params = GyroVibration {
            tone_deg_s: [0.0; 3],
            harmonics: fundamental_only(),
            broadband_deg_s_per_sqrt_hz: [0.1, 0.2, 0.3],
            reference_rad_s: None,
        };
        let mut effect = build(&params, 400.0);
        // OS4 hovers at 225.7 rad/s; at half this speed there is a quarter of the noise.
        for (speed, part) in [(225.6696, 1.0), (112.8348, 0.25), (0.0, 0.0)] {
            let mut squares = Vec3::ZERO;
            for _ in 0..20_000 {
                let got = effect.apply(Vec3::ZERO, &turning([speed; 4]));
                squares += got.scale_by(got);
            }
            for (sum, n) in <[f64; 3]>::from(squares).into_iter().zip([0.1, 0.2, 0.3]) {
                let (got, want) = ((sum / 20_000.0).sqrt() / DEG, n * part * 20.0);
                // The bound is five standard errors of a deviation from 20,000 draws, which are 5/√40,000.
                assert!((got - want).abs() <= 0.025 * want, "{got} {want}");
            }
        }
    }

    #[test]
    fn sine_and_cosine_are_accurate_to_eight_digits() {
        for k in -2500..=2500 {
            let turns = f64::from(k) * 1e-4;
            let (sine, cosine) = sine_and_cosine(f64x4::splat(turns));
            let (sine, cosine) = (sine.to_array()[0], cosine.to_array()[0]);
            assert!((sine - (TAU * turns).sin()).abs() < 3.4e-9, "{turns}: {sine}");
            assert!((cosine - (TAU * turns).cos()).abs() < 2.3e-10, "{turns}: {cosine}");
        }
    }
}
