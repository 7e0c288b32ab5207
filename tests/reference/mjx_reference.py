"""Depth through the fixed cameras of the scenes in xml/, by MuJoCo's C rays and by MJX, in float64, written as npz.

Usage: python tests/reference/mjx_reference.py SCENE_DIR OUT_DIR

For SCENE.xml the file OUT_DIR/SCENE.npz holds, per fixed camera CAM and with images of HEIGHT x WIDTH pixels, row 0 on top:
  CAM/ray_dist    range in m by mj_ray, one call for each ray, -1 where nothing is hit     CAM/ray_geom    its geom id, -1 likewise
  CAM/multi_dist  range in m by mj_multiRay, all rays in one call                          CAM/multi_geom  its geom id
  CAM/mjx_dist    range in m by mjx.ray                                                    CAM/mjx_geom    its geom id
and `geom_type` (mjtGeom of every geom).

OUT_DIR/versions.json names the versions; `geoms`: the geoms' names per scene; `refused`: per scene why MuJoCo or MJX refused it; `left_out`:
per scene and camera why there is no image. A scene that MJX refuses is given to it again with all contact bits 0, since it is the
contacts that it refuses; `refused` says so, and what the rays then see is compared all the same.
"""

import json
import sys
from importlib.metadata import version
from pathlib import Path

import jax
import mujoco
import numpy as np
from mujoco import mjx

jax.config.update("jax_enable_x64", True)

WIDTH, HEIGHT = 48, 36
GROUPS = (1, 1, 1, 0, 0, 0)


def lens(model, camera: int) -> tuple[float, float, float, float]:
    """Edges left, right, bottom, top of the image on the plane at distance 1 before the camera."""
    if all(model.cam_sensorsize[camera] > 0):
        # As MuJoCo's renderer, not its rangefinder, takes cam_intrinsic: focal lengths and offset of the principal point, m.
        (w, h), (fx, fy, px, py) = model.cam_sensorsize[camera].tolist(), model.cam_intrinsic[camera].tolist()  # were float32
        return -(w / 2 - px) / fx, (w / 2 + px) / fx, -(h / 2 + py) / fy, (h / 2 - py) / fy
    half = np.tan(np.radians(model.cam_fovy[camera]) / 2)
    return -half * WIDTH / HEIGHT, half * WIDTH / HEIGHT, -half, half


def check_lens(model, data, camera: int) -> None:
    """Stops unless MuJoCo's own renderer has the same edges (it keeps them in single precision)."""
    view, scene = mujoco.MjvCamera(), mujoco.MjvScene(model, maxgeom=model.ngeom + 1000)
    view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, camera
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, view, mujoco.mjtCatBit.mjCAT_STATIC, scene)
    left, right, bottom, top = lens(model, camera)
    for gl in scene.camera:
        near = gl.frustum_near
        np.testing.assert_allclose([gl.frustum_bottom / near, gl.frustum_top / near], [bottom, top], rtol=1e-5)
        if all(model.cam_sensorsize[camera] > 0):  # otherwise the window's shape decides on the width
            middle, half = gl.frustum_center / near, gl.frustum_width / near
            np.testing.assert_allclose([middle - half, middle + half], [left, right], rtol=1e-5)


def pixel_rays(model, data, camera: int) -> np.ndarray:
    """Unit directions in the world of the rays through all pixel centres, shape (HEIGHT * WIDTH, 3)."""
    left, right, bottom, top = lens(model, camera)
    u, v = np.meshgrid((np.arange(WIDTH) + 0.5) / WIDTH, (np.arange(HEIGHT) + 0.5) / HEIGHT)
    local = np.stack([left + u * (right - left), top + v * (bottom - top), -np.ones_like(u)], axis=-1)
    local /= np.linalg.norm(local, axis=-1, keepdims=True)
    return local.reshape(-1, 3) @ data.cam_xmat[camera].reshape(3, 3).T


def c_rays(model, data, origin, rays, own_body):
    n = len(rays)
    group, one = np.array(GROUPS, np.uint8), np.array([-1], np.int32)
    multi_dist, multi_geom = np.full(n, -1.0), np.full(n, -1, np.int32)
    mujoco.mj_multiRay(
        model, data, origin, rays.ravel(), group, 1, own_body, multi_geom, multi_dist, None, n, mujoco.mjMAXVAL
    )
    dist, geom = np.full(n, -1.0), np.full(n, -1, np.int32)
    for i, ray in enumerate(rays):
        dist[i] = mujoco.mj_ray(model, data, origin, ray.copy(), group, 1, own_body, one)
        geom[i] = one[0]
    return {"ray_dist": dist, "ray_geom": geom, "multi_dist": multi_dist, "multi_geom": multi_geom}


def mjx_rays(model, data, origin, rays, own_body):
    one = lambda ray: mjx.ray(model, data, origin, ray, geomgroup=GROUPS, bodyexclude=own_body)
    dist, geom = jax.jit(jax.vmap(one))(jax.numpy.asarray(rays))
    return {"mjx_dist": np.asarray(dist), "mjx_geom": np.asarray(geom).astype(np.int32)}


def to_mjx(path: Path, model, data):
    """The scene in MJX, and why it refused it as it is, if it did."""
    try:
        return mjx.put_model(model), mjx.put_data(model, data), None
    except (NotImplementedError, ValueError, RuntimeError) as error:
        why = str(error)
    try:
        bare = mujoco.MjModel.from_xml_path(str(path))
        bare.geom_contype[:] = 0
        bare.geom_conaffinity[:] = 0
        bare_data = mujoco.MjData(bare)
        mujoco.mj_forward(bare, bare_data)
        return mjx.put_model(bare), mjx.put_data(bare, bare_data), f"mjx: {why} (rays compared without contacts)"
    except (NotImplementedError, ValueError, RuntimeError) as error:
        return None, None, f"mjx: {why} (without contacts: {error})"


def main(scene_dir: Path, out_dir: Path) -> None:
    out_dir.mkdir(parents=True, exist_ok=True)
    refused, left_out, geoms = {}, {}, {}
    for path in sorted(scene_dir.glob("*.xml")):
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            refused[path.stem] = f"mujoco: {error}"
            continue
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        geoms[path.stem] = [model.geom(i).name for i in range(model.ngeom)]
        arrays = {"geom_type": np.asarray(model.geom_type, np.int32)}
        mjx_model, mjx_data, why = to_mjx(path, model, data)
        if why is not None:
            refused[path.stem] = why
        for camera in range(model.ncam):
            name = model.camera(camera).name
            reason = None
            if model.cam_mode[camera] != mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
                reason = "it is not fixed to its body"
            elif model.cam_projection[camera] != mujoco.mjtProjection.mjPROJ_PERSPECTIVE:
                reason = "it is orthographic"
            if reason is not None:
                left_out.setdefault(path.stem, {})[name] = reason
                continue
            check_lens(model, data, camera)
            rays, origin = pixel_rays(model, data, camera), data.cam_xpos[camera].copy()
            own = int(model.cam_bodyid[camera]) or -1
            images = c_rays(model, data, origin, rays, own)
            if mjx_model is not None:
                images |= mjx_rays(mjx_model, mjx_data, origin, rays, own)
            for kind, image in images.items():
                arrays[f"{name}/{kind}"] = image.reshape(HEIGHT, WIDTH)
        np.savez(out_dir / f"{path.stem}.npz", **arrays)
    told = {package: version(package) for package in ("mujoco", "mujoco-mjx", "jax", "numpy")}
    told |= {"refused": refused, "left_out": left_out, "geoms": geoms}
    (out_dir / "versions.json").write_text(json.dumps(told, indent=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
