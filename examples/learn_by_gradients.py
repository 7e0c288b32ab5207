"""Trains three policies by the gradients of their flights, in a third of a second, and says how they fly in wind, late, weak and heavy.

    pip install propwash matplotlib
    python examples/learn_by_gradients.py --picture out/learn.png

The figure of eight by attitudes, faster by rotor speeds, and throws (docs/learn.md). Saves each policy beside the picture.
"""

import argparse
from pathlib import Path

import numpy as np

import propwash
from propwash import learn

VEHICLE = "cf21B_500"
TASKS = {
    "eight in 10 s, by attitudes": (learn.Track(10.0), "attitude"),
    "eight in 5.5 s, by rotor speeds": (learn.Track(5.5), "rotor_vel"),
    "throws": (learn.Recover(), "attitude"),
}
#: What the vehicle has that the training did not.
OTHERS = {
    "as trained": "",
    "wind of 2 m/s": 'kind = "constant_wind"\nvelocity_m_s = [1.6, 1.2, 0.0]',
    "commands 5 ms late": 'kind = "command_delay"\ndelay_s = 0.005',
    "thrust 10 % weaker": 'kind = "thrust_scale"\nfactor = 0.9',
    "20 % heavier": 'kind = "wrong_mass"\nfactor = 1.2',
}


def other(effect: str) -> propwash.Vehicle:
    vehicle = propwash.Vehicle(VEHICLE)
    return vehicle.with_effects(f"[[effect]]\n{effect}\n") if effect else vehicle


def told(goal: learn.Goal, flights: learn.Flights) -> str:
    if isinstance(goal, learn.Recover):
        return f"{flights.reached / flights.flights:.1%} caught"
    if flights.lost == flights.flights:
        return "all lost"
    lost = f", {flights.lost} of {flights.flights} lost" if flights.lost else ""
    return f"{1e3 * flights.error_rms:.1f} mm{lost}"


def draw(picture: Path, trained: dict[str, learn.Trained]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(12, 7), layout="constrained")
    for column, (name, one) in zip(axes.T, trained.items()):
        column[0].plot(one.commands / 1e3, one.cost, color="#0072b2", linewidth=1)
        column[0].set(yscale="log", title=f"{name}\n{one.seconds:.2f} s", xlabel="thousand commands", ylabel="mean cost of a command")
        if isinstance(one.goal, learn.Recover):
            for seed in range(12):
                path = one.fly(flights=1, settle=0.0, seed=seed).path
                column[1].plot(path[:, 0], path[:, 2], linewidth=1)
                column[1].plot(*path[-1, [0, 2]], "k.", markersize=4)
        else:
            path = one.fly(flights=1).path
            turn = np.linspace(0, 2 * np.pi, 200)
            column[1].plot(np.sin(turn), 1 + 0.5 * np.sin(2 * turn), color="#999999", linewidth=4, label="path")
            column[1].plot(path[:, 0], path[:, 2], color="#d55e00", linewidth=1, label="flown")
            column[1].legend(loc="upper right")
        column[1].set(xlabel="x, m", ylabel="z, m", aspect="equal")
    figure.savefig(picture, dpi=100)
    plt.close(figure)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--picture", type=Path, default=Path("out/learn.png"), help="where the picture goes; policies are saved beside it")
    arguments.add_argument("--seed", type=int, default=0, help="seed of the trainings")
    arguments.add_argument("--no-picture", action="store_true", help="trains and flies only")
    args = arguments.parse_args()
    args.picture.parent.mkdir(parents=True, exist_ok=True)
    trained = {}
    for name, (goal, action) in TASKS.items():
        trained[name] = learn.bptt(goal, VEHICLE, action=action, seed=args.seed)
        print(f"{name}: {int(trained[name].commands[-1])} commands in {trained[name].seconds:.2f} s")
        trained[name].policy.save(args.picture.with_name(f"learn_{len(trained)}.npz"), force=True)
    flights = {"throws": 1000}
    print("| the vehicle | " + " | ".join(TASKS) + " |")
    print("| --- |" + " ---: |" * len(TASKS))
    for what, effect in OTHERS.items():
        flown = [told(one.goal, one.fly(other(effect), flights=flights.get(name, 100))) for name, one in trained.items()]
        print(f"| {what} | " + " | ".join(flown) + " |")
    if not args.no_picture:
        draw(args.picture, trained)
        print(f"wrote {args.picture}")


if __name__ == "__main__":
    main()
