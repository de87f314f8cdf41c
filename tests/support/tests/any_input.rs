//! No NaN and no infinity leaves flight-core, and no motor turns without a permit, whatever comes in.

use std::collections::BTreeSet;
use std::sync::Mutex;

use flight_core::{ArmState, Config, FlightController, Params};
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use test_support::invariants::CheckedController;
use test_support::script::{self, Bytes, Script};

/// The states that a script went through; `None` for a configuration that was refused.
fn fly(bytes: &[u8]) -> Option<BTreeSet<&'static str>> {
    let script = Script::read(&mut Bytes::new(bytes));
    let mut watched = CheckedController::new(&script.config)?;
    script.fly(&mut watched);
    Some(watched.states)
}

/// Scripts at random keep the promises, and go everywhere: each state is reached, and of the configurations
/// neither all nor none are refused.
#[test]
fn whatever_comes_in() {
    let reached = Mutex::new(BTreeSet::new());
    let refused = Mutex::new(0_u32);
    let usual = ProptestConfig::default().cases.max(2_000);
    // A step takes Miri a hundredth of a second: it sees one short flight, and not the odds.
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

/// A scene, a file or a link may bring any configuration. One number out of a hundred that is wrong is refused
/// with its name and range, or harmless.
#[test]
#[cfg_attr(miri, ignore = "20,000 flights")]
fn every_number_of_a_configuration_may_be_anything() {
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
                        // The first field out of range, and what is said of it is true.
                        let within = error.value >= error.minimum && error.value <= error.maximum;
                        let edge = error.value == error.minimum || error.value == error.maximum;
                        assert!(!within || (error.exclusive && edge), "{error}");
                    }
                    Ok(_) => {
                        let mut watched = CheckedController::new(&config).unwrap();
                        let script = Script::read(&mut Bytes::new(&[])).with(config);
                        script.fly(&mut watched);
                    }
                }
            }
        }
    }
}

/// Every number at the two ends of its range, as the refusal of what is beyond them says; and then all of the controller's
/// gains and limits at their largest at once.
#[test]
#[cfg_attr(miri, ignore = "200 flights")]
fn every_number_of_a_configuration_may_be_at_its_limit() {
    let defaults = Config { params: Params::default(), calibration: Some(flight_core::Calibration::NONE) };
    let count = script::numbers(&mut defaults.clone()).len();
    let fly = |config: Config| {
        let mut watched = CheckedController::new(&config)?;
        Script::read(&mut Bytes::new(&[])).with(config).fly(&mut watched);
        Some(())
    };
    let (mut flown, mut all_gains, mut gains) = (0, defaults, 0);
    for index in 0..count {
        let mut config = defaults;
        *script::numbers(&mut config)[index] = f32::NAN;
        let beyond = FlightController::new(&config).expect_err("NaN is no configuration");
        for limit in [beyond.minimum, beyond.maximum] {
            *script::numbers(&mut config)[index] = limit;
            flown += usize::from(fly(config).is_some());
        }
        if beyond.field.starts_with("control.") {
            *script::numbers(&mut all_gains)[index] = beyond.maximum;
            gains += 1;
        }
    }
    // A matrix is refused by what all of its numbers make together, and a limit may be beyond another one's.
    assert!(flown > count, "{flown} of {count} numbers' limits are taken");
    assert!(gains >= 18, "{gains} gains and limits of the controller");
    fly(all_gains).expect("all gains at their largest are a configuration");
}
