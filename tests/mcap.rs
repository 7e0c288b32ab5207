//! Worlds of data sets as MCAP files: what a reader of the format finds in them.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output};

use propwash::dataset::Dataset;
use serde_json::Value;

fn run(line: &str, more: &[&Path]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_propwash"));
    command.args(line.split_whitespace()).args(more).output().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Messages by topic: schema, time (ns) and content.
fn read(path: &Path) -> BTreeMap<String, Vec<(String, u64, Value)>> {
    let bytes = std::fs::read(path).unwrap();
    let mut found: BTreeMap<String, Vec<(String, u64, Value)>> = BTreeMap::new();
    let mut last = 0;
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        assert!(message.log_time >= last, "messages are in the order of time");
        last = message.log_time;
        let schema = message.channel.schema.clone().unwrap();
        let shape: Value = serde_json::from_slice(&schema.data).unwrap();
        assert_eq!((&*schema.encoding, shape["title"].as_str().unwrap()), ("jsonschema", &*schema.name));
        let content = serde_json::from_slice(&message.data).unwrap();
        found.entry(message.channel.topic.clone()).or_default().push((
            schema.name.clone(),
            message.log_time,
            content,
        ));
    }
    found
}

#[test]
fn a_world_as_mcap_holds_what_the_data_set_holds() {
    let dir = tempfile::tempdir().unwrap();
    let (set, file) = (dir.path().join("set"), dir.path().join("world.mcap"));
    let line = "fly --scene forest --drone cf2x_L250 --worlds 2 --drones-per-world 2 --seconds 0.5 --fps 10 --size 12x8 --obstacle-motion line --json --out";
    let flown = run(line, &[&set]);
    assert!(flown.status.success(), "{}", said(&flown));
    let written = run("dataset mcap --world 1 --json", &[&set, Path::new("--out"), &file]);
    assert!(written.status.success(), "{}", said(&written));
    let told: Value = serde_json::from_slice(&written.stdout).unwrap();

    let data = Dataset::open(&set).unwrap();
    let world = data.world(1).unwrap();
    let (states, frames) = (world.states(None).unwrap(), world.frames().unwrap());
    let found = read(&file);
    assert_eq!(told["topics"], found.len());
    assert_eq!(told["messages"], found.values().map(Vec::len).sum::<usize>());
    assert_eq!(told["images"], 2 * frames.time_s.len());
    let poses = &found["/drone1/pose"];
    assert_eq!(poses.len() * 2, states.n_rows());
    let row = (0..states.n_rows()).filter(|i| states.column("drone").unwrap()[*i] == 1.0).nth(7).unwrap();
    let (schema, time, pose) = &poses[7];
    assert_eq!(schema, "foxglove.PoseInFrame");
    assert_eq!(*time, (states.column("t").unwrap()[row] * 1e9).round() as u64);
    for (axis, column) in [("x", "px"), ("y", "py"), ("z", "pz")] {
        assert_eq!(pose["pose"]["position"][axis].as_f64().unwrap(), states.column(column).unwrap()[row]);
    }
    let (_, _, state) = &found["/drone1/state"][7];
    assert_eq!(state["vx"].as_f64().unwrap(), states.column("vx").unwrap()[row]);
    assert!(state.get("vbat").is_none(), "empty cells have no field: {state}");

    // Images: metres, NaN where nothing was met.
    let images = &found["/drone0/depth"];
    assert_eq!(images.len(), frames.time_s.len());
    let image = &images[3].2;
    assert_eq!((&image["encoding"], &image["step"]), (&"32FC1".into(), &48.into()));
    let bytes = {
        use base64::Engine as _;
        base64::engine::general_purpose::STANDARD.decode(image["data"].as_str().unwrap()).unwrap()
    };
    let pixels: Vec<f32> = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    assert_eq!(pixels.len(), 12 * 8);
    let mut hits = 0;
    for (i, pixel) in pixels.iter().enumerate() {
        let at = [3, 0, i / 12, i % 12];
        if frames.status[at] == 0 {
            hits += 1;
            assert_eq!(*pixel, frames.depth_m[at]);
        } else {
            assert!(pixel.is_nan());
        }
    }
    assert!(hits > 10);

    // A pixel seen again through the transform of the camera, z forward and y down, lies where ours, −z forward and y up, has it.
    let of = |child: &str, time: u64| {
        let all = &found["/tf"];
        all.iter()
            .find(|(_, t, v)| *t == time && v["child_frame_id"] == child)
            .map(|(_, _, v)| v.clone())
            .unwrap()
    };
    let camera = of("drone0/fpv", images[3].1);
    let q = ["x", "y", "z", "w"].map(|k| camera["rotation"][k].as_f64().unwrap());
    let ours: [f64; 4] = core::array::from_fn(|k| frames.camera_quat_xyzw[[3, 0, k]]);
    for (seen, here) in [
        ([0.0, 0.0, 1.0], [0.0, 0.0, -1.0]),
        ([0.0, 1.0, 0.0], [0.0, -1.0, 0.0]),
        ([1.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
    ] {
        let (a, b) = (propwash::math::quat::rotate(q, seen), propwash::math::quat::rotate(ours, here));
        assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-12), "{a:?} {b:?}");
    }
    let ball = of("mover_0", images[3].1);
    assert_eq!(ball["translation"]["x"].as_f64().unwrap(), frames.obstacle_pos_m.unwrap()[[3, 0, 0]]);
    assert_eq!(found["/drone0/camera_info"].len(), images.len());
    assert!(found["/drone0/clearance"].iter().any(|(_, _, v)| v["distance"].as_f64().is_some()));
}

#[test]
fn contacts_are_marks_in_the_scene() {
    let dir = tempfile::tempdir().unwrap();
    let scene = dir.path().join("low.xml");
    let text = "<mujoco><worldbody><geom name='floor' type='plane' size='9 9 1'/>\
        <geom name='roof' type='box' size='5 5 .05' pos='0 0 1'/></worldbody></mujoco>";
    std::fs::write(&scene, text).unwrap();
    let (set, file) = (dir.path().join("set"), dir.path().join("world.mcap"));
    let line = format!(
        "fly --scene {} --drone cf2x_L250 --seconds 0.2 --size 8x8 --trajectory hover --json --out",
        scene.display()
    );
    let flown = run(&line, &[&set]);
    assert!(flown.status.success(), "{}", said(&flown));
    assert!(run("dataset mcap", &[&set, Path::new("--out"), &file]).status.success());
    let found = read(&file);
    let (schema, _, update) = &found["/drone0/contacts"][0];
    assert_eq!(schema, "foxglove.SceneUpdate");
    let entity = &update["entities"][0];
    assert_eq!(entity["metadata"][0]["value"], "roof");
    // Every list that Foxglove's schema of an entity requires is there, also where it is empty.
    for list in
        ["arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models", "metadata"]
    {
        assert!(entity[list].is_array(), "{list}: {entity}");
    }
    let q = ["x", "y", "z", "w"].map(|k| entity["arrows"][0]["pose"]["orientation"][k].as_f64().unwrap());
    let contacts = Dataset::open(&set).unwrap().world(0).unwrap().contacts(None).unwrap();
    let arrow = propwash::math::quat::rotate(q, [1.0, 0.0, 0.0]);
    for (a, name) in arrow.iter().zip(["nx", "ny", "nz"]) {
        assert!((a - contacts.column(name).unwrap()[0]).abs() < 1e-9, "{arrow:?}");
    }
    // Refusals.
    let again = run("dataset mcap", &[&set, Path::new("--out"), &file]);
    assert!(again.status.code() == Some(2) && said(&again).contains("--force"), "{}", said(&again));
    let none = run("dataset mcap --world 1", &[&set, Path::new("--out"), &dir.path().join("b.mcap")]);
    assert!(none.status.code() == Some(2) && said(&none).contains("world 1"), "{}", said(&none));
    assert!(!dir.path().join("b.mcap").exists());
}
