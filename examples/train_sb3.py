"""Learns to land with Stable-Baselines3's PPO, and says in how many episodes that it has not seen the drone lands.

    pip install 'propwash[sb3]'
    python examples/train_sb3.py --save out/land.npz --picture out/land.png

Landed means: at the end of the episode, which no crash ended, less than 0.15 m from the place and slower than 0.2 m/s. ``--save`` keeps the
policy in one file, which ``propwash evaluate`` flies on other vehicles and in wind. ``--delay 2`` trains with actions that come up to two
steps late, which a policy that has not met them does not survive.
"""

import argparse
import time
from pathlib import Path

import gymnasium
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
from torch import nn

import propwash
import propwash.envs  # registers the names
from propwash.envs import FlattenState
from propwash.envs.sb3 import SB3VecEnv

#: 25 actions a second, tilts of at most 0.4 rad: what the task needs, and no more to be learnt.
SETTINGS = {"freq": 25, "max_episode_time": 6.0, "action_options": {"max_tilt_rad": 0.4}}
UNSEEN = 1_000_000


def make(num_envs: int, seed: int, delay: float) -> VecNormalize:
    late = {"parameter": "env.action_delay_s", "draw": {"uniform": [0.0, delay / SETTINGS["freq"]]}}
    env = gymnasium.make_vec(
        "Propwash/Landing-v0",
        num_envs=num_envs,
        autoreset_mode="SameStep",
        seed=seed,
        randomization=[late] if delay > 0.0 else None,
        **SETTINGS,
    )
    # Observations about as large as 1; rewards lie between 0 and 1 already.
    return VecNormalize(VecMonitor(SB3VecEnv(FlattenState(env))), norm_reward=False)


def train(steps: int, num_envs: int, seed: int, delay: float) -> tuple[propwash.Policy, propwash.Policy]:
    """The policy before and after the training."""
    env = make(num_envs, seed, delay)
    per_update = 32
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=per_update,
        batch_size=num_envs * per_update // 8,
        n_epochs=4,
        gamma=0.97,
        gae_lambda=0.95,
        # It falls to zero, so that the end of the training is calm.
        learning_rate=lambda left: 1e-3 * left,
        policy_kwargs={"net_arch": [64, 64], "activation_fn": nn.Tanh, "log_std_init": -1.0},
        seed=seed,
        device="cpu",
    )
    before = propwash.Policy.from_sb3(model)
    model.learn(steps)
    return before, propwash.Policy.from_sb3(model)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=1_000_000, help="steps of all worlds together")
    parser.add_argument("--num-envs", type=int, default=128)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--delay", type=float, default=0.0, help="train with actions up to so many steps late")
    parser.add_argument("--episodes", type=int, default=200, help="unseen ones, at the end")
    parser.add_argument("--save", type=Path, help="keep the policy here (.npz)")
    parser.add_argument("--picture", type=Path, help="a picture of four of the unseen flights (.png)")
    args = parser.parse_args()
    begun = time.perf_counter()
    before, after = train(args.steps, args.num_envs, args.seed, args.delay)
    spent = time.perf_counter() - begun
    for path in (args.save, args.picture):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
    if args.save is not None:
        after.save(args.save, force=True)
    untrained = propwash.evaluate(before, episodes=args.episodes, seed=UNSEEN).rows[0]
    found = propwash.evaluate(after, episodes=args.episodes, seed=UNSEEN, picture=args.picture, force=True)
    trained = found.rows[0]
    print(f"{args.steps} steps in {spent:.0f} s; mean return {untrained.mean_return:.1f} -> {trained.mean_return:.1f}")
    print(f"landed in {100 * untrained.success:.0f} % -> {100 * trained.success:.0f} % of {args.episodes} episodes that it has not seen")
    print(found)


if __name__ == "__main__":
    main()
