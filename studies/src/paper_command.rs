//! The command `paper`: reproduces the paper's tables and figures.

use std::fmt::Write as _;
use std::path::PathBuf;

use input::InputError;
use serde_json::{Value, json};
use studies::paper::{self, Exhibit};

use sim_host::command::{Answer, progress_bar};

use super::RECORDINGS;

#[derive(clap::Args)]
pub struct PaperArguments {
    /// Directory for the page and its CSV files; created if it does not exist. Figures 10 to 15 need the recordings
    /// in the directory that the environment variable KESTREL_DATA names
    #[arg(long, value_name = "DIR", default_value = "paper")]
    out: PathBuf,
}

pub fn run(arguments: &PaperArguments) -> Result<Answer, InputError> {
    let recordings = std::env::var_os(RECORDINGS).filter(|path| !path.is_empty()).map(PathBuf::from);
    let bar = progress_bar(100, "paper");
    let made = paper::make(&arguments.out, recordings.as_deref(), &|percent| bar.set_position(percent))?;
    bar.finish_and_clear();
    let mut text = String::new();
    for exhibit in made.tables.iter().chain(&made.figures) {
        let _ = writeln!(text, "{}\n  {}", exhibit.title, exhibit.in_short);
    }
    if let Some(left_out) = &made.left_out {
        let _ = writeln!(text, "\n{left_out}");
    }
    let _ = write!(text, "\n{}", arguments.out.join("index.html").display());
    let list = |exhibits: &[Exhibit]| -> Vec<Value> {
        exhibits
            .iter()
            .map(|e| json!({ "name": e.name, "title": e.title, "in_short": e.in_short, "csv": format!("{}.csv", e.name) }))
            .collect()
    };
    let json = json!({
        "page": arguments.out.join("index.html"),
        "tables": list(&made.tables),
        "figures": list(&made.figures),
        "left_out": made.left_out,
    });
    Ok(Answer { json, text, failed: false })
}
