//! The commands `allan` and `paper` on the command line.

use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

use random::NormalStream;
use serde_json::Value;
use sim_host::scene::Scene;

fn sim_host(arguments: &[&str], directory: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sim-host"))
        .args(arguments)
        .current_dir(directory)
        .env_remove("KESTREL_DATA")
        .output()
        .unwrap()
}

fn json(arguments: &[&str], directory: &Path) -> Value {
    let output = sim_host(&[arguments, &["--json"]].concat(), directory);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(text.lines().count(), 1, "one object and nothing else: {text}");
    serde_json::from_str(&text).unwrap()
}

fn directory_with(name: &str, text: &str) -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    std::fs::write(directory.path().join(name), text).unwrap();
    directory
}

/// Returns rows of white noise, each after the text that `before` gives for it.
fn noise(rows: usize, columns: usize, separator: &str, before: impl Fn(usize) -> String) -> String {
    let mut streams: Vec<_> = (0..columns).map(|axis| NormalStream::new(1, "rows", axis)).collect();
    let mut text = String::new();
    for row in 0..rows {
        let cells: Vec<String> = streams.iter_mut().map(|stream| format!("{:.6}", stream.draw())).collect();
        writeln!(text, "{}{}", before(row), cells.join(separator)).unwrap();
    }
    text
}

#[test]
fn bad_input_gives_a_one_line_error_and_exit_code_2() {
    let stamped = |rows: usize| {
        format!("time_s,y\n{}", noise(rows, 1, ",", |row| format!("{:.3},", row as f64 * 0.01)))
    };
    let replaced = |line: usize, with: &str| {
        let text = stamped(100);
        let mut lines: Vec<&str> = text.lines().collect();
        lines[line - 1] = with;
        lines.join("\n") + "\n"
    };
    let good = stamped(100);
    let six = "time_s,gyro_x_rad_s,gyro_y_rad_s\n".to_owned()
        + &noise(50, 2, ",", |row| format!("{:.2},", row as f64 * 0.01));
    for (name, text, arguments, expected) in [
        (
            "a constant column",
            "y\n".to_owned() + &"9.81\n".repeat(50),
            &["--rate-hz", "10"][..],
            "bad.csv: y = 9.81: the column is constant: there is no noise to analyse (a stuck sensor?)",
        ),
        (
            "two samples",
            "y\n1\n2\n".into(),
            &["--rate-hz", "10"],
            "bad.csv: y = 2: must have at least 3 values",
        ),
        (
            "a NaN",
            replaced(40, "0.380,NaN"),
            &[],
            "bad.csv:40: y = NaN: gap: the column must have a number in every row; cut the recording there and analyse \
             the longer part",
        ),
        (
            "an empty cell",
            replaced(40, "0.380,"),
            &[],
            "bad.csv:40: y = \"\": gap: the column must have a number in every row; cut the recording there and analyse \
             the longer part",
        ),
        (
            "a word",
            replaced(40, "0.380,seven"),
            &[],
            "bad.csv:40: y = seven: must be a number from -1e100 to 1e100",
        ),
        (
            "an infinite value",
            replaced(40, "0.380,inf"),
            &[],
            "bad.csv:40: y = inf: must be a number from -1e100 to 1e100",
        ),
        (
            "a lost row",
            replaced(40, "").replace("\n\n", "\n"),
            &[],
            "bad.csv:40: time_s = 2.000000e-2 s after the previous row: uneven time stamps: the steps must be within 1.010e-3 s of \
             their mean, 1.010204e-2 s; set --rate-hz to treat the rows as even",
        ),
        (
            "a repeated time",
            replaced(40, "0.370,1"),
            &[],
            "bad.csv:40: time_s = 0.37: must increase: the previous row has 0.37",
        ),
        (
            "no rate",
            "y\n1\n2\n4\n".into(),
            &[],
            "bad.csv: --rate-hz: is missing: the file has no column time_s",
        ),
        (
            "a rate of 0",
            good.clone(),
            &["--rate-hz", "0"],
            "--rate-hz = 0: must be above 1e-9 and below 1e9 Hz",
        ),
        (
            "a row that is too short",
            replaced(40, "0.380"),
            &[],
            "bad.csv:40: number of cells = 1: must be 2, as in the header",
        ),
        ("an empty file", String::new(), &[], "bad.csv: the file is empty: it must have rows of numbers"),
        (
            "an unknown column",
            good.clone(),
            &["--column", "z"],
            "bad.csv: --column = z: must be the name of a column or its number from 1 to 2; there are time_s, y",
        ),
        (
            "one column twice",
            good.clone(),
            &["--column", "y", "--column", "2"],
            "--column = 2: names a column a second time",
        ),
        (
            "an unknown role",
            good.clone(),
            &["--column", "gyro_x=y"],
            "--column = gyro_x=y: the part before = must be gyro_{x,y,z}_{rad_s,deg_s}, accel_{x,y,z}_{m_s2,g} or \
             mag_{x,y,z}_ut",
        ),
        (
            "several columns without --column",
            "a,b\n1,2\n3,4\n5,7\n".into(),
            &["--rate-hz", "1"],
            "bad.csv: --column: must name a column: the file has a, b",
        ),
        (
            "a header of numbers and text",
            "time,0\n0.1,5\n0.2,6\n0.3,8\n".into(),
            &["--rate-hz", "1", "--column", "2"],
            "bad.csv:1: the first row is partly text and partly numbers: set --header to yes or no",
        ),
        (
            "a file with two separators",
            "a;b,c;d\n1;2,3;4\n".into(),
            &["--rate-hz", "1"],
            "bad.csv: the separator of the columns is ambiguous: set --separator to comma, semicolon or tab",
        ),
        (
            "two axes of three for a preset",
            six,
            &["--imu", "out.toml"],
            "--imu: must have all three axes of gyro, or none",
        ),
        (
            "a preset of an unknown sensor",
            good.clone(),
            &["--imu", "out.toml"],
            "--imu: must have the columns gyro_{x,y,z}_rad_s (or _deg_s) or accel_{x,y,z}_m_s2 (or _g); rename other \
             columns with --column gyro_x_rad_s=NAME",
        ),
    ] {
        let directory = directory_with("bad.csv", &text);
        let output = sim_host(&[&["allan", "bad.csv"], arguments].concat(), directory.path());
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(error, format!("error: {expected}\n"), "{name}");
        assert_eq!((output.status.code(), output.stdout.len()), (Some(2), 0), "{name}");
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1, "{name}: no file is left");
    }
}

#[test]
fn three_samples_give_a_deviation_and_a_reason() {
    let directory = directory_with("short.csv", "y\n1\n2\n4\n");
    let found = json(&["allan", "short.csv", "--rate-hz", "10"], directory.path());
    let y = &found["columns"]["y"];
    assert_eq!((y["deviation"].as_array().unwrap().len(), y["pairs"][0].as_u64()), (1, Some(2)));
    assert!(y["white_noise"].is_null());
    assert!(y["reason"]["white_noise"].as_str().unwrap().starts_with("too short"), "{y}");
}

#[test]
fn separators_headers_and_column_numbers_are_detected() {
    let plain = noise(4000, 2, ",", |_| String::new());
    let decimal_commas =
        plain.lines().map(|l| l.replace(',', ";").replace('.', ",") + "\n").collect::<String>();
    let files = [
        ("plain.csv", plain.clone(), "2"),
        ("header.csv", format!("# a remark\na,b\n{plain}"), "b"),
        ("by_number.csv", format!("a,b\n{plain}"), "2"),
        ("semicolons.csv", plain.replace(',', ";"), "2"),
        ("decimal_commas.csv", format!("a;b\r\n{}", decimal_commas.replace('\n', "\r\n")), "b"),
        ("tabs.csv", plain.replace(',', "\t"), "2"),
    ];
    let mut seen = Vec::new();
    for (name, text, column) in files {
        let directory = directory_with(name, &text);
        let found = json(&["allan", name, "--rate-hz", "50", "--column", column], directory.path());
        let columns = found["columns"].as_object().unwrap();
        assert_eq!(columns.len(), 1, "{name}");
        let result = columns.values().next().unwrap().clone();
        seen.push((result["deviation"].clone(), result["white_noise"].as_f64().unwrap()));
    }
    assert!(seen.windows(2).all(|w| w[0] == w[1]), "{seen:?}");
    assert!((seen[0].1 * 50_f64.sqrt() - 1.0).abs() < 0.05);
}

#[test]
fn all_statistics_agree_for_a_rate_and_its_integral() {
    let rows = noise(3000, 1, ",", |_| String::new());
    let mut angle = 0.0;
    let mut angles = String::from("0.0\n");
    for line in rows.lines() {
        angle += line.parse::<f64>().unwrap() / 100.0;
        writeln!(angles, "{angle}").unwrap();
    }
    let directory = directory_with("rate.csv", &rows);
    std::fs::write(directory.path().join("angle.csv"), angles).unwrap();
    for statistic in ["overlapping", "standard", "modified", "hadamard", "total"] {
        for taus in ["octave", "decade", "log", "all"] {
            let arguments = ["--rate-hz", "100", "--statistic", statistic, "--taus", taus];
            let of = |start: &[&str]| {
                json(&[start, &arguments].concat(), directory.path())["columns"]["1"].clone()
            };
            let (rate, angle) = (of(&["allan", "rate.csv"]), of(&["allan", "angle.csv", "--phase"]));
            for key in ["tau_s", "deviation", "lower", "upper", "pairs"] {
                assert_eq!(rate[key].as_array().unwrap().len(), rate["tau_s"].as_array().unwrap().len());
            }
            for (a, b) in
                rate["deviation"].as_array().unwrap().iter().zip(angle["deviation"].as_array().unwrap())
            {
                assert!((a.as_f64().unwrap() / b.as_f64().unwrap() - 1.0).abs() < 1e-6, "{statistic} {taus}");
            }
        }
    }
}

#[test]
fn analysis_that_takes_hours_needs_force() {
    // This takes hours on any machine.
    let directory = directory_with("long.csv", &"0\n1\n0\n".repeat(1_500_000));
    let arguments = ["allan", "long.csv", "--rate-hz", "100", "--taus", "all", "--statistic", "total"];
    let output = sim_host(&arguments, directory.path());
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert!(error.contains("--taus") && error.contains("--force") && error.contains("minutes"), "{error}");
}

/// Makes a recording, analyses it, and flies a scene with the resulting preset.
#[test]
fn preset_from_a_recording_flies() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path();
    let run = |arguments: &[&str]| {
        let output = sim_host(arguments, path);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    };
    run(&["sense", "static", "--out", "log.csv", "--duration", "600", "--rate-hz", "200"]);
    run(&["allan", "log.csv", "--imu", "my-imu.toml", "--kalibr", "imu.yaml", "--plot", "plot.svg"]);
    let preset = std::fs::read_to_string(path.join("my-imu.toml")).unwrap();
    for line in ["recording     log.csv", "length        600.0 s at 200.0 Hz", "temperature   not recorded"] {
        assert!(preset.contains(line), "{preset}");
    }
    // The quantization steps of the converters are identified from the recording.
    assert!(preset.contains("lsb_per_deg_s = 16.4 ") && preset.contains("lsb_per_g = 2048.0 "), "{preset}");
    let figure = |key: &str| -> Vec<f64> {
        let line = preset.lines().find(|line| line.starts_with(key)).unwrap();
        let inside = line.split_once('[').unwrap().1.trim_end_matches(']');
        inside.split(',').map(|x| x.trim().parse().unwrap()).collect()
    };
    for (found, simulated) in [
        (figure("n_deg_per_sqrt_h"), [1.9368, 1.239, 1.239]),
        (figure("n_m_s2_per_sqrt_hz"), [0.0012, 0.0012, 0.0014]),
        (figure("n_ut_per_sqrt_hz"), [0.03, 0.03, 0.03]),
    ] {
        for (found, simulated) in found.iter().zip(simulated) {
            assert!((found / simulated - 1.0).abs() < 0.05, "{found} for {simulated}");
        }
    }
    let yaml = std::fs::read_to_string(path.join("imu.yaml")).unwrap();
    for key in [
        "accelerometer_noise_density: ",
        "accelerometer_random_walk: ",
        "gyroscope_noise_density: ",
        "gyroscope_random_walk: ",
        "rostopic: ",
        "update_rate: ",
    ] {
        assert!(yaml.lines().any(|line| line.starts_with(key)), "{yaml}");
    }
    let density: f64 = yaml
        .lines()
        .find_map(|line| line.strip_prefix("gyroscope_noise_density:"))
        .and_then(|rest| rest.split_whitespace().next())
        .unwrap()
        .parse()
        .unwrap();
    let mean_square = [1.9368_f64, 1.239, 1.239].iter().map(|n| n * n / 3.0).sum::<f64>().sqrt();
    assert!((density / (mean_square / 60.0).to_radians() - 1.0).abs() < 0.05, "{density}");
    assert!(std::fs::read_to_string(path.join("plot.svg")).unwrap().starts_with("<svg"));

    let scene = "include = \"hover\"\n[scene]\nimu = \"my-imu.toml\"\n[effects.gyro.white_noise]\n\
                 [effects.accel.white_noise]\n[effects.gyro.constant_bias]\n";
    std::fs::write(path.join("mine.toml"), scene).unwrap();
    let flown = json(&["fly", "mine.toml"], path);
    assert_eq!(flown["crashed"], false, "{flown}");
}

#[test]
fn recording_in_other_units_and_names_gives_a_preset() {
    let rows = noise(20_000, 6, ",", |row| format!("{},", 25.0 + row as f64 * 1e-4));
    let directory = directory_with("own.csv", &format!("temp_c,wx,wy,wz,ax,ay,az\n{rows}"));
    let roles = [
        "gyro_x_deg_s=wx",
        "gyro_y_deg_s=wy",
        "gyro_z_deg_s=wz",
        "accel_x_g=ax",
        "accel_y_g=ay",
        "accel_z_g=az",
    ];
    let mut arguments = vec!["allan", "own.csv", "--rate-hz", "100", "--imu", "own.toml"];
    roles.iter().for_each(|role| arguments.extend(["--column", role]));
    let found = json(&arguments, directory.path());
    assert_eq!(found["columns"].as_object().unwrap().len(), 6);
    let preset = std::fs::read_to_string(directory.path().join("own.toml")).unwrap();
    assert!(preset.contains("temperature   25.0 to 27.0 (temp_c)"), "{preset}");
    // 1 °/s a sample at 100 Hz is 0.1 °/s/√Hz, or 6 °/√h.
    let n = preset.lines().find(|line| line.starts_with("n_deg_per_sqrt_h")).unwrap();
    let first: f64 = n.split_once('[').unwrap().1.split(',').next().unwrap().parse().unwrap();
    assert!((first / 6.0 - 1.0).abs() < 0.05, "{n}");
}

/// Simulates an hour with the noise of table 2 and identifies it: each run within 3.5 %, the mean of 20 runs within 1 %.
#[test]
fn a_simulated_hour_with_table_2_reads_back() {
    use allan::{Phase, Statistic, Taus};
    use flight_core::geometry::Vec3;
    use sim_host::dynamics::Vehicle;
    use sim_host::effects::Snapshot;

    const RATE_HZ: f64 = 100.0;
    let simulated = [1.9368, 1.239, 1.239].map(|n: f64| (n / 60.0).to_radians());
    let text = "[scene]\nduration_s = 3600.0\nseed = 1\nvehicle = \"os4\"\nimu = \"paper\"\n[effects.gyro.white_noise]\n";
    let scene = Scene::parse("hour", text).unwrap();
    let vehicle = Vehicle::at_rest(scene.vehicle, scene.mount(), vec![], 1e-3);
    let mut mean = [0.0; 3];
    let seeds = 20;
    for seed in 1..=seeds {
        let mut gyro = scene.gyro(seed, RATE_HZ);
        let mut axes = [vec![], vec![], vec![]];
        for k in 0..360_000 {
            let at = Snapshot { time_s: f64::from(k) / RATE_HZ, ..vehicle.snapshot() };
            let counts = gyro.sample(Vec3::ZERO, &at);
            let reading = <[f64; 3]>::from(gyro.nominal(counts));
            axes.iter_mut().zip(reading).for_each(|(axis, y)| axis.push(y));
        }
        for (i, samples) in axes.into_iter().enumerate() {
            let phase = Phase::of_rate(samples, 1.0 / RATE_HZ);
            let factors = Taus::Octave.factors(Statistic::Overlapping.largest_factor(phase.samples()));
            let points = allan::deviations(&phase, Statistic::Overlapping, &factors, 1, &|_, _| ());
            let fit = allan::fitted(&points, phase.length_s(), None);
            let off = fit.found[1].value().unwrap() / simulated[i] - 1.0;
            assert!(off.abs() < 0.035, "seed {seed}, axis {i}: {off}");
            mean[i] += off / f64::from(seeds as u32);
        }
    }
    println!("mean of {seeds} seeds off by {mean:?}");
    assert!(mean.iter().all(|off| off.abs() < 0.01), "{mean:?}");
}

#[test]
fn paper_without_recordings_names_the_missing_figures() {
    let directory = tempfile::tempdir().unwrap();
    let made = json(&["paper", "--out", "page"], directory.path());
    assert_eq!(made["tables"].as_array().unwrap().len(), 1);
    assert_eq!(made["figures"].as_array().unwrap().len(), 7);
    assert!(made["left_out"].as_str().unwrap().contains("KESTREL_DATA"));
    assert!(directory.path().join("page/index.html").is_file());
    assert!(directory.path().join("page/figure-07.csv").is_file());
}

#[test]
#[ignore = "needs KESTREL_DATA, the BROAD recordings"]
fn paper_with_recordings_has_all_figures() {
    let data = std::env::var_os("KESTREL_DATA").expect("KESTREL_DATA names the directory of the recordings");
    // Cargo runs tests in their package, `.ci/run` names the directory from the workspace.
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(data);
    let directory = tempfile::tempdir().unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_sim-host"))
        .args(["paper", "--out", "page", "--json"])
        .current_dir(directory.path())
        .env("KESTREL_DATA", data)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let made: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(made["figures"].as_array().unwrap().len(), 13);
    assert!(made["left_out"].is_null());
}
