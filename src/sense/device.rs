//! Depth sensors by name: lens, size, range and noise as their makers publish them.
//!
//! What a data sheet leaves open is our choice and marked so. A device is a starting point: every number can be replaced.

use super::depth::{DepthKind, Lens};
use super::noise::DepthNoise;

/// A depth sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthDevice {
    /// Name.
    pub name: &'static str,
    /// Width and height, pixels.
    pub size: [usize; 2],
    /// Vertical field of view, degrees; pixels are square.
    pub fovy_deg: f64,
    /// Least and greatest depth, m.
    pub range_m: [f64; 2],
    /// What its pixels state.
    pub kind: DepthKind,
    /// Errors.
    pub noise: DepthNoise,
    /// Images per second.
    pub rate_hz: f64,
    /// Where the numbers are from.
    pub source: &'static str,
}

const NONE: DepthNoise = DepthNoise {
    axial_base_m: 0.0,
    axial_quadratic_per_m: 0.0,
    axial_z0_m: 0.0,
    quantum_m: 0.0,
    inverse_quantum_per_m: 0.0,
    dropout_probability: 0.0,
    flying_probability: 0.0,
    flying_edge_m: 0.0,
};

/// The devices that are known.
pub const DEVICES: &[DepthDevice] = &[
    DepthDevice {
        name: "ideal",
        size: [64, 64],
        fovy_deg: 70.0,
        range_m: [0.02, 10.0],
        kind: DepthKind::ZDepth,
        noise: NONE,
        rate_hz: 50.0,
        source: "our choice: no errors",
    },
    DepthDevice {
        name: "vl53l5cx",
        size: [8, 8],
        fovy_deg: 45.0,
        range_m: [0.02, 4.0],
        kind: DepthKind::Range,
        noise: DepthNoise { axial_base_m: 0.01, axial_quadratic_per_m: 0.004, quantum_m: 0.001, ..NONE },
        rate_hz: 15.0,
        source: "STMicroelectronics VL53L5CX data sheet DS13754: 8 x 8 zones over 45 x 45 degrees at 15 Hz, up to 4 m, whole \
                 millimetres; sigma is our choice within its ranging accuracy",
    },
    DepthDevice {
        name: "kinect_v1",
        size: [80, 60],
        fovy_deg: 43.0,
        range_m: [0.4, 4.0],
        kind: DepthKind::ZDepth,
        noise: DepthNoise { axial_base_m: 0.0012, axial_quadratic_per_m: 0.0019, axial_z0_m: 0.4, ..NONE },
        rate_hz: 30.0,
        source: "Nguyen, Izadi and Lovell, 3DIMPVT 2012, eq. 2 (sigma); 57 x 43 degrees; an eighth of its 640 x 480 pixels",
    },
    DepthDevice {
        name: "d435",
        size: [106, 60],
        fovy_deg: 58.0,
        range_m: [0.28, 10.0],
        kind: DepthKind::ZDepth,
        // An eighth of 848 x 480 pixels: f = 240 px / tan(29 degrees) = 433 px of the full image, baseline 50 mm, disparity error
        // 0.08 px, disparity steps of 1/32 px.
        noise: DepthNoise {
            axial_quadratic_per_m: 0.08 / (433.0 * 0.05),
            inverse_quantum_per_m: 1.0 / (32.0 * 433.0 * 0.05),
            flying_probability: 0.3,
            flying_edge_m: 0.2,
            dropout_probability: 0.005,
            ..NONE
        },
        rate_hz: 30.0,
        source: "Intel RealSense D400 series data sheet 337029: 87 x 58 degrees, baseline 50 mm, least depth 0.28 m; disparity \
                 error, edges and dropout are our choice",
    },
];

impl DepthDevice {
    /// The device called `name`, or the names that there are.
    ///
    /// # Errors
    /// The names of all devices.
    pub fn named(name: &str) -> Result<&'static Self, String> {
        DEVICES
            .iter()
            .find(|d| d.name == name)
            .ok_or_else(|| DEVICES.iter().map(|d| d.name).collect::<Vec<_>>().join(", "))
    }

    /// Its lens.
    pub fn lens(&self) -> Lens {
        Lens::Fovy { fovy_deg: self.fovy_deg }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_have_names_of_their_own_and_numbers_that_make_sense() {
        for (i, d) in DEVICES.iter().enumerate() {
            assert_eq!(DepthDevice::named(d.name), Ok(&DEVICES[i]));
            d.noise.check().unwrap();
            assert!(d.range_m[0] < d.range_m[1] && d.fovy_deg < 180.0 && d.rate_hz > 0.0, "{}", d.name);
        }
        let known = DepthDevice::named("d436").unwrap_err();
        assert!(known.contains("d435") && known.contains("vl53l5cx"), "{known}");
    }

    #[test]
    fn a_stereo_pair_errs_as_its_baseline_says() {
        let d = DepthDevice::named("d435").unwrap();
        let stereo = DepthNoise::stereo(0.05, 433.0, 0.08);
        assert!((d.noise.sigma_m(3.0) - stereo.sigma_m(3.0)).abs() < 1e-15);
        // Under 2 % at 2 m, as the data sheet says of the depth.
        assert!(d.noise.sigma_m(2.0) < 0.02 * 2.0);
    }
}
