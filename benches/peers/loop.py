"""Crazyflow's whole loop, for benches/loop.rs: flight, depth images and contacts.

Usage: python benches/peers/loop.py SCENE.xml STARTS.f64 STEPS SIDE

STARTS.f64 holds for each world where its cf2x_L250 starts: position, m, attitude as a quaternion x y z w, and its attitude
command: roll, pitch, yaw, rad, and thrust, N. A frame is STEPS steps at 500 Hz, an image of SIDE x SIDE pixels by the drone's own
camera and the contacts, in all worlds. The process stays on one core, unless PROPWASH_CORES=all is set.

It prints {"first": true} after its first frame, then one line of JSON with the versions, and then answers every line on standard
input with one line: median and least seconds of a frame, over at least 0.3 s and 3 frames. Episodes last 80 frames.
"""

import json
import os
import statistics
import sys
import time
import warnings
from importlib import metadata
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("SCIPY_ARRAY_API", "1")  # Crazyflow asks for it
if os.environ.get("PROPWASH_CORES") != "all":
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
warnings.filterwarnings("ignore")

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from crazyflow.sim import Sim
from crazyflow.sim.sensors.depth import build_render_depth_fn

EPISODE_FRAMES = 80


def main() -> None:
    scene, steps, side = Path(sys.argv[1]), int(sys.argv[3]), int(sys.argv[4])
    starts = np.fromfile(sys.argv[2]).reshape(-1, 11)
    sim = Sim(
        n_worlds=len(starts),
        n_drones=1,
        drone="cf2x_L250",
        dynamics="first_principles",
        control="attitude",
        xml_path=scene,
    )
    pos = jnp.asarray(starts[:, None, :3], dtype=jnp.float32)
    quat = jnp.asarray(starts[:, None, 3:7], dtype=jnp.float32)
    command = jnp.asarray(starts[:, None, 7:], dtype=jnp.float32)
    sim.data = sim.data.replace(states=sim.data.states.replace(pos=pos, quat=quat))
    sim.build_default_data()
    camera = mujoco.mj_name2id(sim.mj_model, mujoco.mjtObj.mjOBJ_CAMERA, "fpv_cam:0")
    # Its faster way: the model is part of the compiled function.
    render = build_render_depth_fn(sim.mjx_model, camera=camera, resolution=(side, side))

    def begin() -> None:
        sim.reset()
        sim.attitude_control(command)
        jax.block_until_ready(sim.data)

    def frame() -> np.ndarray:
        sim.step(steps)
        depth = render(sim)
        touching = sim.contacts()
        jax.block_until_ready((depth, touching))
        return depth

    begin()
    np.asarray(frame())
    print(json.dumps({"first": True}), flush=True)
    names = ("crazyflow", "mujoco-mjx", "jax")
    print(json.dumps({name: metadata.version(name) for name in names}), flush=True)
    frames = 0
    for _ in sys.stdin:
        calls, since = [], time.perf_counter()
        while time.perf_counter() - since < 0.3 or len(calls) < 3:
            if frames % EPISODE_FRAMES == 0:
                begin()
            frames += 1
            start = time.perf_counter()
            frame()
            calls.append(time.perf_counter() - start)
        print(json.dumps([statistics.median(calls), min(calls)]), flush=True)


main()
