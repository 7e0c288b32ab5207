"""A flight of Crazyflow's own simulation, and Crazyflow's own identification of it, for benches/identify.rs.

Usage: python benches/peers/identify.py make OUT.csv TRUTH.json [HOLD_S]    flies 60 s; writes the log and the true parameters
       python benches/peers/identify.py fit LOG.csv MASS_KG                  identifies; prints one line of JSON

HOLD_S is the time between steps of roll, 4.31 unless given; steps of pitch are 0.26 s longer.

The log is in the columns of docs/logs.md, without noise. `fit` takes the steps of Crazyflow's page on system identification
in their order, with all its settings as they are: preprocessing, derivatives_svf, sys_id_translation, sys_id_rotation. Its time
is that of these four calls, compilation by JAX included; importing and reading the log are not. JAX counts in single
precision unless JAX_ENABLE_X64=1 is set.
"""

import json
import os
import sys
import time
import types
import warnings
from importlib import metadata, util

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("SCIPY_ARRAY_API", "1")  # Crazyflow asks for it
warnings.filterwarnings("ignore")

import numpy as np

VEHICLE = "cf2x_L250"
DYNAMICS = "so_rpy_rotor_drag"
SECONDS = 60
SIM_HZ = 1000
LOG_HZ = 200
# Crazyflow's fit assumes level hover at the start.
HOVER_S = 1.0
START_M = (0.0, 0.0, 2.0)
COLUMNS = "t px py pz qx qy qz qw vx vy vz wx wy wz cmd_roll cmd_pitch cmd_yaw cmd_thrust".split()


def make(log: str, truth: str, hold_s: float) -> None:
    """Flies, in double precision; each command holds from its row to the next."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    from crazyflow.dynamics.core import load_params
    from crazyflow.sim import Sim
    from crazyflow.sim.functional import attitude_control
    from crazyflow.sim.integration import Integrator
    from crazyflow.sim.sim import rotor_vel_limits
    from jax.scipy.spatial.transform import Rotation

    params = {name: np.asarray(value, dtype=float) for name, value in load_params(DYNAMICS, VEHICLE).items()}
    mass, scale = float(params["mass"]), float(params["cmd_f_coef"])
    weight = mass * -float(params["gravity_vec"][2])
    hover = (weight - float(params["acc_coef"])) / scale
    least, most = rotor_vel_limits(DYNAMICS, VEHICLE)

    sim = Sim(
        drone=VEHICLE, dynamics=DYNAMICS, control="attitude", integrator=Integrator.rk4, freq=SIM_HZ, attitude_freq=LOG_HZ
    )
    step = sim.build_step_fn()
    states = sim.data.states
    pos = jnp.broadcast_to(jnp.asarray(START_M), states.pos.shape)
    states = states.replace(pos=pos, rotor_vel=jnp.full_like(states.rotor_vel, hover))
    data = sim.data.replace(states=states)

    def waves(t, rates, phase):
        """A multi-sine between -1 and 1; `rates` in rad/s."""
        return sum(jnp.sin(w * t + phase + 1.9 * i) for i, w in enumerate(rates)) / len(rates)

    def steps(t, hold_s, phase_s):
        """A square wave between -1 and 1."""
        return jnp.where(jnp.mod((t + phase_s) / hold_s, 2.0) < 1.0, 1.0, -1.0)

    def command(t, pos, quat, vel):
        """Excites all axes and pulls gently towards the start; level hover before HOVER_S."""
        yaw = Rotation.from_quat(quat).as_euler("xyz")[2]
        away = pos - jnp.asarray(START_M)
        back = -0.10 * away - 0.12 * vel
        ahead = jnp.cos(yaw) * back[0] + jnp.sin(yaw) * back[1]
        left = -jnp.sin(yaw) * back[0] + jnp.cos(yaw) * back[1]
        roll = 0.20 * waves(t, (1.2, 4.3, 8.1, 13.5), 0.4) + 0.18 * steps(t, hold_s, 0.3) - left
        pitch = 0.20 * waves(t, (1.0, 3.9, 8.8, 12.6), 1.2) + 0.18 * steps(t, hold_s + 0.26, 0.8) + ahead
        turn = 0.45 * waves(t, (0.8, 2.5, 6.1, 10.2), 2.1) + 0.30 * steps(t, 2.17, 0.5)
        climb = 1.0 + 0.12 * waves(t, (1.9, 5.5, 9.4, 14.6), 0.6) + 0.13 * steps(t, 0.89, 0.2)
        climb = climb - 0.5 * away[2] - 0.35 * vel[2]
        lift = jnp.clip(hover * climb, 1.05 * least, 0.98 * most)
        excited = jnp.stack([jnp.clip(roll, -0.6, 0.6), jnp.clip(pitch, -0.6, 0.6), turn, lift])
        return jnp.where(t < HOVER_S, jnp.asarray([0.0, 0.0, 0.0, hover]), excited)

    def row(data, t):
        s = data.states
        now = [x[0, 0] for x in (s.pos, s.quat, s.vel, s.ang_vel)]
        cmd = command(t, now[0], now[1], now[2])
        data = step(attitude_control(data, cmd[None, None]), SIM_HZ // LOG_HZ)
        return data, jnp.concatenate([t[None], *now, cmd])

    _, table = jax.lax.scan(row, data, jnp.arange(SECONDS * LOG_HZ) / LOG_HZ)
    table = np.asarray(table)
    np.savetxt(log, table, fmt="%.17g", delimiter=",", header=",".join(COLUMNS), comments="")
    told = {name: value.tolist() for name, value in params.items()}
    told["fastest_m_s"] = float(np.linalg.norm(table[:, 8:11], axis=1).max())
    told["farthest_m"] = float(np.linalg.norm(table[:, 1:4] - START_M, axis=1).max())
    with open(truth, "w") as file:
        json.dump(told, file)


def fit(log: str, mass_kg: str) -> None:
    """Identifies and prints parameters, time and versions."""
    if util.find_spec("matplotlib") is None:
        # The module imports it for plots, which are not asked for.
        sys.modules["matplotlib"] = types.ModuleType("matplotlib")
        sys.modules["matplotlib.pyplot"] = types.ModuleType("matplotlib.pyplot")
    import jax
    from crazyflow.dynamics.utils.data_utils import derivatives_svf, preprocessing
    from crazyflow.dynamics.utils.identification import sys_id_rotation, sys_id_translation

    table = np.loadtxt(log, delimiter=",", skiprows=1)
    column = {name: table[:, i].copy() for i, name in enumerate(COLUMNS)}
    data = {
        "time": column["t"],
        "pos": np.stack([column[k] for k in ("px", "py", "pz")], axis=-1),
        "quat": np.stack([column[k] for k in ("qx", "qy", "qz", "qw")], axis=-1),
        "cmd_rpy": np.stack([column[k] for k in ("cmd_roll", "cmd_pitch", "cmd_yaw")], axis=-1),
        "cmd_f": column["cmd_thrust"],
    }
    marks = [time.perf_counter()]
    data = derivatives_svf(preprocessing(data))
    marks.append(time.perf_counter())
    found = sys_id_translation(dynamics=DYNAMICS, mass=float(mass_kg), data=data)
    marks.append(time.perf_counter())
    found |= sys_id_rotation(data=data)
    marks.append(time.perf_counter())
    took = dict(zip(("filter_s", "translation_s", "rotation_s"), np.diff(marks).tolist()))
    told = {name: np.asarray(value, dtype=float).tolist() for name, value in found.items()}
    told |= {"seconds": marks[-1] - marks[0], **took, "double": bool(jax.config.jax_enable_x64)}
    told["versions"] = {name: metadata.version(name) for name in ("crazyflow", "jax", "numpy", "scipy")}
    print(json.dumps(told))


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["make", log, truth, *hold_s] if len(hold_s) < 2:
            make(log, truth, float((hold_s or [4.31])[0]))
        case ["fit", log, mass_kg]:
            fit(log, mass_kg)
        case _:
            sys.exit(__doc__)
