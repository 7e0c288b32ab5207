"""What MuJoCo C, MJX, Crazyflow and Propwash see of every geom type: depth by rays, contact with a drone.

Usage: PROPWASH_BIN=target/debug/propwash python benches/peers/what_is_seen.py            prints a markdown table

For each type a scene holds one such geom 1 m in front of a camera, and another scene holds it overlapping a drone: a sphere of
0.07 m for MuJoCo C and MJX, Crazyflow's and Propwash's own cf21B for these two. "yes" is a hit (or a contact with negative distance),
"no" is silence, anything else is the program's own refusal. MJX is its JAX implementation, which Crazyflow uses on a CPU.

Crazyflow moves a scene's meshdir to its own assets, so that a relative path finds no file: the height field is asked again with an
absolute path. MJX refuses a scene in which an sdf may meet a sphere: it is asked again with an sdf that cannot collide.
"""

import json
import os
import re
import struct
import subprocess
import tempfile
import warnings
from importlib.metadata import version
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("SCIPY_ARRAY_API", "1")  # Crazyflow asks for it
warnings.filterwarnings("ignore")

import jax
import mujoco
import numpy as np
from mujoco import mjx

jax.config.update("jax_enable_x64", True)

TETRAHEDRON = """
<mesh name="m" vertex="0.3 0.3 0.3  -0.3 -0.3 0.3  -0.3 0.3 -0.3  0.3 -0.3 -0.3"/>"""
# (asset, geom at the origin) of every type; the height field lies with its hill at the origin.
TYPES = {
    "plane": ("", '<geom name="g" type="plane" size="2 2 0.1" zaxis="-1 0 0"/>'),
    "sphere": ("", '<geom name="g" type="sphere" size="0.3"/>'),
    "capsule": ("", '<geom name="g" type="capsule" size="0.2 0.3"/>'),
    "ellipsoid": ("", '<geom name="g" type="ellipsoid" size="0.2 0.3 0.4"/>'),
    "cylinder": ("", '<geom name="g" type="cylinder" size="0.3 0.3"/>'),
    "box": ("", '<geom name="g" type="box" size="0.3 0.3 0.3"/>'),
    "mesh": (TETRAHEDRON, '<geom name="g" type="mesh" mesh="m"/>'),
    "hfield": (
        '<hfield name="h" nrow="9" ncol="9" size="0.5 0.5 0.4 0.1" file="hill.bin"/>',
        '<geom name="g" type="hfield" hfield="h" pos="0 0 -0.2"/>',
    ),
    "hfield, absolute path": (
        '<hfield name="h" nrow="9" ncol="9" size="0.5 0.5 0.4 0.1" file="FOLDER/hill.bin"/>',
        '<geom name="g" type="hfield" hfield="h" pos="0 0 -0.2"/>',
    ),
    "sdf": (
        '<mesh name="m" builtin="sphere" params="3" scale="0.3 0.3 0.3"/>',
        '<geom name="g" type="sdf" mesh="m"/>',
    ),
    "sdf, contacts off": (
        '<mesh name="m" builtin="sphere" params="3" scale="0.3 0.3 0.3"/>',
        '<geom name="g" type="sdf" mesh="m" contype="0" conaffinity="0"/>',
    ),
}


def hill() -> bytes:
    """A height field in MuJoCo's binary format: rows, columns, then float32 heights."""
    axis = np.linspace(-1, 1, 9)
    height = np.exp(-2 * (axis[:, None] ** 2 + axis[None, :] ** 2)).astype(np.float32)
    return struct.pack("<ii", 9, 9) + height.tobytes()


def scene(kind: str, sphere: str, geom_at: str) -> str:
    asset, geom = TYPES[kind]
    # MJX rays need a scene with at least one material.
    geom = geom.replace("<geom ", '<geom material="paint" ')
    asset += '<material name="paint" rgba="0.5 0.5 0.5 1"/>'
    return f"""<mujoco><asset>{asset}</asset><worldbody>
<body name="target" pos="{geom_at}">{geom}</body>{sphere}
<camera name="c" pos="0 0 0" xyaxes="0 -1 0 0 0 1"/></worldbody></mujoco>"""


def model_of(folder: Path, xml: str) -> mujoco.MjModel:
    (folder / "hill.bin").write_bytes(hill())
    path = folder / "scene.xml"
    path.write_text(xml.replace("FOLDER", str(folder)))
    return mujoco.MjModel.from_xml_path(str(path))


FREE_SPHERE = '<body name="drone" pos="{}"><freejoint/><geom name="shell" type="sphere" size="0.07"/></body>'


def ask(question) -> str:
    try:
        return "yes" if question() else "no"
    except Exception as error:  # a refusal is an answer too
        line = re.sub(r"'?/\S*/site-packages/", "", str(error).splitlines()[0])
        return f"{type(error).__name__}: {line[:90]}"


def depth_c(folder, kind):
    model = model_of(folder, scene(kind, "", "1 0 0"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geom = np.array([-1], np.int32)
    mujoco.mj_ray(model, data, np.zeros(3), np.array([1.0, 0, 0]), None, 1, -1, geom)
    return geom[0] >= 0


def depth_mjx(folder, kind):
    model = model_of(folder, scene(kind, "", "1 0 0"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    dist, _ = mjx.ray(mjx.put_model(model), mjx.put_data(model, data), np.zeros(3), np.array([1.0, 0, 0]))
    return float(dist) >= 0


def touching(kind):
    """Where the sphere stands so that it overlaps the geom at the origin a little."""
    return {
        "plane": "-0.05 0 0", "capsule": "-0.25 0 0", "ellipsoid": "-0.25 0 0", "mesh": "-0.1 0 0", "hfield": "0 0 0.2",
    }.get(kind.split(",")[0], "-0.33 0 0")


def contact_c(folder, kind):
    model = model_of(folder, scene(kind, FREE_SPHERE.format(touching(kind)), "0 0 0"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return any(data.contact.dist[: data.ncon] < 0)


def contact_mjx(folder, kind):
    model = model_of(folder, scene(kind, FREE_SPHERE.format(touching(kind)), "0 0 0"))
    data = mjx.make_data(mjx.put_model(model))
    data = mjx.forward(mjx.put_model(model), data)
    return bool((np.asarray(data._impl.contact.dist) < 0).any())


def crazyflow_sim(folder, kind, target_at):
    from crazyflow.sim import Sim

    model_of(folder, scene(kind, "", target_at))
    return Sim(n_worlds=1, n_drones=1, xml_path=folder / "scene.xml")


def depth_crazyflow(folder, kind):
    from crazyflow.sim.sensors.depth import render_depth

    sim = crazyflow_sim(folder, kind, "1 0 0")
    return bool((np.asarray(render_depth(sim, camera=0, resolution=(9, 9))) >= 0).any())


def contact_crazyflow(folder, kind):
    sim = crazyflow_sim(folder, kind, "0 0 0")
    at = np.array([float(v) for v in touching(kind).split()]) - np.array([0, 0, 0.005])
    states = sim.data.states.replace(pos=sim.data.states.pos.at[0, 0].set(at))
    sim.data = sim.data.replace(states=states)
    return bool(np.asarray(sim.contacts()).any())


def propwash(*args: str) -> dict:
    program = os.environ.get("PROPWASH_BIN", str(Path(__file__).parents[2] / "target/debug/propwash"))
    run = subprocess.run([program, *args, "--json"], capture_output=True, text=True)
    if run.returncode != 0:
        raise RuntimeError(run.stderr.strip() or f"exit code {run.returncode}")
    return json.loads(run.stdout)


def depth_propwash(folder, kind):
    model_of(folder, scene(kind, "", "1 0 0"))
    told = propwash(
        "depth", "--scene", f"{folder}/scene.xml", "--camera", "c", "--size", "9x9", "--out", f"{folder}/depth.png"
    )
    return told["hit"] > 0


def contact_propwash(folder, kind):
    # The drone hovers at (0, 0, 1).
    at = np.array([0, 0, 1]) - np.array([float(v) for v in touching(kind).split()])
    model_of(folder, scene(kind, "", " ".join(map(str, at))))
    told = propwash(
        "fly", "--scene", f"{folder}/scene.xml", "--drone", "cf21B_500", "--trajectory", "hover", "--seconds", "0.05",
        "--size", "8x8", "--out", f"{folder}/data",
    )  # fmt: skip
    return told["contact_rows"] > 0


def main() -> None:
    versions = ", ".join(f"{p} {version(p)}" for p in ("mujoco", "mujoco-mjx", "crazyflow", "jax"))
    print(f"{versions}\n")
    columns = {
        "MuJoCo C depth": depth_c,
        "MJX depth": depth_mjx,
        "Crazyflow depth": depth_crazyflow,
        "Propwash depth": depth_propwash,
        "MuJoCo C contact": contact_c,
        "MJX contact": contact_mjx,
        "Crazyflow contact": contact_crazyflow,
        "Propwash contact": contact_propwash,
    }
    print("| geom type | " + " | ".join(columns) + " |")
    print("| --- |" + " --- |" * len(columns))
    for kind in TYPES:
        cells = []
        for question in columns.values():
            with tempfile.TemporaryDirectory() as folder:
                cells.append(ask(lambda: question(Path(folder), kind)))
        print(f"| {kind} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
