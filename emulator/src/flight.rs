//! A flight of the firmware on the emulator in the world of a scene.
//!
//! ```text
//!  sample k due (the chip's own clock)                                sample k+1 due
//!  │ world.sense(): counts to the chips, bytes to the receiver,       │ world.act(): the last commands at the ESCs
//!  │ volts to the battery's pin; INT1 rises                           │ turn the rotors
//!  │◄──── the firmware runs; edges at the pads ──────────────────────►│
//! ```
//! Each sample advances the world by a millisecond; while the chip takes no samples, the world advances each millisecond.
//! Only two things are written to the firmware's memory: the configuration sector before the start, as on a real board,
//! and faults, if a test asks for them.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use flight_core::record::{self, StepRecord};
use flight_core::sample::{Input, RcFrame};
use flight_core::{ArmState, Config};
use input::InputError;
use rigless::device::ResetCause;
use rigless::emulator::{
    self, AccessKind, Driver, HitKind, Host, InterruptLine, Settled, Start, Stop, Watch,
};
use rigless::image::Image;
use rigless::session::Session;
use rigless::soc::Width;
use rigless::time::VirtualNanos;
use sim_host::flight::{AutopilotOutput, Crash, FlightLog, Outcome, World, step_count};
use sim_host::scene::Scene;

use crate::board::{self, FlightBoard, Machine, Wiring, to_chip};
use crate::faults::Fault;
use crate::firmware::Firmware;
use crate::gaps;
use crate::log::Log;
use crate::pads::{Esc, Line, PADS};
use crate::rc_receiver::Protocol;
use crate::rules::Rules;
use crate::timing::{HANDLERS, Timing};
use crate::vectors::Vectors;

/// Length of a step of the world, ns.
const STEP_NS: u64 = 1_000_000;

/// Interval at which the firmware's log is read, steps: its buffer of 4 KiB lasts for at least a second.
const LOG_STEPS: u64 = 100;

/// Maximum number of unmapped or refused addresses. A program that accesses more of them runs wild: the flight is aborted.
const MAX_UNMAPPED_ADDRESSES: usize = 1_000;

/// Settings of a flight.
pub struct Settings<'a> {
    /// Image to fly.
    pub firmware: &'a Firmware,
    /// Board and its wiring.
    pub wiring: Arc<Wiring>,
    /// Protocol of the receiver.
    pub receiver: Protocol,
    /// Configuration in the board's configuration sector; `None` for an empty sector.
    pub config: Option<Config>,
    /// Whether the firmware's log is printed on standard error during the flight.
    pub print_log: bool,
    /// Time for which the firmware runs on after a crash of the vehicle, s.
    pub after_crash_s: f64,
    /// Faults and their times, s.
    pub faults: Vec<(f64, Fault)>,
    /// Whether the flight ends as soon as it can no longer succeed.
    pub fail_fast: bool,
}

/// Result of a flight.
pub struct Flown {
    /// Outcome of the flight, judged by the truth.
    pub outcome: Outcome,
    /// Whether the motors turned after the pilot armed.
    pub armed: bool,
    /// Whether the vehicle left the ground; `None` on a ball joint, where it can't.
    pub took_off: Option<bool>,
    /// Times (s) and causes of the resets after the first start.
    pub resets: Vec<(f64, String)>,
    /// Number of deadlines that the firmware's tasks missed.
    pub missed_deadlines: u32,
    /// Number of executed instructions.
    pub instructions: u64,
    /// Accesses that no model covers, that were refused, or that the manual forbids.
    pub gaps: Vec<String>,
    /// Vectors that were entered again while their source was unserved.
    pub unserved: Vec<String>,
    /// All arm states in order, with their start, s.
    pub states: Vec<(f64, ArmState)>,
    /// All step records in order.
    pub records: Vec<StepRecord>,
    /// Time from which no pad floats, ns; `u64::MAX` if a pad floats at the end.
    pub pads_floated_until_ns: u64,
    /// Hash of all edges at the pads.
    pub pads_digest: u64,
    /// The ESCs at the end of the flight.
    pub escs: [Esc; PADS],
    /// Lines of the firmware's log.
    pub log: Vec<String>,
    /// Times and instruction counts.
    pub timing: Timing,
    /// Board in the vehicle, as flown.
    pub wiring: Arc<Wiring>,
    /// Times at which the LED changed (s), each with whether it is lit from then on.
    pub led: Vec<(f64, bool)>,
    /// Reason why the flight was aborted, if it was.
    pub aborted: Option<String>,
}

/// Flies `scene` with this seed.
///
/// # Errors
/// The image does not load on the board.
pub fn fly(
    scene: &Scene,
    seed: u64,
    settings: Settings<'_>,
    observer: Option<FlightLog>,
) -> Result<(Flown, Option<FlightLog>), InputError> {
    let board = FlightBoard::new(settings.wiring.clone(), settings.receiver)
        .map_err(|error| InputError::new(format!("the emulated board cannot be built: {error}")))?;
    let mut images = vec![settings.firmware.image()?];
    if let Some(config) = &settings.config {
        images.push(configuration(config)?);
    }
    let mut session = Session::new(Box::new(board), 0, VirtualNanos(STEP_NS))
        .map_err(|error| InputError::new(format!("the emulated board cannot be built: {error}")))?;
    let vectors = Vectors::new(settings.firmware, &settings.wiring);
    let handlers = settings.wiring.handlers;
    let handlers = handlers.map(|handler| settings.firmware.handler(handler.exception).unwrap_or(0));
    let returns = settings.wiring.handlers.iter().enumerate().flat_map(|(n, handler)| {
        settings.firmware.return_addresses(handler.exception).into_iter().map(move |address| (address, n))
    });
    let returns: BTreeMap<u64, usize> = returns.collect();
    let sleeps = settings.firmware.sleep_addresses();
    for address in handlers.iter().chain(returns.keys()).chain(&sleeps) {
        session.watch(Watch::Instruction(*address));
    }
    // Word 0 of the record is a counter: odd while a step is being recorded, even when the record is complete.
    session.watch(Watch::Writes { address: settings.firmware.record_address(), length: 4 });
    let mut faults: Vec<(u64, Fault)> =
        settings.faults.into_iter().map(|(at_s, fault)| ((at_s * 1e9) as u64, fault)).collect();
    faults.sort_by_key(|(at_ns, _)| *at_ns);
    faults.reverse();
    let driver = FlightDriver {
        world: World::new(scene, seed),
        observer,
        wiring: settings.wiring.clone(),
        channels: scene.config.params.channels,
        steps: step_count(scene.duration_s),
        after_crash: (settings.after_crash_s * 1e9) as u64 / STEP_NS,
        crash: None,
        crashed_at: 0,
        flown: 0,
        input: None,
        stepped_ns: 0,
        escs: Default::default(),
        digest: xxhash_rust::xxh3::Xxh3::new(),
        floated_until_ns: u64::MAX,
        record_at: settings.firmware.record_address(),
        record: None,
        records: Vec::new(),
        states: Vec::new(),
        missed_deadlines: 0,
        armed: false,
        took_off: false,
        log: Log::new(settings.firmware, settings.print_log)?,
        faults,
        active: crate::faults::ActiveFaults::new(settings.firmware),
        vectors,
        handlers,
        returns,
        sleeps,
        timing: Timing::default(),
        led: vec![(0.0, false)],
        rules: Rules::new(settings.wiring.clone()),
        runs_wild: false,
        arms_by_ns: match &scene.pilot {
            // The stick gesture and the checks take 2 s.
            Some(pilot) if settings.fail_fast => ((pilot.plan.arm_at_s + 2.0) * 1e9) as u64,
            _ => u64::MAX,
        },
        cannot_succeed: false,
        raise_all: [false; _],
        in_ccm: BTreeMap::new(),
        done: false,
    };
    let start = Start::new(&images);
    let finished = emulator::run(session, &start, driver)
        .map_err(|error| InputError::new(error.to_string()).file(settings.firmware.name()))?;
    let (session, driver) = (finished.session, finished.driver);
    let stop = finished.stop;
    let resets = session.resets();
    let resets = resets.iter().map(|reset| (reset.at.0 as f64 * 1e-9, cause(reset.cause))).collect();
    let FlightDriver { world, observer, flown, crash, crashed_at, done, .. } = driver;
    let aborted = match done {
        _ if driver.cannot_succeed => Some("the flight can no longer succeed".into()),
        _ if driver.runs_wild => {
            Some(format!("the program accessed more than {MAX_UNMAPPED_ADDRESSES} unmapped addresses"))
        }
        true if driver.records.is_empty() => Some("the firmware never ran a step".into()),
        true => None,
        false => Some("the emulator stopped unexpectedly".into()),
    };
    let steps = if crash.is_some() { crashed_at } else { flown };
    let flight = Flown {
        outcome: world.outcome(steps, crash),
        armed: driver.armed,
        took_off: (!scene.ball_joint).then_some(driver.took_off),
        resets,
        missed_deadlines: driver.missed_deadlines,
        instructions: stop.map_or(0, |stop| stop.instruction_count),
        gaps: gaps::list(&session, &driver.in_ccm, &driver.rules),
        unserved: driver.vectors.into_violations(),
        states: driver.states,
        records: driver.records,
        pads_floated_until_ns: driver.floated_until_ns,
        pads_digest: driver.digest.digest(),
        escs: driver.escs,
        log: driver.log.into_lines(),
        timing: driver.timing,
        wiring: driver.wiring,
        led: driver.led,
        aborted,
    };
    Ok((flight, observer))
}

/// Returns the cause of a reset as text.
fn cause(cause: ResetCause) -> String {
    match cause {
        ResetCause::Core => "by the program".into(),
        ResetCause::Model(peripheral) => format!("by {peripheral}"),
        ResetCause::Pin => "by the reset pin".into(),
        ResetCause::PowerOn => "power on".into(),
        other => format!("{other:?}"),
    }
}

/// Returns the image of the configuration sector with this configuration.
fn configuration(config: &Config) -> Result<Image, InputError> {
    let mut bytes = [0; stored_config::MAX_RECORD];
    let record = stored_config::encode(config, &mut bytes)
        .map_err(|error| InputError::new(format!("the configuration cannot be stored: {error}")))?;
    Image::new(Path::new("configuration"), record.to_vec(), Some(crate::firmware::CONFIGURATION))
        .map_err(|error| InputError::new(error.to_string()))
}

/// Driver of the emulation: connects the world to the board, and observes the firmware.
struct FlightDriver {
    world: World,
    observer: Option<FlightLog>,
    wiring: Arc<Wiring>,
    channels: flight_core::rc::ChannelMap,
    steps: u64,
    after_crash: u64,
    crash: Option<(Crash, f64)>,
    crashed_at: u64,
    flown: u64,
    input: Option<Input>,
    stepped_ns: u64,
    escs: [Esc; PADS],
    digest: xxhash_rust::xxh3::Xxh3,
    floated_until_ns: u64,
    record_at: u64,
    record: Option<StepRecord>,
    records: Vec<StepRecord>,
    states: Vec<(f64, ArmState)>,
    missed_deadlines: u32,
    armed: bool,
    took_off: bool,
    log: Log,
    faults: Vec<(u64, Fault)>,
    active: crate::faults::ActiveFaults,
    vectors: Vectors,
    handlers: [u64; HANDLERS],
    returns: BTreeMap<u64, usize>,
    sleeps: Vec<u64>,
    timing: Timing,
    led: Vec<(f64, bool)>,
    rules: Rules,
    /// Whether the program accessed too many unmapped addresses.
    runs_wild: bool,
    /// Time by which the vehicle must be armed if `fail_fast` is set, ns. From then on the first error ends the flight.
    arms_by_ns: u64,
    cannot_succeed: bool,
    /// For each handler, whether all other interrupts are raised at its next entry.
    raise_all: [bool; HANDLERS],
    in_ccm: BTreeMap<(usize, usize), u64>,
    done: bool,
}

impl FlightDriver {
    /// Passes the edges at the pads to the ESCs.
    fn take_edges(&mut self, machine: &mut Machine) {
        for (at_ns, pad, line) in machine.take_edges() {
            let mut bytes = [0; 10];
            bytes[..8].copy_from_slice(&at_ns.to_le_bytes());
            bytes[8] = pad as u8;
            bytes[9] = line as u8;
            self.digest.update(&bytes);
            self.escs[pad].on_edge(at_ns, line);
            let floats = self.escs.iter().any(|esc| esc.line() == Line::Floating);
            self.floated_until_ns = match (floats, self.floated_until_ns) {
                (true, _) => u64::MAX,
                (false, u64::MAX) => at_ns,
                (false, until_ns) => until_ns,
            };
        }
    }

    /// Reads the step record after a write to its counter, if the record is complete.
    fn take_record(&mut self, host: &mut dyn Host) {
        let read =
            |host: &mut dyn Host, n: u64| host.read(self.record_at + 4 * n, Width::W32).unwrap_or(0) as u32;
        if !read(host, 0).is_multiple_of(2) {
            return;
        }
        let mut words = [0; record::WORDS];
        for (word, n) in words.iter_mut().zip(1..) {
            *word = read(host, n);
        }
        // The words are invalid while the start code initializes the variables.
        let Ok(record) = StepRecord::from_words(&words) else { return };
        let at_s = self.world.time_us() as f64 * 1e-6;
        if self.states.last().is_none_or(|(_, state)| *state != record.outcome.state) {
            self.states.push((at_s, record.outcome.state));
        }
        self.missed_deadlines = self.missed_deadlines.max(record.health.missed_deadlines);
        self.armed |= record.outcome.driven;
        if record.imu.is_some() {
            self.timing.on_time_stamp(record.time_us);
        }
        self.records.push(record);
        self.record = Some(record);
    }

    /// Returns the firmware's output for the step that ends now.
    fn output(&mut self, now_ns: u64) -> AutopilotOutput {
        let mut pulses_us = [1_000.0; 4];
        for (esc, pad) in self.escs.iter().zip(&self.wiring.pads) {
            pulses_us[pad.rotor] = (1_000.0 + 1_000.0 * esc.throttle(now_ns)) as f32;
        }
        let driven = pulses_us.iter().any(|&us| us > 1_000.0);
        match &self.record {
            Some(record) => AutopilotOutput {
                driven,
                pulses_us,
                state: record.outcome.state,
                event: record.outcome.event,
                attitude: record.outcome.attitude,
                rates_rad_s: None,
            },
            None => AutopilotOutput {
                driven,
                pulses_us,
                state: ArmState::default(),
                event: None,
                attitude: flight_core::geometry::Quaternion::IDENTITY,
                rates_rad_s: None,
            },
        }
    }

    /// Ends the world's present step with the firmware's output, and starts the next one with new sensor samples.
    fn step(&mut self, machine: &mut Machine, now_ns: u64, sampled: bool) {
        if let Some(input) = self.input.take() {
            let output = self.output(now_ns);
            let crash = self.world.act(&input, &output, &mut self.observer);
            self.flown += 1;
            self.took_off |= self.world.truth().position.z < -0.3;
            if let Some(crash) = crash
                && self.crash.is_none()
            {
                self.crash = Some(crash);
                self.crashed_at = self.flown;
                self.steps = self.steps.min(self.flown + self.after_crash);
            }
            if self.flown >= self.steps {
                self.done = true;
                return;
            }
        }
        let input = self.world.sense();
        self.stepped_ns = now_ns;
        machine.check_receiver_line();
        machine.receiver().drop_before(now_ns.saturating_sub(STEP_NS));
        if let Some(sample) = input.imu {
            let axes = &self.wiring.imu_axes;
            let imu = machine.imu();
            imu.set_counts(to_chip(axes, sample.gyro), to_chip(axes, sample.accel));
            if sampled {
                imu.signal_ready();
                self.timing.on_data_ready(now_ns);
            }
        } else {
            machine.imu().skip_sample();
        }
        if let Some(sample) = input.mag {
            machine.magnetometer().set_counts(to_chip(&self.wiring.magnetometer_axes, sample.counts));
        }
        // The magnetometer samples every 10 ms; without a sample at that time, the scene has a dead magnetometer.
        if input.time_us.is_multiple_of(10_000) {
            machine.magnetometer().absent = input.mag.is_none() || self.active.magnetometer_absent;
        }
        if let Some(battery) = input.battery {
            machine.set_battery(self.active.battery_v.unwrap_or(f64::from(battery.voltage_v)));
        }
        if let Some(rc) = &input.rc
            && !self.active.receiver_silent
        {
            self.send_rc(machine, rc, now_ns);
        }
        self.input = Some(input);
    }

    fn send_rc(&mut self, machine: &mut Machine, rc: &RcFrame, now_ns: u64) {
        // The receiver has its own clock: its frames shift against the samples, here by 37 ppm.
        let phase_ns = now_ns / 1_000 * 37 / 1_000 % STEP_NS;
        machine.receiver().send(rc, &self.channels, now_ns + phase_ns);
    }
}

impl Driver<FlightBoard> for FlightDriver {
    fn on_settled(&mut self, session: &mut Session<FlightBoard>, host: &mut dyn Host, settled: Settled) {
        match settled {
            Settled::Access { access, .. } => {
                let at = access.address;
                let resets = session.resets().len();
                let machine = &mut session.board_mut().machine;
                if machine.touches_pads(at) {
                    machine.update_pads(access.virtual_time);
                    if access.kind == AccessKind::Write && machine.is_motor_timer(at) {
                        self.timing.on_motor_write(access.virtual_time.0, access.instruction_count);
                    }
                }
                self.vectors.on_access(machine, at);
                if board::is_dma(at) {
                    self.rules.update_resets(resets);
                    let written = access.kind == AccessKind::Write;
                    self.rules.on_dma_access(machine, at, written, access.virtual_time.0 as f64 * 1e-9);
                    for stream in machine.part.unreachable_by_dma() {
                        self.in_ccm.entry(stream).or_insert(access.program_counter.unwrap_or(0));
                    }
                }
            }
            Settled::Hit(hit) if hit.kind == HitKind::Write => self.take_record(host),
            Settled::Hit(hit) if self.sleeps.contains(&hit.address) => {
                self.timing.on_sleep(hit.instruction_count);
            }
            Settled::Hit(hit) => {
                if let Some(&handler) = self.returns.get(&hit.address) {
                    self.timing.on_return(handler, hit.instruction_count);
                    return;
                }
                if let Some(handler) = self.handlers.iter().position(|entry| *entry == hit.address) {
                    self.timing.on_entry(handler, hit.at.0, hit.instruction_count);
                    if std::mem::take(&mut self.raise_all[handler]) {
                        let handlers = &self.wiring.handlers;
                        let others = handlers.iter().map(|other| other.exception);
                        let others = others.filter(|other| *other != handlers[handler].exception);
                        let lines = others.filter_map(|other| InterruptLine::new(other.checked_sub(16)?));
                        lines.for_each(|line| session.pulse(line, host));
                    }
                }
                self.vectors.on_entry(&session.board().machine, hit.address, hit.at.0);
            }
            _ => {}
        }
    }

    fn on_stop(
        &mut self,
        session: &mut Session<FlightBoard>,
        stop: Stop,
        host: &mut dyn Host,
    ) -> Option<VirtualNanos> {
        let now_ns = stop.at.0;
        if now_ns >= self.arms_by_ns {
            self.cannot_succeed = !self.armed || self.rules.is_broken() || self.vectors.is_unserved();
            if self.cannot_succeed {
                return None;
            }
        }
        if self.flown.is_multiple_of(LOG_STEPS) {
            self.runs_wild = session.unmapped().len() + session.refused().len() > MAX_UNMAPPED_ADDRESSES;
            if self.runs_wild {
                return None;
            }
        }
        self.timing.instructions_now = stop.instruction_count;
        let machine = &mut session.board_mut().machine;
        self.take_edges(machine);
        while self.faults.last().is_some_and(|(at_ns, _)| *at_ns <= now_ns) {
            match self.faults.pop() {
                Some((_, Fault::AllInterrupts)) => self.raise_all = [true; HANDLERS],
                Some((_, Fault::ResetPin)) => session.reset_by_pin(stop.at, stop.instruction_count, host),
                Some((_, fault)) => {
                    self.active.apply(fault, &mut session.board_mut().machine, host, stop.at);
                }
                None => {}
            }
        }
        let machine = &mut session.board_mut().machine;
        self.active.run(machine, now_ns);

        let sampled = machine.imu().take_sampled();
        let running = machine.imu().next_sample_ns().filter(|&at| at > now_ns);
        // A stop comes up to one instruction late, so the intervals of the steps vary slightly.
        let since_ns = now_ns - self.stepped_ns;
        let due = if running.is_some() { sampled && since_ns > STEP_NS / 2 } else { since_ns >= STEP_NS };
        if due || self.input.is_none() || since_ns > 2 * STEP_NS {
            if self.flown.is_multiple_of(LOG_STEPS) {
                self.log.fetch(host);
            }
            self.step(machine, now_ns, sampled);
            self.rules.check(machine, now_ns as f64 * 1e-9);
            if self.led.last().is_some_and(|(_, lit)| *lit != machine.is_led_lit()) {
                self.led.push((now_ns as f64 * 1e-9, machine.is_led_lit()));
            }
            if self.done {
                self.log.fetch(host);
                return None;
            }
        }
        let next_step = machine.imu().next_sample_ns().filter(|&at| at > now_ns);
        let mut next = next_step.unwrap_or(self.stepped_ns + STEP_NS).max(now_ns + 1);
        // Bytes that begin now or began earlier need no further stop.
        if let Some(at) = machine.receiver().next_byte_ns(now_ns) {
            next = next.min(at);
        }
        if let Some((at, _)) = self.faults.last() {
            next = next.min((*at).max(now_ns + 1));
        }
        Some(VirtualNanos(next))
    }
}
