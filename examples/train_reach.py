"""Learns to reach a position by PPO (Schulman et al., 2017), in well under a minute on two cores.

    pip install 'propwash[envs]' torch matplotlib
    python examples/train_reach.py --picture out/reach_flights.png

Writes the learning curve to out/train_reach.png and the policy to out/train_reach.npz, which ``propwash evaluate`` flies on other vehicles and in
wind. Ends with episodes that it has not seen, and a picture of them. The whole learner stands in this file; its details are
those that Huang et al. list ("The 37 implementation details of PPO", 2022): normalised advantages, clipped objective, orthogonal
initialisation, a learning rate that falls to zero.
"""

import argparse
import time
from pathlib import Path

import gymnasium
import numpy as np
import torch
from torch import nn

import propwash
import propwash.envs  # registers the names
from propwash.policies import Input

SETTINGS = {"freq": 25, "max_episode_time": 4.0, "action_options": {"max_tilt_rad": 0.4}}


def layer(inputs: int, outputs: int, gain: float = 2**0.5) -> nn.Linear:
    linear = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(linear.weight, gain)
    nn.init.zeros_(linear.bias)
    return linear


class Policy(nn.Module):
    """A normal distribution over actions, and the value of a state."""

    def __init__(self, inputs: int, actions: int, hidden: int = 64) -> None:
        super().__init__()
        self.mean = nn.Sequential(
            layer(inputs, hidden), nn.Tanh(), layer(hidden, hidden), nn.Tanh(), layer(hidden, actions, 0.01)
        )
        self.value = nn.Sequential(
            layer(inputs, hidden), nn.Tanh(), layer(hidden, hidden), nn.Tanh(), layer(hidden, 1, 1.0)
        )
        self.log_std = nn.Parameter(torch.full((actions,), -1.0))

    def distribution(self, state: torch.Tensor) -> torch.distributions.Normal:
        return torch.distributions.Normal(self.mean(state), self.log_std.exp())


#: The same for the saved policy: it takes observations as they are.
INPUTS = [Input("difference_to_goal"), Input("vel").scale(0.5), Input("quat"), Input("ang_vel").scale(0.2)]
UNSEEN = 1_000_000


def numbers(obs: dict[str, np.ndarray]) -> torch.Tensor:
    """What the policy sees: difference to the goal, velocity, attitude, angular velocity, about as large as 1."""
    parts = [obs["difference_to_goal"], 0.5 * obs["vel"], obs["quat"], 0.2 * obs["ang_vel"]]
    return torch.from_numpy(np.concatenate(parts, axis=-1))


def make(num_envs: int) -> gymnasium.vector.VectorEnv:
    return gymnasium.make_vec("Propwash/ReachPos-v0", num_envs=num_envs, **SETTINGS)


def train(seconds: float, num_envs: int, seed: int, total: int) -> tuple[Policy, list[tuple[float, float, float]]]:
    torch.manual_seed(seed)
    torch.set_num_threads(1)  # networks this small are slower on more
    envs = make(num_envs)
    obs, _ = envs.reset(seed=seed)
    state = numbers(obs)
    policy = Policy(state.shape[1], envs.single_action_space.shape[0])
    optimizer = torch.optim.Adam(policy.parameters(), lr=3e-3, eps=1e-5)
    steps, epochs, minibatches, gamma, lam = 16, 4, 8, 0.97, 0.95
    updates = total // (steps * num_envs)
    returns = np.zeros(num_envs)
    finished: list[float] = []
    curve = []
    begun = time.perf_counter()
    fresh = torch.zeros(num_envs, dtype=torch.bool)
    for update in range(updates):
        optimizer.param_groups[0]["lr"] = 3e-3 * (1.0 - update / updates)
        states = torch.zeros(steps, *state.shape)
        actions = torch.zeros(steps, num_envs, 4)
        logs, values, rewards = (torch.zeros(steps, num_envs) for _ in range(3))
        ended, ignored = (torch.zeros(steps, num_envs, dtype=torch.bool) for _ in range(2))
        for k in range(steps):
            with torch.no_grad():
                distribution = policy.distribution(state)
                action = distribution.sample()
                logs[k] = distribution.log_prob(action).sum(-1)
                values[k] = policy.value(state).squeeze(-1)
            states[k], actions[k], ignored[k] = state, action, fresh
            obs, reward, terminated, truncated, _ = envs.step(action.numpy())
            state = numbers(obs)
            done = terminated | truncated
            returns += reward
            finished += returns[done].tolist()
            returns[done] = 0.0
            rewards[k] = torch.from_numpy(reward)
            ended[k] = torch.from_numpy(terminated)
            # The step after an end begins the next episode: nothing is learnt from it.
            fresh = torch.from_numpy(done)
        with torch.no_grad():
            following = policy.value(state).squeeze(-1)
            advantages = torch.zeros(steps, num_envs)
            advantage = torch.zeros(num_envs)
            for k in reversed(range(steps)):
                after = values[k + 1] if k + 1 < steps else following
                over = fresh if k + 1 == steps else ignored[k + 1]
                error = rewards[k] + gamma * after * ~ended[k] - values[k]
                advantage = error + gamma * lam * advantage * ~over
                advantages[k] = advantage
            targets = (advantages + values).reshape(-1)
        use = ~ignored.reshape(-1)
        flat = [x.reshape(-1, *x.shape[2:])[use] for x in (states, actions, logs, advantages)]
        s, a, old, adv = flat
        target = targets[use]
        for _ in range(epochs):
            for rows in torch.randperm(len(s)).chunk(minibatches):
                distribution = policy.distribution(s[rows])
                ratio = (distribution.log_prob(a[rows]).sum(-1) - old[rows]).exp()
                gain = (adv[rows] - adv[rows].mean()) / (adv[rows].std() + 1e-8)
                objective = torch.min(ratio * gain, ratio.clamp(0.8, 1.2) * gain).mean()
                miss = (policy.value(s[rows]).squeeze(-1) - target[rows]).square().mean()
                loss = -objective + 0.5 * miss
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
                optimizer.step()
        spent = time.perf_counter() - begun
        if finished:
            curve.append((spent, float((update + 1) * steps * num_envs), float(np.mean(finished[-num_envs:]))))
        if spent > seconds:
            break
    return policy, curve


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="stop after so many seconds")
    parser.add_argument("--steps", type=int, default=500_000, help="steps of all worlds together")
    parser.add_argument("--num-envs", type=int, default=256)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--save", type=Path, help="keep the policy here (.npz) [default: train_reach.npz in --out]")
    parser.add_argument("--picture", type=Path, help="a picture of four flights that it has not seen (.png)")
    args = parser.parse_args()
    network, curve = train(args.seconds, args.num_envs, args.seed, args.steps)
    untrained = propwash.Policy.from_torch(Policy(13, 4).mean, make(1), INPUTS)
    policy = propwash.Policy.from_torch(network.mean, make(1), INPUTS)
    spent, flown, _ = curve[-1]
    # The best of an episode is 100: 1 for each step at the goal.
    print(f"{flown:.0f} steps in {spent:.1f} s; mean return {curve[0][2]:.1f} -> {curve[-1][2]:.1f} of 100")
    args.out.mkdir(parents=True, exist_ok=True)
    save = args.save or args.out / "train_reach.npz"
    for path in (save, args.picture):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
    policy.save(save, force=True)
    print(f"wrote {save}")
    plot(curve, args.out / "train_reach.png")
    before = propwash.evaluate(untrained, episodes=256, seed=UNSEEN).rows[0].mean_distance
    found = propwash.evaluate(policy, episodes=256, seed=UNSEEN, picture=args.picture, force=True)
    print(f"mean distance to the goal after 4 s: {before:.2f} m untrained, {found.rows[0].mean_distance:.3f} m trained")
    print(found)


def plot(curve: list[tuple[float, float, float]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    seconds, _, value = np.array(curve).T
    figure, axes = plt.subplots(figsize=(6, 3.5))
    axes.plot(seconds, value)
    axes.set(xlabel="seconds of training", ylabel="return of an episode (best 100)", title="Propwash/ReachPos-v0")
    axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    print(f"wrote {path}")


if __name__ == "__main__":
    main()
