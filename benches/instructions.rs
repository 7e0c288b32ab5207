//! Instructions of small fixed cases, counted by callgrind: a measure of speed that no other program on the machine disturbs.
//!
//! `cargo xtask bench instructions --help`. Each case runs twice, for different numbers of times, and the difference counts, so
//! that loading and building drop out. Valgrind 3.19 knows no AVX-512: on x86-64 lanes fall back to AVX2 under it.

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use clap::Parser;
use common::report::{Report, nothing, number, numbers, shown, word, words};
use common::scenes::{draws, forest};
use common::{Fallible, machine};
use propwash::physics::controllers::ControlMode;
use propwash::rollout::{Engine, Sim, SimOptions};
use propwash::scalar::lanes::{Number, level_name};
use propwash::scene::{Pose, Scene, SceneSource, Shell, WorkerPool};
use propwash::sense::{Camera, Clearance, Contact, DepthFrame, DepthKind, Lens, WorldPoses, Worlds};
use propwash::vehicle::Vehicle;
use serde::{Deserialize, Serialize};

const TABLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/instructions.toml");
/// Growth that is named, %.
const TOLERANCE_PERCENT: f64 = 3.0;
/// Steps of a call.
const STEPS: usize = 50;
/// Worlds of the cases with many.
const WORLDS: usize = 64;
/// How often a case runs in its two runs.
const TIMES: [usize; 2] = [2, 6];

/// Counts the instructions of small fixed cases with callgrind and compares them with benches/instructions.toml: exit code 1 where
/// one grew by more than 3 %.
#[derive(Parser)]
struct Args {
    /// Writes the counts to the table.
    #[arg(long)]
    write: bool,
    /// Only cases whose name holds this.
    #[arg(long, default_value = "")]
    case: String,
    /// Also writes the figures as lines of JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Runs one case some times: what callgrind is given.
    #[arg(long, hide = true, num_args = 2)]
    run: Option<Vec<String>>,
    /// Ignored; `cargo bench` passes it.
    #[arg(long, hide = true)]
    bench: bool,
}

/// Something to count.
struct Case {
    name: &'static str,
    /// What one count is of.
    of: &'static str,
    /// How many of it one time does.
    amount: usize,
    run: fn(usize) -> Fallible<()>,
}

const CASES: [Case; 8] = [
    Case {
        name: "steps_rotor_vel_f32",
        of: "step of a world, 64 worlds, 50 steps a call",
        amount: WORLDS * STEPS,
        run: |times| lanes::<f32>(ControlMode::RotorVel, times),
    },
    Case {
        name: "steps_attitude_f32",
        of: "step of a world, 64 worlds, 50 steps a call",
        amount: WORLDS * STEPS,
        run: |times| lanes::<f32>(ControlMode::Attitude, times),
    },
    Case {
        name: "steps_state_f32",
        of: "step of a world, 64 worlds, 50 steps a call",
        amount: WORLDS * STEPS,
        run: |times| lanes::<f32>(ControlMode::State, times),
    },
    Case {
        name: "steps_attitude_f64",
        of: "step of a world, 64 worlds, 50 steps a call",
        amount: WORLDS * STEPS,
        run: |times| lanes::<f64>(ControlMode::Attitude, times),
    },
    Case {
        name: "steps_attitude_reference",
        of: "step of one world by the equations in f64",
        amount: STEPS,
        run: |times| steps::<f64>(Engine::Reference, ControlMode::Attitude, 1, times),
    },
    Case { name: "depth", of: "image of 64 × 64 pixels, forest of 40 geoms", amount: 16, run: depth },
    Case { name: "contacts", of: "drone, forest of 40 geoms", amount: WORLDS, run: contacts },
    Case { name: "clearances", of: "drone, forest of 40 geoms, within 5 m", amount: WORLDS, run: clearances },
];

/// The table that is checked in.
#[derive(Serialize, Deserialize)]
struct Table {
    /// Compiler that it was counted with; another may count otherwise.
    compiler: String,
    /// Lanes in use under valgrind.
    lanes: String,
    /// Instructions by case.
    instructions: BTreeMap<String, f64>,
}

fn main() -> ExitCode {
    let args = Args::parse();
    let outcome = match &args.run {
        Some(words) => one(words).map(|()| 0),
        None => run(&args),
    };
    match outcome {
        Ok(0) => ExitCode::SUCCESS,
        Ok(grown) => {
            eprintln!("error: {grown} of the counts grew by more than {TOLERANCE_PERCENT} %");
            ExitCode::FAILURE
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

/// Counts all cases; how many grew too much.
fn run(args: &Args) -> Fallible<usize> {
    if cfg!(debug_assertions) {
        return Err("instructions count in the release profile only: `cargo xtask bench instructions`".into());
    }
    let version = match Command::new("valgrind").arg("--version").output() {
        Ok(out) if out.status.success() => String::from_utf8_lossy(&out.stdout).trim().to_string(),
        _ => {
            println!("valgrind was not found: nothing was counted (Debian: apt install valgrind)");
            return Ok(0);
        }
    };
    let cases: Vec<&Case> = CASES.iter().filter(|case| case.name.contains(&args.case)).collect();
    let mut counts = BTreeMap::new();
    let mut lanes = String::new();
    for case in &cases {
        eprintln!("{}", case.name);
        let [few, many] = [count(case, TIMES[0])?, count(case, TIMES[1])?];
        lanes = many.1;
        let per_time = (many.0 - few.0) / (TIMES[1] - TIMES[0]) as f64;
        counts.insert(case.name.to_string(), per_time / case.amount as f64);
    }
    let found = Table { compiler: machine::compiler(), lanes, instructions: counts };
    let known: Option<Table> = match std::fs::read_to_string(TABLE) {
        Ok(text) => Some(toml::from_str(&text).map_err(|e| format!("{TABLE}: {e}"))?),
        Err(_) => None,
    };
    let about = format!("lanes {} under {version}; {}", found.lanes, found.compiler);
    let mut report = Report::begin("instructions", args.json.as_deref(), &about)?;
    let columns = [
        words("case", "case"),
        words("of", "instructions per"),
        numbers("instructions", "instructions"),
        numbers("known", "in the table"),
        numbers("change_percent", "change, %"),
    ];
    report.table("instructions", "Instructions by callgrind's count.", &columns)?;
    let mut grown = Vec::new();
    for case in &cases {
        let now = found.instructions[case.name];
        let before = known.as_ref().and_then(|table| table.instructions.get(case.name).copied());
        let change = before.map(|before| 100.0 * (now / before - 1.0));
        if change.is_some_and(|change| change > TOLERANCE_PERCENT) {
            grown.push(case.name);
        }
        report.row(vec![
            word(case.name),
            word(case.of),
            number(now, 1),
            before.map_or_else(nothing, |v| number(v, 1)),
            change.map_or_else(nothing, |v| shown(v, format!("{v:+.1}"))),
        ])?;
    }
    if let Some(known) = known.as_ref().filter(|k| k.compiler != found.compiler || k.lanes != found.lanes) {
        report.text(&format!(
            "The table was counted with {} and lanes {}: the two cannot be held against each other.",
            known.compiler, known.lanes
        ))?;
        grown.clear();
    }
    for name in &grown {
        report.text(&format!("`{name}` grew."))?;
    }
    if args.write {
        write(&found, known)?;
        return Ok(0);
    }
    Ok(grown.len())
}

/// Renews the table; cases that were not counted stay.
fn write(found: &Table, known: Option<Table>) -> Fallible<()> {
    let mut instructions = known.map(|table| table.instructions).unwrap_or_default();
    instructions
        .extend(found.instructions.iter().map(|(name, count)| (name.clone(), (10.0 * count).round() / 10.0)));
    instructions.retain(|name, _| CASES.iter().any(|case| case.name == name));
    let table = Table { compiler: found.compiler.clone(), lanes: found.lanes.clone(), instructions };
    let head = "# Instructions of the cases of benches/instructions.rs. `cargo xtask bench instructions --write` renews this file.\n";
    std::fs::write(TABLE, format!("{head}{}", toml::to_string(&table)?))?;
    eprintln!("wrote {TABLE}");
    Ok(())
}

/// Instructions of a process that runs a case some times, and the lanes that it used.
fn count(case: &Case, times: usize) -> Fallible<(f64, String)> {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("callgrind.out");
    let out = Command::new("valgrind")
        .arg("--tool=callgrind")
        .arg(format!("--callgrind-out-file={}", file.display()))
        .arg(std::env::current_exe()?)
        .args(["--run", case.name, &times.to_string()])
        .current_dir(folder.path())
        .output()?;
    if !out.status.success() {
        let words = String::from_utf8_lossy(&out.stderr);
        let tail: Vec<&str> = words.lines().rev().take(5).collect();
        return Err(format!("{} failed under valgrind: {}", case.name, tail.join("; ")).into());
    }
    Ok((total(&file)?, String::from_utf8_lossy(&out.stdout).trim().to_string()))
}

/// The sum in a file of callgrind's.
fn total(file: &Path) -> Fallible<f64> {
    let text = std::fs::read_to_string(file)?;
    let line = text.lines().find_map(|l| l.strip_prefix("summary:").or_else(|| l.strip_prefix("totals:")));
    Ok(line.ok_or("callgrind wrote no sum")?.trim().parse()?)
}

/// Runs one case and says which lanes it used.
fn one(words: &[String]) -> Fallible<()> {
    let [name, times] = words else { return Err("--run: expected a case and a number of times".into()) };
    let case = CASES.iter().find(|case| case.name == name).ok_or_else(|| format!("no case {name}"))?;
    let times = times.parse()?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| (case.run)(times).map_err(|e| e.to_string()))?;
    println!("{}", level_name());
    Ok(())
}

fn lanes<N: Number>(control: ControlMode, times: usize) -> Fallible<()> {
    steps::<N>(Engine::Lanes, control, WORLDS, times)
}

fn steps<N: Number>(engine: Engine, control: ControlMode, worlds: usize, times: usize) -> Fallible<()> {
    let vehicle = Vehicle::builtin("cf2x_L250")?;
    let drone = vehicle.drone("first_principles")?;
    let (thrust, speed) = (drone.hover_thrust(), drone.hover_rotor_vel()[0]);
    let command = |world: usize| {
        let wave = |k: f64| (world as f64 * k).sin();
        let [a, b, c, d] = [wave(12.9898), wave(78.233), wave(37.719), wave(4.581)];
        match control {
            ControlMode::State => [&[a, b, 1.0 + 0.5 * c][..], &[0.0; 9], &[1.0, 0.0, 0.0, 0.0]].concat(),
            ControlMode::Attitude => vec![0.1 * a, 0.1 * b, 0.1 * c, thrust * (1.0 + 0.05 * d)],
            _ => [a, b, c, d].map(|wave| speed * (1.0 + 2e-4 * wave)).to_vec(),
        }
    };
    let options = SimOptions { n_worlds: worlds, control, engine, ..SimOptions::default() };
    let mut sim = Sim::<N>::storing(options, vec![(drone, vehicle.rates)])?;
    sim.set_command(&(0..worlds).flat_map(command).collect::<Vec<f64>>())?;
    for _ in 0..times {
        sim.step(STEPS)?;
    }
    Ok(())
}

fn depth(times: usize) -> Fallible<()> {
    let scene = Scene::build(&SceneSource::text("forest", forest(40, "", "")), &[])?;
    let mut worker = scene.worker()?;
    let mut s = draws(1);
    let mut cameras = Vec::new();
    for _ in 0..16 {
        let pos = [s.uniform(-12.0, 12.0), s.uniform(-12.0, 12.0), s.uniform(0.8, 2.5)];
        let (yaw, ahead) = (s.uniform(-3.1, 3.1), propwash::sense::depth::LOOKING_FORWARD_XYZW);
        let turn = [0.0, 0.0, f64::sin(0.5 * yaw), f64::cos(0.5 * yaw)];
        let pose = Pose::new(pos, propwash::math::quat::mul(turn, ahead));
        let camera = Camera::in_world(&scene, pose, Lens::Fovy { fovy_deg: 45.0 })?.with_size(64, 64)?;
        cameras.push(camera.with_kind(DepthKind::Range));
    }
    let mut frame = DepthFrame::new();
    for _ in 0..times {
        for camera in &cameras {
            camera.render(&mut worker, &mut frame)?;
        }
    }
    Ok(())
}

/// Drones in a forest: a pool of workers, and their positions and attitudes.
fn drones() -> Fallible<(WorkerPool, Vec<f64>, Vec<f64>)> {
    let source = SceneSource::text("forest", forest(40, "", ""));
    let scene = Scene::build(&source, &[Shell::builtin("cf2x")?])?;
    let mut s = draws(3);
    let mut pos = Vec::new();
    for _ in 0..WORLDS {
        pos.extend([s.uniform(-12.0, 12.0), s.uniform(-12.0, 12.0), s.uniform(0.3, 2.5)]);
    }
    Ok((WorkerPool::new(&scene), pos, [0.0, 0.0, 0.0, 1.0].repeat(WORLDS)))
}

fn poses<'a>(pos: &'a [f64], quat: &'a [f64]) -> WorldPoses<'a> {
    WorldPoses {
        n_worlds: pos.len() / 3,
        drone_pos_m: pos,
        drone_quat_xyzw: quat,
        obstacle_pos_m: None,
        obstacle_quat_xyzw: None,
    }
}

fn contacts(times: usize) -> Fallible<()> {
    let (pool, pos, quat) = drones()?;
    let (mut out, mut limited): (Vec<Vec<Contact>>, Vec<usize>) = Default::default();
    for _ in 0..times {
        poses(&pos, &quat).within(&pool).contacts(&mut out, &mut limited)?;
    }
    Ok(())
}

fn clearances(times: usize) -> Fallible<()> {
    let (pool, pos, quat) = drones()?;
    let mut out: Vec<Clearance> = Vec::new();
    for _ in 0..times {
        poses(&pos, &quat).within(&pool).clearances(5.0, &mut out)?;
    }
    Ok(())
}
