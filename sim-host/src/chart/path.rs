//! Converts a line to the `d` attribute of an SVG path, with no more points than a screen can show.
//!
//! There are two passes. The first keeps the lowest and the highest point of each column of pixels. The column looks
//! the same, and a peak of one sample is never lost. The second pass uses the Douglas-Peucker method to remove points
//! that are within a tenth of a pixel of a straight line.

use std::fmt::Write as _;

/// Maximum distance of a removed point from the line, tenths of a pixel: too small to see.
const TOLERANCE: f64 = 1.0;

/// Limit of coordinates, tenths of a pixel: beyond any screen.
const MAX_COORDINATE: f64 = 1e6;

/// Returns the position of a coordinate on an axis of this range and width, px from its start.
pub(super) fn along_px((first, last): (f64, f64), width: f64, x: f64) -> f64 {
    (x - first) / (last - first).max(1e-9) * width
}

/// The mapping from coordinates of the axes to the plot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Projection {
    /// Range of the x axis; usually a time, s.
    pub x_range: (f64, f64),
    /// Values at the bottom and the top.
    pub values: (f64, f64),
    /// Width of the plot, px.
    pub width: f64,
    /// Height of the plot, px.
    pub height: f64,
}

/// A point, tenths of a pixel from the upper left.
type Point = (i32, i32);

impl Projection {
    /// Returns the path, in tenths of a pixel. A value that is not finite breaks the line.
    pub fn path(&self, points: &[(f64, f64)]) -> String {
        let mut d = String::new();
        for run in points.split(|(t, value)| !t.is_finite() || !value.is_finite()) {
            let run = self.clip(run);
            let projected: Vec<Point> = run.iter().map(|&point| self.project(point)).collect();
            write_run(&mut d, &simplify(&thin(&projected)));
        }
        d
    }

    /// Returns the points inside the range of the x axis, and one neighbour on each side.
    fn clip<'a>(&self, run: &'a [(f64, f64)]) -> &'a [(f64, f64)] {
        let (first, last) = self.x_range;
        let from = run.partition_point(|&(t, _)| t < first).saturating_sub(1);
        let to = run.len().min(run.partition_point(|&(t, _)| t <= last) + 1);
        &run[from..to.max(from)]
    }

    /// Returns the horizontal position, px from the left.
    pub fn x(&self, x: f64) -> f64 {
        along_px(self.x_range, self.width, x)
    }

    /// Returns the vertical position, px from the top.
    pub fn y(&self, value: f64) -> f64 {
        let (low, high) = self.values;
        (high - value) / (high - low) * self.height
    }

    fn project(&self, (t, value): (f64, f64)) -> Point {
        let tenths = |x: f64| libm::rint(x * 10.0).clamp(-MAX_COORDINATE, MAX_COORDINATE) as i32;
        (tenths(self.x(t)), tenths(self.y(value)))
    }
}

/// Returns the lowest and the highest point of each column of pixels, and the two ends.
fn thin(points: &[Point]) -> Vec<Point> {
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

/// Applies the Douglas-Peucker method: removes points that are within [`TOLERANCE`] of the simplified line.
fn simplify(points: &[Point]) -> Vec<Point> {
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

/// Returns the distance of a point from the segment between two others.
fn distance(point: Point, from: Point, to: Point) -> f64 {
    let minus = |a: Point, b: Point| (f64::from(a.0 - b.0), f64::from(a.1 - b.1));
    let (direction, off) = (minus(to, from), minus(point, from));
    let length_squared = direction.0 * direction.0 + direction.1 * direction.1;
    let part = if length_squared > 0.0 {
        ((off.0 * direction.0 + off.1 * direction.1) / length_squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let (x, y) = (off.0 - part * direction.0, off.1 - part * direction.1);
    libm::sqrt(x * x + y * y)
}

fn write_run(d: &mut String, points: &[Point]) {
    let Some((&first, rest)) = points.split_first() else { return };
    let _ = write!(d, "M{} {}l", first.0, first.1);
    if rest.is_empty() {
        // A line of length zero with round ends is a dot.
        d.push_str("0 0");
    }
    let mut at = first;
    for (n, &point) in rest.iter().enumerate() {
        // A minus sign separates two numbers, so no space is needed before it.
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
        Projection { x_range: (0.0, 10.0), values: (0.0, 1.0), width: 100.0, height: 50.0 };

    #[test]
    fn straight_line_is_two_points() {
        let points: Vec<_> = (0..=1000).map(|k| (f64::from(k) * 0.01, f64::from(k) * 0.001)).collect();
        assert_eq!(PLOT.path(&points), "M0 500l1000-500");
    }

    #[test]
    fn peak_of_one_sample_stays() {
        let mut points: Vec<_> = (0..100_000).map(|k| (f64::from(k) * 1e-4, 0.0)).collect();
        points[54_321].1 = 1.0;
        assert!(PLOT.path(&points).contains("-500"), "{}", PLOT.path(&points));
    }

    #[test]
    fn noise_keeps_two_points_per_column() {
        let points: Vec<_> =
            (0..100_000).map(|k| (f64::from(k) * 1e-4, f64::from(k * 7919 % 101) / 101.0)).collect();
        let projected: Vec<_> = points.iter().map(|&point| PLOT.project(point)).collect();
        let kept = thin(&projected);
        assert!(kept.len() <= 2 * 101 + 2, "{}", kept.len());
        assert_eq!(kept.iter().map(|p| p.1).max(), projected.iter().map(|p| p.1).max());
        assert_eq!(kept.iter().map(|p| p.1).min(), projected.iter().map(|p| p.1).min());
    }

    #[test]
    fn non_finite_value_breaks_the_line() {
        let points = [(0.0, 0.0), (1.0, 0.0), (2.0, f64::NAN), (3.0, 1.0), (4.0, f64::INFINITY)];
        assert_eq!(PLOT.path(&points), "M0 500l100 0M300 0l0 0");
        assert_eq!(PLOT.path(&[]), "");
    }

    #[test]
    fn points_outside_the_range_are_clipped_to_neighbours() {
        let plot = Projection { x_range: (4.0, 6.0), ..PLOT };
        let points: Vec<_> = (0..=10).map(|k| (f64::from(k), f64::from(k % 2))).collect();
        assert_eq!(plot.path(&points), "M-500 0l500 500 500-500 500 500 500-500");
    }
}
