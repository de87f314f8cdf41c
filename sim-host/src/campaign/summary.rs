//! Summary of a campaign: the number of crashes, the distribution of the errors, and the worst runs.

use std::collections::BTreeMap;
use std::fmt::{self, Write as _};

use serde_json::{Value, json};

use super::{Campaign, Run};
use crate::flight::Outcome;
use crate::flight::summary::{drawn_json, outcome_json};

/// Runs in each table of the worst.
const MAX_WORST: usize = 5;
/// Crashes that the text shows. The others are counted, and are in the file of results.
const MAX_CRASHES: usize = 10;

/// Summary of a campaign, or of a shard of it.
#[derive(Debug)]
pub struct Summary<'a> {
    campaign: &'a Campaign,
    runs: &'a [Run],
    crashes: Vec<&'a Run>,
    by_attitude_error: Vec<&'a Run>,
    by_tilt: Vec<&'a Run>,
}

impl<'a> Summary<'a> {
    /// Summarizes these runs of a campaign.
    pub fn new(campaign: &'a Campaign, runs: &'a [Run]) -> Self {
        let (crashes, flown): (Vec<&Run>, Vec<&Run>) =
            runs.iter().partition(|run| run.outcome.crash.is_some());
        let worst = |measure: fn(&Outcome) -> f64| {
            let mut worst = flown.clone();
            // The sort is stable: of equal runs the one with the lower number comes first.
            worst.sort_by(|a, b| measure(&b.outcome).total_cmp(&measure(&a.outcome)));
            worst.truncate(MAX_WORST);
            worst
        };
        Self {
            by_attitude_error: worst(|o| o.attitude_rmse_deg),
            by_tilt: worst(|o| o.tilt_max_deg),
            campaign,
            runs,
            crashes,
        }
    }

    /// Returns the number of runs that crashed.
    pub fn crashes(&self) -> u64 {
        self.crashes.len() as u64
    }

    /// Returns the number of steps of all runs.
    pub fn control_steps(&self) -> u64 {
        self.runs.iter().map(|run| run.outcome.control_steps).sum()
    }

    /// Returns the largest value over all runs.
    fn max(&self, measure: fn(&Outcome) -> f64) -> f64 {
        self.runs.iter().map(|run| measure(&run.outcome)).fold(0.0, f64::max)
    }

    /// Returns the root mean square of the runs' attitude errors, degrees.
    fn rmse_deg(&self) -> f64 {
        let square = |run: &Run| run.outcome.attitude_rmse_deg * run.outcome.attitude_rmse_deg;
        libm::sqrt(self.runs.iter().map(square).sum::<f64>() / self.runs.len().max(1) as f64)
    }

    /// Returns the attitude error that `percent` of the runs do not exceed, degrees. It is the error of the run at this
    /// rank.
    fn attitude_percentile_deg(&self, percent: usize) -> f64 {
        let mut errors: Vec<f64> = self.runs.iter().map(|run| run.outcome.attitude_rmse_deg).collect();
        errors.sort_by(f64::total_cmp);
        let rank = (errors.len() * percent).div_ceil(100).saturating_sub(1);
        errors.get(rank).copied().unwrap_or(0.0)
    }

    fn final_states(&self) -> BTreeMap<&'static str, u64> {
        let mut states = BTreeMap::new();
        for run in self.runs {
            *states.entry(run.outcome.final_state.name()).or_default() += 1;
        }
        states
    }

    /// Returns the command that repeats a run.
    fn command(&self, run: &Run) -> String {
        let Campaign { scene, duration_s, .. } = self.campaign;
        let plain = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_' | '.' | '/');
        let quoted = format!("'{}'", scene.replace('\'', r"'\''"));
        let scene = if scene.chars().all(plain) { scene } else { &quoted };
        format!("sim-host fly {scene} --seed {} --duration {duration_s}", self.campaign.seed(run.number))
    }

    /// Returns the summary as JSON. It has no computing times, because these depend on the machine.
    pub fn to_json(&self) -> Value {
        let run = |run: &Run| {
            let mut object = outcome_json(&run.outcome);
            if let Value::Object(object) = &mut object {
                object.insert("scene".into(), json!(self.campaign.scene));
                object.insert("seed".into(), json!(self.campaign.seed(run.number)));
                object.insert("duration_s".into(), json!(self.campaign.duration_s));
                if !run.drawn.is_empty() {
                    object.insert("drawn".into(), drawn_json(&run.drawn));
                }
            }
            object
        };
        let worst = |runs: &[&Run]| -> Value {
            let one =
                |run: &&Run| json!({ "seed": self.campaign.seed(run.number), "command": self.command(run) });
            runs.iter().map(one).collect()
        };
        json!({
            "scene": self.campaign.scene,
            "seed": self.campaign.first_seed,
            "duration_s": self.campaign.duration_s,
            "control_steps": self.control_steps(),
            "attitude_rmse_deg": self.rmse_deg(),
            "attitude_median_deg": self.attitude_percentile_deg(50),
            "attitude_95_percent_deg": self.attitude_percentile_deg(95),
            "tilt_max_deg": self.max(|o| o.tilt_max_deg),
            "position_error_max_m": self.max(|o| o.position_error_max_m),
            "crashed": !self.crashes.is_empty(),
            "crashes": self.crashes.len(),
            "final_states": self.final_states(),
            "worst": {
                "crashes": worst(&self.crashes),
                "by_attitude_error": worst(&self.by_attitude_error),
                "by_tilt": worst(&self.by_tilt),
            },
            "runs": self.runs.iter().map(run).collect::<Vec<_>>(),
        })
    }

    /// Appends a table of runs.
    fn table(&self, text: &mut String, title: &str, runs: &[&Run]) -> fmt::Result {
        if runs.is_empty() {
            return Ok(());
        }
        write!(text, "\n\n  {title:<24}  attitude     tilt  distance")?;
        for run in runs {
            let Outcome { attitude_rmse_deg, tilt_max_deg, position_error_max_m, crash, final_state, .. } =
                &run.outcome;
            let ending = match crash {
                None => final_state.name().to_owned(),
                Some((crash, at_s)) => format!("{at_s:.3} s: {}", crash.text()),
            };
            write!(
                text,
                "\n    {ending:<22}  {attitude_rmse_deg:>7.3}°  {tilt_max_deg:>6.1}°  {position_error_max_m:>6.2} m  {}",
                self.command(run)
            )?;
        }
        Ok(())
    }

    /// Returns the summary as text.
    fn describe(&self) -> Result<String, fmt::Error> {
        let Campaign { scene, runs, .. } = self.campaign;
        let flights = match self.runs.len() as u64 {
            all if all == *runs => format!("{all} flights"),
            part => format!("{part} of {runs} flights"),
        };
        let states: Vec<String> =
            self.final_states().into_iter().map(|(state, count)| format!("{state} {count}")).collect();
        let seed = |run: Option<&Run>| run.map_or(0, |run| self.campaign.seed(run.number));
        let mut text = format!(
            "{scene}: {flights}, seeds {} to {}, {} crashed\n  \
             attitude error  {:.3}° RMSE of all flights; median flight {:.3}°, 95 % of flights up to {:.3}°, worst flight {:.3}°\n  \
             maximum tilt    {:.1}°; maximum distance from the target {:.2} m\n  \
             final states    {}",
            seed(self.runs.first()),
            seed(self.runs.last()),
            self.crashes.len(),
            self.rmse_deg(),
            self.attitude_percentile_deg(50),
            self.attitude_percentile_deg(95),
            self.max(|o| o.attitude_rmse_deg),
            self.max(|o| o.tilt_max_deg),
            self.max(|o| o.position_error_max_m),
            states.join(", "),
        );
        let (shown, further) = self.crashes.split_at(self.crashes.len().min(MAX_CRASHES));
        self.table(&mut text, "crashed", shown)?;
        if !further.is_empty() {
            write!(text, "\n    and {} more", further.len())?;
        }
        self.table(&mut text, "largest attitude error", &self.by_attitude_error)?;
        self.table(&mut text, "largest tilt", &self.by_tilt)?;
        Ok(text)
    }
}

impl fmt::Display for Summary<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.describe()?)
    }
}
