"""Contacts of many worlds by mujoco.batch and by Crazyflow, for benches/contacts.rs.

Usage: python benches/peers/contacts.py batch|crazyflow SCENE.xml DRONES POSES.json

SCENE.xml is the scene without drones for crazyflow, with its drones as free bodies for batch. POSES.json holds positions,
(world, drone, 3), all level. The process stays on one core. It prints one line of JSON with the versions and the number of
contacts, and then answers every line on standard input with one line: median and least seconds of one round over all worlds,
over at least 0.3 s of rounds. A round writes all poses, computes where geoms are, and finds contacts.
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

import numpy as np


def batch(path, drones, poses):
    """mj_forward up to the stage of positions, on one thread; it has no collision without the rest of that stage."""
    import mujoco
    from mujoco.batch import Batch

    model = mujoco.MjModel.from_xml_path(path)
    sims = Batch(model, nsim=len(poses), nthread=1)
    qpos, ncon = sims.bind("qpos"), sims.bind("ncon")
    # Free joints of drones are the last ones.
    wanted = np.zeros((len(poses), drones, 7))
    wanted[..., :3], wanted[..., 3] = poses, 1.0

    def round_():
        qpos[:, -7 * drones :] = wanted.reshape(len(poses), -1)
        sims.forward(stage=mujoco.mjtStage.mjSTAGE_POS.value)
        return int(ncon.sum())

    return round_, ("mujoco", "numpy")


def crazyflow(path, drones, poses):
    """sync_sim2mjx and Sim.contacts, as its own loop calls them."""
    from pathlib import Path

    import jax
    import jax.numpy as jnp
    from crazyflow.sim import Sim
    from crazyflow.sim.sim import sync_sim2mjx

    sim = Sim(n_worlds=len(poses), n_drones=drones, drone="cf2x_L250", xml_path=Path(path))
    pos = jnp.asarray(poses, dtype=jnp.float32)

    def round_():
        data = sim.data.replace(states=sim.data.states.replace(pos=pos))
        sim.data, sim.mjx_data = sync_sim2mjx(data, sim.mjx_data, sim.mjx_model)
        touching = sim.contacts()
        jax.block_until_ready(touching)
        return int(touching.sum())

    return round_, ("crazyflow", "mujoco-mjx", "jax")


def main():
    kind, path, drones = sys.argv[1], sys.argv[2], int(sys.argv[3])
    with open(sys.argv[4]) as file:
        poses = np.array(json.load(file)).reshape(-1, drones, 3)
    round_, packages = {"batch": batch, "crazyflow": crazyflow}[kind](path, drones, poses)
    told = {name: metadata.version(name) for name in packages}
    told["contacts"] = round_()
    print(json.dumps(told), flush=True)
    for _ in sys.stdin:
        rounds, begin = [], time.perf_counter()
        while time.perf_counter() - begin < 0.3 or len(rounds) < 3:
            start = time.perf_counter()
            round_()
            rounds.append(time.perf_counter() - start)
        print(json.dumps([statistics.median(rounds), min(rounds)]), flush=True)


main()
