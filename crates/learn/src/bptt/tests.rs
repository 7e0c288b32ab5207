//! The gradient by weights against differences of what flights cost.

use super::*;
use crate::goal::Seen;
use crate::goals::{Land, Reach, Track};
use propwash_rollout::tape::state_width;
use propwash_rollout::{Engine, Sim, SimOptions};

/// Mean cost of a flight, in f64 by the simulation itself, and by formulas over f64; nothing counts once an episode is over. With a value network what a
/// cost counts falls, and what it says of the end is added. Also says how many episodes ended.
fn cost_of<G: Goal>(
    goal: &G,
    sim: &mut Sim<f64>,
    policy: &Policy,
    (options, critic): (&Options, Option<(&Value, f64)>),
    (time_s, memory): (&[f64], &[f64]),
) -> (f64, usize) {
    let (worlds, n) = (options.worlds, policy.actions.len());
    let step_s = options.substeps as f64 / f64::from(options.sim_hz);
    let mut numbers = vec![0.0; state_width(sim.data.n_rotors)];
    let mut before = vec![0.0; worlds * n];
    let (mut sum, mut share, m) = (0.0, 1.0, goal.memory());
    let mut memory: Vec<Vec<f64>> = (0..worlds).map(|w| memory[w * m..(w + 1) * m].to_vec()).collect();
    let (mut alive, mut states) = (vec![true; worlds], vec![numbers.clone(); worlds]);
    let observed = |seen: &Seen<f64>| -> Vec<f32> {
        let mut observation = Vec::new();
        goal.observe(seen, &mut observation);
        observation.into_iter().map(|v| v as f32).collect()
    };
    for t in 0..options.horizon {
        let mut commands = Vec::new();
        let mut actions = Vec::new();
        for (w, begun) in time_s.iter().enumerate() {
            sim.data.copy_state(w, &mut numbers);
            states[w].copy_from_slice(&numbers);
            let seen = Seen::of(&numbers, begun + t as f64 * step_s, &memory[w]);
            let action = policy.network.act(&observed(&seen));
            commands.extend(policy.actions.command(&action));
            actions.extend(action.into_iter().map(f64::from));
        }
        sim.set_command(&commands).unwrap();
        sim.step(options.substeps).unwrap();
        for (w, begun) in time_s.iter().enumerate().filter(|(w, _)| alive[*w]).collect::<Vec<_>>() {
            sim.data.copy_state(w, &mut numbers);
            let time_s = begun + t as f64 * step_s;
            let mut changed = memory[w].clone();
            if m > 0 {
                let start = Seen::of(&states[w], time_s, &memory[w]);
                let end = Seen::of(&numbers, time_s + step_s, &memory[w]);
                alive[w] = goal.judge(&start, &end, &mut changed) == Outcome::On;
            }
            memory[w] = changed;
            let seen = Seen::of(&numbers, time_s + step_s, &memory[w]);
            let own = w * n..(w + 1) * n;
            sum += share * goal.cost(&seen, &actions[own.clone()], &before[own]);
        }
        before = actions;
        share *= critic.map_or(1.0, |(_, discount)| discount);
    }
    if let Some((value, _)) = critic {
        for (w, begun) in time_s.iter().enumerate().filter(|(w, _)| alive[*w]) {
            sim.data.copy_state(w, &mut numbers);
            let end_s = begun + options.horizon as f64 * step_s;
            let observation = observed(&Seen::of(&numbers, end_s, &memory[w]));
            let mut kept = vec![F32x16::splat(0.0); value.kept()];
            kept.iter_mut().zip(observation).for_each(|(cell, v)| *cell = F32x16::splat(v));
            sum += share * f64::from(value.estimate(&mut kept).get(0));
        }
    }
    (sum / (worlds * options.horizon) as f64, alive.iter().filter(|alive| !**alive).count())
}

/// 19 worlds, so that lanes stay empty; by attitudes and by rotor speeds; in one group of steps and in several; with what an episode remembers; with a
/// value network at the end; and where some episodes end on the way.
#[test]
fn the_gradient_by_weights_is_that_of_differences() {
    let vehicle = Vehicle::builtin("cf21B_500").unwrap();
    let drone = vehicle.drone("first_principles").unwrap();
    let (attitude, rotors) = (Actions::attitude(&drone), Actions::rotors(&drone));
    let critic = Some(Critic { discount: 0.9, ..Critic::default() });
    assert_eq!(compare(&Track::default(), &attitude, 8, None), 0);
    assert_eq!(compare(&Track::default(), &rotors, 5, None), 0);
    assert_eq!(compare(&Track::default(), &attitude, 60, None), 0);
    assert_eq!(compare(&Reach::default(), &attitude, 12, None), 0);
    assert_eq!(compare(&Reach::default(), &attitude, 12, critic), 0);
    let low = Land { above_m: 0.05, ..Land::default() };
    for critic in [None, critic] {
        let ended = compare(&low, &attitude, 8, critic);
        assert!((3..17).contains(&ended), "{ended} of 19");
    }
}

/// Compares the gradient of a flight; says how many episodes ended in it.
fn compare<G: Goal>(goal: &G, actions: &Actions, horizon: usize, critic: Option<Critic>) -> usize {
    let vehicle = Vehicle::builtin("cf21B_500").unwrap();
    let drone = vehicle.drone("first_principles").unwrap();
    let options = Options { worlds: 19, horizon, hidden: vec![9, 7], critic, ..Options::default() };
    let sim_options =
        SimOptions { n_worlds: 19, control: actions.mode, engine: Engine::Lanes, ..SimOptions::default() };
    let drones = vec![(drone.clone(), vehicle.rates)];
    let of = (&vehicle, "first_principles");
    let episodes = Episodes::new(goal, of, actions, (19, 0), (10, 500)).unwrap();
    let widths = [goal.observations(), 9, 7, actions.len()];
    let network = Network::new(&widths, &mut stream(3, 0, 0, "learn.weights"));
    let mut training = Training::new(episodes, &options, actions, &network);
    if let Some(taught) = &mut training.critic {
        taught.used.note(3.0, 4.0);
    }
    let value = training.critic.as_ref().map(|taught| taught.used.clone());
    let memory = training.episodes.memory.clone();
    let (time_s, start) = (training.episodes.time_s.clone(), training.episodes.sim.save());
    let (gradient, cost) = training.fly(&network).unwrap();
    let mut same = Sim::<f64>::storing(sim_options, drones).unwrap();
    let mut at = |weights: &[f32]| {
        for w in 0..19 {
            same.set_initial(w, 0, start.data().state(w, 0)).unwrap();
        }
        same.reset(None).unwrap();
        let mut network = network.clone();
        network.weights_mut().copy_from_slice(weights);
        let (substeps, sim_hz) = (options.substeps, options.sim_hz);
        let policy = Policy { network, actions: actions.clone(), substeps, sim_hz };
        let critic = value.as_ref().zip(critic.map(|critic| critic.discount));
        cost_of(goal, &mut same, &policy, (&options, critic), (&time_s, &memory))
    };
    let (wanted, ended) = at(network.weights());
    assert!(critic.is_some() || (cost - wanted).abs() < 1e-4 * wanted, "{horizon}: {cost} {wanted}");
    let size = gradient.iter().fold(0.0f32, |most, g| most.max(g.abs()));
    for k in (0..gradient.len()).step_by(23) {
        let step = 2e-3;
        let moved = |by: f32| {
            let mut weights = network.weights().to_vec();
            weights[k] += by;
            weights
        };
        let slope = (at(&moved(step)).0 - at(&moved(-step)).0) / f64::from(2.0 * step);
        let off = (slope - f64::from(gradient[k])).abs();
        assert!(off < 0.01 * f64::from(size), "{horizon} {k}: {slope} {} of {size}", gradient[k]);
    }
    ended
}
