"""One description of a simulation: the same defaults by every door, and data sets that are flown again."""

import inspect
import json
import os
import subprocess

import numpy as np
import pyarrow.parquet as pq
import pytest
from conftest import ROOT

import propwash
from propwash import _native, datasets

envs = pytest.importorskip("propwash.envs")

COLUMNS = {
    "pos": ["px", "py", "pz"],
    "quat": ["qx", "qy", "qz", "qw"],
    "vel": ["vx", "vy", "vz"],
    "ang_vel": ["wx", "wy", "wz"],
}
LINE = "--scene xml/forest.xml --drone {vehicle} --drone cf21B_500 --worlds 2 --seconds 0.4 --log-hz 500 --fps 10 --size 12x8"


@pytest.fixture(autouse=True)
def in_the_checkout(monkeypatch):
    monkeypatch.chdir(ROOT)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A data set of a vehicle file with random effects, of drawn masses and moved obstacles."""
    folder = tmp_path_factory.mktemp("config")
    turbulence = '[[effect]]\nkind = "turbulence"\nsigma_m_s = [0.5, 0.5, 0.3]\nlength_m = [1.0, 1.0, 1.0]\n'
    (folder / "mine.toml").write_text(propwash.Vehicle("cf2x_L250").with_effects(turbulence).to_toml())
    (folder / "rules.toml").write_text('[[rule]]\nparameter = "body.mass_kg"\ndraw = { scale = [0.9, 1.1] }\n')
    program = os.environ.get("PROPWASH_BIN")
    assert program, "set PROPWASH_BIN to the propwash program (cargo xtask test does)"
    line = LINE.format(vehicle=folder / "mine.toml").split()
    more = ["--randomize", folder / "rules.toml", "--obstacle-jitter", "0.3", "--seed", "5", "--out", folder / "set"]
    done = subprocess.run([program, "fly", *line, *map(str, more)], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    (folder / "mine.toml").unlink()  # the manifest is all that is needed beside the scene
    return folder / "set"


def test_every_door_has_the_same_defaults():
    default = json.loads(_native.read_config("{}"))
    assert (default["integrator"], default["control"], default["sim_hz"]) == ("euler", "state", 500)
    sim = propwash.Sim().config
    # What a Sim decides: the precision of many worlds, and how many drones its list makes.
    assert {k: v for k, v in sim.items() if v != default[k]} == {"precision": "f32", "n_drones": 1}
    env = envs.DroneVectorEnv().config
    assert {k: env[k] for k in default if env[k] != default[k]} == {
        "precision": "f32",
        "n_drones": 1,
        "control": "attitude",  # by the action
        "scene": "none",
        "open_ground_z_m": 0.0,
    }
    # And what signatures and docstrings show.
    shown = {name: p.default for name, p in inspect.signature(propwash.Sim).parameters.items()}
    names = {"n_worlds": "n_worlds", "control": "control", "freq": "sim_hz", "integrator": "integrator", "engine": "engine"}
    names |= {"seed": "seed", "rotor_start": "rotor_start", "first_world": "first_world"}
    assert {name: shown[name] for name in names} == {name: default[field] for name, field in names.items()}
    assert (shown["drone"], shown["dynamics"]) == (default["drones"][0]["vehicle"], default["drones"][0]["dynamics"])
    room = propwash.Sim.from_config({"scene": {"files": ["xml/room.xml"]}, "camera": {}})
    assert room.camera is not None and room.camera.kind == propwash.Camera("fpv").kind == "z_depth"
    assert room.camera.range == (0.01, 20.0) and room.camera.resolution == (64, 64)


def test_a_config_gives_the_same_simulation():
    vehicle = propwash.Vehicle("cf2x_L250").with_effects('[[effect]]\nkind = "payload"\nmass_kg = 0.005\n')
    made = propwash.Sim(
        3, 2, [vehicle, "cf21B_500"], ["first_principles", "so_rpy"], "attitude", 1000, ["xml/room.xml", "xml/forest.xml"],
        layout=[1, 0, 1], integrator="rk4", precision="f64", seed=9, rotor_start="off", state_freq=50,
        randomization=[{"parameter": "body.mass_kg", "draw": {"scale": [0.9, 1.1]}}],
    )  # fmt: skip
    again = propwash.Sim.from_config(json.loads(json.dumps(made.config)))
    assert again.config == made.config
    assert (again.dynamics, again.freq, again.precision) == (("first_principles", "so_rpy"), 1000, "f64")
    assert [v.sha256 for v in again.vehicles] == [v.sha256 for v in made.vehicles] and list(again.layout) == [1, 0, 1]
    command = np.tile([0.05, -0.02, 0.0, 0.4], (3, 2, 1))
    for sim in (made, again):
        sim.attitude_control(command)
        sim.step(60)
    for name in COLUMNS:
        assert np.array_equal(getattr(made.data, name), getattr(again.data, name)), name
    other = propwash.Sim.from_config(made.config, n_worlds=1, layout=None, scene=None)
    assert other.n_worlds == 1 and other.scene is None


def states(folder, world):
    table = pq.read_table(folder / f"world_{world:05d}" / "states.parquet")
    return {name: np.stack([table[c].to_numpy().reshape(-1, 2) for c in columns], -1) for name, columns in COLUMNS.items()}


@pytest.mark.parametrize("source", ["folder", "manifest", "dict"])
def test_a_data_set_is_flown_again_from_its_manifest(flown, source):
    of = {"folder": flown, "manifest": str(flown / "manifest.json"), "dict": datasets.open(flown).manifest}[source]
    sim = propwash.Sim.from_config(of)
    assert (sim.precision, sim.seed, sim.n_worlds, sim.n_drones, sim.vehicles[0].name) == ("f64", 5, 2, 2, "mine")
    recorded = [states(flown, w) for w in range(2)]
    for step in range(201):
        for w, world in enumerate(recorded):
            for name, rows in world.items():
                assert np.array_equal(getattr(sim.data, name)[w], rows[step]), (w, step, name)
        if step == 0:
            with np.load(flown / "world_00001" / "frames.npz") as frames:
                assert np.array_equal(sim.render_depth()[1], frames["depth_m"][0])
        sim.state_control(sim.pattern_command())
        sim.step()


def test_lanes_fly_a_data_set_again_within_rounding(flown):
    sim = propwash.Sim.from_config(flown, precision="f32")
    recorded = [states(flown, w) for w in range(2)]
    for _ in range(200):
        sim.state_control(sim.pattern_command())
        sim.step()
    for w, world in enumerate(recorded):
        assert np.abs(sim.data.pos[w] - world["pos"][200]).max() < 1e-3


def test_one_world_of_a_data_set_flies_alone(flown):
    sim = propwash.Sim.from_config(flown, n_worlds=1, first_world=1)
    sim.state_control(sim.pattern_command())
    sim.step()
    assert np.array_equal(sim.data.pos[0], states(flown, 1)["pos"][1])


def test_errors_name_the_field(flown, tmp_path):
    for config, words in [
        ({"sim_hs": 1}, "sim_hs: unknown field `sim_hs`, expected one of"),
        ({"integrator": "rk5"}, "integrator: unknown variant `rk5`"),
        ({"drones": [{"vehicle": "nothing"}]}, "nothing"),
        ({"camera": {}}, "camera: expected none without a scene"),
        ({"obstacle_jitter_m": float("nan")}, "obstacle_jitter_m: expected a finite number"),
        ({"format": "propwash-dataset", "format_version": 1}, "config: expected the whole description"),
        ({**datasets.open(flown).manifest, "format_version": 2}, "propwash-dataset of version 1"),
    ]:
        with pytest.raises(ValueError) as caught:
            propwash.Sim.from_config(config)
        assert words in str(caught.value), config
    with pytest.raises(ValueError, match="unknown field `worlds`"):
        propwash.Sim.from_config({}, worlds=3)
    with pytest.raises(OSError):
        propwash.Sim.from_config(tmp_path / "nothing.toml")
    with pytest.raises(TypeError, match="source: expected a path"):
        propwash.Sim.from_config(3)
    with pytest.raises(propwash.Error, match="flies no pattern"):
        propwash.Sim().pattern_command()
    # Another scene than the one that was recorded.
    manifest = json.loads((flown / "manifest.json").read_text())
    manifest["config"]["scene"] = {"files": ["xml/room.xml"]}
    with pytest.raises(ValueError, match="scene_sha256: expected"):
        propwash.Sim.from_config(manifest)
    assert propwash.Sim.from_config(manifest, scene_sha256=[]).scene is not None


def test_errors_of_a_file_name_it(tmp_path):
    (tmp_path / "mine.toml").write_text("n_worlds = 1\nn_drone = 3\n")
    with pytest.raises(ValueError, match=r"mine\.toml, n_drone, line 2: unknown field `n_drone`"):
        propwash.Sim.from_config(tmp_path / "mine.toml")


def test_a_toml_file_is_read(tmp_path):
    (tmp_path / "mine.toml").write_text('n_worlds = 3\npattern = "hover"\n[[drones]]\nvehicle = "hb_x500"\n')
    sim = propwash.Sim.from_config(tmp_path / "mine.toml")
    assert sim.n_worlds == 3 and sim.vehicles[0].name == "hb_x500" and np.allclose(sim.data.pos[:, 0, 2], 1.0)
    assert np.allclose(sim.pattern_command(0.5)[..., 2], 1.0)
