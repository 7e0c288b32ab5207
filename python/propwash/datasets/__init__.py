"""Data sets of ``propwash fly`` for learners: read, and turned into the forms that training programs take.

``open(folder)`` gives the samples of a data set, one for each drone and frame. ``to_arrow``, ``to_hf`` and ``write_webdataset``
make other forms of them, ``from_arrow``, ``from_hf`` and ``read_webdataset`` read those back as the same samples, and
``TorchDataset`` hands them to PyTorch. docs/datasets.md shows each; docs/formats.md says what the files hold.

Reading needs pyarrow: ``pip install 'propwash[arrow]'``. The other packages are imported when they are used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ._arrow import ArrowSamples, arrow_batches, arrow_schema, from_arrow, to_arrow, write_arrow
from ._errors import DamagedError, DataSetError, FormatError, UnfinishedError
from ._fields import Field, Sample
from ._hf import HfSamples, from_hf, hf_features, to_hf, write_hf
from ._set import DataSet, decode_image, open
from ._webdataset import WebDatasetSamples, from_webdataset, read_webdataset, write_webdataset
from ._world import World

if TYPE_CHECKING:
    from ._torch import TorchDataset

__all__ = [
    "ArrowSamples",
    "DamagedError",
    "DataSet",
    "DataSetError",
    "Field",
    "FormatError",
    "HfSamples",
    "Sample",
    "TorchDataset",
    "UnfinishedError",
    "WebDatasetSamples",
    "World",
    "arrow_batches",
    "arrow_schema",
    "decode_image",
    "from_arrow",
    "from_hf",
    "from_webdataset",
    "hf_features",
    "open",
    "read_webdataset",
    "to_arrow",
    "to_hf",
    "write_arrow",
    "write_hf",
    "write_webdataset",
]


def __getattr__(name: str) -> Any:
    # torch is imported when it is asked for.
    if name == "TorchDataset":
        from ._torch import TorchDataset

        return TorchDataset
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
