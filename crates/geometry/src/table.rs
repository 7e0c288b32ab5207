//! The one table of a scene's geoms: what rays, distances and motions need of each, made once and shared by all threads, worlds and
//! drones.

use std::collections::HashMap;

use crate::broad::groups::RayGroups;
use crate::kind::GeomType;
use crate::shape::bvh::{Bounds, Bvh};
use crate::shape::hfield::Hfield;
use crate::shape::hull::Hull;
use crate::shape::mesh::Mesh;
use crate::shape::round::{Round, norm};
use crate::shape::surface::Surface;

/// A geom as whoever compiled the scene tells of it.
#[derive(Clone, Copy, Debug)]
pub struct GeomSource<'a> {
    /// Shape.
    pub kind: GeomType,
    /// Sizes as in MJCF, m: radius; radius and half length; half sizes; rectangle half sizes of a plane (0 = infinite).
    pub size_m: [f64; 3],
    /// Its body.
    pub body: usize,
    /// The drone that it belongs to.
    pub drone: Option<usize>,
    /// It belongs to an obstacle that can be moved. (Geoms of drones always move.)
    pub moves: bool,
    /// Visibility group, 0 to 5.
    pub group: usize,
    /// Rays can see it: its alpha is not 0.
    pub opaque: bool,
    /// Something can collide with it.
    pub collides: bool,
    /// Centre and half sizes of the bounding box in the geom's frame, m.
    pub aabb_m: [f64; 6],
    /// Radius of the ball about the geom's place that holds it, m.
    pub bounding_radius_m: f64,
    /// Contacts are found up to the signed distance to which this adds up for both geoms, m.
    pub margin_m: f64,
    /// Where it stands; for what moves, where it stands when the table is made.
    pub pos_m: [f64; 3],
    /// Its rotation there.
    pub mat: &'a [f64; 9],
    /// What else its shape is made of.
    pub shape: ShapeSource<'a>,
}

/// What the shape of a mesh or a field is made of, in the geom's frame.
#[derive(Clone, Copy, Debug)]
pub enum ShapeSource<'a> {
    /// Its sizes are all, or nothing else is known.
    Sizes,
    /// Of a mesh, or of a signed distance field that has one. Geoms that share the array of vertices share what is made of it.
    Mesh {
        /// Vertices, m.
        vertices_m: &'a [[f32; 3]],
        /// Triangles, as numbers of vertices.
        faces: &'a [[i32; 3]],
        /// Triangles of the convex hull; empty where they are not known.
        hull: &'a [[i32; 3]],
    },
    /// Of a height field. Geoms that share the array of heights share what is made of it.
    Hfield {
        /// Rows (y).
        n_row: usize,
        /// Columns (x).
        n_col: usize,
        /// Half size in x and in y, height of the value 1, depth of the base below zero, m.
        size_m: [f64; 4],
        /// Heights 0 to 1, row major; row 0 is at −y.
        data: &'a [f32],
    },
}

/// A drone: geoms that move together.
#[derive(Clone, Debug, Default)]
pub struct DroneSource {
    /// Its root body, whose origin is the drone's place.
    pub body: usize,
    /// Its geoms.
    pub geoms: Vec<usize>,
    /// Radius about its place that holds all its geoms that can collide, m.
    pub radius_m: f64,
}

/// A geom, without its pose.
#[derive(Clone, Copy, Debug)]
pub struct Geom {
    /// Shape.
    pub kind: GeomType,
    /// Something can collide with it.
    pub collides: bool,
    /// Rays can see it: its alpha is not 0.
    pub opaque: bool,
    /// Only MuJoCo's own rays know it.
    pub foreign: bool,
    /// Visibility group, 0 to 5.
    pub group: u8,
    /// Number of the mesh or height field that rays meet.
    pub(crate) asset: u32,
    /// Number of the hull or surface that it collides as; none where it has none.
    pub(crate) solid: Option<u32>,
    /// Its body.
    pub body: u32,
    /// The drone that it belongs to.
    pub drone: Option<u32>,
    /// Sizes, m.
    pub size: [f64; 3],
    /// What holds it, for rays.
    pub(crate) round: Round,
    /// Centre and half sizes of the bounding box in the geom's frame, m.
    pub aabb: [f64; 6],
    /// Of the ball about the geom's place that holds it, m.
    pub radius: f64,
    /// Added up for both geoms: contacts are found up to this signed distance, m.
    pub margin: f64,
}

impl Geom {
    /// From a point in the geom's frame to its bounding box; 0 inside. To a plane: signed.
    #[inline]
    pub(crate) fn box_distance(&self, p: [f64; 3]) -> f64 {
        if self.kind == GeomType::Plane {
            return p[2];
        }
        let a = self.aabb;
        let mut sum = 0.0;
        for k in 0..3 {
            let out = ((p[k] - a[k]).abs() - a[3 + k]).max(0.0);
            sum += out * out;
        }
        sum.sqrt()
    }

    /// A point in the geom's frame lies in its bounding box.
    pub(crate) fn holds(&self, p: [f64; 3]) -> bool {
        (0..3).all(|k| (p[k] - self.aabb[k]).abs() <= self.aabb[3 + k])
    }

    /// The box along the world's axes that holds the geom and its margin.
    pub(crate) fn bounds(&self, pos: [f64; 3], mat: &[f64; 9]) -> Bounds {
        let (mut centre, mut half) = (pos, [self.margin.max(0.0); 3]);
        for i in 0..3 {
            for j in 0..3 {
                centre[i] += mat[3 * i + j] * self.aabb[j];
                half[i] += (mat[3 * i + j] * self.aabb[3 + j]).abs();
            }
        }
        Bounds::about(centre, half)
    }
}

/// Geoms that no pose moves.
#[derive(Debug, Default)]
pub(crate) struct Still {
    /// Those that rays can see, in groups of sixteen.
    pub rays: RayGroups,
    /// Those that can collide but are no planes, in a tree of boxes; `ids[order[k]]` is the geom at place `k` of its leaves.
    pub tree: Bvh,
    pub ids: Vec<u32>,
}

/// All geoms of a scene.
#[derive(Debug, Default)]
pub struct Table {
    pub(crate) geoms: Vec<Geom>,
    pub(crate) drones: Vec<DroneSource>,
    pub(crate) meshes: Vec<Mesh>,
    pub(crate) hfields: Vec<Hfield>,
    pub(crate) hulls: Vec<Hull>,
    pub(crate) surfaces: Vec<Surface>,
    pub(crate) still: Still,
    /// What rays look at one by one: geoms of drones and obstacles, and endless planes.
    pub(crate) moving: Vec<u32>,
    /// Geoms of obstacles that can collide.
    pub(crate) obstacles: Vec<u32>,
    /// Planes of no drone that can collide.
    pub(crate) planes: Vec<u32>,
    /// Geoms for MuJoCo's own rays.
    pub(crate) foreign: Vec<u32>,
    /// Body of geom `id` at `id + 1`; −1 at 0.
    pub(crate) bodies: Vec<i32>,
    /// Largest margin of any geom, m.
    pub(crate) margin: f64,
    /// Distances of ellipsoids, cylinders and meshes are known to this, m, to whoever finds contact points.
    pub(crate) tolerance: f64,
    mujoco_only: Option<&'static str>,
}

impl Table {
    /// Of the geoms and drones of a scene. `tolerance_m`: to what whoever finds contact points knows distances of round shapes and meshes.
    /// `mujoco_only`: why contacts and distances of the scene are left to MuJoCo, if they are.
    pub fn new<'a>(
        geoms: impl Iterator<Item = GeomSource<'a>>,
        drones: Vec<DroneSource>,
        tolerance_m: f64,
        mujoco_only: Option<&'static str>,
    ) -> Self {
        let tolerance = tolerance_m;
        let mut builder = Builder {
            table: Self { drones, bodies: vec![-1], tolerance, mujoco_only, ..Self::default() },
            ..Builder::default()
        };
        for geom in geoms {
            builder.add(&geom);
        }
        builder.finish()
    }

    /// The geoms, by id.
    pub fn geoms(&self) -> &[Geom] {
        &self.geoms
    }

    /// The drones.
    pub fn drones(&self) -> &[DroneSource] {
        &self.drones
    }

    /// Geoms that only MuJoCo's own rays know: signed distance fields, and meshes and height fields without data.
    pub fn foreign(&self) -> &[u32] {
        &self.foreign
    }

    /// Bodies as planes of frames state them: that of geom `id`, −1 for the geom −1, which is none.
    pub fn body_of(&self, geom: i32) -> i32 {
        self.bodies[(geom + 1) as usize]
    }

    /// Why contacts and distances are left to MuJoCo, if they are.
    pub fn mujoco_only(&self) -> Option<&'static str> {
        self.mujoco_only
    }
}

/// What a table is made with.
#[derive(Default)]
struct Builder {
    table: Table,
    /// Number and bound of what rays meet, by the address of its array.
    seen: HashMap<usize, (u32, Round)>,
    /// Number of the hull or surface, by type and address.
    solid: HashMap<(GeomType, usize), u32>,
    still: Vec<(u32, Round)>,
    boxes: Vec<Bounds>,
}

impl Builder {
    fn add(&mut self, source: &GeomSource) {
        let (round, asset) = self.for_rays(source);
        let geom = Geom {
            kind: source.kind,
            collides: source.collides,
            opaque: source.opaque,
            foreign: asset.is_none(),
            group: source.group.min(5) as u8,
            asset: asset.unwrap_or(0),
            solid: self.for_distances(source),
            body: source.body as u32,
            drone: source.drone.map(|d| d as u32),
            size: source.size_m,
            round,
            aabb: source.aabb_m,
            radius: source.bounding_radius_m,
            margin: source.margin_m,
        };
        let table = &mut self.table;
        let id = table.geoms.len() as u32;
        table.geoms.push(geom);
        table.bodies.push(source.body as i32);
        if geom.foreign {
            table.foreign.push(id);
        } else if geom.drone.is_some() || source.moves || round.radius.is_infinite() {
            table.moving.push(id);
        } else if geom.opaque {
            self.still.push((id, round.placed(source.pos_m, source.mat)));
        }
        if !geom.collides {
            return;
        }
        table.margin = table.margin.max(geom.margin);
        if geom.drone.is_some() {
            return;
        }
        if geom.kind == GeomType::Plane {
            table.planes.push(id);
        } else if source.moves {
            table.obstacles.push(id);
        } else {
            table.still.ids.push(id);
            self.boxes.push(geom.bounds(source.pos_m, source.mat));
        }
    }

    fn finish(self) -> Table {
        let Self { mut table, still, boxes, .. } = self;
        table.still.rays = RayGroups::new(still);
        table.still.tree.build(&boxes);
        table
    }

    /// What holds a geom, and the number of what rays meet (0 where its sizes say it); none where its rays are left to MuJoCo.
    fn for_rays(&mut self, source: &GeomSource) -> (Round, Option<u32>) {
        let s = source.size_m;
        let round = match source.kind {
            GeomType::Plane if s[0] > 0.0 && s[1] > 0.0 => Round::of_box([0.0; 3], [s[0], s[1], 0.0]),
            GeomType::Plane => Round::along_z(0.0, f64::INFINITY),
            GeomType::Sphere => Round::along_z(0.0, s[0]),
            GeomType::Capsule => Round::along_z(s[1], s[0]),
            GeomType::Cylinder if s[1] > s[0] => Round::along_z(s[1], s[0]),
            GeomType::Cylinder => Round::along_z(0.0, s[0].hypot(s[1])),
            GeomType::Ellipsoid => Round::of_ellipsoid(s),
            GeomType::Box => Round::of_box([0.0; 3], s),
            GeomType::Sdf => return (foreign_ball(source), None),
            GeomType::Mesh => {
                let ShapeSource::Mesh { vertices_m, faces, .. } = source.shape else {
                    return (foreign_ball(source), None);
                };
                let meshes = &mut self.table.meshes;
                let (number, round) = *self.seen.entry(vertices_m.as_ptr() as usize).or_insert_with(|| {
                    meshes.push(Mesh::new(vertices_m, faces));
                    (meshes.len() as u32 - 1, Round::of_points(vertices_m))
                });
                return (round, Some(number));
            }
            GeomType::Hfield => {
                let ShapeSource::Hfield { n_row, n_col, size_m, data } = source.shape else {
                    return (foreign_ball(source), None);
                };
                let key = data.as_ptr() as usize;
                if let Some((number, round)) = self.seen.get(&key) {
                    return (*round, Some(*number));
                }
                let Some(field) = Hfield::new(n_row, n_col, size_m, data) else {
                    return (foreign_ball(source), None);
                };
                let [sx, sy, top, base] = size_m;
                let round = Round::of_box([0.0, 0.0, 0.5 * (top - base)], [sx, sy, 0.5 * (top + base)]);
                let number = self.table.hfields.len() as u32;
                self.table.hfields.push(field);
                self.seen.insert(key, (number, round));
                return (round, Some(number));
            }
        };
        (round, Some(0))
    }

    /// Number of the hull of a mesh or of the surface of a signed distance field, for what can collide.
    fn for_distances(&mut self, source: &GeomSource) -> Option<u32> {
        let ShapeSource::Mesh { vertices_m, faces, hull } = source.shape else { return None };
        if !source.collides {
            return None;
        }
        let Table { hulls, surfaces, .. } = &mut self.table;
        let make = || match source.kind {
            GeomType::Mesh => {
                let points = vertices_m.iter().map(|v| v.map(f64::from)).collect();
                hulls.push(Hull::new(points, hull));
                hulls.len() as u32 - 1
            }
            _ => {
                surfaces.push(Surface::new(vertices_m, faces));
                surfaces.len() as u32 - 1
            }
        };
        Some(*self.solid.entry((source.kind, vertices_m.as_ptr() as usize)).or_insert_with(make))
    }
}

/// A ball that holds whatever MuJoCo's rays may see of a geom.
fn foreign_ball(geom: &GeomSource) -> Round {
    let b = geom.aabb_m;
    let radius = (norm([b[0], b[1], b[2]]) + norm([b[3], b[4], b[5]]))
        .max(norm(geom.size_m))
        .max(geom.bounding_radius_m);
    Round::along_z(0.0, radius)
}
