//! Figures 1 to 3 and 6 to 9, which need only the simulation.

use flight_core::estimator::{Estimator, EstimatorParams};
use flight_core::geometry::{Vec3, vec3};
use flight_core::prefilter::{Biquad, Prefilter};

use super::bench::{self, GRAVITY_UP};
use super::{Exhibit, numbers};
use allan::{Coefficient, Fit, Point};
use input::InputError;
use maud::{Markup, Render};
use sim_host::chart::{Band, Chart, Label, Line, Panel, Stroke, colour};
use sim_host::dynamics::{GRAVITY, Vehicle};
use sim_host::effects::Snapshot;
use sim_host::identify::plot;
use sim_host::scene::Scene;

const WIDTH: f64 = 920.0;
const DEG: f64 = std::f64::consts::PI / 180.0;
const AXES: [&str; 3] = ["x", "y", "z"];
const AXIS_COLOURS: [&str; 3] = [colour::BLUE, colour::VERMILLION, colour::GREEN];

/// Returns all of them, in the order of their numbers.
pub fn all(progress: &dyn Fn(u64)) -> Result<Vec<Exhibit>, InputError> {
    let mut list = vec![bias()?, scale_factor()?, misalignment()?];
    progress(30);
    list.push(five_errors()?);
    progress(60);
    list.extend(allan_plots()?);
    progress(80);
    list.push(chain()?);
    progress(90);
    Ok(list)
}

fn line(label: &str, stroke: Stroke, points: Vec<(f64, f64)>) -> Line {
    Line::new(label, stroke, points)
}

fn panel(title: &str, unit: &'static str, lines: Vec<Line>) -> Panel {
    Panel { includes: vec![0.0], ..Panel::new(title, unit, 150.0, lines) }
}

fn picture(description: &str, along: (f64, f64), x_title: &'static str, panels: Vec<Panel>) -> Markup {
    Chart { x_title, ..Chart::over_time(WIDTH, description, along, panels) }.render()
}

fn at_rest(scene: &Scene) -> Vehicle {
    Vehicle::at_rest(scene.vehicle, scene.mount(), vec![], 1e-3)
}

/// Figure 1 and eqs 1-3: the position error from integrating biased sensors at rest.
fn bias() -> Result<Exhibit, InputError> {
    const SECONDS: u32 = 60;
    const RATE_HZ: u32 = 100;
    let mg = GRAVITY / 1000.0;
    let drift = |effects: &str| -> Result<Vec<(f64, f64)>, InputError> {
        let scene = bench::scene(f64::from(SECONDS), 1, effects)?;
        let rate_hz = f64::from(RATE_HZ);
        let (mut gyro, mut accel) = (scene.gyro(1, rate_hz), scene.accel(1, rate_hz));
        let vehicle = at_rest(&scene);
        let at = |time_s: f64| Snapshot { time_s, ..vehicle.snapshot() };
        let h = 1.0 / rate_hz;
        // The integration is in the vertical plane through north, and trapezoidal in each step.
        let north = |tilt: f64, f: Vec3<f64>| libm::cos(tilt) * f.x + libm::sin(tilt) * f.z;
        let (mut tilt, mut velocity, mut position) = (0.0, 0.0, 0.0);
        let mut before = north(tilt, accel.measure(GRAVITY_UP, &at(0.0)));
        let mut points = vec![(0.0, 0.0)];
        for k in 1..=SECONDS * RATE_HZ {
            let now = at(f64::from(k) * h);
            tilt += gyro.measure(Vec3::ZERO, &now).y * h;
            let acceleration = north(tilt, accel.measure(GRAVITY_UP, &now));
            let faster = velocity + 0.5 * h * (before + acceleration);
            position += 0.5 * h * (velocity + faster);
            (velocity, before) = (faster, acceleration);
            points.push((now.time_s, position));
        }
        Ok(points)
    };
    let accel = drift(&format!("[effects.accel.constant_bias]\nbias_m_s2 = [{mg:?}, 0.0, 0.0]\n"))?;
    // A rotation about −y tilts the measured gravity in the direction that eq 3 counts as positive.
    let rate_deg_s = -1.0 / 3600.0;
    let gyro = drift(&format!("[effects.gyro.constant_bias]\nbias_deg_s = [0.0, {rate_deg_s:?}, 0.0]\n"))?;
    let eq_2 = |t: f64| 0.5 * mg * t * t;
    let eq_3 = |t: f64| GRAVITY * -rate_deg_s * DEG * t * t * t / 6.0;
    let closed =
        |points: &[(f64, f64)], eq: &dyn Fn(f64) -> f64| points.iter().map(|p| (p.0, eq(p.0))).collect();
    let pair = |ours: &[(f64, f64)], eq: &dyn Fn(f64) -> f64, name: &str| {
        vec![
            line("strapdown", Stroke::solid(colour::SKY, 4.0), ours.to_vec()),
            line(name, Stroke::dashed(colour::BLACK, 1.3), closed(ours, eq)),
        ]
    };
    let html = picture(
        "Position error of a biased accelerometer and a biased gyroscope over a minute",
        (0.0, f64::from(SECONDS)),
        "time, s",
        vec![
            panel("Position error from 1 mg of accelerometer bias", "m", pair(&accel, &eq_2, "eq 2")),
            panel("Position error from 1 °/h of gyroscope bias", "m", pair(&gyro, &eq_3, "eq 3")),
        ],
    );
    let (last_a, last_g) = (accel[accel.len() - 1].1, gyro[gyro.len() - 1].1);
    let rows = accel.iter().zip(&gyro).step_by(RATE_HZ as usize);
    let csv = numbers(
        "time_s,accelerometer_strapdown_m,eq_2_m,gyroscope_strapdown_m,eq_3_m",
        rows.map(|(a, g)| vec![a.0, a.1, eq_2(a.0), g.1, eq_3(a.0)]),
    );
    Ok(Exhibit {
        name: "figure-01".into(),
        title: "Figure 1 and equations 1 to 3: bias".into(),
        caption: format!(
            "The paper sketches a bias and gives the resulting position error. Here biased sensors lie still and level, and \
             their readings are integrated. After a minute the position error is {last_a:.4} m, where ½ b t² = {:.4} m, and \
             {last_g:.4} m, where g b t³/6 = {:.4} m.",
            eq_2(60.0),
            eq_3(60.0)
        ),
        html,
        csv,
        further: vec![],
        in_short: format!("{last_a:.3} m and {last_g:.4} m after a minute"),
    })
}

/// Returns the readings of a gyroscope over a sweep of its input, °/s.
fn sweep(effects: &str, input: Vec3<f64>) -> Result<Vec<(f64, [f64; 3])>, InputError> {
    let scene = bench::scene(1.0, 1, effects)?;
    let mut gyro = scene.gyro(1, 100.0);
    let vehicle = at_rest(&scene);
    let reading = |k: i32| {
        let rate = f64::from(k) * 5.0;
        let reading = gyro.measure(input * (rate * DEG), &vehicle.snapshot());
        (rate, <[f64; 3]>::from(reading).map(|r| r / DEG))
    };
    Ok((-40..=40).map(reading).collect())
}

/// Figure 2: three scale factors.
fn scale_factor() -> Result<Exhibit, InputError> {
    let readings =
        sweep("[effects.gyro.scale_factor]\nerror_ppm = [50000.0, 0.0, -50000.0]\n", vec3(1.0, 1.0, 1.0))?;
    let axis = |i: usize| readings.iter().map(|(rate, reading)| (*rate, reading[i])).collect::<Vec<_>>();
    let lines = [("+5 %", 0), ("ideal", 1), ("−5 %", 2)]
        .map(|(label, i)| line(label, Stroke::solid(AXIS_COLOURS[[1, 0, 2][i]], 1.6), axis(i)));
    let html = picture(
        "Output over input for three scale factors",
        (-200.0, 200.0),
        "input, °/s",
        vec![panel("Output", "°/s", lines.into())],
    );
    let csv = numbers(
        "input_deg_s,plus_5_percent_deg_s,ideal_deg_s,minus_5_percent_deg_s",
        readings.iter().map(|(rate, [a, b, c])| vec![*rate, *a, *b, *c]),
    );
    Ok(Exhibit {
        name: "figure-02".into(),
        title: "Figure 2: scale factor".into(),
        caption: "Three gyroscopes with scale factors 5 % too large, correct, and 5 % too small, over the same input: \
                  exaggerated, as in the paper's sketch. Datasheets give some hundred to some ten thousand ppm."
            .into(),
        html,
        csv,
        further: vec![],
        in_short: format!("{:.1} and {:.1} °/s at 200 °/s", readings[80].1[0], readings[80].1[2]),
    })
}

/// Figure 3: the readings of x and y for a rotation about z.
fn misalignment() -> Result<Exhibit, InputError> {
    let readings = sweep(
        "[effects.gyro.misalignment]\nmounting_mrad = [10.0, 20.0, 0.0]\nnon_orthogonality_mrad = [0.0, 0.0, 0.0]\n",
        vec3(0.0, 0.0, 1.0),
    )?;
    let axis = |i: usize| readings.iter().map(|(rate, reading)| (*rate, reading[i])).collect::<Vec<_>>();
    let lines = vec![
        line("x", Stroke::solid(AXIS_COLOURS[0], 1.6), axis(0)),
        line("y", Stroke::solid(AXIS_COLOURS[1], 1.6), axis(1)),
    ];
    let html = picture(
        "Readings of x and y for a rotation about z",
        (-200.0, 200.0),
        "input about z, °/s",
        vec![panel("Reading of x and y", "°/s", lines)],
    );
    let csv = numbers(
        "input_z_deg_s,x_deg_s,y_deg_s,z_deg_s",
        readings.iter().map(|(rate, [a, b, c])| vec![*rate, *a, *b, *c]),
    );
    let [x, y, _] = readings[80].1;
    Ok(Exhibit {
        name: "figure-03".into(),
        title: "Figure 3: misalignment".into(),
        caption: format!(
            "A gyroscope mounted with errors of 10 mrad about x and 20 mrad about y, rotated about z alone. Of the rate about \
             z, x reads −θy and y reads θx. At 200 °/s that is {x:.3} and {y:.3} °/s."
        ),
        html,
        csv,
        further: vec![],
        in_short: format!("x reads {x:.3} °/s and y {y:.3} °/s of 200 °/s about z"),
    })
}

/// Figure 6: the shape of an Allan plot with more than one error.
fn five_errors() -> Result<Exhibit, InputError> {
    const RATE_HZ: f64 = 10.0;
    let put_in = [
        (Coefficient::WhiteNoise, 1.9368 / 60.0),
        (Coefficient::BiasInstability, 20.0 / 3600.0),
        (Coefficient::RateRandomWalk, 1.2e-4),
    ];
    let scene = bench::scene(
        4.0 * 86_400.0,
        1,
        "[effects.gyro.white_noise]\nn_deg_per_sqrt_h = [1.9368, 1.9368, 1.9368]\n\
         [effects.gyro.bias_instability]\nb_deg_per_h = [20.0, 20.0, 20.0]\n\
         [effects.gyro.rate_random_walk]\nk_deg_s_per_sqrt_s = [1.2e-4, 1.2e-4, 1.2e-4]\n",
    )?;
    let [x, ..] = bench::readings(&scene, &mut scene.gyro(1, RATE_HZ), Vec3::ZERO, RATE_HZ, false);
    let (points, fit) = bench::analysed(x.into_iter().map(|y| y / DEG).collect(), RATE_HZ, None);
    let chart = Chart::logarithmic(
        WIDTH,
        "Allan deviation of a simulated gyroscope over four days, with its three errors",
        "averaging time τ, s",
        vec![Panel {
            height: 380.0,
            ..plot::panel("Overlapping Allan deviation", "°/s", &points, Some(&fit))
        }],
    );
    let summary = put_in.map(|(coefficient, put_in)| {
        let found = plot::describe(coefficient, &fit.found[coefficient as usize], "°/s");
        format!("{} {} → {found}", coefficient.letter(), plot::short(put_in))
    });
    Ok(Exhibit {
        name: "figure-06".into(),
        title: "Figure 6: an Allan plot and its slopes".into(),
        caption: format!(
            "The paper shows a drawing from the literature. This is a simulated gyroscope over four days at 10 Hz, with \
             white noise (slope −½), bias instability (flat at 0.664 B) and rate random walk (slope +½). \
             Put in → read back: {}.",
            summary.join("; ")
        ),
        html: chart.render(),
        csv: deviations_csv(&[points]),
        further: vec![],
        in_short: summary.join("; "),
    })
}

fn deviations_csv(axes: &[Vec<Point>]) -> String {
    let mut header = String::from("tau_s");
    for (axis, _) in AXES.iter().zip(axes) {
        header += &format!(",{axis}_deviation,{axis}_lower_68,{axis}_upper_68");
    }
    let row = |k: usize| {
        let mut row = vec![axes[0][k].tau_s];
        axes.iter().for_each(|axis| row.extend([axis[k].deviation, axis[k].lower, axis[k].upper]));
        row
    };
    numbers(&header, (0..axes[0].len()).map(row))
}

/// Figures 7 and 8: an hour of simulated sensors with the noise of table 2.
fn allan_plots() -> Result<Vec<Exhibit>, InputError> {
    const RATE_HZ: f64 = 100.0;
    let scene = bench::scene(3600.0, 1, "[effects.gyro.white_noise]\n[effects.accel.white_noise]\n")?;
    let gyro = bench::readings(&scene, &mut scene.gyro(1, RATE_HZ), Vec3::ZERO, RATE_HZ, true)
        .map(|axis| axis.into_iter().map(|y| y / DEG).collect::<Vec<f64>>());
    let accel = bench::readings(&scene, &mut scene.accel(1, RATE_HZ), GRAVITY_UP, RATE_HZ, true);
    let exhibit = |number: u32, what: &str, unit: &str, axes: [Vec<f64>; 3], printed: [f64; 3]| {
        let analysed: Vec<(Vec<Point>, Fit)> =
            axes.into_iter().map(|axis| bench::analysed(axis, RATE_HZ, None)).collect();
        let n = Coefficient::WhiteNoise;
        let mut lines = Vec::new();
        let mut bands = Vec::new();
        let mut labels = Vec::new();
        let mut summary = Vec::new();
        for (i, (points, fit)) in analysed.iter().enumerate() {
            let colour = AXIS_COLOURS[i];
            let value = fit.found[n as usize].value().unwrap_or(f64::NAN);
            // The lines of equal axes coincide: the first is the widest.
            let label = format!("{}, N {}", AXES[i], plot::short(value));
            let measured = points.iter().map(|p| (p.tau_s, p.deviation)).collect();
            let stroke = Stroke::solid(colour, [2.6, 1.8, 1.0][i]);
            lines.push(Line { dots: true, ..Line::new(label, stroke, measured) });
            bands.push(Band { colour, points: points.iter().map(|p| (p.tau_s, p.lower, p.upper)).collect() });
            labels.push(Label { at: (1.0, value), text: String::new(), colour });
            summary.push(format!("{}: {} for {}", AXES[i], plot::short(value), plot::short(printed[i])));
        }
        let title = format!("Overlapping Allan deviation of the {what}");
        let chart = Chart::logarithmic(
            WIDTH,
            format!("Allan deviation of the {what}, three axes"),
            "averaging time τ, s",
            vec![Panel { bands, labels, ..Panel::new(title, unit, 340.0, lines) }],
        );
        let points: Vec<Vec<Point>> = analysed.into_iter().map(|a| a.0).collect();
        Exhibit {
            name: format!("figure-{number:02}"),
            title: format!("Figure {number}: Allan plot of the {what}"),
            caption: format!(
                "The paper takes table 2 from an hour of its own sensor, which is not published. This is an hour of the simulated \
                 sensor with the noise of table 2, at 100 Hz, through its converter. N as read back, for the value that was \
                 put in ({}): {}.",
                n.unit(unit),
                summary.join("; ")
            ),
            html: chart.render(),
            csv: deviations_csv(&points),
            further: vec![],
            in_short: summary.join("; "),
        }
    };
    Ok(vec![
        exhibit(7, "gyroscope", "°/s", gyro, [1.9368 / 60.0, 1.239 / 60.0, 1.239 / 60.0]),
        exhibit(8, "accelerometer", "m/s²", accel, [0.0012, 0.0012, 0.0014]),
    ])
}

/// Figure 9: the output of the chain of sensors, 30 Hz filters and complementary filter, at rest.
fn chain() -> Result<Exhibit, InputError> {
    const RATE_HZ: f64 = 1000.0;
    let scene = bench::scene(20.0, 7, "[effects.gyro.white_noise]\n[effects.accel.white_noise]\n")?;
    let gyro = bench::readings(&scene, &mut scene.gyro(7, RATE_HZ), Vec3::ZERO, RATE_HZ, true);
    let accel = bench::readings(&scene, &mut scene.accel(7, RATE_HZ), GRAVITY_UP, RATE_HZ, true);
    let refused = |error: flight_core::config::ConfigError| InputError::new(error.to_string());
    let filter = || Biquad::butterworth(30.0, RATE_HZ as f32).map(|design| Prefilter::new(Some(design)));
    let (mut gyro_filter, mut accel_filter) = (filter().map_err(refused)?, filter().map_err(refused)?);
    let mut estimator = Estimator::new(&EstimatorParams::PAPER).map_err(refused)?;
    let at = |axes: &[Vec<f64>; 3], k: usize| vec3(axes[0][k] as f32, axes[1][k] as f32, axes[2][k] as f32);
    let mut channels: [Vec<(f64, f64)>; 4] = Default::default();
    for k in 0..gyro[0].len() {
        let rate = gyro_filter.step(at(&gyro, k));
        estimator.update(rate, accel_filter.step(at(&accel, k)), None, 1e-3);
        // Level and at rest the angles are small: roll and pitch are twice the vector part.
        let [_, x, y, _] = estimator.attitude().to_array().map(f64::from);
        let values = [gyro[0][k] / DEG, f64::from(rate.x) / DEG, 2.0 * x / DEG, 2.0 * y / DEG];
        // The first ten seconds are for settling.
        let time_s = k as f64 / RATE_HZ;
        if time_s >= 10.0 {
            channels.iter_mut().zip(values).for_each(|(channel, value)| channel.push((time_s, value)));
        }
    }
    let deviation = |points: &[(f64, f64)]| {
        let n = points.len() as f64;
        let mean = points.iter().map(|p| p.1).sum::<f64>() / n;
        libm::sqrt(points.iter().map(|p| (p.1 - mean) * (p.1 - mean)).sum::<f64>() / n)
    };
    let names = ["gyroscope x", "behind the 30 Hz filter", "roll", "pitch"];
    let units = ["°/s", "°/s", "°", "°"];
    let summary: Vec<String> = (0..4)
        .map(|i| format!("{} {} {}", names[i], plot::short(deviation(&channels[i])), units[i]))
        .collect();
    let csv = numbers(
        "time_s,gyro_x_deg_s,gyro_x_30_hz_deg_s,roll_deg,pitch_deg",
        (0..channels[0].len()).map(|k| {
            vec![channels[0][k].0, channels[0][k].1, channels[1][k].1, channels[2][k].1, channels[3][k].1]
        }),
    );
    let [raw, filtered, roll, pitch] = channels;
    let html = picture(
        "Gyroscope before and behind the filter, and the angles of the complementary filter, at rest",
        (10.0, 20.0),
        "time, s",
        vec![
            panel(
                "Gyroscope x",
                "°/s",
                vec![
                    line("raw", Stroke::solid(colour::ORANGE, 1.0), raw),
                    line("30 Hz", Stroke::solid(colour::BLACK, 1.1), filtered),
                ],
            ),
            panel(
                "Angles of the complementary filter",
                "°",
                vec![
                    line("roll", Stroke::solid(colour::BLUE, 1.3), roll),
                    line("pitch", Stroke::solid(colour::VERMILLION, 1.3), pitch),
                ],
            ),
        ],
    );
    Ok(Exhibit {
        name: "figure-09".into(),
        title: "Figure 9: the chain".into(),
        caption: format!(
            "The paper draws the chain as blocks: sensors with the noise of table 2, a 30 Hz Butterworth filter on \
             each, and the complementary filter (0.97 at 100 Hz, a time constant of 0.3233 s). This is its output at rest, at \
             1 kHz, computed by the flight code. Standard deviations: {}.",
            summary.join(", ")
        ),
        html,
        csv,
        further: vec![],
        in_short: summary.join(", "),
    })
}
