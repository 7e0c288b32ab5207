"""Physics of one's own in propwash.Sim and in crazyflow.sim.Sim: the same flights in float64 (docs/migrate.md)."""

import importlib.util
import os

import pytest
from conftest import ROOT

os.environ.setdefault("JAX_PLATFORMS", "cpu")
if os.environ.get("PROPWASH_REQUIRE_PEERS") != "1":
    pytest.importorskip("crazyflow")

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

_spec = importlib.util.spec_from_file_location("customise", ROOT / "benches/peers/customise.py")
customise = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(customise)

FORMS = {
    "nothing": {"kernel"},
    "push": {"stage"},
    "wind": {"built-in effects", "stage", "between steps"},
    "fan": {"effect", "stage", "between steps"},
    "controller": {"stage", "between steps"},
    "dynamics": {"effect", "stage", "between steps"},
    "masses": {"rules"},
}
SAME_M = 1e-9
"""Of a coordinate after 1 s; also of a part of the attitude's quaternion."""


def test_every_case_is_here():
    assert set(FORMS) == set(customise.CASES)


@pytest.mark.parametrize("case", FORMS)
def test_both_end_at_the_same_place_with_the_same_change(case):
    apart, moved = customise.apart(case)
    assert set(apart) == FORMS[case]
    assert max(apart.values()) < SAME_M, apart
    # The change is felt: by centimetres where the limit above is a nanometre.
    assert moved < SAME_M if case == "nothing" else moved > 0.01
