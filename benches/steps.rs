//! Steps per second of many worlds by Propwash and by Crazyflow, alternately, each on one core.
//!
//! `cargo xtask bench steps --help`. Prints a Markdown table.

#[path = "peers/process.rs"]
mod process;

use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;
use process::Peer;
use propwash::physics::controllers::ControlMode;
use propwash::rollout::{Engine, Sim, SimOptions};
use propwash::scalar::lanes::{Number, level_name};
use propwash::vehicle::Vehicle;

const VEHICLE: &str = "cf2x_L250";

type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

/// Steps a first-principles cf2x_L250 in many worlds, by Propwash and by Crazyflow in turn, one core each.
#[derive(Parser)]
struct Args {
    /// How often each of the two runs, about 0.3 s each time.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,
    /// Steps of one call.
    #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
    /// Numbers of worlds.
    #[arg(long, value_delimiter = ',', default_values_t = [1usize, 64, 1024, 65536])]
    worlds: Vec<usize>,
    /// Control modes.
    #[arg(long, value_delimiter = ',', default_values_t = ["rotor_vel".to_string(), "attitude".into(), "state".into()])]
    modes: Vec<String>,
    /// Precisions: f32 and f64, for both alike.
    #[arg(long, value_delimiter = ',', default_values_t = ["f32".to_string(), "f64".into()])]
    precisions: Vec<String>,
    /// Leaves Crazyflow out, for profiles.
    #[arg(long)]
    ours_alone: bool,
    /// Ignored; `cargo bench` passes it.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> ExitCode {
    let args = Args::parse();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().map_err(|e| e.to_string());
    match pool.and_then(|pool| pool.install(|| measure(&args).map_err(|e| e.to_string()))) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn measure(args: &Args) -> Fallible<()> {
    let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    println!(
        "{}; one thread, lanes {}; propwash {}; {} steps a call, {} rounds; load of the machine at the start {}\n",
        processor(),
        level_name(),
        env!("CARGO_PKG_VERSION"),
        args.steps,
        args.rounds,
        load.split_whitespace().take(3).collect::<Vec<_>>().join(" "),
    );
    println!("Million steps per second: median (best).\n");
    println!("| mode | precision | worlds | Crazyflow | Propwash | ratio of medians | ratio of bests |");
    println!("| --- | --- | ---: | ---: | ---: | ---: | ---: |");
    let mut versions = String::new();
    for mode in &args.modes {
        let control = *ControlMode::ALL
            .iter()
            .find(|m| {
                m.name() == mode
                    && matches!(m, ControlMode::State | ControlMode::Attitude | ControlMode::RotorVel)
            })
            .ok_or_else(|| format!("--modes: expected rotor_vel, attitude or state, got {mode}"))?;
        for precision in &args.precisions {
            for worlds in &args.worlds {
                match precision.as_str() {
                    "f32" => row::<f32>(args, control, *worlds, &mut versions)?,
                    "f64" => row::<f64>(args, control, *worlds, &mut versions)?,
                    other => return Err(format!("--precisions: expected f32 or f64, got {other}").into()),
                }
            }
        }
    }
    println!("\nPeer: {versions}");
    Ok(())
}

fn row<N: Number>(args: &Args, control: ControlMode, worlds: usize, versions: &mut String) -> Fallible<()> {
    let vehicle = Vehicle::builtin(VEHICLE)?;
    let drone = vehicle.drone("first_principles")?;
    // Another command in every world, the same as in the peer's script.
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
    let commands: Vec<f64> = (0..worlds).flat_map(command).collect();
    let options = SimOptions { n_worlds: worlds, control, engine: Engine::Lanes, ..SimOptions::default() };
    let mut sim = Sim::<N>::storing(options, vec![(drone, vehicle.rates)])?;
    sim.set_command(&commands)?;
    let steps = args.steps as usize;
    sim.step(steps)?;
    let mut peer = None;
    if !args.ours_alone {
        let double = if N::NAME == "f64" { "1" } else { "0" };
        let call = [control.name().to_string(), worlds.to_string(), steps.to_string()];
        peer = Some(Peer::start("steps.py", &call, &[("JAX_ENABLE_X64", double)])?);
    }
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    let (mut our_best, mut their_best) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..args.rounds {
        let mut calls = Vec::new();
        let begin = Instant::now();
        while begin.elapsed().as_secs_f64() < 0.3 || calls.len() < 3 {
            // As a user does: episodes of at most 40 calls. What rests for minutes decays to denormal numbers.
            if calls.len().is_multiple_of(40) {
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
    let rate = |seconds: f64| (worlds * steps) as f64 / seconds / 1e6;
    let (our, their) = (rate(median(&mut ours)), rate(median(&mut theirs)));
    let (our_best, their_best) = (rate(our_best), rate(their_best));
    println!(
        "| `{}` | {} | {worlds} | {their:.3} ({their_best:.3}) | {our:.1} ({our_best:.1}) | {:.1} | {:.1} |",
        control.name(),
        N::NAME,
        our / their,
        our_best / their_best
    );
    if let Some(peer) = &peer {
        *versions = peer.versions();
    }
    Ok(())
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    if values.is_empty() { f64::NAN } else { values[values.len() / 2] }
}

fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = text.lines().find_map(|l| l.strip_prefix("model name")?.split_once(": "));
    model.map_or_else(|| std::env::consts::ARCH.into(), |(_, name)| name.trim().to_string())
}
