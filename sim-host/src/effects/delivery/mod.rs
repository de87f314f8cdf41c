//! What happens to samples on their way from the converter to the flight controller, and to the frames of the
//! transmitter: they come late, or not at all, or wrong. One file each.
//!
//! An effect sees the stream at every step: `Some` when a sample comes, `None` when none does. It is written
//! once for inertial samples, magnetometer samples and receiver frames. The inertial samples and the link are
//! stepped with the simulation, the magnetometer's stream with its own samples.

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

/// Acts on a stream of samples of type `T`.
pub trait Delivery<T>: Send {
    /// Makes of what comes at this step what goes on. Called once a step of the stream. In place: most of the
    /// time an effect leaves a sample alone, and then it is not moved either.
    fn pass(&mut self, sample: &mut Option<T>);

    /// The same by value.
    fn step(&mut self, mut sample: Option<T>) -> Option<T> {
        self.pass(&mut sample);
        sample
    }
}

/// A boxed [`Delivery`].
pub type BoxedDelivery<T> = Box<dyn Delivery<T>>;

/// An effect on the magnetometer, as built.
pub enum MagEffect {
    /// On the reading, before the converter.
    Reading(BoxedSensorEffect),
    /// On the samples.
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

/// An effect on the inertial samples, as built.
pub enum ImuEffect {
    /// On the time at which the truth is sampled.
    Sampling(Jitter),
    /// On the samples.
    Delivery(BoxedDelivery<ImuSample>),
}

impl From<BoxedDelivery<ImuSample>> for ImuEffect {
    fn from(effect: BoxedDelivery<ImuSample>) -> Self {
        Self::Delivery(effect)
    }
}
