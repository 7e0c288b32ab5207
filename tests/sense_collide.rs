//! The native collider against MuJoCo's collision detection, on random cases.

#[path = "common/scenes.rs"]
mod scenes;

use propwash::random::{Key, Stream, purpose};
use propwash::scene::{GeomType, Pose, Scene, Shell, Worker, WorkerPool};
use propwash::sense::{Clearance, Collider, Contact, Queries, Sweep, WorldPoses, Worlds};
use scenes::{build, random_quat};

/// Contacts of the one that the other does not find have a signed distance of less than this, m, beyond the margin. The
/// scenes' `ccd_tolerance` is 1e-6 m.
const FLIP_M: f64 = 1e-5;

fn draws(step: u64) -> Stream {
    Key { seed: 31, world: 0, drone: 0, step, purpose: purpose("test of the collider") }.stream()
}

fn norm(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

fn shell(body: &str, assets: &str) -> Shell {
    Shell {
        name: "test".into(),
        xml: format!("<mujoco>{assets}<worldbody><body name='drone'>{body}</body></worldbody></mujoco>"),
        dir: None,
    }
}

fn geom(kind: GeomType, s: &mut Stream, least: f64, most: f64) -> String {
    let mut r = || s.uniform(least, most);
    match kind {
        GeomType::Plane => "type='plane' size='0 0 1'".to_string(),
        GeomType::Hfield => "type='hfield' hfield='h'".into(),
        GeomType::Sphere => format!("type='sphere' size='{}'", r()),
        GeomType::Capsule => format!("type='capsule' size='{} {}'", r(), r()),
        GeomType::Ellipsoid => format!("type='ellipsoid' size='{} {} {}'", r(), r(), r()),
        GeomType::Cylinder => format!("type='cylinder' size='{} {}'", r(), r()),
        GeomType::Box => format!("type='box' size='{} {} {}'", r(), r(), r()),
        GeomType::Mesh => "type='mesh' mesh='m'".into(),
        GeomType::Sdf => "type='sdf' mesh='s'".into(),
    }
}

/// A cloud of points, whose hull is far from the mesh's own triangles; a torus for the field; hills.
fn assets(s: &mut Stream, reach: f64) -> String {
    let heights: Vec<String> = (0..42).map(|_| format!("{:.4}", s.unit())).collect();
    let points: Vec<String> = (0..90).map(|_| format!("{:.4}", s.uniform(-reach, reach))).collect();
    format!(
        "<asset><hfield name='h' nrow='6' ncol='7' size='1 1.2 0.7 0.2' elevation='{}'/><mesh name='m' vertex='{}'/>\
         <mesh name='s' builtin='supertorus' params='12 0.4 1 1' scale='0.7 0.7 0.7'/></asset>",
        heights.join(" "),
        points.join(" ")
    )
}

fn at(p: [f64; 3], q: [f64; 4]) -> String {
    format!("pos='{} {} {}' quat='{} {} {} {}'", p[0], p[1], p[2], q[0], q[1], q[2], q[3])
}

const SHELLS: [GeomType; 6] = [
    GeomType::Sphere,
    GeomType::Box,
    GeomType::Cylinder,
    GeomType::Capsule,
    GeomType::Ellipsoid,
    GeomType::Mesh,
];

fn place(worker: &mut Worker, drone: usize, pos: [f64; 3], s: &mut Stream) {
    worker.set_drone(drone, pos, random_quat(s)).unwrap();
}

fn both(worker: &mut Worker) -> [Vec<Contact>; 2] {
    [Collider::Native, Collider::MuJoCo].map(|by| {
        let mut out = Vec::new();
        Queries::by(by, worker).contacts(&mut out).unwrap();
        // Stable: the contacts of one pair keep their order.
        out.sort_by_key(|c| (c.drone, c.drone_geom, c.other_geom));
        out
    })
}

/// The contacts of pairs that both found are the same; what only one found hardly touches. Returns how many were only
/// one's.
fn same_contacts(
    scene: &Scene,
    [ours, theirs]: &[Vec<Contact>; 2],
    what: &str,
    worst: &mut [f64; 3],
) -> usize {
    let pair = |c: &Contact| (c.drone, c.drone_geom, c.other_geom);
    let mut flips = 0;
    let all: std::collections::BTreeSet<_> = ours.iter().chain(theirs).map(pair).collect();
    for name in all {
        let of = |list: &[Contact]| list.iter().filter(|c| pair(c) == name).copied().collect::<Vec<_>>();
        let (a, b) = (of(ours), of(theirs));
        if a.is_empty() || b.is_empty() {
            let margin: f64 = [name.1, name.2]
                .iter()
                .map(|g| &scene.geoms()[*g as usize])
                .map(|g| g.margin_m + g.gap_m)
                .sum();
            for c in a.iter().chain(&b) {
                assert!((c.distance_m - margin).abs() < FLIP_M, "{what}: only one found {c:?}");
            }
            flips += 1;
            continue;
        }
        assert_eq!(a.len(), b.len(), "{what}: {a:?} {b:?}");
        let kinds = [name.1, name.2].map(|g| scene.geoms()[g as usize].kind);
        // Closed forms against closed forms, or against MuJoCo's search.
        let searched = kinds.contains(&GeomType::Ellipsoid) || kinds.contains(&GeomType::Mesh);
        // Its search blows up a polytope inside, and ends a little short of the depth of round shapes.
        for (x, y) in a.iter().zip(&b) {
            assert_eq!(
                (x.other_drone, x.drone_body, x.other_body, x.other_flex),
                (y.other_drone, y.drone_body, y.other_body, y.other_flex)
            );
            if !kinds.contains(&GeomType::Sphere)
                || kinds.contains(&GeomType::Hfield)
                || kinds.contains(&GeomType::Sdf)
            {
                // Both have MuJoCo's contact points; it normalizes normals once more.
                assert_eq!((x.distance_m, x.point_m), (y.distance_m, y.point_m), "{what}");
                assert!(norm(x.normal, y.normal) < 1e-14, "{what} {x:?} {y:?}");
                continue;
            }
            let e =
                [(x.distance_m - y.distance_m).abs(), norm(x.point_m, y.point_m), norm(x.normal, y.normal)];
            let short = if y.distance_m < -0.01 { 2e-2 } else { 2e-5 };
            assert!(!searched || x.distance_m < y.distance_m + 2e-5, "{what}: {x:?} {y:?}");
            let limit = if searched { [short, 1.0, 2.0] } else { [1e-9, 1e-9, 1e-8] };
            // Deep inside, another side may be as near.
            let other_side = e[2] > 0.05 && e[0] < limit[0];
            assert!(
                e[0] < limit[0] && (other_side || (e[1] < limit[1] && e[2] < limit[2])),
                "{what} {e:?} {x:?} {y:?}"
            );
            for k in 0..if other_side { 1 } else { 3 } {
                worst[k] = worst[k].max(e[k]);
            }
        }
    }
    flips
}

fn nearest(worker: &mut Worker, drone: usize, max: f64) -> [Clearance; 2] {
    [Collider::Native, Collider::MuJoCo].map(|by| Queries::by(by, worker).clearance(drone, max).unwrap())
}

/// Distances and points of both.
fn same_clearance(scene: &Scene, [a, b]: &[Clearance; 2], what: &str) -> f64 {
    // MuJoCo's search ends short of the depth of round shapes (a ball deep in an ellipsoid: the test below; a box that holds
    // part of the axis of a capsule: less than the capsule's radius, by up to 6 cm), so that ours may be deeper; and the
    // reference takes the depth in a field only where nothing else is nearer than its surface.
    let kind = |g: i32| usize::try_from(g).ok().map(|g| scene.geoms()[g].kind);
    let field = matches!(kind(a.other_geom), Some(GeomType::Hfield | GeomType::Sdf));
    assert!(a.distance_m < b.distance_m + 5e-4, "{what}: {a:?} {b:?}");
    if field && b.distance_m < 0.0 {
        return 0.0;
    }
    // Where both are round, either search may end early, by some 1e-5 of the distance.
    let round = |g: i32| matches!(kind(g), Some(GeomType::Ellipsoid | GeomType::Cylinder));
    let both_round = round(a.drone_geom) && round(a.other_geom);
    let limit = if b.distance_m < -0.01 {
        0.1
    } else if both_round {
        5e-4
    } else {
        2e-5
    };
    let e = (a.distance_m - b.distance_m).abs();
    assert!(e < limit, "{what}: {e} {a:?} {b:?}");
    assert!(a.found == b.found || (a.distance_m - b.distance_m).abs() < limit, "{what}: {a:?} {b:?}");
    if a.found && a.exact {
        // The points are as far apart as the distance says.
        assert!((norm(a.on_drone_m, a.on_other_m) - a.distance_m.abs()).abs() < 2e-5, "{what}: {a:?}");
    }
    e
}

#[test]
fn every_pair_of_types_touches_as_in_mujoco() {
    println!(
        "drone      other      cases touch flips | contact m: worst | clearance m: median  99%     worst"
    );
    let (mut cases, mut touches, mut flips) = (0, 0, 0);
    for own in SHELLS {
        for other in GeomType::ALL {
            let mut s = draws(10 * own as u64 + other as u64);
            let mut worst = [0.0; 3];
            let (mut n, mut met, mut odd) = (0, 0, 0);
            let (mut errors, mut apart) = (Vec::new(), Vec::new());
            for _ in 0..10 {
                let small = assets(&mut s, 0.25);
                let drone = shell(&format!("<geom {}/>", geom(own, &mut s, 0.03, 0.3)), &small);
                let p = [0; 3].map(|_| s.uniform(-3.0, 3.0));
                let xml = format!(
                    "<mujoco>{}<worldbody><geom {} {}/></worldbody></mujoco>",
                    assets(&mut s, 0.8),
                    at(p, random_quat(&mut s)),
                    geom(other, &mut s, 0.1, 0.8)
                );
                let scene = build(&xml, &[drone]);
                let mut worker = scene.worker().unwrap();
                // MuJoCo takes a millisecond for a signed distance field.
                for _ in 0..if other == GeomType::Sdf { 30 } else { 210 } {
                    let d = [0; 3].map(|_| s.uniform(-1.0, 1.0));
                    place(&mut worker, 0, [0, 1, 2].map(|k| p[k] + d[k]), &mut s);
                    worker.update().unwrap();
                    let what = format!("{own} {other}");
                    let found = both(&mut worker);
                    odd += same_contacts(&scene, &found, &what, &mut worst);
                    let near = nearest(&mut worker, 0, 10.0);
                    let error = same_clearance(&scene, &near, &what);
                    errors.push(error);
                    if near[1].distance_m > 0.0 {
                        apart.push(error);
                    }
                    met += usize::from(!found[0].is_empty());
                    n += 1;
                }
            }
            apart.sort_by(f64::total_cmp);
            let most = apart[(apart.len() - 1) * 99 / 100];
            assert!(most < 1e-5, "{own} {other}: {most}");
            errors.sort_by(f64::total_cmp);
            let q = |p: f64| errors[((errors.len() - 1) as f64 * p) as usize];
            println!(
                "{:10} {:10} {n:5} {met:5} {odd:5} | {:.1e} | {:.1e} {:.1e} {:.1e}",
                own.name(),
                other.name(),
                worst[0],
                q(0.5),
                q(0.99),
                q(1.0)
            );
            cases += n;
            touches += met;
            flips += odd;
            assert!(met > n / 50, "{own} {other}: {met} of {n} touch");
        }
    }
    println!("{cases} cases, {touches} touch, {flips} flips");
    assert!(cases >= 100_000 && flips * 2000 < cases, "{cases} {flips}");
}

/// A scene of all types, some of them moving, some with margins.
fn crowd(s: &mut Stream, n: usize, reach: f64) -> String {
    let assets = assets(s, 0.8);
    let mut geoms =
        String::from("<geom type='plane' size='3 3 1' pos='0 0 -1'/><geom type='hfield' hfield='h'/>");
    for i in 0..n {
        let kind = GeomType::ALL[2 + i % 7];
        let shape = geom(kind, s, 0.05, 0.5);
        let p = [0; 3].map(|_| s.uniform(-reach, reach));
        let place = at(p, random_quat(s));
        let more = match i % 11 {
            3 => "margin='0.05'",
            5 => "margin='0.02' gap='0.03'",
            7 => "contype='0' conaffinity='0'",
            8 => "contype='0' conaffinity='4'",
            _ => "",
        };
        geoms += &match i % 5 {
            0 if kind != GeomType::Sdf => format!("<body {place} mocap='true'><geom {shape} {more}/></body>"),
            1 => format!("<body {place}><freejoint/><geom {shape} {more} mass='1'/></body>"),
            _ => format!("<geom {place} {shape} {more}/>"),
        };
    }
    format!("<mujoco>{assets}<worldbody>{geoms}</worldbody></mujoco>")
}

#[test]
fn crowded_scenes_and_real_shells_touch_as_in_mujoco() {
    let mut s = draws(1000);
    let (mut touches, mut flips, mut cases, mut by_drone) = (0, 0, 0, 0);
    let mut worst = [0.0; 3];
    for n in [3, 40, 200] {
        let reach = 0.9 * (n as f64).cbrt();
        let shells = [
            Shell::builtin("cf2x").unwrap(),
            shell("<geom type='sphere' size='0.1' margin='0.01'/>", ""),
            Shell::builtin("hb_x500").unwrap(),
            shell(
                "<geom type='box' size='0.2 0.1 0.05'/><geom type='sphere' size='0.08' pos='0.2 0 0'/>",
                "",
            ),
        ];
        let xml = crowd(&mut s, n, reach);
        let scene = build(&xml, &shells);
        let mut worker = scene.worker().unwrap();
        for _ in 0..150 {
            let middle = [0; 3].map(|_| s.uniform(-reach, reach));
            for drone in 0..shells.len() {
                place(&mut worker, drone, [0, 1, 2].map(|k| middle[k] + s.uniform(-0.4, 0.4)), &mut s);
            }
            for index in 0..scene.obstacles().len() {
                let pos = [0; 3].map(|_| s.uniform(-reach, reach));
                worker.set_obstacle(index, pos, random_quat(&mut s)).unwrap();
            }
            worker.update().unwrap();
            let found = both(&mut worker);
            flips += same_contacts(&scene, &found, "crowd", &mut worst);
            touches += found[1].len();
            for drone in 0..shells.len() {
                let near = nearest(&mut worker, drone, 0.7);
                same_clearance(&scene, &near, "crowd");
                by_drone += usize::from(near[0].other_drone.is_some());
                cases += 1;
            }
        }
    }
    println!(
        "{cases} drones, {touches} contacts, {flips} flips, worst {worst:?}, {by_drone} nearest to another drone"
    );
    assert!(touches > 1000 && by_drone > 100 && flips < 5, "{touches} {by_drone} {flips}");
}

#[test]
fn a_swarm_touches_as_in_mujoco() {
    let mut s = draws(2000);
    let n = 300;
    let mut shells = vec![shell("<geom type='sphere' size='0.07'/>", ""); n];
    for k in (0..n).step_by(10) {
        shells[k] = Shell::builtin("cf2x").unwrap();
    }
    let scene = build("<mujoco><worldbody><geom type='plane' size='0 0 1'/></worldbody></mujoco>", &shells);
    let mut worker = scene.worker().unwrap();
    let mut worst = [0.0; 3];
    for reach in [0.5, 1.0, 2.0] {
        for drone in 0..n {
            let far = if drone == 17 { 1e6 } else { 0.0 };
            let pos = [s.uniform(-reach, reach) + far, s.uniform(-reach, reach), s.uniform(0.0, reach)];
            place(&mut worker, drone, pos, &mut s);
        }
        worker.update().unwrap();
        let found = both(&mut worker);
        assert!(found[0].len() > 10, "{}", found[0].len());
        assert_eq!(same_contacts(&scene, &found, "swarm", &mut worst), 0);
        for drone in (0..n).step_by(7).chain([17]) {
            same_clearance(&scene, &nearest(&mut worker, drone, 5.0), "swarm");
        }
        println!("{} contacts within {reach} m, worst {worst:?}", found[0].len());
    }
}

/// How deep a ball is in an ellipsoid, against all points of a fine mesh of its surface.
#[test]
fn a_ball_deep_in_an_ellipsoid_is_as_deep_as_its_surface_is_far() {
    let mut s = draws(5000);
    let (mut ours, mut theirs) = (0.0f64, 0.0f64);
    for _ in 0..20 {
        let size = [0; 3].map(|_| s.uniform(0.1, 0.8));
        let radius = s.uniform(0.03, 0.3);
        let xml = format!(
            "<mujoco><worldbody><geom type='ellipsoid' size='{} {} {}'/></worldbody></mujoco>",
            size[0], size[1], size[2]
        );
        let scene = build(&xml, &[shell(&format!("<geom type='sphere' size='{radius}'/>"), "")]);
        let mut worker = scene.worker().unwrap();
        let p = size.map(|x| x * s.uniform(-0.55, 0.55));
        place(&mut worker, 0, p, &mut s);
        worker.update().unwrap();
        let mut least = f64::INFINITY;
        let n = 500;
        for i in 0..=n {
            for j in 0..2 * n {
                let a = std::f64::consts::PI * f64::from(i) / f64::from(n);
                let b = std::f64::consts::PI * f64::from(j) / f64::from(n);
                let q = [size[0] * a.sin() * b.cos(), size[1] * a.sin() * b.sin(), size[2] * a.cos()];
                least = least.min(norm(p, q));
            }
        }
        let [a, b] = nearest(&mut worker, 0, 1.0).map(|c| c.distance_m + least + radius);
        // Points of the mesh are up to 0.004 m apart: the nearest is at most 1e-4 m farther than the true one here.
        assert!(a > -1e-9 && a < 1e-4, "{a} {size:?} {p:?}");
        (ours, theirs) = (ours.max(a), theirs.max(b));
    }
    println!("depths differ from the mesh's by {ours:.1e} (native) and {theirs:.1e} m (MuJoCo)");
    assert!(theirs > 10.0 * ours, "{ours} {theirs}");
}

/// A drone at 30 m/s does not pass through a foil, by either collider, and both find the same first touch.
#[test]
fn both_colliders_sweep_to_the_same_touch() {
    let mut s = draws(3000);
    let (mut hits, mut misses) = (0, 0);
    for _ in 0..12 {
        let scene = build(
            &crowd(&mut s, 40, 3.0),
            &[Shell::builtin("cf2x").unwrap(), Shell::builtin("cf2x").unwrap()],
        );
        let mut worker = scene.worker().unwrap();
        for _ in 0..40 {
            let from = Pose::new([0; 3].map(|_| s.uniform(-3.0, 3.0)), random_quat(&mut s));
            let to = Pose::new([0, 1, 2].map(|k| from.pos_m[k] + s.uniform(-0.6, 0.6)), random_quat(&mut s));
            worker
                .set_drone(1, [0, 1, 2].map(|k| to.pos_m[k] + s.uniform(-0.3, 0.3)), random_quat(&mut s))
                .unwrap();
            worker.update().unwrap();
            let [ours, theirs] = [Collider::Native, Collider::MuJoCo]
                .map(|by| Queries::by(by, &mut worker).swept(&Sweep::new(0, from, to)).unwrap());
            match (ours, theirs) {
                (Some(a), Some(b)) => {
                    hits += 1;
                    assert!((a.fraction - b.fraction).abs() < 1e-4, "{a:?} {b:?}");
                    assert!((a.distance_m - b.distance_m).abs() < 2e-4, "{a:?} {b:?}");
                }
                (None, None) => misses += 1,
                (a, b) => panic!("{a:?} {b:?}"),
            }
        }
    }
    println!("{hits} hits, {misses} misses");
    assert!(hits > 100 && misses > 30, "{hits} {misses}");
}

/// Same bits for any number of threads and any batch; a world that fails is named and harms no other.
#[test]
fn many_worlds_do_not_depend_on_threads() {
    let mut s = draws(4000);
    let shells = [Shell::builtin("cf2x").unwrap(), shell("<geom type='sphere' size='0.1'/>", "")];
    let scene = build(&crowd(&mut s, 40, 1.5), &shells);
    let worlds = 40;
    let pos: Vec<f64> = (0..worlds * 2 * 3).map(|_| s.uniform(-1.5, 1.5)).collect();
    let quat: Vec<f64> = (0..worlds * 2).flat_map(|_| random_quat(&mut s)).collect();
    let run = |threads: usize, pos: &[f64]| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let poses = WorldPoses {
            n_worlds: worlds,
            drone_pos_m: pos,
            drone_quat_xyzw: &quat,
            obstacle_pos_m: None,
            obstacle_quat_xyzw: None,
        };
        let workers = WorkerPool::new(&scene);
        let (mut touching, mut limited, mut near) = (Vec::new(), Vec::new(), Vec::new());
        let errors = pool.install(|| {
            [
                poses.within(&workers).contacts(&mut touching, &mut limited).err(),
                poses.within(&workers).clearances(2.0, &mut near).err(),
            ]
        });
        (touching, limited, near, errors.map(|e| e.map(|e| e.to_string())))
    };
    let one = run(1, &pos);
    assert_eq!(one.3, [None, None]);
    assert!(one.0.iter().flatten().count() > 50 && one.2.len() == 2 * worlds);
    for threads in [2, 7] {
        assert_eq!(run(threads, &pos), one);
    }
    let mut bad = pos.clone();
    bad[3 * 2 * 5 + 1] = f64::NAN;
    let (touching, _, near, errors) = run(3, &bad);
    assert!(errors.iter().all(|e| e.as_ref().is_some_and(|e| e.contains("world 5"))), "{errors:?}");
    assert!(touching[5].is_empty() && near[10].distance_m.is_nan() && near[11].distance_m.is_nan());
    for world in (0..worlds).filter(|w| *w != 5) {
        assert_eq!(
            (&touching[world], &near[2 * world..2 * world + 2]),
            (&one.0[world], &one.2[2 * world..2 * world + 2])
        );
    }
}

/// Scenes whose contacts follow more than bits are MuJoCo's.
#[test]
fn excluded_and_named_pairs_are_mujocos() {
    let xml = "<mujoco><worldbody><body name='a'><geom name='g' type='box' size='1 1 1'/></body>
        <body name='b' pos='0 0 3'><geom name='k' type='box' size='1 1 1'/></body></worldbody>
        <contact><exclude body1='a' body2='b'/></contact></mujoco>";
    let scene = build(xml, &[shell("<geom type='sphere' size='0.5'/>", "")]);
    let mut worker = scene.worker().unwrap();
    worker.set_drone(0, [0.0, 0.0, 1.4], [0.0, 0.0, 0.0, 1.0]).unwrap();
    worker.update().unwrap();
    let [ours, theirs] = both(&mut worker);
    assert_eq!((ours.len(), &ours), (1, &theirs));
}
