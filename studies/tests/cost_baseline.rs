//! Compares the studies with `studies/tests/cost_baseline.toml`: no setting may lose accuracy or need more instructions
//! without a change of that file, and Kestrel's default must be on the Pareto front.
//!
//! The errors are computed, not timed, and are the same on every machine. To write the file again after a change:
//! `KESTREL_WRITE_DOCS=1 cargo test -p studies --test cost_baseline`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::LazyLock;

use studies::cost::{self, Options, Setting, Study, on_front};

/// Largest allowed relative increase of an error. No error is random; a change of rounding moves it less than this.
const ERROR: f64 = 0.02;
/// The adaptive method, with its relative and absolute tolerance. It chooses its steps with the C library's power
/// function, whose last bits differ between machines; near the limit of rounding its whole error consists of such bits.
const ADAPTIVE: (&str, f64, f64) = ("Dormand-Prince", 0.5, 1e-12);
/// Largest allowed relative increase of the instructions.
const INSTRUCTIONS: f64 = 0.05;

static STUDIES: LazyLock<Vec<Study>> = LazyLock::new(|| {
    // Without recordings, because not every machine has them.
    let options = Options { quick: true, timed: false, recordings: None };
    cost::run(&[], &options, &|_, _| ()).unwrap_or_else(|error| panic!("{error}"))
});

type Figures = BTreeMap<String, f64>;
type Baseline = BTreeMap<String, BTreeMap<String, Figures>>;

fn measured() -> Baseline {
    let figures = |s: &Setting| -> Figures {
        let all = [("error", s.error), ("m4_instructions", s.m4_instructions)];
        all.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))).collect()
    };
    let settings = |study: &Study| {
        let rows: BTreeMap<String, Figures> =
            study.settings.iter().map(|s| (format!("{}: {}", s.problem, s.setting), figures(s))).collect();
        assert_eq!(rows.len(), study.settings.len(), "{}: two settings of one name", study.name);
        rows
    };
    STUDIES.iter().map(|study| (study.name.to_owned(), settings(study))).collect()
}

fn number(value: f64) -> String {
    if value < 1e-3 { format!("{value:e}") } else { format!("{value}") }
}

fn text(baseline: &Baseline) -> String {
    let mut text = String::from(
        "# Errors of the settings that `sim-host cost --quick` compares, and their instructions on the Cortex-M4F.\n\
         # Written by the test in studies/tests/cost_baseline.rs, which documents the command.\n",
    );
    for (study, settings) in baseline {
        writeln!(text, "\n[{study}]").unwrap();
        for (setting, figures) in settings {
            let figures: Vec<String> =
                figures.iter().map(|(name, value)| format!("{name} = {}", number(*value))).collect();
            writeln!(text, "\"{setting}\" = {{ {} }}", figures.join(", ")).unwrap();
        }
    }
    text
}

#[test]
fn no_setting_loses_accuracy_or_gains_instructions() {
    let measured = measured();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cost_baseline.toml");
    if std::env::var_os("KESTREL_WRITE_DOCS").is_some() {
        return std::fs::write(&path, text(&measured)).unwrap();
    }
    let mut committed: Baseline = toml::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    let mut worse = Vec::new();
    for (study, settings) in measured {
        let mut of_study = committed.remove(&study).unwrap_or_default();
        for (setting, now) in settings {
            let Some(then) = of_study.remove(&setting) else {
                worse.push(format!("{study}: {setting} is not in the file"));
                continue;
            };
            let adaptive = setting.contains(ADAPTIVE.0);
            let (share, slack) = if adaptive { (ADAPTIVE.1, ADAPTIVE.2) } else { (ERROR, 0.0) };
            for (figure, share, slack) in [("error", share, slack), ("m4_instructions", INSTRUCTIONS, 0.0)] {
                match (now.get(figure), then.get(figure)) {
                    (Some(now), Some(then)) if *now > then * (1.0 + share) + slack => {
                        worse.push(format!("{study}: {setting}: {figure} {now:e}, was {then:e}"));
                    }
                    (Some(now), Some(then)) if *now < then * (1.0 - share) - slack => {
                        println!("{study}: {setting}: {figure} {now:e} is better than the file's {then:e}");
                    }
                    (Some(_), None) | (None, Some(_)) => {
                        worse.push(format!("{study}: {setting}: {figure} {:?}, was {:?}", now, then));
                    }
                    _ => {}
                }
            }
        }
        worse.extend(of_study.into_keys().map(|setting| format!("{study}: {setting} is no longer measured")));
    }
    assert!(committed.is_empty(), "no such studies: {:?}", committed.keys());
    assert!(worse.is_empty(), "worse than the file; KESTREL_WRITE_DOCS=1 updates it:\n{}", worse.join("\n"));
}

/// No other setting beats Kestrel's default in error and cost, for the problems on which the default was chosen.
/// `docs/accuracy.md` describes the other cases.
#[test]
fn default_setting_is_on_the_front() {
    let study = |name: &str| STUDIES.iter().find(|study| study.name == name).expect("there is this study");
    let check = |name: &str, problem: &str, cost: fn(&Setting) -> Option<f64>, fits: fn(&Setting) -> bool| {
        let of: Vec<Setting> = study(name).of(problem).filter(|s| fits(s)).cloned().collect();
        let default: Vec<&Setting> = of.iter().filter(|s| s.default).collect();
        assert_eq!(default.len(), 1, "{name}, {problem}: one default");
        assert!(of.len() > 2, "{name}, {problem}: something to compare with");
        assert!(on_front(default[0], &of, cost), "{name}, {problem}: {:?} is beaten", default[0]);
    };
    let everything = |_: &Setting| true;
    let instructions = |s: &Setting| s.m4_instructions;
    // Evaluations of the accelerations are a cost of the integrator that needs no clock. The Lie group's exponentials,
    // four a step, count like evaluations.
    let evaluations = |s: &Setting| {
        let lie = if s.series.starts_with("RKMK4") { 2.0 } else { 1.0 };
        s.figure("evaluations").map(|evaluations| evaluations * lie)
    };
    check("integrator", "flight of the scene steps", evaluations, everything);
    // The controller needs an attitude a thousand times a second.
    let often = |s: &Setting| s.figure("attitude_hz").is_some_and(|rate| rate >= 1000.0);
    check("attitude", "coning, 1° at 20 Hz", instructions, often);
    check("attitude", "tumbling top", instructions, often);
    check("estimator", "simulated, steps", instructions, everything);
    let delay = |s: &Setting| s.figure("group_delay_ms");
    check("prefilter", "vibration of the blades, 72 Hz", delay, everything);
    for problem in study("arithmetic").problems() {
        check("arithmetic", problem, instructions, everything);
    }
    check("rates", "steps: true attitude against that at 8 kHz", instructions, everything);
}
