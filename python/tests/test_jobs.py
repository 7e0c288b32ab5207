"""What commands of the program do, as functions: the same results as theirs."""

import json
import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest
from test_gap import HIDDEN, flight

import propwash

PROGRAM = os.environ.get("PROPWASH_BIN")
program = pytest.mark.skipif(PROGRAM is None, reason="PROPWASH_BIN is not set")


def told(*words, code=0, **options):
    """What the program prints."""
    done = subprocess.run([PROGRAM, *map(str, words)], capture_output=True, text=True, timeout=300, **options)
    assert done.returncode == code, done.stderr
    return done.stdout


def files(folder):
    return {p.relative_to(folder): p.read_bytes() for p in sorted(Path(folder).rglob("*")) if p.is_file()}


@program
def test_fly_writes_the_data_set_of_the_program(tmp_path):
    line = "--scene forest --drone cf2x_L250 --drone cf21B_500 --worlds 3 --seconds 0.2 --trajectory circle --fps 10 --log-hz 50"
    told("fly", *line.split(), "--size", "12x8", "--seed", 4, "--normals", "--out", tmp_path / "a")
    seen = []
    flown = propwash.fly(
        tmp_path / "b", scene="forest", drone=["cf2x_L250", "cf21B_500"], n_worlds=3, seconds=0.2, trajectory="circle", fps=10,
        log_freq=50, camera={"width": 12, "height": 8}, seed=4, normals=True, progress=lambda done, of: seen.append((done, of)),
    )
    assert files(tmp_path / "a") == files(tmp_path / "b")
    assert (flown.worlds, flown.resumed_worlds, flown.quarantined_worlds) == (3, 0, 0) and flown.overview.is_file()
    told_by_it = json.loads(told("fly", *line.split(), "--size", "12x8", "--seed", 4, "--normals", "--json", "--out", tmp_path / "b"))
    assert {**flown.details, "resumed_worlds": 3} == told_by_it
    assert sorted(seen) == [(k, 3) for k in range(4)] and flown.images > 0
    # What is there already is kept, and what was flown is flown again from its manifest, with changes.
    assert propwash.fly(tmp_path / "b", config=tmp_path / "b").resumed_worlds == 3
    more = propwash.fly(tmp_path / "c", config=tmp_path / "b" / "manifest.json", n_worlds=4, threads=1)
    assert more.worlds == 4
    same = {p: b for p, b in files(tmp_path / "a").items() if p.parts[0].endswith("1") and p.name != "manifest.json"}
    assert same and same.items() <= files(tmp_path / "c").items()


def test_fly_takes_vehicles_scenes_as_text_and_waypoints(tmp_path):
    vehicle = propwash.Vehicle("hb_x500").with_effects(HIDDEN)
    path = [[0.0, 0.0, 0.0, 1.0], [0.5, 0.2, 0.0, 1.0], [1.0, 0.2, 0.2, 1.0]]
    text = "<mujoco><worldbody><geom name='floor' type='plane' size='5 5 0.1'/></worldbody></mujoco>"
    flown = propwash.fly(tmp_path / "set", scene=text, drone=vehicle, trajectory=path, seconds=0.2, camera={"width": 8, "height": 6})
    assert flown.worlds == 1
    config = json.loads((tmp_path / "set/manifest.json").read_text())["config"]
    assert config["pattern"] == {"waypoints": [[0.0, [0.0, 0.0, 1.0], 0.0], [0.5, [0.2, 0.0, 1.0], 0.0], [1.0, [0.2, 0.2, 1.0], 0.0]]}
    assert config["drones"][0]["vehicle"] == {"name": "hb_x500", "toml": vehicle.to_toml()}


def test_fly_says_what_is_wrong(tmp_path):
    with pytest.raises(ValueError, match="scene: expected one, such as 'corridor'"):
        propwash.fly(tmp_path / "x")
    with pytest.raises(ValueError, match="trajectory: expected .* rows of"):
        propwash.fly(tmp_path / "x", scene="room", trajectory=[[0.0, 1.0]])
    with pytest.raises(ValueError, match="unknown field `colour`"):
        propwash.fly(tmp_path / "x", scene="room", colour=1)
    with pytest.raises(FileNotFoundError, match="did you mean 'room'"):
        propwash.fly(tmp_path / "x", scene="rooom")
    assert not (tmp_path / "x").exists()

    def stop(done, of):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        propwash.fly(tmp_path / "y", scene="room", seconds=0.05, camera={"width": 4, "height": 3}, progress=stop)


SMALL = {"scene": "room", "seconds": 0.05, "camera": {"width": 4, "height": 3}}


def recorded(folder):
    return json.loads((folder / "manifest.json").read_text())["config"]


def test_a_changed_scene_is_refused_unless_what_changed_makes_another(tmp_path):
    text = "<mujoco><worldbody><geom name='floor' type='plane' size='5 5 0.1'/>{}</worldbody></mujoco>"
    (tmp_path / "own.xml").write_text(text.format(""))
    first = {**SMALL, "scene": tmp_path / "own.xml"}
    propwash.fly(tmp_path / "a", **first)
    (tmp_path / "own.xml").write_text(text.format("<geom name='new' size='0.1' pos='3 0 0'/>"))
    for changes in ({}, {"dynamics": "so_rpy"}, {"seed": 3}):
        with pytest.raises(ValueError, match="scene_sha256: expected"):
            propwash.fly(tmp_path / "b", config=tmp_path / "a", **changes)
    assert propwash.fly(tmp_path / "c", config=tmp_path / "a", n_drones=2).worlds == 1


def test_two_names_for_one_thing_are_refused(tmp_path):
    for one, other in (
        ({"drone": "cf2x_L250"}, {"drones": [{}]}),
        ({"trajectory": "hover"}, {"pattern": "circle"}),
        ({"log_freq": 50}, {"log_hz": 100}),
    ):
        with pytest.raises(ValueError, match=f"{[*one][0]}, {[*other][0]}: expected one of them"):
            propwash.fly(tmp_path / "x", scene="room", **one, **other)


def test_what_is_changed_in_a_camera_takes_the_place_of_what_said_the_same(tmp_path):
    mounted = {**SMALL, "camera": {"width": 4, "height": 3, "fovy_deg": 70.0, "mount": {"pos_m": [0.1, 0.0, 0.0]}}}
    propwash.fly(tmp_path / "a", **mounted)
    propwash.fly(tmp_path / "b", config=tmp_path / "a", camera={"name": "down"})
    propwash.fly(tmp_path / "c", config=tmp_path / "a", camera="down")
    assert recorded(tmp_path / "b")["camera"] == recorded(tmp_path / "c")["camera"]
    assert (recorded(tmp_path / "b")["camera"]["name"], recorded(tmp_path / "b")["camera"]["mount"]) == ("down", None)
    propwash.fly(tmp_path / "d", config=tmp_path / "a", camera={"pinhole_px": [4.0, 4.0, 2.0, 1.5]})
    assert recorded(tmp_path / "d")["camera"]["fovy_deg"] is None and recorded(tmp_path / "d")["camera"]["mount"] is not None
    propwash.fly(tmp_path / "e", config=tmp_path / "d", camera={"fovy_deg": 50.0})
    assert recorded(tmp_path / "e")["camera"]["pinhole_px"] is None


@program
def test_both_doors_change_a_description_alike(tmp_path):
    (tmp_path / "rules.toml").write_text('[[rule]]\nparameter = "body.mass_kg"\ndraw = { scale = [0.9, 1.1] }\n')
    shell = Path(__file__).parents[2] / "xml/shells/cf21B.xml"
    propwash.fly(tmp_path / "first", sensors=["imu"], **SMALL)
    line = ["--sensor", "range_finder", "--shell", shell, "--drones-per-world", 2, "--randomize", tmp_path / "rules.toml"]
    told("fly", "--config", tmp_path / "first/manifest.json", *line, "--fovy", 50, "--out", tmp_path / "a")
    propwash.fly(
        tmp_path / "b", config=tmp_path / "first", sensors=["range_finder"], shell=shell, n_drones=2,
        randomization=tmp_path / "rules.toml", camera={"fovy_deg": 50.0},
    )  # fmt: skip
    assert files(tmp_path / "a") == files(tmp_path / "b")
    assert [s["kind"] for s in recorded(tmp_path / "b")["sensors"]] == ["imu", "range_finder"]
    with pytest.raises(ValueError, match="n_drones: expected 1 to 1024, got 1025"):
        propwash.fly(tmp_path / "x", scene="room", n_drones=1025)


@program
def test_fly_takes_ways_from_a_file(tmp_path):
    way = tmp_path / "way.csv"
    way.write_text("t,x,y,z,drone\n0,0,0,1,0\n1,0.2,0,1,0\n0,1,0,1,1\n1,1.2,0,1,1\n")
    line = "--scene room --drone cf2x_L250 --drones-per-world 2 --seconds 0.05 --size 4x3 --trajectory waypoints"
    told("fly", *line.split(), way, "--out", tmp_path / "a")
    for k, given in enumerate((way, str(way))):
        propwash.fly(tmp_path / f"b{k}", n_drones=2, drone="cf2x_L250", trajectory=given, **SMALL)
        assert files(tmp_path / "a") == files(tmp_path / f"b{k}")
    for wrong, kind in (("lissajou", FileNotFoundError), (tmp_path / "no.csv", FileNotFoundError), ([[0.0, 1.0], [0.0]], ValueError), (3.0, ValueError),
                        ([["a", 0, 0, 0]], ValueError), ({"t": 0}, TypeError)):  # fmt: skip
        with pytest.raises(kind, match="trajectory: expected lissajous, circle, hover, a CSV file or rows of"):
            propwash.fly(tmp_path / "x", scene="room", trajectory=wrong)
    way.write_text("t,x,y\n0,0,0\n")
    with pytest.raises(ValueError, match='way.csv.*no column "z"'):
        propwash.fly(tmp_path / "x", scene="room", trajectory=way)


def test_numbers_of_numpy_are_numbers_and_what_is_none_is_named(tmp_path):
    flown = propwash.fly(
        tmp_path / "set", scene="room", seconds=np.float32(0.0625), n_worlds=np.int64(2), obstacle_jitter_m=np.float32(0.25),
        camera={"width": np.int32(4), "height": 3, "range_m": np.array([0.01, 9.0])},
    )  # fmt: skip
    config = recorded(tmp_path / "set")
    assert (flown.worlds, config["obstacle_jitter_m"], config["camera"]["range_m"]) == (2, 0.25, [0.01, 9.0])
    with pytest.raises(TypeError, match="obstacle_jitter_m: expected numbers, text, lists and dicts, got .1. .set"):
        propwash.fly(tmp_path / "x", scene="room", obstacle_jitter_m={1})
    for make in (propwash.lint, lambda scene: propwash.scene_new("forest", size_m=scene["forest"]["size_m"])):
        with pytest.raises(ValueError, match="scene.forest.size_m: expected a finite number, got nan"):
            make({"forest": {"size_m": float("nan")}})
        with pytest.raises(ValueError, match="^scene: ((?!line).)*$"):
            make({"forest": {"size_m": "large"}})


def test_out_that_is_a_file_is_a_matter_of_the_system(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        propwash.fly(tmp_path / "file", **SMALL)
    with pytest.raises(OSError, match="file"):
        propwash.fly(tmp_path / "file" / "inner", **SMALL)


def test_a_generated_scene_is_asked_for_by_a_dict(tmp_path):
    for make in (propwash.lint, lambda scene: propwash.Sim(scene=scene), lambda scene: propwash.fly(tmp_path / "x", scene=scene)):
        with pytest.raises(FileNotFoundError, match="got 'rooms', a kind of scenes that are generated; did you mean 'room'.*{'rooms': {}} generates one"):
            make("rooms")
    assert propwash.lint({"rooms": {}}).scene == "scene 'rooms of seed 0'"
    propwash.fly(tmp_path / "set", layouts=1, **{**SMALL, "scene": "rooms"})
    assert "rooms" in recorded(tmp_path / "set")["scene"]


@program
def test_lint_is_that_of_the_program():
    report = propwash.lint("zoo")
    theirs = json.loads(told("scene", "lint", "zoo", "--json", code=1))
    assert not report.clean and not report.spawn_blocked and report.details == theirs
    assert [g.name for g in report.geoms] == [g["name"] for g in theirs["geoms"]]
    assert {g.name for g in report.mismatches} == {
        g["name"] for g in theirs["geoms"] if not (g["depth"]["seen"] and g["contact"]["seen"])
    }
    assert all(bool(g.depth_reason) != g.depth and bool(g.contact_reason) != g.contact for g in report.geoms)
    assert str(report).strip() == told("scene", "lint", "zoo", code=1).strip()
    assert propwash.lint("room").clean
    blocked = propwash.lint("<mujoco><worldbody><geom size='1' pos='0 0 1'/></worldbody></mujoco>", spawn=(0, 0, 1))
    assert blocked.spawn_blocked and not blocked.clean


@program
def test_new_scenes_are_those_of_the_program(tmp_path):
    told("scene", "new", "forest", "--seed", 3, "--trees", 9, "--out", tmp_path / "a.xml")
    text = propwash.scene_new("forest", tmp_path / "b.xml", seed=3, trees=9)
    assert text == (tmp_path / "a.xml").read_text() == (tmp_path / "b.xml").read_text()
    with pytest.raises(ValueError, match="trees"):
        propwash.scene_new("forest", tres=9)
    with pytest.raises(ValueError, match="corridor, boxes, track, rooms"):
        propwash.scene_new("desert")


def test_files_that_are_there_are_replaced_on_request_only(tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text("mine")
    jobs = [
        lambda out, **more: propwash.scene_new("forest", out, trees=3, **more),
        lambda out, **more: propwash.identify({}, "cf2x_L250", out, **more),
        lambda out, **more: propwash.excite("cf2x_L250", "nothing", out, **more),
        lambda out, **more: propwash.vehicle_new(750.0, 0.1, out, **more),
    ]
    for job in jobs:
        # Before anything else is looked at.
        with pytest.raises(FileExistsError, match="force=True"):
            job(mine)
        with pytest.raises(FileNotFoundError, match="make it first"):
            job(tmp_path / "no" / "x.toml")
    jobs[0](mine, force=True)
    assert "<mujoco" in mine.read_text()
    assert [p.name for p in tmp_path.iterdir()] == ["mine.toml"], "nothing else is left"


@program
def test_log_check_is_that_of_the_program(tmp_path):
    log = flight("cf2x_L250", seconds=4)
    report = propwash.log_check(log)
    assert report.verdict in ("info", "warning", "refuse") and report.duration_s > 0
    assert {c.name for c in report.channels} >= {"position", "attitude"}
    path = tmp_path / "log.csv"
    with path.open("w") as f:
        f.write(",".join(log) + "\n")
        for row in zip(*log.values()):
            f.write(",".join("" if v != v else repr(float(v)) for v in row) + "\n")
    mine = propwash.log_check(path)
    theirs = subprocess.run([PROGRAM, "log", "check", str(path), "--json"], capture_output=True, text=True)
    assert mine.details == json.loads(theirs.stdout)[0]
    assert report.file == "log_0.csv" and tempfile.gettempdir() not in str(report) + json.dumps(report.details)
    with pytest.raises(ValueError, match="^log_0.csv") as caught:
        propwash.identify({"t": [0.0, 1.0], "px": [0.0, 1.0]}, "cf2x_L250")
    assert tempfile.gettempdir() not in str(caught.value)
    turned = {**log, "t": np.asarray(log["t"])[::-1]}
    assert propwash.log_check(turned).verdict != "info"
    with pytest.raises(OSError):
        propwash.log_check(tmp_path / "absent.csv")


def test_log_check_writes_the_mapping_that_mends_a_log(tmp_path):
    log = flight("cf2x_L250", seconds=20)
    wrong = {**log, **{k: np.degrees(log[k]) for k in ("wx", "wy", "wz")}, **{k: -np.asarray(log[k]) for k in ("vx", "vy", "vz")}}
    before = propwash.log_check(wrong)
    assert before.verdict == "refuse" and any(f.fixes for f in before.findings) and before.corrected == ()
    mapping = tmp_path / "mend.toml"
    mended = propwash.log_check(wrong, write_mapping=mapping)
    assert mended.verdict != "refuse" and len(mended.corrected) == 2, (mended.corrected, mended.text)
    assert propwash.log_check(wrong, mapping).details == mended.details
    with pytest.raises(FileExistsError, match="force"):
        propwash.log_check(wrong, write_mapping=mapping)
    assert propwash.log_check(log, write_mapping=tmp_path / "none.toml").corrected == ()
    assert not (tmp_path / "none.toml").exists()


def test_excite_plans_a_flight_that_fly_takes(tmp_path):
    plan = propwash.excite("cf2x_L250", "linear_drag", tmp_path / "path.csv", seconds=20.0)
    assert plan.manoeuvres and plan.waypoints.shape[1] == 5 and plan.duration_s <= 21.0
    assert (tmp_path / "path.csv").read_text() == plan.csv and plan.csv.startswith("t,x,y,z,yaw")
    assert {p["id"] for p in plan.parameters} == {"linear_drag"}
    flown = propwash.fly(tmp_path / "set", scene="<mujoco><worldbody><geom type='plane' size='9 9 1'/></worldbody></mujoco>",
                         trajectory=plan.waypoints, seconds=0.1, camera={"width": 4, "height": 3})
    assert flown.worlds == 1
    details = {k: v for k, v in plan.details.items() if k != "waypoints"}
    assert plan.details["waypoints"] == str(tmp_path / "path.csv") and details["vehicle"] == "cf2x_L250"
    with pytest.raises(KeyError, match="linear_dra"):
        propwash.excite("cf2x_L250", "linear_dra")
    with pytest.raises(ValueError, match="sensors: expected one of"):
        propwash.excite("cf2x_L250", "linear_drag", sensors={"lidar_hz": 3})


@program
def test_manoeuvres_and_what_tells_effects_apart_are_those_of_the_program(tmp_path):
    names = ["low passes", "yaw spin"]
    line = ["excite", "--vehicle", "cf2x_L250", "--fly", ",".join(names), "--box", "5,5,3", "--json", "--out", tmp_path / "a.csv"]
    theirs = json.loads(told(*line))
    flown = propwash.manoeuvres("cf2x_L250", names, tmp_path / "b.csv", box=(5, 5, 3))
    assert (tmp_path / "b.csv").read_text() == (tmp_path / "a.csv").read_text() == flown.csv
    assert flown.details == {**theirs, "waypoints": str(tmp_path / "b.csv")} and flown.duration_s == flown.waypoints[-1, 0]
    with pytest.raises(KeyError, match="tea break"):
        propwash.manoeuvres("cf2x_L250", "tea break")
    with pytest.raises(ValueError, match="names: expected at least one"):
        propwash.manoeuvres("cf2x_L250", [])
    theirs = json.loads(told("excite", "--vehicle", "cf2x_L250", "--want", "com_offset", "--from", "weak_rotor.2", "--json"))
    advice = propwash.tell_apart("cf2x_L250", "com_offset", "weak_rotor.2")
    assert advice and [vars(a) for a in advice] == theirs["advice"]
    with pytest.raises(KeyError, match="weak_roto"):
        propwash.tell_apart("cf2x_L250", "com_offset", "weak_roto.2")


def commanded():
    """A flight by attitude commands, by the attitude model itself, with a little noise."""
    sim = propwash.Sim(drone="cf2x_L250", dynamics="so_rpy_rotor_drag", control="attitude", freq=500, precision="f64")
    sim.set_initial(pos=[0.0, 0.0, 50.0])
    sim.reset()
    random = np.random.default_rng(0)
    hover = float(sim.hover_thrust()[0, 0])
    names = ["t", "px", "py", "pz", "qx", "qy", "qz", "qw", "cmd_roll", "cmd_pitch", "cmd_yaw", "cmd_thrust"]
    rows = []
    for k in range(6000):
        t = k / 500
        swing = [sum(np.sin(w * t + phase + 1.7 * i) for i, w in enumerate((1.3, 3.1, 5.9, 10.7))) for phase in (0.0, 1.0, 2.0, 3.0)]
        command = np.array([0.1 * swing[0], 0.1 * swing[1], 0.1 * swing[2], hover * (1 + 0.06 * swing[3])])
        pos = sim.data.pos[0, 0] + 1e-4 * random.standard_normal(3)
        quat = sim.data.quat[0, 0] + 1e-4 * random.standard_normal(4)
        rows.append([t, *pos, *quat / np.linalg.norm(quat), *command])
        sim.attitude_control(command.reshape(1, 1, 4))
        sim.step()
    return dict(zip(names, np.array(rows).T))


def test_identify_finds_the_model_that_flew(tmp_path):
    found = propwash.identify(commanded(), "cf2x_L250", tmp_path / "better.toml")
    assert found.dynamics == "so_rpy_rotor_drag" and "identified from" in str(found)
    for p in found.parameters:
        if p.held is None and p.name.startswith(("angle_gain", "command_gain", "rate_gain")):
            assert abs(p.value - found.before[p.name]) < 0.1 * abs(found.before[p.name]) + 4 * p.sigma, p
    assert propwash.Vehicle(tmp_path / "better.toml").to_toml() == found.vehicle.to_toml()
    assert "propwash identify" in found.vehicle.to_toml()
    with pytest.raises(ValueError, match="ends in .toml"):
        propwash.identify(tmp_path / "absent.csv", "cf2x_L250", tmp_path / "better.json")


def test_a_first_vehicle_from_mass_and_arm_flies_and_says_where_its_numbers_come_from(tmp_path):
    first = propwash.vehicle_new(0.75, 0.113, tmp_path / "quad.toml", rotors=6, layout="plus")
    assert (tmp_path / "quad.toml").read_text() == first.vehicle.to_toml() and first.vehicle.name == "quad"
    by_name = {n.name: n for n in first.numbers}
    assert by_name["mass"].value == 0.75 and by_name["mass"].source == "given"
    assert "law of scale" in by_name["inertia about x"].source and by_name["inertia about x"].sigma > 0
    assert any("rotor speeds" in line for line in first.measure_next) and "measure next" in str(first)
    sim = propwash.Sim(drone=first.vehicle, control="attitude", n_worlds=2)
    thrust = np.ravel(sim.hover_thrust())[0]
    command = np.zeros((2, 1, 4), np.float32)
    command[..., 3] = thrust
    sim.attitude_control(command)
    sim.step(250)
    assert abs(thrust - 0.75 * 9.80665) < 1e-4
    assert np.allclose(sim.data.pos, 0.0, atol=1e-2), "it hovers"


def test_motors_by_throttle_are_fitted_and_their_vehicle_is_written(tmp_path):
    # A Crazyflie that climbs and sinks, its motors as their law says and at once at their speed.
    vehicle = propwash.Vehicle("cf2x_L250")
    t = np.arange(0.0, 20.0, 0.004)
    volts = 4.1 - 0.01 * t
    hover = 2200.0
    speed = [hover * (1 + 0.05 * np.sin(2 * t + k) + 0.03 * np.sin(7 * t + 2 * k)) for k in range(4)]
    offset, emf, load = 0.2, 0.5 * 2.0 / hover, 0.4 * 2.0 / hover**2
    log = {"t": t, "vbat": volts, "px": 0 * t, "py": 0 * t, "pz": 1 + 0.2 * np.sin(t)}
    log |= {"qx": 0 * t, "qy": 0 * t, "qz": 0 * t, "qw": 1 + 0 * t}
    for k, w in enumerate(speed):
        log[f"rotor{k + 1}"] = w
        log[f"cmd_u{k + 1}"] = (offset + emf * w + load * w**2) / volts
    motors = propwash.vehicle_throttle(log, vehicle, tmp_path / "motors.toml")
    assert motors.by_speeds and motors.explained > 0.99 and motors.explained_unseen > 0.99
    for w in (0.95 * hover, hover, 1.05 * hover):
        assert abs(_settled(motors, (offset + emf * w + load * w**2) / 4.0, 4.0) / w - 1) < 0.005
    assert all(lag < 0.01 for lag, _ in motors.lag_s), "it follows at once"
    assert "back-EMF" in str(motors) and "[throttle]" in (tmp_path / "motors.toml").read_text()
    assert propwash.Vehicle(tmp_path / "motors.toml").to_toml() == motors.vehicle.to_toml()
    with pytest.raises(ValueError, match="cmd_u1"):
        propwash.vehicle_throttle({name: v for name, v in log.items() if not name.startswith("cmd_u")}, vehicle)
    with pytest.raises(FileExistsError, match="force=True"):
        propwash.vehicle_throttle(log, vehicle, tmp_path / "motors.toml")


def _settled(motors, throttle, volts):
    drive, a, b = throttle * volts - motors.offset_v, motors.back_emf_v_s_per_rad, motors.load_v_s2_per_rad2
    return 2 * drive / (a + np.sqrt(a * a + 4 * b * drive))


def test_what_no_first_vehicle_is_like_is_refused():
    for more, words in [({"rotors": 5}, "4, 6 or 8"), ({"layout": "y"}, "layout"), ({"inertia_kg_m2": [1.0]}, "3 numbers")]:
        with pytest.raises(ValueError, match=words):
            propwash.vehicle_new(0.75, 0.113, **more)
    with pytest.raises(ValueError, match="mass"):
        propwash.vehicle_new(750.0, 0.113)
