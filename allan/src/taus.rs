//! Lists of averaging times.

/// A list of averaging times. All are multiples of the sampling interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taus {
    /// 1, 2, 4, 8 … samples.
    Octave,
    /// 1, 2, 4, 10, 20, 40, 100 … samples.
    Decade,
    /// Evenly spaced on a logarithmic axis, 20 to a decade.
    Log,
    /// All multiples.
    All,
}

impl Taus {
    /// Returns the averaging factors up to `largest`, in rising order.
    pub fn factors(self, largest: usize) -> Vec<usize> {
        match self {
            Self::Octave => std::iter::successors(Some(1_usize), |m| m.checked_mul(2))
                .take_while(|&m| m <= largest)
                .collect(),
            Self::Decade => std::iter::successors(Some(1_usize), |m| m.checked_mul(10))
                .take_while(|&m| m <= largest)
                .flat_map(|m| [m, 2 * m, 4 * m])
                .filter(|&m| m <= largest)
                .collect(),
            Self::Log => {
                let mut factors: Vec<usize> = (0..)
                    .map(|k| libm::round(libm::pow(10.0, f64::from(k) / 20.0)) as usize)
                    .take_while(|&m| m <= largest)
                    .collect();
                factors.dedup();
                factors
            }
            Self::All => (1..=largest).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factors_rise_up_to_the_largest() {
        assert_eq!(Taus::Octave.factors(33), [1, 2, 4, 8, 16, 32]);
        assert_eq!(Taus::Decade.factors(200), [1, 2, 4, 10, 20, 40, 100, 200]);
        assert_eq!(Taus::All.factors(4), [1, 2, 3, 4]);
        assert_eq!(Taus::Octave.factors(0), [0; 0]);
        let log = Taus::Log.factors(1000);
        assert!(log.windows(2).all(|w| w[0] < w[1]) && log[0] == 1 && log[log.len() - 1] == 1000, "{log:?}");
    }
}
