//! Depth images by the native ray caster and by `mj_multiRay`, alternately, on one core.
//!
//! `cargo xtask bench depth --help`. Prints a Markdown table of median frames per second.

#[path = "common/forest.rs"]
mod forest;

use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;
use forest::{draws, forest, hills, median, processor};
use propwash::math::quat;
use propwash::scene::{Pose, Scene, SceneSource, mujoco_version};
use propwash::sense::{Camera, DepthFrame, Lens, caster};

type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

/// Renders depth images in forests, over a mesh and over a height field, by the native caster and by MuJoCo in turn.
#[derive(Parser)]
struct Args {
    /// How often each of the two renders all cameras of a scene; the median counts.
    #[arg(long, default_value_t = 9, value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,
    /// Side of the images, pixels.
    #[arg(long, default_value_t = 64)]
    side: usize,
    /// Cameras of each scene.
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..))]
    cameras: u32,
    /// Only scenes whose name holds this.
    #[arg(long, default_value = "")]
    scene: String,
    /// Leaves MuJoCo's rays out, for profiles.
    #[arg(long)]
    ours_alone: bool,
    /// Adds surface normals to the frames of both.
    #[arg(long)]
    normals: bool,
    /// Ignored; `cargo bench` passes it.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &Args) -> Fallible<()> {
    println!(
        "{}, one core, lanes {}; MuJoCo {}, propwash {}; {side} × {side} pixels, {} cameras, medians of {} rounds\n",
        processor(),
        caster::lanes_in_use(),
        mujoco_version(),
        env!("CARGO_PKG_VERSION"),
        args.cameras,
        args.rounds,
        side = args.side,
    );
    println!(
        "| scene | geoms | mj_multiRay, frames/s | Propwash, frames/s | Mrays/s | ratio | pixels that differ |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    let mut scenes = Vec::new();
    for n in [10, 40, 200, 1000] {
        scenes.push((format!("forest {n}"), forest(n, "", "")));
    }
    scenes.push((
        "mesh of 20,000 triangles, forest 10".into(),
        forest(
            10,
            "<mesh name='m' builtin='supertorus' params='100 0.5 1 1' scale='3 3 3'/>",
            "<geom type='mesh' mesh='m' pos='0 0 2'/>",
        ),
    ));
    scenes.push((
        "height field 100 × 100, forest 10".into(),
        forest(
            10,
            &format!("<hfield name='h' nrow='100' ncol='100' size='6 6 1 0.1' elevation='{}'/>", hills(100)),
            "<geom type='hfield' hfield='h'/>",
        ),
    ));
    for (name, xml) in scenes {
        if name.contains(&args.scene) {
            measure(args, &name, &xml)?;
        }
    }
    Ok(())
}

fn measure(args: &Args, name: &str, xml: &str) -> Fallible<()> {
    let scene = Scene::build(&SceneSource::text(name, xml), &[])?;
    let mut worker = scene.worker()?;
    let mut s = draws(1);
    let reach = 2.0 * (scene.geoms().len().min(1000) as f64).sqrt();
    let mut cameras = Vec::new();
    for _ in 0..args.cameras {
        let pos = [s.uniform(-reach, reach), s.uniform(-reach, reach), s.uniform(0.8, 2.5)];
        let (yaw, pitch) = (s.uniform(-3.1, 3.1), s.uniform(-0.2, 0.3));
        cameras.push(
            Camera::in_world(&scene, looking(pos, yaw, pitch), Lens::Fovy { fovy_deg: 45.0 })?
                .with_size(args.side, args.side)?
                .with_normals(args.normals),
        );
    }
    let pixels = args.side * args.side;
    let mut frame = DepthFrame::new();
    let (mut distances, mut geoms) = (vec![0.0; pixels], vec![0; pixels]);
    let mut normals = args.normals.then(|| vec![[0.0; 3]; pixels]);
    let mut rays = Vec::new();
    let mut differ = 0;
    for camera in &cameras {
        let pose = camera.pose(&worker)?;
        let directions: Vec<[f64; 3]> =
            camera.rays().iter().map(|d| quat::rotate(pose.quat_xyzw, *d)).collect();
        camera.render(&mut worker, &mut frame)?;
        if !args.ours_alone {
            worker.rays(pose.pos_m, &directions, None, None, &mut distances, &mut geoms, None)?;
            differ += frame.geom_id.iter().zip(&geoms).filter(|(a, b)| a != b).count();
        }
        rays.push((pose.pos_m, directions));
    }
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    for _ in 0..args.rounds {
        let start = Instant::now();
        let mut frames = 0;
        while frames == 0 || start.elapsed().as_secs_f64() < 0.05 {
            for camera in &cameras {
                camera.render(&mut worker, &mut frame)?;
                frames += 1;
            }
        }
        ours.push(f64::from(frames) / start.elapsed().as_secs_f64());
        if args.ours_alone {
            continue;
        }
        let start = Instant::now();
        let mut frames = 0;
        while frames == 0 || start.elapsed().as_secs_f64() < 0.05 {
            for (pos, directions) in &rays {
                worker.rays(
                    *pos,
                    directions,
                    None,
                    None,
                    &mut distances,
                    &mut geoms,
                    normals.as_deref_mut(),
                )?;
                frames += 1;
            }
        }
        theirs.push(f64::from(frames) / start.elapsed().as_secs_f64());
    }
    let (ours, theirs) = (median(&mut ours), median(&mut theirs));
    let rate = ours * pixels as f64 / 1e6;
    println!(
        "| {name} | {} | {theirs:.0} | {ours:.0} | {rate:.0} | {:.0} | {differ} of {} |",
        scene.geoms().len(),
        ours / theirs,
        pixels * cameras.len()
    );
    Ok(())
}

fn looking(pos: [f64; 3], yaw: f64, pitch: f64) -> Pose {
    let turn = [0.0, 0.0, (0.5 * yaw).sin(), (0.5 * yaw).cos()];
    let nod = [0.0, (0.5 * pitch).sin(), 0.0, (0.5 * pitch).cos()];
    let ahead = propwash::sense::depth::LOOKING_FORWARD_XYZW;
    Pose::new(pos, quat::mul(quat::mul(turn, nod), ahead))
}
