//! Flights that a pilot commands, and the same backwards.

use super::super::arrays::View;
use super::super::pack::{Pack, Pool, Steps};
use super::super::{Scratch, Shared};
use super::{Piece, Sequence};
use crate::pilot::{Commander, Pilot, Place};
use crate::traced::place;
use propwash_trace::Real;
use propwash_trace::bytecode::Interpret;
use propwash_trace::lanes::{Cell, Number};

/// Appends the numbers of a state, one cell each, of the cells of a home that begin with them.
fn add_state<C: Copy>(buffer: &mut Vec<C>, file: &[C], from: usize, width: usize) {
    buffer.extend_from_slice(&file[from..from + width - 1]);
    buffer.push(file[from + place::THRUST as usize]);
}

impl<N: Number> Shared<'_, N> {
    /// A flight that a pilot commands, and the same backwards. Where numbers stop being numbers nothing is written back.
    pub(in super::super) fn piloted(
        &self,
        mut view: View<N>,
        scratch: &mut Scratch<N>,
        seq: &Sequence<N>,
        pilot: &dyn Pilot<N>,
    ) {
        self.load(&view, scratch, true);
        scratch.one.begin_undo(self);
        let width = crate::tape::state_width(view.written[4]);
        let mut buffer: Vec<N::Cell> = Vec::new();
        for (number, group) in seq.groups.iter().enumerate() {
            scratch.mark(seq.groups.len(), None);
            let last = number + 1 == seq.groups.len();
            for piece in &seq.pieces[group.clone()] {
                self.pilot_forwards(&view, scratch, (seq, *piece), (pilot, width, last), &mut buffer);
            }
        }
        self.keep_finite(&mut view, scratch, seq, pilot);
        for (number, group) in seq.groups.iter().enumerate().rev() {
            let last = number + 1 == seq.groups.len();
            if !last {
                scratch.mark(seq.groups.len(), Some(number));
                for piece in &seq.pieces[group.clone()] {
                    self.pilot_forwards(&view, scratch, (seq, *piece), (pilot, width, true), &mut buffer);
                }
            }
            let mut steps: usize = seq.pieces[group.clone()].iter().map(|piece| piece.n).sum();
            for piece in seq.pieces[group.clone()].iter().rev() {
                steps -= piece.n;
                let pool = &mut scratch.one;
                if piece.from + piece.n == seq.substeps {
                    pool.pilot_seed(self, &view, (pilot, piece.t), width, &mut buffer);
                }
                pool.undo(self, &view, (seq, *piece), steps);
                if piece.from == 0 {
                    pool.pilot_back(self, &view, (pilot, piece.t), (width, seq.width), &mut buffer);
                }
            }
        }
    }

    /// A flight whose commands are given as it goes.
    pub(in super::super) fn commanded(
        &self,
        mut view: View<N>,
        scratch: &mut Scratch<N>,
        seq: &Sequence<N>,
        commander: &dyn Commander<N>,
    ) {
        self.load(&view, scratch, true);
        let width = crate::tape::state_width(view.written[4]);
        let mut buffer: Vec<N::Cell> = Vec::new();
        for t in 0..seq.times {
            for pack in &mut scratch.one.packs[..scratch.one.used] {
                pack.ask(&view, (commander, t), (width, seq.width), &mut buffer);
            }
            self.steps(&view, scratch, Steps::under(t, seq.times, seq.substeps));
            scratch.one.show_states(&view, (commander, t), width, &mut buffer);
        }
        self.keep_finite(&mut view, scratch, seq, commander);
    }

    /// Writes back the worlds at the end of a flight, but for blocks that did not stay finite.
    fn keep_finite(
        &self,
        view: &mut View<N>,
        scratch: &Scratch<N>,
        seq: &Sequence<N>,
        commander: &dyn Commander<N>,
    ) {
        let packs = &scratch.one.packs[..scratch.one.used];
        let lost: Vec<bool> = packs.iter().map(|pack| !pack.finite(self.level)).collect();
        for (pack, lost) in packs.iter().zip(&lost) {
            if *lost {
                commander.lost(Place::of(pack, view, 0));
            } else {
                pack.store(self, view);
            }
        }
        for w in 0..view.n_worlds {
            let pack = w / <N::Cell as Cell>::LANES;
            if view.quarantine[w].is_none() && !lost.get(pack).is_some_and(|lost| *lost) {
                view.steps[w] += (seq.times * seq.substeps) as u64;
            }
        }
    }

    /// One piece forwards, commanded by a pilot; `kept` where it is to be undone.
    fn pilot_forwards(
        &self,
        view: &View<N>,
        scratch: &mut Scratch<N>,
        (seq, piece): (&Sequence<N>, Piece),
        (pilot, width, kept): (&dyn Pilot<N>, usize, bool),
        buffer: &mut Vec<N::Cell>,
    ) {
        let (pool, zero) = (&mut scratch.one, <N::Cell as Cell>::splat(N::zero()));
        if piece.from == 0 {
            for (pack, undo) in pool.packs[..pool.used].iter_mut().zip(&mut pool.undo) {
                let to = pack.ask(view, (pilot, piece.t), (width, seq.width), buffer);
                undo.commands.resize(seq.times * seq.width, zero);
                undo.commands[piece.t * seq.width..(piece.t + 1) * seq.width].copy_from_slice(to);
            }
        }
        self.forwards(view, scratch, (seq, piece), kept);
        if piece.from + piece.n == seq.substeps {
            scratch.one.show_states(view, (pilot, piece.t), width, buffer);
        }
    }
}

impl<C: Interpret> Pack<C> {
    /// Asks for the command for its states, puts it into place and returns it.
    fn ask<'a>(
        &mut self,
        view: &View<C::Number>,
        (commander, t): (&dyn Commander<C::Number>, usize),
        (width, command): (usize, usize),
        buffer: &'a mut Vec<C>,
    ) -> &'a [C]
    where
        C::Number: Number<Cell = C>,
    {
        buffer.clear();
        add_state(buffer, &self.file, place::STATE as usize, width);
        buffer.resize(width + command, C::splat(C::Number::zero()));
        let (state, to) = buffer.split_at_mut(width);
        commander.command(Place::of(self, view, t), state, to);
        self.file[place::COMMAND as usize..place::COMMAND as usize + command].copy_from_slice(to);
        to
    }
}

impl Place {
    fn of<C: Interpret>(pack: &Pack<C>, view: &View<C::Number>, t: usize) -> Self {
        Self { first_world: view.first + pack.rows[0] as usize, n_worlds: pack.n, t }
    }
}

impl<C: Interpret> Pool<C> {
    /// Shows the states after command `t`.
    fn show_states(
        &self,
        view: &View<C::Number>,
        (commander, t): (&dyn Commander<C::Number>, usize),
        width: usize,
        buffer: &mut Vec<C>,
    ) where
        C::Number: Number<Cell = C>,
    {
        for pack in &self.packs[..self.used] {
            buffer.clear();
            add_state(buffer, &pack.file, place::STATE as usize, width);
            commander.look(Place::of(pack, view, t), buffer);
        }
    }

    /// Adds what the loss gains by the states after command `t`.
    fn pilot_seed(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        (pilot, t): (&dyn Pilot<C::Number>, usize),
        width: usize,
        buffer: &mut Vec<C>,
    ) where
        C::Number: Number<Cell = C>,
    {
        for (undo, _, back) in self.undone(shared) {
            let pack = &mut undo.pack;
            let first = back.layout.by(place::STATE) as usize;
            buffer.clear();
            add_state(buffer, &pack.file, first, width);
            pilot.seed(Place::of(pack, view, t), buffer);
            pack.file[first..first + width - 1].copy_from_slice(&buffer[..width - 1]);
            pack.file[first + place::THRUST as usize] = buffer[width - 1];
        }
    }

    /// Lets the pilot take what the loss gains by command `t` to what it gains by the state for which it was given.
    fn pilot_back(
        &mut self,
        shared: &Shared<C::Number>,
        view: &View<C::Number>,
        (pilot, t): (&dyn Pilot<C::Number>, usize),
        (width, command): (usize, usize),
        buffer: &mut Vec<C>,
    ) where
        C::Number: Number<Cell = C>,
    {
        for (undo, _, back) in self.undone(shared) {
            let pack = &mut undo.pack;
            let (first, commands) =
                (back.layout.by(place::STATE) as usize, back.layout.by(place::COMMAND) as usize);
            buffer.clear();
            add_state(buffer, &pack.file, first, width);
            buffer.extend_from_slice(&pack.file[commands..commands + command]);
            let (state, by_command) = buffer.split_at_mut(width);
            pilot.pull_back(Place::of(pack, view, t), by_command, state);
            pack.file[first..first + width - 1].copy_from_slice(&state[..width - 1]);
            pack.file[first + place::THRUST as usize] = state[width - 1];
            pack.clear(commands..commands + command);
        }
    }
}
