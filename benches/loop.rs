//! The whole loop: flight, depth images and contacts of many worlds, by Propwash and by Crazyflow, alternately.
//!
//! `cargo xtask bench loop --help`. Prints Markdown tables. On Linux only: it reads `/proc` and pins with `taskset`.

mod common;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use clap::Parser;
use common::peer::{Peer, python};
use common::report::{Report, count, figures, number, numbers, shown, word, words};
use common::scenes::{draws, forest};
use common::{Fallible, ended, machine, median};
use propwash::arena::Arena;
use propwash::physics::controllers::ControlMode;
use propwash::physics::rigid_body::State;
use propwash::rollout::{Engine, Sim, SimOptions};
use propwash::scalar::lanes::level_name;
use propwash::scene::{Scene, SceneSource, Shell, mujoco_version};
use propwash::sense::{Camera, Contact, DepthBatch, DepthKind, Lens};
use propwash::vehicle::Vehicle;
use serde_json::{Map, Value, json};

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/peers/loop.py");
/// Steps between two frames: 20 frames a second at 500 Hz.
const STEPS: usize = 25;
/// Frames of an episode.
const EPISODE_FRAMES: usize = 80;
/// Geoms of the forest.
const GEOMS: usize = 40;
/// Numbers for each world: position, attitude xyzw, attitude command.
const START: usize = 11;

/// Flies cf2x_L250 through a forest of 40 geoms at 500 Hz, with a depth image and its contacts 20 times a second, by Propwash and by
/// Crazyflow in turn.
#[derive(Parser)]
struct Args {
    /// How often each of the two runs, about 0.3 s each time; slow ones three frames.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,
    /// Numbers of worlds.
    #[arg(long, value_delimiter = ',', default_values_t = [1usize, 64, 1024])]
    worlds: Vec<usize>,
    /// Side of the images, pixels.
    #[arg(long, default_value_t = 64)]
    side: usize,
    /// How often a process is started to its first frame; 0 leaves that out.
    #[arg(long, default_value_t = 3)]
    starts: u32,
    /// Longest time that Crazyflow may take to get ready, s.
    #[arg(long, default_value_t = 600)]
    patience: u64,
    /// Leaves Crazyflow out, for profiles.
    #[arg(long)]
    ours_alone: bool,
    /// Also writes the figures as lines of JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// One of ours as a process that is asked: the folder with the scene and the starts.
    #[arg(long, hide = true)]
    serve: Option<PathBuf>,
    /// Ignored; `cargo bench` passes it.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> ExitCode {
    let args = Args::parse();
    ended(match &args.serve {
        Some(folder) => serve(&args, folder),
        None => run(&args),
    })
}

/// Who takes part.
#[derive(Clone, Copy, PartialEq)]
enum Who {
    Propwash,
    Crazyflow,
}

/// A process that has made its first frame.
struct Ready {
    peer: Peer,
    first_s: f64,
}

fn run(args: &Args) -> Fallible<()> {
    let (all, one) = (machine::allowed()?, machine::last_core()?);
    let about = format!(
        "lanes {}; MuJoCo {}; forest of {GEOMS} geoms, {side} × {side} pixels; medians of {} rounds",
        level_name(),
        mujoco_version(),
        args.rounds,
        side = args.side,
    );
    let mut report = Report::begin("loop", args.json.as_deref(), &about)?;
    let columns = [
        numbers("threads", "cores"),
        numbers("worlds", "worlds"),
        numbers("crazyflow", "Crazyflow, frames/s"),
        numbers("crazyflow_best", "best"),
        numbers("propwash", "Propwash, frames/s"),
        numbers("propwash_best", "best"),
        numbers("ratio", "ratio of medians"),
        numbers("ratio_of_bests", "ratio of bests"),
        numbers("real_time", "Propwash, × real time"),
        numbers("crazyflow_mib", "Crazyflow, MiB"),
        numbers("propwash_mib", "Propwash, MiB"),
    ];
    let caption = "The whole loop: 25 steps at 500 Hz in `attitude` and f32, a depth image and the contacts, in every world; \
                   most memory of the process.";
    report.table("loop", caption, &columns)?;
    let mut versions = String::new();
    let mut notes = Vec::new();
    let mut threads = vec![1, machine::cores()];
    threads.dedup();
    for &threads in &threads {
        machine::pin(if threads == 1 { &one } else { &all })?;
        for &worlds in &args.worlds {
            if let Some(told) = measure(args, threads, worlds, &mut report, &mut notes)? {
                versions = told;
            }
        }
    }
    notes.iter().try_for_each(|note| report.text(note))?;
    machine::pin(&one)?;
    starts(args, &mut report)?;
    if !versions.is_empty() {
        report.text(&format!("Peer: {versions}."))?;
    }
    report.end()
}

/// One row: both in turn on so many worlds and cores. Gives the versions of Crazyflow where it took part.
fn measure(
    args: &Args,
    threads: usize,
    worlds: usize,
    report: &mut Report,
    notes: &mut Vec<String>,
) -> Fallible<Option<String>> {
    eprintln!("{worlds} worlds, {threads} cores");
    let folder = prepare(worlds)?;
    let mut ours = ready(args, Who::Propwash, folder.path(), threads)?;
    let mut theirs = None;
    if !args.ours_alone {
        match ready(args, Who::Crazyflow, folder.path(), threads) {
            Ok(ready) => theirs = Some(ready),
            Err(why) => {
                notes.push(format!("{worlds} worlds on {threads} cores: Crazyflow was left out: {why}."))
            }
        }
    }
    let (mut our_times, mut their_times) = (Vec::new(), Vec::new());
    let (mut our_best, mut their_best) = (f64::INFINITY, f64::NAN);
    for _ in 0..args.rounds {
        let (middle, least) = ours.peer.measure()?;
        our_times.push(middle);
        our_best = our_best.min(least);
        if let Some(theirs) = &mut theirs {
            let (middle, least) = theirs.peer.measure()?;
            their_times.push(middle);
            their_best = their_best.min(least);
        }
    }
    let rate = |seconds: f64| worlds as f64 / seconds;
    let cell = |v: f64| shown(v, figures(v));
    let (our, their) = (rate(median(&mut our_times)), rate(median(&mut their_times)));
    let our_best_rate = rate(our_best);
    let their_mib = theirs.as_ref().map_or(Ok(f64::NAN), |ready| ready.peer.peak_mib())?;
    report.row(vec![
        count(threads),
        count(worlds),
        cell(their),
        cell(rate(their_best)),
        cell(our),
        cell(our_best_rate),
        number(our / their, 0),
        number(our_best_rate / rate(their_best), 0),
        cell(our * STEPS as f64 / 500.0),
        number(their_mib, 0),
        number(ours.peer.peak_mib()?, 0),
    ])?;
    Ok(theirs.map(|ready| ready.peer.versions()))
}

/// Start of a process to its first frame: scene, vehicle, flight, image and contacts.
fn starts(args: &Args, report: &mut Report) -> Fallible<()> {
    if args.starts == 0 {
        return Ok(());
    }
    let columns = [
        words("who", "who"),
        numbers("first_s", "start to first frame, s: median"),
        numbers("least_s", "least"),
        numbers("most_s", "most"),
        numbers("memory_mib", "memory, MiB"),
    ];
    let caption = format!(
        "Start of a process to the first frame of one world, one core, {} starts each in turn.",
        args.starts
    );
    report.table("first_frame", &caption, &columns)?;
    let folder = prepare(1)?;
    let mut times = [Vec::new(), Vec::new()];
    let mut memory = [f64::NAN; 2];
    for _ in 0..args.starts {
        for (k, who) in [Who::Propwash, Who::Crazyflow].into_iter().enumerate() {
            if who == Who::Crazyflow && args.ours_alone {
                continue;
            }
            let ready = ready(args, who, folder.path(), 1)?;
            times[k].push(ready.first_s);
            memory[k] = ready.peer.peak_mib()?;
        }
    }
    for (k, name) in ["Propwash", "Crazyflow"].into_iter().enumerate() {
        let middle = median(&mut times[k]);
        let end = |at: Option<&f64>| number(at.copied().unwrap_or(f64::NAN), 3);
        report.row(vec![
            word(name),
            number(middle, 3),
            end(times[k].first()),
            end(times[k].last()),
            number(memory[k], 0),
        ])?;
    }
    Ok(())
}

/// Starts one of them and waits for its first frame.
fn ready(args: &Args, who: Who, folder: &Path, threads: usize) -> Fallible<Ready> {
    let (scene, starts) = (folder.join("scene.xml"), folder.join("starts.f64"));
    let mut command;
    if who == Who::Propwash {
        command = Command::new(std::env::current_exe()?);
        command.arg("--serve").arg(folder).args(["--side", &args.side.to_string()]);
        command.env("RAYON_NUM_THREADS", threads.to_string());
    } else {
        command = Command::new(python());
        command.arg(SCRIPT).arg(scene).arg(starts).args([STEPS.to_string(), args.side.to_string()]);
        command.env("PROPWASH_CORES", if threads == 1 { "one" } else { "all" });
    }
    let name = if who == Who::Propwash { "this program" } else { "loop.py" };
    let begin = Instant::now();
    let mut peer = Peer::run(name, command, Duration::from_secs(args.patience)).map_err(|e| {
        format!("{name} could not be started: {e}; `cargo xtask bench loop` makes its Python")
    })?;
    peer.answer::<Value>()?;
    let first_s = begin.elapsed().as_secs_f64();
    peer.told = peer.answer::<Map<String, Value>>()?;
    Ok(Ready { peer, first_s })
}

/// A folder with what both read: the scene, and where drones start and what they are told.
fn prepare(worlds: usize) -> Fallible<tempfile::TempDir> {
    let folder = tempfile::tempdir()?;
    std::fs::write(folder.path().join("scene.xml"), forest(GEOMS, "", ""))?;
    let thrust = Vehicle::builtin("cf2x_L250")?.drone("first_principles")?.hover_thrust();
    let mut s = draws(2);
    let reach = 1.5 * (GEOMS as f64).sqrt();
    let mut bytes = Vec::new();
    for _ in 0..worlds {
        let pos = [s.uniform(-reach, reach), s.uniform(-reach, reach), s.uniform(0.8, 2.5)];
        let yaw = s.uniform(-3.0, 3.0);
        let quat = [0.0, 0.0, (0.5 * yaw).sin(), (0.5 * yaw).cos()];
        let tilt = [s.uniform(-0.1, 0.1), s.uniform(-0.1, 0.1), yaw + s.uniform(-0.1, 0.1)];
        let force = thrust * s.uniform(0.99, 1.01);
        let numbers = [&pos[..], &quat, &tilt, &[force]].concat();
        bytes.extend(numbers.into_iter().flat_map(f64::to_le_bytes));
    }
    std::fs::write(folder.path().join("starts.f64"), bytes)?;
    Ok(folder)
}

/// Worlds in flight with all that their drones see and touch.
struct Flight {
    arena: Arena<f32>,
    commands: Vec<f64>,
    camera: Camera,
    depth: DepthBatch,
    contacts: Vec<Vec<Contact>>,
    limited: Vec<usize>,
    frames: usize,
}

impl Flight {
    fn new(folder: &Path, side: usize) -> Fallible<Self> {
        let vehicle = Vehicle::builtin("cf2x_L250")?;
        let xml = std::fs::read_to_string(folder.join("scene.xml"))?;
        let scene = Scene::build(&SceneSource::text("forest", xml), &[Shell::builtin(&vehicle.shell)?])?;
        let camera = Camera::on_drone(&scene, 0, "fpv")?
            .with_size(side, side)?
            .with_lens(Lens::Fovy { fovy_deg: 45.0 })?
            .with_kind(DepthKind::Range);
        let bytes = std::fs::read(folder.join("starts.f64"))?;
        let numbers: Vec<f64> = bytes
            .chunks_exact(8)
            .map(|b| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]))
            .collect();
        let options = SimOptions {
            n_worlds: numbers.len() / START,
            control: ControlMode::Attitude,
            engine: Engine::Lanes,
            ..SimOptions::default()
        };
        let drone = vehicle.drone("first_principles")?;
        let worlds = options.n_worlds;
        let sim = Sim::<f32>::storing(options, vec![(drone, vehicle.rates)])?;
        let mut arena = Arena::within(sim, &[scene], &vec![0; worlds])?;
        let mut commands = Vec::new();
        for (world, n) in numbers.chunks_exact(START).enumerate() {
            let state = State { pos: [n[0], n[1], n[2]], quat: [n[3], n[4], n[5], n[6]], ..State::rest() };
            arena.set_initial(world, 0, state)?;
            commands.extend_from_slice(&n[7..]);
        }
        Ok(Self {
            arena,
            commands,
            camera,
            depth: DepthBatch::default(),
            contacts: Vec::new(),
            limited: Vec::new(),
            frames: 0,
        })
    }

    /// One frame of every world; returns the seconds that it took, without those of a reset.
    fn frame(&mut self) -> Fallible<f64> {
        if self.frames.is_multiple_of(EPISODE_FRAMES) {
            self.arena.reset(None)?;
            self.arena.set_command(&self.commands)?;
        }
        self.frames += 1;
        let start = Instant::now();
        self.arena.step(STEPS)?;
        let cameras = [std::slice::from_ref(&self.camera)];
        self.arena.look().frames(&cameras, None, &mut self.depth)?;
        self.arena.contacts(None, &mut self.contacts, &mut self.limited)?;
        Ok(start.elapsed().as_secs_f64())
    }
}

/// Our side of the protocol of benches/peers/loop.py.
fn serve(args: &Args, folder: &Path) -> Fallible<()> {
    let mut flight = Flight::new(folder, args.side)?;
    flight.frame()?;
    println!("{}", json!({ "first": true }));
    println!("{}", json!({ "propwash": env!("CARGO_PKG_VERSION") }));
    for line in std::io::stdin().lines() {
        line?;
        let (mut calls, since) = (Vec::new(), Instant::now());
        while calls.len() < 3 || since.elapsed().as_secs_f64() < 0.3 {
            calls.push(flight.frame()?);
        }
        let least = calls.iter().copied().fold(f64::INFINITY, f64::min);
        println!("{}", json!([median(&mut calls), least]));
    }
    Ok(())
}
