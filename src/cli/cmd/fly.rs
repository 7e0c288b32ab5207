//! `propwash fly`: the main job.

use super::{io_error, print, print_json};
use crate::arena::{DroneConfig, FlightPattern, SceneConfig, SimConfig, VehicleSource};
use crate::cli::args::FlyArgs;
use crate::cli::exit::{Outcome, warn};
use crate::dataset::recorder::{self, Flight, FlightConfig, Recorded};
use crate::rollout::RolloutError;
use crate::rollout::randomize::Randomization;
use crate::rollout::trajectory::Tracks;
use crate::sense::DepthNoise;
use crate::{Error, Result};
use indicatif::{ProgressBar, ProgressState, ProgressStyle};
use serde_json::json;
use std::path::Path;
use std::time::Duration;

/// Most worlds of a data set.
const MAX_WORLDS: usize = 10_000_000;
/// Most threads that can be asked for; more than any machine has use for.
const MAX_THREADS: usize = 1024;

/// Runs the command.
pub fn run(args: &FlyArgs) -> Result<Outcome> {
    let flight = config(args)?.load()?;
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
    let bar = if args.json {
        ProgressBar::hidden()
    } else {
        ProgressBar::new(flight.config().sim.options.n_worlds as u64)
    };
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.enable_steady_tick(Duration::from_millis(200));
    let recorded = recorder::fly(flight, &args.out, &|done, _| bar.set_position(done as u64))?;
    bar.finish_and_clear();
    Ok(recorded)
}

/// What the arguments ask for: a configuration with what the flags change.
pub fn config(args: &FlyArgs) -> Result<FlightConfig> {
    let mut config = match &args.config {
        None => FlightConfig::default(),
        Some(path) => FlightConfig::from_file(path)?,
    };
    change_drones(args, &mut config.sim)?;
    let usage =
        |flag, expected: &str, got: String| Err(Error::Usage { flag, expected: expected.into(), got });
    let sim = &mut config.sim;
    if let Some(worlds) = args.worlds {
        if !(1..=MAX_WORLDS).contains(&worlds) {
            return usage("--worlds", &format!("1 to {MAX_WORLDS}"), worlds.to_string());
        }
        sim.options.n_worlds = worlds;
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
    if let Some(scene) = &args.scene {
        (sim.scene, sim.layouts, sim.layout) = (Some(SceneConfig::Files(vec![scene.clone()])), None, None);
        sim.scene_sha256.clear();
    }
    if let Some(words) = &args.trajectory {
        sim.pattern = Some(pattern(words)?);
    }
    if let Some(path) = &args.randomize {
        sim.options.randomization = rules(path)?;
    }
    set(&mut sim.options.sim_hz, args.sim_hz);
    set(&mut sim.options.integrator, args.integrator);
    set(&mut sim.options.seed, args.seed);
    set(&mut sim.obstacle_jitter_m, args.obstacle_jitter);
    let camera = sim.camera.get_or_insert_default();
    if let Some(name) = &args.camera {
        (camera.name, camera.mount) = (name.clone(), None);
    }
    camera.mount = args.camera_mount.or(camera.mount);
    if let Some(path) = &args.noise {
        camera.noise = Some(noise(path)?);
    }
    args.view.change(camera)?;
    sim.sensors.extend(args.sensor.iter().cloned());
    set(&mut config.seconds, args.seconds);
    set(&mut config.fps, args.fps);
    set(&mut config.log_hz, args.log_hz);
    config.normals |= args.normals;
    Ok(config)
}

/// A value that a flag gives.
fn set<T>(to: &mut T, given: Option<T>) {
    if let Some(given) = given {
        *to = given;
    }
}

/// What flags change in the drones.
fn change_drones(args: &FlyArgs, sim: &mut SimConfig) -> Result<()> {
    if !args.drone.is_empty() {
        let named = |name: &String| DroneConfig {
            vehicle: VehicleSource::Named(name.clone()),
            ..DroneConfig::default()
        };
        (sim.drones, sim.n_drones) = (args.drone.iter().map(named).collect(), None);
    }
    for drone in &mut sim.drones {
        set(&mut drone.dynamics, args.dynamics.clone());
        drone.shell = args.shell.clone().or(drone.shell.take());
    }
    if !args.drone.is_empty() || args.shell.is_some() || args.drones_per_world.is_some() {
        // Other drones make another scene of the same file.
        sim.scene_sha256.clear();
    }
    let Some(n) = args.drones_per_world else { return Ok(()) };
    let usage =
        |expected: String| Err(Error::Usage { flag: "--drones-per-world", expected, got: n.to_string() });
    if n == 0 || n > 1024 {
        return usage("1 to 1024 drones in one world".into());
    }
    if n < args.drone.len() {
        return usage(format!("at least {}, one for each --drone", args.drone.len()));
    }
    sim.n_drones = Some(n);
    Ok(())
}

fn read(path: &Path) -> Result<String> {
    crate::flight::files::read_text(path).map_err(io_error(path))
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

/// `lissajous`, `circle`, `hover` or `waypoints FILE`.
fn pattern(words: &[String]) -> Result<FlightPattern> {
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words[..] {
        ["lissajous"] => Ok(FlightPattern::Lissajous),
        ["circle"] => Ok(FlightPattern::Circle),
        ["hover"] => Ok(FlightPattern::Hover),
        ["waypoints", file] => {
            // Read here first, so that the flag is named when there is no such file.
            std::fs::File::open(file).map_err(|e| Error::Usage {
                flag: "--trajectory",
                expected:
                    "waypoints and a CSV file with the columns t,x,y,z[,yaw][,world][,drone] (s, m, rad)"
                        .into(),
                got: format!("{file}: {e}"),
            })?;
            let tracks = Tracks::from_csv(Path::new(file))?;
            Ok(match tracks.only() {
                Some(spline) => FlightPattern::Waypoints(spline.clone()),
                None => FlightPattern::Tracks(tracks),
            })
        }
        _ => Err(Error::Usage {
            flag: "--trajectory",
            expected: "lissajous, circle, hover, or waypoints FILE (CSV with t,x,y,z[,yaw][,world][,drone])"
                .into(),
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
        warn(&warning);
    }
    if s.n_quarantined > 0 {
        warn(&format!("{} quarantined; world.json says why", count(s.n_quarantined as u64, "world")));
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
