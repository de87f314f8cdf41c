//! QEMU's `netduinoplus2`, an STM32F405, at the other end of two named pipes.
//!
//! The pipes, QEMU's log and its output are in a temporary directory, which is removed when QEMU ends. The firmware
//! opens `hil-down.fifo` to read and `hil-up.fifo` to write, by semihosting. With `-icount shift=2,sleep=off`
//! QEMU's time follows from the number of instructions, so a flight is the same every time.
//!
//! # When the firmware counts as silent
//! The real time of an answer depends on the load of the machine, so it is no criterion. The firmware counts as silent
//! in two cases:
//! - QEMU has used [`SILENT_CPU_S`] of processor time, as the kernel counts it, without sending a byte.
//! - All threads of QEMU sleep in [`MAX_ASLEEP_POLLS`] polls in a row, although no byte is on the way to it: it waits for
//!   a frame that was lost.
//!
//! On a system without `/proc`, the real time takes the place of the processor time.

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

use super::QemuExit;
use super::link::{OnTimeout, Wire};
use input::InputError;

/// QEMU's program.
const PROGRAM: &str = "qemu-system-arm";
/// Name of the pipe that the firmware reads.
const DOWN: &str = "hil-down.fifo";
/// Name of the pipe that the firmware writes.
const UP: &str = "hil-up.fifo";
/// File with the output of QEMU and of the firmware.
const OUTPUT: &str = "output.txt";
/// File with QEMU's log of accesses to hardware that it does not model.
const ACCESSES: &str = "accesses.log";

/// Time between two polls of QEMU, ms.
const POLL_MS: u16 = 50;
/// Processor time without a byte from QEMU after which the firmware counts as silent, s.
const SILENT_CPU_S: u64 = 10;
/// Polls in a row with all threads of QEMU asleep after which the firmware counts as silent: 2 s.
const MAX_ASLEEP_POLLS: u32 = 40;
/// Ticks per second of the times in `/proc/PID/stat`: Linux's USER_HZ, which is 100 on every machine.
const TICKS_PER_S: u64 = 100;
/// Polls until a QEMU that does not end is killed: 5 s.
const MAX_END_POLLS: u32 = 100;
/// Lines of the output that a report keeps.
const TAIL_LINES: usize = 24;

/// Prefixes of log lines that are known to be harmless, with their explanations.
const EXPLAINED: &str = include_str!("unmodelled.txt");

/// A running QEMU. Dropping it kills the process.
#[derive(Debug)]
pub struct Qemu {
    process: Child,
    down: File,
    up: File,
    /// Processor time at the first poll without a byte, ticks; `None` while bytes come.
    silent_since: Option<u64>,
    /// Processor time at the last poll, ticks.
    computed: u64,
    /// Polls without a byte, in the whole flight.
    polls: u32,
    /// Polls in a row with all threads asleep.
    asleep: u32,
    directory: TempDir,
}

impl Qemu {
    /// Starts QEMU with an image.
    ///
    /// # Errors
    /// QEMU is not installed, or does not start.
    pub fn start(image: &Path) -> Result<Self, InputError> {
        Self::start_with(image, &[])
    }

    /// As [`start`](Self::start), with further arguments to QEMU.
    pub(super) fn start_with(image: &Path, further: &[&str]) -> Result<Self, InputError> {
        let refused = |error: io::Error| match error.kind() {
            io::ErrorKind::NotFound => InputError::new(
                "not found: install it; on Debian and Ubuntu: apt-get install qemu-system-arm",
            ),
            _ => InputError::new(format!("does not start: {error}")),
        };
        Self::try_start(image, further).map_err(|error| refused(error).file(PROGRAM))
    }

    fn try_start(image: &Path, further: &[&str]) -> io::Result<Self> {
        let directory = tempfile::Builder::new().prefix("kestrel-hil-").tempdir()?;
        // Opened for both directions: opening one direction would wait for the other side.
        let pipe = |name: &str| {
            let path = directory.path().join(name);
            mkfifo(&path, Mode::S_IRUSR | Mode::S_IWUSR)?;
            File::options().read(true).write(true).open(path)
        };
        let (down, up) = (pipe(DOWN)?, pipe(UP)?);
        let output = File::create(directory.path().join(OUTPUT))?;
        let process = Command::new(PROGRAM)
            .current_dir(directory.path())
            .args(["-machine", "netduinoplus2", "-icount", "shift=2,sleep=off"])
            .args(["-semihosting-config", "enable=on,target=native"])
            .args(["-display", "none", "-serial", "none", "-monitor", "none"])
            .args(["-d", "unimp,guest_errors", "-D", ACCESSES])
            .args(further)
            .arg("-kernel")
            .arg(image)
            .stdin(Stdio::null())
            .stdout(output.try_clone()?)
            .stderr(output)
            // In a group of its own, so that Ctrl-C on a terminal reaches only this program, which then ends QEMU.
            .process_group(0)
            .spawn()?;
        Ok(Self { process, down, up, silent_since: None, computed: 0, polls: 0, asleep: 0, directory })
    }

    /// Returns the process number of QEMU.
    pub fn id(&self) -> u32 {
        self.process.id()
    }

    /// Returns QEMU's working directory.
    #[cfg(all(target_os = "linux", feature = "firmware-log"))]
    pub(super) fn directory(&self) -> &Path {
        self.directory.path()
    }

    /// Whether all threads of QEMU sleep, which means that the firmware waits for a frame.
    #[cfg(all(target_os = "linux", feature = "firmware-log"))]
    pub(super) fn all_threads_sleep(&self) -> bool {
        all_threads_sleep(&format!("/proc/{}", self.process.id()))
    }

    /// Waits up to 5 s for QEMU to end, then kills it. Returns how it ended.
    pub fn end(mut self) -> QemuExit {
        let mut status = None;
        for _ in 0..MAX_END_POLLS {
            // After an error the process is killed below.
            status = self.process.try_wait().unwrap_or(None);
            if status.is_some() {
                break;
            }
            thread::sleep(Duration::from_millis(POLL_MS.into()));
        }
        self.kill();
        let lines = |name: &str| {
            let bytes = fs::read(self.directory.path().join(name)).unwrap_or_default();
            String::from_utf8_lossy(&bytes).lines().map(str::to_owned).collect::<Vec<_>>()
        };
        let mut output_tail = lines(OUTPUT);
        output_tail.drain(..output_tail.len().saturating_sub(TAIL_LINES));
        let unmodelled = lines(ACCESSES).into_iter().filter(|line| !is_explained(line)).collect();
        QemuExit { status, output_tail, unmodelled }
    }

    fn kill(&mut self) {
        // An error means that the process has ended already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }

    /// Waits up to `ms` for bytes to read, and returns whether there are any.
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
        if !self.readable(POLL_MS)? {
            if self.process.try_wait()?.is_none() {
                return Err(io::ErrorKind::WouldBlock.into());
            }
            // The process has ended: what it wrote just before is still to be read.
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
        self.polls += 1;
        let process = format!("/proc/{}", self.process.id());
        let elapsed = u64::from(self.polls) * u64::from(POLL_MS) * TICKS_PER_S / 1_000;
        let computed = processor_ticks(&process).unwrap_or(elapsed);
        let active = computed != self.computed || !all_threads_sleep(&process);
        self.asleep = if active || self.silent_since.is_none() { 0 } else { self.asleep + 1 };
        self.computed = computed;
        let since = *self.silent_since.get_or_insert(computed);
        if computed - since >= SILENT_CPU_S * TICKS_PER_S {
            OnTimeout::Silent(format!("no answer in {SILENT_CPU_S} s of QEMU's processor time"))
        } else if self.asleep >= MAX_ASLEEP_POLLS {
            OnTimeout::Silent("QEMU sleeps: it waits for a frame, and none is on the way".into())
        } else {
            OnTimeout::Wait
        }
    }
}

/// Returns the user and system time of a process with all its threads, ticks.
fn processor_ticks(process: &str) -> Option<u64> {
    let stat = fs::read_to_string(format!("{process}/stat")).ok()?;
    let mut times = after_name(&stat)?.split_ascii_whitespace().skip(11);
    let mut ticks = || times.next()?.parse::<u64>().ok();
    Some(ticks()? + ticks()?)
}

/// Whether all threads of a process sleep. `process` is its directory in `/proc`.
fn all_threads_sleep(process: &str) -> bool {
    let Ok(threads) = fs::read_dir(format!("{process}/task")) else { return false };
    threads.flatten().all(|thread| {
        let stat = fs::read_to_string(thread.path().join("stat"));
        stat.is_ok_and(|stat| after_name(&stat).is_some_and(|rest| rest.starts_with('S')))
    })
}

/// Returns the fields of `/proc/PID/stat` after the process name, which may contain spaces and brackets: the state, then
/// numbers.
fn after_name(stat: &str) -> Option<&str> {
    stat.rsplit_once(") ").map(|(_, rest)| rest)
}

/// Whether a line of QEMU's log begins with one of the explained prefixes.
fn is_explained(line: &str) -> bool {
    let explained = EXPLAINED.lines().map(str::trim_end).filter(|line| !line.is_empty());
    explained.filter(|prefix| !prefix.starts_with('#')).any(|prefix| line.starts_with(prefix))
}
