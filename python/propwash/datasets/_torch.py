"""Samples for PyTorch."""

from __future__ import annotations

import os
from typing import Any, Callable

import numpy as np

from ._fields import Sample
from .._optional import need
from ._set import DataSet
from ._set import open as open_set

torch = need("torch", "torch")
Dataset: Any = need("torch.utils.data", "torch").Dataset


class TorchDataset(Dataset):  # type: ignore[misc]
    """A data set as a plain, map-style ``torch.utils.data.Dataset``.

    An item is a sample with a tensor for each array, of the same type and shape; numbers and texts stay as they are, and
    ``DataLoader`` makes tensors and lists of them. Works with any number of workers, started by fork or by spawn: each reads for
    itself, and keeps ``cache_mb`` of the data set.

    Args:
        data: A data set, or its folder.
        transform: Called with every sample; what it returns is the item.
    """

    def __init__(self, data: DataSet | str | os.PathLike[str], transform: Callable[[Sample], Any] | None = None) -> None:
        self.data = data if isinstance(data, DataSet) else open_set(data)
        self.transform = transform

    def __len__(self) -> int:
        return len(self.data)

    def __getitem__(self, index: int) -> Any:
        sample = self.data[index]
        for name, value in sample.items():
            if isinstance(value, np.ndarray):
                # A copy: tensors can be written into, arrays of the data set cannot.
                sample[name] = torch.from_numpy(value.copy())
        return sample if self.transform is None else self.transform(sample)
