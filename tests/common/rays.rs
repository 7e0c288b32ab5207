//! Rays of the native caster against `mj_ray`: the scenes, the count of what differs, and the places where it may.

#![allow(dead_code, reason = "every program that includes this uses its own part of it")]

use propwash::math::quat;
use propwash::random::{Key, Stream, purpose};
use propwash::scene::{GeomType, Pose, Scene, Worker};
use propwash::sense::{Queries, RayPattern, RayPlanes, RayQuery};

use crate::scenes::{build, random_quat};

/// The default groups, as MuJoCo's rays take them.
pub const GROUPS: [u8; 6] = [1, 1, 1, 0, 0, 0];

/// Draws of one test.
pub fn draws(step: u64) -> Stream {
    Key { seed: 23, world: 0, drone: 0, step, purpose: purpose("test of the caster") }.stream()
}

/// The types that the native caster knows itself.
pub fn own_kinds() -> impl Iterator<Item = GeomType> {
    GeomType::ALL.into_iter().filter(|k| *k != GeomType::Sdf)
}

/// A geom of random size at a random place.
pub fn geom_xml(kind: GeomType, s: &mut Stream, i: usize) -> String {
    let r = |s: &mut Stream| s.uniform(0.1, 0.9);
    let q = random_quat(s);
    let p = [0; 3].map(|_| s.uniform(-3.0, 3.0));
    let place =
        format!("name='g{i}' pos='{} {} {}' quat='{} {} {} {}'", p[0], p[1], p[2], q[0], q[1], q[2], q[3]);
    let shape = match kind {
        GeomType::Plane if i.is_multiple_of(2) => "type='plane' size='0 0 1'".to_string(),
        GeomType::Plane if i % 4 == 1 => format!("type='plane' size='{} {} 1'", r(s), r(s)),
        GeomType::Plane => format!("type='plane' size='0 {} 1'", r(s)),
        GeomType::Hfield => "type='hfield' hfield='h'".into(),
        GeomType::Sphere => format!("type='sphere' size='{}'", r(s)),
        GeomType::Capsule => format!("type='capsule' size='{} {}'", r(s), r(s)),
        GeomType::Ellipsoid => format!("type='ellipsoid' size='{} {} {}'", r(s), r(s), r(s)),
        GeomType::Cylinder => format!("type='cylinder' size='{} {}'", r(s), r(s)),
        GeomType::Box => format!("type='box' size='{} {} {}'", r(s), r(s), r(s)),
        GeomType::Mesh => format!("type='mesh' mesh='{}'", if i.is_multiple_of(2) { "m" } else { "n" }),
        GeomType::Sdf => "type='sdf' mesh='m'".into(),
    };
    format!("<geom {place} {shape}/>")
}

/// What the geoms of [`geom_xml`] refer to.
pub fn assets(s: &mut Stream) -> String {
    let heights: Vec<String> = (0..17 * 26).map(|_| format!("{:.4}", s.unit())).collect();
    format!(
        "<asset><hfield name='h' nrow='17' ncol='26' size='1 1.2 0.7 0.2' elevation='{}'/>\
         <mesh name='m' builtin='supertorus' params='24 0.4 1 1' scale='0.7 0.7 0.7'/>\
         <mesh name='n' builtin='supersphere' params='20 1 1' scale='0.6 0.3 0.8'/></asset>",
        heights.join(" ")
    )
}

/// A scene of one type of geom, random poses and sizes.
pub fn zoo(kind: GeomType, s: &mut Stream) -> Scene {
    let geoms: String = (0..12).map(|i| geom_xml(kind, s, i)).collect();
    build(&format!("<mujoco>{}<worldbody>{geoms}</worldbody></mujoco>", assets(s)), &[])
}

/// Geoms of all types that the native caster knows itself.
pub fn mixed(n: usize, s: &mut Stream) -> String {
    let geoms: String = (0..n).map(|i| geom_xml(GeomType::ALL[i % 8], s, i)).collect();
    format!("<mujoco>{}<worldbody>{geoms}</worldbody></mujoco>", assets(s))
}

/// Where rays start: anywhere, in a geom or near one.
pub fn origin(scene: &Scene, worker: &Worker, s: &mut Stream) -> [f64; 3] {
    let pick = s.unit();
    if pick < 0.3 {
        return [0; 3].map(|_| s.uniform(-8.0, 8.0));
    }
    let geom = ((s.unit() * 12.0) as usize).min(scene.geoms().len() - 1);
    let (p, _) = worker.geom_pose(geom).unwrap();
    let reach = if pick < 0.8 { 0.5 } else { 1.5 };
    [0, 1, 2].map(|k| p[k] + s.uniform(-reach, reach))
}

/// How rays of the native caster agree with `mj_ray`.
#[derive(Default)]
pub struct Agreement {
    pub rays: usize,
    pub hits: usize,
    /// One sees something and the other nothing.
    pub flips: usize,
    /// Both see, but not the same geom.
    pub labels: usize,
    /// Relative errors of the ranges at the same geom; ranges below 1 mm count as 1 mm.
    errors: Vec<f64>,
}

impl Agreement {
    /// Casts rays from one point by both, and counts.
    pub fn compare(&mut self, worker: &mut Worker, pose: &Pose, directions: &[[f64; 3]]) {
        let pattern = RayPattern::new(directions).unwrap();
        let (mut range, mut geom) = (vec![0.0; pattern.len()], vec![0; pattern.len()]);
        let planes =
            RayPlanes { range_m: Some(&mut range), geom_id: Some(&mut geom), ..RayPlanes::default() };
        Queries::at(worker).pattern(pose, &pattern, &RayQuery::default(), planes).unwrap();
        for i in 0..pattern.len() {
            let d = quat::rotate(pose.quat_xyzw, pattern.direction(i));
            let truth = worker.ray(pose.pos_m, d, Some(&GROUPS), None).unwrap();
            self.rays += 1;
            let t = f64::from(range[i]);
            let Some(hit) = truth else {
                self.flips += usize::from(t.is_finite());
                assert_eq!(geom[i] < 0, !t.is_finite());
                continue;
            };
            self.hits += 1;
            if !t.is_finite() {
                self.flips += 1;
                continue;
            }
            if geom[i] != hit.geom_id {
                self.labels += 1;
                continue;
            }
            self.errors.push((t - hit.distance).abs() / hit.distance.max(1e-3));
        }
    }

    /// Relative error that a share of all hits does not exceed.
    pub fn error(&mut self, share: f64) -> f64 {
        self.errors.sort_by(f64::total_cmp);
        self.errors[((self.errors.len() - 1) as f64 * share) as usize]
    }

    pub fn add(&mut self, other: Self) {
        self.rays += other.rays;
        self.hits += other.hits;
        self.flips += other.flips;
        self.labels += other.labels;
        self.errors.extend(other.errors);
    }

    /// All of it in words.
    pub fn told(&mut self) -> String {
        let [median, most, worst] = [0.5, 0.999, 1.0].map(|share| self.error(share));
        format!(
            "{} rays, {} hits, {} of hit against miss, {} other geoms; relative error median {median:.1e}, 99.9 % \
             {most:.1e}, worst {worst:.1e}",
            self.rays, self.hits, self.flips, self.labels
        )
    }
}
