//! The scenes of a batch, compiled, and what tasks look for in them.

use rayon::prelude::*;

use super::EnvError;
use crate::arena::Setup;
use crate::math::{quat, vec3};
use crate::scene::{GeomType, Scene};
use crate::sense::Camera;

/// A gate to fly through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    /// Middle of its opening, m.
    pub pos_m: [f64; 3],
    /// Orientation x y z w: x points the way through, y and z across.
    pub quat_xyzw: [f64; 4],
    /// Half of the opening along y and z, m.
    pub half_m: [f64; 2],
}

impl Gate {
    /// A point of the world as the gate sees it.
    pub fn local(&self, point_m: [f64; 3]) -> [f64; 3] {
        quat::rotate_inverse(self.quat_xyzw, vec3::sub(point_m, self.pos_m))
    }

    /// The way through, a unit vector.
    pub fn axis(&self) -> [f64; 3] {
        quat::rotate(self.quat_xyzw, [1.0, 0.0, 0.0])
    }

    /// Whether the way from `from_m` to `to_m` leads through the opening in its direction.
    pub fn is_passed(&self, from_m: [f64; 3], to_m: [f64; 3]) -> bool {
        let (a, b) = (self.local(from_m), self.local(to_m));
        if !(a[0] < 0.0 && b[0] >= 0.0) {
            return false;
        }
        let t = a[0] / (a[0] - b[0]);
        let at = vec3::add(a, vec3::scale(vec3::sub(b, a), t));
        at[1].abs() <= self.half_m[0] && at[2].abs() <= self.half_m[1]
    }
}

/// What tasks look for in a scene: its sites by the beginnings of their names, and its extent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// Sites `gate…` in the order of their names: boxes that fill the openings.
    pub gates: Vec<Gate>,
    /// Sites `start…`: middle and half sizes, m.
    pub starts: Vec<([f64; 3], [f64; 3])>,
    /// Sites `goal…`.
    pub goals: Vec<([f64; 3], [f64; 3])>,
    /// Box around all geoms of the scene but planes, m; none where there are none.
    pub extent_m: Option<[[f64; 3]; 2]>,
}

impl Course {
    fn of(scene: &Scene) -> Result<Self, EnvError> {
        let mut sites: Vec<_> = scene.sites().iter().collect();
        sites.sort_by(|a, b| a.name.cmp(&b.name));
        let named = |prefix: &'static str| sites.iter().filter(move |s| s.name.starts_with(prefix)).copied();
        let places = |prefix: &'static str| named(prefix).map(|s| (s.pos_m, s.size_m)).collect();
        let gates = named("gate")
            .map(|s| Gate { pos_m: s.pos_m, quat_xyzw: s.quat_xyzw, half_m: [s.size_m[1], s.size_m[2]] })
            .collect();
        let mut worker = scene.worker()?;
        worker.update()?;
        let mut extent: Option<[[f64; 3]; 2]> = None;
        for geom in scene.geoms().iter().filter(|g| g.drone.is_none() && g.kind != GeomType::Plane) {
            let (pos, mat) = worker.geom_pose(geom.id)?;
            let [cx, cy, cz, hx, hy, hz] = geom.aabb_m;
            for k in 0..3 {
                let row = &mat[3 * k..3 * k + 3];
                let middle = pos[k] + row[0] * cx + row[1] * cy + row[2] * cz;
                let half = row[0].abs() * hx + row[1].abs() * hy + row[2].abs() * hz;
                let e = extent.get_or_insert([[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]]);
                e[0][k] = e[0][k].min(middle - half);
                e[1][k] = e[1][k].max(middle + half);
            }
        }
        Ok(Self { gates, starts: places("start"), goals: places("goal"), extent_m: extent })
    }
}

/// One scene with everything that is made of it once; its workers are with the arena.
pub(super) struct Layout {
    pub scene: Scene,
    /// One for each drone, or none.
    pub cameras: Vec<Camera>,
    pub course: Course,
}

impl Layout {
    /// A scene with the camera of each drone, or none.
    fn new(scene: &Scene, cameras: &[Camera]) -> Result<Self, EnvError> {
        Ok(Self { course: Course::of(scene)?, cameras: cameras.to_vec(), scene: scene.clone() })
    }

    /// All layouts of a description.
    pub fn all(setup: &Setup) -> Result<Vec<Self>, EnvError> {
        let each = setup.scenes().par_iter().zip(setup.cameras());
        each.map(|(scene, cameras)| Self::new(scene, cameras)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneSource;

    #[test]
    fn a_gate_is_passed_through_its_opening_in_its_direction_only() {
        let turn = quat::exp([0.0, 0.0, std::f64::consts::FRAC_PI_2]); // x of the gate is y of the world
        let gate = Gate { pos_m: [1.0, 2.0, 1.5], quat_xyzw: turn, half_m: [0.5, 0.4] };
        assert!(gate.is_passed([1.0, 1.9, 1.5], [1.1, 2.1, 1.6]));
        assert!(!gate.is_passed([1.0, 2.1, 1.5], [1.0, 1.9, 1.5]), "backwards");
        assert!(!gate.is_passed([1.0, 1.0, 1.5], [1.0, 1.9, 1.5]), "not yet there");
        assert!(!gate.is_passed([1.6, 1.9, 1.5], [1.6, 2.1, 1.5]), "beside the opening");
        assert!(!gate.is_passed([1.0, 1.9, 2.0], [1.0, 2.1, 2.0]), "above the opening");
        assert!(gate.is_passed([1.0, 1.9, 1.89], [1.0, 2.0, 1.89]), "to the plane itself");
    }

    #[test]
    fn a_course_is_read_from_sites_and_geoms() {
        let xml = "<mujoco><worldbody><geom type=\"plane\" size=\"0 0 1\"/>\
            <body pos=\"1 0 0\" quat=\"0.70710678 0 0 0.70710678\"><site name=\"gate_1\" type=\"box\" size=\"0.1 0.5 0.6\" pos=\"2 0 1\"/>\
            <geom type=\"box\" size=\"1 2 3\"/></body><site name=\"gate_0\" type=\"box\" size=\"0.1 0.5 0.6\"/>\
            <site name=\"start_a\" type=\"box\" size=\"1 1 1\" pos=\"-3 0 2\"/><site name=\"other\"/></worldbody></mujoco>";
        let scene = Scene::build(&SceneSource::text("course", xml), &[]).unwrap();
        let layout = Layout::new(&scene, &[]).unwrap();
        let c = &layout.course;
        assert_eq!((c.gates.len(), c.starts.len(), c.goals.len()), (2, 1, 0));
        let gate = c.gates[1];
        let near = |a: [f64; 3], b: [f64; 3]| vec3::norm(vec3::sub(a, b)) < 1e-7;
        assert!(near(gate.pos_m, [1.0, 2.0, 1.0]) && near(gate.axis(), [0.0, 1.0, 0.0]), "{gate:?}");
        assert_eq!(gate.half_m, [0.5, 0.6]);
        assert_eq!(c.starts[0].0, [-3.0, 0.0, 2.0]);
        let [low, high] = c.extent_m.unwrap();
        assert!(near(low, [-1.0, -1.0, -3.0]) && near(high, [3.0, 1.0, 3.0]), "{low:?} {high:?}");
    }
}
