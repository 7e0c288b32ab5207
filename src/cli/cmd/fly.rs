//! `propwash fly`: the main job.

use super::drones::find;
use super::{adjust, io_error, print, print_json};
use crate::cli::args::{CameraArgs, FlyArgs, IntegratorArg};
use crate::cli::exit::Outcome;
use crate::dataset::recorder::{Course, Flight, Recorded, record};
use crate::dataset::{Dataset, Overview, map};
use crate::physics::integrate::Integrator;
use crate::rollout::RolloutError;
use crate::rollout::randomize::Randomization;
use crate::rollout::trajectory::Spline;
use crate::scene::{Scene, SceneSource, Shell};
use crate::sense::{Camera, DepthNoise};
use crate::vehicle::Vehicle;
use crate::{Error, Result};
use indicatif::{ProgressBar, ProgressState, ProgressStyle};
use serde_json::json;
use std::path::Path;
use std::time::Duration;

/// Clearances beyond this are not looked for, m.
const CLEARANCE_MAX_M: f64 = 5.0;
/// Most worlds of a data set.
const MAX_WORLDS: usize = 10_000_000;
/// Most threads that can be asked for; more than any machine has use for.
const MAX_THREADS: usize = 1024;

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
    // How long it takes is known when the first world is done.
    let left = |state: &ProgressState, text: &mut dyn std::fmt::Write| match state.eta().as_secs() {
        0 => {}
        s => drop(write!(text, ", about {s} s to go")),
    };
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} worlds, {elapsed} elapsed{left}")
        .map(|style| style.with_key("left", left));
    let bar = if args.json { ProgressBar::hidden() } else { ProgressBar::new(args.worlds as u64) };
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.enable_steady_tick(Duration::from_millis(200));
    let recorded = record(flight, &args.out, &|done, _| bar.set_position(done as u64))?;
    bar.finish_and_clear();
    let map = map::height_map(flight)?;
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
    if n < args.drone.len() {
        let expected = format!("at least {}, one for each --drone", args.drone.len());
        return usage("--drones-per-world", &expected, n.to_string());
    }
    if !(1..=MAX_WORLDS).contains(&args.worlds) {
        return usage("--worlds", &format!("1 to {MAX_WORLDS}"), args.worlds.to_string());
    }
    if let Some(threads) = args.threads
        && !(1..=MAX_THREADS).contains(&threads)
    {
        return usage("--threads", &format!("1 to {MAX_THREADS}"), threads.to_string());
    }
    if args.out.exists() && !args.out.is_dir() {
        let found = format!("{}, which is a file", args.out.display());
        return usage("--out", "a folder, there already or to be made", found);
    }
    let vehicles: Vec<Vehicle> =
        (0..n).map(|i| find(&args.drone[i % args.drone.len()])).collect::<Result<_>>()?;
    let shells: Vec<Shell> =
        vehicles.iter().map(|v| shell(args.shell.as_deref(), v)).collect::<Result<_>>()?;
    let scene = Scene::build(&SceneSource::file(&args.scene), &shells)?;
    let cameras = (0..n).map(|d| Ok(camera(&args.camera, &args.view, &scene, d)?.with_normals(args.normals)));
    let cameras = cameras.collect::<Result<_>>()?;
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
            Some(path) => rules(path)?,
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

fn rules(path: &Path) -> Result<Randomization> {
    Ok(Randomization::from_toml(&read(path)?).map_err(|e| match e {
        // The text itself is wrong: say in which file.
        RolloutError::Randomization { rule, reason } if rule == "file" => {
            RolloutError::Randomization { rule: path.display().to_string(), reason }
        }
        other => other,
    })?)
}

fn noise(path: &Path) -> Result<DepthNoise> {
    let text = read(path)?;
    let model: DepthNoise = toml::from_str(&text).map_err(|e| {
        let line = e.span().map_or(1, |at| 1 + text[..at.start].matches('\n').count());
        Error::Usage {
            flag: "--noise",
            expected: "a depth noise model in TOML (docs/formats.md)".into(),
            got: format!("{}, line {line}: {}", path.display(), e.message().trim()),
        }
    })?;
    model.check()?;
    Ok(model)
}

/// Shell of a vehicle: the one of the command line, else the one that the vehicle file names.
pub fn shell(given: Option<&Path>, vehicle: &Vehicle) -> Result<Shell> {
    Ok(match (given, vehicle.shell_path()) {
        (Some(path), _) => Shell::load(path)?,
        (None, Some(path)) => Shell::load(&path)?,
        (None, None) => Shell::builtin(&vehicle.shell)?,
    })
}

/// The camera of drone `d`: one of its shell's, else one of the scene's.
pub fn camera(name: &str, view: &CameraArgs, scene: &Scene, d: usize) -> Result<Camera> {
    let on_drone = format!("drone{d}/{name}");
    let name = if scene.cameras().iter().any(|c| c.name == on_drone) { &on_drone } else { name };
    adjust(Camera::from_scene(scene, name)?, view)
}

/// `lissajous`, `circle`, `hover` or `waypoints FILE`.
fn course(words: &[String]) -> Result<Course> {
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words[..] {
        ["lissajous"] => Ok(Course::Lissajous),
        ["circle"] => Ok(Course::Circle),
        ["hover"] => Ok(Course::Hover),
        ["waypoints", file] => {
            // Read here first, so that the flag is named when there is no such file.
            std::fs::File::open(file).map_err(|e| Error::Usage {
                flag: "--trajectory",
                expected: "waypoints and a CSV file with the columns t,x,y,z[,yaw] (s, m, rad)".into(),
                got: format!("{file}: {e}"),
            })?;
            Ok(Course::Waypoints(Spline::from_csv(Path::new(file))?))
        }
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
        eprintln!("warning: {} quarantined; world.json says why", count(s.n_quarantined as u64, "world"));
    }
    let there = match recorded.n_resumed {
        0 => String::new(),
        n => format!(" ({n} of them there already)"),
    };
    print(format_args!(
        "{}{there}: {}, {}, {}, {}",
        count(s.n_worlds as u64, "world"),
        count(s.n_images, "depth image"),
        count(s.n_states, "state row"),
        count(s.n_contacts, "contact row"),
        size(s.bytes),
    ))?;
    print(format_args!("data set  {}\noverview  {}", args.out.display(), overview.display()))
}

/// `1 world`, `2 worlds`.
fn count(n: u64, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// Bytes in words.
fn size(bytes: u64) -> String {
    match bytes {
        0..100_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        100_000..1_000_000_000 => format!("{:.1} MB", bytes as f64 / 1e6),
        _ => format!("{:.2} GB", bytes as f64 / 1e9),
    }
}
