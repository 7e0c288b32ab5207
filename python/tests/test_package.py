"""The package itself: one libmujoco, what importing it does, types."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

import propwash

ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


def run(*args, **kwargs):
    done = subprocess.run([sys.executable, *args], capture_output=True, text=True, env=ENVIRONMENT, **kwargs)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("first, second", [("propwash", "mujoco"), ("mujoco", "propwash")])
def test_one_process_holds_one_libmujoco(first, second):
    script = f"""
import {first}, {second}
import mujoco, propwash
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
mujoco.mj_forward(model, mujoco.MjData(model))
sim = propwash.Sim(scene="<mujoco><worldbody><geom size='1' pos='3 0 0'/></worldbody></mujoco>")
assert sim.render_depth("fpv", (4, 4)).shape == (1, 1, 4, 4)
assert propwash.mujoco_version() == mujoco.__version__
maps = open("/proc/self/maps").read().split()
print(len({{m for m in maps if "libmujoco.so" in m}}))
"""
    assert run("-c", script).strip() == "1"


def test_importing_leaves_the_package_mujoco_alone():
    print_them = "import propwash, sys; print(sorted(m for m in sys.modules if m in ('mujoco', 'jax', 'scipy', 'gymnasium')))"
    assert run("-c", print_them).strip() == "[]"


def test_without_mujoco_the_import_says_what_to_do():
    script = """
import sys
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name == "mujoco":
            raise ModuleNotFoundError(name)
import importlib.util
real = importlib.util.find_spec
importlib.util.find_spec = lambda name, *a: None if name == "mujoco" else real(name, *a)
try:
    import propwash
except ImportError as e:
    print(e)
"""
    assert "pip install mujoco==3.17.0" in run("-c", script)


def test_everything_public_has_a_docstring_and_is_listed():
    for name in propwash.__all__:
        thing = getattr(propwash, name)
        assert isinstance(thing, str) or thing.__doc__, name
    for name in dir(propwash.Sim):
        member = getattr(propwash.Sim, name)
        assert name.startswith("_") or not callable(member) or member.__doc__, name


def test_stubs_are_those_of_the_compiled_module(tmp_path):
    if importlib.util.find_spec("mypy") is None:
        pytest.skip("mypy is not installed")
    out = run("-m", "mypy.stubtest", "propwash._native", cwd=tmp_path)
    assert "no issues found" in out


def test_types_hold(tmp_path):
    if importlib.util.find_spec("mypy") is None:
        pytest.skip("mypy is not installed")
    package = Path(propwash.__file__).parent
    assert (package / "py.typed").is_file()
    out = run("-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache"), str(package), cwd=tmp_path)
    assert "no issues found" in out
