"""Packages that are not installed along, since only some parts need them."""

from __future__ import annotations

from importlib import import_module
from typing import Any


def need(module: str, extra: str, what: str = "this") -> Any:
    """Imports a package that is not installed along; the error says what needs it and how to get it."""
    package = module.split(".")[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as e:
        if e.name is None or e.name.split(".")[0] != package:
            raise
        message = f"{what} needs the package {package}, which is not installed: pip install 'propwash[{extra}]'"
        raise ImportError(message, name=package) from None
