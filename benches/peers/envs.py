"""Steps per second of learning environments: propwash.envs beside crazyflow.envs, alternately, in one process on one core.

Usage: taskset -c 0 python envs.py [--worlds 1,64,1024] [--rounds 5]       with propwash (release), crazyflow and jax installed
       taskset -c 0 python envs.py --own                                   what a task written in Python costs; neither is needed

Crazyflow's four tasks at the same rates (one step of the simulation in each step of the environment, its default, and ten), the same
vehicle and dynamics (so_rpy, its default), actions as NumPy arrays as a learner gives them, results taken back as NumPy arrays. Tasks that
it does not have, with depth images and collisions, stand alone.

`--cpu` measures by the processor's time of the process, all its threads together, in place of the clock on the wall: on one core that nothing
else uses both are the same, and on one that others use only this compares the programs.

`--own`: the built-in reach_pos, the same as a goal whose functions run once (propwash.learn.Goal), as a class of NumPy expressions, and one that does nothing, whose calls
alone are paid.
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
import numpy as np

import propwash
import propwash.envs
import propwash.learn

ALONE = ["Propwash/ForestDepth-v0", "Propwash/GateRace-v0", "Propwash/RoomExplore-v0", "Propwash/SwarmCross-v0"]


clock = time.perf_counter


def rate(env, action, seconds):
    """Steps of all worlds together per second."""
    steps = 0
    start = clock()
    while True:
        for _ in range(10):
            obs, reward, terminated, truncated, _ = env.step(action)
            np.asarray(obs["pos"]), np.asarray(reward), np.asarray(terminated | truncated)
        steps += 10
        spent = clock() - start
        if spent > seconds:
            return steps * action.shape[0] / spent


def number(value):
    return f"{value / 1e6:.2f} M" if value >= 1e6 else f"{value / 1e3:.1f} k" if value >= 1e3 else f"{value:.0f}"


def same():
    """The environments of both."""
    from crazyflow.envs.figure_8_env import FigureEightEnv
    from crazyflow.envs.landing_env import LandingEnv
    from crazyflow.envs.reach_pos_env import ReachPosEnv
    from crazyflow.envs.reach_vel_env import ReachVelEnv

    return {
        "Propwash/ReachPos-v0": ReachPosEnv,
        "Propwash/ReachVel-v0": ReachVelEnv,
        "Propwash/Landing-v0": LandingEnv,
        "Propwash/Trajectory-v0": FigureEightEnv,
    }


class ReachPos(propwash.envs.Task):
    """The built-in reach_pos in NumPy: the same episodes, observations, rewards and endings."""

    channels = {"difference_to_goal": 3}
    has_goal = True

    def on_reset(self, worlds):
        draw, begins = worlds.uniform(9, [-1, -1, 1, -1, -1, -1, -1, -1, 0.5], [1, 1, 2, 1, 1, 1, 1, 1, 1.5]), worlds.begins
        worlds.start_pos[begins], worlds.start_vel[begins] = draw[begins, :3], draw[begins, 3:6]
        own = begins & ~worlds.goal_given
        worlds.goal_pos[own] = draw[own, 6:]

    def observe(self, worlds):
        return {"difference_to_goal": worlds.goal_pos - worlds.observed_pos}

    def reward(self, worlds):
        distance = np.linalg.norm(worlds.goal_pos - worlds.pos, axis=1)
        return np.where(worlds.crashed, -1.0, np.exp(-2.0 * distance))


class Reach(propwash.learn.Goal):
    """The same, traced."""

    pos, vel = [(-1, 1), (-1, 1), (1, 2)], [(-1, 1)] * 3
    memory = {"goal": [(-1, 1), (-1, 1), (0.5, 1.5)]}

    def observe(self, s):
        return {"difference_to_goal": s.goal - s.pos}

    def reward(self, s):
        way = s.goal - s.pos
        return np.where(s.crashed, -1.0, np.exp(-2.0 * np.sqrt(way @ way)))


class Nothing(ReachPos):
    """The same episodes, arrays that are there already."""

    def observe(self, worlds):
        return {"difference_to_goal": worlds.goal_pos}

    def reward(self, worlds):
        return worlds.clearance


def own(args):
    """What a task in Python costs beside the same built in."""
    print(f"propwash {propwash.__version__}, {len(os.sched_getaffinity(0))} core(s), medians of {args.rounds} rounds of {args.seconds} s, load "
          f"{os.getloadavg()[0]:.1f}")
    print("| steps per second of a world | worlds | built-in, us for a step | as a goal | ratio | in NumPy | ratio | calls alone, us more than built-in |")
    print("| ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for freq in map(int, args.freq.split(",")):
        for n in map(int, args.worlds.split(",")):
            # Episodes end by crashes alone, the same in all of them.
            given = {"freq": freq, "max_episode_time": 1e5, "threads": 1}
            kinds = [propwash.envs.DroneVectorEnv(n, task=task, **given) for task in ("reach_pos", Reach, ReachPos, Nothing)]
            action = np.zeros((n, 4), np.float32)
            for env in kinds:
                env.reset(seed=1)
                rate(env, action, 0.1)
            rounds = [[1e6 * n / rate(env, action, args.seconds) for env in kinds] for _ in range(args.rounds)]
            built_in, goal, numpy, _ = (statistics.median(x) for x in zip(*rounds))
            goals, ratio, calls = (statistics.median(x) for x in zip(*((g / a, b / a, c - a) for a, g, b, c in rounds)))
            print(f"| {freq} | {n} | {built_in:.1f} | {goal:.1f} | {goals:.2f} | {numpy:.1f} | {ratio:.2f} | {calls:.1f} |", flush=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--worlds", default="1,64,1024")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--freq", default="500,50")
    parser.add_argument("--own", action="store_true")
    parser.add_argument("--cpu", action="store_true")
    args = parser.parse_args()
    if args.cpu:
        global clock
        clock = time.process_time
    if args.own:
        return own(args)
    import crazyflow
    import jax

    print(f"propwash {propwash.__version__}, crazyflow {crazyflow.__version__}, jax {jax.__version__}, gymnasium {gymnasium.__version__}, "
          f"{len(os.sched_getaffinity(0))} core(s), medians of {args.rounds} rounds of {args.seconds} s, load {os.getloadavg()[0]:.1f}")
    print("| environment | steps per second of a world | worlds | Crazyflow | Propwash | ratio | Propwash, us for each call |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    for name, theirs_of in same().items():
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
    for name in ALONE:
        for n in map(int, args.worlds.split(",")):
            env = gymnasium.make_vec(name, num_envs=n, threads=1)
            env.reset(seed=1)
            action = np.zeros(env.action_space.shape, np.float32)
            value = statistics.median(rate(env, action, args.seconds) for _ in range(args.rounds))
            freq = env.metadata["render_fps"]
            print(f"| `{name}` | {freq} | {n} | – | {number(value)} | – | {1e6 * n / value:.1f} |", flush=True)


if __name__ == "__main__":
    main()
