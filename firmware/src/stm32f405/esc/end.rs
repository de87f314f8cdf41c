//! The end: after a fault, the stop on all four pads, and again and again.
//!
//! Nothing else of the program runs then. [`Lines::settle`] and [`Lines::send`] put the stop on the pads, whatever state
//! the fault has found timers and DMA in:
//!
//! 1. What is on its way ends: a pulse that is cut reads as another throttle.
//! 2. Timers and DMA are reset. The pads are low, by their pull-downs.
//! 3. The line pauses, so that the ESC tells the stop from what came before, also if that was cut.
//! 4. Timers and DMA are set up as at the start, and the stop goes out.
//!
//! From the fault to the end of the first stop, µs:
//!
//! | | what is on its way, at most | instructions, and two looks | pause | the stop | **sum** | if something hangs |
//! |---|---|---|---|---|---|---|
//! | PWM, 50 to 400 Hz | the longest pulse: 2,000 | 10 | 400 to 600 | 1,000 | **3,610** | 4,730 |
//! | OneShot125 | a period of the timers: 251 | 10 | in the stop's period | a period: 251 | **512** | 1,050 |
//! | DShot300 | 18 bit times of 3⅓: 60 | 10 | 20 to 30 | 18 bit times: 60 | **160** | 310 |
//! | DShot600 | 18 bit times of 1⅔: 30 | 10 | 20 to 30 | 18 bit times: 30 | **100** | 280 |
//!
//! A timer, a stream of DMA, or a pad that something else holds high does not stop this: each wait has so many looks
//! ([`waits`]), a look takes 1 to 1.5 µs ([`look`]), and what has not ended then is reset. So a pad is low when it is
//! reset, or it has been high for longer than full throttle in the board's protocol.
//!
//! The stop goes on until the watchdog resets the board: with PWM by the timers alone, with the others by
//! [`Lines::stop_for_ever`], about once a millisecond.

use cortex_m::asm::delay;
use flight_core::esc::protocol::{Protocol, STOP_US};

use super::Lines;

/// Looks of the end: for the frame or period on its way to end, for all pads to be low, and in the pause.
struct Waits {
    frame: u32,
    pulse: u32,
    pause: u32,
}

/// Each a little longer than what it is for, if a look took its shortest time, 1 µs.
const fn waits(protocol: Protocol) -> Waits {
    match protocol {
        // All four pads are low once in each period, behind the longest pulse. The pause is about what 400 Hz leaves
        // there.
        Protocol::Pwm { .. } => Waits { frame: 0, pulse: 2_080, pause: 400 },
        // The pads fall when the timers stop. The stop begins 126 µs after the timers.
        Protocol::OneShot125 => Waits { frame: 260, pulse: 260, pause: 0 },
        // The pads are low for a quarter of each bit. The pause is longer than six bits: no frame has one in it.
        Protocol::DShot300 | Protocol::DShot600 => Waits { frame: 70, pulse: 70, pause: 20 },
    }
}

/// From one stop to the next after a fault, as `delay` counts: a millisecond at three cycles each, and up to 1.7 at
/// five.
const STOP_PAUSE: u32 = 56_000;

/// Waits from one look to the next: 42 counts of three to five cycles are 0.75 to 1.25 µs, and what is looked at takes
/// a quarter more.
fn look() {
    delay(42);
}

/// Looks at most `looks` times more, until it is so.
fn wait_until(looks: u32, is_so: impl Fn() -> bool) {
    for _ in 0..looks {
        if is_so() {
            return;
        }
        look();
    }
}

impl Lines {
    /// Lets end what is on its way, but not for long, and sets timers, DMA and pads up anew, with their clocks. The next
    /// thing is to send the stop.
    pub fn settle(&self) {
        let pads_low = || self.outputs.pads.iter().all(|pad| pad.pin.is_low());
        let Waits { frame, pulse, pause } = waits(self.protocol);
        wait_until(frame, || !self.busy());
        wait_until(pulse, pads_low);
        self.reset();
        wait_until(pause, || false);
        self.start();
        self.connect_pads();
    }

    /// Gives the pads to the timers, pulled down.
    pub fn connect_pads(&self) {
        self.outputs.pads.iter().for_each(|pad| pad.pin.connect(pad.function));
    }

    /// Takes them from the timers, pulled down.
    pub fn pull_pads_down(&self) {
        self.outputs.pads.iter().for_each(|pad| pad.pin.pull_down());
    }

    /// Goes on sending the stop, which [`Self::settle`] has made way for, until the watchdog resets the
    /// board.
    pub fn stop_for_ever(&self) -> ! {
        loop {
            // What hangs is set up anew.
            let _ = self.send([STOP_US; 4]);
            delay(STOP_PAUSE);
        }
    }
}
