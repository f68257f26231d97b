"""Proposal of a mapping for a whole file: columns, readings that are computed, sides of the targets, positions from a plan."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Final

import numpy as np

from twin._common.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.measurement.agreement import sides_of_targets
from twin.measurement.columns import PLACE_COLUMNS, POINT_COLUMNS, axis_columns
from twin.measurement.importing.apply import Applied, PlanPoints
from twin.measurement.importing.arrangement import DIRECTION, HEADING, RUN, unit_of_deviations
from twin.measurement.importing.cells import Layout, yaml_list
from twin.measurement.importing.columns import (
    Proposal,
    add_directions,
    add_names,
    add_numbers,
    add_times,
    choose_sign,
    commands_of,
    is_number_column,
    meanings_of,
    quoted,
    stated_units,
    without_header,
)
from twin.measurement.importing.mapping import (
    ANGLE,
    LENGTH,
    ColumnsFile,
    DeviationEntry,
    PlanEntry,
    SphericalEntry,
    column_line,
    entry_of,
    unchecked,
)
from twin.measurement.importing.quantities import (
    ROLES,
    SEXAGESIMAL,
    Meaning,
    direction_of,
    other_axis,
    plain_words,
    table_unit,
    unit_named,
)

CLEAR: Final = 5.0
"""Ratio of misfits from which the readings prove a convention."""
FOLLOWS_MM: Final = 1.0
"""Mean misfit up to which readings follow the commands."""
LARGEST_DEVIATION_MM: Final = 1.0
"""Deviation of a positioning test up to which a title's unit is trusted for it."""
UNCERTAIN_ANGLE: Final = "grad"
"""Word for degrees in German, and for gon in English."""


def proposed(layout: Layout, machine: Machine, plan: PlanPoints | None, given: ColumnsFile | None = None) -> Proposal:
    """Return the proposed mapping of a file.

    ``given``: lines of a mapping file that hold already.

    Raises `InputError`: decimal commas and points in one file; no commanded positions; no header; units that contradict each other.
    """
    found = Proposal(layout, machine, plan, given)
    meanings = meanings_of(layout, machine)
    choose_sign(found, exact=any(meaning.kind == "exact" for meaning in meanings.values()))
    if not layout.header_line:
        meanings = without_header(found)
    _check_axes(found)
    if plan is not None or not _add_one_axis(found, meanings):
        _add_deviations(found, meanings)
        add_numbers(found, meanings)
        _add_spherical(found, meanings)
    if plan is None:
        _check_commands(found, meanings)
    else:
        _match_plan(found, meanings)
    add_names(found, meanings)
    add_directions(found, meanings)
    add_times(found, meanings)
    if plan is None:
        _add_missing(found)
    _choose_conventions(found)
    if plan is None and "carrier" not in found.entries:
        _choose_sides(found)
    if found.deviations is not None and not (found.deviations.along or found.deviations.nominal):
        _ask_for_places(found)
    unused = [
        name
        for name in layout.names
        if name not in found.used and name not in (HEADING, RUN, DIRECTION) and any(layout.column(name))
    ]
    if unused:
        found.notes.append(f"not used: {quoted(unused)}")
    if layout.left_out:
        lines = ", ".join(f"{line} ({text[:40]})" for line, text in layout.left_out[:3])
        more = f" and {len(layout.left_out) - 3} more" if len(layout.left_out) > 3 else ""
        found.notes.append(f"rows without a reading are left out: line {lines}{more}")
    return found


def _check_axes(found: Proposal) -> None:
    """Raise `InputError` if the file gives positions of a rotary axis that the machine does not have: it is of another machine."""
    layout, machine = found.layout, found.machine
    for i, name in enumerate(layout.names):
        letter = other_axis(name.rpartition(": ")[2] if name in layout.derived else name, machine)
        values = found.values(name) if letter else np.zeros(0)
        if letter and np.isfinite(values).any() and np.nanmax(values) - np.nanmin(values) > 1e-6:
            own = [one for one in layout.names if one not in layout.derived]
            renamed = [f"not {one}" if k == i else one for k, one in enumerate(own)]
            raise InputError(
                f"positions of {letter}, an axis that {machine.name} does not have",
                expected=f"a table of a machine with the axes {', '.join(machine.names)}",
                file=layout.raw.path,
                line=layout.header_line or layout.rows[0][0],
                value=name,
                setting="machine",
                cure=f"names: {yaml_list(renamed)}" if name not in layout.derived else None,
            )


# --- Readings that are computed: angles and distances, deviations, lengths along one axis ------------


def _unit_of(found: Proposal, name: str, meaning: Meaning, column: str) -> str | None:
    """Return the unit of a column of the file that its header, the row of units, its cells or the titles state; None if none does."""
    below = found.layout.units[found.layout.names.index(name)]
    for text in (meaning.unit, below, *found.layout.cell_units(name)):
        unit = unit_named("deg" if text == SEXAGESIMAL else text, column) if text else None
        if unit is not None:
            return unit.name
    return stated_units(found).get(table_unit(column))


def _add_spherical(found: Proposal, meanings: Mapping[str, Meaning]) -> None:
    """Add the columns of two angles and a distance, if there are no coordinates."""
    names = {
        kind: next((name for name, one in meanings.items() if one.kind == kind), None)
        for kind in ("horizontal", "vertical", "distance")
    }
    horizontal, vertical, distance = names.values()
    if horizontal is None or vertical is None or distance is None or found.has_readings:
        return
    found.spherical = SphericalEntry(
        horizontal=horizontal,
        vertical=vertical,
        distance=distance,
        angle=_unit_of(found, horizontal, meanings[horizontal], ANGLE),
        length=_unit_of(found, distance, meanings[distance], LENGTH),
    )
    found.used |= {*found.spherical.sources}


def _choose_conventions(found: Proposal) -> None:
    """Choose sense, zero and units of the angles that the readings prove: only with them do they follow the commands."""
    own = found.spherical
    if own is None or (found.given is not None and found.given.spherical is not None):
        return
    spelt = " ".join([own.horizontal, *found.layout.units]).casefold()
    angles = [own.angle] if own.angle is not None and UNCERTAIN_ANGLE not in spelt else ["deg", "gon", "rad", "d.mmss"]
    lengths = [own.length] if own.length is not None else ["mm", "m", "inch"]
    misfits: list[tuple[float, SphericalEntry]] = []
    for angle, length, clockwise, zero in product(angles, lengths, (False, True), ("zenith", "horizon")):
        found.spherical = own.model_copy(
            update={"angle": angle, "length": length, "clockwise": clockwise, "vertical_from": zero}
        )
        try:
            misfits.append((_misfit(found), found.spherical))
        except InputError:  # a cell is no angle in this unit, such as 45.7 in d.mmss
            if [angle] == angles:
                raise
    misfits.sort(key=lambda one: one[0])
    found.spherical = misfits[0][1]
    sense = "clockwise" if found.spherical.clockwise else "counter-clockwise"
    text = (
        f"'{own.horizontal}' grows {sense} seen from above, '{own.vertical}' counts from the {found.spherical.vertical_from}; "
        f"angles in {found.spherical.angle}, distances in {found.spherical.length}"
    )
    if misfits[0][0] < FOLLOWS_MM and CLEAR * misfits[0][0] < misfits[1][0]:
        found.notes.append(f"{text}: only so do the readings follow the commands, within {misfits[0][0]:.2g} mm")
    else:
        found.assume(f"{text}: the readings do not show it", "spherical", "sense, zero and units of the angles")


def _misfit(found: Proposal) -> float:
    """Return the mean misfit of the readings, mm, each target on the side on which it follows the commands."""
    cells = Applied(found.layout, found.mapping(), found.machine).table(found.plan)
    sides = sides_of_targets(found.machine, unchecked(cells, found.machine))
    misfits = [one.misfit_mm for one in sides.values()]
    return float(np.mean(misfits)) if misfits else np.inf


def _add_deviations(found: Proposal, meanings: Mapping[str, Meaning]) -> None:
    """Add the columns of deviations, if there are no coordinates: beside nominal points if positions come from elsewhere."""
    by_axis = {
        one.name.casefold(): name
        for name, one in meanings.items()
        if one.kind == "deviation" and is_number_column(found, name)
    }
    columns = {letter: by_axis[letter] for letter in "xyz" if letter in by_axis}
    measured = any((one.kind == "measured" and one.name) or name in POINT_COLUMNS for name, one in meanings.items())
    if len(columns) < 2 or measured or found.has_readings or "mag" in by_axis:
        return
    commands = {
        one.name.casefold(): name
        for name, one in meanings.items()
        if one.kind in ("command", "bare") and name not in found.layout.derived
    }
    nominal = tuple(commands[letter] for letter in "xyz" if letter in commands)
    elsewhere = found.plan is not None or any(
        one.kind == "command" for name, one in meanings.items() if name in found.layout.derived
    )
    units = {_unit_of(found, name, meanings[name], LENGTH) for name in columns.values()}
    unit = next(iter(units)) if len(units) == 1 else None
    is_position = elsewhere and _are_positions(found, nominal, meanings)
    found.deviations = DeviationEntry(
        **columns, unit=unit or "mm", nominal=nominal if elsewhere and not is_position else ()
    )
    found.used |= {*found.deviations.sources}
    if unit is None:
        found.assume(f"no unit is given for {quoted([*columns.values()])}: mm", "deviations", "unit")
    found.assume(
        f"{quoted([*columns.values()])} are measured less nominal, in the directions of the machine",
        "deviations",
        "sign and directions",
    )


def _are_positions(found: Proposal, nominal: Sequence[str], meanings: Mapping[str, Meaning]) -> bool:
    """Return whether nominal coordinates are the commanded positions that names or a plan give."""
    for name in nominal:
        axis = meanings[name].name
        parts = [
            other
            for other in found.layout.derived
            if meanings[other].kind == "command" and meanings[other].name == axis
        ]
        planned = None if found.plan is None else found.plan.table.positions[:, found.machine.names.index(axis)]
        others = (
            [found.values(parts[0])]
            if parts
            else []
            if planned is None or len(planned) != len(found.layout.rows)
            else [planned]
        )
        if any(np.nanmax(np.abs(found.values(name) - other)) > 1.0 for other in others):
            return False
    return True


def _ask_for_places(found: Proposal) -> None:
    """Add the places of the targets on their carriers, which deviations do not contain, for a person to enter."""
    if all(name in found.entries for name in PLACE_COLUMNS):
        return
    target = found.entries.get("target")
    names = [str(target.value)] if target is not None and target.value is not None else []
    if target is not None and target.sources:
        names = list(dict.fromkeys(found.layout.column(target.sources[0])))
    for column in PLACE_COLUMNS:
        if target is not None and target.sources:
            entry = entry_of(target.sources[0])
            found.entries[column] = entry.model_copy(update={"words": {name: "?" for name in names}})
        else:
            found.entries[column] = entry_of(value="?")
    found.assume(
        f"deviations do not show where the targets {', '.join(names[:6])} sit on their carriers; without their places, angular errors, "
        "squareness and axis locations would be wrong. Enter them, mm: tool side from the spindle nose, work side in the table's frame",
        PLACE_COLUMNS[0],
        "enter the places in mm",
    )


def _add_one_axis(found: Proposal, meanings: Mapping[str, Meaning]) -> bool:
    """Add the columns of a positioning test of one axis (targets, runs, directions, deviations); return whether it is one.

    Raises `InputError`: the axis is a rotary one: the measurement table holds no angles about it.
    """
    layout, machine = found.layout, found.machine
    lettered = {one.name for one in meanings.values() if one.name in machine.by_name or one.name in ("x", "y", "z")}
    series = [name for name, one in meanings.items() if one.kind in ("round", "approach")]
    exact = any(one.kind == "exact" for one in meanings.values())
    if len(lettered) > 1 or not series or found.has_readings or exact:
        return False
    positions = [
        name
        for name, one in meanings.items()
        if one.kind in ("position", "command", "bare", "target") and is_number_column(found, name)
    ]
    positions.sort(
        key=lambda name: (meanings[name].kind == "target", _counts(found.values(name)), not meanings[name].unit)
    )
    readings = [
        name
        for name, one in meanings.items()
        if one.kind in ("deviation", "measured") and is_number_column(found, name)
    ]
    if not positions or not readings:
        return False
    position, reading = positions[0], readings[0]
    axis = _axis_of(found, lettered, found.values(position))
    unit = _unit_of(found, position, meanings[position], LENGTH if axis.linear else ANGLE) or axis.unit
    if not axis.linear:
        raise InputError(
            f"a positioning test of {axis.name}, a rotary axis",
            expected="lengths along a linear axis: a measurement table holds no angles about a rotary axis",
            file=layout.raw.path,
            line=layout.header_line,
            value=" | ".join(layout.names),
        )
    column = f"{axis.name}_{axis.unit}"
    found.add(column, entry_of(position, unit=unit))
    stated = _unit_of(found, reading, meanings[reading], LENGTH)
    if meanings[reading].kind == "deviation":
        stated = _unit_of_deviation(found, reading, meanings[reading], stated)
        unit = stated or "um"
        found.deviations = DeviationEntry(x=reading, unit=unit, along=column)
        found.used.add(reading)
    else:
        unit = stated or unit
        found.add("x_mm", entry_of(reading, unit=unit))
        for name in POINT_COLUMNS[1:]:
            found.entries.setdefault(name, entry_of(value=""))
    if stated is None:
        found.assume(f"no unit is given for '{reading}': {unit}", "deviations" if found.deviations else "x_mm", "unit")
    for name in series:
        if meanings[name].kind == "approach" and all(direction_of(cell) is not None for cell in layout.column(name)):
            found.add(f"approach_{axis.name}", entry_of(name))
    found.used |= {name for name in positions if meanings[name].kind == "target"}
    fixed = {
        "target": "reflector",
        "carrier": axis.side,
        "station": f"laser {axis.name}",
        "instrument": "linear-interferometer",
    }
    for name, value in fixed.items():
        found.entries.setdefault(name, entry_of(value=value))
    found.assume(
        f"'{reading}' is measured along {axis.name} by a laser interferometer whose length grows with {axis.name}",
        column,
        "axis and direction",
    )
    return True


def _unit_of_deviation(found: Proposal, name: str, meaning: Meaning, stated: str | None) -> str | None:
    """Return the unit of the deviations of a positioning test; None if the file does not state it.

    Titles state the unit of the targets: it is that of the deviations, too, only if these are then below `LARGEST_DEVIATION_MM`.
    """
    own = found.layout.units[found.layout.names.index(name)] or meaning.unit or found.layout.cell_units(name)
    if own or stated is None:
        return stated
    titles = [
        unit_named(unit) for unit in map(unit_of_deviations, (*found.layout.titles, *found.layout.raw.comments)) if unit
    ]
    by_title = next((unit.name for unit in titles if unit is not None), None)
    unit, largest = unit_named(stated), float(np.nanmax(np.abs(found.values(name)), initial=0.0))
    fits = unit is not None and largest * float(unit.factor) <= LARGEST_DEVIATION_MM
    return by_title or (stated if fits else None)


def _counts(values: np.ndarray) -> bool:
    """Return whether a column numbers its rows or targets: its values are 1, 2, 3 and so on."""
    distinct = np.unique(values[np.isfinite(values)])
    return len(distinct) > 1 and bool(np.array_equal(distinct, np.arange(1, len(distinct) + 1)))


def _axis_of(found: Proposal, lettered: set[str], targets: np.ndarray) -> Axis:
    """Return the axis of a positioning test: that of the headers, of the titles or the sheet; else assumed, by its range."""
    by_name = {name.casefold(): axis for name, axis in found.machine.by_name.items()}
    if lettered:
        return by_name[next(iter(lettered)).casefold()]
    layout = found.layout
    for text in (*layout.titles, *layout.raw.comments, layout.raw.sheet, layout.raw.path.stem):
        plain = plain_words(text).replace("_", " ")
        match = re.search(
            r"\b(?:axis|achse|axe)\W{0,3}([a-z]\d?)\b|\b([a-z]\d?)\W?\s?(?:axis|achse)\b|^([a-z])$", plain
        )
        axis = by_name.get(next(filter(None, match.groups()))) if match else None
        if axis is not None:
            return axis
    longest = float(np.nanmax(targets, initial=0.0))
    axes = [
        axis for axis in found.machine.axes if axis.linear and axis.upper is not None and axis.upper >= longest
    ] or [axis for axis in found.machine.axes if axis.linear]
    found.assume(f"the file does not name the axis that was measured: {axes[0].name}", f"{axes[0].name}_mm", "axis")
    return axes[0]


# --- Sides of the targets, plan, positions -----------------------------------------------------------


ROWS_OF_A_TARGET: Final = 2000
"""Rows of a target, spread over all of its rows, from which its side is judged."""
Row = tuple[int, tuple[str, ...]]


def _spread(rows: Sequence[Row], of_row: Sequence[str]) -> tuple[Row, ...]:
    """Return `ROWS_OF_A_TARGET` rows of each target at most, from the target of every row, in the same order."""
    by_target: dict[str, list[int]] = {}
    for i, name in enumerate(of_row):
        by_target.setdefault(name, []).append(i)
    kept = (i for own in by_target.values() for i in own[:: -(-len(own) // ROWS_OF_A_TARGET)])
    return tuple(rows[i] for i in sorted(kept))


def _choose_sides(found: Proposal) -> None:
    """Add the side on which each target follows the commands."""
    target, sides = found.entries["target"], {}
    of_row = found.layout.column(target.sources[0]) if target.sources else [str(target.value)] * len(found.layout.rows)
    names = list(dict.fromkeys(of_row))
    if found.deviations is None:
        some = replace(found.layout, rows=_spread(found.layout.rows, of_row))
        cells = Applied(some, found.mapping(), found.machine).table(None)
        sides = sides_of_targets(found.machine, unchecked(cells, found.machine))
    shown = {name: sides[name].carrier for name in names if name in sides and sides[name].carrier}
    chosen = {name: shown.get(name) or _moving_side(found, np.array(of_row, dtype=object) == name) for name in names}
    if len(set(chosen.values())) == 1:
        side = chosen[names[0]]
        found.entries["carrier"] = entry_of(value=side)
        proof = (
            "the readings do not show it" if not shown else "on the other side the readings do not follow the commands"
        )
        proof = "" if 0 < len(shown) < len(names) else f": {proof}"
        text = f"the targets sit on the {side} side of the machine (carrier: {side}){proof}"
        found.assume(text, "carrier", "tool or work")
        return
    found.entries["carrier"] = entry_of(target.sources[0]).model_copy(update={"words": chosen})
    for side in dict.fromkeys(shown.values()):
        of_side = [name for name, own in shown.items() if own == side]
        best = max(sides[name].misfit_mm for name in of_side)
        other = min(sides[name].other_misfit_mm for name in of_side)
        found.assume(
            f"carrier {side}: {', '.join(of_side)} follow the commands on the {side} side (mean misfit {best:.2g} mm or less; "
            f"{other:.3g} mm or more on the other)",
            "carrier",
            "which targets turn with the table",
        )
    unknown = [f"{name} ({chosen[name]})" for name in names if name not in shown]
    if unknown:
        text = (
            f"the readings do not show the side of {', '.join(unknown[:6])}: the one with more axes that moved is taken"
        )
        found.assume(text, "carrier", "tool or work")


def _moving_side(found: Proposal, rows: np.ndarray) -> str:
    """Return the side of the machine with more axes that moved in some rows; the tool side if both have as many."""
    positions = commands_of(found)[rows]
    moving = [axis.side for axis, q in zip(found.machine.axes, positions.T, strict=True) if np.ptp(q) > 1e-3]
    return "work" if moving.count("work") > moving.count("tool") else "tool"


def _check_commands(found: Proposal, meanings: dict[str, Meaning]) -> None:
    """Raise `InputError` if the file gives no commanded position at all, or no measured coordinate."""
    commands = [name for name in axis_columns(found.machine) if name in found.entries]
    if commands and found.has_readings:
        return
    unclear = [name for name, one in meanings.items() if one.kind == "bare" and name not in found.used]
    words = [{*plain_words(name).split()} for name in found.layout.names]
    lettered = [{*map(plain_words, found.layout.column(name))} for name in found.layout.names]
    in_rows = any(2 <= len(own) and own <= {"x", "y", "z", "d", "t", "r", "tp", "pa", "m"} for own in lettered)
    if in_rows or all(any(own <= ROLES[role] for own in words) for role in ("command", "measured")):
        raise InputError(
            "one row for each axis or feature, not for each measured point",
            expected="one row for each point, with the commands of all axes and x, y, z measured",
            file=found.layout.raw.path,
            line=found.layout.header_line,
            value=" | ".join(found.layout.names),
        )
    what = "no commanded positions" if not commands else "no measured coordinates"
    what += f": {quoted(unclear)} can be either" if unclear else ""
    raise InputError(
        what,
        expected="columns for both (X nominal, X actual, or X-Soll, X-Ist), or a plan that gives the commanded positions",
        file=found.layout.raw.path,
        line=found.layout.header_line,
        value=" | ".join(found.layout.names),
        setting="plan" if not commands else None,
        cure=_line_for(found, meanings, is_commanded=bool(commands), unclear=unclear),
    )


def _line_for(
    found: Proposal, meanings: Mapping[str, Meaning], *, is_commanded: bool, unclear: Sequence[str]
) -> str | None:
    """Return the line of a mapping that takes columns from those of the file that have no other use; None if too few are left.

    ``unclear``: columns named by an axis alone. Three columns of lengths beside them are coordinates; one beside a position is a length
    along the axis; none beside the positions of all linear axes: those of a probe with its tip at a sphere's centre.
    """
    layout, axes = found.layout, axis_columns(found.machine)

    def is_length(name: str) -> bool:
        unit = unit_named(meanings[name].unit or layout.units[layout.names.index(name)] or "mm", LENGTH)
        values = found.values(name)
        return (
            unit is not None
            and unit.name != "um"
            and len(np.unique(values[np.isfinite(values)])) > 1
            and not _counts(values)
        )

    free = [
        name
        for name, one in meanings.items()
        if name not in found.used
        and name not in unclear
        and is_number_column(found, name)
        and one.kind in ("", "command", "measured", "deviation", "point", "distance")
        and is_length(name)
    ]
    columns = {f"{meanings[name].name}_{found.machine.by_name[meanings[name].name].unit}": name for name in unclear
               if meanings[name].name in found.machine.by_name}  # fmt: skip
    own = {column: entry_of(name) for column, name in columns.items() if column not in found.entries}
    position = next((name for name, one in meanings.items() if one.kind == "position"), None)
    needed = [*axes][:3] if not (is_commanded or own) else [*POINT_COLUMNS]
    if position is not None and free and not own and not is_commanded:
        axis = _axis_of(found, set(), found.values(position))
        own = {f"{axis.name}_{axis.unit}": entry_of(position, unit="mm"), "x_mm": entry_of(free[0], unit="mm")}
        own |= {column: entry_of(value="") for column in POINT_COLUMNS[1:]}
        return column_line({**own, "instrument": entry_of(value="linear-interferometer")})
    reported = {
        column: found.entries.get(f"readback_{letter}_mm") for column, letter in zip(POINT_COLUMNS, "XYZ", strict=True)
    }
    if is_commanded and all(reported.values()):
        return column_line({column: entry for column, entry in reported.items() if entry is not None})
    if len(free) >= len(needed):
        return column_line(
            {**own, **{column: entry_of(name, unit="mm") for column, name in zip(needed, free, strict=False)}}
        )
    if free or not {column for column, axis in axes.items() if axis.linear} <= {*own}:
        return None
    centre = {**dict.fromkeys(POINT_COLUMNS, entry_of(value=0.0)), "station_carrier": entry_of(value="tool")}
    words = {"carrier": "work", "target": "sphere", "instrument": "probe"}
    return column_line({**own, **centre, **{name: entry_of(value=word) for name, word in words.items()}})


def _match_plan(found: Proposal, meanings: dict[str, Meaning]) -> None:
    plan = found.plan
    if plan is None:
        return
    if found.given is not None and found.given.plan is not None:
        found.matched = found.given.plan
        return
    names = [name for name, one in meanings.items() if one.kind in ("point", "target", "index")]
    for name in names:
        if plan.matches(found.layout.column(name)):
            found.matched = PlanEntry(match="point", point=name)
            found.used.add(name)
            return
    if any(name in found.entries for name in axis_columns(found.machine)):
        found.matched = PlanEntry(match="positions")
        return
    found.matched = PlanEntry(match="order")
    found.assume("the rows are in the order of the plan", "plan", "check the order of the rows")


def _add_missing(found: Proposal) -> None:
    """Add a constant for each axis whose commanded position the file does not give."""
    for column, axis in axis_columns(found.machine).items():
        if column in found.entries:
            continue
        low, high = (axis.lower, axis.upper) if axis.lower is not None and axis.upper is not None else (0.0, 0.0)
        value = min(max(0.0, low), high)
        found.entries[column] = entry_of(value=value)
        found.assume(
            f"{axis.name} stood at {value:g} {axis.unit} in all rows: the file does not give it", column, "position"
        )
