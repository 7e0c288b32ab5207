"""propwash.Lab: a session with a flight of a vehicle whose drag the model does not have."""

import numpy as np
import pytest
from test_gap import HIDDEN, flight
from test_interrupt import Soon, once  # noqa: F401

import propwash


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    columns = flight(propwash.Vehicle("cf2x_L250").with_effects(HIDDEN))
    path = tmp_path_factory.mktemp("lab") / "flight.csv"
    rows = zip(*columns.values())
    text = "\n".join([",".join(columns), *(",".join(repr(float(v)) for v in row) for row in rows)])
    path.write_text(text + "\n")
    return path


@pytest.fixture
def lab(log):
    return propwash.Lab(log, "cf2x_L250")


def test_a_session_finds_switches_moves_fits_and_saves(lab, log, tmp_path):
    assert lab.effects == () and "lacks" in lab.headline
    before, seen = lab.figures_before, []
    assert lab.figures.force_n == before.force_n and lab.figures.exact
    found = lab.find(progress=lambda done, total: seen.append((done, total)))
    assert "quadratic_drag" in [e.id for e in found], lab.headline
    assert seen and all(done <= total for done, total in seen)
    assert not any(e.on for e in lab.effects)
    forecast = lab.toggle("quadratic_drag")
    assert forecast.force_n < 0.5 * before.force_n and not forecast.exact
    exact, residuals = lab.exact()
    assert exact.force_n == pytest.approx(forecast.force_n, rel=0.05)
    r = residuals[0]
    assert r.log == log.name and r.force_n.shape == (r.t_s.size, 3) == r.torque_n_m.shape
    assert np.all(np.diff(r.t_s) > 0)
    (again,) = lab.residual()
    assert np.array_equal(again.force_n, r.force_n, equal_nan=True)
    x = lab.effect("quadratic_drag").parameters[0]
    assert x.interval[0] < x.value < x.interval[1]
    moved = lab.set("quadratic_drag", 0.0, x.name)
    assert moved.force_n > forecast.force_n and lab.effect("quadratic_drag").parameters[0].by_hand
    assert lab.undo() and lab.figures.force_n == pytest.approx(exact.force_n) and lab.redo() and not lab.redo()
    fitted = lab.fit()
    assert fitted.force_n < 0.5 * before.force_n
    saved = lab.save(tmp_path / "better.toml", steps=True)
    assert (tmp_path / "better.toml").read_text() == saved.text and "quadratic_drag" in saved.text
    assert "propwash add" in (tmp_path / "better.sh").read_text()
    assert any(change == "added" and "quadratic_drag" in line for change, line in saved.diff)
    with pytest.raises(FileExistsError):
        lab.save(tmp_path / "better.toml")
    better = propwash.compare(log, saved.vehicle)
    assert better.logs[0].worst_times_noise < propwash.compare(log, "cf2x_L250").logs[0].worst_times_noise
    lab.go(0)
    assert lab.effects == ()


def test_own_expressions_are_checked_and_become_effects(lab):
    with pytest.raises(ValueError, match="column 6"):
        lab.expression("force_body_x", "-k * vx_bodi")
    with pytest.raises(KeyError, match="force_body_x"):
        lab.expression("force", "k")
    name = lab.expression("force_body_x", "-k * vx_body * abs(vx_body)")
    own = lab.effect(name)
    assert own.parameters[0].unit == "N·s²/m²" and own.parameters[0].estimate > 0
    assert lab.toggle(name).force_n < lab.figures_before.force_n
    with pytest.raises(KeyError, match="rotor_drag"):
        lab.toggle("rotor_drug")


def test_ctrl_c_and_errors_of_progress_end_a_search_and_change_nothing(lab, once):  # noqa: F811
    before = lab.state
    with Soon(), pytest.raises(KeyboardInterrupt):
        for _ in range(100):
            lab.find()
    assert lab.state["history"] == before["history"]

    def fails(done, total):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        lab.find(progress=fails)
    assert lab.state["history"] == before["history"]


def test_logs_have_a_use(log, tmp_path):
    other = tmp_path / "other.csv"
    other.write_bytes(log.read_bytes())
    lab = propwash.Lab([log], "cf2x_L250", check=[other])
    assert [f["used"] for f in lab.state["flights"]] == ["fit", "check"]
    with pytest.raises(ValueError, match="flight"):
        lab.set_use(0, "check")
    with pytest.raises(ValueError, match="use"):
        lab.set_use(1, "watch")
    lab.set_use(str(other), "fit")
    assert [f["used"] for f in lab.state["flights"]] == ["fit", "fit"]
