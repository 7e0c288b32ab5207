//! Which way drones fly that follow a pattern, and where they start.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{ArenaError, Look};
use crate::math::{quat, vec3};
use crate::rollout::SimOptions;
use crate::rollout::trajectory::{Spline, Track, Tracks, Trajectory, Waypoint};
use crate::scalar::lanes::Number;
use crate::sense;

/// Which way the drones fly.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlightPattern {
    /// [`Trajectory::lissajous`], drawn for each world and drone.
    Lissajous,
    /// [`Trajectory::circle`], drawn for each world; several drones share it evenly.
    Circle,
    /// Stay 1 m above the origin; several drones in a grid.
    Hover,
    /// Through given points (time s, position m, heading rad); several drones in a grid around them.
    Waypoints(Spline),
    /// Each world or drone through points of its own. A track that names no drone leads several drones in a grid around it.
    Tracks(Tracks),
}

/// Distance between the drones of a grid, m.
const GRID_M: f64 = 0.6;

impl FlightPattern {
    /// Waypoints from CSV ([`Tracks::from_csv`]).
    ///
    /// # Errors
    /// As [`Tracks::from_csv`].
    pub fn from_csv(path: &Path) -> Result<Self, ArenaError> {
        let tracks = Tracks::from_csv(path)?;
        Ok(match tracks.only() {
            Some(spline) => Self::Waypoints(spline.clone()),
            None => Self::Tracks(tracks),
        })
    }

    /// The trajectory of one drone.
    fn trajectory(&self, seed: u64, world: u64, drone: usize, n_drones: usize, attempt: u64) -> Trajectory {
        // A square grid around the centre.
        let side = (n_drones as f64).sqrt().ceil().max(1.0);
        let place = |i: f64| (i - 0.5 * (side - 1.0)) * GRID_M;
        let offset = match n_drones {
            1 => [0.0; 3],
            _ => [place((drone as f64 / side).floor()), place(drone as f64 % side), 0.0],
        };
        match self {
            Self::Lissajous => Trajectory::lissajous(seed, world, drone as u32, attempt),
            Self::Circle => match Trajectory::circle(seed, world, 0, attempt) {
                Trajectory::Circle { center_m, radius_m, phase_rad, rate_rad_s } => Trajectory::Circle {
                    center_m,
                    radius_m,
                    phase_rad: phase_rad + core::f64::consts::TAU * drone as f64 / n_drones as f64,
                    rate_rad_s,
                },
                other => other,
            },
            Self::Hover => Trajectory::Hover { at_m: vec3::add([0.0, 0.0, 1.0], offset) },
            Self::Waypoints(spline) => Trajectory::Waypoints(spline.shifted(offset)),
            Self::Tracks(tracks) => match tracks.of(world, drone) {
                Some(Track { drone: Some(_), points, .. }) => Trajectory::Waypoints(points.clone()),
                Some(track) => Trajectory::Waypoints(track.points.shifted(offset)),
                // Refused by `check`.
                None => Trajectory::Hover { at_m: offset },
            },
        }
    }

    /// Refuses tracks that leave out a drone of a world, or that no drone flies.
    pub(super) fn check(&self, first_world: u64, n_worlds: usize, n_drones: usize) -> Result<(), ArenaError> {
        let Self::Tracks(tracks) = self else { return Ok(()) };
        let worlds = first_world..first_world + n_worlds as u64;
        let odd = tracks.iter().find(|t| {
            t.world.is_some_and(|w| !worlds.contains(&w)) || t.drone.is_some_and(|d| d >= n_drones)
        });
        if let Some(track) = odd {
            let last = worlds.end - 1;
            let expected = format!("tracks of worlds {first_world} to {last} and drones below {n_drones}");
            return Err(ArenaError::option("pattern", expected, track.leads()));
        }
        for world in worlds {
            if let Some(drone) = (0..n_drones).find(|d| tracks.of(world, *d).is_none()) {
                let expected = "a track for every drone of every world";
                return Err(ArenaError::option(
                    "pattern",
                    expected,
                    format!("none for world {world}, drone {drone}"),
                ));
            }
        }
        Ok(())
    }

    /// How far from the origin the drones fly, m, seen from above.
    pub fn reach_m(&self, n_drones: usize) -> f64 {
        let grid = (n_drones as f64).sqrt() * GRID_M;
        match self {
            Self::Lissajous => 2.3,
            Self::Circle => 1.0,
            Self::Hover => grid,
            Self::Waypoints(spline) => far(spline) + grid,
            Self::Tracks(tracks) => tracks.iter().map(|t| far(&t.points)).fold(0.0, f64::max) + grid,
        }
    }
}

/// How far from the origin a path leads, m, seen from above along the axes.
fn far(spline: &Spline) -> f64 {
    let most = |most: f64, (_, p, _): &Waypoint| most.max(p[0].abs()).max(p[1].abs());
    spline.points().iter().fold(0.0, most)
}

/// Clearance that drawn trajectories leave at the start, m.
const START_CLEARANCE_M: f64 = 0.15;

/// Draws of a trajectory before the best of them is taken as it is.
const START_ATTEMPTS: u64 = 64;

/// Trajectories of all drones of a world: the first draw that starts with [`START_CLEARANCE_M`] around every drone. Where no draw
/// does, what comes nearest to it; where nothing is drawn or there is no scene, the first.
pub(super) fn free_start<N: Number>(
    pattern: &FlightPattern,
    look: &Look<'_, N>,
    options: &SimOptions,
    world: usize,
    n: usize,
) -> Result<Vec<Trajectory>, ArenaError> {
    let (seed, number) = options.origin(world);
    let draw = |attempt| -> Vec<Trajectory> {
        (0..n).map(|d| pattern.trajectory(seed, number, d, n, attempt)).collect()
    };
    let drawn = matches!(pattern, FlightPattern::Lissajous | FlightPattern::Circle);
    if !drawn || look.layout(world).is_none() {
        return Ok(draw(0));
    }
    let mut worker = look.surroundings(world)?;
    let mut best = (Vec::new(), f64::NEG_INFINITY);
    for attempt in 0..START_ATTEMPTS {
        let trajectories = draw(attempt);
        for (d, trajectory) in trajectories.iter().enumerate() {
            let start = trajectory.at(0.0);
            worker.set_drone(d, start.pos_m, quat::exp([0.0, 0.0, start.yaw_rad]))?;
        }
        worker.update()?;
        let mut least = f64::INFINITY;
        for d in 0..n {
            least = least.min(sense::Queries::at(&mut worker).clearance(d, START_CLEARANCE_M)?.distance_m);
        }
        if least > best.1 {
            best = (trajectories, least);
        }
        if best.1 >= START_CLEARANCE_M {
            break;
        }
    }
    Ok(best.0)
}
