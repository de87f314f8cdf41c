//! The command `cost`: its output, its files and its errors.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn cost(arguments: &[&str], directory: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_studies"))
        .arg("cost")
        .args(arguments)
        .current_dir(directory)
        .env_remove("KESTREL_DATA")
        .output()
        .unwrap()
}

#[test]
fn json_has_the_documented_keys() {
    let output = cost(&["arithmetic", "prefilter", "--quick", "--json"], Path::new("."));
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let studies = json["studies"].as_object().unwrap();
    assert_eq!(studies.keys().collect::<Vec<_>>(), ["arithmetic", "prefilter"]);
    let mut front = 0;
    for setting in studies.values().flat_map(|study| study.as_array().unwrap()) {
        assert!(setting["setting"].is_string() && setting["error_unit"].is_string(), "{setting}");
        assert!(setting["error"].is_number() && setting["host_ns"].as_f64().unwrap() > 0.0, "{setting}");
        assert!(setting["m4_instructions"].as_f64().unwrap() > 0.0, "{setting}");
        front += u32::from(setting["pareto"].as_bool().unwrap());
    }
    assert!(front > 8, "{front}");
}

#[test]
fn files_are_written_and_untimed_ones_are_reproducible() {
    let directory = tempfile::tempdir().unwrap();
    let mut texts = Vec::new();
    for run in ["a", "b"] {
        let page = format!("{run}.html");
        let output = cost(&["prefilter", "--quick", "--report", &page, "--csv", run], directory.path());
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        assert!(String::from_utf8(output.stdout).unwrap().contains("2nd order 30 Hz"));
        texts.push(std::fs::read_to_string(directory.path().join(run).join("prefilter.csv")).unwrap());
        assert!(directory.path().join(run).join("prefilter-timing.csv").is_file());
        let html = std::fs::read_to_string(directory.path().join(page)).unwrap();
        assert!(html.contains("<svg") && html.contains("The prefilter of the sensors"));
    }
    assert_eq!(texts[0], texts[1]);
}

#[test]
fn bad_input_is_refused_before_any_file_is_written() {
    let directory = tempfile::tempdir().unwrap();
    for (arguments, expected) in [
        (
            vec!["integrators", "--csv", "x"],
            "STUDY = integrators: must be one of integrator, attitude, estimator, \
          prefilter, arithmetic, rates, sensors (did you mean `integrator`?)",
        ),
        (vec!["--report", "none/x.html"], "none/x.html: cannot be written"),
    ] {
        let output = cost(&arguments, directory.path());
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(error.starts_with(&format!("error: {expected}")), "{error}");
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
    }
}

#[test]
fn missing_recordings_are_reported() {
    let output = cost(&["estimator", "--quick"], Path::new("."));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("No recordings were given (KESTREL_DATA)"), "{text}");
    assert!(text.contains("simulated, steps") && !text.contains("recording 02"));
}
