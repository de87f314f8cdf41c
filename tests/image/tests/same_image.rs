//! Two users build the same flash image from copies of the sources in folders of different length, each with their own
//! home directory and CARGO_HOME.
//!
//! Both builds use this machine's toolchain. This test does not show that another operating system gives the same
//! bytes, nor that a toolchain with the standard library's sources does; the latter was checked by hand (see
//! `.cargo/rustc`).

use std::env;
use std::ffi::OsStr;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

use sim_host::image::{flashed_bytes, image_sha256};

const TARGET: &str = "thumbv7em-none-eabihf";

fn workspace() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

fn cargo() -> Command {
    Command::new(env::var_os("CARGO").as_deref().unwrap_or(OsStr::new("cargo")))
}

fn run(command: &mut Command) -> Vec<u8> {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    assert!(output.status.success(), "{command:?}:\n{}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

/// Returns a directory that is below the home directory unless a variable names it.
fn place(variable: &str, under_home: &str) -> PathBuf {
    let home = || PathBuf::from(env::var_os("HOME").expect("a home directory")).join(under_home);
    env::var_os(variable).map_or_else(home, PathBuf::from)
}

/// Copies the sources of the working tree, without files that git ignores.
fn copy_sources(to: &Path) {
    let listed = run(Command::new("git").current_dir(workspace()).args([
        "ls-files",
        "-z",
        "--cached",
        "--others",
        "--exclude-standard",
    ]));
    for name in String::from_utf8(listed).unwrap().split_terminator('\0') {
        let (from, to) = (workspace().join(name), to.join(name));
        // A file in the index may have been deleted from the working tree.
        if from.is_file() {
            fs::create_dir_all(to.parent().unwrap()).unwrap();
            fs::copy(&from, &to).unwrap();
        }
    }
}

/// Builds in `folder` as a user with this home directory, and returns the image. The user's CARGO_HOME links to the
/// fetched crates and unpacks them again.
fn build(folder: &Path, home: &Path) -> Vec<u8> {
    copy_sources(folder);
    let cargo_home = home.join("cargo");
    fs::create_dir_all(cargo_home.join("registry")).unwrap();
    for part in ["index", "cache"] {
        let fetched = place("CARGO_HOME", ".cargo").join("registry").join(part);
        symlink(fetched, cargo_home.join("registry").join(part)).unwrap();
    }
    let mut command = cargo();
    command
        .current_dir(folder)
        .args([
            "build",
            "--profile",
            "flash",
            "--package",
            "firmware",
            "--target",
            TARGET,
            "--offline",
            "--quiet",
        ])
        .env("RUSTUP_HOME", place("RUSTUP_HOME", ".rustup"))
        .env("HOME", home)
        .env("CARGO_HOME", cargo_home);
    // Settings of the surrounding build must not reach this build.
    for variable in ["CARGO_TARGET_DIR", "DEFMT_LOG", "RUSTC", "RUSTFLAGS", "CARGO_ENCODED_RUSTFLAGS"] {
        command.env_remove(variable);
    }
    run(&mut command);
    fs::read(folder.join("target").join(TARGET).join("flash/firmware")).unwrap()
}

#[test]
#[ignore = "builds the firmware twice"]
fn two_users_build_the_same_image() {
    // The only step that may need a network.
    run(cargo().current_dir(workspace()).args(["fetch", "--locked"]));
    // Outside the workspace, because its cargo configuration would apply too.
    let directory = tempfile::Builder::new().prefix("kestrel-image-").tempdir().unwrap();
    let temporary = directory.path();
    let one = build(&temporary.join("a/kestrel"), &temporary.join("a/home"));
    let folder = "another user/with a longer path to it";
    let other = build(&temporary.join(folder).join("sources"), &temporary.join(folder).join("home"));

    let (start, bytes) = flashed_bytes(&one).unwrap();
    println!("image: {} bytes from {start:#010x}, sha256 {}", bytes.len(), image_sha256(&one).unwrap());
    let place = temporary.to_str().unwrap().as_bytes();
    let named = bytes.windows(place.len()).any(|bytes| bytes == place);
    assert!(!named, "the image names {}", temporary.display());
    assert_eq!(image_sha256(&one).unwrap(), image_sha256(&other).unwrap(), "hashes of the flashed bytes");
    assert!(one == other, "the files differ in parts that are not flashed");
    agrees_with_objcopy(&one, temporary);
}

/// Checks that objcopy programs, where installed, extract the same bytes for flashing.
fn agrees_with_objcopy(elf: &[u8], folder: &Path) {
    let (image, flat) = (folder.join("image"), folder.join("image.bin"));
    fs::write(&image, elf).unwrap();
    for program in ["llvm-objcopy", "arm-none-eabi-objcopy"] {
        let status = Command::new(program).args(["-O", "binary"]).args([&image, &flat]).status();
        if status.is_ok_and(|status| status.success()) {
            assert!(
                fs::read(&flat).unwrap() == flashed_bytes(elf).unwrap().1,
                "{program} extracts other bytes"
            );
            println!("image: {program} extracts the same bytes");
        }
    }
}
