use serde::Deserialize;

use super::{Layers, merge};

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    gyro: Option<Gyro>,
    #[serde(default, rename = "move")]
    _moves: Vec<Move>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Gyro {
    #[serde(rename = "noise")]
    _noise: [f64; 3],
    #[serde(default, rename = "axes")]
    _axes: Option<[String; 3]>,
    #[serde(default, rename = "tones")]
    _tones: Vec<f64>,
    #[serde(default, rename = "on")]
    _on: bool,
    #[serde(default, rename = "rotor")]
    _rotor: u8,
    #[serde(default, rename = "cells", deserialize_with = "crate::check::whole_number::<_, _, 1, 24>")]
    _cells: u8,
    #[serde(default)]
    seed: u64,
    #[serde(default, rename = "kind")]
    _kind: Option<Kind>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Kind {
    Dead,
    Spike,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Move {
    #[serde(rename = "at_s")]
    _at_s: f64,
}

fn refused(text: &str) -> String {
    let mut layers = Layers::default();
    let table = layers.add("x.toml", text).unwrap();
    layers.read::<File>(&table).unwrap_err().to_string()
}

#[test]
fn each_wrong_type_is_named_with_its_key_and_line() {
    for (line, error) in [
        ("noise = 0.1", "gyro.noise = 0.1: must be a list of three numbers"),
        ("noise = [1, 2]", "gyro.noise = [1, 2]: must be a list of three numbers"),
        ("noise = [1, 2, 3, 4]", "gyro.noise = [1, 2, 3, 4]: must be a list of three numbers"),
        ("noise = [1, \"2\", 3]", "gyro.noise = \"2\": must be a number"),
        ("axes = \"up\"", "gyro.axes = \"up\": must be a list of three values"),
        ("axes = [1, 2, 3]", "gyro.axes = 1: must be text in quotes"),
        ("tones = 5", "gyro.tones = 5: must be a list"),
        ("on = 1", "gyro.on = 1: must be true or false"),
        ("rotor = 1.5", "gyro.rotor = 1.5: must be a whole number from 0 to 255"),
        ("rotor = 256", "gyro.rotor = 256: must be a whole number from 0 to 255"),
        ("kind = \"deaf\"", "gyro.kind = deaf: must be one of dead, spike (did you mean `dead`?)"),
        ("kind = 5", "gyro.kind = 5: must be text in quotes"),
        ("kind = { dead = {} }", "gyro.kind = { dead = {} }: must be text in quotes"),
        ("kind = [\"dead\"]", "gyro.kind = [\"dead\"]: must be text in quotes"),
        ("cells = 25", "gyro.cells = 25: must be a whole number from 1 to 24"),
        ("cells = 0", "gyro.cells = 0: must be a whole number from 1 to 24"),
        ("cells = 300", "gyro.cells = 300: must be a whole number from 1 to 24"),
        ("cells = 2.5", "gyro.cells = 2.5: must be a whole number from 1 to 24"),
        ("seed = -1", "gyro.seed = -1: must be a whole number from 0 to 18446744073709551615"),
        (
            "seed = 18446744073709551616",
            "gyro.seed = 18446744073709551616: must be a whole number from 0 to 18446744073709551615",
        ),
        ("rotor = 1979-05-27", "gyro.rotor = 1979-05-27: must be a whole number from 0 to 255"),
        (
            "nose = 1",
            "gyro.nose: unknown key: must be one of noise, axes, tones, on, rotor, cells, seed, kind (did you mean `noise`?)",
        ),
    ] {
        let usual = if line.starts_with("noise") { "" } else { "noise = [1, 2, 3]" };
        assert_eq!(refused(&format!("[gyro]\n{usual}\n{line}\n")), format!("x.toml:3: {error}"));
    }
    assert_eq!(refused("[gyro]\n"), "x.toml:1: gyro.noise: is missing");
    assert_eq!(refused("gyro = 5\n"), "x.toml:1: gyro = 5: must be a table");
    assert_eq!(refused("gyro = [[1, 2, 3]]\n"), "x.toml:1: gyro = [[1, 2, 3]]: must be a table");
    assert_eq!(refused("move = [[1]]\n"), "x.toml:1: move = [1]: must be a table");
    let array = refused("[[gyro]]\nnoise = [1, 2, 3]\n");
    assert!(array.starts_with("x.toml:1: gyro") && array.ends_with(": must be a table"), "{array}");
    assert_eq!(
        refused("[[move]]\nat_s = 1\n[[move]]\nat_s = true\n"),
        "x.toml:4: move.at_s = true: must be a number"
    );
    assert_eq!(refused("[[move]]\nat_s = 1\n[[move]]\n"), "x.toml:3: move.at_s: is missing");
}

#[test]
fn longer_lists_of_any_length_are_accepted() {
    let mut layers = Layers::default();
    let text = "gyro = { noise = [1, 2, 3], tones = [1, 2, 3, 4] }\nmove = [{at_s = 1}, {at_s = 2}, {at_s = 3}, {at_s = 4}]\n";
    let table = layers.add("x.toml", text).unwrap();
    layers.read::<File>(&table).unwrap();
}

#[test]
fn whole_numbers_may_use_all_64_bits() {
    let mut layers = Layers::default();
    let table = layers.add("x.toml", "gyro = { noise = [1, 2, 3], seed = 18446744073709551615 }\n").unwrap();
    assert_eq!(layers.read::<File>(&table).unwrap().gyro.unwrap().seed, u64::MAX);
}

#[test]
fn duplicate_key_is_named() {
    let error = |text| Layers::default().add("x.toml", text).unwrap_err().to_string();
    assert_eq!(error("[gyro]\nrotor = 1\nrotor = 2\n"), "x.toml:3: rotor: must be given only once");
    assert_eq!(error("[gyro]\n[move]\n[gyro]\n"), "x.toml:3: gyro: must be given only once");
}

#[test]
fn numbers_are_shown_as_they_are_written() {
    let mut layers = Layers::default();
    let table = layers.add("x.toml", "[gyro]\ncutoff = 50.10\nrotor = 0x10\nnoise = [1, 2, 3]\n").unwrap();
    for (field, shown) in [
        ("gyro.cutoff", "x.toml:2: gyro.cutoff = 50.10: wrong"),
        ("gyro.rotor", "x.toml:3: gyro.rotor = 0x10: wrong"),
        ("gyro.noise", "x.toml:4: gyro.noise = 7: wrong"),
    ] {
        let error = crate::InputError::new("wrong").field(field).value(7);
        assert_eq!(layers.locate(error, &table).to_string(), shown);
    }
}

/// The place of a range error: the key, else the innermost table around it.
#[test]
fn keys_are_located_in_the_text_that_has_them() {
    let mut layers = Layers::default();
    let over = layers.add("over.toml", "[gyro]\non = true\n").unwrap();
    let under = layers
        .add("under.toml", "\n[gyro]\nnoise = [1, 2, 3]\n[[move]]\nat_s = 1\n[[move]]\nat_s = 2\n")
        .unwrap();
    let table = merge(over, under);
    for (field, located) in [
        ("gyro.on", "over.toml:2: gyro.on: wrong"),
        ("gyro.noise", "under.toml:3: gyro.noise: wrong"),
        ("gyro.rotor", "over.toml:1: gyro.rotor: wrong"),
        ("move[0].at_s", "under.toml:5: move.at_s: wrong"),
        ("move[1].at_s", "under.toml:7: move.at_s: wrong"),
        ("move[1].for_s", "under.toml:6: move.for_s: wrong"),
        ("--seed", "--seed: wrong"),
    ] {
        let error = crate::InputError::new("wrong").field(field);
        assert_eq!(layers.locate(error, &table).to_string(), located);
    }
}
