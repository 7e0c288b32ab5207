//! A step of one drone as a graph, cut by how often its values change: what lanes fly.

mod backwards;

pub(super) use backwards::{Backwards, adjoint_schedule};

use std::sync::LazyLock;

use super::blocks::{Phase, Slot, periods};
use propwash_physics::controllers::{COMMAND_WIDTH, ControlMode, Due, Memory, Rates, mellinger};
use propwash_physics::drone::Drone;
use propwash_physics::integrate::Integrator;
use propwash_physics::rigid_body::{MAX_ROTORS, State};
use propwash_physics::surroundings::Neighbour;
use propwash_trace::Real;
use propwash_trace::kernel::key;
use propwash_trace::schedule::{Input, Output, Schedule, schedule};
use propwash_trace::trace::{Graph, Sym, trace_finite};
use propwash_vehicle::{BUILTIN, Vehicle, VehicleError};

/// Numbers that a step reads or writes, in this order; effects' memory and neighbours follow.
pub(super) mod place {
    use super::{COMMAND_WIDTH, MAX_ROTORS, Memory};

    /// Position, attitude, velocity, angular velocity, rotor speeds, thrust.
    pub const STATE: u32 = 0;
    pub const QUAT: u32 = STATE + 3;
    pub const VEL: u32 = QUAT + 4;
    pub const ANG_VEL: u32 = VEL + 3;
    pub const ROTOR_VEL: u32 = ANG_VEL + 3;
    pub const THRUST: u32 = ROTOR_VEL + MAX_ROTORS as u32;
    /// Of the controllers.
    pub const MEMORY: u32 = THRUST + 1;
    pub const ROTOR_COMMAND: u32 = MEMORY + Memory::<f64>::LEN as u32;
    pub const ATTITUDE_COMMAND: u32 = ROTOR_COMMAND + MAX_ROTORS as u32;
    pub const COMMAND: u32 = ATTITUDE_COMMAND + 4;
    pub const FORCE: u32 = COMMAND + COMMAND_WIDTH as u32;
    pub const TORQUE: u32 = FORCE + 3;
    pub const WIND: u32 = TORQUE + 3;
    pub const GROUND: u32 = WIND + 3;
    pub const CEILING: u32 = GROUND + 1;
    pub const TIME: u32 = CEILING + 1;
    pub const NORMALS: u32 = TIME + 1;
    /// Of the effects.
    pub const EFFECTS: u32 = NORMALS + 6;
    /// Numbers of one neighbour: position, velocity, weight, radius.
    pub const NEIGHBOUR: u32 = 8;
}

/// What a step is made of, beside the drone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    pub mode: ControlMode,
    pub integrator: Integrator,
    pub phase: Phase,
    pub due: Due,
    pub sim_hz: u32,
    /// How many other drones an effect may read.
    pub neighbours: usize,
}

/// Numbers that never change: parameters, and the lengths of steps and of the controllers' periods.
pub(super) fn fixed(drone: &Drone<f64>, rates: &Rates, sim_hz: u32) -> Vec<f64> {
    let mut out = Vec::new();
    fixed_into(drone, rates, sim_hz, &mut out);
    out
}

/// The same, in place of what stood in `out`.
pub(super) fn fixed_into(drone: &Drone<f64>, rates: &Rates, sim_hz: u32, out: &mut Vec<f64>) {
    out.clear();
    drone.numbers(&mut |v| out.push(v));
    let p = periods(rates);
    out.extend([1.0 / f64::from(sim_hz), p.state, p.attitude, p.body_rate]);
}

/// A parameter that stands in a graph as the constant that it is, or one that is read from a table.
type Known = Vec<Option<f64>>;

/// Parameters that all built-in vehicles share and that are 0, 1 or −1, for every model: with these as constants one kernel
/// serves them all, and every other vehicle that shares them.
static SHARED: LazyLock<Vec<(Drone<f64>, Known)>> = LazyLock::new(|| {
    let mut out: Vec<(Drone<f64>, Known)> = Vec::new();
    for name in BUILTIN {
        let Ok(vehicle) = Vehicle::builtin(name) else { continue };
        for dynamics in vehicle.available_dynamics() {
            let Ok(drone) = vehicle.drone(dynamics) else { continue };
            let (bare, own) = (bare(&drone), simple(&drone, &|_| false));
            match out.iter_mut().find(|(other, _)| *other == bare) {
                Some((_, known)) => {
                    for (known, own) in known.iter_mut().zip(&own) {
                        *known = known.filter(|_| *known == *own);
                    }
                }
                None => out.push((bare, own)),
            }
        }
    }
    out
});

/// What a drone is made of, without its numbers.
pub(super) fn bare(drone: &Drone<f64>) -> Drone<f64> {
    drone.map(&mut |_| 0.0)
}

/// Parameters of 0, 1 or −1 that do not vary.
fn simple(drone: &Drone<f64>, varies: &dyn Fn(usize) -> bool) -> Known {
    let mut out: Known = Vec::new();
    drone.numbers(&mut |v| {
        let plain = (v == 0.0 || v.abs() == 1.0) && !varies(out.len());
        out.push(plain.then_some(v));
    });
    out
}

/// Which parameters of a drone stand in its graph as constants: those that the built-in vehicles share where it has them too,
/// else its own.
fn known(drone: &Drone<f64>, varies: &dyn Fn(usize) -> bool) -> Known {
    let own = simple(drone, varies);
    let bare = bare(drone);
    let fits = |shared: &Known| shared.iter().zip(&own).all(|(a, b)| a.is_none() || a == b);
    match SHARED.iter().find(|(other, shared)| *other == bare && fits(shared)) {
        Some((_, shared)) => shared.clone(),
        None => own,
    }
}

/// The slot of a drone whose numbers stand by place, `effects` of them the memory of its effects.
fn slot<S: Real>(home: &[S], effects: usize) -> Slot<S> {
    let at = |from: u32, i: usize| home[from as usize + i];
    Slot {
        state: State {
            pos: core::array::from_fn(|i| at(place::STATE, i)),
            quat: core::array::from_fn(|i| at(place::QUAT, i)),
            vel: core::array::from_fn(|i| at(place::VEL, i)),
            ang_vel: core::array::from_fn(|i| at(place::ANG_VEL, i)),
            rotor_vel: core::array::from_fn(|i| at(place::ROTOR_VEL, i)),
            thrust: at(place::THRUST, 0),
        },
        command: core::array::from_fn(|i| at(place::COMMAND, i)),
        memory: Memory::load(|i| at(place::MEMORY, i)),
        rotor_command: core::array::from_fn(|i| at(place::ROTOR_COMMAND, i)),
        attitude_command: core::array::from_fn(|i| at(place::ATTITUDE_COMMAND, i)),
        disturbance_force: core::array::from_fn(|i| at(place::FORCE, i)),
        disturbance_torque: core::array::from_fn(|i| at(place::TORQUE, i)),
        wind: core::array::from_fn(|i| at(place::WIND, i)),
        ground_z: at(place::GROUND, 0),
        ceiling_z: at(place::CEILING, 0),
        effect_memory: (0..effects).map(|i| at(place::EFFECTS, i)).collect(),
    }
}

/// What goes into a step: parameters, then the numbers of the home by place.
fn inputs(n_fixed: usize, n_places: usize, first_neighbour: u32) -> Vec<Input> {
    let mut inputs: Vec<Input> = (0..n_fixed).map(|k| Input::Fixed(k as u32)).collect();
    for p in 0..n_places as u32 {
        let in_neighbour = (p.wrapping_sub(first_neighbour)) % place::NEIGHBOUR;
        inputs.push(match p {
            _ if p >= first_neighbour && in_neighbour < 6 => Input::Fresh(p),
            _ if p >= first_neighbour => Input::Given(p),
            place::TIME..place::EFFECTS => Input::Fresh(p),
            place::ROTOR_COMMAND..place::TIME => Input::Given(p),
            _ => Input::Carried(p),
        });
    }
    inputs
}

/// The `j`-th other drone among the numbers of the home.
fn neighbour(home: &[Sym], first_neighbour: u32, j: usize) -> Neighbour<Sym> {
    let first = (first_neighbour + j as u32 * place::NEIGHBOUR) as usize;
    Neighbour {
        pos: core::array::from_fn(|i| home[first + i]),
        vel: core::array::from_fn(|i| home[first + 3 + i]),
        weight_n: home[first + 6],
        disc_radius_m: home[first + 7],
    }
}

/// The step of `drone` as a graph of its inputs, and what goes in and out. A parameter of exactly 0, 1 or −1 may stand in the
/// graph as such, unless `varies` says that it differs between drones.
pub(super) fn graph(
    drone: &Drone<f64>,
    shape: &Shape,
    varies: &dyn Fn(usize) -> bool,
) -> (Graph, Vec<Input>, Vec<Output>) {
    let known = known(drone, varies);
    let dt = 1.0 / f64::from(shape.sim_hz);
    let effects = drone.memory_len(dt);
    let mut n_fixed = 4;
    drone.numbers(&mut |_| n_fixed += 1);
    let controls = shape.phase != Phase::Integration;
    let moves = shape.phase != Phase::Controllers;
    let first_neighbour = place::EFFECTS + effects as u32;
    let n_places = first_neighbour as usize + shape.neighbours * place::NEIGHBOUR as usize;

    let inputs = inputs(n_fixed, n_places, first_neighbour);
    let mut outputs = Vec::new();
    let graph = trace_finite(n_fixed + n_places, |x| {
        let (parameters, x) = x.split_at(n_fixed);
        let at = |from: u32, i: usize| x[from as usize + i];
        let mut k = 0;
        let drone: Drone<Sym> = drone.map(&mut |_| {
            k += 1;
            known[k - 1].map_or(parameters[k - 1], Sym::lit)
        });
        let [dt_s, state_s, attitude_s, body_rate_s] = core::array::from_fn(|i| parameters[n_fixed - 4 + i]);
        let mut slot = slot(x, effects);
        let neighbours: Vec<Neighbour<Sym>> =
            (0..shape.neighbours).map(|j| neighbour(x, first_neighbour, j)).collect();
        let normals = core::array::from_fn(|i| at(place::NORMALS, i));
        let around = (at(place::TIME, 0), normals, &neighbours[..]);
        if controls {
            let periods = mellinger::Periods { state: state_s, attitude: attitude_s, body_rate: body_rate_s };
            slot.control(&drone, (shape.mode, shape.due, &periods), (dt_s, dt), around);
        }
        if moves {
            slot.state = slot.moved(&drone, shape.integrator, (dt_s, dt), around);
        }
        let mut out = Vec::new();
        let s = &slot.state;
        let motion = [&s.pos[..], &s.quat, &s.vel, &s.ang_vel, &s.rotor_vel, &[s.thrust]].concat();
        for (i, v) in motion.into_iter().enumerate() {
            outputs.push(Output::Carried(place::STATE + i as u32));
            out.push(v);
        }
        slot.memory.store(|i, v| {
            outputs.push(Output::Carried(place::MEMORY + i as u32));
            out.push(v);
        });
        for (i, v) in slot.effect_memory.iter().enumerate() {
            outputs.push(Output::Carried(place::EFFECTS + i as u32));
            out.push(*v);
        }
        if controls {
            for (i, v) in slot.rotor_command.iter().chain(&slot.attitude_command).enumerate() {
                outputs.push(Output::Final(place::ROTOR_COMMAND + i as u32));
                out.push(*v);
            }
        }
        out
    });
    (graph, inputs, outputs)
}

/// The step of `drone`, scheduled.
pub(super) fn scheduled(drone: &Drone<f64>, shape: &Shape, varies: &dyn Fn(usize) -> bool) -> Schedule {
    let (graph, inputs, outputs) = graph(drone, shape, varies);
    schedule(&graph, &inputs, &outputs)
}

/// A step that many fly: what a kernel is generated from.
#[derive(Clone, Debug)]
pub struct CommonStep {
    /// Name of its kernel.
    pub name: String,
    /// What it computes, in a line.
    pub about: String,
    /// The step.
    pub schedule: Schedule,
}

/// Steps per second that kernels are named after; the rate itself is a parameter, but which stages tick together depends on it.
const USUAL_HZ: u32 = 500;

/// What kernels are generated for: the models in all control modes, by the default integrator. Every other step runs as byte code.
const COMMON: [(&str, ControlMode); 11] = [
    ("first_principles", ControlMode::RotorVel),
    ("first_principles", ControlMode::ForceTorque),
    ("first_principles", ControlMode::BodyRate),
    ("first_principles", ControlMode::Attitude),
    ("first_principles", ControlMode::State),
    ("so_rpy", ControlMode::Attitude),
    ("so_rpy", ControlMode::State),
    ("so_rpy_rotor", ControlMode::Attitude),
    ("so_rpy_rotor", ControlMode::State),
    ("so_rpy_rotor_drag", ControlMode::Attitude),
    ("so_rpy_rotor_drag", ControlMode::State),
];

/// The same for steps backwards, which are long code: the commonest of them.
const BACKWARDS: [(&str, ControlMode); 4] = [
    ("first_principles", ControlMode::RotorVel),
    ("first_principles", ControlMode::ForceTorque),
    ("first_principles", ControlMode::Attitude),
    ("so_rpy_rotor_drag", ControlMode::Attitude),
];

/// The steps that kernels are generated for, each once: all built-in vehicles fly them, and every vehicle that is made of the
/// same parts and has the same parameters of 0, 1 and −1.
pub fn common_steps() -> Result<Vec<CommonStep>, VehicleError> {
    let mut out: Vec<CommonStep> = Vec::new();
    for (dynamics, mode) in COMMON {
        for name in BUILTIN {
            let vehicle = Vehicle::builtin(name)?;
            let Ok(drone) = vehicle.drone(dynamics) else { continue };
            let mut dues: Vec<Due> = Vec::new();
            for step in 0..USUAL_HZ {
                let due = relevant(mode, vehicle.rates.due(mode, step.into(), USUAL_HZ));
                if !dues.contains(&due) {
                    dues.push(due);
                }
            }
            for due in dues {
                let integrator = Integrator::Euler;
                let shape =
                    Shape { mode, integrator, phase: Phase::Both, due, sim_hz: USUAL_HZ, neighbours: 0 };
                let forwards = scheduled(&drone, &shape, &|_| false);
                add(&mut out, (dynamics, mode), false, forwards);
                if BACKWARDS.contains(&(dynamics, mode)) {
                    let backwards = adjoint_schedule(&drone, &shape, &|_| false, &[]);
                    add(&mut out, (dynamics, mode), true, backwards);
                }
            }
        }
    }
    Ok(out)
}

/// Adds a step unless it is there.
fn add(
    out: &mut Vec<CommonStep>,
    (dynamics, mode): (&str, ControlMode),
    backwards: bool,
    schedule: Schedule,
) {
    if out.iter().any(|s| key(&s.schedule) == key(&schedule)) {
        return;
    }
    let (end, how) = if backwards { ("_adjoint", ", backwards") } else { ("", "") };
    let plain = format!("{dynamics}_{}{end}", mode.name());
    let numbered = |n: usize| if n == 1 { plain.clone() } else { format!("{plain}_{n}") };
    let free = (1..).map(numbered).find(|name| out.iter().all(|s| s.name != *name));
    let about = format!("A step of `{dynamics}` under commands `{}`{how}.", mode.name());
    out.push(CommonStep { name: free.unwrap_or(plain), about, schedule });
}

/// What ticks, without what does not matter in a control mode.
pub(super) fn relevant(mode: ControlMode, due: Due) -> Due {
    let attitude = matches!(mode, ControlMode::State | ControlMode::Attitude | ControlMode::BodyRate);
    Due {
        state: due.state && mode == ControlMode::State,
        attitude: due.attitude && attitude,
        force_torque: due.force_torque && mode != ControlMode::RotorVel,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Key, purpose};
    use propwash_kernels as kernels;
    use propwash_physics::effects::{self, AnyEffect};
    use propwash_trace::bytecode::{Interpret, Program};
    use propwash_trace::lanes::level;
    use propwash_trace::schedule::{Location, Source};
    use propwash_trace::trace::Node;

    /// The numbers by place, after `steps` of the equations.
    fn by_equations(
        drone: &Drone<f64>,
        rates: &Rates,
        shape: &Shape,
        home: &[f64],
        steps: usize,
    ) -> Vec<f64> {
        let dt = 1.0 / f64::from(shape.sim_hz);
        let mut slot = slot(home, 0);
        for _ in 0..steps {
            let around = (0.0, [0.0; 6], &[][..]);
            slot.control(drone, (shape.mode, shape.due, &periods(rates)), (dt, dt), around);
            slot.state = slot.moved(drone, shape.integrator, (dt, dt), around);
        }
        let mut out = home.to_vec();
        let s = &slot.state;
        let motion = [&s.pos[..], &s.quat, &s.vel, &s.ang_vel, &s.rotor_vel, &[s.thrust]].concat();
        out[..motion.len()].copy_from_slice(&motion);
        slot.memory.store(|i, v| out[place::MEMORY as usize + i] = v);
        out[place::ROTOR_COMMAND as usize..][..MAX_ROTORS].copy_from_slice(&slot.rotor_command);
        out[place::ATTITUDE_COMMAND as usize..][..4].copy_from_slice(&slot.attitude_command);
        out
    }

    /// The same by a kernel, or by byte code where there is none.
    fn by_code(schedule: &Schedule, fixed: &[f64], home: &[f64], steps: usize, compiled: bool) -> Vec<f64> {
        let n = home.len();
        let program = Program::new(schedule, n);
        let mut file = home.to_vec();
        file.resize(n + program.len, 0.0);
        file[n..][..schedule.n_constants].copy_from_slice(&schedule.once.eval(fixed));
        file[program.constants_at..][..program.constants.len()].copy_from_slice(&program.constants);
        for (input, at) in schedule.given.iter().zip(schedule.given_at()) {
            if let (Some(p), Location::Scratch(k)) = (input.place(), at) {
                file[n + k as usize] = home[p as usize];
            }
        }
        if compiled {
            let kernel = kernels::ALL.iter().find(|k| k.key == key(schedule)).expect("a kernel");
            let (home, scratch) = file.split_at_mut(n);
            (kernel.scalar.call)(level(), scratch);
            (kernel.scalar.step)(level(), home, scratch, steps);
            (kernel.scalar.epilogue)(level(), home, scratch);
        } else {
            f64::interpret(level(), &program.call, &mut file, 1);
            f64::interpret(level(), &program.step, &mut file, steps);
            f64::interpret(level(), &program.epilogue, &mut file, 1);
        }
        let (table, state) = (schedule.call_at(), schedule.state_at());
        let number = |at: Location| match at {
            Location::Home(p) => file[p as usize],
            Location::Scratch(k) => file[n + k as usize],
        };
        let mut out = file[..n].to_vec();
        for (output, source) in &schedule.finals {
            out[output.place() as usize] = match source {
                Source::Call(k) => number(table[*k as usize]),
                Source::State(k) => number(state[*k as usize]),
                Source::Constant(v) => *v,
                Source::Input(input) => input.place().map_or(0.0, |p| home[p as usize]),
            };
        }
        out
    }

    /// What the arrays do not keep stays zero.
    #[test]
    fn no_step_changes_numbers_of_the_controllers_that_its_mode_is_said_not_to_use() {
        let mut changed = 0;
        for dynamics in ["first_principles", "so_rpy_rotor_drag"] {
            let vehicle = Vehicle::builtin(BUILTIN[0]).unwrap();
            let drone = vehicle.drone(dynamics).unwrap();
            let rotors = drone.airframe.n_rotors;
            // Rotors that the vehicle lacks are commanded what they were told, nothing.
            let own = Memory::<f64>::LEN - MAX_ROTORS + rotors;
            for mode in vehicle.modes(dynamics).unwrap() {
                let used = Memory::<f64>::used(mode, rotors);
                for k in 0..8 {
                    let due = Due { state: k & 1 > 0, attitude: k & 2 > 0, force_torque: k & 4 > 0 };
                    let due = relevant(mode, due);
                    let integrator = Integrator::Euler;
                    let shape =
                        Shape { mode, integrator, phase: Phase::Both, due, sim_hz: 500, neighbours: 0 };
                    let (graph, inputs, outputs) = graph(&drone, &shape, &|_| false);
                    for (node, output) in graph.outputs.iter().zip(&outputs) {
                        let p = output.place();
                        if !(place::MEMORY..place::MEMORY + own as u32).contains(&p) {
                            continue;
                        }
                        let kept = matches!(graph.nodes[*node as usize], Node::Input(i)
                            if inputs[i as usize] == Input::Carried(p));
                        let i = (p - place::MEMORY) as usize;
                        assert!(kept || used.contains(&i), "{dynamics} {mode:?} {due:?} changes number {i}");
                        changed += usize::from(!kept);
                    }
                }
            }
        }
        assert!(changed > 100, "{changed}");
    }

    #[test]
    fn numbers_of_a_drone_come_in_the_order_of_its_map() {
        for name in BUILTIN {
            let vehicle = Vehicle::builtin(name).unwrap();
            for dynamics in vehicle.available_dynamics() {
                let mut drone = vehicle.drone(dynamics).unwrap();
                drone.effects = effects::KINDS.iter().filter_map(|kind| AnyEffect::by_kind(kind)).collect();
                let (mut n, mut all) = (0, Vec::new());
                drone.numbers_mut(&mut |v| {
                    *v = f64::from(n);
                    n += 1;
                });
                let mapped = drone.map(&mut |v| {
                    all.push(v);
                    v
                });
                assert_eq!(all, (0..n).map(f64::from).collect::<Vec<_>>(), "{name} {dynamics}");
                assert_eq!(mapped, drone);
                let mut read = Vec::new();
                drone.numbers(&mut |v| read.push(v));
                assert_eq!(read, all, "{name} {dynamics}");
            }
        }
    }

    #[test]
    fn kernels_and_byte_code_give_the_numbers_of_the_equations_for_every_built_in_vehicle() {
        let mut random =
            Key { seed: 1, world: 0, drone: 0, step: 0, purpose: purpose("test.kernels") }.stream();
        let (mut by_kernel, mut by_byte_code) = (0, 0);
        for name in BUILTIN {
            let vehicle = Vehicle::builtin(name).unwrap();
            for dynamics in vehicle.available_dynamics() {
                let drone = vehicle.drone(dynamics).unwrap();
                for mode in vehicle.modes(dynamics).unwrap() {
                    for all in [true, false] {
                        let due = relevant(mode, Due { state: all, attitude: true, force_torque: true });
                        let integrator = Integrator::Euler;
                        let shape =
                            Shape { mode, integrator, phase: Phase::Both, due, sim_hz: 500, neighbours: 0 };
                        let schedule = scheduled(&drone, &shape, &|_| false);
                        let known = kernels::ALL.iter().any(|k| k.key == key(&schedule));
                        let common = COMMON.contains(&(dynamics, mode));
                        assert!(known || !common, "{name} {dynamics} {mode:?} flies without its kernel");
                        let fixed = fixed(&drone, &vehicle.rates, 500);
                        for steps in [1, 5] {
                            let mut home: Vec<f64> =
                                (0..place::EFFECTS).map(|_| 0.1 * random.normal()).collect();
                            for i in 0..drone.airframe.n_rotors {
                                let hover = drone.hover_rotor_vel()[i];
                                home[place::ROTOR_VEL as usize + i] = hover * random.uniform(0.9, 1.1);
                            }
                            home[place::QUAT as usize + 3] = 1.0;
                            home[place::COMMAND as usize + 3] = drone.hover_thrust();
                            let wanted = by_equations(&drone, &vehicle.rates, &shape, &home, steps);
                            let codes = if known { vec![true, false] } else { vec![false] };
                            for compiled in codes {
                                let got = by_code(&schedule, &fixed, &home, steps, compiled);
                                for (p, (a, b)) in got.iter().zip(&wanted).enumerate() {
                                    // Equal but for the sign of a zero.
                                    assert!(
                                        a == b,
                                        "{name} {dynamics} {mode:?} {compiled}: place {p} is {a:e}, not {b:e}"
                                    );
                                }
                                *(if compiled { &mut by_kernel } else { &mut by_byte_code }) += 1;
                            }
                        }
                    }
                }
            }
        }
        assert!(by_kernel >= 200 && by_byte_code >= by_kernel, "{by_kernel} {by_byte_code}");
    }
}
