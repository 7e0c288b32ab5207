"""Texts of objects that stay short, whatever they hold."""

from __future__ import annotations

from collections.abc import Mapping, Sized
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

#: Most characters of an object's text.
MOST = 1000
#: Most characters of one of its fields.
MOST_OF_FIELD = 100


def shortened(text: str, most: int = MOST) -> str:
    """The text, or its beginning and its last character."""
    return text if len(text) <= most else f"{text[: most - 2]}…{text[-1]}"


def _field(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"<{value.dtype} {value.shape}>"
    if isinstance(value, str):
        return shortened(repr(value[: 2 * MOST_OF_FIELD]), MOST_OF_FIELD)
    if isinstance(value, Sized) and len(value) > 8:
        return f"<{type(value).__name__} of {len(value)}>"
    if isinstance(value, tuple):
        inner = ", ".join(map(_field, value)) + ("," if len(value) == 1 else "")
        return shortened(f"({inner})", MOST_OF_FIELD)
    if isinstance(value, list):
        return shortened(f"[{', '.join(map(_field, value))}]", MOST_OF_FIELD)
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_field(key)}: {_field(one)}" for key, one in value.items())
        return shortened(f"{{{inner}}}", MOST_OF_FIELD)
    return shortened(repr(value), MOST_OF_FIELD)


def short_repr(self: Any) -> str:
    """``__repr__`` of a dataclass: arrays by type and shape, long lists by their number, long texts by their beginning."""
    inner = ", ".join(f"{f.name}={_field(getattr(self, f.name))}" for f in fields(self) if f.repr)
    return shortened(f"{type(self).__qualname__}({inner})")


def shorten_all(names: Mapping[str, Any]) -> None:
    """Gives every dataclass among them a text that stays short."""
    for kind in names.values():
        if isinstance(kind, type) and is_dataclass(kind):
            kind.__repr__ = short_repr  # type: ignore[method-assign]
