use sim_host::flight::{Flight, Observer, StepView};
use sim_host::scene::Scene;
struct P(u64);
impl Observer for P {
    fn step(&mut self, v: &StepView) {
        if v.output.event.is_some() {
            eprintln!("{} {:?}", v.time_us, v.output.event);
        }
        if self.0 > 0 && v.time_us % self.0 == 0 {
            let e = v.controller.attitude().to_euler();
            let d = v.truth.attitude.down();
            eprintln!(
                "{:.2} pos {:.2} {:.2} {:.2} tilt {:.2} {:.2} est {:.2} {:.2} {:.2} pulses {:?}",
                v.time_us as f64 * 1e-6,
                v.truth.position.x,
                v.truth.position.y,
                v.truth.position.z,
                d.y.asin().to_degrees(),
                -d.x.asin().to_degrees(),
                e.roll.to_degrees(),
                e.pitch.to_degrees(),
                e.yaw.to_degrees(),
                v.output.pulses_us
            );
        }
    }
}
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let scene = match Scene::load(&a[1]) {
        Ok(s) => s,
        Err(e) => {
            eprintln!("{e}");
            std::process::exit(2)
        }
    };
    let t = std::time::Instant::now();
    let out = Flight::new(&scene, scene.seed).run(&mut P(a.get(2).map_or(0, |x| x.parse().unwrap())));
    let w = t.elapsed().as_secs_f64();
    println!("{out:#?} {} steps/s", out.control_steps as f64 / w);
}
