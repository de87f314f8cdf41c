//! The Earth's magnetic field by the World Magnetic Model, at a place and a date.
//!
//! WMM2025 (NOAA and British Geological Survey) is a spherical harmonic model of degree 12, with its change per year.
//! Its error is about 0.15 µT. The result is rounded to 1e-4 µT, so that a different rounding inside the model would
//! not change a digest.

use flight_core::geometry::{Vec3, vec3};
use world_magnetic_model::GeomagneticField;
use world_magnetic_model::time::Date;
use world_magnetic_model::uom::si::angle::degree;
use world_magnetic_model::uom::si::f32::{Angle, Length};
use world_magnetic_model::uom::si::length::meter;
use world_magnetic_model::uom::si::magnetic_flux_density::nanotesla;

use input::InputError;
use input::check;

/// Place and date of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Geodetic latitude (WGS 84), positive north, deg.
    pub latitude_deg: f64,
    /// Longitude, positive east, deg.
    pub longitude_deg: f64,
    /// Height above the ellipsoid, m.
    pub altitude_m: f64,
    /// Date as a decimal year.
    pub year: f64,
}

impl Place {
    /// Ankara, where the paper was written, in November 2026.
    pub const ANKARA: Self =
        Self { latitude_deg: 39.93, longitude_deg: 32.86, altitude_m: 900.0, year: 2026.9 };

    /// Returns the field at this place and date, north, east, down, µT.
    ///
    /// # Errors
    /// The latitude or longitude is out of range, or the model does not cover the height or the date.
    pub fn field_ut(&self) -> Result<Vec3<f64>, InputError> {
        check::in_range("scene.place.latitude_deg", self.latitude_deg, -90.0, 90.0, "deg")?;
        check::in_range("scene.place.longitude_deg", self.longitude_deg, -180.0, 180.0, "deg")?;
        check::in_range("scene.place.altitude_m", self.altitude_m, -1000.0, 850_000.0, "m")?;
        // WMM2020 applies to the end of 2024, WMM2025 from then to the end of 2029.
        check::in_range("scene.place.year", self.year, 2020.0, 2029.999, "AD")?;
        let model_error = |error: String| InputError::new(error).field("scene.place");
        let field = GeomagneticField::new(
            Length::new::<meter>(self.altitude_m as f32),
            Angle::new::<degree>(self.latitude_deg as f32),
            Angle::new::<degree>(self.longitude_deg as f32),
            self.date().map_err(|error| model_error(error.to_string()))?,
        )
        .map_err(|error| model_error(error.to_string()))?;
        // 0.1 nT is 1e-4 µT.
        let rounded = |value_nt: f32| libm::round(f64::from(value_nt) * 10.0) * 1e-4;
        Ok(vec3(
            rounded(field.x().get::<nanotesla>()),
            rounded(field.y().get::<nanotesla>()),
            rounded(field.z().get::<nanotesla>()),
        ))
    }

    fn date(&self) -> Result<Date, world_magnetic_model::time::error::ComponentRange> {
        let year = libm::floor(self.year);
        // A leap year is treated as 365 days, because the field changes by less than 1e-3 µT per day.
        let day = libm::floor((self.year - year) * 365.0) as u16;
        Date::from_ordinal_date(year as i32, 1 + day.min(364))
    }
}

/// Returns the declination of a field, rad, positive east: the direction of magnetic north.
pub fn declination_rad(field: Vec3<f64>) -> f64 {
    libm::atan2(field.y, field.x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::FIELD_ANKARA_UT;

    #[test]
    fn field_of_ankara_matches_another_implementation() {
        let field = Place::ANKARA.field_ut().unwrap();
        assert!((field - FIELD_ANKARA_UT).norm() < 0.05, "{field:?}");
        assert!((declination_rad(field).to_degrees() - 6.175).abs() < 0.05);
    }

    #[test]
    fn field_of_natick_matches_matlab_documentation() {
        // wrldmagm(1000, 42.283, −71.35, decyear(2028, 7, 4), '2025'): 20,139, −4,905, 46,532 nT.
        let natick =
            Place { latitude_deg: 42.283, longitude_deg: -71.35, altitude_m: 1000.0, year: 2028.505 };
        let field = natick.field_ut().unwrap();
        assert!((field - vec3(20.139, -4.905, 46.532)).norm() < 0.01, "{field:?}");
    }

    #[test]
    fn field_is_rounded_and_places_are_checked() {
        let Vec3 { x, y, z } = Place::ANKARA.field_ut().unwrap();
        for value in [x, y, z] {
            assert!((value * 1e4 - (value * 1e4).round()).abs() < 1e-6);
        }
        for (place, named) in [
            (Place { latitude_deg: 95.0, ..Place::ANKARA }, "scene.place.latitude_deg"),
            (Place { year: 2031.0, ..Place::ANKARA }, "scene.place.year"),
            (Place { altitude_m: f64::NAN, ..Place::ANKARA }, "scene.place.altitude_m"),
        ] {
            assert!(place.field_ut().unwrap_err().to_string().contains(named));
        }
        assert!(Place { year: 2028.9999, ..Place::ANKARA }.field_ut().is_ok());
    }
}
