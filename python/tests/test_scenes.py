"""The scenes in xml/ and the shells in xml/shells/, as MuJoCo itself sees them."""

import struct
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
import zlib
from pathlib import Path

import mujoco
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
SCENES = sorted(p.name for p in (ROOT / "xml").glob("*.xml"))
SHELLS = sorted(p.name for p in (ROOT / "xml" / "shells").glob("*.xml"))
START = np.array([0.0, 0.0, 1.0])
GEOM = mujoco.mjtGeom
USUAL_GROUPS = np.array([1, 1, 1, 0, 0, 0], np.uint8)


def load(path):
    model = mujoco.MjModel.from_xml_path(str(ROOT / "xml" / path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def names(model, kind, count):
    return [mujoco.mj_id2name(model, kind, i) for i in range(count)]


def directions(count):
    """Directions spread evenly over the sphere (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    a = np.pi * (1 + np.sqrt(5)) * k
    r = np.sqrt(1 - z * z)
    return np.column_stack([r * np.cos(a), r * np.sin(a), z])


def ray(model, data, start, direction, groups=None):
    """Distance and name of the first hit; None for a miss."""
    hit = np.array([-1], np.int32)
    distance = mujoco.mj_ray(model, data, np.asarray(start, float), np.asarray(direction, float), groups, 1, -1, hit)
    return None if distance < 0 else (distance, model.geom(int(hit[0])).name)


def with_probe(path, radius):
    """The scene with a ball that can be put anywhere and that makes contacts with what has the default collision bits."""
    spec = mujoco.MjSpec.from_file(str(ROOT / "xml" / path))
    body = spec.worldbody.add_body(name="probe")
    body.add_freejoint()
    body.add_geom(name="probe", size=[radius, 0, 0])
    model = spec.compile()
    return model, mujoco.MjData(model)


def put_probe(model, data, at):
    data.qpos[model.joint(int(model.body("probe").jntadr[0])).qposadr[0] :][:3] = at
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    probe = model.geom("probe").id
    touched = set()
    for c in data.contact:
        if probe in c.geom:
            touched.add(model.geom(int(c.geom[0] + c.geom[1] - probe)).name)
    return touched


def test_the_scenes_and_shells_that_the_docs_name_are_there():
    assert SCENES == ["corridor.xml", "forest.xml", "meshes.xml", "room.xml", "terrain.xml", "zoo.xml"]
    assert SHELLS == ["cf21B.xml", "cf2x.xml", "hb_x500.xml"]


def test_the_table_in_the_docs_counts_right():
    table = {}
    for line in (ROOT / "docs" / "scenes.md").read_text().splitlines():
        cells = [c.strip() for c in line.split("|")]
        if len(cells) == 7 and cells[1].startswith("`xml/"):
            table[cells[1].strip("`").removeprefix("xml/")] = (int(cells[2]), int(cells[3]))
    counted = {}
    for path in SCENES:
        model, _ = load(path)
        counted[path] = (model.ngeom, model.nbody - 1)
    assert table == counted


@pytest.mark.parametrize("path", SCENES + [f"shells/{s}" for s in SHELLS])
def test_everything_has_a_name_and_strict_parsers_read_the_file(path):
    ElementTree.parse(ROOT / "xml" / path)
    model, _ = load(path)
    for kind, count in (
        (mujoco.mjtObj.mjOBJ_GEOM, model.ngeom),
        (mujoco.mjtObj.mjOBJ_BODY, model.nbody),
        (mujoco.mjtObj.mjOBJ_CAMERA, model.ncam),
    ):
        found = names(model, kind, count)
        assert found and all(found), f"{kind}: {found}"


@pytest.mark.parametrize("path", SCENES)
def test_scenes_have_their_cameras_their_arena_and_no_options_of_dynamics(path):
    model, _ = load(path)
    assert {"overview", "top"} <= set(names(model, mujoco.mjtObj.mjOBJ_CAMERA, model.ncam))
    assert model.narena == 16 * 2**20
    assert model.nkey == 0 and model.nu == 0
    plain = mujoco.MjModel.from_xml_string("<mujoco/>")
    for field in ("timestep", "integrator", "gravity", "density", "viscosity", "wind", "disableflags", "enableflags", "cone", "o_margin"):
        assert np.array_equal(getattr(model.opt, field), getattr(plain.opt, field)), field


@pytest.mark.parametrize("path", SCENES)
def test_no_geom_is_within_80_cm_of_the_start(path):
    model, data = with_probe(path, 1e-3)
    put_probe(model, data, START)
    probe = model.geom("probe").id
    for g in range(model.ngeom):
        # mj_geomDistance is wrong on these two (see the test of it below); the rays see them.
        if g != probe and model.geom_type[g] not in (GEOM.mjGEOM_HFIELD, GEOM.mjGEOM_SDF):
            distance = mujoco.mj_geomDistance(model, data, probe, g, 2.0, None)
            assert distance > 0.8, f"{model.geom(g).name} is {distance} m near the start"
    model, data = load(path)
    for d in directions(4000):
        hit = ray(model, data, START, d)
        assert hit is None or hit[0] > 0.8, f"{hit} towards {d}"


@pytest.mark.parametrize("path", SCENES)
def test_every_scene_has_moving_obstacles(path):
    model, _ = load(path)
    assert model.nmocap >= 1
    for b in range(model.nbody):
        if model.body_mocapid[b] >= 0:
            assert model.body(b).name.startswith("mover_")
            assert model.body_geomnum[b] > 0


@pytest.mark.parametrize("path", ["forest.xml", "corridor.xml", "room.xml", "terrain.xml", "meshes.xml"])
def test_most_of_the_flight_space_is_free_and_depth_pictures_have_something_to_see(path):
    """A path of the default shape, x and y within 2 m, z from 0.6 to 1.6 m."""
    model, data = with_probe(path, 0.07)
    t = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    flight = np.column_stack([2 * np.sin(t), 2 * np.sin(2 * t), 1.1 + 0.5 * np.sin(3 * t)])
    touching = [put_probe(model, data, p) for p in flight]
    assert sum(bool(names) for names in touching) <= 0.15 * len(flight), set().union(*touching)
    # Looking along the path, within a cone, most pictures hold something other than the ground nearer than 5 m.
    rich = 0
    model, data = load(path)
    for p, ahead in zip(flight, np.roll(flight, -1, 0) - flight):
        near = []
        for d in directions(600):
            if d @ ahead > 0.8 * np.linalg.norm(ahead):
                hit = ray(model, data, p, d)
                near.append(hit is not None and hit[0] < 5 and hit[1] not in ("ground", "floor", "ceiling"))
        rich += np.mean(near) > 0.05
    assert rich > 0.6 * len(flight)


def test_the_forest_has_trees_of_several_shapes_rocks_and_logs():
    model, _ = load("forest.xml")
    kinds = [n.split("_")[0] for n in names(model, mujoco.mjtObj.mjOBJ_BODY, model.nbody)]
    trees = {k: kinds.count(k) for k in ("pine", "oak", "birch", "poplar", "dead", "bush")}
    assert sum(trees.values()) >= 40 and all(trees.values()), trees
    assert kinds.count("rock") >= 5 and kinds.count("log") >= 3
    assert {int(t) for t in model.geom_type} >= {GEOM.mjGEOM_CAPSULE, GEOM.mjGEOM_ELLIPSOID, GEOM.mjGEOM_PLANE}


def test_a_drone_can_fly_through_every_gate_of_the_corridor_and_hits_its_frame():
    model, data = with_probe("corridor.xml", 0.3)
    gates = [b for b in range(model.nbody) if model.body(b).name.startswith("gate_")]
    assert len(gates) >= 4
    for b in gates:
        frame = [
            g
            for g in range(model.body_geomadr[b], model.body_geomadr[b] + model.body_geomnum[b])
            if "_post_" not in model.geom(g).name
        ]
        mujoco.mj_kinematics(model, data)
        middle = data.geom_xpos[frame].mean(0)
        forward = data.xmat[b].reshape(3, 3)[:, 0]
        own = {model.geom(g).name for g in frame}
        for s in np.linspace(-0.5, 0.5, 11):
            assert not put_probe(model, data, middle + s * forward) & own, model.body(b).name
        assert put_probe(model, data, data.geom_xpos[frame[0]]) & own


def test_the_door_and_the_square_window_of_the_room_are_open():
    model, data = load("room.xml")
    for at in ((2.4, 2.0, 1.2), (1.0, -2.0, 1.3)):
        outwards = [0, np.sign(at[1]), 0]
        assert ray(model, data, at, outwards) is None
    assert ray(model, data, START, [-1, 0, 0])[1].startswith(("wall", "sofa", "picture", "cushion"))
    assert ray(model, data, [1.5, 0, 1], [0, 0, 1])[1] == "ceiling"


def test_things_on_the_terrain_stand_on_it():
    model, data = load("terrain.xml")
    ground = model.geom("ground").id
    stood = 0
    for b in range(1, model.nbody):
        name = model.body(b).name
        if name.startswith(("tree_", "rock_")):
            x, y, z = data.xpos[b]
            drop = mujoco.mj_rayHfield(model, data, ground, np.array([x, y, 20.0]), np.array([0, 0, -1.0]), None)
            assert drop > 0, name
            assert -1e-3 < 20.0 - drop - z < 0.25, f"{name} stands at {z}, the ground is at {20.0 - drop}"
            stood += 1
    assert stood >= 30


def test_the_ground_of_the_terrain_is_the_picture():
    model, data = load("terrain.xml")
    grey = read_png(ROOT / "assets" / "terrain.png")
    assert grey.min() == 0 and grey.max() == 255
    ground = model.geom("ground").id
    rows, columns = grey.shape
    for r, c in ((80, 80), (10, 20), (10, 140), (150, 20), (100, 130)):
        # First row of the picture is the far end in y.
        x, y = -10 + 20 * c / (columns - 1), 10 - 20 * r / (rows - 1)
        drop = mujoco.mj_rayHfield(model, data, ground, np.array([x, y, 20.0]), np.array([1e-9, 1e-9, -1.0]), None)
        assert abs(20.0 - drop - 2.55 * grey[r, c] / 255) < 2e-3, (r, c)
    assert 20.0 - mujoco.mj_rayHfield(model, data, ground, np.array([0.01, 0.02, 20.0]), np.array([0, 0, -1.0]), None) > 0.02


def test_meshes_are_fine_enough_and_the_rays_see_their_openings():
    model, data = load("meshes.xml")
    assert model.mesh_facenum.max() > 1000
    # Through the arch and through the window behind it.
    assert ray(model, data, [0, 0, 0.8], [1, 0, 0]) is None
    assert ray(model, data, [0, 0.85, 0.8], [1, 0, 0])[1] == "arch"
    assert ray(model, data, [3.6, 0.8, 0.8], [1, 0, 0])[1] == "window"
    # A collision feels the hull, except where boxes do the touching.
    model, data = with_probe("meshes.xml", 0.1)
    assert put_probe(model, data, [2.7, 0, 0.8]) == {"arch"}
    assert put_probe(model, data, [-2.7, 0, 0.8]) == set()
    assert put_probe(model, data, [-2.7, 0.8, 0.8]) == {"gateway_touch_left"}


def test_the_boxes_of_the_gateway_cover_its_mesh():
    model, data = load("meshes.xml")
    gate, usual = model.body("gateway").id, USUAL_GROUPS
    only_boxes = np.array([0, 0, 0, 1, 0, 0], np.uint8)
    differ = total = 0
    for y in np.linspace(-1.0, 1.0, 81):
        for z in np.linspace(0.02, 2.2, 81):
            start = [-2.0, y, z]
            seen = ray(model, data, start, [-1, 0, 0], usual)
            seen = seen is not None and seen[1] == "gateway"
            felt = ray(model, data, start, [-1, 0, 0], only_boxes) is not None
            total += seen
            differ += seen != felt
    assert model.body_geomnum[gate] == 7
    assert differ < 0.2 * total, f"{differ} of {total}"


def test_the_zoo_holds_every_geom_type():
    model, _ = load("zoo.xml")
    for name in ("plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh", "sdf"):
        assert model.geom(f"type_{name}").type == getattr(GEOM, f"mjGEOM_{name.upper()}"), name
    assert model.nplugin == 0, "the zoo must load without plugin libraries"


# What a ray with the usual groups and a ray with all groups hits, and whether a ball with the default bits feels it.
TRICKS = {
    "trick_group3": (False, True, True),
    "trick_alpha0": (False, False, True),
    "trick_material_alpha0": (False, False, True),
    "trick_alpha_low": (True, True, True),
    "trick_sheet": (True, True, True),
    "trick_wire": (True, True, True),
    "trick_visual_only": (True, True, False),
    "trick_contype2_conaffinity0": (True, True, False),
    "trick_contype0_conaffinity2": (True, True, False),
    "trick_margin": (True, True, True),
    "type_sphere": (True, True, True),
    "type_capsule": (True, True, True),
    "type_ellipsoid": (True, True, True),
    "type_cylinder": (True, True, True),
    "type_box": (True, True, True),
    "type_mesh": (True, True, True),
    "mover_mocap_child": (True, True, True),
    "mover_free": (True, True, True),
    "door": (True, True, True),
    "lift": (True, True, True),
}


@pytest.mark.parametrize("name", TRICKS)
def test_the_tricks_of_the_zoo_are_what_their_names_say(name):
    usual, every, felt = TRICKS[name]
    model, data = load("zoo.xml")
    at = data.geom_xpos[model.geom(name).id]
    # Onto the middle from 10 cm outside the geom's bounding sphere, from above; the door from the front, since its frame is above it.
    look = np.array([-1.0, 0, 0] if name == "door" else [0, 0, -1.0])
    start = at - look * (model.geom_rbound[model.geom(name).id] + 0.1)
    for groups, expected in ((USUAL_GROUPS, usual), (None, every)):
        hit = ray(model, data, start, look, groups)
        assert (hit is not None and hit[1] == name) == expected, hit
    model, data = with_probe("zoo.xml", 0.05)
    assert (name in put_probe(model, data, at + [0.03, 0.02, 0.01])) == felt


def test_contype2_in_the_zoo_meets_a_probe_whose_bits_match():
    spec = mujoco.MjSpec.from_file(str(ROOT / "xml" / "zoo.xml"))
    body = spec.worldbody.add_body(name="probe")
    body.add_freejoint()
    body.add_geom(name="probe", size=[0.05, 0, 0], contype=3, conaffinity=3)
    model = spec.compile()
    data = mujoco.MjData(model)
    for name in ("trick_contype2_conaffinity0", "trick_contype0_conaffinity2"):
        assert put_probe(model, data, model.body("tricks_touching").pos + model.geom(name).pos) == {name}


def test_the_margin_in_the_zoo_reports_a_contact_before_the_touch():
    model, data = with_probe("zoo.xml", 0.05)
    face = model.body("tricks_touching").pos + model.geom("trick_margin").pos + [0, 0.1 + 0.05, 0]
    assert "trick_margin" in put_probe(model, data, face + [0, 0.09, 0])
    assert data.contact[0].dist == pytest.approx(0.09)
    assert "trick_margin" not in put_probe(model, data, face + [0, 0.11, 0])


def test_the_concave_mesh_of_the_zoo_is_felt_as_its_hull_and_the_sdf_is_not():
    model, data = with_probe("zoo.xml", 0.1)
    arch = model.body("trick_mesh_concave_hulled").pos
    assert put_probe(model, data, arch + [0, 0, 0.8]) == {"trick_mesh_concave_hulled"}
    put_probe(model, data, [0, 0, 5])
    assert ray(model, data, arch + [0, 2, 0.8], [0, -1, 0]) is None
    ring = model.body("type_sdf").pos
    assert put_probe(model, data, ring) == set()
    assert put_probe(model, data, ring + [0, 0.6, 0]) == {"type_sdf"}
    put_probe(model, data, [0, 0, 5])
    assert ray(model, data, ring + [1, 0, 0], [-1, 0, 0])[1] != "type_sdf"


def test_the_finite_plane_of_the_zoo_is_seen_as_a_patch_and_felt_as_a_half_space():
    model, data = with_probe("zoo.xml", 0.05)
    put_probe(model, data, START)
    middle = model.geom("trick_plane_finite").pos
    assert ray(model, data, middle + [1, 0, 0], [-1, 0, 0])[1] == "trick_plane_finite"
    assert ray(model, data, middle + [1, 1.2, 0], [-1, 0, 0]) is None
    assert ray(model, data, middle + [-1, 0, 0], [1, 0, 0])[1] != "trick_plane_finite"
    assert put_probe(model, data, middle + [0.01, 30, 0]) == {"trick_plane_finite"}
    assert put_probe(model, data, middle + [0.2, 30, 0]) == set()


def test_mj_ray_misses_a_part_of_what_it_should_hit_on_a_signed_distance_field():
    """MuJoCo 3.17.0 itself: rays that pass near the surface give up early. docs/scenes.md quotes this; if it fails, MuJoCo has changed."""
    xml = f"""<mujoco><compiler meshdir="{ROOT / "assets"}"/><asset><mesh name="m" file="torus.obj"/></asset>
              <worldbody><geom type="{{}}" mesh="m"/></worldbody></mujoco>"""
    found = []
    rng = np.random.default_rng(0)
    starts = rng.normal(size=(4000, 3))
    starts *= 2 / np.linalg.norm(starts, axis=1, keepdims=True)
    aims = rng.uniform(-0.5, 0.5, (4000, 3)) - starts
    for kind in ("mesh", "sdf"):
        model = mujoco.MjModel.from_xml_string(xml.format(kind))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        found.append(np.array([ray(model, data, s, a) is not None for s, a in zip(starts, aims)]))
    mesh, sdf = found
    assert not (sdf & ~mesh).any()
    assert 0.02 < (mesh & ~sdf).sum() / mesh.sum() < 0.2


def test_mj_geom_distance_is_no_clearance_on_height_fields_and_signed_distance_fields():
    """MuJoCo 3.17.0 itself. docs/scenes.md quotes this; if it fails, MuJoCo has changed."""
    model, data = with_probe("terrain.xml", 0.05)
    # 1 m over the lowest ground near the origin: the true distance is under 1 m.
    put_probe(model, data, START)
    probe = model.geom("probe").id
    assert mujoco.mj_geomDistance(model, data, probe, model.geom("ground").id, 5.0, None) > 2.0
    model, data = with_probe("zoo.xml", 0.05)
    ring = model.body("type_sdf").pos
    put_probe(model, data, ring + [0, 0.74 + 0.05 + 0.02, 0])
    field = model.geom("type_sdf").id
    assert mujoco.mj_geomDistance(model, data, model.geom("probe").id, field, 5.0, None) == 5.0
    put_probe(model, data, ring + [0, 0.74 + 0.05 - 0.03, 0])
    assert -0.03 < mujoco.mj_geomDistance(model, data, model.geom("probe").id, field, 5.0, None) < 0


@pytest.mark.parametrize("path", SHELLS)
def test_shells_are_one_body_of_visible_solid_geoms_with_two_cameras(path):
    model, data = load(f"shells/{path}")
    assert names(model, mujoco.mjtObj.mjOBJ_BODY, model.nbody) == ["world", "drone"]
    assert model.njnt == 0 and np.all(model.geom_bodyid == 1)
    assert np.all(model.geom_group == 1)
    assert np.all(model.geom_contype == 1) and np.all(model.geom_conaffinity == 1)
    assert np.all(data.xpos[1] == 0) and np.allclose(data.xmat[1].reshape(3, 3), np.eye(3))
    # Mirror images left and right, and the rotors at the front are the ones at the front.
    for end in ("front", "back"):
        left, right = (model.geom(f"rotor_{end}_{side}") for side in ("left", "right"))
        assert np.array_equal(left.pos, right.pos * [1, -1, 1]) and np.array_equal(left.size, right.size)
        assert left.pos[1] > 0 and (left.pos[0] > 0) == (end == "front")
    looks = {"fpv": [[0, -1, 0], [0, 0, 1], [-1, 0, 0]], "down": [[0, -1, 0], [1, 0, 0], [0, 0, 1]]}
    for name, axes in looks.items():
        matrix = data.cam_xmat[model.camera(name).id].reshape(3, 3)
        assert np.allclose(matrix.T, axes), f"{name}: right, up, back are {matrix.T}"
    # What the front camera sees of its own drone must not hide the view: nothing within its central cone.
    camera = model.camera("fpv")
    for d in directions(5000):
        if d[0] > np.cos(np.radians(20)):
            assert ray(model, data, camera.pos, d) is None


@pytest.mark.parametrize(
    "path, motor_m, rotor_m, size_m",
    [
        # size: over all geoms but the rotors in x and y, over all geoms in z; published figures where there are some.
        ("cf2x.xml", 0.0325, 0.0235, (0.0746, 0.0746, 0.029)),
        ("cf21B.xml", 0.035355, 0.0275, (0.0814, 0.0814, 0.0299)),
        ("hb_x500.xml", 0.17678, 0.127, (0.3906, 0.3906, 0.300)),
    ],
)
def test_shells_have_their_published_dimensions(path, motor_m, rotor_m, size_m):
    model, data = load(f"shells/{path}")
    for end in ("front", "back"):
        for side in ("left", "right"):
            geom = model.geom(f"rotor_{end}_{side}")
            assert np.allclose(np.abs(geom.pos[:2]), motor_m) and geom.size[0] == rotor_m
            assert np.array_equal(model.geom(f"motor_{end}_{side}").pos[:2], geom.pos[:2])
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for g in range(model.ngeom):
        aabb = model.geom_aabb[g]
        turn = data.geom_xmat[g].reshape(3, 3)
        half = np.abs(turn) @ aabb[3:]
        middle = data.geom_xpos[g] + turn @ aabb[:3]
        sides = slice(2, 3) if model.geom(g).name.startswith("rotor") else slice(0, 3)
        low[sides] = np.minimum(low, middle - half)[sides]
        high[sides] = np.maximum(high, middle + half)[sides]
    assert np.allclose(high - low, size_m, atol=6e-3 if path == "hb_x500.xml" else 1.5e-3), high - low


def test_shells_attach_to_a_scene_with_prefixes_and_touch_it_and_each_other():
    spec = mujoco.MjSpec.from_file(str(ROOT / "xml" / "forest.xml"))
    for i, shell in enumerate(SHELLS):
        child = mujoco.MjSpec.from_file(str(ROOT / "xml" / "shells" / shell))
        body = spec.worldbody.add_frame(pos=[0, 0, 1]).attach_body(child.body("drone"), f"drone{i}/", "")
        body.add_freejoint()
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pairs = {frozenset(model.geom(int(g)).name.split("/")[0] for g in c.geom) for c in data.contact}
    assert pairs == {frozenset(p) for p in (("drone0", "drone1"), ("drone0", "drone2"), ("drone1", "drone2"))}
    assert model.camera("drone0/fpv").id >= 0
    data.qpos[0:3] = [3, 3, 0.0]
    mujoco.mj_forward(model, data)
    pairs = {frozenset(model.geom(int(g)).name.split("/")[0] for g in c.geom) for c in data.contact}
    assert frozenset(("ground", "drone0")) in pairs


def test_assets_are_small_and_are_what_their_script_makes(tmp_path):
    subprocess.run([sys.executable, ROOT / "assets" / "make_assets.py", "--out", tmp_path], check=True)
    made = sorted(p.name for p in (tmp_path / "assets").iterdir())
    kept = sorted(p.name for p in (ROOT / "assets").iterdir() if p.suffix in (".obj", ".png"))
    assert made == kept
    for name in made:
        here, there = ROOT / "assets" / name, tmp_path / "assets" / name
        assert here.stat().st_size < 1_000_000
        # Sines differ in the last bit between machines: one step of grey, 0.01 mm.
        if name.endswith(".png"):
            assert np.abs(read_png(here).astype(int) - read_png(there)).max() <= 1
        else:
            (v, f), (w, g) = (read_obj(p) for p in (here, there))
            assert np.array_equal(f, g) and np.abs(v - w).max() < 2.1e-5
    here, there = ((p / "xml" / "terrain.xml").read_text() for p in (ROOT, tmp_path))
    assert here.count("<geom") == there.count("<geom") and abs(len(here) - len(there)) < 50


@pytest.mark.parametrize("path", sorted((ROOT / "assets").glob("*.obj")), ids=lambda p: p.stem)
def test_meshes_are_closed_and_turned_outwards(path):
    v, f = read_obj(path)
    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])
    there = {tuple(e) for e in edges}
    assert len(there) == len(edges), "two faces share an edge in the same direction"
    assert all((b, a) in there for a, b in there), "an edge has one face only"
    volume = np.einsum("ij,ij->i", v[f[:, 0]], np.cross(v[f[:, 1]], v[f[:, 2]])).sum() / 6
    assert volume > 0


def read_obj(path):
    rows = [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]
    vertices = np.array([[float(c) for c in r[1:]] for r in rows if r[0] == "v"])
    faces = np.array([[int(i) - 1 for i in r[1:]] for r in rows if r[0] == "f"])
    return vertices, faces


def read_png(path):
    """Pixels of a PNG as make_assets.py writes them: 8 bits, no filter."""
    data = path.read_bytes()
    at, body = 8, b""
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at : at + 8])
        chunk = data[at + 8 : at + 8 + size]
        if kind == b"IHDR":
            columns, rows, _, colour = struct.unpack(">IIBB", chunk[:10])
        elif kind == b"IDAT":
            body += chunk
        at += size + 12
    depth = {0: 1, 2: 3}[colour]
    lines = np.frombuffer(zlib.decompress(body), np.uint8).reshape(rows, 1 + columns * depth)
    assert not lines[:, 0].any()
    return lines[:, 1:].reshape((rows, columns) if depth == 1 else (rows, columns, depth))


def test_scenes_have_names_in_any_folder(tmp_path, monkeypatch):
    import propwash

    monkeypatch.chdir(tmp_path)
    assert propwash.scenes() == [s.removesuffix(".xml") for s in SCENES]
    for name in propwash.scenes():
        by_name, by_file = propwash.Sim(scene=name), propwash.Sim(scene=ROOT / "xml" / f"{name}.xml")
        assert by_name.scene.sha256 == by_file.scene.sha256
    sim = propwash.Sim(scene=["forest", "room"], n_worlds=2)
    assert sim.config["scene"] == {"files": ["forest", "room"]}
    same = propwash.Sim.from_config(sim.config)
    assert [s.sha256 for s in same.scenes] == [s.sha256 for s in sim.scenes]
    with pytest.raises(FileNotFoundError, match="did you mean 'forest'.* there are: corridor, forest, meshes, room, terrain, zoo;"):
        propwash.Sim(scene="forrest")
    (tmp_path / "room").write_text("<mujoco><worldbody><geom name='mine' size='1'/></worldbody></mujoco>")
    assert [g.name for g in propwash.Sim(scene="room").scene.geoms if g.drone is None] == ["mine"]


def test_a_simulation_leaves_the_log_of_mujoco_to_its_owner(tmp_path):
    script = """
import sys, mujoco, numpy as np
XML = '<mujoco><worldbody><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
if sys.argv[1] == "beside":
    import propwash
    sim = propwash.Sim(scene=XML)
    sim.contacts()
model = mujoco.MjModel.from_xml_string(XML)
data = mujoco.MjData(model)
data.qpos[0] = np.nan
mujoco.mj_step(model, data)
"""
    said = [
        subprocess.run([sys.executable, "-c", script, how], cwd=tmp_path, capture_output=True, text=True, check=True).stderr
        for how in ("alone", "beside")
    ]
    assert "Nan, Inf or huge value in QPOS" in said[0] and said[1] == said[0]


def test_a_name_is_a_scene_and_with_layouts_a_kind_of_scenes():
    from propwash.envs import DroneVectorEnv

    env = DroneVectorEnv(2, task="forest_depth", scene="forest", camera=False)
    assert env.config["scene"] == {"files": ["forest"]}
    env = DroneVectorEnv(2, task="forest_depth", scene="corridor", layouts=2, camera=False)
    assert "corridor" in env.config["scene"] and env.config["layouts"] == 2
    assert "rooms" in DroneVectorEnv(1, task="room_explore", scene="rooms", layouts=1).config["scene"]
    with pytest.raises(FileNotFoundError, match="did you mean 'room'"):
        DroneVectorEnv(1, task="room_explore", scene="rooms")
