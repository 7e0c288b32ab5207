"""PettingZoo's parallel interface: every drone of a world is an agent. Needs ``pettingzoo`` (``pip install 'propwash[swarm]'``)."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

try:
    from pettingzoo import ParallelEnv  # type: ignore[import-untyped,import-not-found,unused-ignore]
except ImportError as _missing:
    raise ImportError("propwash.envs.parallel needs pettingzoo: pip install 'propwash[swarm]'") from _missing

from gymnasium import spaces

from .task import ENDINGS, Task
from .vector import BUILT_IN, DroneVectorEnv, Obs

Agents = dict[str, Any]


class SwarmEnv(ParallelEnv):  # type: ignore[misc]
    """One world of many drones. Takes the arguments of ``DroneVectorEnv`` but ``num_envs`` and ``autoreset_mode``.

    Agents are ``drone_0`` … . A crash of any drone, or the arrival of all, ends the episode of all.
    """

    metadata: dict[str, Any] = {"name": "propwash_swarm_v0", "render_modes": ["human", "rgb_array"], "is_parallelizable": True}

    def __init__(
        self, task: str | Task | Callable[..., Task] = "swarm_cross", n_drones: int | None = None, **kwargs: Any
    ) -> None:
        for name in ("num_envs", "autoreset_mode"):
            if name in kwargs:
                raise TypeError(f"{name}: this is one world; use gymnasium.make_vec for a batch")
        if n_drones is not None and n_drones < 2:
            raise ValueError(f"n_drones: expected 2 or more agents, got {n_drones}")
        given = kwargs if n_drones is None else {"n_drones": n_drones, **kwargs}
        made_for: dict[str, Any] = next((arguments for name, _, arguments in BUILT_IN if name == task), {})
        self.batch = DroneVectorEnv(1, task=task, autoreset_mode=AutoresetMode.DISABLED, **{**made_for, **given})
        n_drones = self.batch.n_drones
        if n_drones < 2:
            raise ValueError(f"n_drones: expected 2 or more agents, got {n_drones}, the task's own")
        self.render_mode = self.batch.render_mode
        self.possible_agents = [f"drone_{d}" for d in range(n_drones)]
        self.agents: list[str] = []
        box = self.batch.single_action_space
        assert isinstance(box, spaces.Box)
        low, high = box.low, box.high
        self._action = {
            name: spaces.Box(low[d], high[d], dtype=np.float32) for d, name in enumerate(self.possible_agents)
        }
        many = self.batch.single_observation_space
        assert isinstance(many, spaces.Dict)

        def own(box: Any) -> spaces.Box:
            return spaces.Box(box.low[0], box.high[0], dtype=np.float32)

        self._observation = {
            name: spaces.Dict({key: own(box) for key, box in many.spaces.items()}) for name in self.possible_agents
        }

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """What an agent observes."""
        return self._observation[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """What an agent does."""
        return self._action[agent]

    def _each(self, obs: Obs) -> Agents:
        return {
            name: {key: value[0, d] for key, value in obs.items()} for d, name in enumerate(self.possible_agents)
        }

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Agents, Agents]:
        """Begins a new episode; a seed starts the random numbers anew.

        ``options["goal"]``, (3,) by agent, gives it its goals, for tasks that have some.
        """
        options = dict(options or {})
        goal = options.pop("goal", None)
        if options:
            warnings.warn(f'options: there is "goal" only, {sorted(options)} is ignored', stacklevel=2)
        given = None
        if goal is not None:
            missing = [name for name in self.possible_agents if name not in goal]
            if missing:
                raise ValueError(f"goal: expected one for each agent, missing {missing}")
            given = {"goal": np.stack([np.asarray(goal[name], np.float64) for name in self.possible_agents])[None]}
        obs, _ = self.batch.reset(seed=seed, options=given)
        self.agents = list(self.possible_agents)
        return self._each(obs), {name: {} for name in self.agents}

    def step(self, actions: Agents) -> tuple[Agents, Agents, Agents, Agents, Agents]:
        """Flies one step with the actions of all agents."""
        if not self.agents:
            raise RuntimeError("step: expected a reset first: the episode has not begun, or has ended")
        missing = [name for name in self.agents if name not in actions]
        unknown = [name for name in actions if name not in self.agents]
        if missing or unknown:
            raise ValueError(f"actions: expected one of each agent {self.agents}, missing {missing}, unknown {unknown}")
        rows: list[NDArray[Any]] = [np.asarray(actions[name], np.float32) for name in self.agents]
        width = self.batch._action_shape[2]
        for name, row in zip(self.agents, rows):
            if row.shape != (width,):
                raise ValueError(f"action of {name}: expected shape ({width},), got {row.shape}")
        obs, _, terminated, truncated, info = self.batch.step(np.stack(rows)[None])
        each = dict(zip(self.agents, info["reward"][0].tolist()))
        ended, late = bool(terminated[0]), bool(truncated[0])
        ending = ENDINGS[int(info["ending"][0])] if "_ending" in info else ""
        names = self.agents
        infos: Agents = {name: {"ending": ending} if ending else {} for name in names}
        if ended or late:
            self.agents = []
        return (
            self._each(obs),
            each,
            {name: ended for name in names},
            {name: late for name in names},
            infos,
        )

    def render(self) -> NDArray[np.uint8] | None:
        """A picture, as of ``DroneVectorEnv.render``; None unless its ``render_mode`` is ``"rgb_array"``. (height, width, 3)"""
        pictures = self.batch.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Marks it closed."""
        self.batch.close()
