"""Samples as data sets of Hugging Face."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Iterator, Mapping

from ._arrow import column_values, describe, understand
from ._fields import Field, Sample
from .._optional import need
from ._set import DataSet

if TYPE_CHECKING:
    import datasets  # type: ignore[import-not-found, import-untyped, unused-ignore]


def hf_features(data: DataSet) -> datasets.Features:
    """Types of ``to_hf``: ``Value`` for numbers, lists of fixed length for vectors, ``Array2D`` for images and matrices."""
    hf = need("datasets", "hf")

    def feature(f: Field) -> Any:
        value = {"str": "string"}.get(f.dtype, f.dtype)
        if len(f.shape) > 1:
            return getattr(hf, f"Array{len(f.shape)}D")(shape=f.shape, dtype=value)
        return hf.Sequence(hf.Value(value), length=f.shape[0]) if f.shape else hf.Value(value)

    return hf.Features({f.name: feature(f) for f in data.fields.values()})


def _generate(data: DataSet) -> Iterator[Sample]:
    yield from data


def to_hf(data: DataSet, cache_dir: str | os.PathLike[str] | None = None) -> datasets.Dataset:
    """All samples as a ``datasets.Dataset`` of Hugging Face, one row each.

    It lies in a file of their cache (``cache_dir``, or ``~/.cache/huggingface``) that is mapped into memory; a second call for
    the same data set and fields finds it there. ``save_to_disk(folder)`` keeps it elsewhere. Its description holds fields, units
    and manifest as JSON.

    ``with_format("numpy")`` of Hugging Face makes float32 of float64; ``from_hf`` keeps every type.
    """
    hf = need("datasets", "hf")
    _some(data)
    # Pickled data sets hold their fingerprint: another data set in the same folder is not taken for this one.
    out = hf.Dataset.from_generator(
        _generate,
        features=hf_features(data),
        gen_kwargs={"data": data},
        cache_dir=None if cache_dir is None else os.fspath(cache_dir),
    )
    out.info.description = describe(data)
    return out


def _some(data: DataSet) -> None:
    if len(data) == 0:
        raise ValueError(f"{data.path}: expected at least one sample, found none: the run had no camera, or no world has a frame")


def write_hf(data: DataSet, folder: str | os.PathLike[str], cache_dir: str | os.PathLike[str] | None = None) -> None:
    """``to_hf(data).save_to_disk(folder)``. FileExistsError where the folder holds anything."""
    if os.path.exists(folder) and (not os.path.isdir(folder) or os.listdir(folder)):
        raise FileExistsError(f"{os.fspath(folder)}: is there already; choose another folder or empty it")
    to_hf(data, cache_dir).save_to_disk(os.fspath(folder))


def from_hf(source: datasets.Dataset | str | os.PathLike[str]) -> HfSamples:
    """The samples of a data set that ``to_hf`` made, or of a folder of ``write_hf``; FormatError for others."""
    where = "data set"
    if isinstance(source, (str, os.PathLike)):
        where = os.fspath(source)
        source = need("datasets", "hf").load_from_disk(where)
    return HfSamples(source, where)


class HfSamples:
    """Samples of a data set of Hugging Face, with the types and values of the data set that it was made of.

    Rows are those of ``dataset``, so ``dataset.shuffle()``, ``.select()`` and ``.filter()`` come before ``from_hf``.
    """

    def __init__(self, dataset: Any, where: str) -> None:
        self.dataset = dataset.with_format("arrow")
        listed, self.manifest = understand(dataset.info.description, where)
        self.fields: Mapping[str, Field] = {name: f for name, f in listed.items() if name in dataset.column_names}
        """What a sample holds."""

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, index: int) -> Sample:
        n = len(self)
        if not -n <= index < n:
            raise IndexError(f"index: expected a sample from {-n} to {n - 1}, got {index}")
        return next(self._rows(self.dataset[index % n]))

    def __iter__(self) -> Iterator[Sample]:
        for batch in self.dataset.iter(batch_size=64):
            yield from self._rows(batch)

    def _rows(self, table: Any) -> Iterator[Sample]:
        columns = [(f, column_values(table[f.name].combine_chunks(), f)) for f in self.fields.values()]
        for i in range(table.num_rows):
            yield {f.name: values[i] for f, values in columns}
