"""Crazyflow's gradients of flights, for benches/learn.rs.

Usage: python benches/peers/learn.py WORLDS STEPS

The process stays on one core. It builds a simulation of WORLDS worlds with one first-principles cf2x_L250 each under attitude commands,
compiles the gradient of the sum of (z - 1)^2 after STEPS steps of 2 ms by the commands, prints one line of JSON with the versions
and the time until the first gradient, and then answers every line on standard input with one line: median and least seconds of a
gradient, over at least 0.3 s of calls. The clip at the floor is taken out of the pipeline, since its slope is no part of the flight.
"""

import json
import os
import statistics
import sys
import time
import warnings
from importlib import metadata

BEGAN = time.perf_counter()
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("SCIPY_ARRAY_API", "1")  # Crazyflow asks for it
os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
warnings.filterwarnings("ignore")

import jax
import jax.numpy as jnp
import numpy as np
from crazyflow.control import Control
from crazyflow.sim import Sim
from crazyflow.sim.pipeline import remove_fn


def main() -> None:
    worlds, steps = map(int, sys.argv[1:3])
    sim = Sim(n_worlds=worlds, drone="cf2x_L250", control=Control.attitude, freq=500, attitude_freq=500)
    remove_fn(sim.step_pipeline, "clip_floor_pos")
    step = sim.build_step_fn()
    sim.reset()
    start = sim.data
    weight = 9.81 * float(sim.data.params.mass.ravel()[0])
    # Another command for every world, the same as in benches/learn.rs.
    a, b, c, d = (np.sin(np.arange(worlds) * k) for k in (12.9898, 78.233, 37.719, 4.581))
    command = jnp.asarray(np.stack([0.1 * a, 0.1 * b, 0.1 * c, weight * (1 + 0.05 * d)], axis=-1))[:, None]

    def loss(command):
        attitude = start.controls.attitude.replace(staged_cmd=command)
        data = step(start.replace(controls=start.controls.replace(attitude=attitude)), steps)
        return jnp.sum((data.states.pos[:, 0, 2] - 1) ** 2)

    gradient = jax.jit(jax.grad(loss))
    gradient(command).block_until_ready()
    told = {name: metadata.version(name) for name in ("crazyflow", "jax", "jaxlib")}
    print(json.dumps({**told, "first_s": time.perf_counter() - BEGAN}), flush=True)
    for _ in sys.stdin:
        calls, begin = [], time.perf_counter()
        while time.perf_counter() - begin < 0.3 or len(calls) < 3:
            before = time.perf_counter()
            gradient(command).block_until_ready()
            calls.append(time.perf_counter() - before)
        print(json.dumps([statistics.median(calls), min(calls)]), flush=True)


main()
