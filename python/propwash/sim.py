"""The batched simulator."""

from __future__ import annotations

import json
import os
import warnings
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Callable, Literal, Mapping, Sequence, Union, get_args, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._mirror import Mirror, mirror, picture
from ._native import RestOnGround, State, Vehicle, scenes
from ._repr import shortened
from .costs import Cost, Priced
from .effects import Effect
from .field import DistanceField
from .scene import SceneInfo, scene_info
from .sense import Camera, Clearance, Contacts, DepthFrame, Swept, _broadcast, _floats, _whole
from .tape import Approach, States, Tape
from .viewer import Viewer

if TYPE_CHECKING:
    import mujoco as mj  # type: ignore[import-not-found, import-untyped, unused-ignore]

DroneLike = Union[str, "os.PathLike[str]", Vehicle]
Stage = Union[Callable[["Data"], None], RestOnGround]
SceneName = Literal["corridor", "forest", "meshes", "room", "terrain", "zoo"]
SceneKind = Literal["forest", "corridor", "boxes", "track", "rooms"]
SceneLike = Union[SceneName, str, "os.PathLike[str]", Mapping[str, Any], Sequence[Union[str, "os.PathLike[str]"]], None]
Dynamics = Literal["first_principles", "so_rpy", "so_rpy_rotor", "so_rpy_rotor_drag"]
Control = Literal["state", "attitude", "body_rate", "force_torque", "rotor_vel"]
Floats = NDArray[Any]

#: What programs that come from Crazyflow ask for, and what it is here (docs/migrate.md).
_CRAZYFLOWS = {
    "step_pipeline": "stages are added by sim.pipeline",
    "reset_pipeline": "what resets draw is said by Sim(randomization=…)",
    "build_step_fn": "changes of sim.pipeline hold at once, nothing is built",
    "build_reset_fn": "Sim(randomization=…) holds at once, nothing is built",
    "control_freq": "rates in force are sim.rates[0][sim.control]",
    "seed": "Sim(seed=…) fixes all random numbers",
    "default_data": "sim.set_initial says where drones start",
    "states": "arrays are those of sim.data itself: sim.data.pos",
    "controls": "commands are sim.data.command, sim.data.attitude_command, sim.data.rotor_command",
    "params": "parameters are sim.parameter(name), sim.set_parameter(name, value)",
    "core": "steps are sim.data.steps, seconds sim.time",
    "replace": "arrays are written in place: sim.data.pos[...] = …",
}


def _missing(thing: object, name: str, known: str = "") -> AttributeError:
    """What is raised for a name that a ``Sim`` or its ``Data`` does not have."""
    hint = f"; Crazyflow's, here {_CRAZYFLOWS[name]}" if name in _CRAZYFLOWS else known
    return AttributeError(f"{type(thing).__name__} has no {name!r}{hint}", name=name, obj=thing)


class QuarantineWarning(RuntimeWarning):
    """A world has been set aside because its numbers stopped being numbers."""


class SceneWarning(UserWarning):
    """Something in a scene was overridden or ignored when it was built."""


class CommandWarning(UserWarning):
    """A command is beyond what the vehicle can do, most often since it is in another unit. It is flown as it is; each ``Sim`` warns once."""


@dataclass(frozen=True)
class Quarantine:
    """Why a world stands still."""

    world: int
    drone: int
    """The drone whose state turned non-finite first."""
    step: int
    """Step after which it did; the state kept is the one before."""
    quantity: str
    stage: str | None
    """The stage that wrote it; None where the equations gave it."""
    message: str
    """All of it in words."""


@dataclass(frozen=True)
class SensorChannel:
    """What a sensor gives under one name."""

    name: str
    unit: str
    """SI unit, ``"1"`` where it has none."""
    shape: tuple[int, ...]
    """Shape for one drone."""
    dtype: str


class Data:
    """The arrays of a simulation: views of what it computes with, no copies.

    They have the precision of the ``Sim``, are writable unless said otherwise, and stay valid as long as anything holds them.
    Writing changes the state before the next step: attitudes are brought to unit length, and a world with a number that is
    not finite is quarantined. Do not read or write them while another thread steps the ``Sim``.
    """

    pos: Floats
    """Position, m, world. (n_worlds, n_drones, 3)"""
    quat: Floats
    """Attitude x y z w, body to world. (n_worlds, n_drones, 4)"""
    vel: Floats
    """Velocity, m/s, world. (n_worlds, n_drones, 3)"""
    ang_vel: Floats
    """Angular velocity, rad/s, body. (n_worlds, n_drones, 3)"""
    rotor_vel: Floats
    """Rotor speeds, rad/s. (n_worlds, n_drones, n_rotors)"""
    thrust: Floats
    """Collective thrust state of the fitted attitude models, N. (n_worlds, n_drones)"""
    command: Floats
    """Commands of the control mode; written here they are not checked. (n_worlds, n_drones, command_width)"""
    rotor_command: Floats
    """Rotor speeds that the controllers ask for, rad/s. (n_worlds, n_drones, n_rotors)"""
    attitude_command: Floats
    """Attitude command in force: roll, pitch, yaw (rad), thrust (N). (n_worlds, n_drones, 4)"""
    disturbance_force: Floats
    """Disturbance force, N, world; stays until changed. (n_worlds, n_drones, 3)"""
    disturbance_torque: Floats
    """Disturbance torque, N m, world; stays until changed. (n_worlds, n_drones, 3)"""
    wind: Floats
    """Velocity of the air, m/s, world; stays until changed. (n_worlds, n_drones, 3)"""
    ground_z: Floats
    """Height of the ground below each drone, m, -inf for none; effects read it. In a scene it is measured before every step where an
    effect of the drone reads it, else it is what is written here. (n_worlds, n_drones)"""
    ceiling_z: Floats
    """Height of the ceiling above each drone, m, inf for none; as ``ground_z``. (n_worlds, n_drones)"""
    controller_memory: Floats
    """What the on-board controllers remember. (n_worlds, n_drones, n)"""
    steps: NDArray[np.uint64]
    """Steps since the last reset, read-only. (n_worlds,)"""
    episodes: NDArray[np.uint64]
    """Episodes begun so far, read-only. (n_worlds,)"""

    __slots__ = (
        "pos", "quat", "vel", "ang_vel", "rotor_vel", "thrust", "command", "rotor_command", "attitude_command",
        "disturbance_force", "disturbance_torque", "wind", "ground_z", "ceiling_z", "controller_memory", "steps", "episodes",
        "__weakref__",
    )  # fmt: skip

    def __init__(self, native: _native.Sim) -> None:
        widths = {"rotor_vel": native.n_rotors, "rotor_command": native.n_rotors, "command": native.command_width}
        for name in self.__slots__[:-1]:
            array = native.array(name)
            if name in widths:
                array = array[..., : widths[name]]
            if name in ("steps", "episodes"):
                array.flags.writeable = False
            object.__setattr__(self, name, array)

    if not TYPE_CHECKING:  # else every name would have a type

        def __getattr__(self, name: str) -> Any:
            raise _missing(self, name, f"; there are: {', '.join(self.__slots__[:-1])}")

    def __setattr__(self, name: str, value: object) -> None:
        # `data.pos += x` writes into the array and then sets the attribute to what it is already.
        if name not in self.__slots__:
            known = ", ".join(self.__slots__[:-1])
            raise AttributeError(f"Data has no array {name!r}; there are: {known}")
        if value is not getattr(self, name):
            raise AttributeError(f"data.{name} is a view of the simulation: write into it, `data.{name}[...] = value`")

    def __reduce__(self) -> Any:
        raise TypeError("Data cannot be pickled or copied: it is a view of a Sim; copy its arrays instead")


class Pipeline:
    """The stages of a step, by name and in order.

    ``controllers`` and ``integration`` are built in. A stage of one's own is a function that takes ``Sim.data``, is called once
    per step with all worlds and writes into the arrays. When it raises, the step ends without the remaining Python stages and
    ``Sim.step`` raises what it raised.

    What need not look at every step is added with ``per="call"``: it is called once per call of ``Sim.step`` or ``Recorder.step``, before its first step (``prepend``)
    or after its last (``append``), and the steps in between are flown without Python. Forces, commands and memory of every step that are formulas are effects
    (``propwash.effect``, ``propwash.controller``): they cost no Python at all.
    """

    def __init__(self, native: _native.Sim) -> None:
        self._native = native
        self._before: dict[str, Callable[[Data], object]] = {}
        self._after: dict[str, Callable[[Data], object]] = {}

    @property
    def names(self) -> list[str]:
        """Names of the stages, first to last."""
        return [*self._before, *self._native.stage_names(), *self._after]

    def append(self, name: str, stage: Stage, *, per: Literal["step", "call"] = "step") -> None:
        """Adds a stage as the last."""
        self._add("last", name, stage, per)

    def prepend(self, name: str, stage: Stage, *, per: Literal["step", "call"] = "step") -> None:
        """Adds a stage as the first."""
        self._add("first", name, stage, per)

    def _add(self, place: str, name: str, stage: Stage, per: str = "step", anchor: str | None = None) -> None:
        if not isinstance(name, str):
            raise TypeError(f"name: expected a str, the name of the stage, and the stage after it, got {name!r} ({type(name).__name__})")
        if per not in ("step", "call"):
            raise ValueError(f"per: expected \"step\" or \"call\", got {per!r}")
        if isinstance(stage, Effect):
            raise TypeError(f"stage {name!r}: expected a function of Sim.data, got {stage!r}, which belongs to a vehicle: Sim(drone=NAME.on(...))")
        if name in self._before or name in self._after:
            raise ValueError(f"stage {name!r}: expected a name that no stage has: replace() or remove() that one first")
        if per == "step":
            self._native.add_stage(place, name, stage, anchor)
            return
        if isinstance(stage, RestOnGround) or not callable(stage):
            raise TypeError(f"stage {name!r}: expected a function of Sim.data, got {stage!r}")
        if name in self._native.stage_names():
            raise ValueError(f"stage {name!r}: expected a name that no stage has: replace() or remove() that one first")
        if place == "first":
            self._before = {name: stage, **self._before}
        else:
            self._after[name] = stage

    def _call(self, stages: dict[str, Callable[[Data], object]], data: Data) -> None:
        for name, stage in list(stages.items()):
            result = stage(data)
            if result is not None:
                raise TypeError(f"stage {name!r}: expected None, got {type(result).__name__}; a stage writes into the arrays that it is given and returns nothing")

    def insert_before(self, anchor: str, name: str, stage: Stage) -> None:
        """Adds a stage directly before ``anchor``."""
        self._add("before", name, stage, anchor=_text("anchor", anchor))

    def insert_after(self, anchor: str, name: str, stage: Stage) -> None:
        """Adds a stage directly after ``anchor``."""
        self._add("after", name, stage, anchor=_text("anchor", anchor))

    def replace(self, name: str, stage: Stage) -> None:
        """Puts another stage in the place of one that was added."""
        for stages in (self._before, self._after):
            if name in stages:
                if isinstance(stage, RestOnGround) or not callable(stage):
                    raise TypeError(f"stage {name!r}: expected a function of Sim.data, got {stage!r}")
                stages[name] = stage
                return
        if not isinstance(name, str):
            raise TypeError(f"name: expected a str, the name of the stage, and the stage after it, got {name!r} ({type(name).__name__})")
        self._native.add_stage("instead", name, stage)

    def remove(self, name: str) -> None:
        """Takes out a stage that was added."""
        if self._before.pop(name, None) is None and self._after.pop(name, None) is None:
            self._native.remove_stage(name)

    def __repr__(self) -> str:
        return shortened(f"<propwash.Pipeline {' -> '.join(self.names)}>")


class Sim:
    """Worlds x drones, advanced together.

    ``Sim.from_config`` makes one of a configuration or of a data set's manifest.

    Args:
        n_worlds: Number of worlds.
        n_drones: Drones in each world; the length of ``drone`` where that is a list, else 1.
        drone: Name of a built-in vehicle (``propwash.vehicles()``), path of a vehicle file, or a ``Vehicle``; a list of them,
            one for each drone, mixes vehicles in every world.
        dynamics: ``"first_principles"``, ``"so_rpy"``, ``"so_rpy_rotor"`` or ``"so_rpy_rotor_drag"``; or a list, one for each drone.
        control: What commands mean: ``"state"``, ``"attitude"``, ``"body_rate"``, ``"force_torque"`` or ``"rotor_vel"``.
        freq: Steps per second.
        scene: Name of a scene that comes with the package (``propwash.scenes()``), path of an MJCF (or URDF) file, or MJCF text, or a
            list of them, or one that is generated, such as ``{"forest": {"trees": 40}}``; without one drones fly, and neither see
            nor touch.
        layout: Which scene of a list each world flies in, (n_worlds,); by turns where it is None. ``Sim.layout`` changes it.
        integrator: ``"euler"``, ``"semi_implicit_euler"`` or ``"rk4"``.
        precision: ``"f32"``, or ``"f64"`` for comparisons: the number that is stored and, in lanes, computed with.
        engine: ``"auto"``: ``"lanes"`` of the processor for f32, ``"reference"`` (the equations, world by world) for f64.
        compile: When steps that come without compiled code (effects, other integrators) are compiled by the C compiler of this machine:
            ``"auto"``, what the cache holds at once and the rest in the background as soon as it is worth it; ``"now"`` (or True), before
            the first step; ``"off"`` (or False), never. Results have the same bits (docs/compile.md).
        seed: Seed of all random numbers: randomisation, turbulence, noise of effects.
        threads: Threads that share the worlds; one for each processor where it is None. Results do not depend on it.
        rotor_start: ``"hover"`` or ``"off"``: how rotors start after a reset.
        randomization: What is drawn anew at every reset: text or path of a TOML file, or a list of rules such as
            ``{"parameter": "body.mass_kg", "draw": {"scale": [0.9, 1.1]}}``.
        first_world: Number of the first world over a run that is split: worlds keep their random numbers.
        state_freq, attitude_freq, body_rate_freq, force_torque_freq: Rates of the on-board controller's stages, Hz; those of the
            vehicle file where they are None.
        body_rate_law: What the controllers make of commanded body rates: ``"firmware"``, as the Crazyflie does, which also holds the level
            attitude, so that roll and pitch rates die away; or ``"tracking"``, by which all three rates follow the command.
        shell: Path of another shell (MJCF) than the vehicle's, or a list, one for each drone.
        sensors: Sensors of every drone, which ``read`` samples: ``"imu"``, ``"lidar"``, ``"range_finder"``, ``"optical_flow"``,
            ``"depth_camera"``, or dicts such as ``{"kind": "lidar", "rings": 4, "range_m": 20.0}`` (docs/sensors.md).
        obstacle_motion: How movable obstacles of the scene move by themselves: ``{"kind": "line"}`` (there and back) or ``"circle"``, with
            ``speed_m_s``, ``reach_m`` and ``names`` (docs/configuration.md). They stand where ``obstacle_pos`` puts them where None.
        obstacle_jitter: They are shifted by up to this much in x and y from their places in the scene, anew for every world, m.

    Raises:
        TypeError, ValueError: for arguments that make no sense; messages name what was expected and what was given.
        OSError: for a file that cannot be read.
        Error: where MuJoCo fails.
    """

    n_worlds: int
    n_drones: int
    data: Data
    """The arrays, as views."""
    pipeline: Pipeline
    """The stages of a step."""
    vehicles: tuple[Vehicle, ...]
    """The vehicle of each drone."""
    rates: tuple[Mapping[str, int], ...]
    """Rates in force of each drone's controllers, Hz, by the control mode whose commands they take up: those of the vehicle's file, or
    ``state_freq`` and the others; ``rotor_vel`` commands are taken up at every step. A loop that commands as often as the controller
    listens takes ``freq // rates[0][control]`` steps in each turn."""
    scene: SceneInfo | None
    """What is in the scene, the first one where there are several."""
    scenes: tuple[SceneInfo, ...]
    """What is in each scene."""
    obstacle_pos: NDArray[np.float64]
    """Positions of the bodies that can be moved (``scene.obstacles``), m, world; writable; NaN in rows that the scene of a world
    does not have. (n_worlds, n_obstacles, 3)"""
    obstacle_quat: NDArray[np.float64]
    """Their orientations x y z w; writable. (n_worlds, n_obstacles, 4)"""
    camera: Camera | None
    """The depth camera of its configuration; ``render_depth`` and ``depth_frame`` see by it unless told otherwise."""

    def __init__(
        self,
        n_worlds: int = 1,
        n_drones: int | None = None,
        drone: DroneLike | Sequence[DroneLike] = "cf2x_L250",
        dynamics: Dynamics | Sequence[Dynamics] = "first_principles",
        control: Control = "state",
        freq: int = 500,
        scene: SceneLike = None,
        *,
        layout: ArrayLike | None = None,
        integrator: Literal["euler", "semi_implicit_euler", "rk4"] = "euler",
        precision: Literal["f32", "f64"] = "f32",
        engine: Literal["auto", "lanes", "reference"] = "auto",
        compile: Literal["auto", "now", "off"] | bool = "auto",
        seed: int = 0,
        threads: int | None = None,
        rotor_start: Literal["hover", "off"] = "hover",
        randomization: str | os.PathLike[str] | Sequence[Mapping[str, Any]] | None = None,
        first_world: int = 0,
        state_freq: int | None = None,
        attitude_freq: int | None = None,
        body_rate_freq: int | None = None,
        force_torque_freq: int | None = None,
        body_rate_law: Literal["firmware", "tracking"] = "firmware",
        shell: str | os.PathLike[str] | Sequence[str | os.PathLike[str] | None] | None = None,
        sensors: Sequence[str | Mapping[str, Any]] = (),
        obstacle_motion: Mapping[str, Any] | None = None,
        obstacle_jitter: float = 0.0,
    ) -> None:
        if n_drones is None:
            n_drones = len(drone) if isinstance(drone, (list, tuple)) else 1
        n = _whole("n_drones", n_drones, 1, 2**20)
        # One entry stands for all drones where nothing is given as a list.
        listed = n if any(isinstance(v, (list, tuple)) for v in (drone, dynamics, shell)) else 1
        vehicles = [_vehicle(d) for d in _each("drone", drone, n)[:listed]]
        drones = [
            {"dynamics": _text("dynamics", d), "shell": None if s is None else _path("shell", s)}
            for d, s in zip(_each("dynamics", dynamics, n)[:listed], _each("shell", shell, n))
        ]
        rates = {"state": state_freq, "attitude": attitude_freq, "body_rate": body_rate_freq, "force_torque": force_torque_freq}
        count = _whole("n_worlds", n_worlds, 1, 2**40)
        config = {
            "n_worlds": count,
            "first_world": _whole("first_world", first_world, 0, 2**63),
            "seed": _whole("seed", seed, 0, 2**64 - 1),
            "sim_hz": _whole("freq", freq, 1, 1_000_000),
            "integrator": _text("integrator", integrator),
            "control": _text("control", control),
            "rotor_start": _text("rotor_start", rotor_start),
            "engine": _text("engine", engine),
            "compile": _text("compile", ("now" if compile else "off") if isinstance(compile, bool) else compile),
            "precision": _text("precision", precision),
            "n_drones": n,
            "drones": drones,
            "rates": {
                f"{name}_hz": None if hz is None else _whole(f"{name}_freq", hz, 1, 1_000_000) for name, hz in rates.items()
            },
            "body_rate_law": _text("body_rate_law", body_rate_law),
            "randomization": _rules(randomization),
            "scene": None if scene is None else _scene(scene),
            "layout": None if layout is None else _layout(layout, count).tolist(),
            "sensors": _sensors(sensors),
            "obstacle_motion": None if obstacle_motion is None else dict(obstacle_motion),
            "obstacle_jitter_m": float(obstacle_jitter),
        }
        self._begin(config, vehicles, threads)

    @classmethod
    def from_config(
        cls, source: str | os.PathLike[str] | Mapping[str, Any], *, threads: int | None = None, **changes: Any
    ) -> Sim:
        """Makes the simulation that a configuration describes (docs/configuration.md lists all fields).

        Args:
            source: Path of a configuration (TOML or JSON), of a data set or of its ``manifest.json``; or a dict: of a configuration,
                as ``Sim.config`` gives it, or a whole manifest, as ``propwash.datasets.open(path).manifest``.
            threads: As in ``Sim``.
            changes: Fields of the configuration that are to be others, such as ``n_worlds=1, first_world=3, precision="f32"``.

        Of a data set it is the simulation that was recorded: vehicles, dynamics, rates, integrator, scene, obstacles, randomisation,
        seed, starts and camera. Under ``pattern_command`` it flies the recorded motion again, to the bit.

        Raises:
            ValueError: for a field that is not known or has no such value, and for vehicles or scenes that are others now than when the
                data set was recorded.
            OSError: for a file that cannot be read.
        """
        config = {**_read_config(source), **changes}
        if changes.keys() & {"scene", "drones", "n_drones"} and "scene_sha256" not in changes:
            config["scene_sha256"] = []
        sim = cls.__new__(cls)
        sim._begin(config, None, threads)
        return sim

    def _begin(self, config: dict[str, Any], vehicles: list[Vehicle] | None, threads: int | None) -> None:
        """Everything of a description; ``vehicles`` are those of its list of drones, where it does not say."""
        text = json.dumps(_plain("", config))
        self.threads = None if threads is None else _whole("threads", threads, 1, 1024)
        self._native = _native.Sim(text, vehicles, self.threads)
        made = self.config
        self.n_worlds, self.n_drones, self.freq = self._native.n_worlds, self._native.n_drones, made["sim_hz"]
        self.control, self.integrator, self.precision = made["control"], made["integrator"], made["precision"]
        self.seed = made["seed"]
        self.vehicles = tuple(vehicles * (self.n_drones // len(vehicles)) if vehicles else self._native.vehicles())
        self.rates = tuple(MappingProxyType(rates) for rates in self._native.rates())
        names = [made["drones"][d % len(made["drones"])]["dynamics"] for d in range(self.n_drones)]
        self.dynamics = names[0] if len(set(names)) == 1 else tuple(names)
        self.data = Data(self._native)
        self.pipeline = Pipeline(self._native)
        self.obstacle_pos = self._native.array("obstacle_pos")
        self.obstacle_quat = self._native.array("obstacle_quat")
        self.scenes = tuple(scene_info(self._native.scene_json(i)) for i in range(self._native.n_scenes))
        self.scene = self.scenes[0] if self.scenes else None
        for text in dict.fromkeys(text for info in self.scenes for text in info.warnings):
            warnings.warn(text, SceneWarning, stacklevel=3)
        camera = self._native.camera_json()
        self.camera = None if camera is None else Camera(**_tuples(json.loads(camera)))
        self._cameras: dict[tuple[Camera, bool], list[_native.Cameras]] = {}
        self._mirrors: dict[int, Mirror] = {}

    @property
    def config(self) -> dict[str, Any]:
        """What it was made of, complete, to be stored as JSON and given to ``Sim.from_config``: every field with its value. Vehicles
        that are not built in stand in it as text, so that it needs no vehicle file; scenes stand in it by their paths."""
        out: dict[str, Any] = json.loads(self._native.config_json())
        return out

    # ---- flying

    def pattern_command(self, time: float | None = None) -> NDArray[np.float64]:
        """State commands of the pattern that the configuration names, a new array: those for ``time`` seconds after the reset, or for the
        present time of each world. (n_worlds, n_drones, 16)

        ``sim.state_control(sim.pattern_command())`` before every step flies as ``propwash fly`` does.

        Raises:
            Error: for a configuration without a pattern.
        """
        return self._native.pattern_command(None if time is None else _floats("time", [time], 1)[0])

    def state_control(self, command: ArrayLike) -> None:
        """Sets all commands: position (m), velocity (m/s), acceleration (m/s^2), attitude x y z w of which yaw is used, body
        rates (rad/s). (n_worlds, n_drones, 16)

        Commands stay in force until set again; controllers take them up at their next tick (``rates``). Numbers that are not finite
        are refused, as is an attitude of zeros, and nothing is changed.
        """
        if (doubt := self._native.set_command("state", command)) is not None:
            warnings.warn(doubt, CommandWarning, stacklevel=2)

    def attitude_control(self, command: ArrayLike) -> None:
        """Sets all commands: roll, pitch, yaw (rad), collective thrust (N). (n_worlds, n_drones, 4)

        Warns with ``CommandWarning``, once for each ``Sim``, of a thrust above what all rotors give together, a roll or pitch of more than
        half a turn and a yaw of more than two turns.
        """
        if (doubt := self._native.set_command("attitude", command)) is not None:
            warnings.warn(doubt, CommandWarning, stacklevel=2)

    def body_rate_control(self, command: ArrayLike) -> None:
        """Sets all commands: body rates (rad/s), collective thrust (N). (n_worlds, n_drones, 4)

        Warns with ``CommandWarning``, once for each ``Sim``, of a rate of more than 35 rad/s and of a thrust above what all rotors give
        together.
        """
        if (doubt := self._native.set_command("body_rate", command)) is not None:
            warnings.warn(doubt, CommandWarning, stacklevel=2)

    def force_torque_control(self, command: ArrayLike) -> None:
        """Sets all commands: collective thrust (N), torque (N m, body). (n_worlds, n_drones, 4)

        Warns with ``CommandWarning``, once for each ``Sim``, of a thrust above what all rotors give together.
        """
        if (doubt := self._native.set_command("force_torque", command)) is not None:
            warnings.warn(doubt, CommandWarning, stacklevel=2)

    def rotor_vel_control(self, command: ArrayLike) -> None:
        """Sets all commands: rotor speeds, rad/s. (n_worlds, n_drones, n_rotors)

        Warns with ``CommandWarning``, once for each ``Sim``, of a speed above the greatest of the vehicle.
        """
        if (doubt := self._native.set_command("rotor_vel", command)) is not None:
            warnings.warn(doubt, CommandWarning, stacklevel=2)

    def step(self, n_steps: int = 1) -> None:
        """Advances every world that is not quarantined by ``n_steps``.

        In a scene, where an effect of some drone reads the ground or the ceiling (``ground_effect``, ``ceiling_effect``, an expression
        with ``ground_m`` or ``ceiling_m``), their heights are measured before each of the steps.

        Warns with ``QuarantineWarning`` when the numbers of a world have stopped being numbers.
        """
        if type(n_steps) is not int or n_steps < 0:
            n_steps = _whole("n_steps", n_steps, 0, 2**62)
        pipeline, data = self.pipeline, self.data
        if pipeline._before and n_steps:
            pipeline._call(pipeline._before, data)
        self._tell_quarantine(self._native.step(n_steps, data))
        if pipeline._after and n_steps:
            pipeline._call(pipeline._after, data)

    @property
    def states(self) -> States:
        """Where all drones are, as one new array. (n_worlds, n_drones, …) Setting it writes the states into ``data``: those of all worlds, or of one for all, (n_drones,
        …); what controllers and effects remember stays.
        """
        data = self.data
        return States(np.concatenate([data.pos, data.quat, data.vel, data.ang_vel, data.rotor_vel, data.thrust[..., None]], -1))

    @states.setter
    def states(self, states: States) -> None:
        data = self.data
        width = data.rotor_vel.shape[-1] + 14
        got = states.numbers.shape
        if got not in ((self.n_worlds, self.n_drones, width), (self.n_drones, width)):
            raise ValueError(
                f"states: expected shape (n_worlds, n_drones, state_width) = ({self.n_worlds}, {self.n_drones}, {width}), or that of one world for all, got {got}"
            )
        for part in ("pos", "quat", "vel", "ang_vel", "rotor_vel", "thrust"):
            getattr(data, part)[...] = getattr(states, part)

    @overload
    def rollout(self, commands: ArrayLike, substeps: int = 1, *, field: None = None, radius: float = 0.0, states: bool = True) -> States: ...
    @overload
    def rollout(self, commands: ArrayLike, substeps: int = 1, *, field: DistanceField, radius: float = 0.0, states: bool = False) -> Approach: ...
    @overload
    def rollout(
        self,
        commands: ArrayLike,
        substeps: int = 1,
        *,
        cost: Cost | Callable[[Any], Any],
        given: Mapping[str, ArrayLike] | None = None,
        field: DistanceField | None = None,
        states: bool = False,
    ) -> Priced: ...
    def rollout(
        self,
        commands: ArrayLike,
        substeps: int = 1,
        *,
        field: DistanceField | None = None,
        radius: float = 0.0,
        states: bool | None = None,
        cost: Cost | Callable[[Any], Any] | None = None,
        given: Mapping[str, ArrayLike] | None = None,
    ) -> States | Approach | Priced:
        """Flies a sequence of commands in one call and gives the states after each, or how near the drones came to things, or what the flights cost.

        Args:
            commands: In the units of the control mode; the last stays in force. (n_worlds, n_times, n_drones, command_width)
            substeps: Steps under each command.
            field: Distances to what stands still (``distance_field``): then an ``Approach`` is returned, which is found while the numbers sit in cache. Drones are asked
                where they are after each command; with one step under each that is after every step.
            radius: How near a drone's place may come to things, m.
            states: Whether to give the states with a field or a cost, too; without they are never stored.
            cost: What a drone costs after each command: a function that runs once, made by ``propwash.cost`` (then it is kept for further rollouts) or plain. It is added up
                while the numbers sit in cache, in f64; with a field it sees distances.
            given: Numbers that the cost declares, by name: once, (count,), or for each command, (n_times, count).

        Returns:
            States of shape (n_worlds, n_times, n_drones, …). A world that is quarantined stands still from the command on under which it
            was, and a ``QuarantineWarning`` says so. With a cost a ``Priced``, else with a field an ``Approach``.

        It does what setting one command after the other and stepping does, faster: all commands are flown while a few worlds sit in cache.
        To try many commands from one state, ``fork`` it first.

        Raises:
            ValueError: for commands of another shape or that are not finite, for a ``Sim`` with stages that are functions of Python, and for costs that are no numbers.
            TypeError: for a cost that cannot be an expression, with the line where.
        """
        array, steps = np.asarray(commands), _whole("substeps", substeps, 1, 2**31)
        if cost is not None:
            own = cost if isinstance(cost, Cost) else Cost(cost, {})
            numbers = own._numbers(given, array.shape[1] if array.ndim == 4 else 1)
            made = own._for(self.data.rotor_vel.shape[-1], self.data.command.shape[-1])
            prices, kept, more = self._native.rollout_priced(array, steps, made, numbers, (None if field is None else field._native, bool(states)))
            self._tell_quarantine(more)
            return Priced(prices, None if kept is None else States(kept))
        if given is not None:
            raise ValueError("given: expected None without a cost")
        if field is None:
            if states is False:
                raise ValueError("states: expected True without a field, since nothing else is returned")
            flown, more = self._native.rollout(array, steps)
            self._tell_quarantine(more)
            return States(flown)
        kept, distance, first, more = self._native.rollout_near(array, steps, field._native, (float(radius), bool(states)))
        self._tell_quarantine(more)
        return Approach(distance, first, None if kept is None else States(kept))

    def distance_field(
        self,
        resolution: float = 0.05,
        bounds: tuple[Sequence[float], Sequence[float]] | None = None,
        *,
        scene: int = 0,
        memory_mib: float = 1024.0,
    ) -> DistanceField:
        """Signed distances to everything in a scene that stands still and can collide, on a grid: baked once, from the exact distances of ``clearances``.

        Drones and obstacles that can be moved are not in it. Meshes are their convex hulls, as for contacts. Inside of two things that overlap the distance is that to the
        farther surface of the two.

        Args:
            resolution: Distance of neighbouring points, m.
            bounds: Lowest and highest corner of the grid, m; None: around all these things but planes, and 1 m beyond.
            scene: Which scene, where worlds have several.
            memory_mib: Memory that the grid may take, MiB; four bytes a point.

        Raises:
            ValueError: for bounds or a resolution that make no sense, a grid that takes too much memory (nothing is allocated then), scenes in which nothing stands still,
                and for planes alone without bounds.
            IndexError: for a scene that there is not.
        """
        if not float(memory_mib) > 0.0:
            raise ValueError(f"memory_mib: expected a number above 0, got {memory_mib}")
        box = None if bounds is None else [[float(v) for v in corner] for corner in bounds]
        if box is not None and [len(corner) for corner in box] != [3, 3]:
            raise ValueError(f"bounds: expected two corners of three numbers each, got {bounds}")
        most = int(min(float(memory_mib), 2.0**40) * 2**20)
        return DistanceField._of(self._native.distance_field(float(resolution), box, _whole("scene", scene, 0, 2**31), most))

    def record(self, commands: ArrayLike, substeps: int = 1) -> Tape:
        """As ``rollout``, and remembers the flight: ``Tape.pull_back`` takes gradients of it.

        Raises:
            ValueError: as ``rollout``, and where the ground or the ceiling is measured in a scene, as some effects ask.
        """
        tape, more = self._native.record(np.asarray(commands), _whole("substeps", substeps, 1, 2**31))
        self._tell_quarantine(more)
        return Tape(tape)

    def f(self, x: ArrayLike | States, u: ArrayLike, *, world: int = 0, drone: int = 0) -> NDArray[np.float64]:
        """The time derivative of states under commands, x' = f(x, u), in f64: a plain function that changes nothing.

        ``x`` holds the numbers of ``States.numbers``: position (m, world), attitude x y z w (body to world), velocity (m/s, world), angular velocity (rad/s, body), rotor speeds (rad/s), thrust (N, of
        fitted models): 14 + n_rotors of them, SI. ``u`` is a command of the control mode (``command_width`` numbers: rotor speeds; roll, pitch, yaw, thrust; …). The derivative has the
        shape of ``x``; that of numbers that a model does not use is 0.

        It is the derivative at this instant: on-board controllers tick once, from what they remember now; parameters, effects, wind, disturbances, other drones, time and random
        numbers are those of the world now. With ``control="rotor_vel"``, and for fitted models with ``"attitude"``, it is ``propwash.export``'s ``rate``. What acts between steps (delays of commands,
        batteries that empty) is part of ``F`` alone.

        Args:
            x: States. (…, 14 + n_rotors)
            u: Commands; leading axes broadcast with those of ``x``. (…, command_width)
            world: Whose parameters, memories and surroundings.
            drone: Which drone.

        Raises:
            ValueError: for other shapes, for numbers that are not finite, for a ``Sim`` with stages that are functions of Python, and in scenes where the ground or the ceiling is
                measured before every step, as some effects ask.
        """
        return self._function(x, u, world, drone, None)

    def F(self, x: ArrayLike | States, u: ArrayLike, substeps: int = 1, *, world: int = 0, drone: int = 0) -> NDArray[np.float64]:
        """The states after ``substeps`` steps, x⁺ = F(x, u), in f64: a plain function that changes nothing, as ``f``.

        It is what ``linearize`` takes slopes of: the steps that the world would fly now, with its integrator, its controllers' ticks and memories, and all effects. Other drones of the
        world fly on under their own commands. A row whose numbers stop being numbers is NaN.

        Args:
            x, u, world, drone: As for ``f``.
            substeps: How many steps.

        Raises:
            ValueError: as ``f``.
        """
        return self._function(x, u, world, drone, _whole("substeps", substeps, 1, 2**31))

    def _function(self, x: ArrayLike | States, u: ArrayLike, world: int, drone: int, n_steps: int | None) -> NDArray[np.float64]:
        wide, narrow = self.data.rotor_vel.shape[-1] + 14, self.data.command.shape[-1]
        parts = []
        for name, value, axis, width in (("x", x, "14 + n_rotors", wide), ("u", u, "command_width", narrow)):
            array = np.asarray(value.numbers if isinstance(value, States) else value)
            if array.dtype.kind not in "fiu" or array.shape[-1:] != (width,):
                raise ValueError(f"{name}: expected real numbers of shape (…, {width}) = (…, {axis}), got {array.dtype} of shape {array.shape}")
            parts.append(array)
        try:
            head = np.broadcast_shapes(parts[0].shape[:-1], parts[1].shape[:-1])
        except ValueError:
            raise ValueError(f"x, u: expected leading axes that broadcast to each other, got {parts[0].shape[:-1]} and {parts[1].shape[:-1]}") from None
        many = int(np.prod(head))
        states, commands = (np.ascontiguousarray(np.broadcast_to(part, (*head, part.shape[-1])), np.float64).reshape(many, part.shape[-1]) for part in parts)
        world, drone = _whole("world", world, 0, self.n_worlds - 1), _whole("drone", drone, 0, self.n_drones - 1)
        return self._native.function(world, drone, states, commands, n_steps).reshape(*head, wide)

    def linearize(self, substeps: int = 1, *, x: ArrayLike | States | None = None, u: ArrayLike | None = None) -> tuple[NDArray[Any], NDArray[Any]]:
        """Slopes of ``substeps`` steps, those of ``F``: ``A`` and ``B`` of x' = A x + B u, as ``Tape.linearize`` gives them. The ``Sim`` stays where it is.

        Args:
            substeps: How many steps.
            x: States about which; None: where the drones are. (n_worlds, n_drones, …), or (n_drones, …) of one world for all
            u: Commands about which; None: those that are set. What broadcasts to (n_worlds, n_drones, command_width)
        """
        kept = self.save()
        try:
            if x is not None:
                self.states = x if isinstance(x, States) else States(np.asarray(x))
            if u is not None:
                self.data.command[...] = _broadcast("u", u, self.data.command.shape)
            return self.record(np.array(self.data.command)[:, None], substeps).linearize()
        finally:
            self.restore(kept)

    def _tell_quarantine(self, more: bool) -> None:
        if more:
            first = self.quarantine[0]
            n = int(self.quarantined.sum())
            others = f" ({n} worlds are quarantined in all)" if n > 1 else ""
            warnings.warn(first.message + others, QuarantineWarning, stacklevel=3)

    def reset(self, mask: ArrayLike | None = None) -> None:
        """Back to the initial states, in all worlds or in those where ``mask`` (n_worlds,) is true.

        Controllers and effects forget, time starts anew, what is randomised is drawn for the next episode, quarantine ends.
        Commands, disturbances, wind and obstacles stay; obstacles that move by themselves begin anew.
        """
        self._native.reset(mask)

    def set_initial(
        self,
        pos: ArrayLike | None = None,
        quat: ArrayLike | None = None,
        vel: ArrayLike | None = None,
        ang_vel: ArrayLike | None = None,
    ) -> None:
        """Sets what resets start from, beginning with the next one; what is None stays as it was.

        Args:
            pos: Position, m, world; by default the origin.
            quat: Attitude x y z w, made unit; by default level.
            vel: Velocity, m/s, world.
            ang_vel: Angular velocity, rad/s, body.

        Each is of shape (n_worlds, n_drones, n), or one that broadcasts to it, such as (n,) or (n_drones, n).
        """
        given = (("pos", pos, 3), ("quat", quat, 4), ("vel", vel, 3), ("ang_vel", ang_vel, 3))
        shape = (self.n_worlds, self.n_drones)
        new = {name: None if v is None else _broadcast(name, v, (*shape, n)) for name, v, n in given}
        self._native.set_initial(**new)

    def save(self) -> State:
        """Keeps the whole state: arrays, commands, disturbances, wind, what controllers and effects remember, parameters, what resets
        start from, counts of steps and episodes, quarantine, seed, layout and obstacles. Stages of the pipeline are functions and are
        not part of it.
        """
        return self._native.save()

    def restore(self, state: State) -> None:
        """Puts back what ``save`` kept, of this ``Sim`` or of one that was made in the same way: it goes on from there bit for bit as it
        did. Views of arrays stay valid.

        Raises:
            ValueError: for a state of other worlds, vehicles, control mode, rates, precision or scenes; nothing is changed then.
        """
        self._native.restore(state)

    def fork(self, world: int) -> None:
        """Copies everything of one world into all others: state, commands, memories, parameters, starts, counts of steps and episodes,
        scene and obstacles.

        From then on worlds differ by what they are commanded, and by the random numbers of effects (``turbulence``), of which
        every world draws its own.
        """
        self._native.fork(_whole("world", world, 0, self.n_worlds - 1))

    @property
    def time(self) -> NDArray[np.float64]:
        """Seconds since the last reset of each world, a new array. (n_worlds,)"""
        return self.data.steps / float(self.freq)

    @property
    def quarantined(self) -> NDArray[np.bool_]:
        """Worlds that stand still since their numbers stopped being numbers, a new array. (n_worlds,)"""
        return self._native.quarantined()

    def compiling(self) -> list[str]:
        """How compiling goes, a line for each step that was traced so far and came without compiled code, such as
        ``"compiled in 0.31 s"``; empty where there is none (docs/compile.md)."""
        return self._native.compiling()

    @property
    def quarantine(self) -> list[Quarantine]:
        """Why each of them does."""
        return [Quarantine(*row) for row in self._native.quarantine()]

    def hover_thrust(self) -> NDArray[np.float64]:
        """Collective thrust to command so that each drone hovers, N: its weight, for models that were fitted to flights through the gain
        and the offset of their thrust. (n_worlds, n_drones)"""
        return self._native.hover_thrust()

    def hover_rotor_vel(self) -> NDArray[np.float64]:
        """Rotor speeds that carry the weight of each drone, rad/s. (n_worlds, n_drones, n_rotors)"""
        return self._native.hover_rotor_vel()

    # ---- parameters

    def parameters(self, world: int = 0, drone: int = 0) -> dict[str, float]:
        """All parameters of one drone in one world by name, SI."""
        world = _whole("world", world, 0, self.n_worlds - 1)
        return dict(self._native.parameters(world, _whole("drone", drone, 0, self.n_drones - 1)))

    def parameter(self, name: str) -> NDArray[np.float64]:
        """One parameter of all drones, NaN for drones without it, a new array. (n_worlds, n_drones)

        Raises:
            KeyError: if no drone has it.
        """
        return self._native.parameter(_text("name", name))

    def set_parameter(self, name: str, value: ArrayLike, drone: int | None = None) -> None:
        """Sets one parameter, such as ``body.mass_kg`` or ``effect.linear_drag.drag_n_s_per_m.0.0``.

        Args:
            name: One of ``parameters()``.
            value: One number for all, one for each world, (n_worlds,), or, where ``drone`` is None, one for each drone of each world,
                (n_worlds, n_drones), as ``parameter`` gives them: NaN for drones without it.
            drone: The drone; all drones where it is None.

        Resets keep it, randomisation draws from it. Where a value is refused nothing is changed.
        """
        name = _text("name", name)
        chosen = list(range(self.n_drones)) if drone is None else [_whole("drone", drone, 0, self.n_drones - 1)]
        before = self.parameter(name)
        if np.ndim(value) == 2 and drone is None:
            values = _broadcast("value", value, (self.n_worlds, self.n_drones))
            # What `parameter` gave of drones that do not have it.
            chosen = [d for d in chosen if not (np.isnan(values[:, d]).all() and np.isnan(before[:, d]).all())]
        else:
            column = _broadcast("value", value, (self.n_worlds,))
            values = np.repeat(column[:, None], self.n_drones, axis=1)
        for k, d in enumerate(chosen):
            try:
                self._native.set_parameter(name, d, np.ascontiguousarray(values[:, d]))
            except Exception:
                for done in chosen[:k]:
                    self._native.set_parameter(name, done, np.ascontiguousarray(before[:, done]))
                raise

    if not TYPE_CHECKING:  # else every name would have a type

        def __getattr__(self, name: str) -> Any:
            raise _missing(self, name)  # Python itself adds what is spelt alike

    # ---- sensing

    @property
    def sensors(self) -> dict[str, tuple[SensorChannel, ...]]:
        """What each sensor of its configuration gives, by the name of the sensor."""
        out: dict[str, tuple[SensorChannel, ...]] = {}
        for sensor, name, unit, shape, dtype in self._native.sensor_channels():
            out[sensor] = (*out.get(sensor, ()), SensorChannel(name, unit, tuple(shape), dtype))
        return out

    def read(self, sensor: str, mask: ArrayLike | None = None) -> dict[str, NDArray[Any]]:
        """Samples a sensor now, on every drone, and gives what it reads by channel, new arrays. (n_worlds, n_drones, *shape)

        Args:
            sensor: Its name.
            mask: Worlds to be sampled, (n_worlds,); the others, as those that are quarantined, keep their last sample (zero before
                the first).

        A sensor that remembers (the bias of an ``imu``) goes on from its last sample, and starts anew after a reset; its noise is the
        same for the same seed, world, drone, episode and step.
        """
        channels = self.sensors.get(_text("sensor", sensor))
        if channels is None:
            known = ", ".join(self.sensors) or "none: give sensors=[…] to make some"
            raise KeyError(f"no sensor is called {sensor!r}; there are {known}")
        self._native.sample(sensor, mask)
        return {c.name: self._native.samples(sensor, c.name).astype(c.dtype, copy=False) for c in channels}

    def contacts(self) -> Contacts:
        """All contacts of drones with the scene and with each other, at the present poses."""
        arrays: dict[str, Any] = self._native.contacts()
        touching = np.zeros((self.n_worlds, self.n_drones), bool)
        real = arrays["distance"] <= 0.0
        touching[arrays["world"][real], arrays["drone"][real]] = True
        both = real & (arrays["other_drone"] >= 0)
        touching[arrays["world"][both], arrays["other_drone"][both]] = True
        return Contacts(**arrays, touching=touching, quarantined=self.quarantined, **self._labels(None))

    def clearance(self, max_distance: float = 5.0) -> Clearance:
        """Distance of every drone to the nearest thing that can collide, looking no farther than ``max_distance`` metres."""
        (limit,) = _floats("max_distance", [max_distance], 1)
        arrays: dict[str, Any] = self._native.clearance(limit)
        pos, quat = self._placed("pos", None), self._placed("quat", None)
        return Clearance(**arrays, pos=pos, quat=quat, quarantined=self.quarantined, **self._labels(None))

    def swept(self, pos: ArrayLike, quat: ArrayLike | None = None) -> Swept:
        """What each drone touched first on its straight way from earlier poses to where it is now: what was flown through between
        two calls of ``contacts``, such as a thin wall. Obstacles count where they are now.

        Args:
            pos: Where the drones were, m, world: a copy of ``data.pos`` from before the steps.
            quat: Their attitudes then, x y z w; those of now where it is None.

        Each is of shape (n_worlds, n_drones, n), or one that broadcasts to it.
        """
        shape = (self.n_worlds, self.n_drones)
        before = _broadcast("pos", pos, (*shape, 3))
        arrays: dict[str, Any] = self._native.swept(before, None if quat is None else _broadcast("quat", quat, (*shape, 4)))
        touched = np.zeros(shape, bool)
        touched[arrays["world"], arrays["drone"]] = True
        return Swept(**arrays, touched=touched, quarantined=self.quarantined, **self._labels(None))

    def render_depth(
        self,
        camera: str | Camera | None = None,
        resolution: tuple[int, int] | None = None,
        *,
        worlds: ArrayLike | None = None,
        out: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """Depth images, m; +inf where nothing was seen or it was beyond range, 0 where it was nearer than the range begins.

        Args:
            camera: Name of a camera of the drones' shells or of the scene, or a ``Camera``; that of the configuration, else
                ``"fpv"``, where it is None.
            resolution: Width and height, pixels; those of the camera where it is None.
            worlds: Numbers of the worlds to render; all where it is None.
            out: Array to write into, in place of a new one.

        Returns:
            (n_worlds, n_drones, height, width) for a camera that drones carry, (n_worlds, height, width) for another.
        """
        cameras, _ = self._camera(camera, resolution, False)
        chosen, n = self._worlds(worlds)
        depth = np.empty(self._image(cameras[0], n), np.float32) if out is None else out
        self._native.render(cameras, chosen, {"depth": depth})
        return depth

    def depth_frame(
        self,
        camera: str | Camera | None = None,
        resolution: tuple[int, int] | None = None,
        *,
        normals: bool = False,
        worlds: ArrayLike | None = None,
        out: DepthFrame | None = None,
    ) -> DepthFrame:
        """Depth images with status, geom and body of every pixel, poses and intrinsics of the cameras.

        Args:
            camera, resolution, worlds: As in ``render_depth``.
            normals: Whether the frame holds surface normals.
            out: An earlier frame of the same shape, whose arrays are written over and go into the result.
        """
        cameras, spec = self._camera(camera, resolution, normals)
        chosen, n = self._worlds(worlds)
        shape = self._image(cameras[0], n)
        names = {"depth": np.float32, "status": np.uint8, "geom_id": np.int32, "body_id": np.int32}
        planes: dict[str, Any]
        if out is None:
            planes = {name: np.empty(shape, dtype) for name, dtype in names.items()}
        elif isinstance(out, DepthFrame):
            planes = {name: getattr(out, name) for name in names}
        else:
            raise TypeError(f"out: expected a DepthFrame, got {type(out).__name__}")
        planes["normal"] = None
        if normals:
            old = None if out is None else out.normal
            planes["normal"] = np.empty((*shape, 3), np.float32) if old is None else old
        pos, quat = self._native.render(cameras, chosen, planes)
        return DepthFrame(
            **planes,
            pos=pos,
            quat=quat,
            k=cameras[0].k(),
            kind=spec.kind,
            range=spec.range,
            worlds=np.arange(self.n_worlds) if chosen is None else np.asarray(chosen, np.int64),
            carrier=self._carriers(cameras, chosen),
            drone_pos=self._placed("pos", chosen),
            drone_quat=self._placed("quat", chosen),
            **self._labels(chosen),
        )

    # ---- MuJoCo's own model, window and renderer

    def mujoco(self, world: int = 0) -> tuple[mj.MjModel, mj.MjData]:
        """A world as a model and data of the package ``mujoco``: scene, obstacles and drones where they are now.

        The model is the one that depth images and contacts are found in, with the same ids of geoms and bodies; drones are bodies with free
        joints, ``drone0/drone`` and so on. Both belong to the caller: nothing that is done to them changes the ``Sim``, which goes on flying
        by its own equations. ``sync_mujoco`` brings them up to date.

        ``data`` holds positions and velocities of the drones, poses of the obstacles, the time of the world, and what
        ``mj_kinematics``, ``mj_comPos`` and ``mj_camlight`` make of them. Contacts and forces are not in it: ``mujoco.mj_forward(model,
        data)`` computes them as MuJoCo does, with masses that it takes from the volumes of the shell.

        Raises:
            Error: for a ``Sim`` without a scene, and for a world whose numbers are not finite.
        """
        here = mirror(self, world)
        model = here.load()
        data = here.mujoco.MjData(model)
        here.place(self, world, model, data)
        return model, data

    def sync_mujoco(self, model: mj.MjModel, data: mj.MjData, world: int = 0) -> None:
        """Writes where drones and obstacles of a world are now into what ``mujoco`` gave, of this world or of another in the same scene.

        Raises:
            ValueError: for a model of another scene, or data of another model; nothing is written.
            Error: for a world whose numbers are not finite.
        """
        here = mirror(self, world)
        if not here.fits(model, data):
            raise ValueError(
                f"model, data: expected those of the scene of world {world} ({here.info.name}), as sim.mujoco({world}) gives them, got those of "
                "another scene, or with other drones"
            )
        here.place(self, world, model, data)

    def viewer(self, world: int = 0, **options: Any) -> Viewer:
        """Opens MuJoCo's window on a world; ``Viewer.sync`` shows it as it is then.

        Args:
            world: The world.
            options: What ``mujoco.viewer.launch_passive`` takes: ``show_left_ui``, ``show_right_ui``, ``key_callback``.

        Raises:
            Error: where there is no display, saying what to do, and for a ``Sim`` without a scene.
        """
        return Viewer(self, world, **options)

    def render(
        self,
        camera: str | Camera | None = None,
        *,
        rgb: bool | None = None,
        segmentation: bool = False,
        depth: bool = False,
        world: int = 0,
        width: int | None = None,
        height: int | None = None,
    ) -> NDArray[Any]:
        """A picture of a world by MuJoCo's renderer, which needs OpenGL (EGL, OSMesa or a display; docs/pictures.md).

        Args:
            camera: As in ``render_depth``. The picture is that of the very camera of the depth image: place, orientation, lens, groups, and
                without the drone or body that carries it. ``range``, ``kind`` and ``caster`` mean nothing here.
            rgb: Colours, uint8, (height, width, 3): what is drawn unless another is asked for.
            segmentation: Ids of the geoms, as ``DepthFrame.geom_id``, int32, -1 for none, (height, width).
            depth: MuJoCo's own depth along the camera's axis, m, float32, inf for nothing, (height, width): to compare with.
            world: The world.
            width, height: Pixels; where they are None those of the camera, or 640 x 480 where it states none.

        Returns:
            One picture, or one for each drone, (n_drones, ...), for a camera that drones carry.

        Raises:
            Error: where there is no OpenGL, saying what to install and set, and for a ``Sim`` without a scene.
        """
        chosen: list[Literal["rgb", "segmentation", "depth"]] = []
        if segmentation:
            chosen.append("segmentation")
        if depth:
            chosen.append("depth")
        if rgb or (rgb is None and not chosen):
            chosen.append("rgb")
        if len(chosen) != 1:
            raise ValueError(f"rgb, segmentation, depth: expected one of them to be true, got {' and '.join(chosen) or 'none'}: call it for each")
        return picture(self, camera, chosen[0], world, (width, height))

    def measure_ground(self) -> None:
        """Writes the height of the scene below every drone into ``data.ground_z`` (-inf for none) now, whatever effects read, for
        ``RestOnGround`` and stages of one's own. Effects need no call: what they read is measured at every step."""
        self._native.measure_ground()

    @property
    def layout(self) -> NDArray[np.int64]:
        """Which of ``scenes`` each world flies in, a copy; set it to move worlds from one to another, where the obstacles of those that
        moved stand as the scene has them. (n_worlds,), empty without a scene"""
        return np.array(self._native.layout, np.int64)

    @layout.setter
    def layout(self, value: ArrayLike) -> None:
        self._native.set_layout([int(i) for i in _layout(value, self.n_worlds)])

    def _labels(self, chosen: list[int] | None) -> dict[str, Any]:
        """What ids of a result stand for."""
        return {"scenes": self.scenes, "layout": self.layout if chosen is None else self.layout[chosen]}

    def _placed(self, name: str, chosen: list[int] | None) -> NDArray[np.float64]:
        """Positions or attitudes of the drones of some worlds, in f64, a copy."""
        array = getattr(self.data, name)
        return np.array(array if chosen is None else array[chosen], np.float64)

    def _carriers(self, cameras: list[_native.Cameras], chosen: list[int] | None) -> NDArray[np.int64]:
        """The drone that carries the camera of each image, -1 for none."""
        layout: NDArray[np.int64] = self._labels(chosen)["layout"]
        own: NDArray[np.int64] = np.array([camera.carriers() for camera in cameras], np.int64)[layout]
        return own if cameras[0].per_drone else own[:, 0]

    def _worlds(self, worlds: ArrayLike | None) -> tuple[list[int] | None, int]:
        if worlds is None:
            return None, self.n_worlds
        array = np.atleast_1d(np.asarray(worlds))
        if array.ndim != 1 or array.dtype.kind not in "iu":
            raise TypeError(f"worlds: expected a list of integers, got {worlds!r}")
        chosen = [_whole("worlds", w, 0, self.n_worlds - 1) for w in array]
        return chosen, len(chosen)

    def _camera(
        self, camera: str | Camera | None, resolution: tuple[int, int] | None, normals: bool, keep: bool = True
    ) -> tuple[list[_native.Cameras], Camera]:
        if camera is None:
            camera = self.camera or "fpv"
        if isinstance(camera, str):
            camera = Camera(camera)
        elif not isinstance(camera, Camera):
            raise TypeError(f"camera: expected the name of a camera or a propwash.Camera, got {type(camera).__name__}")
        if resolution is not None:
            camera = replace(camera, resolution=resolution)
        spec = camera._spec(normals)
        if not keep:
            return self._build(spec), camera
        try:
            made = self._cameras.get((camera, normals))
        except TypeError:  # lists where tuples are expected
            return self._build(spec), camera
        if made is None:
            made = self._cameras[(camera, normals)] = self._build(spec)
        return made, camera

    def _build(self, spec: dict[str, Any]) -> list[_native.Cameras]:
        """The camera in every scene, with one size and one K in all."""
        made = [self._native.cameras(spec, i) for i in range(max(len(self.scenes), 1))]
        first = made[0]
        for i, other in enumerate(made):
            same = (other.width, other.height, other.per_drone) == (first.width, first.height, first.per_drone)
            if not same or not np.array_equal(other.k(), first.k()):
                raise ValueError(
                    f"camera: expected one size and one lens in all scenes, got {first.width} x {first.height} in the first and "
                    f"{other.width} x {other.height} in scene {i}, or another K: give resolution and fovy_deg"
                )
        return made

    def _image(self, cameras: _native.Cameras, n_worlds: int) -> tuple[int, ...]:
        tail = (cameras.height, cameras.width)
        return (n_worlds, self.n_drones, *tail) if cameras.per_drone else (n_worlds, *tail)

    def __reduce__(self) -> Any:
        return self._native.__reduce__()  # raises TypeError, with what to do instead

    def __repr__(self) -> str:
        names = sorted({v.name for v in self.vehicles})
        of = f"scene {self.scene.name!r}" if self.scene else "no scene"
        return shortened(
            f"<propwash.Sim {self.n_worlds} worlds x {self.n_drones} drones ({', '.join(names)}), {self.control} control, "
            f"{self.freq} Hz, {self.precision}, {of}>"
        )


def _each(name: str, value: Any, n: int) -> list[Any]:
    """One for each drone."""
    if not isinstance(value, (list, tuple)):
        return [value] * n
    if len(value) != n:
        raise ValueError(f"{name}: expected one, or a list of {n} (n_drones), got a list of {len(value)}")
    return list(value)


def _text(name: str, value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{name}: expected a str, got {value!r} ({type(value).__name__})")
    return str(value)


def _path(name: str, value: Any) -> str:
    try:
        return os.fsdecode(value)
    except TypeError:
        raise TypeError(f"{name}: expected a path, got {value!r} ({type(value).__name__})") from None


def _vehicle(value: DroneLike) -> Vehicle:
    if isinstance(value, Vehicle):
        return value
    if isinstance(value, (str, os.PathLike)):
        return Vehicle(value)
    raise TypeError(
        f"drone: expected the name of a vehicle, a path or a propwash.Vehicle, got {value!r} ({type(value).__name__})"
    )


#: Kinds of scenes that are generated.
_GENERATED = get_args(SceneKind)


def _scene(scene: SceneLike, layouts: int | None = None) -> Any:
    """The scene as the description wants it. A name means the scene that comes with the package, or the generator of this
    name where a number of layouts asks for generated ones."""
    if isinstance(scene, Mapping):
        if len(scene) != 1 or next(iter(scene)) not in _GENERATED:
            expected = ", ".join(_GENERATED)
            raise ValueError(
                f'scene: expected one entry such as {{"forest": {{"trees": 40}}}}, by one of {expected}, got {dict(scene)!r}'
            )
        return {kind: dict(options) for kind, options in scene.items()}
    if isinstance(scene, (str, os.PathLike)):
        text = os.fspath(scene)
        if text == "none":
            return "none"
        if text in _GENERATED and layouts is not None:
            return {text: {}}
        if text in _GENERATED and text not in scenes() and not os.path.exists(text):
            near = get_close_matches(text, scenes(), 1)
            raise FileNotFoundError(
                f"scene: expected one of {', '.join(scenes())} or an MJCF file, got {text!r}, a kind of scenes that are generated"
                f"{f'; did you mean {near[0]!r}?' if near else ''}; {{{text!r}: {{}}}} generates one"
            )
        return {"xml": text} if text.lstrip().startswith("<") else {"files": [text]}
    if isinstance(scene, Sequence):
        if not scene:
            raise ValueError("scene: expected at least one, got an empty list")
        each = [_scene(os.fspath(one)) for one in scene]
        files = [one["files"][0] for one in each if "files" in one]
        return {"files": files} if len(files) == len(each) else {"each": each}
    remedy = {
        "MjSpec": ": write it beside its meshes by spec.to_file(path), and give that path",
        "MjModel": ": no drones can be put into a compiled model; give the MJCF file that it was made of",
    }.get(type(scene).__name__, "")
    raise TypeError(
        f"scene: expected a path, MJCF text, a list of paths or a dict, got {scene!r} ({type(scene).__name__}){remedy}"
    )


def _layout(value: ArrayLike, n_worlds: int) -> NDArray[np.int64]:
    array = np.asarray(value)
    if array.dtype.kind not in "iu" or array.shape != (n_worlds,) or array.min() < 0:
        raise ValueError(
            f"layout: expected whole numbers of at least 0, of shape ({n_worlds},) = (n_worlds,), got {array.dtype} of shape "
            f"{array.shape}"
        )
    return array.astype(np.int64)


def _read_config(
    source: str | os.PathLike[str] | Mapping[str, Any], read: Callable[[str], str] = _native.read_config
) -> dict[str, Any]:
    """A description, or that in a manifest, complete: of a simulation, or of what ``read`` reads."""
    if isinstance(source, Mapping):
        text = json.dumps(_plain("", source))
    else:
        path = Path(_path("source", source))
        path = path / "manifest.json" if path.is_dir() else path
        try:
            out: dict[str, Any] = json.loads(read(path.read_text(encoding="utf-8")))
        except ValueError as e:
            raise ValueError(f"{path}, {e}") from None
        return out
    whole: dict[str, Any] = json.loads(read(text))
    return whole


def _tuples(options: dict[str, Any]) -> dict[str, Any]:
    """Options with tuples in place of lists."""
    return {name: tuple(v) if isinstance(v, list) else v for name, v in options.items()}


def _plain(name: str, value: Any) -> Any:
    """A value as JSON has it, with numbers and arrays of NumPy and paths in it; what JSON does not know is refused, by its place."""
    if isinstance(value, Mapping):
        return {str(key): _plain(f"{name}.{key}" if name else str(key), one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(name, one) for one in value]
    if isinstance(value, (np.generic, np.ndarray)):
        return _plain(name, value.tolist())
    if isinstance(value, os.PathLike):
        return os.fsdecode(value)
    if isinstance(value, float) and not np.isfinite(value):
        raise ValueError(f"{name}: expected a finite number, got {value}")
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"{name}: expected numbers, text, lists and dicts, got {value!r} ({type(value).__name__})")


def _sensors(sensors: Any) -> list[dict[str, Any]]:
    """Descriptions of sensors, of which a name is the kind."""
    if isinstance(sensors, (str, Mapping)) or not isinstance(sensors, Sequence):
        raise TypeError(f"sensors: expected a list of kinds or dicts, got {type(sensors).__name__}")
    out = []
    for i, sensor in enumerate(sensors):
        if not isinstance(sensor, (str, Mapping)):
            raise TypeError(f"sensors[{i}]: expected a kind or a dict, got {type(sensor).__name__}")
        out.append({"kind": sensor} if isinstance(sensor, str) else dict(sensor))
    return out


def _rules(value: str | os.PathLike[str] | Sequence[Mapping[str, Any]] | None) -> dict[str, Any]:
    """Rules as the description wants them."""
    if value is None:
        return {}
    if isinstance(value, (str, os.PathLike)):
        is_text = isinstance(value, str) and "\n" in value
        text = str(value) if is_text else Path(value).read_text(encoding="utf-8")
        rules: dict[str, Any] = json.loads(_native.rules_json(text))
        return rules
    try:
        plain = json.loads(json.dumps([dict(rule) for rule in value]))
    except (TypeError, ValueError) as e:
        raise TypeError(f"randomization: expected TOML text, a path or a list of rules, got {value!r} ({e})") from None
    for k, rule in enumerate(plain):
        if "draw" in rule:
            _check_draw(f"randomization[{k}]", rule["draw"])
    return {"rule": plain}


def _check_draw(rule: str, draw: Any) -> None:
    """Refuses what is no draw, by the number of its rule; whether its numbers make sense is asked later, where the parameter is known."""
    numbers = {"uniform": 2, "scale": 2, "normal": 1}
    if isinstance(draw, Mapping) and len(draw) == 1:
        ((kind, given),) = draw.items()
        if kind in numbers and np.shape(given) == (() if numbers[kind] == 1 else (2,)):
            return
    expected = '{"uniform": [low, high]}, {"scale": [low, high]} or {"normal": sigma}'
    raise ValueError(f"{rule}: draw: expected one of {expected}, got {draw!r}")
