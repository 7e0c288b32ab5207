//! Depth images against single rays of MuJoCo for every geom type, and the rules of the image.

#[path = "common/notes.rs"]
mod notes;

#[path = "common/scenes.rs"]
mod scenes;

use propwash::math::quat;
use propwash::random::{Key, Stream, purpose};
use propwash::scene::{GeomType, Pose, Scene, SceneError, Shell, Worker, WorkerPool};
use propwash::sense::depth::LOOKING_FORWARD_XYZW;
use propwash::sense::{
    Camera, Caster, DepthBatch, DepthFrame, DepthKind, DepthNoise, DepthPlanes, Lens, NoiseKey, PixelStatus,
    PoseGain, Queries, RayHits, RayQuery, STATUS_NOT_RENDERED, SenseError, WorldPoses, Worlds,
};
use scenes::{build, random_quat};

const HIT: u8 = PixelStatus::Hit as u8;
const MISS: u8 = PixelStatus::Miss as u8;
const TOO_FAR: u8 = PixelStatus::TooFar as u8;
const TOO_NEAR: u8 = PixelStatus::TooNear as u8;
const LEVEL: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

fn shell(body: &str) -> Shell {
    Shell {
        name: "test".into(),
        xml: format!("<mujoco><worldbody><body name='drone'>{body}</body></worldbody></mujoco>"),
        dir: None,
    }
}

const BALL: &str = r#"<geom name="hull" type="sphere" size="0.1"/>
    <camera name="fpv" pos="0.05 0 0" xyaxes="0 -1 0 0 0 1" fovy="90"/>"#;

fn draws(step: u64) -> Stream {
    Key { seed: 11, world: 0, drone: 0, step, purpose: purpose("test of depth") }.stream()
}

fn geom_xml(kind: GeomType, s: &mut Stream, i: usize) -> String {
    let r = |s: &mut Stream| s.uniform(0.1, 0.9);
    let q = random_quat(s);
    let place = format!(
        "name='g{i}' pos='{} {} {}' quat='{} {} {} {}'",
        s.uniform(-3.0, 3.0),
        s.uniform(-3.0, 3.0),
        s.uniform(-3.0, 3.0),
        q[0],
        q[1],
        q[2],
        q[3]
    );
    let shape = match kind {
        GeomType::Plane if i.is_multiple_of(2) => "type='plane' size='0 0 1'".to_string(),
        GeomType::Plane => format!("type='plane' size='{} {} 1'", r(s), r(s)),
        GeomType::Hfield => "type='hfield' hfield='h'".into(),
        GeomType::Sphere => format!("type='sphere' size='{}'", r(s)),
        GeomType::Capsule => format!("type='capsule' size='{} {}'", r(s), r(s)),
        GeomType::Ellipsoid => format!("type='ellipsoid' size='{} {} {}'", r(s), r(s), r(s)),
        GeomType::Cylinder => format!("type='cylinder' size='{} {}'", r(s), r(s)),
        GeomType::Box => format!("type='box' size='{} {} {}'", r(s), r(s), r(s)),
        GeomType::Mesh => "type='mesh' mesh='m'".into(),
        GeomType::Sdf => "type='sdf' mesh='s'".into(),
    };
    format!("<geom {place} {shape}/>")
}

fn assets(s: &mut Stream) -> String {
    let heights: Vec<String> = (0..80).map(|_| format!("{:.4}", s.unit())).collect();
    format!(
        "<asset><hfield name='h' nrow='8' ncol='10' size='1 1.2 0.7 0.2' elevation='{}'/>\
         <mesh name='m' builtin='supertorus' params='12 0.4 1 1' scale='0.7 0.7 0.7'/>\
         <mesh name='s' builtin='supertorus' params='12 0.4 1 1' scale='0.7 0.7 0.7'/></asset>",
        heights.join(" ")
    )
}

/// More than 100,000 rays of each type, from outside, inside and near, against one `mj_ray` each. The native caster is
/// compared in `sense_caster.rs`.
#[test]
fn every_pixel_is_what_a_single_ray_of_mujoco_says_for_every_geom_type() {
    const IMAGES: usize = 120;
    const SIZE: (usize, usize) = (36, 24);
    println!(
        "type       rays    hits    |error|: median  99.9%  worst (relative, f32 image against f64 ray)"
    );
    let mut worst = 0.0f64;
    for kind in GeomType::ALL {
        let mut s = draws(kind as u64);
        let geoms: String = (0..12).map(|i| geom_xml(kind, &mut s, i)).collect();
        let scene = build(&format!("<mujoco>{}<worldbody>{geoms}</worldbody></mujoco>", assets(&mut s)), &[]);
        let mut worker = scene.worker().unwrap();
        let mut frame = DepthFrame::new();
        let (mut errors, mut rays, mut hits) = (Vec::new(), 0, 0);
        for _ in 0..IMAGES {
            let reach = if s.unit() < 0.5 { 2.0 } else { 8.0 };
            let pos = [0; 3].map(|_| s.uniform(-reach, reach));
            let lens = Lens::Fovy { fovy_deg: s.uniform(20.0, 140.0) };
            let camera = Camera::in_world(&scene, Pose::new(pos, random_quat(&mut s)), lens)
                .unwrap()
                .with_size(SIZE.0, SIZE.1)
                .unwrap()
                .with_normals(true)
                .with_kind(DepthKind::Range)
                .with_caster(Caster::MuJoCo);
            camera.render(&mut worker, &mut frame).unwrap();
            let pose = camera.pose(&worker).unwrap();
            for (i, ray) in camera.rays().iter().enumerate() {
                let direction = propwash::math::quat::rotate(pose.quat_xyzw, *ray);
                let single = worker.ray(pos, direction, Some(&[1, 1, 1, 0, 0, 0]), None).unwrap();
                rays += 1;
                match single {
                    None => {
                        assert_eq!(
                            (frame.status[i], frame.geom_id[i], frame.body_id[i]),
                            (MISS, -1, -1),
                            "{kind}"
                        );
                        assert_eq!(frame.depth_m[i], f32::INFINITY);
                    }
                    Some(hit) => {
                        hits += 1;
                        assert_eq!((frame.status[i], frame.geom_id[i]), (HIT, hit.geom_id), "{kind}");
                        assert_eq!(frame.body_id[i], 0);
                        errors.push(
                            (f64::from(frame.depth_m[i]) - hit.distance).abs() / hit.distance.max(1e-3),
                        );
                        let n = frame.normal.as_ref().unwrap()[i];
                        for k in 0..3 {
                            assert!(
                                (f64::from(n[k]) - hit.normal[k]).abs() < 1e-6,
                                "{kind} {n:?} {:?}",
                                hit.normal
                            );
                        }
                    }
                }
            }
        }
        errors.sort_by(f64::total_cmp);
        let q = |p: f64| errors[((errors.len() - 1) as f64 * p) as usize];
        worst = worst.max(q(1.0));
        println!(
            "{:9}  {rays}  {hits:6}            {:.1e} {:.1e} {:.1e}",
            kind.name(),
            q(0.5),
            q(0.999),
            q(1.0)
        );
        assert!(rays >= 100_000 && hits > 5_000, "{kind}: {rays} rays, {hits} hits");
        // One rounding to f32.
        assert!(q(1.0) <= 6.0e-8, "{kind}: worst {}", q(1.0));
    }
    notes::tell(&format!(
        "depth by mj_multiRay vs mj_ray of MuJoCo {}: 9 geom types, over 100,000 rays each, no hit differs, worst {worst:.1e} relative",
        propwash::scene::mujoco_version()
    ));
}

/// An oracle that is not MuJoCo: closed forms for a sphere and a plane, triangles for a height field.
#[test]
fn depth_agrees_with_closed_forms() {
    let xml = "<mujoco><worldbody><geom type='sphere' size='0.5' pos='3 0 1'/><geom type='plane' size='0 0 1'/></worldbody></mujoco>";
    let scene = build(xml, &[]);
    let mut worker = scene.worker().unwrap();
    let eye = [0.2, -0.3, 1.4];
    let camera =
        Camera::in_world(&scene, Pose::new(eye, LOOKING_FORWARD_XYZW), Lens::Fovy { fovy_deg: 80.0 })
            .unwrap()
            .with_size(97, 71)
            .unwrap()
            .with_kind(DepthKind::Range);
    let mut frame = DepthFrame::new();
    camera.render(&mut worker, &mut frame).unwrap();
    let f = 0.5 * 71.0 / 40f64.to_radians().tan();
    let mut seen = [0, 0, 0];
    for row in 0..71 {
        for col in 0..97 {
            // Forward, left, up, without the camera's own code.
            let v = [1.0, -(col as f64 + 0.5 - 48.5) / f, -(row as f64 + 0.5 - 35.5) / f];
            let n = v.iter().map(|x| x * x).sum::<f64>().sqrt();
            let v = v.map(|x| x / n);
            let m = [eye[0] - 3.0, eye[1], eye[2] - 1.0];
            let b = m[0] * v[0] + m[1] * v[1] + m[2] * v[2];
            let c = m[0] * m[0] + m[1] * m[1] + m[2] * m[2] - 0.25;
            let disc = b * b - c;
            if disc.abs() < 1e-6 {
                continue;
            }
            let sphere = if disc > 0.0 { -b - disc.sqrt() } else { f64::INFINITY };
            let plane = if v[2] < 0.0 { -eye[2] / v[2] } else { f64::INFINITY };
            let truth = sphere.min(plane);
            let got = f64::from(frame.depth_m[row * 97 + col]);
            if truth.is_finite() {
                assert!((got - truth).abs() < 1e-6 * truth, "row {row} col {col}: {got} {truth}");
                seen[usize::from(plane < sphere)] += 1;
            } else {
                assert_eq!(frame.status[row * 97 + col], MISS);
                seen[2] += 1;
            }
        }
    }
    assert!(seen.iter().all(|n| *n > 100), "{seen:?}");
}

#[test]
fn a_red_sphere_at_the_upper_left_is_seen_in_the_first_rows_and_columns() {
    // The camera of the drone looks along world x; left is +y, up is +z.
    let xml = r#"<mujoco><worldbody><geom name="red" type="sphere" size="0.2" pos="2 1.5 1.5"/></worldbody></mujoco>"#;
    let scene = build(xml, &[shell(BALL)]);
    let mut worker = scene.worker().unwrap();
    let camera = Camera::on_drone(&scene, 0, "fpv").unwrap().with_size(32, 32).unwrap();
    let mut frame = DepthFrame::new();
    camera.render(&mut worker, &mut frame).unwrap();
    let seen: Vec<usize> = (0..32 * 32).filter(|i| frame.status[*i] == HIT).collect();
    assert!(seen.len() > 4);
    for i in seen {
        assert!(i / 32 < 12 && i % 32 < 12, "row {} column {}", i / 32, i % 32);
        assert_eq!(scene.geoms()[frame.geom_id[i] as usize].name, "red");
    }
    let custom = Camera::mounted(
        &scene,
        0,
        Pose::new([0.05, 0.0, 0.0], LOOKING_FORWARD_XYZW),
        Lens::Fovy { fovy_deg: 90.0 },
    )
    .unwrap()
    .with_size(32, 32)
    .unwrap();
    let mut second = DepthFrame::new();
    custom.render(&mut worker, &mut second).unwrap();
    assert_eq!((&frame.status, &frame.geom_id), (&second.status, &second.geom_id));
}

#[test]
fn a_turned_drone_turns_its_camera() {
    let xml = r#"<mujoco><worldbody><geom name="wall" type="box" size="2 0.1 2" pos="0 5 0"/></worldbody></mujoco>"#;
    let scene = build(xml, &[shell(BALL)]);
    let mut worker = scene.worker().unwrap();
    let camera = Camera::on_drone(&scene, 0, "fpv").unwrap().with_size(1, 1).unwrap();
    let mut frame = DepthFrame::new();
    camera.render(&mut worker, &mut frame).unwrap();
    assert_eq!(frame.status, [MISS]);
    // A quarter turn to the left: forward is +y. The wall begins at 4.9 m, the camera sits 0.05 m forward.
    let h = 0.5f64.sqrt();
    worker.set_drone(0, [0.3, 0.5, 0.0], [0.0, 0.0, h, h]).unwrap();
    worker.update().unwrap();
    camera.render(&mut worker, &mut frame).unwrap();
    assert_eq!(frame.status, [HIT]);
    assert!((f64::from(frame.depth_m[0]) - 4.35).abs() < 1e-6, "{:?}", frame.depth_m);
    assert!((frame.pos_m[1] - 0.55).abs() < 1e-12 && (frame.pos_m[0] - 0.3).abs() < 1e-12);
}

#[test]
fn its_own_body_is_not_seen_and_other_drones_are() {
    // Guards around the camera, one of them on a child body behind another child.
    let guarded = shell(
        r#"<geom name="hull" type="box" size="0.2 0.2 0.05"/>
        <camera name="fpv" pos="0 0 0" xyaxes="0 -1 0 0 0 1" fovy="60"/>
        <body name="guard" pos="0.3 0 0"><geom name="inner" type="box" size="0.01 0.3 0.3"/>
        <body name="outer" pos="0.1 0 0"><geom name="outer" type="sphere" size="0.05"/></body></body>"#,
    );
    let xml =
        "<mujoco><worldbody><geom name='wall' type='box' size='0.1 9 9' pos='6 0 0'/></worldbody></mujoco>";
    let scene = build(xml, &[guarded.clone(), guarded]);
    let mut worker = scene.worker().unwrap();
    worker.set_drone(0, [0.0; 3], LEVEL).unwrap();
    worker.set_drone(1, [3.0, 0.0, 0.0], LEVEL).unwrap();
    worker.update().unwrap();
    let camera = Camera::on_drone(&scene, 0, "fpv").unwrap().with_size(41, 41).unwrap();
    let mut frame = DepthFrame::new();
    camera.render(&mut worker, &mut frame).unwrap();
    let name = |i: usize| scene.geoms()[frame.geom_id[i] as usize].name.clone();
    let names: std::collections::BTreeSet<_> = (0..41 * 41).map(name).collect();
    assert_eq!(names.iter().map(String::as_str).collect::<Vec<_>>(), ["drone1/hull", "drone1/inner", "wall"]);
    // The centre looks at the other drone's hull, whose face is at 2.8 m.
    assert!((frame.depth_m[20 * 41 + 20] - 2.8).abs() < 1e-6, "{}", frame.depth_m[20 * 41 + 20]);
    let normal_free = frame.depth_m.clone();
    // Alone, the wall is all there is, at 5.9 m.
    let alone = build(xml, &[]);
    let open =
        Camera::in_world(&alone, Pose::new([0.0; 3], LOOKING_FORWARD_XYZW), Lens::Fovy { fovy_deg: 60.0 })
            .unwrap()
            .with_size(41, 41)
            .unwrap();
    let mut truth = DepthFrame::new();
    open.render(&mut alone.worker().unwrap(), &mut truth).unwrap();
    for i in 0..41 * 41 {
        if name(i) == "wall" {
            assert!((normal_free[i] - truth.depth_m[i]).abs() < 1e-6);
        }
    }
    let mut itself = DepthFrame::new();
    camera.clone().seeing_itself().render(&mut worker, &mut itself).unwrap();
    assert!(itself.geom_id.iter().any(|g| *g >= 0 && scene.geoms()[*g as usize].drone == Some(0)));
}

#[test]
fn miss_too_far_and_too_near_are_told_apart() {
    let xml =
        "<mujoco><worldbody><geom name='wall' type='box' size='0.1 1 9' pos='5.1 0 0'/></worldbody></mujoco>";
    let scene = build(xml, &[]);
    let mut worker = scene.worker().unwrap();
    let base =
        Camera::in_world(&scene, Pose::new([0.0; 3], LOOKING_FORWARD_XYZW), Lens::Fovy { fovy_deg: 60.0 })
            .unwrap()
            .with_size(9, 1)
            .unwrap();
    let mut frame = DepthFrame::new();
    for (near, far, status, depth) in [
        (0.0, f64::INFINITY, HIT, 5.0),
        (0.1, 4.9, TOO_FAR, f32::INFINITY),
        (5.1, 9.0, TOO_NEAR, 0.0),
        (4.9, 5.1, HIT, 5.0),
    ] {
        base.clone().with_range(near, far).unwrap().render(&mut worker, &mut frame).unwrap();
        assert_eq!((frame.status[4], frame.status[0]), (status, MISS));
        assert!(frame.depth_m[4] == depth || (frame.depth_m[4] - depth).abs() < 1e-5, "{}", frame.depth_m[4]);
        assert_eq!((frame.geom_id[4], frame.geom_id[0]), (0, -1));
        assert_eq!(frame.depth_m[0], f32::INFINITY);
    }
    assert!(base.clone().with_range(2.0, 1.0).is_err());
    assert!(base.with_range(f64::NAN, 1.0).is_err());
}

#[test]
fn z_depth_of_a_wall_is_constant_and_range_is_z_depth_over_the_cosine() {
    let xml = "<mujoco><worldbody><geom type='box' size='0.1 50 50' pos='5.1 0 0'/></worldbody></mujoco>";
    let scene = build(xml, &[]);
    let mut worker = scene.worker().unwrap();
    let lens = Lens::Pinhole { fx_px: 40.0, fy_px: 30.0, cx_px: 20.0, cy_px: 9.0, size: [48, 32] };
    let range = Camera::in_world(&scene, Pose::new([0.0; 3], LOOKING_FORWARD_XYZW), lens)
        .unwrap()
        .with_size(48, 32)
        .unwrap()
        .with_kind(DepthKind::Range);
    let z = range.clone().with_kind(DepthKind::ZDepth);
    let (mut a, mut b) = (DepthFrame::new(), DepthFrame::new());
    range.render(&mut worker, &mut a).unwrap();
    z.render(&mut worker, &mut b).unwrap();
    assert_eq!((a.kind, b.kind), (DepthKind::Range, DepthKind::ZDepth));
    assert_eq!(a.k, [[40.0, 0.0, 20.0], [0.0, 30.0, 9.0], [0.0, 0.0, 1.0]]);
    for row in 0..32 {
        for col in 0..48 {
            let i = row * 48 + col;
            assert!((b.depth_m[i] - 5.0).abs() < 2e-6, "{}", b.depth_m[i]);
            let x = (col as f64 + 0.5 - a.k[0][2]) / a.k[0][0];
            let y = (row as f64 + 0.5 - a.k[1][2]) / a.k[1][1];
            let expected = 5.0 * (1.0 + x * x + y * y).sqrt();
            assert!((f64::from(a.depth_m[i]) - expected).abs() < 2e-6 * expected);
        }
    }
}

/// K, pose and depth together give back the point in the world.
#[test]
fn a_pixel_unprojects_to_the_point_that_was_hit() {
    let xml = "<mujoco><worldbody><geom type='sphere' size='1' pos='1 2 3'/></worldbody></mujoco>";
    let scene = build(xml, &[]);
    let mut worker = scene.worker().unwrap();
    let mut s = draws(77);
    let mut hits = 0;
    for _ in 0..40 {
        let pos = [1.0 + s.uniform(-4.0, 4.0), 2.0 + s.uniform(-4.0, 4.0), 3.0 + s.uniform(-4.0, 4.0)];
        let camera =
            Camera::in_world(&scene, Pose::new(pos, random_quat(&mut s)), Lens::Fovy { fovy_deg: 100.0 })
                .unwrap()
                .with_size(20, 16)
                .unwrap()
                .with_kind(DepthKind::ZDepth);
        let mut f = DepthFrame::new();
        camera.render(&mut worker, &mut f).unwrap();
        for i in (0..f.depth_m.len()).filter(|i| f.status[*i] == HIT) {
            let (u, v, z) = ((i % 20) as f64 + 0.5, (i / 20) as f64 + 0.5, f64::from(f.depth_m[i]));
            // OpenCV camera: x right, y down, z forward; ours: y up, looks along -z.
            let p = [(u - f.k[0][2]) / f.k[0][0] * z, -(v - f.k[1][2]) / f.k[1][1] * z, -z];
            let w = propwash::math::quat::rotate(f.quat_xyzw, p);
            let q = [0, 1, 2].map(|k| w[k] + f.pos_m[k]);
            let r = ((q[0] - 1.0).powi(2) + (q[1] - 2.0).powi(2) + (q[2] - 3.0).powi(2)).sqrt();
            assert!((r - 1.0).abs() < 2e-6 * (1.0 + z), "{r}");
            hits += 1;
        }
    }
    assert!(hits > 200);
}

/// Figures of MuJoCo 3.17.0's renderer for these cameras (mjv_cameraFrustum and the frustum of mjv_updateScene, at
/// near = 1): left -0.55, right 1.05, bottom -0.58, top 0.38.
/// Depths (of the kind of the camera) and geoms along the rays of all pixels, one by one in f64, from a camera at `pose`.
fn depths_at(worker: &mut Worker, camera: &Camera, pose: &Pose, hits: &mut RayHits) -> Vec<f64> {
    let rays = camera.rays();
    let world: Vec<[f64; 3]> = rays.iter().map(|r| quat::rotate(pose.quat_xyzw, *r)).collect();
    let origins = vec![pose.pos_m; world.len()];
    Queries::at(worker).rays(&origins, &world, &RayQuery::default(), hits).unwrap();
    let share = |r: &[f64; 3]| if camera.kind() == DepthKind::Range { 1.0 } else { -r[2] };
    hits.range_m.iter().zip(&rays).map(|(range, r)| range * share(r)).collect()
}

/// Slopes by implicit differentiation against central differences of rays that are cast again in f64 from moved and turned cameras.
#[test]
fn slopes_are_those_of_moved_cameras_for_every_geom_type() {
    const H: f64 = 1e-5;
    let mut told = Vec::new();
    for kind in GeomType::ALL {
        let mut s = draws(300 + kind as u64);
        let geoms: String = (0..8).map(|i| geom_xml(kind, &mut s, i)).collect();
        let scene = build(&format!("<mujoco>{}<worldbody>{geoms}</worldbody></mujoco>", assets(&mut s)), &[]);
        let mut worker = scene.worker().unwrap();
        worker.update().unwrap();
        let (mut compared, mut edges, mut off) = (0usize, 0usize, Vec::new());
        for view in 0..40 {
            let pose = Pose::new([0; 3].map(|_| s.uniform(-4.0, 4.0)), random_quat(&mut s));
            let depth = if view % 2 == 0 { DepthKind::ZDepth } else { DepthKind::Range };
            let camera = Camera::in_world(&scene, pose, Lens::Fovy { fovy_deg: 80.0 }).unwrap();
            let camera = camera.with_size(24, 20).unwrap().with_kind(depth).with_normals(true);
            let mut frame = DepthFrame::new();
            camera.render(&mut worker, &mut frame).unwrap();
            let image = frame.sloped().unwrap();
            // Depths and geoms at the poses on both sides, along each axis and turned about it.
            let mut moved = Vec::new();
            for way in 0..12 {
                let step = if way % 2 == 0 { H } else { -H };
                let mut along = [0.0; 3];
                along[way / 2 % 3] = step;
                let at = if way < 6 {
                    Pose::new([0, 1, 2].map(|k| pose.pos_m[k] + along[k]), pose.quat_xyzw)
                } else {
                    Pose::new(pose.pos_m, quat::mul(quat::exp(along), pose.quat_xyzw))
                };
                let mut hits = RayHits::default();
                let depths = depths_at(&mut worker, &camera, &at, &mut hits);
                moved.push((depths, hits.geom_id, hits.normal));
            }
            for pixel in 0..frame.depth_m.len() {
                let Some(slope) = image.slope(pixel) else { continue };
                // On an edge, of a geom or of one of its faces, the two sides have different slopes.
                let first = moved[0].2[pixel];
                let alike = |(_, geom, normal): &(Vec<f64>, Vec<i32>, Vec<[f64; 3]>)| {
                    geom[pixel] == frame.geom_id[pixel]
                        && (0..3).all(|k| (normal[pixel][k] - first[k]).abs() < 1e-2)
                };
                if !moved.iter().all(alike) {
                    edges += 1;
                    continue;
                }
                let mut gain = PoseGain::default();
                gain.add(slope.by_pos, slope.point_m);
                let turn = gain.by_rotation(pose.pos_m);
                let size = (0..3).map(|k| slope.by_pos[k].hypot(turn[k])).fold(0.0, f64::hypot);
                for axis in 0..6 {
                    let pair = [&moved[2 * axis].0, &moved[2 * axis + 1].0];
                    let measured = (pair[0][pixel] - pair[1][pixel]) / (2.0 * H);
                    let said = if axis < 3 { slope.by_pos[axis] } else { turn[axis - 3] };
                    off.push((said - measured).abs() / size);
                }
                compared += 1;
            }
        }
        off.sort_by(f64::total_cmp);
        let q = |p: f64| off[((off.len() - 1) as f64 * p) as usize];
        let [middle, most, worst] = [0.5, 0.99, 1.0].map(q);
        told.push(format!("{kind} {compared} pixels {middle:.0e} {most:.0e} {worst:.0e}"));
        println!("{}, {edges} on edges", told[told.len() - 1]);
        assert!(compared > 300 && edges * 20 < compared, "{kind}: {compared} compared, {edges} on edges");
        assert!(middle < 1e-6 && most < 1e-3, "{kind}: {middle} {most} {worst}");
    }
    notes::tell(&format!(
        "slopes of depths by camera pose vs central differences of f64 rays, of each slope's size (median, 99 %, worst): {}",
        told.join("; ")
    ));
}

#[test]
fn seeds_are_pulled_back_to_cameras_and_to_what_they_see_and_refused_where_there_is_no_slope() {
    let scene = build(
        "<mujoco><worldbody><geom type='sphere' size='0.5' pos='3 0.2 0.1'/></worldbody></mujoco>",
        &[],
    );
    let mut worker = scene.worker().unwrap();
    worker.update().unwrap();
    let pose = Pose::new([0.1, 0.0, 0.05], LOOKING_FORWARD_XYZW);
    let camera =
        Camera::in_world(&scene, pose, Lens::Fovy { fovy_deg: 40.0 }).unwrap().with_size(16, 16).unwrap();
    let mut frame = DepthFrame::new();
    camera.render(&mut worker, &mut frame).unwrap();
    assert!(frame.sloped().unwrap_err().to_string().contains("render the frame with normals"));
    camera.with_normals(true).render(&mut worker, &mut frame).unwrap();
    let image = frame.sloped().unwrap();
    let mut s = draws(9);
    let seeds: Vec<f64> =
        (0..256).map(|i| if image.slope(i).is_some() { s.uniform(-1.0, 1.0) } else { 0.0 }).collect();
    let mut ball = PoseGain::default();
    let gain = image
        .pull_back(&seeds, |geom, by_point, point| {
            assert_eq!(geom, 0);
            ball.add(by_point, point);
        })
        .unwrap();
    // Camera and ball moved alike, or turned alike, see the same.
    for k in 0..3 {
        assert!((gain.by_pos[k] + ball.by_pos[k]).abs() < 1e-12);
        assert!((gain.by_rotation([0.0; 3])[k] + ball.by_rotation([0.0; 3])[k]).abs() < 1e-12);
        // A ball that turns about its middle looks the same.
        assert!(ball.by_rotation([3.0, 0.2, 0.1])[k].abs() < 1e-5, "{ball:?}");
    }
    // By the quaternion: a small turn in both ways, and nothing by its length.
    let by_quat = gain.by_quat(&pose);
    let along: f64 = (0..4).map(|k| by_quat[k] * pose.quat_xyzw[k]).sum();
    assert!(along.abs() < 1e-12);
    let turned = quat::mul(quat::exp([0.0, 1e-6, 0.0]), pose.quat_xyzw);
    let change: f64 = (0..4).map(|k| by_quat[k] * (turned[k] - pose.quat_xyzw[k])).sum();
    let wanted = 1e-6 * gain.by_rotation(pose.pos_m)[1];
    assert!((change - wanted).abs() < 1e-5 * wanted.abs(), "{change} {wanted}");
    let refused = |seeds: &[f64]| image.pull_back(seeds, |_, _, _| ()).unwrap_err().to_string();
    let one = |pixel: usize, v: f64| (0..256).map(|i| if i == pixel { v } else { 0.0 }).collect::<Vec<_>>();
    assert!(refused(&one(0, 1.0)).contains("pixel (0, 0), where nothing is seen"));
    assert!(refused(&one(8 * 16 + 6, f64::NAN)).contains("got NaN at pixel (6, 8);"));
    assert!(refused(&[1.0]).contains("seeds must have 256 numbers"));
}

#[test]
fn intrinsics_of_the_scene_are_those_of_mujocos_renderer() {
    let xml = r#"<mujoco><worldbody><geom type="box" size="1 1 1" pos="0 0 -5"/>
        <camera name="metres" resolution="640 480" sensorsize="0.0064 0.0048" focal="0.004 0.005" principal="0.001 0.0005"/>
        <camera name="pixels" resolution="640 480" sensorsize="0.0064 0.0048" focalpixel="400 500" principalpixel="100 50"/>
        <camera name="fovy" fovy="60" resolution="64 48"/><camera name="plain"/></worldbody></mujoco>"#;
    let scene = build(xml, &[]);
    for name in ["metres", "pixels"] {
        for size in [[640, 480], [64, 48], [32, 48]] {
            let camera = Camera::from_scene(&scene, name).unwrap();
            assert_eq!((camera.width(), camera.height()), (640, 480));
            let k = camera.with_size(size[0], size[1]).unwrap().k();
            let (w, h) = (size[0] as f64, size[1] as f64);
            let edges =
                [-k[0][2] / k[0][0], (w - k[0][2]) / k[0][0], -(h - k[1][2]) / k[1][1], k[1][2] / k[1][1]];
            for (got, expected) in edges.iter().zip([-0.55, 1.05, -0.58, 0.38]) {
                assert!((got - expected).abs() < 1e-6, "{name} {size:?}: {edges:?}");
            }
        }
    }
    let k = Camera::from_scene(&scene, "fovy").unwrap().k();
    let f = 24.0 / 30f64.to_radians().tan();
    assert!((k[0][0] - f).abs() < 1e-9 && (k[1][1] - f).abs() < 1e-9 && k[0][2] == 32.0 && k[1][2] == 24.0);
    let plain = Camera::from_scene(&scene, "plain").unwrap();
    assert_eq!((plain.width(), plain.height()), (64, 64));
}

#[test]
fn cameras_follow_as_mujoco_moves_them() {
    let xml = r#"<mujoco><worldbody>
        <geom name="target" type="sphere" size="0.3" pos="0 0 5"/>
        <body name="car" mocap="true"><geom name="car" type="box" size="0.1 0.1 0.1"/>
          <camera name="rigid" pos="0 0 0.5" xyaxes="0 -1 0 0 0 1"/>
          <camera name="track" pos="0 0 0.5" xyaxes="0 -1 0 0 0 1" mode="track"/>
          <camera name="com" pos="0 0 0.5" xyaxes="0 -1 0 0 0 1" mode="trackcom"/></body>
        <body name="goal" mocap="true" pos="4 4 1"><geom name="goal" type="sphere" size="0.5"/></body>
        <camera name="look" pos="0 0 1" mode="targetbody" target="goal"/>
        <camera name="lookcom" pos="0 0 1" mode="targetbodycom" target="goal"/>
        <camera name="flat" projection="orthographic"/></worldbody></mujoco>"#;
    let scene = build(xml, &[]);
    let mut worker = scene.worker().unwrap();
    let h = 0.5f64.sqrt();
    worker.set_obstacle(0, [1.0, 2.0, 3.0], [0.0, 0.0, h, h]).unwrap();
    worker.set_obstacle(1, [-3.0, 1.0, 2.0], LEVEL).unwrap();
    worker.update().unwrap();
    let place = |worker: &Worker, name: &str| {
        let pose = Camera::from_scene(&scene, name).unwrap().pose(worker).unwrap();
        (pose.pos_m, propwash::math::quat::rotate(pose.quat_xyzw, [0.0, 0.0, -1.0]))
    };
    let near = |a: [f64; 3], b: [f64; 3]| (0..3).all(|k| (a[k] - b[k]).abs() < 1e-9);
    assert!(
        near(place(&worker, "rigid").0, [1.0, 2.0, 3.5]) && near(place(&worker, "rigid").1, [0.0, 1.0, 0.0])
    );
    for name in ["track", "com"] {
        assert!(
            near(place(&worker, name).0, [1.0, 2.0, 3.5]) && near(place(&worker, name).1, [1.0, 0.0, 0.0]),
            "{name} {:?}",
            place(&worker, name)
        );
    }
    let to_goal = [-3.0, 1.0, 1.0].map(|x| x / 11f64.sqrt());
    for name in ["look", "lookcom"] {
        assert!(near(place(&worker, name).1, to_goal), "{name} {:?}", place(&worker, name));
        let camera = Camera::from_scene(&scene, name).unwrap().with_size(3, 3).unwrap();
        let mut frame = DepthFrame::new();
        camera.render(&mut worker, &mut frame).unwrap();
        assert!((f64::from(frame.depth_m[4]) - (11f64.sqrt() - 0.5)).abs() < 1e-5);
    }
    let message = Camera::from_scene(&scene, "flat").unwrap_err().to_string();
    assert!(message.contains("orthographic") && message.contains("flat"), "{message}");
    let message = Camera::from_scene(&scene, "nope").unwrap_err().to_string();
    assert!(message.contains("nope") && message.contains("rigid"), "{message}");
}

#[test]
fn groups_and_alpha_decide_what_is_seen() {
    let xml = r#"<mujoco><asset><material name="glass" rgba="1 1 1 0"/><material name="milk" rgba="1 1 1 0.2"/></asset><worldbody>
        <geom name="hidden" type="box" size="0.1 9 9" pos="1 0 0" group="3"/>
        <geom name="clear" type="box" size="0.1 9 9" pos="2 0 0" rgba="1 0 0 0"/>
        <geom name="glass" type="box" size="0.1 9 9" pos="3 0 0" material="glass"/>
        <geom name="milk" type="box" size="0.1 9 9" pos="4 0 0" material="milk" rgba="1 0 0 0"/></worldbody></mujoco>"#;
    let scene = build(xml, &[]);
    let mut worker = scene.worker().unwrap();
    let camera =
        Camera::in_world(&scene, Pose::new([0.0; 3], LOOKING_FORWARD_XYZW), Lens::Fovy { fovy_deg: 20.0 })
            .unwrap()
            .with_size(2, 2)
            .unwrap();
    let mut frame = DepthFrame::new();
    camera.render(&mut worker, &mut frame).unwrap();
    assert!(frame.geom_id.iter().all(|g| scene.geoms()[*g as usize].name == "milk"));
    camera.with_groups([true; 6]).render(&mut worker, &mut frame).unwrap();
    assert!(frame.geom_id.iter().all(|g| scene.geoms()[*g as usize].name == "hidden"));
}

fn batch_scene() -> Scene {
    let xml = r#"<mujoco><worldbody><geom type="plane" size="0 0 1"/><geom type="cylinder" size="0.3 2" pos="2 0 1"/>
        <body mocap="true" name="gate" pos="1 1 1"><geom type="box" size="0.1 0.5 0.5"/></body></worldbody></mujoco>"#;
    build(xml, &[shell(BALL), shell(BALL)])
}

fn batch_poses(worlds: usize) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
    let mut s = draws(5);
    let (mut pos, mut quat, mut gate) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..worlds {
        for drone in 0..2 {
            pos.extend([s.uniform(-1.0, 1.0), drone as f64 + s.uniform(-0.4, 0.4), s.uniform(0.5, 1.5)]);
            quat.extend(random_quat(&mut s));
        }
        gate.extend([1.0 + s.unit(), s.uniform(-1.0, 1.0), 1.0]);
    }
    (pos, quat, gate)
}

fn poses<'a>(n: usize, d: &'a (Vec<f64>, Vec<f64>, Vec<f64>)) -> WorldPoses<'a> {
    WorldPoses {
        n_worlds: n,
        drone_pos_m: &d.0,
        drone_quat_xyzw: &d.1,
        obstacle_pos_m: Some(&d.2),
        obstacle_quat_xyzw: None,
    }
}

#[test]
fn a_batch_is_the_same_for_any_number_of_threads_and_equals_single_frames() {
    let scene = batch_scene();
    let data = batch_poses(23);
    let cameras = [0, 1].map(|d| {
        Camera::on_drone(&scene, d, "fpv").unwrap().with_size(17, 11).unwrap().with_range(0.1, 6.0).unwrap()
    });
    let mut results = Vec::new();
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut out = DepthBatch::default();
        pool.install(|| out.render(&poses(23, &data).within(&WorkerPool::new(&scene)), &cameras)).unwrap();
        results.push(out);
    }
    assert_eq!(results[0], results[1]);
    assert_eq!(results[0], results[2]);
    let mut worker: Worker = scene.worker().unwrap();
    let mut frame = DepthFrame::new();
    let seen = results[0].status.iter().map(|s| *s as usize).fold([0; 4], |mut n, s| {
        n[s] += 1;
        n
    });
    assert!(seen[..3].iter().all(|n| *n > 50), "{seen:?}");
    for world in 0..23 {
        poses(23, &data).apply(world, &mut worker).unwrap();
        for (c, camera) in cameras.iter().enumerate() {
            camera.render(&mut worker, &mut frame).unwrap();
            let at = (world * 2 + c) * 187..(world * 2 + c + 1) * 187;
            assert_eq!(frame.depth_m, results[0].depth_m[at.clone()]);
            assert_eq!(frame.geom_id, results[0].geom_id[at]);
            assert_eq!(frame.pos_m, results[0].pose[world * 2 + c].pos_m);
        }
    }
}

#[test]
fn a_batch_fills_the_planes_that_are_asked_for_and_refuses_others_of_another_length() {
    let scene = batch_scene();
    let mut data = batch_poses(5);
    let cameras = [0, 1].map(|d| Camera::on_drone(&scene, d, "fpv").unwrap().with_size(9, 7).unwrap());
    let pool = WorkerPool::new(&scene);
    let (mut depth, mut normal) = (vec![0.0; 5 * 2 * 63], vec![[0.0; 3]; 5 * 2 * 63]);
    let mut pose = vec![Pose::default(); 10];
    let into = |depth: &mut [f32], normal: &mut [[f32; 3]], pose: &mut [Pose], data: &_| {
        let planes = DepthPlanes { depth_m: Some(depth), normal: Some(normal), ..DepthPlanes::default() };
        poses(5, data).within(&pool).render(&|_| &cameras[..], planes, pose)
    };
    into(&mut depth, &mut normal, &mut pose, &data).unwrap();
    let (mut worker, mut frame) = (scene.worker().unwrap(), DepthFrame::new());
    for world in 0..5 {
        poses(5, &data).apply(world, &mut worker).unwrap();
        for (c, camera) in cameras.iter().enumerate() {
            camera.clone().with_normals(true).render(&mut worker, &mut frame).unwrap();
            let at = (world * 2 + c) * 63..(world * 2 + c + 1) * 63;
            assert_eq!(frame.depth_m, depth[at.clone()]);
            assert_eq!(frame.normal.as_deref(), Some(&normal[at]));
            assert_eq!(frame.quat_xyzw, pose[world * 2 + c].quat_xyzw);
        }
    }

    let short = into(&mut depth[1..], &mut normal, &mut pose, &data).unwrap_err().to_string();
    assert!(short.contains("depths") && short.contains("630") && short.contains("629"), "{short}");
    let few = into(&mut depth, &mut normal, &mut pose[1..], &data).unwrap_err().to_string();
    assert!(few.contains("poses of cameras") && few.contains("got 9"), "{few}");
    data.0[3 * 2 * 3] = f64::NAN;
    assert!(matches!(into(&mut depth, &mut normal, &mut pose, &data), Err(SenseError::Worlds { .. })));
    assert!(depth[3 * 126..4 * 126].iter().all(|d| d.is_nan()) && !depth[4 * 126].is_nan());
    assert!(normal[3 * 126..4 * 126].iter().all(|n| *n == [0.0; 3]) && pose[6].pos_m[0].is_nan());
}

#[test]
fn a_world_that_is_not_finite_is_named_and_harms_no_other() {
    let scene = batch_scene();
    let mut data = batch_poses(6);
    let camera = [Camera::on_drone(&scene, 0, "fpv").unwrap().with_size(8, 8).unwrap()];
    let mut good = DepthBatch::default();
    let pool = WorkerPool::new(&scene);
    good.render(&poses(6, &data).within(&pool), &camera).unwrap();
    data.0[(2 * 2 + 1) * 3] = f64::NAN;
    // A batch that was rendered before keeps nothing of it in the world that fails.
    let mut bad = good.clone();
    let error = bad.render(&poses(6, &data).within(&pool), &camera).unwrap_err();
    let message = error.to_string();
    assert!(message.contains("world 2") && message.contains("drone 1"), "{message}");
    let SenseError::Worlds { failures, .. } = error else { panic!("{error:?}") };
    assert_eq!(failures.iter().map(|f| f.0).collect::<Vec<_>>(), [2]);
    for world in 0..6 {
        let at = world * 64..(world + 1) * 64;
        if world == 2 {
            assert!(bad.depth_m[at.clone()].iter().all(|d| d.is_nan()));
            assert!(bad.status[at].iter().all(|s| *s == STATUS_NOT_RENDERED));
            assert!(bad.pose[world].pos_m.iter().all(|v| v.is_nan()), "{:?}", bad.pose[world]);
        } else {
            assert_eq!(bad.depth_m[at.clone()], good.depth_m[at]);
        }
    }
    data.0.pop();
    assert!(matches!(bad.render(&poses(6, &data).within(&pool), &camera), Err(SenseError::Shape { .. })));
}

#[test]
fn absurd_numbers_of_worlds_are_refused_and_no_panic() {
    let out = &mut DepthBatch::default();
    let view = Pose::new([0.0; 3], LOOKING_FORWARD_XYZW);
    let empty = build("<mujoco/>", &[]);
    let camera = [Camera::in_world(&empty, view, Lens::Fovy { fovy_deg: 60.0 }).unwrap()];
    let none = (vec![], vec![], vec![]);
    let message =
        out.render(&poses(usize::MAX, &none).within(&WorkerPool::new(&empty)), &camera).unwrap_err();
    assert!(message.to_string().contains("fewer worlds"), "{message}");
    let scene = batch_scene();
    let camera = [Camera::on_drone(&scene, 0, "fpv").unwrap()];
    let data = batch_poses(1);
    let error =
        out.render(&poses(usize::MAX / 2, &data).within(&WorkerPool::new(&scene)), &camera).unwrap_err();
    assert!(matches!(error, SenseError::Shape { .. }), "{error}");
}

#[test]
fn asking_before_update_is_an_error_and_not_an_old_image() {
    let scene = batch_scene();
    let mut worker = scene.worker().unwrap();
    let camera = Camera::on_drone(&scene, 0, "fpv").unwrap();
    worker.set_drone(0, [0.0, 0.0, 1.0], LEVEL).unwrap();
    let error = camera.render(&mut worker, &mut DepthFrame::new()).unwrap_err();
    assert!(matches!(error, SenseError::Scene(SceneError::Stale { .. })), "{error}");
}

#[test]
fn noise_has_the_stated_spread_keeps_the_clean_frame_and_repeats() {
    let xml = "<mujoco><worldbody><geom type='box' size='0.1 50 50' pos='3.1 0 0'/></worldbody></mujoco>";
    let scene = build(xml, &[]);
    let mut worker = scene.worker().unwrap();
    let camera =
        Camera::in_world(&scene, Pose::new([0.0; 3], LOOKING_FORWARD_XYZW), Lens::Fovy { fovy_deg: 90.0 })
            .unwrap()
            .with_size(120, 100)
            .unwrap()
            .with_kind(DepthKind::Range);
    let mut clean = DepthFrame::new();
    camera.render(&mut worker, &mut clean).unwrap();
    let kept = clean.clone();
    let key = NoiseKey { seed: 3, world: 1, drone: 0, step: 9, camera: 0 };
    let noise = DepthNoise { dropout_probability: 0.1, ..DepthNoise::kinect_v1() };
    let (mut a, mut b, mut c) = (DepthFrame::new(), DepthFrame::new(), DepthFrame::new());
    noise.apply(&camera, &clean, key, &mut a).unwrap();
    noise.apply(&camera, &clean, key, &mut b).unwrap();
    noise.apply(&camera, &clean, NoiseKey { step: 10, ..key }, &mut c).unwrap();
    assert_eq!(clean, kept);
    assert_eq!(a, b);
    assert_ne!(a.depth_m, c.depth_m);
    // σ(3 m) = 1.2 mm + 1.9 mm · 2.6² = 14.044 mm of z-depth.
    let sigma = 0.0012 + 0.0019 * 2.6 * 2.6;
    assert!((noise.sigma_m(3.0) - sigma).abs() < 1e-15);
    let (mut sum, mut n, mut lost) = (0.0, 0.0, 0.0);
    for i in 0..clean.depth_m.len() {
        if a.status[i] == MISS {
            lost += 1.0;
            assert_eq!(a.depth_m[i], f32::INFINITY);
            continue;
        }
        let cosine = -camera.rays()[i][2];
        sum += (f64::from(a.depth_m[i] - clean.depth_m[i]) * cosine).powi(2);
        n += 1.0;
    }
    let spread = (sum / n).sqrt();
    assert!((spread / sigma - 1.0).abs() < 0.03, "{spread} {sigma}");
    assert!((lost / 12_000.0 - 0.1f64).abs() < 0.01, "{lost}");

    let steps = DepthNoise { quantum_m: 0.02, ..DepthNoise::default() };
    let z = camera.clone().with_kind(DepthKind::ZDepth);
    z.render(&mut worker, &mut clean).unwrap();
    steps.apply(&z, &clean, key, &mut a).unwrap();
    assert!(a.depth_m.iter().all(|d| (d / 0.02 - (d / 0.02).round()).abs() < 1e-3));
    let none = DepthNoise::default();
    none.apply(&z, &clean, key, &mut a).unwrap();
    assert_eq!(a, clean);
    assert!(DepthNoise { dropout_probability: 1.5, ..none }.apply(&z, &clean, key, &mut a).is_err());
}

#[test]
fn flying_pixels_lie_between_both_sides_of_an_edge() {
    let xml = "<mujoco><worldbody><geom type='box' size='0.1 50 50' pos='5.1 0 0'/><geom type='box' size='0.1 5 50' pos='2.1 5 0'/></worldbody></mujoco>";
    let scene = build(xml, &[]);
    let mut worker = scene.worker().unwrap();
    let camera =
        Camera::in_world(&scene, Pose::new([0.0; 3], LOOKING_FORWARD_XYZW), Lens::Fovy { fovy_deg: 60.0 })
            .unwrap()
            .with_size(40, 40)
            .unwrap()
            .with_kind(DepthKind::ZDepth);
    let (mut clean, mut noisy) = (DepthFrame::new(), DepthFrame::new());
    camera.render(&mut worker, &mut clean).unwrap();
    let noise = DepthNoise { flying_probability: 1.0, flying_edge_m: 0.5, ..DepthNoise::default() };
    let key = NoiseKey { seed: 3, world: 1, drone: 0, step: 9, camera: 0 };
    noise.apply(&camera, &clean, key, &mut noisy).unwrap();
    let mut flying = 0;
    for i in 0..1600 {
        if noisy.depth_m[i] != clean.depth_m[i] {
            flying += 1;
            assert!((18..=21).contains(&(i % 40)), "column {}", i % 40);
            assert!(noisy.depth_m[i] > 1.99 && noisy.depth_m[i] < 5.01);
        }
    }
    assert!(flying > 60, "{flying}");
}

#[test]
fn impossible_cameras_are_refused() {
    let scene = build("<mujoco/>", &[]);
    let at = Pose::default();
    for lens in [
        Lens::Fovy { fovy_deg: 0.0 },
        Lens::Fovy { fovy_deg: 180.0 },
        Lens::Fovy { fovy_deg: f64::NAN },
        Lens::Pinhole { fx_px: 0.0, fy_px: 1.0, cx_px: 0.0, cy_px: 0.0, size: [4, 4] },
        Lens::Pinhole { fx_px: 1.0, fy_px: 1.0, cx_px: 0.0, cy_px: 0.0, size: [0, 4] },
    ] {
        assert!(Camera::in_world(&scene, at, lens).is_err(), "{lens:?}");
    }
    let camera = Camera::in_world(&scene, at, Lens::Fovy { fovy_deg: 60.0 }).unwrap();
    assert!(camera.clone().with_size(0, 5).is_err());
    assert!(camera.clone().with_size(5, 100_000).is_err());
    assert!(Camera::in_world(&scene, Pose::new([f64::NAN; 3], LEVEL), camera.lens()).is_err());
    assert!(Camera::mounted(&scene, 0, at, camera.lens()).is_err());
    // An empty world is all misses.
    let mut frame = DepthFrame::new();
    camera.render(&mut scene.worker().unwrap(), &mut frame).unwrap();
    assert!(frame.status.iter().all(|s| *s == MISS));
}
