"""The program ``propwash`` as the package brings it."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from conftest import ROOT
from test_package import ENVIRONMENT

import propwash

PROGRAM = os.environ.get("PROPWASH_BIN")


def program(*words, **options):
    return subprocess.run([sys.executable, "-m", "propwash", *words], capture_output=True, text=True, env=ENVIRONMENT, **options)


def test_the_package_runs_the_program():
    done = program("--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"propwash {propwash.__version__}\n", "")
    done = program("drones", "cf2x_L250")
    assert done.returncode == 0 and "mass" in done.stdout


def test_exit_codes_and_messages_are_those_of_the_program(tmp_path):
    bad = tmp_path / "bad.xml"
    bad.write_text("<mujoco><worldbody><geom size='1' contype='0' conaffinity='0'/></worldbody></mujoco>")
    assert program("scene", "lint", str(bad)).returncode == 1
    done = program("scene", "lint", "--spawn", "1,2", "x.xml")
    assert done.returncode == 2 and "`propwash scene lint --help` explains" in done.stderr
    done = program()
    assert done.returncode == 2 and "Usage: propwash" in done.stderr


@pytest.mark.skipif(PROGRAM is None, reason="PROPWASH_BIN is not set")
def test_help_and_data_sets_are_those_of_the_program(tmp_path, monkeypatch):
    monkeypatch.setitem(ENVIRONMENT, "COLUMNS", "100")
    for words in (["--help"], ["fly", "--help"], ["scene", "new", "forest", "--help"]):
        alone = subprocess.run([PROGRAM, *words], capture_output=True, text=True, check=True, env=ENVIRONMENT)
        assert program(*words).stdout == alone.stdout
    line = ["fly", "--scene", str(ROOT / "xml/room.xml"), "--drone", "cf2x_L250", "--seconds", "0.1", "--size", "8x6", "--out"]
    subprocess.run([PROGRAM, *line, tmp_path / "a"], check=True, capture_output=True)
    done = program(*line, str(tmp_path / "b"))
    assert done.returncode == 0, done.stderr
    files = [p.relative_to(tmp_path / "a") for p in sorted((tmp_path / "a").rglob("*")) if p.is_file()]
    assert files and all((tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files)


def test_bench_starts_itself_again(tmp_path):
    figures = tmp_path / "speed.json"
    line = "bench --seconds 0.001 --worlds 1 --sensing-worlds 1 --size 4x4 --threads 1 --out".split()
    done = program(*line, str(figures), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    rows = {row["what"]: row for row in json.loads(figures.read_text())["rows"]}
    assert 0.0 < rows["start to first depth image, with Python's own start"]["median"] < 60.0


def test_a_reader_that_has_seen_enough_is_no_error():
    both = f"{sys.executable} -m propwash drones cf2x_L250 | head -1; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", both], capture_output=True, text=True, env=ENVIRONMENT)
    assert (done.returncode, done.stderr) == (0, "")


def test_ctrl_c_ends_it(tmp_path):
    line = ["fly", "--scene", str(ROOT / "xml/room.xml"), "--drone", "cf2x_L250", "--worlds", "2000", "--seconds", "60"]
    line += ["--out", str(tmp_path / "out")]
    running = subprocess.Popen([sys.executable, "-m", "propwash", *line], stderr=subprocess.PIPE, env=ENVIRONMENT)
    deadline = time.monotonic() + 60
    while not (tmp_path / "out/manifest.json").is_file():
        assert running.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    sent = time.monotonic()
    running.send_signal(signal.SIGINT)
    running.communicate(timeout=30)
    assert running.returncode == -signal.SIGINT
    assert time.monotonic() - sent < 2.0


def test_ctrl_c_stays_ignored_where_it_was():
    """As in a script's background job, whose shell ignores it."""
    look = "import signal, sys; sys.argv = ['propwash', '--version']; from propwash.__main__ import main; main(); "
    look += "print(signal.getsignal(signal.SIGINT) == signal.{})"
    for first, after in (("SIG_IGN", "SIG_IGN"), ("default_int_handler", "SIG_DFL")):
        code = f"import signal; signal.signal(signal.SIGINT, signal.{first}); " + look.format(after)
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=ENVIRONMENT)
        assert done.stdout.splitlines()[-1] == "True", (first, done.stdout)
