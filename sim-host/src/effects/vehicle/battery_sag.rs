//! Battery sag: as the voltage falls, so does every rotor's speed.
//!
//! | quantity | formula | unit |
//! |---|---|---|
//! | power of the rotors | P = Σ d Ω_i³/η, torque d Ω² times speed, over the efficiency of motor and ESC | W |
//! | open-circuit voltage | E = n (3.685 − 1.031 e^(−35 s) + 0.2156 s − 0.1178 s² + 0.3201 s³), s the charge left, 0 to 1 | V |
//! | current | P = (E − R I) I, so I = (E − √(E² − 4 R P))/2R | A |
//! | voltage | V = E − R I | V |
//! | charge | ṡ = −I/Q, Q in A·s: 3.6 times mAh | 1/s |
//! | speed | Ω_wanted V/V_full, V_full = 4.1029 n | rad/s |
//!
//! An ESC sets a share of the supply, so the vehicle's full speed is that at the voltage of a full battery at
//! rest, and every pulse gives less thrust as the voltage falls. Asked for more than the battery can give,
//! E²/4R, the current is that of the peak, E/2R. The voltage goes to the flight controller, too.
//!
//! Source: Chen and Rincón-Mora, *Accurate electrical battery model capable of predicting runtime and I-V
//! performance*, IEEE Trans. Energy Conversion 21(2), 2006: a lithium polymer cell; without its
//! transients.

use serde::Deserialize;

use super::{CommandEffect, VehicleEffect};
use crate::effects::{Build, Recipe, Snapshot};
use input::InputError;
use input::check;

/// `[effects.vehicle.battery_sag]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BatterySag {
    /// n, in series.
    pub cells: u32,
    /// Q, mA·h.
    pub capacity_mah: f64,
    /// R of the pack with its leads, mΩ.
    pub resistance_mohm: f64,
    /// η of motor and ESC together, 0 to 1.
    pub efficiency: f64,
    /// s at the start, 0 to 1; 1 without it.
    #[serde(default = "full")]
    pub charge: f64,
}

fn full() -> f64 {
    1.0
}

impl Recipe for BatterySag {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "cells", f64::from(self.cells), 1.0, 24.0, "cells")?;
        check::key_in_range(key, "capacity_mah", self.capacity_mah, 10.0, 1e6, "mAh")?;
        check::key_in_range(key, "resistance_mohm", self.resistance_mohm, 0.1, 1e4, "mΩ")?;
        check::key_in_range(key, "efficiency", self.efficiency, 0.05, 1.0, "of the battery's power")?;
        check::key_in_range(key, "charge", self.charge, 0.0, 1.0, "of full charge")
    }

    fn build(&self, with: &Build) -> VehicleEffect {
        let cells = f64::from(self.cells);
        VehicleEffect::Command(Box::new(Battery {
            pack: Pack::new(cells, self.capacity_mah, self.resistance_mohm, self.charge),
            per_full_v: 1.0 / (cells * cell_v(1.0, tail(1.0))),
            power_per_cube: with.vehicle.torque_coefficient / self.efficiency,
            interval_s: with.interval_s(),
        }))
    }
}

/// Voltage of a cell at rest, V, with the share `charge` left, and `tail` = exp(−35 charge).
fn cell_v(charge: f64, tail: f64) -> f64 {
    3.685 - 1.031 * tail + charge * (0.2156 + charge * (-0.1178 + charge * 0.3201))
}

fn tail(charge: f64) -> f64 {
    libm::exp(-35.0 * charge)
}

/// Cells in series with a resistance.
struct Pack {
    cells: f64,
    ohm: f64,
    per_capacity: f64,
    charge: f64,
    /// exp(−35 charge), brought along.
    tail: f64,
    voltage_v: f64,
}

impl Pack {
    fn new(cells: f64, capacity_mah: f64, resistance_mohm: f64, charge: f64) -> Self {
        Self {
            cells,
            ohm: resistance_mohm * 1e-3,
            per_capacity: 1.0 / (3.6 * capacity_mah),
            charge,
            tail: tail(charge),
            voltage_v: cells * cell_v(charge, tail(charge)),
        }
    }

    /// Gives `power_w` for `interval_s`; returns the current, A.
    fn give(&mut self, power_w: f64, interval_s: f64) -> f64 {
        let open_v = self.cells * cell_v(self.charge, self.tail);
        let under_root = open_v * open_v - 4.0 * self.ohm * power_w;
        let current = (open_v - under_root.max(0.0).sqrt()) / (2.0 * self.ohm);
        self.voltage_v = open_v - self.ohm * current;
        let taken = current * interval_s * self.per_capacity;
        self.charge = (self.charge - taken).max(0.0);
        // A millisecond takes a millionth of the charge: exp(x) to x³ leaves out x⁴/24 < 4e-18 there, and saves
        // the exponential.
        let x = 35.0 * taken;
        self.tail = if x < 1e-4 && self.charge > 0.0 {
            self.tail * (1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0))))
        } else {
            tail(self.charge)
        };
        current
    }
}

struct Battery {
    pack: Pack,
    /// One over the voltage of the full battery at rest, 1/V.
    per_full_v: f64,
    /// d/η: W for (rad/s)³.
    power_per_cube: f64,
    interval_s: f64,
}

impl CommandEffect for Battery {
    fn apply(&mut self, wanted: &mut [f64; 4], at: &Snapshot) {
        let cubes: f64 = at.rotors.iter().map(|speed| speed * speed * speed).sum();
        self.pack.give(self.power_per_cube * cubes, self.interval_s);
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
    use crate::effects::vehicle::testing::{STATE, command, moment};

    const RECIPE: BatterySag =
        BatterySag { cells: 3, capacity_mah: 1000.0, resistance_mohm: 50.0, efficiency: 0.7, charge: 1.0 };

    #[test]
    fn constant_current_takes_charge_in_proportion_and_r_i_of_voltage() {
        // 6 A out of 1 A·h: a tenth in a minute.
        let mut pack = Pack::new(3.0, 1000.0, 50.0, 1.0);
        for k in 0..60_000 {
            let left = 1.0 - 6.0 * f64::from(k) * 1e-3 / 3600.0;
            // The cell's voltage from powers, not from Horner's rule.
            let cell = -1.031 * (-35.0 * left).exp() + 3.685 + 0.2156 * left - 0.1178 * left.powi(2)
                + 0.3201 * left.powi(3);
            let voltage = 3.0 * cell - 6.0 * 0.05;
            let current = pack.give(voltage * 6.0, 1e-3);
            assert!((current - 6.0).abs() < 1e-9 && (pack.voltage_v - voltage).abs() < 1e-9);
        }
        assert!((pack.charge - 0.9).abs() < 1e-9);
    }

    #[test]
    fn speeds_fall_with_the_voltage() {
        let mut battery = command(&RECIPE);
        // At rest and full, 3 · 4.1029 V.
        assert!((battery.battery_v().unwrap() - 12.3087).abs() < 1e-9);
        let mut wanted = [300.0; 4];
        battery.apply(&mut wanted, &moment(&STATE, 0.0, [0.0; 4]));
        assert!(wanted.iter().all(|w| (w - 300.0).abs() < 1e-9));
        // Hovering: 4 · 7.5e-7 · 225.7³/0.7 = 49.27 W, I = 4.0719 A, which drops 0.2036 V.
        let mut wanted = [300.0; 4];
        battery.apply(&mut wanted, &moment(&STATE, 0.001, [225.7; 4]));
        let voltage = battery.battery_v().unwrap();
        let current = (12.3087 - voltage) / 0.05;
        assert!((current * voltage - 4.0 * 7.5e-7 * 225.7_f64.powi(3) / 0.7).abs() < 1e-6);
        assert!((voltage - 12.105).abs() < 0.001, "{voltage}");
        assert!((wanted[2] - 300.0 * voltage / 12.3087).abs() < 1e-9);
    }

    #[test]
    fn beyond_the_peak_it_gives_half_its_voltage() {
        let mut pack = Pack::new(3.0, 1000.0, 50.0, 1.0);
        let current = pack.give(1e5, 1e-3);
        assert!((pack.voltage_v - 0.5 * 12.3087).abs() < 1e-9 && (current - 123.087).abs() < 1e-9);
        // And an empty one stays empty.
        (0..100_000).for_each(|_| {
            pack.give(1e5, 1e-3);
        });
        assert!(pack.charge == 0.0 && (pack.voltage_v - 0.5 * 3.0 * 2.654).abs() < 1e-9);
    }
}
