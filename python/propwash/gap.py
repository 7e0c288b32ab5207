"""Models against flights: where a vehicle's model fails, which physics it lacks, and the vehicle with that added."""

from __future__ import annotations

import hashlib
import html
import json
import os
import sys
import tempfile
import warnings
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Iterable, Literal, Mapping, Sequence, Union

import numpy as np

from . import _native
from ._native import Vehicle
from ._write import may_write, write

if TYPE_CHECKING:
    import pandas  # type: ignore[import-not-found, import-untyped, unused-ignore]

LogLike = Union[str, "os.PathLike[str]", "pandas.DataFrame", Mapping[str, Any]]
"""A flight: a path (.csv, .parquet, .ulg, .mcap, or the folder of a ROS 2 bag), a table of pandas, or arrays by column name (docs/logs.md)."""

Drive = Literal["rotor_commands", "rotor_speeds", "attitude_commands", "thrust"]


@dataclass(frozen=True)
class Report:
    """One page for people: an HTML file that needs no other and no network."""

    html: str = field(repr=False)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the page; a file that is there is replaced when the new one is whole."""
        write(path, self.html, True)

    def show(self, height: int = 800) -> Any:
        """Shows the page in a notebook; elsewhere in a browser. ``height`` in pixels."""
        # A notebook has IPython loaded already; a program that has not needs none.
        loaded = sys.modules.get("IPython")
        if loaded is None or loaded.get_ipython() is None:
            return self._open()
        display = import_module("IPython.display")
        return display.display(display.HTML(self._frame(height)))

    def _open(self) -> None:
        import webbrowser

        name = hashlib.sha256(self.html.encode()).hexdigest()[:16]
        path = Path(tempfile.gettempdir()) / f"propwash-{name}.html"
        self.save(path)
        webbrowser.open(path.as_uri())

    def _frame(self, height: int) -> str:
        # A frame of its own keeps the page's styles and scripts from those of the notebook.
        page = html.escape(self.html, quote=True)
        return f'<iframe srcdoc="{page}" width="100%" height="{int(height)}" style="border:0"></iframe>'

    def _repr_html_(self) -> str:
        return self._frame(800)


@dataclass(frozen=True)
class HorizonError:
    """Root-mean-square error of roll-outs of one length from measured states, at their end."""

    horizon_s: float
    position_m: float
    velocity_m_s: float
    attitude_rad: float | None
    """None where the attitude is an input of the model."""
    rate_rad_s: float | None
    n: int
    """Roll-outs."""


@dataclass(frozen=True)
class LogComparison:
    """One flight against the model."""

    name: str
    sha256: str
    duration_s: float
    drive: str
    """What drove the model."""
    agrees: bool
    verdict: str
    warnings: tuple[str, ...]
    findings: tuple[str, ...]
    """What the residuals go with, most telling first."""
    horizons: tuple[HorizonError, ...]
    worst_times_noise: float
    """Largest error over what the sensors' noise makes."""
    details: Mapping[str, Any] = field(repr=False)
    """Everything else, as the JSON of ``propwash compare --json``."""


@dataclass(frozen=True)
class Comparison:
    """A model against flights."""

    vehicle: str
    agrees: bool
    """Whether the model agrees with every flight to the noise of the sensors."""
    within_tolerance: bool | None
    """Where it does not: whether numbers within the vehicle's tolerances explain what it leaves, so that nothing is missing."""
    verdict: str
    """One sentence."""
    logs: tuple[LogComparison, ...]
    report: Report

    def to_frame(self) -> pandas.DataFrame:
        """Errors of roll-outs, one row for each log and horizon, SI."""
        return _frame([{"log": log.name, **vars(h)} for log in self.logs for h in log.horizons])

    def _repr_html_(self) -> str:
        return self.report._repr_html_()

    def __str__(self) -> str:
        return f"{self.vehicle}: {self.verdict}"


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect as it was fitted, SI."""

    name: str
    unit: str
    filed: float
    """Value in the vehicle file, or the effect's default."""
    value: float
    sigma: float
    """Standard deviation of ``value``."""


@dataclass(frozen=True)
class Finding:
    """A missing effect."""

    id: str
    kind: str
    title: str
    """In plain words."""
    parameters: tuple[Parameter, ...]
    evidence_nats: float
    removed_share: float
    """Share of the excess error that it removes on flight that the fit has not seen."""
    certain: bool
    """Whether no other effect explains the flights about as well."""
    look_alikes: tuple[tuple[str, ...], ...]
    """Effects that the flights cannot tell from it."""
    stands_for: tuple[str, ...]
    """Effects that could not be tried and look the same: without rotor speeds, drag of the rotors is drag of the body."""
    held_out: Mapping[str, Any] | None
    """What it does on flight that the fit has not seen: ``channel`` and ``unit``, error ``without`` and ``with`` it, ``written``."""
    doubt: str | None
    """Why it is not in ``completed``: with it the error on unseen flight rises, or falls by less than flights differ; or the logs
    have no value in common (the wind of two days), and each has its own in ``details["per_log"]``."""
    each_log: bool = False
    """Whether only the values that logs have each for itself are off the file, and what they have in common is not:
    ``evidence_nats`` is that of one log, ``removed_share`` is not known."""


@dataclass(frozen=True)
class Rung:
    """The model with the first effects that were found: one step of the error ladder."""

    label: str
    training: tuple[HorizonError, ...]
    """On the flights of the fit."""
    held_out: tuple[HorizonError, ...]
    """On flight that the fit has not seen."""
    training_lack: Mapping[str, Any] | None
    """Force (``force_n``) and torque (``torque_n_m``) that the model lacks at the instants of the flights of the fit."""
    held_out_lack: Mapping[str, Any] | None
    """The same on flight that the fit has not seen."""


@dataclass(frozen=True)
class ChangedParameter:
    """A parameter before and after a change, SI."""

    name: str
    unit: str
    filed: float
    """Value in the vehicle file, or the effect's default."""
    before: float
    before_sigma: float
    """Standard deviation of ``before``."""
    after: float
    after_sigma: float
    """Standard deviation of ``after``."""


@dataclass(frozen=True)
class Moment:
    """A moment at which an effect of a vehicle or of its air changed."""

    log: str
    at_s: float
    """When, in the time of the log."""
    interval_s: tuple[float, float]
    """Interval that holds it with 95 %."""
    between_logs: bool
    """Whether it changed between this log and the one before."""
    id: str
    title: str
    """In plain words."""
    parameters: tuple[ChangedParameter, ...]
    evidence_nats: float
    look_alikes: tuple[str, ...]
    """Other effects whose change explains the flight about as well."""
    ruled_out: tuple[str, ...]
    """Other effects that were tried as the change and explain the flight clearly worse."""


@dataclass(frozen=True)
class Section:
    """The flight before, between or after moments, diagnosed by itself."""

    logs: tuple[str, ...]
    """The logs, each with its part."""
    headline: str
    """The verdict on it; where it could not be diagnosed, why."""
    verdict: str
    findings: tuple[Finding, ...]
    unexplained: bool
    """Whether something is left there that nothing explains."""
    fitted: bool
    """Whether it was diagnosed."""


@dataclass(frozen=True)
class Diagnosis:
    """Which physics a vehicle's model lacks."""

    vehicle: str
    headline: str
    """The verdict in at most 90 characters."""
    verdict: str
    """One sentence."""
    findings: tuple[Finding, ...]
    """Missing effects, most important first; empty where nothing is missing."""
    unexplained: bool
    """Whether something is missing that is in no list."""
    ladder: tuple[Rung, ...]
    moments: tuple[Moment, ...]
    """Moments at which something changed in mid-flight."""
    sections: tuple[Section, ...]
    """Where something changed, the flight before and after by itself; all else but ``ladder`` is about the last that was diagnosed."""
    next_flight: tuple[str, ...]
    """Manoeuvres to fly next, most wanted first."""
    warnings: tuple[str, ...]
    undetermined: Mapping[str, str]
    """Effects that the flights do not determine, and what to fly for them."""
    text: str = field(repr=False)
    """All of it in words."""
    details: Mapping[str, Any] = field(repr=False)
    """Everything, as ``propwash diagnose --json`` prints it."""
    report: Report = field(repr=False)
    ladder_png: bytes | None = field(repr=False)
    """Picture of the ladder."""
    completed: Vehicle | None
    """The vehicle with what was found and makes it no worse on unseen flight; None where nothing does."""
    nothing_written: str | None
    """Why ``completed`` is None."""

    def to_frame(self) -> pandas.DataFrame:
        """The parameters that were found, one row for each, SI."""
        rows = [{"effect": f.id, **vars(p), "certain": f.certain} for f in self.findings for p in f.parameters]
        return _frame(rows)

    def _repr_html_(self) -> str:
        return self.report._repr_html_()

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class Change:
    """A drift of one effect of a vehicle."""

    id: str
    title: str
    """In plain words."""
    kind: Literal["differs_from_file", "new", "drifted", "goes_on", "returned"]
    since: str
    """The log in which it began."""
    gradual: bool
    """Whether it came little by little, over several logs."""
    parameters: tuple[ChangedParameter, ...]
    evidence_nats: float
    errors_ratio: float | None
    """Errors on unseen flight of the newest log with it over those without it; None where that could not be measured."""
    look_alikes: tuple[str, ...]
    """Effects whose drift explains the logs about as well."""
    doubt: str | None
    """Why it is not accepted; None where it is."""


@dataclass(frozen=True)
class WatchedLog:
    """One log of a folder that is watched."""

    name: str
    sha256: str
    left_out: str | None
    """Why it was not diagnosed; None where it was."""
    headline: str
    """The verdict on this log alone."""
    changes: tuple[Change, ...]
    """Drifts that this log brought to light."""
    doubtful: tuple[Change, ...]
    """Drifts that have the evidence and are in doubt."""
    still: Mapping[str, str]
    """Drifts of earlier logs that hold on: the log since which, by id."""
    details: Mapping[str, Any] = field(repr=False)
    """Everything else, as the JSON of ``propwash watch --json``."""


@dataclass(frozen=True)
class AcceptedParameter:
    """A parameter of a vehicle as all logs so far have it, SI."""

    id: str
    name: str
    unit: str
    filed: float
    value: float
    sigma: float
    """Standard deviation of ``value``."""
    changed: bool
    """Whether a drift of it was accepted."""


@dataclass(frozen=True)
class Watched:
    """A vehicle and its flights, one after the other."""

    vehicle: str
    logs: tuple[WatchedLog, ...]
    """In the order in which they were taken."""
    accepted: tuple[AcceptedParameter, ...]
    completed: Vehicle | None
    """The vehicle with the accepted values; None where they do not lower the errors of the newest flight."""
    text: str = field(repr=False)
    """As the command prints it."""

    @property
    def changes(self) -> tuple[Change, ...]:
        """All drifts that were accepted, in the order in which they were said."""
        return tuple(c for log in self.logs for c in log.changes)

    def to_frame(self) -> pandas.DataFrame:
        """Accepted parameters, one row each, SI."""
        return _frame([vars(p) for p in self.accepted])

    def __str__(self) -> str:
        return self.text


def compare(
    logs: LogLike | Sequence[LogLike],
    vehicle: str | os.PathLike[str] | Vehicle,
    *,
    drive: Drive | None = None,
    ground_z: float | None = None,
    ceiling_z: float | None = None,
    neighbours: Sequence[str] | None = None,
    load: str | None = None,
    noise: Mapping[str, float] | None = None,
    mapping: str | os.PathLike[str] | None = None,
) -> Comparison:
    """Compares a vehicle's model with flights of it.

    Args:
        logs: One flight or several of one vehicle.
        vehicle: Built-in name, path of a vehicle file, or a ``Vehicle``.
        drive: What drives the model: ``"rotor_commands"``, ``"rotor_speeds"``, ``"attitude_commands"`` or ``"thrust"``; the first
            that log and vehicle have where it is None.
        ground_z, ceiling_z: Heights of ground (0 where None) and ceiling (none), m, world.
        neighbours: Tracked objects that are other vehicles; all that are no loads where it is None.
        load: Tracked object that hangs on a cable.
        noise: Standard deviations of one sample that are known better than the logs tell, by channel: ``"position"`` (m),
            ``"attitude"`` (rad), ``"gyro"`` (rad/s), ``"accel"`` (m/s²).
        mapping: TOML file with names, units and frames of the logs; the one beside each log where it is None.

    Raises:
        ValueError: for a log that cannot be right or lacks what is needed; the message says what.
    """
    with _Logs(logs) as paths:
        text, page = _native.gap_compare(
            paths, _vehicle(vehicle), _reading(drive, ground_z, ceiling_z, neighbours, load, noise, mapping)
        )
    of = json.loads(text)
    logs_ = tuple(
        LogComparison(
            **{k: log[k] for k in ("name", "sha256", "duration_s", "drive", "agrees", "verdict", "worst_times_noise")},
            warnings=tuple(log["warnings"]),
            findings=tuple(log["findings"]),
            horizons=_horizons(h["error"] if "error" in h else h for h in log["horizons"]),
            details=log,
        )
        for log in of["logs"]
    )
    return Comparison(of["vehicle"], of["agrees"], of["within_tolerance"], of["verdict"], logs_, Report(page))


def diagnose(
    logs: LogLike | Sequence[LogLike],
    vehicle: str | os.PathLike[str] | Vehicle,
    *,
    held_out: LogLike | Sequence[LogLike] = (),
    hold_out: float = 0.2,
    candidates: Sequence[str] | None = None,
    moments: bool = True,
    network: bool = False,
    drive: Drive | None = None,
    ground_z: float | None = None,
    ceiling_z: float | None = None,
    neighbours: Sequence[str] | None = None,
    load: str | None = None,
    noise: Mapping[str, float] | None = None,
    mapping: str | os.PathLike[str] | None = None,
) -> Diagnosis:
    """Finds which effects of air, mass, drive and sensors a vehicle's model lacks.

    Args:
        logs, vehicle, drive, ground_z, ceiling_z, neighbours, load, noise, mapping: As in ``compare``.
        held_out: Flights that only check the result.
        hold_out: Share of each log, its end, that only checks the result where there is no ``held_out``; 0 to 0.5.
        candidates: Search among these effects only.
        moments: Whether to look for moments at which something changed in mid-flight, and between one log and the next (give them in
            the order in which they were flown); the flight before and after is then diagnosed apart, and ``completed`` is the vehicle
            after the last of them.
        network: Fit a small neural network to what is left, where that makes unseen flight better: ``details["network"]`` says what
            became of it, ``completed`` has it.

    Raises:
        ValueError: for a log that cannot be right or lacks what is needed.
        KeyError: for an unknown candidate.
    """
    reading = _reading(drive, ground_z, ceiling_z, neighbours, load, noise, mapping)
    return _fit(logs, vehicle, held_out, hold_out, reading, candidates, None, False, moments, network)


def watch(
    folder: str | os.PathLike[str],
    vehicle: str | os.PathLike[str] | Vehicle,
    out: str | os.PathLike[str] | None = None,
    *,
    record: str | os.PathLike[str] | None = None,
    order: Literal["time", "name"] = "time",
    force: bool = False,
    hold_out: float = 0.2,
    drive: Drive | None = None,
    ground_z: float | None = None,
    ceiling_z: float | None = None,
    neighbours: Sequence[str] | None = None,
    load: str | None = None,
    noise: Mapping[str, float] | None = None,
    mapping: str | os.PathLike[str] | None = None,
) -> Watched:
    """Diagnoses the logs of a folder, flight after flight, and says what has drifted of the vehicle, as ``propwash watch --once``.

    Args:
        folder: Folder with flight logs (.csv, .parquet, .ulg, .mcap), sub-folders included.
        vehicle, drive, ground_z, ceiling_z, neighbours, load, noise, mapping: As in ``compare``.
        out: Vehicle file to write with the accepted values; none is written where it is None, or where they do not lower the errors
            of the newest flight (a warning says so).
        record: File in which what is known of each log is kept: a later call goes on from it and diagnoses no log again.
        order: By the time at which files were last changed, or by name.
        force: Replace the file ``out``.
        hold_out: Share of each log, its end, on which drifts are judged and that no fit sees; 0 to 0.5.

    Logs that cannot be used are left out, and say why.

    Raises:
        ValueError: where ``folder`` is none, and for a record of another vehicle or other settings.
        FileExistsError: where ``out`` exists, without ``force``.
    """
    if order not in ("time", "name"):
        raise ValueError(f"order: expected 'time' or 'name', got {order!r}")
    if not 0.0 <= hold_out <= 0.5:
        raise ValueError(f"hold_out: expected a share from 0 to 0.5, got {hold_out}")
    may_write(out, force)
    text, words, changed = _native.gap_watch(
        folder,
        _vehicle(vehicle),
        _reading(drive, ground_z, ceiling_z, neighbours, load, noise, mapping),
        hold_out,
        order == "name",
        record,
    )
    of = json.loads(text)
    made = Watched(
        of["vehicle"],
        tuple(_watched(log) for log in of["logs"]),
        tuple(AcceptedParameter(**p) for p in of["accepted"]),
        None if changed is None else Vehicle.from_toml(changed, of["vehicle"]),
        words,
    )
    if out is not None and changed is None:
        warnings.warn("no vehicle is written: the accepted values do not lower the errors of the newest flight", stacklevel=2)
    elif changed is not None:
        _write_vehicle(out, changed, force)
    return made


def _watched(log: Mapping[str, Any]) -> WatchedLog:
    def change(c: Mapping[str, Any]) -> Change:
        names = ("id", "title", "kind", "since", "evidence_nats", "errors_ratio", "doubt")
        return Change(
            **{k: c[k] for k in names},
            gradual=c["until"] > c["from"],
            parameters=tuple(_changed(p) for p in c["parameters"]),
            look_alikes=tuple(c["look_alikes"]),
        )

    return WatchedLog(
        **{k: log[k] for k in ("name", "sha256", "left_out", "headline")},
        changes=tuple(change(c) for c in log["changes"]),
        doubtful=tuple(change(c) for c in log["doubtful"]),
        still=dict(log["still"]),
        details=log,
    )


def add(
    effects: str | Sequence[str],
    logs: LogLike | Sequence[LogLike],
    vehicle: str | os.PathLike[str] | Vehicle,
    out: str | os.PathLike[str] | None = None,
    *,
    force: bool = False,
    calibrate: bool = False,
    network: bool = False,
    held_out: LogLike | Sequence[LogLike] = (),
    hold_out: float = 0.2,
    drive: Drive | None = None,
    ground_z: float | None = None,
    ceiling_z: float | None = None,
    neighbours: Sequence[str] | None = None,
    load: str | None = None,
    noise: Mapping[str, float] | None = None,
    mapping: str | os.PathLike[str] | None = None,
) -> Diagnosis:
    """Fits effects to flights and adds them to a vehicle: ``completed`` of what is returned, with values, standard deviations,
    the logs' SHA-256 and the date.

    Args:
        effects: Names as ``diagnose`` gives them: ``"rotor_drag"``, ``"weak_rotor.2"``.
        logs, vehicle, held_out, hold_out, drive, ground_z, ceiling_z, neighbours, load, noise, mapping: As in ``diagnose``.
        out: Vehicle file to write; none is written where it is None.
        force: Replace the file ``out``, and take effects that the flights do not determine.
        calibrate: Also set parameters within their tolerance to their estimates: those of the groups that lower the error on
            flight that the fit has not seen.
        network: Also fit a small neural network to what is left beside the effects, which may then be none; its file goes beside
            ``out``.

    Nothing is written that raises the error on flight that the fit has not seen, or, unless it is asked for by name, takes less than
    5 % off: such effects have a ``doubt`` and are not in ``completed``, which is None where nothing is left; then there is no file either, with a warning that says why.

    Raises:
        ValueError: also for effects that the flights do not determine, with what to fly.
        FileExistsError: where ``out`` exists, without ``force``.
    """
    names = [effects] if isinstance(effects, str) else list(effects)
    if not names and not network:
        raise ValueError("effects: expected at least one name, such as 'rotor_drag', got none")
    may_write(out, force)
    reading = _reading(drive, ground_z, ceiling_z, neighbours, load, noise, mapping)
    made = _fit(logs, vehicle, held_out, hold_out, reading, None, names, calibrate, False, network)
    if made.undetermined and not force:
        why = "; ".join(f"{name}: {what}" for name, what in made.undetermined.items())
        raise ValueError(f"the flights do not show {why}; or force=True to take the values all the same")
    if out is not None and made.completed is not None:
        _write_vehicle(out, made.completed.text, force)
    elif out is not None:
        warnings.warn(f"{os.fspath(out)} is not written: {made.nothing_written}", stacklevel=2)
    return made


def _write_vehicle(out: str | os.PathLike[str] | None, text: str, force: bool) -> None:
    """Writes a vehicle file, where ``out`` is one, and before it the networks that it names beside itself."""
    if out is None:
        return
    may_write(out, force)
    for name, content in _native.network_files(text):
        beside = Path(out).with_name(name)
        if not (beside.is_file() and beside.read_bytes() == content.encode("utf-8")):
            write(beside, content, force)
    write(out, text, force)


def _fit(
    logs: Any,
    vehicle: Any,
    held_out: Any,
    hold_out: float,
    reading: dict[str, Any],
    only: Sequence[str] | None,
    given: list[str] | None,
    calibrate: bool,
    moments: bool,
    network: bool,
) -> Diagnosis:
    if not 0.0 <= hold_out <= 0.5:
        raise ValueError(f"hold_out: expected a share from 0 to 0.5, got {hold_out}")
    of_vehicle = _vehicle(vehicle)
    with _Logs(logs) as paths, _Logs(held_out) as unseen:
        both = [p for p in unseen if p in paths]
        if both:
            raise ValueError(f"held_out: expected flights that the fit does not see, got {both[0]}, which is one of the logs")
        text, words, page, picture, changed, undetermined, nothing = _native.gap_diagnose(
            paths,
            unseen,
            float(hold_out),
            of_vehicle,
            reading,
            None if only is None else list(only),
            given,
            calibrate,
            moments,
            network,
        )
    of = json.loads(text)
    next_flight: list[str] = []
    for name in (m for a in of["advice"] for m in a["manoeuvres"]):
        if name not in next_flight:
            next_flight.append(name)
    return Diagnosis(
        vehicle=of["vehicle"],
        headline=of["headline"],
        verdict=of["verdict"],
        findings=tuple(_finding(f) for f in of["findings"]),
        unexplained=of["remainder"]["unexplained"],
        ladder=tuple(
            Rung(r["label"], _horizons(r["training"]), _horizons(r["held_out"]), r["training_lack"], r["held_out_lack"])
            for r in of["ladder"]
        ),
        moments=tuple(
            Moment(
                **{k: m[k] for k in ("log", "at_s", "between_logs", "id", "title", "evidence_nats")},
                interval_s=(m["interval_s"][0], m["interval_s"][1]),
                parameters=tuple(_changed(p) for p in m["parameters"]),
                look_alikes=tuple(m["look_alikes"]),
                ruled_out=tuple(m["ruled_out"]),
            )
            for m in of["moments"]
        ),
        sections=tuple(
            Section(
                tuple(s["logs"]),
                s["headline"],
                s["verdict"],
                tuple(_finding(f) for f in s["findings"]),
                s["unexplained"],
                s["fitted"],
            )
            for s in of["sections"]
        ),
        next_flight=tuple(next_flight),
        warnings=tuple(of["warnings"]),
        undetermined=dict(undetermined),
        text=words,
        details=of,
        report=Report(page),
        ladder_png=picture,
        completed=None if changed is None else Vehicle.from_toml(changed, of_vehicle.name),
        nothing_written=nothing,
    )


def _finding(f: Mapping[str, Any]) -> Finding:
    return Finding(
        **{k: f[k] for k in ("id", "kind", "title", "evidence_nats", "removed_share", "certain", "each_log")},
        parameters=tuple(Parameter(**p) for p in f["parameters"]),
        look_alikes=tuple(tuple(a["ids"]) for a in f["look_alikes"]),
        stands_for=tuple(f["stands_for"]),
        held_out=f["held_out"],
        doubt=f["held_out"]["doubt"] if f["held_out"] else None,
    )


def _changed(p: Mapping[str, Any]) -> ChangedParameter:
    keys = ("name", "unit", "filed", "before", "before_sigma", "after", "after_sigma")
    return ChangedParameter(**{k: p[k] for k in keys})


def _horizons(rows: Iterable[Mapping[str, Any]]) -> tuple[HorizonError, ...]:
    return tuple(HorizonError(**{"attitude_rad": None, "rate_rad_s": None, **row}) for row in rows)


def _frame(rows: list[dict[str, Any]]) -> pandas.DataFrame:
    try:
        library = import_module("pandas")
    except ImportError:
        raise ImportError("tables need pandas: run `pip install pandas`") from None
    return library.DataFrame(rows)


def _vehicle(value: str | os.PathLike[str] | Vehicle) -> Vehicle:
    return value if isinstance(value, Vehicle) else Vehicle(value)


def _reading(
    drive: Drive | None,
    ground_z: float | None,
    ceiling_z: float | None,
    neighbours: Sequence[str] | None,
    load: str | None,
    noise: Mapping[str, float] | None,
    mapping: str | os.PathLike[str] | None,
) -> dict[str, Any]:
    heights = {"ground_z": ground_z, "ceiling_z": ceiling_z}
    for name, z in heights.items():
        if z is not None and not np.isfinite(z):
            raise ValueError(f"{name}: expected a finite height in metres, got {z}")
    return {
        "drive": drive,
        **heights,
        "neighbours": None if neighbours is None else list(neighbours),
        "load": load,
        "noise": {} if noise is None else {name: float(value) for name, value in noise.items()},
        "mapping": mapping,
    }


class _Paths(list[str]):
    """Paths of flights, some of them in a folder that nobody knows and that is gone soon."""

    folder = ""

    def named(self, *of: Any) -> Any:
        """The same with the names of files alone in place of those in the folder."""
        return tuple(one.replace(self.folder, "") if isinstance(one, str) and self.folder else one for one in of)


class _Logs:
    """Paths of flights; tables are written to files for as long as they are needed."""

    def __init__(self, logs: Any) -> None:
        self._logs = list(logs) if isinstance(logs, (list, tuple)) else [logs]
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._paths = _Paths()

    def __enter__(self) -> _Paths:
        paths = self._paths
        paths.extend(self._path(k, log) for k, log in enumerate(self._logs))
        if self._folder is not None:
            paths.folder = self._folder.name + os.sep
        twice = [p for k, p in enumerate(paths) if p in paths[:k]]
        if twice:
            self.__exit__()
            raise ValueError(f"logs: expected each log once, got {twice[0]} twice")
        return paths

    def __exit__(self, kind: object = None, error: BaseException | None = None, *_: object) -> None:
        if self._folder is not None:
            self._folder.cleanup()
        if isinstance(error, Exception):
            error.args = self._paths.named(*error.args)

    def _path(self, number: int, log: Any) -> str:
        if isinstance(log, (str, os.PathLike)):
            return os.fsdecode(log)
        if hasattr(log, "to_csv") and hasattr(log, "columns"):
            columns = {str(name): log[name].to_numpy() for name in log.columns}
        elif isinstance(log, Mapping):
            columns = {str(name): np.asarray(values) for name, values in log.items()}
        else:
            raise TypeError(f"logs: expected a path, a pandas table or arrays by name, got {type(log).__name__}")
        lengths = {name: len(values) for name, values in columns.items()}
        if len(set(lengths.values())) != 1:
            raise ValueError(f"logs: expected columns of one length, got {lengths}")
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="propwash-")
        path = Path(self._folder.name) / f"log_{number}.csv"
        with path.open("w", encoding="utf-8") as f:
            f.write(",".join(columns) + "\n")
            for row in zip(*columns.values()):
                # An empty cell is "not measured"; repr() gives every bit back.
                f.write(",".join("" if v is None or v != v else repr(float(v)) for v in row) + "\n")
        return str(path)
