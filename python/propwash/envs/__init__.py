"""Learning environments: Gymnasium vector environments, single environments, and PettingZoo for swarms.

>>> import gymnasium
>>> import propwash.envs
>>> envs = gymnasium.make_vec("Propwash/ForestDepth-v0", num_envs=64)

Worlds are reset, flown, seen and judged in Rust, all at once; Python pays one call for each step. Needs ``gymnasium``
(``pip install 'propwash[envs]'``).
"""

from __future__ import annotations

import re
from collections.abc import Callable

try:
    import gymnasium
except ImportError as _missing:
    raise ImportError("propwash.envs needs gymnasium: pip install 'propwash[envs]'") from _missing

from ..learn import Goal
from .single import DroneEnv
from .task import ENDINGS, REGISTERED, Task, Worlds
from .vector import BUILT_IN, TASKS, DroneVectorEnv
from .wrappers import DepthFrameStack, DepthImage, FlattenState, NormalizeDepth, ToF8x8

__all__ = [
    "ENDINGS",
    "IDS",
    "TASKS",
    "DepthFrameStack",
    "DepthImage",
    "DroneEnv",
    "DroneVectorEnv",
    "FlattenState",
    "NormalizeDepth",
    "Task",
    "ToF8x8",
    "Worlds",
    "register",
    "register_task",
]

#: Registered names and what they are short for.
IDS: dict[str, dict[str, object]] = {
    f"Propwash/{title}-v0": {"task": name, **arguments} for name, title, arguments in BUILT_IN
}


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


def register_task(name: str, task: Callable[..., Task | Goal], **kwargs: object) -> str:
    """Gives a task of your own a name, by which ``gymnasium.make_vec``, ``gymnasium.make`` and ``DroneVectorEnv(task=…)`` find it.

    Args:
        name: As ``"my_task"``: small letters, digits and underscores. A name that is registered is given to the new task.
        task: The class, or a function that returns an object of it; ``task_options`` are its arguments.
        kwargs: Arguments of ``DroneVectorEnv`` that Gymnasium makes it with.

    Returns:
        Its name in Gymnasium: ``"Propwash/MyTask-v0"``.
    """
    if not re.fullmatch("[a-z][a-z0-9]*(_[a-z0-9]+)*", name):
        raise ValueError(f'name: expected small letters, digits and underscores, as in "my_task", got {name!r}')
    if name in TASKS or name == "own":
        raise ValueError(f"name: expected another than those of the built-in tasks ({', '.join(TASKS)}), got {name!r}")
    if not callable(task):
        raise TypeError(f"task: expected a class derived from propwash.learn.Goal or propwash.envs.Task, got {type(task).__name__}")
    if isinstance(task, type) and not issubclass(task, (Task, Goal)):
        raise TypeError(f"task: expected a class derived from propwash.learn.Goal or propwash.envs.Task, got {task.__name__}")
    REGISTERED[name] = task
    known = f"Propwash/{''.join(part.capitalize() for part in name.split('_'))}-v0"
    IDS[known] = {"task": name, **kwargs}
    gymnasium.registry.pop(known, None)
    register()
    return known


register()
