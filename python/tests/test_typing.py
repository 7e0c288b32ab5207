"""Words that arguments take are types (``Literal``), so that editors offer them and type checkers know them: those of the library."""

import re
import typing

import pytest

import propwash
from propwash import _native, gap, jobs, sense, sim


def words(function, argument):
    """Words of an argument."""
    hint = typing.get_type_hints(function)[argument]
    every = [hint, *typing.get_args(hint)]
    return {word for one in every if typing.get_origin(one) is typing.Literal for word in typing.get_args(one)}


def known(call, *args, **kwargs):
    """Words that the library names when it is given one that it does not know."""
    with pytest.raises((ValueError, propwash.Error)) as caught:
        call(*args, **kwargs)
    expected = re.split(r"expected (?:one of )?", str(caught.value), maxsplit=1)[1]
    expected = expected.split(", got")[0].split("; ")[0].split(" at line")[0]
    return set(re.findall(r"\w+", expected)) - {"or"}


def test_words_that_are_lists_of_the_library():
    vehicle = propwash.Vehicle("cf2x_L250")
    assert set(typing.get_args(sim.SceneName)) == set(propwash.scenes())
    assert set(typing.get_args(sim.Dynamics)) == set(vehicle.dynamics)
    assert set(typing.get_args(sim.Control)) == set(vehicle.modes())
    cameras = propwash.Sim(scene="room").scene.cameras
    assert {f"drone0/{name}" for name in typing.get_args(jobs.CameraName)} == {c.name for c in cameras if c.drone == 0}
    assert set(typing.get_args(jobs.AttitudeDynamics)) == set(vehicle.dynamics) - {"first_principles"}


@pytest.mark.parametrize("name", ["integrator", "precision", "engine", "rotor_start", "control"])
def test_words_of_a_simulation(name):
    assert known(propwash.Sim, **{name: "x"}) - {"auto"} == words(propwash.Sim.__init__, name) - {"auto"}


def test_words_of_other_functions(tmp_path):
    assert known(_native.lint, '{"x": {}}', (0.0, 0.0, 1.0), 0.3) - {"none", "files", "xml", "each"} == set(typing.get_args(sim.SceneKind))
    assert known(propwash.fly, tmp_path / "x", config={"pattern": "x"}, scene="room") - {"waypoints", "tracks"} == set(
        typing.get_args(jobs.Pattern)
    )
    log = tmp_path / "log.csv"
    log.write_text("t\n0\n")
    assert known(propwash.compare, log, "cf2x_L250", drive="x") == set(typing.get_args(gap.Drive))
    room = propwash.Sim(scene="room")
    assert known(room.render_depth, propwash.Camera("fpv", kind="x")) == set(typing.get_args(sense.Kind))
    assert known(room.render_depth, propwash.Camera("fpv", caster="x")) == set(typing.get_args(sense.CasterName))


def test_words_of_environments():
    envs = pytest.importorskip("propwash.envs")
    from propwash.envs import task, vector

    assert known(envs.DroneVectorEnv, action="x") == set(typing.get_args(task.Action))
    of_gymnasium = {mode.value for mode in vector.AutoresetMode}
    ours = set(vector._MODES.values())
    assert set(typing.get_args(vector.Autoreset)) == of_gymnasium | ours
