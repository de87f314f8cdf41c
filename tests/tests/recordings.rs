//! The estimators over real recordings: four trials of BROAD (Laidig, Caruso, Cereatti, Seel, *Data*
//! 6(7):72, 2021, CC BY 4.0), with inertial sensor and optical reference at 285.7 Hz.
//!
//! The recordings are not part of the project. The environment variable `KESTREL_DATA` names the directory
//! that has them in `broad/`; a relative path starts at the root of the workspace.

use std::path::{Path, PathBuf};

use sim_host::estimate::{Report, Request, run};
use sim_host::log::{AccelSign, Axes, Frame};

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
    /// Total RMSE of their VQF, which estimates the bias and detects magnetic disturbances. The bounds for `robust`
    /// follow from it.
    vqf_total: f64,
}

const TRIALS: [Trial; 4] = [
    Trial {
        file: "02_undisturbed_slow_rotation_B.csv",
        paper_literal: [4.22, 3.86, 1.69],
        paper: [2.91, 0.96],
        paper_inclination_limit: 1.00,
        basic_vqf_total: 2.30,
        vqf_total: 1.38,
    },
    Trial {
        file: "07_undisturbed_fast_rotation_B.csv",
        paper_literal: [12.89, 9.57, 8.72],
        paper: [6.27, 4.46],
        paper_inclination_limit: 4.7,
        basic_vqf_total: 3.49,
        vqf_total: 1.75,
    },
    Trial {
        file: "11_undisturbed_slow_translation_B.csv",
        paper_literal: [12.81, 10.28, 7.67],
        paper: [8.19, 5.68],
        paper_inclination_limit: 5.9,
        basic_vqf_total: 3.70,
        vqf_total: 0.90,
    },
    Trial {
        file: "27_disturbed_phone_vibration_B.csv",
        paper_literal: [13.94, 11.81, 7.43],
        paper: [9.03, 5.38],
        paper_inclination_limit: 5.6,
        basic_vqf_total: 7.23,
        vqf_total: 6.73,
    },
];

fn estimate(trial: &Trial, estimator: &str) -> [f64; 3] {
    let data =
        std::env::var_os("KESTREL_DATA").expect("KESTREL_DATA: must name the directory of the recordings");
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let log: PathBuf = workspace.join(data).join("broad").join(trial.file);
    let request = Request {
        log,
        axes: Axes { frame: Frame::Enu, accel_sign: AccelSign::Reaction },
        estimators: vec![estimator.into()],
        ..Request::default()
    };
    let report: Report = run(&request).unwrap_or_else(|error| panic!("{error}"));
    let score = report.estimators[estimator];
    println!("{} {estimator}: {score:?}", trial.file);
    [score.total_rmse_deg, score.heading_rmse_deg, score.inclination_rmse_deg].map(Option::unwrap)
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
        let ours = estimate(trial, "paper-literal");
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
        let [total, _, inclination] = estimate(trial, "paper");
        assert!(inclination <= trial.paper_inclination_limit, "{}: {inclination}", trial.file);
        assert_within(0.01, &[total, inclination], &trial.paper, trial.file);
    }
}

#[test]
#[ignore = "needs KESTREL_DATA, the BROAD recordings"]
fn flight_error_is_at_most_that_of_basic_vqf() {
    for trial in &TRIALS {
        let [total, ..] = estimate(trial, "flight");
        assert!(total <= trial.basic_vqf_total, "{}: {total}", trial.file);
    }
}

#[test]
#[ignore = "needs KESTREL_DATA, the BROAD recordings"]
fn robust_mean_error_is_at_most_that_of_vqf() {
    let mut sums = [0.0; 3];
    for trial in &TRIALS {
        let score = estimate(trial, "robust");
        let [total, ..] = score;
        // At most half of the error of the paper's filter. In 27 it is at most 0.8, because its field points 6° off
        // north for every filter.
        let share = if trial.vqf_total > 5.0 { 0.8 } else { 0.5 };
        assert!(total <= share * trial.paper[0], "{}: {total}", trial.file);
        assert!(total <= 1.05 * trial.vqf_total, "{}: {total}", trial.file);
        sums = std::array::from_fn(|n| sums[n] + score[n]);
    }
    let [total, _, inclination] = sums.map(|sum| sum / TRIALS.len() as f64);
    println!("mean: total {total}, inclination {inclination}");
    // The means of VQF are 2.69 and 0.56.
    assert!(total <= 2.69 && inclination <= 0.6, "{total} {inclination}");
}
