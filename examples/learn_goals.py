"""Trains policies that reach places, land softly and race through gates, and one by PPO, and says how they fly in wind, late, weak and heavy.

    pip install propwash matplotlib
    python examples/learn_goals.py --picture out/learn_goals.png

Landings are trained twice, with a value network for what comes after a flight's end and without. Saves each policy beside the picture (docs/learn.md).
"""

import argparse
from pathlib import Path

import numpy as np

import propwash
from propwash import learn

VEHICLE = "cf21B_500"
#: What the vehicle has that the training did not.
OTHERS = {
    "as trained": "",
    "wind of 2 m/s": 'kind = "constant_wind"\nvelocity_m_s = [1.6, 1.2, 0.0]',
    "commands 5 ms late": 'kind = "command_delay"\ndelay_s = 0.005',
    "thrust 10 % weaker": 'kind = "thrust_scale"\nfactor = 0.9',
    "20 % heavier": 'kind = "wrong_mass"\nfactor = 1.2',
}


def trainings(seed: int) -> dict[str, learn.Trained]:
    return {
        "eight in 10 s, by PPO": learn.ppo(learn.Track(10.0), VEHICLE, seed=seed),
        "places": learn.bptt(learn.Reach(), VEHICLE, seed=seed),
        "landings": learn.bptt(learn.Land(), VEHICLE, seed=seed),
        "landings, no critic": learn.bptt(learn.Land(), VEHICLE, critic=False, seed=seed),
        "gate races": learn.bptt(learn.Gates(), VEHICLE, seed=seed),
    }


def other(effect: str) -> propwash.Vehicle:
    vehicle = propwash.Vehicle(VEHICLE)
    return vehicle.with_effects(f"[[effect]]\n{effect}\n") if effect else vehicle


def told(trained: learn.Trained, vehicle: propwash.Vehicle, flights: int) -> str:
    if isinstance(trained.goal, learn.Track):
        flown = trained.fly(vehicle, flights=100)
        lost = f", {flown.lost} of 100 lost" if flown.lost else ""
        return "all lost" if flown.lost == 100 else f"{1e3 * flown.error_rms:.1f} mm{lost}"
    flown = trained.fly(vehicle, flights=flights, settle=3.0)
    off = f", {1e3 * flown.error_rms:.0f} mm" if isinstance(trained.goal, learn.Reach) else ""
    return f"{flown.reached / flown.flights:.1%}{off}"


def draw(picture: Path, trained: dict[str, learn.Trained]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    shown = {name: one for name, one in trained.items() if name != "landings, no critic"}
    figure, axes = plt.subplots(2, 4, figsize=(15, 7), layout="constrained")
    for column, (name, one) in zip(axes.T, shown.items()):
        costs = {name: one} | ({"no critic": trained["landings, no critic"]} if name == "landings" else {})
        for color, (what, training) in zip(("#0072b2", "#999999"), costs.items()):
            # The mean of 20 updates, since in each some episodes have only begun.
            cost = np.convolve(training.cost, np.full(20, 0.05), "valid")
            column[0].plot(training.commands[19:] / 1e3, cost, color=color, linewidth=1, label=what)
        if len(costs) > 1:
            column[0].legend(loc="upper right")
        column[0].set(yscale="log", title=name, xlabel="thousand commands", ylabel="mean cost of a command")
        paths = [one.fly(flights=1, settle=0.0, seed=seed).path for seed in range(1 if isinstance(one.goal, learn.Track) else 12)]
        across = (0, 1) if isinstance(one.goal, learn.Gates) else (0, 2)
        if isinstance(one.goal, learn.Track):
            turn = np.linspace(0, 2 * np.pi, 200)
            column[1].plot(np.sin(turn), 1 + 0.5 * np.sin(2 * turn), color="#999999", linewidth=4)
        for path in paths:
            column[1].plot(*path[:, across].T, linewidth=1)
            column[1].plot(*path[-1, across], "k.", markersize=4)
        if isinstance(one.goal, learn.Gates):
            for angle in 0.4 * np.pi * np.arange(5):
                for low, high, color, width in ((1.7, 2.3, "#009e73", 2), (1.6, 1.7, "#d55e00", 4), (2.3, 2.4, "#d55e00", 4)):
                    ends = np.array([low, high])
                    column[1].plot(ends * np.cos(angle), ends * np.sin(angle), color=color, linewidth=width)
        column[1].set(xlabel="x, m", ylabel="y, m" if across == (0, 1) else "z, m", aspect="equal")
    figure.savefig(picture, dpi=100)
    plt.close(figure)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--picture", type=Path, default=Path("out/learn_goals.png"), help="where the picture goes; policies are saved beside it")
    arguments.add_argument("--seed", type=int, default=0, help="seed of the trainings")
    arguments.add_argument("--flights", type=int, default=1000, help="flights of each policy on each vehicle")
    arguments.add_argument("--no-picture", action="store_true", help="trains and flies only")
    args = arguments.parse_args()
    args.picture.parent.mkdir(parents=True, exist_ok=True)
    trained = trainings(args.seed)
    for number, (name, one) in enumerate(trained.items(), 1):
        print(f"{name}: {int(one.commands[-1])} commands in {one.seconds:.2f} s")
        one.policy.save(args.picture.with_name(f"learn_goals_{number}.npz"), force=True)
    print("| the vehicle | " + " | ".join(trained) + " |")
    print("| --- |" + " ---: |" * len(trained))
    for what, effect in OTHERS.items():
        vehicle = other(effect)
        print(f"| {what} | " + " | ".join(told(one, vehicle, args.flights) for one in trained.values()) + " |")
    if not args.no_picture:
        draw(args.picture, trained)
        print(f"wrote {args.picture}")


if __name__ == "__main__":
    main()
