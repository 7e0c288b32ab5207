"""Loads the libmujoco of Python's package ``mujoco``, so that one process holds one library, without importing the package."""

import ctypes
from importlib.util import find_spec
from pathlib import Path

VERSION = "3.17.0"


def load_library() -> None:
    """Loads ``libmujoco`` before the compiled module asks for it.

    The loader takes the same name for the same library: the compiled module, and ``import mujoco`` later on, share it.

    Raises:
        ImportError: if the package ``mujoco`` of the right version is not installed.
    """
    spec = find_spec("mujoco")
    folders = [] if spec is None else [Path(f) for f in spec.submodule_search_locations or []]
    name = f"libmujoco.so.{VERSION}"
    for folder in folders:
        if (folder / name).is_file():
            ctypes.CDLL(str(folder / name))
            return
    found = sorted(path.name for folder in folders for path in folder.glob("libmujoco*"))
    what = f"its folder holds {', '.join(found) or 'no libmujoco'}" if folders else "it is not installed"
    raise ImportError(f"propwash needs the Python package mujoco=={VERSION}, but {what}: run `pip install mujoco=={VERSION}`")
