"""Commands against the measured motion: rows that do not fit, and columns that are swapped, mirrored or in another unit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import Any, Final

import numpy as np

from twin._common.arrays import locked
from twin._common.errors import InputError
from twin._common.units import MM
from twin.identification.setup import SetUp
from twin.identification.start import FITS, first_setup, nominal
from twin.machine.machine import Machine
from twin.measurement.checks import RowNote, outside
from twin.measurement.table import POINT_COLUMNS, Measurements

SWAPPED: Final = 0.2
"""Share of rows that miss by centimetres beyond which it is not rows but columns."""
ASKED: Final = 0.02
"""Share beyond which it is asked whether it is columns."""
DRAWN: Final = 0.01
"""Share of the measured motion that a machine may differ from its drawing by."""
STANDS_OUT: Final = 10.0
"""Times the typical miss beyond which a row does not belong."""
DOUBTED: Final = 0.1
"""Misfit over motion beyond which it is asked whether a column is in another unit."""
UNRELATED: Final = 0.5
"""Misfit over motion beyond which readings do not follow the commands at all."""
SEEN: Final = 5e-4
"""m: motion below which drifts and noise may be as large, so that readings may differ from the commands altogether."""
STILL: Final = 1e-5
"""m: motion below which nothing is asked of the readings."""
CLOSE: Final = 0.05
"""Misfit over motion below which a change of unit explains the readings."""
LESS: Final = 5.0
"""Factor by which a change must reduce misfit, or rows that miss, to be named."""
MOST_ROWS: Final = 200
"""Rows on which changes of columns are tried."""
UNITS: Final = (("metres", 1000.0), ("inches", 25.4))
RADIANS: Final = 180.0 / np.pi
Change = tuple[Measurements, str]


def fitting(machine: Machine, data: Measurements, *, lengths_only: bool) -> tuple[Measurements, SetUp]:
    """Return the rows whose command fits the measured motion, and the set-up as it follows from the machine as drawn.

    Args:
        machine: the machine.
        data: the measurements.
        lengths_only: whether only lengths were read.

    Raises:
        InputError: more than a fifth of the rows do not fit, or fewer that one change of the columns would make fit, or readings that
            do not follow the commands; with the change that would make them fit, where there is one.
    """
    try:
        setup, miss = first_setup(machine, data, lengths_only=lengths_only)
    except InputError:
        # A machine seen as in a mirror may be one command column that is wrong; several that would do are the mirror itself.
        likely = _one_change(machine, data, 1.0, np.inf, lengths_only)
        if len(likely) != 1:
            raise
        raise data.error(
            f"the commands do not fit the measured motion: {likely[0][1]}",
            expected=f"commands that the readings follow on {machine.name}",
            row=0,
        ) from None
    limit = miss_limit(data, miss)
    bad = miss > limit
    share = float(np.mean(bad))
    ratio, motion = misfit_ratio(machine, data, setup, miss)
    likely = _one_change(machine, data, share, ratio, lengths_only) if share > ASKED or ratio > DOUBTED else []
    if likely or share > SWAPPED or (ratio > UNRELATED and motion > SEEN):
        worst = int(np.argmax(miss))
        raise data.error(
            f"the commands do not fit the measured motion: {min(likely)[1] if likely else _where(machine, data, miss, limit)}",
            expected=f"commands that the readings follow within {min(limit, motion) / MM:.2g} mm on {machine.name}",
            row=worst,
            value=f"{miss[worst] / MM:.3g} mm off",
        )
    if not np.any(bad):
        return data, setup
    kind = "the commanded position misses the measured motion: another position, another target or a lost beam"
    notes = tuple(
        RowNote(
            int(data.lines[row]),
            f"the commanded position misses the measured motion by {miss[row] / MM:.1f} mm (target {data.target[row]}, "
            f"round {data.round[row]}): another position, another target or a lost beam",
            kind=kind,
            size=float(miss[row]),
        )
        for row in np.flatnonzero(bad)
    )
    left = replace(data.select(~bad), set_aside=(*data.set_aside, *notes))
    if set(left.target) != set(data.target) or set(left.station) != set(data.station):
        lost = sorted({*data.target, *data.station} - {*left.target, *left.station})
        raise InputError(
            f"no reading of {', '.join(lost)} fits the commands",
            expected="commands that the readings follow",
            file=data.source,
            line=notes[0].line,
        )
    return left, first_setup(machine, left, lengths_only=lengths_only)[0]


def miss_limit(data: Measurements, miss: np.ndarray) -> float:
    """How far a reading may be from the machine as drawn, metres.

    A machine drawn a little wrong everywhere (a robot before its calibration) misses by millimetres in every row, by about as much in
    each; rows that do not belong stand out from the others. A typical miss that is no small part of the motion is neither.
    """
    typical = float(np.median(miss))
    read = data.point_mm[:, np.isfinite(data.point_mm).any(axis=0)]
    span = float(np.linalg.norm(np.nanmax(read, axis=0) - np.nanmin(read, axis=0))) * MM
    return max(FITS, STANDS_OUT * typical) if typical < DRAWN * span else FITS


def misfit_ratio(machine: Machine, data: Measurements, setup: SetUp, miss: np.ndarray) -> tuple[float, float]:
    """Return the mean misfit over the mean commanded motion of the targets (of lengths, over their own change), and the largest motion.

    A single row counts with the whole motion at most: a lost beam is no misfit of the others. Zero where hardly anything moves. Metres.
    """
    carried = nominal(machine, data)
    index = {name: i for i, name in enumerate(setup.targets)}
    place = setup.place[[index[name] for name in data.target]]
    points = carried.points + np.einsum("nij,nj->ni", carried.rotation, place)
    if setup.lengths_only:
        points = np.nan_to_num(data.point_mm[:, :1]) * MM
    moved = np.empty(len(points))
    for station, target in dict.fromkeys(zip(data.station, data.target, strict=True)):
        rows = (data.station == station) & (data.target == target)
        moved[rows] = np.linalg.norm(points[rows] - np.median(points[rows], axis=0), axis=1)
    largest = float(moved.max())
    if largest <= STILL:
        return 0.0, largest
    return float(np.minimum(miss, largest).sum() / moved.sum()), largest


def other_unit(machine: Machine, data: Measurements, *, lengths_only: bool) -> str | None:
    """Return which columns would fit in another unit, in words; None if none would, or if all fit as they are."""
    try:
        setup, miss = first_setup(machine, data, lengths_only=lengths_only)
    except InputError:
        return None
    ratio = misfit_ratio(machine, data, setup, miss)[0]
    likely = _in_units(machine, _few(data), 1.0, ratio, lengths_only) if ratio > DOUBTED else []
    return likely[0][1] if likely else None


def _one_change(
    machine: Machine, data: Measurements, share: float, ratio: float, lengths_only: bool
) -> list[tuple[float, str]]:
    """Return what would make the readings fit: two columns swapped, one with the other sign, some in another unit.

    Args:
        machine: the machine.
        data: the measurements.
        share: of rows that do not fit.
        ratio: misfit over motion.
        lengths_only: whether only lengths were read.

    Returns:
        Misfit over motion, and words of each.
    """
    few = _few(data)
    found = []
    for changed, text in _mixed_up(machine, few):
        after = _after(machine, changed, lengths_only)
        if after is not None and (after[1] < share / LESS if share > ASKED else after[0] < min(CLOSE, ratio / LESS)):
            found.append((after[0], text))
    return found or _in_units(machine, few, share, ratio, lengths_only)


def _in_units(
    machine: Machine, data: Measurements, share: float, ratio: float, lengths_only: bool
) -> list[tuple[float, str]]:
    """Return the change of unit that explains the readings, as `_one_change`; changes that do it alike stand together in its words."""
    for single in (False, True):
        found = []
        for changed, text in _units(machine, data, single=single):
            after = _after(machine, changed, lengths_only)
            if after is not None and after[0] < min(CLOSE, ratio / LESS) and after[1] <= share / LESS:
                found.append((after[0], text))
        if found:
            best = min(size for size, _ in found)
            return [(best, ", or ".join(text for size, text in found if size <= 2.0 * best))]
    return []


def _after(machine: Machine, changed: Measurements, lengths_only: bool) -> tuple[float, float] | None:
    """Return misfit over motion and the share of rows that miss; None where no station can be placed, or nothing moves."""
    try:
        setup, miss = first_setup(machine, changed, lengths_only=lengths_only)
    except InputError:
        return None
    ratio, motion = misfit_ratio(machine, changed, setup, miss)
    if motion <= STILL:
        return None  # a swap with an axis that stood still: without motion anything fits
    return ratio, float(np.mean(miss > miss_limit(changed, miss)))


def _few(data: Measurements) -> Measurements:
    """Rows to try changes on, spread over the table."""
    return data.select(np.linspace(0, len(data) - 1, min(len(data), MOST_ROWS)).astype(int))


def _mixed_up(machine: Machine, data: Measurements) -> Iterator[Change]:
    """The data with two command columns swapped, and with the sign of one turned."""
    names, moving = _columns(machine), _moving(data)
    for i, j in combinations(range(len(names)), 2):
        if i in moving or j in moving:
            swapped = np.array(data.positions)
            swapped[:, [i, j]] = swapped[:, [j, i]]
            yield replace(data, positions=locked(swapped)), f"columns {names[i]} and {names[j]} look swapped"
    for i in moving:
        yield _scaled(data, "positions", [i], -1.0), f"column {names[i]} looks as if its sign were wrong"


def _units(machine: Machine, data: Measurements, *, single: bool) -> Iterator[Change]:
    """The data with commands or readings as they would be if they had been written in another unit: a single column, or all alike."""
    names, moving = _columns(machine), _moving(data)
    linear = [i for i in moving if machine.axes[i].linear]
    rotary = [i for i in moving if not machine.axes[i].linear]
    for columns, unit, factor in (*((linear, *unit) for unit in UNITS), (rotary, "radians", RADIANS)):
        for some in _chosen(columns, single):
            changed = _scaled(data, "positions", some, factor)
            if not any(np.any(outside(machine.axes[i], changed.positions[:, i])) for i in some):
                yield changed, _unit_text([names[i] for i in some], unit, factor)
    read = [i for i in range(3) if np.isfinite(data.point_mm[:, i]).any()]
    for unit, factor in (*UNITS, ("micrometres", 1e-3)):
        for some in _chosen(read, single):
            yield _scaled(data, "point_mm", some, factor), _unit_text([POINT_COLUMNS[i] for i in some], unit, factor)


def _scaled(data: Measurements, field: str, columns: list[int], factor: float) -> Measurements:
    values = np.array(getattr(data, field))
    values[:, columns] *= factor
    changed: dict[str, Any] = {field: locked(values)}
    return replace(data, **changed)


def _chosen(columns: list[int], single: bool) -> list[list[int]]:
    """Each column of several by itself, or all together."""
    if single:
        return [[one] for one in columns] if len(columns) > 1 else []
    return [columns] if columns else []


def _unit_text(names: list[str], unit: str, factor: float) -> str:
    meant = "degrees" if unit == "radians" else "millimetres"
    look = f"columns {', '.join(names)} look" if len(names) > 1 else f"column {names[0]} looks"
    return f"{look} like {unit}, not {meant} (factor {factor:.4g})"


def _where(machine: Machine, data: Measurements, miss: np.ndarray, limit: float) -> str:
    """How many rows miss, and the motion of which axis most of them share."""
    by_axis = [
        (float(np.median(miss[data.positions[:, i] != np.median(data.positions[:, i])])), i) for i in _moving(data)
    ]
    _, worst = max(by_axis, default=(0.0, 0))
    share = float(np.mean(miss > limit))
    if share <= SWAPPED:
        return "the readings change, but not as the commands do"
    return f"{share:.0%} of all readings are more than {limit / MM:.2g} mm off, most where {_columns(machine)[worst]} moves"


def _columns(machine: Machine) -> list[str]:
    return [f"{axis.name}_{axis.unit}" for axis in machine.axes]


def _moving(data: Measurements) -> list[int]:
    return [i for i in range(data.positions.shape[1]) if np.ptp(data.positions[:, i]) > 0.0]
