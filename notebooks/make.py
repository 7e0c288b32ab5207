"""Runs the notebooks and writes them with what they printed and drew: ``python notebooks/make.py [NAME ...]``.

Each is written by hand as NAME.py, with cells between ``# %%`` lines (the percent format of jupytext); NAME.ipynb is made from
it. ``cargo xtask docs --notebooks`` calls this with everything at hand.
"""

from __future__ import annotations

import base64
import io
import sys
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode
from PIL import Image

FOLDER = Path(__file__).resolve().parent
SECONDS = 900
"""Longest time for one cell."""
MOST_BYTES = 300_000
"""Most that a notebook may take with its outputs."""


def names() -> list[str]:
    """Names of all notebooks, without their ending."""
    return sorted(path.stem for path in FOLDER.glob("*.py") if path.stem != "make")


def written(name: str) -> NotebookNode:
    """The notebook as it is written, without outputs; cells are numbered, so that the same text makes the same file."""
    notebook = jupytext.read(FOLDER / f"{name}.py")
    notebook.metadata = NotebookNode(
        kernelspec={"display_name": "Python 3", "language": "python", "name": "python3"}, language_info={"name": "python"}
    )
    for k, cell in enumerate(notebook.cells):
        cell.id, cell.metadata = f"cell-{k:02}", NotebookNode()
    return notebook


def executed(name: str) -> NotebookNode:
    """The notebook with its outputs, run from the folder it lies in.

    Raises:
        nbclient.exceptions.CellExecutionError: where a cell raises.
    """
    notebook = written(name)
    client = NotebookClient(notebook, timeout=SECONDS, kernel_name="python3", resources={"metadata": {"path": str(FOLDER)}})
    client.execute()
    for cell in notebook.cells:
        cell.metadata = NotebookNode()  # times of execution
        for output in cell.get("outputs", []):
            if "image/png" in output.get("data", {}):
                output.data["image/png"] = _smaller(output.data["image/png"])
    return notebook


def _smaller(picture: str) -> str:
    """A PNG in base64 with at most 128 colours, a third of the size."""
    image = Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB").quantize(128, dither=Image.Dither.NONE)
    out = io.BytesIO()
    image.save(out, "PNG", optimize=True)
    return base64.b64encode(out.getvalue()).decode() + "\n"


def main(chosen: list[str]) -> None:
    unknown = [name for name in chosen if name not in names()]
    if unknown:
        raise SystemExit(f"expected names of notebooks ({', '.join(names())}), got {', '.join(unknown)}")
    for name in chosen or names():
        notebook = executed(name)
        nbformat.validate(notebook)
        text = nbformat.writes(notebook)
        if len(text.encode()) > MOST_BYTES:
            raise SystemExit(f"{name}: expected at most {MOST_BYTES} bytes, got {len(text.encode())}: draw smaller pictures")
        (FOLDER / f"{name}.ipynb").write_text(text + "\n", encoding="utf-8")
        print(f"{name}.ipynb: {len(notebook.cells)} cells, {len(text.encode()):,} bytes")


if __name__ == "__main__":
    main(sys.argv[1:])
