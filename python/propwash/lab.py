"""A session with flights: see what a model lacks, search, switch effects on and off, set their values, fit, undo, save."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Callable, Literal, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._native import Vehicle
from ._write import may_write, write
from .gap import Drive, Report, _reading, _vehicle

Progress = Callable[[int, int], object]


@dataclass(frozen=True)
class LabParameter:
    """A parameter of an effect, SI."""

    name: str
    unit: str
    filed: float
    """Value of the vehicle file."""
    value: float
    """Present value: that of the file while the effect is off."""
    estimate: float
    """Estimate beside the effects that are on."""
    sigma: float | None
    """Standard deviation of the estimate."""
    interval: tuple[float, float] | None
    """95 % interval."""
    by_hand: bool


@dataclass(frozen=True)
class LabEffect:
    """An effect that can be turned on."""

    id: str
    title: str
    role: str
    """``found``, ``correction``, ``look_alike`` or ``candidate``."""
    on: bool
    parameters: tuple[LabParameter, ...]
    evidence_nats: float | None
    """Evidence that is lost without it if it is on, or gained with it if it is off; None before a search."""
    certain: bool
    """Whether the search names it for certain."""
    look_alikes: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class LabFigures:
    """Force and torque that the model lacks on the judged flight: root mean squares of means over 50 ms."""

    force_n: float
    force_times_noise: float
    torque_n_m: float | None
    torque_times_noise: float | None
    exact: bool
    """Whether they come from the model itself; otherwise they are forecast."""


@dataclass(frozen=True)
class LabResidual:
    """What the model lacks along one flight, at the present values."""

    log: str
    t_s: NDArray[np.float64]
    """Times, s, shape (sample,)."""
    force_n: NDArray[np.float64]
    """N, body, shape (sample, 3); NaN where unknown."""
    torque_n_m: NDArray[np.float64]
    """N·m, body, shape (sample, 3); shape (0, 3) where the drive carries no torques."""


@dataclass(frozen=True)
class LabSaved:
    """What a session saves."""

    vehicle: Vehicle
    text: str = field(repr=False)
    """The vehicle file."""
    diff: tuple[tuple[str, str], ...] = field(repr=False)
    """Its lines beside those of the file before: (``kept``, ``added`` or ``removed``, line)."""
    steps: str = field(repr=False)
    """Commands of a shell that make the same file, but for its date."""
    report: Report | None = field(repr=False)
    remarks: tuple[str, ...]


class Lab:
    """A session with flights of one vehicle: the engine of ``propwash lab``.

    Args:
        logs: Paths of flights (.csv, .parquet, .ulg, .mcap, or the folder of a ROS 2 bag).
        vehicle: Built-in name, vehicle file or ``Vehicle``.
        check: Those of the logs that only check what is fitted to the others; without any, the last fifth of each log does.
        drive, ground_z, ceiling_z, neighbours, load, noise, mapping: As in ``diagnose``.

    Nothing is accepted by itself: ``find`` turns nothing on. Every change is a step that ``undo`` takes back.

    Raises:
        ValueError: for logs that cannot be right, or not of this vehicle.
    """

    def __init__(
        self,
        logs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
        vehicle: str | os.PathLike[str] | Vehicle,
        *,
        check: Sequence[str | os.PathLike[str]] = (),
        drive: Drive | None = None,
        ground_z: float | None = None,
        ceiling_z: float | None = None,
        neighbours: Sequence[str] | None = None,
        load: str | None = None,
        noise: Mapping[str, float] | None = None,
        mapping: str | os.PathLike[str] | None = None,
    ) -> None:
        fit = [logs] if isinstance(logs, (str, os.PathLike)) else list(logs)
        names = [os.fsdecode(p) for p in [*fit, *(p for p in check if p not in fit)]]
        checked = {os.fsdecode(p) for p in check}
        reading = _reading(drive, ground_z, ceiling_z, neighbours, load, noise, mapping)
        of = _vehicle(vehicle)
        label = of.name if isinstance(vehicle, Vehicle) else os.fsdecode(vehicle)
        self._vehicle = of
        self._flags = _flags(reading)
        self._names = names
        self._native = _native.LabSession(label, names, [n in checked for n in names], of, reading)

    @property
    def state(self) -> dict[str, Any]:
        """Everything but arrays, as plain data: headline, flights, effects, figures, history, warnings."""
        return json.loads(self._native.state())  # type: ignore[no-any-return]

    @property
    def headline(self) -> str:
        """One sentence: the verdict of the search, or what is missing before it."""
        return str(self.state["headline"])

    @property
    def effects(self) -> tuple[LabEffect, ...]:
        """What can be turned on; any other candidate can be, too, by its id."""
        return tuple(_effect(e) for e in self.state["effects"])

    def effect(self, name: str) -> LabEffect:
        """An effect by its id."""
        known = self.effects
        for effect in known:
            if effect.id == name:
                return effect
        raise KeyError(f"{name!r} is not offered; there are {', '.join(e.id for e in known)}")

    @property
    def figures(self) -> LabFigures:
        """What the model lacks at the present values."""
        of = self.state["figures"]
        return _figures(of["now"], of["exact"])

    @property
    def figures_before(self) -> LabFigures:
        """What the model of the vehicle file lacks."""
        return _figures(self.state["figures"]["before"], True)

    def find(self, progress: Progress | None = None) -> tuple[LabEffect, ...]:
        """Searches for what is missing, and gives what was found. ``progress(done, total)``; what it raises, or Ctrl-C, ends the
        search, and the session is as it was."""
        self._native.find(progress)
        return tuple(e for e in self.effects if e.role == "found")

    def fit(self, progress: Progress | None = None) -> LabFigures:
        """Fits the effects that are on, from the last linearisation; values set by hand are freed."""
        self._native.fit(progress)
        return self.figures

    def toggle(self, effect: str, on: bool = True) -> LabFigures:
        """Turns an effect on or off; everything that is on is then at its estimate."""
        self._native.toggle(effect, bool(on))
        return self.figures

    def set(self, effect: str, value: float, parameter: str | None = None) -> LabFigures:
        """Sets a parameter by hand, SI, which turns its effect on. ``parameter`` may be left out where the effect has one only, and
        for a group of small corrections, whose value is the share of the way to their estimates."""
        if parameter is None:
            known = [e for e in self.effects if e.id == effect]
            names = [p.name for p in known[0].parameters] if known else []
            if len(names) > 1:
                raise ValueError(f"parameter: expected one of {', '.join(names)} of {effect}, got None")
            parameter = names[0] if names else ""
        self._native.set(effect, parameter, float(value))
        return self.figures

    def residual(self, window: tuple[float, float] | None = None) -> tuple[LabResidual, ...]:
        """Force and torque that the model lacks at the present values, by the model itself, along each flight."""
        return self.exact(window)[1]

    def exact(self, window: tuple[float, float] | None = None) -> tuple[LabFigures, tuple[LabResidual, ...]]:
        """Figures by the model itself, within a window of the logs' times (s) where one is given, and the residuals."""
        figures, flights = self._native.exact(None if window is None else (float(window[0]), float(window[1])))
        return _figures(json.loads(figures)["now"], True), tuple(LabResidual(*f) for f in flights)

    def expression(self, axis: str, text: str) -> str:
        """Adds an effect of your own as a candidate, with ``k`` as its coefficient (docs/effects/expression.md), and gives its name.

        Args:
            axis: ``force_body_x`` …, ``force_world_x`` …, ``torque_x`` ….
            text: Such as ``-k * vx_body * abs(vx_body)``.

        Raises:
            ValueError: with the column of what is wrong.
        """
        return self._native.expression(axis, text)

    def set_use(self, flight: int | str, use: Literal["fit", "check"]) -> None:
        """Says what a log is for. Nothing is fitted again by itself."""
        if use not in ("fit", "check"):
            raise ValueError(f"use: expected 'fit' or 'check', got {use!r}")
        number = self._names.index(flight) if isinstance(flight, str) else int(flight)
        self._native.set_use(number, use == "check")

    def undo(self) -> bool:
        """Takes the last step back; whether there was one."""
        return self._native.undo()

    def redo(self) -> bool:
        """Does the step that was taken back again; whether there was one."""
        return self._native.redo()

    def go(self, step: int) -> None:
        """Goes to a step of ``state["history"]``, by its number."""
        self._native.go(step)

    def save(
        self, out: str | os.PathLike[str] | None = None, *, force: bool = False, report: bool = False, steps: bool = False
    ) -> LabSaved:
        """The vehicle with what is on; written to ``out`` where it is given, beside it the commands (``out`` with ``.sh``) with
        ``steps``. ``report`` makes the page as well, which takes some seconds.

        Raises:
            FileExistsError: where a file exists, without ``force``.
        """
        shell = None if out is None or not steps else Path(out).with_suffix(".sh")
        for path in (out, shell):
            may_write(path, force)
        name = "better.toml" if out is None else os.fsdecode(out)
        text, diff, page, commands, remarks = self._native.save(name, self._flags, report)
        if out is not None:
            write(out, text, force)
        if shell is not None:
            write(shell, commands, force)
        return LabSaved(
            vehicle=Vehicle.from_toml(text, self._vehicle.name),
            text=text,
            diff=tuple(diff),
            steps=commands,
            report=None if page is None else Report(page),
            remarks=tuple(remarks),
        )


def _flags(reading: Mapping[str, Any]) -> list[str]:
    """What reading the logs takes on the command line."""
    out: list[str] = []
    if reading["drive"] is not None:
        out += ["--drive", str(reading["drive"]).replace("_", "-")]
    for name in ("ground_z", "ceiling_z", "load", "mapping"):
        if reading[name] is not None:
            out += ["--" + name.replace("_", "-"), os.fsdecode(reading[name]) if name == "mapping" else str(reading[name])]
    for name in reading["neighbours"] or ():
        out += ["--neighbour", name]
    for channel, value in reading["noise"].items():
        out += ["--noise", f"{channel}={value!r}"]
    return out


def _figures(of: Mapping[str, Any], exact: bool) -> LabFigures:
    names = ("force_n", "force_times_noise", "torque_n_m", "torque_times_noise")
    return LabFigures(**{name: of[name] for name in names}, exact=exact)


def _effect(of: Mapping[str, Any]) -> LabEffect:
    parameters = [{**p, "interval": None if p["interval"] is None else tuple(p["interval"])} for p in of["parameters"]]
    return LabEffect(
        **{name: of[name] for name in ("id", "title", "role", "on", "evidence_nats", "certain")},
        parameters=tuple(LabParameter(**p) for p in parameters),
        look_alikes=tuple(tuple(a["ids"]) for a in of["look_alikes"]),
    )
