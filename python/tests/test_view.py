"""Pages in three dimensions."""

import json
import re

import numpy as np
import pytest

import propwash
from propwash import datasets


def data(page):
    return json.loads(re.search(r'<script type="application/json" id="flight">(.*?)</script>', page, re.S).group(1))


def test_a_sim_is_shown_as_it_is_now(tmp_path):
    sim = propwash.Sim(3, 2, scene="room")
    sim.set_initial(pos=np.array([[0.0, 0.0, 1.0], [0.5, 0.5, 1.2]]))
    sim.reset()
    view = propwash.View(sim, worlds=[0, 2])
    held = data(view.html)
    assert held["kind"] == "simulation" and [w["number"] for w in held["worlds"]] == [0, 2]
    assert len(held["drones"]) == 2 and all(len(d["rotors"]) == 4 for d in held["drones"])
    assert [g["id"] for g in held["scene"]["geoms"]] == [g.id for g in sim.scene.geoms]
    # One sample: offset and no scale, so that it is exact.
    assert [c["offset"] for c in held["worlds"][1]["drones"][1]["pos"]] == pytest.approx([0.5, 0.5, 1.2])
    view.save(tmp_path / "view.html")
    assert (tmp_path / "view.html").read_text() == view.html
    assert view._repr_html_().startswith('<iframe srcdoc="&lt;!doctype html&gt;')
    with pytest.raises(IndexError, match="world 3: expected 0 to 2"):
        propwash.View(sim, worlds=[3])
    with pytest.raises(ValueError, match="flight logs"):
        propwash.View(sim, scene="room")


def test_a_sim_without_a_scene_has_its_drones():
    held = data(propwash.View(propwash.Sim(1, 1)).html)
    assert held["scene"] is None and held["worlds"][0]["obstacles"] == []


def test_a_data_set_and_a_scene_are_shown(tmp_path):
    propwash.fly(tmp_path / "set", scene="room", n_worlds=2, seconds=1.0, camera={"name": "fpv", "width": 16, "height": 12})
    for what in (tmp_path / "set", str(tmp_path / "set"), datasets.open(tmp_path / "set")):
        view = propwash.View(what, worlds=[1])
        held = data(view.html)
        assert held["kind"] == "data set" and [w["number"] for w in held["worlds"]] == [1]
        assert "of 2 worlds this page has 1: 1" in view.notes[0]
    assert data(propwash.View("zoo").html)["kind"] == "scene"
    with pytest.raises(ValueError, match="world: expected worlds that are there: 0, 1"):
        propwash.View(tmp_path / "set", worlds=[2])
    with pytest.raises(ValueError, match="the folder of a data set"):
        propwash.View("nowhere")
