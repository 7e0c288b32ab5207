"""Wrappers of vector environments that change what is observed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from .vector import Info, Obs


def _depth_of(env: VectorEnv[Any, Any, Any]) -> spaces.Box:
    space = env.single_observation_space
    if not isinstance(space, spaces.Dict) or not isinstance(space.spaces.get("depth"), spaces.Box):
        raise TypeError(f'expected an environment that observes "depth", got one that observes {space}')
    box = space.spaces["depth"]
    assert isinstance(box, spaces.Box)
    return box


if TYPE_CHECKING:
    _Wrapper = VectorWrapper[Any, Any, Any]
else:
    _Wrapper = VectorWrapper  # which takes no types before Gymnasium 1.3


class _Observed(_Wrapper):
    """A wrapper that changes observations, those that end episodes too."""

    def __init__(self, env: VectorEnv[Any, Any, Any], space: spaces.Space[Any]) -> None:
        super().__init__(env)
        self.single_observation_space = space
        self.observation_space = batch_space(space, self.num_envs)

    def change(self, obs: Obs) -> Any:
        """Observations as they shall be, of a batch of any size."""
        raise NotImplementedError

    def _changed_infos(self, info: Info) -> Info:
        if "final_obs" in info:
            final = np.full(self.num_envs, None, dtype=object)
            for w in np.flatnonzero(info["_final_obs"]):
                batch = self.change({name: value[None] for name, value in info["final_obs"][w].items()})
                final[w] = {name: value[0] for name, value in batch.items()} if isinstance(batch, dict) else batch[0]
            info["final_obs"] = final
        return info

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, Info]:
        """As that of the environment."""
        obs, info = self.env.reset(seed=seed, options=options)
        return self.change(obs), info

    def step(self, actions: Any) -> tuple[Any, NDArray[Any], NDArray[Any], NDArray[Any], Info]:
        """As that of the environment."""
        obs, reward, terminated, truncated, info = self.env.step(actions)
        return self.change(obs), reward, terminated, truncated, self._changed_infos(info)


class NormalizeDepth(_Observed):
    """Depth from 0 (at the camera) to 1 (as far as it sees); ``inverse``: nearness, from 1 (at ``near`` m and nearer) to 0."""

    def __init__(self, env: VectorEnv[Any, Any, Any], inverse: bool = False, near: float = 0.2) -> None:
        box = _depth_of(env)
        self._far = np.float32(box.high.max())
        if not 0.0 < near < self._far:
            raise ValueError(f"near: expected metres between 0 and {self._far}, got {near}")
        self._inverse, self._near = inverse, np.float32(near)
        space = env.single_observation_space
        assert isinstance(space, spaces.Dict)
        super().__init__(env, spaces.Dict({**space.spaces, "depth": spaces.Box(0.0, 1.0, box.shape, np.float32)}))

    def change(self, obs: Obs) -> Obs:
        """With depth from 0 to 1."""
        depth = obs["depth"]
        new: NDArray[Any]
        if self._inverse:
            low, high = 1.0 / self._far, 1.0 / self._near
            new = (1.0 / np.maximum(depth, self._near) - low) / (high - low)
        else:
            new = depth / self._far
        return {**obs, "depth": np.clip(new, 0.0, 1.0).astype(np.float32)}


class ToF8x8(_Observed):
    """Depth as a time-of-flight sensor of 8 x 8 zones gives it: of each zone the least, or the mean, of its pixels."""

    def __init__(self, env: VectorEnv[Any, Any, Any], reduce: Literal["min", "mean"] = "min") -> None:
        box = _depth_of(env)
        *head, height, width = box.shape
        if height % 8 or width % 8:
            raise ValueError(f"depth: expected a height and a width that 8 divides, got {height} x {width}")
        if reduce not in ("min", "mean"):
            raise ValueError(f'reduce: expected "min" or "mean", got {reduce!r}')
        self._reduce = reduce
        space = env.single_observation_space
        assert isinstance(space, spaces.Dict)
        high = float(box.high.max())
        super().__init__(env, spaces.Dict({**space.spaces, "depth": spaces.Box(0.0, high, (*head, 8, 8), np.float32)}))

    def change(self, obs: Obs) -> Obs:
        """With 8 x 8 zones."""
        depth = obs["depth"]
        *head, height, width = depth.shape
        zones = depth.reshape(*head, 8, height // 8, 8, width // 8)
        new = zones.min(axis=(-3, -1)) if self._reduce == "min" else zones.mean(axis=(-3, -1))
        return {**obs, "depth": np.asarray(new, np.float32)}


class FlattenState(_Observed):
    """All numbers but depth side by side as ``state``; without depth the observation is that array itself.

    They stand in the order in which they are observed: ``ang_vel`` (3), ``pos`` (3), ``quat`` (4) and so on, sorted by name as Gymnasium's
    ``Dict`` sorts them. ``columns`` says where each is: ``state[..., env.columns["pos"]]``. Arrays of several axes (readings of a LiDAR)
    are in the order of C.
    """

    columns: dict[str, slice]
    """Columns of each number in ``state``, by its name, in their order."""

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        space = env.single_observation_space
        if not isinstance(space, spaces.Dict):
            raise TypeError(f"expected an environment whose observations are dicts, got {space}")
        n_drones = int(getattr(env.unwrapped, "n_drones", 1))
        self._head = (n_drones,) if n_drones > 1 else ()
        self.columns = {}
        width = 0
        for name, box in space.spaces.items():
            if name == "depth":
                continue
            shape = box.shape
            if not isinstance(box, spaces.Box) or shape is None or shape[: len(self._head)] != self._head:
                raise TypeError(f"{name}: expected numbers of each drone, a Box {(*self._head, 'n')}, got {box}")
            own = int(np.prod(shape[len(self._head) :]))
            self.columns[name] = slice(width, width + own)
            width += own
        state = spaces.Box(-np.inf, np.inf, (*self._head, width), np.float32)
        self._depth = "depth" in space.spaces
        super().__init__(env, spaces.Dict({"depth": space.spaces["depth"], "state": state}) if self._depth else state)

    def change(self, obs: Obs) -> Any:
        """With one array of numbers."""
        parts = [obs[name] for name in self.columns]
        flat = [part.reshape(*part.shape[: 1 + len(self._head)], -1) for part in parts]
        state = np.concatenate(flat, axis=-1)
        return {"depth": obs["depth"], "state": state} if self._depth else state


class DepthImage(_Observed):
    """Depth as 8-bit images, channels first, which the CNN policies of Stable-Baselines3 take: uint8 (1, height, width), or (n, height,
    width) around ``DepthFrameStack``. For worlds with one drone.

    The scale is linear: a pixel is ``round(255 * depth / far)``, where ``far`` (m) is the greatest depth of the camera: 0 at the camera, 255
    as far as it sees, and where it sees nothing. A step of one is ``far / 255`` m.

    Args:
        env: An environment that observes ``depth``.
        only: The image is the whole observation, for ``"CnnPolicy"``; else it stands as ``depth`` among the numbers, for
            ``"MultiInputPolicy"``.

    The network of Stable-Baselines3 (``NatureCNN``) needs images of at least 36 × 36 pixels.
    """

    far: float
    """Depth of the value 255, m (1 around ``NormalizeDepth``)."""

    def __init__(self, env: VectorEnv[Any, Any, Any], only: bool = False) -> None:
        box = _depth_of(env)
        n_drones = int(getattr(env.unwrapped, "n_drones", 1))
        if n_drones > 1:
            raise ValueError(f"expected worlds with one drone, whose image is one of (1, height, width), got {n_drones} drones")
        if box.dtype != np.float32 or len(box.shape) not in (2, 3):
            raise TypeError(f"depth: expected float32 of shape (height, width) or (n, height, width), got {box}")
        self._only = bool(only)
        self._stacked = len(box.shape) == 3
        self.far = float(box.high.max())
        self._scale = np.float32(255.0 / self.far)
        space = env.single_observation_space
        assert isinstance(space, spaces.Dict)
        image = spaces.Box(0, 255, box.shape if self._stacked else (1, *box.shape), np.uint8)
        super().__init__(env, image if self._only else spaces.Dict({**space.spaces, "depth": image}))

    def change(self, obs: Obs) -> Any:
        """With images."""
        depth = obs["depth"] if self._stacked else obs["depth"][:, None]
        image = np.rint(np.clip(depth * self._scale, 0.0, 255.0)).astype(np.uint8)
        return image if self._only else {**obs, "depth": image}


class DepthFrameStack(_Observed):
    """The last ``n`` depth images, oldest first: ``depth`` gets a leading axis of ``n``. A new episode begins with ``n`` times its
    first image."""

    def __init__(self, env: VectorEnv[Any, Any, Any], n: int = 3) -> None:
        box = _depth_of(env)
        if n < 1:
            raise ValueError(f"n: expected at least 1, got {n}")
        self._n = n
        space = env.single_observation_space
        assert isinstance(space, spaces.Dict)
        high = float(box.high.max())
        stacked = spaces.Box(0.0, high, (n, *box.shape), np.float32)
        super().__init__(env, spaces.Dict({**space.spaces, "depth": stacked}))
        self._frames = np.zeros((self.num_envs, n, *box.shape), np.float32)
        self._ended = np.zeros(self.num_envs, bool)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, Info]:
        """As that of the environment."""
        obs, info = self.env.reset(seed=seed, options=options)
        mask = info.get("reset_mask", np.ones(self.num_envs, bool))
        self._frames[mask] = obs["depth"][mask][:, None]
        self._ended[mask] = False
        return {**obs, "depth": self._frames.copy()}, info

    def step(self, actions: Any) -> tuple[Any, NDArray[Any], NDArray[Any], NDArray[Any], Info]:
        """As that of the environment."""
        obs, reward, terminated, truncated, info = self.env.step(actions)
        done = terminated | truncated
        mode = self.env.metadata.get("autoreset_mode")
        if mode == AutoresetMode.SAME_STEP:
            for w in np.flatnonzero(done):
                last = np.concatenate([self._frames[w][1:], info["final_obs"][w]["depth"][None]])
                info["final_obs"][w] = {**info["final_obs"][w], "depth": last}
            fresh = done
        else:
            fresh = self._ended
        self._frames = np.concatenate([self._frames[:, 1:], obs["depth"][:, None]], axis=1)
        self._frames[fresh] = obs["depth"][fresh][:, None]
        self._ended = done
        return {**obs, "depth": self._frames.copy()}, reward, terminated, truncated, info
