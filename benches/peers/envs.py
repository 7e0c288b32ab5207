"""Steps per second of learning environments: propwash.envs beside crazyflow.envs, alternately, in one process on one core.

Usage: taskset -c 0 python envs.py [--worlds 1,64,1024] [--rounds 5]       with propwash (release), crazyflow and jax installed

Crazyflow's four tasks at the same rates (one step of the simulation in each step of the environment, its default, and ten), the same
vehicle and dynamics (so_rpy, its default), actions as NumPy arrays as a learner gives them, results taken back as NumPy arrays. Tasks that
it does not have, with depth images and collisions, stand alone.
"""

import argparse
import logging
import os
import statistics
import time
import warnings

os.environ.setdefault("JAX_PLATFORMS", "cpu")
warnings.filterwarnings("ignore")
logging.disable(logging.WARNING)

import gymnasium
import jax
import numpy as np

import crazyflow
import propwash
import propwash.envs
from crazyflow.envs.figure_8_env import FigureEightEnv
from crazyflow.envs.landing_env import LandingEnv
from crazyflow.envs.reach_pos_env import ReachPosEnv
from crazyflow.envs.reach_vel_env import ReachVelEnv

SAME = {
    "Propwash/ReachPos-v0": ReachPosEnv,
    "Propwash/ReachVel-v0": ReachVelEnv,
    "Propwash/Landing-v0": LandingEnv,
    "Propwash/Trajectory-v0": FigureEightEnv,
}
OWN = ["Propwash/ForestDepth-v0", "Propwash/GateRace-v0", "Propwash/RoomExplore-v0", "Propwash/SwarmCross-v0"]


def rate(env, action, seconds):
    """Steps of all worlds together per second."""
    steps = 0
    start = time.perf_counter()
    while True:
        for _ in range(10):
            obs, reward, terminated, truncated, _ = env.step(action)
            np.asarray(obs["pos"]), np.asarray(reward), np.asarray(terminated | truncated)
        steps += 10
        spent = time.perf_counter() - start
        if spent > seconds:
            return steps * action.shape[0] / spent


def number(value):
    return f"{value / 1e6:.2f} M" if value >= 1e6 else f"{value / 1e3:.1f} k" if value >= 1e3 else f"{value:.0f}"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--worlds", default="1,64,1024")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--freq", default="500,50")
    args = parser.parse_args()
    print(f"propwash {propwash.__version__}, crazyflow {crazyflow.__version__}, jax {jax.__version__}, gymnasium {gymnasium.__version__}, "
          f"{len(os.sched_getaffinity(0))} core(s), medians of {args.rounds} rounds of {args.seconds} s, load {os.getloadavg()[0]:.1f}")
    print("| environment | steps per second of a world | worlds | Crazyflow | Propwash | ratio | Propwash, us for each call |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    for name, theirs_of in SAME.items():
        for freq in map(int, args.freq.split(",")):
            for n in map(int, args.worlds.split(",")):
                theirs = theirs_of(num_envs=n, freq=freq)
                options = {"max_tilt_rad": np.pi / 2}
                ours = gymnasium.make_vec(
                    name, num_envs=n, freq=freq, dynamics="so_rpy", normalize_actions=False, action_options=options, threads=1
                )
                action = np.zeros((n, 4), np.float32)
                action[:, 3] = 0.33
                theirs.reset(seed=1)
                ours.reset(seed=1)
                rate(theirs, action, 0.1)
                pairs = [(rate(theirs, action, args.seconds), rate(ours, action, args.seconds)) for _ in range(args.rounds)]
                a, b = (statistics.median(x) for x in zip(*pairs))
                ratio = statistics.median(y / x for x, y in pairs)
                print(f"| `{name}` | {freq} | {n} | {number(a)} | {number(b)} | {ratio:.0f} | {1e6 * n / b:.1f} |", flush=True)
    for name in OWN:
        for n in map(int, args.worlds.split(",")):
            env = gymnasium.make_vec(name, num_envs=n, threads=1)
            env.reset(seed=1)
            action = np.zeros(env.action_space.shape, np.float32)
            value = statistics.median(rate(env, action, args.seconds) for _ in range(args.rounds))
            freq = env.metadata["render_fps"]
            print(f"| `{name}` | {freq} | {n} | – | {number(value)} | – | {1e6 * n / value:.1f} |", flush=True)


if __name__ == "__main__":
    main()
