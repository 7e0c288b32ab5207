"""Commands by what they mean."""

import numpy as np
import pytest

import propwash
from propwash import Command


def test_a_hovering_drone_goes_where_the_command_says_with_its_heading() -> None:
    sim = propwash.Sim(n_worlds=3, drone="cf2x_L250", control="state")
    sim.set_initial(pos=[0.0, 0.0, 1.0])
    sim.reset()
    pos = np.array([[[0.3, 0.0, 1.0]], [[0.0, -0.2, 1.1]], [[0.0, 0.0, 1.0]]])
    yaw = np.array([[0.0], [1.0], [-0.5]])
    sim.state_control(Command.hover(pos, yaw))
    sim.step(2000)
    assert np.allclose(sim.data.pos, pos, atol=0.05)  # the controller is still settling in height
    q = sim.data.quat
    heading = np.arctan2(2 * (q[..., 3] * q[..., 2] + q[..., 0] * q[..., 1]), 1 - 2 * (q[..., 1] ** 2 + q[..., 2] ** 2))
    assert np.allclose(heading, yaw, atol=0.02)


def test_parts_of_a_command_are_broadcast() -> None:
    command = Command.state(np.ones((4, 2, 3)), vel=[1.0, 0.0, 0.0], acc=0.5, yaw=np.pi)
    assert command.shape == (4, 2, 16)
    assert np.allclose(command[3, 1], [1, 1, 1, 1, 0, 0, 0.5, 0.5, 0.5, 0, 0, 1, 0, 0, 0, 0])
    assert Command.hover([0.0, 0.0, 1.0], np.zeros(5)).shape == (5, 16)


def test_shapes_that_do_not_fit_are_refused_with_both() -> None:
    with pytest.raises(ValueError, match=r"pos: expected an array of shape \(\.\.\., 3\), got \(4,\)"):
        Command.hover(np.zeros(4))
    with pytest.raises(ValueError, match=r"yaw \(3,\)"):
        Command.hover(np.zeros((4, 3)), np.zeros(3))
