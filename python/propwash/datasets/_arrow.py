"""Samples as Arrow tables."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Iterator, Mapping

import numpy as np

from ._errors import FormatError
from ._fields import Field, Sample
from .._optional import need
from ._set import DataSet
from ._world import Array

if TYPE_CHECKING:
    import pyarrow  # type: ignore[import-not-found, import-untyped, unused-ignore]

SAMPLES, SAMPLES_VERSION = "propwash-samples", 1


def describe(data: DataSet) -> str:
    """What samples mean, as JSON that travels with them."""
    listed = [{"name": f.name, "dtype": f.dtype, "shape": list(f.shape), "unit": f.unit} for f in data.fields.values()]
    head = {"format": SAMPLES, "format_version": SAMPLES_VERSION, "fields": listed, "manifest": data.manifest}
    return json.dumps(head, ensure_ascii=False, allow_nan=False)


def understand(text: str | bytes | None, where: str) -> tuple[dict[str, Field], dict[str, Any]]:
    """Fields and manifest of samples, from what ``describe`` gave; FormatError for anything else."""
    remedy = "read what to_arrow, to_hf or write_webdataset of this version made"
    try:
        head = json.loads(text or "null")
    except ValueError:
        head = None
    if not isinstance(head, dict) or head.get("format") != SAMPLES:
        raise FormatError(f"{where}: expected samples of a Propwash data set, found no description of them; {remedy}")
    if head.get("format_version") != SAMPLES_VERSION:
        found = head.get("format_version")
        raise FormatError(f"{where}: expected samples of version {SAMPLES_VERSION}, found {found!r}; {remedy}")
    listed = {f["name"]: Field(f["name"], f["dtype"], tuple(f["shape"]), f["unit"]) for f in head["fields"]}
    return listed, head["manifest"]


def arrow_schema(data: DataSet) -> pyarrow.Schema:
    """Columns of ``to_arrow``: numbers, lists of fixed size for vectors, ``fixed_shape_tensor`` for images and matrices.

    The key ``propwash`` of its metadata holds the fields with their units and the manifest of the data set, as JSON.
    """
    pa = need("pyarrow", "arrow")
    columns = [pa.field(f.name, _type(pa, f), nullable=False, metadata={"unit": f.unit}) for f in data.fields.values()]
    return pa.schema(columns, metadata={"propwash": describe(data)})


def _type(pa: Any, f: Field) -> Any:
    value = {"str": pa.string(), "bool": pa.bool_()}.get(f.dtype) or pa.from_numpy_dtype(np.dtype(f.dtype))
    if len(f.shape) > 1:
        return pa.fixed_shape_tensor(value, f.shape)
    return pa.list_(value, f.shape[0]) if f.shape else value


def arrow_batches(data: DataSet) -> Iterator[pyarrow.RecordBatch]:
    """The samples of one world after another, one row each; no more than a world is in memory."""
    pa = need("pyarrow", "arrow")
    schema = arrow_schema(data)
    for number in data.worlds:
        world = data.world(number)
        if world.n_frames == 0:
            continue
        columns = []
        for f in data.fields.values():
            array = world.field(f)
            flat = pa.array(np.ascontiguousarray(array).reshape(-1))
            kind = schema.field(f.name).type
            if len(f.shape) > 1:
                stored = pa.FixedSizeListArray.from_arrays(flat, int(np.prod(f.shape)))
                columns.append(pa.ExtensionArray.from_storage(kind, stored))
            else:
                columns.append(pa.FixedSizeListArray.from_arrays(flat, f.shape[0]) if f.shape else flat)
        yield pa.RecordBatch.from_arrays(columns, schema=schema)


def to_arrow(data: DataSet) -> pyarrow.Table:
    """All samples as an Arrow table in memory, one row each; ``write_arrow`` needs the memory of one world only."""
    return need("pyarrow", "arrow").Table.from_batches(arrow_batches(data), schema=arrow_schema(data))


def write_arrow(data: DataSet, path: str | os.PathLike[str]) -> None:
    """Writes all samples into an Arrow file (IPC, not compressed), which can be mapped into memory.

    Raises FileExistsError where there is a file already.
    """
    pa = need("pyarrow", "arrow")
    path = Path(path)
    if path.exists():
        raise FileExistsError(f"{path}: is there already; choose another path or delete it")
    partial = path.with_name(f".partial_{path.name}")
    with pa.OSFile(str(partial), "wb") as file, pa.ipc.new_file(file, arrow_schema(data)) as writer:
        for batch in arrow_batches(data):
            writer.write_batch(batch)
    os.replace(partial, path)


def from_arrow(source: pyarrow.Table | str | os.PathLike[str]) -> ArrowSamples:
    """The samples of a table that ``to_arrow`` made, or of a file of ``write_arrow``, which is mapped into memory.

    Raises FormatError for other tables and files.
    """
    pa = need("pyarrow", "arrow")
    where = "table"
    if isinstance(source, (str, os.PathLike)):
        where = os.fspath(source)
        try:
            source = pa.ipc.open_file(pa.memory_map(where)).read_all()
        except pa.ArrowInvalid as e:
            raise FormatError(f"{where}: expected an Arrow file, found another ({e})") from None
    return ArrowSamples(source, where)


class ArrowSamples:
    """Samples in an Arrow table, the same as those of the data set that it was made of."""

    def __init__(self, table: Any, where: str) -> None:
        self.table = table
        text = (table.schema.metadata or {}).get(b"propwash")
        listed, self.manifest = understand(text, where)
        self.fields: Mapping[str, Field] = {name: f for name, f in listed.items() if name in table.column_names}
        """What a sample holds."""

    def __len__(self) -> int:
        return int(self.table.num_rows)

    def __getitem__(self, index: int) -> Sample:
        n = len(self)
        if not -n <= index < n:
            raise IndexError(f"index: expected a sample from {-n} to {n - 1}, got {index}")
        return next(_rows(self.table.slice(index % n, 1), self.fields))

    def __iter__(self) -> Iterator[Sample]:
        pa = need("pyarrow", "arrow")
        for batch in self.table.to_batches():
            yield from _rows(pa.Table.from_batches([batch]), self.fields)


def _rows(table: Any, listed: Mapping[str, Field]) -> Iterator[Sample]:
    """The samples of a table of one batch."""
    columns = [(f, column_values(table[f.name].chunk(0), f)) for f in listed.values()]
    for i in range(table.num_rows):
        yield {f.name: values[i] for f, values in columns}


def column_values(column: Any, f: Field) -> Any:
    """A column of one chunk: a list of numbers or texts, or an array (row, ...), without a copy."""
    if not f.shape:
        return column.to_pylist()
    values = getattr(column, "storage", column)
    # One level of lists for each axis, or one for all of them.
    while hasattr(values, "flatten") and hasattr(values.type, "value_type"):
        values = values.flatten()
    array: Array = values.to_numpy(zero_copy_only=f.dtype != "bool")
    return array.reshape(len(column), *f.shape)
