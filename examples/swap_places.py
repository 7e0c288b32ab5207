"""Sixteen drones on a circle of 3 m radius learn to change places with those on the other side, all at once, without touching; the same policy then flies more of them.

    pip install 'propwash[envs]' matplotlib
    python examples/swap_places.py --picture out/swap_places.png

One small network flies each drone by its velocity and attitude, the way to its place, and where its four nearest neighbours are and how they move; it is trained by the gradients of its
flights (docs/learn.md). The judge is the environment ``Propwash/SwarmCross-v0``: an exchange counts where all drones are at their places at once and none has touched
anything, on the way between steps too. ``--drones 16 24`` flies it in ``propwash.Sim``, more drones on wider circles.
"""

import argparse
from pathlib import Path

import gymnasium
import numpy as np

import propwash
import propwash.envs  # registers the names
from propwash import learn

DRONE, DRONES, NEIGHBOURS, SECONDS = "cf21B_500", 16, 4, 15.0
RADIUS_M, SCATTER_M, HEIGHT_M = 3.0, 0.3, [1.0, 1.4]
GOAL = learn.Swap()
SETTINGS = {
    "n_drones": DRONES,
    "action": "attitude",
    "normalize_actions": False,
    "freq": 20,
    "max_episode_time": SECONDS,
    "camera": False,
    "scene": {"boxes": {"count": 0, "moving": 0}},
    "layouts": 1,
    "task_options": {"radius_m": RADIUS_M, "start_off_m": SCATTER_M, "height_m": HEIGHT_M, "neighbours": NEIGHBOURS},
}
WASH = 'kind = "downwash"\ndrag_area_m2 = 0.002\nspread = 0.1'


def make(num_envs: int, **changed: object):
    return gymnasium.make_vec("Propwash/SwarmCross-v0", num_envs=num_envs, **{"drone": DRONE, **SETTINGS, **changed})


def judge(policy: propwash.Policy, worlds: int, seed: int, **changed: object) -> tuple[dict[str, float], float, float]:
    """Exchanges in so many worlds: what became of them, the share of drones that came to their places untouched, and the time of those that were done, s."""
    envs = make(worlds, autoreset_mode="Disabled", **changed)
    obs, _ = envs.reset(seed=seed)
    drones = obs["goal"].shape[1]
    ending, steps, there = np.zeros(worlds, int), np.zeros(worlds, int), np.zeros((worlds, drones), bool)
    for t in range(1, int(SETTINGS["freq"] * SECONDS) + 2):
        obs, _, terminated, truncated, info = envs.step(policy(obs))
        there |= (ending == 0)[:, None] & (np.linalg.norm(obs["goal"], axis=-1) < 0.5)
        done = terminated | truncated
        if done.any():
            fresh = (ending == 0) & done
            ending, steps = np.where(fresh, info["ending"], ending), np.where(fresh, t, steps)
            if (ending != 0).all():
                break
            obs, _ = envs.reset(options={"reset_mask": done})
    names = propwash.envs.ENDINGS
    good = ending == names.index("done")
    parts = {names[e]: float((ending == e).mean()) for e in sorted(set(ending.tolist()))}
    return parts, float(there.mean()), float(steps[good].mean() / SETTINGS["freq"]) if good.any() else float("nan")


def ring(n: int, radius: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts and goals on a circle, scattered as in the environment. (n, 3) each"""
    draws = np.random.default_rng(seed)
    angle = draws.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(n) / n

    def around(angle: np.ndarray) -> np.ndarray:
        middle = radius * np.stack([np.cos(angle), np.sin(angle)], -1) + draws.uniform(-SCATTER_M, SCATTER_M, (n, 2))
        return np.concatenate([middle, draws.uniform(*HEIGHT_M, (n, 1))], -1)

    return around(angle), around(angle + np.pi)


def observed(pos: np.ndarray, quat: np.ndarray, vel: np.ndarray, goal: np.ndarray) -> dict[str, np.ndarray]:
    """What the environment shows each drone. Positions, attitudes, velocities and goals are (n, 3 or 4)."""
    x, y, z, w = quat.T
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    cos, sin = np.cos(yaw), np.sin(yaw)

    def along(v: np.ndarray) -> np.ndarray:
        shape = (len(yaw),) + (1,) * (v.ndim - 2)
        c, s = cos.reshape(shape), sin.reshape(shape)
        return np.stack([c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0], v[..., 2]], -1)

    off, moved = pos[None] - pos[:, None], vel[None] - vel[:, None]
    distance = np.linalg.norm(off, axis=-1)
    np.fill_diagonal(distance, np.inf)
    near = np.argsort(distance, axis=1, kind="stable")[:, :NEIGHBOURS]
    rows = np.arange(len(pos))[:, None]
    neighbours = np.concatenate([along(off[rows, near]), along(moved[rows, near])], -1).reshape(len(pos), -1)
    seen = {"pos": pos, "quat": quat, "goal": along(goal - pos), "vel_heading": along(vel), "neighbours": neighbours}
    return {name: value.astype(np.float32) for name, value in seen.items()}


def fly(policy: propwash.Policy, n: int, seed: int, effects: str = "", seconds: float = 20.0) -> dict:
    """An exchange of any number of drones on a circle on which they start as far apart as those of the training: who touched anything, and who is there at the end."""
    start, goal = ring(n, max(RADIUS_M, RADIUS_M * n / DRONES), seed)
    vehicle = propwash.Vehicle(DRONE)
    vehicle = vehicle.with_effects(f"[[effect]]\n{effects}\n") if effects else vehicle
    plane = Path("out/swap_places.xml")
    plane.parent.mkdir(exist_ok=True)
    plane.write_text('<mujoco><worldbody><geom type="plane" size="0 0 .05"/></worldbody></mujoco>')
    sim = propwash.Sim(1, n, drone=vehicle, control="attitude", scene=plane)
    sim.set_initial(pos=start[None])
    sim.reset()
    touched, closest, flown = set(), np.inf, [start]
    pairs = np.triu_indices(n, 1)
    for _ in range(int(seconds * SETTINGS["freq"])):
        before = sim.data.pos.copy(), sim.data.quat.copy()
        sim.attitude_control(policy(observed(sim.data.pos[0], sim.data.quat[0], sim.data.vel[0], goal))[None])
        sim.step(sim.freq // SETTINGS["freq"])
        touched |= set(np.flatnonzero(sim.swept(*before).touched[0])) | set(np.unique(sim.contacts().drone))
        pos = sim.data.pos[0].astype(float)
        closest = min(closest, np.linalg.norm(pos[pairs[0]] - pos[pairs[1]], axis=-1).min())
        flown.append(pos)
    plane.unlink()
    off = np.linalg.norm(flown[-1] - goal, axis=-1)
    return {"touched": len(touched), "closest": closest, "there": int((off < 0.5).sum()), "flown": np.array(flown), "goal": goal}


def draw(path: Path, trained: learn.Crossed, flights: list[dict]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, grid = plt.subplots(1, len(flights) + 1, figsize=(4.2 * (len(flights) + 1), 4.2), layout="constrained")
    each = max(1, len(trained.cost) // 200)
    smooth = trained.cost[: len(trained.cost) // each * each].reshape(-1, each).mean(axis=1)
    grid[0].semilogy(trained.commands[each - 1 :: each][: len(smooth)] / 1e6, smooth)
    grid[0].set(xlabel="million commands", ylabel="cost of a command", title="training")
    grid[0].grid(alpha=0.3)
    for axes, one in zip(grid[1:], flights):
        colours = plt.get_cmap("turbo")(np.linspace(0.05, 0.95, one["flown"].shape[1]))
        for k, colour in enumerate(colours):
            axes.plot(one["flown"][:, k, 0], one["flown"][:, k, 1], color=colour, linewidth=1.2)
            axes.plot(*one["flown"][0, k, :2], "o", color=colour, markersize=4)
            axes.plot(*one["flown"][-1, k, :2], "*", color=colour, markeredgecolor="black", markersize=9)
        n = len(colours)
        axes.set(aspect="equal", xlabel="x, m", ylabel="y, m", title=f"{n} drones, {one['touched']} touched, nearest {100 * one['closest']:.0f} cm")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    print(f"wrote {path}")


def other(effect: str) -> propwash.Vehicle:
    return propwash.Vehicle(DRONE).with_effects(f"[[effect]]\n{effect}\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--commands", type=int, default=2_000_000, help="commands of the training, over all drones")
    parser.add_argument("--seed", type=int, default=0, help="seed of the training")
    parser.add_argument("--unseen", type=int, default=500, help="seed of the exchanges that are flown afterwards")
    parser.add_argument("--worlds", type=int, default=500, help="exchanges of 16 that are flown afterwards, in the environment")
    parser.add_argument("--drones", type=int, nargs="*", default=[16, 24], help="numbers of drones that exchange places in propwash.Sim")
    parser.add_argument("--save", type=Path, help="keep the policy here (.npz)")
    parser.add_argument("--picture", type=Path, help="where the picture goes")
    parser.add_argument("--robust", action="store_true", help="also fly with what the training had not")
    args = parser.parse_args()
    trained = learn.swap(make(1), GOAL, commands=args.commands, seed=args.seed)
    print(f"{trained.commands[-1]} commands in {trained.seconds:.1f} s")
    tests: dict[str, dict[str, object]] = {"as trained": {}} | (ROBUST if args.robust else {})
    for name, changed in tests.items():
        parts, there, seconds = judge(trained.policy, args.worlds, args.unseen, **changed)
        print(f"{name}: {100 * parts.get('done', 0.0):.1f} % of {args.worlds} exchanges done, {100 * there:.1f} % of drones there, {seconds:.1f} s; {parts}")
    if args.save:
        args.save.parent.mkdir(parents=True, exist_ok=True)
        trained.policy.save(args.save, force=True)
        print(f"wrote {args.save}")
    flights = [fly(trained.policy, n, args.unseen) for n in args.drones]
    for one in flights:
        n = one["flown"].shape[1]
        print(f"{n} drones in one world: {one['there']} there, {one['touched']} touched, nearest two {100 * one['closest']:.0f} cm")
    if args.picture:
        draw(args.picture, trained, flights)


#: What the training had not.
ROBUST: dict[str, dict[str, object]] = {
    "the air of others": {"drone": other(WASH)},
    "wind of 2 m/s": {"drone": other('kind = "constant_wind"\nvelocity_m_s = [1.6, 1.2, 0.0]')},
    "commands 5 ms late": {"levels": {"action_delay_s": 0.005}},
    "thrust 10 % weaker": {"drone": other('kind = "thrust_scale"\nfactor = 0.9')},
    "20 % heavier": {"drone": other('kind = "wrong_mass"\nfactor = 1.2')},
}


if __name__ == "__main__":
    main()
