//! Flights over the link, by a board that stands in for the firmware: in this process, where every disturbance comes
//! at its step; and through the program, with pipes, a terminal and signals.

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

use stand_in::{Board, Habit};

/// A board in this process.
struct InProcess {
    board: Board,
    coming: VecDeque<u8>,
    /// The wire may lose frames, as a serial port may.
    lossy: bool,
    vain: u32,
}

impl InProcess {
    fn new(habit: Habit) -> Self {
        Self { board: Board::new(habit), coming: VecDeque::new(), lossy: false, vain: 0 }
    }
}

impl Read for InProcess {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.coming.extend(self.board.sent.drain(..));
        if self.coming.is_empty() {
            return if self.board.dead { Ok(0) } else { Err(io::ErrorKind::WouldBlock.into()) };
        }
        self.vain = 0;
        self.coming.read(buffer)
    }
}

impl Write for InProcess {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.board.take(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Wire for InProcess {
    fn on_timeout(&mut self) -> OnTimeout {
        self.vain += 1;
        if self.lossy && self.vain < 100 { OnTimeout::NextFrame } else { OnTimeout::Silent("nothing".into()) }
    }
}

/// Everything that an autopilot says, in a hash.
#[derive(Default)]
struct Words(Xxh3);

impl Observer for Words {
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

/// Flies by a board of this habit.
fn with(habit: Habit) -> Flown {
    fly(&mut InProcess::new(habit), Faults::default())
}

fn in_process() -> Outcome {
    Flight::new(&hover(14.0), 7).run(&mut ())
}

#[test]
fn over_the_link_it_is_the_same_flight_bit_for_bit() {
    for name in ["hover", "windy-landing", "bad-link", "rough-sampling", "weak-battery"] {
        let scene = Scene::load(name).unwrap();
        let (mut here, mut there) = (Words::default(), Words::default());
        let outcome = Flight::new(&scene, scene.seed).run(&mut here);
        let mut wire = InProcess::new(Habit::Good);
        let flown = hil::fly(&mut wire, &scene, scene.seed, Faults::default(), Arc::default(), &mut there);
        assert!(flown.ended.is_ok() && flown.report.is_clean(), "{name}: {flown:?}");
        assert_eq!(flown.outcome, outcome, "{name}");
        assert_eq!(there.0.digest(), here.0.digest(), "{name}");
        assert!(wire.board.ended, "the board is told that it is over");
        assert_eq!(flown.report.frames, outcome.control_steps);
        let (mean, most) = (flown.report.mean_instructions().unwrap(), flown.report.most_instructions);
        assert!((mean - 1000.5).abs() < 1e-3 && most == 1001);
    }
}

#[test]
fn a_flipped_bit_costs_a_step_and_nothing_else() {
    let faults = Faults { flip_bit_every: NonZeroU32::new(100), ..Faults::default() };
    let Flown { outcome, ended, report } = fly(&mut InProcess::new(Habit::Good), faults);
    assert!(ended.is_ok() && outcome.crash.is_none(), "{ended:?} {outcome:?}");
    assert_eq!((outcome.control_steps, report.frames), (14_000, 14_000));
    assert_eq!(outcome.final_state, ArmState::Disarmed);
    println!("{report:?}");
    // A flip that makes a zero makes two frames of one, and the second costs the step after.
    assert!((140..=160).contains(&report.to_board.corrupt), "{report:?}");
    assert_eq!(report.unanswered, u64::from(report.to_board.corrupt));
    // The last of them is followed by nothing, so that nothing shows that it is missing.
    assert_eq!(report.to_board.lost, 139);
    assert!(!report.is_clean());
    // Every frame is damaged: the flight never begins, and still comes to its end.
    let faults = Faults { flip_bit_every: NonZeroU32::new(1), ..Faults::default() };
    let Flown { outcome, ended, report } = fly(&mut InProcess::new(Habit::Good), faults);
    assert!(ended.is_ok() && outcome.final_state == ArmState::Disarmed, "{ended:?} {outcome:?}");
    assert_eq!(report.unanswered, 14_000);
}

#[test]
fn held_back_frames_are_missing_on_both_sides_and_the_pilot_is_lost_and_found() {
    let faults = Faults { held_back_us: 9_000_000..9_600_000, ..Faults::default() };
    let Flown { outcome, ended, report } = fly_for(&mut InProcess::new(Habit::Good), faults, 25.0);
    assert!(ended.is_ok(), "{ended:?}");
    assert_eq!((report.unanswered, report.to_board.lost, report.to_host.lost), (600, 600, 600));
    assert_eq!(outcome.final_state, ArmState::Disarmed, "{outcome:?}");
}

#[test]
fn answers_that_are_damaged_repeated_lost_or_late_are_counted_and_flown_on_without() {
    let none = Received::default();
    let Flown { outcome, ended, report } = with(Habit::Damages(1_000));
    assert!(ended.is_ok() && outcome.crash.is_none(), "{ended:?}");
    assert_eq!((report.to_host, report.unanswered), (Received { corrupt: 14, ..none }, 14));

    // What comes twice changes nothing.
    let Flown { outcome, ended, report } = with(Habit::Repeats(1_000));
    assert!(ended.is_ok() && outcome == in_process(), "{ended:?}");
    // That of the last step is not read any more.
    assert_eq!((report.to_host, report.unanswered), (Received { repeated: 13, ..none }, 0));

    for (habit, lost, repeated) in [(Habit::Loses(1_000), 13, 0), (Habit::Delays(1_000), 13, 13)] {
        let mut wire = InProcess { lossy: true, ..InProcess::new(habit) };
        let Flown { outcome, ended, report } = fly(&mut wire, Faults::default());
        assert!(ended.is_ok() && outcome.crash.is_none(), "{habit:?}: {ended:?}");
        assert_eq!(
            (report.to_host, report.unanswered),
            (Received { lost, repeated, ..none }, 14),
            "{habit:?}"
        );
    }
}

#[test]
fn a_board_that_is_reset_is_started_again_and_refuses_to_fly_on() {
    let Flown { outcome, ended, report } = with(Habit::ResetAfter(8_000));
    assert!(ended.is_ok(), "{ended:?}");
    assert_eq!(report.resets, [Reset { time_us: 8_000_000, by_watchdog: true }]);
    assert_eq!((report.unanswered, report.to_board), (1, Received::default()));
    // The motors have stopped two metres up.
    assert_eq!(outcome.final_state, ArmState::Terminated);
    assert!(outcome.crash.is_some_and(|(_, at_s)| (8.0..9.0).contains(&at_s)), "{outcome:?}");
}

#[test]
fn a_board_that_does_not_fly_ends_the_flight_and_says_why() {
    for (habit, steps, said) in [
        (Habit::DiesAfter(9_000), 9_000, "the far end of the link is gone"),
        (Habit::SilentAfter(9_000), 9_000, "the firmware is silent: nothing"),
        (Habit::ResetsForEver, 10, "the firmware has been reset more than 10 times"),
        (Habit::Babbles, 0, "77300 bytes have come without an answer: is it this firmware?"),
        (
            Habit::Refuses,
            0,
            "the firmware refuses the configuration: it is in a flight already (reset it), or cannot fly this one",
        ),
        (
            Habit::OtherVersion,
            0,
            "the firmware speaks version 9 of the link, and this is 1: build both from the same sources",
        ),
        (
            Habit::OtherMessages,
            0,
            "the firmware sends what this program does not know: build both from the same sources",
        ),
        (Habit::WrongTime, 1, "the firmware answers the step of 1000 µs with 0 µs"),
    ] {
        for lossy in [false, true] {
            let mut wire = InProcess { lossy, ..InProcess::new(habit) };
            let Flown { outcome, ended, .. } = fly(&mut wire, Faults::default());
            // A wire that may lose frames gives a silent board another hundred.
            let steps = if lossy && matches!(habit, Habit::SilentAfter(_)) { steps + 99 } else { steps };
            assert_eq!(ended.unwrap_err().to_string(), said, "{habit:?}");
            assert_eq!(outcome.control_steps, steps, "{habit:?}, lossy: {lossy}");
        }
    }
}

#[test]
fn whoever_wants_it_to_end_ends_it() {
    struct StopAt(u64, Arc<AtomicBool>);
    impl Observer for StopAt {
        fn step(&mut self, view: &StepView) {
            self.1.store(view.time_us >= self.0, Ordering::Relaxed);
        }
    }
    let stop = Arc::<AtomicBool>::default();
    let mut wire = InProcess::new(Habit::Good);
    let mut observer = StopAt(2_000_000, stop.clone());
    let flown = hil::fly(&mut wire, &hover(14.0), 7, Faults::default(), stop, &mut observer);
    assert!(matches!(flown.ended, Err(LinkError::Interrupted)));
    assert_eq!(flown.outcome.control_steps, 2_001);
    assert!(wire.board.ended, "the board is told");
}
