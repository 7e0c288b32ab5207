"""Every block of Python in the README and in docs/python.md runs."""

import re

import pytest
from conftest import ROOT

BLOCKS = [
    pytest.param(block, id=f"{name}-{k}")
    for name in ("README.md", "docs/python.md")
    for k, block in enumerate(re.findall(r"^```python\n(.*?)^```$", (ROOT / name).read_text(), re.S | re.M))
]


def test_both_have_examples():
    assert len(BLOCKS) >= 5


@pytest.mark.parametrize("block", BLOCKS)
def test_examples_run(block, monkeypatch):
    monkeypatch.chdir(ROOT)
    exec(compile(block, "example", "exec"), {})
