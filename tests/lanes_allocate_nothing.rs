//! Steps in lanes allocate nothing after the first call. Alone in its program, since it counts all allocations.

#[path = "common/allocations.rs"]
mod allocations;

use allocations::allocations;
use propwash::physics::controllers::ControlMode;
use propwash::rollout::{Engine, Sim, SimOptions};
use propwash::scalar::lanes::Number;
use propwash::vehicle::Vehicle;

fn count<N: Number>(control: ControlMode, dynamics: &str) -> usize {
    let vehicle = Vehicle::builtin("cf2x_L250").unwrap();
    let drone = vehicle.drone(dynamics).unwrap();
    let options = SimOptions { n_worlds: 300, control, engine: Engine::Lanes, ..SimOptions::default() };
    let mut sim = Sim::<N>::storing(options, vec![(drone, vehicle.rates)]).unwrap();
    sim.step(12).unwrap();
    let before = allocations();
    for _ in 0..5 {
        sim.step(12).unwrap();
    }
    allocations() - before
}

#[test]
fn steps_allocate_nothing_after_the_first_call() {
    // On one thread: the queue by which others are called takes memory now and then.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| {
        for control in
            [ControlMode::RotorVel, ControlMode::Attitude, ControlMode::State, ControlMode::BodyRate]
        {
            assert_eq!(count::<f32>(control, "first_principles"), 0, "{control:?}");
            assert_eq!(count::<f64>(control, "first_principles"), 0, "{control:?}");
        }
        assert_eq!(count::<f32>(ControlMode::State, "so_rpy_rotor_drag"), 0);
    });
}
