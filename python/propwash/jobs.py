"""What commands of the program do, as functions: data sets, scenes, logs, the attitude model, flights that show an effect."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._native import Vehicle
from ._write import may_write, write
from .gap import Drive, LogLike, _Logs
from .sense import _float, _floats, _whole
from .sim import DroneLike, Dynamics, SceneKind, SceneLike, _path, _plain, _read_config, _rules, _scene, _sensors, _text, _vehicle

Pattern = Literal["lissajous", "circle", "hover"]
CameraName = Literal["fpv", "down"]
AttitudeDynamics = Literal["so_rpy", "so_rpy_rotor", "so_rpy_rotor_drag"]


@dataclass(frozen=True)
class Flown:
    """A data set that was flown."""

    out: Path
    """Its folder; ``propwash.datasets.open`` reads it."""
    overview: Path
    """A picture of it."""
    worlds: int
    resumed_worlds: int
    """Worlds that were there already."""
    quarantined_worlds: int
    """Worlds that were stopped because their numbers were no numbers any more."""
    images: int
    state_rows: int
    contact_rows: int
    clearance_rows: int
    bytes: int
    warnings: tuple[str, ...]
    details: Mapping[str, Any] = field(repr=False)
    """Everything, as ``propwash fly --json`` prints it."""


def fly(
    out: str | os.PathLike[str],
    *,
    config: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    scene: SceneLike = None,
    drone: DroneLike | Sequence[DroneLike] | None = None,
    n_worlds: int | None = None,
    n_drones: int | None = None,
    shell: str | os.PathLike[str] | None = None,
    dynamics: Dynamics | None = None,
    trajectory: Pattern | str | os.PathLike[str] | Sequence[Sequence[float]] | NDArray[np.float64] | None = None,
    seconds: float | None = None,
    fps: int | None = None,
    log_freq: int | None = None,
    camera: CameraName | str | Mapping[str, Any] | None = None,
    sensors: Sequence[str | Mapping[str, Any]] = (),
    randomization: str | os.PathLike[str] | Sequence[Mapping[str, Any]] | None = None,
    seed: int | None = None,
    threads: int | None = None,
    progress: Callable[[int, int], object] | None = None,
    **changes: Any,
) -> Flown:
    """Flies drones through a scene along a path and writes a data set, as ``propwash fly`` does: states, depth, segmentation, contacts,
    clearances, a picture (docs/formats.md). What is not given stays as ``config`` has it, or at its default.

    The same arguments give the same bytes, with any number of threads and after any interruption; a data set that is there already is
    completed.

    Args:
        out: Folder of the data set.
        config: Configuration (docs/configuration.md): a dict, a file, or a data set or its manifest, which is flown again.
        scene, drone, n_worlds, n_drones, randomization, seed, threads: As in ``propwash.Sim``.
        shell, dynamics: Another shell (MJCF) than the vehicles', and the model of motion, for all drones.
        trajectory: The path: ``"lissajous"``, ``"circle"`` or ``"hover"``; a CSV file with t, x, y, z and optionally yaw, world and drone;
            or waypoints, rows of time (s), x, y, z (m) and, where there is a fifth, heading (rad).
        seconds: Length of a flight.
        fps: Depth frames per second.
        log_freq: Rows of states, contacts and clearances per second; divides the steps of the simulation.
        camera: Name of a camera of the drones' shells, or a dict of fields of ``camera`` in docs/configuration.md that are to be others. A
            name takes the place of a mount, and ``fovy_deg`` and ``pinhole_px`` that of each other.
        sensors: Further sensors of every drone, as in ``propwash.Sim``, beside those of ``config``.
        progress: Called with the worlds that are done and the number of all, once before the first and after each, from any thread. What it
            raises is raised at the end.
        changes: Other fields of the configuration, such as ``normals=True`` or ``obstacle_jitter_m=0.3``.

    Raises:
        ValueError: for arguments that make no sense, a folder with another data set, and scenes or vehicles that are others now than
            when the data set ``config`` was recorded.
        OSError: for files that cannot be read or written.
    """
    made: dict[str, Any] = {} if config is None else _read_config(config, _native.read_flight)
    twice = (("drone", "drones", drone), ("trajectory", "pattern", trajectory), ("log_freq", "log_hz", log_freq))
    for name, other, value in twice:
        if value is not None and other in changes:
            raise ValueError(f"{name}, {other}: expected one of them, two names for one thing, got both")
    given: dict[str, Any] = {
        "scene": None if scene is None else _scene(scene, changes.get("layouts")),
        "shell": None if shell is None else _path("shell", shell),
        "dynamics": None if dynamics is None else _text("dynamics", dynamics),
        "pattern": None if trajectory is None else _pattern(trajectory),
        "camera": {"name": camera} if isinstance(camera, str) else camera,
        "randomization": None if randomization is None else _rules(randomization),
        "seconds": None if seconds is None else _float("seconds", seconds),
    }
    counts = {"n_worlds": n_worlds, "n_drones": n_drones, "fps": fps, "log_hz": log_freq, "seed": seed}
    given |= {k: None if v is None else _whole(k, v, 0, 2**64 - 1 if k == "seed" else 2**32 - 1) for k, v in counts.items()}
    vehicles: list[Vehicle] = []
    if drone is not None:
        named: list[Any] = list(drone) if isinstance(drone, (list, tuple)) else [drone]
        vehicles = [_vehicle(one) for one in named]
        given["drones"] = [{} for _ in vehicles]
    given = {**changes, **{k: v for k, v in given.items() if v is not None}, "sensors": _sensors(sensors)}
    if given.get("scene", made.get("scene")) is None:
        raise ValueError(f"scene: expected one, such as {', '.join(map(repr, _native.scenes()))} or the path of an MJCF file")
    if threads is not None:
        threads = _whole("threads", threads, 1, 1024)
    text = _native.fly(json.dumps(made), json.dumps(_plain("", given)), vehicles, os.fspath(out), threads, progress)
    told = json.loads(text)
    own = {"out": Path(out), "overview": Path(out) / "overview.png", "warnings": tuple(told["warnings"])}
    return Flown(**{**told, **own}, details=told)


def _pattern(way: Any) -> Any:
    """A trajectory as the description wants it."""
    if isinstance(way, str) and way in get_args(Pattern):
        return way
    names = ", ".join(get_args(Pattern))
    if isinstance(way, (str, os.PathLike)):
        if not os.path.exists(way):
            raise FileNotFoundError(f"trajectory: expected {names}, a CSV file or rows of waypoints, got {way!r}, which is no file")
        return json.loads(_native.waypoints(way))
    expected = f"trajectory: expected {names}, a CSV file or rows of t, x, y, z[, yaw], finite"
    try:
        array = np.asarray(way, np.float64)
    except (TypeError, ValueError) as e:
        raise type(e)(f"{expected}, got {type(way).__name__}: {e}") from None
    if array.ndim != 2 or array.shape[1] not in (4, 5) or not np.isfinite(array).all():
        raise ValueError(f"{expected}, got an array of shape {array.shape}")
    return {"waypoints": [[row[0], row[1:4], row[4] if len(row) == 5 else 0.0] for row in array.tolist()]}


@dataclass(frozen=True)
class GeomLint:
    """What is perceived of one geom of a scene."""

    id: int
    name: str
    body: str
    kind: str
    group: int
    depth: bool
    """Whether depth images see it."""
    depth_reason: str
    """Why they do not; empty where they do."""
    contact: bool
    """Whether drones collide with it."""
    contact_reason: str
    remarks: tuple[str, ...]
    """What else is worth knowing."""


@dataclass(frozen=True)
class LintReport:
    """What depth images and contacts will and will not see in a scene, and why."""

    scene: str
    spawn_m: tuple[float, float, float]
    spawn_radius_m: float
    geoms: tuple[GeomLint, ...]
    remarks: tuple[str, ...]
    """What concerns the whole scene."""
    clean: bool
    """Whether depth and contacts see every geom and the start is free."""
    spawn_blocked: bool
    """Whether the start overlaps something."""
    text: str = field(repr=False)
    """All of it as a table in words."""
    details: Mapping[str, Any] = field(repr=False)
    """Everything, as ``propwash scene lint --json`` prints it."""

    @property
    def mismatches(self) -> tuple[GeomLint, ...]:
        """Geoms that depth or contacts do not see."""
        return tuple(g for g in self.geoms if not (g.depth and g.contact))

    def __str__(self) -> str:
        return self.text


def lint(scene: SceneLike, spawn: Sequence[float] = (0.0, 0.0, 1.0), spawn_radius: float = 0.3) -> LintReport:
    """Says what depth images and contacts see of every geom of a scene, and why not, as ``propwash scene lint`` does.

    Args:
        scene: As in ``propwash.Sim``, one.
        spawn: Where drones start, m.
        spawn_radius: Radius around the start that should be free, m.

    Raises:
        ValueError: for a scene that MuJoCo refuses.
        OSError: for a file that cannot be read.
    """
    at = tuple(_floats("spawn", spawn, 3))
    text, words, all_seen, blocked = _native.lint(_one(scene), at, _float("spawn_radius", spawn_radius))
    of = json.loads(text)
    geoms = tuple(
        GeomLint(
            **{k: g[k] for k in ("id", "name", "body", "kind", "group")},
            depth=g["depth"]["seen"],
            depth_reason=g["depth"]["reason"],
            contact=g["contact"]["seen"],
            contact_reason=g["contact"]["reason"],
            remarks=tuple(g["remarks"]),
        )
        for g in of["geoms"]
    )
    return LintReport(
        scene=of["scene"],
        spawn_m=tuple(of["spawn_m"]),
        spawn_radius_m=of["spawn_radius_m"],
        geoms=geoms,
        remarks=tuple(of["remarks"]),
        clean=all_seen and not blocked,
        spawn_blocked=blocked,
        text=words,
        details=of,
    )


def _one(scene: SceneLike) -> str:
    """One scene as the description wants it, in JSON."""
    return json.dumps(_plain("scene", _scene(scene)))


def scene_new(
    kind: SceneKind,
    out: str | os.PathLike[str] | None = None,
    *,
    seed: int = 0,
    force: bool = False,
    **options: Any,
) -> str:
    """MJCF of a generated scene, the same for the same options and seed, as ``propwash scene new`` writes it.

    Args:
        kind: What is generated.
        out: File to write; none is written where it is None.
        seed: Seed of everything random.
        force: Replace the file ``out``.
        options: Of the generator, such as ``trees=60, size_m=16.0`` of a forest; those of ``propwash scene new`` with units in their names.

    Raises:
        ValueError: for a kind or an option that there is not, or that has no such value; the message lists those that there are.
        FileExistsError: where ``out`` exists, without ``force``.
    """
    may_write(out, force)
    text = _native.scene_new(_one({kind: {"seed": _whole("seed", seed, 0, 2**64 - 1), **options}}))
    write(out, text, force)
    return text


@dataclass(frozen=True)
class LogFinding:
    """One sentence about a log."""

    severity: Literal["info", "warning", "refuse"]
    """``"refuse"``: the log cannot be right as it is."""
    fault: str
    """What it is about, such as ``"time-unit"``."""
    channel: str
    """Empty for the whole log."""
    text: str
    at_s: float | None
    """Where it begins."""
    fixes: Sequence[Mapping[str, Any] | str] = ()
    """What a mapping file would say against it, as ``log_check(…, write_mapping=…)`` writes it."""


@dataclass(frozen=True)
class LogChannel:
    """A channel that was measured."""

    name: str
    samples: int
    rate_hz: float
    largest_gap_s: float
    held: float
    """Share of samples that equal the one before."""


@dataclass(frozen=True)
class LogReport:
    """What a flight log holds, and what in it cannot be right."""

    file: str
    sha256: str
    duration_s: float
    verdict: Literal["info", "warning", "refuse"]
    """The worst severity that was found."""
    channels: tuple[LogChannel, ...]
    findings: tuple[LogFinding, ...]
    """The worst first."""
    text: str = field(repr=False)
    """All of it in words."""
    details: Mapping[str, Any] = field(repr=False)
    """Everything, as ``propwash log check --json`` prints it."""
    corrected: tuple[str, ...] = ()
    """What ``write_mapping`` corrected, in words; the report is then that of the corrected log."""

    def __str__(self) -> str:
        return self.text


def log_check(
    log: LogLike,
    mapping: str | os.PathLike[str] | None = None,
    *,
    write_mapping: str | os.PathLike[str] | None = None,
    force: bool = False,
) -> LogReport:
    """Checks a flight log, as ``propwash log check`` does: what it holds, and what in it cannot be right.

    Args:
        log: A path (.csv, .parquet, .ulg, .mcap, or the folder of a ROS 2 bag), a table of pandas, or arrays by column name (docs/logs.md).
        mapping: TOML file with names, units and frames; the one beside the log where it is None.
        write_mapping: Mapping file to write with the corrections that the check asks for (units, axes, frames, delays); the report is
            then that of the log read with it. None is written where there is nothing to correct.
        force: Replace the file ``write_mapping``.

    Raises:
        ValueError: for a log that cannot be read as one.
        OSError: for a file that cannot be read.
        FileExistsError: where ``write_mapping`` exists, without ``force``.
    """
    may_write(write_mapping, force)
    with _Logs([log]) as paths:
        of_log = None if mapping is None else _path("mapping", mapping)
        text, words, toml, fixes = _native.log_check(paths[0], of_log, write_mapping is not None)
        text, words = paths.named(text, words)
    if fixes:
        write(write_mapping, toml, force)
    of = json.loads(text)
    return LogReport(
        **{k: of[k] for k in ("file", "sha256", "duration_s", "verdict")},
        channels=tuple(LogChannel(**c) for c in of["channels"]),
        findings=tuple(LogFinding(**f) for f in of["findings"]),
        text=words,
        details=of,
        corrected=tuple(fixes),
    )


@dataclass(frozen=True)
class Estimate:
    """A parameter of the attitude model as it was identified, SI."""

    name: str
    """Key of the vehicle file with the axis, such as ``angle_gain_per_s2.roll``."""
    value: float
    sigma: float | None
    """Standard deviation; None where the value was held."""
    low_95: float | None
    high_95: float | None
    unit: str
    held: str | None
    """Where the value is from when the log could not tell."""


@dataclass(frozen=True)
class Identification:
    """The attitude model of a vehicle, from a log."""

    dynamics: str
    vehicle: Vehicle
    """The vehicle with these values."""
    parameters: tuple[Estimate, ...]
    before: Mapping[str, float]
    """Values that the vehicle had, by the names of the parameters."""
    warnings: tuple[str, ...]
    text: str = field(repr=False)
    """All of it in words."""
    details: Mapping[str, Any] = field(repr=False)
    """Everything, as ``propwash identify --json`` prints it."""

    def __str__(self) -> str:
        return self.text


def identify(
    log: LogLike,
    vehicle: str | os.PathLike[str] | Vehicle,
    out: str | os.PathLike[str] | None = None,
    *,
    dynamics: AttitudeDynamics = "so_rpy_rotor_drag",
    mapping: str | os.PathLike[str] | None = None,
    force: bool = False,
) -> Identification:
    """Identifies the attitude model of a vehicle from a flight log, with intervals, as ``propwash identify`` does (docs/identify.md).

    Args:
        log: As in ``log_check``: position, attitude, ``cmd_roll``, ``cmd_pitch``, ``cmd_yaw`` (rad), ``cmd_thrust`` (N).
        vehicle: Built-in name, path of a vehicle file, or a ``Vehicle``: mass, gravity, and what cannot be identified.
        out: Vehicle file to write; none is written where it is None.
        dynamics: Setting of the model: thrust lags in ``so_rpy_rotor``, and there is linear drag in ``so_rpy_rotor_drag``.
        mapping: As in ``log_check``.
        force: Replace the file ``out``.

    Raises:
        ValueError: for a log that cannot be right or lacks what is needed.
        FileExistsError: where ``out`` exists, without ``force``.
    """
    may_write(out, force)
    before = _vehicle(vehicle)
    with _Logs([log]) as paths:
        text, words, toml, doubts = paths.named(
            *_native.identify(paths[0], before, dynamics, None if mapping is None else _path("mapping", mapping), out)
        )
    of = json.loads(text)
    write(out, toml, force)
    return Identification(
        dynamics=of["dynamics"],
        vehicle=Vehicle.from_toml(toml, before.name),
        parameters=tuple(Estimate(**p) for p in of["parameters"]),
        before=of["before"],
        warnings=(*doubts, *of["warnings"]),
        text=words,
        details=of,
    )


@dataclass(frozen=True)
class FirstNumber:
    """A number of a first vehicle, SI."""

    name: str
    unit: str
    value: float
    sigma: float
    """Standard deviation."""
    source: str
    """Given, a law of scale, or the flights that it was sharpened by."""


@dataclass(frozen=True)
class FirstVehicle:
    """A vehicle that was made from mass, arm and flights."""

    vehicle: Vehicle
    numbers: tuple[FirstNumber, ...]
    from_logs: tuple[str, ...]
    """What the flights said, and what they did not."""
    measure_next: tuple[str, ...]
    """What to measure next, most telling first."""
    text: str = field(repr=False)
    """All of it in words."""

    def __str__(self) -> str:
        return self.text


def vehicle_new(
    mass_kg: float,
    arm_m: float,
    out: str | os.PathLike[str] | None = None,
    *,
    logs: Sequence[LogLike] = (),
    rotors: int = 4,
    layout: Literal["x", "plus"] = "x",
    first_clockwise: bool = False,
    mass_sigma_kg: float | None = None,
    radius_m: float | None = None,
    inertia_kg_m2: Sequence[float] | None = None,
    thrust_to_weight: float | None = None,
    mapping: str | os.PathLike[str] | None = None,
    name: str = "vehicle",
    force: bool = False,
) -> FirstVehicle:
    """Makes a first vehicle file from mass and arm, as ``propwash vehicle new`` does (docs/first_vehicle.md).

    Args:
        mass_kg: Mass with battery.
        arm_m: Distance from the centre to each rotor.
        out: Vehicle file to write; none is written where it is None.
        logs: Flights with rotor speeds, each as in ``log_check``, that sharpen what they can.
        rotors: 4, 6 or 8 on a ring, rotor 1 at the right of the front, the others clockwise, as seen from above.
        layout: Whether the front lies between two rotors (``x``) or at one (``plus``).
        first_clockwise: Rotor 1 turns clockwise, seen from above; neighbours turn opposite ways.
        mass_sigma_kg: Standard deviation of the mass; a hundredth of it where it is None.
        radius_m: Radius of the propellers; by a law of scale where it is None.
        inertia_kg_m2: Inertia about x, y, z; by a law of scale where it is None.
        thrust_to_weight: Greatest thrust over weight; 2 where it is None.
        mapping: As in ``log_check``.
        name: Name of the vehicle where nothing is written.
        force: Replace the file ``out``.

    Raises:
        ValueError: for numbers that no vehicle has, and for logs that cannot be right.
        FileExistsError: where ``out`` exists, without ``force``.
    """
    may_write(out, force)
    if layout not in ("x", "plus"):
        raise ValueError(f"layout: expected 'x' or 'plus', got {layout!r}")

    def maybe(name: str, value: float | None) -> float | None:
        return None if value is None else _float(name, value)

    given = {
        "mass": _float("mass_kg", mass_kg),
        "mass_sigma": maybe("mass_sigma_kg", mass_sigma_kg),
        "arm": _float("arm_m", arm_m),
        "rotors": _whole("rotors", rotors, 1, 64),
        "plus": layout == "plus",
        "first_clockwise": bool(first_clockwise),
        "radius": maybe("radius_m", radius_m),
        "inertia": None if inertia_kg_m2 is None else _floats("inertia_kg_m2", inertia_kg_m2, 3),
        "thrust_to_weight": maybe("thrust_to_weight", thrust_to_weight),
    }
    named = name if out is None else Path(out).stem
    with _Logs(logs) as paths:
        toml, text, words = paths.named(
            *_native.vehicle_new(given, list(paths), None if mapping is None else _path("mapping", mapping), named)
        )
    of = json.loads(text)
    write(out, toml, force)
    return FirstVehicle(
        vehicle=Vehicle.from_toml(toml, named),
        numbers=tuple(FirstNumber(**n) for n in of["numbers"]),
        from_logs=tuple(of["from_logs"]),
        measure_next=tuple(of["measure_next"]),
        text=words,
    )


@dataclass(frozen=True)
class Motors:
    """Motors by throttle and voltage, as flights tell them: u V = offset + back-EMF · Ω + load · Ω²."""

    vehicle: Vehicle
    """The vehicle with them: ``[throttle]``, the motors' time constant, the commands' delay."""
    offset_v: float
    back_emf_v_s_per_rad: float
    load_v_s2_per_rad2: float
    nominal_v: float
    """Voltage where a log has none."""
    by_speeds: bool
    """Whether rotor speeds were measured; otherwise the lift tells, with the file's mass and thrust curves."""
    lag_s: tuple[tuple[float, float], tuple[float, float]] | None
    """Time constants of the motors up and down, each with its standard deviation; None where the flights do not tell them."""
    delay_s: tuple[float, float]
    """Time from a logged throttle until the motor answers, and its standard deviation."""
    explained: float
    """Share of the variance of the rotors' speeds (or of the lift) that is explained on the flights of the fit."""
    explained_unseen: float
    """The same on held-out flights; without any, on the worse half of the flights by a fit to the other half."""
    notes: tuple[str, ...]
    text: str = field(repr=False)
    """All of it in words."""

    def __str__(self) -> str:
        return self.text


def vehicle_throttle(
    logs: LogLike | Sequence[LogLike],
    vehicle: str | os.PathLike[str] | Vehicle,
    out: str | os.PathLike[str] | None = None,
    *,
    held_out: Sequence[LogLike] = (),
    mapping: str | os.PathLike[str] | None = None,
    force: bool = False,
) -> Motors:
    """Fits how fast motors turn by throttle and battery voltage, as ``propwash vehicle throttle`` does (docs/throttle.md).

    Args:
        logs: Flights with throttles ``cmd_u1`` … of all rotors, each as in ``log_check``; with rotor speeds, or a pose from which
            the lift follows; ``vbat`` tells the battery from the motors.
        vehicle: Name of a built-in vehicle, a vehicle file, or a ``Vehicle``.
        out: Vehicle file to write; none is written where it is None.
        held_out: Flights that the fit does not see, to be explained by it.
        mapping: As in ``log_check``.
        force: Replace the file ``out``.

    Raises:
        ValueError: for logs without throttles of every rotor, and for throttles that do not go with the rotors' speeds.
        FileExistsError: where ``out`` exists, without ``force``.
    """
    may_write(out, force)
    before = _vehicle(vehicle)
    with _Logs(logs) as paths, _Logs(list(held_out)) as unseen:
        toml, text, words = paths.named(
            *_native.vehicle_throttle(
                list(paths), list(unseen), before, None if mapping is None else _path("mapping", mapping)
            )
        )
    of = json.loads(text)
    write(out, toml, force)
    table = of["table"]

    def pair(number: dict[str, float]) -> tuple[float, float]:
        return number["value"], number["sigma"]

    return Motors(
        vehicle=Vehicle.from_toml(toml, before.name if out is None else Path(out).stem),
        offset_v=table["offset_v"],
        back_emf_v_s_per_rad=table["back_emf_v_s_per_rad"],
        load_v_s2_per_rad2=table["load_v_s2_per_rad2"],
        nominal_v=table["nominal_v"],
        by_speeds=of["by_speeds"],
        lag_s=None if of["lag_s"] is None else (pair(of["lag_s"][0]), pair(of["lag_s"][1])),
        delay_s=pair(of["delay_s"]),
        explained=of["fitted"]["share"],
        explained_unseen=of["unseen"]["share"],
        notes=tuple(of["notes"]),
        text=words,
    )


@dataclass(frozen=True)
class Manoeuvre:
    """A part of a planned flight."""

    name: str
    title: str
    """What is flown."""
    start_s: float
    duration_s: float
    intensity: float
    """Share of full speed and acceleration at which the vehicle can fly it."""
    peak_speed_m_s: float
    peak_tilt_rad: float
    peak_error_m: float
    """Greatest distance from the reference."""


@dataclass(frozen=True)
class FlightPlan:
    """A flight that makes chosen parameters visible, with the standard deviations to expect."""

    vehicle: str
    duration_s: float
    complete: bool
    """Whether every interval is as narrow as wanted."""
    manoeuvres: tuple[Manoeuvre, ...]
    parameters: tuple[Mapping[str, Any], ...]
    """The wanted parameters: ``id``, ``name``, ``unit``, ``target`` (the standard deviation that is wanted), ``whole`` (what to expect,
    ``alone`` and ``with_look_alike``), ``reached``, ``reason``."""
    waypoints: NDArray[np.float64] = field(repr=False)
    """Rows of time (s), x, y, z (m), heading (rad): ``trajectory`` of ``propwash.fly``. (n, 5)"""
    warnings: tuple[str, ...]
    csv: str = field(repr=False)
    """The waypoints as CSV with t, x, y, z, yaw."""
    details: Mapping[str, Any] = field(repr=False)
    """Everything, as ``propwash excite --json`` prints it."""


def excite(
    vehicle: str | os.PathLike[str] | Vehicle,
    want: str | Sequence[str],
    out: str | os.PathLike[str] | None = None,
    *,
    seconds: float = 60.0,
    share: float = 0.1,
    box: Sequence[float] = (6.0, 6.0, 3.0),
    ground: bool = True,
    ceiling_z: float | None = None,
    drive: Drive | None = None,
    sensors: Mapping[str, float] | None = None,
    air_force: float | None = None,
    seed: int = 0,
    force: bool = False,
) -> FlightPlan:
    """Plans a flight that makes effects visible, as ``propwash excite`` does (docs/excite.md).

    Args:
        vehicle: Built-in name, path of a vehicle file, or a ``Vehicle``.
        want: Effects, such as ``"linear_drag"`` or ``"weak_rotor.2"``; ``"weak_rotor"`` alone means all rotors.
        out: CSV file of the waypoints to write; none is written where it is None.
        seconds: Longest flight.
        share: Standard deviation that is wanted, as a share of the effect's plausible size.
        box: Length, width and height of the space, m: x and y from minus to plus half of theirs, z from 0 up.
        ground: There is ground at z = 0.
        ceiling_z: Height of a ceiling that can be flown under, m.
        drive: Which input of the log will drive the model; rotor commands where it is None.
        sensors: What differs from motion capture at 240 Hz with gyroscope and accelerometer at 500 Hz: ``pose_hz``, ``position_m``,
            ``attitude_rad``, ``gyro_hz``, ``gyro_rad_s``, ``accel_hz``, ``accel_m_s2`` (standard deviations; a rate of 0 is no sensor).
        air_force: Accelerations by moving air that no model explains, m/s²; 0.03 where it is None.
        seed: Seed of noise and disturbances.
        force: Replace the file ``out``.

    Raises:
        ValueError: for arguments that make no sense.
        KeyError: for an effect that there is not.
        FileExistsError: where ``out`` exists, without ``force``.
    """
    may_write(out, force)
    wish = _wish(
        want=_names("want", want, "linear_drag"), seconds=seconds, share=share, box=box, ground=ground, ceiling_z=ceiling_z, drive=drive,
        sensors=sensors, air_force=air_force, seed=seed,
    )  # fmt: skip
    text, waypoints, csv, complete = _native.excite(_vehicle(vehicle), wish)
    of = json.loads(text)
    write(out, csv, force)
    return FlightPlan(
        vehicle=of["vehicle"],
        duration_s=of["duration_s"],
        complete=complete,
        manoeuvres=tuple(Manoeuvre(**m) for m in of["manoeuvres"]),
        parameters=tuple(of["parameters"]),
        waypoints=_rows(waypoints),
        warnings=tuple(of["warnings"]),
        csv=csv,
        details={**of, "waypoints": None if out is None else os.fspath(out)},
    )


@dataclass(frozen=True)
class ManoeuvreFlight:
    """A flight of named manoeuvres."""

    vehicle: str
    duration_s: float
    manoeuvres: tuple[str, ...]
    waypoints: NDArray[np.float64] = field(repr=False)
    """Rows of time (s), x, y, z (m), heading (rad): ``trajectory`` of ``propwash.fly``. (n, 5)"""
    csv: str = field(repr=False)
    """The waypoints as CSV with t, x, y, z, yaw."""
    details: Mapping[str, Any] = field(repr=False)
    """Everything, as ``propwash excite --fly --json`` prints it."""


def manoeuvres(
    vehicle: str | os.PathLike[str] | Vehicle,
    names: str | Sequence[str],
    out: str | os.PathLike[str] | None = None,
    *,
    box: Sequence[float] = (6.0, 6.0, 3.0),
    ground: bool = True,
    ceiling_z: float | None = None,
    drive: Drive | None = None,
    sensors: Mapping[str, float] | None = None,
    air_force: float | None = None,
    seed: int = 0,
    force: bool = False,
) -> ManoeuvreFlight:
    """Puts named manoeuvres into one flight, one after the other, as ``propwash excite --fly`` does: those that a diagnosis advises
    (``Diagnosis.next_flight``).

    Args:
        vehicle, out, box, ground, ceiling_z, drive, sensors, air_force, seed, force: As in ``excite``.
        names: Manoeuvres, such as ``"low passes"``.

    Raises:
        ValueError: for arguments that make no sense.
        KeyError: for a manoeuvre that there is not.
        FileExistsError: where ``out`` exists, without ``force``.
    """
    may_write(out, force)
    flown = [name.strip() for name in _names("names", names, "low passes")]
    wish = _wish(
        want=[], seconds=60.0, share=0.1, box=box, ground=ground, ceiling_z=ceiling_z, drive=drive, sensors=sensors, air_force=air_force,
        seed=seed,
    )  # fmt: skip
    of = _vehicle(vehicle)
    waypoints, csv = _native.manoeuvres(of, wish, flown)
    write(out, csv, force)
    rows = _rows(waypoints)
    seconds = float(rows[-1, 0]) if len(rows) else 0.0
    told = {"manoeuvres": flown, "duration_s": seconds, "waypoints": None if out is None else os.fspath(out)}
    return ManoeuvreFlight(of.name, seconds, tuple(flown), rows, csv, told)


@dataclass(frozen=True)
class Advice:
    """A manoeuvre that tells effects from others."""

    manoeuvre: str
    text: str
    """What it shows."""


def tell_apart(
    vehicle: str | os.PathLike[str] | Vehicle,
    want: str | Sequence[str],
    others: str | Sequence[str],
    *,
    drive: Drive | None = None,
    sensors: Mapping[str, float] | None = None,
) -> tuple[Advice, ...]:
    """Names the manoeuvres that tell effects from others, best first, as ``propwash excite --from`` does; none where hover and a slow
    figure of eight do it as well.

    Args:
        vehicle, drive, sensors: As in ``excite``.
        want: Effects to be told, such as ``"com_offset"``.
        others: Effects that look like them, such as ``"weak_rotor.2"``.

    Raises:
        ValueError: for arguments that make no sense.
        KeyError: for an effect that there is not.
    """
    told = _native.tell_apart(
        _vehicle(vehicle), _names("want", want, "com_offset"), _names("others", others, "weak_rotor.2"), drive, _readings(sensors)
    )
    return tuple(Advice(*one) for one in told)


def _names(name: str, value: str | Sequence[str], example: str) -> list[str]:
    names = [value] if isinstance(value, str) else list(value)
    if not names:
        raise ValueError(f"{name}: expected at least one, such as {example!r}, got none")
    return names


def _wish(*, box: Any, ceiling_z: Any, sensors: Any, air_force: Any, **wish: Any) -> dict[str, Any]:
    """What a flight is planned for."""
    return {
        **wish,
        "seconds": _positive("seconds", wish["seconds"]),
        "share": _positive("share", wish["share"]),
        "room": _floats("box", box, 3),
        "ground": bool(wish["ground"]),
        "ceiling_z": None if ceiling_z is None else _positive("ceiling_z", ceiling_z),
        "sensors": _readings(sensors),
        "air_force": None if air_force is None else _positive("air_force", air_force),
        "seed": _whole("seed", wish["seed"], 0, 2**64 - 1),
    }


def _readings(sensors: Mapping[str, float] | None) -> str:
    return json.dumps(_plain("sensors", sensors or {}))


def _rows(waypoints: Sequence[tuple[float, list[float], float]]) -> NDArray[np.float64]:
    return np.array([[t, *pos, yaw] for t, pos, yaw in waypoints]).reshape(-1, 5)


def _positive(name: str, value: Any) -> float:
    number = _float(name, value)
    if not (np.isfinite(number) and number > 0.0):
        raise ValueError(f"{name}: expected a number above 0, got {value!r}")
    return number
