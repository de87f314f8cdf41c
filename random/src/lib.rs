//! Random numbers: one independent stream for each effect and axis.
//!
//! A stream is a xoshiro256++ generator whose seed is a hash of (scene seed, effect, axis). Switching an
//! effect on or off therefore never changes the draws of another effect.
//!
//! The normal distribution is implemented here and not by a crate: the tails of all published ziggurats call the
//! C library's `exp` and `ln`, whose last bit depends on the processor. This implementation uses `libm`.
#![forbid(unsafe_code)]
#![warn(missing_docs)]
// Tests may compare with the C library's functions: see clippy.toml.
#![cfg_attr(test, allow(clippy::disallowed_methods))]

use std::sync::OnceLock;

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use xxhash_rust::xxh3::xxh3_64_with_seed;

/// Number of layers of the ziggurat.
const LAYERS: usize = 256;
/// Right edge of the lowest layer's rectangle (Marsaglia and Tsang, *The ziggurat method*, 2000).
const R: f64 = 3.654_152_885_361_009;
/// Area of each layer.
const AREA: f64 = 4.928_673_233_974_655e-3;

/// Tables of the ziggurat: the edges x\[i\] of the layers, falling from the base to 0, and exp(−x²/2) at the edges.
struct Ziggurat {
    x: [f64; LAYERS + 1],
    /// x · 2⁻⁵², the size of one of 2⁵² steps across the layer.
    per_step: [f64; LAYERS],
    density: [f64; LAYERS + 1],
}

fn density(x: f64) -> f64 {
    libm::exp(-0.5 * x * x)
}

impl Ziggurat {
    fn new() -> Self {
        let mut x = [0.0; LAYERS + 1];
        // The width of the base layer's rectangle includes the area of its tail.
        x[0] = AREA / density(R);
        x[1] = R;
        for i in 2..LAYERS {
            x[i] = libm::sqrt(-2.0 * libm::log(AREA / x[i - 1] + density(x[i - 1])));
        }
        let per_step = std::array::from_fn(|i| x[i] * (1.0 / (1_u64 << 52) as f64));
        Self { x, per_step, density: x.map(density) }
    }

    fn get() -> &'static Self {
        static TABLES: OnceLock<Ziggurat> = OnceLock::new();
        TABLES.get_or_init(Self::new)
    }
}

/// Returns the generator of one axis of one effect in a scene with this seed.
fn generator(seed: u64, effect: &str, axis: usize) -> Xoshiro256PlusPlus {
    let hash = xxh3_64_with_seed(effect.as_bytes(), seed);
    Xoshiro256PlusPlus::seed_from_u64(hash ^ (axis as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15))
}

/// Draws a number that is uniform in (0, 1], a multiple of 2⁻⁵³.
#[inline]
fn uniform(generator: &mut Xoshiro256PlusPlus) -> f64 {
    ((generator.next_u64() >> 11) + 1) as f64 * (1.0 / (1_u64 << 53) as f64)
}

/// A stream of numbers uniform in (0, 1].
#[derive(Clone, Debug)]
pub struct UniformStream(Xoshiro256PlusPlus);

impl UniformStream {
    /// Returns the stream of one axis of one effect in a scene with this seed.
    pub fn new(seed: u64, effect: &str, axis: usize) -> Self {
        Self(generator(seed, effect, axis))
    }

    /// Draws the next number.
    #[inline]
    pub fn draw(&mut self) -> f64 {
        uniform(&mut self.0)
    }
}

/// A stream of standard normal numbers.
#[derive(Clone)]
pub struct NormalStream {
    generator: Xoshiro256PlusPlus,
    ziggurat: &'static Ziggurat,
}

impl NormalStream {
    /// Returns the stream of one axis of one effect in a scene with this seed.
    pub fn new(seed: u64, effect: &str, axis: usize) -> Self {
        Self { generator: generator(seed, effect, axis), ziggurat: Ziggurat::get() }
    }

    /// Draws the next number.
    #[inline]
    pub fn draw(&mut self) -> f64 {
        loop {
            let bits = self.generator.next_u64();
            let layer = (bits & 0xFF) as usize;
            // The 53 high bits are a uniform number in [−2⁵², 2⁵²); the layer uses other bits.
            let x = ((bits as i64) >> 11) as f64 * self.ziggurat.per_step[layer];
            if x.abs() < self.ziggurat.x[layer + 1] {
                return x;
            }
            if let Some(x) = self.draw_outside(layer, x) {
                return x;
            }
        }
    }

    /// Handles a draw outside its layer's inner rectangle, which happens once in 70 draws. Returns `None` if the draw is
    /// rejected.
    #[cold]
    fn draw_outside(&mut self, layer: usize, x: f64) -> Option<f64> {
        if layer == 0 {
            // This draws from the tail beyond R (Marsaglia 1964).
            loop {
                let away = -libm::log(uniform(&mut self.generator)) / R;
                let y = -libm::log(uniform(&mut self.generator));
                if 2.0 * y >= away * away {
                    return Some(if x < 0.0 { -R - away } else { R + away });
                }
            }
        }
        let (low, high) = (self.ziggurat.density[layer], self.ziggurat.density[layer + 1]);
        (low + uniform(&mut self.generator) * (high - low) < density(x)).then_some(x)
    }
}

impl std::fmt::Debug for NormalStream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.generator.fmt(f)
    }
}

/// Three independent streams of standard normal numbers for the axes of a sensor.
#[derive(Clone, Debug)]
pub struct NormalStreams([NormalStream; 3]);

impl NormalStreams {
    /// Returns the streams of an effect.
    pub fn new(seed: u64, effect: &str) -> Self {
        Self([0, 1, 2].map(|axis| NormalStream::new(seed, effect, axis)))
    }

    /// Draws the next number of each stream.
    #[inline]
    pub fn draw(&mut self) -> flight_core::geometry::Vec3<f64> {
        let [x, y, z] = &mut self.0;
        flight_core::geometry::vec3(x.draw(), y.draw(), z.draw())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ziggurat_layers_have_equal_areas() {
        let z = Ziggurat::get();
        for i in 1..LAYERS {
            let area = z.x[i] * (z.density[i + 1] - z.density[i]);
            assert!((area / AREA - 1.0).abs() < 1e-9, "layer {i}: {area}");
        }
    }

    #[test]
    fn normal_stream_has_normal_moments_and_tails() {
        let mut stream = NormalStream::new(1, "test", 0);
        let n = 4_000_000;
        let (mut moments, mut beyond) = ([0.0; 4], [0_u32; 3]);
        for _ in 0..n {
            let x = stream.draw();
            for (k, m) in moments.iter_mut().enumerate() {
                *m += x.powi(k as i32 + 1);
            }
            for (k, count) in beyond.iter_mut().enumerate() {
                *count += u32::from(x.abs() > [1.0, 3.0, R][k]);
            }
        }
        let n = f64::from(n);
        // The bounds are five standard errors. Those of the four moments are √1/√n, √2/√n, √15/√n and √96/√n.
        for (got, (want, variance)) in
            moments.iter().zip([(0.0, 1.0), (1.0, 2.0), (0.0, 15.0), (3.0, 96.0_f64)])
        {
            assert!((got / n - want).abs() < 5.0 * (variance / n).sqrt(), "{got} {want}");
        }
        // The probabilities P(|x| > 1, 3, R) are from erfc.
        for (count, edge) in beyond.into_iter().zip([1.0, 3.0, R]) {
            let p = libm::erfc(edge / 2.0_f64.sqrt());
            assert!((f64::from(count) - p * n).abs() < 5.0 * (p * n).sqrt(), "beyond {edge}: {count}");
        }
    }

    #[test]
    fn uniform_stream_has_uniform_mean_and_variance() {
        let mut stream = UniformStream::new(1, "test", 0);
        let n = 1_000_000;
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..n {
            let x = stream.draw();
            assert!(x > 0.0 && x <= 1.0);
            sum += x;
            squares += x * x;
        }
        let n = f64::from(n);
        // The bounds are five standard errors: the variance of x is 1/12, that of x² is 1/5 − 1/9 = 4/45.
        assert!((sum / n - 0.5).abs() < 5.0 * (1.0 / 12.0 / n).sqrt());
        assert!((squares / n - 1.0 / 3.0).abs() < 5.0 * (4.0 / 45.0 / n).sqrt());
    }

    #[test]
    fn streams_depend_on_seed_effect_and_axis() {
        let first = |seed, effect, axis| NormalStream::new(seed, effect, axis).draw();
        let all = [first(1, "a", 0), first(2, "a", 0), first(1, "b", 0), first(1, "a", 1)];
        for (i, x) in all.iter().enumerate() {
            assert!(all[..i].iter().all(|y| y != x));
        }
        assert_eq!(first(7, "gyro.white_noise", 2), first(7, "gyro.white_noise", 2));
    }
}
