"""Learns to fly through a forest by what a depth camera shows: PPO (Schulman et al., 2017) with a small network.

    pip install 'propwash[envs]' torch matplotlib
    python examples/train_forest.py --minutes 6

Writes the learning curve to out/train_forest.png, the policy to out/train_forest.npz, which ``propwash evaluate`` flies on other vehicles and in
wind, and flights of the trained policy through forests that it has not seen, with what it saw, to out/train_forest_flight.png. Actions are
velocities along the heading; docs/environments.md says what is observed and rewarded.
"""

import argparse
import time
from pathlib import Path

import gymnasium
import numpy as np
import torch
from torch import nn

import propwash.envs  # registers the names
from propwash.envs import NormalizeDepth
from propwash.envs.vector import shade
from propwash.policies import Input

SETTINGS = {
    "freq": 10,
    "max_episode_time": 16.0,
    "camera": {"width": 64, "height": 48, "fovy_deg": 70.0, "range_m": [0.02, 6.0]},
    "action_options": {"max_speed_m_s": 2.0},
    "scene": {"forest": {"trees": 36, "rocks": 6, "logs": 3, "moving": 0, "size_m": 12.0, "seed": 100}},
    "layouts": 24,
}
UNSEEN = {**SETTINGS, "scene": {"forest": {**SETTINGS["scene"]["forest"], "seed": 900}}, "layouts": 8}

ABOVE = propwash.Camera(mount="world", pos=(0.0, 0.0, 30.0), quat=(0.0, 0.0, 0.0, 1.0), fovy_deg=34.0, resolution=(300, 300))


def layer(module: nn.Module, gain: float = 2**0.5) -> nn.Module:
    nn.init.orthogonal_(module.weight, gain)
    nn.init.zeros_(module.bias)
    return module


class Policy(nn.Module):
    """Sees the nearest thing in each of 12 x 16 zones and ten numbers; gives a normal distribution over velocities, and the value of a state."""

    def __init__(self) -> None:
        super().__init__()

        def network(outputs: int, gain: float) -> nn.Sequential:
            return nn.Sequential(
                layer(nn.Linear(202, 128)), nn.Tanh(), layer(nn.Linear(128, 64)), nn.Tanh(), layer(nn.Linear(64, outputs), gain)
            )

        self.mean, self.value = network(4, 0.01), network(1, 1.0)
        self.log_std = nn.Parameter(torch.tensor([-0.7, -0.7, -1.0, -0.7]))

    def forward(self, seen: torch.Tensor) -> tuple[torch.distributions.Normal, torch.Tensor]:
        return torch.distributions.Normal(self.mean(seen), self.log_std.exp()), self.value(seen).squeeze(-1)


def inputs(obs: dict[str, np.ndarray]) -> torch.Tensor:
    """Nearness by zones, and what a drone knows of itself: direction and distance of the goal, velocity, height, which way is up."""
    zones = obs["depth"].reshape(-1, 12, 4, 16, 4).max(axis=(2, 4)).reshape(-1, 192)
    goal = obs["goal"]
    distance = np.linalg.norm(goal, axis=-1, keepdims=True)
    x, y, z, w = obs["quat"].T
    up = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x)], axis=-1)
    own = [goal / np.maximum(distance, 0.1), 0.1 * distance, 0.5 * obs["vel_heading"], obs["pos"][:, 2:] - 1.2, up]
    return torch.from_numpy(np.concatenate([3.0 * zones, *own], axis=-1).astype(np.float32))


#: The same for the saved policy: it takes observations as they are.
INPUTS = [
    Input("depth").nearness(0.2, SETTINGS["camera"]["range_m"][1]).pool(4, 4, "max").scale(3.0),
    Input("goal").direction(0.1),
    Input("goal").length().scale(0.1),
    Input("vel_heading").scale(0.5),
    Input("pos").take(2).scale(1.0, 1.2),
    Input("quat").tilt(),
]


def make(num_envs: int, settings: dict, **kwargs):
    return NormalizeDepth(gymnasium.make_vec("Propwash/ForestDepth-v0", num_envs=num_envs, **settings, **kwargs), inverse=True)


def train(minutes: float, num_envs: int, seed: int, total: int) -> tuple[Policy, list[tuple[float, ...]]]:
    torch.manual_seed(seed)
    torch.set_num_threads(1)  # networks this small are slower on more; the worlds take all cores
    envs = make(num_envs, SETTINGS)
    obs, _ = envs.reset(seed=seed)
    state = inputs(obs)
    policy = Policy()
    optimizer = torch.optim.Adam(policy.parameters(), lr=1e-3, eps=1e-5)
    steps, epochs, minibatches, gamma, lam = 64, 4, 8, 0.99, 0.95
    returns, finished, endings = np.zeros(num_envs), [], []
    curve: list[tuple[float, ...]] = []
    fresh = torch.zeros(num_envs, dtype=torch.bool)
    begun = time.perf_counter()
    flown = 0
    while flown < total and time.perf_counter() - begun < 60.0 * minutes:
        done_part = max(flown / total, (time.perf_counter() - begun) / (60.0 * minutes))
        optimizer.param_groups[0]["lr"] = 1e-3 * (1.0 - done_part)
        states = torch.zeros(steps, *state.shape)
        actions = torch.zeros(steps, num_envs, 4)
        logs, values, rewards = (torch.zeros(steps, num_envs) for _ in range(3))
        ended, ignored = (torch.zeros(steps, num_envs, dtype=torch.bool) for _ in range(2))
        for k in range(steps):
            with torch.no_grad():
                distribution, values[k] = policy(state)
                action = distribution.sample()
                logs[k] = distribution.log_prob(action).sum(-1)
            states[k], actions[k], ignored[k] = state, action, fresh
            obs, reward, terminated, truncated, info = envs.step(action.numpy())
            state = inputs(obs)
            done = terminated | truncated
            returns += reward
            finished += returns[done].tolist()
            if done.any():
                endings += info["ending"][done].tolist()
            returns[done] = 0.0
            rewards[k], ended[k], fresh = torch.from_numpy(reward), torch.from_numpy(terminated), torch.from_numpy(done)
        flown += steps * num_envs
        with torch.no_grad():
            _, following = policy(state)
        advantages, advantage = torch.zeros(steps, num_envs), torch.zeros(num_envs)
        for k in reversed(range(steps)):
            after = values[k + 1] if k + 1 < steps else following
            over = fresh if k + 1 == steps else ignored[k + 1]
            error = rewards[k] + gamma * after * ~ended[k] - values[k]
            advantage = error + gamma * lam * advantage * ~over
            advantages[k] = advantage
        use = ~ignored.reshape(-1)
        batch = [x.reshape(-1, *x.shape[2:])[use] for x in (states, actions, logs, advantages, advantages + values)]
        for _ in range(epochs):
            for rows in torch.randperm(len(batch[0])).chunk(minibatches):
                s, a, old, adv, target = (x[rows] for x in batch)
                distribution, value = policy(s)
                ratio = (distribution.log_prob(a).sum(-1) - old).exp()
                gain = (adv - adv.mean()) / (adv.std() + 1e-8)
                objective = torch.min(ratio * gain, ratio.clamp(0.8, 1.2) * gain).mean()
                loss = -objective + 0.5 * (value - target).square().mean() - 0.003 * distribution.entropy().sum(-1).mean()
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
                optimizer.step()
        if len(finished) >= num_envs:
            arrived = endings[-2 * num_envs :].count(3) / len(endings[-2 * num_envs :])
            spent = time.perf_counter() - begun
            curve.append((spent, float(flown), float(np.mean(finished[-2 * num_envs :])), arrived))
            if len(curve) % 10 == 1:
                print(f"{spent:6.0f} s {flown:9d} steps: return {curve[-1][2]:6.2f}, {100 * arrived:4.0f} % arrive", flush=True)
    return policy, curve


def goal_place(obs: dict[str, np.ndarray]) -> np.ndarray:
    """Where the goal is, x and y in m, world: it is observed along the drone's heading."""
    x, y, z, w = obs["quat"]
    heading = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    turned = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    return obs["pos"][:2] + turned @ obs["goal"][:2]


def fly(policy: propwash.Policy | None, seed: int, num_envs: int = 64) -> tuple[float, dict[str, float], list]:
    """One episode in each of many unseen forests by the mean action: part that arrived, endings, and four of the flights."""
    envs = gymnasium.make_vec("Propwash/ForestDepth-v0", num_envs=num_envs, autoreset_mode="Disabled", **UNSEEN)
    obs, _ = envs.reset(seed=seed)
    generator = np.random.default_rng(seed)
    ending = np.zeros(num_envs, int)
    ways = [[obs["pos"][w]] for w in range(4)]
    goals = [goal_place({name: values[w] for name, values in obs.items()}) for w in range(4)]
    pictures = [shade(envs.unwrapped.view(w, ABOVE)) for w in range(4)]
    images: list[list[np.ndarray]] = [[obs["depth"][w]] for w in range(4)]
    for _ in range(int(SETTINGS["freq"] * SETTINGS["max_episode_time"]) + 1):
        if policy is None:
            action = generator.uniform(-1, 1, (num_envs, 4)).astype(np.float32)
        else:
            action = policy(obs)
        obs, _, terminated, truncated, info = envs.step(action)
        done = terminated | truncated
        for w in range(4):
            if ending[w] == 0:
                ways[w].append(obs["pos"][w])
                images[w].append(obs["depth"][w])
        if done.any():
            ending = np.where((ending == 0) & done, info["ending"], ending)
            if (ending != 0).all():
                break
            obs, _ = envs.reset(options={"reset_mask": done})
    names = propwash.envs.ENDINGS
    parts = {names[e]: float((ending == e).mean()) for e in sorted(set(ending.tolist()))}
    shown = [(pictures[w], np.array(ways[w]), images[w], names[ending[w]], goals[w]) for w in range(4)]
    return float((ending == 3).mean()), parts, shown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--minutes", type=float, default=6.0, help="stop after so many minutes")
    parser.add_argument("--steps", type=int, default=6_000_000, help="steps of all worlds together")
    parser.add_argument("--num-envs", type=int, default=128)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--save", type=Path, help="keep the policy here (.npz) [default: train_forest.npz in --out]")
    parser.add_argument("--picture", type=Path, help="the picture of flights [default: train_forest_flight.png in --out]")
    args = parser.parse_args()
    network, curve = train(args.minutes, args.num_envs, args.seed, args.steps)
    policy = propwash.Policy.from_torch(network.mean, make(1, SETTINGS), INPUTS)
    by_chance = fly(None, 5)[0]
    arrived, parts, shown = fly(policy, 5)
    spent, flown, value, _ = curve[-1]
    print(f"{flown:.0f} steps in {spent / 60:.1f} min; mean return {curve[0][2]:.2f} -> {value:.2f}")
    print(f"unseen forests: {100 * arrived:.0f} % arrive ({100 * by_chance:.0f} % by random actions); {parts}")
    args.out.mkdir(parents=True, exist_ok=True)
    save, picture = args.save or args.out / "train_forest.npz", args.picture or args.out / "train_forest_flight.png"
    for path in (save, picture):
        path.parent.mkdir(parents=True, exist_ok=True)
    policy.save(save, force=True)
    print(f"wrote {save}")
    plot_curve(curve, args.out / "train_forest.png")
    plot_flight(shown, picture)
    print(propwash.evaluate(policy))


def plot_curve(curve: list[tuple[float, ...]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    spent, _, value, arrived = np.array(curve).T
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4))
    left.plot(spent / 60.0, value)
    left.set(xlabel="minutes of training", ylabel="return of an episode", title="Propwash/ForestDepth-v0")
    right.plot(spent / 60.0, 100.0 * arrived, color="tab:green")
    right.set(xlabel="minutes of training", ylabel="episodes that arrive, %", ylim=(0, 100))
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    print(f"wrote {path}")


def plot_flight(shown: list, path: Path) -> None:
    """Ways of four worlds over their forests from above, with their goals, and what the drone saw in the middle of its way."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, grid = plt.subplots(2, 4, figsize=(13, 6), height_ratios=[2, 1], layout="constrained")
    reach, far = 30.0 * np.tan(np.radians(17.0)), SETTINGS["camera"]["range_m"][1]
    for w, (picture, way, images, ending, goal) in enumerate(shown):
        axes = grid[0, w]
        # Grey and pale, so that the way stands out.
        axes.imshow(0.5 + 0.5 * picture.mean(axis=-1) / 255.0, cmap="gray", vmin=0.0, vmax=1.0, extent=(-reach, reach, -reach, reach))
        axes.plot(way[:, 0], way[:, 1], color="#0072b2", linewidth=2.0)
        axes.plot(*way[0, :2], "o", color="white", markeredgecolor="black", label="start")
        axes.plot(*goal[:2], "*", color="#f0e442", markeredgecolor="black", markersize=13, label="goal")
        if ending == "crashed":
            axes.plot(*way[-1, :2], "X", color="#d55e00", markeredgecolor="black", markersize=9, label="crash")
        axes.set(title=ending, xlabel="x, m", ylabel="y, m" if w == 0 else "")
        axes.legend(loc="upper left", fontsize=7, framealpha=0.9)
        seen = grid[1, w].imshow(np.minimum(images[len(images) // 2], far), cmap="cividis_r", vmin=0.0, vmax=far)
        grid[1, w].set(title="depth half way", xticks=[], yticks=[])
    figure.colorbar(seen, ax=grid[1, :], shrink=0.9, pad=0.01, label="m")
    figure.savefig(path, dpi=100)
    print(f"wrote {path}")


if __name__ == "__main__":
    main()
