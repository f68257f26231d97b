"""ISG kernel and TwinCAT CNC: parameter files of the volumetric compensation (FCT-C26, TF5280) in ISG CSV format.

Checked against public descriptions, infosys.beckhoff.com/content/1033/tf5280_volumetric_comp/ (the same pages at
www.isg-stuttgart.de/kernel-html5):

- 296429067: columns named in a header line, records below, ``//`` comments, ``#`` between blocks, each with its own header line; the
  block of a component error starts with its argument.
- 296423819: names, EXX … ECC and X0C …, P0X P0Y P0Z, N0X N0Y N0Z, PXC … and VXC ….
- isg-stuttgart.de/fileadmin/kernel/kernel-html/en-GB/296426379.html: values in mm and rad, arguments in mm and degrees.
- 296433163 and P-VOLC-00014: ``interpolation GRID`` (default), linear.
- 296386187: the three linear axes correct the tool's position, not its orientation. 296392971: the tool length is used if
  N0X N0Y N0Z are given, and the control keeps it up to date.
- 296390283 and tf5200_volumetric_comp_params/563009163: the lines of `LIST`.

Only component errors are written. Squareness and locations of rotary axes are included in the curves, so that the result does not
depend on the sign convention of the control's position errors. Components are along the machine's x, y, z with all axes at zero; those
of a linear axis refer to the spindle nose, which moves with it, those of a rotary axis to its centre of rotation (PXB … in the file).

**Not checked**: `unchecked` (``negate`` reverses the sign of a component error).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import count_with_noun
from twin.controls.correction import AxisErrors, ControlCurve, VolumetricCorrection, period_of, rest_geometry
from twin.controls.format import TableFormat, TableLine, check_increasing, fixed_decimals, table_lines
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Axis, Machine

FILE: Final = "volcomp.csv"
LIST: Final = "volcomp.lis"
_DIGITS: Final = (6, 9)
"""Number of decimals: mm, rad."""
_UNITS: Final = (1e3, 1e3, 1e3, 1e6, 1e6, 1e6)
"""twin's µm and µrad per mm and rad of the file, by component."""
_LENGTH: Final = re.compile(r"twin: tool length (\S+) mm")
_SAME_MM: Final = 1e-3


@final
class Isg(TableFormat[VolumetricCorrection]):
    """ISG kernel and TwinCAT CNC: volumetric compensation."""

    name = "isg"
    title = "ISG"
    what = "volumetric compensation"
    carries = "all error motions of all axes, at the functional point"
    leaves = "backlash; the tool's orientation"
    correction = VolumetricCorrection
    written = (FILE, LIST)
    classes = ("L-POS", "L-STR", "L-SQU", "L-ANG", "R-POS", "R-RAX", "R-POR", "R-ANG")
    points = 400
    """Largest number of records of an axis: ``vol_comp[0].max_records`` must be at least the sum over all axes."""
    rounding = (0.0005, 0.0005)
    knows_machine = True
    unread = (LIST,)
    unchecked = (
        "sign: a positive component error is taken as the actual deviation (ISO 230-1); `negate` reverses an axis",
        "levers of angular errors: measured from the point that moves with the axis",
        "beyond the ends of a block: the end value; rotary arguments wrapped into one turn",
    )

    def write(self, correction: VolumetricCorrection, notes: Sequence[str] = ()) -> dict[str, str]:
        """Return the parameter file and the lines of the compensation list; see `TableFormat.write`.

        All curves of an axis have the same nodes; the tool length is written as a comment. Axes are named by one of X Y Z A B C.
        """
        machine = correction.machine
        for axis in machine.axes:
            if axis.name not in DIRECTIONS:
                what = "an axis that the volumetric compensation does not support"
                raise InputError(what, expected="X Y Z A B C", value=axis.name)
        named = _dimensions(machine)
        lines = [
            *(f"// {note}" for note in notes),
            f"// twin: tool length {correction.tool_length_mm:g} mm (the control uses the length of the active tool)",
            "// the machine: spindle nose, tool direction, centres and directions of the rotary axes, all axes at zero",
            "  ".join(named),
            "  ".join(fixed_decimals(value, 6) for value in named.values()),
        ]
        for axis_errors in correction.errors:
            components = sorted(axis_errors.curves)
            lines += ["#", f"// component errors of {axis_errors.axis}: mm, rad"]
            lines.append("  ".join([axis_errors.axis, *(f"E{DIRECTIONS[i]}{axis_errors.axis}" for i in components)]))
            for n, q in enumerate(axis_errors.curves[components[0]].at):
                cells = [
                    fixed_decimals(axis_errors.curves[i].values[n] / _UNITS[i], _DIGITS[i // 3]) for i in components
                ]
                lines.append("  ".join([fixed_decimals(q, 4), *cells]))
        return {FILE: "\n".join(lines) + "\n", LIST: "".join(f"# {note}\n" for note in notes) + _list(machine)}

    def read(self, files: Sequence[Path], machine: Machine) -> VolumetricCorrection:
        """Return the component errors from parameter files; a compensation list (``.lis``) among them is ignored.

        It raises `InputError` for unknown or duplicate parameters, dimensions of another machine, and position errors of linear axes.
        """
        curves: dict[str, dict[int, ControlCurve]] = {name: {} for name in machine.names}
        length = machine.tool_length_mm
        blocks: list[_Block] = []
        for path in files:
            if path.suffix.lower() != ".lis":
                lines = table_lines(path)
                for line in lines:
                    match = _LENGTH.search(line.text)
                    length = length if match is None else line.decimal("a tool length", match[1])
                blocks += _blocks(lines)
        if not blocks:
            raise InputError("no parameter file", expected=FILE, value=" ".join(file.name for file in files))
        for block in blocks:
            arguments = [name for name in block.names if name in DIRECTIONS]
            if len(arguments) > 1:
                raise block.head.error("a block with two arguments", "one argument", " ".join(arguments))
            if arguments:
                axis = block.head.axis(arguments[0], machine)
                own = curves[axis.name]
                for component, curve in _of_block(block, axis).items():
                    if component in own:
                        what = f"E{DIRECTIONS[component]}{axis.name}"
                        raise block.head.error("duplicate error", "each error once", what)
                    own[component] = curve
            else:
                _constants(block, machine, curves)
        errors = tuple(AxisErrors(name, own) for name, own in curves.items() if own)
        return VolumetricCorrection(errors, machine, length)

    def loading(self, correction: VolumetricCorrection, largest: Mapping[str, float]) -> tuple[str, ...]:
        """See `TableFormat.loading`."""
        machine = correction.machine
        records = (
            sum(max(len(curve.at) for curve in axis_errors.curves.values()) for axis_errors in correction.errors) + 1
        )
        return (
            f"Copy {FILE} to the controller and the lines of {LIST} into its volumetric compensation list; insert the machine's "
            "logical axis numbers, and check chain and workpiece_axes.",
            f"hochlauf.lis: vol_comp[0].max_records {records} or more.",
            "Activate it in the program (#VOLCOMP ON [ID 0]) or by the CNC object; it corrects the tool's position with "
            f"{' '.join(machine.axes[i].name for i in machine.linear)} but not its orientation.",
            "Enter the tool length in the control: it is used because the file contains N0X N0Y N0Z.",
        )


def _dimensions(machine: Machine) -> dict[str, float]:
    """Return names and values of the kinematic parameters; positions relative to the spindle nose with all axes at zero."""
    rest = rest_geometry(machine)

    def named(letter: str, vector: np.ndarray, axis: str = "") -> dict[str, float]:
        return {f"{letter}{name}{axis}": float(part) for name, part in zip("XYZ", vector, strict=True)}

    dimensions = named("P0", np.zeros(3)) | named("N0", rest.tool)
    for axis in machine.axes:
        if not axis.linear:
            dimensions |= named("P", rest.places[axis.name] - rest.nose, axis.name)
            dimensions |= named("V", rest.turns[axis.name] @ axis.direction, axis.name)
    return dimensions


def _list(machine: Machine) -> str:
    """Return the lines of the compensation list: the file, the axes, and the order of the chain from workpiece to tool."""
    depth = {
        axis.name: len(machine.model.supports[joint])
        for axis, joint in zip(machine.axes, machine.axis_joints, strict=True)
    }
    by_depth = sorted(machine.axes, key=lambda axis: depth[axis.name])
    work = [axis.name for axis in sorted(machine.axes, key=lambda axis: -depth[axis.name]) if axis.side == "work"]
    chain = [*work, *(axis.name for axis in by_depth if axis.side == "tool")]
    lines = [
        "# logical axis numbers: insert those of the machine",
        *(f"{axis.name.lower()}  {i}" for i, axis in enumerate(machine.axes, start=1)),
        f"chain  {''.join(chain)}",
        f"workpiece_axes  {len(work)}",
        f"file[0]  {FILE}",
        "file_format[0]  ISG_CSV",
        "interpolation  GRID",
    ]
    return "\n".join(lines) + "\n"


@final
@dataclass
class _Block:
    """One block: its header line, the names in it, and the rows of numbers."""

    head: TableLine
    names: tuple[str, ...]
    rows: list[tuple[TableLine, tuple[float, ...]]] = field(default_factory=list)


def _blocks(lines: Sequence[TableLine]) -> Iterator[_Block]:
    """Yield the blocks of a file, which are separated by lines with ``#``."""
    block: _Block | None = None
    for line in (*lines, TableLine(lines[0].path, None, "#")) if lines else ():
        text = line.text.partition("//")[0].strip()
        cells = re.split(r"[\s;,]+", text)
        if text.startswith("#"):
            if block is not None:
                if not block.rows:
                    raise block.head.error("no records below the header line", "one or more")
                yield block
            block = None
        elif text and block is None:
            if len(set(cells)) != len(cells):
                raise line.error("duplicate column", "each once", text)
            block = _Block(line, tuple(cells))
        elif text and block is not None:
            if len(cells) != len(block.names):
                what = count_with_noun(len(cells), "cell")
                raise line.error(what, f"{len(block.names)}: {' '.join(block.names)}", text)
            numbers = tuple(line.decimal(name, cell) for cell, name in zip(cells, block.names, strict=True))
            block.rows.append((line, numbers))


def _of_block(block: _Block, axis: Axis) -> dict[int, ControlCurve]:
    """Return the curves of the block of an axis, by component."""
    place = block.names.index(axis.name)
    at = tuple(row[place] for _, row in block.rows)
    check_increasing(at, [line for line, _ in block.rows])
    fields = {}
    for column, name in enumerate(block.names):
        if column == place:
            continue
        if not (len(name) == 3 and name[0] == "E" and name[1] in DIRECTIONS and name[2] == axis.name):
            what = f"unknown column in the block of {axis.name}"
            raise block.head.error(what, f"EX{axis.name} … EC{axis.name}", name)
        component = DIRECTIONS.index(name[1])
        values = tuple(row[column] * _UNITS[component] for _, row in block.rows)
        fields[component] = ControlCurve(axis.name, at, values, period_of(axis))
    return fields


def _constants(block: _Block, machine: Machine, curves: dict[str, dict[int, ControlCurve]]) -> None:
    """Add position errors of rotary axes to their curves, and check that the dimensions are those of the machine."""
    if len(block.rows) != 1:
        raise block.rows[1][0].error("several records without an argument", "one")
    known = _dimensions(machine)
    line, row = block.rows[0]
    for name, value in zip(block.names, row, strict=True):
        if name in known:
            if abs(value - known[name]) > _SAME_MM:
                raise line.error(f"{name} differs from {machine.name}", f"{known[name]:.4f}", value)
            continue
        axis = machine.by_name.get(name[2:])
        if len(name) != 3 or name[0] not in DIRECTIONS or name[1] != "0" or axis is None or axis.linear:
            expected = "component errors, X0C … of rotary axes, dimensions of this machine"
            raise block.head.error("unknown parameter", expected, name)
        component, own = DIRECTIONS.index(name[0]), curves[axis.name]
        old = own.get(component, ControlCurve(axis.name, (axis.domain[0],), (0.0,)))
        values = tuple(before + value * _UNITS[component] for before in old.values)
        own[component] = ControlCurve(old.argument, old.at, values, old.period)
