"""Flights of a policy on vehicles, in winds and with delays of one's choice, and what came of them."""

from __future__ import annotations

import fnmatch
import itertools
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _native
from .._write import may_write, write_bytes
from ..sim import DroneLike
from . import _pictures
from ._policy import Policy

Array = NDArray[Any]
Flies = Callable[[dict[str, Any]], Any]

#: Most worlds of one batch.
_BATCH = 256
#: Wind comes from so many directions, in equal parts of the episodes.
_DIRECTIONS = 8
#: Added to the seeds of generated scenes, so that they are others than those of the training.
_OTHER_SCENES = 10_000
#: What rules of the training would draw, but rows state.
_STATED = ("env.wind_m_s.0", "env.wind_m_s.1", "env.wind_m_s.2", "env.action_delay_s")
_TASKS: dict[str, tuple[str, float, str, float | None]] = {
    "reach_pos": ("difference_to_goal", 0.2, "m", None),
    "landing": ("difference_to_goal", 0.15, "m", 0.2),
    "reach_vel": ("difference_to_target_vel", 0.3, "m/s", None),
    "trajectory": ("local_samples", 0.3, "m", None),
}
"""Tasks whose episodes last until the time is up: what tells the distance, how small it is after a success, its unit, and the speed, m/s."""


@dataclass(frozen=True)
class EvaluationRow:
    """What came of the episodes of one vehicle in one wind with one delay. Parts are from 0 to 1."""

    vehicle: str
    wind_m_s: float
    delay_steps: int
    """Steps of the environment."""
    mass_factor: float
    episodes: int
    success: float
    """Part of the episodes that ended well: ``Evaluation.success_means`` says how."""
    crashed: float
    left: float
    """Part that left the space of the task."""
    quarantined: float
    """Part whose state became NaN, infinite or absurd."""
    mean_return: float
    """Sum of the rewards of an episode."""
    mean_seconds: float
    """How long episodes lasted."""
    mean_distance: float | None
    """Distance to the goal at the end (m; ``reach_vel``: m/s); None where the task has none."""


@dataclass(frozen=True)
class Evaluation:
    """What ``propwash.evaluate`` found. ``print`` shows it as a table."""

    environment: str
    seed: int
    success_means: str
    """When an episode counts as a success."""
    rows: tuple[EvaluationRow, ...]
    warnings: tuple[str, ...] = field(default=())
    """What is worth knowing about the rows."""

    def to_dict(self) -> dict[str, Any]:
        """All of it, as JSON has it."""
        return {**asdict(self), "rows": [asdict(row) for row in self.rows], "warnings": list(self.warnings)}

    def __str__(self) -> str:
        head = ["vehicle", "wind m/s", "delay steps", "mass", "success %", "crashed %", "left %", "return", "seconds", "distance"]
        lines = [head]
        for row in self.rows:
            percent = [f"{100.0 * part:.1f}" for part in (row.success, row.crashed, row.left)]
            distance = "-" if row.mean_distance is None else f"{row.mean_distance:.3f}"
            conditions = [row.vehicle, f"{row.wind_m_s:g}", str(row.delay_steps), f"{row.mass_factor:g}"]
            lines.append([*conditions, *percent, f"{row.mean_return:.2f}", f"{row.mean_seconds:.2f}", distance])
        wide = [max(map(len, column)) for column in zip(*lines, strict=True)]
        table = ["  ".join(w.ljust(n) if k == 0 else w.rjust(n) for k, (w, n) in enumerate(zip(line, wide, strict=True))) for line in lines]
        n = self.rows[0].episodes if self.rows else 0
        title = f"{self.environment}, {n} episodes for each row, seed {self.seed}; success: {self.success_means}"
        lost = [f"{row.vehicle}: {100.0 * row.quarantined:.1f} % quarantined" for row in self.rows if row.quarantined > 0.0]
        return "\n".join([title, *(line.rstrip() for line in table), *lost, *(f"note: {text}" for text in self.warnings)])


def evaluate(
    policy: Policy | str | os.PathLike[str] | Flies,
    env_id: str | None = None,
    *,
    vehicles: Sequence[DroneLike] | None = None,
    wind: Sequence[float] = (0.0,),
    delay: Sequence[int] = (0,),
    mass: Sequence[float] = (1.0,),
    episodes: int = 200,
    seed: int = 1_000_000,
    within: float | None = None,
    settings: Mapping[str, Any] | None = None,
    picture: str | os.PathLike[str] | None = None,
    force: bool = False,
) -> Evaluation:
    """Flies a policy on vehicles, in winds, with delays and masses of your choice, and says what came of it.

    Every combination flies the same episodes: starts, goals and scenes follow from ``seed`` and the number of the episode. The environment is
    that of the training, with its options; scenes that are generated have other seeds than those of the training. Rules of randomisation
    stay in force, but for those that change what a row states: wind, delay of the action, mass.

    Args:
        policy: A ``Policy``, its file, or a function from observations (a dict of arrays of all worlds) to actions.
        env_id: Name of the environment, as of ``gymnasium.make_vec``; ``"module:Name-v0"`` imports a module first. None is that of
            the training. In another one the task, its scene and its episodes are its own; all else is as in the training.
        vehicles: Names, files or ``Vehicle``; None is that of the training.
        wind: Speeds of a steady horizontal wind, m/s. It blows from eight directions, each in as many episodes.
        delay: How late actions come to the vehicle, in steps of the environment; at most 1 s.
        mass: Factors of the mass of the vehicle.
        episodes: Of each combination.
        seed: Of the episodes. Choose one that the policy was not trained with.
        within: Distance to the goal at the end that counts as a success, for tasks whose episodes last until the time is up.
        settings: Arguments of ``DroneVectorEnv`` that shall be others than in the training.
        picture: Where to write a picture (PNG) of the first four flights of the first row: one in each row, at the start, after a third and two
            thirds of it, and at its end.
        force: Write over a picture that is there.

    Raises:
        ValueError, TypeError: for arguments that make no sense, and for a policy that does not fit the environment.
    """
    flies, trained = _flier(policy)
    _numbers("wind", wind, 0.0, 1e3)
    _numbers("mass", mass, 1e-3, 1e3)
    _numbers("delay", delay, 0, 10**6)
    if not all(isinstance(d, (int, np.integer)) for d in delay):
        raise ValueError(f"delay: expected whole numbers of steps, got {delay!r}")
    if isinstance(vehicles, (str, os.PathLike, _native.Vehicle)):
        raise TypeError(f"vehicles: expected a list of vehicles, got {vehicles!r}")
    if not isinstance(episodes, (int, np.integer)) or episodes < 1:
        raise ValueError(f"episodes: expected a whole number of 1 and more, got {episodes!r}")
    may_write(picture, force)
    if picture is not None:
        _pictures.writer()
    env_id, arguments = _environment(trained, env_id, settings)
    if vehicles is None:
        own: Any = arguments.get("drone", ["cf2x_L250"])
        vehicles = own if len(own) == 1 else [own]  # several fly together
    if not vehicles:
        raise ValueError("vehicles: expected at least one, got none")
    arguments.pop("drone", None)
    run = _Run(flies, env_id, arguments, int(seed), int(episodes), within)
    rows = []
    for drone, speed, late, factor in itertools.product(vehicles, wind, delay, mass):
        rows.append(run.row(drone, float(speed), int(late), float(factor)))
        if picture is not None and len(rows) == 1:
            write_bytes(picture, run.picture(drone, float(speed), int(late), float(factor)), force)
    return Evaluation(env_id, int(seed), run.success_means, tuple(rows), tuple(dict.fromkeys(run.warnings)))


def _flier(policy: Any) -> tuple[Flies, Policy | None]:
    if isinstance(policy, (str, os.PathLike)):
        policy = Policy.load(policy)
    if not callable(policy):
        raise TypeError(f"policy: expected a Policy, the path of its file, or a function of observations, got {type(policy).__name__}")
    return policy, policy if isinstance(policy, Policy) else None


def _numbers(name: str, values: Any, low: float, high: float) -> None:
    try:
        fine = len(values) > 0 and all(low <= float(v) <= high for v in values)
    except (TypeError, ValueError):
        fine = False
    if not fine:
        raise ValueError(f"{name}: expected a list of numbers from {low:g} to {high:g}, got {values!r}")


def _environment(trained: Policy | None, env_id: str | None, settings: Mapping[str, Any] | None) -> tuple[str, dict[str, Any]]:
    """Name of the environment and the arguments that make it."""
    told = {} if trained is None else trained.trained
    home = told.get("environment")
    if env_id is None:
        env_id = home
    if env_id is None:
        raise ValueError("env_id: expected the name of an environment: the policy does not say where it was trained")
    arguments = arguments_of(told["config"]) if "config" in told else {}
    if "task_options" in told:
        arguments["task_options"] = dict(told["task_options"])
    if env_id.split(":")[-1] != (home or env_id).split(":")[-1]:
        for key in ("task_options", "scene", "layouts", "max_episode_time", "n_drones"):
            arguments.pop(key, None)
    scene = arguments.get("scene")
    if isinstance(scene, Mapping):
        arguments["scene"] = {kind: {**options, "seed": options.get("seed", 0) + _OTHER_SCENES} for kind, options in scene.items()}
    settings = dict(settings or {})
    taken = {"num_envs", "seed", "first_world", "autoreset_mode", "render_mode", "drone"} & set(settings)
    if taken:
        raise ValueError(f"settings: expected arguments that evaluate() does not set itself, got {', '.join(sorted(taken))}")
    return env_id, {**arguments, **settings}


def arguments_of(config: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of ``DroneVectorEnv`` that make what ``config`` describes, but numbers of worlds and seeds."""
    task = {key: value for key, value in config["task"].items() if key != "kind"}
    action = {key: value for key, value in config["action"].items() if key not in ("kind", "normalized")}
    drones = [d["vehicle"] for d in config["drones"]]
    out: dict[str, Any] = {
        "drone": [d if isinstance(d, str) else _native.Vehicle.from_toml(d["toml"], d["name"]) for d in drones],
        "n_drones": config["n_drones"],
        "dynamics": config["drones"][0]["dynamics"],
        "action": config["action"]["kind"],
        "normalize_actions": config["action"]["normalized"],
        "action_options": action,
        "sim_freq": config["sim_hz"],
        "freq": config["step_hz"],
        "max_episode_time": config["max_episode_s"],
        "layouts": config["layouts"],
        "sensors": config["sensors"],
        "look": config["look_m"],
        "levels": config["levels"],
        "randomization": config["randomization"].get("rule") or None,
        "camera": config["camera"] if config["with_camera"] else False,
        "obstacle_motion": config["obstacle_motion"],
        "obstacle_jitter": config["obstacle_jitter_m"],
        "body_rate_law": config["body_rate_law"],
    }
    out["scene"] = _scene_of(config["scene"])
    if config["task"]["kind"] != "own":
        out["task_options"] = task
    return {key: value for key, value in out.items() if value is not None}


def _scene_of(scene: Any) -> Any:
    if isinstance(scene, Mapping):
        if "files" in scene:
            return list(scene["files"])
        if "xml" in scene:
            return scene["xml"]
        if "each" in scene:
            return [_scene_of(one) if not isinstance(one, Mapping) or "files" not in one else one["files"][0] for one in scene["each"]]
    return scene


@dataclass
class _Flown:
    """What came of some episodes, an entry for each."""

    endings: Array
    returns: Array
    steps: Array
    distances: Array
    speeds: Array


class _Run:
    """Flies the rows of an evaluation."""

    def __init__(
        self, flies: Flies, env_id: str, arguments: dict[str, Any], seed: int, episodes: int, within: float | None
    ) -> None:
        self.flies, self.env_id, self.arguments, self.seed, self.episodes = flies, env_id, arguments, seed, episodes
        self.within = within
        self.warnings: list[str] = []
        self.success_means = ""
        self.first_steps: Array = np.zeros(0, np.int64)

    def make(self, drone: Any, wind: Sequence[float], late: int, factor: float, worlds: int, first: int, **more: Any) -> Any:
        """An environment of some of the episodes."""
        try:
            import gymnasium

            import propwash.envs
        except ImportError as missing:
            raise ImportError("propwash.evaluate needs gymnasium: pip install 'propwash[envs]'") from missing
        arguments = dict(self.arguments)
        stated = [*_STATED, *(["body.mass_kg"] if factor != 1.0 else [])]
        rules = [r for r in _listed(arguments.pop("randomization", None)) if not fnmatch.filter(stated, r["parameter"])]
        if factor != 1.0:
            rules.append({"parameter": "body.mass_kg", "draw": {"scale": [factor, factor]}})
        hz = arguments.get("freq") or self._default_hz()
        levels = {**arguments.pop("levels", {}), "wind_m_s": list(wind), "action_delay_s": late / hz}
        env = gymnasium.make_vec(
            self.env_id, num_envs=worlds, drone=drone, levels=levels, randomization=rules or None, seed=self.seed, first_world=first,
            autoreset_mode="NextStep", **arguments, **more,
        )  # fmt: skip
        policy = self.flies
        if isinstance(policy, Policy):
            base: Any = env.unwrapped
            _check_fit(policy, base.config)
            frames = max(channel.frames for channel in policy.observation)
            if frames > 1:
                return propwash.envs.DepthFrameStack(env, frames)
        return env

    def _default_hz(self) -> int:
        import gymnasium

        import propwash.envs

        env: Any = gymnasium.make_vec(self.env_id, num_envs=1, **self.arguments)
        hz = int(env.unwrapped.config["step_hz"])
        env.close()
        return hz

    def parts(self, speed: float) -> Iterator[tuple[list[float], int, int]]:
        """Wind, number of the first episode and number of episodes of each batch."""
        groups = min(_DIRECTIONS, self.episodes) if speed > 0.0 else 1
        edges = [self.episodes * g // groups for g in range(groups + 1)]
        for g, (begin, end) in enumerate(itertools.pairwise(edges)):
            angle = 2.0 * np.pi * g / _DIRECTIONS
            wind = [speed * float(np.cos(angle)), speed * float(np.sin(angle)), 0.0] if speed > 0.0 else [0.0, 0.0, 0.0]
            for first in range(begin, end, _BATCH):
                yield wind, first, min(_BATCH, end - first)

    def row(self, drone: Any, speed: float, late: int, factor: float) -> EvaluationRow:
        """Flies the episodes of a row."""
        flown: list[_Flown] = []
        hz = 1
        for wind, first, worlds in self.parts(speed):
            env = self.make(drone, wind, late, factor, worlds, first)
            config = env.unwrapped.config
            hz = int(config["step_hz"])
            self._say_success(config)
            if speed > 0.0 and first == 0:
                self._look_at_effects(drone, env)
            flown.append(fly(env, self.flies, config["task"]["kind"]))
            env.close()
        every = _Flown(*(np.concatenate([getattr(f, name) for f in flown]) for name in _Flown.__dataclass_fields__))
        if not len(self.first_steps):
            self.first_steps = every.steps[:4]
        ending = every.endings
        known = every.distances[np.isfinite(every.distances)]
        return EvaluationRow(
            vehicle=_name_of(drone),
            wind_m_s=speed,
            delay_steps=late,
            mass_factor=factor,
            episodes=self.episodes,
            success=float(self._succeeded(every).mean()),
            crashed=float((ending == 1).mean()),
            left=float((ending == 2).mean()),
            quarantined=float((ending == 5).mean()),
            mean_return=float(every.returns.mean()),
            mean_seconds=float(every.steps.mean() / hz),
            mean_distance=float(known.mean()) if len(known) else None,
        )

    def _say_success(self, config: Mapping[str, Any]) -> None:
        self.kind = config["task"]["kind"]
        if self.kind in _TASKS:
            _, near, unit, slow = _TASKS[self.kind]
            near = near if self.within is None else self.within
            speed = "" if slow is None else f" and slower than {slow:g} m/s"
            what = {"m/s": "off the velocity", "m": "from the goal"}[unit]
            self.success_means = f"at the end of the time less than {near:g} {unit} {what}{speed}"
        elif self.within is not None:
            raise ValueError(f"within: expected None: episodes of {self.env_id} say themselves whether they ended well")
        elif self.kind == "own":
            self.success_means = "ended as done, or flown until the time was up"
        else:
            self.success_means = "ended as done"

    def _succeeded(self, flown: _Flown) -> Array:
        if self.kind not in _TASKS:
            return np.asarray((flown.endings == 3) | ((flown.endings == 4) & (self.kind == "own")))
        _, near, _, slow = _TASKS[self.kind]
        close = flown.distances < (near if self.within is None else self.within)
        return np.asarray((flown.endings == 4) & close & (True if slow is None else flown.speeds < slow))

    def _look_at_effects(self, drone: Any, env: Any) -> None:
        numbers = env.unwrapped.parameters(0)
        if not any(name.startswith("effect.") and value != 0.0 for name, value in numbers.items()):
            self.warnings.append(f"{_name_of(drone)}: its file has no effect, such as drag, by which wind could move it")

    def picture(self, drone: Any, speed: float, late: int, factor: float) -> bytes:
        """The first flights of the first row, at four times of each."""
        rows: list[list[Array]] = []
        for wind, first, worlds in self.parts(speed):
            own = self.first_steps[first : first + worlds]
            if not len(own):
                break
            env = self.make(drone, wind, late, factor, len(own), first, render_mode="rgb_array", render_size=(320, 240))
            wanted = [sorted({0, n // 3, 2 * n // 3, int(n)}) for n in own]
            taken: list[list[Array]] = [[] for _ in own]

            def look(step: int, base: Any = env.unwrapped, wanted: Any = wanted, taken: Any = taken) -> None:
                for w, steps in enumerate(wanted):
                    if step in steps:
                        taken[w].append(base._picture(w))

            fly(env, self.flies, self.kind, look)
            env.close()
            rows += taken
        return _pictures.png(_pictures.side_by_side(rows))


def _listed(rules: Any) -> list[Any]:
    """Rules of randomisation as a list."""
    from ..sim import _rules

    return list(_rules(rules).get("rule", [])) if rules else []


def _name_of(drone: Any) -> str:
    if isinstance(drone, (list, tuple)):
        return "+".join(_name_of(one) for one in drone)
    return os.path.basename(os.fspath(drone)) if isinstance(drone, (str, os.PathLike)) else str(drone.name)


def _check_fit(policy: Policy, config: Mapping[str, Any]) -> None:
    wanted = (policy.action.kind, policy.action.normalized, policy.action.step_hz)
    found = (config["action"]["kind"], config["action"]["normalized"], config["step_hz"])
    for name, a, b in zip(("action", "normalize_actions", "freq"), wanted, found, strict=True):
        if a != b:
            raise ValueError(f"{name}: expected {a!r}, as in the training of the policy, found {b!r} in the environment")


def fly(env: Any, flies: Flies, kind: str, look: Callable[[int], None] | None = None) -> _Flown:
    """One episode in each world of an environment; ``look`` is called with the number of steps flown."""
    n = env.num_envs
    obs, _ = env.reset()
    running = np.ones(n, bool)
    out = _Flown(np.zeros(n, np.int64), np.zeros(n), np.zeros(n, np.int64), np.full(n, np.nan), np.full(n, np.nan))
    step = 0
    if look is not None:
        look(0)
    while running.any():
        obs, reward, terminated, truncated, info = env.step(flies(obs))
        step += 1
        if look is not None:
            look(step)
        out.returns[running] += reward[running]
        done = running & (terminated | truncated)
        if done.any():
            out.endings[done] = info["ending"][done]
            out.steps[done] = step
            out.distances[done] = _distance(obs, kind)[done]
            out.speeds[done] = _mean_norm(obs["vel"])[done]
            running &= ~done
    return out


def _distance(obs: Mapping[str, Array], kind: str) -> Array:
    channel = _TASKS[kind][0] if kind in _TASKS else "goal"
    if channel not in obs or obs[channel].shape[-1] < 3:
        return np.full(len(obs["pos"]), np.nan)
    return _mean_norm(obs[channel][..., :3])


def _mean_norm(vectors: Array) -> Array:
    """Length of vectors, the mean over the drones of a world."""
    length = np.linalg.norm(vectors, axis=-1)
    return np.asarray(length.reshape(len(length), -1).mean(axis=1))


def as_json(evaluation: Evaluation) -> str:
    """All of an evaluation as text."""
    return json.dumps(evaluation.to_dict(), indent=2)
