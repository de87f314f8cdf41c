//! `docs/scene.md` against the parser: tables, keys, types, units, ranges, defaults, examples and error messages.
//!
//! The parser itself says which keys it has. Each key gets a table with an unknown key in it, `{ no_such_key = 1 }`. A
//! table answers with its keys, and each of them is asked in turn; a word answers with the words that exist, anything else with
//! its type. **An answer of another kind fails the test,** so that no table can be missed: neither one that takes unknown
//! keys nor one of a type that is new here.
//!
//! Ranges and defaults are tried in a few scenes that together have every key ([`bases`]).

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};

use sim_host::flight::Flight;
use sim_host::scene::{BUILT_IN, Scene};
use toml::{Table, Value};

/// Tables of a document that become files of their own: the sensors' preset and the vehicle that its scene names.
const PRESET: &str = "preset file";
const VEHICLE: &str = "vehicle file";

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn page() -> String {
    let path = workspace().join("docs/scene.md");
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

// ---------------------------------------------------------------------------------------------------------------------
// Documents
// ---------------------------------------------------------------------------------------------------------------------

/// What the parser makes of a document: a scene, or the error and the key in it.
fn parsed(document: &Table) -> Result<Scene, (String, String)> {
    let mut scene = document.clone();
    let mut file = |name| match scene.remove(name) {
        Some(Value::Table(table)) => table.to_string(),
        _ => String::new(),
    };
    let (preset, vehicle) = (file(PRESET), file(VEHICLE));
    let read = |path: &Path| match path.to_str() {
        Some("own-imu.toml") => Ok(preset.clone()),
        Some("own-vehicle.toml") => Ok(vehicle.clone()),
        _ => Err(io::Error::other("not a file of this test")),
    };
    Scene::parse_with("scene.toml", &scene.to_string(), &read)
        .map_err(|error| (error.to_string(), error.field_name().unwrap_or_default().to_owned()))
}

/// Everything in a scene but the text that it was read from.
fn content(scene: &Scene) -> String {
    let mut scene = scene.clone();
    scene.text_hash = 0;
    scene.files.clear();
    format!("{scene:?}")
}

fn digest(scene: &Scene) -> u64 {
    Flight::new(scene, scene.seed).run(&mut ()).digest
}

fn merge(over: Table, under: &mut Table) {
    for (key, value) in over {
        match (value, under.get_mut(&key)) {
            (Value::Table(over), Some(Value::Table(under))) => merge(over, under),
            (value, _) => drop(under.insert(key, value)),
        }
    }
}

/// The value at a path; of an array of tables the first.
fn get<'a>(document: &'a Table, path: &str) -> Option<&'a Value> {
    let (parent, key) = path.rsplit_once('.').map_or((None, path), |(parent, key)| (Some(parent), key));
    let table = match parent {
        None => document,
        Some(parent) => match get(document, parent)? {
            Value::Array(tables) => tables.first()?.as_table()?,
            value => value.as_table()?,
        },
    };
    table.get(key)
}

/// Puts a value at a path, and makes the tables on the way to it; `None` removes what is there.
fn put(table: &mut Table, path: &str, value: Option<Value>) {
    match (path.split_once('.'), value) {
        (None, Some(value)) => drop(table.insert(path.into(), value)),
        (None, None) => drop(table.remove(path)),
        (Some((first, _)), None) if !table.contains_key(first) => {}
        (Some((first, rest)), value) => {
            let inner = match table.entry(first).or_insert_with(|| Table::new().into()) {
                Value::Array(tables) => tables.first_mut().expect("a table in the array"),
                inner => inner,
            };
            put(inner.as_table_mut().unwrap_or_else(|| panic!("{first} of {path} is no table")), rest, value);
        }
    }
}

fn with(document: &Table, path: &str, value: impl Into<Option<Value>>) -> Table {
    let mut document = document.clone();
    put(&mut document, path, value.into());
    document
}

fn table(text: &str) -> Table {
    text.parse().unwrap_or_else(|error| panic!("{error}: {text}"))
}

/// The shortest scene, with a vehicle of its own and a preset without figures.
fn bare() -> Table {
    let mut bare = table(
        "scene = { duration_s = 1.0, seed = 1, vehicle = 'own-vehicle.toml', imu = 'own-imu.toml' }
         ['preset file']
         gyro.lsb_per_deg_s = 16.4
         accel.lsb_per_g = 2048.0
         mag.lsb_per_gauss = 3000.0",
    );
    let os4 = std::fs::read_to_string(workspace().join("vehicles/os4.toml")).expect("a built-in vehicle");
    let mut vehicle = table(&os4);
    // What its file leaves out.
    let more = "esc.protocol = 'oneshot125'
         rates = { max_tilt_deg = 40.0, max_deg_s = 170.0, max_yaw_deg_s = 80.0, max_tilt_deg_s = 250.0 }
         filters = { prefilter_hz = 31.0, estimator = 'robust' }
         battery = { arm_v_per_cell = 3.6, critical_v_per_cell = 3.1 }
         rc = { order = 'TAER', arm_channel = 7, mode_channel = 9, arm_by = 'sticks' }
         mounting = { board = ['right', 'backward', 'down'], magnetometer = ['right', 'backward', 'down'] }";
    merge(table(more), &mut vehicle);
    bare.insert(VEHICLE.into(), vehicle.into());
    bare
}

/// Scenes that together have every key, with values that are no defaults.
fn bases() -> Vec<Table> {
    let built_in =
        |name: &str| table(BUILT_IN.iter().find(|scene| scene.name == name).expect("a built-in scene").text);
    let merged = |layers: Vec<Table>| {
        let mut all = Table::new();
        layers.into_iter().for_each(|layer| merge(layer, &mut all));
        assert!(parsed(&all).is_ok(), "{:?}", parsed(&all).err());
        all
    };
    let own = || bare().into_iter().filter(|(key, _)| key != "scene").collect();
    let files = || {
        table(
            "scene = { vehicle = 'own-vehicle.toml', imu = 'own-imu.toml' }
             effects.mag.white_noise.n_ut_per_sqrt_hz = [0.03, 0.03, 0.03]",
        )
    };

    let mut every = table(include_str!("../../sim-host/benches/every_effect.toml"));
    every.remove("include");
    let more = table(
        "scene.place = { latitude_deg = 47.0, longitude_deg = 8.0, altitude_m = 450.0, year = 2026.0 }
         [flight.calibration]
         gyro_rad_s = { bias = [0.01, 0.0, 0.0], matrix = [[1.01, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] }
         accel_m_s2 = { bias = [0.01, 0.0, 0.0], matrix = [[1.01, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] }
         mag_ut.matrix = [[1.01, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]",
    );
    let every = merged(vec![own(), built_in("hover"), every, more, files()]);
    let lag = table("effects.vehicle.motor_lag.tau_s = 0.04");
    let stand = merged(vec![own(), built_in("stand-steps"), lag, files()]);

    // The other ways to say the same of a vehicle.
    let spike = table(
        "fault = [{ kind = 'spike', sensor = 'gyro', axis = 'y', counts = 200, at_s = 6.0, for_s = 1.0 }]",
    );
    let vehicle = |rotors: &str| {
        let mut hover = merged(vec![own(), built_in("hover"), spike.clone(), files()]);
        let rest = "mass_g = 300.0
             cells = 3
             inertia = { hub_g = 190.0, hub_mm = [70.0, 40.0, 45.0] }
             rotors = { full_thrust_g = 320.0, propeller_mm = 76.0, propeller_g = 2.0, lag_ms = 20.0 }";
        let mut file = table(rest);
        merge(table(rotors), &mut file);
        // It takes longer to compute gains than to read a scene.
        file.insert("gains".into(), get(&bare(), &format!("{VEHICLE}.gains")).expect("gains").clone());
        hover.insert(VEHICLE.into(), file.into());
        merged(vec![hover])
    };
    let rpm = vehicle("rotors = { forward_mm = 50.0, right_mm = 55.0, max_rpm = 18000.0 }");
    let kv = vehicle("rotors = { arm_mm = 75.0, kv_rpm_per_v = 3000.0 }");
    vec![every, stand, rpm, kv]
}

// ---------------------------------------------------------------------------------------------------------------------
// What the parser has
// ---------------------------------------------------------------------------------------------------------------------

/// What stands behind a key.
#[derive(Clone, Debug, PartialEq)]
enum Kind {
    Table(Vec<String>),
    Tables(Vec<String>),
    /// A word of these.
    Words(Vec<String>),
    /// In the words of the page.
    Value(String),
}

fn quoted(text: &str) -> Vec<String> {
    text.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

fn unknown() -> Value {
    table("no_such_key = 1").into()
}

/// What the parser says stands at a path of `document`. It is given a table with an unknown key, or arrays of such
/// tables: `lengths` are those of the arrays, from the outside in.
fn kind(document: &Table, path: &str, lengths: &[usize]) -> Kind {
    let value = lengths.iter().rev().fold(unknown(), |inner, length| Value::Array(vec![inner; *length]));
    let stands_there =
        lengths.is_empty() && (path.is_empty() || get(document, path).is_some_and(Value::is_table));
    // What stands there already is needed: `[scene]` without a vehicle says nothing about its keys.
    let at = if stands_there { format!("{path}.no_such_key") } else { path.into() };
    let at = at.trim_start_matches('.');
    let said = match parsed(&with(document, at, value)) {
        Err((said, _)) => said,
        Ok(_) => panic!("`{path}` takes a key that does not exist"),
    };
    let said = said.split(" (did you mean").next().unwrap_or_default();
    let behind = |start: &str| said.split_once(start).map(|(_, rest)| rest);
    if let Some(rest) = behind("unknown field `no_such_key`, ") {
        assert!(rest.starts_with("expected ") || rest == "there are no fields", "{path}: {said}");
        assert!(lengths.is_empty() || lengths == [1], "{path}: arrays of {lengths:?} tables");
        let keys = quoted(rest);
        return if lengths.is_empty() { Kind::Table(keys) } else { Kind::Tables(keys) };
    }
    if let Some(rest) = behind("unknown variant `no_such_key`, expected ").filter(|_| lengths.is_empty()) {
        return Kind::Words(quoted(rest));
    }
    if let Some(expected) = behind("invalid type: map, expected ") {
        let longer = |length| kind(document, path, &[lengths, &[length]].concat());
        let name = match expected {
            "a sequence" => return longer(1),
            "an array of length 3" => return longer(3),
            "f64" => "number",
            "u8" | "u32" | "u64" | "i16" => "integer",
            "a boolean" => "boolean",
            "a string" => "string",
            other => panic!("{path}: a type that this test does not know: {other}"),
        };
        return Kind::Value(match lengths {
            [] => name.into(),
            [1] => format!("{name}s"),
            [3] => format!("3 {name}s"),
            [3, 3] => format!("3 × 3 {name}s"),
            other => panic!("{path}: arrays of {other:?} that this test does not know"),
        });
    }
    match said {
        _ if said.ends_with(": must be a string") => Kind::Value("string".into()),
        _ if said.contains(": must be a number of ") => Kind::Value("number or string".into()),
        _ => panic!("{path}: an answer that this test does not know: {said}"),
    }
}

/// What the parser has below a path: every key that is no table, every table without keys, and which of the tables stand
/// in arrays.
#[derive(Default)]
struct Parser {
    keys: BTreeMap<String, Kind>,
    arrays: BTreeSet<String>,
}

impl Parser {
    fn walk(&mut self, document: &Table, path: &str) {
        let below = |keys: Vec<String>| {
            let dot = if path.is_empty() { "" } else { "." };
            keys.into_iter().map(move |key| format!("{path}{dot}{key}"))
        };
        match kind(document, path, &[]) {
            Kind::Table(keys) if !keys.is_empty() => below(keys).for_each(|path| self.walk(document, &path)),
            Kind::Table(_) => drop(self.keys.insert(path.into(), Kind::Value("table".into()))),
            Kind::Tables(keys) => {
                let document = with(document, path, Value::Array(vec![Table::new().into()]));
                self.arrays.insert(path.into());
                below(keys).for_each(|path| self.walk(&document, &path));
            }
            leaf => drop(self.keys.insert(path.into(), leaf)),
        }
    }

    /// A scene's keys and a preset's, whose effects are those of a scene.
    fn all() -> Self {
        let mut all = Self::default();
        all.walk(&bare(), "");
        all.walk(&bare(), PRESET);
        let effects = format!("{PRESET}.effects");
        let of_preset: BTreeMap<_, _> = all
            .keys
            .iter()
            .filter_map(|(key, kind)| Some((key.strip_prefix(&effects)?, kind.clone())))
            .collect();
        let of_scene: BTreeMap<_, _> = all
            .keys
            .iter()
            .filter_map(|(key, kind)| Some((key.strip_prefix("effects")?, kind.clone())))
            .collect();
        assert_eq!(of_preset, of_scene);
        all.keys.retain(|key, _| !key.starts_with(&effects));
        assert!(all.keys.len() > 200, "only {} keys", all.keys.len());
        all
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// What the page has
// ---------------------------------------------------------------------------------------------------------------------

const HEADER: &str = "| key | type | unit | range | default | meaning |";

/// A key of the page.
#[derive(Clone, Debug)]
struct Row {
    key: String,
    /// Whether the heading has the table in an array.
    in_array: bool,
    type_name: String,
    unit: String,
    range: String,
    default: String,
    meaning: String,
}

/// Every key of the page's tables, by its whole path.
fn rows(page: &str) -> Vec<Row> {
    let mut rows = Vec::new();
    let (mut heading, mut inside) = ("", false);
    for line in page.lines() {
        if let Some(title) = line.strip_prefix("### ") {
            heading = title;
        }
        inside = line == HEADER || inside && line.starts_with('|');
        if !inside || line == HEADER || line.starts_with("|---") {
            continue;
        }
        let table = match heading {
            "At the top" => String::new(),
            "The preset of the sensors" => format!("{PRESET}."),
            _ => format!("{}.", heading.trim_matches(['`', '[', ']'])),
        };
        let cells: Vec<&str> = line.trim_matches('|').split(" | ").map(str::trim).collect();
        let [keys, type_name, unit, range, default, meaning] = cells[..] else {
            panic!("not six cells: {line}");
        };
        for key in quoted(keys) {
            rows.push(Row {
                key: format!("{table}{key}"),
                in_array: heading.starts_with("`[["),
                type_name: type_name.into(),
                unit: unit.into(),
                range: range.into(),
                default: default.into(),
                meaning: meaning.into(),
            });
        }
    }
    rows
}

impl Row {
    /// Its name in the parser's errors.
    fn in_errors(&self) -> &str {
        let file = format!("{PRESET}.");
        self.key.strip_prefix("vehicle.").or_else(|| self.key.strip_prefix(&file)).unwrap_or(&self.key)
    }

    /// Whether an error is about this key: it says so itself, or flight-core does, by its own name for a calibration.
    fn is_in(&self, (said, field): &(String, String)) -> bool {
        let name =
            ["_rad_s.", "_m_s2.", "_ut."].iter().fold(self.key.clone(), |name, unit| name.replace(unit, "."));
        let of_flight_core = name.strip_prefix("flight.").unwrap_or(&name);
        let last = self.key.rsplit('.').next().unwrap_or_default();
        field == self.in_errors()
            || field == "flight"
                && [" =", " ("].iter().any(|end| said.contains(&format!("{of_flight_core}{end}")))
            || said.contains(&format!("`{last}`"))
            // Without a name, but nothing else has changed.
            || said.contains(": invalid value: ")
            || said.contains(": unknown variant ")
            || said.contains(&format!("{last}: must be"))
    }

    /// The words that may stand here.
    fn words(&self) -> Vec<String> {
        quoted(&self.range)
            .iter()
            .filter_map(|word| Some(word.strip_prefix('"')?.strip_suffix('"')?.into()))
            .collect()
    }

    /// The range of a number, without what may stand beside it: from, to, and whether the ends are refused.
    fn ends<'a>(&'a self, clause: &'a str) -> Option<(&'a str, &'a str, bool)> {
        let clause = clause.split(", or ").next().unwrap_or_default();
        match clause.strip_prefix("above ") {
            Some(rest) => rest.split_once(", below ").map(|(low, high)| (low, high, true)),
            None => clause.split_once(" to ").map(|(low, high)| (low, high, false)),
        }
    }

    /// `number` in the type of this key, as its last entry where it is an array.
    fn value(&self, document: &Table, number: f64) -> Value {
        let number: Value = if self.type_name == "integer" { (number as i64).into() } else { number.into() };
        let mut value = match self.type_name.as_str() {
            "integer" | "number" | "number or string" => return number,
            "numbers" => Value::Array(vec![1.0.into()]),
            "3 numbers" => Value::Array(vec![1.0.into(); 3]),
            "3 × 3 numbers" => table("m = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]")["m"].clone(),
            other => panic!("{}: no numbers in a {other}", self.key),
        };
        if let Some(own) = get(document, &self.key) {
            value = own.clone();
        }
        let mut last = &mut value;
        while let Value::Array(entries) = last {
            last = entries.last_mut().expect("an entry");
        }
        *last = number;
        value
    }
}

fn literal(text: &str) -> Value {
    table(&format!("value = {text}"))["value"].clone()
}

fn number(value: &Value) -> f64 {
    value
        .as_float()
        .or_else(|| value.as_integer().map(|n| n as f64))
        .unwrap_or_else(|| panic!("{value} is no number"))
}

/// The value of a key that stands beside, or in the vehicle's file.
fn beside(document: &Table, row: &Row, key: &str) -> Option<Value> {
    if let Some(key) = key.strip_prefix("vehicle.") {
        return get(document, &format!("{VEHICLE}.{key}")).cloned();
    }
    let mut path = row.key.as_str();
    while let Some((parent, _)) = path.rsplit_once('.') {
        let parent_in_file = if parent == "vehicle" { VEHICLE } else { parent };
        if let Some(value) = get(document, &format!("{parent_in_file}.{key}")) {
            return Some(value.clone());
        }
        path = parent;
    }
    None
}

/// An end of a range, as a number in this document.
fn end(document: &Table, row: &Row, text: &str) -> Option<f64> {
    let scene = || parsed(document).ok();
    match text {
        "half the nominal value" => {
            let vehicle = scene()?.vehicle;
            let figure = match row.key.split('.').nth(1)? {
                "mass_kg" => vehicle.mass_kg,
                "inertia_kg_m2" => {
                    <[f64; 3]>::from(vehicle.inertia_kg_m2).into_iter().fold(f64::MAX, f64::min)
                }
                "rotor_inertia_kg_m2" => vehicle.rotor_inertia_kg_m2,
                "arm_m" => vehicle.arm_m(),
                "thrust_coefficient_n_s2" => vehicle.thrust_coefficient,
                "torque_coefficient_n_m_s2" => vehicle.torque_coefficient,
                "motor_lag_tau_s" => {
                    get(document, "effects.vehicle.motor_lag.tau_s").map_or(vehicle.lag_s, number)
                }
                other => panic!("what is the figure of {other}?"),
            };
            Some(0.5 * figure)
        }
        "0.7071 of the hover speed" => Some(std::f64::consts::FRAC_1_SQRT_2 * scene()?.vehicle.hover_rad_s()),
        _ if text.starts_with('`') => {
            let (key, more) = text.trim_start_matches('`').split_once('`')?;
            let more =
                more.strip_prefix(" + ").map_or(0.0, |more| more.parse().expect("a number behind the +"));
            Some(number(&beside(document, row, key)?) + more)
        }
        _ => Some(text.parse().unwrap_or_else(|_| panic!("{}: an end of a range: {text}", row.key))),
    }
}

/// What an error allows: from, to, whether the ends are refused, and the unit.
fn allowed(said: &str) -> Option<(f64, f64, bool, &str)> {
    let inclusive = said.split_once("must be from ").map(|(_, rest)| (rest, " to ", false));
    let (rest, between, exclusive) = inclusive
        .or_else(|| said.split_once("must be above ").map(|(_, rest)| (rest, " and below ", true)))?;
    let (low, rest) = rest.split_once(between)?;
    let (high, unit) = rest.split_once(' ').unwrap_or((rest, ""));
    // Behind a comma, or in brackets, is why.
    Some((
        low.parse().ok()?,
        high.parse().ok()?,
        exclusive,
        unit.split([',', '(']).next().unwrap_or_default(),
    ))
}

fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * a.abs().max(b.abs())
}

// ---------------------------------------------------------------------------------------------------------------------
// The tests
// ---------------------------------------------------------------------------------------------------------------------

#[test]
fn the_page_has_every_key_of_the_parser_and_no_other() {
    let (parser, page) = (Parser::all(), page());
    let rows = rows(&page);
    let mut seen = BTreeSet::new();
    for row in &rows {
        let key = &row.key;
        assert!(seen.insert(key.clone()), "the page has {key} twice");
        let kind = parser.keys.get(key).unwrap_or_else(|| panic!("the parser has no key {key}"));
        let parent = key.rsplit_once('.').map_or("", |(parent, _)| parent);
        assert_eq!(
            row.in_array,
            parser.arrays.contains(parent),
            "the heading of {key} has as many brackets as its table"
        );
        assert!(row.meaning.ends_with('.'), "{key} has no meaning");
        match kind {
            Kind::Words(words) => {
                assert_eq!(row.type_name, "string", "type of {key}");
                assert_eq!(row.words(), *words, "words of {key}");
            }
            Kind::Value(name) => assert_eq!(row.type_name, *name, "type of {key}"),
            Kind::Table(_) | Kind::Tables(_) => unreachable!("a table is no leaf"),
        }
    }
    let missing: Vec<&String> = parser.keys.keys().filter(|key| !seen.contains(*key)).collect();
    assert!(missing.is_empty(), "the page lacks {missing:?}");
}

/// The bases that have the table of a key, or need none to have it.
fn usable<'a>(bases: &'a [Table], row: &Row) -> impl Iterator<Item = &'a Table> {
    let parent = row.key.rsplit_once('.').map(|(parent, _)| match parent.strip_prefix("vehicle") {
        Some(below) => format!("{VEHICLE}{below}"),
        None => parent.into(),
    });
    let needs_none = row.key.starts_with("tolerances.");
    bases
        .iter()
        .filter(move |base| needs_none || parent.as_ref().is_none_or(|parent| get(base, parent).is_some()))
}

/// A value outside a range gets an error with the range of the page, and with its unit. Where the error says it
/// otherwise, the ends of the range are accepted.
#[test]
fn ranges_and_units_are_those_of_the_errors() {
    let (bases, page) = (bases(), page());
    let mut checked = 0;
    for row in rows(&page) {
        if row.type_name.contains("number") || row.type_name == "integer" {
            for clause in row.range.split("; ") {
                check_range(&bases, &row, clause);
                checked += 1;
            }
        }
    }
    assert!(checked > 200, "only {checked} ranges");
}

fn check_range(bases: &[Table], row: &Row, clause: &str) {
    let key = &row.key;
    let errors = |value: &dyn Fn(&Table) -> Option<Value>| -> Vec<(&Table, String)> {
        usable(bases, row)
            .filter_map(|base| {
                let error = parsed(&with(base, key, Some(value(base)?))).err()?;
                row.is_in(&error).then_some((base, error.0))
            })
            .collect()
    };
    if clause == "refused" {
        let refused = errors(&|base| Some(row.value(base, 1.0)));
        assert_eq!(refused.len(), bases.len(), "{key} is not refused");
        return;
    }
    if let Some(count) = clause.strip_suffix(" entries") {
        let (low, high) = count.split_once(" to ").expect("two numbers");
        for count in [low.parse::<usize>().unwrap() - 1, high.parse::<usize>().unwrap() + 1] {
            let said = errors(&|_| Some(Value::Array(vec![1.0.into(); count])));
            assert!(
                !said.is_empty()
                    && said.iter().all(|(_, said)| said.ends_with(&format!("must have {clause}")))
            );
        }
        return;
    }

    let property =
        ["determinant ", "squared length of a row "].into_iter().find(|name| clause.starts_with(name));
    let ends_of = |base: &Table| {
        let clause = clause.strip_prefix(property.unwrap_or_default()).unwrap_or(clause);
        let (low, high, exclusive) =
            row.ends(clause).unwrap_or_else(|| panic!("{key}: not a range: {clause}"));
        Some((end(base, row, low)?, end(base, row, high)?, exclusive))
    };
    for above in [false, true] {
        let outside = |base: &Table| {
            let (low, high, exclusive) = ends_of(base)?;
            let at = if above { high } else { low };
            match property {
                Some("determinant ") => {
                    // Of this matrix it is 4, of s times the matrix 4 s³.
                    let scale = 1.01 * libm::cbrt(high / 4.0) * if above { 1.0 } else { -1.0 };
                    let rows = [[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0]];
                    let row = |row: [f64; 3]| Value::from(row.map(|x| x * scale).to_vec());
                    return Some(Value::from(rows.map(row).to_vec()));
                }
                Some(_) if above => {
                    let long = 1.01 * libm::sqrt(high);
                    return Some(literal(&format!("[[{long}, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]")));
                }
                // No square is below zero.
                Some(_) => return None,
                None => {}
            }
            if row.type_name == "integer" {
                // As it is written: a float of this size is no longer exact.
                let written = if above { clause.rsplit(' ').next() } else { clause.split(' ').next() };
                let at: i64 = written?.parse().expect("an integer");
                // TOML has no larger one.
                return at.checked_add(if above { 1 } else { -1 }).map(Value::from);
            }
            let step = if exclusive {
                0.0
            } else if at == 0.0 {
                1e-6
            } else {
                1e-3 * at.abs()
            };
            Some(row.value(base, if above { at + step } else { at - step }))
        };
        if bases.iter().all(|base| outside(base).is_none()) {
            continue;
        }
        let errors = errors(&outside);
        assert!(!errors.is_empty(), "{key}: a value outside {clause} is not refused");
        for (base, said) in errors {
            let (low, high, exclusive) = ends_of(base).expect("it was outside of them");
            let Some((said_low, said_high, said_exclusive, unit)) = allowed(&said) else {
                let outside = |base: &Table| outside(base).map(|value| parsed(&with(base, key, value)));
                assert!(
                    usable(bases, row).all(|base| outside(base).is_none_or(|answer| answer.is_err())),
                    "{key}: a value outside {clause} is not refused"
                );
                for end in [low, high] {
                    let inside = |base: &Table| parsed(&with(base, key, row.value(base, end))).is_ok();
                    assert!(usable(bases, row).any(inside), "{key} = {end} is refused");
                }
                continue;
            };
            assert!(
                same(low, said_low) && same(high, said_high) && exclusive == said_exclusive,
                "{key}: the page has {clause}, the parser says: {said}"
            );
            if let Some(property) = property {
                assert!(said.contains(property.trim()), "{key}: {said}");
                continue;
            }
            let unit = unit.trim().replace("deg", "°");
            // flight-core has no units in its errors.
            let of_flight_core = said.contains(": flight: ");
            assert!(
                of_flight_core
                    || if unit.is_empty() { row.unit == "–" } else { row.unit == unit }
                    || row.unit.starts_with(&format!("{unit} per ")),
                "{key}: the page has the unit {}, the parser says: {said}",
                row.unit
            );
        }
    }
}

/// Words that are no names of fields: another word gets an error with all of them. `any` takes any word.
#[test]
fn words_are_those_of_the_errors() {
    let (bases, page) = (bases(), page());
    for row in rows(&page) {
        let key = &row.key;
        let answers = |value: Value| -> Vec<_> {
            usable(&bases, &row).map(|base| parsed(&with(base, key, value.clone()))).collect()
        };
        let accepted = |value: Value| answers(value).iter().any(Result::is_ok);
        let refused = |word: &str| {
            let value = if row.type_name == "3 strings" { vec![word; 3].into() } else { word.into() };
            let errors: Vec<_> =
                answers(value).into_iter().filter_map(Result::err).filter(|e| row.is_in(e)).collect();
            let (said, _) = errors.first().unwrap_or_else(|| panic!("{key} takes {word}"));
            said.clone()
        };
        match (row.type_name.as_str(), row.range.as_str()) {
            ("boolean", range) => {
                assert_eq!(range, "any", "{key}");
                assert!(accepted(true.into()) && accepted(false.into()), "{key}");
            }
            ("string", "any") => assert!(accepted("no such word".into()), "{key} does not take any word"),
            ("string", "the letters A, E, T and R in any order") => {
                refused("AETT");
                refused("AETRA");
                assert!(accepted("RETA".into()), "{key}");
            }
            ("number or string", _) => {
                let said = refused("no such word");
                let named: Vec<&str> = said.split('"').skip(1).step_by(2).collect();
                assert_eq!(row.words(), named, "words of {key}");
                assert!(named.iter().all(|word| accepted((*word).into())), "{key}: {said}");
            }
            ("string" | "3 strings", _) if key == "include" => {
                assert!(refused("no such word").contains("is not a built-in scene"));
                assert_eq!(row.words(), BUILT_IN.iter().map(|scene| scene.name).collect::<Vec<_>>());
            }
            ("string" | "3 strings", _) => {
                let said = refused("no such word");
                let list = said.split_once("must be one of ").map(|(_, list)| list.split(", ").collect());
                // Otherwise the parser has named the words as it has named its keys.
                if let Some(list) = list {
                    let list: Vec<&str> = list;
                    assert_eq!(row.words(), list, "{key}");
                } else {
                    assert!(said.contains("unknown variant"), "{key}: {said}");
                }
            }
            _ => {}
        }
    }
}

/// A key that is left out is as one with the default of the page; one that is required is missed.
#[test]
fn defaults_are_what_holds_without_the_key() {
    let (bases, page) = (bases(), page());
    for row in rows(&page) {
        let Row { key, default, .. } = &row;
        let without: Vec<_> = usable(&bases, &row).map(|base| parsed(&with(base, key, None))).collect();
        let name = key.rsplit('.').next().unwrap_or_default();
        let missed = without
            .iter()
            .filter(|answer| answer.as_ref().is_err_and(|(said, _)| said.contains(name)))
            .count();
        if let Some(condition) = default.strip_prefix("required") {
            let all = condition.is_empty();
            assert!(missed > 0 && (!all || missed == without.len()), "{key} is not required: {without:?}");
            if let Some((_, text)) = condition.split_once("else ") {
                check_default(&bases, &row, &|_| Some(literal(text.trim_matches('`'))));
            }
            continue;
        }
        assert!(without.iter().any(Result::is_ok), "{key} cannot be left out: {without:?}");
        match default.as_str() {
            "no included scene" | "does not land" | "the base's" | "not built" | "not drawn" => {}
            "for good" => {
                check_default(&bases, &row, &|_| Some(row.ends(&row.range)?.1.parse::<f64>().ok()?.into()))
            }
            "the hover speed" => {
                check_default(&bases, &row, &|base| Some(parsed(base).ok()?.vehicle.hover_rad_s().into()));
            }
            "the file's" => check_default(&bases, &row, &|base| beside(base, &row, key)),
            _ if default.starts_with("as ") => check_default(&bases, &row, &|base| {
                let value = beside(base, &row, &quoted(default)[0])?;
                Some(if default.ends_with(", in s") { (number(&value) / 1000.0).into() } else { value })
            }),
            _ => check_default(&bases, &row, &|_| Some(literal(default.trim_matches('`')))),
        }
    }
}

/// Leaving the key out and giving it this value is the same, and another value is not: the same scene, or, if that keeps
/// what was said apart from what was not, the same flight.
fn check_default(bases: &[Table], row: &Row, value: &dyn Fn(&Table) -> Option<Value>) {
    let key = &row.key;
    let (mut compared, mut differs) = (0, false);
    for base in usable(bases, row) {
        let Some(value) = value(base) else { continue };
        let (Ok(without), Ok(said)) =
            (parsed(&with(base, key, None)), parsed(&with(base, key, value.clone())))
        else {
            continue;
        };
        let scenes = content(&without) == content(&said);
        assert!(scenes || digest(&without) == digest(&said), "{key}: the default is not {value}");
        let other_differs = |other: Value| {
            parsed(&with(base, key, other)).is_ok_and(|other| {
                if scenes { content(&without) != content(&other) } else { digest(&without) != digest(&other) }
            })
        };
        differs |= others(base, row, &value).into_iter().any(other_differs);
        compared += 1;
    }
    assert!(compared > 0, "{key}: no scene to try its default in");
    assert!(differs, "{key}: no value does anything else than its default");
}

/// Values that are not this one, some of which are in range.
fn others(base: &Table, row: &Row, value: &Value) -> Vec<Value> {
    fn scaled(value: &Value) -> Option<Value> {
        Some(match value {
            Value::Float(number) => (number * 1.01).into(),
            Value::Integer(number) => (number + 1).into(),
            Value::Array(entries) => Value::Array(entries.iter().map(scaled).collect::<Option<_>>()?),
            Value::Boolean(is) => (!is).into(),
            _ => return None,
        })
    }
    let mut others: Vec<Value> = row.words().into_iter().map(Value::from).collect();
    others.extend(["another".into(), "RETA".into(), vec!["left", "forward", "down"].into()]);
    others.extend(get(base, &row.key).cloned());
    others.extend(scaled(value));
    if row.type_name.contains("number") {
        let ends = row.ends(row.range.split("; ").next().unwrap_or_default());
        let ends = ends.into_iter().flat_map(|(low, high, _)| [low, high]);
        others.extend(ends.filter_map(|end| end.parse().ok()).map(|end| row.value(base, end)));
        // A larger share of a row or of an entry.
        others.extend([0.9, 1.1].map(|number| row.value(base, number)));
    }
    others.retain(|other| other != value);
    others
}

/// The fenced blocks of a language.
fn blocks<'a>(page: &'a str, language: &str) -> Vec<&'a str> {
    let fence = format!("```{language}\n");
    page.split(&fence as &str).skip(1).map(|rest| rest.split_once("```").expect("a closed block").0).collect()
}

/// Each TOML block is a scene, or a file that such a scene names.
#[test]
fn examples_are_scenes() {
    let page = page();
    let files: BTreeMap<&str, &str> = blocks(&page, "toml")
        .into_iter()
        .map(|block| (block.strip_prefix("# ").and_then(|b| b.split_once('\n')).expect("a name").0, block))
        .collect();
    assert_eq!(files.len(), blocks(&page, "toml").len(), "two examples of one name");
    let used = std::cell::RefCell::new(BTreeSet::new());
    let read = |path: &Path| {
        let name = path.to_str().unwrap_or_default();
        let (name, text) = files.get_key_value(name).ok_or_else(|| io::Error::other("not on the page"))?;
        used.borrow_mut().insert(*name);
        Ok((*text).to_owned())
    };
    let answers: Vec<_> = files
        .iter()
        .map(|(name, text)| (*name, Scene::parse_with(name, text, &read).map_err(|e| e.to_string())))
        .collect();
    for (name, answer) in &answers {
        assert!(answer.is_ok() || used.borrow().contains(name), "{name}: {:?}", answer.as_ref().err());
    }
    assert!(answers.iter().filter(|(_, answer)| answer.is_ok()).count() >= 4);
}

/// Each line of the block under "Errors" gets the error below it.
#[test]
fn errors_are_as_the_page_has_them() {
    let page = page();
    let (_, section) = page.split_once("\n## Errors\n").expect("the section");
    let block = blocks(section, "text")[0];
    let lines: Vec<&str> = block.lines().collect();
    for pair in lines.chunks(2) {
        let [written, error] = pair else { panic!("a line without its error") };
        let text = format!("include = \"hover\"\n{written}\n");
        let said = Scene::parse("my-scene.toml", &text).expect_err(written).to_string();
        assert_eq!(error.trim(), said);
    }
    assert!(lines.len() >= 10);
}

#[test]
fn paper_page_links_resolve() {
    let page = page();
    // The anchor of a heading: lower case, no punctuation, hyphens for spaces.
    let anchors = |page: &str| -> BTreeSet<String> {
        let titles =
            page.lines().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#').trim());
        let kept = |c: &char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
        titles
            .map(|title| title.to_lowercase().chars().filter(kept).collect::<String>().replace(' ', "-"))
            .collect()
    };
    for (target, _) in page.split("](").skip(1).filter_map(|rest| rest.split_once(')')) {
        let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
        let path = workspace().join("docs").join(if file.is_empty() { "scene.md" } else { file });
        let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{target}: {error}"));
        assert!(anchor.is_empty() || anchors(&text).contains(anchor), "{file} has no heading for #{anchor}");
    }
}
