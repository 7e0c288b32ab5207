"""What is refused, and in which words; threads, processes, pickling."""

import copy
import dataclasses
import os
import pickle
import re
import subprocess
import sys
import threading
import warnings

import numpy as np
import pytest
from conftest import ROOT, WALL, hover

import propwash


def refused(kind, words, call):
    """`call` raises exactly this kind of exception, and its message holds all the words."""
    with pytest.raises(kind) as caught:
        call()
    missing = [w for w in words if w not in str(caught.value)]
    assert not missing, f"{missing} not in {caught.value}"


@pytest.mark.parametrize(
    "arguments, kind, words",
    [
        ({"n_worlds": 0}, ValueError, ["n_worlds", "integer from 1", "got 0"]),
        ({"n_worlds": -3}, ValueError, ["n_worlds", "got -3"]),
        ({"n_worlds": 2.0}, TypeError, ["n_worlds", "2.0 (float)"]),
        ({"n_worlds": True}, TypeError, ["n_worlds", "bool"]),
        ({"n_worlds": 2**39}, ValueError, ["1 TiB"]),
        ({"n_drones": "2"}, TypeError, ["n_drones", "'2' (str)"]),
        ({"n_drones": 3, "drone": ["cf2x_L250"]}, ValueError, ["drone", "a list of 3", "a list of 1"]),
        ({"drone": "cf3x"}, ValueError, ["cf3x", "cf2x_L250", "hb_x500"]),
        ({"drone": "no/such.toml"}, OSError, ["no/such.toml"]),
        ({"drone": 5}, TypeError, ["drone", "5 (int)"]),
        ({"dynamics": "exact"}, ValueError, ["exact", "first_principles", "so_rpy"]),
        ({"dynamics": ["so_rpy", "so_rpy"]}, ValueError, ["dynamics", "a list of 1"]),
        ({"dynamics": "so_rpy", "control": "rotor_vel"}, ValueError, ["control", "state, attitude", "rotor_vel"]),
        ({"control": "stick"}, ValueError, ["control", "body_rate", "`stick`"]),
        ({"control": None}, TypeError, ["control", "None"]),
        ({"freq": 50}, ValueError, ["50"]),
        ({"freq": 0}, ValueError, ["freq", "got 0"]),
        ({"state_freq": 1000}, ValueError, ["state_hz", "1 to 500 Hz", "1000 Hz"]),
        ({"integrator": "rk5"}, ValueError, ["integrator", "rk4", "`rk5`"]),
        ({"precision": "f16"}, ValueError, ["precision", "`f32`, `f64`", "`f16`"]),
        ({"engine": "gpu"}, ValueError, ["engine", "lanes", "`gpu`"]),
        ({"seed": -1}, ValueError, ["seed", "got -1"]),
        ({"threads": 0}, ValueError, ["threads", "got 0"]),
        ({"rotor_start": "fast"}, ValueError, ["rotor_start", "hover", "`fast`"]),
        ({"scene": "no/such.xml"}, OSError, ["no/such.xml"]),
        ({"scene": "<mujoco"}, ValueError, ["MuJoCo cannot parse"]),
        ({"scene": "<mujoco><worldbody><geom size='-1'/></worldbody></mujoco>"}, ValueError, ["MuJoCo cannot compile"]),
        ({"scene": 7}, TypeError, ["scene", "7 (int)"]),
        ({"shell": "no/shell.xml", "scene": WALL}, OSError, ["no/shell.xml"]),
        ({"randomization": [{"parameter": "body.mass"}]}, ValueError, ["randomization"]),
        ({"randomization": [{"parameter": "body.weight", "draw": {"normal": 1.0}}]}, KeyError, ["body.weight", "mass_kg"]),
        ({"randomization": [{"parameter": "body.mass_kg", "draw": {"scale": [2.0, 1.0]}}]}, ValueError, ["in order"]),
        ({"randomization": [{"parameter": "body.mass_kg", "draw": {"normal": [0.0, 0.1]}}]}, ValueError, ["randomization[0]", '{"normal": sigma}', "[0.0, 0.1]"]),
        ({"randomization": [{"parameter": "body.mass_kg", "draw": {"uniform": 0.1}}]}, ValueError, ["randomization[0]", '{"uniform": [low, high]}']),
        ({"randomization": [{"parameter": "body.mass_kg", "draw": {"gauss": 0.1}}]}, ValueError, ["randomization[0]", "gauss"]),
        ({"randomization": 5}, TypeError, ["randomization", "5"]),
    ],
    ids=lambda v: str(v)[:40] if isinstance(v, dict) else "",
)
def test_arguments_that_make_no_sense_are_refused(arguments, kind, words):
    refused(kind, words, lambda: propwash.Sim(**arguments))


def test_commands_of_another_shape_type_or_mode_are_refused():
    sim = propwash.Sim(2, 3)
    good = np.zeros((2, 3, 16))
    refused(ValueError, ["(2, 3, 16) = (n_worlds, n_drones, 16)", "got (2, 3)"], lambda: sim.state_control(good[..., 0]))
    refused(ValueError, ["got (6, 16)"], lambda: sim.state_control(good.reshape(6, 16)))
    refused(TypeError, ["command", "real numbers", "complex128"], lambda: sim.state_control(good.astype(complex)))
    refused(TypeError, ["command", "bool"], lambda: sim.state_control(good.astype(bool)))
    refused(TypeError, ["command", "str"], lambda: sim.state_control("up"))
    refused(TypeError, ["command", "list"], lambda: sim.state_control([[1.0], [1.0, 2.0]]))
    refused(TypeError, ["command", "None"], lambda: sim.state_control(None))
    refused(propwash.Error, ['control="state"', "state_control"], lambda: sim.attitude_control(good[..., :4]))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_commands_that_are_no_numbers_are_refused_and_change_nothing(value, precision):
    sim = propwash.Sim(2, 2, precision=precision)
    sim.state_control(hover(sim))
    before = sim.data.command.copy()
    bad = hover(sim) + 1.0
    bad[1, 0, 2] = value
    refused(ValueError, ["world 1, drone 0, entry 2", "finite"], lambda: sim.state_control(bad))
    assert np.array_equal(sim.data.command, before)


def test_commands_that_are_no_numbers_and_were_written_past_the_check_set_their_world_aside():
    sim = propwash.Sim(3, control="attitude")
    sim.data.command[1] = np.nan
    with pytest.warns(propwash.QuarantineWarning, match="world 1"):
        sim.step(20)
    assert np.array_equal(sim.quarantined, [False, True, False]) and np.isfinite(sim.data.pos).all()


def test_names_and_orders_of_crazyflow_are_answered_by_those_here():
    sim = propwash.Sim(control="attitude")
    refused(TypeError, ["name", "and the stage after it", "function"], lambda: sim.pipeline.append(lambda data: None, "gust"))
    refused(TypeError, ["anchor"], lambda: sim.pipeline.insert_before(None, "gust", lambda data: None))
    refused(AttributeError, ["step_pipeline", "sim.pipeline"], lambda: sim.step_pipeline)
    refused(AttributeError, ["build_step_fn", "hold at once"], lambda: sim.build_step_fn())
    refused(AttributeError, ["states", "sim.data.pos"], lambda: sim.data.states)
    refused(AttributeError, ["force", "disturbance_force"], lambda: sim.data.force)
    refused(AttributeError, ["Sim has no 'parametre'"], lambda: sim.parametre)
    assert not hasattr(sim, "step_pipeline") and not hasattr(sim.data, "states")


def test_other_calls_refuse_what_makes_no_sense():
    sim = propwash.Sim(2, 2, scene=WALL)
    refused(ValueError, ["n_steps", "got -1"], lambda: sim.step(-1))
    refused(TypeError, ["n_steps", "1.5"], lambda: sim.step(1.5))
    refused(ValueError, ["mask", "(2,)", "(3,)"], lambda: sim.reset([True, False, True]))
    refused(TypeError, ["mask", "booleans", "int64"], lambda: sim.reset([0, 1]))
    refused(ValueError, ["pos", "(2, 2, 3)", "(4,)"], lambda: sim.set_initial(pos=[1, 2, 3, 4]))
    refused(TypeError, ["pos", "str"], lambda: sim.set_initial(pos="here"))
    refused(ValueError, ["world 0, drone 0", "nothing was changed"], lambda: sim.set_initial(pos=[np.nan, 0, 0]))
    refused(ValueError, ["attitude that is not zero"], lambda: sim.set_initial(quat=[0, 0, 0, 0]))
    refused(KeyError, ["body.weight"], lambda: sim.parameter("body.weight"))
    refused(KeyError, ["body.weight"], lambda: sim.set_parameter("body.weight", 1.0))
    refused(ValueError, ["drone", "from 0 to 1", "got 2"], lambda: sim.set_parameter("body.mass_kg", 1.0, drone=2))
    refused(ValueError, ["finite"], lambda: sim.set_parameter("body.mass_kg", np.nan))
    refused(ValueError, ["value", "(2,)", "(3,)"], lambda: sim.set_parameter("body.mass_kg", [1.0, 1.0, 1.0]))
    refused(ValueError, ["world", "got 7"], lambda: sim.parameters(world=7))
    refused(ValueError, ["max_distance", "got -1"], lambda: sim.clearance(-1.0))
    refused(TypeError, ["max_distance", "'far'"], lambda: sim.clearance("far"))
    refused(KeyError, ["rear", "drone0/fpv"], lambda: sim.render_depth("rear"))
    refused(TypeError, ["camera", "int"], lambda: sim.render_depth(0))
    refused(TypeError, ["resolution", "pair"], lambda: sim.render_depth("fpv", 64))
    refused(ValueError, ["resolution", "got 0"], lambda: sim.render_depth("fpv", (0, 4)))
    refused(ValueError, ["worlds", "got 2"], lambda: sim.render_depth("fpv", (4, 4), worlds=[2]))
    refused(TypeError, ["worlds", "integers"], lambda: sim.render_depth("fpv", (4, 4), worlds=[0.5]))
    refused(TypeError, ["out", "ndarray"], lambda: sim.depth_frame("fpv", (4, 4), out=np.zeros(3)))
    for camera, words in [
        (propwash.Camera("fpv", range=(2.0, 1.0)), ["near 2 m", "far 1 m"]),
        (propwash.Camera("fpv", kind="depth"), ["kind", "z_depth"]),
        (propwash.Camera("fpv", caster="gl"), ["caster", "native"]),
        (propwash.Camera("fpv", groups=(9,)), ["groups", "got 9"]),
        (propwash.Camera("fpv", fovy_deg=200.0), ["200 degrees"]),
        (propwash.Camera("fpv", mount="drone", pos=(0, 0, 0)), ["not both"]),
        (propwash.Camera(mount="roof", pos=(0, 0, 0)), ["mount", '"roof"']),
        (propwash.Camera(mount="drone"), ["needs pos"]),
        (propwash.Camera("fpv", pinhole_px=(1, 1, 1, 1)), ["resolution"]),
        (propwash.Camera(), ["name of a camera"]),
    ]:
        refused(ValueError, words, lambda camera=camera: sim.render_depth(camera))
    refused(KeyError, ["'tree'", "gate"], lambda: sim.scene.obstacle("tree"))
    refused(KeyError, ["'tree'", "wall"], lambda: sim.scene.geom("tree"))


@pytest.mark.parametrize(
    "control, entry, good, bad, words",
    [
        ("attitude", 3, 0.4, 10.0, ["thrust", "10 N", "4 rotors", "0.48 N together", "grams"]),
        ("attitude", 0, -3.1, -20.0, ["roll", "-20 rad", "half a turn", "degrees?"]),
        ("attitude", 1, 3.1, 4.0, ["pitch", "4 rad", "half a turn", "degrees?"]),
        ("attitude", 2, 12.0, 90.0, ["yaw", "90 rad", "two turns", "degrees?"]),
        ("body_rate", 2, 30.0, 200.0, ["rate about z", "200 rad/s", "35 rad/s", "degrees per second?"]),
        ("body_rate", 3, 0.4, 1.0, ["thrust", "1 N", "0.48 N"]),
        ("force_torque", 0, 0.4, 1.0, ["thrust", "1 N", "0.48 N"]),
        ("rotor_vel", 3, 2000.0, 16000.0, ["rotor speed", "entry 3", "16000 rad/s", "cf2x_L250", "rpm?"]),
    ],
)
def test_a_command_beyond_the_vehicle_is_told_of_once(control, entry, good, bad, words):
    sim = propwash.Sim(3, 2, control=control)
    give = getattr(sim, f"{control}_control")
    command = np.zeros((3, 2, 4))
    command[..., entry] = good
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        give(command)
    command[2, 1, entry] = bad
    with pytest.warns(propwash.CommandWarning) as told:
        give(command)
    (text,) = [str(w.message) for w in told]
    assert told[0].filename == __file__ and all(w in text for w in [f"{control}_control", "world 2, drone 1", *words]), text
    assert sim.data.command[2, 1, entry] == np.float32(bad)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        give(command)


def test_a_command_is_held_against_the_limits_of_its_own_world_and_vehicle():
    sim = propwash.Sim(2, drone=["cf2x_L250", "cf21B_500"], control="rotor_vel")
    name = "controller.thrust_max_n"
    sim.set_parameter(name, 4.0 * sim.parameter(name))
    command = np.full((2, 2, 4), 4000.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim.rotor_vel_control(command)
    command[:, 1] = 9000.0
    with pytest.warns(propwash.CommandWarning, match="world 0, drone 1.*cf21B_500"):
        sim.rotor_vel_control(command)


def test_a_state_command_needs_an_attitude():
    sim = propwash.Sim(2, 2)
    command = hover(sim)
    sim.state_control(command)
    command[1, 0, 9:13] = 0.0
    command[1, 0, 0] = 5.0
    refused(ValueError, ["world 1, drone 0", "attitude", "[0, 0, 0, 1]", "nothing was changed"], lambda: sim.state_control(command))
    assert sim.data.command[1, 0, 0] == 0.0
    refused(ValueError, ["attitude that is not zero", "nothing was changed"], lambda: sim.set_initial(quat=[[0, 0, 0, 1], [0, 0, 0, 0]]))


def test_errors_name_fields_and_no_places_in_text_that_nobody_wrote():
    from propwash import envs

    class Own(envs.Task):
        channels = {"a": 1}
        start_space = [[-1.0, -1.0, 0.5], [1.0, 1.0, 1.0]]

    def own(**what):
        return lambda: envs.DroneVectorEnv(2, task=type("Own", (Own,), what))

    sim = propwash.Sim(scene=WALL)
    calls = [
        (["scene", "treez", "trees"], lambda: propwash.lint({"forest": {"treez": 3}})),
        (["scene", '"many"'], lambda: propwash.scene_new("forest", trees="many")),
        (["size_m", "finite"], lambda: propwash.scene_new("forest", size_m=float("nan"))),
        (["Own.camera", "devic", "device"], own(camera={"devic": "d435"})),
        (["Own.scene", '"many"'], own(scene={"forest": {"trees": "many"}})),
        (["noise", "sigma"], lambda: propwash.Recorder("out", sim, seconds=1.0, camera="fpv", noise={"sigma": 1})),
    ]
    for words, call in calls:
        with pytest.raises((ValueError, TypeError)) as caught:
            call()
        text = str(caught.value)
        assert all(w in text for w in words) and " at line " not in text, text


def test_vehicles_cameras_and_configurations_are_pickled_and_copied(tmp_path):
    shell = ROOT / "xml/shells/cf2x.xml"
    text = propwash.Vehicle("cf2x_L250").text
    (tmp_path / "mine.toml").write_text(re.sub(r'^shell = .*$', 'shell = "mine.xml"', text, flags=re.M))
    (tmp_path / "mine.xml").write_text(shell.read_text())
    vehicles = [
        propwash.Vehicle("cf2x_L250"),
        propwash.Vehicle("cf2x_L250").with_effects('[[effect]]\nkind = "payload"\nmass_kg = 0.005'),
        propwash.Vehicle(tmp_path / "mine.toml"),
        propwash.Vehicle.from_toml(text, "other"),
    ]
    for call in (lambda v: pickle.loads(pickle.dumps(v)), copy.copy, copy.deepcopy):
        for vehicle in vehicles:
            again = call(vehicle)
            assert (again.name, again.text, again.parameters()) == (vehicle.name, vehicle.text, vehicle.parameters())
            assert repr(again) == repr(vehicle)
            propwash.Sim(drone=again, scene=WALL).step(2)
        camera = propwash.Camera("fpv", resolution=(8, 8))
        sim = propwash.Sim(2, sensors=["imu"])
        for thing in (camera, sim.config, dict(sim.rates[0])):
            assert call(thing) == thing
        assert call(propwash.RestOnGround(0.25)).rest_height_m == 0.25


def test_texts_of_objects_stay_short():
    long = ["x" * 5000, np.zeros((300, 300)), tuple(range(10_000)), {str(k): "y" * 99 for k in range(500)}, ("z" * 5000,) * 5]
    kinds = [kind for name in propwash.__all__ if dataclasses.is_dataclass(kind := getattr(propwash, name))]
    assert len(kinds) >= 25
    for kind in kinds:
        for k in range(len(long)):
            thing = object.__new__(kind)
            for i, field in enumerate(dataclasses.fields(kind)):
                object.__setattr__(thing, field.name, long[(i + k) % len(long)])
            assert kind.__name__ in repr(thing) and len(repr(thing)) <= 1000, repr(thing)
    sim = propwash.Sim(100, scene="room")
    for k in range(200):
        sim.pipeline.append(f"a stage with a long name {k}", print)
    frame = sim.depth_frame("fpv", (8, 8))
    things = [sim, sim.data, sim.pipeline, sim.contacts(), sim.clearance(), frame, sim.scene, sim.vehicles[0], sim.save()]
    for thing in things:
        assert 10 < len(repr(thing)) <= 1000, repr(thing)
    assert "depth=<float32 (100, 1, 8, 8)>" in repr(frame)
    assert eval(repr(propwash.Camera("fpv", range=(0.1, 4.0))), vars(propwash)) == propwash.Camera("fpv", range=(0.1, 4.0))


def test_objects_of_mujoco_are_refused_with_the_way_out():
    mujoco = pytest.importorskip("mujoco")
    refused(TypeError, ["MjSpec", "spec.to_file(path)"], lambda: propwash.Sim(scene=mujoco.MjSpec()))
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    refused(TypeError, ["MjModel", "give the MJCF file"], lambda: propwash.Sim(scene=model))


def test_stages_refuse_what_makes_no_sense():
    pipeline = propwash.Sim().pipeline
    refused(TypeError, ["function", "int"], lambda: pipeline.append("x", 5))
    refused(KeyError, ["nowhere", "controllers, integration"], lambda: pipeline.insert_after("nowhere", "x", print))
    refused(ValueError, ["controllers", "built in"], lambda: pipeline.remove("controllers"))
    pipeline.append("x", print)
    refused(ValueError, ["exists already"], lambda: pipeline.append("x", print))
    refused(ValueError, ["rest_height_m", "NaN"], lambda: propwash.RestOnGround(float("nan")))


def test_a_simulation_without_a_scene_says_so():
    sim = propwash.Sim()
    for call in (sim.contacts, sim.clearance, sim.render_depth, sim.depth_frame, sim.measure_ground):
        refused(propwash.Error, ["no scene", "scene=", 'scene="<mujoco/>"'], call)
    both = propwash.Sim(1, 2, scene="<mujoco/>")
    both.set_initial(pos=[[0.0, 0.0, 1.0], [0.0, 0.01, 1.0]])
    both.reset()
    assert both.contacts().touching.all() and both.clearance().other_drone.tolist() == [[1, 0]]


def test_poses_that_are_no_numbers_are_set_aside_and_named():
    sim = propwash.Sim(3, scene=WALL)
    sim.data.pos[1] = np.nan
    for call in (sim.contacts, sim.clearance):
        assert call().quarantined.tolist() == [False, True, False]
    (why,) = sim.quarantine
    assert (why.world, why.drone, why.quantity) == (1, 0, "position")
    assert sim.render_depth(worlds=[2, 1]).shape[0] == 2
    with pytest.warns(propwash.QuarantineWarning, match="world 1"):
        sim.step()
    sim.reset()
    sim.obstacle_pos[2] = np.inf
    refused(propwash.Error, ["world 2"], sim.clearance)


def test_simulations_are_not_pickled_or_copied():
    sim = propwash.Sim()
    for thing, words in [(sim, "make one"), (sim.data, "copy its arrays"), (sim.save(), "Sim.save")]:
        for call in (pickle.dumps, copy.copy, copy.deepcopy):
            refused(TypeError, [words], lambda: call(thing))
    assert np.array_equal(pickle.loads(pickle.dumps(sim.data.pos)), sim.data.pos)


def test_a_second_thread_is_refused_and_nothing_breaks():
    sim = propwash.Sim(64, precision="f64")
    sim.state_control(hover(sim))
    inside, done, errors = threading.Event(), threading.Event(), []

    def wait(data):
        inside.set()
        assert done.wait(60)

    sim.pipeline.append("wait", wait)
    worker = threading.Thread(target=sim.step)
    worker.start()
    assert inside.wait(60)
    for call in (sim.step, sim.reset, sim.hover_thrust, lambda: sim.state_control(hover(sim))):
        try:
            call()
        except propwash.Error as e:
            errors.append(str(e))
    done.set()
    worker.join()
    assert len(errors) == 4 and all("another thread" in e for e in errors)
    sim.pipeline.remove("wait")
    sim.step()
    assert np.all(sim.data.steps == 2)


def test_simulations_of_different_threads_run_side_by_side():
    def fly(out, k):
        sim = propwash.Sim(200, seed=k, scene=WALL, threads=2)
        sim.state_control(hover(sim))
        for _ in range(10):
            sim.step(20)
            sim.clearance()
        out[k] = sim.data.pos.copy()

    out = {}
    threads = [threading.Thread(target=fly, args=(out, k)) for k in range(4)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert len(out) == 4 and np.array_equal(out[0], out[3])


def test_the_interpreter_is_free_while_steps_run():
    sim = propwash.Sim(200, precision="f64")
    sim.state_control(hover(sim))
    counted, stop = [0], threading.Event()

    def count():
        while not stop.is_set():
            counted[0] += 1

    other = threading.Thread(target=count)
    other.start()
    before = counted[0]
    sim.step(2000)
    after = counted[0]
    stop.set()
    other.join()
    assert after > before


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_forked_process_makes_its_own_simulation():
    script = f"""
import os, sys
import numpy as np
sys.path[:0] = {sys.path!r}
import propwash
old = propwash.Sim(500, scene={str(ROOT / "xml/room.xml")!r}, precision="f64")
old.step(20)
old.clearance()
child = os.fork()
if child == 0:
    try:
        assert np.isfinite(old.data.pos).all()
        for call in (old.step, old.contacts, old.reset):
            try:
                call()
                os._exit(2)
            except propwash.Error as e:
                assert "forked" in str(e) and "spawn" in str(e), e
        new = propwash.Sim(500, scene={str(ROOT / "xml/room.xml")!r}, precision="f64")
        new.step(20)
        new.clearance()
        assert np.array_equal(new.data.pos, old.data.pos)
        os._exit(0)
    except BaseException as e:
        print(repr(e), flush=True)
        os._exit(1)
_, status = os.waitpid(child, 0)
old.step()
sys.exit(os.waitstatus_to_exitcode(status))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
