use serde::Deserialize;

use super::{Layers, merge};

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default, rename = "gyro")]
    _gyro: Option<Gyro>,
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
        (
            "nose = 1",
            "gyro.nose: unknown key: must be one of noise, axes, tones, on, rotor, kind (did you mean `noise`?)",
        ),
    ] {
        let usual = if line.starts_with("noise") { "" } else { "noise = [1, 2, 3]" };
        assert_eq!(refused(&format!("[gyro]\n{usual}\n{line}\n")), format!("x.toml:3: {error}"));
    }
    assert_eq!(refused("[gyro]\n"), "x.toml:1: gyro.noise: is missing");
    assert_eq!(refused("gyro = 5\n"), "x.toml:1: gyro = 5: must be a table");
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
