"""What the tests of the package share."""

import os
from pathlib import Path

import numpy as np
import pytest

import propwash
from propwash import _gl

# Crazyflow asks for it before anything imports SciPy, which other tests may do first.
os.environ.setdefault("SCIPY_ARRAY_API", "1")

# MuJoCo chooses its OpenGL when it is imported first, which test modules do: one that needs no display, where there is none.
_gl.load()

ROOT = Path(__file__).resolve().parents[2]

WALL = """<mujoco><worldbody>
  <geom name="floor" type="plane" size="20 20 0.1"/>
  <geom name="wall" type="box" size="0.1 5 5" pos="3 0 0"/>
  <camera name="overview" pos="0 0 10" fovy="60" resolution="20 10"/>
  <body name="gate" mocap="true" pos="0 4 1"><geom name="bar" type="sphere" size="0.5"/></body>
</worldbody></mujoco>"""


@pytest.fixture
def wall():
    """Two worlds with one drone each, 1 m up and 3 m before a wall; one obstacle that can be moved."""
    sim = propwash.Sim(2, scene=WALL)
    sim.set_initial(pos=[0.0, 0.0, 1.0])
    sim.reset()
    return sim


def hover(sim):
    """State commands that hold every drone where it is."""
    command = np.zeros((sim.n_worlds, sim.n_drones, 16))
    command[..., :3] = sim.data.pos
    command[..., 12] = 1.0
    return command
