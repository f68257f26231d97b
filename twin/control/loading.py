"""How tables get into a control and are switched on, step by step: what goes into the text beside them."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import Final

from twin.control.make import Made, Table
from twin.machine.control import heidenhain, isg, linuxcnc, siemens
from twin.machine.control.lines import URAD_IN_DEG

ROOM: Final = 1.2
"""Times the largest correction: what a limit of the control is to be set to, so that a table read another way round is stopped."""


def steps(made: Made) -> tuple[str, ...]:
    """What to do, in order."""
    match made.request.kind:
        case "linuxcnc":
            return _linuxcnc(made)
        case "heidenhain":
            return _heidenhain(made)
        case "siemens":
            return _siemens(made)
        case "isg":
            return _isg(made)
        case _:
            return (
                "grid.csv is a format of ours: corrections (what is added to the commands), um, at points of the box; trilinear "
                "between them.",
                "What reads it has to take the sign from its first line.",
            )


def trial(made: Made) -> str:
    """The check on the machine that shows a sign the wrong way round."""
    # A shift shows by itself; an angle alone only of a rotary axis.
    best = max((one for one in made.tables if one.nodes), key=lambda one: (one.unit == "um", one.peak), default=None)
    if best is None:
        return ""
    against = "dial gauge or interferometer" if best.unit == "um" else "reference encoder or polygon and autocollimator"
    return (
        f"Before cutting: drive the axis with the largest correction ({best.name}, up to {best.peak:.1f} {_shown(best.unit)}) "
        f"against a {against} "
        "with the tables off and on. The error must become smaller. If it doubles, the control reads the sign the "
        "other way round: "
        "switch the tables off."
    )


def _shown(unit: str) -> str:
    return unit.replace("u", "µ", 1)


def _linuxcnc(made: Made) -> tuple[str, ...]:
    machine = made.wanted.machine
    joints = ", ".join(f"joint {i} is {name}" for i, name in enumerate(machine.names))
    pins = [f"joint.{machine.names.index(name)}.backlash-corr" for name in made.largest]
    shown = f"halcmd show pin {pins[0]} shows" if len(pins) == 1 else f"halcmd show pin {' or '.join(pins)} show"
    found = [
        f"Copy the .comp files beside the INI file and its lines of {linuxcnc.INI} into the sections that are there ({joints}: "
        "check it).",
        "Take BACKLASH out of these sections: it is not used beside a COMP_FILE.",
        "STEPGEN_MAXACCEL (steppers) 1.5 to 2 times MAX_ACCELERATION: the correction moves on top of the program.",
        f"Restart LinuxCNC. The tables work from then on; {shown} what is added (mm, degrees).",
        "To switch off: take the COMP_FILE lines out and restart.",
    ]
    if any(axis.lower is None for axis in machine.axes):
        found.append(
            "An axis that turns without end: the table covers -360 ... 720 degrees, beyond that its end value is held."
        )
    return tuple(found)


def _heidenhain(made: Made) -> tuple[str, ...]:
    return (
        f"Copy the .COM files and {heidenhain.CMA} into the folder of the OEM's tables; open each in the table editor before "
        "anything moves: "
        "the columns must stand where the editor has them.",
        "Positions (AXISPOS) count from the machine datum (MP_refPosition): so do those of the calibration.",
        f"Merge {heidenhain.CMA} with one that is there: its line with * in ACTIVE is the one in use.",
        "Switch nonlinear axis-error compensation on for these axes (MP730 on older controls; the machine configuration on "
        "newer ones).",
        "BACKLASH columns: set MP_backLash / MP710 of these axes to zero, or the reversal is taken out twice.",
    )


def _siemens(made: Made) -> tuple[str, ...]:
    machine = made.wanted.machine
    counts = _counts(made)
    limits = ", ".join(
        f"{name} {ceil(ROOM * peak) * 1e-3:.3f} mm"
        if machine.by_name[name].linear
        else f"{name} {ROOM * peak * URAD_IN_DEG:.5f} deg"
        for name, peak in made.largest.items()
    )
    moved = ", ".join(made.largest)
    products = (
        "Products: a table with $AN_CEC_MULT_BY_TABLE and the one behind it are an angular error times its lever (up to 1). Should "
        "the control add the "
        "single values too, the sum goes over MD32720: an alarm comes, and the correction is held at that limit. Then make the "
        "tables with --no-products."
    )
    return (
        f"Check the axes: {', '.join(f'AX{i} = {name}' for i, name in enumerate(machine.names, start=1))} "
        "(MD10000 $MN_AXCONF_MACHAX_NAME_TAB); input and output axes are written by these numbers.",
        f"MD18342 $MN_MM_CEC_MAX_POINTS[t] for t = 0 ... {len(counts) - 1}: {', '.join(str(n) for n in counts)} or more "
        "(reorganises memory: back up first; a restart follows). The 828D has 8 tables of 200 points.",
        f"MD32710 $MA_CEC_ENABLE = 0 for {moved}: tables can be loaded only while it is off.",
        f"Run {siemens.FILE} once as a part program.",
        f"MD32720 $MA_CEC_MAX_SUM, a limit with an alarm, a little above the largest correction: {limits}.",
        f"SD41300 $SN_CEC_TABLE_ENABLE[t] = 1 for all of them, then MD32710 $MA_CEC_ENABLE = 1 for {moved}; reset. Axes must be "
        "referenced.",
        *([products] if any(" times " in one.name for one in made.tables) else []),
        "Leadscrew error compensation (MD32700) of the same axis works beside it: what it takes out must not be in the "
        "calibration again.",
    )


def _counts(made: Made) -> list[int]:
    """Points of every table in the file, by its index."""
    found: dict[int, int] = {}
    for line in made.files[siemens.FILE].splitlines():
        if line.startswith("$AN_CEC["):
            index = int(line[len("$AN_CEC[") : line.index(",")])
            found[index] = found.get(index, 0) + 1
    return [found[index] for index in sorted(found)]


def _isg(made: Made) -> tuple[str, ...]:
    records = sum({one.name[-1]: one.nodes for one in made.tables if one.nodes}.values()) + 1
    return (
        f"Copy {isg.FILE} to the controller and the lines of {isg.LIST} into its volumetric compensation list; put the machine's "
        "logical axis "
        "numbers in, and check chain and workpiece_axes.",
        f"hochlauf.lis: vol_comp[0].max_records {records} or more.",
        "Switch on in the program (#VOLCOMP ON [ID 0]) or by the CNC object; it corrects the tool's position with "
        f"{' '.join(made.wanted.machine.axes[i].name for i in made.wanted.machine.linear)} and "
        "leaves its orientation.",
        "Give the tool its length in the control: with N0X N0Y N0Z in the file it counts.",
    )


def rows(tables: Sequence[Table]) -> list[str]:
    """The tables, a line each."""
    width = max([len(one.name) for one in tables] + [5])
    found = [f"  {'table':<{width}}  {'range':>17}  nodes    step    largest   between nodes   read back   (allowed)"]
    for one in tables:
        unit = _shown(one.unit)
        span = f"{one.low:g} … {one.high:g}"
        nodes = f"{one.nodes:>5}  {one.step:>6g}" if one.nodes else f"{'':>5}  {'':>6}"
        marks = ("" if one.holds else "  NOT WHAT WAS MEANT") + ("" if one.fine else "  ABOVE TOLERANCE")
        found.append(
            f"  {one.name:<{width}}  {span:>17}  {nodes}  {one.peak:>8.2f}  {one.off:>14.3f}  {one.back:>10.4f}  "
            f"{one.off + one.rounding:>10.4f} {unit}{marks}"
        )
    return found
