"""Data sets of what a program of the user's flies."""

from __future__ import annotations

import dataclasses
import json
import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from numpy.typing import ArrayLike

from . import _native
from .sense import Camera, _float, _whole
from .sim import Sim, _plain


class Recorder:
    """Writes what a ``Sim`` flies under your commands into a data set, as ``propwash fly`` does (docs/formats.md)::

        recorder = propwash.Recorder("out/flown", sim, seconds=2.0, episodes=10, camera=propwash.Camera("fpv"))
        for episode in recorder:                 # resets the Sim, and begins to record
            while recorder.flying:
                sim.attitude_control(policy(sim.data))
                recorder.step(10)                # records and flies ten steps

    The data set has ``episodes`` times the worlds of the ``Sim``. It holds states, commands, contacts, clearances, depth by the camera, and
    what the sensors of the ``Sim`` read. It is sealed when the loop has ended. When the program is run again on a folder that it has not
    finished, episodes whose worlds are all there are skipped.

    Args:
        out: Folder of the data set.
        sim: The simulation; all its worlds are in one scene, or in none, where drones neither see nor touch.
        seconds: Length of a flight.
        episodes: How often its worlds are flown.
        fps: Depth frames per second.
        log_freq: Rows of states, contacts and clearances per second; divides the steps of the simulation.
        camera: The camera that every drone carries, or the name of one of the shell; None: that of the configuration of the ``Sim``.
            A camera without limits of its range gets those of ``propwash fly``, 0.01 m and 20 m: images hold millimetres in 16 bits.
        noise: Noise of this camera, a dict (docs/formats.md).
        normals: Store surface normals too.
        max_distance: Largest clearance that is looked for, m.
        on_reset: Called with the number of the episode before each reset: the place for ``sim.set_initial`` and for moving obstacles.

    Raises:
        ValueError: for arguments that make no sense.
        propwash.datasets.DataSetError, propwash.Error: for a folder with another data set, or one that is being written.
    """

    def __init__(
        self,
        out: str | os.PathLike[str],
        sim: Sim,
        *,
        seconds: float = 4.0,
        episodes: int = 1,
        fps: int = 20,
        log_freq: int = 100,
        camera: Camera | str | None = None,
        noise: Mapping[str, Any] | None = None,
        normals: bool = False,
        max_distance: float = 5.0,
        on_reset: Callable[[int], None] | None = None,
    ) -> None:
        if not isinstance(sim, Sim):
            raise TypeError(f"sim: expected a propwash.Sim, got {type(sim).__name__}")
        self.sim = sim
        self.episodes = _whole("episodes", episodes, 1, 10_000_000)
        self._on_reset = on_reset
        cameras = None
        if camera is not None:
            seen = Camera(camera) if isinstance(camera, str) else camera
            if tuple(seen.range) == (0.0, float("inf")):
                seen = dataclasses.replace(seen, range=(0.01, 20.0))
            cameras = sim._native.cameras(seen._spec(normals), 0)
        elif noise is not None:
            raise ValueError("noise: expected a camera beside it, to which it belongs")
        self._native = _native.Recorder(
            os.fspath(out),
            sim._native,
            _float("seconds", seconds),
            self.episodes,
            _whole("fps", fps, 1, 1_000_000),
            _whole("log_freq", log_freq, 1, 1_000_000),
            bool(normals),
            _float("max_distance", max_distance),
            cameras,
            None if noise is None else json.dumps(_plain("noise", noise)),
        )
        for text in self._native.warnings():
            warnings.warn(text, stacklevel=2)
        self.n_steps: int = self._native.n_steps
        """Steps of a flight."""
        self.summary: dict[str, int] | None = None
        """After the last episode: ``worlds``, ``quarantined`` of them, and ``images``."""

    @property
    def flying(self) -> bool:
        """Whether a flight is being recorded."""
        return self._native.flying

    def __iter__(self) -> Iterator[int]:
        """Numbers of the episodes that are not there yet. Each begins with a reset of the ``Sim``."""
        for episode in range(self.episodes):
            if self._on_reset is not None:
                self._on_reset(episode)
            self.sim.reset()
            if self._native.begin():
                yield episode
                if self._native.flying:
                    self._native.end([True] * self.sim.n_worlds)
        names = ("worlds", "quarantined", "images")
        self.summary = dict(zip(names, self._native.finish()))

    def step(self, n_steps: int = 1) -> bool:
        """Records and flies up to ``n_steps``, under the commands that are set; no more than are left. False: the flight is over.

        Raises:
            ValueError: without a flight, or where the ``Sim`` was stepped otherwise meanwhile.
        """
        n_steps = _whole("n_steps", n_steps, 1, 2**62)
        pipeline, data = self.sim.pipeline, self.sim.data
        pipeline._call(pipeline._before, data)
        goes_on = self._native.step(n_steps, data)
        pipeline._call(pipeline._after, data)
        return goes_on

    def end(self, mask: ArrayLike) -> None:
        """Ends the flight of worlds, (n_worlds,), before its time: their rows end here. The other worlds go on."""
        self._native.end(mask)
