"""Recordings for the viewer of Rerun. Most tests read them back by ``rerun-sdk``, which is no part of the test environment: it has 100 MB.
They run where it is installed: ``pip install 'propwash[rerun]'``."""

import subprocess
import sys
import types

import mujoco
import numpy as np
import pytest
from conftest import ROOT, WALL

import propwash
from propwash import _rerun, datasets

WHY = "rerun-sdk is no part of the test environment (100 MB): pip install 'propwash[rerun]' to run this test"


@pytest.fixture
def rr():
    return pytest.importorskip("rerun", reason=WHY)


@pytest.fixture(scope="module")
def crash(tmp_path_factory):
    """Two worlds of two drones. The first drone flies into a wall and out of it; a camera with a lens of its own that measures along rays."""
    out = tmp_path_factory.mktemp("crash") / "set"
    sim = propwash.Sim(2, 2, scene=WALL)

    def on_reset(_):
        sim.set_initial(pos=[[2.6, 0.0, 1.0], [0.0, 1.0, 1.2]])

    eye = propwash.Camera(
        mount="drone", pos=(0.02, 0.0, 0.03), resolution=(20, 14), pinhole_px=(11.0, 9.0, 8.5, 6.0), range=(0.05, 4.0), kind="range"
    )
    noise = {"axial_base_m": 0.01, "dropout_probability": 0.1}
    recorder = propwash.Recorder(out, sim, seconds=1.2, fps=20, log_freq=50, camera=eye, noise=noise, on_reset=on_reset)
    for _ in recorder:
        while recorder.flying:
            t = sim.time[0]
            sim.obstacle_pos[:, 0] = [0.5 * t, 4.0, 1.0]
            command = np.zeros((2, 2, 16))
            command[:, :, :3] = [[3.1 if t < 0.5 else 2.0, 0.0, 1.0], [0.0, 1.0, 1.2]]
            command[1, 1, 1] = 2.0
            command[..., 12] = 1.0
            sim.state_control(command)
            recorder.step(5)
    return datasets.open(out)


@pytest.fixture(scope="module")
def zoo(tmp_path_factory):
    """Every kind of geom, seen from many places."""
    out = tmp_path_factory.mktemp("zoo") / "set"
    camera = {"name": "fpv", "width": 48, "height": 36}
    propwash.fly(out, scene="zoo", drone="cf2x_L250", trajectory="circle", seconds=4.0, fps=5, camera=camera, n_worlds=1)
    return datasets.open(out)


class Read:
    """A recording as it was written."""

    def __init__(self, rr, path):
        self.recording = rr.dataframe.load_recording(path)
        columns = self.recording.schema().component_columns()
        self.entities = sorted({c.entity_path for c in columns})
        self.static = {(c.entity_path, c.component) for c in columns if c.is_static}

    def once(self, entity, component):
        """Values of a component that holds at all times."""
        view = self.recording.view(index="time", contents=entity)
        table = view.select_static(f"{entity}:{component}").read_all()
        return table.column(0)[0].as_py()

    def times(self, entity, component):
        """Times (s) and values of a component."""
        view = self.recording.view(index="time", contents=entity)
        table = view.select("time", f"{entity}:{component}").read_all()
        rows = [(t, v) for t, v in zip(table.column(0).cast("int64").to_pylist(), table.column(1).to_pylist()) if v is not None]
        return np.array([t * 1e-9 for t, _ in rows]), [v for _, v in rows]

    def poses(self, entity):
        time_s, pos = self.times(entity, "Transform3D:translation")
        _, quat = self.times(entity, "Transform3D:quaternion")
        return time_s, np.array(pos)[:, 0], np.array(quat)[:, 0]

    def images(self, entity, kind, dtype, shape):
        time_s, buffers = self.times(entity, f"{kind}:buffer")
        return time_s, np.stack([np.array(b[0], np.uint8).view(dtype).reshape(shape) for b in buffers])


def written(rr, tmp_path, source, **options):
    return Read(rr, propwash.write_rerun(source, tmp_path / "a.rrd", force=True, **options))


def matrix(quat):
    x, y, z, w = np.asarray(quat, np.float64) / np.linalg.norm(quat)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def points(read, depth, k, frame, drone=0):
    """The pixels of a depth image in the world, as Rerun puts them there: its axis of depth and image are those of ``camera_xyz``."""
    # Right, up, back are 3, 1, 6 of Rerun's directions: right is x, down is -y, forward is -z.
    assert read.once(f"/world/cameras/drone{drone}", "Pinhole:camera_xyz") == [[3, 1, 6]]
    held = np.array(read.once(f"/world/cameras/drone{drone}", "Pinhole:image_from_camera")).reshape(3, 3).T  # columns first
    assert np.allclose(held, k, rtol=1e-6)
    _, pos, quat = read.poses(f"/world/cameras/drone{drone}")
    row, column = np.indices(depth.shape)
    right, down = (column + 0.5 - held[0, 2]) / held[0, 0] * depth, (row + 0.5 - held[1, 2]) / held[1, 1] * depth
    return pos[frame] + np.stack([right, -down, -depth], axis=-1) @ matrix(quat[frame]).T


# Without rerun-sdk.


def test_a_missing_package_is_named_with_its_command(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rerun", None)
    sim = propwash.Sim()
    with pytest.raises(ImportError, match=r"a recording for Rerun needs the package rerun, which is not installed: pip install 'propwash\[rerun\]'"):
        propwash.write_rerun(sim, tmp_path / "a.rrd")
    with pytest.raises(ValueError, match=r"ends with \.rrd"):
        propwash.write_rerun(sim, tmp_path / "a.mp4")
    (tmp_path / "b.rrd").write_bytes(b"mine")
    with pytest.raises(FileExistsError, match="force=True"):
        propwash.write_rerun(sim, tmp_path / "b.rrd")
    assert [path.name for path in tmp_path.iterdir()] == ["b.rrd"] and (tmp_path / "b.rrd").read_bytes() == b"mine"


def test_the_extra_installs_it():
    text = (ROOT / "pyproject.toml").read_text()
    assert 'rerun = ["propwash[arrow]", "rerun-sdk>=' in text


@pytest.mark.parametrize("scene", propwash.scenes())
def test_colours_and_carriers_are_those_of_the_scene(scene):
    sim = propwash.Sim(1, 2, scene=scene)
    model, _ = sim.mujoco()
    for geom in sim.scene.geoms:
        assert np.allclose(_rerun._color(model, geom.id), geom.rgba, atol=1e-6), geom.name
        assert _rerun._alpha(model, geom.id) == pytest.approx(geom.alpha), geom.name
    drones, obstacles = _rerun._carriers(types.SimpleNamespace(escape_entity_path_part=str), model, 2)
    assert [sim.scene.bodies[b].drone for b in drones] == [0, 1] and list(drones.values()) == ["world/drone0", "world/drone1"]
    assert list(obstacles) == [o.body_id for o in sim.scene.obstacles]
    assert list(obstacles.values()) == [f"world/obstacles/{o.name}" for o in sim.scene.obstacles]


@pytest.mark.parametrize("scene", ["zoo", "terrain"])
def test_the_triangles_of_height_fields_are_those_that_rays_meet(scene):
    model, data = propwash.Sim(scene=scene).mujoco()
    (geom,) = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD)
    vertices, faces = _rerun._hfield(model, int(model.geom_dataid[geom]))
    triangles = vertices[faces]
    middle, turn = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    rng, hits = np.random.default_rng(0), 0
    x, y, _, base = model.hfield_size[0]
    for _ in range(40):
        start, to = rng.uniform(-2, 2, 3) * [x, y, 1.0] + [0.0, 0.0, 3.0], rng.uniform(-1, 1, 3) * [x, y, base]
        way = (to - start) / np.linalg.norm(to - start)
        metres = mujoco.mj_rayHfield(model, data, geom, middle + turn @ start, turn @ way)
        if metres >= 0.0:
            hits += 1
            assert distance(start + metres * way, triangles).min() < 1e-6
    assert hits > 25


# With it.


@pytest.mark.parametrize("number", [0, 1])
def test_poses_velocities_and_clearances_are_those_of_the_data_set(rr, crash, tmp_path, number):
    read, world = written(rr, tmp_path, crash, world=number), crash.world(number)
    assert [c.name for c in read.recording.schema().index_columns()] == ["time"]
    assert read.once("/world", "ViewCoordinates:xyz") == [[3, 5, 1]]  # right, forward, up
    states, clearance = world.states().to_pandas(), world.clearance().to_pandas()
    for d in range(2):
        own = states[states["drone"] == d]
        time_s, pos, quat = read.poses(f"/world/drone{d}")
        assert len(own) == 61 and np.allclose(time_s, own["t"], atol=1e-9)
        assert np.array_equal(pos, own[["px", "py", "pz"]].astype(np.float32))
        assert np.array_equal(quat, own[["qx", "qy", "qz", "qw"]].astype(np.float32))
        (strip,) = read.once(f"/world/paths/drone{d}", "LineStrips3D:strips")
        assert np.array_equal(np.array(strip), pos)
        _, vel = read.times(f"/plots/velocity/drone{d}", "Scalars:scalars")
        assert np.array_equal(np.array(vel), own[["vx", "vy", "vz"]])
        assert read.once(f"/plots/velocity/drone{d}", "SeriesLines:names") == [f"drone {d} {c}, m/s" for c in ("vx", "vy", "vz")]
        near = clearance[clearance["drone"] == d]
        time_s, values = read.times(f"/plots/clearance/drone{d}", "Scalars:scalars")
        assert np.allclose(time_s, near["t"], atol=1e-9) and np.array_equal(np.array(values)[:, 0], near["distance"], equal_nan=True)
    time_s, pos, _ = read.poses("/world/obstacles/gate")
    assert np.array_equal(pos, world.frames("obstacle_pos_m")[:, 0].astype(np.float32)) and pos[-1, 0] > 0.5


def test_depth_is_where_the_scene_is(rr, crash, tmp_path, monkeypatch):
    monkeypatch.setattr(_rerun, "_BATCH_BYTES", 5000)  # five images of 1,120 bytes at a time
    read, world, shape = written(rr, tmp_path, crash), crash.world(0), (14, 20)
    k = np.array(crash.manifest["cameras"][1]["k"])
    names = {c["class_id"]: c["class_description"]["info"]["label"] for c in read.once("/world", "AnnotationContext:context")[0]}
    seen = set()
    for d in range(2):
        entity = f"/world/cameras/drone{d}"
        assert read.once(entity, "Pinhole:resolution") == [[20.0, 14.0]]
        assert read.once(f"{entity}/depth", "DepthImage:meter") == [1.0]
        time_s, depth = read.images(f"{entity}/depth", "DepthImage", np.float32, shape)
        _, labels = read.images(f"{entity}/labels", "SegmentationImage", np.uint16, shape)
        _, noisy = read.images(f"{entity}/depth_noisy", "DepthImage", np.float32, shape)
        ids, hit = world.frames("geom_id")[:, d], world.frames("status")[:, d] == 0
        assert np.allclose(time_s, world.frames("time_s"), atol=1e-9) and len(time_s) == 25
        assert np.array_equal(labels, np.where(ids < 0, 65535, ids))
        assert np.array_equal(depth > 0.0, hit) and np.isfinite(depth).all()
        assert np.array_equal(noisy > 0.0, world.frames("status_noisy")[:, d] == 0)
        # Along the axis, while the camera of the data set measures along the ray.
        row, column = np.indices(shape)
        ray = np.sqrt(1.0 + ((column + 0.5 - 8.5) / 11.0) ** 2 + ((row + 0.5 - 6.0) / 9.0) ** 2)
        assert np.allclose((depth * ray)[hit], world.frames("depth_m")[:, d][hit], rtol=1e-6)
        for f in range(len(time_s)):
            where = points(read, depth[f], k, f, d)
            for i in np.unique(labels[f][hit[f]]):
                on = where[hit[f] & (labels[f] == i)]
                seen.add(names[i])
                if names[i] == "floor":
                    assert np.abs(on[:, 2]).max() < 1e-5
                if names[i] == "wall":  # 0.2 m thick at 3 m, 10 m high
                    outside = np.abs(on - [3.0, 0.0, 0.0]) - [0.1, 5.0, 5.0]
                    assert np.abs(outside.max(axis=1)).max() < 1e-5
                if names[i] == "bar":
                    assert np.allclose(np.linalg.norm(on - world.frames("obstacle_pos_m")[f, 0], axis=1), 0.5, atol=1e-5)
    assert {"floor", "wall"} <= seen and names[65535] == "nothing"


def test_contacts_come_and_go(rr, crash, tmp_path):
    read, world = written(rr, tmp_path, crash), crash.world(0)
    rows = world.contacts().to_pandas()
    rows, entity = rows[rows["drone"] == 0], "/world/contacts/drone0"
    time_s, origins = read.times(entity, "Arrows3D:origins")
    _, vectors = read.times(entity, "Arrows3D:vectors")
    _, labels = read.times(entity, "Arrows3D:labels")
    _, positions = read.times(entity, "Points3D:positions")
    assert len(time_s) == len(origins) == len(vectors) == len(positions) and len(rows) > 10
    found = 0
    for t, origin, vector, point, label in zip(time_s, origins, vectors, positions, labels):
        own = rows[np.abs(rows["t"] - t) < 1e-6]
        assert len(own) == len(origin) == len(vector) == len(point) == len(label)
        found += len(own)
        if len(own):
            assert np.array_equal(origin, own[["x", "y", "z"]].astype(np.float32)) and np.array_equal(point, origin)
            assert np.allclose(vector, 0.1 * own[["nx", "ny", "nz"]], atol=1e-7)
            assert label == [crash.manifest["geoms"][g]["name"] for g in own["geom2"]] and set(label) == {"wall"}
    assert found == len(rows)
    # After the last contact of a touch, the next recorded step has none.
    states = world.states().to_pandas()
    recorded = states[states["drone"] == 0]["t"].to_numpy()
    last = rows["t"].max()
    assert origins[-1] == [] and time_s[-1] == pytest.approx(recorded[recorded > last + 1e-9][0])
    touching = {round(t * 500) for t in rows["t"]}
    for t, origin in zip(time_s, origins):
        assert bool(origin) == (round(t * 500) in touching)
    # A drone that touches nothing.
    assert len(read.times("/world/drone1", "Transform3D:translation")[0]) == 61
    assert not any(c == "Points3D:positions" for e, c in read.static) and "/world/contacts/drone1" in read.entities


def far(kind, read, entity, p):
    """How far points in the frame of a geom are from its surface, m."""
    if kind == "box":
        outside = np.abs(p) - read.once(entity, "Boxes3D:half_sizes")[0]
        return np.abs(outside.max(axis=1))
    if kind in ("sphere", "ellipsoid"):
        half = np.array(read.once(entity, "Ellipsoids3D:half_sizes")[0])
        return np.abs(np.linalg.norm(p / half, axis=1) - 1.0) * half.max()
    if kind == "plane":  # without an end, of which a part is drawn
        assert (np.array(read.once(entity, "Mesh3D:vertex_positions"))[:, 2] == 0.0).all()
        return np.abs(p[:, 2])
    if kind == "cylinder":
        radius, length = read.once(entity, "Cylinders3D:radii")[0], read.once(entity, "Cylinders3D:lengths")[0]
        return np.abs(np.maximum(np.hypot(p[:, 0], p[:, 1]) - radius, np.abs(p[:, 2]) - length / 2))
    if kind == "capsule":
        radius, length = read.once(entity, "Capsules3D:radii")[0], read.once(entity, "Capsules3D:lengths")[0]
        own = p - read.once(entity, "Capsules3D:translations")[0]  # from one end, along z
        return np.abs(np.linalg.norm(own - np.clip(own[:, 2:], 0.0, length) * [0, 0, 1], axis=1) - radius)
    corners = np.array(read.once(entity, "Mesh3D:vertex_positions"))[np.array(read.once(entity, "Mesh3D:triangle_indices"))]
    return np.array([distance(one, corners).min() for one in p])


def distance(p, triangles):
    """How far a point is from triangles, m: from their planes where it is over them, else from their edges."""
    a, b, c = (triangles[:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    over = np.abs(normal).max(axis=1) > 0.5  # not of triangles without an area
    edge = np.full(len(a), np.inf)
    for u, v in ((a, b), (b, c), (c, a)):
        over &= np.einsum("ij,ij->i", np.cross(v - u, p - u), normal) >= 0.0
        along = np.clip(np.einsum("ij,ij->i", p - u, v - u) / np.maximum(np.einsum("ij,ij->i", v - u, v - u), 1e-30), 0.0, 1.0)
        edge = np.minimum(edge, np.linalg.norm(u + along[:, None] * (v - u) - p, axis=1))
    return np.where(over, np.abs(np.einsum("ij,ij->i", p - a, normal)), edge)


def test_what_cameras_see_lies_on_the_shapes_that_are_drawn(rr, zoo, tmp_path):
    """Every pixel of every geom, in the frame of the geom's entity."""
    read, shape = written(rr, tmp_path, zoo), (36, 48)
    k = np.array(zoo.manifest["cameras"][0]["k"])
    _, depth = read.images("/world/cameras/drone0/depth", "DepthImage", np.float32, shape)
    _, labels = read.images("/world/cameras/drone0/labels", "SegmentationImage", np.uint16, shape)
    movers = {name: read.poses(f"/world/obstacles/{name}") for name in ("mover_mocap", "mover_free")}
    checked = set()
    for f in range(0, len(depth), 2):
        where = points(read, depth[f], k, f)
        for i in np.unique(labels[f][depth[f] > 0.0]):
            geom = zoo.manifest["geoms"][i]
            mover = next((m for m in movers if geom["name"].startswith(m)), None)
            p = where[(labels[f] == i) & (depth[f] > 0.0)][::7]
            entity = f"/world/scene/{geom['name']}"
            if mover is not None:
                entity, (_, pos, quat) = f"/world/obstacles/{mover}/{geom['name']}", movers[mover]
                p = (p - pos[f]) @ matrix(quat[f])
            turn = np.array(read.once(entity, "Transform3D:mat3x3")).reshape(3, 3).T  # columns first
            p = (p - read.once(entity, "Transform3D:translation")[0]) @ turn
            # MuJoCo draws a signed distance field by triangles that it finds in it.
            limit = 0.03 if geom["type"] == "sdf" else 1e-4
            assert far(geom["type"], read, entity, p).max() < limit, geom["name"]
            checked.add(geom["type"])
    assert checked >= {"plane", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh", "sdf", "hfield"}


def test_a_scene_has_what_cameras_may_see_in_its_colours(rr, zoo, tmp_path):
    read, info = written(rr, tmp_path, zoo), propwash.Sim(scene="zoo").scene
    drawn = [g for g in info.geoms if g.alpha > 0.0 and g.group < 3]
    carried = {13: "obstacles/mover_mocap", 14: "obstacles/mover_mocap", 15: "obstacles/mover_free"}
    color = {"box": "Boxes3D:colors", "sphere": "Ellipsoids3D:colors", "ellipsoid": "Ellipsoids3D:colors"}
    color |= {"cylinder": "Cylinders3D:colors", "capsule": "Capsules3D:colors"}
    expected = set()
    for g in drawn:
        entity = f"/world/drone0/{g.name.split('/')[-1]}" if g.drone == 0 else f"/world/{carried.get(g.body_id, 'scene')}/{g.name}"
        expected.add(entity)
        (held,) = read.once(entity, color.get(g.kind, "Mesh3D:albedo_factor"))
        assert np.abs(np.array([held >> s & 255 for s in (24, 16, 8, 0)]) - 255 * np.array(g.rgba)).max() <= 0.51, g.name
    made = {e for e in read.entities if (e, "Transform3D:mat3x3") in read.static}
    assert made == expected and len(made) < len(info.geoms)


def test_a_sim_is_shown_as_it_is_now(rr, tmp_path):
    sim = propwash.Sim(2, 2, scene=WALL)
    sim.set_initial(pos=[[0.0, 0.0, 1.0], [0.5, 0.5, 1.2]])
    sim.reset()
    sim.obstacle_pos[1, 0] = [1.0, 2.0, 3.0]
    sim.step(50)
    read = written(rr, tmp_path, sim, world=1)
    for d in range(2):
        time_s, pos, quat = read.poses(f"/world/drone{d}")
        assert time_s == pytest.approx([0.1]) and np.array_equal(pos[0], sim.data.pos[1, d]) and np.array_equal(quat[0], sim.data.quat[1, d])
    assert read.poses("/world/obstacles/gate")[1].tolist() == [[1.0, 2.0, 3.0]]
    assert {"/world/scene/wall", "/world/scene/floor", "/world/obstacles/gate/bar", "/world/drone0/board"} <= set(read.entities)
    bare = written(rr, tmp_path, propwash.Sim())
    assert "/world/drone0" in bare.entities and not any(e.startswith("/world/scene") for e in bare.entities)
    with pytest.raises(ValueError, match="world: expected an integer from 0 to 1, got 2"):
        propwash.write_rerun(sim, tmp_path / "no.rrd", world=2)
    sim.data.pos[1, 0, 0] = np.nan
    with pytest.raises(propwash.Error, match="not finite"):
        propwash.write_rerun(sim, tmp_path / "no.rrd", world=1)
    assert [path.name for path in tmp_path.iterdir()] == ["a.rrd"]


def test_paths_versions_and_the_viewer(rr, crash, tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(_rerun, "subprocess", types.SimpleNamespace(Popen=lambda words, **_: calls.append(words)))
    made = propwash.write_rerun(str(crash.path), str(tmp_path / "a.rrd"), spawn=True)
    assert made == tmp_path / "a.rrd" and calls == [[sys.executable, "-m", "rerun", "--bind", "127.0.0.1", str(made)]]
    done = subprocess.run([sys.executable, "-m", "rerun", "rrd", "verify", str(made)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    with pytest.raises(ValueError, match="world: expected an integer from 0 to 1, got 2"):
        propwash.write_rerun(crash, tmp_path / "no.rrd", world=2)
    monkeypatch.setitem(crash.manifest, "mujoco_version", "9.9.9")
    with pytest.raises(propwash.Error, match=f"compiled by MuJoCo {mujoco.__version__}, found one of 9.9.9"):
        propwash.write_rerun(crash, tmp_path / "no.rrd")
    monkeypatch.undo()
    monkeypatch.delitem(crash.manifest["scene"], "mjb_sha256")
    with pytest.warns(UserWarning, match="did not keep its scene"):
        read = written(rr, tmp_path, crash)
    assert "/world/drone0" in read.entities and not any(e.startswith("/world/scene") for e in read.entities)
    monkeypatch.undo()
    monkeypatch.setattr(_rerun, "_NOTHING", 5)
    with pytest.warns(UserWarning, match="labels are left out: expected at most 5 geoms"):
        assert "/world/cameras/drone0/labels" not in written(rr, tmp_path, crash).entities
    assert [path.name for path in tmp_path.iterdir()] == ["a.rrd"]
