# %% [markdown]
# # Find the gap
#
# A flight log, and a model that does not explain it: where does it fail, what is missing, and how good is the model with that
# added? The flight is simulated, with a drag that the model does not know, so that the answer can be checked. With a log of
# your own start at *Compare*; [logs.md](../docs/logs.md) says what a log holds.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

import propwash

plt.rcParams.update({"figure.dpi": 80, "font.size": 9})

# %% [markdown]
# ## A flight with a secret
#
# `cf2x_L250` with quadratic drag flies a figure of eight for 12 s. What would be measured goes into columns of a log: pose,
# velocity, body rates, rotor commands; 250 Hz, each with some noise.

# %%
HIDDEN = """
[[effect]]
kind = "quadratic_drag"
drag_n_s2_per_m2 = [0.02, 0.02, 0.03]
"""
NAMES = "t px py pz qx qy qz qw vx vy vz wx wy wz cmd_rotor1 cmd_rotor2 cmd_rotor3 cmd_rotor4".split()


def fly(vehicle, seconds, seed, turn=1.2):
    """A log by column name."""
    sim = propwash.Sim(drone=vehicle, precision="f64")
    sim.set_initial(pos=[0.0, 0.0, 5.0])
    sim.reset()
    rng = np.random.default_rng(seed)
    rows = []
    for step in range(500 * seconds):
        t = step / 500.0
        grown = min(t / 2.0, 1.0) ** 2 * (3.0 - 2.0 * min(t / 2.0, 1.0))
        angle = turn * t
        place = [1.5 * np.sin(angle), 0.9 * np.sin(1.7 * angle), 0.3 * np.sin(0.7 * angle)]
        vel = [1.5 * grown * turn * np.cos(angle), 1.53 * grown * turn * np.cos(1.7 * angle), 0.0]
        sim.state_control(propwash.Command.state([[grown * np.array(place) + [0.0, 0.0, 5.0]]], [[vel]]))
        d = sim.data
        measured = np.concatenate([d.pos[0, 0], d.quat[0, 0], d.vel[0, 0], d.ang_vel[0, 0]])
        sim.step()
        if step % 2 == 0:
            noise = rng.normal(size=13) * ([5e-4] * 3 + [2e-4] * 4 + [2e-3] * 3 + [5e-3] * 3)
            rows.append([t, *(measured + noise), *d.rotor_command[0, 0]])
    table = np.array(rows)
    table[:, 4:8] /= np.linalg.norm(table[:, 4:8], axis=1, keepdims=True)
    return dict(zip(NAMES, table.T))


model = propwash.Vehicle("cf2x_L250")
truth = model.with_effects(HIDDEN)
log = fly(truth, seconds=12, seed=0)
speed = np.sqrt(log["vx"] ** 2 + log["vy"] ** 2 + log["vz"] ** 2)
print(f"{len(log['t'])} samples, {log['t'][-1]:.1f} s, up to {speed.max():.1f} m/s")

# %% [markdown]
# ## Compare
#
# The model starts from measured states again and again and is driven by the logged rotor commands. `compare` says how far it
# is off after 0.1 to 1 s, and whether the noise of the sensors explains that.

# %%
before = propwash.compare(log, model)
print(before)
before.to_frame().drop(columns="log").round(4)

# %% [markdown]
# What the residuals go with, in words:

# %%
for finding in before.logs[0].findings:
    print("-", finding)

# %% [markdown]
# ## Diagnose
#
# Which effect would explain it, with what intervals, and what looks alike? Three candidates are enough here; without that
# argument all effects of air, mass, drive and sensors are tried. The last fifth of the log is kept apart to check the result.

# %%
verdict = propwash.diagnose(log, model, candidates=["quadratic_drag", "wrong_mass", "payload"])
print(verdict.verdict)
verdict.to_frame()

# %% [markdown]
# What was hidden: 0.02, 0.02 and 0.03 N·s²/m². The ladder shows the errors with each step:

# %%
Image(verdict.ladder_png, width=720)

# %% [markdown]
# `verdict.report.save("gap.html")` writes a page with all of it: what the log can show, what could hide in it, and which flight
# would tell more. `verdict.report.show()` shows that page in a notebook.
#
# ## Add
#
# `add` fits named effects and writes a vehicle file, with standard deviations, the hash of the log and the date. Nothing is
# written that raises the error on unseen flight; parameters within their tolerance stay as filed without `calibrate=True`.

# %%
folder = tempfile.TemporaryDirectory()
better_file = Path(folder.name) / "better.toml"
propwash.add("quadratic_drag", log, model, better_file)
better = propwash.Vehicle(better_file)
print(better_file.read_text().split('kind = "quadratic_drag"')[1].split("source")[0].strip())

# %% [markdown]
# ## The error falls
#
# A second flight, faster and with other noise, which no fit has seen:

# %%
unseen = fly(truth, seconds=12, seed=1, turn=1.4)
results = {"as filed": propwash.compare(unseen, model), "with the drag that was found": propwash.compare(unseen, better)}
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
for (label, result), colour in zip(results.items(), ("tab:red", "tab:green")):
    horizons = result.logs[0].horizons
    seconds = [h.horizon_s for h in horizons]
    left.plot(seconds, [100.0 * h.position_m for h in horizons], "o-", color=colour, label=label)
    right.plot(seconds, [100.0 * h.velocity_m_s for h in horizons], "o-", color=colour, label=label)
    print(f"{label}: {result.verdict}")
left.set(title="error of the position", xlabel="s after a measured state", ylabel="cm", yscale="log")
right.set(title="error of the velocity", xlabel="s after a measured state", ylabel="cm/s", yscale="log")
left.legend()
plt.show()

# %% [markdown]
# After 1 s the position was off by 1.3 m, now by 2 cm, about twice what the noise of the sensors makes. The vehicle flies like
# any other: `propwash.Sim(drone=better)`.

# %%
folder.cleanup()
