"""Samples as WebDataset shards."""

from __future__ import annotations

import io
import json
import math
import os
import tarfile
from pathlib import Path
from typing import Any, Iterator, Mapping

import numpy as np

from ..sense import _whole
from ._arrow import describe, understand
from ._errors import DamagedError, FormatError, UnfinishedError
from ._fields import EMPTY, Field, Sample
from ._files import RESTORE, check, item, parse, read_bytes, same, sha256_of
from ._set import DataSet

INDEX = "dataset.json"


def write_webdataset(data: DataSet, folder: str | os.PathLike[str], samples_per_shard: int = 1000) -> list[Path]:
    """Writes all samples into shards of the WebDataset convention: ``shard-000000.tar``, ``shard-000001.tar``, ...

    A sample is ``KEY.FIELD.npy`` for each image (depth_m, status, ...) and ``KEY.json`` with all other fields. JSON has
    ``null`` for empty cells, that is, NaN, and for a clearance of +inf. ``dataset.json`` beside the shards is written last, with
    the number of samples, size and SHA-256 of each shard, fields with units, and the manifest. The same data set gives the same
    bytes: no file holds a clock time, a user or a machine.

    Args:
        data: Data set, or one of fewer fields (``with_fields``).
        folder: To be made, or empty.
        samples_per_shard: In every shard but the last.

    Returns:
        Paths of the shards.

    Raises:
        FileExistsError: The folder holds anything.
        ValueError: No samples.
    """
    n = _whole("samples_per_shard", samples_per_shard, 1, 2**31)
    folder = Path(folder)
    if len(data) == 0:
        raise ValueError(f"{data.path}: expected at least one sample, found none: the run had no camera, or no world has a frame")
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise FileExistsError(f"{folder}: expected an empty folder, found files; choose another folder or empty it")
    paths, shards, samples = [], [], iter(data)
    for k in range(math.ceil(len(data) / n)):
        path = folder / f"shard-{k:06d}.tar"
        count = min(n, len(data) - k * n)
        with tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as tar:
            for _ in range(count):
                _write_sample(tar, next(samples), data.fields)
        shards.append({"path": path.name, "samples": count, "bytes": path.stat().st_size, "sha256": sha256_of(path)})
        paths.append(path)
    index = {"n_samples": len(data), "shards": shards, "samples": json.loads(describe(data))}
    partial = folder / f".partial_{INDEX}"
    partial.write_text(json.dumps(index, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(partial, folder / INDEX)
    return paths


def _is_image(f: Field) -> bool:
    return f.dtype != "float64" and len(f.shape) > 1


def _write_sample(tar: tarfile.TarFile, sample: Sample, listed: Mapping[str, Field]) -> None:
    rest = {}
    for name, f in listed.items():
        if _is_image(f):
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.ascontiguousarray(sample[name]), version=(1, 0), allow_pickle=False)
            _add(tar, f"{sample['key']}.{name}.npy", buffer.getvalue())
        else:
            rest[name] = _plain(sample[name], f)
    _add(tar, f"{sample['key']}.json", json.dumps(rest, ensure_ascii=False, allow_nan=False).encode())


def _add(tar: tarfile.TarFile, name: str, data: bytes) -> None:
    """A file without clock, user and machine."""
    info = tarfile.TarInfo(name)
    info.size, info.mode = len(data), 0o644
    tar.addfile(info, io.BytesIO(data))


def _plain(value: Any, f: Field) -> Any:
    """A field as JSON has it: empty cells as null."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list):
        return [_plain(v, f) for v in value]
    empty = EMPTY.get(f.name, math.nan)
    if isinstance(value, float) and not math.isfinite(value):
        if value == empty or (math.isnan(value) and math.isnan(empty)):
            return None
        raise ValueError(f"{f.name}: expected a finite number or an empty cell, got {value}")
    return value


def _value(value: Any, f: Field, where: str) -> Any:
    """``_plain`` backwards."""
    if f.shape:
        # None becomes NaN; only EMPTY has other values, and those are single numbers.
        array = np.array(value, np.float64)
        same(Path(where), f"{f.name} of shape", f.shape, array.shape)
        return array
    return EMPTY.get(f.name, math.nan) if value is None else value


def from_webdataset(sample: Mapping[str, Any]) -> Sample:
    """A sample of the package ``webdataset`` as the data set has it.

    For ``webdataset.WebDataset(..., shardshuffle=False).decode().map(propwash.datasets.from_webdataset)``.
    """
    where = str(sample.get("__key__"))
    rest = sample.get("json")
    if not isinstance(rest, dict):
        found = type(rest).__name__
        raise FormatError(f"{where}: expected decoded samples with an entry \"json\", found {found}; call .decode() first")
    out: Sample = {name: _value(value, Field(name, "", np.shape(value), ""), where) for name, value in rest.items()}
    out.update({name[: -len(".npy")]: array for name, array in sample.items() if name.endswith(".npy")})
    return out


class WebDatasetSamples:
    """Samples of shards, one after another, the same as those of the data set that they were made of."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        path = folder / INDEX
        if not folder.is_dir():
            raise FileNotFoundError(f"{folder}: expected a folder of shards, found {'a file' if folder.exists() else 'nothing'}")
        if not path.exists():
            if any(folder.glob("shard-*.tar")):
                raise UnfinishedError(f"{folder}: expected {INDEX} beside the shards, found none; write them anew")
            raise FormatError(f"{folder}: expected shards of write_webdataset, found a folder without {INDEX}; check the path")
        index = parse(path, read_bytes(path))
        listed, self.manifest = understand(json.dumps(index.get("samples")), os.fspath(path))
        self.fields: Mapping[str, Field] = listed
        """What a sample holds."""
        self._n = item(path, index, "n_samples", int)
        self._shards = item(path, index, "shards", list)

    def __len__(self) -> int:
        return int(self._n)

    @property
    def shards(self) -> list[Path]:
        """Paths of the shards, in their order."""
        return [self.folder / s["path"] for s in self._shards]

    def __iter__(self) -> Iterator[Sample]:
        for shard in self._shards:
            yield from self._read(self.folder / shard["path"], shard)

    def _read(self, path: Path, shard: Mapping[str, Any]) -> Iterator[Sample]:
        check(path, shard["bytes"], shard["sha256"])
        n, now = 0, ""
        parts: dict[str, bytes] = {}
        with tarfile.open(path, "r:") as tar:
            for member in tar:
                key, _, name = member.name.partition(".")
                if now and key != now:
                    yield self._sample(parts, path)
                    n, parts = n + 1, {}
                now = key
                file = tar.extractfile(member)
                assert file is not None, "shards hold plain files"
                parts[name] = file.read()
            if now:
                yield self._sample(parts, path)
                n += 1
        same(path, "samples:", shard["samples"], n)

    def _sample(self, parts: Mapping[str, bytes], path: Path) -> Sample:
        out: Sample = {}
        rest = parse(path, parts.get("json", b""))
        for name, f in self.fields.items():
            if _is_image(f):
                if f"{name}.npy" not in parts:
                    raise DamagedError(f"{path}: expected {name}.npy in every sample, found one without; {RESTORE}")
                array = np.load(io.BytesIO(parts[f"{name}.npy"]), allow_pickle=False)
                same(path, f"{name} of type and shape", (np.dtype(f.dtype), f.shape), (array.dtype, array.shape))
                out[name] = array
            else:
                if name not in rest:
                    raise DamagedError(f"{path}: expected {name} in every sample, found one without; {RESTORE}")
                out[name] = _value(rest[name], f, os.fspath(path))
        return out


def read_webdataset(folder: str | os.PathLike[str]) -> WebDatasetSamples:
    """The samples of shards that ``write_webdataset`` wrote, in their order. Needs no package but NumPy.

    Every shard is compared with its size and hash before its first sample.

    Raises:
        FileNotFoundError: No such folder.
        FormatError: Not shards of ``write_webdataset``.
        UnfinishedError: Shards without ``dataset.json``, which is written last.
        DamagedError: A shard is missing or holds other bytes, when it is reached.
    """
    return WebDatasetSamples(Path(folder))
