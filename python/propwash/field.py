"""Distances to everything that stands still in a scene, at the points of a grid and between them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._repr import shorten_all as _shorten_all

Floats = NDArray[np.float64]


class DistanceField:
    """Signed distance to the nearest thing that stands still in a scene and can collide, on a regular grid: negative inside, m.

    ``Sim.distance_field`` bakes one of a scene; made of an array it is a field of your own.

    Between the points of the grid the value is their trilinear interpolation, which is at most 0.87 cells off, and exact near flat surfaces that no edge is near
    to. Outside of the grid it is √(d² + g²) with the distance d at the nearest point of its border and the distance g to there (d + g where d < 0): never more than the distance to
    what lies within the grid, and never less than 0.7 of it. Endless planes are known everywhere; what else lies outside is not known.
    """

    def __init__(
        self,
        data: ArrayLike,
        origin: Sequence[float],
        resolution: float,
        *,
        planes: ArrayLike | None = None,
        zero_inside: Sequence[int] = (),
    ) -> None:
        """A field from distances.

        Args:
            data: Distances at the points, m. (nx, ny, nz)
            origin: The point of ``data[0, 0, 0]``, m, world. (3,)
            resolution: Distance of neighbouring points along each axis, m.
            planes: Endless planes: upward unit normal n and offset of each, n · p − offset being the distance of p. (n, 4)
            zero_inside: Numbers of geoms inside of which the distance is 0.

        Raises:
            ValueError: for arrays of other shapes, numbers that are not finite, and fewer than two points along an axis.
        """
        numbers = np.ascontiguousarray(data, np.float32)
        rows = np.zeros((0, 4)) if planes is None else np.asarray(planes, np.float64)
        if rows.ndim != 2 or rows.shape[1] != 4:
            raise ValueError(f"planes: expected an array (n, 4), got the shape {rows.shape}")
        first = np.asarray(origin, np.float64)
        if first.shape != (3,):
            raise ValueError(f"origin: expected three numbers, got the shape {first.shape}")
        self._native = _native.Field(numbers, first.tolist(), float(resolution), rows.tolist(), [int(i) for i in zero_inside])

    @classmethod
    def _of(cls, native: _native.Field) -> DistanceField:
        made = cls.__new__(cls)
        made._native = native
        return made

    def __repr__(self) -> str:
        low, high = self.bounds
        return f"<propwash.DistanceField of {' x '.join(str(n) for n in self.data.shape)} points, {self.resolution:g} m apart, {low.tolist()} to {high.tolist()} m>"

    @property
    def data(self) -> NDArray[np.float32]:
        """Distances at the points, a new array, m. (nx, ny, nz)"""
        return self._native.data()

    @property
    def origin(self) -> Floats:
        """The point of ``data[0, 0, 0]``, m, world. (3,)"""
        return np.array(self._native.origin)

    @property
    def resolution(self) -> float:
        """Distance of neighbouring points along each axis, m."""
        return self._native.resolution

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest point of the grid, m, world."""
        origin = self.origin
        return origin, origin + self.resolution * (np.array(self.data.shape) - 1.0)

    @property
    def planes(self) -> Floats:
        """Endless planes, which are known outside of the grid too: upward unit normal and offset of each. (n, 4)"""
        return np.array(self._native.planes, np.float64).reshape(-1, 4)

    @property
    def zero_inside(self) -> tuple[int, ...]:
        """Numbers of the geoms inside of which the distance is 0, since how deep a point lies is not known: height fields, and meshes whose hull has no faces."""
        return tuple(self._native.zero_inside)

    def distance(self, points: ArrayLike, *, fast: bool = False) -> Floats:
        """Distances at points, m. (…)

        Args:
            points: Points, m, world. (…, 3)
            fast: In f32, sixteen at a time, as flights ask; else in f64.
        """
        return self.gradient(points, fast=fast)[0]

    def gradient(self, points: ArrayLike, *, fast: bool = False) -> tuple[Floats, Floats]:
        """Distances at points (…), m, and their slopes along x, y and z (…, 3), which are those of the interpolation exactly.

        Raises:
            ValueError: for points of another shape or that are not finite.
        """
        array = np.asarray(points)
        if array.ndim == 0 or array.shape[-1] != 3:
            raise ValueError(f"points: expected an array (…, 3), got the shape {array.shape}")
        rows = array.reshape(-1, 3)
        distance, slopes = self._native.at(rows, len(rows), bool(fast))
        return distance.reshape(array.shape[:-1]), slopes.reshape(array.shape)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes it as ``.npz``: ``data``, ``origin``, ``resolution``, ``planes``, ``zero_inside``. Returns the path.

        Raises:
            ValueError: for a path with another ending.
        """
        to = _checked(path)
        with open(to, "wb") as file:
            np.savez_compressed(
                file,
                data=self.data,
                origin=self.origin,
                resolution=np.float64(self.resolution),
                planes=self.planes,
                zero_inside=np.array(self.zero_inside, np.int64),
            )
        return to

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> DistanceField:
        """Reads what ``save`` wrote.

        Raises:
            OSError: where the file cannot be read.
            ValueError: where it is no distance field.
        """
        of = _checked(path)
        with open(of, "rb") as file:
            try:
                with np.load(file, allow_pickle=False) as saved:
                    arrays: dict[str, Any] = {name: saved[name] for name in ("data", "origin", "resolution", "planes", "zero_inside")}
            except Exception as error:
                raise ValueError(f"{of} is no distance field: expected an .npz with data, origin, resolution, planes and zero_inside; {error}") from None
        return cls(
            arrays["data"],
            arrays["origin"],
            float(arrays["resolution"]),
            planes=arrays["planes"],
            zero_inside=arrays["zero_inside"].ravel().tolist(),
        )


def _checked(path: str | os.PathLike[str]) -> Path:
    of = Path(path)
    if of.suffix != ".npz":
        raise ValueError(f"path: expected one that ends with .npz, got {of}")
    return of


_shorten_all(globals())
