//! The program on the command line: results, errors, exit codes.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn sim_host(arguments: &[&str], directory: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sim-host")).args(arguments).current_dir(directory).output().unwrap()
}

fn json(arguments: &[&str]) -> Value {
    let output = sim_host(arguments, Path::new("."));
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(text.lines().count(), 1, "one object and nothing else: {text}");
    serde_json::from_str(&text).unwrap()
}

const HOVER: &str = include_str!("../scenes/hover.toml");

const LOG: &str = "time_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2\n\
                   0.00,0,0,0,0,0,-9.81\n0.01,0,0,0,0,0,-9.81\n0.02,0,0,0,0,0,-9.81\n";

/// A file with one error, and the error message of one line that is expected.
struct Case {
    name: &'static str,
    arguments: &'static [&'static str],
    file: &'static str,
    text: String,
    expected: &'static str,
}

fn scene(name: &'static str, from: &str, to: &str, expected: &'static str) -> Case {
    assert!(HOVER.contains(from), "the scene has no {from}");
    Case { name, arguments: &["fly", "bad.toml"], file: "bad.toml", text: HOVER.replace(from, to), expected }
}

fn log(name: &'static str, text: String, expected: &'static str) -> Case {
    Case { name, arguments: &["estimate", "bad.csv"], file: "bad.csv", text, expected }
}

fn cases() -> Vec<Case> {
    vec![
        scene(
            "an unknown key",
            "seed = 7",
            "sed = 7",
            "bad.toml:5: scene.sed: unknown key: must be one of description, duration_s, seed, vehicle, imu, mount, \
             aerobatic, place (did you mean `seed`?)",
        ),
        scene(
            "an unknown effect",
            "[effects.gyro.white_noise]",
            "[effects.gyro.whitenoise]",
            "bad.toml:24: effects.gyro.whitenoise: unknown key: must be one of vibration, bandwidth, g_sensitivity, \
             misalignment, scale_factor, temperature, constant_bias, turn_on_bias, bias_step, rate_ramp, \
             rate_random_walk, bias_instability, white_noise, saturation, quantization (did you mean `white_noise`?)",
        ),
        scene(
            "a negative mass",
            "[flight]",
            "[vehicle]\nmass_g = -650.0\n[flight]",
            "bad.toml:10: vehicle.mass_g = -650.0: must be from 10 to 100000 g",
        ),
        scene(
            "an unknown key of a vehicle",
            "[flight]",
            "[vehicle]\nmass = 650.0\n[flight]",
            "bad.toml:10: vehicle.mass: unknown key: must be one of description, mass_g, cells, feet_mm, inertia, rotors, \
             drag, esc, gains, rates, filters, battery, rc, mounting (did you mean `mass_g`?)",
        ),
        scene(
            "a cutoff above Nyquist",
            "[flight]",
            "[flight]\nprefilter_hz = 50.0",
            "bad.toml:10: flight.prefilter_hz = 50.0: must be above 0.5 and below 49.95 Hz, just below half the magnetometer's rate",
        ),
        scene(
            "an unknown estimator",
            "[flight]",
            "[flight]\nestimator = \"fligth\"",
            "bad.toml:10: flight.estimator = fligth: must be one of paper, paper-literal, flight, robust (did you mean `flight`?)",
        ),
        scene(
            "not a number",
            "duration_s = 30.0",
            "duration_s = nan",
            "bad.toml:4: scene.duration_s = nan: must be from 0.01 to 1000000 s",
        ),
        scene(
            "a string for a number",
            "duration_s = 30.0",
            "duration_s = \"long\"",
            "bad.toml:4: scene.duration_s = \"long\": must be a number",
        ),
        scene(
            "four numbers for three axes",
            "field_ut = [0.0, 200.0, 0.0]",
            "field_ut = [0.0, 200.0, 0.0, 0.0]",
            "bad.toml:30: effects.mag.hard_iron.field_ut = [0.0, 200.0, 0.0, 0.0]: must be a list of three numbers",
        ),
        scene(
            "a negative seed",
            "seed = 7",
            "seed = -7",
            "bad.toml:5: scene.seed = -7: must be a whole number from 0 to 18446744073709551615",
        ),
        scene(
            "an effect without a value",
            "[effects.mag.white_noise]",
            "[effects.mag.latency]",
            "bad.toml:28: effects.mag.latency.latency_s: is missing: give it here, or in the IMU preset (scene.imu)",
        ),
        scene(
            "a calibration out of range",
            "bias = [0.0, 200.0, 0.0]",
            "bias = [0.0, 2e6, 0.0]",
            "bad.toml:11: flight.calibration.mag_ut.bias = 2000000: must be from -1000000 to 1000000 µT",
        ),
        scene(
            "a throttle for a pilot that holds a position",
            "kind = \"hold\"",
            "kind = \"hold\"\nthrottle = 0.5",
            "bad.toml:15: pilot.throttle: is only for a pilot with base = \"centred\"",
        ),
        scene(
            "a fault after the end",
            "[pilot]",
            "[[fault]]\nkind = \"dead\"\nsensor = \"mag\"\nat_s = 29.0\n[[fault]]\nkind = \"dead\"\nsensor = \"imu\"\nat_s = 30.0\n[pilot]",
            "bad.toml:20: fault.at_s = 30.0: must be below the length of the scene, 30 s",
        ),
        scene("invalid TOML", "[scene]", "[scene", "bad.toml:2: unclosed table, expected `]`"),
        Case {
            name: "an empty scene",
            arguments: &["fly", "bad.toml"],
            file: "bad.toml",
            text: String::new(),
            expected: "bad.toml: is empty; a scene needs a [scene] table",
        },
        Case {
            name: "an unknown scene",
            arguments: &["fly", "hovr"],
            file: "unused",
            text: String::new(),
            expected: "SCENE = hovr: must be one of hover, steps, stand-steps, static, bench-static, \
                   windy-landing, hot-day, weak-battery, magnetic-site, motor-out, shaky-frame, bad-link, \
                   rough-sampling, whole-drive (did you mean `hover`?); or the path of a scene file",
        },
        Case {
            name: "a scene file that does not exist",
            arguments: &["fly", "nosuch.toml"],
            file: "unused",
            text: String::new(),
            expected: "SCENE = nosuch.toml: this file does not exist",
        },
        Case {
            name: "a negative seed on the command line",
            arguments: &["fly", "--seed", "-1"],
            file: "unused",
            text: String::new(),
            expected: "--seed = -1: must be a whole number from 0 to 18446744073709551615",
        },
        Case {
            name: "no thread",
            arguments: &["fly", "--runs", "2", "--jobs", "0"],
            file: "unused",
            text: String::new(),
            expected: "--jobs = 0: must be a whole number from 1 to 65535",
        },
        Case {
            name: "a word for a number of runs",
            arguments: &["fly", "--runs", "abc"],
            file: "unused",
            text: String::new(),
            expected: "--runs = abc: must be a whole number from 1 to 1000000",
        },
        Case {
            name: "a word that no option has",
            arguments: &["estimate", "log.csv", "--frame", "nde"],
            file: "unused",
            text: String::new(),
            expected: "--frame = nde: must be one of ned, enu (did you mean `ned`?)",
        },
        Case {
            name: "a duration too short to land",
            arguments: &["fly", "hover", "--duration", "6"],
            file: "unused",
            text: String::new(),
            expected: "--duration = 6: must be at least 13 s: take-off 5 s after the start, landing 8 s before the end",
        },
        Case {
            name: "a rate that is not a divisor of 1000 Hz",
            arguments: &["sense", "hover", "--rate-hz", "300"],
            file: "unused",
            text: String::new(),
            expected: "--rate-hz = 300: must be 1000 Hz or 1000 Hz divided by a whole number, for a scene that flies",
        },
        scene(
            "an array for a table",
            "[effects.gyro.white_noise]",
            "[[effects.gyro.white_noise]]",
            "bad.toml:24: effects.gyro.white_noise: must be a table",
        ),
        scene(
            "a table for a word",
            "kind = \"hold\"",
            "kind = { hold = {} }",
            "bad.toml:14: pilot.kind = { hold = {} }: must be text in quotes",
        ),
        Case {
            name: "a calibration in a list",
            arguments: &["fly", "bad.toml"],
            file: "bad.toml",
            text: "include = \"hover\"
[flight]
calibration = [[[0, 0, 0]]]
"
            .into(),
            expected: "bad.toml:3: flight.calibration = [[[0, 0, 0]]]: must be a table",
        },
        scene(
            "an empty list of harmonics",
            "[effects.gyro.white_noise]",
            "[effects.gyro.vibration]\nharmonics = []\n[effects.gyro.white_noise]",
            "bad.toml:25: effects.gyro.vibration.harmonics = []: must have 1 to 8 entries",
        ),
        scene(
            "a rotor beyond the integer's type",
            "[pilot]",
            "[effects.vehicle.motor_failure]\nrotor = 4294967296\nat_s = 3.0\n[pilot]",
            "bad.toml:14: effects.vehicle.motor_failure.rotor = 4294967296: must be a whole number from 1 to 4",
        ),
        scene(
            "a seed that is given twice",
            "seed = 7",
            "seed = 7\nseed = 8",
            "bad.toml:6: seed: must be given only once",
        ),
        Case {
            name: "a description that turns the text",
            arguments: &["fly", "bad.toml"],
            file: "bad.toml",
            text: "include = \"hover\"
scene.description = \"a\\u202eb\"
"
            .into(),
            expected: "bad.toml:2: scene.description = a\\u{202e}b: must be one line without control characters",
        },
        Case {
            name: "an empty include",
            arguments: &["fly", "bad.toml"],
            file: "bad.toml",
            text: "include = \"\"\n".into(),
            expected: "bad.toml:1: include = \"\": must be the name of a built-in scene, or the path of a scene file",
        },
        Case {
            name: "a list of scene keys",
            arguments: &["fly", "bad.toml"],
            file: "bad.toml",
            text: "include = \"hover\"\nscene = []\n".into(),
            expected: "bad.toml:2: scene: must be a table",
        },
        Case {
            name: "a preset without an accelerometer",
            arguments: &["fly", "bad.toml"],
            file: "bad.toml",
            text: "include = \"hover\"\nscene.imu = \"bad.toml\"\n".into(),
            expected: "bad.toml:1: include: unknown key: must be one of gyro, accel, mag, effects",
        },
        Case {
            name: "capital letters that are small",
            arguments: &["fly", "bad.toml"],
            file: "bad.toml",
            text: "include = \"hover\"\n[vehicle.rc]\norder = \"aetr\"\n".into(),
            expected: "bad.toml:3: vehicle.rc.order = aetr: must be the capital letters A, E, T and R in channel order, such as AETR or TAER",
        },
        Case {
            name: "gains that the flight controller rejects",
            arguments: &["fly", "hover", "--vehicle", "bad.toml"],
            file: "bad.toml",
            text: include_str!("../../vehicles/five-inch.toml")
                .replace("[3.0e-3, 3.2e-3, 5.5e-3]", "[2e-6, 2e-6, 2e-6]"),
            expected: "bad.toml:8: inertia: gives control.max_integral_rad_s2 = 37200: must be from 0 to 1000 for the flight \
                   controller: check inertia, rotors and mass_g, or give [gains]",
        },
        Case {
            name: "a seed too large for the runs",
            arguments: &["fly", "--seed", "18446744073709551615", "--runs", "2"],
            file: "unused",
            text: String::new(),
            expected: "--seed = 18446744073709551615: must be from 0 to 18446744073709551614 for 2 runs",
        },
        Case {
            name: "more shards than runs",
            arguments: &["fly", "--runs", "2", "--shard", "3/8", "--out", "x.csv"],
            file: "unused",
            text: String::new(),
            expected: "--shard = 3/8: must have at most as many shards as there are runs, 2",
        },
        Case {
            name: "a duration without a sample",
            arguments: &["sense", "static", "--duration", "0.01", "--rate-hz", "50"],
            file: "unused",
            text: String::new(),
            expected: "--rate-hz = 50: must be at least 100.000 Hz: 0.01 s have no sample",
        },
        Case {
            name: "an option that does not exist",
            arguments: &["fly", "--sead", "3"],
            file: "unused",
            text: String::new(),
            expected: "--sead: unknown argument (did you mean `--seed`?)",
        },
        Case {
            name: "a command that does not exist",
            arguments: &["fyl"],
            file: "unused",
            text: String::new(),
            expected: "COMMAND = fyl: unknown command; --help lists the commands",
        },
        Case {
            name: "an option without its value",
            arguments: &["fly", "--seed"],
            file: "unused",
            text: String::new(),
            expected: "--seed: must have a value",
        },
        Case {
            name: "an option that is missing",
            arguments: &["config", "hover"],
            file: "unused",
            text: String::new(),
            expected: "--out <F.bin>: is missing",
        },
        Case {
            name: "an option twice",
            arguments: &["fly", "--seed", "1", "--seed", "2"],
            file: "unused",
            text: String::new(),
            expected: "--seed: must be given only once",
        },
        Case {
            name: "options that exclude each other",
            arguments: &["fly", "--log", "same.csv", "--out", "same.csv"],
            file: "unused",
            text: String::new(),
            expected: "--log: cannot be used with --out",
        },
        Case {
            name: "a value for an option without one",
            arguments: &["fly", "--json=3"],
            file: "unused",
            text: String::new(),
            expected: "unexpected value '3' for '--json' found; no more were expected",
        },
        Case {
            name: "an endless log",
            arguments: &["estimate", "/dev/zero"],
            file: "unused",
            text: String::new(),
            expected: "/dev/zero: must be a regular file or a pipe",
        },
        Case {
            name: "an endless part",
            arguments: &["merge", "/dev/zero"],
            file: "unused",
            text: String::new(),
            expected: "/dev/zero: must be a regular file or a pipe",
        },
        Case {
            name: "an endless image",
            arguments: &["hil", "hover", "--qemu", "--image", "/dev/zero"],
            file: "unused",
            text: String::new(),
            expected: "--image = /dev/zero: cannot be read: it must be a regular file",
        },
        log("an empty log", String::new(), "bad.csv: the file is empty: a log must begin with a header row"),
        log(
            "a log with a NaN",
            LOG.replace("0.01,0,", "0.01,nan,"),
            "bad.csv:3: gyro_x_rad_s = nan: must be a number from -1000000 to 1000000",
        ),
        log(
            "a log without a column",
            LOG.replace("accel_z_m_s2", "accel_w_m_s2"),
            "bad.csv:1: accel_z_m_s2: the column is missing: a log must have time_s, gyro_{x,y,z}_rad_s and accel_{x,y,z}_m_s2",
        ),
        log(
            "time running backwards",
            LOG.replace("0.02,", "0.005,"),
            "bad.csv:4: time_s = 0.005: must be at least 1 µs after the previous row (0.01 s)",
        ),
    ]
}

#[test]
fn bad_input_gives_a_one_line_error_and_exit_code_2() {
    let mut wrong = Vec::new();
    for case in cases() {
        let directory = tempfile::tempdir().unwrap();
        std::fs::write(directory.path().join(case.file), &case.text).unwrap();
        let output = sim_host(case.arguments, directory.path());
        let error = String::from_utf8(output.stderr).unwrap();
        if error != format!("error: {}\n", case.expected)
            || output.status.code() != Some(2)
            || !output.stdout.is_empty()
        {
            wrong.push(format!(
                "{}: exit {:?}\n  got      {error}  expected error: {}",
                case.name, output.status, case.expected
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A message that cannot be written does not change the exit code.
#[cfg(target_os = "linux")]
#[test]
fn unwritable_standard_error_keeps_the_exit_code() {
    for arguments in [&["plan", "nope.toml"][..], &["fly", "--sead"], &["cost", "--sead"]] {
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let mut program = Command::new(env!("CARGO_BIN_EXE_sim-host"));
        // `cost` starts a program that does not exist.
        let status = program.args(arguments).env("CARGO", "/nonexistent").stderr(full).status().unwrap();
        assert_eq!(status.code(), Some(2), "{arguments:?}");
    }
}

/// A pipe whose reader has ended is no error.
#[cfg(target_os = "linux")]
#[test]
fn log_to_a_pipe_without_a_reader_is_no_error() {
    use std::io::Read as _;
    use std::process::Stdio;
    let mut program = Command::new(env!("CARGO_BIN_EXE_sim-host"));
    program.args(["sense", "static", "--duration", "20", "--out", "/dev/stdout"]).stdout(Stdio::piped());
    let mut sense = program.stderr(Stdio::piped()).spawn().unwrap();
    sense.stdout.take().unwrap().read_exact(&mut [0; 6]).unwrap();
    let output = sense.wait_with_output().unwrap();
    assert_eq!((output.status.code(), output.stderr.len()), (Some(0), 0), "{output:?}");
}

/// A signal ends the program with its own exit code, and no temporary file stays. `nohup` keeps the program running.
#[cfg(target_os = "linux")]
#[test]
fn signals_remove_temporary_files() {
    use nix::sys::signal::{Signal, kill};
    use nix::unistd::Pid;
    let directory = tempfile::tempdir().unwrap();
    let files = || std::fs::read_dir(directory.path()).unwrap().count();
    let program = env!("CARGO_BIN_EXE_sim-host");
    let sense = ["sense", "static", "--duration", "100000", "--out", "log.csv"];
    for (program, before, signal, code) in [
        (program, None, Signal::SIGINT, 130),
        (program, None, Signal::SIGTERM, 143),
        (program, None, Signal::SIGHUP, 129),
        ("nohup", Some(program), Signal::SIGHUP, 143),
    ] {
        let mut command = Command::new(program);
        command.args(before).args(sense).current_dir(directory.path());
        let null = std::process::Stdio::null;
        let mut sense = command.stdin(null()).stdout(null()).stderr(null()).spawn().unwrap();
        while files() == 0 {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        let pid = Pid::from_raw(sense.id() as i32);
        kill(pid, signal).unwrap();
        if before.is_some() {
            std::thread::sleep(std::time::Duration::from_millis(200));
            assert!(sense.try_wait().unwrap().is_none(), "nohup ignores SIGHUP");
            kill(pid, Signal::SIGTERM).unwrap();
        }
        assert_eq!((sense.wait().unwrap().code(), files()), (Some(code), 0), "{signal}");
    }
}

#[test]
fn all_output_paths_are_checked_before_the_flight() {
    let directory = tempfile::tempdir().unwrap();
    let output = sim_host(&["fly", "--log", "log.csv", "--report", "missing/report.html"], directory.path());
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(error.starts_with("error: missing/report.html: cannot be written: "), "{error}");
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
}

#[test]
fn usage_errors_exit_with_2() {
    for arguments in
        [&["fyl"][..], &["fly", "--sead", "3"], &["fly", "--runs", "0"], &["fly", "--seed", "x"], &[]]
    {
        let output = sim_host(arguments, Path::new("."));
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(output.stdout.is_empty() && !output.stderr.is_empty());
    }
}

#[test]
fn unwritable_output_leaves_no_file() {
    let directory = tempfile::tempdir().unwrap();
    let output = sim_host(&["fly", "hover", "--log", "missing/log.csv"], directory.path());
    assert_eq!(output.status.code(), Some(2));
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
}

#[test]
fn fly_json_has_the_documented_keys() {
    let flight = json(&["fly", "--json"]);
    assert_eq!(flight["scene"], "hover");
    assert_eq!((flight["seed"].as_u64(), flight["control_steps"].as_u64()), (Some(7), Some(30_000)));
    for key in
        ["duration_s", "wall_s", "steps_per_s", "real_time_factor", "attitude_rmse_deg", "tilt_max_deg"]
    {
        assert!(flight[key].as_f64().is_some_and(|x| x > 0.0), "{key}: {flight}");
    }
    assert_eq!(
        (flight["crashed"].as_bool(), flight["final_state"].as_str()),
        (Some(false), Some("Disarmed"))
    );
    let digest = flight["digest"].as_str().unwrap();
    assert_eq!(json(&["fly", "hover", "--json"])["digest"], digest);
    assert_ne!(json(&["fly", "hover", "--seed", "8", "--json"])["digest"], digest);
}

#[test]
fn landing_that_the_end_cuts_off_is_a_warning() {
    assert_eq!(json(&["fly", "hover", "--json"])["warnings"].as_array().unwrap().len(), 0);
    let directory = tempfile::tempdir().unwrap();
    let text = "include = \"hover\"\n[pilot]\nland_before_end_s = 2.0\n";
    std::fs::write(directory.path().join("short.toml"), text).unwrap();
    let warning =
        "the scene ended during the landing, in the state Armed: pilot.land_before_end_s is too short";
    let output = sim_host(&["fly", "short.toml", "--json"], directory.path());
    let flight: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((output.status.code(), &flight["warnings"]), (Some(0), &serde_json::json!([warning])));
    let text = String::from_utf8(sim_host(&["fly", "short.toml"], directory.path()).stdout).unwrap();
    assert!(text.ends_with(&format!("\n  warning: {warning}\n")), "{text}");
}

#[test]
fn event_that_duration_cuts_off_is_a_warning() {
    let flight = json(&["fly", "bad-link", "--duration", "14", "--json"]);
    let warning = "effects.link.outage.at_s = 14: has no effect, the scene ends at 14 s";
    assert_eq!(flight["warnings"], serde_json::json!([warning]));
    let flight = json(&["fly", "stand-steps", "--duration", "15", "--json"]);
    let warning = "pilot.move.at_s = 18: has no effect, the scene ends at 15 s";
    assert_eq!(flight["warnings"], serde_json::json!([warning]));
}

#[test]
fn lists_have_a_space_between_name_and_text() {
    let print = |arguments: &[&str]| String::from_utf8(sim_host(arguments, Path::new(".")).stdout).unwrap();
    assert!(print(&["scenes"]).contains("\nrough-sampling  steps with late, "));
    let directory = tempfile::tempdir().unwrap();
    let text = include_str!("../../vehicles/os4.toml")
        .replace("kg_m2 = [7.5e-3, 7.5e-3, 1.3e-2]", "hub_g = 400.0\nhub_mm = [150.0, 150.0, 80.0]");
    let text: String =
        text.lines().filter(|line| !line.starts_with("description")).flat_map(|line| [line, "\n"]).collect();
    std::fs::write(directory.path().join("hub.toml"), text).unwrap();
    let shown = String::from_utf8(sim_host(&["vehicle", "hub.toml"], directory.path()).stdout).unwrap();
    assert!(shown.starts_with("hub.toml\n") && shown.contains(" g m²  a box of 400 g"), "{shown}");
    assert!(shown.contains("\n    estimate, not a measurement: moments of inertia (a box of "), "{shown}");
}

#[test]
fn runs_of_a_campaign_equal_single_flights_in_order() {
    let many = json(&["fly", "stand-steps", "--runs", "5", "--json"]);
    let runs = many["runs"].as_array().unwrap();
    assert_eq!(runs.len(), 5);
    for (run, seed) in runs.iter().zip(7..) {
        let single = json(&["fly", "stand-steps", "--seed", &seed.to_string(), "--json"]);
        assert_eq!((&run["digest"], &run["seed"]), (&single["digest"], &single["seed"]));
    }
}

#[test]
fn crash_exits_with_1() {
    let directory = tempfile::tempdir().unwrap();
    let steps = include_str!("../scenes/steps.toml").replace("[flight]", "[flight]\nestimator = \"paper\"");
    std::fs::write(directory.path().join("tips.toml"), steps).unwrap();
    let output = sim_host(&["fly", "tips.toml", "--json"], directory.path());
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let flight: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(flight["crashed"], true);
}

#[test]
fn estimate_reads_the_logs_of_fly_and_sense() {
    let directory = tempfile::tempdir().unwrap();
    for arguments in [
        &["fly", "hover", "--log", "log.csv"][..],
        &["sense", "hover", "--rate-hz", "500", "--out", "log.csv"],
    ] {
        assert_eq!(sim_host(arguments, directory.path()).status.code(), Some(0));
        let path = directory.path().join("log.csv");
        let score = json(&["estimate", path.to_str().unwrap(), "--estimator", "flight", "--json"]);
        let flight = &score["estimators"]["flight"];
        // The magnetometer samples of the log include the hard iron of 200 µT, so only the inclination can be correct.
        assert!(flight["inclination_rmse_deg"].as_f64().unwrap() < 0.5, "{score}");
        assert!(flight["ns_per_update"].as_f64().unwrap() > 0.0);
    }
}

#[test]
fn sense_is_reproducible_and_counts_its_samples() {
    let sense = json(&["sense", "static", "--duration", "2", "--rate-hz", "250", "--json"]);
    assert_eq!(sense["samples"], 500);
    let directory = tempfile::tempdir().unwrap();
    for file in ["a.csv", "b.csv"] {
        sim_host(&["sense", "static", "--duration", "2", "--out", file], directory.path());
    }
    let [a, b] = ["a.csv", "b.csv"].map(|file| std::fs::read(directory.path().join(file)).unwrap());
    assert_eq!(a.iter().filter(|byte| **byte == b'\n').count(), 2001);
    assert_eq!(a, b);
}

#[test]
fn config_writes_the_record_that_the_board_reads() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("config.bin");
    let config = json(&["config", "hover", "--out", path.to_str().unwrap(), "--json"]);
    let record = std::fs::read(&path).unwrap();
    let scene = sim_host::scene::Scene::load("hover").unwrap();
    assert_eq!(stored_config::decode(&record), Ok(scene.config));
    assert_eq!(config["calibration"], "of the scene's SIMULATED sensors (mag.hard_iron), not of real ones");
    assert_eq!(
        (config["vehicle"].as_str(), config["declination_deg"].as_f64().unwrap().round()),
        (Some("os4"), 6.0)
    );
    assert_eq!(
        (config["scene"].as_str(), config["bytes"].as_u64()),
        (Some("hover"), Some(record.len() as u64))
    );
    assert_eq!(config["address"], 0x0800_4000);

    let output = sim_host(&["config", "hover", "--out", "again.bin"], directory.path());
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        text.ends_with(
            "probe-rs download --binary-format bin --base-address 0x08004000 --chip STM32F405RGTx again.bin\n"
        ),
        "{text}"
    );
    assert_eq!(std::fs::read(directory.path().join("again.bin")).unwrap(), record);
}

/// The board takes the mounting of board and magnetometer in the vehicle from the record.
#[test]
fn config_record_has_the_mounting_of_the_vehicle() {
    let directory = tempfile::tempdir().unwrap();
    let scene = "include = \"hover\"\n[vehicle.mounting]\nboard = [\"right\", \"backward\", \"down\"]\n\
                 magnetometer = [\"left\", \"backward\", \"up\"]\n";
    std::fs::write(directory.path().join("turned.toml"), scene).unwrap();
    let output = sim_host(&["config", "turned.toml", "--out", "config.bin"], directory.path());
    assert!(output.status.success(), "{output:?}");
    let record = std::fs::read(directory.path().join("config.bin")).unwrap();
    let params = stored_config::decode(&record).unwrap().params;
    // The columns are the directions of the chip's x, y and z axes in body axes.
    let rows = |mounting: flight_core::geometry::Mat3<f32>| mounting.rows.map(|row| [row.x, row.y, row.z]);
    let board = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
    assert_eq!((rows(params.gyro.mounting), rows(params.accel.mounting)), (board, board));
    assert_eq!(rows(params.mag.mounting), [[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]);
}

/// No command overwrites a file that it reads, directly or through a scene, or another of its outputs.
#[test]
fn outputs_do_not_overwrite_inputs_or_each_other() {
    let directory = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(directory.path().join(name), text).unwrap();
    let vehicle = include_str!("../../vehicles/five-inch.toml");
    let imu = include_str!("../imus/paper.toml");
    write("quad.toml", vehicle);
    write("imu.toml", imu);
    write("below.toml", HOVER);
    let scene = "include = \"below.toml\"\n[scene]\nduration_s = 9.0\nvehicle = \"quad.toml\"\nimu = \"imu.toml\"\n\
                 [pilot]\nland_before_end_s = 0.1\n";
    write("top.toml", scene);
    let read = "must not be a file that is read";
    for (arguments, expected) in [
        (&["config", "hover", "--vehicle", "quad.toml", "--out", "quad.toml"][..], read),
        (&["config", "top.toml", "--out", "below.toml"], read),
        (&["fly", "top.toml", "--log", "quad.toml"], read),
        (&["fly", "top.toml", "--report", "imu.toml"], read),
        (&["fly", "top.toml", "--runs", "2", "--out", "top.toml"], read),
        (&["sense", "top.toml", "--out", "./below.toml"], read),
        (
            &["fly", "top.toml", "--log", "same", "--report", "./same"],
            "--report = ./same: is already the file of --log",
        ),
    ] {
        let output = sim_host(arguments, directory.path());
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && error.contains(expected), "{arguments:?}: {error}");
    }
    for (name, text) in
        [("quad.toml", vehicle), ("imu.toml", imu), ("below.toml", HOVER), ("top.toml", scene)]
    {
        assert_eq!(std::fs::read_to_string(directory.path().join(name)).unwrap(), text, "{name}");
    }
    assert!(!directory.path().join("same").exists());
}

/// An error of a vehicle names the file in which the value is, or from which it is missing.
#[test]
fn vehicle_errors_name_the_file_that_has_them() {
    let directory = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(directory.path().join(name), text).unwrap();
    let vehicle = include_str!("../../vehicles/five-inch.toml");
    write("no-mass.toml", &vehicle.replace("mass_g", "# mass_g"));
    write("heavy.toml", &vehicle.replace("mass_g = 650.0", "mass_g = -1.0"));
    let include = "include = \"hover\"\n[scene]\n";
    write("heavy-below.toml", &format!("{include}vehicle = \"heavy.toml\"\n[vehicle]\ncells = 4\n"));
    write("heavy-here.toml", &format!("{include}vehicle = \"five-inch\"\n[vehicle]\nmass_g = -1.0\n"));
    write("none.toml", "[scene]\nduration_s = 1.0\nseed = 1\nimu = \"paper\"\n");
    write("number.toml", &format!("{include}vehicle = 5\n"));
    write("include.toml", "include = 5\n");
    for (arguments, expected) in [
        (&["fly", "hover", "--vehicle", "no-mass.toml"][..], "no-mass.toml: mass_g: is missing"),
        (&["fly", "hover", "--vehicle", "gone.toml"], "--vehicle = gone.toml: gone.toml cannot be read"),
        (&["fly", "hover", "--vehicle", "five-inhc"], "--vehicle = five-inhc: must be one of"),
        (&["fly", "heavy-below.toml"], "heavy.toml:4: mass_g = -1.0: must be from 10 to 100000 g"),
        (
            &["fly", "heavy-here.toml"],
            "heavy-here.toml:5: vehicle.mass_g = -1.0: must be from 10 to 100000 g",
        ),
        (&["fly", "none.toml"], "none.toml:1: scene.vehicle: is missing"),
        (&["fly", "number.toml"], "number.toml:3: scene.vehicle = 5: must be text in quotes"),
        (&["fly", "include.toml"], "include.toml:1: include = 5: must be text in quotes"),
    ] {
        let output = sim_host(arguments, directory.path());
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && error.contains(expected), "{arguments:?}: {error}");
    }
}

#[test]
fn config_with_bad_input_writes_no_file() {
    let directory = tempfile::tempdir().unwrap();
    for (arguments, expected) in [
        (["config", "hovr", "--out", "config.bin"], "error: SCENE = hovr: must be one of hover, steps, "),
        (
            ["config", "hover", "--out", "missing/config.bin"],
            "error: missing/config.bin: cannot be written: ",
        ),
    ] {
        let output = sim_host(&arguments, directory.path());
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!((output.status.code(), error.lines().count()), (Some(2), 1), "{error}");
        assert!(error.starts_with(expected) && output.stdout.is_empty(), "{error}");
    }
    assert_eq!(sim_host(&["config", "hover"], directory.path()).status.code(), Some(2));
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
}

#[test]
fn scenes_lists_all_scenes_with_their_effects() {
    let scenes = json(&["scenes", "--json"]);
    let list = scenes["scenes"].as_array().unwrap();
    assert_eq!(list.len(), 14);
    assert_eq!(list[3]["name"], "static");
    assert_eq!(list[3]["effects"].as_array().unwrap().len(), 4);
}

/// On a processor with FMA and AVX2, glibc uses other code for sin, exp and other functions, whose last bits differ. With
/// this code switched off, a flight must have the same digest.
#[test]
fn digest_does_not_depend_on_the_processors_fma() {
    let digest_with = |tunables: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_sim-host"))
            .args(["fly", "steps", "--json"])
            .env("GLIBC_TUNABLES", tunables)
            .output()
            .unwrap();
        serde_json::from_slice::<Value>(&output.stdout).unwrap()["digest"].clone()
    };
    let off = "glibc.cpu.hwcaps=-AVX2,-AVX2_Usable,-FMA,-FMA_Usable,-FMA4,-FMA4_Usable,-AVX,-AVX_Usable";
    assert_eq!(digest_with(off), digest_with(""));
}
