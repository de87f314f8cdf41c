//! Table 2: a sensor with the table's random walks is simulated for an hour, and its Allan deviation gives them back.
//! This is done for both readings of their unit.

use super::bench::{self, GRAVITY_UP};
use super::{Exhibit, tabulated};
use allan::Coefficient;
use flight_core::geometry::Vec3;
use input::InputError;
use sim_host::identify::plot::short;

const HOUR_S: f64 = 3600.0;
const RATE_HZ: f64 = 100.0;
const DEG: f64 = std::f64::consts::PI / 180.0;

/// Gyroscope as printed, x, y, z.
const GYRO: [f64; 3] = [1.9368, 1.239, 1.239];
/// Accelerometer, m/s²/√Hz.
const ACCEL: [f64; 3] = [0.0012, 0.0012, 0.0014];

pub fn table(progress: &dyn Fn(u64)) -> Result<Exhibit, InputError> {
    let mut rows = Vec::new();
    let mut worst = 0.0_f64;
    let n = Coefficient::WhiteNoise as usize;
    // The value in deg/h/√Hz is smaller than that in deg/√h by a factor of 60.
    for (reading, per) in [("deg/√h", 1.0), ("deg/h/√Hz", 60.0)] {
        let [x, y, z] = GYRO.map(|n| n / per);
        let effects = format!("[effects.gyro.white_noise]\nn_deg_per_sqrt_h = [{x:?}, {y:?}, {z:?}]\n");
        let scene = bench::scene(HOUR_S, 1, &effects)?;
        let read = |through| {
            bench::readings(&scene, &mut scene.gyro(scene.seed, RATE_HZ), Vec3::ZERO, RATE_HZ, through)
        };
        let step = scene.gyro(scene.seed, RATE_HZ).nominal([1, 0, 0]).x;
        for (axis, (before, behind)) in read(false).into_iter().zip(read(true)).enumerate() {
            let put_in = GYRO[axis] / per / 60.0;
            let value = |samples: Vec<f64>, step: Option<f64>| {
                // Samples that never leave one count show no noise.
                if samples.windows(2).all(|w| w[0] == w[1]) {
                    return None;
                }
                bench::analysed(samples, RATE_HZ, step).1.found[n].value().map(|n| n / DEG)
            };
            let before = value(before, None);
            let behind = value(behind, Some(step));
            if let Some(found) = before {
                worst = worst.max((found / put_in - 1.0).abs());
            }
            rows.push(row(
                &format!("gyroscope {}, read as {reading}", ["x", "y", "z"][axis]),
                GYRO[axis],
                put_in,
                before,
                behind,
                "°/s/√Hz",
            ));
        }
        progress(if per == 1.0 { 10 } else { 20 });
    }
    let [x, y, z] = ACCEL;
    let effects = format!("[effects.accel.white_noise]\nn_m_s2_per_sqrt_hz = [{x:?}, {y:?}, {z:?}]\n");
    let scene = bench::scene(HOUR_S, 1, &effects)?;
    let read = |through| {
        bench::readings(&scene, &mut scene.accel(scene.seed, RATE_HZ), GRAVITY_UP, RATE_HZ, through)
    };
    let step = scene.accel(scene.seed, RATE_HZ).nominal([1, 0, 0]).x;
    for (axis, (before, behind)) in read(false).into_iter().zip(read(true)).enumerate() {
        let before = bench::analysed(before, RATE_HZ, None).1.found[n].value();
        let behind = bench::analysed(behind, RATE_HZ, Some(step)).1.found[n].value();
        if let Some(found) = before {
            worst = worst.max((found / ACCEL[axis] - 1.0).abs());
        }
        let name = format!("accelerometer {}", ["x", "y", "z"][axis]);
        rows.push(row(&name, ACCEL[axis], ACCEL[axis], before, behind, "m/s²/√Hz"));
    }
    progress(25);
    let header =
        ["axis", "printed", "put in, N", "unit", "read back", "off by", "behind the converter", "off by"];
    let (html, csv) = tabulated(&header, &rows);
    Ok(Exhibit {
        name: "table-2".into(),
        title: "Table 2: angle and speed random walk".into(),
        caption: "The paper prints the gyroscope's values in \"deg/hr\", a unit of bias. Both readings are put into the \
                  simulated sensor, which lies still for an hour at 100 Hz, and are read back from its Allan deviation. \
                  Read as deg/h/√Hz, the noise would be a fifteenth of one step of a common 16-bit converter (16.4 \
                  counts per °/s) and would not be visible at all. Such a sensor shows the noise that deg/√h gives. The \
                  converter's rounding adds a variance of step²/12 per sample."
            .into(),
        html,
        csv,
        further: vec![],
        in_short: format!("N read back within {:.2} %", worst * 100.0),
    })
}

fn row(
    name: &str,
    printed: f64,
    put_in: f64,
    before: Option<f64>,
    behind: Option<f64>,
    unit: &str,
) -> Vec<String> {
    let value = |found: Option<f64>| found.map_or("not visible".into(), short);
    let off =
        |found: Option<f64>| found.map_or("–".into(), |n| format!("{:+.2} %", 100.0 * (n / put_in - 1.0)));
    vec![
        name.into(),
        printed.to_string(),
        short(put_in),
        unit.into(),
        value(before),
        off(before),
        value(behind),
        off(behind),
    ]
}
