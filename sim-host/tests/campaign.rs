//! Campaigns on the command line: files, exit codes, and the command that repeats a run.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn sim_host(arguments: &[&str], directory: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sim-host")).args(arguments).current_dir(directory).output().unwrap()
}

/// A scene on the test stand with 2 s of motion, and another vehicle in each run.
const SPREAD: &str = "include = \"stand-steps\"
[scene]
duration_s = 8.5
[tolerances]
inertia_kg_m2 = { uniform_percent = 5 }
thrust_coefficient_n_s2 = { normal_percent = 5 }
motor_lag_tau_s = { uniform_percent = 20 }
imu_mounting_mrad = { normal = 5 }
";

fn with_scene() -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    std::fs::write(directory.path().join("spread.toml"), SPREAD).unwrap();
    directory
}

fn read(directory: &Path, file: &str) -> String {
    std::fs::read_to_string(directory.join(file)).unwrap()
}

#[test]
fn merged_shards_equal_the_campaign_byte_for_byte() {
    let directory = with_scene();
    let directory = directory.path();
    let fly = |arguments: &[&str]| {
        let output = sim_host(&[&["fly", "spread.toml", "--runs", "7"], arguments].concat(), directory);
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        output
    };
    let whole = fly(&["--out", "whole.csv", "--jobs", "1"]);
    assert_eq!(fly(&["--out", "jobs.csv", "--jobs", "3"]).stdout, whole.stdout);
    assert_eq!(read(directory, "jobs.csv"), read(directory, "whole.csv"));
    for part in ["1", "2", "3"] {
        fly(&["--shard", &format!("{part}/3"), "--out", &format!("part-{part}.csv")]);
    }
    let parts = ["part-3.csv", "part-1.csv", "part-2.csv"];
    let merged = sim_host(&[&["merge"], &parts[..], &["--out", "merged.csv"]].concat(), directory);
    assert_eq!(merged.status.code(), Some(0), "{merged:?}");
    assert_eq!(read(directory, "merged.csv"), read(directory, "whole.csv"));
    assert_eq!(merged.stdout, whole.stdout);

    let lost = sim_host(&["merge", "part-1.csv", "part-3.csv", "--out", "lost.csv"], directory);
    assert_eq!(lost.status.code(), Some(2));
    assert_eq!(
        String::from_utf8(lost.stderr).unwrap(),
        "error: PART: must include runs 2 to 3 of 7: the file of a shard is missing\n"
    );
    assert!(!directory.join("lost.csv").exists());
}

/// The commands that the summary of a campaign prints repeat its runs, with the same drawn values.
#[test]
fn printed_command_repeats_the_run() {
    let directory = with_scene();
    let arguments = ["fly", "spread.toml", "--runs", "4", "--seed", "100", "--duration", "9", "--json"];
    let output = sim_host(&arguments, directory.path());
    let campaign: Value = serde_json::from_slice(&output.stdout).unwrap();
    let runs = campaign["runs"].as_array().unwrap();
    let worst = campaign["worst"]["by_tilt"].as_array().unwrap();
    assert_eq!((runs.len(), worst.len()), (4, 4));
    for worst in worst {
        let mut words = worst["command"].as_str().unwrap().split(' ');
        assert_eq!(words.next(), Some("sim-host"));
        let command: Vec<&str> = words.chain(["--json"]).collect();
        let again: Value = serde_json::from_slice(&sim_host(&command, directory.path()).stdout).unwrap();
        let run = runs.iter().find(|run| run["seed"] == worst["seed"]).unwrap();
        for key in ["seed", "digest", "attitude_rmse_deg", "tilt_max_deg", "final_state", "drawn"] {
            assert_eq!(run[key], again[key], "{key}");
        }
        assert_eq!(run["drawn"].as_object().unwrap().len(), 3 + 4 + 1 + 3);
    }
    // Each run has another vehicle.
    assert_ne!(runs[0]["drawn"], runs[1]["drawn"]);
}

#[test]
fn plan_lists_tolerances_and_the_effects_that_they_add() {
    let directory = with_scene();
    let output = sim_host(&["plan", "spread.toml", "--json"], directory.path());
    let plan: Value = serde_json::from_slice(&output.stdout).unwrap();
    let names = |key: &str| -> Vec<String> {
        let list = plan[key].as_array().unwrap().iter();
        list.map(|one| one.as_str().or(one["name"].as_str()).unwrap().to_owned()).collect()
    };
    let drawn = ["inertia_kg_m2", "thrust_coefficient_n_s2", "motor_lag_tau_s", "imu_mounting_mrad"];
    assert_eq!(names("tolerances"), drawn);
    assert_eq!(plan["tolerances"][1]["drawn"], "normal ±5 %");
    let (runs, left_out) = (names("effects"), names("left_out"));
    for effect in ["tolerances.thrust", "gyro.misalignment", "accel.misalignment"] {
        assert!(runs.iter().any(|name| name == effect), "{effect} is not in {runs:?}");
    }
    assert!(runs.iter().all(|name| !left_out.contains(name)), "{left_out:?}");
}

/// A run has the same noise as the run with the same seed without tolerances. At rest on the bench only the noise differs
/// from sample to sample, so the samples must be equal.
#[test]
fn tolerances_do_not_change_the_noise() {
    let directory = tempfile::tempdir().unwrap();
    let logs =
        ["", "[tolerances]\nmass_kg = { normal_percent = 20 }\narm_m = { uniform = 0.01 }\n"].map(|lines| {
            let scene = format!("include = \"static\"\n[scene]\nduration_s = 1.0\n{lines}");
            std::fs::write(directory.path().join("scene.toml"), scene).unwrap();
            let output = sim_host(&["fly", "scene.toml", "--log", "log.csv"], directory.path());
            assert_eq!(output.status.code(), Some(0), "{output:?}");
            read(directory.path(), "log.csv")
        });
    let readings = |log: &str| -> Vec<Vec<String>> {
        log.lines().skip(1).map(|line| line.split(',').take(10).map(str::to_owned).collect()).collect()
    };
    let [plain, spread] = logs.map(|log| readings(&log));
    assert_eq!(plain.len(), 1000);
    // The first 0.5 s differ: the vehicle settles on its legs, which depends on its mass.
    assert_eq!(plain[500..], spread[500..]);
}

#[test]
fn more_crashes_than_max_failures_exit_with_1() {
    let directory = tempfile::tempdir().unwrap();
    let arguments = ["fly", "motor-out", "--runs", "3", "--jobs", "2", "--out", "crashes.csv"];
    for (max_failures, code) in [(None, 1), (Some("2"), 1), (Some("3"), 0)] {
        let option = max_failures.map_or(vec![], |max| vec!["--max-failures", max]);
        let flown = sim_host(&[&arguments[..], &option].concat(), directory.path());
        assert_eq!(flown.status.code(), Some(code), "{flown:?}");
        let merged = sim_host(&[&["merge", "crashes.csv"][..], &option].concat(), directory.path());
        assert_eq!((merged.status.code(), &merged.stdout), (Some(code), &flown.stdout));
        let text = String::from_utf8(flown.stdout).unwrap();
        assert!(text.starts_with("motor-out: 3 flights, seeds 7 to 9, 3 crashed\n"), "{text}");
        assert!(text.contains("s: tilt above 90°"), "{text}");
    }
}

#[test]
fn bad_arguments_are_refused_before_the_first_flight() {
    let directory = tempfile::tempdir().unwrap();
    for arguments in [
        &["--jobs", "0", "--runs", "2"][..],
        &["--jobs", "2"],
        &["--shard", "1/2", "--runs", "2"],
        &["--shard", "3/2", "--runs", "2", "--out", "a.csv"],
        &["--shard", "1/3", "--runs", "2", "--out", "a.csv"],
        &["--out", "a.csv"],
        &["--runs", "2", "--out", "nowhere/a.csv"],
        &["--runs", "2", "--max-failures", "-1"],
    ] {
        let output = sim_host(&[&["fly", "hover"], arguments].concat(), directory.path());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {output:?}");
        assert!(output.stdout.is_empty() && !output.stderr.is_empty(), "{arguments:?}");
    }
    assert_eq!(sim_host(&["merge"], directory.path()).status.code(), Some(2));
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
}

/// After Ctrl-C the running flights are finished, no further one starts, and no file is left.
#[cfg(target_os = "linux")]
#[test]
fn ctrl_c_ends_a_campaign_and_leaves_no_file() {
    use nix::sys::signal::{Signal, kill};
    use nix::unistd::Pid;

    let directory = tempfile::tempdir().unwrap();
    let child = Command::new(env!("CARGO_BIN_EXE_sim-host"))
        .args(["fly", "hover", "--runs", "1000000", "--out", "results.csv"])
        .current_dir(directory.path())
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    // The temporary file is created after the signal handler is installed, and just before the first flight.
    while std::fs::read_dir(directory.path()).unwrap().count() == 0 {
        std::thread::yield_now();
    }
    kill(Pid::from_raw(child.id() as i32), Signal::SIGINT).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{output:?}");
    assert!(output.stdout.is_empty());
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.starts_with("interrupted, no file written: hover: "), "{message}");
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
}
