"""A machine: its URDF and machine file as one Pinocchio model with an error frame at every axis joint.

The kinematic chain (contract §1), for every axis at any place in it:

- a linear axis: motion, then error: ``T_a(q) · E_a``;
- a rotary axis: location, error in the fixed (not rotating) frame, then motion: ``L_a · E_a · R_a(q)``.

Each ``E`` and ``L`` is a free-flyer joint of the model, so that Pinocchio's own Jacobian columns are the sensitivities
to the six error motions. The code is the same for every machine: axes, ranges and frames come from the files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Literal, final

import numpy as np
import pinocchio as pin

from twin._common.arrays import read_only
from twin._common.bundled import DEFAULT, bundled_folder, find_bundled, is_file
from twin._common.errors import InputError
from twin._common.units import DEG, MM
from twin._common.yaml_files import EntryPath, line_of, load_yaml
from twin.display import Cell, chain, span, table
from twin.display.results import Display, DisplayedResult
from twin.machine.error_names import NamedAxis, Vector, component_names, location_names, squareness_names
from twin.machine.machine_file import (
    SCHEMA,
    UPRIGHT_FRAMES,
    AxisEntry,
    MachineFile,
    check_entries,
    error_frame,
    load_urdf,
    turns_in_machine_frame,
)

AXIS_HEADERS = ("axis", "kind", "range", "least increment", "carries", "joint in the URDF")


@final
@dataclass(frozen=True)
class Axis:
    """One axis of a machine."""

    name: str  # its name in programs and data (``X``, ``B``, ``J1``)
    joint: str  # its joint in the URDF
    linear: bool  # whether it translates (mm); a rotary axis turns (degrees)
    lower: float | None  # lower, upper: range in mm or degrees; None, None for an unlimited rotary axis
    upper: float | None
    increment: float  # least increment in mm or degrees
    direction: Vector  # unit vector of the motion, in the axis's error frame
    # unit vectors of the machine frame's x, y and z in the axis's error frame, all joints at zero
    machine_axes: tuple[Vector, Vector, Vector]
    # the side that it moves: ``tool`` or ``work``; ``both`` for a joint that carries both, without relative motion
    side: Literal["tool", "work", "both"]

    @property
    def unit(self) -> Literal["mm", "deg"]:
        """Unit of its position for the user."""
        return "mm" if self.linear else "deg"

    @property
    def domain(self) -> tuple[float, float]:
        """Range, mm or degrees; one turn if it is unlimited."""
        return (0.0, 360.0) if self.lower is None or self.upper is None else (self.lower, self.upper)

    @property
    def scale(self) -> float:
        """Metres per millimetre, or radians per degree."""
        return MM if self.linear else DEG

    @property
    def machine_direction(self) -> np.ndarray:
        """(3,) unit vector of the motion in the machine frame, all joints at zero."""
        return np.array(self.machine_axes) @ self.direction

    def cells(self) -> tuple[Cell, ...]:
        """Return its row for display, under `AXIS_HEADERS`."""
        reach = "unlimited" if self.lower is None else span(*self.domain, self.unit)
        least = f"{self.increment:g} mm" if self.linear else f"{self.increment:g}°"
        return self.name, "linear" if self.linear else "rotary", reach, least, self.side, self.joint


@final
@dataclass(frozen=True)
class ErrorFrame:
    """One six-component frame of a machine's chain."""

    axis: str  # the axis it belongs to
    # ``motion`` for the error motions E_XX … of an axis, ``location`` for E_X0C … of a rotary axis
    role: Literal["motion", "location"]
    joint: int  # index of its free-flyer joint in the Pinocchio model


@final
class Machine(DisplayedResult):
    """A machine as loaded from its files; immutable, so that it can be shared.

    Attributes:
        name: the machine's name.
        path: the machine file.
        urdf: the URDF file.
        axes: its axes in command order.
        axis_joints: joint index in the Pinocchio model of every axis, in command order.
        model: the Pinocchio model, metres and radians, with a free-flyer joint for every error frame.
        frames: the error frames in the order in which errors are passed as arrays.
        tool_frame, work_frame: indices of the tool and work frames in ``model.frames``.
        default_calibration: path of the calibration that is used if none is given, or None.
        tool_length_mm: tool length that is used if none is given.
        tcp_on, tcp_off: program words that switch tool centre point control on and off on this machine.
        harmless: program words and subprograms that leave positions, frames, offsets and modes alone on this machine.
        auxiliary_axes: axes that programs name and the model does not have (a quill, a pallet, a tailstock).
        references: axis positions after a reference return, mm and degrees, by its word (``G28``, ``G30 P3``, ``G74``) and axis.
        origin_mm: axis coordinates at which the URDF's linear joints are zero, by axis; 0 for those that are not named.
        upright: (3, 3) rotation from the base frame to right, back and up, as a person sees the machine who faces the column.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> machine.names, machine.rotary
        (('X', 'Y', 'Z', 'B', 'C'), (3, 4))
        >>> machine.by_name["B"].domain
        (0.0, 180.0)
    """

    def __init__(self, path: Path) -> None:
        entries, lines = load_yaml(path, MachineFile, SCHEMA)
        self.name = entries.name
        self.path = path
        self.urdf = _relative_to(path, entries.urdf)
        self.tool_length_mm = entries.programs.tool_length
        self._plausible = entries.plausible
        self.tcp_on = tuple(word.upper() for word in entries.programs.tcp_on)
        self.tcp_off = tuple(word.upper() for word in entries.programs.tcp_off)
        self.harmless = tuple(word.upper() for word in entries.programs.harmless)
        self.auxiliary_axes = tuple(name.upper() for name in entries.programs.auxiliary_axes)
        self.references = entries.programs.references
        self.default_calibration = None if entries.calibration is None else _relative_to(path, entries.calibration)
        if not is_file(self.urdf):
            raise InputError(
                "no such URDF",
                expected="a path relative to the machine file",
                file=path,
                line=lines[("urdf",)],
                value=entries.urdf,
            )
        source = load_urdf(self.urdf)
        check_entries(entries, source, path, lines)
        self.model, joint_of, self.frames = _with_error_frames(source, entries)
        # A fixed joint may have the name of a link.
        self.tool_frame = int(self.model.getFrameId(entries.frames.tool, pin.FrameType.BODY))
        self.work_frame = int(self.model.getFrameId(entries.frames.work, pin.FrameType.BODY))
        self.origin_mm: Mapping[str, float] = MappingProxyType(dict(entries.frames.origin))
        self.upright = read_only(UPRIGHT_FRAMES[entries.frames.up].copy())
        self._error_frames = {entry.name: error_frame(entry) for entry in entries.axes}
        self.axis_joints = tuple(joint_of[entry.name] for entry in entries.axes)
        turns = turns_in_machine_frame(entries, source, path, lines)
        self.axes = tuple(self._axis(entry, source, turns[entry.name]) for entry in entries.axes)
        self._check_paths(path, lines)
        self.by_name: Mapping[str, Axis] = MappingProxyType({axis.name: axis for axis in self.axes})

    @classmethod
    def load(cls, machine: str | Path) -> Machine:
        """Load a machine file by its path, or one that comes with `twin` by its name (``dmu50``).

        Raises:
            InputError: there is no such file, or it is invalid; the error names the line.
        """
        return cls(find_bundled(machine, ".yaml", "a machine file"))

    def error_frame(self, axis: str) -> pin.SE3:
        """Return the placement of an axis's error frame in its joint's frame."""
        return pin.SE3(self._error_frames[axis])

    @property
    def names(self) -> tuple[str, ...]:
        """Axis names in command order."""
        return tuple(axis.name for axis in self.axes)

    @cached_property
    def scale(self) -> np.ndarray:
        """Metres per millimetre or radians per degree (axes,), in command order."""
        return read_only(np.array([axis.scale for axis in self.axes]))

    @cached_property
    def limits(self) -> np.ndarray:
        """Lower and upper limits (axes, 2) in metres and radians; infinite for an unlimited axis."""
        rows = [
            (-np.inf, np.inf)
            if axis.lower is None or axis.upper is None
            else (axis.lower * axis.scale, axis.upper * axis.scale)
            for axis in self.axes
        ]
        return read_only(np.array(rows))

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
        """Whether it can run NC programs: three linear axes and at most two rotary ones."""
        return len(self.linear) == 3 and len(self.rotary) <= 2

    def check_programs(self) -> None:
        """Raise `InputError` unless it can run NC programs."""
        if not self.runs_programs:
            raise InputError(
                f"{self.name} has {len(self.linear)} linear and {len(self.rotary)} rotary axes",
                expected="three linear axes and at most two rotary ones, to run programs",
                file=self.path,
            )

    def check_tool_along_z(self) -> None:
        """Raise `InputError` unless the tool is along Z with all axes at zero: controls count its length along Z."""
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, self.configuration(np.zeros(len(self.axes))))
        along = data.oMf[self.tool_frame].rotation[:, 2]
        for axis, joint in zip(self.axes, self.axis_joints, strict=True):
            pose = data.oMi[joint].rotation @ self.error_frame(axis.name).rotation
            if axis.linear and axis.name[0] == "Z" and abs(float(along @ pose @ axis.direction)) < 1.0 - 1e-9:
                what = f"{self.name}: the tool is not along Z (a right-angle head)"
                raise InputError(what, expected="a machine whose tool is along Z with all axes at 0", file=self.path)

    @property
    def as_option(self) -> str:
        """Command-line option that selects this machine: `` --machine mine.yaml``; empty for the default machine."""
        file = self.path.resolve()
        bundled = file.parent == bundled_folder().resolve()
        return "" if bundled and file.stem == DEFAULT else f" --machine {file.stem if bundled else file.name}"

    def error_names(self, frame: ErrorFrame) -> tuple[str, ...]:
        """Return the ISO 230-1 names of a frame's six components: ``E_XX`` … ``E_CX``, or ``E_X0C`` … ``E_C0C``."""
        return component_names(frame.axis, average=frame.role == "location")

    def plausible(self, name: str) -> float:
        """Return the prior standard deviation of an error, µm or µrad.

        Args:
            name: ISO 230-1 name.
        """
        kind = self._plausible.location if name[3] == "0" else self._plausible.motion
        return kind.um if name[2] in "XYZ" else kind.urad

    @cached_property
    def motion_names(self) -> tuple[str, ...]:
        """Names of all error motions (curves), six per axis."""
        return tuple(name for frame in self.frames if frame.role == "motion" for name in self.error_names(frame))

    @cached_property
    def location_names(self) -> tuple[str, ...]:
        """Names of the rotary axes' locations (`twin.machine.error_names.location_names`)."""
        return location_names(self._named_axes)

    @cached_property
    def squareness_names(self) -> tuple[str, ...]:
        """Names of the squareness errors (`twin.machine.error_names.squareness_names`)."""
        return squareness_names(self._named_axes)

    @property
    def _named_axes(self) -> list[NamedAxis]:
        named_axes = []
        for axis in self.axes:
            x, y, z = axis.machine_direction.tolist()
            named_axes.append(NamedAxis(axis.name, axis.linear, axis.direction, (x, y, z)))
        return named_axes

    def configuration(self, q: np.ndarray, errors: np.ndarray | None = None) -> np.ndarray:
        """Return the Pinocchio configuration of one pose.

        Args:
            q: (axes,) positions in metres and radians, command order.
            errors: (frames, 6) translations and rotation vectors in metres and radians, order ``frames``; None for zero.

        Returns:
            Configuration (model.nq,).
        """
        configuration = pin.neutral(self.model)
        for joint, value in zip(self.axis_joints, q, strict=True):
            configuration[self.model.joints[joint].idx_q] = value
        if errors is not None:
            for frame, error in zip(self.frames, errors, strict=True):
                start = self.model.joints[frame.joint].idx_q
                configuration[start : start + 3] = error[:3]
                configuration[start + 3 : start + 7] = pin.Quaternion(pin.exp3(error[3:])).coeffs()
        return configuration

    @property
    def brief(self) -> str:
        """Name, axes and tool length."""
        return f"{self.name}: axes {' '.join(self.names)}, tool length {self.tool_length_mm:g} mm"

    def display(self) -> Display:
        """Return kinematic chain, axes and files."""
        ordered = [axis for _, axis in sorted(zip(self.axis_joints, self.axes, strict=True), key=lambda pair: pair[0])]
        tool = [(axis.name, "axis") for axis in ordered if axis.side == "tool"]
        work = [(axis.name, "axis") for axis in reversed(ordered) if axis.side == "work"]
        links = chain([("workpiece", "end"), *work, ("base", "fixed"), *tool, ("tool", "end")])
        numbers = (
            f"{len(self.motion_names)} error motions, squareness {' '.join(self.squareness_names) or 'none'}, "
            f"axis locations {' '.join(self.location_names) or 'none'}"
        )
        rows = [("machine file", str(self.path)), ("URDF", str(self.urdf)), ("error parameters", numbers)]
        rows.append(("tool length", f"{self.tool_length_mm:g} mm, unless another is given"))
        axes = table(AXIS_HEADERS, [axis.cells() for axis in self.axes])
        return Display(self.name, rows, above=(links, axes), small=f"{len(self.axes)} axes, in command order")

    def _axis(self, entry: AxisEntry, source: pin.Model, orientation: np.ndarray) -> Axis:
        joint = source.joints[source.getJointId(entry.joint)]
        turn = error_frame(entry)
        motion = np.array(_direction(joint))
        lower, upper = (None, None) if entry.range == "unlimited" else entry.range
        x, y, z = (_unit(row) for row in orientation)
        tool, work = (self._carries(entry.name, frame) for frame in (self.tool_frame, self.work_frame))
        return Axis(
            name=entry.name,
            joint=entry.joint,
            linear=entry.kind == "linear",
            lower=lower,
            upper=upper,
            increment=entry.increment,
            direction=_unit(turn.rotation.T @ motion),
            machine_axes=(x, y, z),
            side="both" if tool and work else "tool" if tool else "work",
        )

    def _carries(self, name: str, frame: int) -> bool:
        joint = next(candidate.joint for candidate in self.frames if candidate.axis == name)
        return joint in self.model.supports[self.model.frames[frame].parentJoint].tolist()

    def _check_paths(self, path: Path, lines: Mapping[EntryPath, int]) -> None:
        for index, axis in enumerate(self.axes):
            if not any(self._carries(axis.name, frame) for frame in (self.tool_frame, self.work_frame)):
                raise InputError(
                    f"axis {axis.name} carries neither the tool nor the work",
                    expected=f"a joint between the base and {self._link(self.tool_frame)} or {self._link(self.work_frame)}, "
                    "or no such axis",
                    file=path,
                    line=line_of(("axes", index, "joint"), lines),
                    value=axis.joint,
                )

    def _link(self, frame: int) -> str:
        return str(self.model.frames[frame].name)


def _relative_to(path: Path, name: str) -> Path:
    """Return the path of a file named in another file, relative to that file; unchanged if it cannot be resolved."""
    try:
        return (path.parent / name).resolve()
    except (OSError, RuntimeError, ValueError):
        return path.parent / name


def _with_error_frames(
    source: pin.Model, entries: MachineFile
) -> tuple[pin.Model, dict[str, int], tuple[ErrorFrame, ...]]:
    """Return a copy of the model with error frames inserted: a Pinocchio model cannot be edited in place."""
    by_joint = {entry.joint: entry for entry in entries.axes}
    model = pin.Model()
    model.name = source.name
    up = UPRIGHT_FRAMES[entries.frames.up][2]
    model.gravity = pin.Motion(0.0 - np.linalg.norm(source.gravity.linear) * up, np.zeros(3))
    # old joint -> new joint that carries its body, and the body's placement on it
    end_of = {0: (0, pin.SE3.Identity())}
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
            turn = error_frame(entry)
            new = model.addJoint(parent, joint, placement, name)
            end = model.addJoint(new, pin.JointModelFreeFlyer(), turn, f"{name}:error")
            free_flyers[entry.name, "motion"] = end
            end_of[old] = (end, turn.inverse())
        else:
            turn = error_frame(entry)
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


def bundled_machines() -> tuple[Machine, ...]:
    """Return the machines that come with twin, by name."""
    files = sorted(file for file in bundled_folder().glob("*.yaml") if "." not in file.stem)
    return tuple(Machine.load(file) for file in files)


def _start(first: int, source: pin.Model, entries: MachineFile) -> np.ndarray:
    """Return the start (3,) in metres of the branch from joint ``first``, so that its linear axes count from ``frames.origin``."""
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
    """Return the unit vector of a one-degree-of-freedom joint's motion in its own frame."""
    data = joint.createData()
    joint.calc(
        data,
        np.zeros(joint.nq) if joint.idx_q < 0 else np.zeros(joint.idx_q + joint.nq),
        np.zeros(joint.idx_v + joint.nv),
    )
    motion = np.asarray(data.S).reshape(6)
    return motion[:3] if np.any(motion[:3]) else motion[3:]


def _unit(vector: np.ndarray) -> Vector:
    unit = vector / np.linalg.norm(vector)
    clean = np.where(np.abs(unit - np.round(unit)) < 1e-12, np.round(unit), unit) + 0.0
    return float(clean[0]), float(clean[1]), float(clean[2])
