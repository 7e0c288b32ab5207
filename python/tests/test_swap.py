"""Policies that fly every drone of a swarm to its place on the other side, trained by gradients."""

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

import propwash.envs  # noqa: E402
from propwash import learn  # noqa: E402


def make(num_envs=1, **changed):
    settings = {
        "n_drones": 4,
        "freq": 20,
        "drone": "cf21B_500",
        "action": "attitude",
        "normalize_actions": False,
        "camera": False,
        "scene": {"boxes": {"count": 0, "moving": 0}},
        "layouts": 1,
        "task_options": {"radius_m": 2.0, "start_off_m": 0.2, "neighbours": 3},
    }
    return gymnasium.make_vec("Propwash/SwarmCross-v0", num_envs=num_envs, **{**settings, **changed})


def endings(policy, worlds, seed):
    envs = make(worlds, autoreset_mode="Disabled")
    obs, _ = envs.reset(seed=seed)
    ending = np.zeros(worlds, int)
    for _ in range(240):
        obs, _, terminated, truncated, info = envs.step(policy(obs))
        done = terminated | truncated
        if done.any():
            ending = np.where((ending == 0) & done, info["ending"], ending)
            if (ending != 0).all():
                break
            obs, _ = envs.reset(options={"reset_mask": done})
    return ending


@pytest.fixture(scope="module")
def trained():
    return learn.swap(make(), commands=250_000, worlds=64, threads=2, seed=5)


def test_it_learns_to_change_places(trained):
    assert trained.cost[-5:].mean() < 0.25 * trained.cost[:5].mean()
    assert trained.commands[-1] >= 250_000 and trained.lost > 0 and 0 < trained.prepared < trained.seconds
    done = propwash.envs.ENDINGS.index("done")
    assert (endings(trained.policy, 64, 2) == done).mean() > 0.5
    few = learn.swap(make(), commands=4_000, worlds=32)
    assert (endings(few.policy, 64, 2) == done).mean() < 0.1


def test_threads_do_not_matter_and_seeds_do():
    few = {"commands": 8_000, "worlds": 32}
    one, two = (learn.swap(make(), **few, threads=n) for n in (1, 2))
    np.testing.assert_array_equal(one.cost, two.cost)
    assert not np.array_equal(one.cost, learn.swap(make(), **few, seed=9).cost)


def test_the_policy_is_kept_and_flies_other_numbers_of_drones(trained, tmp_path):
    path = tmp_path / "swap.npz"
    trained.policy.save(path)
    envs = make(3, n_drones=6)
    obs, _ = envs.reset(seed=4)
    actions = propwash.Policy.load(path)(obs)
    assert actions.shape == (3, 6, 4)
    np.testing.assert_array_equal(actions, trained.policy(obs))


@pytest.mark.parametrize(
    ("changed", "options", "words"),
    [
        ({"action": "velocity"}, {}, "attitude"),
        ({"normalize_actions": True}, {}, "normalize_actions=False"),
        ({"n_drones": 6}, {"worlds": 48}, "1, 2, 4, 8 or 16 in a world"),
        ({}, {"worlds": 30}, "multiple of the 4 drones"),
        ({"task_options": {"neighbours": 4}}, {}, "fewer than the 4 drones"),
        ({"scene": {"boxes": {"count": 3, "moving": 0}}}, {}, "nothing but the ground"),
        ({"levels": {"action_delay_s": 0.05}}, {}, "without disturbances, delays, noise"),
        ({}, {"goal": learn.Swap(foresee=0.0)}, "goal.foresee"),
        ({}, {"rate": 0.0}, "rate"),
    ],
)
def test_what_makes_no_sense_is_refused(changed, options, words):
    with pytest.raises(ValueError, match=words):
        learn.swap(make(**changed), **{"commands": 4_000, "worlds": 32, **options})


def test_other_tasks_are_refused():
    env = gymnasium.make_vec("Propwash/ReachPos-v0", num_envs=1, drone="cf21B_500", action="attitude", normalize_actions=False)
    with pytest.raises(ValueError, match="swarm_cross"):
        learn.swap(env)
