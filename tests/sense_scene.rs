//! Building scenes: good ones, bad ones, foreign ones; poses in; the ground below.

use std::path::{Path, PathBuf};
use std::process::Command;

use propwash::scene::{
    BuildOptions, Pose, Scene, SceneError, SceneSource, Shell, WorkerPool, load_plugin_library,
};
use propwash::sense::{Camera, DepthFrame, Lens, Queries};

const LEVEL: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

fn shell(body: &str) -> Shell {
    Shell {
        name: "test".into(),
        xml: format!("<mujoco><worldbody><body name='drone'>{body}</body></worldbody></mujoco>"),
        dir: None,
    }
}

fn ball() -> Shell {
    shell("<geom name='ball' type='sphere' size='0.1'/><camera name='fpv'/>")
}

fn text(xml: &str) -> SceneSource {
    SceneSource::text("test", xml)
}

fn fails(xml: &str, shells: &[Shell]) -> String {
    Scene::build(&text(xml), shells).unwrap_err().to_string()
}

#[test]
fn bad_scenes_give_mujocos_own_reason() {
    let cases: &[(&str, &str)] = &[
        ("<mujoco><worldbody>", "parse"),
        ("not xml at all", "parse"),
        ("", "parse"),
        ("<mujoco><worldbody><geom type='box'/></worldbody></mujoco>", "size"),
        ("<mujoco><worldbody><geom type='blob' size='1'/></worldbody></mujoco>", "blob"),
        ("<mujoco><worldbody><geom type='mesh' mesh='nothing'/></worldbody></mujoco>", "nothing"),
        ("<mujoco><asset><mesh file='no_such_file.obj'/></asset></mujoco>", "no_such_file"),
        (
            "<mujoco><asset><hfield name='h' file='no_such_file.png' size='1 1 1 1'/></asset></mujoco>",
            "no_such_file",
        ),
        ("<mujoco><include file='no_such_file.xml'/></mujoco>", "no_such_file"),
        ("<mujoco><worldbody><geom type='sphere' size='-1'/></worldbody></mujoco>", "size"),
        (
            "<mujoco><worldbody><geom name='a' size='1'/><geom name='a' size='1'/></worldbody></mujoco>",
            "repeated",
        ),
        ("<mujoco><asset><mesh name='m' vertex='0 0 0 1 0 0 0 1 0 nan 0 0'/></asset></mujoco>", ""),
        ("<mujoco><worldbody><geom type='sphere' size='1' plugin='x'/></worldbody></mujoco>", "plugin"),
        (
            "<mujoco><asset><hfield name='h' nrow='2000000000' ncol='2000000000' size='1 1 1 1'/></asset></mujoco>",
            "smaller",
        ),
        (
            "<mujoco><asset><texture name='t' type='2d' builtin='flat' width='90000' height='90000'/></asset></mujoco>",
            "smaller",
        ),
        (
            "<mujoco><worldbody><replicate count='100000'><replicate count='100'><geom size='1'/></replicate></replicate></worldbody></mujoco>",
            "smaller",
        ),
        ("<mujoco><size memory='900000G'/></mujoco>", "memory"),
        ("<mujoco><worldbody><body><freejoint/></body></worldbody></mujoco>", "mass"),
    ];
    for (xml, word) in cases {
        let message = fails(xml, &[ball()]);
        assert!(message.contains("'test'"), "{message}");
        assert!(message.to_lowercase().contains(word), "{xml}\n{message}");
        assert!(message.len() > 30, "{message}");
    }
    assert!(fails("<mujoco>\0</mujoco>", &[]).contains("NUL"));
    let message = Scene::build(&SceneSource::file("/no/such/scene.xml"), &[]).unwrap_err().to_string();
    assert!(message.contains("/no/such/scene.xml"), "{message}");
    let folder = tempfile::tempdir().unwrap();
    let message = Scene::build(&SceneSource::file(folder.path()), &[]).unwrap_err().to_string();
    assert!(message.contains("not a file"), "{message}");
}

#[test]
fn bad_shells_say_what_a_shell_needs() {
    let shells: &[(&str, &str)] = &[
        (
            "<mujoco><worldbody><body name='quad'><geom size='1'/></body></worldbody></mujoco>",
            "named 'drone'",
        ),
        ("<mujoco><worldbody><body name='drone'/></worldbody></mujoco>", "no geom"),
        (
            "<mujoco><worldbody><body name='drone'><freejoint/><geom size='1'/></body></worldbody></mujoco>",
            "joint",
        ),
        ("<mujoco><worldbody>", "parse"),
    ];
    for (xml, word) in shells {
        let bad = Shell { name: "odd".into(), xml: (*xml).into(), dir: None };
        let message = fails("<mujoco/>", &[ball(), bad]);
        assert!(message.contains("odd") && message.contains(word), "{message}");
    }
}

#[test]
fn a_name_that_belongs_to_a_drone_is_refused_by_name() {
    let xml =
        "<mujoco><worldbody><body name='drone1/drone'><geom name='g' size='1'/></body></worldbody></mujoco>";
    let error = Scene::build(&text(xml), &[ball(), ball()]).unwrap_err();
    assert!(matches!(&error, SceneError::NameClash { drone: 1, .. }), "{error}");
    assert!(error.to_string().contains("drone1/drone"));
    // With one drone the name is free.
    assert!(Scene::build(&text(xml), &[ball()]).is_ok());
    let xml = "<mujoco><worldbody><geom name='drone0/ball' size='1'/></worldbody></mujoco>";
    assert!(fails(xml, &[ball()]).contains("drone0/ball"));
}

#[test]
fn an_empty_world_is_a_world() {
    let scene = Scene::build(&text("<mujoco/>"), &[]).unwrap();
    assert_eq!((scene.n_drones(), scene.geoms().len(), scene.obstacles().len()), (0, 0, 0));
    let mut worker = scene.worker().unwrap();
    assert_eq!(worker.collide().unwrap(), 0);
    assert_eq!(worker.ground_below([0.0, 0.0, 5.0]).unwrap(), None);
    assert!(matches!(worker.set_drone(0, [0.0; 3], LEVEL), Err(SceneError::NoSuch { .. })));
    let scene = Scene::build(&text("<mujoco/>"), &[ball()]).unwrap();
    let mut worker = scene.worker().unwrap();
    assert_eq!(worker.ground_distance(0).unwrap(), None);
    assert!(!Queries::at(&mut worker).clearance(0, 3.0).unwrap().found);
}

#[test]
fn switches_that_would_silence_contacts_are_overridden_and_said() {
    for (xml, word) in [
        ("<option><flag contact='disable'/></option>", "disables contacts"),
        ("<option><flag constraint='disable'/></option>", "disables constraints"),
        ("<option><flag nativeccd='disable'/></option>", "nativeccd"),
        ("<option><flag sleep='enable'/></option>", "sleep"),
        ("<size nconmax='1'/>", "nconmax"),
        ("<size nconmax='0'/>", "nconmax"),
        ("<compiler alignfree='true' fusestatic='true' inertiafromgeom='true' settotalmass='2'/>", ""),
        ("<compiler angle='radian' boundmass='0.5' balanceinertia='true'/>", ""),
        ("<option collision='all'/>", "@"),
    ] {
        let xml = format!(
            "<mujoco>{xml}<worldbody><geom type='plane' size='0 0 1'/><geom type='box' size='1 1 1' pos='0 0 1'/>\
             </worldbody></mujoco>"
        );
        // MuJoCo has dropped some attributes over the years: then it is MuJoCo that refuses them.
        let scene = match Scene::build(&text(&xml), &[ball(), ball()]) {
            Ok(scene) => scene,
            Err(e) if word == "@" => {
                assert!(e.to_string().contains("collision"), "{e}");
                continue;
            }
            Err(e) => panic!("{xml}: {e}"),
        };
        assert!(
            word == "@" || word.is_empty() || scene.warnings().iter().any(|w| w.contains(word)),
            "{:?}",
            scene.warnings()
        );
        let mut worker = scene.worker().unwrap();
        worker.set_drone(0, [0.0, 0.0, 2.05], LEVEL).unwrap();
        worker.set_drone(1, [3.0, 0.0, 0.05], LEVEL).unwrap();
        worker.update().unwrap();
        let mut found = Vec::new();
        Queries::at(&mut worker).contacts(&mut found).unwrap();
        assert_eq!(found.len(), 2, "{xml}");
        assert!(found.iter().all(|c| (c.distance_m + 0.05).abs() < 1e-9));
    }
    let plain = Scene::build(&text("<mujoco/>"), &[ball()]).unwrap();
    assert!(plain.warnings().is_empty(), "{:?}", plain.warnings());
}

#[test]
fn a_drone_is_where_it_is_put() {
    // Neither the scene's compiler settings nor offsets inside the shell move it.
    let odd = shell(
        "<inertial pos='0.3 0.2 0.1' mass='3' diaginertia='1 1 1'/><geom type='sphere' size='0.1' pos='0.2 0 0'/>",
    );
    for compiler in ["", "<compiler alignfree='true' inertiafromgeom='true'/>"] {
        let scene =
            Scene::build(&text(&format!("<mujoco>{compiler}</mujoco>")), &[ball(), odd.clone()]).unwrap();
        let mut worker = scene.worker().unwrap();
        let h = 0.5f64.sqrt();
        // Not of unit length: made so. A quarter turn about z.
        worker.set_drone(1, [1.0, 2.0, 3.0], [0.0, 0.0, 2.0 * h, 2.0 * h]).unwrap();
        worker.update().unwrap();
        let geom = scene.drone_geoms(1).unwrap()[0];
        let (p, _) = worker.geom_pose(geom).unwrap();
        for (got, expected) in p.iter().zip([1.0, 2.2, 3.0]) {
            assert!((got - expected).abs() < 1e-12, "{p:?}");
        }
        let body = worker.body_pose(scene.drone_body(1).unwrap()).unwrap();
        assert!((body.quat_xyzw[2] - h).abs() < 1e-12 && (body.quat_xyzw[3] - h).abs() < 1e-12);
        assert_eq!(worker.drone_pose(0).unwrap(), Pose::default());
        assert!(scene.drone_radius_m(1).unwrap() >= 0.3 - 1e-12);
    }
}

#[test]
fn poses_that_are_not_finite_are_refused_and_name_the_drone() {
    let xml =
        "<mujoco><worldbody><body name='gate' mocap='true'><geom size='0.1'/></body></worldbody></mujoco>";
    let scene = Scene::build(&text(xml), &[ball(), ball()]).unwrap();
    let mut worker = scene.worker().unwrap();
    for (pos, quat) in [
        ([f64::NAN, 0.0, 0.0], LEVEL),
        ([0.0, f64::INFINITY, 0.0], LEVEL),
        ([0.0, 0.0, 1e300], LEVEL),
        ([0.0; 3], [0.0; 4]),
        ([0.0; 3], [f64::NAN, 0.0, 0.0, 1.0]),
    ] {
        let message = worker.set_drone(1, pos, quat).unwrap_err().to_string();
        assert!(message.contains("drone 1"), "{message}");
        let message = worker.set_obstacle(0, pos, quat).unwrap_err().to_string();
        assert!(message.contains("gate"), "{message}");
    }
    // The pose before stays.
    worker.update().unwrap();
    assert_eq!(worker.drone_pose(1).unwrap(), Pose::default());
    assert!(matches!(worker.set_drone(2, [0.0; 3], LEVEL), Err(SceneError::NoSuch { .. })));
    assert!(matches!(worker.set_obstacle(1, [0.0; 3], LEVEL), Err(SceneError::NoSuch { .. })));
}

#[test]
fn obstacles_and_joints_start_as_the_model_places_them() {
    let xml = "<mujoco><worldbody>
        <body name='m' mocap='true' pos='1 2 3' quat='0 1 0 0'><geom size='0.1'/></body>
        <body name='f' pos='4 5 6'><freejoint/><geom size='0.1'/><body name='child'><geom size='0.1' pos='1 0 0'/></body></body>
        <body name='h' pos='7 8 9'><joint ref='0.5'/><geom size='0.1'/></body>
        </worldbody><keyframe><key qpos='0 0 0 1 0 0 0 1'/></keyframe></mujoco>";
    let scene = Scene::build(&text(xml), &[ball()]).unwrap();
    let names: Vec<_> = scene.obstacles().iter().map(|o| (o.name.as_str(), o.pos_m)).collect();
    assert_eq!(names, [("m", [1.0, 2.0, 3.0]), ("f", [4.0, 5.0, 6.0])]);
    assert_eq!(scene.obstacles()[0].quat_xyzw, [1.0, 0.0, 0.0, 0.0]);
    let child = scene.bodies().iter().find(|b| b.name == "child").unwrap();
    assert_eq!(child.obstacle, Some(1));
    assert!(scene.warnings().iter().any(|w| w.contains("keyframe")), "{:?}", scene.warnings());
    let mut worker = scene.worker().unwrap();
    let body = |name: &str| scene.bodies().iter().find(|b| b.name == name).unwrap().id;
    for (name, pos) in [("m", [1.0, 2.0, 3.0]), ("f", [4.0, 5.0, 6.0]), ("h", [7.0, 8.0, 9.0])] {
        assert_eq!(worker.body_pose(body(name)).unwrap().pos_m, pos);
    }
    worker.set_obstacle(1, [0.0, 0.0, 9.0], LEVEL).unwrap();
    worker.update().unwrap();
    assert_eq!(worker.body_pose(body("child")).unwrap().pos_m, [0.0, 0.0, 9.0]);
}

#[test]
fn the_ground_is_the_scenes_own() {
    let xml = "<mujoco><asset><hfield name='h' nrow='3' ncol='3' size='5 5 2 0.1' elevation='0 0 0 0 1 0 0 0 0'/></asset><worldbody>
        <geom name='floor' type='plane' size='1 1 1' pos='0 0 -3'/>
        <geom name='table' type='box' size='1 1 0.1' pos='20 0 1' rgba='1 1 1 0' group='4'/>
        <geom name='ghost' type='box' size='1 1 0.1' pos='20 0 2' contype='0' conaffinity='0'/>
        <geom name='hill' type='hfield' hfield='h' pos='50 0 0'/></worldbody></mujoco>";
    let scene = Scene::build(&text(xml), &[shell("<geom type='box' size='0.2 0.2 0.05'/>"), ball()]).unwrap();
    let mut worker = scene.worker().unwrap();
    for (x, z, expected) in [
        (0.0, 0.0, Some(3.0)),
        // A plane has no edge.
        (9.0, 0.0, Some(3.0)),
        // An invisible table is ground, a ghost is not.
        (20.0, 5.0, Some(3.9)),
        (20.0, 1.5, Some(0.4)),
        // The top of the hill, 2 m high.
        (50.0, 5.0, Some(3.0)),
        // Below the floor there is nothing.
        (0.0, -4.0, None),
    ] {
        worker.set_drone(0, [x, 0.0, z], LEVEL).unwrap();
        // Another drone below is no ground.
        worker.set_drone(1, [x, 0.0, z - 0.3], LEVEL).unwrap();
        worker.update().unwrap();
        let got = worker.ground_distance(0).unwrap();
        match (got, expected) {
            (Some(g), Some(e)) => assert!((g - e).abs() < 1e-9, "{x} {z}: {g}"),
            (g, e) => assert_eq!(g, e, "{x} {z}"),
        }
    }
}

#[test]
fn an_engine_error_is_returned_with_mujocos_words_and_the_worker_lives() {
    let boxes: String = (0..30)
        .map(|i| {
            format!(
                "<body pos='0 0 {}'><freejoint/><geom type='box' size='1 1 1'/></body>",
                0.01 * f64::from(i)
            )
        })
        .collect();
    let xml = format!("<mujoco><size memory='100K'/><worldbody>{boxes}</worldbody></mujoco>");
    let small = Scene::build_with(&text(&xml), &[ball()], BuildOptions { raise_memory: false }).unwrap();
    assert_eq!(small.arena_bytes(), 102_400);
    let mut worker = small.worker().unwrap();
    worker.set_drone(0, [5.0, 0.0, 0.0], LEVEL).unwrap();
    worker.update().unwrap();
    for _ in 0..20 {
        let error = worker.collide().unwrap_err();
        assert!(matches!(&error, SceneError::Engine { call: "mj_collision", .. }), "{error}");
        let message = error.to_string();
        assert!(message.contains("mj_stackAlloc") && message.contains("<size memory"), "{message}");
        // Poses are kept, but the worker asks for an update.
        assert!(matches!(worker.collide(), Err(SceneError::Stale { .. })));
        worker.update().unwrap();
        assert_eq!(worker.body_pose(small.drone_body(0).unwrap()).unwrap().pos_m, [5.0, 0.0, 0.0]);
        assert_eq!(
            worker.ground_below([0.0, 0.0, 5.0]).unwrap().map(|d| (d * 1e6).round()),
            Some(3_710_000.0)
        );
    }
    let roomy = Scene::build(&text(&xml), &[ball()]).unwrap();
    assert!(roomy.arena_bytes() >= 16 << 20);
    assert!(roomy.worker().unwrap().collide().unwrap() >= 30);
}

#[test]
fn errors_in_many_threads_at_once_stay_with_their_workers() {
    let boxes: String = (0..30)
        .map(|i| {
            format!(
                "<body pos='0 0 {}'><freejoint/><geom type='box' size='1 1 1'/></body>",
                0.01 * f64::from(i)
            )
        })
        .collect();
    let xml = format!("<mujoco><size memory='100K'/><worldbody>{boxes}</worldbody></mujoco>");
    let bad = Scene::build_with(&text(&xml), &[ball()], BuildOptions { raise_memory: false }).unwrap();
    let good = Scene::build(&text(&xml), &[ball()]).unwrap();
    let expected = good.worker().unwrap().collide().unwrap();
    std::thread::scope(|scope| {
        for t in 0..8 {
            let scene = if t % 2 == 0 { bad.clone() } else { good.clone() };
            scope.spawn(move || {
                for _ in 0..20 {
                    let mut worker = scene.worker().unwrap();
                    match worker.collide() {
                        Ok(n) => assert!(t % 2 == 1 && n == expected),
                        Err(e) => assert!(t % 2 == 0 && e.to_string().contains("mj_stackAlloc")),
                    }
                }
            });
        }
    });
    let pool = WorkerPool::new(&good);
    assert_eq!(pool.with(|w| w.collide().unwrap()).unwrap(), expected);
}

#[test]
fn many_drones_share_their_assets() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(
        folder.path().join("tetra.obj"),
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n",
    )
    .unwrap();
    std::fs::write(
        folder.path().join("part.xml"),
        "<mujoco><worldbody><body name='drone'><geom type='mesh' mesh='tetra'/></body></worldbody></mujoco>",
    )
    .unwrap();
    let meshed = Shell {
        name: "meshed".into(),
        xml: "<mujoco><compiler meshdir='.'/><asset><mesh name='tetra' file='tetra.obj' scale='0.1 0.1 0.1'/></asset><include file='part.xml'/></mujoco>".into(),
        dir: Some(folder.path().to_path_buf()),
    };
    let shells = vec![meshed; 64];
    let scene = Scene::build(&text("<mujoco/>"), &shells).unwrap();
    assert_eq!((scene.n_drones(), scene.geoms().len()), (64, 64));
    let names: std::collections::BTreeSet<_> =
        (0..64).map(|g| scene.mesh(g).unwrap().name.to_string()).collect();
    assert_eq!(names.len(), 1, "{names:?}");
    assert_eq!(scene.mesh(0).unwrap().faces.len(), 4);
    assert_eq!(scene.mesh_hull(0).unwrap().len(), 4);
    // The folder of the shell holds nothing new.
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
}

#[test]
fn a_scene_file_finds_its_includes_and_meshes_from_anywhere() {
    let folder = tempfile::tempdir().unwrap();
    let assets = folder.path().join("assets");
    std::fs::create_dir(&assets).unwrap();
    std::fs::write(
        assets.join("t.obj"),
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n",
    )
    .unwrap();
    std::fs::write(
        folder.path().join("inc.xml"),
        "<mujoco><worldbody><geom name='inc' type='mesh' mesh='t'/></worldbody></mujoco>",
    )
    .unwrap();
    let file = folder.path().join("scene.xml");
    std::fs::write(&file, "<mujoco><compiler meshdir='assets'/><asset><mesh name='t' file='t.obj'/></asset><include file='inc.xml'/></mujoco>").unwrap();
    let scene = Scene::build(&SceneSource::file(&file), &[ball()]).unwrap();
    assert_eq!(scene.geoms()[0].name, "inc");
    assert_eq!(scene.geoms()[0].asset.as_deref(), Some("t"));
}

#[test]
fn the_hash_names_the_scene_and_not_the_folder() {
    let write = |text: &str| {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("scene.xml");
        std::fs::write(
            folder.path().join("t.obj"),
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n",
        )
        .unwrap();
        std::fs::write(&file, text).unwrap();
        (folder, file)
    };
    let xml = |r: f64| {
        format!(
            "<mujoco><asset><mesh name='t' file='t.obj'/></asset><worldbody><geom type='mesh' mesh='t'/><geom size='{r}'/></worldbody></mujoco>"
        )
    };
    let (a, b, c) = (write(&xml(0.5)), write(&xml(0.5)), write(&xml(0.6)));
    let hash = |f: &Path, n: usize| Scene::build(&SceneSource::file(f), &vec![ball(); n]).unwrap().hash();
    assert_eq!(hash(&a.1, 2), hash(&b.1, 2));
    assert_ne!(hash(&a.1, 2), hash(&c.1, 2));
    assert_ne!(hash(&a.1, 2), hash(&a.1, 1));
    assert_eq!(hash(&a.1, 2).len(), 64);
}

#[test]
fn huge_numbers_and_deep_trees_do_not_crash() {
    let deep = format!(
        "<mujoco><worldbody>{}<geom size='1'/>{}</worldbody></mujoco>",
        "<body>".repeat(3000),
        "</body>".repeat(3000)
    );
    let wide: String =
        (0..3000).map(|i| format!("<geom type='box' size='0.1 0.1 0.1' pos='{i} 0 0'/>")).collect();
    let cases = [
        deep,
        format!("<mujoco><worldbody>{wide}</worldbody></mujoco>"),
        "<mujoco><worldbody><geom size='1e300'/><geom size='1e-300'/></worldbody></mujoco>".into(),
        "<mujoco><worldbody><geom size='1' pos='1e200 0 0'/></worldbody></mujoco>".into(),
        "<mujoco><worldbody><geom size='1' pos='nan 0 0'/></worldbody></mujoco>".into(),
        "<mujoco><worldbody><camera name='c' fovy='0'/><geom size='1'/></worldbody></mujoco>".into(),
    ];
    for xml in cases {
        match Scene::build(&text(&xml), &[ball()]) {
            Err(e) => assert!(e.to_string().len() > 20),
            Ok(scene) => {
                let mut worker = scene.worker().unwrap();
                worker.collide().unwrap();
                Queries::at(&mut worker).clearance(0, 10.0).unwrap();
                let camera =
                    Camera::in_world(&scene, Pose::default(), Lens::Fovy { fovy_deg: 60.0 }).unwrap();
                camera.render(&mut worker, &mut DepthFrame::new()).unwrap();
            }
        }
    }
}

/// The folder of the installed `mujoco` wheel, or the reason why there is none.
fn wheel() -> Result<PathBuf, String> {
    if let Some(dir) = std::env::var_os("PROPWASH_MUJOCO_TESTDATA") {
        return Ok(PathBuf::from(dir));
    }
    let python = std::env::var("PROPWASH_PYTHON").map_err(|_| "PROPWASH_PYTHON is not set".to_string())?;
    let out = Command::new(&python)
        .args(["-c", "import mujoco, os; print(os.path.dirname(mujoco.__file__))"])
        .output()
        .map_err(|e| format!("{python}: {e}"))?;
    if !out.status.success() {
        return Err(format!(
            "{python} cannot import mujoco: {}",
            String::from_utf8_lossy(&out.stderr).trim()
        ));
    }
    Ok(PathBuf::from(String::from_utf8_lossy(&out.stdout).trim()))
}

fn xml_files(dir: &Path, out: &mut Vec<PathBuf>) {
    let Ok(entries) = std::fs::read_dir(dir) else { return };
    let mut entries: Vec<_> = entries.flatten().map(|e| e.path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            xml_files(&path, out);
        } else if path.extension().is_some_and(|e| e == "xml" || e == "urdf") {
            out.push(path);
        }
    }
}

#[test]
fn every_scene_of_the_mujoco_wheel_loads_or_fails_with_mujocos_reason() {
    let dir = match wheel() {
        Ok(dir) => dir,
        Err(why) => {
            assert!(
                std::env::var_os("PROPWASH_REQUIRE_PEERS").is_none(),
                "the mujoco wheel is required: {why}"
            );
            println!("skipped: {why}");
            return;
        }
    };
    let mut files = Vec::new();
    xml_files(&dir, &mut files);
    assert!(!files.is_empty(), "no XML under {}", dir.display());
    let (mut loaded, mut refused) = (0, 0);
    for file in &files {
        let name = file.strip_prefix(&dir).unwrap_or(file).display().to_string();
        match Scene::build(&SceneSource::file(file), &[ball(), ball()]) {
            Err(error) => {
                println!("refused {name}: {error}");
                assert!(matches!(error, SceneError::Parse { .. } | SceneError::Compile { .. }), "{error}");
                refused += 1;
            }
            Ok(scene) => {
                loaded += 1;
                let mut worker = scene.worker().unwrap();
                worker.set_drone(0, [0.0, 0.0, 1.0], LEVEL).unwrap();
                worker.set_drone(1, [0.0, 0.05, 1.0], LEVEL).unwrap();
                worker.update().unwrap();
                let mut found = Vec::new();
                Queries::at(&mut worker).contacts(&mut found).unwrap();
                assert!(found.iter().any(|c| c.other_drone == Some(1)), "{name}");
                let c = Queries::at(&mut worker).clearance(0, 20.0).unwrap();
                assert!(c.found && c.distance_m <= -0.15 + 1e-9, "{name} {c:?}");
                worker.ground_distance(0).unwrap();
                let mut frame = DepthFrame::new();
                Camera::on_drone(&scene, 0, "fpv")
                    .unwrap()
                    .with_size(16, 16)
                    .unwrap()
                    .render(&mut worker, &mut frame)
                    .unwrap();
                for info in scene.cameras().iter().filter(|c| !c.orthographic && !c.name.is_empty()) {
                    let camera = Camera::from_scene(&scene, &info.name).unwrap().with_size(8, 8).unwrap();
                    camera.render(&mut worker, &mut frame).unwrap();
                }
                let report = propwash::scene::lint(&SceneSource::file(file), [0.0, 0.0, 1.0], 0.1).unwrap();
                assert_eq!(report.geoms.len() + 2, scene.geoms().len(), "{name}");
            }
        }
    }
    println!("{} files of {}: {loaded} loaded, {refused} refused by MuJoCo", files.len(), dir.display());
    assert!(loaded >= 1);
}

#[test]
fn plugins_of_the_wheel_make_fields_that_are_seen_and_touched() {
    let library = wheel().map(|d| d.join("plugin").join("libsdf_plugin.so"));
    let library = match library {
        Ok(library) if library.is_file() => library,
        Ok(library) => return println!("skipped: no {}", library.display()),
        Err(why) => {
            assert!(
                std::env::var_os("PROPWASH_REQUIRE_PEERS").is_none(),
                "the mujoco wheel is required: {why}"
            );
            return println!("skipped: {why}");
        }
    };
    load_plugin_library(&library).unwrap();
    let xml = "<mujoco><extension><plugin plugin='mujoco.sdf.torus'><instance name='t'/></plugin></extension>
        <asset><mesh name='t'><plugin instance='t'/></mesh></asset>
        <worldbody><geom type='sdf' mesh='t'><plugin instance='t'/></geom></worldbody></mujoco>";
    let scene = Scene::build(&text(xml), &[ball()]).unwrap();
    let mut worker = scene.worker().unwrap();
    // The torus of the plugin: radii 0.35 and 0.15 about z by default.
    let reach = scene.geoms()[0].bounding_radius_m;
    worker.set_drone(0, [reach + 1.0, 0.0, 0.0], LEVEL).unwrap();
    worker.update().unwrap();
    let body = scene.drone_body(0).ok();
    let hit = worker.ray([reach + 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], None, body).unwrap().unwrap();
    assert_eq!(hit.geom_id, 0);
    let c = Queries::at(&mut worker).clearance(0, 9.0).unwrap();
    assert!(c.exact && (c.distance_m - (hit.distance - 0.1)).abs() < 2e-2, "{c:?} {hit:?}");
    worker.set_drone(0, [reach + 1.0 - hit.distance + 0.05, 0.0, 0.0], LEVEL).unwrap();
    worker.update().unwrap();
    let mut found = Vec::new();
    Queries::at(&mut worker).contacts(&mut found).unwrap();
    assert!(!found.is_empty());
}

/// Shells and scenes that come with the crate.
#[test]
fn the_shells_of_the_crate_fly_in_its_scenes() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("xml");
    let mut shells = Vec::new();
    xml_files(&root.join("shells"), &mut shells);
    let shells: Vec<Shell> = shells
        .iter()
        .map(|path| Shell {
            name: path.file_stem().unwrap().to_string_lossy().into_owned(),
            xml: std::fs::read_to_string(path).unwrap(),
            dir: path.parent().map(Path::to_path_buf),
        })
        .collect();
    assert!(!shells.is_empty());
    let mut scenes = vec![text("<mujoco><worldbody><geom type='plane' size='0 0 1'/></worldbody></mujoco>")];
    let mut files = Vec::new();
    xml_files(&root, &mut files);
    scenes.extend(files.into_iter().filter(|f| f.parent() == Some(root.as_path())).map(SceneSource::File));
    for source in &scenes {
        let scene = Scene::build(source, &shells).unwrap();
        let mut worker = scene.worker().unwrap();
        for drone in 0..shells.len() {
            worker.set_drone(drone, [2.0 * drone as f64, 0.0, 400.0], LEVEL).unwrap();
        }
        worker.update().unwrap();
        let mut found = Vec::new();
        Queries::at(&mut worker).contacts(&mut found).unwrap();
        assert_eq!(found, [], "{source:?}");
        for drone in 0..shells.len() {
            assert!(scene.drone_radius_m(drone).unwrap() > 0.02);
            let camera = Camera::on_drone(&scene, drone, "fpv").unwrap().with_size(24, 24).unwrap();
            let mut frame = DepthFrame::new();
            camera.render(&mut worker, &mut frame).unwrap();
            let own =
                frame.geom_id.iter().filter(|g| **g >= 0 && scene.geoms()[**g as usize].drone == Some(drone));
            assert_eq!(own.count(), 0);
        }
    }
    println!("{} shells in {} scenes", shells.len(), scenes.len());
}

#[test]
fn no_log_file_is_written() {
    // MuJoCo writes its warnings to MUJOCO_LOG.TXT in the current folder: this test runs itself in an empty one.
    const CHILD: &str = "PROPWASH_TEST_IN_EMPTY_FOLDER";
    if std::env::var_os(CHILD).is_none() {
        let folder = tempfile::tempdir().unwrap();
        let child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "no_log_file_is_written"])
            .env(CHILD, "1")
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert!(child.status.success(), "{}", String::from_utf8_lossy(&child.stdout));
        let left: Vec<_> =
            std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert!(left.is_empty(), "left behind: {left:?}");
        return;
    }
    let xml = "<mujoco><worldbody><flexcomp name='f' type='grid' count='3 3 1' spacing='0.1 0.1 0.1' dim='2' pos='0 0 1' radius='0.01' mass='1'/></worldbody></mujoco>";
    let scene = Scene::build(&text(xml), &[ball()]).unwrap();
    assert!(scene.warnings().iter().any(|w| w.contains("flex")), "{:?}", scene.warnings());
    scene.worker().unwrap().collide().unwrap();
    assert!(matches!(load_plugin_library(Path::new("/no/such/plugin.so")), Err(SceneError::Read { .. })));
}

#[test]
fn geoms_that_are_nowhere_are_refused_instead_of_hiding_others() {
    let wall = |attributes: &str| {
        format!(
            "<mujoco><worldbody><geom type='plane' size='5 5 1'/><body name='b' pos='1 0 0'>\
             <geom name='wall' type='box' {attributes}/></body></worldbody></mujoco>"
        )
    };
    for (attributes, words) in [
        ("size='1 1 1' pos='2 0 nan'", "position of geom 'wall'"),
        ("size='1 1 1' pos='1e200 0 0'", "position of geom 'wall'"),
        ("size='1 1 1' pos='inf 0 0'", "position of geom 'wall'"),
        ("size='1e300 1 1'", "size of geom 'wall'"),
        ("size='1 1 1' quat='nan 0 0 1'", "orientation of geom 'wall'"),
    ] {
        let message = fails(&wall(attributes), &[ball()]);
        assert!(
            message.contains(words) && message.contains("expected finite numbers"),
            "{attributes}: {message}"
        );
    }
    let far =
        "<mujoco><worldbody><body name='far' pos='0 -2e9 0'><geom size='1'/></body></worldbody></mujoco>";
    assert!(fails(far, &[]).contains("position of body 'far'"));
    // What MuJoCo says itself is passed on.
    let text = "<mujoco><worldbody><geom size='1' friction='nan 1 1'/></worldbody></mujoco>";
    let scene = Scene::build(&self::text(text), &[]).unwrap();
    assert!(scene.warnings().iter().any(|w| w.contains("NaN")), "{:?}", scene.warnings());
}

#[test]
fn files_that_include_themselves_or_no_file_are_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let built = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        Scene::build(&SceneSource::file(path), &[]).map_err(|e| e.to_string())
    };
    let own = "<include file='self.xml'/>".repeat(4);
    assert!(built("self.xml", &format!("<mujoco>{own}</mujoco>")).unwrap_err().contains("already included"));
    let endless = built("zero.xml", "<mujoco><include file='/dev/zero'/></mujoco>").unwrap_err();
    assert!(endless.contains("/dev/zero, which is not a file"), "{endless}");
    // Copies multiply through files.
    built(
        "part.xml",
        "<mujoco><worldbody><replicate count='200'><geom size='1'/></replicate></worldbody></mujoco>",
    )
    .unwrap();
    let many = "<mujoco><worldbody><replicate count='200'><include file='part.xml'/></replicate></worldbody></mujoco>";
    let message = built("many.xml", many).unwrap_err();
    assert!(message.contains("<replicate> on line 1") && message.contains("smaller"), "{message}");
}

#[test]
fn mujocos_own_plugins_are_there() {
    let torus = "<mujoco><extension><plugin plugin='mujoco.sdf.torus'><instance name='t'>\
                 <config key='radius1' value='0.35'/><config key='radius2' value='0.15'/></instance></plugin></extension>\
                 <asset><mesh name='t'><plugin instance='t'/></mesh></asset>\
                 <worldbody><geom name='ring' type='sdf' mesh='t'><plugin instance='t'/></geom></worldbody></mujoco>";
    let scene = Scene::build(&text(torus), &[ball()]).unwrap();
    let mut worker = scene.worker().unwrap();
    worker.set_drone(0, [0.35, 0.0, 1.0], LEVEL).unwrap();
    worker.update().unwrap();
    let below = worker.ground_distance(0).unwrap();
    assert!(below.is_some_and(|d| (d - 0.85).abs() < 0.02), "{below:?}");
}

/// A square frame around a square hole, as a mesh: what a gate is, in an asset called `name`.
fn frame(name: &str) -> String {
    let square = |half: f64, x: f64| {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(y, z)| format!("{x} {} {}", half * y, half * z))
            .join(" ")
    };
    // Outer and inner corners of the front, then of the back.
    let vertices = [square(0.5, 0.05), square(0.4, 0.05), square(0.5, -0.05), square(0.4, -0.05)].join(" ");
    let mut faces = String::new();
    for k in 0..4 {
        let l = (k + 1) % 4;
        for [a, b, c, d] in [
            [k, l, 4 + l, 4 + k],
            [8 + l, 8 + k, 12 + k, 12 + l],
            [8 + k, 8 + l, l, k],
            [4 + k, 4 + l, 12 + l, 12 + k],
        ] {
            faces += &format!("{a} {b} {c} {a} {c} {d} ");
        }
    }
    format!("<mesh name='{name}' vertex='{vertices}' face='{faces}'/>")
}

#[test]
fn meshes_whose_holes_collisions_close_are_told_of() {
    let scene = |geoms: &str| {
        let solid = "-.5 -.5 0 .5 -.5 0 .5 .5 0 -.5 .5 0 0 0 .7";
        let asset = format!("<asset>{}<mesh name='solid' vertex='{solid}'/></asset>", frame("gate"));
        let text = format!("<mujoco>{asset}<worldbody>{geoms}</worldbody></mujoco>");
        Scene::build(&SceneSource::text("meshes", text), &[]).unwrap()
    };
    let told = |s: &Scene| s.warnings().iter().find(|w| w.contains("hollow")).cloned();
    let gate = "<geom name='gate' type='mesh' mesh='gate' pos='0 0 1'/>";
    let said = told(&scene(gate)).unwrap();
    assert!(
        said.contains("1 mesh is hollow and collides as its convex hull") && said.contains("geom 'gate'"),
        "{said}"
    );
    assert!(said.contains("several convex geoms"), "{said}");
    // By seven of them four are named.
    let many: String =
        (0..7).map(|i| format!("<geom name='g{i}' type='mesh' mesh='gate' pos='{i} 0 1'/>")).collect();
    let said = told(&scene(&many)).unwrap();
    assert!(
        said.contains("7 meshes are hollow") && said.contains("'g3'") && !said.contains("'g4'"),
        "{said}"
    );
    // Not convex ones, nor those that nothing collides with, nor such as are too small to fly into.
    let fine = "<geom type='mesh' mesh='solid' pos='0 0 3'/>\
        <geom type='mesh' mesh='gate' contype='0' conaffinity='0'/>";
    assert_eq!(told(&scene(fine)), None);
}

#[test]
fn a_compiled_scene_comes_back_from_its_bytes() {
    let shells = [Shell::builtin("cf2x").unwrap(), Shell::builtin("hb_x500").unwrap()];
    let names: Vec<String> = shells.iter().map(|s| s.name.clone()).collect();
    for file in ["zoo.xml", "terrain.xml", "forest.xml"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("xml").join(file);
        let scene = Scene::build(&SceneSource::file(path), &shells).unwrap();
        let bytes = scene.to_mjb();
        let again = Scene::from_mjb(file, &bytes, &names).unwrap();
        assert_eq!(again.hash(), scene.hash());
        assert_eq!(
            (again.geoms(), again.bodies(), again.obstacles()),
            (scene.geoms(), scene.bodies(), scene.obstacles())
        );
        for geom in scene.geoms() {
            assert_eq!(again.mesh(geom.id).map(|m| m.faces), scene.mesh(geom.id).map(|m| m.faces));
            assert_eq!(again.hfield(geom.id).map(|h| h.data), scene.hfield(geom.id).map(|h| h.data));
        }
        // Poses can be set and looked at.
        let mut worker = again.worker().unwrap();
        worker.set_drone(1, [0.0, 0.5, 2.0], [0.0, 0.0, 0.0, 1.0]).unwrap();
        worker.update().unwrap();
        assert_eq!(worker.drone_pose(1).unwrap().pos_m, [0.0, 0.5, 2.0]);
        assert!(matches!(
            Scene::from_mjb(file, &bytes[..bytes.len() / 2], &names),
            Err(SceneError::Compile { .. })
        ));
        assert!(matches!(Scene::from_mjb(file, b"no model", &names), Err(SceneError::Compile { .. })));
        let more = [names.clone(), vec!["cf2x".into()]].concat();
        assert!(matches!(Scene::from_mjb(file, &bytes, &more), Err(SceneError::Shell { .. })));
    }
}

#[test]
fn damaged_bytes_of_a_scene_end_in_an_error_or_in_a_scene() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("xml/zoo.xml");
    let bytes = Scene::build(&SceneSource::file(path), &[Shell::builtin("cf2x").unwrap()]).unwrap().to_mjb();
    let mut seed = 1u64;
    let mut random = |n: usize| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) as usize % n
    };
    let mut refused = 0;
    for _ in 0..150 {
        let mut damaged = bytes.clone();
        for _ in 0..1 + random(8) {
            // Half of them among the sizes and references, which stand first.
            let at = if random(2) == 0 { random(bytes.len()) } else { random(60_000.min(bytes.len())) };
            damaged[at] = random(256) as u8;
        }
        match Scene::from_mjb("damaged", &damaged, &["cf2x".to_string()]) {
            Ok(scene) => drop(scene.worker().map(|mut w| w.update())),
            Err(_) => refused += 1,
        }
    }
    assert!(refused > 5, "{refused}");
}
