//! The program `emulator` as scripts and people meet it: what it refuses, and how.

use std::path::Path;
use std::process::{Command, Output};

use super::firmware;

fn emulator(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_emulator")).args(arguments).output().unwrap()
}

/// Refused with exit code 2, nothing on standard output, and one line that contains all of `said`.
#[track_caller]
fn refuses(arguments: &[&str], said: &[&str]) {
    let output = emulator(arguments);
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {error}");
    assert!(output.stdout.is_empty(), "{arguments:?}");
    assert_eq!(error.lines().count(), 1, "{arguments:?}: {error}");
    for part in said {
        assert!(error.contains(part), "{arguments:?}: no {part:?} in {error}");
    }
}

fn image() -> String {
    firmware().name()
}

#[test]
fn scenes_that_the_board_does_not_fly_are_refused() {
    let image = image();
    refuses(&["no-such-scene"], &["no-such-scene"]);
    refuses(&["static", "--image", &image], &["static: pilot: is missing", "sim-host scenes"]);
    refuses(&["hover", "--duration", "-1", "--image", &image], &["--duration = -1: "]);
    refuses(
        &["hover", "--board", "matek"],
        &["--board = matek: must be one of speedybee-f405-v4, speedybee-f405-mini, matek-f405-te"],
    );

    // An image for another board than that which is asked for, and a board's file with a mistake.
    refuses(
        &["hover", "--board", "matek-f405-te", "--image", &image],
        &["is for the board speedybee-f405-v4, and --board says matek-f405-te"],
    );
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("other.toml");
    std::fs::write(&scene, "include = \"hover\"\n[scene]\nimu = \"adis16448\"\n").unwrap();
    let board = folder.path().join("mine.toml");
    let text = ::board::BUILT_IN[0].1.replace("\"PC13\"", "\"PC4\"");
    std::fs::write(&board, text).unwrap();
    refuses(
        &["hover", "--board", board.to_str().unwrap()],
        &["mine.toml: led.pin = PC4: is imu.ready's pin already"],
    );
    refuses(&[scene.to_str().unwrap(), "--image", &image], &["imu: the scene's ", "icm-42688-p"]);
}

#[test]
fn images_that_are_none_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path.to_str().unwrap().to_owned()
    };
    refuses(&["hover", "--image", "/no/such/file"], &["/no/such/file: cannot be read"]);
    refuses(&["hover", "--image", "/dev/zero"], &["/dev/zero: must be a file of at most"]);
    refuses(&["hover", "--image", folder.path().to_str().unwrap()], &["must be a file of at most"]);
    refuses(&["hover", "--image", &file("empty.elf", b"")], &["empty.elf: is empty"]);
    refuses(&["hover", "--image", &file("text.elf", b"no ELF")], &["text.elf: must be an ELF image"]);
    refuses(&["hover", "--image", &file("cut.elf", &firmware().elf()[..30])], &["cut.elf: ", "cut short"]);
}

#[test]
fn the_log_spares_image_and_scene() {
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("copy.elf");
    std::fs::write(&copy, firmware().elf()).unwrap();
    let copy_name = copy.to_str().unwrap();
    refuses(
        &["hover", "--image", copy_name, "--log", copy_name],
        &["--log = ", "must not be a file that is read"],
    );
    assert!(std::fs::read(&copy).unwrap() == firmware().elf());
    let scene = folder.path().join("mine.toml");
    std::fs::write(&scene, "include = \"hover\"\n").unwrap();
    let scene_name = scene.to_str().unwrap();
    refuses(&[scene_name, "--log", scene_name, "--image", copy_name], &["--log = "]);
    assert_eq!(std::fs::read_to_string(&scene).unwrap(), "include = \"hover\"\n");
}

/// A short flight that does not arm fails, and says why in a key and in words.
#[test]
fn a_flight_that_does_not_arm_fails_and_says_why() {
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

/// Nothing that was measured is lost in silence.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_behind_standard_output_is_an_error() {
    let full = std::fs::File::options().write(true).open(Path::new("/dev/full")).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_emulator"))
        .args(["hover", "--duration", "13", "--image", &image()])
        .stdout(full)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8(output.stderr).unwrap().contains("standard output: cannot be written"));
}
