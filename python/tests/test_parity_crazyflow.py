"""propwash.Sim and crazyflow.sim.Sim side by side: the same calls, the same commands, the same flights in float64."""

import os

import numpy as np
import pytest

import propwash

os.environ.setdefault("JAX_PLATFORMS", "cpu")
if os.environ.get("PROPWASH_REQUIRE_PEERS") != "1":
    pytest.importorskip("crazyflow")

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

import crazyflow.sim  # noqa: E402

WORLDS, STEPS = 3, 500
SAME_PLACE_M = 1e-9
RPM = 2.0 * np.pi / 60.0
VEHICLE = "cf2x_L250"
# Place of `attitude_ticked` in what the controllers remember: before force and torque, waiting and in force, and four rotor speeds
# (crates/physics/src/controllers/mod.rs).
ATTITUDE_TICKED = -1 - 4 - 4 - 4


def waves(width, seed):
    """Smooth signals between -1 and 1, (STEPS, WORLDS, 1, width)."""
    rng = np.random.default_rng(seed)
    t = np.arange(STEPS)[:, None, None, None] / 500.0
    rate, phase = rng.uniform(2.0, 6.0, (1, WORLDS, 1, width)), rng.uniform(0.0, 6.28, (1, WORLDS, 1, width))
    return np.sin(rate * t + phase)


def commands(control, weight):
    """Commands that keep the vehicle in the air, (STEPS, WORLDS, 1, width)."""
    if control == "state":
        command = np.zeros((STEPS, WORLDS, 1, 16))
        command[..., :3] = 0.1 * waves(3, 1) + [0.0, 0.0, 20.0]
        command[..., 12] = 1.0
        return command
    thrust = weight * (1.05 + 0.1 * waves(1, 2))
    return np.concatenate([waves(3, 3) * {"attitude": 0.2, "body_rate": 1.0}[control], thrust], axis=-1)


def fly_theirs(control, command, rpm):
    """Positions (STEPS, WORLDS, 1, 3), and what the stages asked for on the way."""
    sim = crazyflow.sim.Sim(n_worlds=WORLDS, drone=VEHICLE, dynamics="first_principles", control=control)
    states = sim.data.states
    start = states.pos.at[..., 2].set(20.0)
    sim.data = sim.data.replace(states=states.replace(pos=start, rotor_vel=states.rotor_vel.at[...].set(rpm)))
    pos, quat, rotor_command, force_torque = [], [], [], []
    for step in range(STEPS):
        getattr(sim, f"{control}_control")(jax.numpy.asarray(command[step]))
        sim.step()
        pos.append(np.asarray(sim.data.states.pos))
        quat.append(np.asarray(sim.data.states.quat))
        rotor_command.append(np.asarray(sim.data.controls.rotor_vel))
        if sim.data.controls.force_torque is not None:
            force_torque.append(np.asarray(sim.data.controls.force_torque.cmd))
    assert pos[0].dtype == np.float64
    return np.array(pos), np.array(quat), np.array(rotor_command), np.array(force_torque)


def fly_ours(control, command, rpm):
    sim = propwash.Sim(n_worlds=WORLDS, drone=VEHICLE, control=control, precision="f64", rotor_start="off")
    sim.set_initial(pos=[0.0, 0.0, 20.0])
    sim.reset()
    sim.data.rotor_vel[...] = rpm * RPM
    # Crazyflow's first tick of the attitude stage differs from rates of zero; ours has no derivative unless it "has ticked".
    if control in ("state", "attitude", "body_rate"):
        sim.data.controller_memory[..., ATTITUDE_TICKED] = 1.0
    pos, quat = [], []
    for step in range(STEPS):
        getattr(sim, f"{control}_control")(command[step])
        sim.step()
        pos.append(sim.data.pos.copy())
        quat.append(sim.data.quat.copy())
    return np.array(pos), np.array(quat)


@pytest.fixture(scope="module")
def start():
    """Weight, N, and nine tenths of the rotor speed that carries it, rpm."""
    sim = propwash.Sim(drone=VEHICLE, precision="f64")
    return sim.hover_thrust()[0, 0], 0.9 * sim.hover_rotor_vel()[0, 0, 0] / RPM


@pytest.fixture(scope="module")
def attitude_flight(start):
    return fly_theirs("attitude", commands("attitude", start[0]), start[1])


@pytest.mark.parametrize("control", ["state", "attitude", "body_rate", "force_torque", "rotor_vel"])
def test_flights_are_the_same_in_every_mode(control, start, attitude_flight):
    weight, rpm = start
    # Forces and rotor speeds without feedback tumble: those of the attitude flight are played again.
    if control == "force_torque":
        theirs_command = ours_command = attitude_flight[3]
    elif control == "rotor_vel":
        theirs_command, ours_command = attitude_flight[2], attitude_flight[2] * RPM
    else:
        theirs_command = ours_command = commands(control, weight)
    theirs = attitude_flight if control == "attitude" else fly_theirs(control, theirs_command, rpm)
    pos, quat = fly_ours(control, ours_command, rpm)
    apart = np.abs(pos - theirs[0]).max()
    turned = np.abs(np.abs(np.sum(quat * theirs[1], axis=-1)) - 1.0).max()
    moved = np.ptp(pos, axis=0).max()
    assert moved > 0.05, moved
    assert apart < SAME_PLACE_M and turned < SAME_PLACE_M, (apart, turned)
    note = os.environ.get("PROPWASH_COMPARISONS")
    if note:
        with open(note, "a", encoding="utf-8") as f:
            f.write(f"propwash.Sim vs crazyflow.sim.Sim, {control}, float64: {STEPS} steps, worst {apart:.0e} m apart\n")
