"""Depth through the fixed cameras of the scenes in xml/, by MuJoCo's C rays and by MJX, written as npz.

Usage: python tests/reference/mjx_reference.py SCENE_DIR OUT_DIR

For SCENE.xml the file OUT_DIR/SCENE.npz holds, per fixed camera CAM and with images of HEIGHT x WIDTH pixels, row 0 on top:
  CAM/c_dist     range in m by mj_multiRay, -1 where nothing is hit      CAM/c_geom   its geom id, -1 likewise
  CAM/mjx_dist   range in m by mjx.ray, -1 where nothing is hit          CAM/mjx_geom its geom id
and `geom_type` (mjtGeom of every geom). OUT_DIR/versions.json names the versions and, per scene, why MJX refused it if it did.
"""

import json
import sys
from pathlib import Path

import jax
import mujoco
import numpy as np
from mujoco import mjx

jax.config.update("jax_enable_x64", True)

WIDTH, HEIGHT = 48, 36
GROUPS = (1, 1, 1, 0, 0, 0)


def pixel_rays(fovy_deg: float, rotation: np.ndarray) -> np.ndarray:
    """Unit directions in the world of the rays through all pixel centres, shape (HEIGHT * WIDTH, 3)."""
    focal = 0.5 * HEIGHT / np.tan(np.radians(fovy_deg) / 2)
    u, v = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    local = np.stack([(u - WIDTH / 2) / focal, -(v - HEIGHT / 2) / focal, -np.ones_like(u)], axis=-1)
    local /= np.linalg.norm(local, axis=-1, keepdims=True)
    return local.reshape(-1, 3) @ rotation.T


def c_rays(model, data, origin, rays):
    n = len(rays)
    dist, geom = np.full(n, -1.0), np.full(n, -1, np.int32)
    group = np.array(GROUPS, np.uint8)
    mujoco.mj_multiRay(model, data, origin, rays.ravel(), group, 1, -1, geom, dist, None, n, mujoco.mjMAXVAL)
    return dist.reshape(HEIGHT, WIDTH), geom.reshape(HEIGHT, WIDTH)


def mjx_rays(model, data, origin, rays):
    one = lambda ray: mjx.ray(model, data, origin, ray, geomgroup=GROUPS)
    dist, geom = jax.jit(jax.vmap(one))(jax.numpy.asarray(rays))
    return np.asarray(dist).reshape(HEIGHT, WIDTH), np.asarray(geom).reshape(HEIGHT, WIDTH)


def main(scene_dir: Path, out_dir: Path) -> None:
    out_dir.mkdir(parents=True, exist_ok=True)
    refused = {}
    for path in sorted(scene_dir.glob("*.xml")):
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            refused[path.stem] = f"mujoco: {error}"
            continue
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        arrays = {"geom_type": np.asarray(model.geom_type)}
        try:
            mjx_model = mjx.put_model(model)
            mjx_data = mjx.put_data(model, data)
        except (NotImplementedError, ValueError, RuntimeError) as error:
            refused[path.stem] = f"mjx: {error}"
            mjx_model = None
        for cam in range(model.ncam):
            if model.cam_mode[cam] != mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
                continue
            name = model.camera(cam).name
            rays = pixel_rays(model.cam_fovy[cam], data.cam_xmat[cam].reshape(3, 3))
            origin = data.cam_xpos[cam].copy()
            dist, geom = c_rays(model, data, origin, rays)
            arrays[f"{name}/c_dist"], arrays[f"{name}/c_geom"] = dist, geom
            if mjx_model is not None:
                dist, geom = mjx_rays(mjx_model, mjx_data, origin, rays)
                arrays[f"{name}/mjx_dist"], arrays[f"{name}/mjx_geom"] = dist, geom.astype(np.int32)
        np.savez(out_dir / f"{path.stem}.npz", **arrays)
    versions = {
        "mujoco": mujoco.__version__,
        "mujoco-mjx": __import__("importlib.metadata").metadata.version("mujoco-mjx"),
        "jax": jax.__version__,
        "numpy": np.__version__,
        "refused": refused,
    }
    (out_dir / "versions.json").write_text(json.dumps(versions, indent=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
