//! The mounting of a chip or a board in quarter turns: the directions in which its x, y and z axes point.

use crate::InputError;
use crate::check::unknown;

/// The directions of the axes of a chip or a board. Each axis points in one of six directions: forward, backward, right,
/// left, down or up.
///
/// ```
/// use input::axes::Axes;
/// let axes = Axes::parse("imu.axes", &["right", "forward", "up"].map(String::from)).unwrap();
/// // From a reading along the chip's x, y, z to the same reading along forward, right, down.
/// assert_eq!(axes.body_from_chip([1.0, 2.0, 3.0]), [2.0, 1.0, -3.0]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axes {
    /// For forward, right and down: the chip's axis along that line (0 to 2 for x to z), and its sign.
    rows: [(usize, i8); 3],
}

/// Names of the directions. Each has the index of its line (0 forward, 1 right, 2 down) and its sign.
const DIRECTIONS: [(&str, usize, i8); 6] =
    [("forward", 0, 1), ("backward", 0, -1), ("right", 1, 1), ("left", 1, -1), ("down", 2, 1), ("up", 2, -1)];

impl Axes {
    /// x forward, y right, z down.
    pub const IDENTITY: Self = Self { rows: [(0, 1), (1, 1), (2, 1)] };

    /// Parses the directions of x, y and z. Errors name `field`.
    ///
    /// # Errors
    /// A name that is not a direction; two parallel axes; a left-handed set of axes, which no chip has.
    pub fn parse(field: &str, directions: &[String; 3]) -> Result<Self, InputError> {
        let mut rows = [None; 3];
        for (index, direction) in directions.iter().enumerate() {
            let found = DIRECTIONS.iter().find(|(name, ..)| name == direction);
            let &(_, line, sign) =
                found.ok_or_else(|| unknown(field, direction, DIRECTIONS.map(|(name, ..)| name)))?;
            if rows[line].replace((index, sign)).is_some() {
                return Err(InputError::new(format!(
                    "must be three perpendicular directions: {} is parallel to another axis",
                    ["x", "y", "z"][index]
                ))
                .field(field)
                .value(directions.join(", ")));
            }
        }
        // Three axes on three different lines fill all rows: the default is never used.
        let axes = Self { rows: rows.map(|row| row.unwrap_or((0, 1))) };
        if axes.determinant() < 0 {
            return Err(InputError::new(
                "must be right-handed, as the axes of every chip are: one direction is wrong",
            )
            .field(field)
            .value(directions.join(", ")));
        }
        Ok(axes)
    }

    /// Converts a vector from the chip's x, y, z to the body's forward, right, down.
    pub fn body_from_chip<T: Copy + std::ops::Neg<Output = T>>(&self, xyz: [T; 3]) -> [T; 3] {
        self.rows.map(|(axis, sign)| if sign < 0 { -xyz[axis] } else { xyz[axis] })
    }

    /// Converts a vector from the body's forward, right, down to the chip's x, y, z: the inverse of
    /// [`Self::body_from_chip`].
    pub fn chip_from_body<T: Copy + std::ops::Neg<Output = T>>(&self, body: [T; 3]) -> [T; 3] {
        let mut xyz = body;
        for (value, (axis, sign)) in body.into_iter().zip(self.rows) {
            xyz[axis] = if sign < 0 { -value } else { value };
        }
        xyz
    }

    /// Returns the mounting of a chip on the vehicle: `self` is its mounting on a board, `board` the board's on the
    /// vehicle.
    pub fn mounted_on(&self, board: &Self) -> Self {
        Self {
            rows: board.rows.map(|(axis, sign)| {
                let (chip_axis, chip_sign) = self.rows[axis];
                (chip_axis, sign * chip_sign)
            }),
        }
    }

    /// Returns the rotation matrix from chip to body. Its rows are forward, right and down.
    pub fn rows(&self) -> [[i8; 3]; 3] {
        self.rows.map(|(axis, sign)| {
            let mut row = [0; 3];
            row[axis] = sign;
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

    /// A cube has 24 orientations in quarter turns. All other choices of three directions are rejected.
    #[test]
    fn exactly_24_mountings_are_accepted() {
        let names = DIRECTIONS.map(|(name, ..)| name);
        let mut accepted = Vec::new();
        for x in names {
            for y in names {
                for z in names {
                    accepted.extend(axes(x, y, z).ok());
                }
            }
        }
        assert_eq!(accepted.len(), 24);
        for axes in accepted {
            assert_eq!(axes.chip_from_body(axes.body_from_chip([1, 2, 3])), [1, 2, 3]);
        }
    }

    /// The board is turned by 90° to the right, and the chip on it by 90° to the left.
    #[test]
    fn mountings_of_chip_and_board_combine() {
        let to_right = axes("right", "backward", "down").unwrap();
        let to_left = axes("left", "forward", "down").unwrap();
        assert_eq!(to_left.mounted_on(&to_right), Axes::IDENTITY);
        let up = axes("right", "forward", "up").unwrap();
        assert_eq!(
            up.mounted_on(&to_right).body_from_chip([1, 2, 3]),
            to_right.body_from_chip(up.body_from_chip([1, 2, 3]))
        );
    }

    #[test]
    fn errors_name_the_wrong_axis() {
        for (directions, error) in [
            (
                ["right", "forwards", "up"],
                "imu.axes = forwards: must be one of forward, backward, right, left, down, up (did you mean `forward`?)",
            ),
            (
                ["right", "left", "up"],
                "imu.axes = right, left, up: must be three perpendicular directions: y is parallel to another axis",
            ),
            (
                ["right", "forward", "down"],
                "imu.axes = right, forward, down: must be right-handed, as the axes of every chip are: one direction is wrong",
            ),
        ] {
            let [x, y, z] = directions;
            assert_eq!(axes(x, y, z).unwrap_err().to_string(), error);
        }
    }
}
