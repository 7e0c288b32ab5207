//! A step of flight traced once gives the bits of the code that it was traced from, for every vehicle, control mode, model and
//! integrator, and for the force of every built-in effect.

use propwash::physics::controllers::{COMMAND_WIDTH, ControlMode, Due, Memory, mellinger};
use propwash::physics::drone::{Drone, Dynamics};
use propwash::physics::effects::{AnyEffect, Command, KINDS};
use propwash::physics::integrate::Integrator;
use propwash::physics::params::Parameters;
use propwash::physics::rigid_body::{MAX_ROTORS, State};
use propwash::physics::surroundings::Surroundings;
use propwash::random::{Key, Stream, purpose};
use propwash::scalar::Real;
use propwash::scalar::adjoint::adjoint;
use propwash::scalar::dual::Dual;
use propwash::scalar::trace::{Graph, Sym, trace};
use propwash::vehicle::Vehicle;

const DT_S: f64 = 0.002;
const STATE: usize = 22;
const INPUTS: usize = STATE + COMMAND_WIDTH + Memory::<f64>::LEN + 9;

/// What is stepped.
#[derive(Clone, Copy, Debug)]
struct Plan {
    mode: ControlMode,
    due: Due,
    integrator: Integrator,
}

fn state<S: Real>(x: &[S]) -> State<S> {
    State {
        pos: core::array::from_fn(|i| x[i]),
        quat: core::array::from_fn(|i| x[3 + i]),
        vel: core::array::from_fn(|i| x[7 + i]),
        ang_vel: core::array::from_fn(|i| x[10 + i]),
        rotor_vel: core::array::from_fn(|i| x[13 + i]),
        thrust: x[21],
    }
}

/// Controllers and one step of motion of a drone: numbers in, numbers out.
fn step<S: Real>(drone: &Drone<S>, plan: Plan, x: &[S]) -> Vec<S> {
    let before = state(x);
    let command: [S; COMMAND_WIDTH] = core::array::from_fn(|i| x[STATE + i]);
    let mut memory = Memory::load(|i| x[STATE + COMMAND_WIDTH + i]);
    let rest = &x[STATE + COMMAND_WIDTH + Memory::<S>::LEN..];
    let surroundings = Surroundings {
        disturbance_force_n: core::array::from_fn(|i| rest[i]),
        disturbance_torque_n_m: core::array::from_fn(|i| rest[3 + i]),
        wind_m_s: core::array::from_fn(|i| rest[6 + i]),
        ..Surroundings::calm()
    };
    let period = S::lit(DT_S);
    let periods = mellinger::Periods { state: period, attitude: period, body_rate: period };
    let gravity = drone.body.gravity_m_s2;
    let c = &drone.controller;
    mellinger::run(c, gravity, plan.mode, plan.due, &periods, &before, &command, &mut memory);
    let in_force = match drone.dynamics {
        Dynamics::Rotors => {
            let mut speeds = memory.rotor_cmd;
            mellinger::limit_rotor_vel(c, &mut speeds);
            Command::Rotors(speeds)
        }
        Dynamics::AttitudeResponse(_) => {
            let mut attitude = memory.attitude_cmd;
            attitude[3] = mellinger::limit_thrust(c, attitude[3]);
            Command::Attitude(attitude)
        }
    };
    let after = plan.integrator.step(&before, S::lit(DT_S), |s| drone.rate(s, &in_force, &surroundings));
    let mut out = Vec::new();
    out.extend(after.pos);
    out.extend(after.quat);
    out.extend(after.vel);
    out.extend(after.ang_vel);
    out.extend(after.rotor_vel);
    out.push(after.thrust);
    memory.store(|_, v| out.push(v));
    out
}

/// The step with the vehicle's parameters as further inputs, so that one graph serves all vehicles of a kind.
fn traced(drone: &Drone<f64>, plan: Plan) -> (Graph, Vec<f64>) {
    let mut parameters = Vec::new();
    drone.map(&mut |v| {
        parameters.push(v);
        v
    });
    let graph = trace(INPUTS + parameters.len(), |x| {
        let mut k = INPUTS;
        let drone = drone.map(&mut |_| {
            k += 1;
            x[k - 1]
        });
        step::<Sym>(&drone, plan, &x[..INPUTS])
    });
    (graph, parameters)
}

/// A vehicle in some state, under some command.
fn drawn(drone: &Drone<f64>, mode: ControlMode, random: &mut Stream) -> Vec<f64> {
    let mut x = vec![0.0; INPUTS];
    for v in &mut x[..STATE] {
        *v = random.normal();
    }
    let length = x[3..7].iter().map(|v| v * v).sum::<f64>().sqrt();
    x[3..7].iter_mut().for_each(|v| *v /= length);
    let hover = drone.hover_rotor_vel();
    for i in 0..MAX_ROTORS {
        x[13 + i] = hover[i] * (1.0 + 0.2 * random.normal());
    }
    x[21] = drone.hover_thrust() * (1.0 + 0.2 * random.normal());
    for (i, v) in x[STATE..STATE + COMMAND_WIDTH].iter_mut().enumerate() {
        *v = match mode {
            ControlMode::RotorVel => hover[i % MAX_ROTORS] * (1.0 + 0.2 * random.normal()),
            ControlMode::State => random.normal(),
            _ if i == 3 => drone.hover_thrust() * (1.0 + 0.2 * random.normal()),
            _ => 0.3 * random.normal(),
        };
    }
    for v in &mut x[STATE + COMMAND_WIDTH..] {
        *v = 0.1 * random.normal();
    }
    x
}

fn compare(name: &str, drone: &Drone<f64>, modes: &[ControlMode]) -> usize {
    let mut random = Key { seed: 1, world: 0, drone: 0, step: 0, purpose: purpose("test.trace") }.stream();
    let mut compared = 0;
    for mode in modes {
        for all in [true, false] {
            for integrator in [Integrator::Euler, Integrator::SemiImplicitEuler, Integrator::Rk4] {
                let due = Due { state: all, attitude: all, force_torque: true };
                let plan = Plan { mode: *mode, due, integrator };
                let (graph, parameters) = traced(drone, plan);
                for _ in 0..8 {
                    let mut x = drawn(drone, *mode, &mut random);
                    let direct = step(drone, plan, &x);
                    x.extend(&parameters);
                    let by_graph = graph.eval(&x);
                    assert_eq!(by_graph.len(), direct.len());
                    for (k, (a, b)) in by_graph.iter().zip(&direct).enumerate() {
                        let same = a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan());
                        assert!(same, "{name} {plan:?}: number {k} is {a:e}, not {b:e}");
                        compared += 1;
                    }
                }
            }
        }
    }
    compared
}

#[test]
fn a_traced_step_gives_the_bits_of_the_code() {
    let mut compared = 0;
    for name in propwash::vehicle::BUILTIN {
        let vehicle = Vehicle::builtin(name).unwrap();
        for dynamics in vehicle.available_dynamics() {
            let drone = vehicle.drone(dynamics).unwrap();
            compared += compare(&format!("{name} {dynamics}"), &drone, &vehicle.modes(dynamics).unwrap());
        }
    }
    assert!(compared > 10_000, "{compared}");
}

#[test]
fn a_traced_step_with_any_effect_gives_the_bits_of_the_code() {
    let vehicle = Vehicle::builtin("cf2x_L250").unwrap();
    let plain = vehicle.drone(vehicle.available_dynamics()[0]).unwrap();
    let mut random = Key { seed: 3, world: 0, drone: 0, step: 0, purpose: purpose("test.trace") }.stream();
    let mut traced = 0;
    for kind in KINDS {
        let Some(mut effect) = AnyEffect::by_kind(kind) else { continue };
        // Numbers that are not those of an effect without influence.
        effect.visit("", &mut |_, v| *v += 0.05 * random.uniform(0.5, 1.0));
        let mut drone = plain.clone();
        drone.effects.push(effect);
        compare(kind, &drone, &[ControlMode::Attitude]);
        traced += 1;
    }
    assert!(traced > 25, "{traced} of {} effects", KINDS.len());
}

/// One sweep backwards gives what forward derivatives give, one input after the other.
#[test]
fn slopes_of_a_step_backwards_are_those_of_duals() {
    let vehicle = Vehicle::builtin("cf2x_T350").unwrap();
    let mut random = Key { seed: 2, world: 0, drone: 0, step: 0, purpose: purpose("test.trace") }.stream();
    for dynamics in vehicle.available_dynamics() {
        let drone = vehicle.drone(dynamics).unwrap();
        let due = Due { state: true, attitude: true, force_torque: true };
        let plan = Plan { mode: ControlMode::Attitude, due, integrator: Integrator::Rk4 };
        let (graph, parameters) = traced(&drone, plan);
        let back = adjoint(&graph);
        for _ in 0..5 {
            let x = drawn(&drone, plan.mode, &mut random);
            let weights: Vec<f64> = graph.outputs.iter().map(|_| random.normal()).collect();
            let slopes = back.eval(&[x.as_slice(), &parameters, &weights].concat());

            // By the command and the velocities.
            let wrt: [usize; 10] = [STATE, STATE + 1, STATE + 2, STATE + 3, 7, 8, 9, 10, 11, 12];
            let constant = |v: f64| Dual::<f64, 10>::lit(v);
            let mut seeded: Vec<Dual<f64, 10>> = x.iter().map(|v| constant(*v)).collect();
            for (i, k) in wrt.iter().enumerate() {
                seeded[*k] = Dual::input(x[*k], i);
            }
            let forward = step(&drone.map(&mut |v| constant(v)), plan, &seeded);
            for (i, k) in wrt.iter().enumerate() {
                let by_duals: f64 = forward.iter().zip(&weights).map(|(v, w)| v.partials[i] * w).sum();
                let size: f64 = forward.iter().zip(&weights).map(|(v, w)| (v.partials[i] * w).abs()).sum();
                let off = (slopes[*k] - by_duals).abs() / (1e-12 + size);
                assert!(off < 1e-10, "{dynamics} input {k}: {} backwards, {by_duals} forwards", slopes[*k]);
            }
        }
    }
}
