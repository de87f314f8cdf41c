//! The program, with a stand-in for the emulator on the path, or for a board at a serial port.
//!
//! The stand-in for the emulator is this test program: a script named `qemu-system-arm` starts it anew for the one
//! test [`the_board`], which is a board only if the environment says so.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use nix::fcntl::OFlag;
use nix::pty::{grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::signal::{Signal, kill};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use nix::unistd::Pid;
use serde_json::Value;

use crate::stand_in::{Board, Habit};

/// The habit of the stand-in, and where it writes its process number once it flies.
const HABIT: &str = "KESTREL_STAND_IN";
const FLYING: &str = "KESTREL_STAND_IN_FLYING";

const HABITS: [(&str, Habit); 6] = [
    ("good", Habit::Good),
    ("dies", Habit::DiesAfter(5_000)),
    ("sleeps", Habit::SilentAfter(5_000)),
    ("busy", Habit::BusyAfter(5_000)),
    ("other version", Habit::OtherVersion),
    ("refuses", Habit::Refuses),
];

#[test]
fn the_board() {
    let Ok(name) = std::env::var(HABIT) else { return };
    let (_, habit) = HABITS.into_iter().find(|(known, _)| *known == name).unwrap();
    let mut down = File::open("hil-down.fifo").unwrap();
    let mut up = File::options().write(true).open("hil-up.fifo").unwrap();
    fs::write("accesses.log", "stand-in: unimplemented device read\n").unwrap();
    let mut board = Board::new(habit);
    let mut bytes = [0; 256];
    loop {
        up.write_all(&std::mem::take(&mut board.sent)).unwrap();
        if board.dead {
            eprintln!("panicked at the end of its steps");
            std::process::exit(1);
        }
        if board.ended {
            return;
        }
        if board.steps() == 2_000 {
            fs::write(std::env::var_os(FLYING).unwrap(), std::process::id().to_string()).unwrap();
        }
        let length = down.read(&mut bytes).unwrap();
        board.take(&bytes[..length]);
    }
}

/// A directory with a stand-in for the emulator, an image that looks like one, and room for temporary files.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        let script = place.path("bin/qemu-system-arm");
        fs::create_dir_all(place.path("bin")).unwrap();
        fs::create_dir_all(place.path("tmp")).unwrap();
        let this = std::env::current_exe().unwrap();
        let text = format!("#!/bin/sh\nexec '{}' program::the_board --exact --nocapture\n", this.display());
        fs::write(&script, text).unwrap();
        fs::set_permissions(&script, fs::Permissions::from_mode(0o755)).unwrap();
        let mut elf = vec![0; 64];
        elf[..4].copy_from_slice(b"\x7fELF");
        elf[18] = 40;
        fs::write(place.path("image"), elf).unwrap();
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// The program's call, for a flight of 14 s.
    fn call(&self, habit: &str, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sim-host"));
        command
            .current_dir(self.0.path())
            .args(["hil", "hover", "--json"])
            .args(arguments)
            .env("PATH", self.path("bin"))
            .env("TMPDIR", self.path("tmp"))
            .env(HABIT, habit)
            .env(FLYING, self.path("flying"))
            .stdin(Stdio::null());
        command
    }

    fn fly(&self, habit: &str, arguments: &[&str]) -> (Value, Option<i32>) {
        let common = ["--qemu", "--image", "image", "--duration", "14"];
        let output = self.call(habit, &[&common, arguments].concat()).output().unwrap();
        self.is_tidy();
        result(&output)
    }

    /// Nothing is left behind.
    fn is_tidy(&self) {
        assert_eq!(fs::read_dir(self.path("tmp")).unwrap().count(), 0, "temporary files are left");
    }

    /// Starts a flight that goes on for ever, and waits until it is under way: the program and the stand-in.
    fn start(&self, arguments: &[&str]) -> (std::process::Child, Pid) {
        let common = ["--qemu", "--image", "image", "--duration", "100000"];
        let mut call = self.call("good", &[&common, arguments].concat());
        let child = call.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let board = eventually(|| fs::read_to_string(self.path("flying")).ok()?.parse().ok());
        (child, Pid::from_raw(board))
    }
}

fn eventually<T>(mut look: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(start.elapsed() < Duration::from_secs(60), "it does not come");
        thread::sleep(Duration::from_millis(5));
    }
}

fn result(output: &Output) -> (Value, Option<i32>) {
    let text = String::from_utf8_lossy(&output.stdout);
    let json = serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {output:?}"));
    (json, output.status.code())
}

fn in_process() -> Value {
    let call = ["fly", "hover", "--duration", "14", "--json"];
    result(&Command::new(env!("CARGO_BIN_EXE_sim-host")).args(call).output().unwrap()).0
}

#[test]
fn a_flight_by_the_pipes_is_summed_up_as_one_in_process() {
    let place = Place::new();
    let (flown, code) = place.fly("good", &["--log", "log.csv", "--report", "report.html"]);
    assert_eq!(code, Some(0), "{flown}");
    let here = in_process();
    for (key, value) in here.as_object().unwrap() {
        let timing = ["wall_s", "steps_per_s", "real_time_factor"].contains(&key.as_str());
        assert!(timing || flown[key] == *value, "{key}: {flown}");
    }
    assert_eq!(
        (&flown["frames"], &flown["unanswered"], &flown["ended_by"]),
        (&14_000.into(), &0.into(), &Value::Null)
    );
    assert_eq!(flown["unmodelled_accesses"], 1);
    assert_eq!(flown["instructions_max"], 1_001);
    assert!(flown["firmware"].as_str().unwrap().ends_with("/image"));
    let rows = fs::read_to_string(place.path("log.csv")).unwrap().lines().count();
    assert_eq!(rows, 14_001);
    assert!(fs::read_to_string(place.path("report.html")).unwrap().contains("</html>"));
}

#[test]
fn people_read_the_same() {
    let place = Place::new();
    let mut call =
        place.call("good", &["--qemu", "--image", "image", "--duration", "14", "--flip-bit-every", "7000"]);
    let output = call.output().unwrap();
    // `--json` comes with the call; without it the same is text.
    assert_eq!(result(&output).1, Some(1));
    let mut call = Command::new(env!("CARGO_BIN_EXE_sim-host"));
    let output = call
        .current_dir(place.0.path())
        .args(["hil", "hover", "--qemu", "--image", "image", "--duration", "14", "--flip-bit-every", "7000"])
        .env("PATH", place.path("bin"))
        .env(HABIT, "good")
        .env(FLYING, place.path("flying"))
        .output()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    for part in [
        "BUT the link has lost or damaged frames",
        "14000, 2 of them without an answer",
        "unmodelled accesses      1",
    ] {
        assert!(text.contains(part), "{text}");
    }
}

#[test]
fn whatever_ends_a_flight_is_said_with_exit_code_1() {
    for (habit, said, steps) in [
        ("dies", "the emulator has ended (exit status: 1)", 5_000),
        ("sleeps", "the firmware is silent: the emulator sleeps, and waits for what nobody will send", 5_000),
        (
            "other version",
            "the firmware speaks version 9 of the link, and this is 1: build both from the same sources",
            0,
        ),
        (
            "refuses",
            "the firmware refuses the configuration: it is in a flight already (reset it), or cannot fly this one",
            0,
        ),
    ] {
        let place = Place::new();
        let (flown, code) = place.fly(habit, &["--log", "log.csv"]);
        assert_eq!((code, flown["ended_by"].as_str()), (Some(1), Some(said)), "{habit}: {flown}");
        assert_eq!(flown["control_steps"], steps, "{habit}");
        let words = flown["last_words"].as_array().unwrap();
        let panicked = words.iter().any(|line| line == "panicked at the end of its steps");
        assert_eq!(panicked, habit == "dies", "{words:?}");
        assert!(!place.path("log.csv").exists(), "{habit}: a log that reads like a short flight");
    }
}

#[test]
fn a_board_that_computes_for_ever_is_silent_by_its_own_time() {
    let (flown, code) = Place::new().fly("busy", &[]);
    let said = "the firmware is silent: no answer in 10 s of the emulator's processor time";
    assert_eq!((code, flown["ended_by"].as_str()), (Some(1), Some(said)), "{flown}");
}

#[test]
fn link_faults_are_flown_through_and_exit_with_1() {
    for (arguments, unanswered) in
        [(&["--flip-bit-every", "7000"][..], 2), (&["--delay-at-s", "9", "--delay-ms", "30"], 30)]
    {
        let (flown, code) = Place::new().fly("good", arguments);
        assert_eq!((code, &flown["unanswered"]), (Some(1), &unanswered.into()), "{flown}");
        assert_eq!(flown["ended_by"], "the link has lost or damaged frames");
        assert_eq!(flown["control_steps"], 14_000);
    }
}

#[test]
fn ctrl_c_ends_board_and_flight_and_leaves_nothing() {
    let place = Place::new();
    let (child, board) = place.start(&["--log", "log.csv"]);
    kill(Pid::from_raw(child.id() as i32), Signal::SIGINT).unwrap();
    let (flown, code) = result(&child.wait_with_output().unwrap());
    assert_eq!((code, flown["ended_by"].as_str()), (Some(1), Some("interrupted")), "{flown}");
    assert!(flown["control_steps"].as_u64().unwrap() >= 2_000);
    assert!(!Path::new(&format!("/proc/{board}")).exists(), "the board is gone");
    assert!(!place.path("log.csv").exists());
    place.is_tidy();
    // Nor is a hidden file left where the log was to be.
    let names: Vec<_> =
        fs::read_dir(place.0.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(!names.iter().any(|name| name.to_string_lossy().starts_with(".kestrel")), "{names:?}");
}

#[test]
fn an_emulator_that_is_killed_is_told_of() {
    let place = Place::new();
    let (child, board) = place.start(&[]);
    kill(board, Signal::SIGKILL).unwrap();
    let (flown, code) = result(&child.wait_with_output().unwrap());
    assert_eq!(
        (code, flown["ended_by"].as_str()),
        (Some(1), Some("the emulator has ended (signal: 9 (SIGKILL))")),
        "{flown}"
    );
    place.is_tidy();
}

#[test]
fn what_is_missing_or_wrong_is_one_line_and_exit_code_2() {
    let place = Place::new();
    fs::write(place.path("text"), "no image").unwrap();
    fs::create_dir(place.path("empty")).unwrap();
    let none = place.path("empty");
    for (path, arguments, said) in [
        (
            Some(&none),
            &["--qemu", "--image", "image"][..],
            "qemu-system-arm: not found: install it, on Debian and Ubuntu by apt-get install qemu-system-arm",
        ),
        (None, &["--qemu", "--image", "text"], "--image = text: must be an ELF image for Arm"),
        (
            None,
            &["--qemu", "--image", "missing"],
            "--image = missing: cannot be read: No such file or directory (os error 2)",
        ),
        (
            None,
            &["--serial", "missing"],
            "--serial = missing: cannot be opened: No such file or directory (os error 2)",
        ),
        #[cfg(not(feature = "firmware-log"))]
        (
            None,
            &["--qemu", "--firmware-log"],
            "--firmware-log: needs a program with the decoder: cargo run --release -p sim-host --features \
             firmware-log -- hil ...",
        ),
        #[cfg(feature = "firmware-log")]
        (
            None,
            &["--qemu", "--firmware-log", "--image", "image"],
            "--firmware-log: the table of log messages cannot be read: Unknown file magic",
        ),
        (
            Some(&none),
            &["--qemu"],
            "firmware: cargo does not run (No such file or directory (os error 2)): name an image by --image FILE",
        ),
    ] {
        let mut call = place.call("good", arguments);
        path.map(|path| call.env("PATH", path).env_remove("CARGO"));
        let output = call.output().unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!((text, output.status.code()), (format!("error: {said}\n"), Some(2)), "{arguments:?}");
        assert!(output.stdout.is_empty());
        place.is_tidy();
    }
    for arguments in [
        &[][..],
        &["--qemu", "--serial", "port"],
        &["--serial", "port", "--image", "image"],
        &["--serial", "port", "--firmware-log"],
        &["--qemu", "--flip-bit-every", "0"],
        &["--qemu", "--delay-at-s", "1"],
        &["--qemu", "--delay-at-s", "-1", "--delay-ms", "5"],
    ] {
        assert_eq!(place.call("good", arguments).output().unwrap().status.code(), Some(2), "{arguments:?}");
    }
}

/// A board at a pseudo terminal: the terminal's name, and the thread that is the board.
fn at_a_terminal(habit: Habit) -> (PathBuf, thread::JoinHandle<()>) {
    // Not for the programs that the tests start: a terminal hangs up when the last has closed it.
    let master = posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = PathBuf::from(ptsname_r(&master).unwrap());
    // This end stays open beside the program's, so that the board does not take the program's coming late for a
    // hang-up. No echo, from the start.
    let beside = File::options().read(true).write(true).open(&name).unwrap();
    let mut settings = tcgetattr(&beside).unwrap();
    cfmakeraw(&mut settings);
    tcsetattr(&beside, SetArg::TCSANOW, &settings).unwrap();
    let board = thread::spawn(move || {
        let (mut port, _beside) = (master, beside);
        let mut board = Board::new(habit);
        let mut bytes = [0; 256];
        while !board.ended && !board.dead {
            port.write_all(&std::mem::take(&mut board.sent)).unwrap();
            let length = port.read(&mut bytes).unwrap();
            board.take(&bytes[..length]);
        }
    });
    (name, board)
}

#[test]
fn a_flight_at_a_serial_port_is_the_same_flight() {
    let place = Place::new();
    let (port, board) = at_a_terminal(Habit::Good);
    let arguments = ["--serial", port.to_str().unwrap(), "--duration", "14"];
    let (flown, code) = result(&place.call("good", &arguments).output().unwrap());
    board.join().unwrap();
    assert_eq!((code, &flown["digest"]), (Some(0), &in_process()["digest"]), "{flown}");
    assert_eq!((flown["firmware"].as_str(), &flown["unmodelled_accesses"]), (port.to_str(), &Value::Null));
}

#[test]
fn a_board_that_is_unplugged_is_told_of() {
    let place = Place::new();
    let (port, board) = at_a_terminal(Habit::DiesAfter(3_000));
    let arguments = ["--serial", port.to_str().unwrap(), "--duration", "14"];
    let (flown, code) = result(&place.call("good", &arguments).output().unwrap());
    board.join().unwrap();
    assert_eq!((code, &flown["control_steps"]), (Some(1), &3_000.into()), "{flown}");
    println!("{}", flown["ended_by"]);
}
