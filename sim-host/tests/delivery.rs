//! Flights whose samples and frames come late, wrong or not at all.

use flight_core::ArmState;
use flight_core::arming::{Cause, Event};
use flight_core::sample::{Battery, ImuSample, MagSample, RcFrame};
use sim_host::flight::{Crash, Flight, Observer, Outcome, STEP_US, StepView};
use sim_host::scene::Scene;

/// What the flight controller was given and what it said.
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

/// Flies the hover scene with these tables on top of it.
fn hover_with(tables: &str) -> (Outcome, Arrivals) {
    let scene = Scene::parse("altered", &format!("include = \"hover\"\n{tables}")).unwrap();
    let mut arrivals = Arrivals::default();
    let outcome = Flight::new(&scene, scene.seed).run(&mut arrivals);
    (outcome, arrivals)
}

/// When and why the motors' state changed after arming, and to which.
fn after_arming(arrivals: &Arrivals) -> Vec<(f64, ArmState, Cause)> {
    let flown = arrivals.events.iter().skip_while(|(_, event)| event.to != ArmState::Armed).skip(1);
    flown.map(|(time_s, event)| (*time_s, event.to, event.cause)).collect()
}

#[test]
fn hover_is_flown_though_one_inertial_sample_in_ten_is_lost() {
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
    // Five standard errors: 5 √(0.1 · 0.9/30,000) = 0.0087.
    assert!((lost - 0.1).abs() < 5.0 * (0.09 / n).sqrt(), "{lost}");
}

#[test]
fn latency_of_the_sensor_is_the_same_flight_seen_later() {
    // On the ground and before the arming nothing depends on what the flight controller makes of it.
    let (_, prompt) = hover_with("");
    let (outcome, late) = hover_with("[effects.imu.latency]\nlatency_s = 0.004\n");
    assert_eq!(outcome.crash, None, "{outcome:?}");
    assert!(late.imu[..4].iter().all(Option::is_none));
    assert_eq!(late.imu[4..3004], prompt.imu[..3000]);
    println!("4 ms late: {outcome:?}");
}

#[test]
fn a_dead_inertial_sensor_stops_the_motors() {
    let (outcome, arrivals) = hover_with("[[fault]]\nkind = \"dead\"\nsensor = \"imu\"\nat_s = 15.0\n");
    assert!(arrivals.airborne_steps > 5000, "it flew before");
    // The last sample is that of 14.999 s; 100 ms may pass, the next step is one too many.
    let (time_s, state, cause) = after_arming(&arrivals)[0];
    assert_eq!((state, cause), (ArmState::Terminated, Cause::ImuLost));
    assert!((time_s - 15.1).abs() < 1.5e-3, "{time_s}");
    // From two metres up it falls: √(2 · 9.8 · 2) = 6.3 m/s.
    assert!(matches!(outcome.crash, Some((Crash::HardTouchDown | Crash::TiltedTouchDown, _))), "{outcome:?}");
}

#[test]
fn an_outage_of_the_link_begins_a_descent_after_half_a_second_and_not_before() {
    let outage = |for_s: f64| hover_with(&format!("[effects.link.outage]\nat_s = 15.0\nfor_s = {for_s}\n"));
    let (short, arrivals) = outage(0.45);
    assert_eq!(short.crash, None);
    assert!(
        matches!(after_arming(&arrivals)[..], [(_, ArmState::Disarmed, Cause::Pilot)]),
        "{:?}",
        arrivals.events
    );
    // Two seconds: the pilot takes over again half a second after the first frame.
    let (long, arrivals) = outage(2.0);
    assert_eq!((long.crash, long.final_state), (None, ArmState::Disarmed));
    let [(lost_s, ArmState::Descent, Cause::RcLost), (back_s, ArmState::Armed, Cause::RcBack), (..)] =
        after_arming(&arrivals)[..]
    else {
        panic!("{:?}", arrivals.events)
    };
    // The last frame came at 14.98 s, 20 ms before the outage; the next at 17.00 s.
    assert!((lost_s - 15.48).abs() < 2.5e-3 && (back_s - 17.5).abs() < 2.5e-3, "{lost_s} {back_s}");
    // For good: it sinks two metres at most at 1.3 m/s, stands on the ground, and stops after half a minute.
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
fn frames_come_late_and_a_share_of_them_not_at_all() {
    let (_, prompt) = hover_with("");
    let (outcome, late) = hover_with("[effects.link.latency]\nlatency_s = 0.033\n");
    assert_eq!(outcome.crash, None, "{outcome:?}");
    assert_eq!(late.rc[33..3033], prompt.rc[..3000]);
    println!("33 ms late: {outcome:?}");

    let (outcome, lossy) = hover_with("[effects.link.loss]\nprobability = 0.3\n");
    assert_eq!(outcome.crash, None, "{outcome:?}");
    let sent = prompt.rc.iter().flatten().count() as f64;
    let lost = 1.0 - lossy.rc.iter().flatten().count() as f64 / sent;
    // Five standard errors of 1,500 frames: 5 √(0.21/1500) = 0.059.
    assert!((lost - 0.3).abs() < 5.0 * (0.21 / sent).sqrt(), "{lost}");
    println!("30 % lost: {outcome:?}");
}

/// Effects on delivery, each by itself without an influence on the flight before the arming.
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

/// The board's tasks look for a field every 5 ms and for a voltage every 20 ms: then these are there for the same step
/// as here.
#[test]
fn fields_and_voltages_arrive_when_the_boards_tasks_look() {
    let aligned = |what: &str, arrivals: &Arrivals| {
        let steps =
            |some: Vec<bool>| some.into_iter().enumerate().filter(|(_, some)| *some).map(|(step, _)| step);
        for step in steps(arrivals.mag.iter().map(Option::is_some).collect()) {
            assert!(step.is_multiple_of(10), "{what}: a field in step {step}");
        }
        let voltages: Vec<usize> = steps(arrivals.battery.iter().map(Option::is_some).collect()).collect();
        let expected: Vec<usize> = (0..arrivals.battery.len()).step_by(20).collect();
        assert_eq!(voltages, expected, "{what}");
    };
    for effect in EFFECTS {
        aligned(effect, &hover_with(effect).1);
    }
    for latency_s in [0.001, 0.004, 0.007, 0.0333] {
        let mag = format!("[effects.mag.latency]\nlatency_s = {latency_s}\n");
        aligned(&mag, &hover_with(&mag).1);
    }
    for built_in in sim_host::scene::BUILT_IN.iter().filter(|scene| scene.name != "bench-static") {
        let mut arrivals = Arrivals::default();
        Flight::new(&Scene::load(built_in.name).unwrap(), 3).run(&mut arrivals);
        aligned(built_in.name, &arrivals);
    }
}

#[test]
fn no_effect_moves_the_draws_of_another() {
    // Before the arming the truth is the same in all flights: what arrives differs only by the effects.
    let still = 2900;
    let (_, plain) = hover_with("");
    let gaps = |samples: &[Option<ImuSample>]| samples.iter().map(Option::is_some).collect::<Vec<_>>();
    let (_, dropping) = hover_with(EFFECTS[1]);
    for effect in EFFECTS {
        if effect == EFFECTS[1] {
            continue;
        }
        let (_, arrivals) = hover_with(effect);
        // What this effect does not touch is bit for bit as without it.
        if !effect.contains("imu") {
            assert_eq!(arrivals.imu[..still], plain.imu[..still], "{effect}");
        }
        if !effect.contains("mag") {
            assert_eq!(arrivals.mag[..still], plain.mag[..still], "{effect}");
        }
        if !effect.contains("link") {
            assert_eq!(arrivals.rc[..still], plain.rc[..still], "{effect}");
        }
        // And the samples that are lost are the same ones with this effect beside the loss.
        let (_, both) = hover_with(&format!("{effect}{}", EFFECTS[1]));
        if effect.contains("effects.imu.latency") {
            // Two steps late: the first two steps bring nothing that could be lost.
            assert_ne!(gaps(&both.imu[..still]), gaps(&dropping.imu[..still]));
            assert_eq!(gaps(&both.imu[2..still]), gaps(&dropping.imu[..still - 2]), "{effect}");
        } else {
            assert_eq!(both.imu[..still], dropping.imu[..still], "{effect}");
        }
    }
}

#[test]
fn the_samples_that_are_not_lost_are_those_of_the_flight_without_loss() {
    let (_, plain) = hover_with("");
    let (_, lossy) = hover_with(&format!("{}{}", EFFECTS[1], EFFECTS[2]));
    for k in 0..2900 {
        assert!(lossy.imu[k].is_none() || lossy.imu[k] == plain.imu[k], "at step {k}");
        assert!(lossy.mag[k].is_none() || lossy.mag[k] == plain.mag[k], "at step {k}");
    }
}

#[test]
fn faults_reach_the_flight_controller_at_their_time() {
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
        let (got, right) = (stuck.imu[k].unwrap(), plain.imu[k].unwrap());
        assert_eq!(got, ImuSample { accel: [right.accel[0], right.accel[1], first], ..right });
    }

    let spike = fault("kind = \"spike\"\nsensor = \"gyro\"\naxis = \"x\"\ncounts = 5000\n");
    let (got, right) = (spike.imu[step].unwrap(), plain.imu[step].unwrap());
    assert_eq!(got.gyro, [right.gyro[0] + 5000, right.gyro[1], right.gyro[2]]);

    let repeated = fault("kind = \"repeated_sample\"\nsensor = \"imu\"\n");
    assert!(repeated.imu[step..step + 500].iter().all(|imu| *imu == plain.imu[step - 1]));
}

#[test]
fn sampling_jitter_is_flown_and_shows_only_where_the_truth_changes() {
    let jitter = "[effects.imu.sampling_jitter]\nsigma_us = 50.0\n";
    let (_, plain) = hover_with("");
    let (outcome, jittered) = hover_with(jitter);
    assert_eq!(outcome.crash, None, "{outcome:?}");
    // At rest nothing changes between t and t + δ.
    assert_eq!(jittered.imu[..2900], plain.imu[..2900]);
    assert!(jittered.imu[5000..] != plain.imu[5000..]);
}

#[test]
fn a_scene_elsewhere_flies_by_the_declination_of_the_model() {
    let natick = "[scene.place]\nlatitude_deg = 42.283\nlongitude_deg = -71.35\n";
    let (right, _) = hover_with(&format!("{natick}[flight]\ndeclination_deg = \"model\"\n"));
    assert!(right.crash.is_none() && right.heading_rmse_deg < 3.0, "{right:?}");
    // With Ankara's 6.2° in place of −13.7° the heading is wrong by the difference.
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
fn a_magnetic_object_turns_the_heading_while_it_passes() {
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
fn a_sensor_that_fails_in_flight_stops_the_motors_by_name() {
    let fails = |fault: &str| {
        let (outcome, arrivals) = hover_with(&format!("[[fault]]\nat_s = 15.0\n{fault}"));
        assert!(
            matches!(outcome.crash, Some((Crash::HardTouchDown | Crash::TiltedTouchDown, _))),
            "{outcome:?}"
        );
        assert_eq!(outcome.final_state, ArmState::Terminated);
        after_arming(&arrivals)[0]
    };
    // The code for "invalid" is no sample: as if the sensor were dead.
    let (time_s, state, cause) = fails("kind = \"invalid_code\"\nsensor = \"imu\"\n");
    assert_eq!((state, cause), (ArmState::Terminated, Cause::ImuLost));
    assert!((time_s - 15.1).abs() < 1.5e-3, "{time_s}");
    // Each axis by itself. Two samples more than a tenth of a second: each sensor is looked at in every other one.
    for sensor in ["gyro", "accel"] {
        for axis in ["x", "y", "z"] {
            let fault = format!("kind = \"stuck_axis\"\nsensor = \"{sensor}\"\naxis = \"{axis}\"\n");
            let (time_s, state, cause) = fails(&fault);
            assert_eq!((state, cause), (ArmState::Terminated, Cause::ImuStuck), "{sensor} {axis}");
            assert!((time_s - 15.1).abs() < 3e-3, "{sensor} {axis}: {time_s}");
        }
    }
    // Repeated samples are one that is stuck on all axes.
    let (_, state, cause) = fails("kind = \"repeated_sample\"\nsensor = \"imu\"\n");
    assert_eq!((state, cause), (ArmState::Terminated, Cause::ImuStuck));
}

#[test]
fn no_good_sensor_is_taken_for_a_stuck_one() {
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
