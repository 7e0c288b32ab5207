//! Gradients of flights, ours against Crazyflow's, alternately.
//!
//! `cargo xtask bench learn --help`. Prints Markdown tables. On Linux only: it reads `/proc` and pins with `taskset`.

mod common;

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::Parser;
use common::peer::Peer;
use common::report::{Report, count, figures, number, numbers, shown};
use common::{Fallible, ended, machine, median};
use propwash::physics::controllers::{ControlMode, Rates};
use propwash::rollout::pool::alone;
use propwash::rollout::{Sim, SimOptions};
use propwash::vehicle::Vehicle;

const VEHICLE: &str = "cf2x_L250";

/// Gradients of the height after some steps by the commands, by Propwash and by Crazyflow in turn.
#[derive(Parser)]
struct Args {
    /// How often each of the two runs, about 0.3 s each time.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,
    /// Steps of a flight.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
    /// Numbers of worlds.
    #[arg(long, value_delimiter = ',', default_values_t = [1usize, 64, 1024])]
    worlds: Vec<usize>,
    /// Longest time that Crazyflow may take to get ready, s; it compiles for every shape.
    #[arg(long, default_value_t = 300)]
    patience: u64,
    /// Leaves Crazyflow out.
    #[arg(long)]
    ours_alone: bool,
    /// Also writes the figures as lines of JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Ignored; `cargo bench` passes it.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> ExitCode {
    ended(run(&Args::parse()))
}

/// A simulation in f32 whose attitude controller ticks in every step, as in the peer's.
fn sim(worlds: usize) -> Fallible<(Sim<f32>, Vec<f32>)> {
    let vehicle = Vehicle::builtin(VEHICLE)?;
    let drone = vehicle.drone("first_principles")?;
    let rates = Rates { attitude_hz: 500, force_torque_hz: 500, ..vehicle.rates };
    let options = SimOptions { n_worlds: worlds, control: ControlMode::Attitude, ..SimOptions::default() };
    let hover = drone.hover_command() as f32;
    let sim = Sim::<f32>::storing(options, vec![(drone, rates)])?;
    // Another command for every world, the same as in benches/peers/learn.py.
    let wave = |w: usize, k: f32| (w as f32 * k).sin();
    let commands = (0..worlds).flat_map(|w| {
        let tilt = [12.9898, 78.233, 37.719].map(|k| 0.1 * wave(w, k));
        [tilt[0], tilt[1], tilt[2], hover * (1.0 + 0.05 * wave(w, 4.581))]
    });
    let commands = commands.collect();
    Ok((sim, commands))
}

/// The gradient of Σ (z − 1)² after the steps by the commands.
fn gradient(sim: &mut Sim<f32>, commands: &[f32], steps: usize) -> Fallible<Vec<f32>> {
    let mut tape = sim.record(commands, steps)?;
    let width = tape.state_width();
    let mut seeds = vec![0.0; tape.states().len()];
    for (seed, state) in seeds.chunks_exact_mut(width).zip(tape.states().chunks_exact(width)) {
        seed[2] = 2.0 * (state[2] - 1.0);
    }
    Ok(tape.pull_back(&seeds, &[])?.commands)
}

/// Median and least seconds of a gradient of all worlds, over at least 0.3 s.
fn measure(sim: &mut Sim<f32>, commands: &[f32], steps: usize) -> Fallible<(f64, f64)> {
    let start = sim.save();
    let (mut times, begin) = (Vec::new(), Instant::now());
    while begin.elapsed() < Duration::from_millis(300) || times.len() < 3 {
        sim.restore(&start)?;
        let began = Instant::now();
        gradient(sim, commands, steps)?;
        times.push(began.elapsed().as_secs_f64());
    }
    let least = times.iter().copied().fold(f64::INFINITY, f64::min);
    Ok((median(&mut times), least))
}

fn run(args: &Args) -> Fallible<()> {
    let cores = machine::cores();
    let about = format!(
        "{} rounds; {VEHICLE}, first_principles, attitude commands, {} steps of 2 ms, f32",
        args.rounds, args.steps
    );
    let mut report = Report::begin("learn", args.json.as_deref(), &about)?;
    first(&mut report, args)?;
    let columns = [
        numbers("worlds", "worlds"),
        numbers("cores", "cores"),
        numbers("crazyflow", "Crazyflow, thousand/s"),
        numbers("propwash", "Propwash, thousand/s"),
        numbers("propwash_best", "best"),
        numbers("ratio", "ratio of medians"),
    ];
    let caption = "Gradients of a flight by its command: forwards and backwards, one for each world.";
    report.table("gradients", caption, &columns)?;
    let all = machine::allowed()?;
    let mut versions = String::new();
    for threads in [1, cores] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        if threads == 1 {
            machine::pin(&machine::last_core()?)?;
        }
        for worlds in args.worlds.iter().copied().filter(|w| threads == 1 || *w > 64) {
            let (mut sim, commands) = sim(worlds)?;
            let mut peer = match args.ours_alone || threads > 1 {
                true => None,
                false => {
                    let words = [worlds.to_string(), args.steps.to_string()];
                    Some(Peer::start_within(args.patience, "learn.py", &words, &[])?)
                }
            };
            let (mut ours, mut best, mut theirs) = (Vec::new(), f64::INFINITY, Vec::new());
            for _ in 0..args.rounds {
                let mut run = || measure(&mut sim, &commands, args.steps as usize).map_err(|e| e.to_string());
                let (one, least) = if threads == 1 { alone(run) } else { pool.install(&mut run) }?;
                ours.push(one);
                best = best.min(least);
                if let Some(peer) = &mut peer {
                    theirs.push(peer.measure()?.0);
                }
            }
            if let Some(peer) = &peer {
                versions = peer.versions();
            }
            let rate = |seconds: f64| worlds as f64 / seconds / 1e3;
            let (ours, theirs) = (
                rate(median(&mut ours)),
                if theirs.is_empty() { f64::NAN } else { rate(median(&mut theirs)) },
            );
            report.row(vec![
                count(worlds),
                count(threads),
                shown(theirs, figures(theirs)),
                shown(ours, figures(ours)),
                shown(rate(best), figures(rate(best))),
                number(ours / theirs, 1),
            ])?;
        }
        machine::pin(&all)?;
    }
    if !versions.is_empty() {
        report.text(&format!("Peer: {versions}; one core."))?;
    }
    report.end()
}

/// Time from nothing to the first gradient: vehicle, simulation, programs.
fn first(report: &mut Report, args: &Args) -> Fallible<()> {
    let mut times = Vec::new();
    for _ in 0..args.rounds {
        let began = Instant::now();
        let (mut sim, commands) = sim(1024)?;
        gradient(&mut sim, &commands, args.steps as usize)?;
        times.push(1e3 * began.elapsed().as_secs_f64());
    }
    let ms = median(&mut times);
    report.table(
        "first",
        "Time from nothing to the first gradients of 1,024 worlds.",
        &[numbers("ms", "ms")],
    )?;
    report.row(vec![shown(ms, figures(ms))])
}
