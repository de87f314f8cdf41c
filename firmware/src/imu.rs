//! The inertial sensor's set-up: at start, and again whenever the sensor must be set up again, in flight too.
//!
//! Nobody waits for it. While it lasts it has the sensor's bus ([`tasks::sampling`]), and the control loop steps
//! without samples: on the ground it refuses to arm; in flight it goes on if the samples are back within 0.1 s, and
//! stops the motors if not.
//!
//! ```text
//!   0 ms    the sensor resets: its supply has dipped
//!   1 ms    its data-ready line stays down: the timer reads it, and it says so                    `sampling::poll`
//!   3 ms    it says so again: the set-up has the bus                                  `drivers::icm42688p::Recovery`
//!  62 ms    it samples                                                                   `drivers::icm42688p::Setup`
//! ```

use drivers::icm42688p::{Progress, Setup};
use tasks::sampling;

use crate::stm32f405::burst::{HasWiring, ImuSpi};
use crate::stm32f405::deadline;

/// The sensor, for its set-up.
pub struct Imu<W> {
    spi: ImuSpi<W>,
    /// The set-up that is under way.
    setup: Option<Setup>,
}

impl<W: HasWiring> Imu<W> {
    /// Not set up yet.
    pub fn new(spi: ImuSpi<W>) -> Self {
        Self { spi, setup: None }
    }

    /// A step of the set-up: while [`sampling::setting_up`], once in a millisecond.
    pub fn run(&mut self) {
        let now_us = deadline::now_us();
        let Self { spi, setup } = self;
        let progress = setup
            .get_or_insert_with(|| {
                defmt::info!("inertial sensor: set-up begins");
                spi.claim();
                Setup::new(now_us)
            })
            .step(spi, now_us, sampling::edges());
        match progress {
            Progress::Waiting => {}
            Progress::Done => {
                *setup = None;
                spi.hand_over();
                sampling::set_up_done();
                defmt::info!("inertial sensor: set up");
            }
            // The control loop runs all the same, and refuses to arm.
            Progress::Failed(error) => {
                defmt::warn!("inertial sensor: {=str} {=u32:#x}", error.text(), error.number());
            }
        }
    }
}
