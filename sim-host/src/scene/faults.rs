//! `[[fault]]`: sensor faults during a scene, with their time and duration.
//!
//! | kind | sensor | further keys |
//! |---|---|---|
//! | `stuck_axis` | gyro, accel, mag | `axis` |
//! | `spike` | gyro, accel, mag | `axis`, `counts` |
//! | `invalid_code` | imu, mag | |
//! | `dead` | imu, mag | |
//! | `repeated_sample` | imu, mag | |
//!
//! Gyroscope and accelerometer are in one chip and share a sample, so a fault of a whole sample is one of `imu`.

use flight_core::sample::{ImuSample, MagSample};
use serde::Deserialize;

use super::{Named, check};
use crate::effects::delivery::{
    BoxedDelivery, Counts, Dead, InvalidCode, RepeatedSample, Spike, StuckAxis, Window,
};
use input::InputError;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Kind {
    StuckAxis,
    InvalidCode,
    Dead,
    Spike,
    RepeatedSample,
}

/// Each kind with its name in the list of effects, in the order of that list.
const NAMES: [(Kind, &str); 5] = [
    (Kind::StuckAxis, "fault.stuck_axis"),
    (Kind::InvalidCode, "fault.invalid_code"),
    (Kind::Spike, "fault.spike"),
    (Kind::RepeatedSample, "fault.repeated_sample"),
    (Kind::Dead, "fault.dead"),
];

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum FaultySensor {
    Imu,
    Gyro,
    Accel,
    Mag,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Axis {
    X,
    Y,
    Z,
}

/// One table `[[fault]]`.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    kind: Kind,
    sensor: FaultySensor,
    /// Start of the fault, s.
    at_s: f64,
    /// Duration of the fault, s; `None` if it lasts until the end.
    for_s: Option<f64>,
    /// Axis of `stuck_axis` and `spike`.
    axis: Option<Axis>,
    /// Height of a `spike`, counts.
    counts: Option<i16>,
}

/// Returns all kinds of faults and whether the scene names one of each.
pub fn named(faults: &[Fault]) -> Vec<(&'static str, bool)> {
    NAMES.iter().map(|(kind, name)| (*name, faults.iter().any(|fault| fault.kind == *kind))).collect()
}

/// Removes all faults of a kind. Returns whether there was one.
pub fn remove(faults: &mut Vec<Fault>, name: &str) -> bool {
    let before = faults.len();
    faults.retain(|fault| fault.name() != name);
    faults.len() < before
}

/// Builds the faults of IMU samples in the order of the file, for steps at this rate.
pub fn on_imu(faults: &[Fault], rate_hz: f64) -> Vec<Named<BoxedDelivery<ImuSample>>> {
    let invalid = ImuSample { gyro: [i16::MIN; 3], accel: [i16::MIN; 3] };
    let build = |fault: &Fault| {
        let effect = match fault.sensor {
            FaultySensor::Imu | FaultySensor::Gyro => fault.build(rate_hz, |s| &mut s.gyro, invalid),
            FaultySensor::Accel => fault.build(rate_hz, |s| &mut s.accel, invalid),
            FaultySensor::Mag => return None,
        };
        Some((fault.name(), effect))
    };
    faults.iter().filter_map(build).collect()
}

/// Builds the faults of magnetometer samples in the order of the file, for samples at this rate.
pub fn on_mag(faults: &[Fault], rate_hz: f64) -> Vec<Named<BoxedDelivery<MagSample>>> {
    let invalid = MagSample { counts: [i16::MIN; 3] };
    faults
        .iter()
        .filter(|fault| fault.sensor == FaultySensor::Mag)
        .map(|fault| (fault.name(), fault.build(rate_hz, |s: &mut MagSample| &mut s.counts, invalid)))
        .collect()
}

impl Fault {
    fn name(&self) -> &'static str {
        NAMES.iter().find(|(kind, _)| *kind == self.kind).map_or("fault", |(_, name)| name)
    }

    /// Returns the start, s.
    pub fn at_s(&self) -> f64 {
        self.at_s
    }

    /// Checks that the keys are in range and fit the kind. `table` is the name of the table for errors.
    pub fn validate(&self, table: &str) -> Result<(), InputError> {
        check::key_in_range(table, "at_s", self.at_s, 0.0, 1e6, "s")?;
        if let Some(for_s) = self.for_s {
            check::key_in_range(table, "for_s", for_s, 1e-3, 1e6, "s")?;
        }
        let refused =
            |key: &str, message: String| Err(InputError::new(message).field(format!("{table}.{key}")));
        let kind = self.name().trim_start_matches("fault.");
        let of_one_axis = matches!(self.kind, Kind::StuckAxis | Kind::Spike);
        match (of_one_axis, self.sensor) {
            (true, FaultySensor::Imu) => {
                return refused("sensor", format!("must be gyro, accel or mag: {kind} affects one axis"));
            }
            (false, FaultySensor::Gyro | FaultySensor::Accel) => {
                return refused("sensor", format!("must be imu or mag: {kind} affects a whole sample"));
            }
            _ => {}
        }
        for (key, needed, given) in [
            ("axis", of_one_axis, self.axis.is_some()),
            ("counts", self.kind == Kind::Spike, self.counts.is_some()),
        ] {
            match (needed, given) {
                (true, false) => return refused(key, format!("is missing: a fault of kind {kind} needs it")),
                (false, true) => {
                    return refused(key, format!("must be left out: a fault of kind {kind} has none"));
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn build<T: Copy + Send + 'static>(
        &self,
        rate_hz: f64,
        counts: Counts<T>,
        invalid: T,
    ) -> BoxedDelivery<T> {
        let window = Window::new(self.at_s, self.for_s, rate_hz);
        // `validate` has checked that both are given for the kinds that need them.
        let axis = self.axis.map_or(0, |axis| axis as usize);
        let by = self.counts.unwrap_or(0);
        match self.kind {
            Kind::StuckAxis => Box::new(StuckAxis { window, counts, axis, held: None }),
            Kind::Spike => Box::new(Spike { window, counts, axis, by }),
            Kind::InvalidCode => Box::new(InvalidCode { window, sample: invalid }),
            Kind::RepeatedSample => Box::new(RepeatedSample { window, last: None }),
            Kind::Dead => Box::new(Dead(window)),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::scene::Scene;

    const BARE: &str = "[scene]\nduration_s = 1.0\nseed = 1\nvehicle = \"os4\"\nimu = \"paper\"\n";

    #[test]
    fn faults_are_listed_by_kind() {
        let text = format!("{BARE}[[fault]]\nkind = \"dead\"\nsensor = \"imu\"\nat_s = 0.5\n");
        let scene = Scene::parse("broken", &text).unwrap();
        assert_eq!(scene.effects(), ["fault.dead"]);
        assert!(scene.left_out().contains(&"fault.spike"));
    }

    #[test]
    fn removing_a_kind_removes_all_its_faults_and_no_others() {
        let fault = |kind: &str, at_s: f64| {
            format!("[[fault]]\nkind = \"{kind}\"\nsensor = \"imu\"\nat_s = {at_s}\nfor_s = 0.1\n")
        };
        let faults =
            [("dead", 0.1), ("invalid_code", 0.3), ("dead", 0.5)].map(|(kind, at_s)| fault(kind, at_s));
        let scene = Scene::parse("broken", &format!("{BARE}{}", faults.concat())).unwrap();
        assert_eq!(scene.effects(), ["fault.invalid_code", "fault.dead"]);
        assert_eq!(scene.without("fault.dead").unwrap().effects(), ["fault.invalid_code"]);
        assert!(scene.without("fault.spike").is_none());
    }

    #[test]
    fn keys_that_do_not_fit_the_kind_are_refused() {
        for (fault, wanted) in [
            ("kind = \"dead\"\nsensor = \"gyro\"\nat_s = 1.0", "fault.sensor: must be imu or mag"),
            (
                "kind = \"stuck_axis\"\nsensor = \"gyro\"\nat_s = 1.0",
                "fault.axis: is missing: a fault of kind stuck_axis needs it",
            ),
            (
                "kind = \"spike\"\nsensor = \"mag\"\naxis = \"x\"\nat_s = 1.0",
                "fault.counts: is missing: a fault of kind spike needs it",
            ),
            (
                "kind = \"dead\"\nsensor = \"mag\"\naxis = \"x\"\nat_s = 1.0",
                "fault.axis: must be left out: a fault of kind dead has none",
            ),
            ("kind = \"deaf\"\nsensor = \"mag\"\nat_s = 1.0", "did you mean `dead`?"),
            ("kind = \"dead\"\nsensor = \"mag\"\nat_s = -1.0", "fault.at_s = -1.0: must be from 0"),
        ] {
            let error =
                Scene::parse("wrong", &format!("{BARE}[[fault]]\n{fault}\n")).unwrap_err().to_string();
            assert!(error.contains(wanted), "{error}");
        }
    }
}
