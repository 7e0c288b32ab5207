"""Depth by rays of the peers, for benches/depth.rs.

Usage: python benches/peers/depth.py PEER FOLDER SIDE LIMIT_S [worlds]

PEER is batch (mujoco.batch), mjx or crazyflow. FOLDER holds scene.xml and poses.f64: for each camera its position, m, and its
rotation to the world as a quaternion, x y z w. Images are SIDE x SIDE pixels, 45 degrees high. A pass goes through all
cameras, one after the other, or stops after LIMIT_S seconds; with `worlds` all cameras, one in each world, are one call.

It prints {"first": true} after its first call. After a first pass it writes PEER.f32 with the ranges, inf where nothing was met and
nan where the limit came first, and prints one line of JSON with the versions, or with the reason why it cannot. Then it answers every line on standard input with the frames and
the seconds of passes of at least 0.05 s together.
"""

import json
import os
import sys
import time
import warnings
from importlib import metadata
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("SCIPY_ARRAY_API", "1")  # Crazyflow asks for it
warnings.filterwarnings("ignore")

import mujoco
import numpy as np

FOVY_DEG = 45.0


def camera_rays(side: int) -> np.ndarray:
    """Unit directions of the pixels in a camera that looks along -z, (side * side, 3)."""
    focal = 0.5 * side / np.tan(0.5 * np.radians(FOVY_DEG))
    at = (np.arange(side) + 0.5 - 0.5 * side) / focal
    x, y = np.meshgrid(at, -at)
    rays = np.stack([x, y, -np.ones_like(x)], axis=-1).reshape(-1, 3)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def matrices(quat: np.ndarray) -> np.ndarray:
    """Rotations from quaternions w x y z, (n, 3, 3)."""
    out = np.zeros((len(quat), 9))
    for row, q in zip(out, quat):
        mujoco.mju_quat2Mat(row, q)
    return out.reshape(-1, 3, 3)


def scene(folder: Path, body: str, more: str = "") -> str:
    text = (folder / "scene.xml").read_text()
    return text.replace("</worldbody>", body + "</worldbody>" + more)


def batch(folder: Path, side: int, pos: np.ndarray, quat: np.ndarray, worlds: bool):
    """Cameras with a rangefinder: mj_multiRay in the threads of the batch, twice as fast as Batch.ray, which is mj_ray."""
    from mujoco.batch import Batch

    camera = f"<camera name='c' fovy='{FOVY_DEG}' resolution='{side} {side}'/>"
    xml = scene(
        folder,
        f"<body mocap='true'>{camera}</body>",
        "<sensor><rangefinder camera='c' data='dist'/></sensor>",
    )
    threads = len(os.sched_getaffinity(0))
    many = Batch(mujoco.MjModel.from_xml_string(xml), len(pos), nthread=threads)
    ranges = many.bind("sensordata")
    many.bind("mocap_pos")[:, 0] = pos
    many.bind("mocap_quat")[:, 0] = quat

    def cast(_):
        many.forward(stage=int(mujoco.mjtStage.mjSTAGE_POS))
        return ranges

    return [range(len(pos))], cast


def mjx(folder: Path, side: int, pos: np.ndarray, quat: np.ndarray, worlds: bool):
    import jax
    import jax.numpy as jnp
    from mujoco import mjx

    model = mujoco.MjModel.from_xml_string(scene(folder, ""))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    # The scene never changes here: constants of the compiled function, as Crazyflow's fast path has its model.
    m, d = mjx.put_model(model), mjx.put_data(model, data)
    rays = jnp.asarray(camera_rays(side), dtype=jnp.float32)

    def image(at, turn):
        return jax.vmap(lambda ray: mjx.ray(m, d, at, turn @ ray)[0])(rays)

    at, turn = jnp.asarray(pos, dtype=jnp.float32), jnp.asarray(matrices(quat), dtype=jnp.float32)
    if worlds:
        # All at once needs memory for all rays times all geoms; camera by camera is as fast.
        every = jax.jit(lambda at, turn: jax.lax.map(lambda pose: image(*pose), (at, turn)))
        return [range(len(pos))], lambda _: every(at, turn).block_until_ready()
    one = jax.jit(image)
    return [[k] for k in range(len(pos))], lambda k: one(at[k[0]], turn[k[0]])[None].block_until_ready()


def crazyflow(folder: Path, side: int, pos: np.ndarray, quat: np.ndarray, worlds: bool):
    import jax.numpy as jnp
    from crazyflow.sim import Sim
    from crazyflow.sim.sensors.depth import build_render_depth_fn

    (folder / "crazyflow.xml").write_text(scene(folder, "<camera name='c'/>"))
    n = len(pos) if worlds else 1
    sim = Sim(n_worlds=n, n_drones=1, xml_path=folder / "crazyflow.xml")
    camera = mujoco.mj_name2id(sim.mj_model, mujoco.mjtObj.mjOBJ_CAMERA, "c")
    # Its faster way: the model is part of the compiled function.
    render = build_render_depth_fn(sim.mjx_model, camera=camera, resolution=(side, side))
    render(sim)  # brings MJX's data up to date
    at, turn = jnp.asarray(pos, dtype=jnp.float32), jnp.asarray(matrices(quat), dtype=jnp.float32)

    def cast(cameras):
        first, count = cameras[0], len(cameras)
        sim.mjx_data = sim.mjx_data.replace(
            cam_xpos=sim.mjx_data.cam_xpos.at[:, camera].set(at[first : first + count]),
            cam_xmat=sim.mjx_data.cam_xmat.at[:, camera].set(turn[first : first + count]),
        )
        return render(sim).reshape(count, -1).block_until_ready()

    return ([range(n)] if worlds else [[k] for k in range(len(pos))]), cast


PEERS = {
    "batch": (batch, ("mujoco",)),
    "mjx": (mjx, ("mujoco-mjx", "jax", "jaxlib")),
    "crazyflow": (crazyflow, ("crazyflow", "mujoco-mjx", "jax")),
}


def main() -> None:
    name, folder, side, limit = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
    make, packages = PEERS[name]
    poses = np.fromfile(folder / "poses.f64").reshape(-1, 7)
    answer = {"versions": ", ".join(f"{p} {metadata.version(p)}" for p in packages)}
    try:
        calls, cast = make(folder, side, poses[:, :3], poses[:, [6, 3, 4, 5]], sys.argv[5:] == ["worlds"])
        seen = np.full((len(poses), side * side), np.nan, np.float32)
        begin = time.perf_counter()
        for cameras in calls:
            ranges = np.asarray(cast(cameras))
            if cameras == calls[0]:
                print(json.dumps({"first": True}), flush=True)
            seen[list(cameras)] = np.where(ranges < 0, np.inf, ranges)
            if time.perf_counter() - begin > limit:
                break
        seen.tofile(folder / f"{name}.f32")
    except Exception as error:  # a refusal is an answer too
        answer["refused"] = f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
        print(json.dumps(answer), flush=True)
        return
    print(json.dumps(answer), flush=True)
    for _ in sys.stdin:
        frames, begin = 0, time.perf_counter()
        while (seconds := time.perf_counter() - begin) < 0.05:
            for cameras in calls:
                cast(cameras)
                frames += len(cameras)
                if time.perf_counter() - begin > limit:
                    break
        print(json.dumps([frames, seconds]), flush=True)


main()
