//! Where on Earth a vehicle is, and what the air and the magnetic field are there.

use world_magnetic_model::GeomagneticField;
use world_magnetic_model::time::Date;
use world_magnetic_model::uom::si::angle::degree;
use world_magnetic_model::uom::si::f32::{Angle, Length};
use world_magnetic_model::uom::si::length::meter;
use world_magnetic_model::uom::si::magnetic_flux_density::gauss;

use crate::ProtocolError;

/// Standard gravity, m/s² (ISO 80000-3).
pub const GRAVITY_M_S2: f64 = 9.806_65;

/// Radius of the sphere on which north and east become degrees, m. It is PX4's (`src/lib/geo/geo.h`), so that its local frame is ours.
pub const RADIUS_M: f64 = 6_371_000.0;

/// Where the vehicle stands at the start.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Home {
    /// Latitude, degrees.
    pub lat_deg: f64,
    /// Longitude, degrees.
    pub lon_deg: f64,
    /// Height above mean sea level, m.
    pub alt_m: f64,
}

impl Default for Home {
    /// The field near Zurich at which PX4's simulations start (`PX4_HOME_LAT` … of its documentation).
    fn default() -> Self {
        Self { lat_deg: 47.397_742, lon_deg: 8.545_594, alt_m: 488.0 }
    }
}

impl Home {
    /// Refuses what is no place on Earth, and the poles, where north has no direction.
    ///
    /// # Errors
    /// [`ProtocolError::Number`].
    pub fn check(&self) -> Result<(), ProtocolError> {
        let fine = self.lat_deg.abs() <= 89.0
            && self.lon_deg.abs() <= 180.0
            && (-1000.0..=20_000.0).contains(&self.alt_m);
        if fine {
            return Ok(());
        }
        Err(ProtocolError::Number {
            name: "home",
            expected: "latitude (-89 to 89°), longitude (-180 to 180°) and height above the sea (-1000 to 20000 m)",
            got: format!("{},{},{}", self.lat_deg, self.lon_deg, self.alt_m),
        })
    }

    /// Latitude, longitude (degrees) and height above the sea (m) of a position from here, m (north, west, up): by the azimuthal
    /// equidistant projection (Snyder, "Map projections: a working manual", USGS 1395, 1987, p. 195), which PX4 and its simulators use.
    pub fn at(&self, pos_m: [f64; 3]) -> [f64; 3] {
        let (north, east) = (pos_m[0] / RADIUS_M, -pos_m[1] / RADIUS_M);
        let c = north.hypot(east);
        let (lat_0, lon_0) = (self.lat_deg.to_radians(), self.lon_deg.to_radians());
        if c == 0.0 {
            return [self.lat_deg, self.lon_deg, self.alt_m + pos_m[2]];
        }
        let lat = (c.cos() * lat_0.sin() + north * c.sin() * lat_0.cos() / c).clamp(-1.0, 1.0).asin();
        let lon = lon_0 + (east * c.sin()).atan2(c * lat_0.cos() * c.cos() - north * lat_0.sin() * c.sin());
        let lon_deg = (lon.to_degrees() + 540.0).rem_euclid(360.0) - 180.0;
        [lat.to_degrees(), lon_deg, self.alt_m + pos_m[2]]
    }

    /// The magnetic field here, gauss, world (north, west, up): the World Magnetic Model 2025 of NOAA and BGS on a day of it.
    ///
    /// # Errors
    /// [`ProtocolError::Number`] for a day that the model does not reach.
    pub fn magnetic_field_gauss(&self, year: i32, day_of_year: u16) -> Result<[f64; 3], ProtocolError> {
        let wrong = |got: String| ProtocolError::Number {
            name: "magnetic field",
            expected: "a day of the World Magnetic Model, 2019 to 2029",
            got,
        };
        let date = Date::from_ordinal_date(year, day_of_year).map_err(|e| wrong(e.to_string()))?;
        let angle = |deg: f64| Angle::new::<degree>(deg as f32);
        let height = Length::new::<meter>(self.alt_m as f32);
        let field = GeomagneticField::new(height, angle(self.lat_deg), angle(self.lon_deg), date)
            .map_err(|e| wrong(format!("{year}, day {day_of_year}: {e}")))?;
        let [north, east, down] = [field.x(), field.y(), field.z()].map(|b| f64::from(b.get::<gauss>()));
        Ok([north, -east, -down])
    }
}

/// Pressure (Pa) and temperature (°C) at a height above the sea, m: the International Standard Atmosphere (ISO 2533), 15 °C and
/// 101325 Pa at sea level, 6.5 K less each kilometre up to 11 km and even from there; the height counts as a geopotential one.
pub fn atmosphere(alt_m: f64) -> (f64, f64) {
    const SEA_K: f64 = 288.15;
    const SEA_PA: f64 = 101_325.0;
    const LAPSE_K_M: f64 = 0.0065;
    const GAS_J_KG_K: f64 = 287.052_87;
    const TOP_M: f64 = 11_000.0;
    let kelvin = SEA_K - LAPSE_K_M * alt_m.min(TOP_M);
    let below = SEA_PA * (kelvin / SEA_K).powf(GRAVITY_M_S2 / (LAPSE_K_M * GAS_J_KG_K));
    let above = (-GRAVITY_M_S2 * (alt_m - TOP_M).max(0.0) / (GAS_J_KG_K * kelvin)).exp();
    (below * above, kelvin - 273.15)
}

/// Height above the sea, m, at which the standard atmosphere has a pressure, Pa, up to 11 km: what a barometer calls its altitude.
pub fn pressure_altitude_m(pressure_pa: f64) -> f64 {
    288.15 / 0.0065 * (1.0 - (pressure_pa / 101_325.0).powf(0.0065 * 287.052_87 / GRAVITY_M_S2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_standard_atmosphere_is_that_of_its_tables() {
        // ISO 2533, table 5: height, pressure, temperature.
        for (alt, pa, celsius) in [
            (0.0, 101_325.0, 15.0),
            (1000.0, 89_874.6, 8.5),
            (5000.0, 54_019.9, -17.5),
            (11_000.0, 22_632.0, -56.5),
            (15_000.0, 12_044.5, -56.5),
        ] {
            let (p, t) = atmosphere(alt);
            assert!((p / pa - 1.0).abs() < 1e-5 && (t - celsius).abs() < 1e-9, "{alt}: {p} {t}");
            if alt <= 11_000.0 {
                assert!((pressure_altitude_m(p) - alt).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn a_metre_is_a_metre_in_degrees() {
        let home = Home::default();
        let [lat, lon, alt] = home.at([1000.0, -2000.0, 30.0]);
        assert!(((lat - home.lat_deg).to_radians() * RADIUS_M - 1000.0).abs() < 1.0);
        let east = (lon - home.lon_deg).to_radians() * RADIUS_M * lat.to_radians().cos();
        assert!((east - 2000.0).abs() < 1.0 && alt == 518.0, "{east}");
        assert_eq!(home.at([0.0; 3]), [home.lat_deg, home.lon_deg, home.alt_m]);
        let date_line = Home { lon_deg: 179.999_999, ..home };
        assert!(date_line.at([0.0, -1000.0, 0.0])[1] < -179.9);
    }

    #[test]
    fn the_field_is_that_of_other_tables_of_the_model() {
        // Declination, inclination (degrees) and strength (gauss) by pymavlink 2.4.50 (`mavextra.get_mag_field_ef`), which interpolates
        // tables of an older epoch every ten degrees: near Zurich, and near Canberra.
        for (lat_deg, lon_deg, expected) in
            [(47.397_742, 8.545_594, [3.19, 63.11, 0.4816]), (-35.36, 149.17, [12.80, -65.76, 0.5800])]
        {
            let home = Home { lat_deg, lon_deg, ..Home::default() };
            let [north, west, up] = home.magnetic_field_gauss(2025, 1).unwrap();
            let level = north.hypot(west);
            let found = [(-west).atan2(north).to_degrees(), (-up).atan2(level).to_degrees(), level.hypot(up)];
            for ((found, expected), off) in found.into_iter().zip(expected).zip([1.0, 1.0, 0.006]) {
                assert!((found - expected).abs() < off, "{found} {expected}");
            }
        }
        assert!(Home::default().magnetic_field_gauss(1960, 1).is_err());
    }

    #[test]
    fn places_that_are_none_are_refused() {
        for home in [
            Home { lat_deg: 90.0, ..Home::default() },
            Home { lon_deg: f64::NAN, ..Home::default() },
            Home { alt_m: 1e6, ..Home::default() },
        ] {
            assert!(home.check().unwrap_err().to_string().contains("latitude"));
        }
        assert_eq!(Home::default().check(), Ok(()));
    }
}
