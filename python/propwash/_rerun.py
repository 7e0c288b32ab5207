"""Flights and scenes for the viewer of Rerun (rerun.io), as recordings (.rrd)."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Union

import numpy as np
from numpy.typing import NDArray

from . import _gl, _native
from ._optional import need
from ._write import may_write
from .datasets import DataSet, World
from .datasets import open as open_data_set
from .sense import PixelStatus, _whole
from .sim import Sim, _path

if TYPE_CHECKING:
    import pyarrow  # type: ignore[import-not-found, import-untyped, unused-ignore]

Array = NDArray[Any]
Shown = Union[Sim, DataSet, str, "os.PathLike[str]"]

_NOTHING = 65535  # class of pixels without a geom; ids of geoms are the classes of the others
_ARROW_M = 0.1  # length of a contact's normal
_BATCH_BYTES = 8e6  # of images in one chunk of the file
_PLANE_M = 5.0  # half the width of planes without an end, at least
_SEEN_GROUPS = 3  # groups 0, 1, 2 are what cameras and MuJoCo's window show


def write_rerun(source: Shown, path: str | os.PathLike[str], *, world: int = 0, spawn: bool = False, force: bool = False) -> Path:
    """Writes a recording (.rrd) for the viewer of Rerun, https://rerun.io.

    Of a data set, one world: the scene, poses, paths, velocities and clearances of the drones, contacts, depth images and labels, over the
    timeline ``time``, s from the start. Of a ``Sim``, the scene of a world, drones and obstacles where they are now.

    Lengths are in m, world z is up. docs/datasets.md lists the entities.

    Args:
        source: A ``Sim``, a data set, or its folder.
        path: The file, whose name ends with ``.rrd``. It is written whole or not at all.
        world: Number of the world.
        spawn: Opens the viewer of the package ``rerun-sdk`` with the file.
        force: Replaces a file that is there.

    Returns:
        Path of the file.

    Raises:
        ImportError: without ``rerun-sdk``: ``pip install 'propwash[rerun]'``.
        ValueError: for a name that does not end with ``.rrd``, and a number that is no world's.
        FileExistsError: where there is a file, without ``force``.
        KeyError: for a world that an unfinished data set lacks.
        Error: for a world of a ``Sim`` whose numbers are not finite, and a scene that another version of MuJoCo compiled.
    """
    place = Path(_path("path", path))
    if place.suffix.lower() != ".rrd":
        raise ValueError(f"path: expected a name that ends with .rrd, got {str(place)!r}")
    may_write(place, force)
    rr = need("rerun", "rerun", "a recording for Rerun")
    if not isinstance(source, Sim):
        data = source if isinstance(source, DataSet) else open_data_set(_path("source", source))
        one = data.world(world)
    else:
        world = _whole("world", world, 0, source.n_worlds - 1)
    n_drones = source.n_drones if isinstance(source, Sim) else data.manifest["n_drones"]
    partial = place.with_name(f".partial_{place.stem}.{os.getpid()}.rrd")
    try:
        log = rr.RecordingStream("propwash")
        try:
            log.save(str(partial), default_blueprint=_blueprint(n_drones))
            log.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            if isinstance(source, Sim):
                _Log(rr, log).sim(source, world)
            else:
                _Log(rr, log).flight(data, one)
        finally:
            log.disconnect()  # writes what is left, and closes the file
        os.replace(partial, place)
    finally:
        partial.unlink(missing_ok=True)
    if spawn:
        subprocess.Popen([sys.executable, "-m", "rerun", "--bind", "127.0.0.1", str(place)], start_new_session=True)
    return place


def _blueprint(n_drones: int) -> Any:
    """How the viewer lays it out: the world beside images and plots; noisy images are not shown until they are asked for."""
    views = need("rerun.blueprint", "rerun")
    images = views.Spatial2DView(origin="world/cameras/drone0", contents=["$origin/depth", "$origin/labels"], name="depth of drone 0")
    space = ["$origin/**", *(f"- $origin/cameras/drone{d}/depth_noisy" for d in range(n_drones))]
    plots = [views.TimeSeriesView(origin=f"plots/{name}", name=name) for name in ("velocity", "clearance")]
    side = views.Vertical(images, *plots)
    return views.Blueprint(views.Horizontal(views.Spatial3DView(origin="world", contents=space, name="world"), side, column_shares=[2, 1]))


class _Log:
    """What is written into one recording."""

    def __init__(self, rr: Any, log: Any) -> None:
        self.rr, self.log = rr, log

    def columns(self, entity: str, time_s: Array, columns: Any) -> None:
        if len(time_s):
            self.log.send_columns(entity, indexes=[self.rr.TimeColumn("time", duration=time_s)], columns=columns)

    def poses(self, entity: str, time_s: Array, pos: Array, quat_xyzw: Array) -> None:
        self.columns(entity, time_s, self.rr.Transform3D.columns(translation=pos, quaternion=quat_xyzw))

    # ---- a Sim

    def sim(self, sim: Sim, world: int) -> None:
        now = sim.time[world : world + 1]
        if sim.scenes:
            model, _ = sim.mujoco(world)
            for o, (entity, _) in enumerate(self.scene(model, sim.n_drones)):
                self.poses(entity, now, sim.obstacle_pos[world, o][None], sim.obstacle_quat[world, o][None])
        for d in range(sim.n_drones):
            pos, quat = (np.asarray(a[world, d], np.float64) for a in (sim.data.pos, sim.data.quat))
            if not (np.isfinite(pos).all() and np.isfinite(quat).all()):
                raise _native.Error(f"world {world} cannot be shown: the pose of drone {d} is not finite; reset the world or write another")
            self.poses(f"world/drone{d}", now, pos[None], quat[None])

    # ---- a world of a data set

    def flight(self, data: DataSet, world: World) -> None:
        manifest, obstacles = data.manifest, []
        self.names(manifest)
        if "mjb_sha256" in manifest["scene"]:
            obstacles = self.scene(_compiled(data), manifest["n_drones"])
        elif manifest["geoms"]:
            text = f"{data.path}: the data set is of a version that did not keep its scene: the recording shows none; fly it again to have it"
            warnings.warn(text, stacklevel=3)
        self.drones(manifest, world)
        if manifest["flight"]["clearance_every_steps"] > 0:
            for d, rows in _by_drone(world.clearance(["t", "drone", "distance"]), manifest["n_drones"]):
                self.log.log(f"plots/clearance/drone{d}", self.rr.SeriesLines(names=[f"drone {d}, m"]), static=True)
                self.columns(f"plots/clearance/drone{d}", rows["t"], self.rr.Scalars.columns(scalars=rows["distance"]))
        if manifest["flight"]["contact_every_steps"] > 0:
            self.contacts(manifest, world)
        moved = bool(manifest.get("obstacles")) and bool(manifest["cameras"])
        for o, (entity, rest) in enumerate(obstacles):
            if moved:
                pos, quat = (world.frames(f"obstacle_{name}")[:, o] for name in ("pos_m", "quat_xyzw"))
                self.poses(entity, world.frames("time_s"), pos, quat)
            else:  # nothing says where they were: where the scene has them
                self.poses(entity, np.zeros(1), rest[None, :3], rest[None, 3:])
        for d, camera in enumerate(manifest["cameras"]):
            self.camera(camera, world, d, manifest)

    def names(self, manifest: Mapping[str, Any]) -> None:
        """Names of the classes in labels."""
        classes = [(g["id"], _name(g)) for g in manifest["geoms"] if g["id"] < _NOTHING]
        self.log.log("world", self.rr.AnnotationContext([*classes, (_NOTHING, "nothing", (0, 0, 0, 0))]), static=True)

    def drones(self, manifest: Mapping[str, Any], world: World) -> None:
        """Poses, paths and velocities."""
        rr, columns = self.rr, ["t", "drone", "px", "py", "pz", "qx", "qy", "qz", "qw", "vx", "vy", "vz"]
        for d, rows in _by_drone(world.states(columns), manifest["n_drones"]):
            pos, quat, vel = (np.stack([rows[c] for c in names], axis=-1) for names in (columns[2:5], columns[5:9], columns[9:]))
            self.poses(f"world/drone{d}", rows["t"], pos, quat)
            self.log.log(f"world/paths/drone{d}", rr.LineStrips3D([pos]), static=True)
            names = [f"drone {d} {c}, m/s" for c in ("vx", "vy", "vz")]
            self.log.log(f"plots/velocity/drone{d}", rr.SeriesLines(names=names), static=True)
            self.columns(f"plots/velocity/drone{d}", rows["t"], rr.Scalars.columns(scalars=vel))

    def contacts(self, manifest: Mapping[str, Any], world: World) -> None:
        """Points and normals of each step with contacts, until the next recorded step without any."""
        rr, names, n_drones = self.rr, [_name(g) for g in manifest["geoms"]], manifest["n_drones"]
        recorded = dict(_by_drone(world.states(["t", "step", "drone"]), n_drones))
        columns = ["t", "step", "drone", "x", "y", "z", "nx", "ny", "nz", "geom2"]
        for d, rows in _by_drone(world.contacts(columns), n_drones):
            steps, first, counts = np.unique(rows["step"], return_index=True, return_counts=True)
            after = np.searchsorted(recorded[d]["step"], steps, side="right")
            after = np.unique(after[after < len(recorded[d]["step"])])
            after = after[~np.isin(recorded[d]["step"][after], steps)]
            time_s = np.concatenate([rows["t"][first], recorded[d]["t"][after]])
            order = np.argsort(time_s)
            lengths = np.concatenate([counts, np.zeros(len(after), np.int64)])[order]
            point, normal = (np.stack([rows[c] for c in n], axis=-1) for n in (("x", "y", "z"), ("nx", "ny", "nz")))
            text = [names[int(g)] if g >= 0 else "flex" for g in rows["geom2"]]
            entity, color = f"world/contacts/drone{d}", (230, 60, 0)
            self.log.log(entity, rr.Arrows3D.from_fields(show_labels=False, colors=[color]), static=True)
            self.log.log(entity, rr.Points3D.from_fields(radii=[0.01], colors=[color]), static=True)
            arrows = rr.Arrows3D.columns(origins=point, vectors=_ARROW_M * normal, labels=text).partition(lengths)
            self.columns(entity, time_s[order], [*arrows, *rr.Points3D.columns(positions=point).partition(lengths)])

    def camera(self, camera: Mapping[str, Any], world: World, drone: int, manifest: Mapping[str, Any]) -> None:
        """Poses, lens, depth along the camera's axis, and geoms of the pixels."""
        rr, entity, size = self.rr, f"world/cameras/drone{drone}", (camera["width"], camera["height"])
        k, time_s = np.array(camera["k"], np.float64), world.frames("time_s")
        # The camera's frame stays MuJoCo's, which Rerun is told: x right, y up, z back.
        lens = rr.Pinhole(image_from_camera=k, resolution=size, camera_xyz=rr.ViewCoordinates.RUB, image_plane_distance=0.3)
        self.log.log(entity, lens, static=True)
        self.poses(entity, time_s, world.frames("camera_pos_m")[:, drone], world.frames("camera_quat_xyzw")[:, drone])
        x, y = (np.arange(size[0]) + 0.5 - k[0, 2]) / k[0, 0], (np.arange(size[1]) + 0.5 - k[1, 2]) / k[1, 1]
        along = np.sqrt(1.0 + x[None] ** 2 + y[:, None] ** 2) if camera["kind"] == "range" else np.ones((size[1], size[0]))
        fixed = {"meter": 1.0, "depth_range": (camera["near_m"], camera["far_m"])}
        noisy = [("depth_noisy", "depth_noisy_m", "status_noisy")] if manifest["noise"] else []
        for name, depth, status in [("depth", "depth_m", "status"), *noisy]:
            hit = np.equal(world.frames(status)[:, drone], PixelStatus.HIT)
            made = (np.where(h, v / along, 0.0).astype(np.float32) for h, v in zip(hit, world.frames(depth)[:, drone]))
            self.images(f"{entity}/{name}", rr.DepthImage, "F32", size, time_s, made, fixed)
        n = len(manifest["geoms"])
        if n > _NOTHING:
            warnings.warn(f"labels are left out: expected at most {_NOTHING} geoms, which Rerun can number, found {n}", stacklevel=4)
            return
        ids = (np.where(g < 0, _NOTHING, g).astype(np.uint16) for g in world.frames("geom_id")[:, drone])
        self.images(f"{entity}/labels", rr.SegmentationImage, "U16", size, time_s, ids, {"opacity": 0.5})

    def images(
        self, entity: str, kind: Any, number: str, size: tuple[int, int], time_s: Array, images: Iterator[Array], fixed: dict[str, Any]
    ) -> None:
        """Images of one size, some at a time."""
        form = self.rr.components.ImageFormat(width=size[0], height=size[1], color_model="L", channel_datatype=number)
        self.log.log(entity, kind.from_fields(format=form, **fixed), static=True)
        held: list[Array] = []
        for f, image in enumerate(images):
            held.append(np.ascontiguousarray(image).view(np.uint8).reshape(-1))
            if len(held) * held[0].nbytes > _BATCH_BYTES or f + 1 == len(time_s):
                self.columns(entity, time_s[f + 1 - len(held) : f + 1], kind.columns(buffer=np.stack(held)))
                held = []

    # ---- the scene

    def scene(self, model: Any, n_drones: int) -> list[tuple[str, Array]]:
        """Every geom that cameras may see: in the world, or in the frame of the drone or obstacle that carries it.

        Gives the entities of the obstacles, and where the scene has them: x, y, z (m), and the quaternion x y z w. (7,)
        """
        mujoco = _gl.load()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        drones, obstacles = _carriers(self.rr, model, n_drones)
        carriers = {**drones, **obstacles}
        for g in range(model.ngeom):
            if _alpha(model, g) == 0.0 or model.geom_group[g] >= _SEEN_GROUPS:
                continue
            body = int(model.geom_bodyid[g])
            while body and body not in carriers:
                body = int(model.body_parentid[body])
            turn = data.xmat[body].reshape(3, 3)
            pos, mat = turn.T @ (data.geom_xpos[g] - data.xpos[body]), turn.T @ data.geom_xmat[g].reshape(3, 3)
            name = model.geom(g).name or f"geom {g}"
            own = name.split("/", 1)[1] if body in drones and "/" in name else name
            entity = f"{carriers.get(body, 'world/scene')}/{self.rr.escape_entity_path_part(own)}"
            place = self.rr.Transform3D.from_fields(translation=pos, mat3x3=mat)
            self.log.log(entity, place, _shape(self.rr, mujoco, model, g), static=True)
        return [(entity, np.concatenate([data.xpos[b], data.xquat[b][[1, 2, 3, 0]]])) for b, entity in obstacles.items()]


def _compiled(data: DataSet) -> Any:
    """The compiled scene of a data set."""
    found, ours = data.manifest["mujoco_version"], _native.mujoco_version()
    if found != ours:
        raise _native.Error(f"{data.path}: expected a scene compiled by MuJoCo {ours}, found one of {found}; read it with that version")
    return _gl.load().MjModel.from_binary_path(str(data.scene_path()))


def _by_drone(table: pyarrow.Table, n_drones: int) -> Iterator[tuple[int, dict[str, Array]]]:
    """Rows of each drone; empty cells are NaN."""
    columns = {name: np.asarray(table[name].to_numpy()) for name in table.column_names}
    for d in range(n_drones):
        own = columns["drone"] == d
        yield d, {name: values[own] for name, values in columns.items()}


def _name(geom: Mapping[str, Any]) -> str:
    """Of a geom of a manifest."""
    return geom["name"] or f"{geom['type']} {geom['id']}"


def _carriers(rr: Any, model: Any, n_drones: int) -> tuple[dict[int, str], dict[int, str]]:
    """Bodies of drones and of obstacles, and their entities; obstacles in the order of ``SceneInfo.obstacles``."""
    drones = {int(model.body(f"drone{d}/drone").id): f"world/drone{d}" for d in range(n_drones)}
    obstacles = {}
    for body in range(1, model.nbody):
        free = model.body_jntnum[body] == 1 and model.jnt_type[model.body_jntadr[body]] == _gl.load().mjtJoint.mjJNT_FREE
        if int(model.body_rootid[body]) not in drones and (model.body_mocapid[body] >= 0 or free):
            name = model.body(body).name or f"body#{body}"
            obstacles[body] = f"world/obstacles/{rr.escape_entity_path_part(name)}"
    return drones, obstacles


def _alpha(model: Any, geom: int) -> float:
    """Opacity that rays look at (``Geom.alpha``)."""
    material = int(model.geom_matid[geom])
    return float(model.geom_rgba[geom, 3] if material < 0 else model.mat_rgba[material, 3])


def _color(model: Any, geom: int) -> Array:
    """Colour and opacity as MuJoCo draws it, 0 to 1: its own, or its material's by the mean of the texture (``Geom.rgba``)."""
    rgba, material = np.array(model.geom_rgba[geom], np.float64), int(model.geom_matid[geom])
    if material < 0:
        return rgba
    if (rgba == (0.5, 0.5, 0.5, 1.0)).all():
        rgba = np.array(model.mat_rgba[material], np.float64)
    roles = _gl.load().mjtTextureRole
    texture = next((int(t) for t in model.mat_texid[material][[int(roles.mjTEXROLE_RGB), int(roles.mjTEXROLE_RGBA)]] if t >= 0), None)
    if texture is not None:
        n, start = int(model.tex_nchannel[texture]), int(model.tex_adr[texture])
        pixels = model.tex_data[start : start + int(model.tex_height[texture]) * int(model.tex_width[texture]) * n].reshape(-1, n)
        rgba[:3] *= pixels[:, [0, 0, 0] if n < 3 else [0, 1, 2]].mean(axis=0) / 255.0
    return rgba


def _shape(rr: Any, mujoco: Any, model: Any, geom: int) -> Any:
    """A geom in its own frame."""
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), np.array(model.geom_size[geom])
    color = np.round(255.0 * np.clip(_color(model, geom), 0.0, 1.0)).astype(np.uint8)
    solid = {"colors": [color], "fill_mode": rr.components.FillMode.Solid}
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return rr.Boxes3D(half_sizes=[size], **solid)
    if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        return rr.Ellipsoids3D(half_sizes=[size[[0, 0, 0]] if kind == mujoco.mjtGeom.mjGEOM_SPHERE else size], **solid)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return rr.Cylinders3D(lengths=[2.0 * size[1]], radii=[size[0]], **solid)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:  # which Rerun begins at one end
        return rr.Capsules3D(lengths=[2.0 * size[1]], radii=[size[0]], translations=[(0.0, 0.0, -size[1])], **solid)
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        x, y = (s if s > 0.0 else max(_PLANE_M, 2.0 * float(model.stat.extent)) for s in size[:2])
        vertices, faces = np.array([(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)]), np.array([(0, 1, 2), (0, 2, 3)])
    elif kind == mujoco.mjtGeom.mjGEOM_HFIELD:
        vertices, faces = _hfield(model, int(model.geom_dataid[geom]))
    else:  # meshes, and signed distance fields by theirs
        mesh = int(model.geom_dataid[geom])
        at, first = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
        vertices = model.mesh_vert[at : at + int(model.mesh_vertnum[mesh])]
        faces = model.mesh_face[first : first + int(model.mesh_facenum[mesh])]
    return rr.Mesh3D(vertex_positions=vertices, triangle_indices=faces, albedo_factor=color)


def _hfield(model: Any, field: int) -> tuple[Array, Array]:
    """A height field with its sides and base: corners, m, and triangles."""
    rows, columns, start = int(model.hfield_nrow[field]), int(model.hfield_ncol[field]), int(model.hfield_adr[field])
    x_m, y_m, high, base = model.hfield_size[field]
    z = high * model.hfield_data[start : start + rows * columns]
    y, x = np.meshgrid(np.linspace(-y_m, y_m, rows), np.linspace(-x_m, x_m, columns), indexing="ij")
    top = np.stack([x.reshape(-1), y.reshape(-1), z], axis=-1)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (index[r, k].reshape(-1) for r in (slice(-1), slice(1, None)) for k in (slice(-1), slice(1, None)))
    faces = [np.stack([a, b, d], axis=-1), np.stack([a, d, c], axis=-1)]
    # Once around the border, and the same below.
    ring = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
    below, following = rows * columns + np.arange(len(ring)), np.roll(np.arange(len(ring)), -1)
    faces += [np.stack([ring, below, below[following]], axis=-1), np.stack([ring, below[following], ring[following]], axis=-1)]
    bottom = top[ring] * (1.0, 1.0, 0.0) - (0.0, 0.0, base)
    p, q, r, s = below[np.cumsum([0, columns - 1, rows - 1, columns - 1])]
    faces.append(np.array([(p, r, q), (p, s, r)]))
    return np.concatenate([top, bottom]), np.concatenate(faces)
