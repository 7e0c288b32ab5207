//! `propwash fly`: the main job.

use super::{io_error, print, print_json};
use crate::arena::{FlightPattern, SceneConfig};
use crate::cli::args::{FlyArgs, put};
use crate::cli::exit::{Outcome, warn};
use crate::cli::output;
use crate::dataset::recorder::{self, Flight, FlightConfig, Recorded};
use crate::dataset::{MAX_DRONES, MAX_WORLDS};
use crate::rollout::RolloutError;
use crate::rollout::randomize::Randomization;
use crate::sense::DepthNoise;
use crate::view;
use crate::{Error, Result};
use indicatif::{ProgressBar, ProgressState, ProgressStyle};
use serde_json::{Map, Value, json};
use std::path::Path;
use std::time::Duration;

/// Most threads that can be asked for; more than any machine has use for.
const MAX_THREADS: usize = 1024;

/// Runs the command.
pub fn run(args: &FlyArgs) -> Result<Outcome> {
    let flight = config(args)?.load()?;
    output::check(&[("--view", args.page.as_deref())], false)?;
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
    if let Some(page) = &args.page {
        let made = view::page(&args.out, &view::Options::default())?;
        output::report("--view", page, made.html.as_bytes(), false)?;
    }
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
fn config(args: &FlyArgs) -> Result<FlightConfig> {
    let config = match &args.config {
        None => FlightConfig::default(),
        Some(path) => FlightConfig::from_file(path)?,
    };
    check(args)?;
    let mut fields = Map::new();
    put(&mut fields, "--scene", "scene", args.scene.clone().map(|path| SceneConfig::Files(vec![path])))?;
    let drones: Vec<Value> = args.drone.iter().map(|name| json!({ "vehicle": name })).collect();
    put(&mut fields, "--drone", "drones", (!drones.is_empty()).then_some(drones))?;
    put(&mut fields, "--drones-per-world", "n_drones", args.drones_per_world)?;
    put(&mut fields, "--shell", "shell", args.shell.as_ref())?;
    put(&mut fields, "--dynamics", "dynamics", args.dynamics.as_ref())?;
    put(&mut fields, "--worlds", "n_worlds", args.worlds)?;
    put(&mut fields, "--trajectory", "pattern", args.trajectory.as_deref().map(pattern).transpose()?)?;
    put(&mut fields, "--randomize", "randomization", args.randomize.as_deref().map(rules).transpose()?)?;
    put(&mut fields, "--sim-hz", "sim_hz", args.sim_hz)?;
    put(&mut fields, "--integrator", "integrator", args.integrator)?;
    put(&mut fields, "--seed", "seed", args.seed)?;
    put(&mut fields, "--obstacle-jitter", "obstacle_jitter_m", args.obstacle_jitter)?;
    put(&mut fields, "--obstacle-motion", "obstacle_motion", args.obstacle_motion.as_ref())?;
    put(&mut fields, "--sensor", "sensors", Some(&args.sensor))?;
    put(&mut fields, "--seconds", "seconds", args.seconds)?;
    put(&mut fields, "--fps", "fps", args.fps)?;
    put(&mut fields, "--log-hz", "log_hz", args.log_hz)?;
    put(&mut fields, "--normals", "normals", args.normals.then_some(true))?;
    let mut camera = args.view.fields(&config.sim.camera.clone().unwrap_or_default())?;
    put(&mut camera, "--camera", "name", args.camera.as_ref())?;
    put(&mut camera, "--camera-mount", "mount", args.camera_mount)?;
    put(&mut camera, "--noise", "noise", args.noise.as_deref().map(noise).transpose()?)?;
    put(&mut fields, "--camera", "camera", Some(camera))?;
    config.changed(fields)
}

/// Refuses what can be told from the flags alone, by their names.
fn check(args: &FlyArgs) -> Result<()> {
    let usage = |flag, expected: String, got: String| Err(Error::Usage { flag, expected, got });
    let limits = [
        ("--worlds", args.worlds, MAX_WORLDS),
        ("--threads", args.threads, MAX_THREADS),
        ("--drones-per-world", args.drones_per_world, MAX_DRONES),
    ];
    for (flag, given, most) in limits {
        if let Some(n) = given.filter(|n| !(1..=most).contains(n)) {
            return usage(flag, format!("1 to {most}"), n.to_string());
        }
    }
    if let Some(n) = args.drones_per_world.filter(|n| *n < args.drone.len()) {
        let expected = format!("at least {}, one for each --drone", args.drone.len());
        return usage("--drones-per-world", expected, n.to_string());
    }
    if let Some(video) = &args.video {
        // The Python package takes the flag away before it calls this program.
        let expected = "the command of the Python package, which draws with MuJoCo's renderer; this program has none: pip install \
                        'propwash[video]', then python -m propwash fly with the same words, or propwash.video(\"DIR\", \"FILE.mp4\") in \
                        Python with the data set of this flight";
        return usage("--video", expected.into(), video.display().to_string());
    }
    if args.out.exists() && !args.out.is_dir() {
        let found = format!("{}, which is a file", args.out.display());
        return usage("--out", "a folder, there already or to be made".into(), found);
    }
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
            Ok(FlightPattern::from_csv(Path::new(file))?)
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
    if args.json {
        return print_json(&recorded.details(&args.out));
    }
    for warning in &recorded.warnings {
        warn(warning);
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
    print(format_args!(
        "data set  {}\noverview  {}",
        args.out.display(),
        args.out.join("overview.png").display()
    ))
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
