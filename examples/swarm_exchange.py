"""128 drones exchange places at once and do not touch: ways that bend around each other, planned by gradients.

    pip install propwash matplotlib
    python examples/swarm_exchange.py --picture out/swarm_exchange.png

Every drone is told a random place of the others. Straight ways at one speed would meet; each way gets a bend, and all bends together are moved down the
gradient of how far any two come nearer than they may. Below each other they keep more distance, for the air that rotors push down. What flies is the whole
model with its on-board controller, and each feels the air of the others (`downwash`); whether any two touched is said by the contacts of the simulator, on the
way between steps too.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import propwash

VEHICLE = "cf2x_L250"
SIDE, PITCH_M, HEIGHT_M = 16, 0.6, 4.0
#: How near two may come, m: beside each other, and above each other.
APART_M = np.array([0.35, 0.35, 0.8])
BEND_M = np.array([2.0, 2.0, 2.0])
SECONDS = 15.0
WASH = """
[[effect]]
kind = "downwash"
drag_area_m2 = 0.002
spread = 0.1
"""


def places(n: int) -> np.ndarray:
    x, y = np.meshgrid(np.arange(SIDE), np.arange(-(-n // SIDE)))
    grid = np.stack([x.ravel(), y.ravel()], -1)[:n] * PITCH_M
    return np.concatenate([grid, np.full((n, 1), HEIGHT_M)], -1)


def shares(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Part of the way, and parts of two bends, as shares of the time: the derivatives 0 to 2 of each. (3, ...) and (2, 3, ...)

    The way is a path of least snap from rest to rest. By how far it has come, u, the first bend is 16 u² (1 − u)² and the second 60 u² (1 − u)² (1 − 2 u).
    """
    path = propwash.MinimumSnap([[0, 0, 0], [1, 0, 0]], [0.0, SECONDS])
    u, v, a = (path.at(time_s, d)[..., 0] for d in range(3))
    bends = []
    for shape in (np.poly1d([16, -32, 16, 0, 0]), 60 * np.poly1d([1, -2, 1, 0, 0]) * np.poly1d([-2, 1])):
        first, second = shape.deriv()(u), shape.deriv(2)(u)
        bends.append((shape(u), first * v, second * v**2 + first * a))
    return np.array([u, v, a]), np.array(bends)


def ways(start: np.ndarray, end: np.ndarray, bends: np.ndarray, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where all are, (times, n, 3), and parts of the bends, (2, times)."""
    way, shape = shares(time_s)
    return start + (end - start) * way[0][:, None, None] + np.einsum("kt,knx->tnx", shape[:, 0], bends), shape[:, 0]


def nearest(start: np.ndarray, end: np.ndarray, bends: np.ndarray) -> float:
    """How near any two come, in units of what they may."""
    where, _ = ways(start, end, bends, np.linspace(0, SECONDS, 501))
    first, second = np.triu_indices(len(start), 1)
    return min(float(np.sqrt((((w[first] - w[second]) / APART_M) ** 2).sum(-1)).min()) for w in where)


def plan(start: np.ndarray, end: np.ndarray, seed: int) -> tuple[np.ndarray, float]:
    """Two bends for each drone, m, (2, n, 3), and how near any two come by them, in units of what they may."""
    n, draws = len(start), np.random.default_rng(seed)
    b = draws.uniform(-0.5, 0.5, (2, n, 3)) * BEND_M
    mean, square, near = np.zeros_like(b), np.zeros_like(b), 0.0
    for step in range(1, 1501):
        # Other times in every step, so that no meeting stays unseen between them.
        where, shape = ways(start, end, b, SECONDS * (np.arange(24) + draws.random(24)) / 24)
        where = where / APART_M
        gap = where[:, :, None] - where[:, None]
        distance = np.sqrt((gap**2).sum(-1)) + 1e-9
        # A little more than is asked for, since flights are not exact.
        short = np.maximum(1.4 - distance, 0.0)
        short[:, np.arange(n), np.arange(n)] = 0.0
        pull = np.einsum("tij,tijx->tix", -2 * short / distance, gap) / APART_M
        gradient = np.einsum("kt,tnx->knx", shape, pull) + 0.02 * b
        mean, square = 0.9 * mean + 0.1 * gradient, 0.99 * square + 0.01 * gradient**2
        rate = 0.05 / np.sqrt(1 + step / 200)
        b = np.clip(b - rate * (mean / (1 - 0.9**step)) / (np.sqrt(square / (1 - 0.99**step)) + 1e-9), -BEND_M, BEND_M)
        if step % 100 == 0:
            near = nearest(start, end, b)
            if near > 1.05:
                break
    return b, near


def fly(n: int, seed: int) -> dict:
    start = places(n)
    end = start[np.random.default_rng(seed).permutation(n)]
    began = time.perf_counter()
    bends, near = plan(start, end, seed)
    planned_s = time.perf_counter() - began
    pairs = np.triu_indices(n, 1)
    vehicle = propwash.Vehicle(VEHICLE).with_effects(WASH)
    plane = Path("out/swarm_exchange.xml")
    plane.parent.mkdir(exist_ok=True)
    plane.write_text('<mujoco><worldbody><geom type="plane" size="0 0 .05"/></worldbody></mujoco>')
    sim = propwash.Sim(1, n, drone=vehicle, control="state", scene=plane)
    sim.set_initial(pos=start[None])
    sim.reset()
    touched, closest, off, flown = set(), np.inf, 0.0, [start]
    for k in range(round((SECONDS + 2) * 50)):
        t = np.array(0.02 * k)
        way, shape = shares(t)
        pos, vel, acc = (part * (end - start) + np.einsum("k,knx->nx", shape[:, d], bends) for d, part in enumerate(way))
        command = propwash.Command.state(start + pos, vel, acc)
        sim.state_control(command[None])
        before = sim.data.pos.copy(), sim.data.quat.copy()
        sim.step(10)
        touched |= set(np.flatnonzero(sim.swept(*before).touched[0])) | set(np.unique(sim.contacts().drone))
        pos = sim.data.pos[0].astype(float)
        closest = min(closest, np.linalg.norm(pos[pairs[0]] - pos[pairs[1]], axis=-1).min())
        flown.append(pos)
    off = np.linalg.norm(sim.data.pos[0] - end, axis=-1).max()
    plane.unlink()
    return {"touched": len(touched), "closest": closest, "off": off, "flown": np.array(flown), "seconds": planned_s, "near": near}


def draw(picture: Path, flown: np.ndarray) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 1, figsize=(11, 9), layout="constrained", height_ratios=[2, 1])
    colours = plt.get_cmap("viridis")(np.linspace(0, 1, flown.shape[1]))
    for axis, (i, j), names in ((axes[0], (0, 1), "xy"), (axes[1], (0, 2), "xz")):
        for k, colour in enumerate(colours):
            axis.plot(flown[:, k, i], flown[:, k, j], color=colour, linewidth=0.6)
        axis.plot(flown[-1, :, i], flown[-1, :, j], "k.", markersize=3)
        axis.set(aspect="equal", xlabel=f"{names[0]}, m", ylabel=f"{names[1]}, m")
    figure.savefig(picture, dpi=90)
    plt.close(figure)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--drones", type=int, default=128, help="number of drones")
    arguments.add_argument("--flights", type=int, default=1, help="number of exchanges, each with other places")
    arguments.add_argument("--seed", type=int, default=0, help="seed of the first")
    arguments.add_argument("--picture", type=Path, help="where the picture of the first goes")
    args = arguments.parse_args()
    flights = [fly(args.drones, args.seed + k) for k in range(args.flights)]
    for k, one in enumerate(flights):
        print(
            f"exchange {args.seed + k}: planned in {one['seconds']:.1f} s, {one['near']:.2f} of the distance to be kept; {one['touched']} of {args.drones} touch another; "
            f"nearest two {100 * one['closest']:.0f} cm; at most {1e3 * one['off']:.0f} mm from their places"
        )
    if args.picture:
        args.picture.parent.mkdir(parents=True, exist_ok=True)
        draw(args.picture, flights[0]["flown"])
        print(f"wrote {args.picture}")


if __name__ == "__main__":
    main()
