"""propwash.compare, diagnose and add: a flight of a vehicle whose drag the model does not have."""

import hashlib
import pickle
import subprocess
import sys

import numpy as np
import pytest

import propwash
import propwash.envs

HIDDEN = '[[effect]]\nkind = "quadratic_drag"\ndrag_n_s2_per_m2 = [0.02, 0.02, 0.03]\n'


def flight(vehicle, seconds=12, seed=0):
    """A flight along a figure of eight in the columns of docs/logs.md, at 250 Hz, with a little noise of the sensors."""
    sim = propwash.Sim(drone=vehicle, precision="f64")
    sim.set_initial(pos=[0.0, 0.0, 5.0])
    sim.reset()
    rng = np.random.default_rng(seed)
    names = "t px py pz qx qy qz qw vx vy vz wx wy wz cmd_rotor1 cmd_rotor2 cmd_rotor3 cmd_rotor4".split()
    rows = []
    command = np.zeros((1, 1, 16))
    command[..., 12] = 1.0
    for step in range(500 * seconds):
        t = step / 500.0
        grown = min(t / 2.0, 1.0)
        grown = grown * grown * (3.0 - 2.0 * grown)
        command[0, 0, :3] = [1.5 * grown * np.sin(1.2 * t), 0.9 * grown * np.sin(2.0 * t), 5.0 + 0.3 * grown * np.sin(0.9 * t)]
        command[0, 0, 3:6] = [1.8 * grown * np.cos(1.2 * t), 1.8 * grown * np.cos(2.0 * t), 0.27 * grown * np.cos(0.9 * t)]
        sim.state_control(command)
        d = sim.data
        state = [*d.pos[0, 0], *d.quat[0, 0], *d.vel[0, 0], *d.ang_vel[0, 0]]
        sim.step()
        if step % 2 == 0:
            noise = rng.normal(size=13) * ([5e-4] * 3 + [2e-4] * 4 + [2e-3] * 3 + [5e-3] * 3)
            rows.append([t, *(np.array(state) + noise), *d.rotor_command[0, 0]])
    table = np.array(rows)
    assert 4.0 < table[:, 3].min() and table[:, 3].max() < 6.0, "it stays in the air"
    table[:, 4:8] /= np.linalg.norm(table[:, 4:8], axis=1, keepdims=True)
    return dict(zip(names, table.T))


@pytest.fixture(scope="module")
def flown():
    return flight(propwash.Vehicle("cf2x_L250").with_effects(HIDDEN))


def test_a_comparison_tells_a_model_that_agrees_from_one_that_does_not(flown):
    vehicle = propwash.Vehicle("cf2x_L250")
    lacks, right = propwash.compare(flown, vehicle), propwash.compare(flown, vehicle.with_effects(HIDDEN))
    assert not lacks.agrees and lacks.verdict and str(lacks).startswith("cf2x_L250")
    log, better = lacks.logs[0], right.logs[0]
    assert log.horizons[-1].horizon_s == 1.0 and log.horizons[-1].n > 10
    assert better.horizons[-1].position_m < 0.3 * log.horizons[-1].position_m
    assert better.worst_times_noise < log.worst_times_noise
    page = lacks.report.html
    assert page.startswith("<!") and "<iframe srcdoc=" in lacks._repr_html_() and len(page) > 10_000


def test_a_diagnosis_names_what_is_missing_and_completes_the_vehicle(flown, tmp_path):
    verdict = propwash.diagnose(flown, "cf2x_L250", candidates=["quadratic_drag", "wrong_mass", "payload"])
    assert [f.id for f in verdict.findings] == ["quadratic_drag"], verdict.text
    x = verdict.findings[0].parameters[0]
    assert abs(x.value - 0.02) < 5 * x.sigma + 0.002 and x.sigma > 0.0, x
    assert "quadratic_drag" in [kind for kind, _ in verdict.completed.effects()]
    assert [r.label for r in verdict.ladder][:2] == ["as filed", "+ quadratic_drag"]
    assert verdict.findings[0].held_out["with"] < verdict.findings[0].held_out["without"]
    assert verdict.findings[0].doubt is None and verdict.nothing_written is None
    assert verdict.headline == "missing: quadratic_drag"
    assert verdict.moments == () and verdict.sections == ()
    assert verdict.ladder[1].held_out_lack["force_n"] < verdict.ladder[0].held_out_lack["force_n"]
    assert verdict.ladder[1].held_out[-1].position_m < verdict.ladder[0].held_out[-1].position_m
    assert verdict.ladder_png[:4] == b"\x89PNG" and verdict.text == str(verdict)
    verdict.report.save(tmp_path / "gap.html")
    assert (tmp_path / "gap.html").read_text() == verdict.report.html
    propwash.Sim(drone=verdict.completed).step()


def test_a_load_between_two_flights_is_told_and_fitted_apart():
    load = '[[effect]]\nkind = "payload"\nmass_kg = 0.004\nposition_m = [0.0, 0.0, -0.02]\n'
    vehicle = propwash.Vehicle("cf2x_L250")
    both = [flight(vehicle, seed=1), flight(vehicle.with_effects(load), seed=2)]
    verdict = propwash.diagnose(both, vehicle)
    (moment,) = verdict.moments
    assert moment.between_logs and {moment.id, *moment.look_alikes} & {"payload", "wrong_mass"}, verdict.text
    before, after = verdict.sections
    assert before.fitted and before.findings == () and after.findings == verdict.findings != ()
    assert verdict.headline.startswith(f"{moment.id} changed before ")
    assert propwash.diagnose(both, vehicle, moments=False).moments == ()


def test_an_effect_is_fitted_and_written(flown, tmp_path):
    out = tmp_path / "better.toml"
    added = propwash.add("quadratic_drag", flown, "cf2x_L250", out)
    better = propwash.Vehicle(out)
    assert dict(better.effects())["quadratic_drag"] == dict(added.completed.effects())["quadratic_drag"]
    assert {kind for kind, _ in better.effects()} <= {"quadratic_drag", *(k for k, _ in propwash.Vehicle("cf2x_L250").effects())}
    assert "source_log_sha256" in out.read_text() and "propwash.add" in out.read_text()
    with pytest.raises(FileExistsError, match="force=True"):
        propwash.add("quadratic_drag", flown, "cf2x_L250", out)
    stated = propwash.add("quadratic_drag", flown, "cf2x_L250", noise={"gyro": 0.05, "position": 0.002}).details["logs"][0]["noise"]
    assert (stated["gyro_rad_s"], stated["position_m"]) == (0.05, 0.002), stated
    assert added.details["logs"][0]["noise"]["gyro_rad_s"] < 0.02


def test_tables_come_and_go_as_pandas(flown):
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame(flown)
    errors = propwash.compare(table, "cf2x_L250").to_frame()
    assert list(errors.columns) == [
        "log", "horizon_s", "position_m", "velocity_m_s", "attitude_rad", "rate_rad_s", "n",
    ]  # fmt: skip


def test_reports_show_themselves_in_a_notebook_and_elsewhere_in_a_browser(monkeypatch):
    import sys
    import types
    import webbrowser

    report = propwash.Report("<!doctype html><p>a < b & \"c\"</p>")
    opened, shown = [], []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    report.show()
    assert len(opened) == 1 and opened[0].startswith("file://")
    notebook = types.ModuleType("IPython")
    notebook.get_ipython = lambda: object()
    notebook.display = types.ModuleType("IPython.display")
    notebook.display.HTML, notebook.display.display = str, shown.append
    monkeypatch.setitem(sys.modules, "IPython", notebook)
    monkeypatch.setitem(sys.modules, "IPython.display", notebook.display)
    report.show(height=300)
    assert len(opened) == 1 and 'height="300"' in shown[0] and "&lt;p&gt;a &lt; b &amp;" in shown[0]


def test_what_makes_no_sense_is_refused(flown, tmp_path):
    def refused(kind, words, call):
        with pytest.raises(kind) as caught:
            call()
        assert all(w in str(caught.value) for w in words), caught.value

    short = {name: values[:20] for name, values in flown.items()}
    no_commands = {name: values for name, values in flown.items() if not name.startswith("cmd")}
    uneven = {**flown, "px": flown["px"][:-1]}
    refused(OSError, ["no/log.csv"], lambda: propwash.compare("no/log.csv", "cf2x_L250"))
    refused(TypeError, ["logs", "int"], lambda: propwash.compare(5, "cf2x_L250"))
    refused(ValueError, ["expected"], lambda: propwash.compare(short, "cf2x_L250"))
    refused(ValueError, ["expected"], lambda: propwash.compare(no_commands, "cf2x_L250"))
    refused(ValueError, ["one length"], lambda: propwash.compare(uneven, "cf2x_L250"))
    refused(ValueError, ["drive", "stick"], lambda: propwash.compare(flown, "cf2x_L250", drive="stick"))
    refused(ValueError, ["ceiling_z", "-1"], lambda: propwash.compare(flown, "cf2x_L250", ceiling_z=-1.0))
    refused(ValueError, ["noise", "gyro", "compass"], lambda: propwash.compare(flown, "cf2x_L250", noise={"compass": 1.0}))
    refused(ValueError, ["noise", "-1"], lambda: propwash.compare(flown, "cf2x_L250", noise={"gyro": -1.0}))
    refused(ValueError, ["hold_out", "0.9"], lambda: propwash.diagnose(flown, "cf2x_L250", hold_out=0.9))
    refused(KeyError, ["witchcraft"], lambda: propwash.diagnose(flown, "cf2x_L250", candidates=["witchcraft"]))
    refused(ValueError, ["at least one"], lambda: propwash.add([], flown, "cf2x_L250"))
    path = tmp_path / "a.csv"
    path.write_text("t,px\n0.0,1.0\n")
    refused(ValueError, ["each log once"], lambda: propwash.compare([path, path], "cf2x_L250"))


def test_drifts_of_a_folder_are_found_and_a_record_goes_on(tmp_path):
    logs, record = tmp_path / "logs", tmp_path / "r.jsonl"
    logs.mkdir()
    heavier = propwash.Vehicle("cf2x_L250").with_effects('[[effect]]\nkind = "wrong_mass"\nfactor = 1.12\n')
    for number, vehicle in enumerate([propwash.Vehicle("cf2x_L250"), heavier]):
        columns = flight(vehicle, 10, number)
        rows = np.array(list(columns.values())).T
        np.savetxt(logs / f"{number}.csv", rows, delimiter=",", header=",".join(columns), comments="")
    (logs / "broken.csv").write_text("")
    (logs / "README.md").write_text("no log")
    seen = propwash.watch(logs, "cf2x_L250", tmp_path / "now.toml", record=record, order="name")
    assert [log.name for log in seen.logs] == ["0.csv", "1.csv", "broken.csv"]
    assert seen.logs[0].changes == () and seen.logs[2].left_out
    change = seen.logs[1].changes[0]
    assert change.kind in ("drifted", "new") and change.since == "1.csv" and not change.gradual and change.doubt is None
    assert {change.id, *change.look_alikes} & {"wrong_mass", "thrust_scale", "payload"}, seen.text
    assert "2 logs diagnosed, 1 left out" in str(seen) and any(p.changed for p in seen.accepted)
    assert propwash.Vehicle(tmp_path / "now.toml").effects() == seen.completed.effects()
    again = propwash.watch(logs, "cf2x_L250", record=record, order="name")
    assert again.logs == seen.logs and again.accepted == seen.accepted
    with pytest.raises(FileExistsError):
        propwash.watch(logs, "cf2x_L250", tmp_path / "now.toml")
    with pytest.raises(ValueError, match="SHA-256"):
        propwash.watch(logs, heavier, record=record)
    with pytest.raises(ValueError, match="order"):
        propwash.watch(logs, "cf2x_L250", order="size")


def test_a_formula_that_add_wrote_flies_at_once_in_sims_data_sets_and_environments(flown, tmp_path):
    log, better = tmp_path / "flight.csv", tmp_path / "better.toml"
    np.savetxt(log, np.array(list(flown.values())).T, delimiter=",", header=",".join(flown), comments="")
    words = ["add", "--vehicle", "cf2x_L250", "--fit", str(log), "--out", str(better), "--set", "found_1:k=0.05+-0.001"]
    words += ["--expression", "found_1:force_body_x:0.1:-k * vx_body * abs(vx_body)"]
    done = subprocess.run([sys.executable, "-m", "propwash", *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = propwash.Vehicle(better)
    assert "expression" in [kind for kind, _ in found.effects()]

    def by_sim(vehicle):
        sim = propwash.Sim(drone=vehicle, control="attitude")
        sim.set_initial(pos=[0.0, 0.0, 1.0])
        sim.reset()
        sim.attitude_control(np.array([[[0.0, 0.1, 0.0, 0.32]]]))
        sim.step(100)
        return sim.data.pos[0, 0].tobytes()

    def by_data_set(vehicle):
        out = tmp_path / ("found" if vehicle is found else "plain")
        propwash.fly(out, scene="room", drone=vehicle, n_worlds=1, trajectory="lissajous", seconds=1.0)
        return next(out.rglob("states.parquet")).read_bytes()

    def by_environment(vehicle):
        env = propwash.envs.DroneVectorEnv(1, drone=vehicle)
        env.reset(seed=1)
        for _ in range(20):
            seen = env.step(np.zeros(env.action_space.shape, env.action_space.dtype))[0]
        return str(seen)

    for fly in (by_sim, by_data_set, by_environment):
        assert fly(found) != fly("cf2x_L250"), fly.__name__


NETWORK = """format = "propwash network 1"

[[input]]
name = "vx_body"
unit = "m/s"
offset = 0.0
scale = 2.0
low = -4.0
high = 4.0
margin = 1.0

[[hidden]]
weight = [[1.0]]
bias = [0.0]

[output]
acts_on = ["force_body_x_n"]
weight = [[-0.02]]
bias = [0.0]
"""


def test_a_vehicle_flies_with_a_network_beside_it_and_is_pickled_with_it(tmp_path):
    digest = hashlib.sha256(NETWORK.encode()).hexdigest()
    base = propwash.Vehicle("cf2x_L250")
    entry = f'[[effect]]\nkind = "network"\nname = "brake"\nfile = "brake.network.toml"\nsha256 = "{digest}"\n'
    file = tmp_path / "with.toml"
    file.write_text(f"{base.text}\n{entry}")
    with pytest.raises(ValueError, match=r"brake\.network\.toml beside the vehicle file"):
        propwash.Vehicle(file)
    (tmp_path / "brake.network.toml").write_text(NETWORK)
    vehicle = propwash.Vehicle(file)
    assert ("effect.network.brake.gain", 1.0) in vehicle.parameters()

    def pushed(vehicle):
        sim = propwash.Sim(drone=vehicle, control="rotor_vel", precision="f32")
        sim.set_initial(pos=[0.0, 0.0, 5.0], vel=[2.0, 0.0, 0.0])
        sim.reset()
        sim.step(50)
        return float(sim.data.vel[0, 0, 0])

    assert pushed(vehicle) < pushed(base) - 0.01
    # Another process knows nothing of the file.
    script = "import pickle, sys; print(dict(pickle.loads(sys.stdin.buffer.read()).parameters())['effect.network.brake.gain'])"
    out = subprocess.run([sys.executable, "-c", script], input=pickle.dumps(vehicle), capture_output=True, check=True)
    assert out.stdout.strip() == b"1.0"


def test_nothing_left_is_no_network(flown):
    vehicle = propwash.Vehicle("cf2x_L250")
    found = propwash.diagnose(flown, vehicle, network=True)
    network = found.details["network"]
    assert network["found"] is None and network["text"].startswith("no network"), network["text"]
