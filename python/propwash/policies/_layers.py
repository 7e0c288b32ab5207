"""Layers of a policy's network, in NumPy."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Shape = tuple[int, ...]

#: Kinds of layers, and their options with the defaults.
KINDS: dict[str, dict[str, Any]] = {
    "linear": {},
    "conv2d": {"stride": [1, 1], "padding": [0, 0]},
    "layer_norm": {"eps": 1e-5},
    "flatten": {},
    "tanh": {},
    "relu": {},
    "elu": {"alpha": 1.0},
    "leaky_relu": {"slope": 0.01},
    "sigmoid": {},
    "silu": {},
    "softplus": {},
}
WEIGHTED = ("linear", "conv2d", "layer_norm")


@dataclass(frozen=True, eq=False)
class Layer:
    """One layer: ``linear``, ``conv2d``, ``layer_norm``, ``flatten``, or an activation."""

    kind: str
    """``linear``, ``conv2d``, ``layer_norm``, ``flatten``, ``tanh``, ``relu``, ``elu``, ``leaky_relu``, ``sigmoid``, ``silu`` or ``softplus``."""
    weight: Array | None = field(default=None, repr=False)
    """``linear``: (outputs, inputs); ``conv2d``: (outputs, inputs, height, width); ``layer_norm``: (n,)."""
    bias: Array | None = field(default=None, repr=False)
    """(outputs,)."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """``stride`` and ``padding`` [rows, columns], ``alpha``, ``slope``, ``eps``."""

    def option(self, name: str) -> Any:
        """An option, or its default."""
        return self.options.get(name, KINDS[self.kind][name])


def _weights(layer: Layer, where: str) -> tuple[Array, Array]:
    axes = {"linear": 2, "conv2d": 4, "layer_norm": 1}[layer.kind]
    weight, bias = layer.weight, layer.bias
    if weight is None or bias is None:
        raise ValueError(f"{where}: {layer.kind}: expected a weight and a bias, found {'no weight' if weight is None else 'no bias'}")
    for name, array, n in (("weight", weight, axes), ("bias", bias, 1)):
        if array.dtype != np.float32 or array.ndim != n:
            raise ValueError(f"{where}: {layer.kind}: {name}: expected float32 with {n} axes, found {array.dtype} of shape {array.shape}")
        if not np.isfinite(array).all():
            raise ValueError(f"{where}: {layer.kind}: {name}: expected finite numbers, found NaN or infinity")
    if bias.shape[0] != weight.shape[0]:
        raise ValueError(f"{where}: {layer.kind}: expected a bias of shape ({weight.shape[0]},), found {bias.shape}")
    return weight, bias


def shape_after(layer: Layer, shape: Shape, where: str) -> Shape:
    """Shape of what a layer gives, of one drone; raises where it does not fit."""
    if layer.kind not in KINDS:
        raise ValueError(f"{where}: expected one of the layers {', '.join(KINDS)}, found {layer.kind!r}")
    unknown = set(layer.options) - set(KINDS[layer.kind])
    if unknown:
        raise ValueError(f"{where}: {layer.kind}: expected the options {sorted(KINDS[layer.kind])}, found {sorted(unknown)}")
    if layer.kind == "flatten":
        return (math.prod(shape),)
    if layer.kind not in WEIGHTED:
        return shape
    weight, _ = _weights(layer, where)
    if layer.kind == "conv2d":
        return _convolved(layer, weight, shape, where)
    inputs = weight.shape[-1]
    if shape != (inputs,):
        raise ValueError(f"{where}: {layer.kind}: its weight {weight.shape} takes {inputs} numbers in a row, found the shape {shape}")
    return (weight.shape[0],)


def _convolved(layer: Layer, weight: Array, shape: Shape, where: str) -> Shape:
    if len(shape) != 3 or shape[0] != weight.shape[1]:
        raise ValueError(f"{where}: conv2d: its weight {weight.shape} takes ({weight.shape[1]}, height, width), found the shape {shape}")
    out = []
    for axis in (0, 1):
        kernel, stride, padding = weight.shape[2 + axis], layer.option("stride")[axis], layer.option("padding")[axis]
        if not (isinstance(stride, int) and isinstance(padding, int) and stride >= 1 and 0 <= padding < kernel):
            raise ValueError(f"{where}: conv2d: expected a stride of 1 and more and a padding below {kernel}, found {stride} and {padding}")
        size = (shape[1 + axis] + 2 * padding - kernel) // stride + 1
        if size < 1:
            raise ValueError(f"{where}: conv2d: a kernel of {kernel} is larger than the image, {shape}")
        out.append(size)
    return (weight.shape[0], *out)


def shape_through(layers: Sequence[Layer], shape: Shape, where: str) -> Shape:
    """Shape after all layers."""
    for k, layer in enumerate(layers):
        shape = shape_after(layer, shape, f"{where}[{k}]")
    return shape


def apply(layer: Layer, x: Array) -> Array:
    """What a layer makes of a batch, (n, ...) float32."""
    f = np.float32
    kind = layer.kind
    if kind == "linear":
        assert layer.weight is not None and layer.bias is not None
        return np.asarray(x @ layer.weight.T + layer.bias)
    if kind == "conv2d":
        return _convolve(layer, x)
    if kind == "layer_norm":
        mean = x.mean(axis=-1, keepdims=True)
        spread = np.sqrt(((x - mean) ** 2).mean(axis=-1, keepdims=True) + f(layer.option("eps")))
        return np.asarray((x - mean) / spread * layer.weight + layer.bias)
    if kind == "flatten":
        return x.reshape(len(x), -1)
    if kind == "tanh":
        return np.tanh(x)
    if kind == "relu":
        return np.maximum(x, f(0.0))
    if kind == "elu":
        return np.where(x > 0.0, x, f(layer.option("alpha")) * np.expm1(np.minimum(x, f(0.0))))
    if kind == "leaky_relu":
        return np.where(x > 0.0, x, f(layer.option("slope")) * x)
    if kind == "softplus":
        return np.maximum(x, f(0.0)) + np.log1p(np.exp(-np.abs(x)))
    # 1 / (1 + exp(-x)), which overflows nowhere.
    sigmoid = f(0.5) * (f(1.0) + np.tanh(f(0.5) * x))
    return x * sigmoid if kind == "silu" else sigmoid


def _convolve(layer: Layer, x: Array) -> Array:
    assert layer.weight is not None and layer.bias is not None
    (down, right), (top, left) = layer.option("stride"), layer.option("padding")
    x = np.pad(x, ((0, 0), (0, 0), (top, top), (left, left)))
    out, _, height, width = layer.weight.shape
    windows = np.lib.stride_tricks.sliding_window_view(x, (height, width), axis=(2, 3))[:, :, ::down, ::right]
    n, _, rows, columns = windows.shape[:4]
    flat = windows.transpose(0, 2, 3, 1, 4, 5).reshape(n * rows * columns, -1)
    y = flat @ layer.weight.reshape(out, -1).T + layer.bias
    return np.ascontiguousarray(y.reshape(n, rows, columns, out).transpose(0, 3, 1, 2))
