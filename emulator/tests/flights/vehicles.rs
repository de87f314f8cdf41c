//! The image that is built for a vehicle, flown by that vehicle.

use emulator::firmware::Firmware;
use flight_core::Params;
use sim_host::scene::Scene;
use vehicle::Vehicle;

use super::{assert_healthy, settings};

/// One file: the image holds what the flight controller needs of it, and the simulator flies it.
#[test]
fn an_image_for_five_inches_flies_them() {
    let firmware = Firmware::build(&[("KESTREL_VEHICLE", "vehicles/five-inch.toml")]).unwrap();
    let told = firmware.vehicle().unwrap();
    let vehicle = Vehicle::load("five-inch").unwrap();
    assert_eq!(told.params, vehicle.mounted(vehicle.flight_params(&Params::default())));
    assert_eq!(told.calibration, None);

    let mut scene = Scene::load_with_vehicle("hover", Some("five-inch")).unwrap();
    scene.set_duration(20.0).unwrap();
    let flown = emulator::flight::fly(&scene, scene.seed, settings(&firmware, &scene, &[]), None).unwrap().0;
    assert_healthy(&flown);
    // Its file says DShot600.
    assert!(flown.escs.iter().all(|esc| esc.last().is_some_and(|last| last.protocol.name() == "DShot600")));
}
