"""MuJoCo's window on a world of a ``Sim``."""

from __future__ import annotations

import atexit
import threading
import warnings
import weakref
from importlib import import_module
from typing import TYPE_CHECKING, Any

from . import _gl, _native
from ._repr import shortened

if TYPE_CHECKING:
    from .sim import Sim

_WHAT_TO_DO = (
    "MuJoCo's window needs one (DISPLAY or WAYLAND_DISPLAY): run it in a desktop session, by `ssh -X`, or under `xvfb-run -s '-screen 0 "
    "1280x720x24'` to test; sim.render() and propwash.video() make pictures without a display"
)


#: For the end of a window's threads, at most.
_WAIT_S = 5.0


def _close(ref: weakref.ref[Viewer]) -> None:
    viewer = ref()
    if viewer is not None:
        viewer.close()


class Viewer:
    """MuJoCo's window on a world, as ``Sim.viewer`` opens it; a context manager that closes it.

    The window stays responsive by a thread of its own and shows the world as it was at the last ``sync``. What is done in it (dragging
    bodies, sliders) moves what it shows until then, and never the ``Sim``.
    """

    def __init__(self, sim: Sim, world: int = 0, **options: Any) -> None:
        self.model, self.data = sim.mujoco(world)
        """What it shows: a ``mujoco.MjModel`` and ``mujoco.MjData`` of its own."""
        self.world = world
        self._sim = sim
        if not _gl.has_display():
            raise _native.Error(f"there is no display: {_WHAT_TO_DO}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # GLFW's, which the error says too
            if not import_module("glfw").init():
                raise _native.Error(f"the display does not answer: {_WHAT_TO_DO}")
        passive = import_module("mujoco.viewer")
        before = set(threading.enumerate())
        self.handle: Any = passive.launch_passive(self.model, self.data, **options)
        """MuJoCo's own handle, with ``cam``, ``opt``, ``user_scn`` and so on."""
        self._threads = [thread for thread in threading.enumerate() if thread not in before]
        # A process that ends while the window's threads draw would crash.
        atexit.register(_close, weakref.ref(self))

    def sync(self) -> None:
        """Shows the world as it is now. Nothing happens after the window was closed: ask ``is_running``.

        Raises:
            Error: for a world whose numbers are not finite.
        """
        if not self.handle.is_running():
            return
        with self.handle.lock():
            self._sim.sync_mujoco(self.model, self.data, self.world)
        self.handle.sync()

    def is_running(self) -> bool:
        """Whether the window is open."""
        return bool(self.handle.is_running())

    def close(self) -> None:
        """Closes the window, and waits until it is gone."""
        self.handle.close()
        for thread in self._threads:
            thread.join(_WAIT_S)

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        state = "open" if self.is_running() else "closed"
        return shortened(f"<propwash.Viewer of world {self.world}, {state}>")
