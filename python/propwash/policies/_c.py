"""Policies as one file of C99."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from .._write import write
from ._inputs import shape_after as step_shape
from ._layers import Layer
from ._layers import shape_after as layer_shape

if TYPE_CHECKING:
    from ._policy import Branch, Policy

Array = NDArray[Any]

_KEYWORDS = set(
    """auto break case char const continue default do double else enum extern float for goto if inline int long register restrict return
    short signed sizeof static struct switch typedef union unsigned void volatile while action main""".split()
)

#: Functions that a file may need. NAME is its prefix.
_FUNCTIONS = {
    "copy": """static void NAME_copy(const float *x, float *y, int n)
{
    for (int i = 0; i < n; i++)
        y[i] = x[i];
}""",
    "take": """static void NAME_take(const float *x, float *y, const int *columns, int n)
{
    for (int i = 0; i < n; i++)
        y[i] = x[columns[i]];
}""",
    "scale": """static void NAME_scale(const float *x, float *y, int n, float offset, float factor)
{
    for (int i = 0; i < n; i++)
        y[i] = (x[i] - offset) * factor;
}""",
    "scale_each": """static void NAME_scale_each(const float *x, float *y, int n, const float *offset, const float *factor)
{
    for (int i = 0; i < n; i++)
        y[i] = (x[i] - offset[i]) * factor[i];
}""",
    "clip": """static void NAME_clip(const float *x, float *y, int n, float low, float high)
{
    for (int i = 0; i < n; i++)
        y[i] = fminf(fmaxf(x[i], low), high);
}""",
    "round": """static void NAME_round(const float *x, float *y, int n)
{
    for (int i = 0; i < n; i++)
        y[i] = rintf(x[i]);
}""",
    "length": """static float NAME_length(const float *x, int n)
{
    float sum = 0.0f;
    for (int i = 0; i < n; i++)
        sum += x[i] * x[i];
    return sqrtf(sum);
}""",
    "tilt": """static void NAME_tilt(const float *q, float *y)
{
    y[0] = 2.0f * (q[0] * q[2] - q[3] * q[1]);
    y[1] = 2.0f * (q[1] * q[2] + q[3] * q[0]);
}""",
    "nearness": """static void NAME_nearness(const float *x, float *y, int n, float near_m, float low, float span)
{
    for (int i = 0; i < n; i++)
        y[i] = fminf(fmaxf((1.0f / fmaxf(x[i], near_m) - low) / span, 0.0f), 1.0f);
}""",
    "pool": """/* Blocks of h x w pixels of images of rows x columns: -1 the least, 0 the mean, 1 the greatest. */
static void NAME_pool(const float *x, float *y, int images, int rows, int columns, int h, int w, int kind)
{
    for (int c = 0; c < images; c++)
        for (int r = 0; r < rows / h; r++)
            for (int s = 0; s < columns / w; s++) {
                const float *block = x + (c * rows + r * h) * columns + s * w;
                float out = kind == 0 ? 0.0f : block[0];
                for (int i = 0; i < h; i++)
                    for (int j = 0; j < w; j++) {
                        const float v = block[i * columns + j];
                        out = kind == 0 ? out + v : kind < 0 ? fminf(out, v) : fmaxf(out, v);
                    }
                *y++ = kind == 0 ? out / (float)(h * w) : out;
            }
}""",
    "linear": """static void NAME_linear(const float *x, float *y, const float *weight, const float *bias, int inputs, int outputs)
{
    for (int o = 0; o < outputs; o++) {
        float sum = bias[o];
        for (int i = 0; i < inputs; i++)
            sum += weight[o * inputs + i] * x[i];
        y[o] = sum;
    }
}""",
    "conv2d": """/* shape: inputs, rows, columns, outputs, kernel h, w, stride down, right, padding top, left, rows and columns after. */
static void NAME_conv2d(const float *x, float *y, const float *weight, const float *bias, const int *shape)
{
    const int inputs = shape[0], rows = shape[1], columns = shape[2], outputs = shape[3], h = shape[4], w = shape[5];
    for (int o = 0; o < outputs; o++)
        for (int r = 0; r < shape[10]; r++)
            for (int s = 0; s < shape[11]; s++) {
                float sum = bias[o];
                for (int c = 0; c < inputs; c++)
                    for (int i = 0; i < h; i++)
                        for (int j = 0; j < w; j++) {
                            const int row = r * shape[6] + i - shape[8], column = s * shape[7] + j - shape[9];
                            if (row >= 0 && row < rows && column >= 0 && column < columns)
                                sum += weight[((o * inputs + c) * h + i) * w + j] * x[(c * rows + row) * columns + column];
                        }
                *y++ = sum;
            }
}""",
    "layer_norm": """static void NAME_layer_norm(const float *x, float *y, const float *weight, const float *bias, int n, float eps)
{
    float mean = 0.0f, spread = 0.0f;
    for (int i = 0; i < n; i++)
        mean += x[i] / (float)n;
    for (int i = 0; i < n; i++)
        spread += (x[i] - mean) * (x[i] - mean) / (float)n;
    spread = sqrtf(spread + eps);
    for (int i = 0; i < n; i++)
        y[i] = (x[i] - mean) / spread * weight[i] + bias[i];
}""",
}
#: Activations of one number x.
_ACTIVATIONS = {
    "tanh": "tanhf(x)",
    "relu": "x > 0.0f ? x : 0.0f",
    "elu": "x > 0.0f ? x : OPTION * expm1f(x)",
    "leaky_relu": "x > 0.0f ? x : OPTION * x",
    "sigmoid": "0.5f * (1.0f + tanhf(0.5f * x))",
    "silu": "x * 0.5f * (1.0f + tanhf(0.5f * x))",
    "softplus": "fmaxf(x, 0.0f) + log1pf(expf(-fabsf(x)))",
}


def _number(value: Any) -> str:
    text = f"{float(np.float32(value)):.9g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"


class _File:
    """Parts of the file while it is built."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.functions: dict[str, str] = {}
        self.constants: list[str] = []
        self.body: list[str] = []
        self.widest = 1
        self.rooms: dict[str, int] = {}
        self.current = ""
        self.size = 0

    def array(self, values: Any, kind: str = "float") -> str:
        flat = np.asarray(values).ravel()
        made = f"{self.name}_k{len(self.constants)}"
        words = [str(int(v)) if kind == "int" else _number(v) for v in flat]
        rows = [", ".join(words[i : i + 10]) for i in range(0, len(words), 10)]
        self.constants.append(f"static const {kind} {made}[{len(words)}] = {{\n    " + ",\n    ".join(rows) + ",\n};")
        return made

    def call(self, function: str, size: int, *arguments: Any, of: str | None = None) -> None:
        """A call that makes ``size`` numbers of the present ones, in the other buffer."""
        self.functions.setdefault(function, _FUNCTIONS[function] if of is None else of)
        to = f"{self.name}_b" if self.current == f"{self.name}_a" else f"{self.name}_a"
        words = ", ".join(str(a) for a in (self.current, to, *arguments))
        self.body.append(f"    {self.name}_{function}({words});")
        self.current, self.size, self.widest = to, size, max(self.widest, size)

    def keep(self, room: str, at: int) -> None:
        """Puts the present numbers where they stay: into a buffer called ``room``."""
        self.rooms[room] = max(self.rooms.get(room, 0), at + self.size)
        self.functions.setdefault("copy", _FUNCTIONS["copy"])
        self.body.append(f"    {self.name}_copy({self.current}, {self.name}_{room} + {at}, {self.size});")

    def step(self, step: Mapping[str, Any], shape: tuple[int, ...]) -> None:
        kind, n = step["step"], self.size
        if kind == "image":
            return
        after = math.prod(step_shape(step, shape, ""))
        if kind == "take":
            self.call("take", after, self.array(step["columns"], "int"), after)
        elif kind == "scale" and np.ndim(step["factor"]) == np.ndim(step["offset"]) == 0:
            self.call("scale", n, n, _number(step["offset"]), _number(step["factor"]))
        elif kind == "scale":
            each = [self.array(np.broadcast_to(np.asarray(step[key], np.float32), shape)) for key in ("offset", "factor")]
            self.call("scale_each", n, n, *each)
        elif kind == "clip":
            self.call("clip", n, n, _number(step["low"]), _number(step["high"]))
        elif kind == "round":
            self.call("round", n, n)
        elif kind == "tilt":
            self.call("tilt", 2)
        elif kind == "nearness":
            low, high = np.float32(1.0 / step["far"]), np.float32(1.0 / step["near"])
            self.call("nearness", n, n, _number(step["near"]), _number(low), _number(high - low))
        elif kind == "pool":
            sign = {"min": -1, "mean": 0, "max": 1}[step["kind"]]
            images = math.prod(shape[:-2])
            self.call("pool", after, images, shape[-2], shape[-1], step["height"], step["width"], sign)
        else:
            self.functions.setdefault("length", _FUNCTIONS["length"])
            if kind == "length":
                one = f"""static void {self.name}_length_of(const float *x, float *y, int n)\n{{\n    y[0] = {self.name}_length(x, n);\n}}"""
                self.call("length_of", 1, n, of=one)
            else:
                words = "    for (int i = 0; i < n; i++)\n        y[i] = x[i] / length;"
                head = f"static void {self.name}_direction(const float *x, float *y, int n, float least)"
                one = f"{head}\n{{\n    const float length = fmaxf({self.name}_length(x, n), least);\n{words}\n}}"
                self.call("direction", n, n, _number(step["least"]), of=one)

    def layers(self, layers: Sequence[Layer], shape: tuple[int, ...]) -> None:
        """Layers, one after the other."""
        for layer in layers:
            self.layer(layer, shape)
            shape = layer_shape(layer, shape, "")

    def layer(self, layer: Layer, shape: tuple[int, ...]) -> None:
        kind, after = layer.kind, layer_shape(layer, shape, "")
        size = math.prod(after)
        if kind == "flatten":
            return
        if kind in _ACTIVATIONS:
            option = {"elu": "alpha", "leaky_relu": "slope"}.get(kind)
            body = _ACTIVATIONS[kind].replace("OPTION", "option")
            head = f"static void {self.name}_{kind}(const float *v, float *y, int n{', float option' if option else ''})"
            loop = f"    for (int i = 0; i < n; i++) {{\n        const float x = v[i];\n        y[i] = {body};\n    }}"
            self.call(kind, size, size, *([_number(layer.option(option))] if option else []), of=f"{head}\n{{\n{loop}\n}}")
            return
        weight, bias = self.array(layer.weight), self.array(layer.bias)
        if kind == "linear":
            self.call("linear", size, weight, bias, shape[0], size)
        elif kind == "layer_norm":
            self.call("layer_norm", size, weight, bias, size, _number(layer.option("eps")))
        else:
            assert layer.weight is not None
            numbers = [*shape, layer.weight.shape[0], *layer.weight.shape[2:], *layer.option("stride"), *layer.option("padding"), *after[1:]]
            self.call("conv2d", size, weight, bias, self.array(numbers, "int"))


def _branch(made: _File, branch: Branch, arguments: Mapping[str, str], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """The calls of a branch; its result is the present numbers."""
    seen = 0
    shape: tuple[int, ...] = (0,)
    for given in branch.inputs:
        shape = shapes[given.channel]
        made.current, made.size = arguments[given.channel], math.prod(shape)
        for step in given.steps:
            made.step(step, shape)
            shape = step_shape(step, shape, "")
        if len(branch.inputs) > 1:
            made.keep("seen", seen)
            seen += made.size
    if len(branch.inputs) > 1:
        shape, made.current, made.size = (seen,), f"{made.name}_seen", seen
    made.layers(branch.layers, shape)


def write_c(policy: Policy, path: str | os.PathLike[str], name: str, force: bool) -> None:
    """Writes the file."""
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_]*", name) or name in _KEYWORDS:
        raise ValueError(f"name: expected a name of C that is no keyword, got {name!r}")
    arguments = {channel.name: _argument(channel.name, name) for channel in policy.observation}
    if len(set(arguments.values())) < len(arguments):
        raise ValueError(f"observation: expected channels whose names differ in C, found {', '.join(arguments)}")
    made = _File(name)
    shapes = {channel.name: channel.shape for channel in policy.observation}
    joined = 0
    for branch in policy.branches:
        _branch(made, branch, arguments, shapes)
        if len(policy.branches) > 1:
            made.keep("joined", joined)
            joined += made.size
    if len(policy.branches) > 1:
        made.current, made.size = f"{name}_joined", joined
    made.layers(policy.layers, (made.size,))
    write(path, _text(made, policy, arguments), force)


def _argument(channel: str, name: str) -> str:
    """Name of the argument of a channel."""
    word = re.sub(r"\W", "_", channel, flags=re.ASCII)
    word = word if re.match("[A-Za-z]", word) else f"in_{word}"
    return f"{word}_in" if word in _KEYWORDS or word == name or word.startswith(f"{name}_") else word


def _last(made: _File, policy: Policy) -> str:
    """The lines that give the action."""
    n = len(policy.action.low)
    line = {"none": "x[i]", "clip": "fminf(fmaxf(x[i], low[i]), high[i])", "tanh": "low[i] + 0.5f * (tanhf(x[i]) + 1.0f) * (high[i] - low[i])"}
    limits = ""
    if policy.action.limit != "none":
        low, high = ("{" + ", ".join(_number(v) for v in a) + "}" for a in (policy.action.low, policy.action.high))
        limits = f"    static const float low[{n}] = {low};\n    static const float high[{n}] = {high};\n"
    loop = f"    for (int i = 0; i < {n}; i++)\n        action[i] = {line[policy.action.limit]};\n"
    head = f"static void {made.name}_act(const float *x, float *action)"
    return f"{head}\n{{\n{limits}{loop}}}"


def _text(made: _File, policy: Policy, arguments: Mapping[str, str]) -> str:
    name = made.name
    told = policy.describe().replace("*/", "* /").replace("/*", "/ *").splitlines()
    sizes = {channel.name: channel.size for channel in policy.observation}
    declared = ", ".join(f"const float {word}[{sizes[channel]}]" for channel, word in arguments.items())
    head = f"void {name}({declared}, float action[{len(policy.action.low)}])"
    comment = [
        f"A policy, exported by Propwash {__version__}. C99 and libm, nothing else.", "", f"    {head};", "",
        "Arguments are the channels below in SI units, as the environment gives them; images row by row. The buffers are static: one call at a time.",
        "", *told,
    ]  # fmt: skip
    rooms = {"a": made.widest, "b": made.widest, **made.rooms}
    buffers = [f"static float {name}_{key}[{size}];" for key, size in rooms.items() if any(f"{name}_{key}" in line for line in made.body)]
    functions = [text.replace("NAME", name) for text in made.functions.values()]
    functions.append(_last(made, policy))
    parts = [
        "/*\n" + "\n".join(f" * {line}".rstrip() for line in comment) + "\n */",
        "#include <math.h>",
        *made.constants,
        "\n".join(buffers),
        *functions,
        f"{head};",
        head + "\n{\n" + "\n".join([*made.body, f"    {name}_act({made.current}, action);"]) + "\n}",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"
