//! The receiver: turns the bytes at its port into frames, in any supported protocol.

use flight_core::rc::ChannelMap;
use flight_core::sample::RcFrame;
use receiver::search::Search;
use tasks::clock::Clock;
use tasks::counters::COUNTERS;

use crate::stm32f405::deadline::now_us;
use crate::stm32f405::port::{HasWiring, Port};

/// The receiver at its port.
pub struct RcReceiver<W> {
    port: Port<W>,
    search: Search,
    clock: Clock,
    damaged: u32,
}

impl<W: HasWiring> RcReceiver<W> {
    /// Takes a port that is open with the settings of [`Search::FIRST`].
    pub fn new(port: Port<W>, channels: ChannelMap) -> Self {
        Self { port, search: Search::new(channels), clock: Clock::new(), damaged: 0 }
    }

    /// Returns the next complete frame.
    pub fn poll(&mut self) -> Option<RcFrame> {
        let now_us = self.clock.at(now_us());
        while let Some((at_us, received)) = self.port.next() {
            let found = self.search.found();
            let frame = self.search.push(received, self.clock.at(at_us));
            if found.is_none()
                && let Some(protocol) = self.search.found()
            {
                defmt::info!("receiver found: {=str}", protocol.name());
            }
            if frame.is_some() {
                COUNTERS.rc.add();
                return frame;
            }
        }
        let damaged = self.search.damaged();
        COUNTERS.rc_bad.add_n(damaged.saturating_sub(self.damaged));
        self.damaged = damaged;
        if let Some(line) = self.search.next_line(now_us) {
            self.port.set(line);
        }
        None
    }
}
