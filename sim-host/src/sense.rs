//! The command `sense`: simulates the sensors of a scene and writes their samples with the truth.
//!
//! A scene with a pilot is flown, and its sensors are sampled in flight. In a scene without a pilot the vehicle lies on
//! the bench, so only the sensors are computed.

use crate::dynamics::Vehicle;
use crate::effects::Snapshot;
use crate::flight::{Flight, Observer, STEP_US, StepView};
use crate::log::{LogRow, LogWriter};
use crate::scene::{DEFAULT_RATE_HZ, MAG_RATE_HZ, Scene};
use crate::sensors::Sensors;
use input::InputError;

/// Samples the three sensors at the rate of the request.
struct Sampler<'a> {
    sensors: Sensors,
    /// IMU samples for each magnetometer sample.
    mag_every: u64,
    /// IMU samples until the next magnetometer sample.
    until_mag: u64,
    /// IMU samples so far.
    samples: u64,
    out: Option<&'a mut LogWriter>,
    /// The first error of a write.
    failed: Option<InputError>,
}

impl<'a> Sampler<'a> {
    fn new(scene: &Scene, seed: u64, rate_hz: u32, out: Option<&'a mut LogWriter>) -> Self {
        let mag_every = u64::from(rate_hz / MAG_RATE_HZ).max(1);
        let rate_hz = f64::from(rate_hz);
        Self {
            sensors: scene.for_run(seed).0.sensors(seed, rate_hz, rate_hz / mag_every as f64),
            mag_every,
            until_mag: 0,
            samples: 0,
            out,
            failed: None,
        }
    }

    /// Takes one sample of the truth.
    #[inline(always)]
    fn sample(&mut self, at: &Snapshot, moving: bool) {
        let imu = self.sensors.imu(at);
        let mut mag = None;
        if self.until_mag == 0 {
            self.until_mag = self.mag_every;
            mag = self.sensors.mag(at);
        }
        self.until_mag -= 1;
        self.samples += 1;
        let Some(out) = &mut self.out else {
            // Keeps the compiler from removing the computation, which the command measures.
            std::hint::black_box((&imu, &mag));
            return;
        };
        // A lost IMU sample has no row in a log.
        let Some(imu) = imu else { return };
        let Sensors { gyro, accel, mag: magnetometer, .. } = &self.sensors;
        let row = LogRow {
            time_s: at.time_s,
            gyro_rad_s: gyro.nominal(imu.gyro).into(),
            accel_m_s2: accel.nominal(imu.accel).into(),
            mag_ut: mag.map(|sample| magnetometer.nominal(sample.counts).into()),
            reference: Some(at.state.attitude.to_array()),
            moving,
        };
        if self.failed.is_none() {
            self.failed = out.write(&row).err();
        }
    }
}

/// Observer of a flight that samples its sensors every `interval_us`.
struct InFlight<'a> {
    sampler: Sampler<'a>,
    interval_us: u64,
}

impl Observer for InFlight<'_> {
    fn step(&mut self, view: &StepView) {
        if view.time_us.is_multiple_of(self.interval_us) {
            let moving = view.output.driven;
            self.sampler.sample(&view.snapshot, moving);
        }
    }
}

/// Samples the scene's sensors at `rate_hz` with this seed, and writes them to `out` if it is given. Returns the number of
/// samples.
///
/// # Errors
/// The rate is out of range for the scene, or the log cannot be written.
pub fn run(scene: &Scene, seed: u64, rate_hz: u32, out: Option<&mut LogWriter>) -> Result<u64, InputError> {
    let refused = |allowed: &str| Err(InputError::new(allowed).field("--rate-hz").value(rate_hz));
    // The length is a decimal number: a product just below 1 is a rounding error.
    if scene.duration_s * f64::from(rate_hz) < 1.0 - 1e-9 {
        let duration_s = scene.duration_s;
        return refused(&format!(
            "must be at least {:.3} Hz: {duration_s} s have no sample",
            1.0 / duration_s
        ));
    }
    let sampler = if scene.pilot.is_some() {
        if rate_hz == 0 || !DEFAULT_RATE_HZ.is_multiple_of(rate_hz) {
            return refused("must be 1000 Hz or 1000 Hz divided by a whole number, for a scene that flies");
        }
        let sampler = Sampler::new(scene, seed, rate_hz, out);
        let interval_us = STEP_US * u64::from(DEFAULT_RATE_HZ / rate_hz);
        let mut observer = InFlight { sampler, interval_us };
        Flight::new(scene, seed).run(&mut observer);
        observer.sampler
    } else {
        if !(1..=32_000).contains(&rate_hz) {
            return refused("must be from 1 to 32000 Hz");
        }
        let mut sampler = Sampler::new(scene, seed, rate_hz, out);
        let vehicle = Vehicle::at_rest(scene.vehicle, scene.mount(), vec![], 1e-3);
        let at_rest = vehicle.snapshot();
        let samples = libm::round(scene.duration_s * f64::from(rate_hz)) as u64;
        for k in 0..samples {
            let at = Snapshot { time_s: k as f64 / f64::from(rate_hz), ..at_rest };
            sampler.sample(&at, true);
        }
        sampler
    };
    match sampler.failed {
        Some(error) => Err(error),
        None => Ok(sampler.samples),
    }
}
