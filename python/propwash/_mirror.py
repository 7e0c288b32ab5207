"""A world of a ``Sim`` in MuJoCo's own model and data, and pictures of it by MuJoCo's renderer."""

from __future__ import annotations

import atexit
import warnings
import weakref
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from . import _gl, _native
from .scene import SceneInfo
from .sense import Camera, _whole

if TYPE_CHECKING:
    from .sim import Sim

Array = NDArray[Any]
What = Literal["rgb", "segmentation", "depth"]

_drawing: weakref.WeakSet[Mirror] = weakref.WeakSet()
_SIZE = (640, 480)  # of pictures by cameras that state none
_FINE = (96, 48)  # corners around round things and along them, of labels and depth
_NEAR_M = 0.005  # nothing nearer is drawn


class Mirror:
    """One scene of a ``Sim``: where drones and obstacles stand in MuJoCo's arrays, and a model of its own to draw from."""

    def __init__(self, sim: Sim, scene: int) -> None:
        mjb = sim._native.scene_mjb(scene)  # raises where the Sim has no scene
        self.mujoco = _gl.load()
        self.info: SceneInfo = sim.scenes[scene]
        self.mjb = mjb
        self.model: Any = self.load()
        self.data: Any = self.mujoco.MjData(self.model)
        self.names = bytes(self.model.names)
        self.group = np.array(self.model.geom_group, np.int64).clip(0, 5)
        # In labels MuJoCo draws what has no alpha, which rays pass.
        self.solid = np.array([g.alpha != 0.0 for g in self.info.geoms], bool)
        self.visible_m: float = float(self.model.vis.map.zfar * self.model.stat.extent)
        self.corners = (int(self.model.vis.quality.numslices), int(self.model.vis.quality.numstacks))
        self.renderers: dict[bool, Any] = {}
        roots = [next(b.id for b in self.info.bodies if b.drone == d and b.parent_id == 0) for d in range(sim.n_drones)]
        free = [o for o in self.info.obstacles if o.kind == "free_joint"]
        mocap = [o for o in self.info.obstacles if o.kind == "mocap"]
        self.drones, self.drone_vel = self._joints(roots)
        self.free, _ = self._joints([o.body_id for o in free])
        self.free_rows = np.array([o.index for o in free], np.int64)
        self.mocap = np.array([self.model.body_mocapid[o.body_id] for o in mocap], np.int64)
        self.mocap_rows = np.array([o.index for o in mocap], np.int64)

    def _joints(self, bodies: list[int]) -> tuple[Array, Array]:
        """First places in ``qpos`` and ``qvel`` of bodies' free joints."""
        joints = np.array([self.model.body_jntadr[b] for b in bodies], np.int64)
        return np.array(self.model.jnt_qposadr, np.int64)[joints], np.array(self.model.jnt_dofadr, np.int64)[joints]

    def load(self) -> Any:
        """Another model of the scene."""
        return self.mujoco.MjModel.from_binary_path("scene.mjb", {"scene.mjb": self.mjb})

    def fits(self, model: Any, data: Any) -> bool:
        """Whether a model is this scene, and the data are of such a model."""
        sizes = ("nq", "nv", "nbody", "ngeom", "nmocap")
        same = isinstance(model, self.mujoco.MjModel) and all(getattr(model, n) == getattr(self.model, n) for n in sizes)
        whole = isinstance(data, self.mujoco.MjData) and data.qpos.size == self.model.nq and data.mocap_pos.size == 3 * self.model.nmocap
        return same and whole and bytes(model.names) == self.names

    def place(self, sim: Sim, world: int, model: Any, data: Any) -> None:
        """Writes where drones and obstacles of a world are, and what follows of it by kinematics."""
        now = sim.data
        pos, quat = (np.asarray(a[world], np.float64) for a in (now.pos, now.quat))
        others = [np.asarray(a[world]) for a in (sim.obstacle_pos, sim.obstacle_quat)]
        rows = len(self.info.obstacles)
        for name, array in (("pos", pos), ("quat", quat), ("obstacle_pos", others[0][:rows]), ("obstacle_quat", others[1][:rows])):
            if not np.isfinite(array).all():
                raise _native.Error(f"world {world} cannot be shown: {name} holds numbers that are not finite; reset the world or write others")
        _write(data.qpos, self.drones, pos, quat)
        _write(data.qpos, self.free, others[0][self.free_rows], others[1][self.free_rows])
        data.qvel[self.drone_vel[:, None] + np.arange(3)] = now.vel[world]
        data.qvel[self.drone_vel[:, None] + np.arange(3, 6)] = now.ang_vel[world]
        data.mocap_pos[self.mocap] = others[0][self.mocap_rows]
        data.mocap_quat[self.mocap] = others[1][self.mocap_rows][:, [3, 0, 1, 2]]
        data.time = float(now.steps[world]) / sim.freq
        mujoco = self.mujoco
        for follow in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight, mujoco.mj_flex, mujoco.mj_tendon):
            follow(model, data)

    # ---- drawing

    def _ready(self, size: tuple[int, int], fine: bool) -> Any:
        """The renderer for pictures of a width and height; ``fine``: with more corners of round things than MuJoCo gives them, which takes
        longer, so that their outlines are those of the depth image within a pixel."""
        r = self.renderers.get(fine)
        if r is not None and (r.width, r.height) == size:
            return r
        if r is not None:
            self.renderers.pop(fine).close()
        vis = self.model.vis
        extent = float(self.model.stat.extent)
        vis.map.znear, vis.map.zfar = _NEAR_M / extent, self.visible_m / extent
        vis.global_.offwidth, vis.global_.offheight = size
        least = _FINE if fine else (0, 0)
        vis.quality.numslices, vis.quality.numstacks = (max(pair) for pair in zip(self.corners, least))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # GLFW's, which the error says too
                self.renderers[fine] = self.mujoco.Renderer(self.model, size[1], size[0], max_geom=self.model.ngeom + 10_000)
        except Exception as e:
            raise _gl.no_gl(e) from e
        if not _drawing:
            # After the first context was made: what frees OpenGL itself at the end of the process runs later than this.
            atexit.register(_close_all)
        _drawing.add(self)
        return self.renderers[fine]

    def _background(self) -> float:
        """The depth that the renderer makes of nothing: the farthest, but for its rounding to float32."""
        vis, extent = self.model.vis.map, float(self.model.stat.extent)
        near, far = np.float32(vis.znear * extent), np.float32(vis.zfar * extent)
        c = np.float32(-0.5) * (-(far + near) / (far - near)) - np.float32(0.5)
        d = np.float32(-0.5) * (-(np.float32(2) * far * near) / (far - near))
        return float(d / c)

    def close(self) -> None:
        """Frees what was taken to draw."""
        while self.renderers:
            self.renderers.popitem()[1].close()

    def draw(self, view: View, what: What) -> Array:
        """The picture of a camera of what ``place`` wrote into ``data``."""
        r = self._ready(view.size, what != "rgb")
        # What the camera does not see goes into a group of its own, which is off.
        shown = np.array([g in view.groups for g in range(6)])[self.group]
        shown &= self.solid & ~view.hidden
        self.model.geom_group[:] = np.where(shown, 0, 5)
        option = self.mujoco.MjvOption()
        option.geomgroup[:] = [1, 0, 0, 0, 0, 0]
        option.sitegroup[:] = 0
        if what != "rgb":
            # Rays of depth images meet geoms alone.
            option.tendongroup[:] = option.flexgroup[:] = option.skingroup[:] = 0
        r.update_scene(self.data, scene_option=option)
        near, (fx, fy, cx, cy), (width, height) = _NEAR_M, view.lens, view.size
        for eye in r.scene.camera:
            eye.pos[:], eye.forward[:], eye.up[:] = view.pos, view.forward, view.up
            eye.orthographic = 0
            eye.frustum_center = near * (0.5 * width - cx) / fx
            eye.frustum_width = near * 0.5 * width / fx  # half of it
            eye.frustum_bottom, eye.frustum_top = near * (cy - height) / fy, near * cy / fy
            eye.frustum_near, eye.frustum_far = near, self.visible_m
        self.mujoco.mjv_makeLights(self.model, self.data, r.scene)  # the lamp at the camera
        r.disable_depth_rendering()
        r.disable_segmentation_rendering()
        if what == "rgb":
            return np.array(r.render())
        if what == "depth":
            r.enable_depth_rendering()
            depth = np.array(r.render())
            depth[depth >= 0.999 * self._background()] = np.inf
            return depth
        r.enable_segmentation_rendering()
        ids = r.render()
        return np.where(ids[..., 1] == int(self.mujoco.mjtObj.mjOBJ_GEOM), ids[..., 0], -1).astype(np.int32)


class View:
    """A camera at one moment."""

    def __init__(self, camera: Camera, size: tuple[int, int], k: Array, pos: Array, quat: Array, hidden: Array) -> None:
        self.size, self.pos, self.hidden, self.groups = size, pos, hidden, camera.groups
        self.lens = (k[0, 0], k[1, 1], k[0, 2], k[1, 2])
        x, y, z, w = quat
        self.forward = -np.array([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)])
        self.up = np.array([2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)])


def _close_all() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # GLFW's, where a window that closed has ended all of it before
        for one in list(_drawing):
            one.close()


def _write(qpos: Any, at: Array, pos: Array, quat: Array) -> None:
    """Poses into the places of free joints, whose quaternions are w x y z."""
    qpos[at[:, None] + np.arange(3)] = pos
    qpos[at[:, None] + np.arange(3, 7)] = quat[:, [3, 0, 1, 2]]


def mirror(sim: Sim, world: int) -> Mirror:
    """The scene that a world flies in."""
    world = _whole("world", world, 0, sim.n_worlds - 1)
    layout = sim._native.layout
    scene = layout[world] if layout else 0
    if scene not in sim._mirrors:
        sim._mirrors[scene] = Mirror(sim, scene)
    return sim._mirrors[scene]


def picture(
    sim: Sim, camera: str | Camera | None, what: What, world: int, size: tuple[int | None, int | None], keep: bool = True
) -> Array:
    """``Sim.render``; a camera that is another in every picture shall not be kept."""
    here = mirror(sim, world)
    wide, high = _sized(sim, here, camera, size)
    cameras, spec = sim._camera(camera, (wide, high), False, keep)
    pos, quat = sim._native.render(cameras, [world], {})
    one = cameras[sim._native.layout[world]]
    k = one.k()
    here.place(sim, world, here.model, here.data)
    if not one.per_drone:
        hidden = _own(here.info, spec, None)
        return here.draw(View(spec, (wide, high), k, pos[0], quat[0], hidden), what)
    views = [View(spec, (wide, high), k[d], pos[0, d], quat[0, d], _own(here.info, spec, d)) for d in range(sim.n_drones)]
    return np.stack([here.draw(view, what) for view in views])


def _own(info: SceneInfo, camera: Camera, drone: int | None) -> Array:
    """Geoms that the camera does not see since they carry it."""
    hidden = np.zeros(len(info.geoms), bool)
    if camera.sees_itself:
        return hidden
    body = 0
    if drone is None and camera.name is not None:
        carrier = next(c for c in info.cameras if c.name == camera.name)
        drone, body = carrier.drone, carrier.body_id
    if drone is not None:
        hidden[[g.id for g in info.geoms if g.drone == drone]] = True
    elif body != 0:
        hidden[[g.id for g in info.geoms if g.body_id == body]] = True
    return hidden


def _sized(sim: Sim, here: Mirror, camera: str | Camera | None, size: tuple[int | None, int | None]) -> tuple[int, int]:
    """Width and height of a picture: what is asked for, else what the camera states, else 640 x 480."""
    if (size[0] is None) != (size[1] is None):
        raise ValueError(f"width, height: expected both or neither, got width={size[0]!r}, height={size[1]!r}")
    if size[0] is not None and size[1] is not None:
        return _whole("width", size[0], 1, 16384), _whole("height", size[1], 1, 16384)
    if camera is None:
        camera = sim.camera or "fpv"
    of = Camera(camera) if isinstance(camera, str) else camera
    if not isinstance(of, Camera):
        raise TypeError(f"camera: expected the name of a camera or a propwash.Camera, got {type(camera).__name__}")
    if of.resolution is not None:
        return replace(of)._spec(False)["resolution"]  # type: ignore[no-any-return]
    stated = [c.resolution for c in here.info.cameras if of.name is not None and c.name in (of.name, f"drone0/{of.name}")]
    return stated[0] if stated and min(stated[0]) > 1 else _SIZE
