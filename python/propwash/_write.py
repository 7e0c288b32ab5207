"""Files that functions write: whole or not at all, and over another only where that is asked for."""

from __future__ import annotations

import os
from pathlib import Path


def may_write(path: str | os.PathLike[str] | None, force: bool) -> None:
    """Raises where no file can be written at ``path``, or one is there already, without ``force``. To be called before the work."""
    if path is None:
        return
    place = Path(path)
    if place.is_dir():
        raise IsADirectoryError(f"{place}: expected the path of a file, found a folder")
    if not place.parent.is_dir():
        raise FileNotFoundError(f"{place}: the folder {place.parent} is not there: make it first")
    if (place.is_file() or place.is_symlink()) and not force:
        raise FileExistsError(f"{place} exists: give another name, or force=True to replace it")


def write(path: str | os.PathLike[str] | None, text: str, force: bool) -> None:
    """Writes a file of text, where ``path`` is one."""
    write_bytes(path, text.encode("utf-8"), force)


def write_bytes(path: str | os.PathLike[str] | None, held: bytes, force: bool) -> None:
    """Writes a file, where ``path`` is one."""
    if path is None:
        return
    may_write(path, force)
    place = Path(os.path.realpath(path))
    if place.exists() and not place.is_file():  # a device or a pipe
        place.write_bytes(held)
        return
    partial = place.with_name(f".partial_{place.name}.{os.getpid()}")
    try:
        partial.write_bytes(held)
        if place.exists():
            partial.chmod(place.stat().st_mode)
        os.replace(partial, place)
    finally:
        partial.unlink(missing_ok=True)
