//! Noise of depth sensors, as an option. The clean frame is kept; the noisy one is a second frame.
//!
//! Order: flying pixels at depth edges, axial noise, quantisation, range limits, dropout. Errors act along the
//! camera's axis (z-depth); a range image is scaled along its rays accordingly. Draws depend only on the key and the
//! camera number, in the order of pixels.

use serde::{Deserialize, Serialize};

use super::SenseError;
use super::depth::{Camera, DepthFrame, DepthKind, PixelStatus};
use crate::random::{Key, Stream, purpose};

/// A depth sensor's errors. [`Default`] is none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DepthNoise {
    /// Standard deviation of z-depth at `axial_z0_m`, m.
    pub axial_base_m: f64,
    /// Growth of the standard deviation, m per m²: base + this · (z − z0)².
    pub axial_quadratic_per_m: f64,
    /// Depth of the smallest error, m.
    pub axial_z0_m: f64,
    /// Step of z-depth, m; 0 = none.
    pub quantum_m: f64,
    /// Step of 1 / z, 1/m, as sensors have that measure disparity; 0 = none. Disparity step (px) / (focal length (px) ·
    /// baseline (m)).
    pub inverse_quantum_per_m: f64,
    /// Chance that a pixel is lost, 0..=1.
    pub dropout_probability: f64,
    /// Chance that a pixel at a depth edge is a mixture of both sides, 0..=1.
    pub flying_probability: f64,
    /// Least jump of z-depth between neighbours that is an edge, m.
    pub flying_edge_m: f64,
}

/// Which draws a noisy frame takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoiseKey {
    /// Seed of the run.
    pub seed: u64,
    /// World.
    pub world: u64,
    /// Drone.
    pub drone: u32,
    /// Step or frame.
    pub step: u64,
    /// Number of the camera on the drone.
    pub camera: u32,
}

impl DepthNoise {
    /// Microsoft Kinect v1, surfaces seen at up to 60 degrees: σ = 1.2 mm + 1.9 mm/m² · (z − 0.4 m)². (Nguyen, Izadi and
    /// Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and tracking", 3DIMPVT 2012, eq. 2.)
    pub fn kinect_v1() -> Self {
        Self { axial_base_m: 0.0012, axial_quadratic_per_m: 0.0019, axial_z0_m: 0.4, ..Self::default() }
    }

    /// A stereo pair: σ = z² · disparity error / (focal length · baseline), by z = f · b / d.
    pub fn stereo(baseline_m: f64, focal_px: f64, disparity_sigma_px: f64) -> Self {
        Self { axial_quadratic_per_m: disparity_sigma_px / (focal_px * baseline_m), ..Self::default() }
    }

    /// Standard deviation of z-depth at depth `z_m`, m.
    pub fn sigma_m(&self, z_m: f64) -> f64 {
        let d = z_m - self.axial_z0_m;
        self.axial_base_m + self.axial_quadratic_per_m * d * d
    }

    /// Refuses numbers that make no sense.
    ///
    /// # Errors
    /// [`SenseError::Parameter`], naming the field.
    pub fn check(&self) -> Result<(), SenseError> {
        let fields = [
            ("axial_base_m", self.axial_base_m, f64::MAX),
            ("axial_quadratic_per_m", self.axial_quadratic_per_m, f64::MAX),
            ("axial_z0_m", self.axial_z0_m, f64::MAX),
            ("quantum_m", self.quantum_m, f64::MAX),
            ("inverse_quantum_per_m", self.inverse_quantum_per_m, f64::MAX),
            ("dropout_probability", self.dropout_probability, 1.0),
            ("flying_probability", self.flying_probability, 1.0),
            ("flying_edge_m", self.flying_edge_m, f64::MAX),
        ];
        for (name, value, most) in fields {
            if !(value >= 0.0 && value <= most) {
                let range = if most == 1.0 { "between 0 and 1" } else { "finite and not negative" };
                return Err(SenseError::Parameter {
                    what: format!("depth noise: {name} must be {range}, got {value}"),
                });
            }
        }
        Ok(())
    }

    /// A z-depth with axial noise, in the steps of the device.
    fn measured(&self, mut z: f64, draws: &mut Stream) -> f64 {
        if self.axial_base_m > 0.0 || self.axial_quadratic_per_m > 0.0 {
            z += self.sigma_m(z) * draws.normal();
        }
        if self.quantum_m > 0.0 {
            z = (z / self.quantum_m).round() * self.quantum_m;
        }
        if self.inverse_quantum_per_m > 0.0 && z > 0.0 {
            let steps = (1.0 / (z * self.inverse_quantum_per_m)).round();
            z = if steps > 0.0 { 1.0 / (steps * self.inverse_quantum_per_m) } else { f64::INFINITY };
        }
        z
    }

    /// Writes the noisy version of `clean` into `noisy`, whose buffers are reused. `camera` is the one that rendered
    /// `clean`.
    ///
    /// # Errors
    /// [`SenseError::Parameter`] for impossible parameters, [`SenseError::Shape`] when the frame is not the camera's.
    pub fn apply(
        &self,
        camera: &Camera,
        clean: &DepthFrame,
        key: NoiseKey,
        noisy: &mut DepthFrame,
    ) -> Result<(), SenseError> {
        self.check()?;
        let rays = camera.pattern();
        if clean.depth_m.len() != rays.len() || clean.width != camera.width() {
            return Err(SenseError::Shape {
                what: "a frame to add noise to",
                shape: format!("(height {}, width {})", camera.height(), camera.width()),
                expected: rays.len(),
                found: clean.depth_m.len(),
            });
        }
        noisy.clone_from(clean);
        let mut draws = Key {
            seed: key.seed,
            world: key.world,
            drone: key.drone,
            step: key.step,
            purpose: purpose("depth noise") ^ key.camera.wrapping_mul(0x9e37_79b9),
        }
        .stream();
        let cosine = |i: usize| match clean.kind {
            DepthKind::Range => -rays.direction(i)[2],
            DepthKind::ZDepth => 1.0,
        };
        let hit = |i: usize| clean.status[i] == PixelStatus::Hit as u8;
        let (near, far) = camera.range_m();
        let (w, h) = (clean.width, clean.height);
        for i in 0..rays.len() {
            if !hit(i) {
                continue;
            }
            let mut z = f64::from(clean.depth_m[i]) * cosine(i);
            if self.flying_probability > 0.0 && draws.unit() < self.flying_probability {
                let mix = draws.unit();
                let z_of = |k: usize| hit(k).then(|| f64::from(clean.depth_m[k]) * cosine(k));
                let jump = greatest_jump(z, i, (w, h), z_of);
                if jump.abs() > self.flying_edge_m {
                    z += mix * jump;
                }
            }
            z = self.measured(z, &mut draws);
            let value = z / cosine(i);
            let (depth, status) = if value > far || value == f64::INFINITY {
                (f32::INFINITY, PixelStatus::TooFar)
            } else if value < near || value <= 0.0 {
                (0.0, PixelStatus::TooNear)
            } else {
                (value as f32, PixelStatus::Hit)
            };
            noisy.depth_m[i] = depth;
            noisy.status[i] = status as u8;
            if self.dropout_probability > 0.0 && draws.unit() < self.dropout_probability {
                noisy.depth_m[i] = f32::INFINITY;
                noisy.status[i] = PixelStatus::Miss as u8;
                noisy.geom_id[i] = -1;
                noisy.body_id[i] = -1;
                if let Some(normal) = noisy.normal.as_mut() {
                    normal[i] = [0.0; 3];
                }
            }
        }
        Ok(())
    }
}

/// The greatest step from a z-depth to those beside, above and below pixel `i`; `z_of` is none where nothing was hit.
fn greatest_jump(z: f64, i: usize, (w, h): (usize, usize), z_of: impl Fn(usize) -> Option<f64>) -> f64 {
    let (row, col) = (i / w, i % w);
    let mut jump = 0.0;
    for (r, c) in [(row.wrapping_sub(1), col), (row, col.wrapping_sub(1)), (row, col + 1), (row + 1, col)] {
        if r < h
            && c < w
            && let Some(other) = z_of(r * w + c)
            && (other - z).abs() > f64::abs(jump)
        {
            jump = other - z;
        }
    }
    jump
}
