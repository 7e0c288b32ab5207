"""What a sample holds: one drone in one frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, Mapping, Sequence

from .._repr import short_repr
from ._errors import FormatError

Sample = Dict[str, Any]
"""One drone in one frame: text, numbers, and NumPy arrays by the names of ``DataSet.fields``."""


@dataclass(frozen=True)
class Field:
    """One entry of a sample."""

    name: str
    dtype: str
    """``"str"``, ``"bool"``, or a NumPy type such as ``"float32"``."""
    shape: tuple[int, ...]
    """() for a single number; images are (row, column)."""
    unit: str
    """Unit, frame of reference, or meaning."""
    columns: tuple[str, ...] = ()
    """Columns of states.parquet that it is made of."""

    __repr__ = short_repr


ALWAYS = ("key", "world", "drone", "frame", "step", "time_s")
"""Fields that every sample has."""

COMMANDS = {
    "state": ["cmd_x", "cmd_y", "cmd_z", "cmd_vx", "cmd_vy", "cmd_vz", "cmd_ax", "cmd_ay", "cmd_az",
              "cmd_qx", "cmd_qy", "cmd_qz", "cmd_qw", "cmd_wx", "cmd_wy", "cmd_wz"],
    "attitude": ["cmd_roll", "cmd_pitch", "cmd_yaw", "cmd_thrust"],
    "body_rate": ["cmd_wx", "cmd_wy", "cmd_wz", "cmd_thrust"],
    "force_torque": ["cmd_thrust", "cmd_tx", "cmd_ty", "cmd_tz"],
}  # fmt: skip
"""Columns of the command of each control mode; those of ``rotor_vel`` are one for each rotor."""

EMPTY = {"clearance_m": float("inf")}
"""What an empty cell becomes where that is not NaN."""


def fields(manifest: Mapping[str, Any]) -> dict[str, Field]:
    """The entries of a sample of a data set, in their order."""
    out = [
        Field("key", "str", (), "unique within the data set, sorts in the order of samples"),
        Field("world", "int64", (), ""),
        Field("drone", "int64", (), ""),
        Field("frame", "int64", (), "frame within the world"),
        Field("step", "int64", (), "simulation step"),
        Field("time_s", "float64", (), "s from the start"),
    ]
    image = (manifest["cameras"][0]["height"], manifest["cameras"][0]["width"]) if manifest["cameras"] else (0, 0)
    # What `frames.npz` has for each drone; its pixels first.
    sizes = {"3": 3, "4": 4, "row": image[0], "column": image[1]}
    for array in manifest["frames"]:
        axes = [a.strip() for a in array["shape"].strip("()").split(",")]
        if axes[:2] == ["frame", "drone"]:
            out.append(Field(array["name"], array["dtype"], tuple(sizes[a] for a in axes[2:]), array["unit"]))
    out.append(Field("k", "float64", (3, 3), "pin-hole matrix, pixels"))
    out.extend(_of_states(manifest))
    flight = manifest["flight"]
    if flight["contact_every_steps"] > 0:
        out.append(Field("contact", "bool", (), "whether the drone touched anything since the frame before"))
        out.append(Field("n_contacts", "int64", (), "rows of contacts.parquet since the frame before"))
    if flight["clearance_every_steps"] > 0:
        out.append(Field("clearance_step", "int64", (), "step of the row of clearance.parquet"))
        out.append(Field("clearance_m", "float64", (), "m to the nearest geom, negative inside; +inf for none in reach"))
        out.append(Field("clearance_exact", "bool", (), "false where the distance is a lower bound"))
        out.append(Field("clearance_geom", "int64", (), "the nearest geom, -1 for none in reach"))
    known = {f.name: f for f in out}
    for name, sensor, channel in sampled(manifest):
        if name in known:
            raise FormatError(
                f'sensor "{sensor}", channel "{channel["name"]}": a sample has a field {name} already; rename the sensor and record again'
            )
        unit = f"{channel['unit']}, last sample of the sensor {sensor}"
        known[name] = Field(name, CHANNEL_TYPES[channel["type"]], tuple(channel["shape"]), unit)
    return known


CHANNEL_TYPES = {"f32": "float32", "i32": "int32", "u8": "uint8"}
"""NumPy's names for the types of channels of sensors."""


def sampled(manifest: Mapping[str, Any]) -> list[tuple[str, str, Mapping[str, Any]]]:
    """Fields of sensors: their name, that of the sensor, and the channel."""
    sensors = manifest.get("sensors", [])
    return [(f"{s['name']}_{c['name']}", s["name"], c) for s in sensors for c in s["channels"]]


def _of_states(manifest: Mapping[str, Any]) -> list[Field]:
    there = [c["name"] for c in manifest["tables"]["states.parquet"]]

    def numbered(stem: str) -> list[str]:
        return [c for c in there if c.startswith(stem) and c[len(stem) :].isdigit()]

    rotor_command = numbered("cmd_rotor")
    command = COMMANDS.get(manifest["flight"]["control_mode"], rotor_command)
    attitude = COMMANDS["attitude"]
    reference = ["ref_x", "ref_y", "ref_z", "ref_vx", "ref_vy", "ref_vz", "ref_ax", "ref_ay", "ref_az", "ref_yaw"]
    groups: list[tuple[str, Sequence[str], str]] = [
        ("pos_m", ["px", "py", "pz"], "m, world"),
        ("quat_xyzw", ["qx", "qy", "qz", "qw"], "body to world"),
        ("vel_m_s", ["vx", "vy", "vz"], "m/s, world"),
        ("ang_vel_rad_s", ["wx", "wy", "wz"], "rad/s, body"),
        ("specific_force_m_s2", ["ax", "ay", "az"], "m/s², body: what an accelerometer reads"),
        ("rotor_rad_s", numbered("rotor"), "rad/s"),
        ("thrust_n", ["thrust"], "N, all rotors together"),
        ("command", command, "the command of the control mode: " + " ".join(command)),
        ("attitude_command", attitude, "roll, pitch, yaw (rad), thrust (N)"),
        ("rotor_command_rad_s", rotor_command, "rad/s"),
        ("reference", reference, "position (m), velocity (m/s), acceleration (m/s²), world; yaw (rad)"),
        ("battery_v", ["vbat"], "V under load"),
        ("wind_m_s", ["wind_x", "wind_y", "wind_z"], "m/s, world"),
    ]
    out = [Field("state_step", "int64", (), "step of the row of states.parquet")]
    for name, columns, unit in groups:
        if columns and all(c in there for c in columns):
            scalar = name in ("thrust_n", "battery_v")
            out.append(Field(name, "float64", () if scalar else (len(columns),), unit, tuple(columns)))
    return out


def key(world: int, drone: int, frame: int) -> str:
    """Name of a sample; without dots, as WebDataset wants it."""
    return f"world_{world:05d}_frame_{frame:06d}_drone_{drone:04d}"


def chosen(all_fields: Mapping[str, Field], names: Sequence[str]) -> dict[str, Field]:
    """The named fields and those that every sample has; KeyError for a name that is none."""
    for name in names:
        if name not in all_fields:
            raise KeyError(f"no field \"{name}\" in this data set; there are {', '.join(all_fields)}")
    return {name: f for name, f in all_fields.items() if name in ALWAYS or name in names}
