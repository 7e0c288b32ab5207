"""propwash.Sim: arrays, commands, steps, resets, parameters, stages, quarantine."""

import gc
import weakref

import numpy as np
import pytest
from conftest import WALL, hover

import propwash


def test_arrays_have_worlds_and_drones_first():
    sim = propwash.Sim(3, 2)
    shapes = {
        "pos": (3,), "quat": (4,), "vel": (3,), "ang_vel": (3,), "rotor_vel": (4,), "thrust": (), "command": (16,),
        "rotor_command": (4,), "attitude_command": (4,), "disturbance_force": (3,), "disturbance_torque": (3,), "wind": (3,),
        "ground_z": (), "ceiling_z": (),
    }  # fmt: skip
    for name, tail in shapes.items():
        array = getattr(sim.data, name)
        assert array.shape == (3, 2, *tail) and array.dtype == np.float32, name
    assert sim.data.steps.shape == sim.time.shape == sim.quarantined.shape == (3,)
    assert propwash.Sim(precision="f64").data.pos.dtype == np.float64
    assert np.all(sim.data.quat == [0, 0, 0, 1]) and np.all(sim.data.ground_z == -np.inf)


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_arrays_are_views_that_follow_every_step_and_outlive_the_simulation(precision):
    sim = propwash.Sim(2, precision=precision)
    pos, steps = sim.data.pos, sim.data.steps
    address = pos.__array_interface__["data"][0]
    sim.state_control(hover(sim))
    sim.step(100)
    assert np.all(steps == 100) and np.all(pos[..., 2] != 0.0)
    assert sim.data.pos is pos and sim.data.pos.__array_interface__["data"][0] == address
    sim.reset()
    assert np.all(pos == 0.0)
    pos[1, 0] = [1.0, 2.0, 3.0]
    sim.step(1)
    assert abs(pos[1, 0, 0] - 1.0) < 0.1 and abs(pos[0, 0, 0]) < 0.1
    before = pos.copy()
    del sim, steps
    gc.collect()
    assert np.all(pos == before)


def test_arrays_go_to_other_libraries_by_dlpack():
    sim = propwash.Sim(2)
    other = np.from_dlpack(sim.data.pos)
    sim.data.pos[...] = 7.0
    assert np.all(other == 7.0)
    jax = pytest.importorskip("jax")
    assert jax.dlpack.from_dlpack(sim.data.vel).shape == (2, 1, 3)


def test_counts_are_read_only_and_arrays_are_not_replaced():
    sim = propwash.Sim()
    with pytest.raises(ValueError, match="read-only"):
        sim.data.steps[0] = 5
    with pytest.raises(AttributeError, match=r"data.pos\[\.\.\.\] = value"):
        sim.data.pos = np.zeros((1, 1, 3))
    with pytest.raises(AttributeError, match="no array 'position'"):
        sim.data.position = 1
    sim.data.pos += 1.0
    assert np.all(sim.data.pos == 1.0)


@pytest.mark.parametrize("control", ["state", "attitude", "body_rate", "force_torque", "rotor_vel"])
@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_drones_hover_in_every_mode(control, precision):
    sim = propwash.Sim(2, control=control, precision=precision)
    command = np.zeros(sim.data.command.shape)
    if control == "rotor_vel":
        command = sim.hover_rotor_vel()
    elif control == "force_torque":
        command[..., 0] = sim.hover_thrust()
    elif control == "state":
        command = hover(sim)
    else:
        command[..., 3] = sim.hover_thrust()
    getattr(sim, f"{control}_control")(command)
    sim.step(100)
    assert np.abs(sim.data.pos).max() < 0.02, sim.data.pos
    assert np.allclose(sim.time, 0.2)


def test_commands_may_be_of_any_real_type_and_layout():
    sim = propwash.Sim(2, 3, precision="f64")
    command = np.arange(2 * 3 * 16.0).reshape(2, 3, 16)
    for given in (command, command.astype(np.float32), command.astype(int), command.tolist(), np.asfortranarray(command)):
        sim.data.command[...] = 0.0
        sim.state_control(given)
        assert np.all(sim.data.command == command), type(given)


def test_only_worlds_of_the_mask_are_reset():
    sim = propwash.Sim(3)
    sim.set_initial(pos=np.arange(9.0).reshape(3, 1, 3))
    sim.reset()
    assert np.all(sim.data.pos.ravel() == np.arange(9.0))
    sim.step(50)
    sim.reset([False, True, False])
    assert np.all(sim.data.steps == [50, 0, 50]) and np.all(sim.data.episodes == [2, 3, 2])
    assert np.all(sim.data.pos[1, 0] == [3.0, 4.0, 5.0]) and np.any(sim.data.pos[0, 0] != [0.0, 1.0, 2.0])


def test_what_set_initial_is_not_given_stays():
    sim = propwash.Sim(2, 2, precision="f64")
    sim.set_initial(pos=[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]], quat=[0.0, 0.0, 2.0, 0.0])
    sim.set_initial(vel=[0.0, 0.0, 0.5])
    sim.reset()
    assert np.all(sim.data.pos[:, 1] == [1.0, 0.0, 1.0]) and np.all(sim.data.vel == [0.0, 0.0, 0.5])
    assert np.all(sim.data.quat == [0.0, 0.0, 1.0, 0.0])


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_the_same_seed_gives_the_same_bits_for_any_number_of_threads(precision):
    rules = [
        {"parameter": "body.mass_kg", "draw": {"scale": [0.8, 1.2]}},
        {"parameter": "initial.pos.*", "draw": {"uniform": [-1.0, 1.0]}},
    ]

    def fly(seed, threads, n_worlds=300):
        sim = propwash.Sim(n_worlds, seed=seed, threads=threads, randomization=rules, precision=precision)
        sim.state_control(hover(sim))
        sim.step(60)
        return sim.data.pos.copy(), sim.parameter("body.mass_kg")

    (pos, mass), (pos3, mass3) = fly(5, 1), fly(5, 3)
    assert np.array_equal(pos, pos3) and np.array_equal(mass, mass3)
    assert len(np.unique(mass)) == 300
    assert not np.array_equal(pos, fly(6, 3)[0])
    assert np.array_equal(pos[:7], fly(5, 2, 7)[0])


def test_randomisation_may_be_text_or_a_file(tmp_path):
    text = '[[rule]]\nparameter = "body.mass_kg"\ndraw = { uniform = [0.02, 0.03] }\n'
    (tmp_path / "rules.toml").write_text(text)
    for rules in (text, tmp_path / "rules.toml", str(tmp_path / "rules.toml")):
        mass = propwash.Sim(4, randomization=rules).parameter("body.mass_kg")
        assert np.all((mass >= 0.02) & (mass < 0.03))


def test_rates_are_those_in_force():
    sim = propwash.Sim(drone=["cf2x_L250", "hb_x500"], state_freq=50, attitude_freq=250)
    for drone, vehicle in enumerate(sim.vehicles):
        own = dict(vehicle.rates)
        assert dict(sim.rates[drone]) == {**own, "state": 50, "attitude": 250, "rotor_vel": 500}
    plain = propwash.Sim(freq=1000)
    assert dict(plain.rates[0]) == {**plain.vehicles[0].rates, "rotor_vel": 1000}
    with pytest.raises(TypeError):
        sim.rates[0]["state"] = 1
    assert propwash.Sim.from_config(sim.config).rates == sim.rates


@pytest.mark.parametrize("control, freq", [("state", 50), ("attitude", 100), ("body_rate", 250), ("force_torque", 125), ("rotor_vel", None)])
def test_a_loop_over_the_rate_commands_as_often_as_the_controller_listens(control, freq):
    """Each command of such a loop is taken up in the first of its steps."""
    rate = {} if freq is None else {f"{control}_freq": freq}
    sim = propwash.Sim(control=control, rotor_start="off", **rate)
    n = sim.freq // sim.rates[0][control]
    assert n == (1 if freq is None else 500 // freq)
    give = getattr(sim, f"{control}_control")
    command = np.zeros((1, 1, sim.data.command.shape[-1]))
    column, unit = {"state": (0, 0.1), "force_torque": (0, 0.1), "rotor_vel": (3, 500.0)}.get(control, (3, 0.1))
    if control == "state":
        command[..., 12] = 1.0
    made = "attitude_command" if control == "state" else "rotor_command"
    heard = []
    for turn in range(4):
        command[..., column] = unit * (1 + turn)
        give(command)
        for step in range(n):
            before = getattr(sim.data, made).copy()
            sim.step()
            if not (getattr(sim.data, made) == before).all():
                heard.append((turn, step))
    assert heard == [(turn, 0) for turn in range(4)]


def test_a_parameter_goes_back_in_the_shape_that_it_came_in():
    light = propwash.Vehicle("cf2x_L250").with_effects('[[effect]]\nkind = "payload"\nmass_kg = 0.005')
    sim = propwash.Sim(3, drone=[light, "cf2x_L250"])
    mass = sim.parameter("body.mass_kg")
    new = mass * np.array([[1.0, 1.1], [1.2, 1.3], [1.4, 1.5]])
    sim.set_parameter("body.mass_kg", new)
    assert (sim.parameter("body.mass_kg") == new).all()
    # NaN where a drone does not have it.
    payload = sim.parameter("effect.payload.mass_kg")
    assert np.isnan(payload[:, 1]).all()
    sim.set_parameter("effect.payload.mass_kg", 2.0 * payload)
    assert np.allclose(sim.parameter("effect.payload.mass_kg")[:, 0], 0.01)
    for value, kind in [(np.ones((2, 2)), ValueError), (np.ones((3, 2)), KeyError), (payload * [[1], [1], [np.nan]], ValueError)]:
        with pytest.raises(kind):
            sim.set_parameter("effect.payload.mass_kg", value)
    with pytest.raises(ValueError, match=r"\(3,\)"):
        sim.set_parameter("body.mass_kg", new, drone=0)
    bad = new.copy()
    bad[2, 1] = np.nan
    with pytest.raises(ValueError):
        sim.set_parameter("body.mass_kg", 2.0 * bad)
    assert (sim.parameter("body.mass_kg") == new).all()
    assert np.allclose(sim.parameter("effect.payload.mass_kg")[:, 0], 0.01)


def test_parameters_differ_between_worlds_where_they_are_set_so():
    sim = propwash.Sim(3, 2, control="force_torque", precision="f64")
    mass = sim.parameters()["body.mass_kg"]
    sim.set_parameter("body.mass_kg", mass * np.array([1.0, 1.5, 2.0]), drone=1)
    expected = mass * np.array([[1.0, 1.0], [1.0, 1.5], [1.0, 2.0]])
    assert np.allclose(sim.parameter("body.mass_kg"), expected, rtol=1e-15)
    assert np.allclose(sim.hover_thrust(), 9.81 * expected, rtol=1e-3)
    sim.reset()
    command = np.zeros((3, 2, 4))
    command[..., 0] = 9.81 * mass
    sim.force_torque_control(command)
    sim.step(100)
    assert np.all(np.diff(sim.data.vel[:, 1, 2]) < -0.1) and np.ptp(sim.data.vel[:, 0, 2]) < 1e-12
    with pytest.raises(ValueError, match="mass"):
        sim.set_parameter("body.mass_kg", mass * np.array([1.0, 1.0, -1.0]))
    assert np.allclose(sim.parameter("body.mass_kg"), expected, rtol=1e-15), "nothing was changed"


def test_vehicles_are_mixed_in_one_world_and_arrays_are_as_wide_as_the_widest():
    sim = propwash.Sim(2, drone=["cf2x_L250", "cf21B_500"])
    assert sim.n_drones == 2 and [v.name for v in sim.vehicles] == ["cf2x_L250", "cf21B_500"]
    mass = sim.parameter("body.mass_kg")
    assert mass[0, 0] != mass[0, 1]
    sim = propwash.Sim(1, 3, dynamics=["first_principles", "so_rpy", "so_rpy_rotor"])
    names = [n for n in sim.parameters(drone=1) if n.startswith("attitude_response.")]
    values = sim.parameter(names[0])
    assert np.isnan(values[0, 0]) and np.isfinite(values[0, 1])


def test_effects_of_a_vehicle_act():
    vehicle = propwash.Vehicle("cf2x_L250")
    windy = vehicle.with_effects(
        '[[effect]]\nkind = "constant_wind"\nvelocity_m_s = [3.0, 0.0, 0.0]\n'
    )
    assert [kind for kind, _ in windy.effects()][-1] == "constant_wind" and len(vehicle.effects()) + 1 == len(windy.effects())
    sim = propwash.Sim(2, drone=[vehicle, windy], control="attitude", precision="f64")
    command = np.zeros((2, 2, 4))
    command[..., 3] = sim.hover_thrust()
    sim.attitude_control(command)
    sim.step(50)
    assert np.all(np.abs(sim.data.vel[:, 0, 0]) < 1e-3) and np.all(sim.data.vel[:, 1, 0] > 0.05)
    assert "effect.constant_wind.velocity_m_s.0" in sim.parameters(drone=1)


def test_vehicle_files_are_read_and_written(tmp_path):
    text = propwash.Vehicle("cf2x_L250").to_toml()
    (tmp_path / "mine.toml").write_text(text)
    mine = propwash.Vehicle(tmp_path / "mine.toml")
    assert mine.name == "mine" and mine.to_toml() == text and mine.sha256 == propwash.Vehicle("cf2x_L250").sha256
    assert propwash.Sim(drone=tmp_path / "mine.toml").vehicles[0].name == "mine"
    assert set(["cf2x_L250", "cf21B_500", "hb_x500"]) >= {"cf2x_L250", "cf21B_500"}
    assert dict(mine.parameters())["body.mass_kg"] == 0.0328 and "first_principles" in mine.dynamics
    assert mine.modes("so_rpy") == ["state", "attitude"] and mine.rates["state"] == 100


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_a_stage_is_called_once_per_step_with_all_worlds(precision):
    sim = propwash.Sim(4, control="attitude", precision=precision)
    seen = []

    def push(data):
        seen.append(data.steps.copy())
        data.disturbance_force[:2, 0, 0] = 0.01

    sim.pipeline.insert_before("integration", "push", push)
    assert sim.pipeline.names == ["controllers", "push", "integration"]
    command = np.zeros((4, 1, 4))
    command[..., 3] = sim.hover_thrust()
    sim.attitude_control(command)
    sim.step(20)
    assert np.array_equal(np.array(seen), np.arange(20)[:, None].repeat(4, 1))
    assert np.all(sim.data.vel[:2, 0, 0] > 1e-3) and np.all(np.abs(sim.data.vel[2:, 0, 0]) < 1e-4)
    sim.pipeline.remove("push")
    sim.step(5)
    assert len(seen) == 20


def test_stages_are_put_first_last_before_after_and_instead():
    sim = propwash.Sim()
    calls = []
    sim.pipeline.append("d", lambda data: calls.append("d"))
    sim.pipeline.prepend("a", lambda data: calls.append("a"))
    sim.pipeline.insert_after("controllers", "b", lambda data: calls.append("b"))
    sim.pipeline.insert_before("d", "c", lambda data: calls.append("c"))
    assert sim.pipeline.names == ["a", "controllers", "b", "integration", "c", "d"]
    sim.step(2)
    assert calls == ["a", "b", "c", "d"] * 2
    sim.pipeline.replace("b", lambda data: calls.append("B"))
    sim.step()
    assert calls[8:] == ["a", "B", "c", "d"]


def test_stages_once_per_call_see_its_beginning_or_its_end():
    sim = propwash.Sim(2)
    seen = []
    sim.pipeline.append("every", lambda data: seen.append(("every", int(data.steps[0]))))
    sim.pipeline.append("end", lambda data: seen.append(("end", int(data.steps[0]))), per="call")
    sim.pipeline.prepend("begin", lambda data: seen.append(("begin", int(data.steps[0]))), per="call")
    assert sim.pipeline.names == ["begin", "controllers", "integration", "every", "end"]
    sim.step(0)
    assert not seen
    sim.step(3)
    assert [name for name, _ in seen] == ["begin", "every", "every", "every", "end"] and seen[0][1] == 0 and seen[-1][1] == 3
    sim.pipeline.replace("end", lambda data: seen.append(("other", 0)))
    sim.pipeline.remove("every")
    sim.pipeline.remove("begin")
    seen.clear()
    sim.step(4)
    assert seen == [("other", 0)] and sim.pipeline.names == ["controllers", "integration", "end"]
    for stage, message in [(propwash.RestOnGround(0.1), "expected a function"), (3, "expected a function"), (propwash.effect(lambda s: s.force.__setitem__(0, 1.0)), "belongs to a vehicle")]:
        with pytest.raises(TypeError, match=message):
            sim.pipeline.append("odd", stage, per="call")
    for name in ("end", "controllers"):
        with pytest.raises(ValueError, match="expected a name that no stage has"):
            sim.pipeline.append(name, print, per="call")
    with pytest.raises(ValueError, match='expected "step" or "call", got "hour"|got \'hour\''):
        sim.pipeline.append("odd", print, per="hour")
    sim.pipeline.replace("end", lambda data: 3)
    with pytest.raises(TypeError, match="stage 'end': expected None, got int"):
        sim.step(1)


def test_what_a_stage_raises_is_raised_by_step():
    sim = propwash.Sim(2)
    later = []

    def fails(data):
        if data.steps[0] == 3:
            raise ZeroDivisionError("in the stage")

    sim.pipeline.append("fails", fails)
    sim.pipeline.append("later", lambda data: later.append(1))
    with pytest.raises(ZeroDivisionError, match="in the stage"):
        sim.step(10)
    assert np.all(sim.data.steps == 3) and len(later) == 2
    sim.pipeline.replace("fails", lambda data: 5)
    with pytest.raises(TypeError, match='"fails": expected None, got int'):
        sim.step()
    sim.pipeline.remove("fails")
    sim.step(2)
    assert np.all(sim.data.steps == 6)


def test_a_stage_that_steps_its_own_simulation_is_refused():
    sim = propwash.Sim()
    sim.pipeline.append("again", lambda data: sim.step())
    with pytest.raises(propwash.Error, match="one of its own stages"):
        sim.step()
    sim.pipeline.remove("again")
    sim.step()


def test_a_simulation_whose_stage_holds_it_is_collected():
    sim = propwash.Sim()
    sim.pipeline.append("hold", lambda data, sim=sim: None)
    sim.step()
    gone = weakref.ref(sim)
    del sim
    gc.collect()
    assert gone() is None


def test_the_ground_holds_where_a_stage_says_so():
    sim = propwash.Sim(2, control="rotor_vel", scene=WALL, rotor_start="off")
    sim.set_initial(pos=[0.0, 0.0, 0.5])
    sim.reset()
    sim.measure_ground()
    assert np.all(np.abs(sim.data.ground_z) < 1e-6)
    sim.pipeline.append("ground", propwash.RestOnGround(0.02))
    sim.rotor_vel_control(np.zeros((2, 1, 4)))
    sim.step(1000)
    # Gravity acts for one step before the stage stops the fall again.
    assert np.allclose(sim.data.pos[..., 2], 0.02, atol=1e-6) and np.all(np.abs(sim.data.vel) < 0.05)


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_a_world_that_breaks_is_set_aside_and_told(precision):
    sim = propwash.Sim(3, precision=precision)
    sim.state_control(hover(sim))
    sim.step(5)
    sim.data.vel[1] = np.nan
    with pytest.warns(propwash.QuarantineWarning, match="world 1 is quarantined"):
        sim.step(5)
    assert np.all(sim.quarantined == [False, True, False])
    (why,) = sim.quarantine
    assert (why.world, why.drone) == (1, 0) and "world 1" in why.message
    sim.step(5)  # told once
    assert np.all(sim.data.steps[[0, 2]] == 15) and sim.data.steps[1] < 15
    sim.reset([False, True, False])
    assert not sim.quarantined.any() and sim.quarantine == []
    sim.data.pos[0] = np.inf
    with pytest.warns(propwash.QuarantineWarning):
        sim.step()


def test_a_stage_that_writes_no_number_is_named():
    sim = propwash.Sim(2)

    def breaks(data):
        data.ang_vel[1, 0, 2] = np.nan

    sim.pipeline.append("breaks", breaks)
    with pytest.warns(propwash.QuarantineWarning, match="written by stage breaks"):
        sim.step()
    assert sim.quarantine[0].stage == "breaks" and np.isfinite(sim.data.ang_vel).all()


@pytest.mark.parametrize("dynamics", ["first_principles", "so_rpy", "so_rpy_rotor", "so_rpy_rotor_drag"])
@pytest.mark.parametrize("vehicle", ["cf2x_L250", "cf21B_500", "hb_x500"])
def test_hover_thrust_hovers_with_every_vehicle_and_model(vehicle, dynamics):
    try:
        sim = propwash.Sim(drone=vehicle, dynamics=dynamics, control="attitude", precision="f64")
    except (ValueError, propwash.Error) as e:
        pytest.skip(f"{vehicle} has no {dynamics}: {e}")
    sim.set_initial(pos=[0, 0, 2])
    sim.reset()
    command = np.zeros((1, 1, 4))
    command[..., 3] = sim.hover_thrust()
    sim.attitude_control(command)
    sim.step(sim.freq)
    assert np.abs(sim.data.pos[0, 0] - [0, 0, 2]).max() < 2e-3


def test_more_worlds_than_memory_holds_are_refused():
    with pytest.raises(ValueError, match="fit in the memory of this machine|1 TiB"):
        propwash.Sim(n_worlds=10**9, n_drones=2)


@pytest.mark.parametrize("vehicle", ["cf2x_L250", "cf21B_500", "hb_x500"])
def test_body_rates_die_away_by_the_firmware_and_are_followed_by_the_tracking_law(vehicle):
    for law, roll in (("firmware", 0.0), ("tracking", 2.0)):
        sim = propwash.Sim(drone=vehicle, control="body_rate", precision="f64", body_rate_law=law)
        sim.set_initial(pos=[0, 0, 50])
        for axis in (0, 1):
            sim.reset()
            command = np.zeros((1, 1, 4))
            command[..., 3] = sim.hover_thrust()
            command[..., axis] = 2.0
            sim.body_rate_control(command)
            # A rolling drone soon hangs upside down; its rates do not mind.
            sim.step(400)
            rate = sim.data.ang_vel[0, 0]
            assert abs(rate[axis] - roll) < 0.2 and np.abs(np.delete(rate, axis)).max() < 0.05
    with pytest.raises(ValueError, match="firmware.*tracking"):
        propwash.Sim(body_rate_law="betaflight")
