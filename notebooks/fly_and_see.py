# %% [markdown]
# # Fly and see
#
# Four drones fly through the forest, each in a world of its own. On the way they tell how near they come to the next
# thing and what they touch; then they look ahead, and their depth images become points in the world.

# %%
import matplotlib.pyplot as plt
import numpy as np

import propwash

plt.rcParams.update({"figure.dpi": 80, "font.size": 9})
sim = propwash.Sim(n_worlds=4, drone="cf2x_L250", control="state", scene="../xml/forest.xml")
sim

# %% [markdown]
# ## Flying
#
# Every world starts at another y and flies along x with 1.5 m/s, straight through whatever stands there. Arrays are
# (worlds, drones, …); `Command.state` makes commands of the `state` mode: position, velocity, acceleration and heading.

# %%
start = np.array([[-6.0, y, 1.2] for y in (-3.0, -1.0, 1.0, 3.0)])[:, None]  # (4, 1, 3)
sim.set_initial(pos=start)
sim.reset()
path, near, touched = [], [], []
names_touched = set()
for tick in range(400):  # 8 s; senses at 50 Hz, the equations at 500 Hz
    t = tick / 50.0
    travelled = 1.5 * (t - np.tanh(t))  # a soft start
    vel = [1.5 * np.tanh(t) ** 2, 0.0, 0.0]
    sim.state_control(propwash.Command.state(start + [travelled, 0.0, 0.0], vel))
    sim.step(10)
    clearance, contacts = sim.clearance(max_distance=3.0), sim.contacts()
    path.append(sim.data.pos[:, 0].copy())
    near.append(clearance.distance[:, 0])
    touched.append(contacts.touching[:, 0])
    names_touched |= {(int(w), sim.scene.bodies[b].name) for w, b in zip(contacts.world, contacts.other_body)}
path, near, touched = np.array(path), np.array(near), np.array(touched)
for world in range(4):
    what = ", ".join(sorted(name for w, name in names_touched if w == world)) or "nothing"
    print(f"world {world}: least clearance {near[:, world].min():+.3f} m; touched {what}")

# %% [markdown]
# Contact forces are not solved: a drone that touches a tree flies on, and the contacts say so. A negative clearance is how
# deep it is inside.

# %%
colours = ["tab:blue", "tab:orange", "tab:green", "tab:red"]
figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 4), layout="constrained")
level = (0.0, 0.0, 0.0, 1.0)  # looks along -z: down
down = propwash.Camera(mount="world", pos=(0.0, 0.0, 30.0), quat=level, fovy_deg=30.0, resolution=(240, 240), kind="z_depth")
height = 30.0 - sim.render_depth(down, worlds=[0])[0]
edge = 30.0 * np.tan(np.radians(15.0))
left.imshow(height, extent=(-edge, edge, -edge, edge), cmap="Greens", vmin=0.0, vmax=5.0)
for world, colour in enumerate(colours):
    left.plot(*path[:, world, :2].T, color=colour)
    left.plot(*path[touched[:, world], world, :2].T, "x", color="black", markersize=5)
    right.plot(np.arange(400) / 50.0, near[:, world], color=colour, label=f"world {world}")
left.set(title="paths over the height of the scene (x: contact)", xlabel="x, m", ylabel="y, m")
right.axhline(0.0, color="black", linewidth=0.8)
right.set(title="clearance", xlabel="time, s", ylabel="m")
right.legend()
plt.show()

# %% [markdown]
# The background of the left picture is a depth image too: a camera 30 m above, whose z-depth gives the height of the scene.
#
# ## Seeing
#
# `depth_frame` gives a label for every pixel: the depth, why there is none, which geom and body it is, the surface normal, the
# pose of the camera and its matrix K. All worlds are rendered in one call.

# %%
sim.reset()
camera = propwash.Camera("fpv", resolution=(96, 72), range=(0.1, 8.0), kind="z_depth")
frame = sim.depth_frame(camera, normals=True)
print("depth", frame.depth.shape, frame.depth.dtype, "| camera", frame.pos[:, 0].round(2).tolist())
for status in propwash.PixelStatus:
    print(f"{status.name:8} {np.mean(frame.status == status):6.1%} of all pixels")

# %%
figure, rows = plt.subplots(3, 4, figsize=(9.5, 5.6), layout="constrained")
for world in range(4):
    depth = np.where(frame.hit[world, 0], frame.depth[world, 0], np.nan)
    shown = rows[0, world].imshow(depth, cmap="viridis_r", vmin=0.0, vmax=8.0)
    body = frame.body_id[world, 0]
    rows[1, world].imshow(np.where(body > 0, body * 37 % 20, np.nan), cmap="tab20", vmin=0, vmax=19)
    rows[2, world].imshow(0.5 + 0.5 * frame.normal[world, 0])
    rows[0, world].set_title(f"world {world}")
for row, name in zip(rows, ("z-depth", "body", "normal")):
    row[0].set_ylabel(name)
    for axes in row:
        axes.set(xticks=[], yticks=[])
figure.colorbar(shown, ax=rows[0], label="m")
plt.show()

# %% [markdown]
# Names are at hand for every id. What does the second drone see most of?

# %%
bodies, pixels = np.unique(frame.body_id[1, 0], return_counts=True)
for body, n in sorted(zip(bodies, pixels), key=lambda pair: -pair[1])[:6]:
    print(f"{n:5} pixels  {'nothing' if body < 0 else sim.scene.bodies[body].name}")

# %% [markdown]
# ## From pixels to points
#
# The centre of pixel (row, column) is at (column + ½, row + ½) of K. The camera looks along its −z, with y up. `quat` turns
# from camera to world, x y z w.

# %%
def rotated(quat, v):
    """Vectors (n, 3) turned by a quaternion x y z w."""
    axis, w = quat[:3], quat[3]
    return v + 2.0 * np.cross(axis, np.cross(axis, v) + w * v)


figure, axes = plt.subplots(figsize=(5, 5.6), layout="constrained")
axes.imshow(height, extent=(-edge, edge, -edge, edge), cmap="Greens", vmin=0.0, vmax=9.0)
for world, colour in enumerate(colours):
    row, column = np.nonzero(frame.hit[world, 0])
    z = frame.depth[world, 0][row, column].astype(float)
    k = frame.k[0]
    seen = np.column_stack([(column + 0.5 - k[0, 2]) / k[0, 0] * z, -(row + 0.5 - k[1, 2]) / k[1, 1] * z, -z])
    points = frame.pos[world, 0] + rotated(frame.quat[world, 0], seen)
    high = points[:, 2] > 0.3
    axes.plot(*points[high, :2].T, ".", color=colour, markersize=1.5)
    axes.plot(*frame.pos[world, 0, :2], "o", color=colour)
axes.set(title="what each drone sees above 0.3 m, from above", xlabel="x, m", ylabel="y, m", xlim=(-7, 3), ylim=(-7, 7))
plt.show()
