"""Files of a data set and their hashes."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from ._errors import DamagedError

RESTORE = "restore the file or write the data set anew"


def read_bytes(path: Path) -> bytes:
    """The bytes of a file that must be there."""
    try:
        return path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise DamagedError(f"{path}: expected a file, found none; {RESTORE}") from None


def parse(path: Path, text: bytes) -> dict[str, Any]:
    """A JSON object."""
    try:
        value = json.loads(text)
    except ValueError as e:
        raise DamagedError(f"{path}: expected JSON, found other text ({e}); {RESTORE}") from None
    if not isinstance(value, dict):
        raise DamagedError(f"{path}: expected a JSON object, found {type(value).__name__}; {RESTORE}")
    return value


def item(path: Path, record: dict[str, Any], name: str, kind: type) -> Any:
    """An entry of a JSON object, of the given type."""
    value = record.get(name)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise DamagedError(f"{path}: expected \"{name}\" to be {kind.__name__}, found {value!r:.80}; {RESTORE}")
    return value


def sha256(data: bytes) -> str:
    """Hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def sha256_of(path: Path) -> str:
    """Hash of a file, hexadecimal."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def same(path: Path, what: str, expected: object, found: object) -> None:
    """Raises DamagedError unless both are equal."""
    if expected != found:
        raise DamagedError(f"{path}: expected {what} {expected}, found {found}; {RESTORE}")


def check(path: Path, size: int, digest: str) -> None:
    """Raises DamagedError unless the file has this size and hash."""
    try:
        found = path.stat().st_size
    except (FileNotFoundError, NotADirectoryError):
        raise DamagedError(f"{path}: expected a file of {size} bytes, found none; {RESTORE}") from None
    if found != size:
        raise DamagedError(f"{path}: expected {size} bytes, found {found}; {RESTORE}")
    same(path, "sha256", digest, sha256_of(path))
