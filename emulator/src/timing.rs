//! Times and instruction counts of the fast loop, as seen from outside.

use std::collections::BTreeSet;

/// Instructions a second of virtual time: two cycles of 168 MHz for each, as `docs/timing.md` assumes. A setting, not
/// a measurement: no wait states of the flash, no caches, no contention on the bus.
pub const INSTRUCTIONS_PER_SECOND: u64 = 84_000_000;

/// Smallest, mean and largest of something.
#[derive(Clone, Copy, Debug, Default)]
pub struct Spread {
    /// Smallest.
    pub least: u64,
    /// Largest.
    pub most: u64,
    sum: u64,
    count: u64,
}

impl Spread {
    fn add(&mut self, value: u64) {
        self.least = if self.count == 0 { value } else { self.least.min(value) };
        self.most = self.most.max(value);
        self.sum += value;
        self.count += 1;
    }

    /// Mean; zero of nothing.
    pub fn mean(&self) -> f64 {
        if self.count == 0 { 0.0 } else { self.sum as f64 / self.count as f64 }
    }

    /// Share of `seconds` that it takes, if it is of instructions.
    pub fn share_of_time(&self, seconds: f64) -> f64 {
        self.sum as f64 / (seconds * INSTRUCTIONS_PER_SECOND as f64)
    }

    /// How many.
    pub fn count(&self) -> u64 {
        self.count
    }
}

/// An interrupt handler of the firmware.
#[derive(Clone, Copy, Debug)]
pub struct Handler {
    /// The vector's name.
    pub vector: &'static str,
    /// What the firmware does in it: the task, or the tasks of this priority (`firmware/src/main.rs`).
    pub task: &'static str,
    /// Number of the exception; interrupts begin at 16.
    pub exception: u16,
    /// RTIC's: the higher, the more urgent.
    pub priority: u8,
}

/// How many handlers run in flight.
pub const HANDLERS: usize = 8;

/// The handlers that run in flight, on a board with these vectors of the data-ready line and of the receiver's port.
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

/// Interrupts by name and number (RM0090, table 61).
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

/// Their priorities, in the same order.
const PRIORITIES: [u8; HANDLERS] = [6, 6, 6, 5, 4, 3, 2, 1];

/// Place of the data-ready interrupt in [`handlers`].
const DATA_READY: usize = 0;

/// What a flight shows of the firmware's timing.
#[derive(Clone, Debug, Default)]
pub struct Timing {
    /// Instructions up to the present stop.
    pub instructions_now: u64,
    /// From INT1 to the handler's first instruction, ns.
    pub entry_ns: Spread,
    /// From INT1 to the last access to a motor timer or its DMA, ns.
    pub latency_ns: Spread,
    /// Instructions in that time, of all priorities.
    pub latency_instructions: Spread,
    /// Instructions of a run of each of [`handlers`], without those of the handlers that interrupted it.
    pub runs: [Spread; HANDLERS],
    /// The firmware's time stamp less the instant of INT1, ns, least and most: two clocks, so that only the difference
    /// of the two says something.
    stamp_ns: Option<(i64, i64)>,
    last_stamp_us: u64,
    /// Handlers that have begun and not ended, and the instructions that each has executed.
    running: Vec<(usize, u64)>,
    /// Up to here the instructions are assigned.
    assigned: u64,
    /// Which handler has interrupted which, places in [`handlers`]: the one below, the one on top.
    pub interrupted: BTreeSet<(usize, usize)>,
    ready: Option<(u64, u64)>,
    entered: bool,
    last_motor: Option<(u64, u64)>,
}

impl Timing {
    /// INT1 rises.
    pub fn ready(&mut self, now_ns: u64) {
        if let (Some((ready_ns, ready_at)), Some((motor_ns, motor_at))) = (self.ready, self.last_motor) {
            self.latency_ns.add(motor_ns - ready_ns);
            self.latency_instructions.add(motor_at - ready_at);
        }
        self.ready = Some((now_ns, self.instructions_now));
        self.entered = false;
        self.last_motor = None;
    }

    /// A handler is entered: its place in [`handlers`].
    pub fn entered(&mut self, handler: usize, now_ns: u64, instructions: u64) {
        self.assign(instructions);
        if let Some((below, _)) = self.running.last() {
            self.interrupted.insert((*below, handler));
        }
        // What this one does not interrupt has ended, by a way out that is not watched.
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

    /// A handler is about to return.
    pub fn returns(&mut self, handler: usize, instructions: u64) {
        // The return itself is executed after this.
        self.assign(instructions + 1);
        if self.running.last().is_some_and(|(running, _)| *running == handler) {
            self.end();
        }
    }

    /// The core is about to sleep.
    pub fn sleeps(&mut self, instructions: u64) {
        self.assign(instructions);
        while !self.running.is_empty() {
            self.end();
        }
    }

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

    /// The firmware has recorded a step, of the sample that it stamped so.
    pub fn stamped(&mut self, time_us: u64) {
        if let (true, Some((ready_ns, _))) = (self.entered, self.ready) {
            let since_ns = 1_000 * time_us as i64 - ready_ns as i64;
            // After a reset the firmware's clock begins anew.
            let since_start = self.stamp_ns.filter(|_| time_us >= self.last_stamp_us);
            self.last_stamp_us = time_us;
            let (least, most) = since_start.unwrap_or((since_ns, since_ns));
            self.stamp_ns = Some((least.min(since_ns), most.max(since_ns)));
        }
    }

    /// Jitter of the time stamp: its latest less its earliest, ns, in a microsecond's steps.
    pub fn stamp_jitter_ns(&self) -> i64 {
        self.stamp_ns.map_or(0, |(least, most)| most - least)
    }

    /// The firmware has accessed a timer of the motors.
    pub fn motor_access(&mut self, now_ns: u64, instructions: u64) {
        if self.ready.is_some() {
            self.last_motor = Some((now_ns, instructions));
        }
    }
}
