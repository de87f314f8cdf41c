//! Conversion of the tables `[rotors]` and `[inertia]` to the simulator's figures.

use flight_core::geometry::Vec3;
use input::InputError;
use input::check::in_range;

use super::{Inertia, Notes, Rotors, all_in_range, exactly_one, in_words, optional_in_range};

/// Voltage of a cell under load, V: gives the speed at full throttle from a motor's kV.
const LOADED_CELL_V: f64 = 3.7;
/// Speed that a motor reaches with its propeller, as a share of kV × voltage: 70 to 80 % on thrust stands.
const LOADED_SHARE: f64 = 0.75;
/// Torque over thrust (d/b) as a share of the propeller's diameter: 0.08 to 0.11 for two and three blades.
const TORQUE_PER_DIAMETER: f64 = 0.1;

impl Inertia {
    /// Returns the vehicle's moments of inertia about x, y and z, kg·m².
    pub(super) fn build(
        &self,
        mass_kg: f64,
        forward_m: f64,
        right_m: f64,
        notes: &mut Notes,
    ) -> Result<Vec3<f64>, InputError> {
        let hub = self.hub_g.is_some() || self.hub_mm.is_some();
        let keys = [("kg_m2", self.kg_m2.is_some()), ("hub_g with hub_mm", hub)];
        exactly_one("inertia", &keys)?;
        let inertia = match (self.kg_m2, self.hub_g, self.hub_mm) {
            (Some(inertia), _, _) => {
                all_in_range("inertia.kg_m2", inertia, 1e-6, 100.0, "kg m²")?;
                inertia
            }
            (None, Some(hub_g), Some(hub_mm)) => {
                in_range("inertia.hub_g", hub_g, 1.0, mass_kg * 1e3, "g")?;
                all_in_range("inertia.hub_mm", hub_mm, 1.0, 2_000.0, "mm")?;
                // The hub is a box of length, width and height; the rest of the mass is four points at the rotors.
                let hub_kg = hub_g / 1e3;
                let outside_kg = mass_kg - hub_kg;
                let [length, width, height] = hub_mm.map(|mm| mm / 1e3);
                let of_box = |a: f64, b: f64| hub_kg * (a * a + b * b) / 12.0;
                let inertia = [
                    of_box(width, height) + outside_kg * right_m * right_m,
                    of_box(length, height) + outside_kg * forward_m * forward_m,
                    of_box(length, width) + outside_kg * (forward_m * forward_m + right_m * right_m),
                ];
                let [x, y, z] = inertia.map(|inertia| inertia * 1e3);
                let how = format!(
                    "a box of {hub_g} g and {:.0} g at the rotors; measure them, or take them from the CAD model",
                    outside_kg * 1e3
                );
                notes.add("moments of inertia", format!("{x:.2}, {y:.2}, {z:.2} g m²"), how, true);
                inertia
            }
            (None, Some(_), None) => {
                return Err(InputError::new("is missing: hub_g needs it").field("inertia.hub_mm"));
            }
            (None, None, _) => {
                return Err(InputError::new("is missing: hub_mm needs it").field("inertia.hub_g"));
            }
        };
        // No rigid body has a moment of inertia larger than the sum of the other two.
        let [x, y, z] = inertia;
        for (value, others) in [(x, y + z), (y, x + z), (z, x + y)] {
            // Published figures exceed the sum by about a percent: 5 % are allowed.
            if value > others * 1.05 {
                return Err(InputError::new(
                    "must be at most the sum of the other two moments of inertia, as for every rigid body",
                )
                .field("inertia.kg_m2")
                .value(value));
            }
        }
        Ok(Vec3::from(inertia))
    }
}

impl Rotors {
    /// Returns the distances of the rotors forward and right of the centre of gravity, m.
    pub(super) fn positions(&self) -> Result<(f64, f64), InputError> {
        let rectangle = self.forward_mm.is_some() || self.right_mm.is_some();
        exactly_one("rotors", &[("arm_mm", self.arm_mm.is_some()), ("forward_mm with right_mm", rectangle)])?;
        if let Some(arm_mm) = optional_in_range("rotors.arm_mm", self.arm_mm, 20.0, 5e3, "mm")? {
            // Rotors at the corners of a square.
            let distance_m = arm_mm / 1e3 * std::f64::consts::FRAC_1_SQRT_2;
            return Ok((distance_m, distance_m));
        }
        let distance_m = |key: &str, value: Option<f64>, other: &str| {
            optional_in_range(&format!("rotors.{key}"), value, 14.0, 5e3, "mm")?
                .map(|mm| mm / 1e3)
                .ok_or_else(|| {
                    InputError::new(format!("is missing: {other} needs it")).field(format!("rotors.{key}"))
                })
        };
        Ok((
            distance_m("forward_mm", self.forward_mm, "right_mm")?,
            distance_m("right_mm", self.right_mm, "forward_mm")?,
        ))
    }

    /// Returns the speed at full throttle, rad/s.
    pub(super) fn max_rad_s(&self, cells: u8, notes: &mut Notes) -> Result<f64, InputError> {
        exactly_one(
            "rotors",
            &[
                ("max_rad_s", self.max_rad_s.is_some()),
                ("max_rpm", self.max_rpm.is_some()),
                ("kv_rpm_per_v", self.kv_rpm_per_v.is_some()),
            ],
        )?;
        if let Some(speed) = optional_in_range("rotors.max_rad_s", self.max_rad_s, 65.0, 1e4, "rad/s")? {
            return Ok(speed);
        }
        const RAD_S_PER_RPM: f64 = std::f64::consts::TAU / 60.0;
        if let Some(rpm) = optional_in_range("rotors.max_rpm", self.max_rpm, 650.0, 9.5e4, "rpm")? {
            return Ok(rpm * RAD_S_PER_RPM);
        }
        let kv = optional_in_range("rotors.kv_rpm_per_v", self.kv_rpm_per_v, 50.0, 30_000.0, "rpm/V")?
            .unwrap_or(0.0);
        let speed = kv * RAD_S_PER_RPM * LOADED_CELL_V * f64::from(cells) * LOADED_SHARE;
        let how = format!("75 % of {kv} rpm/V at {LOADED_CELL_V} V a cell, {}", in_words(cells));
        notes.add("speed at full throttle", format!("{speed:.0} rad/s"), how, true);
        if !(65.0..=1e4).contains(&speed) {
            return Err(InputError::new(format!(
                "gives {speed:.0} rad/s at full throttle with {}: must give from 65 to 10000 rad/s",
                in_words(cells)
            ))
            .field("rotors.kv_rpm_per_v")
            .value(kv));
        }
        Ok(speed)
    }

    /// Returns the thrust coefficient b, N·s².
    pub(super) fn thrust_coefficient(&self, max_rad_s: f64, notes: &mut Notes) -> Result<f64, InputError> {
        let keys = [("thrust_n_s2", self.thrust_n_s2), ("full_thrust_g", self.full_thrust_g)];
        exactly_one("rotors", &keys.map(|(key, value)| (key, value.is_some())))?;
        if let Some(b) = optional_in_range("rotors.thrust_n_s2", self.thrust_n_s2, 1e-9, 0.1, "N s²")? {
            return Ok(b);
        }
        let full_g =
            optional_in_range("rotors.full_thrust_g", self.full_thrust_g, 1.0, 1e5, "g")?.unwrap_or(0.0);
        let b = full_g / 1e3 * crate::GRAVITY / (max_rad_s * max_rad_s);
        let how = format!("{full_g} g at {max_rad_s:.0} rad/s");
        notes.add("thrust coefficient", format!("{b:.3e} N s²"), how, false);
        if !(1e-9..=0.1).contains(&b) {
            return Err(InputError::new(format!(
                "gives a thrust coefficient of {b:.3e} N s² at {max_rad_s:.0} rad/s: must give from 1e-9 to 0.1 N s²"
            ))
            .field("rotors.full_thrust_g")
            .value(full_g));
        }
        Ok(b)
    }

    /// Returns the torque coefficient d, N·m·s².
    pub(super) fn torque_coefficient(&self, b: f64, notes: &mut Notes) -> Result<f64, InputError> {
        // Checked even if torque_n_m_s2 is given, because the rotors' inertia can also use the diameter.
        let diameter_mm = optional_in_range("rotors.propeller_mm", self.propeller_mm, 20.0, 2e3, "mm")?;
        if let Some(d) = optional_in_range("rotors.torque_n_m_s2", self.torque_n_m_s2, 1e-11, 0.1, "N m s²")?
        {
            return Ok(d);
        }
        let Some(diameter_mm) = diameter_mm else {
            return Err(
                InputError::new("needs torque_n_m_s2, or propeller_mm for an estimate of it").field("rotors")
            );
        };
        let diameter_m = diameter_mm / 1e3;
        let d = TORQUE_PER_DIAMETER * diameter_m * b;
        let how = "a tenth of the propeller's diameter times the thrust coefficient";
        notes.add("torque coefficient", format!("{d:.3e} N m s²"), how, true);
        Ok(d)
    }

    /// Returns the moment of inertia of a rotor J_r, kg·m².
    pub(super) fn rotor_inertia(&self, notes: &mut Notes) -> Result<f64, InputError> {
        let measured = optional_in_range("rotors.inertia_kg_m2", self.inertia_kg_m2, 0.0, 1.0, "kg m²")?;
        let grams = optional_in_range("rotors.propeller_g", self.propeller_g, 0.1, 1e3, "g")?;
        if measured.is_some() || grams.is_some() {
            exactly_one(
                "rotors",
                &[("inertia_kg_m2", measured.is_some()), ("propeller_g", grams.is_some())],
            )?;
        }
        if let Some(inertia) = measured {
            return Ok(inertia);
        }
        let Some(grams) = grams else {
            notes.add(
                "moment of inertia of a rotor",
                "0 kg m²",
                "neither inertia_kg_m2 nor propeller_g is given",
                true,
            );
            return Ok(0.0);
        };
        let Some(diameter_mm) = self.propeller_mm else {
            return Err(InputError::new("is missing: propeller_g needs it").field("rotors.propeller_mm"));
        };
        // The propeller is taken as a thin rod, whose moment of inertia is m d²/12.
        let diameter_m = diameter_mm / 1e3;
        let inertia = grams / 1e3 * diameter_m * diameter_m / 12.0;
        notes.add(
            "moment of inertia of a rotor",
            format!("{inertia:.2e} kg m²"),
            "the propeller as a rod",
            true,
        );
        Ok(inertia)
    }
}
