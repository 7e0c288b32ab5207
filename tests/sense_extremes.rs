//! The native ray caster where shapes or sensors are far from ordinary: thin and huge solids, meshes of slivers, lenses that
//! look backwards, sensors on a surface.

#[path = "common/notes.rs"]
mod notes;

#[path = "common/rays.rs"]
mod rays;

#[path = "common/scenes.rs"]
mod scenes;

use std::f64::consts::TAU;
use std::fmt::Write as _;

use propwash::random::Stream;
use propwash::scene::{Pose, Worker};
use propwash::sense::{
    Camera, Caster, DepthFrame, DepthKind, Lens, Queries, RayHits, RayPattern, RayPlanes, RayQuery,
};
use rays::{Agreement, draws, mixed};
use scenes::{build, random_quat, random_unit};

/// Rays from 0.3 to 20 m (and from inside, where that is possible) at points in and about the box `half` of geom 0.
fn at_a_geom(worker: &mut Worker, half: [f64; 3], from_m: [f64; 2], s: &mut Stream, sum: &mut Agreement) {
    let (pos, mat) = worker.geom_pose(0).unwrap();
    let point = |s: &mut Stream, reach: f64| {
        let u = half.map(|h| h * s.uniform(-reach, reach));
        [0, 1, 2].map(|i| pos[i] + mat[3 * i] * u[0] + mat[3 * i + 1] * u[1] + mat[3 * i + 2] * u[2])
    };
    let anchor = point(s, 1.0);
    let away = random_unit(s);
    let far = s.uniform(from_m[0], from_m[1]);
    let from = [0, 1, 2].map(|k| anchor[k] + far * away[k]);
    let directions: Vec<[f64; 3]> = (0..64)
        .map(|_| point(s, 1.2))
        .map(|to| [0, 1, 2].map(|k| to[k] - from[k]))
        .filter(|d| d.iter().map(|x| x * x).sum::<f64>() > 1e-6)
        .collect();
    sum.compare(worker, &Pose::new(from, [0.0, 0.0, 0.0, 1.0]), &directions);
}

/// Wires, plates, discs and needles, some ten thousand times thinner than wide.
#[test]
fn thin_solids_agree_with_mj_ray() {
    let mut all = Agreement::default();
    for (name, shape, half) in [
        ("wire", "type='capsule' size='.001 3'", [1e-3, 1e-3, 3.0]),
        ("rod", "type='cylinder' size='.0005 2'", [5e-4, 5e-4, 2.0]),
        ("disc", "type='cylinder' size='2 .0002'", [2.0, 2.0, 2e-4]),
        ("plate", "type='box' size='2 3 .0005'", [2.0, 3.0, 5e-4]),
        ("lath", "type='box' size='4 .002 .001'", [4.0, 2e-3, 1e-3]),
        ("needle", "type='ellipsoid' size='.001 .002 3'", [1e-3, 2e-3, 3.0]),
        ("pancake", "type='ellipsoid' size='2 2 .0005'", [2.0, 2.0, 5e-4]),
    ] {
        let mut s = draws(400 + name.len() as u64);
        let mut own = Agreement::default();
        for _ in 0..4 {
            let q = random_quat(&mut s);
            let xml = format!(
                "<mujoco><worldbody><geom {shape} pos='1 2 3' quat='{} {} {} {}'/></worldbody></mujoco>",
                q[0], q[1], q[2], q[3]
            );
            let scene = build(&xml, &[]);
            let mut worker = scene.worker().unwrap();
            for _ in 0..250 {
                at_a_geom(&mut worker, half, [0.3, 20.0], &mut s, &mut own);
            }
        }
        println!("{name}: {}", own.told());
        // Rounding of a direction to f32 is 0.6 µm at 10 m: of a wire of 1 mm one ray in a thousand.
        assert!(own.flips * 1_000 < own.rays && own.hits * 4 > own.rays, "{name}: {}", own.told());
        assert!(own.error(0.999) < 1e-4, "{name}: {}", own.told());
        all.add(own);
    }
    notes::tell(&format!("native caster, thin solids vs mj_ray: {}", all.told()));
    assert!(all.flips * 4_000 < all.rays, "{}", all.flips);
}

/// Solids of kilometres, from near their surface, from far and from inside.
#[test]
fn huge_solids_agree_with_mj_ray() {
    let mut all = Agreement::default();
    for (name, shape, half) in [
        ("planet", "type='sphere' size='2000'", [2000.0; 3]),
        ("mountain", "type='ellipsoid' size='3000 2000 500'", [3000.0, 2000.0, 500.0]),
        ("block", "type='box' size='1000 3000 200'", [1000.0, 3000.0, 200.0]),
        ("tower", "type='cylinder' size='300 2000'", [300.0, 300.0, 2000.0]),
        ("cigar", "type='capsule' size='300 2000'", [300.0, 300.0, 2300.0]),
    ] {
        let mut s = draws(420 + name.len() as u64);
        let mut own = Agreement::default();
        let q = random_quat(&mut s);
        let xml = format!(
            "<mujoco><worldbody><geom {shape} pos='1 2 3' quat='{} {} {} {}'/></worldbody></mujoco>",
            q[0], q[1], q[2], q[3]
        );
        let scene = build(&xml, &[]);
        let mut worker = scene.worker().unwrap();
        for round in 0..1000 {
            if round % 2 == 0 {
                at_a_geom(&mut worker, half, [1.0, 5000.0], &mut s, &mut own);
                continue;
            }
            // A drone's height above the surface (or under it): all around.
            let away = random_unit(&mut s);
            let top = away.map(|x| 1e4 * x);
            let hit = worker.ray(top, away.map(|x| -x), Some(&rays::GROUPS), None).unwrap().unwrap();
            let height = s.uniform(-1.0, 5.0);
            let from = [0, 1, 2].map(|k| top[k] - hit.distance * away[k] + height * hit.normal[k]);
            let directions: Vec<[f64; 3]> = (0..64).map(|_| random_unit(&mut s)).collect();
            own.compare(&mut worker, &Pose::new(from, [0.0, 0.0, 0.0, 1.0]), &directions);
        }
        println!("{name}: {}", own.told());
        assert!(own.flips * 20_000 <= own.rays && own.labels == 0, "{name}: {} {}", own.flips, own.labels);
        assert!(own.error(0.5) < 1e-6 && own.error(0.99) < 1e-4, "{name}: {}", own.told());
        all.add(own);
    }
    notes::tell(&format!("native caster, solids of kilometres vs mj_ray: {}", all.told()));
    assert!(all.hits > 150_000);
}

/// A tube of facets that are thousands of times longer than wide, closed by fans of slivers, as scanned meshes have them.
fn tube(facets: usize, radius: f64, half: f64, s: &mut Stream) -> String {
    let (mut vertices, mut faces) = (String::new(), String::new());
    for k in 0..facets {
        let (sin, cos) = (TAU * k as f64 / facets as f64).sin_cos();
        for z in [-half, half] {
            let r = radius + s.uniform(-1e-5, 1e-5);
            let _ = write!(vertices, "{} {} {} ", r * cos, r * sin, z);
        }
    }
    let _ = write!(vertices, "0 0 {} 0 0 {}", -half, half);
    for k in 0..facets {
        let (a, b) = (2 * k, 2 * ((k + 1) % facets));
        let _ = write!(faces, "{a} {b} {} {b} {} {} ", a + 1, b + 1, a + 1);
        let _ = write!(faces, "{b} {a} {} {} {} {} ", 2 * facets, a + 1, b + 1, 2 * facets + 1);
    }
    format!("<mesh name='t' vertex='{vertices}' face='{faces}'/>")
}

#[test]
fn meshes_of_slivers_agree_with_mj_ray_and_are_tight() {
    let mut all = Agreement::default();
    let mut slips = 0;
    for (facets, radius, half) in [(300, 0.5, 2.0), (2000, 0.5, 3.0), (700, 0.004, 1.5)] {
        let mut s = draws(440 + facets as u64);
        let mesh = tube(facets, radius, half, &mut s);
        let q = random_quat(&mut s);
        let xml = format!(
            "<mujoco><asset>{mesh}</asset><worldbody><geom type='mesh' mesh='t' pos='1 2 3' quat='{} {} {} {}'/>\
             </worldbody></mujoco>",
            q[0], q[1], q[2], q[3]
        );
        let scene = build(&xml, &[]);
        let mut worker = scene.worker().unwrap();
        let mut own = Agreement::default();
        // The compiler of MuJoCo turns a mesh so that its largest moment of inertia comes first: the tube's axis is z.
        for _ in 0..400 {
            at_a_geom(&mut worker, [radius, radius, half], [0.3, 12.0], &mut s, &mut own);
        }
        // From its middle every ray meets the mesh.
        let (middle, _) = worker.geom_pose(0).unwrap();
        let directions: Vec<[f64; 3]> = (0..20_000).map(|_| random_unit(&mut s)).collect();
        let pattern = RayPattern::new(&directions).unwrap();
        let mut geom = vec![0; pattern.len()];
        let planes = RayPlanes { geom_id: Some(&mut geom), ..RayPlanes::default() };
        Queries::at(&mut worker)
            .pattern(&Pose::new(middle, random_quat(&mut s)), &pattern, &RayQuery::default(), planes)
            .unwrap();
        slips += geom.iter().filter(|g| **g != 0).count();
        println!("{facets} facets: {}", own.told());
        assert!(own.hits * 4 > own.rays, "{facets} facets: {}", own.told());
        all.add(own);
    }
    notes::tell(&format!("native caster, meshes of slivers vs mj_ray: {}", all.told()));
    assert_eq!(slips, 0, "rays that leave a closed mesh");
    assert!(all.flips * 10_000 < all.rays, "{}", all.flips);
    assert!(all.error(0.5) < 1e-6 && all.error(0.999) < 1e-4, "{}", all.told());
}

/// An equidistant fisheye lens of `wide` degrees along −z, 64 × 64 rays, tile by tile.
fn fisheye(wide: f64) -> Vec<[f64; 3]> {
    let mut rays = Vec::new();
    for tile in 0..64 {
        for lane in 0..64 {
            let (row, col) = (8 * (tile / 8) + lane / 8, 8 * (tile % 8) + lane % 8);
            let (x, y) = ((f64::from(col) - 31.5) / 32.0, (31.5 - f64::from(row)) / 32.0);
            let (turn, angle) = (y.atan2(x), x.hypot(y) * (0.5 * wide).to_radians());
            rays.push([angle.sin() * turn.cos(), angle.sin() * turn.sin(), -angle.cos()]);
        }
    }
    rays
}

#[test]
fn lenses_wider_than_half_the_sphere_see_what_is_behind_them() {
    let mut s = draws(460);
    let scene = build(&mixed(40, &mut s), &[]);
    let mut worker = scene.worker().unwrap();
    let mut all = Agreement::default();
    for wide in [100.0, 179.0, 181.0, 220.0, 280.0, 360.0] {
        let directions = fisheye(wide);
        let mut own = Agreement::default();
        for _ in 0..12 {
            let pose = Pose::new(rays::origin(&scene, &worker, &mut s), random_quat(&mut s));
            own.compare(&mut worker, &pose, &directions);
        }
        println!("{wide} degrees: {}", own.told());
        all.add(own);
    }
    notes::tell(&format!("native caster, fisheye lenses up to 360 degrees vs mj_ray: {}", all.told()));
    assert!(all.hits > 200_000, "{}", all.hits);
    assert!(all.flips <= 2 && all.labels <= 2 && all.error(0.99) < 1e-5, "{}", all.told());
    assert!(all.error(1.0) < 1e-3, "{}", all.told());
    // One ball behind the sensor: only the wide lens sees it.
    let scene = build("<mujoco><worldbody><geom size='.2' pos='0 .7 1'/></worldbody></mujoco>", &[]);
    let mut worker = scene.worker().unwrap();
    let mut sees = |wide: f64| {
        let pattern = RayPattern::new(&fisheye(wide)).unwrap();
        let mut geom = vec![0; pattern.len()];
        let planes = RayPlanes { geom_id: Some(&mut geom), ..RayPlanes::default() };
        Queries::at(&mut worker).pattern(&Pose::default(), &pattern, &RayQuery::default(), planes).unwrap();
        geom.contains(&0)
    };
    assert!(!sees(180.0) && sees(320.0));
}

/// A distance of zero has no sign: programs that read bits, or take 1 / range, tell −0 from 0.
#[test]
fn a_sensor_on_a_surface_stores_no_negative_zero() {
    let xml = "<mujoco><worldbody><geom type='box' size='1 1 1'/><geom type='cylinder' size='1 1' pos='10 0 0'/>\
               <geom type='capsule' size='1 1' pos='20 0 0'/><geom type='sphere' size='1' pos='30 0 0'/>\
               <geom type='ellipsoid' size='1 1 1' pos='40 0 0'/><geom type='plane' size='1 1 1' pos='50 0 1'/></worldbody></mujoco>";
    let scene = build(xml, &[]);
    let mut worker = scene.worker().unwrap();
    let mut directions = Vec::new();
    for k in 0..27 {
        if k != 13 {
            directions.push([k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1].map(f64::from));
        }
    }
    let pattern = RayPattern::new(&directions).unwrap();
    let h = 0.5f64.sqrt();
    // A face, and the rotation of a camera that looks at it.
    let faces = [
        ([1.0, 0.0, 0.0], [0.0, h, 0.0, h]),
        ([-1.0, 0.0, 0.0], [0.0, -h, 0.0, h]),
        ([0.0, 1.0, 0.0], [-h, 0.0, 0.0, h]),
        ([0.0, -1.0, 0.0], [h, 0.0, 0.0, h]),
        ([0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]),
        ([0.0, 0.0, -1.0], [1.0, 0.0, 0.0, 0.0]),
    ];
    let mut zeros = [0; 4];
    for centre in [0.0, 10.0, 20.0, 30.0, 40.0, 50.0] {
        for (face, turn) in faces {
            let pos = [centre + face[0], face[1], face[2]];
            let mut range = vec![0.0; pattern.len()];
            let planes = RayPlanes { range_m: Some(&mut range), ..RayPlanes::default() };
            let pose = Pose::new(pos, [0.0, 0.0, 0.0, 1.0]);
            Queries::at(&mut worker).pattern(&pose, &pattern, &RayQuery::default(), planes).unwrap();
            assert!(range.iter().all(|r| r.is_sign_positive()), "{pos:?}: {range:?}");
            zeros[0] += range.iter().filter(|r| **r == 0.0).count();
            let mut hits = RayHits::default();
            let from = vec![pos; directions.len()];
            Queries::at(&mut worker).rays(&from, &directions, &RayQuery::default(), &mut hits).unwrap();
            assert!(hits.range_m.iter().all(|r| r.is_sign_positive()), "{pos:?}: {:?}", hits.range_m);
            zeros[1] += hits.range_m.iter().filter(|r| **r == 0.0).count();
            // A camera that looks straight at the face.
            for kind in [DepthKind::Range, DepthKind::ZDepth] {
                let camera = Camera::in_world(&scene, Pose::new(pos, turn), Lens::Fovy { fovy_deg: 60.0 })
                    .unwrap()
                    .with_size(9, 9)
                    .unwrap()
                    .with_kind(kind);
                for (k, caster) in [Caster::Native, Caster::MuJoCo].into_iter().enumerate() {
                    let mut frame = DepthFrame::new();
                    camera.clone().with_caster(caster).render(&mut worker, &mut frame).unwrap();
                    assert!(
                        frame.depth_m.iter().all(|d| d.is_sign_positive()),
                        "{pos:?} {caster:?} {:?}",
                        frame.depth_m
                    );
                    zeros[2 + k] += frame.depth_m.iter().filter(|d| **d == 0.0).count();
                }
            }
        }
    }
    println!("{zeros:?}");
    assert!(zeros.iter().all(|n| *n > 100), "{zeros:?}");
}
