//! Scenes as TOML documents that a test changes key by key.

use std::io;
use std::path::Path;

use sim_host::flight::Flight;
use sim_host::scene::{BUILT_IN, Scene};
use test_support::pages::read;
use toml::{Table, Value};

/// Tables of a document that become files of their own: the IMU preset and the vehicle that its scene names.
pub const PRESET: &str = "preset file";
pub const VEHICLE: &str = "vehicle file";

/// Returns the scene of a document, or the parser's error and the key that it names.
pub fn parsed(document: &Table) -> Result<Scene, (String, String)> {
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

/// Returns everything in a scene except its files and its text, for comparison.
pub fn content(scene: &Scene) -> String {
    let mut scene = scene.clone();
    scene.text_hash = 0;
    scene.files.clear();
    format!("{scene:?}")
}

pub fn digest(scene: &Scene) -> u64 {
    Flight::new(scene, scene.seed).run(&mut ()).digest
}

pub fn merge(over: Table, under: &mut Table) {
    for (key, value) in over {
        match (value, under.get_mut(&key)) {
            (Value::Table(over), Some(Value::Table(under))) => merge(over, under),
            (value, _) => drop(under.insert(key, value)),
        }
    }
}

/// Returns the value at a path. In an array of tables, the first table counts.
pub fn get<'a>(document: &'a Table, path: &str) -> Option<&'a Value> {
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

/// Puts a value at a path and creates the tables that lead to it. `None` removes the value.
pub fn put(table: &mut Table, path: &str, value: Option<Value>) {
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

pub fn with(document: &Table, path: &str, value: impl Into<Option<Value>>) -> Table {
    let mut document = document.clone();
    put(&mut document, path, value.into());
    document
}

pub fn table(text: &str) -> Table {
    text.parse().unwrap_or_else(|error| panic!("{error}: {text}"))
}

/// Returns the shortest scene, with a vehicle of its own and a preset without values for effects.
pub fn bare() -> Table {
    let mut bare = table(
        "scene = { duration_s = 1.0, seed = 1, vehicle = 'own-vehicle.toml', imu = 'own-imu.toml' }
         ['preset file']
         gyro.lsb_per_deg_s = 16.4
         accel.lsb_per_g = 2048.0
         mag.lsb_per_gauss = 3000.0",
    );
    let mut vehicle = table(&read("vehicles/os4.toml"));
    // Keys that its file leaves out.
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

/// Returns scenes that together have every key, with values other than the defaults.
pub fn bases() -> Vec<Table> {
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

    let mut every = table(include_str!("../../../sim-host/benches/every_effect.toml"));
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

    // The alternative keys of a vehicle.
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
        // Given, because computing gains takes longer than reading a scene.
        file.insert("gains".into(), get(&bare(), &format!("{VEHICLE}.gains")).expect("gains").clone());
        hover.insert(VEHICLE.into(), file.into());
        merged(vec![hover])
    };
    let rpm = vehicle("rotors = { forward_mm = 50.0, right_mm = 55.0, max_rpm = 18000.0 }");
    let kv = vehicle("rotors = { arm_mm = 75.0, kv_rpm_per_v = 3000.0 }");
    vec![every, stand, rpm, kv]
}
