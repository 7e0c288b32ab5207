"""The Gymnasium environment of one world, for libraries that want single ones."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from .task import ENDINGS
from .vector import DroneVectorEnv, Info, Obs


class DroneEnv(gymnasium.Env[Obs, NDArray[np.float32]]):
    """One world. Takes the arguments of ``DroneVectorEnv`` but ``num_envs`` and ``autoreset_mode``.

    Observations are dicts of float32 arrays ``(n,)``, or ``(n_drones, n)``. For throughput use the vector environment: a batch of
    these pays Python for each.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 50}

    def __init__(self, **kwargs: Any) -> None:
        for name in ("num_envs", "autoreset_mode"):
            if name in kwargs:
                raise TypeError(f"{name}: this is one world; use gymnasium.make_vec for a batch")
        self.batch = DroneVectorEnv(1, autoreset_mode=AutoresetMode.DISABLED, **kwargs)
        self.metadata = {**type(self).metadata, "render_fps": self.batch.metadata["render_fps"]}
        self.render_mode = self.batch.render_mode
        self.action_space = self.batch.single_action_space
        self.observation_space = self.batch.single_observation_space
        self._ready = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Obs, Info]:
        """Begins a new episode; a seed starts the random numbers anew.

        ``options["goal"]``, (3,) or (n_drones, 3), gives it its goal, for tasks that have one.
        """
        if seed is not None:
            super().reset(seed=seed)
        options = options or {}
        if set(options) - {"goal"}:
            raise ValueError(f'options: expected "goal" or none, got {sorted(options)}')
        goal = options.get("goal")
        obs, _ = self.batch.reset(seed=seed, options=None if goal is None else {"goal": np.asarray(goal)[None]})
        self._ready = True
        return {name: value[0] for name, value in obs.items()}, {}

    def step(self, action: NDArray[Any]) -> tuple[Obs, float, bool, bool, Info]:
        """Flies one step. After the end of an episode it must be reset."""
        if not self._ready:
            self.batch._check_open()
            raise RuntimeError("step: expected a reset first: the episode has not begun, or has ended")
        obs, reward, terminated, truncated, info = self.batch.step(np.asarray(action)[None])
        own: Info = {}
        if "_ending" in info:
            own["ending"] = ENDINGS[int(info["ending"][0])]
            own["is_success"] = own["ending"] == "done"
            self._ready = False
        if "clipped" in info:
            own["clipped"] = True
        if "reward" in info:
            own["reward"] = info["reward"][0]
        first = {name: value[0] for name, value in obs.items()}
        return first, float(reward[0]), bool(terminated[0]), bool(truncated[0]), own

    def render(self) -> NDArray[np.uint8] | None:
        """A picture, as of ``DroneVectorEnv.render``; None unless its ``render_mode`` is ``"rgb_array"``. (height, width, 3)"""
        pictures = self.batch.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Marks it closed: every later call is an error."""
        self.batch.close()

    def __reduce__(self) -> Any:
        raise TypeError(
            "an environment cannot be pickled or copied: make one with the same arguments where it is needed"
        )
