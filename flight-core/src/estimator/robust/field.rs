//! Model of the magnetic field: its means, how far it deviates from them, and the field of the sensor itself.

use crate::arithmetic::{max, min};
use crate::geometry::{Vec3, vec3};

/// Averaging time of the horizontal and vertical part of the field, s.
const MEAN_S: f32 = 20.0;
/// Minimum age of these means after the first sample, which covers no time, s.
const MIN_AGE_S: f32 = 1.0e-3;
/// Deviation of the field from its means, as a share of its strength, at which a sample has half its weight, and the
/// time over which the square of the deviation is averaged, s. A magnet that turns with the sensor often passes
/// through the field of the Earth for a moment.
const TOLERANCE: f32 = 0.06;
const DEVIATION_S: f32 = 0.25;
/// Time after which a deviating field is accepted as the new one, s.
const NEW_FIELD_S: f32 = 60.0;
/// Time constant of the estimate of the field of the sensor itself, s.
const OFFSET_S: f32 = 30.0;
/// Largest estimate per axis, µT: a fifth of the Earth's field. A larger offset needs a calibration.
const MAX_OFFSET: f32 = 10.0;

/// See the module documentation.
#[derive(Clone, Copy, Debug, Default)]
pub struct MagneticField {
    /// Means of the horizontal and vertical part of the field, µT, and their age, s, counted up to [`MEAN_S`].
    level: f32,
    vertical: f32,
    age_s: f32,
    /// Low-passed square of the deviation, as a share of the squared strength.
    deviation: f32,
    /// Time for which the field has deviated, s.
    deviating_s: f32,
    /// Field of the sensor itself, µT, body axes.
    pub offset: Vec3<f32>,
}

impl MagneticField {
    /// Updates the means with the horizontal and vertical part of a field, µT, after `dt_s` (s). Returns the weight of
    /// the sample, 0 to 1, and the deviations of both parts from the means before, µT. With `settling` all samples
    /// have full weight: while the tilt settles, its changes alter the parts of the field.
    #[inline(always)]
    pub fn update(&mut self, level: f32, vertical: f32, settling: bool, dt_s: f32) -> (f32, [f32; 2]) {
        let mut weight = 1.0;
        if self.age_s > 0.0 && !settling {
            let (level_off, vertical_off) = (level - self.level, vertical - self.vertical);
            let strength = self.level * self.level + self.vertical * self.vertical;
            let off = min((level_off * level_off + vertical_off * vertical_off) / max(strength, 1.0), 1.0);
            self.deviation += (off - self.deviation) * (dt_s / (DEVIATION_S + dt_s));
            let relative = self.deviation * (1.0 / (TOLERANCE * TOLERANCE));
            weight = 1.0 / (1.0 + relative * relative);
            self.deviating_s = if weight < 0.5 { self.deviating_s + dt_s } else { 0.0 };
            if self.deviating_s >= NEW_FIELD_S {
                self.age_s = 0.0;
                self.deviation = 0.0;
                self.deviating_s = 0.0;
            }
        }
        if self.age_s == 0.0 {
            (self.level, self.vertical) = (level, vertical);
        }
        self.age_s = min(max(self.age_s + dt_s, MIN_AGE_S), MEAN_S);
        let off = [level - self.level, vertical - self.vertical];
        let share = min(weight * dt_s / self.age_s, 1.0);
        self.level += share * off[0];
        self.vertical += share * off[1];
        (weight, off)
    }

    /// Returns the means of the horizontal and vertical part, µT, and the time of the present deviation, s.
    #[cfg(test)]
    pub fn means(&self) -> [f32; 3] {
        [self.level, self.vertical, self.deviating_s]
    }

    /// Moves the estimate of the field of the sensor by a share of `residual` (µT, body axes): the part of the field
    /// that is not constant in the world.
    #[inline(always)]
    pub fn learn_offset(&mut self, residual: Vec3<f32>, weighted_dt_s: f32) {
        let learnt = self.offset + residual * (weighted_dt_s / OFFSET_S);
        let within = |o: f32| max(min(o, MAX_OFFSET), -MAX_OFFSET);
        self.offset = vec3(within(learnt.x), within(learnt.y), within(learnt.z));
    }
}
