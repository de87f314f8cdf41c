//! Measures the time of the Allan analysis of samples in memory, for `benches/against-allantools`.
//!
//! Usage: `allan_speed SAMPLES.f64`, a file of little-endian doubles. Prints one JSON object with two times, s: for the
//! sums and the overlapping deviations at octave τ on one thread (as `allantools.oadev` computes), and for the complete
//! analysis with noise identification, bounds and fit.

use std::time::Instant;

use allan::{Phase, Statistic, Taus, statistic};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("usage: allan_speed SAMPLES.f64")?;
    let bytes = std::fs::read(path)?;
    let (words, _) = bytes.as_chunks::<8>();
    let samples: Vec<f64> = words.iter().map(|word| f64::from_le_bytes(*word)).collect();
    let factors = Taus::Octave.factors(samples.len() / 3);
    let (mut deviations_s, mut all_s) = (f64::INFINITY, f64::INFINITY);
    let mut first = 0.0;
    for _ in 0..5 {
        let copy = samples.clone();
        let start = Instant::now();
        let phase = Phase::of_rate(copy, 0.01);
        let variances = statistic::variances(&phase, Statistic::Overlapping, &factors, 1, &|_, _| ());
        deviations_s = deviations_s.min(start.elapsed().as_secs_f64());
        first = libm::sqrt(variances[0].value);

        let copy = samples.clone();
        let start = Instant::now();
        let phase = Phase::of_rate(copy, 0.01);
        let points = allan::deviations(&phase, Statistic::Overlapping, &factors, 1, &|_, _| ());
        std::hint::black_box(allan::fitted(&points, phase.length_s(), None));
        all_s = all_s.min(start.elapsed().as_secs_f64());
    }
    println!("{{\"deviations_s\":{deviations_s},\"all_s\":{all_s},\"first\":{first}}}");
    Ok(())
}
