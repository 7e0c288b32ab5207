"""Saved policies: networks in NumPy, files, ONNX, C, and flights that say how good they are."""

import contextlib
import ctypes
import inspect
import json
import shutil
import struct
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from test_package import ENVIRONMENT

import propwash
from propwash.policies import ActionSpec, Branch, Channel, Input, Layer, Policy

gymnasium = pytest.importorskip("gymnasium")

import propwash.envs as envs  # noqa: E402


def weights(rng, *shape):
    return (rng.normal(size=shape) / np.sqrt(np.prod(shape[1:]))).astype(np.float32)


def every_part(limit="clip"):
    """A policy with every step of an input and every layer there is, and observations for it."""
    rng = np.random.default_rng(1)

    def linear(outputs, inputs):
        return Layer("linear", weights(rng, outputs, inputs), weights(rng, outputs))

    depth, goal, vel = Input("depth"), Input("goal"), Input("vel")
    image = Branch(
        (depth.nearness(0.2, 6.0).pool(2, 2, "min").scale(2.0, 0.1),),
        (
            Layer("conv2d", weights(rng, 5, 2, 3, 3), weights(rng, 5), {"stride": [1, 2], "padding": [1, 0]}),
            Layer("elu"),
            Layer("conv2d", weights(rng, 4, 5, 2, 2), weights(rng, 4)),
            Layer("silu"),
            Layer("flatten"),
            linear(8, 40),
            Layer("tanh"),
        ),
    )
    numbers = Branch(
        (
            goal.direction(0.1),
            goal.length().scale(0.1),
            vel.scale([0.5, 1.0, 2.0], [0.0, 0.1, 0.2]).clip(-1.0, 1.0),
            Input("quat").tilt(),
            goal.take(2, 0),
            depth.pool(6, 8, "mean").scale(2.0).round(),
            depth.pool(6, 8, "max"),
        ),
        (linear(9, 27), Layer("layer_norm", weights(rng, 9), weights(rng, 9)), Layer("leaky_relu")),
    )
    layers = (linear(7, 17), Layer("softplus"), linear(6, 7), Layer("sigmoid"), linear(6, 6), Layer("relu"), linear(4, 6))
    seen = (Channel("depth", (2, 12, 16), 2), Channel("goal", (3,)), Channel("quat", (4,)), Channel("vel", (3,)))
    ones = np.ones(4, np.float32)
    policy = Policy(seen, (image, numbers), layers, ActionSpec("velocity", -ones, 2.0 * ones, limit), {"note": "a note /* with a comment */"})
    obs = {
        "depth": rng.uniform(0.0, 7.0, (1000, 2, 12, 16)),
        "goal": 3.0 * rng.normal(size=(1000, 3)),
        "quat": rng.normal(size=(1000, 4)),
        "vel": rng.normal(size=(1000, 3)),
    }
    obs["quat"] /= np.linalg.norm(obs["quat"], axis=1, keepdims=True)
    return policy, {name: value.astype(np.float32) for name, value in obs.items()}


def in_c(policy, obs, folder, **kwargs):
    """Actions of the exported C."""
    policy.to_c(folder / "policy.c", **kwargs)
    line = "gcc -std=c99 -O2 -Wall -Wextra -Werror -pedantic -shared -fPIC -o policy.so policy.c -lm"
    done = subprocess.run(line.split(), cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    function = getattr(ctypes.CDLL(str(folder / "policy.so")), kwargs.get("name", "policy"))
    inputs = [np.ascontiguousarray(obs[c.name], np.float32) for c in policy.observation]
    out = np.zeros((len(inputs[0]), len(policy.action.low)), np.float32)
    for i in range(len(out)):
        function(*(x[i].ctypes.data_as(ctypes.c_void_p) for x in inputs), out[i].ctypes.data_as(ctypes.c_void_p))
    return out


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
@pytest.mark.parametrize("limit", ["clip", "tanh", "none"])
def test_the_exported_c_gives_the_same_actions(limit, tmp_path):
    policy, obs = every_part(limit)
    expected = policy(obs)
    assert np.abs(in_c(policy, obs, tmp_path, name="goal") - expected).max() < 1e-5
    assert np.unique(expected, axis=0).shape[0] > 900
    text = (tmp_path / "policy.c").read_text()
    assert "depth (2, 12, 16) m" in text and "yaw rate: -1 to 2" in text and "#include <math.h>" in text and text.count("#include") == 1


@pytest.mark.parametrize("limit", ["clip", "tanh", "none"])
def test_the_exported_onnx_gives_the_same_actions(limit, tmp_path):
    onnx = pytest.importorskip("onnx")
    from onnx.reference import ReferenceEvaluator

    policy, obs = every_part(limit)
    policy.to_onnx(tmp_path / "policy.onnx")
    model = onnx.load(tmp_path / "policy.onnx")
    few = {name: value[:100] for name, value in obs.items()}
    (out,) = ReferenceEvaluator(model).run(None, few)
    assert np.abs(out - policy(few)).max() < 1e-5
    assert json.loads({p.key: p.value for p in model.metadata_props}["propwash"])["action"]["kind"] == "velocity"


def test_onnx_is_asked_for_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(ImportError, match=r"propwash\[onnx\]"):
        every_part()[0].to_onnx(tmp_path / "policy.onnx")


def test_a_policy_is_kept_in_a_file(tmp_path):
    policy, obs = every_part()
    policy.save(tmp_path / "a.npz")
    again = Policy.load(tmp_path / "a.npz")
    assert (again(obs) == policy(obs)).all() and again.describe() == policy.describe()
    again.save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    # Any tool that opens zip files can read what it is; NumPy reads the weights.
    with zipfile.ZipFile(tmp_path / "a.npz") as archive:
        assert json.loads(archive.read("policy.json"))["format"] == "propwash policy"
    assert np.load(tmp_path / "a.npz")["layer0.weight"].shape == (7, 17)
    with pytest.raises(FileExistsError, match="force=True"):
        policy.save(tmp_path / "a.npz")
    with pytest.raises(ValueError, match=r"ends with \.npz"):
        policy.save(tmp_path / "a.pt")


def changed(path, out, change=None, without=None, **arrays):
    """A policy's file with another description, without an array, or with other arrays."""
    with zipfile.ZipFile(path) as archive, zipfile.ZipFile(out, "w") as new:
        for name in archive.namelist():
            held = archive.read(name)
            if name == "policy.json" and change is not None:
                told = json.loads(held)
                change(told)
                held = json.dumps(told).encode()
            if name != without and name not in arrays:
                new.writestr(name, held)
        for name, array in arrays.items():
            with new.open(name, "w") as file:
                np.lib.format.write_array(file, array)


def test_broken_files_are_refused_in_words(tmp_path):
    path, bad = tmp_path / "a.npz", tmp_path / "bad.npz"
    policy, _ = every_part()
    policy.save(path)
    whole = path.read_bytes()

    def refused(words):
        with pytest.raises(ValueError, match=words) as caught:
            Policy.load(bad)
        assert str(caught.value).startswith(f"{bad}: "), caught.value

    for cut in (0, 10, len(whole) // 2, len(whole) - 3):
        bad.write_bytes(whole[:cut])
        refused("expected a whole file of Policy.save")
    for at in range(60, len(whole), 97):
        bad.write_bytes(whole[:at] + bytes([whole[at] ^ 255]) + whole[at + 1 :])
        with contextlib.suppress(ValueError):  # where a byte means nothing the file is read
            Policy.load(bad)
    changed(path, bad, lambda told: told["action"].update(low=[1e300, 0, 0, 0]))
    refused("action: expected finite numbers low < high")
    np.savez(bad, a=np.zeros(3))
    refused("with policy.json in it; found a.npy")
    changed(path, bad, lambda told: told.update(version=2))
    refused("expected version 1 of the format, found 2")
    changed(path, bad, lambda told: told.update(format="other"))
    refused("format: expected")
    changed(path, bad, lambda told: told.pop("action"))
    refused("expected action, which is missing")
    changed(path, bad, lambda told: told["layers"][0].update(kind="lstm"))
    refused(r"layers\[0\]: expected one of the layers linear")
    changed(path, bad, lambda told: told["layers"][1].update(strange=1))
    refused(r"softplus: expected the options \[\], found \['strange'\]")
    changed(path, bad, lambda told: told["observation"][1].update(shape=[4]))
    refused("takes 27 numbers in a row, found the shape")
    changed(path, bad, lambda told: told["observation"][1].update(shape="3"))
    refused(r"observation\[1\]\.shape: expected a list")
    changed(path, bad, lambda told: told["branches"][0]["inputs"][0].update(channel="lidar"))
    refused("expected one of the channels depth, goal, quat, vel, found 'lidar'")
    changed(path, bad, lambda told: told["branches"][0]["inputs"][0]["steps"][0].update(near=9.0))
    refused("expected 0 < near < far")
    changed(path, bad, lambda told: told["branches"][0]["layers"][0].update(padding=[5, 0]))
    refused("a padding below 3")
    changed(path, bad, without="layer0.weight.npy")
    refused(r"layer0.weight.npy: expected an array of the shape \[7, 17\], found none")
    changed(path, bad, without="layer0.bias.npy")
    refused("expected a weight and a bias, found no bias")
    changed(path, bad, **{"layer0.bias.npy": np.full(7, np.nan, np.float32)})
    refused("bias: expected finite numbers")
    changed(path, bad, **{"layer0.bias.npy": np.zeros(6, np.float32)})
    refused(r"expected a bias of shape \(7,\)")
    changed(path, bad, **{"layer9.bias.npy": np.zeros(6, np.float32)})
    refused("no layer of policy.json has this array")
    with pytest.raises(FileNotFoundError, match="there is none"):
        Policy.load(tmp_path / "none.npz")


def test_observations_are_dicts_or_flat_arrays_of_any_number_of_worlds():
    rng = np.random.default_rng(2)
    layer = Layer("linear", weights(rng, 4, 6), weights(rng, 4))
    ones = np.ones(4, np.float32)
    seen = (Channel("pos", (3,)), Channel("vel", (3,)))
    policy = Policy(seen, (Branch((Input("vel"), Input("pos"))),), (layer,), ActionSpec("attitude", -ones, ones))
    obs = {"pos": rng.normal(size=(5, 2, 3)), "vel": rng.normal(size=(5, 2, 3)), "more": np.zeros((5, 2, 9))}
    actions = policy(obs)
    assert actions.shape == (5, 2, 4) and actions.dtype == np.float32
    assert policy.columns == {"pos": slice(0, 3), "vel": slice(3, 6)}
    assert (policy(np.concatenate([obs["pos"], obs["vel"]], axis=-1)) == actions).all()
    np.testing.assert_allclose(policy({name: value[3, 1] for name, value in obs.items()}), actions[3, 1], atol=1e-6)
    np.testing.assert_allclose(actions, np.clip(np.concatenate([obs["vel"], obs["pos"]], -1) @ layer.weight.T + layer.bias, -1, 1), atol=1e-5)
    for bad, words in (
        ({"pos": obs["pos"]}, "vel: expected this channel in the observation, found pos"),
        ({"pos": obs["pos"], "vel": obs["vel"][..., :2]}, r"vel: expected shape \(..., 3\), found"),
        ({"pos": obs["pos"], "vel": obs["vel"][:4]}, r"vel: expected \(5, 2\) before the shape"),
        (np.zeros((3, 7)), r"an array \(..., 6\) with the columns pos 0 to 2, vel 3 to 5; found shape \(3, 7\)"),
    ):
        with pytest.raises(ValueError, match=words):
            policy(bad)


class Tensor:
    """As a parameter of PyTorch."""

    def __init__(self, array):
        self.array, self.shape = array, array.shape

    def detach(self):
        return self

    cpu = detach

    def numpy(self):
        return self.array


class Linear:
    def __init__(self, rng, inputs, outputs):
        self.weight, self.bias = Tensor(weights(rng, outputs, inputs)), Tensor(weights(rng, outputs))


class Tanh:
    pass


class LSTM:
    pass


class Sequential(list):
    pass


def reach(**kwargs):
    return gymnasium.make_vec("Propwash/ReachPos-v0", num_envs=3, **kwargs)


def test_networks_of_pytorch_become_policies_with_the_environment_they_know():
    """By objects that look like those of PyTorch, which is no part of the test environment."""
    rng = np.random.default_rng(3)
    env = reach(freq=25, action_options={"max_tilt_rad": 0.4}, drone="cf2x_P250")
    net = Sequential([Linear(rng, 9, 8), Tanh(), Linear(rng, 8, 4)])
    inputs = [Input("difference_to_goal"), Input("vel").scale(0.5), Input("ang_vel").scale(0.2)]
    policy = Policy.from_torch(net, env, inputs, note="by hand")
    obs, _ = env.reset(seed=1)
    seen = np.concatenate([obs["difference_to_goal"], 0.5 * obs["vel"], 0.2 * obs["ang_vel"]], axis=1)
    hidden = np.tanh(seen @ net[0].weight.array.T + net[0].bias.array)
    np.testing.assert_allclose(policy(obs), np.clip(hidden @ net[2].weight.array.T + net[2].bias.array, -1, 1), atol=1e-6)
    assert [c.name for c in policy.observation] == ["ang_vel", "difference_to_goal", "vel"]
    assert policy.trained["environment"] == "Propwash/ReachPos-v0" and policy.trained["config"]["action"]["max_tilt_rad"] == 0.4
    assert policy.trained["propwash"] == propwash.__version__ and policy.action.step_hz == 25
    # What the wrappers do belongs to the policy.
    flat = envs.FlattenState(reach())
    policy = Policy.from_torch(Linear(rng, 16, 4), flat)
    assert policy.columns == flat.columns
    with pytest.raises(TypeError, match="expected a Sequential of Linear"):
        Policy.from_torch(Sequential([LSTM()]), env, inputs)
    with pytest.raises(ValueError, match="expected channels of the environment"):
        Policy.from_torch(net, env, [Input("lidar")])
    with pytest.raises(ValueError, match=r"takes 9 numbers in a row, found the shape \(3,\)"):
        Policy.from_torch(net, env, inputs[:1])
    with pytest.raises(TypeError, match="TransformObservation"):
        wrapped = gymnasium.wrappers.vector.TransformObservation(flat, lambda x: x)
        Policy.from_torch(Linear(rng, 16, 4), wrapped)


def test_policies_of_pytorch_give_what_pytorch_gives():
    torch = pytest.importorskip("torch")
    nn = torch.nn
    torch.manual_seed(1)
    env = envs.NormalizeDepth(gymnasium.make_vec("Propwash/ForestDepth-v0", num_envs=2, layouts=2, camera={"width": 16, "height": 12}))
    image = nn.Sequential(nn.Conv2d(1, 4, 3, stride=2, padding=1), nn.ELU(), nn.Flatten(), nn.Linear(4 * 6 * 8, 8), nn.LayerNorm(8))
    net = nn.Sequential(nn.Linear(11, 16), nn.SiLU(), nn.Dropout(), nn.Linear(16, 16), nn.LeakyReLU(0.1), nn.Linear(16, 4), nn.Softplus()).eval()
    far = float(env.unwrapped.single_observation_space["depth"].high.max())
    policy = Policy.from_torch(net, env, [Input("goal")], branches=[([Input("depth").scale(1.0 / far).image()], image)], limit="none")
    obs, _ = env.reset(seed=1)
    raw = {**obs, "depth": obs["depth"] * far}
    with torch.no_grad():
        seen = image(torch.from_numpy(obs["depth"])[:, None])
        expected = net(torch.cat([torch.from_numpy(obs["goal"]), seen], -1)).numpy()
    np.testing.assert_allclose(policy(raw), expected, atol=1e-5)


@pytest.mark.parametrize("kind", ["ppo", "sac", "td3", "cnn", "multi", "stack"])
def test_policies_of_stable_baselines_give_what_it_gives(kind):
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.vec_env import VecFrameStack, VecMonitor, VecNormalize

    from propwash.envs.sb3 import SB3VecEnv

    images = kind in ("cnn", "multi", "stack")
    name, more = ("ForestDepth", {"layouts": 2, "camera": {"width": 40, "height": 36}}) if images else ("ReachPos", {})
    raw = gymnasium.make_vec(f"Propwash/{name}-v0", num_envs=3, autoreset_mode="SameStep", seed=3, **more)
    stacked = envs.DepthFrameStack(raw, 2) if kind == "stack" else raw
    wrapped = envs.DepthImage(stacked, only=kind == "cnn") if images else stacked
    env = SB3VecEnv(wrapped if kind == "cnn" else envs.FlattenState(wrapped))
    env = VecNormalize(VecMonitor(env), clip_obs=2.0, norm_obs_keys=["state"] if kind in ("multi", "stack") else None, norm_obs=kind != "cnn")
    made = {"sac": sb3.SAC, "td3": sb3.TD3}.get(kind, sb3.PPO)
    options = {"learning_starts": 1000} if kind in ("sac", "td3") else {"n_steps": 8, "batch_size": 24}
    word = {"cnn": "CnnPolicy", "multi": "MultiInputPolicy", "stack": "MultiInputPolicy"}.get(kind, "MlpPolicy")
    model = made(word, env, seed=1, device="cpu", **options)
    model.learn(96)
    policy = Policy.from_sb3(model)
    env.training = False
    # What an environment without wrappers observes, beside what the wrappers make of it: by the wrappers themselves.
    obs = env.reset()
    plain = {name: raw.unwrapped._observe(raw.unwrapped._numbers, raw.unwrapped._depth, {})[name] for name in raw.single_observation_space}
    if kind == "stack":
        plain["depth"] = np.repeat(plain["depth"][:, None], 2, axis=1)
        assert policy.observation[1].frames == 2
    expected, _ = model.predict(obs, deterministic=True)
    np.testing.assert_allclose(policy(plain), expected, atol=2e-5)
    with pytest.raises(TypeError, match="VecFrameStack"):
        Policy.from_sb3(model, VecFrameStack(env, 2))


def pilot(freq=25, gain=1.0, **kwargs):
    """A policy that flies to the goal by velocities, with one layer: as the environment's own numbers say where the goal is."""
    env = reach(action="velocity", freq=freq, max_episode_time=5.0, action_options={"max_speed_m_s": 1.0}, **kwargs)
    weight = np.zeros((4, 6), np.float32)
    weight[:3, :3] = 0.5 * gain * np.eye(3)

    class Linear:
        bias = None

    Linear.weight = Tensor(weight)
    return Policy.from_torch(Linear(), env, [Input("difference_to_goal"), Input("vel")])


def test_a_policy_is_evaluated_on_vehicles_winds_and_delays(tmp_path):
    pilot().save(tmp_path / "pilot.npz")
    bare = propwash.Vehicle.from_toml(propwash.Vehicle("cf2x_L250").text.split("[[effect]]")[0], "bare")
    found = propwash.evaluate(tmp_path / "pilot.npz", vehicles=["cf2x_L250", bare], wind=(0.0, 1.0), delay=(0, 2), episodes=20)
    assert [(r.vehicle, r.wind_m_s, r.delay_steps) for r in found.rows] == [
        (v, w, d) for v in ("cf2x_L250", "bare") for w in (0.0, 1.0) for d in (0, 2)
    ]
    first = found.rows[0]
    assert first.success >= 0.9 and first.crashed == 0.0 and first.mean_distance < 0.2 and first.mean_seconds == pytest.approx(5.0)
    assert "less than 0.2 m from the goal" in found.success_means
    assert len({r.mean_return for r in found.rows[:4]}) == 4, "wind and delay change the flights"
    assert len(found.warnings) == 1 and "bare: its file has no effect, such as drag" in found.warnings[0]
    assert found.rows[4].mean_return == found.rows[6].mean_return, "wind does nothing to it"
    again = propwash.evaluate(Policy.load(tmp_path / "pilot.npz"), episodes=20)
    assert again.rows[0] == first, "the same seed flies the same episodes"
    assert propwash.evaluate(pilot(gain=0.0), episodes=20).rows[0].success <= 0.2
    heavy = propwash.evaluate(pilot(), episodes=20, mass=(1.0, 1.3)).rows
    assert heavy[0] == first and heavy[1].mean_return != first.mean_return
    assert propwash.evaluate(pilot(), episodes=20, within=1e-4).rows[0].success < first.success
    text = str(found)
    assert "success %" in text and text.count("\n") >= 9 and json.dumps(found.to_dict())


def test_episodes_are_the_same_however_they_are_parted(monkeypatch):
    from propwash.policies import _evaluate

    whole = propwash.evaluate(pilot(), episodes=12).rows
    monkeypatch.setattr(_evaluate, "_BATCH", 5)
    assert propwash.evaluate(pilot(), episodes=12).rows[0].mean_return == pytest.approx(whole[0].mean_return, rel=1e-6)


def test_rows_have_the_wind_and_delay_that_they_state():
    """Rules of the training that draw the same are left out; others stay."""
    rules = [
        {"parameter": "env.wind_m_s.*", "draw": {"normal": 3.0}},
        {"parameter": "env.action_delay_s", "draw": {"uniform": [0.0, 0.3]}},
    ]
    windy = propwash.evaluate(pilot(randomization=rules), episodes=10).rows[0]
    calm = propwash.evaluate(pilot(), episodes=10).rows[0]
    assert windy == calm
    masses = [{"parameter": "body.mass_kg", "draw": {"scale": [0.8, 1.2]}}]
    assert propwash.evaluate(pilot(randomization=masses), episodes=10).rows[0] != calm


def test_wind_blows_from_all_sides():
    from propwash.policies import _evaluate

    run = _evaluate._Run(pilot(), "Propwash/ReachPos-v0", {}, 1, 20, None)
    parts = list(run.parts(2.0))
    assert sum(n for _, _, n in parts) == 20 and [first for _, first, _ in parts] == list(np.cumsum([0] + [n for _, _, n in parts])[:-1])
    assert np.allclose([np.hypot(*w[:2]) for w, _, _ in parts], 2.0) and np.allclose(np.sum([w for w, _, _ in parts], axis=0), 0.0)


def test_generated_scenes_are_others_than_those_of_the_training():
    """And the ending of a task counts where it has one; functions fly too."""
    seen = []

    def ahead(obs):
        seen.append(obs["depth"][:, 8, 8])
        return np.tile([0.6, 0.0, 0.0, 0.0], (len(obs["pos"]), 1))

    settings = {"camera": {"width": 16, "height": 16}, "layouts": 2, "max_episode_time": 4.0, "scene": {"forest": {"trees": 20, "size_m": 8.0}}}
    found = propwash.evaluate(ahead, "Propwash/ForestDepth-v0", episodes=12, settings=settings)
    row = found.rows[0]
    assert found.success_means == "ended as done" and row.crashed > 0.0 and row.success + row.crashed + row.left <= 1.0
    from propwash.policies._evaluate import _environment

    env = gymnasium.make_vec("Propwash/ForestDepth-v0", num_envs=1, **settings)
    trained = Policy.from_torch(Sequential([Linear(np.random.default_rng(1), 3, 4)]), env, [Input("goal")])
    _, arguments = _environment(trained, None, None)
    assert arguments["scene"]["forest"]["seed"] == env.unwrapped.config["scene"]["forest"]["seed"] + 10_000
    assert arguments["scene"]["forest"]["trees"] == 20 and arguments["camera"]["width"] == 16


def test_the_environment_of_the_training_is_made_again_with_all_that_it_was():
    from propwash.policies._evaluate import arguments_of

    scene = {"forest": {"trees": 3, "moving": 2, "size_m": 8.0}}
    odd = {
        "drone": "cf21B_500", "n_drones": 1, "dynamics": "so_rpy", "action": "attitude", "normalize_actions": False,
        "action_options": {"max_tilt_rad": 0.3}, "sim_freq": 1000, "freq": 25, "max_episode_time": 3.0, "layouts": 2, "scene": scene,
        "camera": {"width": 8, "height": 8}, "sensors": ["imu"], "look": 2.0, "levels": {"pos_sigma_m": 0.02},
        "randomization": [{"parameter": "body.mass_kg", "draw": {"scale": [0.9, 1.1]}}],
        "obstacle_motion": {"kind": "circle"}, "obstacle_jitter": 0.2, "body_rate_law": "tracking",
    }  # fmt: skip
    env = gymnasium.make_vec("Propwash/ForestDepth-v0", num_envs=2, seed=3, task_options={"arrive_m": 0.5}, **odd).unwrapped
    again = arguments_of(env.config)
    assert gymnasium.make_vec("Propwash/ForestDepth-v0", num_envs=2, seed=3, **again).unwrapped.config == env.config
    # Arguments that shape no flight, or that an evaluation sets itself; all others must come back.
    own = {"num_envs", "task", "autoreset_mode", "seed", "first_world", "threads", "copy", "render_mode", "render_size", "max_episode_steps"}
    assert set(inspect.signature(envs.DroneVectorEnv).parameters) - own == set(again) == {*odd, "task_options"}


def test_frames_are_stacked_for_policies_that_want_them():
    env = envs.DepthFrameStack(gymnasium.make_vec("Propwash/ForestDepth-v0", num_envs=1, layouts=2, camera={"width": 8, "height": 8}), 3)
    rng = np.random.default_rng(1)
    policy = Policy.from_torch(Sequential([Linear(rng, 192, 4)]), env, [Input("depth")])
    assert policy.observation[0].shape == (3, 8, 8)
    assert propwash.evaluate(policy, episodes=4).rows[0].episodes == 4


def test_a_task_of_ones_own_is_evaluated():
    class Hold(envs.Task):
        channels = {"below": 1}
        start_space = [[-1.0, -1.0, 0.5], [1.0, 1.0, 1.5]]
        max_episode_time = 2.0

        def __init__(self, height=1.0):
            self.height = height

        def observe(self, worlds):
            return {"below": self.height - worlds.observed_pos[:, 2]}

        def reward(self, worlds):
            return np.exp(-np.abs(self.height - worlds.pos[:, 2]))

    name = envs.register_task("hold_for_policies", Hold)
    env = gymnasium.make_vec(name, num_envs=2, task_options={"height": 1.5})
    policy = Policy.from_torch(Sequential([Linear(np.random.default_rng(1), 1, 4)]), env, [Input("below")])
    assert policy.trained["task_options"] == {"height": 1.5}
    found = propwash.evaluate(policy, episodes=6)
    assert "flown until the time was up" in found.success_means and found.rows[0].mean_distance is None


def test_what_makes_no_sense_is_refused():
    policy = pilot()
    for kwargs, error, words in (
        ({"wind": (-1.0,)}, ValueError, "wind: expected a list of numbers from 0"),
        ({"wind": 3}, ValueError, "wind: expected a list"),
        ({"delay": (0.5,)}, ValueError, "delay: expected whole numbers of steps"),
        ({"delay": 1}, ValueError, "delay: expected a list of numbers from 0"),
        ({"delay": ()}, ValueError, "delay: expected a list of numbers from 0"),
        ({"vehicles": "cf2x_L250"}, TypeError, "vehicles: expected a list"),
        ({"delay": (26,)}, ValueError, "action_delay_s"),
        ({"episodes": 0}, ValueError, "episodes: expected a whole number"),
        ({"vehicles": []}, ValueError, "vehicles: expected at least one"),
        ({"vehicles": ["cf2x_L251"]}, Exception, "cf2x_L251"),
        ({"settings": {"freq": 50}}, ValueError, "freq: expected 25, as in the training of the policy, found 50"),
        ({"settings": {"num_envs": 5}}, ValueError, "settings: expected arguments that evaluate"),
        ({"env_id": "Propwash/Landing-v1"}, Exception, "Landing"),
        ({"env_id": "Propwash/ForestDepth-v0", "within": 0.1, "episodes": 1}, ValueError, "difference_to_goal: expected|within: expected None"),
    ):
        with pytest.raises(error, match=words):
            propwash.evaluate(policy, **kwargs)
    with pytest.raises(ValueError, match="env_id: expected the name of an environment"):
        propwash.evaluate(lambda obs: obs)
    with pytest.raises(TypeError, match="policy: expected a Policy"):
        propwash.evaluate(3)


def test_flights_become_a_picture(tmp_path):
    pillow = pytest.importorskip("PIL.Image")
    propwash.evaluate(pilot(), episodes=10, picture=tmp_path / "flights.png")
    picture = np.asarray(pillow.open(tmp_path / "flights.png"))
    assert picture.shape == (4 * 244 - 4, 4 * 324 - 4, 3)
    env = reach(action="velocity", freq=25, max_episode_time=5.0, render_mode="rgb_array", render_size=(320, 240))
    env.reset(seed=1_000_000)
    assert (picture[:240, :320] == env.render()[0]).all(), "the first is the start of the first episode"
    assert len({picture[:240, x : x + 320].tobytes() for x in (0, 324, 648, 972)}) == 4
    with pytest.raises(FileExistsError):
        propwash.evaluate(pilot(), episodes=1, picture=tmp_path / "flights.png")


def program(*words, **options):
    line = [sys.executable, "-m", "propwash", "evaluate", *map(str, words)]
    return subprocess.run(line, capture_output=True, text=True, env=ENVIRONMENT, **options)


def test_the_command_evaluates(tmp_path):
    pilot().save(tmp_path / "pilot.npz")
    done = program(tmp_path / "pilot.npz", "--wind", "0,1", "--delay", "0,1", "--episodes", "8", "--json", "--picture", tmp_path / "x.png")
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)["rows"]
    assert len(rows) == 4 and rows[0]["success"] > 0.8
    assert rows == [vars(r) for r in propwash.evaluate(pilot(), wind=(0, 1), delay=(0, 1), episodes=8).rows]
    assert struct.unpack(">II", (tmp_path / "x.png").read_bytes()[16:24]) == (4 * 324 - 4, 4 * 244 - 4)
    done = program(tmp_path / "pilot.npz", "--episodes", "2")
    assert done.returncode == 0 and "cf2x_L250" in done.stdout and "success %" in done.stdout
    done = program(tmp_path / "pilot.npz", "--describe")
    assert done.returncode == 0 and "difference_to_goal (3) m, world" in done.stdout
    bad_wind = [tmp_path / "pilot.npz", "--wind", "a"]
    for words, said in (([tmp_path / "none.npz"], "there is none"), (bad_wind, "expected numbers, separated by commas")):
        done = program(*words)
        assert done.returncode == 2 and said in done.stderr and "Traceback" not in done.stderr


def test_the_command_flies_tasks_of_ones_own(tmp_path):
    (tmp_path / "my_task.py").write_text(
        "import numpy as np, propwash.envs\n"
        "class Hold(propwash.envs.Task):\n"
        "    channels = {'below': 1}\n"
        "    start_space = [[-1.0, -1.0, 0.5], [1.0, 1.0, 1.5]]\n"
        "    max_episode_time = 1.0\n"
        "    def observe(self, worlds): return {'below': 1.0 - worlds.observed_pos[:, 2]}\n"
        "    def reward(self, worlds): return np.ones(worlds.num_worlds)\n"
        "propwash.envs.register_task('hold_by_command', Hold)\n"
    )
    make = "import my_task, gymnasium, numpy as np; from propwash.policies import *; from propwash.policies._convert import Seen; "
    make += "a = Seen(gymnasium.make_vec('Propwash/HoldByCommand-v0')); i = np.zeros((4, 1), np.float32); "
    make += "seen = (Channel('below', (1,)),); branch = Branch((Input('below'),)); layer = Layer('linear', i, i[:, 0]); "
    make += "Policy(seen, (branch,), (layer,), a.action('clip'), a.trained('')).save('p.npz')"
    done = subprocess.run([sys.executable, "-c", make], capture_output=True, text=True, env=ENVIRONMENT, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    done = program("p.npz", "--import", "my_task", "--episodes", "3", cwd=tmp_path)
    assert done.returncode == 0 and "Propwash/HoldByCommand-v0, 3 episodes" in done.stdout, done.stderr
