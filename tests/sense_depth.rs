//! Depth images against single rays of MuJoCo, and the rules of the image.

use propwash::scene::{Pose, Scene, SceneSource, Shell};
use propwash::sense::{Camera, DepthFrame, DepthKind, Lens, PixelStatus};

fn shell() -> Shell {
    Shell {
        name: "ball".into(),
        xml: r#"<mujoco><worldbody><body name="drone"><geom name="hull" type="sphere" size="0.1"/>
            <camera name="fpv" pos="0.05 0 0" xyaxes="0 -1 0 0 0 1" fovy="90"/></body></worldbody></mujoco>"#
            .into(),
        dir: None,
    }
}

#[test]
fn a_red_sphere_at_the_upper_left_is_seen_in_the_first_rows_and_columns() {
    // The camera of the drone looks along world x; left is +y, up is +z.
    let xml = r#"<mujoco><worldbody><geom name="red" type="sphere" size="0.2" pos="2 1.5 1.5" rgba="1 0 0 1"/></worldbody></mujoco>"#;
    let scene = Scene::build(&SceneSource::text("upper left", xml), &[shell()]).unwrap();
    println!("{:?} {} {:?} arena {}", scene, scene.hash(), scene.warnings(), scene.arena_bytes());
    let mut worker = scene.worker().unwrap();
    worker.set_drone(0, [0.0; 3], [0.0, 0.0, 0.0, 1.0]).unwrap();
    worker.update().unwrap();
    let camera = Camera::on_drone(&scene, 0, "fpv").unwrap().with_size(32, 32).unwrap();
    let mut frame = DepthFrame::new();
    camera.render(&mut worker, &mut frame).unwrap();
    let seen: Vec<usize> = (0..32 * 32).filter(|i| frame.status[*i] == PixelStatus::Hit as u8).collect();
    assert!(!seen.is_empty());
    for i in seen {
        assert!(i / 32 < 12 && i % 32 < 12, "row {} column {}", i / 32, i % 32);
        assert_eq!(scene.geoms()[frame.geom_id[i] as usize].name, "red");
    }
    let custom = Camera::mounted(
        &scene,
        0,
        Pose::new([0.05, 0.0, 0.0], propwash::sense::depth::LOOKING_FORWARD_XYZW),
        Lens::Fovy { fovy_deg: 90.0 },
    )
    .unwrap()
    .with_size(32, 32)
    .unwrap()
    .with_kind(DepthKind::Range);
    let mut second = DepthFrame::new();
    custom.render(&mut worker, &mut second).unwrap();
    assert_eq!(frame.status, second.status);
}
