//! Gradients of flights, ours against Crazyflow's, alternately; and policies trained by them, beside the figures of Crazyflow's paper.
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
use propwash::env::crossing::{NEARNESS, Sight};
use propwash::env::{Ending, Env, EnvConfig, train_crossing, train_swapping};
use propwash::geometry::DistanceField;
use propwash::learn::goals::{Cross, Gates, Land, Reach, Recover, Swap, Track, cross, swap};
use propwash::learn::sampling::{self, Cost, Planner};
use propwash::learn::{Actions, Critic, Flown, Goal, Options, Policy, ppo, train};
use propwash::physics::controllers::{ControlMode, Rates};
use propwash::rollout::pilot::{Commander, Pilot, Place};
use propwash::rollout::pool::alone;
use propwash::rollout::{Sim, SimOptions};
use propwash::scalar::lanes::{Cell, F32x16};
use propwash::scene::{FIELD_MOST_BYTES, Scene, SceneSource};
use propwash::vehicle::Vehicle;
use std::sync::{Mutex, PoisonError};

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
    /// What to measure: gradients, planning, policies, forests, rooms, swarm.
    #[arg(long, value_delimiter = ',', default_values_t = ["gradients".to_string(), "planning".into(), "policies".into(), "forests".into(), "rooms".into(), "swarm".into()])]
    parts: Vec<String>,
    /// First seed of the trained policies, and number of seeds.
    #[arg(long, default_value_t = 200)]
    first: u64,
    /// Number of seeds.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
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

/// The same in one pass, by a pilot that gives fixed commands: the states are seen in lanes, and nothing is flown twice.
struct Fixed<'a> {
    commands: &'a [f32],
    /// Heights, and gains by the command, of each block of worlds.
    blocks: Vec<Mutex<[F32x16; 5]>>,
}

impl Fixed<'_> {
    fn with(&self, at: Place, work: impl FnOnce(&mut [F32x16; 5])) {
        let block = &self.blocks[at.first_world / F32x16::LANES];
        work(&mut block.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

impl Commander<f32> for Fixed<'_> {
    fn command(&self, at: Place, _: &[F32x16], command: &mut [F32x16]) {
        for (k, cell) in command.iter_mut().enumerate() {
            cell.fill(at.first_world, |w| self.commands[4 * w.min(self.commands.len() / 4 - 1) + k]);
        }
    }

    fn look(&self, at: Place, state: &[F32x16]) {
        self.with(at, |block| block[4] = state[2]);
    }

    fn lost(&self, _: Place) {}
}

impl Pilot<f32> for Fixed<'_> {
    fn seed(&self, at: Place, by_state: &mut [F32x16]) {
        self.with(at, |block| {
            let (z, gain) = (block[4], &mut by_state[2]);
            (0..at.n_worlds).for_each(|lane| gain.set(lane, gain.get(lane) + 2.0 * (z.get(lane) - 1.0)));
        });
    }

    fn pull_back(&self, at: Place, by_command: &[F32x16], _: &mut [F32x16]) {
        self.with(at, |block| block[..4].copy_from_slice(by_command));
    }
}

/// Gains by the commands.
fn in_one_pass(sim: &mut Sim<f32>, commands: &[f32], steps: usize) -> Fallible<Vec<f32>> {
    let n = commands.len() / 4;
    let block = || Mutex::new([F32x16::splat(0.0); 5]);
    let blocks = (0..n.div_ceil(F32x16::LANES)).map(|_| block()).collect();
    let pilot = Fixed { commands, blocks };
    sim.fly_piloted(&pilot, 1, steps)?;
    let mut out = vec![0.0; commands.len()];
    for (k, block) in pilot.blocks.into_iter().enumerate() {
        let block = block.into_inner().unwrap_or_else(PoisonError::into_inner);
        for (lane, to) in out[4 * k * F32x16::LANES..].chunks_exact_mut(4).take(F32x16::LANES).enumerate() {
            to.iter_mut().zip(&block).for_each(|(to, cell)| *to = cell.get(lane));
        }
    }
    Ok(out)
}

type Gradients = fn(&mut Sim<f32>, &[f32], usize) -> Fallible<Vec<f32>>;

/// Median and least seconds of a gradient of all worlds, over at least 0.3 s.
fn measure(sim: &mut Sim<f32>, commands: &[f32], steps: usize, of: Gradients) -> Fallible<(f64, f64)> {
    let start = sim.save();
    let (mut times, begin) = (Vec::new(), Instant::now());
    while begin.elapsed() < Duration::from_millis(300) || times.len() < 3 {
        sim.restore(&start)?;
        let began = Instant::now();
        of(sim, commands, steps)?;
        times.push(began.elapsed().as_secs_f64());
    }
    let least = times.iter().copied().fold(f64::INFINITY, f64::min);
    Ok((median(&mut times), least))
}

fn run(args: &Args) -> Fallible<()> {
    let about = format!(
        "{} rounds; gradients: {VEHICLE}, first_principles, attitude commands, {} steps of 2 ms, f32; policies: seeds {} to {}",
        args.rounds,
        args.steps,
        args.first,
        args.first + args.seeds - 1
    );
    let mut report = Report::begin("learn", args.json.as_deref(), &about)?;
    if args.parts.iter().any(|part| part == "gradients") {
        first(&mut report, args)?;
        gradients(&mut report, args)?;
    }
    if args.parts.iter().any(|part| part == "planning") {
        planning(&mut report, args)?;
    }
    if args.parts.iter().any(|part| part == "policies") {
        policies(&mut report, args)?;
    }
    if args.parts.iter().any(|part| part == "forests") {
        forests(&mut report, args)?;
    }
    if args.parts.iter().any(|part| part == "rooms") {
        rooms(&mut report, args)?;
    }
    if args.parts.iter().any(|part| part == "swarm") {
        swarm(&mut report, args)?;
    }
    report.end()
}

/// Gradients per second, by the number of worlds.
fn gradients(report: &mut Report, args: &Args) -> Fallible<()> {
    let columns = [
        numbers("worlds", "worlds"),
        numbers("cores", "cores"),
        numbers("crazyflow", "Crazyflow, thousand/s"),
        numbers("tape", "Propwash by a tape"),
        numbers("propwash", "in one pass"),
        numbers("propwash_best", "best"),
        numbers("ratio", "ratio of medians"),
    ];
    let caption = "Gradients of a flight by its command: forwards and backwards, one for each world.";
    report.table("gradients", caption, &columns)?;
    let all = machine::allowed()?;
    let mut versions = String::new();
    for threads in [1, machine::cores()] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        if threads == 1 {
            machine::pin(&machine::last_core()?)?;
        }
        for worlds in args.worlds.iter().copied().filter(|w| threads == 1 || *w > 64) {
            let (mut sim, commands) = sim(worlds)?;
            let mut peer = match args.ours_alone || threads > 1 {
                true => None,
                false => {
                    let words = ["gradients".to_string(), worlds.to_string(), args.steps.to_string()];
                    Some(Peer::start_within(args.patience, "learn.py", &words, &[])?)
                }
            };
            let (mut tape, mut ours, mut best, mut theirs) =
                (Vec::new(), Vec::new(), f64::INFINITY, Vec::new());
            for _ in 0..args.rounds {
                let mut time = |of: Gradients| {
                    let mut run =
                        || measure(&mut sim, &commands, args.steps as usize, of).map_err(|e| e.to_string());
                    if threads == 1 { alone(run) } else { pool.install(&mut run) }
                };
                tape.push(time(gradient)?.0);
                let (one, least) = time(in_one_pass)?;
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
            let theirs = if theirs.is_empty() { f64::NAN } else { rate(median(&mut theirs)) };
            let (tape, ours) = (rate(median(&mut tape)), rate(median(&mut ours)));
            report.row(vec![
                count(worlds),
                count(threads),
                shown(theirs, figures(theirs)),
                shown(tape, figures(tape)),
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
    Ok(())
}

/// Poles along x and y through which sequences are planned, their distance, m, and how often a second plans are made anew.
const POLES: [usize; 2] = [6, 5];
const PITCH_M: f64 = 0.8;
const UPDATES_HZ: f64 = 50.0;

/// The field of poles of `examples/mppi.py`, but not moved off their grid.
fn poles() -> Fallible<DistanceField> {
    let [nx, ny] = POLES;
    let geoms: String = (0..nx * ny)
        .map(|i| {
            let (x, y) = (1.0 + (i % nx) as f64 * PITCH_M, ((i / nx) as f64 - 2.0) * PITCH_M);
            format!("<geom type=\"cylinder\" size=\".05 1\" pos=\"{x} {y} 1\"/>")
        })
        .collect();
    let text =
        format!("<mujoco><worldbody><geom type=\"plane\" size=\"0 0 .05\"/>{geoms}</worldbody></mujoco>");
    let scene = Scene::build(&SceneSource::text("poles", &text), &[])?;
    Ok(scene.distance_field(0.05, Some([[-2.0, -4.0, 0.0], [8.0, 4.0, 2.0]]), FIELD_MOST_BYTES)?)
}

/// Command sequences that are drawn, flown and judged in the time between two updates of a plan, on one core.
fn planning(report: &mut Report, args: &Args) -> Fallible<()> {
    let columns = [
        numbers("sequences", "sequences of an update"),
        numbers("crazyflow", "Crazyflow, between two updates"),
        numbers("propwash", "Propwash"),
        numbers("updates", "updates a second"),
        numbers("ratio", "ratio of medians"),
    ];
    let caption = "Planning by sampling: sequences of 25 commands of 40 ms by so_rpy_rotor_drag among 30 poles, drawn, flown and judged on one core: how many are done in 20 ms.";
    report.table("planning", caption, &columns)?;
    let all = machine::allowed()?;
    machine::pin(&machine::last_core()?)?;
    let vehicle = Vehicle::builtin(LEARNER)?;
    let field = poles()?;
    let near = |pos: &[F32x16; 3]| field.distance_lanes(pos);
    let drone = vehicle.drone("so_rpy_rotor_drag")?;
    let hover = drone.hover_command();
    // That of the example.
    let cost = "50 * ((x - min(1.2 * t, 6))^2 + y^2 + (z - 1)^2) + vx^2 + vy^2 + vz^2 + 5 * (command1^2 + command2^2) \
                + 5 * (command4 - hover)^2 + where(distance < 0.15, 1000, 0)";
    let mut versions = String::new();
    for samples in [4096usize, 65536] {
        let cost = Cost::new((&[], cost), &["hover".into()], (4, 4))?;
        let options = sampling::Options { samples, ..sampling::Options::attitude(&drone) };
        let mut planner = Planner::new((&vehicle, "so_rpy_rotor_drag"), cost, options)?;
        let mut state = planner.at_rest();
        state.pos = [0.0, 0.0, 1.0];
        let mut peer = match args.ours_alone {
            true => None,
            false => {
                let words = ["planning".to_string(), samples.to_string()];
                Some(Peer::start_within(args.patience, "learn.py", &words, &[])?)
            }
        };
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        for _ in 0..args.rounds {
            let (mut times, begin) = (Vec::new(), Instant::now());
            while begin.elapsed() < Duration::from_millis(300) {
                let began = Instant::now();
                alone(|| planner.update(&state, 0.0, &[hover], Some(&near)))?;
                times.push(began.elapsed().as_secs_f64());
            }
            ours.push(median(&mut times));
            if let Some(peer) = &mut peer {
                theirs.push(peer.measure()?.0);
            }
        }
        if let Some(peer) = &peer {
            versions = peer.versions();
        }
        let seconds = median(&mut ours);
        let rate = |seconds: f64| samples as f64 / seconds / UPDATES_HZ;
        let theirs = if theirs.is_empty() { f64::NAN } else { rate(median(&mut theirs)) };
        let own = rate(seconds);
        report.row(vec![
            count(samples),
            shown(theirs, figures(theirs)),
            shown(own, figures(own)),
            number(1.0 / seconds, 1),
            number(own / theirs, 1),
        ])?;
    }
    if !versions.is_empty() {
        report.text(&format!("Peer: {versions}; one core."))?;
    }
    machine::pin(&all)?;
    Ok(())
}

/// The vehicle of the paper's policies.
const LEARNER: &str = "cf21B_500";

/// How a policy is trained: on one core by gradients, on all by proximal policy optimisation.
enum How {
    Bptt(Options),
    Ppo(ppo::Options),
}

/// A training for each seed, from nothing: seconds, and what flights showed.
fn trained<G: Goal>(
    args: &Args,
    goal: &G,
    actions: fn(&propwash::physics::drone::Drone<f64>) -> Actions,
    how: &How,
    (flights, settle_s): (usize, f64),
) -> Fallible<Vec<(f64, Flown)>> {
    (args.first..args.first + args.seeds)
        .map(|seed| {
            let began = Instant::now();
            let vehicle = Vehicle::builtin(LEARNER)?;
            let of = (&vehicle, "first_principles");
            let actions = actions(&vehicle.drone(of.1)?);
            let trained = match how {
                How::Bptt(options) => {
                    alone(|| train(goal, of, &actions, &Options { seed, ..options.clone() }))?
                }
                How::Ppo(options) => {
                    ppo::train(goal, of, &actions, &ppo::Options { seed, ..options.clone() })?
                }
            };
            let seconds = began.elapsed().as_secs_f64();
            Ok((seconds, trained.policy.fly(goal, of, (flights, settle_s, 1_000_000))?))
        })
        .collect()
}

/// Policies beside the figures of Crazyflow's paper.
fn policies(report: &mut Report, args: &Args) -> Fallible<()> {
    let columns = [
        common::report::words("task", "task"),
        numbers("paper_s", "paper, s"),
        numbers("paper", "paper"),
        numbers("seconds", "Propwash, s"),
        numbers("seconds_most", "slowest"),
        numbers("result", "median"),
        numbers("worst", "worst"),
        common::report::words("what", "what"),
    ];
    let caption = "Policies trained from nothing, on one core but where all are named, over seeds that nothing was chosen by; flights from starts that no training has seen.";
    report.table("policies", caption, &columns)?;
    let all = machine::allowed()?;
    machine::pin(&machine::last_core()?)?;
    let gradients = |horizon, substeps, commands| {
        How::Bptt(Options { horizon, substeps, commands, ..Options::default() })
    };
    let eight = Track { period_s: 5.5, ..Track::default() };
    let error = |f: &Flown| if f.lost > 0 { f64::INFINITY } else { 1e3 * f.off_rms_m };
    let done = |f: &Flown| 0.1 * f.reached as f64;
    let (slow, fast) = (Track::default(), (100, 2.0));
    let flown = trained(args, &slow, Actions::attitude, &gradients(40, 10, 100_000), fast)?;
    row(report, "eight in 10 s, by attitudes", (1.56, 8.7), &flown, error, "error, mm, rms", false)?;
    let flown = trained(args, &eight, Actions::rotors, &gradients(40, 5, 600_000), fast)?;
    row(report, "eight in 5.5 s, by rotor speeds", (12.16, 166.0), &flown, error, "error, mm, rms", false)?;
    let none = (f64::NAN, f64::NAN);
    let goal = Recover::default();
    let flown = trained(args, &goal, Actions::attitude, &gradients(25, 5, 60_000), (1000, 0.0))?;
    row(report, "throws", (0.38, f64::NAN), &flown, done, "% of 1,000 caught", true)?;
    let goal = Reach::default();
    let flown = trained(args, &goal, Actions::attitude, &gradients(40, 10, 200_000), (1000, 3.0))?;
    row(report, "places", none, &flown, done, "% of 1,000 reached", true)?;
    row(report, "places, the last second", none, &flown, error, "error, mm, rms", false)?;
    let land = |critic| Options { horizon: 40, commands: 300_000, critic, ..Options::default() };
    for (task, critic) in [("landings", Some(Critic::default())), ("landings, without a critic", None)] {
        let how = How::Bptt(land(critic));
        let flown = trained(args, &Land::default(), Actions::attitude, &how, (1000, 0.0))?;
        row(report, task, none, &flown, done, "% of 1,000 soft", true)?;
    }
    let how = How::Bptt(Options { commands: 1_000_000, rate: 0.005, ..Options::default() });
    let flown = trained(args, &Gates::default(), Actions::attitude, &how, (1000, 0.0))?;
    row(report, "gate races", none, &flown, done, "% of 1,000 done", true)?;
    machine::pin(&all)?;
    let how = How::Ppo(ppo::Options::default());
    // The pool that everything else shares may have been made while one core was allowed, and has one thread then.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(machine::cores()).build()?;
    let flown =
        pool.install(|| trained(args, &slow, Actions::attitude, &how, fast).map_err(|e| e.to_string()))?;
    let task = "eight in 10 s, by PPO, all cores";
    row(report, task, (1.61, 15.9), &flown, error, "error, mm, rms", false)?;
    report.text("Paper: Crazyflow's, its own machine (PPO: on a GPU) and its own figure of eight (a Lissajous figure), after warming up.")
}

fn row(
    report: &mut Report,
    task: &str,
    (paper_s, paper): (f64, f64),
    flown: &[(f64, Flown)],
    of: impl Fn(&Flown) -> f64,
    what: &str,
    high_is_good: bool,
) -> Fallible<()> {
    let mut seconds: Vec<f64> = flown.iter().map(|(s, _)| *s).collect();
    let mut results: Vec<f64> = flown.iter().map(|(_, f)| of(f)).collect();
    let fold =
        |list: &[f64], best: fn(f64, f64) -> f64| list.iter().copied().reduce(best).unwrap_or(f64::NAN);
    let slowest = fold(&seconds, f64::max);
    let worst = fold(&results, if high_is_good { f64::min } else { f64::max });
    let (seconds, result) = (median(&mut seconds), median(&mut results));
    report.row(vec![
        common::report::word(task),
        shown(paper_s, figures(paper_s)),
        shown(paper, figures(paper)),
        shown(seconds, figures(seconds)),
        shown(slowest, figures(slowest)),
        shown(result, figures(result)),
        shown(worst, figures(worst)),
        common::report::word(what),
    ])
}

/// Time from nothing to the first gradient: vehicle, simulation, programs.
fn first(report: &mut Report, args: &Args) -> Fallible<()> {
    let mut times = Vec::new();
    for _ in 0..args.rounds {
        let began = Instant::now();
        let (mut sim, commands) = sim(1024)?;
        in_one_pass(&mut sim, &commands, args.steps as usize)?;
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

/// How far cameras see, m.
const FAR_M: f64 = 6.0;

/// An environment of forests, of seeds from `seed` on, in which a drone acts by attitudes and sees 12 × 16 pixels.
fn forest(worlds: usize, seed: u64, layouts: usize, first: u64) -> Fallible<EnvConfig> {
    let text = format!(
        "n_worlds = {worlds}\nseed = {seed}\nlayouts = {layouts}\nstep_hz = 20\nmax_episode_s = 16.0\n\
         [[drones]]\nvehicle = \"{LEARNER}\"\n[task]\nkind = \"forest_depth\"\n[action]\nkind = \"attitude\"\nnormalized = false\n\
         [camera]\nwidth = 16\nheight = 12\nfovy_deg = 70.0\nrange_m = [0.02, 6.0]\n\
         [scene.forest]\ntrees = 36\nrocks = 6\nlogs = 3\nmoving = 0\nsize_m = 12.0\nseed = {first}"
    );
    Ok(EnvConfig::from_text(&text)?)
}

/// What stands first in the input of policies that fly to a goal: the direction, which fades away within `least_m`, the distance, velocity, height and attitude. Behind
/// position, attitude, velocity and angular velocity of a row stand the goal and the velocity along the heading.
fn towards(row: &[f32], scales: [f64; 4], least_m: f64) -> Vec<f32> {
    let [distance, speed, height, zero] = scales.map(|v| v as f32);
    let (goal, along) = (&row[13..16], &row[16..19]);
    let length = long(goal);
    let mut input: Vec<f32> = goal.iter().map(|v| v / length.max(least_m as f32)).collect();
    input.push(distance * length);
    input.extend(along.iter().map(|v| speed * v));
    input.push(height * (row[2] - zero));
    input.extend(&row[3..7]);
    input
}

fn long(v: &[f32]) -> f32 {
    v.iter().map(|v| v * v).sum::<f32>().sqrt()
}

/// Nearness of a distance, from 0 at `far` to `factor` at `near` and nearer.
fn nearness(distance: f32, [near, far, factor]: [f64; 3]) -> f32 {
    let [near, low] = [near as f32, 1.0 / far as f32];
    factor as f32 * ((1.0 / distance.max(near) - low) / (1.0 / near - low)).clamp(0.0, 1.0)
}

/// Part of the worlds whose first episode is done. `input` says what the policy makes of a drone's row and image.
fn arrive(policy: &Policy, config: EnvConfig, input: impl Fn(&[f32], &[f32]) -> Vec<f32>) -> Fallible<f64> {
    let (worlds, drones) = (config.sim.options.n_worlds, config.sim.n_drones());
    let mut env = Env::new(config)?;
    env.reset(None, None)?;
    let width: usize = env.channels().iter().filter(|c| c.name != "depth").map(|c| c.width).sum();
    let mut endings = vec![Ending::None as u8; worlds];
    for _ in 0..321 {
        let (seen, depth) = (env.observation().to_vec(), env.depth().to_vec());
        let pixels = depth.len() / (worlds * drones);
        let act = |(i, row): (usize, &[f32])| -> Vec<f32> {
            let input = input(row, &depth[i * pixels..(i + 1) * pixels]);
            policy.actions.command(&policy.network.act(&input)).map(|v| v as f32).collect()
        };
        let actions: Vec<f32> = seen.chunks_exact(width).enumerate().flat_map(act).collect();
        env.step(&actions)?;
        let now = env.ending();
        (endings.iter_mut().zip(now))
            .filter(|(known, _)| **known == 0)
            .for_each(|(known, new)| *known = *new);
        if endings.iter().all(|e| *e != 0) {
            break;
        }
    }
    Ok(endings.iter().filter(|e| **e == Ending::Done as u8).count() as f64 / worlds as f64)
}

/// What a policy that sees makes of a row and an image.
fn sees(row: &[f32], image: &[f32]) -> Vec<f32> {
    let mut input = towards(row, cross::SCALES, cross::LEAST_M);
    input.extend(image.iter().map(|d| nearness(*d, [NEARNESS[0], FAR_M, NEARNESS[1]])));
    input
}

/// Policies that cross forests by depth, on all cores; the judge is the environment, with other forests.
fn forests(report: &mut Report, args: &Args) -> Fallible<()> {
    let columns = [
        numbers("seed", "seed"),
        numbers("cores", "cores"),
        numbers("prepared_s", "scenes and fields, s"),
        numbers("seconds", "in all, s"),
        numbers("arrive", "% of 500 unseen forests crossed"),
    ];
    let caption = "Forests by depth: 2,000,000 commands of 50 ms in 24 forests, from nothing; unseen forests are crossed in the environment, once each.";
    report.table("forests", caption, &columns)?;
    for seed in args.first..args.first + args.seeds {
        let options = Options {
            worlds: 128,
            horizon: 30,
            commands: 2_000_000,
            rate: 0.003,
            longest: 1.0,
            ..Options::default()
        };
        let config = forest(1, seed, 24, 100)?;
        let crossed = train_crossing(config, &Cross::default(), Sight { block: [1, 1] }, &options)?;
        let part = arrive(&crossed.trained.policy, forest(500, seed, 500, 2000)?, sees)?;
        let [prepared, seconds] = crossed.seconds;
        report.row(vec![
            count(seed as usize),
            count(machine::cores()),
            shown(prepared, figures(prepared)),
            shown(seconds, figures(seconds)),
            number(100.0 * part, 1),
        ])?;
    }
    Ok(())
}

/// A kind of rooms: name, what is generated, starts and goals, the camera, what is paid for, scenes and commands of a training.
type Kind = (&'static str, &'static str, &'static str, &'static str, Cross, (usize, usize));

fn kinds() -> [Kind; 2] {
    let hall = Cross { keep_m: 0.45, speed_m_s: 1.5, ..Cross::default() };
    let row = Cross { keep_m: 0.4, speed_m_s: 1.2, episode_s: 16.0, detour_m: 0.45, ..hall };
    [
        (
            "a hall of 8 m",
            "columns = 1\nrows = 1\nroom_m = 8.0\nthings = 12",
            "start_m = [[-3.3, -2.5, 0.9], [-2.7, 2.5, 1.5]]\ngoal_m = [[2.7, -2.5, 0.9], [3.3, 2.5, 1.5]]",
            "width = 16\nfovy_deg = 70.0",
            hall,
            (24, 2_000_000),
        ),
        (
            "three rooms, two doors",
            "columns = 3\nrows = 1\nroom_m = 4.0\nthings = 6",
            "start_m = [[-1.0, -1.0, 0.9], [1.0, 1.0, 1.5]]\ngoal_m = [[7.0, -1.2, 0.9], [9.2, 1.2, 1.5]]",
            "width = 20\nfovy_deg = 80.0",
            row,
            (48, 4_000_000),
        ),
    ]
}

/// Policies that cross rooms by depth, on all cores; the judge is the environment, with other rooms.
fn rooms(report: &mut Report, args: &Args) -> Fallible<()> {
    let columns = [
        common::report::words("rooms", "rooms"),
        numbers("seed", "seed"),
        numbers("cores", "cores"),
        numbers("prepared_s", "scenes and fields, s"),
        numbers("seconds", "in all, s"),
        numbers("arrive", "% of 500 unseen rooms crossed"),
    ];
    let caption = "Rooms by depth, from nothing; unseen rooms are crossed in the environment, once each.";
    report.table("rooms", caption, &columns)?;
    for (name, scene, ends, camera, goal, (scenes, commands)) in kinds() {
        let config = |worlds: usize, seed: u64, layouts: usize, first: u64| {
            EnvConfig::from_text(&format!(
                "n_worlds = {worlds}\nseed = {seed}\nlayouts = {layouts}\nstep_hz = 20\nmax_episode_s = 16.0\n\
                 [[drones]]\nvehicle = \"{LEARNER}\"\n[task]\nkind = \"forest_depth\"\nceiling_m = 2.3\n{ends}\n\
                 [action]\nkind = \"attitude\"\nnormalized = false\n\
                 [camera]\n{camera}\nheight = 12\nrange_m = [0.02, {FAR_M}]\n\
                 [scene.rooms]\n{scene}\nmoving = 0\nseed = {first}"
            ))
        };
        for seed in args.first..args.first + args.seeds {
            let options = Options {
                worlds: 128,
                horizon: 30,
                commands,
                rate: 0.003,
                longest: 1.0,
                ..Options::default()
            };
            let crossed =
                train_crossing(config(1, seed, scenes, 100)?, &goal, Sight { block: [1, 1] }, &options)?;
            let part = arrive(&crossed.trained.policy, config(500, seed, 500, 2000)?, sees)?;
            let [prepared, seconds] = crossed.seconds;
            report.row(vec![
                common::report::word(name),
                count(seed as usize),
                count(machine::cores()),
                shown(prepared, figures(prepared)),
                shown(seconds, figures(seconds)),
                number(100.0 * part, 1),
            ])?;
        }
    }
    Ok(())
}

/// What a policy of a swarm makes of a row, behind whose goal and velocity the others stand: way and motion of each.
fn knows(row: &[f32], _: &[f32]) -> Vec<f32> {
    let mut input = towards(row, swap::SCALES, swap::LEAST_M[0]);
    let [away, speed, ..] = swap::SCALES.map(|v| v as f32);
    for other in row[19..].chunks_exact(6) {
        let (off, distance) = (&other[..3], long(&other[..3]));
        input.extend(off.iter().map(|v| v / distance.max(swap::LEAST_M[1] as f32)));
        input.push(nearness(distance, swap::NEARNESS));
        input.push(away * distance);
        input.extend(other[3..].iter().map(|v| speed * v));
    }
    input
}

/// Policies by which 16 drones change places, on all cores; the judge is the environment.
fn swarm(report: &mut Report, args: &Args) -> Fallible<()> {
    let columns = [
        numbers("seed", "seed"),
        numbers("cores", "cores"),
        numbers("seconds", "in all, s"),
        numbers("done", "% of 500 unseen exchanges done"),
    ];
    let caption = "16 drones change places across a circle of 3 m radius, from nothing: done where all are at their places and none has touched another.";
    report.table("swarm", caption, &columns)?;
    let config = |worlds: usize, seed: u64| {
        EnvConfig::from_text(&format!(
            "n_worlds = {worlds}\nseed = {seed}\nlayouts = 1\nstep_hz = 20\nmax_episode_s = 15.0\nwith_camera = false\nn_drones = 16\n\
             [[drones]]\nvehicle = \"{LEARNER}\"\n[task]\nkind = \"swarm_cross\"\nradius_m = 3.0\nstart_off_m = 0.3\nheight_m = [1.0, 1.4]\n[action]\nkind = \"attitude\"\nnormalized = false\n\
             [scene.boxes]\ncount = 0\nmoving = 0"
        ))
    };
    for seed in args.first..args.first + args.seeds {
        let options = Options {
            worlds: 128,
            horizon: 30,
            commands: 2_000_000,
            rate: 0.003,
            longest: 1.0,
            ..Options::default()
        };
        let crossed = train_swapping(config(1, seed)?, &Swap::default(), &options)?;
        let part = arrive(&crossed.trained.policy, config(500, 1_000_000 + seed)?, knows)?;
        let seconds = crossed.seconds[1];
        report.row(vec![
            count(seed as usize),
            count(machine::cores()),
            shown(seconds, figures(seconds)),
            number(100.0 * part, 1),
        ])?;
    }
    Ok(())
}
