//! Sensors at rest, from which the simulated figures are made.

use flight_core::geometry::Vec3;

use allan::{Fit, Phase, Point, Statistic, Taus};
use input::InputError;
use sim_host::dynamics::{GRAVITY, Vehicle};
use sim_host::effects::Snapshot;
use sim_host::scene::Scene;
use sim_host::sensors::Sensor;

/// Specific force of a level vehicle at rest, m/s².
pub const GRAVITY_UP: Vec3<f64> = Vec3 { x: 0.0, y: 0.0, z: -GRAVITY };

/// Returns a scene of a vehicle at rest on the bench, with these effects.
pub fn scene(duration_s: f64, seed: u64, effects: &str) -> Result<Scene, InputError> {
    let head =
        format!("[scene]\nduration_s = {duration_s:?}\nseed = {seed}\nvehicle = \"os4\"\nimu = \"paper\"\n");
    Scene::parse("paper", &(head + effects))
}

/// Returns the readings of a sensor with the true input `truth`, in SI units, after or before its converter.
pub fn readings(
    scene: &Scene,
    sensor: &mut Sensor,
    truth: Vec3<f64>,
    rate_hz: f64,
    through_converter: bool,
) -> [Vec<f64>; 3] {
    let rest = Vehicle::at_rest(scene.vehicle, scene.mount(), vec![], 1e-3);
    let mut axes = [Vec::new(), Vec::new(), Vec::new()];
    for k in 0..libm::round(scene.duration_s * rate_hz) as u32 {
        let at = Snapshot { time_s: f64::from(k) / rate_hz, ..rest.snapshot() };
        let reading = if through_converter {
            let counts = sensor.sample(truth, &at);
            sensor.nominal(counts)
        } else {
            sensor.measure(truth, &at)
        };
        for (axis, value) in axes.iter_mut().zip(<[f64; 3]>::from(reading)) {
            axis.push(value);
        }
    }
    axes
}

/// Returns the overlapping Allan deviations at octaves of τ, and the fit to them.
pub fn analysed(samples: Vec<f64>, rate_hz: f64, step: Option<f64>) -> (Vec<Point>, Fit) {
    let phase = Phase::of_rate(samples, 1.0 / rate_hz);
    let factors = Taus::Octave.factors(Statistic::Overlapping.largest_factor(phase.samples()));
    let points = allan::deviations(&phase, Statistic::Overlapping, &factors, 1, &|_, _| ());
    let fit = allan::fitted(&points, phase.length_s(), step);
    (points, fit)
}
