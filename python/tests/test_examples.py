"""Examples in Python run to their end and say what they promise. Those that learn are cut short here, and need torch, which is no part of the
test environment (its wheel for Linux takes 3 GB)."""

import importlib.util
import os
import re
import subprocess
import sys

import pytest
from conftest import ROOT

TESTED = {"own_dataset.py", "own_task.py", "ray_dataset.py", "train_forest.py", "train_reach.py", "train_sb3.py"}


def run(name, *args):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, str(ROOT / "examples" / name), *map(str, args)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_there_is_a_test_for_every_example():
    # That of ray_dataset.py stands in test_datasets.py.
    assert {path.name for path in (ROOT / "examples").glob("*.py")} == TESTED


@pytest.mark.parametrize("name", sorted(TESTED))
def test_examples_are_python(name):
    text = (ROOT / "examples" / name).read_text()
    compile(text, name, "exec")
    assert text.startswith('"""')


def test_a_task_of_ones_own_is_flown():
    said = run("own_task.py")
    hits = dict(re.findall(r"(.+): hit in (\d+) %", said))
    assert int(hits["holds its place"]) > 90 and int(hits["gives way"]) < 10, said


def test_a_policys_flights_become_a_data_set(tmp_path):
    said = run("own_dataset.py", tmp_path / "set")
    assert "16 worlds" in said and "lidar_range (1, 8)" in said, said


def test_reaching_is_learnt(tmp_path):
    pytest.importorskip("torch")
    said = run("train_reach.py", "--steps", 300_000, "--seconds", 120, "--out", tmp_path)
    before, after = map(float, re.search(r"mean return ([-\d.]+) -> ([-\d.]+) of 100", said).groups())
    assert after > 2.0 * before, said
    assert (tmp_path / "train_reach.png").stat().st_size > 5_000


def test_the_forest_is_trained_for_a_moment(tmp_path):
    pytest.importorskip("torch")
    said = run("train_forest.py", "--steps", 20_000, "--num-envs", 64, "--out", tmp_path)
    assert re.search(r"unseen forests: \d+ % arrive", said), said
    assert all((tmp_path / f"train_forest{end}.png").stat().st_size > 5_000 for end in ("", "_flight"))


def test_stable_baselines_train(tmp_path):
    if importlib.util.find_spec("stable_baselines3") is None:
        pytest.skip("stable-baselines3 is not installed")
    assert "mean return" in run("train_sb3.py", "--steps", 16_384)
