"""Tasks written in Python: the numbers of a built-in one, everything that built-in ones have, and what is wrong named."""

import gc
import threading
import traceback
import weakref

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import propwash.envs as envs

LOW = [-1, -1, 1, -1, -1, -1, -1, -1, 0.5]
HIGH = [1, 1, 2, 1, 1, 1, 1, 1, 1.5]
BALL = (
    "<mujoco><worldbody><geom type='plane' size='0 0 1'/>"
    "<body name='ball' mocap='true' pos='0 9 1'><geom type='sphere' size='0.15'/></body></worldbody></mujoco>"
)
FLOOR = "<mujoco><worldbody><geom type='plane' size='0 0 1'/></worldbody></mujoco>"
BLOCK = "<mujoco><worldbody><geom type='box' size='9 9 0.3'/></worldbody></mujoco>"


class ReachPos(envs.Task):
    """The built-in ``reach_pos`` again."""

    channels = {"difference_to_goal": 3}
    has_goal = True

    def __init__(self, steepness=2.0):
        self.steepness = steepness

    def on_reset(self, worlds):
        draw = worlds.uniform(9, LOW, HIGH)
        begins = worlds.begins
        worlds.start_pos[begins] = draw[begins, :3]
        worlds.start_vel[begins] = draw[begins, 3:6]
        own = begins & ~worlds.goal_given
        worlds.goal_pos[own] = draw[own, 6:]

    def observe(self, worlds):
        return {"difference_to_goal": worlds.goal_pos - worlds.observed_pos}

    def reward(self, worlds):
        distance = np.linalg.norm(worlds.goal_pos - worlds.pos, axis=1)
        return np.where(worlds.crashed, -1.0, np.exp(-self.steepness * distance))


class Hover(envs.Task):
    """The least that a task says: where drones start, and what a step is worth."""

    start_space = [[-1, -1, 1], [1, 1, 1.5]]

    def reward(self, worlds):
        return -worlds.clearance


class Swarm(envs.Task):
    """Several drones, each with a goal."""

    channels = {"to_goal": 3, "clearance": 1}
    n_drones = 3
    action = "velocity"
    freq = 20
    max_episode_time = 3.0
    scene = FLOOR
    start_space = [[-2, -2, 0.5], [2, 2, 1.5]]
    goal_space = [[-2, -2, 0.5], [2, 2, 1.5]]
    goal_clearance = 0.2

    def observe(self, worlds):
        return {"to_goal": worlds.goal_pos - worlds.observed_pos, "clearance": worlds.clearance}

    def reward(self, worlds):
        return -np.linalg.norm(worlds.goal_pos - worlds.pos, axis=-1)


class Ball(envs.Task):
    """A ball comes along y at 2 m/s and is at the drone after one second."""

    scene = BALL
    freq = 20
    start_space = [[0, 0, 1], [0, 0, 1]]

    def before_step(self, worlds):
        worlds.obstacle_pos[:, 0, 1] = 2.0 - 2.0 * (worlds.step + 1) * worlds.step_time

    def reward(self, worlds):
        return np.zeros(worlds.num_worlds)


def actions(env, step, first=0, n=None):
    """Actions that differ by world and step but not by the batch; every third world falls."""
    shape = env.action_space.shape
    out = np.empty(shape, np.float32)
    for w in range(shape[0]):
        out[w] = np.random.default_rng((first + w, step)).uniform(-0.8, 0.8, shape[1:])
        if (first + w) % 3 == 0:
            out[w, ..., -1] -= 0.6
    return out


def flown(env, steps=60, seed=9, goal=None, first=0):
    obs, _ = env.reset(seed=seed, options=None if goal is None else {"goal": goal})
    out = [dict(obs)]
    for step in range(steps):
        obs, reward, terminated, truncated, info = env.step(actions(env, step, first))
        row = {**obs, "reward": reward, "terminated": terminated, "truncated": truncated}
        if "ending" in info:
            row["ending"] = info["ending"]
        for w, last in enumerate(info.get("final_obs", [])):
            if last is not None:
                row.update({f"final_{w}_{name}": value for name, value in last.items()})
        out.append(row)
    return out


def same(a, b, tolerance=0.0):
    assert len(a) == len(b)
    for step, (x, y) in enumerate(zip(a, b)):
        assert x.keys() == y.keys(), step
        for name in x:
            np.testing.assert_allclose(x[name], y[name], rtol=tolerance, atol=tolerance, err_msg=f"step {step}, {name}")


CASES = {
    "next_step": {"max_episode_time": 0.5},
    "same_step": {"max_episode_time": 0.5, "autoreset_mode": "SameStep"},
    "parallel": {"num_envs": 300, "max_episode_time": 0.3},
    "noise and delay": {
        "max_episode_time": 0.5,
        "levels": {"pos_sigma_m": 0.02, "attitude_sigma_rad": 0.01, "action_delay_s": 0.03, "wind_m_s": [0.5, 0, 0]},
        "randomization": [{"parameter": "env.vel_sigma_m_s", "draw": {"uniform": [0.0, 0.1]}},
                          {"parameter": "body.mass_kg", "draw": {"scale": [0.9, 1.1]}}],
    },
    "layouts": {"max_episode_time": 0.5, "scene": [FLOOR, BLOCK]},
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_reach_pos_written_again_gives_the_episodes_of_the_built_in_one(case):
    kwargs = {"num_envs": 6, **CASES[case]}
    ours = flown(envs.DroneVectorEnv(task=ReachPos, **kwargs))
    same(flown(envs.DroneVectorEnv(task="reach_pos", **kwargs)), ours, 2e-7)
    assert any("ending" in row for row in ours)
    same(ours, flown(envs.DroneVectorEnv(task=ReachPos(), threads=3, **kwargs)))


def test_goals_that_a_reset_gives_are_those_of_the_built_in_task_and_of_ours():
    goal = np.array([[0.3, -0.2, 1.1], [0.0, 0.5, 0.9], [0.1, 0.1, 1.0]])
    kwargs = {"num_envs": 3, "max_episode_time": 0.3}
    built_in, own = (envs.DroneVectorEnv(task=task, **kwargs) for task in ("reach_pos", ReachPos))
    a, b = flown(built_in, goal=goal), flown(own, goal=goal)
    same(a, b, 2e-7)
    np.testing.assert_allclose(a[0]["pos"] + a[0]["difference_to_goal"], goal, atol=1e-6)
    later = next(k for k, row in enumerate(a) if row.get("truncated", np.zeros(1)).any()) + 1
    assert (np.abs(a[later]["pos"] + a[later]["difference_to_goal"] - goal).max(axis=1) > 1e-3).any()
    # With a mask, in worlds that begin.
    for env in (built_in, own):
        mask = np.array([True, False, True])
        before = env.reset(seed=1)[0]
        obs, _ = env.reset(options={"reset_mask": mask, "goal": np.where(mask[:, None], goal, np.nan)})
        to = obs["pos"] + obs["difference_to_goal"]
        np.testing.assert_allclose(to[mask], goal[mask], atol=1e-6)
        np.testing.assert_allclose(to[1], before["pos"][1] + before["difference_to_goal"][1], atol=1e-6)
        with pytest.raises(ValueError, match=r"goal: expected shape \(3, 3\)"):
            env.reset(options={"goal": goal[:2]})
        with pytest.raises(ValueError, match="goal of world 1, drone 0"):
            env.reset(options={"goal": goal + [[0], [np.inf], [0]]})
        with pytest.raises(ValueError, match='"reset_mask", "goal"'):
            env.reset(options={"goals": goal})
    with pytest.raises(ValueError, match="the task Hover takes no goals"):
        envs.DroneVectorEnv(task=Hover).reset(options={"goal": np.zeros((1, 3))})
    forest = gymnasium.make("Propwash/ForestDepth-v0", layouts=1, camera=False)
    with pytest.raises(RuntimeError, match="which drones must not leave"):
        forest.reset(seed=1, options={"goal": [500.0, 0.0, 1.0]})


def test_built_in_tasks_take_goals():
    goal = np.array([[0.4, -0.3, 0.9], [-0.2, 0.1, 1.2]])
    for task, channel, of in (
        ("reach_pos", "difference_to_goal", "pos"),
        ("reach_vel", "difference_to_target_vel", "vel"),
        ("landing", "difference_to_goal", "pos"),
    ):
        obs, _ = envs.DroneVectorEnv(2, task=task).reset(seed=1, options={"goal": goal})
        np.testing.assert_allclose(obs[of] + obs[channel], goal, atol=1e-6, err_msg=task)
    # Along the heading, of which the length stays.
    obs, _ = envs.DroneVectorEnv(2, task="forest_depth", layouts=1, camera=False).reset(seed=1, options={"goal": goal})
    away = np.linalg.norm(goal - obs["pos"], axis=-1)
    np.testing.assert_allclose(np.linalg.norm(obs["goal"], axis=-1), away, rtol=1e-5)
    goal = np.stack([goal, goal + [0.0, 0.5, 0.0]], axis=1)
    swarm = envs.DroneVectorEnv(2, task="swarm_cross", n_drones=2, layouts=1, camera=False)
    obs, _ = swarm.reset(seed=1, options={"goal": goal})
    np.testing.assert_allclose(np.linalg.norm(obs["goal"], axis=-1), np.linalg.norm(goal - obs["pos"], axis=-1), rtol=1e-5)


def test_any_part_of_a_batch_has_the_numbers_of_the_whole():
    for task in (ReachPos, Swarm):
        whole = flown(envs.DroneVectorEnv(5, task=task, max_episode_time=0.4), steps=30)
        part = flown(envs.DroneVectorEnv(2, task=task, max_episode_time=0.4, first_world=3), steps=30, first=3)
        for a, b in zip(whole, part):
            for name in a.keys() - {"ending"}:
                assert (a[name][3:5] == b[name]).all(), name


def test_random_numbers_are_those_of_world_episode_step_and_method_alone():
    class Noisy(Hover):
        channels = {"noise": 2}

        def __init__(self):
            self.kept = []

        def on_reset(self, worlds):
            first, second = worlds.uniform(2), worlds.uniform(2)
            assert np.isnan(first[~worlds.begins]).all() and (first[worlds.begins] != second[worlds.begins]).all()
            self.kept.append(("reset", worlds.episode.copy(), first[worlds.begins].copy()))

        def observe(self, worlds):
            return {"noise": worlds.normal(2)}

        def reward(self, worlds):
            return worlds.uniform(1, 2.0, 3.0)[:, 0]

    def fly(n, first):
        env = envs.DroneVectorEnv(n, task=Noisy, first_world=first, max_episode_time=0.1)
        return flown(env, steps=12, first=first), env.task.kept

    rows, kept = fly(400, 0)
    noise = np.stack([row["noise"] for row in rows])
    assert abs(noise.mean()) < 0.05 and abs(noise.std() - 1.0) < 0.05
    assert len(np.unique(noise)) == noise.size, "no number comes twice"
    rewards = np.stack([row["reward"] for row in rows[1:]])
    assert ((rewards == 0.0) | ((rewards >= 2.0) & (rewards < 3.0))).all()
    part, _ = fly(3, 100)
    assert all((a["noise"][100:103] == b["noise"]).all() for a, b in zip(rows, part))
    assert [episode.max() for _, episode, _ in kept] == [0, 1, 2]
    worlds = envs.DroneVectorEnv(task=Hover)._calls.worlds
    with pytest.raises(RuntimeError, match="within on_reset, before_step, reward, terminated or observe"):
        worlds.uniform(3)


def test_a_moving_obstacle_hits_when_it_comes_and_begins_where_the_scene_has_it():
    env = envs.DroneVectorEnv(2, task=Ball, autoreset_mode="Disabled")
    for _ in range(2):
        env.reset(seed=1)
        assert (env.clearance > 0.5).all() and (env._calls.worlds.obstacle_pos[:, 0, 1] == 9.0).all()
        steps = 0
        done = np.zeros(2, bool)
        while not done.any():
            _, _, done, _, info = env.step(np.zeros((2, 4)))
            steps += 1
        assert 17 <= steps < 20 and done.all()
        assert [envs.ENDINGS[e] for e in info["ending"]] == ["crashed"] * 2


def test_layouts_starts_and_goals_are_free():
    class Forest(Swarm):
        n_drones = 2
        scene = {"forest": {"trees": 16, "size_m": 8.0}}
        layouts = 3
        start_space = goal_space = [[-3, -3, 0.5], [3, 3, 2]]
        start_clearance = 0.4
        camera = {"width": 8, "height": 6}

        def observe(self, worlds):
            self.layouts_seen = worlds.layout.copy()
            assert worlds.depth.shape == (12, 2, 6, 8) and not worlds.depth.flags.writeable
            self.depth = worlds.depth.copy()
            return super().observe(worlds)

    env = envs.DroneVectorEnv(12, task=Forest, seed=3)
    obs, _ = env.reset()
    assert (env.clearance >= 0.39).all() and len(set(env.layouts())) > 1
    assert (env.task.layouts_seen == env.layouts()).all()
    assert (obs["depth"] == env.task.depth).all() and obs["depth"].max() <= 20.0
    assert (obs["clearance"][..., 0] == env.clearance).all()
    goal = obs["pos"] + obs["to_goal"]
    assert (np.abs(goal) <= 3.01).all()
    # Late and noisy images are observed, true ones are judged.
    env = envs.DroneVectorEnv(12, task=Forest, seed=3, levels={"depth_delay_s": 0.1})
    env.reset()
    for _ in range(3):
        obs, *_ = env.step(np.full((12, 2, 4), 0.5))
    assert (obs["depth"] != env.task.depth).any()
    assert "depth" not in envs.DroneVectorEnv(1, task=Forest, camera=False).single_observation_space.spaces
    with pytest.raises(RuntimeError, match="no start with 50 m to everything"):
        close = Swarm()
        close.start_clearance = 50.0
        envs.DroneVectorEnv(1, task=close).reset(seed=1)


def test_noise_is_on_what_is_observed_and_not_on_what_is_judged():
    class Both(Hover):
        channels = {"true": 3, "seen": 3}

        def observe(self, worlds):
            return {"true": worlds.pos, "seen": worlds.observed_pos}

    obs, _ = envs.DroneVectorEnv(200, task=Both, levels={"pos_sigma_m": 0.1}).reset(seed=1)
    assert (obs["seen"] == obs["pos"]).all()
    assert 0.08 < (obs["seen"] - obs["true"]).std() < 0.12
    obs, _ = envs.DroneVectorEnv(2, task=Both).reset(seed=1)
    assert (obs["seen"] == obs["true"]).all()


def test_endings_are_by_truth_or_by_number():
    class Ends(Hover):
        def __init__(self, what):
            self.what = what

        def terminated(self, worlds):
            return self.what(worlds)

    def endings(what):
        env = envs.DroneVectorEnv(4, task=Ends(what))
        env.reset(seed=1)
        _, _, terminated, _, info = env.step(np.zeros((4, 4)))
        return terminated.tolist(), [envs.ENDINGS[e] for e in info.get("ending", [])]

    some = np.array([True, False, True, False])
    assert endings(lambda worlds: some) == ([True, False, True, False], ["done", "", "done", ""])
    assert endings(lambda worlds: some * 2) == ([True, False, True, False], ["left", "", "left", ""])
    assert endings(lambda worlds: [0, 1, 2, 3]) == ([False, True, True, True], ["", "crashed", "left", "done"])
    assert endings(lambda worlds: some & False) == ([False] * 4, [])
    with pytest.raises(ValueError, match=r"Ends.terminated: expected booleans, or numbers .* got 0 to 4"):
        endings(lambda worlds: np.arange(4) + (np.arange(4) == 3))
    with pytest.raises(ValueError, match=r"Ends.terminated: expected shape \(4,\) = \(num_worlds,\), got \(4, 1\)"):
        endings(lambda worlds: some[:, None])
    with pytest.raises(TypeError, match="Ends.terminated: .* got dtype float64"):
        endings(lambda worlds: some * 1.0)


def test_every_door_takes_a_task():
    name = envs.register_task("own_reach", ReachPos, max_episode_time=0.5)
    assert name == "Propwash/OwnReach-v0"
    try:
        env = gymnasium.make_vec(name, num_envs=4)
        assert env.spec.id == name and env.unwrapped.config["task"] == {"kind": "own", "name": "ReachPos"}
        obs, _ = env.reset(seed=3)
        assert env.observation_space.contains(obs) and obs["difference_to_goal"].shape == (4, 3)
        direct = envs.DroneVectorEnv(4, task="own_reach", max_episode_time=0.5)
        same(flown(env), flown(direct))
        steep = gymnasium.make_vec(name, num_envs=4, task_options={"steepness": 20.0})
        steep.reset(seed=3)
        assert (steep.step(np.zeros((4, 4)))[1] < env.step(np.zeros((4, 4)))[1]).all()
        single = gymnasium.make(name)
        check_env(single.unwrapped, skip_render_check=True)
        obs, _ = single.reset(seed=1, options={"goal": [0.0, 0.0, 1.0]})
        np.testing.assert_allclose(obs["pos"] + obs["difference_to_goal"], [0.0, 0.0, 1.0], atol=1e-6)
    finally:
        envs.IDS.pop(name)
        gymnasium.registry.pop(name)


def test_swarms_take_a_task():
    parallel = pytest.importorskip("propwash.envs.parallel")
    env = parallel.SwarmEnv(task=Swarm)
    goal = {agent: [0.1 * d, 0.0, 1.0] for d, agent in enumerate(env.possible_agents)}
    obs, _ = env.reset(seed=1, options={"goal": goal})
    for agent in env.agents:
        assert env.observation_space(agent).contains(obs[agent])
        np.testing.assert_allclose(obs[agent]["pos"] + obs[agent]["to_goal"], goal[agent], atol=1e-6)
    _, rewards, *_ = env.step({agent: np.zeros(4) for agent in env.agents})
    assert len(set(rewards.values())) == 3
    with pytest.raises(ValueError, match="2 or more agents"):
        parallel.SwarmEnv(task=ReachPos)


def test_tasks_that_make_no_sense_are_refused_by_name():
    def refused(error, match, task, **kwargs):
        with pytest.raises(error, match=match):
            envs.DroneVectorEnv(2, task=task, **kwargs)

    refused(ValueError, "task: expected one of reach_pos, .*, a propwash.learn.Goal or a propwash.envs.Task, got 'none_such'", "none_such")
    refused(TypeError, "task: expected a name, a propwash.learn.Goal or a propwash.envs.Task, got float", 3.5)
    refused(TypeError, "expected dict to make a propwash.learn.Goal or a propwash.envs.Task, got dict", dict)
    refused(ValueError, "task_options: expected none", ReachPos(), task_options={"steepness": 1})
    refused(TypeError, "unexpected keyword argument 'steep'", ReachPos, task_options={"steep": 1})
    for channels in ({"x": 0}, {"x": 1.5}, ["x"], {3: 1}):
        refused(ValueError, "Odd.channels: expected a dict of names and widths", type("Odd", (Hover,), {"channels": channels}))
    refused(ValueError, "channels of the task: expected names", type("Odd", (Hover,), {"channels": {"pos": 3}}))
    refused(ValueError, r"Odd.start_space: expected two corners", type("Odd", (Hover,), {"start_space": [1, 2]}))
    refused(ValueError, "start_space", type("Odd", (Hover,), {"start_space": [[1, 1, 1], [0, 0, 0]]}))
    refused(ValueError, "start_clearance", type("Odd", (Hover,), {"start_clearance": -1.0}))
    refused(ValueError, "freq", type("Odd", (Hover,), {"freq": 0}))
    with pytest.raises(ValueError, match="name: expected small letters"):
        envs.register_task("MyTask", Hover)
    with pytest.raises(ValueError, match="another than those of the built-in"):
        envs.register_task("reach_pos", Hover)
    with pytest.raises(TypeError, match="derived from propwash.learn.Goal or propwash.envs.Task"):
        envs.register_task("mine", dict)


def test_what_a_task_returns_wrong_is_named_with_its_method():
    class Wrong(Hover):
        channels = {"a": 2, "b": 1}

        def __init__(self, **given):
            self.given = given

        def on_reset(self, worlds):
            if "start" in self.given:
                worlds.start_pos[worlds.begins] = self.given["start"]

        def observe(self, worlds):
            n = worlds.num_worlds
            return self.given.get("observe", {"a": np.zeros((n, 2)), "b": np.zeros(n)})

        def reward(self, worlds):
            return self.given.get("reward", np.zeros(worlds.num_worlds))

    def refused(error, match, **given):
        env = envs.DroneVectorEnv(3, task=Wrong(**given))
        with pytest.raises(error, match=match):
            env.reset(seed=1)
            env.step(np.zeros((3, 4)))
        with pytest.raises(ValueError, match="a reset of all worlds first"):
            env.step(np.zeros((3, 4)))
        env.task.given = {}
        env.reset(seed=1)
        env.step(np.zeros((3, 4)))

    refused(ValueError, r"Wrong.reward: expected shape \(3,\) = \(num_worlds\), got \(3, 1\)", reward=np.zeros((3, 1)))
    refused(ValueError, r"Wrong.reward: expected shape \(3,\) = \(num_worlds\), got \(\)", reward=0.0)
    refused(TypeError, "Wrong.reward: expected an array of real numbers, got dtype complex128", reward=np.zeros(3) * 1j)
    refused(TypeError, "Wrong.reward: .* got dtype <U1", reward=["a", "b", "c"])
    refused(TypeError, "Wrong.reward: expected an array of numbers, got NoneType", reward=None)
    refused(TypeError, "Wrong.reward: expected an array, got list", reward=[[1], [1, 2], [3]])
    refused(ValueError, "reward of world 1, drone 0: expected a finite number from the task, got NaN", reward=[0, np.nan, 0])
    refused(ValueError, "reward of world 0, drone 0: .* got inf", reward=[1e300, 0, 0])
    refused(ValueError, r"Wrong.observe: expected a dict of the channels \['a', 'b'\], got \['a'\]", observe={"a": 0})
    refused(ValueError, "Wrong.observe: expected a dict .* got NoneType", observe=None)
    a, b = np.zeros((3, 2)), np.zeros((3, 1))
    refused(ValueError, r'channel "a": expected shape \(3, 2\) = \(num_worlds, width\), got \(3, 3\)', observe={"a": np.zeros((3, 3)), "b": b})
    nan = np.where(np.arange(3)[:, None] == 2, np.nan, a)
    refused(ValueError, r"channel a \(observe\) of world 2, drone 0: .* got NaN", observe={"a": nan, "b": b})
    refused(ValueError, "start_pos of world 0, drone 0, after on_reset: .* got .*NaN", start=np.nan)

    class Nothing(envs.Task):
        def reward(self, worlds):
            return np.zeros(worlds.num_worlds)

    with pytest.raises(ValueError, match="give the task a start_space"):
        envs.DroneVectorEnv(task=Nothing).reset(seed=1)
    silent = type("Silent", (Hover,), {"reward": envs.Task.reward})
    env = envs.DroneVectorEnv(task=silent)
    env.reset(seed=1)
    with pytest.raises(NotImplementedError, match="Silent.reward: a task says what a step is worth"):
        env.step(np.zeros((1, 4)))


def test_exceptions_of_a_task_come_out_as_they_are_with_their_traceback():
    class Mine(Exception):
        pass

    class Raises(Hover):
        fails = False

        def deep(self):
            raise Mine("as it is")

        def reward(self, worlds):
            if self.fails:
                self.deep()
            return np.zeros(worlds.num_worlds)

    for n in (1, 300):  # by the caller's thread, and by one of the pool
        env = envs.DroneVectorEnv(n, task=Raises, threads=2)
        env.reset(seed=1)
        env.task.fails = True
        with pytest.raises(Mine, match="^as it is$") as caught:
            env.step(np.zeros((n, 4)))
        names = [frame.name for frame in traceback.extract_tb(caught.value.__traceback__)]
        assert names[-2:] == ["reward", "deep"]
        env.task.fails = False
        env.reset(seed=1)
        env.step(np.zeros((n, 4)))


def test_a_task_that_calls_its_own_environment_is_told_so_and_nothing_waits():
    class Calls(Hover):
        def reward(self, worlds):
            self.env.step(np.zeros((worlds.num_worlds, 4)))

    for n in (1, 300):
        env = envs.DroneVectorEnv(n, task=Calls)
        env.task.env = env
        env.reset(seed=1)
        with pytest.raises(RuntimeError, match="at work in another thread"):
            env.step(np.zeros((n, 4)))
        # Another environment may fly meanwhile.
        env.task.env = envs.DroneVectorEnv(n, task=Hover)
        env.task.env.reset(seed=1)
        env.reset(seed=1)
        with pytest.raises(TypeError, match="Calls.reward"):
            env.step(np.zeros((n, 4)))


def test_python_runs_elsewhere_while_worlds_fly():
    class Seen(Hover):
        scene = FLOOR
        camera = {"width": 320, "height": 240}

    env = envs.DroneVectorEnv(16, task=Seen, threads=1)
    env.reset(seed=1)
    count, stop = [0], threading.Event()

    def work():
        while not stop.is_set():
            count[0] += 1

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        before = count[0]
        env.step(np.zeros((16, 4)))
        # The interpreter changes threads every 5 ms; one that waited for the whole step would have counted nothing.
        assert count[0] - before > 1000
    finally:
        stop.set()
        thread.join()


def test_environments_of_several_threads_do_not_wait_for_each_other():
    def fly(out, k):
        env = envs.DroneVectorEnv(300, task=ReachPos, threads=2)
        out[k] = flown(env, steps=20)

    out = [None] * 4
    threads = [threading.Thread(target=fly, args=(out, k), daemon=True) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
        assert not thread.is_alive(), "a deadlock"
    for other in out[1:]:
        same(out[0], other)


def test_an_environment_with_a_task_is_freed():
    class Keeps(Hover):
        def on_reset(self, worlds):
            self.worlds = worlds

    env = envs.DroneVectorEnv(4, task=Keeps)
    env.reset(seed=1)
    calls = weakref.ref(env._calls)
    kept = env._calls.worlds.pos
    del env
    gc.collect()
    assert calls() is None
    assert np.isfinite(kept).all(), "a view keeps its numbers alive"


def test_views_are_made_once_and_written_only_where_a_task_may():
    class Looks(Hover):
        def __init__(self):
            self.seen = []

        def reward(self, worlds):
            self.seen.append({name: value for name, value in vars(worlds).items() if isinstance(value, np.ndarray)})
            return np.zeros(worlds.num_worlds)

    env = envs.DroneVectorEnv(3, task=Looks)
    env.reset(seed=1)
    for _ in range(2):
        env.step(np.full((3, 4), 0.1))
    first, second = env.task.seen
    assert first.keys() == second.keys() and all(first[name] is second[name] for name in first)
    writeable = {name for name, value in first.items() if value.flags.writeable}
    assert writeable == {"start_pos", "start_vel", "start_yaw"}
    with pytest.raises(ValueError, match="read-only"):
        first["pos"][:] = 0.0
    assert (first["step"] == 2).all() and np.allclose(first["time"], 0.04) and (first["action"] == np.float32(0.1)).all()
    assert np.allclose(first["previous_pos"] + 0.02 * first["vel"], first["pos"], atol=1e-3)


def test_the_caller_says_how_many_layouts_a_task_has():
    class Woods(Hover):
        scene = "forest"
        layouts = None

    assert envs.DroneVectorEnv(2, task=Woods()).config["scene"] == {"files": ["forest"]}
    env = envs.DroneVectorEnv(2, task=Woods(), layouts=3)
    assert env.config["layouts"] == 3 and "forest" in env.config["scene"]
