"""Sensors by every door: a simulation, environments with tasks of one's own, data sets."""

import json
import os
import subprocess

import numpy as np
import pytest
from conftest import ROOT

import propwash
from propwash import datasets

envs = pytest.importorskip("propwash.envs")

# A floor, and a wall whose face is at x = 3 m.
HALL = (
    "<mujoco><worldbody><geom type='plane' size='0 0 1'/>"
    "<geom name='wall' type='box' size='0.5 20 20' pos='3.5 0 0'/></worldbody></mujoco>"
)
FRONT = {"kind": "range_finder", "name": "front", "direction": [1, 0, 0], "range_m": 10}
NOISY = {"kind": "imu", "noise": {"accelerometer_bias_m_s2": 0.1, "gyroscope_density_rad_s_sqrt_hz": 0.01}}


@pytest.fixture(autouse=True)
def in_the_checkout(monkeypatch):
    monkeypatch.chdir(ROOT)


def test_a_simulation_reads_its_sensors():
    camera = {"kind": "depth_camera", "name": "rear", "labels": True, "camera": {"width": 6, "height": 4}}
    camera["camera"]["mount"] = {"pos_m": [-0.1, 0, 0], "quat_xyzw": [0, 0, 1, 0]}
    sim = propwash.Sim(2, scene=HALL, seed=1, sensors=["lidar", FRONT, "optical_flow", NOISY, camera])
    sim.set_initial(pos=[0.0, 0.0, 2.0])
    sim.reset()
    assert [c.name for c in sim.sensors["imu"]] == ["accelerometer", "gyroscope", "saturated"]
    assert sim.sensors["rear"][2] == propwash.SensorChannel("geom_id", "1", (4, 6), "int32")
    assert np.allclose(sim.read("front")["range"], 3.0, atol=1e-5) and sim.read("front")["range"].shape == (2, 1)
    lidar = sim.read("lidar")["range"]
    # 72 rays all around, forward first: those that look at the wall within 12 m, and the others.
    angle = np.arange(72) * 2 * np.pi / 72
    expected = np.minimum(np.where(np.cos(angle) > 1e-9, 3.0 / np.maximum(np.cos(angle), 1e-9), 12.0), 12.0)
    assert lidar.shape == (2, 1, 1, 72) and np.allclose(lidar[0, 0, 0], expected, atol=1e-4)
    rear = sim.read("rear")
    assert rear["status"].dtype == np.uint8 and rear["geom_id"].dtype == np.int32
    assert (rear["geom_id"][0, 0, 3] == 0).all() and (rear["status"][0, 0, 0] == 1).all(), "floor below, nothing above"
    assert rear["depth"][0, 0, 0, 0] == 20.0, "the greatest depth where nothing is seen"
    first = sim.read("imu")["accelerometer"]
    sim.step(10)
    flow = sim.read("optical_flow")
    assert np.allclose(flow["distance"], 2.0, atol=0.01) and (flow["valid"] == 1).all()
    mixed = sim.read("imu", mask=[True, False])["accelerometer"]
    assert (mixed[0] != first[0]).any() and (mixed[1] == first[1]).all()
    with pytest.raises(KeyError, match="lidar, front"):
        sim.read("sonar")
    with pytest.raises(ValueError, match="one of imu|unknown variant"):
        propwash.Sim(sensors=["sonar"])
    with pytest.raises(TypeError, match="a list of kinds or dicts"):
        propwash.Sim(sensors="imu")


def test_saved_and_forked_worlds_read_on_as_they_did():
    sim = propwash.Sim(2, seed=3, sensors=[NOISY])
    sim.read("imu")
    state = sim.save()

    def next_readings():
        sim.step(5)
        return sim.read("imu")

    before = next_readings()
    sim.restore(state)
    after = next_readings()
    assert all((before[k] == after[k]).all() for k in before)


class Wall(envs.Task):
    """Keeps a metre from the wall, as the range finder says."""

    channels = {"error": 1}
    start_space = [[0.0, -1.0, 1.5], [1.0, 1.0, 2.0]]
    scene = HALL

    def observe(self, worlds):
        return {"error": worlds.sensors["front_range"] - 1.0}

    def reward(self, worlds):
        assert not worlds.sensors["front_range"].flags.writeable
        return -np.abs(worlds.sensors["front_range"] - 1.0)


def test_environments_observe_sensors_and_tasks_see_by_them():
    env = envs.DroneVectorEnv(
        4, task=Wall, sensors=[FRONT, NOISY, {"kind": "lidar", "sample_hz": 10, "noise_m": 0.01}], seed=2, autoreset_mode="SameStep", max_episode_time=0.2
    )
    obs, _ = env.reset(seed=5)
    space = env.single_observation_space
    assert space["front_range"].shape == () and space["imu_gyroscope"].shape == (3,) and space["lidar_range"].shape == (1, 72)
    assert env.observation_space.contains(obs)
    assert np.allclose(obs["front_range"], 3.0 - obs["pos"][:, 0], atol=1e-5)
    assert np.allclose(obs["error"][:, 0], obs["front_range"] - 1.0)
    held = obs["lidar_range"]
    for k in range(10):
        obs, reward, _, truncated, info = env.step(np.zeros((4, 4), np.float32))
        assert (obs["lidar_range"] == held).all() == (k not in (4, 9)), "ten times a second, of fifty"
        held = obs["lidar_range"]
        if k < 9:
            assert np.allclose(reward, -np.abs(obs["front_range"] - 1.0))
    assert truncated.all()
    last = info["final_obs"][0]
    assert set(last) == set(obs) and last["front_range"].shape == ()
    assert np.isclose(reward[0], -abs(last["front_range"] - 1.0)) and last["front_range"] != obs["front_range"][0]
    with pytest.raises(ValueError, match="1 to 50 Hz"):
        envs.DroneVectorEnv(1, task=Wall, sensors=[{**FRONT, "sample_hz": 100}])
    with pytest.raises(ValueError, match="without a scene"):
        envs.DroneVectorEnv(1, task="reach_pos", sensors=["lidar"])


def test_the_same_batch_reads_the_same_however_it_is_split():
    def readings(n, first_world):
        env = envs.DroneVectorEnv(n, task="reach_pos", sensors=[NOISY], seed=2, first_world=first_world)
        out = [env.reset(seed=9)[0]["imu_accelerometer"]]
        for _ in range(5):
            out.append(env.step(np.zeros((n, 4), np.float32))[0]["imu_accelerometer"])
        return np.stack(out)

    whole = readings(6, 0)
    assert (np.concatenate([readings(2, 0), readings(4, 2)], axis=1) == whole).all()
    assert len(np.unique(whole[0, :, 0])) == 6


def fly(out, *options):
    program = os.environ.get("PROPWASH_BIN")
    assert program, "set PROPWASH_BIN to the propwash program (cargo xtask test does)"
    command = [program, "fly", "--scene", "xml/forest.xml", "--drone", "cf2x_L250", "--seconds", "0.4", *options, "--out", str(out)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)


def test_a_data_set_holds_what_sensors_read_and_is_flown_again(tmp_path):
    sensors = ["imu:sample_hz=500,noise={accelerometer_bias_m_s2=0.1}", "lidar:rings=2,columns=8,elevation_rad=[-0.2,0.2]"]
    sensors.append("depth_camera:name=down,labels=true,camera={width=5,height=4,mount={quat_xyzw=[0,0.70710678,0,0.70710678]}}")
    camera = ["--camera-mount", "0.03,0,0.02,0,30,0", "--intrinsics", "20,20,16,12", "--size", "32x24"]
    flags = [flag for s in sensors for flag in ("--sensor", s)]
    done = fly(tmp_path / "set", *flags, *camera, "--worlds", "2", "--fps", "10")
    assert done.returncode == 0, done.stderr
    data = datasets.open(tmp_path / "set")
    data.verify()
    assert data.manifest["cameras"][0]["k"] == [[20.0, 0.0, 16.0], [0.0, 20.0, 12.0], [0.0, 0.0, 1.0]]
    rates = {s["name"]: s["sample_hz"] for s in data.manifest["sensors"]}
    assert rates == {"imu": 500, "lidar": 100, "down": 10}
    world = data.world(1)
    imu, lidar, down = (world.sensor(name) for name in ("imu", "lidar", "down"))
    assert imu["accelerometer"].shape == (201, 1, 3) and lidar["range"].shape == (41, 1, 2, 8)
    assert down["depth"].shape == (5, 1, 4, 5) and down["geom_id"].dtype == np.int32 and (down["step"] == np.arange(5) * 50).all()
    # Samples of frames hold the last reading.
    sample = data[len(data) - 1]
    assert (sample["imu_accelerometer"] == imu["accelerometer"][200, 0]).all()
    assert (sample["down_depth"] == down["depth"][4, 0]).all()
    # The same again in a simulation of the user's, to the bit.
    sim = propwash.Sim.from_config(tmp_path / "set", n_worlds=1, first_world=1)
    for step in range(201):
        assert (sim.read("imu")["accelerometer"][0] == imu["accelerometer"][step]).all(), step
        sim.state_control(sim.pattern_command())
        sim.step()
    frame = propwash.Sim.from_config(tmp_path / "set", n_worlds=1, first_world=1).depth_frame()
    assert (frame.depth[0, 0] == world.frames("depth_m")[0, 0]).all()
    with pytest.raises(KeyError, match="imu, lidar, down"):
        world.sensor("sonar")
    # Found damaged where it is.
    file = tmp_path / "set" / "world_00001" / "sensor_lidar.npz"
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(datasets.DamagedError, match="sensor_lidar.npz"):
        datasets.open(tmp_path / "set").world(1).sensor("lidar")


@pytest.mark.parametrize(
    ("flag", "words"),
    [
        (["--sensor", "sonar"], "unknown variant `sonar`"),
        (["--sensor", "imu:rate=5"], "unknown field `rate`"),
        (["--sensor", "lidar:rings"], "KEY=VALUE"),
        (["--sensor", "lidar", "--sensor", "lidar"], "no other sensor"),
        (["--sensor", "imu:sample_hz=1000"], "1 to 500 Hz"),
        (["--camera-mount", "1,2"], "X,Y,Z"),
        (["--intrinsics", "1,2,3"], "4 finite numbers"),
        (["--intrinsics", "0,20,16,12"], "focal lengths"),
    ],
)
def test_flags_that_make_no_sense_are_refused_before_anything_is_written(tmp_path, flag, words):
    done = fly(tmp_path / "set", *flag)
    assert done.returncode != 0 and words in done.stderr, done.stderr
    assert not (tmp_path / "set").exists()


def test_a_configuration_with_sensors_is_read_back(tmp_path):
    sim = propwash.Sim(scene=HALL, sensors=[FRONT, NOISY])
    text = json.dumps(sim.config)
    again = propwash.Sim.from_config(json.loads(text))
    assert again.config == sim.config and list(again.sensors) == ["front", "imu"]
