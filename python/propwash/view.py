"""Scenes, data sets, flight logs and simulations in three dimensions, as pages that need no other file and no network."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Sequence, Union

from . import _native
from .gap import Report

if TYPE_CHECKING:
    from .datasets import DataSet
    from .sim import Sim

ViewLike = Union["Sim", "DataSet", str, "os.PathLike[str]"]
"""What a ``View`` shows: a ``Sim`` as it is now, a data set, or a path as ``propwash view`` takes it."""

_MOST_WORLDS = 16


class View:
    """One page with a scene and what flies in it, in three dimensions; a notebook shows it.

    Args:
        what: A ``Sim`` (its drones where they are now), a data set or its folder, a scene (a file or a name), or a flight log
            (.csv, .parquet, .ulg, .mcap, or the folder of a ROS 2 bag).
        worlds: Worlds of a ``Sim`` (default: the first 16) or of a data set (default: as many as fit into 1.5 MB). Those of a ``Sim`` that
            are in another scene than the first are left out.
        scene: Scene that a flight log was flown in.
        vehicle: Vehicle of a flight log, a name or a file: its model flies beside, and starts again from the measurement.

    Raises:
        ValueError: for what cannot be shown, or an option that this kind has no use for.
        OSError: for a file that cannot be read.
        IndexError: for a world that a ``Sim`` does not have.
    """

    def __init__(
        self,
        what: ViewLike,
        *,
        worlds: Sequence[int] | None = None,
        scene: str | os.PathLike[str] | None = None,
        vehicle: str | os.PathLike[str] | None = None,
    ) -> None:
        native = getattr(what, "_native", None)
        if isinstance(native, _native.Sim):
            if scene is not None or vehicle is not None:
                raise ValueError("scene and vehicle are for flight logs: a Sim has its own")
            asked = range(min(native.n_worlds, _MOST_WORLDS)) if worlds is None else worlds
            html, notes = native.view_page([int(w) for w in asked])
        else:
            path = os.fspath(getattr(what, "path", what))  # type: ignore[arg-type]
            vehicle = None if vehicle is None else os.fspath(vehicle)
            html, notes = _native.view_page(path, [int(w) for w in worlds or ()], scene, vehicle)
        self.notes: tuple[str, ...] = tuple(notes)
        """What the page leaves out or thins."""
        self._page = Report(html)

    @property
    def html(self) -> str:
        """The page."""
        return self._page.html

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the page; a file that is there is replaced when the new one is whole."""
        self._page.save(path)

    def show(self, height: int = 800) -> Any:
        """Shows the page in a notebook; elsewhere in a browser. ``height`` in pixels."""
        return self._page.show(height)

    def _repr_html_(self) -> str:
        return self._page._repr_html_()

    def __repr__(self) -> str:
        return f"<View, {len(self.html) / 1e6:.1f} MB>"
