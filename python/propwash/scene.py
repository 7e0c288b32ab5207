"""What is in a scene."""

import json
from dataclasses import dataclass, fields
from typing import Any, Sequence, TypeVar, Union

T = TypeVar("T")
Named = TypeVar("Named", bound=Union["Geom", "Obstacle"])


@dataclass(frozen=True)
class Geom:
    """One geom of the compiled scene; its ``id`` is what depth images and contacts name."""

    id: int
    name: str
    """Empty where the scene gives none."""
    kind: str
    """plane, hfield, sphere, capsule, ellipsoid, cylinder, box, mesh or sdf."""
    body_id: int
    group: int
    alpha: float
    """Opacity that rays look at; 0 is not seen."""
    rgba: tuple[float, float, float, float]
    """Colour and opacity as MuJoCo draws it, 0 to 1: its own, or its material's by the mean of the texture."""
    contype: int
    conaffinity: int
    drone: int | None
    """The drone whose shell it belongs to."""
    asset: str | None
    """Mesh or height field that it shows."""
    size_m: tuple[float, float, float]
    """As in MJCF."""
    is_static: bool


@dataclass(frozen=True)
class Body:
    """One body of the compiled scene."""

    id: int
    name: str
    parent_id: int
    drone: int | None
    is_static: bool
    obstacle: int | None
    """The obstacle that moves it."""


@dataclass(frozen=True)
class SceneCamera:
    """One camera of the compiled scene; ``droneI/NAME`` for a camera of a shell."""

    id: int
    name: str
    body_id: int
    drone: int | None
    orthographic: bool
    fovy_deg: float
    resolution: tuple[int, int]
    """Width and height, pixels; (1, 1) where the scene gives none."""


@dataclass(frozen=True)
class Obstacle:
    """A body of the scene that can be moved: a mocap body, or one with a free joint of its own."""

    index: int
    """Its place in ``Sim.obstacle_pos`` and ``Sim.obstacle_quat``."""
    body_id: int
    name: str
    kind: str
    """mocap or free_joint."""
    pos_m: tuple[float, float, float]
    """Position in the model, m."""
    quat_xyzw: tuple[float, float, float, float]
    """Orientation in the model."""


@dataclass(frozen=True)
class SceneInfo:
    """A compiled scene with its drones."""

    name: str
    geoms: tuple[Geom, ...]
    bodies: tuple[Body, ...]
    cameras: tuple[SceneCamera, ...]
    obstacles: tuple[Obstacle, ...]
    warnings: tuple[str, ...]
    """What was overridden, ignored or doubtful when the scene was built."""
    sha256: str
    """Hash of the compiled model."""

    def geom(self, name: str) -> Geom:
        """The geom of this name.

        Raises:
            KeyError: if there is none.
        """
        return _by_name("geom", self.geoms, name)

    def obstacle(self, name: str) -> Obstacle:
        """The obstacle of this name.

        Raises:
            KeyError: if there is none.
        """
        return _by_name("obstacle", self.obstacles, name)


def _by_name(what: str, things: Sequence[Named], name: str) -> Named:
    for thing in things:
        if thing.name == name:
            return thing
    known = ", ".join(t.name for t in things if t.name) or "none with a name"
    raise KeyError(f"{what} {name!r} does not exist in this scene; there are: {known}")


def _made(kind: type[T], of: dict[str, Any]) -> T:
    names = [f.name for f in fields(kind)]  # type: ignore[arg-type]
    return kind(**{n: tuple(of[n]) if isinstance(of[n], list) else of[n] for n in names})


def scene_info(text: str) -> SceneInfo:
    """From the JSON of the compiled module."""
    of = json.loads(text)
    return SceneInfo(
        name=of["name"],
        geoms=tuple(_made(Geom, g) for g in of["geoms"]),
        bodies=tuple(_made(Body, b) for b in of["bodies"]),
        cameras=tuple(_made(SceneCamera, c) for c in of["cameras"]),
        obstacles=tuple(_made(Obstacle, o) for o in of["obstacles"]),
        warnings=tuple(of["warnings"]),
        sha256=of["sha256"],
    )
