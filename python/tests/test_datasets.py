"""Data sets for learners: every form gives the samples that lie in the files of `propwash fly`."""

import hashlib
import json
import math
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import tarfile
import time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from conftest import ROOT, WALL

from propwash import PixelStatus, datasets

NOISE = "axial_base_m = 0.002\ndropout_probability = 0.05\n"
# Into a wall, along within it, and back.
PATH = "t,x,y,z\n0,1.5,-0.5,1\n1,3,-0.5,1\n2,3,0.5,1\n3,1.5,0.5,1\n"
ONE = ["--scene", "xml/forest.xml", "--drone", "cf2x_L250", "--seconds", "1", "--size", "32x24", "--fps", "10", "--seed", "3"]
TWO = ["--scene", "xml/forest.xml", "--drone", "cf2x_L250", "--drone", "hb_x500", "--trajectory", "circle", "--seconds", "0.5"]
TWO += ["--size", "16x12", "--fps", "30", "--seed", "4"]


def program():
    path = os.environ.get("PROPWASH_BIN")
    assert path, "set PROPWASH_BIN to the propwash program (cargo xtask test does)"
    return path


def fly(out, worlds, *options):
    command = [program(), "fly", *map(str, options), "--worlds", str(worlds), "--out", str(out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    """Three worlds, one drone."""
    return fly(tmp_path_factory.mktemp("one") / "set", 3, *ONE)


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """Two worlds, two drones, everything that can be stored; frames between the rows of states."""
    folder = tmp_path_factory.mktemp("two")
    (folder / "noise.toml").write_text(NOISE)
    return fly(folder / "set", 2, *TWO, "--normals", "--noise", folder / "noise.toml")


@pytest.fixture(scope="module")
def touching(tmp_path_factory):
    """A drone that flies into a wall; more frames than rows of states."""
    folder = tmp_path_factory.mktemp("touching")
    (folder / "path.csv").write_text(PATH)
    (folder / "wall.xml").write_text(WALL)
    options = ["--scene", folder / "wall.xml", "--drone", "cf2x_L250", "--trajectory", "waypoints", folder / "path.csv"]
    return fly(folder / "set", 1, *options, "--seconds", 3, "--size", "4x4", "--fps", 250, "--log-hz", 50)


@pytest.fixture(params=["one", "two"])
def path(request):
    return request.getfixturevalue(request.param)


@pytest.fixture
def copy(one, tmp_path):
    """A copy to break."""
    return shutil.copytree(one, tmp_path / "set")


def assert_same(a, b):
    """Two samples are equal in names, types and values; NaN equals NaN."""
    assert set(a) == set(b)
    for name, x in a.items():
        y = b[name]
        if isinstance(x, np.ndarray):
            assert isinstance(y, np.ndarray) and (x.dtype, x.shape) == (y.dtype, y.shape), name
            np.testing.assert_array_equal(x, y, err_msg=name)
        else:
            assert type(x) is type(y) and (x == y or (x != x and y != y)), name


def assert_all_same(samples, data):
    n = 0
    for a, b in zip(samples, data, strict=True):
        assert_same(a, b)
        n += 1
    assert n == len(data) > 0


def last_row(table, drone, step):
    """The last row of a drone at or before a step, by looking at each."""
    found = None
    for row in table:
        if row["drone"] == drone and row["step"] <= step and (found is None or row["step"] > found["step"]):
            found = row
    return found


def test_samples_are_what_the_files_hold(path):
    data = datasets.open(path)
    manifest = json.loads((path / "manifest.json").read_text())
    assert data.manifest == manifest and data.complete and data.worlds == tuple(range(manifest["n_worlds"]))
    i = 0
    for w in data.worlds:
        folder = path / f"world_{w:05d}"
        with np.load(folder / "frames.npz") as arrays:
            frames = dict(arrays)
        states = pq.read_table(folder / "states.parquet").to_pylist()
        near = pq.read_table(folder / "clearance.parquet").to_pylist()
        for f, step in enumerate(frames["step"]):
            for d in range(manifest["n_drones"]):
                s = data[i]
                assert data.where(i) == (w, f, d) == (s["world"], s["frame"], s["drone"])
                assert (s["step"], s["time_s"]) == (step, frames["time_s"][f])
                for name, array in frames.items():
                    if name.startswith("obstacle_"):
                        # They are of no drone: the world has them.
                        np.testing.assert_array_equal(data.world(w).frames(name), array)
                    elif array.ndim > 1:
                        np.testing.assert_array_equal(s[name], array[f, d])
                        assert s[name].dtype == array.dtype and not s[name].flags.writeable
                np.testing.assert_array_equal(s["k"], manifest["cameras"][d]["k"])
                row = last_row(states, d, step)
                assert s["state_step"] == row["step"]
                nan = lambda names: [math.nan if row[c] is None else row[c] for c in names.split()]
                np.testing.assert_array_equal(s["pos_m"], nan("px py pz"))
                np.testing.assert_array_equal(s["quat_xyzw"], nan("qx qy qz qw"))
                np.testing.assert_array_equal(s["vel_m_s"], nan("vx vy vz"))
                np.testing.assert_array_equal(s["ang_vel_rad_s"], nan("wx wy wz"))
                np.testing.assert_array_equal(s["specific_force_m_s2"], nan("ax ay az"))
                np.testing.assert_array_equal(s["rotor_rad_s"], nan("rotor1 rotor2 rotor3 rotor4"))
                np.testing.assert_array_equal(s["attitude_command"], nan("cmd_roll cmd_pitch cmd_yaw cmd_thrust"))
                np.testing.assert_array_equal(s["command"][[0, 4, 8, 12, 15]], nan("cmd_x cmd_vy cmd_az cmd_qw cmd_wz"))
                np.testing.assert_array_equal(s["reference"][[0, 4, 8, 9]], nan("ref_x ref_vy ref_az ref_yaw"))
                np.testing.assert_array_equal(s["wind_m_s"], nan("wind_x wind_y wind_z"))
                assert s["thrust_n"] == row["thrust"] and math.isnan(s["battery_v"]) and row["vbat"] is None
                row = last_row(near, d, step)
                distance = math.inf if row["distance"] is None else row["distance"]
                found = (row["step"], distance, row["exact"], row["geom"])
                assert (s["clearance_step"], s["clearance_m"], s["clearance_exact"], s["clearance_geom"]) == found
                i += 1
    assert i == len(data) > 0
    assert_all_same(data, [data[k] for k in range(len(data))])


def test_samples_hold_their_fields(path):
    data = datasets.open(path)
    sample = data[0]
    assert list(sample) == list(data.fields)
    assert ("normal" in sample) == ("depth_noisy_m" in sample) == (data.manifest["noise"] is not None)
    for name, f in data.fields.items():
        value = sample[name]
        if f.shape:
            assert (value.dtype, value.shape) == (np.dtype(f.dtype), f.shape), name
        else:
            assert type(value) is {"str": str, "bool": bool, "int64": int, "float64": float}[f.dtype], name
    keys = [s["key"] for s in data]
    assert keys == sorted(set(keys)) and not any("." in k for k in keys)


def test_frames_between_rows_name_the_step_of_their_state(two):
    steps = [(s["step"], s["state_step"]) for s in datasets.open(two)]
    assert any(a != b for a, b in steps) and all(0 <= a - b < 5 for a, b in steps)


def test_a_contact_is_told_by_every_frame_that_it_lasts(touching):
    data = datasets.open(touching)
    every = data.manifest["flight"]["state_every_steps"]
    rows = data.world(0).contacts().to_pylist()
    assert rows, "the drone flies into the wall"
    frames = [s["step"] for s in data]
    told = 0
    for s, before in zip(data, [-1, *frames], strict=False):
        # Since the frame before, or since the recorded step where no other lies between.
        after = min(before, s["step"] // every * every - 1)
        n = sum(after < r["step"] <= s["step"] for r in rows)
        assert (s["n_contacts"], s["contact"]) == (n, n > 0)
        told += n > 0
    # From the first recorded step of a pair to its last without a gap, every frame says so.
    lasting = {}
    for r in rows:
        if r["step"] % every == 0:
            lasting.setdefault((r["geom1"], r["geom2"]), set()).add(r["step"])
    checked = 0
    for steps in lasting.values():
        for s in data:
            at = s["step"] // every * every
            if {at, at + every} <= steps:
                assert s["contact"]
                checked += 1
    assert checked > 20 and 0 < told < len(data)


def test_contacts_of_two_drones_count_for_both(two, tmp_path):
    """Rows name the drone with the lower number; the other one is touched as well."""
    copy = shutil.copytree(two, tmp_path / "set")
    table = pq.read_table(copy / "world_00000/contacts.parquet")
    row = {n: [False] if pa.types.is_boolean(table.schema.field(n).type) else [0] for n in table.column_names}
    row |= {"step": [20], "drone": [0], "other_drone": [1]}
    replace(copy, "contacts.parquet", lambda p: pq.write_table(pa.table(row, table.schema), p), n_contacts=1)
    flags = {(s["drone"], s["step"]): s["contact"] for s in datasets.open(copy, unfinished=True) if s["world"] == 0}
    next_frame = min(step for _, step in flags if step >= 20)
    assert [k for k, v in sorted(flags.items()) if v] == [(0, next_frame), (1, next_frame)]


def replace(copy, name, write, **changes):
    """Another file in world 0, with a list of files that fits; the seal goes."""
    folder = copy / "world_00000"
    write(folder / name)
    record = json.loads((folder / "world.json").read_text()) | changes
    data = (folder / name).read_bytes()
    for f in record["files"]:
        if f["path"] == name:
            f |= {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    (folder / "world.json").write_text(json.dumps(record))
    (copy / "complete.json").unlink()


def test_images_decode_to_the_depth_of_the_frames(two):
    data = datasets.open(two)
    world = data.world(1)
    unit = data.manifest["depth_png"]["metres_per_unit"]
    seen = set()
    for noisy in (False, True):
        for f, d in [(0, 0), (3, 1), (world.n_frames - 1, 1)]:
            depth, status = datasets.decode_image(world.image(f, d, noisy=noisy), data.manifest)
            exact = world.frames("depth_noisy_m" if noisy else "depth_m")[f, d]
            np.testing.assert_array_equal(status, world.frames("status_noisy" if noisy else "status")[f, d])
            hit = status == PixelStatus.HIT
            np.testing.assert_array_equal(depth[~hit], exact[~hit])
            assert np.abs(depth[hit] - exact[hit]).max() <= 0.5 * unit * (1 + 1e-6)
            seen |= set(np.unique(status))
    assert seen >= {PixelStatus.HIT, PixelStatus.MISS}
    with pytest.raises(IndexError, match="frame: expected 0 to"):
        world.image(world.n_frames)
    with pytest.raises(IndexError, match="drone: expected 0 to 1"):
        world.image(0, 2)
    assert world.image(0).dtype == np.uint16
    with pytest.raises(TypeError, match="expected uint16, got float64"):
        datasets.decode_image(depth, data.manifest)


def test_codes_of_images_without_depth():
    manifest = {"depth_png": {"metres_per_unit": 0.001, "miss": 0, "too_far": 65535, "too_near": 65534}}
    depth, status = datasets.decode_image(np.array([0, 1, 65533, 65534, 65535], np.uint16), manifest)
    np.testing.assert_allclose(depth, [np.inf, 0.001, 65.533, 0.0, np.inf])
    assert status.tolist() == [1, 0, 0, 3, 2]


def test_tables_are_read_whole_or_by_column(one):
    world = datasets.open(one).world(2)
    assert world.states().equals(pq.read_table(one / "world_00002/states.parquet"))
    assert world.clearance(["distance", "t"]).column_names == ["distance", "t"]
    assert world.contacts().num_rows == world.record["n_contacts"]
    assert world.quarantine is None and world.info["masses_kg"] and "frames.npz" in world.files
    with pytest.raises(KeyError, match='no column \\\\?"height\\\\?"; there are t, step'):
        world.states(["height"])
    with pytest.raises(KeyError, match="no array"):
        world.frames("normal")


def test_indices_are_checked(one):
    data = datasets.open(one)
    n = len(data)
    assert_same(data[-1], data[n - 1])
    assert_same(data[np.int64(2)], data[2])
    for bad in (n, -n - 1):
        with pytest.raises(IndexError, match=f"expected a sample from -{n} to {n - 1}, got {bad}"):
            data[bad]
    for bad in (1.0, True, slice(0, 2), "0"):
        with pytest.raises(TypeError, match="index"):
            data[bad]
    with pytest.raises(ValueError, match="world: expected an integer from 0 to 2, got 3"):
        data.world(3)
    with pytest.raises(ValueError, match="cache_mb"):
        datasets.open(one, cache_mb=-1)


def test_fewer_fields_leave_the_rest_alone(one):
    data = datasets.open(one)
    few = data.with_fields("depth_m", "pos_m")
    assert list(few[0]) == ["key", "world", "drone", "frame", "step", "time_s", "depth_m", "pos_m"]
    assert len(few) == len(data) and few.fingerprint != data.fingerprint and "status" in data[0]
    with pytest.raises(KeyError, match="no field .*depth.*; there are key, world"):
        data.with_fields("depth")


def test_what_is_asked_for_alone_is_read(copy):
    """Damage in files that nobody reads stops nobody; the one who reads is told."""
    (copy / "world_00001/contacts.parquet").unlink()
    data = datasets.open(copy)
    assert sum(1 for _ in data.with_fields("depth_m", "pos_m")) == len(data)
    with pytest.raises(datasets.DamagedError, match="contacts.parquet: expected a file of .* found none"):
        list(data.with_fields("contact"))


def test_a_small_cache_changes_nothing(two):
    data = datasets.open(two)
    small = datasets.open(two, cache_mb=0)
    order = np.random.default_rng(0).permutation(len(data))[:12]
    for i in order:
        assert_same(small[int(i)], data[int(i)])


# What is broken, and what the error says.
def other_version(copy):
    path = copy / "manifest.json"
    path.write_text(path.read_text().replace('"format_version": 1', '"format_version": 2'))


def other_format(copy):
    (copy / "manifest.json").write_text('{"format": "photos"}')


def no_json(copy):
    (copy / "manifest.json").write_text('{"format": ')


def other_manifest(copy):
    path = copy / "manifest.json"
    path.write_text(path.read_text().replace('"seed": 3', '"seed": 4'))


def no_manifest(copy):
    (copy / "manifest.json").unlink()


def no_world(copy):
    shutil.rmtree(copy / "world_00001")


def other_world(copy):
    path = copy / "world_00001/world.json"
    path.write_text(path.read_text().replace('"n_contacts": 0', '"n_contacts": 1'))


def fewer_worlds(copy):
    path = copy / "complete.json"
    seal = json.loads(path.read_text())
    seal["worlds"].pop()
    path.write_text(json.dumps(seal))


def path_outside(copy):
    path = copy / "world_00001/world.json"
    path.write_text(path.read_text().replace('"states.parquet"', '"../../../etc/passwd"'))
    seal = json.loads((copy / "complete.json").read_text())
    seal["worlds"][1]["world_json_sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    (copy / "complete.json").write_text(json.dumps(seal))


@pytest.mark.parametrize(
    "damage, error, says",
    [
        (other_version, datasets.FormatError, "expected format .* version 1, found 'propwash-dataset' version 2"),
        (other_format, datasets.FormatError, "found 'photos' version None"),
        (no_json, datasets.DamagedError, "manifest.json: expected JSON"),
        (other_manifest, datasets.DamagedError, "manifest.json: expected .*sha256"),
        (no_manifest, datasets.FormatError, "without manifest.json"),
        (no_world, datasets.DamagedError, "world_00001/world.json: expected a file, found none"),
        (other_world, datasets.DamagedError, "world_00001/world.json: expected .*sha256"),
        (path_outside, datasets.DamagedError, "world_00001/world.json: expected paths inside the world's folder"),
        (fewer_worlds, datasets.DamagedError, "complete.json: expected worlds"),
    ],
)
def test_a_broken_set_does_not_open(copy, damage, error, says):
    damage(copy)
    with pytest.raises(error, match=says):
        datasets.open(copy)


def flip(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize("name", ["frames.npz", "states.parquet", "clearance.parquet", "depth/drone0_000003.png"])
@pytest.mark.parametrize("how", ["missing", "cut", "flipped"])
def test_a_broken_file_is_found(copy, name, how):
    path = copy / "world_00002" / name
    if how == "missing":
        path.unlink()
    elif how == "cut":
        path.write_bytes(path.read_bytes()[:-1])
    else:
        flip(path)
    data = datasets.open(copy)
    data[0]
    with pytest.raises(datasets.DamagedError, match=f"{name}: expected .*restore the file"):
        data.world(2).image(3) if name.endswith("png") else data[-1]
    with pytest.raises(datasets.DamagedError, match=name):
        data.verify()


def test_verify_reads_again(copy):
    data = datasets.open(copy)
    data.verify()
    flip(copy / "world_00000/contacts.parquet")
    with pytest.raises(datasets.DamagedError, match="contacts.parquet: expected sha256"):
        data.verify()


@pytest.mark.parametrize("name", ["world_00000/notes.txt", "world_00001/depth/more.png", "world_00009/world.json"])
def test_verify_finds_what_no_list_names(copy, name):
    (copy / "README.txt").write_text("beside the worlds")
    datasets.open(copy).verify()
    (copy / name).parent.mkdir(exist_ok=True)
    (copy / name).write_text("x")
    with pytest.raises(datasets.DamagedError, match=f"{name.removesuffix('/world.json')}: expected .* found another"):
        datasets.open(copy).verify()


def test_an_unfinished_set_opens_when_asked_for(copy, one):
    (copy / "complete.json").unlink()
    with pytest.raises(datasets.UnfinishedError, match="lacks the seal.*unfinished=True"):
        datasets.open(copy)
    shutil.rmtree(copy / "world_00001")
    with pytest.raises(datasets.UnfinishedError, match=r"lacks 1 worlds \(first: world 1\)"):
        datasets.open(copy)
    data = datasets.open(copy, unfinished=True)
    assert not data.complete and data.worlds == (0, 2)
    whole = datasets.open(one)
    assert_all_same(data, [s for s in whole if s["world"] != 1])
    assert [data.where(i)[0] for i in (0, len(data) - 1)] == [0, 2]
    with pytest.raises(KeyError, match="world 1 is not there"):
        data.world(1)


def test_a_set_without_frames_has_tables_and_no_samples(copy, tmp_path):
    """As the library in Rust writes it for flights without cameras, or for worlds that end before their first frame."""
    manifest = json.loads((copy / "manifest.json").read_text()) | {"cameras": [], "frames": [], "fps": 0.0}
    (copy / "manifest.json").write_text(json.dumps(manifest))
    (copy / "complete.json").unlink()
    for path in copy.glob("world_*/world.json"):
        path.write_text(json.dumps(json.loads(path.read_text()) | {"n_frames": 0}))
    data = datasets.open(copy, unfinished=True)
    assert len(data) == 0 and list(data) == [] and data.world(0).states().num_rows > 0
    assert datasets.to_arrow(data).num_rows == 0
    for make in (datasets.to_hf, lambda d: datasets.write_webdataset(d, tmp_path / "shards")):
        with pytest.raises(ValueError, match="expected at least one sample, found none"):
            make(data)
    with pytest.raises(IndexError, match="has no samples"):
        data[0]


def test_paths_that_are_no_sets(tmp_path):
    with pytest.raises(FileNotFoundError, match="found nothing"):
        datasets.open(tmp_path / "none")
    (tmp_path / "file").write_text("")
    with pytest.raises(FileNotFoundError, match="found a file"):
        datasets.open(tmp_path / "file")


def test_errors_are_those_of_the_package():
    import propwash

    assert issubclass(datasets.DamagedError, propwash.Error) and issubclass(datasets.UnfinishedError, datasets.DataSetError)


def test_pickled_sets_are_the_same_or_refuse(copy):
    data = datasets.open(copy).with_fields("depth_m", "command")
    text = pickle.dumps(data)
    assert len(text) < 2000, "arrays stay behind"
    again = pickle.loads(text)
    assert list(again.fields) == list(data.fields)
    assert_all_same(again, data)
    shutil.rmtree(copy)
    fly(copy, 3, *ONE[:-1], "5")
    with pytest.raises(datasets.DataSetError, match="another than when it was opened"):
        pickle.loads(text)


# Arrow.


def test_arrow_tables_hold_the_samples(path):
    data = datasets.open(path)
    table = datasets.to_arrow(data)
    assert table.num_rows == len(data) and table.column_names == list(data.fields)
    assert table.schema.field("pos_m").type == pa.list_(pa.float64(), 3)
    depth = table["depth_m"].combine_chunks().to_numpy_ndarray()
    np.testing.assert_array_equal(depth, [s["depth_m"] for s in data])
    samples = datasets.from_arrow(table)
    assert len(samples) == len(data) and samples.manifest == data.manifest
    assert_all_same(samples, data)
    assert_same(samples[-2], data[-2])
    assert_same(samples[3], data[3])
    with pytest.raises(IndexError):
        samples[len(data)]
    few = datasets.from_arrow(table.select(["key", "pos_m"]))
    assert list(few[0]) == ["key", "pos_m"]


def test_arrow_files_hold_the_samples(path, tmp_path):
    data = datasets.open(path)
    file = tmp_path / "samples.arrow"
    datasets.write_arrow(data, file)
    assert_all_same(datasets.from_arrow(file), data)
    assert [p.name for p in tmp_path.iterdir()] == ["samples.arrow"]
    with pytest.raises(FileExistsError, match="samples.arrow: is there already"):
        datasets.write_arrow(data, file)
    first = file.read_bytes()
    file.unlink()
    datasets.write_arrow(data, file)
    assert file.read_bytes() == first


def test_other_tables_are_refused(tmp_path):
    with pytest.raises(datasets.FormatError, match="table: expected samples of a Propwash data set"):
        datasets.from_arrow(pa.table({"a": [1]}))
    with pytest.raises(datasets.FormatError, match="expected samples of version 1, found 9"):
        datasets.from_arrow(pa.table({"a": [1]}).replace_schema_metadata(
            {"propwash": '{"format": "propwash-samples", "format_version": 9}'}
        ))
    (tmp_path / "text").write_text("no table")
    with pytest.raises(datasets.FormatError, match="expected an Arrow file"):
        datasets.from_arrow(tmp_path / "text")


# Hugging Face.


def test_hugging_face_sets_hold_the_samples(path, tmp_path):
    data = datasets.open(path)
    made = datasets.to_hf(data, cache_dir=tmp_path / "cache")
    assert made.num_rows == len(data) and made.column_names == list(data.fields)
    assert made.features["depth_m"].shape == data.fields["depth_m"].shape
    assert np.asarray(made[4]["geom_id"]).tolist() == data[4]["geom_id"].tolist()
    samples = datasets.from_hf(made)
    assert_all_same(samples, data)
    for i in (0, 7, -1):
        assert_same(samples[i], data[i])
    mixed = made.shuffle(seed=1).select(range(5))
    wanted = {s["key"]: s for s in data}
    for s in datasets.from_hf(mixed):
        assert_same(s, wanted[s["key"]])


def test_hugging_face_sets_are_saved_and_read_back(one, tmp_path):
    data = datasets.open(one)
    datasets.write_hf(data, tmp_path / "saved", cache_dir=tmp_path / "cache")
    shutil.rmtree(tmp_path / "cache")
    samples = datasets.from_hf(tmp_path / "saved")
    assert samples.manifest == data.manifest and samples.fields["depth_m"].unit == "m"
    assert_all_same(samples, data)
    with pytest.raises(FileExistsError, match="saved"):
        datasets.write_hf(data, tmp_path / "saved")


def test_another_set_in_the_same_folder_is_not_taken_from_the_cache(copy, tmp_path):
    data = datasets.open(copy).with_fields("depth_m", "pos_m")
    datasets.to_hf(data, cache_dir=tmp_path / "cache")
    shutil.rmtree(copy)
    fly(copy, 3, *ONE[:-1], "5")
    other = datasets.open(copy).with_fields("depth_m", "pos_m")
    assert_all_same(datasets.from_hf(datasets.to_hf(other, cache_dir=tmp_path / "cache")), other)


def test_other_hugging_face_sets_are_refused():
    hf = pytest.importorskip("datasets")
    with pytest.raises(datasets.FormatError, match="expected samples of a Propwash data set"):
        datasets.from_hf(hf.Dataset.from_dict({"a": [1]}))


# WebDataset.


def test_shards_hold_the_samples(path, tmp_path):
    data = datasets.open(path)
    n = len(data) // 3 + 1
    shards = datasets.write_webdataset(data, tmp_path / "shards", n)
    assert [p.name for p in shards] == ["shard-000000.tar", "shard-000001.tar", "shard-000002.tar"]
    samples = datasets.read_webdataset(tmp_path / "shards")
    assert samples.shards == shards and len(samples) == len(data) and samples.manifest == data.manifest
    assert_all_same(samples, data)
    names = tarfile.open(shards[1]).getnames()
    key = data[n]["key"]
    assert names[0].startswith(f"{key}.") and f"{key}.depth_m.npy" in names and f"{key}.json" in names


def test_the_package_webdataset_reads_the_samples(path, tmp_path):
    webdataset = pytest.importorskip("webdataset")
    data = datasets.open(path)
    shards = [str(p) for p in datasets.write_webdataset(data, tmp_path / "shards", 10)]
    raw = next(iter(webdataset.WebDataset(shards, shardshuffle=False).decode()))
    np.testing.assert_array_equal(raw["depth_m.npy"], data[0]["depth_m"])
    assert raw["__key__"] == raw["json"]["key"] == data[0]["key"] and raw["json"]["pos_m"] == data[0]["pos_m"].tolist()
    theirs = webdataset.WebDataset(shards, shardshuffle=False).decode().map(datasets.from_webdataset)
    assert_all_same(({k: v for k, v in s.items() if k != "__key__"} for s in theirs), data)
    with pytest.raises(datasets.FormatError, match="call .decode"):
        next(iter(webdataset.WebDataset(shards, shardshuffle=False).map(datasets.from_webdataset)))


def test_shards_are_the_same_bytes_each_time(one, tmp_path):
    data = datasets.open(one)
    for name in "ab":
        datasets.write_webdataset(data, tmp_path / name, 7)
    read = lambda name: {p.name: p.read_bytes() for p in (tmp_path / name).iterdir()}
    assert read("a") == read("b") and "dataset.json" in read("a")
    for member in tarfile.open(tmp_path / "a/shard-000000.tar"):
        assert (member.mtime, member.uid, member.gid, member.uname, member.gname) == (0, 0, 0, "", "")


def test_shards_hold_json_of_the_standard(one, tmp_path):
    """NaN is null: other languages refuse the word."""
    data = datasets.open(one)
    (shard,) = datasets.write_webdataset(data, tmp_path / "shards", 1000)
    refuse = lambda word: pytest.fail(f"{word} is no JSON")
    with tarfile.open(shard) as tar:
        rows = [json.load(tar.extractfile(m), parse_constant=refuse) for m in tar if m.name.endswith(".json")]
    assert len(rows) == len(data) and all(r["battery_v"] is None for r in rows)


def test_nothing_in_reach_comes_back_as_infinity(tmp_path):
    """Far from everything: an empty clearance, and depths of +inf."""
    scene = tmp_path / "far.xml"
    scene.write_text("<mujoco><worldbody><geom name='far' type='sphere' size='1' pos='0 0 -40'/></worldbody></mujoco>")
    fly(tmp_path / "set", 1, "--scene", scene, "--drone", "cf2x_L250", "--seconds", 0.2, "--size", "4x4", "--trajectory", "hover")
    data = datasets.open(tmp_path / "set")
    assert all(s["clearance_m"] == math.inf and s["clearance_geom"] == -1 and np.isinf(s["depth_m"]).all() for s in data)
    datasets.write_webdataset(data, tmp_path / "shards")
    assert_all_same(datasets.read_webdataset(tmp_path / "shards"), data)


def test_broken_shards_are_found(one, tmp_path):
    data = datasets.open(one)
    folder = tmp_path / "shards"
    shards = datasets.write_webdataset(data, folder, 10)
    flip(shards[1])
    read = iter(datasets.read_webdataset(folder))
    for _ in range(10):
        next(read)
    with pytest.raises(datasets.DamagedError, match="shard-000001.tar: expected sha256"):
        next(read)
    shards[1].unlink()
    with pytest.raises(datasets.DamagedError, match="shard-000001.tar: expected a file"):
        list(datasets.read_webdataset(folder))
    (folder / "dataset.json").unlink()
    with pytest.raises(datasets.UnfinishedError, match="expected dataset.json beside the shards"):
        datasets.read_webdataset(folder)
    with pytest.raises(datasets.FormatError, match="without dataset.json"):
        datasets.read_webdataset(tmp_path)
    with pytest.raises(FileNotFoundError):
        datasets.read_webdataset(tmp_path / "none")
    with pytest.raises(FileExistsError, match="expected an empty folder"):
        datasets.write_webdataset(data, folder)
    with pytest.raises(ValueError, match="samples_per_shard: expected an integer from 1"):
        datasets.write_webdataset(data, tmp_path / "other", 0)


# PyTorch.


def test_torch_gives_tensors_of_the_same_types(two):
    torch = pytest.importorskip("torch")
    data = datasets.open(two)
    items = datasets.TorchDataset(data)
    assert isinstance(items, torch.utils.data.Dataset) and len(items) == len(data)
    back = [{k: v.numpy() if torch.is_tensor(v) else v for k, v in items[i].items()} for i in range(len(items))]
    assert_all_same(back, data)
    items[0]["depth_m"][:] = -1.0
    assert_same(data[0], datasets.open(two)[0])
    assert datasets.TorchDataset(two, transform=lambda s: s["depth_m"].shape)[0] == (12, 16)


@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_torch_loads_with_workers(one, start):
    torch = pytest.importorskip("torch")
    data = datasets.open(one)
    data[0]  # arrays that the parent holds must do no harm
    loader = torch.utils.data.DataLoader(
        datasets.TorchDataset(data), batch_size=8, shuffle=True, num_workers=2, multiprocessing_context=start,
        generator=torch.Generator().manual_seed(0),
    )
    wanted = {s["key"]: s for s in data}
    for batch in loader:
        n = len(batch["key"])
        assert batch["depth_m"].shape == (n, 24, 32) and batch["depth_m"].dtype == torch.float32
        assert batch["contact"].dtype == torch.bool and batch["step"].dtype == torch.int64
        for i, key in enumerate(batch["key"]):
            s = wanted.pop(key)
            for name in ("depth_m", "status", "geom_id", "pos_m", "command", "k"):
                np.testing.assert_array_equal(batch[name][i].numpy(), s[name])
            assert batch["clearance_m"][i].item() == s["clearance_m"] and batch["time_s"].dtype == torch.float64
    assert not wanted, "every sample once"


# Packages that are not there.


@pytest.mark.parametrize(
    "package, extra, use",
    [
        ("pyarrow", "arrow", "list(d.open(path))"),
        ("pyarrow", "arrow", "d.to_arrow(d.open(path))"),
        ("PIL", "arrow", "d.open(path).world(0).image(0)"),
        ("datasets", "hf", "d.to_hf(d.open(path))"),
        ("datasets", "hf", "d.from_hf(path)"),
        ("torch", "torch", "d.TorchDataset(path)"),
    ],
)
def test_a_missing_package_is_named_with_its_command(one, package, extra, use):
    script = f"""
import sys
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == {package!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Hidden())
from propwash import datasets as d
path = {str(one)!r}
try:
    {use}
except ImportError as e:
    print(e)
"""
    done = python(script)
    assert f"needs the package {package}" in done and f"pip install 'propwash[{extra}]'" in done


def python(script):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_importing_and_opening_need_no_other_package(one):
    names = ["pyarrow", "PIL", "datasets", "webdataset", "torch", "ray"]
    script = f"import sys; from propwash import datasets; datasets.open({str(one)!r})"
    assert python(f"{script}; print([n for n in {names} if n in sys.modules])").strip() == "[]"


def test_extras_install_what_is_imported():
    tomllib = pytest.importorskip("tomllib")
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    code = "".join(p.read_text() for p in (ROOT / "python/propwash/datasets").glob("*.py"))
    needed = set(re.findall(r'need\("(\w+)[\w.]*", "(\w+)"\)', code)) | {("webdataset", "webdataset"), ("ray", "ray")}
    assert len(needed) >= 6
    for package, extra in needed:
        name = {"PIL": "pillow"}.get(package, package)
        assert any(re.match(rf"{name}>=\d", e) for e in extras[extra]), (package, extra)
        assert extra == "arrow" or "propwash[arrow]" in extras[extra]


# The page.


def blocks():
    return re.findall(r"^```python\n(.*?)^```$", (ROOT / "docs/datasets.md").read_text(), re.S | re.M)


@pytest.mark.parametrize("block", [pytest.param(b, id=str(k)) for k, b in enumerate(blocks())])
def test_examples_of_the_page_run(block, one, tmp_path, monkeypatch):
    for package in ("torch", "webdataset"):
        if f"import {package}" in block or f"{package.title()}Dataset" in block:
            pytest.importorskip(package)
    if "write_rerun" in block:
        pytest.importorskip("rerun", reason="rerun-sdk is no part of the test environment (100 MB)")
    monkeypatch.setenv("HF_DATASETS_CACHE", str(tmp_path / "cache"))
    shutil.copytree(one, tmp_path / "out/forest")
    for name in ("assets", "xml"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "docs/datasets.md", "exec"), {"__name__": "example"})


def test_the_page_has_examples():
    assert len(blocks()) == 8


# Many machines.

EXAMPLE = ROOT / "examples/ray_dataset.py"


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Two machines of one processor each, as Ray plays them on one."""
    pytest.importorskip("ray")
    folder = tmp_path_factory.mktemp("ray")
    (folder / "token").write_text(hashlib.sha256(os.urandom(32)).hexdigest())
    with pytest.MonkeyPatch.context() as patch:
        # Nothing is sent to Ray's makers, and nothing written to the home folder.
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_AUTH_TOKEN_PATH", str(folder / "token"))
        from ray.cluster_utils import Cluster

        made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        made.add_node(num_cpus=1)
        yield made.address
        made.shutdown()


def ray_command(address, out, worlds, *options):
    head = [sys.executable, str(EXAMPLE), "--out", str(out), "--worlds", str(worlds), "--worlds-per-task", "2"]
    return [*head, "--address", address, "--program", program(), "--", *map(str, options)]


def files(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_many_machines_make_the_same_bytes_and_go_on_after_a_kill(cluster, tmp_path):
    options = [{"0.5": "2"}.get(o, o) for o in TWO]
    worlds = 9
    expected = files(fly(tmp_path / "single", worlds, *options))
    out = tmp_path / "many"
    there = lambda: sorted(p.name for p in out.glob("world_*"))

    command = ray_command(cluster, out, worlds, *options)
    driver = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    end = time.monotonic() + 300
    while len(there()) < 3 and driver.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    driver.send_signal(signal.SIGKILL)
    said = driver.communicate()[0]
    kept = there()
    assert 3 <= len(kept) < worlds and driver.returncode == -signal.SIGKILL, said
    assert not (out / "complete.json").exists()
    with pytest.raises(datasets.UnfinishedError):
        datasets.open(out)
    inodes = {name: (out / name).stat().st_ino for name in kept}

    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    summary = json.loads(done.stdout[done.stdout.index("{") :])
    assert summary["flown_worlds"] == worlds - len(kept) and summary["resumed_worlds"] == worlds
    assert {name: (out / name).stat().st_ino for name in kept} == inodes, "what was there is kept"
    assert files(out) == expected

    # Finished: nothing is flown. Other settings: refused, nothing is changed.
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert '"flown_worlds": 0' in done.stdout
    other = ray_command(cluster, out, worlds, *options, "--obstacle-jitter", "0.1", "--sim-hz", "1000")
    done = subprocess.run(other, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode != 0 and "made with other settings" in done.stderr
    more = subprocess.run(ray_command(cluster, out, worlds + 1, *options), cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert more.returncode != 0 and "holds a data set of 9 worlds, asked for 10" in more.stderr
    assert files(out) == expected


def test_the_example_sets_its_own_options(cluster, tmp_path):
    done = subprocess.run(
        ray_command(cluster, tmp_path / "out", 2, *ONE, "--threads", "3"), cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert done.returncode != 0 and "--threads: is set by this program" in done.stderr
    assert not (tmp_path / "out").exists()
