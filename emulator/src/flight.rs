//! A flight: the firmware on the board, in the scene's world.
//!
//! ```text
//!  sample k due (the chip's own clock)                                sample k+1 due
//!  │ world.sense(): counts into the chips, bytes to the receiver,     │ the commands that have arrived at the ESCs
//!  │ volts on the battery's pin; INT1 rises                           │ turn the rotors: world.act()
//!  │◄──── the firmware runs; edges at the pads ──────────────────────►│
//! ```
//! The world moves on by a millisecond with each sample; while the chip takes none, with each millisecond. Nothing is
//! put into the memory of the firmware but what the configuration sector of a board holds before it is switched on,
//! and, where a test asks for it, a fault.

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
use sim_host::flight::{Answer, Crash, FlightLog, Outcome, World, steps_of};
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

/// A step of the world, ns.
const STEP_NS: u64 = 1_000_000;

/// How often the firmware's log is fetched, steps: its buffer of 4 KiB takes a second at least.
const LOG_STEPS: u64 = 100;

/// A program that has accessed so many addresses where nothing is has lost its way: it ends, and so does the list.
const ASTRAY_ADDRESSES: usize = 1_000;

/// What is to be flown, and how.
pub struct Settings<'a> {
    /// The image.
    pub firmware: &'a Firmware,
    /// The board.
    pub wiring: Arc<Wiring>,
    /// What the receiver speaks.
    pub receiver: Protocol,
    /// What is in the board's configuration sector.
    pub config: Option<Config>,
    /// The firmware's log goes to standard error as it comes.
    pub print_log: bool,
    /// After a crash of the vehicle the firmware runs on for this long, s: what becomes of it.
    pub after_crash_s: f64,
    /// What goes wrong, and when (s).
    pub faults: Vec<(f64, Fault)>,
    /// The flight ends as soon as it can't be a good one any more.
    pub fail_fast: bool,
}

/// What became of a flight.
pub struct Flown {
    /// The flight, judged on the truth.
    pub outcome: Outcome,
    /// Whether the pilot's arming brought the motors to turn.
    pub armed: bool,
    /// Whether it left the ground; a vehicle on a ball joint can't.
    pub took_off: Option<bool>,
    /// Resets after the first start: when (s), and why.
    pub resets: Vec<(f64, String)>,
    /// Deadlines that the firmware's tasks have missed.
    pub missed_deadlines: u32,
    /// Instructions executed.
    pub instructions: u64,
    /// Accesses that no model covers, that were refused, or that the manual forbids.
    pub gaps: Vec<String>,
    /// Vectors that were entered again while their source was unserved.
    pub unserved: Vec<String>,
    /// Every state in turn, and when (s).
    pub states: Vec<(f64, ArmState)>,
    /// The step records, in turn.
    pub records: Vec<StepRecord>,
    /// When the last pad that floated did so no more, ns; never, if one floats at the end.
    pub pads_floated_until_ns: u64,
    /// Hash of every edge at the pads.
    pub pads_digest: u64,
    /// The ESCs as they ended.
    pub escs: [Esc; PADS],
    /// Lines of the firmware's log.
    pub log: Vec<String>,
    /// Times and instruction counts.
    pub timing: Timing,
    /// What was flown: the board in the vehicle.
    pub wiring: Arc<Wiring>,
    /// When the LED changed (s), and whether it was lit from then on.
    pub led: Vec<(f64, bool)>,
    /// The emulator stopped by itself, and why.
    pub broken_off: Option<String>,
}

/// Flies `scene` with this seed.
///
/// # Errors
/// The image can't be placed on the board.
pub fn fly(
    scene: &Scene,
    seed: u64,
    settings: Settings<'_>,
    observer: Option<FlightLog>,
) -> Result<(Flown, Option<FlightLog>), InputError> {
    let board = FlightBoard::new(settings.wiring.clone(), settings.receiver)
        .map_err(|error| InputError::new(format!("the board does not assemble: {error}")))?;
    let mut images = vec![settings.firmware.image()?];
    if let Some(config) = &settings.config {
        images.push(configuration(config)?);
    }
    let mut session = Session::new(Box::new(board), 0, VirtualNanos(STEP_NS))
        .map_err(|error| InputError::new(format!("the board does not assemble: {error}")))?;
    let vectors = Vectors::new(settings.firmware, &settings.wiring);
    let handlers = settings.wiring.handlers;
    let handlers = handlers.map(|handler| settings.firmware.handler(handler.exception).unwrap_or(0));
    let returns = settings.wiring.handlers.iter().enumerate().flat_map(|(n, handler)| {
        settings.firmware.returns(handler.exception).into_iter().map(move |address| (address, n))
    });
    let returns: BTreeMap<u64, usize> = returns.collect();
    let sleeps = settings.firmware.sleeps();
    for address in handlers.iter().chain(returns.keys()).chain(&sleeps) {
        session.watch(Watch::Instruction(*address));
    }
    // Word 0 of the record counts: odd while a step is being recorded, even when it is complete.
    session.watch(Watch::Writes { address: settings.firmware.record_address(), length: 4 });
    let mut faults: Vec<(u64, Fault)> =
        settings.faults.into_iter().map(|(at_s, fault)| ((at_s * 1e9) as u64, fault)).collect();
    faults.sort_by_key(|(at_ns, _)| *at_ns);
    faults.reverse();
    let pilot = Pilot {
        world: World::new(scene, seed),
        observer,
        wiring: settings.wiring.clone(),
        channels: scene.config.params.channels,
        steps: steps_of(scene),
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
        active: crate::faults::Active::new(settings.firmware),
        vectors,
        handlers,
        returns,
        sleeps,
        timing: Timing::default(),
        led: vec![(0.0, false)],
        rules: Rules::new(settings.wiring.clone()),
        astray: false,
        arms_by_ns: match &scene.pilot {
            // The gesture, the checks, and some time.
            Some(pilot) if settings.fail_fast => ((pilot.plan.arm_at_s + 2.0) * 1e9) as u64,
            _ => u64::MAX,
        },
        hopeless: false,
        raise_all: [false; _],
        in_ccm: BTreeMap::new(),
        done: false,
    };
    let start = Start::new(&images);
    let finished = emulator::run(session, &start, pilot)
        .map_err(|error| InputError::new(error.to_string()).file(settings.firmware.name()))?;
    let (session, pilot) = (finished.session, finished.driver);
    let stop = finished.stop;
    let resets = session.resets();
    let resets = resets.iter().map(|reset| (reset.at.0 as f64 * 1e-9, cause(reset.cause))).collect();
    let Pilot { world, observer, flown, crash, crashed_at, done, .. } = pilot;
    let broken_off = match done {
        _ if pilot.hopeless => Some("broken off: it can't be a good flight any more".into()),
        _ if pilot.astray => {
            Some(format!("accesses to more than {ASTRAY_ADDRESSES} addresses where nothing is"))
        }
        true if pilot.records.is_empty() => Some("the firmware never ran a step".into()),
        true => None,
        false => Some("the emulator stopped by itself".into()),
    };
    let steps = if crash.is_some() { crashed_at } else { flown };
    let flight = Flown {
        outcome: world.outcome(steps, crash),
        armed: pilot.armed,
        took_off: (!scene.ball_joint).then_some(pilot.took_off),
        resets,
        missed_deadlines: pilot.missed_deadlines,
        instructions: stop.map_or(0, |stop| stop.instruction_count),
        gaps: gaps::list(&session, &pilot.in_ccm, &pilot.rules),
        unserved: pilot.vectors.into_violations(),
        states: pilot.states,
        records: pilot.records,
        pads_floated_until_ns: pilot.floated_until_ns,
        pads_digest: pilot.digest.digest(),
        escs: pilot.escs,
        log: pilot.log.into_lines(),
        timing: pilot.timing,
        wiring: pilot.wiring,
        led: pilot.led,
        broken_off,
    };
    Ok((flight, observer))
}

/// Why the microcontroller was reset, for people.
fn cause(cause: ResetCause) -> String {
    match cause {
        ResetCause::Core => "by the program".into(),
        ResetCause::Model(peripheral) => format!("by {peripheral}"),
        ResetCause::Pin => "by the reset pin".into(),
        ResetCause::PowerOn => "power on".into(),
        other => format!("{other:?}"),
    }
}

/// The configuration sector with this configuration in it.
fn configuration(config: &Config) -> Result<Image, InputError> {
    let mut bytes = [0; stored_config::MAX_RECORD];
    let record = stored_config::encode(config, &mut bytes)
        .map_err(|error| InputError::new(format!("the configuration can't be stored: {error}")))?;
    Image::new(Path::new("configuration"), record.to_vec(), Some(crate::firmware::CONFIGURATION))
        .map_err(|error| InputError::new(error.to_string()))
}

/// What drives the run: the world on the one side, the board on the other.
struct Pilot {
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
    active: crate::faults::Active,
    vectors: Vectors,
    handlers: [u64; HANDLERS],
    returns: BTreeMap<u64, usize>,
    sleeps: Vec<u64>,
    timing: Timing,
    led: Vec<(f64, bool)>,
    rules: Rules,
    astray: bool,
    /// From then on nothing that is wrong is waited out.
    arms_by_ns: u64,
    hopeless: bool,
    /// Handlers at whose next entry all other interrupts are raised.
    raise_all: [bool; HANDLERS],
    in_ccm: BTreeMap<(usize, usize), u64>,
    done: bool,
}

impl Pilot {
    fn take_edges(&mut self, machine: &mut Machine) {
        for (at_ns, pad, line) in machine.take_edges() {
            let mut bytes = [0; 10];
            bytes[..8].copy_from_slice(&at_ns.to_le_bytes());
            bytes[8] = pad as u8;
            bytes[9] = line as u8;
            self.digest.update(&bytes);
            self.escs[pad].edge(at_ns, line);
            let floats = self.escs.iter().any(|esc| esc.line() == Line::Floating);
            self.floated_until_ns = match (floats, self.floated_until_ns) {
                (true, _) => u64::MAX,
                (false, u64::MAX) => at_ns,
                (false, until_ns) => until_ns,
            };
        }
    }

    /// A step has been recorded, or begins to be.
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
        // Zeros, while the variables are set up.
        let Ok(record) = StepRecord::from_words(&words) else { return };
        let at_s = self.world.time_us() as f64 * 1e-6;
        if self.states.last().is_none_or(|(_, state)| *state != record.outcome.state) {
            self.states.push((at_s, record.outcome.state));
        }
        self.missed_deadlines = self.missed_deadlines.max(record.health.missed_deadlines);
        self.armed |= record.outcome.driven;
        if record.imu.is_some() {
            self.timing.stamped(record.time_us);
        }
        self.records.push(record);
        self.record = Some(record);
    }

    /// What came of the step that ends now.
    fn answer(&mut self, now_ns: u64) -> Answer {
        let mut pulses_us = [1_000.0; 4];
        for (esc, pad) in self.escs.iter().zip(&self.wiring.pads) {
            pulses_us[pad.rotor] = (1_000.0 + 1_000.0 * esc.throttle(now_ns)) as f32;
        }
        let driven = pulses_us.iter().any(|&us| us > 1_000.0);
        match &self.record {
            Some(record) => Answer {
                driven,
                pulses_us,
                state: record.outcome.state,
                event: record.outcome.event,
                attitude: record.outcome.attitude,
                rates_rad_s: None,
            },
            None => Answer {
                driven,
                pulses_us,
                state: ArmState::default(),
                event: None,
                attitude: flight_core::geometry::Quaternion::IDENTITY,
                rates_rad_s: None,
            },
        }
    }

    /// The world's next step: what has become of the last one, and what there is to sense now.
    fn step(&mut self, machine: &mut Machine, now_ns: u64, sampled: bool) {
        if let Some(input) = self.input.take() {
            let answer = self.answer(now_ns);
            let crash = self.world.act(&input, &answer, &mut self.observer);
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
        machine.check_radio_line();
        machine.receiver().forget_before(now_ns.saturating_sub(STEP_NS));
        if let Some(sample) = input.imu {
            let axes = &self.wiring.imu_axes;
            let imu = machine.imu();
            imu.measure(to_chip(axes, sample.gyro), to_chip(axes, sample.accel));
            if sampled {
                imu.ready();
                self.timing.ready(now_ns);
            }
        } else {
            machine.imu().withhold();
        }
        if let Some(sample) = input.mag {
            machine.magnetometer().measure(to_chip(&self.wiring.magnetometer_axes, sample.counts));
        }
        // It samples every 10 ms; a scene in which it is dead brings none.
        if input.time_us.is_multiple_of(10_000) {
            machine.magnetometer().absent = input.mag.is_none() || self.active.magnetometer_absent;
        }
        if let Some(battery) = input.battery {
            machine.set_battery(self.active.battery_v.unwrap_or(f64::from(battery.voltage_v)));
        }
        if let Some(rc) = &input.rc
            && !self.active.radio_silent
        {
            self.send(machine, rc, now_ns);
        }
        self.input = Some(input);
    }

    fn send(&mut self, machine: &mut Machine, rc: &RcFrame, now_ns: u64) {
        // The receiver's clock is not the sensor's: its frames move along the samples, by 37 ppm here.
        let phase_ns = now_ns / 1_000 * 37 / 1_000 % STEP_NS;
        machine.receiver().send(rc, &self.channels, now_ns + phase_ns);
    }
}

impl Driver<FlightBoard> for Pilot {
    fn on_settled(&mut self, session: &mut Session<FlightBoard>, host: &mut dyn Host, settled: Settled) {
        match settled {
            Settled::Access { access, .. } => {
                let at = access.address;
                let resets = session.resets().len();
                let machine = &mut session.board_mut().machine;
                if machine.touches_pads(at) {
                    machine.follow_pads(access.virtual_time);
                    if access.kind == AccessKind::Write && machine.is_motor_timer(at) {
                        self.timing.motor_access(access.virtual_time.0, access.instruction_count);
                    }
                }
                self.vectors.accessed(machine, at);
                if board::is_dma(at) {
                    self.rules.restarted(resets);
                    let written = access.kind == AccessKind::Write;
                    self.rules.dma_accessed(machine, at, written, access.virtual_time.0 as f64 * 1e-9);
                    for stream in machine.part.unreachable_by_dma() {
                        self.in_ccm.entry(stream).or_insert(access.program_counter.unwrap_or(0));
                    }
                }
            }
            Settled::Hit(hit) if hit.kind == HitKind::Write => self.take_record(host),
            Settled::Hit(hit) if self.sleeps.contains(&hit.address) => {
                self.timing.sleeps(hit.instruction_count);
            }
            Settled::Hit(hit) => {
                if let Some(&handler) = self.returns.get(&hit.address) {
                    self.timing.returns(handler, hit.instruction_count);
                    return;
                }
                if let Some(handler) = self.handlers.iter().position(|entry| *entry == hit.address) {
                    self.timing.entered(handler, hit.at.0, hit.instruction_count);
                    if std::mem::take(&mut self.raise_all[handler]) {
                        let handlers = &self.wiring.handlers;
                        let others = handlers.iter().map(|other| other.exception);
                        let others = others.filter(|other| *other != handlers[handler].exception);
                        let lines = others.filter_map(|other| InterruptLine::new(other.checked_sub(16)?));
                        lines.for_each(|line| session.pulse(line, host));
                    }
                }
                self.vectors.entered(&session.board().machine, hit.address, hit.at.0);
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
            self.hopeless = !self.armed || self.rules.is_broken() || self.vectors.is_unserved();
            if self.hopeless {
                return None;
            }
        }
        if self.flown.is_multiple_of(LOG_STEPS) {
            self.astray = session.unmapped().len() + session.refused().len() > ASTRAY_ADDRESSES;
            if self.astray {
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
        // A stop comes up to an instruction after its instant, so that steps are a little more or less apart.
        let since_ns = now_ns - self.stepped_ns;
        let due = if running.is_some() { sampled && since_ns > STEP_NS / 2 } else { since_ns >= STEP_NS };
        if due || self.input.is_none() || since_ns > 2 * STEP_NS {
            if self.flown.is_multiple_of(LOG_STEPS) {
                self.log.fetch(host);
            }
            self.step(machine, now_ns, sampled);
            self.rules.look(machine, now_ns as f64 * 1e-9);
            if self.led.last().is_some_and(|(_, lit)| *lit != machine.lit()) {
                self.led.push((now_ns as f64 * 1e-9, machine.lit()));
            }
            if self.done {
                self.log.fetch(host);
                return None;
            }
        }
        let next_step = machine.imu().next_sample_ns().filter(|&at| at > now_ns);
        let mut next = next_step.unwrap_or(self.stepped_ns + STEP_NS).max(now_ns + 1);
        // One that begins now, or that nobody has listened to, is no reason to stop again.
        if let Some(at) = machine.receiver().next_byte_ns(now_ns) {
            next = next.min(at);
        }
        if let Some((at, _)) = self.faults.last() {
            next = next.min((*at).max(now_ns + 1));
        }
        Some(VirtualNanos(next))
    }
}
