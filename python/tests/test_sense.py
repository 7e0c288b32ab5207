"""Depth images, contacts, clearances and obstacles of propwash.Sim."""

import numpy as np
import pytest
from conftest import ROOT, WALL

import propwash
from propwash import PixelStatus


def test_a_camera_on_drones_gives_an_image_for_each_drone(wall):
    depth = wall.render_depth("fpv", (33, 21))
    assert depth.shape == (2, 1, 21, 33) and depth.dtype == np.float32
    # The camera sits a little before the centre of the drone; the wall begins at 2.9 m.
    ahead = depth[:, 0, 10, 16]
    assert np.all((ahead > 2.8) & (ahead < 2.91)) and ahead[0] == ahead[1]


def test_a_camera_of_the_scene_gives_one_image_for_each_world(wall):
    frame = wall.depth_frame("overview")
    assert frame.depth.shape == (2, 10, 20) and frame.pos.shape == (2, 3) and frame.k.shape == (3, 3)
    assert np.all(frame.pos == [0.0, 0.0, 10.0])


def test_frames_say_what_each_pixel_saw(wall):
    camera = propwash.Camera("fpv", resolution=(64, 48), range=(0.5, 4.0))
    frame = wall.depth_frame(camera, normals=True)
    shape = (2, 1, 48, 64)
    assert frame.depth.shape == frame.status.shape == frame.geom_id.shape == frame.body_id.shape == shape
    assert frame.normal.shape == (*shape, 3) and frame.quat.shape == (2, 1, 4) and frame.k.shape == (1, 3, 3)
    assert (frame.kind, frame.range) == ("z_depth", (0.5, 4.0)) and np.all(frame.worlds == [0, 1])
    middle = (0, 0, 23, 32)
    assert frame.geom_name(frame.geom_id[middle]) == "wall" and frame.status[middle] == PixelStatus.HIT
    assert np.allclose(frame.normal[middle], [-1, 0, 0])
    assert np.all(np.isinf(frame.depth[frame.status == PixelStatus.TOO_FAR]))
    assert np.all(frame.geom_id[frame.status == PixelStatus.MISS] == -1) and frame.geom_name(-1) == ""
    assert np.array_equal(frame.hit, (frame.depth > 0) & np.isfinite(frame.depth))
    assert np.array_equal(frame.depth, wall.render_depth(camera))
    fx, cx = frame.k[0, 0, 0], frame.k[0, 0, 2]
    assert cx == 32.0 and fx > 0.0


def test_depth_agrees_with_rays_of_mujoco():
    sim = propwash.Sim(1, 2, scene=ROOT / "xml/room.xml", precision="f64")
    sim.set_initial(pos=[[-1.0, 0.5, 1.2], [0.5, -0.8, 0.8]], quat=[[0.0, 0.1, 0.2, 1.0], [0.1, 0.0, -0.9, 0.5]])
    sim.reset()
    ours = sim.depth_frame(propwash.Camera("fpv", resolution=(40, 30)))
    theirs = sim.depth_frame(propwash.Camera("fpv", resolution=(40, 30), caster="mujoco"))
    same = ours.geom_id == theirs.geom_id
    assert same.mean() > 0.999 and ours.hit.mean() > 0.9
    both = same & ours.hit & theirs.hit
    assert np.abs(ours.depth[both] - theirs.depth[both]).max() < 1e-4


def test_cameras_are_mounted_on_drones_or_in_the_world(wall):
    ahead = propwash.Camera(mount="drone", pos=(0.1, 0.0, 0.0), fovy_deg=60.0, resolution=(11, 11), kind="z_depth")
    depth = wall.render_depth(ahead)
    assert depth.shape == (2, 1, 11, 11) and np.allclose(depth[0, 0, :9, 5], 2.8, atol=1e-5)
    down = propwash.Camera(mount="world", pos=(0.0, 0.0, 5.0), quat=(0.0, 0.0, 0.0, 1.0), resolution=(5, 5))
    frame = wall.depth_frame(down)
    assert frame.depth.shape == (2, 5, 5) and frame.geom_name(frame.geom_id[0, 2, 2]).startswith("drone0/")
    pinhole = propwash.Camera(mount="world", pos=(0, 0, 5), pinhole_px=(10.0, 10.0, 2.5, 2.5), resolution=(5, 5))
    assert np.allclose(wall.depth_frame(pinhole).k, [[10, 0, 2.5], [0, 10, 2.5], [0, 0, 1]])


def test_only_the_worlds_that_are_asked_for_are_rendered():
    sim = propwash.Sim(5, scene=WALL)
    sim.set_initial(pos=np.column_stack([np.zeros(5), np.zeros(5), 1.0 + np.arange(5)])[:, None])
    sim.reset()
    frame = sim.depth_frame("fpv", (8, 8), worlds=[4, 1])
    assert frame.depth.shape == (2, 1, 8, 8) and np.all(frame.worlds == [4, 1])
    assert np.array_equal(frame.depth, sim.render_depth("fpv", (8, 8))[[4, 1]])
    assert frame.pos[0, 0, 2] > 4.9


def test_arrays_of_an_earlier_call_are_written_over(wall):
    depth = wall.render_depth("fpv", (16, 8))
    before = depth.copy()
    wall.data.pos[:, 0, 0] += 1.0
    assert wall.render_depth("fpv", (16, 8), out=depth) is depth and not np.array_equal(depth, before)
    frame = wall.depth_frame("fpv", (16, 8), normals=True)
    again = wall.depth_frame("fpv", (16, 8), normals=True, out=frame)
    assert again.depth is frame.depth and again.normal is frame.normal and np.array_equal(again.depth, depth)
    with pytest.raises(ValueError, match=r"shape \(2, 1, 8, 16\)"):
        wall.render_depth("fpv", (16, 8), out=np.empty((2, 1, 16, 8), np.float32))
    with pytest.raises(ValueError, match="depth of out"):
        wall.render_depth("fpv", (16, 8), out=np.empty((2, 1, 8, 16)))
    with pytest.raises(ValueError, match="not contiguous"):
        wall.render_depth("fpv", (16, 8), out=np.empty((2, 1, 8, 32), np.float32)[..., ::2])


def test_obstacles_move_in_one_world(wall):
    assert [o.name for o in wall.scene.obstacles] == ["gate"] and wall.obstacle_pos.shape == (2, 1, 3)
    gate = wall.scene.obstacle("gate").index
    wall.obstacle_pos[1, gate] = [1.5, 0.0, 1.0]
    frame = wall.depth_frame("fpv", (9, 9))
    names = [frame.geom_name(frame.geom_id[w, 0, 4, 4]) for w in range(2)]
    assert names == ["wall", "bar"] and frame.depth[1, 0, 4, 4] < 1.0
    near = wall.clearance()
    assert near.distance[1, 0] < near.distance[0, 0] and wall.scene.geoms[near.other_geom[1, 0]].name == "bar"


def test_contacts_name_both_sides():
    sim = propwash.Sim(3, scene=WALL)
    sim.set_initial(pos=np.array([[0.0, 0.0, 1.0], [2.9, 0.0, 1.0], [0.0, 0.0, 0.0]])[:, None])
    sim.reset()
    contacts = sim.contacts()
    assert np.array_equal(contacts.touching, [[False], [True], [True]]) and len(contacts) == len(contacts.distance) > 0
    names = {
        w: {sim.scene.geoms[g].name for g in contacts.other_geom[contacts.world == w]} for w in np.unique(contacts.world)
    }
    assert names == {1: {"wall"}, 2: {"floor"}}
    assert np.all(contacts.other_drone == -1) and np.all(contacts.drone == 0) and np.all(contacts.limited == 0)
    assert contacts.point.shape == contacts.normal.shape == (len(contacts), 3)
    assert np.allclose(np.linalg.norm(contacts.normal, axis=1), 1.0)
    assert np.all(contacts.normal[contacts.world == 2][:, 2] > 0.99)


def test_drones_touch_each_other():
    sim = propwash.Sim(1, 3, scene=WALL)
    sim.set_initial(pos=[[0.0, 0.0, 1.0], [0.02, 0.0, 1.0], [0.0, 2.0, 1.0]])
    sim.reset()
    contacts = sim.contacts()
    assert np.array_equal(contacts.touching, [[True, True, False]])
    assert set(zip(contacts.drone, contacts.other_drone)) == {(0, 1)}
    near = sim.clearance(max_distance=10.0)
    assert near.other_drone[0, 0] == 1 and near.distance[0, 0] < 0 and near.distance[0, 2] > 0


def test_clearance_gives_the_closest_points(wall):
    near = wall.clearance()
    assert near.distance.shape == near.found.shape == (2, 1) and near.on_other.shape == (2, 1, 3)
    assert np.all(near.found) and np.all(near.exact) and not near.quarantined.any()
    assert np.allclose(np.linalg.norm(near.on_drone - near.on_other, axis=-1), near.distance)
    assert wall.scene.geoms[near.other_geom[0, 0]].name == "floor" and 0.9 < near.distance[0, 0] < 1.0
    far = wall.clearance(max_distance=0.1)
    assert not far.found.any() and np.all(far.distance == 0.1) and np.all(far.other_geom == -1)


def test_a_thin_wall_that_was_flown_through_between_two_calls_is_found():
    xml = (
        '<mujoco><worldbody><geom name="thin" type="box" size="0.005 5 5" pos="1.07 0 0"/><geom name="far" size="1" pos="90 0 0"/>'
        "</worldbody></mujoco>"
    )
    sim = propwash.Sim(2, n_drones=2, scene=xml)
    # The first drone of world 0 flies through the wall at 20 m/s, all others away from it.
    vel = np.full((2, 2, 3), [-20.0, 0.0, 0.0])
    vel[0, 0, 0] = 20.0
    sim.set_initial(pos=[[0.0, 0.0, 1.0], [0.0, 2.0, 1.0]], vel=vel)
    sim.reset()
    found = []
    for _ in range(5):
        pos, quat = sim.data.pos.copy(), sim.data.quat.copy()
        sim.step(10)
        assert not sim.contacts().touching.any(), "no call of contacts falls on the wall"
        swept = sim.swept(pos, quat)
        for k in range(len(swept)):
            where = pos[0, 0] + swept.fraction[k] * (sim.data.pos[0, 0] - pos[0, 0])
            assert np.allclose(swept.pos[k], where, atol=1e-5) and 0.0 < swept.fraction[k] < 1.0
            assert np.isclose(swept.point[k, 0], 1.065, atol=1e-4) and np.allclose(swept.normal[k], [-1.0, 0.0, 0.0], atol=1e-6)
            found.append((swept.world[k], swept.drone[k], swept.scene.geoms[swept.other_geom[k]].name, swept.other_drone[k]))
        assert np.array_equal(swept.touched, [[len(swept) == 1, False], [False, False]]) and not swept.quarantined.any()
    assert found == [(0, 0, "thin", -1)]
    assert np.array_equal(sim.swept([[0.0, 0.0, 1.0], [0.0, 2.0, 1.0]]).touched[0], [True, False]), "positions broadcast, attitudes are those of now"
    with pytest.raises(ValueError, match="pos: expected shape"):
        sim.swept(np.zeros((3, 3)))
    with pytest.raises(propwash.Error, match="position"):
        sim.swept([np.nan, 0.0, 0.0])


def test_worlds_that_stand_still_are_marked_in_what_is_sensed(wall):
    wall.data.vel[0] = np.nan
    with pytest.warns(propwash.QuarantineWarning):
        wall.step()
    assert np.array_equal(wall.contacts().quarantined, [True, False])
    assert np.array_equal(wall.clearance().quarantined, [True, False])


@pytest.mark.parametrize("scene", sorted((ROOT / "xml").glob("*.xml")), ids=lambda p: p.name)
@pytest.mark.filterwarnings("ignore::propwash.SceneWarning")
def test_every_scene_is_seen_by_every_vehicle(scene):
    for vehicle in ("cf2x_L250", "cf21B_500", "hb_x500"):
        sim = propwash.Sim(2, drone=vehicle, scene=scene)
        sim.set_initial(pos=[0.0, 0.0, 1.5])
        sim.reset()
        assert sim.scene.geoms and sim.scene.bodies[0].id == 0
        camera = propwash.Camera(mount="drone", pos=(0.0, 0.0, 0.0), resolution=(24, 16))
        assert sim.depth_frame(camera).hit.any()
        assert sim.clearance().distance.shape == (2, 1)


def test_results_do_not_depend_on_threads():
    frames = []
    for threads in (1, 3):
        sim = propwash.Sim(20, scene=ROOT / "xml/forest.xml", threads=threads, seed=1, randomization=[
            {"parameter": "initial.pos.*", "draw": {"uniform": [-2.0, 2.0]}},
        ])  # fmt: skip
        sim.data.pos[..., 2] += 2.5
        frames.append((sim.depth_frame("fpv", (16, 16)), sim.clearance(), sim.contacts()))
    (a, near_a, touch_a), (b, near_b, touch_b) = frames
    assert np.array_equal(a.depth, b.depth) and np.array_equal(near_a.distance, near_b.distance)
    assert np.array_equal(touch_a.point, touch_b.point)


WALLS = [
    f"""<mujoco><worldbody><geom name="floor" type="plane" size="20 20 0.1" pos="0 0 {z}"/>
    <geom name="wall_{x}" type="box" size="0.1 5 5" pos="{x} 0 0"/>
    <body name="gate" mocap="true" pos="0 {x} 1"><geom name="bar" type="sphere" size="0.5"/></body></worldbody></mujoco>"""
    for x, z in ((3, 0.0), (5, -1.0))
]


def test_worlds_fly_in_scenes_of_their_own():
    layout = [0, 1, 1, 0, 1]
    sim = propwash.Sim(5, scene=WALLS, layout=layout)
    alone = [propwash.Sim(5, scene=text) for text in WALLS]
    start = np.random.default_rng(1).uniform([-1, -1, 0.02], [1, 1, 1], (5, 1, 3))
    start[[0, 2], 0] = [2.88, 0.0, 1.0]  # in the wall of the first scene only
    for s in (sim, *alone):
        s.set_initial(pos=start)
        s.reset()
    assert [len(sim.scenes), sim.layout.tolist()] == [2, layout] and sim.scene is sim.scenes[0]
    frame = sim.depth_frame("fpv", (8, 6), normals=True)
    each = [s.depth_frame("fpv", (8, 6), normals=True) for s in alone]
    plain, clear = sim.render_depth("fpv", (8, 6)), sim.clearance()
    apart = [s.clearance() for s in alone]
    for w, i in enumerate(layout):
        for name in ("depth", "status", "geom_id", "body_id", "normal", "pos", "quat"):
            assert (getattr(frame, name)[w] == getattr(each[i], name)[w]).all(), name
        assert (plain[w] == frame.depth[w]).all()
        for name in ("distance", "found", "other_geom", "on_drone", "on_other"):
            assert (getattr(clear, name)[w] == getattr(apart[i], name)[w]).all(), name
    assert frame.geom_name(int(frame.geom_id[1, 0, 0, 4]), k=1) == "wall_5"
    with pytest.raises(propwash.Error, match="2 scenes"):
        frame.geom_name(1)
    some = sim.depth_frame("fpv", (8, 6), worlds=[4, 0])
    assert (some.depth[0] == frame.depth[4]).all() and (some.depth[1] == frame.depth[0]).all()
    assert some.layout.tolist() == [1, 0]
    # Contacts in the order of worlds, with the numbers of worlds.
    contacts, theirs = sim.contacts(), [s.contacts() for s in alone]
    assert (np.diff(contacts.world) >= 0).all()
    for w, i in enumerate(layout):
        mine, other = contacts.world == w, theirs[i].world == w
        assert (contacts.distance[mine] == theirs[i].distance[other]).all()
        assert (contacts.other_geom[mine] == theirs[i].other_geom[other]).all()
        assert contacts.limited[w] == theirs[i].limited[w]
    assert contacts.touching[0, 0] and not contacts.touching[2, 0]
    sim.measure_ground()
    np.testing.assert_allclose(sim.data.ground_z[:, 0], [0.0 if i == 0 else -1.0 for i in layout], atol=1e-6)
    # Obstacles stand where the scene of each world has them.
    assert sim.obstacle_pos[:, 0, 1].tolist() == [3.0 if i == 0 else 5.0 for i in layout]
    mixed = propwash.Sim(2, scene=[WALLS[0], mixed_alone()])
    assert np.isnan(mixed.obstacle_pos[1]).all() and np.isfinite(mixed.obstacle_pos[0]).all()
    assert abs(mixed.clearance().distance[1, 0] - propwash.Sim(1, scene=mixed_alone()).clearance().distance[0, 0]) < 1e-9
    sim.layout = [1, 1, 1, 1, 0]
    assert (sim.render_depth("fpv", (8, 6))[0] == each[1].depth[0]).all()
    assert propwash.Sim(3, scene=WALLS).layout.tolist() == [0, 1, 0]


def mixed_alone():
    return "<mujoco><worldbody><geom type='box' size='1 1 1' pos='4 0 0'/></worldbody></mujoco>"


def test_scenes_and_layouts_that_do_not_fit_are_refused():
    for layout, words in [([0, 1], r"shape \(3,\)"), ([0, 1, 2], "below 2"), ([0, -1, 1], "at least 0"), ([0.0, 1.0, 0.0], "whole")]:
        with pytest.raises(ValueError, match=words):
            propwash.Sim(3, scene=WALLS, layout=layout)
    with pytest.raises(ValueError, match="below 0"):
        propwash.Sim(3, layout=[0, 0, 0])
    with pytest.raises(ValueError, match="empty list"):
        propwash.Sim(3, scene=[])
    cameras = [t.replace("<worldbody>", f'<worldbody><camera name="c" pos="0 0 9" fovy="{40 + 9 * i}"/>') for i, t in enumerate(WALLS)]
    sim = propwash.Sim(2, scene=cameras)
    with pytest.raises(ValueError, match="one size and one lens in all scenes"):
        sim.render_depth("c", (4, 4))
    assert sim.render_depth(propwash.Camera("c", fovy_deg=50.0, resolution=(4, 4))).shape == (2, 4, 4)
    out = np.empty((2, 1, 4, 5), np.float32)
    with pytest.raises(ValueError, match=r"expected an array of shape \(2, 1, 4, 4\)"):
        sim.render_depth("fpv", (4, 4), out=out)


def test_a_world_that_flew_away_or_was_written_away_harms_no_other():
    sim = propwash.Sim(6, scene="<mujoco><worldbody><geom type='plane' size='5 5 1'/></worldbody></mujoco>")
    sim.set_initial(pos=[0, 0, 1])
    sim.reset()
    sim.data.disturbance_force[3] = 1e9
    with pytest.warns(propwash.QuarantineWarning, match="went beyond 1e9 m"):
        sim.step(1000)
    assert sim.quarantined.tolist() == [False, False, False, True, False, False]
    sim.data.pos[1] = np.nan
    sim.data.quat[2] = 0
    distance = sim.clearance().distance[:, 0]
    assert sim.quarantined.tolist() == [False, True, True, True, False, False]
    assert np.isnan(distance[1:3]).all() and np.isfinite(np.delete(distance, [1, 2])).all()
    assert not set(sim.contacts().world) & {1, 2}
    assert np.isnan(sim.depth_frame(propwash.Camera("fpv"), resolution=(2, 2)).depth[1:3]).all()
    sim.reset()
    assert not sim.quarantined.any()


BALLS = """<mujoco><worldbody><geom type="plane" size="0 0 1"/><geom type="sphere" size="0.4" pos="2.5 0.6 1.2"/>
<geom type="box" size="0.3 0.4 0.5" pos="2.2 -0.7 1" euler="10 20 30"/></worldbody></mujoco>"""


def pair():
    """Two drones that see each other and things beside, and come near."""
    sim = propwash.Sim(2, 2, scene=BALLS, precision="f64", control="attitude")
    pos = [[[0.0, 0.0, 1.1], [0.6, 0.1, 1.2]], [[1.4, 0.1, 1.0], [1.9, 0.5, 1.5]]]
    sim.set_initial(pos=pos, quat=[[0.02, 0.05, 0.1, 1.0], [0.03, -0.04, 0.95, 0.2]])
    sim.reset()
    return sim


def turned(quat, rotation):
    """Attitudes after a small turn about axes of the world."""
    x, y, z, w = np.moveaxis(quat, -1, 0)
    a, b, c = np.broadcast_to(rotation, (*quat.shape[:-1], 3)).T / 2
    a, b, c = a.T, b.T, c.T
    return np.stack([x + a * w + b * z - c * y, y + b * w + c * x - a * z, z + c * w + a * y - b * x, w - a * x - b * y - c * z], axis=-1)


@pytest.mark.parametrize("kind", ["z_depth", "range"])
def test_depths_gain_by_poses_what_moved_drones_see(kind):
    sim = pair()
    # Without the floor far away, whose slopes are beyond what depths in f32 can tell.
    camera = propwash.Camera("fpv", resolution=(48, 40), kind=kind, range=(0.0, 8.0))
    frame = sim.depth_frame(camera, normals=True)
    assert frame.carrier.tolist() == [[0, 1]] * 2
    other = np.array([g.drone if g.drone is not None else -1 for g in sim.scene.geoms])
    assert {0, 1} & set(other[frame.geom_id[frame.geom_id >= 0]])
    step = 1e-4
    pos, quat = sim.data.pos.copy(), sim.data.quat.copy()

    def depths(drone, axis, by):
        sim.data.pos[...], sim.data.quat[...] = pos, quat
        if axis < 3:
            sim.data.pos[:, drone, axis] += by
        else:
            sim.data.quat[:, drone] = turned(quat[:, drone], by * np.eye(3)[axis - 3])
        return sim.depth_frame(camera, normals=True)

    moved = {(d, a, s): depths(d, a, s * step) for d in (0, 1) for a in range(6) for s in (1, -1)}
    # Pixels on edges see something else from one side.
    alike = [(f.geom_id == frame.geom_id) & (np.abs(f.normal - frame.normal).max(axis=-1) < 0.02) for f in moved.values()]
    inner = frame.known & np.all(alike, axis=0)
    assert inner.sum() > 0.9 * frame.known.sum() > 2000
    seeds = np.where(inner, np.random.default_rng(1).normal(size=inner.shape), 0.0)
    gain = frame.pull_back(seeds)
    assert gain.camera.pos.shape == (2, 2, 3) and gain.drones.quat.shape == (2, 2, 4)
    for (drone, axis), said in np.ndenumerate(np.concatenate([gain.drones.pos, gain.drones.rotation], axis=-1)[0]):
        plus, minus = (np.where(inner, moved[drone, axis, s].depth, 0).astype(float) for s in (1, -1))
        measured = (seeds * (plus - minus))[0].sum() / (2 * step)
        size = np.sqrt((seeds**2)[0].sum())
        assert abs(said - measured) < 0.02 * size, (drone, axis, said, measured)
    # Nothing is gained by the length of an attitude, and a turn gains the same by either.
    np.testing.assert_allclose((gain.drones.quat * quat).sum(axis=-1), 0, atol=1e-9)
    turn = np.array([1e-6, -2e-6, 3e-6])
    by_quat = (gain.drones.quat * (turned(quat, turn) - quat)).sum(axis=-1)
    np.testing.assert_allclose(by_quat, gain.drones.rotation @ turn, rtol=1e-4, atol=1e-9)
    # Pixel by pixel the same.
    slopes = frame.slopes()
    np.testing.assert_array_equal(slopes.known, frame.known)
    np.testing.assert_allclose(np.einsum("wdij,wdijk->wdk", seeds, slopes.pos), gain.camera.pos, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.einsum("wdij,wdijk->wdk", seeds, slopes.rotation), gain.camera.rotation, rtol=1e-9, atol=1e-9)


def test_cameras_that_stand_still_see_drones_move():
    sim = pair()
    frame = sim.depth_frame(propwash.Camera(mount="world", pos=(0.3, 0.05, 3.0), quat=(0, 0, 0, 1), fovy_deg=60.0, resolution=(160, 160)), normals=True)
    assert frame.carrier.tolist() == [-1, -1]
    drones = np.isin(frame.geom_id, [g.id for g in sim.scene.geoms if g.drone is not None]) & frame.known
    assert drones.sum() > 20
    gain = frame.pull_back(np.where(drones, 1.0, 0.0))
    # Higher drones are nearer to a camera that looks down, as is a lower camera; the floor stays.
    assert (gain.drones.pos[..., 2] <= 0).all() and np.count_nonzero(gain.drones.pos[..., 2]) >= 3
    np.testing.assert_allclose(gain.drones.pos.sum(axis=1), -gain.camera.pos, rtol=1e-9, atol=1e-9)
    floor = frame.pull_back(np.where(frame.geom_id == 0, 1.0, 0.0))
    assert not floor.drones.pos.any() and not floor.drones.quat.any()


def test_a_clearance_after_a_flight_has_a_gradient_by_the_commands():
    sim = pair()
    kept = sim.save()
    commands = np.zeros((2, 5, 2, 4))
    commands[..., 3] = sim.hover_thrust()[:, None]
    commands[..., :2] = np.random.default_rng(4).normal(0, 0.2, (2, 5, 2, 2))

    def near(commands):
        sim.restore(kept)
        sim.rollout(commands, 10)
        return sim.clearance()

    tape = sim.record(commands, 10)
    clearance = near(commands)
    assert clearance.known.all() and np.allclose(np.linalg.norm(clearance.away, axis=-1), 1) and (clearance.other_drone >= 0).any()
    weights = np.array([[1.0, 0.5], [-0.7, 2.0]])
    gain = clearance.pull_back(weights)
    seeds = {name: np.zeros_like(getattr(tape.states, name)) for name in ("pos", "quat")}
    seeds["pos"][:, -1], seeds["quat"][:, -1] = gain.pos, gain.quat
    gradient = tape.pull_back(seeds)
    direction = np.random.default_rng(5).normal(size=commands.shape)
    plus, minus = (near(commands + by * direction).distance for by in (1e-5, -1e-5))
    measured = (weights * (plus - minus)).sum() / 2e-5
    assert (gradient.commands * direction).sum() == pytest.approx(measured, rel=1e-3)


def test_slopes_that_are_none_are_refused_in_words(wall):
    with pytest.raises(ValueError, match="normals=True"):
        wall.depth_frame("fpv", (8, 8)).slopes()
    frame = wall.depth_frame(propwash.Camera("fpv", resolution=(8, 8), kind="range", range=(0.0, 3.3)), normals=True)
    assert frame.known.any() and not frame.known.all()
    with pytest.raises(ValueError, match=r"got 1 at pixel \(\d, \d\), (where nothing is seen|which is beyond the range)"):
        frame.pull_back(1.0)
    with pytest.raises(ValueError, match=r"seeds: expected shape \(2, 1, 8, 8\)"):
        frame.pull_back(np.zeros((3, 3)))
    far = wall.clearance(0.01)
    assert not far.known.any() and not far.away.any() and not far.pull_back(0.0).pos.any()
    with pytest.raises(ValueError, match="got 1.0 for drone 0 of world 0 .found: False"):
        far.pull_back(1.0)


def test_cameras_that_follow_otherwise_and_drones_that_flew_away_gain_nothing_wrong():
    follows = """<mujoco><worldbody><geom type="plane" size="0 0 1"/><body name="stand" pos="0 0 1"/>
    <camera name="eye" pos="-2 0 1.5" mode="targetbody" target="stand"/></worldbody></mujoco>"""
    sim = propwash.Sim(2, scene=follows, precision="f64")
    frame = sim.depth_frame("eye", (8, 8), normals=True)
    assert frame.carrier.tolist() == [-2, -2] and frame.slopes().known.any()
    with pytest.raises(ValueError, match="follows in another mode"):
        frame.pull_back(0.0)
    sim.data.pos[1] = np.nan
    frame, near = sim.depth_frame("fpv", (8, 8), normals=True), sim.clearance()
    gain, also = frame.pull_back(np.where(frame.known, 1.0, 0.0)), near.pull_back(np.where(near.known, 1.0, 0.0))
    assert not frame.known[1].any() and not near.known[1].any()
    for part in (gain.camera, gain.drones, also):
        for array in (part.pos, part.rotation, part.quat):
            assert np.isfinite(array).all() and not array[1].any()
    assert gain.drones.pos[0].any() and also.pos[0].any()
