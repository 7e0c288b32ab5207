"""Videos of flights, drawn by MuJoCo's renderer and written by ffmpeg."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

from . import _gl, _native
from ._mirror import picture
from ._optional import need
from ._size import radius
from ._write import may_write
from .sense import Camera, _float, _whole
from .sim import Sim, _path

Picture = NDArray[np.uint8]
Source = Union[Sim, "str | os.PathLike[str]", Callable[[int], Union[Picture, None]], Iterable[Picture]]

_TURN_RAD_S = 1.2  # of the camera that follows
_DOWN_RAD = 0.35  # where it looks, below the horizon
_WIDTHS_AWAY = 9.0  # its distance, in widths of the drone


def video(
    source: Source,
    path: str | os.PathLike[str],
    *,
    camera: str | Camera | None = None,
    fps: int = 50,
    seconds: float | None = None,
    world: int = 0,
    width: int | None = None,
    height: int | None = None,
    control: Callable[[Sim], object] | None = None,
    force: bool = False,
) -> Path:
    """Writes a video (mp4, H.264) of a flight.

    ``source`` is one of

    - a ``Sim``, which flies ``seconds`` on from where it is, under the commands in force or those that ``control`` gives; a picture is drawn
      every 1/fps s;
    - the folder of a data set that ``propwash fly`` wrote: the flight is flown again, to the bit, by its configuration;
    - a function of the number of the picture, from 0, which flies its own loop and returns a picture, (height, width, 3), uint8, such as
      ``sim.render("overview")`` or ``env.render()``, or None at the end;
    - pictures, one after another (a list, a generator).

    Args:
        source: What is shown.
        path: The file, whose name ends with ``.mp4``. It is written whole or not at all.
        camera: As in ``Sim.render``, of a ``Sim`` or data set; ``"fpv"`` shows what the first drone sees. None: a camera that follows the first
            drone from behind and above.
        fps: Pictures per second of the video, which runs at the speed of the flight.
        seconds: Seconds of flight: of a ``Sim`` needed, of a data set all where it is None. Of others the most that are taken.
        world: The world that is shown; of a data set its number.
        width, height: Even numbers of pixels, of a ``Sim`` or data set; 640 x 480, or those of the camera, where they are None.
        control: Is called with the ``Sim`` before each of its steps.
        force: Replaces a file that is there.

    Returns:
        Path of the video.

    Raises:
        ImportError: without ``imageio-ffmpeg``: ``pip install 'propwash[video]'``.
        Error: where MuJoCo's renderer finds no OpenGL, and for a ``Sim`` without a scene.
        FileExistsError: where there is a file, without ``force``.
    """
    place = Path(_path("path", path))
    if place.suffix.lower() != ".mp4":
        raise ValueError(f"path: expected a name that ends with .mp4, got {str(place)!r}")
    fps = _whole("fps", fps, 1, 1000)
    most = None if seconds is None else _pictures(seconds, fps)
    may_write(place, force)
    need_ffmpeg()
    if isinstance(source, (str, os.PathLike)):
        if control is not None:
            raise TypeError("control: a data set is flown again by the commands of its own pattern; expected a Sim with it")
        source, control, whole = _again(source, world)
        world = 0
        most = most or _pictures(whole, fps)
    if isinstance(source, Sim):
        if most is None:
            raise ValueError("seconds: expected how long the Sim flies in the video, got None")
        shown = _flight(source, camera, fps, most, world, (width, height), control)
    else:
        given = {"camera": camera, "width": width, "height": height, "control": control, "world": world or None}
        for name, value in given.items():
            if value is not None:
                raise TypeError(f"{name}: expected it with a Sim or a data set; a function or pictures have it in themselves")
        shown = _given(source, most)
    _encode(shown, place, fps)
    return place


def _pictures(seconds: float, fps: int) -> int:
    value = _float("seconds", seconds)
    if not 0.0 < value < 1e6:
        raise ValueError(f"seconds: expected more than 0, got {seconds!r}")
    return max(1, round(value * fps))


def need_ffmpeg() -> Any:
    """The package that brings ffmpeg."""
    return need("imageio_ffmpeg", "video", "a video")


def _again(source: str | os.PathLike[str], world: int) -> tuple[Sim, Callable[[Sim], object], float]:
    """The ``Sim`` of one world of a data set, what flies it, and how long it flew, s."""
    folder = Path(_path("source", source))
    file = folder / "manifest.json"
    if not file.is_file():
        found = "none in it" if folder.is_dir() else "no folder"
        raise FileNotFoundError(f"{folder}: expected the folder of a data set, with manifest.json, found {found}")
    config: dict[str, Any] = json.loads(_native.read_flight(file.read_text(encoding="utf-8")))
    if config.get("pattern") is None:
        raise _native.Error(
            f"{folder}: the data set was recorded from a loop of one's own, which cannot be flown again by its configuration: give "
            "propwash.video the Sim and the control of that loop, or its pictures"
        )
    world = _whole("world", world, 0, config["n_worlds"] - 1)
    one = {"n_worlds": 1, "first_world": config["first_world"] + world}
    layout = config.get("layout")
    sim = Sim.from_config(file, **one, layout=None if layout is None else [layout[world]])
    if layout is None and len(sim.scenes) > 1:  # worlds fly in them by turns
        sim = Sim.from_config(file, **one, layout=[world % len(sim.scenes)])
    return sim, _by_pattern, float(config["seconds"])


def _by_pattern(sim: Sim) -> None:
    sim.state_control(sim.pattern_command())


def _flight(
    sim: Sim,
    camera: str | Camera | None,
    fps: int,
    n: int,
    world: int,
    size: tuple[int | None, int | None],
    control: Callable[[Sim], object] | None,
) -> Iterator[Picture]:
    if fps > sim.freq:
        raise ValueError(f"fps: expected at most {sim.freq}, the steps of the Sim in a second, got {fps}")
    world = _whole("world", world, 0, sim.n_worlds - 1)
    follow = Follow(sim, world) if camera is None else None
    wanted: tuple[int | None, int | None] = (640, 480) if follow and size == (None, None) else size
    done = 0
    for k in range(n):
        steps, done = k * sim.freq // fps - done, k * sim.freq // fps
        if control is None:
            sim.step(steps)
        else:
            for _ in range(steps):
                control(sim)
                sim.step()
        eye = camera if follow is None else follow.camera(steps / sim.freq)
        one = picture(sim, eye, "rgb", world, wanted, keep=follow is None)
        yield one if one.ndim == 3 else one[0]


class Follow:
    """A camera behind and above the first drone of a world, its horizon level, which turns slowly after the drone's heading."""

    def __init__(self, sim: Sim, world: int) -> None:
        self.sim, self.world = sim, world
        self.yaw = self._heading()
        self.radius = radius(sim.vehicles[0])
        self.away = 2.0 * self.radius * _WIDTHS_AWAY

    def _heading(self) -> float:
        x, y, z, w = (float(v) for v in self.sim.data.quat[self.world, 0])
        return float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))

    def camera(self, seconds: float) -> Camera:
        """The camera now, so many seconds after it was asked for last."""
        off = (self._heading() - self.yaw + np.pi) % (2.0 * np.pi) - np.pi
        self.yaw += float(np.clip(off, -_TURN_RAD_S * seconds, _TURN_RAD_S * seconds))
        c, s, cd, sd = np.cos(self.yaw), np.sin(self.yaw), np.cos(_DOWN_RAD), np.sin(_DOWN_RAD)
        ahead = np.array([c * cd, s * cd, -sd])
        pos = np.asarray(self.sim.data.pos[self.world, 0], np.float64)
        p, y = 0.5 * (0.5 * np.pi - _DOWN_RAD), 0.5 * (self.yaw - 0.5 * np.pi)
        quat = tuple(float(v) for v in (np.cos(y) * np.sin(p), np.sin(y) * np.sin(p), np.sin(y) * np.cos(p), np.cos(y) * np.cos(p)))
        # Nearer where something is in between: a narrow look back from the drone.
        first = 1.3 * self.radius
        start = tuple((pos - first * ahead).tolist())
        look = Camera(mount="world", pos=start, quat=_turned(quat), fovy_deg=6.0, resolution=(4, 4))  # type: ignore[arg-type]
        cameras, _ = self.sim._camera(look, None, False, keep=False)
        depth = np.empty(self.sim._image(cameras[0], 1), np.float32)
        self.sim._native.render(cameras, [self.world], {"depth": depth})
        away = max(min(self.away, first + float(depth.min()) - 0.08), 2.5 * self.radius)
        return Camera(mount="world", pos=tuple((pos - away * ahead).tolist()), quat=quat, fovy_deg=50.0)  # type: ignore[arg-type]


def _turned(quat: tuple[float, ...]) -> tuple[float, ...]:
    """The orientation of a camera that looks the other way, with the same side up."""
    x, y, z, w = quat
    # Half a turn about its own y axis.
    return (-z, w, x, -y)


def _given(source: Any, most: int | None) -> Iterator[Picture]:
    """Pictures of a function or of a row of pictures."""
    if callable(source):
        k = 0
        while most is None or k < most:
            one = source(k)
            if one is None:
                return
            yield one
            k += 1
        return
    if not isinstance(source, Iterable):
        raise TypeError(f"source: expected a Sim, the folder of a data set, a function or pictures, got {type(source).__name__}")
    for k, one in enumerate(source):
        if most is not None and k >= most:
            return
        yield one


def _checked(one: Any, k: int, shape: tuple[int, ...] | None) -> Picture:
    """A picture that can be written."""
    if isinstance(one, (tuple, list)) and len(one) == 1:  # what a vector environment renders
        one = one[0]
    array = np.asarray(one)
    if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] != 3:
        raise ValueError(f"picture {k}: expected uint8 of shape (height, width, 3), got {array.dtype} of shape {array.shape}")
    if shape is not None and array.shape != shape:
        raise ValueError(f"picture {k}: expected the shape of the first, {shape}, got {array.shape}")
    if array.shape[0] % 2 or array.shape[1] % 2:
        raise ValueError(f"picture {k}: expected even width and height, which H.264 needs, got {array.shape[1]} x {array.shape[0]}")
    return np.ascontiguousarray(array)


def _encode(pictures: Iterator[Picture], place: Path, fps: int) -> None:
    ffmpeg = need_ffmpeg()
    partial = place.with_name(f".partial_{place.stem}.{os.getpid()}.mp4")
    writer: Any = None
    shape: tuple[int, ...] | None = None
    try:
        for k, one in enumerate(pictures):
            array = _checked(one, k, shape)
            if writer is None:
                shape = array.shape
                size = (array.shape[1], array.shape[0])
                writer = ffmpeg.write_frames(str(partial), size, fps=fps, codec="libx264", macro_block_size=2, ffmpeg_log_level="error")
                writer.send(None)
            writer.send(array)
        if writer is None:
            raise ValueError("source: expected at least one picture, got none")
        writer.close()
        os.replace(partial, place)
    finally:
        if writer is not None:
            writer.close()
        partial.unlink(missing_ok=True)


def check(path: str) -> None:
    """Raises where no video could be written: before the flight that it shall show."""
    place = Path(path)
    if place.suffix.lower() != ".mp4":
        raise ValueError(f"--video: expected a name that ends with .mp4, got {path}")
    may_write(place, False)
    need_ffmpeg()
    fault = _gl.missing()
    if fault is not None:
        raise _native.Error(fault)
