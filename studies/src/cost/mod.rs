//! The command `cost`: what accuracy costs in time.
//!
//! A study sweeps the settings of one part of the flight code or of the simulator, and judges each against a
//! reference that is independent of it: a closed form, a second method, published figures, or the simulated
//! truth. The result is error against cost, with the settings marked that no other beats in both (the Pareto
//! front).
//!
//! Three kinds of cost, never mixed:
//!
//! | cost | from | deterministic |
//! |---|---|---|
//! | instructions on the Cortex-M4F | `m4.toml`, counted on the emulated core and kept true by a test | yes |
//! | a cost of its own: group delay, share of the processor | computed | yes |
//! | ns on this machine | the quickest of several batches | no |
//!
//! Errors are computed before anything is timed, and are the same in every run: `studies/tests/cost_baseline.toml`
//! holds them.

pub mod integrator;
pub mod m4;
mod page;
mod table;
mod timing;

mod arithmetic;
mod attitude;
mod estimator;
mod prefilter;
mod rates;
mod sensors;

use std::path::PathBuf;

use serde_json::{Value, json};

use input::InputError;
use input::check;

pub use page::{page, plot};
pub use table::{csv, text, timing_csv};

/// How thoroughly, and with what.
#[derive(Clone, Debug)]
pub struct Options {
    /// Fewer settings, seeds and batches.
    pub quick: bool,
    /// Whether to time anything on this machine.
    pub timed: bool,
    /// The directory that has recordings in `broad/`.
    pub recordings: Option<PathBuf>,
}

/// What a study holds its errors against.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Axis {
    /// [`Setting::host_ns`].
    Host,
    /// [`Setting::m4_instructions`].
    M4,
    /// One of [`Setting::also`], by its name.
    Also(&'static str),
}

/// One setting of a sweep.
#[derive(Clone, Debug, Default)]
pub struct Setting {
    /// What was to be solved: settings are compared with others of the same problem.
    pub problem: &'static str,
    /// Which of them are one line in the plot: the method, without its step or rate.
    pub series: String,
    /// The setting, by a name that no other of its problem has.
    pub setting: String,
    /// How wrong it is; `None` if there is nothing to judge, as after a crash.
    pub error: Option<f64>,
    /// Unit of the error.
    pub error_unit: &'static str,
    /// Time on this machine, ns, of what [`Study::per`] says.
    pub host_ns: Option<f64>,
    /// The part of `host_ns` that this setting adds to the one before it.
    pub host_ns_added: Option<f64>,
    /// Instructions on the Cortex-M4F for the same.
    pub m4_instructions: Option<f64>,
    /// Bytes of flash on the Cortex-M4F.
    pub flash_bytes: Option<u32>,
    /// More about it, names with units.
    pub also: Vec<(&'static str, f64)>,
    /// Whether this is what Kestrel does unless told otherwise.
    pub default: bool,
    /// Whether no other setting of its problem is better in one of error and cost without being worse in the
    /// other.
    pub pareto: bool,
}

impl Setting {
    /// A further figure.
    pub fn figure(&self, name: &str) -> Option<f64> {
        self.also.iter().find(|(other, _)| *other == name).map(|(_, value)| *value)
    }

    /// Its cost, if it is known.
    pub fn cost(&self, axis: Axis) -> Option<f64> {
        match axis {
            Axis::Host => self.host_ns,
            Axis::M4 => self.m4_instructions,
            Axis::Also(name) => self.figure(name),
        }
    }
}

/// A sweep and its outcome.
#[derive(Clone, Debug)]
pub struct Study {
    /// Its name on the command line.
    pub name: &'static str,
    /// Its title.
    pub title: &'static str,
    /// What is compared, and what the error is.
    pub about: String,
    /// What the error is against, and why that is independent of what is judged.
    pub reference: String,
    /// What one cost is for: "an update", "a simulated second".
    pub per: &'static str,
    /// What the errors are held against.
    pub axis: Axis,
    /// The same in words, with its unit.
    pub axis_title: &'static str,
    /// The settings, problem by problem.
    pub settings: Vec<Setting>,
    /// Where more cost does not buy less error, and why; what was left out.
    pub remarks: Vec<String>,
}

impl Study {
    /// The problems, in order.
    pub fn problems(&self) -> Vec<&'static str> {
        let mut problems: Vec<&'static str> = Vec::new();
        for setting in &self.settings {
            if !problems.contains(&setting.problem) {
                problems.push(setting.problem);
            }
        }
        problems
    }

    /// The settings of a problem.
    pub fn of(&self, problem: &str) -> impl Iterator<Item = &Setting> {
        self.settings.iter().filter(move |setting| setting.problem == problem)
    }

    /// Marks the settings on the Pareto front of their problems.
    fn mark_front(&mut self) {
        let (axis, all) = (self.axis, self.settings.clone());
        for setting in &mut self.settings {
            setting.pareto = on_front(setting, &all, |setting| setting.cost(axis));
        }
    }
}

/// Whether no setting of the same problem has less error at no more cost, or less cost at no more error.
pub fn on_front(setting: &Setting, all: &[Setting], cost: impl Fn(&Setting) -> Option<f64>) -> bool {
    let Some((error, price)) = setting.error.zip(cost(setting)) else { return false };
    !all.iter().filter(|other| other.problem == setting.problem).any(|other| {
        other.error.zip(cost(other)).is_some_and(|(other_error, other_price)| {
            other_error <= error && other_price <= price && (other_error < error || other_price < price)
        })
    })
}

/// Told how far a study has come, 0 to 1.
pub type Progress<'a> = &'a dyn Fn(f64);

type Maker = fn(&Options, Progress) -> Result<Study, InputError>;

/// The studies in order, each with its share of the time, %.
const STUDIES: [(&str, u64, Maker); 7] = [
    ("integrator", 20, integrator::study),
    ("attitude", 10, attitude::study),
    ("estimator", 15, estimator::study),
    ("prefilter", 3, prefilter::study),
    ("arithmetic", 5, arithmetic::study),
    ("rates", 20, rates::study),
    ("sensors", 30, sensors::study),
];

/// The names of the studies, in order.
pub fn names() -> impl Iterator<Item = &'static str> {
    STUDIES.iter().map(|(name, ..)| *name)
}

/// Whether there are studies of these names.
///
/// # Errors
/// A name that is none, with the nearest one.
pub fn check_names(wanted: &[String]) -> Result<(), InputError> {
    match wanted.iter().find(|name| !names().any(|known| known == *name)) {
        Some(unknown) => Err(check::unknown("STUDY", unknown, names())),
        None => Ok(()),
    }
}

/// Runs the studies of these names, or all of them.
///
/// # Errors
/// A name that is none, with the nearest one; recordings that cannot be read.
pub fn run(
    wanted: &[String],
    options: &Options,
    progress: &dyn Fn(&str, f64),
) -> Result<Vec<Study>, InputError> {
    check_names(wanted)?;
    let chosen: Vec<_> = STUDIES
        .iter()
        .filter(|(name, ..)| wanted.is_empty() || wanted.iter().any(|wanted| wanted == name))
        .collect();
    let whole: u64 = chosen.iter().map(|(_, share, _)| share).sum();
    let mut done = 0;
    let mut studies = Vec::new();
    for (name, share, make) in chosen {
        let at = |part: f64| progress(name, (done as f64 + part * *share as f64) / whole as f64);
        at(0.0);
        let mut study = make(options, &at)?;
        study.mark_front();
        studies.push(study);
        done += share;
    }
    Ok(studies)
}

/// What `cost --json` prints.
pub fn to_json(studies: &[Study]) -> Value {
    let setting = |s: &Setting| {
        let mut row = json!({
            "problem": s.problem,
            "series": s.series,
            "setting": s.setting,
            "error": s.error,
            "error_unit": s.error_unit,
            "host_ns": s.host_ns,
            "host_ns_added": s.host_ns_added,
            "m4_instructions": s.m4_instructions,
            "flash_bytes": s.flash_bytes,
            "default": s.default,
            "pareto": s.pareto,
        });
        if let Value::Object(row) = &mut row {
            row.extend(s.also.iter().map(|(name, value)| ((*name).into(), json!(value))));
        }
        row
    };
    let studies: serde_json::Map<String, Value> = studies
        .iter()
        .map(|study| (study.name.into(), study.settings.iter().map(setting).collect()))
        .collect();
    json!({ "studies": studies })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setting(problem: &'static str, error: f64, host_ns: f64) -> Setting {
        Setting { problem, error: Some(error), host_ns: Some(host_ns), ..Setting::default() }
    }

    #[test]
    fn the_front_is_what_nothing_beats() {
        let mut all = vec![
            setting("a", 1.0, 1.0),
            setting("a", 0.5, 2.0),
            // More of both than the first.
            setting("a", 1.5, 1.5),
            // As the second, and dearer.
            setting("a", 0.5, 3.0),
            setting("a", 0.1, 9.0),
            // Another problem.
            setting("b", 5.0, 5.0),
        ];
        all.push(Setting { error: None, ..setting("b", 0.0, 1.0) });
        let front: Vec<bool> = all.iter().map(|one| on_front(one, &all, |s| s.host_ns)).collect();
        assert_eq!(front, [true, true, false, false, true, true, false]);
    }

    #[test]
    fn an_unknown_study_is_answered_with_the_nearest() {
        let options = Options { quick: true, timed: false, recordings: None };
        let error = run(&["integrater".into()], &options, &|_, _| ()).unwrap_err().to_string();
        assert!(error.starts_with("STUDY = integrater: must be one of integrator, "), "{error}");
        assert!(error.ends_with("(did you mean `integrator`?)"), "{error}");
    }
}
