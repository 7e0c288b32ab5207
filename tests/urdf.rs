//! URDF import: numbers, poses, groups, and what is refused. MuJoCo 3.17.0 compiles what comes out.

use mujoco_rs::prelude::*;
use propwash::math::euler;
use propwash::physics::controllers::mellinger::{self, Periods};
use propwash::physics::controllers::{ControlMode, Memory};
use propwash::physics::effects::Command;
use propwash::physics::integrate::Integrator;
use propwash::physics::rigid_body::State;
use propwash::physics::surroundings::Surroundings;
use propwash::vehicle::Vehicle;
use propwash::vehicle::urdf::{UrdfOptions, from_urdf, obstacle_from_urdf};
use std::path::{Path, PathBuf};
use std::sync::Arc;

fn data(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/urdf").join(file)
}

fn with_controller() -> UrdfOptions {
    UrdfOptions { controller_from: Some("cf2x_L250".into()), ..UrdfOptions::default() }
}

fn geom(model: &MjModel, name: &str) -> usize {
    model.name_to_id(MjtObjBase::mjOBJ_GEOM, name).unwrap_or_else(|| panic!("no geom {name}"))
}

#[test]
fn a_drone_becomes_a_vehicle_file_and_a_shell() {
    let import = from_urdf(data("quad.urdf"), &with_controller()).unwrap();
    let vehicle = Vehicle::from_toml("quad", import.vehicle_toml.as_ref().unwrap()).unwrap();
    let drone = vehicle.drone("first_principles").unwrap();
    assert_eq!(drone.body.mass_kg, 0.03);
    assert_eq!(drone.body.inertia_kg_m2, [[1.5e-5, 0.0, 0.0], [0.0, 1.6e-5, 0.0], [0.0, 0.0, 2.5e-5]]);
    assert_eq!(drone.body.gravity_m_s2, [0.0, 0.0, -9.80665]);
    // Rotors by the number in their names, seen from the centre of mass 1 cm above the link's origin.
    let model = Vehicle::builtin("cf2x_L250").unwrap().drone("first_principles").unwrap();
    let places = [[0.0354, -0.0354], [-0.0354, -0.0354], [-0.0354, 0.0354], [0.0354, 0.0354]];
    assert_eq!(drone.airframe.n_rotors, 4);
    for i in 0..4 {
        let r = &drone.airframe.rotors[i];
        assert_eq!(r.position_m, [places[i][0], places[i][1], -0.01]);
        assert_eq!((r.spin, r.radius_m), ([-1.0, 1.0, -1.0, 1.0][i], 0.023));
        // The estimated inertia leads by as much as that of the model.
        let ours = r.inertia_kg_m2 / (2.0 * r.torque_curve[2] * drone.hover_rotor_vel()[i]);
        let m = model.airframe.rotors[0];
        let theirs =
            m.inertia_kg_m2 / (m.torque_curve[1] + 2.0 * m.torque_curve[2] * model.hover_rotor_vel()[0]);
        assert!((ours / theirs - 1.0).abs() < 1e-12, "{ours} {theirs}");
        // kf in N/rpm², km in N·m/rpm².
        let speed = 1000.0;
        let rpm = speed * 60.0 / std::f64::consts::TAU;
        assert!((r.thrust_curve[2] * speed * speed / (3.2e-10 * rpm * rpm) - 1.0).abs() < 1e-14);
        assert!((r.torque_curve[2] / r.thrust_curve[2] - 0.025).abs() < 1e-14);
        assert!(r.spin_up[0] > 5.0 && r.spin_up[0] < 100.0, "{:?}", r.spin_up);
    }
    let most = 2.2 * 0.03 * 9.80665 / 4.0;
    assert!((drone.controller.thrust_max_n - most).abs() < 1e-15);
    assert_eq!(drone.controller.mass_kg, 0.03);
    assert_eq!(vehicle.shell, "quad.xml");
    for p in vehicle.provenance() {
        let source = p.source.unwrap_or_default();
        assert!(source.contains("quad.urdf") || source.contains("Crazyflow"), "{} from {source:?}", p.key);
    }
    let warned = import.warnings.join("\n");
    for word in [
        "max_speed_kmh",
        "centre of mass is at [0, 0, 0.01]",
        "cf2x_L250",
        "spin directions",
        "prop0, prop1",
        "fpv",
    ] {
        assert!(warned.contains(word), "no {word:?} in\n{warned}");
    }

    let model = MjModel::from_xml_string(&import.shell_mjcf).unwrap();
    assert!(model.name_to_id(MjtObjBase::mjOBJ_BODY, "drone").is_some());
    assert!(model.name_to_id(MjtObjBase::mjOBJ_CAMERA, "fpv").is_some());
    let (seen, felt) = (geom(&model, "quad_base_visual_0"), geom(&model, "quad_base_collision_0"));
    assert_eq!(
        (model.geom_group()[seen], model.geom_contype()[seen], model.geom_conaffinity()[seen]),
        (1, 0, 0)
    );
    assert_eq!(
        (model.geom_group()[felt], model.geom_contype()[felt], model.geom_conaffinity()[felt]),
        (3, 1, 1)
    );
    assert_eq!(model.geom_size()[seen], [0.04, 0.03, 0.01]);
    assert_eq!(model.geom_size()[felt][..2], [0.06, 0.015]);
    assert_eq!(model.geom_rgba()[seen], [0.5, 0.5, 0.5, 1.0]);
    let mut data = MjData::new(Arc::new(model));
    data.forward();
    assert!(data.geom_xpos()[seen].iter().all(|x| x.abs() < 1e-15), "geoms are seen from the centre of mass");
    let turn = data.geom_xmat()[seen];
    assert!((turn[0] - 0.5_f64.cos()).abs() < 1e-12 && (turn[3] - 0.5_f64.sin()).abs() < 1e-12, "{turn:?}");
    // The camera looks along body x with z up.
    let axes = data.cam_xmat()[0];
    assert!((axes[2] + 1.0).abs() < 1e-12 && (axes[7] - 1.0).abs() < 1e-12, "{axes:?}");
}

/// Where an imported vehicle is after five seconds of its own controller, started with a shove and a tilt.
fn settled(vehicle: &Vehicle) -> State<f64> {
    let drone = vehicle.drone("first_principles").unwrap();
    let mut state = State::rest();
    state.rotor_vel = drone.hover_rotor_vel();
    state.vel = [0.3, -0.2, 0.1];
    state.quat = euler::to_quat([0.2, -0.1, 0.3]);
    let (mut memory, mut command) = (Memory::zero(), [0.0; 16]);
    command[12] = 1.0;
    let r = &vehicle.rates;
    let [state_s, attitude_s, rate_s] =
        [r.state_hz, r.attitude_hz, r.body_rate_hz].map(|hz| 1.0 / f64::from(hz));
    let periods = Periods { state: state_s, attitude: attitude_s, body_rate: rate_s };
    for step in 0..2500 {
        let (mode, gravity) = (ControlMode::State, drone.body.gravity_m_s2);
        let due = r.due(mode, step, 500);
        mellinger::run(&drone.controller, gravity, mode, due, &periods, &state, &command, &mut memory);
        let mut speeds = memory.rotor_cmd;
        mellinger::limit_rotor_vel(&drone.controller, &mut speeds);
        let (motors, calm) = (Command::Rotors(speeds), Surroundings::calm());
        state = Integrator::Rk4.step(&state, 0.002, |s| drone.rate(s, &motors, &calm));
    }
    state
}

#[test]
fn scaled_gains_fly_drones_of_other_sizes() {
    let small = std::fs::read_to_string(data("quad.urdf")).unwrap();
    let dir = tempfile::tempdir().unwrap();
    // The same shape five times as long: mass by 125, inertia by 3125, rotors with 125 times the thrust.
    let large = small
        .replace("\"0.03\"/>\n      <inertia ixx=\"1.5e-5\"", "\"3.75\"/>\n      <inertia ixx=\"0.046875\"")
        .replace("iyy=\"1.6e-5\"", "iyy=\"0.05\"")
        .replace("izz=\"2.5e-5\"", "izz=\"0.078125\"")
        .replace("3.2e-10", "4.0e-8")
        .replace("8.0e-12", "5.0e-9")
        .replace("0.0354", "0.177")
        .replace("arm=\"0.05\"", "arm=\"0.25\"");
    for (name, text) in [("small", small), ("large", large)] {
        let path = dir.path().join(format!("{name}.urdf"));
        std::fs::write(&path, text).unwrap();
        for from in ["cf2x_L250", "cf21B_500", "hb_x500"] {
            let options = UrdfOptions { controller_from: Some(from.into()), ..UrdfOptions::default() };
            let toml = from_urdf(&path, &options).unwrap().vehicle_toml.unwrap();
            let state = settled(&Vehicle::from_toml(name, &toml).unwrap());
            let rpy = euler::from_quat(state.quat);
            assert!(state.vel.iter().all(|v| v.abs() < 0.1), "{name} from {from}: {:?}", state.vel);
            assert!(rpy.iter().all(|a| a.abs() < 0.05), "{name} from {from}: {rpy:?}");
        }
    }
}

#[test]
fn an_obstacle_has_its_links_where_the_joints_put_them() {
    let options = UrdfOptions { name: Some("door<1>".into()), ..UrdfOptions::default() };
    let obstacle = obstacle_from_urdf(data("pkg/urdf/gate.urdf"), &options).unwrap();
    let model = MjModel::from_xml_string(&obstacle.mjcf).unwrap();
    let body = model.name_to_id(MjtObjBase::mjOBJ_BODY, "door<1>").unwrap();
    assert_eq!(model.body_mocapid()[body], 0);
    assert_eq!(model.ngeom(), 5);
    assert_eq!(model.nmesh(), 1, "one file at one scale is one asset");
    let named = |name: &str| geom(&model, &format!("door<1>_{name}"));
    let (post, door, felt) = (named("post_collision_0"), named("door_visual_0"), named("door_collision_0"));
    let (lamp, rail) = (named("lamp_visual_0"), named("rail_collision_0"));
    // A link with collision geoms only is seen by them; with both kinds only the visual ones are seen.
    for (id, group, contacts) in [(post, 1, 1), (door, 1, 0), (felt, 3, 1), (lamp, 1, 0), (rail, 1, 1)] {
        assert_eq!((model.geom_group()[id], model.geom_contype()[id]), (group, contacts), "geom {id}");
    }
    let mut data = MjData::new(Arc::new(model.clone()));
    data.forward();
    let near = |id: usize, want: [f64; 3]| {
        let at = data.geom_xpos()[id];
        assert!((0..3).all(|k| (at[k] - want[k]).abs() < 1e-9), "geom {id} at {at:?}, not {want:?}");
    };
    near(post, [0.0, 0.0, 1.0]);
    near(lamp, [0.0, 0.0, 2.1]);
    // The hinge turns the door's x axis to world y.
    near(rail, [0.1, 0.25, 1.0]);
    let along = data.geom_xmat()[rail];
    assert!((along[5].abs() - 1.0).abs() < 1e-9, "the rail lies along y: {along:?}");
    assert_eq!(model.geom_size()[rail][..2], [0.02, 0.3]);
    assert!((data.geom_xpos()[door][0] - 0.1).abs() < 1e-9 && (data.geom_xpos()[door][1] - 0.5).abs() < 1e-9);
    let warned = obstacle.warnings.join("\n");
    for word in ["`hinge`", "<gazebo>", "`lamp`", "wholly transparent"] {
        assert!(warned.contains(word), "no {word:?} in\n{warned}");
    }
}

#[test]
fn packages_are_found_by_the_search_list() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("gate.urdf");
    std::fs::copy(data("pkg/urdf/gate.urdf"), &path).unwrap();
    let error = obstacle_from_urdf(&path, &UrdfOptions::default()).unwrap_err().to_string();
    for word in ["link door, visual 0", "wedge.obj", "no folder to look in", "search list"] {
        assert!(error.contains(word), "{error}");
    }
    // The folder above the package, or the package itself; relative paths are looked for there as well.
    for search in [vec![data(""), data("pkg/urdf")], vec![data("pkg"), data("pkg/urdf")]] {
        let options = UrdfOptions { search, ..UrdfOptions::default() };
        obstacle_from_urdf(&path, &options).unwrap();
    }
    let text = std::fs::read_to_string(&path).unwrap();
    let file = format!("file://{}", data("pkg/meshes/wedge.obj").display());
    let text = text.replace("package://pkg/meshes/wedge.obj", &file).replace("../meshes/wedge.obj", &file);
    std::fs::write(&path, text).unwrap();
    obstacle_from_urdf(&path, &UrdfOptions::default()).unwrap();
}

#[test]
fn a_converted_mesh_beside_a_collada_file_is_taken_and_said() {
    let dir = tempfile::tempdir().unwrap();
    let text = r#"<robot name="r"><link name="a"><visual><geometry><mesh filename="a.dae"/></geometry></visual></link></robot>"#;
    let path = dir.path().join("r.urdf");
    std::fs::write(&path, text).unwrap();
    let error = obstacle_from_urdf(&path, &UrdfOptions::default()).unwrap_err().to_string();
    for word in ["link a, visual 0", "a.dae", ".obj, .stl or .msh", "convert"] {
        assert!(error.contains(word), "{error}");
    }
    std::fs::copy(data("pkg/meshes/wedge.obj"), dir.path().join("a.obj")).unwrap();
    let obstacle = obstacle_from_urdf(&path, &UrdfOptions::default()).unwrap();
    assert!(
        obstacle.warnings[0].contains("`a.obj` beside it was taken for `a.dae`"),
        "{:?}",
        obstacle.warnings
    );
    MjModel::from_xml_string(&obstacle.mjcf).unwrap();
}

#[test]
fn rotors_without_links_stand_at_the_arms() {
    let text = std::fs::read_to_string(data("quad.urdf")).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("arms.urdf");
    let arms = text.replace("\"prop", "\"stub").replace("prop_radius=\"0.023\"", "");
    let rotors = |text: &str| {
        std::fs::write(&path, text).unwrap();
        let import = from_urdf(&path, &with_controller()).unwrap();
        let vehicle = Vehicle::from_toml("arms", &import.vehicle_toml.unwrap()).unwrap();
        let drone = vehicle.drone("first_principles").unwrap();
        (
            [0, 1, 2, 3].map(|i| (drone.airframe.rotors[i].position_m, drone.airframe.rotors[i].spin)),
            import.warnings,
        )
    };
    let (places, warnings) = rotors(&arms);
    let d = 0.05 * std::f64::consts::FRAC_1_SQRT_2;
    assert_eq!(
        places,
        [([d, -d, -0.01], -1.0), ([-d, -d, -0.01], 1.0), ([-d, d, -0.01], -1.0), ([d, d, -0.01], 1.0)]
    );
    let warned = warnings.join("\n");
    for word in ["arm = 0.05 m in X configuration", "no prop_radius; 0.02355 m was taken from cf2x_L250"] {
        assert!(warned.contains(word), "no {word:?} in\n{warned}");
    }
    let (places, warnings) = rotors(&arms.replace("arm=", "configuration=\"+\" arm="));
    assert_eq!(places[1], ([0.0, 0.05, -0.01], 1.0));
    assert!(warnings.join("\n").contains("+ configuration"));
}

#[test]
fn spins_may_be_given() {
    let options = UrdfOptions { spins: vec![1.0, -1.0, 1.0, -1.0], ..with_controller() };
    let import = from_urdf(data("quad.urdf"), &options).unwrap();
    let vehicle = Vehicle::from_toml("quad", &import.vehicle_toml.unwrap()).unwrap();
    assert_eq!(vehicle.drone("first_principles").unwrap().airframe.rotors[0].spin, 1.0);
    let options = UrdfOptions { spins: vec![1.0], ..with_controller() };
    let error = from_urdf(data("quad.urdf"), &options).unwrap_err().to_string();
    assert!(error.contains("one spin for each of 4 rotors"), "{error}");
}

#[test]
fn mass_and_inertia_of_links_add_up_about_the_common_centre() {
    // Two points of 1 kg, 2 m apart along y of a link that is turned by 90° about z: apart along x of the root.
    let text = r#"<robot name="r">
      <link name="a"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="3"/></inertial>
        <collision><geometry><sphere radius="0.1"/></geometry></collision></link>
      <link name="b"><inertial><origin xyz="0 -2 0"/><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="3"/></inertial></link>
      <joint name="j" type="fixed"><origin xyz="0 0 0" rpy="0 0 1.5707963267948966"/><parent link="a"/><child link="b"/></joint>
      <properties kf="1e-7" km="1e-9" thrust2weight="2" arm="0.3" prop_radius="0.1"/></robot>"#;
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("r.urdf");
    std::fs::write(&path, text).unwrap();
    let import = from_urdf(&path, &with_controller()).unwrap();
    let body = Vehicle::from_toml("r", &import.vehicle_toml.unwrap())
        .unwrap()
        .drone("first_principles")
        .unwrap()
        .body;
    assert_eq!(body.mass_kg, 2.0);
    // Centre at x = 1: own inertias diag(1,2,3) + diag(2,1,3), and 2 · 1 kg · (1 m)² about y and z.
    let want = [3.0, 5.0, 8.0];
    for i in 0..3 {
        for j in 0..3 {
            let expected = if i == j { want[i] } else { 0.0 };
            assert!((body.inertia_kg_m2[i][j] - expected).abs() < 1e-12, "{:?}", body.inertia_kg_m2);
        }
    }
    assert!(import.warnings.iter().any(|w| w.contains("centre of mass is at [1, ")), "{:?}", import.warnings);
    let model = MjModel::from_xml_string(&import.shell_mjcf).unwrap();
    assert!((model.geom_pos()[0][0] + 1.0).abs() < 1e-12);
}

#[test]
fn a_drone_without_coefficients_gives_a_shell_only() {
    let import = from_urdf(data("pkg/urdf/gate.urdf"), &UrdfOptions::default()).unwrap();
    assert_eq!(import.vehicle_toml, None);
    assert!(import.warnings.iter().any(|w| w.contains("only the shell")), "{:?}", import.warnings);
    MjModel::from_xml_string(&import.shell_mjcf).unwrap();
}

#[test]
fn wrong_files_are_refused_with_place_and_remedy() {
    let quad = std::fs::read_to_string(data("quad.urdf")).unwrap();
    let swap = |from: &str, to: &str| {
        assert!(quad.contains(from), "no {from:?}");
        quad.replacen(from, to, 1)
    };
    let nested = format!("<robot>{}{}</robot>", "<a>".repeat(100), "</a>".repeat(100));
    let deep = format!("<robot>{}{}</robot>", "<a>".repeat(100_000), "</a>".repeat(100_000));
    let nine: String = (0..9).map(|i| format!("<link name=\"rotor{i}\"/><joint name=\"k{i}\" type=\"fixed\"><parent link=\"base\"/><child link=\"rotor{i}\"/></joint>")).collect();
    let cases: Vec<(&str, String, Vec<&str>)> = vec![
        ("a.xacro", quad.clone(), vec!["xacro", "run `xacro"]),
        ("a.urdf", swap("<robot name=\"quad\">", "<robot name=\"quad\" xmlns:xacro=\"http://www.ros.org/wiki/xacro\"><xacro:include filename=\"x\"/>"), vec!["`xacro`", "run `xacro"]),
        ("a.urdf", swap("<robot name=\"quad\">", "<robot name=\"quad\"><xacro:macro/>"), vec!["`xacro`", "run `xacro"]),
        ("a.urdf", swap("value=\"0.03\"", "value=\"${mass}\""), vec!["`xacro`", "run `xacro"]),
        ("a.urdf", swap("</robot>", ""), vec!["well-formed XML", "line", "correct the file"]),
        ("a.urdf", "<mujoco/>".into(), vec!["<robot>", "found <mujoco>", "give a URDF"]),
        ("a.urdf", nested, vec!["nested at most 64", "check the file"]),
        ("a.urdf", deep, vec!["a.urdf"]),
        ("a.urdf", swap("value=\"0.03\"", "value=\"heavy\""), vec!["links and joints", "correct the element"]),
        ("a.urdf", swap("value=\"0.03\"", "value=\"-1\""), vec!["link base, inertial, mass", "not negative", "-1"]),
        ("a.urdf", swap("value=\"0.03\"", "value=\"NaN\""), vec!["link base, inertial, mass", "NaN"]),
        ("a.urdf", swap("value=\"0.03\"", "value=\"0\""), vec!["rotors away from the centre of mass", "mass"]),
        ("a.urdf", swap("xyz=\"0 0 0.01\" rpy=\"0 0 0.5\"", "xyz=\"0 0 inf\""), vec!["link base, visual 0, origin", "finite", "correct the origin"]),
        ("a.urdf", swap("size=\"0.08 0.06 0.02\"", "size=\"0.08 0 0.02\""), vec!["link base, visual 0", "sizes above 0", "correct the size"]),
        ("a.urdf", swap("link=\"prop3\"", "link=\"prop9\""), vec!["joint j3, child", "`prop9`, which is no link", "add the link"]),
        ("a.urdf", swap("link=\"prop3\"", "link=\"prop2\""), vec!["link prop2", "`j2` and `j3`", "tree"]),
        ("a.urdf", swap("<parent link=\"base\"/><child link=\"prop3\"/>", "<parent link=\"prop3\"/><child link=\"prop3\"/>"), vec!["link prop3", "circle", "tree"]),
        ("a.urdf", swap("<joint name=\"j3\" type=\"fixed\"><parent link=\"base\"/><child link=\"prop3\"/></joint>", ""), vec!["one link without a parent", "base, prop3", "connect"]),
        ("a.urdf", swap("<link name=\"prop3\">", "<link name=\"prop2\">"), vec!["link prop2", "twice", "rename"]),
        ("a.urdf", swap("kf=\"3.2e-10\"", ""), vec!["properties, kf", "N/rpm²", "add the attribute"]),
        ("a.urdf", swap("kf=\"3.2e-10\"", "kf=\"-1\""), vec!["properties, kf", "positive", "correct the attribute"]),
        ("a.urdf", swap("</robot>", &format!("{nine}</robot>")), vec!["at most 8", "found 13", "rename"]),
        ("a.urdf", "<robot name=\"r\"><link name=\"a\"/></robot>".into(), vec!["<visual> or <collision>", "no geometry", "xml/shells"]),
        ("a.urdf", "<robot name=\"r\"><link name=\"a\"><visual><geometry><mesh filename=\"http://x/a.obj\"/></geometry></visual></link></robot>".into(), vec!["link a, visual 0", "http://", "fetch"]),
        ("a.urdf", "<robot name=\"r\"><link name=\"a\"><visual><geometry><plane/></geometry></visual></link></robot>".into(), vec!["links and joints", "plane"]),
        ("a.urdf", "".into(), vec!["well-formed XML"]),
    ];
    let dir = tempfile::tempdir().unwrap();
    for (name, text, words) in cases {
        let path = dir.path().join(name);
        std::fs::write(&path, &text).unwrap();
        let shown: String = text.chars().take(200).collect();
        let error = match from_urdf(&path, &with_controller()) {
            Ok(_) => panic!("accepted: {shown}"),
            Err(error) => error.to_string(),
        };
        for word in words {
            assert!(error.contains(word), "no {word:?} in\n{error}\nfor {shown}");
        }
        assert!(error.contains(name), "{error}");
    }
    let error = from_urdf(data("quad.urdf"), &UrdfOptions::default()).unwrap_err().to_string();
    assert!(error.contains("controller_from") && error.contains("cf2x_L250, cf2x_P250"), "{error}");
    let options = UrdfOptions { controller_from: Some("none".into()), ..UrdfOptions::default() };
    assert!(from_urdf(data("quad.urdf"), &options).unwrap_err().to_string().contains("`none`"));
    assert!(
        from_urdf(data("absent.urdf"), &with_controller()).unwrap_err().to_string().contains("absent.urdf")
    );
}

#[test]
fn damaged_files_are_errors_and_never_panics() {
    let mut seed = 7_u64;
    let mut random = move |below: usize| {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 33) as usize % below
    };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("damaged.urdf");
    let mut refused = 0;
    for file in ["quad.urdf", "pkg/urdf/gate.urdf"] {
        let text = std::fs::read_to_string(data(file)).unwrap();
        let pieces: Vec<&str> = text.split_inclusive(|c: char| !c.is_alphanumeric()).collect();
        for _ in 0..1000 {
            let mut text = pieces.clone();
            for _ in 0..=random(3) {
                let (from, to) = (random(text.len()), random(text.len()));
                match random(3) {
                    0 => text[to] = text[from],
                    1 => drop(text.remove(from)),
                    _ => text.insert(to, text[from]),
                }
            }
            std::fs::write(&path, text.concat()).unwrap();
            let options = UrdfOptions { search: vec![data(""), data("pkg/urdf")], ..with_controller() };
            refused += usize::from(from_urdf(&path, &options).is_err());
            let _ = obstacle_from_urdf(&path, &options);
        }
    }
    assert!(refused > 500, "{refused}");
}
