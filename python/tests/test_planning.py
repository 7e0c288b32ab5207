"""Planning by sampling, from Python."""

import numpy as np
import pytest

import propwash
from propwash.planning import Planner

VEHICLE = "cf21B_500"


@propwash.cost(goal=3)
def near(s):
    off = s.pos - s.goal
    return 4 * np.sqrt(off @ off + 0.01) + 0.2 * s.vel @ s.vel + 0.1 * (s.command[:2] - s.before[:2]) @ (s.command[:2] - s.before[:2])


def rest(pos):
    return np.array([*pos, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0], float)


def test_it_flies_to_where_each_update_says():
    planner = Planner(VEHICLE, near, samples=1024, threads=1)
    sim = propwash.Sim(1, drone=VEHICLE, control="attitude", precision="f64")
    sim.set_initial(pos=[0.0, 0.0, 1.0])
    sim.reset()
    for goal in ([0.6, 0.0, 1.0], [0.6, 0.5, 1.3]):
        for _ in range(125):
            plan = planner.update(sim.states, goal=goal)
            sim.attitude_control(plan.command[None, None])
            sim.step(10)
        assert np.linalg.norm(sim.data.pos[0, 0] - goal) < 0.08
    assert plan.best <= plan.cost and planner.costs.shape == (1024,) and np.isclose(planner.costs.min(), plan.best)
    assert planner.means.shape == (1, 25, 4)


def test_the_same_seed_plans_the_same_whatever_the_threads_and_other_seeds_do_not():
    def plans(threads, seed):
        planner = Planner(VEHICLE, near, samples=4096, modes=2, threads=threads, seed=seed, temperature=5.0)
        return [planner.update(rest([0, 0, 1]), goal=[1, 0.2, 1]).command for _ in range(3)], planner.costs

    (one, costs), (two, others), (three, _) = plans(1, 0), plans(2, 0), plans(1, 1)
    np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(costs, others)
    assert not np.array_equal(one, three)


def test_what_is_near_counts_by_the_field():
    # A wall at x = 0.5 m that fills the half-space behind it.
    x = np.linspace(-1, 2, 31)
    field = propwash.DistanceField(np.broadcast_to((0.5 - x)[:, None, None], (31, 21, 21)), origin=(-1, -1, 0), resolution=0.1)
    kept = Planner(VEHICLE, lambda s: (1.0 - s.pos[0]) ** 2 + np.where(s.distance < 0.1, 100.0, 0.0), field=field, samples=512)
    free = Planner(VEHICLE, lambda s: (1.0 - s.pos[0]) ** 2, samples=512)
    start = rest([-0.3, 0, 1])
    start[7] = 1.5
    brakes, flies = kept.update(start), free.update(start)
    assert brakes.command[1] < -0.05 < 0.05 < flies.command[1], "the one brakes in front of the wall"
    assert kept.costs.max() > 1000.0 > brakes.cost > flies.cost


def test_the_end_of_a_flight_and_the_time_cost_what_they_are_said_to():
    planner = Planner(VEHICLE, lambda s: s.t + 1000.0 * s.last, samples=16, horizon=3, step=0.1, substeps=4)
    planner.update(rest([0, 0, 1]), t=2.0)
    np.testing.assert_allclose(planner.costs, 1000 + 2.1 + 2.2 + 2.3, rtol=1e-6)
    planner.begin()
    np.testing.assert_allclose(planner.means, np.broadcast_to([0, 0, 0, propwash.Sim(drone=VEHICLE, dynamics="so_rpy_rotor_drag", control="attitude").hover_thrust()[0, 0]], (1, 3, 4)), rtol=1e-6)


def test_rotors_are_planned_where_bounds_are_given():
    sim = propwash.Sim(drone=VEHICLE, control="rotor_vel")
    hover = float(sim.data.rotor_vel[0, 0, 0])
    bounds = {"middle": [hover] * 4, "spread": [0.05 * hover] * 4, "low": [0.5 * hover] * 4, "high": [1.5 * hover] * 4}
    planner = Planner(
        VEHICLE, lambda s: (s.pos[2] - 1.5) ** 2, control="rotor_vel", dynamics="first_principles", samples=512, step=0.02, substeps=10, update=0.02, **bounds
    )
    assert planner.update(rest([0, 0, 1])).command.sum() > 4 * hover


@pytest.mark.parametrize(
    "error, words, make",
    [
        (TypeError, "a cost sees pos", lambda: Planner(VEHICLE, lambda s: s.nowhere)),
        (ValueError, "multiple of 16", lambda: Planner(VEHICLE, near, samples=100)),
        (ValueError, "middle: expected 4 numbers", lambda: Planner(VEHICLE, near, control="rotor_vel", dynamics="first_principles")),
        (ValueError, "control: expected one of state, attitude", lambda: Planner(VEHICLE, near, control="pitch")),
        (ValueError, "given: expected goal, got nothing", lambda: Planner(VEHICLE, near).update(rest([0, 0, 1]))),
        (ValueError, "given: goal: expected shape", lambda: Planner(VEHICLE, near).update(rest([0, 0, 1]), goal=[1, 2])),
        (ValueError, "given: expected goal, got goal, speed", lambda: Planner(VEHICLE, near).update(rest([0, 0, 1]), goal=[1, 2, 3], speed=1)),
        (ValueError, "at least 13 numbers of one drone", lambda: Planner(VEHICLE, lambda s: s.t).update(np.zeros((2, 13)))),
        (ValueError, "a distance field", lambda: Planner(VEHICLE, lambda s: s.distance).update(rest([0, 0, 1]))),
        (ValueError, "finite numbers", lambda: Planner(VEHICLE, lambda s: s.t).update(rest([np.nan, 0, 1]))),
        (ValueError, "no sample has a finite cost", lambda: Planner(VEHICLE, lambda s: np.sqrt(-1.0 - s.pos[0] ** 2)).update(rest([0, 0, 1]))),
    ],
)
def test_what_makes_no_sense_is_refused(error, words, make):
    with pytest.raises(error, match=words):
        make()
