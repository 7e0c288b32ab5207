"""Every block of Python in the README and in docs/python.md runs."""

import re

import numpy as np
import pytest
from conftest import ROOT
from test_gap import HIDDEN, flight

import propwash

BLOCKS = [
    pytest.param(block, id=f"{name}-{k}")
    for name in ("README.md", "docs/python.md")
    for k, block in enumerate(re.findall(r"^```python\n(.*?)^```$", (ROOT / name).read_text(), re.S | re.M))
]


def test_both_have_examples():
    assert len(BLOCKS) >= 5


@pytest.mark.parametrize("block", BLOCKS)
def test_examples_run(block, monkeypatch, tmp_path):
    monkeypatch.chdir(ROOT)
    if "flight.csv" in block:
        columns = flight(propwash.Vehicle("cf2x_L250").with_effects(HIDDEN))
        path = tmp_path / "flight.csv"
        np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
        block = block.replace('"flight.csv"', repr(str(path))).replace('"out/gap.html"', repr(str(tmp_path / "gap.html")))
    exec(compile(block, "example", "exec"), {})
