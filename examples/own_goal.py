"""How do I say a task once, and have it learnt by gradients, by PPO and in any library that takes Gymnasium?

    pip install 'propwash[envs]' matplotlib
    python examples/own_goal.py --picture out/own_goal.png

A drone flies to and fro between two places that are drawn for each episode; which of them is next is what the episode remembers. The class below is plain Python that
runs once: ``propwash.learn.bptt`` trains a policy for it by the gradients of flights, and the same class is an environment, in which the policy flies with everything that
environments have: masses that differ, wind, noise, late commands, a scene. ``--sb3 500000`` trains one by Stable-Baselines3's PPO in that environment, too
(``pip install 'propwash[sb3]'``).
"""

import argparse
from pathlib import Path

import numpy as np

import propwash.envs
from propwash import learn

VEHICLE = "cf21B_500"
#: Corners of the boxes that the two places are drawn from, along each axis, m.
LEFT, RIGHT = [(-1.0, -0.4), (-1, 1), (1, 2)], [(0.4, 1.0), (-1, 1), (1, 2)]


class Shuttle(learn.Goal):
    """To and fro between two places: within 0.2 m of one the other is next."""

    pos, vel, time = [(-1, 1), (-1, 1), (1, 2)], [(-0.5, 0.5)] * 3, 12.0
    memory = {"goal": LEFT, "other": RIGHT, "passed": 0.0}

    def way(self, s):
        return s.goal - s.pos

    def off(self, s):
        return np.sqrt(self.way(s) @ self.way(s) + 1e-6)

    def observe(self, s):
        return {"difference_to_goal": self.way(s), "motion": [s.other - s.goal, 0.5 * s.vel, s.quat, 0.3 * s.ang_vel]}

    def cost(self, s):
        change = s.action - s.before
        return self.off(s) + 0.02 * s.vel @ s.vel + 0.005 * s.ang_vel @ s.ang_vel + 0.02 * change @ change

    def remember(self, s):
        there = self.off(s) < 0.2
        return {"goal": np.where(there, s.other, s.goal), "other": np.where(there, s.goal, s.other), "passed": s.passed + there}

    def reached(self, s):
        return s.passed > 7.5


#: Commands mean in the environment what they mean in training.
SAME = {"drone": VEHICLE, "normalize_actions": False, "action_options": {"max_tilt_rad": 0.6, "max_yaw_rad": 0.2}}
OTHERS = {
    "as trained": {},
    "masses that differ by 10 %": {"randomization": [{"parameter": "body.mass_kg", "draw": {"scale": [0.9, 1.1]}}]},
    "wind of 1 m/s": {"levels": {"wind_m_s": [0.8, 0.6, 0.0]}},
    "noise and late commands": {"levels": {"pos_sigma_m": 0.01, "vel_sigma_m_s": 0.05, "action_delay_s": 0.01}},
    "in a room, where touching ends an episode": {"scene": "room"},
}


def fly(policy, worlds: int = 200, **options) -> tuple[float, float, np.ndarray]:
    """Places reached in an episode, part of the episodes that ended before their time, and paths (n, worlds, 3)."""
    env = propwash.envs.DroneVectorEnv(worlds, task=Shuttle, autoreset_mode="SameStep", seed=1, **{**SAME, **options})
    obs, _ = env.reset(seed=1)
    path, places, broken = [obs["pos"]], np.zeros(worlds), np.zeros(worlds, bool)
    running = np.ones(worlds, bool)
    while running.any():
        before = obs["difference_to_goal"]
        obs, _, terminated, truncated, _ = env.step(policy(obs))
        ended = terminated | truncated
        # The way jumps where the other place has become the next.
        places += running & ~ended & (np.linalg.norm(obs["difference_to_goal"] - before, axis=-1) > 0.5)
        broken |= running & terminated
        running &= ~ended
        path.append(np.where(running[:, None], obs["pos"], np.nan))
    return places.mean(), broken.mean(), np.array(path)


def by_sb3(steps: int, seed: int):
    """The same by another library: PPO in the environment."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    from propwash.envs.sb3 import SB3VecEnv

    env = propwash.envs.DroneVectorEnv(128, task=Shuttle, autoreset_mode="SameStep", seed=seed, drone=VEHICLE)
    wrapped = VecNormalize(SB3VecEnv(propwash.envs.FlattenState(env)), norm_reward=False)
    model = PPO("MlpPolicy", wrapped, n_steps=32, batch_size=512, n_epochs=4, gamma=0.97, learning_rate=lambda left: 1e-3 * left, seed=seed, device="cpu")
    model.learn(steps)
    return propwash.Policy.from_sb3(model)


def draw(picture: Path, paths: np.ndarray) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 4, figsize=(14, 3.8), layout="constrained")
    for axis, path in zip(axes, np.moveaxis(paths, 1, 0)):
        axis.plot(path[:, 0], path[:, 1], color="#0072b2", linewidth=1)
        axis.plot(path[0, 0], path[0, 1], "k.", markersize=6)
        axis.set(aspect="equal", xlim=(-1.4, 1.4), ylim=(-1.4, 1.4), xlabel="x, m", ylabel="y, m")
    figure.savefig(picture, dpi=90)
    plt.close(figure)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--picture", type=Path, help="a picture of four flights from above")
    arguments.add_argument("--seed", type=int, default=0, help="seed of the training")
    arguments.add_argument("--sb3", type=int, default=0, help="steps of a training by Stable-Baselines3")
    args = arguments.parse_args()
    trained = learn.bptt(Shuttle(), VEHICLE, commands=600_000, seed=args.seed)
    print(f"trained by gradients in {trained.seconds:.1f} s: {trained.fly(settle=0.0).reached} of 100 flights reach eight places")
    paths = np.zeros((0, 4, 3))
    for what, options in OTHERS.items():
        places, broken, flown = fly(trained.policy, **options)
        paths = flown if what == "as trained" else paths
        print(f"{what}: {places:.1f} places in 12 s, {broken:.1%} of the episodes broken off")
    if args.sb3:
        places, broken, _ = fly(by_sb3(args.sb3, args.seed), normalize_actions=True, action_options={})
        print(f"by PPO of Stable-Baselines3, {args.sb3} steps: {places:.1f} places in 12 s, {broken:.1%} broken off")
    if args.picture:
        args.picture.parent.mkdir(parents=True, exist_ok=True)
        draw(args.picture, paths)
        print(f"wrote {args.picture}")


if __name__ == "__main__":
    main()
