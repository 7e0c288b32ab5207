"""A policy that was trained elsewhere flies vehicles that it has never met: RAPTOR, one small network for many quadrotors.

    pip install propwash foundation-policy
    python examples/raptor.py
    python examples/raptor.py cf2x_L250 my_quad.toml

It sees position, attitude, velocity and what it commanded last, and gives speeds of four rotors, a hundred times a second; what it flies, it
finds out in flight, by its memory (Eschmann, Albani and Loianno, "RAPTOR: A Foundation Policy for Quadrotor Control", 2025). Each vehicle
starts in 64 worlds, up to half a metre off its place along each axis, tilted and moving. Printed is how far off it is after 8 s, and in how
many worlds it hovers: less than 0.3 m off and slower than 0.3 m/s.
"""

import argparse
import sys

import numpy as np

import propwash

PLACE = np.array([0.0, 0.0, 2.0])
SECONDS, RATE_HZ, SIM_HZ = 8.0, 100, 500
#: Where the rotors that the policy commands are (signs of x forward and y left), in its order, and their spins as vehicle files write them.
SIDES = [(1, -1), (-1, -1), (-1, 1), (1, 1)]
SPINS = [-1, 1, -1, 1]


class CannotFly(Exception):
    """Why the policy cannot fly a vehicle."""


def rotors(vehicle: propwash.Vehicle) -> tuple[list[int], float, float]:
    """Numbers of the rotors in the order of the policy, and their least and greatest speed, rad/s."""
    if "first_principles" not in vehicle.dynamics or "rotor_vel" not in vehicle.modes():
        raise CannotFly("its file has no rotors that take speeds as commands")
    numbers = dict(vehicle.parameters())
    n = sum(name.startswith("rotors.") and name.endswith(".spin") for name in numbers)
    if n != 4:
        raise CannotFly(f"it has {n} rotors; the policy commands four")
    sides = [tuple(int(np.sign(round(numbers[f"rotors.{k}.position_m.{axis}"], 6))) for axis in (0, 1)) for k in range(n)]
    if sorted(sides) != sorted(SIDES):
        raise CannotFly("its rotors are not one in each of front right, back right, back left and front left")
    order = [sides.index(side) for side in SIDES]
    if [numbers[f"rotors.{k}.spin"] for k in order] != SPINS:
        raise CannotFly("its rotors spin the other way round: the policy would turn it the wrong way")
    c0, c1, c2 = (numbers[f"rotors.0.thrust_curve.{k}"] for k in range(3))
    thrusts = [numbers[f"controller.{key}"] for key in ("thrust_min_n", "thrust_max_n")]
    least, most = ((-c1 + np.sqrt(c1 * c1 + 4 * c2 * (thrust - c0))) / (2 * c2) for thrust in thrusts)
    return order, float(least), float(most)


def rotation(quat: np.ndarray) -> np.ndarray:
    """Rotation matrices, row by row, of quaternions x y z w. (n, 9)"""
    x, y, z, w = quat.T
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)]
    rows += [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)]
    rows += [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]
    return np.stack(rows, axis=-1)


def fly(name: str, policy, worlds: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the place, m, and speeds, m/s, at the end. (worlds,) each"""
    vehicle = propwash.Vehicle(name)
    order, least, most = rotors(vehicle)
    sim = propwash.Sim(worlds, drone=vehicle, control="rotor_vel", freq=SIM_HZ, rotor_start="hover")
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(worlds, 1, 4)) * [0.1, 0.1, 0.1, 0.0] + [0.0, 0.0, 0.0, 1.0]
    sim.set_initial(
        pos=PLACE + rng.uniform(-0.5, 0.5, (worlds, 1, 3)),
        quat=quat / np.linalg.norm(quat, axis=-1, keepdims=True),
        vel=0.3 * rng.normal(size=(worlds, 1, 3)),
        ang_vel=0.5 * rng.normal(size=(worlds, 1, 3)),
    )
    sim.reset()
    policy.reset()
    action = np.zeros((worlds, 4))
    command = np.zeros((worlds, 1, 4))
    for _ in range(int(SECONDS * RATE_HZ)):
        pos, quat, vel, ang_vel = (np.asarray(x[:, 0], np.float64) for x in (sim.data.pos, sim.data.quat, sim.data.vel, sim.data.ang_vel))
        seen = [np.clip(pos - PLACE, -1, 1), rotation(quat), np.clip(vel, -2, 2), ang_vel, action]
        action = np.clip(policy.evaluate_step(np.concatenate(seen, axis=-1)), -1.0, 1.0)
        command[:, 0, order] = least + 0.5 * (action + 1.0) * (most - least)
        sim.rotor_vel_control(command)
        sim.step(SIM_HZ // RATE_HZ)
    return np.linalg.norm(sim.data.pos[:, 0] - PLACE, axis=-1), np.linalg.norm(sim.data.vel[:, 0], axis=-1)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("vehicles", nargs="*", help="names or vehicle files; all built-in ones if not given")
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    try:
        from foundation_policy import Raptor
    except ImportError:
        print("this flies the policy of the package foundation-policy, which is not installed: pip install foundation-policy", file=sys.stderr)
        return 2
    policy = Raptor()
    for name in args.vehicles or propwash.vehicles():
        try:
            off, speed = fly(name, policy, args.worlds, args.seed)
        except CannotFly as why:
            print(f"{name}: not flown: {why}")
            continue
        hovers = (off < 0.3) & (speed < 0.3)
        part = 100 * hovers.mean()
        print(f"{name}: after {SECONDS:g} s {1e3 * np.median(off):.0f} mm off (median), hovers in {part:.0f} % of {args.worlds} worlds")
    return 0


if __name__ == "__main__":
    sys.exit(main())
