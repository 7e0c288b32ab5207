"""MuJoCo's own model, window and renderer, and videos."""

import os
import shutil
import subprocess
import sys
import types

import mujoco
import numpy as np
import pytest
from conftest import ROOT, WALL, hover

import propwash
from propwash import __main__ as program
from propwash import _gl

NO_GL = _gl.missing()
needs_gl = pytest.mark.skipif(NO_GL is not None, reason=f"no GL: {NO_GL}")
DRONES = ["cf2x_L250", "cf21B_500", "hb_x500"]
POS = [[0.0, 0.0, 1.0], [0.7, 0.1, 1.05], [0.9, -0.5, 0.9]]
QUAT = [[0.0, 0.0, 0.0, 1.0], [0.1, 0.2, 0.3, 0.9], [0.0, 0.0, 0.38, 0.92]]


def crowd(scene, worlds=1):
    """Three drones of several vehicles, in sight of the first, turned in different ways."""
    sim = propwash.Sim(worlds, scene=scene, drone=DRONES)
    sim.set_initial(pos=POS, quat=QUAT)
    sim.reset()
    return sim


@pytest.mark.parametrize("scene", propwash.scenes())
def test_the_model_is_that_of_the_scene(scene):
    sim = crowd(scene)
    model, data = sim.mujoco()
    assert isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData)
    assert model.ngeom == len(sim.scene.geoms) and model.nbody == len(sim.scene.bodies) and model.ncam == len(sim.scene.cameras)
    assert [model.geom(i).name for i in range(model.ngeom)] == [g.name for g in sim.scene.geoms]
    assert [model.body(i).name for i in range(model.nbody)] == [b.name for b in sim.scene.bodies]
    for d in range(3):
        assert np.array_equal(data.body(f"drone{d}/drone").xpos, sim.data.pos[0, d].astype(np.float64))
        x, y, z, w = sim.data.quat[0, d].astype(np.float64)
        assert np.abs(data.body(f"drone{d}/drone").xquat - [w, x, y, z]).max() < 1e-7
    for o in sim.scene.obstacles:
        assert np.abs(data.xpos[o.body_id] - sim.obstacle_pos[0, o.index]).max() < 1e-12
    # Cameras of both stand in one place and look one way.
    for name in ("overview", "fpv"):
        frame = sim.depth_frame(name, resolution=(4, 4))
        pos, quat = (frame.pos[0], frame.quat[0]) if name == "overview" else (frame.pos[0, 1], frame.quat[0, 1])
        camera = data.camera(name if name == "overview" else f"drone1/{name}")
        assert np.abs(camera.xpos - pos).max() < 1e-12
        x, y, z, w = quat
        back = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
        assert np.abs(camera.xmat.reshape(3, 3)[:, 2] - back).max() < 1e-9
    assert data.ncon == 0 and not data.qacc.any()  # nothing was solved


def test_ids_of_rays_in_the_model_are_those_of_depth_images():
    """Needs no OpenGL: MuJoCo's rays in the model that was handed over, through the middles of pixels."""
    sim = crowd("room")
    model, data = sim.mujoco()
    frame = sim.depth_frame("overview", resolution=(24, 18))
    camera = data.camera("overview")
    k, turn = frame.k, camera.xmat.reshape(3, 3)
    seen = np.zeros(1, np.int32)
    same = 0
    for v in range(18):
        for u in range(24):
            way = turn @ [(u + 0.5 - k[0, 2]) / k[0, 0], -(v + 0.5 - k[1, 2]) / k[1, 1], -1.0]
            groups = np.array([1, 1, 1, 0, 0, 0], np.uint8)
            mujoco.mj_ray(model, data, camera.xpos, way / np.linalg.norm(way), groups, 1, -1, seen)
            same += int(seen[0] == frame.geom_id[0, v, u])
    assert same >= 24 * 18 - 2  # two walls that overlap in a corner are at one depth
    assert len(np.unique(frame.geom_id)) > 10


def test_poses_are_written_again():
    sim = propwash.Sim(2, scene=WALL, drone="cf2x_L250")
    sim.set_initial(pos=[[[0.0, 0.0, 1.0]], [[1.0, 0.0, 2.0]]])
    sim.reset()
    sim.state_control(hover(sim))
    model, data = sim.mujoco(1)
    assert np.array_equal(data.body("drone0/drone").xpos, [1.0, 0.0, 2.0]) and data.time == 0.0
    sim.data.vel[1, 0] = [0.5, 0.0, 0.0]
    sim.step(50)
    sim.obstacle_pos[1, 0] = [0.0, 3.0, 2.0]
    sim.obstacle_quat[1, 0] = [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]
    assert data.body("drone0/drone").xpos[0] == 1.0  # not before it is asked for
    sim.sync_mujoco(model, data, 1)
    assert np.array_equal(data.body("drone0/drone").xpos, sim.data.pos[1, 0].astype(np.float64)) and data.time == 0.1
    assert np.array_equal(data.joint(model.body("drone0/drone").jntadr[0]).qvel[:3], sim.data.vel[1, 0].astype(np.float64))
    assert np.array_equal(data.joint(model.body("drone0/drone").jntadr[0]).qvel[3:], sim.data.ang_vel[1, 0].astype(np.float64))
    gate = data.body("gate")
    assert np.allclose(gate.xpos, [0.0, 3.0, 2.0]) and np.allclose(gate.xmat.reshape(3, 3)[:, 0], [0.0, 1.0, 0.0])
    sim.sync_mujoco(model, data, 0)
    assert np.array_equal(data.body("drone0/drone").xpos, sim.data.pos[0, 0].astype(np.float64))
    # What is done to the model does not reach the Sim.
    data.qpos[:] = 7.0
    assert not (sim.data.pos == 7.0).any()


def test_obstacles_with_free_joints_are_written():
    free = '<mujoco><worldbody><body name="ball" pos="1 0 1"><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'
    sim = propwash.Sim(1, scene=free)
    sim.obstacle_pos[0, 0] = [2.0, 3.0, 4.0]
    _, data = sim.mujoco()
    assert np.array_equal(data.body("ball").xpos, [2.0, 3.0, 4.0])


def test_worlds_of_several_scenes_have_models_of_their_own():
    sim = propwash.Sim(2, scene=["room", "zoo"])
    (room, data), (zoo, _) = sim.mujoco(0), sim.mujoco(1)
    assert (room.ngeom, zoo.ngeom) == tuple(len(s.geoms) for s in sim.scenes)
    with pytest.raises(ValueError, match=r"expected those of the scene of world 1 \(scene zoo\).*sim.mujoco\(1\)"):
        sim.sync_mujoco(room, data, 1)
    with pytest.raises(ValueError, match="expected those of the scene"):
        sim.sync_mujoco(room, mujoco.MjData(zoo), 0)
    sim.layout = [1, 1]
    sim.sync_mujoco(*sim.mujoco(1), 0)


def test_what_cannot_be_handed_over_is_refused():
    sim = propwash.Sim()
    for call in (sim.mujoco, sim.viewer, sim.render):
        with pytest.raises(propwash.Error, match="has no scene"):
            call()
    sim = propwash.Sim(2, scene=WALL)
    with pytest.raises(ValueError, match="world: expected an integer from 0 to 1, got 2"):
        sim.mujoco(2)
    sim.data.pos[1, 0, 2] = np.nan
    with pytest.raises(propwash.Error, match="world 1 cannot be shown: pos holds numbers that are not finite"):
        sim.mujoco(1)
    sim.mujoco(0)


def test_a_window_without_a_display_says_what_to_do(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(propwash.Error, match="no display.*DISPLAY.*xvfb-run.*propwash.video"):
        propwash.Sim(scene=WALL).viewer()


def test_a_display_that_does_not_answer_says_what_to_do(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":9999")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(propwash.Error, match="the display does not answer.*xvfb-run"):
        propwash.Sim(scene=WALL).viewer()


@pytest.mark.skipif(shutil.which("xvfb-run") is None or shutil.which("xauth") is None, reason="no Xvfb")
def test_the_window_shows_the_flight_and_closes():
    code = """
import numpy as np
import propwash
sim = propwash.Sim(scene="zoo")
with sim.viewer(show_left_ui=False) as viewer:
    assert viewer.is_running() and "open" in repr(viewer)
    sim.data.pos[0, 0] = [1.0, 2.0, 3.0]
    viewer.sync()
    assert np.array_equal(viewer.data.body("drone0/drone").xpos, [1.0, 2.0, 3.0])
assert not viewer.is_running() and "closed" in repr(viewer)
viewer.sync()
left_open = sim.viewer()
print("done")
"""
    env = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "PYOPENGL_PLATFORM", "WAYLAND_DISPLAY")}
    words = ["xvfb-run", "-a", "-s", "-screen 0 640x480x24", sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, env=env)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr


def outside(code, **environment):
    """Runs Python without a display and with nothing said of OpenGL but what is given; what it printed."""
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env={**env, **environment})
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_renderer_without_opengl_says_what_to_install_and_to_set():
    code = """
import propwash
try:
    propwash.Sim(scene="room").render("overview")
except propwash.Error as e:
    print(e)
"""
    said = outside(code, MUJOCO_GL="glfw")
    assert "found no OpenGL (MUJOCO_GL is 'glfw', there is no display" in said
    assert "libegl1" in said and "libosmesa6" in said and "MUJOCO_GL=egl" in said and "Sim.render_depth" in said


def test_a_model_is_handed_over_where_opengl_is_broken():
    code = "import propwash; print(propwash.Sim(scene='room').mujoco()[0].ncam > 0)"
    assert outside(code, PYOPENGL_PLATFORM="glx") == "True\n"


@needs_gl
def test_a_machine_without_a_display_draws_with_nothing_set():
    code = "import os, propwash; print(propwash.Sim(scene='room').render('overview').shape, 'MUJOCO_GL' in os.environ)"
    assert outside(code) == "(480, 640, 3) False\n"


def report(line):
    """Appends a line to what the run compared, where that is asked for."""
    if path := os.environ.get("PROPWASH_COMPARISONS"):
        with open(path, "a") as file:
            file.write(line + "\n")


CAMERAS = ["overview", "top", "fpv", "down"]
LENS = propwash.Camera(mount="drone", pos=(0.1, 0.0, 0.05), resolution=(160, 120), pinhole_px=(110.0, 90.0, 70.0, 65.0))


@needs_gl
@pytest.mark.parametrize("scene", propwash.scenes())
def test_labels_are_those_of_mujocos_renderer(scene):
    """A second oracle beside MuJoCo's rays, by another method: triangles on a graphics card, or on its software."""
    sim = crowd(scene)
    # MuJoCo draws a signed distance field as triangles that it finds in it, centimetres off.
    field = [g.id for g in sim.scene.geoms if g.kind == "sdf"]
    least, equal, pixels, depths = 1.0, 0, 0, []
    for camera in [*CAMERAS, LENS]:
        size = (160, 120)
        drawn = sim.render(camera, segmentation=True, width=size[0], height=size[1])
        far = sim.render(camera, depth=True, width=size[0], height=size[1])
        frame = sim.depth_frame(camera, resolution=size)
        assert drawn.dtype == np.int32 and drawn.shape == frame.geom_id[0].shape
        same = drawn == frame.geom_id[0]
        least, equal, pixels = min(least, same.mean()), equal + same.sum(), pixels + same.size
        assert same.mean() >= 0.995, f"{camera}: {100 * same.mean():.2f} % of the pixels"
        both = same & frame.hit[0] & ~np.isin(drawn, field)
        assert np.isfinite(far[both]).all() and np.isinf(far[same & (drawn == -1)]).all()
        depths.append(np.abs(far[both] - frame.depth[0][both]) / frame.depth[0][both])
    off = np.concatenate(depths)
    median, most, worst = np.median(off), np.quantile(off, 0.999), off.max()
    report(
        f"labels of {scene} against MuJoCo's renderer: {equal} of {pixels} pixels equal, {100 * least:.2f} % at least in an image; relative "
        f"difference of depths: median {median:.1e}, 99.9 % {most:.1e}, worst {worst:.1e}"
    )
    assert median < 1e-5 and most < 5e-3


@needs_gl
def test_pictures_show_what_the_depth_camera_sees(wall):
    wall.obstacle_pos[1, 0] = [2.0, 0.0, 1.0]
    first, second = (wall.render("fpv", world=w, segmentation=True, width=40, height=30) for w in (0, 1))
    bar, wide = wall.scene.geom("bar").id, wall.scene.geom("wall").id
    assert first.shape == (1, 30, 40) and first[0, 15, 20] == wide and second[0, 15, 20] == bar
    colors = wall.render("fpv", world=1, width=40, height=30)
    assert colors.shape == (1, 30, 40, 3) and colors.dtype == np.uint8 and np.ptp(colors) > 50
    assert wall.render("overview").shape == (10, 20, 3)  # the size that the scene states
    assert wall.render().shape == (1, 480, 640, 3)


@needs_gl
def test_a_camera_does_not_see_what_carries_it():
    sim = propwash.Sim(1, scene=WALL)
    own = {g.id for g in sim.scene.geoms if g.drone == 0}
    down = propwash.Camera(mount="drone", pos=(0.0, 0.0, 0.3), quat=(0.0, 0.0, 0.0, 1.0), resolution=(32, 32), fovy_deg=40.0)
    sim.data.pos[0, 0, 2] = 1.0
    assert not own & set(np.unique(sim.render(down, segmentation=True)))
    itself = propwash.Camera(mount="drone", pos=down.pos, quat=down.quat, resolution=(32, 32), fovy_deg=40.0, sees_itself=True)
    assert own & set(np.unique(sim.render(itself, segmentation=True)))
    others = propwash.Camera(mount="world", pos=(0.0, 0.0, 1.3), quat=(0.0, 0.0, 0.0, 1.0), resolution=(32, 32), groups=(1,))
    assert set(np.unique(sim.render(others, segmentation=True))) <= own | {-1}


def test_pictures_that_make_no_sense_are_refused(wall):
    with pytest.raises(ValueError, match="expected both or neither, got width=40, height=None"):
        wall.render("fpv", width=40)
    with pytest.raises(ValueError, match="expected one of them to be true, got segmentation and rgb"):
        wall.render("fpv", rgb=True, segmentation=True)
    with pytest.raises(ValueError, match="got none"):
        wall.render("fpv", rgb=False)
    with pytest.raises(TypeError, match="camera: expected the name of a camera"):
        wall.render(3)
    with pytest.raises(KeyError, match="nowhere"):
        wall.render("nowhere")


# ---- videos


@pytest.fixture
def tape(monkeypatch):
    """An encoder in memory, in the place of ffmpeg: what was written."""
    reel = {"frames": []}

    def write_frames(path, size, fps, **_):
        reel.update(size=size, fps=fps)
        while True:
            frame = yield
            reel["frames"].append(np.array(frame))
            with open(path, "ab") as file:
                file.write(b"x")

    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", types.SimpleNamespace(write_frames=write_frames))
    return reel


def card(k):
    return np.full((4, 6, 3), k, np.uint8) if k < 5 else None


def test_a_video_of_pictures_has_them_all(tape, tmp_path):
    path = propwash.video(card, tmp_path / "a.mp4", fps=30)
    assert path == tmp_path / "a.mp4" and path.read_bytes() == b"xxxxx"
    assert tape["size"] == (6, 4) and tape["fps"] == 30 and [int(f[0, 0, 0]) for f in tape["frames"]] == [0, 1, 2, 3, 4]
    tape["frames"].clear()
    propwash.video((card(k % 5) for k in range(100)), tmp_path / "b.mp4", fps=10, seconds=0.7)
    assert len(tape["frames"]) == 7
    propwash.video([(card(1),)], tmp_path / "c.mp4")  # what a vector environment of one world renders
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mp4", "b.mp4", "c.mp4"]


@pytest.mark.parametrize(
    "source, options, error, words",
    [
        (card, {"path": "a.avi"}, ValueError, "expected a name that ends with .mp4"),
        (card, {"path": "no/a.mp4"}, FileNotFoundError, "folder .*no is not there"),
        (card, {"camera": "fpv"}, TypeError, "camera: expected it with a Sim or a data set"),
        (card, {"fps": 0}, ValueError, "fps: expected an integer from 1"),
        ([], {}, ValueError, "expected at least one picture"),
        (3, {}, TypeError, "expected a Sim, the folder of a data set, a function or pictures, got int"),
        ([np.zeros((4, 6))], {}, ValueError, r"picture 0: expected uint8 of shape \(height, width, 3\), got float64"),
        ([card(0), np.zeros((6, 6, 3), np.uint8)], {}, ValueError, "picture 1: expected the shape of the first"),
        ([np.zeros((5, 6, 3), np.uint8)], {}, ValueError, "even width and height, which H.264 needs, got 6 x 5"),
        ("nothing_there", {}, FileNotFoundError, "expected the folder of a data set"),
    ],
)
def test_videos_that_cannot_be_are_refused_and_leave_nothing(tape, tmp_path, source, options, error, words):
    path = tmp_path / options.pop("path", "a.mp4")
    with pytest.raises(error, match=words):
        propwash.video(source, path, **options)
    assert not list(tmp_path.rglob("*"))


def test_a_video_is_replaced_only_where_that_is_asked_for(tape, tmp_path):
    propwash.video(card, tmp_path / "a.mp4")
    with pytest.raises(FileExistsError, match="force=True"):
        propwash.video(card, tmp_path / "a.mp4")
    propwash.video([card(0)], tmp_path / "a.mp4", force=True)
    assert (tmp_path / "a.mp4").read_bytes() == b"x"

    def breaks(k):
        if k == 2:
            raise RuntimeError("mine")
        return card(k)

    with pytest.raises(RuntimeError, match="mine"):
        propwash.video(breaks, tmp_path / "a.mp4", force=True)
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"] and (tmp_path / "a.mp4").read_bytes() == b"x"


def test_without_ffmpeg_a_video_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ImportError, match=r"pip install 'propwash\[video\]'"):
        propwash.video(card, tmp_path / "a.mp4")


@needs_gl
def test_a_video_of_a_sim_flies_it(tape, tmp_path):
    sim = propwash.Sim(2, scene="room", freq=500)
    sim.set_initial(pos=[0.0, 0.0, 1.0])
    sim.reset()
    calls = []

    def control(s):
        calls.append(int(s.data.steps[1]))
        s.state_control(hover(s))

    propwash.video(sim, tmp_path / "a.mp4", fps=30, seconds=0.2, world=1, width=64, height=48, control=control)
    # Pictures 0 to 5 at steps 0, 16, 33, 50, 66, 83.
    assert len(tape["frames"]) == 6 and calls == list(range(83)) and sim.data.steps[1] == 83
    propwash.video(sim, tmp_path / "b.mp4", camera="fpv", fps=100, seconds=0.03, width=64, height=48)
    assert len(tape["frames"]) == 9 and tape["frames"][-1].shape == (48, 64, 3)
    with pytest.raises(ValueError, match="seconds: expected how long the Sim flies"):
        propwash.video(sim, tmp_path / "c.mp4")
    with pytest.raises(ValueError, match="fps: expected at most 500"):
        propwash.video(sim, tmp_path / "c.mp4", fps=501, seconds=1.0)


@needs_gl
def test_the_camera_that_follows_sees_the_drone(tape, tmp_path):
    from propwash._video import Follow

    for scene in ("room", "forest"):
        sim = crowd(scene)
        follow = Follow(sim, 0)
        own = [g.id for g in sim.scene.geoms if g.drone == 0]
        for pos in ([0.0, 0.0, 1.0], [-2.0, 1.0, 1.2]):
            sim.data.pos[0, 0] = pos
            sim.data.quat[0, 0] = [0.0, 0.0, 0.6, 0.8]
            seen = sim.render(follow.camera(1.0), segmentation=True, width=160, height=120)
            assert 20 < np.isin(seen[30:90, 40:120], own).sum() < 6000, scene


@needs_gl
def test_a_video_of_a_data_set_flies_it_again(tape, tmp_path):
    out = tmp_path / "set"
    camera = {"width": 8, "height": 8}
    propwash.fly(out, scene="room", n_worlds=2, seconds=0.2, camera=camera)
    propwash.video(out, tmp_path / "a.mp4", fps=20, world=1, width=64, height=48)
    assert len(tape["frames"]) == 4
    with pytest.raises(TypeError, match="control: a data set is flown again by the commands of its own"):
        propwash.video(out, tmp_path / "b.mp4", control=hover)
    own = tmp_path / "own"
    sim = propwash.Sim(1, scene="room")
    recorder = propwash.Recorder(own, sim, seconds=0.1)
    for _ in recorder:
        recorder.step(recorder.n_steps)
    with pytest.raises(propwash.Error, match="recorded from a loop of one's own"):
        propwash.video(own, tmp_path / "b.mp4")


@needs_gl
def test_ffmpeg_writes_what_was_drawn(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    sim = propwash.Sim(1, scene="room")
    path = propwash.video(sim, tmp_path / "a.mp4", camera="overview", fps=20, seconds=0.5, width=64, height=48)
    frames = ffmpeg.read_frames(str(path))
    meta = next(frames)
    pictures = [np.frombuffer(f, np.uint8).reshape(48, 64, 3) for f in frames]
    assert meta["size"] == (64, 48) and meta["fps"] == 20.0 and len(pictures) == 10
    drawn = sim.render("overview", width=64, height=48)
    assert np.abs(pictures[0].astype(float) - drawn).mean() < 12.0


# ---- the program


@pytest.mark.parametrize(
    "line, left, film",
    [
        ("fly --scene room --video a.mp4 --out o", "fly --scene room --out o", "a.mp4"),
        ("fly --video=a.mp4 --out=o", "fly --out=o", "a.mp4"),
        ("fly --help --video a.mp4", "fly --help --video a.mp4", None),
        ("fly --out o --video", "fly --out o --video", None),
        ("scene lint --video a.mp4", "scene lint --video a.mp4", None),
    ],
)
def test_the_flag_is_taken_from_flights_alone(line, left, film):
    assert program._without_video(line.split()) == (left.split(), film)
    assert program._value("fly --out=o".split(), "--out") == program._value("fly --out o".split(), "--out") == "o"


def test_a_video_that_cannot_be_made_is_told_before_the_flight(tmp_path):
    words = ["fly", "--scene", "room", "--drone", "cf2x_L250", "--out", str(tmp_path / "o"), "--video", "a.avi"]
    done = subprocess.run([sys.executable, "-m", "propwash", *words], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.startswith("error: --video: expected a name that ends with .mp4") and not done.stdout
    assert not (tmp_path / "o").exists()


@needs_gl
def test_the_command_makes_a_video(tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    words = "fly --scene room --drone cf2x_L250 --seconds 0.2 --size 8x8 --out o --video a.mp4 --json".split()
    done = subprocess.run([sys.executable, "-m", "propwash", *words], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("{") and "video     a.mp4" in done.stderr and (tmp_path / "a.mp4").stat().st_size > 1000


def test_names_stand_in_the_extras():
    text = (ROOT / "pyproject.toml").read_text()
    assert 'video = ["imageio-ffmpeg' in text and 'window = ["propwash[envs]", "pygame' in text
