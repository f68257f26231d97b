"""A machine's rotary axes as its control describes them: parameters of the five-axis transformation, read without a machine file.

Checked against public descriptions:

- SINUMERIK `$MC_TRAFO5_…` (MD24500 ff.), Commissioning Manual SINUMERIK Operate (IM9), 12/2017, p. 572 and 581, and 03/2013, p. 502:
  type 24 head, 40 table, 56 head and table; of a head BASE_TOOL leads from the tool adapter to the second axis and JOINT_OFFSET from
  there to the first, of a table BASE_TOOL from the machine's reference point to the first and JOINT_OFFSET (24558) to the second.
  Types 16 to 21 (head), 32 to 35 (table) and 48 to 51 name their axes, and type 72 takes the vectors of a tool carrier; a tool carrier
  `$TC_CARR…` corresponds to the machine data on p. 572, its fine offsets and axes are on p. 352 and 779. Types and kinematic chain
  `$NK_…`: Function Manual Transformations, 06/2019, p. 148.
- Fanuc 30i, A-79348E, p. 72 to 86: 19680 = 2, 12, 21; of a head 19709 to 19711 lead from the tool axis to the second axis, 19712 to
  19714 from there to the first; 19666 is the tool holder offset.
- HEIDENHAIN iTNC 530, Technical Manual HSCI, p. 722: rows NR, KEY, AXIS, COORD from the tool to the workpiece.
- LinuxCNC: the compiled modules of version 2.9 themselves (`xyzac-trt-kins`, `xyzbc-trt-kins`, `maxkins`, `5axiskins`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, final

import numpy as np

from twin._common.errors import InputError
from twin.controls.format import TableLine, rotation_about_axis, table_lines
from twin.machine.description import Description, axis_lines, is_linear
from twin.machine.machine import Machine

Side = Literal["tool", "work"]
ALIKE_MM: Final = 1e-3
"""Distance in mm, and angle in mrad, above which an answer and the control contradict each other."""
MANY_TURNS: Final = 3600.0
"""Range in degrees above which a rotary axis counts as unlimited."""
SHORTEST: Final = 1e-6
"""Length below which a vector has no direction."""
_MD: Final[Mapping[str, str]] = {
    "24100": "TRAFO_TYPE", "24500": "TRAFO5_PART_OFFSET", "24510": "TRAFO5_ROT_AX_OFFSET", "24520": "TRAFO5_ROT_SIGN_IS_PLUS",
    "24550": "TRAFO5_BASE_TOOL", "24558": "TRAFO5_JOINT_OFFSET_PART", "24560": "TRAFO5_JOINT_OFFSET", "24570": "TRAFO5_AXIS1",
    "24572": "TRAFO5_AXIS2", "24574": "TRAFO5_BASE_ORIENT", "24582": "TRAFO5_TCARR_NO",
}  # fmt: skip
"""Names of SINUMERIK's machine data of the first transformation, by number."""


class StatedAxis(NamedTuple):
    """One rotary axis of a control.

    Attributes:
        name: its letter; None if the control gives its order only.
        side: the side that it moves.
        direction: (3,) unit vector about which the tool turns relative to the workpiece with a positive command.
        reference: ``nose`` or ``machine``: where its point is counted from.
        point: (3,) a point of the axis with all rotary axes at zero, mm.
    """

    name: str | None
    side: Side
    direction: np.ndarray
    reference: Literal["nose", "machine"]
    point: np.ndarray


@final
@dataclass(frozen=True, eq=False)
class StatedKinematics:
    """Kinematics of a control.

    Attributes:
        title: the control and its data, in words.
        path: the file that contains them.
        axes: rotary axes, from the bed outwards on each side.
        chains: axes of the two sides from the bed outwards, where the control states them.
        ranges: ranges of axes as in the answers, where the control states them.
        unchecked: assumptions that no public description settles.
    """

    title: str
    path: Path
    axes: tuple[StatedAxis, ...]
    chains: Mapping[Side, tuple[str, ...]] = field(default_factory=dict)
    ranges: Mapping[str, Any] = field(default_factory=dict)
    unchecked: tuple[str, ...] = ()

    @classmethod
    def load(cls, paths: Sequence[Path]) -> StatedKinematics:
        """Return the kinematics in a control's files.

        Raises:
            InputError: a file cannot be read, or the files contain no kinematics that twin knows, or others than it can read.
        """
        lines = [line for path in paths for line in table_lines(path)]
        for pattern, read in _READERS:
            if any(pattern.search(line.text) for line in lines):
                return read(lines)
        raise InputError(
            "no kinematics of a control",
            expected="$MC_TRAFO5_…, MD24500 ff., $TC_CARR…, $NK_…, N19680 ff., rows of MachAxis and Trans, or KINEMATICS of LinuxCNC",
            file=paths[0],
        )

    def named(self, tool: Sequence[str], work: Sequence[str]) -> tuple[StatedAxis, ...]:
        """Return the axes with their names.

        Args:
            tool: axes of the tool side, from the bed outwards.
            work: axes of the side of the workpiece.

        Raises:
            InputError: the machine has other rotary axes than the control, or other chains if that states them.
        """
        named = []
        sides: tuple[tuple[Side, Sequence[str]], ...] = (("tool", tool), ("work", work))
        for side, chain in sides:
            rotary = [name for name in chain if not is_linear(name)]
            own = [axis for axis in self.axes if axis.side == side]
            names = [one.name or name for one, name in zip(own, rotary, strict=False)]
            stated = self.chains.get(side, tuple(chain))
            if len(own) != len(rotary) or names != rotary or stated != tuple(chain):
                words = " ".join(self.chains.get(side, [one.name or "one" for one in own])) or "none"
                what = f"`{side}` contradicts the control: {self.title} has {words} there"
                expected = "the same axes, from the bed outwards"
                raise InputError(what, expected=expected, file=self.path, value=" ".join(chain))
            named += [one._replace(name=name) for one, name in zip(own, rotary, strict=True)]
        return tuple(named)

    def completed(self, data: Mapping[str, Any]) -> dict[str, Any]:
        """Return plain answers (`twin.machine.description.Answers`) completed from the control.

        Raises:
            InputError: the control contradicts an answer; it names the answer.
        """
        data = {**{key: list(chain) for key, chain in self.chains.items() if chain}, **data}
        given: Any = data.get("axes") or {}
        own: dict[str, Any] = {name: dict(one) for name, one in given.items()}
        merged = {name: dict(one) for name, one in own.items()}
        chain = (*(data.get("tool") or ()), *(data.get("work") or ()))
        for name, reach in self.ranges.items():
            if name in chain:
                stated_reach = own.get(name, {}).get("range")
                if stated_reach not in (None, reach):
                    raise self._contradiction(f"axes.{name}.range", stated_reach, reach)
                merged.setdefault(name, {})["range"] = reach
        for stated in self.named(data.get("tool") or (), data.get("work") or ()):
            entry = merged.setdefault(str(stated.name), {})
            fields = {
                "about": words_of(stated.direction),
                "positive": "iso",
                "at": f"{stated.reference} {words_of(stated.point)}",
            }
            merged[str(stated.name)] = entry | fields
        completed = {**data, "axes": merged}
        both = [name for name in own if not is_linear(name) and {"about", "at", "positive"} & set(own[name])]
        if both:
            theirs = {name: dict(one) for name, one in merged.items()}
            for name in both:
                if {"about", "positive"} & set(own[name]):  # one without the other: the other has its default
                    theirs[name] = {
                        key: value for key, value in merged[name].items() if key not in ("about", "positive")
                    }
                theirs[name] |= own[name]
            parts = [{p.name: p for p in Description.of(one).parts} for one in (completed, {**data, "axes": theirs})]
            for name in both:
                control, answer = (one[name] for one in parts)
                turned = 1e3 * float(np.linalg.norm(control.motion - answer.motion))
                away = float(np.linalg.norm(np.cross(control.point - answer.point, control.motion)))
                if max(turned, away) > ALIKE_MM:
                    key = (
                        "at" if away > turned and "at" in own[name] else "about" if "about" in own[name] else "positive"
                    )
                    raise self._contradiction(f"axes.{name}.{key}", own[name].get(key), merged[name][key])
        return completed

    def _contradiction(self, answer: str, given: object, found: object) -> InputError:
        return InputError(
            f"`{answer}` contradicts the control ({self.title})", expected=f"{found}, as there, or no such answer", file=self.path,
            value=given,
        )  # fmt: skip

    def differences(self, machine: Machine) -> list[tuple[str, float, float, np.ndarray]]:
        """Return for each rotary axis its name, the angle in degrees and the distance in mm to that of a machine, and the vector (3,).

        The vector leads from the machine's axis to the point that the control states, perpendicular to the axis.

        Raises:
            InputError: the machine has other rotary axes.
        """
        rows = []
        lines, nose = axis_lines(machine, zero=True)
        ordered = [
            axis for _, axis in sorted(zip(machine.axis_joints, machine.axes, strict=True), key=lambda pair: pair[0])
        ]
        for stated in self.named(*([axis.name for axis in ordered if axis.side == side] for side in ("tool", "work"))):
            _, motion, place = lines[str(stated.name)]
            point = place - nose
            turned = motion * (1.0 if stated.side == "tool" else -1.0)
            sine = float(np.linalg.norm(np.cross(turned, stated.direction)))
            angle = float(np.degrees(np.arctan2(sine, turned @ stated.direction)))
            off = stated.point - point
            off = off - motion * float(off @ motion)
            rows.append((str(stated.name), angle, float(np.linalg.norm(off)), off))
        return rows


def words_of(vector: np.ndarray) -> str:
    """Return three numbers separated by blanks, exact but for rounding errors of zero."""
    clean = np.where(np.abs(vector) < 1e-12, 0.0, vector)
    return " ".join(repr(float(value)).removesuffix(".0") for value in clean)


@final
class _Parameters:
    """Parameters of a control by name, each with its line."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.found: dict[str, TableLine] = {}

    def add(self, name: str, line: TableLine) -> None:
        """Add the value of a parameter.

        Raises:
            InputError: it has another value already.
        """
        if self.found.setdefault(name, line).text != line.text:
            raise line.error(f"{name} has two values", self.found[name].text, line.text)

    def number(self, name: str, default: float = 0.0) -> float:
        """Return the number of a parameter, or the default where it is missing."""
        return self.found[name].decimal(name) if name in self.found else default

    def vector(self, *names: str) -> np.ndarray:
        """Return the numbers (3,) of three parameters; missing ones are zero."""
        return np.array([self.number(name) for name in names])

    def direction(self, *names: str) -> np.ndarray:
        """Return the unit vector (3,) of three parameters.

        Raises:
            InputError: they are missing or zero.
        """
        vector = self.vector(*names)
        size = float(np.linalg.norm(vector))
        if size < SHORTEST:
            raise InputError(
                f"{names[0]} … is missing or zero", expected="the direction of a rotary axis", file=self.path
            )
        return vector / size

    def check(self, name: str, expected: float, meaning: str) -> None:
        """Raise `InputError` if a parameter is given and has not the expected value."""
        if self.number(name, expected) != expected:
            raise self.found[name].error(f"{name}: {meaning}", f"{expected:g}", self.found[name].text)


# --- SINUMERIK ---------------------------------------------------------------------------------------

_TRAFO: Final = re.compile(
    r"(?:\$MC_(?P<name>TRAFO5?_\w+?)_1\b|\b(?:MD|N)\s?(?P<number>24\d{3})\b)[^=\[]*(?:\[(?P<index>\d)\])?\s*=\s*(?P<value>[^\s;]+)",
    re.I,
)


def _sinumerik(lines: Sequence[TableLine]) -> StatedKinematics:
    given = _Parameters(lines[0].path)
    for line in lines:
        match = _TRAFO.search(line.text.partition(";")[0])
        if match is not None:
            name = (match["name"] or _MD.get(match["number"], match["number"])).upper()
            value = {"TRUE": "1", "FALSE": "0"}.get(match["value"].upper(), match["value"])
            given.add(f"{name}[{match['index'] or 0}]", TableLine(line.path, line.number, value))
    kind = int(given.number("TRAFO_TYPE[0]", -1))
    if kind in (-1, 72):
        wanted = f"{int(given.number('TRAFO5_TCARR_NO[0]', 1))}" if kind == 72 else None
        return _tool_carrier(lines, wanted)
    if kind not in _TYPES:
        expected = f"MD24100 $MC_TRAFO_TYPE_1 = one of {', '.join(map(str, sorted(_TYPES)))} or 72"
        raise InputError("transformation of another type", expected=expected, file=given.path, value=kind)
    sides, letters = _TYPES[kind]
    for i, upright in enumerate((0.0, 0.0, 1.0)):
        given.check(f"TRAFO5_ROT_AX_OFFSET[{i}]", 0.0, "the zero of a rotary axis is shifted (MD24510)")
        given.check(f"TRAFO5_BASE_ORIENT[{i}]", upright, "the tool is not along Z at zero (MD24574)")
    if not any(name.startswith("TRAFO5_BASE_TOOL[") for name in given.found):
        raise InputError("BASE_TOOL (MD24550) is missing", expected="all machine data of TRAFO5", file=given.path)
    names = ("AXIS1", "AXIS2", "BASE_TOOL", "JOINT_OFFSET", "JOINT_OFFSET_PART")
    fields = {name: [f"TRAFO5_{name}[{i}]" for i in range(3)] for name in names}
    one, two = (
        (np.eye(3)["ABC".index(letters[i - 1])] if letters else given.direction(*fields[f"AXIS{i}"]))
        * (1.0 if given.number(f"TRAFO5_ROT_SIGN_IS_PLUS[{i - 1}]", 1.0) else -1.0)
        for i in (1, 2)
    )
    base, joint, part = (given.vector(*fields[name]) for name in names[2:])
    axes = _axes(sides, one, two, base, joint, part if part.any() or sides == "TW" else joint)
    if letters:
        axes = (axes[0]._replace(name=letters[0]), axes[1]._replace(name=letters[1]))
    unchecked = (
        "the machine's reference point is the spindle nose with the linear axes at zero: the public table gives names and sums only",
        "the axes MD24570 and MD24572 are those of the tool's motion relative to the workpiece with a positive command",
        *(("the vectors have the same meaning as those of types 24, 40 and 56",) if letters else ()),
    )
    return StatedKinematics(f"SINUMERIK, transformation type {kind}", given.path, axes, unchecked=unchecked)


_TYPES: Final[Mapping[int, tuple[str, str]]] = {
    24: ("TT", ""), 40: ("WW", ""), 56: ("TW", ""), 16: ("TT", "AB"), 18: ("TT", "BA"), 20: ("TT", "CA"), 21: ("TT", "CB"),
    32: ("WW", "AB"), 33: ("WW", "AC"), 34: ("WW", "BA"), 35: ("WW", "BC"), 48: ("TW", "AB"), 49: ("TW", "AC"), 50: ("TW", "BA"),
    51: ("TW", "BC"),
}  # fmt: skip
"""Sides (tool, workpiece) of the axes of each transformation type, and their letters where the type states them."""
_CARRIER: Final = re.compile(r"\$TC_CARR(?P<field>\d+)\[(?P<n>\d+)\]\s*=\s*\"?(?P<value>[^\";\s]+)\"?", re.I)


def _tool_carrier(lines: Sequence[TableLine], wanted: str | None) -> StatedKinematics:
    """Return the kinematics of a tool carrier (swivel data record): the one with that number, else the only one."""
    carriers: dict[str, _Parameters] = {}
    for line in lines:
        match = _CARRIER.search(line.text.partition(";")[0])
        if match is not None:
            given = carriers.setdefault(match["n"], _Parameters(line.path))
            given.add(match["field"], TableLine(line.path, line.number, match["value"]))
    if (wanted is None and len(carriers) != 1) or (wanted is not None and wanted not in carriers):
        what = (
            "no transformation and no tool carrier"
            if not carriers
            else "several tool carriers, or not the one of MD24582"
        )
        expected = f"$TC_CARR…[{wanted or 1}], of one carrier" if wanted else "MD24100 … or $TC_CARR… of one carrier"
        raise InputError(what, expected=expected, file=lines[0].path, value=", ".join(carriers) or None)
    number = wanted or next(iter(carriers))
    given = carriers[number]
    kind = given.found["23"].text.upper() if "23" in given.found else "T"
    if kind not in ("T", "P", "M"):
        raise given.found["23"].error("$TC_CARR23: kinematic type", "T, P or M", kind)
    for shift in ("24", "25", "64", "65"):
        given.check(shift, 0.0, "$TC_CARR24, 25, 64, 65: the zero of a rotary axis is shifted")

    def vector(start: int, fine: int) -> np.ndarray:
        return sum((given.vector(*(str(at + i) for i in range(3))) for at in (start, fine)), np.zeros(3))

    l1, l2, l3 = vector(1, 41), vector(4, 44), vector(15, 55)
    one, two = (given.direction(*(str(start + i) for i in range(3))) for start in (7, 10))
    sides, base, head, table = {
        "T": ("TT", l3, l2, l2), "P": ("WW", l2, l3, l3), "M": ("TW", l2, l1, l3),
    }[kind]  # fmt: skip
    axes, ranges = list[StatedAxis](), dict[str, Any]()
    for axis, name, low, high in zip(
        _axes(sides, one, two, base, head, table), ("21", "22"), ("30", "31"), ("32", "33"), strict=True
    ):
        letter = given.found[name].text.upper() if name in given.found else ""
        known = re.fullmatch("[ABC][0-9]?", letter) is not None
        axes.append(axis._replace(name=letter if known else None))
        ends = [given.number(low), given.number(high)]
        if known and ends[0] < ends[1]:
            ranges[letter] = "unlimited" if ends[1] - ends[0] > MANY_TURNS else ends
    unchecked = (
        "the machine's reference point is the spindle nose with the linear axes at zero",
        "the axes $TC_CARR7 to 12 are those of the tool's motion relative to the workpiece with a positive command",
    )
    title = f"SINUMERIK, tool carrier {number}, kinematic type {kind}"
    return StatedKinematics(title, given.path, tuple(axes), ranges=ranges, unchecked=unchecked)


def _axes(
    kind: str, one: np.ndarray, two: np.ndarray, base: np.ndarray, head: np.ndarray, table: np.ndarray
) -> tuple[StatedAxis, StatedAxis]:
    """Return the axes of a head (TT), of a table (WW), or of both (TW).

    Args:
        kind: as above.
        one, two: directions of the first and the second axis.
        base: point of a head's second axis (TW: its only one) from the spindle nose, or of a table's first axis in machine coordinates.
        head: vector from a head's second axis to its first.
        table: vector from a table's first axis to its second (TW: point of its only one in machine coordinates).
    """
    if kind == "TT":
        return StatedAxis(None, "tool", one, "nose", base + head), StatedAxis(None, "tool", two, "nose", base)
    if kind == "WW":
        return StatedAxis(None, "work", one, "machine", base), StatedAxis(None, "work", two, "machine", base + table)
    return StatedAxis(None, "tool", one, "nose", base), StatedAxis(None, "work", two, "machine", table)


_CHAIN: Final = re.compile(
    r"\$N(?P<group>[KT])_(?P<name>\w+)\[(?P<n>\d+)(?:,(?P<i>\d))?\]\s*=\s*\"?(?P<value>[^\";]*)\"?", re.I
)
_ENDS: Final[Mapping[Side, str]] = {"tool": "T_CHAIN_LAST_ELEM", "work": "P_CHAIN_LAST_ELEM"}


def _sinumerik_chain(lines: Sequence[TableLine]) -> StatedKinematics:
    fields: dict[str, dict[str, TableLine]] = {}
    ends: dict[str, TableLine] = {}
    for line in lines:
        match = _CHAIN.search(line.text)
        if match is not None:
            value, name = TableLine(line.path, line.number, match["value"].strip()), match["name"].upper()
            if match["group"].upper() == "K":
                fields.setdefault(match["n"], {})[name + (match["i"] or "")] = value
            else:
                ends.setdefault(name, value)
    elements = {one["NAME"].text: one for one in fields.values() if "NAME" in one}
    nose, chains, axes = np.zeros(3), dict[Side, tuple[str, ...]](), list[StatedAxis]()
    for side, key in _ENDS.items():
        if key not in ends:
            raise InputError(f"$NT_{key} is missing", expected="the last element of the chain", file=lines[0].path)
        place, names = np.zeros(3), list[str]()
        for one in _chain_to(ends[key], elements):
            vector = np.array([one[f"OFF_DIR{i}"].decimal("OFF_DIR") for i in range(3)])
            if one["TYPE"].text == "OFFSET":
                place = place + vector
                continue
            names.append(one["AXIS"].text)
            if one["TYPE"].text == "AXIS_ROT":
                sign = 1.0 if side == "tool" else -1.0
                size = max(float(np.linalg.norm(vector)), SHORTEST)
                axes.append(
                    StatedAxis(names[-1], side, sign * vector / size, "nose" if side == "tool" else "machine", place)
                )
        chains[side] = tuple(names)
        nose = place if side == "tool" else nose
    stated = tuple(one._replace(point=one.point - nose) for one in axes)
    unchecked = (
        "all vectors of the chain are in machine coordinates with all axes at zero",
        "the tool chain ends at the spindle nose",
    )
    return StatedKinematics("SINUMERIK, kinematic chain", lines[0].path, stated, chains, unchecked=unchecked)


def _chain_to(end: TableLine, elements: Mapping[str, Mapping[str, TableLine]]) -> list[Mapping[str, TableLine]]:
    """Return the elements of a chain from the root to its end; a turned element (ROT_CONST) may only be the last, and is left out."""
    carried: dict[str, str] = {}
    for name, one in elements.items():
        following = one["NEXT"].text if "NEXT" in one else ""
        while following in elements and following not in carried:
            carried[following] = name  # a parallel element begins where its neighbour begins
            following = elements[following]["PARALLEL"].text if "PARALLEL" in elements[following] else ""
    names, name = list[str](), end.text
    while name:
        if name in names or name not in elements:
            raise end.error(
                "the kinematic chain is broken or closed", "elements linked by $NK_NEXT, $NK_PARALLEL", name
            )
        names.append(name)
        name = carried.get(name, "")
    found = [elements[name] for name in reversed(names)]
    for one in found:
        for key in ("TYPE", "AXIS", "OFF_DIR0", "OFF_DIR1", "OFF_DIR2"):
            if key not in one:
                raise one["NAME"].error(f"$NK_{key} of an element is missing", "all its fields", one["NAME"].text)
        if one["TYPE"].text not in ("OFFSET", "AXIS_LIN", "AXIS_ROT") and one is not found[-1]:
            raise one["TYPE"].error("an element that turns the chain", "OFFSET, AXIS_LIN, AXIS_ROT", one["TYPE"].text)
    return [one for one in found if one["TYPE"].text in ("OFFSET", "AXIS_LIN", "AXIS_ROT")]


# --- Fanuc -------------------------------------------------------------------------------------------

_PARAMETER: Final = re.compile(r"^N?(19[67]\d\d)\s*(?:Q1)?\s*(?:L1)?\s*(?:P|=|:|\s)\s*(\S+)\s*$")


def _fanuc(lines: Sequence[TableLine]) -> StatedKinematics:
    given = _Parameters(lines[0].path)
    for line in lines:
        match = _PARAMETER.match(line.text.partition("(")[0].strip())
        if match is not None:
            given.add(match[1], TableLine(line.path, line.number, match[2]))
    kind = int(given.number("19680", -1))
    if kind not in (2, 12, 21):
        expected = "19680 = 2, 12 or 21"
        raise InputError("mechanical unit of another type", expected=expected, file=given.path, value=kind)
    for name, expected_value in (("19697", 3.0), ("19698", 0.0), ("19699", 0.0)):
        given.check(name, expected_value, "the tool is not along +Z at zero")
    sides = {2: "TT", 12: "WW", 21: "TW"}[kind]
    one, two = (_fanuc_direction(given, start, side) for start, side in zip((19681, 19686), sides, strict=True))

    def vector(start: int) -> np.ndarray:
        return given.vector(*(str(start + i) for i in range(3)))

    base = vector(19700) if kind == 12 else np.array([0.0, 0.0, given.number("19666")]) + vector(19709)
    axes = _axes(sides, one, two, base, vector(19712), vector(19703 if kind == 12 else 19700))
    unchecked = (
        "19682 and 19687: 1 2 3 for X Y Z; 4, 5, 6 for an axis in the plane XY, YZ, ZX at the angle in 19683 and 19688",
        "19700 to 19702 are counted from the spindle nose with the linear axes at zero",
        "19666 (tool holder offset) is the distance from the spindle nose to the point D of the head; lengths are in mm",
    )
    return StatedKinematics(f"Fanuc, mechanical unit type {kind}", given.path, axes, unchecked=unchecked)


def _fanuc_direction(given: _Parameters, start: int, side: str) -> np.ndarray:
    """Return the direction (3,) of an axis of the side T or W, whose parameters begin at ``start`` (19681, 19686)."""
    code, angle = int(given.number(str(start + 1))), np.radians(given.number(str(start + 2)))
    if code not in range(1, 7):
        what = f"parameter {start + 1} is missing, or no direction of a rotary axis"
        raise InputError(what, expected="1 to 6", file=given.path, value=code)
    first, along = (code - 1) % 3, np.zeros(3)
    along[first], along[(first + 1) % 3] = (1.0, 0.0) if code < 4 else (np.cos(angle), np.sin(angle))
    left_handed = given.number(str(start + 3), float(side == "W")) == 1.0
    return along * (1.0 if left_handed == (side == "W") else -1.0)


# --- HEIDENHAIN --------------------------------------------------------------------------------------


def _heidenhain(lines: Sequence[TableLine]) -> StatedKinematics:
    turned, place, linear = np.eye(3), np.zeros(3), False
    tool, work = list[StatedAxis](), list[StatedAxis]()
    for line in lines:
        words = line.text.partition(";")[0].split()
        if len(words) < 3 or not words[0].isdigit() or words[1] not in ("Trans", "MachAxis"):
            continue
        key, axis = words[1], words[2].upper()
        if axis not in ("X", "Y", "Z", "A", "B", "C") or (key == "Trans" and len(words) < 4):
            raise line.error("not a row of a kinematics description", "NR, KEY, AXIS (X Y Z A B C), COORD", line.text)
        if key == "Trans":
            value, k = line.decimal("COORD", words[3]), "XYZABC".index(axis)
            place = place + turned[:, k] * value if k < 3 else place
            turned = turned @ rotation_about_axis(k - 3, np.radians(value)) if k >= 3 else turned
        elif axis in "XYZ":
            linear = True
        else:
            reference: Literal["nose", "machine"] = "machine" if linear else "nose"
            one = StatedAxis(axis, "work" if linear else "tool", turned[:, "ABC".index(axis)], reference, place)
            (work if linear else tool).append(one)
    if not tool and not work:
        raise InputError("no rotary axis in the description", expected="MachAxis rows of A, B or C", file=lines[0].path)
    unchecked = (
        "signs: Trans moves the system from tool to table, with the spindle nose at zero of all axes as origin; a positive command "
        "moves the tool relative to the workpiece right-handed about the axis of the current system",
        "which of the linear axes move the table is not in the description",
    )
    return StatedKinematics(
        "HEIDENHAIN, kinematics description", lines[0].path, (*reversed(tool), *work), unchecked=unchecked
    )


# --- LinuxCNC ----------------------------------------------------------------------------------------

_SETP: Final = re.compile(r"^(?:HALCMD\s*=\s*)?setp\s+(?P<module>[\w-]+)\.(?P<pin>[\w-]+)\s+(?P<value>\S+)")
_NET: Final = re.compile(
    r"^(?:HALCMD\s*=\s*)?(?:net\s+(?P<net>\S+)\s+(?P<pins>.*)|sets\s+(?P<signal>\S+)\s+(?P<value>\S+))$"
)
_MODULES: Final = ("xyzac-trt-kins", "xyzbc-trt-kins", "maxkins", "5axiskins")


def _linuxcnc(lines: Sequence[TableLine]) -> StatedKinematics:
    given, module = _hal(lines)
    if module not in _MODULES:
        expected = f"one of {', '.join(_MODULES)}"
        raise InputError("kinematics of another kind", expected=expected, file=given.path, value=module or None)

    def pin(name: str, *, needed: bool = False) -> float:
        if needed and f"{module}.{name}" not in given.found:
            raise InputError(f"`setp {module}.{name}` is missing", expected="the HAL file too", file=given.path)
        return given.number(f"{module}.{name}")

    x, y, z = np.eye(3)
    conventional = 1.0 if pin("conventional-directions") else -1.0
    unchecked = ["which linear axes move the table is not in the configuration"]
    if not module.endswith("trt-kins"):
        unchecked.append("pivot-length counts from the spindle nose, without the length of a tool")
    if module.endswith("trt-kins"):
        point = np.array([pin("x-rot-point"), pin("y-rot-point"), pin("z-rot-point") + pin("z-offset")])
        tilting, along = ("A", x) if "ac" in module else ("B", y)
        shift = y * pin("y-offset") if "ac" in module else x * pin("x-offset")
        first = StatedAxis(tilting, "work", conventional * along, "machine", point + shift)
        axes = (first, StatedAxis("C", "work", conventional * z, "machine", point))
        unchecked.append("pins that the files do not set count as 0, their default")
    elif module == "maxkins":
        head = StatedAxis("B", "tool", conventional * y, "nose", z * pin("pivot-length", needed=True))
        axes = (head, StatedAxis("C", "work", z, "machine", np.zeros(3)))
        unchecked.append(
            "maxkins adds the shift by the head without the rotation of C: with B and C away from zero its positions are not those of "
            "a rigid machine, which this is"
        )
    else:
        point = z * pin("pivot-length", needed=True)
        axes = (StatedAxis("C", "tool", z, "nose", point), StatedAxis("B", "tool", -y, "nose", point))
    return StatedKinematics(f"LinuxCNC, {module}", given.path, axes, ranges=_limits(given), unchecked=tuple(unchecked))


def _hal(lines: Sequence[TableLine]) -> tuple[_Parameters, str]:
    """Return the variables of an INI file (`[AXIS_X]MIN_LIMIT`) and the pins of `setp` and `sets`, and the name of the module."""
    given, section, module = _Parameters(lines[0].path), "", ""
    pins, signals, joined = dict[str, TableLine](), dict[str, TableLine](), dict[str, str]()
    for line in lines:
        text = line.text.partition("#")[0].strip()
        pin, net = _SETP.match(text), _NET.match(text)
        if pin is not None:
            pins[f"{pin['module']}.{pin['pin']}"] = TableLine(line.path, line.number, pin["value"])
            module = pin["module"] if pin["module"] in _MODULES else module
        elif net is not None and net["net"]:
            joined |= dict.fromkeys(net["pins"].split(), net["net"])
        elif net is not None:
            signals[net["signal"]] = TableLine(line.path, line.number, net["value"])
        elif text.startswith("[") and text.endswith("]"):
            section = text[1:-1].strip()
        elif section and "=" in text:
            name, _, value = text.partition("=")
            given.found.setdefault(f"[{section}]{name.strip()}", TableLine(line.path, line.number, value.strip()))
    pins |= {name: signals[signal] for name, signal in joined.items() if signal in signals}
    for name, signal in joined.items():
        if name.partition(".")[0] in _MODULES and name not in pins and not name.endswith(".tool-offset"):
            raise InputError(
                f"the value of {name} is that of the signal {signal}, which the files do not give",
                expected=f"`sets {signal} …`, or `setp {name} …` in another file",
                file=given.path,
            )
    for name, value_line in pins.items():
        given.found[name] = given.found.get(value_line.text, value_line)
    kinematics = given.found.get("[KINS]KINEMATICS")
    return given, module if kinematics is None or not kinematics.text else kinematics.text.split()[0]


def _limits(given: _Parameters) -> dict[str, Any]:
    """Return the ranges of the axes in an INI file, as in the answers."""
    ranges: dict[str, Any] = {}
    for name in "XYZABC":
        low, high = f"[AXIS_{name}]MIN_LIMIT", f"[AXIS_{name}]MAX_LIMIT"
        if low in given.found and high in given.found:
            ends = [given.number(low), given.number(high)]
            ranges[name] = "unlimited" if name in "ABC" and ends[1] - ends[0] > MANY_TURNS else ends
    return ranges


_READERS: Final = (
    (re.compile(r"\$NK_NAME", re.I), _sinumerik_chain),
    (re.compile(r"\$MC_TRAFO|\$TC_CARR\d|(?:MD|N)\s?24[15]\d\d\b", re.I), _sinumerik),
    (re.compile(r"^N?19680\b|^N19680"), _fanuc),
    (re.compile(r"^\d+\s+MachAxis\s"), _heidenhain),
    (re.compile(r"^KINEMATICS\s*=|-kins\.|\b(?:maxkins|5axiskins)\."), _linuxcnc),
)
"""The formats, each with a pattern of a line by which its files are recognised."""
