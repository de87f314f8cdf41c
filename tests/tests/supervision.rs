//! The flight controller of a level vehicle at rest: what is needed to turn a motor, and what stops it.

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

/// Returns a vehicle that is armed with the throttle at half: for the flight controller, as in flight.
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
fn single_arm_gesture_frames_do_not_arm() {
    let mut vehicle = StillVehicle::new(&config());
    vehicle.run_ms(3_000);
    vehicle.sticks(ARM).run_ms(1);
    vehicle.silence().run_ms(5_000);
    assert_eq!((vehicle.state(), &vehicle.events[..]), (Disarmed, &[][..]));
    // One frame every 0.4 s does not arm either, with silence or with centred sticks between them.
    for _ in 0..20 {
        vehicle.sticks(ARM).run_ms(1);
        vehicle.sticks(CENTRED).run_ms(399);
    }
    assert_eq!((vehicle.state(), &vehicle.events[..]), (Disarmed, &[][..]));
}

#[test]
fn each_arming_obstacle_is_reported_by_its_cause() {
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

    // With an arm switch the throttle can be up while arming.
    let mut config = config();
    config.params.arm_by = ArmBy::Switch;
    let mut up = StillVehicle::new(&config);
    up.sticks([992; 4]).run_ms(2_000);
    up.arm_switch(HIGH_TICKS).run_ms(2_000);
    assert_eq!(up.events, refusal(Cause::ThrottleUp));
}

#[test]
fn arm_switch_arms_from_off_to_on_and_disarms_within_122_ms() {
    let mut config = config();
    config.params.arm_by = ArmBy::Switch;
    let mut vehicle = StillVehicle::new(&config);
    vehicle.sticks(CENTRED).arm_switch(HIGH_TICKS).run_ms(5_000);
    assert_eq!((vehicle.state(), vehicle.events.len()), (Disarmed, 0), "on since power-up");
    vehicle.arm_switch(LOW_TICKS).run_ms(200);
    vehicle.arm_switch(HIGH_TICKS).run_ms(1_600);
    assert_eq!(vehicle.state(), Armed);
    // A single corrupt frame does not disarm.
    vehicle.arm_switch(LOW_TICKS).run_ms(20);
    vehicle.arm_switch(HIGH_TICKS).run_ms(1_000);
    assert_eq!(vehicle.state(), Armed);
    vehicle.arm_switch(LOW_TICKS).run_ms(122);
    assert_eq!(vehicle.state(), Disarmed);
    // With an arm switch the gesture does nothing.
    vehicle.sticks(ARM).run_ms(5_000);
    assert_eq!(vehicle.state(), Disarmed);
}

#[test]
fn imu_without_new_data_terminates_flight_after_100_ms() {
    let end = |fault: fn(&mut StillVehicle), cause, after_ms| {
        let mut vehicle = flying(&config());
        fault(&mut vehicle);
        vehicle.run_ms(after_ms);
        assert_eq!(vehicle.state(), Armed, "{cause:?} too soon");
        vehicle.run_ms(5);
        assert_eq!(vehicle.events, [event(Armed, Terminated, cause)]);
        vehicle.events.clear();
        // The state stays when the sensor recovers after a second.
        vehicle.run_ms(1_000);
        (vehicle.sensor_dead, vehicle.all_zeros, vehicle.invalid_code) = (false, false, false);
        vehicle.run_ms(3_000);
        assert_eq!((vehicle.state(), vehicle.pulses_us), (Terminated, [1_000.0; 4]));
    };
    // For 0.1 s there is no sample, or the code for "no sample", or the same sample.
    end(|vehicle| vehicle.sensor_dead = true, Cause::ImuLost, 98);
    end(|vehicle| vehicle.invalid_code = true, Cause::ImuLost, 98);
    end(|vehicle| vehicle.all_zeros = true, Cause::ImuStuck, 98);
}

#[test]
fn usb_terminates_flight_until_the_pilot_acknowledges() {
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
fn watchdog_reset_terminates_until_the_pilot_acknowledges() {
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
fn critical_battery_starts_descent_that_the_pilot_ends() {
    let mut vehicle = flying(&config());
    vehicle.sticks([HIGH_TICKS, 992, 992, 992]).run_ms(100);
    assert!(vehicle.pulses_us[0] > 1_900.0);
    vehicle.battery_v = Some(8.9);
    vehicle.run_ms(2_999);
    assert_eq!(vehicle.state(), Armed);
    vehicle.run_ms(2);
    assert_eq!(vehicle.events, [event(Armed, Descent, Cause::BatteryCritical)]);
    // Full stick gives the throttle of the descent. The speed is proportional to the square root of the thrust.
    vehicle.run_ms(1);
    let max_us = 1_000.0 + 1_000.0 * config().params.descent.throttle.sqrt() + 1.0;
    assert!(vehicle.pulses_us.iter().sum::<f32>() / 4.0 < max_us, "{:?}", vehicle.pulses_us);
    // A recovering battery changes nothing. This descent has no time limit: it ends when the pilot disarms.
    vehicle.battery_v = Some(12.0);
    vehicle.run_ms(60_000);
    assert_eq!(vehicle.state(), Descent);
    vehicle.sticks(DISARM).run_ms(600);
    assert_eq!(vehicle.state(), Disarmed);
}

#[test]
fn bench_turns_one_capped_motor_only_while_commanded() {
    let command = |rotor, thrust| Some(BenchCommand { rotor, thrust });
    let mut vehicle = StillVehicle::new(&config());
    vehicle.health.usb = true;
    vehicle.run_ms(100);
    for rotor in 1..=4 {
        vehicle.bench_every_ms(command(rotor, 1.0), 1).run_ms(500);
        assert_eq!(vehicle.state(), Bench);
        // A tenth of the thrust needs √0.1 of the speed.
        let mut expected = [1_000.0; 4];
        expected[usize::from(rotor) - 1] = 1_000.0 + 1_000.0 * 0.1_f32.sqrt();
        for (pulse, expected) in vehicle.pulses_us.iter().zip(expected) {
            assert!((pulse - expected).abs() < 0.01, "{:?}", vehicle.pulses_us);
        }
        vehicle.bench_every_ms(None, 1).run_ms(249);
        assert_eq!(vehicle.state(), Bench, "rotor {rotor}");
        vehicle.run_ms(2);
        assert_eq!((vehicle.state(), vehicle.pulses_us), (Disarmed, [1_000.0; 4]), "rotor {rotor}");
    }
    // Invalid commands: a rotor that does not exist, a thrust outside 0 to 1.
    for bad in [command(0, 0.1), command(5, 0.1), command(1, -0.1), command(1, 1.1), command(1, f32::NAN)] {
        vehicle.bench_every_ms(bad, 10).run_ms(1_000);
        assert_eq!(vehicle.state(), Disarmed);
    }
    // A motor turns for at most ten seconds; then the commands must pause.
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
fn pilot_stops_the_bench_and_cannot_arm_from_it() {
    let mut vehicle = StillVehicle::new(&config());
    vehicle.sticks(CENTRED).bench_every_ms(Some(BenchCommand { rotor: 2, thrust: 0.1 }), 50).run_ms(1_000);
    assert_eq!(vehicle.state(), Bench);
    vehicle.sticks(DISARM).run_ms(600);
    assert_eq!(vehicle.state(), Disarmed);
    vehicle.run_ms(1_000);
    assert_eq!(vehicle.state(), Disarmed, "while the pilot holds the disarm gesture");
    vehicle.sticks(CENTRED).run_ms(100);
    assert_eq!(vehicle.state(), Bench);
    vehicle.events.clear();
    vehicle.sticks(ARM).run_ms(1_100);
    assert_eq!(vehicle.events[0], event(Bench, Disarmed, Cause::BenchCommand));
    assert!(!vehicle.events.iter().any(|event| matches!(event.to, Arming | Armed)), "{:?}", vehicle.events);
}

#[test]
fn bench_command_in_flight_is_ignored() {
    let mut vehicle = flying(&config());
    vehicle.bench_every_ms(Some(BenchCommand { rotor: 2, thrust: 0.1 }), 50).run_ms(2_000);
    assert_eq!((vehicle.state(), vehicle.events.len()), (Armed, 0));
}

#[test]
fn maintenance_starts_on_the_ground_and_never_in_flight() {
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
fn receiver_failsafe_flag_is_link_loss_at_once() {
    let mut vehicle = flying(&config());
    vehicle.link_status(LinkStatus::Failsafe).run_ms(21);
    assert_eq!(vehicle.events, [event(Armed, Descent, Cause::RcLost)]);
    // On the ground with the throttle low the motors stop instead.
    let mut vehicle = flying(&config());
    vehicle.sticks(CENTRED).run_ms(100);
    vehicle.link_status(LinkStatus::Failsafe).run_ms(21);
    assert_eq!(vehicle.events, [event(Armed, Terminated, Cause::RcLost)]);
}

#[test]
fn repeated_lost_frames_are_link_loss_after_half_a_second() {
    let mut vehicle = flying(&config());
    vehicle.link_status(LinkStatus::FrameLost).run_ms(450);
    assert_eq!(vehicle.state(), Armed);
    vehicle.run_ms(100);
    assert_eq!(vehicle.events, [event(Armed, Descent, Cause::RcLost)]);
}
