"""Learns to land with Stable-Baselines3's PPO.

    pip install 'propwash[sb3]'
    python examples/train_sb3.py
"""

import argparse

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

import propwash.envs
from propwash.envs import FlattenState
from propwash.envs.sb3 import SB3VecEnv


def make(num_envs: int) -> VecMonitor:
    env = gymnasium.make_vec("Propwash/Landing-v0", num_envs=num_envs, autoreset_mode="SameStep", max_episode_time=4.0)
    return VecMonitor(SB3VecEnv(FlattenState(env)))


def mean_return(model: PPO, num_envs: int = 64) -> float:
    """Of one episode in each world, by the mean action; the best is below 200, since a drone starts away from the goal."""
    env = make(num_envs)
    env.seed(7)
    obs, returns, running = env.reset(), np.zeros(num_envs), np.ones(num_envs, bool)
    while running.any():
        obs, reward, done, _ = env.step(model.predict(obs, deterministic=True)[0])
        returns += reward * running
        running &= ~done
    return float(returns.mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=600_000)
    parser.add_argument("--num-envs", type=int, default=128)
    args = parser.parse_args()
    model = PPO(
        "MlpPolicy", make(args.num_envs), n_steps=64, batch_size=1024, n_epochs=5, gamma=0.98, learning_rate=1e-3, seed=1, device="cpu"
    )
    before = mean_return(model)
    model.learn(args.steps)
    print(f"mean return {before:.1f} -> {mean_return(model):.1f} after {model.num_timesteps} steps")


if __name__ == "__main__":
    main()
