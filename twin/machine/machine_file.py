"""Entries of a machine file, and checks that they fit its URDF.

Reading of a URDF file, with checks of its size, numbers and tree before it is passed to Pinocchio.

Pinocchio's reader ends the process on a deep chain, accepts an axis of length zero, and gives no line numbers. Units: metres and
radians.
"""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final, Literal, final
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from pydantic import BaseModel, ConfigDict, Field

from twin._common.errors import InputError, closest_name
from twin._common.files import read_text
from twin._common.units import DEG
from twin._common.xml_files import Element, parse_xml
from twin._common.yaml_files import EntryPath, line_of
from twin.machine.error_names import MIN_ALIGNMENT

MAX_BYTES: Final = 4_000_000
"""Largest file accepted. The files that come with twin have 20 kB."""
MAX_LINKS: Final = 1_000
"""Largest number of links. Pinocchio's reader recurses along the chain and ends the process at some 10,000."""
MAX_MOVING_JOINTS: Final = 50
"""Largest number of moving joints. The memory of Pinocchio's data grows with the cube of it: 64 MB per table at 200."""
MAX_COORDINATE_M: Final = 1e3
"""Largest coordinate and size, m. Beyond it, double precision does not resolve a picometre."""
MAX_MASS_DISTANCE: Final = 5.0
"""Largest distance of a centre of mass from its link, as a multiple of the total length of all joints (at least 1 m)."""
MIN_AXIS_LENGTH: Final = 1e-6
"""Shortest axis vector accepted; Pinocchio scales it to length one."""
MOVING: Final = ("prismatic", "revolute", "continuous")
TYPES: Final = (*MOVING, "fixed")

_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_COUNTS: Final[Mapping[tuple[str, str], int]] = {
    ("origin", "xyz"): 3,
    ("origin", "rpy"): 3,
    ("axis", "xyz"): 3,
    ("limit", "lower"): 1,
    ("limit", "upper"): 1,
    ("limit", "effort"): 1,
    ("limit", "velocity"): 1,
    ("dynamics", "damping"): 1,
    ("dynamics", "friction"): 1,
    ("mass", "value"): 1,
    **{("inertia", name): 1 for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")},
    ("box", "size"): 3,
    ("cylinder", "radius"): 1,
    ("cylinder", "length"): 1,
    ("capsule", "radius"): 1,
    ("capsule", "length"): 1,
    ("sphere", "radius"): 1,
    ("mesh", "scale"): 3,
    ("color", "rgba"): 4,
}
"""Number of values of an attribute of an element."""
_NEEDED: Final[Mapping[str, tuple[str, ...]]] = {
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "limit": ("effort", "velocity"),
    "axis": ("xyz",),
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "mesh": ("filename",),
}
"""Required attributes: without them Pinocchio's reader drops the enclosing element, for example a link's mass or shape."""
_PARTS: Final[Mapping[str, tuple[str, ...]]] = {
    "inertial": ("mass", "inertia"),
    "visual": ("geometry",),
    "collision": ("geometry",),
}
"""Required child elements."""
_LENGTHS: Final = frozenset(
    {
        ("origin", "xyz"),
        ("box", "size"),
        *((kind, name) for kind in ("cylinder", "capsule") for name in ("radius", "length")),
    }
    | {("sphere", "radius")}
)
_NOT_NEGATIVE: Final = frozenset(
    {("mass", "value"), ("inertia", "ixx"), ("inertia", "iyy"), ("inertia", "izz")} | (_LENGTHS - {("origin", "xyz")})
)


def read_urdf(path: Path) -> str:
    """Return the text of a URDF file after checking that Pinocchio can read it safely.

    Raises:
        InputError: the file is too large, is not XML, or is not a tree of links and joints with finite numbers; it names the line.
    """
    text = _text(path)
    robot = parse_xml(text, path, "a URDF file")
    if robot.name != "robot":
        raise InputError("not a URDF", expected="a <robot> element", file=path, line=robot.line, value=robot.name)
    _check_parts(robot, path)
    _check_tree(robot, path)
    _check_masses(robot, path)
    return text


def _text(path: Path) -> str:
    try:
        size = path.stat().st_size
    except OSError as error:
        raise InputError("cannot be read", expected="a readable file", file=path, value=error.strerror) from error
    if size > MAX_BYTES:
        raise InputError("too large for a URDF", expected=f"at most {MAX_BYTES:,} bytes", file=path, value=f"{size:,}")
    return read_text(path)


def _check_parts(robot: Element, path: Path) -> None:
    for part in robot.children:
        if part.name not in ("link", "joint"):
            continue
        for one in part.within():
            _check_complete(one, path)
            for name, text in one.attributes.items():
                count = _COUNTS.get((one.name, name))
                if count is not None:
                    _check_number(one, name, text, count, path)


def _check_complete(one: Element, path: Path) -> None:
    lacking = [f'{name}="…"' for name in _NEEDED.get(one.name, ()) if name not in one.attributes]
    lacking += [f"<{name}>" for name in _PARTS.get(one.name, ()) if not one.each(name)]
    if one.name == "geometry" and not one.children:
        lacking.append("a shape")
    if lacking:
        raise InputError(f"<{one.name}> is not complete", expected=" and ".join(lacking), file=path, line=one.line)


def _check_number(one: Element, name: str, text: str, count: int, path: Path) -> None:
    def refuse(expected: str) -> InputError:
        return InputError(
            f'<{one.name} {name}="…"> is invalid', expected=expected, file=path, line=one.line, value=text
        )

    words = text.split()
    if len(words) != count or not all(_NUMBER.fullmatch(word) for word in words):
        raise refuse("a number" if count == 1 else f"{count} numbers separated by blanks")
    values = [float(word) for word in words]
    if not all(map(math.isfinite, values)):
        raise refuse("finite numbers")
    if (one.name, name) in _LENGTHS and max(map(abs, values)) > MAX_COORDINATE_M:
        raise refuse(f"metres, at most {MAX_COORDINATE_M:g}")
    if (one.name, name) in _NOT_NEGATIVE and min(values) < 0.0:
        raise refuse("zero or more")
    if one.name == "axis" and not MIN_AXIS_LENGTH <= math.hypot(*values) <= 1.0 / MIN_AXIS_LENGTH:
        raise refuse('a unit vector, such as "1 0 0"')


def _check_tree(robot: Element, path: Path) -> None:
    """Raise `InputError` unless links and joints are one tree that starts at one link."""
    links, joints = robot.each("link"), robot.each("joint")
    if not links:
        raise InputError("no links", expected="a robot of links and joints", file=path, line=robot.line)
    if len(links) > MAX_LINKS or len(joints) > MAX_LINKS:
        raise InputError(
            "too many links", expected=f"at most {MAX_LINKS:,}", file=path, value=max(len(links), len(joints))
        )
    moving = sum(joint.attributes.get("type") in MOVING for joint in joints)
    if moving > MAX_MOVING_JOINTS:
        raise InputError("too many moving joints", expected=f"at most {MAX_MOVING_JOINTS}", file=path, value=moving)
    for kind, parts in (("link", links), ("joint", joints)):
        seen: Counter[str] = Counter()
        for part in parts:
            name = part.attributes.get("name", "")
            seen[name] += 1
            if not name or seen[name] > 1:
                what = f"duplicate {kind}" if name else f"a {kind} without a name"
                raise InputError(
                    what, expected="every name once", file=path, line=part.line, value=name if name else None
                )
    known = [link.attributes["name"] for link in links]
    carried: dict[str, Element] = {}
    below: defaultdict[str, list[str]] = defaultdict(list)
    for joint in joints:
        _check_joint(joint, path)
        parent, child = (_end(joint, kind, known, path) for kind in ("parent", "child"))
        if child in carried:
            raise InputError(
                "a link carried by two joints", expected="one joint per link", file=path, line=joint.line, value=child
            )
        carried[child] = joint
        below[parent].append(child)
    _check_roots(known, carried, below, path)


def _check_masses(robot: Element, path: Path) -> None:
    """Raise `InputError` if the centre of mass of a link is implausibly far from it."""
    steps = [_numbers(origin, "xyz") for joint in robot.each("joint") for origin in joint.each("origin")]
    travels = [
        [float(limit.attributes.get("upper", 0.0)) - float(limit.attributes.get("lower", 0.0))]
        for joint in robot.each("joint")
        if joint.attributes.get("type") == "prismatic"
        for limit in joint.each("limit")
    ]
    farthest = MAX_MASS_DISTANCE * max(sum(math.hypot(*step) for step in (*steps, *travels)), 1.0)
    for link in robot.each("link"):
        for origin in (origin for inertial in link.each("inertial") for origin in inertial.each("origin")):
            away = math.hypot(*_numbers(origin, "xyz"))
            if away > farthest:
                raise InputError(
                    f"the centre of mass of {link.attributes['name']} is {away:g} m away",
                    expected=f"metres, within {farthest:.3g} m of the link, {MAX_MASS_DISTANCE:g} times the length of all joints",
                    file=path,
                    line=origin.line,
                    value=origin.attributes["xyz"],
                )


def _numbers(one: Element, name: str) -> list[float]:
    """Return the numbers of a checked attribute; empty if it is absent."""
    return [float(word) for word in one.attributes.get(name, "").split()]


def _check_joint(joint: Element, path: Path) -> None:
    name, kind = joint.attributes["name"], joint.attributes.get("type", "")

    def refuse(what: str, expected: str, value: str) -> InputError:
        return InputError(
            what, expected=expected, file=path, line=joint.line, value=value, nearest=closest_name(value, TYPES)
        )

    if kind not in TYPES:
        raise refuse(f"joint {name} has an unsupported type", f"one of {', '.join(TYPES)}", kind)
    if kind in ("prismatic", "revolute") and not joint.each("limit"):
        raise refuse(f"a {kind} joint without <limit>", '<limit lower="…" upper="…" effort="0" velocity="1"/>', name)
    if joint.each("mimic"):
        raise refuse("a joint that follows another (<mimic>)", "joints that move independently", name)


def _end(joint: Element, kind: str, known: list[str], path: Path) -> str:
    """Return the name of the link at one end of a joint."""
    ends = joint.each(kind)
    link = ends[0].attributes.get("link", "") if len(ends) == 1 else ""
    if link not in known:
        what = f"joint {joint.attributes['name']} has no {kind} link" if not link else "no such link"
        raise InputError(
            what,
            expected=f'one <{kind} link="…"/> that names a link of the file',
            file=path,
            line=ends[0].line if len(ends) == 1 else joint.line,
            value=link or None,
            nearest=closest_name(link, known) if link else None,
        )
    return link


def _check_roots(known: list[str], carried: Mapping[str, Element], below: Mapping[str, list[str]], path: Path) -> None:
    roots = [name for name in known if name not in carried]
    if len(roots) > 1:
        raise InputError(
            "links that no joint connects",
            expected="exactly one link that is not the child of a joint",
            file=path,
            value=", ".join(roots),
        )
    reached, waiting = set(roots), list(roots)
    while waiting:
        children = below.get(waiting.pop(), [])
        reached.update(children)
        waiting += children
    for name in known:
        if name not in reached:
            raise InputError(
                "joints that form a loop",
                expected="a tree of links that starts at one link",
                file=path,
                line=carried[name].line,
                value=name,
            )


# --- Entries of a machine file, and checks that they fit its URDF ---------------------------------

SCHEMA = "twin.machine/1"
UPRIGHT_FRAMES: Final[Mapping[str, np.ndarray]] = {
    "Z": np.eye(3),
    "Y": np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]),
}
"""Rotations (3, 3) from the base frame to right, back and up, as seen by a person who faces the column, by the axis that is up."""
MAX_AXES: Final = 16
"""Largest number of axes. An axis has up to twelve error components, and Pinocchio's data grow with the cube of their total number."""
MAX_POSITION: Final = 1e6
"""Largest position of an axis, mm or degrees: a kilometre."""
LONGEST_TOOL_MM: Final = 5_000.0
"""Largest tool length: twice that of long boring bars. A larger value is a wrong unit or a misplaced decimal point."""

_Position = Annotated[float, Field(ge=-MAX_POSITION, le=MAX_POSITION)]


class FileEntry(BaseModel):
    """Entry of a YAML file: all names known, all numbers finite, immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


@final
class AxisEntry(FileEntry):
    """One axis."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9]*$")]
    joint: str
    kind: Literal["linear", "rotary"]
    range: tuple[_Position, _Position] | Literal["unlimited"]
    increment: Annotated[float, Field(gt=0, le=MAX_POSITION)]
    error_frame_rpy_deg: tuple[_Position, _Position, _Position] = (0.0, 0.0, 0.0)


@final
class Frames(FileEntry):
    """Links that are the tool and work frames, the upward axis of the base frame, and axis coordinates of the URDF's zero position."""

    tool: str
    work: str
    up: Literal["Y", "Z"] = "Z"
    origin: dict[str, _Position] = {}


@final
class Programs(FileEntry):
    """Defaults for programs on this machine."""

    tool_length: Annotated[float, Field(ge=0, le=LONGEST_TOOL_MM)] = 0.0
    tcp_on: tuple[str, ...] = ()
    tcp_off: tuple[str, ...] = ()
    harmless: tuple[str, ...] = ()
    auxiliary_axes: tuple[Annotated[str, Field(pattern=r"^[A-CU-Za-cu-z]$")], ...] = ()
    references: Mapping[Annotated[str, Field(pattern=r"^(?:G28|G30(?: P[234])?|G74)$")], Mapping[str, _Position]] = {}


@final
class Magnitudes(FileEntry):
    """Prior standard deviations of errors of one kind, µm and µrad."""

    um: Annotated[float, Field(gt=0.0, le=1e5)] = 1000.0
    urad: Annotated[float, Field(gt=0.0, le=1e5)] = 1000.0


class Plausible(FileEntry):
    """Prior standard deviations by kind: error motions; squareness and locations of rotary axes."""

    motion: Magnitudes = Magnitudes()
    location: Magnitudes = Magnitudes()


class MachineFile(FileEntry):
    """A machine file."""

    schema_: Literal["twin.machine/1"] = Field(alias="schema")
    name: str
    urdf: str
    calibration: str | None = None
    axes: Annotated[tuple[AxisEntry, ...], Field(min_length=1, max_length=MAX_AXES)]
    frames: Frames
    programs: Programs = Programs()
    plausible: Plausible = Plausible()


def load_urdf(path: Path) -> pin.Model:
    """Return the Pinocchio model of a URDF file.

    Raises:
        InputError: the file is invalid (see `read_urdf`), or Pinocchio cannot load it.
    """
    text = _without_continuous(read_urdf(path))
    try:
        return pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        raise InputError(
            "not a URDF that Pinocchio can load", expected="a URDF robot", file=path, value=error
        ) from error


def _without_continuous(text: str) -> str:
    """Return the URDF with its ``continuous`` joints as ``revolute`` ones, which have one coordinate in Pinocchio, not two.

    Their ranges are those of the machine file, as for all joints.
    """
    if "continuous" not in text:
        return text
    robot = ElementTree.fromstring(text)
    for joint in robot.iter("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            limit = ElementTree.SubElement(joint, "limit", effort="0", velocity="1") if limit is None else limit
            limit.attrib |= {"lower": "-10000", "upper": "10000"}
    return ElementTree.tostring(robot, encoding="unicode")


def check_entries(entries: MachineFile, source: pin.Model, path: Path, lines: Mapping[EntryPath, int]) -> None:  # noqa: C901
    """Raise `InputError` unless the axes and frames of a machine file are in its URDF, each once, with a range."""
    joints = [name for name in source.names if name != "universe"]
    seen: set[str] = set()
    used: set[str] = set()
    for index, entry in enumerate(entries.axes):
        place: EntryPath = ("axes", index)

        def fail(key: str, what: str, expected: str, value: object, place: EntryPath = place) -> InputError:
            return InputError(what, expected=expected, file=path, line=line_of((*place, key), lines), value=value)

        if entry.name in seen:
            raise fail("name", "duplicate axis", "each axis once", entry.name)
        seen.add(entry.name)
        if entry.joint in used:
            raise fail("joint", "duplicate joint", "another joint for every axis", entry.joint)
        used.add(entry.joint)
        added = {f"{entry.joint}:error", f"{entry.joint}:location"} & set(joints)
        if added:
            raise fail(
                "joint", "the URDF has a joint with a name reserved by twin", f"no joint {added.pop()}", entry.joint
            )
        if entry.joint not in joints:
            raise fail("joint", f"{entries.urdf} has no such moving joint", f"one of {', '.join(joints)}", entry.joint)
        joint = source.joints[source.getJointId(entry.joint)]
        if joint.nq != 1 or joint.nv != 1:
            raise fail(
                "joint", f"joint is {joint.shortname()}", "a prismatic or a (limited) revolute joint", entry.joint
            )
        if ("P" in joint.shortname().removeprefix("JointModel")[:1]) != (entry.kind == "linear"):
            kind = "linear" if entry.kind == "rotary" else "rotary"
            does = "slides" if kind == "linear" else "turns"
            raise fail("kind", f"joint {entry.joint} of the URDF {does}", f"kind: {kind}", entry.kind)
        if entry.range == "unlimited":
            if entry.kind == "linear":
                raise fail("range", "a linear axis without limits", "range: [lower, upper] in mm", entry.range)
        elif not entry.range[0] < entry.range[1]:
            raise fail("range", "an empty range", "[lower, upper] with lower < upper", list(entry.range))
    _check_frames(entries, source, path, lines)


def _check_frames(entries: MachineFile, source: pin.Model, path: Path, lines: Mapping[EntryPath, int]) -> None:
    def fail(place: EntryPath, what: str, expected: str, value: str) -> InputError:
        return InputError(what, expected=expected, file=path, line=line_of(place, lines), value=value)

    bodies = [frame.name for frame in source.frames if frame.type == pin.FrameType.BODY]
    for key, link in (("tool", entries.frames.tool), ("work", entries.frames.work)):
        if link not in bodies:
            raise fail(("frames", key), f"{entries.urdf} has no such link", f"one of {', '.join(bodies)}", link)
    for word, places in entries.programs.references.items():
        for name in places:
            if not any(entry.name == name for entry in entries.axes):
                what = "reference position of something that is not an axis"
                raise fail(("programs", "references", word, name), what, "names of axes", name)
    for name in entries.frames.origin:
        if not any(entry.name == name and entry.kind == "linear" for entry in entries.axes):
            what = "origin of something that is not a linear axis"
            raise fail(("frames", "origin", name), what, "names of linear axes", name)


def turns_in_machine_frame(
    entries: MachineFile, source: pin.Model, path: Path, lines: Mapping[EntryPath, int]
) -> dict[str, np.ndarray]:
    """Return the rotation of every axis's error frame in the machine frame, all joints at zero.

    The machine frame has the directions of the first linear axis's error frame, or of the base frame if other linear axes are inclined
    to the first by more than 45°.
    """
    data = source.createData()
    pin.forwardKinematics(source, data, pin.neutral(source))
    joints = {entry.name: data.oMi[source.getJointId(entry.joint)].rotation for entry in entries.axes}
    turns = {entry.name: joints[entry.name] @ error_frame(entry).rotation for entry in entries.axes}
    linear = [entry.name for entry in entries.axes if entry.kind == "linear"]
    for reference in (*(turns[name] for name in linear[:1]), np.eye(3)):
        found = {name: reference.T @ turn for name, turn in turns.items()}
        turned = [name for name in linear if np.min(np.diag(found[name])) < MIN_ALIGNMENT]
        if not turned:
            return found
    angles = np.round(pin.rpy.matrixToRpy(joints[turned[0]].T) / DEG, 4) + 0.0
    index = [entry.name for entry in entries.axes].index(turned[0])
    raise InputError(
        f"the error frame of linear axis {turned[0]} is turned: its errors would be named after other directions",
        expected=f"error_frame_rpy_deg: [{', '.join(f'{angle:g}' for angle in angles)}] for this axis, "
        "so that x, y and z are those of the base",
        file=path,
        line=line_of(("axes", index), lines),
        value=entries.axes[index].joint,
    )


def error_frame(entry: AxisEntry) -> pin.SE3:
    """Return the placement of an axis's error frame in its joint's frame."""
    return pin.SE3(pin.rpy.rpyToMatrix(*(angle * DEG for angle in entry.error_frame_rpy_deg)), np.zeros(3))
