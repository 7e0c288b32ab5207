"""Policies trained in the lanes in which they fly."""

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


def test_ppo_learns_to_follow_a_path_and_is_the_same_for_the_same_seed():
    trained = learn.ppo(learn.Track(), commands=300_000, seed=2)
    flights = trained.fly()
    assert flights.lost == 0 and flights.error_rms < 0.06, flights
    assert trained.cost[-5:].mean() < 0.1 * trained.cost[:20].max() and trained.commands[-1] >= 300_000
    again = learn.ppo(learn.Track(), commands=300_000, seed=2)
    np.testing.assert_array_equal(trained.cost, again.cost)
    assert "propwash.learn.ppo" in trained.policy.describe()


def test_places_are_reached_and_the_policy_flies_in_the_environment_of_places():
    pytest.importorskip("gymnasium")
    trained = learn.bptt(learn.Reach())
    flights = trained.fly(settle=3.0, flights=200)
    assert flights.reached >= 198 and flights.error_rms < 0.02, flights
    assert flights.ends.shape == (200, 13) and (np.abs(flights.ends[:, 7:10]) < 0.1).all(1).sum() >= 198
    found = pw.evaluate(trained.policy, episodes=16)
    assert found.rows[0].success == 1.0, found


def test_landings_are_soft_where_a_critic_says_what_comes_after_a_flight():
    trained = learn.bptt(learn.Land(height=0.3), seed=1)
    flights = trained.fly(flights=200)
    assert flights.reached >= 190, flights
    # Each flight ends in the first step below the height.
    down = flights.ends[:, 2] <= 0.3
    assert down.sum() >= 190 and (flights.ends[down, 2] > 0.29).all() and (np.abs(flights.ends[down, 9]) < 0.3).sum() >= 190
    alone = learn.bptt(learn.Land(height=0.3), critic=False, seed=1)
    assert alone.fly(flights=200).reached < flights.reached


def test_gates_are_passed_in_their_order():
    trained = learn.bptt(learn.Gates())
    flights = trained.fly(flights=200)
    assert flights.reached >= 180, flights
    # The first flight crosses the ring of five gates once round.
    angle = np.unwrap(np.arctan2(flights.path[:, 1], flights.path[:, 0]))
    assert 1.5 * np.pi < angle[-1] - angle[0] < 2.2 * np.pi
    gates = [learn.Gate((2.0 * np.cos(a), 2.0 * np.sin(a), 1.0), (-np.sin(a), np.cos(a), 0.0), 0.5) for a in (0.0, 2.1, 4.2)]
    wide = learn.bptt(learn.Gates(tuple(gates), moved=0.0, turned=0.0, laps=2, time=15.0), commands=300_000)
    assert wide.fly(flights=100).reached >= 90


def test_gate_and_landing_policies_are_saved_and_give_in_numpy_what_they_are(tmp_path):
    trained = learn.bptt(learn.Gates(), commands=20_000)
    trained.policy.save(tmp_path / "gates.npz")
    trained.policy.to_c(tmp_path / "gates.c")
    loaded, draws = pw.Policy.load(tmp_path / "gates.npz"), np.random.default_rng(1)
    seen = {"gates": draws.normal(size=(5, 12)), "vel": draws.normal(size=(5, 3)), "quat": np.tile([0.0, 0.0, 0.0, 1.0], (5, 1)), "ang_vel": draws.normal(size=(5, 3))}
    action = loaded(seen)
    # The same by hand: gates and velocities are halved, angular velocities times 0.3.
    row = np.concatenate([seen["gates"] * (([0.5] * 3 + [1.0] * 3) * 2), 0.5 * seen["vel"], seen["quat"], 0.3 * seen["ang_vel"]], 1)
    parts = trained._native.parts()
    for weight, bias in parts["layers"]:
        row = np.tanh(row @ np.asarray(weight).T + np.asarray(bias))
    np.testing.assert_allclose(action, np.array(parts["middle"]) + np.array(parts["reach"]) * row, atol=1e-5)


def test_wrong_input_is_refused_in_words():
    with pytest.raises(TypeError, match="Track, Recover, Reach, Land, Gates or a Goal of your own"):
        learn.bptt("track")
    with pytest.raises(TypeError, match="critic: expected"):
        learn.bptt(learn.Land(), critic=3)
    with pytest.raises(ValueError, match="critic discount: expected a number from 0 to below 1, got 1"):
        learn.bptt(learn.Land(), critic=learn.Critic(discount=1.0))
    with pytest.raises(ValueError, match="discount: expected a number from 0 to below 1"):
        learn.ppo(learn.Track(), discount=1.5)
    with pytest.raises(ValueError, match="noise: expected a finite number above 0"):
        learn.ppo(learn.Track(), noise=0.0)
    with pytest.raises(ValueError, match="entropy: expected a finite number of at least 0"):
        learn.ppo(learn.Track(), entropy=-1.0)
    with pytest.raises(ValueError, match="parts"):
        learn.ppo(learn.Track(), parts=0)
    with pytest.raises(ValueError, match=r"gates\[0\].normal: expected a vector of length 1"):
        learn.bptt(learn.Gates((learn.Gate((0.0, 0.0, 1.0), (2.0, 0.0, 0.0)),)))
    with pytest.raises(ValueError, match=r"gates\[0\].radius: expected more than the drone's 0.07 m"):
        learn.bptt(learn.Gates((learn.Gate((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), 0.05),)))
    with pytest.raises(ValueError, match="height: expected a finite number"):
        learn.bptt(learn.Land(height=float("nan")))
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
