//! Flights with late, wrong and lost samples and frames.

use flight_core::ArmState;
use flight_core::arming::{Cause, Event};
use flight_core::sample::{Battery, ImuSample, MagSample, RcFrame};
use sim_host::flight::{Crash, Flight, Observer, Outcome, STEP_US, StepView};
use sim_host::scene::Scene;

/// Inputs and events of the flight controller in a flight.
#[derive(Debug, Default)]
struct Arrivals {
    imu: Vec<Option<ImuSample>>,
    mag: Vec<Option<MagSample>>,
    rc: Vec<Option<RcFrame>>,
    battery: Vec<Option<Battery>>,
    events: Vec<(f64, Event)>,
    airborne_steps: usize,
}

impl Observer for Arrivals {
    fn step(&mut self, view: &StepView) {
        self.imu.push(view.input.imu);
        self.mag.push(view.input.mag);
        self.rc.push(view.input.rc);
        self.battery.push(view.input.battery);
        self.airborne_steps += usize::from(view.truth.position.z < -1.0);
        if let Some(event) = view.output.event {
            self.events.push((view.time_us as f64 * 1e-6, event));
        }
    }
}

/// Flies the hover scene with these tables added.
fn hover_with(tables: &str) -> (Outcome, Arrivals) {
    let scene = Scene::parse("altered", &format!("include = \"hover\"\n{tables}")).unwrap();
    let mut arrivals = Arrivals::default();
    let outcome = Flight::new(&scene, scene.seed).run(&mut arrivals);
    (outcome, arrivals)
}

/// Returns time, new state and cause of each change of the arm state after arming.
fn after_arming(arrivals: &Arrivals) -> Vec<(f64, ArmState, Cause)> {
    let flown = arrivals.events.iter().skip_while(|(_, event)| event.to != ArmState::Armed).skip(1);
    flown.map(|(time_s, event)| (*time_s, event.to, event.cause)).collect()
}

#[test]
fn hover_flies_with_ten_percent_of_imu_samples_lost() {
    let (outcome, arrivals) = hover_with("[effects.imu.dropped_samples]\nprobability = 0.1\n");
    assert_eq!(outcome.crash, None);
    assert!(
        matches!(after_arming(&arrivals)[..], [(_, ArmState::Disarmed, Cause::Pilot)]),
        "{:?}",
        arrivals.events
    );
    println!("{outcome:?}");
    assert!(outcome.position_error_max_m < 1.5 && outcome.attitude_rmse_deg < 2.0, "{outcome:?}");
    let n = arrivals.imu.len() as f64;
    let lost = arrivals.imu.iter().filter(|imu| imu.is_none()).count() as f64 / n;
    // The bound is five standard errors, 5 √(0.1 · 0.9/30,000) = 0.0087.
    assert!((lost - 0.1).abs() < 5.0 * (0.09 / n).sqrt(), "{lost}");
}

#[test]
fn imu_latency_delays_the_same_samples() {
    // Before arming, on the ground, the truth does not depend on the flight controller.
    let (_, without_delay) = hover_with("");
    let (outcome, late) = hover_with("[effects.imu.latency]\nlatency_s = 0.004\n");
    assert_eq!(outcome.crash, None, "{outcome:?}");
    assert!(late.imu[..4].iter().all(Option::is_none));
    assert_eq!(late.imu[4..3004], without_delay.imu[..3000]);
    println!("4 ms late: {outcome:?}");
}

#[test]
fn dead_imu_in_flight_stops_the_motors() {
    let (outcome, arrivals) = hover_with("[[fault]]\nkind = \"dead\"\nsensor = \"imu\"\nat_s = 15.0\n");
    assert!(arrivals.airborne_steps > 5000, "the vehicle was in flight");
    // The last sample is that of 14.999 s. 100 ms without a sample are allowed, so the next step stops the motors.
    let (time_s, state, cause) = after_arming(&arrivals)[0];
    assert_eq!((state, cause), (ArmState::Terminated, Cause::ImuLost));
    assert!((time_s - 15.1).abs() < 1.5e-3, "{time_s}");
    // It falls from 2 m: √(2 · 9.8 · 2) = 6.3 m/s, more than the 2 m/s of a crash.
    assert!(matches!(outcome.crash, Some((Crash::HardTouchDown | Crash::TiltedTouchDown, _))), "{outcome:?}");
}

#[test]
fn link_outage_starts_a_descent_after_half_a_second() {
    let outage = |for_s: f64| hover_with(&format!("[effects.link.outage]\nat_s = 15.0\nfor_s = {for_s}\n"));
    let (short, arrivals) = outage(0.45);
    assert_eq!(short.crash, None);
    assert!(
        matches!(after_arming(&arrivals)[..], [(_, ArmState::Disarmed, Cause::Pilot)]),
        "{:?}",
        arrivals.events
    );
    // An outage of 2 s: the pilot has control again 0.5 s after the first frame.
    let (long, arrivals) = outage(2.0);
    assert_eq!((long.crash, long.final_state), (None, ArmState::Disarmed));
    let [(lost_s, ArmState::Descent, Cause::RcLost), (back_s, ArmState::Armed, Cause::RcBack), (..)] =
        after_arming(&arrivals)[..]
    else {
        panic!("{:?}", arrivals.events)
    };
    // The last frame came at 14.98 s, 20 ms before the outage; the next at 17.00 s.
    assert!((lost_s - 15.48).abs() < 2.5e-3 && (back_s - 17.5).abs() < 2.5e-3, "{lost_s} {back_s}");
    // The outage lasts until the end. The vehicle descends 2 m at up to 1.3 m/s, stands on the ground, and stops
    // its motors after 30 s.
    let (outcome, arrivals) =
        hover_with("[scene]\nduration_s = 60.0\n[effects.link.outage]\nat_s = 15.0\nfor_s = 45.0\n");
    println!("{outcome:?}");
    assert_eq!((outcome.crash, outcome.final_state), (None, ArmState::Terminated));
    let [(_, ArmState::Descent, Cause::RcLost), (over_s, ArmState::Terminated, Cause::DescentOver)] =
        after_arming(&arrivals)[..]
    else {
        panic!("{:?}", arrivals.events)
    };
    assert!((over_s - 45.48).abs() < 3e-3, "{over_s}");
}

#[test]
fn link_latency_and_loss_are_applied_to_the_frames() {
    let (_, without_delay) = hover_with("");
    let (outcome, late) = hover_with("[effects.link.latency]\nlatency_s = 0.033\n");
    assert_eq!(outcome.crash, None, "{outcome:?}");
    assert_eq!(late.rc[33..3033], without_delay.rc[..3000]);
    println!("33 ms late: {outcome:?}");

    let (outcome, lossy) = hover_with("[effects.link.loss]\nprobability = 0.3\n");
    assert_eq!(outcome.crash, None, "{outcome:?}");
    let sent = without_delay.rc.iter().flatten().count() as f64;
    let lost = 1.0 - lossy.rc.iter().flatten().count() as f64 / sent;
    // The bound is five standard errors of 1,500 frames, 5 √(0.21/1500) = 0.059.
    assert!((lost - 0.3).abs() < 5.0 * (0.21 / sent).sqrt(), "{lost}");
    println!("30 % lost: {outcome:?}");
}

/// Effects on delivery. None of them changes the truth before arming.
const EFFECTS: [&str; 9] = [
    "[effects.imu.latency]\nlatency_s = 0.002\n",
    "[effects.imu.dropped_samples]\nprobability = 0.2\n",
    "[effects.mag.dropped_samples]\nprobability = 0.2\n",
    "[effects.mag.latency]\nlatency_s = 0.02\n",
    "[effects.link.latency]\nlatency_s = 0.02\n",
    "[effects.link.loss]\nprobability = 0.2\n",
    "[effects.imu.sampling_jitter]\nsigma_us = 20.0\n",
    "[effects.mag.disturbance]\nat_s = 1.0\nfor_s = 1.0\nfield_ut = [10.0, 0.0, 0.0]\n",
    "[[fault]]\nkind = \"repeated_sample\"\nsensor = \"mag\"\nat_s = 1.0\nfor_s = 0.1\n",
];

/// The tasks of a board read the magnetometer every 5 ms and the battery voltage every 20 ms. Here the samples arrive in
/// the same steps.
#[test]
fn mag_and_battery_samples_arrive_at_the_boards_read_times() {
    let assert_aligned = |name: &str, arrivals: &Arrivals| {
        let steps =
            |some: Vec<bool>| some.into_iter().enumerate().filter(|(_, some)| *some).map(|(step, _)| step);
        for step in steps(arrivals.mag.iter().map(Option::is_some).collect()) {
            assert!(step.is_multiple_of(10), "{name}: a magnetometer sample in step {step}");
        }
        let voltages: Vec<usize> = steps(arrivals.battery.iter().map(Option::is_some).collect()).collect();
        let expected: Vec<usize> = (0..arrivals.battery.len()).step_by(20).collect();
        assert_eq!(voltages, expected, "{name}");
    };
    for effect in EFFECTS {
        assert_aligned(effect, &hover_with(effect).1);
    }
    for latency_s in [0.001, 0.004, 0.007, 0.0333] {
        let mag = format!("[effects.mag.latency]\nlatency_s = {latency_s}\n");
        assert_aligned(&mag, &hover_with(&mag).1);
    }
    for built_in in sim_host::scene::BUILT_IN.iter().filter(|scene| scene.name != "bench-static") {
        let mut arrivals = Arrivals::default();
        Flight::new(&Scene::load(built_in.name).unwrap(), 3).run(&mut arrivals);
        assert_aligned(built_in.name, &arrivals);
    }
}

#[test]
fn effects_do_not_change_each_others_draws() {
    // Before arming the truth is the same in all flights, so the samples differ only by the effects.
    let steps_at_rest = 2900;
    let (_, plain) = hover_with("");
    let gaps = |samples: &[Option<ImuSample>]| samples.iter().map(Option::is_some).collect::<Vec<_>>();
    let (_, dropping) = hover_with(EFFECTS[1]);
    for effect in EFFECTS {
        if effect == EFFECTS[1] {
            continue;
        }
        let (_, arrivals) = hover_with(effect);
        // Samples that this effect does not concern are bit for bit the same.
        if !effect.contains("imu") {
            assert_eq!(arrivals.imu[..steps_at_rest], plain.imu[..steps_at_rest], "{effect}");
        }
        if !effect.contains("mag") {
            assert_eq!(arrivals.mag[..steps_at_rest], plain.mag[..steps_at_rest], "{effect}");
        }
        if !effect.contains("link") {
            assert_eq!(arrivals.rc[..steps_at_rest], plain.rc[..steps_at_rest], "{effect}");
        }
        // With a loss in addition to this effect the same samples are lost.
        let (_, both) = hover_with(&format!("{effect}{}", EFFECTS[1]));
        if effect.contains("effects.imu.latency") {
            // The latency is two steps: in the first two steps there is no sample that could be lost.
            assert_ne!(gaps(&both.imu[..steps_at_rest]), gaps(&dropping.imu[..steps_at_rest]));
            assert_eq!(
                gaps(&both.imu[2..steps_at_rest]),
                gaps(&dropping.imu[..steps_at_rest - 2]),
                "{effect}"
            );
        } else {
            assert_eq!(both.imu[..steps_at_rest], dropping.imu[..steps_at_rest], "{effect}");
        }
    }
}

#[test]
fn loss_does_not_change_the_other_samples() {
    let (_, plain) = hover_with("");
    let (_, lossy) = hover_with(&format!("{}{}", EFFECTS[1], EFFECTS[2]));
    for k in 0..2900 {
        assert!(lossy.imu[k].is_none() || lossy.imu[k] == plain.imu[k], "at step {k}");
        assert!(lossy.mag[k].is_none() || lossy.mag[k] == plain.mag[k], "at step {k}");
    }
}

#[test]
fn faults_change_the_samples_in_their_interval() {
    let fault = |text: &str| hover_with(&format!("[[fault]]\nat_s = 1.0\nfor_s = 0.5\n{text}")).1;
    let (_, plain) = hover_with("");
    let step = (1_000_000 / STEP_US) as usize;
    let invalid = ImuSample { gyro: [i16::MIN; 3], accel: [i16::MIN; 3] };

    let dead = fault("kind = \"dead\"\nsensor = \"mag\"\n");
    assert!(dead.mag[step..step + 500].iter().all(Option::is_none));
    assert_eq!((dead.mag[step - 10], dead.mag[step + 500]), (plain.mag[step - 10], plain.mag[step + 500]));

    let code = fault("kind = \"invalid_code\"\nsensor = \"imu\"\n");
    assert!(code.imu[step..step + 500].iter().all(|imu| *imu == Some(invalid)));
    assert_eq!((code.imu[step - 1], code.imu[step + 500]), (plain.imu[step - 1], plain.imu[step + 500]));

    let stuck = fault("kind = \"stuck_axis\"\nsensor = \"accel\"\naxis = \"z\"\n");
    let first = plain.imu[step].unwrap().accel[2];
    for k in step..step + 500 {
        let (got, correct) = (stuck.imu[k].unwrap(), plain.imu[k].unwrap());
        assert_eq!(got, ImuSample { accel: [correct.accel[0], correct.accel[1], first], ..correct });
    }

    let spike = fault("kind = \"spike\"\nsensor = \"gyro\"\naxis = \"x\"\ncounts = 5000\n");
    let (got, correct) = (spike.imu[step].unwrap(), plain.imu[step].unwrap());
    assert_eq!(got.gyro, [correct.gyro[0] + 5000, correct.gyro[1], correct.gyro[2]]);

    let repeated = fault("kind = \"repeated_sample\"\nsensor = \"imu\"\n");
    assert!(repeated.imu[step..step + 500].iter().all(|imu| *imu == plain.imu[step - 1]));
}

#[test]
fn sampling_jitter_changes_samples_only_in_motion() {
    let jitter = "[effects.imu.sampling_jitter]\nsigma_us = 50.0\n";
    let (_, plain) = hover_with("");
    let (outcome, jittered) = hover_with(jitter);
    assert_eq!(outcome.crash, None, "{outcome:?}");
    // At rest the truth is the same at t and at t + δ.
    assert_eq!(jittered.imu[..2900], plain.imu[..2900]);
    assert!(jittered.imu[5000..] != plain.imu[5000..]);
}

#[test]
fn other_place_needs_the_declination_of_the_model() {
    let natick = "[scene.place]\nlatitude_deg = 42.283\nlongitude_deg = -71.35\n";
    let (right, _) = hover_with(&format!("{natick}[flight]\ndeclination_deg = \"model\"\n"));
    assert!(right.crash.is_none() && right.heading_rmse_deg < 3.0, "{right:?}");
    // With the declination of Ankara, 6.2°, instead of −13.7°, the heading error is the difference, 19.9°.
    let (wrong, _) = hover_with(natick);
    assert!((wrong.heading_rmse_deg - 19.9).abs() < 3.0, "{wrong:?}");
}

#[test]
fn hover_flies_on_every_preset() {
    for preset in ["icm-42688-p", "mpu-6050", "bmi088", "adis16448"] {
        let (outcome, _) = hover_with(&format!("[scene]\nimu = \"{preset}\"\n"));
        println!("{preset}: {outcome:?}");
        assert!(outcome.crash.is_none() && outcome.attitude_rmse_deg < 3.0, "{preset}: {outcome:?}");
    }
}

#[test]
fn pilot_arms_and_disarms_with_the_switch_of_the_vehicle() {
    let (outcome, arrivals) = hover_with("[vehicle.rc]\narm_by = \"switch\"\n");
    assert!(outcome.crash.is_none() && arrivals.airborne_steps > 10_000, "{outcome:?}");
    let after = after_arming(&arrivals);
    assert!(matches!(after[..], [(_, ArmState::Disarmed, Cause::Pilot)]), "{after:?}");
}

#[test]
fn magnetic_disturbance_increases_the_heading_error() {
    let (plain, _) = hover_with("");
    let (outcome, _) = hover_with(
        "[effects.mag.disturbance]\nat_s = 10.0\nfor_s = 10.0\nfield_ut = [0.0, 25.0, 0.0]\n[effects.mag.soft_iron]\n\
         matrix = [[1.02, 0.0, 0.0], [0.0, 0.98, 0.0], [0.0, 0.0, 1.0]]\n[effects.mag.motor_current]\n\
         field_ut_per_a = [0.5, 0.5, 0.0]\nsupply_v = 11.1\nefficiency = 0.6\n",
    );
    println!("{plain:?}\n{outcome:?}");
    assert!(outcome.heading_rmse_deg > plain.heading_rmse_deg + 2.0, "{outcome:?}");
}

#[test]
fn failed_sensor_stops_the_motors_with_its_cause() {
    let fails = |fault: &str| {
        let (outcome, arrivals) = hover_with(&format!("[[fault]]\nat_s = 15.0\n{fault}"));
        assert!(
            matches!(outcome.crash, Some((Crash::HardTouchDown | Crash::TiltedTouchDown, _))),
            "{outcome:?}"
        );
        assert_eq!(outcome.final_state, ArmState::Terminated);
        after_arming(&arrivals)[0]
    };
    // The code for "invalid" is not a sample, so the effect is that of a dead sensor.
    let (time_s, state, cause) = fails("kind = \"invalid_code\"\nsensor = \"imu\"\n");
    assert_eq!((state, cause), (ArmState::Terminated, Cause::ImuLost));
    assert!((time_s - 15.1).abs() < 1.5e-3, "{time_s}");
    // Each axis is stuck alone. The limit is 0.1 s and up to two samples more, because each sensor is checked at every
    // other sample.
    for sensor in ["gyro", "accel"] {
        for axis in ["x", "y", "z"] {
            let fault = format!("kind = \"stuck_axis\"\nsensor = \"{sensor}\"\naxis = \"{axis}\"\n");
            let (time_s, state, cause) = fails(&fault);
            assert_eq!((state, cause), (ArmState::Terminated, Cause::ImuStuck), "{sensor} {axis}");
            assert!((time_s - 15.1).abs() < 3e-3, "{sensor} {axis}: {time_s}");
        }
    }
    // Repeated samples look like a sensor that is stuck on all axes.
    let (_, state, cause) = fails("kind = \"repeated_sample\"\nsensor = \"imu\"\n");
    assert_eq!((state, cause), (ArmState::Terminated, Cause::ImuStuck));
}

#[test]
fn working_sensors_are_not_taken_for_stuck() {
    for scene in sim_host::scene::BUILT_IN.iter().filter(|scene| scene.name != "bench-static") {
        let scene = Scene::load(scene.name).unwrap();
        for seed in 0..5 {
            let mut arrivals = Arrivals::default();
            Flight::new(&scene, seed).run(&mut arrivals);
            let stuck = arrivals.events.iter().find(|(_, event)| event.cause == Cause::ImuStuck);
            assert_eq!(stuck, None, "{}, seed {seed}", scene.name);
        }
    }
}
