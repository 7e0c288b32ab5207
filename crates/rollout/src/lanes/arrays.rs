//! The public arrays of some worlds, and where in them each number of a drone stands.

use super::super::SimData;
use super::super::quarantine::Quarantine;
use super::super::traced::place;
use super::Extra;

/// Place of the memory of effects among the arrays that steps change, the last of them.
pub(super) const EFFECT_MEMORY: usize = 9;

/// Numbers of every drone that stand side by side in a public array and in the home.
#[derive(Clone, Copy, Debug)]
pub(super) struct Columns {
    /// Place of the first.
    pub(super) place: usize,
    /// Of [`View::out`], or from the tenth on of [`Shared::read`].
    pub(super) array: usize,
    pub(super) width: usize,
    /// The first, and how many there are.
    pub(super) col: usize,
    pub(super) n: usize,
}

/// The arrays of some consecutive worlds.
pub(super) struct View<'a, N> {
    /// Index of the first world.
    pub(super) first: usize,
    pub(super) n_worlds: usize,
    pub(super) n_drones: usize,
    /// Numbers of effects per world.
    pub(super) n_effects: usize,
    /// What steps change, and its widths: see [`Arrays`].
    pub(super) out: [&'a mut [N]; 10],
    pub(super) written: [usize; 9],
    pub(super) steps: &'a mut [u64],
    pub(super) quarantine: &'a mut [Option<Box<Quarantine>>],
    /// Further arrays that are written, with the numbers of a world in each.
    pub(super) extra: Extra<'a, N>,
}

/// How the public arrays hold the numbers of a drone.
#[derive(Debug, Default)]
pub(super) struct Arrays {
    /// Widths of the arrays that steps change: position, attitude, velocity, angular velocity, rotor speeds, thrust, memory of
    /// the controllers, rotor command, attitude command. The tenth is the memory of effects.
    pub(super) written: [usize; 9],
    /// Array, width and column of every place before [`place::EFFECTS`]. Arrays from the tenth on are only read: command,
    /// disturbing force and torque, wind, ground, ceiling.
    pub(super) columns: Vec<Option<(usize, usize, usize)>>,
}

impl Arrays {
    pub(super) fn of<N>(data: &SimData<N>) -> Self {
        let (rotors, memory) = (data.n_rotors, data.memory_columns.len());
        let written = [3, 4, 3, 3, rotors, 1, memory, rotors, 4];
        let firsts = [
            place::STATE,
            place::QUAT,
            place::VEL,
            place::ANG_VEL,
            place::ROTOR_VEL,
            place::THRUST,
            place::MEMORY,
            place::ROTOR_COMMAND,
            place::ATTITUDE_COMMAND,
        ];
        let read = [
            (place::COMMAND, data.command_width),
            (place::FORCE, 3),
            (place::TORQUE, 3),
            (place::WIND, 3),
            (place::GROUND, 1),
            (place::CEILING, 1),
        ];
        let mut columns = vec![None; place::EFFECTS as usize];
        let all = firsts.into_iter().zip(written).chain(read);
        for (i, (first, width)) in all.enumerate() {
            // Written arrays are followed by the memory of effects.
            let array = if i < written.len() { i } else { i + 1 };
            for col in 0..width {
                let within = if first == place::MEMORY { data.memory_columns[col] } else { col };
                columns[first as usize + within] = Some((array, width, col));
            }
        }
        Self { written, columns }
    }
}

impl<'a, N> View<'a, N> {
    /// The first worlds and the rest.
    pub(super) fn split(self, worlds: usize) -> (Self, Self) {
        let (mut low, mut high): ([&mut [N]; 10], [&mut [N]; 10]) = Default::default();
        for (i, array) in self.out.into_iter().enumerate() {
            let width = self.written.get(i).map_or(self.n_effects, |width| width * self.n_drones);
            (low[i], high[i]) = array.split_at_mut(worlds * width);
        }
        let (steps, more_steps) = self.steps.split_at_mut(worlds);
        let (quarantine, more_quarantine) = self.quarantine.split_at_mut(worlds);
        let (extra, more_extra) = self
            .extra
            .into_iter()
            .map(|(array, per_world)| {
                let (low, high) = array.split_at_mut(worlds * per_world);
                ((low, per_world), (high, per_world))
            })
            .unzip();
        let (n_drones, n_effects, written) = (self.n_drones, self.n_effects, self.written);
        (
            View {
                first: self.first,
                n_worlds: worlds,
                n_drones,
                n_effects,
                out: low,
                written,
                steps,
                quarantine,
                extra,
            },
            View {
                first: self.first + worlds,
                n_worlds: self.n_worlds - worlds,
                n_drones,
                n_effects,
                out: high,
                written,
                steps: more_steps,
                quarantine: more_quarantine,
                extra: more_extra,
            },
        )
    }
}

/// Where places stand in the public arrays, neighbours as one, also where up to `gap` numbers between them are not asked for; nowhere
/// for time, random numbers, other drones and what the mode does not use.
pub(super) fn columns(arrays: &Arrays, mut places: Vec<u32>, n_effects: usize, gap: usize) -> Vec<Columns> {
    places.sort_unstable();
    places.dedup();
    let mut all: Vec<Columns> = Vec::new();
    for p in places {
        let at = if p >= place::EFFECTS {
            let col = (p - place::EFFECTS) as usize;
            (col < n_effects).then_some((EFFECT_MEMORY, 0, col))
        } else {
            arrays.columns[p as usize]
        };
        let Some((array, width, col)) = at else { continue };
        match all.last_mut() {
            Some(c)
                if c.array == array
                    && p as usize - c.place == col.wrapping_sub(c.col)
                    && p as usize - c.place <= c.n + gap =>
            {
                c.n = p as usize - c.place + 1;
            }
            _ => all.push(Columns { place: p as usize, array, width, col, n: 1 }),
        }
    }
    all
}
