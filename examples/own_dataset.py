"""How do I record a data set of what my own policy flies?

Drones look for a way through a forest by a LiDAR of eight rays: they fly forward, and away from what is near. Two episodes of eight worlds are
recorded with depth, LiDAR and inertial readings, and end for a drone that has touched a tree. ``python examples/own_dataset.py [FOLDER]``
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import propwash
from propwash import datasets

WORLDS, SPEED, HEIGHT = 8, 1.0, 1.0


def main(out):
    sim = propwash.Sim(
        WORLDS,
        scene="forest",
        precision="f64",
        sensors=["imu", {"kind": "lidar", "columns": 8, "range_m": 3.0, "noise_m": 0.01}],
    )
    start = np.zeros((WORLDS, 1, 3))

    def on_reset(episode):
        # Side by side at the edge of the forest, somewhere else in every episode.
        start[:, 0] = [[-2.0, 0.5 * w - 1.75 + 0.2 * episode, HEIGHT] for w in range(WORLDS)]
        sim.set_initial(pos=start)

    recorder = propwash.Recorder(
        out, sim, seconds=3.0, episodes=2, fps=10, camera=propwash.Camera("fpv", resolution=(48, 36)), on_reset=on_reset
    )
    # Where each ray points, in the body: forward first, and then to the left.
    angle = np.arange(8) * np.pi / 4
    rays = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    for episode in recorder:
        command = np.zeros((WORLDS, 1, 16))
        command[..., 12] = 1.0  # attitude: no turn
        command[..., :3] = start
        while recorder.flying:
            near = np.maximum(0.0, 1.0 - sim.read("lidar")["range"][:, 0, 0] / 1.5)
            velocity = SPEED * (np.array([1.0, 0.0]) - 1.5 * near @ rays)
            command[:, 0, 3:5] = velocity
            command[:, 0, :2] += 0.02 * velocity
            sim.state_control(command)
            recorder.step(10)
            recorder.end(sim.clearance(0.5).distance[:, 0] <= 0.0)
        print(f"episode {episode}: mean way {np.mean(sim.data.pos[:, 0, 0] + 2.0):.2f} m")
    data = datasets.open(out)
    data.verify()
    touched = sum(data.world(w).contacts().num_rows > 0 for w in data.worlds)
    sample = data[len(data) - 1]
    print(f"{recorder.summary['worlds']} worlds, {touched} with a touch, {recorder.summary['images']} images in {out}")
    print("a sample holds", ", ".join(f"{k} {sample[k].shape}" for k in ("depth_m", "lidar_range", "imu_accelerometer", "command")))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as folder:
            main(Path(folder) / "set")
