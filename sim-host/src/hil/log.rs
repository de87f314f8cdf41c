//! The firmware's log on QEMU, read from QEMU's memory while the firmware waits.
//!
//! The firmware logs into a ring buffer in RAM (the crate `firmware-log` has its layout). On a board a debug probe empties
//! it. Here the chip's RAM is memory of a process that this program has started, and Linux lets this program read and
//! write it (`/proc/PID/mem`). QEMU's monitor gives the address of the RAM in that process, once, before the firmware
//! starts.
//!
//! Before each frame is sent, this program waits until all threads of QEMU sleep: the firmware has then finished the last
//! step and waits for the next. Then it empties the ring. So the ring does not overflow, and the flight equals one
//! without the log. Lines between the last frame and the end of QEMU, or a reset, are lost.

use std::fs::{self, File};
use std::io::{self, BufRead as _, BufReader, Read, Write};
use std::ops::Range;
use std::os::unix::fs::FileExt as _;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::thread;
use std::time::Duration;

use firmware_log::{Decoder, Line, Memory, RttError, drain, rtt_control_block};
use serde_json::{Value, json};

use super::QemuExit;
use super::link::{OnTimeout, Wire};
use super::qemu::Qemu;
use input::InputError;

/// Addresses of the RAM of QEMU's chip.
const RAM: Range<u32> = 0x2000_0000..0x2002_0000;
/// Name of the socket of QEMU's monitor, in QEMU's directory.
const MONITOR: &str = "monitor.socket";

/// Time between two polls of QEMU.
const POLL: Duration = Duration::from_micros(50);
/// Maximum number of polls in one wait until QEMU's threads sleep. 10,000 polls of at least 50 µs take at least 0.5 s.
/// If QEMU works for longer, it hangs. The wait then ends, and the code that waits for QEMU's answer reports the hang.
const MAX_WORK_POLLS: u32 = 10_000;
/// Maximum number of polls in one wait for QEMU's monitor. 50,000 polls of at least 50 µs take at least 2.5 s.
const MAX_MONITOR_POLLS: u32 = 50_000;

/// A running QEMU that passes each line of the firmware's log to `print`.
pub struct WithLog<P> {
    qemu: Qemu,
    ram: ChipRam,
    control_block: u32,
    decoder: Decoder,
    print: P,
    ended: bool,
}

impl<P: FnMut(&Line)> WithLog<P> {
    /// Starts QEMU with an image.
    ///
    /// # Errors
    /// As [`Qemu::start`]; also if the image has no log, or QEMU's memory cannot be read.
    pub fn start(image: &Path, print: P) -> Result<Self, InputError> {
        let refused = |what: String| InputError::new(what).field("--firmware-log");
        let elf = read_image(image).map_err(|error| refused(format!("the image cannot be read: {error}")))?;
        let decoder = Decoder::new(&elf).map_err(|error| refused(error.to_string()))?;
        let control_block =
            rtt_control_block(&elf).ok_or_else(|| refused("the image has no log by RTT".into()))?;
        // With -S QEMU waits for the monitor's command to start the firmware.
        let monitor = format!("unix:{MONITOR},server=on,wait=off");
        let qemu = Qemu::start_with(image, &["-S", "-qmp", &monitor])?;
        let ram = ChipRam::of(&qemu).map_err(|error| {
            refused(format!("QEMU's memory cannot be read: {error} (a container may forbid it)"))
        })?;
        Ok(Self { qemu, ram, control_block, decoder, print, ended: false })
    }

    /// As [`Qemu::end`].
    pub fn end(self) -> QemuExit {
        self.qemu.end()
    }

    /// Waits until the firmware waits, then prints the new lines of the log.
    fn print_log(&mut self) {
        if self.ended {
            return;
        }
        for _ in 0..MAX_WORK_POLLS {
            if self.qemu.all_threads_sleep() {
                break;
            }
            thread::sleep(POLL);
        }
        match drain(&mut self.ram, self.control_block) {
            Ok(bytes) => self.decoder.push(&bytes).iter().for_each(&mut self.print),
            // The firmware has not started yet, or QEMU has ended.
            Err(RttError::NotThere | RttError::Memory { .. }) => {}
            Err(error) => {
                self.ended = true;
                let message = format!("the log ends here: {error}");
                (self.print)(&Line { time_us: None, level: None, message });
            }
        }
    }
}

impl<P> Read for WithLog<P> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.qemu.read(buffer)
    }
}

impl<P: FnMut(&Line)> Write for WithLog<P> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.print_log();
        self.qemu.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.qemu.flush()
    }
}

impl<P: FnMut(&Line)> Wire for WithLog<P> {
    fn on_timeout(&mut self) -> OnTimeout {
        self.qemu.on_timeout()
    }
}

/// The chip's RAM, in QEMU's memory.
struct ChipRam {
    memory: File,
    /// Address of the RAM in QEMU's memory.
    host_start: u64,
    /// Kept open although it is not used any more: closing it could discard the last command.
    _monitor: Monitor,
}

impl ChipRam {
    /// Asks QEMU for the address of the RAM, and then starts the firmware.
    fn of(qemu: &Qemu) -> io::Result<Self> {
        let mut monitor = Monitor::open(&qemu.directory().join(MONITOR))?;
        let answer = monitor.request(&json!({
            "execute": "human-monitor-command",
            "arguments": { "command-line": format!("gpa2hva {:#x}", RAM.start) },
        }))?;
        let answer = answer.as_str().unwrap_or_default();
        let host_start = answer
            .split_ascii_whitespace()
            .last()
            .and_then(|word| u64::from_str_radix(word.strip_prefix("0x")?, 16).ok())
            .ok_or_else(|| io::Error::other(format!("gpa2hva answers: {}", answer.trim())))?;
        let memory = File::options().read(true).write(true).open(format!("/proc/{}/mem", qemu.id()))?;
        // Does not wait for the answer: QEMU answers only after the firmware has received its first frame.
        monitor.send(&json!({ "execute": "cont" }))?;
        let mut ram = Self { memory, host_start, _monitor: monitor };
        ram.read(RAM.start, &mut [0; 4])?;
        Ok(ram)
    }

    /// Returns the address in QEMU's memory of `length` bytes at an address of the chip.
    fn host_address(&self, address: u32, length: usize) -> io::Result<u64> {
        let end = u64::from(address) + length as u64;
        if RAM.contains(&address) && end <= u64::from(RAM.end) {
            Ok(self.host_start + u64::from(address - RAM.start))
        } else {
            Err(io::Error::other(format!("{length} bytes at {address:#010x} are not in RAM")))
        }
    }
}

impl Memory for ChipRam {
    fn read(&mut self, address: u32, bytes: &mut [u8]) -> io::Result<()> {
        self.memory.read_exact_at(bytes, self.host_address(address, bytes.len())?)
    }

    fn write_u32(&mut self, address: u32, value: u32) -> io::Result<()> {
        self.memory.write_all_at(&value.to_le_bytes(), self.host_address(address, 4)?)
    }
}

/// QEMU's monitor (QMP): each command and each answer is a line of JSON.
struct Monitor {
    socket: BufReader<UnixStream>,
}

impl Monitor {
    fn open(path: &Path) -> io::Result<Self> {
        let mut polls = 0;
        let socket = loop {
            match UnixStream::connect(path) {
                Ok(socket) => break socket,
                Err(error) if polls == MAX_MONITOR_POLLS => return Err(error),
                Err(_) => thread::sleep(POLL),
            }
            polls += 1;
        };
        socket.set_read_timeout(Some(Duration::from_secs(10)))?;
        let mut monitor = Self { socket: BufReader::new(socket) };
        monitor.request(&json!({ "execute": "qmp_capabilities" }))?;
        Ok(monitor)
    }

    fn send(&mut self, command: &Value) -> io::Result<()> {
        writeln!(self.socket.get_mut(), "{command}")
    }

    /// Sends a command and returns its answer. Skips the greeting and events in between.
    fn request(&mut self, command: &Value) -> io::Result<Value> {
        self.send(command)?;
        loop {
            let mut line = String::new();
            if self.socket.read_line(&mut line)? == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            let mut answer: Value = serde_json::from_str(&line)?;
            if let Some(answer) = answer.get_mut("return") {
                return Ok(answer.take());
            }
            if let Some(error) = answer.get("error") {
                return Err(io::Error::other(format!("QEMU's monitor answers {error}")));
            }
        }
    }
}
