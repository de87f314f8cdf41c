//! The program `emulator` on the command line: its examples, and the errors for bad input.

use std::path::Path;
use std::process::{Command, Output};

use super::firmware;

fn emulator(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_emulator")).args(arguments).output().unwrap()
}

/// Checks for exit code 2, an empty standard output, and an error of one line that contains all `parts`.
#[track_caller]
fn assert_refused(arguments: &[&str], parts: &[&str]) {
    let output = emulator(arguments);
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {error}");
    assert!(output.stdout.is_empty(), "{arguments:?}");
    assert_eq!(error.lines().count(), 1, "{arguments:?}: {error}");
    for part in parts {
        assert!(error.contains(part), "{arguments:?}: no {part:?} in {error}");
    }
}

/// The first example of the help flies; the second would build an image for another vehicle, so only its arguments are
/// checked: the error is that of an image that does not exist, and not of the arguments.
#[test]
fn examples_of_the_help_run() {
    let help = String::from_utf8(emulator(&["--help"]).stdout).unwrap();
    let section = help.lines().skip_while(|line| *line != "Example:").skip(1);
    let examples: Vec<&str> = section.map_while(|line| line.strip_prefix("  emulator ")).collect();
    let [flown, checked] = examples[..] else { panic!("two examples: {help}") };

    let directory = tempfile::tempdir().unwrap();
    let image = std::path::absolute(image()).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_emulator"))
        .args(flown.split(' '))
        .arg("--image")
        .arg(image)
        .current_dir(directory.path())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    for file in flown.split(' ').filter(|argument| argument.contains('.')) {
        assert!(directory.path().join(file).is_file(), "{file} does not exist");
    }
    let arguments: Vec<&str> = checked.split(' ').chain(["--image", "/no/such/file"]).collect();
    assert_refused(&arguments, &["/no/such/file: cannot be read"]);
}

fn image() -> String {
    firmware().name()
}

#[test]
fn scenes_and_boards_that_do_not_fit_are_refused() {
    let image = image();
    assert_refused(&["no-such-scene"], &["no-such-scene"]);
    assert_refused(&["static", "--image", &image], &["static: pilot: is missing", "sim-host scenes"]);
    assert_refused(&["hover", "--duration", "-1", "--image", &image], &["--duration = -1: "]);
    assert_refused(
        &["hover", "--board", "matek"],
        &["--board = matek: must be one of speedybee-f405-v4, speedybee-f405-mini, matek-f405-te"],
    );

    // The image is for another board than --board, or the board file has an error.
    assert_refused(
        &["hover", "--board", "matek-f405-te", "--image", &image],
        &["is for the board speedybee-f405-v4, but --board is matek-f405-te"],
    );
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("other.toml");
    std::fs::write(&scene, "include = \"hover\"\n[scene]\nimu = \"adis16448\"\n").unwrap();
    let board = folder.path().join("mine.toml");
    let text = ::board::BUILT_IN[0].1.replace("\"PC13\"", "\"PC4\"");
    std::fs::write(&board, text).unwrap();
    assert_refused(
        &["hover", "--board", board.to_str().unwrap()],
        &["mine.toml:", " led.pin = PC4: already used by imu.ready"],
    );
    assert_refused(&[scene.to_str().unwrap(), "--image", &image], &["imu: the scene's ", "icm-42688-p"]);
}

#[test]
fn invalid_image_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path.to_str().unwrap().to_owned()
    };
    assert_refused(&["hover", "--image", "/no/such/file"], &["/no/such/file: cannot be read"]);
    assert_refused(&["hover", "--image", "/dev/zero"], &["/dev/zero: must be a file of at most"]);
    assert_refused(&["hover", "--image", folder.path().to_str().unwrap()], &["must be a file of at most"]);
    assert_refused(&["hover", "--image", &file("empty.elf", b"")], &["empty.elf: is empty"]);
    assert_refused(&["hover", "--image", &file("text.elf", b"no ELF")], &["text.elf: must be an ELF image"]);
    assert_refused(
        &["hover", "--image", &file("cut.elf", &firmware().elf()[..30])],
        &["cut.elf: ", "truncated"],
    );
}

#[test]
fn log_does_not_overwrite_image_or_scene() {
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("copy.elf");
    std::fs::write(&copy, firmware().elf()).unwrap();
    let copy_name = copy.to_str().unwrap();
    assert_refused(
        &["hover", "--image", copy_name, "--log", copy_name],
        &["--log = ", "must not be a file that is read"],
    );
    assert!(std::fs::read(&copy).unwrap() == firmware().elf());
    let scene = folder.path().join("mine.toml");
    std::fs::write(&scene, "include = \"hover\"\n").unwrap();
    let scene_name = scene.to_str().unwrap();
    assert_refused(&[scene_name, "--log", scene_name, "--image", copy_name], &["--log = "]);
    assert_eq!(std::fs::read_to_string(&scene).unwrap(), "include = \"hover\"\n");
}

/// The exit code is 1; the JSON has `armed` and the reason in `violations`.
#[test]
fn flight_that_does_not_arm_fails_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("empty-battery.toml");
    let text = "include = \"weak-battery\"\n[effects.vehicle.battery_sag]\ncharge = 0.0\n";
    std::fs::write(&scene, text).unwrap();
    let output = emulator(&[scene.to_str().unwrap(), "--image", &image(), "--json"]);
    assert_eq!(output.status.code(), Some(1));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&json["armed"], &json["took_off"]), (&false.into(), &false.into()), "{json}");
    assert_eq!(json["violations"], serde_json::json!(["did not arm: battery low or not measured"]));
}

/// The program reports results that it cannot write.
#[cfg(target_os = "linux")]
#[test]
fn full_disk_at_standard_output_is_an_error() {
    let full = std::fs::File::options().write(true).open(Path::new("/dev/full")).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_emulator"))
        .args(["hover", "--duration", "13", "--image", &image()])
        .stdout(full)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8(output.stderr).unwrap().contains("standard output: cannot be written"));
}
