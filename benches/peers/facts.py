"""Small experiments on what MJX, Crazyflow and Propwash report besides the geom types, for docs/compare.md.

Usage: PROPWASH_BIN=target/debug/propwash python benches/peers/facts.py [NAME ...]            prints one line for each fact

Each function asks one question of one program by running it; its doc comment is the question. MJX is its JAX implementation.
"""

import hashlib
import os
import sys
import tempfile
import time
import warnings
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("SCIPY_ARRAY_API", "1")  # Crazyflow asks for it
warnings.filterwarnings("ignore")

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx
from what_is_seen import model_of, propwash

CAMERA = '<camera name="c" pos="0 0 1" xyaxes="0 -1 0 0 0 1" fovy="{}"/>'
WALL = '<geom name="wall" type="box" size="0.1 9 9" pos="2.1 0 1" {}/>'
FLOOR = '<geom name="floor" type="plane" size="0 0 1" pos="0 0 {}"/>'


def world(*parts: str, assets: str = "") -> str:
    return f"<mujoco><asset>{assets}</asset><worldbody>{''.join(parts)}</worldbody></mujoco>"


def sim(folder: Path, xml: str, **options):
    from crazyflow.sim import Sim

    (folder / "scene.xml").write_text(xml)
    return Sim(xml_path=folder / "scene.xml", **options)


def depth(simulation, size=(9, 9), **options):
    from crazyflow.sim.sensors.depth import render_depth

    return np.asarray(render_depth(simulation, camera=0, resolution=size, **options))


def put(simulation, pos) -> None:
    states = simulation.data.states.replace(pos=jnp.asarray(pos, dtype=simulation.data.states.pos.dtype))
    core = simulation.data.core.replace(mjx_synced=False)
    simulation.data = simulation.data.replace(states=states, core=core)


def view(folder: Path, *args: str) -> dict:
    return propwash("depth", "--scene", f"{folder}/scene.xml", "--out", f"{folder}/d.png", *args)


def angle(ranges) -> float:
    """Vertical field of view from the ranges to a wall across the axis, 9 x 9 pixels."""
    top = np.arccos(ranges[4, 4] / ranges[0, 4])
    return float(np.degrees(2 * np.arctan(np.tan(top) * 9 / 8)))


def crazyflow_field_of_view(folder):
    """What is the vertical field of view of depth images through a camera with fovy = 90?"""
    return f"{angle(depth(sim(folder, world(CAMERA.format(90), WALL.format(''))))[0]):.1f} degrees"


def propwash_field_of_view(folder):
    """The same question."""
    (folder / "scene.xml").write_text(world(CAMERA.format(90), WALL.format("")))
    told = view(folder, "--camera", "c", "--size", "9x9", "--depth", "range")
    return f"{np.degrees(2 * np.arctan(4.5 / told['k'][1][1])):.1f} degrees"


def crazyflow_own_files(folder):
    """Does a scene find its own mesh by a path relative to the scene's folder, and by an absolute one?"""
    (folder / "tetra.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    answers = []
    for path in ("tetra.obj", f"{folder}/tetra.obj"):
        try:
            sim(folder, world('<geom type="mesh" mesh="m"/>', assets=f'<mesh name="m" file="{path}"/>'))
            answers.append("found")
        except Exception as error:
            answers.append(str(error).splitlines()[0].replace(str(folder), "FOLDER")[:60] + "...")
    return f"relative: {answers[0]}; absolute: {answers[1]}"


def propwash_own_files(folder):
    """The same question."""
    (folder / "tetra.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    answers = []
    for path in ("tetra.obj", f"{folder}/tetra.obj"):
        mesh = f'<mesh name="m" file="{path}"/>'
        (folder / "scene.xml").write_text(world('<geom type="mesh" mesh="m"/>', assets=mesh))
        answers.append("found" if view(folder, "--pos", "-2,0.2,0.2")["hit"] else "not seen")
    return f"relative: {answers[0]}; absolute: {answers[1]}"


def crazyflow_floor(folder):
    """Where does a falling drone stop above a floor at z = -2, and above one at z = 0.5?"""
    ends = []
    for floor in (-2, 0.5):
        s = sim(folder, world(FLOOR.format(floor)), control="rotor_vel", dynamics="first_principles")
        put(s, [[[0.0, 0.0, 1.0]]])
        s.rotor_vel_control(np.zeros((1, 1, 4)))
        s.step(1500)
        ends.append(float(s.data.states.pos[0, 0, 2]))
    return f"floor at -2 m: stops at z = {ends[0]:.3f} m; floor at 0.5 m: stops at z = {ends[1]:.3f} m"


def crazyflow_zero_rotor_speed(folder):
    """How fast do the rotors turn after 2 s of the command 0?"""
    s = sim(folder, world(), control="rotor_vel", dynamics="first_principles")
    put(s, [[[0.0, 0.0, 1e3]]])
    s.rotor_vel_control(np.zeros((1, 1, 4)))
    s.step(1000)
    return f"{float(s.data.states.rotor_vel[0, 0, 0]):.0f} rpm"


def crazyflow_schedule(folder):
    """How often does a state controller of 400 Hz run in one second at 500 Hz?"""
    s = sim(folder, world(), control="state", state_freq=400, freq=500)
    ticks, last = 0, None
    for _ in range(500):
        s.step()
        now = int(s.data.controls.state.steps[0, 0])
        ticks += now != last
        last = now
    return f"{ticks} times"


def crazyflow_contacts(folder):
    """What does a contact report say?"""
    s = sim(folder, world(FLOOR.format(0)), n_drones=2)
    put(s, [[[0.0, 0.0, 0.05], [0.0, 0.0, 5.0]]])
    flags = s.contacts()
    names = [f.name for f in s.mjx_data._impl.contact.__dataclass_fields__.values()]
    return (
        f"Sim.contacts(): {flags.dtype} of shape {flags.shape}, {int(flags.sum())} true; sim.mjx_data._impl.contact holds "
        f"{', '.join(n for n in names if n in ('dist', 'pos', 'frame', 'geom1', 'geom2', 'geom'))}"
    )


def crazyflow_slots(folder):
    """Of 64 drones at one place (2,016 overlapping pairs, no floor), how many contacts are reported?"""
    s = sim(folder, world(), n_drones=64)
    put(s, np.zeros((1, 64, 3)) + [0, 0, 1.0])
    flags = s.contacts()
    return f"{int(flags.sum())} (max_geom_pairs = {s.max_geom_pairs}, {flags.shape[1]} slots)"


def crazyflow_misses(folder):
    """What does a depth image hold where nothing is hit, and where something is 60 m away?"""
    s = sim(folder, world(CAMERA.format(45), '<geom type="sphere" size="5" pos="65 0 1"/>'))
    image = depth(s)[0]
    return f"miss {image[0, 0]}, centre {image[4, 4]:.3f}; one array of shape {depth(s).shape}, no ids"


def propwash_misses(folder):
    """The same question, with far limits of 65 m and of 50 m."""
    (folder / "scene.xml").write_text(world(CAMERA.format(45), '<geom type="sphere" size="5" pos="65 0 1"/>'))
    told = [view(folder, "--camera", "c", "--size", "9x9", "--far", far) for far in ("65", "50")]
    return "; ".join(f"hit {t['hit']}, miss {t['miss']}, too far {t['too_far']}" for t in told)


def propwash_group_two(folder):
    """Is a wall of geom group 2 seen by default?"""
    (folder / "scene.xml").write_text(world(CAMERA.format(45), WALL.format('group="2"')))
    return f"{view(folder, '--camera', 'c', '--size', '9x9')['hit']} of 81 pixels"


def crazyflow_first_image(folder):
    """How long does the first depth image take, 64 x 64 of a box, compilation included (run this question alone), and the second?"""
    s = sim(folder, world(CAMERA.format(45), WALL.format("")))
    times = []
    for _ in range(2):
        start = time.perf_counter()
        depth(s, size=(64, 64))
        times.append(time.perf_counter() - start)
    return f"{times[0]:.2f} s, then {times[1]:.4f} s (importing and building the simulation not counted)"


def propwash_first_image(folder):
    """How long does `propwash depth` take from start to end for the same image?"""
    (folder / "scene.xml").write_text(world(CAMERA.format(45), WALL.format("")))
    start = time.perf_counter()
    view(folder, "--camera", "c", "--size", "64x64")
    return f"{time.perf_counter() - start:.2f} s (starting the program, loading the scene and writing the image counted)"


def crazyflow_pose_units(folder):
    """In which order does a state hold a rotation, and which unit has a rotor speed?"""
    s = sim(folder, world(), dynamics="first_principles")
    quat = np.asarray(s.data.states.quat)[0, 0]
    docs = type(s.data.states).__dataclass_fields__
    return f"quaternion of no rotation {quat.tolist()} (x y z w); fields {', '.join(docs)}; rotor_vel is in rpm (sim.rotor_vel_limits)"


def crazyflow_group_two(folder):
    """Is a wall of geom group 2 seen by default, and are other drones?"""
    hidden = depth(sim(folder, world(CAMERA.format(45), WALL.format('group="2"'))))
    s = sim(folder, world(CAMERA.format(45), WALL.format("")))
    put(s, [[[1.0, 0.0, 1.0]]])
    without, including = depth(s, size=(31, 31)), depth(s, size=(31, 31), include_drone=True)
    return (
        f"wall of group 2: {'seen' if (hidden >= 0).any() else 'not seen'}; drone before the camera: "
        f"{'seen' if (without[0] < 1.9)[without[0] >= 0].any() else 'not seen'}, with include_drone=True "
        f"{'seen' if (including[0] < 1.9)[including[0] >= 0].any() else 'not seen'}"
    )


def crazyflow_nan(folder):
    """A drone is inside a wall; then its position becomes NaN. What do contacts say?"""
    s = sim(folder, world(WALL.format("")), n_worlds=2)
    put(s, [[[2.1, 0.0, 1.0]], [[2.1, 0.0, 1.0]]])
    before = np.asarray(s.contacts()).any(axis=1)
    put(s, [[[np.nan, 0.0, 1.0]], [[2.1, 0.0, 1.0]]])
    after = np.asarray(s.contacts()).any(axis=1)
    return f"contact in both worlds before: {before.tolist()}, after NaN in world 0: {after.tolist()}, no error"


def mjx_invisible_mesh(folder):
    """A mesh of alpha 0 hangs before an opaque one. What do the rays of MuJoCo C and of MJX see?"""
    mesh = '<mesh name="m" vertex="0.3 0.3 0.3  -0.3 -0.3 0.3  -0.3 0.3 -0.3  0.3 -0.3 -0.3"/>'
    mesh += '<material name="paint" rgba="1 0 0 1"/><material name="air" rgba="1 0 0 0"/>'
    parts = ('<geom name="air" type="mesh" mesh="m" material="air" pos="1 0 0"/>'
             '<geom name="opaque" type="mesh" mesh="m" material="paint" pos="3 0 0"/>')  # fmt: skip
    model = model_of(folder, world(parts, assets=mesh))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    one = np.array([-1], np.int32)
    c = mujoco.mj_ray(model, data, np.zeros(3), np.array([1.0, 0, 0]), None, 1, -1, one)
    x, _ = mjx.ray(mjx.put_model(model), mjx.put_data(model, data), np.zeros(3), np.array([1.0, 0, 0]))
    return f"mj_ray: {c:.3f} m; mjx.ray: {float(x):.3f} m"


def mjx_without_materials(folder):
    """Does mjx.ray work in a scene without materials?"""
    model = model_of(folder, world('<geom type="sphere" size="0.5" pos="2 0 0"/>'))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    try:
        x, _ = mjx.ray(mjx.put_model(model), mjx.put_data(model, data), np.zeros(3), np.array([1.0, 0, 0]))
        return f"{float(x)} m"
    except Exception as error:
        return f"{type(error).__name__}: {str(error).splitlines()[0][:80]}"


def mujoco_batch_of_rays(folder):
    """A body of a box that collides and a larger one that does not: how many rays at it does mj_multiRay lose?"""
    body = ('<body pos="3 0 0" euler="0 0 40"><geom type="box" size="0.1 0.1 0.1"/>'
            '<geom type="box" size="0.5 0.5 0.5" pos="0.6 0.4 0" contype="0" conaffinity="0"/></body>')  # fmt: skip
    model = model_of(folder, world(body))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    y, z = np.meshgrid(np.linspace(-0.5, 0.5, 101), np.linspace(-0.5, 0.5, 101))
    rays = np.stack([np.ones_like(y), y, z], axis=-1).reshape(-1, 3)
    geoms, dists, one = np.full(len(rays), -1, np.int32), np.zeros(len(rays)), np.array([-1], np.int32)
    mujoco.mj_multiRay(
        model, data, np.zeros(3), rays.ravel(), None, 1, -1, geoms, dists, None, len(rays), mujoco.mjMAXVAL
    )
    hits = lost = 0
    for i, ray in enumerate(rays):
        mujoco.mj_ray(model, data, np.zeros(3), ray.copy(), None, 1, -1, one)
        hits += one[0] >= 0
        lost += one[0] != geoms[i]
    return f"{lost} of {hits} that mj_ray finds"


def mujoco_mocap_contacts(folder):
    """Does a mocap body (a posed drone) make contact with a static floor, and a body with a free joint?"""
    answers = []
    for kind in ('mocap="true"', ""):
        joint = "" if kind else "<freejoint/>"
        body = f'<body pos="0 0 0.05" {kind}>{joint}<geom type="sphere" size="0.07"/></body>'
        model = model_of(folder, world(FLOOR.format(0), body))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        answers.append(data.ncon)
    return f"mocap body: {answers[0]} contacts; free joint: {answers[1]}"


def propwash_same_bytes(folder):
    """Are the files of two runs with 1 and 2 threads the same?"""
    (folder / "scene.xml").write_text(world(FLOOR.format(0), WALL.format("")))
    sums = []
    for threads in ("1", "2"):
        out = folder / threads
        propwash(
            "fly", "--scene", f"{folder}/scene.xml", "--drone", "cf21B_500", "--worlds", "4", "--seconds", "0.2", "--size",
            "8x8", "--threads", threads, "--out", str(out),
        )  # fmt: skip
        files = sorted(p.relative_to(out) for p in out.rglob("*") if p.is_file())
        sums.append([(str(f), hashlib.sha256((out / f).read_bytes()).hexdigest()) for f in files])
    return f"{len(sums[0])} files, {'all the same' if sums[0] == sums[1] else 'different'}"


def mjx_distances(folder):
    """Which functions of MJX give distances of geoms or swept contacts?"""
    found = [n for n in dir(mjx) if any(w in n.lower() for w in ("distance", "sweep", "swept", "clearance"))]
    return ", ".join(found) or "none (dir(mjx))"


QUESTIONS = [f for n, f in list(globals().items()) if n.startswith(("crazyflow_", "propwash_", "mjx_", "mujoco_"))]

if __name__ == "__main__":
    wanted = sys.argv[1:]
    for question in QUESTIONS:
        if wanted and question.__name__ not in wanted:
            continue
        with tempfile.TemporaryDirectory() as folder:
            try:
                answer = question(Path(folder))
            except Exception as error:
                answer = f"{type(error).__name__}: {str(error).splitlines()[0][:200]}"
        print(f"{question.__name__}: {question.__doc__.strip()}\n    {answer}", flush=True)
