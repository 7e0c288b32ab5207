//! Depth by the native ray caster and by its peers: each a process of its own, all asked alternately.
//!
//! `cargo xtask bench depth --help`. Prints Markdown tables. On Linux only: it reads `/proc` and pins with `taskset`.

#[path = "common/forest.rs"]
mod forest;

use std::io::{BufRead, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitCode, Stdio};
use std::time::Instant;

use clap::Parser;
use forest::{draws, forest, hills, median, processor};
use propwash::math::quat;
use propwash::scene::{Pose, Scene, SceneSource, Shell, Worker, WorkerPool, mujoco_version};
use propwash::sense::{
    Camera, Caster, DepthBatch, DepthFrame, Lens, RayPattern, RayPlanes, RayQuery, WorldPoses, cast_pattern,
    caster, render_batch,
};
use serde_json::{Value, json};

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

type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

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
    let done = match &args.serve {
        Some(who) => serve(&args, who),
        None => run(&args),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
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
    println!(
        "{}, lanes {}; MuJoCo {}, propwash {}; medians of {} rounds; load of the machine at the start {}\n",
        processor(),
        caster::lanes_in_use(),
        mujoco_version(),
        env!("CARGO_PKG_VERSION"),
        args.rounds,
        load(),
    );
    let mut versions = Vec::new();
    images(args, &who, &mut versions)?;
    sensors(args, &who)?;
    if args.worlds > 0 && "1024 worlds".contains(&args.scene) {
        worlds(args, &who)?;
    }
    if !versions.is_empty() {
        println!("Peers: {}.", versions.join("; "));
    }
    println!("Load of the machine at the end {}.", load());
    Ok(())
}

/// One core, one camera after the other.
fn images(args: &Args, who: &[(&str, &str)], versions: &mut Vec<String>) -> Fallible<()> {
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
    let table = |title: &str, cell: &dyn Fn(&[Outcome], usize) -> String| {
        println!("{title}\n");
        println!("| scene | {} |", who.iter().map(|(_, title)| *title).collect::<Vec<_>>().join(" | "));
        println!("| --- |{}", " ---: |".repeat(who.len()));
        for (name, outcomes) in &rows {
            let cells: Vec<String> = (0..who.len()).map(|k| cell(outcomes, k)).collect();
            println!("| {name} | {} |", cells.join(" | "));
        }
        println!();
    };
    let (side, cameras) = (args.side, args.cameras);
    table(
        &format!(
            "Frames per second on one core, {side} × {side} pixels, {cameras} cameras (how many times as many Propwash makes)."
        ),
        &|all, k| all[k].rate(&all[0]),
    );
    table("Start of the process to its first frame, s.", &|all, k| {
        all[k].told(|o| format!("{:.2}", o.first_s))
    });
    table("Most memory of the process, MiB.", &|all, k| all[k].told(|o| format!("{:.0}", o.memory_mib)));
    table(
        "Pixels that `mj_multiRay` sees otherwise (hit against miss, or 0.1 % of the range), of those cast.",
        &|all, k| all[k].told(|o| o.differ.map_or("–".into(), |(odd, of)| format!("{odd} of {of}"))),
    );
    Ok(())
}

/// Other images and patterns, one core.
fn sensors(args: &Args, who: &[(&str, &str)]) -> Fallible<()> {
    let views = [
        ("one pixel", "1x1", 16),
        ("61 × 37 pixels", "61x37", 16),
        ("1920 × 1080 pixels", "1920x1080", 2),
        ("fisheye of 220°, 64 × 64 pixels", "fisheye", 16),
        ("LiDAR, 32 beams × 1,024", "lidar", 16),
    ];
    let own: Vec<(&str, &str)> =
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
            println!("Other sensors in the forest of 40 geoms, one core.\n");
            println!(
                "| sensor | rays | frames/s | million rays/s | `mj_multiRay`, frames/s | first frame, s | memory, MiB | pixels that differ |"
            );
            println!("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
            head = true;
        }
        let rays = View::parse(view)?.rays();
        let o = &all[0];
        println!(
            "| {name} | {rays} | {:.0} | {:.1} | {} | {:.2} | {:.0} | {} |",
            o.fps,
            o.fps * rays as f64 / 1e6,
            all.get(1).map_or("–".into(), |p| p.rate(o)),
            o.first_s,
            o.memory_mib,
            o.differ.map_or("–".into(), |(odd, of)| format!("{odd} of {of}"))
        );
    }
    if head {
        println!();
    }
    Ok(())
}

/// A camera in each of many worlds, one call for all, on one core and on all.
fn worlds(args: &Args, who: &[(&str, &str)]) -> Fallible<()> {
    let folder = tempfile::tempdir()?;
    write(folder.path(), &forest(40, "", ""), &poses(40, args.worlds as usize))?;
    let view = format!("{0}x{0}", args.side);
    let pixels = (args.worlds as usize * args.side * args.side) as f64;
    println!(
        "{} worlds of the forest of 40 geoms, one camera of {1} × {1} pixels in each, one call for all. The depths take {2:.1} MiB; \
         Propwash's states, geoms and bodies {3:.1} MiB more.\n",
        args.worlds,
        args.side,
        pixels * 4.0 / 1048576.0,
        pixels * 9.0 / 1048576.0
    );
    println!("| cores | who | frames/s | first call, s | memory, MiB |");
    println!("| --- | --- | ---: | ---: | ---: |");
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    for (pinned, title) in [(true, "1".to_string()), (false, cores.to_string())] {
        eprintln!("{} worlds, {title} cores", args.worlds);
        let all = contest(args, folder.path(), &view, true, pinned, who)?;
        for (k, (_, name)) in who.iter().enumerate() {
            println!(
                "| {title} | {name} | {} | {} | {} |",
                all[k].rate(&all[0]),
                all[k].told(|o| format!("{:.2}", o.first_s)),
                all[k].told(|o| format!("{:.0}", o.memory_mib))
            );
        }
    }
    println!();
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
    fn told(&self, words: impl Fn(&Self) -> String) -> String {
        self.refused.clone().unwrap_or_else(|| words(self))
    }

    /// Frames per second, and how many times as many `best` has.
    fn rate(&self, best: &Self) -> String {
        self.told(|o| {
            let fps = if o.fps < 10.0 { format!("{:.2}", o.fps) } else { format!("{:.0}", o.fps) };
            if std::ptr::eq(o, best) { fps } else { format!("{fps} ({:.0} ×)", best.fps / o.fps) }
        })
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
            let (frames, seconds) = process.measure()?;
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
            memory_mib: if process.refused.is_some() { f64::NAN } else { process.peak_mib()? },
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
    child: Child,
    ask: ChildStdin,
    answers: BufReader<ChildStdout>,
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
        let venv = Path::new(env!("CARGO_MANIFEST_DIR")).join(".venv/bin/python");
        let python = std::env::var_os("PROPWASH_PYTHON").map_or(venv, PathBuf::from);
        let ours = name == "native" || name == "multiray";
        let program = if ours { std::env::current_exe()? } else { python };
        let mut command = if pinned {
            let mut command = Command::new("taskset");
            command.args(["--cpu-list", &last_core()?]).arg(&program);
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
        let start = Instant::now();
        let mut child = command
            // MuJoCo leaves its log in the current folder.
            .current_dir(folder)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(if ours { Stdio::inherit() } else { Stdio::null() })
            .spawn()
            .map_err(|e| {
                let shown = command.get_program().to_string_lossy().into_owned();
                format!("`{shown}` could not be started: {e}; `cargo xtask bench depth` sets the peers up")
            })?;
        let ask = child.stdin.take().ok_or("no input of the process")?;
        let answers = BufReader::new(child.stdout.take().ok_or("no output of the process")?);
        let mut process = Self {
            child,
            ask,
            answers,
            versions: String::new(),
            refused: None,
            first_s: f64::NAN,
            slow: false,
        };
        let mut told: Value = serde_json::from_str(&process.line(name)?)?;
        if told["first"] == true {
            process.first_s = start.elapsed().as_secs_f64();
            told = serde_json::from_str(&process.line(name)?)?;
        }
        process.versions = told["versions"].as_str().unwrap_or_default().into();
        process.refused = told["refused"].as_str().map(Into::into);
        Ok(process)
    }

    fn line(&mut self, name: &str) -> Fallible<String> {
        loop {
            let mut line = String::new();
            if self.answers.read_line(&mut line)? == 0 {
                return Err(format!("{name} ended without an answer; run it by hand to see why").into());
            }
            // Anything else is a remark of a library.
            if line.starts_with(['{', '[']) {
                return Ok(line);
            }
        }
    }

    /// Frames and seconds of a round.
    fn measure(&mut self) -> Fallible<(f64, f64)> {
        writeln!(self.ask)?;
        self.ask.flush()?;
        Ok(serde_json::from_str(&self.line("a peer")?)?)
    }

    /// Most memory that it had in use, MiB.
    fn peak_mib(&self) -> Fallible<f64> {
        let text = std::fs::read_to_string(format!("/proc/{}/status", self.child.id()))?;
        let line = text.lines().find_map(|l| l.strip_prefix("VmHWM:")).ok_or("no VmHWM in /proc")?;
        Ok(line.trim().trim_end_matches(" kB").trim().parse::<f64>()? / 1024.0)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // Failing to end it leaves a process that ends with its input.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The last core that this process may use.
fn last_core() -> Fallible<String> {
    let text = std::fs::read_to_string("/proc/self/status")?;
    let list =
        text.lines().find_map(|l| l.strip_prefix("Cpus_allowed_list:")).ok_or("no Cpus_allowed_list")?;
    Ok(list.trim().rsplit([',', '-']).next().unwrap_or("0").to_string())
}

/// Rays of a sensor.
enum View {
    Image(usize, usize),
    Pattern(Vec<[f64; 3]>),
}

impl View {
    fn parse(text: &str) -> Fallible<Self> {
        if text == "fisheye" {
            // Equidistant: the angle from the axis grows with the distance from the middle, 110° at the edges.
            let mut rays = Vec::new();
            for row in 0..64 {
                for col in 0..64 {
                    let (x, y) = ((f64::from(col) - 31.5) / 32.0, (31.5 - f64::from(row)) / 32.0);
                    let (turn, angle) = (y.atan2(x), x.hypot(y) * 110f64.to_radians());
                    rays.push([angle.sin() * turn.cos(), angle.sin() * turn.sin(), -angle.cos()]);
                }
            }
            // Eight by eight in a row: neighbours in the list are neighbours in space.
            let tiled = (0..4096).map(|k| {
                let (tile, own) = (k / 64, k % 64);
                let (packet, lane) = (own / 16, own % 16);
                let row = 8 * (tile / 8) + 4 * (packet / 2) + lane / 4;
                rays[64 * row + 8 * (tile % 8) + 4 * (packet % 2) + lane % 4]
            });
            return Ok(Self::Pattern(tiled.collect()));
        }
        if text == "lidar" {
            // 32 rings from 25° below to 15° above the horizon of a sensor whose z axis points up.
            let mut rays = Vec::new();
            for ring in 0..32 {
                let up = (-25.0 + 40.0 * f64::from(ring) / 31.0).to_radians();
                for step in 0..1024 {
                    let turn = f64::from(step) * std::f64::consts::TAU / 1024.0;
                    // The sensor's y is up, as in a camera.
                    rays.push([up.cos() * turn.cos(), up.sin(), up.cos() * turn.sin()]);
                }
            }
            return Ok(Self::Pattern(rays));
        }
        let (width, height) =
            text.split_once('x').ok_or("--view: expected WIDTHxHEIGHT, fisheye or lidar")?;
        Ok(Self::Image(width.parse()?, height.parse()?))
    }

    fn rays(&self) -> usize {
        match self {
            Self::Image(width, height) => width * height,
            Self::Pattern(rays) => rays.len(),
        }
    }
}

/// One of ours.
trait Contestant {
    /// Casts call `k`.
    fn cast(&mut self, k: usize) -> Fallible<()>;
    /// Ranges of the last call.
    fn ranges(&self) -> Vec<f32>;
}

/// The side of ours of the protocol in the script.
fn serve(args: &Args, who: &str) -> Fallible<()> {
    let folder = args.folder.as_deref().ok_or("--folder is missing")?;
    let xml = std::fs::read_to_string(folder.join("scene.xml"))?;
    let bytes = std::fs::read(folder.join("poses.f64"))?;
    let numbers: Vec<f64> = bytes
        .chunks_exact(8)
        .map(|b| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]))
        .collect();
    let poses: Vec<Pose> =
        numbers.chunks_exact(7).map(|p| Pose::new([p[0], p[1], p[2]], [p[3], p[4], p[5], p[6]])).collect();
    let view = View::parse(&args.view)?;
    let caster = if who == "native" { Caster::Native } else { Caster::MuJoCo };
    let (calls, frames) = if args.in_worlds { (1, poses.len()) } else { (poses.len(), 1) };
    let mut contestant: Box<dyn Contestant> = match (view, args.in_worlds) {
        (View::Image(width, height), true) => Box::new(Worlds::new(&xml, &poses, width, height, caster)?),
        (View::Pattern(_), true) => return Err("worlds have images only".into()),
        (view, false) => {
            let scene = Scene::build(&SceneSource::text("forest", &xml), &[])?;
            match caster {
                Caster::Native => Box::new(Native::new(&scene, poses, &view, args.normals)?),
                Caster::MuJoCo => Box::new(MultiRay::new(&scene, &poses, &view, args.normals)?),
            }
        }
    };
    let mut seen = Vec::new();
    for k in 0..calls {
        contestant.cast(k)?;
        if k == 0 {
            println!("{}", json!({ "first": true }));
        }
        for range in contestant.ranges() {
            seen.extend(range.to_le_bytes());
        }
    }
    std::fs::write(folder.join(format!("{who}.f32")), seen)?;
    println!("{}", json!({ "versions": "" }));
    for line in std::io::stdin().lines() {
        line?;
        let (begin, mut count) = (Instant::now(), 0);
        while begin.elapsed().as_secs_f64() < ROUND_S {
            for k in 0..calls {
                contestant.cast(k)?;
                count += frames;
                if begin.elapsed().as_secs_f64() > LIMIT_S {
                    break;
                }
            }
        }
        println!("{}", json!([count, begin.elapsed().as_secs_f64()]));
    }
    Ok(())
}

/// The native caster, by a camera or by a pattern.
struct Native {
    worker: Worker,
    cameras: Vec<Camera>,
    pattern: RayPattern,
    poses: Vec<Pose>,
    frame: DepthFrame,
}

impl Native {
    fn new(scene: &Scene, poses: Vec<Pose>, view: &View, normals: bool) -> Fallible<Self> {
        let (mut cameras, mut pattern, mut frame) = (Vec::new(), RayPattern::default(), DepthFrame::new());
        match view {
            View::Image(..) => cameras = image(scene, &poses, view, normals)?,
            View::Pattern(rays) => {
                pattern = RayPattern::new(rays)?;
                frame.depth_m.resize(pattern.len(), 0.0);
                frame.geom_id.resize(pattern.len(), 0);
                frame.body_id.resize(pattern.len(), 0);
            }
        }
        Ok(Self { worker: scene.worker()?, cameras, pattern, poses, frame })
    }
}

fn image(scene: &Scene, poses: &[Pose], view: &View, normals: bool) -> Fallible<Vec<Camera>> {
    let &View::Image(width, height) = view else { return Err("a pattern is no image".into()) };
    let lens = Lens::Fovy { fovy_deg: 45.0 };
    let make = |pose: &Pose| {
        Ok(Camera::in_world(scene, *pose, lens)?.with_size(width, height)?.with_normals(normals))
    };
    poses.iter().map(make).collect()
}

impl Contestant for Native {
    fn cast(&mut self, k: usize) -> Fallible<()> {
        if let Some(camera) = self.cameras.get(k) {
            camera.render(&mut self.worker, &mut self.frame)?;
        } else {
            let planes = RayPlanes {
                range_m: Some(&mut self.frame.depth_m),
                geom_id: Some(&mut self.frame.geom_id),
                body_id: Some(&mut self.frame.body_id),
                normal: None,
            };
            cast_pattern(&mut self.worker, &self.poses[k], &self.pattern, &RayQuery::default(), planes)?;
        }
        Ok(())
    }

    fn ranges(&self) -> Vec<f32> {
        self.frame.depth_m.clone()
    }
}

/// `mj_multiRay` with directions that stand ready.
struct MultiRay {
    worker: Worker,
    rays: Vec<([f64; 3], Vec<[f64; 3]>)>,
    distances: Vec<f64>,
    geoms: Vec<i32>,
    normals: Option<Vec<[f64; 3]>>,
}

impl MultiRay {
    fn new(scene: &Scene, poses: &[Pose], view: &View, normals: bool) -> Fallible<Self> {
        let own: Vec<[f64; 3]> = match view {
            View::Image(..) => image(scene, &poses[..1], view, false)?[0].rays(),
            View::Pattern(rays) => rays.clone(),
        };
        let turn = |pose: &Pose| own.iter().map(|d| quat::rotate(pose.quat_xyzw, *d)).collect();
        Ok(Self {
            worker: scene.worker()?,
            rays: poses.iter().map(|pose| (pose.pos_m, turn(pose))).collect(),
            distances: vec![0.0; own.len()],
            geoms: vec![0; own.len()],
            normals: normals.then(|| vec![[0.0; 3]; own.len()]),
        })
    }
}

impl Contestant for MultiRay {
    fn cast(&mut self, k: usize) -> Fallible<()> {
        let (pos, rays) = &self.rays[k];
        let (distances, geoms) = (&mut self.distances, &mut self.geoms);
        self.worker.rays(*pos, rays, None, None, distances, geoms, self.normals.as_deref_mut())?;
        Ok(())
    }

    fn ranges(&self) -> Vec<f32> {
        self.distances.iter().map(|d| if *d < 0.0 { f32::INFINITY } else { *d as f32 }).collect()
    }
}

/// A drone with a camera in each of many worlds.
struct Worlds {
    pool: WorkerPool,
    camera: Camera,
    pos: Vec<f64>,
    quat: Vec<f64>,
    out: DepthBatch,
}

impl Worlds {
    fn new(xml: &str, poses: &[Pose], width: usize, height: usize, caster: Caster) -> Fallible<Self> {
        let shell = Shell {
            name: "eye".into(),
            xml: "<mujoco><worldbody><body name='drone'><geom size='0.05'/><camera name='fpv' fovy='45'/></body></worldbody></mujoco>"
                .into(),
            dir: None,
        };
        let scene = Scene::build(&SceneSource::text("forest", xml), &[shell])?;
        let camera = Camera::on_drone(&scene, 0, "fpv")?.with_size(width, height)?.with_caster(caster);
        Ok(Self {
            pool: WorkerPool::new(&scene),
            camera,
            pos: poses.iter().flat_map(|p| p.pos_m).collect(),
            quat: poses.iter().flat_map(|p| p.quat_xyzw).collect(),
            out: DepthBatch::default(),
        })
    }
}

impl Contestant for Worlds {
    fn cast(&mut self, _: usize) -> Fallible<()> {
        let poses = WorldPoses {
            n_worlds: self.pos.len() / 3,
            drone_pos_m: &self.pos,
            drone_quat_xyzw: &self.quat,
            obstacle_pos_m: None,
            obstacle_quat_xyzw: None,
        };
        Ok(render_batch(&self.pool, std::slice::from_ref(&self.camera), &poses, &mut self.out)?)
    }

    fn ranges(&self) -> Vec<f32> {
        // Nobody compares these, and a copy would count as memory of the caster.
        Vec::new()
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

fn load() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split_whitespace().take(3).collect::<Vec<_>>().join(" ")
}

fn looking(pos: [f64; 3], yaw: f64, pitch: f64) -> Pose {
    let turn = [0.0, 0.0, (0.5 * yaw).sin(), (0.5 * yaw).cos()];
    let nod = [0.0, (0.5 * pitch).sin(), 0.0, (0.5 * pitch).cos()];
    let ahead = propwash::sense::depth::LOOKING_FORWARD_XYZW;
    Pose::new(pos, quat::mul(quat::mul(turn, nod), ahead))
}
