//! For any input, flight-core outputs no NaN and no infinity, and no motor turns without a permit.

use std::collections::BTreeSet;
use std::sync::Mutex;

use flight_core::{ArmState, Config, FlightController, Params};
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use test_support::invariants::CheckedController;
use test_support::script::{self, Bytes, Script};

/// Flies a script and returns the states that it reached; `None` if the configuration was refused.
fn fly(bytes: &[u8]) -> Option<BTreeSet<&'static str>> {
    let script = Script::read(&mut Bytes::new(bytes));
    let mut controller = CheckedController::new(&script.config)?;
    script.fly(&mut controller);
    Some(controller.states)
}

/// Random scripts keep the invariants. Together they reach every state, and some but not all of their configurations
/// are refused.
#[test]
fn random_scripts_keep_invariants_and_reach_every_state() {
    let reached = Mutex::new(BTreeSet::new());
    let refused = Mutex::new(0_u32);
    let usual = ProptestConfig::default().cases.max(2_000);
    // A step takes Miri a hundredth of a second: under Miri one short flight runs, and the shares are not checked.
    let (cases, longest) = if cfg!(miri) { (1, 40) } else { (usual, 400) };
    let mut runner = TestRunner::new(ProptestConfig { cases, ..ProptestConfig::default() });
    runner
        .run(&prop::collection::vec(any::<u8>(), 0..longest), |bytes| {
            match fly(&bytes) {
                Some(states) => reached.lock().unwrap().extend(states),
                None => *refused.lock().unwrap() += 1,
            }
            Ok(())
        })
        .unwrap_or_else(|failure| panic!("{failure}"));
    if cfg!(miri) {
        return;
    }
    let refused = *refused.lock().unwrap();
    assert!(refused > cases / 20 && refused < cases / 2, "{refused} of {cases} configurations refused");
    let all: BTreeSet<_> = ArmState::ALL.map(ArmState::name).into();
    assert_eq!(*reached.lock().unwrap(), all);
}

/// A scene, a file or a link may deliver any configuration. One wrong number out of a hundred is either refused with
/// its name and range, or harmless.
#[test]
#[cfg_attr(miri, ignore = "20,000 flights")]
fn config_numbers_of_any_value_are_refused_or_harmless() {
    let defaults = Config { params: Params::default(), calibration: Some(flight_core::Calibration::NONE) };
    let count = script::numbers(&mut defaults.clone()).len();
    for index in 0..count {
        for value in script::SPECIAL.into_iter().chain(script::POWERS) {
            for literal in script::ESTIMATORS {
                let mut config = defaults;
                config.params.estimator = literal;
                *script::numbers(&mut config)[index] = value;
                match FlightController::new(&config) {
                    Err(error) => {
                        // The error names the first field out of range; its range is true.
                        let within = error.value >= error.minimum && error.value <= error.maximum;
                        let edge = error.value == error.minimum || error.value == error.maximum;
                        assert!(!within || (error.exclusive && edge), "{error}");
                    }
                    Ok(_) => {
                        let mut controller = CheckedController::new(&config).unwrap();
                        let script = Script::read(&mut Bytes::new(&[])).with_config(config);
                        script.fly(&mut controller);
                    }
                }
            }
        }
    }
}

/// Sets every number to both ends of its range, as the error for NaN gives them. Then sets all gains and limits of the
/// controller to their maximum at once.
#[test]
#[cfg_attr(miri, ignore = "200 flights")]
fn config_numbers_at_their_limits_are_harmless() {
    let defaults = Config { params: Params::default(), calibration: Some(flight_core::Calibration::NONE) };
    let count = script::numbers(&mut defaults.clone()).len();
    let fly = |config: Config| {
        let mut controller = CheckedController::new(&config)?;
        Script::read(&mut Bytes::new(&[])).with_config(config).fly(&mut controller);
        Some(())
    };
    let (mut flown, mut all_gains, mut gains) = (0, defaults, 0);
    for index in 0..count {
        let mut config = defaults;
        *script::numbers(&mut config)[index] = f32::NAN;
        let error = FlightController::new(&config).expect_err("NaN is refused");
        for limit in [error.minimum, error.maximum] {
            *script::numbers(&mut config)[index] = limit;
            flown += usize::from(fly(config).is_some());
        }
        if error.field.starts_with("control.") {
            *script::numbers(&mut all_gains)[index] = error.maximum;
            gains += 1;
        }
    }
    // A matrix may be refused for its determinant or shape, and a limit may contradict another one.
    assert!(flown > count, "{flown} limits of {count} numbers are accepted");
    assert!(gains >= 18, "{gains} gains and limits of the controller");
    fly(all_gains).expect("a configuration with all gains at their maximum is accepted");
}
