//! The scene as the caster and collision detection keep it: built once for each compiled scene, shared by all threads, worlds and drones.

use std::collections::HashMap;

use super::hfield::Hfield;
use super::mesh::Mesh;
use crate::scene::{GeomInfo, GeomType, Scene, SceneError, Worker};
use crate::sense::collide::Solids;

/// A geom, without its pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    pub kind: GeomType,
    pub size: [f64; 3],
    /// Number of the mesh or height field.
    pub asset: usize,
    pub body: usize,
    pub drone: Option<usize>,
    pub group: usize,
    /// Its alpha is not 0.
    pub opaque: bool,
    /// Only MuJoCo's own rays know it.
    pub foreign: bool,
    pub hull: Hull,
}

/// A segment with a radius that holds a geom: in its frame, or in the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hull {
    pub centre: [f64; 3],
    /// From the centre to one end.
    pub half: [f64; 3],
    /// Infinite for an endless plane.
    pub radius: f64,
}

impl Hull {
    /// Of a box.
    fn of_box(centre: [f64; 3], size: [f64; 3]) -> Self {
        let long = (0..3).fold(0, |a, k| if size[k] > size[a] { k } else { a });
        let across = size[(long + 1) % 3].hypot(size[(long + 2) % 3]);
        let mut half = [0.0; 3];
        if size[long] > across {
            half[long] = size[long];
            Self { centre, half, radius: across }
        } else {
            Self { centre, half, radius: across.hypot(size[long]) }
        }
    }

    /// Along z.
    fn along_z(half: f64, radius: f64) -> Self {
        Self { centre: [0.0; 3], half: [0.0, 0.0, half], radius }
    }

    /// In the world, grown by what f32 may round away.
    pub fn placed(&self, pos: [f64; 3], mat: &[f64; 9]) -> Self {
        let mut centre = pos;
        let mut half = [0.0; 3];
        for i in 0..3 {
            for j in 0..3 {
                centre[i] += mat[3 * i + j] * self.centre[j];
                half[i] += mat[3 * i + j] * self.half[j];
            }
        }
        let far = centre.iter().chain(&half).fold(0.0f64, |a, x| a.max(x.abs()));
        Self { centre, half, radius: self.radius * (1.0 + 1e-5) + 2e-6 * far + 1e-9 }
    }

    /// Radius of the ball about the centre that holds it.
    pub fn reach(&self) -> f64 {
        norm(self.half) + self.radius
    }

    /// Distance from a point, negative inside.
    pub fn distance(&self, from: [f64; 3]) -> f64 {
        let d = [0, 1, 2].map(|k| from[k] - self.centre[k]);
        let square: f64 = self.half.iter().map(|x| x * x).sum();
        let along: f64 = (0..3).map(|k| d[k] * self.half[k]).sum();
        let u = if square > 0.0 { (along / square).clamp(-1.0, 1.0) } else { 0.0 };
        norm([0, 1, 2].map(|k| d[k] - u * self.half[k])) - self.radius
    }
}

fn norm(v: [f64; 3]) -> f64 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

/// A number for each of many geoms, in arrays of whole lanes.
#[derive(Debug, Default)]
pub(super) struct Hulls {
    /// Centre, half segment, radius; filled up with hulls that are nowhere.
    pub data: [Vec<f32>; 7],
}

impl Hulls {
    pub fn clear(&mut self) {
        for column in &mut self.data {
            column.clear();
        }
    }

    /// Room for so many more, and for what [`Hulls::pad`] adds.
    pub fn reserve(&mut self, hulls: usize) {
        for column in &mut self.data {
            column.reserve(hulls.next_multiple_of(16));
        }
    }

    pub fn push(&mut self, hull: &Hull) {
        let row = [
            hull.centre[0],
            hull.centre[1],
            hull.centre[2],
            hull.half[0],
            hull.half[1],
            hull.half[2],
            hull.radius,
        ];
        for (column, x) in self.data.iter_mut().zip(row) {
            column.push(x as f32);
        }
    }

    /// Fills up the last group of sixteen.
    pub fn pad(&mut self) {
        while !self.data[0].len().is_multiple_of(16) {
            for column in &mut self.data[..6] {
                column.push(0.0);
            }
            self.data[6].push(f32::NEG_INFINITY);
        }
    }

    pub fn groups(&self) -> usize {
        self.data[0].len() / 16
    }
}

/// The static level: geoms that no pose moves, in groups of sixteen that lie close together.
#[derive(Debug, Default)]
pub(super) struct Fixed {
    /// Geom ids, in the order of `hulls`.
    pub ids: Vec<u32>,
    pub hulls: Hulls,
    /// One ball for each group of sixteen.
    pub groups: Hulls,
}

/// All that does not change from frame to frame.
#[derive(Debug)]
pub(in super::super) struct World {
    pub(super) shapes: Vec<Shape>,
    pub meshes: Vec<Mesh>,
    pub hfields: Vec<Hfield>,
    pub(super) fixed: Fixed,
    /// Geoms of drones and obstacles, and endless planes.
    pub moving: Vec<u32>,
    /// Geoms for MuJoCo's own rays.
    pub foreign: Vec<u32>,
    /// Body of geom `id` at `id + 1`; −1 at 0.
    pub bodies: Vec<i32>,
    /// The same geoms as they collide.
    pub solids: Solids,
}

/// Geom ids travel in lanes of f32.
pub(super) const MAX_GEOMS: usize = 1 << 24;

impl World {
    /// That of the worker's scene, built when it is first asked for.
    pub fn of(worker: &Worker) -> Result<std::sync::Arc<Self>, SceneError> {
        let (pos, mat) = worker.geom_poses()?;
        Ok(worker.scene().keep(|| Self::new(worker.scene(), pos, mat)))
    }

    fn new(scene: &Scene, pos: &[[f64; 3]], mat: &[[f64; 9]]) -> Self {
        let mut assets = Vec::new();
        let mut world = Self {
            solids: Solids::default(),
            shapes: Vec::new(),
            meshes: Vec::new(),
            hfields: Vec::new(),
            fixed: Fixed::default(),
            moving: Vec::new(),
            foreign: Vec::new(),
            bodies: vec![-1],
        };
        // Geoms of one mesh share its arrays.
        let mut known: HashMap<usize, (usize, Hull)> = HashMap::new();
        let mut still = Vec::new();
        for geom in scene.geoms() {
            let (hull, found) = world.hull_of(scene, geom, &mut known);
            let (asset, foreign) = (found.unwrap_or(0), found.is_none());
            world.shapes.push(Shape {
                kind: geom.kind,
                size: geom.size_m,
                asset,
                body: geom.body_id,
                drone: geom.drone,
                group: geom.group.clamp(0, 5) as usize,
                opaque: geom.alpha != 0.0,
                foreign,
                hull,
            });
            assets.push(if foreign { usize::MAX } else { asset });
            world.bodies.push(geom.body_id as i32);
            let moves = geom.drone.is_some() || scene.bodies()[geom.body_id].obstacle.is_some();
            if foreign {
                world.foreign.push(geom.id as u32);
            } else if moves || hull.radius.is_infinite() {
                world.moving.push(geom.id as u32);
            } else if geom.alpha != 0.0 {
                still.push((geom.id as u32, hull.placed(pos[geom.id], &mat[geom.id])));
            }
        }
        world.fixed = Fixed::new(still);
        world.solids = Solids::new(scene, &assets, pos, mat);
        world
    }

    /// What holds a geom, and the number of its asset (0 where it needs none); none where its rays are left to MuJoCo. Adds assets that
    /// are not `known` by the address of their arrays.
    fn hull_of(
        &mut self,
        scene: &Scene,
        geom: &GeomInfo,
        known: &mut HashMap<usize, (usize, Hull)>,
    ) -> (Hull, Option<usize>) {
        let s = geom.size_m;
        let hull = match geom.kind {
            GeomType::Plane if s[0] > 0.0 && s[1] > 0.0 => Hull::of_box([0.0; 3], [s[0], s[1], 0.0]),
            GeomType::Plane => Hull::along_z(0.0, f64::INFINITY),
            GeomType::Sphere => Hull::along_z(0.0, s[0]),
            GeomType::Capsule => Hull::along_z(s[1], s[0]),
            GeomType::Cylinder if s[1] > s[0] => Hull::along_z(s[1], s[0]),
            GeomType::Cylinder => Hull::along_z(0.0, s[0].hypot(s[1])),
            GeomType::Ellipsoid => of_ellipsoid(s),
            GeomType::Box => Hull::of_box([0.0; 3], s),
            GeomType::Sdf => return (foreign_ball(geom), None),
            GeomType::Mesh => {
                let Some(view) = scene.mesh(geom.id) else { return (foreign_ball(geom), None) };
                let key = view.vertices_m.as_ptr() as usize;
                let (number, hull) = *known.entry(key).or_insert_with(|| {
                    self.meshes.push(Mesh::new(view.vertices_m, view.faces));
                    (self.meshes.len() - 1, of_points(view.vertices_m))
                });
                return (hull, Some(number));
            }
            GeomType::Hfield => {
                let view = scene.hfield(geom.id);
                let key = view.map_or(0, |v| v.data.as_ptr() as usize);
                if let Some((number, hull)) = known.get(&key) {
                    return (*hull, Some(*number));
                }
                let made =
                    view.and_then(|v| Some((Hfield::new(v.n_row, v.n_col, v.size_m, v.data)?, v.size_m)));
                let Some((field, [sx, sy, top, base])) = made else { return (foreign_ball(geom), None) };
                let hull = Hull::of_box([0.0, 0.0, 0.5 * (top - base)], [sx, sy, 0.5 * (top + base)]);
                let number = self.hfields.len();
                self.hfields.push(field);
                known.insert(key, (number, hull));
                return (hull, Some(number));
            }
        };
        (hull, Some(0))
    }
}

/// A ball that holds whatever MuJoCo's rays may see of a geom.
fn foreign_ball(geom: &GeomInfo) -> Hull {
    let b = geom.aabb_m;
    let radius = (norm([b[0], b[1], b[2]]) + norm([b[3], b[4], b[5]]))
        .max(norm(geom.size_m))
        .max(geom.bounding_radius_m);
    Hull::along_z(0.0, radius)
}

fn of_ellipsoid(s: [f64; 3]) -> Hull {
    let long = (0..3).fold(0, |a, k| if s[k] > s[a] { k } else { a });
    let across = s[(long + 1) % 3].max(s[(long + 2) % 3]);
    let mut half = [0.0; 3];
    // Its support √(h² c² + r² s²) is never more than (h − r) c + r.
    half[long] = s[long] - across;
    Hull { centre: [0.0; 3], half, radius: across }
}

fn of_points(points: &[[f32; 3]]) -> Hull {
    let (mut lo, mut hi) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for p in points {
        for k in 0..3 {
            lo[k] = lo[k].min(f64::from(p[k]));
            hi[k] = hi[k].max(f64::from(p[k]));
        }
    }
    if points.is_empty() {
        return Hull::along_z(0.0, 0.0);
    }
    Hull::of_box([0, 1, 2].map(|k| 0.5 * (lo[k] + hi[k])), [0, 1, 2].map(|k| 0.5 * (hi[k] - lo[k])))
}

impl Fixed {
    fn new(mut geoms: Vec<(u32, Hull)>) -> Self {
        let (mut lo, mut hi) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for (_, h) in &geoms {
            for k in 0..3 {
                lo[k] = lo[k].min(h.centre[k]);
                hi[k] = hi[k].max(h.centre[k]);
            }
        }
        // Along a curve that keeps neighbours together (Morton, 1966): bits of the coordinates in turn.
        geoms.sort_by_cached_key(|(id, h)| {
            let mut code = 0u64;
            for k in 0..3 {
                let width = hi[k] - lo[k];
                let u = if width > 0.0 { (h.centre[k] - lo[k]) / width } else { 0.0 };
                let cell = (u * 1023.0) as u64;
                for bit in 0..10 {
                    code |= (cell >> bit & 1) << (3 * bit + k as u64);
                }
            }
            (code, *id)
        });
        let mut fixed = Self::default();
        for group in geoms.chunks(16) {
            let n = group.len() as f64;
            let mut centre = [0.0; 3];
            for (id, hull) in group {
                fixed.ids.push(*id);
                fixed.hulls.push(hull);
                for k in 0..3 {
                    centre[k] += hull.centre[k] / n;
                }
            }
            let reach = group.iter().fold(0.0f64, |a, (_, h)| {
                a.max(norm([0, 1, 2].map(|k| h.centre[k] - centre[k])) + h.reach())
            });
            let ball = Hull { centre, half: [0.0; 3], radius: reach };
            fixed.groups.push(&ball.placed([0.0; 3], &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]));
        }
        fixed.hulls.pad();
        fixed.groups.pad();
        fixed
    }
}
