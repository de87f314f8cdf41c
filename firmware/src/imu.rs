//! Set-up of the IMU: at start, and again whenever the IMU has lost its settings, also in flight.
//!
//! No task waits for it. During the set-up it owns the IMU's bus ([`tasks::sampling`]), and the control loop steps
//! without samples. On the ground the flight controller then refuses to arm. In flight it continues if samples are back
//! within 0.1 s, and stops the motors otherwise.
//!
//! ```text
//!   0 ms    the IMU resets: its supply has dipped
//!   1 ms    its data-ready line stays low: the timer starts the burst, which reports the reset      `sampling::poll`
//!   3 ms    the next burst reports it again: the set-up takes the bus                 `drivers::icm42688p::Recovery`
//!  62 ms    the IMU samples                                                              `drivers::icm42688p::Setup`
//! ```

use drivers::icm42688p::{Progress, Setup};
use tasks::sampling;

use crate::stm32f405::burst::{HasWiring, ImuSpi};
use crate::stm32f405::deadline;

/// The IMU during its set-up.
pub struct Imu<W> {
    spi: ImuSpi<W>,
    /// The set-up in progress.
    setup: Option<Setup>,
}

impl<W: HasWiring> Imu<W> {
    /// Returns the IMU before its first set-up.
    pub fn new(spi: ImuSpi<W>) -> Self {
        Self { spi, setup: None }
    }

    /// Runs one step of the set-up: once a millisecond while [`sampling::setting_up`] is true.
    pub fn run(&mut self) {
        let now_us = deadline::now_us();
        let Self { spi, setup } = self;
        let progress = setup
            .get_or_insert_with(|| {
                defmt::info!("IMU: set-up started");
                spi.claim();
                Setup::new(now_us)
            })
            .step(spi, now_us, sampling::edges());
        match progress {
            Progress::Waiting => {}
            Progress::Done => {
                *setup = None;
                spi.hand_over();
                sampling::end_setup();
                defmt::info!("IMU: set-up done");
            }
            // The control loop keeps running and refuses to arm.
            Progress::Failed(error) => {
                defmt::warn!("IMU: set-up failed: {=str} {=u32:#x}", error.text(), error.number());
            }
        }
    }
}
