"""Environments of ``propwash.learn.Goal``: classes whose functions run once."""

import gymnasium
import numpy as np
import pytest

import propwash as pw
from propwash import envs, learn
from propwash.envs import FlattenState


class Reach(learn.Goal):
    """What the built-in reach_pos asks: the same episodes, observations, rewards and endings."""

    pos, vel, time = [(-1, 1), (-1, 1), (1, 2)], [(-1, 1)] * 3, 10.0
    memory = {"goal": [(-1, 1), (-1, 1), (0.5, 1.5)]}

    def __init__(self, steepness=2.0):
        self.steepness = steepness

    def observe(self, s):
        return {"difference_to_goal": s.goal - s.pos}

    def reward(self, s):
        way = s.pos - s.goal
        return np.where(s.crashed, -1.0, np.exp(-self.steepness * np.sqrt(way @ way)))


RULES = [
    {"parameter": "body.mass_kg", "draw": {"scale": [0.9, 1.1]}},
    {"parameter": "env.action_delay_s", "draw": {"uniform": [0.0, 0.04]}},
    {"parameter": "env.pos_sigma_m", "draw": {"uniform": [0.0, 0.05]}},
]


def flown(env, steps=120, seed=3):
    """All that a learner sees, and how many episodes ended."""
    obs, _ = env.reset(seed=seed)
    draws, out, ended = np.random.default_rng(0), [obs], 0
    for _ in range(steps):
        action = draws.uniform(-1.0, 1.0, (env.num_envs, 4))
        action[:, 3] -= 0.4
        obs, reward, terminated, truncated, info = env.step(action)
        out.append({**obs, "reward": reward, "terminated": terminated, "truncated": truncated, "ending": info.get("ending", np.zeros(env.num_envs, np.uint8))})
        for world in np.flatnonzero(info.get("_final_obs", [])):
            out.append({name: value for name, value in info["final_obs"][world].items()})
        ended += int((terminated | truncated).sum())
    return out, ended


def same(a, b):
    assert len(a) == len(b)
    for step, (x, y) in enumerate(zip(a, b)):
        assert x.keys() == y.keys()
        for name in x:
            np.testing.assert_array_equal(x[name], y[name], err_msg=f"{name} of entry {step}")


@pytest.mark.parametrize(
    "options",
    [
        {"autoreset_mode": "NextStep"},
        {"autoreset_mode": "SameStep", "max_episode_time": 0.5},
        {"autoreset_mode": "SameStep", "randomization": RULES, "max_episode_time": 1.0},
        {"scene": "<mujoco><worldbody><geom type='box' pos='0 0 1' size='9 0.1 0.3'/></worldbody></mujoco>"},
        {"action": "velocity", "freq": 25, "threads": 1},
    ],
)
def test_a_goal_gives_the_bits_of_the_built_in_task(options):
    n = 20 if "scene" in options else 301
    own, built_in = (envs.DroneVectorEnv(n, task=task, **options) for task in (Reach, "reach_pos"))
    (a, ended), (b, _) = flown(own), flown(built_in)
    same(a, b)
    assert ended > 3
    # The same seed gives the same episodes again, at any number of threads, and another seed others.
    again, _ = flown(envs.DroneVectorEnv(n, task=Reach(), **{**options, "threads": 2}))
    same(a, again)
    other, _ = flown(own, 1, seed=4)
    assert (other[0]["pos"] != a[0]["pos"]).any()


def test_goals_are_given_at_resets_and_every_door_takes_a_goal():
    name = envs.register_task("traced_reach", Reach, max_episode_time=0.5)
    try:
        env = gymnasium.make_vec(name, num_envs=4, autoreset_mode="SameStep")
        assert env.unwrapped.config["task"] == {"kind": "own", "name": "Reach"} and isinstance(env.unwrapped.task, Reach)
        goal = np.tile([0.2, -0.3, 1.1], (4, 1))
        obs, _ = env.reset(seed=1, options={"goal": goal})
        np.testing.assert_allclose(obs["pos"] + obs["difference_to_goal"], goal, atol=1e-6)
        assert env.observation_space.contains(obs)
        for _ in range(25):
            _, _, _, truncated, info = env.step(np.zeros((4, 4)))
        assert truncated.all() and set(info["final_obs"][0]) == set(obs)
        steep = gymnasium.make_vec(name, num_envs=4, task_options={"steepness": 20.0})
        steep.reset(seed=3)
        env.reset(seed=3)
        assert (steep.step(np.zeros((4, 4)))[1] < env.step(np.zeros((4, 4)))[1]).all()
        single = gymnasium.make(name)
        obs, _ = single.reset(seed=1, options={"goal": [0.0, 0.0, 1.0]})
        np.testing.assert_allclose(obs["pos"] + obs["difference_to_goal"], [0.0, 0.0, 1.0], atol=1e-6)
        assert FlattenState(gymnasium.make_vec(name, num_envs=2)).single_observation_space.shape == (16,)
    finally:
        envs.IDS.pop(name)
        gymnasium.registry.pop(name)
    # A goal that is observed is shown.
    env = envs.DroneVectorEnv(1, task=Reach, render_mode="rgb_array", render_size=(160, 120))
    env.reset(seed=1)
    env.step(np.zeros((1, 4)))
    shown = env.render()[0]
    green = (shown[..., 1] > 120) & (shown[..., 0] < 90) & (shown[..., 2] < 110)
    assert shown.shape == (120, 160, 3) and green.any()


class Everything(learn.Goal):
    """All that functions see in an environment, remembered and shown."""

    pos, vel, ang_vel, turn, begin, time = [0, 0, 1], [(-1, 1), 0, 0], [0, (1, 2), 0], [(0.1, 0.3), 0, 0], (2, 3), 5.0
    memory = {"count": 0.0, "best": [(0, 1), 5.0], "last": [0.0] * 4}
    lost_cost = 7.0

    def observe(self, s):
        return [s.count, s.best, s.last, s.t, s.crashed, s.clearance, s.previous_pos, s.step_time]

    def cost(self, s):
        return s.count + s.action_change + 0.5 * (s.action - s.before) @ (s.action - s.before) + s.pos[2]

    def remember(self, s):
        return {"count": s.count + 1, "best": [s.best[0], np.minimum(s.best[1], s.pos[2])], "last": s.action}

    def lost(self, s):
        return s.pos[2] > 1.2

    def off(self, s):
        return abs(s.pos[0])

    def done(self, s):
        return s.count >= 30

    far = 0.6


def test_functions_see_what_they_say_and_change_what_is_remembered():
    env = envs.DroneVectorEnv(64, task=Everything, freq=50, autoreset_mode="SameStep", seed=1)
    obs, _ = env.reset(seed=1)
    first = obs["observation"].astype(float)
    assert first.shape == (64, 14)  # 1 + 2 + 4 + 1 + 1 + 1 + 3 + 1
    assert (first[:, 0] == 0).all() and (first[:, 2] == 5).all() and ((2 <= first[:, 7]) & (first[:, 7] < 3)).all()
    assert ((0 <= first[:, 1]) & (first[:, 1] < 1)).all() and len(set(first[:, 1])) == 64
    assert ((1 <= obs["ang_vel"][:, 1]) & (obs["ang_vel"][:, 1] < 2)).all()
    assert ((np.sin(0.05) <= obs["quat"][:, 0] + 1e-7) & (obs["quat"][:, 0] <= np.sin(0.15) + 1e-7)).all()
    np.testing.assert_array_equal(first[:, 10:13], obs["pos"])
    draws, endings = np.random.default_rng(1), set()
    before, last, count = np.zeros((64, 4)), obs, np.zeros(64)
    best, begun = np.full(64, 5.0), first[:, 7]
    for k in range(40):
        action = draws.uniform(-1.2, 1.2, (64, 4)).astype(np.float32)
        action[:, 3] = 0.6 if k % 8 < 4 else -0.6
        obs, reward, terminated, truncated, info = env.step(action)
        ended = terminated | truncated
        final = {name: np.stack([info["final_obs"][w][name] if ended[w] else obs[name][w] for w in range(64)]) for name in obs}
        held = np.clip(action, -1, 1).astype(float)
        x, z = final["pos"][:, 0].astype(float), final["pos"][:, 2].astype(float)
        change = np.where(count == 0, 0.0, np.minimum(np.abs(action - last_action) / 2 if k else 0.0, 1.0).mean(1) if k else 0.0)
        cost = count + change + 0.5 * ((held - before) ** 2).sum(1) + z
        lost = (z > 1.2) | (np.abs(x) > 0.6)
        np.testing.assert_allclose(reward, -cost - 7.0 * lost, atol=2e-6)
        done = ~lost & (count >= 30)
        np.testing.assert_array_equal(terminated, lost | done)
        if ended.any():
            np.testing.assert_array_equal(info["ending"][ended], np.where(lost, 2, np.where(done, 3, 0))[ended])
            endings |= set(info["ending"][ended].tolist())
        best = np.minimum(best, z)
        seen = final["observation"].astype(float)
        np.testing.assert_array_equal(seen[:, 0], count + 1)
        np.testing.assert_allclose(seen[:, 2], best, atol=1e-6)
        np.testing.assert_allclose(seen[:, 3:7], held, atol=1e-6)
        np.testing.assert_allclose(seen[:, 7], begun + 0.02 * (count + 1), atol=1e-5)
        np.testing.assert_array_equal(seen[:, 10:13], last["pos"])
        np.testing.assert_allclose(seen[:, 13], 0.02, atol=1e-9)
        # Episodes that begin remember nothing of those before.
        fresh = obs["observation"].astype(float)
        assert (fresh[ended, 0] == 0).all() and (fresh[ended, 3:7] == 0).all() and (fresh[ended, 2] == 5).all()
        count, best = np.where(ended, 0, count + 1), np.where(ended, 5.0, best)
        before, begun = np.where(ended[:, None], 0.0, held), np.where(ended, fresh[:, 7], begun)
        last, last_action = obs, np.where(ended[:, None], 0.0, action)
    assert endings == {2, 3}


def test_actions_in_units_are_numbers_of_the_limits():
    class Told(learn.Goal):
        pos = [0, 0, 1]
        memory = {"told": [0.0] * 4}

        def observe(self, s):
            return s.told

        def reward(self, s):
            return s.action[3] - s.before[3]

        def remember(self, s):
            return {"told": s.action}

    env = envs.DroneVectorEnv(3, task=Told, drone="cf21B_500", normalize_actions=False)
    env.reset(seed=1)
    low, high = env.single_action_space.low, env.single_action_space.high
    middle = np.array([0, 0, 0, pw.Sim(drone="cf21B_500").hover_thrust()[0, 0]])
    obs, reward, *_ = env.step(np.stack([low, middle, high + [0, 0, 1, 1]]))
    np.testing.assert_allclose(obs["observation"], [[-1] * 4, [0] * 4, [1] * 4], atol=1e-6)
    np.testing.assert_allclose(reward, [-1, 0, 1], atol=1e-6)
    _, reward, *_ = env.step(np.tile(middle, (3, 1)))
    np.testing.assert_allclose(reward, [1, 0, -1], atol=1e-6)
    # Rotor speeds: as many numbers as rotors.
    env = envs.DroneVectorEnv(1, task=Told, drone="cf21B_500", action="rotor_vel")
    env.reset(seed=1)
    np.testing.assert_allclose(env.step(np.array([[0.1, 0.2, -0.3, 0.4]]))[0]["observation"], [[0.1, 0.2, -0.3, 0.4]], atol=1e-6)


class Hold(learn.Goal):
    """One class for both: bptt and ppo train it, an environment flies it."""

    pos, vel, time = [(-1, 1), (-1, 1), (0.8, 1.8)], [(-0.5, 0.5)] * 3, 4.0
    memory = {"goal": [(-1, 1), (-1, 1), (1, 2)]}

    def way(self, s):
        return s.goal - s.pos

    def observe(self, s):
        return {"way": self.way(s), "motion": [0.5 * s.vel, s.quat, 0.3 * s.ang_vel]}

    def cost(self, s):
        way, change = self.way(s), s.action - s.before
        return np.sqrt(way @ way + 0.01) + 0.05 * s.vel @ s.vel + 0.02 * change @ change

    def off(self, s):
        return np.sqrt(self.way(s) @ self.way(s))


def test_one_class_is_trained_by_gradients_and_flown_in_an_environment():
    trained = learn.bptt(Hold(), "cf21B_500", commands=300_000)
    flown = trained.fly(flights=50, settle=3.0)
    assert flown.reached == 50 and flown.lost == 0, flown
    assert [c.name for c in trained.policy.observation] == ["motion", "way"]
    options = {"max_tilt_rad": 0.6, "max_yaw_rad": 0.2}
    env = envs.DroneVectorEnv(64, task=Hold, drone="cf21B_500", normalize_actions=False, action_options=options, autoreset_mode="Disabled")
    obs, _ = env.reset(seed=5)
    for _ in range(199):
        obs, reward, terminated, truncated, _ = env.step(trained.policy(obs))
    assert not terminated.any() and not truncated.any()
    assert np.linalg.norm(obs["way"], axis=-1).max() < 0.1
    assert env.step(trained.policy(obs))[3].all(), "an episode takes 4 s"
    name = envs.register_task("hold_traced", Hold)
    try:
        settings = {"normalize_actions": False, "action_options": options}
        assert "success" in str(pw.evaluate(trained.policy, name, vehicles=["cf21B_500"], episodes=8, settings=settings))
    finally:
        envs.IDS.pop(name)
        gymnasium.registry.pop(name)


def of(**parts):
    return type("Own", (Hold,), parts)


def late(self, s):
    if s.pos[0] > 0:
        return 1.0
    return 2.0


@pytest.mark.parametrize(
    "task, error, message",
    [
        (of(reward=late), TypeError, r"ask whether something is so.*test_traced_tasks.py, line \d+: if s.pos\[0\] > 0"),
        (of(reward=lambda self, s: s.wind), TypeError, r"a goal sees pos, .* not wind \(test_traced_tasks.py, line \d+"),
        (of(reward=lambda self, s: s.pos), TypeError, r"Own.reward: expected a number or a formula"),
        (of(reward=lambda self, s: "much"), TypeError, r"Own.reward: .*'much'"),
        (of(observe=lambda self, s: {"way": []}), ValueError, r"observe: expected at least one number in each channel, got \{'way': 0\}"),
        (of(observe=lambda self, s: {"pos": s.pos}), ValueError, r"observe: expected names of channels other than pos.*got 'pos'"),
        (of(observe=lambda self, s: [s.action]), TypeError, r"a goal sees .* here, not action"),
        (of(cost=learn.Goal.cost), NotImplementedError, r"def cost.*or what it is worth: def reward"),
        (of(pos=(0, 1)), TypeError, r"pos: expected three numbers or pairs"),
        (of(vel=[(1, -1)] * 3), ValueError, "finite bounds in order"),
        (of(memory={"crashed": 0.0}), ValueError, "memory: expected names .* got 'crashed'"),
        (of(remember=lambda self, s: {"there": 1.0}), ValueError, "remember: expected names of memory"),
    ],
)
def test_what_is_no_task_is_refused(task, error, message):
    with pytest.raises(error, match=message):
        envs.DroneVectorEnv(2, task=task)


def test_what_an_environment_cannot_do_with_a_goal_is_said():
    with pytest.raises(ValueError, match="n_drones: expected 1: in the task Hold every world has one drone"):
        envs.DroneVectorEnv(2, task=Hold, n_drones=2)
    # What environments alone show is refused where there is none.
    with pytest.raises(TypeError, match="not crashed: environments alone show it"):
        learn.bptt(Reach(), "cf21B_500", commands=1000)
    with pytest.raises(ValueError, match="reward of world .*: expected a finite number"):
        env = envs.DroneVectorEnv(2, task=of(reward=lambda self, s: np.sqrt(s.pos[0] - 100)))
        env.reset(seed=1)
        env.step(np.zeros((2, 4)))
    # Without ground: what a class says of crashes counts.
    low = of(pos=[0, 0, -1], crash_ends=False)
    env = envs.DroneVectorEnv(2, task=low)
    env.reset(seed=1)
    assert not env.step(np.zeros((2, 4)))[2].any()
    env = envs.DroneVectorEnv(2, task=of(pos=[0, 0, -1]))
    env.reset(seed=1)
    _, reward, terminated, *_ = env.step(np.zeros((2, 4)))
    assert terminated.all() and (reward < -100).all()
