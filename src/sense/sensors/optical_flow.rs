//! Optical flow of the ground below, as sensors for hovering measure it.
//!
//! A camera that looks along the sensor's x axis sees the surface there turn by −v/h where it moves across with v at a distance h, and by
//! its own rate. The sensor gives the angular rate at which the point ahead turns about its axes y and z, with the turning of the drone in it,
//! as flow sensors report it; with the gyroscope's rate added what speed alone makes is left.

use super::lidar::mounted;
use crate::math::{quat, vec3};
use crate::scene::{Pose, checked_pose};
use crate::sense::sensor::{Moment, Sensor, SensorChannel};
use crate::sense::{Queries, RayPattern, RayPlanes, RayQuery, SenseError};

/// An optical-flow sensor with a range finder along the same axis.
#[derive(Clone, Debug)]
pub struct OpticalFlow {
    name: String,
    beam: RayPattern,
    mount: Pose,
    /// Greatest distance at which it sees the surface, m.
    most_m: f64,
    /// Standard deviation of the flow, rad/s.
    sigma_rad_s: f64,
}

impl OpticalFlow {
    /// A sensor that looks along the x axis of its mount in the body.
    ///
    /// # Errors
    /// [`SenseError::Parameter`] for a distance or noise that makes no sense.
    pub fn new(
        name: impl Into<String>,
        mount: Pose,
        most_m: f64,
        sigma_rad_s: f64,
    ) -> Result<Self, SenseError> {
        let name = name.into();
        let whole = |v: f64| v.is_finite() && v >= 0.0;
        if !(whole(most_m) && most_m > 0.0 && whole(sigma_rad_s)) {
            return Err(SenseError::Parameter {
                what: format!(
                    "{name}: expected a greatest distance above 0 m and noise of at least 0 rad/s, got {most_m} and {sigma_rad_s}"
                ),
            });
        }
        let mount = checked_pose(|| name.clone(), mount.pos_m, mount.quat_xyzw)?;
        Ok(Self { beam: RayPattern::new(&[[1.0, 0.0, 0.0]])?, name, mount, most_m, sigma_rad_s })
    }

    /// Looking down from the centre of mass, level with the body: the sensor's x axis is the body's −z, its y axis the body's y, its z axis
    /// the body's x.
    ///
    /// # Errors
    /// As [`OpticalFlow::new`].
    pub fn down(name: impl Into<String>, most_m: f64, sigma_rad_s: f64) -> Result<Self, SenseError> {
        // Turned by 90° about y: the sensor's x axis points along the body's −z.
        let turn = quat::exp([0.0, core::f64::consts::FRAC_PI_2, 0.0]);
        Self::new(name, Pose::new([0.0; 3], turn), most_m, sigma_rad_s)
    }
}

impl Sensor for OpticalFlow {
    fn name(&self) -> &str {
        &self.name
    }

    fn channels(&self) -> Vec<SensorChannel> {
        vec![
            SensorChannel::new("flow", "rad/s", &[2]),
            SensorChannel::new("distance", "m", &[]),
            SensorChannel::new("valid", "1", &[]),
        ]
    }

    fn sample(&self, at: &mut Moment, _: &mut [f64], out: &mut [&mut [f32]]) -> Result<(), SenseError> {
        let (pose, drone) = (mounted(&at.pose, &self.mount), at.drone);
        // Velocity and rate of the sensor, in its own frame.
        let across = vec3::cross(at.ang_vel_rad_s, self.mount.pos_m);
        let vel = vec3::add(at.vel_m_s, quat::rotate(at.pose.quat_xyzw, across));
        let vel = quat::rotate_inverse(pose.quat_xyzw, vel);
        let rate = quat::rotate_inverse(self.mount.quat_xyzw, at.ang_vel_rad_s);
        let worker = at.scene(&self.name)?;
        let query = RayQuery::default().without_drone(worker.scene(), drone)?;
        let mut range = [f32::INFINITY];
        let planes = RayPlanes { range_m: Some(&mut range), ..RayPlanes::default() };
        Queries::at(worker).pattern(&pose, &self.beam, &query, planes)?;
        let distance = f64::from(range[0]);
        let seen = distance < self.most_m && distance > 1e-3;
        out[1][0] = if seen { range[0] } else { self.most_m as f32 };
        out[2][0] = if seen { 1.0 } else { 0.0 };
        // A point ahead at distance h turns about y by v_z/h and about z by −v_y/h, less the sensor's own turning.
        let turned = [vel[2] / distance - rate[1], -vel[1] / distance - rate[2]];
        for k in 0..2 {
            let noise = if self.sigma_rad_s > 0.0 { self.sigma_rad_s * at.draw.normal() } else { 0.0 };
            out[0][k] = if seen { (turned[k] + noise) as f32 } else { 0.0 };
        }
        Ok(())
    }
}
