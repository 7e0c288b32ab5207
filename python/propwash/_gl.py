"""The Python package ``mujoco``, imported when it is needed, with an OpenGL that works on this machine."""

from __future__ import annotations

import ctypes.util
import os
import sys
from importlib import import_module
from typing import Any

from ._native import Error

PACKAGES = (
    "on a machine without a display install EGL or OSMesa (Debian, Ubuntu: apt install libegl1 libgl1-mesa-dri, or apt install libosmesa6) "
    "and set MUJOCO_GL=egl or MUJOCO_GL=osmesa before Python starts, or at least before the first `import mujoco`; depth images "
    "(Sim.render_depth) need no OpenGL"
)


def has_display() -> bool:
    """Whether the environment names a display on which windows could open."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def load() -> Any:
    """The package ``mujoco``.

    It chooses its OpenGL when it is imported, by ``MUJOCO_GL``: GLFW, which needs a display, where that is not set. Where it is
    imported here first, and there is no display, EGL or OSMesa is chosen, whichever is installed.
    """
    if "mujoco" in sys.modules:
        return import_module("mujoco")
    chosen = None
    if "MUJOCO_GL" not in os.environ and not has_display():
        chosen = next((gl for gl, library in (("egl", "EGL"), ("osmesa", "OSMesa")) if ctypes.util.find_library(library)), None)
    if chosen is None:
        return _imported()
    platform = os.environ.get("PYOPENGL_PLATFORM")
    os.environ["MUJOCO_GL"] = chosen
    try:
        return _imported()
    except Error:
        # A library that is there and does not work: models and data need none.
        os.environ.pop("PYOPENGL_PLATFORM", None)
        if platform is not None:
            os.environ["PYOPENGL_PLATFORM"] = platform
    finally:
        del os.environ["MUJOCO_GL"]
    return _imported()


def _imported() -> Any:
    try:
        return import_module("mujoco")
    except (AttributeError, ImportError, RuntimeError) as e:
        # What PyOpenGL and MuJoCo raise for a library that is not there.
        raise no_gl(e) from e


def no_gl(fault: BaseException) -> Error:
    """The error for a renderer that found no OpenGL."""
    said = os.environ.get("MUJOCO_GL")
    now = f"MUJOCO_GL is {said!r}" if said is not None else "MUJOCO_GL is not set"
    display = "there is a display" if has_display() else "there is no display"
    return Error(f"MuJoCo's renderer found no OpenGL ({now}, {display}; {type(fault).__name__}: {fault}): {PACKAGES}")


def missing() -> str | None:
    """Why MuJoCo's renderer cannot draw here; None where it can."""
    mujoco = None
    try:
        mujoco = load()
        with mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8) as renderer:
            renderer.render()
    except Exception as e:
        return str(e if isinstance(e, Error) else no_gl(e))
    return None
