"""Learns to reach a position by the gradients of its flights, in PyTorch: backpropagation through time.

    pip install 'propwash[envs]' torch matplotlib
    python examples/train_bptt.py --picture out/bptt_flights.png

The task of train_reach.py, without drawing any action: `propwash.torch.rollout` flies a command as one function of PyTorch, so the slope of what
a flight costs goes back through motion, on-board controllers and network. Gradients are cut every 0.8 s (`HORIZON`): longer ones grow
until they say nothing. Writes the costs along the training to out/train_bptt.png and the policy to out/train_bptt.npz, and ends with episodes
of `Propwash/ReachPos-v0` that it has not seen. `propwash.learn.bptt` does the same in the lanes of the simulation, in a fraction of a second.
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
import propwash.torch
from propwash.policies import Input

SETTINGS = {"freq": 25, "max_episode_time": 4.0, "action_options": {"max_tilt_rad": 0.4}}
DRONE = "cf2x_L250"  # that of the environment unless it is told another
#: Commands of an episode, and those between two cuts of the gradient.
TIMES, HORIZON = 100, 20
#: What the saved policy sees of an observation, as `numbers` makes it.
INPUTS = [Input("difference_to_goal"), Input("vel").scale(0.5), Input("quat"), Input("ang_vel").scale(0.2)]
UNSEEN = 1_000_000


def numbers(state: torch.Tensor) -> torch.Tensor:
    """What the policy sees of states (n_worlds, state_width) whose goal is the origin."""
    pos, quat, vel, ang_vel = state[:, 0:3], state[:, 3:7], state[:, 7:10], state[:, 10:13]
    return torch.cat([-pos, 0.5 * vel, quat, 0.2 * ang_vel], dim=-1)


def make(num_envs: int, **more: bool) -> gymnasium.vector.VectorEnv:
    return gymnasium.make_vec("Propwash/ReachPos-v0", num_envs=num_envs, **SETTINGS, **more)


class Commands:
    """Attitude commands of actions from -1 to 1, of which 0 hovers, as the environment makes them."""

    def __init__(self, sim: propwash.Sim) -> None:
        space = make(1, normalize_actions=False).single_action_space
        self.middle = torch.tensor([0.0, 0.0, 0.0, float(sim.hover_thrust()[0, 0])])
        self.down = self.middle - torch.from_numpy(space.low)
        self.up = torch.from_numpy(space.high) - self.middle

    def __call__(self, action: torch.Tensor) -> torch.Tensor:
        return self.middle + torch.where(action < 0, self.down, self.up) * action


def begin(sim: propwash.Sim, env: gymnasium.vector.VectorEnv, seed: int) -> torch.Tensor:
    """States in which episodes of the environment begin, with the goal in the origin."""
    seen, _ = env.reset(seed=seed)
    sim.reset()
    states = sim.states.numbers.copy()
    states[:, 0, 0:3] = -seen["difference_to_goal"]
    states[:, 0, 3:7], states[:, 0, 7:10], states[:, 0, 10:13] = seen["quat"], seen["vel"], seen["ang_vel"]
    return torch.from_numpy(states)


def train(updates: int, worlds: int, seed: int) -> tuple[nn.Sequential, list[tuple[float, float]]]:
    torch.manual_seed(seed)
    torch.set_num_threads(1)  # networks this small are slower on more
    env = make(worlds)
    sim = propwash.Sim(worlds, drone=DRONE, control="attitude")
    substeps = sim.freq // SETTINGS["freq"]
    commands = Commands(sim)
    network = nn.Sequential(nn.Linear(13, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 4))
    nn.init.zeros_(network[-1].bias)
    network[-1].weight.data *= 0.1
    optimizer = torch.optim.Adam(network.parameters(), lr=5e-3)
    curve, begun = [], time.perf_counter()
    for update in range(updates):
        optimizer.param_groups[0]["lr"] = 5e-3 * (1.0 - update / updates)
        state, total = begin(sim, env, seed * UNSEEN // 2 + update), 0.0
        for t in range(0, TIMES, HORIZON):
            cost, state = torch.zeros(()), state.detach()
            for _ in range(HORIZON):
                action = torch.tanh(network(numbers(state[:, 0])))
                flown = propwash.torch.rollout(sim, commands(action)[:, None, None], state=state, substeps=substeps, advance=True)
                state = flown[:, 0]
                pos, vel = state[:, 0, 0:3], state[:, 0, 7:10]
                far = (pos.square().sum(-1) + 0.01).sqrt()
                cost = cost + (far + 0.1 * vel.square().sum(-1) + 0.05 * action.square().sum(-1)).mean()
            optimizer.zero_grad()
            (cost / HORIZON).backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            total += cost.item() / TIMES
        curve.append((time.perf_counter() - begun, total))
    return network, curve


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--updates", type=int, default=40, help="rounds of episodes, five steps of the optimiser each")
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--picture", type=Path, help="a picture of four flights that it has not seen (.png)")
    args = parser.parse_args()
    network, curve = train(args.updates, args.worlds, args.seed)
    flown = args.updates * args.worlds * TIMES
    print(f"{flown} commands in {curve[-1][0]:.1f} s; mean cost of a command {curve[0][1]:.2f} -> {curve[-1][1]:.2f}")
    policy = propwash.Policy.from_torch(network, make(1), INPUTS, limit="tanh")
    args.out.mkdir(parents=True, exist_ok=True)
    policy.save(args.out / "train_bptt.npz", force=True)
    print(f"wrote {args.out / 'train_bptt.npz'}")
    plot(curve, args.out / "train_bptt.png")
    if args.picture is not None:
        args.picture.parent.mkdir(parents=True, exist_ok=True)
    found = propwash.evaluate(policy, episodes=256, seed=UNSEEN, picture=args.picture, force=True)
    print(f"mean distance to the goal after 4 s, of episodes that it has not seen: {found.rows[0].mean_distance:.3f} m")
    print(found)


def plot(curve: list[tuple[float, float]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    seconds, cost = np.array(curve).T
    figure, axes = plt.subplots(figsize=(6, 3.5))
    axes.plot(seconds, cost)
    axes.set(xlabel="seconds of training", ylabel="mean cost of a command", title="Propwash/ReachPos-v0, by gradients")
    axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    print(f"wrote {path}")


if __name__ == "__main__":
    main()
