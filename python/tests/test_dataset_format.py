"""A data set as `propwash fly` writes it, read with pyarrow, numpy and PIL. docs/formats.md is the contract."""

import hashlib
import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
WORLDS, SECONDS, WIDTH, HEIGHT, FPS = 2, 1, 32, 24, 10
HIT, MISS, TOO_FAR, TOO_NEAR = range(4)
TYPES = {"float64": pa.float64(), "int64": pa.int64(), "int32": pa.int32(), "bool": pa.bool_()}


def fly(out):
    program = os.environ.get("PROPWASH_BIN")
    assert program, "set PROPWASH_BIN to the propwash program (cargo xtask test does)"
    command = [program, "fly", "--scene", "xml/forest.xml", "--drone", "cf2x_L250", "--worlds", str(WORLDS)]
    command += ["--trajectory", "circle", "--seconds", str(SECONDS), "--camera", "fpv"]
    command += ["--size", f"{WIDTH}x{HEIGHT}", "--fps", str(FPS), "--seed", "3", "--out", str(out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("fly") / "out"
    fly(out)
    return out


@pytest.fixture(scope="module")
def manifest(run):
    return json.loads((run / "manifest.json").read_text())


@pytest.fixture(scope="module", params=range(WORLDS))
def world(request, run):
    return run / f"world_{request.param:05d}"


@pytest.fixture(scope="module")
def record(world):
    return json.loads((world / "world.json").read_text())


@pytest.fixture(scope="module")
def frames(world):
    with np.load(world / "frames.npz") as arrays:
        return dict(arrays)


def columns(world, name):
    table = pq.read_table(world / name)
    return {c: table[c].to_numpy() for c in table.column_names}


def test_the_manifest_says_what_was_asked_for(manifest):
    assert (manifest["format"], manifest["format_version"]) == ("propwash-dataset", 1)
    assert manifest["mujoco_version"] == "3.17.0"
    assert (manifest["seed"], manifest["n_worlds"], manifest["n_drones"]) == (3, WORLDS, 1)
    assert (manifest["seconds"], manifest["fps"]) == (SECONDS, FPS)
    assert "forest" in manifest["scene"]["name"]
    assert len(manifest["scene"]["sha256"]) == 64
    assert [v["name"] for v in manifest["vehicles"]] == ["cf2x_L250"]
    assert manifest["flight"]["trajectory"]["kind"] == "circle"
    (camera,) = manifest["cameras"]
    assert (camera["width"], camera["height"]) == (WIDTH, HEIGHT)
    assert camera["kind"] in ("range", "z_depth")
    k = np.array(camera["k"])
    assert k[0, 0] > 0 and k[1, 1] > 0 and k[2].tolist() == [0, 0, 1]
    assert manifest["depth_png"] == {
        "metres_per_unit": 0.001, "miss": 0, "too_far": 65535, "too_near": 65534, "max_distance": 65533
    }
    assert manifest["pixel_status"] == {"hit": HIT, "miss": MISS, "too_far": TOO_FAR, "too_near": TOO_NEAR}
    assert [g["id"] for g in manifest["geoms"]] == list(range(len(manifest["geoms"])))
    assert all(0 <= g["body"] < len(manifest["bodies"]) for g in manifest["geoms"])
    assert {b["drone"] for b in manifest["bodies"]} == {-1, 0}


def test_every_table_has_the_columns_that_the_manifest_names(manifest, world):
    assert set(manifest["tables"]) >= {"states.parquet", "contacts.parquet"}
    for name, wanted in manifest["tables"].items():
        schema = pq.read_schema(world / name)
        assert schema.names == [c["name"] for c in wanted], name
        for c in wanted:
            field = schema.field(c["name"])
            assert field.type == TYPES[c["dtype"]], c
            assert field.nullable == c["nullable"], c


def test_states_are_a_flight_log_in_si(manifest, world, record):
    s = columns(world, "states.parquet")
    flight = manifest["flight"]
    n = record["n_states"]
    assert all(len(v) == n for v in s.values())
    assert n >= SECONDS * flight["sim_hz"] // flight["state_every_steps"]
    assert set(s["drone"]) == {0}
    assert set(s["world"]) == {record["world"]}
    assert np.all(np.diff(s["step"]) == flight["state_every_steps"])
    np.testing.assert_allclose(s["t"], s["step"] / flight["sim_hz"], rtol=0, atol=1e-12)
    quat = np.column_stack([s[c] for c in ("qx", "qy", "qz", "qw")])
    np.testing.assert_allclose(np.linalg.norm(quat, axis=1), 1, rtol=0, atol=1e-12)
    pos = np.column_stack([s[c] for c in ("px", "py", "pz")])
    vel = np.column_stack([s[c] for c in ("vx", "vy", "vz")])
    assert np.isfinite(pos).all() and np.isfinite(vel).all()
    # Positions in metres and velocities in m/s of one world frame: the mean of both ends' velocities moves the drone.
    dt = np.diff(s["t"])[:, None]
    mean = 0.5 * (vel[1:] + vel[:-1])
    assert np.abs(np.diff(pos, axis=0) - mean * dt).max() < 0.05 * np.abs(mean * dt).max() + 1e-5
    rotors = np.column_stack([s[f"rotor{i}"] for i in range(1, 5)])
    assert (rotors[np.isfinite(rotors)] >= 0).all()


def test_frames_have_the_shapes_and_types_that_the_manifest_names(manifest, frames, record):
    n = record["n_frames"]
    assert n in (SECONDS * FPS, SECONDS * FPS + 1)
    sizes = {"frame": n, "drone": 1, "row": HEIGHT, "column": WIDTH, "obstacle": len(manifest.get("obstacles", []))}
    assert sorted(frames) == sorted(a["name"] for a in manifest["frames"])
    for a in manifest["frames"]:
        parts = [p.strip() for p in a["shape"].strip("()").split(",") if p.strip()]
        shape = tuple(sizes.get(p) or int(p) for p in parts)
        assert frames[a["name"]].shape == shape, a
        assert frames[a["name"]].dtype == np.dtype(a["dtype"]), a
    np.testing.assert_allclose(np.diff(frames["time_s"]), 1 / FPS, rtol=0, atol=1 / manifest["flight"]["sim_hz"])
    np.testing.assert_allclose(np.linalg.norm(frames["camera_quat_xyzw"], axis=-1), 1, rtol=0, atol=1e-12)


def test_depth_status_and_ids_agree(manifest, frames):
    (camera,) = manifest["cameras"]
    depth, status, geom, body = (frames[a] for a in ("depth_m", "status", "geom_id", "body_id"))
    hit = status == HIT
    assert hit.any(), "the forest has a floor"
    assert set(np.unique(status)) <= {HIT, MISS, TOO_FAR, TOO_NEAR}
    assert (depth[hit] >= camera["near_m"]).all() and (depth[hit] <= camera["far_m"]).all()
    assert np.isposinf(depth[(status == MISS) | (status == TOO_FAR)]).all()
    assert (depth[status == TOO_NEAR] == 0).all()
    assert ((geom == -1) == (status == MISS)).all()
    owner = np.array([g["body"] for g in manifest["geoms"]])
    seen = geom >= 0
    assert (owner[geom[seen]] == body[seen]).all()
    # The only drone never sees itself.
    drone_of = np.array([b["drone"] for b in manifest["bodies"]])
    assert (drone_of[body[seen]] == -1).all()


def test_images_are_the_exact_depth_in_units(manifest, world, frames):
    unit = manifest["depth_png"]["metres_per_unit"]
    names = sorted(p.name for p in (world / "depth").iterdir())
    assert names == [f"drone0_{f:06d}.png" for f in range(len(frames["time_s"]))]
    for f, name in enumerate(names):
        image = np.asarray(Image.open(world / "depth" / name))
        assert image.dtype == np.uint16 and image.shape == (HEIGHT, WIDTH)
        depth, status = frames["depth_m"][f, 0].astype(np.float64), frames["status"][f, 0]
        hit = status == HIT
        assert (image[hit] == np.round(depth[hit] / unit)).all()
        assert (image[hit] >= 1).all() and (image[hit] <= 65533).all()
        assert (image[status == MISS] == 0).all()
        assert (image[status == TOO_FAR] == 65535).all()
        assert (image[status == TOO_NEAR] == 65534).all()


def test_pixels_of_the_floor_lie_on_the_floor(manifest, frames):
    """K, pose and depth together put a hit where the geom is: all hits of a plane at z = 0 have z = 0."""
    (camera,) = manifest["cameras"]
    planes = [g["id"] for g in manifest["geoms"] if g["type"] == "plane"]
    assert planes, "the forest's floor is a plane"
    k = np.array(camera["k"])
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    ray = np.stack([(column + 0.5 - k[0, 2]) / k[0, 0], -(row + 0.5 - k[1, 2]) / k[1, 1], -np.ones(row.shape)], -1)
    if camera["kind"] == "range":
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    heights = []
    for f in range(len(frames["time_s"])):
        x, y, z, w = frames["camera_quat_xyzw"][f, 0]
        turn = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ])
        on = np.isin(frames["geom_id"][f, 0], planes) & (frames["status"][f, 0] == HIT)
        depth = frames["depth_m"][f, 0][on].astype(np.float64)
        points = frames["camera_pos_m"][f, 0] + depth[:, None] * (ray[on] @ turn.T)
        heights.append(points[:, 2])
    heights = np.concatenate(heights)
    assert len(heights) > 100
    assert np.abs(heights - np.median(heights)).max() < 1e-4


def test_clearance_is_the_distance_of_its_closest_points(manifest, world, record):
    assert manifest["flight"]["clearance_every_steps"] > 0
    c = columns(world, "clearance.parquet")
    assert len(c["t"]) == record["n_clearances"] > 0
    found = np.isfinite(c["distance"])
    assert found.any()
    assert (c["distance"][found] <= manifest["flight"]["clearance_max_m"] + 1e-9).all()
    gap = np.sqrt(sum((c[f"from_{a}"] - c[f"to_{a}"]) ** 2 for a in "xyz"))
    exact = found & c["exact"]
    np.testing.assert_allclose(gap[exact], np.abs(c["distance"][exact]), rtol=0, atol=1e-5)
    owner = np.array([g["body"] for g in manifest["geoms"]])
    drone_of = np.array([b["drone"] for b in manifest["bodies"]])
    assert (owner[c["geom"][found]] == c["body"][found]).all()
    assert (drone_of[owner[c["drone_geom"][found]]] == 0).all()
    assert (drone_of[c["body"][found]] == -1).all()
    assert (c["geom"][~found] == -1).all()


def test_contacts_are_between_the_drone_and_the_scene(manifest, world, record):
    c = columns(world, "contacts.parquet")
    assert len(c["t"]) == record["n_contacts"]
    owner = np.array([g["body"] for g in manifest["geoms"]])
    drone_of = np.array([b["drone"] for b in manifest["bodies"]])
    assert (owner[c["geom1"]] == c["body1"]).all() and (drone_of[c["body1"]] == 0).all()
    assert (drone_of[c["body2"]] == -1).all() and (c["other_drone"] == -1).all()
    fraction = c["fraction"].astype(float)
    assert (np.isfinite(fraction) == c["swept"]).all()
    inside = fraction[np.isfinite(fraction)]
    assert ((inside >= 0) & (inside <= 1)).all()


def test_the_seal_covers_every_file(run):
    seal = json.loads((run / "complete.json").read_text())
    digest = lambda path: hashlib.sha256(path.read_bytes()).hexdigest()
    assert seal["manifest_sha256"] == digest(run / "manifest.json")
    assert len(seal["worlds"]) == WORLDS
    for world in seal["worlds"]:
        folder = run / world["dir"]
        assert world["world_json_sha256"] == digest(folder / "world.json")
        files = json.loads((folder / "world.json").read_text())["files"]
        listed = {f["path"] for f in files}
        there = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
        assert listed | {"world.json"} == there
        for f in files:
            path = folder / f["path"]
            assert (path.stat().st_size, digest(path)) == (f["bytes"], f["sha256"])


def test_the_overview_is_a_picture(run):
    image = np.asarray(Image.open(run / "overview.png"))
    assert image.shape == (1100, 1600, 3)
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 200


def test_another_run_and_a_run_that_lost_a_world_give_the_same_bytes(run, tmp_path):
    read = lambda folder: {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    expected = read(run)
    out = tmp_path / "again"
    fly(out)
    assert read(out) == expected
    for p in (out / "world_00001" / "depth").iterdir():
        p.unlink()
    (out / "complete.json").unlink()
    fly(out)
    assert read(out) == expected
