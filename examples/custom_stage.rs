//! How do I add physics of my own to a step, and give each world its own parameters?
//!
//! A gust becomes a stage of the pipeline; four worlds fly it with four masses.
//! `cargo run --example custom_stage`

use propwash::physics::controllers::ControlMode;
use propwash::rollout::pipeline::INTEGRATION;
use propwash::rollout::trajectory::Reference;
use propwash::rollout::{Sim, SimOptions};
use propwash::vehicle::Vehicle;

/// Time and force of the gust: from 1 s to 1.5 s, 50 mN along y.
const GUST_S: std::ops::Range<f64> = 1.0..1.5;
const GUST_N: f64 = 0.05;

fn main() -> propwash::Result<()> {
    let vehicle = Vehicle::builtin("cf2x_L250")?;
    let options = SimOptions { n_worlds: 4, control: ControlMode::State, ..SimOptions::default() };
    let mut sim = Sim::new(options, vec![(vehicle.drone("first_principles")?, vehicle.rates)])?;

    // Any parameter by its name, in one world or (with None) in all.
    let nominal_kg = sim.drone(0, 0).body.mass_kg;
    for world in 0..4 {
        sim.set_parameter(Some(world), 0, "body.mass_kg", nominal_kg * (1.0 + 0.1 * world as f64))?;
    }

    // Stages read and write the arrays of all worlds, shape (world, drone, n), between the built-in stages.
    sim.pipeline.insert_before(
        INTEGRATION,
        "gust",
        Box::new(|data| {
            for world in 0..data.n_worlds {
                let row = data.row(world, 0);
                let blows = GUST_S.contains(&data.time_s(world));
                data.disturbance_force[3 * row + 1] = if blows { GUST_N } else { 0.0 };
            }
        }),
    )?;
    println!("stages of a step: {}", sim.pipeline.names().join(", "));

    // Hover at the origin, facing along x.
    sim.reset(None)?;
    let hover = Reference::hover([0.0; 3], 0.0).command();
    sim.set_command(&hover.repeat(4))?;
    let mut aside_m = [0.0f64; 4];
    for _ in 0..1500 {
        sim.step(1)?;
        for (world, worst) in aside_m.iter_mut().enumerate() {
            *worst = worst.max(sim.data.state(world, 0).pos[1].abs());
        }
    }
    for (world, aside) in aside_m.iter().enumerate() {
        let mass = sim.drone(world, 0).body.mass_kg;
        println!("world {world}: {:.1} g, blown {:.2} cm aside", 1e3 * mass, 1e2 * aside);
    }
    Ok(())
}
