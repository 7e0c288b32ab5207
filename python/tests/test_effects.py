"""Effects that are Python functions."""

import math

import numpy as np
import pytest

import propwash as pw
from conftest import ROOT


def bare():
    """A Crazyflie without effects of its own."""
    return pw.Vehicle.from_toml(pw.Vehicle("cf2x_L250").to_toml().split("[[effect]]")[0])


@pw.effect
def everything(s, k=pw.EffectParameter(0.03, "N·s/m", slab=0.05, sign="up", min=0.0), begin=0.8):
    """Something of each."""
    s.force[0] += k * np.tanh(s.vel[1] / 0.5) - 0.002 * (s.pos[0] - s.pos[1]) / (1 + s.pos[2] ** 2)
    s.force[0] += 0.004 * np.sin(3 * s.t)
    s.force[2] += -2e-3 * -s.vel[2] - np.float64(0.001) * np.maximum(0, begin - s.pos[2])
    s.force_body[1] -= k * s.vel_body[1] * abs(s.vel_body[1])
    s.torque[2] = -1e-6 * s.ang_vel[2] * np.sqrt(s.ang_vel[2] ** 2 + 1e-6) + 1e-12 * s.rotor_sum
    s.thrust_factor *= 1 - 0.01 * np.minimum(s.mass, np.exp(-s.yaw))


def by_hand(sim, t):
    """Force and torque of the same in world axes, as disturbances are, with NumPy. (n_worlds, n_drones, 3)"""
    x, v, w = sim.data.pos, sim.data.vel, sim.data.ang_vel
    qx, qy, qz, qw = np.moveaxis(sim.data.quat, -1, 0)
    turn = np.stack([
        np.stack([1 - 2 * (qy**2 + qz**2), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw)], -1),
        np.stack([2 * (qx * qy + qz * qw), 1 - 2 * (qx**2 + qz**2), 2 * (qy * qz - qx * qw)], -1),
        np.stack([2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx**2 + qy**2)], -1),
    ], -2)  # fmt: skip
    body = np.einsum("wdji,wdj->wdi", turn, v)
    force = np.zeros_like(x)
    force[..., 0] = 0.03 * np.tanh(v[..., 1] / 0.5) - 0.002 * (x[..., 0] - x[..., 1]) / (1 + x[..., 2] ** 2) + 0.004 * np.sin(3 * t)
    force[..., 2] = 2e-3 * v[..., 2] - 0.001 * np.maximum(0, 0.8 - x[..., 2])
    side = np.zeros_like(x)
    side[..., 1] = -0.03 * body[..., 1] * abs(body[..., 1])
    force += np.einsum("wdij,wdj->wdi", turn, side)
    torque = np.zeros_like(x)
    torque[..., 2] = -1e-6 * w[..., 2] * np.sqrt(w[..., 2] ** 2 + 1e-6) + 1e-12 * sim.data.rotor_vel.sum(-1)
    return force, np.einsum("wdij,wdj->wdi", turn, torque)


def flown(vehicle, **options):
    sim = pw.Sim(6, drone=vehicle, control="rotor_vel", precision="f64", **options)
    draws = np.random.default_rng(2)
    sim.data.pos[...] = draws.normal(1, 1, sim.data.pos.shape)
    sim.data.vel[...] = draws.normal(0, 1, sim.data.vel.shape)
    sim.data.ang_vel[...] = draws.normal(0, 1, sim.data.ang_vel.shape)
    sim.rotor_vel_control(np.full((6, 1, 4), 1500.0))
    return sim


def test_a_function_does_in_flight_what_it_says():
    # Without its factor on the thrust, which disturbances cannot say.
    text = "\n".join(line for line in everything.toml.splitlines() if not line.startswith("thrust_factor"))
    own = flown(bare().with_effects(text), engine="reference")
    wanted = flown(bare(), engine="reference")
    for step in range(40):
        force, torque = by_hand(wanted, step / 500)
        wanted.data.disturbance_force[...], wanted.data.disturbance_torque[...] = force, torque
        wanted.step(1)
        own.step(1)
    for name in ("pos", "vel", "quat", "ang_vel"):
        np.testing.assert_allclose(getattr(own.data, name), getattr(wanted.data, name), rtol=0, atol=1e-12, err_msg=name)
    # In lanes too.
    lanes = flown(bare().with_effects(text), engine="lanes")
    lanes.step(40)
    np.testing.assert_allclose(lanes.data.vel, own.data.vel, rtol=0, atol=1e-10)


def test_the_factor_on_the_thrust_is_one():
    @pw.effect
    def weak(s):
        s.thrust_factor *= 0.75

    sim = pw.Sim(drone=weak.on(bare()), control="rotor_vel", precision="f64")
    sim.rotor_vel_control(sim.data.rotor_vel)
    sim.step(1)
    np.testing.assert_allclose(sim.data.vel[0, 0], [0, 0, -0.25 * 9.81 / 500], rtol=1e-3, atol=1e-9)
    assert weak.toml.endswith('thrust_factor = "0.75"\n')


def test_parentheses_stand_where_they_matter():
    @pw.effect
    def sums(s):
        a, b, c = s.pos
        s.force[0] = a - (b - c) / (a / b) * -c**2
        s.force[1] = (a + b) ** 2 / 2 - -3.0 * (-a) ** 2
        s.force[2] = 1 / (2 * a) + 2 ** (1 + 1) * (a - b) * c

    want = {"x": 1.7, "y": -0.6, "z": 2.3}
    a, b, c = want.values()
    texts = sums.toml.split("force_world_n = [")[1].split("]")[0].replace("^", "**").replace('"', "").split(", ")
    got = [eval(text, {}, want) for text in texts]
    np.testing.assert_allclose(got, [a - (b - c) / (a / b) * -(c**2), (a + b) ** 2 / 2 + 3 * a**2, 1 / (2 * a) + 4 * (a - b) * c], rtol=1e-14)
    sums.on(bare())


def test_parameters_are_those_of_the_vehicle_and_can_be_set():
    assert "[effect.parameter.k]\nvalue = 0.03\nunit = \"N·s/m\"\nslab = 0.05\nmin = 0.0\nsign = \"up\"\n" in everything.toml
    assert "[effect.parameter.begin]\nvalue = 0.8\nunit = \"1\"\n" in everything.toml
    sim = pw.Sim(3, drone=everything.on("cf2x_L250"))
    assert "effect.expression.everything.k" in sim.parameters()
    assert sim.parameters()["effect.expression.everything.k"] == 0.03
    # Behind those that the vehicle has, and no second one of its name.
    with pytest.raises(ValueError, match="everything"):
        everything.on(everything.on("cf2x_L250"))
    assert repr(everything) == "<propwash.Effect everything>" and everything.__doc__ == "Something of each."


def nothing(s):
    s.pos


def returns(s):
    s.force[0] += 1.0
    return s.force


def branch(s):
    if s.pos[2] < 1:
        s.force[0] += 1.0


def truth(s):
    s.force[0] += 1.0 if s.pos[2] else 2.0


def of_math(s):
    s.force[0] += math.sin(s.t)


def no_name(s):
    s.force[0] += s.speed


def whole(s):
    s.force = 1.0


def elsewhere(s):
    s.lift = 1.0


def fourth(s):
    s.force[3] += 1.0


def root(s):
    s.force[0] += s.vel[0] ** 0.5


def other_ufunc(s):
    s.force[0] += np.cosh(s.t)


def equal(s):
    s.force[0] += s.pos[0] == 1.0


def no_next(s):
    s.force[0] += s.memory("low").value


def twice(s):
    s.memory("low"), s.memory("low")


def no_start(s):
    s.memory("low", math.nan)


def clash(s, k=0.1):
    m = s.memory("k")
    m.next = m.value
    s.force[0] += k * m.value


def reduced(s):
    s.force[0] += np.max(s.pos)


def text(s):
    s.force[0] += "1"


def endless(s):
    s.force[0] += float("inf") * s.t


def bare_parameter(s, k):
    s.force[0] += k


@pytest.mark.parametrize(
    "function, message",
    [
        (nothing, r"nothing adds nothing: expected s\.force\[0\] \+= "),
        (returns, "returns: expected None, got Vector"),
        (branch, r"ask whether something is so.*line \d+: if s\.pos\[2\] < 1:"),
        (equal, r"== and != are no part.*line \d+: s\.force\[0\] \+= s\.pos"),
        (no_next, "no_next: memory low never gets a next value: set .next"),
        (twice, r"memory\('low'\): expected a name .* no other memory has"),
        (no_start, "memory low: expected a finite number to start from, got nan"),
        (clash, "memory k has the name of a parameter"),
        (reduced, r"ask whether something is so.*line \d+: s\.force\[0\] \+= np\.max"),
        (truth, r"ask whether something is so.*line \d+: s\.force\[0\] \+= 1\.0 if"),
        (of_math, r"functions of `math`.*line \d+: s\.force\[0\] \+= math\.sin"),
        (no_name, r"an effect sees t, pos, vel, .*not speed .*line \d+: s\.force\[0\] \+= s\.speed"),
        (whole, r"force has 3 numbers: force \+= "),
        (elsewhere, "adds to force, force_body, torque, thrust_factor, rotor_command, attitude_command, not to lift"),
        (fourth, r"force\[3\]: expected 0, 1 or 2"),
        (root, "whole power from -16 to 16, got 0.5; roots are np.sqrt"),
        (other_ufunc, "np.cosh is no part of expressions; there are np.absolute"),
        (text, "expected a number or a formula of the state, got '1'"),
        (endless, "expected a finite number, got inf"),
        (bare_parameter, "k has no value: write k="),
    ],
)
def test_what_cannot_be_an_effect_is_refused_with_its_line(function, message):
    with pytest.raises(TypeError, match=message):
        pw.effect(function)


def test_arrays_choices_and_long_sums_are_those_of_numpy():
    @pw.effect
    def everywhere(s):
        away = s.pos - [0.5, -0.25, 1.0]
        far = np.sqrt(away @ away + 1e-6)
        s.force -= 0.01 * away / far * np.where((far > 0.3) & (s.pos[2] < 5), 1.0, 0.5)
        s.force[:2] += 0.003 * np.clip(s.vel, -0.5, [0.5, 0.25, 1.0])[:2] + np.arctan2(s.vel[:2], 2.0) * 1e-3
        s.force += 1e-3 * s.to_world(np.cross(s.to_body(s.vel), [0.0, 0.0, 1.0]))
        s.torque[:] = [0.0, 1e-7 * np.sign(s.ang_vel[1]), -1e-7 * ~(s.t >= 0.01)]

    own, wanted = flown(everywhere.on(bare())), flown(bare())
    for step in range(10):
        x, v, q = wanted.data.pos, wanted.data.vel, wanted.data.quat
        away = x - [0.5, -0.25, 1.0]
        far = np.sqrt((away**2).sum(-1) + 1e-6)[..., None]
        force = -0.01 * away / far * np.where((far > 0.3) & (x[..., 2:] < 5), 1.0, 0.5)
        force[..., :2] += (0.003 * np.clip(v, -0.5, [0.5, 0.25, 1.0]) + np.arctan2(v, 2.0) * 1e-3)[..., :2]
        up = np.stack([2 * (q[..., 0] * q[..., 2] + q[..., 1] * q[..., 3]), 2 * (q[..., 1] * q[..., 2] - q[..., 0] * q[..., 3]), 1 - 2 * (q[..., 0] ** 2 + q[..., 1] ** 2)], -1)
        force += 1e-3 * np.cross(v, up)
        # Disturbances turn about the world's axes: the torque about the body's.
        torque = np.zeros_like(x)
        torque[..., 1], torque[..., 2] = 1e-7 * np.sign(wanted.data.ang_vel[..., 1]), -1e-7 * (step / 500 < 0.01)
        t = 2 * np.cross(q[..., :3], torque)
        wanted.data.disturbance_force[...], wanted.data.disturbance_torque[...] = force, torque + q[..., 3:] * t + np.cross(q[..., :3], t)
        wanted.step(1)
        own.step(1)
    for name in ("pos", "vel", "ang_vel"):
        np.testing.assert_allclose(getattr(own.data, name), getattr(wanted.data, name), rtol=0, atol=1e-12, err_msg=name)


@pw.effect
def gusty(s, tau=0.05, size=pw.EffectParameter(0.004, "N")):
    low = s.memory("low", start=0.5)
    low.next = low.value + s.dt / tau * (s.normal[0] - low.value)
    s.force[0] += size * low.value


@pytest.mark.parametrize("engine", ["reference", "lanes"])
def test_what_is_remembered_and_random_numbers_are_those_of_a_filter_in_numpy(engine):
    sim = flown(gusty.on(bare()), engine=engine)
    plain = flown(bare(), engine=engine)
    low, seen = np.full(6, 0.5), []
    for _ in range(50):
        before = sim.data.vel[:, 0, 0] - plain.data.vel[:, 0, 0]
        sim.step(1)
        plain.step(1)
        # What the force was says what is remembered, and that says what was drawn.
        force = (sim.data.vel[:, 0, 0] - plain.data.vel[:, 0, 0] - before) * 500 * 0.0328
        normal = (force / 0.004 - low) * 0.05 * 500 + low
        low = low + 1 / 500 / 0.05 * (normal - low)
        seen.append(normal)
    seen = np.array(seen)
    assert abs(seen.mean()) < 4 / np.sqrt(seen.size) and 0.8 < seen.std() < 1.2 and len(np.unique(seen.round(9))) == seen.size
    # A reset starts it again, with other numbers; the same seed has the same ones.
    again = flown(gusty.on(bare()), engine=engine)
    again.step(50)
    np.testing.assert_array_equal(again.data.vel, sim.data.vel)


def test_commands_are_changed_on_their_way():
    @pw.effect
    def limit(s):
        s.rotor_command[0] *= 0.9
        s.rotor_command[1:] = np.minimum(s.rotor_command[1:], 1400.0)

    own, told = flown(limit.on(bare())), flown(bare())
    told.rotor_vel_control(np.array([[[1350.0, 1400.0, 1400.0, 1400.0]]] * 6))
    own.step(20)
    told.step(20)
    np.testing.assert_allclose(own.data.rotor_vel, told.data.rotor_vel, rtol=1e-12)
    # As many as the vehicle has: six of a hexacopter, whose function fits no quadrotor.
    @pw.effect
    def sixth(s):
        s.rotor_command[5] *= 0.5

    hexa = pw.Sim(drone=sixth.on(ROOT / "examples/own_vehicle/hexa.toml"), control="rotor_vel", precision="f64", rotor_start="off")
    hexa.rotor_vel_control(np.full((1, 1, 6), 400.0))
    hexa.step(5)
    assert hexa.data.rotor_vel[0, 0, 5] < 0.7 * hexa.data.rotor_vel[0, 0, 4]
    for fails in (lambda: sixth.on(bare()), lambda: sixth.toml):
        with pytest.raises(TypeError, match=r"rotor_command\[5\]: expected 0 to 3"):
            fails()
    with pytest.raises(TypeError, match=r"rotor_command\[9\]: expected 0 to 3"):
        pw.effect(lambda s: s.rotor_command.__setitem__(9, 1.0))


def test_vectors_are_arrays():
    @pw.effect
    def whole(s, k=0.1):
        s.force += 0.015 * (np.array([1.0, 0.0, 0.0]) * np.sin(2 * s.t) - s.vel)
        s.force -= k * s.vel * np.sqrt(s.vel @ s.vel + 1e-6)
        s.torque -= 1e-6 * np.tanh(s.ang_vel)

    @pw.effect
    def parts(s, k=0.1):
        speed = np.sqrt(s.vel[0] * s.vel[0] + s.vel[1] * s.vel[1] + s.vel[2] * s.vel[2] + 1e-6)
        for axis in range(3):
            s.force[axis] += 0.015 * ((np.sin(2 * s.t) if axis == 0 else 0.0) - s.vel[axis])
            s.force[axis] -= k * s.vel[axis] * speed
            s.torque[axis] -= 1e-6 * np.tanh(s.ang_vel[axis])

    ends = []
    for own in (whole, parts):
        sim = flown(own.on(bare()), engine="reference")
        sim.step(40)
        ends.append(np.concatenate([sim.data.pos, sim.data.vel, sim.data.ang_vel], -1))
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    "does, words",
    [
        (lambda s: s.force.__iadd__(0.1), ["3 numbers", "0.1"]),
        (lambda s: s.force.__iadd__([0.1, 0.2]), ["3 numbers"]),
        (lambda s: setattr(s, "force", 0.1 * s.vel), ["force += "]),
        (lambda s: 2 * s.force, ["force += "]),
        (lambda s: s.vel.__setitem__(0, 1.0), ["read-only"]),
    ],
)
def test_what_vectors_refuse(does, words):
    with pytest.raises((TypeError, ValueError)) as caught:
        pw.effect(lambda s: does(s) and None)
    assert all(word in str(caught.value) for word in words), caught.value
