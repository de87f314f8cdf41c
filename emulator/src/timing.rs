//! Times and instruction counts of the fast loop, as seen from outside.

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

    /// How many.
    pub fn count(&self) -> u64 {
        self.count
    }
}

/// Handlers whose runs are counted: what they are called, and their exception numbers.
pub const HANDLERS: [(&str, u16); 7] = [
    ("EXTI4", 16 + 10),
    ("USART2", 16 + 38),
    ("TIM5", 16 + 50),
    ("DMA2_STREAM0", 16 + 56),
    ("SysTick", 15),
    ("DCMI", 16 + 78),
    ("CRYP", 16 + 79),
];

/// What a flight shows of the firmware's timing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Timing {
    /// Instructions up to the present stop.
    pub instructions_now: u64,
    /// From INT1 to the handler's first instruction, ns: the jitter of the time stamp.
    pub entry_ns: Spread,
    /// From INT1 to the last access to a motor timer or its DMA, ns.
    pub latency_ns: Spread,
    /// Instructions in that time, of all priorities.
    pub latency_instructions: Spread,
    /// How often each of [`HANDLERS`] was entered.
    pub entries: [u64; HANDLERS.len()],
    /// Instructions of a run of each, those of the way to sleep included: of the runs that the core began asleep and
    /// ended asleep, with no other handler between.
    pub runs: [Spread; HANDLERS.len()],
    /// The first handler since the core slept, the count at its entry, and whether another one came.
    busy: Option<(usize, u64, bool)>,
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

    /// A handler of [`HANDLERS`] is entered.
    pub fn entered(&mut self, handler: usize, now_ns: u64, instructions: u64) {
        self.entries[handler] += 1;
        self.busy = match self.busy {
            None => Some((handler, instructions, false)),
            Some((first, since, _)) => Some((first, since, true)),
        };
        if handler == 0
            && !self.entered
            && let Some((ready_ns, _)) = self.ready
        {
            self.entered = true;
            self.entry_ns.add(now_ns.saturating_sub(ready_ns));
        }
    }

    /// The core is about to sleep.
    pub fn sleeps(&mut self, instructions: u64) {
        if let Some((handler, since, false)) = self.busy {
            self.runs[handler].add(instructions - since);
        }
        self.busy = None;
    }

    /// The firmware has accessed a timer of the motors.
    pub fn motor_access(&mut self, now_ns: u64, instructions: u64) {
        if self.ready.is_some() {
            self.last_motor = Some((now_ns, instructions));
        }
    }
}
