//! The command `paper`: the paper's tables and figures reproduced, with ours beside theirs.
//!
//! B. Altınöz, H. Eken, A. Cönger, S. Can, *Modelling inertial measurement unit error parameters for an unmanned
//! air vehicle*, 2024. The result is one page, with the numbers of every figure in a CSV file beside it. The same
//! program writes the same bytes. Figures 10 to 15 need recordings; without them they are left out, and the page says
//! so.

mod bench;
mod figures;
mod recordings;
mod spectrum;
mod table_2;

use std::path::Path;

use input::InputError;
use maud::{Markup, html};
use sim_host::output_file;
use sim_host::report::document;

/// A table or a figure.
#[derive(Clone, Debug)]
pub struct Exhibit {
    /// Its name in file names and in the JSON result: `figure-07`.
    pub name: String,
    /// Its title on the page.
    pub title: String,
    /// Its caption: what the paper shows, and what is shown here.
    pub caption: String,
    /// A chart, a table, or both.
    html: Markup,
    /// The numbers, as CSV.
    csv: String,
    /// Further CSV files, each with its suffix to the name: `-spectrum`.
    further: Vec<(&'static str, String)>,
    /// Its main result in one or two numbers.
    pub in_short: String,
}

/// The exhibits that were made.
#[derive(Clone, Debug)]
pub struct Made {
    /// The paper's tables.
    pub tables: Vec<Exhibit>,
    /// Its figures.
    pub figures: Vec<Exhibit>,
    /// A sentence that says what was left out and why.
    pub left_out: Option<String>,
}

/// Writes all exhibits and the page into the directory `out`.
///
/// # Errors
/// A file cannot be written; a recording cannot be read.
pub fn make(out: &Path, recordings: Option<&Path>, progress: &dyn Fn(u64)) -> Result<Made, InputError> {
    std::fs::create_dir_all(out)
        .map_err(|error| InputError::new(format!("cannot be created: {error}")).file(out).field("--out"))?;
    let tables = vec![table_2::table(progress)?];
    let mut figures = figures::all(progress)?;
    let left_out = match recordings {
        Some(directory) => {
            figures.extend(recordings::all(directory)?);
            None
        }
        None => Some(
            "Figures 10 to 15 compare a recording at rest with its simulation. No recordings were given \
             (KESTREL_DATA), so they are left out."
                .into(),
        ),
    };
    progress(100);
    let made = Made { tables, figures, left_out };
    for exhibit in made.tables.iter().chain(&made.figures) {
        output_file::write(out.join(format!("{}.csv", exhibit.name)), &exhibit.csv)?;
        for (addition, csv) in &exhibit.further {
            output_file::write(out.join(format!("{}{addition}.csv", exhibit.name)), csv)?;
        }
    }
    // The page is written last: once it exists, all files that it links to exist.
    output_file::write(out.join("index.html"), &page(&made))?;
    Ok(made)
}

fn page(made: &Made) -> String {
    let style = "td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;width:auto}\n\
         table.data{width:auto;min-width:60%}\ntable.data th{width:auto;color:#333;font-weight:600}\n\
         .pair{display:flex;gap:10px}.pair .chart{flex:1 1 0;min-width:0}\n";
    let content = html! {
        header {
            p.kind { "Kestrel · the paper, reproduced" }
            h1 { "Modelling inertial measurement unit error parameters for an unmanned air vehicle" }
            p.about {
                "Tables and figures of Altınöz, Eken, Cönger and Can (2024), reproduced with Kestrel's simulation and analysis, \
                 beside what the paper prints."
            }
            p.facts {
                "Every number on this page is in a CSV file beside it. The same program writes the same page, byte for byte."
            }
        }
        @for exhibit in made.tables.iter().chain(&made.figures) { (shown(exhibit)) }
        @if let Some(left_out) = &made.left_out {
            h2 { "Left out" }
            p { (left_out) }
        }
        footer {
            "Table 1 lists symbols, and figures 4 and 5 show the vehicle: they have nothing to compute. docs/paper.md discusses \
             the paper equation by equation."
        }
    };
    document("The paper's tables and figures", style, &content)
}

fn shown(exhibit: &Exhibit) -> Markup {
    let additions = std::iter::once("").chain(exhibit.further.iter().map(|f| f.0));
    let files: Vec<String> = additions.map(|addition| format!("{}{addition}.csv", exhibit.name)).collect();
    html! {
        figure id=(exhibit.name) {
            h2 { (exhibit.title) }
            figcaption {
                (exhibit.caption) " Numbers: "
                @for (k, file) in files.iter().enumerate() {
                    @if k > 0 { ", " }
                    a href=(file) { (file) }
                }
                "."
            }
            div.scroll { (exhibit.html) }
        }
    }
}

/// Returns a table as HTML and as CSV, from a header and rows. The first column is text.
fn tabulated(header: &[&str], rows: &[Vec<String>]) -> (Markup, String) {
    let html = html! {
        table.data {
            tr {
                @for (k, cell) in header.iter().enumerate() { th class=[(k > 0).then_some("n")] { (cell) } }
            }
            @for row in rows {
                tr {
                    @for (k, cell) in row.iter().enumerate() { td class=[(k > 0).then_some("n")] { (cell) } }
                }
            }
        }
    };
    let quoted = |cell: &str| {
        if cell.contains([',', '"']) { format!("\"{}\"", cell.replace('"', "\"\"")) } else { cell.into() }
    };
    let line =
        |cells: &mut dyn Iterator<Item = &str>| cells.map(quoted).collect::<Vec<String>>().join(",") + "\n";
    let mut csv = line(&mut header.iter().copied());
    for row in rows {
        csv += &line(&mut row.iter().map(String::as_str));
    }
    (html, csv)
}

/// Returns rows of numbers as CSV under a header. Numbers that are not finite are empty cells.
fn numbers(header: &str, rows: impl Iterator<Item = Vec<f64>>) -> String {
    let mut csv = format!("{header}\n");
    for row in rows {
        let cells: Vec<String> =
            row.iter().map(|x| if x.is_finite() { x.to_string() } else { String::new() }).collect();
        csv += &cells.join(",");
        csv.push('\n');
    }
    csv
}

#[cfg(test)]
mod tests;
