//! Hardware in the loop on QEMU: the firmware's image flies on QEMU's STM32F405, with `sim-host` as its world,
//! through the real arming path, judged on the truth, and compared bit for bit with the flight in process.
//!
//! Each flight is flown twice. Flights without faults on the link are also compared with the flight in process: every
//! word that the flight code outputs (pulses, whether they are driven, state, event, attitude) and the digest of truth
//! and pulses.

use std::fs::File;
use std::io::Read as _;
use std::num::NonZeroU32;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use flight_core::ArmState::{self, Armed, Arming, Descent, Disarmed, Terminated};
use flight_core::arming::{Cause, Event};
use sim_host::flight::{Flight, Observer, Outcome, StepView};
use sim_host::hil::{self, Faults, Flown, LinkError, Qemu, QemuExit, Received, Reset, Serial};
use sim_host::scene::Scene;

/// Returns the image whose link is QEMU's pipes. It is built once.
fn image() -> &'static Path {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    BUILT.get_or_init(|| hil::build(hil::PIPES).unwrap())
}

/// The outputs of the flight code: the words of each step, and all events.
#[derive(Default, PartialEq)]
struct Words {
    steps: Vec<[u32; 11]>,
    events: Vec<(f64, Event)>,
}

impl Observer for Words {
    fn step(&mut self, view: &StepView) {
        let out = view.output;
        let [p1, p2, p3, p4] = out.pulses_us.map(f32::to_bits);
        let [w, x, y, z] = out.attitude.to_array().map(f32::to_bits);
        let driven = u32::from(out.driven);
        self.steps.push([view.time_us as u32, driven, out.state as u32, p1, p2, p3, p4, w, x, y, z]);
        self.events.extend(out.event.map(|event| (view.time_us as f64 * 1e-6, event)));
    }
}

impl Words {
    /// Returns the events after arming: time, s, new state and cause.
    fn after_arming(&self) -> Vec<(f64, ArmState, Cause)> {
        let flown = self.events.iter().skip_while(|(_, event)| event.to != Armed).skip(1);
        flown.map(|(time_s, event)| (*time_s, event.to, event.cause)).collect()
    }
}

/// Flies a scene twice on QEMU, and checks that every word is the same.
fn fly_twice_on_qemu(scene: &Scene, faults: Faults) -> (Flown, Words, QemuExit) {
    let (again, words_again, _) = fly_once_on_qemu(scene, faults.clone());
    let (flown, words, exit) = fly_once_on_qemu(scene, faults);
    assert_eq!((&again.outcome, &again.report), (&flown.outcome, &flown.report), "{}", scene.name);
    assert!(words_again == words, "{}: the two flights differ", scene.name);
    (flown, words, exit)
}

fn fly_once_on_qemu(scene: &Scene, faults: Faults) -> (Flown, Words, QemuExit) {
    let mut qemu = Qemu::start(image()).unwrap();
    let mut words = Words::default();
    let flown = hil::fly(&mut qemu, scene, scene.seed, faults, Arc::default(), &mut words);
    let exit = qemu.end();
    (flown, words, exit)
}

fn in_process(scene: &Scene) -> (Outcome, Words) {
    let mut words = Words::default();
    let outcome = Flight::new(scene, scene.seed).run(&mut words);
    (outcome, words)
}

/// Flies a scene on QEMU and in process, and checks that every word is the same.
fn assert_equal_on_qemu_and_in_process(scene: &Scene) -> (Outcome, Words) {
    let start = Instant::now();
    let (Flown { outcome, ended, report }, words, exit) = fly_twice_on_qemu(scene, Faults::default());
    let wall_s = start.elapsed().as_secs_f64() / 2.0;
    let name = &scene.name;
    assert!(ended.is_ok() && exit.is_success(), "{name}: {ended:?} {exit:?}");
    assert!(report.is_clean() && report.missed_deadlines == 0, "{name}: {report:?}");
    assert_eq!(exit.unmodelled, [""; 0], "{name}");
    let (outcome_here, here) = in_process(scene);
    for (board, host) in words.steps.iter().zip(&here.steps) {
        assert_eq!(board, host, "{name}: words of the board and of the host");
    }
    assert_eq!((&outcome, &words.events), (&outcome_here, &here.events), "{name}");
    println!(
        "{name}: {} steps are equal, digest {:016x}; {:.1} × real time; {:.0} instructions from sample to motors, \
         at most {}",
        outcome.control_steps,
        outcome.digest,
        outcome.flown_s() / wall_s,
        report.mean_instructions().unwrap(),
        report.max_instructions,
    );
    (outcome, words)
}

fn scene(name: &str) -> Scene {
    Scene::load(name).unwrap()
}

/// Returns the scene `hover` with these tables added.
fn hover_with(tables: &str) -> Scene {
    Scene::parse("altered", &format!("include = \"hover\"\n{tables}")).unwrap()
}

#[test]
#[ignore = "needs qemu-system-arm"]
fn hil_flights_equal_in_process_flights_bit_for_bit() {
    for name in ["hover", "steps", "windy-landing"] {
        let scene = scene(name);
        let (outcome, _) = assert_equal_on_qemu_and_in_process(&scene);
        assert_eq!((outcome.crash, outcome.final_state), (None, Disarmed), "{name}: {outcome:?}");
    }
}

#[test]
#[ignore = "needs qemu-system-arm"]
fn hil_equals_in_process_with_late_and_lost_samples() {
    for name in ["bad-link", "rough-sampling", "whole-drive"] {
        assert_equal_on_qemu_and_in_process(&scene(name));
    }
}

#[test]
#[ignore = "needs qemu-system-arm"]
fn hil_failures_in_flight_end_in_the_documented_state() {
    let fault = |text: &str| hover_with(&format!("[[fault]]\nat_s = 15.0\n{text}"));
    let stuck = "kind = \"stuck_axis\"\nsensor = \"gyro\"\naxis = \"y\"\n";
    // A charge that is enough to arm, and lasts for half a minute.
    let weak = hover_with(
        "[effects.vehicle.battery_sag]\ncells = 3\ncapacity_mah = 400.0\nresistance_mohm = 60.0\n\
         efficiency = 0.6\ncharge = 0.06\n",
    );
    for (what, scene, state, cause, noticed_s) in [
        (
            "receiver silent",
            hover_with("[effects.link.outage]\nat_s = 15.0\n"),
            Descent,
            Cause::RcLost,
            Some(15.48),
        ),
        ("sensor dead", fault("kind = \"dead\"\nsensor = \"imu\"\n"), Terminated, Cause::ImuLost, Some(15.1)),
        (
            "invalid code",
            fault("kind = \"invalid_code\"\nsensor = \"imu\"\n"),
            Terminated,
            Cause::ImuLost,
            Some(15.1),
        ),
        ("axis stuck", fault(stuck), Terminated, Cause::ImuStuck, Some(15.1)),
        ("battery critical", weak, Descent, Cause::BatteryCritical, None),
    ] {
        let (_, words) = assert_equal_on_qemu_and_in_process(&scene);
        let (at_s, to, why) = words.after_arming()[0];
        println!("{what}: {} after {at_s:.3} s, {}", to.name(), why.text());
        assert_eq!((to, why), (state, cause), "{what}");
        assert!(noticed_s.is_none_or(|s| (at_s - s).abs() < 3e-3), "{what}: {at_s}");
    }
}

fn held_back(us: Range<u64>) -> Faults {
    Faults { dropped_us: us, ..Faults::default() }
}

/// The counters of a side that has missed this many frames.
fn lost(frames: u32) -> Received {
    Received { lost: frames, ..Received::default() }
}

#[test]
#[ignore = "needs qemu-system-arm"]
fn hil_link_gap_over_half_a_second_is_link_loss() {
    // There are no frames for 0.05 s. The flight continues.
    let (Flown { outcome, ended, report }, words, exit) =
        fly_twice_on_qemu(&scene("hover"), held_back(15_000_000..15_050_000));
    assert!(ended.is_ok() && exit.is_success(), "{ended:?}");
    assert_eq!((report.to_board, report.to_host), (lost(50), lost(50)));
    assert_eq!((outcome.crash, outcome.final_state), (None, Disarmed));
    assert!(matches!(words.after_arming()[..], [(_, Disarmed, Cause::Pilot)]), "{:?}", words.events);

    // A gap of more than 0.5 s: the link to the pilot is lost, and recovers.
    let (Flown { outcome, ended, report }, words, exit) =
        fly_twice_on_qemu(&scene("hover"), held_back(15_000_000..15_600_000));
    assert!(ended.is_ok() && exit.is_success(), "{ended:?}");
    assert_eq!((report.to_board, report.to_host), (lost(600), lost(600)));
    let [(lost_s, Descent, Cause::RcLost), (back_s, Armed, Cause::RcBack), (_, Disarmed, Cause::Pilot)] =
        words.after_arming()[..]
    else {
        panic!("{:?}", words.events)
    };
    assert!((lost_s - 15.6).abs() < 2e-3 && (back_s - 16.1).abs() < 2e-2, "{lost_s} {back_s}");
    assert_eq!(outcome.final_state, Disarmed);
}

#[test]
#[ignore = "needs qemu-system-arm"]
fn hil_without_frames_the_watchdog_resets_into_terminated() {
    let mut scene = scene("static");
    scene.set_duration(20.0).unwrap();
    let (Flown { outcome, ended, report }, _, exit) =
        fly_twice_on_qemu(&scene, held_back(3_000_000..4_500_000));
    assert!(ended.is_ok() && exit.is_success(), "{ended:?}");
    // There is one reset. Afterwards frames arrive again.
    assert_eq!(report.resets, [Reset { time_us: 4_500_000, by_watchdog: true }]);
    assert_eq!(outcome.final_state, Terminated);
}

#[test]
#[ignore = "needs qemu-system-arm"]
fn hil_bit_flips_are_counted_and_prevent_arming() {
    let faults = Faults { flip_bit_every: NonZeroU32::new(1_000), ..Faults::default() };
    let (Flown { outcome, ended, report }, words, exit) = fly_twice_on_qemu(&scene("hover"), faults);
    assert!(ended.is_ok() && exit.is_success(), "{ended:?}");
    assert!(!report.is_clean());
    assert_eq!((outcome.control_steps, outcome.crash), (30_000, None));
    assert!((30..35).contains(&report.to_board.corrupt), "{report:?}");
    // The firmware counts a missed deadline every second and does not arm.
    let [(_, Event { from: Disarmed, to: Disarmed, cause: Cause::Overload })] = words.events[..] else {
        panic!("{:?}", words.events)
    };

    // With rare bit flips it arms and flies; each flip costs one sample.
    let faults = Faults { flip_bit_every: NonZeroU32::new(4_999), ..Faults::default() };
    let (Flown { outcome, ended, report }, words, _) = fly_twice_on_qemu(&scene("hover"), faults);
    assert!(ended.is_ok(), "{ended:?}");
    assert_eq!((outcome.crash, outcome.final_state), (None, Disarmed), "{report:?}");
    assert!((6..=8).contains(&report.to_board.corrupt), "{report:?}");
    let states: Vec<ArmState> = words.events.iter().map(|(_, event)| event.to).collect();
    assert_eq!(states, [Arming, Armed, Disarmed]);
}

#[test]
#[ignore = "needs qemu-system-arm"]
fn killed_qemu_ends_the_flight() {
    struct KillAt(u64, u32);
    impl Observer for KillAt {
        fn step(&mut self, view: &StepView) {
            if view.time_us == self.0 {
                assert!(Command::new("kill").args(["-9", &self.1.to_string()]).status().unwrap().success());
            }
        }
    }
    let scene = scene("hover");
    let mut qemu = Qemu::start(image()).unwrap();
    let mut killer = KillAt(10_000_000, qemu.id());
    let flown = hil::fly(&mut qemu, &scene, scene.seed, Faults::default(), Arc::default(), &mut killer);
    assert!(matches!(flown.ended, Err(LinkError::Closed)), "{:?}", flown.ended);
    assert!((10_000..10_100).contains(&flown.outcome.control_steps), "{:?}", flown.outcome);
    assert_eq!(qemu.end().description(), "QEMU has ended (signal: 9 (SIGKILL))");
}

#[test]
#[ignore = "needs qemu-system-arm"]
fn hil_over_a_serial_port_equals_in_process() {
    struct KilledOnDrop(Child);
    impl Drop for KilledOnDrop {
        fn drop(&mut self) {
            // An error means that the process has already ended.
            let _ = self.0.kill();
            let _ = self.0.wait();
        }
    }
    let image = hil::build(hil::USART).unwrap();
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let output_file = directory.join("hil-serial.txt");
    let out = File::create(&output_file).unwrap();
    // USART1 to 5 are not connected; USART6 is connected to a pseudo terminal.
    let qemu = Command::new("qemu-system-arm")
        .args(["-machine", "netduinoplus2", "-icount", "shift=2,sleep=off"])
        .args(["-semihosting-config", "enable=on,target=native", "-display", "none", "-monitor", "none"])
        .args(["-serial", "null"].repeat(5))
        .args(["-serial", "pty", "-kernel"])
        .arg(image)
        .stdin(Stdio::null())
        .stdout(out.try_clone().unwrap())
        .stderr(out)
        .spawn()
        .expect("qemu-system-arm runs: apt-get install qemu-system-arm");
    let _qemu = KilledOnDrop(qemu);
    let start = Instant::now();
    let port = loop {
        let mut text = String::new();
        File::open(&output_file).unwrap().read_to_string(&mut text).unwrap();
        if let Some(name) = text.split_ascii_whitespace().find(|word| word.starts_with("/dev/")) {
            break PathBuf::from(name);
        }
        assert!(start.elapsed() < Duration::from_secs(30), "{text}");
        std::thread::sleep(Duration::from_millis(20));
    };
    // QEMU reads a terminal byte by byte, so that a step takes some milliseconds.
    let mut scene = scene("static");
    scene.set_duration(3.0).unwrap();
    let mut serial = Serial::open(&port).unwrap();
    let mut words = Words::default();
    let start = Instant::now();
    let flown = hil::fly(&mut serial, &scene, scene.seed, Faults::default(), Arc::default(), &mut words);
    println!("{:.1} × real time", flown.outcome.flown_s() / start.elapsed().as_secs_f64());
    assert!(flown.ended.is_ok() && flown.report.is_clean(), "{:?} {:?}", flown.ended, flown.report);
    let (outcome, here) = in_process(&scene);
    assert_eq!((flown.outcome, words.steps, words.events), (outcome, here.steps, here.events));
}
