"""ISO 230-1 names of a machine's errors, from the directions of its axes; plain Python, so that shell completion is quick.

`axes_of` reads the directions from the machine file and the URDF without checking either; `twin.machine.machine` checks both.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import cos, hypot, radians, sin
from pathlib import Path
from typing import Any, Final, NamedTuple
from xml.etree import ElementTree

from twin._common.errors import InputError
from twin._common.files import read_text

DIRECTIONS: Final = "XYZABC"
"""Components of an error frame in order: translations along, rotations about x, y, z (ISO 230-1, 3.4)."""
PARALLEL: Final = 0.1
"""Sine of the angle below which two linear axes count as parallel and span no datum plane."""
MIN_ALIGNMENT: Final = 0.7071
"""Cosine of the largest angle, 45° (rounded), between a direction of a linear axis's error frame and that of the base frame."""
MAX_BYTES: Final = 4_000_000

Vector = tuple[float, float, float]
Rows = tuple[Vector, Vector, Vector]
"""Rotation, row by row."""
IDENTITY: Final[Rows] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class NamedAxis(NamedTuple):
    """Directions of the motion of one axis, unit vectors, all joints at zero."""

    name: str
    linear: bool
    direction: Vector
    """In the axis's error frame."""
    machine_direction: Vector
    """In the machine frame."""


def component_names(axis: str, *, average: bool = False) -> tuple[str, ...]:
    """Return the names of six components: ``E_XX`` … ``E_CX``, or ``E_X0C`` … ``E_C0C`` of the average line."""
    return tuple(f"E_{direction}{'0' if average else ''}{axis}" for direction in DIRECTIONS)


def location_names(axes: Iterable[NamedAxis]) -> tuple[str, ...]:
    """Return the names of the rotary axes' locations: two offsets and two angles each, perpendicular to the axis (ISO 230-1, 3.5)."""
    names: list[str] = []
    for axis in axes:
        if not axis.linear:
            along, six = _largest(axis.direction), component_names(axis.name, average=True)
            names += [six[i] for i in range(3) if i != along] + [six[3 + i] for i in range(3) if i != along]
    return tuple(names)


def squareness_names(axes: Iterable[NamedAxis]) -> tuple[str, ...]:
    """Return the names of the squareness errors that remain with the choice of the machine frame, by that frame's directions.

    The first linear axis is the datum axis and has none. The first one that is not parallel to it lies in the datum plane with it
    and has one, about the plane's normal (contract §1). Every other one has two, perpendicular to its direction.
    """
    names: list[str] = []
    datum: Vector | None = None
    plane = False
    for axis in axes:
        if not axis.linear:
            continue
        if datum is None:
            datum = axis.machine_direction
            continue
        normal = _cross(datum, axis.machine_direction)
        if not plane and hypot(*normal) > PARALLEL:
            plane = True
            names.append(f"E_{'ABC'[_largest(normal)]}0{axis.name}")
        else:
            along = _largest(axis.machine_direction)
            names += [f"E_{'ABC'[i]}0{axis.name}" for i in range(3) if i != along]
    return tuple(names)


def axes_of(file: Path) -> tuple[NamedAxis, ...]:
    """Return the axes of a machine file with their directions, in command order.

    Raises:
        InputError: the file or its URDF cannot be read or is not one of a machine.
    """
    import yaml  # needed only here

    try:
        entries = yaml.load(read_text(file, most_bytes=MAX_BYTES), Loader=yaml.SafeLoader)
        root = ElementTree.fromstring(read_text(file.parent / entries["urdf"], most_bytes=MAX_BYTES))
        return _named(entries["axes"], {str(joint.get("name")): joint for joint in root.iter("joint")})
    except (yaml.YAMLError, ElementTree.ParseError, LookupError, TypeError, ValueError, AttributeError) as error:
        raise InputError("not a machine", expected="a machine file and its URDF", file=file, value=error) from error


def _named(entries: Sequence[Mapping[str, Any]], joints: Mapping[str, ElementTree.Element]) -> tuple[NamedAxis, ...]:
    frames = [
        _from_rpy([radians(angle) for angle in entry.get("error_frame_rpy_deg", (0.0, 0.0, 0.0))]) for entry in entries
    ]
    turns = [_product(_orientation(one["joint"], joints), frame) for one, frame in zip(entries, frames, strict=True)]
    linear = [i for i, one in enumerate(entries) if one["kind"] == "linear"]
    reference = turns[linear[0]] if linear else IDENTITY
    aligned = (_product(_transposed(reference), turns[i]) for i in linear)
    if any(min(rows[k][k] for k in range(3)) < MIN_ALIGNMENT for rows in aligned):
        reference = IDENTITY
    named = []
    for i, one in enumerate(entries):
        axis = joints[one["joint"]].find("axis")
        motion = _numbers(None if axis is None else axis.get("xyz"), (1.0, 0.0, 0.0))
        length = hypot(*motion)
        direction = _turned(_transposed(frames[i]), tuple(part / length for part in motion))
        in_machine = _turned(_product(_transposed(reference), turns[i]), direction)
        named.append(NamedAxis(one["name"], i in linear, direction, in_machine))
    return tuple(named)


def _orientation(name: str, joints: Mapping[str, ElementTree.Element]) -> Rows:
    """Return the orientation of a joint in the base frame, all joints at zero."""
    carrying = {_link(joint, "child"): joint for joint in joints.values()}
    turn, joint = IDENTITY, joints.get(name)
    if joint is None:
        raise LookupError(name)
    for _ in joints:
        if joint is None:
            break
        origin = joint.find("origin")
        turn = _product(_from_rpy(_numbers(None if origin is None else origin.get("rpy"), (0.0, 0.0, 0.0))), turn)
        joint = carrying.get(_link(joint, "parent"))
    return turn


def _link(joint: ElementTree.Element, side: str) -> str:
    end = joint.find(side)
    return "" if end is None else end.get("link", "")


def _numbers(text: str | None, default: Vector) -> Vector:
    x, y, z = default if text is None else map(float, text.split())
    return x, y, z


def _from_rpy(rpy: Sequence[float]) -> Rows:
    """Return the rotation by roll, pitch and yaw about the fixed x, y and z (URDF)."""
    (a, b, c), (d, e, f) = map(cos, rpy), map(sin, rpy)
    return (
        (c * b, c * e * d - f * a, c * e * a + f * d),
        (f * b, f * e * d + c * a, f * e * a - c * d),
        (-e, b * d, b * a),
    )


def _transposed(rows: Rows) -> Rows:
    x, y, z = zip(*rows, strict=True)
    return x, y, z


def _turned(rows: Rows, vector: Sequence[float]) -> Vector:
    x, y, z = (sum(a * b for a, b in zip(row, vector, strict=True)) for row in rows)
    return x, y, z


def _product(first: Rows, second: Rows) -> Rows:
    columns = _transposed(second)
    return _transposed((_turned(first, columns[0]), _turned(first, columns[1]), _turned(first, columns[2])))


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _largest(vector: Vector) -> int:
    """Return the index of the component with the largest absolute value."""
    return max(range(3), key=lambda i: abs(vector[i]))
