//! How do I randomise vehicles and starts between worlds, so that every run can be repeated?
//!
//! Draws are a function of (seed, world, drone, episode, name of the number) and of nothing else: two runs are equal bit
//! for bit, and world 5 of a large run is world 5 of any other run with the same seed.
//! `cargo run --example randomize`

use propwash::physics::controllers::ControlMode;
use propwash::rollout::randomize::Randomization;
use propwash::rollout::trajectory::Reference;
use propwash::rollout::{Sim, SimData, SimOptions};
use propwash::vehicle::Vehicle;

/// The same text can be given to `propwash fly --randomize FILE`.
const RULES: &str = r#"
[[rule]]
parameter = "body.mass_kg"
draw = { scale = [0.9, 1.1] }

[[rule]]
parameter = "rotors.*.thrust_curve.2"
draw = { scale = [0.95, 1.05] }

[[rule]]
parameter = "initial.pos.*"
draw = { normal = 0.1 }
"#;

/// One second of hovering in `n_worlds` worlds, the first of them numbered `first_world`.
fn run(first_world: u64, n_worlds: usize) -> propwash::Result<(Vec<f64>, SimData)> {
    let vehicle = Vehicle::builtin("cf2x_L250")?;
    let options = SimOptions {
        n_worlds,
        first_world,
        seed: 42,
        control: ControlMode::State,
        randomization: Randomization::from_toml(RULES)?,
        ..SimOptions::default()
    };
    let mut sim = Sim::new(options, vec![(vehicle.drone("first_principles")?, vehicle.rates)])?;
    let hover = Reference::hover([0.0; 3], 0.0).command();
    sim.set_command(&hover.repeat(n_worlds))?;
    sim.step(500)?;
    let masses = (0..n_worlds).map(|w| sim.drone(w, 0).body.mass_kg).collect();
    Ok((masses, sim.data.clone()))
}

fn main() -> propwash::Result<()> {
    let (masses, first) = run(0, 8)?;
    for (world, mass) in masses.iter().enumerate() {
        let at = first.state(world, 0).pos;
        println!("world {world}: {:.2} g, after 1 s at {at:.4?} m", 1e3 * mass);
    }
    let (again, second) = run(0, 8)?;
    println!("the same run again is equal, bit for bit: {}", masses == again && first == second);
    let (single, alone) = run(5, 1)?;
    let same = single[0] == masses[5] && alone.state(0, 0) == first.state(5, 0);
    println!("world 5 flown alone is the same world 5: {same}");
    Ok(())
}
