"""The file of a policy: an .npz with ``policy.json`` (what it is) and one array for each weight."""

from __future__ import annotations

import io
import json
import os
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._write import write_bytes
from ._inputs import Channel, Input
from ._layers import Layer

if TYPE_CHECKING:
    from ._policy import Policy

#: Version of the format.
VERSION = 1


def description(policy: Policy) -> dict[str, Any]:
    """All of a policy but its weights, as JSON has it."""
    return {
        "format": "propwash policy",
        "version": VERSION,
        "observation": [{"name": c.name, "shape": list(c.shape), "frames": c.frames} for c in policy.observation],
        "branches": [
            {
                "inputs": [{"channel": given.channel, "steps": [dict(step) for step in given.steps]} for given in branch.inputs],
                "layers": [_told(layer) for layer in branch.layers],
            }
            for branch in policy.branches
        ],
        "layers": [_told(layer) for layer in policy.layers],
        "action": {
            "kind": policy.action.kind,
            "names": list(policy.action.names),
            "low": policy.action.low.tolist(),
            "high": policy.action.high.tolist(),
            "limit": policy.action.limit,
            "normalized": policy.action.normalized,
            "step_hz": policy.action.step_hz,
        },
        "trained": dict(policy.trained),
    }


def _told(layer: Layer) -> dict[str, Any]:
    shape = {} if layer.weight is None else {"weight": list(layer.weight.shape)}
    return {"kind": layer.kind, **shape, **layer.options}


def save(policy: Policy, path: str | os.PathLike[str], force: bool) -> None:
    """Writes the file."""
    place = Path(path)
    if place.suffix != ".npz":
        raise ValueError(f"{place}: expected a name that ends with .npz, as policies are kept")
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as archive:
        # The same policy gives the same bytes: no times of today.
        archive.writestr(_entry("policy.json"), json.dumps(description(policy), indent=1) + "\n")
        for name, layer in _all_layers(policy):
            for part, array in (("weight", layer.weight), ("bias", layer.bias)):
                if array is not None:
                    inner = io.BytesIO()
                    np.lib.format.write_array(inner, array, allow_pickle=False)
                    archive.writestr(_entry(f"{name}.{part}.npy"), inner.getvalue())
    write_bytes(place, held.getvalue(), force)


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name)
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


def _all_layers(policy: Policy) -> list[tuple[str, Layer]]:
    out = [(f"branch{b}.{k}", layer) for b, branch in enumerate(policy.branches) for k, layer in enumerate(branch.layers)]
    return out + [(f"layer{k}", layer) for k, layer in enumerate(policy.layers)]


def load(path: str | os.PathLike[str]) -> Policy:
    """Reads the file."""
    place = Path(path)
    if not place.is_file():
        raise FileNotFoundError(f"{place}: expected the file of a policy, as Policy.save writes it; there is none")
    try:
        with zipfile.ZipFile(place) as archive:
            broken = archive.testzip()
            if broken is not None:
                raise ValueError(f"{place}: {broken} is broken: its checksum is wrong; copy the file again")
            names = set(archive.namelist())
            if "policy.json" not in names:
                found = ", ".join(sorted(names)[:6]) or "nothing"
                raise ValueError(f"{place}: expected a file of Policy.save, with policy.json in it; found {found}")
            head = archive.read("policy.json")
            arrays = {name: _array(place, name, archive.read(name)) for name in sorted(names) if name.endswith(".npy")}
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError, RuntimeError) as e:
        raise ValueError(f"{place}: expected a whole file of Policy.save (.npz): {e}") from e
    try:
        told = json.loads(head)
    except ValueError as e:
        raise ValueError(f"{place}: policy.json: expected JSON: {e}") from e
    return _policy(place, told, arrays)


def _array(place: Path, name: str, held: bytes) -> Any:
    try:
        return np.lib.format.read_array(io.BytesIO(held), allow_pickle=False)
    except (ValueError, EOFError, MemoryError, SyntaxError) as e:
        raise ValueError(f"{place}: {name}: expected an array of NumPy: {e}") from e


class _Reader:
    """Reads parts of the description; what is missing or of another type is an error that says where."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def get(self, told: Any, where: str, key: str, kind: type[Any] | tuple[type[Any], ...]) -> Any:
        if not isinstance(told, Mapping) or key not in told:
            raise ValueError(f"{self.place}: policy.json: {where}: expected {key}, which is missing")
        value = told[key]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise ValueError(f"{self.place}: policy.json: {where}{key}: expected {_kind_words(kind)}, found {value!r}")
        return value

    def layers(self, told: Sequence[Any], where: str, name: str, arrays: dict[str, Any]) -> tuple[Layer, ...]:
        out = []
        for k, one in enumerate(told):
            kind = self.get(one, f"{where}[{k}].", "kind", str)
            options = {key: value for key, value in one.items() if key not in ("kind", "weight")}
            held = [arrays.pop(f"{name}{k}.{part}.npy", None) for part in ("weight", "bias")]
            if "weight" in one and (held[0] is None or list(held[0].shape) != one["weight"]):
                found = "none" if held[0] is None else f"one of the shape {list(held[0].shape)}"
                raise ValueError(f"{self.place}: {name}{k}.weight.npy: expected an array of the shape {one['weight']}, found {found}")
            out.append(Layer(kind, held[0], held[1], options))
        return tuple(out)


def _kind_words(kind: type[Any] | tuple[type[Any], ...]) -> str:
    words = {str: "text", int: "a whole number", list: "a list", dict: "an object", bool: "true or false"}
    return " or ".join(words[k] for k in (kind if isinstance(kind, tuple) else (kind,)))


def _policy(place: Path, told: Any, arrays: dict[str, Any]) -> Policy:
    from ._policy import ActionSpec, Branch, Policy

    read = _Reader(place)
    if read.get(told, "", "format", str) != "propwash policy":
        raise ValueError(f'{place}: policy.json: format: expected "propwash policy", found {told["format"]!r}')
    version = read.get(told, "", "version", int)
    if version != VERSION:
        raise ValueError(f"{place}: expected version {VERSION} of the format, found {version}: read it with the Propwash that wrote it")
    try:
        channels = []
        for i, one in enumerate(read.get(told, "", "observation", list)):
            where = f"observation[{i}]."
            shape = read.get(one, where, "shape", list)
            if not shape or not all(isinstance(n, int) and n > 0 for n in shape):
                raise ValueError(f"policy.json: {where}shape: expected whole numbers above 0, found {shape}")
            channels.append(Channel(read.get(one, where, "name", str), tuple(shape), read.get(one, where, "frames", int)))
        branches = []
        for b, one in enumerate(read.get(told, "", "branches", list)):
            inputs = []
            for i, given in enumerate(read.get(one, f"branches[{b}].", "inputs", list)):
                where = f"branches[{b}].inputs[{i}]."
                steps = read.get(given, where, "steps", list)
                inputs.append(Input(read.get(given, where, "channel", str), tuple(steps)))
            layers = read.get(one, f"branches[{b}].", "layers", list)
            branches.append(Branch(tuple(inputs), read.layers(layers, f"branches[{b}].layers", f"branch{b}.", arrays)))
        layers = read.layers(read.get(told, "", "layers", list), "layers", "layer", arrays)
        if arrays:
            raise ValueError(f"{', '.join(arrays)}: no layer of policy.json has this array")
        a = read.get(told, "", "action", dict)
        with np.errstate(over="ignore"):  # infinite limits are refused below
            low, high = (np.asarray(read.get(a, "action.", key, list), np.float32) for key in ("low", "high"))
        limit, kind = read.get(a, "action.", "limit", str), read.get(a, "action.", "kind", str)
        normalized, step_hz = read.get(a, "action.", "normalized", bool), read.get(a, "action.", "step_hz", int)
        action = ActionSpec(kind, low, high, limit, normalized, step_hz)
        return Policy(tuple(channels), tuple(branches), layers, action, read.get(told, "", "trained", dict))
    except (ValueError, TypeError, KeyError, IndexError, AttributeError) as e:
        if str(e).startswith(f"{place}: "):
            raise
        raise ValueError(f"{place}: {e}") from e
