"""Learning environments: Gymnasium's checkers, the same episodes from the same seed, modes, wrappers, wrong input."""

import copy
import importlib
import importlib.util
import multiprocessing
import os
import pickle
import sys
import threading
import types
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import propwash
import propwash.envs as envs
from propwash.envs.vector import config_file, depth_devices

SMALL = {"width": 8, "height": 8}
#: Every id with what makes it quick.
QUICK = {
    name: {"layouts": 2, "camera": SMALL} if name.split("/")[1].startswith(("Forest", "Gate", "Room", "Swarm")) else {}
    for name in envs.IDS
}


def make(name, num_envs=3, **kwargs):
    return gymnasium.make_vec(name, num_envs=num_envs, **{**QUICK[name], **kwargs})


def actions(env, step):
    rng = np.random.default_rng(step)
    return rng.uniform(-0.8, 0.8, env.action_space.shape).astype(np.float32)


@pytest.mark.parametrize("name", envs.IDS)
def test_gymnasiums_checker_passes(name, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*Box observation space.*")
        env = gymnasium.make(name, render_mode="rgb_array", **QUICK[name])
        # It makes one in every mode, also that with a window.
        check_env(env.unwrapped, skip_render_check=importlib.util.find_spec("pygame") is None)


@pytest.mark.parametrize("name", envs.IDS)
def test_vectors_are_what_their_spaces_say(name):
    env = make(name)
    assert isinstance(env.unwrapped, gymnasium.vector.VectorEnv)
    assert env.spec is not None and env.spec.id == name
    assert env.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    obs, info = env.reset(seed=3)
    assert env.observation_space.contains(obs) and info == {}
    for step in range(30):
        obs, reward, terminated, truncated, info = env.step(actions(env, step))
        assert env.observation_space.contains(obs), step
        assert reward.shape == (3,) and reward.dtype == np.float64 and np.isfinite(reward).all()
        assert terminated.shape == truncated.shape == (3,) and terminated.dtype == truncated.dtype == np.bool_
        if "_ending" in info:
            assert (info["_ending"] == (terminated | truncated)).all()
            assert all(envs.ENDINGS[e] for e in info["ending"][info["_ending"]])
    assert all(value.dtype == np.float32 for value in obs.values())


@pytest.mark.parametrize("name", envs.IDS)
def test_the_same_seed_gives_the_same_episodes_at_any_thread_count(name):
    def flown(threads, seed):
        env = make(name, num_envs=5, threads=threads, max_episode_time=0.4)
        obs, _ = env.reset(seed=seed)
        out = [*obs.values()]
        for step in range(20):
            obs, reward, terminated, truncated, _ = env.step(actions(env, step))
            out += [*obs.values(), reward, terminated, truncated]
        return out

    one, three, other = flown(1, 7), flown(3, 7), flown(1, 8)
    assert all((a == b).all() for a, b in zip(one, three, strict=True))
    assert any((a != b).any() for a, b in zip(one, other, strict=True))


def test_a_seed_seeds_everything_that_is_random():
    rules = [
        {"parameter": "body.mass_kg", "draw": {"scale": [0.8, 1.2]}},
        {"parameter": "env.wind_m_s.*", "draw": {"normal": 1.0}},
        {"parameter": "env.pos_sigma_m", "draw": {"uniform": [0.0, 0.05]}},
    ]
    a, b = (make("Propwash/ReachPos-v0", randomization=rules) for _ in range(2))
    for seed in (1, 2):
        (x, _), (y, _) = a.reset(seed=seed), b.reset(seed=seed)
        assert all((x[k] == y[k]).all() for k in x)
        assert a.unwrapped.levels(1) == b.unwrapped.levels(1)
        assert a.unwrapped.parameters(2) == b.unwrapped.parameters(2)
    assert a.unwrapped.levels(0) != a.unwrapped.levels(1)
    masses = {a.unwrapped.parameters(w)["body.mass_kg"] for w in range(3)}
    assert len(masses) == 3
    # The seed of the making is that of the first reset.
    (x, _), (y, _) = make("Propwash/ReachPos-v0", seed=1).reset(), make("Propwash/ReachPos-v0").reset(seed=1)
    assert all((x[k] == y[k]).all() for k in x)
    # Without a seed two batches differ.
    (x, _), (y, _) = (make("Propwash/ReachPos-v0").reset() for _ in range(2))
    assert (x["pos"] != y["pos"]).any()


def test_modes_of_autoreset_are_gymnasiums():
    def of(mode):
        env = make("Propwash/ReachPos-v0", num_envs=2, autoreset_mode=mode, max_episode_time=0.1)
        env.reset(seed=1)
        return env

    zero = np.zeros((2, 4), np.float32)
    following, same, disabled = (of(m) for m in AutoresetMode)
    assert {e.metadata["autoreset_mode"] for e in (following, same, disabled)} == set(AutoresetMode)
    for _ in range(5):
        last, _, _, truncated, info = following.step(zero)
    assert truncated.all() and "final_obs" not in info
    begun, reward, _, truncated, _ = following.step(zero)
    assert not truncated.any() and (reward == 0.0).all()
    for _ in range(5):
        obs, _, _, truncated, info = same.step(zero)
    assert truncated.all() and (info["_final_obs"]).all()
    for w in range(2):
        assert all((info["final_obs"][w][k] == last[k][w]).all() for k in last)
    assert all((obs[k] == begun[k]).all() for k in obs)
    for _ in range(5):
        disabled.step(zero)
    with pytest.raises(propwash.Error, match="world 0 has ended"):
        disabled.step(zero)
    obs, info = disabled.reset(options={"reset_mask": np.array([True, False])})
    assert (obs["pos"][0] == begun["pos"][0]).all() and (obs["pos"][1] == last["pos"][1]).all()


def test_observations_are_copies_unless_asked_otherwise():
    for copies in (True, False):
        env = make("Propwash/ForestDepth-v0", copy=copies)
        first, _ = env.reset(seed=1)
        kept = {k: v.copy() for k, v in first.items()}
        env.step(actions(env, 0))
        same = all((first[k] == kept[k]).all() for k in ("vel", "depth"))
        assert same == copies


def test_rewards_of_reaching_are_crazyflows():
    # The formulas of crazyflow 0.4.0, envs/: exp(-2 d), exp(-|dv|), exp(-2 d) exp(-2 v), at what is observed after the step.
    for name, reward_of in {
        "Propwash/ReachPos-v0": lambda o: np.exp(-2.0 * np.linalg.norm(o["difference_to_goal"], axis=-1)),
        "Propwash/ReachVel-v0": lambda o: np.exp(-np.linalg.norm(o["difference_to_target_vel"], axis=-1)),
        "Propwash/Landing-v0": lambda o: np.exp(
            -2.0 * np.linalg.norm(o["difference_to_goal"], axis=-1) - 2.0 * np.linalg.norm(o["vel"], axis=-1)
        ),
        "Propwash/Trajectory-v0": lambda o: np.exp(-2.0 * np.linalg.norm(o["local_samples"][:, :3], axis=-1)),
    }.items():
        env = make(name, num_envs=20)
        env.reset(seed=2)
        for step in range(5):
            obs, reward, terminated, _, _ = env.step(0.2 * actions(env, step))
            assert not terminated.any()
            np.testing.assert_allclose(reward, reward_of(obs), rtol=2e-5, err_msg=name)


def test_the_figure_of_eight_is_crazyflows():
    env = make("Propwash/Trajectory-v0", num_envs=1)
    obs, _ = env.reset(seed=0)
    points = obs["local_samples"].reshape(10, 3) + obs["pos"]
    phase = 2.0 * np.pi * 0.1 * np.arange(10) / 10.0
    expected = np.stack([np.sin(phase), 0.0 * phase, 0.5 * np.sin(2.0 * phase) + 1.0], axis=-1)
    np.testing.assert_allclose(points, expected, atol=1e-6)


def test_depth_is_what_the_simulator_renders():
    env = make("Propwash/ForestDepth-v0", num_envs=1, scene="xml/forest.xml", layouts=None, camera={"width": 16, "height": 12})
    obs, _ = env.reset(seed=5)
    sim = propwash.Sim(scene="xml/forest.xml", control="attitude")
    sim.data.pos[0, 0], sim.data.quat[0, 0] = obs["pos"][0], obs["quat"][0]
    camera = propwash.Camera("fpv", resolution=(16, 12), range=(0.02, 10.0))
    frame = sim.render_depth(camera)
    frame = getattr(frame, "depth", frame)[0, 0]
    expected = np.where(frame < 10.0, frame, 10.0)
    np.testing.assert_allclose(obs["depth"][0], expected, rtol=1e-6)
    assert (obs["depth"] < 10.0).any() and env.unwrapped.clearance[0] > 0.0


def test_every_named_device_sees():
    assert {"vl53l5cx", "d435", "kinect_v1", "ideal"} <= set(depth_devices())
    for device in depth_devices():
        env = gymnasium.make_vec("Propwash/ForestDepth-v0", num_envs=2, layouts=1, camera=device)
        obs, _ = env.reset(seed=1)
        again, _ = env.reset(seed=1)
        assert env.observation_space.contains(obs) and (obs["depth"] == again["depth"]).all(), device
        clean = gymnasium.make_vec("Propwash/ForestDepth-v0", num_envs=2, layouts=1, camera=device, levels={"depth_noise": 0.0})
        exact, _ = clean.reset(seed=1)
        assert ((obs["depth"] != exact["depth"]).any()) == (device != "ideal"), device


def test_layouts_differ_between_worlds_and_come_back():
    env = make("Propwash/ForestDepth-v0", num_envs=16, layouts=3, scene={"forest": {"trees": 10, "size_m": 8.0, "moving": 0}})
    env.reset(seed=1)
    first = env.unwrapped.layouts()
    assert set(first.tolist()) == {0, 1, 2}
    env.reset()
    assert (env.unwrapped.layouts() != first).any()


def test_swarms_have_an_axis_of_drones_and_rewards_apart():
    env = make("Propwash/SwarmCross-v0", num_envs=2, n_drones=4)
    obs, _ = env.reset(seed=1)
    assert obs["pos"].shape == (2, 4, 3) and obs["depth"].shape == (2, 4, 8, 8) and obs["neighbours"].shape == (2, 4, 24)
    assert env.action_space.shape == (2, 4, 4)
    _, reward, _, _, info = env.step(actions(env, 0))
    np.testing.assert_allclose(reward, info["reward"].mean(axis=1), rtol=1e-6)
    # The nearest neighbour first, along the own heading.
    off = obs["pos"][0, 1:] - obs["pos"][0, 0]
    nearest = np.linalg.norm(off, axis=-1).min()
    assert np.isclose(np.linalg.norm(obs["neighbours"][0, 0, :3]), nearest, rtol=1e-5)


def test_pettingzoos_checkers_pass():
    pytest.importorskip("pettingzoo")
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    from propwash.envs.parallel import SwarmEnv

    quick = {"n_drones": 3, "layouts": 1, "camera": SMALL}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="options: there are none")
        parallel_api_test(SwarmEnv(**quick), num_cycles=200)
        parallel_seed_test(lambda: SwarmEnv(**quick), num_cycles=30)
    env = SwarmEnv(**quick)
    env.reset(seed=1)
    with pytest.raises(ValueError, match="missing"):
        env.step({"drone_0": np.zeros(4)})
    with pytest.raises(ValueError, match="drone_1"):
        env.step({f"drone_{d}": np.zeros(4 - (d == 1)) for d in range(3)})


def test_wrappers_change_what_they_say():
    base = make("Propwash/ForestDepth-v0", camera={"width": 16, "height": 16}, autoreset_mode="SameStep", max_episode_time=0.2)
    plain, _ = base.reset(seed=1)
    near = envs.NormalizeDepth(base, inverse=True)
    obs, _ = near.reset(seed=1)
    assert near.observation_space.contains(obs) and obs["depth"].max() <= 1.0
    assert np.argmax(obs["depth"][0]) == np.argmin(plain["depth"][0])
    zones = envs.ToF8x8(base)
    obs, _ = zones.reset(seed=1)
    assert zones.observation_space.contains(obs)
    assert obs["depth"][0, 0, 0] == plain["depth"][0, :2, :2].min()
    flat = envs.FlattenState(zones)
    obs, _ = flat.reset(seed=1)
    assert set(obs) == {"depth", "state"} and obs["state"].shape == (3, 19)
    stack = envs.DepthFrameStack(flat, 3)
    obs, _ = stack.reset(seed=1)
    assert obs["depth"].shape == (3, 3, 8, 8) and (obs["depth"][:, 0] == obs["depth"][:, 2]).all()
    seen = [obs["depth"][:, -1]]
    for step in range(4):
        obs, _, terminated, truncated, info = stack.step(actions(base, step))
        if not (terminated | truncated).any():
            seen.append(obs["depth"][:, -1])
            assert (obs["depth"][:, 1] == seen[-2]).all()
    # The fourth step ends all episodes: what is observed begins anew, what was is kept.
    assert truncated.all() and (obs["depth"][:, 0] == obs["depth"][:, 2]).all()
    final = info["final_obs"][0]
    assert final["depth"].shape == (3, 8, 8) and (final["depth"][1] == seen[-1][0]).all()
    numbers = envs.FlattenState(make("Propwash/ReachPos-v0"))
    obs, _ = numbers.reset(seed=1)
    assert obs.shape == (3, 16) and numbers.observation_space.contains(obs)
    with pytest.raises(TypeError, match="depth"):
        envs.ToF8x8(make("Propwash/ReachPos-v0"))


def test_the_flat_state_says_its_order():
    base = make("Propwash/ForestDepth-v0", camera={"width": 16, "height": 16}, sensors=[{"kind": "lidar", "rings": 2, "columns": 4}])
    plain, _ = base.reset(seed=1)
    flat = envs.FlattenState(base)
    obs, _ = flat.reset(seed=1)
    assert list(flat.columns) == [name for name in base.single_observation_space.spaces if name != "depth"]
    assert list(flat.columns)[:2] == ["ang_vel", "goal"] and flat.columns["goal"] == slice(3, 6)
    for name, columns in flat.columns.items():
        assert (obs["state"][:, columns] == plain[name].reshape(3, -1)).all(), name
    assert flat.observation_space.contains(obs) and "lidar_range" in flat.columns
    swarm = envs.FlattenState(make("Propwash/SwarmCross-v0", n_drones=3, camera=False))
    plain, _ = swarm.env.reset(seed=1)
    obs, _ = swarm.reset(seed=1)
    assert obs.shape[:2] == (3, 3) and all((obs[..., c] == plain[name]).all() for name, c in swarm.columns.items())


def is_image(space):
    """What Stable-Baselines3 asks of an image (``is_image_space``, ``is_image_space_channels_first``)."""
    if importlib.util.find_spec("stable_baselines3") is not None:
        from stable_baselines3.common.preprocessing import is_image_space, is_image_space_channels_first

        return is_image_space(space) and is_image_space_channels_first(space)
    is_box = isinstance(space, gymnasium.spaces.Box) and len(space.shape) == 3 and space.dtype == np.uint8
    return is_box and (space.low == 0).all() and (space.high == 255).all() and np.argmin(space.shape) == 0 and space.shape[0] in (1, 3, 4)


def test_depth_becomes_images_for_networks():
    base = make("Propwash/ForestDepth-v0", camera={"width": 48, "height": 40}, autoreset_mode="SameStep", max_episode_time=0.1)
    plain, _ = base.reset(seed=1)
    far = float(base.single_observation_space["depth"].high.max())
    both = envs.DepthImage(base)
    assert is_image(both.single_observation_space["depth"]) and not is_image(base.single_observation_space["depth"])
    obs, _ = both.reset(seed=1)
    assert both.observation_space.contains(obs) and obs["depth"].shape == (3, 1, 40, 48) and both.far == far
    assert (obs["depth"][:, 0] == np.rint(255.0 * plain["depth"] / far)).all() and obs["depth"].max() == 255
    assert np.abs(obs["depth"][:, 0] * far / 255.0 - plain["depth"]).max() < 0.51 * far / 255.0
    assert (obs["pos"] == plain["pos"]).all()
    only = envs.DepthImage(envs.DepthFrameStack(base, 3), only=True)
    assert is_image(only.single_observation_space)
    image, _ = only.reset(seed=1)
    assert (image == np.repeat(obs["depth"], 3, axis=1)).all() and only.observation_space.contains(image)
    truncated = np.zeros(3, bool)
    while not truncated.any():
        image, _, _, truncated, info = only.step(actions(base, 1))
    assert truncated.all() and info["final_obs"][0].shape == (3, 40, 48) and info["final_obs"][0].dtype == np.uint8
    flat, _ = envs.FlattenState(both).reset(seed=1)
    assert flat["depth"].dtype == np.uint8 and flat["state"].shape == (3, 19)
    normal = envs.DepthImage(envs.NormalizeDepth(base))
    assert normal.far == 1.0 and (normal.reset(seed=1)[0]["depth"] == obs["depth"]).all()
    with pytest.raises(ValueError, match="3 drones"):
        envs.DepthImage(make("Propwash/SwarmCross-v0", n_drones=3))
    with pytest.raises(TypeError, match="float32"):
        envs.DepthImage(both)


def test_what_gymnasium_has_otherwise_is_refused_in_words():
    with pytest.raises(TypeError, match="max_episode_time, in seconds.*100 steps.*0.02 s"):
        make("Propwash/ReachPos-v0", max_episode_steps=100)


@pytest.mark.parametrize("name", ["Propwash/ReachPos-v0", "Propwash/ForestDepth-v0", "own"])
def test_worlds_with_seeds_of_their_own_fly_as_single_environments_do(name):
    kind = {"task": _Drawn} if name == "own" else {}
    options = {**kind, "levels": {"pos_sigma_m": 0.01}, "max_episode_time": 0.2, "autoreset_mode": "SameStep"}

    def of(n):
        return envs.DroneVectorEnv(n, **options) if name == "own" else make(name, num_envs=n, **options)

    def flown(env, seed, column):
        out = [env.reset(seed=seed)[0]]
        for i in range(15):
            out.append(env.step(np.full(env.action_space.shape, 0.1 * np.sin(i), np.float32))[0])
        return [{k: v[column] for k, v in obs.items()} for obs in out]

    batch = of(3)
    together = [flown(batch, [7, 123, 7], w) for w in range(3)]
    alone = [flown(of(1), seed, 0) for seed in (7, 123)]
    for a, b in ((together[0], alone[0]), (together[1], alone[1]), (together[2], alone[0])):
        assert all((x[k] == y[k]).all() for x, y in zip(a, b, strict=True) for k in x)
    assert any((x["pos"] != y["pos"]).any() for x, y in zip(together[0], together[1], strict=True))
    # One seed ends it.
    assert (flown(batch, 7, 1)[0]["pos"] != together[1][0]["pos"]).any()
    for seed, error, words in [
        ([1, 2], ValueError, "expected 3 seeds, one for each world, got 2"),
        ([1, None, 2], TypeError, r"seed\[1\]"),
        ("abc", TypeError, "got str"),
        ([1, 2, -1], ValueError, r"seed\[2\]"),
    ]:
        with pytest.raises(error, match=words):
            batch.reset(seed=seed)
    with pytest.raises(ValueError, match="reset_mask"):
        batch.reset(seed=[1, 2, 3], options={"reset_mask": np.array([True, False, True])})


class _Drawn(envs.Task):
    channels = {"drawn": 2}

    def on_reset(self, worlds):
        worlds.start_pos[worlds.begins] = worlds.uniform(3, (-1.0, -1.0, 1.0), (1.0, 1.0, 2.0))[worlds.begins]

    def reward(self, worlds):
        return np.zeros(worlds.num_worlds)

    def observe(self, worlds):
        return {"drawn": worlds.normal(2)}


def test_obstacles_move_by_themselves_and_are_seen():
    scene = {"forest": {"trees": 5, "moving": 4, "size_m": 8.0}}
    options = {"num_envs": 4, "scene": scene, "layouts": 2, "camera": {"width": 8, "height": 8}}
    env = gymnasium.make_vec("Propwash/ForestDepth-v0", **options, obstacle_motion={"speed_m_s": [1.0, 1.5]}, obstacle_jitter=0.1)
    env.reset(seed=4)
    native = env.unwrapped._native
    before = native.array("obstacle_pos").copy()
    assert before.shape == (4, 4, 3)
    for _ in range(10):
        env.step(np.zeros((4, 4), np.float32))
    after = native.array("obstacle_pos")
    moved, most_m = np.linalg.norm(after - before, axis=-1), 10 / env.unwrapped.config["step_hz"] * 1.5 + 1e-6
    assert (moved > 0.02).sum() > 8 and (moved <= most_m).all() and (after[..., 2] == before[..., 2]).all()
    sim = propwash.Sim(n_worlds=2, scene="forest", obstacle_motion={"kind": "circle", "names": ["mover_0"]})
    start = sim.obstacle_pos.copy()
    sim.step(100)
    moved = np.linalg.norm(sim.obstacle_pos - start, axis=-1)
    assert (moved[:, 0] > 0.01).all() and (moved[:, 1:] == 0.0).all()
    with pytest.raises(ValueError, match="obstacle_motion.names.*'mover_0'.*got 'mover_9'"):
        propwash.Sim(scene="forest", obstacle_motion={"names": ["mover_9"]})
    with pytest.raises(ValueError, match="moving obstacles needs a scene"):
        make("Propwash/ReachPos-v0", obstacle_motion={})


def test_gymnasiums_own_wrappers_work():
    from gymnasium.wrappers.vector import ClipAction, RecordEpisodeStatistics, RescaleAction

    env = RecordEpisodeStatistics(ClipAction(RescaleAction(make("Propwash/ReachPos-v0", max_episode_time=0.1), -2.0, 2.0)))
    env.reset(seed=1)
    for _ in range(5):
        *_, info = env.step(np.zeros((3, 4), np.float32))
    assert (info["episode"]["l"] == 5).all() and (info["episode"]["r"] > 0.0).all()


def of_drone(picture):
    """Pixels in the colours of the first drone, which are orange, around the place where the camera has it."""
    height, width, _ = picture.shape
    r, g, b = np.moveaxis(picture.astype(int), -1, 0)
    # Its body and its rotors, by the ratios of the colours: the light changes their sum only.
    orange = np.zeros(r.shape, bool)
    for green, blue in ((0.263, 0.053), (0.605, 0.492)):
        orange |= (r > 90) & (np.abs(g - green * r) < 4) & (np.abs(b - blue * r) < 4)
    y, x = np.nonzero(orange)
    near = (np.abs(x / width - 0.5) < 0.12) & (0.55 < y / height) & (y / height < 0.90)
    return np.stack([x[near], y[near]], axis=-1)


def of_goal(picture):
    r, g, b = np.moveaxis(picture.astype(int), -1, 0)
    return (g > 90) & (r < 0.2 * g) & (b < 0.6 * g)


def of_trail(picture):
    r, g, b = np.moveaxis(picture.astype(int), -1, 0)
    return (b > 180) & (r < 0.4 * b) & (g < 0.5 * b)


@pytest.mark.parametrize("name", envs.IDS)
def test_every_environment_is_rendered(name):
    env = make(name, num_envs=2, render_mode="rgb_array")
    with pytest.raises(RuntimeError, match="expected a reset first"):
        env.render()
    env.reset(seed=4)
    before = env.render()
    assert len(before) == 2 and all(p.shape == (480, 640, 3) and p.dtype == np.uint8 for p in before)
    assert (before[0] != before[1]).any() and (before[0] == env.render()[0]).all()
    assert of_trail(before[0]).sum() < 20
    action = np.zeros(env.action_space.shape, np.float32)
    if "velocity" in str(env.unwrapped.config["action"]):
        action[..., 0] = 0.2
    for _ in range(int(0.8 * env.metadata["render_fps"])):
        _, _, terminated, _, _ = env.step(action)
        assert not terminated.any()
    after = env.render()
    for picture in (*before, *after):
        x, y = of_drone(picture).T
        assert len(x) > 60, len(x)
        # 5 to 8 % of the width, more where something stands behind the drone; here without the outermost pixels.
        assert 0.03 < np.ptp(x) / 640 < 0.3
        assert abs(np.median(x) / 640 - 0.5) < 0.03
    assert (before[0] != after[0]).mean() > 0.1
    assert of_trail(after[0]).sum() > 40
    if "RoomExplore" in name:
        # Ground that was seen is greener.
        r, g, b = np.moveaxis(after[0].astype(int), -1, 0)
        assert ((g > 1.5 * r) & (g > 1.2 * b)).sum() > 1000
    else:
        assert max(of_goal(p).sum() for p in after) > 60
    # The trail begins anew, and the same flight gives the same pictures.
    env.reset(seed=4)
    assert (env.render()[0] == before[0]).all()
    for _ in range(int(0.8 * env.metadata["render_fps"])):
        env.step(action)
    assert all((a == b).all() for a, b in zip(env.render(), after))


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_trails_begin_with_episodes(mode):
    env = make("Propwash/ReachVel-v0", num_envs=2, render_mode="rgb_array", autoreset_mode=mode, max_episode_time=0.5)
    env.reset(seed=1)
    zero = np.zeros((2, 4), np.float32)
    for _ in range(25):
        *_, truncated, _ = env.step(zero)
    assert truncated.all()
    if mode == AutoresetMode.SAME_STEP:
        assert all(of_trail(p).sum() < 20 for p in env.render())
        return
    assert all(of_trail(p).sum() > 100 for p in env.render())
    if mode == AutoresetMode.NEXT_STEP:
        env.step(zero)
        assert all(of_trail(p).sum() < 20 for p in env.render())
    else:
        env.reset(options={"reset_mask": np.array([False, True])})
        first, second = env.render()
        assert of_trail(first).sum() > 100 and of_trail(second).sum() < 20


class _Marked(envs.Task):
    start_space = ((-0.1, -0.1, 1.0), (0.1, 0.1, 1.1))
    goal_space = ((1.0, -0.1, 1.0), (1.2, 0.1, 1.1))

    def reward(self, worlds):
        return np.zeros(worlds.num_worlds)


def test_pictures_have_the_colours_of_the_scene():
    """By rgba, by default class, by material and by texture; names say nothing."""
    parts = {"own": "rgba='0.1 0.1 0.8 1'", "class": "class='green'", "material": "material='red'", "texture": "material='checked'"}
    x = {name: 0.8 * (i - 1.5) for i, name in enumerate(parts)}
    text = (
        "<mujoco><default><default class='green'><geom rgba='0.1 0.7 0.1 1'/></default></default><asset>"
        "<material name='red' rgba='0.8 0.1 0.1 1'/><material name='checked' texture='pattern'/>"
        "<texture name='pattern' type='2d' builtin='checker' rgb1='0.8 0.8 0' rgb2='0.6 0.6 0' width='8' height='8'/>"
        "</asset><worldbody><geom name='leaf wall' type='plane' size='9 9 1'/>"
        + "".join(f"<geom type='box' size='.3 .3 .3' pos='2 {x[p]} 1' {of}/>" for p, of in parts.items())
        + "</worldbody></mujoco>"
    )
    env = envs.DroneVectorEnv(1, task=_Marked, scene=text, render_mode="rgb_array", render_size=(320, 240))
    env.reset(seed=1)
    (picture,) = env.render()
    r, g, b = np.moveaxis(picture.astype(int), -1, 0)
    seen = {
        "own": (b > 2 * r) & (b > 2 * g) & (b > 60) & (r < 60),
        "class": (g > 3 * r) & (g > 3 * b) & (g > 50),
        "material": (r > 4 * g) & (r > 4 * b) & (r > 50),
        "texture": (r > 3 * b) & (abs(r - g) < 8) & (r > 50),
    }
    assert all(mask.sum() > 40 for mask in seen.values()), {name: int(mask.sum()) for name, mask in seen.items()}
    sim = propwash.Sim(scene=text)
    colors = [g.rgba for g in sim.scenes[0].geoms if g.kind == "box" and g.drone is None]
    expected = [(0.1, 0.1, 0.8, 1), (0.1, 0.7, 0.1, 1), (0.8, 0.1, 0.1, 1), (0.7, 0.7, 0, 1)]
    np.testing.assert_allclose(colors, expected, atol=0.003)


def test_pictures_of_own_tasks_and_of_shipped_scenes_have_the_size_asked_for():
    env = envs.DroneVectorEnv(1, task=_Marked, render_mode="rgb_array", render_size=(320, 200))
    env.reset(seed=1)
    (picture,) = env.render()
    assert picture.shape == (200, 320, 3) and of_goal(picture).sum() > 20 and len(of_drone(picture)) > 15
    for scene in ("forest", ["room", "forest"], "<mujoco><worldbody><geom type='box' size='.1 .1 .1' pos='3 0 .1'/></worldbody></mujoco>"):
        env = envs.DroneVectorEnv(2, task=_Marked, scene=scene, render_mode="rgb_array", threads=1)
        env.reset(seed=1)
        assert all(len(of_drone(p)) > 60 for p in env.render())
    view = make("Propwash/GateRace-v0", num_envs=2)
    view.reset(seed=1)
    assert view.render() is None and view.unwrapped.view(0, "fpv")["depth"].shape == (240, 320)
    for size, error in [((0, 10), ValueError), ((64.5, 64), TypeError), (64, TypeError)]:
        with pytest.raises(error, match="render_size"):
            envs.DroneVectorEnv(1, render_mode="rgb_array", render_size=size)


def test_gymnasium_records_videos(tmp_path):
    pytest.importorskip("moviepy", reason="gymnasium writes videos by moviepy, which is not installed")
    env = gymnasium.make("Propwash/ReachPos-v0", render_mode="rgb_array", max_episode_time=0.2)
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path), episode_trigger=lambda k: True)
    env.reset(seed=1)
    for _ in range(10):
        env.step(np.zeros(4, np.float32))
    env.close()
    assert [p.stat().st_size > 1000 for p in tmp_path.glob("*.mp4")] == [True]


def test_a_description_in_toml_is_complete(tmp_path):
    path = tmp_path / "env.toml"
    path.write_text('step_hz = 25\n[task]\nkind = "landing"\n[levels]\nwind_m_s = [1.0, 0.0, 0.0]\n')
    config = config_file(path)
    assert config["task"]["goal_m"] == [0.0, 0.0, 0.1] and config["levels"]["wind_m_s"] == [1.0, 0.0, 0.0]
    path.write_text("step_hz = 25\nstep_hx = 1\n")
    with pytest.raises(ValueError, match="line 2.*step_hx"):
        config_file(path)
    made = make("Propwash/ReachPos-v0").unwrapped.config
    assert made["n_worlds"] == 3 and made["task"]["kind"] == "reach_pos"


@pytest.mark.parametrize(
    "kwargs, error, words",
    [
        ({"task": "fly"}, ValueError, "task: expected one of reach_pos.*got 'fly'"),
        ({"num_envs": 0}, ValueError, "num_envs.*1.*0"),
        ({"num_envs": 2.5}, TypeError, "num_envs"),
        ({"freq": 60}, ValueError, "step_hz: expected a divisor of sim_hz"),
        ({"action": "thrust"}, ValueError, "unknown variant `thrust`"),
        ({"action_options": {"tilt": 1}}, ValueError, "unknown field `tilt`"),
        ({"task_options": {"goal": 1}}, ValueError, "unknown field `goal`"),
        ({"drone": "cf3"}, ValueError, "cf3"),
        ({"drone": 3}, TypeError, "drone"),
        ({"dynamics": "newton"}, ValueError, "newton"),
        ({"scene": {"desert": {}}}, ValueError, "scene: expected one entry.*forest"),
        ({"scene": 3}, TypeError, "scene: expected a path"),
        ({"scene": "missing.xml"}, OSError, "missing.xml"),
        ({"camera": True}, ValueError, "camera"),
        ({"camera": "ideal"}, ValueError, "camera: expected none without a scene"),
        ({"scene": "forest", "camera": "lidar"}, ValueError, "camera device: expected one of ideal"),
        ({"autoreset_mode": "later"}, ValueError, "autoreset_mode.*NextStep.*later"),
        ({"render_mode": "tv"}, ValueError, 'render_mode: expected None, "human" or "rgb_array", got \'tv\''),
        ({"levels": {"action_delay_s": 5}}, ValueError, "env.action_delay_s: expected 0 to 1, got 5"),
        ({"randomization": [{"parameter": "env.wind", "draw": {"normal": 1}}]}, ValueError, "env.wind"),
        ({"randomization": [{"parameter": "body.mas", "draw": {"normal": 1}}]}, KeyError, "body.mas"),
        ({"n_drones": 2}, ValueError, "n_drones: expected 1"),
        ({"threads": 0}, ValueError, "threads"),
        ({"max_episode_time": float("nan")}, ValueError, "max_episode_s"),
    ],
)
def test_arguments_that_make_no_sense_are_refused(kwargs, error, words):
    with pytest.raises(error, match=words):
        envs.DroneVectorEnv(**{"num_envs": 1, **kwargs})


def test_actions_that_make_no_sense_are_refused_and_nothing_is_flown():
    env = make("Propwash/ReachPos-v0")
    with pytest.raises(ValueError, match="reset of all worlds first"):
        env.unwrapped.step(np.zeros((3, 4), np.float32))
    obs, _ = env.reset(seed=1)
    for action, error, words in [
        (np.zeros((3, 3)), ValueError, r"expected shape \(3, 4\).*\(3, 3\)"),
        (np.zeros(12), ValueError, r"expected shape \(3, 4\)"),
        (np.full((3, 4), np.nan), ValueError, "world 0, drone 0, entry 0.*NaN"),
        (np.full((3, 4), np.inf, np.float32), ValueError, "finite"),
        (np.zeros((3, 4), complex), TypeError, "complex"),
        (np.full((3, 4), "a"), TypeError, "action: expected an array of real numbers"),
        (np.zeros((3, 4), bool), TypeError, "bool"),
        (None, ValueError, r"expected shape \(3, 4\)"),
    ]:
        with pytest.raises(error, match=words):
            env.step(action)
    # Other number types and orders are taken.
    env.step(np.zeros((3, 4), np.int64))
    env.step(np.asfortranarray(np.zeros((3, 4))))
    env.step([[0.0] * 4] * 3)
    _, _, _, _, info = env.step(np.array([[0, 0, 0, 0], [2, 0, 0, 0], [0, 0, 0, 0]], np.float32))
    assert info["clipped"].tolist() == [False, True, False]


def test_seeds_and_masks_that_make_no_sense_are_refused():
    env = make("Propwash/ReachPos-v0")
    for seed, error in [([1, 2], ValueError), ("1", TypeError), (-1, ValueError), (1.5, TypeError)]:
        with pytest.raises(error, match="seed"):
            env.reset(seed=seed)
    with pytest.raises(ValueError, match="reset_mask"):
        env.reset(options={"mask": 1})
    env.reset(seed=1)
    with pytest.raises(ValueError, match=r"\(3,\)"):
        env.reset(options={"reset_mask": np.array([True])})
    with pytest.raises(TypeError, match="booleans"):
        env.reset(options={"reset_mask": np.array([1, 0, 0])})
    with pytest.raises(ValueError, match="seed"):
        env.reset(seed=1, options={"reset_mask": np.array([True, False, False])})


def test_single_environments_refuse_what_is_for_batches():
    with pytest.raises(TypeError, match="make_vec"):
        envs.DroneEnv(num_envs=2)
    env = gymnasium.make("Propwash/ReachPos-v0", max_episode_time=0.1)
    with pytest.raises(RuntimeError, match="reset first"):
        env.step(np.zeros(4))
    env.reset(seed=1)
    for _ in range(5):
        *_, truncated, info = env.step(np.zeros(4, np.float32))
    assert truncated and info["ending"] == "time_up" and info["is_success"] is False
    with pytest.raises(RuntimeError, match="has ended"):
        env.step(np.zeros(4, np.float32))


def test_closed_environments_and_copies_are_refused():
    env = make("Propwash/ReachPos-v0")
    env.reset(seed=1)
    for how in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(TypeError, match="cannot be pickled or copied"):
            how(env.unwrapped)
    env.close()
    env.close()
    for call in (lambda: env.reset(), lambda: env.step(np.zeros((3, 4))), lambda: env.unwrapped.layouts()):
        with pytest.raises(RuntimeError, match="closed"):
            call()


def _in_a_fork(env, queue):
    try:
        env.step(np.zeros((3, 4), np.float32))
        queue.put("nothing happened")
    except propwash.Error as e:
        queue.put(str(e))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_is_told():
    env = make("Propwash/ReachPos-v0").unwrapped
    env.reset(seed=1)
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        process = context.Process(target=_in_a_fork, args=(env, queue))
        process.start()
    assert "forked" in queue.get(timeout=60)
    process.join(timeout=60)


def test_two_threads_get_an_error_or_a_turn_and_never_a_crash():
    env = make("Propwash/ForestDepth-v0", num_envs=64)
    env.reset(seed=1)
    action = np.zeros((64, 4), np.float32)
    seen = []

    def fly():
        for _ in range(20):
            try:
                env.step(action)
                seen.append("ok")
            except propwash.Error as e:
                seen.append(str(e))

    workers = [threading.Thread(target=fly) for _ in range(4)]
    for w in workers:
        w.start()
    for w in workers:
        w.join()
    assert len(seen) == 80 and "ok" in seen
    assert all(s == "ok" or "at work in another thread" in s for s in seen)


def base_of_stable_baselines(monkeypatch):
    """Their base class, or where it is not installed (it needs torch) what of it matters here."""
    if importlib.util.find_spec("stable_baselines3") is not None:
        return

    class VecEnv:
        def __init__(self, num_envs, observation_space, action_space):
            self.num_envs, self.observation_space, self.action_space = num_envs, observation_space, action_space
            self.render_mode = self.get_attr("render_mode")[0]

        def _get_indices(self, indices):
            return range(self.num_envs) if indices is None else indices

        def get_images(self):
            raise NotImplementedError

    for name in ("stable_baselines3", "stable_baselines3.common", "stable_baselines3.common.vec_env"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    sys.modules["stable_baselines3.common.vec_env"].VecEnv = VecEnv
    monkeypatch.delitem(sys.modules, "propwash.envs.sb3", raising=False)


def test_stable_baselines_get_pictures_for_videos(monkeypatch):
    base_of_stable_baselines(monkeypatch)
    sb3 = importlib.import_module("propwash.envs.sb3")
    monkeypatch.delitem(sys.modules, "propwash.envs.sb3")
    made = make("Propwash/ForestDepth-v0", autoreset_mode="SameStep", render_mode="rgb_array", freq=25)
    env = sb3.SB3VecEnv(envs.FlattenState(made))
    assert env.render_mode == "rgb_array" and env.metadata["render_fps"] == 25
    env.reset()
    pictures = env.get_images()
    assert len(pictures) == 3 and all(p.shape == (480, 640, 3) and p.dtype == np.uint8 for p in pictures)
    assert all((a == b).all() for a, b in zip(pictures, made.render()))
    blind = sb3.SB3VecEnv(make("Propwash/ReachPos-v0", autoreset_mode="SameStep"))
    assert blind.get_images() == [None, None, None]


def test_stable_baselines_take_the_batch():
    pytest.importorskip("stable_baselines3")
    from propwash.envs.sb3 import SB3VecEnv

    with pytest.raises(ValueError, match="SameStep"):
        SB3VecEnv(make("Propwash/ReachPos-v0"))
    env = SB3VecEnv(envs.FlattenState(make("Propwash/ReachPos-v0", autoreset_mode="SameStep", max_episode_time=0.1)))
    env.seed(1)
    obs = env.reset()
    assert obs.shape == (3, 16)
    for _ in range(5):
        obs, reward, done, infos = env.step(np.zeros((3, 4), np.float32))
    assert done.all() and all(i["TimeLimit.truncated"] and i["terminal_observation"].shape == (16,) for i in infos)


@pytest.fixture
def window(monkeypatch):
    """Pygame with a screen in memory."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    return pytest.importorskip("pygame")


def test_a_window_shows_the_pictures_of_the_first_worlds(window):
    shown, drawn = (
        envs.DroneVectorEnv(n, task="reach_pos", render_mode=mode, render_size=(80, 60), freq=100)
        for n, mode in ((6, "human"), (6, "rgb_array"))
    )
    assert shown.metadata["render_modes"] == ["human", "rgb_array"] and window.display.get_surface() is None
    for env in (shown, drawn):
        env.reset(seed=3)
    for k in range(3):
        for env in (shown, drawn):
            env.step(np.full((6, 4), 0.2 * k, np.float32))
        screen = window.surfarray.array3d(window.display.get_surface()).swapaxes(0, 1)
        assert screen.shape == (120, 160, 3) and shown.render() is None
        for w, picture in enumerate(drawn.render()[:4]):
            row, column = divmod(w, 2)
            assert (screen[60 * row : 60 * row + 60, 80 * column : 80 * column + 80] == picture).all()
    assert window.display.get_caption()[0] == "Propwash: the first 4 of 6 worlds"
    # Its user closes it: the flight goes on without.
    window.event.post(window.event.Event(window.QUIT))
    shown.step(np.zeros((6, 4), np.float32))
    assert window.display.get_surface() is None
    shown.step(np.zeros((6, 4), np.float32))
    shown.close()


def test_a_single_environment_has_a_window(window):
    env = gymnasium.make("Propwash/ReachPos-v0", render_mode="human", render_size=(80, 60))
    env.reset(seed=1)
    env.step(env.action_space.sample())
    assert env.render() is None and window.display.get_surface().get_size() == (80, 60)
    env.close()
    assert window.display.get_surface() is None


def test_a_window_that_cannot_be_says_what_is_missing(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ImportError, match=r"pip install 'propwash\[window\]'"):
        envs.DroneVectorEnv(1, render_mode="human")
    monkeypatch.setitem(sys.modules, "pygame", object())
    with pytest.raises(propwash.Error, match='no display.*render_mode="rgb_array"'):
        envs.DroneVectorEnv(1, render_mode="human")
