//! Steps per second of many worlds, of swarms, and their memory, by Propwash and by Crazyflow, alternately.
//!
//! `cargo xtask bench steps --help`. Prints Markdown tables. On Linux only: it reads `/proc` and pins with `taskset`.

mod common;

use std::path::PathBuf;
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use clap::Parser;
use common::peer::Peer;
use common::report::{Cell, Report, code, count, figures, nothing, number, numbers, shown, word, words};
use common::{Fallible, ended, machine, median};
use propwash::physics::controllers::ControlMode;
use propwash::rollout::{Engine, Sim, SimOptions};
use propwash::scalar::lanes::{Number, level_name};
use propwash::vehicle::Vehicle;
use serde_json::{Value, json};

const VEHICLE: &str = "cf2x_L250";
const PARTS: [&str; 4] = ["rates", "cores", "swarms", "memory"];
/// Calls of an episode. What rests for minutes decays to denormal numbers, which the processor is slow with.
const EPISODE_CALLS: usize = 40;
/// Worlds that memory is measured with.
const MEMORY_WORLDS: [usize; 3] = [1, 65_536, 1_048_576];
/// Share of the memory at hand that a peer may be expected to need.
const MEMORY_SHARE: f64 = 0.6;

/// Steps a first-principles cf2x_L250 in many worlds and in swarms, by Propwash and by Crazyflow in turn.
#[derive(Parser)]
struct Args {
    /// How often each of the two runs, about 0.3 s each time.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,
    /// Steps of one call.
    #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
    /// What to measure: rates (one core), cores (attitude on all cores), swarms, memory.
    #[arg(long, value_delimiter = ',', default_values_t = PARTS.map(String::from))]
    parts: Vec<String>,
    /// Numbers of worlds.
    #[arg(long, value_delimiter = ',', default_values_t = [1usize, 64, 1024, 65536])]
    worlds: Vec<usize>,
    /// Control modes.
    #[arg(long, value_delimiter = ',', default_values_t = ["rotor_vel".to_string(), "attitude".into(), "state".into()])]
    modes: Vec<String>,
    /// Precisions: f32 and f64, for both alike.
    #[arg(long, value_delimiter = ',', default_values_t = ["f32".to_string(), "f64".into()])]
    precisions: Vec<String>,
    /// Swarms: worlds × drones in each.
    #[arg(long, value_delimiter = ',', value_parser = swarm, default_value = "1x1,1x64,1x1024,1x4096,16x256,64x64,1024x16")]
    swarms: Vec<(usize, usize)>,
    /// Longest time that Crazyflow may take to get ready, s; it compiles for every shape.
    #[arg(long, default_value_t = 300)]
    patience: u64,
    /// Leaves Crazyflow out, for profiles.
    #[arg(long)]
    ours_alone: bool,
    /// Also writes the figures as lines of JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// A process of its own, whose memory is asked for: control mode, precision, worlds.
    #[arg(long, hide = true, num_args = 3)]
    hold: Option<Vec<String>>,
    /// Ignored; `cargo bench` passes it.
    #[arg(long, hide = true)]
    bench: bool,
}

/// `16x256` → 16 worlds of 256 drones.
fn swarm(text: &str) -> Result<(usize, usize), String> {
    let parts = text.split_once('x').and_then(|(w, d)| Some((w.parse().ok()?, d.parse().ok()?)));
    parts
        .filter(|(w, d)| *w > 0 && *d > 0)
        .ok_or_else(|| format!("expected WORLDSxDRONES, such as 16x256; got {text}"))
}

/// One thing to measure.
#[derive(Clone, Copy)]
struct Case {
    control: ControlMode,
    worlds: usize,
    drones: usize,
    threads: usize,
    /// Whether Crazyflow takes part.
    peer: bool,
}

/// Million steps of a drone per second: medians and bests, NaN of who did not take part.
struct Rates {
    ours: f64,
    our_best: f64,
    theirs: f64,
    their_best: f64,
    /// Why the peer did not answer.
    refused: Option<String>,
}

impl Rates {
    fn cells(&self) -> Vec<Cell> {
        let theirs = |v: f64| shown(v, figures(v));
        vec![
            theirs(self.theirs),
            theirs(self.their_best),
            shown(self.ours, figures(self.ours)),
            shown(self.our_best, figures(self.our_best)),
            number(self.ours / self.theirs, 1),
            number(self.our_best / self.their_best, 1),
        ]
    }
}

/// The columns of [`Rates::cells`].
fn rate_columns() -> [common::report::Column; 6] {
    [
        numbers("crazyflow", "Crazyflow"),
        numbers("crazyflow_best", "best"),
        numbers("propwash", "Propwash"),
        numbers("propwash_best", "best"),
        numbers("ratio", "ratio of medians"),
        numbers("ratio_of_bests", "ratio of bests"),
    ]
}

fn main() -> ExitCode {
    let args = Args::parse();
    ended(match &args.hold {
        Some(words) => hold(&args, words),
        None => Bench::new(&args).and_then(|mut bench| bench.run()),
    })
}

/// A run.
struct Bench<'a> {
    args: &'a Args,
    report: Report,
    versions: String,
    /// How many cores there are before any row is pinned to one.
    cores: usize,
    /// All cores, as `taskset` writes them.
    all: String,
    /// The one of the rows that use one.
    one: String,
}

impl<'a> Bench<'a> {
    fn new(args: &'a Args) -> Fallible<Self> {
        if let Some(odd) = args.parts.iter().find(|p| !PARTS.contains(&p.as_str())) {
            return Err(format!("--parts: expected some of {}, got {odd}", PARTS.join(", ")).into());
        }
        let about = format!("lanes {}; {} steps a call, {} rounds", level_name(), args.steps, args.rounds);
        let report = Report::begin("steps", args.json.as_deref(), &about)?;
        let (all, one) = (machine::allowed()?, machine::last_core()?);
        Ok(Self { args, report, versions: String::new(), cores: machine::cores(), all, one })
    }

    fn run(&mut self) -> Fallible<()> {
        for part in &self.args.parts {
            match part.as_str() {
                "rates" => self.rates()?,
                "cores" => self.cores()?,
                "swarms" => self.swarms()?,
                _ => self.memory()?,
            }
        }
        if !self.versions.is_empty() {
            self.report.text(&format!("Peer: {}.", self.versions))?;
        }
        self.report.end()
    }

    /// One drone in every world, one core.
    fn rates(&mut self) -> Fallible<()> {
        let columns = [words("mode", "mode"), words("precision", "precision"), numbers("worlds", "worlds")];
        let caption = "Million steps per second on one core, one drone in every world.";
        self.report.table(
            "rates",
            caption,
            &columns.into_iter().chain(rate_columns()).collect::<Vec<_>>(),
        )?;
        for mode in &self.args.modes {
            let control = control(mode)?;
            for precision in &self.args.precisions {
                for &worlds in &self.args.worlds {
                    let case = Case { control, worlds, drones: 1, threads: 1, peer: !self.args.ours_alone };
                    let rates = self.measure(precision, case)?;
                    let mut row = vec![code(mode), word(precision), count(worlds)];
                    row.extend(rates.cells());
                    self.report.row(row)?;
                }
            }
        }
        Ok(())
    }

    /// Attitude commands in f32 on all cores.
    fn cores(&mut self) -> Fallible<()> {
        let threads = self.cores;
        let columns = [numbers("threads", "cores"), numbers("worlds", "worlds")];
        let caption =
            "Million steps per second in `attitude` and f32 on all cores, one drone in every world.";
        self.report.table(
            "cores",
            caption,
            &columns.into_iter().chain(rate_columns()).collect::<Vec<_>>(),
        )?;
        for &worlds in &self.args.worlds {
            let control = ControlMode::Attitude;
            let case = Case { control, worlds, drones: 1, threads, peer: !self.args.ours_alone };
            let rates = self.measure("f32", case)?;
            let mut row = vec![count(threads), count(worlds)];
            row.extend(rates.cells());
            self.report.row(row)?;
        }
        Ok(())
    }

    /// Many drones in a world.
    fn swarms(&mut self) -> Fallible<()> {
        let columns =
            [numbers("worlds", "worlds"), numbers("drones", "drones in each"), numbers("threads", "cores")];
        let caption = "Swarms: million steps of a drone per second in `attitude` and f32.";
        self.report.table(
            "swarms",
            caption,
            &columns.into_iter().chain(rate_columns()).collect::<Vec<_>>(),
        )?;
        let mut notes = Vec::new();
        let mut threads = vec![1, self.cores];
        threads.dedup();
        for threads in threads {
            for &(worlds, drones) in &self.args.swarms {
                let control = ControlMode::Attitude;
                let case = Case { control, worlds, drones, threads, peer: !self.args.ours_alone };
                let rates = self.measure("f32", case)?;
                let mut row = vec![count(worlds), count(drones), count(threads)];
                row.extend(rates.cells());
                self.report.row(row)?;
                if let Some(why) = rates.refused {
                    notes.push(format!(
                        "{worlds} × {drones} on {threads} cores: Crazyflow was left out: {why}."
                    ));
                }
            }
        }
        for note in notes {
            self.report.text(&note)?;
        }
        Ok(())
    }

    /// Most memory of a process that steps many worlds, and the speed of a million.
    fn memory(&mut self) -> Fallible<()> {
        machine::pin(&self.one)?;
        let columns = [
            numbers("worlds", "worlds"),
            numbers("crazyflow_mib", "Crazyflow, MiB"),
            numbers("propwash_mib", "Propwash, MiB"),
            numbers("crazyflow_bytes", "Crazyflow, bytes per world"),
            numbers("propwash_bytes", "Propwash, bytes per world"),
        ];
        let caption = "Most memory of the process in `attitude` and f32 on one core; per world: what it takes more than with one.";
        self.report.table("memory", caption, &columns)?;
        let mut first = [f64::NAN; 2];
        let mut per_world = f64::NAN;
        let mut notes = Vec::new();
        let mut peer_at_most = false;
        for worlds in MEMORY_WORLDS {
            let ours = self.ours_mib(worlds)?;
            let expected = per_world * worlds as f64;
            let room = machine::available_mib()? * MEMORY_SHARE;
            let theirs = if self.args.ours_alone {
                f64::NAN
            } else if expected > room {
                notes.push(format!(
                    "{worlds} worlds: Crazyflow was left out, since it would take about {:.0} GiB and there are {:.0} GiB.",
                    expected / 1024.0,
                    room / MEMORY_SHARE / 1024.0
                ));
                f64::NAN
            } else {
                peer_at_most |= worlds == MEMORY_WORLDS[2];
                self.peer(Case { worlds, ..ALONE }, "f32")?.peak_mib()?
            };
            if worlds == 1 {
                first = [theirs, ours];
            } else if theirs.is_finite() {
                per_world = (theirs - first[0]) / worlds as f64;
            }
            let bytes = |peak: f64, first: f64| {
                let each = (peak - first) * 1_048_576.0 / worlds as f64;
                if worlds == 1 { nothing() } else { number(each, 0) }
            };
            self.report.row(vec![
                count(worlds),
                number(theirs, 0),
                number(ours, 0),
                bytes(theirs, first[0]),
                bytes(ours, first[1]),
            ])?;
        }
        for note in notes {
            self.report.text(&note)?;
        }
        let columns = [numbers("threads", "cores"), numbers("worlds", "worlds")];
        let caption = "Million steps per second of a million worlds, in `attitude` and f32.";
        self.report.table(
            "million",
            caption,
            &columns.into_iter().chain(rate_columns()).collect::<Vec<_>>(),
        )?;
        let mut threads = vec![1, self.cores];
        threads.dedup();
        for threads in threads {
            let case = Case { worlds: MEMORY_WORLDS[2], threads, peer: peer_at_most, ..ALONE };
            let rates = self.measure("f32", case)?;
            let mut row = vec![count(threads), count(case.worlds)];
            row.extend(rates.cells());
            self.report.row(row)?;
        }
        Ok(())
    }

    /// A process of our own that holds many worlds.
    fn ours_mib(&self, worlds: usize) -> Fallible<f64> {
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["--steps", &self.args.steps.to_string(), "--hold", "attitude", "f32"]);
        command.arg(worlds.to_string());
        let mut child = Peer::run("this program", command, Duration::from_secs(self.args.patience))?;
        child.answer::<Value>()?;
        child.peak_mib()
    }

    fn peer(&mut self, case: Case, precision: &str) -> Fallible<Peer> {
        let double = if precision == "f64" { "1" } else { "0" };
        let call = [
            case.control.name().to_string(),
            case.worlds.to_string(),
            self.args.steps.to_string(),
            case.drones.to_string(),
        ];
        let cores = if case.threads == 1 { "one" } else { "all" };
        let environment = [("JAX_ENABLE_X64", double), ("PROPWASH_CORES", cores)];
        let peer = Peer::start_within(self.args.patience, "steps.py", &call, &environment)?;
        self.versions = peer.versions();
        Ok(peer)
    }

    fn measure(&mut self, precision: &str, case: Case) -> Fallible<Rates> {
        machine::pin(if case.threads == 1 { &self.one } else { &self.all })?;
        let pool = rayon::ThreadPoolBuilder::new().num_threads(case.threads).build()?;
        let mut peer = None;
        let mut refused = None;
        if case.peer {
            match self.peer(case, precision) {
                Ok(ready) => peer = Some(ready),
                Err(why) if case.drones > 1 => refused = Some(why.to_string()),
                Err(why) => return Err(why),
            }
        }
        let (rounds, steps) = (self.args.rounds, self.args.steps as usize);
        // Text, since errors must be able to leave the pool.
        let rates = pool.install(|| {
            let done = match precision {
                "f32" => alternate::<f32>(case, rounds, steps, peer.as_mut()),
                "f64" => alternate::<f64>(case, rounds, steps, peer.as_mut()),
                other => Err(format!("--precisions: expected f32 or f64, got {other}").into()),
            };
            done.map_err(|e| e.to_string())
        })?;
        Ok(Rates { refused, ..rates })
    }
}

/// The case of memory.
const ALONE: Case = Case { control: ControlMode::Attitude, worlds: 1, drones: 1, threads: 1, peer: true };

fn control(mode: &str) -> Fallible<ControlMode> {
    let known = [ControlMode::RotorVel, ControlMode::Attitude, ControlMode::State];
    let found = known.into_iter().find(|m| m.name() == mode);
    Ok(found.ok_or_else(|| format!("--modes: expected rotor_vel, attitude or state, got {mode}"))?)
}

/// A simulation and the commands of all its drones, the same as in the peer's script: another one for every drone.
fn build<N: Number>(case: Case) -> Fallible<(Sim<N>, Vec<f64>)> {
    let vehicle = Vehicle::builtin(VEHICLE)?;
    let drone = vehicle.drone("first_principles")?;
    let (thrust, speed) = (drone.hover_thrust(), drone.hover_rotor_vel()[0]);
    let command = |k: usize| {
        let wave = |f: f64| (k as f64 * f).sin();
        let [a, b, c, d] = [wave(12.9898), wave(78.233), wave(37.719), wave(4.581)];
        match case.control {
            ControlMode::State => [&[a, b, 1.0 + 0.5 * c][..], &[0.0; 9], &[1.0, 0.0, 0.0, 0.0]].concat(),
            ControlMode::Attitude => vec![0.1 * a, 0.1 * b, 0.1 * c, thrust * (1.0 + 0.05 * d)],
            _ => [a, b, c, d].map(|wave| speed * (1.0 + 2e-4 * wave)).to_vec(),
        }
    };
    let commands: Vec<f64> = (0..case.worlds * case.drones).flat_map(command).collect();
    let options = SimOptions {
        n_worlds: case.worlds,
        control: case.control,
        engine: Engine::Lanes,
        ..SimOptions::default()
    };
    let mut sim = Sim::<N>::storing(options, vec![(drone, vehicle.rates); case.drones])?;
    sim.set_command(&commands)?;
    Ok((sim, commands))
}

/// Ours and the peer's calls in turn.
fn alternate<N: Number>(
    case: Case,
    rounds: u32,
    steps: usize,
    mut peer: Option<&mut Peer>,
) -> Fallible<Rates> {
    let (mut sim, commands) = build::<N>(case)?;
    sim.step(steps)?;
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    let (mut our_best, mut their_best) = (f64::INFINITY, f64::NAN);
    for _ in 0..rounds {
        let mut calls = Vec::new();
        let begin = Instant::now();
        while begin.elapsed().as_secs_f64() < 0.3 || calls.len() < 3 {
            if calls.len().is_multiple_of(EPISODE_CALLS) {
                sim.reset(None)?;
                sim.set_command(&commands)?;
            }
            let start = Instant::now();
            sim.step(steps)?;
            calls.push(start.elapsed().as_secs_f64());
        }
        our_best = calls.iter().copied().fold(our_best, f64::min);
        ours.push(median(&mut calls));
        if let Some(peer) = &mut peer {
            let (middle, least) = peer.measure()?;
            theirs.push(middle);
            their_best = their_best.min(least);
        }
    }
    let stopped = sim.data.quarantine.iter().flatten().count();
    if stopped > 0 {
        return Err(
            format!("{stopped} of {} worlds were stopped: their steps cost nothing", case.worlds).into()
        );
    }
    let rate = |seconds: f64| (case.worlds * case.drones * steps) as f64 / seconds / 1e6;
    Ok(Rates {
        ours: rate(median(&mut ours)),
        our_best: rate(our_best),
        theirs: rate(median(&mut theirs)),
        their_best: rate(their_best),
        refused: None,
    })
}

/// Steps some worlds, says so, and waits to be ended.
fn hold(args: &Args, words: &[String]) -> Fallible<()> {
    let [mode, precision, worlds] = words else { return Err("--hold: expected three words".into()) };
    let case = Case { control: control(mode)?, worlds: worlds.parse()?, ..ALONE };
    let steps = args.steps as usize;
    match precision.as_str() {
        "f32" => build::<f32>(case)?.0.step(steps)?,
        _ => build::<f64>(case)?.0.step(steps)?,
    }
    println!("{}", json!({ "worlds": case.worlds }));
    std::io::stdin().read_line(&mut String::new())?;
    Ok(())
}
