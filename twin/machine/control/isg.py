"""ISG kernel and TwinCAT CNC: parameter files of the volumetric compensation (FCT-C26, TF5280) in ISG CSV format.

Checked against public descriptions, infosys.beckhoff.com/content/1033/tf5280_volumetric_comp/ (the same pages at
www.isg-stuttgart.de/kernel-html5):

- 296429067: columns named in a head line, records below, ``//`` comments, ``#`` between a block and the next, which has a head
  line of its own; a component error's block starts with its argument.
- 296423819: names, EXX … ECC and X0C …, P0X P0Y P0Z, N0X N0Y N0Z, PXC … and VXC ….
- isg-stuttgart.de/fileadmin/kernel/kernel-html/en-GB/296426379.html: values in mm and rad, arguments in mm and degrees.
- 296433163 and P-VOLC-00014: ``interpolation GRID`` (default), linear.
- 296386187: the tool's position is corrected, by the three linear axes, not its orientation. 296392971: the tool length counts
  where N0X N0Y N0Z are given, and is kept up to date by the control.
- 296390283 and tf5200_volumetric_comp_params/563009163: the lines of `LIST`.

What is written: component errors only. Squareness and the place of a rotary axis are folded into the curves, so that nothing
depends on which way round the control reads a position error; components along the machine's x, y, z with all axes at zero; of a
linear axis at the point of the spindle nose it carries along, of a rotary axis at its centre of rotation (PXB … in the file).

**Not checked** (`UNCHECKED`): that a positive component error is the actual deviation as of ISO 230-1 (``negate`` turns it
round); that the lever of an angular error is counted from the point that moves with the axis; positions beyond a block's ends:
taken as held, rotary arguments as wrapped.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from twin._common.errors import InputError
from twin._common.units import TURN
from twin.machine.control.base import Correction
from twin.machine.control.curve import Curve
from twin.machine.control.geometry import Geometry
from twin.machine.control.lines import axis_named, number, numbered, plain, rising
from twin.machine.machine import DIRECTIONS, Axis, ErrorFrame, Machine

FILE: Final = "volcomp.csv"
LIST: Final = "volcomp.lis"
DIGITS: Final = (6, 9)
"""Behind the point: mm, rad."""
UNCHECKED: Final = (
    "sign: a positive component error is taken as the actual deviation (ISO 230-1); `negate` turns an axis round",
    "levers of angular errors: taken from the point that moves with the axis",
    "beyond the ends of a block: the end value; rotary arguments wrapped into a turn",
)
_LENGTH: Final = re.compile(r"twin: tool length (\S+) mm")
_SAME_MM: Final = 1e-3


@final
@dataclass(frozen=True)
class AxisErrors:
    """Six error motions of one axis as the file has them, µm and µrad.

    Attributes:
        axis: the axis.
        curves: by component in ``XYZABC``.
    """

    axis: str
    curves: Mapping[int, Curve]


@final
class Volumetric(Correction):
    """What the control makes of component errors: the linear axes move so that the tool point stays, to first order.

    Args:
        errors: of every axis.
        geometry: of the machine, with the tool.
    """

    def __init__(self, errors: Sequence[AxisErrors], geometry: Geometry) -> None:
        self.errors = tuple(errors)
        self.geometry = geometry
        machine = geometry.machine
        self._linear = tuple(machine.axes[i].name for i in machine.linear)
        self._frames: dict[str, ErrorFrame] = {frame.axis: frame for frame in geometry.frames}

    @property
    def axes(self) -> tuple[str, ...]:
        """See `Correction.axes`."""
        return self._linear if self.errors else ()

    def with_tool(self, tool_length_mm: float) -> Volumetric:
        """See `Correction.with_tool`: this control counts the active tool's length."""
        if tool_length_mm == self.geometry.tool_length_mm:
            return self
        return Volumetric(self.errors, Geometry(self.geometry.machine, tool_length_mm))

    def shift(self, axis: str, positions: Mapping[str, Any]) -> Any:
        """See `Correction.shift`."""
        total: list[Any] = [0.0, 0.0, 0.0]
        for one in self.errors:
            twist = [one.curves[i](positions) if i in one.curves else 0.0 for i in range(6)]
            moved = self.geometry.moved(self._frames[one.axis], positions, twist)
            total = [a + b for a, b in zip(total, moved, strict=True)]
        row = self.geometry.solve[self._linear.index(axis)]
        parts = [-float(weight) * part for weight, part in zip(row, total, strict=True) if weight]
        return sum(parts[1:], parts[0])


def write(errors: Sequence[AxisErrors], geometry: Geometry, notes: Sequence[str] = ()) -> dict[str, str]:
    """The parameter file, and lines of the compensation list, by their names.

    Args:
        errors: all curves of an axis have the same nodes.
        geometry: of the machine; its tool length is noted.
        notes: said in comments at the head.

    Raises:
        InputError: axes of other names than X Y Z A B C.
    """
    machine = geometry.machine
    for axis in machine.axes:
        if axis.name not in DIRECTIONS:
            raise InputError("an axis the volumetric compensation has not", expected="X Y Z A B C", value=axis.name)
    lines = [f"// {note}" for note in notes]
    lines.append(f"// twin: tool length {geometry.tool_length_mm:g} mm (the control takes the active tool's by itself)")
    named = _machine(geometry)
    lines += [
        "// the machine: spindle nose, tool direction, centres and directions of the rotary axes, all axes at zero"
    ]
    lines += ["  ".join(named), "  ".join(plain(value, 6) for value in named.values())]
    for one in errors:
        components = sorted(one.curves)
        at = one.curves[components[0]].at
        lines += ["#", f"// component errors of {one.axis}: mm, rad"]
        lines.append("  ".join([one.axis, *(f"E{DIRECTIONS[i]}{one.axis}" for i in components)]))
        for n, q in enumerate(at):
            cells = [
                plain(one.curves[i].values[n] * (1e-3 if i < 3 else 1e-6), DIGITS[0] if i < 3 else DIGITS[1])
                for i in components
            ]
            lines.append("  ".join([plain(q, 4), *cells]))
    return {FILE: "\n".join(lines) + "\n", LIST: "".join(f"# {note}\n" for note in notes) + _list(machine)}


def _machine(geometry: Geometry) -> dict[str, float]:
    """Names and values of the kinematic parameters; places counted from the spindle nose with all axes at zero."""
    zero = {axis.name: 0.0 for axis in geometry.machine.axes}
    found = dict.fromkeys(("P0X", "P0Y", "P0Z"), 0.0)
    tip, nose = Geometry(geometry.machine, 1.0).tip(zero), geometry.nose
    found |= {f"N0{name}": float(a - b) for name, a, b in zip("XYZ", tip, nose, strict=True)}
    for frame in geometry.frames:
        axis = geometry.machine.by_name[frame.axis]
        if not axis.linear:
            turn, place = geometry.at_zero(frame)
            found |= {f"P{name}{axis.name}": float(a - b) for name, a, b in zip("XYZ", place, nose, strict=True)}
            along = [sum(row[k] * axis.direction[k] for k in range(3)) for row in turn]
            found |= {f"V{name}{axis.name}": float(part) for name, part in zip("XYZ", along, strict=True)}
    return found


def _list(machine: Machine) -> str:
    """Lines of the compensation list: which file, which axes, the order of the chain from workpiece to tool."""
    work = [axis for axis in machine.axes if axis.side == "work"]
    tool = [axis for axis in machine.axes if axis.side == "tool"]
    depth = {
        axis.name: len(machine.model.supports[joint])
        for axis, joint in zip(machine.axes, machine.axis_joints, strict=True)
    }
    chain = [axis.name for axis in sorted(work, key=lambda axis: -depth[axis.name])]
    chain += [axis.name for axis in sorted(tool, key=lambda axis: depth[axis.name])]
    numbers = [f"{axis.name.lower()}  {i}" for i, axis in enumerate(machine.axes, start=1)]
    return "\n".join(
        [
            "# logical axis numbers: put in those of the machine",
            *numbers,
            f"chain  {''.join(chain)}",
            f"workpiece_axes  {len(work)}",
            f"file[0]  {FILE}",
            "file_format[0]  ISG_CSV",
            "interpolation  GRID",
            "",
        ]
    )


def read(files: Sequence[Path], machine: Machine) -> Volumetric:
    """Component errors from parameter files; a compensation list (``.lis``) among them is not read.

    Raises:
        InputError: a column of another name, blocks of two arguments, a parameter given twice, a machine of other dimensions,
        position errors of
            linear axes; whatever is no number.
    """
    curves: dict[str, dict[int, Curve]] = {}
    length = machine.tool_length_mm
    tables = [file for file in files if file.suffix.lower() != ".lis"]
    found: list[_Block] = []
    for path in tables:
        blocks, noted = _blocks(path)
        found += blocks
        length = length if noted is None else noted
    if not found:
        raise InputError("no parameter file", expected=FILE, value=" ".join(file.name for file in files))
    geometry = Geometry(machine, length)
    for block in found:
        arguments = [name for name in block.head if name in DIRECTIONS]
        if len(arguments) > 1:
            raise InputError(
                "a block of two arguments", expected="one", file=block.path, line=block.line, value=" ".join(arguments)
            )
        if arguments:
            axis = axis_named(arguments[0], machine, block.path, block.line)
            for component, curve in _of_block(block, axis).items():
                if component in curves.setdefault(axis.name, {}):
                    raise _twice(block, f"E{DIRECTIONS[component]}{axis.name}")
                curves[axis.name][component] = curve
        else:
            _constants(block, geometry, curves)
    ordered = [AxisErrors(name, curves[name]) for name in machine.names if curves.get(name)]
    return Volumetric(ordered, geometry)


@final
@dataclass(frozen=True)
class _Block:
    path: Path
    line: int
    head: tuple[str, ...]
    rows: tuple[tuple[int, tuple[float, ...]], ...]


def _blocks(path: Path) -> tuple[list[_Block], float | None]:
    blocks: list[_Block] = []
    head: tuple[str, ...] | None = None
    head_line = 0
    rows: list[tuple[int, tuple[float, ...]]] = []
    length: float | None = None

    def close() -> None:
        if head is not None:
            if not rows:
                raise InputError("no records below the head line", expected="one or more", file=path, line=head_line)
            blocks.append(_Block(path, head_line, head, tuple(rows)))

    for line, whole in numbered(path):
        noted = _LENGTH.search(whole)
        if noted is not None:
            length = number(noted[1], path, line, "a tool length")
        text = whole.partition("//")[0].strip()
        if text.startswith("#"):
            close()
            head, rows = None, []
        elif text and head is None:
            head, head_line = tuple(re.split(r"[\s;,]+", text.strip())), line
            if len(set(head)) != len(head):
                raise InputError("a column given twice", expected="each once", file=path, line=line, value=text)
        elif text and head is not None:
            cells = re.split(r"[\s;,]+", text)
            if len(cells) != len(head):
                raise InputError(
                    f"{len(cells)} cells", expected=f"{len(head)}: {' '.join(head)}", file=path, line=line, value=text
                )
            rows.append((line, tuple(number(cell, path, line, name) for cell, name in zip(cells, head, strict=True))))
    close()
    return blocks, length


def _of_block(block: _Block, axis: Axis) -> dict[int, Curve]:
    place = block.head.index(axis.name)
    at = tuple(row[place] for _, row in block.rows)
    rising(at, tuple(line for line, _ in block.rows), block.path)
    period = TURN if axis.lower is None else None
    found = {}
    for column, name in enumerate(block.head):
        if column == place:
            continue
        if not (len(name) == 3 and name[0] == "E" and name[1] in DIRECTIONS and name[2] == axis.name):
            raise InputError(
                f"a column of a block over {axis.name}",
                expected=f"EX{axis.name} … EC{axis.name}",
                file=block.path,
                line=block.line,
                value=name,
            )
        component = DIRECTIONS.index(name[1])
        scale = 1e3 if component < 3 else 1e6
        found[component] = Curve(axis.name, at, tuple(row[column] * scale for _, row in block.rows), period)
    return found


def _constants(block: _Block, geometry: Geometry, curves: dict[str, dict[int, Curve]]) -> None:
    """Position errors of rotary axes join their curves; the machine's dimensions must be the machine's."""
    if len(block.rows) != 1:
        raise InputError(
            "records without an argument",
            expected="one",
            file=block.path,
            line=block.rows[1][0] if len(block.rows) > 1 else block.line,
        )
    known = _machine(geometry)
    line, row = block.rows[0]
    for name, value in zip(block.head, row, strict=True):
        if name in known:
            if abs(value - known[name]) > _SAME_MM:
                raise InputError(
                    f"{name} is not {geometry.machine.name}'s",
                    expected=f"{known[name]:.4f}",
                    file=block.path,
                    line=line,
                    value=value,
                )
            continue
        axis = geometry.machine.by_name.get(name[2:])
        if len(name) != 3 or name[0] not in DIRECTIONS or name[1] != "0" or axis is None or axis.linear:
            raise InputError(
                "a parameter that is not read",
                expected="component errors, X0C … of rotary axes, dimensions of this machine",
                file=block.path,
                line=block.line,
                value=name,
            )
        component = DIRECTIONS.index(name[0])
        own = curves.setdefault(axis.name, {})
        constant = value * (1e3 if component < 3 else 1e6)
        if component in own:
            old = own[component]
            own[component] = Curve(old.of, old.at, tuple(v + constant for v in old.values), old.period)
        else:
            own[component] = Curve(axis.name, (axis.domain[0],), (constant,), None)


def _twice(block: _Block, name: str) -> InputError:
    return InputError("given twice", expected="each error once", file=block.path, line=block.line, value=name)
