//! Contacts, clearances and swept checks against closed forms, brute force and each other.

#[path = "common/scenes.rs"]
mod scenes;

use propwash::math::quat;
use propwash::random::{Key, Stream, purpose};
use propwash::scene::{GeomType, HfieldView, Pose, Scene, SceneError, SceneSource, Shell, Worker};
use propwash::sense::{Collider, Contact, PoseGain, Queries, SenseError, Sweep, SweptHit, TOUCH_M};
use scenes::{build, random_quat};

const LEVEL: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

fn shell(body: &str) -> Shell {
    Shell {
        name: "test".into(),
        xml: format!("<mujoco><worldbody><body name='drone'>{body}</body></worldbody></mujoco>"),
        dir: None,
    }
}

fn ball(radius: f64) -> Shell {
    shell(&format!("<geom name='ball' type='sphere' size='{radius}'/>"))
}

fn draws(step: u64) -> Stream {
    Key { seed: 12, world: 0, drone: 0, step, purpose: purpose("test of contacts") }.stream()
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn norm(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

fn touching(worker: &mut Worker, at: &[[f64; 3]]) -> Vec<Contact> {
    for (drone, pos) in at.iter().enumerate() {
        worker.set_drone(drone, *pos, LEVEL).unwrap();
    }
    worker.update().unwrap();
    let mut found = Vec::new();
    Queries::at(worker).contacts(&mut found).unwrap();
    found
}

#[test]
fn contacts_are_found_with_static_mocap_and_free_bodies_and_other_drones() {
    let xml = r#"<mujoco><worldbody>
        <geom name="floor" type="plane" size="0 0 1"/>
        <geom name="pillar" type="box" size="0.1 0.1 2" pos="2 0 0"/>
        <geom name="sight" type="box" size="0.5 0.5 0.5" pos="0 0 5" contype="0" conaffinity="0"/>
        <geom name="odd bits" type="sphere" size="0.1" pos="0 0 9" contype="0" conaffinity="1073741824"/>
        <body name="gate" mocap="true" pos="4 0 1"><geom name="gate" type="box" size="0.1 0.1 0.1"/></body>
        <body name="crate" pos="6 0 1"><freejoint/><geom name="crate" type="box" size="0.1 0.1 0.1"/></body>
        <body name="door" pos="8 0 1"><joint type="hinge" axis="0 0 1"/><geom name="door" type="box" size="0.1 0.1 0.1"/></body>
        </worldbody></mujoco>"#;
    let scene = build(xml, &[ball(0.1), ball(0.1)]);
    let mut worker = scene.worker().unwrap();
    let away = [50.0, 0.0, 5.0];
    // Where the drone goes, what it touches, the normal from there to the drone.
    let cases: [([f64; 3], &str, [f64; 3]); 6] = [
        ([0.0, 1.0, 0.09], "floor", [0.0, 0.0, 1.0]),
        ([2.19, 0.0, 1.0], "pillar", [1.0, 0.0, 0.0]),
        ([4.0, -0.19, 1.0], "gate", [0.0, -1.0, 0.0]),
        ([6.0, 0.0, 1.19], "crate", [0.0, 0.0, 1.0]),
        ([8.0, 0.0, 0.81], "door", [0.0, 0.0, -1.0]),
        ([0.0, 0.19, 9.0], "odd bits", [0.0, 1.0, 0.0]),
    ];
    for drone in 0..2 {
        for (pos, name, normal) in cases {
            let mut at = [away; 2];
            at[drone] = pos;
            at[1 - drone][0] += 1.0;
            let found = touching(&mut worker, &at);
            assert_eq!(found.len(), 1, "{name}: {found:?}");
            let c = found[0];
            assert_eq!((c.drone, c.other_drone), (drone, None), "{name}");
            assert_eq!(scene.geoms()[c.other_geom as usize].name, name);
            assert_eq!(scene.geoms()[c.drone_geom as usize].name, format!("drone{drone}/ball"));
            assert_eq!(c.other_body as usize, scene.geoms()[c.other_geom as usize].body_id);
            assert_eq!(c.drone_body as usize, scene.drone_body(drone).unwrap());
            assert!((c.distance_m + 0.01).abs() < 1e-6 && c.touches(), "{name} {}", c.distance_m);
            assert!(norm(sub(c.normal, normal)) < 1e-6, "{name} {:?}", c.normal);
            // The point lies half way into the overlap.
            let expected = [0, 1, 2].map(|k| pos[k] - 0.095 * normal[k]);
            assert!(norm(sub(c.point_m, expected)) < 1e-6, "{name} {:?} {expected:?}", c.point_m);
        }
    }
    assert_eq!(touching(&mut worker, &[[0.0, 0.0, 5.0], away]), []);
    let two = touching(&mut worker, &[[20.0, 0.0, 3.0], [20.15, 0.0, 3.0]]);
    assert_eq!(two.len(), 1);
    assert_eq!((two[0].drone, two[0].other_drone), (0, Some(1)));
    assert!((two[0].distance_m + 0.05).abs() < 1e-12 && norm(sub(two[0].normal, [-1.0, 0.0, 0.0])) < 1e-9);
    assert!(two[0].involves(1) && !two[0].involves(2));
    // The obstacle that was moved is touched where it is now.
    let gate = scene.obstacle("gate").unwrap().index;
    worker.set_obstacle(gate, [30.0, 0.0, 3.0], LEVEL).unwrap();
    let moved = touching(&mut worker, &[[30.0, 0.0, 3.15], away]);
    assert_eq!(moved.len(), 1);
    assert_eq!(scene.geoms()[moved[0].other_geom as usize].name, "gate");
    let crate_ = scene.obstacle("crate").unwrap().index;
    worker.set_obstacle(crate_, [31.0, 0.0, 3.0], LEVEL).unwrap();
    let moved = touching(&mut worker, &[[31.0, 0.0, 3.15], away]);
    assert_eq!(scene.geoms()[moved[0].other_geom as usize].name, "crate");
}

#[test]
fn a_drone_does_not_touch_itself() {
    let folded = shell(
        "<geom type='sphere' size='0.2'/><geom type='sphere' size='0.2' pos='0.1 0 0'/>\
         <body><joint type='hinge'/><geom type='sphere' size='0.2'/></body>\
         <body><joint type='hinge'/><geom type='sphere' size='0.2'/></body>",
    );
    let scene = build("<mujoco/>", &[folded]);
    let mut worker = scene.worker().unwrap();
    assert_eq!(touching(&mut worker, &[[0.0; 3]]), []);
    let c = Queries::at(&mut worker).clearance(0, 5.0).unwrap();
    assert!(!c.found && c.distance_m == 5.0);
}

#[test]
fn no_contact_is_lost_where_there_are_thousands() {
    let n = 60;
    let scene = build("<mujoco/>", &vec![ball(0.5); n]);
    let mut worker = scene.worker().unwrap();
    // Every pair of drones touches.
    let found = touching(&mut worker, &(0..n).map(|i| [1e-3 * i as f64, 0.0, 0.0]).collect::<Vec<_>>());
    assert_eq!(found.len(), n * (n - 1) / 2);
    // The same for one drone in a field of many geoms.
    let pins: String = (0..2000)
        .map(|i| {
            format!(
                "<geom type='sphere' size='0.01' pos='{} {} 0'/>",
                0.001 * (i % 50) as f64,
                0.001 * (i / 50) as f64
            )
        })
        .collect();
    let scene = build(&format!("<mujoco><worldbody>{pins}</worldbody></mujoco>"), &[ball(1.0)]);
    let found = touching(&mut scene.worker().unwrap(), &[[0.0, 0.0, 0.5]]);
    assert_eq!(found.len(), 2000);
}

#[test]
fn contacts_that_do_not_fit_are_an_error_and_not_fewer_contacts() {
    let boxes: String = (0..30)
        .map(|i| {
            format!(
                "<body pos='0 0 {}'><freejoint/><geom type='box' size='1 1 1'/></body>",
                0.01 * f64::from(i)
            )
        })
        .collect();
    let options = propwash::scene::BuildOptions { raise_memory: false };
    for memory in ["100K", "400K"] {
        let xml = format!("<mujoco><size memory='{memory}'/><worldbody>{boxes}</worldbody></mujoco>");
        let source = SceneSource::text("full", xml);
        let scene = Scene::build_with(&source, &[ball(0.1)], options).unwrap();
        let mut worker = scene.worker().unwrap();
        let mut found = Vec::new();
        for _ in 0..3 {
            let error = Queries::by(Collider::MuJoCo, &mut worker).contacts(&mut found).unwrap_err();
            let message = error.to_string();
            assert!(message.contains("memory"), "{message}");
            assert!(
                matches!(
                    error,
                    SenseError::Scene(SceneError::Engine { .. } | SceneError::ContactsLost { .. })
                ),
                "{message}"
            );
            // The process lives and the worker can still be used.
            worker.set_drone(0, [3.0, 0.0, 0.25], LEVEL).unwrap();
            worker.update().unwrap();
            let c = Queries::at(&mut worker).clearance(0, 10.0).unwrap();
            assert!((c.distance_m - 1.9).abs() < 1e-6, "{c:?}");
        }
        // The native collider has no arena to fill.
        assert_eq!(Queries::at(&mut worker).contacts(&mut found).unwrap(), 0);
        // With room, all is found.
        let roomy = Scene::build(&source, &[ball(0.1)]).unwrap();
        Queries::by(Collider::MuJoCo, &mut roomy.worker().unwrap()).contacts(&mut found).unwrap();
        assert!(found.len() >= 30, "{}", found.len());
    }
}

#[test]
fn a_pair_with_more_contacts_than_mujoco_reports_is_said() {
    let heights: Vec<String> = (0..3600).map(|i| if i % 2 == 0 { "1" } else { "0" }.to_string()).collect();
    let xml = format!(
        "<mujoco><asset><hfield name='h' nrow='60' ncol='60' size='1 1 0.05 0.1' elevation='{}'/></asset><worldbody>\
         <geom type='hfield' hfield='h'/></worldbody></mujoco>",
        heights.join(" ")
    );
    let scene = build(&xml, &[shell("<geom type='box' size='0.5 0.5 0.1'/>")]);
    let mut worker = scene.worker().unwrap();
    worker.set_drone(0, [0.0, 0.0, 0.1], LEVEL).unwrap();
    worker.update().unwrap();
    let mut found = Vec::new();
    assert_eq!(Queries::at(&mut worker).contacts(&mut found).unwrap(), 1);
    assert_eq!(found.len(), propwash::sense::MAX_PER_PAIR);
    let c = Queries::at(&mut worker).clearance(0, 1.0).unwrap();
    assert!(c.distance_m <= 0.0 && !c.exact, "{c:?}");
    worker.set_drone(0, [0.0, 0.0, 0.3], LEVEL).unwrap();
    worker.update().unwrap();
    assert_eq!(Queries::at(&mut worker).contacts(&mut found).unwrap(), 0);
    let c = Queries::at(&mut worker).clearance(0, 1.0).unwrap();
    assert!(c.exact && (c.distance_m - 0.15).abs() < 1e-6, "{c:?}");
}

#[test]
fn the_deepest_of_many_overlaps_is_the_clearance() {
    let xml = "<mujoco><worldbody><geom type='box' size='1 1 1' pos='0 0 0.05'/><geom type='box' size='1 1 1' pos='0 0 -0.3'/>
        <geom type='sphere' size='0.1' pos='0 0 1.2'/></worldbody></mujoco>";
    let scene = build(xml, &[ball(0.2), ball(0.2)]);
    let mut worker = scene.worker().unwrap();
    // 0.15 into the upper box, 0.2 into the sphere, 0.3 into the other drone.
    worker.set_drone(0, [0.0, 0.0, 1.1], LEVEL).unwrap();
    worker.set_drone(1, [0.1, 0.0, 1.1], LEVEL).unwrap();
    worker.update().unwrap();
    let c = Queries::at(&mut worker).clearance(0, 1.0).unwrap();
    assert!((c.distance_m + 0.3).abs() < 1e-9 && c.other_drone == Some(1), "{c:?}");
    worker.set_drone(1, [9.0, 0.0, 1.1], LEVEL).unwrap();
    worker.update().unwrap();
    let c = Queries::at(&mut worker).clearance(0, 1.0).unwrap();
    assert!((c.distance_m + 0.2).abs() < 1e-9 && c.other_geom == 2, "{c:?}");
}

/// Distance of a point to a segment.
fn to_segment(p: [f64; 3], a: [f64; 3], b: [f64; 3]) -> f64 {
    let (ab, ap) = (sub(b, a), sub(p, a));
    let t = (dot(ab, ap) / dot(ab, ab).max(1e-300)).clamp(0.0, 1.0);
    norm(sub(ap, ab.map(|x| t * x)))
}

/// Distance of a point to a triangle: to its plane where the foot lies inside, else to the sides.
fn to_triangle(p: [f64; 3], [a, b, c]: [[f64; 3]; 3]) -> f64 {
    let cross = |u: [f64; 3], v: [f64; 3]| {
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    };
    let n = cross(sub(b, a), sub(c, a));
    let sides = to_segment(p, a, b).min(to_segment(p, b, c)).min(to_segment(p, c, a));
    let length = norm(n);
    if length < 1e-12 {
        return sides;
    }
    let inside = [(a, b), (b, c), (c, a)].iter().all(|(u, v)| dot(cross(sub(*v, *u), sub(p, *u)), n) >= 0.0);
    if inside { sides.min(dot(sub(p, a), n).abs() / length) } else { sides }
}

/// Distance of a point outside to a geom at the origin, without MuJoCo; none where the point is inside.
fn oracle(scene: &Scene, geom: usize, p: [f64; 3]) -> Option<f64> {
    let g = &scene.geoms()[geom];
    let s = g.size_m;
    let rho = (p[0] * p[0] + p[1] * p[1]).sqrt();
    let outside = |d: f64| (d > 0.0).then_some(d);
    match g.kind {
        GeomType::Plane => outside(p[2]),
        GeomType::Sphere => outside(norm(p) - s[0]),
        GeomType::Capsule => outside(to_segment(p, [0.0, 0.0, -s[1]], [0.0, 0.0, s[1]]) - s[0]),
        GeomType::Cylinder => {
            let (a, b) = ((rho - s[0]).max(0.0), (p[2].abs() - s[1]).max(0.0));
            outside((a * a + b * b).sqrt())
        }
        GeomType::Box => outside(norm([0, 1, 2].map(|k| (p[k].abs() - s[k]).max(0.0)))),
        GeomType::Ellipsoid => to_ellipsoid(s, p),
        GeomType::Mesh | GeomType::Sdf => to_mesh(scene, geom, p),
        GeomType::Hfield => to_hfield(&scene.hfield(geom)?, p),
    }
}

/// As [`oracle`], of an ellipsoid with half axes `s`.
fn to_ellipsoid(s: [f64; 3], p: [f64; 3]) -> Option<f64> {
    if (0..3).map(|k| (p[k] / s[k]).powi(2)).sum::<f64>() <= 1.0 {
        return None;
    }
    // The foot x solves x_k = s_k² p_k / (s_k² + t) with sum (x_k / s_k)² = 1; t by bisection.
    let f = |t: f64| (0..3).map(|k| (s[k] * p[k] / (s[k] * s[k] + t)).powi(2)).sum::<f64>() - 1.0;
    let (mut low, mut high) = (0.0, 10.0 * norm(p));
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if f(middle) > 0.0 { low = middle } else { high = middle }
    }
    Some(norm([0, 1, 2].map(|k| p[k] - s[k] * s[k] * p[k] / (s[k] * s[k] + low))))
}

/// As [`oracle`], of the triangles of a mesh; of a signed distance field every point counts as outside.
fn to_mesh(scene: &Scene, geom: usize, p: [f64; 3]) -> Option<f64> {
    let is_sdf = scene.geoms()[geom].kind == GeomType::Sdf;
    let mesh = scene.mesh(geom)?;
    let hull = if is_sdf { mesh.faces } else { scene.mesh_hull(geom)? };
    let at = |v: i32| mesh.vertices_m[v as usize].map(f64::from);
    let middle = [0.0; 3];
    let mut best = f64::INFINITY;
    let mut is_outside = is_sdf;
    for f in hull {
        let t = f.map(at);
        best = best.min(to_triangle(p, t));
        let (u, v) = (sub(t[1], t[0]), sub(t[2], t[0]));
        let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        // On the other side of a face than the middle of the hull.
        is_outside |= dot(n, sub(p, t[0])) * dot(n, sub(middle, t[0])) < 0.0;
    }
    is_outside.then_some(best)
}

/// As [`oracle`], of a height field: its surface, its sides down to the base, and the base.
fn to_hfield(h: &HfieldView, p: [f64; 3]) -> Option<f64> {
    let [rx, ry, rz, base] = h.size_m;
    let x = |c: usize| -rx + 2.0 * rx * c as f64 / (h.n_col - 1) as f64;
    let y = |r: usize| -ry + 2.0 * ry * r as f64 / (h.n_row - 1) as f64;
    let z = |r: usize, c: usize| rz * f64::from(h.data[r * h.n_col + c]);
    let at = |r: usize, c: usize| [x(c), y(r), z(r, c)];
    let foot = |r: usize, c: usize| [x(c), y(r), -base];
    let mut best = f64::INFINITY;
    let mut quad = |a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]| {
        best = best.min(to_triangle(p, [a, b, c])).min(to_triangle(p, [a, c, d]));
    };
    for r in 0..h.n_row - 1 {
        for c in 0..h.n_col - 1 {
            // MuJoCo splits a cell along the diagonal from (r, c) to (r + 1, c + 1).
            quad(at(r, c), at(r, c + 1), at(r + 1, c + 1), at(r + 1, c));
        }
    }
    for r in 0..h.n_row - 1 {
        for c in [0, h.n_col - 1] {
            quad(at(r, c), at(r + 1, c), foot(r + 1, c), foot(r, c));
        }
    }
    for c in 0..h.n_col - 1 {
        for r in [0, h.n_row - 1] {
            quad(at(r, c), at(r, c + 1), foot(r, c + 1), foot(r, c));
        }
    }
    quad(foot(0, 0), foot(0, h.n_col - 1), foot(h.n_row - 1, h.n_col - 1), foot(h.n_row - 1, 0));
    (!is_in_hfield(h, p)).then_some(best)
}

fn is_in_hfield(h: &HfieldView, p: [f64; 3]) -> bool {
    let [rx, ry, rz, base] = h.size_m;
    if p[0].abs() >= rx || p[1].abs() >= ry || p[2] <= -base {
        return false;
    }
    let z = |r: usize, c: usize| rz * f64::from(h.data[r * h.n_col + c]);
    let c = (p[0] + rx) / (2.0 * rx) * (h.n_col - 1) as f64;
    let r = (p[1] + ry) / (2.0 * ry) * (h.n_row - 1) as f64;
    let (c0, r0) = (c.floor() as usize, r.floor() as usize);
    let (u, v) = (c - c0 as f64, r - r0 as f64);
    let (here, across) = (z(r0, c0), z(r0 + 1, c0 + 1));
    // The two triangles of the cell, as MuJoCo splits it.
    let top = if u > v {
        here * (1.0 - u) + z(r0, c0 + 1) * (u - v) + across * v
    } else {
        here * (1.0 - v) + z(r0 + 1, c0) * (v - u) + across * u
    };
    p[2] < top
}

fn geom_xml(kind: GeomType, s: &mut Stream) -> (String, String) {
    let r = |s: &mut Stream| s.uniform(0.15, 0.8);
    let shape = match kind {
        GeomType::Plane => "type='plane' size='0 0 1'".to_string(),
        GeomType::Hfield => "type='hfield' hfield='h'".into(),
        GeomType::Sphere => format!("type='sphere' size='{}'", r(s)),
        GeomType::Capsule => format!("type='capsule' size='{} {}'", r(s), r(s)),
        GeomType::Ellipsoid => format!("type='ellipsoid' size='{} {} {}'", r(s), r(s), r(s)),
        GeomType::Cylinder => format!("type='cylinder' size='{} {}'", r(s), r(s)),
        GeomType::Box => format!("type='box' size='{} {} {}'", r(s), r(s), r(s)),
        GeomType::Mesh => "type='mesh' mesh='m'".into(),
        GeomType::Sdf => "type='sdf' mesh='s'".into(),
    };
    let heights: Vec<String> = (0..42).map(|_| format!("{:.4}", s.unit())).collect();
    let points: Vec<String> = (0..60).map(|_| format!("{:.4}", s.uniform(-0.8, 0.8))).collect();
    let assets = format!(
        "<asset><hfield name='h' nrow='6' ncol='7' size='1 1.2 0.7 0.2' elevation='{}'/><mesh name='m' vertex='{}'/>\
         <mesh name='s' builtin='supertorus' params='12 0.4 1 1' scale='0.7 0.7 0.7'/></asset>",
        heights.join(" "),
        points.join(" ")
    );
    (assets, shape)
}

#[test]
fn clearance_of_a_ball_agrees_with_closed_forms_for_every_type() {
    println!("type       cases  |error| m: median  99%     worst");
    for kind in GeomType::ALL {
        let mut s = draws(kind as u64);
        let mut errors = Vec::new();
        let mut mujoco_differs = 0;
        for _ in 0..12 {
            let (assets, shape) = geom_xml(kind, &mut s);
            let q = random_quat(&mut s);
            let p = [s.uniform(-3.0, 3.0), s.uniform(-3.0, 3.0), s.uniform(-3.0, 3.0)];
            let xml = format!(
                "<mujoco>{assets}<worldbody><geom pos='{} {} {}' quat='{} {} {} {}' {shape}/></worldbody></mujoco>",
                p[0], p[1], p[2], q[0], q[1], q[2], q[3]
            );
            let radius = s.uniform(0.02, 0.3);
            let scene = build(&xml, &[ball(radius)]);
            let mut worker = scene.worker().unwrap();
            for _ in 0..60 {
                let away = [0; 3].map(|_| s.uniform(-1.8, 1.8));
                let pos = [0, 1, 2].map(|k| p[k] + away[k]);
                worker.set_drone(0, pos, LEVEL).unwrap();
                worker.update().unwrap();
                let (gp, gm) = worker.geom_pose(0).unwrap();
                let d = sub(pos, gp);
                let local = [0, 1, 2].map(|k| gm[k] * d[0] + gm[3 + k] * d[1] + gm[6 + k] * d[2]);
                let Some(expected) = oracle(&scene, 0, local) else { continue };
                let c = Queries::at(&mut worker).clearance(0, 100.0).unwrap();
                let own = scene.drone_geoms(0).unwrap()[0];
                let by_mujoco = worker.geom_distance(own, 0, 100.0).unwrap().distance_m;
                mujoco_differs += usize::from((by_mujoco - c.distance_m).abs() > 1e-3);

                // Inside a signed distance field only the sign is checked, by the winding number.
                if kind == GeomType::Sdf && c.distance_m < -radius {
                    continue;
                }
                assert!(c.found && c.exact && c.other_geom == 0, "{kind}");
                let error = (c.distance_m - (expected - radius)).abs();
                assert!(error < 3e-4, "{kind} {local:?}: {} expected {}", c.distance_m, expected - radius);
                // The closest points are as far apart as the distance says, and one lies on the ball.
                let gap = norm(sub(c.on_drone_m, c.on_other_m));
                assert!((gap - c.distance_m.abs()).abs() < 1e-5, "{kind} {gap} {}", c.distance_m);
                assert!((norm(sub(c.on_drone_m, pos)) - radius).abs() < 1e-4, "{kind}");
                errors.push(error);
                // Nothing is nearer than a smaller maximum.
                let max = 0.5 * c.distance_m;
                if max > 1e-3 {
                    let none = Queries::at(&mut worker).clearance(0, max).unwrap();
                    assert!(!none.found && none.distance_m == max);
                }
            }
        }
        errors.sort_by(f64::total_cmp);
        let q = |p: f64| errors[((errors.len() - 1) as f64 * p) as usize];
        println!(
            "{:9}  {:5}             {:.1e} {:.1e} {:.1e}; mj_geomDistance differs by more than 1 mm in {mujoco_differs}",
            kind.name(),
            errors.len(),
            q(0.5),
            q(0.99),
            q(1.0)
        );
        assert!(errors.len() > 250, "{kind}: {}", errors.len());
        let limit = match kind {
            GeomType::Ellipsoid | GeomType::Mesh | GeomType::Hfield | GeomType::Sdf | GeomType::Cylinder => {
                2e-5
            }
            _ => 1e-9,
        };
        assert!(q(0.99) < limit, "{kind}: {}", q(0.99));
    }
}

#[test]
fn clearance_of_a_box_agrees_with_points_on_its_faces() {
    let half = [0.3, 0.2, 0.1];
    let mut s = draws(100);
    let mut cases = 0;
    for _ in 0..30 {
        let size = [0; 3].map(|_| s.uniform(0.1, 0.6));
        let xml = format!(
            "<mujoco><worldbody><geom type='box' size='{} {} {}'/></worldbody></mujoco>",
            size[0], size[1], size[2]
        );
        let scene = build(&xml, &[shell("<geom type='box' size='0.3 0.2 0.1'/>")]);
        let mut worker = scene.worker().unwrap();
        for _ in 0..10 {
            let (pos, q) = ([0; 3].map(|_| s.uniform(-1.2, 1.2)), random_quat(&mut s));
            worker.set_drone(0, pos, q).unwrap();
            worker.update().unwrap();
            let c = Queries::at(&mut worker).clearance(0, 9.0).unwrap();
            let mut sampled = f64::INFINITY;
            const N: i32 = 40;
            for axis in 0..3 {
                for side in [-1.0, 1.0] {
                    for i in 0..=N {
                        for j in 0..=N {
                            let mut p = [0.0; 3];
                            p[axis] = side * half[axis];
                            p[(axis + 1) % 3] =
                                half[(axis + 1) % 3] * (2.0 * f64::from(i) / f64::from(N) - 1.0);
                            p[(axis + 2) % 3] =
                                half[(axis + 2) % 3] * (2.0 * f64::from(j) / f64::from(N) - 1.0);
                            let w = quat::rotate(q, p);
                            let w = [0, 1, 2].map(|k| pos[k] + w[k]);
                            sampled = sampled.min(norm([0, 1, 2].map(|k| (w[k].abs() - size[k]).max(0.0))));
                        }
                    }
                }
            }
            if sampled > 0.0 {
                // Samples lie 0.015 m apart: the nearest is at most 0.0107 m from the true closest point.
                assert!(
                    c.distance_m <= sampled + 1e-6 && c.distance_m > sampled - 0.011,
                    "{} {sampled}",
                    c.distance_m
                );
                cases += 1;
            } else {
                assert!(c.distance_m <= 1e-6, "{}", c.distance_m);
            }
        }
    }
    assert!(cases > 100, "{cases}");
}

/// Where the drone penetrates, clearance is the deepest contact; where contacts say nothing, it is positive.
/// The direction in which a distance grows, and what turning gains, against distances at moved and turned poses.
#[test]
fn slopes_of_clearances_are_those_of_moved_drones_for_every_type() {
    const H: f64 = 1e-5;
    for kind in GeomType::ALL {
        let mut s = draws(400 + kind as u64);
        let mut off = Vec::new();
        for _ in 0..12 {
            let (assets, shape) = geom_xml(kind, &mut s);
            let q = random_quat(&mut s);
            let xml = format!(
                "<mujoco>{assets}<worldbody><geom quat='{} {} {} {}' {shape}/></worldbody></mujoco>",
                q[0], q[1], q[2], q[3]
            );
            let body = "<geom type='capsule' size='0.05' fromto='-0.1 0 0.02 0.15 0.05 0'/>";
            let scene = build(&xml, &[shell(body)]);
            let mut worker = scene.worker().unwrap();
            let mut at = |pose: &Pose| {
                worker.set_drone(0, pose.pos_m, pose.quat_xyzw).unwrap();
                worker.update().unwrap();
                Queries::at(&mut worker).clearance(0, 100.0).unwrap()
            };
            for _ in 0..20 {
                let pose = Pose::new([0; 3].map(|_| s.uniform(-1.8, 1.8)), random_quat(&mut s));
                let near = at(&pose);
                // The depth of penetrations is searched for by MuJoCo, to a tolerance that differences would see.
                let Some(away) = near.away().filter(|_| near.distance_m > 1e-2) else { continue };
                assert!((norm(away) - 1.0).abs() < 1e-12);
                let mut gain = PoseGain::default();
                gain.add(away, near.on_drone_m);
                let turn = gain.by_rotation(pose.pos_m);
                let mut worst = 0.0f64;
                for axis in 0..6 {
                    let moved = |step: f64| {
                        let mut along = [0.0; 3];
                        along[axis % 3] = step;
                        match axis {
                            0..3 => Pose::new([0, 1, 2].map(|k| pose.pos_m[k] + along[k]), pose.quat_xyzw),
                            _ => Pose::new(pose.pos_m, quat::mul(quat::exp(along), pose.quat_xyzw)),
                        }
                    };
                    let measured = (at(&moved(H)).distance_m - at(&moved(-H)).distance_m) / (2.0 * H);
                    let said = if axis < 3 { away[axis] } else { turn[axis - 3] };
                    worst = worst.max((said - measured).abs());
                }
                off.push(worst);
            }
        }
        off.sort_by(f64::total_cmp);
        let q = |p: f64| off[((off.len() - 1) as f64 * p) as usize];
        println!(
            "{kind}: {} poses, off by {:.0e}, 95 % {:.0e}, worst {:.0e}",
            off.len(),
            q(0.5),
            q(0.95),
            q(1.0)
        );
        // Where two points are equally near, on an edge between two faces, the two sides have different slopes.
        assert!(
            off.len() > 80 && q(0.5) < 1e-4 && q(0.95) < 1e-2,
            "{kind}: {} {} {}",
            off.len(),
            q(0.5),
            q(0.95)
        );
    }
}

#[test]
fn distances_without_a_direction_have_no_slope() {
    let scene =
        build("<mujoco><worldbody><geom type='box' size='1 1 1'/></worldbody></mujoco>", &[ball(0.1)]);
    let mut worker = scene.worker().unwrap();
    let mut away = |x: f64, most: f64| {
        worker.set_drone(0, [x, 0.2, 0.1], LEVEL).unwrap();
        worker.update().unwrap();
        Queries::at(&mut worker).clearance(0, most).unwrap().away()
    };
    // Far, in front of a face, within it, and touching it.
    assert_eq!(away(9.0, 1.0), None);
    for x in [1.5, 1.05] {
        let direction = away(x, 1.0).unwrap();
        assert!(norm(sub(direction, [1.0, 0.0, 0.0])) < 1e-6, "{x}: {direction:?}");
    }
    assert_eq!(away(1.1, 1.0), None);
}

#[test]
fn clearance_and_contacts_agree_about_touching() {
    for kind in GeomType::ALL {
        let mut s = draws(200 + kind as u64);
        let (mut touching_cases, mut free_cases) = (0, 0);
        for _ in 0..8 {
            let (assets, shape) = geom_xml(kind, &mut s);
            let scene = build(
                &format!("<mujoco>{assets}<worldbody><geom {shape}/></worldbody></mujoco>"),
                &[ball(0.15)],
            );
            let mut worker = scene.worker().unwrap();
            let mut found = Vec::new();
            for _ in 0..60 {
                worker.set_drone(0, [0; 3].map(|_| s.uniform(-1.2, 1.2)), LEVEL).unwrap();
                worker.update().unwrap();
                Queries::at(&mut worker).contacts(&mut found).unwrap();
                let c = Queries::at(&mut worker).clearance(0, 50.0).unwrap();
                let deepest = found.iter().map(|c| c.distance_m).fold(f64::INFINITY, f64::min);
                if c.distance_m < -2e-2 && (kind != GeomType::Sdf || c.distance_m > -0.13) {
                    assert!(!found.is_empty(), "{kind} {c:?}");
                    touching_cases += 1;
                    if !matches!(kind, GeomType::Sdf | GeomType::Hfield) && c.distance_m > -0.14 {
                        assert!((deepest - c.distance_m).abs() < 1e-4, "{kind}: {deepest} {c:?}");
                    }
                } else if c.distance_m > 2e-2 {
                    assert!(found.is_empty(), "{kind} {c:?} {found:?}");
                    free_cases += 1;
                }
            }
        }
        println!("{:9} touching {touching_cases} free {free_cases}", kind.name());
        assert!(touching_cases > 10 && free_cases > 50, "{kind}: {touching_cases} {free_cases}");
    }
}

#[test]
fn clearance_names_the_nearest_of_many_and_counts_other_drones() {
    let mut s = draws(300);
    let geoms: String = (0..300)
        .map(|i| {
            format!(
                "<geom name='g{i}' type='box' size='{} {} {}' pos='{} {} {}' euler='{} {} 0'/>",
                s.uniform(0.05, 0.5),
                s.uniform(0.05, 0.5),
                s.uniform(0.05, 0.5),
                s.uniform(-9.0, 9.0),
                s.uniform(-9.0, 9.0),
                s.uniform(0.0, 5.0),
                s.uniform(0.0, 90.0),
                s.uniform(0.0, 90.0)
            )
        })
        .collect();
    let scene = build(&format!("<mujoco><worldbody>{geoms}</worldbody></mujoco>"), &[ball(0.1), ball(0.1)]);
    let mut worker = scene.worker().unwrap();
    let mut by_drone = 0;
    for _ in 0..200 {
        let pos = [s.uniform(-9.0, 9.0), s.uniform(-9.0, 9.0), s.uniform(0.0, 5.0)];
        worker.set_drone(0, pos, LEVEL).unwrap();
        worker.set_drone(1, [0, 1, 2].map(|k| pos[k] + s.uniform(-1.5, 1.5)), LEVEL).unwrap();
        worker.update().unwrap();
        let c = Queries::at(&mut worker).clearance(0, 30.0).unwrap();
        let own = scene.drone_geoms(0).unwrap()[0];
        let mut best = (f64::INFINITY, 0);
        for g in scene.geoms().iter().filter(|g| g.drone != Some(0)) {
            let d = worker.geom_distance(own, g.id, 30.0).unwrap().distance_m;
            if d < best.0 {
                best = (d, g.id);
            }
        }
        assert!((c.distance_m - best.0).abs() < 1e-9, "{c:?} {best:?}");
        assert_eq!(c.other_drone, scene.geoms()[c.other_geom as usize].drone);
        by_drone += usize::from(c.other_drone == Some(1));
    }
    assert!(by_drone > 10, "{by_drone}");
    assert!(Queries::at(&mut worker).clearance(7, 1.0).is_err());
    assert!(Queries::at(&mut worker).clearance(0, f64::NAN).is_err());
}

#[test]
fn a_fast_drone_does_not_tunnel_through_a_thin_wall() {
    let xml = "<mujoco><worldbody><geom name='foil' type='box' size='0.0005 2 2' pos='1 0 0'/></worldbody></mujoco>";
    let scene = build(xml, &[shell("<geom type='box' size='0.1 0.1 0.02'/>")]);
    let mut worker = scene.worker().unwrap();
    // 30 m/s for 20 ms: 0.6 m.
    let (from, to) = (Pose::new([0.7, 0.0, 0.0], LEVEL), Pose::new([1.3, 0.0, 0.0], LEVEL));
    for end in [from, to] {
        worker.set_drone(0, end.pos_m, LEVEL).unwrap();
        worker.update().unwrap();
        assert!(Queries::at(&mut worker).clearance(0, 1.0).unwrap().distance_m > 0.1);
    }
    let hit = Queries::at(&mut worker).swept(&Sweep::new(0, from, to)).unwrap().unwrap();
    // The front face at x + 0.1 meets 0.9995.
    assert!((hit.fraction - 0.1995 / 0.6).abs() < 1e-4, "{hit:?}");
    assert_eq!(scene.geoms()[hit.other_geom as usize].name, "foil");
    assert!(
        norm(sub(hit.normal, [-1.0, 0.0, 0.0])) < 1e-2 && (hit.point_m[0] - 0.9995).abs() < 1e-4,
        "{hit:?}"
    );
    let back = Queries::at(&mut worker).swept(&Sweep::new(0, to, from)).unwrap().unwrap();
    assert!((back.fraction - 0.1995 / 0.6).abs() < 1e-4);
    // Along the wall, 1 mm away, at 30 m/s: nothing; and the worker's pose was left alone.
    let (a, b) = (Pose::new([0.8985, -1.0, 0.0], LEVEL), Pose::new([0.8985, 1.0, 0.0], LEVEL));
    assert_eq!(Queries::at(&mut worker).swept(&Sweep::new(0, a, b)).unwrap(), None);
    assert_eq!(worker.drone_pose(0).unwrap(), to);
    assert!(Queries::at(&mut worker).clearance(0, 1.0).unwrap().distance_m > 0.1);
    // Spinning past it: the corner reaches 0.1414 m out.
    let h = (0.25 * std::f64::consts::PI).sin();
    let (a, b) = (Pose::new([0.88, 0.0, 0.0], LEVEL), Pose::new([0.88, 0.0, 0.0], [0.0, 0.0, h, h]));
    let spin = Queries::at(&mut worker).swept(&Sweep::new(0, a, b)).unwrap().unwrap();
    // 0.1 (cos a + sin a) = 0.1195.
    let angle = (0.1195f64 / 0.02f64.sqrt()).asin() - std::f64::consts::FRAC_PI_4;
    assert!((spin.fraction - angle / std::f64::consts::FRAC_PI_2).abs() < 1e-3, "{} {angle}", spin.fraction);
    assert!(Queries::at(&mut worker).swept(&Sweep::new(0, Pose::new([f64::NAN; 3], LEVEL), to)).is_err());
}

/// Sixteen geoms of six kinds anywhere, in every third scene above a height field, and a drone of three geoms.
fn crowded(round: usize, s: &mut Stream) -> Scene {
    let mut geoms = String::new();
    let mut assets = String::new();
    for i in 0..16 {
        let kinds = [
            GeomType::Sphere,
            GeomType::Capsule,
            GeomType::Ellipsoid,
            GeomType::Cylinder,
            GeomType::Box,
            GeomType::Mesh,
        ];
        let (a, shape) = geom_xml(kinds[i % 6], s);
        assets = a;
        let q = random_quat(s);
        geoms += &format!(
            "<geom {shape} pos='{} {} {}' quat='{} {} {} {}'/>",
            s.uniform(-3.0, 3.0),
            s.uniform(-3.0, 3.0),
            s.uniform(0.5, 3.0),
            q[0],
            q[1],
            q[2],
            q[3]
        );
    }
    if round.is_multiple_of(3) {
        geoms += "<geom type='hfield' hfield='h' pos='0 0 0'/>";
    }
    let drone = shell(
        "<geom type='box' size='0.15 0.1 0.03'/><geom type='sphere' size='0.05' pos='0.15 0 0.02'/><geom type='cylinder' size='0.06 0.01' pos='-0.1 0.1 0.03'/>",
    );
    build(&format!("<mujoco>{assets}<worldbody>{geoms}</worldbody></mujoco>"), &[drone])
}

/// A random motion of a drone, straight and about one axis.
struct Way {
    from: Pose,
    step: [f64; 3],
    turn: [f64; 3],
}

impl Way {
    fn draw(s: &mut Stream) -> Self {
        let place = [s.uniform(-3.0, 3.0), s.uniform(-3.0, 3.0), s.uniform(0.5, 3.0)];
        let from = Pose::new(place, random_quat(s));
        let turn = [0; 3].map(|_| s.uniform(-1.2, 1.2));
        let step = [0; 3].map(|_| s.uniform(-1.0, 1.0));
        Self { from, step, turn }
    }

    /// Where the drone is after a share of it.
    fn at(&self, f: f64) -> Pose {
        let turned = quat::mul(self.from.quat_xyzw, quat::exp(self.turn.map(|x| f * x)));
        Pose::new([0, 1, 2].map(|k| self.from.pos_m[k] + f * self.step[k]), quat::normalize(turned))
    }
}

/// Distance of the drone in a pose to what is nearest, m.
fn gap(worker: &mut Worker, p: Pose) -> f64 {
    worker.set_drone(0, p.pos_m, p.quat_xyzw).unwrap();
    worker.update().unwrap();
    Queries::at(worker).clearance(0, 0.5).unwrap().distance_m
}

/// What is nearest at a touch that was found, m. Nothing touches before it.
fn assert_first_touch(worker: &mut Worker, way: &Way, fine: &[f64], hit: &SweptHit) -> f64 {
    let f = hit.fraction;
    let last = (f * (fine.len() - 1) as f64).floor() as usize;
    let before = if f > 0.0 { &fine[..last.min(fine.len() - 1)] } else { &fine[..0] };
    assert!(before.iter().all(|d| *d > 0.0), "touched before {f}");
    let p = way.at(f);
    assert!(norm(sub(p.pos_m, hit.pos_m)) < 1e-9);
    let there = gap(worker, p);
    assert!(there <= 2.0 * TOUCH_M, "at {f} the gap is {there}");
    there
}

/// Three properties on random ways through random scenes: no touch before the reported one, a touch at the reported
/// one, and no touch at all where none is reported.
#[test]
fn swept_checks_agree_with_fine_stepping() {
    const FINE: usize = 400;
    let mut s = draws(400);
    let (mut hits, mut misses, mut grazes) = (0, 0, 0);
    let mut latest = 0.0f64;
    for round in 0..12 {
        let scene = crowded(round, &mut s);
        let mut worker = scene.worker().unwrap();
        for _ in 0..40 {
            let way = Way::draw(&mut s);
            let fine: Vec<f64> =
                (0..=FINE).map(|i| gap(&mut worker, way.at(i as f64 / FINE as f64))).collect();
            match Queries::at(&mut worker).swept(&Sweep::new(0, way.from, way.at(1.0))).unwrap() {
                Some(hit) => {
                    latest = latest.max(assert_first_touch(&mut worker, &way, &fine, &hit));
                    if fine.iter().all(|d| *d > 0.0) { grazes += 1 } else { hits += 1 }
                }
                None => {
                    let least = fine.iter().copied().fold(f64::INFINITY, f64::min);
                    assert!(least > 0.0, "missed a touch of {least}");
                    misses += 1;
                }
            }
        }
    }
    println!("swept: {hits} hits, {misses} misses, {grazes} grazes; largest gap at a hit {latest:.1e} m");
    assert!(hits > 100 && misses > 100 && grazes < 10, "{hits} {misses} {grazes}");
}

/// What a worker did before leaves no trace in what it finds next.
#[test]
fn a_used_worker_finds_bit_for_bit_what_a_fresh_one_finds() {
    let mut s = draws(500);
    let (assets, _) = geom_xml(GeomType::Mesh, &mut s);
    let mut geoms = String::from("<geom type='hfield' hfield='h'/>");
    for i in 0..40 {
        let (_, shape) = geom_xml(GeomType::ALL[2 + i % 7], &mut s);
        let q = random_quat(&mut s);
        let p = [0; 3].map(|_| s.uniform(-2.0, 2.0));
        let body = if i % 2 == 0 { "<body>" } else { "<body mocap='true'>" };
        geoms += &format!(
            "{body}<geom {shape} pos='{} {} {}' quat='{} {} {} {}'/></body>",
            p[0], p[1], p[2], q[0], q[1], q[2], q[3]
        );
    }
    let drone = shell(
        "<geom type='box' size='0.3 0.2 0.1'/><geom type='ellipsoid' size='0.3 0.1 0.2' pos='0.2 0 0'/>",
    );
    let scene =
        build(&format!("<mujoco>{assets}<worldbody>{geoms}</worldbody></mujoco>"), &[drone.clone(), drone]);
    let mut used = scene.worker().unwrap();
    let mut total = 0;
    for _ in 0..60 {
        let poses = [0; 2].map(|_| Pose::new([0; 3].map(|_| s.uniform(-2.0, 2.0)), random_quat(&mut s)));
        let mut fresh = scene.worker().unwrap();
        let mut found = [Vec::new(), Vec::new()];
        let mut distances = [Vec::new(), Vec::new()];
        let mut hits = [Vec::new(), Vec::new()];
        for (i, worker) in [&mut used, &mut fresh].into_iter().enumerate() {
            for (drone, pose) in poses.iter().enumerate() {
                worker.set_drone(drone, pose.pos_m, pose.quat_xyzw).unwrap();
            }
            worker.update().unwrap();
            Queries::at(worker).contacts(&mut found[i]).unwrap();
            for drone in 0..2 {
                distances[i].push(Queries::at(worker).clearance(drone, 2.0).unwrap());
            }
            hits[i].push(Queries::at(worker).swept(&Sweep::new(0, poses[0], poses[1])).unwrap());
        }
        total += found[0].len();
        assert_eq!(found[0], found[1]);
        assert_eq!(distances[0], distances[1]);
        assert_eq!(hits[0], hits[1]);
    }
    assert!(total > 100, "{total}");
}

/// Where roads cross, neither drone meets the other where it stands at the end.
#[test]
fn drones_that_cross_each_other_within_a_step_are_found() {
    let ball = || shell("<geom type='sphere' size='0.1'/>");
    let scene = build(
        "<mujoco><worldbody><geom type='plane' size='9 9 1' pos='0 0 -3'/></worldbody></mujoco>",
        &[ball(), ball()],
    );
    let mut worker = scene.worker().unwrap();
    let at = |x: f64, y: f64| Pose::new([x, y, 0.0], LEVEL);
    let mut cross = |from: Pose, to: Pose, other_from: Pose, other_to: Pose| {
        worker.set_drone(0, to.pos_m, LEVEL).unwrap();
        worker.set_drone(1, other_to.pos_m, LEVEL).unwrap();
        worker.update().unwrap();
        let alone = Queries::at(&mut worker).swept(&Sweep::new(0, from, to)).unwrap();
        (alone, Queries::at(&mut worker).swept(&Sweep::new(0, from, to).of_drone(1, other_from)).unwrap())
    };
    let (alone, hit) = cross(at(-1.0, 0.0), at(1.0, 0.0), at(0.0, -1.0), at(0.0, 1.0));
    assert_eq!(alone, None);
    let hit = hit.unwrap();
    // Their distance is √2 |2 t − 1|, and 0.2 when they touch.
    let t = 0.5 - 0.1 / 2f64.sqrt();
    assert!((hit.fraction - t).abs() < 1e-4 && hit.other_drone == Some(1), "{hit:?}");
    assert!(norm(sub(hit.pos_m, [2.0 * t - 1.0, 0.0, 0.0])) < 1e-3, "{hit:?}");
    assert!(norm(sub(hit.point_m, [t - 0.5, t - 0.5, 0.0])) < 1e-3, "{hit:?}");
    let corner = std::f64::consts::FRAC_1_SQRT_2;
    assert!(norm(sub(hit.normal, [-corner, corner, 0.0])) < 1e-2, "{hit:?}");
    // One behind the other at the same speed, and one that has gone when the other comes.
    assert_eq!(cross(at(-1.0, 0.0), at(1.0, 0.0), at(-0.7, 0.0), at(1.3, 0.0)).1, None);
    assert_eq!(cross(at(-1.0, 0.0), at(1.0, 0.0), at(0.0, 0.0), at(0.0, 2.0)).1, None);
}
