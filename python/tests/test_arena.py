"""What effects read of a scene is measured at every step; states are kept, put back and copied."""

import numpy as np
import propwash
import pytest

SLABS = """<mujoco><worldbody>
  <geom type="box" size="5 5 0.25" pos="0 0 -0.25"/>
  <geom type="box" size="5 5 0.25" pos="0 0 0.45"/>
  <body name="post" mocap="true" pos="9 9 1"><geom size="0.1"/></body>
</worldbody></mujoco>"""


def vehicle(*effects):
    text = "".join(f"[[effect]]\n{lines}\n" for lines in effects)
    return propwash.Vehicle("cf2x_L250").with_effects(text)


GROUND = 'kind = "ground_effect"\nstrength = 3.0'
CEILING = 'kind = "ceiling_effect"\nstrength = 3.0'
MINE = 'kind = "expression"\nname = "mine"\nforce_world_n = ["0", "0", "1e-4 / ground_m + 1e-4 / ceiling_m"]'


def fly(drone, precision, scene, heights=None):
    sim = propwash.Sim(3, drone=drone, control="attitude", scene=scene, precision=precision)
    sim.set_initial(pos=[0.0, 0.0, 0.08])
    sim.reset()
    if heights is not None:
        sim.data.ground_z[...], sim.data.ceiling_z[...] = heights
    sim.attitude_control(np.tile([0.05, 0.0, 0.0, 0.32], (3, 1, 1)))
    sim.step(60)
    return sim


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("effect", [GROUND, CEILING, MINE])
def test_effects_get_the_ground_and_the_ceiling_of_the_scene_by_themselves(effect, precision):
    told = fly(vehicle(effect), precision, SLABS)
    by_hand = fly(vehicle(effect), precision, None, (0.0, 0.2))
    plain = fly(vehicle(), precision, SLABS)
    np.testing.assert_allclose(told.data.pos, by_hand.data.pos, atol=1e-6 if precision == "f32" else 1e-12)
    assert np.abs(told.data.pos - plain.data.pos).max() > 1e-4
    ground, ceiling = effect != CEILING, effect != GROUND
    assert np.allclose(told.data.ground_z, 0.0, atol=1e-6) if ground else np.all(np.isinf(told.data.ground_z))
    assert np.allclose(told.data.ceiling_z, 0.2, atol=1e-6) if ceiling else np.all(np.isinf(told.data.ceiling_z))


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_a_saved_state_goes_on_bit_for_bit_and_views_stay(precision):
    drone = vehicle(GROUND, 'kind = "turbulence"\nsigma_m_s = [0.5, 0.5, 0.2]\nlength_m = [5.0, 5.0, 2.0]')
    rules = [{"parameter": "body.mass_kg", "draw": {"scale": [0.9, 1.1]}}]
    args = {"drone": drone, "scene": SLABS, "precision": precision, "randomization": rules, "seed": 3}
    sim = propwash.Sim(4, **args)
    sim.set_initial(pos=[0.0, 0.0, 0.1])
    sim.reset()
    sim.step(20)
    pos, kept = sim.data.pos, sim.save()

    def on(sim):
        sim.step(15)
        sim.reset([True, False, False, True])
        sim.data.wind[..., 0] = 0.3
        sim.step(15)
        return [sim.data.pos.copy(), sim.data.rotor_vel.copy(), sim.parameter("body.mass_kg"), sim.data.steps.copy()]

    first = on(sim)
    sim.set_parameter("body.mass_kg", 0.04)
    sim.obstacle_pos[...] = 1.0
    sim.set_initial(pos=[0.0, 0.0, 0.15])
    for again in (sim, propwash.Sim(4, **args)):
        again.restore(kept)
        assert np.all(again.obstacle_pos == [9.0, 9.0, 1.0])
        assert all((a == b).all() for a, b in zip(first, on(again)))
    assert pos is sim.data.pos and (pos == first[0]).all()
    # Only heights are given: the rest of what resets start from is that of the state.
    sim.set_initial(vel=[0.0, 0.0, 0.1])
    sim.reset()
    assert np.all(sim.data.pos == np.asarray([0.0, 0.0, 0.1], sim.data.pos.dtype))
    sim.fork(2)
    assert np.all(sim.parameter("body.mass_kg") == sim.parameter("body.mass_kg")[2])
    assert "4 worlds" in repr(kept)


def test_states_that_do_not_fit_are_refused_and_change_nothing():
    sim = propwash.Sim(2)
    before = sim.data.pos.copy()
    for other, words in [
        (propwash.Sim(3), "3 worlds"),
        (propwash.Sim(2, precision="f64"), "precision"),
        (propwash.Sim(2, control="attitude"), "state"),
        (propwash.Sim(2, drone=vehicle(GROUND)), "ground_effect"),
        (propwash.Sim(2, scene=SLABS), "scenes"),
    ]:
        other.data.pos[...] = 1.0
        with pytest.raises(ValueError, match=words):
            sim.restore(other.save())
    assert (sim.data.pos == before).all()
    with pytest.raises(ValueError, match="world"):
        sim.fork(2)
    with pytest.raises(TypeError):
        sim.restore("state")


def test_worlds_that_move_to_another_scene_find_its_obstacles_where_they_stand():
    sim = propwash.Sim(2, scene=[SLABS, SLABS.replace("9 9 1", "1 0 0.1")], layout=[0, 0])
    sim.set_initial(pos=[0.0, 0.0, 0.1])
    sim.reset()
    sim.layout = [0, 1]
    assert sim.obstacle_pos[:, 0, 0].tolist() == [9.0, 1.0]
    assert sim.layout.tolist() == [0, 1]
