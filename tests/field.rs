//! Distance fields of scenes against the exact clearances of a small ball at the same points.

#[path = "common/scenes.rs"]
mod scenes;

use propwash::arena::{Arena, SimConfig};
use propwash::geometry::{DistanceField, FieldGrid};
use propwash::physics::controllers::ControlMode;
use propwash::random::{Key, Stream, purpose};
use propwash::rollout::{Engine, SimOptions};
use propwash::scalar::lanes::Number;
use propwash::scene::{FIELD_MOST_BYTES, Scene, SceneError, SceneSource, Shell};
use propwash::sense::Queries;
use scenes::build;

const LEVEL: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
const RADIUS_M: f64 = 1e-3;

fn ball() -> Shell {
    let xml = format!(
        "<mujoco><worldbody><body name='drone'><geom name='ball' type='sphere' size='{RADIUS_M}'/></body></worldbody></mujoco>"
    );
    Shell { name: "test".into(), xml, dir: None }
}

fn draws(step: u64) -> Stream {
    Key { seed: 5, world: 0, drone: 0, step, purpose: purpose("test of fields") }.stream()
}

/// Obstacles, which are not in fields, are moved out of the way: then clearances are what the field should be.
fn compare(name: &str, scene: &Scene, field: &DistanceField) {
    let mut worker = scene.worker().unwrap();
    for obstacle in 0..scene.obstacles().len() {
        worker.set_obstacle(obstacle, [0.0, 0.0, 1000.0 + 10.0 * obstacle as f64], LEVEL).unwrap();
    }
    let mut s = draws(scene.geoms().len() as u64);
    let (low, high) = (field.grid().origin_m, field.grid().end_m());
    let bound = 0.5 * 3f64.sqrt() * field.grid().resolution_m + 2e-5;
    let (mut worst, mut at_points, mut inside, mut n) = (0.0f64, 0.0f64, 0, 0);
    for k in 0..3000 {
        let on_grid = k % 3 == 0;
        let p = match on_grid {
            true => field.grid().point(field.grid().counts.map(|n| s.below(n as u64) as usize)),
            false => [0, 1, 2].map(|k| s.uniform(low[k], high[k])),
        };
        worker.set_drone(0, p, LEVEL).unwrap();
        worker.update().unwrap();
        let c = Queries::at(&mut worker).clearance(0, 100.0).unwrap();
        let exact = c.distance_m + RADIUS_M;
        let got = field.at(p).0;
        if exact < 0.0 && field.zero_inside().contains(&(c.other_geom as u32)) {
            // How deep is not known: zero, and no more than that beside it.
            assert!(got <= bound && got >= -bound, "{name} {p:?}: {got} {exact}");
            continue;
        }
        inside += usize::from(exact < 0.0);
        let off = (got - exact).abs();
        assert!(
            off <= bound,
            "{name} {p:?}: {got}, exactly {exact}, of {}",
            scene.geoms()[c.other_geom as usize].name
        );
        if on_grid {
            at_points = at_points.max(off);
        }
        (worst, n) = (worst.max(off), n + 1);
    }
    println!(
        "{name}: {n} points, {inside} of them inside; at points of the grid {at_points:.1e} m off, anywhere {worst:.4} m of {bound:.4}"
    );
    assert!(at_points < 5e-5 && n > 1000, "{name}: {at_points} {n}");
}

#[test]
fn fields_agree_with_exact_clearances_in_scenes_of_all_kinds() {
    for name in ["forest", "room", "corridor", "terrain", "meshes", "zoo"] {
        let scene = Scene::build(&SceneSource::file(format!("xml/{name}.xml")), &[ball()]).unwrap();
        let field = scene.distance_field(0.2, None, FIELD_MOST_BYTES).unwrap();
        compare(name, &scene, &field);
    }
    // Rotated boxes, capsules, ellipsoids, a mesh with a concave hull, a height field, a slope, overlapping.
    let xml = "<mujoco><asset>\
        <mesh name='m' vertex='0 0 0  1 0 0  0 1 0  0 0 1  0.2 0.2 0.9' scale='0.8 0.8 0.8'/>\
        <hfield name='h' nrow='4' ncol='5' size='1.5 1 0.6 0.2' elevation='0 .2 .4 .1 0  .3 1 .2 .6 .1  0 .4 .9 .2 .3  .1 .2 0 .5 0'/></asset><worldbody>\
        <geom type='plane' size='0 0 1' pos='0 0 -1' euler='8 -5 0'/>\
        <geom type='box' size='.3 .6 .1' pos='1 0 1' euler='30 20 50'/><geom type='box' size='.2 .2 .5' pos='1.2 0.2 1' euler='0 70 10'/>\
        <geom type='capsule' size='.12 .7' pos='-1 1 .6' euler='40 0 80'/><geom type='cylinder' size='.3 .2' pos='-1 -1 1.2' euler='60 10 0'/>\
        <geom type='ellipsoid' size='.5 .2 .3' pos='0 1.4 1.5' euler='0 30 20'/><geom type='sphere' size='.4' pos='0 0 2'/>\
        <geom type='mesh' mesh='m' pos='-2 0 .5' euler='20 20 20'/><geom type='hfield' hfield='h' pos='2.5 -1 -.4' euler='0 10 30'/>\
        </worldbody></mujoco>";
    let scene = build(xml, &[ball()]);
    let fine = scene.distance_field(0.1, None, FIELD_MOST_BYTES).unwrap();
    compare("all types", &scene, &fine);
    assert_eq!(fine.zero_inside().len(), 1, "the height field alone");
    // The same whatever the number of threads.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let alone = pool.install(|| scene.distance_field(0.1, None, FIELD_MOST_BYTES)).unwrap();
    assert!(alone == fine);
}

#[test]
fn outside_of_its_grid_a_field_bounds_the_distance_from_below_and_knows_planes() {
    let xml = "<mujoco><worldbody><geom type='plane' size='0 0 1'/><geom type='cylinder' size='.2 1' pos='0 0 1'/>\
        <geom type='box' size='.3 .1 .4' pos='1 1 1'/></worldbody></mujoco>";
    let scene = build(xml, &[ball()]);
    let field = scene.distance_field(0.05, None, FIELD_MOST_BYTES).unwrap();
    assert_eq!(field.planes().len(), 1);
    let mut worker = scene.worker().unwrap();
    let mut s = draws(1);
    let (mut outside, mut by_plane) = (0, 0);
    for _ in 0..3000 {
        let p = [s.uniform(-6.0, 6.0), s.uniform(-6.0, 6.0), s.uniform(0.01, 6.0)];
        worker.set_drone(0, p, LEVEL).unwrap();
        worker.update().unwrap();
        let exact = Queries::at(&mut worker).clearance(0, 100.0).unwrap().distance_m + RADIUS_M;
        let got = field.at(p).0;
        assert!(got <= exact + 0.045 && got >= 0.7 * exact - 0.045, "{p:?}: {got} {exact}");
        let (low, high) = (field.grid().origin_m, field.grid().end_m());
        outside += usize::from((0..3).any(|k| p[k] < low[k] || p[k] > high[k]));
        by_plane += usize::from((got - p[2]).abs() < 1e-9);
    }
    assert!(outside > 2000 && by_plane > 100, "{outside} {by_plane}");
}

#[test]
fn what_makes_no_field_is_refused_in_words() {
    let geoms = |text: &str| format!("<mujoco><worldbody>{text}</worldbody></mujoco>");
    let words = |xml: &str, resolution: f64, bounds, most| match build(xml, &[])
        .distance_field(resolution, bounds, most)
    {
        Err(SceneError::Argument { what }) => what,
        other => panic!("{other:?}"),
    };
    let (plane, ball) = (geoms("<geom type='plane' size='0 0 1'/>"), geoms("<geom size='.1'/>"));
    let sight = geoms("<geom size='.1' contype='0' conaffinity='0'/>");
    assert!(words(&plane, 0.1, None, 1 << 20).contains("give bounds"));
    assert!(words(&sight, 0.1, None, 1 << 20).contains("nothing in it stands still"));
    assert!(words(&ball, 0.01, None, 1 << 20).contains("allow more memory"));
    assert!(words(&ball, 0.0, None, 1 << 20).contains("resolution: expected"));
    assert!(words(&ball, f64::INFINITY, None, 1 << 20).contains("resolution: expected"));
    assert!(words(&ball, 0.1, Some([[1.0; 3], [0.0; 3]]), 1 << 20).contains("bounds: expected"));
    assert!(words(&ball, 0.1, Some([[f64::NAN; 3], [0.0; 3]]), 1 << 20).contains("bounds: expected"));
}

/// The distance to the plane x = 0.3 from its lower side.
fn wall() -> DistanceField {
    let grid = FieldGrid { origin_m: [-1.0, -1.0, -1.0], resolution_m: 1.0, counts: [3, 3, 4] };
    let data = (0..grid.len()).map(|i| 0.3 - (-1.0 + (i / 12) as f32)).collect();
    DistanceField::new(grid, data, vec![], vec![]).unwrap()
}

fn arena<N: Number>(engine: Engine) -> Arena<N> {
    let options =
        SimOptions { n_worlds: 37, control: ControlMode::Attitude, engine, ..SimOptions::default() };
    Arena::from_config(&SimConfig { options, n_drones: Some(2), ..SimConfig::default() }).unwrap()
}

/// In lanes and one by one, with states kept and not; a world goes astray on its way.
#[test]
fn what_is_seen_on_the_way_is_what_the_states_say_afterwards() {
    check_watched::<f32>(Engine::Lanes);
    check_watched::<f64>(Engine::Lanes);
    check_watched::<f64>(Engine::Reference);
}

fn check_watched<N: Number>(engine: Engine) {
    let (field, radius_m, times) = (wall(), 0.25, 30);
    // A pitch for each drone of each world; some stay where they are. (world, time, drone)
    let pitch = |i: usize| 0.5 * ((i / (2 * times) * 2 + i % 2) % 7) as f64 / 6.0;
    let command = |i: usize| [0.0, pitch(i), 0.0, 0.33].map(N::of);
    let commands: Vec<N> = (0..37 * times * 2).flat_map(command).collect();
    let flown = |keep: bool| {
        let mut arena = arena::<N>(engine);
        // Beyond 1e9 m after a step or two.
        arena.data_mut().vel[6 * 5] = N::of(3e11);
        let found = arena.rollout_near(&commands, 10, (&field, radius_m), keep).unwrap();
        assert!(arena.sim().data.quarantine[5].is_some() && arena.sim().data.quarantine[4].is_none());
        found
    };
    let (states, near) = flown(true);
    let (none, same) = flown(false);
    assert!(none.is_empty() && same == near);
    let width = states.len() / (37 * times * 2);
    let mut hits = 0;
    for row in 0..74 {
        let at = |t: usize| {
            let from = ((row / 2 * times + t) * 2 + row % 2) * width;
            field.at([0, 1, 2].map(|k| states[from + k].wide())).0
        };
        let distances: Vec<f64> = (0..times).map(at).collect();
        let least = distances.iter().copied().fold(f64::INFINITY, f64::min);
        let off = (least - f64::from(near.distance_m[row])).abs();
        assert!(off < 1e-5 * (1.0 + least.abs()), "{row}: {off} of {least}");
        let first = near.first[row] as usize;
        let below = distances.iter().position(|d| *d < radius_m).unwrap_or(times);
        // Within rounding of the radius either may be the first.
        let close = distances.get(first.min(below)).is_some_and(|d| (d - radius_m).abs() < 1e-5);
        assert!(first == below || close, "{row}: {first} {below}");
        hits += usize::from(first < times);
    }
    assert!(hits > 5 && hits < 70, "{hits}");
    for radius_m in [-1.0, f64::NAN] {
        let e = arena::<N>(engine).rollout_near(&commands, 1, (&field, radius_m), false).unwrap_err();
        assert!(e.to_string().contains("radius_m"), "{e}");
    }
}
