//! The native ray caster against `mj_ray`, geom type by geom type, and the rules of patterns, rays and planes.

#[path = "common/notes.rs"]
mod notes;

#[path = "common/rays.rs"]
mod rays;

#[path = "common/scenes.rs"]
mod scenes;

use propwash::math::quat;
use propwash::random::Stream;
use propwash::scene::{GeomType, Pose, Scene, Shell, Worker};
use propwash::sense::depth::LOOKING_FORWARD_XYZW;
use propwash::sense::{
    Camera, Caster, DepthFrame, DepthKind, DepthPlanes, Lens, Queries, RayHits, RayPattern, RayPlanes,
    RayQuery, SenseError,
};
use rays::{Agreement, GROUPS, draws, mixed, origin, own_kinds, zoo};
use scenes::{build, random_quat, random_unit};

const LEVEL: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

/// More than 130,000 rays of each type that has a closed form, in bundles of 64 from one point: over the whole sphere, in
/// narrow cones.
#[test]
fn packets_agree_with_mj_ray_for_every_geom_type() {
    let mut all = Agreement::default();
    for kind in own_kinds() {
        let mut own = Agreement::default();
        let mut s = draws(100 + kind as u64);
        for _ in 0..4 {
            let scene = zoo(kind, &mut s);
            let mut worker = scene.worker().unwrap();
            for _ in 0..520 {
                compare_bundle(&scene, &mut worker, &mut s, &mut own);
            }
        }
        println!("{kind}: {}", own.told());
        assert!(own.rays > 130_000 && own.hits > 20_000, "{kind}");
        assert!(own.error(0.999) < 1e-5 && own.error(1.0) < 2e-4, "{kind}: {}", own.told());
        // A crack would show the wall behind.
        assert!(own.flips <= 2 && own.labels <= 2, "{kind}: {} {}", own.flips, own.labels);
        all.add(own);
    }
    let version = propwash::scene::mujoco_version();
    notes::tell(&format!(
        "native caster (f32 lanes) vs mj_ray (f64) of MuJoCo {version}, 8 geom types: {}",
        all.told()
    ));
    assert!(all.rays >= 1_000_000);
    assert!((all.flips as f64) < 1e-5 * all.rays as f64, "{}", all.flips);
}

fn compare_bundle(scene: &Scene, worker: &mut Worker, s: &mut Stream, sum: &mut Agreement) {
    let pos = origin(scene, worker, s);
    let pose = Pose::new(pos, random_quat(s));
    let spread = [3.0, 0.3, 0.03][(s.unit() * 2.999) as usize];
    let axis = random_unit(s);
    let directions: Vec<[f64; 3]> = (0..64)
        .map(|_| {
            let e = random_unit(s);
            [0, 1, 2].map(|k| axis[k] + spread * e[k])
        })
        .filter(|d| d.iter().map(|x| x * x).sum::<f64>() > 1e-6)
        .collect();
    sum.compare(worker, &pose, &directions);
}

/// Rays that pass along surfaces: from 1 µm to 0.1 m beside one (or below it) and from afar, along its tangent, bent by up to 0.1 rad.
#[test]
fn rays_that_graze_agree_with_mj_ray() {
    let mut all = Agreement::default();
    for kind in own_kinds() {
        let mut own = Agreement::default();
        let mut s = draws(300 + kind as u64);
        let scene = zoo(kind, &mut s);
        let mut worker = scene.worker().unwrap();
        while own.rays < 50_000 {
            let pos = origin(&scene, &worker, &mut s);
            let towards = random_unit(&mut s);
            let ray = worker.ray(pos, towards, Some(&GROUPS), None).unwrap();
            let Some(hit) = ray.filter(|h| h.distance < 20.0) else { continue };
            let n = hit.normal;
            let e = random_unit(&mut s);
            let off = e[0] * n[0] + e[1] * n[1] + e[2] * n[2];
            let along = [0, 1, 2].map(|k| e[k] - off * n[k]);
            let length = along.iter().map(|x| x * x).sum::<f64>().sqrt();
            if length < 0.1 {
                continue;
            }
            let along = along.map(|x| x / length);
            let beside = 10f64.powf(s.uniform(-6.0, -1.0)) * if s.unit() < 0.2 { -1.0 } else { 1.0 };
            let back = if s.unit() < 0.5 { 0.0 } else { s.uniform(0.0, 6.0) };
            let from =
                [0, 1, 2].map(|k| pos[k] + hit.distance * towards[k] + beside * n[k] - back * along[k]);
            let directions: Vec<[f64; 3]> = (0..16)
                .map(|_| {
                    let bend = 10f64.powf(s.uniform(-5.0, -1.0));
                    let e = random_unit(&mut s);
                    [0, 1, 2].map(|k| along[k] + bend * e[k])
                })
                .collect();
            own.compare(&mut worker, &Pose::new(from, LEVEL), &directions);
        }
        println!("{kind}: {}", own.told());
        all.add(own);
    }
    notes::tell(&format!("native caster, grazing rays vs mj_ray: {}", all.told()));
    assert!(all.hits > 50_000, "{}", all.hits);
    assert!((all.flips as f64) < 1e-4 * all.rays as f64, "{}", all.flips);
    assert!(all.labels <= 20 && all.error(0.5) < 1e-6 && all.error(0.99) < 1e-2, "{}", all.told());
}

/// The f64 rays, with normals, from many points.
#[test]
fn single_rays_agree_with_mj_ray_for_every_geom_type() {
    let mut total = 0;
    let mut worst = 0.0f64;
    for kind in GeomType::ALL {
        let mut s = draws(200 + kind as u64);
        let scene = zoo(kind, &mut s);
        let mut worker = scene.worker().unwrap();
        let n = if kind == GeomType::Sdf { 3_000 } else { 20_000 };
        let origins: Vec<_> = (0..n).map(|_| origin(&scene, &worker, &mut s)).collect();
        let directions: Vec<_> = (0..n).map(|_| random_unit(&mut s).map(|x| x * (0.5 + s.unit()))).collect();
        let mut hits = RayHits::default();
        Queries::at(&mut worker).rays(&origins, &directions, &RayQuery::default(), &mut hits).unwrap();
        let (mut flips, mut seen, mut normals) = (0, 0, 0);
        for i in 0..n {
            let length = directions[i].iter().map(|x| x * x).sum::<f64>().sqrt();
            let d = directions[i].map(|x| x / length);
            let truth = worker.ray(origins[i], d, Some(&GROUPS), None).unwrap();
            let Some(hit) = truth else {
                flips += usize::from(hits.range_m[i].is_finite());
                continue;
            };
            seen += 1;
            if hits.geom_id[i] != hit.geom_id {
                flips += 1;
                continue;
            }
            let error = (hits.range_m[i] - hit.distance).abs() / hit.distance.max(1e-2);
            worst = worst.max(error);
            assert!(error < 1e-9, "{kind}: {} {}", hits.range_m[i], hit.distance);
            let off = (0..3).map(|k| (hits.normal[i][k] - hit.normal[k]).abs()).fold(0.0, f64::max);
            normals += usize::from(off > 1e-6);
        }
        total += n;
        assert!(seen > n / 20, "{kind}: {seen}");
        // Rays within 1e-15 m of an outline, and normals on an edge.
        assert!(flips == 0, "{kind}: {flips} of {n}");
        assert!(normals <= 1, "{kind}: {normals} normals of {seen}");
    }
    notes::tell(&format!(
        "native single rays (f64) vs mj_ray: {total} rays at 9 geom types, all at the same geom, worst {worst:.1e} \
         relative, normals within 1e-6"
    ));
}

/// All planes of frames of the native caster against those of MuJoCo's rays.
#[test]
fn frames_are_those_of_mujocos_rays() {
    let mut worst = 0.0f64;
    let (mut pixels, mut odd) = (0, 0);
    for kind in GeomType::ALL {
        let mut s = draws(300 + kind as u64);
        let scene = zoo(kind, &mut s);
        let mut worker = scene.worker().unwrap();
        let (mut ours, mut theirs) = (DepthFrame::new(), DepthFrame::new());
        for image in 0..40 {
            let pos = origin(&scene, &worker, &mut s);
            let lens = Lens::Fovy { fovy_deg: s.uniform(20.0, 150.0) };
            let camera = Camera::in_world(&scene, Pose::new(pos, random_quat(&mut s)), lens)
                .unwrap()
                .with_size(21 + image % 5, 9 + image % 9)
                .unwrap()
                .with_normals(true)
                .with_range(0.2, 6.0)
                .unwrap()
                .with_kind(if image % 2 == 0 { DepthKind::Range } else { DepthKind::ZDepth });
            assert_eq!(camera.caster(), Caster::Native);
            camera.render(&mut worker, &mut ours).unwrap();
            camera.clone().with_caster(Caster::MuJoCo).render(&mut worker, &mut theirs).unwrap();
            assert_eq!((ours.pos_m, ours.k, ours.kind), (theirs.pos_m, theirs.k, theirs.kind));
            for i in 0..ours.depth_m.len() {
                pixels += 1;
                let same = ours.status[i] == theirs.status[i]
                    && ours.geom_id[i] == theirs.geom_id[i]
                    && ours.body_id[i] == theirs.body_id[i];
                let (a, b) = (ours.normal.as_ref().unwrap()[i], theirs.normal.as_ref().unwrap()[i]);
                let turned = (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f32::max);
                if !same || turned > 1e-4 {
                    odd += 1;
                    continue;
                }
                let (a, b) = (f64::from(ours.depth_m[i]), f64::from(theirs.depth_m[i]));
                if a.is_finite() || b.is_finite() {
                    worst = worst.max((a - b).abs() / b.max(1e-2));
                }
            }
        }
    }
    notes::tell(&format!(
        "native frames vs frames by mj_multiRay: {pixels} pixels with state, geom, body, normal, {odd} differ; depth \
         worst {worst:.1e} relative"
    ));
    assert!(odd * 20_000 < pixels, "{odd} of {pixels}");
    assert!(worst < 1e-4, "{worst}");
}

/// Drones, guards on child bodies, obstacles that move, groups, alpha, all of it turned about.
#[test]
fn what_moves_and_what_is_hidden_is_as_with_mujocos_rays() {
    let guarded = Shell {
        name: "guarded".into(),
        xml: r#"<mujoco><asset><mesh name='m' builtin='supertorus' params='9 0.4 1 1' scale='0.1 0.1 0.1'/></asset>
            <worldbody><body name='drone'><geom type="box" size="0.2 0.2 0.05"/><geom type="mesh" mesh="m" pos="0 0 0.2"/>
            <camera name="fpv" xyaxes="0 -1 0 0 0 1" fovy="100"/>
            <body pos="0.3 0 0"><geom type="box" size="0.01 0.3 0.3"/>
            <body pos="0.1 0 0"><geom type="sphere" size="0.05"/></body></body></body></worldbody></mujoco>"#
            .into(),
        dir: None,
    };
    let xml = r#"<mujoco><asset><material name="glass" rgba="1 1 1 0"/></asset><worldbody>
        <geom type="plane" size="0 0 1"/><geom type="cylinder" size="0.3 2" pos="2 0 1"/>
        <geom type="box" size="0.1 9 9" pos="1 0 0" group="3"/><geom type="box" size="0.1 9 9" pos="2 0 0" rgba="1 0 0 0"/>
        <geom type="box" size="0.1 9 9" pos="3 0 0" material="glass"/><geom type="ellipsoid" size="1 .4 .3" pos="-2 1 1"/>
        <body mocap="true" pos="1 1 1"><geom type="capsule" size="0.1 0.5"/>
          <body pos="0 0 1"><geom type="sphere" size=".2"/></body></body>
        <body pos="0 -2 1"><freejoint/><geom type="box" size="0.4 0.1 0.6"/></body>
        <body pos="0 2 1"><joint type="hinge" axis="0 0 1" ref="30"/><geom type="box" size="0.4 0.1 0.6"/></body>
        </worldbody></mujoco>"#;
    let scene = build(xml, &[guarded.clone(), guarded]);
    let mut worker = scene.worker().unwrap();
    let mut s = draws(5);
    let (mut ours, mut theirs) = (DepthFrame::new(), DepthFrame::new());
    let mut kinds = std::collections::BTreeSet::new();
    let mut odd = 0;
    for trial in 0..60 {
        for drone in 0..2 {
            let pos = [s.uniform(-1.0, 1.0), s.uniform(-1.0, 1.0), s.uniform(0.3, 2.0)];
            worker.set_drone(drone, pos, random_quat(&mut s)).unwrap();
        }
        for obstacle in 0..2 {
            let pos = [0; 3].map(|_| s.uniform(-2.0, 2.0));
            worker.set_obstacle(obstacle, pos, random_quat(&mut s)).unwrap();
        }
        worker.update().unwrap();
        let camera = Camera::on_drone(&scene, trial % 2, "fpv").unwrap().with_size(30, 20).unwrap();
        let mut camera = camera.with_kind(DepthKind::Range);
        if trial % 3 == 1 {
            camera = camera.with_groups([true; 6]);
        }
        if trial % 5 == 2 {
            camera = camera.seeing_itself();
        }
        camera.render(&mut worker, &mut ours).unwrap();
        let oracle = camera.with_caster(Caster::MuJoCo);
        oracle.render(&mut worker, &mut theirs).unwrap();
        for i in 0..600 {
            let same = (ours.status[i], ours.geom_id[i], ours.body_id[i])
                == (theirs.status[i], theirs.geom_id[i], theirs.body_id[i]);
            odd += usize::from(!same);
            kinds.insert(ours.geom_id[i]);
            if same && theirs.depth_m[i].is_finite() {
                let error = (ours.depth_m[i] - theirs.depth_m[i]).abs();
                assert!(
                    error <= 2e-5 * theirs.depth_m[i].max(0.05),
                    "{} {}",
                    ours.depth_m[i],
                    theirs.depth_m[i]
                );
            }
        }
    }
    assert!(odd <= 1, "{odd} of 36,000");
    assert!(kinds.len() > 12, "{kinds:?}");
}

#[test]
fn asking_for_fewer_planes_changes_none_of_them() {
    let mut s = draws(6);
    let scene = zoo(GeomType::Capsule, &mut s);
    let mut worker = scene.worker().unwrap();
    let view = Pose::new([6.0, 0.0, 0.0], random_quat(&mut s));
    for (width, height) in [(1, 1), (7, 5), (64, 64), (33, 4), (3, 70)] {
        let camera = Camera::in_world(&scene, view, Lens::Fovy { fovy_deg: 120.0 })
            .unwrap()
            .with_size(width, height)
            .unwrap();
        let n = width * height;
        let (mut plain, mut full) = (DepthFrame::new(), DepthFrame::new());
        camera.render(&mut worker, &mut plain).unwrap();
        camera.clone().with_normals(true).render(&mut worker, &mut full).unwrap();
        assert_eq!((&plain.depth_m, &plain.geom_id), (&full.depth_m, &full.geom_id));
        let mut depth = vec![0.0; n];
        let planes = DepthPlanes { depth_m: Some(&mut depth), ..DepthPlanes::default() };
        let pose = camera.render_into(&mut worker, planes).unwrap();
        assert_eq!((depth, pose.pos_m), (plain.depth_m, plain.pos_m));
        let (mut body, mut normal) = (vec![0; n], vec![[0.0; 3]; n]);
        let planes =
            DepthPlanes { body_id: Some(&mut body), normal: Some(&mut normal), ..DepthPlanes::default() };
        camera.render_into(&mut worker, planes).unwrap();
        assert_eq!((Some(normal), body), (full.normal, full.body_id));
        let mut short = vec![0.0; n + 1];
        let planes = DepthPlanes { depth_m: Some(&mut short), ..DepthPlanes::default() };
        assert!(matches!(camera.render_into(&mut worker, planes), Err(SenseError::Shape { .. })));
    }
}

/// A LiDAR with rings over the whole turn, and one ray alone, equal single rays.
#[test]
fn lidar_patterns_see_what_single_rays_see() {
    let mut s = draws(7);
    let scene = build(&mixed(40, &mut s), &[]);
    let mut worker = scene.worker().unwrap();
    for rings in [16, 1] {
        let mut directions = Vec::new();
        for ring in 0..rings {
            for step in 0..if rings == 1 { 1 } else { 361 } {
                let (up, turn) = (f64::from(ring) * 0.07 - 0.5, f64::from(step) * 0.0174);
                directions.push([up.cos() * turn.cos(), up.cos() * turn.sin(), up.sin()]);
            }
        }
        let pattern = RayPattern::new(&directions).unwrap();
        let pose = Pose::new([0.3, 4.5, 0.2], random_quat(&mut s));
        let n = directions.len();
        let (mut range, mut geom, mut normal) = (vec![0.0; n], vec![0; n], vec![[0.0; 3]; n]);
        let planes = RayPlanes {
            range_m: Some(&mut range),
            geom_id: Some(&mut geom),
            normal: Some(&mut normal),
            body_id: None,
        };
        Queries::at(&mut worker).pattern(&pose, &pattern, &RayQuery::default(), planes).unwrap();
        let world: Vec<_> = directions.iter().map(|d| quat::rotate(pose.quat_xyzw, *d)).collect();
        let mut hits = RayHits::default();
        Queries::at(&mut worker).rays(&vec![pose.pos_m; n], &world, &RayQuery::default(), &mut hits).unwrap();
        let mut odd = 0;
        for i in 0..n {
            if geom[i] != hits.geom_id[i] {
                odd += 1;
                continue;
            }
            if geom[i] >= 0 {
                let error = (f64::from(range[i]) - hits.range_m[i]).abs() / hits.range_m[i];
                assert!(error < 1e-4, "{} {}", range[i], hits.range_m[i]);
                let dot: f64 = (0..3).map(|k| f64::from(normal[i][k]) * hits.normal[i][k]).sum();
                assert!(dot > 0.999_99, "{:?} {:?}", normal[i], hits.normal[i]);
            }
        }
        assert!(odd <= 1, "{odd}");
    }
}

/// A query that hides the only drone of a scene.
fn query_of_another_scene() -> RayQuery {
    let xml = "<mujoco><worldbody><body name='drone'><geom size='.1'/></body></worldbody></mujoco>";
    let shell = Shell { name: "ball".into(), xml: xml.into(), dir: None };
    let other = build("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", &[shell]);
    RayQuery::default().without_drone(&other, 0).unwrap()
}

#[test]
fn rays_that_cannot_be_cast_are_named() {
    let scene = build("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", &[]);
    let mut worker = scene.worker().unwrap();
    for bad in [[0.0; 3], [f64::NAN, 0.0, 1.0], [f64::INFINITY, 0.0, 0.0]] {
        let message = RayPattern::new(&[[1.0, 0.0, 0.0], bad]).unwrap_err().to_string();
        assert!(message.contains("ray 1"), "{message}");
        let mut hits = RayHits::default();
        let query = RayQuery::default();
        let message =
            Queries::at(&mut worker).rays(&[[0.0; 3]], &[bad], &query, &mut hits).unwrap_err().to_string();
        assert!(message.contains("ray 0"), "{message}");
    }
    let empty = RayPattern::new(&[]).unwrap();
    assert!(empty.is_empty());
    Queries::at(&mut worker)
        .pattern(&Pose::default(), &empty, &RayQuery::default(), RayPlanes::default())
        .unwrap();
    let pattern = RayPattern::new(&[[1.0, 0.0, 0.0]; 3]).unwrap();
    let mut short = [0.0; 2];
    let planes = RayPlanes { range_m: Some(&mut short), ..RayPlanes::default() };
    let query = RayQuery::default();
    assert!(Queries::at(&mut worker).pattern(&Pose::default(), &pattern, &query, planes).is_err());
    for (query, name) in
        [(RayQuery::default().without_body(7), "body 7"), (query_of_another_scene(), "drone 0")]
    {
        let told = Queries::at(&mut worker).pattern(&Pose::default(), &pattern, &query, RayPlanes::default());
        let message = told.unwrap_err().to_string();
        assert!(message.contains(name) && message.contains("does not exist"), "{message}");
        let mut hits = RayHits::default();
        let told = Queries::at(&mut worker).rays(&[[0.0; 3]], &[[1.0, 0.0, 0.0]], &query, &mut hits);
        assert_eq!(told.unwrap_err().to_string(), message);
    }
    // MuJoCo's own rays say it too; without the check its answer is that of all bodies.
    let (at, along) = ([3.0, 0.0, 0.0], [-1.0, 0.0, 0.0]);
    assert!(worker.ray(at, along, None, Some(0)).unwrap().is_none());
    let message = worker.ray(at, along, None, Some(7)).unwrap_err().to_string();
    assert!(message.contains("body 7 does not exist"), "{message}");
    let (mut distances, mut geoms) = ([0.0], [0]);
    assert!(worker.rays(at, &[along], None, Some(7), &mut distances, &mut geoms, None).is_err());
    let nowhere = Pose::new([f64::NAN; 3], LEVEL);
    assert!(Queries::at(&mut worker).pattern(&nowhere, &pattern, &query, RayPlanes::default()).is_err());
}

/// Rays along the axes and through edges and corners, where divisions by zero lurk.
#[test]
fn rays_along_axes_through_edges_and_corners_are_finite() {
    let xml = r#"<mujoco><worldbody><geom type="box" size="1 1 1"/><geom type="cylinder" size="1 1" pos="5 0 0"/>
        <geom type="capsule" size="1 1" pos="-5 0 0"/></worldbody></mujoco>"#;
    let scene = build(xml, &[]);
    let mut worker = scene.worker().unwrap();
    let mut directions = Vec::new();
    for x in -1..=1 {
        for y in -1..=1 {
            for z in -1..=1 {
                if (x, y, z) != (0, 0, 0) {
                    directions.push([f64::from(x), f64::from(y), f64::from(z)]);
                }
            }
        }
    }
    let pattern = RayPattern::new(&directions).unwrap();
    for centre in [0.0, 5.0, -5.0] {
        for place in [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 3.0], [0.2, 0.3, -0.4]] {
            let pos = [centre + place[0], place[1], place[2]];
            let mut range = vec![0.0; pattern.len()];
            let planes = RayPlanes { range_m: Some(&mut range), ..RayPlanes::default() };
            Queries::at(&mut worker)
                .pattern(&Pose::new(pos, LEVEL), &pattern, &RayQuery::default(), planes)
                .unwrap();
            for i in 0..pattern.len() {
                assert!(!range[i].is_nan() && range[i] >= 0.0, "{pos:?} {:?}: {}", directions[i], range[i]);
                // Through a corner either answer is right.
                let d = pattern.direction(i);
                let nudged = [d[0] + 1e-4, d[1] + 2e-4, d[2] - 1e-4];
                let before = worker.ray(pos, nudged, None, None).unwrap();
                let nudged = [d[0] - 1e-4, d[1] - 2e-4, d[2] + 1e-4];
                let after = worker.ray(pos, nudged, None, None).unwrap();
                if let (Some(a), Some(b)) = (before, after)
                    && (a.distance - b.distance).abs() < 0.01
                {
                    assert!((f64::from(range[i]) - a.distance).abs() < 0.01, "{pos:?} {d:?}: {}", range[i]);
                }
            }
        }
    }
}

/// Far from the origin of the world f32 has few digits; distances do not lose them.
#[test]
fn a_scene_far_from_the_origin_of_the_world_is_seen_as_well() {
    let heights: Vec<String> = (0..100).map(|k| format!("{:.3}", f64::from(k * 37 % 11) / 11.0)).collect();
    let at = "8000 -6000 300";
    let xml = format!(
        "<mujoco><asset><hfield name='h' nrow='10' ncol='10' size='3 3 1 0.1' elevation='{}'/>\
         <mesh name='m' builtin='supertorus' params='24 0.4 1 1'/></asset><worldbody>\
         <geom type='hfield' hfield='h' pos='{at}'/><body pos='{at}'><geom type='mesh' mesh='m' pos='0 0 3'/>\
         <geom type='box' size='.3 .3 .3' pos='2 2 2'/><geom type='cylinder' size='.3 .3' pos='-2 2 2'/>\
         <geom type='capsule' size='.3 .3' pos='-2 -2 2'/><geom type='ellipsoid' size='.3 .5 .4' pos='2 -2 2'/></body>\
         </worldbody></mujoco>",
        heights.join(" ")
    );
    let scene = build(&xml, &[]);
    let mut worker = scene.worker().unwrap();
    let mut s = draws(9);
    let (mut ours, mut theirs) = (DepthFrame::new(), DepthFrame::new());
    let (mut odd, mut hits) = (0, 0);
    for _ in 0..30 {
        let pos =
            [8000.0 + s.uniform(-4.0, 4.0), -6000.0 + s.uniform(-4.0, 4.0), 302.0 + s.uniform(-1.0, 4.0)];
        let camera =
            Camera::in_world(&scene, Pose::new(pos, random_quat(&mut s)), Lens::Fovy { fovy_deg: 120.0 })
                .unwrap()
                .with_kind(DepthKind::Range);
        camera.render(&mut worker, &mut ours).unwrap();
        let oracle = camera.with_caster(Caster::MuJoCo);
        oracle.render(&mut worker, &mut theirs).unwrap();
        for i in 0..4096 {
            if ours.geom_id[i] != theirs.geom_id[i] {
                odd += 1;
            } else if ours.geom_id[i] >= 0 {
                hits += 1;
                let error = (ours.depth_m[i] - theirs.depth_m[i]).abs() / theirs.depth_m[i].max(0.1);
                assert!(error < 1e-4, "{error} {}", theirs.depth_m[i]);
            }
        }
    }
    assert!(hits > 20_000 && odd <= 3, "{odd} of {hits}");
}

#[test]
fn large_images_and_narrow_lenses_work() {
    let mut s = draws(10);
    let scene = zoo(GeomType::Box, &mut s);
    let mut worker = scene.worker().unwrap();
    let mut frame = DepthFrame::new();
    let pose = Pose::new([-7.0, 0.0, 0.0], LOOKING_FORWARD_XYZW);
    let wide =
        Camera::in_world(&scene, pose, Lens::Fovy { fovy_deg: 70.0 }).unwrap().with_size(1920, 1080).unwrap();
    let wide = wide.with_kind(DepthKind::Range);
    wide.render(&mut worker, &mut frame).unwrap();
    let seen = frame.geom_id.iter().filter(|g| **g >= 0).count();
    assert!(seen > 50_000);
    // A pixel of the small image lies amid 3 × 3 of the large one.
    let small = wide.clone().with_size(640, 360).unwrap();
    let mut coarse = DepthFrame::new();
    small.render(&mut worker, &mut coarse).unwrap();
    for row in 0..360 {
        for col in 0..640 {
            let (a, b) = (row * 640 + col, (3 * row + 1) * 1920 + 3 * col + 1);
            if coarse.geom_id[a] == frame.geom_id[b] && coarse.geom_id[a] >= 0 {
                assert!((coarse.depth_m[a] - frame.depth_m[b]).abs() < 1e-4 * frame.depth_m[b]);
            } else if coarse.geom_id[a] != frame.geom_id[b] {
                // Only along outlines.
                let around = [b - 1920 - 1, b - 1920 + 1, b + 1920 - 1, b + 1920 + 1];
                assert!(
                    around.iter().any(|k| frame.geom_id[*k] != frame.geom_id[b]),
                    "row {row} column {col}"
                );
            }
        }
    }
}

/// The same bits for any number of threads, any batch and whatever the worker cast before.
#[test]
fn batches_and_threads_change_no_bit() {
    use propwash::scene::WorkerPool;
    use propwash::sense::{DepthBatch, WorldPoses};
    let mut s = draws(11);
    let shell = Shell {
        name: "ball".into(),
        xml: "<mujoco><worldbody><body name='drone'><geom size='0.1'/><camera name='fpv' fovy='100'/></body></worldbody></mujoco>"
            .into(),
        dir: None,
    };
    let scene = build(&mixed(60, &mut s), &[shell.clone(), shell]);
    let n = 40;
    let (mut pos, mut quat) = (Vec::new(), Vec::new());
    for _ in 0..2 * n {
        pos.extend([0; 3].map(|_| s.uniform(-4.0, 4.0)));
        quat.extend(random_quat(&mut s));
    }
    let cameras = [0, 1].map(|d| Camera::on_drone(&scene, d, "fpv").unwrap().with_size(23, 17).unwrap());
    let batch = |first: usize, count: usize, threads: usize| {
        let poses = WorldPoses {
            n_worlds: count,
            drone_pos_m: &pos[6 * first..6 * (first + count)],
            drone_quat_xyzw: &quat[8 * first..8 * (first + count)],
            obstacle_pos_m: None,
            obstacle_quat_xyzw: None,
        };
        let mut out = DepthBatch::default();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| out.render(&poses.within(&WorkerPool::new(&scene)), &cameras)).unwrap();
        out
    };
    let all = batch(0, n, 1);
    for threads in [2, 3, 8] {
        assert_eq!(batch(0, n, threads), all, "{threads} threads");
    }
    let per_world = 2 * 23 * 17;
    for world in [0, 7, n - 1] {
        let one = batch(world, 1, 1);
        let at = world * per_world..(world + 1) * per_world;
        assert!(one.depth_m.iter().zip(&all.depth_m[at.clone()]).all(|(a, b)| a.to_bits() == b.to_bits()));
        assert_eq!(one.geom_id, all.geom_id[at]);
    }
}

/// The example of docs/depth.md.
#[test]
fn a_ring_of_beams_meets_the_ball_ahead_and_nothing_behind() {
    let xml = "<mujoco><worldbody><geom type='sphere' size='1' pos='3 0 0'/></worldbody></mujoco>";
    let scene = build(xml, &[]);
    let mut worker = scene.worker().unwrap();
    let ring: Vec<[f64; 3]> =
        (0..360).map(|k| f64::from(k).to_radians()).map(|a| [a.cos(), a.sin(), 0.0]).collect();
    let pattern = RayPattern::new(&ring).unwrap();
    let mut range_m = vec![0.0; pattern.len()];
    let planes = RayPlanes { range_m: Some(&mut range_m), ..RayPlanes::default() };
    Queries::at(&mut worker).pattern(&Pose::default(), &pattern, &RayQuery::default(), planes).unwrap();
    assert_eq!((range_m[0], range_m[180]), (2.0, f32::INFINITY));
}
