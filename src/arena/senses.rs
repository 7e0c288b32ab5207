//! What drones of an arena see, touch and come near to.

use rayon::prelude::*;

use super::{Arena, ArenaError, Look, check_worlds};
use crate::math::{quat, vec3};
use crate::scalar::lanes::Number;
use crate::scene::Pose;
use crate::sense::{
    Camera, Clearance, Contact, DepthBatch, DepthPlanes, Queries, SenseError, Sweep, SweptHit, Worlds,
};

/// What a drone touched on its way, first things first: of the scene, or another drone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Way {
    /// World.
    pub world: usize,
    /// Drone.
    pub drone: usize,
    /// Where and what.
    pub hit: SweptHit,
}

impl<'a, N: Number> Look<'a, N> {
    /// The worlds of the list as they are now, or all, where there is a scene.
    fn at<'b>(&'b self, asked: &'static str, worlds: Option<&'b [usize]>) -> Result<Look<'b, N>, ArenaError> {
        if self.places.pools.is_empty() {
            return Err(ArenaError::NoScene { asked });
        }
        check_worlds(worlds, self.data.n_worlds)?;
        // The arrays are open to the caller.
        let (pos, quat) = (self.data.pos.len(), self.data.quat.len());
        let rows = self.data.n_worlds * self.data.n_drones;
        if (pos, quat) != (3 * rows, 4 * rows) {
            let expected = format!("{} and {} numbers", 3 * rows, 4 * rows);
            return Err(ArenaError::option("pos and quat", expected, format!("{pos} and {quat}")));
        }
        Ok(Look { worlds, ..*self })
    }

    /// Renders depth in the worlds of the list, or in all, in parallel. `cameras`: those of each scene, by its number, as many and of
    /// one size in all; `planes` and `poses` as in [`Worlds::render`], worlds in the order of the
    /// list.
    ///
    /// # Errors
    /// [`ArenaError::NoScene`], [`ArenaError::Option`] for worlds that there are not and lists of another length,
    /// [`ArenaError::Sense`] as there, by places in the list.
    pub fn render(
        &self,
        cameras: &[&[Camera]],
        worlds: Option<&[usize]>,
        planes: DepthPlanes,
        poses: &mut [Pose],
    ) -> Result<(), ArenaError> {
        let look = self.at("rendering", worlds)?;
        if cameras.len() != self.places.pools.len() {
            let expected = format!("a list for each of {} scenes", self.places.pools.len());
            return Err(ArenaError::option("cameras", expected, cameras.len()));
        }
        let layout = &self.places.layout;
        let of = |k: usize| cameras[layout[look.number(k)]];
        Ok(look.but_quarantined(Worlds::render(&look, &of, planes, poses))?)
    }

    /// As [`Look::render`], all planes but normals, into buffers that grow as needed.
    ///
    /// # Errors
    /// As [`Look::render`].
    pub fn frames(
        &self,
        cameras: &[&[Camera]],
        worlds: Option<&[usize]>,
        out: &mut DepthBatch,
    ) -> Result<(), ArenaError> {
        let n_worlds = worlds.map_or(self.data.n_worlds, <[usize]>::len);
        let (planes, poses) = out.fit(cameras.first().copied().unwrap_or_default(), n_worlds)?;
        self.render(cameras, worlds, planes, poses)
    }

    /// All contacts of drones in the worlds of the list, or in all, one list for each; see
    /// [`Worlds::contacts`].
    ///
    /// # Errors
    /// [`ArenaError::NoScene`], [`ArenaError::Option`], [`ArenaError::Sense`] by places in the list, quarantined worlds left out.
    pub fn contacts(
        &self,
        worlds: Option<&[usize]>,
        out: &mut Vec<Vec<Contact>>,
        limited: &mut Vec<usize>,
    ) -> Result<(), ArenaError> {
        let look = self.at("looking for contacts", worlds)?;
        Ok(look.but_quarantined(Worlds::contacts(&look, out, limited))?)
    }

    /// Distance of every drone to the nearest thing in the worlds of the list, or in all, (world, drone), up to `max_distance_m`; see
    /// [`Worlds::clearances`].
    ///
    /// # Errors
    /// [`ArenaError::NoScene`], [`ArenaError::Option`], [`ArenaError::Sense`] by places in the list, quarantined worlds left out.
    pub fn clearances(
        &self,
        worlds: Option<&[usize]>,
        max_distance_m: f64,
        out: &mut Vec<Clearance>,
    ) -> Result<(), ArenaError> {
        let look = self.at("looking for clearances", worlds)?;
        Ok(look.but_quarantined(Worlds::clearances(&look, max_distance_m, out))?)
    }

    /// Where all drones are, (world, drone): what [`Look::swept`] is asked with after some steps.
    pub fn poses(&self) -> Vec<Pose> {
        let (look, data) = (self, self.data);
        (0..data.n_worlds * data.n_drones)
            .map(|row| look.pose(row / data.n_drones, row % data.n_drones))
            .collect()
    }

    /// What drones touched first on their straight way from `before` (world, drone) to where they are now, in the worlds of the
    /// list or in all: at most one entry for each drone, in the order of worlds. Two drones that met both have one.
    ///
    /// # Errors
    /// [`ArenaError::NoScene`], [`ArenaError::Option`] for poses of another number, [`ArenaError::Sense`] by places in the list, quarantined worlds left out.
    pub fn swept(&self, before: &[Pose], worlds: Option<&[usize]>) -> Result<Vec<Way>, ArenaError> {
        let look = self.at("swept checks", worlds)?;
        let n = self.data.n_drones;
        if before.len() != self.data.n_worlds * n {
            let expected = format!("{} poses, (world, drone)", self.data.n_worlds * n);
            return Err(ArenaError::option("poses before", expected, before.len()));
        }
        let found: Vec<Result<Vec<Way>, SenseError>> = (0..look.n_worlds())
            .into_par_iter()
            .map(|k| {
                let world = look.number(k);
                swept_world(&look, k, &before[world * n..(world + 1) * n])
            })
            .collect();
        let worlds = found.len();
        let (mut out, mut failures) = (Vec::new(), Vec::new());
        for (k, found) in found.into_iter().enumerate() {
            match found {
                Ok(ways) => out.extend(ways),
                Err(e) => failures.push((k, e)),
            }
        }
        look.but_quarantined(all_or_failures(worlds, failures))?;
        Ok(out)
    }
}

impl<N: Number> Arena<N> {
    /// As [`Look::render`].
    ///
    /// # Errors
    /// As there.
    pub fn render(
        &self,
        cameras: &[&[Camera]],
        worlds: Option<&[usize]>,
        planes: DepthPlanes,
        poses: &mut [Pose],
    ) -> Result<(), ArenaError> {
        self.look().render(cameras, worlds, planes, poses)
    }

    /// As [`Look::contacts`].
    ///
    /// # Errors
    /// As there.
    pub fn contacts(
        &self,
        worlds: Option<&[usize]>,
        out: &mut Vec<Vec<Contact>>,
        limited: &mut Vec<usize>,
    ) -> Result<(), ArenaError> {
        self.look().contacts(worlds, out, limited)
    }

    /// As [`Look::clearances`].
    ///
    /// # Errors
    /// As there.
    pub fn clearances(
        &self,
        worlds: Option<&[usize]>,
        max_distance_m: f64,
        out: &mut Vec<Clearance>,
    ) -> Result<(), ArenaError> {
        self.look().clearances(worlds, max_distance_m, out)
    }

    /// As [`Look::poses`].
    pub fn poses(&self) -> Vec<Pose> {
        self.look().poses()
    }

    /// As [`Look::swept`].
    ///
    /// # Errors
    /// As there.
    pub fn swept(&self, before: &[Pose], worlds: Option<&[usize]>) -> Result<Vec<Way>, ArenaError> {
        self.look().swept(before, worlds)
    }
}

/// The failures, if there are any.
fn all_or_failures(worlds: usize, failures: Vec<(usize, SenseError)>) -> Result<(), SenseError> {
    if failures.is_empty() { Ok(()) } else { Err(SenseError::Worlds { worlds, failures }) }
}

/// What the drones of world number `k` of those looked at touched on their way.
fn swept_world<N: Number>(look: &Look<N>, k: usize, before: &[Pose]) -> Result<Vec<Way>, SenseError> {
    let world = look.number(k);
    let mut worker = look.worker(k)?;
    let scene = worker.scene().clone();
    let mut first: Vec<Option<SweptHit>> = Vec::with_capacity(before.len());
    for (d, from) in before.iter().enumerate() {
        // Other drones move too: they are looked at in pairs.
        first.push(Queries::at(&mut worker).swept(&Sweep::new(d, *from, look.pose(world, d)).of_scene())?);
    }
    let mut keep = |d: usize, hit: SweptHit| {
        if first[d].is_none_or(|known| hit.fraction < known.fraction) {
            first[d] = Some(hit);
        }
    };
    for d in 0..before.len() {
        for other in d + 1..before.len() {
            let to = look.pose(world, d);
            if let Some(hit) = Queries::at(&mut worker)
                .swept(&Sweep::new(d, before[d], to).of_drone(other, before[other]))?
            {
                keep(d, hit);
                keep(other, seen_from(&hit, before[other], look.pose(world, other), d, &scene));
            }
        }
    }
    let ways = first.into_iter().enumerate();
    Ok(ways.filter_map(|(drone, hit)| Some(Way { world, drone, hit: hit? })).collect())
}

/// A touch of two drones as the other of them has it, which flew from one pose to another.
fn seen_from(hit: &SweptHit, from: Pose, to: Pose, drone: usize, scene: &crate::scene::Scene) -> SweptHit {
    let body = usize::try_from(hit.drone_geom).ok().and_then(|g| scene.geoms().get(g));
    let way = vec3::sub(to.pos_m, from.pos_m);
    SweptHit {
        pos_m: vec3::add(from.pos_m, vec3::scale(way, hit.fraction)),
        quat_xyzw: turned(from.quat_xyzw, to.quat_xyzw, hit.fraction),
        drone_geom: hit.other_geom,
        other_geom: hit.drone_geom,
        other_body: body.map_or(-1, |g| g.body_id as i32),
        other_drone: Some(drone),
        normal: hit.normal.map(|v| -v),
        ..*hit
    }
}

/// Part of the rotation from one attitude to another, the shorter way about one axis.
fn turned(from: [f64; 4], to: [f64; 4], fraction: f64) -> [f64; 4] {
    let way = quat::mul(quat::conjugate(from), to);
    let way = if way[3] < 0.0 { way.map(|v| -v) } else { way };
    let axis = [way[0], way[1], way[2]];
    let sine = vec3::norm(axis);
    let angle = 2.0 * sine.atan2(way[3]);
    // Of hardly any rotation the axis is not known, and not needed.
    let per_sine = if sine > 1e-12 { angle / sine } else { 2.0 };
    quat::mul(from, quat::exp(vec3::scale(axis, per_sine * fraction)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn part_of_a_rotation_is_about_the_same_axis() {
        let from = quat::exp([0.1, -0.4, 0.2]);
        let to = quat::mul(from, quat::exp([0.0, 0.0, 1.2]));
        let near = |a: [f64; 4], b: [f64; 4]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
        assert!(near(turned(from, to, 0.25), quat::mul(from, quat::exp([0.0, 0.0, 0.3]))));
        assert!(near(turned(from, to.map(|v| -v), 1.0), to), "the shorter way");
        assert!(near(turned(from, from, 0.5), from));
    }
}
