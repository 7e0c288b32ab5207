"""Policies as ONNX."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from .._optional import need
from .._write import may_write, write_bytes
from ._file import description
from ._layers import Layer

if TYPE_CHECKING:
    from ._policy import Policy

OPSET = 17


class _Graph:
    """Nodes and constants of a graph; every method adds nodes and gives the name of what they make."""

    def __init__(self) -> None:
        from onnx import helper, numpy_helper  # type: ignore[import-not-found,unused-ignore]

        self.helper, self.numpy_helper = helper, numpy_helper
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, value: Any, dtype: Any = np.float32) -> str:
        name = f"/c{len(self.constants)}"
        self.constants.append(self.numpy_helper.from_array(np.asarray(value, dtype), name))
        return name

    def add(self, kind: str, *inputs: str, out: str | None = None, **attributes: Any) -> str:
        made = out or f"/x{len(self.nodes)}"
        self.nodes.append(self.helper.make_node(kind, list(inputs), [made], **attributes))
        return made

    def clip(self, x: str, low: Any, high: Any) -> str:
        return self.add("Min", self.add("Max", x, self.constant(low)), self.constant(high))

    def step(self, step: Mapping[str, Any], x: str, axes: int) -> str:
        """A step of an input; ``axes``: those of the input without that of the batch."""
        kind = step["step"]
        if kind == "take":
            return self.add("Gather", x, self.constant(step["columns"], np.int64), axis=1)
        if kind == "scale":
            return self.add("Mul", self.add("Sub", x, self.constant(step["offset"])), self.constant(step["factor"]))
        if kind == "clip":
            return self.clip(x, step["low"], step["high"])
        if kind == "round":
            return self.add("Round", x)
        if kind in ("direction", "length"):
            length = self.add("ReduceL2", x, axes=[1], keepdims=1)
            return length if kind == "length" else self.add("Div", x, self.add("Max", length, self.constant(step["least"])))
        if kind == "tilt":
            # 2 (xz - wy) and 2 (yz + wx), as products of columns.
            a, b, c, d = (self.add("Gather", x, self.constant(k, np.int64), axis=1) for k in ([0, 1], [2], [3], [1, 0]))
            signs = self.constant([-2.0, 2.0])
            first = self.add("Mul", self.add("Mul", a, b), self.constant(2.0))
            return self.add("Add", first, self.add("Mul", self.add("Mul", d, c), signs))
        if kind == "nearness":
            low, high = np.float32(1.0 / step["far"]), np.float32(1.0 / step["near"])
            inverse = self.add("Reciprocal", self.add("Max", x, self.constant(step["near"])))
            return self.clip(self.add("Div", self.add("Sub", inverse, self.constant(low)), self.constant(high - low)), 0.0, 1.0)
        if kind == "image":
            return self.add("Unsqueeze", x, self.constant([1], np.int64))
        return self._pool(step, x, axes)

    def _pool(self, step: Mapping[str, Any], x: str, axes: int) -> str:
        sides = [step["height"], step["width"]]
        if axes == 2:  # ONNX pools images with an axis of channels
            x = self.add("Unsqueeze", x, self.constant([1], np.int64))
        if step["kind"] == "mean":
            x = self.add("AveragePool", x, kernel_shape=sides, strides=sides)
        else:
            x = x if step["kind"] == "max" else self.add("Neg", x)
            x = self.add("MaxPool", x, kernel_shape=sides, strides=sides)
            x = x if step["kind"] == "max" else self.add("Neg", x)
        return self.add("Squeeze", x, self.constant([1], np.int64)) if axes == 2 else x

    def layer(self, layer: Layer, x: str) -> str:
        kind = layer.kind
        if kind in ("linear", "conv2d", "layer_norm"):
            weight, bias = self.constant(layer.weight), self.constant(layer.bias)
            if kind == "linear":
                return self.add("Gemm", x, weight, bias, transB=1)
            if kind == "layer_norm":
                return self.add("LayerNormalization", x, weight, bias, axis=-1, epsilon=layer.option("eps"))
            top, left = layer.option("padding")
            return self.add("Conv", x, weight, bias, strides=layer.option("stride"), pads=[top, left, top, left])
        if kind == "flatten":
            return self.add("Flatten", x)
        if kind == "silu":
            return self.add("Mul", x, self.add("Sigmoid", x))
        if kind == "elu":
            return self.add("Elu", x, alpha=layer.option("alpha"))
        if kind == "leaky_relu":
            return self.add("LeakyRelu", x, alpha=layer.option("slope"))
        return self.add({"tanh": "Tanh", "relu": "Relu", "sigmoid": "Sigmoid", "softplus": "Softplus"}[kind], x)


def _built(policy: Policy) -> _Graph:
    """The nodes of a policy, whose last gives ``action``."""
    graph = _Graph()
    axes = {channel.name: len(channel.shape) for channel in policy.observation}
    parts = []
    for branch in policy.branches:
        given = []
        for one in branch.inputs:
            x, images = one.channel, axes[one.channel]
            for step in one.steps:
                x = graph.step(step, x, images)
                images += step["step"] == "image"
            if len(branch.inputs) > 1:
                x = graph.add("Flatten", x)
            given.append(x)
        x = given[0] if len(given) == 1 else graph.add("Concat", *given, axis=1)
        for layer in branch.layers:
            x = graph.layer(layer, x)
        parts.append(x)
    y = parts[0] if len(parts) == 1 else graph.add("Concat", *parts, axis=1)
    for layer in policy.layers:
        y = graph.layer(layer, y)
    low, high = policy.action.low, policy.action.high
    if policy.action.limit == "clip":
        y = graph.clip(y, low, high)
    elif policy.action.limit == "tanh":
        unit = graph.add("Add", graph.add("Tanh", y), graph.constant(1.0))
        y = graph.add("Add", graph.add("Mul", unit, graph.constant(np.float32(0.5) * (high - low))), graph.constant(low))
    graph.add("Identity", y, out="action")
    return graph


def write_onnx(policy: Policy, path: str | os.PathLike[str], force: bool) -> None:
    """Writes the model."""
    may_write(path, force)
    if any(c.name == "action" for c in policy.observation):
        raise ValueError('observation: a channel is called "action", as the output of the model is: give the channel another name')
    onnx = need("onnx", "onnx", "Policy.to_onnx")
    graph = _built(policy)
    number = onnx.TensorProto.FLOAT
    inputs = [onnx.helper.make_tensor_value_info(c.name, number, ["batch", *c.shape]) for c in policy.observation]
    output = onnx.helper.make_tensor_value_info("action", number, ["batch", len(policy.action.low)])
    body = onnx.helper.make_graph(graph.nodes, "policy", inputs, [output], graph.constants, doc_string=policy.describe())
    model = onnx.helper.make_model(body, opset_imports=[onnx.helper.make_opsetid("", OPSET)], producer_name="propwash")
    model.ir_version = 8
    onnx.helper.set_model_props(model, {"propwash": json.dumps(description(policy))})
    onnx.checker.check_model(model, full_check=True)
    write_bytes(path, model.SerializeToString(), force)
