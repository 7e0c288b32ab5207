"""Makes every file in this folder, and the terrain scene whose things stand on the height map. Needs Python 3.10 and numpy.

    python3 assets/make_assets.py            writes assets/*.obj, assets/*.png and xml/terrain.xml of the checkout
    python3 assets/make_assets.py --out DIR  the same below DIR (DIR/assets, DIR/xml)

Meshes are closed, with faces counter-clockwise seen from outside, in metres, z up. Everything is a formula below; random numbers
come from numpy's PCG64 with fixed seeds.
"""

import argparse
import struct
import zlib
from pathlib import Path

import numpy as np

TAU = 2.0 * np.pi


# ---------------------------------------------------------------- files


def write_obj(path, vertices, faces, about):
    """Wavefront OBJ: 0.01 mm steps, triangles only."""
    lines = [f"# {about}", "# Made by assets/make_assets.py; metres, z up, counter-clockwise seen from outside."]
    lines += ["v " + " ".join(f"{c + 0.0:.5f}" for c in np.round(v, 5)) for v in vertices]
    lines += ["f " + " ".join(str(i + 1) for i in f) for f in faces]
    path.write_text("\n".join(lines) + "\n")


def write_png(path, pixels):
    """8-bit PNG from an array (rows, columns) or (rows, columns, 3), first row at the top."""
    pixels = np.ascontiguousarray(pixels, np.uint8)
    rows, columns = pixels.shape[:2]
    colour_type = 0 if pixels.ndim == 2 else 2
    raw = b"".join(b"\0" + pixels[r].tobytes() for r in range(rows))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", columns, rows, 8, colour_type, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw, 9)) + chunk(b"IEND", b"")
    )


# ---------------------------------------------------------------- meshes


def tube(centres, frames, section, closed):
    """Sweeps `section` (k, 2) along `centres` (n, 3) with `frames` (n, 2, 3); closes into a ring or caps both ends (k must then be star-shaped)."""
    n, k = len(centres), len(section)
    vertices = (centres[:, None, :] + np.einsum("kj,njc->nkc", section, frames)).reshape(-1, 3)
    faces = []
    for i in range(n if closed else n - 1):
        for j in range(k):
            a, b = i * k + j, i * k + (j + 1) % k
            c, d = ((i + 1) % n) * k + (j + 1) % k, ((i + 1) % n) * k + j
            faces += [(a, b, c), (a, c, d)]
    if not closed:
        vertices = np.vstack([vertices, centres[0], centres[-1]])
        first, last = n * k, n * k + 1
        for j in range(k):
            faces += [(first, (j + 1) % k, j), (last, (n - 1) * k + j, (n - 1) * k + (j + 1) % k)]
    return vertices, np.array(faces)


def circle(radius, count):
    angle = TAU * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def torus(ring_m=0.6, tube_m=0.14, around=48, across=24):
    """A ring in the x-y plane; 2 * around * across triangles."""
    angle = TAU * np.arange(around) / around
    out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(around)])
    up = np.broadcast_to([0.0, 0.0, 1.0], out.shape)
    # The section turns from z to the outside, seen along the sweep: normals point out.
    return tube(ring_m * out, np.stack([up, out], 1), circle(tube_m, across), closed=True)


def knot(scale_m=0.22, tube_m=0.09, around=160, across=12):
    """A trefoil knot: (sin t + 2 sin 2t, cos t - 2 cos 2t, -sin 3t), swept with a frame carried along without twist."""
    t = TAU * np.arange(around) / around
    centres = scale_m * np.column_stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)])
    tangent = np.roll(centres, -1, 0) - np.roll(centres, 1, 0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.empty_like(centres)
    normal[0] = np.cross(tangent[0], [0.0, 0.0, 1.0])
    normal[0] /= np.linalg.norm(normal[0])
    for i in range(1, around):
        carried = normal[i - 1] - tangent[i] * (tangent[i] @ normal[i - 1])
        normal[i] = carried / np.linalg.norm(carried)
    # What is left of the turn after one round is spread over the whole length.
    last = normal[-1] - tangent[0] * (tangent[0] @ normal[-1])
    rest = np.arctan2(tangent[0] @ np.cross(last, normal[0]), last @ normal[0])
    turn = rest * np.arange(around) / around
    side = np.cross(tangent, normal)
    frames = np.stack(
        [
            np.cos(turn)[:, None] * normal + np.sin(turn)[:, None] * side,
            np.cos(turn)[:, None] * side - np.sin(turn)[:, None] * normal,
        ],
        1,
    )
    return tube(centres, frames, circle(tube_m, across), closed=True)


def arch(half_width_m=0.8, pillar_m=1.2, depth_m=0.25, thickness_m=0.22, steps=24):
    """Two pillars and half a ring over them, to be flown through along x; foot at z = 0. Concave."""
    angle = np.pi * np.arange(steps + 1) / steps
    bow_out = np.column_stack([np.zeros(steps + 1), -np.cos(angle), np.sin(angle)])
    centres = [[0.0, -half_width_m, 0.0]]
    outward = [[0.0, -1.0, 0.0]]
    for o in bow_out:
        centres.append([0.0, half_width_m * o[1], pillar_m + half_width_m * o[2]])
        outward.append(list(o))
    centres.append([0.0, half_width_m, 0.0])
    outward.append([0.0, 1.0, 0.0])
    centres, outward = np.array(centres), np.array(outward)
    along = np.broadcast_to([1.0, 0.0, 0.0], centres.shape)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [thickness_m / 2, depth_m / 2]
    return tube(centres, np.stack([outward, along], 1), corners, closed=False)


def star(outer_m=0.6, inner_m=0.25, half_depth_m=0.12, points=5):
    """A star in the y-z plane, extruded along x. Concave."""
    angle = TAU * np.arange(2 * points) / (2 * points)
    radius = np.where(np.arange(2 * points) % 2 == 0, outer_m, inner_m)
    section = np.column_stack([radius * np.sin(angle), radius * np.cos(angle)])[::-1]
    centres = np.array([[-half_depth_m, 0.0, 0.0], [half_depth_m, 0.0, 0.0]])
    frames = np.broadcast_to(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), (2, 2, 3))
    return tube(centres, frames, section, closed=False)


def window(outer_m=(2.0, 1.6), hole_m=(0.9, 0.8), half_depth_m=0.06):
    """A panel in the y-z plane with a rectangular hole: a flat ring of four corners. Concave."""
    sign = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    rings = []
    for x, size in ((half_depth_m, outer_m), (half_depth_m, hole_m), (-half_depth_m, hole_m), (-half_depth_m, outer_m)):
        yz = sign * np.array(size) / 2
        rings.append(np.column_stack([np.full(4, x), yz]))
    vertices = np.vstack(rings)
    faces = []
    for ring in range(4):
        for j in range(4):
            a, b = ring * 4 + j, ring * 4 + (j + 1) % 4
            c, d = ((ring + 1) % 4) * 4 + (j + 1) % 4, ((ring + 1) % 4) * 4 + j
            faces += [(a, b, c), (a, c, d)]
    return vertices, np.array(faces)


def bowl(radius_m=0.5, wall_m=0.05, around=40, up=8):
    """Half of a hollow ball, open at the top. Concave, with its opening at z = 0."""
    outer = [(radius_m * np.sin(a), -radius_m * np.cos(a)) for a in np.linspace(0, np.pi / 2, up + 1)[1:]]
    r = radius_m - wall_m
    inner = [(r * np.sin(a), -r * np.cos(a)) for a in np.linspace(np.pi / 2, 0, up + 1)[:-1]]
    rings = outer + inner
    angle = TAU * np.arange(around) / around
    vertices = [(q * np.cos(a), q * np.sin(a), z) for q, z in rings for a in angle]
    bottom, inside = len(vertices), len(vertices) + 1
    vertices += [(0.0, 0.0, -radius_m), (0.0, 0.0, -r)]
    faces = []
    for i in range(len(rings) - 1):
        for j in range(around):
            a, b = i * around + j, i * around + (j + 1) % around
            c, d = (i + 1) * around + (j + 1) % around, (i + 1) * around + j
            faces += [(a, b, c), (a, c, d)]
    last = (len(rings) - 1) * around
    for j in range(around):
        faces += [(bottom, (j + 1) % around, j), (inside, last + j, last + (j + 1) % around)]
    return np.array(vertices), np.array(faces)


def ball(subdivisions):
    """Unit icosphere: 20 * 4^subdivisions triangles."""
    g = (1.0 + np.sqrt(5.0)) / 2.0
    v = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g),
         (0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]  # fmt: skip
    f = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8),
         (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]  # fmt: skip
    v = [np.array(p, float) / np.linalg.norm(p) for p in v]
    for _ in range(subdivisions):
        middle, finer = {}, []

        def between(a, b):
            key = (min(a, b), max(a, b))
            if key not in middle:
                p = v[a] + v[b]
                middle[key] = len(v)
                v.append(p / np.linalg.norm(p))
            return middle[key]

        for a, b, c in f:
            ab, bc, ca = between(a, b), between(b, c), between(c, a)
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        f = finer
    return np.array(v), np.array(f)


def rock(seed=7, radius_m=0.5, waves=9):
    """An icosphere of 1280 triangles, pushed in and out by waves in random directions. Not convex."""
    vertices, faces = ball(3)
    draw = np.random.default_rng(seed)
    bump = np.zeros(len(vertices))
    for w in range(waves):
        direction = draw.normal(size=3)
        direction *= (1.5 + 0.6 * w) / np.linalg.norm(direction)
        bump += 0.22 / (1.0 + 0.7 * w) * np.sin(vertices @ direction + TAU * draw.random())
    return vertices * radius_m * (1.0 + bump)[:, None] * [1.0, 0.85, 0.7], faces


def cone(radius_m=1.0, height_m=1.0, around=16):
    """A cone with its foot at z = 0; convex, for the crowns of firs."""
    vertices = np.vstack([np.column_stack([circle(radius_m, around), np.zeros(around)]), [[0, 0, 0], [0, 0, height_m]]])
    faces = []
    for j in range(around):
        faces += [(around, (j + 1) % around, j), (around + 1, j, (j + 1) % around)]
    return vertices, np.array(faces)


# ---------------------------------------------------------------- pictures


def stone(side=128, seed=11):
    """A tileable grey texture: waves with whole numbers of periods."""
    draw = np.random.default_rng(seed)
    u, v = np.meshgrid(np.arange(side) / side, np.arange(side) / side)
    value = np.zeros((side, side))
    for _ in range(60):
        k = draw.integers(-14, 15, 2)
        value += np.cos(TAU * (k[0] * u + k[1] * v + draw.random())) / (1.0 + np.hypot(*k))
    value = (value - value.min()) / (value.max() - value.min())
    grey = 96 + 110 * value
    return np.rint(np.stack([grey, 0.97 * grey, 0.90 * grey], 2)).astype(np.uint8)


TERRAIN_SIDE_M = 20.0  # edge of the square ground
TERRAIN_PIXELS = 161  # along an edge; 0.125 m apart
TERRAIN_RISE_M = 2.55  # height of grey value 255: 1 cm a step


def smoothstep(x, low, high):
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def terrain(seed=5):
    """Grey values (rows from north, y up, to south): a gentle dell around the origin, hills from 2.5 m outwards."""
    draw = np.random.default_rng(seed)
    axis = np.linspace(-TERRAIN_SIDE_M / 2, TERRAIN_SIDE_M / 2, TERRAIN_PIXELS)
    x, y = np.meshgrid(axis, axis[::-1])
    hills = np.zeros_like(x)
    for w in range(14):
        length = 11.0 / (1.0 + 0.55 * w)
        direction = TAU * draw.random()
        phase = TAU * draw.random()
        hills += length / 11.0 * np.cos(TAU / length * (np.cos(direction) * x + np.sin(direction) * y) + phase)
    hills = (hills - hills.min()) / (hills.max() - hills.min())
    far = smoothstep(np.hypot(x, y), 2.5, 7.0)
    dell = 0.06 + 0.04 * np.cos(1.9 * x + 0.4) * np.cos(1.6 * y - 0.8)
    value = dell + far * hills * 0.95
    value = (value - value.min()) / (value.max() - value.min())
    return np.rint(255 * value).astype(np.uint8)


# ---------------------------------------------------------------- the terrain scene


class Ground:
    """Heights of the field as MuJoCo makes them of the picture: two triangles a cell. Their lowest corner bounds both ways of splitting a cell."""

    def __init__(self, grey):
        self.height = grey[::-1].astype(float) / 255.0 * TERRAIN_RISE_M  # [row from south, column from west]

    def corners(self, x, y):
        step = TERRAIN_SIDE_M / (TERRAIN_PIXELS - 1)
        c = int(np.clip((x + TERRAIN_SIDE_M / 2) / step, 0, TERRAIN_PIXELS - 2))
        r = int(np.clip((y + TERRAIN_SIDE_M / 2) / step, 0, TERRAIN_PIXELS - 2))
        return self.height[r : r + 2, c : c + 2]

    def low(self, x, y):
        return self.corners(x, y).min()


def f(*values):
    """Numbers for XML: at most four decimals, no trailing zeros, no minus zero."""
    return " ".join(f"{round(float(v), 4) + 0.0:.4f}".rstrip("0").rstrip(".") for v in values)


def terrain_xml(grey, seed=23, trees=26, rocks=16):
    ground = Ground(grey)
    draw = np.random.default_rng(seed)
    places = []

    def place(radius, nearest, farthest):
        for _ in range(10_000):
            x, y = draw.uniform(-farthest, farthest, 2)
            if np.hypot(x, y) > nearest and all(np.hypot(x - a, y - b) > radius + r + 0.5 for a, b, r in places):
                places.append((x, y, radius))
                return x, y, ground.low(x, y)
        raise SystemExit("no place left: ask for fewer things")

    out = []
    for i in range(trees):
        # The first trees stand near the flight space, the others anywhere on the hills.
        nearest, farthest = (2.0, 3.6) if i < 5 else (3.0, 9.3)
        x, y, z = place(0.35, nearest, farthest)
        height, trunk = draw.uniform(1.9, 3.4), draw.uniform(0.06, 0.13)
        name = f"tree_{i:02d}"
        out.append(f'    <body name="{name}" pos="{f(x, y, z)}">')
        # The trunk starts below the ground, so that it stands on a slope without a gap.
        out.append(f'      <geom name="{name}_trunk" type="cylinder" size="{f(trunk)}" fromto="0 0 -0.3 {f(0, 0, height)}" material="bark"/>')
        if i % 2 == 0:
            for j, (low, wide) in enumerate(((0.28, 0.75), (0.52, 0.55), (0.74, 0.36))):
                out.append(f'      <geom name="{name}_crown_{j}" type="mesh" mesh="fir_{j}" pos="{f(0, 0, low * height)}" material="fir"/>')
        else:
            for j in range(3):
                a, q = TAU * (j / 3 + draw.random() / 6), draw.uniform(0.38, 0.55)
                out.append(
                    f'      <geom name="{name}_crown_{j}" type="ellipsoid" size="{f(q, q, 0.8 * q)}" '
                    f'pos="{f(0.32 * np.cos(a), 0.32 * np.sin(a), height + 0.12 * j)}" material="leaf_{j % 2}"/>'
                )
        out.append("    </body>")
    for i in range(rocks):
        size = draw.integers(0, 3)
        x, y, z = place((0.3, 0.5, 0.8)[size], 1.9 + size, 9.0)
        turn = draw.random() * np.pi
        out.append(f'    <body name="rock_{i:02d}" pos="{f(x, y, z)}" quat="{f(np.cos(turn), 0, 0, np.sin(turn))}">')
        out.append(f'      <geom name="rock_{i:02d}" type="mesh" mesh="rock_{size}" material="stone"/>')
        out.append("    </body>")

    half = TERRAIN_SIDE_M / 2
    return f"""<!--
Hills from a height map, with trees and rocks that stand on them. Written by assets/make_assets.py together with assets/terrain.png:
change the script, not this file.
The ground is {f(TERRAIN_SIDE_M)} x {f(TERRAIN_SIDE_M)} m, {f(TERRAIN_RISE_M)} m from its lowest to its highest point (1 cm a grey step), with a dell around the origin
whose floor is not at zero. There is no plane below: a ray past the edge of the ground misses.
-->
<mujoco model="terrain">
  <compiler meshdir="../assets" texturedir="../assets"/>
  <size memory="16M"/>
  <statistic center="0 0 1" extent="12"/>
  <visual>
    <headlight ambient="0.35 0.35 0.35" diffuse="0.4 0.4 0.4"/>
    <map znear="0.002"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.55 0.72 0.92" rgb2="0.95 0.93 0.88" width="256" height="1536"/>
    <texture name="stone" type="2d" file="stone.png"/>
    <material name="ground" rgba="0.45 0.52 0.30 1"/>
    <material name="bark" rgba="0.36 0.25 0.17 1"/>
    <material name="fir" rgba="0.12 0.33 0.20 1"/>
    <material name="leaf_0" rgba="0.35 0.55 0.20 1"/>
    <material name="leaf_1" rgba="0.47 0.60 0.22 1"/>
    <material name="stone" texture="stone" texuniform="true"/>
    <material name="mover" rgba="0.95 0.35 0.15 1"/>
    <hfield name="hills" file="terrain.png" size="{f(half, half, TERRAIN_RISE_M)} 0.5"/>
    <mesh name="fir_0" file="cone.obj" scale="0.75 0.75 1.1"/>
    <mesh name="fir_1" file="cone.obj" scale="0.55 0.55 0.95"/>
    <mesh name="fir_2" file="cone.obj" scale="0.36 0.36 0.9"/>
    <mesh name="rock_0" file="rock.obj" scale="0.5 0.5 0.5"/>
    <mesh name="rock_1" file="rock.obj" scale="0.9 0.9 0.9"/>
    <mesh name="rock_2" file="rock.obj" scale="1.5 1.5 1.5"/>
  </asset>
  <worldbody>
    <light name="sun" type="directional" pos="0 0 12" dir="-0.4 0.3 -1" diffuse="0.7 0.68 0.6"/>
    <camera name="overview" pos="-9 -11 9" xyaxes="0.774 -0.633 0 0.37 0.452 0.812" fovy="55"/>
    <camera name="top" pos="0 0 24" fovy="48"/>
    <geom name="ground" type="hfield" hfield="hills" material="ground"/>
{chr(10).join(out)}
    <body name="mover_0" mocap="true" pos="2.6 -1.2 1.3">
      <geom name="mover_0" type="sphere" size="0.3" material="mover"/>
    </body>
    <body name="mover_1" mocap="true" pos="-2.4 1.9 1.1">
      <geom name="mover_1" type="capsule" size="0.12 0.5" material="mover"/>
    </body>
  </worldbody>
</mujoco>
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent.parent, help="the folder that holds assets/ and xml/")
    out = parser.parse_args().out
    assets, xml = out / "assets", out / "xml"
    assets.mkdir(parents=True, exist_ok=True)
    xml.mkdir(parents=True, exist_ok=True)
    for name, (vertices, faces), about in (
        ("torus", torus(), "A ring with a round section. Concave."),
        ("knot", knot(), "A trefoil knot. Concave."),
        ("arch", arch(), "An arch to fly through. Concave."),
        ("star", star(), "A five-pointed star. Concave."),
        ("window", window(), "A panel with a hole. Concave."),
        ("bowl", bowl(), "A bowl. Concave."),
        ("rock", rock(), "A rock. Slightly concave."),
        ("cone", cone(), "A cone. Convex."),
    ):
        write_obj(assets / f"{name}.obj", vertices, faces, about)
    grey = terrain()
    write_png(assets / "terrain.png", grey)
    write_png(assets / "stone.png", stone())
    (xml / "terrain.xml").write_text(terrain_xml(grey))


if __name__ == "__main__":
    main()
