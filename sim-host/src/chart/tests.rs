use super::*;

fn panel(points: Vec<(f64, f64)>) -> Panel {
    let line = Line::new("<truth>", Stroke::solid(colour::SKY, 2.0), points);
    Panel {
        min_span: 1.0,
        right: Some(RightAxis { unit: "rad/s", zero: -10.0, per_unit: 0.5 }),
        ..Panel::new("Roll & pitch", "°", 100.0, vec![line])
    }
}

fn chart(points: Vec<(f64, f64)>) -> Chart {
    Chart {
        heading: Some(("Title".into(), "Note".into())),
        ..Chart::over_time(400.0, "a \"description\"", (0.0, 10.0), vec![panel(points)])
    }
}

/// Returns a chart of two equal panels with logarithmic axes: a line with dots, a band and a label.
fn logarithmic(points: Vec<(f64, f64)>) -> Chart {
    let band =
        Band { colour: colour::SKY, points: points.iter().map(|&(x, y)| (x, y * 0.9, y * 1.1)).collect() };
    let label = Label { at: (1.0, 0.1), text: "N < 1".into(), colour: colour::BLACK };
    let line = Line { dots: true, ..Line::new("a & b", Stroke::solid(colour::BLUE, 1.5), points) };
    let panel =
        Panel { bands: vec![band], labels: vec![label], ..Panel::new("x", "°/s", 100.0, vec![line]) };
    Chart { columns: 2, ..Chart::logarithmic(400.0, "d", "τ, s", vec![panel.clone(), panel]) }
}

fn mark(time_s: f64, label: &str) -> Mark {
    Mark { time_s, label: label.into(), colour: colour::GREEN }
}

#[test]
fn extreme_values_give_finite_coordinates() {
    let cases = [
        vec![],
        vec![(0.0, 0.0)],
        vec![(0.0, f64::NAN), (1.0, f64::INFINITY)],
        vec![(0.0, -1e300), (5.0, 1e300), (f64::NAN, 0.0)],
        vec![(0.0, 1e9), (10.0, 1e9)],
        vec![(3.0, 1e-300), (3.0, -1e-300)],
    ];
    for points in cases {
        let mut chart = chart(points.clone());
        for time_s in [(0.0, 10.0), (0.0, 0.0)] {
            chart.x_range = Some(time_s);
            let svg = chart.to_svg();
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{points:?}: {svg}");
        }
    }
}

#[test]
fn values_without_logarithm_are_not_drawn() {
    for points in [
        vec![],
        vec![(1.0, 1.0)],
        vec![(0.0, -1.0), (f64::NAN, 1.0), (1.0, f64::INFINITY)],
        vec![(1e-300, 1e-300), (1e300, 1e300)],
        vec![(1.0, 5.0), (2.0, 5.1)],
    ] {
        let svg = logarithmic(points.clone()).to_svg_file();
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{points:?}: {svg}");
        assert!(svg.contains("a &amp; b") && svg.contains("N &lt; 1"));
    }
}

/// A line of slope −½ through (1, 1), four decades long.
#[test]
fn power_law_is_straight_on_logarithmic_axes() {
    let points: Vec<(f64, f64)> = (-20..=20)
        .map(|k| (libm::pow(10.0, 0.1 * f64::from(k)), libm::pow(10.0, -0.05 * f64::from(k))))
        .collect();
    let svg = Chart { columns: 1, ..logarithmic(points) }.to_svg();
    let path = svg.split("class=\"l\"").nth(1).and_then(|rest| rest.split(" d=\"").nth(1)).unwrap();
    let path = path.split('"').next().unwrap();
    // x: 334 px for 4 decades and a margin of 0.2 at each end, so the line starts at 334 · 0.2/4.4 = 15.2 px and is
    // 334 · 4/4.4 = 303.6 px long. y: 100 px from 1 + log 1.1 to −1 + log 0.9, the ends of the band, and a margin of 0.15
    // at each end, so the line starts at 100 · 0.191/2.387 = 8.0 px and is 100 · 2/2.387 = 83.8 px high.
    assert_eq!(path, "M152 80l3036 838");
}

#[test]
fn text_is_escaped() {
    let svg = chart(vec![(0.0, 1.0)]).to_svg();
    assert!(svg.contains("&lt;truth&gt;") && svg.contains("Roll &amp; pitch"));
    assert!(svg.contains("aria-label=\"a &quot;description&quot;\""));
    assert_eq!(escaped("a\u{0}b\nc'"), "a\u{FFFD}b c&#39;");
}

#[test]
fn svg_file_has_no_external_references() {
    let file = chart(vec![(0.0, 1.0)]).to_svg_file();
    let rest = file.replacen("http://www.w3.org/2000/svg", "", 1);
    assert!(file.starts_with("<svg xmlns=") && rest != file);
    assert!(!rest.contains("http") && !rest.contains("url(") && !rest.contains("href"));
}

#[test]
fn axis_covers_shown_points_and_included_values() {
    let panel = Panel { includes: vec![-4.0], ..panel(vec![(0.0, 1.0), (5.0, 2.0), (20.0, 900.0)]) };
    let (low, high) = panel.range(Scale::Linear, (0.0, 10.0));
    assert!((-5.0..-4.0).contains(&low) && (2.0..3.0).contains(&high), "{low} {high}");
}

#[test]
fn nearly_constant_line_keeps_the_minimum_span() {
    let (low, high) = panel(vec![(0.0, 1.0), (5.0, 1.0 + 1e-7)]).range(Scale::Linear, (0.0, 10.0));
    assert!((high - low - 1.0).abs() < 1e-6);
}

#[test]
fn mark_labels_do_not_overlap_and_stay_inside() {
    let mut chart = chart(vec![(0.0, 1.0)]);
    chart.marks = vec![mark(1.0, "armed"), mark(1.1, "disarmed"), mark(9.9, "crash"), mark(6.0, "armed")];
    let rows: Vec<_> = chart.mark_labels().iter().map(|label| (label.row, label.leftwards)).collect();
    assert_eq!(rows, [(0, false), (1, false), (0, true), (0, false)]);
    assert_eq!(chart.marks_height(), 2.0 * MARK_ROW);
}

#[test]
fn lengths_are_rounded_to_a_tenth() {
    assert_eq!(["0", "0", "12.3", "-4"], [0.0, -0.01, 12.345, -4.0].map(px).each_ref().map(String::as_str));
}
