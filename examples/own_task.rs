//! How do I ask drones for something that no built-in task asks?
//!
//! A ball swings through the place that a drone holds. The task gives a reward for staying near, ends an episode when the ball hits, and
//! observes where the ball is. Two policies fly it in 32 worlds: one holds the place whatever comes, one gives way.
//! `cargo run --example own_task`

use std::sync::Arc;

use propwash::arena::SceneConfig;
use propwash::env::{
    ActionConfig, ActionKind, Channel, Ending, Env, EnvConfig, EnvError, EpisodeStart, Obstacles, Outcome,
    Start, Task, WorldView,
};

/// The place to hold, m, and the ball, which the scene puts far aside until the first step.
const PLACE_M: [f64; 3] = [0.0, 0.0, 1.0];
const SCENE: &str = "<mujoco><worldbody><geom type='plane' size='0 0 1'/>\
    <body name='ball' mocap='true' pos='0 9 1'><geom type='sphere' size='0.15'/></body></worldbody></mujoco>";

/// Hold a place through which a ball swings along y.
struct Dodge {
    /// Swings per second.
    swings_hz: f64,
    /// How far the ball swings to either side, m.
    reach_m: f64,
}

/// What is remembered of each world: where in its swing the ball begins, and where it is along y.
const PHASE: usize = 0;
const BALL_Y: usize = 1;

impl Task for Dodge {
    fn name(&self) -> &str {
        "dodge"
    }

    fn scene(&self) -> (SceneConfig, Option<usize>) {
        (SceneConfig::Xml(SCENE.into()), None)
    }

    fn channels(&self) -> Vec<Channel> {
        vec![Channel::new("ball", 3)]
    }

    fn memory_len(&self, _n_drones: usize) -> usize {
        2
    }

    fn begin(&self, start: &mut EpisodeStart) -> Result<(), EnvError> {
        start.memory[PHASE] = start.draw.uniform(0.0, std::f64::consts::TAU) as f32;
        start.memory[BALL_Y] = 9.0;
        start.starts[0] = Start::at(PLACE_M);
        Ok(())
    }

    fn move_obstacles(&self, memory: &mut [f32], time_s: f64, obstacles: &mut Obstacles) {
        let angle = f64::from(memory[PHASE]) + std::f64::consts::TAU * self.swings_hz * time_s;
        let y = self.reach_m * angle.cos();
        // It comes in from afar during the first four seconds.
        let y = y + (4.0 - time_s).max(0.0);
        obstacles.pos_m[0] = [PLACE_M[0], y, PLACE_M[2]];
        memory[BALL_Y] = y as f32;
    }

    fn judge(&self, view: &WorldView, _memory: &mut [f32], reward: &mut [f32]) -> Outcome {
        let drone = &view.drones[0];
        if drone.crashed {
            reward[0] = -10.0;
            return Outcome::Crashed;
        }
        let off = (0..3).map(|k| (drone.pos_m[k] - PLACE_M[k]).powi(2)).sum::<f64>().sqrt();
        reward[0] = (-off).exp() as f32;
        Outcome::Continue
    }

    fn observe(&self, view: &WorldView, memory: &[f32], drone: usize, out: &mut [f32]) {
        let at = view.drones[drone].pos_m;
        let ball = [PLACE_M[0], f64::from(memory[BALL_Y]), PLACE_M[2]];
        (0..3).for_each(|k| out[k] = (ball[k] - at[k]) as f32);
    }
}

/// Part of the worlds whose episode a hit ended within 12 s, and the mean sum of rewards of an episode.
fn fly(policy: impl Fn(&[f32]) -> [f32; 4]) -> propwash::Result<(f64, f64)> {
    let mut config = EnvConfig {
        step_hz: 25,
        max_episode_s: 12.0,
        action: ActionConfig { kind: ActionKind::Velocity, ..ActionConfig::default() },
        ..EnvConfig::default()
    };
    config.sim.options.n_worlds = 32;
    let mut env = Env::with_task(config, Arc::new(Dodge { swings_hz: 0.1, reach_m: 3.0 }))?;
    env.reset(Some(1), None)?;
    let width: usize = env.channels().iter().map(|c| c.width).sum();
    let (mut hit, mut ended, mut total) = ([false; 32], [false; 32], 0.0);
    for _ in 0..300 {
        let actions: Vec<f32> = env.observation().chunks_exact(width).flat_map(&policy).collect();
        env.step(&actions)?;
        for world in 0..32 {
            let ending = env.ending()[world];
            if !ended[world] {
                total += f64::from(env.reward()[world]);
                hit[world] = ending == Ending::Crashed as u8;
                ended[world] = ending != Ending::None as u8;
            }
        }
    }
    let hits = hit.iter().filter(|hit| **hit).count();
    Ok((hits as f64 / 32.0, total / 32.0))
}

fn main() -> propwash::Result<()> {
    // Actions are velocities: forward, left, up, turn. The ball is observed after pos, quat, vel and ang_vel: 13 numbers.
    let (hits, total) = fly(|_| [0.0; 4])?;
    println!("holds its place: hit in {:.0} % of the worlds, sum of rewards {total:.0}", 100.0 * hits);
    let (hits, total) = fly(|seen| {
        let (x, vel_x, ball_y) = (seen[0], seen[7], seen[14]);
        // Half a metre forward while the ball is near, else back to the place.
        let wanted = if ball_y.abs() < 2.1 { 0.5 } else { 0.0 };
        [(0.7 * (wanted - x) - 0.3 * vel_x).clamp(-1.0, 1.0), 0.0, 0.0, 0.0]
    })?;
    println!("gives way: hit in {:.0} % of the worlds, sum of rewards {total:.0}", 100.0 * hits);
    Ok(())
}
