//! What one world sees and touches after a step.

use std::sync::{Mutex, PoisonError};

use super::EnvError;
use super::layouts::Layout;
use crate::scene::{Pose, Worker};
use crate::sense::{DepthFrame, DepthNoise, DepthPlanes, NoiseKey, Queries, Sweep};

/// A drone between two looks at it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Flown {
    /// Where it was at the last look.
    pub before: Pose,
    /// Where it is.
    pub now: Pose,
    /// Distance to the nearest thing at the last look, m.
    pub clearance_m: f64,
    /// It touched something since.
    pub crashed: bool,
}

/// Looks at all drones of a world, which stand in `worker` where they are now: clearances, and whether they touched something on their
/// way. `fresh`: they did not fly here, so that there is no way.
pub(super) fn update_collisions(
    worker: &mut Worker,
    drones: &mut [Flown],
    look_m: f64,
    fresh: bool,
) -> Result<(), EnvError> {
    for d in 0..drones.len() {
        let known = drones[d].clearance_m;
        let now = Queries::at(worker).clearance(d, look_m)?.distance_m;
        drones[d].clearance_m = now;
        drones[d].crashed = now <= 0.0;
        let (from, to) = (drones[d].before, drones[d].now);
        if fresh || drones[d].crashed || way(from, to) < known.min(now).max(0.0) {
            continue;
        }
        // It flew farther than it was free: it may have flown through something.
        drones[d].crashed = Queries::at(worker).swept(&Sweep::new(d, from, to).of_scene())?.is_some();
    }
    if fresh {
        return Ok(());
    }
    for d in 0..drones.len() {
        for other in d + 1..drones.len() {
            if drones[d].crashed && drones[other].crashed {
                continue;
            }
            let (a, b) = (drones[d], drones[other]);
            if Queries::at(worker).swept(&Sweep::new(d, a.before, a.now).of_drone(other, b.before))?.is_some()
            {
                drones[d].crashed = true;
                drones[other].crashed = true;
            }
        }
    }
    Ok(())
}

/// Length of a way, m.
fn way(from: Pose, to: Pose) -> f64 {
    let square: f64 = (0..3).map(|k| (to.pos_m[k] - from.pos_m[k]).powi(2)).sum();
    square.sqrt()
}

/// Errors of the depth sensor, and frames to work with.
#[derive(Debug, Default)]
pub(super) struct NoisySensor {
    pub noise: DepthNoise,
    free: Mutex<Vec<[DepthFrame; 2]>>,
}

impl NoisySensor {
    pub fn new(noise: DepthNoise) -> Self {
        Self { noise, free: Mutex::default() }
    }
}

/// The noise with all deviations and chances multiplied.
fn scaled(noise: DepthNoise, factor: f64) -> DepthNoise {
    DepthNoise {
        axial_base_m: noise.axial_base_m * factor,
        axial_quadratic_per_m: noise.axial_quadratic_per_m * factor,
        dropout_probability: (noise.dropout_probability * factor).min(1.0),
        flying_probability: (noise.flying_probability * factor).min(1.0),
        ..noise
    }
}

/// Renders the cameras of a world, (drone, height, width): into `clean`, and with noise into `noisy` where there is a sensor that errs.
/// Where nothing is seen stands the greatest depth of the camera.
pub(super) fn render_depth(
    layout: &Layout,
    worker: &mut Worker,
    poses: &mut [Pose],
    clean: &mut [f32],
    noisy: Option<(&NoisySensor, f64, NoiseKey, &mut [f32])>,
) -> Result<(), EnvError> {
    let n = clean.len() / layout.cameras.len().max(1);
    let Some((sensor, factor, key, noisy)) = noisy else {
        for (d, (camera, out)) in layout.cameras.iter().zip(clean.chunks_exact_mut(n)).enumerate() {
            let planes = DepthPlanes { depth_m: Some(out), ..DepthPlanes::default() };
            poses[d] = camera.render_into(worker, planes)?;
            camera.fill_unseen(out);
        }
        return Ok(());
    };
    let noise = scaled(sensor.noise, factor);
    let lent = sensor.free.lock().unwrap_or_else(PoisonError::into_inner).pop();
    let mut frames = lent.unwrap_or_default();
    let [frame, other] = &mut frames;
    let images = clean.chunks_exact_mut(n).zip(noisy.chunks_exact_mut(n));
    for (d, (camera, (clean, noisy))) in layout.cameras.iter().zip(images).enumerate() {
        camera.render(worker, frame)?;
        poses[d] = Pose { pos_m: frame.pos_m, quat_xyzw: frame.quat_xyzw };
        noise.apply(camera, frame, NoiseKey { drone: d as u32, ..key }, other)?;
        clean.copy_from_slice(&frame.depth_m);
        camera.fill_unseen(clean);
        noisy.copy_from_slice(&other.depth_m);
        camera.fill_unseen(noisy);
    }
    sensor.free.lock().unwrap_or_else(PoisonError::into_inner).push(frames);
    Ok(())
}
