"""Agreement of commands and readings: rows that do not fit, and columns that are swapped, of wrong sign or in another unit.

The nominal machine and a robustly estimated set-up predict every reading. If the readings do not follow the commands, single changes of
the columns are tried on some of the rows, and those after which they do are reported. A mirrored reading and a mirrored linear command
differ by a rotation of the station: which of them is wrong is not determined, except by a station that is aligned with the machine's
axes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.messages import Message
from twin._common.units import MM, count_with_noun
from twin.machine.machine import Axis, Machine
from twin.measurement.columns import CARRIERS, POINT_COLUMNS, SYSTEMATIC_ROWS, RowNote, axis_columns, outside_axis_range
from twin.measurement.instruments import SIDES, StationInstruments, default_instrument
from twin.measurement.observation import CarriedTargets, nominal_carriers
from twin.measurement.set_up import LARGEST_MISFIT_M, StationsAndTargets, initial_setup
from twin.measurement.table import Measurements

WRONG_COLUMN_SHARE: Final = 0.2
"""Share of rows with misfits of centimetres above which a column is wrong, not single rows."""
SUSPECT_COLUMN_SHARE: Final = 0.02
"""Share of such rows above which swapped or mirrored columns are tried."""
NOMINAL_SHARE: Final = 0.01
"""Largest deviation of a machine from its nominal geometry, as a share of the measured motion."""
OUTLYING_FACTOR: Final = 10.0
"""Multiple of the median misfit above which a row is wrong."""
SUSPECT_RATIO: Final = 0.1
"""Ratio of misfit to motion above which other units are tried."""
UNRELATED_RATIO: Final = 0.5
"""Ratio of misfit to motion above which the readings do not follow the commands at all."""
CLEAR_MOTION_M: Final = 5e-4
"""Motion, m, below which drift and noise may be as large, so that readings need not follow the commands."""
LEAST_MOTION_M: Final = 1e-5
"""Motion, m, below which readings are not compared with commands."""
GOOD_RATIO: Final = 0.05
"""Ratio of misfit to motion below which a change of unit explains the readings."""
IMPROVEMENT: Final = 5.0
"""Factor by which a change must reduce the misfit, or the number of wrong rows, to be reported."""
TRIAL_ROWS: Final = 200
"""Number of rows on which changes of columns are tried."""
SHOWN_MM: Final = 0.5
"""Mean misfit on a side, mm, above which a target does not sit there."""
STILL_MM: Final = 0.05
"""Mean misfit, mm, up to which a target stands still."""
FEWEST_ROWS: Final = 8
"""Number of rows of a station below which its columns are not judged."""
MOST_FINDINGS: Final = 3
"""Number of changes that are found one after the other in the rows of a station."""
ALIGNED: Final = 0.25
"""Largest deviation of a rotation from identity up to which a station counts as aligned with the machine's axes."""
UNITS: Final = (("metres", "m", 1000.0), ("inches", "inch", 25.4))
READING_UNITS: Final = (*UNITS, ("micrometres", "um", 1e-3), ("centimetres", "cm", 10.0))
RADIANS: Final = ("radians", "rad", 180.0 / np.pi)
"""Units that are tried: in words, as a mapping file names them, factor to mm or degrees."""


class ColumnChange(NamedTuple):
    """A change of the columns of a table: two exchanged, some multiplied by a factor, targets on the other side.

    Attributes:
        field: ``positions`` or ``point_mm``.
        columns: names of the columns that change.
        text: what seems to be wrong with them.
        advice: comment for the entries of these columns in a mapping file.
        exchanged: indices of the two columns that are exchanged; empty for none.
        factors: factor of each column that is multiplied, by its index.
        sides: side of the machine for targets that sit on another.
    """

    field: str
    columns: tuple[str, ...] = ()
    text: str = ""
    advice: str = ""
    exchanged: tuple[int, ...] = ()
    factors: Mapping[int, float] = MappingProxyType({})
    sides: Mapping[str, str] = MappingProxyType({})

    def of(self, data: Measurements) -> Measurements:
        """Return the changed data."""
        if self.sides:
            carrier = [self.sides.get(name, own) for name, own in zip(data.target, data.carrier, strict=True)]
            data = replace(data, carrier=read_only(np.array(carrier, dtype=object)))
        values = np.array(getattr(data, self.field))
        values[:, self.exchanged] = values[:, self.exchanged[::-1]]
        for i, factor in self.factors.items():
            values[:, i] *= factor
        changed: dict[str, Any] = {self.field: read_only(values)}
        return replace(data, **changed)


class Agreement(NamedTuple):
    """Agreement of readings with commands on the nominal machine.

    ``miss``: (n,) misfit of each reading, metres; ``limit``: misfit above which a row is wrong, metres; ``motion``: largest motion of a
    target, metres.
    """

    setup: StationsAndTargets
    miss: np.ndarray
    limit: float
    ratio: float
    motion: float

    @property
    def share(self) -> float:
        """Share of wrong rows."""
        return float(np.mean(self.miss > self.limit))

    @property
    def rms_mm(self) -> float:
        """RMS misfit."""
        return float(np.sqrt(np.mean(self.miss**2))) / MM

    @property
    def is_suspect(self) -> bool:
        """Whether a column may be wrong."""
        return self.share > SUSPECT_COLUMN_SHARE or self.ratio > SUSPECT_RATIO


def fit_of(
    machine: Machine,
    data: Measurements,
    instruments: StationInstruments,
    carried: CarriedTargets | None = None,
    *,
    mirrored: bool = False,
) -> Agreement:
    """Return the agreement of some data; arguments and errors as `initial_setup`."""
    carried = nominal_carriers(machine, data) if carried is None else carried
    setup, miss = initial_setup(data, instruments, carried, mirrored=mirrored)
    return Agreement(setup, miss, miss_limit(data, miss), *misfit_ratio(machine, data, carried, setup, miss))


def agreeing_rows(
    machine: Machine, data: Measurements, instruments: StationInstruments, carried: CarriedTargets | None = None
) -> tuple[Measurements, StationsAndTargets]:
    """Return the rows whose command agrees with the measured motion, and the set-up estimated with the nominal machine.

    ``carried``: carriers of the rows on the nominal machine; computed if None.

    Raises `InputError`: more than a fifth of the rows do not agree, or fewer that agree after one change of the columns, or readings
    that do not follow the commands; with the change that would make them agree, if there is one.
    """
    follows = f"readings that follow the commands of {machine.name}"
    try:
        fit = fit_of(machine, data, instruments, carried)
    except InputError:
        # Readings in a left-handed frame may be due to one wrong command column; if several would explain them, the frame is wrong.
        texts = [change.text for change in _one_change(machine, data, 1.0, np.inf, instruments)]
        if len(texts) != 1:
            raise
        raise data.error(f"commands and readings do not agree: {texts[0]}", expected=follows, row=0) from None
    bad = fit.miss > fit.limit
    changes = _one_change(machine, data, fit.share, fit.ratio, instruments) if fit.is_suspect else []
    unrelated = fit.ratio > UNRELATED_RATIO and fit.motion > CLEAR_MOTION_M
    if changes or fit.share > WRONG_COLUMN_SHARE or unrelated:
        worst = int(np.argmax(fit.miss))
        raise data.error(
            f"commands and readings do not agree: {changes[0].text if changes else _description(machine, data, fit)}",
            expected=f"{follows} within {min(fit.limit, fit.motion) / MM:.2g} mm",
            row=worst,
            value=f"deviation {fit.miss[worst] / MM:.3g} mm",
        )
    if not np.any(bad):
        return data, fit.setup
    set_aside = (*data.set_aside, *_notes_of_disagreement(data, bad, fit.miss))
    agreeing = replace(data.select(~bad), set_aside=set_aside)
    if set(agreeing.target) != set(data.target) or set(agreeing.station) != set(data.station):
        without_rows = sorted({*data.target, *data.station} - {*agreeing.target, *agreeing.station})
        raise data.error(
            f"no reading of {', '.join(without_rows)} agrees with its command",
            expected="readings that follow the commands",
            row=np.flatnonzero(bad)[0],
        )
    return agreeing, initial_setup(agreeing, instruments, nominal_carriers(machine, agreeing))[0]


def _notes_of_disagreement(data: Measurements, bad: np.ndarray, miss: np.ndarray) -> tuple[RowNote, ...]:
    """Return a note for each of the bad rows."""
    causes = Message("wrong position, wrong target or lost beam")
    return tuple(
        RowNote(
            int(data.lines[row]),
            Message(
                "the reading disagrees with the command by {distance:.1f} mm (target {target}, round {round}): {causes}",
                distance=miss[row] / MM,
                target=data.target[row],
                round=data.round[row],
                causes=causes,
            ),
            kind=Message("the reading disagrees with the command: {causes}", causes=causes),
            size=float(miss[row]),
        )
        for row in np.flatnonzero(bad)
    )


def miss_limit(data: Measurements, miss: np.ndarray) -> float:
    """Return the largest misfit with the nominal machine that is accepted, metres.

    A machine that differs from its nominal geometry everywhere (an uncalibrated robot) has misfits of millimetres in every row,
    of similar size; wrong rows stand out from them. A median misfit that is a large part of the motion is neither case.
    """
    typical = float(np.median(miss))
    read = data.point_mm[:, np.isfinite(data.point_mm).any(axis=0)]
    span = float(np.linalg.norm(np.nanmax(read, axis=0) - np.nanmin(read, axis=0))) * MM
    return max(LARGEST_MISFIT_M, OUTLYING_FACTOR * typical) if typical < NOMINAL_SHARE * span else LARGEST_MISFIT_M


def misfit_ratio(
    machine: Machine, data: Measurements, carried: CarriedTargets, setup: StationsAndTargets, miss: np.ndarray
) -> tuple[float, float]:
    """Return mean misfit over mean commanded motion of the targets (for lengths, over their change), and the largest motion.

    A row's misfit is limited to the largest motion, so that a lost beam does not dominate. Zero if hardly anything moves. Metres.
    """
    station, target = setup.indices(data)
    points = carried.at(setup.place[target])
    kind = np.array([read.reads for read in setup.reads])[station]
    lengths = np.zeros_like(points)
    lengths[:, 0] = np.nan_to_num(data.point_mm[:, 0]) * MM
    points = np.where((kind == "length")[:, None], lengths, points)
    if np.any(kind == "null"):  # the target is always at the station's origin: the motion is that of the linear axes
        linear = np.array([axis.linear for axis in machine.axes])
        travel = np.linalg.norm(np.where(linear, data.positions - np.median(data.positions, axis=0), 0.0), axis=1) * MM
        points = np.where((kind == "null")[:, None], travel[:, None] * np.array([1.0, 0.0, 0.0]), points)
    moved = np.empty(len(points))
    for station, target in dict.fromkeys(zip(data.station, data.target, strict=True)):
        rows = (data.station == station) & (data.target == target)
        moved[rows] = np.linalg.norm(points[rows] - np.median(points[rows], axis=0), axis=1)
    largest = float(moved.max())
    if largest <= LEAST_MOTION_M:
        return 0.0, largest
    return float(np.minimum(miss, largest).sum() / moved.sum()), largest


def other_unit(machine: Machine, data: Measurements, instruments: StationInstruments) -> str | None:
    """Return, in words, which columns would agree in another unit; None if none would, or if all agree as given."""
    try:
        ratio = fit_of(machine, data, instruments).ratio
    except InputError:
        return None
    changes = _in_units(machine, data, 1.0, ratio, instruments) if ratio > SUSPECT_RATIO else []
    return changes[0].text if changes else None


def wrong_columns(machine: Machine, data: Measurements) -> list[ColumnChange]:
    """Return a change for each sign, order or unit of columns that seems to be wrong; empty if the data show none.

    ``data``: a table before it is checked: NaN, unknown sides and positions outside the ranges of their axes are allowed.
    """
    names = [*axis_columns(machine)]
    wrong = [
        ColumnChange("positions", (names[i],), text, "sign: -1?", factors={i: -1.0})
        for i, q in enumerate(data.positions.T)
        if (text := _mirrored_by_range(machine.axes[i], q))
    ]
    sides = np.isin(data.carrier, CARRIERS) & np.isin(data.station_carrier, SIDES)
    data = data.select(np.isfinite(data.positions).all(axis=1) & np.isfinite(data.point_mm).all(axis=1) & sides)
    for change in wrong:
        data = change.of(data)
    stations = list(dict.fromkeys(data.station))
    for station in stations:
        own = _wrong_columns_of_station(machine, data.select(data.station == station))
        wrong += [one._replace(text=f"station {station}: {one.text}") if len(stations) > 1 else one for one in own]
    return wrong


class TargetSide(NamedTuple):
    """Side of the machine on which a target follows the commands.

    ``carrier``: the side; empty if the readings do not show it; ``misfit_mm``: mean misfit on this side; the smaller one if they do
    not.
    """

    carrier: str
    misfit_mm: float
    other_misfit_mm: float


def sides_of_targets(machine: Machine, data: Measurements) -> dict[str, TargetSide]:
    """Return the side on which each target follows the commands: of both, each tried alone and then with the targets that are clear.

    ``data``: a table before it is checked: NaN and unknown sides are allowed; Stations ride on the base.
    """
    data = data.select(np.isfinite(data.positions).all(axis=1) & np.isfinite(data.point_mm).all(axis=1))
    rows = {target: _spread(np.flatnonzero(data.target == target)) for target in dict.fromkeys(data.target)}
    sides = {target: _side(machine, data.select(some), np.ones(len(some), dtype=bool)) for target, some in rows.items()}
    clear = {target: side.carrier for target, side in sides.items() if side.carrier}
    for target in (target for target in rows if target not in clear and clear):
        stations = {*data.station[data.target == target]}
        others = [
            rows[other][:: max(1, len(clear) // 3)]
            for other in clear
            if {*data.station[data.target == other]} & stations
        ]
        if others:
            tried = data.select(np.concatenate([rows[target], *others]))
            carrier = np.array([clear.get(name, "") for name in tried.target], dtype=object)
            sides[target] = _side(machine, replace(tried, carrier=carrier), tried.target == target)
    return sides


def _spread(rows: np.ndarray) -> np.ndarray:
    return rows[np.linspace(0, len(rows) - 1, min(len(rows), TRIAL_ROWS)).astype(int)]


def _side(machine: Machine, data: Measurements, rows: np.ndarray) -> TargetSide:
    """Return the side of some rows: that on which their mean misfit is several times smaller, and smaller than a wrong row's."""
    instruments = StationInstruments.same(default_instrument("point"), data.station)
    misfits, follows = {}, {}
    for side in CARRIERS:
        tried = replace(data, carrier=read_only(np.where(rows, side, data.carrier)))
        try:
            fit = fit_of(machine, tried, instruments, mirrored=True)
        except InputError:
            return TargetSide("", np.inf, np.inf)
        misfits[side] = float(np.mean(fit.miss[rows])) / MM
        # A target that stands still must be read so: readings in metres stand still as well, nearly.
        follows[side] = fit.ratio < GOOD_RATIO if fit.motion > CLEAR_MOTION_M else misfits[side] < STILL_MM
    best, other = sorted(CARRIERS, key=lambda side: misfits[side])
    shown = follows[best] and misfits[best] * IMPROVEMENT < misfits[other] and misfits[other] > SHOWN_MM
    return TargetSide(best if shown else "", misfits[best], misfits[other])


def _other_sides(machine: Machine, data: Measurements) -> Iterator[ColumnChange]:
    """Yield the change that puts targets on the side on which they follow the commands."""
    if not (data.station_carrier == SIDES[0]).all():
        return
    given = dict(zip(data.target, data.carrier, strict=True))
    sides = {
        target: side.carrier
        for target, side in sides_of_targets(machine, data).items()
        if side.carrier and side.carrier != given[target]
    }
    texts = []
    for side, other in (CARRIERS, CARRIERS[::-1]):
        names = [str(target) for target, own in sides.items() if own == side]
        if names:
            texts.append(
                f"{', '.join(names)} {'sit' if len(names) > 1 else 'sits'} on the {side} side, not on the {other} side"
            )
    if texts:
        yield ColumnChange("positions", ("carrier",), "; ".join(texts), "which side?", sides=sides)


def _mirrored_by_range(axis: Axis, q: np.ndarray) -> str:
    """Return a sentence if the positions of an axis are within its range with the opposite sign only; empty otherwise."""
    q = q[np.isfinite(q)]
    count = np.count_nonzero(outside_axis_range(axis, q))
    if len(q) < SYSTEMATIC_ROWS or not count or 2 * count < len(q) or np.any(outside_axis_range(axis, -q)):
        return ""
    return (
        f"{axis.name} seems to be mirrored: {count} of {count_with_noun(len(q), 'row')} are outside the range of {axis.name}, "
        f"{axis.lower:g} … {axis.upper:g} {axis.unit}, and none with −{axis.name}"
    )


def _wrong_columns_of_station(machine: Machine, data: Measurements) -> list[ColumnChange]:
    """Return the changes after which the points of one station agree with the commands, found one after the other."""
    wrong: list[ColumnChange] = []
    instruments = StationInstruments.same(default_instrument("point"), data.station)
    while len(data) >= FEWEST_ROWS and np.any(data.point_mm) and len(wrong) < MOST_FINDINGS:
        try:
            before = fit_of(machine, data, instruments, mirrored=True)
        except InputError:
            break
        if not before.is_suspect:
            break
        mirror = ColumnChange("point_mm", factors={0: -1.0})
        tried = _other_sides(machine, data), [mirror], _swapped_or_mirrored(machine, data), _two_mirrored(machine, data)
        changes = _one_change(machine, data, before.share, before.ratio, instruments, tried)
        negated = not changes
        if negated:  # mirrored readings agree in no unit: the unit is sought with one column negated, and the mirror is found next
            changes = _in_units(machine, mirror.of(data), before.share, before.ratio, instruments)
        if not changes:
            break
        data = changes[0].of(data)
        after = fit_of(machine, mirror.of(data) if negated else data, instruments)
        change = _mirror(after) if changes[0] is mirror else changes[0]
        size = f"RMS residual {after.rms_mm:.3g} mm instead of {before.rms_mm:.3g} mm"
        size += ", with one column negated" if negated else ""
        wrong.append(change._replace(text=f"{change.text}; {size}"))
    return wrong


def _mirror(after: Agreement) -> ColumnChange:
    """Return the change that mirrors readings, named by its column if the station is then aligned with the machine's axes.

    ``after``: the fit of the readings with −x.
    """
    agreeing = np.count_nonzero(after.miss <= after.limit)
    rows = f"{agreeing} of {count_with_noun(len(after.miss), 'row')} agree"
    turn = after.setup.rotation[0] @ np.diag([-1.0, 1.0, 1.0])
    for i, name in enumerate("xyz"):
        if np.max(np.abs(turn * np.where(np.arange(3) == i, -1.0, 1.0) - np.eye(3))) < ALIGNED:
            text = f"{name} seems to be mirrored: {rows} with −{name}"
            return ColumnChange("point_mm", (POINT_COLUMNS[i],), text, "sign: -1?", factors={i: -1.0})
    for i, j in combinations(range(3), 2):
        order = [j if k == i else i if k == j else k for k in range(3)]
        if np.max(np.abs(turn[:, order] - np.eye(3))) < ALIGNED:
            text = f"{'xyz'[i]} and {'xyz'[j]} seem to be exchanged: {rows} with exchanged columns"
            return ColumnChange("point_mm", (POINT_COLUMNS[i], POINT_COLUMNS[j]), text, "exchanged?", (i, j))
    text = (
        f"the coordinates seem to be mirrored: {rows} in a frame of the other hand. The data do not show which one: one "
        "of x, y, z (or of the commanded linear axes) has the opposite sign, or two are exchanged"
    )
    return ColumnChange("point_mm", POINT_COLUMNS, text, "sign: -1 on one of them?", factors={0: -1.0})


def _one_change(
    machine: Machine,
    data: Measurements,
    share: float,
    ratio: float,
    instruments: StationInstruments,
    families: Sequence[Iterable[ColumnChange]] = (),
) -> list[ColumnChange]:
    """Return the changes that make the readings agree, the best first: commands swapped or of opposite sign, columns in another unit.

    ``families``: changes, each family tried if none before explains the readings; `_swapped_or_mirrored` if there are none.
    """

    def explains(fit: Agreement) -> bool:
        if share > SUSPECT_COLUMN_SHARE:
            return fit.share < share / IMPROVEMENT
        return fit.ratio < min(GOOD_RATIO, ratio / IMPROVEMENT)

    for changes in families or (_other_sides(machine, data), _swapped_or_mirrored(machine, data)):
        explaining = _explaining(machine, data, changes, explains, instruments)
        if explaining:
            return [change for _, change in sorted(explaining, key=lambda one: one[0])]
    return _in_units(machine, data, share, ratio, instruments)


def _in_units(
    machine: Machine, data: Measurements, share: float, ratio: float, instruments: StationInstruments
) -> list[ColumnChange]:
    """Return the change of unit that explains the readings, as `_one_change`; equivalent changes are joined in its text."""

    def explains(fit: Agreement) -> bool:
        return fit.ratio < min(GOOD_RATIO, ratio / IMPROVEMENT) and fit.share <= share / IMPROVEMENT

    for single in (False, True):
        explaining = _explaining(machine, data, _units(machine, data, single=single), explains, instruments)
        if explaining:
            best = min(explaining, key=lambda one: one[0])
            texts = [change.text for size, change in explaining if size <= 2.0 * best[0]]
            return [best[1]._replace(text=", or ".join(texts))]
    return []


def _explaining(
    machine: Machine,
    data: Measurements,
    changes: Iterable[ColumnChange],
    explains: Callable[[Agreement], bool],
    instruments: StationInstruments,
) -> list[tuple[float, ColumnChange]]:
    """Return the changes after which some rows agree, each with misfit over motion."""
    explaining = []
    rows = data.select(_spread(np.arange(len(data))))
    for change in changes:
        try:
            fit = fit_of(machine, change.of(rows), instruments)
        except InputError:  # no station can be placed
            continue
        # Swapped with an axis that did not move, anything fits.
        if fit.motion > LEAST_MOTION_M and explains(fit):
            explaining.append((fit.ratio, change))
    return explaining


def _swapped_or_mirrored(machine: Machine, data: Measurements) -> Iterator[ColumnChange]:
    """Yield the changes that swap two command columns, and those that reverse the sign of one."""
    names, moving = [*axis_columns(machine)], _moving(data)
    for i, j in combinations(range(len(names)), 2):
        if i in moving or j in moving:
            text = f"columns {names[i]} and {names[j]} look swapped"
            yield ColumnChange("positions", (names[i], names[j]), text, "exchanged?", (i, j))
    for i in moving:
        text = f"column {names[i]} appears to have the wrong sign"
        yield ColumnChange("positions", (names[i],), text, "sign: -1?", factors={i: -1.0})


def _two_mirrored(machine: Machine, data: Measurements) -> Iterator[ColumnChange]:
    """Yield the changes that reverse the signs of two rotary axes."""
    names = [*axis_columns(machine)]
    for i, j in combinations([i for i in _moving(data) if not machine.axes[i].linear], 2):
        text = f"columns {names[i]} and {names[j]} appear to have the wrong sign"
        yield ColumnChange("positions", (names[i], names[j]), text, "sign: -1?", factors={i: -1.0, j: -1.0})


def _units(machine: Machine, data: Measurements, *, single: bool) -> Iterator[ColumnChange]:
    """Yield the changes that convert commands or readings from another unit: single columns, or all columns."""
    names, moving = [*axis_columns(machine)], _moving(data)
    linear = [i for i in moving if machine.axes[i].linear]
    rotary = [i for i in moving if not machine.axes[i].linear]
    read = [i for i in range(3) if np.isfinite(data.point_mm[:, i]).any()]
    tried = [
        *(("positions", names, linear, unit) for unit in UNITS),
        ("positions", names, rotary, RADIANS),
        *(("point_mm", POINT_COLUMNS, read, unit) for unit in READING_UNITS),
    ]
    for field, labels, columns, (unit, word, factor) in tried:
        groups = [[i] for i in columns] if single and len(columns) > 1 else [] if single or not columns else [columns]
        for some in groups:
            if field == "positions" and any(
                np.any(outside_axis_range(machine.axes[i], data.positions[:, i] * factor)) for i in some
            ):
                continue
            named = tuple(labels[i] for i in some)
            look = f"columns {', '.join(named)} look" if len(named) > 1 else f"column {named[0]} looks"
            meant = "degrees" if unit == RADIANS[0] else "millimetres"
            text = f"{look} like {unit}, not {meant} (factor {factor:.4g})"
            yield ColumnChange(field, named, text, f"unit: {word}?", factors=dict.fromkeys(some, factor))


def _description(machine: Machine, data: Measurements, fit: Agreement) -> str:
    """Return the share of wrong rows, and the axis whose motion most of them share, in words."""
    if fit.share <= WRONG_COLUMN_SHARE:
        return "the readings change, but not as the commands do"
    by_axis = [
        (float(np.median(fit.miss[data.positions[:, i] != np.median(data.positions[:, i])])), i) for i in _moving(data)
    ]
    axis = [*axis_columns(machine)][max(by_axis, default=(0.0, 0))[1]]
    return f"{fit.share:.0%} of the readings deviate by more than {fit.limit / MM:.2g} mm, mostly where {axis} changes"


def _moving(data: Measurements) -> list[int]:
    return [i for i in range(data.positions.shape[1]) if np.ptp(data.positions[:, i]) > 0.0]
