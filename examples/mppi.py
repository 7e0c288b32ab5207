"""Flies through a field of poles by sampling: model-predictive path integral control with elites (MPPI, iCEM).

    pip install propwash matplotlib
    python examples/mppi.py --picture out/mppi.png

Fifty times a second thousands of command sequences of 1 s are flown by a model that is quick to fly (`so_rpy_rotor_drag` in 40 ms steps), in one call of
``Sim.rollout``, and the best hundredth of them says what to do next. What flies is the first-principles model at 500 Hz in a scene of MuJoCo; whether it
touched a pole is said by the scene, not by the planner's costs. Williams et al., "Information theoretic MPC", 2017; Pinneri et al., "Sample-efficient
cross-entropy method for real-time planning", 2020.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import propwash

VEHICLE = "cf21B_500"
#: Poles on a grid, their radius, how near the middle of the drone may come to their axes, and cells of the planner's map, m.
PITCH_M, RADIUS_M, KEEP_M, CELL_M = 0.8, 0.05, 0.2, 0.01
HORIZON, STEP_S, UPDATE_S = 25, 0.04, 0.02
SPREAD = np.array([0.12, 0.12, 0.0, 0.06], np.float32)
SPEED_M_S = 1.2


def poles(seed: int) -> np.ndarray:
    """Where 30 poles stand, m: a grid, each pole moved by up to 12 cm."""
    x, y = np.meshgrid(np.arange(6) * PITCH_M, (np.arange(5) - 2) * PITCH_M, indexing="ij")
    draws = np.random.default_rng(seed)
    return np.stack([x.ravel(), y.ravel()], -1) + draws.uniform(-0.12, 0.12, (30, 2)) + [1.0, 0.0]


def scene(where: np.ndarray) -> str:
    geoms = "".join(f'<geom type="cylinder" size="{RADIUS_M} 1" pos="{x:.4f} {y:.4f} 1" rgba=".3 .3 .3 1"/>' for x, y in where)
    return f'<mujoco><worldbody><geom type="plane" size="0 0 .05"/>{geoms}</worldbody></mujoco>'


class Planner:
    """Sequences of commands for a second to come, better with every update."""

    def __init__(self, samples: int, where: np.ndarray, seed: int) -> None:
        slow = {f"{name}_freq": 25 for name in ("state", "attitude", "body_rate", "force_torque")}
        self.sim = propwash.Sim(samples, drone=VEHICLE, dynamics="so_rpy_rotor_drag", control="attitude", freq=25, threads=1, **slow)
        self.hover = float(self.sim.hover_thrust()[0, 0])
        # Where poles are too near, on a grid of 1 cm over the field: looked up in place of 30 distances.
        x, y = np.meshgrid(np.arange(-2, 8, CELL_M), np.arange(-4, 4, CELL_M), indexing="ij")
        near = np.min(np.hypot(x[..., None] - where[:, 0], y[..., None] - where[:, 1]), axis=-1)
        self.taken = (near < KEEP_M).astype(np.float32)
        self.mean = np.tile(np.array([0, 0, 0, self.hover], np.float32), (HORIZON, 1))
        self.low = np.array([-0.6, -0.6, 0, 0.3 * self.hover], np.float32)
        self.high = np.array([0.6, 0.6, 0, 1.7 * self.hover], np.float32)
        self.draws = np.random.default_rng(seed)
        self.seconds = 0.0

    def update(self, state: propwash.States, goals: np.ndarray) -> np.ndarray:
        """The command for now. ``goals``: where to be after each step, (HORIZON, 3)."""
        began = time.process_time()
        n = self.sim.n_worlds
        # The quick model has a thrust in place of rotor speeds: that of hover to begin with.
        numbers = state.numbers.copy()
        numbers[..., -1] = self.hover
        self.sim.states = propwash.States(numbers)
        self.sim.data.controller_memory[...] = 0.0
        noise = self.draws.standard_normal((n, HORIZON, 4), dtype=np.float32)
        # Noise that lasts moves farther than noise that changes with every step.
        for t in range(1, HORIZON):
            noise[:, t] = 0.8 * noise[:, t - 1] + 0.6 * noise[:, t]
        noise[0] = 0.0
        commands = np.clip(self.mean + noise * SPREAD, self.low, self.high)
        states = self.sim.rollout(commands[:, :, None])
        cost = self.cost(states, commands, goals)
        best = np.argpartition(cost, n // 100)[: n // 100]
        self.mean = commands[best].mean(axis=0)
        command = self.mean[0].copy()
        # Half a step passes until the next update.
        self.mean[:-1] = 0.5 * (self.mean[:-1] + self.mean[1:])
        self.seconds += time.process_time() - began
        return command

    def cost(self, states: propwash.States, commands: np.ndarray, goals: np.ndarray) -> np.ndarray:
        pos, vel = states.pos[:, :, 0], states.vel[:, :, 0]
        off, tilt, thrust = pos - goals, commands[..., :2], commands[..., 3] - self.hover
        cost = 50 * np.einsum("ntk,ntk->n", off, off) + np.einsum("ntk,ntk->n", vel, vel)
        cost += 5 * np.einsum("ntk,ntk->n", tilt, tilt) + 5 * np.einsum("nt,nt->n", thrust, thrust)
        i = ((pos[..., 0] + 2) / CELL_M).astype(np.int32).clip(0, self.taken.shape[0] - 1)
        j = ((pos[..., 1] + 4) / CELL_M).astype(np.int32).clip(0, self.taken.shape[1] - 1)
        return cost + 1000 * self.taken[i, j].sum(1)


def fly(seed: int, samples: int) -> dict:
    """One flight from one end of the field to the other."""
    where = poles(seed)
    folder = Path("out")
    folder.mkdir(exist_ok=True)
    path = folder / f"mppi_{seed}.xml"
    path.write_text(scene(where))
    sim = propwash.Sim(1, drone=VEHICLE, control="attitude", scene=path, precision="f64")
    start, end = np.array([0.0, 0.0, 1.0]), np.array([6.0, 0.0, 1.0])
    sim.set_initial(pos=start)
    sim.reset()
    planner = Planner(samples, where, seed)
    flown, touched, updates = [sim.data.pos[0, 0].copy()], 0, 0
    while updates < 500 and np.linalg.norm(sim.data.pos[0, 0] - end) > 0.15:
        now = updates * UPDATE_S
        along = np.clip(SPEED_M_S * (now + STEP_S * np.arange(1, HORIZON + 1)), 0, 6.0)
        goals = start + along[:, None] * np.array([1.0, 0.0, 0.0])
        command = planner.update(propwash.States(sim.states.numbers[0]), goals.astype(np.float32))
        before = sim.data.pos.copy(), sim.data.quat.copy()
        sim.attitude_control(command[None, None])
        sim.step(10)
        touched += int(sim.swept(*before).touched.any())
        flown.append(sim.data.pos[0, 0].copy())
        updates += 1
    path.unlink()
    distance = np.linalg.norm(np.array(flown)[:, None, :2] - where[None], axis=-1).min() - RADIUS_M
    arrived = np.linalg.norm(sim.data.pos[0, 0] - end) <= 0.15
    return {"path": np.array(flown), "poles": where, "touched": touched, "nearest": distance, "arrived": arrived, "rate": samples * updates / planner.seconds}


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
    arguments.add_argument("--samples", type=int, default=512, help="sequences of an update")
    arguments.add_argument("--seed", type=int, default=0, help="seed of the first field")
    arguments.add_argument("--picture", type=Path, help="where the picture goes")
    args = arguments.parse_args()
    flights = [fly(args.seed + k, args.samples) for k in range(args.flights)]
    arrived, touched = sum(f["arrived"] for f in flights), sum(f["touched"] > 0 for f in flights)
    rate = np.median([f["rate"] for f in flights])
    print(f"{arrived} of {len(flights)} flights arrive, {touched} touch a pole; nearest {100 * min(f['nearest'] for f in flights):.0f} cm")
    print(f"{rate / 1e3:.0f} thousand sequences of {HORIZON} steps a second on one core: {rate * UPDATE_S:.0f} for each of 50 updates a second")
    if args.picture:
        args.picture.parent.mkdir(parents=True, exist_ok=True)
        draw(args.picture, flights)
        print(f"wrote {args.picture}")


if __name__ == "__main__":
    main()
