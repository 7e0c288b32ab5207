//! Collision detection of our own: which geoms are near a drone, how far they are, and which of them touch.
//!
//! It answers what MuJoCo 3.17.0 answers: a mesh collides as its convex hull, a plane as a whole half space, a height
//! field as the prisms below its triangles, whatever the group and alpha; only geoms that can collide count.
//!
//! How it works: geoms that no pose moves are kept once for each scene in a tree of boxes, shared by all threads, worlds
//! and drones; geoms of obstacles are in a small tree and drones in a grid, made anew when a worker's poses change. Both
//! give what may be nearer than the best so far, near ones first. Between two geoms, planes and balls have closed forms; all
//! other convex pairs are followed by the algorithm of Gilbert, Johnson and Keerthi until the distance is proven; height
//! fields descend a pyramid of heights, the triangles of signed distance fields a tree.
//!
//! What is left to MuJoCo, for the one pair of geoms that needs it: how deep two overlap that are no ball and no plane,
//! the contact points of touching pairs without a ball, and all contacts of signed distance fields. Scenes whose contacts
//! depend on more than geoms (flexes, `<pair>`, `<exclude>`, overridden margins) are left to it wholly.

mod find;
mod grid;
mod hull;
mod pair;
mod point;

use serde::{Deserialize, Serialize};

pub(super) use find::{Finder, Found, Movers};
pub(super) use hull::Hull;
pub(super) use pair::Meeting;
use pair::Place;

use super::caster::bvh::{Bounds, Bvh};
use super::caster::mesh::Mesh;
use crate::scene::{GeomType, Scene};
use pair::Surface;

/// Who finds contacts and distances.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Collider {
    /// Propwash's own, with MuJoCo's contact points where two geoms touch that are no balls.
    #[default]
    Native,
    /// `mj_collision` and `mj_geomDistance` of MuJoCo over all geoms: the reference.
    MuJoCo,
}

/// A geom, without its pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Solid {
    pub kind: GeomType,
    pub size: [f64; 3],
    /// Number of the hull, the height field or the surface.
    pub asset: usize,
    /// Centre and half sizes of the bounding box in the geom's frame, m.
    pub aabb: [f64; 6],
    /// Of the ball about the geom's place that holds it, m.
    pub radius: f64,
    /// Added up for both geoms: contacts are found up to this signed distance, m.
    pub margin: f64,
    pub collides: bool,
}

impl Solid {
    /// From a point in the geom's frame to its bounding box; 0 inside. To a plane: signed.
    pub fn box_distance(&self, p: [f64; 3]) -> f64 {
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
    pub fn holds(&self, p: [f64; 3]) -> bool {
        (0..3).all(|k| (p[k] - self.aabb[k]).abs() <= self.aabb[3 + k])
    }
}

/// Signed distance to a bounding box or a plane from a ball about `centre`: nothing of the two is nearer than that.
#[inline]
fn lower_bound(g: &Solid, place: Place, centre: [f64; 3], radius: f64) -> f64 {
    let m = place.mat;
    let d = [0, 1, 2].map(|k| centre[k] - place.pos[k]);
    let local = [0, 1, 2].map(|k| m[k] * d[0] + m[3 + k] * d[1] + m[6 + k] * d[2]);
    let distance = g.box_distance(local);
    // In the box nothing is known of the depth.
    if distance == 0.0 { f64::NEG_INFINITY } else { distance - radius }
}

/// All geoms of a scene as they collide, and the tree over those that stay where they are.
#[derive(Debug, Default)]
pub(super) struct Solids {
    pub geoms: Vec<Solid>,
    hulls: Vec<Hull>,
    surfaces: Vec<Surface>,
    /// Of no drone.
    planes: Vec<u32>,
    fixed: Bvh,
    fixed_ids: Vec<u32>,
    /// Geoms of obstacles.
    moving: Vec<u32>,
    /// Largest margin of any geom.
    margin: f64,
    /// Why contacts are left to MuJoCo, if they are.
    pub alone: Option<&'static str>,
}

/// Why a scene's contacts are left to MuJoCo.
fn alone(scene: &Scene) -> Option<&'static str> {
    let odd = |id: &usize| {
        let g = &scene.geoms()[*id];
        g.can_collide() && matches!(g.kind, GeomType::Plane | GeomType::Hfield | GeomType::Sdf)
    };
    let drones = || (0..scene.n_drones()).filter_map(|d| scene.drone_geoms(d).ok()).flatten();
    if scene.n_flex() > 0 {
        Some("it has flexes")
    } else if drones().any(odd) {
        Some("a shell has a plane or a field")
    } else {
        scene.special_contacts()
    }
}

impl Solids {
    /// `assets`: number of the height field of each geom that has one. `pos`, `mat`: poses of all geoms.
    pub fn new(scene: &Scene, assets: &[usize], pos: &[[f64; 3]], mat: &[[f64; 9]]) -> Self {
        let mut solids = Self {
            geoms: Vec::new(),
            hulls: Vec::new(),
            surfaces: Vec::new(),
            planes: Vec::new(),
            fixed: Bvh::default(),
            fixed_ids: Vec::new(),
            moving: Vec::new(),
            margin: 0.0,
            alone: alone(scene),
        };
        // Geoms of one mesh share its hull.
        let mut known = std::collections::HashMap::new();
        let mut boxes = Vec::new();
        for geom in scene.geoms() {
            let view = scene.mesh(geom.id).filter(|_| geom.can_collide());
            let key = (geom.kind, view.map_or(0, |v| v.vertices_m.as_ptr() as usize));
            let asset = match (geom.kind, view) {
                (GeomType::Hfield, _) => assets[geom.id],
                (_, None) => usize::MAX,
                (GeomType::Mesh, Some(view)) => *known.entry(key).or_insert_with(|| {
                    let points = view.vertices_m.iter().map(|v| v.map(f64::from)).collect();
                    let faces = scene.mesh_hull(geom.id).unwrap_or_default();
                    solids.hulls.push(Hull::new(points, faces));
                    solids.hulls.len() - 1
                }),
                (_, Some(view)) => *known.entry(key).or_insert_with(|| {
                    let corner = |v: i32| usize::try_from(v).ok().and_then(|v| view.vertices_m.get(v));
                    let triangle = |f: &[i32; 3]| Some([*corner(f[0])?, *corner(f[1])?, *corner(f[2])?]);
                    solids.surfaces.push(Surface {
                        mesh: Mesh::new(view.vertices_m, view.faces),
                        triangles: view
                            .faces
                            .iter()
                            .filter_map(triangle)
                            .map(|t| t.map(|v| v.map(f64::from)))
                            .collect(),
                    });
                    solids.surfaces.len() - 1
                }),
            };
            let margin = geom.margin_m + geom.gap_m;
            let solid = Solid {
                kind: geom.kind,
                size: geom.size_m,
                asset,
                aabb: geom.aabb_m,
                radius: geom.bounding_radius_m,
                margin,
                collides: geom.can_collide(),
            };
            solids.geoms.push(solid);
            if !solid.collides {
                continue;
            }
            solids.margin = solids.margin.max(margin);
            let id = geom.id as u32;
            if geom.drone.is_some() {
                continue;
            }
            if geom.kind == GeomType::Plane {
                solids.planes.push(id);
            } else if scene.bodies()[geom.body_id].obstacle.is_some() {
                solids.moving.push(id);
            } else {
                solids.fixed_ids.push(id);
                boxes.push(bounds(&solid, pos[geom.id], &mat[geom.id]));
            }
        }
        solids.fixed.build(&boxes);
        solids
    }
}

/// The box along the world's axes that holds a geom and its margin.
fn bounds(g: &Solid, pos: [f64; 3], mat: &[f64; 9]) -> Bounds {
    let (mut centre, mut half) = (pos, [g.margin.max(0.0); 3]);
    for i in 0..3 {
        for j in 0..3 {
            centre[i] += mat[3 * i + j] * g.aabb[j];
            half[i] += (mat[3 * i + j] * g.aabb[3 + j]).abs();
        }
    }
    Bounds::about(centre, half)
}
