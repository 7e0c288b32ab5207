"""What can be wrong with a data set."""

from __future__ import annotations

from .._native import Error


class DataSetError(Error):
    """A data set cannot be read."""


class FormatError(DataSetError):
    """Not a data set, or one of another format or version."""


class UnfinishedError(DataSetError):
    """A run has not finished the data set."""


class DamagedError(DataSetError):
    """A file is missing, cut short, or holds other bytes than were written."""
