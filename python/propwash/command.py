"""Commands by what they mean, in place of columns by number."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Command:
    """Arrays for ``Sim.state_control``, of which each drone's last axis has 16 numbers."""

    @staticmethod
    def hover(pos: ArrayLike, yaw: ArrayLike = 0.0) -> NDArray[np.float64]:
        """Commands to fly to a position and stay there, level, with a heading.

        Args:
            pos: Position, m, world. (..., 3)
            yaw: Heading, rad, from the world's x axis to its y axis. (...), or one for all

        Returns:
            (..., 16), as many as positions and headings give together.
        """
        return Command.state(pos, yaw=yaw)

    @staticmethod
    def state(pos: ArrayLike, vel: ArrayLike = 0.0, acc: ArrayLike = 0.0, yaw: ArrayLike = 0.0) -> NDArray[np.float64]:
        """Commands to be at a point of a path.

        Args:
            pos: Position, m, world. (..., 3)
            vel: Velocity, m/s, world. (..., 3), or one number for all
            acc: Acceleration, m/s^2, world, as ``vel``.
            yaw: Heading, rad. (...), or one for all

        Returns:
            (..., 16): position, velocity, acceleration, attitude x y z w of the heading alone, body rates of zero.

        Raises:
            ValueError: for shapes that do not fit each other, with both.
        """
        parts = {name: np.asarray(v, np.float64) for name, v in (("pos", pos), ("vel", vel), ("acc", acc))}
        if parts["pos"].ndim == 0 or parts["pos"].shape[-1] != 3:
            raise ValueError(f"pos: expected an array of shape (..., 3), got {parts['pos'].shape}")
        heading = np.asarray(yaw, np.float64)
        try:
            shape = np.broadcast_shapes(*(p.shape for p in parts.values()), (*heading.shape, 3))
            columns = [np.broadcast_to(p, shape) for p in parts.values()]
            half = 0.5 * np.broadcast_to(heading, shape[:-1])
        except ValueError:
            shapes = ", ".join(f"{name} {p.shape}" for name, p in parts.items())
            raise ValueError(
                f"expected pos (..., 3), vel and acc (..., 3) or one number, yaw (...), got {shapes}, yaw {heading.shape}"
            ) from None
        out = np.zeros((*shape[:-1], 16))
        for k, column in enumerate(columns):
            out[..., 3 * k : 3 * k + 3] = column
        out[..., 11], out[..., 12] = np.sin(half), np.cos(half)
        return out
