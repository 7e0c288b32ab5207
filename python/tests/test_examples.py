"""Examples in Python run to their end and say what they promise. Those that learn are cut short here, and need torch, which is no part of the
test environment (its wheel for Linux takes 3 GB)."""

import importlib.util
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from conftest import ROOT

import propwash
import propwash.envs

TESTED = {
    "cross_forest.py",
    "learn_by_gradients.py",
    "learn_goals.py",
    "lqr.py",
    "mppi.py",
    "nmpc.py",
    "own_controller.py",
    "own_dataset.py",
    "own_goal.py",
    "own_task.py",
    "raptor.py",
    "ray_dataset.py",
    "swap_places.py",
    "swarm_exchange.py",
    "train_bptt.py",
    "train_forest.py",
    "train_reach.py",
    "train_sb3.py",
}


def run(name, *args, cwd=ROOT):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, str(ROOT / "examples" / name), *map(str, args)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=cwd)
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


def test_a_task_of_ones_own_is_flown(tmp_path):
    said = run("own_task.py", "--picture", tmp_path / "own_task.png")
    hits = dict(re.findall(r"(.+): hit in (\d+) %", said))
    assert int(hits["holds its place"]) > 90 and int(hits["gives way"]) < 10, said
    assert "Propwash/Dodge-v0, 64 episodes" in said and (tmp_path / "own_task.png").stat().st_size > 20_000


def test_a_goal_is_learnt_and_flown_in_its_environment(tmp_path):
    pytest.importorskip("matplotlib")
    said = run("own_goal.py", "--picture", tmp_path / "own_goal.png")
    assert int(re.search(r"(\d+) of 100 flights reach eight places", said).group(1)) >= 60, said
    rows = re.findall(r"^(.+): ([\d.]+) places in 12 s, ([\d.]+)% of the episodes broken off", said, re.M)
    assert len(rows) == 5 and all(float(places) > 7.0 and float(broken) < 10.0 for _, places, broken in rows), said
    assert (tmp_path / "own_goal.png").stat().st_size > 10_000


def test_a_vehicle_of_ones_own_flies_and_learns():
    hexa = str(ROOT / "examples/own_vehicle/hexa.toml")
    sim = propwash.Sim(drone=hexa, scene="room")
    sim.state_control(propwash.Command.hover([[[0.5, 0.0, 1.2]]]))
    sim.step(2000)
    assert np.abs(sim.data.pos[0, 0] - [0.5, 0.0, 1.2]).max() < 0.05, sim.data.pos
    assert sim.data.rotor_vel.shape == (1, 1, 6) and sim.render_depth("fpv", (32, 24)).min() > 0.1
    env = propwash.envs.DroneVectorEnv(4, task="reach_pos", drone=hexa)
    env.reset(seed=1)
    for _ in range(5):
        observed, reward, *_ = env.step(np.zeros(env.action_space.shape, np.float32))
    assert np.isfinite(reward).all() and np.isfinite(observed["pos"]).all()


def test_a_policys_flights_become_a_data_set(tmp_path):
    said = run("own_dataset.py", tmp_path / "set")
    assert "16 worlds" in said and "lidar_range (1, 8)" in said, said


def test_policies_are_learnt_by_gradients(tmp_path):
    pytest.importorskip("gymnasium")
    said = run("learn_by_gradients.py", "--no-picture", "--picture", tmp_path / "learn.png")
    row = re.search(r"^\| as trained \| ([\d.]+) mm \| ([\d.]+) mm \| ([\d.]+)% caught", said, re.M)
    eight, fast, caught = map(float, row.groups())
    assert eight < 8.7 and fast < 166.0 and caught >= 95.0, said
    assert propwash.Policy.load(tmp_path / "learn_1.npz").trained["environment"] == "Propwash/Trajectory-v0"


def test_places_landings_and_gates_are_learnt(tmp_path):
    pytest.importorskip("gymnasium")
    said = run("learn_goals.py", "--no-picture", "--flights", 200, "--picture", tmp_path / "goals.png")
    row = re.search(r"^\| as trained \| ([\d.]+) mm \| ([\d.]+)%, (\d+) mm \| ([\d.]+)% \| ([\d.]+)% \| ([\d.]+)% \|", said, re.M)
    eight, places, off, landings, alone, races = map(float, row.groups())
    assert eight < 15.9 and places >= 99.0 and off < 20 and landings >= 95.0 and alone < landings and races >= 90.0, said
    assert len(list(tmp_path.glob("learn_goals_*.npz"))) == 5


def test_controllers_of_ones_own_follow_and_rise(tmp_path):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "controllers.png"
    said = run("own_controller.py", "--picture", picture)
    still = {name: int(mm) for name, mm in re.findall(r"^  (.*?) +(\d+) mm +\d+ mm$", said, re.M)}
    assert set(still) == {"a cascade", "lee", "indi", "on board"}
    assert all(still[name] < 60 for name in ("a cascade", "lee", "indi")) and picture.stat().st_size > 10_000
    assert re.search(r"px4 \d+ ms, ardupilot \d+ ms, on board \d+ ms", said) and re.search(r"betaflight \d+ ms", said)


def test_gains_of_the_slopes_hold_a_hover(tmp_path):
    pytest.importorskip("scipy")
    said = run("lqr.py", "--worlds", 64, cwd=tmp_path)
    assert "64 of 64 hover within 2 cm" in said, said


def test_samples_find_a_way_between_poles(tmp_path):
    said = run("mppi.py", "--flights", 2, "--samples", 256, cwd=tmp_path)
    assert "2 of 2 flights arrive, 0 touch a pole" in said, said


def test_a_figure_of_eight_is_followed_by_optimisation(tmp_path):
    pytest.importorskip("casadi")
    said = run("nmpc.py", "--flights", 1, "--seconds", 4, cwd=tmp_path)
    off = [float(line.split(": ")[1].split(" mm")[0]) for line in said.splitlines() if " mm off" in line]
    assert len(off) == 2 and off[0] < 1 and off[1] < 10, said


def test_drones_exchange_places_without_touching(tmp_path):
    said = run("swarm_exchange.py", "--drones", 32, cwd=tmp_path)
    assert "0 of 32 touch another" in said, said


def test_reaching_is_learnt(tmp_path):
    pytest.importorskip("torch")
    flights = tmp_path / "flights.png"
    said = run("train_reach.py", "--steps", 300_000, "--seconds", 120, "--out", tmp_path, "--picture", flights)
    before, after = map(float, re.search(r"mean return ([-\d.]+) -> ([-\d.]+) of 100", said).groups())
    assert after > 2.0 * before, said
    assert (tmp_path / "train_reach.png").stat().st_size > 5_000 and flights.stat().st_size > 20_000
    row = propwash.evaluate(propwash.Policy.load(tmp_path / "train_reach.npz"), episodes=64).rows[0]
    assert row.mean_distance < 0.8, row  # 2.1 untrained


def test_reaching_is_learnt_by_gradients_in_pytorch(tmp_path):
    pytest.importorskip("torch")
    flights = tmp_path / "flights.png"
    said = run("train_bptt.py", "--updates", 20, "--out", tmp_path, "--picture", flights)
    assert (tmp_path / "train_bptt.png").stat().st_size > 5_000 and flights.stat().st_size > 20_000
    row = propwash.evaluate(propwash.Policy.load(tmp_path / "train_bptt.npz"), episodes=64).rows[0]
    assert row.mean_distance < 0.1 and row.success >= 0.95, (row, said)  # 2.1 m untrained


def test_the_forest_is_trained_for_a_moment(tmp_path):
    pytest.importorskip("torch")
    said = run("train_forest.py", "--steps", 20_000, "--num-envs", 64, "--out", tmp_path)
    assert re.search(r"unseen forests: \d+ % arrive", said), said
    assert all((tmp_path / f"train_forest{end}.png").stat().st_size > 5_000 for end in ("", "_flight"))
    assert propwash.Policy.load(tmp_path / "train_forest.npz").observation[0].shape == (48, 64)


def test_the_saved_policy_of_the_forest_sees_what_was_trained(monkeypatch):
    torch = pytest.importorskip("torch")
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    import train_forest

    torch.manual_seed(1)
    network = train_forest.Policy()
    torch.nn.init.orthogonal_(network.mean[-1].weight)
    env = train_forest.make(4, {**train_forest.SETTINGS, "layouts": 2})
    policy = propwash.Policy.from_torch(network.mean, env, train_forest.INPUTS)
    seen, _ = env.reset(seed=1)
    plain, _ = env.unwrapped.reset(seed=1)
    with torch.no_grad():
        expected = network.mean(train_forest.inputs(seen)).clip(-1.0, 1.0).numpy()
    assert np.abs(policy(plain) - expected).max() < 1e-5


def test_raptor_flies_what_it_has_never_met():
    if importlib.util.find_spec("foundation_policy") is None:
        pytest.skip("foundation-policy is not installed")
    said = run("raptor.py", *propwash.vehicles(), ROOT / "tests/data/planted_hexa.toml", "--worlds", 16)
    hovers = dict(re.findall(r"^(\w+): after 8 s .* hovers in (\d+) %", said, re.M))
    assert set(hovers) == set(propwash.vehicles()) and all(int(part) >= 90 for part in hovers.values()), said
    assert re.search(r"planted_hexa.toml: not flown: it has 6 rotors; the policy commands four", said), said


def test_raptor_says_what_it_needs(tmp_path):
    (tmp_path / "foundation_policy.py").write_text("raise ImportError('none')")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *(p for p in sys.path if p)])}
    done = subprocess.run([sys.executable, str(ROOT / "examples/raptor.py")], capture_output=True, text=True, env=environment)
    assert done.returncode == 2 and "pip install foundation-policy" in done.stderr and "Traceback" not in done.stderr


def test_stable_baselines_train(tmp_path):
    if importlib.util.find_spec("stable_baselines3") is None:
        pytest.skip("stable-baselines3 is not installed")
    line = ("train_sb3.py", "--steps", 16_384, "--delay", 1, "--episodes", 20, "--save", tmp_path / "land.npz", "--picture", tmp_path / "land.png")
    said = run(*line)
    assert re.search(r"landed in \d+ % -> \d+ % of 20 episodes that it has not seen", said), said
    assert (tmp_path / "land.png").stat().st_size > 20_000
    assert propwash.Policy.load(tmp_path / "land.npz").trained["environment"] == "Propwash/Landing-v0"


@pytest.mark.parametrize("place", ["forest", "rooms"])
def test_places_are_crossed_by_gradients(tmp_path, place):
    pytest.importorskip("matplotlib")
    save, picture = tmp_path / "cross.npz", tmp_path / "cross.png"
    said = run("cross_forest.py", "--place", place, "--commands", 8000, "--flights", 6, "--save", save, "--picture", picture)
    assert re.search(r"\d+ commands in", said) and re.search(r"% of 6 flights through unseen scenes arrive", said), said
    assert picture.stat().st_size > 10_000
    assert propwash.Policy.load(save).action.kind == "attitude"


def test_places_are_changed_by_gradients(tmp_path):
    pytest.importorskip("matplotlib")
    save, picture = tmp_path / "swap.npz", tmp_path / "swap.png"
    said = run("swap_places.py", "--commands", 8000, "--worlds", 4, "--drones", 6, "--save", save, "--picture", picture)
    assert re.search(r"as trained: \S+ % of 4 exchanges done", said) and re.search(r"6 drones in one world: \d there", said), said
    assert picture.stat().st_size > 10_000
    assert propwash.Policy.load(save).action.kind == "attitude"
