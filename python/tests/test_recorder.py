"""Data sets of what a user's own loop flies."""

import os
import subprocess

import mujoco
import numpy as np
import pytest
from conftest import ROOT

import propwash
from propwash import datasets

LINE = "--scene xml/forest.xml --drone cf2x_L250 --drone cf21B_500 --worlds 2 --seconds 0.5 --fps 10 --size 12x8 --normals --sensor imu --sensor lidar"


@pytest.fixture(autouse=True)
def in_the_checkout(monkeypatch):
    monkeypatch.chdir(ROOT)


def fly(out, *options):
    program = os.environ.get("PROPWASH_BIN")
    assert program, "set PROPWASH_BIN to the propwash program (cargo xtask test does)"
    command = [program, "fly", *LINE.split(), *map(str, options), "--out", str(out)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)


def test_what_fly_flies_is_recorded_again_byte_for_byte(tmp_path):
    noise = tmp_path / "noise.toml"
    noise.write_text("axial_base_m = 0.002\ndropout_probability = 0.05\n")
    done = fly(tmp_path / "fly", "--noise", noise)
    assert done.returncode == 0, done.stderr
    sim = propwash.Sim.from_config(tmp_path / "fly")
    recorder = propwash.Recorder(tmp_path / "own", sim, seconds=0.5, fps=10, normals=True)
    for _ in recorder:
        while recorder.flying:
            sim.state_control(sim.pattern_command())
            recorder.step()
        # The simulation stays where its last step led.
        assert (sim.data.steps == 250).all()
    assert recorder.summary == {"worlds": 2, "quarantined": 0, "images": 24}
    flown, own = datasets.open(tmp_path / "fly"), datasets.open(tmp_path / "own")
    own.verify()
    for w in range(2):
        a, b = flown.world(w), own.world(w)
        assert a.files == b.files
        for name in a.files:
            if name != "states.parquet":
                assert a.path(name).read_bytes() == b.path(name).read_bytes(), name
        a, b = a.states(), b.states()
        for name in a.column_names:
            if name.startswith("ref_"):
                assert b[name].null_count == len(b), "there is no reference"
            else:
                # Nobody has commanded anything for the end of the flight.
                n = len(a) - 2 if name.startswith("cmd_") else len(a)
                assert a[name].slice(0, n).equals(b[name].slice(0, n)), name
    # The scene lies beside them, and MuJoCo loads it without any other file.
    model = mujoco.MjModel.from_binary_path(str(own.scene_path()))
    assert model.ngeom == len(own.manifest["geoms"]) and model.geom(3).name == own.manifest["geoms"][3]["name"]
    assert own.scene_path().read_bytes() == flown.scene_path().read_bytes()
    (tmp_path / "own" / "scene.mjb").write_bytes(b"MJB")
    with pytest.raises(datasets.DamagedError, match="scene.mjb"):
        datasets.open(tmp_path / "own").verify()
    assert own.manifest["flight"]["trajectory"]["kind"] == "user" and own.manifest["config"]["by_user"]
    # The program does not know these commands; the simulation is made again all the same.
    again = propwash.Sim.from_config(tmp_path / "own")
    assert again.config["drones"] == sim.config["drones"]
    program = os.environ["PROPWASH_BIN"]
    command = [program, "fly", "--config", str(tmp_path / "own" / "manifest.json"), "--out", str(tmp_path / "no")]
    refused = subprocess.run(command, capture_output=True, text=True)
    assert refused.returncode != 0 and "has to be run again" in refused.stderr


def policy_flown(out, episodes=2, stop_after=None, ends=False, **options):
    """Worlds that fall forward by an attitude command, with a stage in Python, in single precision."""
    sim = propwash.Sim(3, scene="xml/room.xml", control="attitude", seed=4, sensors=["imu"])
    calls = []

    def push(data):
        calls.append(1)
        data.disturbance_force[:, :, 0] = 0.001

    sim.pipeline.insert_before("integration", "push", push)

    def on_reset(episode):
        sim.set_initial(pos=[0.1 * episode, 0.0, 1.0])

    recorder = propwash.Recorder(out, sim, seconds=0.2, episodes=episodes, camera=propwash.Camera("fpv", resolution=(8, 6), range=(0.1, 20)), on_reset=on_reset, **options)
    begun = []
    for episode in recorder:
        begun.append(episode)
        if stop_after == len(begun):
            break
        command = np.tile([0.0, 0.2, 0.0, 1.0], (3, 1, 1))
        command[..., 3] = sim.hover_thrust()
        while recorder.flying:
            sim.attitude_control(command)
            recorder.step(7)
            if ends and sim.data.steps.max() >= 35:
                recorder.end([False, True, False])
    return sim, recorder, begun


def test_a_policys_flights_become_worlds_and_a_second_run_goes_on(tmp_path):
    _, recorder, begun = policy_flown(tmp_path / "set")
    assert begun == [0, 1] and recorder.summary["worlds"] == 6 and recorder.n_steps == 100
    data = datasets.open(tmp_path / "set")
    data.verify()
    first, second = data.world(0), data.world(3)
    states = second.states().to_pydict()
    assert states["px"][0] == np.float32(0.1) and len(states["px"]) == 21
    assert np.allclose(states["cmd_pitch"], np.float32(0.2)) and states["vx"][-1] > 0.1
    assert first.sensor("imu")["accelerometer"].shape == (21, 1, 3)
    assert first.frames("depth_m").shape == (5, 1, 6, 8) and first.info["start_clearance_m"] > 0
    assert data.manifest["flight"]["control_mode"] == "attitude" and states["ref_x"][0] is None
    # Stopped in its second episode, and run again: the same bytes.
    policy_flown(tmp_path / "cut", stop_after=2)
    with pytest.raises(datasets.UnfinishedError):
        datasets.open(tmp_path / "cut")
    _, recorder, begun = policy_flown(tmp_path / "cut")
    assert begun == [1] and recorder.summary["worlds"] == 6
    assert (tmp_path / "cut" / "complete.json").read_bytes() == (tmp_path / "set" / "complete.json").read_bytes()


def test_recorded_and_plain_flights_are_the_same(tmp_path):
    command = np.tile([0.05, 0.1, 0.2, 0.3], (2, 1, 1))

    def made():
        sim = propwash.Sim(2, scene="xml/room.xml", control="attitude")
        sim.set_initial(pos=[0, 0, 1.0])
        sim.reset()
        sim.attitude_control(command)
        return sim

    plain, recorded = made(), made()
    plain.step(50)
    recorder = propwash.Recorder(tmp_path / "set", recorded, seconds=0.1)
    for _ in recorder:
        recorded.attitude_control(command)
        recorder.step(1000)
        assert not recorder.flying
        for name in ("pos", "quat", "vel", "ang_vel", "rotor_vel", "controller_memory"):
            assert (getattr(plain.data, name) == getattr(recorded.data, name)).all(), name


def test_worlds_end_early_when_they_are_told_to_or_break(tmp_path):
    policy_flown(tmp_path / "set", episodes=1, ends=True)
    data = datasets.open(tmp_path / "set")
    rows = [data.world(w).states().num_rows for w in range(3)]
    assert rows == [21, 7, 21] and data.world(1).quarantine is None
    sim = propwash.Sim(2)
    recorder = propwash.Recorder(tmp_path / "broken", sim, seconds=0.1)
    for _ in recorder:
        recorder.step(20)
        sim.data.vel[1] = np.nan
        recorder.step(100)
    data = datasets.open(tmp_path / "broken")
    assert recorder.summary["quarantined"] == 1 and data.world(1).quarantine["step"] == 20
    assert data.world(0).states().num_rows == 11 and data.manifest["scene"]["name"] == "none"
    assert not data.manifest["cameras"] and data.world(0).contacts().num_rows == 0


def test_what_makes_no_sense_is_refused(tmp_path):
    sim = propwash.Sim(2, scene="xml/room.xml")
    for options, words in [
        ({"seconds": 0.0}, "seconds"),
        ({"log_freq": 300}, "log_hz"),
        ({"fps": 1000}, "fps"),
        ({"camera": "overview"}, "every drone carries"),
        ({"camera": "fpv", "noise": {"bias": 1}}, "unknown field"),
        ({"noise": {}}, "a camera beside it"),
        ({"normals": True}, "normals: expected a camera"),
        ({"episodes": 0}, "episodes"),
    ]:
        with pytest.raises((ValueError, propwash.Error), match=words):
            propwash.Recorder(tmp_path / "set", sim, **options)
    with pytest.raises(TypeError, match="propwash.Sim"):
        propwash.Recorder(tmp_path / "set", "sim")
    many = propwash.Sim(2, scene=["xml/room.xml", "xml/forest.xml"])
    with pytest.raises(ValueError, match="one scene"):
        propwash.Recorder(tmp_path / "set", many)
    recorder = propwash.Recorder(tmp_path / "set", sim, seconds=0.1, camera="fpv")
    with pytest.raises(ValueError, match="a flight that was begun"):
        recorder.step()
    with pytest.raises((ValueError, propwash.Error), match="another process is writing"):
        propwash.Recorder(tmp_path / "set", sim, seconds=0.1, camera="fpv")
    for _ in recorder:
        sim.step()
        with pytest.raises(ValueError, match="step by it alone"):
            recorder.step()
        break
