//! Flights over the link with a stand-in for the firmware: in this process, where each fault occurs at a chosen step, and
//! with the program `sim-host`, with pipes, a terminal and signals.

#[cfg(target_os = "linux")]
mod program;
mod stand_in;

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::num::NonZeroU32;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use flight_core::ArmState;
use sim_host::flight::{Flight, Observer, Outcome, StepView};
use sim_host::hil::{self, Faults, Flown, LinkError, OnTimeout, Received, Reset, Wire};
use sim_host::scene::Scene;
use xxhash_rust::xxh3::Xxh3;

use stand_in::{Behaviour, Board};

/// A board in this process, as a wire.
struct InProcess {
    board: Board,
    incoming: VecDeque<u8>,
    /// Whether the wire may lose frames, as a serial port may.
    lossy: bool,
    /// Timeouts in a row.
    timeouts: u32,
}

impl InProcess {
    fn new(behaviour: Behaviour) -> Self {
        Self { board: Board::new(behaviour), incoming: VecDeque::new(), lossy: false, timeouts: 0 }
    }
}

impl Read for InProcess {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.incoming.extend(self.board.sent.drain(..));
        if self.incoming.is_empty() {
            return if self.board.dead { Ok(0) } else { Err(io::ErrorKind::WouldBlock.into()) };
        }
        self.timeouts = 0;
        self.incoming.read(buffer)
    }
}

impl Write for InProcess {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.board.receive_bytes(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Wire for InProcess {
    fn on_timeout(&mut self) -> OnTimeout {
        self.timeouts += 1;
        if self.lossy && self.timeouts < 100 {
            OnTimeout::NextFrame
        } else {
            OnTimeout::Silent("nothing".into())
        }
    }
}

/// Hash of all outputs of an autopilot.
#[derive(Default)]
struct OutputHash(Xxh3);

impl Observer for OutputHash {
    fn step(&mut self, view: &StepView) {
        let out = view.output;
        let numbers = out.pulses_us.into_iter().chain(out.attitude.to_array());
        for number in numbers {
            self.0.update(&number.to_bits().to_le_bytes());
        }
        self.0.update(format!("{} {:?} {:?}", out.driven, out.state, out.event).as_bytes());
    }
}

fn hover(duration_s: f64) -> Scene {
    let mut scene = Scene::load("hover").unwrap();
    scene.set_duration(duration_s).unwrap();
    scene
}

fn fly(wire: &mut InProcess, faults: Faults) -> Flown {
    fly_for(wire, faults, 14.0)
}

fn fly_for(wire: &mut InProcess, faults: Faults, duration_s: f64) -> Flown {
    hil::fly(wire, &hover(duration_s), 7, faults, Arc::default(), &mut ())
}

/// Flies with a board of this behaviour.
fn with(behaviour: Behaviour) -> Flown {
    fly(&mut InProcess::new(behaviour), Faults::default())
}

fn in_process() -> Outcome {
    Flight::new(&hover(14.0), 7).run(&mut ())
}

#[test]
fn flight_over_the_link_equals_the_one_in_process() {
    for name in ["hover", "windy-landing", "bad-link", "rough-sampling", "weak-battery"] {
        let scene = Scene::load(name).unwrap();
        let (mut here, mut there) = (OutputHash::default(), OutputHash::default());
        let outcome = Flight::new(&scene, scene.seed).run(&mut here);
        let mut wire = InProcess::new(Behaviour::Good);
        let flown = hil::fly(&mut wire, &scene, scene.seed, Faults::default(), Arc::default(), &mut there);
        assert!(flown.ended.is_ok() && flown.report.is_clean(), "{name}: {flown:?}");
        assert_eq!(flown.outcome, outcome, "{name}");
        assert_eq!(there.0.digest(), here.0.digest(), "{name}");
        assert!(wire.board.ended, "the board is told that the flight is over");
        assert_eq!(flown.report.frames, outcome.control_steps);
        let (mean, max) = (flown.report.mean_instructions().unwrap(), flown.report.max_instructions);
        assert!((mean - 1000.5).abs() < 1e-3 && max == 1001);
    }
}

#[test]
fn flipped_bit_loses_one_step_and_nothing_else() {
    let faults = Faults { flip_bit_every: NonZeroU32::new(100), ..Faults::default() };
    let Flown { outcome, ended, report } = fly(&mut InProcess::new(Behaviour::Good), faults);
    assert!(ended.is_ok() && outcome.crash.is_none(), "{ended:?} {outcome:?}");
    assert_eq!((outcome.control_steps, report.frames), (14_000, 14_000));
    assert_eq!(outcome.final_state, ArmState::Disarmed);
    println!("{report:?}");
    // A flip that makes a byte zero splits the frame in two, and the second part loses the next step.
    assert!((140..=160).contains(&report.to_board.corrupt), "{report:?}");
    assert_eq!(report.unanswered, u64::from(report.to_board.corrupt));
    // No frame follows the last damaged one, so its loss is not noticed.
    assert_eq!(report.to_board.lost, 139);
    assert!(!report.is_clean());
    // All frames are damaged: the vehicle never takes off, and the flight still runs to its end.
    let faults = Faults { flip_bit_every: NonZeroU32::new(1), ..Faults::default() };
    let Flown { outcome, ended, report } = fly(&mut InProcess::new(Behaviour::Good), faults);
    assert!(ended.is_ok() && outcome.final_state == ArmState::Disarmed, "{ended:?} {outcome:?}");
    assert_eq!(report.unanswered, 14_000);
}

#[test]
fn dropped_frames_are_counted_and_cause_a_link_loss() {
    let faults = Faults { dropped_us: 9_000_000..9_600_000, ..Faults::default() };
    let Flown { outcome, ended, report } = fly_for(&mut InProcess::new(Behaviour::Good), faults, 25.0);
    assert!(ended.is_ok(), "{ended:?}");
    assert_eq!((report.unanswered, report.to_board.lost, report.to_host.lost), (600, 600, 600));
    assert_eq!(outcome.final_state, ArmState::Disarmed, "{outcome:?}");
}

#[test]
fn damaged_repeated_lost_and_late_answers_are_counted() {
    let none = Received::default();
    let Flown { outcome, ended, report } = with(Behaviour::Damages(1_000));
    assert!(ended.is_ok() && outcome.crash.is_none(), "{ended:?}");
    assert_eq!((report.to_host, report.unanswered), (Received { corrupt: 14, ..none }, 14));

    // A repeated answer changes nothing.
    let Flown { outcome, ended, report } = with(Behaviour::Repeats(1_000));
    assert!(ended.is_ok() && outcome == in_process(), "{ended:?}");
    // The repetition after the last step is not read.
    assert_eq!((report.to_host, report.unanswered), (Received { repeated: 13, ..none }, 0));

    for (behaviour, lost, repeated) in [(Behaviour::Loses(1_000), 13, 0), (Behaviour::Delays(1_000), 13, 13)]
    {
        let mut wire = InProcess { lossy: true, ..InProcess::new(behaviour) };
        let Flown { outcome, ended, report } = fly(&mut wire, Faults::default());
        assert!(ended.is_ok() && outcome.crash.is_none(), "{behaviour:?}: {ended:?}");
        assert_eq!(
            (report.to_host, report.unanswered),
            (Received { lost, repeated, ..none }, 14),
            "{behaviour:?}"
        );
    }
}

#[test]
fn board_reset_in_flight_restarts_and_stays_terminated() {
    let Flown { outcome, ended, report } = with(Behaviour::ResetAfter(8_000));
    assert!(ended.is_ok(), "{ended:?}");
    assert_eq!(report.resets, [Reset { time_us: 8_000_000, by_watchdog: true }]);
    assert_eq!((report.unanswered, report.to_board), (1, Received::default()));
    // The motors stop at a height of 2 m.
    assert_eq!(outcome.final_state, ArmState::Terminated);
    assert!(outcome.crash.is_some_and(|(_, at_s)| (8.0..9.0).contains(&at_s)), "{outcome:?}");
}

#[test]
fn faulty_board_ends_the_flight_with_the_reason() {
    for (behaviour, steps, expected) in [
        (Behaviour::DiesAfter(9_000), 9_000, "the far end has closed the link"),
        (Behaviour::SilentAfter(9_000), 9_000, "the firmware is silent: nothing"),
        (Behaviour::ResetsAlways, 10, "the firmware was reset more than 10 times"),
        (Behaviour::SendsNoise, 0, "77300 bytes without an answer: is this Kestrel's firmware?"),
        (
            Behaviour::Refuses,
            0,
            "the firmware refuses the configuration: it is already in a flight (reset it), or cannot fly this scene",
        ),
        (
            Behaviour::OtherVersion,
            0,
            "the firmware has link version 9, must be 1: build both from the same sources",
        ),
        (
            Behaviour::OtherMessages,
            0,
            "the firmware sends an unknown message: build both from the same sources",
        ),
        (Behaviour::WrongTime, 1, "the firmware answers the step at 1000 µs with the time 0 µs"),
    ] {
        for lossy in [false, true] {
            let mut wire = InProcess { lossy, ..InProcess::new(behaviour) };
            let Flown { outcome, ended, .. } = fly(&mut wire, Faults::default());
            // A wire that may lose frames waits for another 99 frames of a silent board.
            let steps =
                if lossy && matches!(behaviour, Behaviour::SilentAfter(_)) { steps + 99 } else { steps };
            assert_eq!(ended.unwrap_err().to_string(), expected, "{behaviour:?}");
            assert_eq!(outcome.control_steps, steps, "{behaviour:?}, lossy: {lossy}");
        }
    }
}

#[test]
fn stop_flag_ends_the_flight() {
    struct StopAt(u64, Arc<AtomicBool>);
    impl Observer for StopAt {
        fn step(&mut self, view: &StepView) {
            self.1.store(view.time_us >= self.0, Ordering::Relaxed);
        }
    }
    let stop = Arc::<AtomicBool>::default();
    let mut wire = InProcess::new(Behaviour::Good);
    let mut observer = StopAt(2_000_000, stop.clone());
    let flown = hil::fly(&mut wire, &hover(14.0), 7, Faults::default(), stop, &mut observer);
    assert!(matches!(flown.ended, Err(LinkError::Interrupted)));
    assert_eq!(flown.outcome.control_steps, 2_001);
    assert!(wire.board.ended, "the board is told about the end");
}
