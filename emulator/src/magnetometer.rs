//! The magnetometer on its connector: a QMC5883L, and its faults.

use rigless::chip::Timeline;
use rigless::chip::i2c::Peer;
use rigless::chip::qmc5883l::Qmc5883l;
use rigless::snapshot::store;
use rigless::time::EventId;

/// The sensor.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
pub struct Magnetometer {
    chip: Qmc5883l,
    /// Whether the sensor is not connected: it acknowledges nothing.
    pub absent: bool,
    reading: bool,
    last: bool,
    /// Whether a transfer was ended although its last byte was acknowledged: the chip continues to send.
    sends_on: bool,
}

store!(Magnetometer);

impl Default for Magnetometer {
    fn default() -> Self {
        Self::new()
    }
}

impl Magnetometer {
    /// Returns a sensor just after power-on.
    pub fn new() -> Self {
        Self { chip: Qmc5883l::new(), absent: false, reading: false, last: false, sends_on: false }
    }

    /// Returns whether the chip continues to send, because the last byte of a transfer was acknowledged.
    pub fn sends_on(&self) -> bool {
        self.sends_on
    }

    /// Ends the present transfer, after enough clock pulses.
    pub fn end_transfer(&mut self) {
        self.reading = false;
        self.sends_on = false;
    }

    /// Sets the present measurement: counts of ±8 G along the chip's axes.
    pub fn set_counts(&mut self, counts: [i16; 3]) {
        // 3,000 counts are 1 gauss, which is 100,000 nT.
        let [x, y, z] = counts.map(|counts| {
            let nanotesla = i64::from(counts) * 100_000;
            ((nanotesla + 1_500 * nanotesla.signum()) / 3_000) as i32
        });
        self.chip.set_field(x, y, z);
    }
}

impl Peer for Magnetometer {
    fn start(&mut self, address: u8, read: bool, context: &mut Timeline<'_, '_>) -> bool {
        let answers = !self.absent && self.chip.start(address, read, context);
        (self.reading, self.last, self.sends_on) = (answers && read, false, false);
        answers
    }

    fn write(&mut self, byte: u8, context: &mut Timeline<'_, '_>) -> bool {
        !self.absent && self.chip.write(byte, context)
    }

    fn read(&mut self, last: bool, context: &mut Timeline<'_, '_>) -> u8 {
        self.last = last;
        if self.absent { 0xff } else { self.chip.read(last, context) }
    }

    fn stop(&mut self, context: &mut Timeline<'_, '_>) {
        self.sends_on = self.reading && !self.last;
        self.reading = false;
        self.chip.stop(context);
    }

    fn on_event(&mut self, event: EventId, context: &mut Timeline<'_, '_>) {
        self.chip.on_event(event, context);
    }
}
