use super::*;
use crate::goals::{Cross, Swap};
use propwash_trace::math::vec3;

/// A ball at (1, 0.2, 1) of radius 0.3, another in every second world, seen as the inverse distances in a few directions.
struct Balls {
    begun: usize,
}

impl Balls {
    fn middle(world: usize) -> [f64; 3] {
        [1.0, if world.is_multiple_of(2) { 0.2 } else { -0.3 }, 1.0]
    }
}

impl Surroundings for Balls {
    fn sights(&self) -> usize {
        2
    }

    fn begin(&mut self, world: usize, _: u64, random: &mut Stream) -> Result<(State<f64>, [f64; 3]), String> {
        self.begun += 1;
        let state = State {
            pos: [random.uniform(-0.1, 0.3), random.uniform(-0.2, 0.2), random.uniform(0.9, 1.1)],
            vel: [1.0, 0.0, 0.0],
            ..State::rest()
        };
        Ok((state, [3.0, 0.1 * world as f64, 1.2]))
    }

    /// Changes in steps, so that it has no slope.
    fn see(&self, world: usize, pos: [f32; 3], _: [f32; 4], out: &mut [f32]) {
        let (d, _) = self.distance(world, pos);
        out.copy_from_slice(&[(0.5 + d).recip().mul_add(4.0, 0.0).floor() / 4.0, (world % 3) as f32]);
    }

    fn fault(&self) -> Option<String> {
        None
    }

    fn distance(&self, world: usize, pos: [f32; 3]) -> (f32, [f32; 3]) {
        let off = vec3::sub(pos.map(f64::from), Self::middle(world));
        let length = vec3::norm(off);
        ((length - 0.3) as f32, off.map(|v| (v / length) as f32))
    }
}

fn sim<N: propwash_trace::lanes::Number>(vehicle: &Vehicle, worlds: usize) -> Sim<N> {
    let options = SimOptions {
        n_worlds: worlds,
        control: propwash_physics::controllers::ControlMode::Attitude,
        engine: Engine::Lanes,
        ..SimOptions::default()
    };
    Sim::storing(options, vec![(vehicle.drone("first_principles").unwrap(), vehicle.rates)]).unwrap()
}

fn training<'a, G: SightedGoal, W: Surroundings>(
    goal: &'a G,
    around: &'a mut W,
    options: &'a Options,
    vehicle: &Vehicle,
    network: &Network,
) -> Training<'a, G, W> {
    let sim = sim::<f32>(vehicle, options.worlds);
    let width = state_width(sim.data.n_rotors);
    let traced = Traced::new(goal, width, 4);
    let seen = (around.sights(), goal.others());
    let block = || Mutex::new(Block::new(&traced, network, (options.horizon, width), seen));
    let blocks = (0..options.worlds.div_ceil(F32x16::LANES)).map(|_| block()).collect();
    let actions = Actions::attitude(&vehicle.drone("first_principles").unwrap());
    let (time_s, episodes) = (vec![0.0; options.worlds], vec![0; options.worlds]);
    Training { goal, around, options, sim, actions, traced, blocks, time_s, episodes, width, lost: 0 }
}

/// Mean cost of a flight under given actions, in f64: what is seen does not count, since the actions are given. Ways away from things are those of `away`, one for
/// each cost, which is filled where it is empty: no slope goes through them.
fn cost_of(
    goal: &Cross,
    start: &Sim<f32>,
    vehicle: &Vehicle,
    actions: &[Vec<f64>],
    horizon: usize,
    away: &mut Vec<[f64; 3]>,
) -> f64 {
    let (worlds, fill) = (actions.len() / horizon, away.is_empty());
    let mut sim = sim::<f64>(vehicle, worlds);
    for w in 0..worlds {
        sim.set_initial(w, 0, start.data.state(w, 0)).unwrap();
    }
    sim.reset(None).unwrap();
    let means = Actions::attitude(&vehicle.drone("first_principles").unwrap());
    let (mut sum, mut numbers) = (0.0, vec![0.0; state_width(sim.data.n_rotors)]);
    for t in 0..horizon {
        let command = |w: usize| -> Vec<f64> {
            let all = means.middle.iter().zip(&means.reach).zip(&actions[t * worlds + w]);
            all.map(|((m, r), a)| m + r * a).collect()
        };
        let commands: Vec<f64> = (0..worlds).flat_map(command).collect();
        sim.set_command(&commands).unwrap();
        sim.step(25).unwrap();
        for w in 0..worlds {
            sim.data.copy_state(w, &mut numbers);
            let seen = Seen::of(&numbers, 0.0, &[]);
            let (off, ball) = (vec3::sub(seen.pos_m, Balls::middle(w)), 0.3);
            let length = vec3::norm(off);
            if fill {
                away.push(off.map(|v| v / length));
            }
            let near = Near { distance_m: length - ball, away: away[t * worlds + w] };
            let before = if t == 0 { vec![0.0; 4] } else { actions[(t - 1) * worlds + w].clone() };
            let now = &actions[t * worlds + w];
            sum += goal.cost(
                &seen,
                &Around { near, detour: [0.0; 3], others: &[] },
                [3.0, 0.1 * w as f64, 1.2],
                [now, &before],
            );
        }
    }
    sum / (worlds * horizon) as f64
}

/// Biases of the last layer, whose every change moves all actions: with a network that looks at nothing else what is seen cannot hide a slope.
#[test]
fn the_gradient_goes_through_the_distance() {
    let vehicle = Vehicle::builtin("cf21B_500").unwrap();
    let goal = Cross::default();
    // 32 commands of 25 steps: several groups, of which the first is flown twice.
    for horizon in [6, 32] {
        let options = Options { worlds: 19, horizon, substeps: 25, ..Options::default() };
        let widths = [goal.observations() + 2, 5, 4];
        let mut network = Network::new(&widths, &mut stream(3, 0, 0, "learn.weights"));
        let n = network.weights().len();
        let biases = [0.05, -0.1, 0.2, 0.1];
        // The last layer gives its biases alone.
        network.weights_mut()[n - 24..n - 4].fill(0.0);
        network.weights_mut()[n - 4..].copy_from_slice(&biases);
        let mut around = Balls { begun: 0 };
        let mut training = training(&goal, &mut around, &options, &vehicle, &network);
        training.begin(&[true; 19]).unwrap();
        let start = sim_at(&training.sim, &vehicle);
        let (gradient, cost) = training.fly(&network).unwrap();
        let mut away = Vec::new();
        let mut at = |biases: [f64; 4]| {
            let action: Vec<f64> = biases.iter().map(|b| b.tanh()).collect();
            cost_of(&goal, &start, &vehicle, &vec![action; 19 * horizon], horizon, &mut away)
        };
        let wide = biases.map(f64::from);
        let wanted = at(wide);
        assert!((cost - wanted).abs() < 1e-3 * wanted, "{horizon}: {cost} {wanted}");
        for k in 0..4 {
            let mut moved = |by: f64| {
                let mut biases = wide;
                biases[k] += by;
                at(biases)
            };
            let slope = (moved(1e-4) - moved(-1e-4)) / 2e-4;
            let got = f64::from(gradient[n - 4 + k]);
            assert!((slope - got).abs() < 0.01 * slope.abs() + 0.003, "{horizon} {k}: {slope} {got}");
        }
        assert!(gradient[..n - 24].iter().all(|g| *g == 0.0), "nothing goes through zero weights");
        assert!(gradient[n - 24..n - 4].iter().any(|g| *g != 0.0));
    }
}

fn sim_at(of: &Sim<f32>, vehicle: &Vehicle) -> Sim<f32> {
    let mut same = sim::<f32>(vehicle, of.data.n_worlds);
    for w in 0..of.data.n_worlds {
        same.set_initial(w, 0, of.data.state(w, 0)).unwrap();
    }
    same.reset(None).unwrap();
    same
}

#[test]
fn a_training_lowers_the_cost_and_begins_episodes_anew() {
    let vehicle = Vehicle::builtin("cf21B_500").unwrap();
    let options = Options {
        worlds: 32,
        horizon: 20,
        substeps: 25,
        commands: 64_000,
        hidden: vec![16],
        rate: 0.005,
        longest: 1.0,
        ..Options::default()
    };
    let goal = Cross { episode_s: 3.0, ..Cross::default() };
    let actions = Actions::attitude(&vehicle.drone("first_principles").unwrap());
    let run = || {
        let mut around = Balls { begun: 0 };
        let of = (&vehicle, "first_principles");
        let trained = train_sighted(&goal, &mut around, of, &actions, &options).unwrap();
        (trained, around.begun)
    };
    let (trained, begun) = run();
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    let cost = &trained.curve.cost;
    assert!(mean(&cost[90..]) < 0.5 * mean(&cost[..10]), "{cost:?}");
    assert!(begun > 32 * 10, "{begun}");
    let (again, _) = run();
    assert_eq!(again.policy, trained.policy, "the same seed, the same policy");
}

/// Pairs of drones that change places, 1.4 m apart.
struct Pairs {
    drones: usize,
}

impl Pairs {
    fn place(drone: usize) -> [f64; 3] {
        let side = if drone.is_multiple_of(2) { 1.0 } else { -1.0 };
        [0.7 * side, 0.05 * side, 1.2]
    }
}

impl Surroundings for Pairs {
    fn sights(&self) -> usize {
        0
    }

    fn drones(&self) -> usize {
        self.drones
    }

    fn begin(&mut self, drone: usize, _: u64, random: &mut Stream) -> Result<(State<f64>, [f64; 3]), String> {
        let pos = vec3::add(Self::place(drone), [random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1), 0.0]);
        let vel = [if drone.is_multiple_of(2) { -0.5 } else { 0.5 }, 0.0, 0.0];
        Ok((State { pos, vel, ..State::rest() }, Self::place(drone + 1)))
    }

    fn see(&self, _: usize, _: [f32; 3], _: [f32; 4], _: &mut [f32]) {}

    fn fault(&self) -> Option<String> {
        None
    }

    fn distance(&self, _: usize, pos: [f32; 3]) -> (f32, [f32; 3]) {
        (pos[2], [0.0, 0.0, 1.0])
    }
}

/// Mean cost of flights of pairs under one action, in f64. Where others are is that of `others`, one for each cost, which is filled where it is empty: no slope goes through them.
fn pair_cost(
    goal: &Swap,
    start: &Sim<f32>,
    vehicle: &Vehicle,
    (action, horizon): (&[f64], usize),
    others: &mut Vec<Other<f64>>,
) -> f64 {
    let (worlds, fill) = (start.data.n_worlds, others.is_empty());
    let mut sim = sim::<f64>(vehicle, worlds);
    for w in 0..worlds {
        sim.set_initial(w, 0, start.data.state(w, 0)).unwrap();
    }
    sim.reset(None).unwrap();
    let means = Actions::attitude(&vehicle.drone("first_principles").unwrap());
    let command: Vec<f64> =
        means.middle.iter().zip(&means.reach).zip(action).map(|((m, r), a)| m + r * a).collect();
    sim.set_command(&command.repeat(worlds)).unwrap();
    let (mut sum, width) = (0.0, state_width(sim.data.n_rotors));
    for t in 0..horizon {
        sim.step(25).unwrap();
        let mut states = vec![vec![0.0; width]; worlds];
        states.iter_mut().enumerate().for_each(|(w, state)| sim.data.copy_state(w, state));
        for w in 0..worlds {
            let seen = Seen::of(&states[w], 0.0, &[]);
            if fill {
                let other = Seen::of(&states[w ^ 1], 0.0, &[]);
                others.push(Other { pos_m: other.pos_m, vel_m_s: other.vel_m_s });
            }
            let near = Near { distance_m: seen.pos_m[2], away: [0.0, 0.0, 1.0] };
            let others = &others[t * worlds + w..=t * worlds + w];
            let before = if t == 0 { &[0.0; 4] } else { action };
            let around = Around { near, detour: [0.0; 3], others };
            sum += goal.cost(&seen, &around, Pairs::place(w + 1), [action, before]);
        }
    }
    sum / (worlds * horizon) as f64
}

#[test]
fn the_gradient_goes_through_the_distance_to_others() {
    let vehicle = Vehicle::builtin("cf21B_500").unwrap();
    let goal = Swap { neighbours: 1, ..Swap::default() };
    let (lanes, horizon) = (18, 20);
    let options = Options { worlds: lanes, horizon, substeps: 25, ..Options::default() };
    let mut network = Network::new(&[goal.observations(), 5, 4], &mut stream(3, 0, 0, "learn.weights"));
    let n = network.weights().len();
    let biases = [0.05, -0.1, 0.2, 0.1];
    network.weights_mut()[n - 24..n - 4].fill(0.0);
    network.weights_mut()[n - 4..].copy_from_slice(&biases);
    let mut around = Pairs { drones: 2 };
    let mut training = training(&goal, &mut around, &options, &vehicle, &network);
    training.begin(&[true; 18]).unwrap();
    let start = sim_at(&training.sim, &vehicle);
    let (gradient, cost) = training.fly(&network).unwrap();
    let mut others = Vec::new();
    let mut at = |biases: [f64; 4]| {
        let action: Vec<f64> = biases.iter().map(|b| b.tanh()).collect();
        pair_cost(&goal, &start, &vehicle, (&action, horizon), &mut others)
    };
    let wide = biases.map(f64::from);
    let wanted = at(wide);
    assert!((cost - wanted).abs() < 1e-3 * wanted, "{cost} {wanted}");
    for k in 0..4 {
        let mut moved = |by: f64| {
            let mut biases = wide;
            biases[k] += by;
            at(biases)
        };
        let slope = (moved(1e-4) - moved(-1e-4)) / 2e-4;
        let got = f64::from(gradient[n - 4 + k]);
        assert!((slope - got).abs() < 0.01 * slope.abs() + 0.003, "{k}: {slope} {got}");
    }
}

#[test]
fn pairs_learn_to_change_places() {
    let vehicle = Vehicle::builtin("cf21B_500").unwrap();
    let actions = Actions::attitude(&vehicle.drone("first_principles").unwrap());
    let goal = Swap { neighbours: 1, speed_m_s: 1.0, episode_s: 4.0, ..Swap::default() };
    let options = Options {
        worlds: 32,
        horizon: 30,
        substeps: 25,
        commands: 100_000,
        hidden: vec![32],
        rate: 0.005,
        longest: 1.0,
        ..Options::default()
    };
    let of = (&vehicle, "first_principles");
    let trained = train_sighted(&goal, &mut Pairs { drones: 2 }, of, &actions, &options).unwrap();
    let cost = &trained.curve.cost;
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    assert!(mean(&cost[90..]) < 0.5 * mean(&cost[..10]), "{cost:?}");
    let told =
        train_sighted(&goal, &mut Pairs { drones: 1 }, of, &actions, &options).unwrap_err().to_string();
    assert!(told.contains("neighbours") && told.contains("fewer than the 1"), "{told}");
}
