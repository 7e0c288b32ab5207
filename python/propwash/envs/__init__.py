"""Learning environments: Gymnasium vector environments, single environments, and PettingZoo for swarms.

>>> import gymnasium
>>> import propwash.envs
>>> envs = gymnasium.make_vec("Propwash/ForestDepth-v0", num_envs=64)

Worlds are reset, flown, seen and judged in Rust, all at once; Python pays one call for each step. Needs ``gymnasium``
(``pip install 'propwash[envs]'``).
"""

from __future__ import annotations

try:
    import gymnasium
except ImportError as _missing:
    raise ImportError("propwash.envs needs gymnasium: pip install 'propwash[envs]'") from _missing

from .single import DroneEnv
from .vector import ENDINGS, DroneVectorEnv
from .wrappers import DepthFrameStack, FlattenState, NormalizeDepth, ToF8x8

__all__ = [
    "ENDINGS",
    "IDS",
    "DepthFrameStack",
    "DroneEnv",
    "DroneVectorEnv",
    "FlattenState",
    "NormalizeDepth",
    "ToF8x8",
    "register",
]

#: Registered names and what they are short for.
IDS: dict[str, dict[str, object]] = {
    "Propwash/ReachPos-v0": {"task": "reach_pos"},
    "Propwash/ReachVel-v0": {"task": "reach_vel"},
    "Propwash/Landing-v0": {"task": "landing"},
    "Propwash/Trajectory-v0": {"task": "trajectory"},
    "Propwash/ForestDepth-v0": {"task": "forest_depth", "action": "velocity", "freq": 20, "max_episode_time": 12.0},
    "Propwash/GateRace-v0": {"task": "gate_race", "action": "velocity", "freq": 25, "max_episode_time": 30.0},
    "Propwash/RoomExplore-v0": {"task": "room_explore", "action": "velocity", "freq": 20, "max_episode_time": 40.0},
    "Propwash/SwarmCross-v0": {
        "task": "swarm_cross", "n_drones": 8, "action": "velocity", "freq": 20, "max_episode_time": 12.0,
    },
}  # fmt: skip


def register() -> None:
    """Registers all names with Gymnasium; importing this module does so already."""
    for name, kwargs in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name,
                entry_point="propwash.envs.single:DroneEnv",
                vector_entry_point="propwash.envs.vector:DroneVectorEnv",
                kwargs=dict(kwargs),
                disable_env_checker=True,
                order_enforce=False,
            )


register()
