//! `propwash fly`: the main job.

use super::drones::find;
use super::{adjust, io_error, print, print_json};
use crate::cli::args::{FlyArgs, IntegratorArg};
use crate::cli::exit::Outcome;
use crate::dataset::recorder::{Course, Flight, Recorded, record};
use crate::dataset::{Dataset, Overview, recorder};
use crate::physics::integrate::Integrator;
use crate::rollout::randomize::Randomization;
use crate::rollout::trajectory::Spline;
use crate::scene::{Scene, SceneSource, Shell};
use crate::sense::{Camera, DepthNoise};
use crate::vehicle::Vehicle;
use crate::{Error, Result};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use std::path::Path;

/// Clearances beyond this are not looked for, m.
const CLEARANCE_MAX_M: f64 = 5.0;

/// Runs the command.
pub fn run(args: &FlyArgs) -> Result<Outcome> {
    let flight = flight(args)?;
    let recorded = match args.threads {
        None => fly(args, &flight)?,
        Some(n) => rayon::ThreadPoolBuilder::new()
            .num_threads(n)
            .build()
            .map_err(|e| Error::Usage {
                flag: "--threads",
                expected: "threads that start".into(),
                got: e.to_string(),
            })?
            .install(|| fly(args, &flight))?,
    };
    report(args, &recorded)?;
    Ok(Outcome::Fine)
}

fn fly(args: &FlyArgs, flight: &Flight) -> Result<Recorded> {
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} worlds, {elapsed} elapsed, {eta} to go");
    let bar = if args.json { ProgressBar::hidden() } else { ProgressBar::new(args.worlds as u64) };
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let recorded = record(flight, &args.out, &|done, _| bar.set_position(done as u64))?;
    bar.finish_and_clear();
    let map = recorder::height_map(flight)?;
    Overview::from_dataset(&Dataset::open(&args.out)?, map)?.draw()?.save(&args.out.join("overview.png"))?;
    Ok(recorded)
}

/// What the arguments ask for, everything loaded and checked.
fn flight(args: &FlyArgs) -> Result<Flight> {
    let usage =
        |flag, expected: &str, got: String| Err(Error::Usage { flag, expected: expected.into(), got });
    let n = args.drones_per_world.unwrap_or(args.drone.len());
    if n == 0 || n > 1024 {
        return usage("--drones-per-world", "1 to 1024 drones in one world", n.to_string());
    }
    if args.worlds == 0 {
        return usage("--worlds", "at least 1", "0".into());
    }
    if args.threads == Some(0) {
        return usage("--threads", "at least 1", "0".into());
    }
    let vehicles: Vec<Vehicle> =
        (0..n).map(|i| find(&args.drone[i % args.drone.len()])).collect::<Result<_>>()?;
    let shells: Vec<Shell> = vehicles.iter().map(|v| shell(args, v)).collect::<Result<_>>()?;
    let scene = Scene::build(&SceneSource::file(&args.scene), &shells)?;
    let cameras = (0..n).map(|d| camera(args, &scene, d)).collect::<Result<_>>()?;
    Ok(Flight {
        vehicles,
        dynamics: args.dynamics.clone(),
        n_worlds: args.worlds,
        seconds: args.seconds,
        sim_hz: args.sim_hz,
        fps: args.fps,
        log_hz: args.log_hz,
        integrator: match args.integrator {
            IntegratorArg::Euler => Integrator::Euler,
            IntegratorArg::SemiImplicitEuler => Integrator::SemiImplicitEuler,
            IntegratorArg::Rk4 => Integrator::Rk4,
        },
        seed: args.seed,
        course: course(&args.trajectory)?,
        cameras,
        randomization: match &args.randomize {
            None => Randomization::default(),
            Some(path) => Randomization::from_toml(&read(path)?)?,
        },
        obstacle_jitter_m: args.obstacle_jitter,
        noise: match &args.noise {
            None => None,
            Some(path) => Some(noise(path)?),
        },
        normals: args.normals,
        clearance_max_m: CLEARANCE_MAX_M,
        scene,
    })
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).map_err(io_error(path))
}

fn noise(path: &Path) -> Result<DepthNoise> {
    let model: DepthNoise = toml::from_str(&read(path)?).map_err(|e| Error::Usage {
        flag: "--noise",
        expected: "a depth noise model in TOML (docs/formats.md)".into(),
        got: format!("{}: {e}", path.display()),
    })?;
    model.check()?;
    Ok(model)
}

/// Shell of a vehicle: the one of the command line, else the one that the vehicle file names.
fn shell(args: &FlyArgs, vehicle: &Vehicle) -> Result<Shell> {
    Ok(match (&args.shell, vehicle.shell_path()) {
        (Some(path), _) => Shell::load(path)?,
        (None, Some(path)) => Shell::load(&path)?,
        (None, None) => Shell::builtin(&vehicle.shell)?,
    })
}

/// The camera of drone `d`: one of its shell's, else one of the scene's.
fn camera(args: &FlyArgs, scene: &Scene, d: usize) -> Result<Camera> {
    let on_drone = format!("drone{d}/{}", args.camera);
    let name = if scene.cameras().iter().any(|c| c.name == on_drone) { &on_drone } else { &args.camera };
    Ok(adjust(Camera::from_scene(scene, name)?, &args.view)?.with_normals(args.normals))
}

/// `lissajous`, `circle`, `hover` or `waypoints FILE`.
fn course(words: &[String]) -> Result<Course> {
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words[..] {
        ["lissajous"] => Ok(Course::Lissajous),
        ["circle"] => Ok(Course::Circle),
        ["hover"] => Ok(Course::Hover),
        ["waypoints", file] => Ok(Course::Waypoints(Spline::from_csv(Path::new(file))?)),
        _ => Err(Error::Usage {
            flag: "--trajectory",
            expected: "lissajous, circle, hover, or waypoints FILE (CSV with t,x,y,z[,yaw])".into(),
            got: words.join(" "),
        }),
    }
}

fn report(args: &FlyArgs, recorded: &Recorded) -> Result<()> {
    let s = &recorded.summary;
    let overview = args.out.join("overview.png");
    if args.json {
        return print_json(&json!({
            "out": args.out, "overview": overview, "worlds": s.n_worlds, "resumed_worlds": recorded.n_resumed,
            "quarantined_worlds": s.n_quarantined, "state_rows": s.n_states, "contact_rows": s.n_contacts,
            "clearance_rows": s.n_clearances, "images": s.n_images, "bytes": s.bytes, "warnings": recorded.warnings,
        }));
    }
    for warning in &recorded.warnings {
        eprintln!("warning: {warning}");
    }
    if s.n_quarantined > 0 {
        eprintln!("warning: {} worlds were quarantined; their world.json says why", s.n_quarantined);
    }
    print(format_args!(
        "{} worlds ({} of them were there already): {} images, {} state rows, {} contact rows, {:.1} MB",
        s.n_worlds,
        recorded.n_resumed,
        s.n_images,
        s.n_states,
        s.n_contacts,
        s.bytes as f64 / 1e6
    ))?;
    print(format_args!("data set  {}\noverview  {}", args.out.display(), overview.display()))
}
