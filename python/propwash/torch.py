"""Flights as functions of PyTorch, with gradients: ``import propwash.torch``."""

from __future__ import annotations

from typing import Any, Mapping

import numpy as np

from ._flight import Flight
from ._optional import need
from .sim import Sim

torch = need("torch", "torch", "propwash.torch")


class _Rollout(torch.autograd.Function):  # type: ignore[misc, name-defined, unused-ignore]
    @staticmethod
    def forward(ctx: Any, flight: Flight, *inputs: Any) -> Any:
        ctx.tape, ctx.flight, ctx.like = None, flight, inputs
        ctx.tape = flight.record([None if x is None else x.detach().cpu().numpy() for x in inputs])
        states = torch.from_numpy(np.array(ctx.tape.states.numbers))
        return states.to(device=inputs[0].device)

    @staticmethod
    @torch.autograd.function.once_differentiable  # type: ignore[untyped-decorator, unused-ignore]
    def backward(ctx: Any, seeds: Any) -> Any:
        gains = ctx.flight.pull_back(ctx.tape, seeds.detach().cpu().numpy())
        wanted = zip(gains, ctx.like, ctx.needs_input_grad[1:])
        return None, *(
            torch.from_numpy(gain).to(device=x.device, dtype=x.dtype) if x is not None and needed else None for gain, x, needed in wanted
        )


def rollout(
    sim: Sim,
    commands: Any,
    *,
    state: Any = None,
    wind: Any = None,
    parameters: Mapping[str, Any] | None = None,
    substeps: int = 1,
    advance: bool = False,
) -> Any:
    """States after each command of a flight, as a tensor through which gradients flow back to commands, state, wind and parameters.

    Args:
        sim: What flies. It is as it was afterwards, unless ``advance`` is true: then it stands where the flight ended.
        commands: (n_worlds, n_times, n_drones, command_width)
        state: States to start from, (n_worlds, n_drones, state_width), in the order of ``propwash.States.numbers``; those of ``sim`` where it
            is None. What on-board controllers and effects remember is that of ``sim``; no gradient flows through it from one call to
            another.
        wind: Velocity of the air, m/s, world. (n_worlds, n_drones, 3)
        parameters: Parameters by name, each one number for all worlds, or (n_worlds,).
        substeps: Steps under each command.
        advance: Whether ``sim`` stands at the end of the flight afterwards.

    Returns:
        (n_worlds, n_times, n_drones, state_width), of the precision of ``sim``.

    ``torch.autograd.gradcheck`` holds for a ``Sim`` in f64. There are no gradients of gradients.
    """
    names = list(parameters or {})
    values = [torch.as_tensor(v) for v in (parameters or {}).values()]
    flight = Flight(sim, names, substeps, advance)
    optional = [None if x is None else torch.as_tensor(x) for x in (state, wind)]
    return _Rollout.apply(flight, torch.as_tensor(commands), *optional, *values)
