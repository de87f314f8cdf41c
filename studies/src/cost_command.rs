//! The command `cost`: error against cost of the parts of Kestrel.

use std::path::PathBuf;

use input::InputError;
use sim_host::output_file::{self, OutputFile};
use studies::cost::{self, Options};

use sim_host::command::{Answer, progress_bar};

use super::RECORDINGS;

#[derive(clap::Args)]
pub struct CostArguments {
    /// Studies to run: integrator, attitude, estimator, prefilter, arithmetic, rates, sensors [default: all].
    /// `estimator` also uses the recordings in the directory that the environment variable KESTREL_DATA names
    #[arg(value_name = "STUDY")]
    studies: Vec<String>,
    /// Run fewer settings, seeds and repetitions: all studies together take less than a minute
    #[arg(long)]
    quick: bool,
    /// Write a report with plots: one HTML file that needs no network
    #[arg(long, value_name = "F.html")]
    report: Option<PathBuf>,
    /// Write two files for each study into this directory: STUDY.csv, equal in every run, and STUDY-timing.csv
    #[arg(long, value_name = "DIR")]
    csv: Option<PathBuf>,
}

pub fn run(arguments: &CostArguments) -> Result<Answer, InputError> {
    // Errors in the arguments are found before minutes of work.
    cost::check_names(&arguments.studies)?;
    if let Some(directory) = &arguments.csv {
        std::fs::create_dir_all(directory).map_err(|error| {
            InputError::new(format!("cannot be created: {error}")).file(directory).field("--csv")
        })?;
    }
    let report = arguments.report.as_ref().map(OutputFile::create).transpose()?;

    let recordings = std::env::var_os(RECORDINGS).filter(|path| !path.is_empty()).map(PathBuf::from);
    let options = Options { quick: arguments.quick, timed: true, recordings };
    let bar = progress_bar(1000, "cost");
    let studies = cost::run(&arguments.studies, &options, &|study, part| {
        bar.set_message(study.to_owned());
        bar.set_position((1000.0 * part) as u64);
    })?;
    bar.finish_and_clear();
    if let Some(directory) = &arguments.csv {
        for study in &studies {
            let file = |addition: &str| directory.join(format!("{}{addition}.csv", study.name));
            output_file::write(file(""), &cost::csv(study))?;
            output_file::write(file("-timing"), &cost::timing_csv(study))?;
        }
    }
    if let Some(mut report) = report {
        report.write_text(&cost::page(&studies))?;
        report.finish()?;
    }
    Ok(Answer { json: cost::to_json(&studies), text: cost::text(&studies), failed: false })
}
