"""How do I ask drones for something that no built-in task asks?

A ball swings through the place that a drone holds. The task gives a reward for staying near, ends an episode when the ball hits, and observes
where the ball is. Two policies fly it in 64 worlds: one holds the place whatever comes, one gives way. At the end episodes with other seeds, in
wind too, and a picture of four of them.
``python examples/own_task.py --picture out/own_task.png``
"""

import argparse
from pathlib import Path

import gymnasium
import numpy as np

import propwash
import propwash.envs

PLACE = np.array([0.0, 0.0, 1.0], np.float32)
SCENE = """
<mujoco><worldbody>
  <geom type="plane" size="0 0 1"/>
  <body name="ball" mocap="true" pos="0 9 1"><geom type="sphere" size="0.15"/></body>
</worldbody></mujoco>
"""


class Dodge(propwash.envs.Task):
    """Hold a place through which a ball swings along y.

    Args:
        swings: Swings per second.
        reach: How far the ball swings to either side, m.
    """

    channels = {"ball": 3}
    scene = SCENE
    action = "velocity"
    freq = 25
    max_episode_time = 12.0

    def __init__(self, swings: float = 0.1, reach: float = 3.0) -> None:
        self.swings, self.reach = swings, reach

    def on_reset(self, worlds):
        begins = worlds.begins
        if not hasattr(self, "phase"):
            self.phase = np.zeros(worlds.num_worlds)
        self.phase[begins] = worlds.uniform(1, 0.0, 2.0 * np.pi)[begins, 0]
        worlds.start_pos[begins] = PLACE

    def before_step(self, worlds):
        time = (worlds.step + 1) * worlds.step_time
        swing = self.reach * np.cos(self.phase + 2.0 * np.pi * self.swings * time)
        # It comes in from afar during the first four seconds.
        worlds.obstacle_pos[:, 0, 1] = swing + np.maximum(0.0, 4.0 - time)

    def observe(self, worlds):
        return {"ball": worlds.obstacle_pos[:, 0] - worlds.observed_pos}

    def reward(self, worlds):
        near = np.exp(-np.linalg.norm(worlds.pos - PLACE, axis=1))
        return np.where(worlds.crashed, -10.0, near)


def fly(envs, policy):
    """Part of the worlds whose episode a hit ended, and the mean sum of rewards of an episode."""
    obs, _ = envs.reset(seed=1)
    hit, running, total = np.zeros(envs.num_envs, bool), np.ones(envs.num_envs, bool), 0.0
    while running.any():
        obs, reward, terminated, truncated, _ = envs.step(policy(obs))
        total += reward[running].sum()
        hit |= running & terminated
        running &= ~(terminated | truncated)
    return hit.mean(), total / envs.num_envs


def hold(obs):
    return np.zeros((len(obs["pos"]), 4))


def give_way(obs):
    """Half a metre forward while the ball is near, else back to the place. Actions: forward, left, up, turn."""
    wanted = np.where(np.abs(obs["ball"][:, 1]) < 2.1, 0.5, 0.0)
    action = hold(obs)
    action[:, 0] = np.clip(0.7 * (wanted - obs["pos"][:, 0]) - 0.3 * obs["vel"][:, 0], -1.0, 1.0)
    return action


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="A task of your own")
    parser.add_argument("--picture", type=Path, help="a picture of four flights (.png)")
    picture = parser.parse_args().picture
    if picture is not None:
        picture.parent.mkdir(parents=True, exist_ok=True)
    name = propwash.envs.register_task("dodge", Dodge)
    envs = gymnasium.make_vec(name, num_envs=64)
    for what, policy in (("holds its place", hold), ("gives way", give_way)):
        hits, total = fly(envs, policy)
        print(f"{what}: hit in {100 * hits:.0f} % of the worlds, sum of rewards {total:.0f}")
    print(propwash.evaluate(give_way, name, episodes=64, wind=(0.0, 1.0), picture=picture, force=True))
