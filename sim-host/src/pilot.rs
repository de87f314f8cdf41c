//! The simulated pilot, who sees the truth 0.2 s late and moves four sticks 50 times per second.
//!
//! The pilot arms with the sticks, or with the arm switch if the vehicle has one, takes off, holds a position, lands
//! and disarms. A *script* moves named sticks at given times. The other sticks follow the base: the pilot who holds the
//! position, or centred sticks for a stand.

use std::collections::VecDeque;

use flight_core::geometry::{Vec3, vec3};
use flight_core::rc::{ArmBy, CENTRE_TICKS, FlightMode, HIGH_TICKS, LOW_TICKS};
use flight_core::sample::{LinkStatus, RcFrame};

use crate::dynamics::{GRAVITY, State};

/// Frames from the transmitter per second.
pub const FRAME_RATE_HZ: f64 = 50.0;

/// Reaction time of the pilot, in frames: 0.2 s.
const REACTION_FRAMES: usize = 10;

/// Stick positions before they become ticks: throttle 0 to 1, the others −1 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sticks {
    throttle: f64,
    roll: f64,
    pitch: f64,
    yaw: f64,
    mode: FlightMode,
}

impl Sticks {
    const LOW: Self = Self { throttle: 0.0, roll: 0.0, pitch: 0.0, yaw: 0.0, mode: FlightMode::Angle };
    const ARM: Self = Self { yaw: 1.0, ..Self::LOW };
    const DISARM: Self = Self { yaw: -1.0, ..Self::LOW };

    /// Converts the positions to the 11-bit ticks of the receiver. `armed` is the position of the arm switch.
    fn to_frame(self, armed: bool) -> RcFrame {
        let ticks = |position: f64, zero: u16, span: u16| {
            let limited = f64::from(zero) + libm::rint(position * f64::from(span));
            limited.clamp(f64::from(LOW_TICKS), f64::from(HIGH_TICKS)) as u16
        };
        let centred = |position| ticks(position, CENTRE_TICKS, HIGH_TICKS - CENTRE_TICKS);
        RcFrame {
            channels: [
                ticks(self.throttle, LOW_TICKS, HIGH_TICKS - LOW_TICKS),
                centred(self.roll),
                centred(self.pitch),
                centred(self.yaw),
            ],
            arm_switch: if armed { HIGH_TICKS } else { LOW_TICKS },
            mode_switch: match self.mode {
                FlightMode::Angle => LOW_TICKS,
                FlightMode::Rate => HIGH_TICKS,
            },
            status: LinkStatus::Good,
        }
    }
}

/// The source of the sticks that a script does not name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Base {
    /// The pilot holds the position above the start.
    Hold,
    /// Roll, pitch and yaw are centred; the throttle has this value from take-off time on.
    Centred {
        /// Throttle, 0 to 1.
        throttle: f64,
    },
}

/// Times and height of a flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Start of the arm gesture, or time at which the arm switch is moved, s.
    pub arm_at_s: f64,
    /// Start of the climb, s; on a stand, time at which the throttle opens.
    pub take_off_at_s: f64,
    /// Height to hold, m.
    pub height_m: f64,
    /// Start of the descent, s before the end of the scene; `None` for no landing.
    pub land_before_end_s: Option<f64>,
}

/// One move of a script: stick positions from a time on, for a duration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// Start, s.
    pub at_s: f64,
    /// Duration, s.
    pub for_s: f64,
    /// Throttle, 0 to 1; `None` if the base determines it.
    pub throttle: Option<f64>,
    /// Roll, −1 (left) to 1 (right); `None` if the base determines it.
    pub roll: Option<f64>,
    /// Pitch, −1 (back, nose up) to 1 (forward, nose down); `None` if the base determines it.
    pub pitch: Option<f64>,
    /// Yaw, −1 (anticlockwise from above) to 1; `None` if the base determines it.
    pub yaw: Option<f64>,
    /// Position of the mode switch. In rate mode, roll, pitch and yaw that are not named are centred, because the base
    /// gives angles, not rates.
    pub mode: FlightMode,
}

/// The task of a pilot.
#[derive(Clone, Debug, PartialEq)]
pub struct PilotScript {
    /// Times and height.
    pub plan: Plan,
    /// Source of the sticks that the script does not name.
    pub base: Base,
    /// Moves.
    pub script: Vec<Move>,
}

/// The pilot's knowledge of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knowledge {
    /// Throttle at which the vehicle hovers, 0 to 1.
    pub hover_throttle: f64,
    /// Tilt at full stick, rad.
    pub max_tilt_rad: f64,
    /// Yaw rate at full stick, rad/s.
    pub max_yaw_rate_rad_s: f64,
    /// Whether the vehicle is armed with the sticks or with a switch.
    pub arm_by: ArmBy,
}

/// Speed of the climb, m/s.
const CLIMB_M_S: f64 = 1.0;
/// Speed of the descent, m/s.
const DESCENT_M_S: f64 = 0.5;
/// Depth below the ground at which the target's descent ends, m. The target is below the ground so that the vehicle
/// settles on it. A height error of 2 m commands 2.8 m/s², because the ground effect adds up to a third of the thrust.
const MAX_DEPTH_M: f64 = 2.0;

/// Duration of the arming gesture, s: the flight code needs 1 s.
const ARM_GESTURE_S: f64 = 1.2;

/// Gain from height error to acceleration, 1/s².
const HEIGHT_P: f64 = 1.4;
/// Gain from climb rate error to acceleration, 1/s. With 0.2 s of reaction time and 0.05 s of motor lag, 2.4/s leaves a
/// phase margin of 50°.
const HEIGHT_D: f64 = 2.4;
/// Gain from the integral of the height error to acceleration, 1/s³. The integral compensates a battery that
/// discharges, a payload, or a downdraught.
const HEIGHT_I: f64 = 0.3;
/// Limit of the integral part, m/s²: a third of the weight.
const MAX_INTEGRAL_M_S2: f64 = 3.0;
/// Gain from position error to acceleration north and east, 1/s². It is lower, because the vehicle has to tilt first
/// (0.25 s more).
const POSITION_P: f64 = 0.5;
/// Gain from velocity to acceleration north and east, 1/s.
const POSITION_D: f64 = 1.2;
/// Gain from the integral of the position error to acceleration, 1/s³. The integral compensates a steady wind or an
/// error of the level attitude.
const POSITION_I: f64 = 0.08;
/// Limit of the tilt for holding a position, rad (20°).
const MAX_HOLD_TILT_RAD: f64 = 0.35;
/// Minimum throttle in flight, as a share of hover.
const MIN_THROTTLE: f64 = 0.12;
/// Gain from heading error to yaw rate, 1/s.
const HEADING_P: f64 = 1.0;

/// The pilot of a flight.
#[derive(Clone, Debug)]
pub struct Pilot {
    plan: Plan,
    base: Base,
    script: Vec<Move>,
    knowledge: Knowledge,
    /// The last [`REACTION_FRAMES`] views, the oldest first.
    views: VecDeque<State>,
    home: Vec3<f64>,
    /// Start of the descent, s.
    land_at_s: Option<f64>,
    /// Integral part of the commanded acceleration, north, east, down, m/s².
    integral: Vec3<f64>,
    landed_at_s: Option<f64>,
}

impl Pilot {
    /// Creates the pilot of a vehicle at `start`, for a flight of this duration.
    pub fn new(flying: &PilotScript, duration_s: f64, knowledge: Knowledge, start: &State) -> Self {
        let PilotScript { plan, base, script } = flying.clone();
        Self {
            plan,
            base,
            script,
            land_at_s: plan.land_before_end_s.map(|before_end_s| duration_s - before_end_s),
            knowledge,
            views: VecDeque::with_capacity(REACTION_FRAMES + 1),
            home: start.position,
            integral: Vec3::ZERO,
            landed_at_s: None,
        }
    }

    /// Returns the target height above the start at time `t_s`, m. It is below zero for a landing, to settle on the
    /// ground.
    fn wanted_height_m(&self, t_s: f64) -> f64 {
        let Plan { take_off_at_s, height_m, .. } = self.plan;
        let climbed = ((t_s - take_off_at_s) * CLIMB_M_S).clamp(0.0, height_m);
        let descended = self.land_at_s.map_or(0.0, |at| ((t_s - at) * DESCENT_M_S).max(0.0));
        (climbed - descended).max(-MAX_DEPTH_M)
    }

    /// Returns the pilot's target at time `t_s`, north, east, down, m.
    pub fn target_m(&self, t_s: f64) -> Vec3<f64> {
        Vec3 { z: self.home.z - self.wanted_height_m(t_s), ..self.home }
    }

    /// Returns the frame that the transmitter sends at time `t_s`, when the vehicle is in `state`.
    pub fn frame(&mut self, t_s: f64, state: &State) -> RcFrame {
        self.views.push_back(*state);
        let view = self.views[0];
        if self.views.len() > REACTION_FRAMES {
            self.views.pop_front();
        }
        let sticks = self.sticks(t_s, &view);
        match self.knowledge.arm_by {
            ArmBy::Sticks => sticks.to_frame(false),
            // At the times of the gestures the pilot moves the switch, and the sticks stay low.
            ArmBy::Switch => {
                let armed = t_s >= self.plan.arm_at_s && sticks != Sticks::DISARM;
                let gesture = sticks == Sticks::ARM || sticks == Sticks::DISARM;
                if gesture { Sticks::LOW } else { sticks }.to_frame(armed)
            }
        }
    }

    fn sticks(&mut self, t_s: f64, view: &State) -> Sticks {
        let Plan { arm_at_s, take_off_at_s, .. } = self.plan;
        if (arm_at_s..arm_at_s + ARM_GESTURE_S).contains(&t_s) {
            return Sticks::ARM;
        }
        if t_s < take_off_at_s {
            return Sticks::LOW;
        }
        if let Some(since) = self.landed_at_s {
            // First the throttle is down, then there is a pause of half a second, then the gesture.
            return if t_s - since > 0.5 { Sticks::DISARM } else { Sticks::LOW };
        }
        if self.land_at_s.is_some_and(|at| t_s > at) && self.is_down(t_s, view) {
            self.landed_at_s = Some(t_s);
            return Sticks::LOW;
        }
        let mut sticks = match self.base {
            Base::Hold => self.hold(t_s, view),
            Base::Centred { throttle } => Sticks { throttle, ..Sticks::LOW },
        };
        for m in self.script.iter().filter(|m| (m.at_s..m.at_s + m.for_s).contains(&t_s)) {
            if m.mode == FlightMode::Rate {
                sticks = Sticks { throttle: sticks.throttle, mode: m.mode, ..Sticks::LOW };
            }
            sticks.throttle = m.throttle.unwrap_or(sticks.throttle);
            sticks.roll = m.roll.unwrap_or(sticks.roll);
            sticks.pitch = m.pitch.unwrap_or(sticks.pitch);
            sticks.yaw = m.yaw.unwrap_or(sticks.yaw);
        }
        sticks
    }

    /// Returns true if the pilot sees the vehicle on the ground, even if it slides in the wind; on a stand, always.
    fn is_down(&self, t_s: f64, view: &State) -> bool {
        match self.base {
            Base::Centred { .. } => true,
            Base::Hold => {
                // Four seconds after the planned landing, the vehicle may be on two feet, tilted into the wind, or held
                // up by the ground effect. The pilot then closes the throttle, and the vehicle drops the rest.
                let overdue = self.wanted_height_m(t_s) <= -MAX_DEPTH_M;
                let height_m = if overdue { 0.1 } else { 0.03 };
                self.target_m(t_s).z > self.home.z
                    && view.position.z > self.home.z - height_m
                    && view.velocity.z.abs() < 0.1
            }
        }
    }

    fn hold(&mut self, t_s: f64, view: &State) -> Sticks {
        let error = self.target_m(t_s) - view.position;
        // Do not integrate on the ground, where the legs hold the vehicle.
        if view.position.z < self.home.z - 0.2 {
            let limit = |a: f64| a.clamp(-MAX_INTEGRAL_M_S2, MAX_INTEGRAL_M_S2);
            let Vec3 { x, y, z } = self.integral
                + error.scale_by(vec3(POSITION_I, POSITION_I, HEIGHT_I)) * (1.0 / FRAME_RATE_HZ);
            self.integral = vec3(limit(x), limit(y), limit(z));
        }
        let climb = self.target_rate_m_s(t_s) - view.velocity.z;
        let wanted_z = HEIGHT_P * error.z + HEIGHT_D * climb + self.integral.z;
        let level = Vec3 { z: 0.0, ..error };
        let a = level * POSITION_P - view.velocity * POSITION_D + self.integral;
        // Forward and right of the vehicle, as the pilot sees it.
        let nose = view.attitude.rotate(Vec3::X);
        let length = libm::sqrt(nose.x * nose.x + nose.y * nose.y).max(1e-6);
        let (cos_yaw, sin_yaw) = (nose.x / length, nose.y / length);
        let forward = cos_yaw * a.x + sin_yaw * a.y;
        let right = cos_yaw * a.y - sin_yaw * a.x;

        let Knowledge { hover_throttle, max_tilt_rad, max_yaw_rate_rad_s, .. } = self.knowledge;
        let tilt = |acceleration: f64| {
            (acceleration / GRAVITY).clamp(-MAX_HOLD_TILT_RAD, MAX_HOLD_TILT_RAD) / max_tilt_rad
        };
        let heading = libm::atan2(sin_yaw, cos_yaw);
        let yaw = -HEADING_P * heading / max_yaw_rate_rad_s;
        Sticks {
            throttle: (hover_throttle * (1.0 - wanted_z / GRAVITY)).clamp(MIN_THROTTLE * hover_throttle, 1.0),
            roll: tilt(right),
            pitch: tilt(forward),
            // The flight code holds the heading; the pilot only corrects a visible error.
            yaw: if heading.abs() > 0.05 { yaw.clamp(-0.3, 0.3) } else { 0.0 },
            mode: FlightMode::Angle,
        }
    }

    /// Returns the vertical speed of the target, m/s, down.
    fn target_rate_m_s(&self, t_s: f64) -> f64 {
        (self.target_m(t_s + 0.5 / FRAME_RATE_HZ) - self.target_m(t_s - 0.5 / FRAME_RATE_HZ)).z
            * FRAME_RATE_HZ
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flight_core::geometry::Quaternion;

    const KNOWLEDGE: Knowledge = Knowledge {
        hover_throttle: 0.5,
        max_tilt_rad: 0.785,
        max_yaw_rate_rad_s: 1.57,
        arm_by: ArmBy::Sticks,
    };
    const PLAN: Plan = Plan { arm_at_s: 1.0, take_off_at_s: 3.0, height_m: 2.0, land_before_end_s: None };

    fn hold() -> PilotScript {
        PilotScript { plan: PLAN, base: Base::Hold, script: vec![] }
    }

    fn at(position: Vec3<f64>) -> State {
        State { position, velocity: Vec3::ZERO, attitude: Quaternion::IDENTITY, rates: Vec3::ZERO }
    }

    #[test]
    fn pilot_arms_with_the_sticks_before_take_off() {
        let ground = at(vec3(0.0, 0.0, -0.05));
        let mut pilot = Pilot::new(&hold(), 60.0, KNOWLEDGE, &ground);
        assert_eq!(pilot.frame(0.0, &ground).channels, [172, 992, 992, 992]);
        assert_eq!(pilot.frame(1.5, &ground).channels, [172, 992, 992, 1811]);
        assert_eq!(pilot.frame(2.5, &ground).channels, [172, 992, 992, 992]);
        assert!(pilot.frame(4.0, &ground).channels[0] > 992);
    }

    #[test]
    fn pilot_moves_the_switch_of_a_vehicle_that_has_one() {
        let ground = at(vec3(0.0, 0.0, -0.05));
        let plan = Plan { land_before_end_s: Some(20.0), ..PLAN };
        let with_switch = Knowledge { arm_by: ArmBy::Switch, ..KNOWLEDGE };
        let mut pilot = Pilot::new(&PilotScript { plan, ..hold() }, 60.0, with_switch, &ground);
        let mut sent = |t_s| {
            let frame = pilot.frame(t_s, &ground);
            (frame.arm_switch, frame.channels[0] == LOW_TICKS, frame.channels[3])
        };
        assert_eq!(sent(0.5), (LOW_TICKS, true, CENTRE_TICKS));
        assert_eq!(sent(1.0), (HIGH_TICKS, true, CENTRE_TICKS));
        assert_eq!(sent(10.0), (HIGH_TICKS, false, CENTRE_TICKS));
        // The pilot sees the vehicle on the ground, and half a second later switches it off.
        assert_eq!(sent(50.0), (HIGH_TICKS, true, CENTRE_TICKS));
        assert_eq!(sent(50.6), (LOW_TICKS, true, CENTRE_TICKS));
    }

    #[test]
    fn pilot_steers_to_the_target_after_reaction_time() {
        let start = at(vec3(0.0, 0.0, -0.05));
        let mut pilot = Pilot::new(&hold(), 60.0, KNOWLEDGE, &start);
        let home = at(vec3(0.0, 0.0, -2.05));
        let off = at(vec3(1.0, 1.0, -2.05));
        for _ in 0..=REACTION_FRAMES {
            pilot.frame(10.0, &home);
        }
        for late in 0..REACTION_FRAMES {
            assert_eq!(pilot.frame(10.0, &off).channels[1], 992, "{late} frames late");
        }
        // The vehicle is north and east of the target, so the pilot rolls left and pulls the pitch stick back.
        let [_, roll, pitch, _] = pilot.frame(10.0, &off).channels;
        assert!(roll < 992 && pitch < 992);
    }

    #[test]
    fn overdue_landing_closes_the_throttle() {
        let start = at(vec3(0.0, 0.0, -0.05));
        let plan = Plan { land_before_end_s: Some(20.0), ..PLAN };
        let mut pilot = Pilot::new(&PilotScript { plan, ..hold() }, 60.0, KNOWLEDGE, &start);
        // The vehicle is on two feet, 5 cm up. The descent from 2 m starts at 40 s, so the target is on the ground from
        // 44 s on.
        let leaning = at(vec3(0.0, 0.0, -0.1));
        for (t_s, holds) in [(43.0, true), (47.9, true), (48.1, false), (50.0, false)] {
            for _ in 0..=REACTION_FRAMES {
                pilot.frame(t_s, &leaning);
            }
            assert_eq!(pilot.frame(t_s, &leaning).channels[0] > LOW_TICKS, holds, "{t_s} s");
        }
    }

    #[test]
    fn script_moves_only_the_sticks_it_names() {
        let start = at(Vec3::ZERO);
        let script = vec![Move {
            at_s: 5.0,
            for_s: 2.0,
            throttle: None,
            roll: Some(2.0 / 3.0),
            pitch: None,
            yaw: None,
            mode: FlightMode::Angle,
        }];
        let flying = PilotScript { base: Base::Centred { throttle: 0.5 }, script, ..hold() };
        let mut pilot = Pilot::new(&flying, 60.0, KNOWLEDGE, &start);
        assert_eq!(pilot.frame(4.98, &start).channels, [992, 992, 992, 992]);
        assert_eq!(pilot.frame(5.0, &start).channels, [992, 1538, 992, 992]);
        assert_eq!(pilot.frame(7.0, &start).channels[1], 992);
    }
}
