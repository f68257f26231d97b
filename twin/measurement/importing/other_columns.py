"""Proposal of the columns that are not numbers: names, sides, directions of approach, dates and times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from twin.measurement.importing.apply import WORD_COLUMNS, moment_in
from twin.measurement.importing.headers import Meaning
from twin.measurement.importing.mapping import entry_of
from twin.measurement.importing.proposal import Proposal, axis_columns, quoted
from twin.measurement.importing.vocabulary import CARRIER_WORDS, direction_of, plain_words

DATE_FORMS: Final = tuple(
    f"{day}{clock}"
    for day in ("%d.%m.%Y", "%d.%m.%y", "%d/%m/%Y", "%m/%d/%Y", "%Y/%m/%d", "%d-%m-%Y", "%m-%d-%Y", "")
    for clock in (" %H:%M:%S", " %H:%M:%S.%f", " %H:%M:%S,%f", " %H:%M", " %I:%M:%S %p", " %I:%M %p")
)
"""Forms of dates and times that are tried after ISO 8601; those without a date only where the file has none."""
SERIAL: Final = ("datetime", "date", "time")


def add_names(found: Proposal, meanings: Mapping[str, Meaning]) -> None:
    """Add target, carrier, station, round and instrument."""
    for name, meaning in meanings.items():
        if meaning.kind == "exact" and name in WORD_COLUMNS:
            found.add(name, entry_of(name))
        elif meaning.kind in ("target", "station", "round"):
            found.add(meaning.kind, entry_of(name))
        elif meaning.kind == "carrier":
            wrong = [cell for cell in found.layout.column(name) if plain_words(cell) not in CARRIER_WORDS]
            if wrong:
                found.notes.append(f"'{name}' is not used: '{wrong[0]}' is not a side of the machine")
            else:
                found.add("carrier", entry_of(name))
    if found.plan is not None:
        return
    points = [name for name, one in meanings.items() if one.kind == "point"]
    if "target" not in found.entries:
        _add_target(found, points)
    if "carrier" not in found.entries:
        moving = [axis for axis, q in zip(found.machine.axes, commands_of(found).T, strict=True) if np.ptp(q) > 1e-3]
        side = "work" if moving and all(axis.side == "work" for axis in moving) else "tool"
        found.entries["carrier"] = entry_of(value=side)
        found.assume(f"the targets sit on the {side} side of the machine (carrier: {side})", "carrier", "tool or work")


def commands_of(found: Proposal) -> np.ndarray:
    """Return (n, axes) the commanded positions in the file's units; zero for an axis that the file does not give."""
    columns = [found.entries.get(name) for name in axis_columns(found.machine)]
    zero = np.zeros(len(found.layout.rows))
    return np.stack(
        [np.nan_to_num(found.values(one.sources[0])) if one and one.sources else zero for one in columns], axis=1
    )


def _add_target(found: Proposal, points: Sequence[str]) -> None:
    for name in points:
        names = dict.fromkeys(found.layout.column(name))
        if 2 * len(names) <= len(found.layout.rows):
            found.add("target", entry_of(name))
            shown = ", ".join(list(names)[:5]) + (", …" if len(names) > 5 else "")
            found.assume(f"each name of '{name}' is a target: {shown}", "target", f"{len(names)} targets")
            return
    found.entries["target"] = entry_of(value="1")
    found.assume("all rows are of one target, named 1", "target", "name of the target")


def add_directions(found: Proposal, meanings: Mapping[str, Meaning]) -> None:
    """Add directions of approach."""
    machine = found.machine
    for name, meaning in meanings.items():
        exact = meaning.kind == "exact" and name.startswith("approach_")
        if meaning.kind != "approach" and not exact:
            continue
        if any(direction_of(cell) is None for cell in found.layout.column(name)):
            wrong = next(cell for cell in found.layout.column(name) if direction_of(cell) is None)
            found.notes.append(f"'{name}' is not used: '{wrong}' is not a direction")
            continue
        axis = machine.by_name.get(meaning.name)
        if exact:
            found.add(name, entry_of(name))
        elif axis is not None:
            found.add(f"approach_{axis.name}", entry_of(name))
        else:
            spans = np.ptp(commands_of(found), axis=0)
            if np.count_nonzero(spans > 1e-3) == 1:
                column = f"approach_{machine.names[int(np.argmax(spans))]}"
                if found.add(column, entry_of(name)):
                    found.assume(f"'{name}' is the direction of {column[9:]}, the only axis that moves", column)


def add_times(found: Proposal, meanings: Mapping[str, Meaning]) -> None:
    """Add the time of each row from columns of dates and times."""
    kinds = {kind: [name for name, one in meanings.items() if one.kind == kind] for kind in SERIAL}
    if "time_s" in found.entries or not any(kinds.values()):
        return
    candidates = [*([one] for one in kinds["datetime"]), *([d, t] for d in kinds["date"] for t in kinds["time"])]
    candidates += [*([one] for one in kinds["time"]), *([one] for one in kinds["date"])]
    for sources in candidates:
        texts = [" ".join(parts).strip() for parts in zip(*map(found.layout.column, sources), strict=True)]
        texts = [text for text in texts if text]
        forms = [form.strip() for form in ("iso", *DATE_FORMS)]
        fitting = [form for form in forms if texts and all(moment_in(text, form) is not None for text in texts)]
        if not fitting or (fitting[0] == "iso" and len(texts[0]) <= 10):
            continue
        if any(form.endswith("%p") for form in fitting):  # clocks of twelve hours come with the month first
            fitting.sort(key=lambda form: not form.startswith("%m"))
        source = sources[0] if len(sources) == 1 else tuple(sources)
        if found.add("time_s", entry_of(source, form=fitting[0])):
            found.notes.append(f"time_s counts from the first row, {texts[0]}")
            if {form[:2] for form in fitting} >= {"%d", "%m"}:
                order = "month" if fitting[0].startswith("%m") else "day"
                found.assume(f"dates have the {order} first: {texts[0]}", "time_s", "order of day and month")
        return
    found.notes.append(
        f"no time: {quoted([name for names in kinds.values() for name in names])} cannot be read as dates"
    )
