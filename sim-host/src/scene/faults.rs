//! `[[fault]]`: what breaks during a scene, when, and for how long.
//!
//! | kind | of a sensor | further keys |
//! |---|---|---|
//! | `stuck_axis` | gyro, accel, mag | `axis` |
//! | `spike` | gyro, accel, mag | `axis`, `counts` |
//! | `invalid_code` | imu, mag | |
//! | `dead` | imu, mag | |
//! | `repeated_sample` | imu, mag | |
//!
//! Gyroscope and accelerometer are one chip and share a sample: what befalls a whole sample befalls `imu`.

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

/// Every kind and its name in the list of effects, in the order in which faults of one moment are listed.
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

/// One `[[fault]]`.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    kind: Kind,
    sensor: FaultySensor,
    /// The first moment at which it shows, s.
    at_s: f64,
    /// For how long, s; without it for good.
    for_s: Option<f64>,
    axis: Option<Axis>,
    counts: Option<i16>,
}

/// Every kind of fault, and whether one of them is named.
pub fn named(faults: &[Fault]) -> Vec<(&'static str, bool)> {
    NAMES.iter().map(|(kind, name)| (*name, faults.iter().any(|fault| fault.kind == *kind))).collect()
}

/// Leaves out every fault of a kind; whether there was one.
pub fn leave_out(faults: &mut Vec<Fault>, name: &str) -> bool {
    let named = faults.len();
    faults.retain(|fault| fault.name() != name);
    faults.len() < named
}

/// What befalls the inertial samples, in the order of the file, at this many steps a second.
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

/// What befalls the magnetometer's samples.
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

    /// Checks that the keys are in range and fit the kind.
    pub fn validate(&self) -> Result<(), InputError> {
        check::in_range("fault.at_s", self.at_s, 0.0, 1e6, "s")?;
        if let Some(for_s) = self.for_s {
            check::in_range("fault.for_s", for_s, 1e-3, 1e6, "s")?;
        }
        let of_one_axis = matches!(self.kind, Kind::StuckAxis | Kind::Spike);
        let said = |field: &str, message: &str| Err(InputError::new(message).field(field));
        match (of_one_axis, self.sensor) {
            (true, FaultySensor::Imu) => {
                return said("fault.sensor", "must be gyro, accel or mag: this kind is of one axis");
            }
            (false, FaultySensor::Gyro | FaultySensor::Accel) => {
                return said("fault.sensor", "must be imu or mag: this kind is of a whole sample");
            }
            _ => {}
        }
        if of_one_axis != self.axis.is_some() {
            return said("fault.axis", "is for stuck_axis and spike, which need it, and for no other kind");
        }
        if (self.kind == Kind::Spike) != self.counts.is_some() {
            return said("fault.counts", "is for spike, which needs it, and for no other kind");
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
        // Both are there where the kind takes them: see `validate`.
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
    fn every_fault_of_a_kind_is_left_out_at_once_and_no_other() {
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
            ("kind = \"stuck_axis\"\nsensor = \"gyro\"\nat_s = 1.0", "fault.axis: is for stuck_axis"),
            ("kind = \"spike\"\nsensor = \"mag\"\naxis = \"x\"\nat_s = 1.0", "fault.counts: is for spike"),
            ("kind = \"dead\"\nsensor = \"mag\"\naxis = \"x\"\nat_s = 1.0", "fault.axis: is for stuck_axis"),
            ("kind = \"deaf\"\nsensor = \"mag\"\nat_s = 1.0", "did you mean `dead`?"),
            ("kind = \"dead\"\nsensor = \"mag\"\nat_s = -1.0", "fault.at_s = -1: must be from 0"),
        ] {
            let said = Scene::parse("wrong", &format!("{BARE}[[fault]]\n{fault}\n")).unwrap_err().to_string();
            assert!(said.contains(wanted), "{said}");
        }
    }
}
