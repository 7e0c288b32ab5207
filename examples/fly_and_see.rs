//! How do I fly a drone through a scene and see what its camera sees?
//!
//! Steps a simulation under a state command, writes the pose into the scene, renders a depth image and asks for
//! contacts and the nearest obstacle. Run it from the folder of the project: `cargo run --example fly_and_see`.

use propwash::physics::rigid_body::State;
use propwash::rollout::trajectory::Trajectory;
use propwash::rollout::{Sim, SimOptions};
use propwash::scene::{Scene, SceneSource, Shell};
use propwash::sense::{Camera, DepthFrame, PixelStatus, Queries};
use propwash::vehicle::Vehicle;

fn main() -> propwash::Result<()> {
    // A vehicle is physics; its shell is what the scene sees and touches of it.
    let vehicle = Vehicle::builtin("cf2x_L250")?;
    let shell = Shell::builtin(&vehicle.shell)?;
    let scene = Scene::build(&SceneSource::file("xml/forest.xml"), &[shell])?;
    let mut worker = scene.worker()?;
    let camera = Camera::on_drone(&scene, 0, "fpv")?.with_size(64, 48)?.with_range(0.05, 20.0)?;

    // One world, one drone, commands of position, velocity, acceleration and heading.
    let mut sim = Sim::new(SimOptions::default(), vec![(vehicle.drone("first_principles")?, vehicle.rates)])?;
    let path =
        Trajectory::Circle { center_m: [0.0, 0.0, 1.0], radius_m: 0.8, phase_rad: 0.0, rate_rad_s: 1.0 };
    sim.set_initial(0, 0, State { pos: path.at(0.0).pos_m, ..State::rest() })?;
    sim.reset(None)?;

    // Two seconds at 500 steps per second.
    for step in 0..1000 {
        sim.set_command(&path.at(f64::from(step) / 500.0).command())?;
        sim.step(1)?;
    }
    let state = sim.data.state(0, 0);
    println!("after {} s: position {:.3?} m, velocity {:.3?} m/s", sim.time_s(0), state.pos, state.vel);

    // The pose goes into the scene; then it is sensed.
    worker.set_drone(0, state.pos, state.quat)?;
    worker.update()?;
    let mut frame = DepthFrame::new();
    camera.render(&mut worker, &mut frame)?;
    let hits = frame.status.iter().filter(|s| **s == PixelStatus::Hit as u8).count();
    let ahead = frame.width * (frame.height / 2) + frame.width / 2;
    println!("depth image: {hits} of {} pixels hit", frame.depth_m.len());
    match usize::try_from(frame.geom_id[ahead]) {
        Ok(geom) => println!("straight ahead: {} at {:.3} m", scene.geom_label(geom), frame.depth_m[ahead]),
        Err(_) => println!("straight ahead: nothing"),
    }

    let near = Queries::at(&mut worker).clearance(0, 5.0)?;
    if near.found {
        let name = scene.geom_label(near.other_geom as usize);
        println!("nearest obstacle: {name}, {:.3} m away at {:.3?} m", near.distance_m, near.on_other_m);
    }
    let mut touching = Vec::new();
    Queries::at(&mut worker).contacts(&mut touching)?;
    println!("contacts: {}", touching.iter().filter(|c| c.touches()).count());
    Ok(())
}
