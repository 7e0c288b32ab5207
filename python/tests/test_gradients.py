"""Sequences of commands and gradients of flights, through NumPy, PyTorch and JAX."""

import numpy as np
import pytest

import propwash as pw


def flight(n_worlds=3, control="attitude", precision="f64", **more):
    """A Sim whose drones move a little, with commands around hover."""
    sim = pw.Sim(n_worlds=n_worlds, drone="cf2x_L250", control=control, precision=precision, **more)
    draws = np.random.default_rng(3)
    sim.data.vel[...] = draws.normal(0, 0.3, sim.data.vel.shape)
    sim.data.ang_vel[...] = draws.normal(0, 0.5, sim.data.ang_vel.shape)
    hover = sim.hover_thrust()[:, None, :, None]
    commands = draws.normal(0, 0.1, (n_worlds, 4, sim.n_drones, 4))
    commands[..., 3:] = hover * (1 + 0.3 * commands[..., 3:])
    return sim, commands


def test_a_rollout_is_steps_under_one_command_after_the_other():
    sim, commands = flight(n_worlds=5, precision="f32")
    kept = sim.save()
    states = sim.rollout(commands, 10)
    assert states.pos.shape == (5, 4, 1, 3) and states.pos.dtype == np.float32
    end = sim.data.pos.copy()
    sim.restore(kept)
    for t in range(4):
        sim.attitude_control(commands[:, t])
        sim.step(10)
        for part in ("pos", "quat", "vel", "ang_vel", "rotor_vel"):
            np.testing.assert_array_equal(getattr(states, part)[:, t], getattr(sim.data, part))
    np.testing.assert_array_equal(end, sim.data.pos)
    assert repr(states) == "States(numbers=<float32 (5, 4, 1, 18)>)"


def test_states_are_read_and_written_as_one():
    sim, _ = flight(n_worlds=3)
    states = sim.states
    np.testing.assert_array_equal(states.vel, sim.data.vel)
    sim.states = pw.States(states.numbers[::-1].copy())
    np.testing.assert_array_equal(sim.data.ang_vel, states.ang_vel[::-1])
    sim.states = pw.States(states.numbers[1])
    for world in range(3):
        np.testing.assert_array_equal(sim.states.numbers[world], states.numbers[1])
    with pytest.raises(ValueError, match="states: expected shape"):
        sim.states = pw.States(states.numbers[:2])


def test_gradients_are_those_of_differences_and_of_dual_numbers():
    sim, commands = flight()
    kept = sim.save()
    tape = sim.record(commands, 10)
    loss = lambda states: (states.pos**2).sum()  # noqa: E731
    gradient = tape.pull_back({"pos": 2 * tape.states.pos}, ["body.mass_kg"])
    assert gradient.commands.shape == commands.shape and gradient.state.pos.shape == (3, 1, 3)
    direction = np.random.default_rng(5).normal(size=commands.shape)
    moved = tape.push_forward(commands=direction)
    forwards = (2 * tape.states.pos * moved.pos).sum()
    assert forwards == pytest.approx((gradient.commands * direction).sum(), rel=1e-10)

    def at(by):
        sim.restore(kept)
        return loss(sim.rollout(commands + by * direction, 10))

    assert (at(1e-5) - at(-1e-5)) / 2e-5 == pytest.approx(forwards, rel=1e-6)

    def heavier(by):
        sim.restore(kept)
        sim.set_parameter("body.mass_kg", sim.parameter("body.mass_kg") + by)
        return loss(sim.rollout(commands, 10))

    slope = (heavier(1e-8) - heavier(-1e-8)) / 2e-8
    assert slope == pytest.approx(gradient.parameters["body.mass_kg"].sum(), rel=1e-5)


def test_linearize_says_where_a_small_change_leads():
    sim, commands = flight(n_worlds=2)
    sim.attitude_control(commands[:, 0])
    before = sim.save()
    a, b = sim.linearize(5)
    assert a.shape == (2, 1, 18, 18) and b.shape == (2, 1, 18, 4)
    nominal = sim.rollout(commands[:, :1], 5).numbers[:, 0]
    sim.restore(before)
    sim.data.vel[..., 0] += 1e-4
    moved = sim.rollout(commands[:, :1], 5).numbers[:, 0]
    np.testing.assert_allclose((moved - nominal) / 1e-4, a[..., 7], atol=1e-4)
    sim.restore(before)
    more = commands[:, :1].copy()
    more[..., 3] += 1e-5
    moved = sim.rollout(more, 5).numbers[:, 0]
    np.testing.assert_allclose((moved - nominal)[..., :13] / 1e-5, b[..., :13, 3], rtol=1e-3, atol=1e-5)


def test_wrong_input_is_refused_in_words():
    sim, commands = flight()
    with pytest.raises(ValueError, match=r"n_worlds, n_times, n_drones, command_width"):
        sim.rollout(commands[0])
    with pytest.raises(ValueError, match="substeps"):
        sim.rollout(commands, 0)
    tape = sim.record(commands, 2)
    with pytest.raises(ValueError, match="seeds: expected shape"):
        tape.pull_back(np.zeros(3))
    with pytest.raises(ValueError, match="got 'position'"):
        tape.pull_back({"position": tape.states.pos})
    with pytest.raises(ValueError, match="seeds of pos: expected shape"):
        tape.pull_back({"pos": np.zeros(3)})
    with pytest.raises(KeyError, match="body.mass_kg"):
        tape.pull_back(tape.states, ["body.mass"])
    with pytest.raises(TypeError, match="a list of names"):
        tape.pull_back(tape.states, "body.mass_kg")
    with pytest.raises(ValueError, match="direction of wind"):
        tape.push_forward(wind=np.zeros(3))
    sim.pipeline.append("mine", lambda data: None)
    with pytest.raises(ValueError, match="functions of Python"):
        sim.record(commands)
    there = pw.Sim(drone="cf2x_L250", scene="room", control="attitude")
    there.rollout(there.data.command[:, None].copy())


def test_a_world_that_flies_away_is_told_of_and_has_no_gradient():
    sim, commands = flight()
    sim.data.pos[1] = 2e9
    with pytest.warns(pw.QuarantineWarning):
        tape = sim.record(commands)
    assert tape.faults == [1]
    with pytest.raises(ValueError, match="world 1"):
        tape.pull_back(tape.states)
    seeds = tape.states.zeros()
    seeds.pos[0] = 1
    assert tape.pull_back(seeds).state.pos[0].any()


def test_jax_takes_gradients_through_flights():
    jax = pytest.importorskip("jax")
    import propwash.jax

    sim, commands = flight(precision="f32")
    start = sim.states.numbers
    before = sim.data.pos.copy()

    def loss(commands, state, mass):
        states = propwash.jax.rollout(sim, commands, state=state, parameters={"body.mass_kg": mass}, substeps=10)
        return (states[..., :3] ** 2).sum()

    mass = float(sim.parameter("body.mass_kg")[0, 0])
    value, got = jax.jit(jax.value_and_grad(loss, argnums=(0, 1, 2)))(commands.astype(np.float32), start.astype(np.float32), mass)
    np.testing.assert_array_equal(sim.data.pos, before)
    tape = sim.record(commands, 10)
    wanted = tape.pull_back({"pos": 2 * tape.states.pos}, ["body.mass_kg"])
    assert float(value) == pytest.approx(float((tape.states.pos**2).sum()), rel=1e-5)
    np.testing.assert_allclose(got[0], wanted.commands, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(got[1], wanted.state.numbers, rtol=1e-4, atol=1e-6)
    assert float(got[2]) == pytest.approx(float(wanted.parameters["body.mass_kg"].sum()), rel=1e-4)


def test_torch_takes_gradients_through_flights():
    torch = pytest.importorskip("torch")
    import propwash.torch

    sim, commands = flight(n_worlds=2)
    sim.rollout(commands[:, :1], 5)
    before = sim.data.pos.copy()
    start = sim.states.numbers

    def of(commands, state, wind, mass):
        return propwash.torch.rollout(sim, commands, state=state, wind=wind, parameters={"body.mass_kg": mass}, substeps=4)[..., :13]

    inputs = [torch.tensor(x, requires_grad=True) for x in (commands[:, :2], start, sim.data.wind + 0.1, sim.parameter("body.mass_kg")[0, 0])]
    assert torch.autograd.gradcheck(of, inputs, eps=1e-7, atol=1e-4, rtol=1e-3)
    np.testing.assert_array_equal(before, sim.data.pos)
    end = propwash.torch.rollout(sim, inputs[0], advance=True)[:, -1, :, :3]
    np.testing.assert_array_equal(end.detach().numpy(), sim.data.pos)


def test_long_rollouts_are_flown_in_parts():
    sim = pw.Sim(3, control="state")
    kept = sim.save()
    # 21 million steps of drones, of which ten million make a part.
    commands = np.zeros((3, 700, 1, 16))
    commands[..., :3] = np.random.default_rng(1).normal(0, 1, (3, 700, 1, 3))
    commands[..., 12] = 1
    whole = sim.rollout(commands, 10_000)
    sim.restore(kept)
    ours = [sim.rollout(commands[:, t : t + 100], 10_000).numbers for t in range(0, 700, 100)]
    np.testing.assert_array_equal(whole.numbers, np.concatenate(ours, axis=1))
    assert len(np.unique(whole.pos[:, -1, 0, 0])) == 3 and not sim.quarantined.any()
