//! Eqs 15 and 16 and table 2: the noise density of a simulated sensor is recovered from its samples.
//!
//! The Allan deviation here is an independent implementation of its definition.

use flight_core::geometry::Vec3;
use random::NormalStreams;
use sim_host::flight::{Flight, Observer, StepView};
use sim_host::scene::Scene;

use crate::spread::Spread;
use crate::still::{STILL, white_noise};

/// Eq 15 as printed, over consecutive means of `length` samples that do not overlap.
#[derive(Clone, Debug)]
pub struct Allan {
    length: u32,
    filled: u32,
    sum: f64,
    last_mean: Option<f64>,
    squares: f64,
    pairs: f64,
}

impl Allan {
    pub fn new(length: u32) -> Self {
        Self { length, filled: 0, sum: 0.0, last_mean: None, squares: 0.0, pairs: 0.0 }
    }

    pub fn add(&mut self, y: f64) {
        self.sum += y;
        self.filled += 1;
        if self.filled == self.length {
            let mean = self.sum / f64::from(self.length);
            if let Some(last) = self.last_mean.replace(mean) {
                self.squares += (mean - last) * (mean - last);
                self.pairs += 1.0;
            }
            (self.sum, self.filled) = (0.0, 0);
        }
    }

    /// Returns the square root of eq 15.
    pub fn deviation(&self) -> f64 {
        libm::sqrt(self.squares / (2.0 * self.pairs))
    }

    /// Returns the relative standard error of [`Self::deviation`] for white noise. Differences of neighbouring means
    /// correlate by −1/2, so their mean square has the relative variance 2 (1 + 2/4)/M; the root halves the
    /// relative error.
    pub fn error(&self) -> f64 {
        0.5 * libm::sqrt(3.0 / self.pairs)
    }
}

/// The Allan deviation over means that start at every sample.
#[derive(Clone, Debug)]
pub struct OverlappingAllan {
    length: usize,
    /// The last 2 · length + 1 running sums.
    sums: Vec<f64>,
    taken: usize,
    squares: f64,
    pairs: f64,
}

impl OverlappingAllan {
    pub fn new(length: usize) -> Self {
        Self { length, sums: vec![0.0; 2 * length + 1], taken: 0, squares: 0.0, pairs: 0.0 }
    }

    pub fn add(&mut self, y: f64) {
        let slots = self.sums.len();
        let now = self.sums[self.taken % slots] + y;
        self.taken += 1;
        self.sums[self.taken % slots] = now;
        if self.taken >= 2 * self.length {
            let middle = self.sums[(self.taken - self.length) % slots];
            let first = self.sums[(self.taken - 2 * self.length) % slots];
            let difference = (now - 2.0 * middle + first) / self.length as f64;
            self.squares += difference * difference;
            self.pairs += 1.0;
        }
    }

    pub fn deviation(&self) -> f64 {
        libm::sqrt(self.squares / (2.0 * self.pairs))
    }
}

/// Table 2's gyroscope, deg/√h, x y z.
const GYRO_DEG_PER_SQRT_H: [f64; 3] = [1.9368, 1.239, 1.239];
/// Table 2's accelerometer, m/s²/√Hz, x y z.
const ACCEL_M_S2_PER_SQRT_HZ: [f64; 3] = [0.0012, 0.0012, 0.0014];

fn on_the_bench(duration_s: f64) -> (Scene, u64) {
    let mut scene = Scene::load("static").unwrap_or_else(|error| panic!("{error}"));
    scene.duration_s = duration_s;
    let seed = scene.seed;
    (scene, seed)
}

#[test]
fn allan_of_eq_15_by_hand() {
    // Means of two: 1, 4, 2, 8 (the ninth sample is left over). Differences 3, −2, 6: (9 + 4 + 36)/(2 · 3).
    let mut allan = Allan::new(2);
    for y in [0.0, 2.0, 3.0, 5.0, 1.0, 3.0, 7.0, 9.0, 100.0] {
        allan.add(y);
    }
    assert!((allan.deviation() - libm::sqrt(49.0 / 6.0)).abs() < 1e-12);
    // The overlapping variance of the first six samples: the means are 1, 2.5, 4, 3, 2, and their differences are
    // 4 − 1, 3 − 2.5 and 2 − 4.
    let mut overlapping = OverlappingAllan::new(2);
    for y in [0.0, 2.0, 3.0, 5.0, 1.0, 3.0] {
        overlapping.add(y);
    }
    assert!((overlapping.deviation() - libm::sqrt((9.0 + 0.25 + 4.0) / 6.0)).abs() < 1e-12);
}

#[test]
fn gyroscope_of_table_2_is_0_03228_deg_per_s_per_root_hz() {
    // deg/√h is an angle per root of time, deg/s/√Hz is deg/√s, and √h is 60 √s.
    let n = GYRO_DEG_PER_SQRT_H.map(|n| n / 60.0);
    assert!((n[0] - 0.03228).abs() < 1e-6);
    let (scene, seed) = on_the_bench(60.0);
    let mut gyro = scene.gyro(seed, 1000.0);
    // These are the random draws of the sensor, from the same streams.
    let mut streams = NormalStreams::new(seed, "gyro.white_noise");
    for _ in 0..1000 {
        let readings = <[f64; 3]>::from(gyro.measure(Vec3::ZERO, &STILL));
        let draws = <[f64; 3]>::from(streams.draw());
        for ((reading, w), n) in readings.into_iter().zip(draws).zip(n) {
            // Eq 16 at 1 kHz.
            assert!((reading.to_degrees() / w / (n * libm::sqrt(1000.0)) - 1.0).abs() < 1e-12);
        }
    }
}

/// Records the flight controller's samples on the bench, in the tables' units.
struct Bench {
    /// Degrees per second and m/s² of a count.
    per_count: [f64; 2],
    spreads: [[Spread; 3]; 2],
    /// Over means of 1 s.
    allans: [[Allan; 3]; 2],
}

impl Observer for Bench {
    fn step(&mut self, view: &StepView) {
        let sample = view.input.imu.expect("the IMU is sampled at every step");
        for (sensor, counts) in [sample.gyro, sample.accel].into_iter().enumerate() {
            for (axis, counts) in counts.map(f64::from).into_iter().enumerate() {
                // 1 g is subtracted on z, because it would cost digits of the variance.
                let rest = if (sensor, axis) == (1, 2) { -2048.0 } else { 0.0 };
                let reading = (counts - rest) * self.per_count[sensor];
                self.spreads[sensor][axis].add(reading);
                self.allans[sensor][axis].add(reading);
            }
        }
    }
}

/// Eqs 15 and 16 together, through the converter: the scene `static` at 1 kHz has table 2's Allan deviation at 1 s, and
/// the standard deviation that follows from it.
#[test]
fn static_reads_back_table_2() {
    let (scene, seed) = on_the_bench(2000.0);
    let [gyro, accel, _] = scene.converters.map(|c| c.per_count());
    let mut bench = Bench {
        per_count: [gyro.to_degrees(), accel],
        spreads: [[Spread::default(); 3]; 2],
        allans: std::array::from_fn(|_| std::array::from_fn(|_| Allan::new(1000))),
    };
    Flight::new(&scene, seed).run(&mut bench);

    let expected = [GYRO_DEG_PER_SQRT_H.map(|n| n / 60.0), ACCEL_M_S2_PER_SQRT_HZ];
    assert!((libm::sqrt(1000.0) * expected[0][0] - 1.0208).abs() < 1e-4);
    let spreads = bench.spreads.iter().flatten();
    let allans = bench.allans.iter().flatten();
    let lsbs = bench.per_count.iter().flat_map(|lsb| [lsb; 3]);
    for (((n, spread), allan), lsb) in expected.iter().flatten().zip(spreads).zip(allans).zip(lsbs) {
        // Rounding to a count adds LSB²/12: 2e-4 of the gyroscope's variance, 1e-3 of the accelerometer's.
        let deviation = libm::sqrt(n * n * 1000.0 + lsb * lsb / 12.0);
        spread.assert_deviation(deviation, 1.0);
        let ratio = allan.deviation() * libm::sqrt(1000.0) / deviation;
        println!("Allan deviation at 1 s {:.6}, N {n:.6}, ± {:.4}", allan.deviation(), allan.error());
        assert!((ratio - 1.0).abs() < 5.0 * allan.error(), "{ratio} ± {}", allan.error());
    }
}

/// White noise falls as 1/√τ: its deviation has the slope −½, from which the paper reads N. The variance, which
/// eq 15 gives, has the slope −1.
#[test]
fn white_noise_has_the_allan_deviation_n_over_root_tau() {
    let n = 0.03;
    let mut sensor = white_noise(n, 100.0, 11, "paper.slope");
    let lengths = [10, 100, 1000];
    let mut allans = lengths.map(Allan::new);
    for _ in 0..4_000_000 {
        let y = sensor.measure(Vec3::ZERO, &STILL).x;
        allans.iter_mut().for_each(|allan| allan.add(y));
    }
    for (allan, length) in allans.iter().zip(lengths) {
        let expected = n / libm::sqrt(f64::from(length) * 0.01);
        let ratio = allan.deviation() / expected;
        assert!((ratio - 1.0).abs() < 5.0 * allan.error(), "{length}: {ratio} ± {}", allan.error());
    }
}
