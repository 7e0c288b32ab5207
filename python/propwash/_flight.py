"""A flight as a function of commands, start, wind and parameters: what the bridges to PyTorch and JAX call."""

from __future__ import annotations

from typing import Any, Sequence

import numpy as np

from .sim import Sim
from .tape import States, Tape


class Flight:
    """The flight of a ``Sim`` from where it is; inputs are commands, state, wind and then parameters, each may be None."""

    def __init__(self, sim: Sim, names: Sequence[str], substeps: int, advance: bool) -> None:
        self.sim, self.names, self.substeps, self.advance = sim, list(names), substeps, advance
        self.shapes: list[tuple[int, ...]] = []

    def record(self, inputs: Sequence[Any]) -> Tape:
        """Flies it."""
        sim = self.sim
        commands, state, wind, *values = inputs
        kept = sim.save()
        self.shapes = [np.shape(v) for v in values]
        for name, value in zip(self.names, values):
            if np.shape(value) not in ((), (sim.n_worlds,)):
                raise ValueError(f"parameter {name}: expected one number, or shape ({sim.n_worlds},), got shape {np.shape(value)}")
        done = False
        try:
            for name, value in zip(self.names, values):
                sim.set_parameter(name, value)
            if wind is not None:
                sim.data.wind[...] = wind
            if state is not None:
                sim.states = States(np.asarray(state))
            tape = sim.record(commands, self.substeps)
            done = True
        finally:
            if not (done and self.advance):
                sim.restore(kept)
        return tape

    def pull_back(self, tape: Tape, seeds: Any) -> list[Any]:
        """What a loss gains by each input."""
        gradient = tape.pull_back(seeds, self.names)
        out: list[Any] = [gradient.commands, gradient.state.numbers, gradient.wind]
        for name, shape in zip(self.names, self.shapes):
            gain = gradient.parameters[name].sum(axis=1)
            out.append(gain if shape else np.asarray(gain.sum()))
        return out
