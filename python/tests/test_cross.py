"""Policies that cross forests by what a depth camera shows, trained by gradients."""

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

import propwash.envs  # noqa: E402
from propwash import learn  # noqa: E402


def make(num_envs=1, **changed):
    settings = {
        "freq": 20,
        "drone": "cf21B_500",
        "action": "attitude",
        "normalize_actions": False,
        "camera": {"width": 16, "height": 12, "fovy_deg": 70.0, "range_m": [0.02, 6.0]},
        "scene": {"forest": {"trees": 12, "rocks": 2, "logs": 1, "moving": 0, "size_m": 8.0, "seed": 1}},
        "layouts": 2,
    }
    return gymnasium.make_vec("Propwash/ForestDepth-v0", num_envs=num_envs, **{**settings, **changed})


@pytest.fixture(scope="module")
def trained():
    return learn.cross(make(), commands=150_000, worlds=64, threads=2, seed=5)


def arrived(policy, worlds, **changed):
    """Part of the flights that arrive."""
    envs = make(worlds, autoreset_mode="Disabled", **changed)
    obs, _ = envs.reset(seed=2)
    ending = np.zeros(worlds, int)
    for _ in range(240):
        obs, _, terminated, truncated, info = envs.step(policy(obs))
        done = terminated | truncated
        if done.any():
            ending = np.where((ending == 0) & done, info["ending"], ending)
            if (ending != 0).all():
                break
            obs, _ = envs.reset(options={"reset_mask": done})
    return (ending == propwash.envs.ENDINGS.index("done")).mean()


def test_it_learns_to_cross(trained):
    assert trained.cost[-5:].mean() < 0.25 * trained.cost[:5].mean()
    assert trained.commands[-1] >= 150_000 and trained.lost > 0 and 0 < trained.prepared < trained.seconds
    assert arrived(trained.policy, 64) > 0.5


def test_ways_lead_through_doors():
    rooms = {"rooms": {"columns": 2, "rows": 1, "room_m": 4.0, "things": 0, "moving": 0, "seed": 3}}
    ends = {"start_m": [[-1.0, -1.0, 1.0], [0.0, 1.0, 1.2]], "goal_m": [[4.5, -1.0, 1.0], [5.0, 1.0, 1.2]]}
    done = {}
    for detour in (0.0, 0.4):
        trained = learn.cross(make(scene=rooms, task_options=ends, layouts=1), learn.Cross(detour=detour, keep=0.4), commands=150_000, worlds=64, seed=5)
        done[detour] = arrived(trained.policy, 64, scene=rooms, task_options=ends, layouts=1)
    assert done[0.4] > 0.5 and done[0.4] > done[0.0] + 0.2, done


def test_threads_do_not_matter_and_seeds_do(trained):
    few = {"commands": 8_000, "worlds": 32}
    one, two = (learn.cross(make(), **few, threads=n) for n in (1, 2))
    np.testing.assert_array_equal(one.cost, two.cost)
    assert not np.array_equal(one.cost, learn.cross(make(), **few, seed=9).cost)


def test_the_policy_is_kept(trained, tmp_path):
    path = tmp_path / "cross.npz"
    trained.policy.save(path)
    envs = make(3)
    obs, _ = envs.reset(seed=4)
    np.testing.assert_array_equal(propwash.Policy.load(path)(obs), trained.policy(obs))
    assert "cross" in repr(trained.policy) or trained.policy.trained
    assert "commands in" in repr(trained)


def test_pixels_are_pooled():
    camera = {"width": 32, "height": 24, "fovy_deg": 70.0, "range_m": [0.02, 6.0]}
    trained = learn.cross(make(camera=camera), pool=(2, 2), commands=2_000, worlds=16)
    obs, _ = make(2, camera=camera).reset(seed=4)
    assert trained.policy(obs).shape == (2, 4)


@pytest.mark.parametrize(
    ("changed", "options", "words"),
    [
        ({"action": "velocity"}, {}, "attitude"),
        ({"normalize_actions": True}, {}, "normalize_actions=False"),
        ({}, {"pool": (5, 1)}, "block sides that divide"),
        ({}, {"goal": learn.Cross(speed=-1.0)}, "goal.speed"),
        ({}, {"goal": learn.Cross(detour=-1.0)}, "goal.detour: expected a finite number of at least 0"),
        ({}, {"rate": 0.0}, "rate"),
        ({"scene": {"forest": {"moving": 2, "seed": 1}}}, {}, "nothing moves"),
        ({"levels": {"action_delay_s": 0.05}}, {}, "without disturbances, delays, noise"),
        ({"randomization": [{"parameter": "body.mass_kg", "draw": {"scale": [0.9, 1.1]}}]}, {}, "without disturbances, delays, noise"),
    ],
)
def test_what_makes_no_sense_is_refused(changed, options, words):
    with pytest.raises(ValueError, match=words):
        learn.cross(make(**changed), commands=100, worlds=16, **options)


def test_other_environments_and_wrappers_are_refused():
    with pytest.raises(ValueError, match="forest_depth"):
        learn.cross(gymnasium.make_vec("Propwash/ReachPos-v0", num_envs=1, normalize_actions=False), commands=100)
    with pytest.raises(TypeError):
        learn.cross(object())
