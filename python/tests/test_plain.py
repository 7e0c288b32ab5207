"""``Sim.f`` and ``Sim.F``: a drone as a plain function of state and command; costs of rollouts."""

import numpy as np
import pytest

import propwash as pw
import propwash.export

LATE = '[[effect]]\nkind = "command_delay"\ndelay_s = 0.004\n'
PUSHED = '[[effect]]\nkind = "downwash"\ndrag_area_m2 = 0.005\nspread = 0.1\n'


@pw.effect
def drag(s):
    s.force -= 0.01 * s.vel * np.sqrt(s.vel @ s.vel + 1e-6)
    s.torque += [0.0, 0.0, 1e-5 * s.ang_vel[0]]


def states(sim, n, seed=0):
    """Random states near those of hover, (n, 14 + n_rotors), and commands, (n, command_width)."""
    draws, d = np.random.default_rng(seed), sim.data
    x = np.tile(np.concatenate([sim.states.numbers[0, 0, :-1], [sim.hover_thrust()[0, 0]]]).astype(float), (n, 1))
    x[:, :3] += draws.normal(0, 1, (n, 3))
    x[:, 3:7] += draws.normal(0, 0.4, (n, 4))
    x[:, 3:7] /= np.linalg.norm(x[:, 3:7], axis=1, keepdims=True)
    x[:, 7:13] = draws.normal(0, 2, (n, 6))
    rotors = d.rotor_vel.shape[-1]
    x[:, 13 : 13 + rotors] = sim.hover_rotor_vel()[0, 0] * draws.uniform(0.8, 1.2, (n, rotors))
    x[:, -1] *= draws.uniform(0.7, 1.3, n)
    if sim.control == "rotor_vel":
        u = sim.hover_rotor_vel()[0, 0] * draws.uniform(0.8, 1.2, (n, rotors))
    else:
        u = np.concatenate([draws.normal(0, 0.2, (n, 3)), sim.hover_thrust()[0, 0] * draws.uniform(0.8, 1.2, (n, 1))], 1)
    return x, u


def near(got, wanted, within=1e-12):
    """Relative to the largest number of each column."""
    assert got.shape == wanted.shape
    size = np.maximum(np.abs(wanted).max(axis=0), 1.0)
    assert (np.abs(got - wanted) / size).max() < within, np.abs(got - wanted).max(axis=0)


@pytest.mark.parametrize("vehicle", ["cf21B_500", "cf2x_L250"])
@pytest.mark.parametrize("dragged", [False, True])
def test_f_is_the_exported_rate(vehicle, dragged):
    own = drag.on(vehicle) if dragged else pw.Vehicle(vehicle)
    for precision in ("f32", "f64"):
        sim = pw.Sim(2, drone=own, control="rotor_vel", precision=precision)
        x, u = states(sim, 300)
        rate = propwash.export.numpy(own)
        near(sim.f(x, u)[:, :-1], rate(x[:, :-1], u))
        assert (sim.f(x, u)[:, -1] == 0).all()
        # One state as well as many, and what broadcasts.
        np.testing.assert_array_equal(sim.f(x[3], u[3]), sim.f(x, u)[3])
        np.testing.assert_array_equal(sim.f(x.reshape(3, 100, -1), u[0])[1, 4], sim.f(x[104], u[0]))
        assert sim.f(x[:0], u[:0]).shape == (0, 18)


def test_f_is_the_rate_of_casadi():
    pytest.importorskip("casadi")
    sim = pw.Sim(drone="cf21B_500", control="rotor_vel")
    x, u = states(sim, 20)
    rate = propwash.export.casadi("cf21B_500")
    near(sim.f(x, u)[:, :-1], np.array([np.asarray(rate(a, b)).ravel() for a, b in zip(x[:, :-1], u)]))


def test_f_of_fitted_models_and_behind_controllers():
    sim = pw.Sim(drone="cf21B_500", dynamics="so_rpy_rotor_drag", control="attitude")
    x, u = states(sim, 200)
    rate = propwash.export.numpy("cf21B_500", dynamics="so_rpy_rotor_drag")
    got, kept = sim.f(x, u), [*range(13), 17]
    near(got[:, kept], rate(x[:, kept], u))
    assert (got[:, 13:17] == 0).all()
    # The on-board controllers tick once, from what they remember.
    sim = pw.Sim(drone="cf21B_500", control="attitude", precision="f64")
    x, u = states(sim, 200)
    controller, rate = propwash.export.numpy("cf21B_500", what="controller"), propwash.export.numpy("cf21B_500")
    told = controller(x[:, :-1], u)[0]
    near(sim.f(x, u)[:, :-1], rate(x[:, :-1], told))
    sim.attitude_control(u[0][None, None])
    sim.step(50)
    memory = sim.data.controller_memory[0, 0]
    told = controller(x[:, :-1], u, np.tile(memory, (200, 1)))[0]
    near(sim.f(x, u)[:, :-1], rate(x[:, :-1], told))


def test_f_is_that_of_a_world_now():
    sim = pw.Sim(3, drone="cf21B_500", control="rotor_vel", precision="f64")
    x, u = states(sim, 5)
    calm = sim.f(x, u)
    sim.set_parameter("body.mass_kg", [0.04, 0.05, 0.06])
    sim.data.disturbance_force[1] = [0.1, 0, 0]
    heavy = [sim.f(x, u, world=w) for w in range(3)]
    thrust = heavy[0][:, 7:10] + [0, 0, 9.81]
    np.testing.assert_allclose((heavy[2][:, 7:10] + [0, 0, 9.81]) * 1.5, thrust, rtol=2e-3, atol=1e-3)
    np.testing.assert_allclose((heavy[1][:, 7] - 2.0) * 1.25, thrust[:, 0], rtol=1e-9)
    assert (heavy[0] != calm).any()
    before = sim.save()
    sim.f(x, u), sim.F(x, u, 3, world=2)
    np.testing.assert_array_equal(sim.states.numbers, (sim.restore(before), sim.states.numbers)[1])


@pytest.mark.parametrize("integrator", ["euler", "rk4"])
@pytest.mark.parametrize("control, dynamics", [("attitude", "first_principles"), ("rotor_vel", "first_principles"), ("attitude", "so_rpy_rotor_drag"), ("state", "first_principles")])
def test_F_is_what_the_simulation_flies_and_linearize_its_slopes(control, dynamics, integrator):
    own = drag.on(pw.Vehicle("cf21B_500").with_effects(LATE))
    sim = pw.Sim(2, drone=own, control=control, dynamics=dynamics, integrator=integrator, precision="f64")
    sim.set_initial(pos=[0.1, 0.2, 1.0], vel=[0.5, -0.3, 0.2], ang_vel=[0.3, -0.2, 0.1])
    sim.reset()
    if control == "state":
        u = np.zeros(16)
        u[[0, 2, 12]] = 0.3, 1.1, 1.0
    else:
        u = states(sim, 1)[1][0]
    sim.data.command[...] = u
    sim.step(7)  # controllers and effects remember something, and not all of them tick now
    x = sim.states.numbers[1, 0].copy()
    for substeps in (1, 4):
        A, B = sim.linearize(substeps)
        F = lambda x, u: sim.F(x, u, substeps, world=1)  # noqa: E731
        for matrix, at, step in ((A, x, lambda d: F(x + d, u)), (B, u, lambda d: F(x, u + d))):
            h = 1e-6 * np.maximum(np.abs(at), 1.0)
            slopes = np.array([(step(d) - step(-d)) / (2 * h[k]) for k, d in enumerate(np.diag(h))]).T
            assert matrix[1, 0].shape == slopes.shape
            np.testing.assert_allclose(matrix[1, 0], slopes, atol=1e-6 * max(1.0, np.abs(slopes).max()))
        kept = sim.save()
        sim.step(substeps)
        flown = sim.states.numbers[1, 0].copy()
        sim.restore(kept)
        np.testing.assert_array_equal(F(x, u), flown)
    # About other states and commands than those that are set.
    other, _ = states(sim, 1, seed=5)
    A, B = sim.linearize(x=other, u=1.001 * u)
    np.testing.assert_array_equal(sim.states.numbers[1, 0], x)
    sim.states, sim.data.command[...] = pw.States(np.tile(other, (2, 1, 1))), 1.001 * u
    np.testing.assert_array_equal(A, sim.linearize()[0])


def test_f_and_F_in_company():
    sim = pw.Sim(1, 2, drone=pw.Vehicle("cf21B_500").with_effects(PUSHED), control="rotor_vel", precision="f64")
    sim.data.pos[0] = [[0, 0, 1], [0, 0, 1.6]]
    sim.rotor_vel_control(sim.hover_rotor_vel())
    x, u = sim.states.numbers[0], sim.hover_rotor_vel()[0]
    alone = pw.Sim(drone="cf21B_500", control="rotor_vel", precision="f64").f(x[0], u[0])
    assert sim.f(x[0], u[0])[9] < alone[9] - 0.1, "the upper drone blows the lower one down"
    assert abs(sim.f(x[1], u[1], drone=1)[9] - alone[9]) < 1e-9
    lower, upper = sim.F(x[0], u[0], 20), sim.F(x[1], u[1], 20, drone=1)
    sim.step(20)
    np.testing.assert_array_equal(sim.states.numbers[0], [lower, upper])


def test_what_is_no_function_of_state_and_command_is_refused():
    sim = pw.Sim(2, drone="cf21B_500", control="rotor_vel")
    x, u = states(sim, 3)
    for call, message in [
        (lambda: sim.f(x[:, :-1], u), r"x: expected real numbers of shape \(…, 18\) = \(…, 14 \+ n_rotors\), got float64 of shape \(3, 17\)"),
        (lambda: sim.f(x, u[:, :3]), r"u: expected real numbers of shape \(…, 4\)"),
        (lambda: sim.f(x, u[:2]), r"expected leading axes that broadcast"),
        (lambda: sim.F(x * np.nan, u), r"x: expected finite numbers, got NaN in row 0, number 0"),
        (lambda: sim.f(x, u, world=2), "world"),
        (lambda: sim.F(x, u, 0), "substeps"),
        (lambda: sim.f("x", u), "x: expected real numbers"),
    ]:
        with pytest.raises(ValueError, match=message):
            call()
    wild = x.copy()
    wild[1, 7] = 1e300
    assert np.isnan(sim.F(wild, u)).all(axis=1).tolist() == [False, True, False]
    sim.pipeline.append("push", lambda data: None)
    with pytest.raises(ValueError, match="functions of Python are no function of state and command"):
        sim.f(x, u)
    ground = pw.Vehicle("cf21B_500").with_effects('[[effect]]\nkind = "ground_effect"\n')
    sim = pw.Sim(drone=ground, control="rotor_vel", scene="room")
    with pytest.raises(ValueError, match="scene: expected none in which effects of a drone read the ground"):
        sim.f(*states(sim, 1))
    assert np.isfinite(pw.Sim(drone=ground, control="rotor_vel").f(x, u)).all()


# ---- costs


def commands(sim, n_times, seed=0, spread=0.1):
    draws = np.random.default_rng(seed)
    out = np.zeros((sim.n_worlds, n_times, sim.n_drones, 4))
    out[..., :2] = draws.normal(0, spread, out[..., :2].shape)
    out[..., 3] = sim.hover_thrust()[:, None]
    return out


@pw.cost(goal=3, weight=1)
def to_goal(s):
    off, change = s.pos - s.goal, s.command - s.before
    return s.weight * off @ off + 0.1 * s.vel @ s.vel + change @ change + 10 * s.last * off @ off + 0.5 * np.where(s.t > 0.1, s.quat[0] ** 2, 0)


def told(states, commands, first, goal, weight, step):
    """The same with NumPy."""
    pos, vel, quat = (np.asarray(part, float) for part in (states.pos, states.vel, states.quat))
    given = commands.astype(np.float32).astype(float)
    before = np.concatenate([np.broadcast_to(first[:, None], given[:, :1].shape), given[:, :-1]], 1)
    off, n = pos - goal, pos.shape[1]
    last, t = np.zeros(n), step * np.arange(1, n + 1)
    last[-1] = 1
    near = (off**2).sum(-1)
    each = weight * near + 0.1 * (vel**2).sum(-1) + ((given - before) ** 2).sum(-1) + 10 * last[:, None] * near
    return (each + 0.5 * np.where(t[:, None] > 0.1, quat[..., 0] ** 2, 0)).sum(1)


@pytest.mark.parametrize("n_worlds, n_drones, threads", [(1, 1, 1), (70, 1, 2), (513, 2, 2)])
def test_a_cost_is_what_numpy_says_of_the_states(n_worlds, n_drones, threads):
    sim = pw.Sim(n_worlds, n_drones, drone="cf21B_500", control="attitude", threads=threads)
    sim.set_initial(pos=np.random.default_rng(2).uniform(-1, 1, (n_worlds, n_drones, 3)))
    sim.reset()
    sim.attitude_control(np.tile([0.1, 0, 0, 0.3], (n_worlds, n_drones, 1)))
    first, given = np.array(sim.data.command, float), commands(sim, 12)
    goals, start = np.linspace([0, 0, 1], [1, 0, 1], 12), sim.save()
    got = sim.rollout(given, 10, cost=to_goal, given={"goal": goals, "weight": 2.0}, states=True)
    assert got.cost.shape == (n_worlds, n_drones) and got.cost.dtype == np.float64
    np.testing.assert_allclose(got.cost, told(got.states, given, first, goals[:, None], 2.0, 0.02), rtol=1e-12)
    end = sim.states.numbers
    # The same without states, and what is given once for all commands.
    sim.restore(start)
    again = sim.rollout(given, 10, cost=to_goal, given={"goal": goals, "weight": 2.0})
    assert again.states is None
    np.testing.assert_array_equal(again.cost, got.cost)
    np.testing.assert_array_equal(sim.states.numbers, end)
    sim.restore(start)
    once = sim.rollout(given, 10, cost=to_goal, given={"goal": [0, 0, 1], "weight": np.linspace(0, 1, 12)})
    np.testing.assert_allclose(once.cost, told(got.states, given, first, np.array([0, 0, 1]), np.linspace(0, 1, 12)[:, None], 0.02), rtol=1e-12)
    # The equations world by world price alike.
    exact = pw.Sim(n_worlds, n_drones, drone="cf21B_500", control="attitude", precision="f64")
    exact.set_initial(pos=np.random.default_rng(2).uniform(-1, 1, (n_worlds, n_drones, 3)))
    exact.reset()
    exact.attitude_control(np.tile([0.1, 0, 0, 0.3], (n_worlds, n_drones, 1)))
    wide = exact.rollout(given, 10, cost=to_goal, given={"goal": goals, "weight": 2.0})
    np.testing.assert_allclose(wide.cost, got.cost, rtol=1e-3)


def test_plain_functions_are_traced_at_every_rollout_and_fields_show_distances():
    sim = pw.Sim(64, scene="forest", drone="cf21B_500", control="attitude")
    field = sim.distance_field(0.1, bounds=([-6, -6, 0], [6, 6, 3]))
    given, start = commands(sim, 20), sim.save()
    given[..., 1] += 0.3
    for far in (0.5, 1.5):
        sim.restore(start)
        priced = sim.rollout(given, 10, cost=lambda s: np.where(s.distance < far, 1.0, 0.0), field=field, states=True)
        distance = field.distance(priced.states.pos.astype(float).reshape(-1, 3)).reshape(64, 20)
        counts = (distance < far).sum(1)
        assert np.abs(priced.cost[:, 0] - counts).max() <= 1 and counts.max() > 0
    rotors = pw.Sim(2, drone="cf21B_500", control="rotor_vel")
    speeds = np.tile(rotors.hover_rotor_vel()[:, None], (1, 3, 1, 1))
    priced = rotors.rollout(speeds, cost=lambda s: (s.rotor_vel - s.command) @ (s.rotor_vel - s.command) + s.thrust, states=True)
    assert (priced.cost < 1e-3).all()
    assert repr(to_goal) == "<propwash.Cost to_goal>" and to_goal.given == {"goal": 3, "weight": 1}


def test_worlds_that_are_lost_cost_infinity():
    sim = pw.Sim(40, drone="cf21B_500", control="attitude")
    sim.data.vel[7, 0] = 1e30
    with pytest.warns(pw.QuarantineWarning):
        priced = sim.rollout(commands(sim, 5), 10, cost=lambda s: s.t)
    assert np.isinf(priced.cost[7, 0])
    np.testing.assert_allclose(np.delete(priced.cost, 7, 0), 0.02 * 15, rtol=1e-12)


def test_what_is_no_cost_is_refused():
    sim = pw.Sim(2, drone="cf21B_500", control="attitude")
    given = commands(sim, 3)

    def hard(s):
        return 1.0 if s.pos[2] < 0.5 else 0.0

    for error, message, options in [
        (TypeError, r"ask whether something is so.*test_plain.py, line \d+: return 1.0 if s.pos\[2\]", {"cost": hard}),
        (TypeError, r"a cost sees pos, .*before here, not wind \(test_plain.py", {"cost": lambda s: s.wind}),
        (TypeError, "<lambda>: expected a number or a formula", {"cost": lambda s: s.pos}),
        (TypeError, "expected a function of what is seen", {"cost": 3.0}),
        (ValueError, "given: expected goal, weight, got nothing", {"cost": to_goal}),
        (ValueError, r"given: goal: expected shape \(3,\), or \(3, 3\) = \(n_times, 3\), got \(2, 3\)", {"cost": to_goal, "given": {"goal": np.zeros((2, 3)), "weight": 1}}),
        (ValueError, "given: expected finite numbers, got NaN", {"cost": to_goal, "given": {"goal": [0, 0, np.nan], "weight": 1}}),
        (ValueError, "given: expected None without a cost", {"given": {}}),
        (ValueError, "field: expected a distance field, since the cost reads distances", {"cost": lambda s: s.distance}),
        (ValueError, "cost: expected numbers.*got NaN in world 0, drone 0", {"cost": lambda s: np.sqrt(s.pos[0] - 9)}),
    ]:
        with pytest.raises(error, match=message):
            sim.rollout(given, **options)
    for bad in ({"pos": 3}, {"not a name": 1}, {"goal": 0}, {"goal": 1.5}, {"goal": True}):
        with pytest.raises(ValueError, match="cost: "):
            pw.cost(lambda s: 0.0, **bad)
