//! How do I let something else than the processor's lanes compute the steps?
//!
//! Here it is arithmetic with fewer digits: every result of a step is rounded to a number of binary digits, as on hardware that has no
//! more. How many does a flight need? A backend gets the code of a step, traced from the equations, and runs it on the numbers of the
//! drones; a printer for a GPU would begin at the same place. Run it from the folder of the project:
//! `cargo run --release --example own_backend`.

use std::sync::Arc;

use propwash::rollout::trajectory::Reference;
use propwash::rollout::{Backend, Engine, PreparedStep, Sim, SimOptions};
use propwash::scalar::Real;
use propwash::scalar::schedule::{Code, Instruction, Location, Schedule};
use propwash::vehicle::Vehicle;

/// Rounds every result to this many binary digits behind the first: 52 is f64, 23 is f32, 10 is f16.
#[derive(Debug)]
struct Rounding {
    digits: u32,
}

#[derive(Debug)]
struct Rounded {
    digits: u32,
    schedule: Schedule,
}

impl Backend<f64> for Rounding {
    fn prepare(&self, schedule: &Schedule) -> Box<dyn PreparedStep<f64>> {
        Box::new(Rounded { digits: self.digits, schedule: schedule.clone() })
    }
}

impl Rounded {
    /// The nearest number with so many digits; of two, the even one.
    fn round(&self, v: f64) -> f64 {
        let dropped = 52 - self.digits;
        if dropped == 0 || !v.is_finite() {
            return v;
        }
        let bits = v.to_bits();
        let half = (1u64 << (dropped - 1)) - 1 + (bits >> dropped & 1);
        f64::from_bits((bits + half) >> dropped << dropped)
    }

    /// Runs code on one drone: `states` and `stores` say where what it reads and leaves stands.
    fn run(
        &self,
        code: &Code,
        states: &[Location],
        stores: &[Location],
        home: &mut [f64],
        scratch: &mut [f64],
    ) {
        let table = self.schedule.call_at();
        let mut values: Vec<f64> = Vec::with_capacity(code.instructions.len());
        let mut seconds = vec![0.0; code.instructions.len()];
        for (i, instruction) in code.instructions.iter().enumerate() {
            let read = |at: Location| match at {
                Location::Home(k) => home[k as usize],
                Location::Scratch(k) => scratch[k as usize],
            };
            let v = |k: u32| values[k as usize];
            let holds = |k: u32| v(k) > 0.5;
            let truth = |b: bool| f64::from(u8::from(b));
            let result = match *instruction {
                Instruction::Lit(bits) => f64::from_bits(bits),
                Instruction::Constant(k) => scratch[k as usize],
                Instruction::Call(k) => read(table[k as usize]),
                Instruction::State(k) => read(states[k as usize]),
                Instruction::Add(a, b) => v(a) + v(b),
                Instruction::Sub(a, b) => v(a) - v(b),
                Instruction::Mul(a, b) => v(a) * v(b),
                Instruction::Div(a, b) | Instruction::Over(a, b, _) => v(a) / v(b),
                Instruction::MulAdd(a, b, c) => self.round(v(a) * v(b)) + v(c),
                Instruction::MulSub(a, b, c) => self.round(v(a) * v(b)) - v(c),
                Instruction::MulFrom(a, b, c) => v(c) - self.round(v(a) * v(b)),
                Instruction::Neg(a) => -v(a),
                Instruction::Sqrt(a) => v(a).sqrt(),
                Instruction::Abs(a) => v(a).abs(),
                Instruction::Min(a, b) => Real::min(v(a), v(b)),
                Instruction::Max(a, b) => Real::max(v(a), v(b)),
                Instruction::SinCos(a) => {
                    let (sin, cos) = v(a).sin_cos();
                    seconds[i] = self.round(cos);
                    sin
                }
                Instruction::HalfTurn(a) => {
                    let (scale, cos) = v(a).half_turn();
                    seconds[i] = self.round(cos);
                    scale
                }
                Instruction::Second(of) => seconds[of as usize],
                Instruction::Exp(a) => v(a).exp(),
                Instruction::Atan2(a, b) => v(a).atan2(v(b)),
                Instruction::Floor(a) => v(a).floor(),
                Instruction::Lt(a, b) => truth(v(a) < v(b)),
                Instruction::Le(a, b) => truth(v(a) <= v(b)),
                Instruction::And(a, b) => truth(holds(a) && holds(b)),
                Instruction::Or(a, b) => truth(holds(a) || holds(b)),
                Instruction::Not(a) => truth(!holds(a)),
                Instruction::Select(a, b, c) => v(if holds(a) { b } else { c }),
            };
            values.push(self.round(result));
        }
        for (value, slot) in &code.stores {
            match stores[*slot as usize] {
                Location::Home(k) => home[k as usize] = values[*value as usize],
                Location::Scratch(k) => scratch[k as usize] = values[*value as usize],
            }
        }
    }
}

/// Lends the numbers of one drone after the other; they stand side by side, shape (number, drone).
fn each(drones: usize, home: &mut [f64], scratch: &mut [f64], f: impl Fn(&mut [f64], &mut [f64])) {
    let column = |of: &[f64], d: usize| of.iter().skip(d).step_by(drones).copied().collect::<Vec<f64>>();
    for d in 0..drones {
        let (mut own_home, mut own_scratch) = (column(home, d), column(scratch, d));
        f(&mut own_home, &mut own_scratch);
        home.iter_mut().skip(d).step_by(drones).zip(own_home).for_each(|(to, v)| *to = v);
        scratch.iter_mut().skip(d).step_by(drones).zip(own_scratch).for_each(|(to, v)| *to = v);
    }
}

impl PreparedStep<f64> for Rounded {
    fn call(&self, drones: usize, scratch: &mut [f64]) {
        let (given, table) = (self.schedule.given_at(), self.schedule.call_at());
        each(drones, &mut [], scratch, |home, scratch| {
            self.run(&self.schedule.call, &given, &table, home, scratch);
        });
    }

    fn step(&self, drones: usize, home: &mut [f64], scratch: &mut [f64], times: usize) {
        let state = self.schedule.state_at();
        each(drones, home, scratch, |home, scratch| {
            for _ in 0..times {
                self.run(&self.schedule.step, &state, &state, home, scratch);
            }
        });
    }

    fn epilogue(&self, drones: usize, home: &mut [f64], scratch: &mut [f64]) {
        let state = self.schedule.state_at();
        each(drones, home, scratch, |home, scratch| {
            self.run(&self.schedule.epilogue, &state, &state, home, scratch);
        });
    }
}

/// Height in a climb by half a metre within two seconds, m, every 20 ms.
fn climb(digits: Option<u32>) -> propwash::Result<Vec<f64>> {
    let vehicle = Vehicle::builtin("cf2x_L250")?;
    let options = SimOptions { engine: Engine::Lanes, ..SimOptions::default() };
    let mut sim = Sim::<f64>::new(options, vec![(vehicle.drone("first_principles")?, vehicle.rates)])?;
    if let Some(digits) = digits {
        sim.set_backend(Some(Arc::new(Rounding { digits })))?;
    }
    sim.set_command(&Reference::hover([0.0, 0.0, 0.5], 0.0).command())?;
    let mut heights = Vec::new();
    for _ in 0..100 {
        sim.step(10)?;
        heights.push(sim.data.state(0, 0).pos[2]);
    }
    Ok(heights)
}

fn main() -> propwash::Result<()> {
    let lanes = climb(None)?;
    for digits in [52, 23, 16, 10] {
        let rounded = climb(Some(digits))?;
        let apart = lanes.iter().zip(&rounded).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        println!("with {digits} binary digits the climb is {:.6} mm off", 1e3 * apart);
    }
    Ok(())
}
