//! Range check of parameters, and its error.

use core::fmt;

/// A parameter outside its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConfigError {
    /// Name of the parameter.
    pub field: &'static str,
    /// Rejected value.
    pub value: f32,
    /// Lower end of the range.
    pub minimum: f32,
    /// Upper end of the range.
    pub maximum: f32,
    /// Whether the two ends are outside the range.
    pub exclusive: bool,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { field, value, minimum, maximum, exclusive } = self;
        if *exclusive {
            write!(f, "{field} = {value}: must be above {minimum} and below {maximum}")
        } else {
            write!(f, "{field} = {value}: must be from {minimum} to {maximum}")
        }
    }
}

impl core::error::Error for ConfigError {}

/// Checks that `value` is within `minimum..=maximum`. NaN is outside every range.
pub(crate) fn check(field: &'static str, value: f32, minimum: f32, maximum: f32) -> Result<(), ConfigError> {
    if value >= minimum && value <= maximum {
        Ok(())
    } else {
        Err(ConfigError { field, value, minimum, maximum, exclusive: false })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::num::f32::ANY;
    use proptest::prelude::*;
    use std::format;

    proptest! {
        /// For any value and any range, the check accepts exactly the values inside the range.
        #[test]
        fn only_values_inside_the_range_pass(value in ANY, a in ANY, b in ANY, inside in 0.0..=1.0_f32) {
            let result = check("field", value, a, b);
            prop_assert_eq!(result.is_ok(), (a..=b).contains(&value));
            if let Err(error) = result {
                prop_assert_eq!((error.field, error.value.to_bits(), error.exclusive), ("field", value.to_bits(), false));
                prop_assert_eq!((error.minimum.to_bits(), error.maximum.to_bits()), (a.to_bits(), b.to_bits()));
            }
            prop_assert_eq!(check("field", inside, 0.0, 1.0), Ok(()));
            for end in [a, b] {
                prop_assert_eq!(check("field", end, a, b).is_ok(), a <= b);
            }
        }
    }

    #[test]
    fn error_text_names_field_value_and_range() {
        let error = check("imu_rate_hz", 5.0, 10.0, 32_000.0).unwrap_err();
        assert_eq!(format!("{error}"), "imu_rate_hz = 5: must be from 10 to 32000");
        let error = ConfigError { exclusive: true, ..error };
        assert_eq!(format!("{error}"), "imu_rate_hz = 5: must be above 10 and below 32000");
    }
}
