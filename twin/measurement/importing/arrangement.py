"""Tables in other arrangements as one row for each reading and one column for each quantity.

Each arrangement is recognised by its content alone: names and headings that hold positions (``X100_Y250_Z-200_A0_C30_K1``), and the
matrix of ISO 230-2 (targets against runs, either way round). What they hold becomes columns of the file, so that a mapping refers to it
as to any other column.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final, NamedTuple, final

from twin.measurement.importing.cells import Layout, RawTable, Row, layout_of
from twin.measurement.importing.quantities import (
    COMMA,
    DOWN_WORDS,
    MINUS,
    NAMES,
    POINT,
    ROLES,
    UP_WORDS,
    direction_of,
    is_no_value,
    looks_like_number,
    plain_words,
    quantity_in,
    unit_named,
    without_unit,
)

FEWEST: Final = 2
"""Number of axes that a name must give, of runs that a matrix must have, and of headings that a table must have."""
SHARE: Final = 0.8
"""Share of rows whose names must give positions."""
MOST_BEFORE: Final = 20
"""Number of rows between the targets and the first run of a matrix."""
NEAR: Final = 0.01
"""Distance of a reading from its target, as a share of the largest target, up to which it is a position and not a deviation."""
HEADING: Final = "heading"
"""Name of the column with the heading above each row."""
RUN: Final = "run"
DIRECTION: Final = "direction"
NAME: Final = "name"
"""Names of the columns that a matrix gives, and of parts of names of points."""
_POSITION: Final = re.compile(
    r"(?<![A-Za-z])([XYZABCUVW])\s*[=:]?\s*([-+]?\d+(?:[.,]\d+)?)(?:\s*(?:mm|deg|°))?(?![0-9]|[.,][0-9]|[A-Za-z](?![-+]?\d))",
    re.IGNORECASE | re.ASCII,
)
_ROUND: Final = re.compile(r"(?:r|run|round|runde|lauf|durchgang|wdh|rep|essai|serie|cycle)\s*\d+", re.IGNORECASE)


_GROUPED_ROUND: Final = re.compile(r"(?<![a-z])(run|round|runde|lauf|durchgang|serie) (\d+)(?= *::)", re.IGNORECASE)


def table_layout(raw: RawTable, names: Sequence[str] = ()) -> Layout:
    """Return the parts of a table in any arrangement; arguments and errors as `layout_of`."""
    raw = _with_entries(raw) or raw
    matrix = None if names else _matrix(raw)
    if matrix is not None:
        return replace(layout_of(replace(raw, rows=matrix.rows, merged=())), left_out=matrix.left_out)
    layout = _with_headings(layout_of(raw, names))
    for name in layout.names:
        layout = _with_name_parts(layout, name)
    return layout


def unit_of_deviations(text: str) -> str:
    """Return the unit that a title states for deviations; empty if it states none."""
    stated = _DEVIATION_UNIT.search(text)
    return next(filter(None, stated.groups())) if stated else ""


def _with_entries(raw: RawTable) -> RawTable | None:
    """Return a table of lines that name each of their values (``P1 X=300.0012 A=0.``), below a header; None if it is none."""
    found = []
    for line, cells in raw.rows:
        text = " ".join(cells)
        entries = dict(_ENTRY.findall(text))
        if len(entries) >= FEWEST:
            found.append((line, entries, re.sub(r"[:;,\s]+$", "", text[: _ENTRY.search(text).start()])))  # type: ignore[union-attr]
    names = list(dict.fromkeys(name for _, entries, _ in found for name in entries))
    if len(found) < FEWEST or any(names != [*entries] for _, entries, _ in found):
        return None
    first, last = found[0][0], found[-1][0]
    if len(found) < SHARE * sum(first <= line <= last for line, _ in raw.rows):  # headings above blocks of points
        return None
    labels = all(label for *_, label in found)
    titles = [(line, cells) for line, cells in raw.rows if line < first]
    rows = [
        (line, (*([label] if labels else []), *(value.replace(COMMA, POINT) for value in e.values())))
        for line, e, label in found
    ]
    below = [(line, (" ".join(cells),)) for line, cells in raw.rows if line > last]
    header = (first - 1 or first, (*(["name"] if labels else []), *names))
    return replace(raw, rows=(*titles, header, *rows, *below), merged=())


# --- Names and headings that hold positions ---------------------------------------------------------


def positions_in(text: str) -> tuple[dict[str, str], str]:
    """Return the positions that a name holds, as text by the letter of the axis, and the rest of the name.

    A name that gives an axis twice gives no positions.
    """
    found: dict[str, str] = {}
    plain = text.translate(MINUS)
    for match in _POSITION.finditer(plain.replace("_", " ")):
        letter = match[1].upper()
        if letter in found:
            return {}, text
        found[letter] = match[2].replace(COMMA, POINT)
    return found, _POSITION.sub(" ", plain.replace("_", " ")) if found else text


def _with_name_parts(layout: Layout, name: str) -> Layout:
    """Return a layout with a column for each part of the names in a column, if these hold positions."""
    cells = layout.column(name)
    if any(looks_like_number(cell) for cell in cells):
        return layout
    parts = [positions_in(cell) for cell in cells]
    given = [found for found, _ in parts if len(found) >= FEWEST]
    if len(given) < SHARE * len(cells):
        if 2 * len(set(cells)) <= len(cells):
            return layout
        parts, given = (
            [({}, cell.replace("_", " ")) for cell in cells],
            [],
        )  # with a number for each point, such as K1_017
    letters = [letter for letter in "XYZABCUVW" if any(letter in found for found in given)]
    columns = {f"{name}: {letter}": [found.get(letter, "") for found, _ in parts] for letter in letters}
    # Collection, group and point (A::Round_1::P1) have several words each; a group `Round_1` is one.
    rest = [re.split(r"[\s,;:/|-]+", _GROUPED_ROUND.sub(r"\1\2", text.strip(" -,;:/|"))) for _, text in parts]
    count = max(map(len, rest))
    padded = [[*words, *[""] * (count - len(words))] for words in rest]
    kept: list[int] = []
    rounds: list[int] = []
    for i in range(count):
        words = [row[i] for row in padded]
        distinct = {word for word in words if word}
        if distinct and all(_ROUND.fullmatch(word) for word in distinct):
            rounds.append(i)
        elif distinct and 2 * len(distinct) <= len(words):  # others are numbers of points
            kept.append(i)
    if rounds and not kept and letters:  # R1, R2 and R3 may be the reflectors
        kept = rounds
    elif rounds:
        columns[f"{name}: {RUN}"] = [row[rounds[0]] for row in padded]
    several = [i for i in kept if len({row[i] for row in padded}) > 1]
    kept = several or kept
    if kept and (letters or several):
        columns[f"{name}: {NAME}"] = [" ".join(filter(None, (row[i] for i in kept))) for row in padded]
    return layout.with_columns(columns) if columns else layout


def _with_headings(layout: Layout) -> Layout:
    """Return a layout with the heading above each row as a column, if rows without numbers in between give positions."""
    headings = {line: text for line, text in layout.left_out if len(positions_in(text)[0]) >= FEWEST}
    above = [(line, " ".join(filter(None, cells))) for line, cells in layout.raw.rows if line < layout.rows[0][0]]
    first = next((text for _, text in reversed(above) if len(positions_in(text)[0]) >= FEWEST), "")
    if len(headings) + bool(first) < FEWEST:
        return layout
    cells, current = [], first
    waiting = sorted(headings)
    for line, _ in layout.rows:
        while waiting and waiting[0] < line:
            current = headings[waiting.pop(0)]
        cells.append(current)
    left_out = tuple((line, text) for line, text in layout.left_out if line not in headings)
    return replace(layout.with_columns({HEADING: cells}), left_out=left_out)


# --- The matrix of ISO 230-2 ------------------------------------------------------------------------


@final
class _Matrix(NamedTuple):
    """Rows of a table with one row for each reading, and the rows of the file that are no readings (means, standard deviations)."""

    rows: tuple[Row, ...]
    left_out: tuple[tuple[int, str], ...]


_RUNS: Final = NAMES["round"] | {"messung", "measurement", "mesure"}
_TOLERANCES: Final = frozenset({"tol", "toleranz", "tolerance", "utol", "ltol", "otol", "utl", "ltl", "out", "outtol"})
_RUN_WORDS: Final = (_RUNS | ROLES["approach"] | {"n", "nr", "no", "j", "x", "xij"} | ROLES["deviation"]) - _TOLERANCES
"""Words of the titles of runs; ``+TOL`` and ``-TOL`` are no runs."""


_DEVIATION_UNIT: Final = re.compile(
    r"(?:abweich|deviat|error|fehler|ecart|écart)\w*[^;,\[(]{0,16}(?:[\[(]|\bin\s)\s*([µμ]m|um|mm|inch)\b|(?:[\[(]|\bin\s)\s*([µμ]m|um|microns?)\b"
    r"|(?:abweichung(?:en)?|deviations?|errors?|fehler|[eé]carts?)\s*[:=;,]?\s*([µμ]m|um|microns?|[mμµ]icromet(?:er|re)s?|mikrometer)\b",
    re.IGNORECASE,
)
"""Title that states the unit of deviations: ``Errors: Micrometres``."""
_ENTRY: Final = re.compile(r"(?<!\S)([A-Za-z_]\w*)\s*=\s*([-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+))(?!\S)")
"""Entry of a line that names each of its values: ``X=300.0012``."""


def run_in(text: str) -> tuple[str, int] | None:
    """Return the number and direction of a run from its title (``Lauf 2 ↑``, ``3-``, ``Run 1 forward``); None if it is no run."""
    words = re.findall(r"[^\W\d_]+|\d+|[-+−–↑↓→←]", plain_words(text))
    numbers = [word for word in words if word.isdecimal()]
    directions = {direction_of(word) for word in words if not word.isdecimal() and (direction_of(word) or 0)}
    known = all(
        word.isdecimal() or word in _RUN_WORDS or word in UP_WORDS or word in DOWN_WORDS or not word[0].isalpha()
        for word in words
    )
    is_run = any(word in _RUNS for word in words)
    if not known or len(numbers) > 1 or len(directions) > 1 or not (directions or (is_run and numbers)):
        return None
    return (numbers[0] if numbers else "1"), next(iter(directions), 0) or 0


def _matrix(raw: RawTable) -> _Matrix | None:
    for at in range(min(len(raw.rows), 100)):
        matrix = _runs_in_columns(raw, at) or _runs_in_rows(raw, at)
        # Of two rows of titles, the lower one shows more runs.
        lower = _runs_in_columns(raw, at + 1) if matrix is not None and at + 1 < len(raw.rows) else None
        if matrix is not None:
            return max([matrix, *([lower] if lower is not None else [])], key=lambda one: len(one.rows))
    return None


def _runs_in_columns(raw: RawTable, at: int) -> _Matrix | None:
    """Return the matrix whose header is a row, with one column for each run; None if it is no such header."""
    line, header = raw.rows[at]
    upper = raw.rows[at - 1][1] if at else ()
    runs: dict[int, tuple[str, int]] = {}
    unit, group = "", ""
    for i, cell in enumerate(header):
        group = upper[i] if i < len(upper) and upper[i] else group if cell else ""
        alone, own = without_unit(cell)
        is_title = bool(cell) and plain_words(alone).strip(". ") not in NAMES["position"]  # "Pos." is no direction
        run = run_in(alone) if is_title else None
        if is_title and (run is None or not re.search(r"\d", alone)):
            run = run_in(f"{without_unit(group)[0]} {alone}") or run
        if run is not None and not looks_like_number(cell):
            runs[i] = run
            unit = unit or own
    if len(runs) < FEWEST or len(set(runs.values())) < len(runs):
        return None
    body = raw.rows[at + 1 :]
    below = ""
    if body and all(unit_named(cell) or not cell for cell in (_bare(cell) for cell in body[0][1])):
        below, units = body[0][1][min(runs)] if min(runs) < len(body[0][1]) else "", body[0][1]
        body = body[1:]
    else:
        units = ()
    others = [i for i in range(len(header)) if i not in runs]
    place = _target_column(others, header, upper, body)
    if place is None:
        return None
    title = _title_at(place, header, upper) or "position"
    title += f" [{_bare(units[place])}]" if place < len(units) and units[place] else ""
    rows, left_out = [], []
    for number, cells in body:
        target = cells[place] if place < len(cells) else ""
        values = {i: cells[i] for i in runs if i < len(cells) and cells[i]}
        if looks_like_number(target) and any(looks_like_number(value) for value in values.values()):
            rows.append((number, target, values))
        else:
            left_out.append((number, " ".join(filter(None, cells))))
    return _in_rows(
        raw, at - bool(_is_group_row(upper, header)), line, title, _bare(below) or unit, runs, rows, left_out
    )


def _is_group_row(upper: Sequence[str], header: Sequence[str]) -> bool:
    return any(run_in(f"{cell} 1") for cell in upper if cell) and len(upper) <= len(header) + 1


def _bare(unit: str) -> str:
    return unit.strip("[]() ")


def _title_at(i: int, header: Sequence[str], upper: Sequence[str]) -> str:
    """Return the title of a column: that of the header, or of the row above where the header has none or a unit alone."""
    over = upper[i] if i < len(upper) else ""
    return f"{over} {header[i]}".strip() if unit_named(_bare(header[i])) else header[i] or over


def _is_position_title(title: str) -> bool:
    words = re.findall(r"[a-z]+", plain_words(title))
    return all(
        word in NAMES["position"] | ROLES["command"] | {*"xyzabcuvwip", "axis", "achse", "axe", "pi"} for word in words
    )


def _target_column(
    others: Sequence[int], header: Sequence[str], upper: Sequence[str], body: Sequence[Row]
) -> int | None:
    """Return the column of targets: that named as a position, else the first of numbers that is not an index."""
    numbers = [i for i in others if sum(i < len(cells) and looks_like_number(cells[i]) for _, cells in body) >= FEWEST]
    titles = {i: plain_words(without_unit(_title_at(i, header, upper))[0]) for i in numbers}
    plain = [i for i in numbers if titles[i].strip(". ") not in NAMES["index"] - {""}]
    counted = [i for i in plain if [_size(cells[i]) for _, cells in body if i < len(cells)][:3] == [1.0, 2.0, 3.0]]
    plain = [*(i for i in plain if i not in counted), *counted]  # a number of the position comes last
    named = [i for i in plain if titles[i] and _is_position_title(titles[i])]
    return next(iter([*named, *plain]), None)


def _runs_in_rows(raw: RawTable, at: int) -> _Matrix | None:
    """Return the matrix whose header is a row of targets, with one row for each run; None if it is no such header."""
    line, header = raw.rows[at]
    label, unit = without_unit(header[0])
    targets = [i for i, cell in enumerate(header) if i and looks_like_number(cell)]
    if len(targets) < FEWEST or looks_like_number(header[0]) or not _is_position_title(label):
        return None
    first, body, readings, left_out = targets[0], raw.rows[at + 1 :], [], []
    runs: dict[int, tuple[str, int]] = {}
    group = ""
    for number, cells in body:
        group = cells[0] or group
        run = run_in(" ".join(filter(None, [group, *cells[1:first]])))
        values = [(i, cells[i]) for i in targets if i < len(cells) and cells[i]]
        if run is None or not any(looks_like_number(value) for _, value in values):
            left_out.append((number, " ".join(filter(None, cells))))
            if not runs and len(left_out) > MOST_BEFORE:
                return None
            continue
        if run in runs.values():
            return None
        runs[number] = run
        readings += [(number, header[i], {number: value}) for i, value in values]
    if len(runs) < FEWEST:
        return None
    title = f"{label or 'position'}" + (f" [{unit}]" if unit else "")
    return _in_rows(raw, at, line, title, "", runs, readings, left_out)


def _in_rows(
    raw: RawTable,
    titles: int,
    line: int,
    title: str,
    unit: str,
    runs: dict[int, tuple[str, int]],
    readings: Sequence[tuple[int, str, dict[int, str]]],
    left_out: Sequence[tuple[int, str]],
) -> _Matrix | None:
    """Return one row for each reading, run by run, below the title rows of the file.

    ``unit``: unit of the readings; empty if the matrix gives none; ``runs``: number and direction of each run, by its key in the
    readings.
    """
    if len(readings) < FEWEST:
        return None
    above = raw.rows[:titles]
    text = " ".join(cell for _, cells in above for cell in cells)
    unit = unit or unit_of_deviations(text)
    small = _are_deviations(readings)
    name = ("deviation" if small else "measured") + (f" [{unit}]" if unit else "")

    def rows() -> Iterator[Row]:
        yield line, (title, RUN, DIRECTION, name)
        for key, (number, direction) in runs.items():
            for at, target, values in readings:
                if key in values:
                    value = "" if is_no_value(values[key]) else values[key]
                    yield at, (target, number, "+" if direction > 0 else "-" if direction < 0 else "0", value)

    return _Matrix((*above, *rows()), tuple(left_out))


def _are_deviations(readings: Sequence[tuple[int, str, dict[int, str]]]) -> bool:
    """Return whether the readings do not follow the targets: some are farther from them than a hundredth of the largest."""
    pairs = [(_size(target), _size(value)) for _, target, values in readings for value in values.values()]
    most = max(abs(target) for target, _ in pairs)
    return any(abs(value - target) > NEAR * most for target, value in pairs)


def _size(cell: str) -> float:
    """Return a number with whatever decimal sign, to see how large it is; zero for other cells."""
    numbers = [quantity_in(cell, sign) for sign in (COMMA if "," in cell else POINT, POINT)]
    return next((float(number.value) for number in numbers if number is not None), 0.0)
