//! Contacts, clearances and sweeps allocate nothing once a worker has grown. Alone in its program, since it counts all
//! allocations.

#[path = "common/allocations.rs"]
mod allocations;
#[path = "common/scenes.rs"]
mod scenes;

use allocations::allocations;
use propwash::random::{Key, Stream, purpose};
use propwash::scene::{Pose, Shell, Worker};
use propwash::sense::{Queries, Sweep};
use scenes::{build, random_quat};

fn draws() -> Stream {
    Key { seed: 1, world: 0, drone: 0, step: 0, purpose: purpose("test of allocations") }.stream()
}

fn round(worker: &mut Worker, s: &mut Stream, found: &mut Vec<propwash::sense::Contact>) -> usize {
    let n = worker.scene().n_drones();
    let mut total = 0;
    for _ in 0..40 {
        for drone in 0..n {
            worker.set_drone(drone, [0; 3].map(|_| s.uniform(-1.0, 1.0)), random_quat(s)).unwrap();
        }
        worker.set_obstacle(0, [0; 3].map(|_| s.uniform(-1.0, 1.0)), random_quat(s)).unwrap();
        worker.update().unwrap();
        Queries::at(worker).contacts(found).unwrap();
        total += found.len();
        for drone in 0..n {
            Queries::at(worker).clearance(drone, 2.0).unwrap();
        }
        let pose = |s: &mut Stream| Pose::new([0; 3].map(|_| s.uniform(-1.0, 1.0)), random_quat(s));
        let (from, to) = (pose(s), pose(s));
        Queries::at(worker).swept(&Sweep::new(0, from, to)).unwrap();
    }
    total
}

#[test]
fn queries_allocate_nothing_after_the_first_calls() {
    let heights = "0.1 0.5 0.9 0.3 ".repeat(9);
    let xml = format!(
        "<mujoco><asset><hfield name='h' nrow='6' ncol='6' size='1 1 0.5 0.1' elevation='{heights}'/>\
         <mesh name='s' builtin='supertorus' params='20 0.4 1 1' scale='0.4 0.4 0.4'/></asset><worldbody>\
         <geom type='plane' size='0 0 1' pos='0 0 -1'/><geom type='hfield' hfield='h'/>\
         <geom type='mesh' mesh='s' pos='0.5 0 0.8'/><geom type='box' size='0.2 0.2 0.2' pos='-0.5 0 0.7'/>\
         <geom type='ellipsoid' size='0.2 0.3 0.1' pos='0 -0.6 0.7'/>\
         <body mocap='true'><geom type='cylinder' size='0.2 0.3'/></body></worldbody></mujoco>"
    );
    let ball = Shell {
        name: "ball".into(),
        xml: "<mujoco><worldbody><body name='drone'><geom type='sphere' size='0.1'/></body></worldbody></mujoco>".into(),
        dir: None,
    };
    let mut shells = vec![ball; 12];
    shells[3] = Shell::builtin("cf2x").unwrap();
    shells[7] = Shell::builtin("hb_x500").unwrap();
    let scene = build(&xml, &shells);
    let mut worker = scene.worker().unwrap();
    let mut found = Vec::new();
    assert!(round(&mut worker, &mut draws(), &mut found) > 100);
    let before = allocations();
    round(&mut worker, &mut draws(), &mut found);
    assert_eq!(allocations() - before, 0);
}
