"""A hover controller from the simulator's own slopes: a linear-quadratic regulator (LQR) of `Sim.linearize`.

    pip install propwash scipy matplotlib
    python examples/lqr.py --picture out/lqr.png

Linearises one step of 10 ms about hover by rotor speeds, solves the Riccati equation, and flies 256 drones from far off and tilted starts by the gains that come
out, with the whole model: rotors that lag, drag, limits. Says how many hover after 4 s, and from how far.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.linalg import solve_discrete_are

import propwash

VEHICLE = "cf21B_500"
SUBSTEPS = 5
#: How much each part of the state may be off, and how much a rotor speed may change, in the units of the state: what the weights are made of.
TOLERATED = {"pos": 0.3, "turn": 0.3, "vel": 1.0, "ang_vel": 6.0, "rotor_vel": 1e9}
TOLERATED_ROTOR = 300.0


def gains() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gains (rotor, 16) on position, rotation vector, velocity, angular velocity and rotor speeds; the speeds of hover; eigenvalues of the loop."""
    sim = propwash.Sim(1, drone=VEHICLE, control="rotor_vel", precision="f64")
    hover = sim.hover_rotor_vel()
    sim.rotor_vel_control(hover)
    a, b = (m[0, 0] for m in sim.linearize(SUBSTEPS))
    # Attitudes near level: x, y, z of the quaternion are half a rotation vector, w stays 1; thrust is no state of this model.
    wide = np.zeros((18, 16))
    wide[0:3, 0:3], wide[3:6, 3:6] = np.eye(3), 0.5 * np.eye(3)
    wide[7:17, 6:16] = np.eye(10)
    narrow = np.linalg.pinv(wide)
    a, b = narrow @ a @ wide, narrow @ b
    tolerated = np.repeat(list(TOLERATED.values()), (3, 3, 3, 3, 4))
    q, r = np.diag(tolerated**-2.0), np.eye(4) * TOLERATED_ROTOR**-2.0
    p = solve_discrete_are(a, b, q, r)
    k = np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)
    return k, hover[0, 0], np.linalg.eigvals(a - b @ k)


def turn(quat: np.ndarray) -> np.ndarray:
    """Rotation vectors of attitudes x y z w."""
    quat = quat * np.where(quat[..., 3:] < 0, -1.0, 1.0)
    sine = np.linalg.norm(quat[..., :3], axis=-1, keepdims=True)
    return 2 * np.arctan2(sine, quat[..., 3:]) * quat[..., :3] / np.maximum(sine, 1e-9)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--worlds", type=int, default=256, help="number of flights")
    arguments.add_argument("--picture", type=Path, help="where the picture goes")
    args = arguments.parse_args()
    k, hover, loop = gains()
    print(f"largest eigenvalue of the loop: {abs(loop).max():.4f} in 10 ms")
    n = args.worlds
    sim = propwash.Sim(n, drone=VEHICLE, control="rotor_vel")
    draws = np.random.default_rng(5)
    goal = np.array([0.0, 0.0, 1.0])
    axis = draws.normal(size=(n, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    half = 0.5 * draws.uniform(0, np.radians(40), (n, 1))
    quat = np.concatenate([axis * np.sin(half), np.cos(half)], -1)
    off = draws.uniform(-0.6, 0.6, (n, 3))
    sim.set_initial(pos=(goal + off)[:, None], quat=quat[:, None], vel=draws.uniform(-0.8, 0.8, (n, 1, 3)))
    sim.reset()
    path = []
    for _ in range(400):
        data = sim.data
        x = np.concatenate([data.pos[:, 0] - goal, turn(data.quat[:, 0]), data.vel[:, 0], data.ang_vel[:, 0], data.rotor_vel[:, 0] - hover], -1)
        sim.rotor_vel_control(np.clip(hover - x @ k.T, 0.4 * hover, 1.2 * hover)[:, None])
        sim.step(SUBSTEPS)
        path.append(np.linalg.norm(sim.data.pos[:, 0] - goal, axis=-1))
    error = np.array(path)
    still = (error[-1] < 0.02) & (np.linalg.norm(sim.data.vel[:, 0], axis=-1) < 0.05)
    print(f"{still.sum()} of {n} hover within 2 cm after 4 s, from up to {error[0].max():.2f} m and 40 degrees off; median {1e3 * np.median(error[-1]):.2f} mm")
    if args.picture:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot as plt

        figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
        axis.semilogy(0.01 * np.arange(1, 401), error, color="#0072b2", linewidth=0.4)
        axis.set(xlabel="s", ylabel="distance to the goal, m", title=f"{n} flights by the gains of Sim.linearize")
        args.picture.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(args.picture, dpi=90)
        print(f"wrote {args.picture}")


if __name__ == "__main__":
    main()
