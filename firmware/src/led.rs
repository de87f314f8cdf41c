//! The board's LED.
//!
//! | LED | meaning |
//! |---|---|
//! | fast blink (5 Hz) | no IMU samples |
//! | on | the motors turn, or may turn |
//! | slow blink (1 Hz) | terminated: disarm first |
//! | one short flash a second | disarmed, or another state on the ground |

use flight_core::ArmState;
use stm32f4xx_hal::gpio::{AnyPin, Output, PinState};

use crate::step::Step;

/// The LED, if the board has one.
pub struct Led {
    pin: Option<AnyPin<Output>>,
    on_level: PinState,
    steps: u32,
}

impl Led {
    /// Returns the LED on `pin`, which lights at the level `on_level`.
    pub fn new(pin: Option<AnyPin<Output>>, on_level: PinState) -> Self {
        Self { pin, on_level, steps: 0 }
    }

    /// Shows the state after a step.
    #[inline]
    pub fn show(&mut self, step: &Step) {
        self.steps = self.steps.wrapping_add(1);
        let lit = if !step.sampled {
            self.steps % 200 < 100
        } else if step.state == ArmState::Terminated {
            self.steps % 1_000 < 500
        } else {
            step.state.flies() || self.steps % 1_000 < 50
        };
        if let Some(pin) = &mut self.pin {
            pin.set_state(if lit { self.on_level } else { !self.on_level });
        }
    }
}
