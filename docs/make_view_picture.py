"""Draws docs/view.png: a flight through a room as `propwash view` shows it.

python3 docs/make_view_picture.py target/debug/propwash    needs node, Chromium, and `npm install` in tests/web
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent


def main() -> None:
    propwash = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as folder:
        fly = "fly --scene room --drone cf2x_L250 --drones-per-world 2 --worlds 1 --seconds 20 --camera fpv --size 96x96 --out set --view set.html"
        subprocess.run([propwash, *fly.split()], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        look = {
            "page": f"{folder}/set.html",
            "hash": "t=13.4",
            "ready": "globalThis.Propwash?.shown !== undefined",
            "steps": ["new Promise((done) => setTimeout(done, 1000))"],
            "width": 1280,
            "height": 860,
            "picture": str(HERE / "view.png"),
        }
        subprocess.run(["node", "look.js"], cwd=HERE.parent / "tests/web", input=json.dumps([look]), text=True, check=True, stdout=subprocess.DEVNULL)


main()
