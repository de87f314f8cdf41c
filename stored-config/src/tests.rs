use std::format;
use std::string::String;
use std::vec::Vec;

use flight_core::calibration::Calibration;
use flight_core::{Config, Params};
use proptest::num::f32::ANY;
use proptest::prelude::*;

use crate::*;

fn record(config: &Config) -> Vec<u8> {
    encode(config, &mut [0; MAX_RECORD]).unwrap().to_vec()
}

fn calibrated() -> Config {
    Config { params: Params::default(), calibration: Some(Calibration::NONE) }
}

/// Returns a record with a right checksum around any content, of any version.
fn sealed(version: u16, content: &[u8]) -> Vec<u8> {
    let length = (content.len() as u16).to_le_bytes();
    let mut record = [&MAGIC[..], &version.to_le_bytes(), &length, content].concat();
    let checksum = CRC.checksum(&record);
    record.extend(checksum.to_le_bytes());
    record
}

#[test]
fn configuration_survives_encoding_and_decoding() {
    for config in [calibrated(), Config { calibration: None, ..calibrated() }] {
        let mut bytes = record(&config);
        assert_eq!(decode(&bytes), Ok(config));
        // The record is followed by erased flash, or by other data.
        bytes.resize(16 * 1024, ERASED);
        assert_eq!(decode(&bytes), Ok(config));
        bytes[MAX_RECORD..].fill(0x5a);
        assert_eq!(decode(&bytes), Ok(config));
    }
}

proptest! {
    /// This includes numbers that the flight controller rejects.
    #[test]
    fn numbers_keep_their_bits(bias in prop::array::uniform3(ANY), throttle in ANY, cutoff in prop::option::of(ANY)) {
        let mut config = calibrated();
        config.calibration.as_mut().unwrap().gyro.bias = bias.into();
        config.params.descent.throttle = throttle;
        config.params.prefilter_cutoff_hz = cutoff;
        let back = decode(&record(&config)).unwrap();
        let bits = |config: &Config| {
            let bias = <[f32; 3]>::from(config.calibration.unwrap().gyro.bias).map(f32::to_bits);
            let Params { descent, prefilter_cutoff_hz, .. } = config.params;
            (bias, descent.throttle.to_bits(), prefilter_cutoff_hz.map(f32::to_bits))
        };
        prop_assert_eq!(bits(&back), bits(&config));
    }

    #[test]
    fn random_bytes_are_refused(bytes in prop::collection::vec(any::<u8>(), 0..1_200)) {
        // The probability of a record is below 2⁻⁶⁴.
        prop_assert!(decode(&bytes).is_err());
    }

    /// The checksum is right, so that the content reaches the decoder.
    #[test]
    fn any_content_with_right_checksum_is_decoded_or_refused(
        content in prop::collection::vec(any::<u8>(), 0..600), version in prop_oneof![Just(VERSION), any::<u16>()],
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
        like_a_record: bool,
    ) {
        let content = if like_a_record {
            let whole = record(&calibrated());
            let mut content = whole[HEADER..whole.len() - TRAILER].to_vec();
            for (at, byte) in changes {
                *at.get_mut(&mut content) = byte;
            }
            content
        } else {
            content
        };
        match decode(&sealed(version, &content)) {
            Err(DecodeError::Version(named)) => prop_assert!(named == version && version != VERSION),
            Err(error) => prop_assert_eq!(error, DecodeError::Content),
            Ok(_) => prop_assert_eq!(version, VERSION),
        }
    }

    #[test]
    fn encoding_fails_only_if_the_buffer_is_too_small(length in 0..MAX_RECORD + 10) {
        let whole = record(&calibrated());
        let mut buffer = std::vec![0; length];
        let encoded = encode(&calibrated(), &mut buffer).map(<[u8]>::to_vec);
        prop_assert_eq!(encoded, if length < whole.len() { Err(EncodeError) } else { Ok(whole) });
    }
}

#[test]
fn truncated_record_is_refused() {
    let whole = record(&calibrated());
    for length in 0..whole.len() {
        assert_eq!(decode(&whole[..length]), Err(DecodeError::Truncated), "{length}");
        // The rest of the flash is erased.
        let mut cut = whole[..length].to_vec();
        cut.resize(MAX_RECORD, ERASED);
        let expected = match length {
            0 => DecodeError::Empty,
            1..4 => DecodeError::Magic,
            // The length is 0xffff, or its lower byte is right and its upper byte is 0xff.
            4..8 => DecodeError::Length,
            _ => DecodeError::Checksum,
        };
        assert_eq!(decode(&cut), Err(expected), "{length}");
    }
}

#[test]
fn record_with_one_flipped_bit_is_refused() {
    let whole = record(&calibrated());
    for bit in 0..8 * whole.len() {
        let mut flipped = whole.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        flipped.resize(MAX_RECORD, ERASED);
        let error = decode(&flipped).unwrap_err();
        let expected: &[DecodeError] = match bit / 8 {
            0..4 => &[DecodeError::Magic],
            6..8 => &[DecodeError::Length, DecodeError::Checksum],
            _ => &[DecodeError::Checksum],
        };
        assert!(expected.contains(&error), "bit {bit}: {error:?}");
    }
}

#[test]
fn errors_name_the_defect_of_a_record() {
    let whole = record(&calibrated());
    let content = &whole[HEADER..whole.len() - TRAILER];
    let longer = [content, &[0]].concat();
    let shorter = &content[..content.len() - 1];
    let mut too_long = whole.clone();
    too_long[6..8].copy_from_slice(&1013_u16.to_le_bytes());
    too_long.resize(MAX_RECORD, 0);
    for (bytes, error, name) in [
        (std::vec![ERASED; MAX_RECORD], DecodeError::Empty, "nothing is stored"),
        (std::vec![0; MAX_RECORD], DecodeError::Magic, "not a record"),
        (std::vec![], DecodeError::Truncated, "truncated"),
        (too_long, DecodeError::Length, "length above the maximum"),
        (sealed(4, content), DecodeError::Version(4), "version 4, must be 3"),
        (sealed(0, &[]), DecodeError::Version(0), "version 0, must be 3"),
        (sealed(3, &[]), DecodeError::Content, "not a configuration"),
        (sealed(3, &longer), DecodeError::Content, "not a configuration"),
        (sealed(3, shorter), DecodeError::Content, "not a configuration"),
    ] {
        assert_eq!(decode(&bytes), Err(error));
        assert_eq!(format!("{error}"), name);
    }
    assert_eq!(decode(&sealed(VERSION, content)), Ok(calibrated()));
    assert_eq!(DecodeError::Version(2).name(), "another version");
}

/// Names of the fields of a record, in order. A change requires a new [`VERSION`].
const FIELDS_OF_VERSION_3: &str = "\
    params imu_rate_hz mag_rate_hz gyro per_count mounting rows x y z x y z x y z accel per_count \
    mounting rows x y z x y z x y z mag per_count mounting rows x y z x y z x y z \
    prefilter_cutoff_hz estimator method kinematics weight tau_s declination_rad airframe \
    thrust_coefficient torque_coefficient forward_m right_m spin inertia_kg_m2 x y z idle_rad_s max_rad_s control \
    max_tilt_rad max_stick_rate_rad_s max_yaw_rate_rad_s max_tilt_rate_rad_s tilt_p heading_p rate_p \
    x y z rate_i x y z rate_d x y z max_integral_rad_s2 x y z begin_throttle esc stop_us full_us channels sticks \
    arm mode arm_by stuck_check gyro accel min_arm_voltage_v critical_voltage_v descent throttle \
    seconds bench max_thrust max_s calibration gyro bias x y z matrix rows x y z x y z x y z accel \
    bias x y z matrix rows x y z x y z x y z mag bias x y z matrix rows x y z x y z x y z";

#[test]
fn changed_fields_require_a_new_version() {
    // The names before the colons of the debug format, which is derived in the order of declaration, like the encoding.
    let text = format!("{:?}", calibrated());
    let names: Vec<&str> = text
        .split(':')
        .map(|before| before.rsplit(|c: char| !(c.is_alphanumeric() || c == '_')).next().unwrap())
        .filter(|name| !name.is_empty())
        .collect();
    let mut fields = String::new();
    for name in names {
        fields += name;
        fields.push(' ');
    }
    assert_eq!(fields.trim_end(), FIELDS_OF_VERSION_3, "changed fields require a new VERSION");
    assert_eq!(record(&calibrated()).len(), 455, "a changed size requires a new VERSION");
}
