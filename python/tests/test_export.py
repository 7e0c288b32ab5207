"""Equations of vehicles in other languages, against the equations that fly."""

import ctypes
import itertools
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import propwash as pw
import propwash.export as export

ROOT = Path(__file__).resolve().parents[2]

WHATS = ("rate", "step", "controller", "gradient")
EFFECTS = """
[[effect]]
kind = "quadratic_drag"
drag_n_s2_per_m2 = [0.002, 0.002, 0.004]
[[effect]]
kind = "ground_effect"
strength = 2.0
[[effect]]
kind = "com_offset"
offset_m = [0.0005, 0.0, 0.0]
"""


def with_effects():
    """A Crazyflie with effects, one of which reads the height of the ground."""
    return pw.Vehicle.from_toml(pw.Vehicle("cf21B_500").to_toml() + EFFECTS)


def states(native, n, seed=0):
    """Random inputs of a function, (n, numbers) each: around the usual ones, with attitudes and speeds of any size."""
    draws = np.random.default_rng(seed)
    out = []
    for name, _, entries, usual in native.inputs():
        values = np.array(usual) + draws.normal(0, 1, (n, len(entries))) * (1 if name == "x" else 0.3) * np.maximum(np.abs(usual), 1)
        if name == "x":
            values[:, 3:7] /= np.linalg.norm(values[:, 3:7], axis=1, keepdims=True)
        if name == "p":
            values = np.array(usual) * draws.uniform(0.9, 1.1, (n, len(entries)))
        if name == "w":
            values = np.array(usual) + draws.normal(0, 0.2, (n, len(entries)))
            values[:, 9:11] = np.array([-1.0, 3.0]) + draws.uniform(-0.2, 0.2, (n, 2))
        out.append(values)
    return out


def close(got, want, tolerance):
    """Whether outputs agree, by the size of the largest number of each column."""
    for a, b in zip(got, want):
        a, b = np.asarray(a, dtype=np.float64), np.asarray(b)
        assert a.shape == b.shape and np.isfinite(b).all()
        size = np.maximum(np.abs(b).max(axis=0), 1.0)
        worst = (np.abs(a - b) / size).max()
        assert worst <= tolerance, worst


def reference(native, inputs):
    """The outputs in f64, (n, numbers) each."""
    rows = [native.evaluate([list(row) for row in rows]) for rows in zip(*inputs)]
    return [np.array(list(column)) for column in zip(*rows)]


def outputs(result, native):
    return result if len(native.outputs()) > 1 else [result]


CASES = [
    *itertools.product(("cf2x_L250", "cf21B_500"), WHATS, ("first_principles",), ("attitude",)),
    *itertools.product(("cf21B_500",), ("rate", "step"), ("so_rpy", "so_rpy_rotor_drag"), ("attitude",)),
    *itertools.product(("cf21B_500",), ("step",), ("first_principles",), ("state", "body_rate", "force_torque", "rotor_vel")),
    *itertools.product(("effects",), ("rate", "step", "gradient"), ("first_principles",), ("rotor_vel",)),
]


def made(case, **more):
    vehicle, what, dynamics, control = case
    own = with_effects() if vehicle == "effects" else vehicle
    choices = dict(dynamics=dynamics, control=control, surroundings=True, **more)
    return own, dict(what=what, **choices), export._function(own, what, choices)


@pytest.mark.parametrize("case", CASES)
def test_numpy_and_casadi_give_the_numbers_of_the_equations(case):
    casadi = pytest.importorskip("casadi")
    vehicle, choices, native = made(case, parameters=["body.mass_kg"])
    inputs = states(native, 300)
    want = reference(native, inputs)
    close(outputs(export.numpy(vehicle, **choices)(*inputs), native), want, 1e-12)
    solver = export.casadi(vehicle, **choices)
    assert isinstance(solver, casadi.Function) and solver.name_in() == [name for name, *_ in native.inputs()]
    got = solver.map(300)(*(rows.T for rows in inputs))
    close([np.array(part).T for part in (got if len(want) > 1 else [got])], want, 1e-12)


@pytest.mark.parametrize("case", [CASES[0], CASES[5], CASES[-2]])
def test_jax_gives_them_too_and_its_gradient_is_ours(case):
    jax = pytest.importorskip("jax")
    vehicle, choices, native = made(case)
    inputs = states(native, 100)
    want = reference(native, inputs)
    f = export.jax(vehicle, **choices)
    with jax.enable_x64(True):
        close(outputs(jax.jit(f)(*inputs), native), want, 1e-12)
        if case[1] == "step":
            seeds = [np.random.default_rng(3).normal(size=rows.shape) for rows in want]
            loss = lambda *given: sum((a * b).sum() for a, b in zip(outputs(f(*given), native), seeds))
            gains = jax.grad(loss, argnums=tuple(range(len(inputs))))(*inputs)
            ours = made((case[0], "gradient", *case[2:]))[2]
            close(gains, reference(ours, [*inputs, *seeds]), 1e-9)


FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffreestanding", "-ffp-contract=off", "-O1", "-fPIC", "-shared"]


def built(text, name, tmp_path, file="f"):
    """A function of C, compiled."""
    (tmp_path / f"{file}.c").write_text(text)
    subprocess.run(["cc", *FLAGS, "-o", tmp_path / f"{file}.so", tmp_path / f"{file}.c", "-lm"], check=True)
    return getattr(ctypes.CDLL(str(tmp_path / f"{file}.so")), name)


def called(function, number, inputs, outputs):
    """What it gives for each row; shapes as those of `outputs`."""
    got = [np.zeros(rows.shape) for rows in outputs]
    for k in range(len(inputs[0])):
        given = [(number * rows.shape[1])(*rows[k]) for rows in inputs]
        made_here = [(number * rows.shape[1])() for rows in outputs]
        function(*given, *made_here)
        for rows, own in zip(got, made_here):
            rows[k] = own
    return got


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("language, number, tolerance", [("c", ctypes.c_double, 1e-12), ("c-float", ctypes.c_float, 5e-6), ("cuda", ctypes.c_float, 5e-6)])
@pytest.mark.parametrize("case", [CASES[0], CASES[1], CASES[2], CASES[3], CASES[-2]])
def test_c_builds_without_a_warning_and_gives_them_too(case, language, number, tolerance, tmp_path):
    vehicle, choices, native = made(case)
    text = export.source(vehicle, to=language, **choices)
    if language == "cuda":
        # Its twin in C: what the device adds is a word and the functions that it has without a header.
        assert "__device__ void" in text and "#include" not in text
        text = "#include <math.h>\n" + text.replace("__device__ void", "void f(" + text.split("void ")[1].split("(", 1)[1].split(")")[0] + ");\nvoid")
        text = text.replace("void f(", f"void {native.name}(", 1)
    function = built(text, native.name, tmp_path)
    inputs = given_as(number, states(native, 200))
    want = reference(native, inputs)
    got = called(function, number, inputs, want)
    close(got, want, tolerance)


def given_as(number, inputs):
    """Inputs as numbers of a type: what rounding them does is no error of the function, though a difference of two may be most of a result."""
    return [rows.astype(number).astype(np.float64) for rows in inputs]


def examples():
    """A Crazyflie with each kind of effect whose page has an example that it takes."""
    for page in sorted((ROOT / "docs/effects").glob("*.md")):
        parts = page.read_text().split("```toml\n")
        if len(parts) < 2:
            continue
        try:
            yield page.stem, pw.Vehicle("cf2x_L250").with_effects(parts[1].split("```")[0])
        except (ValueError, OSError):
            continue


EXAMPLES = dict(examples())


def test_most_effects_are_among_those_that_are_exported():
    assert len(EXAMPLES) >= 25


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("effect", EXAMPLES)
def test_every_effect_is_what_it_is_in_numpy_casadi_and_c(effect, tmp_path):
    casadi = pytest.importorskip("casadi")
    vehicle = EXAMPLES[effect]
    choices = dict(what="step", control="rotor_vel", surroundings=True)
    native = export._function(vehicle, "step", dict(control="rotor_vel", surroundings=True))
    inputs = states(native, 1000, seed=7)
    want = reference(native, inputs)
    close(export.numpy(vehicle, **choices)(*inputs), want, 1e-12)
    got = export.casadi(vehicle, **choices).map(1000)(*(rows.T for rows in inputs))
    close([np.array(part).T for part in got], want, 1e-12)
    function = built(export.source(vehicle, to="c", **choices), native.name, tmp_path)
    rows = called(function, ctypes.c_double, inputs, want)
    close(rows, want, 1e-12)
    inputs = given_as(ctypes.c_float, inputs)
    function = built(export.source(vehicle, to="c-float", **choices), native.name, tmp_path, "float")
    close(called(function, ctypes.c_float, inputs, want), reference(native, inputs), 2e-6)
    assert isinstance(got[0], casadi.DM)


@pytest.mark.parametrize("vehicle", pw.vehicles())
def test_a_step_is_that_of_the_simulation(vehicle):
    n = 20
    draws = np.random.default_rng(5)
    sim = pw.Sim(n, drone=vehicle, control="attitude", precision="f64", engine="reference")
    sim.data.vel[...] = draws.normal(0, 1, sim.data.vel.shape)
    sim.data.ang_vel[...] = draws.normal(0, 2, sim.data.ang_vel.shape)
    sim.attitude_control(np.concatenate([draws.normal(0, 0.3, (n, 1, 3)), sim.hover_thrust()[..., None]], axis=-1))
    step = export.numpy(vehicle, "step")
    x = sim.states.numbers[:, 0]
    x, memory = step(x[:, : len(step.inputs["x"])], sim.data.command[:, 0])
    sim.step(1)
    np.testing.assert_allclose(x, sim.states.numbers[:, 0, : x.shape[1]], rtol=1e-12, atol=1e-12)
    assert memory.shape == (n, len(step.outputs["m_next"]))


def test_a_function_says_what_it_is_and_takes_usual_values_for_what_is_left_out():
    rate = export.numpy("cf21B_500", parameters=["body.mass_kg"])
    assert list(rate.inputs) == ["x", "u", "p"] and rate.inputs["p"] == ("body.mass_kg",) and list(rate.outputs) == ["x_rate"]
    assert repr(rate).startswith("Function(rate of cf21B_500, first_principles: x[17], u[4], p[1] -> x_rate[17])")
    hover = rate(rate.defaults["x"], rate.defaults["u"])
    np.testing.assert_allclose(hover[:13], 0, atol=1e-9)
    heavier = rate(rate.defaults["x"], rate.defaults["u"], p=2 * rate.defaults["p"])
    assert heavier[9] == pytest.approx(-9.81 / 2, rel=1e-2)
    # Batches: one state under many commands.
    assert rate(rate.defaults["x"], np.tile(rate.defaults["u"], (5, 1))).shape == (5, 17)
    text = export.source("cf21B_500", to="latex")
    assert "\\begin{align*}" in text and "x\\_rate_{1} &= x_{8}" in text
    assert "fn cf21B_500_rate(x: array<f32, 17>, u: array<f32, 4>)" in export.source("cf21B_500", to="wgsl")


def test_any_name_of_a_vehicle_gives_a_name_of_a_function():
    odd = pw.Vehicle.from_toml(pw.Vehicle("cf21B_500").to_toml(), name='5" quad */ """')
    rate = export.numpy(odd)
    assert rate.name.startswith("vehicle_5__quad_") and rate.name.isidentifier() and rate(rate.defaults["x"]).shape == (17,)
    assert export.source(odd, to="c").count("*/") == 4


def test_what_makes_no_sense_is_refused_in_words():
    rate = export.numpy("cf21B_500")
    for wrong, message in [
        (lambda: rate(np.zeros(3)), r"x: expected 17 numbers in the last axis .*got \(3,\)"),
        (lambda: rate(np.zeros(17), np.zeros(4), np.zeros(1)), "at most 2 inputs"),
        (lambda: rate(np.zeros(17), x=np.zeros(17)), "x was given twice"),
        (lambda: rate(np.zeros(17), p=np.zeros(17)), "p is no input; there are x, u"),
        (lambda: export.source("cf21B_500", to="fortran"), "to: expected one of c, c-float"),
        (lambda: export.source("cf21B_500", "force"), "what: expected one of rate, step"),
        (lambda: export.source("cf21B_500", dynamics="so"), "dynamics: expected first_principles, so_rpy"),
        (lambda: export.source("cf21B_500", "step", dynamics="so_rpy", control="rotor_vel"), "control: expected state, attitude, got rotor_vel"),
        (lambda: export.source("cf21B_500", mode="state"), "unknown choice 'mode': there are dynamics, control"),
        (lambda: export.source("cf21B_500", parameters=["body.mas"]), "body.mass_kg"),
        (lambda: export.source("no_such_vehicle"), "no_such_vehicle"),
    ]:
        with pytest.raises((ValueError, TypeError, KeyError), match=message):
            wrong()
