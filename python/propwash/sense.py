"""What drones see, touch and come near to."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Literal, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native

if TYPE_CHECKING:
    from .scene import SceneInfo

Kind = Literal["z_depth", "range"]
CasterName = Literal["native", "mujoco"]
FORWARD = (0.5, -0.5, -0.5, 0.5)
"""Quaternion of a camera that looks along body x, with body z up in the image."""


class PixelStatus(IntEnum):
    """What happened to the ray of a pixel: ``DepthFrame.status``."""

    HIT = 0
    """A surface between near and far; depth in metres."""
    MISS = 1
    """Nothing along the ray; depth is +inf."""
    TOO_FAR = 2
    """A surface beyond far; depth is +inf, ids and normal tell what it was."""
    TOO_NEAR = 3
    """A surface nearer than near; depth is 0, ids and normal tell what it was."""


@dataclass(frozen=True)
class Camera:
    """A depth camera.

    Either ``name``: a camera of the drones' shells (``"fpv"``: one on every drone) or of the scene (``"overview"``,
    ``"drone0/fpv"``). Or ``mount``: ``"drone"``, with ``pos`` and ``quat`` from camera to body, one on every drone;
    ``"world"``, with both from camera to world. A camera looks along its -z with y up; the default ``quat`` looks forward.

    A camera does not see the drone or body that carries it, unless ``sees_itself``.
    """

    name: str | None = None
    mount: str | None = None
    pos: tuple[float, float, float] | None = None
    """Position, m."""
    quat: tuple[float, float, float, float] = FORWARD
    """Orientation x y z w."""
    resolution: tuple[int, int] | None = None
    """Width and height, pixels; what the scene gives, or 64 x 64, where it is None."""
    fovy_deg: float | None = None
    """Vertical field of view, degrees; what the scene gives, or 90 for a mounted camera, where it is None."""
    pinhole_px: tuple[float, float, float, float] | None = None
    """fx, fy, cx, cy in pixels of ``resolution``, in place of ``fovy_deg``."""
    range: tuple[float, float] = (0.0, float("inf"))
    """Near and far limit, m."""
    kind: Kind = "z_depth"
    """``"z_depth"``: distance along the camera's axis, as depth cameras report it; ``"range"``: distance along the ray."""
    groups: tuple[int, ...] = (0, 1, 2)
    """Geom groups that it sees."""
    sees_itself: bool = False
    caster: CasterName = "native"
    """``"native"``, or ``"mujoco"``: MuJoCo's own rays, the slow reference."""

    def _spec(self, normals: bool) -> dict[str, Any]:
        near, far = _pair("range", self.range)
        groups = [_whole("groups", g, 0, 5) for g in self.groups]
        size = None
        if self.resolution is not None:
            size = tuple(_whole("resolution", n, 1, 16384) for n in _pair("resolution", self.resolution))
        placed = self.mount is not None
        return {
            "name": self.name,
            "mount": self.mount,
            "pos": _floats("pos", self.pos, 3) if placed and self.pos is not None else None,
            "quat": _floats("quat", self.quat, 4) if placed else None,
            "fovy_deg": None if self.fovy_deg is None else _float("fovy_deg", self.fovy_deg),
            "pinhole_px": None if self.pinhole_px is None else _floats("pinhole_px", self.pinhole_px, 4),
            "resolution": size,
            "near": _float("range", near),
            "far": _float("range", far),
            "kind": self.kind,
            "groups": [g in groups for g in range(6)],
            "sees_itself": bool(self.sees_itself),
            "caster": self.caster,
            "normals": normals,
        }


@dataclass(frozen=True, eq=False)
class PoseGradient:
    """What a loss gains by poses, world frame. ``...`` stands for what has the poses: cameras or drones."""

    pos: NDArray[np.float64]
    """By position, for each metre. (..., 3)"""
    rotation: NDArray[np.float64]
    """By turning about that position, for each radian about the axes of the world. (..., 3)"""
    quat: NDArray[np.float64]
    """The same by the numbers x y z w of the attitude, as ``Tape.pull_back`` takes them; nothing is gained by their length. (..., 4)"""


@dataclass(frozen=True, eq=False)
class DepthGradient:
    """What a loss of depth images gains by poses."""

    camera: PoseGradient
    """By the pose of each camera. (n_worlds, n_drones, ...) or (n_worlds, ...)"""
    drones: PoseGradient
    """By the pose of each drone: through the camera that it carries, and where others see it. (n_worlds, n_drones, ...)"""


@dataclass(frozen=True, eq=False)
class DepthSlopes:
    """What each depth gains by the pose of its camera."""

    pos: NDArray[np.float64]
    """By position, m/m, world. (..., height, width, 3)"""
    rotation: NDArray[np.float64]
    """By turning about that position, m/rad, axes of the world. (..., height, width, 3)"""
    known: NDArray[np.bool_]
    """Whether there are slopes; both are 0 where not. (..., height, width)"""


class _Seen:
    """What tells of ids of a scene."""

    scenes: tuple[SceneInfo, ...]

    @property
    def scene(self) -> SceneInfo:
        """What the ids stand for; of worlds in different scenes they are those of ``scenes[layout[k]]``."""
        if len(self.scenes) != 1:
            raise _native.Error(f"the worlds fly in {len(self.scenes)} scenes, each with ids of its own: take scenes[layout[world]]")
        return self.scenes[0]


@dataclass(frozen=True, eq=False)
class DepthFrame(_Seen):
    """Depth images with everything that is known about them.

    ``...`` stands for (n_worlds, n_drones) of cameras that drones carry, (n_worlds,) of others; rows are height, pixel (0, 0)
    is top left.
    """

    depth: NDArray[np.float32]
    """Depth, m, (..., height, width); see ``status`` for pixels without one."""
    status: NDArray[np.uint8]
    """``PixelStatus`` of each pixel, (..., height, width)."""
    geom_id: NDArray[np.int32]
    """Geom that was seen, -1 for none, (..., height, width)."""
    body_id: NDArray[np.int32]
    """Body that was seen, -1 for none, (..., height, width)."""
    normal: NDArray[np.float32] | None
    """Outward unit surface normal in the world, zero where nothing was seen, (..., height, width, 3)."""
    pos: NDArray[np.float64]
    """Position of the camera, m, (..., 3)."""
    quat: NDArray[np.float64]
    """Camera to world, x y z w, (..., 4); the camera looks along its -z with y up."""
    k: NDArray[np.float64]
    """Intrinsics in pixels, (n_drones, 3, 3) or (3, 3); image points have their origin at the outer corner of pixel (0, 0)."""
    kind: Kind
    """``"range"`` or ``"z_depth"``."""
    range: tuple[float, float]
    """Near and far limit, m."""
    worlds: NDArray[np.int64]
    """Worlds that were rendered, (n_worlds,)."""
    scenes: tuple[SceneInfo, ...]
    """All scenes of the simulation."""
    layout: NDArray[np.int64]
    """Which of them each world flies in, of those that were rendered. (n_worlds,)"""
    carrier: NDArray[np.int64]
    """The drone that each camera is fixed to, -1 for none, -2 for one that follows in another mode of MJCF than ``fixed``. (...)"""
    drone_pos: NDArray[np.float64]
    """Where the drones were, m, world. (n_worlds, n_drones, 3)"""
    drone_quat: NDArray[np.float64]
    """Their attitudes, x y z w. (n_worlds, n_drones, 4)"""

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Pixels with a depth, (..., height, width)."""
        return np.equal(self.status, PixelStatus.HIT)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Pixels whose depth has a slope: what is seen within the range, and not grazed by the ray (within 0.06 degrees). (..., height, width)

        Raises:
            ValueError: for a frame without normals.
        """
        return _native.depth_known(self._images())

    def slopes(self) -> DepthSlopes:
        """What each depth gains by the pose of its camera.

        By implicit differentiation at the surface that was seen, exact for every kind of geom. A pixel knows of its own ray alone: that an edge moves from one
        pixel to the next is in no slope.

        Raises:
            ValueError: for a frame without normals.
        """
        return DepthSlopes(*_native.depth_slopes(self._images()))

    def pull_back(self, seeds: ArrayLike) -> DepthGradient:
        """What a loss gains by the poses of cameras and drones, where it gains ``seeds`` by the depths.

        Things that are no drones stand where they are. ``drones`` goes on through a flight: ``tape.pull_back({"pos": g.drones.pos, ...})``.

        Args:
            seeds: Of the shape of ``depth``, or one that broadcasts to it; 0 where ``known`` is false.

        Raises:
            ValueError: for a frame without normals, another shape, seeds that are no numbers or not 0 where there is no slope, and a camera that
                follows in another mode than ``fixed``: how it moves with drones is not known.
        """
        own = _broadcast("seeds", seeds, self.depth.shape)
        if np.any(self.carrier == -2):
            raise ValueError("camera: expected one that is fixed to a drone or stands still, got one that follows in another mode (MJCF): take slopes()")
        drones = {
            "pos": self.drone_pos,
            "quat": self.drone_quat,
            "carrier": self.carrier.ravel().tolist(),
            "of_geom": [[-1 if geom.drone is None else geom.drone for geom in scene.geoms] for scene in self.scenes],
            "layout": self.layout.tolist(),
        }
        camera, flown = _native.depth_pull_back(self._images(), own, drones)
        return DepthGradient(PoseGradient(*camera), PoseGradient(*flown))

    def _images(self) -> dict[str, Any]:
        if self.normal is None:
            raise ValueError("slopes of depths need the normals of what was seen: make the frame with normals=True")
        own = {name: np.ascontiguousarray(getattr(self, name)) for name in ("depth", "status", "geom_id", "normal", "pos", "quat", "k")}
        return {**own, "z_depth": self.kind == "z_depth"}

    def geom_name(self, geom_id: int, k: int | None = None) -> str:
        """Name of a geom in this frame, in that of entry ``k`` of ``worlds`` where they fly in different scenes; empty for -1 and
        for geoms without one."""
        scene = self.scene if k is None else self.scenes[int(self.layout[k])]
        return "" if geom_id < 0 else scene.geoms[geom_id].name


@dataclass(frozen=True, eq=False)
class Contacts(_Seen):
    """All contacts of all drones, one entry for each, in the order of worlds. ``n`` is their number."""

    world: NDArray[np.int32]
    """The world. (n,)"""
    drone: NDArray[np.int32]
    """The drone; of two drones the one with the lower number. (n,)"""
    other_drone: NDArray[np.int32]
    """The other drone, -1 for a thing of the scene. (n,)"""
    drone_geom: NDArray[np.int32]
    """The geom of the drone. (n,)"""
    drone_body: NDArray[np.int32]
    """The body of the drone. (n,)"""
    other_geom: NDArray[np.int32]
    """What is touched; -1 for a flex. (n,)"""
    other_body: NDArray[np.int32]
    """The body of what is touched. (n,)"""
    other_flex: NDArray[np.int32]
    """-1 for a geom. (n,)"""
    distance: NDArray[np.float64]
    """Signed distance, m: negative in penetration, positive only within a contact margin that the scene sets. (n,)"""
    point: NDArray[np.float64]
    """Midpoint between the two surfaces, m, world. (n, 3)"""
    normal: NDArray[np.float64]
    """Unit normal from the other thing to the drone, world. (n, 3)"""
    limited: NDArray[np.int64]
    """Pairs of geoms that reached MuJoCo's limit of 50 contacts: where it is 0, none is missing. (n_worlds,)"""
    quarantined: NDArray[np.bool_]
    """Worlds that stand still since their numbers stopped being numbers: contacts are of the last good state. (n_worlds,)"""
    touching: NDArray[np.bool_]
    """Whether a drone touches anything (distance <= 0). (n_worlds, n_drones)"""
    scenes: tuple[SceneInfo, ...]
    """All scenes of the simulation."""
    layout: NDArray[np.int64]
    """Which of them each world flies in. (n_worlds,)"""

    def __len__(self) -> int:
        return len(self.world)


@dataclass(frozen=True, eq=False)
class Clearance(_Seen):
    """Nearest obstacle of every drone. Arrays are (n_worlds, n_drones), points (n_worlds, n_drones, 3)."""

    distance: NDArray[np.float64]
    """Signed distance, m: negative in penetration; the maximum asked for where nothing is nearer."""
    found: NDArray[np.bool_]
    """Whether anything is nearer than the maximum; ids and points mean nothing where it is false."""
    exact: NDArray[np.bool_]
    """False where ``distance`` is only a lower bound, or the depth of a height field may be greater."""
    drone_geom: NDArray[np.int32]
    """The geom of the drone that is nearest."""
    other_geom: NDArray[np.int32]
    """The geom of the obstacle."""
    other_body: NDArray[np.int32]
    """The body of the obstacle."""
    other_drone: NDArray[np.int32]
    """The drone that the nearest thing belongs to, -1 for none."""
    on_drone: NDArray[np.float64]
    """Closest point on the drone, m, world."""
    on_other: NDArray[np.float64]
    """Closest point on the obstacle, m, world."""
    known: NDArray[np.bool_]
    """Whether the distance has a slope: something was found, the distance is exact, and both do not just touch."""
    away: NDArray[np.float64]
    """Unit vector from the obstacle to the drone, world: along it the distance grows. Zero where ``known`` is false."""
    pos: NDArray[np.float64]
    """Where the drones were, m, world."""
    quat: NDArray[np.float64]
    """Their attitudes, x y z w. (n_worlds, n_drones, 4)"""
    quarantined: NDArray[np.bool_]
    """Worlds that stand still since their numbers stopped being numbers. (n_worlds,)"""
    scenes: tuple[SceneInfo, ...]
    """All scenes of the simulation."""
    layout: NDArray[np.int64]
    """Which of them each world flies in. (n_worlds,)"""

    def pull_back(self, seeds: ArrayLike) -> PoseGradient:
        """What a loss gains by the poses of drones, where it gains ``seeds`` by their distances. (n_worlds, n_drones, ...)

        Of two drones that are near each other both gain. Things that are no drones stand where they are.

        Args:
            seeds: (n_worlds, n_drones), or a shape that broadcasts to it; 0 where ``known`` is false.

        Raises:
            ValueError: for another shape, and seeds that are no numbers or not 0 where there is no slope.
        """
        own = _broadcast("seeds", seeds, self.distance.shape)
        wrong = np.argwhere(~np.isfinite(own) | ((own != 0) & ~self.known))
        if len(wrong):
            world, drone = wrong[0]
            raise ValueError(
                f"seeds: expected finite numbers, and 0 for distances without a slope, got {own[world, drone]} for drone {drone} of world {world} (found: "
                f"{self.found[world, drone]}, exact: {self.exact[world, drone]}, {self.distance[world, drone]:g} m); set seeds to 0 where known is false"
            )
        places = [np.ascontiguousarray(getattr(self, name)) for name in ("away", "on_drone", "on_other", "pos", "quat")]
        return PoseGradient(*_native.clearance_pull_back(own, places, np.ascontiguousarray(self.other_drone)))


@dataclass(frozen=True, eq=False)
class Swept(_Seen):
    """What drones touched first on their way, one entry for each that touched something, in the order of worlds. ``n`` is their number."""

    world: NDArray[np.int32]
    """The world. (n,)"""
    drone: NDArray[np.int32]
    """The drone. Two that met have an entry each. (n,)"""
    fraction: NDArray[np.float64]
    """Where on the way it touched, 0 (where it came from) to 1 (where it is now); 0 for one that touched at the start. (n,)"""
    pos: NDArray[np.float64]
    """Where the drone was then, m, world. (n, 3)"""
    drone_geom: NDArray[np.int32]
    """The geom of the drone. (n,)"""
    other_geom: NDArray[np.int32]
    """What is touched. (n,)"""
    other_body: NDArray[np.int32]
    """The body of what is touched. (n,)"""
    other_drone: NDArray[np.int32]
    """The other drone, -1 for a thing of the scene. (n,)"""
    point: NDArray[np.float64]
    """Where it is touched, m, world. (n, 3)"""
    normal: NDArray[np.float64]
    """Unit normal from the other thing to the drone, world; zero where the two overlapped at the start. (n, 3)"""
    exact: NDArray[np.bool_]
    """False where the touch may be early (signed distance fields). (n,)"""
    quarantined: NDArray[np.bool_]
    """Worlds that stand still since their numbers stopped being numbers. (n_worlds,)"""
    touched: NDArray[np.bool_]
    """Whether a drone touched anything. (n_worlds, n_drones)"""
    scenes: tuple[SceneInfo, ...]
    """All scenes of the simulation."""
    layout: NDArray[np.int64]
    """Which of them each world flies in. (n_worlds,)"""

    def __len__(self) -> int:
        return len(self.world)


def _whole(name: str, value: object, low: int, high: int) -> int:
    """An integer between bounds; booleans and floats are none."""
    if isinstance(value, (bool, np.bool_)) or not hasattr(value, "__index__"):
        raise TypeError(f"{name}: expected an integer from {low} to {high}, got {value!r} ({type(value).__name__})")
    number = value.__index__()
    if not low <= number <= high:
        raise ValueError(f"{name}: expected an integer from {low} to {high}, got {number}")
    return int(number)


def _float(name: str, value: object) -> float:
    if isinstance(value, (bool, str, bytes)):
        raise TypeError(f"{name}: expected a number, got {value!r} ({type(value).__name__})")
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise TypeError(f"{name}: expected a number, got {value!r} ({type(value).__name__})") from None


def _floats(name: str, value: Any, n: int) -> list[float]:
    try:
        numbers = [_float(name, v) for v in value]
    except TypeError:
        raise TypeError(f"{name}: expected {n} numbers, got {value!r}") from None
    if len(numbers) != n:
        raise ValueError(f"{name}: expected {n} numbers, got {len(numbers)}")
    return numbers


def _pair(name: str, value: Sequence[Any]) -> tuple[Any, Any]:
    try:
        first, second = value
    except (TypeError, ValueError):
        raise TypeError(f"{name}: expected a pair of numbers, got {value!r}") from None
    return first, second


def _broadcast(name: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name}: expected real numbers, got {type(value).__name__} of dtype {array.dtype}")
    try:
        return np.array(np.broadcast_to(array, shape), np.float64, order="C")
    except ValueError:
        raise ValueError(f"{name}: expected shape {shape}, or one that broadcasts to it, got {array.shape}") from None
