//! What depth keeps in memory. Alone in its program, since it counts all allocations of Rust's; MuJoCo's own are not seen.

#[path = "common/allocations.rs"]
mod allocations;

use std::fmt::Write as _;

use allocations::used;
use propwash::scene::{Pose, Scene, SceneSource, Shell, Worker, WorkerPool};
use propwash::sense::{
    Camera, Caster, DepthBatch, DepthFrame, DepthKind, Queries, RayPattern, RayPlanes, RayQuery, WorldPoses,
};

/// `n` posts on a floor, a mesh, a height field, and a drone with a camera.
fn grove(n: usize) -> Scene {
    let mut geoms = String::from("<geom type='plane' size='0 0 1'/><geom type='mesh' mesh='m' pos='9 3 1'/>");
    geoms += "<geom type='hfield' hfield='h' pos='12 -2 0'/>";
    for k in 0..n {
        let (x, y) = (3.0 + (k % 32) as f64, (k / 32) as f64 - 8.0);
        let kind = ["cylinder", "capsule", "box", "ellipsoid", "sphere"][k % 5];
        let _ = write!(geoms, "<geom type='{kind}' size='.1 .3 .5' pos='{x} {y} .5'/>");
    }
    let heights: Vec<String> = (0..100).map(|k| format!("{}", f64::from(k * 37 % 11) / 11.0)).collect();
    let assets = format!(
        "<mesh name='m' builtin='supertorus' params='20 0.4 1 1'/>\
         <hfield name='h' nrow='10' ncol='10' size='2 2 1 .1' elevation='{}'/>",
        heights.join(" ")
    );
    let shell = Shell {
        name: "ball".into(),
        xml: "<mujoco><worldbody><body name='drone'><geom size='.05'/>\
              <camera name='fpv' xyaxes='0 -1 0 0 0 1' fovy='60'/></body></worldbody></mujoco>"
            .into(),
        dir: None,
    };
    let xml = format!("<mujoco><asset>{assets}</asset><worldbody>{geoms}</worldbody></mujoco>");
    Scene::build(&SceneSource::text("grove", &xml), &[shell]).unwrap()
}

fn look(worker: &mut Worker, step: usize) {
    // First at the sky, where nothing is, then at ever more.
    let (nod, x) = if step == 0 { (-0.7, 0.0) } else { (0.1, 4.0 - step as f64) };
    let turn = [0.0, (0.5f64 * nod).sin(), 0.0, (0.5f64 * nod).cos()];
    worker.set_drone(0, [x, 0.0, 1.0], turn).unwrap();
    worker.update().unwrap();
}

#[test]
fn memory_grows_with_pixels_only_and_frames_allocate_nothing() {
    a_cameras_constants_grow_with_its_pixels_only();
    no_frame_allocates_once_the_worker_has_seen_its_size();
    depth_of_1024_worlds_takes_less_than_twice_its_output();
}

fn a_cameras_constants_grow_with_its_pixels_only() {
    for n in [10, 1000] {
        let scene = grove(n);
        for (width, height) in [(128, 96), (640, 480), (1920, 1080)] {
            let camera = Camera::on_drone(&scene, 0, "fpv").unwrap();
            let (camera, bytes, _) = used(|| camera.with_size(width, height).unwrap());
            let each = bytes as f64 / (width * height) as f64;
            println!("{n} posts, {width} x {height}: {each:.2} bytes of constants a pixel");
            // Three f32 a pixel, a hundred bytes for 64 pixels, and some for each row and column.
            assert!(each > 12.0 && each < 16.0, "{width} x {height}: {each}");
            // A frame needs nothing beside it that grows with its pixels.
            let mut worker = scene.worker().unwrap();
            let mut frame = DepthFrame::new();
            camera.clone().with_size(8, 8).unwrap().render(&mut worker, &mut frame).unwrap();
            let (_, bytes, _) = used(|| camera.render(&mut worker, &mut frame).unwrap());
            assert!(bytes <= 13 * (width * height) as isize, "{n}, {width} x {height}: {bytes}");
        }
    }
}

fn no_frame_allocates_once_the_worker_has_seen_its_size() {
    let scene = grove(400);
    let base = Camera::on_drone(&scene, 0, "fpv").unwrap();
    let cameras = [
        base.clone().with_size(64, 64).unwrap(),
        base.clone().with_size(61, 37).unwrap(),
        base.clone().with_size(64, 64).unwrap().with_normals(true).with_kind(DepthKind::ZDepth),
        base.clone().with_size(64, 64).unwrap().with_caster(Caster::MuJoCo),
    ];
    for (k, camera) in cameras.iter().enumerate() {
        let mut worker = scene.worker().unwrap();
        let mut frame = DepthFrame::new();
        look(&mut worker, 0);
        camera.render(&mut worker, &mut frame).unwrap();
        let few = frame.geom_id.iter().filter(|g| **g >= 0).count();
        let mut most = 0;
        for step in 1..6 {
            look(&mut worker, step);
            let (_, _, count) = used(|| camera.render(&mut worker, &mut frame).unwrap());
            assert_eq!(count, 0, "camera {k}, frame {step}");
            most = most.max(frame.geom_id.iter().filter(|g| **g >= 0).count());
        }
        assert!(most > 2 * few + 100, "{few} {most}");
    }
    let ring: Vec<[f64; 3]> = (0..720).map(|k| 0.5 * f64::from(k)).map(ring).collect();
    let pattern = RayPattern::new(&ring).unwrap();
    let (mut range, mut normal) = (vec![0.0; 720], vec![[0.0; 3]; 720]);
    let mut worker = scene.worker().unwrap();
    let mut cast = |z: f64| {
        let pose = Pose::new([0.0, 0.0, z], [0.0, 0.0, 0.0, 1.0]);
        let planes =
            RayPlanes { range_m: Some(&mut range), normal: Some(&mut normal), ..RayPlanes::default() };
        Queries::at(&mut worker).pattern(&pose, &pattern, &RayQuery::default(), planes).unwrap();
    };
    cast(50.0);
    let (_, _, count) = used(|| cast(0.5));
    assert_eq!(count, 0, "pattern");
    assert!(range.iter().filter(|r| r.is_finite()).count() > 100);
}

fn ring(degrees: f64) -> [f64; 3] {
    let a = degrees.to_radians();
    [a.cos(), a.sin(), 0.0]
}

fn depth_of_1024_worlds_takes_less_than_twice_its_output() {
    const WORLDS: usize = 1024;
    let scene = grove(40);
    let pos: Vec<f64> = (0..WORLDS).flat_map(|w| [-(w as f64) * 0.01, 0.0, 1.0]).collect();
    let quat: Vec<f64> = (0..WORLDS).flat_map(|_| [0.0, 0.0, 0.0, 1.0]).collect();
    let poses = WorldPoses {
        n_worlds: WORLDS,
        drone_pos_m: &pos,
        drone_quat_xyzw: &quat,
        obstacle_pos_m: None,
        obstacle_quat_xyzw: None,
    };
    // All that is Rust's: camera, threads' workers, what the caster keeps of the scene, and the output.
    let (out, bytes, _) = used(|| {
        let camera = Camera::on_drone(&scene, 0, "fpv").unwrap().with_size(64, 64).unwrap();
        let mut out = DepthBatch::default();
        out.render(&poses.within(&WorkerPool::new(&scene)), &[camera]).unwrap();
        out
    });
    let output = 13 * out.depth_m.len() + WORLDS * size_of::<Pose>();
    println!("1024 worlds: {bytes} bytes at most, {output} of them the output");
    assert_eq!(out.depth_m.len(), WORLDS * 64 * 64);
    assert!(out.geom_id.iter().any(|g| *g >= 0));
    assert!(bytes >= output as isize && bytes < 2 * output as isize, "{bytes} {output}");
}
