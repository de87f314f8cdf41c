//! The flight controller as a whole, lying level and still: what it takes to turn a motor, and what stops it.

use flight_core::arming::{Cause, Event};
use flight_core::rc::ArmBy;
use flight_core::rc::{HIGH_TICKS, LOW_TICKS};
use flight_core::sample::{BenchCommand, Health, LinkStatus};
use flight_core::{ArmState, Config};
use test_support::still_vehicle::{ARM, CENTRED, DISARM, StillVehicle, config};

use ArmState::*;

fn event(from: ArmState, to: ArmState, cause: Cause) -> Event {
    Event { from, to, cause }
}

/// Armed, throttle at a half: as in flight, as far as the flight controller can know.
fn flying(config: &Config) -> StillVehicle {
    let mut vehicle = StillVehicle::new(config);
    vehicle.sticks(CENTRED).run_ms(2_000);
    vehicle.sticks(ARM).run_ms(1_600);
    assert_eq!(vehicle.state(), Armed);
    let up = [992; 4];
    vehicle.sticks(up).run_ms(100);
    vehicle.events.clear();
    vehicle
}

#[test]
fn one_frame_that_looks_like_the_gesture_arms_nothing() {
    let mut vehicle = StillVehicle::new(&config());
    vehicle.run_ms(3_000);
    vehicle.sticks(ARM).run_ms(1);
    vehicle.silence().run_ms(5_000);
    assert_eq!((vehicle.state(), &vehicle.events[..]), (Disarmed, &[][..]));
    // Nor does one every 0.4 s, with silence or with centred sticks between them.
    for _ in 0..20 {
        vehicle.sticks(ARM).run_ms(1);
        vehicle.sticks(CENTRED).run_ms(399);
    }
    assert_eq!((vehicle.state(), &vehicle.events[..]), (Disarmed, &[][..]));
}

#[test]
fn every_obstacle_has_its_name() {
    let refused = |mut vehicle: StillVehicle| {
        vehicle.sticks(CENTRED).run_ms(2_000);
        vehicle.sticks(ARM).run_ms(2_000);
        assert!(!vehicle.turned, "{:?}", vehicle.events);
        vehicle.events
    };
    let refusal = |cause| vec![event(Disarmed, Disarmed, cause)];

    let mut usb = StillVehicle::new(&config());
    usb.health = Health { usb: true, ..Health::default() };
    assert_eq!(refused(usb), refusal(Cause::BenchLock));

    assert_eq!(
        refused(StillVehicle::new(&Config { calibration: None, ..config() })),
        refusal(Cause::NoCalibration)
    );

    let mut unknown = StillVehicle::new(&config());
    unknown.battery_v = None;
    assert_eq!(refused(unknown), refusal(Cause::BatteryLow));

    let mut dead = StillVehicle::new(&config());
    dead.sensor_dead = true;
    assert_eq!(refused(dead), refusal(Cause::ImuLost));

    let mut invalid = StillVehicle::new(&config());
    invalid.invalid_code = true;
    assert_eq!(refused(invalid), refusal(Cause::ImuLost));

    let mut stuck = StillVehicle::new(&config());
    stuck.axis_stuck = true;
    assert_eq!(refused(stuck), refusal(Cause::ImuStuck));

    let mut zeros = StillVehicle::new(&config());
    zeros.all_zeros = true;
    assert_eq!(refused(zeros), refusal(Cause::ImuStuck));

    for tilt_deg in [30.0, 90.0, 180.0] {
        let mut tilted = StillVehicle::new(&config());
        tilted.tilt_deg = tilt_deg;
        assert_eq!(refused(tilted), refusal(Cause::NotLevel));
    }

    let mut moved = StillVehicle::new(&config());
    moved.shaken = true;
    assert_eq!(refused(moved), refusal(Cause::NotStill));

    let mut late = StillVehicle::new(&config());
    late.misses_a_deadline_every_ms = Some(500);
    assert_eq!(refused(late), refusal(Cause::Overload));

    // With a switch the throttle may be up.
    let mut config = config();
    config.params.arm_by = ArmBy::Switch;
    let mut up = StillVehicle::new(&config);
    up.sticks([992; 4]).run_ms(2_000);
    up.arm_switch(HIGH_TICKS).run_ms(2_000);
    assert_eq!(up.events, refusal(Cause::ThrottleUp));
}

#[test]
fn an_arm_switch_works_from_off_to_on_with_the_throttle_low_and_stops_within_a_tenth_of_a_second() {
    let mut config = config();
    config.params.arm_by = ArmBy::Switch;
    let mut vehicle = StillVehicle::new(&config);
    vehicle.sticks(CENTRED).arm_switch(HIGH_TICKS).run_ms(5_000);
    assert_eq!((vehicle.state(), vehicle.events.len()), (Disarmed, 0), "on since power-up");
    vehicle.arm_switch(LOW_TICKS).run_ms(200);
    vehicle.arm_switch(HIGH_TICKS).run_ms(1_600);
    assert_eq!(vehicle.state(), Armed);
    // One corrupt frame is not the pilot.
    vehicle.arm_switch(LOW_TICKS).run_ms(20);
    vehicle.arm_switch(HIGH_TICKS).run_ms(1_000);
    assert_eq!(vehicle.state(), Armed);
    vehicle.arm_switch(LOW_TICKS).run_ms(122);
    assert_eq!(vehicle.state(), Disarmed);
    // The gesture means nothing now.
    vehicle.sticks(ARM).run_ms(5_000);
    assert_eq!(vehicle.state(), Disarmed);
}

#[test]
fn a_sensor_that_shows_nothing_ends_the_flight_within_a_tenth_of_a_second_or_two() {
    let end = |fault: fn(&mut StillVehicle), cause, after_ms| {
        let mut vehicle = flying(&config());
        fault(&mut vehicle);
        vehicle.run_ms(after_ms);
        assert_eq!(vehicle.state(), Armed, "{cause:?} too soon");
        vehicle.run_ms(5);
        assert_eq!(vehicle.events, [event(Armed, Terminated, cause)]);
        vehicle.events.clear();
        // It stays so when the sensor is back, after a second.
        vehicle.run_ms(1_000);
        (vehicle.sensor_dead, vehicle.all_zeros, vehicle.invalid_code) = (false, false, false);
        vehicle.run_ms(3_000);
        assert_eq!((vehicle.state(), vehicle.pulses_us), (Terminated, [1_000.0; 4]));
    };
    // No sample for 0.1 s; the code for "no sample"; and the same sample for 0.1 s.
    end(|vehicle| vehicle.sensor_dead = true, Cause::ImuLost, 98);
    end(|vehicle| vehicle.invalid_code = true, Cause::ImuLost, 98);
    end(|vehicle| vehicle.all_zeros = true, Cause::ImuStuck, 98);
}

#[test]
fn usb_stops_the_motors_and_the_pilot_must_take_note() {
    let mut vehicle = flying(&config());
    vehicle.health.usb = true;
    vehicle.run_ms(1);
    assert_eq!(vehicle.events, [event(Armed, Terminated, Cause::BenchLock)]);
    vehicle.health.usb = false;
    vehicle.sticks(ARM).run_ms(2_000);
    assert_eq!(vehicle.events[1..], [event(Terminated, Terminated, Cause::NotAcknowledged)]);
    vehicle.sticks(DISARM).run_ms(600);
    assert_eq!(vehicle.state(), Disarmed);
    vehicle.sticks(CENTRED).run_ms(1_200);
    vehicle.sticks(ARM).run_ms(1_600);
    assert_eq!(vehicle.state(), Armed);
}

#[test]
fn after_a_reset_by_the_watchdog_the_pilot_must_take_note() {
    let mut vehicle = StillVehicle::new(&config());
    vehicle.health.watchdog_reset = true;
    vehicle.run_ms(2_000);
    assert_eq!(vehicle.events, [event(Disarmed, Terminated, Cause::WatchdogReset)]);
    vehicle.sticks(CENTRED).run_ms(600);
    vehicle.sticks(ARM).run_ms(2_000);
    assert_eq!(vehicle.state(), Terminated);
    vehicle.sticks(DISARM).run_ms(600);
    vehicle.sticks(CENTRED).run_ms(1_200);
    vehicle.sticks(ARM).run_ms(1_600);
    assert_eq!(vehicle.state(), Armed);
}

#[test]
fn a_battery_that_runs_out_brings_the_vehicle_down_in_the_pilots_hands() {
    let mut vehicle = flying(&config());
    vehicle.sticks([HIGH_TICKS, 992, 992, 992]).run_ms(100);
    assert!(vehicle.pulses_us[0] > 1_900.0);
    vehicle.battery_v = Some(8.9);
    vehicle.run_ms(2_999);
    assert_eq!(vehicle.state(), Armed);
    vehicle.run_ms(2);
    assert_eq!(vehicle.events, [event(Armed, Descent, Cause::BatteryCritical)]);
    // Full throttle is that of the descent: the speed goes with the root of the thrust.
    vehicle.run_ms(1);
    let most = 1_000.0 + 1_000.0 * config().params.descent.throttle.sqrt() + 1.0;
    assert!(vehicle.pulses_us.iter().sum::<f32>() / 4.0 < most, "{:?}", vehicle.pulses_us);
    // A recovering battery changes nothing; a descent with a pilot has no end but the pilot's.
    vehicle.battery_v = Some(12.0);
    vehicle.run_ms(60_000);
    assert_eq!(vehicle.state(), Descent);
    vehicle.sticks(DISARM).run_ms(600);
    assert_eq!(vehicle.state(), Disarmed);
}

#[test]
fn the_bench_turns_one_motor_slowly_and_only_while_it_is_told_to() {
    let command = |rotor, thrust| Some(BenchCommand { rotor, thrust });
    let mut vehicle = StillVehicle::new(&config());
    vehicle.health.usb = true;
    vehicle.run_ms(100);
    for rotor in 1..=4 {
        vehicle.bench_every_ms(command(rotor, 1.0), 1).run_ms(500);
        assert_eq!(vehicle.state(), Bench);
        // A tenth of the thrust is √0.1 of the speed.
        let mut should = [1_000.0; 4];
        should[usize::from(rotor) - 1] = 1_000.0 + 1_000.0 * 0.1_f32.sqrt();
        for (pulse, should) in vehicle.pulses_us.iter().zip(should) {
            assert!((pulse - should).abs() < 0.01, "{:?}", vehicle.pulses_us);
        }
        vehicle.bench_every_ms(None, 1).run_ms(249);
        assert_eq!(vehicle.state(), Bench, "rotor {rotor}");
        vehicle.run_ms(2);
        assert_eq!((vehicle.state(), vehicle.pulses_us), (Disarmed, [1_000.0; 4]), "rotor {rotor}");
    }
    // A rotor that does not exist, a thrust that is no share: no command.
    for bad in [command(0, 0.1), command(5, 0.1), command(1, -0.1), command(1, 1.1), command(1, f32::NAN)] {
        vehicle.bench_every_ms(bad, 10).run_ms(1_000);
        assert_eq!(vehicle.state(), Disarmed);
    }
    // Ten seconds, then a pause.
    vehicle.events.clear();
    vehicle.bench_every_ms(command(1, 0.05), 100).run_ms(9_900);
    assert_eq!(vehicle.state(), Bench);
    vehicle.run_ms(20_000);
    assert_eq!(
        vehicle.events,
        [event(Disarmed, Bench, Cause::BenchCommand), event(Bench, Disarmed, Cause::BenchExpired)]
    );
    vehicle.bench_every_ms(None, 1).run_ms(400);
    vehicle.bench_every_ms(command(1, 0.05), 100).run_ms(400);
    assert_eq!(vehicle.state(), Bench);
}

#[test]
fn the_pilot_can_stop_the_bench_and_cannot_arm_into_it() {
    let mut vehicle = StillVehicle::new(&config());
    vehicle.sticks(CENTRED).bench_every_ms(Some(BenchCommand { rotor: 2, thrust: 0.1 }), 50).run_ms(1_000);
    assert_eq!(vehicle.state(), Bench);
    vehicle.sticks(DISARM).run_ms(600);
    assert_eq!(vehicle.state(), Disarmed);
    vehicle.run_ms(1_000);
    assert_eq!(vehicle.state(), Disarmed, "as long as the pilot says so");
    vehicle.sticks(CENTRED).run_ms(100);
    assert_eq!(vehicle.state(), Bench);
    vehicle.events.clear();
    vehicle.sticks(ARM).run_ms(1_100);
    assert_eq!(vehicle.events[0], event(Bench, Disarmed, Cause::BenchCommand));
    assert!(!vehicle.events.iter().any(|event| matches!(event.to, Arming | Armed)), "{:?}", vehicle.events);
}

#[test]
fn a_bench_command_in_flight_is_not_listened_to() {
    let mut vehicle = flying(&config());
    vehicle.bench_every_ms(Some(BenchCommand { rotor: 2, thrust: 0.1 }), 50).run_ms(2_000);
    assert_eq!((vehicle.state(), vehicle.events.len()), (Armed, 0));
}

#[test]
fn flash_is_erased_on_the_ground_and_never_in_flight() {
    let mut vehicle = flying(&config());
    vehicle.health.maintenance = true;
    vehicle.run_ms(5_000);
    assert_eq!(vehicle.state(), Armed);
    vehicle.sticks(DISARM).run_ms(600);
    assert_eq!(vehicle.state(), Maintenance);
    vehicle.sticks(CENTRED).run_ms(1_200);
    vehicle.sticks(ARM).run_ms(2_000);
    assert_eq!(vehicle.state(), Maintenance);
    vehicle.health.maintenance = false;
    vehicle.run_ms(1);
    assert_eq!(vehicle.state(), Disarmed);
}

#[test]
fn a_receiver_that_says_that_it_is_alone_is_believed_at_once() {
    let mut vehicle = flying(&config());
    vehicle.link_status(LinkStatus::Failsafe).run_ms(21);
    assert_eq!(vehicle.events, [event(Armed, Descent, Cause::RcLost)]);
    // On the ground, throttle low: nothing may spin up.
    let mut vehicle = flying(&config());
    vehicle.sticks(CENTRED).run_ms(100);
    vehicle.link_status(LinkStatus::Failsafe).run_ms(21);
    assert_eq!(vehicle.events, [event(Armed, Terminated, Cause::RcLost)]);
}

#[test]
fn lost_frames_that_are_repeated_are_a_loss_after_half_a_second() {
    let mut vehicle = flying(&config());
    vehicle.link_status(LinkStatus::FrameLost).run_ms(450);
    assert_eq!(vehicle.state(), Armed);
    vehicle.run_ms(100);
    assert_eq!(vehicle.events, [event(Armed, Descent, Cause::RcLost)]);
}
