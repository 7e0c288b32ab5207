//! See as much of some rooms as there is time for, by a depth camera.
//!
//! The floor plan is cut into square cells. A cell is seen when a ray of the camera passes over it between two heights, before it hits
//! something and not farther away than `see_m`.

use serde::{Deserialize, Serialize};

use super::forest_depth::one_of;
use super::{
    ActionKind, CameraConfig, Channel, Course, EnvConfig, EnvError, EpisodeStart, Outcome, SceneConfig,
    Start, Task, TaskDefaults, Weights, WorldView, in_order, in_range, is_within, one_drone, store,
    task_camera, yaw,
};
use crate::math::quat;
use crate::scene::generate::RoomsOptions;
use crate::sense::DepthKind;

/// Options.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RoomExplore {
    /// Corners of the box in which episodes start, m; a site `start…` of the scene, else anywhere in it.
    pub start_m: Option<[[f64; 3]; 2]>,
    /// Corners of the box that is explored and that the drone must not leave, m; the scene, up to 2.3 m above its ground.
    pub space_m: Option<[[f64; 3]; 2]>,
    /// Free distance around starts, m.
    pub free_m: f64,
    /// Edge of a cell, m.
    pub cell_m: f64,
    /// Cells farther away than this are not seen, m.
    pub see_m: f64,
    /// Heights between which a ray sees a cell, m.
    pub band_m: [f64; 2],
    /// Every so many rows and columns of the image are looked at.
    pub stride: usize,
    /// Seeing so much of all cells ends the episode.
    pub enough: f64,
    /// For each square metre that is seen for the first time.
    pub area_reward_per_m2: f64,
    /// Weights of the reward; progress has no meaning here.
    pub weights: Weights,
}

impl Default for RoomExplore {
    fn default() -> Self {
        Self {
            start_m: None,
            space_m: None,
            free_m: 0.3,
            cell_m: 0.25,
            see_m: 4.0,
            band_m: [0.2, 2.2],
            stride: 4,
            enough: 0.95,
            area_reward_per_m2: 0.5,
            weights: Weights { progress: 0.0, ..Weights::default() },
        }
    }
}

/// Cells along each edge of the plan.
const SIDE: usize = 96;
/// Entries along each edge of the map that is observed, and the edge of one, m.
const NEAR: usize = 16;
const NEAR_M: f64 = 0.5;
/// Height of the space where none is given, m.
const CEILING_M: f64 = 2.3;
/// Place of the number of cells seen in the memory; the cells stand before it.
const COUNT: usize = SIDE * SIDE;

/// Cells along both edges that lie in a space.
fn cells(space: [[f64; 3]; 2], cell_m: f64) -> [usize; 2] {
    core::array::from_fn(|k| ((space[1][k] - space[0][k]) / cell_m).ceil().max(1.0) as usize)
}

impl RoomExplore {
    fn space(&self, course: &Course) -> [[f64; 3]; 2] {
        self.space_m.unwrap_or_else(|| {
            let [low, high] = course.extent_m.unwrap_or([[-5.0; 3], [5.0; 3]]);
            [low, [high[0], high[1], high[2].min(low[2] + CEILING_M)]]
        })
    }

    /// Index of the cell under a point, where there is one.
    fn cell(&self, space: [[f64; 3]; 2], x: f64, y: f64) -> Option<usize> {
        let [nx, ny] = cells(space, self.cell_m);
        let (i, j) = ((x - space[0][0]) / self.cell_m, (y - space[0][1]) / self.cell_m);
        let inside = i >= 0.0 && j >= 0.0 && i < nx as f64 && j < ny as f64;
        inside.then_some(j as usize * SIDE + i as usize)
    }

    /// Marks what the images show; returns how many cells were not seen before.
    fn look(&self, view: &WorldView, memory: &mut [f32]) -> usize {
        let Some(images) = &view.images else { return 0 };
        let space = self.space(view.course);
        let mut fresh = 0;
        for (d, (camera, pose)) in images.cameras.iter().zip(images.poses).enumerate() {
            let (w, h) = (camera.width(), camera.height());
            let depth = &images.depth_m[d * w * h..(d + 1) * w * h];
            let pattern = camera.pattern();
            for row in (0..h).step_by(self.stride) {
                for column in (0..w).step_by(self.stride) {
                    let pixel = row * w + column;
                    let along = pattern.direction(pixel);
                    let mut range = f64::from(depth[pixel]);
                    if camera.kind() == DepthKind::ZDepth {
                        range /= -along[2];
                    }
                    let range = range.min(self.see_m);
                    let way = quat::rotate(pose.quat_xyzw, along);
                    let step = 0.5 * self.cell_m;
                    for k in 0..(range / step) as usize {
                        let s = (k as f64 + 0.5) * step;
                        let at: [f64; 3] = core::array::from_fn(|i| pose.pos_m[i] + s * way[i]);
                        if !(self.band_m[0]..=self.band_m[1]).contains(&at[2]) {
                            continue;
                        }
                        if let Some(cell) = self.cell(space, at[0], at[1])
                            && memory[cell] == 0.0
                        {
                            memory[cell] = 1.0;
                            fresh += 1;
                        }
                    }
                }
            }
        }
        memory[COUNT] += fresh as f32;
        fresh
    }
}

impl Task for RoomExplore {
    fn check(&self, config: &EnvConfig) -> Result<(), EnvError> {
        one_drone("room_explore", config)?;
        for (name, space) in [("start_m", self.start_m), ("space_m", self.space_m)] {
            space.map_or(Ok(()), |space| in_order(name, space))?;
        }
        in_range("free_m", self.free_m, 0.0, 100.0)?;
        in_range("cell_m", self.cell_m, 1e-3, 1e3)?;
        in_range("see_m", self.see_m, 1e-3, 1e3)?;
        in_range("stride", self.stride as f64, 1.0, 1e4)?;
        in_range("enough", self.enough, 1e-3, 1.0)?;
        in_range("area_reward_per_m2", self.area_reward_per_m2, 0.0, 1e6)?;
        in_order("band_m", self.band_m.map(|z| [0.0, 0.0, z]))?;
        if !config.with_camera {
            return Err(EnvError::option("with_camera", "true: rooms are explored by seeing them", "false"));
        }
        self.weights.check()
    }

    fn check_course(&self, course: &Course, scene: &str) -> Result<(), EnvError> {
        if self.space_m.is_none() && course.extent_m.is_none() {
            let expected = "space_m of the task for a scene without any geom but planes";
            return Err(EnvError::option("scene", expected, scene));
        }
        let most = SIDE as f64 * self.cell_m;
        let space = self.space(course);
        if cells(space, self.cell_m).iter().any(|n| *n > SIDE) {
            let got = format!("{:.1} m x {:.1} m", space[1][0] - space[0][0], space[1][1] - space[0][1]);
            return Err(EnvError::option(
                "task space_m",
                format!("at most {most} m along x and y for cells of {} m: enlarge cell_m", self.cell_m),
                got,
            ));
        }
        Ok(())
    }

    fn scene(&self) -> (SceneConfig, Option<usize>) {
        (SceneConfig::Rooms(RoomsOptions::default()), Some(8))
    }

    fn camera(&self) -> Option<CameraConfig> {
        Some(task_camera())
    }

    fn defaults(&self) -> TaskDefaults {
        TaskDefaults {
            n_drones: None,
            action: Some(ActionKind::Velocity),
            step_hz: Some(20),
            max_episode_s: Some(40.0),
        }
    }

    fn channels(&self) -> Vec<Channel> {
        vec![Channel::new("vel_heading", 3), Channel::new("seen", 1), Channel::new("near_map", NEAR * NEAR)]
    }

    fn memory_len(&self, _: usize) -> usize {
        COUNT + 1
    }

    fn begin(&self, b: &mut EpisodeStart) -> Result<(), EnvError> {
        let course = b.course;
        let anywhere = || {
            let [low, high] = self.space(course);
            [
                [low[0], low[1], low[2].max(0.0) + 0.8],
                [high[0], high[1], (low[2].max(0.0) + 1.4).min(high[2])],
            ]
        };
        let start = self.start_m.or_else(|| one_of(b, &course.starts)).unwrap_or_else(anywhere);
        b.scatter()?;
        let pos = b.free_place(0, "start", start, self.free_m)?;
        let yaw_rad = b.draw.uniform(-std::f64::consts::PI, std::f64::consts::PI);
        b.starts[0] = Start::at(pos).facing(yaw_rad);
        Ok(())
    }

    fn judge(&self, view: &WorldView, memory: &mut [f32], reward: &mut [f32]) -> Outcome {
        let (seen, w) = (&view.drones[0], &self.weights);
        let space = self.space(view.course);
        let fresh = self.look(view, memory) as f64 * self.cell_m * self.cell_m;
        let mut value = self.area_reward_per_m2 * fresh - w.cost(view, 0);
        let [nx, ny] = cells(space, self.cell_m);
        let outcome = if seen.crashed {
            Outcome::Crashed
        } else if !is_within(seen.pos_m, space) {
            Outcome::Left
        } else if f64::from(memory[COUNT]) >= self.enough * (nx * ny) as f64 {
            Outcome::Done
        } else {
            Outcome::Continue
        };
        value += w.end(outcome);
        reward[0] = value as f32;
        outcome
    }

    fn observe(&self, view: &WorldView, memory: &[f32], drone: usize, out: &mut [f32]) {
        let seen = &view.drones[drone];
        let space = self.space(view.course);
        store(out, &seen.along_heading(seen.vel_m_s));
        let [nx, ny] = cells(space, self.cell_m);
        out[3] = memory[COUNT] / (nx * ny) as f32;
        let (sin, cos) = yaw(seen.quat_xyzw).sin_cos();
        for (k, out) in out[4..].iter_mut().enumerate() {
            // Rows from far ahead to far behind, columns from left to right.
            let ahead = (0.5 * (NEAR - 1) as f64 - (k / NEAR) as f64) * NEAR_M;
            let left = (0.5 * (NEAR - 1) as f64 - (k % NEAR) as f64) * NEAR_M;
            let (x, y) = (seen.pos_m[0] + cos * ahead - sin * left, seen.pos_m[1] + sin * ahead + cos * left);
            *out = self.cell(space, x, y).map_or(1.0, |cell| memory[cell]);
        }
    }
}
