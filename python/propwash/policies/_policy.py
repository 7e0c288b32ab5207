"""A trained policy: what it observes, its network, what its actions mean, where it was trained."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _inputs, _layers
from ._inputs import Channel, Input
from ._layers import Layer

Array = NDArray[Any]

#: What each number of an action is, by the kind of action.
ACTION_NAMES: dict[str, tuple[str, ...]] = {
    "attitude": ("roll", "pitch", "yaw", "thrust"),
    "body_rate": ("roll rate", "pitch rate", "yaw rate", "thrust"),
    "force_torque": ("force", "torque x", "torque y", "torque z"),
    "velocity": ("forward", "left", "up", "yaw rate"),
}


@dataclass(frozen=True, eq=False)
class Branch:
    """A part of the network: inputs side by side, and layers over them. A branch that begins with ``conv2d`` has one input, an image."""

    inputs: tuple[Input, ...]
    layers: tuple[Layer, ...] = ()


@dataclass(frozen=True, eq=False)
class ActionSpec:
    """What the numbers that a policy gives mean."""

    kind: str
    """``attitude``, ``body_rate``, ``force_torque``, ``rotor_vel`` or ``velocity``, as ``action=`` of the environment."""
    low: Array = field(repr=False)
    """Least of each number, (n,)."""
    high: Array = field(repr=False)
    """Greatest of each number, (n,)."""
    limit: Literal["clip", "tanh", "none"] = "clip"
    """What is done with the numbers of the network: they are held within ``low`` and ``high``; or their ``tanh`` is stretched from ``low`` to
    ``high``; or nothing."""
    normalized: bool = True
    """Whether they run from -1 to 1 and 0 hovers; else they are in SI units."""
    step_hz: int = 50
    """Actions per second."""

    @property
    def names(self) -> tuple[str, ...]:
        """What each number is."""
        return ACTION_NAMES.get(self.kind) or tuple(f"rotor {k}" for k in range(len(self.low)))


@dataclass(frozen=True, eq=False)
class Policy:
    """A trained policy with the description of what it observes and of what its actions mean. Needs nothing but NumPy.

    ``from_torch`` and ``from_sb3`` make one; ``save`` and ``Policy.load`` keep it in one file; ``to_onnx`` and ``to_c`` export it;
    ``propwash.evaluate`` flies it. Calling it gives actions: ``policy(obs)`` takes observations of an environment as they are, without
    wrappers (but ``DepthFrameStack`` where it was trained with that): scales and limits of the inputs are part of the policy.
    """

    observation: tuple[Channel, ...]
    """Channels that it sees, sorted by name, as ``FlattenState`` does."""
    branches: tuple[Branch, ...] = field(repr=False)
    """Parts of the network, whose results stand side by side before ``layers``."""
    layers: tuple[Layer, ...] = field(repr=False)
    """Layers after the branches; the last gives the action."""
    action: ActionSpec
    """What its actions mean."""
    trained: Mapping[str, Any] = field(default_factory=dict, repr=False)
    """Where it was trained: ``environment`` (id), ``config`` (of the environment, complete), ``task_options``, ``propwash`` (version), ``note``."""

    def __post_init__(self) -> None:
        names = [channel.name for channel in self.observation]
        if names != sorted(set(names)) or not names:
            raise ValueError(f"observation: expected channels sorted by name, each once, found {names}")
        shapes = {channel.name: channel.shape for channel in self.observation}
        width = 0
        seen = set()
        for b, branch in enumerate(self.branches):
            shape = _shape_of_branch(branch, shapes, f"branches[{b}]")
            seen |= {given.channel for given in branch.inputs}
            if len(shape) != 1:
                raise ValueError(f"branches[{b}]: expected numbers in a row at its end, found the shape {shape}: add a layer flatten")
            width += shape[0]
        unused = sorted(set(names) - seen)
        if unused:
            raise ValueError(f"observation: expected channels that some input uses, found {', '.join(unused)}, which none does")
        out = _layers.shape_through(self.layers, (width,), "layers")
        if out != self.action.low.shape or out != self.action.high.shape:
            raise ValueError(f"action: expected {self.action.low.shape[0]} numbers ({', '.join(self.action.names)}), the network gives {out}")
        low, high = self.action.low, self.action.high
        if self.action.limit != "none" and not (np.isfinite(low).all() and np.isfinite(high).all() and (low < high).all()):
            raise ValueError(f"action: expected finite numbers low < high, found {low.tolist()} and {high.tolist()}")
        if self.action.step_hz < 1:
            raise ValueError(f"action: step_hz: expected at least 1, found {self.action.step_hz}")
        if self.action.limit not in ("clip", "tanh", "none"):
            raise ValueError(f'action: limit: expected "clip", "tanh" or "none", found {self.action.limit!r}')

    @property
    def columns(self) -> dict[str, slice]:
        """Where the numbers of each channel but ``depth`` stand in a flat array, as ``FlattenState.columns`` says it."""
        out, start = {}, 0
        for channel in self.observation:
            if channel.name != "depth":
                out[channel.name] = slice(start, start + channel.size)
                start += channel.size
        return out

    def __call__(self, obs: Mapping[str, ArrayLike] | ArrayLike) -> NDArray[np.float32]:
        """Actions for observations.

        Args:
            obs: Observations of an environment by name, each (..., shape of its channel); channels that the policy does not use may
                stand among them. A policy that sees no depth also takes one array (..., n), whose columns are ``columns``.

        Returns:
            (..., numbers of an action), float32.
        """
        head, rows = self._rows(obs)
        parts = []
        for branch in self.branches:
            given = [_inputs.apply(one, rows[one.channel]) for one in branch.inputs]
            x = given[0] if len(given) == 1 else np.concatenate([one.reshape(len(one), -1) for one in given], axis=1)
            for layer in branch.layers:
                x = _layers.apply(layer, x)
            parts.append(x)
        y = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        for layer in self.layers:
            y = _layers.apply(layer, y)
        low, high = self.action.low, self.action.high
        if self.action.limit == "clip":
            y = np.clip(y, low, high)
        elif self.action.limit == "tanh":
            y = low + np.float32(0.5) * (np.tanh(y) + np.float32(1.0)) * (high - low)
        return np.asarray(y, np.float32).reshape(*head, len(low))

    def _rows(self, obs: Mapping[str, ArrayLike] | ArrayLike) -> tuple[tuple[int, ...], dict[str, Array]]:
        """The axes before those of the channels, and a batch (n, ...) of each channel."""
        named = obs if isinstance(obs, Mapping) else self._parted(np.asarray(obs))
        out: dict[str, Array] = {}
        head: tuple[int, ...] | None = None
        for channel in self.observation:
            if channel.name not in named:
                raise ValueError(f"{channel.name}: expected this channel in the observation, found {', '.join(map(str, named))}")
            array = np.asarray(named[channel.name])
            if array.dtype.kind not in "fiu":
                raise TypeError(f"{channel.name}: expected real numbers, found {array.dtype}")
            axes = array.ndim - len(channel.shape)
            if axes < 0 or array.shape[axes:] != channel.shape:
                more = "; stack that many images by propwash.envs.DepthFrameStack" if channel.frames > 1 else ""
                raise ValueError(f"{channel.name}: expected shape (..., {', '.join(map(str, channel.shape))}), found {array.shape}{more}")
            if head is None:
                head = array.shape[:axes]
            elif array.shape[:axes] != head:
                raise ValueError(f"{channel.name}: expected {head} before the shape of the channel as the others have, found {array.shape[:axes]}")
            out[channel.name] = array.astype(np.float32, copy=False).reshape(-1, *channel.shape)
        assert head is not None
        return head, out

    def _parted(self, flat: Array) -> dict[str, Array]:
        if any(channel.name == "depth" for channel in self.observation):
            raise TypeError("obs: expected a dict of observations: this policy sees depth")
        columns = self.columns
        width = sum(channel.size for channel in self.observation)
        if flat.ndim == 0 or flat.shape[-1] != width:
            where = ", ".join(f"{name} {part.start} to {part.stop - 1}" for name, part in columns.items())
            raise ValueError(f"obs: expected a dict, or an array (..., {width}) with the columns {where}; found shape {flat.shape}")
        shapes = {channel.name: channel.shape for channel in self.observation}
        return {name: flat[..., part].reshape(*flat.shape[:-1], *shapes[name]) for name, part in columns.items()}

    def describe(self) -> str:
        """What it sees, its network and its actions, in lines of text."""
        lines = []
        if self.trained.get("environment"):
            lines.append(f"Trained in {self.trained['environment']} with Propwash {self.trained.get('propwash')}.")
        if self.trained.get("note"):
            lines.append(str(self.trained["note"]))
        lines.append("Observed:")
        for channel in self.observation:
            frames = f", the last {channel.frames} images, oldest first" if channel.frames > 1 else ""
            lines.append(f"  {channel.name} ({', '.join(map(str, channel.shape))}){_UNITS.get(channel.name, '')}{frames}")
        lines.append("Inputs of the network, in order:")
        for b, branch in enumerate(self.branches):
            lines += [f"  {_inputs.in_words(given)}" for given in branch.inputs]
            if branch.layers:
                lines.append(f"  layers of these: {_layer_words(branch.layers)}")
        lines.append(f"Layers: {_layer_words(self.layers)}")
        unit = "-1 to 1, where 0 hovers" if self.action.normalized else "SI units"
        lines.append(f"Action, {self.action.step_hz} times a second: {self.action.kind} ({unit}); limit: {self.action.limit}")
        for name, low, high in zip(self.action.names, self.action.low, self.action.high, strict=True):
            lines.append(f"  {name}: {low:.6g} to {high:.6g}")
        return "\n".join(lines)

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> None:
        """Writes it to one file (.npz: ``policy.json``, and an array for each weight), which ``Policy.load`` reads.

        Raises:
            FileExistsError: where a file is there already, without ``force``.
        """
        from ._file import save

        save(self, path, force)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Policy:
        """Reads what ``save`` wrote.

        Raises:
            ValueError: for a file that is broken or no policy, saying where and why.
        """
        from ._file import load

        return load(path)

    @classmethod
    def from_torch(
        cls,
        module: Any,
        env: Any,
        inputs: Sequence[Input] | None = None,
        *,
        branches: Sequence[tuple[Sequence[Input], Any]] = (),
        limit: Literal["clip", "tanh", "none"] = "clip",
        note: str = "",
    ) -> Policy:
        """A policy of PyTorch.

        Args:
            module: A ``torch.nn.Sequential`` (or one layer) that gives the action: of ``Linear``, ``Conv2d``, ``LayerNorm``, ``Flatten``,
                ``Tanh``, ``ReLU``, ``ELU``, ``LeakyReLU``, ``Sigmoid``, ``SiLU``, ``Softplus``; ``Identity`` and ``Dropout`` do nothing.
            env: The environment that it was trained in, a vector or a single one.
            inputs: What the network sees, side by side. None: what ``env`` with its wrappers observes.
            branches: More parts before ``module``, as ``(inputs, module)``, whose results stand side by side after ``inputs``.
            limit: As ``ActionSpec.limit``.
            note: Anything that is worth keeping.
        """
        from ._convert import from_torch

        return from_torch(module, env, inputs, branches, limit, note)

    @classmethod
    def from_sb3(cls, model: Any, env: Any = None, *, note: str = "") -> Policy:
        """The deterministic policy of a model of Stable-Baselines3: ``PPO``, ``A2C``, ``SAC``, ``TD3``, ``DDPG`` with ``MlpPolicy``, ``CnnPolicy``
        or ``MultiInputPolicy``, with the statistics of ``VecNormalize``.

        Args:
            model: The model.
            env: The environment it was trained in, a ``SB3VecEnv`` with wrappers; None is that of the model.
            note: Anything that is worth keeping.
        """
        from ._convert import from_sb3

        return from_sb3(model, env, note)

    def to_onnx(self, path: str | os.PathLike[str], *, force: bool = False) -> None:
        """Writes it as ONNX (opset 17): an input for each channel, float32 (batch, shape); the output ``action`` (batch, n). The description stands
        in the metadata as ``propwash``. Needs ``onnx`` (``pip install 'propwash[onnx]'``)."""
        from ._onnx import write_onnx

        write_onnx(self, path, force)

    def to_c(self, path: str | os.PathLike[str], *, name: str = "policy", force: bool = False) -> None:
        """Writes it as one file of C99 that needs nothing but libm.

        It defines ``void NAME(const float CHANNEL[...], ..., float action[...])``, one argument for each channel in the order of
        ``observation``, images in rows. Its buffers are static: one call at a time.

        Args:
            path: Of the file.
            name: Of the function, and prefix of all else in the file.
            force: Write over a file that is there.
        """
        from ._c import write_c

        write_c(self, path, name, force)


_UNITS = {
    "pos": " m, world",
    "quat": " x y z w, body to world",
    "vel": " m/s, world",
    "ang_vel": " rad/s, body",
    "vel_heading": " m/s, forward, left, up",
    "goal": " m, forward, left, up",
    "difference_to_goal": " m, world",
    "difference_to_target_vel": " m/s, world",
    "local_samples": " m, world",
    "depth": " m, rows from above",
}


def _layer_words(layers: Sequence[Layer]) -> str:
    words = []
    for layer in layers:
        shape = "" if layer.weight is None else " x ".join(map(str, layer.weight.shape))
        words.append(f"{layer.kind}({shape})" if shape else layer.kind)
    return ", ".join(words) or "none"


def _shape_of_branch(branch: Branch, shapes: Mapping[str, tuple[int, ...]], where: str) -> tuple[int, ...]:
    if not branch.inputs:
        raise ValueError(f"{where}: expected at least one input, found none")
    after = []
    for i, given in enumerate(branch.inputs):
        if given.channel not in shapes:
            raise ValueError(f"{where}.inputs[{i}]: expected one of the channels {', '.join(shapes)}, found {given.channel!r}")
        after.append(_inputs.shape_of(given, shapes[given.channel], f"{where}.inputs[{i}]"))
    shape = after[0] if len(after) == 1 else (sum(math.prod(one) for one in after),)
    return _layers.shape_through(branch.layers, shape, f"{where}.layers")
