"""Goals of one's own: what Python functions say, learnt in lanes."""

import numpy as np
import pytest

import propwash as pw
from propwash import learn


class Circle(learn.Goal):
    """Round and round, 1 m from the axis."""

    pos, vel, begin, time = [(-1, 1), (-1, 1), (1, 2)], [(-0.5, 0.5)] * 3, (0, 6), 5.0

    def way(self, s):
        return np.array([np.cos(s.t), np.sin(s.t), 1.5]) - s.pos

    def observe(self, s):
        return [self.way(s), 0.5 * s.vel, s.quat, 0.3 * s.ang_vel, np.sin(s.t), np.cos(s.t)]

    def cost(self, s):
        way, change = self.way(s), s.action - s.before
        return way @ way + 0.02 * change @ change

    def off(self, s):
        way = self.way(s)
        return np.sqrt(way @ way)


def test_a_goal_of_ones_own_is_learnt_and_its_policy_flies_in_a_simulation():
    trained = learn.bptt(Circle(), "cf21B_500", commands=200_000)
    flown = trained.fly(flights=50)
    assert flown.lost == 0 and flown.error_rms < 0.05, flown
    assert trained.cost[-1] < 0.2 * trained.cost[0]
    # The same seed gives the same policy.
    again = learn.bptt(Circle(), "cf21B_500", commands=200_000)
    linear = [[layer.weight for layer in t.policy.layers if layer.kind == "linear"] for t in (trained, again)]
    assert len(linear[0]) == 3
    for a, b in zip(*linear):
        np.testing.assert_array_equal(a, b)
    # Observed with NumPy, in a simulation of one's own.
    policy = trained.policy
    sim = pw.Sim(4, drone="cf21B_500", control="attitude")
    sim.data.pos[...] = [1.0, 0.2, 1.4]
    for k in range(200):
        t = np.full(4, (k + 1) * 0.02)
        way = np.stack([np.cos(t), np.sin(t), 0 * t + 1.5], -1) - sim.data.pos[:, 0]
        seen = np.concatenate([way, 0.5 * sim.data.vel[:, 0], sim.data.quat[:, 0], 0.3 * sim.data.ang_vel[:, 0], np.sin(t)[:, None], np.cos(t)[:, None]], -1)
        sim.attitude_control(policy({"observation": seen.astype(np.float32)})[:, None])
        sim.step(10)
    assert np.linalg.norm(way, axis=-1).max() < 0.1, way


def test_what_is_remembered_is_drawn_changed_and_ends_episodes():
    class Two(learn.Goal):
        """To one place and then to another."""

        memory = {"place": [(-1, 1), (-1, 1), (1, 2)], "other": [(-1, 1), (-1, 1), (1, 2)], "there": 0.0}
        pos, time = [(-1, 1), (-1, 1), (1, 2)], 6.0

        def aim(self, s):
            return np.where(s.there > 0.5, s.other, s.place) - s.pos

        def observe(self, s):
            return [self.aim(s), 0.5 * s.vel, s.quat, 0.3 * s.ang_vel]

        def off(self, s):
            return np.sqrt(self.aim(s) @ self.aim(s) + 1e-9)

        def cost(self, s):
            return np.sqrt(self.aim(s) @ self.aim(s) + 0.01) + 0.05 * s.vel @ s.vel + 0.02 * (s.action - s.before) @ (s.action - s.before)

        def remember(self, s):
            return {"there": np.where(self.off(s) < 0.15, 1.0, s.there)}

        def reached(self, s):
            return (s.there > 0.5) & (self.off(s) < 0.15)

        def lost(self, s):
            return s.pos[2] < 0.2

    trained = learn.bptt(Two(), "cf21B_500", commands=400_000)
    flown = trained.fly(flights=100)
    assert flown.reached >= 95 and flown.lost <= 2, flown
    assert repr(Two()) == "<Two, a propwash.learn.Goal>"


def test_ppo_learns_it_too():
    trained = learn.ppo(Circle(), "cf21B_500", commands=600_000)
    assert trained.cost[-1] < 0.5 * trained.cost[0] and trained.fly(flights=50).error_rms < 0.8


def of(**parts):
    return type("Own", (Circle,), parts)()


@pytest.mark.parametrize(
    "goal, error, message",
    [
        (of(observe=lambda self, s: [s.action]), TypeError, r"a goal sees pos, quat, vel, ang_vel, t here, not action"),
        (of(observe=lambda self, s: []), ValueError, "observe: expected at least one number"),
        (of(cost=lambda self, s: 1.0 if s.pos[0] > 0 else 2.0), TypeError, "ask whether something is so"),
        (of(cost=lambda self, s: s.pos), TypeError, "expected a number or a formula"),
        (of(off=learn.Goal.off), NotImplementedError, "def off"),
        (of(pos=(0, 1)), TypeError, r"pos: expected three numbers or pairs"),
        (of(vel=[0, 0, "fast"]), TypeError, r"vel: expected a number or a pair"),
        (of(vel=[(1, -1)] * 3), ValueError, "finite bounds in order"),
        (of(time=0.0), ValueError, "time: expected a finite number above 0"),
        (of(memory={"pos": 0.0}), ValueError, "memory: expected names"),
        (of(remember=lambda self, s: {"there": 1.0}), ValueError, r"remember: expected names of memory \(\), got 'there'"),
        (of(memory={"a": [0.0, 1.0]}, remember=lambda self, s: {"a": 1.0}), ValueError, "remember: a: expected 2 numbers, got 1"),
    ],
)
def test_what_is_no_goal_is_refused(goal, error, message):
    with pytest.raises(error, match=message):
        learn.bptt(goal, "cf21B_500", commands=1000)
