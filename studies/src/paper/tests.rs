use super::*;

#[test]
fn table_is_escaped_in_html_and_quoted_in_csv() {
    let (html, csv) = tabulated(&["a", "b"], &[vec!["x, <y>".into(), "1".into()]]);
    assert!(html.into_string().contains("<td>x, &lt;y&gt;</td><td class=\"n\">1</td>"));
    assert_eq!(csv, "a,b\n\"x, <y>\",1\n");
}

#[test]
fn exhibits_without_recordings_are_reproducible() {
    let made = |_| {
        let directory = tempfile::tempdir().unwrap();
        let out = directory.path().join("paper");
        let made = make(&out, None, &|_| ()).unwrap();
        let mut files: Vec<_> = std::fs::read_dir(&out)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .map(|path| (path.file_name().unwrap().to_owned(), std::fs::read(path).unwrap()))
            .collect();
        files.sort();
        (made, files)
    };
    let [(one, first), (_, second)] = [0, 1].map(made);
    assert!(first == second, "the pages differ");
    let names: Vec<&str> = one.figures.iter().map(|f| f.name.as_str()).collect();
    assert_eq!(
        names,
        ["figure-01", "figure-02", "figure-03", "figure-06", "figure-07", "figure-08", "figure-09"]
    );
    assert_eq!(first.len(), 1 + one.tables.len() + one.figures.len());
    assert!(one.left_out.is_some());
    let page = String::from_utf8(first.iter().find(|f| f.0 == "index.html").unwrap().1.clone()).unwrap();
    assert!(page.contains("17.65") && page.contains("1.7116") && !page.contains("NaN"));
    // Table 2 comes back, in both readings of its unit.
    for row in one.tables[0].csv.lines().skip(1) {
        let from_the_end: Vec<&str> = row.rsplit(',').collect();
        let off: f64 = from_the_end[2].trim_end_matches(" %").parse().unwrap();
        assert!(off.abs() < 3.5, "{row}");
    }
}
