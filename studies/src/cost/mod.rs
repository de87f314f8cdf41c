//! The command `cost`: error against cost.
//!
//! A study sweeps the settings of one part of the flight code or of the simulator. It judges each setting against an
//! independent reference: a closed form, a second method, published figures, or the simulated truth. The result is
//! error against cost. Settings that no other setting beats in both are marked: they form the Pareto front.
//!
//!
//! There are three kinds of cost, which are never mixed:
//!
//! | cost | from | deterministic |
//! |---|---|---|
//! | instructions on the Cortex-M4F | `m4.toml`, counted on QEMU and checked by a test | yes |
//! | a cost particular to the study: group delay, share of the processor | computed | yes |
//! | ns on this machine | the shortest of several runs | no |
//!
//! Errors are computed, not timed, and are the same in every run. `studies/tests/cost_baseline.toml` records them, and
//! a test compares them.

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

/// Options of a run of the studies.
#[derive(Clone, Debug)]
pub struct Options {
    /// Fewer settings, seeds and repetitions.
    pub quick: bool,
    /// Whether to measure times on this machine.
    pub timed: bool,
    /// The directory whose subdirectory `broad/` holds recordings.
    pub recordings: Option<PathBuf>,
}

/// The cost against which a study shows its errors.
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
    /// The problem. Settings are compared with others of the same problem.
    pub problem: &'static str,
    /// The line in the plot: the method, without its step or rate.
    pub series: String,
    /// The setting's name, unique within its problem.
    pub setting: String,
    /// The error; `None` if there is nothing to judge, as after a crash.
    pub error: Option<f64>,
    /// Unit of the error.
    pub error_unit: &'static str,
    /// Time on this machine for one [`Study::per`], ns.
    pub host_ns: Option<f64>,
    /// The part of `host_ns` that this setting adds to the one before it.
    pub host_ns_added: Option<f64>,
    /// Instructions on the Cortex-M4F for the same.
    pub m4_instructions: Option<f64>,
    /// Bytes of flash on the Cortex-M4F.
    pub flash_bytes: Option<u32>,
    /// Further figures; their names end with the unit.
    pub also: Vec<(&'static str, f64)>,
    /// Whether this is Kestrel's default.
    pub default: bool,
    /// Whether it is on the Pareto front: no other setting of its problem is better in one of error and cost and at
    /// least as good in the other.
    pub pareto: bool,
}

impl Setting {
    /// Returns a further figure.
    pub fn figure(&self, name: &str) -> Option<f64> {
        self.also.iter().find(|(other, _)| *other == name).map(|(_, value)| *value)
    }

    /// Returns its cost, if it is known.
    pub fn cost(&self, axis: Axis) -> Option<f64> {
        match axis {
            Axis::Host => self.host_ns,
            Axis::M4 => self.m4_instructions,
            Axis::Also(name) => self.figure(name),
        }
    }
}

/// A study: a sweep over settings and its results.
#[derive(Clone, Debug)]
pub struct Study {
    /// Its name on the command line.
    pub name: &'static str,
    /// Its title.
    pub title: &'static str,
    /// What is compared, and how the error is defined.
    pub about: String,
    /// The reference of the error, and why it is independent of what is judged.
    pub reference: String,
    /// The unit of work to which costs refer: "an update", "a simulated second".
    pub per: &'static str,
    /// The cost on the horizontal axis.
    pub axis: Axis,
    /// Title of the horizontal axis, with its unit.
    pub axis_title: &'static str,
    /// The settings, problem by problem.
    pub settings: Vec<Setting>,
    /// Remarks: where more cost does not give less error, and why; what was left out.
    pub remarks: Vec<String>,
}

impl Study {
    /// Returns the problems, in order.
    pub fn problems(&self) -> Vec<&'static str> {
        let mut problems: Vec<&'static str> = Vec::new();
        for setting in &self.settings {
            if !problems.contains(&setting.problem) {
                problems.push(setting.problem);
            }
        }
        problems
    }

    /// Returns the settings of a problem.
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

/// Returns whether no setting of the same problem has less error at no more cost, or less cost at no more error.
pub fn on_front(setting: &Setting, all: &[Setting], cost: impl Fn(&Setting) -> Option<f64>) -> bool {
    let Some((error, own_cost)) = setting.error.zip(cost(setting)) else { return false };
    !all.iter().filter(|other| other.problem == setting.problem).any(|other| {
        other.error.zip(cost(other)).is_some_and(|(other_error, other_cost)| {
            other_error <= error && other_cost <= own_cost && (other_error < error || other_cost < own_cost)
        })
    })
}

/// A callback that receives the progress of a study, from 0 to 1.
pub type Progress<'a> = &'a dyn Fn(f64);

type StudyFunction = fn(&Options, Progress) -> Result<Study, InputError>;

/// The studies in order, each with its share of the run time, %.
const STUDIES: [(&str, u64, StudyFunction); 7] = [
    ("integrator", 20, integrator::study),
    ("attitude", 10, attitude::study),
    ("estimator", 15, estimator::study),
    ("prefilter", 3, prefilter::study),
    ("arithmetic", 5, arithmetic::study),
    ("rates", 20, rates::study),
    ("sensors", 30, sensors::study),
];

/// Returns the names of the studies, in order.
pub fn names() -> impl Iterator<Item = &'static str> {
    STUDIES.iter().map(|(name, ..)| *name)
}

/// Checks that there are studies of these names.
///
/// # Errors
/// A name is unknown; the error gives the nearest known name.
pub fn check_names(wanted: &[String]) -> Result<(), InputError> {
    match wanted.iter().find(|name| !names().any(|known| known == *name)) {
        Some(unknown) => Err(check::unknown("STUDY", unknown, names())),
        None => Ok(()),
    }
}

/// Runs the studies of these names, or all of them.
///
/// # Errors
/// A name is unknown; a recording cannot be read.
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
    let total: u64 = chosen.iter().map(|(_, share, _)| share).sum();
    let mut done = 0;
    let mut studies = Vec::new();
    for (name, share, make) in chosen {
        let at = |part: f64| progress(name, (done as f64 + part * *share as f64) / total as f64);
        at(0.0);
        let mut study = make(options, &at)?;
        study.mark_front();
        studies.push(study);
        done += share;
    }
    Ok(studies)
}

/// Returns what `cost --json` prints.
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
    fn front_holds_settings_that_no_other_beats() {
        let mut all = vec![
            setting("a", 1.0, 1.0),
            setting("a", 0.5, 2.0),
            // This setting has more error and more cost than the first.
            setting("a", 1.5, 1.5),
            // This setting has the error of the second, at more cost.
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
    fn unknown_study_is_refused_with_the_nearest_name() {
        let options = Options { quick: true, timed: false, recordings: None };
        let error = run(&["integrater".into()], &options, &|_, _| ()).unwrap_err().to_string();
        assert!(error.starts_with("STUDY = integrater: must be one of integrator, "), "{error}");
        assert!(error.ends_with("(did you mean `integrator`?)"), "{error}");
    }
}
