"""Tasks of your own: what is asked of the drones, as a class over arrays."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _native
from ..learn import Goal
from ..sim import _plain, _scene

#: What actions are.
Action = Literal["attitude", "body_rate", "force_torque", "rotor_vel", "velocity"]

#: Why an episode ended, by the number in ``info["ending"]``.
ENDINGS = ("", "crashed", "left", "done", "time_up", "quarantined")

#: Corners of a box, m, world frame, the lower first.
Box = Sequence[Sequence[float]]


class Worlds:
    """All worlds of an environment, as its task sees them: NumPy arrays, one row for each world.

    The arrays are views, made once; every call of the task finds the present numbers in them. Where worlds have several drones, arrays
    marked * have an axis of drones after that of worlds. They are float32 and read-only unless said otherwise.

    State, true: ``pos`` * (m, world), ``quat`` * (x y z w, body to world), ``vel`` * (m/s, world), ``ang_vel`` * (rad/s, body),
    ``previous_pos`` * (m, a step ago), ``clearance`` * (m to the nearest thing, at most ``look``), ``crashed`` * (bool: touched something
    in the last step; without a scene: is below height zero), ``depth`` * (m, height × width; None without a camera).
    ``observed_pos``, ``observed_quat``, ``observed_vel`` and ``observed_ang_vel`` * have the noise of the environment; what is observed
    should come from them.

    ``sensors``: what the sensors of the environment sampled last, by their name in observations (``"lidar_range"``): * and the shape of
    the channel.

    Actions: ``action`` * (as given), ``action_change`` * (0 to 1, mean over its entries, of their range).

    Counts: ``time`` (s since the episode began), ``step`` (int64, 0 in worlds that have just begun), ``episode`` (int64), ``layout`` (int64).

    To be filled in by ``on_reset``, in the rows of ``begins`` (bool): ``start_pos`` * (m), ``start_vel`` * (m/s), ``start_yaw`` * (rad),
    ``goal_pos`` * (None unless the task has goals; those that the caller of the reset gave stand in the rows of ``goal_given``, bool).

    ``obstacle_pos`` (n, 3) and ``obstacle_quat`` (n, 4), float64, m and x y z w in the world frame: bodies of the scene with
    ``mocap="true"``, which ``on_reset`` and ``before_step`` may move; NaN in rows that the layout of a world does not have; None without
    obstacles.
    """

    num_worlds: int
    n_drones: int
    #: Number of the first world over a batch that is split.
    first_world: int
    #: Seconds of a step of the environment.
    step_time: float
    pos: NDArray[np.float32]
    quat: NDArray[np.float32]
    vel: NDArray[np.float32]
    ang_vel: NDArray[np.float32]
    previous_pos: NDArray[np.float32]
    observed_pos: NDArray[np.float32]
    observed_quat: NDArray[np.float32]
    observed_vel: NDArray[np.float32]
    observed_ang_vel: NDArray[np.float32]
    clearance: NDArray[np.float32]
    crashed: NDArray[np.bool_]
    depth: NDArray[np.float32] | None
    sensors: Mapping[str, NDArray[np.float32]]
    action: NDArray[np.float32]
    action_change: NDArray[np.float32]
    time: NDArray[np.float32]
    step: NDArray[np.int64]
    episode: NDArray[np.int64]
    layout: NDArray[np.int64]
    begins: NDArray[np.bool_]
    start_pos: NDArray[np.float32]
    start_vel: NDArray[np.float32]
    start_yaw: NDArray[np.float32]
    goal_pos: NDArray[np.float32] | None
    goal_given: NDArray[np.bool_]
    obstacle_pos: NDArray[np.float64] | None
    obstacle_quat: NDArray[np.float64] | None

    def __init__(self, native: _native.Env, draws: _native.TaskDraws, config: Mapping[str, Any]) -> None:
        n, d, _ = native.action_shape
        self.num_worlds, self.n_drones, self.first_world = n, d, int(config["first_world"])
        self.step_time = 1.0 / config["step_hz"]
        self._draws = draws

        def array(name: str, drones: bool = True, write: bool = False) -> Any:
            view = native.array(name)
            view = view[:, 0] if drones and d == 1 else view
            if not write:
                view.flags.writeable = False
            return view

        for name in ("pos", "quat", "vel", "ang_vel", "previous_pos", "crashed", "action", "action_change"):
            setattr(self, name, array(name))
        self.clearance = array("task_clearance")
        for name in ("pos", "quat", "vel", "ang_vel"):
            try:
                observed = array(f"observed_{name}")
            except KeyError:
                observed = getattr(self, name)  # there is no noise
            setattr(self, f"observed_{name}", observed)
        (width, _), _ = native.image()
        self.depth = array("true_depth") if width else None
        self.sensors = {}
        for name, (sensor, channel, *_) in native.sensor_channels():
            samples = native.samples(sensor, channel)
            samples.flags.writeable = False
            self.sensors[name] = samples[:, 0] if d == 1 else samples
        for name in ("time", "step", "episode", "layout", "begins", "goal_given"):
            setattr(self, name, array(name, drones=False))
        for name in ("start_pos", "start_vel", "start_yaw"):
            setattr(self, name, array(name, write=True))
        self.goal_pos = array("goal_pos", write=True) if native.has_goal() else None
        obstacles = array("obstacle_pos", drones=False, write=True)
        self.obstacle_pos = obstacles if obstacles.shape[1] else None
        self.obstacle_quat = array("obstacle_quat", drones=False, write=True) if obstacles.shape[1] else None

    def uniform(self, n: int, low: ArrayLike = 0.0, high: ArrayLike = 1.0) -> NDArray[np.float32]:
        """``n`` numbers for each drone, uniform between ``low`` and ``high``, each one number or ``n`` of them.

        They depend on seed, world, episode, step and the method that asks (``reward`` and ``terminated`` count as one), and on the calls
        before in that method: the same whatever else is in the batch. In ``on_reset`` rows of worlds that do not begin are NaN.

        Returns:
            (num_worlds, n), or (num_worlds, n_drones, n) where worlds have several drones.
        """
        n = _count(n)
        sides = []
        for name, side in (("low", low), ("high", high)):
            array = np.asarray(side, dtype=np.float64)
            if array.shape not in ((), (n,)):
                raise ValueError(f"uniform: expected {name} to be one number or {n} numbers, got shape {array.shape}")
            sides.append(np.broadcast_to(array, (n,)).tolist())
        keys = (self.episode, self.step)
        out = self._draws.uniform((self.num_worlds, self.n_drones), keys, self.begins, *sides)
        return out if self.n_drones > 1 else out[:, 0]

    def normal(self, n: int) -> NDArray[np.float32]:
        """As ``uniform``, standard normal."""
        shape = (self.num_worlds, self.n_drones, _count(n))
        out = self._draws.normal(shape, (self.episode, self.step), self.begins)
        return out if self.n_drones > 1 else out[:, 0]


def _count(n: int) -> int:
    if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or not 1 <= n <= 1_000_000:
        raise ValueError(f"n: expected a whole number from 1 to 1000000, got {n!r}")
    return int(n)


class Task:
    """What is asked of the drones of an environment: a base class for tasks of your own.

    A task gives ``channels`` and ``reward``, says by ``start_space`` or ``on_reset`` where drones start, and observes by ``observe``.
    Each method gets the same ``Worlds`` and works on all of them at once. What it says of one world must not depend on the others, if results
    shall not depend on how a batch is split. What it remembers it keeps in arrays of its own. An exception in a method ends the step or
    the reset as it is; then all worlds must be reset.

    ``DroneVectorEnv(task=…)`` takes the class or an object of it; ``register_task`` gives it a name.
    """

    #: What is observed beside ``pos``, ``quat``, ``vel``, ``ang_vel`` and ``depth``: numbers of each drone by name.
    channels: ClassVar[Mapping[str, int]] = {}
    #: Drones start at random places in this box, at rest, with ``start_clearance`` (m) to everything; None: ``on_reset`` says where.
    start_space: Box | None = None
    start_clearance: float = 0.3
    #: Goals are random places in this box, in ``worlds.goal_pos``, with ``goal_clearance`` (m) to everything.
    goal_space: Box | None = None
    goal_clearance: float = 0.0
    #: Drones have goals, which ``reset(options={"goal": …})`` may give; True without a ``goal_space``: ``on_reset`` draws the others.
    has_goal: bool = False
    #: Where it takes place unless the caller says otherwise, and in how many layouts: as ``scene`` and ``layouts`` of ``DroneVectorEnv``.
    scene: Any = None
    layouts: int | None = None
    #: The camera that it is made for, as ``camera`` of ``DroneVectorEnv``; there where there is a scene.
    camera: Any = None
    #: As the arguments of ``DroneVectorEnv``, for callers that say nothing else.
    n_drones: int = 1
    action: Action = "attitude"
    freq: int = 50
    max_episode_time: float = 10.0

    def on_reset(self, worlds: Worlds) -> None:
        """Begins episodes in the worlds of ``worlds.begins``: fills in ``start_pos`` and the like there, and moves obstacles.

        Beside ``begins``, ``episode``, ``layout``, ``start_…``, ``goal_…`` and ``obstacle_…`` arrays still tell of the episode before.
        """

    def before_step(self, worlds: Worlds) -> None:
        """Moves obstacles (``worlds.obstacle_pos``, ``worlds.obstacle_quat``), which stand there through the whole step."""

    def observe(self, worlds: Worlds) -> Mapping[str, ArrayLike]:
        """What is observed by each channel: (num_worlds, width), or (num_worlds, n_drones, width)."""
        return {}

    def reward(self, worlds: Worlds) -> ArrayLike:
        """Rewards of the step: (num_worlds,), or (num_worlds, n_drones). Not used in rows with ``step`` 0."""
        raise NotImplementedError(f"{type(self).__name__}.reward: a task says what a step is worth")

    def terminated(self, worlds: Worlds) -> ArrayLike:
        """Episodes that the step has ended, after ``reward``. (num_worlds,)

        Booleans (True is "crashed" where a drone crashed, else "done"), or numbers of ``ENDINGS`` up to 3. As it is, crashes end episodes.
        """
        return worlds.crashed if worlds.n_drones == 1 else worlds.crashed.any(axis=1)


class TaskCalls:
    """Calls the methods of a task and puts what they return where the environment reads it."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self.name = type(task).__name__
        self.draws = _native.TaskDraws()
        channels = task.channels
        if not isinstance(channels, Mapping) or not all(
            isinstance(name, str) and isinstance(width, int) and 1 <= width <= 1_000_000 for name, width in channels.items()
        ):
            raise ValueError(
                f"{self.name}.channels: expected a dict of names and widths, whole numbers of at least 1, got {channels!r}"
            )
        self.channels = dict(channels)

    def described(self, layouts: int | None) -> str:
        """What the environment has to know of the task, as JSON; ``layouts`` where the caller asks for so many."""
        task = self.task
        camera = task.camera
        if isinstance(camera, str):
            camera = {"device": camera}
        out = {
            "name": self.name,
            "channels": list(self.channels.items()),
            "start": self._place("start_space", task.start_space, task.start_clearance),
            "goal": self._place("goal_space", task.goal_space, task.goal_clearance),
            "has_goal": bool(task.has_goal) or task.goal_space is not None,
            "moves_obstacles": type(task).before_step is not Task.before_step or "before_step" in vars(task),
            "scene": "none" if task.scene is None else _scene(task.scene, task.layouts if layouts is None else layouts),
            "layouts": None if task.layouts is None else int(task.layouts),
            "camera": None if camera is None or camera is False else dict(camera),
        }
        return json.dumps(_plain(self.name, out))

    def _place(self, name: str, space: Box | None, clearance: float) -> list[Any] | None:
        if space is None:
            return None
        box = np.asarray(space, dtype=np.float64)
        if box.shape != (2, 3):
            raise ValueError(f"{self.name}.{name}: expected two corners of three numbers (m), got shape {box.shape}")
        return [box.tolist(), float(clearance)]

    def attach(self, native: _native.Env, config: Mapping[str, Any]) -> None:
        """Makes the views of the environment's arrays."""
        self.worlds = Worlds(native, self.draws, config)
        one = self.worlds.n_drones == 1
        self._axes = "num_worlds" if one else "num_worlds, n_drones"

        def array(name: str) -> Any:
            view = native.array(name)
            return view[:, 0] if one else view

        self._reward, self._ending = array("task_reward"), native.array("task_ending")
        numbers, first = array("channels"), 0
        self._targets: dict[str, NDArray[np.float32]] = {}
        for name, width in self.channels.items():
            self._targets[name] = numbers[..., first : first + width]
            first += width

    def on_reset(self) -> None:
        self.task.on_reset(self.worlds)

    def before_step(self) -> None:
        self.task.before_step(self.worlds)

    def judge(self) -> None:
        worlds, task = self.worlds, self.task
        self._store("reward", self._reward, task.reward(worlds), "")
        ended, ending = task.terminated(worlds), self._ending
        if type(ended) is not np.ndarray:
            ended = self._array("terminated", ended)
        if ended.shape != ending.shape:
            raise self._wrong("terminated", ending.shape, "(num_worlds,)", ended)
        if ended.dtype == np.bool_:
            np.copyto(ending, 3, where=ended)
            crashed = worlds.crashed if worlds.n_drones == 1 else worlds.crashed.any(axis=1)
            np.copyto(ending, 1, where=ended & crashed)
        elif ended.dtype.kind in "iu":
            if ended.min() < 0 or ended.max() > 3:
                raise ValueError(
                    f"{self.name}.terminated: expected booleans, or numbers of propwash.envs.ENDINGS from 0 to 3, got "
                    f"{ended.min()} to {ended.max()}"
                )
            np.copyto(ending, ended, casting="unsafe")
        else:
            raise TypeError(
                f"{self.name}.terminated: expected booleans, or numbers of propwash.envs.ENDINGS, of shape {ending.shape} = "
                f"(num_worlds,), got dtype {ended.dtype}"
            )

    def observe(self) -> None:
        observed = self.task.observe(self.worlds)
        if not isinstance(observed, Mapping) or observed.keys() != self._targets.keys():
            got = sorted(map(str, observed)) if isinstance(observed, Mapping) else type(observed).__name__
            raise ValueError(
                f"{self.name}.observe: expected a dict of the channels {sorted(self._targets)}, got {got}"
            )
        for name, target in self._targets.items():
            self._store(f'observe, channel "{name}"', target, observed[name], ", width")

    def _store(self, what: str, target: NDArray[np.float32], value: Any, axes: str) -> None:
        if type(value) is not np.ndarray:
            value = self._array(what, value)
        if value.dtype.kind not in "fiu":
            raise TypeError(f"{self.name}.{what}: expected an array of real numbers, got dtype {value.dtype}")
        if value.shape != target.shape:
            if target.shape[-1:] == (1,) and value.shape == target.shape[:-1]:
                value = value[..., None]  # one number of each drone, without an axis for it
            else:
                raise self._wrong(what, target.shape, f"({self._axes}{axes})", value)
        np.copyto(target, value, casting="unsafe")

    def _array(self, what: str, value: Any) -> NDArray[Any]:
        try:
            array = np.asarray(value)
        except Exception as e:
            raise TypeError(f"{self.name}.{what}: expected an array, got {type(value).__name__}: {e}") from e
        if array.dtype == object or value is None:
            raise TypeError(f"{self.name}.{what}: expected an array of numbers, got {type(value).__name__}")
        return array

    def _wrong(self, what: str, shape: tuple[int, ...], axes: str, value: NDArray[Any]) -> ValueError:
        return ValueError(f"{self.name}.{what}: expected shape {shape} = {axes}, got {value.shape}")


#: Tasks that ``register_task`` has named.
REGISTERED: dict[str, Callable[..., Task | Goal]] = {}


def own_task(task: Any, options: Mapping[str, Any] | None, built_in: Sequence[str]) -> Task | Goal | None:
    """The object of a task that is not built in; None for the name of one that is."""
    if isinstance(task, (Task, Goal)):
        if options:
            raise ValueError("task_options: expected none beside an object of a task, which has its options already")
        return task
    made = REGISTERED.get(task) if isinstance(task, str) else task
    if made is None:
        if task in built_in:
            return None
        known = ", ".join([*built_in, *REGISTERED])
        raise ValueError(f"task: expected one of {known}, a propwash.learn.Goal or a propwash.envs.Task, got {task!r}")
    if not callable(made):
        raise TypeError(f"task: expected a name, a propwash.learn.Goal or a propwash.envs.Task, got {type(task).__name__}")
    out = made(**(options or {}))
    if not isinstance(out, (Task, Goal)):
        shown = task if isinstance(task, str) else getattr(task, "__name__", repr(task))
        raise TypeError(f"task: expected {shown} to make a propwash.learn.Goal or a propwash.envs.Task, got {type(out).__name__}")
    return out

