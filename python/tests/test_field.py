"""Distance fields of scenes, and flights that are watched by them."""

import numpy as np
import pytest

import propwash as pw

SCENE = """<mujoco><worldbody><geom type="plane" size="0 0 1"/><geom type="cylinder" size=".2 1" pos="1 0 1"/>
<geom type="box" size=".1 .3 .2" pos="-1 .5 1" euler="10 20 30"/></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def sim(tmp_path_factory):
    path = tmp_path_factory.mktemp("field") / "scene.xml"
    path.write_text(SCENE)
    return pw.Sim(40, n_drones=2, drone="cf2x_L250", control="attitude", scene=path, threads=2)


@pytest.fixture(scope="module")
def field(sim):
    return sim.distance_field(0.05)


def exact(points):
    """Distance to the plane and the cylinder, which is what is near in front of it."""
    x, y, z = np.moveaxis(points, -1, 0)
    radial = np.hypot(x - 1, y) - 0.2
    return np.minimum(z, np.hypot(np.maximum(radial, 0), np.maximum(z - 2, 0)))


def test_a_field_is_as_far_off_as_its_grid_is_coarse(field):
    points = np.random.default_rng(1).uniform([0.3, -1, 0], [1.9, 1, 2.4], (2000, 3))
    points = points[np.hypot(points[:, 0] - 1, points[:, 1]) > 0.2]
    distance = field.distance(points)
    assert np.abs(distance - exact(points)).max() < 0.05 * np.sqrt(3) / 2
    np.testing.assert_allclose(field.distance(points, fast=True), distance, atol=1e-5)
    assert field.distance([1.0, 0.0, 1.0]) < -0.15, "inside"


def test_slopes_are_those_of_the_interpolation(field):
    points = np.random.default_rng(2).uniform([-3, -3, 0], [3, 3, 4], (2, 500, 3))
    distance, slopes = field.gradient(points)
    assert distance.shape == (2, 500) and slopes.shape == (2, 500, 3)
    step = 1e-6
    differences = np.stack([(field.distance(points + step * e) - field.distance(points - step * e)) / (2 * step) for e in np.eye(3)], -1)
    close = np.abs(differences - slopes).max(-1) < 1e-4
    assert close.mean() > 0.99, "but where cells meet"


def test_a_field_is_kept_in_a_file(field, tmp_path):
    again = pw.DistanceField.load(field.save(tmp_path / "field.npz"))
    np.testing.assert_array_equal(again.data, field.data)
    np.testing.assert_array_equal(again.planes, [[0, 0, 1, 0]])
    assert again.resolution == field.resolution == 0.05 and (again.origin == field.origin).all()
    assert repr(again) == repr(field) and "0.05 m apart" in repr(field)
    assert again.zero_inside == () and (again.bounds[1] > 1.8).all()
    (tmp_path / "none.npz").write_text("none")
    with pytest.raises(ValueError, match="is no distance field"):
        pw.DistanceField.load(tmp_path / "none.npz")
    with pytest.raises(ValueError, match="ends with .npz"):
        field.save(tmp_path / "field.npy")


def test_a_field_of_ones_own():
    data = np.broadcast_to(np.linspace(0, 1, 11)[:, None, None], (11, 3, 4))
    field = pw.DistanceField(data, [0, 0, 0], 0.1)
    distance, slopes = field.gradient([0.33, 0.1, 0.1])
    assert abs(distance - 0.33) < 1e-6
    np.testing.assert_allclose(slopes, [1, 0, 0], atol=1e-6)
    assert abs(field.distance([1.3, 0.1, 0.1]) - np.hypot(1.0, 0.3)) < 1e-6, "outside"


def test_what_is_no_field_is_refused(sim, field):
    with pytest.raises(ValueError, match="MiB"):
        sim.distance_field(0.001, memory_mib=10)
    with pytest.raises(ValueError, match="resolution"):
        sim.distance_field(-1.0)
    with pytest.raises(ValueError, match="two corners"):
        sim.distance_field(0.1, ([0, 0], [1, 1]))
    with pytest.raises(ValueError, match="two corners"):
        sim.distance_field(0.1, ([0, 0, 1], [1, 1, 0]))
    with pytest.raises(ValueError, match="memory_mib"):
        sim.distance_field(0.1, memory_mib=0)
    with pytest.raises(IndexError):
        sim.distance_field(0.1, scene=1)
    with pytest.raises(pw.Error, match="no scene"):
        pw.Sim(1).distance_field()
    with pytest.raises(ValueError, match="points"):
        field.distance([1.0, 2.0])
    with pytest.raises(ValueError, match="finite"):
        field.distance([1.0, 2.0, np.nan])
    with pytest.raises(ValueError, match="data"):
        pw.DistanceField(np.zeros((2, 2)), [0, 0, 0], 0.1)
    with pytest.raises(ValueError, match="finite"):
        pw.DistanceField(np.full((2, 2, 2), np.inf), [0, 0, 0], 0.1)
    with pytest.raises(ValueError, match="planes"):
        pw.DistanceField(np.zeros((2, 2, 2)), [0, 0, 0], 0.1, planes=[0, 0, 1])
    with pytest.raises(ValueError, match="origin"):
        pw.DistanceField(np.zeros((2, 2, 2)), [0, 0], 0.1)


@pytest.mark.parametrize("substeps", [1, 5])
def test_a_flight_says_how_near_it_came(sim, field, substeps):
    draws = np.random.default_rng(3)
    hover = float(sim.hover_thrust()[0, 0])
    commands = np.zeros((40, 60, 2, 4))
    commands[..., 1] = draws.uniform(0, 0.5, (40, 1, 2))
    commands[..., 3] = 1.1 * hover
    sim.set_initial(pos=draws.uniform([-0.2, -0.4, 0.8], [0.4, 0.4, 1.2], (40, 2, 3)), vel=[2.0, 0, 0])
    sim.reset()
    kept = sim.save()
    near = sim.rollout(commands, substeps, field=field, radius=0.1, states=True)
    pos = near.states.pos
    sim.restore(kept)
    np.testing.assert_array_equal(sim.rollout(commands, substeps).pos, pos)
    sim.restore(kept)
    same = sim.rollout(commands, substeps, field=field, radius=0.1)
    assert same.states is None
    np.testing.assert_array_equal(same.distance, near.distance)
    np.testing.assert_array_equal(same.first, near.first)
    distance = field.distance(pos, fast=True)
    np.testing.assert_allclose(near.distance, distance.min(axis=1), atol=1e-6)
    below = distance < 0.1
    np.testing.assert_array_equal(near.first, np.where(below.any(axis=1), below.argmax(axis=1), 60))
    if substeps == 5:
        assert 0 < (near.first < 60).mean() < 1


def test_a_flight_without_a_field_gives_states_alone(sim, field):
    commands = np.zeros((40, 1, 2, 4))
    with pytest.raises(ValueError, match="states"):
        sim.rollout(commands, states=False)
    with pytest.raises(ValueError, match="radius"):
        sim.rollout(commands, field=field, radius=-1.0)
