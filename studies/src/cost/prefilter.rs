//! The study `prefilter`: how much a low-pass before the estimator attenuates, and how much it delays.
//!
//! All figures follow from the impulse response h of the filter as it runs, in f32. The power of white noise is
//! multiplied by Σ h², a tone of frequency f by |Σ h e^(−jωk)|, and the delay at low frequency is Σ k h/Σ h
//! samples. The phase margin is that of the rate and angle loop with the gains of [`ControlParams::OS4`] and the
//! filter's own response.

use std::f64::consts::TAU;
use std::hint::black_box;

use alternatives::prefilter::{Pt1, butterworth_4};
use flight_core::config::Params;
use flight_core::control::ControlParams;
use flight_core::geometry::{Vec3, vec3};
use flight_core::prefilter::{Biquad, Prefilter};

use super::timing::shortest_ns;
use super::{Axis, Options, Progress, Setting, Study, m4};
use input::InputError;
use sim_host::dynamics::{GRAVITY, VehicleParams};

/// Sample rate of the sensor, Hz.
const RATE_HZ: f64 = 1000.0;
/// Length of the impulse response, samples. After 2 s the response of the slowest filter (10 Hz, 4th order) is below
/// the resolution of f32.
const LENGTH: usize = 2000;
/// The motors' lag in the flying scenes, s.
const LAG_S: f64 = 0.05;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    None,
    Pt1,
    Second,
    Fourth,
}

/// A filter of three axes.
#[derive(Clone, Copy)]
enum Filter {
    None,
    Pt1(Pt1),
    Second(Prefilter),
    Fourth([Prefilter; 2]),
}

impl Kind {
    const FILTERS: [Self; 3] = [Self::Pt1, Self::Second, Self::Fourth];

    fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Pt1 => "PT1",
            Self::Second => "2nd order",
            Self::Fourth => "4th order",
        }
    }

    fn build(self, cutoff_hz: f64) -> Result<Filter, InputError> {
        Ok(match self {
            Self::None => Filter::None,
            Self::Pt1 => Filter::Pt1(Pt1::new(cutoff_hz, RATE_HZ)),
            Self::Second => {
                let design = Biquad::butterworth(cutoff_hz as f32, RATE_HZ as f32);
                let design = design.map_err(|error| InputError::new(error.to_string()))?;
                Filter::Second(Prefilter::new(Some(design)))
            }
            Self::Fourth => {
                Filter::Fourth(butterworth_4(cutoff_hz, RATE_HZ).map(|design| Prefilter::new(Some(design))))
            }
        })
    }
}

impl Filter {
    #[inline(always)]
    fn step(&mut self, x: Vec3<f32>) -> Vec3<f32> {
        match self {
            Self::None => x,
            Self::Pt1(filter) => filter.step(x),
            Self::Second(filter) => filter.step(x),
            Self::Fourth([first, second]) => second.step(first.step(x)),
        }
    }

    fn impulse_response(mut self) -> Vec<f64> {
        // A filter settles on its first sample.
        self.step(Vec3::ZERO);
        let input = |k| if k == 0 { Vec3::X } else { Vec3::ZERO };
        (0..LENGTH).map(|k| f64::from(self.step(input(k)).x)).collect()
    }
}

/// A complex number: real and imaginary part.
type Complex = (f64, f64);

fn product((a, b): Complex, (c, d): Complex) -> Complex {
    (a * c - b * d, a * d + b * c)
}

fn ratio(a: Complex, (c, d): Complex) -> Complex {
    let (x, y) = product(a, (c, -d));
    let square = c * c + d * d;
    (x / square, y / square)
}

/// Returns the filter's frequency response at ω rad/s.
fn response(impulse: &[f64], w: f64) -> Complex {
    impulse.iter().enumerate().fold((0.0, 0.0), |(re, im), (k, h)| {
        let angle = w * k as f64 / RATE_HZ;
        (re + h * libm::cos(angle), im - h * libm::sin(angle))
    })
}

/// Returns the open loop at the rotors, with the gains of [`ControlParams::OS4`]:
/// (P + I/s + D s + K (P + I/s)/s) F(s)/((1 + s LAG) s) at s = jω.
fn open_loop(impulse: &[f64], w: f64) -> Complex {
    let gains = ControlParams::OS4;
    let [p, i, d, k] = [gains.rate_p.x, gains.rate_i.x, gains.rate_d.x, gains.tilt_p].map(f64::from);
    // With 1/s = −j/ω and 1/s² = −1/ω².
    let controller = (p - k * i / (w * w), -i / w + d * w - k * p / w);
    ratio(product(controller, response(impulse, w)), product((1.0, w * LAG_S), (0.0, w)))
}

/// Returns the phase margin at the highest frequency at which the loop has a gain of 1, degrees.
fn phase_margin_deg(impulse: &[f64]) -> f64 {
    let gain = |w: f64| {
        let (re, im) = open_loop(impulse, w);
        re * re + im * im
    };
    // Search downwards from a frequency where the gain is certainly below 1, then bisect.
    let (mut low, mut high) = (500.0, 500.0);
    while gain(low) < 1.0 {
        high = low;
        low *= 0.95;
    }
    for _ in 0..40 {
        let middle = libm::sqrt(low * high);
        if gain(middle) < 1.0 { high = middle } else { low = middle }
    }
    let (re, im) = open_loop(impulse, low);
    180.0 + libm::atan2(im, re).to_degrees() - if im > 0.0 { 360.0 } else { 0.0 }
}

/// Returns the blade-passing frequency in hover, Hz: twice the rotor speed with two blades; 72 Hz for OS4.
fn blade_passing_hz(vehicle: &VehicleParams) -> f64 {
    let hover = libm::sqrt(vehicle.mass_kg * GRAVITY / (4.0 * vehicle.thrust_coefficient));
    2.0 * hover / TAU
}

/// Runs the study.
///
/// # Errors
/// A filter refuses a cutoff; this does not happen with these.
pub fn study(options: &Options, progress: Progress) -> Result<Study, InputError> {
    let all = [10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0];
    let cutoffs = if options.quick { &all[2..6] } else { &all[..] };
    let default_hz = Params::default().prefilter_cutoff_hz.map(f64::from);
    let mut filters = vec![(Kind::None, 0.0)];
    filters.extend(Kind::FILTERS.iter().flat_map(|&kind| cutoffs.iter().map(move |&hz| (kind, hz))));
    let blades = TAU * blade_passing_hz(&VehicleParams::OS4);
    let (mut noise, mut vibration) = (Vec::new(), Vec::new());
    for (n, &(kind, cutoff_hz)) in filters.iter().enumerate() {
        let filter = kind.build(cutoff_hz)?;
        let impulse = filter.impulse_response();
        let sum: f64 = impulse.iter().sum();
        let delay: f64 = impulse.iter().enumerate().map(|(k, h)| k as f64 * h).sum::<f64>() / sum;
        let power: f64 = impulse.iter().map(|h| h * h).sum();
        let (re, im) = response(&impulse, blades);
        let figure = m4::figure(&format!("prefilter {}", kind.name()));
        const SAMPLES: u32 = 1000;
        let time = shortest_ns(options, || {
            let mut bank = [filter; 3];
            for k in 0..SAMPLES {
                let x = black_box(vec3(k as f32, 1.0, -1.0));
                black_box(bank.each_mut().map(|filter| filter.step(x)));
            }
        });
        let setting =
            if kind == Kind::None { kind.name().into() } else { format!("{} {cutoff_hz} Hz", kind.name()) };
        let row = Setting {
            series: kind.name().into(),
            setting,
            error_unit: "of the amplitude",
            host_ns: time.map(|ns| ns / f64::from(SAMPLES)),
            m4_instructions: figure.map(|figure| figure.instructions),
            flash_bytes: figure.and_then(|figure| figure.flash_bytes),
            also: vec![
                ("group_delay_ms", 1e3 * delay / RATE_HZ),
                ("phase_margin_deg", phase_margin_deg(&impulse)),
            ],
            default: kind == Kind::Second && Some(cutoff_hz) == default_hz,
            ..Setting::default()
        };
        noise.push(Setting { problem: "white noise", error: Some(libm::sqrt(power)), ..row.clone() });
        vibration.push(Setting {
            problem: "vibration of the blades, 72 Hz",
            error: Some(libm::sqrt(re * re + im * im)),
            ..row
        });
        progress(n as f64 / filters.len() as f64);
    }
    noise.append(&mut vibration);
    Ok(Study {
        name: "prefilter",
        title: "The prefilter of the sensors",
        about: format!(
            "The error is the remaining share of a disturbance, RMS out over RMS in: of white noise, and of a tone at \
             {:.0} Hz, the blade-passing frequency with two blades in hover. The cost is the delay of the motion itself, \
             which takes phase margin: without a filter the loop has {:.0}°.",
            blade_passing_hz(&VehicleParams::OS4),
            phase_margin_deg(&[1.0])
        ),
        reference: "The input. Each figure is computed from the impulse response of the filter that runs; tests \
                    compare them with the closed forms of Butterworth filters."
            .into(),
        per: "a sample of nine axes",
        axis: Axis::Also("group_delay_ms"),
        axis_title: "group delay at low frequency, ms",
        settings: noise,
        remarks: vec![
            "Against white noise the order hardly matters. For the same remaining noise, first and second order have the same \
             delay (their noise bandwidths are π/2 and π/(2√2) times the cutoff, their delays 1 and √2 over ω_c). The \
             fourth order delays more and costs twice the instructions. The second order has its advantage against vibration, \
             which the white noise does not show."
                .into(),
            "`none` has no delay, and so no point on a logarithmic axis.".into(),
        ],
    })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    fn impulse(kind: Kind, cutoff_hz: f64) -> Vec<f64> {
        kind.build(cutoff_hz).unwrap().impulse_response()
    }

    #[test]
    fn delay_noise_and_tone_match_the_closed_forms() {
        // Butterworth's analogue filter of order n: |H|² = 1/(1 + (ω/ω_c)^2n), noise bandwidth
        // (π/2n)/sin(π/2n) f_c, delay Σ 2 sin((2k+1)π/2n)/(2 ω_c) over its poles. The bilinear transform maps
        // ω to 2 f_s tan(ω/2f_s): a negligible change at 10 Hz with 1 kHz.
        for (kind, n, delay) in [
            (Kind::Second, 2.0, std::f64::consts::SQRT_2),
            (Kind::Fourth, 4.0, 2.0 * ((PI / 8.0).sin() + (3.0 * PI / 8.0).sin())),
        ] {
            let (hz, h) = (10.0, impulse(kind, 10.0));
            let power: f64 = h.iter().map(|h| h * h).sum();
            let bandwidth = PI / (2.0 * n) / (PI / (2.0 * n)).sin() * hz;
            assert!((power / (2.0 * bandwidth / RATE_HZ) - 1.0).abs() < 2e-3, "{kind:?}: {power}");
            let sum: f64 = h.iter().enumerate().map(|(k, h)| k as f64 * h).sum();
            assert!((sum / RATE_HZ / (delay / (TAU * hz)) - 1.0).abs() < 2e-3, "{kind:?}: {sum}");
            for f in [5.0, 10.0, 30.0_f64] {
                let (re, im) = response(&h, TAU * f);
                let warped = |f: f64| (PI * f / RATE_HZ).tan();
                let expected = (1.0 + (warped(f) / warped(hz)).powf(2.0 * n)).sqrt().recip();
                assert!((re.hypot(im) - expected).abs() < 1e-4, "{kind:?} at {f} Hz");
            }
        }
    }

    #[test]
    fn loop_has_the_phase_margin_of_its_gains() {
        // `ControlParams::OS4`: crossover at 20 rad/s with a phase margin of 61°.
        let h = impulse(Kind::Second, 30.0);
        assert!((phase_margin_deg(&h) - 61.0).abs() < 2.0, "{}", phase_margin_deg(&h));
        let (re, im) = open_loop(&h, 20.0);
        assert!((re.hypot(im) - 1.0).abs() < 0.05);
        // A delay of τ costs ω τ: 5 ms at about 20 rad/s are 6°.
        let mut late = vec![0.0; 5];
        late.push(1.0);
        let lost = phase_margin_deg(&[1.0]) - phase_margin_deg(&late);
        assert!((4.0..9.0).contains(&lost), "{lost}");
    }
}
