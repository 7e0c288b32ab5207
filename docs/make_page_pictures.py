"""Takes the pictures of README and docs that show pages: docs/view.png, docs/gap_report.png, docs/lab*.png and the animation docs/gap.webp. Writes the pages
of docs/live, which the site of the documentation carries.

`cargo xtask pictures` builds what it needs and runs it. By hand, with Pillow, node, Chromium, and after `npm ci` in tests/web:

    python docs/make_page_pictures.py target/release

The animation is the page of a diagnosis while its effect is turned on: a flight of an independent simulator with a hidden drag of the
rotors, as in docs/gap.md. docs/live/real_flight.html is a flight of the MIT Blackbird data set, where that lies beside the checkout; its licence
allows it and stands beside the page.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

HERE = Path(__file__).resolve().parent
WEB = HERE.parent / "tests" / "web"

FLY = "fly --scene room --drone cf2x_L250 --drones-per-world 2 --worlds 1 --seconds 20 --camera fpv --size 96x96 --out set --view set.html"
LIVE = "fly --scene room --drone cf2x_L250 --drones-per-world 2 --worlds 1 --seconds 12 --camera fpv --size 64x64 --fps 10 --obstacle-motion line --out live --view live.html"
HIDE = "--effect rotor_drag --seed 3 --seconds 50 --out flight.csv --vehicle-out quad.toml"
DIAGNOSE = "diagnose flight.csv --vehicle quad.toml --out d.json --report gap.html"

REAL = HERE.parents[1] / "shared" / "data" / "blackbird"
DIAGNOSE_REAL = f"diagnose {REAL}/clover_5mps_train.csv --held-out {REAL}/clover_5mps_test.csv --vehicle blackbird.toml --report real.html"

#: Pictures per second of the animation, its width in pixels, and how many bytes it may have.
RATE, WIDTH, MOST_BYTES = 10, 920, 2_000_000


def run(program: Path, arguments: str, folder: Path) -> None:
    # `diagnose` exits with 1 where it finds something.
    done = subprocess.run([program, *arguments.split()], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    if done.returncode not in (0, 1):
        sys.exit(f"{program.name} {arguments}\n{done.stderr}")


def node(script: Path, arguments: list[str], given: str | None = None) -> None:
    subprocess.run(["node", script, *arguments], input=given, text=True, check=True, stdout=subprocess.DEVNULL)


#: Turns the first effect of a report on, with a part of its estimate.
TURN_ON = """(() => {
  const slider = document.querySelector(".effect input[type=range]");
  slider.value = 0.7 * slider.value;
  slider.dispatchEvent(new Event("input", { bubbles: true }));
})()"""


def look(page: Path, picture: str, ready: str, size: tuple[int, int], moment: str = "", steps: tuple[str, ...] = ()) -> None:
    asked = {
        "page": str(page),
        "hash": moment,
        "ready": ready,
        "steps": [*steps, "new Promise((done) => setTimeout(done, 1500))"],
        "width": size[0],
        "height": size[1],
        "picture": str(HERE / picture),
    }
    node(WEB / "look.js", [], json.dumps([asked]))


def animation(page: Path, folder: Path) -> None:
    frames = folder / "frames"
    frames.mkdir()
    node(HERE / "film.js", [str(page), str(frames), str(RATE)])
    images = [Image.open(path).convert("RGB") for path in sorted(frames.glob("*.png"))]
    size = (WIDTH, round(images[0].height * WIDTH / images[0].width))
    first, *rest = (image.resize(size, Image.Resampling.LANCZOS) for image in images)
    to = HERE / "gap.webp"
    first.save(to, save_all=True, append_images=rest, duration=1000 // RATE, loop=0, quality=60, method=6)
    if to.stat().st_size > MOST_BYTES:
        sys.exit(f"{to} has {to.stat().st_size} bytes, {MOST_BYTES} are allowed: lower RATE or WIDTH")


def live(propwash: Path, folder: Path) -> None:
    to = HERE / "live"
    to.mkdir(exist_ok=True)
    run(propwash, LIVE, folder)
    shutil.copy(folder / "live.html", to / "data_set.html")
    if not REAL.is_dir():
        print(f"{to / 'real_flight.html'} stays as it is: {REAL} is not there")
        return
    shutil.copy(HERE.parent / "tests" / "data" / "blackbird.toml", folder)
    run(propwash, DIAGNOSE_REAL, folder)
    shutil.copy(folder / "real.html", to / "real_flight.html")
    shutil.copy(REAL / "LICENSE.md", to / "real_flight.LICENSE.txt")


#: What a person does in the lab before its pictures are taken: words that are clicked, conditions that are waited for, pictures.
EXACT = "document.getElementById('exactness')?.textContent === 'figures are those of the model itself'"
LAB = [
    {"picture": "lab_start.png"},
    {"drop": ["flight.csv", "quad.toml"]},
    {"until": "document.querySelector('.card.log .tag') !== null"},
    {"picture": "lab_check.png"},
    {"until": "(location.hash = '#map=1', true)"},
    {"until": "document.querySelector('#verdict .sane') !== null"},
    {"picture": "lab_map.png"},
    {"click": "Back"},
    {"until": "document.querySelector('.card.log .tag') !== null"},
    {"click": "Continue"},
    {"until": EXACT},
    {"click": "Find what is missing"},
    {"until": "document.getElementById('headline') !== null && document.querySelector('.effect') !== null"},
    {"css": ".effect .on"},
    {"until": f"document.querySelector('.effect.is-on') !== null && {EXACT}"},
    {"size": [1400, 1200]},
    {"until": "new Promise((done) => setTimeout(done, 1500, true))"},
    {"picture": "lab.png"},
    {"size": [1400, 900]},
    {"click": "4 Next flight"},
    {"until": "document.getElementById('plan') !== null"},
    {"click": "Plan it"},
    {"until": "document.querySelector('#plan canvas') !== null"},
    {"until": "new Promise((done) => setTimeout(done, 1000, true))"},
    {"picture": "lab_next.png"},
    {"click": "5 Save"},
    {"until": "document.getElementById('folder') !== null"},
    {"fill": ["#folder", "/flights"]},
    {"picture": "lab_save.png"},
]


def lab(propwash: Path, folder: Path) -> None:
    running = subprocess.Popen([propwash, "lab", "--no-open"], cwd=folder, stdout=subprocess.PIPE, text=True)
    try:
        url = running.stdout.readline().split()[1]
        steps = []
        for step in LAB:
            ((kind, given),) = step.items()
            if kind == "picture":
                given = str(HERE / given)
            if kind == "drop":
                given = [str(folder / name) for name in given]
            steps.append({kind: given})
        node(WEB / "act.js", [], json.dumps({"url": url, "steps": steps}))
    finally:
        running.terminate()
        running.wait()


def main() -> None:
    built = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run(built / "propwash", FLY, folder)
        look(folder / "set.html", "view.png", "globalThis.Propwash?.shown !== undefined", (1280, 860), "t=13.4")
        run(built / "examples" / "hidden_flight", HIDE, folder)
        run(built / "propwash", DIAGNOSE, folder)
        look(folder / "gap.html", "gap_report.png", "globalThis.Propwash?.scene !== undefined", (1400, 1360), steps=(TURN_ON,))
        animation(folder / "gap.html", folder)
        lab(built / "propwash", folder)
        live(built / "propwash", folder)


main()
