"""Follows a path by nonlinear model-predictive control with the solvers that come with CasADi.

    pip install propwash casadi matplotlib
    python examples/nmpc.py --picture out/nmpc.png

The model in the optimisation is the vehicle's own fitted model `so_rpy_rotor_drag`, printed for CasADi by ``propwash.export.casadi``; what flies is the same model or
the first-principles one, in ``propwash.Sim``. A hundred times a second one quadratic programme is solved (sequential quadratic programming, one iteration each
time: Diehl et al., "A real-time iteration scheme for nonlinear optimization in optimal feedback control", SIAM J. Control Optim. 43(5), 2005) over 25
commands for the next 2.5 s, by HPIPM (Frison and Diehl, 2020).
"""

import argparse
import time
from pathlib import Path

import casadi as ca
import numpy as np

import propwash
import propwash.export

VEHICLE, MODEL = "cf21B_500", "so_rpy_rotor_drag"
N, HORIZON_S, UPDATE_HZ, SIM_HZ = 25, 2.5, 100, 500
#: Prices of a metre off the path and of commands away from hover, as in the paper of Crazyflow.
POSITION, COMMAND = 80.0, np.ones(4)
LEAN_RAD, LEAST_N, MOST_N = 0.6, 0.0856, 0.8


def path(t: np.ndarray) -> np.ndarray:
    """A figure of eight of 2 m by 1 m in 10 s, m. (…, 3)"""
    return np.stack([np.sin(2 * np.pi * t / 10), 0 * t, 1 + 0.5 * np.sin(4 * np.pi * t / 10)], axis=-1)


class Controller:
    """One quadratic programme for each command: Gauss-Newton over all states and commands of the horizon."""

    def __init__(self) -> None:
        rate = propwash.export.casadi(VEHICLE, dynamics=MODEL)
        self.usual = propwash.export.numpy(VEHICLE, dynamics=MODEL).defaults
        self.nx, self.nu, dt = rate.size1_in(0), rate.size1_in(1), HORIZON_S / N
        x, u = ca.SX.sym("x", self.nx), ca.SX.sym("u", self.nu)
        k1 = rate(x, u)
        k2 = rate(x + dt / 2 * k1, u)
        k3 = rate(x + dt / 2 * k2, u)
        k4 = rate(x + dt * k3, u)
        after = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        step = ca.Function("step", [x, u], [after, ca.jacobian(after, x), ca.jacobian(after, u)]).expand()
        self.step = step.map(N)
        # Variables: x0 u0 x1 u1 … xN, the order that HPIPM finds by itself.
        self.width = self.nx + self.nu
        n = N * self.width + self.nx
        price = np.zeros(n)
        for k in range(N + 1):
            price[k * self.width : k * self.width + 3] = POSITION
            if k < N:
                price[k * self.width + self.nx : (k + 1) * self.width] = COMMAND
        # A little on all else, so that every direction has a price.
        self.price = np.maximum(price, 1e-6)
        rows, columns = [], []
        for k in range(N):
            r, c = k * self.nx, k * self.width
            rows += [r + i for i in range(self.nx) for _ in range(self.width + 1)]
            columns += [c + j for i in range(self.nx) for j in [*range(self.width), self.width + i]]
        pattern = ca.Sparsity.triplet(N * self.nx, n, rows, columns)
        order = np.zeros((N * self.nx, n), dtype=int)
        order[rows, columns] = np.arange(1, len(rows) + 1)
        self.order = order.T[order.T > 0] - 1
        self.pattern = pattern
        self.qp = ca.conic("qp", "hpipm", {"h": ca.Sparsity.diag(n), "a": pattern}, {"print_time": False, "error_on_fail": False})
        hover = self.usual["u"]
        low = np.array([-LEAN_RAD, -LEAN_RAD, -LEAN_RAD, LEAST_N])
        high = np.array([LEAN_RAD, LEAN_RAD, LEAN_RAD, MOST_N])
        self.hover, self.low, self.high = hover, low, high
        self.x = np.tile(self.usual["x"], (N + 1, 1))
        self.u = np.tile(hover, (N, 1))

    def command(self, state: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """The command for a state; `wanted` are the places to be at, (N + 1, 3)."""
        # The quaternion that is nearer to the one that was expected.
        state = state.copy()
        if state[3:7] @ self.x[0, 3:7] < 0:
            state[3:7] *= -1
        after, by_x, by_u = (np.array(m) for m in self.step(self.x[:-1].T, self.u.T))
        by_x = by_x.reshape(self.nx, N, self.nx).transpose(1, 0, 2)
        by_u = by_u.reshape(self.nx, N, self.nu).transpose(1, 0, 2)
        # x(k+1) + dx(k+1) = after + A dx + B du: rows of A, B and −1 for each state.
        blocks = np.concatenate([by_x, by_u, np.full((N, self.nx, 1), -1.0)], axis=-1)
        gap = self.x[1:] - after.T
        gradient = np.zeros(N * self.width + self.nx)
        for k in range(N + 1):
            gradient[k * self.width : k * self.width + 3] = POSITION * (self.x[k, :3] - wanted[k])
            if k < N:
                gradient[k * self.width + self.nx : (k + 1) * self.width] = COMMAND * (self.u[k] - self.hover)
        lower, upper = np.full(gradient.size, -1e8), np.full(gradient.size, 1e8)
        lower[: self.nx] = upper[: self.nx] = state - self.x[0]
        for k in range(N):
            at = slice(k * self.width + self.nx, (k + 1) * self.width)
            lower[at], upper[at] = self.low - self.u[k], self.high - self.u[k]
        a = ca.DM(self.pattern, blocks.reshape(-1)[self.order])
        solved = self.qp(h=ca.diag(ca.DM(self.price)), a=a, g=gradient, lba=gap.reshape(-1), uba=gap.reshape(-1), lbx=lower, ubx=upper)
        move = np.array(solved["x"]).ravel()
        steps = move[: N * self.width].reshape(N, self.width)
        self.x[:-1] += steps[:, : self.nx]
        self.u += steps[:, self.nx :]
        self.x[-1] += move[N * self.width :]
        return np.clip(self.u[0], self.low, self.high)


def fly(dynamics: str, seconds: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Flies from near the path; returns how far off, m, and the time of each solution, s. (updates,)"""
    sim = propwash.Sim(drone=VEHICLE, dynamics=dynamics, control="attitude", freq=SIM_HZ, precision="f64", threads=1)
    draws = np.random.default_rng(seed)
    sim.data.pos[0, 0] = path(np.array(0.0)) + draws.normal(0, 0.05, 3)
    sim.data.vel[0, 0] = draws.normal(0, 0.1, 3)
    controller = Controller()
    off, took = [], []
    for k in range(int(seconds * UPDATE_HZ)):
        t = k / UPDATE_HZ
        off.append(np.linalg.norm(sim.data.pos[0, 0] - path(np.array(t))))
        # First principles have rotors where the model has a thrust; what it would be is what was told last.
        x = np.concatenate([sim.states.numbers[0, 0, :13], controller.u[:1, 3]])
        if dynamics == MODEL:
            x[13] = sim.data.thrust[0, 0]
        begun = time.process_time()
        command = controller.command(x, path(t + np.arange(N + 1) * HORIZON_S / N))
        took.append(time.process_time() - begun)
        sim.attitude_control(command[None, None])
        sim.step(SIM_HZ // UPDATE_HZ)
    return np.array(off), np.array(took)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=3, help="flights, each from another start")
    parser.add_argument("--seconds", type=float, default=12.5, help="length of a flight")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first start")
    parser.add_argument("--picture", type=Path, help="where to draw the errors")
    args = parser.parse_args()
    curves = {}
    for dynamics in (MODEL, "first_principles"):
        errors, times = [], []
        for k in range(args.flights):
            off, took = fly(dynamics, args.seconds, args.seed + k)
            curves.setdefault(dynamics, []).append(off)
            # From 2.5 s on: before, it comes from its start.
            errors.append(np.sqrt(np.mean(off[int(2.5 * UPDATE_HZ) :] ** 2)))
            times.append(np.median(took[5:]))
        print(f"{dynamics}: {1e3 * np.median(errors):.1f} mm off (worst flight {1e3 * max(errors):.1f}), {1e3 * np.median(times):.2f} ms a solution")
    if args.picture:
        draw(args.picture, curves)


def draw(to: Path, curves: dict[str, list[np.ndarray]]) -> None:
    """Draws how far off the flights are."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
    for (dynamics, flights), colour in zip(curves.items(), ("#1f6fb4", "#d1610d")):
        for k, off in enumerate(flights):
            axes.plot(np.arange(len(off)) / UPDATE_HZ, 1e3 * off, color=colour, lw=1, label=dynamics if k == 0 else None)
    axes.set(xlabel="s", ylabel="mm off the path", yscale="log", title="A figure of eight in 10 s by model-predictive control")
    axes.grid(alpha=0.3)
    axes.legend()
    to.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(to, dpi=110)
    print(f"wrote {to}")


if __name__ == "__main__":
    main()
