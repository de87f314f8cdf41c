//! Power spectral density by Welch's method: the mean of periodograms of overlapping, windowed segments.

/// Returns the two-sided density at each frequency, Hz, above 0 and up to half the rate. White noise N has the density
/// N².
pub fn density(samples: &[f64], rate_hz: f64) -> Vec<(f64, f64)> {
    /// Samples in a segment.
    const LENGTH: usize = 512;
    if samples.len() < LENGTH {
        return Vec::new();
    }
    let turn = |k: usize| 2.0 * std::f64::consts::PI * k as f64 / LENGTH as f64;
    let table: Vec<(f64, f64)> = (0..LENGTH).map(|k| (libm::cos(turn(k)), libm::sin(turn(k)))).collect();
    // Hann window.
    let window: Vec<f64> = table.iter().map(|(cos, _)| 0.5 - 0.5 * cos).collect();
    let power: f64 = window.iter().map(|w| w * w).sum();
    let starts = (0..=samples.len() - LENGTH).step_by(LENGTH / 2);
    let count = starts.clone().count() as f64;
    let mut density = vec![0.0; LENGTH / 2];
    for start in starts {
        let segment = &samples[start..start + LENGTH];
        let mean = segment.iter().sum::<f64>() / LENGTH as f64;
        let windowed: Vec<f64> = segment.iter().zip(&window).map(|(y, w)| (y - mean) * w).collect();
        for (f, density) in density.iter_mut().enumerate() {
            let (mut re, mut im) = (0.0, 0.0);
            for (k, y) in windowed.iter().enumerate() {
                let (cos, sin) = table[k * (f + 1) % LENGTH];
                re += y * cos;
                im -= y * sin;
            }
            *density += (re * re + im * im) / (power * rate_hz * count);
        }
    }
    let frequency = |f: usize| (f + 1) as f64 * rate_hz / LENGTH as f64;
    density.into_iter().enumerate().map(|(f, density)| (frequency(f), density)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use random::NormalStream;

    #[test]
    fn white_noise_has_its_two_sided_density_everywhere() {
        let (n, rate_hz) = (0.03, 200.0);
        let mut stream = NormalStream::new(1, "spectrum", 0);
        let samples: Vec<f64> = (0..100_000).map(|_| n * f64::sqrt(rate_hz) * stream.draw()).collect();
        let density = density(&samples, rate_hz);
        assert_eq!(density.last().unwrap().0, rate_hz / 2.0);
        let mean = density.iter().map(|d| d.1).sum::<f64>() / density.len() as f64;
        assert!((mean / (n * n) - 1.0).abs() < 0.02, "{mean}");
    }
}
