//! An effect of your own: `cargo run --release -p sim-host --example own_effect`
//!
//! Here the gyroscope measures a share of the acceleration of the vehicle's rates as a rate, as a sensor on a soft mount
//! does. The effect is added to a flight without changing the simulator. An effect that every scene may name is added to
//! the simulator itself: see CONTRIBUTING.md, "Add an effect".

use flight_core::geometry::Vec3;
use input::InputError;
use random::NormalStreams;
use sim_host::effects::{SensorEffect, Snapshot};
use sim_host::flight::{Flight, Outcome};
use sim_host::scene::Scene;

/// A soft mount: y ← y + τ ω̇ + n w, w normal with variance 1.
struct SoftMount {
    /// Time constant τ of the mount, s.
    tau_s: f64,
    /// Standard deviation n of the noise of the mount, rad/s.
    noise_rad_s: f64,
    /// Random streams of this effect. The name keeps them apart from those of all other effects.
    noise: NormalStreams,
}

impl SensorEffect for SoftMount {
    fn apply_to(&mut self, reading: &mut Vec3<f64>, at: &Snapshot) {
        *reading += at.angular_acceleration * self.tau_s + self.noise.draw() * self.noise_rad_s;
    }
}

fn fly(seed: u64, tau_s: f64) -> Result<Outcome, InputError> {
    let scene = Scene::load("steps")?;
    let mut flight = Flight::new(&scene, seed);
    let noise = NormalStreams::new(seed, "gyro.soft_mount");
    flight
        .sensors_mut()
        .gyro
        .push("gyro.soft_mount", Box::new(SoftMount { tau_s, noise_rad_s: 1.0e-3, noise }));
    Ok(flight.run(&mut ()))
}

fn main() -> Result<(), InputError> {
    for tau_s in [0.0, 2.0e-3, 5.0e-3] {
        let outcome = fly(1, tau_s)?;
        println!("τ {tau_s} s: {:.3}° of attitude error", outcome.attitude_rmse_deg);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn soft_mount_changes_the_flight() {
        let [rigid, soft] = [0.0, 5.0e-3].map(|tau_s| fly(1, tau_s).unwrap());
        assert_eq!((rigid.crash, soft.crash), (None, None));
        assert_ne!(rigid.digest, soft.digest);
    }

    #[test]
    fn same_seed_gives_same_digest() {
        assert_eq!(fly(3, 2.0e-3).unwrap().digest, fly(3, 2.0e-3).unwrap().digest);
    }
}
