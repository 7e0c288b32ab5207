"""Controllers: one of one's own, and those of other firmware, on the same vehicle.

    pip install propwash matplotlib
    python examples/own_controller.py --picture out/own_controller.png

A cascade of a few lines, Lee's law, incremental dynamic inversion and the controller on board follow a figure of eight, in still air and in a wind that none of them knows; the laws of PX4, ArduPilot and
Betaflight take up steps of what they hold. Each is a Python function that runs once: nothing of Python runs in flight.
"""

import argparse
from pathlib import Path

import numpy as np

import propwash
from propwash import controllers

WIND = '[[effect]]\nkind = "constant_wind"\nvelocity_m_s = [2.0, 1.0, 0.0]\n'
HZ = 500


@propwash.controller
def cascade(s, position=4.0, attitude=12.0):
    """Place to lean to torque, each a spring with a damper; yaw is held at 0."""
    wanted = s.command[6:9] + position**2 * (s.command[0:3] - s.pos) + 2 * position * (s.command[3:6] - s.vel)
    side = np.clip(wanted[:2], -4, 4) / s.vehicle.gravity
    turn = np.array([-side[1] - s.roll, side[0] - s.pitch, -s.yaw], dtype=object)
    torque = s.vehicle.inertia @ (attitude**2 * turn - 2 * attitude * s.ang_vel)
    lift = s.vehicle.mass * (s.vehicle.gravity + np.clip(wanted[2], -4, 4)) / np.clip(np.cos(s.roll) * np.cos(s.pitch), 0.5, 1)
    s.mix(lift, torque, lag=0.02)


def eight(t):
    """Place, velocity and acceleration of a figure of eight in 5 s, m. (9,)"""
    w = 2 * np.pi / 5
    x, y = np.sin(w * t), 0.5 * np.sin(2 * w * t)
    vx, vy = w * np.cos(w * t), w * np.cos(2 * w * t)
    ax, ay = -w * w * x, -2 * w * w * np.sin(2 * w * t)
    return np.array([x, y, 1.0, vx, vy, 0.0, ax, ay, 0.0])


def follow(vehicle, seconds):
    """Flies the eight; where it was, and how far off in the second half, m."""
    sim = propwash.Sim(1, drone=vehicle, control="state")
    command = np.zeros_like(sim.data.command)
    command[..., 12] = 1
    sim.data.pos[...], sim.data.vel[...] = eight(0.0)[:3], eight(0.0)[3:6]
    path, off = [], []
    for k in range(int(seconds * 100)):
        command[..., :9] = eight(k / 100)
        sim.data.command[...] = command
        sim.step(HZ // 100)
        path.append(sim.data.pos[0, 0].copy())
        off.append(np.linalg.norm(path[-1] - eight((k + 1) / 100)[:3]))
    return np.array(path), float(np.sqrt(np.mean(np.square(off[len(off) // 2 :]))))


def steps(vehicle, control):
    """Takes up a roll of 0.4 rad (`attitude`) or 2 rad/s (`body_rate`) after 0.1 s; what it did over 0.6 s."""
    sim = propwash.Sim(1, drone=vehicle, control=control)
    sim.data.command[..., 3] = float(sim.hover_thrust()[0, 0])
    out = []
    for k in range(300):
        if k == 50:
            sim.data.command[..., 0] = 0.4 if control == "attitude" else 2.0
        sim.step(1)
        x, y, z, w = sim.data.quat[0, 0]
        out.append(np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)) if control == "attitude" else sim.data.ang_vel[0, 0, 0])
    return np.array(out)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--drone", default="cf21B_500", help="vehicle that they fly")
    arguments.add_argument("--seconds", type=float, default=10.0, help="length of a flight")
    arguments.add_argument("--picture", type=Path, help="where the picture goes")
    args = arguments.parse_args()
    vehicle = propwash.Vehicle(args.drone)
    laws = {"a cascade": cascade, "lee": controllers.lee(), "indi": controllers.indi(), "on board": None}
    paths = {}
    print("figure of eight in 5 s: root mean square distance to where it should be, in still air and in wind that nobody knows")
    for name, law in laws.items():
        own = vehicle if law is None else law.on(vehicle)
        path, still = follow(own, args.seconds)
        paths[name], windy = path, follow(own.with_effects(WIND), args.seconds)[1]
        print(f"  {name:9s} {1000 * still:6.0f} mm {1000 * windy:6.0f} mm")
    turns = {
        "roll, rad": {"px4": controllers.px4(), "ardupilot": controllers.ardupilot(), "on board": None},
        "roll rate, rad/s": {"betaflight": controllers.betaflight(), "on board": None},
    }
    answers = {
        title: {name: steps(vehicle if law is None else law.on(vehicle), "attitude" if k == 0 else "body_rate") for name, law in group.items()}
        for k, (title, group) in enumerate(turns.items())
    }
    for title, group in answers.items():
        size = 0.4 if "rate" not in title else 2.0
        risen = {name: np.argmax(values > 0.9 * size) - 50 if (values > 0.9 * size).any() else None for name, values in group.items()}
        print(f"{title}: 90 % of the step after " + ", ".join(f"{name} {'-' if n is None else f'{2 * n} ms'}" for name, n in risen.items()))
    if args.picture:
        draw(args.picture, paths, answers)
        print(f"wrote {args.picture}")


def draw(picture: Path, paths: dict, answers: dict) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 1 + len(answers), figsize=(15, 4.2), layout="constrained")
    asked = np.array([eight(t) for t in np.linspace(0, 5, 400)])
    axes[0].plot(asked[:, 0], asked[:, 1], color="#bbbbbb", linewidth=5, label="asked")
    for name, path in paths.items():
        axes[0].plot(path[:, 0], path[:, 1], label=name, linewidth=1.2)
    axes[0].set(aspect="equal", xlabel="x, m", ylabel="y, m", title="figure of eight in 5 s, still air", ylim=(-0.75, 1.05))
    axes[0].legend(ncol=3, fontsize=8, loc="upper center")
    for axis, (title, group) in zip(axes[1:], answers.items()):
        for name, values in group.items():
            axis.plot(np.arange(len(values)) / HZ, values, label=name)
        size = 0.4 if "rate" not in title else 2.0
        axis.step([0, 0.1, 0.6], [0, size, size], where="post", color="#bbbbbb", label="asked")
        axis.set(xlabel="s", title=title)
        axis.legend(fontsize=8)
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    main()
