"""Entries of a machine file, and checks that they fit its URDF."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final, Literal, final

import numpy as np
import pinocchio as pin
from pydantic import BaseModel, ConfigDict, Field

from twin._common.errors import InputError
from twin._common.units import DEG
from twin._common.yaml_files import EntryPath, line_of
from twin.machine.error_names import MIN_ALIGNMENT
from twin.machine.urdf_file import read_urdf

SCHEMA = "twin.machine/1"
MAX_AXES: Final = 16
"""Largest number of axes. An axis has up to twelve error components, and Pinocchio's data grow with the cube of their total number."""
MAX_POSITION: Final = 1e6
"""Largest position of an axis, mm or degrees: a kilometre."""
LONGEST_TOOL_MM: Final = 5_000.0
"""Largest tool length: twice that of long boring bars. A larger value is a wrong unit or a misplaced decimal point."""

_Position = Annotated[float, Field(ge=-MAX_POSITION, le=MAX_POSITION)]


@final
class AxisEntry(BaseModel):
    """One axis."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9]*$")]
    joint: str
    kind: Literal["linear", "rotary"]
    range: tuple[_Position, _Position] | Literal["unlimited"]
    increment: Annotated[float, Field(gt=0, le=MAX_POSITION)]
    error_frame_rpy_deg: tuple[_Position, _Position, _Position] = (0.0, 0.0, 0.0)


@final
class Frames(BaseModel):
    """Links that are the tool and work frames, and axis coordinates of the URDF's zero position."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
    tool: str
    work: str
    origin: dict[str, _Position] = {}


@final
class Programs(BaseModel):
    """Defaults for programs on this machine."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
    tool_length: Annotated[float, Field(ge=0, le=LONGEST_TOOL_MM)] = 0.0
    tcp_on: tuple[str, ...] = ()
    tcp_off: tuple[str, ...] = ()
    harmless: tuple[str, ...] = ()


@final
class Magnitudes(BaseModel):
    """Prior standard deviations of errors of one kind, µm and µrad."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
    um: Annotated[float, Field(gt=0.0, le=1e5)] = 1000.0
    urad: Annotated[float, Field(gt=0.0, le=1e5)] = 1000.0


class Plausible(BaseModel):
    """Prior standard deviations by kind: error motions; squareness and locations of rotary axes."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    motion: Magnitudes = Magnitudes()
    location: Magnitudes = Magnitudes()


class MachineFile(BaseModel):
    """A machine file."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
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
    text = read_urdf(path)
    try:
        return pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        raise InputError(
            "not a URDF that Pinocchio can load", expected="a URDF robot", file=path, value=error
        ) from error


def check_entries(entries: MachineFile, source: pin.Model, path: Path, lines: Mapping[EntryPath, int]) -> None:
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
    bodies = [frame.name for frame in source.frames if frame.type == pin.FrameType.BODY]
    for key in ("tool", "work"):
        if getattr(entries.frames, key) not in bodies:
            raise InputError(
                f"{entries.urdf} has no such link",
                expected=f"one of {', '.join(bodies)}",
                file=path,
                line=line_of(("frames", key), lines),
                value=getattr(entries.frames, key),
            )
    for name in entries.frames.origin:
        if not any(entry.name == name and entry.kind == "linear" for entry in entries.axes):
            raise InputError(
                "origin of something that is not a linear axis",
                expected="names of linear axes",
                file=path,
                line=line_of(("frames", "origin", name), lines),
                value=name,
            )


def turns_in_machine_frame(
    entries: MachineFile, source: pin.Model, path: Path, lines: Mapping[EntryPath, int]
) -> dict[str, np.ndarray]:
    """Return the rotation of every axis's error frame in the machine frame, all joints at zero.

    The machine frame has the directions of the first linear axis's error frame, or of the base frame if other linear axes are inclined
    to the first by more than 45°.

    Raises:
        InputError: the error frame of a linear axis is turned so far that its components would be named after other directions.
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
