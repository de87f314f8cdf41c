//! Sensor logs: CSV files with one row per sample.
//!
//! | columns | unit | |
//! |---|---|---|
//! | `time_s` | s | required, increasing; resolution 1 µs |
//! | `gyro_{x,y,z}_rad_s` | rad/s | required; angular rate of the body |
//! | `accel_{x,y,z}_m_s2` | m/s² | required; specific force a − g |
//! | `mag_{x,y,z}_ut` | µT | optional; empty cells if there is no new sample |
//! | `ref_q{w,x,y,z}` | – | optional; true attitude, body to world; empty cells if unknown |
//! | `moving` | – | optional; 1 if the row counts in an error, 0 if not; without the column all rows count |
//!
//! Other columns are ignored, and the columns may be in any order. [`LogReader`] converts the axes of the file
//! ([`Axes`]) to the project's axes: world north-east-down, body forward-right-down, and an accelerometer that reads
//! (0, 0, −9.81) m/s² level and at rest. [`LogWriter`] writes these axes.
//!
//! Invalid data stop the reader: a cell that is not a finite number, a time that does not increase, or a reference that
//! is not a rotation gives an [`InputError`](input::InputError) with file, line and column.

mod read;
mod write;

pub(crate) use read::Records;
pub use read::{Log, LogReader};
pub use write::LogWriter;

/// The columns in the order in which they are written.
const COLUMNS: [&str; 15] = [
    "time_s",
    "gyro_x_rad_s",
    "gyro_y_rad_s",
    "gyro_z_rad_s",
    "accel_x_m_s2",
    "accel_y_m_s2",
    "accel_z_m_s2",
    "mag_x_ut",
    "mag_y_ut",
    "mag_z_ut",
    "ref_qw",
    "ref_qx",
    "ref_qy",
    "ref_qz",
    "moving",
];

/// One sample, in the project's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LogRow {
    /// Time, s.
    pub time_s: f64,
    /// Angular rate about forward, right, down, rad/s.
    pub gyro_rad_s: [f64; 3],
    /// Specific force along forward, right, down, m/s².
    pub accel_m_s2: [f64; 3],
    /// Magnetic field along forward, right, down, µT; `None` if there is no new sample.
    pub mag_ut: Option<[f64; 3]>,
    /// True attitude as a unit quaternion (w, x, y, z), body to world; `None` if it is unknown.
    pub reference: Option<[f64; 4]>,
    /// True if the row counts in an error.
    pub moving: bool,
}

impl LogRow {
    /// Returns the time rounded to microseconds, as the flight code needs it.
    pub fn time_us(&self) -> i64 {
        libm::round(self.time_s * 1e6) as i64
    }
}

/// Directions of the axes of a log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Frame {
    /// World north-east-down, body forward-right-down.
    #[default]
    Ned,
    /// World east-north-up, body forward-left-up.
    Enu,
}

/// Sign convention of an accelerometer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AccelSign {
    /// Specific force a − g: an upward axis reads +9.81 m/s² at rest.
    #[default]
    Reaction,
    /// Negative specific force: an upward axis reads −9.81 m/s² at rest.
    Inverted,
}

/// The conventions of a log's file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Axes {
    /// Directions of the axes.
    pub frame: Frame,
    /// Sign of the accelerometer.
    pub accel_sign: AccelSign,
}

impl Axes {
    /// Converts a row from the file's axes to the project's.
    fn convert(self, row: LogRow) -> LogRow {
        let accel_m_s2 = match self.accel_sign {
            AccelSign::Reaction => row.accel_m_s2,
            AccelSign::Inverted => row.accel_m_s2.map(|a| -a),
        };
        let row = LogRow { accel_m_s2, ..row };
        match self.frame {
            Frame::Ned => row,
            Frame::Enu => LogRow {
                gyro_rad_s: half_turn_about_x(row.gyro_rad_s),
                accel_m_s2: half_turn_about_x(row.accel_m_s2),
                mag_ut: row.mag_ut.map(half_turn_about_x),
                reference: row.reference.map(enu_to_ned),
                ..row
            },
        }
    }
}

/// Converts a vector from forward-left-up to forward-right-down axes.
fn half_turn_about_x([x, y, z]: [f64; 3]) -> [f64; 3] {
    [x, -y, -z]
}

/// Converts an attitude (body to world) from forward-left-up and east-north-up axes to forward-right-down and
/// north-east-down axes.
///
/// Both changes of axes are half turns: of the world about (1, 1, 0)/√2, which swaps east and north and reverses the
/// vertical, and of the body about x. With p = (0, 1, 1, 0)/√2 and i = (0, 1, 0, 0) the attitude becomes p q i. The
/// expression below is this product times −1, which is the same rotation.
fn enu_to_ned([w, x, y, z]: [f64; 4]) -> [f64; 4] {
    [w + z, x + y, x - y, w - z].map(|c| c * core::f64::consts::FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rotates a body vector to world axes by the textbook rotation matrix, independently of the product form.
    fn rotate([w, x, y, z]: [f64; 4], [a, b, c]: [f64; 3]) -> [f64; 3] {
        [
            (w * w + x * x - y * y - z * z) * a + 2.0 * (x * y - w * z) * b + 2.0 * (x * z + w * y) * c,
            2.0 * (x * y + w * z) * a + (w * w - x * x + y * y - z * z) * b + 2.0 * (y * z - w * x) * c,
            2.0 * (x * z - w * y) * a + 2.0 * (y * z + w * x) * b + (w * w - x * x - y * y + z * z) * c,
        ]
    }

    #[test]
    fn reference_rotates_the_same_vector_in_both_frames() {
        let r = core::f64::consts::FRAC_1_SQRT_2;
        for q in [
            [1.0, 0.0, 0.0, 0.0],
            [r, 0.0, 0.0, r],
            [r, r, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
            [0.5, -0.5, 0.5, 0.5],
            [
                0.182_574_185_835_055_36,
                0.365_148_371_670_110_7,
                -0.547_722_557_505_166,
                0.730_296_743_340_221_4,
            ],
        ] {
            for v in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.3, -2.0, 0.7]] {
                let [east, north, up] = rotate(q, v);
                let converted = rotate(enu_to_ned(q), half_turn_about_x(v));
                for (a, b) in converted.into_iter().zip([north, east, -up]) {
                    assert!((a - b).abs() < 1e-15, "{q:?} {v:?}");
                }
            }
        }
    }

    #[test]
    fn level_and_facing_east_is_90_degrees_of_yaw() {
        let r = core::f64::consts::FRAC_1_SQRT_2;
        assert_eq!(enu_to_ned([1.0, 0.0, 0.0, 0.0]), [r, 0.0, 0.0, r]);
        // After a left turn of 90° the body faces north.
        for (a, b) in enu_to_ned([r, 0.0, 0.0, r]).into_iter().zip([1.0, 0.0, 0.0, 0.0]) {
            assert!((a - b).abs() < 1e-15);
        }
    }

    #[test]
    fn every_convention_reads_minus_g_down_at_rest() {
        for (frame, accel_sign, z) in [
            (Frame::Ned, AccelSign::Reaction, -9.81),
            (Frame::Ned, AccelSign::Inverted, 9.81),
            (Frame::Enu, AccelSign::Reaction, 9.81),
            (Frame::Enu, AccelSign::Inverted, -9.81),
        ] {
            let row = LogRow {
                time_s: 0.0,
                gyro_rad_s: [1.0, 2.0, 3.0],
                accel_m_s2: [0.0, 0.0, z],
                mag_ut: Some([20.0, 5.0, 40.0]),
                reference: None,
                moving: true,
            };
            let converted = Axes { frame, accel_sign }.convert(row);
            assert_eq!(converted.accel_m_s2[2], -9.81, "{frame:?} {accel_sign:?}");
            let sign = if frame == Frame::Ned { 1.0 } else { -1.0 };
            assert_eq!(converted.gyro_rad_s, [1.0, 2.0 * sign, 3.0 * sign]);
            assert_eq!(converted.mag_ut, Some([20.0, 5.0 * sign, 40.0 * sign]));
        }
    }
}
