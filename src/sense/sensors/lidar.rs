//! Ranges along rays: a LiDAR with rings, a row of range finders, a single beam.

use crate::math::{quat, vec3};
use crate::scene::{Pose, checked_pose};
use crate::sense::sensor::{Moment, Sensor, SensorChannel};
use crate::sense::{Queries, RayPattern, RayPlanes, RayQuery, SenseError};

/// Ranges along rays in the body of the drone. Beyond `most_m`, and where nothing is met, it reads `most_m`.
#[derive(Clone, Debug)]
pub struct Lidar {
    name: String,
    shape: Vec<usize>,
    pattern: RayPattern,
    mount: Pose,
    /// Greatest range, m.
    most_m: f64,
    /// Standard deviation of a range, m.
    sigma_m: f64,
}

impl Lidar {
    /// Rays in these directions of the sensor's frame, of any length but zero; ranges have `shape`, which has as many numbers as there are
    /// rays. `mount` is where the sensor sits in the body, and how it is turned.
    ///
    /// # Errors
    /// [`SenseError::Parameter`] for directions, shapes, ranges and noise that make no sense.
    pub fn new(
        name: impl Into<String>,
        directions: &[[f64; 3]],
        shape: &[usize],
        mount: Pose,
        (most_m, sigma_m): (f64, f64),
    ) -> Result<Self, SenseError> {
        let name = name.into();
        let refused = |what: String| Err(SenseError::Parameter { what: format!("{name}: {what}") });
        if directions.is_empty() || shape.iter().product::<usize>() != directions.len() {
            return refused(format!(
                "expected a shape of {} numbers, one for each ray, got {shape:?}",
                directions.len()
            ));
        }
        if !(most_m > 0.0 && most_m.is_finite()) {
            return refused(format!("expected a greatest range above 0 m, got {most_m}"));
        }
        if !(sigma_m >= 0.0 && sigma_m.is_finite()) {
            return refused(format!("expected noise of at least 0 m, got {sigma_m}"));
        }
        let mount = checked_pose(|| name.clone(), mount.pos_m, mount.quat_xyzw)?;
        Ok(Self { pattern: RayPattern::new(directions)?, name, shape: shape.into(), mount, most_m, sigma_m })
    }

    /// `rings` rings of `columns` rays all around, forward first and then to the left; elevations run evenly from `elevation_rad[0]` to
    /// `elevation_rad[1]` above the horizon of the sensor. Ranges have the shape (rings, columns).
    ///
    /// # Errors
    /// As [`Lidar::new`].
    pub fn rings(
        name: impl Into<String>,
        (rings, columns): (usize, usize),
        elevation_rad: [f64; 2],
        mount: Pose,
        range: (f64, f64),
    ) -> Result<Self, SenseError> {
        let [low, high] = elevation_rad;
        let quarter = core::f64::consts::FRAC_PI_2;
        if !(rings > 0 && columns > 0 && -quarter <= low && low <= high && high <= quarter) {
            let name = name.into();
            return Err(SenseError::Parameter {
                what: format!(
                    "{name}: expected at least one ring and one column, and elevations that rise within ±π/2, got {rings} rings, \
                     {columns} columns and {elevation_rad:?} rad"
                ),
            });
        }
        let mut directions = Vec::with_capacity(rings * columns);
        for ring in 0..rings {
            let share = if rings > 1 { ring as f64 / (rings - 1) as f64 } else { 0.5 };
            let (up, flat) = (low + share * (high - low)).sin_cos();
            for column in 0..columns {
                let (y, x) = (core::f64::consts::TAU * column as f64 / columns as f64).sin_cos();
                directions.push([flat * x, flat * y, up]);
            }
        }
        Self::new(name, &directions, &[rings, columns], mount, range)
    }

    /// One beam along the sensor's x axis; its range is one number.
    ///
    /// # Errors
    /// As [`Lidar::new`].
    pub fn beam(name: impl Into<String>, mount: Pose, range: (f64, f64)) -> Result<Self, SenseError> {
        Self::new(name, &[[1.0, 0.0, 0.0]], &[], mount, range)
    }
}

/// Where something that is mounted on a body is in the world.
pub(super) fn mounted(body: &Pose, mount: &Pose) -> Pose {
    let pos = vec3::add(body.pos_m, quat::rotate(body.quat_xyzw, mount.pos_m));
    Pose::new(pos, quat::normalize(quat::mul(body.quat_xyzw, mount.quat_xyzw)))
}

impl Sensor for Lidar {
    fn name(&self) -> &str {
        &self.name
    }

    fn channels(&self) -> Vec<SensorChannel> {
        vec![SensorChannel::new("range", "m", &self.shape)]
    }

    fn sample(&self, at: &mut Moment, _: &mut [f64], out: &mut [&mut [f32]]) -> Result<(), SenseError> {
        let (pose, drone) = (mounted(&at.pose, &self.mount), at.drone);
        let worker = at.scene(&self.name)?;
        let query = RayQuery::default().without_drone(worker.scene(), drone)?;
        let planes = RayPlanes { range_m: Some(&mut *out[0]), ..RayPlanes::default() };
        Queries::at(worker).pattern(&pose, &self.pattern, &query, planes)?;
        for range in out[0].iter_mut() {
            let truth = f64::from(*range);
            let noise = if self.sigma_m > 0.0 { self.sigma_m * at.draw.normal() } else { 0.0 };
            *range = if truth < self.most_m {
                (truth + noise).clamp(0.0, self.most_m) as f32
            } else {
                self.most_m as f32
            };
        }
        Ok(())
    }
}
