//! The results of a campaign as a file: CSV, a row for each run.
//!
//! Every row says which campaign it belongs to, so that files of parts can be told apart, and put together by any
//! tool. Numbers have the fewest digits that read back as the same f64, so equal runs make equal rows.
//!
//! | columns | |
//! |---|---|
//! | `scene`, `scene_hash`, `version`, `duration_s`, `first_seed`, `runs` | the campaign |
//! | `run`, `seed` | the run, counted from 0, and what flies it again |
//! | `crash`, `crashed_at_s` | empty, or why and when |
//! | `final_state` … `digest` | as `fly --json` has them |
//! | `drawn.…` | what the tolerances have drawn, in the scene's order |

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Write as _};
use std::path::{Path, PathBuf};

use flight_core::ArmState;

use super::{Campaign, Run};
use crate::flight::{Crash, Outcome};
use crate::output_file::OutputFile;
use input::InputError;

/// What says which campaign a row belongs to.
const CAMPAIGN: [&str; 6] = ["scene", "scene_hash", "version", "duration_s", "first_seed", "runs"];

/// What follows, up to what was drawn.
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

/// More steps than the longest flight has, 10⁶ s; a sum of them over all runs that a machine holds is still a number.
const MAX_STEPS: u64 = 1_000_000_000;

/// Before the name of a column that was drawn.
const DRAWN: &str = "drawn.";

/// Writes the runs of a campaign, or of a part of it.
///
/// # Errors
/// The file cannot be written.
pub fn write(mut file: OutputFile, campaign: &Campaign, runs: &[Run]) -> Result<(), InputError> {
    let text = to_csv(campaign, runs)?;
    file.write_all(&text).map_err(|error| file.error(&error))?;
    file.finish()
}

/// What [`write`](write()) writes.
///
/// # Errors
/// None of what a campaign gives; runs that have drawn different quantities are no table.
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
        let figures = [
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
        let figures = figures.map(f64::to_string);
        let drawn = drawn.iter().map(|(_, value)| value.to_string());
        table
            .write_record(before.into_iter().chain(figures).chain([format!("{digest:016x}")]).chain(drawn))?;
    }
    table.into_inner().map_err(|error| error.into_error().into())
}

/// Reads the parts of a campaign, and puts their runs in order.
///
/// # Errors
/// A part that is none, or of another campaign; a run that is there twice; runs that are missing.
pub fn merge(parts: &[PathBuf]) -> Result<(Campaign, Vec<Run>), InputError> {
    merge_with(parts, |path| File::open(path))
}

/// [`merge`], with the parts opened by `open`.
///
/// # Errors
/// As there.
pub fn merge_with<R: Read>(
    parts: &[PathBuf],
    open: impl Fn(&Path) -> io::Result<R>,
) -> Result<(Campaign, Vec<Run>), InputError> {
    let mut whole: Option<(Campaign, Vec<String>, &Path)> = None;
    let mut runs: BTreeMap<u64, (Run, &Path)> = BTreeMap::new();
    for path in parts {
        let mut rows = Rows::open(path, &open)?;
        while rows.advance()? {
            let campaign = rows.campaign()?;
            match &whole {
                None => whole = Some((campaign, rows.drawn.clone(), path)),
                Some((first, drawn, of)) => {
                    same(&rows, &campaign, first, of)?;
                    if rows.drawn != *drawn {
                        return Err(rows
                            .error(format!("must have what {} has", of.display()))
                            .field("drawn"));
                    }
                }
            }
            let (campaign, ..) = whole.as_ref().expect("a first row has just been read");
            let run = rows.run(campaign)?;
            if let Some((_, of)) = runs.get(&run.number) {
                let allowed = format!("has come before, from {}", of.display());
                return Err(rows.error(allowed).field("run").value(run.number));
            }
            runs.insert(run.number, (run, path));
        }
    }
    let Some((campaign, ..)) = whole else {
        return Err(InputError::new("no part has a run").field("PART"));
    };
    complete(&campaign, &runs)?;
    Ok((campaign, runs.into_values().map(|(run, _)| run).collect()))
}

/// Whether a row belongs to the campaign of the first one.
fn same<R: Read>(rows: &Rows<R>, campaign: &Campaign, first: &Campaign, of: &Path) -> Result<(), InputError> {
    // In this order: another scene has another hash, too.
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
                .error(format!("another {what} than in {}: not a part of the same campaign", of.display()))
                .field(field)
                .value(rows.text(field)));
        }
    }
    Ok(())
}

/// Whether all runs are there.
fn complete(campaign: &Campaign, runs: &BTreeMap<u64, (Run, &Path)>) -> Result<(), InputError> {
    let missing = campaign.runs - runs.len() as u64;
    if missing == 0 {
        return Ok(());
    }
    // The first number that is not its own place in the order begins the first gap.
    let start = runs.keys().zip(0..).find_map(|(number, place)| (*number != place).then_some(place));
    let start = start.unwrap_or(runs.len() as u64);
    let end = runs.range(start..).next().map_or(campaign.runs, |(number, _)| *number);
    let gap = if end - start == 1 { format!("run {start}") } else { format!("runs {start} to {}", end - 1) };
    let others = match missing - (end - start) {
        0 => String::new(),
        further => format!(", and {further} more"),
    };
    Err(InputError::new(format!("a part is missing: {gap} of {}{others}", campaign.runs)).field("PART"))
}

/// The rows of one part.
struct Rows<'a, R> {
    path: &'a Path,
    reader: csv::Reader<R>,
    record: csv::StringRecord,
    /// Names of what was drawn.
    drawn: Vec<String>,
}

impl<'a, R: Read> Rows<'a, R> {
    fn open(path: &'a Path, open: impl Fn(&Path) -> io::Result<R>) -> Result<Self, InputError> {
        let unreadable = |error: csv::Error| InputError::new(format!("cannot be read: {error}")).file(path);
        let mut reader = csv::Reader::from_reader(open(path).map_err(|error| unreadable(error.into()))?);
        let header = reader.headers().map_err(unreadable)?;
        if header.is_empty() {
            return Err(InputError::new("the file is empty: no part of a campaign").file(path));
        }
        for (place, wanted) in CAMPAIGN.into_iter().chain(RUN).enumerate() {
            let found = header.get(place).unwrap_or("");
            if found != wanted {
                return Err(InputError::new(format!("must be {wanted}: no part of a campaign"))
                    .file(path)
                    .line(1)
                    .field(format!("column {}", place + 1))
                    .value(found));
            }
        }
        let mut drawn = Vec::new();
        for name in header.iter().skip(CAMPAIGN.len() + RUN.len()) {
            let of = name.strip_prefix(DRAWN).ok_or_else(|| {
                InputError::new("must be a column that begins with drawn.").file(path).line(1).value(name)
            })?;
            drawn.push(of.to_owned());
        }
        Ok(Self { path, reader, record: csv::StringRecord::new(), drawn })
    }

    fn advance(&mut self) -> Result<bool, InputError> {
        self.reader.read_record(&mut self.record).map_err(|error| {
            let line = error.position().map(csv::Position::line);
            let said = InputError::new(format!("cannot be read: {error}")).file(self.path);
            line.map_or(said.clone(), |line| said.line(line))
        })
    }

    fn error(&self, allowed: impl Into<String>) -> InputError {
        let line = self.record.position().map_or(0, csv::Position::line);
        InputError::new(allowed).file(self.path).line(line)
    }

    /// The cell under a name of the two lists.
    fn text(&self, column: &str) -> &str {
        let place = CAMPAIGN.iter().chain(&RUN).position(|name| *name == column);
        place.and_then(|place| self.record.get(place)).unwrap_or("")
    }

    fn wrong(&self, column: &str, allowed: &str) -> InputError {
        self.error(allowed).field(column).value(self.text(column))
    }

    fn whole(&self, column: &str) -> Result<u64, InputError> {
        self.text(column).parse().map_err(|_| self.wrong(column, "must be a whole number from 0 to 2^64 - 1"))
    }

    fn hash(&self, column: &str) -> Result<u64, InputError> {
        u64::from_str_radix(self.text(column), 16)
            .map_err(|_| self.wrong(column, "must be 16 hexadecimal digits"))
    }

    fn number(&self, column: &str) -> Result<f64, InputError> {
        self.text(column).parse().map_err(|_| self.wrong(column, "must be a number"))
    }

    fn duration_s(&self) -> Result<f64, InputError> {
        let duration_s = self.number("duration_s")?;
        if (0.01..=1.0e6).contains(&duration_s) {
            Ok(duration_s)
        } else {
            Err(self.wrong("duration_s", "must be from 0.01 to 1000000 s"))
        }
    }

    fn control_steps(&self) -> Result<u64, InputError> {
        match self.whole("control_steps")? {
            steps @ 0..=MAX_STEPS => Ok(steps),
            _ => Err(self.wrong("control_steps", &format!("must be from 0 to {MAX_STEPS}"))),
        }
    }

    fn campaign(&self) -> Result<Campaign, InputError> {
        Ok(Campaign {
            scene: self.text("scene").into(),
            scene_hash: self.hash("scene_hash")?,
            version: self.text("version").into(),
            duration_s: self.duration_s()?,
            first_seed: self.whole("first_seed")?,
            runs: self.whole("runs")?,
        })
    }

    fn run(&self, campaign: &Campaign) -> Result<Run, InputError> {
        let number = self.whole("run")?;
        if number >= campaign.runs {
            return Err(
                self.wrong("run", &format!("must be less than {}, the number of runs", campaign.runs))
            );
        }
        if self.whole("seed")? != campaign.seed(number) {
            let allowed = format!("must be {}, the first seed and the run together", campaign.seed(number));
            return Err(self.wrong("seed", &allowed));
        }
        let crash = match self.text("crash") {
            "" => None,
            name => {
                let crash = Crash::ALL.into_iter().find(|crash| crash.name() == name).ok_or_else(|| {
                    let names = Crash::ALL.map(Crash::name).join(", ");
                    self.wrong("crash", &format!("must be empty or one of {names}"))
                })?;
                Some((crash, self.number("crashed_at_s")?))
            }
        };
        let state = |state: &ArmState| state.name() == self.text("final_state");
        let final_state = ArmState::ALL.into_iter().find(state).ok_or_else(|| {
            let names = ArmState::ALL.map(ArmState::name).join(", ");
            self.wrong("final_state", &format!("must be one of {names}"))
        })?;
        let drawn = self.record.iter().skip(CAMPAIGN.len() + RUN.len());
        let drawn = self.drawn.iter().zip(drawn).map(|(name, cell)| {
            let value = cell
                .parse()
                .map_err(|_| self.error("must be a number").field(format!("{DRAWN}{name}")).value(cell))?;
            Ok((name.clone(), value))
        });
        Ok(Run {
            number,
            outcome: Outcome {
                control_steps: self.control_steps()?,
                attitude_rmse_deg: self.number("attitude_rmse_deg")?,
                heading_rmse_deg: self.number("heading_rmse_deg")?,
                inclination_rmse_deg: self.number("inclination_rmse_deg")?,
                tilt_error_max_deg: self.number("tilt_error_max_deg")?,
                tilt_max_deg: self.number("tilt_max_deg")?,
                position_error_max_m: self.number("position_error_max_m")?,
                crash,
                final_state,
                digest: self.hash("digest")?,
            },
            drawn: drawn.collect::<Result<_, InputError>>()?,
        })
    }
}
