//! One description of a simulation: the same defaults by every door, clear errors, and data sets that are flown again.

use propwash::arena::{
    Arena, CameraConfig, DroneConfig, FlightPattern, Precision, SceneConfig, SimConfig, VehicleSource,
};
use propwash::dataset::Dataset;
use propwash::dataset::recorder::FlightConfig;
use propwash::env::{Env, EnvConfig};
use propwash::physics::controllers::ControlMode;
use propwash::physics::integrate::Integrator;
use propwash::rollout::SimOptions;
use propwash::scene::{Scene, SceneSource, Shell};
use propwash::sense::{Camera, DepthKind, Lens};
use propwash::vehicle::Vehicle;
use std::path::Path;
use std::process::{Command, Output};

fn propwash(line: &str, out: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_propwash"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .arg("fly")
        .args(line.split_whitespace())
        .args(["--json", "--out"])
        .arg(out)
        .output()
        .unwrap()
}

fn fly(line: &str, out: &Path) -> String {
    let done = propwash(line, out);
    assert_eq!(done.status.code(), Some(0), "{line}: {}", String::from_utf8_lossy(&done.stderr));
    std::fs::read_to_string(out.join("manifest.json")).unwrap()
}

#[test]
fn every_door_has_the_same_defaults() {
    let options = SimOptions::default();
    assert_eq!((options.integrator, options.control), (Integrator::Euler, ControlMode::State));
    assert_eq!(SimConfig::default().options, options);
    assert_eq!(EnvConfig::default().sim, SimConfig::default());
    assert_eq!(FlightConfig::default().sim, SimConfig::default());

    // propwash fly, by what it writes into the manifest.
    let dir = tempfile::tempdir().unwrap();
    let manifest = fly("--scene xml/room.xml --drone cf2x_L250 --seconds 0.01", &dir.path().join("out"));
    let mut flown = FlightConfig::from_text(&manifest).unwrap();
    assert_eq!(std::mem::take(&mut flown.sim.scene_sha256).len(), 1);
    let expected = FlightConfig {
        sim: SimConfig {
            precision: Precision::F64,
            n_drones: Some(1),
            scene: Some(SceneConfig::Files(vec!["xml/room.xml".into()])),
            pattern: Some(FlightPattern::Lissajous),
            camera: Some(CameraConfig::default()),
            ..SimConfig::default()
        },
        seconds: 0.01,
        ..FlightConfig::default()
    };
    assert_eq!(flown, expected);

    // An environment: the action says what commands mean, all else is as everywhere.
    let env = Env::new(EnvConfig::default()).unwrap();
    let expected = SimConfig {
        options: SimOptions { control: ControlMode::Attitude, ..options },
        precision: Precision::F32,
        scene: Some(SceneConfig::None),
        open_ground_z_m: Some(0.0),
        ..SimConfig::default()
    };
    assert_eq!(env.config().sim, expected);

    // What a depth means.
    let scene = Scene::build(&SceneSource::file("xml/room.xml"), &[Shell::builtin("cf2x").unwrap()]).unwrap();
    let forest = EnvConfig::from_text(r#"{"task": {"kind": "forest_depth"}, "layouts": 1}"#).unwrap();
    let seen = Env::new(forest).unwrap().config().sim.camera.clone().unwrap();
    for kind in [
        CameraConfig::default().build(&scene, 0).unwrap().kind(),
        Camera::on_drone(&scene, 0, "fpv").unwrap().kind(),
        Camera::in_world(&scene, Default::default(), Lens::Fovy { fovy_deg: 60.0 }).unwrap().kind(),
        seen.kind().unwrap(),
        Dataset::open(&dir.path().join("out")).unwrap().manifest().cameras[0].kind,
    ] {
        assert_eq!(kind, DepthKind::ZDepth);
    }
}

#[test]
fn what_stands_beside_a_device_comes_before_it() {
    let own = CameraConfig { device: Some("vl53l5cx".into()), ..CameraConfig::default() };
    assert_eq!((own.kind().unwrap(), own.size().unwrap()), (DepthKind::Range, [8, 8]));
    let beside = CameraConfig { kind: Some(DepthKind::ZDepth), width: Some(4), ..own };
    assert_eq!((beside.kind().unwrap(), beside.size().unwrap()), (DepthKind::ZDepth, [4, 8]));
}

#[test]
fn a_description_reads_back_equal_in_json_and_in_toml() {
    let vehicle =
        Vehicle::from_toml("heavy", &Vehicle::builtin("cf2x_L250").unwrap().to_toml().replace("32.8", "35"))
            .unwrap();
    let config = SimConfig {
        options: SimOptions { seed: u64::MAX, sim_hz: 1000, ..SimOptions::default() },
        drones: vec![DroneConfig::default(), DroneConfig::from(&vehicle)],
        pattern: Some(
            serde_json::from_str(
                r#"{"waypoints": [[0.0, [0.1, 0.2, 1.0], 0.0], [1.0, [1.0, 0.0, 1.0], 3.141592653589793]]}"#,
            )
            .unwrap(),
        ),
        obstacle_jitter_m: 0.1 + 0.2,
        camera: Some(CameraConfig { range_m: Some([0.1, 1.0 / 3.0]), ..CameraConfig::default() }),
        ..SimConfig::default()
    };
    let json = serde_json::to_string(&config).unwrap();
    let read = SimConfig::from_text(&json).unwrap();
    assert_eq!(read, config);
    assert_eq!(serde_json::to_string(&read).unwrap(), json);
    // TOML has no numbers beyond those of i64.
    let config = SimConfig { options: SimOptions { seed: 3, ..config.options }, ..config };
    assert_eq!(SimConfig::from_text(&toml::to_string(&config).unwrap()).unwrap(), config);
}

#[test]
fn errors_of_a_file_name_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mine.toml");
    std::fs::write(&path, "seconds = 1\nn_world = 3\n").unwrap();
    let message = FlightConfig::from_file(&path).unwrap_err().to_string();
    assert!(message.contains("mine.toml, n_world, line 2: unknown field `n_world`"), "{message}");
    let message = FlightConfig::from_file(&folder.path().join("none.toml")).unwrap_err().to_string();
    assert!(message.contains("none.toml") && message.contains("check the path"), "{message}");
}

#[test]
fn errors_say_where_what_was_expected_and_what_was_found() {
    for (text, words) in [
        (
            r#"{"sim_hs": 500}"#,
            "sim_hs: unknown field `sim_hs`, expected one of body_rate_law, camera, compile, control,",
        ),
        (r#"{"sim_hz": "fast"}"#, "sim_hz: invalid type: string \"fast\", expected u32"),
        (r#"{"integrator": "rk5"}"#, "integrator: unknown variant `rk5`, expected one of `euler`"),
        (
            r#"{"drones": [{}, {"vehicl": "cf2x_L250"}]}"#,
            "drones[1]: unknown field `vehicl`, expected one of `vehicle`",
        ),
        (r#"{"drones": [{"vehicle": 3}]}"#, "drones[0]: expected the name of a built-in vehicle, the path"),
        (r#"{"camera": {"fov": 3}}"#, "camera: unknown field `fov`"),
        (r#"{"rates": {"state": 3}}"#, "rates: unknown field `state`, expected one of `state_hz`"),
        (r#"{"n_worlds": 1"#, "JSON: EOF"),
        ("n_worlds = 1\nsim_hz = 1 2", "TOML, line 2"),
        ("n_worlds = 1\n[camera]\nfov = 3", "camera, line 3: unknown field `fov`"),
        ("n_worlds = 1\nsim_hs = 3", "sim_hs, line 2: unknown field `sim_hs`"),
        ("n_worlds = 1\nsim_hz = \"fast\"", "sim_hz, line 2: invalid type"),
    ] {
        let message = SimConfig::from_text(text).unwrap_err().to_string();
        assert!(message.contains(words), "{text}: {message}");
    }
    for (text, words) in [
        (r#"{"drones": []}"#, "drones: expected at least one, got an empty list"),
        (r#"{"n_drones": 1, "drones": [{}, {}]}"#, "drones: expected at most 1"),
        (r#"{"n_worlds": 0}"#, "n_worlds: expected 1 to"),
        (
            r#"{"control": "body_rate", "drones": [{"dynamics": "so_rpy"}]}"#,
            "control: expected one of state, attitude",
        ),
        (r#"{"obstacle_jitter_m": -1}"#, "obstacle_jitter_m: expected a finite number of at least 0"),
        (r#"{"camera": {}}"#, "camera: expected none without a scene"),
        (r#"{"layout": [0]}"#, "layout: expected numbers below 0, the number of scenes"),
        (r#"{"drones": [{"vehicle": "cf2x"}]}"#, "cf2x_L250"),
        (r#"{"scene": {"files": ["nowhere.xml"]}}"#, "nowhere.xml"),
        (
            r#"{"scene": {"files": ["xml/room.xml"]}, "scene_sha256": ["ab"]}"#,
            "scene_sha256: expected ab, of the scene and the shells that were flown in",
        ),
    ] {
        let message = SimConfig::from_text(text).unwrap().load().unwrap_err().to_string();
        assert!(message.contains(words), "{text}: {message}");
    }
    for (text, words) in [
        (r#"{"precision": "f64"}"#, "precision: expected f32"),
        (r#"{"control": "rotor_vel"}"#, "control: expected attitude, which the action commands"),
        (r#"{"pattern": "hover"}"#, "pattern: expected nothing"),
    ] {
        let message = EnvConfig::from_text(text).and_then(Env::new).unwrap_err().to_string();
        assert!(message.contains(words), "{text}: {message}");
    }
    for (text, words) in [
        (r#"{"precision": "f32"}"#, "precision: expected f64"),
        (r#"{"control": "attitude"}"#, "control: expected state"),
        (r#"{"fps": 0, "scene": {"files": ["xml/room.xml"]}}"#, "fps: expected 1 to 500 Hz"),
        (r#"{}"#, "camera: expected none without a scene"),
        (r#"{"format": "propwash-dataset", "format_version": 1}"#, "config: expected the whole description"),
        (r#"{"format": "propwash-dataset", "format_version": 2}"#, "propwash-dataset of version 1"),
    ] {
        let message = FlightConfig::from_text(text).and_then(FlightConfig::load).unwrap_err().to_string();
        assert!(message.contains(words), "{text}: {message}");
    }
}

/// A vehicle file with effects that draw random numbers and read the ground, rules that draw masses and starts, and moved obstacles.
fn busy(dir: &Path) -> String {
    let vehicle = format!(
        "{}\n[[effect]]\nkind = \"ground_effect\"\nstrength = 3.0\n[[effect]]\nkind = \"turbulence\"\n\
         sigma_m_s = [0.5, 0.5, 0.3]\nlength_m = [1.0, 1.0, 1.0]\n",
        Vehicle::builtin("cf2x_L250").unwrap().to_toml()
    );
    let rules = "[[rule]]\nparameter = \"body.mass_kg\"\ndraw = { scale = [0.9, 1.1] }\n\
                 [[rule]]\nparameter = \"initial.vel.*\"\ndraw = { normal = 0.1 }\n";
    let file = |name: &str, text: &str| {
        std::fs::write(dir.join(name), text).unwrap();
        dir.join(name).display().to_string()
    };
    let (vehicle, rules) = (file("mine.toml", &vehicle), file("rules.toml", rules));
    format!(
        "--scene xml/forest.xml --drone {vehicle} --drone cf21B_500 --worlds 3 --seconds 0.6 --log-hz 500 --size 8x6 \
         --obstacle-jitter 0.3 --randomize {rules} --seed 11 --integrator rk4"
    )
}

#[test]
fn a_data_set_is_flown_again_from_its_manifest_bit_for_bit() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let manifest = fly(&busy(dir.path()), &out);
    // The manifest is all that is needed beside the scene.
    std::fs::remove_file(dir.path().join("mine.toml")).unwrap();
    let config = FlightConfig::from_text(&manifest).unwrap();
    let mut arena = Arena::<f64>::from_config(&config.sim).unwrap();
    let data = Dataset::open(&out).unwrap();
    let tables: Vec<_> = (0..3).map(|w| data.world(w).unwrap().states(None).unwrap()).collect();
    let names = ["px", "py", "pz", "qx", "qy", "qz", "qw", "vx", "vy", "vz", "wx", "wy", "wz"];
    for step in 0..=300 {
        for (w, table) in tables.iter().enumerate() {
            for d in 0..2 {
                let s = arena.sim().data.state(w, d);
                let flown = [&s.pos[..], &s.quat, &s.vel, &s.ang_vel].concat();
                let stored = names.map(|name| table.column(name).unwrap()[2 * step + d]);
                assert_eq!(flown, stored, "world {w}, drone {d}, step {step}");
            }
        }
        let t = arena.sim().time_s(0);
        let command: Vec<f64> = arena.trajectories().iter().flat_map(|path| path.at(t).command()).collect();
        arena.set_command(&command).unwrap();
        arena.step(1).unwrap();
    }

    // And by the program: the same bytes.
    let again = dir.path().join("again");
    let config = out.join("manifest.json").display().to_string();
    assert_eq!(fly(&format!("--config {config}"), &again), manifest);
    for world in ["world_00000", "world_00001", "world_00002"] {
        for file in ["states.parquet", "contacts.parquet", "frames.npz", "world.json"] {
            let bytes = |out: &Path| std::fs::read(out.join(world).join(file)).unwrap();
            assert!(bytes(&out) == bytes(&again), "{world}/{file}");
        }
    }

    // Flags change what the file says.
    let other = fly(
        &format!("--config {config} --worlds 1 --seconds 0.02 --drone cf2x_L250"),
        &dir.path().join("other"),
    );
    let other = FlightConfig::from_text(&other).unwrap();
    assert_eq!((other.sim.options.n_worlds, other.sim.options.seed, other.seconds), (1, 11, 0.02));
    assert_eq!(other.sim.drones, [DroneConfig::default()]);
}

#[test]
fn a_split_run_flies_the_worlds_of_the_whole() {
    let dir = tempfile::tempdir().unwrap();
    let whole = FlightConfig::from_text(&fly(&busy(dir.path()), &dir.path().join("out"))).unwrap().sim;
    let mut part = whole.clone();
    (part.options.n_worlds, part.options.first_world) = (1, 2);
    let (whole, part) =
        (Arena::<f64>::from_config(&whole).unwrap(), Arena::<f64>::from_config(&part).unwrap());
    assert_eq!(whole.trajectories()[4..], *part.trajectories());
    for d in 0..2 {
        assert_eq!(whole.sim().data.state(2, d), part.sim().data.state(0, d));
    }
}

#[test]
fn a_vehicle_that_is_not_built_in_stands_in_the_description_as_text() {
    let own = Vehicle::builtin("cf2x_L250").unwrap();
    assert_eq!(VehicleSource::from(&own), VehicleSource::Named("cf2x_L250".into()));
    let mut file = own.file().clone();
    file.effect.clear();
    let other = Vehicle::from_file("cf2x_L250", file).unwrap();
    let source = VehicleSource::from(&other);
    assert!(matches!(&source, VehicleSource::Text { name, .. } if name == "cf2x_L250"), "{source:?}");
    assert_eq!(source.load().unwrap().sha256(), other.sha256());
}
