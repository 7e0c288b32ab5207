//! What depth and contacts will and will not see in a scene, and why.

use std::collections::HashMap;
use std::fmt;

use serde::Serialize;

use super::GeomType;
use super::model::{GeomInfo, MeshView, ObstacleKind, Scene, SceneSource, Shell};
use super::{SceneError, Worker};
use crate::math::vec3;

/// Whether a sense perceives a geom, and why (not).
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Verdict {
    /// It does.
    pub seen: bool,
    /// The reason where it does not; empty where it does.
    pub reason: String,
}

impl Verdict {
    fn yes() -> Self {
        Self { seen: true, reason: String::new() }
    }

    fn no(reason: impl Into<String>) -> Self {
        Self { seen: false, reason: reason.into() }
    }
}

/// One geom of the scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GeomLint {
    /// Geom id in the scene when it is built without drones. (With drones, ids may be higher; names stay.)
    pub id: usize,
    /// Name, or number with type and body.
    pub name: String,
    /// Name of its body.
    pub body: String,
    /// Shape.
    pub kind: GeomType,
    /// Visibility group.
    pub group: i32,
    /// Depth images with the default groups 0, 1, 2.
    pub depth: Verdict,
    /// Contacts with a drone.
    pub contact: Verdict,
    /// What else is worth knowing.
    pub remarks: Vec<String>,
}

/// What [`lint`] found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LintReport {
    /// The scene.
    pub scene: String,
    /// Where a drone was tried, m.
    pub spawn_m: [f64; 3],
    /// Radius of the drone that was tried, m.
    pub spawn_radius_m: f64,
    /// Every geom, by id.
    pub geoms: Vec<GeomLint>,
    /// What concerns the whole scene.
    pub remarks: Vec<String>,
}

impl LintReport {
    /// Geoms of which depth and contacts disagree, or that neither perceives.
    pub fn mismatches(&self) -> impl Iterator<Item = &GeomLint> {
        self.geoms.iter().filter(|g| !(g.depth.seen && g.contact.seen))
    }

    /// Whether the spawn overlaps something.
    pub fn spawn_is_blocked(&self) -> bool {
        self.geoms.iter().any(|g| g.remarks.iter().any(|r| r.starts_with(SPAWN)))
    }
}

const SPAWN: &str = "overlaps the spawn";

impl fmt::Display for LintReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let wide = |pick: fn(&GeomLint) -> usize, head: usize| {
            self.geoms.iter().map(pick).chain([head]).max().unwrap_or(head)
        };
        let name = wide(|g| g.name.chars().count(), 4);
        let body = wide(|g| g.body.chars().count(), 4);
        writeln!(f, "{}: {} geoms", self.scene, self.geoms.len())?;
        writeln!(
            f,
            "{:>4}  {:name$}  {:body$}  {:9}  {:5}  {:5}  {:7}  notes",
            "id", "geom", "body", "type", "group", "depth", "contact"
        )?;
        let mark = |v: &Verdict| if v.seen { "yes" } else { "NO" };
        for g in &self.geoms {
            let mut notes: Vec<String> = Vec::new();
            if !g.depth.seen {
                notes.push(format!("depth: {}", g.depth.reason));
            }
            if !g.contact.seen {
                notes.push(format!("contact: {}", g.contact.reason));
            }
            notes.extend(g.remarks.iter().cloned());
            let line = format!(
                "{:>4}  {:name$}  {:body$}  {:9}  {:>5}  {:5}  {:7}  {}",
                g.id,
                g.name,
                g.body,
                g.kind.name(),
                g.group,
                mark(&g.depth),
                mark(&g.contact),
                notes.join("; ")
            );
            writeln!(f, "{}", line.trim_end())?;
        }
        let unseen = self.geoms.iter().filter(|g| !g.depth.seen).count();
        let untouched = self.geoms.iter().filter(|g| !g.contact.seen).count();
        writeln!(f, "{unseen} geom(s) unseen by depth, {untouched} without contacts")?;
        for remark in &self.remarks {
            writeln!(f, "note: {remark}")?;
        }
        Ok(())
    }
}

/// Says of every geom whether depth and contacts will perceive it, and what else may surprise.
///
/// A ball of `spawn_radius_m` is put at `spawn_m` to find what a drone would overlap there.
///
/// # Errors
/// [`SceneError`] when the scene cannot be built, or a spawn that makes no sense.
pub fn lint(source: &SceneSource, spawn_m: [f64; 3], spawn_radius_m: f64) -> Result<LintReport, SceneError> {
    if !(spawn_radius_m > 0.0 && spawn_radius_m < 1e6) {
        return Err(SceneError::Argument {
            what: format!("the radius of the spawn must be positive and below 1e6 m, got {spawn_radius_m}"),
        });
    }
    let probe = Shell {
        name: "probe".into(),
        xml: format!(
            "<mujoco><worldbody><body name=\"drone\"><geom type=\"sphere\" size=\"{spawn_radius_m:e}\"/></body>\
             </worldbody></mujoco>"
        ),
        dir: None,
    };
    let scene = Scene::build(source, &[probe])?;
    let mut worker = scene.worker()?;
    worker.set_drone(0, spawn_m, [0.0, 0.0, 0.0, 1.0])?;
    worker.update()?;
    let overlapped = overlaps(&scene, &mut worker)?;

    // By mesh: many geoms may show the same.
    let mut concavities = HashMap::new();
    let mut geoms = Vec::new();
    for info in scene.geoms().iter().filter(|g| g.drone.is_none()) {
        let mut remarks = Vec::new();
        if let Some(depth) = overlapped.get(&info.id) {
            remarks.push(format!("{SPAWN} at {spawn_m:?} m by {:.3} m", -depth));
        }
        shape_remarks(&scene, info, &mut concavities, &mut remarks);
        motion_remarks(&scene, info, &mut remarks);
        twin_remarks(&scene, &worker, info, &mut remarks)?;
        geoms.push(GeomLint {
            id: geoms.len(),
            name: info.label(scene.bodies()),
            body: match scene.bodies()[info.body_id].name.as_str() {
                "" => format!("body#{}", info.body_id),
                name => name.to_string(),
            },
            kind: info.kind,
            group: info.group,
            depth: depth_verdict(info),
            contact: contact_verdict(info),
            remarks,
        });
    }
    let mut remarks: Vec<String> = scene.warnings().to_vec();
    if geoms.is_empty() {
        remarks.push("the scene has no geoms: depth sees nothing, nothing can be touched".into());
    }
    if scene.n_skin() > 0 {
        remarks.push(format!(
            "{} skin(s): drawn only; neither depth nor contacts perceive them",
            scene.n_skin()
        ));
    }
    if worker.ground_distance(0)?.is_none() {
        remarks.push(format!(
            "no floor that can be touched below the spawn {spawn_m:?} m: a drone there falls forever"
        ));
    }
    Ok(LintReport { scene: scene.name().to_string(), spawn_m, spawn_radius_m, geoms, remarks })
}

/// As [`lint`] with a ball of 0.1 m at 1 m above the origin.
///
/// # Errors
/// As [`lint`].
pub fn lint_source(source: &SceneSource) -> Result<LintReport, SceneError> {
    lint(source, [0.0, 0.0, 1.0], 0.1)
}

/// Whether depth images of the usual groups 0, 1, 2 see a geom.
pub(crate) fn depth_verdict(info: &GeomInfo) -> Verdict {
    if info.alpha == 0.0 {
        return Verdict::no("alpha is 0 (geom or material): rays pass through");
    }
    if info.group > 2 {
        return Verdict::no(format!("group {} is hidden; cameras see groups 0, 1, 2 by default", info.group));
    }
    Verdict::yes()
}

/// Whether drones can touch a geom.
pub(crate) fn contact_verdict(info: &GeomInfo) -> Verdict {
    if !info.can_collide() {
        return Verdict::no("contype and conaffinity are 0: drones fly through");
    }
    Verdict::yes()
}

/// Deepest signed distance of each geom that the probe touches.
fn overlaps(
    scene: &Scene,
    worker: &mut Worker,
) -> Result<std::collections::BTreeMap<usize, f64>, SceneError> {
    let mut found = std::collections::BTreeMap::new();
    let own = scene.drone_geoms(0)?.first().map_or(-1, |g| *g as i32);
    for index in 0..worker.collide()? {
        let Some(contact) = worker.contact(index) else { break };
        let [a, b] = contact.geom;
        if contact.distance_m > 0.0 || (a != own && b != own) {
            continue;
        }
        if let Ok(other) = usize::try_from(if a == own { b } else { a }) {
            let depth = found.entry(other).or_insert(0.0f64);
            *depth = depth.min(contact.distance_m);
        }
    }
    Ok(found)
}

fn shape_remarks(
    scene: &Scene,
    info: &GeomInfo,
    concavities: &mut HashMap<String, f64>,
    remarks: &mut Vec<String>,
) {
    if info.alpha > 0.0 && info.alpha < 1.0 {
        remarks.push(format!("looks transparent (alpha {}) but depth sees it as solid", info.alpha));
    }
    if info.margin_m > 0.0 {
        remarks.push(format!("contact margin: contacts are reported from {} m on", info.margin_m));
    }
    match info.kind {
        GeomType::Plane => {
            let [x, y, _] = info.size_m;
            if x > 0.0 || y > 0.0 {
                let side = |s: f64| if s > 0.0 { format!("{} m", 2.0 * s) } else { "endless".into() };
                remarks.push(format!(
                    "depth sees only its rectangle ({} x {}), contacts the endless plane and all that is below",
                    side(x),
                    side(y)
                ));
            } else {
                remarks.push("endless plane; depth sees it from above only".into());
            }
        }
        GeomType::Mesh if info.can_collide() => {
            if let Some(mesh) = scene.mesh(info.id)
                && let Some(hull) = scene.mesh_hull(info.id)
            {
                let depth =
                    *concavities.entry(mesh.name.to_string()).or_insert_with(|| concavity(&mesh, hull));
                let size = info.bounding_radius_m;
                if depth > 0.01 * size {
                    remarks.push(format!(
                        "concave: collision uses the convex hull, depth sees the true surface (up to {depth:.3} m inside)"
                    ));
                }
            }
        }
        GeomType::Sdf => {
            remarks.push(
                "signed distance field: contacts by descent on the field, clearance by its triangles".into(),
            );
        }
        _ => {}
    }
    if info.bounding_radius_m > HUGE_M {
        remarks.push(format!("huge: {:.0} m across; wrong units?", 2.0 * info.bounding_radius_m));
    } else if info.kind != GeomType::Plane && info.bounding_radius_m < TINY_M {
        remarks.push(format!("tiny: {:.1e} m across; wrong units?", 2.0 * info.bounding_radius_m));
    }
}

const HUGE_M: f64 = 1e3;
const TINY_M: f64 = 1e-3;

fn motion_remarks(scene: &Scene, info: &GeomInfo, remarks: &mut Vec<String>) {
    if info.is_static {
        return;
    }
    match scene.bodies()[info.body_id].obstacle.map(|o| &scene.obstacles()[o]) {
        Some(o) => {
            let how = match o.kind {
                ObstacleKind::Mocap => "mocap",
                ObstacleKind::FreeJoint => "free joint",
            };
            remarks.push(format!("moves with obstacle {} '{}' ({how})", o.index, o.name));
        }
        None => remarks.push("on a joint: stays at its reference position".into()),
    }
}

/// A geom that is only seen beside one that is only touched, about as large and in the same place.
fn twin_remarks(
    scene: &Scene,
    worker: &Worker,
    info: &GeomInfo,
    remarks: &mut Vec<String>,
) -> Result<(), SceneError> {
    let sees = |g: &GeomInfo| depth_verdict(g).seen;
    let touches = |g: &GeomInfo| contact_verdict(g).seen;
    if sees(info) == touches(info) || info.kind == GeomType::Plane {
        return Ok(());
    }
    let (at, _) = worker.geom_pose(info.id)?;
    let mut best: Option<(f64, &GeomInfo)> = None;
    for other in scene.geoms() {
        let complement = sees(other) == touches(info) && touches(other) == sees(info);
        if other.id == info.id
            || other.body_id != info.body_id
            || !complement
            || other.kind == GeomType::Plane
        {
            continue;
        }
        let (there, _) = worker.geom_pose(other.id)?;
        let gap = (0..3).map(|k| (at[k] - there[k]).powi(2)).sum::<f64>().sqrt();
        let (a, b) = (info.bounding_radius_m, other.bounding_radius_m);
        if gap < 0.3 * a.max(b) && a.min(b) > 0.6 * a.max(b) && best.is_none_or(|(g, _)| gap < g) {
            best = Some((gap, other));
        }
    }
    if let Some((_, other)) = best {
        let name = other.label(scene.bodies());
        remarks.push(if sees(info) {
            format!("visual shape; {name} seems to be its collision shape")
        } else {
            format!("collision shape; {name} seems to be its visual shape")
        });
    }
    Ok(())
}

/// Names at most in the warning of hollow meshes.
const MOST_NAMES: usize = 4;

/// What has to be known of meshes with hollows that a drone could fly into, since they collide as their convex hulls: their holes are
/// closed. None where there are none.
pub(super) fn hollow_meshes(scene: &Scene) -> Option<String> {
    let mut known: HashMap<&str, [f64; 2]> = HashMap::new();
    let mut hollow: Vec<String> = Vec::new();
    let scenery = |g: &&GeomInfo| g.kind == GeomType::Mesh && g.can_collide() && g.drone.is_none();
    for info in scene.geoms().iter().filter(scenery) {
        let (Some(mesh), Some(hull)) = (scene.mesh(info.id), scene.mesh_hull(info.id)) else { continue };
        let [own, of_hull] = *known.entry(mesh.name).or_insert_with(|| volumes(&mesh, hull));
        let empty = of_hull - own;
        if empty >= HOLLOW_M3 && empty >= HOLLOW_SHARE * of_hull {
            let share = (100.0 * empty / of_hull).min(100.0);
            hollow.push(format!("{} ({share:.0} % of its hull is empty)", info.label(scene.bodies())));
        }
    }
    let n = hollow.len();
    let names = hollow[..n.min(MOST_NAMES)].join(", ");
    let more = if n > MOST_NAMES { ", …" } else { "" };
    let what = match n {
        0 => return None,
        1 => "1 mesh is hollow and collides as its convex hull".to_string(),
        _ => format!("{n} meshes are hollow and collide as their convex hulls"),
    };
    Some(format!(
        "{what}, so that drones crash where depth sees an opening: {names}{more}; for a hole to fly through give the body \
         several convex geoms, and the mesh contype=\"0\" conaffinity=\"0\""
    ))
}

/// Emptiness that a small drone fits into, m³, and which share of a hull it is: less is roughness.
const HOLLOW_M3: f64 = 1e-3;
const HOLLOW_SHARE: f64 = 0.25;

/// Volumes of a mesh and of its hull, m³. That of a mesh with open edges is of little meaning; its hull is hollow.
fn volumes(mesh: &MeshView, hull: &[[i32; 3]]) -> [f64; 2] {
    let at = |v: i32| mesh.vertices_m[v as usize].map(f64::from);
    let first = hull.first().map_or([0.0; 3], |face| at(face[0]));
    // Of the tetrahedron between a face and one corner of the hull.
    let part = |face: &[i32; 3]| {
        let [a, b, c] = face.map(|v| vec3::sub(at(v), first));
        vec3::dot(a, vec3::cross(b, c)) / 6.0
    };
    let own = mesh.faces.iter().map(part).sum::<f64>().abs();
    [own, hull.iter().map(|face| part(face).abs()).sum()]
}

/// How far inside the hull a mesh's surface lies, m: 0 for a convex mesh.
fn concavity(mesh: &MeshView, hull: &[[i32; 3]]) -> f64 {
    let at = |v: i32| mesh.vertices_m[v as usize].map(f64::from);
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let sub = |a: [f64; 3], b: [f64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let mut middle = [0.0; 3];
    let corners = (3 * hull.len()).max(1) as f64;
    for v in hull.iter().flatten() {
        let p = at(*v);
        for k in 0..3 {
            middle[k] += p[k] / corners;
        }
    }
    let planes: Vec<([f64; 3], f64)> = hull
        .iter()
        .filter_map(|f| {
            let (a, b, c) = (at(f[0]), at(f[1]), at(f[2]));
            let n = cross(sub(b, a), sub(c, a));
            let length = dot(n, n).sqrt();
            (length > 1e-14).then(|| {
                let n = n.map(|x| x / length);
                // Outwards, whatever the order of the corners.
                let side = if dot(n, sub(middle, a)) > 0.0 { -1.0 } else { 1.0 };
                let n = n.map(|x| side * x);
                (n, dot(n, a))
            })
        })
        .collect();
    let stride = (mesh.faces.len() * planes.len() / 20_000_000).max(1);
    let mut deepest = 0.0f64;
    for face in mesh.faces.iter().step_by(stride) {
        let [a, b, c] = face.map(at);
        let between = |p: [f64; 3], q: [f64; 3]| [0, 1, 2].map(|k| 0.5 * (p[k] + q[k]));
        let center = [0, 1, 2].map(|k| (a[k] + b[k] + c[k]) / 3.0);
        for p in [a, b, c, between(a, b), between(b, c), between(c, a), center] {
            let mut inside = f64::INFINITY;
            for (n, d) in &planes {
                inside = inside.min(d - dot(*n, p));
                if inside <= deepest {
                    break;
                }
            }
            if inside.is_finite() {
                deepest = deepest.max(inside);
            }
        }
    }
    deepest
}
