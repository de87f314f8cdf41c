//! The program `sim-host` with a stand-in for QEMU in the search path, or for a board at a serial port.
//!
//! The stand-in for QEMU is this test program: a script named `qemu-system-arm` starts it again with only the test
//! [`stand_in_for_qemu`], which acts as a board only if an environment variable is set.

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

use crate::stand_in::{Behaviour, Board};

/// Environment variable with the behaviour of the stand-in.
const BEHAVIOUR: &str = "KESTREL_STAND_IN";
/// Environment variable with the file into which the stand-in writes its process number in flight.
const FLYING: &str = "KESTREL_STAND_IN_FLYING";

const BEHAVIOURS: [(&str, Behaviour); 6] = [
    ("good", Behaviour::Good),
    ("dies", Behaviour::DiesAfter(5_000)),
    ("sleeps", Behaviour::SilentAfter(5_000)),
    ("busy", Behaviour::BusyAfter(5_000)),
    ("other version", Behaviour::OtherVersion),
    ("refuses", Behaviour::Refuses),
];

#[test]
fn stand_in_for_qemu() {
    let Ok(name) = std::env::var(BEHAVIOUR) else { return };
    let (_, behaviour) = BEHAVIOURS.into_iter().find(|(known, _)| *known == name).unwrap();
    let mut down = File::open("hil-down.fifo").unwrap();
    let mut up = File::options().write(true).open("hil-up.fifo").unwrap();
    fs::write("accesses.log", "stand-in: unimplemented device read\n").unwrap();
    let mut board = Board::new(behaviour);
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
        board.receive_bytes(&bytes[..length]);
    }
}

/// A directory with the stand-in for QEMU, a file with the header of an image, and a directory for temporary files.
struct Workspace(tempfile::TempDir);

impl Workspace {
    fn new() -> Self {
        let workspace = Self(tempfile::tempdir().unwrap());
        let script = workspace.path("bin/qemu-system-arm");
        fs::create_dir_all(workspace.path("bin")).unwrap();
        fs::create_dir_all(workspace.path("tmp")).unwrap();
        let this = std::env::current_exe().unwrap();
        let text =
            format!("#!/bin/sh\nexec '{}' program::stand_in_for_qemu --exact --nocapture\n", this.display());
        fs::write(&script, text).unwrap();
        fs::set_permissions(&script, fs::Permissions::from_mode(0o755)).unwrap();
        let mut elf = vec![0; 64];
        elf[..4].copy_from_slice(b"\x7fELF");
        elf[18] = 40;
        fs::write(workspace.path("image"), elf).unwrap();
        workspace
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Returns the command for a flight of the hover scene.
    fn call(&self, behaviour: &str, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sim-host"));
        command
            .current_dir(self.0.path())
            .args(["hil", "hover", "--json"])
            .args(arguments)
            .env("PATH", self.path("bin"))
            .env("TMPDIR", self.path("tmp"))
            .env(BEHAVIOUR, behaviour)
            .env(FLYING, self.path("flying"))
            .stdin(Stdio::null());
        command
    }

    fn fly(&self, behaviour: &str, arguments: &[&str]) -> (Value, Option<i32>) {
        let common = ["--qemu", "--image", "image", "--duration", "14"];
        let output = self.call(behaviour, &[&common, arguments].concat()).output().unwrap();
        self.assert_tidy();
        result(&output)
    }

    /// Checks that no temporary file is left.
    fn assert_tidy(&self) {
        assert_eq!(fs::read_dir(self.path("tmp")).unwrap().count(), 0, "temporary files are left");
    }

    /// Starts a very long flight and waits until it runs. Returns the program and the process number of the stand-in.
    fn start(&self, arguments: &[&str]) -> (std::process::Child, Pid) {
        let common = ["--qemu", "--image", "image", "--duration", "100000"];
        let mut call = self.call("good", &[&common, arguments].concat());
        let child = call.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let board = eventually(|| fs::read_to_string(self.path("flying")).ok()?.parse().ok());
        (child, Pid::from_raw(board))
    }
}

/// Waits until `look` returns a value.
fn eventually<T>(mut look: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(start.elapsed() < Duration::from_secs(60), "no value within 60 s");
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
fn flight_over_pipes_has_the_summary_of_one_in_process() {
    let workspace = Workspace::new();
    let (flown, code) = workspace.fly("good", &["--log", "log.csv", "--report", "report.html"]);
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
    let rows = fs::read_to_string(workspace.path("log.csv")).unwrap().lines().count();
    assert_eq!(rows, 14_001);
    assert!(fs::read_to_string(workspace.path("report.html")).unwrap().contains("</html>"));
}

#[test]
fn text_and_json_have_the_same_result() {
    let workspace = Workspace::new();
    let mut call = workspace
        .call("good", &["--qemu", "--image", "image", "--duration", "14", "--flip-bit-every", "7000"]);
    let output = call.output().unwrap();
    // The command above has `--json`; the one below prints text.
    assert_eq!(result(&output).1, Some(1));
    let mut call = Command::new(env!("CARGO_BIN_EXE_sim-host"));
    let output = call
        .current_dir(workspace.0.path())
        .args(["hil", "hover", "--qemu", "--image", "image", "--duration", "14", "--flip-bit-every", "7000"])
        .env("PATH", workspace.path("bin"))
        .env(BEHAVIOUR, "good")
        .env(FLYING, workspace.path("flying"))
        .output()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    for part in [
        "BUT the link lost or damaged frames",
        "14000, 2 of them without an answer",
        "unmodelled accesses      1",
    ] {
        assert!(text.contains(part), "{text}");
    }
}

#[test]
fn aborted_flight_gives_the_reason_and_exit_code_1() {
    for (behaviour, expected, steps) in [
        ("dies", "QEMU has ended (exit status: 1)", 5_000),
        (
            "sleeps",
            "the firmware is silent: QEMU sleeps: it waits for a frame, and none is on the way",
            5_000,
        ),
        ("other version", "the firmware has link version 9, must be 1: build both from the same sources", 0),
        (
            "refuses",
            "the firmware refuses the configuration: it is already in a flight (reset it), or cannot fly this scene",
            0,
        ),
    ] {
        let workspace = Workspace::new();
        let (flown, code) = workspace.fly(behaviour, &["--log", "log.csv"]);
        assert_eq!((code, flown["ended_by"].as_str()), (Some(1), Some(expected)), "{behaviour}: {flown}");
        assert_eq!(flown["control_steps"], steps, "{behaviour}");
        let words = flown["output_tail"].as_array().unwrap();
        let panicked = words.iter().any(|line| line == "panicked at the end of its steps");
        assert_eq!(panicked, behaviour == "dies", "{words:?}");
        assert!(!workspace.path("log.csv").exists(), "{behaviour}: an incomplete log was written");
    }
}

#[test]
fn board_in_an_endless_loop_counts_as_silent() {
    let (flown, code) = Workspace::new().fly("busy", &[]);
    let expected = "the firmware is silent: no answer in 10 s of QEMU's processor time";
    assert_eq!((code, flown["ended_by"].as_str()), (Some(1), Some(expected)), "{flown}");
}

#[test]
fn flight_with_link_faults_ends_with_exit_code_1() {
    for (arguments, unanswered) in
        [(&["--flip-bit-every", "7000"][..], 2), (&["--drop-at-s", "9", "--drop-for-ms", "30"], 30)]
    {
        let (flown, code) = Workspace::new().fly("good", arguments);
        assert_eq!((code, &flown["unanswered"]), (Some(1), &unanswered.into()), "{flown}");
        assert_eq!(flown["ended_by"], "the link lost or damaged frames");
        assert_eq!(flown["control_steps"], 14_000);
    }
}

#[test]
fn ctrl_c_ends_board_and_flight_and_leaves_no_file() {
    let workspace = Workspace::new();
    let (child, board) = workspace.start(&["--log", "log.csv"]);
    kill(Pid::from_raw(child.id() as i32), Signal::SIGINT).unwrap();
    let (flown, code) = result(&child.wait_with_output().unwrap());
    assert_eq!((code, flown["ended_by"].as_str()), (Some(130), Some("interrupted")), "{flown}");
    assert!(flown["control_steps"].as_u64().unwrap() >= 2_000);
    assert!(!Path::new(&format!("/proc/{board}")).exists(), "the board has ended");
    assert!(!workspace.path("log.csv").exists());
    workspace.assert_tidy();
    // No hidden temporary file is left next to the log.
    let names: Vec<_> =
        fs::read_dir(workspace.0.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(!names.iter().any(|name| name.to_string_lossy().starts_with(".kestrel")), "{names:?}");
}

#[test]
fn killed_qemu_is_reported() {
    let workspace = Workspace::new();
    let (child, board) = workspace.start(&[]);
    kill(board, Signal::SIGKILL).unwrap();
    let (flown, code) = result(&child.wait_with_output().unwrap());
    assert_eq!(
        (code, flown["ended_by"].as_str()),
        (Some(1), Some("QEMU has ended (signal: 9 (SIGKILL))")),
        "{flown}"
    );
    workspace.assert_tidy();
}

#[test]
fn bad_input_gives_a_one_line_error_and_exit_code_2() {
    let workspace = Workspace::new();
    fs::write(workspace.path("text"), "no image").unwrap();
    fs::create_dir(workspace.path("empty")).unwrap();
    let empty = workspace.path("empty");
    for (path, arguments, expected) in [
        (
            Some(&empty),
            &["--qemu", "--image", "image"][..],
            "qemu-system-arm: not found: install it; on Debian and Ubuntu: apt-get install qemu-system-arm",
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
            "--firmware-log: needs a build with the decoder: cargo run --release -p sim-host --features \
             firmware-log -- hil ...",
        ),
        #[cfg(feature = "firmware-log")]
        (
            None,
            &["--qemu", "--firmware-log", "--image", "image"],
            "--firmware-log: the table of log messages cannot be read: Unknown file magic",
        ),
        (
            Some(&empty),
            &["--qemu"],
            "firmware: cargo does not start (No such file or directory (os error 2)): give an image by --image FILE",
        ),
    ] {
        let mut call = workspace.call("good", arguments);
        path.map(|path| call.env("PATH", path).env_remove("CARGO"));
        let output = call.output().unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!((text, output.status.code()), (format!("error: {expected}\n"), Some(2)), "{arguments:?}");
        assert!(output.stdout.is_empty());
        workspace.assert_tidy();
    }
    for arguments in [
        &[][..],
        &["--qemu", "--serial", "port"],
        &["--serial", "port", "--image", "image"],
        &["--serial", "port", "--firmware-log"],
        &["--qemu", "--flip-bit-every", "0"],
        &["--qemu", "--drop-at-s", "1"],
        &["--qemu", "--drop-at-s", "-1", "--drop-for-ms", "5"],
    ] {
        assert_eq!(
            workspace.call("good", arguments).output().unwrap().status.code(),
            Some(2),
            "{arguments:?}"
        );
    }
}

/// Starts a board at a pseudo terminal. Returns the terminal's name and the board's thread.
fn at_a_terminal(behaviour: Behaviour) -> (PathBuf, thread::JoinHandle<()>) {
    // O_CLOEXEC: child processes must not inherit the terminal, which hangs up only when the last user has closed it.
    let master = posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = PathBuf::from(ptsname_r(&master).unwrap());
    // This process also keeps the other end open, so that the board does not see a hang-up before the program opens it.
    // The settings switch the echo off.
    let other_end = File::options().read(true).write(true).open(&name).unwrap();
    let mut settings = tcgetattr(&other_end).unwrap();
    cfmakeraw(&mut settings);
    tcsetattr(&other_end, SetArg::TCSANOW, &settings).unwrap();
    let board = thread::spawn(move || {
        let (mut port, _other_end) = (master, other_end);
        let mut board = Board::new(behaviour);
        let mut bytes = [0; 256];
        while !board.ended && !board.dead {
            port.write_all(&std::mem::take(&mut board.sent)).unwrap();
            let length = port.read(&mut bytes).unwrap();
            board.receive_bytes(&bytes[..length]);
        }
    });
    (name, board)
}

#[test]
fn flight_at_a_serial_port_equals_the_one_in_process() {
    let workspace = Workspace::new();
    let (port, board) = at_a_terminal(Behaviour::Good);
    let arguments = ["--serial", port.to_str().unwrap(), "--duration", "14"];
    let (flown, code) = result(&workspace.call("good", &arguments).output().unwrap());
    board.join().unwrap();
    assert_eq!((code, &flown["digest"]), (Some(0), &in_process()["digest"]), "{flown}");
    assert_eq!((flown["firmware"].as_str(), &flown["unmodelled_accesses"]), (port.to_str(), &Value::Null));
}

#[test]
fn unplugged_board_is_reported() {
    let workspace = Workspace::new();
    let (port, board) = at_a_terminal(Behaviour::DiesAfter(3_000));
    let arguments = ["--serial", port.to_str().unwrap(), "--duration", "14"];
    let (flown, code) = result(&workspace.call("good", &arguments).output().unwrap());
    board.join().unwrap();
    assert_eq!((code, &flown["control_steps"]), (Some(1), &3_000.into()), "{flown}");
    println!("{}", flown["ended_by"]);
}
