//! Steps that are compiled at run time: the same bits as byte code, forwards and backwards, for every effect.

#[path = "common/effects.rs"]
mod effects;

use effects::{entry, vehicle};
use propwash::physics::controllers::ControlMode;
use propwash::physics::effects::KINDS;
use propwash::physics::integrate::Integrator;
use propwash::random::{Key, purpose};
use propwash::rollout::{Compile, CompileStatus, Engine, Sim, SimOptions};
use propwash::scalar::lanes::Number;
use propwash::vehicle::Vehicle;

/// A C compiler is no condition for building Propwash's own code, so these tests may lack one.
fn has_compiler() -> bool {
    let there = ["cc", "gcc", "clang"]
        .iter()
        .any(|c| std::process::Command::new(c).arg("--version").output().is_ok());
    if !there {
        println!("skipped: no C compiler");
    }
    there
}

/// What a flight of 19 worlds ends with, in bits; and the gains of a loss by commands and start.
fn flown<N: Number>(
    vehicle: &Vehicle,
    control: ControlMode,
    integrator: Integrator,
    compile: Compile,
) -> Vec<u64> {
    let drone = vehicle.drone("first_principles").unwrap();
    let n_worlds = 19;
    let options = SimOptions {
        n_worlds,
        control,
        integrator,
        engine: Engine::Lanes,
        compile,
        seed: 3,
        ..SimOptions::default()
    };
    let hover = drone.hover_thrust();
    let rotors = drone.hover_rotor_vel();
    let mut sim = Sim::<N>::storing(options, vec![(drone, vehicle.rates)]).unwrap();
    let width = sim.command_width();
    let mut random = Key { seed: 5, world: 0, drone: 0, step: 0, purpose: purpose("test.compile") }.stream();
    let commands: Vec<f64> = (0..n_worlds * width)
        .map(|k| match (control, k % width) {
            (ControlMode::RotorVel, r) => rotors[r] * random.uniform(0.9, 1.1),
            (ControlMode::Attitude, 3) => hover * random.uniform(0.8, 1.2),
            (ControlMode::State, 12) => 1.0,
            (ControlMode::State, 3..) => 0.0,
            _ => random.uniform(-0.3, 0.3),
        })
        .collect();
    sim.set_command(&commands).unwrap();
    sim.step(37).unwrap();
    let s = &sim.data;
    let arrays = [&s.pos, &s.quat, &s.vel, &s.ang_vel, &s.rotor_vel, &s.controller_memory, &s.effect_memory];
    let mut out: Vec<u64> = arrays.into_iter().flatten().map(|v| v.wide().to_bits()).collect();
    if compile == Compile::Now {
        let status = sim.compiling();
        let ready = status.iter().all(|s| matches!(s, CompileStatus::Ready(_)));
        assert!(ready && !status.is_empty(), "{status:?}");
    }
    // Commands of four times, and what the last state's numbers gain by them.
    let sequence: Vec<N> = (0..4).flat_map(|_| commands.iter().map(|v| N::of(*v))).collect();
    let sequence = by_world(&sequence, n_worlds, width);
    let mut tape = sim.record(&sequence, 2).unwrap();
    let gains = tape.pull_back(&vec![N::one(); tape.states().len()], &[]).unwrap();
    out.extend(gains.state.iter().chain(&gains.commands).map(|v| v.wide().to_bits()));
    out
}

/// From (time, world, number) to (world, time, number).
fn by_world<N: Number>(list: &[N], n_worlds: usize, width: usize) -> Vec<N> {
    let times = list.len() / (n_worlds * width);
    let at = |w: usize, t: usize| &list[(t * n_worlds + w) * width..][..width];
    (0..n_worlds).flat_map(|w| (0..times).flat_map(move |t| at(w, t).iter().copied())).collect()
}

#[test]
fn compiled_steps_have_the_bits_of_byte_code_with_every_effect() {
    if !has_compiler() {
        return;
    }
    // Effects that cannot stand together in one file go to the next.
    let mut groups: Vec<(String, Vec<&str>)> = Vec::new();
    for kind in KINDS {
        let text = entry(kind);
        let fits = |group: &(String, Vec<&str>)| {
            let whole = format!("{}{text}", group.0);
            group.1.len() < 9
                && std::panic::catch_unwind(|| vehicle(&whole).drone("first_principles").unwrap()).is_ok()
        };
        match groups.iter_mut().find(|group| fits(group)) {
            Some(group) => {
                group.0.push_str(&text);
                group.1.push(kind);
            }
            None => groups.push((text, vec![kind])),
        }
    }
    assert!(groups.len() < 8, "{groups:?}");
    for (k, (text, kinds)) in groups.iter().enumerate() {
        let vehicle = vehicle(text);
        let control = [ControlMode::Attitude, ControlMode::RotorVel, ControlMode::State][k % 3];
        let run = |compile| flown::<f32>(&vehicle, control, Integrator::Euler, compile);
        assert_eq!(run(Compile::Now), run(Compile::Off), "{kinds:?}");
    }
    // A controller in place of the one on board.
    let own = vehicle(
        "[[effect]]\nkind = \"expression\"\nname = \"own\"\nmodels = [\"first_principles\"]\ncontrols = true\n\
         let = [\"turn = 20 * wx + 3 * held\"]\nmemory.held = { next = \"held + dt * (normal1 + command1)\" }\n\
         rotor_command = [\"1500 - turn\", \"where(z < 0, 1450, 1500) - turn\", \"1500 + turn\", \"1500 + turn\"]",
    );
    let run = |compile| flown::<f32>(&own, ControlMode::Attitude, Integrator::Euler, compile);
    assert_eq!(run(Compile::Now), run(Compile::Off));
    let mixed = vehicle(&groups[0].0);
    let run = |compile| flown::<f64>(&mixed, ControlMode::Attitude, Integrator::Rk4, compile);
    assert_eq!(run(Compile::Now), run(Compile::Off));
}

/// Nothing but the time is given anew here, so compiled code takes many steps at once with a list of times, 64 at most.
#[test]
fn what_reads_the_time_has_the_bits_of_byte_code_in_calls_of_any_length() {
    if !has_compiler() {
        return;
    }
    let gust = vehicle(
        "[[effect]]\nkind = \"expression\"\nname = \"own_gust\"\nforce_world_n = [\"0.01 * sin(9 * t)\", \"0\", \"0\"]",
    );
    let flown = |compile| {
        let options = SimOptions {
            n_worlds: 19,
            control: ControlMode::RotorVel,
            engine: Engine::Lanes,
            compile,
            ..SimOptions::default()
        };
        let drone = gust.drone("first_principles").unwrap();
        let mut sim = Sim::<f32>::storing(options, vec![(drone, gust.rates)]).unwrap();
        sim.data.command.fill(1500.0);
        sim.step(150).unwrap();
        sim.step(1).unwrap();
        // Blocks of worlds that are in the same step, and one in which one is not.
        sim.reset(Some(&(0..19).map(|w| w == 17).collect::<Vec<_>>())).unwrap();
        sim.data.command.fill(1500.0);
        sim.step(70).unwrap();
        let s = &sim.data;
        let bits: Vec<u32> = s.pos.iter().chain(&s.vel).chain(&s.quat).map(|v| v.to_bits()).collect();
        bits
    };
    assert_eq!(flown(Compile::Now), flown(Compile::Off));
}
