# %% [markdown]
# # Randomisation and swarms
#
# Many worlds at once, each with other vehicles, other numbers and other weather: what differs between worlds, how drones
# of one world feel each other, and how a stage of one's own takes part in every step.

# %%
import matplotlib.pyplot as plt
import numpy as np

import propwash

plt.rcParams.update({"figure.dpi": 80, "font.size": 9})
print(propwash.vehicles())

# %% [markdown]
# ## Numbers that differ between worlds
#
# Rules say what is drawn anew at every reset. The same seed gives the same bits, for any number of threads and worlds. Here
# 200 worlds get other masses and starts, and each drone is told to stay where it is.

# %%
rules = [
    {"parameter": "body.mass_kg", "draw": {"scale": [0.85, 1.15]}},
    {"parameter": "initial.pos.*", "draw": {"uniform": [-0.5, 0.5]}},
]
sim = propwash.Sim(n_worlds=200, control="state", randomization=rules, seed=7)
sim.reset()
mass = sim.parameter("body.mass_kg")[:, 0]
start = sim.data.pos.copy()
sim.state_control(propwash.Command.hover(start))
height = []
for _ in range(100):
    sim.step(20)
    height.append(sim.data.pos[:, 0, 2] - start[:, 0, 2])
height = np.array(height)

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
colours = plt.get_cmap("coolwarm")((mass - mass.min()) / np.ptp(mass))
for world in range(0, 200, 4):
    left.plot(np.arange(1, 101) * 0.04, 100.0 * height[:, world], color=colours[world], linewidth=0.7)
left.set(title="height off by; blue: light, red: heavy", xlabel="time, s", ylabel="cm")
right.plot(1000.0 * mass, 100.0 * height[-1], ".")
right.set(title="height off by after 4 s, over mass", xlabel="mass, g", ylabel="cm")
plt.show()

# %% [markdown]
# The firmware's controller does not know these masses: what is heavier hangs lower until its integral has caught up.
#
# ## Mixed vehicles in one world
#
# A list of vehicles, one for each drone. An effect is a table of a vehicle file; here the small drones feel the jets of those
# above them (`downwash`). The built-in vehicles have `linear_drag` in their files, through which they feel wind.

# %%
JET = """
[[effect]]
kind = "downwash"
drag_area_m2 = 0.005
spread = 0.1
"""
plain = propwash.Vehicle("cf2x_L250")
sim = propwash.Sim(n_worlds=2, drone=["cf21B_500", plain.with_effects(JET)], control="state", precision="f64")
sim.set_parameter("effect.downwash.drag_area_m2", [0.0, 0.005], drone=1)  # none in the first world
sim.set_initial(pos=[[-1.5, 0.0, 1.6], [0.0, 0.0, 1.0]])
sim.reset()
pos, vel = np.zeros((2, 2, 3)), np.zeros((2, 2, 3))
pos[:, 1, 2], vel[:, 0, 0] = 1.0, 0.5
below = []
for tick in range(300):
    pos[:, 0] = [-1.5 + 0.01 * tick, 0.0, 1.6]  # the other passes above with 0.5 m/s
    sim.state_control(propwash.Command.state(pos, vel))
    sim.step(10)
    below.append(sim.data.pos[:, 1, 2].copy())
below = np.array(below)

# %%
figure, axes = plt.subplots(figsize=(6.5, 3.2), layout="constrained")
axes.plot(np.arange(300) / 50.0, 100.0 * (below[:, 1] - below[:, 0]))
axes.set(title="what the jet does to a drone 0.6 m below, met at 3 s", xlabel="time, s", ylabel="height with less without, cm")
plt.show()

# %% [markdown]
# ## A stage of one's own
#
# A stage is a function of all arrays of all worlds, called once in every step; it writes into them. This one makes gusts that
# differ between worlds, and pushes every drone from its neighbours.

# %%
N_WORLDS, N_DRONES = 3, 8
sim = propwash.Sim(
    N_WORLDS, drone=["cf2x_L250", "cf21B_500"] * (N_DRONES // 2), control="state", scene="../xml/room.xml", seed=3,
    randomization=[{"parameter": "body.mass_kg", "draw": {"scale": [0.95, 1.05]}}],
)
strength = np.array([0.0, 1.0, 3.0])  # m/s, one for each world


def gusts(data):
    t = data.steps / 500.0
    data.wind[..., 1] = (strength * np.sin(2.0 * np.pi * 0.4 * t))[:, None]


def keep_apart(data):
    apart = data.pos[:, :, None] - data.pos[:, None]  # (worlds, drones, drones, 3)
    distance = np.linalg.norm(apart, axis=-1) + np.eye(N_DRONES)
    push = np.clip(0.4 - distance, 0.0, None) * 0.2 * (1.0 - np.eye(N_DRONES))
    data.disturbance_force[...] = (push[..., None] * apart / distance[..., None]).sum(axis=2)


sim.pipeline.insert_before("integration", "gusts", gusts)
sim.pipeline.insert_before("integration", "keep_apart", keep_apart)
print(sim.pipeline)


def places(t):
    """Where the drones of a world should be: a ring that turns, and draws together and apart again. (drones, 3)"""
    angle = 2.0 * np.pi * np.arange(N_DRONES) / N_DRONES + 0.4 * (t - np.tanh(t))
    radius = 1.0 - 0.45 * np.sin(np.pi * t / 8.0) ** 2
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(N_DRONES, 1.2)])


sim.set_initial(pos=places(0.0))
sim.reset()
paths, least, met = [], [], np.zeros((N_WORLDS, N_DRONES), bool)
for tick in range(400):
    t = tick / 50.0
    command = propwash.Command.state(places(t), (places(t + 0.01) - places(t - 0.01)) / 0.02)
    sim.state_control(np.broadcast_to(command, (N_WORLDS, N_DRONES, 16)))
    sim.step(10)
    near, contacts = sim.clearance(max_distance=1.0), sim.contacts()
    paths.append(sim.data.pos.copy())
    least.append(np.where(near.other_drone >= 0, near.distance, np.inf).min(axis=1))
    met |= contacts.touching
paths, least = np.array(paths), np.array(least)
for world in range(N_WORLDS):
    nearest, n = 100.0 * least[:, world].min(), met[world].sum()
    print(f"gusts of {strength[world]:.0f} m/s: drones come within {nearest:.1f} cm of each other, {n} touch something")

# %%
figure, all_axes = plt.subplots(1, N_WORLDS, figsize=(9.5, 3.6), layout="constrained", sharey=True)
for world, axes in enumerate(all_axes):
    for drone in range(N_DRONES):
        axes.plot(*paths[:, world, drone, :2].T, color="tab:blue" if drone % 2 == 0 else "tab:orange", linewidth=0.8)
        axes.plot(*paths[-1, world, drone, :2], "o", color="black", markersize=3)
    axes.set(title=f"gusts of {strength[world]:.0f} m/s along y", xlabel="x, m", aspect="equal")
all_axes[0].set_ylabel("y, m")
plt.show()

# %% [markdown]
# Blue: `cf2x_L250`, orange: `cf21B_500`. All drones see each other too:

# %%
frame = sim.depth_frame(propwash.Camera("fpv", resolution=(160, 120), range=(0.02, 8.0)), worlds=[2])
seen = [{sim.scene.geoms[g].drone for g in np.unique(frame.geom_id[0, d]) if g >= 0} - {None} for d in range(N_DRONES)]
for drone in (0, 1):
    print(f"drone {drone} sees the drones {sorted(seen[drone])}")
figure, (left, right) = plt.subplots(1, 2, figsize=(8.5, 3.2), layout="constrained")
for drone, axes in ((0, left), (1, right)):
    axes.imshow(np.where(frame.hit[0, drone], frame.depth[0, drone], np.nan), cmap="viridis_r", vmin=0.0, vmax=4.0)
    axes.set(title=f"what drone {drone} sees", xticks=[], yticks=[])
plt.show()
