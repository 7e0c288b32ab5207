"""Crazyflow's gradients of flights and its planning by sampling, for benches/learn.rs.

Usage: python benches/peers/learn.py gradients WORLDS STEPS
       python benches/peers/learn.py planning SAMPLES

The process stays on one core. It compiles its task, prints one line of JSON with the versions and the time until the first result,
and then answers every line on standard input with one line: median and least seconds of a call, over at least 0.3 s of calls.

gradients: WORLDS worlds with one first-principles cf2x_L250 each under attitude commands; the gradient of the sum of (z - 1)^2 after
STEPS steps of 2 ms by the commands. The clip at the floor is taken out of the pipeline, since its slope is no part of the flight.

planning: an update of a plan of 25 commands of 40 ms for a cf21B_500 by so_rpy_rotor_drag among 30 poles: SAMPLES sequences are drawn
about the plan, flown, judged by the cost of benches/learn.rs (distances to the poles in closed form), and the best hundredth averaged.
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
from crazyflow.sim import Dynamics, Sim
from crazyflow.sim.pipeline import remove_fn


def replaced(data, command):
    """The data of a simulation with an attitude command for each world."""
    attitude = data.controls.attitude.replace(staged_cmd=command)
    return data.replace(controls=data.controls.replace(attitude=attitude))


def gradients(worlds: int, steps: int):
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
        data = step(replaced(start, command), steps)
        return jnp.sum((data.states.pos[:, 0, 2] - 1) ** 2)

    gradient = jax.jit(jax.grad(loss))
    return lambda: gradient(command).block_until_ready()


def planning(samples: int):
    times, step_s, elites = 25, 0.04, max(1, samples // 100)
    rates = dict.fromkeys(("freq", "attitude_freq", "state_freq", "body_rate_freq", "force_torque_freq"), 25)
    sim = Sim(n_worlds=samples, drone="cf21B_500", dynamics=Dynamics.so_rpy_rotor_drag, control=Control.attitude, **rates)
    step = sim.build_step_fn()
    sim.reset()
    start = sim.data
    start = start.replace(states=start.states.replace(pos=start.states.pos.at[..., 2].set(1.0)))
    hover = 9.81 * float(sim.data.params.mass.ravel()[0])
    # The grid of benches/learn.rs.
    poles = jnp.asarray([(1.0 + 0.8 * (i % 6), 0.8 * (i // 6 - 2)) for i in range(30)], jnp.float32)
    spread = jnp.asarray([0.12, 0.12, 0.0, 0.15 * hover], jnp.float32)
    low, high = (jnp.asarray(v, jnp.float32) for v in ([-0.6, -0.6, 0, 0.3 * hover], [0.6, 0.6, 0, 1.7 * hover]))

    def one(data, given):
        command, t = given
        data = step(replaced(data, command[:, None]), 1)
        pos, vel = data.states.pos[:, 0], data.states.vel[:, 0]
        way = pos - jnp.stack([jnp.minimum(1.2 * t, 6.0), 0.0, 1.0])
        near = jnp.linalg.norm(pos[:, None, :2] - poles, axis=-1).min(axis=-1) - 0.05
        cost = 50 * jnp.sum(way**2, -1) + jnp.sum(vel**2, -1) + 5 * jnp.sum(command[:, :2] ** 2, -1)
        return data, cost + 5 * (command[:, 3] - hover) ** 2 + jnp.where(near < 0.15, 1000.0, 0.0)

    @jax.jit
    def update(key, plan):
        key, draw = jax.random.split(key)
        commands = jnp.clip(plan + spread * jax.random.normal(draw, (samples, times, 4)), low, high)
        at = step_s * jnp.arange(1, times + 1, dtype=jnp.float32)
        _, costs = jax.lax.scan(one, start, (commands.transpose(1, 0, 2), at))
        best = jax.lax.top_k(-costs.sum(axis=0), elites)[1]
        return key, commands[best].mean(axis=0)

    now = [jax.random.key(0), jnp.tile(jnp.asarray([0, 0, 0, hover], jnp.float32), (times, 1))]

    def call() -> None:
        now[:] = update(*now)
        now[1].block_until_ready()

    return call


def main() -> None:
    task = {"gradients": gradients, "planning": planning}[sys.argv[1]]
    call = task(*map(int, sys.argv[2:]))
    call()
    told = {name: metadata.version(name) for name in ("crazyflow", "jax", "jaxlib")}
    print(json.dumps({**told, "first_s": time.perf_counter() - BEGAN}), flush=True)
    for _ in sys.stdin:
        calls, begin = [], time.perf_counter()
        while time.perf_counter() - begin < 0.3 or len(calls) < 3:
            before = time.perf_counter()
            call()
            calls.append(time.perf_counter() - before)
        print(json.dumps([statistics.median(calls), min(calls)]), flush=True)


main()
