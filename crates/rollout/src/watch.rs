//! What looks at the states of a flight as they come.

/// States of some consecutive worlds after a command.
#[derive(Clone, Copy, Debug)]
pub struct Watched<'a, N> {
    /// Number of the first world.
    pub first_world: usize,
    /// How many worlds.
    pub n_worlds: usize,
    /// After which command, from 0.
    pub t: usize,
    numbers: &'a [N],
    stride: usize,
    width: usize,
}

impl<'a, N> Watched<'a, N> {
    /// Of `n_worlds` from `first_world` on; the states of each, `width` numbers (drone, number of a state), begin `stride` numbers behind those of the one before.
    pub(super) fn new(
        (first_world, n_worlds, t): (usize, usize, usize),
        numbers: &'a [N],
        (stride, width): (usize, usize),
    ) -> Self {
        Self { first_world, n_worlds, t, numbers, stride, width }
    }

    /// States of the drones of world `first_world + i`. (drone, number of a state)
    pub fn world(&self, i: usize) -> &'a [N] {
        &self.numbers[i * self.stride..][..self.width]
    }
}

/// Looks at states as they come, a few worlds at a time and from several threads; each command of a world in order. A world whose numbers stop being numbers is
/// flown once more from its start, and then seen again, up to there as before.
pub trait Watcher<N>: Sync {
    /// Sees some worlds after a command.
    fn look(&self, seen: Watched<N>);
}
