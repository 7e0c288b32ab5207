//! The lint says what rays and contacts really do: each verdict is checked by a ray and by a probe.

use propwash::scene::{GeomType, Pose, Scene, SceneSource, Shell, Worker, lint, lint_source};
use propwash::sense::{Camera, DepthFrame, Lens, PixelStatus, Queries};

const LEVEL: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

fn probe(radius: f64) -> Shell {
    Shell {
        name: "probe".into(),
        xml: format!(
            "<mujoco><worldbody><body name='drone'><geom type='sphere' size='{radius}'/></body></worldbody></mujoco>"
        ),
        dir: None,
    }
}

/// Every type in five variants: plain, hidden group, invisible, invisible material, without contacts.
fn zoo() -> String {
    let shapes = [
        "type='hfield' hfield='h'",
        "type='sphere' size='0.3'",
        "type='capsule' size='0.2 0.2'",
        "type='ellipsoid' size='0.3 0.2 0.4'",
        "type='cylinder' size='0.3 0.3'",
        "type='box' size='0.3 0.3 0.3'",
        "type='mesh' mesh='m'",
        "type='sdf' mesh='s'",
    ];
    let variants = [
        "",
        "group='3'",
        "group='5' contype='0' conaffinity='0'",
        "rgba='1 1 1 0'",
        "material='glass'",
        "material='solid' rgba='0 0 0 0'",
        "contype='0' conaffinity='0'",
        "contype='0' conaffinity='2'",
        "contype='4' conaffinity='0' rgba='1 1 1 0.3'",
    ];
    let mut geoms = String::new();
    for (i, shape) in shapes.iter().enumerate() {
        for (j, variant) in variants.iter().enumerate() {
            // On static bodies, mocap bodies and hinges in turn.
            let body = match (i + j) % 3 {
                0 => "<body",
                1 => "<body mocap='true'",
                _ => "<body",
            };
            let joint = if (i + j) % 3 == 2 { "<joint type='slide' axis='1 0 0'/>" } else { "" };
            let mass = if joint.is_empty() { "" } else { "mass='1'" };
            if shape.contains("hfield") && !joint.is_empty() {
                geoms += &format!("<geom {shape} {variant} pos='{} {} 0'/>", 5 * i, 5 * j);
                continue;
            }
            geoms +=
                &format!("{body} pos='{} {} 0'>{joint}<geom {shape} {variant} {mass}/></body>", 5 * i, 5 * j);
        }
    }
    for (j, variant) in variants.iter().enumerate() {
        geoms += &format!("<geom type='plane' size='1 1 1' pos='{} {} -50' {variant}/>", 500 + 5 * j, 0);
    }
    format!(
        "<mujoco><asset><material name='glass' rgba='1 1 1 0'/><material name='solid' rgba='1 1 1 1'/>\
         <hfield name='h' nrow='3' ncol='3' size='0.4 0.4 0.3 0.1' elevation='0 0 0 0 1 0 0 0 0'/>\
         <mesh name='m' vertex='-0.3 -0.3 -0.3 0.3 -0.3 -0.3 0 0.3 -0.3 0 0 0.3'/>\
         <mesh name='s' builtin='supertorus' params='12 0.4 1 1' scale='0.4 0.4 0.4'/></asset>\
         <worldbody>{geoms}</worldbody></mujoco>"
    )
}

/// A geom is seen when a camera close to it gets its id in some pixel of an image.
fn is_seen(scene: &Scene, worker: &mut Worker, geom: usize) -> bool {
    let (p, _) = worker.geom_pose(geom).unwrap();
    // From above and a little aside, looking down: cameras look along -z.
    let pose = Pose::new([p[0] + 0.05, p[1] + 0.03, p[2] + 1.5], LEVEL);
    let camera =
        Camera::in_world(scene, pose, Lens::Fovy { fovy_deg: 60.0 }).unwrap().with_size(41, 41).unwrap();
    let mut frame = DepthFrame::new();
    camera.render(worker, &mut frame).unwrap();
    (0..frame.status.len())
        .any(|i| frame.status[i] == PixelStatus::Hit as u8 && frame.geom_id[i] == geom as i32)
}

/// A geom is touched when a probe that is moved over it makes a contact with it.
fn is_touched(scene: &Scene, worker: &mut Worker, geom: usize) -> bool {
    let (p, _) = worker.geom_pose(geom).unwrap();
    let mut found = Vec::new();
    for i in -6..=6 {
        for k in -4..=4 {
            worker.set_drone(0, [p[0] + 0.1 * f64::from(i), p[1], p[2] + 0.1 * f64::from(k)], LEVEL).unwrap();
            worker.update().unwrap();
            Queries::at(worker).contacts(&mut found).unwrap();
            if found.iter().any(|c| c.other_geom == geom as i32) {
                assert_eq!(scene.geoms()[geom].drone, None);
                return true;
            }
        }
    }
    false
}

#[test]
fn every_verdict_is_what_rays_and_contacts_do() {
    let source = SceneSource::text("zoo", zoo());
    let report = lint(&source, [0.0, 0.0, 20.0], 0.1).unwrap();
    let scene = Scene::build(&source, &[probe(0.06)]).unwrap();
    let mut worker = scene.worker().unwrap();
    assert_eq!(report.geoms.len() + 1, scene.geoms().len());
    let (mut counts, mut kinds) = ([0; 4], std::collections::BTreeSet::new());
    for line in &report.geoms {
        let info = &scene.geoms()[line.id];
        assert_eq!((info.kind, info.group), (line.kind, line.group));
        worker.set_drone(0, [-99.0, 0.0, 99.0], LEVEL).unwrap();
        worker.update().unwrap();
        let (seen, touched) =
            (is_seen(&scene, &mut worker, line.id), is_touched(&scene, &mut worker, line.id));
        assert_eq!(line.depth.seen, seen, "depth: {line:?}");
        assert_eq!(line.contact.seen, touched, "contact: {line:?}");
        assert_eq!(line.depth.reason.is_empty(), seen);
        assert_eq!(line.contact.reason.is_empty(), touched);
        counts[usize::from(seen) * 2 + usize::from(touched)] += 1;
        kinds.insert(line.kind.name());
    }
    assert_eq!(kinds.len(), GeomType::ALL.len());
    assert!(counts.iter().all(|n| *n >= 9), "{counts:?}");
    assert_eq!(report.mismatches().count(), report.geoms.len() - counts[3]);
}

fn remarks(xml: &str) -> (Vec<String>, Vec<String>) {
    let report = lint_source(&SceneSource::text("test", xml)).unwrap();
    let geoms = report.geoms.iter().map(|g| g.remarks.join("; ")).collect();
    (geoms, report.remarks)
}

#[test]
fn concave_meshes_are_named_and_convex_ones_are_not() {
    let xml = "<mujoco><asset>
        <mesh name='torus' builtin='supertorus' params='20 0.3 1 1'/>
        <mesh name='ball' builtin='sphere' params='2'/>
        <mesh name='box' vertex='0 0 0 1 0 0 0 1 0 1 1 0 0 0 1 1 0 1 0 1 1 1 1 1'/>
        <mesh name='ell' vertex='0 0 0 2 0 0 2 1 0 1 1 0 1 2 0 0 2 0 0 0 1 2 0 1 2 1 1 1 1 1 1 2 1 0 2 1'
          face='0 2 1 0 3 2 0 4 3 0 5 4 6 7 8 6 8 9 6 9 10 6 10 11 0 1 7 0 7 6 1 2 8 1 8 7 2 3 9 2 9 8 3 4 10 3 10 9 4 5 11 4 11 10 5 0 6 5 6 11'/>
        </asset><worldbody>
        <geom type='mesh' mesh='torus' pos='5 0 0'/><geom type='mesh' mesh='ball' pos='10 0 0'/>
        <geom type='mesh' mesh='box' pos='15 0 0'/><geom type='mesh' mesh='ell' pos='20 0 0'/>
        <geom type='mesh' mesh='torus' pos='25 0 0' contype='0' conaffinity='0'/></worldbody></mujoco>";
    let (geoms, _) = remarks(xml);
    let concave: Vec<bool> = geoms.iter().map(|r| r.contains("concave")).collect();
    assert_eq!(concave, [true, false, false, true, false], "{geoms:?}");

    // And it is true: a probe in the hole of the torus touches the hull, though a ray passes.
    let scene = Scene::build(&SceneSource::text("test", xml), &[probe(0.1)]).unwrap();
    let mut worker = scene.worker().unwrap();
    let (p, _) = worker.geom_pose(0).unwrap();
    // (Not right at the centre: MuJoCo 3.17.0 finds nothing where two centres coincide to the last bit.)
    worker.set_drone(0, [p[0] + 1e-3, p[1] + 1e-3, p[2] + 1e-3], LEVEL).unwrap();
    worker.update().unwrap();
    let mut found = Vec::new();
    Queries::at(&mut worker).contacts(&mut found).unwrap();
    assert!(found.iter().any(|c| c.other_geom == 0));
    let body = scene.drone_body(0).unwrap();
    for axis in 0..3 {
        let mut direction = [0.0; 3];
        direction[axis] = 1.0;
        let passes = worker.ray(p, direction, None, Some(body)).unwrap().is_none_or(|h| h.geom_id != 0);
        if passes {
            return;
        }
    }
    panic!("no axis goes through the hole");
}

#[test]
fn what_may_surprise_is_said() {
    let xml = "<mujoco><worldbody>
        <geom name='floor' type='plane' size='3 2 1'/><geom name='endless' type='plane' size='0 0 1' pos='0 0 -1'/>
        <geom name='there' type='box' size='0.5 0.5 0.5' pos='0 0 1.2'/>
        <geom name='huge' type='box' size='3000 1 1' pos='0 50 0'/><geom name='tiny' type='sphere' size='0.0002' pos='9 9 9'/>
        <body name='gate' mocap='true' pos='8 0 1'><geom name='gate' type='box' size='0.1 1 1'/></body>
        <body name='door' pos='12 0 1'><joint/><geom name='door' type='box' size='0.1 1 1'/></body>
        <body name='tree' pos='16 0 1'><geom name='look' type='cylinder' size='0.3 1' contype='0' conaffinity='0'/>
          <geom name='hit' type='capsule' size='0.3 0.8' group='3'/></body>
        <geom name='window' type='box' size='0.1 1 1' pos='20 0 1' rgba='1 1 1 0.2'/>
        <geom name='soft' type='box' size='0.1 1 1' pos='24 0 1' margin='0.05'/></worldbody>
        <option><flag contact='disable'/></option></mujoco>";
    let report = lint(&SceneSource::text("test", xml), [0.0, 0.0, 1.0], 0.1).unwrap();
    let remark = |name: &str| {
        let g = report.geoms.iter().find(|g| g.name.contains(&format!("'{name}'"))).unwrap();
        g.remarks.join("; ")
    };
    for (name, words) in [
        ("floor", "rectangle (6 m x 4 m)"),
        ("endless", "endless"),
        ("there", "overlaps the spawn"),
        ("huge", "huge"),
        ("tiny", "tiny"),
        ("gate", "moves with obstacle 0 'gate' (mocap)"),
        ("door", "joint"),
        ("look", "'hit' seems to be its collision shape"),
        ("hit", "'look' seems to be its visual shape"),
        ("window", "transparent"),
        ("soft", "margin"),
    ] {
        assert!(remark(name).contains(words), "{name}: {}", remark(name));
    }
    assert!(report.spawn_is_blocked());
    assert!(report.remarks.iter().any(|r| r.contains("disables contacts")), "{:?}", report.remarks);
    let table = report.to_string();
    for words in ["geom 'floor'", "depth", "contact", "overlaps the spawn", "hidden", "11 geoms"] {
        assert!(table.contains(words), "{words}\n{table}");
    }
    let json = serde_json::to_value(&report).unwrap();
    assert_eq!(json["geoms"][0]["kind"], "plane");
    assert_eq!(json["geoms"][0]["depth"]["seen"], true);
    println!("{table}");
}

#[test]
fn scenes_without_floor_or_geoms_and_with_flexes_are_told() {
    let (_, notes) =
        remarks("<mujoco><worldbody><geom type='box' size='1 1 1' pos='9 0 0'/></worldbody></mujoco>");
    assert!(notes.iter().any(|n| n.contains("no floor")), "{notes:?}");
    let (geoms, notes) = remarks("<mujoco/>");
    assert!(geoms.is_empty() && notes.iter().any(|n| n.contains("no geoms")), "{notes:?}");
    let xml = "<mujoco><worldbody><geom type='plane' size='0 0 1'/><flexcomp name='cloth' type='grid' count='6 6 1' \
               spacing='0.3 0.3 0.3' dim='2' pos='0 0 2' radius='0.02' mass='1'><contact selfcollide='none'/></flexcomp></worldbody></mujoco>";
    let (geoms, notes) = remarks(xml);
    assert!(notes.iter().any(|n| n.contains("flex")) && geoms.len() == 1, "{notes:?}");
    // And it is true: no ray sees the cloth, a drone touches it.
    let scene = Scene::build(&SceneSource::text("cloth", xml), &[probe(0.1)]).unwrap();
    let mut worker = scene.worker().unwrap();
    worker.set_drone(0, [0.1, 0.1, 2.05], LEVEL).unwrap();
    worker.update().unwrap();
    let hit =
        worker.ray([0.1, 0.13, 5.0], [0.0, 0.0, -1.0], None, scene.drone_body(0).ok()).unwrap().unwrap();
    assert!((hit.distance - 5.0).abs() < 1e-9, "{hit:?}");
    let mut found = Vec::new();
    Queries::at(&mut worker).contacts(&mut found).unwrap();
    assert!(found.iter().any(|c| c.other_flex == 0 && c.other_geom == -1 && c.other_body == -1), "{found:?}");
    let (geoms, _) =
        remarks("<mujoco><worldbody><body><geom type='box' size='1 1 1'/></body></worldbody></mujoco>");
    assert_eq!(geoms.len(), 1);
    let report = lint_source(&SceneSource::text(
        "t",
        "<mujoco><worldbody><body name='wall'><geom type='box' size='1 1 1'/></body></worldbody></mujoco>",
    ))
    .unwrap();
    assert_eq!(report.geoms[0].name, "geom #0 (box in body wall)");
    assert!(lint(&SceneSource::text("t", "<mujoco/>"), [0.0; 3], -1.0).is_err());
    assert!(lint(&SceneSource::text("t", "<mujoco/>"), [f64::NAN; 3], 0.1).is_err());
    assert!(lint_source(&SceneSource::text("t", "<mujoco>")).is_err());
}
