//! The errors of the TOML parser in words: which key is wrong, which value it has, and what is allowed.
//!
//! The parser says "invalid type: string \"x\", expected f64" and does not name the key. The error here is
//! `scene.duration_s = "x": must be a number`.

use toml::de::DeValue;

use crate::InputError;
use crate::check::{nearest, unknown};
use crate::layers::Found;

/// Returns the error for a message of the parser. `path` is the key that the message is about, or the table if a key is
/// missing; `found` is its value.
pub(crate) fn in_words(message: &str, path: &str, found: Option<Found>) -> InputError {
    let message = message.split_whitespace().collect::<Vec<_>>().join(" ");
    let names: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let of_table = |key: &str| format!("{path}.{key}").trim_start_matches('.').to_owned();
    let start = |start: &str| message.strip_prefix(start);
    match &names[..] {
        [key] if start("missing field").is_some() => InputError::missing().field(of_table(key)),
        [_] if start("unknown field").is_some() => {
            InputError::new("unknown key: the table has no keys").field(path)
        }
        [wrong, keys @ ..] if start("unknown field").is_some() => {
            let near = nearest(wrong, keys.iter().copied());
            InputError::new(format!("unknown key: must be one of {}{near}", keys.join(", "))).field(path)
        }
        [wrong, words @ ..] if start("unknown variant").is_some() => {
            unknown(path, wrong, words.iter().copied())
        }
        _ => {
            // What the parser says about an enum.
            let message = message.replace("wanted string or table", ", expected a string");
            let allowed = match message.split_once(", expected ") {
                Some((_, expected)) => type_in_words(expected, found.as_ref().map(|found| found.value)),
                None => message,
            };
            let error = InputError::new(allowed);
            let error = if path.is_empty() { error } else { error.field(path) };
            match found {
                Some(Found { value: DeValue::Table(_), .. }) | None => error,
                Some(Found { text, .. }) => {
                    error.value(text.split_whitespace().collect::<Vec<_>>().join(" "))
                }
            }
        }
    }
}

/// Returns what is allowed where the parser expected this type and found this value.
fn type_in_words(expected: &str, found: Option<&DeValue>) -> String {
    let whole = |minimum: i64, maximum: i64| format!("a whole number from {minimum} to {maximum}");
    let words = match expected {
        "f64" | "f32" => "a number".into(),
        "u8" => whole(0, u8::MAX.into()),
        "u16" => whole(0, u16::MAX.into()),
        "u32" => whole(0, u32::MAX.into()),
        // TOML has no larger integer.
        "u64" => whole(0, i64::MAX),
        "i16" => whole(i16::MIN.into(), i16::MAX.into()),
        "a boolean" => "true or false".into(),
        "a string" => "text in quotes".into(),
        "a sequence" => "a list".into(),
        // The parser does not say of what. A number in the wrong place stands for numbers.
        "an array of length 3" if found.is_some_and(holds_numbers) => "a list of three numbers".into(),
        "an array of length 3" => "a list of three values".into(),
        _ if expected.starts_with("struct ") || expected == "a map" => "a table".into(),
        other => other.to_owned(),
    };
    format!("must be {words}")
}

fn holds_numbers(value: &DeValue) -> bool {
    let is_number = |value: &DeValue| matches!(value, DeValue::Integer(_) | DeValue::Float(_));
    match value {
        DeValue::Array(entries) => entries.iter().any(|entry| is_number(entry.get_ref())),
        value => is_number(value),
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use crate::layers::{Layers, merge};

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
}
