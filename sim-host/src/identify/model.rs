//! Writes the coefficients of columns to files: a preset for scenes, and Kalibr's imu.yaml.
//!
//! For both files the names of the columns give the units: `gyro_{x,y,z}_rad_s` or `_deg_s`, `accel_{x,y,z}_m_s2`
//! or `_g`, `mag_{x,y,z}_ut`. These are the names in the project's logs; other columns must be renamed
//! (`--column gyro_x_deg_s=wx`).
//!
//! # Kalibr's convention
//! Kalibr's model (wiki, *IMU noise model*) is a noise n with E\[n(t) n(t′)\] = σ² δ(t − t′). In discrete time its
//! standard deviation is σ/√Δt, so σ² is the two-sided density, and σ is N. Its bias is ḃ = σ_b w, so σ_b is K. Only the
//! unit is converted. (A datasheet's one-sided density would have to be divided by √2.)

use std::fmt::Write as _;

use crate::dynamics::GRAVITY;
use allan::{Coefficient, Fit, Found};
use input::InputError;

const DEG: f64 = std::f64::consts::PI / 180.0;

/// The kind of a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Gyroscope, rad/s.
    Gyro,
    /// Accelerometer, m/s².
    Accel,
    /// Magnetometer, µT.
    Mag,
}

impl Kind {
    const ALL: [Self; 3] = [Self::Gyro, Self::Accel, Self::Mag];

    fn name(self) -> &'static str {
        match self {
            Self::Gyro => "gyro",
            Self::Accel => "accel",
            Self::Mag => "mag",
        }
    }

    fn number(self) -> usize {
        self as usize
    }
}

/// The meaning of a column, by its name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Role {
    /// The sensor.
    pub kind: Kind,
    /// The axis: 0, 1, 2 for x, y, z.
    pub axis: usize,
    /// Factor from the column's unit to rad/s, m/s² or µT.
    pub scale: f64,
    /// The column's unit.
    pub unit: &'static str,
}

impl Role {
    /// Returns the role of the column of this name; `None` for an unknown name.
    pub fn of(name: &str) -> Option<Self> {
        let mut parts = name.splitn(3, '_');
        let (sensor, axis, unit) = (parts.next()?, parts.next()?, parts.next()?);
        let (kind, scale, unit) = match (sensor, unit) {
            ("gyro", "rad_s") => (Kind::Gyro, 1.0, "rad/s"),
            ("gyro", "deg_s") => (Kind::Gyro, DEG, "°/s"),
            ("accel", "m_s2") => (Kind::Accel, 1.0, "m/s²"),
            ("accel", "g") => (Kind::Accel, GRAVITY, "g"),
            ("mag", "ut") => (Kind::Mag, 1.0, "µT"),
            _ => return None,
        };
        let axis = ["x", "y", "z"].iter().position(|a| *a == axis)?;
        Some(Self { kind, axis, scale, unit })
    }
}

/// A column with its coefficients, in the column's own unit.
#[derive(Clone, Debug)]
pub struct Analysed {
    /// Name of the column.
    pub name: String,
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Number of samples.
    pub samples: usize,
    /// Mean of the samples.
    pub mean: f64,
    /// Step of the converter, if it is visible.
    pub step: Option<f64>,
    /// True if the values increase over the recording.
    pub rises: bool,
    /// The coefficients.
    pub fit: Fit,
}

/// The source of the data.
#[derive(Clone, Debug)]
pub struct Provenance {
    /// The file.
    pub file: String,
    /// Name of the temperature column, lowest and highest temperature.
    pub temperature: Option<(String, f64, f64)>,
}

/// The sensors of a recording.
#[derive(Debug)]
struct Imu<'a> {
    sensors: [Option<[(&'a Analysed, Role); 3]>; 3],
}

impl<'a> Imu<'a> {
    fn of(columns: &'a [Analysed], option: &str) -> Result<Self, InputError> {
        let mut found: [[Option<(&Analysed, Role)>; 3]; 3] = [[None; 3]; 3];
        for column in columns {
            if let Some(role) = Role::of(&column.name) {
                found[role.kind.number()][role.axis] = Some((column, role));
            }
        }
        let mut sensors = [None; 3];
        for kind in Kind::ALL {
            sensors[kind.number()] = match found[kind.number()] {
                [Some(x), Some(y), Some(z)] => Some([x, y, z]),
                [None, None, None] => None,
                _ => {
                    return Err(InputError::new(format!(
                        "must have all three axes of {}, or none",
                        kind.name()
                    ))
                    .field(option));
                }
            };
        }
        if sensors[0].is_none() && sensors[1].is_none() {
            return Err(InputError::new(
                "must have the columns gyro_{x,y,z}_rad_s (or _deg_s) or accel_{x,y,z}_m_s2 (or _g); \
                 rename other columns with --column gyro_x_rad_s=NAME",
            )
            .field(option));
        }
        Ok(Self { sensors })
    }
}

/// Returns text for a comment of one line: control characters are replaced.
fn comment_text(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { char::REPLACEMENT_CHARACTER } else { c }).collect()
}

/// Formats a number with five significant digits, without trailing zeros: 0.0322800 is 0.03228.
fn digits(value: f64) -> String {
    if value == 0.0 {
        return "0.0".into();
    }
    let magnitude = libm::floor(libm::log10(value.abs())) as i32;
    if !(-5..6).contains(&magnitude) {
        return format!("{value:.4e}");
    }
    let shown = format!("{value:.*}", (4 - magnitude).max(1) as usize);
    let trimmed = shown.trim_end_matches('0');
    if trimmed.ends_with('.') { format!("{trimmed}0") } else { trimmed.into() }
}

fn header(provenance: &Provenance, columns: &[Analysed]) -> String {
    let longest = columns.iter().map(|c| c.samples as f64 / c.rate_hz).fold(0.0, f64::max);
    let mut rates: Vec<String> = Vec::new();
    for column in columns {
        let rate = format!("{} Hz", digits(column.rate_hz));
        if !rates.contains(&rate) {
            rates.push(rate);
        }
    }
    let temperature = provenance.temperature.as_ref().map_or("not recorded".into(), |(name, low, high)| {
        format!("{} to {} ({})", digits(*low), digits(*high), comment_text(name))
    });
    format!(
        "#   recording     {}\n#   length        {} s at {}\n#   temperature   {temperature}\n\
         #   program       sim-host {}\n",
        comment_text(&provenance.file),
        digits(longest),
        rates.join(" and "),
        env!("CARGO_PKG_VERSION"),
    )
}

/// An effect in a preset: its sensor, coefficient and key, and the factor from SI units to the key's unit.
struct Entry {
    kind: Kind,
    coefficient: Coefficient,
    key: &'static str,
    factor: f64,
}

const fn entry(kind: Kind, coefficient: Coefficient, key: &'static str, factor: f64) -> Entry {
    Entry { kind, coefficient, key, factor }
}

const ENTRIES: [Entry; 9] = [
    entry(Kind::Gyro, Coefficient::WhiteNoise, "n_deg_per_sqrt_h", 60.0 / DEG),
    entry(Kind::Gyro, Coefficient::BiasInstability, "b_deg_per_h", 3600.0 / DEG),
    entry(Kind::Gyro, Coefficient::RateRandomWalk, "k_deg_s_per_sqrt_s", 1.0 / DEG),
    entry(Kind::Gyro, Coefficient::RateRamp, "r_deg_s_per_s", 1.0 / DEG),
    entry(Kind::Accel, Coefficient::WhiteNoise, "n_m_s2_per_sqrt_hz", 1.0),
    entry(Kind::Accel, Coefficient::BiasInstability, "b_m_s2", 1.0),
    entry(Kind::Accel, Coefficient::RateRandomWalk, "k_m_s2_per_sqrt_s", 1.0),
    entry(Kind::Accel, Coefficient::RateRamp, "r_m_s2_per_s", 1.0),
    entry(Kind::Mag, Coefficient::WhiteNoise, "n_ut_per_sqrt_hz", 1.0),
];

/// Returns a preset, which a scene uses with `imu = "my-imu.toml"`.
///
/// # Errors
/// The columns have neither a complete gyroscope nor a complete accelerometer.
pub fn preset(columns: &[Analysed], provenance: &Provenance) -> Result<String, InputError> {
    let imu = Imu::of(columns, "--imu")?;
    let mut text = format!(
        "# An IMU preset, identified from a recording at rest by `sim-host allan --imu`.\n#\n{}#\n\
         # A scene selects it with `imu = \"...\"` and names its effects, such as `[effects.gyro.white_noise]`. They then\n\
         # have these values, unless the scene or a scene that it includes gives others. ± is one standard deviation of\n\
         # the fit. N is two-sided: y = N/√Δt · w. An axis whose recording does not show an error has the value 0. An\n\
         # effect that no axis shows is left out, with the reason.\n\n",
        header(provenance, columns)
    );
    converters(&mut text, &imu);
    for entry in &ENTRIES {
        if let Some(axes) = &imu.sensors[entry.kind.number()] {
            effect(&mut text, entry, axes);
        }
    }
    if let Some(axes) = &imu.sensors[Kind::Gyro.number()] {
        let bias = axes.map(|(column, role)| digits(column.mean * role.scale / DEG));
        let _ = write!(
            text,
            "\n[effects.gyro.constant_bias]        # mean of the recording, with the Earth's rate of 0.0042 °/s\n\
             bias_deg_s = [{}]\n",
            bias.join(", ")
        );
    }
    if imu.sensors[Kind::Mag.number()].is_none() {
        text.push_str(
            "\n[effects.mag.white_noise]           # not recorded: values of the preset `paper`\n\
             n_ut_per_sqrt_hz = [0.03, 0.03, 0.03]\n",
        );
    }
    Ok(text)
}

/// Writes the converters: by the steps in the columns, or else those of an ICM-42688-P and a QMC5883L.
fn converters(text: &mut String, imu: &Imu) {
    for (kind, key, unit, default) in [
        (Kind::Gyro, "lsb_per_deg_s", DEG, 16.4),
        (Kind::Accel, "lsb_per_g", GRAVITY, 2048.0),
        (Kind::Mag, "lsb_per_gauss", 100.0, 3000.0),
    ] {
        let axes = imu.sensors[kind.number()].as_ref();
        let step = axes.and_then(|axes| {
            let steps = axes.iter().map(|(column, role)| column.step.map(|step| step * role.scale));
            let steps: Option<Vec<f64>> = steps.collect();
            // All axes of a chip have the same step; different steps do not come from the converter.
            steps.filter(|s| s.iter().all(|step| (step / s[0] - 1.0).abs() < 0.02)).map(|s| s[0])
        });
        let seen = step.map(|step| unit / step).filter(|counts| (0.1..=1e6).contains(counts));
        let (counts, why) = match seen {
            Some(counts) => (counts, "from the step of the recording; the converter has 16 bits"),
            None if axes.is_some() => (default, "the recording shows no step: value of a common converter"),
            None => (default, "not recorded: value of a common converter"),
        };
        let _ = writeln!(text, "[{}]\n{:<36}# {why}", kind.name(), format!("{key} = {}", digits(counts)));
    }
}

fn effect(text: &mut String, entry: &Entry, axes: &[(&Analysed, Role); 3]) {
    let Entry { kind, coefficient, key, factor } = entry;
    let found = |(column, _): &(&Analysed, Role)| column.fit.found[*coefficient as usize].clone();
    let table = format!("[effects.{}.{}]", kind.name(), coefficient.name());
    if axes.iter().all(|axis| found(axis).value().is_none()) {
        let _ = writeln!(text, "\n# {table} is left out:");
        for axis in axes {
            if let Found::Hidden { reason, at_most } = found(axis) {
                let bound = at_most.map_or(String::new(), |limit| {
                    format!("; at most {}", digits(limit * axis.1.scale * factor))
                });
                let _ = writeln!(text, "#   {}: {reason}{bound}", ["x", "y", "z"][axis.1.axis]);
            }
        }
        return;
    }
    let uncertainty = axes.iter().map(|axis| match found(axis) {
        Found::Value { value, uncertainty } => format!("{:.1}", 100.0 * uncertainty / value),
        Found::Hidden { .. } => "not seen".into(),
    });
    let values = axes.iter().map(|axis| {
        let value = found(axis).value().unwrap_or(0.0) * axis.1.scale * factor;
        // The Allan deviation has no sign, so the recording gives the sign.
        let down = *coefficient == Coefficient::RateRamp && !axis.0.rises;
        digits(if down { -value } else { value })
    });
    let _ = write!(
        text,
        "\n{table:<36}# {}: ± {} %\n{key} = [{}]\n",
        coefficient.letter(),
        uncertainty.collect::<Vec<_>>().join(", "),
        values.collect::<Vec<_>>().join(", ")
    );
}

/// Returns the imu.yaml of Kalibr, VINS and OpenVINS.
///
/// # Errors
/// An axis of gyroscope or accelerometer is missing, or does not show N.
pub fn kalibr(columns: &[Analysed], provenance: &Provenance) -> Result<String, InputError> {
    let imu = Imu::of(columns, "--kalibr")?;
    let [Some(gyro), Some(accel), _] = &imu.sensors else {
        return Err(InputError::new("must have all axes of gyroscope and accelerometer").field("--kalibr"));
    };
    let mut text = format!(
        "# IMU noise for Kalibr, VINS and OpenVINS, identified from a recording at rest by `sim-host allan --kalibr`.\n#\n{}#\n\
         # Continuous-time units. A noise density is N, the root of the two-sided density, as in Kalibr's model: the\n\
         # standard deviation of a sample is density·√update_rate. A datasheet's one-sided value is √2 times as large.\n\
         # A random walk is K of ḃ = K w. Each value is the root mean square of the three axes.\n\n",
        header(provenance, columns)
    );
    for (name, axes, [density, walk]) in
        [("accelerometer", accel, ["m/s²/√Hz", "m/s³/√Hz"]), ("gyroscope", gyro, ["rad/s/√Hz", "rad/s²/√Hz"])]
    {
        for (what, coefficient, unit) in [
            ("noise_density", Coefficient::WhiteNoise, density),
            ("random_walk", Coefficient::RateRandomWalk, walk),
        ] {
            let mut squares = 0.0;
            let mut remarks = Vec::new();
            for (column, role) in axes {
                let (value, remark) = match &column.fit.found[coefficient as usize] {
                    Found::Value { value, .. } => (*value, ""),
                    // The upper bound, because an estimator with too small a random walk is overconfident.
                    Found::Hidden { at_most: Some(limit), .. }
                        if coefficient == Coefficient::RateRandomWalk =>
                    {
                        (*limit, " at most")
                    }
                    Found::Hidden { reason, .. } => {
                        return Err(InputError::new(format!("needs {}: {reason}", coefficient.name()))
                            .field("--kalibr")
                            .value(&column.name));
                    }
                };
                squares += value * value * role.scale * role.scale / 3.0;
                remarks.push(format!("{}{remark}", digits(value * role.scale)));
            }
            let key = format!("{name}_{what}:");
            let _ = writeln!(
                text,
                "{key:<30} {:<12} # {unit}; x, y, z: {}",
                format!("{:.5e}", libm::sqrt(squares)),
                remarks.join(", ")
            );
        }
    }
    let _ = write!(
        text,
        "\n{:<30} /imu0        # set your topic\n{:<30} {:<12} # Hz\n",
        "rostopic:",
        "update_rate:",
        digits(gyro[0].0.rate_hz)
    );
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_valid_toml() {
        for (value, shown) in [
            (1.9368, "1.9368"),
            (0.03228, "0.03228"),
            (1000.0, "1000.0"),
            (-0.5, "-0.5"),
            (123_456.78, "123456.8"),
            (1.5e-7, "1.5000e-7"),
            (0.0, "0.0"),
        ] {
            assert_eq!(digits(value), shown);
        }
    }

    #[test]
    fn column_name_gives_sensor_axis_and_unit() {
        let role = Role::of("gyro_y_deg_s").unwrap();
        assert_eq!((role.kind, role.axis, role.unit), (Kind::Gyro, 1, "°/s"));
        assert_eq!(Role::of("accel_z_g").unwrap().scale, GRAVITY);
        for name in ["gyro_x", "gyro_w_rad_s", "wx", "accel_x_rad_s", ""] {
            assert_eq!(Role::of(name), None, "{name}");
        }
    }
}
