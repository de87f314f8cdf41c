//! Fuzzes a sensor log. The input is a byte for the conventions of its axes, then CSV.
//!
//! Every accepted row is finite, within the range that the error messages give, and later than the one before. Rows are
//! the same after they are written and read again. The flight code's estimators stay finite over them.
#![no_main]

use std::fmt::Write as _;

use flight_core::estimator::{Estimator, EstimatorParams};
use flight_core::geometry::Vec3;
use libfuzzer_sys::fuzz_target;
use sim_host::log::{AccelSign, Axes, Frame, LogReader, LogRow};

const HEADER: &str = "time_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,\
                      mag_x_ut,mag_y_ut,mag_z_ut,ref_qw,ref_qx,ref_qy,ref_qz,moving\n";

fuzz_target!(|data: &[u8]| {
    let (conventions, text) = data.split_first().unwrap_or((&0, &[]));
    let axes = Axes {
        frame: if conventions & 1 == 0 { Frame::Ned } else { Frame::Enu },
        accel_sign: if conventions & 2 == 0 { AccelSign::Reaction } else { AccelSign::Inverted },
    };
    let Ok(reader) = LogReader::new(text, "log.csv", axes) else { return };
    let rows: Vec<LogRow> = reader.map_while(Result::ok).collect();
    let mut last_us = None;
    for row in &rows {
        assert!(last_us < Some(row.time_us()), "{row:?}");
        last_us = Some(row.time_us());
        let readings = [row.gyro_rad_s, row.accel_m_s2, row.mag_ut.unwrap_or_default()];
        assert!(row.time_s.abs() <= 9e9 && readings.iter().flatten().all(|x| x.abs() <= 1e6), "{row:?}");
        let norm: f64 = row.reference.unwrap_or([0.5; 4]).iter().map(|c| c * c).sum();
        assert!((norm - 1.0).abs() < 1e-12, "{row:?}");
    }
    read_again(&rows);
    estimate(&rows);
});

fn read_again(rows: &[LogRow]) {
    let mut text = String::from(HEADER);
    for row in rows {
        let mut cells = vec![row.time_s.to_string()];
        cells.extend(row.gyro_rad_s.iter().chain(&row.accel_m_s2).map(f64::to_string));
        cells.extend(row.mag_ut.map_or([const { String::new() }; 3], |field| field.map(|x| x.to_string())));
        cells.extend(row.reference.map_or([const { String::new() }; 4], |q| q.map(|x| x.to_string())));
        writeln!(text, "{},{}", cells.join(","), u8::from(row.moving)).unwrap();
    }
    let again = LogReader::new(text.as_bytes(), "again.csv", Axes::default()).unwrap();
    let again: Vec<LogRow> = again.map(|row| row.unwrap_or_else(|error| panic!("{error}"))).collect();
    // A reference is normalised again and may change in its last digit.
    let plain = |row: &LogRow| LogRow { reference: row.reference.map(|_| [0.0; 4]), ..*row };
    assert!(again.iter().map(plain).eq(rows.iter().map(plain)), "{again:?} for {rows:?}");
}

fn estimate(rows: &[LogRow]) {
    let single = |v: [f64; 3]| Vec3::from(v.map(|x| x as f32));
    for (name, params) in EstimatorParams::PRESETS {
        let mut estimator = Estimator::new(&params).unwrap();
        let mut last_us = rows.first().map_or(0, LogRow::time_us);
        for row in rows {
            let dt_s = (row.time_us() - last_us) as f32 * 1e-6;
            last_us = row.time_us();
            let mag = row.mag_ut.map(single);
            estimator.update(single(row.gyro_rad_s), single(row.accel_m_s2), mag, dt_s);
            let attitude = estimator.attitude();
            assert!((attitude.norm_squared() - 1.0).abs() < 1e-3, "{name}: {attitude:?} after {row:?}");
        }
    }
}
