//! QEMU's `netduinoplus2`, an STM32F405, at the other end of two named pipes.
//!
//! The pipes, the emulator's log and what it prints are in a directory of their own, which goes when the emulator
//! does. The firmware opens `hil-down.fifo` to read and `hil-up.fifo` to write, by semihosting. With
//! `-icount shift=2,sleep=off` the emulator's time is that of its instructions, and a flight is the same every time.
//!
//! # Silence
//! How long a machine takes for an answer says nothing. The firmware counts as silent when the emulator has
//! computed for [`SILENT_CPU_S`] of its own processor time, as the kernel counts it, without a byte; or when
//! all its threads sleep, look after look, while there is nothing on the way to it: then it waits for what nobody
//! will send. Where there is no `/proc`, the time that passes stands for the time computed.

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::os::fd::AsFd as _;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::stat::Mode;
use nix::unistd::mkfifo;
use tempfile::TempDir;

use super::Account;
use super::link::{OnTimeout, Wire};
use input::InputError;

/// The emulator.
const PROGRAM: &str = "qemu-system-arm";
/// The pipe that the firmware reads.
const DOWN: &str = "hil-down.fifo";
/// The pipe that it writes.
const UP: &str = "hil-up.fifo";
/// What the emulator and the firmware print.
const SAID: &str = "said.txt";
/// Accesses to what the emulator does not model.
const ACCESSES: &str = "accesses.log";

/// Time between two looks at a silent emulator, ms.
const LOOK_MS: u16 = 50;
/// Processor time without a byte after which the firmware counts as silent, s.
const SILENT_CPU_S: u64 = 10;
/// Looks in a row at which all threads sleep, after which it does too.
const SILENT_LOOKS: u32 = 40;
/// Ticks of `/proc/PID/stat` in a second: Linux says USER_HZ, and it is this on every machine.
const TICKS_PER_S: u64 = 100;
/// Looks at an emulator that is to end, until it is killed: 5 s.
const LOOKS_TO_END: u32 = 100;
/// Lines of the last words.
const LAST_WORDS: usize = 24;

/// Beginnings of lines of the log that are explained, with their explanations.
const EXPLAINED: &str = include_str!("unmodelled.txt");

/// A running emulator. It is killed when this is dropped.
#[derive(Debug)]
pub struct Qemu {
    emulator: Child,
    down: File,
    up: File,
    /// Processor time at the first look without a byte, ticks; `None` while bytes come.
    silent_since: Option<u64>,
    /// Processor time at the last look, ticks, looks without a byte, and of those, since the last sign of life.
    computed: u64,
    looks: u32,
    asleep: u32,
    directory: TempDir,
}

impl Qemu {
    /// Starts an image.
    ///
    /// # Errors
    /// The emulator isn't installed, or can't be started.
    pub fn start(image: &Path) -> Result<Self, InputError> {
        Self::start_with(image, &[])
    }

    /// The same, with these further arguments to the emulator.
    pub(super) fn start_with(image: &Path, further: &[&str]) -> Result<Self, InputError> {
        let refused = |error: io::Error| match error.kind() {
            io::ErrorKind::NotFound => InputError::new(
                "not found: install it, on Debian and Ubuntu by apt-get install qemu-system-arm",
            ),
            _ => InputError::new(format!("does not start: {error}")),
        };
        Self::try_start(image, further).map_err(|error| refused(error).file(PROGRAM))
    }

    fn try_start(image: &Path, further: &[&str]) -> io::Result<Self> {
        let directory = tempfile::Builder::new().prefix("kestrel-hil-").tempdir()?;
        // Opened for both directions, so that neither side waits for the other to open its end.
        let pipe = |name: &str| {
            let path = directory.path().join(name);
            mkfifo(&path, Mode::S_IRUSR | Mode::S_IWUSR)?;
            File::options().read(true).write(true).open(path)
        };
        let (down, up) = (pipe(DOWN)?, pipe(UP)?);
        let said = File::create(directory.path().join(SAID))?;
        let emulator = Command::new(PROGRAM)
            .current_dir(directory.path())
            .args(["-machine", "netduinoplus2", "-icount", "shift=2,sleep=off"])
            .args(["-semihosting-config", "enable=on,target=native"])
            .args(["-display", "none", "-serial", "none", "-monitor", "none"])
            .args(["-d", "unimp,guest_errors", "-D", ACCESSES])
            .args(further)
            .arg("-kernel")
            .arg(image)
            .stdin(Stdio::null())
            .stdout(said.try_clone()?)
            .stderr(said)
            // Ctrl-C on a terminal goes to this program, which ends the emulator.
            .process_group(0)
            .spawn()?;
        Ok(Self { emulator, down, up, silent_since: None, computed: 0, looks: 0, asleep: 0, directory })
    }

    /// The emulator's process.
    pub fn id(&self) -> u32 {
        self.emulator.id()
    }

    /// Its working directory.
    #[cfg(all(target_os = "linux", feature = "firmware-log"))]
    pub(super) fn directory(&self) -> &Path {
        self.directory.path()
    }

    /// Whether all its threads sleep: the firmware waits for a frame.
    #[cfg(all(target_os = "linux", feature = "firmware-log"))]
    pub(super) fn sleeps(&self) -> bool {
        sleeps(&format!("/proc/{}", self.emulator.id()))
    }

    /// Waits for the emulator to end, but not for long.
    pub fn end(mut self) -> Account {
        let mut status = None;
        for _ in 0..LOOKS_TO_END {
            // Whoever can't be asked is killed below.
            status = self.emulator.try_wait().unwrap_or(None);
            if status.is_some() {
                break;
            }
            thread::sleep(Duration::from_millis(LOOK_MS.into()));
        }
        self.kill();
        let lines = |name: &str| {
            let bytes = fs::read(self.directory.path().join(name)).unwrap_or_default();
            String::from_utf8_lossy(&bytes).lines().map(str::to_owned).collect::<Vec<_>>()
        };
        let mut last_words = lines(SAID);
        last_words.drain(..last_words.len().saturating_sub(LAST_WORDS));
        let unmodelled = lines(ACCESSES).into_iter().filter(|line| !is_explained(line)).collect();
        Account { status, last_words, unmodelled }
    }

    fn kill(&mut self) {
        // An error means that it has ended, which is all that is wanted.
        let _ = self.emulator.kill();
        let _ = self.emulator.wait();
    }

    /// Whether there are bytes to read, within `ms`.
    fn readable(&self, ms: u16) -> io::Result<bool> {
        let mut pipes = [PollFd::new(self.up.as_fd(), PollFlags::POLLIN)];
        Ok(poll(&mut pipes, PollTimeout::from(ms))? > 0)
    }
}

impl Drop for Qemu {
    fn drop(&mut self) {
        self.kill();
    }
}

impl Read for Qemu {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if !self.readable(LOOK_MS)? {
            if self.emulator.try_wait()?.is_none() {
                return Err(io::ErrorKind::WouldBlock.into());
            }
            // What it wrote at the last moment is still to be read.
            if !self.readable(0)? {
                return Ok(0);
            }
        }
        self.silent_since = None;
        self.up.read(buffer)
    }
}

impl Write for Qemu {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.down.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Wire for Qemu {
    fn on_timeout(&mut self) -> OnTimeout {
        self.looks += 1;
        let process = format!("/proc/{}", self.emulator.id());
        let passed = u64::from(self.looks) * u64::from(LOOK_MS) * TICKS_PER_S / 1_000;
        let computed = processor_ticks(&process).unwrap_or(passed);
        let lives = computed != self.computed || !sleeps(&process);
        self.asleep = if lives || self.silent_since.is_none() { 0 } else { self.asleep + 1 };
        self.computed = computed;
        let since = *self.silent_since.get_or_insert(computed);
        if computed - since >= SILENT_CPU_S * TICKS_PER_S {
            OnTimeout::Silent(format!("no answer in {SILENT_CPU_S} s of the emulator's processor time"))
        } else if self.asleep >= SILENT_LOOKS {
            OnTimeout::Silent("the emulator sleeps, and waits for what nobody will send".into())
        } else {
            OnTimeout::Wait
        }
    }
}

/// User and system time of a process and all its threads.
fn processor_ticks(process: &str) -> Option<u64> {
    let stat = fs::read_to_string(format!("{process}/stat")).ok()?;
    let mut times = after_name(&stat)?.split_ascii_whitespace().skip(11);
    let mut ticks = || times.next()?.parse::<u64>().ok();
    Some(ticks()? + ticks()?)
}

/// Whether all threads of a process sleep.
fn sleeps(process: &str) -> bool {
    let Ok(threads) = fs::read_dir(format!("{process}/task")) else { return false };
    threads.flatten().all(|thread| {
        let stat = fs::read_to_string(thread.path().join("stat"));
        stat.is_ok_and(|stat| after_name(&stat).is_some_and(|rest| rest.starts_with('S')))
    })
}

/// The fields behind the name, which may hold anything: the state, and the numbers from the fourth on.
fn after_name(stat: &str) -> Option<&str> {
    stat.rsplit_once(") ").map(|(_, rest)| rest)
}

fn is_explained(line: &str) -> bool {
    let explained = EXPLAINED.lines().map(str::trim_end).filter(|line| !line.is_empty());
    explained.filter(|beginning| !beginning.starts_with('#')).any(|beginning| line.starts_with(beginning))
}
