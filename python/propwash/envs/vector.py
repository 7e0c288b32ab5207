"""The Gymnasium vector environment."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from .. import _native
from ..effects import n_rotors
from ..learn import Goal
from ..sense import Camera, _pair, _whole
from ..sim import DroneLike, Dynamics, SceneLike, _each, _plain, _rules, _scene, _sensors, _vehicle
from ._render import Display
from ._window import MOST, Window
from .task import ENDINGS, Action, Task, TaskCalls, own_task

Obs = dict[str, NDArray[np.float32]]
Info = dict[str, Any]

_ARGUMENTS = {"n_drones": "n_drones", "action": "action", "step_hz": "freq", "max_episode_s": "max_episode_time"}

#: The built-in tasks: name, name in camel case, and the arguments that they are made for.
BUILT_IN = tuple(
    (name, title, {_ARGUMENTS[key]: value for key, value in json.loads(defaults).items() if value is not None})
    for name, title, defaults in _native.built_in_tasks()
)

#: Names of the built-in tasks.
TASKS = tuple(name for name, _, _ in BUILT_IN)

Autoreset = Literal["next_step", "same_step", "disabled", "NextStep", "SameStep", "Disabled"]

_MODES = {
    AutoresetMode.NEXT_STEP: "next_step",
    AutoresetMode.SAME_STEP: "same_step",
    AutoresetMode.DISABLED: "disabled",
}


def _camera(camera: str | Mapping[str, Any]) -> dict[str, Any]:
    if isinstance(camera, str):
        return {"device": camera}
    if isinstance(camera, Mapping):
        return dict(camera)
    raise TypeError(f"camera: expected the name of a device, a dict, None or False, got {type(camera).__name__}")


class DroneVectorEnv(VectorEnv[Obs, NDArray[np.float32], NDArray[Any]]):
    """A batch of worlds to learn in, one for each sub-environment.

    Observations are dicts of float32 arrays ``(num_envs, n)``, or ``(num_envs, n_drones, n)`` where worlds have several drones:
    ``pos`` (m, world), ``quat`` (x y z w, body to world), ``vel`` (m/s, world), ``ang_vel`` (rad/s, body), what the task adds,
    and ``depth`` (m, ``(num_envs, height, width)``) where there is a camera; docs/environments.md lists all. Rewards are those
    of the drone, or the mean over the drones of a world; ``info["reward"]`` has them apart.

    Args:
        num_envs: Number of worlds.
        task: Name of a built-in task (``propwash.envs.TASKS``) or of one by ``register_task``, or a ``propwash.learn.Goal`` or a
            ``propwash.envs.Task``, the class or an object.
        task_options: Options of the task, by name; of a class, the arguments that make an object.
        n_drones: Drones in each world. None, here and below: one; a ``propwash.envs.Task`` may say otherwise.
        drone: As in ``propwash.Sim``: a name, a path or a ``Vehicle``, or a list of them, one for each drone.
        dynamics: As in ``propwash.Sim``.
        action: ``"attitude"``, ``"body_rate"``, ``"force_torque"``, ``"rotor_vel"`` or ``"velocity"``; None is
            ``"attitude"``.
        action_options: ``max_tilt_rad``, ``max_speed_m_s`` and other limits.
        normalize_actions: Actions run from -1 to 1 and 0 hovers; else they are in SI units.
        sim_freq: Steps of the simulation per second.
        freq: Steps of the environment per second; divides ``sim_freq``. None is 50.
        max_episode_time: Episodes are truncated after so many seconds. None is 10.
        scene: Name of a scene that comes with the package (``propwash.scenes()``), path of an MJCF file or MJCF text, a list of names
            and paths (each a layout), ``{"forest": {"trees": 40}}`` (also ``corridor``, ``boxes``, ``track``, ``rooms``; with
            ``layouts`` the name alone) or ``"none"``; None is the task's own choice.
        layouts: Number of generated scenes, which differ in their seeds; every world flies in one, drawn anew at every reset.
        camera: Name of a depth device (``propwash.envs.depth_devices()``), or a dict of ``device``, ``name``, ``width``,
            ``height``, ``fovy_deg``, ``range_m``, ``kind``, ``noise``; None is the task's own choice, False is no camera.
        sensors: Further sensors of every drone, as in ``propwash.Sim``; each of their channels is observed as
            ``SENSOR_CHANNEL`` (``imu_gyroscope``, ``lidar_range``), sampled in every step or ``sample_hz`` times a second.
        randomization: What is drawn anew at every reset: text or path of a TOML file, or a list of rules; parameters of the
            vehicle and its effects, ``initial.…``, and ``env.…`` (delays, wind, noise).
        levels: Fixed delays, wind and noise, by name without ``env.``.
        obstacle_motion: How movable obstacles of the scene move by themselves, as in ``propwash.Sim``; drawn anew at every reset.
        obstacle_jitter: They are shifted by up to this much in x and y from their places in the scene, anew at every reset, m.
        body_rate_law: As in ``propwash.Sim``.
        look: Clearances are looked for up to this distance, m.
        autoreset_mode: Gymnasium's, or its name.
        seed: Seed until ``reset(seed=…)`` gives another; drawn by the system where None.
        first_world: Number of the first world over a batch that is split: worlds keep their random numbers.
        threads: Threads that share the worlds; one for each processor where None. Results do not depend on it.
        copy: Observations are copies; else views that the next step overwrites.
        render_mode: ``"rgb_array"``: ``render()`` returns a picture of every world. ``"human"``: every reset and step shows the pictures of
            the first four worlds in a window, ``freq`` times a second; closing it ends that, and the flight goes on.
        render_size: Width and height of each picture, pixels.
        max_episode_steps: Refused: ``max_episode_time`` limits episodes, in seconds.

    Raises:
        TypeError, ValueError: for arguments that make no sense, saying what was expected and what was given.
    """

    metadata: dict[str, Any] = {
        "render_modes": ["human", "rgb_array"],
        "render_fps": 50,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        task: str | Task | Goal | Callable[..., Task | Goal] = "reach_pos",
        task_options: Mapping[str, Any] | None = None,
        n_drones: int | None = None,
        drone: DroneLike | Sequence[DroneLike] = "cf2x_L250",
        dynamics: Dynamics = "first_principles",
        action: Action | None = None,
        action_options: Mapping[str, Any] | None = None,
        normalize_actions: bool = True,
        sim_freq: int = 500,
        freq: int | None = None,
        max_episode_time: float | None = None,
        scene: SceneLike = None,
        layouts: int | None = None,
        camera: str | Mapping[str, Any] | bool | None = None,
        sensors: Sequence[str | Mapping[str, Any]] = (),
        randomization: str | os.PathLike[str] | Sequence[Mapping[str, Any]] | None = None,
        levels: Mapping[str, Any] | None = None,
        obstacle_motion: Mapping[str, Any] | None = None,
        obstacle_jitter: float = 0.0,
        body_rate_law: Literal["firmware", "tracking"] = "firmware",
        look: float = 3.0,
        autoreset_mode: AutoresetMode | Autoreset = AutoresetMode.NEXT_STEP,
        seed: int | None = None,
        first_world: int = 0,
        threads: int | None = None,
        copy: bool = True,
        render_mode: Literal["human", "rgb_array"] | None = None,
        render_size: tuple[int, int] = (640, 480),
        max_episode_steps: None = None,
    ) -> None:
        self.num_envs = _whole("num_envs", num_envs, 1, 2**24)
        own = own_task(task, task_options, TASKS)
        self.task: Task | Goal | None = own
        """The task, where it is not built in."""
        by = own if isinstance(own, Task) else Task
        n_drones = by.n_drones if n_drones is None else n_drones
        action = by.action if action is None else action
        freq = by.freq if freq is None else freq
        usual_time = own.time if isinstance(own, Goal) else by.max_episode_time
        max_episode_time = usual_time if max_episode_time is None else max_episode_time
        self.n_drones = _whole("n_drones", n_drones, 1, 4096)
        if max_episode_steps is not None:
            raise TypeError(
                f"max_episode_steps: expected max_episode_time, in seconds, got {max_episode_steps!r} steps: at freq={freq} one step is "
                f"{1 / freq:g} s"
            )
        if render_mode not in (None, "human", "rgb_array"):
            raise ValueError(f'render_mode: expected None, "human" or "rgb_array", got {render_mode!r}')
        wide, high = _pair("render_size", render_size)
        picture = (_whole("render_size", wide, 16, 4096), _whole("render_size", high, 16, 4096))
        if autoreset_mode not in (*_MODES, *_MODES.values(), *(m.value for m in _MODES)):
            known = ", ".join(str(m.value) for m in _MODES)
            raise ValueError(f"autoreset_mode: expected one of {known}, got {autoreset_mode!r}")
        mode = next(m for m, name in _MODES.items() if autoreset_mode in (m, m.value, name))
        self.metadata = {**type(self).metadata, "autoreset_mode": mode, "render_fps": freq}
        self.autoreset_mode = mode
        self.render_mode = render_mode
        if camera is True:
            raise ValueError("camera: expected the name of a device, a dict, None or False, got True")
        listed = self.n_drones if isinstance(drone, (list, tuple)) else 1
        vehicles = [_vehicle(d) for d in _each("drone", drone, self.n_drones)[:listed]]
        wanted: dict[str, Any] = {
            "task": {"kind": "own"} if own is not None else {"kind": task, **(task_options or {})},
            "n_worlds": self.num_envs,
            "n_drones": self.n_drones,
            "first_world": _whole("first_world", first_world, 0, 2**62),
            "seed": 0 if seed is None else _whole("seed", seed, 0, 2**64 - 1),
            "drones": [{"dynamics": dynamics}] * len(vehicles),
            "sim_hz": _whole("sim_freq", sim_freq, 1, 1_000_000),
            "step_hz": _whole("freq", freq, 1, 1_000_000),
            "max_episode_s": float(max_episode_time),
            "action": {"kind": action, "normalized": bool(normalize_actions), **(action_options or {})},
            "scene": None if scene is None else _scene(scene, layouts),
            "layouts": None if layouts is None else _whole("layouts", layouts, 1, 4096),
            "camera": None if camera is None or camera is False else _camera(camera),
            "sensors": _sensors(sensors),
            "with_camera": camera is not False,
            "autoreset": _MODES[mode],
            "look_m": float(look),
            "levels": dict(levels or {}),
            "obstacle_motion": None if obstacle_motion is None else dict(obstacle_motion),
            "obstacle_jitter_m": float(obstacle_jitter),
            "body_rate_law": body_rate_law,
            "randomization": _rules(randomization),
        }
        threads = None if threads is None else _whole("threads", threads, 1, 1024)
        calls = TaskCalls(own) if isinstance(own, Task) else None
        self._calls = calls
        given = None if calls is None else (calls.described(layouts), calls, calls.draws)
        written = own._task(n_rotors(vehicles[0]) if action == "rotor_vel" else 4) if isinstance(own, Goal) else None
        self._native = _native.Env(json.dumps(_plain("", wanted)), vehicles, threads, given, written)
        if calls is not None:
            calls.attach(self._native, wanted)
        self._seeded = seed is not None
        self._copy = bool(copy)
        self._closed = False
        self._many = self.n_drones > 1
        low, high = self._native.action_limits()
        pick: Any = slice(None) if self._many else 0
        self.single_action_space = spaces.Box(low[pick], high[pick], dtype=np.float32)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._action_shape = self._native.action_shape

        self._columns: list[tuple[str, Any]] = []
        shape: dict[str, spaces.Space[Any]] = {}
        head = (self.n_drones,) if self._many else ()
        start = 0
        for name, width in self._native.channels():
            key = slice(start, start + width)
            self._columns.append((name, (slice(None), slice(None), key) if self._many else (slice(None), key)))
            shape[name] = spaces.Box(-np.inf, np.inf, (*head, width), np.float32)
            start += width
        (width, height), (_, far) = self._native.image()
        self._numbers = self._array("observation")
        self._depth = self._array("depth") if width else None
        if width:
            shape["depth"] = spaces.Box(0.0, far, (*head, height, width), np.float32)
        self._samples: dict[str, NDArray[Any]] = {}
        self._ended_samples: dict[str, NDArray[Any]] = {}
        for name, (sensor, channel, _, tail, _) in self._native.sensor_channels():
            shape[name] = spaces.Box(-np.inf, np.inf, (*head, *tail), np.float32)
            for ended, arrays in ((False, self._samples), (True, self._ended_samples)):
                if not ended or mode is AutoresetMode.SAME_STEP:
                    array = self._native.samples(sensor, channel, ended)
                    arrays[name] = array if self._many else array[:, 0]
        self.single_observation_space = spaces.Dict(shape)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._display = None if render_mode is None else Display(self, vehicles, picture)
        self._window = Window(freq, self.num_envs) if render_mode == "human" else None
        self._ended = np.zeros(self.num_envs, bool)
        self._reward = self._native.array("reward")
        self._terminated = self._native.array("terminated")
        self._truncated = self._native.array("truncated")
        self._ending = self._native.array("ending")
        self.clearance: NDArray[np.float32] = self._array("clearance")
        """Distance to the nearest thing after the last step, m, at most ``look``; a view. (num_envs,) or (num_envs, n_drones)"""

    def _array(self, name: str) -> NDArray[Any]:
        array: NDArray[Any] = self._native.array(name)
        return array if self._many else array[:, 0]

    @property
    def config(self) -> dict[str, Any]:
        """What it is made of, complete: every option with its value."""
        out: dict[str, Any] = json.loads(self._native.config_json())
        return out

    def _observe(
        self, numbers: NDArray[Any], depth: NDArray[Any] | None, samples: Mapping[str, NDArray[Any]]
    ) -> Obs:
        if self._copy:
            numbers = numbers.copy()
        out = {name: numbers[key] for name, key in self._columns}
        if depth is not None:
            out["depth"] = depth.copy() if self._copy else depth
        for name, array in samples.items():
            out[name] = array.copy() if self._copy else array
        return out

    def _seeds(self, seed: Any, mask: Any) -> int | list[int] | None:
        """The seed of all worlds, or one for each, checked."""
        if seed is None or isinstance(seed, (int, np.integer)):
            return None if seed is None else _whole("seed", seed, 0, 2**64 - 1)
        if isinstance(seed, (str, bytes, Mapping)) or not np.iterable(seed):
            raise TypeError(f"seed: expected a whole number, or a list with one for each world, got {type(seed).__name__}")
        each = [_whole(f"seed[{i}]", s, 0, 2**64 - 1) for i, s in enumerate(seed)]
        if len(each) != self.num_envs:
            raise ValueError(f"seed: expected {self.num_envs} seeds, one for each world, got {len(each)}")
        if mask is not None:
            raise ValueError("seed: expected none with a reset_mask: seeds are those of all worlds")
        return each

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Obs, Info]:
        """Begins new episodes: in all worlds, or in those where ``options["reset_mask"]`` (num_envs,) is true.

        ``options["goal"]``, (num_envs, 3) or (num_envs, n_drones, 3), gives these episodes their goals, for tasks that have some (m, or
        m/s, in the world frame); later episodes have drawn ones again.

        ``seed`` is one number for the whole batch; every world has random numbers of its own by it and by its number (``first_world`` and
        its place). A list has a seed for each world, (num_envs,), whose episodes are then those of a single environment with that seed,
        whatever its place. The same seeds give the same episodes, bit for bit.
        """
        self._check_open()
        options = options or {}
        unknown = set(options) - {"reset_mask", "goal"}
        if unknown:
            raise ValueError(f'options: expected "reset_mask", "goal" or nothing, got {sorted(unknown)}')
        mask = options.get("reset_mask")
        seed = self._seeds(seed, mask)
        if seed is not None:
            super().reset(seed=(seed if isinstance(seed, int) else seed[0]) % 2**32)
            self._seeded = True
        elif not self._seeded:
            # Gymnasium's own generator, which the system seeds.
            seed = int(self.np_random.integers(2**63))
            self._seeded = True
        self._native.reset(seed, mask, self._goal(options.get("goal")))
        if self._display is not None:
            begun = np.ones(self.num_envs, bool) if mask is None else np.asarray(mask, bool)
            self._ended &= ~begun
            self._display.begin(begun)
            self._show()
        info: Info = {}
        if mask is not None:
            info["reset_mask"] = np.asarray(mask)
        return self._observe(self._numbers, self._depth, self._samples), info

    def _goal(self, goal: ArrayLike | None) -> Any:
        """Goals of worlds with one drone, with its axis."""
        if goal is None or self._many:
            return goal
        array = np.asarray(goal)
        if array.shape != (self.num_envs, 3):
            raise ValueError(f"goal: expected shape ({self.num_envs}, 3) = (num_envs, 3), got {array.shape}")
        return array[:, None]

    def step(
        self, actions: ArrayLike
    ) -> tuple[Obs, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Info]:
        """Flies one step of the environment.

        ``info`` holds ``ending`` (numbers of ``ENDINGS``) with ``_ending`` in steps that ended episodes, ``clipped`` where actions
        lay outside the action space and were held within it, ``final_obs`` with ``_final_obs`` in the mode ``SAME_STEP``, and
        ``reward`` (num_envs, n_drones) where worlds have several drones.
        """
        if self._closed:
            self._check_open()
        if not self._many:
            actions = self._actions(actions)
        ended, clipped = self._native.step(actions)
        info: Info = {}
        if self._many:
            reward = self._reward.mean(axis=1, dtype=np.float64)
            info["reward"] = self._reward.copy()
        else:
            reward = self._reward[:, 0].astype(np.float64)
        terminated, truncated = self._terminated.copy(), self._truncated.copy()
        if self._display is not None:
            begun, self._ended = self._ended, terminated | truncated
            if self.autoreset_mode == AutoresetMode.SAME_STEP:
                begun = self._ended
            self._display.record(begun)
            self._show()
        if ended:
            done = terminated | truncated
            info["ending"] = self._ending.copy()
            info["_ending"] = done
            if self.autoreset_mode == AutoresetMode.SAME_STEP:
                info["final_obs"] = self._final(done)
                info["_final_obs"] = done
                info["final_info"] = {"ending": info["ending"], "_ending": done}
                info["_final_info"] = done
        if clipped:
            info["clipped"] = self._native.clipped()
        return self._observe(self._numbers, self._depth, self._samples), reward, terminated, truncated, info

    def _actions(self, actions: ArrayLike) -> NDArray[Any]:
        """Actions of worlds with one drone, with its axis."""
        array = actions if isinstance(actions, np.ndarray) else np.asarray(actions)
        worlds, _, width = self._action_shape
        if array.shape != (worlds, width):
            raise ValueError(f"action: expected shape ({worlds}, {width}) = (num_envs, action), got {array.shape}")
        return array[:, None]

    def _final(self, done: NDArray[np.bool_]) -> NDArray[Any]:
        """The last observations of worlds that ended, one dict for each, None for the others."""
        numbers = self._array("final_observation")
        depth = None if self._depth is None else self._array("final_depth")
        out = np.full(self.num_envs, None, dtype=object)
        for w in np.flatnonzero(done):
            own = {name: numbers[w][key[1:]].copy() for name, key in self._columns}
            if depth is not None:
                own["depth"] = depth[w].copy()
            own.update({name: array[w].copy() for name, array in self._ended_samples.items()})
            out[w] = own
        return out

    def layouts(self) -> NDArray[np.int64]:
        """Number of the layout in which each world flies. (num_envs,)"""
        self._check_open()
        return self._native.layouts()

    def levels(self, world: int) -> dict[str, Any]:
        """Delays, wind and noise of a world's episode."""
        out: dict[str, Any] = json.loads(self._native.levels_json(world))
        return out

    def parameters(self, world: int, drone: int = 0) -> dict[str, float]:
        """Parameters of one vehicle in a world's episode, SI, by name."""
        return dict(self._native.parameters(world, drone))

    def view(self, world: int = 0, camera: Camera | str = "overview") -> dict[str, NDArray[Any]]:
        """What a camera sees in a world: ``depth`` (m), ``status``, ``geom_id``, ``normal``. (height, width)

        ``camera``: the name of a camera of the scene or of the drone, or a ``propwash.Camera``.
        """
        self._check_open()
        if isinstance(camera, str):
            camera = Camera(camera, resolution=(320, 240))
        return dict(self._native.view(world, camera._spec(normals=True)))

    def overview(self, world: int = 0, resolution: tuple[int, int] = (320, 240)) -> Camera:
        """A camera above and before everything in a world's scene."""
        low, high = self._native.extent(int(self._native.layouts()[world])) or ([-3.0, -3.0, 0.0], [3.0, 3.0, 2.0])
        middle = 0.5 * (np.asarray(low) + np.asarray(high))
        reach = float(np.linalg.norm(np.asarray(high)[:2] - np.asarray(low)[:2]))
        eye = middle + reach * np.array([-0.45, -0.6, 0.75])
        return Camera(
            mount="world", pos=tuple(eye.tolist()), quat=_towards(middle - eye), fovy_deg=50.0, resolution=resolution
        )

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Pictures of all worlds, ``render_size`` large: the first drone from behind, its trail in blue, its goal in green.

        The same states since the last reset give the same pictures, bit for bit. None without a ``render_mode``, and for ``"human"``, whose
        window shows them by itself. (height, width, 3) each
        """
        self._check_open()
        return tuple(self._picture(w) for w in range(self.num_envs)) if self.render_mode == "rgb_array" else None

    def _show(self) -> None:
        """Shows the first worlds in the window, where there is one; before the first reset of all there is nothing to show."""
        if self._window is None or self._window.closed or self._display is None:
            return
        worlds = range(min(self.num_envs, MOST))
        if self._display.begun[: len(worlds)].all():
            self._window.show([self._picture(w) for w in worlds])

    def _picture(self, world: int) -> NDArray[np.uint8]:
        assert self._display is not None
        return self._display.picture(world)

    def close_extras(self, **kwargs: Any) -> None:
        """Marks it closed: every later call is an error. Closes its window."""
        self._closed = True
        if self._window is not None:
            self._window.close()

    def _check_open(self) -> None:
        if self._closed:
            raise RuntimeError("this environment was closed: make a new one")

    def __reduce__(self) -> Any:
        raise TypeError(
            "an environment cannot be pickled or copied: make one with the same arguments where it is needed"
        )


def _towards(way: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Orientation x y z w of an upright camera that looks along ``way``."""
    back = -way / np.linalg.norm(way)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    m = np.column_stack([right, np.cross(back, right), back])
    w = 0.5 * np.sqrt(max(1.0 + np.trace(m), 1e-12))
    x, y, z = (m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1])
    quat = np.array([x / (4.0 * w), y / (4.0 * w), z / (4.0 * w), w])
    a, b, c, d = (quat / np.linalg.norm(quat)).tolist()
    return (a, b, c, d)


def shade(frame: Mapping[str, NDArray[Any]]) -> NDArray[np.uint8]:
    """A picture of a labelled frame: colours by geoms, light by normals. (height, width, 3)"""
    ids = frame["geom_id"].astype(np.int64)
    hue = (ids * 0.61803398875) % 1.0
    color = 0.55 + 0.35 * np.cos(2.0 * np.pi * (hue[..., None] + np.array([0.0, 0.33, 0.67])))
    color[ids == 0] = (0.66, 0.68, 0.60)  # the ground in most scenes
    light = np.clip(frame["normal"] @ np.array([-0.35, -0.45, 0.82]), 0.0, 1.0)
    picture = color * (0.35 + 0.65 * light)[..., None]
    picture[frame["status"] != 0] = (0.80, 0.87, 0.95)
    return np.asarray(255.0 * np.clip(picture, 0.0, 1.0), dtype=np.uint8)


def depth_devices() -> list[str]:
    """Names of the depth devices that ``camera`` takes."""
    return _native.depth_devices()


def config_file(path: str | os.PathLike[str]) -> dict[str, Any]:
    """An environment described in a TOML file, checked and completed, as a dict."""
    out: dict[str, Any] = json.loads(_native.env_config(Path(path).read_text()))
    return out
