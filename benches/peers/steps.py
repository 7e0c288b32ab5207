"""Crazyflow's steps per second, for benches/steps.rs.

Usage: python benches/peers/steps.py MODE WORLDS STEPS DRONES

MODE is rotor_vel, attitude or state. The process stays on one core, unless PROPWASH_CORES=all is set. It builds a simulation
of WORLDS worlds with DRONES first-principles cf2x_L250 each, compiles a call of STEPS steps, prints one line of JSON with the
versions, and then answers every line on standard input with one line: median and least seconds of a call, over at least 0.3 s
of calls. Single precision unless JAX_ENABLE_X64=1 is set.
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
if os.environ.get("PROPWASH_CORES") != "all":
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
warnings.filterwarnings("ignore")

import jax
import jax.numpy as jnp
import numpy as np
from crazyflow.sim import Sim


def main() -> None:
    mode, worlds, steps, drones = sys.argv[1], *map(int, sys.argv[2:5])
    sim = Sim(n_worlds=worlds, n_drones=drones, drone="cf2x_L250", dynamics="first_principles", control=mode)
    n = worlds * drones
    # Another command for every drone, the same as in benches/steps.rs.
    waves = np.stack([np.sin(np.arange(n) * k) for k in (12.9898, 78.233, 37.719, 4.581)], axis=-1)
    a, b, c, d = waves.T
    zero, one = np.zeros(n), np.ones(n)
    weight = 9.81 * float(sim.data.params.mass.ravel()[0])
    if mode == "state":
        command = np.stack([a, b, 1 + 0.5 * c] + [zero] * 9 + [one, zero, zero, zero], axis=-1)
        control = sim.state_control
    elif mode == "attitude":
        command = np.stack([0.1 * a, 0.1 * b, 0.1 * c, weight * (1 + 0.05 * d)], axis=-1)
        control = sim.attitude_control
    else:
        c0, c1, c2 = (float(c) for c in np.ravel(sim.data.params.rpm2thrust)[:3])
        hover_rpm = (np.sqrt(c1 * c1 - 4 * c2 * (c0 - weight / 4)) - c1) / (2 * c2)
        command = hover_rpm * (1 + 2e-4 * waves)
        control = sim.rotor_vel_control
    command = jnp.asarray(command).reshape(worlds, drones, -1)
    control(command)
    sim.step(steps)
    jax.block_until_ready(sim.data)
    names = ("crazyflow", "jax", "jaxlib")
    print(json.dumps({name: metadata.version(name) for name in names}), flush=True)
    for _ in sys.stdin:
        calls, begin = [], time.perf_counter()
        while time.perf_counter() - begin < 0.3 or len(calls) < 3:
            # Episodes of at most 40 calls.
            if len(calls) % 40 == 0:
                sim.reset()
                control(command)
                jax.block_until_ready(sim.data)
            start = time.perf_counter()
            sim.step(steps)
            jax.block_until_ready(sim.data)
            calls.append(time.perf_counter() - start)
        print(json.dumps([statistics.median(calls), min(calls)]), flush=True)


main()
