"""Steps that the C compiler of this machine compiles."""

import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

import propwash as pw

needs_compiler = pytest.mark.skipif(not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler")


def flight(**options):
    """Where a flight by RK4, for which there is no kernel, ends."""
    sim = pw.Sim(5, drone="cf2x_L250", control="attitude", integrator="rk4", **options)
    sim.data.command[..., :2] = np.linspace(-0.2, 0.2, 10).reshape(5, 1, 2)
    sim.data.command[..., 3] = sim.hover_thrust()
    sim.step(50)
    return sim, np.concatenate([sim.data.pos, sim.data.quat, sim.data.vel, sim.data.rotor_vel], axis=-1)


@needs_compiler
def test_compiled_steps_have_the_bits_of_byte_code():
    compiled, end = flight(compile="now")
    assert compiled.compiling() and all(line.startswith("compiled") for line in compiled.compiling())
    plain, want = flight(compile="off")
    assert plain.compiling() == []
    np.testing.assert_array_equal(end, want)
    np.testing.assert_array_equal(flight(compile=True)[1], want)
    np.testing.assert_array_equal(flight(compile=False)[1], want)


def test_what_compile_may_be():
    with pytest.raises(ValueError, match="auto"):
        pw.Sim(compile="never")
    with pytest.raises(TypeError, match="expected a str"):
        pw.Sim(compile=3)


SCRIPT = """
import sys, warnings
import numpy as np, propwash as pw
sim = pw.Sim(2048, drone="cf2x_L250", control="attitude", integrator="rk4", compile=sys.argv[1])
sim.data.command[..., 3] = sim.hover_thrust()
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    for _ in range(4000):
        sim.step(50)
        sim.reset()
        if sim.compiling()[0].startswith(("compiled", "byte code:")):
            break
    for _ in range(3):
        sim.step(1)
print(sim.compiling()[0])
print(len(caught), *[str(w.message) for w in caught])
"""


def run(mode, tmp_path, **variables):
    """Runs the script above in a process of its own, with a cache of its own."""
    env = {**os.environ, "PROPWASH_CACHE": str(tmp_path / "cache"), **variables}
    return subprocess.run([sys.executable, "-c", SCRIPT, mode], env=env, capture_output=True, text=True)


@needs_compiler
def test_what_flies_for_a_while_is_compiled_in_the_background_and_kept(tmp_path):
    first = run("auto", tmp_path)
    assert first.stdout.startswith("compiled in "), first
    again = run("auto", tmp_path)
    assert again.stdout == "compiled, from the cache\n0\n", again
    # What was cut off is compiled anew.
    (library,) = (tmp_path / "cache" / "steps").glob("*.so")
    library.write_bytes(library.read_bytes()[:1000])
    assert run("now", tmp_path).stdout.startswith("compiled in ")


def test_without_a_compiler_byte_code_flies_and_it_is_said_once(tmp_path):
    auto = run("auto", tmp_path, CC="no-such-compiler")
    state, told = auto.stdout.splitlines()
    assert state.startswith("byte code: no C compiler: tried no-such-compiler"), auto
    assert told.startswith("1 steps fly as byte code, more slowly: no C compiler"), auto
    now = run("now", tmp_path, CC="no-such-compiler")
    assert now.returncode != 0 and "compiling the steps of the simulation: no C compiler" in now.stderr


@needs_compiler
def test_what_the_compiler_says_and_where_nothing_can_be_kept_are_told(tmp_path):
    refuses = run("now", tmp_path, CC="cc -no-such-flag")
    assert "cc -no-such-flag failed: exit status: 1" in refuses.stderr, refuses
    (tmp_path / "file").write_text("")
    nowhere = run("now", tmp_path, PROPWASH_CACHE=str(tmp_path / "file"))
    assert "the cache folder" in nowhere.stderr and "PROPWASH_CACHE" in nowhere.stderr, nowhere


def test_the_variable_is_for_those_that_ask_for_auto(tmp_path):
    assert "expected off, auto or now, got 'yes'" in run("auto", tmp_path, PROPWASH_COMPILE="yes").stderr.replace('"', "'")
    assert "no C compiler" in run("auto", tmp_path, PROPWASH_COMPILE="now", CC="no-such-compiler").stderr
    off = run("off", tmp_path, PROPWASH_COMPILE="yes")
    assert "IndexError" in off.stderr and "PROPWASH_COMPILE" not in off.stderr


FORKED = """
import os, sys, time
import propwash as pw
make = lambda mode: pw.Sim(2048, drone="cf2x_L250", control="attitude", integrator="rk4", compile=mode)
sim = make("auto")
sim.data.command[..., 3] = sim.hover_thrust()
sim.step(1)
while sim.compiling()[0] == "byte code":
    sim.reset()
    sim.step(50)
assert sim.compiling()[0] == "byte code, compiling", sim.compiling()
child = os.fork()
if child == 0:
    os.environ["CC"] = "cc"
    print(make("now").compiling()[0], flush=True)
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
"""


@needs_compiler
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_process_that_was_forked_meanwhile_compiles_by_itself(tmp_path):
    slow = tmp_path / "slow-cc"
    slow.write_text("#!/bin/sh\nsleep 20\nexec cc \"$@\"\n")
    slow.chmod(0o755)
    env = {**os.environ, "PROPWASH_CACHE": str(tmp_path / "cache"), "CC": str(slow)}
    run = subprocess.run([sys.executable, "-c", FORKED], env=env, capture_output=True, text=True, timeout=60)
    assert run.stdout.startswith("compiled in "), run
