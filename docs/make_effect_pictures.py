"""Draws for every effect what it leaves in a log when the model lacks it: docs/effects/NAME.png.

    cargo build --release && cargo build --release --example hidden_flight
    python docs/make_effect_pictures.py target/release [NAME ...]

For each effect an independent simulator flies a vehicle that has it (`examples/hidden_flight.rs`; the vehicle is off from its file by
manufacturing tolerances too, and the sensors are noisy). `propwash compare` says which force and torque the model lacks, `propwash add` fits
the effect and writes it into the vehicle file, and `compare` is asked again. Needs NumPy and matplotlib; takes some seconds for each effect.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

PAGES = Path(__file__).resolve().parent / "effects"

#: Effects that are hidden under another name, or for one axis or rotor of several.
HIDDEN = {
    "wrong_inertia": "wrong_inertia.x",
    "weak_rotor": "weak_rotor.2",
    "clock_offset": "clock_offset.pose",
    "thrust_fade": "battery_sag",
    "network": "rippled_push",
}
#: What is fitted where it is not what was hidden.
FITTED = {"battery_sag": "thrust_fade", "thrust_fade": "thrust_fade", "turbulence": None}
#: What the logs of an effect are read with.
READING = {"ceiling_effect": ["--ceiling-z", "3"]}
#: The axis that is drawn, and what it is drawn against in the second panel, if anything.
SHOW: dict[str, tuple[str, str | None]] = {
    "accel_bias": ("force_body_y", None),
    "actuator_saturation": ("torque_body_x", None),
    "battery_sag": ("force_body_z", None),
    "blade_flapping": ("torque_body_x", "velocity_left"),
    "ceiling_effect": ("force_body_z", "height"),
    "clock_offset": ("torque_body_z", None),
    "com_offset": ("torque_body_x", "rotor_speed"),
    "command_delay": ("torque_body_x", None),
    "constant_wind": ("force_world_x", None),
    "downwash": ("force_world_z", None),
    "ground_effect": ("force_body_z", "height"),
    "gust": ("force_world_x", None),
    "inflow": ("force_body_z", "velocity_up"),
    "linear_drag": ("force_body_x", "velocity_forward"),
    "motor_lag": ("torque_body_x", None),
    "mount": ("force_body_x", "rotor_speed"),
    "network": ("force_body_x", "velocity_forward"),
    "payload": ("force_body_z", "rotor_speed"),
    "quadratic_drag": ("force_body_x", "velocity_forward"),
    "rotor_drag": ("force_body_x", "velocity_forward"),
    "rotor_inertia": ("torque_body_z", None),
    "rotor_tilt": ("force_body_y", "rotor_speed"),
    "slung_payload": ("force_world_x", None),
    "thrust_curve": ("force_body_z", "rotor_speed"),
    "thrust_fade": ("force_body_z", None),
    "thrust_scale": ("force_body_z", "rotor_speed"),
    "torque_scale": ("torque_body_z", "yaw_rate"),
    "translational_lift": ("force_body_z", "speed"),
    "turbulence": ("force_world_x", None),
    "weak_rotor": ("torque_body_x", "rotor_speed"),
    "wrong_inertia": ("torque_body_x", None),
    "wrong_mass": ("force_body_z", "rotor_speed"),
}
#: Effects that leave no force and no torque: errors of short roll-outs show them.
ROLL_OUTS = {"gyro_bias", "gyro_scale", "sensor_offset", "world_tilt"}
#: Slow effects, drawn over the whole flight.
SLOW = {"battery_sag", "thrust_fade"}
#: Effects that `add` does not write, by its rules, or not alone: drawn with the true values.
TRUE = {"gyro_scale", "actuator_saturation", "world_tilt"}
#: Parameters of these that vehicle files call otherwise.
FILED = {("world_tilt", "rotation_rad"): "tilt_rad"}
#: Pages without a picture: what they write is the user's, or is set by the caller.
NONE = {"expression", "disturbance"}

BEFORE, AFTER, GREY = "#d55e00", "#0072b2", "#5d6370"

def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("programs", type=Path, help="folder of the program, such as target/release")
    parser.add_argument("names", nargs="*", help="effects; all if none is named")
    args = parser.parse_args()
    programs = args.programs.resolve()
    names = args.names or sorted(path.stem for path in PAGES.glob("*.md") if path.stem not in {"README", *NONE})
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            before, after = fly_and_compare(programs, name, Path(folder))
        draw(name, before, after, PAGES / f"{name}.png")
        print(name, flush=True)


def fly_and_compare(programs: Path, name: str, folder: Path) -> tuple[dict, dict | None]:
    """What `compare` says of a flight with the effect, for the vehicle as filed and with the effect."""

    def run(program: str, *words: str, fine: tuple[int, ...] = (0,)) -> str:
        done = subprocess.run([str(programs / program), *words], cwd=folder, capture_output=True, text=True)
        if done.returncode not in fine:
            raise SystemExit(f"{name}: {program} {' '.join(words)}: {done.stderr or done.stdout}")
        return done.stdout if done.returncode == 0 or "compare" in words else ""

    hidden = HIDDEN.get(name, name)
    flight = ["--effect", hidden, "--seed", "3", "--seconds", "40", "--out", "flight.csv", "--vehicle-out", "quad.toml"]
    run("examples/hidden_flight", *flight, "--truth", "truth.json")
    read = READING.get(name, [])
    before = json.loads(run("propwash", "compare", "flight.csv", "--vehicle", "quad.toml", "--json", *read, fine=(0, 1)))
    fitted = FITTED.get(name, hidden)
    if fitted is None:
        return before["logs"][0], None
    if name in TRUE:
        truth = json.loads((folder / "truth.json").read_text())["hidden"][0]["parameters"]
        lists: dict[str, list[float]] = {}
        for key, value in truth.items():
            field, *index = key.split(".")
            lists.setdefault(field, []).append(value if index else [value])
        rows = [f"{FILED.get((name, field), field)} = {values[0][0] if isinstance(values[0], list) else values}" for field, values in lists.items()]
        text = (folder / "quad.toml").read_text() + f'\n[[effect]]\nkind = "{name}"\n' + "\n".join(rows) + "\n"
        (folder / "better.toml").write_text(text)
    added = "--network" if name == "network" else fitted
    words = ["add", added, "--vehicle", "quad.toml", "--fit", "flight.csv", "--out", "better.toml", "--force", *read]
    if name not in TRUE:
        run("propwash", *words, fine=(0, 1))
    if not (folder / "better.toml").exists():
        return before["logs"][0], None
    after = json.loads(run("propwash", "compare", "flight.csv", "--vehicle", "better.toml", "--json", *read, fine=(0, 1)))
    return before["logs"][0], after["logs"][0]


def series(log: dict, axis: str) -> tuple[np.ndarray, np.ndarray]:
    """Times and the missing force (mN) or torque (mN·m) on an axis."""
    of = log["one_step"]["series"]
    key = {"force_body": "force_body_n", "force_world": "force_world_n", "torque_body": "torque_n_m"}[axis[:-2]]
    rows = np.array([row or [np.nan] * 3 for row in of[key]], float)
    return np.array(of["t_s"]), 1e3 * rows[:, "xyz".index(axis[-1])]


def draw(name: str, before: dict, after: dict | None, path: Path) -> None:
    plt.rcParams.update({"font.size": 8, "font.family": "DejaVu Sans", "axes.spines.top": False, "axes.spines.right": False})
    if name in ROLL_OUTS:
        return draw_roll_outs(name, before, after, path)
    axis, cause = SHOW[name]
    what, frame, letter = axis.split("_")
    unit = "mN" if what == "force" else "mN·m"
    figure, panels = plt.subplots(
        1, 2 if cause else 1, figsize=(7.6, 2.4), dpi=100, width_ratios=(1.5, 1) if cause else None, squeeze=False, layout="constrained"
    )
    left = panels[0, 0]
    left.axhline(0.0, color=GREY, linewidth=0.5)
    t, lack = series(before, axis)
    # Eight seconds in which most is missing; slow effects over the whole flight.
    span = 60.0 if name in SLOW or frame == "world" else 8.0
    starts = np.arange(t[0], max(t[-1] - span, t[0]) + 0.1, 0.5)
    start = starts[int(np.argmax([np.nansum(lack[(t >= s) & (t < s + span)] ** 2) for s in starts]))]
    for log, colour, words in ((before, BEFORE, "without"), (after, AFTER, "with")):
        if log is not None:
            t, lack = series(log, axis)
            shown = (t >= start) & (t < start + span)
            left.plot(t[shown], lack[shown], color=colour, linewidth=1.1, label=f"model {words} {name}")
    left.set(xlabel="time, s", ylabel=f"missing {what}\n{frame} {letter}, {unit}")
    left.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.0)
    if cause:
        against_cause(panels[0, 1], cause, axis, before, after, unit)
    save(figure, path)


def draw_roll_outs(name: str, before: dict, after: dict | None, path: Path) -> None:
    """Errors of roll-outs of 0.1 s, one pair of bars for each quantity."""
    quantities = [("position_m", "position, mm", 1e3), ("velocity_m_s", "velocity, mm/s", 1e3),
                  ("attitude_rad", "attitude, mrad", 1e3), ("rate_rad_s", "body rate, mrad/s", 1e3)]  # fmt: skip
    figure, panels = plt.subplots(1, len(quantities), figsize=(7.6, 1.5), dpi=100, layout="constrained")
    for panel, (key, words, times) in zip(panels, quantities):
        values = [times * log["horizons"][0]["error"][key] for log in (before, after) if log is not None]
        bars = panel.barh(["without", "with"][: len(values)], values, color=[BEFORE, AFTER][: len(values)], height=0.55)
        panel.bar_label(bars, fmt="%.3g", padding=2)
        panel.set(xlim=(0.0, 1.25 * max(values)), title=words, xticks=[])
        panel.title.set_fontsize(8)
        panel.invert_yaxis()
        panel.spines["bottom"].set_visible(False)
        if panel is not panels[0]:
            panel.set_yticks([])
    figure.suptitle(f"error of roll-outs of 0.1 s, model without and with {name}", x=0.01, ha="left", fontsize=8, color=GREY)
    save(figure, path)


def save(figure: plt.Figure, path: Path) -> None:
    """Writes a picture of 64 colours: lines on paper need no more, and the file is half as large."""
    figure.savefig(path, metadata={"Software": None})
    plt.close(figure)
    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(64)
    small.save(path, optimize=True)


def against_cause(axes: plt.Axes, name: str, axis: str, before: dict, after: dict | None, unit: str) -> None:
    """The missing force or torque, averaged by what it depends on."""
    axes.axhline(0.0, color=GREY, linewidth=0.5)
    for log, colour in ((before, BEFORE), (after, AFTER)):
        if log is None:
            continue
        cause = next(cause for cause in log["causes"] if cause["name"] == name)
        row = next(row for row in cause["responses"] if row["name"] == axis)
        means, errors = (1e3 * np.array(row[key], float) for key in ("means", "standard_errors"))
        axes.errorbar(cause["values"], means, errors, color=colour, linewidth=1.1, marker="o", markersize=3, elinewidth=0.7)
        axes.set(xlabel=f"{cause['title']}, {cause['unit']}", ylabel=f"mean, {unit}")


if __name__ == "__main__":
    main()
