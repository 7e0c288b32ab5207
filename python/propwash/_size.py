"""How large vehicles are."""

from __future__ import annotations

from typing import Any

from . import _native


def radius(vehicle: _native.Vehicle) -> float:
    """Half the width of a vehicle, m, from the middles of its rotors and their radii."""
    of = dict(next((p for p in (_parameters(vehicle, name) for name in vehicle.dynamics) if p), {}))
    out = 0.0
    k = 0
    while f"rotors.{k}.position_m.0" in of:
        x, y = of[f"rotors.{k}.position_m.0"], of[f"rotors.{k}.position_m.1"]
        out = max(out, abs(x) + of.get(f"rotors.{k}.radius_m", 0.0), abs(y) + of.get(f"rotors.{k}.radius_m", 0.0))
        k += 1
    return out if out > 0.0 else 0.06


def _parameters(vehicle: _native.Vehicle, dynamics: Any) -> list[tuple[str, float]]:
    return vehicle.parameters(dynamics)
