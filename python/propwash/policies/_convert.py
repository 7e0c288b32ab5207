"""Policies of PyTorch and of Stable-Baselines3. Neither is imported: what their objects say of themselves is read."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ._inputs import Channel, Input, shape_of
from ._layers import Layer
from ._policy import ActionSpec, Branch, Policy

Array = NDArray[Any]


def from_torch(
    module: Any,
    env: Any,
    inputs: Sequence[Input] | None,
    branches: Sequence[tuple[Sequence[Input], Any]],
    limit: Literal["clip", "tanh", "none"],
    note: str,
) -> Policy:
    """See ``Policy.from_torch``."""
    seen = Seen(env)
    made = []
    if inputs is None and not branches:
        inputs = [one for part in seen.parts.values() for one in part]
    if inputs:
        made.append(Branch(tuple(inputs)))
    made += [Branch(tuple(given), _layers_of(net, f"branches[{b}]")) for b, (given, net) in enumerate(branches)]
    layers = _layers_of(module, "module")
    _known(seen, made)
    if len(made) == 1 and not made[0].layers:
        made, layers = _image_first(made[0], layers, seen)
    return _assemble(seen, made, layers, limit, note)


def _image_first(branch: Branch, layers: tuple[Layer, ...], seen: Seen) -> tuple[list[Branch], tuple[Layer, ...]]:
    """A network that begins with an image: its layers up to the flat ones belong to the branch."""
    flat = next((k for k, layer in enumerate(layers) if layer.kind == "flatten"), None)
    if len(branch.inputs) == 1 and flat is not None:
        return [Branch(branch.inputs, layers[: flat + 1])], layers[flat + 1 :]
    if len(branch.inputs) == 1 and len(shape_of(branch.inputs[0], seen.shapes[branch.inputs[0].channel], "inputs")) > 1:
        return [Branch(branch.inputs, (Layer("flatten"),))], layers
    return [branch], layers


def _known(seen: Seen, branches: Sequence[Branch]) -> set[str]:
    """The channels that branches use, which the environment must have."""
    used = {given.channel for branch in branches for given in branch.inputs}
    unknown = used - set(seen.shapes)
    if unknown:
        raise ValueError(f"inputs: expected channels of the environment ({', '.join(seen.shapes)}), got {', '.join(sorted(unknown))}")
    return used


def _assemble(
    seen: Seen, branches: Sequence[Branch], layers: Sequence[Layer], limit: Literal["clip", "tanh", "none"], note: str
) -> Policy:
    used = _known(seen, branches)
    channels = tuple(
        Channel(name, seen.shapes[name], seen.frames if name == "depth" else 1) for name in sorted(used)
    )
    return Policy(channels, tuple(branches), tuple(layers), seen.action(limit), seen.trained(note))


class Seen:
    """What an environment with its wrappers observes, in terms of what it observes without them."""

    def __init__(self, env: Any) -> None:
        from ..envs import DroneEnv, DroneVectorEnv

        wrappers = []
        inner: Any = env
        while not isinstance(inner, (DroneEnv, DroneVectorEnv)):
            if not hasattr(inner, "env"):
                raise TypeError(f"env: expected an environment of propwash.envs, got {type(inner).__name__}")
            wrappers.append(inner)
            inner = inner.env
        #: The environment itself.
        self.base: Any = inner.batch if isinstance(inner, DroneEnv) else inner
        spec: Any = getattr(inner, "spec", None)
        self._id = None if spec is None else spec.id
        self._options = {} if spec is None else dict(spec.kwargs)
        head = 1 if self.base.n_drones > 1 else 0
        space: Any = self.base.single_observation_space
        #: Shape of each channel of one drone, with the images that are stacked.
        self.shapes: dict[str, tuple[int, ...]] = {
            name: tuple(box.shape[head:]) for name, box in space.spaces.items()
        }
        self.frames = 1
        #: What stands in the observation, by name: inputs side by side. ``""``: the observation is an array.
        self.parts: dict[str, list[Input]] = {name: [Input(name)] for name in self.shapes}
        for wrapper in reversed(wrappers):
            self._wrap(wrapper)

    def _wrap(self, wrapper: Any) -> None:
        from .. import envs

        name = type(wrapper).__name__
        if isinstance(wrapper, envs.FlattenState):
            flat = [one for key, part in self.parts.items() if key != "depth" for one in part]
            self.parts = {"depth": self.parts["depth"], "state": flat} if "depth" in self.parts else {"": flat}
            return
        if isinstance(wrapper, envs.DepthFrameStack):
            if any(step["step"] == "image" for one in self.parts.get("depth", []) for step in one.steps):
                raise TypeError("env: expected DepthFrameStack before DepthImage, got it around that")
            self.frames = int(wrapper._n)
            self.shapes["depth"] = (self.frames, *self.shapes["depth"])
            return
        if isinstance(wrapper, envs.NormalizeDepth):
            near, far = float(wrapper._near), float(wrapper._far)
            inverse = wrapper._inverse

            def change(x: Input) -> Input:
                return x.nearness(near, far) if inverse else x.scale(1.0 / far).clip(0.0, 1.0)

        elif isinstance(wrapper, envs.ToF8x8):
            space: Any = wrapper.env.single_observation_space
            height, width = space.spaces["depth"].shape[-2:]
            kind = wrapper._reduce

            def change(x: Input) -> Input:
                return x.pool(height // 8, width // 8, kind)

        elif isinstance(wrapper, envs.DepthImage):
            far = wrapper.far
            one_frame = self.frames == 1

            def change(x: Input) -> Input:
                x = x.scale(255.0 / far).clip(0.0, 255.0).round()
                return x.image() if one_frame else x

            if wrapper._only:
                self.parts = {"": self.parts["depth"]}
        elif name in ("RecordEpisodeStatistics", "RecordVideo", "OrderEnforcing", "PassiveEnvChecker", "NumpyToTorch"):
            return
        else:
            raise TypeError(
                f"env: a policy keeps what these wrappers do: DepthFrameStack, DepthImage, FlattenState, NormalizeDepth, ToF8x8; got {name}: "
                "state by Policy.from_torch(…, inputs=…), with the environment without that wrapper, what the network sees"
            )
        for key in ("depth", ""):
            if key in self.parts and (key == "depth" or self.parts[key][0].channel == "depth"):
                self.parts[key] = [change(one) for one in self.parts[key]]

    def action(self, limit: Literal["clip", "tanh", "none"]) -> ActionSpec:
        """What actions of the environment mean."""
        config = self.base.config
        space = self.base.single_action_space
        low, high = (np.asarray(a, np.float32).reshape(-1, np.shape(a)[-1])[0] for a in (space.low, space.high))
        if not (np.isfinite(low).all() and np.isfinite(high).all()) and limit != "none":
            raise ValueError(f'limit: expected "none": the action space of the environment has no limits, got {limit!r}')
        return ActionSpec(config["action"]["kind"], low, high, limit, bool(config["action"]["normalized"]), int(config["step_hz"]))

    def trained(self, note: str) -> dict[str, Any]:
        """Where a policy was trained in it."""
        out: dict[str, Any] = {"environment": self._id, "propwash": __version__, "config": self.base.config}
        if out["config"]["task"].get("kind") == "own" and self._options.get("task_options"):
            try:
                out["task_options"] = json.loads(json.dumps(self._options["task_options"]))
            except (TypeError, ValueError):
                pass  # evaluate() asks for them
        if note:
            out["note"] = note
        return out


_ACTIVATIONS = {"Tanh": "tanh", "ReLU": "relu", "Sigmoid": "sigmoid", "SiLU": "silu"}


def _layers_of(module: Any, where: str) -> tuple[Layer, ...]:
    """Layers of a module of PyTorch."""
    name = type(module).__name__
    if name == "Sequential":
        return tuple(layer for k, part in enumerate(module) for layer in _layers_of(part, f"{where}[{k}]"))
    if name in ("Identity", "Dropout"):
        return ()
    if name in _ACTIVATIONS:
        return (Layer(_ACTIVATIONS[name]),)
    if name == "ELU":
        return (Layer("elu", options={"alpha": float(module.alpha)}),)
    if name == "LeakyReLU":
        return (Layer("leaky_relu", options={"slope": float(module.negative_slope)}),)
    if name == "Softplus" and float(module.beta) == 1.0:
        return (Layer("softplus"),)
    if name == "Flatten" and (module.start_dim, module.end_dim) == (1, -1):
        return (Layer("flatten"),)
    if name == "Linear":
        return (Layer("linear", _array(module.weight), _bias(module)),)
    if name == "LayerNorm" and len(module.normalized_shape) == 1 and module.weight is not None:
        return (Layer("layer_norm", _array(module.weight), _bias(module), {"eps": float(module.eps)}),)
    if name == "Conv2d":
        return (_convolution(module, where),)
    raise TypeError(
        f"{where}: expected a Sequential of Linear, Conv2d, LayerNorm (of one axis), Flatten, Tanh, ReLU, ELU, LeakyReLU, Sigmoid, SiLU, Softplus, "
        f"got {module!r}"
    )


def _convolution(module: Any, where: str) -> Layer:
    odd = tuple(module.dilation) != (1, 1) or module.groups != 1 or module.padding_mode != "zeros" or isinstance(module.padding, str)
    if odd:
        raise TypeError(f"{where}: expected a Conv2d with dilation 1, one group, zeros and numbers as padding, got {module!r}")
    options = {"stride": [int(n) for n in module.stride], "padding": [int(n) for n in module.padding]}
    return Layer("conv2d", _array(module.weight), _bias(module), options)


def _array(tensor: Any) -> Array:
    return np.ascontiguousarray(tensor.detach().cpu().numpy(), np.float32)


def _bias(module: Any) -> Array:
    return np.zeros(module.weight.shape[0], np.float32) if module.bias is None else _array(module.bias)


def from_sb3(model: Any, env: Any, note: str) -> Policy:
    """See ``Policy.from_sb3``."""
    env = model.get_env() if env is None else env
    if env is None:
        raise TypeError("env: expected the environment that the model was trained in; the model has none")
    seen, statistics = _of_sb3(env)
    policy = model.policy
    if hasattr(policy, "mlp_extractor"):
        # PPO, A2C: a normal distribution whose mean is the action.
        extractor = policy.pi_features_extractor if hasattr(policy, "pi_features_extractor") else policy.features_extractor
        if type(policy.action_dist).__name__ not in ("DiagGaussianDistribution", "StateDependentNoiseDistribution"):
            raise TypeError(f"model: expected a policy of continuous actions, got one with {type(policy.action_dist).__name__}")
        layers = [*_layers_of(policy.mlp_extractor.policy_net, "policy_net"), *_layers_of(policy.action_net, "action_net")]
        limit: Literal["clip", "tanh", "none"] = "tanh" if policy.squash_output else "clip"
        if limit == "tanh" and type(policy.action_dist).__name__ == "StateDependentNoiseDistribution" and not policy.action_dist.squash_output:
            limit = "clip"
    elif hasattr(policy, "actor"):
        extractor = policy.actor.features_extractor
        if hasattr(policy.actor, "latent_pi"):
            layers = [*_layers_of(policy.actor.latent_pi, "latent_pi"), *_layers_of(policy.actor.mu, "mu")]
        else:
            layers = list(_layers_of(policy.actor.mu, "mu"))
            if layers[-1].kind != "tanh":
                raise TypeError(f"model: expected an actor that ends with Tanh, got {layers[-1].kind}")
            layers.pop()
        limit = "tanh"
    else:
        raise TypeError(f"model: expected PPO, A2C, SAC, TD3 or DDPG of Stable-Baselines3, got {type(model).__name__}")
    parts = {key: [_normalized(one, seen, statistics, key, k) for k, one in enumerate(part)] for key, part in seen.parts.items()}
    branches, first = _features(extractor, parts, seen, bool(policy.normalize_images))
    return _assemble(seen, branches, (*first, *layers), limit, note)


def _of_sb3(env: Any) -> tuple[Seen, Any]:
    """What the environment of a model observes, and its ``VecNormalize``, or None."""
    statistics = None
    while "venv" in vars(env):
        name = type(env).__name__
        if name == "VecNormalize":
            statistics = env if env.norm_obs else None
        elif name not in ("VecMonitor", "VecVideoRecorder", "VecCheckNan"):
            raise TypeError(f"env: expected a SB3VecEnv, or VecNormalize and VecMonitor around one, got {name}, which a policy does not keep")
        env = env.venv
    if type(env).__name__ != "SB3VecEnv":
        raise TypeError(f"env: expected propwash.envs.sb3.SB3VecEnv, got {type(env).__name__}")
    return Seen(env.env), statistics


def _normalized(given: Input, seen: Seen, statistics: Any, key: str, k: int) -> Input:
    """An input with the statistics of ``VecNormalize``."""
    if statistics is None:
        return given
    rms = statistics.obs_rms
    if isinstance(rms, Mapping):
        if key not in rms:  # not among norm_obs_keys
            return given
        rms = rms[key]
    mean, spread = np.asarray(rms.mean), np.sqrt(np.asarray(rms.var) + statistics.epsilon)
    part = seen.parts[key]
    shapes = [shape_of(one, seen.shapes[one.channel], one.channel) for one in part]
    if len(part) > 1:
        start = sum(math.prod(shape) for shape in shapes[:k])
        own = slice(start, start + math.prod(shapes[k]))
        mean, spread = mean[own], spread[own]
    limit = float(statistics.clip_obs)
    return given.scale(1.0 / spread.reshape(shapes[k]), mean.reshape(shapes[k])).clip(-limit, limit)


def _features(
    extractor: Any, parts: Mapping[str, Sequence[Input]], seen: Seen, scaled: bool
) -> tuple[list[Branch], tuple[Layer, ...]]:
    """Branches of a features extractor of Stable-Baselines3, and layers before the policy's own."""
    name = type(extractor).__name__

    def flat(part: Sequence[Input]) -> Branch:
        image = len(part) == 1 and len(shape_of(part[0], seen.shapes[part[0].channel], "inputs")) > 1
        return Branch(tuple(part), (Layer("flatten"),) if image else ())

    def seen_by_cnn(part: Sequence[Input], net: Any) -> Branch:
        (image,) = part
        image = image.scale(1.0 / 255.0) if scaled else image
        return Branch((image,), (*_layers_of(net.cnn, "cnn"), *_layers_of(net.linear, "cnn.linear")))

    if name == "FlattenExtractor" and set(parts) == {""}:
        return [flat(parts[""])], ()
    if name == "NatureCNN" and set(parts) == {""}:
        return [seen_by_cnn(parts[""], extractor)], ()
    if name == "CombinedExtractor":
        made = []
        for key, net in extractor.extractors.items():
            made.append(seen_by_cnn(parts[key], net) if type(net).__name__ == "NatureCNN" else flat(parts[key]))
        return made, ()
    raise TypeError(
        f"model: expected the features of FlattenExtractor, NatureCNN or CombinedExtractor, got {name}: "
        "build the policy by Policy.from_torch with its parts as branches"
    )
