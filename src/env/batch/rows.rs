//! What every step touches of the worlds, as arrays in their order: a step reads them from end to end, where a heap block of each world
//! would have to be looked up.

use super::world::Plan;

/// Worlds whose rows one thread takes at a time.
pub(super) const ROWS_AT_ONCE: usize = 128;

/// Arrays over worlds.
#[derive(Debug, Default)]
pub(super) struct Rows {
    /// Steps of the environment since the reset. (world)
    pub step: Vec<u64>,
    /// The episode has ended. (world)
    pub ended: Vec<bool>,
    /// An entry of the last action was held within its limits. (world)
    pub clipped: Vec<bool>,
    /// (world, drone, action)
    pub last_action: Vec<f32>,
    /// Actions of the last step and of the one before, −1 to 1, where something may look at them; else empty. (world, drone, action)
    pub acted: [Vec<f32>; 2],
    /// What the task remembers. (world, `memory_stride`)
    pub memory: Vec<f32>,
    /// Numbers that the task remembers of each world.
    pub memory_len: usize,
    /// Numbers from the memory of one world to that of the next, at least one.
    pub memory_stride: usize,
    /// Positions after the last step, and before it, m, where formulas of a task read them. (world, 3)
    pub last_pos: Vec<f32>,
    pub previous_pos: Vec<f32>,
}

impl Rows {
    /// Those of worlds that have not begun, whose task remembers `memory_len` numbers of each.
    pub fn new(plan: &Plan, memory_len: usize) -> Self {
        let (n, d) = (plan.config.sim.options.n_worlds, plan.config.sim.n_drones());
        let kept = if plan.reads_previous { 3 * n } else { 0 };
        Self {
            step: vec![0; n],
            ended: vec![false; n],
            clipped: vec![false; n],
            last_action: vec![0.0; n * d * plan.action_width],
            acted: if plan.reads_actions {
                [0, 1].map(|_| vec![0.0; n * d * plan.action_width])
            } else {
                Default::default()
            },
            memory: vec![0.0; n * memory_len.max(1)],
            memory_len,
            memory_stride: memory_len.max(1),
            last_pos: vec![0.0; kept],
            previous_pos: vec![0.0; kept],
        }
    }

    /// What the task remembers of a world.
    pub fn memory_of(&self, world: usize) -> &[f32] {
        &self.memory[world * self.memory_stride..][..self.memory_len]
    }

    /// The same, to be written.
    pub fn memory_of_mut(&mut self, world: usize) -> &mut [f32] {
        &mut self.memory[world * self.memory_stride..][..self.memory_len]
    }

    /// Forgets the episode before in a world that begins another.
    pub fn begin(&mut self, world: usize) {
        self.step[world] = 0;
        self.ended[world] = false;
        self.clipped[world] = false;
        self.memory_of_mut(world).fill(0.0);
        let each = self.last_action.len() / self.step.len();
        self.last_action[world * each..(world + 1) * each].fill(0.0);
        for kept in &mut self.acted {
            let each = kept.len() / self.step.len();
            kept[world * each..(world + 1) * each].fill(0.0);
        }
    }

    /// The actions of a world, of this step and of the one before.
    pub fn acted_in(acted: &[Vec<f32>; 2], world: usize, n_worlds: usize) -> [&[f32]; 2] {
        [0, 1].map(|k| {
            let each = acted[k].len() / n_worlds;
            &acted[k][world * each..(world + 1) * each]
        })
    }
}
