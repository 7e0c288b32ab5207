//! A backend of steps that is not in the library: what a program sets in place of kernels and byte code.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use propwash::physics::controllers::ControlMode;
use propwash::rollout::randomize::{Draw, Randomization, Rule};
use propwash::rollout::trajectory::Reference;
use propwash::rollout::{Backend, Engine, PreparedStep, Sim, SimOptions};
use propwash::scalar::bytecode::{Interpret, Program};
use propwash::scalar::lanes::level;
use propwash::scalar::schedule::Schedule;
use propwash::vehicle::Vehicle;

/// Byte code on one f64 at a time, which has the bits of the traced equations.
#[derive(Debug, Default)]
struct OneByOne {
    prepared: AtomicUsize,
}

#[derive(Debug)]
struct Code {
    program: Program,
    n_home: usize,
    n_scratch: usize,
}

impl Backend<f64> for OneByOne {
    fn prepare(&self, schedule: &Schedule) -> Box<dyn PreparedStep<f64>> {
        self.prepared.fetch_add(1, Ordering::Relaxed);
        let (n_home, n_scratch) = (schedule.n_home(), schedule.n_scratch());
        Box::new(Code { program: Program::new(schedule, n_home), n_home, n_scratch })
    }
}

impl Code {
    /// Lends a file of registers filled from drone `d`, and puts its numbers back.
    fn on(&self, drones: usize, home: &mut [f64], scratch: &mut [f64], run: impl Fn(&mut [f64])) {
        assert_eq!((home.len() / drones, scratch.len() / drones), (self.n_home, self.n_scratch));
        for d in 0..drones {
            let numbers = home.chunks_exact(drones).chain(scratch.chunks_exact(drones)).map(|n| n[d]);
            let mut file: Vec<f64> = numbers.collect();
            file.resize(self.program.constants_at, 0.0);
            file.extend(&self.program.constants);
            file.resize(self.n_home + self.program.len, 0.0);
            run(&mut file);
            let cells = home.chunks_exact_mut(drones).chain(scratch.chunks_exact_mut(drones));
            cells.zip(file).for_each(|(n, v)| n[d] = v);
        }
    }
}

impl PreparedStep<f64> for Code {
    fn call(&self, drones: usize, scratch: &mut [f64]) {
        // The call reads and writes scratch alone.
        let mut home = vec![0.0; self.n_home * drones];
        self.on(drones, &mut home, scratch, |file| f64::interpret(level(), &self.program.call, file, 1));
    }

    fn step(&self, drones: usize, home: &mut [f64], scratch: &mut [f64], times: usize) {
        self.on(drones, home, scratch, |file| f64::interpret(level(), &self.program.step, file, times));
    }

    fn epilogue(&self, drones: usize, home: &mut [f64], scratch: &mut [f64]) {
        self.on(drones, home, scratch, |file| f64::interpret(level(), &self.program.epilogue, file, 1));
    }
}

/// Random vehicles in `n_worlds` worlds, two a world, of which one has an effect with memory.
fn worlds(engine: Engine, n_worlds: usize, control: ControlMode) -> Sim<f64> {
    let plain = Vehicle::builtin("cf2x_L250").unwrap();
    let text = plain.to_toml().to_string() + "\n[[effect]]\nkind = \"command_delay\"\ndelay_s = 0.02\n";
    let late = Vehicle::from_toml("late", &text).unwrap();
    let drones = [&plain, &late].map(|v| (v.drone("first_principles").unwrap(), v.rates));
    let mass = Rule { parameter: "body.mass_kg".into(), draw: Draw::Scale([0.9, 1.1]), shared: false };
    let randomization = Randomization { rules: vec![mass] };
    let options = SimOptions { n_worlds, control, engine, seed: 7, randomization, ..SimOptions::default() };
    Sim::<f64>::new(options, drones.to_vec()).unwrap()
}

fn flown(mut sim: Sim<f64>) -> Sim<f64> {
    let command = match sim.options().control {
        ControlMode::Attitude => vec![0.1, -0.05, 0.0, 0.4],
        _ => Reference::hover([0.3, 0.0, 1.0], 0.4).command().to_vec(),
    };
    sim.set_command(&command.repeat(2 * sim.data.n_worlds)).unwrap();
    for n in [1, 7, 150] {
        sim.step(n).unwrap();
    }
    sim
}

#[test]
fn a_backend_flies_as_the_equations_do() {
    for control in [ControlMode::State, ControlMode::Attitude] {
        let mut sim = worlds(Engine::Lanes, 45, control);
        let backend = Arc::new(OneByOne::default());
        sim.set_backend(Some(backend.clone())).unwrap();
        let (own, reference) = (flown(sim), flown(worlds(Engine::Reference, 45, control)));
        assert!(backend.prepared.load(Ordering::Relaxed) >= 2);
        for (a, b) in own
            .data
            .pos
            .iter()
            .chain(&own.data.quat)
            .zip(reference.data.pos.iter().chain(&reference.data.quat))
        {
            assert!((a - b).abs() < 1e-11, "{control:?}: {a} {b}");
        }
        // A world alone flies as it does among others.
        let mut alone = worlds(Engine::Lanes, 1, control);
        alone.set_backend(Some(backend)).unwrap();
        let alone = flown(alone);
        assert_eq!(alone.data.pos, own.data.pos[..6]);
        // And back to kernels and byte code.
        let mut back = worlds(Engine::Lanes, 45, control);
        back.set_backend(Some(Arc::new(OneByOne::default()))).unwrap();
        back.set_backend(None).unwrap();
        assert_eq!(flown(back).data.pos, flown(worlds(Engine::Lanes, 45, control)).data.pos);
    }
}

#[test]
fn the_reference_takes_no_backend() {
    let mut sim = worlds(Engine::Reference, 1, ControlMode::State);
    let said = sim.set_backend(Some(Arc::new(OneByOne::default()))).unwrap_err().to_string();
    assert!(said.contains("engine") && said.contains("lanes"), "{said}");
}
