//! The flight board's path from the data-ready line to a sample (`tasks::sampling`), with the IMU that
//! `sim-host` simulates, and a DMA whose interrupt is a level, as on the chip.

use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::sync::{Mutex, MutexGuard, PoisonError};

use drivers::icm42688p::{BURST_READ, FRAME_LEN, Frame, Progress, Setup};
use embedded_hal::spi::SpiDevice;
use flight_core::sample::ImuSample;
use proptest::prelude::*;
use sim_host::chips::icm42688p::Icm42688p;
use sim_host::chips::{Clock, Fault};
use tasks::counters::COUNTERS;
use tasks::sampling::{self, Action, BurstBus, Sample, Sampler, Signal};

const US: u64 = 1_000;
const MS: u64 = 1_000_000;
const S: u64 = 1_000 * MS;

/// Returns a guard that lets one test run at a time, because `tasks::sampling` keeps its state in statics.
fn exclusive() -> MutexGuard<'static, ()> {
    static TEST_RUNS: Mutex<()> = Mutex::new(());
    let guard = TEST_RUNS.lock().unwrap_or_else(PoisonError::into_inner);
    sampling::end_setup();
    sampling::run_finished();
    guard
}

/// Returns whether a burst must be started. In these tests the task `control_loop` runs after every wake-up, so the
/// motors need not be stopped.
fn starts(next: Action) -> bool {
    assert_ne!(next, Action::StopMotors, "the motors are stopped");
    next == Action::StartBurst
}

/// A simulated DMA stream: its flags, which stay set until they are cleared, and its buffer.
#[derive(Clone, Default)]
struct Dma {
    done: Rc<Cell<bool>>,
    failed: Rc<Cell<bool>>,
    running: Rc<Cell<bool>>,
    frame: Rc<RefCell<Frame>>,
}

impl Dma {
    /// Returns the level of its interrupt.
    fn is_up(&self) -> bool {
        self.done.get() || self.failed.get()
    }
}

impl BurstBus for Dma {
    const SUPPORTS_SETUP: bool = true;

    fn acknowledge(&mut self) -> Signal {
        match (self.failed.take(), self.done.take()) {
            (true, _) => Signal::Failed,
            (_, true) => Signal::Done,
            _ => Signal::Nothing,
        }
    }

    fn finish(&mut self) -> Frame {
        *self.frame.borrow()
    }

    fn abort(&mut self) {
        self.running.set(false);
        self.done.set(false);
        self.failed.set(false);
    }
}

/// Enters the handler of the task `control_loop` as the interrupt controller does: if it is pended, and again as long
/// as the interrupt's level is up.
fn enter(dma: &Dma, sampler: &mut Sampler<Dma>, mut pended: bool, now_us: u32) -> (u32, Vec<Sample>) {
    let (mut entries, mut samples) = (0, vec![]);
    while pended || dma.is_up() {
        pended = false;
        entries += 1;
        assert!(entries < 10, "the handler is entered without end");
        if let Some(sample) = sampler.next_sample(now_us) {
            samples.push(sample);
            sampling::run_finished();
        }
    }
    (entries, samples)
}

#[derive(Clone, Copy, Debug)]
enum Event {
    DataReady,
    Deadline,
    /// The end of a burst, which may also come when no burst was started.
    Done,
    Failed,
    /// Software sets the interrupt pending.
    Pended,
    SetUpDone,
    Passes(u32),
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        Just(Event::DataReady),
        Just(Event::Deadline),
        Just(Event::Done),
        Just(Event::Failed),
        Just(Event::Pended),
        Just(Event::SetUpDone),
        (0..20_000_u32).prop_map(Event::Passes),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// After any event, one run of the handler clears the interrupt.
    #[test]
    fn each_event_enters_the_handler_once(
        events in prop::collection::vec(event(), 1..200),
        frame in prop::array::uniform16(any::<u8>()),
    ) {
        let _guard = exclusive();
        let dma = Dma::default();
        let mut sampler = Sampler::new(dma.clone());
        *dma.frame.borrow_mut() = frame;
        let mut now_us = 0_u32;
        for event in events {
            let mut pended = false;
            match event {
                Event::DataReady => {
                    let starts = starts(sampling::ready(now_us, dma.running.get()));
                    dma.running.set(dma.running.get() || starts);
                    pended = !starts;
                }
                Event::Deadline => {
                    let starts = starts(sampling::poll(now_us));
                    dma.running.set(dma.running.get() || starts);
                    pended = !starts;
                }
                Event::Done => {
                    dma.running.set(false);
                    dma.done.set(true);
                }
                Event::Failed => {
                    dma.running.set(false);
                    dma.failed.set(true);
                }
                Event::Pended => pended = true,
                Event::SetUpDone => {
                    if sampling::setting_up() {
                        sampling::end_setup();
                    }
                }
                Event::Passes(us) => now_us = now_us.wrapping_add(us),
            }
            let up = pended || dma.is_up();
            let (entries, samples) = enter(&dma, &mut sampler, pended, now_us);
            prop_assert_eq!(entries, u32::from(up));
            prop_assert!(samples.len() <= 1);
            // Nothing is counted against a control loop that runs.
            sampling::run_finished();
        }
    }
}

#[test]
fn burst_started_during_the_handler_is_not_aborted() {
    let _guard = exclusive();
    let dma = Dma::default();
    let mut sampler = Sampler::new(dma.clone());
    assert!(starts(sampling::poll(0)) && !starts(sampling::poll(500)));
    // The time was read before the burst began, so the age is −1 µs, not 71 minutes.
    dma.running.set(true);
    sampler.next_sample(u32::MAX);
    assert!(dma.running.get());
    sampler.next_sample(101);
    assert!(!dma.running.get(), "a burst that hangs is aborted");
}

/// A simulated board: time, sensor, the timer of the deadline, the tick, and the tasks that they start.
struct Board {
    clock: Clock,
    chip: Icm42688p,
    dma: Dma,
    sampler: Sampler<Dma>,
    setup: Option<Setup>,
    /// Whether the data-ready line is connected.
    connected: bool,
    deadline_us: u32,
    /// Steps: time, µs, whether there was a sample, and whether it was polled.
    steps: Vec<(u64, bool, bool)>,
}

impl Board {
    /// Creates a board whose sensor gets power now and is not set up yet.
    fn new() -> Self {
        let clock = Clock::default();
        let mut n = 0_i16;
        let source = move |_| {
            n = n.wrapping_add(1) & 0x3fff;
            ImuSample { gyro: [n; 3], accel: [n; 3] }
        };
        let chip = Icm42688p::new(&clock, Box::new(source));
        let dma = Dma::default();
        sampling::begin_setup();
        let sampler = Sampler::new(dma.clone());
        Self { clock, chip, dma, sampler, setup: None, connected: true, deadline_us: 1_500, steps: vec![] }
    }

    fn now_us(&self) -> u32 {
        (self.clock.now_ns() / US) as u32
    }

    /// Runs for `for_ns`, in steps of 10 µs.
    fn run(&mut self, for_ns: u64) {
        let end_ns = self.clock.now_ns() + for_ns;
        let mut edges = self.chip.data_ready_edges();
        let mut tick_ns = self.clock.now_ns().next_multiple_of(MS);
        while self.clock.now_ns() < end_ns {
            let now_us = self.now_us();
            let risen = self.chip.data_ready_edges() != edges;
            edges = self.chip.data_ready_edges();
            if risen && self.connected {
                self.deadline_us = now_us + 1_500;
                let starts = starts(sampling::ready(now_us, false));
                self.burst_or_pend(starts);
            } else if now_us >= self.deadline_us {
                self.deadline_us = now_us + 1_000;
                let starts = starts(sampling::poll(now_us));
                self.burst_or_pend(starts);
            }
            if self.clock.now_ns() >= tick_ns {
                tick_ns += MS;
                self.set_up();
            }
            self.clock.advance_ns(10 * US);
        }
    }

    fn burst_or_pend(&mut self, starts: bool) {
        let mut pended = !starts;
        if starts {
            let mut frame = BURST_READ;
            match self.chip.transfer_in_place(&mut frame) {
                Ok(()) => {
                    *self.dma.frame.borrow_mut() = frame;
                    self.dma.done.set(true);
                }
                Err(_) => self.dma.failed.set(true),
            }
            pended = false;
        }
        let now_us = self.now_us();
        let (_, samples) = enter(&self.dma, &mut self.sampler, pended, now_us);
        self.steps.extend(samples.iter().map(|sample| (sample.time_us, sample.imu.is_some(), sample.polled)));
    }

    fn set_up(&mut self) {
        if !sampling::setting_up() {
            return;
        }
        let now_us = self.now_us();
        let setup = self.setup.get_or_insert_with(|| Setup::new(now_us));
        if setup.step(&mut self.chip, now_us, sampling::edges()) == Progress::Done {
            self.setup = None;
            sampling::end_setup();
        }
    }

    /// Returns the longest time without a sample since the last call, up to now, µs, and the longest without a step.
    fn longest_gaps_us(&mut self) -> (u64, u64) {
        let now = std::iter::once(u64::from(self.now_us()));
        let longest = |times: &mut dyn Iterator<Item = u64>| {
            let (mut last, mut longest) = (None, 0);
            for time_us in times {
                longest = longest.max(time_us - last.unwrap_or(time_us));
                last = Some(time_us);
            }
            longest
        };
        let sampled =
            longest(&mut self.steps.iter().filter(|step| step.1).map(|step| step.0).chain(now.clone()));
        let stepped = longest(&mut self.steps.iter().map(|step| step.0).chain(now));
        self.steps.clear();
        (sampled, stepped)
    }
}

#[test]
fn first_samples_arrive_within_62_ms() {
    let _guard = exclusive();
    let mut board = Board::new();
    board.run(200 * MS);
    let first = board.steps.iter().find(|step| step.1).expect("samples");
    assert!((50_000..62_000).contains(&first.0), "{first:?}");
    let (sampled, stepped) = board.longest_gaps_us();
    assert!(sampled <= 1_020 && stepped <= 1_520, "{sampled} {stepped}");
    assert_eq!(board.chip.misuse(), []);
}

#[test]
fn imu_reset_in_flight_recovers_within_90_ms() {
    // The supply is interrupted for 1 µs to 20 ms, at different phases.
    for (n, dip_us) in [1, 300, 1_000, 5_000, 20_000].into_iter().enumerate() {
        let _guard = exclusive();
        let mut board = Board::new();
        board.run(200 * MS);
        board.steps.clear();
        let at_ns = board.clock.now_ns() + MS + n as u64 * 170 * US;
        board.chip.inject(at_ns..at_ns + dip_us * US, Fault::NoPower);
        board.run(300 * MS);
        let polled = board.steps.iter().filter(|step| step.2).count();
        assert!(polled >= 2, "the timer polled the sensor");
        let (sampled, stepped) = board.longest_gaps_us();
        println!("supply off for {dip_us} µs: no sample for {sampled} µs");
        assert!(sampled < 90_000, "{dip_us}: {sampled}");
        assert!(stepped <= 2_100, "steps continue: {stepped}");
        assert_eq!(board.chip.misuse(), []);
    }
}

#[test]
fn bit_flip_that_looks_like_a_reset_costs_one_sample() {
    let _guard = exclusive();
    let mut board = Board::new();
    board.run(200 * MS);
    board.steps.clear();
    let mut frame = [0; FRAME_LEN];
    frame[FRAME_LEN - 1] = 0x18;
    assert!(starts(sampling::ready(board.now_us(), false)));
    *board.dma.frame.borrow_mut() = frame;
    board.dma.done.set(true);
    assert!(board.sampler.next_sample(board.now_us()).unwrap().imu.is_none());
    board.run(100 * MS);
    assert_eq!(board.steps.iter().filter(|step| !step.1).count(), 0);
}

#[test]
fn broken_data_ready_line_is_replaced_by_polling() {
    let _guard = exclusive();
    let mut board = Board::new();
    board.run(200 * MS);
    board.steps.clear();
    COUNTERS.polled.take();
    board.connected = false;
    board.run(2 * S);
    let samples = board.steps.iter().filter(|step| step.1).count();
    assert!((1_950..=2_000).contains(&samples), "{samples}");
    assert!((1_990..=2_000).contains(&COUNTERS.polled.take()));
    assert!(board.longest_gaps_us().0 <= 3_000);
    // The line works again, so polling stops.
    board.connected = true;
    board.run(10 * MS);
    board.steps.clear();
    COUNTERS.polled.take();
    board.run(S);
    assert_eq!(COUNTERS.polled.take(), 0);
    assert!(board.longest_gaps_us().0 <= 1_020);
}

#[test]
fn silent_imu_is_set_up_again_when_it_returns() {
    for fault in
        [Fault::NoAnswer { reads: 0x00 }, Fault::NoAnswer { reads: 0xff }, Fault::Stalled, Fault::NoPower]
    {
        let _guard = exclusive();
        let mut board = Board::new();
        board.run(200 * MS);
        board.steps.clear();
        board.run(5 * MS);
        let now_ns = board.clock.now_ns();
        board.chip.inject(now_ns..now_ns + S, fault);
        board.run(2 * S);
        let (sampled, stepped) = board.longest_gaps_us();
        // Setup attempts are 150 ms apart, or 210 ms if they fail at their end.
        assert!((1_000_000..1_270_000).contains(&sampled), "{fault:?}: {sampled}");
        assert!(stepped <= 2_100, "{fault:?}: {stepped}");
    }
}
