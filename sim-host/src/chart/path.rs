//! A line as the `d` of an SVG path: no more points than a screen can show.
//!
//! Two passes. First, of all points in a column of pixels the lowest and the highest stay: that is what the
//! column would show of them, and a peak of one sample is never lost. Then Douglas and Peucker's method takes
//! out points that a straight line passes within a tenth of a pixel.

use std::fmt::Write as _;

/// Distance that a point may be off the line without it, tenths of a pixel: too little to be seen.
const TOLERANCE: f64 = 1.0;

/// Coordinates beyond this are outside of any screen, tenths of a pixel.
const FURTHEST: f64 = 1e6;

/// Place of a coordinate along an axis of this range and width, px from its beginning.
pub(super) fn along_px((first, last): (f64, f64), width: f64, x: f64) -> f64 {
    (x - first) / (last - first).max(1e-9) * width
}

/// From coordinates of the axes to a plot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Projection {
    /// First and last along the bottom: as a rule a time, s.
    pub along: (f64, f64),
    /// Values at the bottom and the top.
    pub values: (f64, f64),
    /// px.
    pub width: f64,
    /// px.
    pub height: f64,
}

/// Tenths of a pixel, from the upper left.
type Point = (i32, i32);

impl Projection {
    /// The path, in tenths of a pixel. A value that is not finite breaks the line.
    pub fn path(&self, points: &[(f64, f64)]) -> String {
        let mut d = String::new();
        for run in points.split(|(t, value)| !t.is_finite() || !value.is_finite()) {
            let run = self.shown(run);
            let projected: Vec<Point> = run.iter().map(|&point| self.project(point)).collect();
            write_run(&mut d, &simplified(&thinned(&projected)));
        }
        d
    }

    /// What is in the range of times, and the neighbours that the line comes from and goes to.
    fn shown<'a>(&self, run: &'a [(f64, f64)]) -> &'a [(f64, f64)] {
        let (first, last) = self.along;
        let from = run.partition_point(|&(t, _)| t < first).saturating_sub(1);
        let to = run.len().min(run.partition_point(|&(t, _)| t <= last) + 1);
        &run[from..to.max(from)]
    }

    /// Px from the left.
    pub fn x(&self, along: f64) -> f64 {
        along_px(self.along, self.width, along)
    }

    /// Px from the top.
    pub fn y(&self, value: f64) -> f64 {
        let (low, high) = self.values;
        (high - value) / (high - low) * self.height
    }

    fn project(&self, (t, value): (f64, f64)) -> Point {
        let tenths = |x: f64| libm::rint(x * 10.0).clamp(-FURTHEST, FURTHEST) as i32;
        (tenths(self.x(t)), tenths(self.y(value)))
    }
}

/// The lowest and the highest point of each column of pixels, and the two ends.
fn thinned(points: &[Point]) -> Vec<Point> {
    let (Some(&first), Some(&last)) = (points.first(), points.last()) else { return Vec::new() };
    let mut out = vec![first];
    for column in points.chunk_by(|a, b| a.0.div_euclid(10) == b.0.div_euclid(10)) {
        if column.len() <= 2 {
            out.extend_from_slice(column);
            continue;
        }
        let top = (0..column.len()).min_by_key(|&k| column[k].1).unwrap_or(0);
        let bottom = (0..column.len()).max_by_key(|&k| column[k].1).unwrap_or(0);
        out.extend([top.min(bottom), top.max(bottom)].map(|k| column[k]));
    }
    out.push(last);
    out.dedup();
    out
}

/// Douglas and Peucker: keeps what lies further than [`TOLERANCE`] from the line without it.
fn simplified(points: &[Point]) -> Vec<Point> {
    let mut keep = vec![false; points.len()];
    if let (Some(first), true) = (keep.first_mut(), !points.is_empty()) {
        *first = true;
        keep[points.len() - 1] = true;
    }
    let mut open = vec![(0, points.len().saturating_sub(1))];
    while let Some((from, to)) = open.pop() {
        let furthest = (from + 1..to)
            .map(|k| (distance(points[k], points[from], points[to]), k))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((distance, k)) = furthest
            && distance > TOLERANCE
        {
            keep[k] = true;
            open.extend([(from, k), (k, to)]);
        }
    }
    points.iter().zip(keep).filter_map(|(&point, keep)| keep.then_some(point)).collect()
}

/// Distance of a point from the stretch between two others.
fn distance(point: Point, from: Point, to: Point) -> f64 {
    let minus = |a: Point, b: Point| (f64::from(a.0 - b.0), f64::from(a.1 - b.1));
    let (along, off) = (minus(to, from), minus(point, from));
    let length_squared = along.0 * along.0 + along.1 * along.1;
    let part = if length_squared > 0.0 {
        ((off.0 * along.0 + off.1 * along.1) / length_squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let (x, y) = (off.0 - part * along.0, off.1 - part * along.1);
    libm::sqrt(x * x + y * y)
}

fn write_run(d: &mut String, points: &[Point]) {
    let Some((&first, rest)) = points.split_first() else { return };
    let _ = write!(d, "M{} {}l", first.0, first.1);
    if rest.is_empty() {
        // A line of no length with round ends is a dot.
        d.push_str("0 0");
    }
    let mut at = first;
    for (n, &point) in rest.iter().enumerate() {
        // A minus sign parts two numbers as well as a space does.
        let (dx, dy) = (point.0 - at.0, point.1 - at.1);
        let before = if n == 0 || dx < 0 { "" } else { " " };
        let between = if dy < 0 { "" } else { " " };
        let _ = write!(d, "{before}{dx}{between}{dy}");
        at = point;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLOT: Projection =
        Projection { along: (0.0, 10.0), values: (0.0, 1.0), width: 100.0, height: 50.0 };

    #[test]
    fn a_straight_line_is_two_points() {
        let points: Vec<_> = (0..=1000).map(|k| (f64::from(k) * 0.01, f64::from(k) * 0.001)).collect();
        assert_eq!(PLOT.path(&points), "M0 500l1000-500");
    }

    #[test]
    fn a_peak_of_one_sample_stays() {
        let mut points: Vec<_> = (0..100_000).map(|k| (f64::from(k) * 1e-4, 0.0)).collect();
        points[54_321].1 = 1.0;
        assert!(PLOT.path(&points).contains("-500"), "{}", PLOT.path(&points));
    }

    #[test]
    fn noise_takes_two_points_a_column() {
        let points: Vec<_> =
            (0..100_000).map(|k| (f64::from(k) * 1e-4, f64::from(k * 7919 % 101) / 101.0)).collect();
        let projected: Vec<_> = points.iter().map(|&point| PLOT.project(point)).collect();
        let kept = thinned(&projected);
        assert!(kept.len() <= 2 * 101 + 2, "{}", kept.len());
        assert_eq!(kept.iter().map(|p| p.1).max(), projected.iter().map(|p| p.1).max());
        assert_eq!(kept.iter().map(|p| p.1).min(), projected.iter().map(|p| p.1).min());
    }

    #[test]
    fn what_is_not_finite_breaks_the_line() {
        let points = [(0.0, 0.0), (1.0, 0.0), (2.0, f64::NAN), (3.0, 1.0), (4.0, f64::INFINITY)];
        assert_eq!(PLOT.path(&points), "M0 500l100 0M300 0l0 0");
        assert_eq!(PLOT.path(&[]), "");
    }

    #[test]
    fn outside_of_the_times_only_the_neighbours_stay() {
        let plot = Projection { along: (4.0, 6.0), ..PLOT };
        let points: Vec<_> = (0..=10).map(|k| (f64::from(k), f64::from(k % 2))).collect();
        assert_eq!(plot.path(&points), "M-500 0l500 500 500-500 500 500 500-500");
    }
}
