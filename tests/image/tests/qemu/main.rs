//! The firmware on QEMU's STM32F405: its results, and the number of instructions.
//!
//! The tests build the images for the QEMU machine `netduinoplus2` and run them with `-icount`, which ties QEMU's
//! time to executed instructions: every run is the same on every machine.

mod figures;

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::{env, fs};

use fixed_input::{STEPS, WORDS_FILE, WORDS_PER_STEP};
use flight_core::FlightController;
use flight_core::estimator::EstimatorParams;

type Words = [u32; WORDS_PER_STEP];

#[test]
#[ignore = "needs qemu-system-arm"]
fn five_seconds_on_the_board_equal_the_host_bit_for_bit() {
    let directory = fresh_directory("words");
    let output = run(&board_image("firmware"), &directory);

    let name = WORDS_FILE.to_str().unwrap();
    let bytes = fs::read(directory.join(name)).unwrap();
    let words: Vec<u32> = bytes.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
    let board: Vec<Words> = words.as_chunks().0.to_vec();
    assert_eq!(board.len(), STEPS as usize);
    assert_eq!(bytes.len(), board.len() * 4 * WORDS_PER_STEP);

    let host = steps_on_the_host();
    for (slot, (board, host)) in board.iter().zip(&host).enumerate() {
        assert_eq!(board, host, "slot {slot}: words of the board and of the host");
    }

    // The input table covers the cases: the vehicle flies and stops, and samples are missing.
    let driven = host.iter().filter(|words| words[1] == 1).count();
    assert!((1_500..2_500).contains(&driven), "driven in {driven} steps");
    assert_eq!(host.last().unwrap()[1], 0, "the sensor loss stops the motors");
    let pulses: BTreeSet<u32> = host.iter().flat_map(|words| words[2..6].to_vec()).collect();
    assert!(pulses.len() > 3_000, "{} different pulses", pulses.len());
    println!("{STEPS} steps of {WORDS_PER_STEP} words are equal, {driven} of them with the motors driven");

    let line = output.lines().find_map(|line| line.strip_prefix("icount,sample to motors,")).expect(&output);
    let [steps, total, max] = line.split(',').map(|n| n.parse::<u32>().unwrap()).collect::<Vec<_>>()[..]
    else {
        panic!("{line}")
    };
    println!("sample to motors: {steps} steps, mean {} instructions, maximum {max}", total / steps);
    assert!(steps > 4_500);
    image_tests::budget("instructions", "sample to motors", max);
}

/// Returns the words for the same input table, computed on the host.
fn steps_on_the_host() -> Vec<Words> {
    let mut controller = FlightController::new(&fixed_input::config()).unwrap();
    (0..STEPS)
        .map(|slot| {
            let input = fixed_input::input(slot);
            let output = controller.step(&input);
            let driven = output.permit.is_some();
            fixed_input::words(input.time_us, driven, output.pulses_us, controller.attitude())
        })
        .collect()
}

/// The stages with an instruction budget.
const STAGES: [&str; 13] = [
    "calibration of 3 sensors",
    "9 prefilters",
    "first sample of 9 prefilters",
    "8 biquads one by one",
    "estimator paper 9-axis",
    "estimator flight 9-axis",
    "estimator robust 9-axis",
    "control",
    "mixer and ESC",
    "4 DShot frames",
    "sticks",
    "step in flight 9-axis every time",
    // Everything that can coincide in flight, and what is added on the ground.
    "step",
];

#[test]
#[ignore = "needs qemu-system-arm"]
fn estimators_equal_the_host_and_stages_keep_their_budgets() {
    let output = run(&board_image("icount"), &fresh_directory("icount"));
    let mut counts = BTreeMap::new();
    let mut digests = BTreeMap::new();
    println!(
        "{:34} {:>7} {:>8} {:>6}   instructions on the Cortex-M4F of QEMU",
        "stage", "inputs", "mean", "max"
    );
    for line in output.lines() {
        let fields: Vec<&str> = line.split(',').collect();
        if let ["attitudes", preset, digest] = fields[..] {
            digests.insert(preset.to_owned(), digest.parse::<u32>().unwrap());
            continue;
        }
        let ["icount", stage, inputs, total, max] = fields[..] else { panic!("{line}") };
        let mean = total.parse::<f64>().unwrap() / inputs.parse::<f64>().unwrap();
        println!("{stage:34} {inputs:>7} {mean:8.1} {max:>6}");
        counts.insert(stage.to_owned(), (inputs.parse::<u32>().unwrap(), mean, max.parse::<u32>().unwrap()));
    }
    let host = EstimatorParams::PRESETS
        .map(|(name, preset)| (name.to_owned(), fixed_input::attitudes_digest(&preset).unwrap()));
    assert_eq!(digests, BTreeMap::from(host));

    // The counter must count a thousand instructions as a thousand.
    assert_eq!(counts["1000 nops"], (1_024, 1_000.0, 1_000));
    // The time does not depend on the numbers, denormals included.
    let (_, mean, max) = counts["8 biquads down a tail"];
    assert_eq!(mean, f64::from(max));
    for stage in STAGES {
        let (inputs, _, max) = counts[stage];
        assert!(inputs >= 1_024, "{stage}: {inputs} inputs");
        image_tests::budget("instructions", stage, max);
    }
    // The figure is from the converters' counts to the ESCs' pulses, with every sensor in every step.
    for (name, estimator) in
        [("chain of paper", "estimator paper 9-axis"), ("chain of flight", "estimator flight 9-axis")]
    {
        let chain = ["calibration of 3 sensors", "9 prefilters", estimator, "control", "mixer and ESC"];
        image_tests::budget("instructions", name, chain.iter().map(|stage| counts[*stage].2).sum());
    }
}

/// Returns the QEMU image of this name. All of them are built once.
fn board_image(name: &str) -> PathBuf {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    BUILT.get_or_init(|| build(&["build-qemu"])).join(name)
}

/// Builds the image that measures the alternatives to the flight code, which needs more crates.
fn alternatives_image() -> PathBuf {
    let features = ["--no-default-features", "--features", "alternatives", "--bin", "alternatives"];
    let target = ["--target", "thumbv7em-none-eabihf"];
    build(&[&["build", "--profile", "flash", "--package", "firmware"], &target[..], &features].concat())
        .join("alternatives")
}

/// Runs cargo in a separate target directory, because the outer build holds the lock of its own, and returns the
/// directory of the images.
fn build(arguments: &[&str]) -> PathBuf {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("qemu");
    let status = Command::new(env::var_os("CARGO").as_deref().unwrap_or(OsStr::new("cargo")))
        .current_dir(workspace())
        .args(arguments)
        .arg("--target-dir")
        .arg(&target)
        // These would replace the link arguments of .cargo/config.toml.
        .env_remove("RUSTFLAGS")
        .env_remove("CARGO_ENCODED_RUSTFLAGS")
        .status()
        .expect("cargo runs");
    assert!(status.success(), "the image does not build");
    target.join("thumbv7em-none-eabihf/flash")
}

fn workspace() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

fn fresh_directory(name: &str) -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("qemu-runs").join(name);
    if directory.exists() {
        fs::remove_dir_all(&directory).unwrap();
    }
    fs::create_dir_all(&directory).unwrap();
    directory
}

/// Runs an image to its end in `directory`, and returns its output.
fn run(image: &Path, directory: &Path) -> String {
    let accesses = directory.join("accesses.log");
    let qemu = Command::new("qemu-system-arm")
        .current_dir(directory)
        .args(["-machine", "netduinoplus2", "-icount", "shift=2,sleep=off"])
        .args(["-semihosting-config", "enable=on,target=native"])
        .args(["-display", "none", "-serial", "none", "-monitor", "none"])
        .args(["-d", "unimp,guest_errors", "-D"])
        .arg(&accesses)
        .arg("-kernel")
        .arg(image)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("qemu-system-arm runs: apt-get install qemu-system-arm");
    let mut qemu = KilledOnDrop(qemu);
    let mut printed = String::new();
    qemu.0.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
    let mut errors = String::new();
    qemu.0.stderr.take().unwrap().read_to_string(&mut errors).unwrap();
    let status = qemu.0.wait().unwrap();
    assert!(status.success(), "{status}\n{printed}{errors}");
    // Registers that QEMU does not model read as zero: an image that uses one proves nothing.
    let accesses = fs::read_to_string(accesses).unwrap_or_default();
    assert!(accesses.is_empty(), "accesses that QEMU does not model:\n{accesses}");
    printed + &errors
}

struct KilledOnDrop(Child);

impl Drop for KilledOnDrop {
    fn drop(&mut self) {
        // An error means that the process has already ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
