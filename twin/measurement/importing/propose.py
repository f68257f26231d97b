"""Proposal of a mapping: the columns of a file by their headers, with every assumption in words."""

from __future__ import annotations

from collections.abc import Sequence

from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.importing.apply import WORD_COLUMNS
from twin.measurement.importing.decimals import COMMA, POINT, SIGNS, decimal_sign, decimal_value, looks_like_number
from twin.measurement.importing.headers import Meaning, meaning_of
from twin.measurement.importing.layout import Layout
from twin.measurement.importing.mapping import PlanEntry, entry_of
from twin.measurement.importing.other_columns import add_directions, add_names, add_times
from twin.measurement.importing.plan_rows import PlanPoints
from twin.measurement.importing.proposal import Proposal, axis_columns, quoted
from twin.measurement.importing.sizes import unit_by_size
from twin.measurement.importing.units import units_of
from twin.measurement.importing.vocabulary import ROLES, plain_words


def proposed(layout: Layout, machine: Machine, plan: PlanPoints | None) -> Proposal:
    """Return the proposed mapping of a file.

    Raises:
        InputError: decimal commas and points in one file; no commanded positions; no header.
    """
    found = Proposal(layout, machine, plan)
    meanings = {name: meaning_of(name, machine) for name in layout.names}
    _choose_sign(found, exact=any(one.kind == "exact" for one in meanings.values()))
    if not layout.header_line:
        meanings = _without_header(found)
    _add_numbers(found, meanings)
    if plan is None:
        _check_commands(found, meanings)
    else:
        _match_plan(found, meanings)
    add_names(found, meanings)
    add_directions(found, meanings)
    add_times(found, meanings)
    if plan is None:
        _add_missing(found)
    unused = [name for name in layout.names if name not in found.used and any(layout.column(name))]
    if unused:
        found.notes.append(f"not used: {quoted(unused)}")
    if layout.left_out:
        lines = ", ".join(f"{line} ({text[:40]})" for line, text in layout.left_out[:3])
        more = f" and {len(layout.left_out) - 3} more" if len(layout.left_out) > 3 else ""
        found.notes.append(f"rows without a number are left out: line {lines}{more}")
    return found


def _choose_sign(found: Proposal, *, exact: bool) -> None:
    layout = found.layout
    is_sheet = bool(layout.raw.sheet)
    cells = [cell for _, row in layout.rows for cell in row if not is_sheet or COMMA in cell]
    sign = decimal_sign(cells)
    if sign.contrary and not is_sheet:
        line = next(line for line, row in layout.rows if sign.contrary in row)
        raise InputError(
            "decimal commas and decimal points in one file",
            expected="one decimal sign",
            file=layout.raw.path,
            line=line,
            value=sign.contrary,
        )
    found.sign = sign.sign
    ordinary = sign.sign == POINT and COMMA not in sign.ambiguous and (exact or layout.raw.delimiter == "comma")
    if sign.ambiguous and not ordinary:
        value = decimal_value(sign.ambiguous, sign.sign)
        name = SIGNS[sign.sign]
        found.assume(f"the decimal sign is the {name}: '{sign.ambiguous}' is read as {value}", "decimal", "check")


def _without_header(found: Proposal) -> dict[str, Meaning]:
    """Return meanings of the columns of a file without header: a name and three coordinates.

    Raises:
        InputError: other columns, or no plan.
    """
    layout = found.layout
    numbers = [name for name in layout.names if all(looks_like_number(cell) for cell in layout.column(name) if cell)]
    words = [name for name in layout.names if name not in numbers and any(layout.column(name))]
    if len(numbers) == 4 and not words:  # numbered points
        words, numbers = numbers[:1], numbers[1:]
    if len(numbers) != 3 or not words or found.plan is None:
        raise InputError(
            "no header row" + (" and no plan" if found.plan is None else ""),
            expected="a row with the names of the columns; or lines of a name and x, y, z, with a plan for the positions",
            file=layout.raw.path,
            line=layout.rows[0][0],
            value=" | ".join(layout.rows[0][1]),
            setting="plan" if found.plan is None else None,
        )
    found.assume(f"the file has no header; {quoted(numbers)} are x, y, z", "x_mm", "no header")
    return {
        **dict.fromkeys(layout.names, Meaning()),
        words[-1]: Meaning("point", "point"),
        **{name: Meaning("measured", axis) for name, axis in zip(numbers, "xyz", strict=True)},
    }


def _role(meaning: Meaning, name: str, found: Proposal, roles: set[tuple[str, str]]) -> str:
    """Return the role of a column that names an axis: that of its words, else from the other columns."""
    machine = found.machine
    linear = meaning.name.casefold() in ("x", "y", "z")
    if meaning.kind == "measured":
        return "measured" if linear else "readback"
    if meaning.kind != "bare":
        return meaning.kind
    if not linear or meaning.name not in machine.by_name:
        return "command" if meaning.name in machine.by_name else "measured" if linear else ""
    letter = meaning.name.casefold()
    if any(kind == "bare" and other == "x" for kind, other in roles) and _has_both_cases(found.layout.names, machine):
        return "measured" if name.lstrip()[:1].islower() else "command"
    if ("measured", letter) in roles:
        return "command"
    if ("command", letter) in roles or found.plan is not None:
        return "measured"
    return "bare"


def _has_both_cases(names: Sequence[str], machine: Machine) -> bool:
    first = [name.lstrip()[:1] for name in names if meaning_of(name, machine).kind == "bare"]
    return "x" in first and "X" in first


def _add_numbers(found: Proposal, meanings: dict[str, Meaning]) -> None:
    """Add commanded positions, read-back values, coordinates, uncertainties, temperatures and channels."""
    machine = found.machine
    roles = {(one.kind, one.name.casefold()) for one in meanings.values()}
    roles |= {
        ("measured", one.name[0])
        for name, one in meanings.items()
        if one.kind == "exact" and name in ("x_mm", "y_mm", "z_mm")
    }
    roles |= {
        ("command", one.name[0].casefold())
        for one in meanings.values()
        if one.kind == "exact" and one.name in axis_columns(machine)
    }
    chosen: dict[str, tuple[str, Meaning]] = {}
    for name, meaning in meanings.items():
        column = _column_of(name, meaning, found, roles)
        if column is None:
            continue
        if column in chosen:
            found.assume(f"{column} is taken from '{chosen[column][0]}', not from '{name}'", column, f"or {name}")
            continue
        chosen[column] = (name, meaning)
        if not meaning.certain:
            found.assume(f"'{name}' is {column}", column, "meaning of the name")
    units = unit_by_size(found, {column: (name, meaning.unit) for column, (name, meaning) in chosen.items()})
    for column, (name, meaning) in chosen.items():
        if meaning.kind == "exact":
            unit = next((one.name for one in units_of(column)), None)
            found.add(column, entry_of(name, unit=unit))
        else:
            found.add(column, entry_of(name, unit=units.get(column)))


def _column_of(name: str, meaning: Meaning, found: Proposal, roles: set[tuple[str, str]]) -> str | None:
    """Return the column of the measurement table that a column of numbers gives; None if it gives none."""
    if meaning.kind == "exact":
        return None if name in WORD_COLUMNS or name.startswith("approach_") else name
    if meaning.kind in ("spindle_rpm", "feed_mm_min", "load_kg"):
        return meaning.kind
    if meaning.kind == "temperature":
        return f"T_{meaning.name}_degC"
    if meaning.kind == "time" and _is_number_column(found, name):
        return "time_s"
    if not meaning.name:
        return None
    role, axis = _role(meaning, name, found, roles), found.machine.by_name.get(meaning.name)
    letter = meaning.name.casefold()
    if role in ("command", "readback") and axis is not None:
        return f"{'readback_' if role == 'readback' else ''}{axis.name}_{axis.unit}"
    if role == "measured" and letter in ("x", "y", "z"):
        return f"{letter}_mm"
    return f"u_{letter}_mm" if role == "uncertainty" and letter in ("x", "y", "z") else None


def _is_number_column(found: Proposal, name: str) -> bool:
    cells = [cell for cell in found.layout.column(name) if cell]
    return bool(cells) and all(decimal_value(cell, found.sign) is not None for cell in cells)


def _check_commands(found: Proposal, meanings: dict[str, Meaning]) -> None:
    """Raise `InputError` if the file gives no commanded position at all, or no measured coordinate."""
    commands = [name for name in axis_columns(found.machine) if name in found.entries]
    measured = [name for name in ("x_mm", "y_mm", "z_mm", "a_urad", "b_urad") if name in found.entries]
    unclear = [name for name, one in meanings.items() if one.kind == "bare" and name not in found.used]
    if commands and measured:
        return
    words = [{*plain_words(name).split()} for name in found.layout.names]
    if all(any(own <= ROLES[role] for own in words) for role in ("command", "measured")):
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
    )


def _match_plan(found: Proposal, meanings: dict[str, Meaning]) -> None:
    plan = found.plan
    if plan is None:
        return
    names = [name for name, one in meanings.items() if one.kind in ("point", "target", "index")]
    for name in names:
        if plan.matches(found.layout.column(name)):
            found.matched = PlanEntry(match="point", point=name)
            found.used.add(name)
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
