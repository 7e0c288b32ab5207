"""Crazyflow's steps per second, for benches/steps.rs.

Usage: python benches/peers/steps.py MODE WORLDS STEPS

MODE is rotor_vel, attitude or state. The process stays on one core. It builds a simulation of WORLDS worlds with one
first-principles cf2x_L250 each, compiles a call of STEPS steps, prints one line of JSON with the versions, and then answers
every line on standard input with one line: median and least seconds of a call, over at least 0.3 s of calls. Single precision
unless JAX_ENABLE_X64=1 is set.
"""

import json
import os
import statistics
import sys
import time
import warnings
from importlib import metadata

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("SCIPY_ARRAY_API", "1")  # Crazyflow asks for it
os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
warnings.filterwarnings("ignore")

import jax
import jax.numpy as jnp
from crazyflow.sim import Sim


def main() -> None:
    mode, worlds, steps = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    sim = Sim(n_worlds=worlds, n_drones=1, drone="cf2x_L250", dynamics="first_principles", control=mode)
    if mode == "state":
        command = [0.0, 0.0, 0.5] + [0.0] * 9 + [1.0, 0.0, 0.0, 0.0]
        sim.state_control(jnp.broadcast_to(jnp.array(command), (worlds, 1, 16)))
    elif mode == "attitude":
        weight = 9.81 * float(sim.data.params.mass.ravel()[0])
        sim.attitude_control(jnp.broadcast_to(jnp.array([0.0, 0.0, 0.0, weight]), (worlds, 1, 4)))
    else:
        sim.rotor_vel_control(jnp.broadcast_to(jnp.array([15000.0] * 4), (worlds, 1, 4)))
    sim.step(steps)
    jax.block_until_ready(sim.data)
    names = ("crazyflow", "jax", "jaxlib")
    print(json.dumps({name: metadata.version(name) for name in names}), flush=True)
    for _ in sys.stdin:
        calls, begin = [], time.perf_counter()
        while time.perf_counter() - begin < 0.3 or len(calls) < 3:
            start = time.perf_counter()
            sim.step(steps)
            jax.block_until_ready(sim.data)
            calls.append(time.perf_counter() - start)
        print(json.dumps([statistics.median(calls), min(calls)]), flush=True)


main()
