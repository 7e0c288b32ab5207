"""Pictures of flights as one PNG file."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._optional import need


def writer() -> Any:
    """Pillow, which writes pictures."""
    return need("PIL.Image", "envs")


def png(picture: NDArray[np.uint8]) -> bytes:
    """A picture (height, width, 3) as the bytes of a PNG file."""
    held = io.BytesIO()
    writer().fromarray(picture).save(held, "PNG")
    return held.getvalue()


def side_by_side(rows: Sequence[Sequence[NDArray[Any]]], gap: int = 4) -> NDArray[np.uint8]:
    """Pictures of one size in rows and columns, with white between them."""
    height, width, _ = rows[0][0].shape
    columns = max(len(row) for row in rows)
    out = np.full((len(rows) * (height + gap) - gap, columns * (width + gap) - gap, 3), 255, np.uint8)
    for r, row in enumerate(rows):
        for c, one in enumerate(row):
            out[r * (height + gap) : r * (height + gap) + height, c * (width + gap) : c * (width + gap) + width] = one
    return out
