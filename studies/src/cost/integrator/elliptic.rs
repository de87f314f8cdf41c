//! Jacobi's elliptic functions, computed with the arithmetic-geometric mean.

use std::f64::consts::{FRAC_PI_2, PI};

/// sn u, cn u and dn u.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jacobi {
    /// Sine amplitude.
    pub sn: f64,
    /// Cosine amplitude.
    pub cn: f64,
    /// Delta amplitude.
    pub dn: f64,
}

/// Returns the means a_n and the differences c_n, starting with a₀ = 1, c₀ = k (Abramowitz and Stegun, 17.6). They
/// converge quadratically: after eight steps f64 shows no further change.
fn means(m1: f64) -> [(f64, f64); 9] {
    let (mut a, mut b) = (1.0, libm::sqrt(m1));
    let mut list = [(1.0, libm::sqrt(1.0 - m1)); 9];
    for slot in &mut list[1..] {
        let c = 0.5 * (a - b);
        (a, b) = (0.5 * (a + b), libm::sqrt(a * b));
        *slot = (a, c);
    }
    list
}

/// Returns the quarter period K for the complementary parameter m₁ = 1 − k² in (0, 1].
pub fn quarter_period(m1: f64) -> f64 {
    FRAC_PI_2 / means(m1)[8].0
}

/// Returns the functions of u for the complementary parameter m₁ = 1 − k² in (0, 1], by descending Landen
/// transformation (Abramowitz and Stegun, 16.4). The parameter is m₁ because near the separatrix it is small, and
/// rounding would spoil 1 − k².
pub fn jacobi(u: f64, m1: f64) -> Jacobi {
    let means = means(m1);
    // Reduce u by whole periods 4K: the angle is 2⁸ a₈ u, and its integer digits would cost precision.
    let (last, _) = means[8];
    let u = u - libm::rint(u * last / (2.0 * PI)) * (2.0 * PI / last);
    let mut angle = 256.0 * last * u;
    for (a, c) in means[1..].iter().rev() {
        angle = 0.5 * (angle + libm::asin(c / a * libm::sin(angle)));
    }
    let (sn, cn) = (libm::sin(angle), libm::cos(angle));
    // √(1 − m sn²) would lose all digits where m and sn are near 1.
    Jacobi { sn, cn, dn: libm::sqrt(m1 + (1.0 - m1) * cn * cn) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quarter_periods_match_published_values() {
        // Abramowitz and Stegun, table 17.1.
        for (m, published) in [
            (0.1, 1.612_441_348_720_219),
            (0.5, 1.854_074_677_301_372),
            (0.9, 2.578_092_113_348_173),
            (0.99, 3.695_637_362_989_875),
        ] {
            assert!((quarter_period(1.0 - m) - published).abs() < 4e-15, "{m}: {}", quarter_period(1.0 - m));
        }
    }

    #[test]
    fn values_match_another_implementation() {
        // mpmath 1.3.0, ellipfun at 30 digits: (u, m₁, sn, cn, dn).
        for (u, m1, sn, cn, dn) in [
            (0.2, 0.19, 0.1976208236718765, 0.9802785369736752, 0.9840560289645666),
            (0.5, 0.5, 0.4707504736556573, 0.8822663948904403, 0.9429724257773857),
            (1.3, 0.81, 0.9491089950937154, 0.3149477979478468, 0.9104100735010118),
            (10.0, 0.5, 0.8588125059527787, -0.5122900346669925, 0.7944938890951612),
            (57.0, 0.0001, 0.9941754674969898, -0.10777355810745863, 0.10823113375161071),
            (-33.3, 1e-06, -0.12316561708171445, 0.9923861298753024, 0.9923861375183803),
        ] {
            let ours = jacobi(u, m1);
            for (ours, theirs) in [(ours.sn, sn), (ours.cn, cn), (ours.dn, dn)] {
                assert!((ours - theirs).abs() < 3e-14, "u = {u}, m1 = {m1}: {ours} against {theirs}");
            }
        }
    }

    #[test]
    fn argument_equals_its_defining_integral() {
        // u = ∫ dφ/√(1 − m sin²φ) from 0 to am u, by Simpson's rule.
        let (u, m) = (0.8, 0.7);
        let Jacobi { sn, cn, .. } = jacobi(u, 1.0 - m);
        let end = sn.atan2(cn);
        let f = |angle: f64| 1.0 / (1.0 - m * angle.sin().powi(2)).sqrt();
        let n = 200;
        let h = end / f64::from(n);
        let sum: f64 = (0..n)
            .map(|i| {
                let a = f64::from(i) * h;
                h / 6.0 * (f(a) + 4.0 * f(a + 0.5 * h) + f(a + h))
            })
            .sum();
        assert!((sum - u).abs() < 1e-12, "{sum}");
    }
}
