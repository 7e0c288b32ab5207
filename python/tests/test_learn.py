"""Policies trained by the gradients of their flights."""

import numpy as np
import pytest

import propwash as pw
from propwash import learn


@pytest.fixture(scope="module")
def tracked():
    return learn.bptt(learn.Track(), seed=3)


def test_a_policy_learns_to_follow_a_path(tracked):
    flights = tracked.fly()
    assert flights.lost == 0 and flights.reached == 100
    assert flights.error_rms < 0.0087, flights
    assert tracked.cost[-1] < 0.1 * tracked.cost[:20].mean() and tracked.commands[-1] >= 100_000
    assert flights.path.shape == (500, 3)


def test_it_learns_by_rotor_speeds_too():
    trained = learn.bptt(learn.Track(period=5.5), action="rotor_vel", seed=1)
    flights = trained.fly()
    assert flights.lost == 0 and flights.error_rms < 0.166, flights


def test_it_learns_to_recover_from_throws():
    trained = learn.bptt(learn.Recover())
    flights = trained.fly(flights=1000)
    assert flights.reached >= 950, flights
    # The same by the policy in NumPy, from other throws.
    n, draws = 100, np.random.default_rng(2)
    sim = pw.Sim(n, drone="cf21B_500", control="attitude")
    axis = draws.normal(size=(n, 1, 3))
    half = draws.uniform(0, np.pi / 4, (n, 1, 1))
    axis *= np.sin(half) / np.linalg.norm(axis, axis=-1, keepdims=True)
    quat = np.concatenate([axis, np.cos(half)], -1)
    sim.set_initial(pos=np.zeros((n, 1, 3)), quat=quat, vel=draws.uniform(-2, 2, (n, 1, 3)), ang_vel=draws.uniform(-8, 8, (n, 1, 3)))
    sim.reset()
    for _ in range(250):
        now = sim.states
        action = trained.policy({name: getattr(now, name)[:, 0] for name in ("pos", "quat", "vel", "ang_vel")})
        sim.attitude_control(action[:, None])
        sim.step(5)
    end = sim.states
    still = (np.linalg.norm(end.vel, axis=-1) < 0.3) & (np.linalg.norm(end.ang_vel, axis=-1) < 1.0)
    assert still.sum() >= 95, still.sum()


def test_the_same_seed_gives_the_same_policy(tracked):
    again = learn.bptt(learn.Track(), seed=3)
    np.testing.assert_array_equal(tracked.cost, again.cost)
    assert not np.array_equal(tracked.cost, learn.bptt(learn.Track(), seed=4).cost)


def test_the_policy_is_one_as_any_other(tracked, tmp_path):
    pytest.importorskip("gymnasium")
    policy = tracked.policy
    policy.save(tmp_path / "track.npz")
    policy.to_c(tmp_path / "track.c")
    loaded = pw.Policy.load(tmp_path / "track.npz")
    found = pw.evaluate(loaded, episodes=16)
    assert found.rows[0].success == 1.0 and found.rows[0].mean_distance < 0.05, found


def test_it_flies_vehicles_that_it_was_not_trained_with(tracked):
    windy = pw.Vehicle("cf21B_500").with_effects('[[effect]]\nkind = "constant_wind"\nvelocity_m_s = [1.0, 0.5, 0.0]\n')
    calm, wind = tracked.fly().error_rms, tracked.fly(windy).error_rms
    assert calm < wind < 0.5


def test_wrong_input_is_refused_in_words():
    with pytest.raises(TypeError, match="Track or Recover"):
        learn.bptt("track")
    with pytest.raises(ValueError, match="period: expected a finite number above 0"):
        learn.bptt(learn.Track(period=-1.0))
    with pytest.raises(ValueError, match="action: expected `attitude` or `rotor_vel`"):
        learn.bptt(learn.Track(), action="state")
    with pytest.raises(ValueError, match="rate"):
        learn.bptt(learn.Track(), rate=float("nan"))
    with pytest.raises(ValueError, match="substeps: expected a divisor of 500"):
        learn.bptt(learn.Track(), substeps=3)
    with pytest.raises(ValueError, match="horizon"):
        learn.bptt(learn.Track(), horizon=0)
    with pytest.raises(ValueError, match="rotor_vel"):
        learn.bptt(learn.Track(), dynamics="so_rpy", action="rotor_vel")
