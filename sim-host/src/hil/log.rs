//! The firmware's log on QEMU, taken out of the emulator's memory while both wait.
//!
//! The firmware logs into a ring in RAM (the crate `firmware-log` has its layout). On a board a debug probe empties it; here
//! the emulated RAM is memory of a process that this program has started, and Linux lets it read and write that
//! (`/proc/PID/mem`). Where in it the RAM begins, the emulator is asked once, before it starts the firmware.
//!
//! Each time a frame is about to be sent, the emulator is waited for until all its threads sleep: the firmware has done
//! everything that the last step brought, and waits for the next. Then the ring is emptied. So no line is lost to a
//! full ring, and the flight is the same as without. What was logged between the last frame and the emulator's end, or a
//! reset, is lost.

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

use super::Account;
use super::link::{OnTimeout, Wire};
use super::qemu::Qemu;
use input::InputError;

/// The emulated chip's RAM.
const RAM: Range<u32> = 0x2000_0000..0x2002_0000;
/// The emulator's monitor, in its directory.
const MONITOR: &str = "monitor.socket";

/// Time between two looks at an emulator that has work, and at one that starts.
const LOOK: Duration = Duration::from_micros(50);
/// Looks at an emulator that works: a second. One that takes longer than that has hung, which the wire finds out.
const LOOKS_AT_WORK: u32 = 10_000;
/// Looks for its monitor: some seconds.
const LOOKS_FOR_MONITOR: u32 = 50_000;

/// A running emulator whose firmware's log is given to `print` line by line.
pub struct WithLog<P> {
    qemu: Qemu,
    ram: EmulatedRam,
    control_block: u32,
    decoder: Decoder,
    print: P,
    ended: bool,
}

impl<P: FnMut(&Line)> WithLog<P> {
    /// Starts an image.
    ///
    /// # Errors
    /// As [`Qemu::start`]; and the image has no log, or the emulator's memory can't be read.
    pub fn start(image: &Path, print: P) -> Result<Self, InputError> {
        let refused = |what: String| InputError::new(what).field("--firmware-log");
        let elf = fs::read(image).map_err(|error| refused(format!("the image cannot be read: {error}")))?;
        let decoder = Decoder::new(&elf).map_err(|error| refused(error.to_string()))?;
        let control_block =
            rtt_control_block(&elf).ok_or_else(|| refused("the image does not log by RTT".into()))?;
        // It waits to be told to start the firmware.
        let monitor = format!("unix:{MONITOR},server=on,wait=off");
        let qemu = Qemu::start_with(image, &["-S", "-qmp", &monitor])?;
        let ram = EmulatedRam::of(&qemu).map_err(|error| {
            refused(format!("the emulator's memory cannot be read: {error} (a container may forbid it)"))
        })?;
        Ok(Self { qemu, ram, control_block, decoder, print, ended: false })
    }

    /// Waits for the emulator to end, but not for long.
    pub fn end(self) -> Account {
        self.qemu.end()
    }

    /// Prints what has been logged, once the firmware waits.
    fn take(&mut self) {
        if self.ended {
            return;
        }
        for _ in 0..LOOKS_AT_WORK {
            if self.qemu.sleeps() {
                break;
            }
            thread::sleep(LOOK);
        }
        match drain(&mut self.ram, self.control_block) {
            Ok(bytes) => self.decoder.push(&bytes).iter().for_each(&mut self.print),
            // Not started, or gone.
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
        self.take();
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

/// The emulated RAM, in the emulator's memory.
struct EmulatedRam {
    memory: File,
    /// Where it begins there.
    begins: u64,
    /// Nobody listens to it any more; closed, it would take a last word with it.
    _monitor: Monitor,
}

impl EmulatedRam {
    /// Asks where it is, and then starts the firmware.
    fn of(qemu: &Qemu) -> io::Result<Self> {
        let mut monitor = Monitor::open(&qemu.directory().join(MONITOR))?;
        let said = monitor.ask(&json!({
            "execute": "human-monitor-command",
            "arguments": { "command-line": format!("gpa2hva {:#x}", RAM.start) },
        }))?;
        let said = said.as_str().unwrap_or_default();
        let begins = said
            .split_ascii_whitespace()
            .last()
            .and_then(|word| u64::from_str_radix(word.strip_prefix("0x")?, 16).ok())
            .ok_or_else(|| io::Error::other(format!("it says: {}", said.trim())))?;
        let memory = File::options().read(true).write(true).open(format!("/proc/{}/mem", qemu.id()))?;
        // Its answer would not come before the firmware has got its first frame: until then the emulator is busy waiting.
        monitor.tell(&json!({ "execute": "cont" }))?;
        let mut ram = Self { memory, begins, _monitor: monitor };
        ram.read(RAM.start, &mut [0; 4])?;
        Ok(ram)
    }

    fn place(&self, address: u32, length: usize) -> io::Result<u64> {
        let end = u64::from(address) + length as u64;
        if RAM.contains(&address) && end <= u64::from(RAM.end) {
            Ok(self.begins + u64::from(address - RAM.start))
        } else {
            Err(io::Error::other(format!("{length} bytes at {address:#010x} are not in RAM")))
        }
    }
}

impl Memory for EmulatedRam {
    fn read(&mut self, address: u32, bytes: &mut [u8]) -> io::Result<()> {
        self.memory.read_exact_at(bytes, self.place(address, bytes.len())?)
    }

    fn write_u32(&mut self, address: u32, value: u32) -> io::Result<()> {
        self.memory.write_all_at(&value.to_le_bytes(), self.place(address, 4)?)
    }
}

/// The emulator's monitor: lines of JSON, a question and its answer each (QMP).
struct Monitor {
    socket: BufReader<UnixStream>,
}

impl Monitor {
    fn open(path: &Path) -> io::Result<Self> {
        let mut looks = 0;
        let socket = loop {
            match UnixStream::connect(path) {
                Ok(socket) => break socket,
                Err(error) if looks == LOOKS_FOR_MONITOR => return Err(error),
                Err(_) => thread::sleep(LOOK),
            }
            looks += 1;
        };
        socket.set_read_timeout(Some(Duration::from_secs(10)))?;
        let mut monitor = Self { socket: BufReader::new(socket) };
        monitor.ask(&json!({ "execute": "qmp_capabilities" }))?;
        Ok(monitor)
    }

    fn tell(&mut self, order: &Value) -> io::Result<()> {
        writeln!(self.socket.get_mut(), "{order}")
    }

    /// What it answers. A greeting and events come in between.
    fn ask(&mut self, question: &Value) -> io::Result<Value> {
        self.tell(question)?;
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
                return Err(io::Error::other(format!("its monitor says {error}")));
            }
        }
    }
}
