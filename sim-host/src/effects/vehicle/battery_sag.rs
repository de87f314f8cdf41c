//! Battery sag: the speed of every rotor falls with the battery's voltage.
//!
//! | quantity | formula | unit |
//! |---|---|---|
//! | power of the rotors | P = Σ d Ω_i³/η, torque d Ω² times speed, divided by the efficiency of motor and ESC | W |
//! | open-circuit voltage | E = n (3.685 − 1.031 e^(−35 s) + 0.2156 s − 0.1178 s² + 0.3201 s³), where s is the remaining charge, 0 to 1 | V |
//! | current | P = (E − R I) I, so I = (E − √(E² − 4 R P))/2R | A |
//! | voltage | V = E − R I | V |
//! | charge | ṡ = −I/Q, Q in A·s: 3.6 times mAh | 1/s |
//! | speed | Ω_wanted V/V_full, V_full = 4.1029 n | rad/s |
//!
//! An ESC applies a share of the battery voltage to its motor. So the vehicle's full speed is the speed at the
//! voltage of a full battery without load, and every pulse gives less thrust as the voltage falls. The battery can
//! deliver at most E²/4R; for any larger power the current is that at this maximum, E/2R. The flight controller
//! measures this voltage, too.
//!
//! Source: Chen and Rincón-Mora, *Accurate electrical battery model capable of predicting runtime and I-V
//! performance*, IEEE Trans. Energy Conversion 21(2), 2006: their lithium polymer cell, without its transients.

use serde::Deserialize;

use super::{CommandEffect, VehicleEffect};
use crate::effects::{BuildContext, EffectParams, Snapshot};
use input::InputError;
use input::check;

/// `[effects.vehicle.battery_sag]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BatterySag {
    /// Number of cells in series, n.
    #[serde(deserialize_with = "check::whole_number::<_, _, 1, 24>")]
    pub cells: u32,
    /// Capacity Q, mA·h.
    pub capacity_mah: f64,
    /// Resistance R of the pack with its leads, mΩ.
    pub resistance_mohm: f64,
    /// Efficiency η of motor and ESC together, 0 to 1.
    pub efficiency: f64,
    /// Charge s at the start, 0 to 1; default 1.
    #[serde(default = "fully_charged")]
    pub charge: f64,
}

fn fully_charged() -> f64 {
    1.0
}

impl EffectParams for BatterySag {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "capacity_mah", self.capacity_mah, 10.0, 1e6, "mAh")?;
        check::key_in_range(key, "resistance_mohm", self.resistance_mohm, 0.1, 1e4, "mΩ")?;
        check::key_in_range(key, "efficiency", self.efficiency, 0.05, 1.0, "of the battery's power")?;
        check::key_in_range(key, "charge", self.charge, 0.0, 1.0, "of full charge")
    }

    fn build(&self, context: &BuildContext) -> VehicleEffect {
        let cells = f64::from(self.cells);
        VehicleEffect::Command(Box::new(Battery {
            pack: Pack::new(cells, self.capacity_mah, self.resistance_mohm, self.charge),
            per_full_v: 1.0 / (cells * cell_v(1.0, exponential(1.0))),
            power_per_cube: context.vehicle.torque_coefficient / self.efficiency,
            interval_s: context.interval_s(),
        }))
    }
}

/// Returns the open-circuit voltage of a cell, V, at the remaining share `charge`. `exponential` = exp(−35 charge).
fn cell_v(charge: f64, exponential: f64) -> f64 {
    3.685 - 1.031 * exponential + charge * (0.2156 + charge * (-0.1178 + charge * 0.3201))
}

/// Returns exp(−35 charge).
fn exponential(charge: f64) -> f64 {
    libm::exp(-35.0 * charge)
}

/// A battery pack: cells in series with a resistance.
struct Pack {
    cells: f64,
    ohm: f64,
    per_capacity_a_s: f64,
    charge: f64,
    /// Value of exp(−35 charge), updated with the charge.
    exponential: f64,
    voltage_v: f64,
}

impl Pack {
    fn new(cells: f64, capacity_mah: f64, resistance_mohm: f64, charge: f64) -> Self {
        Self {
            cells,
            ohm: resistance_mohm * 1e-3,
            per_capacity_a_s: 1.0 / (3.6 * capacity_mah),
            charge,
            exponential: exponential(charge),
            voltage_v: cells * cell_v(charge, exponential(charge)),
        }
    }

    /// Delivers `power_w` for `interval_s`. Returns the current, A.
    fn discharge(&mut self, power_w: f64, interval_s: f64) -> f64 {
        let open_v = self.cells * cell_v(self.charge, self.exponential);
        let under_root = open_v * open_v - 4.0 * self.ohm * power_w;
        let current = (open_v - under_root.max(0.0).sqrt()) / (2.0 * self.ohm);
        self.voltage_v = open_v - self.ohm * current;
        let drawn = current * interval_s * self.per_capacity_a_s;
        self.charge = (self.charge - drawn).max(0.0);
        // A millisecond uses a millionth of the charge. The power series of exp(x) up to x³ then has an error of
        // x⁴/24 < 4e-18, and is cheaper than the exponential.
        let x = 35.0 * drawn;
        self.exponential = if x < 1e-4 && self.charge > 0.0 {
            self.exponential * (1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0))))
        } else {
            exponential(self.charge)
        };
        current
    }
}

struct Battery {
    pack: Pack,
    /// Reciprocal of the open-circuit voltage of the full battery, 1/V.
    per_full_v: f64,
    /// d/η, W/(rad/s)³.
    power_per_cube: f64,
    interval_s: f64,
}

impl CommandEffect for Battery {
    fn apply(&mut self, wanted: &mut [f64; 4], at: &Snapshot) {
        let cubes: f64 = at.rotors.iter().map(|speed| speed * speed * speed).sum();
        self.pack.discharge(self.power_per_cube * cubes, self.interval_s);
        let share = self.pack.voltage_v * self.per_full_v;
        wanted.iter_mut().for_each(|wanted| *wanted *= share);
    }

    fn battery_v(&self) -> Option<f64> {
        Some(self.pack.voltage_v)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::vehicle::testing::{STATE, command, snapshot};

    const PARAMS: BatterySag =
        BatterySag { cells: 3, capacity_mah: 1000.0, resistance_mohm: 50.0, efficiency: 0.7, charge: 1.0 };

    #[test]
    fn constant_current_drains_charge_and_drops_r_i() {
        // 6 A from 1 A·h take a tenth of the charge in a minute.
        let mut pack = Pack::new(3.0, 1000.0, 50.0, 1.0);
        for k in 0..60_000 {
            let left = 1.0 - 6.0 * f64::from(k) * 1e-3 / 3600.0;
            // This computes the cell's voltage with powers instead of Horner's rule.
            let cell = -1.031 * (-35.0 * left).exp() + 3.685 + 0.2156 * left - 0.1178 * left.powi(2)
                + 0.3201 * left.powi(3);
            let voltage = 3.0 * cell - 6.0 * 0.05;
            let current = pack.discharge(voltage * 6.0, 1e-3);
            assert!((current - 6.0).abs() < 1e-9 && (pack.voltage_v - voltage).abs() < 1e-9);
        }
        assert!((pack.charge - 0.9).abs() < 1e-9);
    }

    #[test]
    fn rotor_speeds_fall_with_the_voltage() {
        let mut battery = command(&PARAMS);
        // Fully charged and without load, the battery has 3 · 4.1029 V.
        assert!((battery.battery_v().unwrap() - 12.3087).abs() < 1e-9);
        let mut wanted = [300.0; 4];
        battery.apply(&mut wanted, &snapshot(&STATE, 0.0, [0.0; 4]));
        assert!(wanted.iter().all(|w| (w - 300.0).abs() < 1e-9));
        // Hovering takes 4 · 7.5e-7 · 225.7³/0.7 = 49.27 W. The current is I = 4.0719 A, which causes a drop of
        // 0.2036 V.
        let mut wanted = [300.0; 4];
        battery.apply(&mut wanted, &snapshot(&STATE, 0.001, [225.7; 4]));
        let voltage = battery.battery_v().unwrap();
        let current = (12.3087 - voltage) / 0.05;
        assert!((current * voltage - 4.0 * 7.5e-7 * 225.7_f64.powi(3) / 0.7).abs() < 1e-6);
        assert!((voltage - 12.105).abs() < 0.001, "{voltage}");
        assert!((wanted[2] - 300.0 * voltage / 12.3087).abs() < 1e-9);
    }

    #[test]
    fn power_above_the_maximum_gives_half_the_voltage() {
        let mut pack = Pack::new(3.0, 1000.0, 50.0, 1.0);
        let current = pack.discharge(1e5, 1e-3);
        assert!((pack.voltage_v - 0.5 * 12.3087).abs() < 1e-9 && (current - 123.087).abs() < 1e-9);
        // An empty battery stays empty.
        (0..100_000).for_each(|_| {
            pack.discharge(1e5, 1e-3);
        });
        assert!(pack.charge == 0.0 && (pack.voltage_v - 0.5 * 3.0 * 2.654).abs() < 1e-9);
    }
}
