//! What the board's light says.
//!
//! | light | meaning |
//! |---|---|
//! | fast blink (5 Hz) | no inertial samples |
//! | lit | the motors turn, or may |
//! | slow blink (1 Hz) | terminated: disarm first |
//! | a short flash a second | disarmed, or in a state on the ground |

use flight_core::ArmState;
use stm32f4xx_hal::gpio::{AnyPin, Output, PinState};

use crate::step::Step;

/// The light, if the board has one.
pub struct Light {
    pin: Option<AnyPin<Output>>,
    lit: PinState,
    steps: u32,
}

impl Light {
    /// A light that is lit by the level `lit`.
    pub fn new(pin: Option<AnyPin<Output>>, lit: PinState) -> Self {
        Self { pin, lit, steps: 0 }
    }

    /// Shows a step.
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
            pin.set_state(if lit { self.lit } else { !self.lit });
        }
    }
}
