//! The results of a campaign as a CSV file with one row for each run.
//!
//! Every row has the identity of its campaign, so that any tool can check and merge the files of shards. Numbers have
//! the fewest digits that read back as the same f64, so equal runs have equal rows.
//!
//! | columns | |
//! |---|---|
//! | `scene`, `scene_hash`, `version`, `duration_s`, `first_seed`, `runs` | the campaign |
//! | `run`, `seed` | number of the run, counted from 0, and its seed, which repeats it |
//! | `crash`, `crashed_at_s` | cause and time of the crash; empty without a crash |
//! | `final_state` … `digest` | as in `fly --json` |
//! | `drawn.…` | values that the tolerances have drawn, in the order of the scene |

use std::collections::BTreeMap;
use std::io::{Read, Write as _};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use flight_core::ArmState;

use super::{Campaign, MAX_RUNS, Run};
use crate::flight::{Crash, Outcome, STEP_US, step_count};
use crate::input_file::{self, RowLimit};
use crate::output_file::OutputFile;
use input::InputError;

/// Columns with the identity of the campaign.
const CAMPAIGN: [&str; 6] = ["scene", "scene_hash", "version", "duration_s", "first_seed", "runs"];

/// Columns of the run, up to the drawn values.
const RUN: [&str; 13] = [
    "run",
    "seed",
    "crash",
    "crashed_at_s",
    "final_state",
    "control_steps",
    "attitude_rmse_deg",
    "heading_rmse_deg",
    "inclination_rmse_deg",
    "tilt_error_max_deg",
    "tilt_max_deg",
    "position_error_max_m",
    "digest",
];

/// Prefix of the columns with drawn values.
const DRAWN: &str = "drawn.";

/// Writes the runs of a campaign, or of a shard of it.
///
/// # Errors
/// The file cannot be written.
pub fn write(mut file: OutputFile, campaign: &Campaign, runs: &[Run]) -> Result<(), InputError> {
    let text = to_csv(campaign, runs)?;
    file.write_all(&text).map_err(|error| file.error(&error))?;
    file.finish()
}

/// Returns the text of the file that [`write`](write()) writes.
///
/// # Errors
/// The runs have drawn different quantities, which does not happen within a campaign.
pub fn to_csv(campaign: &Campaign, runs: &[Run]) -> Result<Vec<u8>, InputError> {
    table(campaign, runs).map_err(|error| InputError::new(error.to_string()))
}

fn table(campaign: &Campaign, runs: &[Run]) -> Result<Vec<u8>, csv::Error> {
    let mut table = csv::Writer::from_writer(Vec::new());
    let drawn = runs.first().map_or(&[][..], |run| &run.drawn);
    let drawn = drawn.iter().map(|(name, _)| format!("{DRAWN}{name}"));
    table.write_record(CAMPAIGN.into_iter().chain(RUN).map(String::from).chain(drawn))?;
    let Campaign { scene, scene_hash, version, duration_s, first_seed, runs: all } = campaign;
    for Run { number, outcome, drawn } in runs {
        let Outcome {
            control_steps,
            attitude_rmse_deg,
            heading_rmse_deg,
            inclination_rmse_deg,
            tilt_error_max_deg,
            tilt_max_deg,
            position_error_max_m,
            crash,
            final_state,
            digest,
        } = outcome;
        let (crash, crashed_at_s) =
            crash.map_or_else(Default::default, |(crash, at_s)| (crash.name(), at_s.to_string()));
        let results = [
            attitude_rmse_deg,
            heading_rmse_deg,
            inclination_rmse_deg,
            tilt_error_max_deg,
            tilt_max_deg,
            position_error_max_m,
        ];
        let before = [
            scene.clone(),
            format!("{scene_hash:016x}"),
            version.clone(),
            duration_s.to_string(),
            first_seed.to_string(),
            all.to_string(),
            number.to_string(),
            campaign.seed(*number).to_string(),
            crash.into(),
            crashed_at_s,
            final_state.name().into(),
            control_steps.to_string(),
        ];
        let results = results.map(f64::to_string);
        let drawn = drawn.iter().map(|(_, value)| value.to_string());
        table
            .write_record(before.into_iter().chain(results).chain([format!("{digest:016x}")]).chain(drawn))?;
    }
    table.into_inner().map_err(|error| error.into_error().into())
}

/// Reads the files of all shards of a campaign, and returns the runs in order.
///
/// # Errors
/// A file is not one of a campaign, or belongs to another campaign; a run is there twice, or runs are missing.
pub fn merge(parts: &[PathBuf]) -> Result<(Campaign, Vec<Run>), InputError> {
    merge_with(parts, input_file::open)
}

/// Merges as [`merge`]; `open` opens the files.
///
/// # Errors
/// As [`merge`].
pub fn merge_with<R: Read>(
    parts: &[PathBuf],
    open: impl Fn(&Path) -> Result<R, InputError>,
) -> Result<(Campaign, Vec<Run>), InputError> {
    let mut merged: Option<(Campaign, Vec<String>, &Path)> = None;
    let mut runs: BTreeMap<u64, (Run, &Path)> = BTreeMap::new();
    for path in parts {
        let mut rows = Rows::open(path, &open)?;
        while rows.advance()? {
            let campaign = rows.campaign()?;
            match &merged {
                None => merged = Some((campaign, rows.drawn.clone(), path)),
                Some((first, drawn, of)) => {
                    check_same_campaign(&rows, &campaign, first, of)?;
                    if rows.drawn != *drawn {
                        return Err(rows
                            .error(format!("must have the same columns as {}", of.display()))
                            .field("drawn"));
                    }
                }
            }
            let (campaign, ..) = merged.as_ref().expect("the first row has been read");
            let run = rows.run(campaign)?;
            if let Some((_, of)) = runs.get(&run.number) {
                let allowed = format!("must be in one file only: {} has it too", of.display());
                return Err(rows.error(allowed).field("run").value(run.number));
            }
            runs.insert(run.number, (run, path));
        }
    }
    let Some((campaign, ..)) = merged else {
        return Err(InputError::new("must have at least one run").field("PART"));
    };
    check_complete(&campaign, &runs)?;
    Ok((campaign, runs.into_values().map(|(run, _)| run).collect()))
}

/// Checks that a row belongs to the same campaign as the first row, which is in the file `of`.
fn check_same_campaign<R: Read>(
    rows: &Rows<R>,
    campaign: &Campaign,
    first: &Campaign,
    of: &Path,
) -> Result<(), InputError> {
    // The name of the scene comes before its hash, because another scene also has another hash.
    for (field, what, is) in [
        ("scene", "scene", campaign.scene == first.scene),
        ("scene_hash", "text of the scene", campaign.scene_hash == first.scene_hash),
        ("version", "version of sim-host", campaign.version == first.version),
        ("duration_s", "length of the flights", campaign.duration_s == first.duration_s),
        ("first_seed", "first seed", campaign.first_seed == first.first_seed),
        ("runs", "number of runs", campaign.runs == first.runs),
    ] {
        if !is {
            return Err(rows
                .error(format!("must be the {what} of {}: both files must be of one campaign", of.display()))
                .field(field)
                .value(rows.text(field)));
        }
    }
    Ok(())
}

/// Checks that no run is missing.
fn check_complete(campaign: &Campaign, runs: &BTreeMap<u64, (Run, &Path)>) -> Result<(), InputError> {
    let missing = campaign.runs - runs.len() as u64;
    if missing == 0 {
        return Ok(());
    }
    // The first gap starts at the first index that differs from the number of its run.
    let start = runs.keys().zip(0..).find_map(|(number, place)| (*number != place).then_some(place));
    let start = start.unwrap_or(runs.len() as u64);
    let end = runs.range(start..).next().map_or(campaign.runs, |(number, _)| *number);
    let gap = if end - start == 1 { format!("run {start}") } else { format!("runs {start} to {}", end - 1) };
    let others = match missing - (end - start) {
        0 => String::new(),
        further => format!(", and {further} more"),
    };
    Err(InputError::new(format!(
        "must include {gap} of {}{others}: the file of a shard is missing",
        campaign.runs
    ))
    .field("PART"))
}

/// Returns the error for a file that cannot be read, without the words of the parser about its place.
fn unreadable(path: &Path, error: &csv::Error) -> InputError {
    let what = match error.kind() {
        csv::ErrorKind::Io(error) => error.to_string(),
        csv::ErrorKind::Utf8 { .. } => "it must be UTF-8 text".into(),
        _ => error.to_string(),
    };
    let unreadable = InputError::new(format!("cannot be read: {what}")).file(path);
    match error.position() {
        Some(position) => unreadable.line(position.line()),
        None => unreadable,
    }
}

/// The rows of one file.
struct Rows<'a, R> {
    path: &'a Path,
    reader: csv::Reader<RowLimit<R>>,
    record: csv::StringRecord,
    /// Names of the drawn quantities.
    drawn: Vec<String>,
}

impl<'a, R: Read> Rows<'a, R> {
    fn open(path: &'a Path, open: impl Fn(&Path) -> Result<R, InputError>) -> Result<Self, InputError> {
        // `advance` checks the number of cells, so that the error has the form of all errors.
        let mut reader = csv::ReaderBuilder::new().flexible(true).from_reader(RowLimit::new(open(path)?));
        let header = reader.headers().map_err(|error| unreadable(path, &error))?;
        if header.is_empty() {
            return Err(InputError::new("must be results of `fly --out`: the file is empty").file(path));
        }
        for (place, wanted) in CAMPAIGN.into_iter().chain(RUN).enumerate() {
            let found = header.get(place).unwrap_or("");
            if found != wanted {
                return Err(InputError::new(format!("must be {wanted}, as in results of `fly --out`"))
                    .file(path)
                    .line(1)
                    .field(format!("column {}", place + 1))
                    .value(found));
            }
        }
        let mut drawn = Vec::new();
        for name in header.iter().skip(CAMPAIGN.len() + RUN.len()) {
            let quantity = name
                .strip_prefix(DRAWN)
                .ok_or_else(|| InputError::new("must begin with drawn.").file(path).line(1).value(name))?;
            drawn.push(quantity.to_owned());
        }
        Ok(Self { path, reader, record: csv::StringRecord::new(), drawn })
    }

    fn advance(&mut self) -> Result<bool, InputError> {
        self.reader.get_mut().next_row();
        let read = self.reader.read_record(&mut self.record);
        let is_row = read.map_err(|error| unreadable(self.path, &error))?;
        let width = CAMPAIGN.len() + RUN.len() + self.drawn.len();
        if is_row && self.record.len() != width {
            let error = self.error(format!("must be {width}, as in the header"));
            return Err(error.field("number of cells").value(self.record.len()));
        }
        Ok(is_row)
    }

    fn error(&self, allowed: impl Into<String>) -> InputError {
        let line = self.record.position().map_or(0, csv::Position::line);
        InputError::new(allowed).file(self.path).line(line)
    }

    /// Returns the cell of the current row in a column of [`CAMPAIGN`] or [`RUN`].
    fn text(&self, column: &str) -> &str {
        let place = CAMPAIGN.iter().chain(&RUN).position(|name| *name == column);
        place.and_then(|place| self.record.get(place)).unwrap_or("")
    }

    fn wrong(&self, column: &str, allowed: &str) -> InputError {
        self.error(allowed).field(column).value(self.text(column))
    }

    fn whole_number_in(&self, column: &str, range: RangeInclusive<u64>) -> Result<u64, InputError> {
        let (minimum, maximum) = (range.start(), range.end());
        let number = self.text(column).parse().ok().filter(|number| range.contains(number));
        number
            .ok_or_else(|| self.wrong(column, &format!("must be a whole number from {minimum} to {maximum}")))
    }

    fn hash(&self, column: &str) -> Result<u64, InputError> {
        let digits = self.text(column);
        let is_hash = digits.len() == 16 && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
        let hash = u64::from_str_radix(digits, 16).ok().filter(|_| is_hash);
        hash.ok_or_else(|| self.wrong(column, "must be 16 hexadecimal digits"))
    }

    fn number_in(&self, column: &str, minimum: f64, maximum: f64, unit: &str) -> Result<f64, InputError> {
        let number = self.text(column).parse().ok().filter(|x| (minimum..=maximum).contains(x));
        number.ok_or_else(|| {
            self.wrong(column, &format!("must be a number from {minimum} to {maximum} {unit}"))
        })
    }

    /// Returns an error or an angle of a flight: a number that is finite and not negative.
    fn error_in(&self, column: &str) -> Result<f64, InputError> {
        let number = self.text(column).parse().ok().filter(|x: &f64| x.is_finite() && *x >= 0.0);
        number.ok_or_else(|| self.wrong(column, "must be a number of at least 0"))
    }

    fn campaign(&self) -> Result<Campaign, InputError> {
        let runs = self.whole_number_in("runs", 1..=MAX_RUNS)?;
        Ok(Campaign {
            scene: self.text("scene").into(),
            scene_hash: self.hash("scene_hash")?,
            version: self.text("version").into(),
            duration_s: self.number_in("duration_s", 0.01, 1.0e6, "s")?,
            first_seed: self.whole_number_in("first_seed", 0..=u64::MAX - (runs - 1))?,
            runs,
        })
    }

    fn run(&self, campaign: &Campaign) -> Result<Run, InputError> {
        let number = self.whole_number_in("run", 0..=campaign.runs - 1)?;
        if self.whole_number_in("seed", 0..=u64::MAX)? != campaign.seed(number) {
            let allowed = format!("must be {}, the sum of first seed and run", campaign.seed(number));
            return Err(self.wrong("seed", &allowed));
        }
        let crash = match self.text("crash") {
            "" if self.text("crashed_at_s").is_empty() => None,
            "" => return Err(self.wrong("crashed_at_s", "must be empty in a run without a crash")),
            name => {
                let crash = Crash::ALL.into_iter().find(|crash| crash.name() == name).ok_or_else(|| {
                    let names = Crash::ALL.map(Crash::name).join(", ");
                    self.wrong("crash", &format!("must be empty or one of {names}"))
                })?;
                // A crash is found at the end of its step, which may be half a step after the end of the flight.
                let last_step_s = (step_count(campaign.duration_s) * STEP_US) as f64 * 1e-6;
                let end_s = campaign.duration_s.max(last_step_s);
                Some((crash, self.number_in("crashed_at_s", 0.0, end_s, "s")?))
            }
        };
        let state = |state: &ArmState| state.name() == self.text("final_state");
        let final_state = ArmState::ALL.into_iter().find(state).ok_or_else(|| {
            let names = ArmState::ALL.map(ArmState::name).join(", ");
            self.wrong("final_state", &format!("must be one of {names}"))
        })?;
        let drawn = self.record.iter().skip(CAMPAIGN.len() + RUN.len());
        let drawn = self.drawn.iter().zip(drawn).map(|(name, cell)| {
            let value = cell.parse().ok().filter(|value: &f64| value.is_finite());
            let wrong = || self.error("must be a finite number").field(format!("{DRAWN}{name}")).value(cell);
            Ok((name.clone(), value.ok_or_else(wrong)?))
        });
        Ok(Run {
            number,
            outcome: Outcome {
                control_steps: self.whole_number_in("control_steps", 1..=step_count(campaign.duration_s))?,
                attitude_rmse_deg: self.error_in("attitude_rmse_deg")?,
                heading_rmse_deg: self.error_in("heading_rmse_deg")?,
                inclination_rmse_deg: self.error_in("inclination_rmse_deg")?,
                tilt_error_max_deg: self.error_in("tilt_error_max_deg")?,
                tilt_max_deg: self.error_in("tilt_max_deg")?,
                position_error_max_m: self.error_in("position_error_max_m")?,
                crash,
                final_state,
                digest: self.hash("digest")?,
            },
            drawn: drawn.collect::<Result<_, InputError>>()?,
        })
    }
}
