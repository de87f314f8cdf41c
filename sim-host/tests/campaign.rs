//! Campaigns as a person or a batch system meets them: files, exit codes, the command that flies a run again.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn sim_host(arguments: &[&str], directory: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sim-host")).args(arguments).current_dir(directory).output().unwrap()
}

/// Two seconds on the stand, armed and turning, with a vehicle of its own in each run.
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
fn shards_merged_are_the_unsplit_campaign_byte_for_byte() {
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
    assert_eq!(String::from_utf8(lost.stderr).unwrap(), "error: PART: a part is missing: runs 2 to 3 of 7\n");
    assert!(!directory.join("lost.csv").exists());
}

/// Every run of a campaign is flown again by the command that its summary prints, with the vehicle it had.
#[test]
fn the_printed_command_flies_that_very_run() {
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
    // Another vehicle for each.
    assert_ne!(runs[0]["drawn"], runs[1]["drawn"]);
}

/// The noise of a run is that of the same seed without tolerances: at rest on the bench nothing else differs.
#[test]
fn tolerances_move_no_noise() {
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
    // But for the first moments on its legs, which give by the same millimetre under another weight.
    assert_eq!(plain[500..], spread[500..]);
}

#[test]
fn crashes_are_counted_against_the_budget() {
    let directory = tempfile::tempdir().unwrap();
    let arguments = ["fly", "motor-out", "--runs", "3", "--jobs", "2", "--out", "crashes.csv"];
    for (budget, code) in [(None, 1), (Some("2"), 1), (Some("3"), 0)] {
        let budget = budget.map_or(vec![], |budget| vec!["--max-failures", budget]);
        let flown = sim_host(&[&arguments[..], &budget].concat(), directory.path());
        assert_eq!(flown.status.code(), Some(code), "{flown:?}");
        let merged = sim_host(&[&["merge", "crashes.csv"][..], &budget].concat(), directory.path());
        assert_eq!((merged.status.code(), &merged.stdout), (Some(code), &flown.stdout));
        let text = String::from_utf8(flown.stdout).unwrap();
        assert!(text.starts_with("motor-out: 3 flights, seeds 7 to 9, 3 crashed\n"), "{text}");
        assert!(text.contains("s: tilt above 90°"), "{text}");
    }
}

#[test]
fn what_cannot_be_is_refused_before_anything_flies() {
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

/// Ctrl-C: the flights under way are flown to their end, and no file is left.
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
    // The temporary file is made behind the handler of the signal, and just before the first flight.
    while std::fs::read_dir(directory.path()).unwrap().count() == 0 {
        std::thread::yield_now();
    }
    kill(Pid::from_raw(child.id() as i32), Signal::SIGINT).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{output:?}");
    assert!(output.stdout.is_empty());
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.starts_with("interrupted, no file written: hover: "), "{said}");
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
}
