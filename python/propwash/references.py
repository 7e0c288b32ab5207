"""Paths to be followed: what a state controller is told."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .command import Command

Floats = NDArray[np.float64]


class MinimumSnap:
    """The smoothest path through points at given times: the one whose fourth derivative (snap) has the least square over time, at rest at both ends
    (Mellinger and Kumar, "Minimum snap trajectory generation and control for quadrotors", 2011). Between two points each axis is a polynomial of degree 7; all
    derivatives up to the sixth are continuous, which is what makes it the smoothest.

    >>> path = propwash.MinimumSnap([[0, 0, 1], [1, 0.5, 1.2], [2, 0, 1]], times=[0.0, 1.5, 3.0])
    >>> sim.state_control(path.command(t)[None, None])
    """

    def __init__(self, points: ArrayLike, times: ArrayLike) -> None:
        """
        Args:
            points: Where to be, m, world; at least two. (n, 3)
            times: When, s, rising. (n,)

        Raises:
            ValueError: for other shapes, numbers that are not finite, and times that do not rise.
        """
        where, when = np.array(points, np.float64), np.array(times, np.float64)
        if where.ndim != 2 or where.shape[1] != 3 or len(where) < 2:
            raise ValueError(f"points: expected shape (n, 3) with at least two points, got {where.shape}")
        if when.shape != (len(where),):
            raise ValueError(f"times: expected shape ({len(where)},), one for each point, got {when.shape}")
        if not (np.isfinite(where).all() and np.isfinite(when).all()):
            raise ValueError("points, times: expected finite numbers, got some that are not")
        if not (np.diff(when) > 0).all():
            raise ValueError(f"times: expected rising numbers, got {when.tolist()}")
        self.points: Floats = where
        """The points, m. (n, 3)"""
        self.times: Floats = when
        """Their times, s. (n,)"""
        self._coefficients = _solve(where, np.diff(when))

    def __repr__(self) -> str:
        return f"<propwash.MinimumSnap through {len(self.points)} points in {self.times[-1] - self.times[0]:g} s>"

    def at(self, time: ArrayLike, derivative: int = 0) -> Floats:
        """Where the path is, or a derivative of it by time, m/sᵏ. Before and behind it rests at its ends.

        Args:
            time: s. (...)
            derivative: 0 for the position, 1 for the velocity, …, at most 6.

        Returns:
            (..., 3)
        """
        if type(derivative) is not int or not 0 <= derivative <= 6:
            raise ValueError(f"derivative: expected a whole number from 0 to 6, got {derivative!r}")
        t = np.clip(np.asarray(time, np.float64), self.times[0], self.times[-1])
        segment = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        length = np.diff(self.times)[segment]
        share = (t - self.times[segment]) / length
        rows = _powers(share, derivative) / length[..., None] ** derivative
        out: Floats = np.einsum("...k,...kx->...x", rows, self._coefficients[segment])
        outside = (np.asarray(time) < self.times[0]) | (np.asarray(time) > self.times[-1])
        if derivative:
            out = np.where(outside[..., None], 0.0, out)
        return out

    def command(self, time: ArrayLike, yaw: ArrayLike = 0.0) -> Floats:
        """State commands to be where the path is, with its velocity and acceleration. (..., 16)"""
        return Command.state(self.at(time), self.at(time, 1), self.at(time, 2), yaw)


def _powers(share: Any, derivative: int) -> Floats:
    """The derivative of 1, s, …, s⁷ by s. (..., 8)"""
    s = np.asarray(share, np.float64)[..., None]
    k = np.arange(8)
    factor = np.ones(8)
    for d in range(derivative):
        factor = factor * (k - d)
    return np.asarray(np.where(k >= derivative, factor * s ** np.maximum(k - derivative, 0), 0.0))


def _solve(points: Floats, lengths: Floats) -> Floats:
    """Coefficients of each segment by share of its time. (segments, 8, 3)"""
    m = len(lengths)
    rows, values = [], []

    def row(terms: list[tuple[int, float, int, float]], value: Any) -> None:
        """Σ sign · (derivative of a segment at a share of its time) = value, in terms of real time."""
        out = np.zeros((m, 8))
        for segment, share, derivative, sign in terms:
            out[segment] += sign * _powers(share, derivative) / lengths[segment] ** derivative
        # Of like size whatever the times.
        size = np.abs(out).max()
        rows.append(out.ravel() / size)
        values.append(np.asarray(value, np.float64) / size)

    for i in range(m):
        row([(i, 0.0, 0, 1.0)], points[i])
        row([(i, 1.0, 0, 1.0)], points[i + 1])
    for derivative in (1, 2, 3):
        row([(0, 0.0, derivative, 1.0)], np.zeros(3))
        row([(m - 1, 1.0, derivative, 1.0)], np.zeros(3))
    for i in range(m - 1):
        for derivative in range(1, 7):
            row([(i, 1.0, derivative, 1.0), (i + 1, 0.0, derivative, -1.0)], np.zeros(3))
    return np.linalg.solve(np.array(rows), np.array(values)).reshape(m, 8, 3)
