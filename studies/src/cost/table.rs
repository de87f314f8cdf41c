//! The studies as text tables and as CSV.

use std::fmt::Write as _;

use super::{Setting, Study};

/// Problems with at most this many settings are shown in full; of the others the front and the default.
const MAX_FULL: usize = 12;

/// Returns the settings of a problem that a text table shows, and the number of all its settings.
pub(super) fn shown<'a>(study: &'a Study, problem: &'a str) -> (Vec<&'a Setting>, usize) {
    let all: Vec<&Setting> = study.of(problem).collect();
    let count = all.len();
    let short = all.into_iter().filter(|s| count <= MAX_FULL || s.pareto || s.default).collect();
    (short, count)
}

/// Formats a number with three significant digits.
pub(super) fn number(value: Option<f64>) -> String {
    let Some(value) = value else { return "–".into() };
    if value == 0.0 {
        return "0".into();
    }
    let size = value.abs();
    if (1e-3..1e6).contains(&size) {
        let digits = (2 - libm::floor(libm::log10(size)) as i32).max(0) as usize;
        format!("{value:.digits$}")
    } else {
        format!("{value:.1e}")
    }
}

/// Heading of a column, and the function that gives a setting's value.
type Column = (String, Box<dyn Fn(&Setting) -> Option<f64>>);

/// Returns the columns behind the setting, without those that have no value.
pub(super) fn columns(study: &Study) -> Vec<Column> {
    let mut list: Vec<Column> = vec![
        ("error".into(), Box::new(|s| s.error)),
        ("M4 instructions".into(), Box::new(|s| s.m4_instructions)),
        ("flash, bytes".into(), Box::new(|s| s.flash_bytes.map(f64::from))),
        ("host, ns".into(), Box::new(|s| s.host_ns)),
        ("added by this, ns".into(), Box::new(|s| s.host_ns_added)),
    ];
    let mut further: Vec<&'static str> = Vec::new();
    for (name, _) in study.settings.iter().flat_map(|s| &s.also) {
        if !further.contains(name) {
            further.push(name);
        }
    }
    for name in further {
        list.push((named(name), Box::new(move |s| s.figure(name))));
    }
    list.retain(|(_, value)| study.settings.iter().any(|s| value(s).is_some()));
    list
}

/// Returns a readable name for a key with its unit: `group_delay_ms` as "group delay, ms".
fn named(key: &str) -> String {
    for (suffix, unit) in [("_ms", "ms"), ("_deg", "°"), ("_ulp", "ulp"), ("_percent", "%"), ("_hz", "Hz")] {
        if let Some(name) = key.strip_suffix(suffix) {
            return format!("{}, {unit}", name.replace('_', " "));
        }
    }
    key.replace('_', " ")
}

/// Returns the studies as text. The front is marked with `*`, Kestrel's default with `=`.
pub fn text(studies: &[Study]) -> String {
    let mut text = String::new();
    for study in studies {
        let _ = writeln!(text, "{}: {}\nCosts are for {}.", study.name, study.title, study.per);
        let columns = columns(study);
        for problem in study.problems() {
            let (rows, count) = shown(study, problem);
            let unit = rows.first().map_or("", |s| s.error_unit);
            let of = if rows.len() < count {
                format!(", {} of {count} settings", rows.len())
            } else {
                String::new()
            };
            let _ = writeln!(text, "\n  {problem}: error in {unit}{of}");
            let width = rows.iter().map(|s| s.setting.chars().count()).max().unwrap_or(0).max(7);
            let _ = write!(text, "     {:<width$}", "setting");
            for (name, _) in &columns {
                let _ = write!(text, "  {name:>11}");
            }
            for s in rows {
                let marks = [if s.pareto { '*' } else { ' ' }, if s.default { '=' } else { ' ' }];
                let _ = write!(text, "\n  {}{} {:<width$}", marks[0], marks[1], s.setting);
                for (name, value) in &columns {
                    let width = name.chars().count().max(11);
                    let _ = write!(text, "  {:>width$}", number(value(s)));
                }
            }
            text.push('\n');
        }
        text.push('\n');
        for remark in &study.remarks {
            let _ = writeln!(text, "  {remark}");
        }
        text.push('\n');
    }
    let _ = write!(
        text,
        "* on the Pareto front: no other setting of the problem is better in one of error and cost and at least as good \
         in the other. = Kestrel's default."
    );
    text
}

fn quoted(cell: &str) -> String {
    if cell.contains([',', '"']) { format!("\"{}\"", cell.replace('"', "\"\"")) } else { cell.into() }
}

fn cell(value: Option<f64>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

/// Returns as CSV what is the same in every run: errors, instructions, and the study's own costs.
pub fn csv(study: &Study) -> String {
    let mut further: Vec<&'static str> = Vec::new();
    for (name, _) in study.settings.iter().flat_map(|s| &s.also) {
        if !further.contains(name) {
            further.push(name);
        }
    }
    let mut csv = String::from("problem,series,setting,error,error_unit,m4_instructions,flash_bytes,default");
    for name in &further {
        let _ = write!(csv, ",{name}");
    }
    for s in &study.settings {
        let _ = write!(
            csv,
            "\n{},{},{},{},{},{},{},{}",
            quoted(s.problem),
            quoted(&s.series),
            quoted(&s.setting),
            cell(s.error),
            s.error_unit,
            cell(s.m4_instructions),
            cell(s.flash_bytes.map(f64::from)),
            u8::from(s.default),
        );
        for name in &further {
            let _ = write!(csv, ",{}", cell(s.figure(name)));
        }
    }
    csv + "\n"
}

/// Returns as CSV the times measured on this machine.
pub fn timing_csv(study: &Study) -> String {
    let mut csv = String::from("problem,setting,host_ns,host_ns_added,pareto");
    for s in &study.settings {
        let (problem, setting) = (quoted(s.problem), quoted(&s.setting));
        let _ = write!(
            csv,
            "\n{problem},{setting},{},{},{}",
            cell(s.host_ns),
            cell(s.host_ns_added),
            u8::from(s.pareto)
        );
    }
    csv + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits() {
        for (value, text) in
            [(0.0, "0"), (1234.5, "1234"), (12.345, "12.3"), (0.012_345, "0.0123"), (1.2345e-7, "1.2e-7")]
        {
            assert_eq!(number(Some(value)), text);
        }
        assert_eq!(number(None), "–");
    }

    #[test]
    fn a_key_with_its_unit_reads_as_words() {
        assert_eq!(named("group_delay_ms"), "group delay, ms");
        assert_eq!(named("evaluations"), "evaluations");
    }
}
