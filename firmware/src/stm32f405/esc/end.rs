//! The outputs after a fault: the stop pulse on all four pads, repeated until the reset.
//!
//! No other part of the program runs then. [`Lines::finish_and_restart`] and [`Lines::send`] put the stop on the pads,
//! in any state of timers and DMA after the fault:
//!
//! 1. A pulse or frame that is being sent is finished, because a cut pulse would be another throttle value.
//! 2. Timers and DMA are reset. The pads are low, by their pull-downs.
//! 3. The line pauses, so that the ESC can separate the stop from what came before, even if that was cut.
//! 4. Timers and DMA are set up as at the start, and the stop is sent.
//!
//! Time from the fault to the end of the first stop, µs:
//!
//! | | pulse or frame being sent, at most | instructions, and two polls | pause | the stop | **sum** | if a peripheral hangs |
//! |---|---|---|---|---|---|---|
//! | PWM, 50 to 400 Hz | the longest pulse: 2,000 | 10 | 400 to 600 | 1,000 | **3,610** | 4,730 |
//! | OneShot125 | a period of the timers: 251 | 10 | in the stop's period | a period: 251 | **512** | 1,050 |
//! | DShot300 | 18 bit times of 3⅓: 60 | 10 | 20 to 30 | 18 bit times: 60 | **160** | 310 |
//! | DShot600 | 18 bit times of 1⅔: 30 | 10 | 20 to 30 | 18 bit times: 30 | **100** | 280 |
//!
//! A hanging timer, a hanging DMA stream, or a pad held high from outside does not prevent the stop: each wait has a
//! limited number of polls ([`waits`]), a poll takes 1 to 1.5 µs ([`poll_delay`]), and after that the peripheral is
//! reset. So at the reset a pad is low, or it has been high for longer than full throttle in the board's protocol.
//!
//! The stop is repeated until the watchdog resets the board: with PWM by the timers alone, with the other protocols by
//! [`Lines::send_stop_forever`], about once a millisecond.

use cortex_m::asm::delay;
use flight_core::esc::protocol::{Protocol, STOP_US};

use super::Lines;

/// Numbers of polls: until the current frame or period ends, until all pads are low, and for the pause.
struct Waits {
    frame: u32,
    pulse: u32,
    pause: u32,
}

/// Returns each number a little above what is needed, for polls of the shortest time, 1 µs.
const fn waits(protocol: Protocol) -> Waits {
    match protocol {
        // All four pads are low once in each period, after the longest pulse. The pause is about the time that 400 Hz
        // leaves there.
        Protocol::Pwm { .. } => Waits { frame: 0, pulse: 2_080, pause: 400 },
        // The pads fall when the timers stop. The stop pulse begins 126 µs after the timers.
        Protocol::OneShot125 => Waits { frame: 260, pulse: 260, pause: 0 },
        // The pads are low for a quarter of each bit. The pause is longer than six bits, so the pads are never low for
        // as long within a frame.
        Protocol::DShot300 | Protocol::DShot600 => Waits { frame: 70, pulse: 70, pause: 20 },
    }
}

/// Time between two stops after a fault, counts of `delay`: 1 ms at three cycles each, and up to 1.7 ms at five.
const STOP_PAUSE: u32 = 56_000;

/// Waits between two polls: 42 counts of three to five cycles are 0.75 to 1.25 µs; the polled registers add a quarter.
fn poll_delay() {
    delay(42);
}

/// Waits until `condition` is true, for at most `polls` polls.
fn wait_until(polls: u32, condition: impl Fn() -> bool) {
    for _ in 0..polls {
        if condition() {
            return;
        }
        poll_delay();
    }
}

impl Lines {
    /// Waits a limited time until the current pulse or frame is finished, and sets up timers, DMA and pads again, with
    /// their clocks. The stop must be sent next.
    pub fn finish_and_restart(&self) {
        let pads_low = || self.outputs.pads.iter().all(|pad| pad.pin.is_low());
        let Waits { frame, pulse, pause } = waits(self.protocol);
        wait_until(frame, || !self.busy());
        wait_until(pulse, pads_low);
        self.reset();
        wait_until(pause, || false);
        self.start();
        self.connect_pads();
    }

    /// Connects the pads to the timers, pulled down.
    pub fn connect_pads(&self) {
        self.outputs.pads.iter().for_each(|pad| pad.pin.connect(pad.function));
    }

    /// Disconnects the pads from the timers, pulled down.
    pub fn pull_pads_down(&self) {
        self.outputs.pads.iter().for_each(|pad| pad.pin.pull_down());
    }

    /// Repeats the stop until the watchdog resets the board. [`Self::finish_and_restart`] must have been called before.
    pub fn send_stop_forever(&self) -> ! {
        loop {
            // `send` restarts outputs that hang.
            let _ = self.send([STOP_US; 4]);
            delay(STOP_PAUSE);
        }
    }
}
