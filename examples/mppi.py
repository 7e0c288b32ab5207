"""Flies through a field of poles by sampling: model-predictive path integral control with elites (MPPI, iCEM).

    pip install propwash matplotlib
    python examples/mppi.py --picture out/mppi.png

Fifty times a second `propwash.planning.Planner` flies thousands of command sequences of 1 s by a model that is quick to fly (`so_rpy_rotor_drag` in 40 ms steps), and the best hundredth
of them says what to do next. How near poles are is looked up in a distance field that is baked of the scene once. What flies is the first-principles model at 500 Hz in that scene of
MuJoCo; whether it touched a pole is said by the scene, not by the planner's costs. Williams et al., "Information theoretic MPC", 2017; Pinneri et al., "Sample-efficient cross-entropy
method for real-time planning", 2020.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import propwash
import propwash.planning

VEHICLE = "cf21B_500"
#: Poles on a grid, their radius, how near the middle of the drone may come to them, and cells of the distance field, m.
PITCH_M, RADIUS_M, KEEP_M, CELL_M = 0.8, 0.05, 0.15, 0.05
HORIZON, STEP_S, UPDATE_S = 25, 0.04, 0.02
SPEED_M_S, LENGTH_M = 1.2, 6.0


def poles(seed: int) -> np.ndarray:
    """Where 30 poles stand, m: a grid, each pole moved by up to 12 cm."""
    x, y = np.meshgrid(np.arange(6) * PITCH_M, (np.arange(5) - 2) * PITCH_M, indexing="ij")
    draws = np.random.default_rng(seed)
    return np.stack([x.ravel(), y.ravel()], -1) + draws.uniform(-0.12, 0.12, (30, 2)) + [1.0, 0.0]


def scene(where: np.ndarray) -> str:
    geoms = "".join(f'<geom type="cylinder" size="{RADIUS_M} 1" pos="{x:.4f} {y:.4f} 1" rgba=".3 .3 .3 1"/>' for x, y in where)
    return f'<mujoco><worldbody><geom type="plane" size="0 0 .05"/>{geoms}</worldbody></mujoco>'


@propwash.cost(hover=1)
def cost(s):
    """What each command costs: it runs once, over names of numbers."""
    off = s.pos - np.array([np.clip(SPEED_M_S * s.t, 0.0, LENGTH_M), 0.0, 1.0])
    tilt, thrust = s.command[:2], s.command[3] - s.hover
    return 50 * off @ off + s.vel @ s.vel + 5 * tilt @ tilt + 5 * thrust * thrust + np.where(s.distance < KEEP_M, 1000.0, 0.0)


def fly(seed: int, samples: int, threads: int) -> dict:
    """One flight from one end of the field to the other."""
    where = poles(seed)
    folder = Path("out")
    folder.mkdir(exist_ok=True)
    path = folder / f"mppi_{seed}.xml"
    path.write_text(scene(where))
    sim = propwash.Sim(1, drone=VEHICLE, control="attitude", scene=path, precision="f64")
    start, end = np.array([0.0, 0.0, 1.0]), np.array([LENGTH_M, 0.0, 1.0])
    sim.set_initial(pos=start)
    sim.reset()
    hover = float(sim.hover_thrust()[0, 0])
    field = sim.distance_field(CELL_M, bounds=((-2.0, -4.0, 0.0), (8.0, 4.0, 2.0)))
    planner = propwash.planning.Planner(
        VEHICLE,
        cost,
        field=field,
        samples=samples,
        horizon=HORIZON,
        step=STEP_S,
        update=UPDATE_S,
        threads=threads,
        seed=seed,
    )
    flown, touched, updates, seconds = [sim.data.pos[0, 0].copy()], 0, 0, 0.0
    while updates < 500 and np.linalg.norm(sim.data.pos[0, 0] - end) > 0.15:
        began = time.process_time()
        plan = planner.update(sim.states, updates * UPDATE_S, hover=hover)
        seconds += time.process_time() - began
        before = sim.data.pos.copy(), sim.data.quat.copy()
        sim.attitude_control(plan.command[None, None])
        sim.step(10)
        touched += int(sim.swept(*before).touched.any())
        flown.append(sim.data.pos[0, 0].copy())
        updates += 1
    path.unlink()
    distance = np.linalg.norm(np.array(flown)[:, None, :2] - where[None], axis=-1).min() - RADIUS_M
    arrived = np.linalg.norm(sim.data.pos[0, 0] - end) <= 0.15
    return {"path": np.array(flown), "poles": where, "touched": touched, "nearest": distance, "arrived": arrived, "rate": samples * updates / seconds}


def draw(picture: Path, flights: list[dict]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    rows = -(-len(flights) // 2)
    figure, axes = plt.subplots(rows, 2, figsize=(12, 4.2 * rows), layout="constrained", squeeze=False)
    for axis, flight in zip(axes.ravel(), flights):
        for pole in flight["poles"]:
            axis.add_patch(plt.Circle(pole, RADIUS_M, color="#444444"))
        axis.plot(flight["path"][:, 0], flight["path"][:, 1], color="#d55e00")
        axis.set(aspect="equal", xlabel="x, m", ylabel="y, m", xlim=(-0.5, 6.5), ylim=(-2.2, 2.2), title=f"nearest pole {100 * flight['nearest']:.0f} cm away")
    for axis in axes.ravel()[len(flights) :]:
        axis.axis("off")
    figure.savefig(picture, dpi=90)
    plt.close(figure)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--flights", type=int, default=6, help="number of flights, each through another field")
    arguments.add_argument("--samples", type=int, default=4096, help="sequences of an update")
    arguments.add_argument("--threads", type=int, default=1, help="threads of the planner")
    arguments.add_argument("--seed", type=int, default=0, help="seed of the first field")
    arguments.add_argument("--picture", type=Path, help="where the picture goes")
    args = arguments.parse_args()
    flights = [fly(args.seed + k, args.samples, args.threads) for k in range(args.flights)]
    arrived, touched = sum(f["arrived"] for f in flights), sum(f["touched"] > 0 for f in flights)
    rate = np.median([f["rate"] for f in flights])
    print(f"{arrived} of {len(flights)} flights arrive, {touched} touch a pole; nearest {100 * min(f['nearest'] for f in flights):.0f} cm")
    print(f"{rate / 1e6:.2f} million sequences of {HORIZON} steps a second of processor time: {rate * UPDATE_S:.0f} for each of 50 updates a second")
    if args.picture:
        args.picture.parent.mkdir(parents=True, exist_ok=True)
        draw(args.picture, flights)
        print(f"wrote {args.picture}")


if __name__ == "__main__":
    main()
