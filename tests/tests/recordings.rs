//! The estimators over real recordings: nine trials of BROAD (Laidig, Caruso, Cereatti, Seel, *Data*
//! 6(7):72, 2021, CC BY 4.0), with inertial sensor and optical reference at 285.7 Hz.
//!
//! The recordings are not part of the project. The environment variable `KESTREL_DATA` names the directory
//! that has them in `broad/`; a relative path starts at the root of the workspace.

use std::path::Path;

use flight_core::estimator::{Estimator, EstimatorParams, Method, RobustParams};
use flight_core::geometry::Quaternion;
use sim_host::attitude_error::{AttitudeError, AttitudeRmse};
use sim_host::estimate::{Report, Request, run, samples};
use sim_host::log::{AccelSign, Axes, Frame, Log};
use test_support::pages::{read, workspace};

/// A trial: results of an independent program, and bounds for ours; all RMSE in degrees.
struct Trial {
    file: &'static str,
    /// Total, heading and inclination RMSE of `paper-literal` by the independent program.
    paper_literal: [f64; 3],
    /// Total and inclination RMSE of `paper` by the independent program.
    paper: [f64; 2],
    /// Largest allowed inclination RMSE of `paper`.
    paper_inclination_limit: f64,
    /// Total RMSE of the BROAD authors' BasicVQF, a filter without bias estimation. It is the bound for `flight`, whose
    /// gyroscope is zeroed at rest.
    basic_vqf_total: f64,
}

const TRIALS: [Trial; 4] = [
    Trial {
        file: "02_undisturbed_slow_rotation_B.csv",
        paper_literal: [4.22, 3.86, 1.69],
        paper: [2.91, 0.96],
        paper_inclination_limit: 1.00,
        basic_vqf_total: 2.30,
    },
    Trial {
        file: "07_undisturbed_fast_rotation_B.csv",
        paper_literal: [12.89, 9.57, 8.72],
        paper: [6.27, 4.46],
        paper_inclination_limit: 4.7,
        basic_vqf_total: 3.49,
    },
    Trial {
        file: "11_undisturbed_slow_translation_B.csv",
        paper_literal: [12.81, 10.28, 7.67],
        paper: [8.19, 5.68],
        paper_inclination_limit: 5.9,
        basic_vqf_total: 3.70,
    },
    Trial {
        file: "27_disturbed_phone_vibration_B.csv",
        paper_literal: [13.94, 11.81, 7.43],
        paper: [9.03, 5.38],
        paper_inclination_limit: 5.6,
        basic_vqf_total: 7.23,
    },
];

fn request(file: &str, estimator: &str) -> Request {
    let data =
        std::env::var_os("KESTREL_DATA").expect("KESTREL_DATA: must name the directory of the recordings");
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    Request {
        log: workspace.join(data).join("broad").join(file),
        axes: Axes { frame: Frame::Enu, accel_sign: AccelSign::Reaction },
        estimators: vec![estimator.into()],
        ..Request::default()
    }
}

/// Returns the total, heading and inclination RMSE of a preset, degrees.
fn estimate(file: &str, estimator: &str) -> [f64; 3] {
    let report: Report = run(&request(file, estimator)).unwrap_or_else(|error| panic!("{error}"));
    let score = report.estimators[estimator];
    println!("{file} {estimator}: {score:?}");
    [score.total_rmse_deg, score.heading_rmse_deg, score.inclination_rmse_deg].map(Option::unwrap)
}

/// Returns the same for any parameters.
fn estimate_with(file: &str, params: &EstimatorParams) -> [f64; 3] {
    let request = request(file, "robust");
    let log = Log::read(&request.log, request.axes).unwrap();
    let mut estimator = Estimator::new(params).unwrap();
    let mut rmse = AttitudeRmse::default();
    for (sample, row) in samples(&log, &request).unwrap().iter().zip(&log.rows) {
        estimator.update(sample.gyro, sample.accel, sample.mag, sample.dt_s);
        if let (Some([w, x, y, z]), true) = (row.reference, row.moving) {
            let [ew, ex, ey, ez] = estimator.attitude().to_array().map(f64::from);
            let (estimate, truth) = (Quaternion::new(ew, ex, ey, ez), Quaternion::new(w, x, y, z));
            rmse.add(AttitudeError::between(estimate, truth));
        }
    }
    let root = rmse.root().unwrap();
    [root.total_rad, root.heading_rad, root.inclination_rad].map(f64::to_degrees)
}

/// Asserts that each of `ours` is within `share` of the same figure of `theirs`.
#[track_caller]
fn assert_within(share: f64, ours: &[f64], theirs: &[f64], file: &str) {
    for (ours_deg, theirs_deg) in ours.iter().zip(theirs) {
        assert!((ours_deg / theirs_deg - 1.0).abs() <= share, "{file}: {ours:?} against {theirs:?}");
    }
}

#[test]
#[ignore = "needs KESTREL_DATA, the BROAD recordings"]
fn paper_literal_agrees_with_an_independent_program() {
    for trial in &TRIALS {
        let ours = estimate(trial.file, "paper-literal");
        // The largest difference is 0.8 %, in the heading of 07: in twelve of its samples the estimated horizontal
        // field is below 1 µT, and our program leaves these samples out where the other program does not. All other
        // differences are within 0.5 %, mostly rounding of the figures. A difference of 5 % would be acceptable.
        assert_within(0.01, &ours, &trial.paper_literal, trial.file);
    }
}

#[test]
#[ignore = "needs KESTREL_DATA, the BROAD recordings"]
fn paper_agrees_with_an_independent_program() {
    for trial in &TRIALS {
        let [total, _, inclination] = estimate(trial.file, "paper");
        assert!(inclination <= trial.paper_inclination_limit, "{}: {inclination}", trial.file);
        assert_within(0.01, &[total, inclination], &trial.paper, trial.file);
    }
}

#[test]
#[ignore = "needs KESTREL_DATA, the BROAD recordings"]
fn flight_error_is_at_most_that_of_basic_vqf() {
    for trial in &TRIALS {
        let [total, ..] = estimate(trial.file, "flight");
        assert!(total <= trial.basic_vqf_total, "{}: {total}", trial.file);
    }
}

/// A trial, and the total, heading and inclination RMSE of two filters of the authors of BROAD with their defaults, degrees
/// (public implementations, on the same files): BasicVQF, and VQF (9D), which also estimates the bias and detects
/// magnetic disturbances.
struct Published {
    file: &'static str,
    title: &'static str,
    basic_vqf: [f64; 3],
    vqf: [f64; 3],
}

const fn published(file: &'static str, title: &'static str, basic_vqf: [f64; 3], vqf: [f64; 3]) -> Published {
    Published { file, title, basic_vqf, vqf }
}

const PUBLISHED: [Published; 9] = [
    published(
        "02_undisturbed_slow_rotation_B.csv",
        "02 slow rotation B",
        [2.30, 2.10, 0.95],
        [1.38, 1.31, 0.43],
    ),
    published(
        "07_undisturbed_fast_rotation_B.csv",
        "07 fast rotation B",
        [3.49, 3.19, 1.41],
        [1.75, 1.43, 1.02],
    ),
    published(
        "08_undisturbed_fast_rotation_with_breaks_A.csv",
        "08 fast rotation with breaks A",
        [4.13, 3.66, 1.92],
        [3.34, 2.84, 1.76],
    ),
    published(
        "11_undisturbed_slow_translation_B.csv",
        "11 slow translation B",
        [3.70, 3.53, 1.11],
        [0.90, 0.80, 0.42],
    ),
    published(
        "16_undisturbed_fast_translation_B.csv",
        "16 fast translation B",
        [3.30, 3.08, 1.19],
        [0.74, 0.51, 0.54],
    ),
    published("21_undisturbed_fast_combined.csv", "21 fast combined", [4.21, 3.86, 1.69], [4.08, 3.70, 1.72]),
    published(
        "27_disturbed_phone_vibration_B.csv",
        "27 phone vibration B",
        [7.23, 7.08, 1.45],
        [6.73, 6.72, 0.37],
    ),
    published(
        "30_disturbed_stationary_magnet_C.csv",
        "30 stationary magnet C",
        [3.72, 3.52, 1.18],
        [2.57, 2.25, 1.25],
    ),
    published(
        "33_disturbed_attached_magnet_2cm.csv",
        "33 attached magnet 2 cm",
        [5.98, 5.95, 0.56],
        [3.75, 3.70, 0.60],
    ),
];

/// Returns the mean of each column.
fn means(rows: &[[f64; 3]]) -> [f64; 3] {
    std::array::from_fn(|column| rows.iter().map(|row| row[column]).sum::<f64>() / rows.len() as f64)
}

#[test]
#[ignore = "needs KESTREL_DATA, the BROAD recordings"]
fn robust_is_better_than_vqf() {
    let ours = PUBLISHED.map(|trial| estimate(trial.file, "robust"));
    for (Published { file, vqf, .. }, ours) in PUBLISHED.iter().zip(&ours) {
        assert!(ours[0] <= 1.06 * vqf[0], "{file}: {ours:?} against {vqf:?}");
    }
    let ([total, _, inclination], vqf) = (means(&ours), means(&PUBLISHED.map(|trial| trial.vqf)));
    println!("mean: total {total}, inclination {inclination}, of VQF {vqf:?}");
    assert!(total <= 2.2 && inclination <= 0.74, "{total} {inclination}");
}

/// One set of parameters for nine trials may still be a lucky one: with any other choice nearby the filter keeps its
/// advantage. (The whole grid moves together: 0.15 to 0.6 m/s, 0.09 to 0.19 rad/√Hz.)
#[test]
#[ignore = "needs KESTREL_DATA, the BROAD recordings"]
fn parameters_of_robust_lie_on_a_plateau() {
    for (speed_m_s, heading_noise_rad) in
        [(0.15, 0.13), (0.6, 0.13), (0.3, 0.09), (0.3, 0.19), (0.15, 0.09), (0.6, 0.19)]
    {
        let method = Method::Robust(RobustParams { speed_m_s, heading_noise_rad });
        let params = EstimatorParams { method, declination_rad: 0.0 };
        let [total, _, inclination] = means(&PUBLISHED.map(|trial| estimate_with(trial.file, &params)));
        println!(
            "{speed_m_s} m/s, {heading_noise_rad} rad/√Hz: total {total:.2}, inclination {inclination:.2}"
        );
        assert!(total <= 2.5 && inclination <= 0.8, "{total} {inclination}");
    }
}

/// The tables on the pages show what the estimators measure now. Write them with KESTREL_WRITE_DOCS=1.
#[test]
#[ignore = "needs KESTREL_DATA, the BROAD recordings"]
fn tables_on_pages_are_current() {
    let measured = |column: &str| -> Vec<[f64; 3]> {
        PUBLISHED
            .iter()
            .map(|trial| match column {
                "BasicVQF" => trial.basic_vqf,
                "VQF" => trial.vqf,
                preset => estimate(trial.file, preset.trim_matches('`')),
            })
            .collect()
    };
    let cell = |errors: &[f64; 3]| errors.map(|error| format!("{error:.2}")).join(" / ");
    for page in ["README.md", "docs/estimators.md"] {
        let text = read(page);
        let header = text.lines().find(|line| line.starts_with("| trial |")).expect(page);
        let columns: Vec<&str> = header.trim_matches('|').split('|').map(str::trim).skip(1).collect();
        let errors: Vec<Vec<[f64; 3]>> = columns.iter().map(|column| measured(column)).collect();
        let mut rows: Vec<String> = (0..PUBLISHED.len())
            .map(|trial| {
                let cells: Vec<String> = errors.iter().map(|column| cell(&column[trial])).collect();
                format!("| {} | {} |", PUBLISHED[trial].title, cells.join(" | "))
            })
            .collect();
        let mean: Vec<String> = errors.iter().map(|column| cell(&means(column))).collect();
        rows.push(format!("| mean | {} |", mean.join(" | ")));
        let rule = format!("|{}", "---|".repeat(columns.len() + 1));
        let table = format!("{header}\n{rule}\n{}\n", rows.join("\n"));
        if text.contains(&table) {
            continue;
        }
        assert!(std::env::var_os("KESTREL_WRITE_DOCS").is_some(), "{page}: must contain\n{table}");
        let start = text.find(header).unwrap();
        let end = start + text[start..].find("\n\n").unwrap() + 1;
        std::fs::write(workspace().join(page), [&text[..start], &table, &text[end..]].concat()).unwrap();
    }
}
