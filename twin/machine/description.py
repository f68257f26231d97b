"""A machine from a description in words and numbers: a URDF with plain solids, and a machine file (`twin machine new`).

All lengths of a description are mm, in the directions of the machine's X, Y and Z, with every rotary axis at zero. A positive command
moves the tool along X, Y, Z or right-handed about A, B, C, as seen from the workpiece (ISO 841), unless `positive` says ``reversed``.
The base frame is the centre of the table's surface; there the spindle nose is with the linear joints of the URDF at zero.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, final

import numpy as np
import pinocchio as pin
from pydantic import BaseModel, ConfigDict, Field

from twin._common.errors import InputError
from twin._common.files import scratch_folder
from twin._common.units import DEG, MM
from twin._common.yaml_files import EntryPath, line_of, load_yaml, quoted, yaml_text
from twin.machine.machine import Machine
from twin.machine.machine_file import LONGEST_TOOL_MM, MAX_POSITION
from twin.machine.solids import COLOURS, Solids, from_z, rpy_of

SCHEMA: Final = "twin.answers/1"
LETTERS: Final = {letter: np.eye(3)[i % 3] for i, letter in enumerate("XYZABC")}
"""Direction of an axis by the first letter of its name (ISO 841)."""
NAME: Final = r"^[XYZABC][0-9]?$"
PLACES: Final = "nose, table, machine or another rotary axis, and x y z in mm, such as `nose 0 0 180`"
DIRECTIONS: Final = (
    "a letter (Y, -Y), three numbers (0 1 1), or two letters and the angle from the first to the second (Y Z 45)"
)
PARALLEL: Final = 0.9998
"""Cosine of the angle, 1°, below which two axes count as parallel."""
ALIGNED: Final = 0.985
"""Cosine of the angle, 10°, up to which a rotary axis has the error frame of the axis of the machine that it is close to."""
AGREED_MM: Final = 1e-7
"""Largest distance between an axis of the written file and the description; rounding is 1e-10 mm."""

LONGEST_MM: Final = 1e5
"""Largest distance, and longest travel."""

_Position = Annotated[float, Field(ge=-MAX_POSITION, le=MAX_POSITION)]


@final
class AxisAnswer(BaseModel):
    """Answers on one axis: range, least increment, and for a rotary axis direction and place."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    range: tuple[_Position, _Position] | Literal["unlimited"]
    increment: Annotated[float, Field(gt=0, le=1.0)] = 0.001
    positive: Literal["iso", "reversed"] = "iso"
    about: str | None = None
    at: str | None = None


@final
class Answers(BaseModel):
    """Answers that describe a machine: the axes of both sides from the bed outwards, and each axis."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    schema_: Literal["twin.answers/1"] = Field(alias="schema", default=SCHEMA)
    name: Annotated[str, Field(min_length=1, max_length=80)]
    tool: tuple[Annotated[str, Field(pattern=NAME)], ...] = ()
    work: tuple[Annotated[str, Field(pattern=NAME)], ...] = ()
    spindle: Literal["vertical", "horizontal"] = "vertical"
    tool_axis: str = "Z"
    table: Mapping[str, _Position] = {}
    table_size: Annotated[float, Field(gt=10, le=20_000)] | None = None
    tool_length: Annotated[float, Field(ge=0, le=LONGEST_TOOL_MM)] = 0.0
    tcp_on: tuple[str, ...] = ()
    tcp_off: tuple[str, ...] = ()
    axes: Mapping[str, AxisAnswer]

    @property
    def names(self) -> tuple[str, ...]:
        """Axes in command order: linear ones, then rotary ones, by name."""
        return tuple(sorted((*self.tool, *self.work), key=lambda name: (not is_linear(name), name)))


def is_linear(name: str) -> bool:
    """Return whether an axis of that name is linear."""
    return name[0] in "XYZ"


def is_near(direction: np.ndarray | None, name: str) -> bool:
    """Return whether a direction suits the letter of a rotary axis: not almost perpendicular to the axis of the machine."""
    return direction is not None and abs(float(direction @ LETTERS[name[0]])) >= 0.1


def check_chain(tool: Sequence[str], work: Sequence[str]) -> None:
    """Raise `InputError` unless two chains of axes, from the bed outwards, are those of a machine."""
    axes: dict[str, dict[str, Any]] = {name: {"range": [-1, 1]} for name in (*tool, *work)}
    for side, place in ((tool, "nose 0 0 0"), (work, "table 0 0 0")):
        axes |= {name: {"range": [-1, 1], "at": place} for name in side if not is_linear(name)}
    table = {name: 0 for name in axes if is_linear(name)}
    Description.of({"name": "any", "tool": list(tool), "work": list(work), "table": table, "axes": axes})


def vector_of(text: str) -> np.ndarray | None:
    """Return three numbers separated by blanks or commas; None if the text is something else."""
    words = text.replace(",", " ").split()
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        return None
    return values if len(values) == 3 and bool(np.all(np.abs(values) <= LONGEST_MM)) else None


def direction_of(text: str) -> np.ndarray | None:
    """Return the unit vector (3,) of a direction as in `DIRECTIONS`; None if the text is none."""
    match = re.fullmatch(r"\s*(-?)([XYZ])\s*(?:(-?)([XYZ])\s+(-?[\d.]+)\s*)?", text)
    if match is None:
        found = vector_of(text)
        size = 0.0 if found is None else float(np.linalg.norm(found))
        return None if found is None or size < 1e-6 else found / size
    first = LETTERS[match[2]] * (-1.0 if match[1] else 1.0)
    if match[4] is None:
        return first
    try:
        angle = float(match[5]) * DEG
    except ValueError:
        return None
    second = LETTERS[match[4]] * (-1.0 if match[3] else 1.0)
    return None if match[2] == match[4] else first * math.cos(angle) + second * math.sin(angle)


def place_of(text: str) -> tuple[str, np.ndarray] | None:
    """Return reference and vector (3,) in mm of a place as in `PLACES`; None if the text is none."""
    reference, _, numbers = text.strip().partition(" ")
    vector = vector_of(numbers)
    known = reference in ("nose", "table", "machine") or re.fullmatch("[ABC][0-9]?", reference)
    return (reference, vector) if known and vector is not None else None


@final
@dataclass(frozen=True)
class Part:
    """One axis of a described machine with every axis at its rest: linear ones at the centre of the table, rotary ones at zero.

    Attributes:
        name: its letter.
        side: the side that it moves.
        motion: (3,) unit vector along or about which its link moves with a positive command.
        point: (3,) a point of the axis in the base frame, mm.
    """

    name: str
    side: Literal["tool", "work"]
    motion: np.ndarray
    point: np.ndarray

    @property
    def frame_z(self) -> np.ndarray:
        """(3,) z of the joint's frame: the axis itself, along the axis of the machine that it is close to, else upwards."""
        near = int(np.argmax(np.abs(self.motion)))
        along = near if abs(self.motion[near]) >= ALIGNED else 2 if abs(self.motion[2]) > 1e-9 else 1
        return self.motion * float(np.sign(self.motion[along]))

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) orientation of the joint's frame: for a rotary axis the shortest rotation of z to it."""
        if is_linear(self.name):
            return np.eye(3)
        return from_z(self.frame_z)

    @property
    def error_frame_deg(self) -> tuple[float, float, float]:
        """Entry `error_frame_rpy_deg`: the errors of an axis about X or Y have the directions of the machine."""
        near = int(np.argmax(np.abs(self.motion)))
        turned = not is_linear(self.name) and near < 2 and abs(self.motion[near]) >= ALIGNED
        return ((0.0, -90.0, 0.0), (90.0, 0.0, 0.0))[near] if turned else (0.0, 0.0, 0.0)


@final
class Description:
    """Answers that were checked, with the place of every axis.

    Args:
        answers: the answers.
        fail: makes the error of an answer: (its path, what, expected, value).

    Attributes:
        answers: as given.
        tool_axis: (3,) unit vector from the tool tip to the spindle with the rotary axes at zero.
        up: axis of the machine that points upwards.
        parts: the axes from the bed outwards, tool side first.

    Raises:
        InputError: answers that contradict each other, or a chain that is no machine; it names the answer.
    """

    def __init__(self, answers: Answers, fail: Callable[[EntryPath, str, str, object], InputError]) -> None:
        self.answers = answers
        self._fail = fail
        direction = direction_of(answers.tool_axis)
        if direction is None:
            raise fail(("tool_axis",), "`tool_axis`: not a direction", DIRECTIONS, answers.tool_axis)
        self.tool_axis: np.ndarray = direction
        self.up: Literal["Y", "Z"] = "Y" if answers.spindle == "horizontal" else "Z"
        self._check_chain()
        for name in answers.names:
            self._check_axis(name, answers.axes[name])
        self._check_directions()
        chains: tuple[tuple[Literal["tool", "work"], tuple[str, ...]], ...] = (
            ("tool", answers.tool),
            ("work", answers.work),
        )
        self.parts = tuple(self._part(name, side) for side, names in chains for name in names)

    @classmethod
    def load(cls, path: Path) -> Description:
        """Return the description in a YAML file of answers.

        Raises:
            InputError: it is not such a file, or see the class; with the line.
        """
        answers, lines = load_yaml(path, Answers, SCHEMA)

        def fail(place: EntryPath, what: str, expected: str, value: object) -> InputError:
            return InputError(what, expected=expected, file=path, line=line_of(place, lines), value=value)

        return cls(answers, fail)

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Description:
        """Return the description of plain data, as in a file of answers.

        Raises:
            InputError: as `load`, without file and line.
        """
        with scratch_folder() as folder:
            path = folder / "answers.yaml"
            path.write_text(yaml_text({"schema": SCHEMA, **data}), encoding="utf-8")
            try:
                answers, _ = load_yaml(path, Answers, SCHEMA)
            except InputError as error:
                raise InputError(
                    error.what, expected=error.expected, value=error.value, nearest=error.nearest
                ) from None
        return cls(answers, lambda place, what, expected, value: InputError(what, expected=expected, value=value))

    def signed_direction(self, name: str) -> np.ndarray:
        """Return the unit vector (3,) along or about which the tool moves relative to the workpiece with a positive command."""
        one = self.answers.axes[name]
        direction = LETTERS[name[0]] if one.about is None else direction_of(one.about)
        return np.asarray(direction) * (-1.0 if one.positive == "reversed" else 1.0)

    def _check_chain(self) -> None:
        """Raise `InputError` unless every axis is once in one of the chains, linear axes first, and has its answers."""
        answers, fail = self.answers, self._fail
        chain = (*answers.tool, *answers.work)
        for side in ("tool", "work"):
            names = getattr(answers, side)
            for i, name in enumerate(names):
                if chain.count(name) > 1:
                    raise fail((side, i), f"axis {name} twice in `tool` and `work`", "every axis once", name)
                if name not in answers.axes:
                    raise fail(
                        (side, i), f"axis {name} has no entry in `axes`", f"axes: {{{name}: {{range: …}}}}", name
                    )
                before = [other for other in names[:i] if not is_linear(other)]
                if is_linear(name) and before:
                    what = f"`{side}`: the linear axis {name} is carried by the rotary axis {before[-1]}"
                    raise fail(
                        (side, i), what, "linear axes before rotary ones, from the bed outwards", " ".join(names)
                    )
        for name in answers.axes:
            if name not in chain:
                what = f"axis {name} is neither in `tool` nor in `work`"
                raise fail(("axes", name), what, "the side that it moves", name)
        self._check_count(chain)

    def _check_count(self, chain: tuple[str, ...]) -> None:
        """Raise `InputError` unless linear axes differ in direction, are those of `table`, and there are at most two rotary axes."""
        answers, fail = self.answers, self._fail
        linear = [name for name in chain if is_linear(name)]
        if not linear or len({name[0] for name in linear}) < len(linear):
            what = "two linear axes in the same direction" if linear else "no linear axis"
            raise fail(("tool",), what, "one to three of X, Y, Z in `tool` and `work`", " ".join(chain) or None)
        if len(chain) - len(linear) > 2:
            expected = "at most two of A, B, C in `tool` and `work`"
            raise fail(("tool",), "more than two rotary axes", expected, " ".join(chain))
        if set(linear) != set(answers.table):
            name = min(set(linear) ^ set(answers.table))
            raise fail(
                ("table", name),
                f"`table` {'lacks' if name in linear else 'has'} {name}",
                f"the positions of {' '.join(linear)} with the spindle nose at the centre of the table's surface",
                dict(answers.table),
            )

    def _check_axis(self, name: str, one: AxisAnswer) -> None:
        """Raise `InputError` unless the answers on one axis fit each other."""

        def fail(key: str, what: str, expected: str, value: object) -> InputError:
            return self._fail(("axes", name, key), f"`axes.{name}.{key}`: {what}", expected, value)

        if one.range == "unlimited":
            if is_linear(name):
                raise fail("range", "a linear axis without limits", "[lower, upper] in mm", one.range)
        elif not one.range[0] < one.range[1]:
            raise fail("range", "a reversed or empty range", "[lower, upper] with lower < upper", list(one.range))
        elif is_linear(name) and one.range[1] - one.range[0] > LONGEST_MM:
            raise fail("range", "a travel of more than 100 m", "mm", list(one.range))
        elif not is_linear(name) and not one.range[0] <= 0.0 <= one.range[1]:
            what = "zero is outside it, and all distances are those at zero"
            raise fail("range", what, "a range with zero", list(one.range))
        if not is_linear(name):
            self._check_rotary(name, one, fail)
        elif one.about is not None or one.at is not None:
            raise fail("at" if one.about is None else "about", "a linear axis", "no such answer", one.at or one.about)

    def _check_rotary(self, name: str, one: AxisAnswer, fail: Callable[[str, str, str, object], InputError]) -> None:
        """Raise `InputError` unless a rotary axis has a direction that suits its letter, and a place that suits its side."""
        direction = LETTERS[name[0]] if one.about is None else direction_of(one.about)
        if direction is None:
            raise fail("about", "not a direction", DIRECTIONS, one.about)
        line = "XYZ"["ABC".index(name[0])]
        if not is_near(direction, name):
            raise fail(
                "about", f"{name} is an axis about {line} or inclined to it", f"a direction closer to {line}", one.about
            )
        place = None if one.at is None else place_of(one.at)
        if place is None:
            raise fail("at", "the place of the axis is missing" if one.at is None else "not a place", PLACES, one.at)
        tool = name in self.answers.tool
        allowed = ("nose",) if tool else ("table", "machine")
        own = self.answers.tool if tool else self.answers.work
        if place[0] not in (*allowed, *(other for other in own if other != name and not is_linear(other))):
            expected = f"{' or '.join(allowed)}, or another rotary axis of `{'tool' if tool else 'work'}`"
            what = f"{name} moves the {'tool' if tool else 'workpiece'}, and its place is given from {place[0]}"
            raise fail("at", what, expected, one.at)

    def _check_directions(self) -> None:
        rotary = [name for name in self.answers.names if not is_linear(name)]
        if (
            len(rotary) == 2
            and abs(float(self.signed_direction(rotary[0]) @ self.signed_direction(rotary[1]))) > PARALLEL
        ):
            one = self.answers.axes[rotary[1]]
            raise self._fail(
                ("axes", rotary[1], "about"),
                f"the rotary axes {' and '.join(rotary)} are parallel",
                "two directions (`about`) that differ",
                one.about or rotary[1],
            )

    def _part(self, name: str, side: Literal["tool", "work"]) -> Part:
        motion = self.signed_direction(name) * (1.0 if side == "tool" else -1.0)
        return Part(name, side, motion, self._point(name, ()))

    def _point(self, name: str, following: tuple[str, ...]) -> np.ndarray:
        """Return the place of an axis in the base frame, mm."""
        at = self.answers.axes[name].at
        found = None if at is None else place_of(at)
        if found is None:
            return np.zeros(3)
        reference, vector = found
        if reference in following:
            raise self._fail(
                ("axes", name, "at"), f"`axes.{name}.at`: {name} and {reference} refer to each other", PLACES, at
            )
        if reference == "machine":
            return vector - [self.answers.table.get(letter, 0.0) for letter in "XYZ"]
        return vector if reference in ("nose", "table") else vector + self._point(reference, (*following, name))

    # --- Files ---------------------------------------------------------------------------------------

    def urdf(self) -> str:
        """Return the text of the URDF."""
        answers = self.answers
        links = [Placed("base", "", None, np.eye(3), np.zeros(3), np.zeros(3))]
        for side in ("tool", "work"):
            parent, own = "base", [one for one in self.parts if one.side == side]
            for i, part in enumerate(own):
                # `frames.origin` shifts the start of a branch: its links are where the later axes have their origins.
                later = [one.motion * answers.table[one.name] for one in own[i + 1 :] if is_linear(one.name)]
                shift = -MM * np.sum([np.zeros(3), *later], axis=0)
                links.append(Placed(link_name(part.name), parent, part, part.rotation, part.point * MM, shift))
                parent = links[-1].name
            end, turn = ("spindle_nose", from_z(self.tool_axis)) if side == "tool" else ("table", np.eye(3))
            links.append(Placed(end, parent, None, turn, np.zeros(3), np.zeros(3)))
        solids = Solids(self)
        by_name = {one.name: one for one in links}
        comment = (
            f"{answers.name}, made by `twin machine new` from answers. Metres and radians; the base frame is the centre of the table's "
            f"surface, {self.up} is up. Shapes are plain and not measured. MASSES ARE ESTIMATES from the shapes, not the machine's."
        )
        lines = ['<?xml version="1.0"?>', f"<!-- {re.sub('--+|[<>&]', ' ', comment)} -->", '<robot name="described">']
        lines += [f'  <material name="{name}"><color rgba="{rgba} 1"/></material>' for name, rgba in COLOURS.items()]
        for one in links:
            if one.parent:
                lines += _joint_lines(one, by_name[one.parent])
            lines += [f'  <link name="{one.name}">', *solids.lines(one), "  </link>"]
        return "\n".join([*lines, "</robot>"]) + "\n"

    def machine_file(self, urdf: str, answers_file: str) -> str:
        """Return the text of the machine file.

        Args:
            urdf: name of the URDF file.
            answers_file: name of the file of answers, for the comment.
        """
        answers = self.answers
        lines = [
            f"# This file was made by `twin machine new`; change the answers in {answers_file} and make it again.",
            "schema: twin.machine/1",
            f"name: {quoted(answers.name)}",
            f"urdf: {quoted(urdf)}",
            "",
            "axes:",
        ]
        parts = {part.name: part for part in self.parts}
        for name in answers.names:
            one, turn = answers.axes[name], parts[name].error_frame_deg
            reach = "unlimited" if one.range == "unlimited" else f"[{one.range[0]:.12g}, {one.range[1]:.12g}]"
            kind = "linear" if is_linear(name) else "rotary"
            frame = f", error_frame_rpy_deg: [{', '.join(f'{angle:g}' for angle in turn)}]" if any(turn) else ""
            entry = f"name: {name}, joint: {name.lower()}_joint, kind: {kind}, range: {reach}, increment: {one.increment:.12g}{frame}"
            lines.append(f"  - {{{entry}}}")
        origin = ", ".join(f"{name}: {value!r}" for name, value in answers.table.items())
        lines += [
            "",
            "frames:",
            "  tool: spindle_nose",
            "  work: table     # centre of the table's surface with all rotary axes at zero",
            *(["  up: Y           # the spindle is horizontal"] if self.up == "Y" else []),
        ]
        lines += ["  # Axis coordinates with the spindle nose there.", f"  origin: {{{origin}}}", "", "programs:"]
        lines.append(f"  tool_length: {answers.tool_length!r}")
        lines += [
            f"  {key}: [{', '.join(map(quoted, getattr(answers, key)))}]"
            for key in ("tcp_on", "tcp_off")
            if getattr(answers, key)
        ]
        return "\n".join(lines) + "\n"

    def check(self, machine: Machine) -> None:
        """Raise `InputError` unless a loaded machine has the axes of this description, in their places.

        Raises:
            InputError: it has not: a defect.
        """
        lines, _ = axis_lines(machine)
        for part in self.parts:
            side, motion, point = lines[part.name]
            away = np.zeros(3) if is_linear(part.name) else np.cross(point - part.point, part.motion)
            off = max(1e3 * float(np.linalg.norm(motion - part.motion)), float(np.linalg.norm(away)))
            if side != part.side or off > AGREED_MM:
                expected = f"within {AGREED_MM:g} mm"
                raise InputError(
                    f"the written axis {part.name} is not as described", expected=expected, value=f"{off:g} mm"
                )


def link_name(axis: str) -> str:
    """Return the name of the link that an axis moves."""
    return f"{axis.lower()}_link"


def axis_lines(
    machine: Machine, *, zero: bool = False
) -> tuple[dict[str, tuple[str, np.ndarray, np.ndarray]], np.ndarray]:
    """Return side, motion of the link (3,) and a point (3,) in mm of every axis in the base frame, and the spindle nose (3,) in mm.

    The rotary axes are at zero, the linear ones at `Machine.origin_mm`, or at zero if ``zero`` is set.
    """
    rest = np.array([0.0 if zero else machine.origin_mm.get(one, 0.0) for one in machine.names]) * machine.scale
    data = machine.model.createData()
    pin.framesForwardKinematics(machine.model, data, machine.configuration(rest))
    found: dict[str, tuple[str, np.ndarray, np.ndarray]] = {}
    for axis, joint in zip(machine.axes, machine.axis_joints, strict=True):
        pose = data.oMi[joint]
        motion = pose.rotation @ machine.error_frame(axis.name).rotation @ np.array(axis.direction)
        found[axis.name] = axis.side, motion, pose.translation / MM
    return found, data.oMf[machine.tool_frame].translation / MM


@final
@dataclass(frozen=True)
class Placed:
    """A link at rest.

    Attributes:
        name: its name.
        parent: name of the link that carries it; empty for the base.
        part: the axis that moves it; None for a fixed link.
        rotation, origin: pose of its frame in the base frame as the URDF has it, m.
        shift: (3,) of that frame where the machine is loaded, m.
    """

    name: str
    parent: str
    part: Part | None
    rotation: np.ndarray
    origin: np.ndarray
    shift: np.ndarray


def _numbers(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{float(value) + 0.0:.17g}" for value in values)


def _joint_lines(one: Placed, parent: Placed) -> list[str]:
    """Return the lines of the joint that carries a link."""
    place = parent.rotation.T @ (one.origin - parent.origin)
    origin = f'<origin xyz="{_numbers(place)}" rpy="{_numbers(rpy_of(parent.rotation.T @ one.rotation))}"/>'
    ends = f'<parent link="{one.parent}"/><child link="{one.name}"/>'
    if one.part is None:
        return [f'  <joint name="{one.name}_joint" type="fixed">{ends}{origin}</joint>']
    kind, motion = ("prismatic" if is_linear(one.part.name) else "revolute"), one.rotation.T @ one.part.motion
    exact = np.where(np.abs(motion - np.round(motion)) < 1e-12, np.round(motion), motion)
    limit = '<limit lower="-10000" upper="10000" effort="0" velocity="1"/>'
    return [
        f'  <joint name="{one.part.name.lower()}_joint" type="{kind}">{ends}{origin}<axis xyz="{_numbers(exact)}"/>{limit}</joint>'
    ]
