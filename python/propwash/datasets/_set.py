"""A data set as it lies in its folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from .._repr import shortened
from ..sense import PixelStatus, _float, _whole
from ._errors import DamagedError, DataSetError, FormatError, UnfinishedError
from ._fields import ALWAYS, Field, Sample, chosen, fields
from ._files import RESTORE, item, parse, read_bytes, same, sha256
from ._world import Cache, World

if TYPE_CHECKING:
    import os

FORMAT, FORMAT_VERSION = "propwash-dataset", 1


def open(path: str | os.PathLike[str], *, unfinished: bool = False, cache_mb: float = 512.0) -> DataSet:
    """Opens a data set that ``propwash fly`` wrote (docs/formats.md).

    Reads the manifest, the seal and the list of files of every world, each compared with its hash. All else is read when it is
    asked for.

    Args:
        path: Folder of the data set.
        unfinished: Take a data set without its seal too, with the worlds that are there.
        cache_mb: How many megabytes (1e6 bytes) of arrays are kept for the next samples.

    Raises:
        FileNotFoundError: No such folder.
        FormatError: Not a data set, or one of another version.
        UnfinishedError: The run that makes it has not ended, unless ``unfinished``.
        DamagedError: A file is missing or holds other bytes than were written.
    """
    limit = _float("cache_mb", cache_mb)
    if not 0.0 <= limit < float("inf"):
        raise ValueError(f"cache_mb: expected 0 or more megabytes, got {cache_mb!r}")
    return DataSet(Path(path), bool(unfinished), int(limit * 1e6))


class DataSet:
    """A data set, made by ``open``. ``data[i]`` is sample ``i``: one drone in one frame, a dictionary by the names of ``fields``.

    Samples are in the order of worlds, frames, drones. Their arrays are read-only views of arrays of a whole world, which are
    kept for the next samples: going through the samples in order reads each file once, jumping between more worlds than
    ``cache_mb`` holds reads files again and again.

    It may be pickled and used after a fork: each process reads for itself, and refuses if the data set has changed since.
    """

    def __init__(self, path: Path, unfinished: bool, cache_bytes: int) -> None:
        self.path = path
        self._unfinished = unfinished
        self._manifest_text, self.manifest = _manifest(path)
        self.fields: Mapping[str, Field] = fields(self.manifest)
        """What a sample holds."""
        seal = _seal(path, self._manifest_text, self.manifest["n_worlds"])
        self.complete = seal is not None
        """Whether the run that made it has ended."""
        there = [w for w in range(self.manifest["n_worlds"]) if (path / _folder(w)).is_dir()]
        if seal is None and not unfinished:
            missing = sorted(set(range(self.manifest["n_worlds"])) - set(there))
            lacking = f"{len(missing)} worlds (first: world {missing[0]})" if missing else "the seal, complete.json"
            raise UnfinishedError(
                f"{path}: expected a finished data set, found one of {self.manifest['n_worlds']} worlds that lacks {lacking}; "
                "run the command that made it again, it continues where it stopped, or open it with unfinished=True"
            )
        self._cache = Cache(cache_bytes)
        numbers = range(self.manifest["n_worlds"]) if seal is not None else there
        self._worlds = {
            w: World(path / _folder(w), w, None if seal is None else seal[w], self.manifest, self._cache) for w in numbers
        }
        self.worlds: tuple[int, ...] = tuple(self._worlds)
        """Numbers of the worlds that are there."""
        n_drones = self.manifest["n_drones"]
        self._ends = np.cumsum([w.n_frames * n_drones for w in self._worlds.values()], dtype=np.int64)

    def __repr__(self) -> str:
        state = "" if self.complete else ", unfinished"
        return shortened(f"DataSet({str(self.path)!r}: {len(self._worlds)} worlds, {len(self)} samples{state})")

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def __getitem__(self, index: int) -> Sample:
        world, frame, drone = self.where(index)
        w = self._worlds[world]
        return {name: _one(w.field(f)[frame, drone], f) for name, f in self.fields.items()}

    def __iter__(self) -> Iterator[Sample]:
        for w in self._worlds.values():
            arrays = [(name, f, w.field(f)) for name, f in self.fields.items()] if w.n_frames else []
            for frame in range(w.n_frames):
                for drone in range(self.manifest["n_drones"]):
                    yield {name: _one(array[frame, drone], f) for name, f, array in arrays}

    def where(self, index: int) -> tuple[int, int, int]:
        """World, frame and drone of a sample; negative numbers count from the end. IndexError beyond the last."""
        n = len(self)
        try:
            i = _whole("index", index, -n, max(n - 1, 0))
        except ValueError:
            raise IndexError(f"index: expected a sample from {-n} to {n - 1}, got {index}") from None
        if n == 0:
            raise IndexError(f"index: {self.path} has no samples")
        i %= n
        k = int(np.searchsorted(self._ends, i, side="right"))
        frame, drone = divmod(i - (int(self._ends[k - 1]) if k else 0), self.manifest["n_drones"])
        return self.worlds[k], frame, drone

    def world(self, number: int) -> World:
        """A world by its number; KeyError where it is not there."""
        n = _whole("world", number, 0, self.manifest["n_worlds"] - 1)
        if n not in self._worlds:
            raise KeyError(f"{self.path}: world {n} is not there; there are {len(self.worlds)} of {self.manifest['n_worlds']}")
        return self._worlds[n]

    def with_fields(self, *names: str) -> DataSet:
        """The same data set with samples of fewer fields: those named, and key, world, drone, frame, step and time_s.

        What is left out is not read. KeyError for a name that is no field.
        """
        out = DataSet.__new__(DataSet)
        out.__dict__.update(self.__dict__)
        out.fields = chosen(self.fields, names)
        return out

    def scene_path(self) -> Path:
        """Path of scene.mjb, the compiled scene with its drones, after a comparison with its hash: ``mujoco.MjModel.from_binary_path`` of
        the MuJoCo version in the manifest loads it, and needs no other file.

        Raises:
            KeyError: a data set without a scene, or of a version that did not keep it.
            DamagedError: the file is missing or holds other bytes.
        """
        wanted = self.manifest["scene"].get("mjb_sha256")
        if wanted is None:
            raise KeyError(f"{self.path}: the data set holds no scene")
        path = self.path / "scene.mjb"
        same(path, "sha256", wanted, sha256(read_bytes(path)))
        return path

    def verify(self) -> None:
        """Reads every file of every world and compares it with its hash; DamagedError names the first that differs, or that no list
        names."""
        if "mjb_sha256" in self.manifest["scene"]:
            self.scene_path()
        ours = {_folder(w) for w in range(self.manifest["n_worlds"])}
        for path in sorted(self.path.glob("world_*")):
            if path.name not in ours:
                raise DamagedError(f"{path}: expected {len(ours)} worlds, which the manifest names, found another; {RESTORE}")
        for w in self._worlds.values():
            w.verify()

    @property
    def fingerprint(self) -> str:
        """Hash of the manifest, of the lists of files of all worlds, and of the names of the fields: of all that samples hold."""
        parts = [sha256(self._manifest_text), *(w.record_sha256 for w in self._worlds.values()), *self.fields]
        return sha256("\n".join(parts).encode())

    def __getstate__(self) -> dict[str, Any]:
        names = [name for name in self.fields if name not in ALWAYS]
        return {
            "path": self.path,
            "unfinished": self._unfinished,
            "cache_bytes": self._cache.max_bytes,
            "names": names,
            "fingerprint": self.fingerprint,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        DataSet.__init__(self, state["path"], state["unfinished"], state["cache_bytes"])
        self.fields = chosen(self.fields, state["names"])
        if self.fingerprint != state["fingerprint"]:
            raise DataSetError(f"{self.path}: the data set is another than when it was opened; open it again")


def _one(value: Any, field: Field) -> Any:
    """An entry of a sample: numbers as Python's own, arrays as they are."""
    if field.shape:
        return value
    return value if field.dtype == "str" else value.item()


def _folder(world: int) -> str:
    return f"world_{world:05d}"


def _manifest(path: Path) -> tuple[bytes, dict[str, Any]]:
    """Text and contents of a manifest of this version."""
    if not path.is_dir():
        raise FileNotFoundError(f"{path}: expected the folder of a data set, found {'a file' if path.exists() else 'nothing'}")
    file = path / "manifest.json"
    if not file.is_file():
        raise FormatError(f"{path}: expected a data set, found a folder without manifest.json; check the path")
    text = read_bytes(file)
    manifest = parse(file, text)
    found = (manifest.get("format"), manifest.get("format_version"))
    if found != (FORMAT, FORMAT_VERSION):
        raise FormatError(
            f"{file}: expected format \"{FORMAT}\" version {FORMAT_VERSION}, found {found[0]!r} version {found[1]!r}; "
            "read it with the program that wrote it"
        )
    kinds = {"n_worlds": int, "n_drones": int, "cameras": list, "frames": list, "flight": dict, "tables": dict}
    for name, kind in kinds.items():
        item(file, manifest, name, kind)
    for name in ("state_every_steps", "clearance_every_steps", "contact_every_steps"):
        item(file, manifest["flight"], name, int)
    if manifest["cameras"]:
        same(file, "cameras:", manifest["n_drones"], len(manifest["cameras"]))
    return text, manifest


def _seal(path: Path, manifest_text: bytes, n_worlds: int) -> list[str] | None:
    """Hash of the world.json of each world; none where there is no seal."""
    file = path / "complete.json"
    if not file.exists():
        return None
    seal = parse(file, read_bytes(file))
    same(path / "manifest.json", "(by complete.json) sha256", item(file, seal, "manifest_sha256", str), sha256(manifest_text))
    worlds = item(file, seal, "worlds", list)
    same(file, "worlds:", [_folder(w) for w in range(n_worlds)], [w.get("dir") for w in worlds])
    return [item(file, w, "world_json_sha256", str) for w in worlds]


def decode_image(image: NDArray[np.uint16], manifest: Mapping[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Depth in metres and ``PixelStatus`` of a 16-bit depth image, both of its shape.

    Depth is +inf for a miss and for what is too far, 0 for what is too near, as in frames.npz; hits are rounded to the unit of
    the image, ``manifest["depth_png"]["metres_per_unit"]``.
    """
    codes = manifest["depth_png"]
    if image.dtype != np.uint16:
        raise TypeError(f"image: expected uint16, got {image.dtype}")
    status: NDArray[np.uint8] = np.full(image.shape, PixelStatus.HIT, np.uint8)
    depth: NDArray[np.float64] = image.astype(np.float64) * float(codes["metres_per_unit"])
    for code, value in (("miss", np.inf), ("too_far", np.inf), ("too_near", 0.0)):
        there = image == codes[code]
        status[there] = PixelStatus[code.upper()]
        depth[there] = value
    return depth, status
