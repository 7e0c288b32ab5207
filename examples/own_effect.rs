//! How do I add a physical effect that Propwash does not have?
//!
//! Here it is dynamic inflow: after a step in rotor speed the thrust overshoots, until the air that flows through the rotors has sped
//! up as well (Carpenter & Fridovich, "Effect of a rapid blade-pitch increase on the thrust and induced-velocity response of a
//! full-scale helicopter rotor", NACA TN 3044, 1953). Its memory is the thrust that the inflow has settled to. The effect is one
//! file; once registered it flies in all simulations, environments and data sets of this program, in the reference and in lanes.
//! Run it from the folder of the project: `cargo run --release --example own_effect`.

use propwash::physics::airframe;
use propwash::physics::effects::{self, Bounds, Command, Effect, Nature, View};
use propwash::physics::rigid_body::State;
use propwash::rollout::trajectory::Reference;
use propwash::rollout::{Engine, Sim, SimOptions};
use propwash::scalar::Real;
use propwash::scalar::lanes::Number;
use propwash::vehicle::Vehicle;

propwash::parameters! {
    /// Parameters of dynamic inflow.
    pub struct Params {
        /// Thrust beyond that of settled inflow, as a share of how far the thrust is from settled, 1.
        overshoot: S,
        /// Time in which inflow settles, s.
        settling_s: S,
    }
}

impl Default for Params<f64> {
    /// No overshoot: the effect does nothing.
    fn default() -> Self {
        Self { overshoot: 0.0, settling_s: 0.1 }
    }
}

/// Thrust of all rotors by their curves, N.
fn thrust<S: Real>(view: &View<S>) -> S {
    let loads = airframe::loads(view.airframe, &view.rotor_vel());
    (0..view.airframe.n_rotors).fold(S::zero(), |sum, i| sum + loads.thrust[i])
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { moved_by_memory: true, ..Nature::default() }
    }

    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("overshoot", Bounds::from(0.0)), ("settling_s", Bounds::above(0.0))] }
    }

    /// The thrust to which inflow has settled, N, and whether there has been a step.
    fn memory_len(&self, _: f64) -> usize {
        2
    }

    fn command(&self, view: &View<S>, dt_s: S, _: &mut Command<S>, memory: &mut [S]) {
        let now = thrust(view);
        let begun = S::zero().lt(memory[1]);
        let keep = (-dt_s / self.settling_s).exp();
        memory[0] = S::select(begun, now + keep * (memory[0] - now), now);
        memory[1] = S::one();
    }

    fn thrust_gain(&self, view: &View<S>, _: [S; 3]) -> S {
        let (now, settled) = (thrust(view).max(S::lit(1e-6)), view.remembered(0));
        let begun = S::zero().lt(view.remembered(1));
        S::select(begun, S::one() + self.overshoot * (now - settled) / now, S::one())
    }
}

/// Height over the start after a step of the reference by 0.5 m, m, every 20 ms.
fn climb<N: Number>(vehicle: &Vehicle, engine: Engine) -> propwash::Result<Vec<f64>> {
    let options = SimOptions { engine, ..SimOptions::default() };
    let mut sim = Sim::<N>::storing(options, vec![(vehicle.drone("first_principles")?, vehicle.rates)])?;
    sim.set_initial(0, 0, State { pos: [0.0, 0.0, 1.0], ..State::rest() })?;
    sim.reset(None)?;
    sim.set_command(&Reference::hover([0.0, 0.0, 1.5], 0.0).command())?;
    let mut heights = Vec::new();
    for _ in 0..50 {
        sim.step(10)?;
        heights.push(sim.data.state(0, 0).pos[2] - 1.0);
    }
    Ok(heights)
}

/// The greatest difference between two flights, m.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

fn main() -> propwash::Result<()> {
    // Nothing of it may be missing in a model: a search for missing physics does not look for it.
    effects::register::<Params<f64>>("dynamic_inflow", |_| Vec::new())?;

    let plain = Vehicle::builtin("cf2x_L250")?;
    let entry = "\n[[effect]]\nkind = \"dynamic_inflow\"\novershoot = 0.6\nsettling_s = 0.08\n";
    let text = plain.to_toml().to_string() + entry;
    let vehicle = Vehicle::from_toml("with dynamic inflow", &text)?;

    let without = climb::<f64>(&plain, Engine::Reference)?;
    let reference = climb::<f64>(&vehicle, Engine::Reference)?;
    let lanes = climb::<f32>(&vehicle, Engine::Lanes)?;
    println!("dynamic inflow changes the climb by up to {:.2} mm", 1e3 * apart(&without, &reference));
    println!("the reference in f64 and lanes in f32 agree to {:.4} mm", 1e3 * apart(&reference, &lanes));

    // What is out of its bounds is refused as with every other effect.
    let wrong = text.replace("settling_s = 0.08", "settling_s = 0.0");
    if let Err(e) = Vehicle::from_toml("wrong", &wrong) {
        println!("{e}");
    }
    Ok(())
}
