"""The notebooks run, and are checked in as they are written, with what they show."""

import base64
import importlib.util
import os

import pytest
from conftest import ROOT

if os.environ.get("PROPWASH_REQUIRE_PEERS") != "1":
    for package in ("ipykernel", "jupytext", "matplotlib", "nbclient"):
        pytest.importorskip(package)

import nbformat  # noqa: E402

spec = importlib.util.spec_from_file_location("make_notebooks", ROOT / "notebooks/make.py")
make = importlib.util.module_from_spec(spec)
spec.loader.exec_module(make)


def kinds(cell):
    """What a cell shows: the kinds of its outputs, in order."""
    return [(o.output_type, *sorted(o.get("data", {}))) for o in cell.get("outputs", [])]


def filed(name):
    return nbformat.read(make.FOLDER / f"{name}.ipynb", as_version=4)


def test_there_are_notebooks_and_no_others():
    assert {"find_the_gap", "fly_and_see", "swarms"} <= set(make.names())
    assert {path.stem for path in make.FOLDER.glob("*.ipynb")} == set(make.names())


@pytest.mark.parametrize("name", make.names())
def test_it_is_checked_in_as_it_is_written_with_its_outputs(name):
    notebook, text = filed(name), make.written(name)
    nbformat.validate(notebook)
    assert [(c.cell_type, c.source) for c in notebook.cells] == [(c.cell_type, c.source) for c in text.cells], (
        f"{name}.py was changed: run `cargo xtask docs --notebooks`"
    )
    assert (make.FOLDER / f"{name}.ipynb").stat().st_size < make.MOST_BYTES
    outputs = [o for c in notebook.cells for o in c.get("outputs", [])]
    assert not any(o.output_type == "error" or o.get("name") == "stderr" for o in outputs)
    pictures = [base64.b64decode(o.data["image/png"]) for o in outputs if "image/png" in o.get("data", {})]
    assert len(pictures) >= 2 and all(p.startswith(b"\x89PNG") for p in pictures)
    assert [c.execution_count for c in notebook.cells if c.cell_type == "code"] == list(
        range(1, 1 + sum(c.cell_type == "code" for c in notebook.cells))
    )


@pytest.mark.parametrize("name", make.names())
def test_it_runs_and_shows_what_is_checked_in(name):
    """Numbers may differ in their last digits from one processor to another: what is compared is what kind of thing is shown."""
    notebook = make.executed(name)  # raises where a cell does
    for new, old in zip(notebook.cells, filed(name).cells, strict=True):
        assert kinds(new) == kinds(old), new.source
