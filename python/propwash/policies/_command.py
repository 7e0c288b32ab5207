"""The command ``propwash evaluate``."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Callable, Sequence
from typing import TypeVar

from ._evaluate import as_json, evaluate as fly
from ._policy import Policy

T = TypeVar("T")

_EXAMPLES = """Examples:
  propwash evaluate reach.npz
  propwash evaluate reach.npz --vehicle cf2x_L250,cf21B_500 --wind 0,2,4 --delay 0,1,3
  propwash evaluate reach.npz --picture flights.png
  propwash evaluate reach.npz --json > reach.json

Exit codes: 0 fine, 2 error. Only the package of Python has this command; docs/policies.md explains it."""


def _list(of: Callable[[str], T], what: str) -> Callable[[str], list[T]]:
    def read(text: str) -> list[T]:
        try:
            return [of(word.strip()) for word in text.split(",")]
        except ValueError:
            raise argparse.ArgumentTypeError(f"expected {what}, separated by commas, got {text!r}") from None

    return read


def _name(word: str) -> str:
    if not word:
        raise ValueError
    return word


def parser() -> argparse.ArgumentParser:
    """Of the command line."""
    out = argparse.ArgumentParser(
        prog="propwash evaluate",
        description="Flies a saved policy on vehicles, in winds and with delays, and says how often it succeeds.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = out.add_argument
    names, floats, wholes = _list(_name, "names or files"), _list(float, "numbers"), _list(int, "whole numbers")
    add("policy", metavar="POLICY", help="file of Policy.save (.npz)")
    add("--env", metavar="ID", help="another environment than that of the training, as Propwash/ReachPos-v0")
    add("--import", dest="module", metavar="MODULE", help="module to import first, which registers a task of your own")
    add("--vehicle", "--drone", type=names, metavar="NAMES", help="built-in vehicles or vehicle files [default: that of the training]")
    add("--wind", type=floats, default=[0.0], metavar="M/S", help="speeds of a steady wind, from eight directions [default: 0]")
    add("--delay", type=wholes, default=[0], metavar="STEPS", help="how late actions come, in steps of the environment [default: 0]")
    add("--mass", type=floats, default=[1.0], metavar="FACTORS", help="factors of the mass [default: 1]")
    add("--episodes", type=int, default=200, metavar="N", help="of each combination [default: 200]")
    add("--seed", type=int, default=1_000_000, metavar="N", help="of the episodes [default: 1000000]")
    add("--within", type=float, metavar="M", help="distance at the end that is a success, in tasks that last until the time is up")
    add("--picture", metavar="FILE", help="a picture (PNG) of the first four flights of the first row")
    add("--force", action="store_true", help="write over a picture that is there")
    add("--describe", action="store_true", help="say what the policy observes and what its actions mean, and fly nothing")
    add("--json", action="store_true", help="print all of it as JSON")
    return out


def evaluate(words: Sequence[str]) -> int:
    """Runs the command; returns the exit code."""
    args = parser().parse_args(words)
    try:
        if args.describe:
            print(Policy.load(args.policy).describe())
            return 0
        if args.module is not None:
            sys.path.insert(0, os.getcwd())
            importlib.import_module(args.module)
        found = fly(
            args.policy, args.env, vehicles=args.vehicle, wind=args.wind, delay=args.delay, mass=args.mass, episodes=args.episodes,
            seed=args.seed, within=args.within, picture=args.picture, force=args.force,
        )  # fmt: skip
    except KeyboardInterrupt:
        return 130
    except Exception as e:  # whatever it is, a line says it
        print(f"error: {e}", file=sys.stderr)
        return 2
    print(as_json(found) if args.json else found)
    return 0
