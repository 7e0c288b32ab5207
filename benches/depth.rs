//! Depth by the native ray caster and by its peers: each a process of its own, all asked alternately.
//!
//! `cargo xtask bench depth --help`. Prints Markdown tables. On Linux only: it reads `/proc` and pins with `taskset`.

mod common;
#[path = "depth/ours.rs"]
mod ours;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use clap::Parser;
use common::peer::{Peer, python};
use common::report::{Cell, Column, Report, count, nothing, number, numbers, shown, word, words};
use common::scenes::{draws, forest, hills};
use common::{Fallible, ended, machine, median};
use ours::{View, serve};
use propwash::math::quat;
use propwash::scene::{Pose, mujoco_version};
use propwash::sense::caster;
use serde_json::Value;

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/peers/depth.py");
/// All that are compared: name on the command line, title.
const ALL: [(&str, &str); 5] = [
    ("native", "Propwash"),
    ("multiray", "`mj_multiRay`"),
    ("batch", "`mujoco.batch`"),
    ("mjx", "MJX"),
    ("crazyflow", "Crazyflow"),
];
/// Least time of a round, s, as in the script.
const ROUND_S: f64 = 0.05;
/// A pass over the cameras stops here, s.
const LIMIT_S: f64 = 10.0;
/// Whoever needs longer for a round, s, has no more than three.
const SLOW_S: f64 = 3.0;
/// Longest time of any answer: compilers are slow.
const PATIENCE: Duration = Duration::from_secs(1200);

/// Casts depth images in forests, over a mesh and over a height field, by the native caster and its peers in turn.
#[derive(Parser)]
struct Args {
    /// How often each is asked; the median counts.
    #[arg(long, default_value_t = 9, value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,
    /// Side of the images, pixels.
    #[arg(long, default_value_t = 64)]
    side: usize,
    /// Cameras of each scene.
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..))]
    cameras: u32,
    /// Worlds of the batch; 0 leaves it out.
    #[arg(long, default_value_t = 1024)]
    worlds: u32,
    /// Only scenes and sensors whose name holds this.
    #[arg(long, default_value = "")]
    scene: String,
    /// Who takes part: native, multiray, batch, mjx, crazyflow.
    #[arg(long, value_delimiter = ',', default_values_t = ALL.map(|(name, _)| name.to_string()))]
    peers: Vec<String>,
    /// Leaves all peers out, for profiles.
    #[arg(long)]
    ours_alone: bool,
    /// Adds surface normals to the images of Propwash and `mj_multiRay`; the others take no part.
    #[arg(long)]
    normals: bool,
    /// Also writes the figures as lines of JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// One of ours, as a process that is asked: native or multiray.
    #[arg(long, hide = true, requires = "folder")]
    serve: Option<String>,
    #[arg(long, hide = true)]
    folder: Option<PathBuf>,
    #[arg(long, hide = true, default_value = "64x64")]
    view: String,
    #[arg(long, hide = true)]
    in_worlds: bool,
    /// Ignored; `cargo bench` passes it.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> ExitCode {
    let args = Args::parse();
    ended(match &args.serve {
        Some(who) => serve(&args, who),
        None => run(&args),
    })
}

fn run(args: &Args) -> Fallible<()> {
    if let Some(odd) = args.peers.iter().find(|p| !ALL.iter().any(|(name, _)| name == p)) {
        return Err(format!("--peers: expected native, multiray, batch, mjx or crazyflow, got {odd}").into());
    }
    let takes_part = |name: &str| {
        args.peers.iter().any(|p| p == name)
            && (!args.ours_alone || name == "native")
            && (!args.normals || name == "native" || name == "multiray")
    };
    let who: Vec<(&str, &str)> = ALL.into_iter().filter(|(name, _)| takes_part(name)).collect();
    let about = format!(
        "lanes {}; MuJoCo {}; medians of {} rounds",
        caster::lanes_in_use(),
        mujoco_version(),
        args.rounds
    );
    let mut report = Report::begin("depth", args.json.as_deref(), &about)?;
    let mut versions = Vec::new();
    images(args, &who, &mut report, &mut versions)?;
    sensors(args, &who, &mut report)?;
    if args.worlds > 0 && "1024 worlds".contains(&args.scene) {
        worlds(args, &who, &mut report)?;
    }
    if !versions.is_empty() {
        report.text(&format!("Peers: {}.", versions.join("; ")))?;
    }
    report.end()
}

/// One core, one camera after the other.
fn images(
    args: &Args,
    who: &[(&'static str, &str)],
    report: &mut Report,
    versions: &mut Vec<String>,
) -> Fallible<()> {
    let mut scenes = Vec::new();
    for n in [10, 40, 200, 1000] {
        scenes.push((format!("forest, {n} geoms"), n, forest(n, "", "")));
    }
    let mesh = "<mesh name='m' builtin='supertorus' params='100 0.5 1 1' scale='3 3 3'/>";
    let torus = forest(10, mesh, "<geom type='mesh' mesh='m' pos='0 0 2'/>");
    scenes.push(("mesh of 20,000 triangles, forest 10".into(), 11, torus));
    let field =
        format!("<hfield name='h' nrow='100' ncol='100' size='6 6 1 0.1' elevation='{}'/>", hills(100));
    let hilly = forest(10, &field, "<geom type='hfield' hfield='h'/>");
    scenes.push(("height field 100 × 100, forest 10".into(), 11, hilly));
    scenes.retain(|(name, ..)| name.contains(&args.scene));
    let mut rows = Vec::new();
    for (name, geoms, xml) in &scenes {
        eprintln!("{name}");
        let folder = tempfile::tempdir()?;
        let cameras = poses(*geoms, args.cameras as usize);
        write(folder.path(), xml, &cameras)?;
        let view = format!("{0}x{0}", args.side);
        let outcomes = contest(args, folder.path(), &view, false, true, who)?;
        for outcome in &outcomes {
            if !outcome.versions.is_empty() && !versions.contains(&outcome.versions) {
                versions.push(outcome.versions.clone());
            }
        }
        rows.push((name, outcomes));
    }
    if rows.is_empty() {
        return Ok(());
    }
    let mut columns: Vec<Column> = vec![words("scene", "scene")];
    columns.extend(who.iter().map(|(name, title)| numbers(name, title)));
    let mut table = |name: &'static str, caption: &str, cell: &dyn Fn(&[Outcome], usize) -> Cell| {
        report.table(name, caption, &columns)?;
        for (scene, outcomes) in &rows {
            let mut row = vec![word(scene.as_str())];
            row.extend((0..who.len()).map(|k| cell(outcomes, k)));
            report.row(row)?;
        }
        Fallible::Ok(())
    };
    let (side, cameras) = (args.side, args.cameras);
    table(
        "fps",
        &format!(
            "Frames per second on one core, {side} × {side} pixels, {cameras} cameras (how many times as many Propwash makes)."
        ),
        &|all, k| all[k].rate(&all[0]),
    )?;
    table("first_s", "Start of the process to its first frame, s.", &|all, k| {
        all[k].told(|o| number(o.first_s, 2))
    })?;
    table("memory_mib", "Most memory of the process, MiB.", &|all, k| {
        all[k].told(|o| number(o.memory_mib, 0))
    })?;
    table(
        "differ",
        "Pixels that `mj_multiRay` sees otherwise (hit against miss, or 0.1 % of the range), of those cast.",
        &|all, k| all[k].told(Outcome::differing),
    )
}

/// Other images and patterns, one core.
fn sensors(args: &Args, who: &[(&'static str, &str)], report: &mut Report) -> Fallible<()> {
    let views = [
        ("one pixel", "1x1", 16),
        ("61 × 37 pixels", "61x37", 16),
        ("1920 × 1080 pixels", "1920x1080", 2),
        ("fisheye of 220°, 64 × 64 pixels", "fisheye", 16),
        ("LiDAR, 32 beams × 1,024", "lidar", 16),
    ];
    let own: Vec<(&'static str, &str)> =
        who.iter().copied().filter(|(name, _)| ["native", "multiray"].contains(name)).collect();
    let mut head = false;
    for (name, view, cameras) in views {
        if !name.contains(&args.scene) {
            continue;
        }
        eprintln!("{name}");
        let folder = tempfile::tempdir()?;
        write(folder.path(), &forest(40, "", ""), &poses(40, cameras))?;
        let all = contest(args, folder.path(), view, false, true, &own)?;
        if !head {
            let columns = [
                words("sensor", "sensor"),
                numbers("rays", "rays"),
                numbers("fps", "frames/s"),
                numbers("mega_rays", "million rays/s"),
                numbers("multiray_fps", "`mj_multiRay`, frames/s"),
                numbers("first_s", "first frame, s"),
                numbers("memory_mib", "memory, MiB"),
                numbers("differ", "pixels that differ"),
            ];
            report.table("sensors", "Other sensors in the forest of 40 geoms, one core.", &columns)?;
            head = true;
        }
        let rays = View::parse(view)?.rays();
        let o = &all[0];
        report.row(vec![
            word(name),
            count(rays),
            number(o.fps, 0),
            number(o.fps * rays as f64 / 1e6, 1),
            all.get(1).map_or_else(nothing, |p| p.rate(o)),
            number(o.first_s, 2),
            number(o.memory_mib, 0),
            o.differing(),
        ])?;
    }
    Ok(())
}

/// A camera in each of many worlds, one call for all, on one core and on all.
fn worlds(args: &Args, who: &[(&'static str, &str)], report: &mut Report) -> Fallible<()> {
    let folder = tempfile::tempdir()?;
    write(folder.path(), &forest(40, "", ""), &poses(40, args.worlds as usize))?;
    let view = format!("{0}x{0}", args.side);
    let pixels = (args.worlds as usize * args.side * args.side) as f64;
    let caption = format!(
        "{} worlds of the forest of 40 geoms, one camera of {1} × {1} pixels in each, one call for all. The depths take {2:.1} MiB; \
         Propwash's states, geoms and bodies {3:.1} MiB more.",
        args.worlds,
        args.side,
        pixels * 4.0 / 1048576.0,
        pixels * 9.0 / 1048576.0
    );
    let columns = [
        numbers("threads", "cores"),
        words("who", "who"),
        numbers("fps", "frames/s"),
        numbers("first_s", "first call, s"),
        numbers("memory_mib", "memory, MiB"),
    ];
    report.table("worlds", &caption, &columns)?;
    for (pinned, threads) in [(true, 1), (false, machine::cores())] {
        eprintln!("{} worlds, {threads} cores", args.worlds);
        let all = contest(args, folder.path(), &view, true, pinned, who)?;
        for (k, (_, name)) in who.iter().enumerate() {
            report.row(vec![
                count(threads),
                word(*name),
                all[k].rate(&all[0]),
                all[k].told(|o| number(o.first_s, 2)),
                all[k].told(|o| number(o.memory_mib, 0)),
            ])?;
        }
    }
    Ok(())
}

/// What one process came to.
struct Outcome {
    /// Why it could not.
    refused: Option<String>,
    versions: String,
    fps: f64,
    first_s: f64,
    memory_mib: f64,
    /// Pixels that differ, of how many.
    differ: Option<(usize, usize)>,
}

impl Outcome {
    fn told(&self, cell: impl Fn(&Self) -> Cell) -> Cell {
        self.refused.as_deref().map_or_else(|| cell(self), word)
    }

    /// Frames per second, and how many times as many `best` has.
    fn rate(&self, best: &Self) -> Cell {
        self.told(|o| {
            let fps = if o.fps < 10.0 { format!("{:.2}", o.fps) } else { format!("{:.0}", o.fps) };
            let ratio = best.fps / o.fps;
            shown(o.fps, if std::ptr::eq(o, best) { fps } else { format!("{fps} ({ratio:.0} ×)") })
        })
    }

    /// Pixels that differ, of how many.
    fn differing(&self) -> Cell {
        self.differ.map_or_else(nothing, |(odd, of)| shown(odd as f64, format!("{odd} of {of}")))
    }
}

/// Starts them all, asks them in turn, and ends them.
fn contest(
    args: &Args,
    folder: &Path,
    view: &str,
    in_worlds: bool,
    pinned: bool,
    who: &[(&str, &str)],
) -> Fallible<Vec<Outcome>> {
    let mut all = Vec::new();
    for (name, _) in who {
        eprintln!("  {name}");
        all.push(Process::start(args, name, folder, view, in_worlds, pinned)?);
    }
    let mut rates = vec![Vec::new(); all.len()];
    for round in 0..args.rounds {
        for (process, rates) in all.iter_mut().zip(&mut rates) {
            if process.refused.is_some() || (process.slow && round >= 3) {
                continue;
            }
            let (frames, seconds) = process.peer.measure()?;
            process.slow |= seconds > SLOW_S;
            rates.push(frames / seconds);
        }
    }
    let truth = ranges(folder, "multiray");
    let mut outcomes = Vec::new();
    for ((process, rates), (name, _)) in all.iter_mut().zip(&mut rates).zip(who) {
        let seen = if *name == "multiray" || in_worlds { None } else { ranges(folder, name) };
        outcomes.push(Outcome {
            fps: median(rates),
            memory_mib: if process.refused.is_some() { f64::NAN } else { process.peer.peak_mib()? },
            first_s: process.first_s,
            refused: process.refused.take(),
            versions: std::mem::take(&mut process.versions),
            differ: seen.zip(truth.as_ref()).map(|(seen, truth)| difference(&seen, truth)),
        });
    }
    Ok(outcomes)
}

fn ranges(folder: &Path, name: &str) -> Option<Vec<f32>> {
    let bytes = std::fs::read(folder.join(format!("{name}.f32"))).ok()?;
    Some(bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
}

fn difference(seen: &[f32], truth: &[f32]) -> (usize, usize) {
    let cast = seen.iter().zip(truth).filter(|(a, b)| !a.is_nan() && !b.is_nan());
    let odd = |a: f32, b: f32| a.is_finite() != b.is_finite() || (a.is_finite() && (a - b).abs() > 1e-3 * b);
    cast.fold((0, 0), |(n, of), (a, b)| (n + usize::from(odd(*a, *b)), of + 1))
}

/// A process that has made its first pass and waits.
struct Process {
    peer: Peer,
    versions: String,
    refused: Option<String>,
    first_s: f64,
    slow: bool,
}

impl Process {
    fn start(
        args: &Args,
        name: &str,
        folder: &Path,
        view: &str,
        in_worlds: bool,
        pinned: bool,
    ) -> Fallible<Self> {
        let ours = name == "native" || name == "multiray";
        let program = if ours { std::env::current_exe()? } else { python() };
        let mut command = if pinned {
            let mut command = Command::new("taskset");
            command.args(["--cpu-list", &machine::last_core()?]).arg(&program);
            command.env("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1");
            command
        } else {
            Command::new(&program)
        };
        if ours {
            command.args(["--serve", name, "--view", view, "--folder"]).arg(folder);
            if in_worlds {
                command.arg("--in-worlds");
            }
            if args.normals {
                command.arg("--normals");
            }
        } else {
            command.args([SCRIPT, name]).arg(folder).args([args.side.to_string(), LIMIT_S.to_string()]);
            if in_worlds {
                command.arg("worlds");
            }
        }
        let shown = command.get_program().to_string_lossy().into_owned();
        let start = Instant::now();
        let mut peer = Peer::run(name, command, PATIENCE).map_err(|e| {
            format!("`{shown}` could not be started: {e}; `cargo xtask bench depth` sets the peers up")
        })?;
        let mut told: Value = peer.answer()?;
        let mut first_s = f64::NAN;
        if told["first"] == true {
            first_s = start.elapsed().as_secs_f64();
            told = peer.answer()?;
        }
        Ok(Self {
            peer,
            first_s,
            versions: told["versions"].as_str().unwrap_or_default().into(),
            refused: told["refused"].as_str().map(Into::into),
            slow: false,
        })
    }
}

/// Where cameras are in a scene of `geoms` geoms.
fn poses(geoms: usize, n: usize) -> Vec<Pose> {
    let mut s = draws(1);
    let reach = 2.0 * (geoms as f64).sqrt();
    let mut pose = || {
        let pos = [s.uniform(-reach, reach), s.uniform(-reach, reach), s.uniform(0.8, 2.5)];
        let (yaw, pitch) = (s.uniform(-3.1, 3.1), s.uniform(-0.2, 0.3));
        looking(pos, yaw, pitch)
    };
    (0..n).map(|_| pose()).collect()
}

/// What all processes read.
fn write(folder: &Path, xml: &str, poses: &[Pose]) -> Fallible<()> {
    std::fs::write(folder.join("scene.xml"), xml)?;
    let numbers = poses.iter().flat_map(|p| p.pos_m.into_iter().chain(p.quat_xyzw));
    std::fs::write(folder.join("poses.f64"), numbers.flat_map(f64::to_le_bytes).collect::<Vec<u8>>())?;
    Ok(())
}

fn looking(pos: [f64; 3], yaw: f64, pitch: f64) -> Pose {
    let turn = [0.0, 0.0, (0.5 * yaw).sin(), (0.5 * yaw).cos()];
    let nod = [0.0, (0.5 * pitch).sin(), 0.0, (0.5 * pitch).cos()];
    let ahead = propwash::sense::depth::LOOKING_FORWARD_XYZW;
    Pose::new(pos, quat::mul(quat::mul(turn, nod), ahead))
}
