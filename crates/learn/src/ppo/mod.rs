//! Proximal policy optimisation in lanes (Schulman et al., "Proximal policy optimization algorithms", 2017): many worlds fly under actions drawn around
//! those of the network, in the lanes in which the network is evaluated; what each action was better than expected is estimated by a value network (Schulman et
//! al., "High-dimensional continuous control using generalized advantage estimation", 2016); and better actions become likelier, no more than a little at a time.
//!
//! It sees what flights cost, not their slopes, so costs may jump: a gate that is touched, a landing that is too hard ([`Goal::judge`]).

mod flight;
mod update;

use crate::LearnError;
use crate::adam::Adam;
use crate::batch::{annealed, shorten, shuffle};
use crate::bptt::{Curve, Trained};
use crate::check::{above_zero, at_least_one, below_one, divides, up_to_one};
use crate::episodes::{Episodes, stream};
use crate::goal::{Actions, Goal};
use crate::network::Network;
use crate::policy::Policy;
use crate::value::{Sample, Value};
use flight::Flights;
use propwash_vehicle::Vehicle;
use update::{Judged, Samples, surrogate};

/// How a policy is trained.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Worlds that fly at once.
    pub worlds: usize,
    /// Commands of a flight, before the policy is changed.
    pub horizon: usize,
    /// Steps of the simulation under each command.
    pub substeps: usize,
    /// Steps per second.
    pub sim_hz: u32,
    /// Commands in all, over all worlds.
    pub commands: usize,
    /// Widths of the layers between observation and action, and of the value network's.
    pub hidden: Vec<usize>,
    /// Size of the first steps of Adam; it falls to nothing along half a cosine.
    pub rate: f32,
    /// Gradients that are longer are shortened to this.
    pub longest: f32,
    /// What a cost counts one command later.
    pub discount: f64,
    /// Share of longer returns in what an action is judged by (λ of generalised advantage estimation).
    pub lambda: f64,
    /// How far the likelihood of an action may move from what it was when it was flown, as a share, before it gains nothing more.
    pub clip: f32,
    /// How often the samples of a flight are gone through.
    pub epochs: usize,
    /// Parts of the samples, each a step of Adam.
    pub parts: usize,
    /// Standard deviation of the first actions around those of the network, in the numbers of an action, of which 1 is the limit.
    pub noise: f32,
    /// What the logarithms of the standard deviations gain the loss by themselves, so that noise does not die early.
    pub entropy: f32,
    /// Seed of weights, starts and actions.
    pub seed: u64,
}

impl Default for Options {
    /// 128 worlds, 32 commands of 20 ms at 500 steps per second, 2,000,000 commands, two layers of 64.
    fn default() -> Self {
        Self {
            worlds: 128,
            horizon: 32,
            substeps: 10,
            sim_hz: 500,
            commands: 2_000_000,
            hidden: vec![64, 64],
            rate: 0.005,
            longest: 0.5,
            discount: 0.95,
            lambda: 0.95,
            clip: 0.2,
            epochs: 4,
            parts: 4,
            noise: 0.3,
            entropy: 0.0,
            seed: 0,
        }
    }
}

fn check(options: &Options) -> Result<(), LearnError> {
    at_least_one(&[
        ("worlds", options.worlds),
        ("horizon", options.horizon),
        ("substeps", options.substeps),
        ("commands", options.commands),
        ("hidden", options.hidden.iter().copied().min().unwrap_or(1)),
        ("epochs", options.epochs),
        ("parts", options.parts),
    ])?;
    divides(options.substeps, options.sim_hz)?;
    above_zero(&[
        ("rate", options.rate),
        ("longest", options.longest),
        ("clip", options.clip),
        ("noise", options.noise),
    ])?;
    if !(options.entropy.is_finite() && options.entropy >= 0.0) {
        let (expected, got) = ("a finite number of at least 0".into(), options.entropy.to_string());
        return Err(LearnError::Option { name: "entropy", expected, got });
    }
    below_one("discount", options.discount)?;
    up_to_one(&[("lambda", options.lambda)])
}

/// What is learnt: the network of the actions, the logarithms of the standard deviations around them, and the value network.
struct Learner {
    network: Network,
    log_std: Vec<f32>,
    adam: Adam,
    adam_std: Adam,
    value: Value,
}

impl Learner {
    fn new(observations: usize, actions: usize, options: &Options) -> Self {
        let widths: Vec<usize> =
            [observations].into_iter().chain(options.hidden.iter().copied()).chain([actions]).collect();
        let network = Network::new(&widths, &mut stream(options.seed, 0, 0, "learn.weights"));
        Self {
            adam: Adam::new(network.weights().len()),
            adam_std: Adam::new(actions),
            log_std: vec![options.noise.ln(); actions],
            value: Value::new(observations, &options.hidden, options.seed),
            network,
        }
    }

    /// Makes what turned out better likelier, and the value network wiser.
    fn improve(&mut self, samples: &Samples, judged: &Judged, options: &Options, (flight, rate): (u64, f32)) {
        self.value.note(judged.target_mean, judged.target_variance);
        let mut order: Vec<usize> = (0..samples.len()).collect();
        for epoch in 0..options.epochs {
            let number = flight * options.epochs as u64 + epoch as u64;
            shuffle(&mut order, &mut stream(options.seed, 0, number, "learn.order"));
            for part in order.chunks(order.len().div_ceil(options.parts)) {
                let mut gradient = surrogate(part, samples, judged, (&self.network, &self.log_std), options);
                shorten(&mut gradient, options.longest);
                let (by_weights, by_std) = gradient.split_at(self.network.weights().len());
                self.adam.step(self.network.weights_mut(), by_weights, rate);
                self.adam_std.step(&mut self.log_std, by_std, rate);
                let sample = |i: usize| Sample {
                    observation: samples.observation(i),
                    target: judged.targets[i],
                    weight: samples.weight(i),
                };
                self.value.teach(part, sample, (rate, options.longest));
            }
        }
    }
}

/// Trains a policy that flies a vehicle towards a goal. The policy flies the middle of the actions that the training drew.
///
/// # Errors
/// [`LearnError::Option`] for options that make no sense, and what the vehicle and the simulation refuse.
pub fn train<G: Goal>(
    goal: &G,
    vehicle: (&Vehicle, &str),
    actions: &Actions,
    options: &Options,
) -> Result<Trained, LearnError> {
    check(options)?;
    let rates = (options.substeps, options.sim_hz);
    let mut episodes = Episodes::new(goal, vehicle, actions, (options.worlds, options.seed), rates)?;
    let mut learner = Learner::new(goal.observations(), actions.len(), options);
    let mut flights = Flights::new(&episodes, actions, options);
    let mut curve = Curve::default();
    let each = options.worlds * options.horizon;
    let updates = options.commands.div_ceil(each);
    for update in 0..updates {
        let cost =
            flights.fly(&mut episodes, actions, (&learner.network, &learner.log_std), update as u64)?;
        let samples = flights.samples();
        let judged = samples.judge(&learner.value, goal.lost_cost() as f32, options);
        let done = update as f32 / updates as f32;
        let rate = annealed(options.rate, done);
        learner.improve(&samples, &judged, options, (update as u64, rate));
        curve.commands.push((update + 1) * each);
        curve.cost.push(cost);
        flights.go_on(&mut episodes)?;
    }
    let (substeps, sim_hz) = rates;
    let policy = Policy { network: learner.network, actions: actions.clone(), substeps, sim_hz };
    Ok(Trained { policy, curve, lost: episodes.lost })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::goal::Outcome;
    use crate::goals::Track;
    use propwash_trace::lanes::F32x16;

    fn small() -> Options {
        // Long flights under wild actions, so that some are lost on the way; 19 worlds, so that lanes stay empty.
        Options { worlds: 19, horizon: 48, hidden: vec![9, 7], noise: 1.5, ..Options::default() }
    }

    /// Calls `look` with what flights of a network gave, which is not the one that is to be changed.
    fn flown(look: impl FnOnce(&Learner, &Samples, &Judged, &Options)) {
        let vehicle = Vehicle::builtin("cf21B_500").unwrap();
        let actions = Actions::attitude(&vehicle.drone("first_principles").unwrap());
        let (goal, options) = (Track::default(), small());
        let of = (&vehicle, "first_principles");
        let mut episodes = Episodes::new(&goal, of, &actions, (19, 0), (10, 500)).unwrap();
        let mut learner = Learner::new(goal.observations(), actions.len(), &options);
        let mut flights = Flights::new(&episodes, &actions, &options);
        let old = (&learner.network.clone(), &learner.log_std.clone()[..]);
        flights.fly(&mut episodes, &actions, old, 0).unwrap();
        let samples = flights.samples();
        learner.value.note(30.0, 100.0);
        let judged = samples.judge(&learner.value, 100.0, &options);
        for (k, w) in learner.network.weights_mut().iter_mut().enumerate() {
            *w += 0.02 * (k as f32).sin();
        }
        learner.log_std[1] += 0.1;
        look(&learner, &samples, &judged, &options);
    }

    #[test]
    fn advantages_are_what_a_sum_over_later_costs_says() {
        flown(|learner, samples, _, options| {
            let lost = |b: usize, l: usize| samples.blocks[b].lives.outcome(l) == Outcome::Lost;
            assert!((0..16).any(|l| lost(0, l)) && (0..16).any(|l| !lost(0, l)), "both are to be seen");
            let full = Options { lambda: 1.0, ..options.clone() };
            let judged = samples.judge(&learner.value, 100.0, &full);
            for (b, block) in samples.blocks.iter().enumerate() {
                for (lane, t) in (0..block.worlds).flat_map(|l| (0..options.horizon).map(move |t| (l, t))) {
                    let alive: Vec<usize> =
                        (t..options.horizon).filter(|t| block.lives.alive(*t, lane) > 0.0).collect();
                    if alive.first() != Some(&t) {
                        assert_eq!(samples.weight(b * options.horizon + t).0[lane], 0.0);
                        continue;
                    }
                    let share = |k: usize| options.discount.powi(k as i32);
                    let costs =
                        alive.iter().enumerate().map(|(k, t)| share(k) * f64::from(block.costs[*t].0[lane]));
                    let mut kept = vec![F32x16([0.0; 16]); learner.value.kept()];
                    let n = samples.observations;
                    kept[..n].copy_from_slice(&block.observations[options.horizon * n..]);
                    let end = match lost(b, lane) {
                        true => share(alive.len() - 1) * 100.0,
                        false => share(alive.len()) * f64::from(learner.value.estimate(&mut kept).0[lane]),
                    };
                    let wanted = costs.sum::<f64>() + end;
                    let got = f64::from(judged.targets[b * options.horizon + t].0[lane]);
                    assert!(
                        (got - wanted).abs() < 1e-3 * wanted.abs().max(1.0),
                        "{lane} {t}: {got} {wanted}"
                    );
                }
            }
        });
    }

    #[test]
    fn the_surrogate_s_gradient_is_that_of_differences() {
        flown(|learner, samples, judged, options| {
            let part: Vec<usize> = (0..samples.len()).step_by(3).collect();
            let gradient = surrogate(&part, samples, judged, (&learner.network, &learner.log_std), options);
            let loss = |network: &Network, log_std: &[f32]| {
                let (mut sum, mut count) = (0.0, 0.0);
                for i in &part {
                    let (block, t) = (samples.blocks[i / options.horizon], i % options.horizon);
                    for lane in (0..16).filter(|l| samples.weight(*i).0[*l] > 0.0) {
                        let seen: Vec<f32> =
                            samples.observation(*i).iter().map(|cell| cell.0[lane]).collect();
                        let mut now = 0.0;
                        for (k, m) in network.act(&seen).into_iter().enumerate() {
                            let z =
                                f64::from(block.actions[t * 4 + k].0[lane] - m) / f64::from(log_std[k]).exp();
                            now -= 0.5 * z * z + f64::from(log_std[k]);
                        }
                        let ratio = (now - f64::from(block.likelihoods[t].0[lane])).exp();
                        let advantage = f64::from(judged.advantages[*i].0[lane]);
                        let clip = f64::from(options.clip);
                        sum -= (ratio * advantage).min(ratio.clamp(1.0 - clip, 1.0 + clip) * advantage);
                        count += 1.0;
                    }
                }
                sum / count
            };
            let (n, step) = (learner.network.weights().len(), 1e-3);
            let size = gradient.iter().fold(0.0f32, |most, g| most.max(g.abs()));
            for k in (0..n).step_by(17).chain(n..n + 4) {
                let moved = |by: f32| {
                    let (mut network, mut log_std) = (learner.network.clone(), learner.log_std.clone());
                    if k < n {
                        network.weights_mut()[k] += by
                    } else {
                        log_std[k - n] += by
                    }
                    loss(&network, &log_std)
                };
                let slope = (moved(step) - moved(-step)) / f64::from(2.0 * step);
                let off = (slope - f64::from(gradient[k])).abs();
                assert!(off < 0.02 * f64::from(size), "{k}: {slope} {} of {size}", gradient[k]);
            }
        });
    }

    /// A tenth of a usual training learns to stay near the path, and is the same bit for bit on one thread and on three.
    #[test]
    fn it_learns_the_same_at_any_number_of_threads() {
        let vehicle = Vehicle::builtin("cf21B_500").unwrap();
        let of = (&vehicle, "first_principles");
        let actions = Actions::attitude(&vehicle.drone(of.1).unwrap());
        let options = Options { commands: 200_000, ..Options::default() };
        let at = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| train(&Track::default(), of, &actions, &options)).unwrap()
        };
        let (one, three) = (at(1), at(3));
        assert_eq!(one.policy, three.policy);
        assert_eq!(one.curve, three.curve);
        let flown = one.policy.fly(&Track::default(), of, (50, 2.0, 1_000_000)).unwrap();
        assert!(flown.lost == 0 && flown.off_rms_m < 0.1, "{} {}", flown.lost, flown.off_rms_m);
    }
}
