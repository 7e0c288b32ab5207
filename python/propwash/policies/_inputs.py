"""What a policy makes of the numbers and images that an environment observes, before its network sees them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]
Shape = tuple[int, ...]


@dataclass(frozen=True)
class Channel:
    """A channel of the observation of one drone, as the environment gives it without wrappers."""

    name: str
    """Its name in the observation."""
    shape: Shape
    """``(3,)`` for three numbers, ``(height, width)`` for a depth image, ``(frames, height, width)`` for the last ones, oldest first."""
    frames: int = 1
    """How many of the last images stand in it (``DepthFrameStack``)."""

    @property
    def size(self) -> int:
        """Its numbers."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class Input:
    """A channel, and what is done with it in turn. Each method gives a new ``Input`` with one step more:

    >>> Input("vel").scale(0.5)
    >>> Input("depth").nearness(0.2, 6.0).pool(4, 4, "max").scale(3.0)
    """

    channel: str
    """Name of the channel."""
    steps: tuple[Mapping[str, Any], ...] = ()
    """The steps, as the file has them: ``{"step": "scale", "factor": 0.5, "offset": 0.0}``."""

    def _then(self, step: str, **options: Any) -> Input:
        return Input(self.channel, (*self.steps, {"step": step, **options}))

    def take(self, *columns: int) -> Input:
        """Only these of its numbers, counted from 0."""
        return self._then("take", columns=[int(c) for c in columns])

    def scale(self, factor: ArrayLike = 1.0, offset: ArrayLike = 0.0) -> Input:
        """``(x - offset) * factor``; numbers, or arrays of the shape of x."""
        return self._then("scale", factor=_plain(factor), offset=_plain(offset))

    def clip(self, low: float, high: float) -> Input:
        """Not below ``low`` and not above ``high``."""
        return self._then("clip", low=float(low), high=float(high))

    def round(self) -> Input:
        """To whole numbers, halves to the even one, as images of 8 bits are made."""
        return self._then("round")

    def direction(self, least: float = 0.1) -> Input:
        """``x / max(|x|, least)``."""
        return self._then("direction", least=float(least))

    def length(self) -> Input:
        """``|x|``, one number."""
        return self._then("length")

    def tilt(self) -> Input:
        """Of an attitude (x y z w): how far the axes x and y of the body point up, ``2 (xz - wy)`` and ``2 (yz + wx)``."""
        return self._then("tilt")

    def nearness(self, near: float, far: float) -> Input:
        """Of a depth in m: from 1 at ``near`` and nearer to 0 at ``far``, in proportion to the inverse depth (``NormalizeDepth``)."""
        return self._then("nearness", near=float(near), far=float(far))

    def pool(self, height: int, width: int, kind: Literal["min", "max", "mean"]) -> Input:
        """Of an image: the least, the greatest or the mean of each block of ``height`` x ``width`` pixels."""
        return self._then("pool", height=int(height), width=int(width), kind=kind)

    def image(self) -> Input:
        """Of a depth image (height, width): with the axis of channels that networks for images want, (1, height, width)."""
        return self._then("image")


def _plain(value: ArrayLike) -> Any:
    array = np.asarray(value, np.float64)
    return float(array) if array.ndim == 0 else array.tolist()


_OPTIONS: dict[str, set[str]] = {
    "take": {"columns"},
    "scale": {"factor", "offset"},
    "clip": {"low", "high"},
    "round": set(),
    "direction": {"least"},
    "length": set(),
    "tilt": set(),
    "nearness": {"near", "far"},
    "pool": {"height", "width", "kind"},
    "image": set(),
}


def shape_after(step: Mapping[str, Any], shape: Shape, where: str) -> Shape:
    """Shape of what a step gives, of one drone; raises where the step makes no sense there."""
    name = step.get("step")
    if name not in _OPTIONS:
        raise ValueError(f"{where}: expected one of the steps {', '.join(_OPTIONS)}, found {name!r}")
    if set(step) != {"step", *_OPTIONS[name]}:
        raise ValueError(f"{where}: {name}: expected the options {sorted(_OPTIONS[name])}, found {sorted(set(step) - {'step'})}")
    for option, value in step.items():
        if option in ("low", "high", "least", "near", "far", "factor", "offset") and not np.isfinite(np.asarray(value, np.float64)).all():
            raise ValueError(f"{where}: {name}: {option}: expected finite numbers, found {value}")
    if name == "pool":
        return _pooled(step, shape, where)
    if name == "image":
        if len(shape) != 2:
            raise ValueError(f"{where}: image: expected an image (height, width), found the shape {shape}")
        return (1, *shape)
    if name in ("take", "direction", "length", "tilt") and len(shape) != 1:
        raise ValueError(f"{where}: {name}: expected numbers in a row, (n,), found the shape {shape}")
    if name == "take":
        columns = step["columns"]
        if not columns or not all(isinstance(c, int) and 0 <= c < shape[0] for c in columns):
            raise ValueError(f"{where}: take: expected columns of 0 to {shape[0] - 1}, found {columns}")
        return (len(columns),)
    if name == "scale":
        for option in ("factor", "offset"):
            got = np.shape(step[option])
            if got not in ((), shape):
                raise ValueError(f"{where}: scale: {option}: expected a number or an array of the shape {shape}, found one of {got}")
    if name == "clip" and not step["low"] < step["high"]:
        raise ValueError(f"{where}: clip: expected low < high, found {step['low']} and {step['high']}")
    if name == "direction" and not step["least"] > 0.0:
        raise ValueError(f"{where}: direction: least: expected a number above 0, found {step['least']}")
    if name == "nearness" and not 0.0 < step["near"] < step["far"]:
        raise ValueError(f"{where}: nearness: expected 0 < near < far, found {step['near']} and {step['far']}")
    if name == "length":
        return (1,)
    if name == "tilt":
        if shape != (4,):
            raise ValueError(f"{where}: tilt: expected an attitude, (4,), found the shape {shape}")
        return (2,)
    return shape


def _pooled(step: Mapping[str, Any], shape: Shape, where: str) -> Shape:
    height, width, kind = step["height"], step["width"], step["kind"]
    if kind not in ("min", "max", "mean"):
        raise ValueError(f'{where}: pool: kind: expected "min", "max" or "mean", found {kind!r}')
    if len(shape) < 2 or height < 1 or width < 1 or shape[-2] % height or shape[-1] % width:
        raise ValueError(f"{where}: pool: expected an image whose sides {height} and {width} divide, found the shape {shape}")
    return (*shape[:-2], shape[-2] // height, shape[-1] // width)


def shape_of(given: Input, shape: Shape, where: str) -> Shape:
    """Shape of an input after all its steps."""
    for k, step in enumerate(given.steps):
        shape = shape_after(step, shape, f"{where}.steps[{k}]")
    return shape


def apply(given: Input, x: Array) -> Array:
    """What the steps make of a batch, (n, ...) float32."""
    for step in given.steps:
        x = _apply(step, x)
    return x


def _apply(step: Mapping[str, Any], x: Array) -> Array:
    name = step["step"]
    f = np.float32
    if name == "take":
        return x[:, step["columns"]]
    if name == "scale":
        return (x - np.asarray(step["offset"], f)) * np.asarray(step["factor"], f)
    if name == "clip":
        return np.clip(x, f(step["low"]), f(step["high"]))
    if name == "round":
        return np.rint(x)
    if name in ("direction", "length"):
        length = np.sqrt((x * x).sum(axis=-1, keepdims=True))
        return np.asarray(x / np.maximum(length, f(step["least"])) if name == "direction" else length)
    if name == "tilt":
        a, b, c, d = x.T
        return np.stack([2 * (a * c - d * b), 2 * (b * c + d * a)], axis=-1)
    if name == "nearness":
        low, high = f(1.0 / step["far"]), f(1.0 / step["near"])
        return np.clip((f(1.0) / np.maximum(x, f(step["near"])) - low) / (high - low), f(0.0), f(1.0))
    if name == "image":
        return x[:, None]
    h, w = step["height"], step["width"]
    blocks = x.reshape(*x.shape[:-2], x.shape[-2] // h, h, x.shape[-1] // w, w)
    if step["kind"] == "mean":
        return np.asarray(blocks.mean(axis=(-3, -1)), f)
    return np.asarray(blocks.min(axis=(-3, -1)) if step["kind"] == "min" else blocks.max(axis=(-3, -1)))


def in_words(given: Input) -> str:
    """An input in one line of text."""
    words = [given.channel]
    for step in given.steps:
        options = {k: v for k, v in step.items() if k != "step"}
        shown = ", ".join(f"{k} {_short(v)}" for k, v in options.items())
        words.append(f"{step['step']}({shown})")
    return " -> ".join(words)


def _short(value: Any) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str):
        flat = np.ravel(value)
        numbers = [f"{v:.6g}" for v in flat[:12]]
        return "[" + ", ".join([*numbers, f"... {flat.size} in all"] if flat.size > 12 else numbers) + "]"
    return value if isinstance(value, str) else f"{value:.6g}"
