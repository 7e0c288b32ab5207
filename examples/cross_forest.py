"""Learns to cross forests, halls or rooms by what a depth camera shows, by the gradients of its flights, and crosses others that it has not seen.

    pip install 'propwash[envs]' matplotlib
    python examples/cross_forest.py --picture out/cross_forest.png
    python examples/cross_forest.py --place rooms --picture out/cross_rooms.png

Two million commands are flown in 24 generated forests; the slopes of what the flights cost go through motion, on-board controller, network and the distance to
trees, not through pixels (docs/learn.md). The judge is the environment ``Propwash/ForestDepth-v0`` with other forests, in which any touch ends the flight.

``hall`` is one large room with furniture, ``rooms`` three in a row with a door between each two: there the training also knows the way through the doors, which the
policy must find by what it sees.
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
#: Generated scenes of a training, and its commands.
TRAINING = {"forest": (24, 2_000_000), "hall": (24, 2_000_000), "rooms": (48, 4_000_000)}
#: Scenes, where flights begin and end in them (forests: beside them), and what the training pays for.
PLACES: dict[str, tuple[dict[str, object], dict[str, object], learn.Cross]] = {
    "forest": ({"forest": FOREST}, {}, learn.Cross()),
    "hall": (
        {"rooms": {"columns": 1, "rows": 1, "room_m": 8.0, "things": 12, "moving": 0}},
        {"start_m": [[-3.3, -2.5, 0.9], [-2.7, 2.5, 1.5]], "goal_m": [[2.7, -2.5, 0.9], [3.3, 2.5, 1.5]], "ceiling_m": 2.3},
        learn.Cross(keep=0.45, speed=1.5),
    ),
    "rooms": (
        {"rooms": {"columns": 3, "rows": 1, "room_m": 4.0, "things": 6, "moving": 0}},
        {"start_m": [[-1.0, -1.0, 0.9], [1.0, 1.0, 1.5]], "goal_m": [[7.0, -1.2, 0.9], [9.2, 1.2, 1.5]], "ceiling_m": 2.3},
        learn.Cross(keep=0.4, speed=1.2, time=16.0, detour=0.45),
    ),
}
SETTINGS = {
    "drone": "cf21B_500",
    "action": "attitude",
    "normalize_actions": False,
    "freq": 20,
    "max_episode_time": 16.0,
    "camera": {"width": 16, "height": 12, "fovy_deg": 70.0, "range_m": [0.02, 6.0]},
}
#: Middle of what pictures from above show, m, and how far they reach from it, m.
SHOWN = {"forest": ((0.0, 0.0), 9.2), "hall": ((0.0, 0.0), 4.6), "rooms": ((4.0, 0.0), 6.6)}


def make(place: str, num_envs: int, seed: int, layouts: int, **changed: object):
    """Worlds in so many scenes, of seeds from ``seed`` on."""
    scene, ends, _ = PLACES[place]
    seeded = {kind: {**options, "seed": seed} for kind, options in scene.items()}
    settings = {**SETTINGS, "scene": seeded, "task_options": ends, "layouts": layouts, **changed}
    if place == "rooms":
        # Doors beside the way are looked for with a wider image.
        settings["camera"] = {**SETTINGS["camera"], "width": 20, "fovy_deg": 80.0}
    return gymnasium.make_vec("Propwash/ForestDepth-v0", num_envs=num_envs, **settings)


def judge(
    policy: propwash.Policy, place: str, first: int, flights: int, shown: int = 0, **changed: object
) -> tuple[dict[str, float], list]:
    """Flights through scenes, one or two in each: what became of them, and the ways of the first ones."""
    envs = make(place, flights, first, min(flights, 500), autoreset_mode="Disabled", **changed)
    obs, _ = envs.reset(seed=first)
    ending, ways = np.zeros(flights, int), [[obs["pos"][w]] for w in range(shown)]
    (x, y), reach = SHOWN[place]
    angle = float(2 * np.degrees(np.arctan(reach / 30.0)))
    above = propwash.Camera(mount="world", pos=(x, y, 30.0), quat=(0.0, 0.0, 0.0, 1.0), fovy_deg=angle, resolution=(300, 300))
    pictures = [shade(envs.unwrapped.view(w, above)) for w in range(shown)]
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


def draw(path: Path, place: str, trained: learn.Crossed, shown: list) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, grid = plt.subplots(2, len(shown) + 1, figsize=(3.2 * (len(shown) + 1), 5.4), height_ratios=[2, 1], layout="constrained")
    (x, y), reach = SHOWN[place]
    each = max(1, len(trained.cost) // 200)
    smooth = trained.cost[: len(trained.cost) // each * each].reshape(-1, each).mean(axis=1)
    grid[0, 0].semilogy(trained.commands[each - 1 :: each][: len(smooth)] / 1e6, smooth)
    grid[0, 0].set(xlabel="million commands", ylabel="cost of a command", title="training")
    grid[0, 0].grid(alpha=0.3)
    grid[1, 0].axis("off")
    for column, (picture, way, image, ending) in enumerate(shown, 1):
        axes = grid[0, column]
        axes.imshow(0.5 + 0.5 * picture.mean(axis=-1) / 255.0, cmap="gray", vmin=0.0, vmax=1.0, extent=(x - reach, x + reach, y - reach, y + reach))
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
    parser.add_argument("--place", choices=tuple(PLACES), default="forest", help="what is crossed")
    parser.add_argument("--commands", type=int, help="commands of the training, over all worlds; 2,000,000, for rooms 4,000,000")
    parser.add_argument("--seed", type=int, default=0, help="seed of the training")
    parser.add_argument("--unseen", type=int, default=500, help="seed of the first scene that is crossed afterwards; those of the training are from 100 on")
    parser.add_argument("--flights", type=int, default=500, help="flights afterwards")
    parser.add_argument("--save", type=Path, help="keep the policy here (.npz)")
    parser.add_argument("--picture", type=Path, help="where the picture goes")
    parser.add_argument("--robust", action="store_true", help="also fly with what the training had not")
    args = parser.parse_args()
    goal, (scenes, commands) = PLACES[args.place][2], TRAINING[args.place]
    trained = learn.cross(make(args.place, 1, 100, scenes), goal, commands=args.commands or commands, seed=args.seed)
    print(f"{trained.commands[-1]} commands in {trained.seconds:.1f} s, {trained.prepared:.1f} s of them for scenes and their distance fields")
    parts, shown = judge(trained.policy, args.place, args.unseen, args.flights, shown=4)
    print(f"{100 * parts.get('done', 0.0):.1f} % of {args.flights} flights through unseen scenes arrive: {parts}")
    if args.robust:
        for name, changed in ROBUST.items():
            if args.place == "forest" or "scene" not in changed:
                parts, _ = judge(trained.policy, args.place, args.unseen, args.flights, **changed)
                print(f"{name}: {100 * parts.get('done', 0.0):.1f} %")
    if args.save:
        args.save.parent.mkdir(parents=True, exist_ok=True)
        trained.policy.save(args.save, force=True)
        print(f"wrote {args.save}")
    if args.picture:
        draw(args.picture, args.place, trained, shown)


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
