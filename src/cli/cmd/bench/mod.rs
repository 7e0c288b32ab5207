//! `propwash bench`: what this machine gives, with one's own scene and vehicle.

mod fleet;
mod measure;

use super::{io_error, print};
use crate::cli::args::BenchArgs;
use crate::cli::bench_args::{PartArg, PrecisionArg};
use crate::cli::exit::{Outcome, warn};
use crate::cli::output;
use crate::scalar::lanes::{Number, level_name};
use crate::scene::mujoco_version;
use crate::{Error, Result};
use fleet::{Fleet, Job, STEPS, STEPS_PER_FRAME};
use measure::{Rate, figure, load, peak_mib, processor, rate, seconds};
use serde_json::{Value, json};
use std::ffi::OsString;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

/// Most worlds of one simulation.
const MAX_WORLDS: usize = 10_000_000;
/// Most threads that can be asked for; more than any machine has use for.
const MAX_THREADS: usize = 1024;
/// Steps per second of flight.
const SIM_HZ: f64 = 500.0;
/// Processes that the start to the first image is measured with.
const STARTS: usize = 3;
/// Flight before drones look around, in calls of [`STEPS`].
const CALLS_BEFORE_LOOKING: usize = 15;

/// How a process of its own is started that does the same.
#[derive(Clone, Copy)]
pub struct Start<'a> {
    /// The program, and what it is told before the words of the command.
    pub again: &'a [OsString],
    /// The words of the command.
    pub words: &'a [OsString],
}

/// Runs the command.
pub fn run(args: &BenchArgs, own: &Start<'_>) -> Result<Outcome> {
    match args.precision {
        PrecisionArg::F32 => run_as::<f32>(args, own),
        PrecisionArg::F64 => run_as::<f64>(args, own),
    }
}

fn run_as<N: Number>(args: &BenchArgs, own: &Start<'_>) -> Result<Outcome> {
    check(args)?;
    let job = Job::load(args)?;
    if let Some(part) = args.part {
        tell::<N>(args, &job, part)?;
        return Ok(Outcome::Fine);
    }
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut report = Report::new(args, &job, cores)?;
    let all = args.threads.unwrap_or(cores);
    let mut threads = vec![1, all];
    threads.dedup();
    for &n in &threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().map_err(|e| Error::Usage {
            flag: "--threads",
            expected: "threads that start".into(),
            got: e.to_string(),
        })?;
        pool.install(|| steps::<N>(args, &job, n, &mut report))?;
        pool.install(|| sensing::<N>(args, &job, n, &mut report))?;
    }
    start(own, &job, &mut report)?;
    memory(own, args, &mut report)?;
    report.end()?;
    Ok(Outcome::Fine)
}

fn check(args: &BenchArgs) -> Result<()> {
    let refuse =
        |flag, expected: String, got: usize| Err(Error::Usage { flag, expected, got: got.to_string() });
    if let Some(n) = args.worlds.iter().find(|n| !(1..=MAX_WORLDS).contains(*n)) {
        return refuse("--worlds", format!("1 to {MAX_WORLDS} each"), *n);
    }
    if !(1..=MAX_WORLDS).contains(&args.sensing_worlds) {
        return refuse("--sensing-worlds", format!("1 to {MAX_WORLDS}"), args.sensing_worlds);
    }
    output::check(&[("--out", args.out.as_deref())], args.force)?;
    match args.threads {
        Some(n) if !(1..=MAX_THREADS).contains(&n) => refuse("--threads", format!("1 to {MAX_THREADS}"), n),
        _ => Ok(()),
    }
}

/// Dynamics alone.
fn steps<N: Number>(args: &BenchArgs, job: &Job, threads: usize, report: &mut Report) -> Result<()> {
    for &worlds in &args.worlds {
        let mut fleet = Fleet::<N>::new(job, worlds)?;
        let rate = rate(args.seconds, (worlds * STEPS) as f64, || fleet.fly(STEPS))?;
        report.row("steps", worlds, threads, rate, "steps/s", Some(1.0 / SIM_HZ))?;
        report.stopped(worlds, fleet.stopped());
    }
    Ok(())
}

/// Depth, contacts, clearances, and all of it in flight.
fn sensing<N: Number>(args: &BenchArgs, job: &Job, threads: usize, report: &mut Report) -> Result<()> {
    let worlds = args.sensing_worlds;
    let mut fleet = Fleet::<N>::new(job, worlds)?;
    for _ in 0..CALLS_BEFORE_LOOKING {
        fleet.fly(STEPS)?;
    }
    let n = worlds as f64;
    let depth = rate(args.seconds, n, || seconds(|| fleet.see()))?;
    report.row("depth", worlds, threads, depth, "frames/s", None)?;
    let pixels = job.size().iter().product::<usize>() as f64;
    let scaled = |v: f64| v * pixels;
    let rays = Rate {
        median: scaled(depth.median),
        low: scaled(depth.low),
        high: scaled(depth.high),
        calls: depth.calls,
    };
    report.row("depth", worlds, threads, rays, "pixels/s", None)?;
    let contacts = rate(args.seconds, n, || seconds(|| fleet.touch()))?;
    report.row("contacts", worlds, threads, contacts, "drones/s", None)?;
    let clearances = rate(args.seconds, n, || seconds(|| fleet.keep_clear()))?;
    report.row("clearances", worlds, threads, clearances, "drones/s", None)?;
    let whole = rate(args.seconds, n, || {
        let flown = fleet.fly(STEPS_PER_FRAME)?;
        let sensed = seconds(|| {
            fleet.see()?;
            fleet.touch()
        })?;
        Ok(flown + sensed)
    })?;
    report.row("loop", worlds, threads, whole, "frames/s", Some(STEPS_PER_FRAME as f64 / SIM_HZ))?;
    report.stopped(worlds, fleet.stopped());
    Ok(())
}

/// What a process of its own does and prints.
fn tell<N: Number>(args: &BenchArgs, job: &Job, part: PartArg) -> Result<()> {
    let before = peak_mib();
    match part {
        PartArg::FirstFrame => {
            Fleet::<N>::new(job, 1)?.see()?;
        }
        PartArg::Memory => {
            Fleet::<N>::new(job, largest(args))?.fly(STEPS)?;
        }
    }
    print(json!({ "before_mib": before, "peak_mib": peak_mib() }))
}

fn largest(args: &BenchArgs) -> usize {
    args.worlds.iter().copied().max().unwrap_or(1)
}

/// Another process with the same arguments that measures one part: seconds from its start to its answer, and the answer.
fn ask(own: &Start<'_>, part: &str) -> Result<(f64, Value)> {
    let (program, first) = own.again.split_first().ok_or_else(|| Error::Usage {
        flag: "bench",
        expected: "the program that it starts again, from a system or a caller that names it".into(),
        got: "none".into(),
    })?;
    let failed = io_error(Path::new(program));
    let start = Instant::now();
    let answer = || {
        let mut child = Command::new(program)
            .args(first)
            .args(own.words)
            .args(["--part", part])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        let mut text = String::new();
        if let Some(out) = child.stdout.take() {
            let mut lines = BufReader::new(out);
            lines.read_line(&mut text)?;
        }
        let seconds = start.elapsed().as_secs_f64();
        let out = child.wait_with_output()?;
        match serde_json::from_str(&text) {
            Ok(told) if out.status.success() => Ok((seconds, told)),
            _ => {
                let words = String::from_utf8_lossy(&out.stderr).trim().to_string();
                Err(std::io::Error::other(format!("the part `{part}` of the measurement failed: {words}")))
            }
        }
    };
    answer().map_err(failed)
}

fn start(own: &Start<'_>, job: &Job, report: &mut Report) -> Result<()> {
    let mut all = Vec::new();
    let mut peaks = Vec::new();
    for _ in 0..STARTS {
        let (seconds, told) = ask(own, "first-frame")?;
        all.push(seconds);
        peaks.extend(told["peak_mib"].as_f64());
    }
    all.sort_by(f64::total_cmp);
    peaks.sort_by(f64::total_cmp);
    let [width, height] = job.size();
    // The program `propwash` starts as one file; what has words of its own before those of the command is Python with the package.
    let what = match own.again.len() {
        1 => "start to first depth image",
        _ => "start to first depth image, with Python's own start",
    };
    report.single(what, all[STARTS / 2], "s", [all[0], all[STARTS - 1]])?;
    if let Some(peak) = peaks.get(peaks.len() / 2) {
        let what = format!("memory to first image of {width}x{height}");
        report.single(&what, *peak, "MiB", [peaks[0], peaks[peaks.len() - 1]])?;
    }
    Ok(())
}

fn memory(own: &Start<'_>, args: &BenchArgs, report: &mut Report) -> Result<()> {
    let worlds = largest(args);
    let (_, told) = ask(own, "memory")?;
    match (told["before_mib"].as_f64(), told["peak_mib"].as_f64()) {
        (Some(before), Some(peak)) => {
            let grown = peak - before;
            let what = format!("memory of {worlds} world{} of dynamics", if worlds == 1 { "" } else { "s" });
            report.single(&what, grown, "MiB", [grown, grown])
        }
        _ => {
            report.warn("memory: this system does not say how much a process uses (no /proc/self/status)");
            Ok(())
        }
    }
}

/// The table as it grows, and the same as JSON.
struct Report<'a> {
    file: Option<&'a Path>,
    /// Whether it may replace another.
    force: bool,
    /// Whether JSON is printed in place of text.
    as_json: bool,
    head: Value,
    rows: Vec<Value>,
    warnings: Vec<String>,
}

impl<'a> Report<'a> {
    fn new(args: &'a BenchArgs, job: &Job, cores: usize) -> Result<Self> {
        let precision = match args.precision {
            PrecisionArg::F32 => "f32",
            PrecisionArg::F64 => "f64",
        };
        let [width, height] = job.size();
        let load = load();
        let head = json!({
            "propwash": env!("CARGO_PKG_VERSION"), "mujoco": mujoco_version(), "processor": processor(),
            "cores": cores, "lanes": level_name(), "load": load, "drone": args.drone, "dynamics": args.dynamics,
            "control": args.control, "precision": precision, "scene": job.scene().name(),
            "geoms": job.scene().geoms().len(), "width": width, "height": height,
            "steps_per_call": STEPS, "sim_hz": SIM_HZ, "steps_per_frame": STEPS_PER_FRAME,
        });
        if !args.json {
            print_head(args, job, (cores, precision), load.as_deref())?;
        }
        Ok(Self {
            file: args.out.as_deref(),
            force: args.force,
            as_json: args.json,
            head,
            rows: Vec::new(),
            warnings: job.scene().warnings().to_vec(),
        })
    }

    /// A rate of something; `seconds` of flight that one of it stands for.
    fn row(
        &mut self,
        what: &str,
        worlds: usize,
        threads: usize,
        rate: Rate,
        unit: &str,
        seconds: Option<f64>,
    ) -> Result<()> {
        let times = seconds.map(|s| s * rate.median);
        self.rows.push(json!({
            "what": what, "worlds": worlds, "threads": threads, "unit": unit, "median": rate.median,
            "low": rate.low, "high": rate.high, "calls": rate.calls, "times_real_time": times,
        }));
        if self.as_json {
            return Ok(());
        }
        print_row(
            what,
            &[
                &worlds.to_string(),
                &threads.to_string(),
                &figure(rate.median),
                &figure(rate.low),
                &figure(rate.high),
                unit,
                &times.map(figure).unwrap_or_default(),
            ],
        )
    }

    /// A single figure, with the least and the greatest that was measured.
    fn single(&mut self, what: &str, value: f64, unit: &str, range: [f64; 2]) -> Result<()> {
        self.rows.push(json!({
            "what": what, "unit": unit, "median": value, "low": range[0], "high": range[1],
        }));
        if self.as_json {
            return Ok(());
        }
        let between = if range[0] < range[1] {
            format!(" ({} to {})", figure(range[0]), figure(range[1]))
        } else {
            String::new()
        };
        print(format_args!("{what}: {} {unit}{between}", figure(value)))
    }

    fn warn(&mut self, words: &str) {
        self.warnings.push(words.to_string());
    }

    fn stopped(&mut self, worlds: usize, stopped: usize) {
        if stopped > 0 {
            self.warn(&format!(
                "{stopped} of {worlds} worlds were stopped, since their states were not finite: their steps cost nothing"
            ));
        }
    }

    fn end(self) -> Result<()> {
        for warning in &self.warnings {
            warn(warning);
        }
        let mut all = self.head;
        all["rows"] = json!(self.rows);
        all["warnings"] = json!(self.warnings);
        if self.as_json {
            print(format_args!("{all:#}"))?;
        }
        match self.file {
            Some(path) => output::write("--out", path, format!("{all:#}\n").as_bytes(), self.force),
            None => Ok(()),
        }
    }
}

/// What stands above the table.
fn print_head(
    args: &BenchArgs,
    job: &Job,
    (cores, precision): (usize, &str),
    load: Option<&str>,
) -> Result<()> {
    let [width, height] = job.size();
    print(format_args!(
        "propwash {}, MuJoCo {}; {}, {cores} core{}, lanes {}; load of the machine at the start {}",
        env!("CARGO_PKG_VERSION"),
        mujoco_version(),
        processor(),
        if cores == 1 { "" } else { "s" },
        level_name(),
        load.unwrap_or("not known"),
    ))?;
    print(format_args!(
        "{} {} under {} in {precision}, {STEPS} steps a call; {}, {} geoms; {} × {} pixels\n",
        args.drone,
        args.dynamics,
        args.control,
        job.scene().name(),
        job.scene().geoms().len(),
        width,
        height
    ))?;
    let cells = ["worlds", "threads", "median", "5 %", "95 %", "", "× real time"];
    print_row("", &cells)
}

fn print_row(what: &str, cells: &[&str; 7]) -> Result<()> {
    let [worlds, threads, median, low, high, unit, times] = cells;
    let line =
        format!("{what:<12}{worlds:>9}{threads:>9}{median:>10}{low:>10}{high:>10}  {unit:<10}{times:>12}");
    print(line.trim_end())
}
