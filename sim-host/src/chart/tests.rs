use super::*;

fn panel(points: Vec<(f64, f64)>) -> Panel {
    let line = Line::new("<truth>", Stroke::solid(colour::SKY, 2.0), points);
    Panel {
        least_span: 1.0,
        right: Some(RightAxis { unit: "rad/s", zero: -10.0, per_unit: 0.5 }),
        ..Panel::new("Roll & pitch", "°", 100.0, vec![line])
    }
}

fn chart(points: Vec<(f64, f64)>) -> Chart {
    Chart {
        heading: Some(("Title".into(), "Note".into())),
        ..Chart::over_time(400.0, "what is \"seen\"", (0.0, 10.0), vec![panel(points)])
    }
}

/// A line with dots, a band and a label, on logarithmic axes, twice.
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
fn whatever_is_plotted_every_coordinate_is_a_number() {
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
            chart.along = Some(time_s);
            let svg = chart.to_svg();
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{points:?}: {svg}");
        }
    }
}

#[test]
fn what_has_no_logarithm_has_no_place() {
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
fn logarithmic_axes_make_a_power_a_straight_line() {
    let points: Vec<(f64, f64)> = (-20..=20)
        .map(|k| (libm::pow(10.0, 0.1 * f64::from(k)), libm::pow(10.0, -0.05 * f64::from(k))))
        .collect();
    let svg = Chart { columns: 1, ..logarithmic(points) }.to_svg();
    let path = svg.split("class=\"l\"").nth(1).and_then(|rest| rest.split(" d=\"").nth(1)).unwrap();
    let path = path.split('"').next().unwrap();
    // Along 4 decades and 0.2 of room at each end, 334 px: from 0.2/4.4 = 15.2 px on by 4/4.4 = 303.6. Up 1 + log 1.1 to
    // −1 + log 0.9, the band's ends, and 0.15 of room, 100 px: from 0.191/2.387 = 8.0 px on by 2/2.387 = 83.8.
    assert_eq!(path, "M152 80l3036 838");
}

#[test]
fn text_is_escaped() {
    let svg = chart(vec![(0.0, 1.0)]).to_svg();
    assert!(svg.contains("&lt;truth&gt;") && svg.contains("Roll &amp; pitch"));
    assert!(svg.contains("aria-label=\"what is &quot;seen&quot;\""));
    assert_eq!(escaped("a\u{0}b\nc'"), "a\u{FFFD}b c&#39;");
}

#[test]
fn a_file_stands_alone_and_asks_for_nothing() {
    let file = chart(vec![(0.0, 1.0)]).to_svg_file();
    let rest = file.replacen("http://www.w3.org/2000/svg", "", 1);
    assert!(file.starts_with("<svg xmlns=") && rest != file);
    assert!(!rest.contains("http") && !rest.contains("url(") && !rest.contains("href"));
}

#[test]
fn the_axis_covers_what_is_in_the_time_shown_and_what_is_asked() {
    let panel = Panel { covers: vec![-4.0], ..panel(vec![(0.0, 1.0), (5.0, 2.0), (20.0, 900.0)]) };
    let (low, high) = panel.range(Scale::Linear, (0.0, 10.0));
    assert!((-5.0..-4.0).contains(&low) && (2.0..3.0).contains(&high), "{low} {high}");
}

#[test]
fn a_line_that_hardly_moves_is_not_blown_up() {
    let (low, high) = panel(vec![(0.0, 1.0), (5.0, 1.0 + 1e-7)]).range(Scale::Linear, (0.0, 10.0));
    assert!((high - low - 1.0).abs() < 1e-6);
}

#[test]
fn labels_of_marks_do_not_cover_each_other_and_stay_inside() {
    let mut chart = chart(vec![(0.0, 1.0)]);
    chart.marks = vec![mark(1.0, "armed"), mark(1.1, "disarmed"), mark(9.9, "crash"), mark(6.0, "armed")];
    let rows: Vec<_> = chart.mark_labels().iter().map(|label| (label.row, label.leftwards)).collect();
    assert_eq!(rows, [(0, false), (1, false), (0, true), (0, false)]);
    assert_eq!(chart.marks_height(), 2.0 * MARK_ROW);
}

#[test]
fn lengths_are_short() {
    assert_eq!(["0", "0", "12.3", "-4"], [0.0, -0.01, 12.345, -4.0].map(px).each_ref().map(String::as_str));
}
