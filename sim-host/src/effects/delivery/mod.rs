//! Effects on samples between the converter and the flight controller, and on the frames of the transmitter: they
//! arrive late, get lost, or arrive wrong. One file for each effect.
//!
//! An effect is called at every step of its stream: with `Some` when there is a sample, with `None` when there is
//! none. Each effect is written once for IMU samples, magnetometer samples and receiver frames. The streams
//! of IMU samples and of the link step with the simulation; the magnetometer's stream has one step for each
//! of its samples.

mod faults;
mod latency;
mod loss;
mod outage;
mod sampling_jitter;
mod window;

pub use faults::{Counts, Dead, InvalidCode, RepeatedSample, Spike, StuckAxis};
pub use latency::Latency;
pub use loss::Loss;
pub use outage::Outage;
pub use sampling_jitter::{Jitter, SamplingJitter};
pub use window::Window;

use flight_core::sample::{ImuSample, MagSample};

use super::BoxedSensorEffect;

/// An effect on a stream of samples of type `T`.
pub trait Delivery<T>: Send {
    /// Passes the optional sample of one step through the effect. Called once for each step of the stream. It works
    /// in place, because most samples pass unchanged and then need not be moved.
    fn pass(&mut self, sample: &mut Option<T>);

    /// Does the same by value.
    fn step(&mut self, mut sample: Option<T>) -> Option<T> {
        self.pass(&mut sample);
        sample
    }
}

/// A boxed [`Delivery`].
pub type BoxedDelivery<T> = Box<dyn Delivery<T>>;

/// An effect on the magnetometer, after it is built.
pub enum MagEffect {
    /// On the reading, before the converter.
    Reading(BoxedSensorEffect),
    /// An effect on the samples.
    Delivery(BoxedDelivery<MagSample>),
}

impl From<BoxedSensorEffect> for MagEffect {
    fn from(effect: BoxedSensorEffect) -> Self {
        Self::Reading(effect)
    }
}

impl From<BoxedDelivery<MagSample>> for MagEffect {
    fn from(effect: BoxedDelivery<MagSample>) -> Self {
        Self::Delivery(effect)
    }
}

/// An effect on the IMU samples, after it is built.
pub enum ImuEffect {
    /// An effect on the time at which the sensors sample the truth.
    Sampling(Jitter),
    /// An effect on the samples.
    Delivery(BoxedDelivery<ImuSample>),
}

impl From<BoxedDelivery<ImuSample>> for ImuEffect {
    fn from(effect: BoxedDelivery<ImuSample>) -> Self {
        Self::Delivery(effect)
    }
}
