"""A policy that was trained elsewhere flies vehicles that it has never met: RAPTOR, one small network for many quadrotors.

    pip install propwash foundation-policy
    python examples/raptor.py
    python examples/raptor.py cf2x_L250 my_quad.toml

It sees position, attitude, velocity and what it commanded last, and gives speeds of four rotors, a hundred times a second; in the first moments of a
flight it finds out by its memory what it flies (Eschmann, Albani and Loianno, "RAPTOR: A Foundation Policy for Quadrotor Control", 2025). Each
vehicle starts in 64 worlds, up to half a metre off its place, tilted and moving; printed is how far off it is after 8 s, and how many hover.
"""

import argparse

import numpy as np

import propwash

PLACE = np.array([0.0, 0.0, 2.0])
SECONDS, RATE_HZ, SIM_HZ = 8.0, 100, 500
#: Where the policy's rotors are (x forward, y left), and how they spin (1: counter-clockwise seen from above, by the drag on the body).
ORDER = ("front right", "back right", "back left", "front left")
SIDES = np.array([[1, -1], [-1, -1], [-1, 1], [1, 1]])


def rotors(vehicle: propwash.Vehicle) -> dict[str, np.ndarray]:
    """Places, spins and thrust curves of the rotors: (rotors, n) each."""
    numbers = dict(vehicle.parameters())
    n = sum(name.startswith("rotors.") and name.endswith(".spin") for name in numbers)
    return {
        key: np.array([[numbers.get(f"rotors.{k}.{key}.{i}", 0.0) for i in range(3)] for k in range(n)])
        for key in ("position_m", "thrust_curve")
    }


def fly(name: str, worlds: int, seed: int) -> str:
    raise NotImplementedError


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])


if __name__ == "__main__":
    main()
