"""Physics of one's own in both simulators: propwash.Sim beside crazyflow.sim.Sim, alternately, in one process on one core.

Usage: python customise.py                  the table of docs/migrate.md; with propwash (release), crazyflow and jax installed
       python customise.py --check          only how far apart both end (float64)
       python customise.py --worlds 1,64 --rounds 5 --seconds 0.2 wind fan

What Crazyflow's examples and guides change in a simulation: a random push in every step, wind, a force of one's own, a controller of one's own,
dynamics of one's own, masses drawn at random. Each is written here for both in the shortest form that it has there, and for Propwash in every form
that it has.

A row with a distance flies the same equations: both end so far apart after 500 steps of 3 worlds in float64. The others differ by what the page says.
Speed is steps of all worlds together per second of the processor (all threads of the process; one core), f32, medians of rounds that take turns:
on a core that others use too, this compares the programs, where the clock on the wall does not. A call makes 500 steps at less than 64 worlds, 100 at more,
after a first one that compiles. No flight lasts longer than 4 s.
"""

import argparse
import logging
import os
import statistics
import time
import warnings
from dataclasses import dataclass

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
os.environ.setdefault("SCIPY_ARRAY_API", "1")  # Crazyflow asks for it
if __name__ == "__main__":  # a test imports this file
    warnings.filterwarnings("ignore")
    logging.disable(logging.WARNING)

import crazyflow
import crazyflow.sim
import jax
import jax.numpy as jnp
import numpy as np
from crazyflow.sim.dynamics import first_principles_dynamics
from crazyflow.sim.integration import euler
from crazyflow.sim.pipeline import append_fn, insert_fn_before, prepend_fn, replace_fn
from crazyflow.utils import leaf_replace
from jax.scipy.spatial.transform import Rotation

import propwash

VEHICLE, RPM = "cf2x_L250", np.pi / 30
CHECKED_WORLDS, CHECKED_STEPS, CHECKED = 3, 500, {"precision": "f64", "compile": "auto"}
MASS, GRAVITY = 0.0328, 9.81


# How both start, and what they are commanded.


def starts(n):
    """Positions and velocities of n worlds, (n, 1, 3): about 3 m up, each another."""
    waves = np.sin(np.arange(6 * n).reshape(n, 1, 6) * 12.9898)
    return [0.0, 0.0, 3.0] + 0.2 * waves[..., :3], 0.2 * waves[..., 3:]


def hover():
    """Rotor speed that carries the vehicle, rad/s."""
    return propwash.Sim(drone=VEHICLE, precision="f64").hover_rotor_vel()[0, 0, 0]


def command_of(control, n):
    """Level flight by attitude, rotor speeds near those of hover; (n, 1, 4), SI."""
    waves = np.sin(np.arange(4 * n).reshape(n, 1, 4) * 78.233)
    if control == "attitude":
        return np.concatenate([0.05 * waves[..., :2], 0 * waves[..., 2:3], MASS * GRAVITY * (1 + 0.02 * waves[..., 3:])], -1)
    return hover() + 0.2 * waves if control == "rotor_vel" else None


def theirs_of(n, control, change=lambda sim: None):
    """Crazyflow's simulation with a change, at the start."""
    sim = crazyflow.sim.Sim(n_worlds=n, drone=VEHICLE, dynamics="first_principles", control=control)
    pos, vel = map(jnp.asarray, starts(n))
    turning = jnp.full((n, 1, 4), hover() / RPM)
    kind = sim.data.states.pos.dtype
    states = sim.data.states.replace(pos=pos.astype(kind), vel=vel.astype(kind), rotor_vel=turning.astype(kind))
    sim.data = sim.data.replace(states=states)
    command = command_of(control, n)
    if control == "attitude":
        sim.attitude_control(jnp.asarray(command, kind))
    elif control == "rotor_vel":
        sim.rotor_vel_control(jnp.asarray(command / RPM, kind))
    sim.build_default_data()  # resets go back to all this, commands too
    change(sim)
    sim.build_step_fn()
    sim.build_reset_fn()
    return sim


def ours_of(n, control, drone=VEHICLE, **options):
    """Ours, at the start; compiled before the first step unless options say otherwise."""
    sim = propwash.Sim(n_worlds=n, drone=drone, control=control, threads=1, **{"compile": "now", **options})
    pos, vel = starts(n)
    sim.set_initial(pos=pos, vel=vel)
    sim.reset()
    return sim


def restarted(sim, control):
    """The simulation at its start, with its commands."""
    sim.reset()
    if isinstance(sim, propwash.Sim):
        sim.data.rotor_vel[...] = hover()  # else that of each world's own mass and rotors
        if control == "attitude":
            sim.attitude_control(command_of(control, sim.n_worlds))
        elif control == "rotor_vel":
            sim.rotor_vel_control(command_of(control, sim.n_worlds))
    return sim


class Between:
    """A function of ``sim.data`` that is called between calls of ``sim.step``, before every ``every`` steps."""

    def __init__(self, sim, function, every=1):
        self.sim, self.function, self.every, self.n_worlds = sim, function, every, sim.n_worlds

    def step(self, steps):
        for _ in range(steps // self.every):
            self.function(self.sim.data)
            self.sim.step(self.every)


def staged(make):
    """A form in which what ``make`` gives, a simulation and a function, is a stage before the integration, or the first one for commands."""

    def form(n, **options):
        sim, function = make(n, **options)
        if sim.control == "force_torque":
            sim.pipeline.prepend("own", function)
        else:
            sim.pipeline.insert_before("integration", "own", function)
        return sim

    return form


def between(make, every=1):
    """A form in which it is called between steps."""
    return lambda n, **options: Between(*make(n, **options), every)


# 1. A random push in every step.


def cf_push(sim):
    def push(data):
        key, a, b = jax.random.split(data.core.rng_key, 3)
        shape = data.states.pos.shape
        force, torque = 0.02 * jax.random.normal(a, shape), 2e-5 * jax.random.normal(b, shape)
        return data.replace(states=data.states.replace(force=force, torque=torque), core=data.core.replace(rng_key=key))

    insert_fn_before(sim.step_pipeline, "integration", push)


def pw_push(n, **options):
    sim, random = ours_of(n, "attitude", **options), np.random.default_rng(0)

    def push(data):
        data.disturbance_force[...] = 0.02 * random.standard_normal(data.pos.shape, np.float32)
        data.disturbance_torque[...] = 2e-5 * random.standard_normal(data.pos.shape, np.float32)

    return sim, push


def pw_push_effect(n, **options):
    @propwash.effect
    def push(s, a=0.0, b=0.0, f=0.0, g=0.0):
        s.force[0] += a * np.sin(7 * s.t + f) + b * np.sin(17 * s.t + g)
        s.force[1] += b * np.sin(11 * s.t + f) + a * np.sin(5 * s.t + g)

    draws = [("a", {"normal": 0.02}), ("b", {"normal": 0.02}), ("f", {"uniform": [0.0, 2 * np.pi]}), ("g", {"uniform": [0.0, 2 * np.pi]})]
    rules = [{"parameter": f"effect.expression.push.{name}", "draw": draw} for name, draw in draws]
    return ours_of(n, "attitude", push.on(VEHICLE), randomization=rules, **options)


def pw_push_drawn(n, **options):
    """The same in every step, by random numbers of the simulation."""

    @propwash.effect
    def push(s, size=0.02):
        s.force += size * s.normal

    return ours_of(n, "attitude", push.on(VEHICLE), **options)


def pw_turbulence(n, **options):
    toml = '[[effect]]\nkind = "turbulence"\nsigma_m_s = [1.0, 1.0, 0.5]\nlength_m = [1.0, 1.0, 1.0]\n'
    return ours_of(n, "attitude", propwash.Vehicle(VEHICLE).with_effects(toml), **options)


# 2. Wind, which moves the vehicle by the drag that it has.


def cf_wind(sim):
    def wind(data):
        speed = 1 + 0.5 * jnp.sin(data.core.steps[..., None] * (2 / data.core.freq))
        air = jnp.concatenate([speed, 0 * speed, 0 * speed], -1)
        turn = Rotation.from_quat(data.states.quat)
        force = -turn.apply((data.params.drag_matrix @ turn.inv().apply(air)[..., None])[..., 0])
        return data.replace(states=data.states.replace(force=force))

    insert_fn_before(sim.step_pipeline, "integration", wind)


def pw_wind_effects(n, **options):
    toml = f"""
    [[effect]]
    kind = "constant_wind"
    velocity_m_s = [1.0, 0.0, 0.0]
    [[effect]]
    kind = "gust"
    sine_m_s = [0.5, 0.0, 0.0]
    cosine_m_s = [0.0, 0.0, 0.0]
    frequency_hz = {1 / np.pi}
    """
    return ours_of(n, "attitude", propwash.Vehicle(VEHICLE).with_effects(toml), **options)


def pw_wind(n, **options):
    sim = ours_of(n, "attitude", **options)

    def wind(data):
        data.wind[..., 0] = 1 + 0.5 * np.sin(2 * data.steps[:, None] / sim.freq)

    return sim, wind


# 3. A force of one's own: the updraught over a fan, and gusts that take the vehicle along.


def cf_fan(sim):
    def fan(data):
        pos, vel = data.states.pos, data.states.vel
        t = data.core.steps[..., None] * (1 / data.core.freq)
        air = 0.015 * (jnp.concatenate([1 + 0.5 * jnp.sin(2 * t), 0 * t, 0 * t], -1) - vel)
        lift = 0.02 * jnp.exp(-(pos[..., 0] ** 2 + pos[..., 1] ** 2) / 0.3)
        return data.replace(states=data.states.replace(force=air.at[..., 2].add(lift)))

    insert_fn_before(sim.step_pipeline, "integration", fan)


def pw_fan_effect(n, **options):
    @propwash.effect
    def fan(s):
        s.force += 0.015 * (np.array([1 + 0.5 * np.sin(2 * s.t), 0, 0]) - s.vel)
        s.force[2] += 0.02 * np.exp(-(s.pos[0] ** 2 + s.pos[1] ** 2) / 0.3)

    return ours_of(n, "attitude", fan.on(VEHICLE), **options)


def pw_fan(n, **options):
    sim = ours_of(n, "attitude", **options)

    def fan(data):
        force, pos = data.disturbance_force, data.pos
        force[...] = -0.015 * data.vel
        force[..., 0] += 0.015 * (1 + 0.5 * np.sin(2 * data.steps[:, None] / sim.freq))
        force[..., 2] += 0.02 * np.exp(-(pos[..., 0] ** 2 + pos[..., 1] ** 2) / 0.3)

    return sim, fan


# 4. A controller of one's own: holds a place by force and torque; motors and mixer are those of the vehicle.

INERTIA = np.array([1.68e-5, 1.68e-5, 2.98e-5])


def law(xp, pos, quat, vel, ang_vel):
    """Thrust and torque, (…, 4), that bring a vehicle to (0, 0, 3), level."""
    wanted = 4 * (xp.asarray([0.0, 0.0, 3.0], pos.dtype) - pos) - 4 * vel
    half = xp.stack([-wanted[..., 1], wanted[..., 0], 0 * wanted[..., 0]], -1) / (2 * GRAVITY)
    torque = INERTIA.astype(pos.dtype) * (800 * (half - quat[..., :3]) - 40 * ang_vel)
    return xp.concatenate([MASS * (GRAVITY + wanted[..., 2:]), torque], -1)


def cf_law(sim):
    def own(data):
        states, stage = data.states, data.controls.force_torque
        command = law(jnp, states.pos, states.quat, states.vel, states.ang_vel)
        return data.replace(controls=data.controls.replace(force_torque=stage.replace(staged_cmd=command)))

    prepend_fn(sim.step_pipeline, own)


def pw_law(n, **options):
    sim = ours_of(n, "force_torque", **options)

    def own(data):
        data.command[...] = law(np, data.pos, data.quat, data.vel, data.ang_vel)

    return sim, own


def pw_law_compiled(n, **options):
    """The law as a controller of the vehicle."""

    @propwash.controller
    def own(s):
        wanted = 4 * (np.array([0.0, 0.0, 3.0]) - s.pos) - 4 * s.vel
        half = np.array([-wanted[1], wanted[0], 0.0], dtype=object) / (2 * GRAVITY)
        s.mix(MASS * (GRAVITY + wanted[2]), INERTIA * (800 * (half - s.quat[:3]) - 40 * s.ang_vel))

    return ours_of(n, "force_torque", own.on(VEHICLE), **options)


def pw_firmware(n, **options):
    """The law of the firmware, with gains of one's own."""
    sim = ours_of(n, "state", **options)
    sim.set_parameter("controller.state.kp.2", 1.0)
    sim.state_control(propwash.Command.hover(np.tile([0.0, 0.0, 3.0], (n, 1, 1))))
    return sim


# 5. Dynamics of one's own: rotors that lift less in an inflow and drag sideways, in place of all forces and torques of the model.

LIFT, INFLOW, SIDE, REACTION = 1.9e-8, 8e-7, 4e-7, 0.0073
PLACES = 0.03253 * np.array([[1, -1], [-1, -1], [-1, 1], [1, 1]])
SPINS = np.array([-1.0, 1.0, -1.0, 1.0])


def cf_dynamics(sim):
    def own(data):
        states = data.states
        turn, speed = Rotation.from_quat(states.quat), RPM * states.rotor_vel
        air = turn.inv().apply(states.vel)
        lift = LIFT * speed**2 - INFLOW * speed * air[..., 2:]
        force = -SIDE * speed.sum(-1, keepdims=True) * air.at[..., 2].set(0.0)
        acc = turn.apply(force.at[..., 2].set(lift.sum(-1))) / MASS - jnp.asarray([0, 0, GRAVITY])
        arms = jnp.asarray(np.stack([PLACES[:, 1], -PLACES[:, 0], REACTION * SPINS]))
        rate = states.ang_vel
        ang_acc = (lift @ arms.T - jnp.cross(rate, INERTIA * rate)) / INERTIA
        return first_principles_dynamics(data).replace(acc=acc, ang_acc=ang_acc)  # rotors follow their commands as in the model

    replace_fn(sim.step_pipeline, lambda data: euler(data, own), "integration")


def without_forces(sim):
    """The model without lift, reaction, inertia of rotors and drag: a rigid body that falls, whose rotors turn."""
    for k in range(4):
        for name in ("thrust_curve.1", "torque_curve.1", "torque_curve.2", "inertia_kg_m2"):
            sim.set_parameter(f"rotors.{k}.{name}", 0.0)
    for k in range(3):
        sim.set_parameter(f"effect.linear_drag.drag_n_s_per_m.{k}.{k}", 0.0)
    return sim


def pw_dynamics_effect(n, **options):
    @propwash.effect
    def own(s):
        s.thrust_factor *= 0
        speed = s.rotor_vel[:4]
        lift = LIFT * speed**2 - INFLOW * speed * s.vel_body[2]
        s.force_body -= SIDE * s.rotor_sum * s.vel_body * np.array([1, 1, 0])
        s.force_body[2] += lift.sum()
        s.torque += np.stack([PLACES[:, 1], -PLACES[:, 0], REACTION * SPINS]) @ lift

    return without_forces(ours_of(n, "rotor_vel", own.on(VEHICLE), **options))


def pw_dynamics(n, **options):
    @propwash.effect
    def no_lift(s):
        s.thrust_factor *= 0

    sim = without_forces(ours_of(n, "rotor_vel", no_lift.on(VEHICLE), **options))

    def own(data):
        turn, speed = rotation(data.quat), data.rotor_vel
        air = np.einsum("wdji,wdj->wdi", turn, data.vel)
        lift = LIFT * speed**2 - INFLOW * speed * air[..., 2:]
        force = -SIDE * speed.sum(-1, keepdims=True) * air
        force[..., 2] = lift.sum(-1)
        data.disturbance_force[...] = np.einsum("wdij,wdj->wdi", turn, force)
        arms = np.stack([PLACES[:, 1], -PLACES[:, 0], REACTION * SPINS])
        data.disturbance_torque[...] = np.einsum("wdij,wdj->wdi", turn, lift @ arms.T)

    return sim, own


def rotation(quat):
    """Matrices body to world of quaternions x y z w."""
    x, y, z, w = np.moveaxis(quat, -1, 0)
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
            2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]  # fmt: skip
    return np.stack(rows, -1).reshape(*quat.shape[:-1], 3, 3)


# 6. Masses drawn at random at every reset.


def cf_masses(sim):
    def masses(data, default, mask):
        key, own = jax.random.split(data.core.rng_key)
        scale = jax.random.uniform(own, (data.core.n_worlds, data.core.n_drones, 1), minval=0.9, maxval=1.1)
        params = leaf_replace(data.params, mask, mass=default.params.mass * scale)
        return data.replace(params=params, core=data.core.replace(rng_key=key))

    append_fn(sim.reset_pipeline, masses)


def pw_masses(n, **options):
    return ours_of(n, "attitude", randomization=[{"parameter": "body.mass_kg", "draw": {"scale": [0.9, 1.1]}}], **options)


@dataclass
class Case:
    """One change: in Crazyflow, and by the names of its forms in Propwash."""

    about: str
    control: str
    theirs: object
    ours: dict
    same: tuple = ()
    """Forms that fly the same equations with the same numbers."""
    resets: bool = False
    """Whether a call begins with a reset."""


BOTH = ("stage", "between steps")


def python(make):
    """The two forms of a Python function."""
    return {"stage": staged(make), "between steps": between(make)}


CASES = {
    "nothing": Case("nothing", "attitude", lambda sim: None, {"kernel": lambda n, **o: ours_of(n, "attitude", **o)}, ("kernel",)),
    "push": Case("a push at random", "attitude", cf_push, {"effect": pw_push_drawn, "effect, drawn at resets": pw_push_effect, **python(pw_push), "turbulence, built in": pw_turbulence}),
    "wind": Case("wind", "attitude", cf_wind, {"built-in effects": pw_wind_effects, **python(pw_wind)}, ("built-in effects", *BOTH)),
    "fan": Case("a force", "attitude", cf_fan, {"effect": pw_fan_effect, **python(pw_fan)}, ("effect", *BOTH)),
    "controller": Case(
        "a controller", "force_torque", cf_law, {"`propwash.controller`": pw_law_compiled, **python(pw_law), "between every five steps": between(pw_law, 5), "the vehicle's, own gains": pw_firmware}, BOTH
    ),
    "dynamics": Case("dynamics", "rotor_vel", cf_dynamics, {"effect": pw_dynamics_effect, **python(pw_dynamics)}, ("effect", *BOTH)),
    "masses": Case("masses at random, a reset in 100 steps", "attitude", cf_masses, {"rules": pw_masses}, resets=True),
}


# Where they end.


def end_of(sim, control, steps=CHECKED_STEPS):
    """Position and attitude after a flight, (n, 1, 7)."""
    form, sim = sim, getattr(sim, "sim", sim)
    restarted(sim, control)
    form.step(steps)
    states = sim.data if isinstance(sim, propwash.Sim) else sim.data.states
    quat = np.asarray(states.quat)
    return np.concatenate([np.asarray(states.pos), quat * np.sign(quat[..., 3:])], -1)


def replayed(n):
    """The random push: Crazyflow's own draws, in a stage of ours."""
    theirs, drawn = restarted(theirs_of(n, "attitude", cf_push), "attitude"), []
    for _ in range(CHECKED_STEPS):
        theirs.step()
        drawn.append((np.asarray(theirs.data.states.force), np.asarray(theirs.data.states.torque)))
    ours = ours_of(n, "attitude", **CHECKED)

    def push(data):
        data.disturbance_force[...], data.disturbance_torque[...] = drawn[data.steps[0]]

    ours.pipeline.insert_before("integration", "own", push)
    return end_of(ours, "attitude") - np.concatenate([theirs.data.states.pos, theirs.data.states.quat], -1)


def masses_given(n):
    """Masses at random: Crazyflow's, given to ours."""
    theirs = theirs_of(n, "attitude", cf_masses)
    there = end_of(theirs, "attitude")
    ours = ours_of(n, "attitude", **CHECKED)
    ours.set_parameter("body.mass_kg", np.asarray(theirs.data.params.mass)[..., 0])
    return end_of(ours, "attitude") - there


def apart(name):
    """How far both end from each other, by form (greatest difference of a coordinate, m, or of a quaternion's part), and how far the change moves the vehicle, m."""
    case, n = CASES[name], CHECKED_WORLDS
    plain = end_of(ours_of(n, case.control, **CHECKED), case.control) if case.control != "force_torque" else None
    there = end_of(theirs_of(n, case.control, case.theirs), case.control)
    moved = np.linalg.norm((there - plain)[..., :3], axis=-1).min() if plain is not None else np.linalg.norm(there[..., :3] - starts(n)[0], axis=-1).min()
    if name == "push":
        return {"stage": float(np.abs(replayed(n)).max())}, float(moved)
    if name == "masses":
        return {"rules": float(np.abs(masses_given(n)).max())}, float(moved)
    ends = {form: end_of(case.ours[form](n, **CHECKED), case.control) for form in case.same}
    return {form: float(np.abs(end - there).max()) for form, end in ends.items()}, float(moved)


# How fast they are.


def rate(form, case, steps, seconds):
    """Steps of all worlds per second of the processor. Every episode lasts 4 s at most; its reset counts only where the case is about resets."""
    sim = getattr(form, "sim", form)
    ours = isinstance(sim, propwash.Sim)
    calls, spent = 0, 0.0
    while spent < seconds or calls < 3:
        if calls * steps % 2000 == 0 and not case.resets:
            restarted(sim, case.control)
        start = time.process_time()
        if case.resets:
            sim.reset()
        form.step(steps)
        if not ours:
            sim.data.states.pos.block_until_ready()
        spent += time.process_time() - start
        calls += 1
    assert not ours or not sim.quarantined.any(), sim.quarantine
    return calls * steps * sim.n_worlds / spent


def number(value):
    return f"{value / 1e6:.3g} M" if value >= 1e6 else f"{value / 1e3:.3g} k"


def measure(case, n, rounds, seconds):
    """Rates by form, each a list of one number for each round, and what making it and its first three calls took, s."""
    makers = {"Crazyflow": lambda: theirs_of(n, case.control, case.theirs), **{form: (lambda make=make: make(n)) for form, make in case.ours.items()}}
    steps, forms, first = 500 if n < 64 and not case.resets else 100, {}, {}
    for name, make in makers.items():
        start = time.perf_counter()
        forms[name] = make()
        rate(forms[name], case, steps, 0.0)
        first[name] = time.perf_counter() - start
    rates = {name: [] for name in forms}
    for _ in range(rounds):
        for name, form in forms.items():
            rates[name].append(rate(form, case, steps, seconds))
    return rates, first


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}; all by default")
    parser.add_argument("--worlds", default="1,1024", help="numbers of worlds")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--seconds", type=float, default=0.3, help="processor time of a measurement")
    parser.add_argument("--check", action="store_true", help="do not measure speed")
    args = parser.parse_args()
    for name in args.cases:
        if name not in CASES:
            parser.error(f"CASE: expected one of {', '.join(CASES)}, got {name!r}")
    chosen = {name: CASES[name] for name in args.cases or CASES}
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    print(f"propwash {propwash.__version__}, crazyflow {crazyflow.__version__}, jax {jax.__version__}, one core, load {os.getloadavg()[0]:.1f}")
    jax.config.update("jax_enable_x64", True)
    distances = {}
    for name in chosen:
        distances[name], moved = apart(name)
        for form, distance in distances[name].items():
            print(f"  {name}, {form}: {distance:.0e} apart where the change moves the vehicle by {moved:.2g} m or more", flush=True)
    if args.check:
        return
    jax.config.update("jax_enable_x64", False)
    worlds = [int(n) for n in args.worlds.split(",")]
    heads = "".join(f" {n:,} world{'s' * (n > 1)}: Crazyflow | Propwash | ratio |" for n in worlds)
    print(f"\n| change | in Propwash |{heads} apart |\n| --- | --- |{' ---: | ---: | ---: |' * len(worlds)} ---: |")
    for name, case in chosen.items():
        measured = [measure(case, n, args.rounds, args.seconds) for n in worlds]
        for form in case.ours:
            cells = []
            for rates, _ in measured:
                there, here = rates["Crazyflow"], rates[form]
                ratio = statistics.median(b / a for a, b in zip(there, here))
                cells += [number(statistics.median(there)), number(statistics.median(here)), f"{ratio:.2g} ×"]
            distance = distances[name].get(form)
            print(f"| {case.about} | {form} | {' | '.join(cells)} | {'' if distance is None else f'{distance:.0e}'} |", flush=True)
        ready = "; ".join(f"{n:,}: " + ", ".join(f"{form} {t:.2f} s" for form, t in first.items()) for n, (_, first) in zip(worlds, measured))
        print(f"<!-- {name}: made and three calls flown after {ready} -->", flush=True)


if __name__ == "__main__":
    main()
