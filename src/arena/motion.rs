//! Obstacles that move by themselves: there and back, or around their places.

use core::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::places::Places;
use super::{Arena, ArenaError};
use crate::math::vec3;
use crate::random::{Key, purpose};
use crate::scalar::lanes::Number;
use crate::scene::{Scene, Worker};
use crate::sense::{Queries, RayHits, RayQuery};

/// Along which way obstacles move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MotionKind {
    /// There and back along a level line, fastest in the middle and slow at the ends.
    #[default]
    Line,
    /// Around their places, level, at one speed.
    Circle,
}

/// How movable obstacles move by themselves. Heading, speed, reach and where on its way an obstacle starts are drawn anew for every
/// world, obstacle and episode. Its height and its orientation stay.
///
/// An obstacle turns before what stands in its way: other things of the scene, and other obstacles where they start, as far as a few rays
/// tell that are cast from it when an episode begins. Drones are not in its way.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ObstacleMotion {
    /// Along which way.
    pub kind: MotionKind,
    /// Least and greatest of what is drawn as the greatest speed on the way, m/s.
    pub speed_m_s: [f64; 2],
    /// Least and greatest of what is drawn as the greatest distance from its place, m.
    pub reach_m: [f64; 2],
    /// Names of the obstacles that move; all where there is none.
    pub names: Vec<String>,
}

impl Default for ObstacleMotion {
    /// All of them, along lines of up to 1.5 m to either side, at 0.3 to 1 m/s.
    fn default() -> Self {
        Self { kind: MotionKind::Line, speed_m_s: [0.3, 1.0], reach_m: [0.5, 1.5], names: Vec::new() }
    }
}

impl ObstacleMotion {
    /// Refuses numbers that make no sense.
    ///
    /// # Errors
    /// [`ArenaError::Option`], naming the field.
    pub fn check(&self) -> Result<(), ArenaError> {
        for (name, [low, high], most) in [
            ("obstacle_motion.speed_m_s", self.speed_m_s, 100.0),
            ("obstacle_motion.reach_m", self.reach_m, 1000.0),
        ] {
            if !(low >= 0.0 && low <= high && high <= most) {
                return Err(ArenaError::option(
                    name,
                    format!("the least and the greatest, from 0 to {most}"),
                    format!("{low} and {high}"),
                ));
            }
        }
        Ok(())
    }

    /// Refuses names that no scene has an obstacle of, and scenes without any obstacle.
    pub(super) fn check_names<'a>(&self, scenes: impl Iterator<Item = &'a Scene>) -> Result<(), ArenaError> {
        let known: Vec<String> = scenes.flat_map(|s| s.obstacles().iter().map(|o| o.name.clone())).collect();
        let odd = self.names.iter().find(|name| !known.contains(name));
        if known.is_empty() || odd.is_some() {
            let mut known: Vec<String> = known.into_iter().map(|name| format!("'{name}'")).collect();
            known.sort();
            known.dedup();
            let expected = match known.is_empty() {
                true => "a scene with movable obstacles: bodies with mocap=\"true\" or a free joint".into(),
                false => format!("names of movable obstacles: {}", known.join(", ")),
            };
            let got = odd.map_or("none in the scene".into(), |name| format!("'{name}'"));
            return Err(ArenaError::option("obstacle_motion.names", expected, got));
        }
        Ok(())
    }

    fn moves(&self, name: &str) -> bool {
        self.names.is_empty() || self.names.iter().any(|n| n == name)
    }
}

/// The way of one obstacle in one episode.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Way {
    /// Where it would stand if it did not move, m.
    place_m: [f64; 3],
    /// From there to the middle of its way, m.
    middle_m: [f64; 3],
    /// Half the way: at the sine and at the cosine of its angle, m.
    sine_m: [f64; 3],
    cosine_m: [f64; 3],
    /// Angle at the start, and what it grows by in a second, rad.
    start_rad: f64,
    rate_rad_s: f64,
}

impl Way {
    /// Where it is, `t_s` after the start of the episode.
    fn at(&self, t_s: f64) -> [f64; 3] {
        let (sine, cosine) = (self.start_rad + self.rate_rad_s * t_s).sin_cos();
        core::array::from_fn(|k| {
            self.place_m[k] + self.middle_m[k] + sine * self.sine_m[k] + cosine * self.cosine_m[k]
        })
    }
}

/// Motion of the obstacles of an arena.
#[derive(Clone, Debug, Default)]
pub(super) struct Motion {
    /// How they move; none: they stand where they were put.
    pub asked: Option<ObstacleMotion>,
    /// The way of each, (world, obstacle); none for one that stands still. Empty while nothing moves.
    pub ways: Vec<Option<Way>>,
}

/// Directions in which the room for a circle is looked at.
const CIRCLE_DIRECTIONS: usize = 16;

/// Distance that is kept from what stands in the way, m.
const MARGIN_M: f64 = 0.05;

/// Reaches below this count as no motion, m.
const LEAST_REACH_M: f64 = 0.01;

/// Where drones are put while the room around an obstacle is looked at: nowhere near.
const FAR_AWAY_M: f64 = 1e8;

/// Rays in each direction: how far to the side of the obstacle's middle each is, in its radii, and how far above it, in its half heights.
const RAYS: [[f64; 2]; 7] =
    [[0.0, 0.0], [-0.7, 0.0], [0.7, 0.0], [-1.0, 0.0], [1.0, 0.0], [0.0, -0.6], [0.0, 0.6]];

/// An upright cylinder about the place of an obstacle that holds its geoms: radius and half height, m.
fn cylinder(scene: &Scene, obstacle: usize, at: [f64; 3], worker: &Worker) -> Result<[f64; 2], ArenaError> {
    let poses = worker.poses()?;
    let (positions, matrices) = (poses.geom_pos_m, poses.geom_mat);
    let mut most = [0.0f64; 3];
    for geom in scene.geoms().iter().filter(|g| scene.bodies()[g.body_id].obstacle == Some(obstacle)) {
        let (r, [cx, cy, cz, hx, hy, hz]) = (matrices[geom.id], geom.aabb_m);
        for (k, most) in most.iter_mut().enumerate() {
            let row = [r[3 * k], r[3 * k + 1], r[3 * k + 2]];
            let middle = positions[geom.id][k] - at[k] + vec3::dot(row, [cx, cy, cz]);
            *most = most.max(middle.abs() + vec3::dot(row.map(f64::abs), [hx, hy, hz]));
        }
    }
    Ok([most[0].hypot(most[1]), most[2]])
}

/// How far an obstacle that stands at `at` can go along each of some level directions before it meets something, m, at most `most_m`.
fn room(
    (scene, worker): (&Scene, &mut Worker),
    (obstacle, at): (usize, [f64; 3]),
    headings_rad: &[f64],
    most_m: f64,
) -> Result<Vec<f64>, ArenaError> {
    let [radius, half_height] = cylinder(scene, obstacle, at, worker)?;
    let (mut origins, mut directions) = (Vec::new(), Vec::new());
    for heading in headings_rad {
        let (s, c) = heading.sin_cos();
        for [side, up] in RAYS {
            // All of them begin on the cylinder, so that what they meet is as far as the obstacle can go.
            let (side, ahead) = (side * radius, radius * (1.0 - side * side).sqrt());
            origins.push([
                at[0] + c * ahead - s * side,
                at[1] + s * ahead + c * side,
                at[2] + up * half_height,
            ]);
            directions.push([c, s, 0.0]);
        }
    }
    let query = RayQuery::default().with_groups([true; 6]).without_body(scene.obstacles()[obstacle].body_id);
    let mut hits = RayHits::default();
    Queries::at(worker).rays(&origins, &directions, &query, &mut hits)?;
    let free =
        |rays: &[f64]| (rays.iter().copied().fold(f64::INFINITY, f64::min) - MARGIN_M).clamp(0.0, most_m);
    Ok(hits.range_m.chunks_exact(RAYS.len()).map(free).collect())
}

/// Draws the way of one obstacle that stands at `at`, in a worker where all obstacles stand at their places. None: it stays there.
fn draw(
    asked: &ObstacleMotion,
    scene_and_worker: (&Scene, &mut Worker),
    (obstacle, at): (usize, [f64; 3]),
    key: Key,
) -> Result<Option<Way>, ArenaError> {
    let mut stream = key.stream();
    let heading = stream.uniform(0.0, TAU);
    let speed = stream.uniform(asked.speed_m_s[0], asked.speed_m_s[1]);
    let reach = stream.uniform(asked.reach_m[0], asked.reach_m[1]);
    let start_rad = stream.uniform(0.0, TAU);
    let mut way = Way { place_m: at, start_rad, ..Way::default() };
    let half = match asked.kind {
        MotionKind::Line => {
            let headings = [heading, heading + 0.5 * TAU];
            let free = room(scene_and_worker, (obstacle, at), &headings, reach)?;
            let (half, middle) = (0.5 * (free[0] + free[1]), 0.5 * (free[0] - free[1]));
            let along = [heading.cos(), heading.sin(), 0.0];
            (way.middle_m, way.sine_m) = (vec3::scale(along, middle), vec3::scale(along, half));
            half
        }
        MotionKind::Circle => {
            let headings: Vec<f64> =
                (0..CIRCLE_DIRECTIONS).map(|k| TAU * k as f64 / CIRCLE_DIRECTIONS as f64).collect();
            let free = room(scene_and_worker, (obstacle, at), &headings, reach)?;
            let radius = free.into_iter().fold(reach, f64::min);
            (way.sine_m, way.cosine_m) = ([0.0, radius, 0.0], [radius, 0.0, 0.0]);
            radius
        }
    };
    if half < LEAST_REACH_M || speed == 0.0 {
        return Ok(None);
    }
    way.rate_rad_s = speed / half;
    Ok(Some(way))
}

impl Motion {
    /// Draws the ways of the obstacles of one world anew, about the places where they stand.
    fn draw_world(
        &mut self,
        places: &Places,
        world: usize,
        key: impl Fn(usize) -> Key,
    ) -> Result<(), ArenaError> {
        let Some(asked) = &self.asked else { return Ok(()) };
        let n = places.n_obstacles;
        let ways = &mut self.ways[world * n..(world + 1) * n];
        ways.fill(None);
        let scene = places.pools[places.layout[world]].scene().clone();
        let mut worker = places.pools[places.layout[world]].lend()?;
        for drone in 0..scene.n_drones() {
            worker.set_drone(drone, [FAR_AWAY_M, drone as f64, 0.0], [0.0, 0.0, 0.0, 1.0])?;
        }
        places.set_obstacles(world, &mut worker)?;
        worker.update()?;
        for (i, obstacle) in scene.obstacles().iter().enumerate().filter(|(_, o)| asked.moves(&o.name)) {
            let at = core::array::from_fn(|k| places.obstacle_pos[3 * (world * n + i) + k]);
            ways[i] = draw(asked, (&scene, &mut worker), (obstacle.index, at), key(i))?;
        }
        Ok(())
    }
}

impl<N: Number> Arena<N> {
    /// How obstacles move by themselves, if they do.
    pub fn obstacle_motion(&self) -> Option<&ObstacleMotion> {
        self.motion.asked.as_ref()
    }

    /// Lets obstacles move by themselves from where they stand, or stand still. Every step moves them, whatever was written into their
    /// arrays before; a reset draws their ways anew, about the same places.
    ///
    /// # Errors
    /// [`ArenaError::NoScene`], [`ArenaError::Option`] for numbers and names that make no sense, [`ArenaError::Scene`] for obstacles whose
    /// poses are not finite.
    pub fn set_obstacle_motion(&mut self, motion: Option<ObstacleMotion>) -> Result<(), ArenaError> {
        let Some(motion) = motion else {
            self.motion = Motion::default();
            return Ok(());
        };
        if !self.has_scene() {
            return Err(ArenaError::NoScene { asked: "moving obstacles" });
        }
        motion.check()?;
        motion.check_names(self.scenes())?;
        let ways = vec![None; self.sim.data.n_worlds * self.places.n_obstacles];
        self.motion = Motion { asked: Some(motion), ways };
        self.begin_motion(None)
    }

    /// Shifts obstacles by up to `jitter_m` from their places in the scene, in x and in y, in all worlds; [`Arena::reset_obstacles`] does
    /// so from here on.
    pub(super) fn shift_obstacles(&mut self, jitter_m: f64) {
        self.jitter_m = jitter_m;
        self.jitter_obstacles(None);
    }

    /// Draws these shifts anew, in worlds whose entry is true or in all.
    pub(super) fn jitter_obstacles(&mut self, worlds: Option<&[bool]>) {
        if self.jitter_m == 0.0 {
            return;
        }
        let (n, most) = (self.places.n_obstacles, self.jitter_m);
        for world in (0..self.sim.data.n_worlds).filter(|w| worlds.is_none_or(|mask| mask[*w])) {
            let Some(scene) = self.places.scene(world).cloned() else { break };
            // Where worlds are made, and where nothing begins anew, it is the first episode.
            let step = worlds.map_or(0, |_| self.sim.data.episodes[world].saturating_sub(1));
            let (seed, number) = self.sim.options().origin(world);
            for (i, obstacle) in scene.obstacles().iter().enumerate() {
                let key = Key { seed, world: number, drone: i as u32, step, purpose: purpose("obstacle") };
                let mut stream = key.stream();
                let shift = [stream.uniform(-most, most), stream.uniform(-most, most), 0.0];
                let at = 3 * (world * n + i);
                self.places.obstacle_pos[at..at + 3].copy_from_slice(&vec3::add(obstacle.pos_m, shift));
            }
        }
    }

    /// Draws the ways of obstacles anew, about the places where they stand, and puts them where these begin: in worlds whose entry is true,
    /// or in all.
    pub(crate) fn begin_motion(&mut self, worlds: Option<&[bool]>) -> Result<(), ArenaError> {
        if self.motion.asked.is_none() {
            return Ok(());
        }
        for world in (0..self.sim.data.n_worlds).filter(|w| worlds.is_none_or(|mask| mask[*w])) {
            let step = self.sim.data.episodes[world].saturating_sub(1);
            let (seed, number) = self.sim.options().origin(world);
            let key = |i: usize| Key {
                seed,
                world: number,
                drone: i as u32,
                step,
                purpose: purpose("obstacle motion"),
            };
            self.motion.draw_world(&self.places, world, key)?;
        }
        self.move_obstacles();
        Ok(())
    }

    /// Puts obstacles that move back to the places about which they do, in worlds whose entry is true or in all.
    pub(super) fn take_obstacles_back(&mut self, worlds: Option<&[bool]>) {
        let n = self.places.n_obstacles;
        for (row, way) in self.motion.ways.iter().enumerate() {
            if let Some(way) = way
                && worlds.is_none_or(|mask| mask[row / n])
            {
                self.places.obstacle_pos[3 * row..3 * row + 3].copy_from_slice(&way.place_m);
            }
        }
    }

    /// Puts obstacles that move where they are at the time of their worlds.
    pub(super) fn move_obstacles(&mut self) {
        let (n, dt) = (self.places.n_obstacles, 1.0 / f64::from(self.sim.options().sim_hz));
        for (row, way) in self.motion.ways.iter().enumerate() {
            if let Some(way) = way {
                let t_s = self.sim.data.steps[row / n] as f64 * dt;
                self.places.obstacle_pos[3 * row..3 * row + 3].copy_from_slice(&way.at(t_s));
            }
        }
    }
}
