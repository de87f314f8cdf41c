//! `sim-host` at the other end of a link. Each slot is one frame of the link (`hil-link`), and all times are those of
//! the frames.
//!
//! The link is served by an interrupt of the lowest priority that pends itself again after each run. So each of its
//! runs begins when all tasks have finished their work of the previous one:
//!
//! ```text
//!  slot  k                                                      k + 1
//!        begin_slot: the time is that of frame k;               begin_slot ...
//!        its sample, or the lack of one, wakes `control_loop`
//!        │ control_loop: step, pulses, answer
//!        └───► receive: waits for frame k + 1; the time is half a millisecond before that of frame k + 1;
//!              │        wakes `tick`, which starts the slow tasks; they take the frame's inputs
//! ```
//! A damaged or repeated frame is answered with [`ToHost::Bad`] and runs no step. Frames missing in the sequence are
//! counted; the flight controller sees the gap in time.
//!
//! # The watchdog
//! QEMU has none, and a real one would reset the board whenever the host is slow. The replacement has the same
//! period of a second, measured by the frames' time, and the same effect: a reset of the chip, by SYSRESETREQ. The
//! cause is kept in RAM that no start clears.

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
use super::{ARRIVED, last_outputs, now_us, prepare_frame, sample_to_motors, set_now, wake_control_loop};
use crate::interrupts::enable;
use crate::step::Step;

#[cfg_attr(all(feature = "qemu", not(feature = "hil-usart")), path = "semihosting.rs")]
#[cfg_attr(not(all(feature = "qemu", not(feature = "hil-usart"))), path = "usart.rs")]
mod transport;

use transport::Transport;

/// The link and its state.
struct Link {
    transport: Transport,
    decoder: Decoder,
    /// Sequence number of the last frame; the answer repeats it.
    sequence: Option<u32>,
    received: Received,
}

static LINK: Mutex<RefCell<Option<Link>>> = Mutex::new(RefCell::new(None));
static CONFIG: Mutex<Cell<Option<Config>>> = Mutex::new(Cell::new(None));

/// Inputs for the slow tasks.
static RC: Mutex<Cell<Option<RcFrame>>> = Mutex::new(Cell::new(None));
static MAG: Mutex<Cell<Option<MagSample>>> = Mutex::new(Cell::new(None));
static BATTERY: Mutex<Cell<Option<Battery>>> = Mutex::new(Cell::new(None));

impl Link {
    /// Returns the next valid message that is in sequence. Other frames are answered here.
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
            // The first frame of a flight starts the sequence.
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
        // Every message to the host is far shorter than the longest packet.
        if let Ok(length) = encode(self.sequence.unwrap_or(0), message, &mut frame) {
            self.transport.send(&frame[..length]);
        }
    }
}

/// Runs `work` on the link, which [`begin`] has opened.
fn with_link<T>(cs: &CriticalSection, work: impl FnOnce(&mut Link) -> T) -> T {
    match LINK.borrow(cs).borrow_mut().as_mut() {
        Some(link) => work(link),
        None => panic!("the link is not open"),
    }
}

/// Opens the link, announces the board, receives the configuration and the first frame. Returns whether the watchdog
/// caused the last reset.
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
    enable(nvic, SLOT_INTERRUPT, SLOT_PRIORITY);
    NVIC::pend(SLOT_INTERRUPT);
    watchdog_reset
}

/// Returns the configuration of the flight.
pub fn config() -> Config {
    match free(|cs| CONFIG.borrow(cs).get()) {
        Some(config) => config,
        None => panic!("the link has no configuration yet"),
    }
}

/// The interrupt that serves the link. Its vector is that of the floating-point unit, whose own interrupt is never
/// enabled. The vector has the highest number of all vectors of its priority (the priority of `magnetometer`), so it
/// runs last.
const SLOT_INTERRUPT: Interrupt = Interrupt::FPU;
const SLOT_PRIORITY: u8 = 1;

/// Time of the next slot, µs, and whether it has a sample.
static TIME_US: AtomicU32 = AtomicU32::new(0);
static SAMPLED: AtomicBool = AtomicBool::new(false);
/// Whether the slot has begun.
static BEGUN: AtomicBool = AtomicBool::new(false);

#[interrupt]
fn FPU() {
    let arrived = instructions();
    let begun = BEGUN.load(Ordering::Relaxed);
    BEGUN.store(!begun, Ordering::Relaxed);
    NVIC::pend(SLOT_INTERRUPT);
    if begun {
        receive();
    } else {
        begin_slot(arrived);
    }
}

fn begin_slot(arrived: u32) {
    let at_us = TIME_US.load(Ordering::Relaxed);
    set_now(at_us);
    reset_if_watchdog_expired(at_us);
    ARRIVED.store(arrived, Ordering::Relaxed);
    let sampled = SAMPLED.load(Ordering::Relaxed);
    wake_control_loop(if sampled { sampling::ready(at_us, false) } else { sampling::overdue(at_us) });
}

/// Waits for the next frame, and prepares its slot.
fn receive() {
    free(|cs| {
        with_link(cs, |link| {
            let step = loop {
                match link.next() {
                    ToBoard::Step(step) => break step,
                    ToBoard::Start(_) => link.answer(&ToHost::Refused),
                    ToBoard::End => end(),
                }
            };
            let at_us = step.time_us as u32;
            TIME_US.store(at_us, Ordering::Relaxed);
            // The time spent waiting does not count: the tasks only see the frames' times.
            set_now(at_us.wrapping_sub(PERIOD_US / 2));
            SAMPLED.store(step.imu.is_some(), Ordering::Relaxed);
            store_inputs(cs, step.rc, step.mag, step.battery);
            prepare_frame(step.imu.unwrap_or_default());
        });
    });
}

/// Stores inputs for the slow tasks. An input that was not taken yet stays until a newer one replaces it.
fn store_inputs(cs: &CriticalSection, rc: Option<RcFrame>, mag: Option<MagSample>, battery: Option<Battery>) {
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

/// The pilot's frames from the link.
#[derive(Default)]
pub struct RcReceiver(());

impl RcReceiver {
    /// Returns the frame, if one has come.
    pub fn poll(&mut self) -> Option<RcFrame> {
        free(|cs| RC.borrow(cs).take())
    }
}

/// The battery voltages from the link.
#[derive(Default)]
pub struct BatteryAdc(());

impl BatteryAdc {
    /// Returns the voltage, if one has come.
    pub fn measure(&mut self) -> Option<Battery> {
        free(|cs| BATTERY.borrow(cs).take())
    }
}

/// The magnetometer samples from the link.
#[derive(Default)]
pub struct Magnetometer(());

impl Magnetometer {
    /// Returns the sample, if one has come.
    pub fn run(&mut self) -> Option<MagSample> {
        free(|cs| MAG.borrow(cs).take())
    }
}

/// The answers to the host.
#[derive(Default)]
pub struct Monitor(());

impl Monitor {
    /// Answers a step.
    pub fn show(&mut self, step: &Step) {
        let (pulses_us, driven) = last_outputs();
        free(|cs| {
            with_link(cs, |link| {
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

/// Period of the simulated watchdog, µs. It is the period of the real one.
const WATCHDOG_US: u32 = 1_000_000;

/// Time of the watchdog's start or last feed, µs.
static FED_US: AtomicU32 = AtomicU32::new(0);

/// The simulated watchdog.
pub struct Watchdog;

impl Watchdog {
    /// Starts a new period.
    pub fn feed(&mut self) {
        FED_US.store(now_us(), Ordering::Relaxed);
    }
}

/// Resets the chip if the watchdog's period has ended.
fn reset_if_watchdog_expired(at_us: u32) {
    // The first frame starts the watchdog. A feed shortly before the start of a slot may have a later time than the
    // frame.
    static STARTED: AtomicBool = AtomicBool::new(false);
    if !STARTED.load(Ordering::Relaxed) {
        STARTED.store(true, Ordering::Relaxed);
        FED_US.store(at_us, Ordering::Relaxed);
    }
    let since_feed_us = at_us.wrapping_sub(FED_US.load(Ordering::Relaxed)) as i32;
    if since_feed_us > WATCHDOG_US as i32 {
        RESET_MARK.set();
        SCB::sys_reset();
    }
}

/// A word that survives a reset.
struct ResetMark(MaybeUninit<AtomicU32>);

#[unsafe(link_section = ".uninit.reset_mark")]
static RESET_MARK: ResetMark = ResetMark(MaybeUninit::uninit());

impl ResetMark {
    /// The mark of a watchdog reset. The word's random content after power-up is very unlikely to be equal.
    const WATCHDOG: u32 = 0x77a7_c4d0;

    fn word(&self) -> &AtomicU32 {
        // SAFETY: every bit pattern is a valid number.
        unsafe { self.0.assume_init_ref() }
    }

    fn set(&self) {
        self.word().store(Self::WATCHDOG, Ordering::SeqCst);
    }

    fn take(&self) -> bool {
        self.word().swap(0, Ordering::SeqCst) == Self::WATCHDOG
    }
}
