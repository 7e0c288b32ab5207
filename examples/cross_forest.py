"""Learns to cross forests by what a depth camera shows, by the gradients of its flights, and crosses forests that it has not seen.

    pip install 'propwash[envs]' matplotlib
    python examples/cross_forest.py --picture out/cross_forest.png

Two million commands are flown in 24 generated forests; the slopes of what the flights cost go through motion, on-board controller, network and the distance to
trees, not through pixels (docs/learn.md). The judge is the environment ``Propwash/ForestDepth-v0`` with other forests, in which any touch ends the flight.
"""

import argparse
from pathlib import Path

import gymnasium
import numpy as np

import propwash
import propwash.envs  # registers the names
from propwash import learn
from propwash.envs.vector import shade

FOREST = {"trees": 36, "rocks": 6, "logs": 3, "moving": 0, "size_m": 12.0}
SETTINGS = {
    "drone": "cf21B_500",
    "action": "attitude",
    "normalize_actions": False,
    "freq": 20,
    "max_episode_time": 16.0,
    "camera": {"width": 16, "height": 12, "fovy_deg": 70.0, "range_m": [0.02, 6.0]},
}
ABOVE = propwash.Camera(mount="world", pos=(0.0, 0.0, 30.0), quat=(0.0, 0.0, 0.0, 1.0), fovy_deg=34.0, resolution=(300, 300))


def make(num_envs: int, seed: int, layouts: int, **changed: object):
    """Worlds in so many forests, of seeds from ``seed`` on."""
    settings = {**SETTINGS, "scene": {"forest": {**FOREST, "seed": seed}}, "layouts": layouts, **changed}
    return gymnasium.make_vec("Propwash/ForestDepth-v0", num_envs=num_envs, **settings)


def judge(policy: propwash.Policy, first: int, flights: int, shown: int = 0, **changed: object) -> tuple[dict[str, float], list]:
    """Flights through forests, one to four in each: what became of them, and the ways of the first ones."""
    envs = make(flights, first, min(flights, 250), autoreset_mode="Disabled", **changed)
    obs, _ = envs.reset(seed=first)
    ending, ways = np.zeros(flights, int), [[obs["pos"][w]] for w in range(shown)]
    pictures = [shade(envs.unwrapped.view(w, ABOVE)) for w in range(shown)]
    images = [obs["depth"][w] for w in range(shown)]
    for t in range(int(SETTINGS["freq"] * SETTINGS["max_episode_time"]) + 1):
        obs, _, terminated, truncated, info = envs.step(policy(obs))
        for w in range(shown):
            if ending[w] == 0:
                ways[w].append(obs["pos"][w])
                images[w] = obs["depth"][w] if t == 80 else images[w]
        done = terminated | truncated
        if done.any():
            ending = np.where((ending == 0) & done, info["ending"], ending)
            if (ending != 0).all():
                break
            obs, _ = envs.reset(options={"reset_mask": done})
    names = propwash.envs.ENDINGS
    parts = {names[e]: float((ending == e).mean()) for e in sorted(set(ending.tolist()))}
    return parts, [(pictures[w], np.array(ways[w]), images[w], names[ending[w]]) for w in range(shown)]


def draw(path: Path, trained: learn.Crossed, shown: list) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, grid = plt.subplots(2, len(shown) + 1, figsize=(3.2 * (len(shown) + 1), 5.4), height_ratios=[2, 1], layout="constrained")
    reach = 30.0 * np.tan(np.radians(17.0))
    each = max(1, len(trained.cost) // 200)
    smooth = trained.cost[: len(trained.cost) // each * each].reshape(-1, each).mean(axis=1)
    grid[0, 0].semilogy(trained.commands[each - 1 :: each][: len(smooth)] / 1e6, smooth)
    grid[0, 0].set(xlabel="million commands", ylabel="cost of a command", title="training")
    grid[0, 0].grid(alpha=0.3)
    grid[1, 0].axis("off")
    for column, (picture, way, image, ending) in enumerate(shown, 1):
        axes = grid[0, column]
        axes.imshow(0.5 + 0.5 * picture.mean(axis=-1) / 255.0, cmap="gray", vmin=0.0, vmax=1.0, extent=(-reach, reach, -reach, reach))
        axes.plot(way[:, 0], way[:, 1], color="#0072b2", linewidth=2.0)
        axes.plot(*way[0, :2], "o", color="white", markeredgecolor="black")
        axes.plot(*way[-1, :2], "X" if ending == "crashed" else "*", color="#f0e442", markeredgecolor="black", markersize=11)
        axes.set(title=ending, xlabel="x, m", ylabel="y, m" if column == 1 else "")
        grid[1, column].imshow(image, cmap="cividis_r", vmin=0.0, vmax=SETTINGS["camera"]["range_m"][1])
        grid[1, column].set(title="seen after 4 s", xticks=[], yticks=[])
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    print(f"wrote {path}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--commands", type=int, default=2_000_000, help="commands of the training, over all worlds")
    parser.add_argument("--seed", type=int, default=0, help="seed of the training")
    parser.add_argument("--unseen", type=int, default=500, help="seed of the first forest that is crossed afterwards; those of the training are 100 to 123")
    parser.add_argument("--flights", type=int, default=500, help="flights afterwards")
    parser.add_argument("--save", type=Path, help="keep the policy here (.npz)")
    parser.add_argument("--picture", type=Path, help="where the picture goes")
    parser.add_argument("--robust", action="store_true", help="also fly with what the training had not")
    args = parser.parse_args()
    trained = learn.cross(make(1, 100, 24), commands=args.commands, seed=args.seed)
    print(f"{trained.commands[-1]} commands in {trained.seconds:.1f} s, {trained.prepared:.1f} s of them for scenes and their distance fields")
    parts, shown = judge(trained.policy, args.unseen, args.flights, shown=4)
    print(f"{100 * parts.get('done', 0.0):.1f} % of {args.flights} flights through unseen forests arrive: {parts}")
    if args.robust:
        for name, changed in ROBUST.items():
            parts, _ = judge(trained.policy, args.unseen, args.flights, **changed)
            print(f"{name}: {100 * parts.get('done', 0.0):.1f} %")
    if args.save:
        args.save.parent.mkdir(parents=True, exist_ok=True)
        trained.policy.save(args.save, force=True)
        print(f"wrote {args.save}")
    if args.picture:
        draw(args.picture, trained, shown)


def other(effect: str) -> propwash.Vehicle:
    return propwash.Vehicle(SETTINGS["drone"]).with_effects(f"[[effect]]\n{effect}\n")


#: What the training had not.
ROBUST: dict[str, dict[str, object]] = {
    "wind of 2 m/s": {"drone": other('kind = "constant_wind"\nvelocity_m_s = [1.6, 1.2, 0.0]')},
    "commands and images 50 ms late": {"levels": {"action_delay_s": 0.05, "depth_delay_s": 0.05}},
    "thrust 10 % weaker": {"drone": other('kind = "thrust_scale"\nfactor = 0.9')},
    "20 % heavier": {"drone": other('kind = "wrong_mass"\nfactor = 1.2')},
    "50 trees in place of 36": {"scene": {"forest": {**FOREST, "trees": 50, "seed": 500}}},
}


if __name__ == "__main__":
    main()
