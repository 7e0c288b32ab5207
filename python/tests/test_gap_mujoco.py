"""The gap finder on flights of another simulator: MuJoCo steps the vehicle, with its own drag, loads and motors' thrust.

Nothing of it is Propwash's: equations, integrator, controller and noise are those of this file and of MuJoCo.
"""

import csv
from pathlib import Path

import numpy as np
import pytest

import propwash

mujoco = pytest.importorskip("mujoco")

MASS_KG = 0.75
INERTIA_KG_M2 = np.array([2.5e-3, 2.1e-3, 4.3e-3])
GRAVITY_M_S2 = 9.81
THRUST_N_S2 = 1.52e-6
TORQUE_PER_THRUST_M = 0.016
MOTOR_LAG_S = 0.03
ARM_M = 0.08
PLACES_M = ARM_M * np.array([[1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
SPINS = np.array([-1.0, 1.0, -1.0, 1.0])
STEP_S = 0.001
SECONDS = 40.0

ROTORS = "\n".join(
    f"[[rotor]]\nposition_m = [{x}, {y}, 0.0]\nspin = {int(s)}\n" for (x, y), s in zip(PLACES_M, SPINS, strict=True)
)
VEHICLE = f"""
shell = "hb_x500"

[body]
mass_kg = {MASS_KG}
inertia_kg_m2 = [[{INERTIA_KG_M2[0]}, 0.0, 0.0], [0.0, {INERTIA_KG_M2[1]}, 0.0], [0.0, 0.0, {INERTIA_KG_M2[2]}]]
gravity_m_s2 = [0.0, 0.0, -{GRAVITY_M_S2}]

[rotor_default]
thrust_curve_n_per_rad_s = [0.0, 0.0, {THRUST_N_S2}]
torque_per_thrust_m = {TORQUE_PER_THRUST_M}
time_constant_up_s = {MOTOR_LAG_S}
time_constant_down_s = {MOTOR_LAG_S}
inertia_kg_m2 = 0.0
radius_m = 0.0635

{ROTORS}
[controller.direct]
thrust_min_n = 0.09
thrust_max_n = 5.5

[rates]
state_hz = 100
attitude_hz = 500
body_rate_hz = 500
force_torque_hz = 500
"""


def scene(mass=1.0, density=0.0, gains=(1.0, 1.0, 1.0, 1.0), load_kg=0.0, imu_m="0 0 0"):
    """The vehicle as MuJoCo knows it; `load_kg` hangs 0.7 m below on a ball joint, the accelerometer sits at `imu_m`."""
    sites = "".join(f'<site name="m{i}" pos="{x} {y} 0"/>' for i, (x, y) in enumerate(PLACES_M))
    motors = "".join(
        f'<motor site="m{i}" gear="0 0 {gain} 0 0 {spin * TORQUE_PER_THRUST_M}"/>'
        for i, (gain, spin) in enumerate(zip(gains, SPINS, strict=True))
    )
    load = (
        '<body pos="0 0 -0.02"><joint type="ball" damping="0.0005"/><geom type="sphere" size="0.02" '
        f'pos="0 0 -0.7" mass="{load_kg}" contype="0" conaffinity="0"/></body>'
        if load_kg
        else ""
    )
    inertia = " ".join(str(i) for i in INERTIA_KG_M2)
    return (
        f'<mujoco><option timestep="{STEP_S}" integrator="RK4" gravity="0 0 -{GRAVITY_M_S2}" density="{density}"/>'
        '<worldbody><body name="quad" pos="0 0 5"><freejoint/>'
        f'<inertial pos="0 0 0" mass="{MASS_KG * mass}" diaginertia="{inertia}"/><site name="imu" pos="{imu_m}"/>{sites}{load}</body>'
        f"</worldbody><actuator>{motors}</actuator>"
        '<sensor><accelerometer site="imu"/></sensor></mujoco>'
    )


class Path4:
    """Places and yaw over time: sums of sines, which begin within three seconds. Rows x, y, z, yaw; value, slope, bend."""

    def __init__(self, seed):
        draws = np.random.default_rng(seed)
        self.turns = 2 * np.pi * np.array([0.09, 0.17, 0.29, 0.43]) * (1 + 0.1 * draws.uniform(-1, 1, (4, 4)))
        self.sizes = np.array([0.7, 0.5, 0.35, 0.18]) * np.array([1.0, 1.0, 0.6, 1.1])[:, None]
        self.phases = draws.uniform(0, 2 * np.pi, (4, 4))

    def __call__(self, t):
        at, begun = self.turns * t + self.phases, min(1.0, t / 3)
        rows = [np.sin(at), self.turns * np.cos(at), -(self.turns**2) * np.sin(at)]
        out = begun * np.stack([(self.sizes * r).sum(1) for r in rows], axis=1)
        out[2, 0] += 5.0
        return out


def turned(quat):
    """Rotation matrix of a quaternion x, y, z, w."""
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, np.roll(quat, 1))
    return out.reshape(3, 3)


MIX = np.linalg.inv(np.array([np.ones(4), PLACES_M[:, 1], -PLACES_M[:, 0], SPINS * TORQUE_PER_THRUST_M]))


def commands(ref, pos, vel, quat, ang_vel, sums):
    """Rotor speeds (rad/s) of a cascade over position, attitude and rate; `sums` are its integrals, kept between calls."""
    off = ref[:3, 0] - pos
    sums[0] = np.clip(sums[0] + 0.002 * off, -2, 2)
    acc = np.clip(4.5 * off + 3.6 * (ref[:3, 1] - vel) + 1.2 * sums[0] + ref[:3, 2], -7, 7)
    push = MASS_KG * (acc + [0, 0, GRAVITY_M_S2])
    body = turned(quat)
    up = push / np.linalg.norm(push)
    left = np.cross(up, [np.cos(ref[3, 0]), np.sin(ref[3, 0]), 0])
    left /= np.linalg.norm(left)
    wanted = np.stack([np.cross(left, up), left, up], axis=1)
    lean = 0.5 * (wanted.T @ body - body.T @ wanted)
    lean = np.array([lean[2, 1], lean[0, 2], lean[1, 0]])
    rate = np.clip(-np.array([9, 9, 4]) * lean, -8, 8) + [0, 0, ref[3, 1]] - ang_vel
    sums[1] = np.clip(sums[1] + 0.002 * rate, -1, 1)
    torque = INERTIA_KG_M2 * (np.array([22, 22, 9]) * rate + np.array([15, 15, 6]) * sums[1])
    thrusts = MIX @ np.r_[max(push @ body[:, 2], 1.5), torque]
    return np.sqrt(np.clip(thrusts, 0.15, 4.2) / THRUST_N_S2)


COLUMNS = {"gyro": slice(8, 11), "accel": slice(11, 14), "rotor": slice(14, 18)}


def flown(folder, seed, friction_n=0.0, late_rows=None, drag=None, **hidden):
    """A flight with something hidden, as a log with noise of a motion capture and of a small inertial unit.

    `friction_n` is dry friction along each axis of the world; `late_rows` says by how many rows of 2 ms late
    the channels of `COLUMNS` are written; `drag` is its size, N·s/m, and how far above the centre of mass it acts, m.
    """
    model = mujoco.MjModel.from_xml_string(scene(**hidden))
    model.dof_frictionloss[:3] = friction_n
    data = mujoco.MjData(model)
    path, noise = Path4(seed), np.random.default_rng(seed + 1000)
    data.qpos[:3] = path(0.0)[:3, 0]
    speed = np.full(4, np.sqrt(MASS_KG * GRAVITY_M_S2 / 4 / THRUST_N_S2))
    sent, sums, rows = speed.copy(), [np.zeros(3), np.zeros(3)], []
    half, whole = np.exp(-0.5 * STEP_S / MOTOR_LAG_S), np.exp(-STEP_S / MOTOR_LAG_S)
    for i in range(round(SECONDS / STEP_S)):
        if i % 2 == 0:
            pos, quat = data.qpos[:3].copy(), np.roll(data.qpos[3:7], -1)
            vel, ang_vel = data.qvel[:3].copy(), data.qvel[3:6].copy()
            sent = commands(path(i * STEP_S), pos, vel, quat, ang_vel, sums)
            data.ctrl[:] = THRUST_N_S2 * speed**2
            mujoco.mj_forward(model, data)
            turn, shown = np.zeros(4), np.zeros(4)
            mujoco.mju_axisAngle2Quat(turn, *_axis_angle(noise.normal(0, np.deg2rad(0.2), 3)))
            mujoco.mju_mulQuat(shown, np.roll(quat, 1), turn)
            rows.append(
                np.r_[
                    i * STEP_S,
                    pos + noise.normal(0, 3e-4, 3),
                    np.roll(shown, -1),
                    ang_vel + noise.normal(0, 0.01, 3),
                    data.sensordata[:3] + noise.normal(0, 0.1, 3),
                    speed + noise.normal(0, 2.0, 4),
                    sent,
                ]
            )
        if drag:
            turn = turned(np.roll(data.qpos[3:7], -1))
            pull = -drag[0] * data.qvel[:3]
            data.xfrc_applied[1] = np.r_[pull, np.cross(turn @ [0, 0, drag[1]], pull)]
        # The motors follow within the step; the step sees them in its middle.
        data.ctrl[:] = THRUST_N_S2 * (sent + (speed - sent) * half) ** 2
        mujoco.mj_step(model, data)
        speed = sent + (speed - sent) * whole
    table = np.array(rows)
    for channel, late in (late_rows or {}).items():
        table[late:, COLUMNS[channel]] = table[:-late, COLUMNS[channel]].copy()
    file = Path(folder) / "flight.csv"
    names = "t px py pz qx qy qz qw wx wy wz ax ay az rotor1 rotor2 rotor3 rotor4".split()
    names += [f"cmd_rotor{i}" for i in range(1, 5)]
    with file.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(names)
        writer.writerows([f"{x:.9g}" for x in row] for row in table)
    return file


def _axis_angle(turn):
    angle = float(np.linalg.norm(turn))
    return turn / angle, angle


def diagnosed(folder, seed, drive=None, **hidden):
    vehicle = Path(folder) / "quad.toml"
    vehicle.write_text(VEHICLE)
    return propwash.diagnose([flown(folder, seed, **hidden)], vehicle=str(vehicle), drive=drive)


def test_with_nothing_hidden_nothing_is_missing(tmp_path):
    d = diagnosed(tmp_path, 7)
    assert not d.findings and d.verdict.startswith("nothing is missing"), d.verdict


def test_eight_per_cent_more_mass_are_found_and_written(tmp_path):
    d = diagnosed(tmp_path, 11, mass=1.08)
    (found,) = d.findings
    assert found.id == "wrong_mass", d.text
    (factor,) = found.parameters
    assert abs(factor.value - 1.08) < 2 * factor.sigma < 0.04, factor
    assert found.doubt is None and d.completed is not None, d.text


def test_a_drag_along_each_axis_is_found_as_such(tmp_path):
    density = 12.0
    d = diagnosed(tmp_path, 13, density=density)
    # MuJoCo's drag is that of a box with the body's inertia: half of density times area times the square of the speed, each axis by itself
    # (its documentation, "Inertia-based model").
    sides = np.sqrt(6 / MASS_KG * (INERTIA_KG_M2.sum() - 2 * INERTIA_KG_M2))
    areas = np.array([sides[1] * sides[2], sides[0] * sides[2], sides[0] * sides[1]])
    truth = {"x and y": -0.5 * density * areas[:2].mean(), "z": -0.5 * density * areas[2]}
    assert not d.unexplained and len(d.findings) == 2, d.text
    for f in d.findings:
        assert "v · |v along the axis|" in f.title and f.certain and f.doubt is None, d.text
        (c,) = f.parameters
        (known,) = [v for axes, v in truth.items() if f.title.startswith(f"force along body {axes} =")]
        assert abs(c.value - known) < 2.5 * c.sigma < 0.12 * abs(known), (f, known)


def test_a_drag_above_the_centre_of_mass_is_not_taken_for_flapping_blades(tmp_path):
    size, above = 0.2, 0.02
    d = diagnosed(tmp_path, 37, drag=(size, above))
    # Its torque goes with the speed, that of blades also with the speed of their rotors, which varies by a tenth.
    assert not d.unexplained and len(d.findings) == 2, d.text
    (torque,) = [f for f in d.findings if "e_z × v" in f.title]
    (drag,) = [f for f in d.findings if f.id == "linear_drag"]
    assert torque.title.startswith("torque about body x and y") and torque.certain and drag.certain, d.text
    (c,) = torque.parameters
    assert abs(c.value + size * above) < 2.5 * c.sigma < 0.2 * size * above, c
    for c in drag.parameters:
        assert abs(c.value - size) < 2.5 * c.sigma < 0.3 * size, c


def test_dry_friction_along_axes_of_the_world_is_named_as_such(tmp_path):
    d = diagnosed(tmp_path, 17, friction_n=0.18)
    assert not d.unexplained and d.headline.startswith("missing: force along world x, y and z"), d.headline
    # MuJoCo's friction is a soft constraint, which leads the velocity by 9 ms: the accelerometer's clock is named beside it, in doubt.
    (found,) = [f for f in d.findings if f.certain]
    assert "sign(v)" in found.title and found.doubt is None, d.text
    (c,) = found.parameters
    assert abs(c.value + 0.18) < 0.006 and c.sigma < 0.01, c
    h = found.held_out
    assert h["with"] < 0.3 * h["without"], h


def test_an_accelerometer_beside_the_centre_of_mass_is_found_and_leaves_nothing_where_it_is_filed(tmp_path):
    vehicle = tmp_path / "quad.toml"
    log = flown(tmp_path, 19, imu_m="0.02 -0.012 0")
    vehicle.write_text(VEHICLE)
    d = propwash.diagnose([log], vehicle=str(vehicle))
    (found,) = d.findings
    assert found.id == "sensor_offset.imu", d.text
    for c, true in zip(found.parameters, (0.02, -0.012, 0.0), strict=True):
        assert abs(c.value - true) < 2.5 * c.sigma and c.sigma < 0.002, d.text
    filed = '\n[[effect]]\nkind = "sensor_offset"\nimu_position_m = [0.02, -0.012, 0.0]\n'
    vehicle.write_text(VEHICLE + filed)
    d = propwash.diagnose([log], vehicle=str(vehicle))
    assert not d.findings and d.verdict.startswith("nothing is missing"), d.text


def test_rotor_speeds_that_are_late_are_said_to_be_and_can_be_filed(tmp_path):
    d = diagnosed(tmp_path, 23, drive="rotor_speeds", late_rows={"rotor": 15})
    (said,) = [w for w in d.warnings if "later than all sensors" in w]
    late_ms = float(said.split("come ")[1].split()[0])
    assert abs(late_ms - 30.0) < 3.0, said
    assert not d.findings, d.text
    # Commands keep the log's time whatever the clock of the rotor speeds.
    vehicle = tmp_path / "quad.toml"
    vehicle.write_text(VEHICLE + '\n[[effect]]\nkind = "clock_offset"\ninputs_s = 0.03\n')
    for drive in ("rotor_speeds", "rotor_commands"):
        d = propwash.diagnose([tmp_path / "flight.csv"], vehicle=str(vehicle), drive=drive)
        assert not d.findings and not any("than all sensors" in w for w in d.warnings), d.text
        assert propwash.compare([tmp_path / "flight.csv"], vehicle=str(vehicle), drive=drive).agrees, drive


def test_one_sensor_that_is_late_beside_the_others_is_no_tolerance_of_the_rotor_speeds(tmp_path):
    d = diagnosed(tmp_path, 29, drive="rotor_speeds", late_rows={"gyro": 12})
    (found,) = d.findings
    (late,) = found.parameters
    assert found.id == "clock_offset.gyro" and abs(late.value - 0.024) < 0.004, d.text


def test_a_late_inertial_unit_is_named_beside_early_poses(tmp_path):
    d = diagnosed(tmp_path, 31, drive="rotor_speeds", late_rows={"gyro": 6, "accel": 6})
    ids = {f.id for f in d.findings}
    pair = ("clock_offset.gyro", "clock_offset.accel")
    assert ids == set(pair) or (ids == {"clock_offset.pose"} and pair in d.findings[0].look_alikes), d.text


def test_a_load_that_nobody_tracked_makes_nothing_up(tmp_path):
    d = diagnosed(tmp_path, 68, load_kg=0.06)
    assert d.headline.startswith(("in doubt", "unexplained")), d.headline
    # The mass is what it was, and no force of several times the load makes up for another.
    assert not any(f.certain or f.id == "wrong_mass" or "found" in f.id for f in d.findings), d.text
