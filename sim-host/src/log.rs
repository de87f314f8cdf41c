//! Sensor logs: CSV files with one row a sample.
//!
//! | columns | unit | |
//! |---|---|---|
//! | `time_s` | s | required, rising; read to the microsecond |
//! | `gyro_{x,y,z}_rad_s` | rad/s | required; angular rate of the body |
//! | `accel_{x,y,z}_m_s2` | m/s² | required; specific force a − g |
//! | `mag_{x,y,z}_ut` | µT | optional; empty cells where there was no new sample |
//! | `ref_q{w,x,y,z}` | – | optional; true attitude, body to world; empty cells where it is unknown |
//! | `moving` | – | optional; 1 where the row counts in an error, 0 where not; all rows count without it |
//!
//! Other columns are ignored, and the order is free. [`LogReader`] turns whatever axes the file has
//! ([`Axes`]) into the project's own: world north-east-down, body forward-right-down, and an
//! accelerometer that reads (0, 0, −9.81) m/s² level and at rest. [`LogWriter`] writes these.
//!
//! Nothing doubtful gets through: a cell that isn't a finite number, time that doesn't rise, a reference
//! that is no rotation, each ends the reading with an [`InputError`](input::InputError) that
//! names file, line and column.

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
    /// Magnetic field along forward, right, down, µT; `None` where there was no new sample.
    pub mag_ut: Option<[f64; 3]>,
    /// True attitude as a unit quaternion (w, x, y, z), body to world; `None` where it is unknown.
    pub reference: Option<[f64; 4]>,
    /// Whether the row counts in an error.
    pub moving: bool,
}

impl LogRow {
    /// Time rounded to the microsecond: the only form of time that the flight code knows.
    pub fn time_us(&self) -> i64 {
        libm::round(self.time_s * 1e6) as i64
    }
}

/// Which way the axes of a log point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Frame {
    /// World north-east-down, body forward-right-down.
    #[default]
    Ned,
    /// World east-north-up, body forward-left-up.
    Enu,
}

/// Which of its two signs an accelerometer's reading has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AccelSign {
    /// Specific force a − g: an upward axis reads +9.81 m/s² at rest.
    #[default]
    Reaction,
    /// Its negative: an upward axis reads −9.81 m/s² at rest.
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
    /// A row in the file's axes, in the project's.
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

/// A vector in forward-left-up axes, in forward-right-down axes.
fn half_turn_about_x([x, y, z]: [f64; 3]) -> [f64; 3] {
    [x, -y, -z]
}

/// An attitude from forward-left-up to east-north-up, as one from forward-right-down to north-east-down.
///
/// Both changes of axes are half turns: of the world about (1, 1, 0)/√2, which swaps east and north and
/// turns up into down, and of the body about x. With p = (0, 1, 1, 0)/√2 and i = (0, 1, 0, 0) the attitude
/// becomes p q i, and the product, times −1 (the same rotation), is what stands here.
fn enu_to_ned([w, x, y, z]: [f64; 4]) -> [f64; 4] {
    [w + z, x + y, x - y, w - z].map(|c| c * core::f64::consts::FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A body vector in the world's axes: the textbook's rotation matrix, independent of the product form.
    fn rotate([w, x, y, z]: [f64; 4], [a, b, c]: [f64; 3]) -> [f64; 3] {
        [
            (w * w + x * x - y * y - z * z) * a + 2.0 * (x * y - w * z) * b + 2.0 * (x * z + w * y) * c,
            2.0 * (x * y + w * z) * a + (w * w - x * x + y * y - z * z) * b + 2.0 * (y * z - w * x) * c,
            2.0 * (x * z - w * y) * a + 2.0 * (y * z + w * x) * b + (w * w - x * x - y * y + z * z) * c,
        ]
    }

    #[test]
    fn a_reference_turns_the_same_vector_in_either_frame() {
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
    fn level_and_facing_east_is_a_yaw_of_90_degrees() {
        let r = core::f64::consts::FRAC_1_SQRT_2;
        assert_eq!(enu_to_ned([1.0, 0.0, 0.0, 0.0]), [r, 0.0, 0.0, r]);
        // Turned left by 90° it faces north.
        for (a, b) in enu_to_ned([r, 0.0, 0.0, r]).into_iter().zip([1.0, 0.0, 0.0, 0.0]) {
            assert!((a - b).abs() < 1e-15);
        }
    }

    #[test]
    fn at_rest_every_convention_reads_minus_g_downwards() {
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
