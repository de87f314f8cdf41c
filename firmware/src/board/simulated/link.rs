//! `sim-host` at the other end of a link: each slot is a frame of it (`hil-link`), and all time is that of the
//! frames.
//!
//! The world turns in an interrupt that has the lowest priority of all and always comes again, so that each turn
//! begins when every task is done with the one before:
//!
//! ```text
//!  slot  k                                                      k + 1
//!        begin: it is the time of frame k;                      begin ...
//!        its sample, or its lack of one, wakes `flight`
//!        │ flight: step, pulses, answer
//!        └───► await: waits for frame k + 1; it is half a millisecond before its time;
//!              │      wakes `tick`, and that the slow tasks, which take what the frame brings
//! ```
//! A frame that is damaged, or comes again, is answered with [`ToHost::Bad`] and steps nothing. One that is missing
//! in the sequence is counted; the flight controller notices it by the time that it did not see.
//!
//! # The watchdog
//! The emulator has none, and a real one would bite whenever the host takes its time. Its stand-in has the same second,
//! by the frames' time, and the same end: a reset of the chip, by SYSRESETREQ. What has caused it is kept in RAM that
//! no start clears.

use core::cell::{Cell, RefCell};
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::interrupt::{CriticalSection, Mutex, free};
use cortex_m::peripheral::{NVIC, SCB};
use flight_core::sample::{Battery, MagSample, RcFrame};
use flight_core::{Config, FlightController};
use hil_link::{Decoder, Done, MAX_FRAME, Order, Received, Started, ToBoard, ToHost, encode};
use stm32f4xx_hal::pac::{Interrupt, interrupt};
use tasks::{PERIOD_US, sampling};

use super::chip::{end, instructions};
use super::{CAME, now_us, play, sample_to_motors, sent, set_now, wake_flight};
use crate::interrupts::enable;
use crate::step::Step;

#[cfg_attr(all(feature = "qemu", not(feature = "hil-usart")), path = "semihosting.rs")]
#[cfg_attr(not(all(feature = "qemu", not(feature = "hil-usart"))), path = "usart.rs")]
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
pub fn begin(nvic: &mut NVIC) -> bool {
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
    enable(nvic, TURN, TURN_PRIORITY);
    NVIC::pend(TURN);
    watchdog_reset
}

/// What the flight is flown with.
pub fn config() -> Config {
    match free(|cs| CONFIG.borrow(cs).get()) {
        Some(config) => config,
        None => panic!("the link has not begun"),
    }
}

/// The interrupt in which the world turns: one that the chip's floating-point unit raises only if it is asked to, and
/// nobody does. Of all that have its priority, `magnetometer` among them, it has the highest number, and so comes last.
const TURN: Interrupt = Interrupt::FPU;
const TURN_PRIORITY: u8 = 1;

/// The slot that comes next: its time, and whether it has a sample.
static TIME_US: AtomicU32 = AtomicU32::new(0);
static SAMPLED: AtomicBool = AtomicBool::new(false);
/// The slot has begun.
static BEGUN: AtomicBool = AtomicBool::new(false);

#[interrupt]
fn FPU() {
    let came = instructions();
    let begun = BEGUN.load(Ordering::Relaxed);
    BEGUN.store(!begun, Ordering::Relaxed);
    NVIC::pend(TURN);
    if begun {
        receive();
    } else {
        begin_slot(came);
    }
}

fn begin_slot(came: u32) {
    let at_us = TIME_US.load(Ordering::Relaxed);
    set_now(at_us);
    bite_if_hungry(at_us);
    CAME.store(came, Ordering::Relaxed);
    let sampled = SAMPLED.load(Ordering::Relaxed);
    wake_flight(if sampled { sampling::ready(at_us, false) } else { sampling::overdue(at_us) });
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
            let at_us = step.time_us as u32;
            TIME_US.store(at_us, Ordering::Relaxed);
            // However long it was waited for: the tasks know no time but that of the frames.
            set_now(at_us.wrapping_sub(PERIOD_US / 2));
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

/// The pilot's frames.
#[derive(Default)]
pub struct RcReceiver(());

impl RcReceiver {
    /// The frame, if one has come.
    pub fn poll(&mut self) -> Option<RcFrame> {
        free(|cs| RC.borrow(cs).take())
    }
}

/// The battery.
#[derive(Default)]
pub struct BatteryAdc(());

impl BatteryAdc {
    /// The reading, if one has come.
    pub fn measure(&mut self) -> Option<Battery> {
        free(|cs| BATTERY.borrow(cs).take())
    }
}

/// The magnetometer.
#[derive(Default)]
pub struct Magnetometer(());

impl Magnetometer {
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
