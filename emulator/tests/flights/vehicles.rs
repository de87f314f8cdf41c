//! An image that is built for another vehicle flies that vehicle.

use emulator::firmware::Firmware;
use flight_core::Params;
use sim_host::scene::Scene;
use vehicle::Vehicle;

use super::{assert_healthy, settings};

/// The vehicle's file gives both the configuration in the image and the simulated vehicle.
#[test]
fn image_for_five_inch_vehicle_flies_it() {
    let firmware = Firmware::build(&[("KESTREL_VEHICLE", "vehicles/five-inch.toml")]).unwrap();
    let config = firmware.vehicle().unwrap();
    let vehicle = Vehicle::load("five-inch").unwrap();
    assert_eq!(config.params, vehicle.with_mounting(vehicle.flight_params(&Params::default())));
    assert_eq!(config.calibration, None);

    let mut scene = Scene::load_with_vehicle("hover", Some("five-inch")).unwrap();
    scene.set_duration(20.0).unwrap();
    let flown = emulator::flight::fly(&scene, scene.seed, settings(&firmware, &scene, &[]), None).unwrap().0;
    assert_healthy(&flown);
    // The protocol in the vehicle's file is DShot600.
    assert!(flown.escs.iter().all(|esc| esc.last().is_some_and(|last| last.protocol.name() == "DShot600")));
}
