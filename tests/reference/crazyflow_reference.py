"""Writes what Crazyflow 0.4.0 computes in float64, for tests/parity_crazyflow.rs to compare with.

Usage: python crazyflow_reference.py OUT_DIR

    versions.json      versions, sha256 of this script
    params.json        every parameter used, per vehicle: dynamics and controller
    derivatives.npz    random states and their time derivatives, per vehicle and dynamics
    near_vertical.npz  derivatives of the so_rpy dynamics as pitch approaches 90 degrees
    stages.npz         random inputs and outputs of every controller stage, per vehicle
    runs.json          list of the simulation runs
    runs.npz           commands and states of these runs

Arrays are named VEHICLE.DYNAMICS.QUANTITY, VEHICLE.STAGE.QUANTITY, RUN.QUANTITY. Units are Crazyflow's: SI, but rotor
speeds in rpm.
"""

import hashlib
import json
import logging
import os
import sys
import time
import warnings
import zlib
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
warnings.filterwarnings("ignore")
logging.disable(logging.WARNING)

import jax

jax.config.update("jax_enable_x64", True)

import crazyflow
import crazyflow.sim.functional as functional
import numpy as np
import scipy
from crazyflow.control.core import load_params as load_control_params
from crazyflow.control.core import parametrize as parametrize_control
from crazyflow.control.mellinger import control as mellinger
from crazyflow.dynamics import first_principles, so_rpy, so_rpy_rotor, so_rpy_rotor_drag
from crazyflow.dynamics.core import load_params as load_dynamics_params
from crazyflow.dynamics.core import parametrize as parametrize_dynamics
from crazyflow.sim import Sim
from crazyflow.sim.sim import rotor_vel_limits
from scipy.spatial.transform import Rotation as R

VEHICLES = ("cf2x_L250", "cf2x_P250", "cf2x_T350", "cf21B_500", "hb_x500")
DYNAMICS = {
    "first_principles": first_principles.dynamics,
    "so_rpy": so_rpy.dynamics,
    "so_rpy_rotor": so_rpy_rotor.dynamics,
    "so_rpy_rotor_drag": so_rpy_rotor_drag.dynamics,
}
N_STATES = 1200
N_STAGE_INPUTS = 3000
N_WORLDS = 4
N_STEPS = 1000
STRIDE = 10
GRAVITY = 9.81
SETTERS = {
    "state": functional.state_control,
    "attitude": functional.attitude_control,
    "body_rate": functional.body_rate_control,
    "force_torque": functional.force_torque_control,
    "rotor_vel": functional.rotor_vel_control,
}


def rng_for(*names):
    """A random generator of its own for every data set, the same in every run of this script."""
    return np.random.default_rng(zlib.crc32("/".join(names).encode()))


def has(vehicle, dynamics):
    try:
        load_dynamics_params(dynamics, vehicle)
    except KeyError:
        return False
    return True


def listed(params):
    return {k: np.asarray(v).tolist() for k, v in params.items()}


def write_params(out):
    table = {}
    for vehicle in VEHICLES:
        controller = load_control_params("mellinger", vehicle)
        table[vehicle] = {
            "controller": {section: listed(values) for section, values in controller.items()},
            "dynamics": {d: listed(load_dynamics_params(d, vehicle)) for d in DYNAMICS if has(vehicle, d)},
            "command_limits": {d: rotor_vel_limits(d, vehicle) for d in DYNAMICS if has(vehicle, d)},
        }
    (out / "params.json").write_text(json.dumps(table, indent=1, sort_keys=True))


def random_quats(rng, n):
    q = rng.normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def disturbances(rng, n, params):
    weight = float(params["mass"]) * GRAVITY
    force = rng.normal(size=(n, 3)) * 0.3 * weight
    torque = rng.normal(size=(n, 3)) * np.diag(params["J"]) * 20.0
    return force, torque


def write_derivatives(out):
    arrays = {}
    for vehicle in VEHICLES:
        for name, fn in DYNAMICS.items():
            if not has(vehicle, name):
                continue
            rng = rng_for("derivatives", vehicle, name)
            params = load_dynamics_params(name, vehicle)
            n = N_STATES
            quat = random_quats(rng, n)
            vel = rng.uniform(-5, 5, (n, 3))
            ang_vel = rng.uniform(-10, 10, (n, 3))
            vel[::50] = 0.0
            ang_vel[::50] = 0.0
            dist_f, dist_t = disturbances(rng, n, params)
            kwargs = {}
            if name == "first_principles":
                _, top = rotor_vel_limits(name, vehicle)
                rotor_vel = rng.uniform(0.0, 1.1 * top, (n, 4))
                cmd = rng.uniform(0.0, top, (n, 4))
                rotor_vel[::20] = 0.0
                cmd[10::20] = 0.0
                cmd[5::20] = rotor_vel[5::20]
            else:
                low, top = rotor_vel_limits(name, vehicle)
                cmd = np.concatenate([rng.uniform(-1.5, 1.5, (n, 3)), rng.uniform(low, top, (n, 1))], axis=-1)
                rotor_vel = np.repeat(rng.uniform(0.0, top, (n, 1)), 4, axis=-1)
            if name != "so_rpy":
                kwargs["rotor_vel"] = rotor_vel
            result = parametrize_dynamics(fn, vehicle)(
                pos=np.zeros((n, 3)), quat=quat, vel=vel, ang_vel=ang_vel, cmd=cmd, dist_f=dist_f, dist_t=dist_t, **kwargs
            )
            _, _, acc, ang_acc = result[:4]
            rotor_acc = result[4] if len(result) > 4 else np.zeros((n, 4))
            assert acc.dtype == ang_acc.dtype == rotor_acc.dtype == np.float64
            pitch = R.from_quat(quat).as_euler("xyz")[:, 1]
            key = f"{vehicle}.{name}."
            arrays |= {
                key + k: np.asarray(v)
                for k, v in dict(
                    quat=quat, vel=vel, ang_vel=ang_vel, rotor_vel=rotor_vel, cmd=cmd, dist_f=dist_f, dist_t=dist_t,
                    pitch=pitch, acc=acc, ang_acc=ang_acc, rotor_acc=rotor_acc,
                ).items()
            }
    np.savez(out / "derivatives.npz", **arrays)


def write_near_vertical(out):
    """Derivatives at pitches from 85 degrees to 1e-4 degrees short of 90, nose up and nose down."""
    arrays = {}
    gap = np.logspace(np.log10(5.0), -4, 100)
    for vehicle in VEHICLES:
        for name in ("so_rpy", "so_rpy_rotor", "so_rpy_rotor_drag"):
            rng = rng_for("near vertical", vehicle, name)
            n = 2 * len(gap)
            sign = np.repeat([1.0, -1.0], len(gap))
            gaps = np.tile(gap, 2)
            rpy = np.stack([rng.uniform(-2, 2, n), sign * np.deg2rad(90 - gaps), rng.uniform(-2, 2, n)], axis=-1)
            quat = R.from_euler("xyz", rpy).as_quat()
            vel = rng.uniform(-5, 5, (n, 3))
            ang_vel = np.ones((n, 3))
            _, top = rotor_vel_limits(name, vehicle)
            cmd = np.tile([0.1, 0.2, 0.3, 0.5 * top], (n, 1))
            rotor_vel = np.full((n, 4), 0.5 * top)
            kwargs = {} if name == "so_rpy" else {"rotor_vel": rotor_vel}
            result = parametrize_dynamics(DYNAMICS[name], vehicle)(
                pos=np.zeros((n, 3)), quat=quat, vel=vel, ang_vel=ang_vel, cmd=cmd, **kwargs
            )
            arrays |= {
                f"{vehicle}.{name}.{k}": v
                for k, v in dict(
                    gap_deg=gaps, quat=quat, vel=vel, ang_vel=ang_vel, cmd=cmd, rotor_vel=rotor_vel,
                    acc=result[2], ang_acc=result[3],
                ).items()
            }
    np.savez(out / "near_vertical.npz", **arrays)


def mixed(rng, shape, calm, wild):
    """Normal deviates, the first half of the rows calm, the second half wild."""
    scale = np.where(np.arange(shape[0])[:, None] < shape[0] // 2, calm, wild)
    return rng.normal(size=shape) * scale


def write_stages(out):
    arrays = {}
    n = N_STAGE_INPUTS

    def put(vehicle, stage, **quantities):
        for k, v in quantities.items():
            v = np.asarray(v)
            assert v.dtype == np.float64 and len(v) == n, (vehicle, stage, k, v.dtype, v.shape)
            assert np.isfinite(v).all(), (vehicle, stage, k)
            arrays[f"{vehicle}.{stage}.{k}"] = v

    for vehicle in VEHICLES:
        controller = load_control_params("mellinger", vehicle)
        core = controller["core"]
        thrust_max = float(core["thrust_max"])
        all_max = 4 * thrust_max
        rng = rng_for("stages", vehicle)

        # State: positions near the set-point, so that the wanted thrust mostly points up; a share upside down.
        int_max = np.asarray(controller["state2attitude"]["int_err_max"])
        rotvec = mixed(rng, (n, 3), 0.2, 1.0)
        quat = R.from_rotvec(rotvec).as_quat()
        pos = rng.uniform(-3, 3, (n, 3))
        vel = rng.uniform(-3, 3, (n, 3))
        cmd = np.concatenate(
            [
                pos + mixed(rng, (n, 3), 0.05, 0.3),
                vel + mixed(rng, (n, 3), 0.1, 0.5),
                mixed(rng, (n, 3), 1.0, 4.0),
                random_quats(rng, n),
                rng.uniform(-5, 5, (n, 3)),
            ],
            axis=-1,
        )
        pos_err_i = rng.uniform(-1.2, 1.2, (n, 3)) * int_max
        rpyt, next_i = parametrize_control(mellinger.state2attitude, vehicle)(
            pos, quat, vel, cmd, pos_err_i=pos_err_i, ctrl_freq=100
        )
        positive = int((rpyt[:, 3] > 0).sum())
        assert positive >= 1000 and n - positive >= 50, (vehicle, positive)
        put(
            vehicle, "state", quat=quat, pos=pos, vel=vel, cmd=cmd, integral=pos_err_i, out=rpyt, out_integral=next_i
        )

        # Attitude and body rates: half of the inputs within the bounds of the torque, half beyond; 15 % without thrust.
        for stage, section in (
            ("attitude", "attitude2force_torque"),
            ("attitude_with_rates", "attitude2force_torque"),
            ("body_rate", "body_rate2force_torque"),
        ):
            rng = rng_for("stages", vehicle, stage)
            int_max = np.asarray(controller[section]["int_err_max"])
            wanted = rng.uniform(-1.2, 1.2, (n, 3)) * np.array([1.0, 1.0, 2.5])
            if stage == "body_rate":
                wanted[:, :2] = 0.0
            quat = (R.from_euler("xyz", wanted) * R.from_rotvec(mixed(rng, (n, 3), 0.05, 1.0))).as_quat()
            ang_vel = rng.uniform(-10, 10, (n, 3))
            rates = ang_vel + mixed(rng, (n, 3), 0.2, 4.0)
            if stage == "attitude":
                rates = np.zeros((n, 3))
                ang_vel = mixed(rng, (n, 3), 0.2, 5.0)
            prev_ang_vel = ang_vel + mixed(rng, (n, 3), 0.02, 0.5)
            prev_rates = rates + mixed(rng, (n, 3), 0.02, 0.5) * (stage != "attitude")
            integral = rng.uniform(-1.2, 1.2, (n, 3)) * int_max
            thrust = rng.uniform(0.01, 1.1, n) * all_max
            lifeless = rng.permutation(n)[: (15 * n) // 100]
            thrust[lifeless] = -rng.uniform(0.0, 0.5, len(lifeless)) * all_max
            thrust[lifeless[::3]] = 0.0
            if stage == "attitude":
                cmd = np.concatenate([wanted, thrust[:, None]], axis=-1)
                result = parametrize_control(mellinger.attitude2force_torque, vehicle)(
                    quat, ang_vel, cmd, prev_ang_vel=prev_ang_vel, r_int_error=integral, ctrl_freq=500
                )
            elif stage == "attitude_with_rates":
                cmd = np.concatenate([wanted, thrust[:, None]], axis=-1)
                params = parametrize_control(mellinger.attitude2force_torque, vehicle).keywords
                result = mellinger._attitude2force_torque(
                    quat, ang_vel, wanted, rates, thrust, prev_ang_vel, prev_rates, integral, 250, **params
                )
            else:
                cmd = np.concatenate([rates, thrust[:, None]], axis=-1)
                prev_cmd = np.concatenate([prev_rates, thrust[:, None]], axis=-1)
                result = parametrize_control(mellinger.body_rate2force_torque, vehicle)(
                    quat, ang_vel, cmd, prev_ang_vel=prev_ang_vel, prev_cmd=prev_cmd, r_int_error=integral, ctrl_freq=500
                )
            force, torque, next_i = result
            put(
                vehicle, stage, quat=quat, ang_vel=ang_vel, cmd=cmd, rates=rates, prev_rates=prev_rates,
                prev_ang_vel=prev_ang_vel, integral=integral, out=np.concatenate([force, torque], axis=-1),
                out_integral=next_i,
            )

        # Mixer: half within the range of the rotors, half beyond; some with no thrust at all.
        rng = rng_for("stages", vehicle, "force_torque")
        arm = np.array([float(core["L"]), float(core["L"]), float(core["thrust2torque"])])
        force = rng.uniform(-0.2, 1.2, (n, 1)) * all_max
        force[::30] = 0.0
        torque = mixed(rng, (n, 3), 0.1, 1.0) * thrust_max * arm
        rpm = parametrize_control(mellinger.force_torque2rotor_vel, vehicle)(force, torque)
        put(vehicle, "force_torque", cmd=np.concatenate([force, torque], axis=-1), out=rpm)
    np.savez(out / "stages.npz", **arrays)


def sines(rng, t, width, amplitude, low_hz=0.3, high_hz=1.2):
    """Smooth signals (steps, N_WORLDS, width), two sines each; with value, first and second derivative."""
    value, first, second = 0.0, 0.0, 0.0
    for share in (0.7, 0.3):
        w = 2 * np.pi * rng.uniform(low_hz, high_hz, (1, N_WORLDS, width))
        phase = rng.uniform(0, 2 * np.pi, (1, N_WORLDS, width))
        a = share * np.broadcast_to(amplitude, (width,)) * (-1.0) ** rng.integers(0, 2, (1, N_WORLDS, width))
        x = w * t[:, None, None] + phase
        value = value + a * np.sin(x)
        first = first + a * w * np.cos(x)
        second = second - a * w * w * np.sin(x)
    return value, first, second


def commands(rng, vehicle, dynamics, control, freq, steps):
    """Commands (steps, N_WORLDS, width) that keep a vehicle flying near where it starts."""
    t = np.arange(steps) / freq
    weight = float(load_dynamics_params(dynamics, vehicle)["mass"]) * GRAVITY
    big = vehicle == "hb_x500"
    if control == "state":
        pos, vel, acc = sines(rng, t, 3, np.array([0.25, 0.25, 0.1]) * (3.0 if big else 1.0), 0.15, 0.35)
        pos = pos - pos[:1] + np.array([0.0, 0.0, 20.0])
        # Only the yaw of the attitude counts; a little roll and pitch must change nothing.
        rpy = sines(rng, t, 3, np.array([0.2, 0.2, 0.6]), 0.15, 0.35)[0]
        quat = R.from_euler("xyz", rpy.reshape(-1, 3)).as_quat().reshape(steps, N_WORLDS, 4)
        rates = sines(rng, t, 3, 0.3)[0]
        return np.concatenate([pos, vel, acc, quat, rates], axis=-1)
    thrust = weight * (1.05 + sines(rng, t, 1, 0.2)[0])
    if control == "attitude":
        rpy = sines(rng, t, 3, np.array([0.35, 0.35, 1.0]))[0]
        return np.concatenate([rpy, thrust], axis=-1)
    assert control == "body_rate"
    return np.concatenate([sines(rng, t, 3, np.array([1.5, 1.5, 1.0]), 1.0, 2.5)[0], thrust], axis=-1)


def initial_states(rng, vehicle, dynamics, control):
    params = load_dynamics_params(dynamics, vehicle)
    weight = float(params["mass"]) * GRAVITY
    n = N_WORLDS
    pos = np.tile([0.0, 0.0, 20.0], (n, 1)) + rng.uniform(-0.02, 0.02, (n, 3))
    quat = R.from_rotvec(rng.uniform(-0.1, 0.1, (n, 3))).as_quat()
    force, torque = disturbances(rng, n, params)
    # Rotors still in even worlds, as after Crazyflow's reset; at hover in odd ones. Position control of the weakest
    # vehicles does not recover from such a fall (in Crazyflow they tumble), so there the rotors start slow, not still.
    rotor_vel = np.zeros((n, 4))
    if dynamics == "first_principles":
        c, b, a = np.asarray(params["rpm2thrust"])
        rotor_vel[1::2] = (-b + np.sqrt(b * b - 4 * a * (c - weight / 4))) / (2 * a)
    elif dynamics != "so_rpy":
        rotor_vel[1::2] = weight
    if control == "state":
        rotor_vel[::2] = 0.9 * rotor_vel[1::2]
    return dict(
        pos=pos,
        quat=quat,
        vel=rng.uniform(-0.1, 0.1, (n, 3)),
        ang_vel=rng.uniform(-0.2, 0.2, (n, 3)),
        rotor_vel=rotor_vel,
        force=0.05 * force * (np.arange(n) >= 2)[:, None],
        torque=0.01 * torque * (np.arange(n) >= 2)[:, None],
    )


class Flight:
    """One configuration of Crazyflow's simulation, compiled once and flown with any commands."""

    def __init__(self, vehicle, dynamics, control, integrator="euler", freq=500, **rates):
        self.meta = dict(
            vehicle=vehicle, dynamics=dynamics, control=control, integrator=integrator, freq=freq,
            rates=dict(state_freq=100, attitude_freq=500, body_rate_freq=500, force_torque_freq=500) | rates,
        )
        self.sim = Sim(
            n_worlds=N_WORLDS, drone=vehicle, dynamics=dynamics, control=control, integrator=integrator, freq=freq,
            **self.meta["rates"],
        )
        setter = SETTERS[control]
        step = self.sim._step

        @jax.jit
        def fly(data, cmds):
            def one(data, cmd):
                data = step(setter(data, cmd), n_steps=1)
                s, c = data.states, data.controls
                record = dict(pos=s.pos, quat=s.quat, vel=s.vel, ang_vel=s.ang_vel, rotor_vel=s.rotor_vel)
                record["rotor_cmd"] = c.rotor_vel
                if c.attitude is not None:
                    record["attitude_cmd"] = c.attitude.cmd
                    record["attitude_ticked"] = c.attitude.steps == data.core.steps - 1
                if c.force_torque is not None:
                    record["force_torque_cmd"] = c.force_torque.cmd
                return data, record

            return jax.lax.scan(one, data, cmds)[1]

        self.fly = fly

    def __call__(self, cmds, init):
        sim = self.sim
        sim.reset()
        states = sim.data.states.replace(**{k: jax.numpy.asarray(v)[:, None, :] for k, v in init.items()})
        record = self.fly(sim.data.replace(states=states), jax.numpy.asarray(cmds)[:, :, None, :])
        record = {k: np.asarray(v)[:, :, 0] for k, v in record.items()}
        assert record["pos"].dtype == np.float64
        return record


class Runs:
    def __init__(self):
        self.arrays = {}
        self.list = []

    def add(self, name, flight, cmds, init, stride=STRIDE, tame=True):
        record = flight(cmds, init)
        if tame:
            # Inside the region where both simulators must agree: in the air, the fitted dynamics well below 90 degrees of
            # pitch, always some thrust.
            pitch = np.abs(R.from_quat(record["quat"].reshape(-1, 4)).as_euler("xyz")[:, 1]).max()
            assert record["pos"][..., 2].min() > 0.5, (name, record["pos"][..., 2].min())
            assert np.rad2deg(pitch) < 75, (name, np.rad2deg(pitch))
            if "attitude_cmd" in record:
                assert (record["attitude_cmd"][..., 3] > 0).all(), name
        self.list.append(dict(name=name, stride=stride, steps=len(cmds), **flight.meta))
        keep = {"cmd": cmds} | {f"init_{k}": v for k, v in init.items()}
        keep |= {k: record[k][stride - 1 :: stride] for k in ("pos", "quat", "vel", "ang_vel", "rotor_vel")}
        self.arrays |= {f"{name}.{k}": np.asarray(v, dtype=np.float64) for k, v in keep.items()}
        return record

    def write(self, out):
        np.savez(out / "runs.npz", **self.arrays)
        (out / "runs.json").write_text(json.dumps(self.list, indent=1))


def write_runs(out):
    runs = Runs()

    def standard(vehicle, dynamics, control, name=None, freq=500, **kwargs):
        name = name or f"{vehicle}.{dynamics}.{control}"
        rng = rng_for("runs", name)
        flight = Flight(vehicle, dynamics, control, freq=freq, **kwargs)
        cmds = commands(rng, vehicle, dynamics, control, freq, N_STEPS)
        init = initial_states(rng, vehicle, dynamics, control)
        return flight, runs.add(name, flight, cmds, init), init

    for vehicle in VEHICLES:
        for dynamics in DYNAMICS:
            if not has(vehicle, dynamics):
                continue
            standard(vehicle, dynamics, "state")
            flight, _, _ = standard(vehicle, dynamics, "attitude")
            if dynamics == "so_rpy_rotor" and vehicle == "cf2x_L250":
                # No thrust asked for: Crazyflow raises the command to four times the least thrust of a rotor.
                init = initial_states(rng_for("no thrust"), vehicle, dynamics, "attitude")
                init["rotor_vel"] = np.zeros((N_WORLDS, 4))
                runs.add("no_thrust", flight, np.zeros((500, N_WORLDS, 4)), init, tame=False)
            if dynamics != "first_principles":
                continue
            standard(vehicle, dynamics, "body_rate")
            # These two modes have no feedback, so what the attitude controller asked for in another flight is replayed.
            for control, source in (("force_torque", "force_torque_cmd"), ("rotor_vel", "rotor_cmd")):
                rng = rng_for("replay", vehicle, control)
                limits = rotor_vel_limits(dynamics, vehicle)
                init = initial_states(rng, vehicle, dynamics, control)
                cmds = flight(commands(rng, vehicle, dynamics, "attitude", 500, N_STEPS), init)[source].copy()
                # At the end all rotors are asked for more than they can: the limits of the command are part of the run.
                cmds[-50:] = 1.3 * limits[1] if control == "rotor_vel" else [6 * 0.25 * full_thrust(vehicle), 0, 0, 0]
                replay = Flight(vehicle, dynamics, control)
                runs.add(f"{vehicle}.{dynamics}.{control}", replay, cmds, init)
                if control == "rotor_vel" and vehicle == "cf2x_L250":
                    # Motors commanded off: Crazyflow raises the command to the least speed.
                    off = np.zeros((100, N_WORLDS, 4))
                    runs.add("motors_off", replay, off, init | {"rotor_vel": np.zeros((N_WORLDS, 4))}, tame=False)

    # Other integrators, and stages that tick at rates of their own.
    standard("cf21B_500", "first_principles", "state", "symplectic.first_principles", integrator="symplectic_euler")
    standard("cf21B_500", "so_rpy_rotor_drag", "state", "symplectic.so_rpy_rotor_drag", integrator="symplectic_euler")
    standard("cf21B_500", "first_principles", "state", "rk4.first_principles", integrator="rk4")
    standard("hb_x500", "so_rpy_rotor_drag", "state", "rk4.so_rpy_rotor_drag", integrator="rk4")
    standard(
        "cf2x_T350", "first_principles", "state", "staggered.state", freq=1000, state_freq=50, attitude_freq=250,
        force_torque_freq=500,
    )
    standard("cf2x_P250", "first_principles", "body_rate", "staggered.body_rate", body_rate_freq=250, force_torque_freq=125)

    # How often an attitude stage of 400 Hz ticks in a simulation of 500 Hz.
    _, record, _ = standard("cf2x_L250", "first_principles", "attitude", "ticks", attitude_freq=400)
    runs.arrays["ticks.attitude_ticked"] = record["attitude_ticked"][:, 0].astype(np.float64)
    # What attitude command the fitted model answers at every step where the attitude stage has 50 Hz.
    _, record, _ = standard("cf2x_L250", "so_rpy", "attitude", "held", attitude_freq=50)
    runs.arrays["held.attitude_cmd"] = record["attitude_cmd"]
    runs.write(out)


def full_thrust(vehicle):
    """Greatest collective thrust, N."""
    return 4 * float(load_dynamics_params("first_principles", vehicle)["thrust_max"])


def main():
    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    versions = dict(
        crazyflow=crazyflow.__version__,
        jax=jax.__version__,
        numpy=np.__version__,
        scipy=scipy.__version__,
        python=sys.version.split()[0],
        script_sha256=hashlib.sha256(Path(__file__).read_bytes()).hexdigest(),
    )
    for write in (write_params, write_derivatives, write_near_vertical, write_stages, write_runs):
        start = time.time()
        write(out)
        print(f"{write.__name__}: {time.time() - start:.1f} s", flush=True)
    (out / "versions.json").write_text(json.dumps(versions, indent=1))


if __name__ == "__main__":
    main()
