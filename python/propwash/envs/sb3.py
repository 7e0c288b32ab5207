"""Stable-Baselines3's vector interface. Needs ``stable-baselines3`` (``pip install 'propwash[sb3]'``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

try:
    from stable_baselines3.common.vec_env import VecEnv  # type: ignore[import-not-found,unused-ignore]
except ImportError as _missing:
    raise ImportError("propwash.envs.sb3 needs stable-baselines3: pip install 'propwash[sb3]'") from _missing

from .task import ENDINGS


class SB3VecEnv(VecEnv):  # type: ignore[misc,unused-ignore]
    """A vector environment of ``propwash.envs``, or one with wrappers around it, for Stable-Baselines3.

    Needs the mode ``SAME_STEP``: Stable-Baselines3 resets worlds in the step that ends them.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        mode = env.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(f'env: expected one made with autoreset_mode="SameStep", got {mode}')
        self.env = env
        self._actions: NDArray[Any] | None = None
        self._seed: int | None = None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.metadata = env.metadata

    def reset(self) -> Any:
        obs, _ = self.env.reset(seed=self._seed)
        self._seed = None
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        return obs

    def step_async(self, actions: NDArray[Any]) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[Any, NDArray[Any], NDArray[Any], list[dict[str, Any]]]:
        obs, reward, terminated, truncated, info = self.env.step(self._actions)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for w in np.flatnonzero(done):
            ending = ENDINGS[int(info["ending"][w])]
            infos[w] = {
                "terminal_observation": info["final_obs"][w],
                "TimeLimit.truncated": bool(truncated[w] and not terminated[w]),
                "ending": ending,
                "is_success": ending == "done",
            }
        return obs, reward.astype(np.float32), done, infos

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Pictures of all worlds, (height, width, 3) each, of an environment that was made with ``render_mode="rgb_array"``: ``VecVideoRecorder``
        and ``render`` take them. None without that mode."""
        pictures: Any = self.env.render()
        return [None] * self.num_envs if pictures is None else list(pictures)

    def close(self) -> None:
        self.env.close()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        self._seed = seed
        return [seed] * self.num_envs

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        value = getattr(self.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        value = getattr(self.env, method_name)(*args, **kwargs)
        return [value for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]
