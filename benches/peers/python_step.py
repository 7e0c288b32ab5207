"""One command and one step from Python: propwash.Sim beside crazyflow.sim.Sim, alternately, in one process.

Usage: python python_step.py [WORLDS]       with propwash (release), crazyflow and jax installed
"""

import logging
import os
import statistics
import sys
import time
import warnings

os.environ.setdefault("JAX_PLATFORMS", "cpu")
warnings.filterwarnings("ignore")
logging.disable(logging.WARNING)

import crazyflow
import crazyflow.sim
import jax
import numpy as np
import propwash

STEPS, ROUNDS = 300, 9


def timed(sim, setter, command, wait):
    start = time.perf_counter()
    for _ in range(STEPS):
        setter(command)
        sim.step(1)
    wait()
    return (time.perf_counter() - start) / STEPS * 1e6


def main(n_worlds):
    print(f"propwash {propwash.__version__}, crazyflow {crazyflow.__version__}, jax {jax.__version__}, f32, {n_worlds} worlds")
    for control in ("attitude", "state"):
        theirs = crazyflow.sim.Sim(n_worlds=n_worlds, drone="cf2x_L250", dynamics="first_principles", control=control)
        ours = propwash.Sim(n_worlds=n_worlds, drone="cf2x_L250", control=control)
        command = np.zeros(ours.data.command.shape, np.float32)
        if control == "attitude":
            command[..., 3] = ours.hover_thrust()
        else:
            command[..., 12] = 1.0
        on_device = jax.numpy.asarray(command)
        times = []
        for _ in range(ROUNDS + 1):
            name = f"{control}_control"
            a = timed(theirs, getattr(theirs, name), on_device, lambda: theirs.data.states.pos.block_until_ready())
            times.append((a, timed(ours, getattr(ours, name), command, lambda: None)))
        # The first round compiles.
        a, b = (statistics.median(t) for t in zip(*times[1:]))
        ratio = statistics.median(x / y for x, y in times[1:])
        print(f"  {control}: Crazyflow {a:.0f} us, Propwash {b:.1f} us, ratio {ratio:.0f} (medians of {ROUNDS})")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1)
