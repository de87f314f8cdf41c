//! The command `paper`: the paper's tables and figures made again, ours beside theirs.
//!
//! B. Altınöz, H. Eken, A. Cönger, S. Can, *Modelling inertial measurement unit error parameters for an unmanned
//! air vehicle*, 2024. One page, with the numbers of every figure in a CSV file beside it. The same program
//! makes the same bytes; figures 10 to 15 need recordings, and are left out, and said to be, without them.

mod bench;
mod figures;
mod recordings;
mod spectrum;
mod table_2;

use std::fmt::Write as _;
use std::path::Path;

use input::InputError;
use sim_host::chart::escaped;
use sim_host::output_file;
use sim_host::report::begin;

/// A table or a figure.
#[derive(Clone, Debug)]
pub struct Exhibit {
    /// Its name among the files, and in the result: `figure-07`.
    pub name: String,
    /// What it is called on the page.
    pub title: String,
    /// What the paper shows, and what is shown here.
    pub caption: String,
    /// HTML: a picture, a table, or both.
    html: String,
    /// The numbers, as CSV.
    csv: String,
    /// Further numbers, each with what is added to the name: `-spectrum`.
    further: Vec<(&'static str, String)>,
    /// The one or two numbers that say it in short.
    pub in_short: String,
}

/// What was made.
#[derive(Clone, Debug)]
pub struct Made {
    /// The paper's tables.
    pub tables: Vec<Exhibit>,
    /// Its figures.
    pub figures: Vec<Exhibit>,
    /// What was left out, and why.
    pub left_out: Option<String>,
}

/// Makes everything that can be made into the directory at `out`.
///
/// # Errors
/// A place that cannot be written; recordings that cannot be read.
pub fn make(out: &Path, recordings: Option<&Path>, progress: &dyn Fn(u64)) -> Result<Made, InputError> {
    std::fs::create_dir_all(out)
        .map_err(|error| InputError::new(format!("cannot be made: {error}")).file(out).field("--out"))?;
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
    // The page last: when it is there, so is everything that it links to.
    output_file::write(out.join("index.html"), &page(&made))?;
    Ok(made)
}

fn page(made: &Made) -> String {
    let style = "td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;width:auto}\n\
         table.data{width:auto;min-width:60%}\ntable.data th{width:auto;color:#333;font-weight:600}\n\
         .pair{display:flex;gap:10px}.pair .chart{flex:1 1 0;min-width:0}\n";
    let mut html = begin("The paper's tables and figures", style);
    html.push_str(
        "<header>\n<p class=\"kind\">Kestrel · the paper, made again</p>\n\
         <h1>Modelling inertial measurement unit error parameters for an unmanned air vehicle</h1>\n\
         <p class=\"about\">Tables and figures of Altınöz, Eken, Cönger and Can (2024), from this project's own \
         simulation and analysis, beside what the paper prints.</p>\n\
         <p class=\"facts\">Every number on this page is in a CSV file beside it. The same program makes the same \
         page, to the byte.</p>\n</header>\n",
    );
    for exhibit in made.tables.iter().chain(&made.figures) {
        let name = &exhibit.name;
        let additions = std::iter::once("").chain(exhibit.further.iter().map(|f| f.0));
        let links: Vec<String> = additions
            .map(|addition| format!("<a href=\"{name}{addition}.csv\">{name}{addition}.csv</a>"))
            .collect();
        let _ = write!(
            html,
            "<figure id=\"{name}\">\n<h2>{}</h2>\n<figcaption>{} Numbers: {}.</figcaption>\n\
             <div class=\"scroll\">{}</div>\n</figure>\n",
            escaped(&exhibit.title),
            escaped(&exhibit.caption),
            links.join(", "),
            exhibit.html,
        );
    }
    if let Some(left_out) = &made.left_out {
        let _ = write!(html, "<h2>Left out</h2>\n<p>{}</p>\n", escaped(left_out));
    }
    html.push_str(
        "<footer>Table 1 lists symbols, and figures 4 and 5 show the vehicle: there is nothing in them to compute. \
         Equation by equation the paper is gone through in docs/paper.md.</footer>\n</main>\n</body>\n</html>\n",
    );
    html
}

/// A table as HTML and as CSV: a header and rows. The first column is text.
fn tabulated(header: &[&str], rows: &[Vec<String>]) -> (String, String) {
    let mut html = String::from("<table class=\"data\">\n<tr>");
    for (k, cell) in header.iter().enumerate() {
        let class = if k == 0 { "" } else { " class=\"n\"" };
        let _ = write!(html, "<th{class}>{}</th>", escaped(cell));
    }
    html.push_str("</tr>\n");
    for row in rows {
        html.push_str("<tr>");
        for (k, cell) in row.iter().enumerate() {
            let class = if k == 0 { "" } else { " class=\"n\"" };
            let _ = write!(html, "<td{class}>{}</td>", escaped(cell));
        }
        html.push_str("</tr>\n");
    }
    html.push_str("</table>");
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

/// Rows of numbers under a header.
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
