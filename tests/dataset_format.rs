//! The data-set format: what is written is what is read, whole or not at all, the same bytes every time.

#[path = "common/tree.rs"]
mod tree;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use propwash::dataset::{
    self, BodyRecord, CameraRecord, ClearanceRow, ContactRow, Dataset, DatasetError, DepthPng, FlightRecord,
    FrameInput, Frames, GeomRecord, HeightMap, Manifest, Nearest, NoisyDepth, OVERVIEW_SIZE, Overview,
    Quarantine, Reference, SceneRecord, StateRow, Table, VehicleRecord, View, WorldReader, Writer, status,
};
use propwash::sense::{Caster, Collider, DepthKind};
use rayon::prelude::*;
use sha2::{Digest, Sha256};

const W: usize = 7;
const H: usize = 5;
const FRAMES: usize = 3;
const STATES: usize = 40;

fn vehicle(name: &str, n_rotors: usize) -> VehicleRecord {
    VehicleRecord {
        name: name.into(),
        dynamics: "first_principles".into(),
        shell: "cf2x".into(),
        sha256: "ab".repeat(32),
        n_rotors,
        rates_hz: BTreeMap::from([("state".into(), 100), ("attitude".into(), 500)]),
    }
}

fn manifest() -> Manifest {
    let camera = CameraRecord {
        name: "fpv".into(),
        width: W,
        height: H,
        kind: DepthKind::Range,
        near_m: 0.05,
        far_m: 20.0,
        caster: Some(Caster::Native),
        k: [[3.5, 0.0, 3.5], [0.0, 3.5, 2.5], [0.0, 0.0, 1.0]],
    };
    Manifest {
        mujoco_version: "3.17.0".into(),
        seed: u64::MAX,
        n_worlds: 4,
        n_drones: 2,
        seconds: 1.0,
        fps: 3.0,
        scene: SceneRecord { name: "xml/forest.xml".into(), sha256: "cd".repeat(32), mjb_sha256: None },
        vehicles: vec![vehicle("cf2x_L250", 4), vehicle("hexa", 6)],
        flight: FlightRecord {
            control_mode: "state".into(),
            integrator: "rk4".into(),
            sim_hz: 500,
            state_every_steps: 1,
            clearance_every_steps: 5,
            clearance_max_m: 5.0,
            contact_every_steps: 1,
            swept: true,
            collider: Some(Collider::Native),
            trajectory: serde_json::json!({"kind": "circle", "radius_m": 0.1 + 0.2}),
        },
        config: None,
        cameras: vec![camera.clone(), camera],
        sensors: Vec::new(),
        obstacles: Vec::new(),
        depth_png: DepthPng::default(),
        normals: true,
        noise: Some(serde_json::json!({"kind": "gaussian", "sigma_m": 0.01})),
        geoms: (0..4)
            .map(|id| GeomRecord { id, name: format!("g{id}"), kind: "box".into(), body: id })
            .collect(),
        bodies: (0..4).map(|id| BodyRecord { id, name: format!("b{id}"), drone: id - 2 }).collect(),
    }
}

/// A number in [0, 1) for (world, what, index), different for each.
fn number(world: usize, what: u64, i: usize) -> f64 {
    let mut x = (world as u64) << 48 ^ what << 32 ^ i as u64 ^ 0x9e37_79b9_7f4a_7c15;
    for _ in 0..3 {
        x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x ^= x >> 27;
    }
    (x >> 11) as f64 / (1u64 << 53) as f64
}

fn numbers<const N: usize>(world: usize, what: u64, i: usize) -> [f64; N] {
    std::array::from_fn(|k| number(world, what, i * 64 + k) - 0.5)
}

/// Depth, status, geom and normal of a pixel.
fn pixel(world: usize, frame: usize, drone: usize, i: usize) -> (f32, u8, i32, [f32; 3]) {
    let x = number(world, 100 + drone as u64, frame * 1000 + i);
    match i % 7 {
        0 => (f32::INFINITY, status::MISS, -1, [0.0; 3]),
        1 => (f32::INFINITY, status::TOO_FAR, 1, [0.0, 0.0, 1.0]),
        2 => (0.0, status::TOO_NEAR, 2, [1.0, 0.0, 0.0]),
        _ => ((0.05 + 19.9 * x) as f32, status::HIT, 3, [0.6, 0.0, 0.8]),
    }
}

struct Planes {
    depth: Vec<f32>,
    status: Vec<u8>,
    geom: Vec<i32>,
    normal: Vec<[f32; 3]>,
    noisy: Vec<f32>,
}

fn planes(world: usize, frame: usize, drone: usize) -> Planes {
    let all: Vec<_> = (0..W * H).map(|i| pixel(world, frame, drone, i)).collect();
    Planes {
        depth: all.iter().map(|p| p.0).collect(),
        status: all.iter().map(|p| p.1).collect(),
        geom: all.iter().map(|p| p.2).collect(),
        normal: all.iter().map(|p| p.3).collect(),
        noisy: all.iter().map(|p| p.0 * 1.01).collect(),
    }
}

fn view<'a>(manifest: &Manifest, world: usize, frame: usize, drone: usize, p: &'a Planes) -> View<'a> {
    View {
        depth_m: &p.depth,
        status: &p.status,
        geom_id: &p.geom,
        body_id: &p.geom,
        normal: manifest.normals.then_some(&p.normal),
        noisy: manifest.noise.is_some().then_some(NoisyDepth { depth_m: &p.noisy, status: &p.status }),
        pos_m: numbers(world, 1, frame * 10 + drone),
        quat_xyzw: numbers(world, 2, frame * 10 + drone),
        k: manifest.cameras[drone].k,
    }
}

fn reference(world: usize, i: usize) -> Reference {
    Reference {
        pos_m: numbers(world, 10, i),
        vel_m_s: numbers(world, 11, i),
        acc_m_s2: numbers(world, 12, i),
        yaw_rad: number(world, 13, i),
    }
}

/// Everything up to, not including, `finish`.
fn fill(writer: &Writer, world: usize) -> dataset::WorldWriter {
    let m = writer.manifest().clone();
    let mut w = writer.world(world).unwrap();
    for i in 0..STATES {
        for drone in 0..m.n_drones {
            let k = i * 2 + drone;
            let rotors: [f64; 6] = numbers(world, 20, k);
            let command: [f64; 16] = numbers(world, 21, k);
            w.state(&StateRow {
                t_s: i as f64 / 500.0,
                step: i as u64,
                drone,
                pos_m: numbers(world, 22, k),
                quat_xyzw: numbers(world, 23, k),
                vel_m_s: numbers(world, 24, k),
                ang_vel_rad_s: numbers(world, 25, k),
                specific_force_m_s2: (i > 0).then(|| numbers(world, 26, k)),
                rotor_rad_s: &rotors[..m.vehicles[drone].n_rotors],
                thrust_n: (drone == 0).then_some(number(world, 27, k)),
                command: &command,
                attitude_command: Some(numbers(world, 28, k)),
                rotor_command_rad_s: if i % 2 == 0 { &[] } else { &rotors[..m.vehicles[drone].n_rotors] },
                reference: (i % 3 != 0).then(|| reference(world, k)),
                battery_v: (drone == 1).then_some(number(world, 14, k)),
                wind_m_s: (i % 2 == 0).then(|| numbers(world, 15, k)),
            })
            .unwrap();
            w.clearance(&ClearanceRow {
                t_s: i as f64 / 500.0,
                step: i as u64,
                drone,
                nearest: (i % 4 != 0).then(|| Nearest {
                    distance_m: number(world, 30, k),
                    from_m: numbers(world, 31, k),
                    to_m: numbers(world, 32, k),
                    drone_geom: 1,
                    geom: 3,
                    body: 2,
                    other_drone: (i % 4 == 1).then_some(1 - drone),
                    exact: i % 4 == 2,
                }),
            })
            .unwrap();
        }
    }
    for i in 0..world {
        w.contact(&ContactRow {
            t_s: i as f64,
            step: i as u64,
            drone: i % 2,
            other_drone: (i == 1).then_some(0),
            geoms: [1, 3],
            bodies: [0, 2],
            other_flex: -1,
            distance_m: -0.25,
            point_m: numbers(world, 40, i),
            normal: [0.0, 0.0, 1.0],
            exact: true,
            swept_fraction: (i == 2).then_some(0.125),
        })
        .unwrap();
    }
    for frame in 0..FRAMES {
        let planes: Vec<Planes> = (0..m.n_drones).map(|d| planes(world, frame, d)).collect();
        let views: Vec<View> = planes.iter().enumerate().map(|(d, p)| view(&m, world, frame, d, p)).collect();
        w.frame(&FrameInput {
            t_s: frame as f64 / 3.0,
            step: frame as u64 * 166,
            views: &views,
            obstacles: (&[], &[]),
        })
        .unwrap();
    }
    w.set_info(serde_json::json!({"mass_kg": 0.03 + 0.01 * world as f64}));
    if world == 3 {
        w.quarantine(Quarantine { step: 7, drone: 1, reason: "position".into() });
    }
    w
}

fn write_all(dir: &Path, threads: usize) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let m = manifest();
        let (writer, done) = Dataset::create_or_resume(dir, &m).unwrap();
        let open: Vec<usize> = (0..m.n_worlds).filter(|w| !done[*w]).collect();
        open.into_par_iter().for_each(|world| {
            fill(&writer, world).finish().unwrap();
        });
        writer.finish().unwrap();
    });
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|v| v.to_bits()).collect()
}

/// What [`fill`] wrote as row `i` of a drone's states.
fn assert_state_row(states: &Table, world: usize, i: usize, drone: usize) {
    let k = i * 2 + drone;
    let column = |name: &str| states.column(name).unwrap();
    assert_eq!(column("t")[k], i as f64 / 500.0);
    assert_eq!(column("step")[k], i as f64);
    assert_eq!(column("world")[k], world as f64);
    assert_eq!(column("drone")[k], drone as f64);
    let check = |names: &[&str], expected: &[f64]| {
        let found: Vec<f64> = names.iter().map(|n| column(n)[k]).collect();
        assert_eq!(bits(&found), bits(expected), "{names:?} of row {k}");
    };
    // What was not given is empty.
    let check_where = |given: bool, names: &[&str], expected: &[f64]| {
        if given {
            return check(names, expected);
        }
        for name in names {
            assert!(column(name)[k].is_nan(), "{name} of row {k}");
        }
    };
    check(&["px", "py", "pz"], &numbers::<3>(world, 22, k));
    check(&["qx", "qy", "qz", "qw"], &numbers::<4>(world, 23, k));
    check(&["vx", "vy", "vz"], &numbers::<3>(world, 24, k));
    check(&["wx", "wy", "wz"], &numbers::<3>(world, 25, k));
    check_where(i > 0, &["ax", "ay", "az"], &numbers::<3>(world, 26, k));
    let rotors: [f64; 6] = numbers(world, 20, k);
    check(&["rotor1", "rotor2", "rotor3", "rotor4"], &rotors[..4]);
    check_where(drone == 1, &["rotor5", "rotor6"], &rotors[4..]);
    check_where(drone == 0, &["thrust"], &[number(world, 27, k)]);
    let command: [f64; 16] = numbers(world, 21, k);
    check(&["cmd_x", "cmd_y", "cmd_z", "cmd_vx", "cmd_vy", "cmd_vz"], &command[..6]);
    check(&["cmd_qx", "cmd_qy", "cmd_qz", "cmd_qw", "cmd_wx", "cmd_wy", "cmd_wz"], &command[9..]);
    check(&["cmd_roll", "cmd_pitch", "cmd_yaw", "cmd_thrust"], &numbers::<4>(world, 28, k));
    check_where(i % 2 == 1, &["cmd_rotor4"], &rotors[3..4]);
    let r = reference(world, k);
    let [x, y, z] = r.pos_m;
    let names = ["ref_x", "ref_y", "ref_z", "ref_vx", "ref_ax", "ref_yaw"];
    check_where(!i.is_multiple_of(3), &names, &[x, y, z, r.vel_m_s[0], r.acc_m_s2[0], r.yaw_rad]);
    check_where(drone == 1, &["vbat"], &[number(world, 14, k)]);
    check_where(i.is_multiple_of(2), &["wind_x", "wind_y", "wind_z"], &numbers::<3>(world, 15, k));
}

fn assert_clearance(reader: &WorldReader, world: usize) {
    let clearance = reader.clearance(None).unwrap();
    for k in 0..STATES * 2 {
        let (i, distance) = (k / 2, clearance.column("distance").unwrap()[k]);
        let geom = clearance.column("geom").unwrap()[k];
        if i % 4 == 0 {
            assert!(distance.is_nan());
            assert_eq!(geom, -1.0);
        } else {
            assert_eq!(distance, number(world, 30, k));
            assert_eq!(geom, 3.0);
            let of = |name: &str| clearance.column(name).unwrap()[k];
            assert_eq!((of("drone_geom"), of("body")), (1.0, 2.0));
            assert_eq!(of("other_drone"), if i % 4 == 1 { (1 - k % 2) as f64 } else { -1.0 });
            assert_eq!(of("exact"), f64::from(u8::from(i % 4 == 2)));
            assert_eq!(clearance.column("to_z").unwrap()[k], numbers::<3>(world, 32, k)[2]);
        }
    }
}

fn assert_contacts(reader: &WorldReader, world: usize) {
    let contacts = reader.contacts(None).unwrap();
    assert_eq!(contacts.n_rows(), world);
    let of = |name: &str| contacts.column(name).unwrap().to_vec();
    assert_eq!(of("other_drone"), [-1.0, 0.0, -1.0][..world]);
    assert_eq!(of("swept"), [0.0, 0.0, 1.0][..world]);
    assert_eq!(of("fraction").iter().filter(|f| **f == 0.125).count(), usize::from(world > 2));
    assert_eq!(of("geom2"), [3.0; 3][..world]);
    assert_eq!(of("distance"), [-0.25; 3][..world]);
}

/// The arrays of all frames, and their images as PNG.
fn assert_frames(reader: &WorldReader, world: usize) {
    let frames = reader.frames().unwrap();
    assert_eq!(frames.depth_m.shape(), [FRAMES, 2, H, W]);
    assert_eq!(frames.normal.as_ref().unwrap().shape(), [FRAMES, 2, H, W, 3]);
    for frame in 0..FRAMES {
        assert_eq!(frames.time_s[frame], frame as f64 / 3.0);
        assert_eq!(frames.step[frame], frame as i64 * 166);
        for drone in 0..2 {
            assert_arrays(&frames, world, frame, drone);
            assert_images(reader, world, frame, drone);
        }
    }
}

fn assert_arrays(frames: &Frames, world: usize, frame: usize, drone: usize) {
    let quat: [f64; 4] = numbers(world, 2, frame * 10 + drone);
    let p = planes(world, frame, drone);
    for c in 0..4 {
        assert_eq!(frames.camera_quat_xyzw[[frame, drone, c]], quat[c]);
    }
    for i in 0..W * H {
        let at = [frame, drone, i / W, i % W];
        assert_eq!(frames.depth_m[at].to_bits(), p.depth[i].to_bits());
        assert_eq!(frames.depth_noisy_m.as_ref().unwrap()[at].to_bits(), p.noisy[i].to_bits());
        assert_eq!(frames.status[at], p.status[i]);
        assert_eq!(frames.geom_id[at], p.geom[i]);
    }
}

fn assert_images(reader: &WorldReader, world: usize, frame: usize, drone: usize) {
    let p = planes(world, frame, drone);
    let image = reader.image(drone, frame, false).unwrap();
    let noisy = reader.image(drone, frame, true).unwrap();
    for i in 0..W * H {
        let expected = match i % 7 {
            0 => 0,
            1 => 65_535,
            2 => 65_534,
            _ => (f64::from(p.depth[i]) / 0.001).round_ties_even() as u16,
        };
        assert_eq!(image[i], expected);
        let (depth, code) = dataset::decode(image[i], 0.001);
        assert_eq!(code, p.status[i]);
        if code == status::HIT {
            assert!((depth - p.depth[i]).abs() <= 0.000_502);
            assert_eq!(noisy[i], (f64::from(p.noisy[i]) / 0.001).round_ties_even() as u16);
        }
    }
}

#[test]
fn what_is_written_is_read_back_bit_for_bit() {
    let dir = tempfile::tempdir().unwrap();
    write_all(dir.path(), 2);
    let data = Dataset::open(dir.path()).unwrap();
    assert_eq!(data.manifest(), &manifest());
    assert!(data.is_complete());
    data.verify().unwrap();
    assert_eq!(data.worlds(), [0, 1, 2, 3]);
    for world in 0..4 {
        let reader = data.world(world).unwrap();
        let states = reader.states(None).unwrap();
        assert_eq!(states.n_rows(), STATES * 2);
        for i in 0..STATES {
            for drone in 0..2 {
                assert_state_row(&states, world, i, drone);
            }
        }
        assert_clearance(&reader, world);
        assert_contacts(&reader, world);
        assert_frames(&reader, world);
        let record = reader.record();
        assert_eq!(record.info["mass_kg"], 0.03 + 0.01 * world as f64);
        assert_eq!(record.quarantine.is_some(), world == 3);
    }
}

#[test]
fn the_bytes_are_the_same_for_any_thread_count_and_after_an_interruption() {
    let (one, four, cut) =
        (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    write_all(one.path(), 1);
    write_all(four.path(), 4);
    // A run that is killed in world 1, with world 2 finished: nothing is cleaned up.
    {
        let (writer, done) = Dataset::create_or_resume(cut.path(), &manifest()).unwrap();
        assert_eq!(done, [false; 4]);
        fill(&writer, 2).finish().unwrap();
        std::mem::forget(fill(&writer, 1));
        assert!(cut.path().join(".partial_world_00001/depth/drone0_000002.png").is_file());
        let early = Dataset::open(cut.path()).unwrap();
        assert_eq!(early.worlds(), [2]);
        assert!(!early.is_complete());
        assert!(matches!(early.verify(), Err(DatasetError::Incomplete { missing: 3, first: 0, .. })));
        assert!(matches!(writer.finish(), Err(DatasetError::Incomplete { missing: 3, first: 0, .. })));
        // A real kill frees the lock; a forgotten writer does not, so a copy stands in for the folder after the kill.
    }
    let after = tempfile::tempdir().unwrap();
    for (path, bytes) in tree::files(cut.path()) {
        let to = after.path().join(path);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::write(to, bytes).unwrap();
    }
    let (writer, done) = Dataset::create_or_resume(after.path(), &manifest()).unwrap();
    assert_eq!(done, [false, false, true, false]);
    assert!(writer.warnings().is_empty());
    assert!(!after.path().join(".partial_world_00001").exists());
    drop(writer);
    write_all(after.path(), 3);

    let expected = tree::files(one.path());
    assert!(expected.len() > 4 * FRAMES * 2 * 2);
    for other in [four.path(), after.path()] {
        let found = tree::files(other);
        assert_eq!(found.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>());
        for (path, bytes) in &found {
            assert!(bytes == &expected[path], "{} differs", path.display());
        }
    }
    // A run over a finished data set changes nothing.
    write_all(one.path(), 2);
    assert!(tree::files(one.path()) == expected);
}

#[test]
fn a_world_that_is_dropped_unfinished_leaves_nothing_and_can_be_started_again() {
    let dir = tempfile::tempdir().unwrap();
    let (writer, _) = Dataset::create_or_resume(dir.path(), &manifest()).unwrap();
    drop(fill(&writer, 1));
    let names: Vec<_> = fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names, ["manifest.json"]);
    let open = fill(&writer, 1);
    assert!(matches!(writer.world(1), Err(DatasetError::World { world: 1, .. })), "open twice");
    open.finish().unwrap();
    assert!(matches!(writer.world(1), Err(DatasetError::World { world: 1, .. })), "there already");
    assert!(matches!(writer.world(4), Err(DatasetError::World { world: 4, .. })), "out of range");
}

#[test]
fn a_damaged_world_is_named_and_made_anew() {
    let dir = tempfile::tempdir().unwrap();
    write_all(dir.path(), 2);
    let expected = tree::files(dir.path());
    let victim = dir.path().join("world_00002/depth/drone1_000001.png");
    let mut bytes = fs::read(&victim).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&victim, bytes).unwrap();
    let error = Dataset::open(dir.path()).unwrap().verify().unwrap_err().to_string();
    assert!(error.contains("drone1_000001.png") && error.contains("sha256"), "{error}");

    let (writer, done) = Dataset::create_or_resume(dir.path(), &manifest()).unwrap();
    assert_eq!(done, [true, true, false, true]);
    assert!(writer.warnings()[0].contains("world 2 was damaged"), "{:?}", writer.warnings());
    assert!(!dir.path().join("complete.json").exists(), "the seal went with the world");
    drop(writer);
    write_all(dir.path(), 2);
    assert!(tree::files(dir.path()) == expected);
}

/// A file of a world and its hash in `world.json`, changed together.
fn forge(world: &Path, path: &str) {
    let old: String = sha256(&fs::read(world.join(path)).unwrap());
    let mut bytes = fs::read(world.join(path)).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(world.join(path), &bytes).unwrap();
    let list = fs::read_to_string(world.join("world.json")).unwrap();
    fs::write(world.join("world.json"), list.replace(&old, &sha256(&bytes))).unwrap();
}

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

/// What the program says of a data set, and its exit code.
fn verified(dir: &Path) -> (Option<i32>, String) {
    let out = std::process::Command::new(env!("CARGO_BIN_EXE_propwash"))
        .args(["dataset", "verify"])
        .arg(dir)
        .output()
        .unwrap();
    (out.status.code(), String::from_utf8([out.stdout, out.stderr].concat()).unwrap())
}

#[test]
fn a_world_whose_list_was_changed_too_is_not_sealed_again() {
    let dir = tempfile::tempdir().unwrap();
    write_all(dir.path(), 2);
    assert_eq!(verified(dir.path()).0, Some(0));
    let expected = tree::files(dir.path());
    forge(&dir.path().join("world_00001"), "states.parquet");
    let set = Dataset::open(dir.path()).unwrap();
    for error in [set.verify().unwrap_err(), set.world(1).map(|_| ()).unwrap_err()] {
        let said = error.to_string();
        assert!(said.contains("world_00001/world.json") && said.contains("from complete.json"), "{said}");
    }
    let (writer, done) = Dataset::create_or_resume(dir.path(), &manifest()).unwrap();
    assert_eq!(done, [true, false, true, true]);
    assert!(writer.warnings()[0].contains("world 1 was damaged"), "{:?}", writer.warnings());
    drop(writer);
    write_all(dir.path(), 2);
    assert!(tree::files(dir.path()) == expected);
    // A seal that cannot be read is made anew, and said.
    fs::write(dir.path().join("complete.json"), "{}").unwrap();
    let (writer, done) = Dataset::create_or_resume(dir.path(), &manifest()).unwrap();
    assert_eq!(done, [true; 4]);
    assert!(writer.warnings()[0].contains("the seal was damaged"), "{:?}", writer.warnings());
}

#[test]
fn a_damaged_table_is_refused_by_everything_that_reads_it() {
    let dir = tempfile::tempdir().unwrap();
    write_all(dir.path(), 2);
    let world = dir.path().join("world_00000");
    for (path, n) in [("states.parquet", 700), ("frames.npz", 900), ("depth/drone0_000000.png", 60)] {
        let whole = fs::read(world.join(path)).unwrap();
        let mut bytes = whole.clone();
        bytes[n] ^= 1;
        fs::write(world.join(path), bytes).unwrap();
        let set = Dataset::open(dir.path()).unwrap();
        let reader = set.world(0).unwrap();
        let said = match path {
            "states.parquet" => reader.flight_log(0).unwrap_err(),
            "frames.npz" => reader.frames().unwrap_err(),
            _ => reader.image(0, 0, false).unwrap_err(),
        };
        assert!(said.to_string().contains(path) && said.to_string().contains("expected sha256"), "{said}");
        fs::write(world.join(path), whole).unwrap();
    }
    assert!(Dataset::open(dir.path()).unwrap().world(0).unwrap().flight_log(0).is_ok());
}

#[test]
fn files_and_worlds_that_no_list_names_and_paths_that_lead_out_are_found() {
    let dir = tempfile::tempdir().unwrap();
    write_all(dir.path(), 2);
    for extra in ["world_00000/notes.txt", "world_00003/depth/more.png", "world_00004/world.json", "world_x"]
    {
        let path = dir.path().join(extra);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, "x").unwrap();
        let (code, said) = verified(dir.path());
        let named = if extra.starts_with("world_00004") { "world_00004: expected 4 worlds" } else { extra };
        assert!(code == Some(1) && said.contains(named) && said.lines().count() == 1, "{extra}: {said}");
        fs::remove_file(&path).unwrap();
        let _ = fs::remove_dir(path.parent().unwrap());
    }
    assert_eq!(verified(dir.path()).0, Some(0));
    // A note beside the worlds harms nothing.
    fs::write(dir.path().join("README.txt"), "x").unwrap();
    assert_eq!(verified(dir.path()).0, Some(0));
    fs::remove_file(dir.path().join("complete.json")).unwrap();
    let list = dir.path().join("world_00002/world.json");
    let text = fs::read_to_string(&list).unwrap();
    for path in ["../../../etc/passwd", "/etc/passwd", "", "./states.parquet"] {
        fs::write(&list, text.replace("\"states.parquet\"", &format!("{path:?}"))).unwrap();
        let said = Dataset::open(dir.path()).unwrap().world(2).map(|_| ()).unwrap_err().to_string();
        assert!(said.contains("paths inside the world's folder") && said.contains(path), "{said}");
        assert!(verified(dir.path()).1.contains("paths inside the world's folder"));
    }
    let (code, said) = verified(&dir.path().join("world_00000"));
    assert!(code == Some(2) && said.contains("without manifest.json"), "{said}");
}

#[test]
fn what_looks_like_ours_in_a_folder_that_is_no_data_set_stays() {
    let dir = tempfile::tempdir().unwrap();
    let mine = dir.path().join(".partial_world_00000");
    fs::create_dir(&mine).unwrap();
    fs::write(mine.join("thesis.tex"), "x").unwrap();
    let error = dataset::create_or_resume(dir.path(), &manifest()).map(|_| ()).unwrap_err();
    assert!(error.to_string().contains(".partial_world_00000"), "{error}");
    assert!(mine.join("thesis.tex").is_file());
    fs::remove_dir_all(&mine).unwrap();
    // All that a start can leave before there is a manifest.
    fs::write(dir.path().join(".partial_manifest.json.123"), "{").unwrap();
    dataset::create_or_resume(dir.path(), &manifest()).unwrap();
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
}

#[test]
fn other_settings_are_refused_and_the_message_names_them() {
    let dir = tempfile::tempdir().unwrap();
    write_all(dir.path(), 2);
    let before = tree::files(dir.path());
    let mut other = manifest();
    other.seed = 5;
    other.cameras[1].far_m = 30.0;
    other.geoms.pop();
    let error = dataset::create_or_resume(dir.path(), &other).map(|_| ()).unwrap_err();
    assert!(matches!(error, DatasetError::ManifestMismatch { .. }));
    let text = error.to_string();
    for part in [
        "seed: the folder has 18446744073709551615, asked for 5",
        "cameras[1].far_m: the folder has 20.0, asked for 30.0",
        "geoms: the folder has 4 entries, asked for 3 entries",
        "--out",
        "delete",
    ] {
        assert!(text.contains(part), "\"{part}\" is not in: {text}");
    }
    assert_eq!(text.matches("the folder has").count(), 3, "{text}");
    assert!(tree::files(dir.path()) == before, "nothing was touched");
}

#[test]
fn foreign_folders_and_formats_are_refused_and_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("thesis.tex"), "x").unwrap();
    let error = dataset::create_or_resume(dir.path(), &manifest()).map(|_| ()).unwrap_err();
    assert!(
        matches!(&error, DatasetError::NotADataset { found, .. } if found.contains("thesis.tex")),
        "{error}"
    );
    assert!(Dataset::open(dir.path()).unwrap_err().to_string().contains("without manifest.json"));
    assert!(Dataset::open(&dir.path().join("none")).unwrap_err().to_string().contains("no folder"));
    assert_eq!(tree::files(dir.path()).len(), 1);

    for (text, expected) in [
        ("{\"format\": \"other\", \"format_version\": 1}", "found format \"other\""),
        ("{\"format\": \"propwash-dataset\", \"format_version\": 2}", "version 2"),
        ("{\"format\": ", "no JSON"),
        ("[]", "no object"),
        ("{\"format\": \"propwash-dataset\", \"format_version\": 1}", "missing field"),
    ] {
        fs::write(dir.path().join("manifest.json"), text).unwrap();
        for error in [
            Dataset::open(dir.path()).map(|_| ()).unwrap_err(),
            dataset::create_or_resume(dir.path(), &manifest()).map(|_| ()).unwrap_err(),
        ] {
            assert!(error.to_string().contains(expected), "{error}");
        }
    }
}

/// Data sets of versions that did not say who cast their rays and found their contacts are read, and not taken for ones that do.
#[test]
fn a_manifest_names_its_caster_and_collider_and_older_ones_without_them_are_read() {
    let dir = tempfile::tempdir().unwrap();
    drop(dataset::create_or_resume(dir.path(), &manifest()).unwrap());
    let path = dir.path().join("manifest.json");
    let text = fs::read_to_string(&path).unwrap();
    assert_eq!(text.matches("\"caster\": \"native\"").count(), 2, "{text}");
    assert_eq!(text.matches("\"collider\": \"native\"").count(), 1, "{text}");
    let unsaid = |l: &&str| !l.contains("\"caster\"") && !l.contains("\"collider\"");
    let older: String = text.lines().filter(unsaid).flat_map(|l| [l, "\n"]).collect();
    fs::write(&path, &older).unwrap();
    let data = Dataset::open(dir.path()).unwrap();
    assert!(data.manifest().cameras.iter().all(|c| c.caster.is_none()));
    let mut unsaid = manifest();
    assert!(data.manifest().flight.collider.is_none());
    unsaid.flight.collider = None;
    for camera in &mut unsaid.cameras {
        camera.caster = None;
    }
    assert_eq!(data.manifest(), &unsaid);
    assert_eq!(unsaid.to_json().unwrap(), older, "it is written as it was");
    let error = dataset::create_or_resume(dir.path(), &manifest()).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("the folder has nothing, asked for \"native\""), "{error}");
}

#[test]
fn two_writers_of_one_folder_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (first, _) = dataset::create_or_resume(dir.path(), &manifest()).unwrap();
    let second = dataset::create_or_resume(dir.path(), &manifest());
    assert!(matches!(second, Err(DatasetError::Busy { .. })));
    drop(first);
    dataset::create_or_resume(dir.path(), &manifest()).unwrap();
}

#[test]
fn cut_files_are_errors_that_name_the_file() {
    let dir = tempfile::tempdir().unwrap();
    write_all(dir.path(), 2);
    for name in
        ["states.parquet", "contacts.parquet", "clearance.parquet", "frames.npz", "depth/drone0_000000.png"]
    {
        let path = dir.path().join("world_00001").join(name);
        let whole = fs::read(&path).unwrap();
        for keep in [0, 10, whole.len() / 2, whole.len() - 1] {
            fs::write(&path, &whole[..keep]).unwrap();
            let data = Dataset::open(dir.path()).unwrap();
            let world = data.world(1).unwrap();
            let read = match name {
                "states.parquet" => world.states(None).map(|_| ()),
                "contacts.parquet" => world.contacts(None).map(|_| ()),
                "clearance.parquet" => world.clearance(None).map(|_| ()),
                "frames.npz" => world.frames().map(|_| ()),
                // A PNG whose last checksum alone is cut may still decode; the hash below finds it.
                _ if keep == whole.len() - 1 => data.verify(),
                _ => world.image(0, 0, false).map(|_| ()),
            };
            let error = read.unwrap_err().to_string();
            let last = name.rsplit('/').next().unwrap();
            assert!(error.contains(last), "{name} cut to {keep}: {error}");
            assert!(data.verify().is_err(), "{name} cut to {keep}");
        }
        fs::write(&path, &whole).unwrap();
    }
    let data = Dataset::open(dir.path()).unwrap();
    data.verify().unwrap();
    let error = data.world(1).unwrap().states(Some(&["t", "pq"])).unwrap_err().to_string();
    assert!(error.contains("\"pq\"") && error.contains("ref_yaw"), "{error}");
    fs::remove_dir_all(dir.path().join("world_00001")).unwrap();
    assert!(data.verify().is_err());
    assert!(matches!(data.world(1), Err(DatasetError::Incomplete { first: 1, missing: 1, .. })));
}

#[test]
fn pixel_codes_are_those_of_the_format() {
    assert_eq!(dataset::encode(f32::INFINITY, status::MISS, 0.001), Some(0));
    assert_eq!(dataset::encode(f32::INFINITY, status::TOO_FAR, 0.001), Some(65_535));
    assert_eq!(dataset::encode(0.0, status::TOO_NEAR, 0.001), Some(65_534));
    assert_eq!(dataset::encode(1.2346, status::HIT, 0.001), Some(1235));
    assert_eq!(dataset::encode(65.533, status::HIT, 0.001), Some(65_533));
    // No hit takes a code's value, and none is clamped.
    for depth in [65.534, 65.535, 1e9, f32::INFINITY, f32::NAN, 0.0, -1.0, 0.0004] {
        assert_eq!(dataset::encode(depth, status::HIT, 0.001), None, "{depth}");
    }
    assert_eq!(dataset::encode(1.0, 4, 0.001), None);
    for value in 0..=u16::MAX {
        let (depth, code) = dataset::decode(value, 0.002);
        assert_eq!(dataset::encode(depth, code, 0.002), Some(value));
    }
}

#[test]
fn a_range_that_sixteen_bits_cannot_hold_is_refused_at_the_start() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let try_with = |near_m: f64, far_m: f64, unit: f64| {
        let mut m = manifest();
        m.cameras[1].near_m = near_m;
        m.cameras[1].far_m = far_m;
        m.depth_png = DepthPng::new(unit);
        m.to_json()
    };
    try_with(0.001, 65.533, 0.001).unwrap();
    for (near_m, far_m, unit) in [
        (0.05, 65.534, 0.001),
        (0.05, 200.0, 0.002),
        (0.0, 20.0, 0.001),
        (0.05, f64::INFINITY, 0.001),
        (0.05, 20.0, 0.0),
    ] {
        let error = try_with(near_m, far_m, unit).unwrap_err();
        assert!(matches!(error, DatasetError::Manifest { .. }), "{error}");
    }
    let text = try_with(0.05, 100.0, 0.001).unwrap_err().to_string();
    assert!(text.contains("cameras[1]") && text.contains("65.533 m") && text.contains("100 m"), "{text}");
    let mut m = manifest();
    m.cameras[0].far_m = 100.0;
    dataset::create_or_resume(&out, &m).map(|_| ()).unwrap_err();
    assert!(!out.exists(), "nothing is made before the manifest is sound");
    m = manifest();
    m.flight.trajectory = serde_json::json!({"radius_m": f64::NAN});
    let text = m.to_json().unwrap_err().to_string();
    assert!(text.contains("flight.trajectory.radius_m"), "{text}");
}

#[test]
fn rows_and_frames_that_break_the_manifest_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (writer, _) = dataset::create_or_resume(dir.path(), &manifest()).unwrap();
    let m = manifest();
    let mut w = writer.world(0).unwrap();
    let good = StateRow {
        t_s: 0.0,
        step: 0,
        drone: 0,
        pos_m: [0.0; 3],
        quat_xyzw: [0.0, 0.0, 0.0, 1.0],
        vel_m_s: [0.0; 3],
        ang_vel_rad_s: [0.0; 3],
        specific_force_m_s2: None,
        rotor_rad_s: &[],
        thrust_n: None,
        command: &[0.0; 16],
        attitude_command: None,
        rotor_command_rad_s: &[],
        reference: None,
        battery_v: None,
        wind_m_s: None,
    };
    w.state(&good).unwrap();
    for bad in [
        StateRow { drone: 2, ..good },
        StateRow { t_s: f64::NAN, ..good },
        StateRow { command: &[0.0; 4], ..good },
        StateRow { rotor_rad_s: &[1.0; 6], ..good },
        StateRow { rotor_command_rad_s: &[1.0; 3], ..good },
    ] {
        assert!(matches!(w.state(&bad), Err(DatasetError::Input { world: 0, .. })), "{bad:?}");
    }

    let both = [planes(0, 0, 0), planes(0, 0, 1)];
    let views = [view(&m, 0, 0, 0, &both[0]), view(&m, 0, 0, 1, &both[1])];
    let frame = FrameInput { t_s: 0.0, step: 0, views: &views, obstacles: (&[], &[]) };
    let mut far = both[1].depth.clone();
    far[4] = 70.0;
    let mut wrong_k = views[1];
    wrong_k.k[0][0] += 1e-9;
    let unknown = vec![4; W * H];
    for (bad, expected) in [
        (View { depth_m: &far, ..views[1] }, "row 0, column 4"),
        (View { status: &both[1].status[1..], ..views[1] }, "35 pixels (7x5)"),
        (View { normal: None, ..views[1] }, "normals true"),
        (View { noisy: None, ..views[1] }, "noisy depth true"),
        (View { geom_id: &unknown, ..views[1] }, "-1 to 3"),
        (View { pos_m: [f64::NAN, 0.0, 0.0], ..views[1] }, "pose"),
        (wrong_k, "K"),
    ] {
        let error = w.frame(&FrameInput { views: &[views[0], bad], ..frame }).unwrap_err().to_string();
        assert!(error.contains(expected) && error.contains("drone 1"), "{error}");
    }
    assert!(w.frame(&FrameInput { views: &views[..1], ..frame }).is_err());
    w.frame(&frame).unwrap();
    assert!(w.frame(&frame).is_err(), "time must advance");

    let nearest = Nearest {
        distance_m: 1.0,
        from_m: [0.0; 3],
        to_m: [0.0; 3],
        drone_geom: 0,
        geom: 4,
        body: 0,
        other_drone: None,
        exact: true,
    };
    let row = ClearanceRow { t_s: 0.0, step: 0, drone: 0, nearest: Some(nearest) };
    assert!(w.clearance(&row).is_err());
    let record = w.finish().unwrap();
    assert_eq!((record.n_states, record.n_frames, record.n_clearances), (1, 1, 0));
    let images = record.files.iter().filter(|f| f.path.ends_with(".png")).count();
    assert_eq!(images, 4, "each image once: two drones, exact and noisy");
    // The refused frame left nothing in the arrays.
    let frames = Dataset::open(dir.path()).unwrap().world(0).unwrap().frames().unwrap();
    assert_eq!(frames.depth_m.shape(), [1, 2, H, W]);
    assert_eq!(frames.depth_m[[0, 1, 0, 3]], both[1].depth[3]);
}

#[test]
fn each_control_mode_has_its_command_columns() {
    for (mode, names, values) in [
        ("attitude", vec!["cmd_roll", "cmd_pitch", "cmd_yaw", "cmd_thrust"], vec![1.0, 2.0, 3.0, 4.0]),
        ("body_rate", vec!["cmd_wx", "cmd_wy", "cmd_wz", "cmd_thrust"], vec![1.0, 2.0, 3.0, 4.0]),
        ("force_torque", vec!["cmd_thrust", "cmd_tx", "cmd_ty", "cmd_tz"], vec![1.0, 2.0, 3.0, 4.0]),
        ("rotor_vel", vec!["cmd_rotor1", "cmd_rotor2", "cmd_rotor3", "cmd_rotor4"], vec![1.0, 2.0, 3.0, 4.0]),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let mut m = manifest();
        (m.n_worlds, m.n_drones, m.fps) = (1, 1, 0.0);
        m.vehicles.truncate(1);
        (m.cameras, m.noise, m.normals) = (vec![], None, false);
        m.flight.clearance_every_steps = 0;
        m.flight.control_mode = mode.into();
        let (writer, _) = dataset::create_or_resume(dir.path(), &m).unwrap();
        let mut w = writer.world(0).unwrap();
        let row = StateRow {
            t_s: 0.5,
            step: 1,
            drone: 0,
            pos_m: [0.0; 3],
            quat_xyzw: [0.0, 0.0, 0.0, 1.0],
            vel_m_s: [0.0; 3],
            ang_vel_rad_s: [0.0; 3],
            specific_force_m_s2: None,
            rotor_rad_s: &[],
            thrust_n: None,
            command: &values,
            attitude_command: None,
            rotor_command_rad_s: &[],
            reference: None,
            battery_v: None,
            wind_m_s: None,
        };
        w.state(&row).unwrap();
        match mode {
            "attitude" => assert!(w.state(&StateRow { attitude_command: Some([0.0; 4]), ..row }).is_err()),
            "rotor_vel" => assert!(w.state(&StateRow { rotor_command_rad_s: &[0.0; 4], ..row }).is_err()),
            _ => {}
        }
        w.finish().unwrap();
        writer.finish().unwrap();
        let data = Dataset::open(dir.path()).unwrap();
        let states = data.world(0).unwrap().states(Some(&names)).unwrap();
        let found: Vec<f64> = names.iter().map(|n| states.column(n).unwrap()[0]).collect();
        assert_eq!(found, values, "{mode}");
        assert!(!dir.path().join("world_00000/frames.npz").exists());
        assert!(!dir.path().join("world_00000/clearance.parquet").exists());
    }
}

#[test]
fn a_table_longer_than_a_row_group_keeps_all_rows_in_order() {
    let dir = tempfile::tempdir().unwrap();
    let mut m = manifest();
    m.n_worlds = 1;
    let (writer, _) = dataset::create_or_resume(dir.path(), &m).unwrap();
    let mut w = writer.world(0).unwrap();
    let n = 40_000;
    for i in 0..n {
        let nearest = Nearest {
            distance_m: i as f64,
            from_m: [0.0; 3],
            to_m: [0.0; 3],
            drone_geom: 0,
            geom: 0,
            body: 0,
            other_drone: None,
            exact: true,
        };
        let nearest = (i % 5 != 0).then_some(nearest);
        w.clearance(&ClearanceRow { t_s: i as f64, step: i, drone: 0, nearest }).unwrap();
    }
    assert_eq!(w.finish().unwrap().n_clearances, n);
    let table =
        Dataset::open(dir.path()).unwrap().world(0).unwrap().clearance(Some(&["t", "distance"])).unwrap();
    for i in 0..n as usize {
        assert_eq!(table.column("t").unwrap()[i], i as f64);
        let d = table.column("distance").unwrap()[i];
        assert!(if i % 5 == 0 { d.is_nan() } else { d == i as f64 });
    }
    assert_eq!(table.names().collect::<Vec<_>>(), ["distance", "t"]);
}

/// A plain of trunks, in closed form: (x, y, radius) of each, 6 m tall.
fn trunks() -> Vec<[f64; 3]> {
    let mut all = Vec::new();
    for i in 0..70 {
        let [x, y, r] = [number(9, 50, i), number(9, 51, i), number(9, 52, i)];
        all.push([x * 20.0 - 10.0, y * 16.0 - 8.0, 0.12 + 0.25 * r]);
    }
    all
}

const TALL_M: f64 = 6.0;

/// Range, status and geom of a ray.
fn cast(from: [f64; 3], ray: [f64; 3], far_m: f64) -> (f32, u8, i32) {
    let mut best = (f64::INFINITY, -1);
    if ray[2] < 0.0 {
        best = (-from[2] / ray[2], 0);
    }
    for (i, [x, y, r]) in trunks().into_iter().enumerate() {
        let (dx, dy) = (from[0] - x, from[1] - y);
        let a = ray[0] * ray[0] + ray[1] * ray[1];
        let b = dx * ray[0] + dy * ray[1];
        let root = b * b - a * (dx * dx + dy * dy - r * r);
        if root > 0.0 {
            let t = (-b - root.sqrt()) / a;
            if t > 0.0 && t < best.0 && (0.0..TALL_M).contains(&(from[2] + t * ray[2])) {
                best = (t, i as i32 + 1);
            }
        }
    }
    match best.0 {
        t if t == f64::INFINITY => (f32::INFINITY, status::MISS, -1),
        t if t > far_m => (f32::INFINITY, status::TOO_FAR, best.1),
        t if t < 0.2 => (0.0, status::TOO_NEAR, best.1),
        t => (t as f32, status::HIT, best.1),
    }
}

/// Size of the images among the trunks, and how far they see, m.
const FOREST_W: usize = 64;
const FOREST_H: usize = 48;
const FOREST_FAR_M: f64 = 15.0;
/// Length of a flight among them, s, and frames in a second.
const FOREST_S: u64 = 6;
const FOREST_FPS: u64 = 4;
/// Radius of a drone there, m.
const FOREST_DRONE_M: f64 = 0.08;

/// The geom of the drone there: geom 0 is the floor, and those of the trunks follow.
fn drone_geom() -> i32 {
    trunks().len() as i32 + 1
}

/// Intrinsics of the camera there.
fn forest_k() -> [[f64; 3]; 3] {
    let (cx, cy) = (FOREST_W as f64 / 2.0, FOREST_H as f64 / 2.0);
    [[cx, 0.0, cx], [0.0, cx, cy], [0.0, 0.0, 1.0]]
}

fn forest_manifest(n: usize) -> Manifest {
    let mut m = manifest();
    (m.n_worlds, m.n_drones, m.seconds, m.fps, m.seed) = (n, 1, FOREST_S as f64, FOREST_FPS as f64, 7);
    (m.normals, m.noise) = (false, None);
    m.vehicles.truncate(1);
    m.cameras.truncate(1);
    let camera = &mut m.cameras[0];
    (camera.width, camera.height, camera.near_m, camera.far_m) = (FOREST_W, FOREST_H, 0.2, FOREST_FAR_M);
    camera.k = forest_k();
    m.flight.trajectory = serde_json::json!({"kind": "lissajous"});
    let own = drone_geom();
    let kind = |id| if id == 0 { "plane" } else { "cylinder" };
    m.geoms =
        (0..=own).map(|id| GeomRecord { id, name: String::new(), kind: kind(id).into(), body: id }).collect();
    m.bodies =
        (0..=own).map(|id| BodyRecord { id, name: String::new(), drone: -i32::from(id != own) }).collect();
    m
}

/// A level drone without commands.
fn bare_state(t_s: f64, step: u64, pos_m: [f64; 3], vel_m_s: [f64; 3]) -> StateRow<'static> {
    StateRow {
        t_s,
        step,
        drone: 0,
        pos_m,
        quat_xyzw: [0.0, 0.0, 0.0, 1.0],
        vel_m_s,
        ang_vel_rad_s: [0.0; 3],
        specific_force_m_s2: None,
        rotor_rad_s: &[],
        thrust_n: None,
        command: &[0.0; 16],
        attitude_command: None,
        rotor_command_rad_s: &[],
        reference: None,
        battery_v: None,
        wind_m_s: None,
    }
}

/// The trunk next to a drone at `pos`.
fn nearest_trunk(trunks: &[[f64; 3]], pos: [f64; 3]) -> Nearest {
    let gap = |trunk: &[f64; 3]| (pos[0] - trunk[0]).hypot(pos[1] - trunk[1]) - trunk[2] - FOREST_DRONE_M;
    let (nearest, distance_m) = trunks
        .iter()
        .enumerate()
        .map(|(i, trunk)| (i + 1, gap(trunk)))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .unwrap();
    let id = nearest as i32;
    let toward = (trunks[nearest - 1][1] - pos[1]).atan2(trunks[nearest - 1][0] - pos[0]);
    let along = |r: f64| [pos[0] + r * toward.cos(), pos[1] + r * toward.sin(), pos[2]];
    Nearest {
        distance_m,
        from_m: along(FOREST_DRONE_M),
        to_m: along(FOREST_DRONE_M + distance_m),
        drone_geom: drone_geom(),
        geom: id,
        body: id,
        other_drone: None,
        exact: true,
    }
}

/// What a camera at `pos` that looks level to the yaw `yaw` sees, as one frame.
fn forest_frame(out: &mut dataset::WorldWriter, t_s: f64, step: u64, pos: [f64; 3], yaw: f64) {
    let (cx, cy) = (FOREST_W as f64 / 2.0, FOREST_H as f64 / 2.0);
    let pixels: Vec<_> = (0..FOREST_W * FOREST_H)
        .map(|i| {
            let right = (i % FOREST_W) as f64 + 0.5 - cx;
            let down = (i / FOREST_W) as f64 + 0.5 - cy;
            let length = (right * right + down * down + cx * cx).sqrt();
            let (f, r, d) = (cx / length, right / length, down / length);
            let ray = [f * yaw.cos() + r * yaw.sin(), f * yaw.sin() - r * yaw.cos(), -d];
            cast(pos, ray, FOREST_FAR_M)
        })
        .collect();
    let depth: Vec<f32> = pixels.iter().map(|p| p.0).collect();
    let codes: Vec<u8> = pixels.iter().map(|p| p.1).collect();
    let geoms: Vec<i32> = pixels.iter().map(|p| p.2).collect();
    // A camera that looks along x, turned by yaw.
    let (sin, cos) = (0.5 * yaw).sin_cos();
    let view = View {
        depth_m: &depth,
        status: &codes,
        geom_id: &geoms,
        body_id: &geoms,
        normal: None,
        noisy: None,
        pos_m: pos,
        quat_xyzw: [0.5 * (cos + sin), 0.5 * (sin - cos), 0.5 * (sin - cos), 0.5 * (cos + sin)],
        k: forest_k(),
    };
    out.frame(&FrameInput { t_s, step, views: &[view], obstacles: (&[], &[]) }).unwrap();
}

/// One world: a drone on a figure of eight among the trunks. Returns how often it began to touch one.
fn fly_through(writer: &Writer, world: usize) -> usize {
    let trunks = trunks();
    let mut out = writer.world(world).unwrap();
    let phase = std::f64::consts::TAU * number(world, 60, 0);
    let (ax, ay) = (5.0 + 3.5 * number(world, 61, 0), 3.5 + 3.0 * number(world, 62, 0));
    let at = |t: f64| {
        let p = phase + 0.5 * t;
        [ax * p.sin(), ay * (2.0 * p + phase).sin(), 1.5 + 0.5 * (3.0 * p).sin()]
    };
    let (mut touching, mut beginnings) = (-1, 0);
    for step in 0..100 * FOREST_S {
        let t = step as f64 / 100.0;
        let (pos, next) = (at(t), at(t + 1e-4));
        let vel: [f64; 3] = std::array::from_fn(|i| (next[i] - pos[i]) / 1e-4);
        out.state(&bare_state(t, step, pos, vel)).unwrap();
        let nearest = nearest_trunk(&trunks, pos);
        let Nearest { geom: id, distance_m, drone_geom: own, .. } = nearest;
        out.clearance(&ClearanceRow { t_s: t, step, drone: 0, nearest: Some(nearest) }).unwrap();
        if distance_m < 0.0 {
            // Every step has a row; the picture counts beginnings.
            beginnings += usize::from(touching != id);
            out.contact(&ContactRow {
                t_s: t,
                step,
                drone: 0,
                other_drone: None,
                geoms: [own, id],
                bodies: [own, id],
                other_flex: -1,
                distance_m,
                point_m: pos,
                normal: [1.0, 0.0, 0.0],
                exact: true,
                swept_fraction: None,
            })
            .unwrap();
        }
        touching = if distance_m < 0.0 { id } else { -1 };
        if step % (100 / FOREST_FPS) == 0 {
            forest_frame(&mut out, t, step, pos, vel[1].atan2(vel[0]));
        }
    }
    out.finish().unwrap();
    beginnings
}

/// Flights through the trunks, written as a data set: `n` worlds, 64×48 pixels. Returns how often a trunk was touched.
fn write_forest(dir: &Path, n: usize) -> usize {
    let (writer, _) = dataset::create_or_resume(dir, &forest_manifest(n)).unwrap();
    let beginnings = (0..n).into_par_iter().map(|world| fly_through(&writer, world)).sum();
    writer.finish().unwrap();
    beginnings
}

/// The plain of trunks from above.
fn forest_map() -> HeightMap {
    let (x_m, y_m, columns, rows) = ([-11.0, 11.0], [-9.0, 9.0], 440, 360);
    let trunks = trunks();
    let heights_m = (0..rows * columns)
        .map(|i| {
            let x = x_m[0] + ((i % columns) as f64 + 0.5) * 0.05;
            let y = y_m[1] - ((i / columns) as f64 + 0.5) * 0.05;
            if x.abs() > 10.5 || y.abs() > 8.5 {
                return f32::NAN;
            }
            let inside = trunks.iter().any(|[tx, ty, r]| (x - tx).hypot(y - ty) < *r);
            if inside { TALL_M as f32 } else { 0.0 }
        })
        .collect();
    HeightMap { x_m, y_m, columns, rows, heights_m }
}

#[test]
fn the_overview_shows_what_the_data_set_holds() {
    let dir = tempfile::tempdir().unwrap();
    let beginnings = write_forest(dir.path(), 24);
    let data = Dataset::open(dir.path()).unwrap();
    let overview = Overview::from_dataset(&data, forest_map()).unwrap();
    assert_eq!(overview.title, "forest · cf2x_L250 · 24 worlds × 6 s · seed 7");
    assert_eq!(overview.frames.len(), 12);
    let worlds: std::collections::BTreeSet<_> = overview.frames.iter().map(|f| f.world).collect();
    assert_eq!(worlds.into_iter().collect::<Vec<_>>(), [0, 7, 15, 23]);
    assert_eq!(overview.paths.len(), 24);
    assert!(beginnings > 10);
    assert_eq!(overview.contacts.len(), beginnings);
    // Thinning keeps the first and last point and the nearest pass of every path.
    for (world, path) in overview.paths.iter().enumerate() {
        let reader = data.world(world).unwrap();
        let least = |v: &[f64]| v.iter().copied().fold(f64::INFINITY, f64::min);
        let all = reader.clearance(None).unwrap();
        assert_eq!(least(&path.clearance_m), least(all.column("distance").unwrap()));
        assert!(path.t_s.len() <= 401 && path.t_s[0] == 0.0 && path.t_s[path.t_s.len() - 1] == 5.99);
    }
    let picture = overview.draw().unwrap();
    assert_eq!((picture.width, picture.height), OVERVIEW_SIZE);
    assert_eq!(picture.rgb.len(), 1600 * 1100 * 3);
    assert_eq!(overview.draw().unwrap(), picture);
    let kept = std::env::var_os("PROPWASH_OVERVIEW_OUT").map(PathBuf::from);
    let path = kept.unwrap_or_else(|| dir.path().join("overview.png"));
    picture.save(&path).unwrap();
    let image::DynamicImage::ImageRgb8(written) = image::open(&path).unwrap() else {
        panic!("not in colour")
    };
    assert_eq!(written.into_raw(), picture.rgb);

    // Each thing in its colour, in its place: depth codes on the sheet, orange near passes and none without clearance.
    let count = |picture: &dataset::Picture, [x, y, w, h]: [usize; 4], wanted: &dyn Fn([u8; 3]) -> bool| {
        (y..y + h)
            .flat_map(|row| (x..x + w).map(move |column| (row * 1600 + column) * 3))
            .filter(|i| wanted([picture.rgb[*i], picture.rgb[*i + 1], picture.rgb[*i + 2]]))
            .count()
    };
    let (sheet, map) = ([28, 138, 888, 784], [986, 138, 586, 524]);
    let orange = |p: [u8; 3]| p[0] > 190 && p[1] < 130 && p[2] < 90;
    assert!(count(&picture, sheet, &|p| p == [226, 228, 232]) > 10_000, "sky");
    assert!(count(&picture, sheet, &|p| p == [128, 131, 137]) > 100, "too far");
    assert!(count(&picture, map, &orange) > 200, "near passes");
    let mut safe = overview.clone();
    safe.paths.iter_mut().for_each(|p| p.clearance_m.fill(3.0));
    safe.contacts.clear();
    let safe = safe.draw().unwrap();
    assert_eq!(count(&safe, map, &orange), 0);
    assert!(count(&safe, map, &|p| p[2] > 150 && p[0] < 90 && p[1] < 130) > 5_000, "blue paths");
}

#[test]
fn an_overview_can_be_drawn_of_little_and_refuses_what_does_not_fit() {
    let dir = tempfile::tempdir().unwrap();
    write_all(dir.path(), 2);
    let data = Dataset::open(dir.path()).unwrap();
    let map =
        HeightMap { x_m: [-1.0, 1.0], y_m: [-9.0, 9.0], columns: 1, rows: 1, heights_m: vec![f32::NAN] };
    let good = Overview::from_dataset(&data, map).unwrap();
    good.draw().unwrap();
    assert_eq!(good.frames.iter().map(|f| f.drone).max(), Some(1), "drones take turns");
    let mut empty = good.clone();
    (empty.frames, empty.paths, empty.contacts, empty.notes) = (vec![], vec![], vec![], vec![]);
    empty.draw().unwrap();
    let mut odd = good.clone();
    odd.paths[0].clearance_m.fill(f64::NAN);
    odd.paths[1].xy_m.fill([f64::NAN, f64::INFINITY]);
    odd.paths[2].clearance_m.fill(f64::INFINITY);
    odd.paths[3].clearance_m.fill(-0.3);
    odd.title = "long ".repeat(100);
    odd.draw().unwrap();

    let mut bad = good.clone();
    bad.map.heights_m.clear();
    assert!(bad.draw().unwrap_err().to_string().contains("height map"));
    let mut bad = good.clone();
    bad.map.x_m = [1.0, 1.0];
    assert!(bad.draw().is_err());
    let mut bad = good.clone();
    bad.frames[1].status.pop();
    assert!(bad.draw().unwrap_err().to_string().contains("frame 1"));
    let mut bad = good;
    bad.paths[0].t_s.pop();
    assert!(bad.draw().unwrap_err().to_string().contains("path 0"));
}
