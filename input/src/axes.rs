//! Which way something is mounted, in quarter turns: where its x, y and z point.

use crate::InputError;
use crate::check::unknown;

/// Where the axes of a chip, or of a board, point: to one of six sides each.
///
/// ```
/// use input::axes::Axes;
/// let axes = Axes::parse("imu.axes", &["right", "forward", "up"].map(String::from)).unwrap();
/// // Forward, right, down, of what the chip reads along its x, y, z.
/// assert_eq!(axes.of([1.0, 2.0, 3.0]), [2.0, 1.0, -3.0]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axes {
    /// For forward, right and down: which of x, y and z (0 to 2) is read there, and its sign.
    rows: [(usize, i8); 3],
}

/// The sides, each with its axis of forward, right, down, and its sign.
const SIDES: [(&str, usize, i8); 6] =
    [("forward", 0, 1), ("backward", 0, -1), ("right", 1, 1), ("left", 1, -1), ("down", 2, 1), ("up", 2, -1)];

impl Axes {
    /// Its x forward, its y to the right, its z down.
    pub const IDENTITY: Self = Self { rows: [(0, 1), (1, 1), (2, 1)] };

    /// From the sides to which x, y and z point. `field` is what an error calls them.
    ///
    /// # Errors
    /// A name that is no side; two axes along one line; a left-handed set of axes, which no chip has.
    pub fn parse(field: &str, sides: &[String; 3]) -> Result<Self, InputError> {
        let mut rows = [None; 3];
        for (place, side) in sides.iter().enumerate() {
            let found = SIDES.iter().find(|(name, ..)| name == side);
            let &(_, axis, sign) = found.ok_or_else(|| unknown(field, side, SIDES.map(|(name, ..)| name)))?;
            if rows[axis].replace((place, sign)).is_some() {
                return Err(InputError::new(format!(
                    "must be three sides at right angles to each other: {} points along the line of another",
                    ["x", "y", "z"][place]
                ))
                .field(field)
                .value(sides.join(", ")));
            }
        }
        // Three axes on three lines, so each line has one.
        let axes = Self { rows: rows.map(|row| row.unwrap_or((0, 1))) };
        if axes.determinant() < 0 {
            return Err(InputError::new("must be right-handed: x, y and z of a chip are; one side is wrong")
                .field(field)
                .value(sides.join(", ")));
        }
        Ok(axes)
    }

    /// What a reading along x, y and z is along forward, right and down.
    pub fn of<T: Copy + std::ops::Neg<Output = T>>(&self, xyz: [T; 3]) -> [T; 3] {
        self.rows.map(|(place, sign)| if sign < 0 { -xyz[place] } else { xyz[place] })
    }

    /// What must be along x, y and z to read so along forward, right and down: the inverse of [`Self::of`].
    pub fn back<T: Copy + std::ops::Neg<Output = T>>(&self, body: [T; 3]) -> [T; 3] {
        let mut xyz = body;
        for (value, (place, sign)) in body.into_iter().zip(self.rows) {
            xyz[place] = if sign < 0 { -value } else { value };
        }
        xyz
    }

    /// These axes on something that is itself mounted by `outer`.
    pub fn within(&self, outer: &Self) -> Self {
        Self {
            rows: outer.rows.map(|(place, sign)| {
                let (inner, inner_sign) = self.rows[place];
                (inner, sign * inner_sign)
            }),
        }
    }

    /// A rotation matrix: its rows are forward, right and down.
    pub fn rows(&self) -> [[i8; 3]; 3] {
        self.rows.map(|(place, sign)| {
            let mut row = [0; 3];
            row[place] = sign;
            row
        })
    }

    fn determinant(&self) -> i8 {
        let [a, b, c] = self.rows();
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axes(x: &str, y: &str, z: &str) -> Result<Axes, InputError> {
        Axes::parse("imu.axes", &[x, y, z].map(String::from))
    }

    /// A cube can lie on a table in 24 ways, and every other choice of three sides is refused.
    #[test]
    fn there_are_24_mountings() {
        let names = SIDES.map(|(name, ..)| name);
        let mut right = Vec::new();
        for x in names {
            for y in names {
                for z in names {
                    right.extend(axes(x, y, z).ok());
                }
            }
        }
        assert_eq!(right.len(), 24);
        for axes in right {
            assert_eq!(axes.back(axes.of([1, 2, 3])), [1, 2, 3]);
        }
    }

    /// A board that is turned by a quarter to the right, with a chip that is turned by a quarter to the left.
    #[test]
    fn mountings_within_each_other() {
        let to_right = axes("right", "backward", "down").unwrap();
        let to_left = axes("left", "forward", "down").unwrap();
        assert_eq!(to_left.within(&to_right), Axes::IDENTITY);
        let up = axes("right", "forward", "up").unwrap();
        assert_eq!(up.within(&to_right).of([1, 2, 3]), to_right.of(up.of([1, 2, 3])));
    }

    #[test]
    fn errors_say_which() {
        for (sides, error) in [
            (
                ["right", "forwards", "up"],
                "imu.axes = forwards: must be one of forward, backward, right, left, down, up (did you mean `forward`?)",
            ),
            (
                ["right", "left", "up"],
                "imu.axes = right, left, up: must be three sides at right angles to each other: y points along the line of another",
            ),
            (
                ["right", "forward", "down"],
                "imu.axes = right, forward, down: must be right-handed: x, y and z of a chip are; one side is wrong",
            ),
        ] {
            let [x, y, z] = sides;
            assert_eq!(axes(x, y, z).unwrap_err().to_string(), error);
        }
    }
}
