//! A depth camera as a sensor, beside others of other sizes and mounts.

use crate::sense::sensor::{ChannelType, Moment, Sensor, SensorChannel};
use crate::sense::{Camera, DepthFrame, DepthNoise, DepthPlanes, NoiseKey, SenseError};

/// A depth camera on every drone. Pixels that see nothing within the camera's range have its greatest depth; `status` says why.
#[derive(Clone, Debug)]
pub struct DepthCamera {
    name: String,
    /// (scene, drone)
    cameras: Vec<Vec<Camera>>,
    noise: Option<DepthNoise>,
    /// Whether geoms are told.
    labels: bool,
}

impl DepthCamera {
    /// The camera of each drone in each scene, all of one size. With `labels` it tells the geom of each pixel too.
    ///
    /// # Errors
    /// [`SenseError::Parameter`] without any camera, for sizes that differ, and for noise that makes no sense.
    pub fn new(
        name: impl Into<String>,
        cameras: Vec<Vec<Camera>>,
        noise: Option<DepthNoise>,
        labels: bool,
    ) -> Result<Self, SenseError> {
        let name = name.into();
        if let Some(noise) = &noise {
            noise.check()?;
        }
        let sizes: Vec<_> = cameras.iter().flatten().map(|c| (c.width(), c.height())).collect();
        if sizes.is_empty() || sizes.iter().any(|size| *size != sizes[0]) {
            return Err(SenseError::Parameter {
                what: format!(
                    "{name}: expected cameras of one size for all drones in a scene, got {sizes:?}"
                ),
            });
        }
        Ok(Self { name, cameras, noise, labels })
    }

    /// The camera of each drone in each scene, (scene, drone).
    pub fn cameras(&self) -> &[Vec<Camera>] {
        &self.cameras
    }
}

impl Sensor for DepthCamera {
    fn name(&self) -> &str {
        &self.name
    }

    fn channels(&self) -> Vec<SensorChannel> {
        let camera = &self.cameras[0][0];
        let shape = [camera.height(), camera.width()];
        let mut channels = vec![
            SensorChannel::new("depth", "m", &shape),
            SensorChannel::new("status", "1", &shape).of_type(ChannelType::U8),
        ];
        if self.labels {
            channels.push(SensorChannel::new("geom_id", "1", &shape).of_type(ChannelType::I32));
        }
        channels
    }

    fn sample(&self, at: &mut Moment, _: &mut [f64], out: &mut [&mut [f32]]) -> Result<(), SenseError> {
        let drone = at.drone;
        let camera = at.layout.and_then(|scene| self.cameras.get(scene)?.get(drone));
        let Some(camera) = camera else {
            let what =
                format!("{}: expected a camera for drone {drone} in each scene, found none", self.name);
            return Err(SenseError::Parameter { what });
        };
        let seed = self.noise.is_some().then(|| at.draw.bits());
        let worker = at.scene(&self.name)?;
        let mut frame = DepthFrame::new();
        match (&self.noise, seed) {
            (Some(noise), Some(seed)) => {
                let mut clean = DepthFrame::new();
                camera.render(worker, &mut clean)?;
                let key = NoiseKey { seed, world: 0, drone: 0, step: 0, camera: 0 };
                noise.apply(camera, &clean, key, &mut frame)?;
                out[0].copy_from_slice(&frame.depth_m);
            }
            _ => {
                let n = out[0].len();
                frame.status.resize(n, 0);
                frame.geom_id.resize(n, 0);
                let planes = DepthPlanes {
                    depth_m: Some(&mut *out[0]),
                    status: Some(&mut frame.status),
                    geom_id: self.labels.then_some(&mut frame.geom_id[..]),
                    ..DepthPlanes::default()
                };
                camera.render_into(worker, planes)?;
            }
        }
        camera.fill_unseen(out[0]);
        for (out, status) in out[1].iter_mut().zip(&frame.status) {
            *out = f32::from(*status);
        }
        if self.labels {
            for (out, geom) in out[2].iter_mut().zip(&frame.geom_id) {
                *out = *geom as f32;
            }
        }
        Ok(())
    }
}
