"""One world of a data set: its tables, its frames, and both together by frame."""

from __future__ import annotations

import zipfile
from collections import OrderedDict
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from .._repr import shortened
from ._errors import DamagedError
from ._fields import CHANNEL_TYPES, EMPTY, Field, key, sampled
from ._files import RESTORE, check, item, parse, read_bytes, same, sha256
from .._optional import need

if TYPE_CHECKING:
    import pyarrow  # type: ignore[import-not-found, import-untyped, unused-ignore]

Array = NDArray[Any]


class Cache:
    """Arrays that were read last, up to a number of bytes."""

    def __init__(self, max_bytes: int) -> None:
        self.max_bytes = max_bytes
        self._arrays: OrderedDict[tuple[int, str], Array] = OrderedDict()
        self._bytes = 0

    def get(self, name: tuple[int, str]) -> Array | None:
        array = self._arrays.pop(name, None)
        if array is not None:
            self._arrays[name] = array
        return array

    def put(self, name: tuple[int, str], array: Array) -> None:
        array.setflags(write=False)
        old = self._arrays.pop(name, None)
        self._arrays[name] = array
        self._bytes += _own_bytes(array) - (0 if old is None else _own_bytes(old))
        # The newest stays, however large: without it every sample would read its world again.
        while self._bytes > self.max_bytes and len(self._arrays) > 1:
            _, oldest = self._arrays.popitem(last=False)
            self._bytes -= _own_bytes(oldest)


def _own_bytes(array: Array) -> int:
    """Memory of an array; of one that repeats a value by strides, the value's."""
    return int(np.prod([n for n, s in zip(array.shape, array.strides) if s != 0])) * array.itemsize


class World:
    """One world. Files are read when they are asked for, and compared with their hashes when they are read first.

    Arrays are read-only: they may be shared with others; ``.copy()`` gives one to write into.
    """

    def __init__(self, folder: Path, number: int, seal: str | None, manifest: Mapping[str, Any], cache: Cache) -> None:
        path = folder / "world.json"
        text = read_bytes(path)
        if seal is not None:
            same(path, "(by complete.json) sha256", seal, sha256(text))
        record = parse(path, text)
        same(path, "world", number, record.get("world"))
        self.folder = folder
        self.number = number
        self.record = record
        """Contents of world.json."""
        self.record_sha256 = sha256(text)
        self.n_frames: int = item(path, record, "n_frames", int)
        self.info = record.get("info")
        """What was drawn for this world alone (docs/formats.md)."""
        self.quarantine = record.get("quarantine")
        """None, or the ``step``, ``drone`` and ``reason`` for which the world ends early."""
        self._files = {item(path, f, "path", str): f for f in item(path, record, "files", list)}
        for name in self._files:
            if not name or PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
                raise DamagedError(f"{path}: expected paths inside the world's folder, found {name!r}; {RESTORE}")
        self._manifest = manifest
        self._cache = cache
        self._checked: set[str] = set()

    def __repr__(self) -> str:
        return shortened(f"World({self.number}: {self.n_frames} frames in {str(self.folder)!r})")

    @property
    def files(self) -> tuple[str, ...]:
        """Paths of all files of this world but world.json, within its folder."""
        return tuple(self._files)

    def path(self, name: str) -> Path:
        """Path of a file of this world, after a comparison with its size and hash.

        Raises:
            KeyError: the world has no such file.
            DamagedError: the file is missing or holds other bytes.
        """
        path = self.folder / name
        if name not in self._files:
            raise KeyError(f"{path}: world.json lists no such file")
        if name not in self._checked:
            record = self.folder / "world.json"
            f = self._files[name]
            check(path, item(record, f, "bytes", int), item(record, f, "sha256", str))
            self._checked.add(name)
        return path

    def verify(self) -> None:
        """Reads every file again and compares it with its hash; DamagedError names the first that differs, or that no list names."""
        self._checked.clear()
        for name in self._files:
            self.path(name)
        for path in sorted(self.folder.rglob("*")):
            name = path.relative_to(self.folder).as_posix()
            if name not in self._files and name != "world.json" and (path.is_symlink() or not path.is_dir()):
                raise DamagedError(f"{path}: expected only files that world.json names, found another; {RESTORE}")

    def states(self, columns: Sequence[str] | None = None) -> pyarrow.Table:
        """states.parquet: the named columns, or all."""
        return self._table("states", "n_states", columns)

    def contacts(self, columns: Sequence[str] | None = None) -> pyarrow.Table:
        """contacts.parquet: the named columns, or all."""
        return self._table("contacts", "n_contacts", columns)

    def clearance(self, columns: Sequence[str] | None = None) -> pyarrow.Table:
        """clearance.parquet: the named columns, or all. KeyError where clearance was not measured."""
        return self._table("clearance", "n_clearances", columns)

    def _table(self, stem: str, count: str, columns: Sequence[str] | None) -> Any:
        name = f"{stem}.parquet"
        parquet = need("pyarrow.parquet", "arrow")
        path = self.path(name)
        there = [c["name"] for c in self._manifest["tables"].get(name, [])]
        for c in columns or []:
            if c not in there:
                raise KeyError(f"{path}: no column \"{c}\"; there are {', '.join(there)}")
        try:
            table = parquet.read_table(path, columns=None if columns is None else list(columns), partitioning=None)
        except (OSError, ValueError) as e:
            raise DamagedError(f"{path}: expected a Parquet file, found another ({e}); {RESTORE}") from None
        if columns is None:
            same(path, "columns", there, table.column_names)
        same(path, "rows:", item(self.folder / "world.json", self.record, count, int), table.num_rows)
        return table

    def frames(self, name: str) -> Array:
        """An array of frames.npz (docs/formats.md), with its type and shape checked: (frame,), (frame, drone, ...) or (frame, obstacle, ...)."""
        wanted = {a["name"]: a for a in self._manifest["frames"]}
        if name not in wanted:
            raise KeyError(f"no array \"{name}\" in frames.npz; there are {', '.join(wanted) or 'none: the run had no camera'}")
        found = self._cache.get((self.number, f"npz/{name}"))
        if found is not None:
            return found
        path = self.path("frames.npz")
        try:
            with np.load(path, allow_pickle=False) as arrays:
                array: Array = arrays[name]
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as e:
            raise DamagedError(f"{path}: expected the array {name}, found none that can be read ({e}); {RESTORE}") from None
        camera = self._manifest["cameras"][0]
        sizes = {"frame": self.n_frames, "drone": self._manifest["n_drones"], "row": camera["height"], "column": camera["width"]}
        sizes["obstacle"] = len(self._manifest.get("obstacles", []))
        axes = [a.strip() for a in wanted[name]["shape"].strip("()").split(",") if a.strip()]
        same(path, f"{name} of shape", tuple(sizes[a] if a in sizes else int(a) for a in axes), array.shape)
        same(path, f"{name} of type", np.dtype(wanted[name]["dtype"]), array.dtype)
        self._cache.put((self.number, f"npz/{name}"), array)
        return array

    def sensor(self, name: str) -> dict[str, Array]:
        """What a sensor has sampled: ``time_s`` (sample,), ``step`` (sample,), and each of its channels (sample, drone, ...).

        Raises:
            KeyError: the data set has no such sensor.
            DamagedError: its file is missing or holds other bytes or arrays.
        """
        sensors = {s["name"]: s for s in self._manifest.get("sensors", [])}
        if name not in sensors:
            raise KeyError(f"no sensor \"{name}\"; there are {', '.join(sensors) or 'none'}")
        path = self.path(f"sensor_{name}.npz")
        channels = sensors[name]["channels"]
        out: dict[str, Array] = {}
        try:
            with np.load(path, allow_pickle=False) as arrays:
                for array in ("time_s", "step", *(c["name"] for c in channels)):
                    out[array] = arrays[array]
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as e:
            raise DamagedError(f"{path}: expected the arrays of a sensor, found a file without them ({e}); {RESTORE}") from None
        n = len(out["time_s"])
        same(path, "step of shape", (n,), out["step"].shape)
        for c in channels:
            same(path, f"{c['name']} of shape", (n, self._manifest["n_drones"], *c["shape"]), out[c["name"]].shape)
            same(path, f"{c['name']} of type", np.dtype(CHANNEL_TYPES[c["type"]]), out[c["name"]].dtype)
        for array in out.values():
            array.setflags(write=False)
        return out

    def image(self, frame: int, drone: int = 0, noisy: bool = False) -> NDArray[np.uint16]:
        """A 16-bit depth image as it lies in its file, (row, column); ``decode_image`` makes metres of it."""
        if not 0 <= frame < self.n_frames:
            raise IndexError(f"frame: expected 0 to {self.n_frames - 1}, got {frame}")
        if not 0 <= drone < self._manifest["n_drones"]:
            raise IndexError(f"drone: expected 0 to {self._manifest['n_drones'] - 1}, got {drone}")
        path = self.path(f"{'depth_noisy' if noisy else 'depth'}/drone{drone}_{frame:06d}.png")
        with need("PIL.Image", "arrow").open(path) as file:
            # Old versions of Pillow widen 16 bits to 32.
            same(path, "16 bits of grey:", True, file.mode in ("I;16", "I"))
            image: NDArray[np.uint16] = np.asarray(file).astype(np.uint16)
        camera = self._manifest["cameras"][drone]
        same(path, "pixels of shape", (camera["height"], camera["width"]), image.shape)
        return image

    def field(self, field: Field) -> Array:
        """A field of all samples of this world, (frame, drone, ...)."""
        found = self._cache.get((self.number, field.name))
        if found is not None:
            return found
        array = self._make(field)
        same(self.folder, f"{field.name} of shape", (self.n_frames, self._manifest["n_drones"], *field.shape), array.shape)
        self._cache.put((self.number, field.name), array)
        return array

    def _make(self, field: Field) -> Array:
        name, n_drones = field.name, self._manifest["n_drones"]
        shape = (self.n_frames, n_drones)
        if name == "key":
            keys = [key(self.number, d, f) for f in range(self.n_frames) for d in range(n_drones)]
            return np.array(keys, object).reshape(shape)
        if name == "world":
            return np.full(shape, self.number, np.int64)
        if name == "drone":
            return np.broadcast_to(np.arange(n_drones), shape).copy()
        if name == "frame":
            return np.broadcast_to(np.arange(self.n_frames)[:, None], shape).copy()
        if name in ("step", "time_s"):
            return np.broadcast_to(self.frames(name)[:, None], shape).copy()
        if name == "k":
            k = np.array([c["k"] for c in self._manifest["cameras"]], np.float64)
            return np.broadcast_to(k, (*shape, 3, 3))
        if field.columns or name == "state_step":
            return self._of_states(field)
        if name in ("contact", "n_contacts"):
            return self._of_contacts(name)
        if name.startswith("clearance_"):
            return self._of_clearance(name)
        for sampled_name, sensor, channel in sampled(self._manifest):
            if sampled_name == name:
                return self._of_sensor(sensor, channel["name"])
        return self.frames(name).view()

    def _numbers(self, stem: str, count: str) -> dict[str, NDArray[np.float64]]:
        """Columns of a table as floats, (row,): read once for all fields; empty cells are NaN, truth is 1."""
        name = f"{stem}.parquet"
        found = self._cache.get((self.number, name))
        if found is None:
            table = self._table(stem, count, None)
            columns = [np.asarray(c.to_numpy(), np.float64) for c in table.columns]
            found = np.stack(columns) if columns else np.zeros((0, 0))
            self._cache.put((self.number, name), found)
        return {c["name"]: values for c, values in zip(self._manifest["tables"][name], found)}

    def _rows(self, table: Mapping[str, NDArray[np.float64]], name: str) -> NDArray[np.int64]:
        """Which row of a table holds for each frame and drone: the last at or before the frame's step."""
        steps, drones = table["step"], table["drone"]
        frames = self.frames("step")
        rows = np.zeros((self.n_frames, self._manifest["n_drones"]), np.int64)
        for d in range(rows.shape[1]):
            own = np.flatnonzero(drones == d)
            if np.any(np.diff(steps[own]) <= 0):
                raise DamagedError(f"{self.folder / name}: expected rows in the order of steps, found others; {RESTORE}")
            at = np.searchsorted(steps[own], frames, side="right") - 1
            if np.any(at < 0):
                first = int(frames[at < 0][0])
                raise DamagedError(f"{self.folder / name}: expected a row of drone {d} up to step {first}, found none; {RESTORE}")
            rows[:, d] = own[at] if len(own) else 0
        return rows

    def _of_states(self, field: Field) -> Array:
        table = self._numbers("states", "n_states")
        rows = self._rows(table, "states.parquet")
        if field.name == "state_step":
            return table["step"][rows].astype(np.int64)
        array = np.stack([table[c][rows] for c in field.columns], axis=-1)
        return array if field.shape else array[..., 0]

    def _of_clearance(self, name: str) -> Array:
        table = self._numbers("clearance", "n_clearances")
        values = table["distance" if name == "clearance_m" else name[len("clearance_") :]][
            self._rows(table, "clearance.parquet")
        ]
        if name == "clearance_m":
            return np.where(np.isnan(values), EMPTY[name], values)
        return values.astype(bool if name == "clearance_exact" else np.int64)

    def _of_sensor(self, name: str, channel: str) -> Array:
        """The last sample at or before each frame; there is one at the first step."""
        samples, frames = self.sensor(name), self.frames("step")
        at = np.searchsorted(samples["step"], frames, side="right") - 1
        if np.any(at < 0):
            first = int(frames[at < 0][0])
            raise DamagedError(f"{self.folder}: expected a sample of {name} up to step {first}, found none; {RESTORE}")
        out: Array = samples[channel][at]
        return out

    def _of_contacts(self, name: str) -> Array:
        table = self._numbers("contacts", "n_contacts")
        frames = self.frames("step")
        before = np.concatenate([[-1], frames[:-1]])[: len(frames)]
        # A contact that lasts is written down at recorded steps alone: no frame may look back less far than to one.
        every = self._manifest["flight"]["state_every_steps"]
        before = np.minimum(before, frames // every * every - 1)
        out = np.zeros((self.n_frames, self._manifest["n_drones"]), np.int64)
        for d in range(out.shape[1]):
            own = np.sort(table["step"][(table["drone"] == d) | (table["other_drone"] == d)])
            out[:, d] = np.searchsorted(own, frames, side="right") - np.searchsorted(own, before, side="right")
        return out if name == "n_contacts" else out > 0
