//! The main job as a whole: `propwash fly` and what lies in the folder afterwards.

#[path = "common/tree.rs"]
mod tree;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use propwash::dataset::{Dataset, Frames, Table, world_dir_name};
use propwash::scene::{Scene, SceneSource, Shell};
use propwash::sense::{Camera, DepthFrame};
use propwash::vehicle::{BUILTIN, DYNAMICS, Vehicle};
use serde_json::Value;
use tempfile::TempDir;
use tree::files;

/// `propwash fly` with small images, ready to run; `line` is split at spaces.
fn command(line: &str, out: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_propwash"));
    command
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .arg("fly")
        .args(line.split_whitespace())
        .args(["--json", "--out"])
        .arg(out);
    if !line.contains("--size") {
        command.args(["--size", "16x12"]);
    }
    command
}

fn run(line: &str, out: &Path) -> Output {
    command(line, out).output().unwrap()
}

/// Flies and gives the summary and the whole, verified data set.
fn fly(line: &str, out: &Path) -> (Value, Dataset) {
    let done = run(line, out);
    assert_eq!(done.status.code(), Some(0), "{line}: {}", String::from_utf8_lossy(&done.stderr));
    let summary = serde_json::from_slice(&done.stdout).unwrap();
    let data = Dataset::open(out).unwrap();
    data.verify().unwrap();
    (summary, data)
}

/// A folder for one test, and a file in it.
fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn write(dir: &TempDir, name: &str, content: &str) -> String {
    let path = dir.path().join(name);
    fs::write(&path, content).unwrap();
    path.to_string_lossy().into_owned()
}

/// Both folders hold the same files with the same bytes.
fn assert_same(a: &Path, b: &Path) {
    let (a, b) = (files(a), files(b));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    for (name, bytes) in &a {
        assert!(bytes == &b[name], "{} differs", name.display());
    }
}

/// Row `i` of some columns.
fn row<const N: usize>(table: &Table, names: [&str; N], i: usize) -> [f64; N] {
    names.map(|name| table.column(name).unwrap()[i])
}

const POS: [&str; 3] = ["px", "py", "pz"];
const QUAT: [&str; 4] = ["qx", "qy", "qz", "qw"];

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

/// Number of a body in the manifest.
fn body(data: &Dataset, name: &str) -> i32 {
    let found = data.manifest().bodies.iter().find(|b| b.name == name);
    found.unwrap_or_else(|| panic!("no body {name}")).id
}

fn geom(data: &Dataset, name: &str) -> i32 {
    let found = data.manifest().geoms.iter().find(|g| g.name == name);
    found.unwrap_or_else(|| panic!("no geom {name}")).id
}

/// Indices of the rows of a column that hold `value`.
fn rows_with(table: &Table, column: &str, value: i32) -> Vec<usize> {
    let values = table.column(column).unwrap();
    (0..table.n_rows()).filter(|i| values[*i] == f64::from(value)).collect()
}

// The same bytes, however it is run.

#[test]
fn the_bytes_do_not_depend_on_the_number_of_threads() {
    let dir = folder();
    let noise = write(&dir, "noise.toml", "axial_base_m = 0.01\ndropout_probability = 0.05\n");
    let rules =
        write(&dir, "rules.toml", "[[rule]]\nparameter = \"body.mass_kg\"\ndraw = { scale = [0.9, 1.1] }\n");
    let line = format!(
        "--scene xml/forest.xml --drone cf2x_L250 --drone cf21B_500 --worlds 5 --seconds 0.4 --obstacle-jitter 0.3 \
         --normals --noise {noise} --randomize {rules} --seed 5"
    );
    let (one, four) = (dir.path().join("one"), dir.path().join("four"));
    fly(&format!("{line} --threads 1"), &one);
    fly(&format!("{line} --threads 4"), &four);
    assert!(one.join("overview.png").is_file());
    assert_same(&one, &four);
}

#[test]
fn a_killed_run_goes_on_to_the_same_bytes() {
    let dir = folder();
    let (whole, torn) = (dir.path().join("whole"), dir.path().join("torn"));
    let line = "--scene xml/forest.xml --drone cf2x_L250 --worlds 12 --seconds 1 --size 48x36 --threads 2";
    fly(line, &whole);
    let mut child = command(line, &torn).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let worlds = || (0..12).filter(|w| torn.join(world_dir_name(*w)).is_dir()).count();
    let start = Instant::now();
    while worlds() == 0 {
        assert!(child.try_wait().unwrap().is_none(), "it ended before it could be killed");
        assert!(start.elapsed() < Duration::from_secs(300), "no world was written");
        std::thread::sleep(Duration::from_millis(2));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let there = worlds();
    assert!((1..12).contains(&there), "{there} of 12 worlds were there when it was killed");
    assert!(!torn.join("complete.json").exists(), "half a data set must not look whole");
    let half = Dataset::open(&torn).unwrap();
    assert!(!half.is_complete() && half.verify().is_err());

    let (summary, _) = fly(line, &torn);
    assert_eq!(summary["resumed_worlds"].as_u64().unwrap() as usize, there);
    assert_same(&whole, &torn);

    // Nothing is left to do.
    let (summary, _) = fly(line, &torn);
    assert_eq!(summary["resumed_worlds"], 12);
    assert_same(&whole, &torn);

    // A damaged world is found, named and made anew.
    let victim = torn.join(world_dir_name(3)).join("states.parquet");
    let mut bytes = fs::read(&victim).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x55;
    fs::write(&victim, bytes).unwrap();
    let (summary, _) = fly(line, &torn);
    assert_eq!(summary["resumed_worlds"], 11);
    assert!(summary["warnings"].to_string().contains("world 3 was damaged"), "{summary}");
    assert_same(&whole, &torn);
}

#[test]
fn a_folder_of_other_settings_is_refused_by_field() {
    let dir = folder();
    let out = dir.path().join("out");
    let line = "--scene xml/room.xml --drone cf2x_L250 --worlds 2 --seconds 0.1";
    fly(line, &out);
    let before = files(&out);
    for (more, field) in [
        ("--seed 1", "seed: the folder has 0, asked for 1"),
        ("--seed 0 --fps 10", "fps: the folder has 20.0, asked for 10.0"),
        ("--trajectory hover", "flight.trajectory.kind"),
        ("--obstacle-jitter 0.1", "flight.trajectory.obstacle_jitter_m"),
        ("--far 10", "cameras[0].far_m"),
        ("--integrator rk4", "flight.integrator"),
        ("--dynamics so_rpy", "vehicles[0].dynamics"),
    ] {
        let refused = run(&format!("{line} {more}"), &out);
        let message = String::from_utf8(refused.stderr).unwrap();
        assert_eq!(refused.status.code(), Some(2), "{message}");
        assert!(message.starts_with("error: ") && message.trim_end().lines().count() == 1, "{message}");
        assert!(message.contains(field) && message.contains("choose another --out"), "{more}: {message}");
    }
    assert!(files(&out) == before, "a refused run changes nothing");
}

#[test]
fn another_seed_flies_another_way() {
    let dir = folder();
    let line = "--scene xml/room.xml --drone cf2x_L250 --worlds 2 --seconds 0.1";
    let (_, a) = fly(&format!("{line} --seed 0"), &dir.path().join("a"));
    let (_, b) = fly(&format!("{line} --seed 1"), &dir.path().join("b"));
    let start = |data: &Dataset, world| row(&data.world(world).unwrap().states(Some(&POS)).unwrap(), POS, 0);
    assert_ne!(start(&a, 0), start(&a, 1), "worlds differ");
    assert_ne!(start(&a, 0), start(&b, 0), "seeds differ");
}

// What is recorded is what happened.

#[test]
fn the_drone_follows_its_reference() {
    let dir = folder();
    let (_, data) =
        fly("--scene xml/room.xml --drone cf2x_L250 --worlds 3 --seconds 5 --fps 2", &dir.path().join("out"));
    for world in data.worlds() {
        let states = data.world(world).unwrap().states(None).unwrap();
        let t = states.column("t").unwrap();
        assert_eq!(t.len(), 501);
        let errors: Vec<f64> = (0..t.len())
            .filter(|i| t[*i] >= 1.5)
            .map(|i| distance(row(&states, POS, i), row(&states, ["ref_x", "ref_y", "ref_z"], i)))
            .collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let worst = errors.iter().copied().fold(0.0, f64::max);
        println!("world {world}: tracking error mean {mean:.3} m, worst {worst:.3} m");
        assert!(mean < 0.25 && worst < 0.6, "world {world}: mean {mean} m, worst {worst} m");
        assert!(mean > 1e-4, "a drone lags behind its reference: the states are not the references");
        // Velocities are the slopes of positions.
        for i in (150..t.len() - 1).step_by(7) {
            for (k, v) in ["vx", "vy", "vz"].into_iter().enumerate() {
                let p = states.column(POS[k]).unwrap();
                let slope = (p[i + 1] - p[i - 1]) / (t[i + 1] - t[i - 1]);
                let speed = states.column(v).unwrap()[i];
                assert!(
                    (slope - speed).abs() < 0.02,
                    "world {world}, t {}: {v} {speed}, slope {slope}",
                    t[i]
                );
            }
            let q = row(&states, QUAT, i);
            assert!((q.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < 1e-9);
        }
    }
}

#[test]
fn contacts_and_clearances_agree() {
    let dir = folder();
    let (summary, data) = fly(
        "--scene xml/forest.xml --drone cf2x_L250 --worlds 8 --seconds 4 --fps 1",
        &dir.path().join("out"),
    );
    assert!(
        summary["contact_rows"].as_u64().unwrap() > 0,
        "a forest in which nothing is touched proves nothing"
    );
    let mut touched = 0;
    for world in data.worlds() {
        let world = data.world(world).unwrap();
        let (contacts, clearance) = (world.contacts(None).unwrap(), world.clearance(None).unwrap());
        let (steps, distances) = (clearance.column("step").unwrap(), clearance.column("distance").unwrap());
        let at = |step: f64| steps.iter().position(|s| *s == step).map(|i| (i, distances[i]));
        for i in 0..contacts.n_rows() {
            let [step, depth, swept] = row(&contacts, ["step", "distance", "swept"], i);
            // At steps that are logged, the clearance is negative too, and no contact is deeper than it.
            if let (Some((_, clear)), true) = (at(step), swept == 0.0 && depth < 0.0) {
                assert!(clear < 0.0, "step {step}: contact {depth} m, clearance {clear} m");
                touched += 1;
            }
            // A neighbouring log tick is near, at the speed of the drone.
            let near = distances[(step / 5.0).round() as usize];
            assert!(near < 0.05, "step {step}: contact, but the clearance nearby is {near} m");
            let n = row(&contacts, ["nx", "ny", "nz"], i);
            assert!((distance(n, [0.0; 3]) - 1.0).abs() < 1e-6, "normal {n:?}");
        }
        // And back: what is nearer than nothing was reported as a contact at that step.
        for (step, clear) in steps.iter().zip(distances) {
            if *clear < -1e-4 {
                let there = contacts.column("step").unwrap().contains(step);
                assert!(there, "step {step}: clearance {clear} m without a contact");
            }
        }
    }
    assert!(touched > 0, "no contact at a logged step");
}

/// Renders frame after frame through the library at the poses that the states hold, and compares bit by bit.
fn assert_frames_are_those_of_the_states(
    scene: &Scene,
    data: &Dataset,
    world: usize,
    cameras: &[Camera],
) -> usize {
    let reader = data.world(world).unwrap();
    let (states, frames) = (reader.states(None).unwrap(), reader.frames().unwrap());
    let mut worker = scene.worker().unwrap();
    let places = reader.record().info["obstacles_m"].as_array().unwrap();
    for (i, obstacle) in scene.obstacles().iter().enumerate() {
        let at: [f64; 3] = std::array::from_fn(|k| places[i][k].as_f64().unwrap());
        worker.set_obstacle(i, at, obstacle.quat_xyzw).unwrap();
    }
    let n = cameras.len();
    let (t, drone) = (states.column("t").unwrap(), states.column("drone").unwrap());
    let mut seen = 0;
    for (f, time) in frames.time_s.iter().enumerate() {
        for d in 0..n {
            let i = (0..t.len()).find(|i| t[*i] == *time && drone[*i] == d as f64).unwrap();
            worker.set_drone(d, row(&states, POS, i), row(&states, QUAT, i)).unwrap();
        }
        worker.update().unwrap();
        for (d, camera) in cameras.iter().enumerate() {
            let mut frame = DepthFrame::new();
            camera.render(&mut worker, &mut frame).unwrap();
            let of = |a: ndarray::ArrayView2<f32>| a.iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
            let stored = frames.depth_m.slice(ndarray::s![f, d, .., ..]);
            let rendered: Vec<u32> = frame.depth_m.iter().map(|v| v.to_bits()).collect();
            assert!(of(stored) == rendered, "depth of frame {f}, drone {d}");
            let equal = |a: ndarray::ArrayView2<i32>, b: &[i32]| a.iter().eq(b.iter());
            assert!(equal(frames.geom_id.slice(ndarray::s![f, d, .., ..]), &frame.geom_id));
            assert!(equal(frames.body_id.slice(ndarray::s![f, d, .., ..]), &frame.body_id));
            assert!(frames.status.slice(ndarray::s![f, d, .., ..]).iter().eq(frame.status.iter()));
            assert!((0..3).all(|k| frames.camera_pos_m[[f, d, k]] == frame.pos_m[k]));
            // And the 16-bit image holds the same in millimetres.
            let image = reader.image(d, f, false).unwrap();
            for (value, (depth, status)) in image.iter().zip(frame.depth_m.iter().zip(&frame.status)) {
                let (metres, code) = propwash::dataset::decode(*value, 0.001);
                assert_eq!(code, *status);
                assert!(code != 0 || (metres - depth).abs() <= 0.000_502, "{metres} m, {depth} m");
            }
            seen += frame.status.iter().filter(|s| **s == 0).count();
        }
    }
    seen
}

#[test]
fn stored_depth_is_that_of_the_stored_poses() {
    let dir = folder();
    let (_, data) = fly(
        "--scene xml/forest.xml --drone cf2x_L250 --worlds 2 --seconds 1 --size 32x24 --obstacle-jitter 0.4",
        &dir.path().join("out"),
    );
    let scene =
        Scene::build(&SceneSource::file("xml/forest.xml"), &[Shell::builtin("cf2x").unwrap()]).unwrap();
    let camera = Camera::on_drone(&scene, 0, "fpv").unwrap().with_size(32, 24).unwrap();
    let camera = camera.with_kind(propwash::sense::DepthKind::ZDepth).with_range(0.01, 20.0).unwrap();
    for world in 0..2 {
        let seen = assert_frames_are_those_of_the_states(&scene, &data, world, std::slice::from_ref(&camera));
        assert!(seen > 21 * 32 * 24 / 2, "world {world}: only {seen} pixels hit");
    }
}

// Walls and other drones.

/// A sheet of 1 mm across the way at x = 0, and a floor far below.
const THIN_WALL: &str = r#"<mujoco><worldbody>
    <geom name="floor" type="plane" size="0 0 1" pos="0 0 -20"/>
    <geom name="wall" type="box" size="0.0005 5 5" pos="0 0 1"/>
</worldbody></mujoco>"#;

#[test]
fn no_vehicle_tunnels_through_a_thin_wall() {
    let dir = folder();
    let scene = write(&dir, "wall.xml", THIN_WALL);
    // The reference crosses the wall at about 7 m/s.
    let path = write(&dir, "path.csv", "t,x,y,z\n0,-6,0,1\n1,-4.5,0,1\n2,2,0,1\n3,8,0,1\n4,10,0,1\n");
    for vehicle in BUILTIN {
        let (summary, data) = fly(
            &format!("--scene {scene} --drone {vehicle} --trajectory waypoints {path} --seconds 3 --fps 5"),
            &dir.path().join(vehicle),
        );
        assert_eq!(summary["quarantined_worlds"], 0, "{vehicle}");
        let world = data.world(0).unwrap();
        let (states, contacts) = (world.states(None).unwrap(), world.contacts(None).unwrap());
        let x = states.column("px").unwrap();
        assert!(x[0] < -1.0 && x.iter().any(|x| *x > 1.0), "{vehicle} went to the other side");
        let wall = rows_with(&contacts, "geom2", geom(&data, "wall"));
        assert!(!wall.is_empty(), "{vehicle} went through the wall unnoticed");
        let first = wall[0];
        let [t, px, nx] = row(&contacts, ["t", "x", "nx"], first);
        assert!(px.abs() < 0.01, "{vehicle} touched the wall at x = {px}");
        assert!(nx > 0.0, "the normal points from the drone to the wall");
        let before = states.column("t").unwrap().iter().rposition(|s| *s <= t).unwrap();
        assert!(x[before.saturating_sub(1)] < 0.3, "{vehicle}: noticed at t = {t} s, x = {}", x[before]);
    }
}

/// A shell of 2 mm: at 5 m/s and 500 steps per second the way of one step is five times as long, so the drone is on one
/// side of the wall at one step and clear of it on the other side at the next.
const SPECK: &str = r#"<mujoco><worldbody><body name="drone"><geom name="speck" type="sphere" size="0.001"/>
    <camera name="fpv" pos="0.01 0 0" xyaxes="0 -1 0 0 0 1"/></body></worldbody></mujoco>"#;

/// Waypoints through x = 0 at about 7 m/s, at `y` metres from the middle; each has the crossing in another part of a step.
fn crossing(dir: &TempDir, y: &str, i: usize) -> String {
    let end = 2.0 + 0.003 * i as f64;
    let text = format!("t,x,y,z\n0,-6,{y},1\n1,-4.5,{y},1\n{end},2,{y},1\n3,8,{y},1\n4,10,{y},1\n");
    write(dir, &format!("path{i}.csv"), &text)
}

#[test]
fn a_wall_between_two_steps_is_found_by_the_swept_check() {
    let dir = folder();
    let scene = write(&dir, "wall.xml", THIN_WALL);
    let shell = write(&dir, "speck.xml", SPECK);
    let mut swept_only = 0;
    for i in 0..6 {
        let path = crossing(&dir, "0", i);
        let (_, data) = fly(
            &format!(
                "--scene {scene} --drone cf2x_L250 --shell {shell} --trajectory waypoints {path} --seconds 2.5 --fps 2 \
                 --log-hz 500"
            ),
            &dir.path().join(i.to_string()),
        );
        let world = data.world(0).unwrap();
        let (states, contacts) = (world.states(None).unwrap(), world.contacts(None).unwrap());
        let x = states.column("px").unwrap();
        let after = x.iter().position(|x| *x > 0.0).expect("it crosses");
        let wall = rows_with(&contacts, "geom2", geom(&data, "wall"));
        assert!(!wall.is_empty(), "{i}: unnoticed; x from {} to {}", x[after - 1], x[after]);
        // Both ends of the step are clear of wall and shell: only the way between them touched.
        if x[after - 1] < -0.0016 && x[after] > 0.0016 {
            swept_only += 1;
            assert_eq!(wall.len(), 1, "{i}: crossed once, found {} times", wall.len());
            let [swept, step, fraction, at] = row(&contacts, ["swept", "step", "fraction", "x"], wall[0]);
            assert_eq!((swept, step), (1.0, after as f64));
            let expected = (-0.0015 - x[after - 1]) / (x[after] - x[after - 1]);
            assert!((fraction - expected).abs() < 0.02, "{i}: at {fraction} of the step, not {expected}");
            assert!((at + 0.0005).abs() < 1e-4, "{i}: touched at x = {at}");
        }
    }
    assert!(swept_only >= 3, "in {swept_only} of 6 runs only was the swept check needed");
}

/// While it touches one thing, a drone must not lose sight of the next; and one step may cross several walls.
#[test]
fn every_wall_on_the_way_of_a_step_is_found() {
    let dir = folder();
    // A rail that the drone flies inside of, and two walls, 2 mm from each other.
    let scene = write(
        &dir,
        "rail.xml",
        r#"<mujoco><worldbody>
            <geom name="rail" type="box" size="60 0.5 0.5" pos="0 0 1"/>
            <geom name="wall" type="box" size="0.0005 5 5" pos="0 0 1"/>
            <geom name="second" type="box" size="0.0005 5 5" pos="0.002 0 1"/>
        </worldbody></mujoco>"#,
    );
    let shell = write(&dir, "speck.xml", SPECK);
    // In the rail, and beside it.
    for (i, y) in ["0", "2", "0", "2", "0", "2"].into_iter().enumerate() {
        let path = crossing(&dir, y, i);
        let (_, data) = fly(
            &format!(
                "--scene {scene} --drone cf2x_L250 --shell {shell} --trajectory waypoints {path} --seconds 2.5 --fps 2"
            ),
            &dir.path().join(i.to_string()),
        );
        let contacts = data.world(0).unwrap().contacts(None).unwrap();
        let touches = |name: &str| rows_with(&contacts, "geom2", geom(&data, name)).len();
        assert_eq!(touches("rail") > 0, y == "0");
        assert!(touches("wall") > 0, "{i}, y = {y}: the first wall went unnoticed");
        assert!(touches("second") > 0, "{i}, y = {y}: the second wall went unnoticed");
    }
}

/// Clearance does not measure flexes, so it must not decide where contacts are looked for.
#[test]
fn a_cloth_on_the_way_is_touched_though_nothing_else_is_near() {
    let dir = folder();
    let scene = write(
        &dir,
        "cloth.xml",
        r#"<mujoco><worldbody><body name="cloth" pos="0 0 2">
            <flexcomp name="cloth" type="grid" dim="2" count="5 5 1" spacing="0.2 0.2 0.2" radius="0.02" mass="1">
                <contact selfcollide="none"/>
            </flexcomp>
        </body></worldbody></mujoco>"#,
    );
    let path = write(&dir, "up.csv", "t,x,y,z\n0,0.05,0.03,1\n2,0.05,0.03,3\n");
    let (_, data) = fly(
        &format!("--scene {scene} --drone cf2x_L250 --trajectory waypoints {path} --seconds 2 --fps 2"),
        &dir.path().join("out"),
    );
    let contacts = data.world(0).unwrap().contacts(None).unwrap();
    let cloth = rows_with(&contacts, "other_flex", 0);
    assert!(!cloth.is_empty(), "the drone went through the cloth unnoticed");
    let [geom, z] = row(&contacts, ["geom2", "z"], cloth[0]);
    assert!(geom == -1.0 && (1.9..2.1).contains(&z), "geom {geom}, z = {z}");
}

#[test]
fn drones_of_several_kinds_see_each_other() {
    let dir = folder();
    // A grid of four, 0.6 m apart, all facing x: those at the back have the others before them.
    let (_, data) = fly(
        "--scene xml/room.xml --drone cf2x_L250 --drone hb_x500 --drones-per-world 4 --trajectory hover --seconds 0.5 \
         --size 64x48",
        &dir.path().join("out"),
    );
    let names: Vec<&str> = data.manifest().vehicles.iter().map(|v| v.name.as_str()).collect();
    assert_eq!(names, ["cf2x_L250", "hb_x500", "cf2x_L250", "hb_x500"]);
    let world = data.world(0).unwrap();
    let states = world.states(None).unwrap();
    let start = |d: usize| {
        let i = (0..states.n_rows()).find(|i| states.column("drone").unwrap()[*i] == d as f64).unwrap();
        row(&states, POS, i)
    };
    let frames: Frames = world.frames().unwrap();
    for d in 0..4 {
        let sees = |other: usize| {
            let id = body(&data, &format!("drone{other}/drone"));
            frames.body_id.slice(ndarray::s![.., d, .., ..]).iter().filter(|b| **b == id).count()
        };
        assert_eq!(sees(d), 0, "drone {d} sees itself");
        // Straight ahead is the drone with the same y and 0.6 m more of x.
        for other in (0..4).filter(|o| *o != d) {
            let (a, b) = (start(d), start(other));
            if (a[1] - b[1]).abs() < 0.01 && b[0] > a[0] {
                assert!(sees(other) > 0, "drone {d} at {a:?} does not see drone {other} at {b:?}");
            }
        }
    }
    // And the images are those of the logged poses, of all drones.
    let shells = ["cf2x", "hb_x500", "cf2x", "hb_x500"].map(|n| Shell::builtin(n).unwrap());
    let scene = Scene::build(&SceneSource::file("xml/room.xml"), &shells).unwrap();
    let cameras: Vec<Camera> = (0..4)
        .map(|d| Camera::on_drone(&scene, d, "fpv").unwrap().with_size(64, 48).unwrap())
        .map(|c| c.with_kind(propwash::sense::DepthKind::ZDepth).with_range(0.01, 20.0).unwrap())
        .collect();
    assert!(assert_frames_are_those_of_the_states(&scene, &data, 0, &cameras) > 1000);
}

#[test]
fn drones_that_meet_touch_each_other() {
    let dir = folder();
    // Shells of 0.35 m radius at 0.6 m from each other.
    let shell = write(
        &dir,
        "ball.xml",
        r#"<mujoco><worldbody><body name="drone"><geom name="ball" type="sphere" size="0.35"/>
            <camera name="fpv" pos="0.36 0 0" xyaxes="0 -1 0 0 0 1"/></body></worldbody></mujoco>"#,
    );
    let (_, data) = fly(
        &format!(
            "--scene xml/room.xml --drone cf2x_L250 --drone cf21B_500 --shell {shell} --trajectory hover --seconds 0.2"
        ),
        &dir.path().join("balls"),
    );
    let world = data.world(0).unwrap();
    let (contacts, clearance) = (world.contacts(None).unwrap(), world.clearance(None).unwrap());
    let pairs: Vec<usize> = rows_with(&contacts, "other_drone", 1);
    assert!(!pairs.is_empty());
    for i in &pairs {
        let [drone, other, gap] = row(&contacts, ["drone", "other_drone", "distance"], *i);
        assert_eq!((drone, other), (0.0, 1.0));
        assert!((gap + 0.1).abs() < 0.05, "balls of 0.35 m at 0.6 m: {gap} m");
    }
    let first = row(&clearance, ["distance", "body"], 0);
    assert!((first[0] + 0.1).abs() < 1e-6 && first[1] == f64::from(body(&data, "drone1/drone")), "{first:?}");

    // Six drones on Lissajous figures of the same shape meet on their way.
    let (summary, data) = fly(
        "--scene xml/room.xml --drone hb_x500 --drones-per-world 6 --worlds 3 --seconds 4 --fps 1 --size 8x6",
        &dir.path().join("swarm"),
    );
    assert_eq!(summary["quarantined_worlds"], 0);
    let mut meetings = 0;
    for w in data.worlds() {
        let contacts = data.world(w).unwrap().contacts(None).unwrap();
        for i in 0..contacts.n_rows() {
            let [drone, other, body1, body2] = row(&contacts, ["drone", "other_drone", "body1", "body2"], i);
            if other >= 0.0 {
                assert!(drone < other, "drone {drone} and drone {other}: the lower number comes first");
                let owner = |b: f64| data.manifest().bodies[b as usize].drone;
                assert_eq!((owner(body1), owner(body2)), (drone as i32, other as i32));
                meetings += 1;
            }
        }
    }
    assert!(meetings > 0);
}

#[test]
fn every_vehicle_flies_with_every_dynamics() {
    let dir = folder();
    for dynamics in DYNAMICS {
        for vehicle in BUILTIN {
            assert!(Vehicle::builtin(vehicle).unwrap().available_dynamics().contains(&dynamics));
            let (summary, data) = fly(
                &format!(
                    "--scene xml/room.xml --drone {vehicle} --dynamics {dynamics} --seconds 1 --fps 2 --size 8x6 \
                     --trajectory circle"
                ),
                &dir.path().join(format!("{vehicle}_{dynamics}")),
            );
            assert_eq!(summary["quarantined_worlds"], 0, "{vehicle} {dynamics}");
            let states = data.world(0).unwrap().states(None).unwrap();
            let last = states.n_rows() - 1;
            let error = distance(row(&states, POS, last), row(&states, ["ref_x", "ref_y", "ref_z"], last));
            assert!(error < 0.8, "{vehicle} {dynamics}: {error} m from its reference after 1 s");
            let up = 1.0 - 2.0 * (row(&states, QUAT, last)[0].powi(2) + row(&states, QUAT, last)[1].powi(2));
            assert!(up > 0.5, "{vehicle} {dynamics} lies on its side");
        }
    }
}

// Options that change worlds.

#[test]
fn randomised_masses_differ_between_worlds_and_repeat() {
    let dir = folder();
    let rules = write(
        &dir,
        "rules.toml",
        "[[rule]]\nparameter = \"body.mass_kg\"\ndraw = { scale = [0.8, 1.2] }\n\n\
         [[rule]]\nparameter = \"initial.pos.2\"\ndraw = { normal = 0.05 }\n",
    );
    let line = format!("--scene xml/room.xml --drone cf2x_L250 --worlds 4 --seconds 0.3 --randomize {rules}");
    let (_, a) = fly(&line, &dir.path().join("a"));
    fly(&line, &dir.path().join("b"));
    assert_same(&dir.path().join("a"), &dir.path().join("b"));
    let nominal = Vehicle::builtin("cf2x_L250").unwrap().drone("first_principles").unwrap().body.mass_kg;
    let mut masses = Vec::new();
    let mut heights = Vec::new();
    for w in a.worlds() {
        let world = a.world(w).unwrap();
        let mass = world.record().info["masses_kg"][0].as_f64().unwrap();
        assert!((0.8 * nominal..=1.2 * nominal).contains(&mass), "{mass}");
        masses.push(mass);
        let states = world.states(None).unwrap();
        heights.push(states.column("pz").unwrap()[0] - states.column("ref_z").unwrap()[0]);
    }
    for i in 0..4 {
        for j in 0..i {
            assert_ne!(masses[i], masses[j], "worlds {i} and {j} have the same mass");
            assert_ne!(heights[i], heights[j]);
        }
    }
    assert!(heights.iter().all(|h| h.abs() < 0.3 && *h != 0.0), "{heights:?}");
    // The rules are in the manifest, so that the run can be repeated from it.
    assert!(a.manifest().flight.trajectory["randomization"].to_string().contains("body.mass_kg"));
}

/// Such a world used to end the whole run with an error, and no repetition could ever finish it.
#[test]
fn a_world_that_flies_out_of_all_bounds_is_set_aside_and_the_others_go_on() {
    let dir = folder();
    for (i, (rule, quarantined)) in [
        ("parameter = \"initial.vel.0\"\ndraw = { uniform = [1e13, 2e13] }", 3),
        ("parameter = \"initial.pos.0\"\ndraw = { uniform = [1e13, 2e13] }", 3),
        ("parameter = \"initial.vel.0\"\ndraw = { uniform = [0.0, 0.1] }", 0),
    ]
    .into_iter()
    .enumerate()
    {
        let rules = write(&dir, &format!("rules{i}.toml"), &format!("[[rule]]\n{rule}\n"));
        let line =
            format!("--scene xml/room.xml --drone cf2x_L250 --worlds 3 --seconds 0.1 --randomize {rules}");
        let (summary, data) = fly(&line, &dir.path().join(i.to_string()));
        assert_eq!(summary["quarantined_worlds"], quarantined, "{rule}");
        for w in data.worlds() {
            let reason = data.world(w).unwrap().record().quarantine.as_ref().map(|q| q.reason.clone());
            assert_eq!(reason.is_some(), quarantined > 0);
            assert!(reason.is_none_or(|r| r.contains("1e9 m")));
        }
    }
}

#[test]
fn noise_leaves_the_clean_depth_alone() {
    let dir = folder();
    let noise = write(
        &dir,
        "noise.toml",
        "axial_base_m = 0.005\naxial_quadratic_per_m = 0.002\ndropout_probability = 0.1\n",
    );
    let line = "--scene xml/forest.xml --drone cf2x_L250 --worlds 2 --seconds 0.3 --size 32x24";
    let (_, clean) = fly(line, &dir.path().join("clean"));
    let (_, noisy) = fly(&format!("{line} --noise {noise}"), &dir.path().join("noisy"));
    for w in 0..2 {
        let (a, b) = (clean.world(w).unwrap(), noisy.world(w).unwrap());
        let (fa, fb) = (a.frames().unwrap(), b.frames().unwrap());
        assert!(fa.depth_m == fb.depth_m && fa.status == fb.status && fa.geom_id == fb.geom_id);
        assert!(fa.depth_noisy_m.is_none());
        assert_eq!(
            a.states(None).unwrap().column("px").unwrap(),
            b.states(None).unwrap().column("px").unwrap()
        );
        assert_eq!(a.image(0, 2, false).unwrap(), b.image(0, 2, false).unwrap());
        let (depth, status) = (fb.depth_noisy_m.unwrap(), fb.status_noisy.unwrap());
        let hit = |i: &usize| *fb.status.iter().nth(*i).unwrap() == 0;
        let hits: Vec<usize> = (0..fb.status.len()).filter(hit).collect();
        let lost = hits.iter().filter(|i| *status.iter().nth(**i).unwrap() == 1).count();
        let share = lost as f64 / hits.len() as f64;
        assert!((0.07..0.13).contains(&share), "{share} of the pixels were lost, not a tenth");
        let changed = depth.iter().zip(fb.depth_m.iter()).filter(|(a, b)| a != b).count();
        assert!(changed > hits.len() / 2);
    }
    assert!(noisy.manifest().noise.is_some());
}

/// A movable ball ahead of the drone, and nothing else.
const BALL: &str = r#"<mujoco><worldbody>
    <body name="ball" mocap="true" pos="1.5 0 1"><geom name="ball" type="sphere" size="0.5"/></body>
</worldbody></mujoco>"#;

#[test]
fn a_data_set_names_who_cast_its_rays() {
    use propwash::sense::Caster;
    let dir = folder();
    let scene = write(&dir, "ball.xml", BALL);
    for (flag, expected) in [("", Caster::Native), ("--caster mujoco", Caster::MuJoCo)] {
        let line = format!(
            "--scene {scene} --drone cf2x_L250 --trajectory hover --seconds 0.1 --fps 10 --size 8x8 {flag}"
        );
        let (_, data) = fly(&line, &dir.path().join(format!("{expected:?}")));
        assert_eq!(data.manifest().cameras[0].caster, Some(expected));
    }
}

#[test]
fn shifted_obstacles_are_seen_and_touched_where_they_are() {
    let dir = folder();
    let scene = write(&dir, "ball.xml", BALL);
    let path = write(&dir, "path.csv", "t,x,y,z\n0,0,0,1\n2,3,0,1\n");
    let line = format!(
        "--scene {scene} --drone cf2x_L250 --trajectory waypoints {path} --seconds 2 --fps 10 --size 32x24 \
         --depth range --worlds 5 --obstacle-jitter 0.4"
    );
    let (_, data) = fly(&line, &dir.path().join("out"));
    let mut centres: Vec<[f64; 3]> = Vec::new();
    for w in data.worlds() {
        let world = data.world(w).unwrap();
        let at = &world.record().info["obstacles_m"][0];
        let centre: [f64; 3] = std::array::from_fn(|k| at[k].as_f64().unwrap());
        assert!((centre[0] - 1.5).abs() <= 0.4 && centre[1].abs() <= 0.4 && centre[2] == 1.0, "{centre:?}");
        assert!(!centres.contains(&centre), "worlds share a place");
        centres.push(centre);
        // Every pixel that hits lies on the ball where world.json says it is.
        let frames = world.frames().unwrap();
        let k = data.manifest().cameras[0].k;
        let mut hits = 0;
        for ((f, d, y, x), depth) in frames.depth_m.indexed_iter().filter(|(_, v)| v.is_finite() && **v > 0.0)
        {
            let q: [f64; 4] = std::array::from_fn(|i| frames.camera_quat_xyzw[[f, d, i]]);
            let pixel = [(x as f64 + 0.5 - k[0][2]) / k[0][0], -(y as f64 + 0.5 - k[1][2]) / k[1][1], -1.0];
            let length = distance(pixel, [0.0; 3]);
            let ray = propwash::math::quat::rotate(q, pixel.map(|v| v / length));
            let point: [f64; 3] =
                std::array::from_fn(|i| frames.camera_pos_m[[f, d, i]] + f64::from(*depth) * ray[i]);
            assert!((distance(point, centre) - 0.5).abs() < 1e-4, "world {w}: {point:?} is not on the ball");
            hits += 1;
        }
        assert!(hits > 50, "world {w}: the ball was hardly seen");
        // Contacts lie on it, clearances end on it.
        let (contacts, clearance) = (world.contacts(None).unwrap(), world.clearance(None).unwrap());
        assert!(contacts.n_rows() > 0, "world {w}: the drone flies through the ball's place");
        let [x, y, z, gap] = row(&contacts, ["x", "y", "z", "distance"], 0);
        assert!((distance([x, y, z], centre) - 0.5).abs() < 0.01 + gap.abs(), "world {w}");
        let first = row(&clearance, ["to_x", "to_y", "to_z"], 0);
        assert!((distance(first, centre) - 0.5).abs() < 1e-4, "world {w}: {first:?}");
    }
    // Without jitter they stay where the scene has them.
    let (_, still) = fly(&line.replace("--obstacle-jitter 0.4", ""), &dir.path().join("still"));
    for w in still.worlds() {
        assert_eq!(
            still.world(w).unwrap().record().info["obstacles_m"][0],
            serde_json::json!([1.5, 0.0, 1.0])
        );
    }
}

#[test]
fn every_scene_of_the_project_is_flown() {
    let dir = folder();
    let mut scenes: Vec<PathBuf> = fs::read_dir("xml").unwrap().map(|e| e.unwrap().path()).collect();
    scenes.retain(|p| p.extension().is_some_and(|e| e == "xml"));
    scenes.sort();
    assert!(scenes.len() >= 6);
    for scene in scenes {
        let name = scene.file_stem().unwrap().to_string_lossy().into_owned();
        let line = format!("--scene {} --drone cf2x_L250 --trajectory hover --seconds 0.5", scene.display());
        let (summary, data) = fly(&line, &dir.path().join(&name));
        assert_eq!(summary["quarantined_worlds"], 0, "{name}");
        assert_eq!(summary["images"], 11, "{name}");
        assert_eq!(summary["contact_rows"], 0, "{name}: the drone starts in the open");
        let frames = data.world(0).unwrap().frames().unwrap();
        assert!(frames.status.iter().filter(|s| **s == 0).count() > 100, "{name}: nothing is seen");
        // It hovers.
        let states = data.world(0).unwrap().states(None).unwrap();
        let last = row(&states, POS, states.n_rows() - 1);
        assert!(distance(last, [0.0, 0.0, 1.0]) < 0.1, "{name}: {last:?}");
    }
}

#[test]
fn ground_effect_feels_the_floor_of_the_scene() {
    let dir = folder();
    let table = |height: &str| {
        let scene = format!(
            "<mujoco><worldbody><geom name=\"floor\" type=\"plane\" size=\"0 0 1\" pos=\"0 0 -5\"/>\
             <geom name=\"table\" type=\"box\" size=\"1 1 0.05\" pos=\"0 0 {height}\"/></worldbody></mujoco>"
        );
        write(&dir, &format!("table{height}.xml"), &scene)
    };
    let own = fs::read_to_string("params/cf2x_L250.toml").unwrap();
    let effect = "\n[[effect]]\nkind = \"ground_effect\"\nstrength = 3.0\nsource = \"this test\"\n";
    let vehicle = write(&dir, "grounded.toml", &format!("{own}{effect}"));
    let path = write(&dir, "path.csv", "t,x,y,z\n0,0,0,0.6\n5,0,0,0.6\n");
    let (mass, radius) = (0.0328, 0.02355);
    // A table whose top is at 0.5 m, and one far below.
    for (height, top) in [("0.45", 0.5), ("-3", -2.95)] {
        let line = format!(
            "--scene {} --drone {vehicle} --trajectory waypoints {path} --seconds 2 --fps 1",
            table(height)
        );
        let (_, data) = fly(&line, &dir.path().join(height));
        let states = data.world(0).unwrap().states(None).unwrap();
        for i in 100..states.n_rows() {
            let [force, thrust, z] = row(&states, ["az", "thrust", "pz"], i);
            let ratio: f64 = radius / (4.0 * (z - top));
            let gain = 1.0 / (1.0 - 3.0 * ratio * ratio);
            assert!(
                (mass * force / thrust - gain).abs() < 2e-3,
                "{height}, z = {z}: gain {}, not {gain}",
                mass * force / thrust
            );
            assert_eq!(gain > 1.01, height == "0.45", "{height}, z = {z}: gain {gain}");
        }
    }
}

#[test]
fn a_run_that_only_resumes_warns_as_the_one_that_flew() {
    let dir = folder();
    let scene = write(
        &dir,
        "inside.xml",
        r#"<mujoco><worldbody><geom name="block" type="box" size="1 1 1" pos="0 0 1"/></worldbody></mujoco>"#,
    );
    let line = format!("--scene {scene} --drone cf2x_L250 --trajectory hover --worlds 2 --seconds 0.05");
    let (first, _) = fly(&line, &dir.path().join("out"));
    let (again, _) = fly(&line, &dir.path().join("out"));
    assert!(first["warnings"].to_string().contains("2 worlds start with a drone in contact"), "{first}");
    assert_eq!(again["resumed_worlds"], 2);
    assert_eq!(first["warnings"], again["warnings"]);
}

#[test]
fn each_world_and_drone_flies_the_way_that_its_rows_of_the_file_name() {
    let dir = folder();
    let scene =
        write(&dir, "plain.xml", "<mujoco><worldbody><geom type='plane' size='0 0 1'/></worldbody></mujoco>");
    // World 1 has ways of its own for both drones, the others share one; drone 1 flies beside drone 0 there.
    let path = write(
        &dir,
        "paths.csv",
        "t,x,y,z,world,drone\n0,0,0,1,0,0\n1,1,0,1,0,0\n0,0,2,1,0,1\n1,1,2,1,0,1\n\
         0,5,0,1,1,0\n1,5,1,1,1,0\n0,7,0,1,1,1\n1,7,1,1,1,1\n",
    );
    let rest = "--drone cf2x_L250 --drones-per-world 2 --seconds 0.2 --fps 5 --size 4x4 --worlds 2";
    let (_, data) =
        fly(&format!("--scene {scene} {rest} --trajectory waypoints {path}"), &dir.path().join("out"));
    let start = |world: usize, drone: usize| {
        let states = data.world(world).unwrap().states(None).unwrap();
        row(&states, ["px", "py", "pz"], drone)
    };
    let at = [[0.0, 0.0, 1.0], [0.0, 2.0, 1.0], [5.0, 0.0, 1.0], [7.0, 0.0, 1.0]];
    for (i, expected) in at.into_iter().enumerate() {
        assert_eq!(start(i / 2, i % 2), expected);
    }
    assert_eq!(data.manifest().flight.trajectory["kind"], "tracks");
    assert!(data.dir().join("scene.mjb").is_file());
    data.verify().unwrap();
    // A file without a world for some, or with one for nobody, is refused.
    for (rows, words) in [
        ("t,x,y,z,world\n0,0,0,1,0\n1,0,0,2,0\n", "none for world 1"),
        (
            "t,x,y,z,world\n0,0,0,1,0\n1,0,0,2,0\n0,0,0,1,1\n1,0,0,2,1\n0,0,0,1,2\n1,0,0,2,2\n",
            "worlds 0 to 1",
        ),
        ("t,x,y,z,world\n0,0,0,1,0\n1,0,0,2,-1\n", "row 2, column world"),
        ("t,x,y,z,drone\n0,0,0,1,0\n1,0,0,2,0\n", "drone 1"),
        ("t,x,y,z,world\n0,0,0,1,0\n0,0,0,2,0\n0,0,0,1,1\n1,0,0,2,1\n", "world 0, waypoint 1"),
    ] {
        let path = write(&dir, "odd.csv", rows);
        let out =
            run(&format!("--scene {scene} {rest} --trajectory waypoints {path}"), &dir.path().join("no"));
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(!out.status.success() && said.contains(words), "{rows}: {said}");
    }
}

#[test]
fn a_scene_by_name_needs_no_checkout() {
    let dir = folder();
    let named =
        |line: &str, out: &str| command(line, Path::new(out)).current_dir(dir.path()).output().unwrap();
    let line = "--scene forest --drone cf2x_L250 --worlds 2 --seconds 0.1";
    let done = named(line, "set");
    assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
    let manifest: Value =
        serde_json::from_slice(&fs::read(dir.path().join("set/manifest.json")).unwrap()).unwrap();
    assert_eq!(manifest["config"]["scene"], serde_json::json!({ "files": ["forest"] }));
    let (_, file) = fly(&line.replace("forest", "xml/forest.xml"), &dir.path().join("file"));
    assert_eq!(manifest["scene"]["sha256"], file.manifest().scene.sha256.as_str());
    // It is flown again, and what was done is kept.
    let again = named("--config set/manifest.json", "again");
    assert_eq!(again.status.code(), Some(0), "{}", String::from_utf8_lossy(&again.stderr));
    let worlds = |set: &str| files(&dir.path().join(set).join(world_dir_name(1)));
    assert_eq!(worlds("set"), worlds("again"));
    let wrong = named("--scene forrest --drone cf2x_L250", "none");
    let words = String::from_utf8_lossy(&wrong.stderr).into_owned();
    assert_eq!(wrong.status.code(), Some(2));
    assert!(words.contains("did you mean 'forest'?") && words.contains("corridor, forest"), "{words}");
}
