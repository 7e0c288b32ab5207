"""Flights as functions of JAX, with gradients: ``import propwash.jax``."""

from __future__ import annotations

from typing import Any, Mapping

import numpy as np

from ._flight import Flight
from ._optional import need
from .sim import Sim

jax = need("jax", "jax", "propwash.jax")


def rollout(
    sim: Sim,
    commands: Any,
    *,
    state: Any = None,
    wind: Any = None,
    parameters: Mapping[str, Any] | None = None,
    substeps: int = 1,
) -> Any:
    """States after each command of a flight, as an array of JAX through which gradients flow back to commands, state, wind and parameters;
    it can be jitted.

    Args:
        sim: What flies. It is called back from JAX on the processor, at the time when the result is computed, and is as it was
            afterwards: leave it alone between.
        commands: (n_worlds, n_times, n_drones, command_width)
        state: States to start from, (n_worlds, n_drones, state_width), in the order of ``propwash.States.numbers``; those of ``sim`` where it
            is None.
        wind: Velocity of the air, m/s, world. (n_worlds, n_drones, 3)
        parameters: Parameters by name, each one number for all worlds, or (n_worlds,).
        substeps: Steps under each command.

    Returns:
        (n_worlds, n_times, n_drones, state_width), of the precision of ``sim``, or single precision where JAX has no other enabled.

    Gradients are reverse-mode (``jax.grad``, ``jax.vjp``, ``jax.jacrev``), once; backwards the flight is flown again.
    """
    flight = Flight(sim, list(parameters or {}), substeps, False)
    given = {"commands": commands, "state": state, "wind": wind, **{f"parameter {k}": v for k, v in (parameters or {}).items()}}
    inputs = tuple(jax.numpy.asarray(v) for v in given.values() if v is not None)
    here = [v is not None for v in given.values()]

    def spread(arrays: tuple[Any, ...]) -> list[Any]:
        rest = iter(arrays)
        return [np.asarray(next(rest)) if there else None for there in here]

    dtype = jax.dtypes.canonicalize_dtype(np.dtype(sim.precision.replace("f", "float")))
    worlds, times, drones = inputs[0].shape[:3]
    shape = jax.ShapeDtypeStruct((worlds, times, drones, sim.states.numbers.shape[-1]), dtype)

    def fly(*arrays: Any) -> Any:
        return np.asarray(flight.record(spread(arrays)).states.numbers, dtype)

    def undo(seeds: Any, *arrays: Any) -> tuple[Any, ...]:
        numbers = spread(arrays)
        gains = flight.pull_back(flight.record(numbers), np.asarray(seeds))
        return tuple(np.asarray(g, x.dtype) for g, x in zip(gains, numbers) if x is not None)

    def states(*arrays: Any) -> Any:
        return jax.pure_callback(fly, shape, *arrays)

    def forward(*arrays: Any) -> tuple[Any, tuple[Any, ...]]:
        return states(*arrays), arrays

    def backward(arrays: tuple[Any, ...], seeds: Any) -> Any:
        like = tuple(jax.ShapeDtypeStruct(x.shape, x.dtype) for x in arrays)
        return jax.pure_callback(undo, like, seeds, *arrays)

    of = jax.custom_vjp(states)
    of.defvjp(forward, backward)
    return of(*inputs)
