//! `sim-host` at the other end of a link: each slot is a frame of it (`hil-link`), and all time is that of the
//! frames.
//!
//! ```text
//!  tick, in the middle of a slot     waits for the next frame; the slow tasks take what it brings
//!  tick, at the slot's start         the frame's time begins; its sample, or its lack of one, wakes `flight`
//!  `flight`, at its end              the answer
//! ```
//! Who waits for a frame does so in the interrupt, and nothing else runs. A frame that is damaged, or comes again, is
//! answered with [`ToHost::Bad`] and steps nothing. One that is missing in the sequence is counted; the flight
//! controller notices it by the time that it did not see.
//!
//! # The watchdog
//! The emulator has none. Its stand-in has the same second as the real one, by the frames' time, and the same end: a
//! reset of the chip, by SYSRESETREQ. What has caused it is kept in RAM that no start clears.

use core::cell::{Cell, RefCell};
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::interrupt::{CriticalSection, Mutex, free};
use cortex_m::peripheral::{NVIC, SCB};
use cortex_m_semihosting::debug::{self, EXIT_SUCCESS};
use flight_core::sample::{Battery, MagSample, RcFrame};
use flight_core::{Config, FlightController};
use hil_link::{Decoder, Done, MAX_FRAME, Order, Received, Started, ToBoard, ToHost, encode};

use super::{BEGAN_US, CAME, now_us, play, sample_to_motors, sent};
use crate::board::{Step, WAKE_FLIGHT};
use crate::sampling;

#[cfg(not(feature = "hil-usart"))]
#[path = "semihosting.rs"]
mod transport;
#[cfg(feature = "hil-usart")]
#[path = "usart.rs"]
mod transport;

use transport::Transport;

/// The link, and where it stands.
struct Link {
    transport: Transport,
    decoder: Decoder,
    /// Number of the last frame, which the answer takes.
    sequence: Option<u32>,
    received: Received,
}

static LINK: Mutex<RefCell<Option<Link>>> = Mutex::new(RefCell::new(None));
static CONFIG: Mutex<Cell<Option<Config>>> = Mutex::new(Cell::new(None));

/// What the slow tasks find, each at its turn.
static RC: Mutex<Cell<Option<RcFrame>>> = Mutex::new(Cell::new(None));
static MAG: Mutex<Cell<Option<MagSample>>> = Mutex::new(Cell::new(None));
static BATTERY: Mutex<Cell<Option<Battery>>> = Mutex::new(Cell::new(None));

impl Link {
    /// The next message that is in order. What is not is answered, and told to nobody.
    fn next(&mut self) -> ToBoard {
        loop {
            let found = self.transport.receive(|byte| {
                self.decoder.push(byte).map(|packet| {
                    let packet = packet.ok()?;
                    Some((packet.sequence, packet.message::<ToBoard>()?))
                })
            });
            let Some((sequence, message)) = found else {
                self.received.corrupt = self.received.corrupt.wrapping_add(1);
                self.answer(&ToHost::Bad(self.received));
                continue;
            };
            // The first frame of a flight begins the count.
            let order = self.sequence.map_or(Order::Next, |last| Order::of(sequence, Some(last)));
            match order {
                Order::Next => {}
                Order::Lost(frames) => self.received.lost = self.received.lost.wrapping_add(frames),
                Order::Repeated => {
                    self.received.repeated = self.received.repeated.wrapping_add(1);
                    self.answer(&ToHost::Bad(self.received));
                    continue;
                }
            }
            self.sequence = Some(sequence);
            return message;
        }
    }

    fn answer(&mut self, message: &ToHost) {
        let mut frame = [0; MAX_FRAME];
        // Every message to the host is far shorter than a packet can be.
        if let Ok(length) = encode(self.sequence.unwrap_or(0), message, &mut frame) {
            self.transport.send(&frame[..length]);
        }
    }
}

/// Runs `work` on the link, which `begin` has opened.
fn with<T>(cs: &CriticalSection, work: impl FnOnce(&mut Link) -> T) -> T {
    match LINK.borrow(cs).borrow_mut().as_mut() {
        Some(link) => work(link),
        None => panic!("the link is not open"),
    }
}

/// Says that the board is there, learns what to be, and takes the first frame. Returns whether the watchdog has
/// brought it here.
pub fn begin() -> bool {
    let watchdog_reset = RESET_MARK.take();
    free(|cs| {
        let mut link = Link {
            transport: Transport::open(),
            decoder: Decoder::default(),
            sequence: None,
            received: Received::default(),
        };
        link.answer(&ToHost::Ready(Started { watchdog_reset }));
        loop {
            match link.next() {
                ToBoard::Start(config) if FlightController::new(&config).is_ok() => {
                    CONFIG.borrow(cs).set(Some(config));
                    break link.answer(&ToHost::Started);
                }
                ToBoard::Start(_) => link.answer(&ToHost::Refused),
                ToBoard::Step(_) => link.answer(&ToHost::Ready(Started { watchdog_reset })),
                ToBoard::End => end(),
            }
        }
        LINK.borrow(cs).replace(Some(link));
    });
    receive();
    watchdog_reset
}

/// What the flight is flown with.
pub fn config() -> Config {
    match free(|cs| CONFIG.borrow(cs).get()) {
        Some(config) => config,
        None => panic!("the link has not begun"),
    }
}

/// The slot that comes next: its time, and whether it has a sample.
static TIME_US: AtomicU32 = AtomicU32::new(0);
static SAMPLED: AtomicBool = AtomicBool::new(false);
/// The slot has begun.
static BEGUN: AtomicBool = AtomicBool::new(false);

/// Half a period has passed, at the instruction `came`.
pub fn tick(came: u32) {
    let begun = BEGUN.load(Ordering::Relaxed);
    BEGUN.store(!begun, Ordering::Relaxed);
    if begun {
        receive();
        return;
    }
    let at_us = TIME_US.load(Ordering::Relaxed);
    // From here on it is the frame's time.
    let ahead_us = now_us().wrapping_sub(at_us);
    BEGAN_US.store(BEGAN_US.load(Ordering::Relaxed).wrapping_add(ahead_us), Ordering::Relaxed);
    bite_if_hungry(at_us);
    CAME.store(came, Ordering::Relaxed);
    if SAMPLED.load(Ordering::Relaxed) {
        sampling::ready(at_us, false);
    } else {
        sampling::overdue(at_us);
    }
    NVIC::pend(WAKE_FLIGHT);
}

/// Waits for the next frame, and lays out what it brings.
fn receive() {
    free(|cs| {
        with(cs, |link| {
            let step = loop {
                match link.next() {
                    ToBoard::Step(step) => break step,
                    ToBoard::Start(_) => link.answer(&ToHost::Refused),
                    ToBoard::End => end(),
                }
            };
            TIME_US.store(step.time_us as u32, Ordering::Relaxed);
            SAMPLED.store(step.imu.is_some(), Ordering::Relaxed);
            for_the_tasks(cs, step.rc, step.mag, step.battery);
            play(step.imu.unwrap_or_default());
        });
    });
}

/// What is there already stays until it is taken, or something newer comes.
fn for_the_tasks(
    cs: &CriticalSection,
    rc: Option<RcFrame>,
    mag: Option<MagSample>,
    battery: Option<Battery>,
) {
    if rc.is_some() {
        RC.borrow(cs).set(rc);
    }
    if mag.is_some() {
        MAG.borrow(cs).set(mag);
    }
    if battery.is_some() {
        BATTERY.borrow(cs).set(battery);
    }
}

/// The flight is over.
fn end() -> ! {
    loop {
        debug::exit(EXIT_SUCCESS);
    }
}

/// The pilot's frames.
#[derive(Default)]
pub struct Radio(());

impl Radio {
    /// The frame, if one has come.
    pub fn poll(&mut self) -> Option<RcFrame> {
        free(|cs| RC.borrow(cs).take())
    }
}

/// The battery.
#[derive(Default)]
pub struct Supply(());

impl Supply {
    /// The reading, if one has come.
    pub fn measure(&mut self) -> Option<Battery> {
        free(|cs| BATTERY.borrow(cs).take())
    }
}

/// The magnetometer.
#[derive(Default)]
pub struct Compass(());

impl Compass {
    /// The sample, if one has come.
    pub fn run(&mut self) -> Option<MagSample> {
        free(|cs| MAG.borrow(cs).take())
    }
}

/// The answers.
#[derive(Default)]
pub struct Monitor(());

impl Monitor {
    /// Answers a step.
    pub fn show(&mut self, step: &Step) {
        let (pulses_us, driven) = sent();
        free(|cs| {
            with(cs, |link| {
                let done = Done {
                    time_us: step.time_us,
                    state: step.state,
                    event: step.event,
                    driven,
                    pulses_us,
                    attitude: step.attitude.to_array(),
                    instructions: if step.sampled { sample_to_motors() } else { 0 },
                    missed_deadlines: step.missed_deadlines,
                    received: link.received,
                };
                link.answer(&ToHost::Done(done));
            });
        });
    }
}

/// The real one's time, µs.
const WATCHDOG_US: u32 = 1_000_000;

/// When it was last fed, or started.
static FED_US: AtomicU32 = AtomicU32::new(0);

/// The stand-in of the watchdog.
pub struct Watchdog;

impl Watchdog {
    /// Another second.
    pub fn feed(&mut self) {
        FED_US.store(now_us(), Ordering::Relaxed);
    }
}

/// Resets the chip if nobody has fed the watchdog for its time.
fn bite_if_hungry(at_us: u32) {
    // The first frame starts it. Who feeds it a moment before a slot's start may be ahead of the frame's time.
    static STARTED: AtomicBool = AtomicBool::new(false);
    if !STARTED.load(Ordering::Relaxed) {
        STARTED.store(true, Ordering::Relaxed);
        FED_US.store(at_us, Ordering::Relaxed);
    }
    let hungry_us = at_us.wrapping_sub(FED_US.load(Ordering::Relaxed)) as i32;
    if hungry_us > WATCHDOG_US as i32 {
        RESET_MARK.set();
        SCB::sys_reset();
    }
}

/// A word that outlives a reset.
struct ResetMark(MaybeUninit<AtomicU32>);

#[unsafe(link_section = ".uninit.reset_mark")]
static RESET_MARK: ResetMark = ResetMark(MaybeUninit::uninit());

impl ResetMark {
    /// Whatever else is in the word after power-up, it is hardly this.
    const WATCHDOG: u32 = 0x77a7_c4d0;

    fn word(&self) -> &AtomicU32 {
        // SAFETY: any bits are a number.
        unsafe { self.0.assume_init_ref() }
    }

    fn set(&self) {
        self.word().store(Self::WATCHDOG, Ordering::SeqCst);
    }

    fn take(&self) -> bool {
        self.word().swap(0, Ordering::SeqCst) == Self::WATCHDOG
    }
}
