"""Pictures of environments: a camera that follows the first drone, with its trail and its goal drawn in."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _native
from ..learn import Goal
from .._size import radius
from ..scene import SceneInfo, scene_info
from ..sense import Camera, DepthFrame
from ..sim import Sim
from .task import Task

Array = NDArray[Any]

#: Seconds of flight that the trail shows.
TRAIL_S = 3.0
#: Colours of drones, 0 to 1, by turns; the first is that of the drone that the camera follows.
DRONES = ((0.95, 0.25, 0.05), (0.55, 0.20, 0.75), (0.05, 0.55, 0.65), (0.85, 0.55, 0.00), (0.80, 0.15, 0.50), (0.35, 0.35, 0.40))
#: Colours of the trail of the first drone, and of its goal.
TRAIL = (0.05, 0.20, 0.90)
GOAL = (0.00, 0.72, 0.20)

_SHARE = 0.06  # of the picture's width that the drone takes
# Of the camera, degrees: its height, seen from the drone; where it looks, below the horizon; its vertical field of view.
_CHASE = (24.0, 14.0, 50.0)
_IN_ROOMS = (52.0, 38.0, 80.0)  # which are looked into from above
_TURN_RAD_S = 1.2  # at most, of the camera
_HORIZON, _ZENITH = np.array([0.87, 0.91, 0.95], np.float32), np.array([0.35, 0.60, 0.95], np.float32)
_LIGHT = np.array([-0.35, -0.45, 0.82], np.float32)
_STATES_NONE = (0.5, 0.5, 0.5, 1.0)  # the colour of geoms whose scene gives them none
_FLOOR = """<mujoco model="floor"><worldbody><geom name="ground" type="plane" size="0 0 0.1"/></worldbody></mujoco>"""


class Picture:
    """A picture that lines and spheres are drawn into, hidden behind what is nearer."""

    def __init__(self, eye: Array, turn: Array, focal: float, colors: Array, depth: Array) -> None:
        self.eye, self.turn, self.focal = eye, turn, focal
        self.height, self.width = depth.shape
        self.colors, self.depth = colors, depth

    def project(self, points: Array) -> tuple[Array, Array]:
        """Places in the picture, px from its upper left corner, and distances along the view, m, of points of the world. (n, 2), (n,)"""
        seen = (np.asarray(points, np.float64) - self.eye) @ self.turn
        z = -seen[:, 2]
        at = np.maximum(z, 1e-3)[:, None]
        middle = np.array([0.5 * self.width, 0.5 * self.height])
        return middle + self.focal * seen[:, :2] * [1.0, -1.0] / at, z

    def shows(self, at: Array, z: float, margin: float = 0.0) -> bool:
        """Whether a place lies in the picture, ``margin`` pixels from its edge."""
        x, y = at
        return z > 0.05 and margin <= x <= self.width - margin and margin <= y <= self.height - margin

    def line(self, points: Array, color: Sequence[float], px: float, alpha: Any = 1.0, hidden: float = 0.0) -> None:
        """A line through points of the world, (n, 3), ``px`` wide; ``hidden`` of its strength is left behind things."""
        points = np.asarray(points, np.float64)
        if len(points) < 2:
            return
        alpha = np.broadcast_to(np.asarray(alpha, np.float64), (len(points),))
        # What lies behind the camera is cut off.
        z = -((points - self.eye) @ self.turn)[:, 2]
        near = 0.05
        a, b, za, zb, fa, fb = points[:-1], points[1:], z[:-1], z[1:], alpha[:-1], alpha[1:]
        keep = (za > near) | (zb > near)
        if not keep.any():
            return
        a, b, za, zb, fa, fb = (x[keep] for x in (a, b, za, zb, fa, fb))
        span = np.where(np.abs(zb - za) < 1e-12, 1.0, zb - za)
        ta = np.where(za > near, 0.0, (near - za) / span)[:, None]
        tb = np.where(zb > near, 1.0, (near - za) / span)[:, None]
        a, b = a + ta * (b - a), a + tb * (b - a)
        (pa, za), (pb, zb) = self.project(a), self.project(b)
        steps = np.clip(np.ceil(1.5 * np.linalg.norm(pb - pa, axis=1)), 1, 4000).astype(np.int64)
        which = np.repeat(np.arange(len(steps)), steps)
        t = (np.arange(len(which)) - np.repeat(np.cumsum(steps) - steps, steps) + 0.5) / steps[which]
        at = pa[which] + t[:, None] * (pb - pa)[which]
        inverse = (1.0 / za)[which] * (1.0 - t) + (1.0 / zb)[which] * t
        self.dots(at, 1.0 / inverse, color, px, fa[which] * (1.0 - t) + fb[which] * t, hidden)

    def dots(self, at: Array, z: Array, color: Sequence[float], px: float, alpha: Any = 1.0, hidden: float = 0.0) -> None:
        """Round dots at places in the picture, each ``px`` wide; what they cover together is painted once."""
        r = 0.5 * px
        reach = int(np.ceil(r + 0.5))
        inside = (at > -reach).all(axis=1) & (at < [self.width + reach, self.height + reach]).all(axis=1)
        at, z = at[inside], z[inside]
        alpha = np.broadcast_to(np.asarray(alpha, np.float64), inside.shape)[inside]
        if len(at) == 0:
            return
        off = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), axis=-1).reshape(-1, 2)
        cell = np.floor(at).astype(np.int64)[:, None] + off
        cover = np.clip(r + 0.5 - np.linalg.norm(cell + 0.5 - at[:, None], axis=-1), 0.0, 1.0) * alpha[:, None]
        x, y = cell[..., 0], cell[..., 1]
        cover[(x < 0) | (y < 0) | (x >= self.width) | (y >= self.height)] = 0.0
        where = np.clip(y, 0, self.height - 1) * self.width + np.clip(x, 0, self.width - 1)
        behind = z[:, None] > 1.01 * self.depth.ravel()[where] + 0.02
        cover = np.where(behind, hidden * cover, cover)
        some = cover > 0.0
        self._paint(where[some], cover[some], color)

    def _paint(self, where: Array, cover: Array, color: Sequence[float]) -> None:
        mask = np.zeros(self.width * self.height, np.float32)
        np.maximum.at(mask, where, cover.astype(np.float32))
        touched = np.flatnonzero(mask)
        m = mask[touched, None]
        flat = self.colors.reshape(-1, 3)
        flat[touched] += m * (np.asarray(color, np.float32) - flat[touched])

    def sphere(self, middle: Array, radius: float, color: Sequence[float], hidden: float = 0.0) -> None:
        """A shaded sphere, m, at least four pixels in radius."""
        (at,), (z,) = self.project(np.asarray(middle)[None])
        if z < 0.1:
            return
        r = max(self.focal * radius / z, 4.0)
        x0, x1 = (int(np.clip(v, 0, self.width)) for v in (at[0] - r - 1, at[0] + r + 2))
        y0, y1 = (int(np.clip(v, 0, self.height)) for v in (at[1] - r - 1, at[1] + r + 2))
        if x0 >= x1 or y0 >= y1:
            return
        dx = (np.arange(x0, x1) + 0.5 - at[0])[None] / r
        dy = (np.arange(y0, y1) + 0.5 - at[1])[:, None] / r
        d = np.sqrt(dx * dx + dy * dy)
        up = np.sqrt(np.maximum(1.0 - d * d, 0.0))
        cover = np.clip((1.0 - d) * r + 0.5, 0.0, 1.0)
        cover = np.where(z - radius * up > self.depth[y0:y1, x0:x1], hidden * cover, cover)[..., None]
        light = (0.55 + 0.45 * np.clip(0.7 * up - 0.3 * dx - 0.6 * dy, 0.0, 1.0))[..., None]
        part = self.colors[y0:y1, x0:x1]
        part += (cover * (light * np.asarray(color) - part)).astype(np.float32)

    def pointer(self, point: Array, color: Sequence[float]) -> None:
        """A mark at the edge of the picture that points to something outside."""
        side = (np.asarray(point) - self.eye) @ self.turn
        way = np.array([side[0], -side[1]])
        way = way / max(float(np.linalg.norm(way)), 1e-9)
        half = np.array([0.5 * self.width, 0.5 * self.height])
        scale = self.width / 640.0
        reach = np.min((half - 14.0 * scale) / np.maximum(np.abs(way), 1e-9))
        tip, across = half + reach * way, np.array([-way[1], way[0]])
        t = np.linspace(0.0, 1.0, 40)[:, None]
        for depth in np.linspace(0.0, 20.0 * scale, 12):
            row = tip - depth * way + (2.0 * t - 1.0) * 0.5 * depth * across
            self.dots(row, np.zeros(len(row)), color, 3.0 * scale)


def _focal(size: tuple[int, int], fovy_deg: float) -> float:
    return float(0.5 * size[1] / np.tan(0.5 * np.deg2rad(fovy_deg)))


@lru_cache(maxsize=4)
def _rays(size: tuple[int, int], focal: float) -> tuple[Array, Array]:
    """Ways through the pixels of a picture, of length 1 along the view, and their lengths. (3, height * width), (height * width,)"""
    width, height = size
    x, y = np.meshgrid((np.arange(width) + 0.5 - 0.5 * width) / focal, (0.5 * height - np.arange(height) - 0.5) / focal)
    rays = np.stack([x, y, -np.ones_like(x)]).reshape(3, -1).astype(np.float32)
    return rays, np.linalg.norm(rays, axis=0)


def _facing(yaw: float, down: float) -> tuple[Array, tuple[float, float, float, float]]:
    """Axes (columns right, up, back) and orientation x y z w of an upright camera."""
    c, s, cd, sd = np.cos(yaw), np.sin(yaw), np.cos(down), np.sin(down)
    turn = np.array([[s, sd * c, -cd * c], [-c, sd * s, -cd * s], [0.0, cd, sd]])
    # A camera that looks along -z with y up: pitched up from looking straight down, then turned about the vertical.
    p, y = 0.5 * (0.5 * np.pi - down), 0.5 * (yaw - 0.5 * np.pi)
    cp, sp, cy, sy = np.cos(p), np.sin(p), np.cos(y), np.sin(y)
    return turn, (float(cy * sp), float(sy * sp), float(sy * cp), float(cy * cp))


def _yaw(quat: Array) -> Array:
    x, y, z, w = np.moveaxis(np.asarray(quat, np.float64), -1, 0)
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def _level(yaw: Array, along: Array) -> Array:
    """Vectors along headings (forward, left, up) in the world."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y, z = np.moveaxis(np.asarray(along, np.float64), -1, 0)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def _circle(middle: Array, radius: float, axis: Any = (0.0, 0.0, 1.0)) -> Array:
    n = np.asarray(axis, np.float64)
    n = n / max(float(np.linalg.norm(n)), 1e-9)
    u = np.cross(n, [0.0, 0.0, 1.0] if abs(n[2]) < 0.9 else [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    t = np.linspace(0.0, 2.0 * np.pi, 49)[:, None]
    return np.asarray(middle + radius * (np.cos(t) * u + np.sin(t) * np.cross(n, u)))


def _drone_color(drone: int) -> tuple[float, float, float]:
    return DRONES[0] if drone == 0 else DRONES[1 + (drone - 1) % (len(DRONES) - 1)]


def _palette(scene: SceneInfo) -> tuple[Array, Array]:
    """Colours of the geoms, and which of them are ground; the last row is for what is no geom. (n + 1, 3), (n + 1,)"""
    colors = np.full((len(scene.geoms) + 1, 3), 0.6, np.float32)
    ground = np.zeros(len(scene.geoms) + 1, bool)
    for g in scene.geoms:
        stated = np.array(g.rgba[:3])
        if g.drone is not None:
            color = np.array(_drone_color(g.drone))
            # Rotors are lighter than the body, which lets the drone's attitude be seen.
            colors[g.id] = 0.55 * color + 0.45 if "rotor" in g.name else color
        elif g.kind in ("plane", "hfield"):
            ground[g.id] = True
            colors[g.id] = (0.60, 0.64, 0.60) if g.rgba == _STATES_NONE else stated
        else:
            colors[g.id] = (0.72, 0.70, 0.66) if g.rgba == _STATES_NONE else stated
    return colors, ground


class Display:
    """Draws the worlds of an environment, whose trails it remembers.

    ``env`` is the ``DroneVectorEnv``; ``size`` the width and height of pictures, px.
    """

    def __init__(self, env: Any, vehicles: Sequence[_native.Vehicle], size: tuple[int, int]) -> None:
        self.env, self.vehicles, self.size = env, list(vehicles), size
        self.native: _native.Env = env._native
        self.n, self.d = env.num_envs, env.n_drones
        self.config = env.config
        self.task = self.config["task"]
        self.columns: dict[str, slice] = {}
        start = 0
        for name, width in self.native.channels():
            self.columns[name] = slice(start, start + width)
            start += width
        self.numbers: Array = self.native.array("observation")
        #: A task in Python, over arrays; one of expressions has none.
        self.own = isinstance(env.task, Task)
        self.written = isinstance(env.task, Goal)
        self.pos = self.native.array("pos") if self.own else self.numbers[..., self.columns["pos"]]
        self.quat = self.native.array("quat") if self.own else self.numbers[..., self.columns["quat"]]
        # The trail: some 50 places a second, in a ring.
        self.hz = int(self.config["step_hz"])
        self.every = -(-self.hz // 50)
        length = max(int(TRAIL_S * self.hz / self.every), 2)
        self.ring = np.zeros((length, self.n, self.d, 3), np.float32)
        self.steps = np.zeros(self.n, np.int64)
        self.begun = np.zeros(self.n, bool)
        self.look = np.zeros(self.n)
        above, down, self.fovy = _IN_ROOMS if self.task["kind"] == "room_explore" else _CHASE
        self.above, self.down = np.deg2rad(above), np.deg2rad(down)
        self.focal = _focal(size, self.fovy)
        self.layouts: dict[int, tuple[Array, Array]] = {}
        self._open = self.config["scene"] in (None, "none")  # there is no scene
        self.stage: Sim | None = None
        self.frame: DepthFrame | None = None
        self.radius = max(radius(v) for v in self.vehicles[:1])

    # ---- what is remembered

    def begin(self, worlds: Array) -> None:
        """New episodes in the worlds of a mask: their trails begin here, and the camera looks to the goal."""
        if not worlds.any():
            return
        self.begun |= worlds
        self.steps[worlds] = 0
        self.ring[0, worlds] = self.pos[worlds]
        self.look[worlds] = self._wanted(_yaw(self.quat[:, 0]))[worlds]

    def _wanted(self, keep: Array) -> Array:
        """Headings that the camera should have: the way to the goal, ``keep`` near it, or the drone's heading where there is none. (n,)"""
        if self.task["kind"] == "trajectory":
            return np.full(self.n, np.deg2rad(60.0))  # an upright path is seen from its side
        goals = self.goals()
        if goals is None:
            return _yaw(self.quat[:, 0])
        way = goals[:, 0] - self.pos[:, 0]
        return np.where(np.hypot(way[:, 0], way[:, 1]) > 0.5, np.arctan2(way[:, 1], way[:, 0]), keep)

    def record(self, begun: Array) -> None:
        """The places after a step, in which the worlds of the mask began anew."""
        self.steps += 1
        now = ~begun & (self.steps % self.every == 0)
        self.ring[(self.steps[now] // self.every) % len(self.ring), now] = self.pos[now]
        off = self._wanted(self.look) - self.look
        most = _TURN_RAD_S / self.hz
        # Worlds that are quarantined have no numbers.
        off = np.nan_to_num((off + np.pi) % (2.0 * np.pi) - np.pi)
        self.look += np.clip(off, -most, most)
        self.begin(begun)

    def trail(self, world: int, drone: int) -> Array:
        """Places of the last seconds, m, oldest first, ending at the present one. (n, 3)"""
        last = int(self.steps[world]) // self.every
        first = max(last - len(self.ring) + 1, 0)
        kept = self.ring[np.arange(first, last + 1) % len(self.ring), world, drone]
        return np.concatenate([kept, self.pos[world, drone][None]]).astype(np.float64)

    # ---- what is asked

    def goals(self) -> Array | None:
        """Where drones shall fly, m, world; of a task that asks for a velocity where that leads in one second. (n, d, 3), or None"""
        if self.own:
            return np.array(self.native.array("goal_pos"), np.float64) if self.native.has_goal() else None
        pos, yaw = self.pos.astype(np.float64), _yaw(self.quat)
        for name in ("difference_to_goal",) if self.written else ("difference_to_goal", "local_samples"):
            if name in self.columns:
                return np.asarray(pos + self.numbers[..., self.columns[name]][..., :3])
        if self.written:
            return None
        if "difference_to_target_vel" in self.columns:
            vel = self.numbers[..., self.columns["vel"]] + self.numbers[..., self.columns["difference_to_target_vel"]]
            return np.asarray(pos + vel)
        for name in ("goal", "next_gate"):
            if name in self.columns:
                return np.asarray(pos + _level(yaw, self.numbers[..., self.columns[name]][..., :3]))
        return None

    # ---- pictures

    def picture(self, world: int) -> NDArray[np.uint8]:
        """The picture of one world. (height, width, 3)"""
        if not self.begun[world]:
            raise RuntimeError(f"render: expected a reset first: world {world} has not begun an episode")
        pos = np.asarray(self.pos[world], np.float64)
        if not np.isfinite(pos[0]).all() or not np.isfinite(self.quat[world, 0]).all():
            # The world is quarantined, and its drone nowhere; the next episode is seen again.
            return np.full((self.size[1], self.size[0], 3), 128, np.uint8)
        eye, turn, quat = self._eye(world, pos[0], float(self.look[world]))
        camera = Camera(mount="world", pos=tuple(eye.tolist()), quat=quat, fovy_deg=self.fovy, resolution=self.size)
        frame = self._see(world, camera, True)
        picture = self._shade(world, frame, eye, turn)
        self._marks(world, picture)
        colors = np.clip(picture.colors, 0.0, 1.0, out=picture.colors)
        colors *= np.float32(255.0)
        out = (colors + np.float32(0.5)).astype(np.uint8)
        return np.asarray(out.reshape(self.size[1], self.size[0], 3))

    def _eye(self, world: int, pos: Array, yaw: float) -> tuple[Array, Array, tuple[float, float, float, float]]:
        """Place, axes and orientation of the camera: behind and above, nearer where something is in between."""
        away = self.focal / self.size[0] * 2.0 * self.radius / _SHARE
        back = np.array([-np.cos(yaw) * np.cos(self.above), -np.sin(yaw) * np.cos(self.above), np.sin(self.above)])
        if not self._open:
            first = 1.3 * self.radius
            _, quat = _facing(yaw + np.pi, -self.above)
            start = pos + first * back
            look = Camera(mount="world", pos=tuple(start.tolist()), quat=quat, fovy_deg=6.0, resolution=(4, 4))
            free = first + float(np.min(self._see(world, look, False)["depth"])) - 0.08
            away = max(min(away, free), 2.5 * self.radius)
        turn, quat = _facing(yaw, self.down)
        return pos + away * back, turn, quat

    def _see(self, world: int, camera: Camera, normals: bool) -> dict[str, Array]:
        if not self._open:
            return dict(self.native.view(world, camera._spec(normals=normals)))
        if self.stage is None:
            self.stage = Sim(n_drones=self.d, drone=self._drones(), scene=_FLOOR, threads=1)
            self.layouts[0] = _palette(self.stage.scenes[0])
        self.stage.data.pos[0], self.stage.data.quat[0] = self.pos[world], self.quat[world]
        self.frame = f = self.stage.depth_frame(camera, normals=normals, out=self.frame)
        return {"depth": f.depth[0], "status": f.status[0], "geom_id": f.geom_id[0], "normal": f.normal[0] if normals else None}  # type: ignore[index,dict-item]

    def _drones(self) -> list[_native.Vehicle]:
        return self.vehicles if len(self.vehicles) == self.d else self.vehicles * self.d

    def _colors(self, world: int) -> tuple[Array, Array]:
        layout = int(self.native.layouts()[world])
        if layout not in self.layouts:
            self.layouts[layout] = _palette(scene_info(self.native.scene_json(layout) or ""))
        return self.layouts[layout]

    def _shade(self, world: int, frame: dict[str, Array], eye: Array, turn: Array) -> Picture:
        palette, grounds = self._colors(world)
        ids = frame["geom_id"].ravel()
        hit = frame["status"].ravel() == 0
        normal = frame["normal"].reshape(-1, 3)
        depth = np.where(hit, frame["depth"].ravel(), np.float32(np.inf))
        rays, lengths = _rays(self.size, self.focal)
        turned = turn.astype(np.float32)
        # Products of so few columns are written out: threads of a library for matrices would cost more than they bring.
        light = normal[:, 0] * _LIGHT[0] + normal[:, 1] * _LIGHT[1] + normal[:, 2] * _LIGHT[2]
        np.maximum(light, np.float32(0.0), out=light)
        light *= np.float32(0.55)
        light += np.float32(0.45)
        colors = np.take(palette, ids, axis=0, mode="wrap")

        # The ground: squares that fade with distance, and shadows straight below drones.
        floor = np.flatnonzero(hit & (normal[:, 2] > 0.7) & (depth < 40.0))
        if len(floor):
            near = depth[floor]
            a, b, c = (near * rays[k][floor] for k in range(3))
            x, y, z = (a * turned[k, 0] + b * turned[k, 1] + c * turned[k, 2] + np.float32(eye[k]) for k in range(3))
            square = np.float32(0.5 if self._open else 1.0)
            odd = (np.floor(x / square) + np.floor(y / square)).astype(np.int32) & 1
            fade = (np.float32(0.13) * np.exp(near * np.float32(-1.0 / 15.0))) * grounds[ids[floor]]
            light[floor] *= 1.0 + np.where(odd, fade, -fade)
            if self.task["kind"] == "room_explore":
                on = grounds[ids[floor]]
                self._seen_floor(world, floor[on], x[on], y[on], colors)
            for pos in np.asarray(self.pos[world], np.float32):
                under = (np.abs(x - pos[0]) < self.radius) & (np.abs(y - pos[1]) < self.radius)
                under = np.flatnonzero(under & (z < pos[2] - 0.02))
                under = under[(x[under] - pos[0]) ** 2 + (y[under] - pos[1]) ** 2 < self.radius**2]
                light[floor[under]] *= 0.5

        colors *= light[:, None]
        far = np.flatnonzero(depth > 12.0)
        if len(far):
            # The sky above, and haze before what is far away.
            up = rays[0][far] * turned[2, 0] + rays[1][far] * turned[2, 1] + rays[2][far] * turned[2, 2]
            sky = np.clip(up / lengths[far], 0.0, 0.6)[:, None]
            horizon = _HORIZON + sky * (_ZENITH - _HORIZON)
            haze = np.float32(1.0) - np.exp((depth[far, None] - np.float32(12.0)) * np.float32(-1.0 / 40.0))
            colors[far] += haze * (horizon - colors[far])
        shape = (self.size[1], self.size[0])
        return Picture(eye, turn, self.focal, colors.reshape(*shape, 3), depth.reshape(shape))

    def _seen_floor(self, world: int, floor: Array, x: Array, y: Array, colors: Array) -> None:
        """Tints the ground where it has been seen, around the drone."""
        cells = np.asarray(self.numbers[world, 0, self.columns["near_map"]]) > 0.5
        side = int(np.sqrt(len(cells)))
        pos, yaw = self.pos[world, 0], float(_yaw(self.quat[world, 0]))
        dx, dy = x - pos[0], y - pos[1]
        ahead, left = np.cos(yaw) * dx + np.sin(yaw) * dy, np.cos(yaw) * dy - np.sin(yaw) * dx
        row = np.floor(0.5 * side - ahead / 0.5).astype(np.int64)
        column = np.floor(0.5 * side - left / 0.5).astype(np.int64)
        inside = (row >= 0) & (row < side) & (column >= 0) & (column < side)
        seen = np.zeros(len(floor), bool)
        seen[inside] = cells[row[inside] * side + column[inside]]
        colors[floor[seen]] = 0.55 * colors[floor[seen]] + 0.45 * np.array(GOAL, np.float32)

    def _marks(self, world: int, p: Picture) -> None:
        scale = self.size[0] / 640.0
        goals = self.goals()
        pos = np.asarray(self.pos[world], np.float64)
        for drone in range(self.d):
            path = self.trail(world, drone)
            path = path[np.linalg.norm(path - pos[drone], axis=1) > 0.8 * self.radius]
            color = TRAIL if drone == 0 else _drone_color(drone)
            p.line(path, color, (3.5 if drone == 0 else 2.0) * scale, np.linspace(0.25, 1.0, max(len(path), 1)))
        if self.task["kind"] == "trajectory":
            ahead = pos[0] + self.numbers[world, 0, self.columns["local_samples"]].reshape(-1, 3)
            p.line(_curve(self.task, ahead), GOAL, 2.0 * scale, 0.8, 0.3)
        if goals is None:
            return
        for drone in range(self.d - 1, -1, -1):
            goal = goals[world, drone]
            if not np.isfinite(goal).all():
                continue
            first = drone == 0
            color = GOAL if first else _drone_color(drone)
            (at,), (z,) = p.project(goal[None])
            radius = max(0.6 * self.radius, (0.010 if first else 0.006) * float(z))
            if self.task["kind"] == "reach_vel":
                self._arrow(p, pos[drone], goal, color, 4.0 * scale)
                continue
            if self.task["kind"] == "gate_race":
                axis = _level(_yaw(self.quat[world, drone]), self.numbers[world, drone, self.columns["next_gate"]][3:6])
                p.line(_circle(goal, 0.25, axis), color, 4.0 * scale, 1.0, 0.4)
                self._arrow(p, goal - 0.4 * axis, goal + 0.4 * axis, color, 4.0 * scale)
            else:
                if first:
                    foot = np.array([goal[0], goal[1], 0.0])
                    p.line(np.stack([goal, foot]), color, 1.5 * scale, 0.8, 0.3)
                    p.line(_circle(foot + [0.0, 0.0, 0.005], 3.0 * radius), color, 2.5 * scale, 1.0, 0.3)
                p.sphere(goal, radius, color, 0.4)
            if first and not p.shows(at, float(z)):
                p.pointer(goal, color)

    def _arrow(self, p: Picture, a: Array, b: Array, color: Sequence[float], px: float) -> None:
        way = b - a
        length = float(np.linalg.norm(way))
        if length < 1e-6:
            return
        side = np.cross(way / length, p.turn[:, 2])
        side /= max(float(np.linalg.norm(side)), 1e-9)
        head = min(0.4 * length, 2.0 * self.radius)
        back = b - way / length * head
        p.line(np.stack([a, b]), color, px, 1.0, 0.4)
        p.line(np.stack([back + 0.6 * head * side, b, back - 0.6 * head * side]), color, px, 1.0, 0.4)


def _curve(task: dict[str, Any], ahead: Array) -> Array:
    """The path of the task ``trajectory``, m; the points ``ahead`` of one that is drawn at random. (n, 3)"""
    r, shape = float(task["radius_m"]), task["shape"]
    t = np.linspace(0.0, 2.0 * np.pi, 241)
    if shape == "figure_eight":
        x, y, z = r * np.sin(t), 0.0 * t, 1.0 + 0.5 * r * np.sin(2.0 * t)
    elif shape == "circle":
        x, y, z = r * np.cos(t), r * np.sin(t), np.ones_like(t)
    else:
        return ahead
    return np.stack([x, y, z], axis=-1)
