"""Paths to be followed."""

import numpy as np
import pytest

import propwash as pw

POINTS = np.array([[0, 0, 1], [1.0, 0.8, 1.4], [2.2, -0.3, 0.8], [3.0, 0.2, 1.0]])
TIMES = np.array([0.5, 1.6, 3.4, 4.4])


def test_it_meets_the_points_rests_at_its_ends_and_is_smooth():
    path = pw.MinimumSnap(POINTS, TIMES)
    np.testing.assert_allclose(path.at(TIMES), POINTS, atol=1e-9)
    for derivative in (1, 2, 3):
        np.testing.assert_allclose(path.at(TIMES[[0, -1]], derivative), 0, atol=1e-7)
    for derivative in range(1, 7):
        before, after = path.at(TIMES[1:-1] - 1e-9, derivative), path.at(TIMES[1:-1] + 1e-9, derivative)
        np.testing.assert_allclose(before, after, rtol=1e-4, atol=1e-4)
    t = np.linspace(0.6, 4.3, 50)
    for derivative in range(1, 5):
        slope = (path.at(t + 1e-6, derivative - 1) - path.at(t - 1e-6, derivative - 1)) / 2e-6
        np.testing.assert_allclose(path.at(t, derivative), slope, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(path.at([-3.0, 9.0]), POINTS[[0, -1]], atol=1e-12)
    assert not path.at(9.0, 1).any() and path.at(np.zeros((2, 3))).shape == (2, 3, 3)


def test_no_other_path_has_less_snap():
    """Searched for by what stands free at the middle points: velocity, acceleration and jerk there, with polynomials of degree 7 between."""
    minimize = pytest.importorskip("scipy.optimize").minimize
    path = pw.MinimumSnap(POINTS, TIMES)
    lengths = np.diff(TIMES)

    def snap(free):
        ends = np.zeros((4, 4))
        ends[:, 0] = POINTS[:, 0]
        ends[1:3, 1:] = free.reshape(2, 3)
        total = 0.0
        for i, length in enumerate(lengths):
            rows = np.array([[np.prod(np.arange(k, k - d, -1)) * t ** (k - d) if k >= d else 0.0 for k in range(8)] for t in (0.0, length) for d in range(4)])
            c = np.linalg.solve(rows, np.concatenate([ends[i], ends[i + 1]]))
            t = (np.arange(2000) + 0.5) / 2000 * length
            fourth = sum(c[k] * np.prod(np.arange(k, k - 4, -1)) * t ** (k - 4) for k in range(4, 8))
            total += (fourth**2).mean() * length
        return total

    own = np.array([[path.at(t, d)[0] for d in (1, 2, 3)] for t in TIMES[1:3]]).ravel()
    best = minimize(snap, own + 0.5, method="BFGS", options={"gtol": 1e-9})
    assert snap(own) <= best.fun * (1 + 1e-6)
    np.testing.assert_allclose(own, best.x, rtol=1e-2, atol=1e-2)


def test_a_drone_follows_it():
    path = pw.MinimumSnap(POINTS, 2 * TIMES)
    sim = pw.Sim(control="state")
    sim.set_initial(pos=POINTS[0])
    sim.reset()
    worst = 0.0
    for k in range(900):
        t = k * 0.01
        sim.state_control(path.command(t)[None, None])
        sim.step(5)
        worst = max(worst, np.linalg.norm(sim.data.pos[0, 0] - path.at(t + 0.01)))
    assert worst < 0.1, worst


@pytest.mark.parametrize(
    "points, times, said",
    [
        ([[0, 0, 1]], [0], "at least two"),
        ([[0, 0], [1, 1]], [0, 1], r"shape \(n, 3\)"),
        ([[0, 0, 1], [1, 0, 1]], [0, 1, 2], "one for each point"),
        ([[0, 0, 1], [1, 0, 1]], [1, 1], "rising"),
        ([[0, 0, np.nan], [1, 0, 1]], [0, 1], "finite"),
    ],
)
def test_wrong_input_is_refused_in_words(points, times, said):
    with pytest.raises(ValueError, match=said):
        pw.MinimumSnap(points, times)
    with pytest.raises(ValueError, match="0 to 6"):
        pw.MinimumSnap(POINTS, TIMES).at(0.0, 7)
