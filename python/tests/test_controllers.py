"""Controllers of one's own, and laws of other firmware."""

import numpy as np
import pytest

import propwash as pw
from propwash import controllers, export
from conftest import ROOT
from test_export import close, outputs, reference, states



def matrix(quat):
    """Rotations from body to world. (..., 3, 3)"""
    x, y, z, w = np.moveaxis(np.asarray(quat) / np.linalg.norm(quat, axis=-1, keepdims=True), -1, 0)
    rows = [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def angles_of(quat):
    """Roll, pitch and yaw, rad. (..., 3)"""
    m = matrix(quat)
    return np.stack([np.arctan2(m[..., 2, 1], m[..., 2, 2]), np.arcsin(-m[..., 2, 0]), np.arctan2(m[..., 1, 0], m[..., 0, 0])], -1)


MODES = {"lee": "state", "indi": "state", "px4": "attitude", "ardupilot": "attitude", "betaflight": "body_rate"}


def upset(vehicle, control, seed=1, **options):
    """Eight drones that are off, and turn."""
    sim = pw.Sim(8, drone=vehicle, control=control, **options)
    draws = np.random.default_rng(seed)
    sim.data.ang_vel[...] = draws.normal(0, 1, sim.data.ang_vel.shape)
    sim.data.vel[...] = draws.normal(0, 0.2, sim.data.vel.shape)
    sim.data.pos[...] = draws.normal(0, 0.3, sim.data.pos.shape) + [0, 0, 3]
    return sim


@pytest.mark.parametrize("drone", [*pw.vehicles(), str(ROOT / "examples/own_vehicle/hexa.toml")])
@pytest.mark.parametrize("law", MODES)
def test_every_law_holds_what_it_is_told_on_every_vehicle(law, drone):
    vehicle = getattr(controllers, law)().on(drone)
    sim = upset(vehicle, MODES[law], compile="off")
    weight = sum(value * 9.81 for name, value in vehicle.parameters() if name == "body.mass_kg")
    command = np.zeros_like(sim.data.command)
    if MODES[law] == "state":
        command[..., :3], command[..., 11], command[..., 12] = [0.2, -0.3, 3.0], np.sin(0.25), np.cos(0.25)
    else:
        command[..., :4] = [0.2, -0.1, 0.3, weight]
    sim.data.command[...] = command
    sim.step(4000)
    assert not sim.quarantined.any()
    angles = angles_of(sim.data.quat[:, 0])
    if MODES[law] == "state":
        np.testing.assert_allclose(sim.data.pos[:, 0], np.broadcast_to([0.2, -0.3, 3.0], (8, 3)), atol=0.01)
        np.testing.assert_allclose(angles, np.broadcast_to([0, 0, 0.5], (8, 3)), atol=0.02)
    elif MODES[law] == "attitude":
        np.testing.assert_allclose(angles, np.broadcast_to([0.2, -0.1, 0.3], (8, 3)), atol=0.02)
    else:
        np.testing.assert_allclose(sim.data.ang_vel[:, 0], np.broadcast_to([0.2, -0.1, 0.3], (8, 3)), atol=0.02)


@pytest.mark.parametrize(
    "name, options",
    [
        ("px4", {"rate": ((0.03, 2.0, 0.0006), (0.03, 2.0, 0.0006), (0.04, 1.0, 0.0)), "integral_max": 0.02}),
        ("ardupilot", {"rate": ((0.027, 1.35, 0.00072), (0.027, 1.35, 0.00072), (0.036, 0.18, 0.0)), "integral_max": 0.02, "accel_max": np.radians((1100, 1100, 270))}),
    ],
)
def test_laws_command_what_the_firmwares_functions_command(name, options):
    """tests/data/laws: torques by the firmware's functions, transcribed, in float."""
    rows = np.genfromtxt(ROOT / f"tests/data/laws/{name}.csv", delimiter=",", names=True)
    columns = lambda *names: np.stack([now[column] for column in names], -1)
    of = controllers.Airframe(pw.Vehicle("hb_x500"))
    sim = pw.Sim(16, drone=getattr(controllers, name)(**options).on("hb_x500"), control="attitude", precision="f64", compile="off")
    turns = of.wrench[1:].T / np.abs(of.wrench[1:]).max(axis=1)
    command, compared, greatest = np.zeros((16, 1, 4)), 0, 0.0
    command[..., 3] = 0.5 * 4 * of.thrust_max
    for tick in range(15):
        now = rows[rows["tick"] == tick]
        sim.data.quat[:, 0], sim.data.ang_vel[:, 0] = columns("qx", "qy", "qz", "qw"), columns("wx", "wy", "wz")
        command[:, 0, :3] = columns("roll", "pitch", "yaw")
        sim.attitude_control(command)
        sim.step(1)
        thrusts = np.polyval(of.thrust_curve[::-1], sim.data.rotor_command[:, 0]) / of.thrust_max
        got = np.linalg.lstsq(np.column_stack([np.ones(4), turns]), thrusts.T, rcond=None)[0].T[:, 1:]
        wanted = columns("torque_x", "torque_y", "torque_z")
        free = np.abs(wanted @ turns.T).max(axis=1) < 0.4  # where no motor leaves its range
        np.testing.assert_allclose(got[free], wanted[free], atol=1e-6)
        compared, greatest = compared + free.sum(), max(greatest, np.abs(wanted[free]).max())
    assert compared > 200 and greatest > 0.15


def test_px4_turns_over_from_exactly_upside_down():
    sim = pw.Sim(1, drone=controllers.px4().on("hb_x500"), control="attitude", precision="f64", compile="off")
    sim.data.pos[...], sim.data.quat[...] = [0, 0, 50], [1, 0, 0, 0]
    sim.attitude_control([[[0, 0, 0, 10.0]]])
    sim.step(1000)
    assert np.abs(angles_of(sim.data.quat[0, 0])[:2]).max() < 0.05


def test_the_controller_on_board_commands_the_motors_as_the_crazyflies_firmware_does(tmp_path):
    """tests/data/laws: whole numbers of PWM by `controllerMellinger` and `powerDistributionLegacy`, which cut off r / 2, p / 2 and each sum: less than 3 of 65,535."""
    rows = np.genfromtxt(ROOT / "tests/data/laws/mellinger.csv", delimiter=",", names=True)
    # Both stages in every turn, as on board.
    file = tmp_path / "both.toml"
    text = (ROOT / "params/cf2x_L250.toml").read_text()
    assert "state_hz = 100" in text
    file.write_text(text.replace("state_hz = 100", "state_hz = 500"))
    of, sim = controllers.Airframe(pw.Vehicle("cf2x_L250")), pw.Sim(24, drone=str(file), control="state", precision="f64", compile="off")
    command, compared = np.zeros((24, 1, 16)), 0
    for tick in range(12):
        now = rows[rows["tick"] == tick]
        columns = lambda *names: np.stack([now[column] for column in names], -1)
        sim.data.pos[:, 0], sim.data.vel[:, 0] = columns("px", "py", "pz"), columns("vx", "vy", "vz")
        sim.data.quat[:, 0], sim.data.ang_vel[:, 0] = columns("qx", "qy", "qz", "qw"), columns("wx", "wy", "wz")
        command[:, 0, :9] = columns("to_x", "to_y", "to_z", "to_vx", "to_vy", "to_vz", "to_ax", "to_ay", "to_az")
        command[:, 0, 11], command[:, 0, 12] = np.sin(now["to_yaw"] / 2), np.cos(now["to_yaw"] / 2)
        sim.data.command[...] = command
        sim.step(1)
        got = np.polyval(of.thrust_curve[::-1], sim.data.rotor_command[:, 0]) / 0.12 * 65535
        wanted = columns("m1", "m2", "m3", "m4")
        free = ((wanted > 7100) & (wanted < 65400)).all(axis=1)  # where no motor leaves its range
        np.testing.assert_allclose(got[free], wanted[free], atol=3)
        compared += free.sum()
    assert compared == 192


def mixed(of, thrust, torque):
    """Thrusts of the rotors, N: torques before thrust. (rotor,)"""
    room = of.thrust_max - of.thrust_min
    turns = of.shares[:, 1:] @ torque
    shrink = min(1, room / np.ptp(turns))
    lift = np.clip(thrust / of.rotors, of.thrust_min - turns.min() * shrink, of.thrust_max - turns.max() * shrink)
    return np.clip(lift + turns * shrink, of.thrust_min, of.thrust_max)


def by_hand(sim, position=4.0, attitude=20.0, damping=0.8, lag=None):
    """Rotor speeds by Lee's equations and the mixing, written with NumPy and rotation matrices, drone by drone."""
    of = controllers.Airframe(sim.drone if hasattr(sim, "drone") else pw.Vehicle("cf2x_L250"))
    out = []
    for x, v, q, w, c in zip(sim.data.pos[:, 0], sim.data.vel[:, 0], sim.data.quat[:, 0], sim.data.ang_vel[:, 0], sim.data.command[:, 0]):
        a = c[6:9] - position**2 * (x - c[:3]) - 2 * position * (v - c[3:6])
        most = 0.8 * 4 * of.thrust_max / of.mass
        side = np.sqrt((most**2 - 9.81**2) / 2)
        force = of.mass * (np.clip(a, [-side, -side, -0.5 * 9.81], [side, side, 0.8 * (most - 9.81)]) + [0, 0, 9.81])
        b3 = force / np.linalg.norm(force)
        b2 = np.cross(b3, matrix(c[9:13])[:, 0])
        b2 /= np.linalg.norm(b2)
        wanted, now = np.column_stack([np.cross(b2, b3), b2, b3]), matrix(q)
        skew = 0.5 * (wanted.T @ now - now.T @ wanted)
        e_r, e_w = np.array([skew[2, 1], skew[0, 2], skew[1, 0]]), w - now.T @ wanted @ c[13:16]
        rates = attitude * np.array([1, 1, 0.4])
        torque = of.inertia @ (-(rates**2) * e_r - 2 * damping * rates * e_w) + np.cross(w, of.inertia @ w)
        c0, c1, c2 = of.thrust_curve
        thrust = mixed(of, force @ now[:, 2], torque)
        out.append((np.sqrt(c1**2 - 4 * c2 * (c0 - thrust)) - c1) / (2 * c2))
    return np.array(out)


def test_lee_is_what_its_equations_say():
    # Without a lag of the motors that is to be beaten.
    sim = upset(controllers.lee(lag=10.0).on("cf2x_L250"), "state", precision="f64")
    draws = np.random.default_rng(3)
    sim.data.command[...] = draws.normal(0, 0.3, sim.data.command.shape)
    sim.data.command[..., 2] += 3
    for quats, spread in ((sim.data.command[..., 9:13], 1.0), (sim.data.quat, 0.2)):
        quats[...] = draws.normal(0, spread, quats.shape) + (0 if spread == 1.0 else np.array([0, 0, 0, 1]))
        quats /= np.linalg.norm(quats, axis=-1, keepdims=True)
    wanted = by_hand(sim)
    sim.step(1)
    np.testing.assert_allclose(sim.data.rotor_command[:, 0], wanted, rtol=1e-9)


def test_a_controller_is_its_function():
    @pw.controller
    def mine(s, gain=6.0, turn=pw.EffectParameter(2e-3, "N·m·s/rad")):
        s.mix(s.vehicle.mass * (9.81 + gain * (s.command[2] - s.pos[2]) - 4 * s.vel[2]), -turn * s.ang_vel)

    vehicle = mine.on("cf2x_L250")
    assert repr(mine) == "<propwash.Controller mine>" and dict(vehicle.parameters())["effect.expression.mine.turn"] == 2e-3
    # It stands in the file, and flies from there.
    vehicle = pw.Vehicle.from_toml(vehicle.to_toml())
    sim = upset(vehicle, "state", precision="f64")
    sim.data.command[..., 2] = 3.2
    of = controllers.Airframe(vehicle)
    lift = of.mass * (9.81 + 6 * (3.2 - sim.data.pos[:, 0, 2]) - 4 * sim.data.vel[:, 0, 2])
    wanted = [of.speed(mixed(of, one, -2e-3 * spin)) for one, spin in zip(lift, sim.data.ang_vel[:, 0])]
    sim.step(1)
    np.testing.assert_allclose(sim.data.rotor_command[:, 0], wanted, rtol=1e-9)
    # Nothing of the on-board controller ran.
    assert not sim.data.controller_memory.any()
    sim.step(1000)
    np.testing.assert_allclose(sim.data.pos[..., 2], 3.2, atol=0.02)


@pytest.mark.parametrize("engine", ["reference", "lanes"])
def test_a_controller_with_a_rate_holds_between_its_turns(engine):
    @pw.controller(hz=100)
    def slow(s):
        turns = s.memory("turns")
        turns.next = turns.value + s.dt
        for k in range(4):
            s.rotor_command[k] = 1500 + 100 * turns.next

    sim = pw.Sim(3, drone=slow.on("cf2x_L250"), control="rotor_vel", precision="f64", engine=engine)
    seen = []
    for _ in range(13):
        sim.step(1)
        seen.append(float(sim.data.rotor_command[1, 0, 2]))
    np.testing.assert_allclose(seen, [1501.0] * 5 + [1502.0] * 5 + [1503.0] * 3, rtol=1e-12)
    sim.reset()
    sim.step(1)
    np.testing.assert_allclose(sim.data.rotor_command, 1501.0, rtol=1e-12)


def test_speeds_stay_within_what_the_vehicle_can():
    @pw.controller
    def wild(s):
        s.rotor_command[:] = [1e6, -5.0, 10.0, 1500.0]

    sim = pw.Sim(1, drone=wild.on("cf2x_L250"), control="rotor_vel", precision="f64")
    of = controllers.Airframe(pw.Vehicle("cf2x_L250"))
    sim.step(1)
    np.testing.assert_allclose(sim.data.rotor_command[0, 0], [of.speed(of.thrust_max), 0.0, of.speed(of.thrust_min), 1500.0], rtol=1e-9)


@pytest.mark.parametrize("law", MODES)
def test_gradients_go_through_controllers(law):
    sim = upset(getattr(controllers, law)().on("cf21B_500"), MODES[law], precision="f64")
    sim.data.vel[...] *= 0.1
    sim.data.ang_vel[...] *= 0.1
    sim.data.pos[...] = 0.1 * (sim.data.pos - [0, 0, 3]) + [0, 0, 3]
    width = sim.data.command.shape[-1]
    commands = np.zeros((8, 5, 1, width))
    if MODES[law] == "state":
        commands[..., 2], commands[..., 12] = 3.0, 1.0
    else:
        commands[..., 3] = 0.043 * 9.81
    draws = np.random.default_rng(5)
    way = draws.normal(0, 1, commands.shape)
    if MODES[law] == "state":
        way[..., 9:13] = 0

    def loss(by):
        kept = sim.save()
        out = sim.rollout(commands + by * way, 4).numbers
        sim.restore(kept)
        return out

    kept = sim.save()
    tape = sim.record(commands, 4)
    sim.restore(kept)
    seeds = draws.normal(0, 1, tape.states.numbers.shape)
    gains = tape.pull_back(seeds)
    exact = (gains.commands * way).sum(axis=(1, 2, 3))
    # Small: limits of motors are bends, on either side of which slopes differ.
    h = 1e-7
    differences = ((loss(h) - loss(-h)) * seeds).sum(axis=(1, 2, 3)) / (2 * h)
    np.testing.assert_allclose(exact, differences, rtol=1e-6)
    assert np.abs(exact).min() > 1e-3


@pytest.mark.parametrize("law, what", [("lee", "step"), ("px4", "controller"), ("indi", "gradient"), ("betaflight", "step")])
def test_they_are_exported_too(law, what):
    vehicle = getattr(controllers, law)().on("cf2x_L250")
    choices = dict(dynamics="first_principles", control=MODES[law], surroundings=True)
    native = export._function(vehicle, what, choices)
    inputs = states(native, 50)
    close(outputs(export.numpy(vehicle, what=what, **choices)(*inputs), native), reference(native, inputs), 1e-12)
    assert "void " in export.source(vehicle, what=what, to="c", **choices)


def branch(s):
    s.mix(1.0 if s.pos[2] < 1 else 2.0, [0, 0, 0])


def three(s):
    s.rotor_command[:3] = 100.0


def pushes(s):
    s.force = 1.0


@pytest.mark.parametrize(
    "function, message",
    [
        (branch, r"ask whether something is so.*line \d+: s\.mix"),
        (three, "three commands no speed of rotor 4"),
        (pushes, "a controller adds to rotor_command, not to force"),
        (lambda s: s.torque.__iadd__(1.0), "adds nothing|returns nothing|expected None"),
    ],
)
def test_what_is_no_controller_is_refused(function, message):
    with pytest.raises(TypeError, match=message):
        pw.controller(function)


def test_one_vehicle_has_one_controller_and_rates_are_rates():
    with pytest.raises(ValueError, match="expected a vehicle without a controller of one's own"):
        controllers.lee().on(controllers.px4().on("cf2x_L250"))
    for hz in (0, -1, np.inf, True, "fast"):
        with pytest.raises(ValueError, match="hz: expected a rate above 0"):
            pw.controller(hz=hz)(three)
