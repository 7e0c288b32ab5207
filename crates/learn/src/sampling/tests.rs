use super::*;

const DYNAMICS: &str = "so_rpy_rotor_drag";

fn vehicle() -> Vehicle {
    Vehicle::builtin("cf21B_500").unwrap()
}

fn options() -> Options {
    Options { samples: 512, horizon: 12, ..Options::attitude(&vehicle().drone(DYNAMICS).unwrap()) }
}

fn cost(step: &str, given: &[&str]) -> Cost {
    let given: Vec<String> = given.iter().map(ToString::to_string).collect();
    Cost::new((&[], step), &given, (4, 4)).unwrap()
}

fn planner(step: &str, options: Options) -> Planner {
    Planner::new((&vehicle(), DYNAMICS), cost(step, &[]), options).unwrap()
}

fn state(planner: &Planner) -> State<f64> {
    State { pos: [0.2, -0.1, 1.0], vel: [0.3, 0.0, -0.1], ..planner.at_rest() }
}

/// Commands of some samples of the update to come, (sample, time, number), as they were drawn about the means.
fn commands(planner: &Planner, mode: usize, samples: &[u32]) -> Vec<Vec<Vec<f32>>> {
    let zero = F32x16::splat(0.0);
    let draws = Draws {
        options: &planner.options,
        means: &planner.means,
        drawn: &planner.drawn,
        update: planner.updates,
    };
    let one = |sample: &u32| {
        let (mut noise, mut command) = (vec![zero; planner.drawn.len()], vec![zero; 4]);
        let each = |t| {
            draws.command((mode, t), &[*sample; 16], &mut noise, &mut command);
            command.iter().map(|cell| cell.0[5]).collect()
        };
        (0..planner.options.horizon).map(each).collect()
    };
    samples.iter().map(one).collect()
}

#[test]
fn costs_are_those_of_the_flights_by_the_equations() {
    let step = "5 * x^2 + y^2 + (z - 1)^2 + t * vx^2 + command1^2 + 2 * (command2 - before2)^2 + qz^2 \
                + wx^2 * gain + last * 10 * (x - far)^2";
    let mut planner = Planner::new((&vehicle(), DYNAMICS), cost(step, &["gain", "far"]), options()).unwrap();
    let (start, samples) = (state(&planner), [0u32, 1, 17, 300, 511]);
    let drawn = commands(&planner, 0, &samples);
    let hover = planner.options.middle[3];
    planner.update(&start, 2.0, &[0.01, 0.5], None).unwrap();
    for (sample, sequence) in samples.iter().zip(&drawn) {
        let drone = vehicle().drone(DYNAMICS).unwrap();
        let at = SimOptions { sim_hz: 25, control: ControlMode::Attitude, ..SimOptions::default() };
        let hz = Rates { state_hz: 25, attitude_hz: 25, body_rate_hz: 25, force_torque_hz: 25 };
        let mut sim = Sim::<f64>::storing(at, vec![(drone, hz)]).unwrap();
        sim.set_initial(0, 0, start).unwrap();
        sim.reset(None).unwrap();
        sim.data.set_state(0, 0, &start);
        let (mut sum, mut before) = (0.0, vec![0.0, 0.0, 0.0, hover]);
        for (t, command) in sequence.iter().enumerate() {
            let command: Vec<f64> = command.iter().map(|v| f64::from(*v)).collect();
            sim.set_command(&command).unwrap();
            sim.step(1).unwrap();
            let s = sim.data.state(0, 0);
            sum += 5.0 * s.pos[0].powi(2) + s.pos[1].powi(2) + (s.pos[2] - 1.0).powi(2);
            sum += (2.0 + 0.04 * (t + 1) as f64) * s.vel[0].powi(2) + command[0].powi(2);
            sum += 2.0 * (command[1] - before[1]).powi(2) + s.quat[2].powi(2) + 0.01 * s.ang_vel[0].powi(2);
            before = command;
        }
        sum += 10.0 * (sim.data.state(0, 0).pos[0] - 0.5).powi(2);
        let got = f64::from(planner.costs()[*sample as usize]);
        assert!((got - sum).abs() < 1e-4 * sum, "sample {sample}: {got}, not {sum}");
    }
    assert!(planner.costs()[1] != planner.costs()[2]);
}

#[test]
fn the_plan_is_the_mean_of_the_best_samples_as_they_were_flown() {
    let mut planner = planner("x^2 + y^2 + (z - 1)^2 + 0.1 * vx^2", Options { update_s: 0.0, ..options() });
    let all: Vec<u32> = (0..512).collect();
    let drawn = commands(&planner, 0, &all);
    let start = state(&planner);
    let plan = planner.update(&start, 0.0, &[], None).unwrap();
    let mut order = all.clone();
    order.sort_by(|a, b| planner.costs()[*a as usize].total_cmp(&planner.costs()[*b as usize]));
    let best = &order[..5];
    let mean = |t: usize, k: usize| best.iter().map(|i| drawn[*i as usize][t][k]).sum::<f32>() / 5.0;
    for t in 0..12 {
        for k in 0..4 {
            assert!((planner.means()[t * 4 + k] - mean(t, k)).abs() < 1e-6, "{t} {k}");
        }
    }
    let cost = best.iter().map(|i| f64::from(planner.costs()[*i as usize])).sum::<f64>() / 5.0;
    assert!((plan.cost - cost).abs() < 1e-9 && plan.best == f64::from(planner.costs()[best[0] as usize]));
    assert_eq!(plan.command[2], 0.0, "yaw is not drawn");
    // The draws are as wide as they should be, and the first sample flies the mean.
    assert_eq!(drawn[0][3], planner.options.middle.iter().map(|v| *v as f32).collect::<Vec<_>>());
    let square = drawn[1..].iter().flatten().map(|c| f64::from(c[0]).powi(2)).sum::<f64>() / (511.0 * 12.0);
    assert!((square.sqrt() - 0.12).abs() < 0.01, "{square}");
}

#[test]
fn plans_are_the_same_bits_however_they_are_flown() {
    let flown = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let way = Options { samples: 4096, modes: 2, ..options() };
            let mut planner = planner("(x - 1)^2 + y^2 + (z - 1)^2", way);
            let start = state(&planner);
            let plans: Vec<Plan> = (0..3).map(|_| planner.update(&start, 0.0, &[], None).unwrap()).collect();
            (plans, planner.means().to_vec(), planner.costs().to_vec())
        })
    };
    assert_eq!(flown(1), flown(3));
}

/// Flies by plans on the model itself, past what is in the way; where it was, and how near it came.
fn flight(mut planner: Planner, distance: &Distance, updates: usize) -> (State<f64>, f32) {
    let drone = vehicle().drone(DYNAMICS).unwrap();
    let at = SimOptions { sim_hz: 500, control: ControlMode::Attitude, ..SimOptions::default() };
    let mut sim = Sim::<f64>::storing(at, vec![(drone, vehicle().rates)]).unwrap();
    let mut start = planner.at_rest();
    start.pos = [0.0, 0.0, 1.0];
    sim.set_initial(0, 0, start).unwrap();
    sim.reset(None).unwrap();
    let mut nearest = f32::INFINITY;
    for _ in 0..updates {
        let state = sim.data.state(0, 0);
        let plan = planner.update(&state, 0.0, &[], Some(distance)).unwrap();
        sim.set_command(&plan.command).unwrap();
        sim.step(10).unwrap();
        let at = sim.data.state(0, 0).pos.map(|v| F32x16::splat(v as f32));
        nearest = nearest.min(distance(&at).0[0]);
    }
    (sim.data.state(0, 0), nearest)
}

#[test]
fn it_flies_round_a_pole_by_elites_and_by_weights() {
    // A pole of 10 cm right in the way.
    let pole = |pos: &[F32x16; 3]| {
        F32x16(core::array::from_fn(|lane| (pos[0].0[lane] - 0.8).hypot(pos[1].0[lane] - 0.02) - 0.1))
    };
    for weigh in [Weigh::Elites(0.02), Weigh::Temperature(20.0)] {
        let way = Options { samples: 1024, horizon: 25, modes: 2, weigh, ..options() };
        let step = "4 * sqrt((x - 1.6)^2 + y^2 + (z - 1)^2 + 0.01) + 0.2 * (vx^2 + vy^2 + vz^2) \
                    + where(distance < 0.12, 100, 0)";
        let (end, nearest) = flight(planner(step, way), &pole, 250);
        assert!(nearest > 0.05, "{weigh:?}: {nearest} m from the pole");
        let off = (end.pos[0] - 1.6).hypot(end.pos[1]).hypot(end.pos[2] - 1.0);
        assert!(off < 0.15, "{weigh:?}: {off} m off at {:?}", end.pos);
    }
}

#[test]
fn plans_move_on_by_the_time_between_updates() {
    let mut planner = planner("command1", Options { update_s: 0.06, horizon: 4, ..options() });
    for (i, v) in planner.means.iter_mut().enumerate() {
        *v = (i / 4 * i / 4) as f32;
    }
    let before = planner.means.clone();
    planner.move_on();
    // One and a half commands of 40 ms.
    for (t, (a, b)) in [(1, 2), (2, 3), (3, 3), (3, 3)].into_iter().enumerate() {
        for k in 0..4 {
            let wanted = 0.5 * (before[a * 4 + k] + before[b * 4 + k]);
            assert!((planner.means[t * 4 + k] - wanted).abs() < 1e-6, "{t} {k}");
        }
    }
}

#[test]
fn weights_are_those_of_the_papers() {
    let costs = [3.0, f32::NAN, 1.0, f32::INFINITY, 2.0, 1.0];
    let elites = weigh(&costs, Weigh::Elites(0.34));
    assert_eq!(elites.list, [(2, 0.5), (5, 0.5)]);
    assert_eq!(elites.cost, Some((1.0, 1.0)));
    let all = weigh(&costs, Weigh::Temperature(0.5));
    let sum = 2.0 + (-2f64).exp() + (-4f64).exp();
    for (i, wanted) in [(0, (-4f64).exp()), (2, 1.0), (4, (-2f64).exp()), (5, 1.0)] {
        let got = all.list.iter().find(|(of, _)| *of == i).unwrap().1;
        assert!((f64::from(got) - wanted / sum).abs() < 1e-6, "{i}: {got}");
    }
    assert_eq!(all.list.len(), 4);
    assert_eq!(weigh(&[f32::NAN; 3], Weigh::Elites(0.5)).cost, None);
}

#[test]
fn samples_without_a_cost_do_not_count_and_none_at_all_is_said() {
    // Below 1 m the cost is no number.
    let mut some = planner("(x^2 + 0.01) * sqrt(z - 1)", options());
    let mut start = state(&some);
    (start.pos, start.vel) = ([0.0, 0.0, 1.001], [0.0; 3]);
    some.update(&start, 0.0, &[], None).unwrap();
    let lost = some.costs().iter().filter(|c| !c.is_finite()).count();
    assert!(lost > 50 && lost < 500, "{lost}");
    assert!(some.means().iter().all(|v| v.is_finite()));
    start.pos[2] = 0.2;
    let said = some.update(&start, 0.0, &[], None).unwrap_err().to_string();
    assert!(said.contains("no sample has a finite cost"), "{said}");
}

#[test]
fn what_makes_no_sense_is_refused() {
    let of = |change: &dyn Fn(&mut Options)| {
        let mut way = options();
        change(&mut way);
        Planner::new((&vehicle(), DYNAMICS), cost("x", &[]), way).err().unwrap().to_string()
    };
    for (said, words) in [
        (of(&|o| o.samples = 100), "a multiple of 16 for each mode"),
        (of(&|o| o.horizon = 0), "horizon: expected at least 1"),
        (of(&|o| o.lasting = 1.0), "lasting: expected a number from 0 to below 1"),
        (of(&|o| o.spread = vec![0.1]), "spread: expected 4 finite numbers"),
        (of(&|o| o.spread[0] = -1.0), "spread: expected numbers of 0 or more"),
        (of(&|o| o.low[3] = 9.0), "numbers in this order"),
        (of(&|o| o.step_s = 0.0007), "a whole number of steps a second"),
        (of(&|o| o.update_s = f64::NAN), "update_s: expected a finite number"),
        (of(&|o| o.weigh = Weigh::Elites(0.0)), "elites: expected a share"),
        (of(&|o| o.weigh = Weigh::Temperature(-1.0)), "temperature: expected a finite number"),
    ] {
        assert!(said.contains(words), "{said} lacks {words}");
    }
    let hexa = Cost::new((&[], "x"), &[], (6, 4)).unwrap();
    let said = Planner::new((&vehicle(), DYNAMICS), hexa, options()).err().unwrap().to_string();
    assert!(said.contains("cost: expected one of 4 rotors"), "{said}");
    let mut near = planner("distance", options());
    let start = state(&near);
    assert!(near.update(&start, 0.0, &[], None).unwrap_err().to_string().contains("a distance field"));
    let mut plain = planner("x", options());
    assert!(plain.update(&start, 0.0, &[1.0], None).unwrap_err().to_string().contains("given: expected 0"));
    let lost = State { pos: [f64::NAN, 0.0, 0.0], ..start };
    assert!(plain.update(&lost, 0.0, &[], None).unwrap_err().to_string().contains("finite numbers"));
}
