//! Times and instruction counts of the firmware, measured from outside.

use std::collections::BTreeSet;

/// Instructions in a second of virtual time: each takes two cycles of 168 MHz, as `docs/timing.md` assumes. This is a
/// setting and not a measurement: there are no wait states of the flash, no caches and no contention on the bus.
pub const INSTRUCTIONS_PER_SECOND: u64 = 84_000_000;

/// Minimum, mean, maximum and number of a series of values.
#[derive(Clone, Copy, Debug, Default)]
pub struct Statistics {
    /// Minimum.
    pub min: u64,
    /// Maximum.
    pub max: u64,
    sum: u64,
    count: u64,
}

impl Statistics {
    fn add(&mut self, value: u64) {
        self.min = if self.count == 0 { value } else { self.min.min(value) };
        self.max = self.max.max(value);
        self.sum += value;
        self.count += 1;
    }

    /// Returns the mean, or 0 without values.
    pub fn mean(&self) -> f64 {
        if self.count == 0 { 0.0 } else { self.sum as f64 / self.count as f64 }
    }

    /// Returns the share of `seconds` that the sum takes, if the values are instructions.
    pub fn share_of_time(&self, seconds: f64) -> f64 {
        self.sum as f64 / (seconds * INSTRUCTIONS_PER_SECOND as f64)
    }

    /// Returns the number of values.
    pub fn count(&self) -> u64 {
        self.count
    }
}

/// An interrupt handler of the firmware.
#[derive(Clone, Copy, Debug)]
pub struct Handler {
    /// Name of the vector.
    pub vector: &'static str,
    /// Task of the handler, or the tasks of its priority (`firmware/src/main.rs`).
    pub task: &'static str,
    /// Number of the exception; interrupts begin at 16.
    pub exception: u16,
    /// Priority in RTIC: a higher number is more urgent.
    pub priority: u8,
}

/// Number of handlers that run in flight.
pub const HANDLERS: usize = 8;

/// Returns the handlers that run in flight, on a board with these vectors of the data-ready line and of the receiver's port.
pub fn handlers(ready: &str, serial: &str) -> [Handler; HANDLERS] {
    let board = |name: &str, task| {
        let found = VECTORS.iter().find(|(vector, _)| *vector == name).expect("a vector of the chip");
        Handler { vector: found.0, task, exception: 16 + found.1, priority: 6 }
    };
    [
        board(ready, "data ready"),
        board(serial, "receive"),
        board("TIM5", "overdue"),
        Handler { vector: "DMA2_STREAM0", task: "control_loop", exception: 16 + 56, priority: 5 },
        Handler { vector: "SysTick", task: "tick", exception: 15, priority: 4 },
        Handler { vector: "HASH_RNG", task: "battery", exception: 16 + 80, priority: 3 },
        Handler { vector: "DCMI", task: "imu_setup, health, log_event", exception: 16 + 78, priority: 2 },
        Handler { vector: "CRYP", task: "magnetometer", exception: 16 + 79, priority: 1 },
    ]
}

/// Names and numbers of interrupts (RM0090, table 61).
const VECTORS: [(&str, u16); 14] = [
    ("EXTI0", 6),
    ("EXTI1", 7),
    ("EXTI2", 8),
    ("EXTI3", 9),
    ("EXTI4", 10),
    ("EXTI9_5", 23),
    ("EXTI15_10", 40),
    ("USART1", 37),
    ("USART2", 38),
    ("USART3", 39),
    ("TIM5", 50),
    ("UART4", 52),
    ("UART5", 53),
    ("USART6", 71),
];

/// Priorities of [`handlers`], in the same order.
const PRIORITIES: [u8; HANDLERS] = [6, 6, 6, 5, 4, 3, 2, 1];

/// Index of the data-ready interrupt in [`handlers`].
const DATA_READY: usize = 0;

/// The firmware's timing in a flight.
#[derive(Clone, Debug, Default)]
pub struct Timing {
    /// Instructions up to the present stop.
    pub instructions_now: u64,
    /// Time from INT1 to the handler's first instruction, ns.
    pub entry_ns: Statistics,
    /// Time from INT1 to the last write to a motor timer, ns.
    pub latency_ns: Statistics,
    /// Instructions of all priorities in that time.
    pub latency_instructions: Statistics,
    /// Instructions of a run of each of [`handlers`], without those of the handlers that interrupted it.
    pub runs: [Statistics; HANDLERS],
    /// Minimum and maximum of the firmware's time stamp minus the time of INT1, ns. The two clocks have different origins, so
    /// only the difference of minimum and maximum is meaningful.
    stamp_ns: Option<(i64, i64)>,
    last_stamp_us: u64,
    /// Active handlers, each with the number of instructions that it has executed.
    running: Vec<(usize, u64)>,
    /// Number of instructions that are already assigned to handlers.
    assigned: u64,
    /// Observed interruptions, as indices into [`handlers`]: the interrupted handler, the interrupting handler.
    pub interrupted: BTreeSet<(usize, usize)>,
    ready: Option<(u64, u64)>,
    entered: bool,
    last_motor: Option<(u64, u64)>,
}

impl Timing {
    /// Records a rise of INT1, and completes the latency of the last sample.
    pub fn on_data_ready(&mut self, now_ns: u64) {
        if let (Some((ready_ns, ready_at)), Some((motor_ns, motor_at))) = (self.ready, self.last_motor) {
            self.latency_ns.add(motor_ns - ready_ns);
            self.latency_instructions.add(motor_at - ready_at);
        }
        self.ready = Some((now_ns, self.instructions_now));
        self.entered = false;
        self.last_motor = None;
    }

    /// Records the entry of a handler, given by its index in [`handlers`].
    pub fn on_entry(&mut self, handler: usize, now_ns: u64, instructions: u64) {
        self.assign(instructions);
        if let Some((below, _)) = self.running.last() {
            self.interrupted.insert((*below, handler));
        }
        // A running handler of the same or a higher priority has ended by a return that is not watched.
        while self.running.last().is_some_and(|(below, _)| PRIORITIES[*below] >= PRIORITIES[handler]) {
            self.end();
        }
        self.running.push((handler, 0));
        if handler == DATA_READY
            && !self.entered
            && let Some((ready_ns, _)) = self.ready
        {
            self.entered = true;
            self.entry_ns.add(now_ns.saturating_sub(ready_ns));
        }
    }

    /// Records the return of a handler.
    pub fn on_return(&mut self, handler: usize, instructions: u64) {
        // The return instruction itself is executed after this call.
        self.assign(instructions + 1);
        if self.running.last().is_some_and(|(running, _)| *running == handler) {
            self.end();
        }
    }

    /// Records that the core goes to sleep: all handlers have ended.
    pub fn on_sleep(&mut self, instructions: u64) {
        self.assign(instructions);
        while !self.running.is_empty() {
            self.end();
        }
    }

    /// Assigns the instructions since the last call to the running handler.
    fn assign(&mut self, instructions: u64) {
        if let Some((_, own)) = self.running.last_mut() {
            *own += instructions.saturating_sub(self.assigned);
        }
        self.assigned = instructions;
    }

    fn end(&mut self) {
        if let Some((handler, own)) = self.running.pop() {
            self.runs[handler].add(own);
        }
    }

    /// Records the firmware's time stamp of a sample.
    pub fn on_time_stamp(&mut self, time_us: u64) {
        if let (true, Some((ready_ns, _))) = (self.entered, self.ready) {
            let since_ns = 1_000 * time_us as i64 - ready_ns as i64;
            // After a reset the firmware's clock restarts at zero.
            let since_start = self.stamp_ns.filter(|_| time_us >= self.last_stamp_us);
            self.last_stamp_us = time_us;
            let (min, max) = since_start.unwrap_or((since_ns, since_ns));
            self.stamp_ns = Some((min.min(since_ns), max.max(since_ns)));
        }
    }

    /// Returns the jitter of the time stamp, ns: maximum minus minimum against INT1. Time stamps have steps of 1 µs.
    pub fn stamp_jitter_ns(&self) -> i64 {
        self.stamp_ns.map_or(0, |(min, max)| max - min)
    }

    /// Records a write to a motor timer.
    pub fn on_motor_write(&mut self, now_ns: u64, instructions: u64) {
        if self.ready.is_some() {
            self.last_motor = Some((now_ns, instructions));
        }
    }
}
