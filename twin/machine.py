"""A machine: its URDF and machine file, as one Pinocchio model with an error frame at every axis joint.

The contract's chain (§1), for every axis wherever it stands:

- a linear axis: motion, then error: ``T_a(q) · E_a``;
- a rotary axis: location, error in the frame that does not turn, then motion: ``L_a · E_a · R_a(q)``.

Each ``E`` and ``L`` is a free-flyer joint of the model, so that Pinocchio's own Jacobian columns are the sensitivities
to the six error motions. Nothing here knows one machine from another: axes, ranges and frames come from the files.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Final, Literal, final

import numpy as np
import pinocchio as pin
from pydantic import BaseModel, ConfigDict, Field

from twin.arrays import locked
from twin.errors import InputError, nearest
from twin.files import Place, line_of, load_yaml, read_text
from twin.show import Cell, card, chain, pairs, span, table
from twin.units import DEG, MM

SCHEMA = "twin.machine/1"
DIRECTIONS = "XYZABC"
"""Components of an error frame in order: translations along, rotations about x, y, z (ISO 230-1, 3.4)."""
AXIS_HEADERS = ("axis", "kind", "range", "least increment", "carries", "joint in the URDF")


@final
@dataclass(frozen=True)
class Axis:
    """One axis of a machine.

    Attributes:
        name: its name in programs and data (``X``, ``B``, ``J1``).
        joint: its joint in the URDF.
        linear: whether it translates (mm) or turns (degrees).
        lower, upper: range in mm or degrees; None, None for an unlimited rotary axis.
        increment: least increment in mm or degrees.
        direction: unit vector of the motion, in the axis's error frame.
        side: where it acts: ``tool`` or ``work``; ``both`` for a joint under both, which moves nothing between them.
    """

    name: str
    joint: str
    linear: bool
    lower: float | None
    upper: float | None
    increment: float
    direction: tuple[float, float, float]
    side: Literal["tool", "work", "both"]

    @property
    def unit(self) -> Literal["mm", "deg"]:
        """The unit users see."""
        return "mm" if self.linear else "deg"

    @property
    def domain(self) -> tuple[float, float]:
        """Its range, mm or degrees; one turn where it is unlimited."""
        return (0.0, 360.0) if self.lower is None or self.upper is None else (self.lower, self.upper)

    @property
    def scale(self) -> float:
        """Metres a millimetre, or radians a degree."""
        return MM if self.linear else DEG

    def cells(self) -> tuple[Cell, ...]:
        """What a display has of it, under `AXIS_HEADERS`."""
        reach = "unlimited" if self.lower is None else span(*self.domain, self.unit)
        least = f"{self.increment:g} mm" if self.linear else f"{self.increment:g}°"
        return self.name, "linear" if self.linear else "rotary", reach, least, self.side, self.joint

    def _repr_html_(self) -> str:
        return card(f"Axis {self.name}", table(AXIS_HEADERS, [self.cells()])).text


@final
@dataclass(frozen=True)
class ErrorFrame:
    """One six-component frame of a machine's chain.

    Attributes:
        axis: the axis it belongs to.
        role: ``motion`` for the error motions E_XX … of an axis, ``location`` for E_X0C … of a rotary axis.
        joint: index of its free-flyer joint in the Pinocchio model.
    """

    axis: str
    role: Literal["motion", "location"]
    joint: int


class _AxisEntry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9]*$")]
    joint: str
    kind: Literal["linear", "rotary"]
    range: tuple[float, float] | Literal["unlimited"]
    increment: Annotated[float, Field(gt=0)]
    error_frame_rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)


class _Frames(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    tool: str
    work: str
    origin: dict[str, float] = {}


class _Programs(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    tool_length: float = 0.0
    tcp_on: tuple[str, ...] = ()
    tcp_off: tuple[str, ...] = ()


class _MachineFile(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    schema_: Literal["twin.machine/1"] = Field(alias="schema")
    name: str
    urdf: str
    calibration: str | None = None
    axes: Annotated[tuple[_AxisEntry, ...], Field(min_length=1)]
    frames: _Frames
    programs: _Programs = _Programs()


DEFAULT: Final = "dmu50"
"""The machine file where none is named: of those that come with twin."""


@final
class Machine:
    """A machine as loaded: immutable, and the same for everybody who uses it.

    Attributes:
        name: the machine's name.
        path: the machine file.
        urdf: the URDF file.
        axes: its axes in command order.
        model: the Pinocchio model, metres and radians, with a free-flyer joint for every error frame.
        frames: the error frames in the order in which errors are passed as arrays.
        tool_frame, work_frame: indices of the tool and work frames in ``model.frames``.
        default_calibration: path of the calibration used when none is given, or None.
        tool_length_mm: the tool length when none is given.
        tcp_on, tcp_off: words that switch the control's kinematics on and off on this machine.
    """

    def __init__(self, path: Path) -> None:
        entries, lines = load_yaml(path, _MachineFile, SCHEMA)
        self.name = entries.name
        self.path = path
        self.urdf = (path.parent / entries.urdf).resolve()
        self.tool_length_mm = entries.programs.tool_length
        self.tcp_on = tuple(word.upper() for word in entries.programs.tcp_on)
        self.tcp_off = tuple(word.upper() for word in entries.programs.tcp_off)
        self.default_calibration = (
            None if entries.calibration is None else (path.parent / entries.calibration).resolve()
        )
        if not self.urdf.is_file():
            raise InputError(
                "no such URDF",
                expected="a file beside the machine file",
                file=path,
                line=lines[("urdf",)],
                value=entries.urdf,
            )
        source = _load_urdf(self.urdf)
        _check(entries, source, path, lines)
        self.model, joint_of, self.frames = _with_error_frames(source, entries)
        self.tool_frame = int(self.model.getFrameId(entries.frames.tool))
        self.work_frame = int(self.model.getFrameId(entries.frames.work))
        self._axis_joints = tuple(joint_of[entry.name] for entry in entries.axes)
        self.axes = tuple(self._axis(entry, source) for entry in entries.axes)
        self.by_name: Mapping[str, Axis] = MappingProxyType({axis.name: axis for axis in self.axes})

    @classmethod
    def load(cls, machine: str | Path) -> Machine:
        """Load a machine file, or one that comes with `twin` by its bare name (``dmu50``).

        Raises:
            InputError: there is no such file, or it does not fit; with the line.
        """
        return cls(find_bundled(machine, ".yaml", "a machine file"))

    @property
    def axis_joints(self) -> tuple[int, ...]:
        """Index in the Pinocchio model of the joint of every axis, in command order."""
        return self._axis_joints

    @property
    def names(self) -> tuple[str, ...]:
        """Axis names in command order."""
        return tuple(axis.name for axis in self.axes)

    @cached_property
    def scale(self) -> np.ndarray:
        """(axes,) metres a millimetre or radians a degree, in command order."""
        return locked(np.array([axis.scale for axis in self.axes]))

    @cached_property
    def limits(self) -> np.ndarray:
        """(axes, 2) lower and upper limits in metres and radians; infinite for an unlimited axis."""
        rows = [
            (-np.inf, np.inf)
            if axis.lower is None or axis.upper is None
            else (axis.lower * axis.scale, axis.upper * axis.scale)
            for axis in self.axes
        ]
        return locked(np.array(rows))

    @property
    def linear(self) -> tuple[int, ...]:
        """Indices of the linear axes in command order."""
        return tuple(i for i, axis in enumerate(self.axes) if axis.linear)

    @property
    def rotary(self) -> tuple[int, ...]:
        """Indices of the rotary axes in command order."""
        return tuple(i for i, axis in enumerate(self.axes) if not axis.linear)

    @property
    def runs_programs(self) -> bool:
        """Whether NC programs can be worked out for it: three linear axes and at most two rotary ones."""
        return len(self.linear) == 3 and len(self.rotary) <= 2

    def check_programs(self) -> None:
        """That it does.

        Raises:
            InputError: other axes.
        """
        if not self.runs_programs:
            raise InputError(
                f"{self.name} has {len(self.linear)} linear and {len(self.rotary)} rotary axes",
                expected="three linear axes and at most two rotary ones, to run programs",
                file=self.path,
            )

    @property
    def as_option(self) -> str:
        """What a command needs to be about this machine: `` --machine mine.yaml``; nothing where it is the default."""
        file = self.path.resolve()
        bundled = file.parent == bundled_folder().resolve()
        return "" if bundled and file.stem == DEFAULT else f" --machine {file.stem if bundled else file.name}"

    def error_names(self, frame: ErrorFrame) -> tuple[str, ...]:
        """ISO 230-1 names of a frame's six components: ``E_XX`` … ``E_CX``, or ``E_X0C`` … ``E_C0C``."""
        mark = "" if frame.role == "motion" else "0"
        return tuple(f"E_{direction}{mark}{frame.axis}" for direction in DIRECTIONS)

    @cached_property
    def motion_names(self) -> tuple[str, ...]:
        """Names of all error motions (curves), six an axis."""
        return tuple(name for frame in self.frames if frame.role == "motion" for name in self.error_names(frame))

    @cached_property
    def location_names(self) -> tuple[str, ...]:
        """Names of the rotary axes' locations: two offsets and two angles each, across the axis (ISO 230-1, 3.5)."""
        names: list[str] = []
        for frame in self.frames:
            if frame.role == "location":
                along = int(np.argmax(np.abs(self.by_name[frame.axis].direction)))
                six = self.error_names(frame)
                names += [six[i] for i in range(3) if i != along] + [six[3 + i] for i in range(3) if i != along]
        return tuple(names)

    @cached_property
    def squareness_names(self) -> tuple[str, ...]:
        """Names of the squareness errors the datum leaves: none for the first linear axis, one for the second, then two.

        The first linear axis is the datum axis; the second lies in the datum plane with it (contract §1).
        """
        names: list[str] = []
        seen: list[np.ndarray] = []
        for index in self.linear:
            axis = self.axes[index]
            direction = np.array(axis.direction)
            if len(seen) == 1:
                normal = int(np.argmax(np.abs(np.cross(seen[0], direction))))
                names.append(f"E_{'ABC'[normal]}0{axis.name}")
            elif len(seen) >= 2:
                along = int(np.argmax(np.abs(direction)))
                names += [f"E_{'ABC'[i]}0{axis.name}" for i in range(3) if i != along]
            seen.append(direction)
        return tuple(names)

    def configuration(self, q: np.ndarray, errors: np.ndarray | None = None) -> np.ndarray:
        """Pinocchio configuration of one pose.

        Args:
            q: (axes,) positions in metres and radians, command order.
            errors: (frames, 6) translations and rotation vectors in metres and radians, order ``frames``; None for zero.

        Returns:
            (model.nq,) configuration.
        """
        configuration = pin.neutral(self.model)
        for joint, value in zip(self._axis_joints, q, strict=True):
            configuration[self.model.joints[joint].idx_q] = value
        if errors is not None:
            for frame, error in zip(self.frames, errors, strict=True):
                start = self.model.joints[frame.joint].idx_q
                configuration[start : start + 3] = error[:3]
                configuration[start + 3 : start + 7] = pin.Quaternion(pin.exp3(error[3:])).coeffs()
        return configuration

    def _repr_html_(self) -> str:
        ordered = [axis for _, axis in sorted(zip(self._axis_joints, self.axes, strict=True), key=lambda one: one[0])]
        tool = [(axis.name, "axis") for axis in ordered if axis.side == "tool"]
        work = [(axis.name, "axis") for axis in reversed(ordered) if axis.side == "work"]
        links = chain([("workpiece", "end"), *work, ("base", "fixed"), *tool, ("tool", "end")])
        numbers = (
            f"{len(self.motion_names)} error motions, squareness {' '.join(self.squareness_names) or 'none'}, "
            f"axis locations {' '.join(self.location_names) or 'none'}"
        )
        rows = [("machine file", str(self.path)), ("URDF", str(self.urdf)), ("can err in", numbers)]
        rows.append(("tool length", f"{self.tool_length_mm:g} mm, if nobody says otherwise"))
        axes = table(AXIS_HEADERS, [axis.cells() for axis in self.axes])
        return card(self.name, links, axes, pairs(rows), small=f"{len(self.axes)} axes, in command order").text

    def _axis(self, entry: _AxisEntry, source: pin.Model) -> Axis:
        joint = source.joints[source.getJointId(entry.joint)]
        turn = _error_frame(entry)
        motion = np.array(_direction(joint))
        lower, upper = (None, None) if entry.range == "unlimited" else entry.range
        return Axis(
            name=entry.name,
            joint=entry.joint,
            linear=entry.kind == "linear",
            lower=lower,
            upper=upper,
            increment=entry.increment,
            direction=_unit(turn.rotation.T @ motion),
            side=self._side(entry.name),
        )

    def _side(self, name: str) -> Literal["tool", "work", "both"]:
        joint = next(frame.joint for frame in self.frames if frame.axis == name)
        tool = joint in self.model.supports[self.model.frames[self.tool_frame].parentJoint].tolist()
        work = joint in self.model.supports[self.model.frames[self.work_frame].parentJoint].tolist()
        return "both" if tool and work else "tool" if tool else "work"


def find_bundled(name: str | Path, suffix: str, expected: str) -> Path:
    """A file by its path, or one that comes with `twin` by its bare name.

    Raises:
        InputError: neither; the message lists what comes with `twin`.
    """
    path = Path(name)
    if path.is_file():
        return path
    bundled = bundled_folder()
    for candidate in (bundled / path.name, bundled / f"{path.name}{suffix}"):
        if path.parent == Path(".") and candidate.is_file():
            return candidate
    known = sorted(file.name for file in bundled.glob(f"*{suffix}") if file.name.count(".") == suffix.count("."))
    meant = [*known, *(name.removesuffix(suffix) for name in known)]
    raise InputError(
        "not found",
        expected=f"{expected}, or one that comes with twin ({', '.join(known)})",
        file=path,
        nearest=nearest(path.name, meant),
    )


def bundled_folder() -> Path:
    """Where the machines that come with `twin` are: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).parent
    inside = package / "urdf"
    return inside if inside.is_dir() else package.parent / "urdf"


def _load_urdf(path: Path) -> pin.Model:
    text = read_text(path)
    try:
        ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError("not XML", expected="a URDF file", file=path, line=error.position[0], value=error) from error
    try:
        return pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        raise InputError(
            "not a URDF that Pinocchio can load", expected="a URDF robot", file=path, value=error
        ) from error


def _check(entries: _MachineFile, source: pin.Model, path: Path, lines: Mapping[Place, int]) -> None:
    joints = [name for name in source.names if name != "universe"]
    bodies = [frame.name for frame in source.frames if frame.type == pin.FrameType.BODY]
    seen: set[str] = set()
    for index, entry in enumerate(entries.axes):
        place: Place = ("axes", index)

        def fail(key: str, what: str, expected: str, value: object, place: Place = place) -> InputError:
            return InputError(what, expected=expected, file=path, line=line_of((*place, key), lines), value=value)

        if entry.name in seen:
            raise fail("name", "an axis given twice", "each axis once", entry.name)
        seen.add(entry.name)
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
                "origin of something that is no linear axis",
                expected="names of linear axes",
                file=path,
                line=line_of(("frames", "origin", name), lines),
                value=name,
            )


def _with_error_frames(
    source: pin.Model, entries: _MachineFile
) -> tuple[pin.Model, dict[str, int], tuple[ErrorFrame, ...]]:
    """A new model, walked from the old one: Pinocchio's cannot be edited in place."""
    by_joint = {entry.joint: entry for entry in entries.axes}
    model = pin.Model()
    model.name = source.name
    model.gravity = source.gravity
    end_of = {
        0: (0, pin.SE3.Identity())
    }  # old joint -> new joint that carries its body, and the body's placement there
    joint_of: dict[str, int] = {}
    free_flyers: dict[tuple[str, str], int] = {}
    for old in range(1, source.njoints):
        name = source.names[old]
        parent, shift = end_of[source.parents[old]]
        placement = shift * source.jointPlacements[old]
        if source.parents[old] == 0:
            placement = pin.SE3(np.eye(3), _start(old, source, entries)) * placement
        entry = by_joint.get(name)
        joint = source.joints[old]
        if entry is None:
            new = model.addJoint(parent, joint, placement, name)
            end_of[old] = (new, pin.SE3.Identity())
        elif entry.kind == "linear":
            turn = _error_frame(entry)
            new = model.addJoint(parent, joint, placement, name)
            end = model.addJoint(new, pin.JointModelFreeFlyer(), turn, f"{name}:error")
            free_flyers[entry.name, "motion"] = end
            end_of[old] = (end, turn.inverse())
        else:
            turn = _error_frame(entry)
            located = model.addJoint(parent, pin.JointModelFreeFlyer(), placement * turn, f"{name}:location")
            erring = model.addJoint(located, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"{name}:error")
            new = model.addJoint(erring, joint, turn.inverse(), name)
            free_flyers[entry.name, "location"] = located
            free_flyers[entry.name, "motion"] = erring
            end_of[old] = (new, pin.SE3.Identity())
        if entry is not None:
            joint_of[entry.name] = new
        model.appendBodyToJoint(end_of[old][0], source.inertias[old], end_of[old][1])
    for frame in source.frames:
        if frame.type != pin.FrameType.JOINT and frame.name != "universe":
            parent, shift = end_of[frame.parentJoint]
            model.addFrame(pin.Frame(frame.name, parent, 0, shift * frame.placement, frame.type), False)
    frames = tuple(
        ErrorFrame(entry.name, role, free_flyers[entry.name, role])
        for entry in entries.axes
        for role in (("location", "motion") if entry.kind == "rotary" else ("motion",))
        if (entry.name, role) in free_flyers
    )
    return model, joint_of, frames


def _start(first: int, source: pin.Model, entries: _MachineFile) -> np.ndarray:
    """Where a branch that starts at joint ``first`` begins, so that its linear axes count from ``frames.origin``."""
    data = source.createData()
    pin.forwardKinematics(source, data, pin.neutral(source))
    start = np.zeros(3)
    for entry in entries.axes:
        joint = source.getJointId(entry.joint)
        if entry.name in entries.frames.origin and first in source.supports[joint].tolist():
            start -= (
                entries.frames.origin[entry.name] * MM * (data.oMi[joint].rotation @ _direction(source.joints[joint]))
            )
    return start


def _direction(joint: pin.JointModel) -> np.ndarray:
    """Unit vector of a one-degree-of-freedom joint's motion in its own frame."""
    data = joint.createData()
    joint.calc(
        data,
        np.zeros(joint.nq) if joint.idx_q < 0 else np.zeros(joint.idx_q + joint.nq),
        np.zeros(joint.idx_v + joint.nv),
    )
    motion = np.asarray(data.S).reshape(6)
    return motion[:3] if np.any(motion[:3]) else motion[3:]


def _error_frame(entry: _AxisEntry) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(*(angle * DEG for angle in entry.error_frame_rpy_deg)), np.zeros(3))


def _unit(vector: np.ndarray) -> tuple[float, float, float]:
    unit = vector / np.linalg.norm(vector)
    clean = np.where(np.abs(unit - np.round(unit)) < 1e-12, np.round(unit), unit) + 0.0
    return float(clean[0]), float(clean[1]), float(clean[2])
