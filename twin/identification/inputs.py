"""What a table of readings must be before anything is fitted to it: live sensors, known columns, commands that fit."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from twin._common.errors import InputError
from twin._common.units import MM
from twin.identification.fitting import SWAPPED, fitting, miss_limit, other_unit
from twin.identification.setup import SetUp
from twin.identification.start import first_setup, nominal
from twin.machine.machine import Machine
from twin.measurement.checks import ASSUMED
from twin.measurement.instruments import Instrument, usual
from twin.measurement.table import POINT_COLUMNS, Measurements

FEWEST_ROWS: Final = 3
"""Equal readings that are no coincidence."""
DEAD: Final = 1e-4
"""m: motion that a sensor must show. Gauges for machine tools have steps of 0.01 mm at most."""
IN_LINE: Final = 0.01
"""Width over length below which points are on a line, which has no sides."""
HARDLY_MOVES: Final = 1e-5
"""m: motion from which a reading that never changes is worth a notice."""
LENGTH_CHANGES: Final = 0.01
"""Share of the motion that a column must change by before it is taken for a length unasked: seen square to the beam, anything fits."""
FARTHEST: Final = 50.0
"""m: distance beyond which no interferometer follows a machine; what would come from there is a coordinate."""


class Placed(NamedTuple):
    """What read the data, the rows whose command fits the measured motion, and the set-up to start from."""

    instrument: Instrument
    data: Measurements
    setup: SetUp


def prepared(machine: Machine, data: Measurements, given: Instrument | None) -> Placed:
    """Return what read the data, the rows whose command fits the measured motion, and the set-up to start from.

    Args:
        machine: the machine.
        data: the measurements.
        given: what read them; if None, a laser tracker, or a tracking interferometer where x_mm alone is read and is no coordinate.

    Raises:
        InputError: a sensor that does not follow its target; one coordinate that is neither a coordinate nor a length; an instrument
            that does not read so; commands that do not fit the readings (`fitting`).
    """
    data = _alive(machine, data)
    reader, notices = _instrument(machine, data, given)
    assumed = any(text.startswith(ASSUMED) for text in notices)
    try:
        left, setup = fitting(machine, data, lengths_only=reader.lengths_only)
    except InputError as error:
        if not assumed:
            raise
        raise InputError(
            f"only x_mm is given, and it follows the commands neither as a coordinate along one line nor as a length: {error.what}",
            expected="x_mm, y_mm and z_mm, or a length or coordinate that moves with the commands",
            file=error.file,
            line=error.line,
            value=error.value,
        ) from None
    if not reader.specification.free_start:
        setup = replace(setup, free_start=False, dead=np.zeros(len(setup.stations)))
    far = float(np.linalg.norm(setup.origin, axis=1).max())
    if assumed and far > FARTHEST:
        raise data.error(
            f"only x_mm is given, and it does not follow the commands as a coordinate along one line; as a length it would come from "
            f"{far:.3g} m away, so it is one coordinate of several",
            expected="x_mm, y_mm and z_mm, or an interferometer's lengths in x_mm",
            row=0,
        )
    said = (*notices, *left.notices, *_sides(machine, left), *_from_behind(left, setup))
    return Placed(reader, replace(left, notices=said), setup)


def _alive(machine: Machine, data: Measurements) -> Measurements:
    """Return the data with a notice of each coordinate that never changes.

    Raises:
        InputError: a target of which no coordinate ever changes, although its commands move it wherever it sits on its carrier.
    """
    points = nominal(machine, data)
    notices = []
    for station in dict.fromkeys(data.station):
        at = data.station == station
        for target in dict.fromkeys(data.target[at]):
            rows = np.flatnonzero(at & (data.target == target))
            constant = _constant(data, rows)
            read = np.isfinite(data.point_mm[rows]).any(axis=0)
            if not np.any(read) or not np.array_equal(constant, read):
                continue
            off = _least_motion(points.points[rows], points.rotation[rows], data.place_mm[rows[0]] * MM)
            far = int(np.argmax(np.linalg.norm(off - off[0], axis=1)))
            moved = float(np.linalg.norm(off[far] - off[0]))
            value = ", ".join(f"{POINT_COLUMNS[i]} {data.point_mm[rows[0], i]:g}" for i in np.flatnonzero(read))
            said = f"target {target} of station {station} reads the same in all {len(rows)} rows, while the commands move it by"
            if moved > DEAD:
                raise data.error(
                    f"a sensor that does not move: {said} {moved / MM:.3g} mm",
                    expected="readings that follow the commands; check the sensor, its cable and the column it was written to",
                    row=rows[far],
                    value=value,
                )
            if moved > HARDLY_MOVES:
                notices.append(f"{said} {moved / MM:.2g} mm: a dead sensor, or one with coarse steps")
        notices += _flat(data, points.points, station)
    return replace(data, notices=(*data.notices, *notices)) if notices else data


def _constant(data: Measurements, rows: np.ndarray) -> np.ndarray:
    """(3,) Whether a coordinate was read in several of the rows and is the same in all of them."""
    part = data.point_mm[rows]
    low = np.min(np.where(np.isfinite(part), part, np.inf), axis=0)
    high = np.max(np.where(np.isfinite(part), part, -np.inf), axis=0)
    return (np.isfinite(part).sum(axis=0) >= FEWEST_ROWS) & (low == high)


def _flat(data: Measurements, points: np.ndarray, station: str) -> list[str]:
    """Return a notice for each coordinate of a station that never changes while others do."""
    rows = np.flatnonzero(data.station == station)
    constant = _constant(data, rows)
    read = np.isfinite(data.point_mm[rows]).any(axis=0)
    moved = float(np.linalg.norm(np.ptp(points[rows], axis=0)))
    if moved <= DEAD or np.array_equal(constant, read):
        return []
    return [
        f"{POINT_COLUMNS[i]} of station {station} is {data.point_mm[rows, i][np.isfinite(data.point_mm[rows, i])][0]:g} in every row "
        f"while its targets move by {moved / MM:.3g} mm: right without noise in one plane, otherwise a dead channel"
        for i in np.flatnonzero(constant)
    ]


def _least_motion(points: np.ndarray, rotation: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(n, 3) how far a target is from its mean, m; of all places on its carrier, at the one that moves least if none is given.

    Args:
        points: (n, 3) origin of the carrier.
        rotation: (n, 3, 3) of the carrier.
        place: (3,) of the target; NaN where unknown.
    """
    if np.isfinite(place).all():
        found = points + rotation @ place
        return np.asarray(found - found.mean(axis=0))
    turn = (rotation - rotation.mean(axis=0)).reshape(-1, 3)
    off = (points - points.mean(axis=0)).reshape(-1)
    best = np.linalg.lstsq(turn, -off, rcond=1e-9)[0]
    return np.asarray((off + turn @ best).reshape(-1, 3))


def _sides(machine: Machine, data: Measurements) -> list[str]:
    """Return a notice for each axis that moved although no target or station is on the side that it carries."""
    sides = {*data.carrier, *data.station_carrier}
    return [
        f"{axis.name} moved, but it carries the {axis.side} and no target is there: these readings say nothing of {axis.name}"
        for axis, q in zip(machine.axes, data.positions.T, strict=True)
        if np.ptp(q) > 0.0 and axis.side != "both" and axis.side not in sides
    ]


def _from_behind(data: Measurements, setup: SetUp) -> list[str]:
    """Return a notice for each station that reads two coordinates and sees them as in a mirror, or from the other side.

    Readings of a plane fit either way: a station that looks from the other side is a mirror image.
    """
    found = []
    for i in np.flatnonzero(~setup.station_known):
        point = data.point_mm[data.station == setup.stations[i]]
        read = np.isfinite(point).any(axis=0)
        whole = point[np.isfinite(point[:, read]).all(axis=1)][:, read]
        if setup.lengths_only or np.count_nonzero(read) != 2 or len(whole) < FEWEST_ROWS:
            continue
        size = np.linalg.svd(whole - whole.mean(axis=0), compute_uv=False)
        unread = int(np.flatnonzero(~read)[0])
        if size[1] > IN_LINE * size[0] and setup.rotation[i][unread, unread] < -0.5:
            columns = " and ".join(POINT_COLUMNS[k] for k in np.flatnonzero(read))
            found.append(
                f"station {setup.stations[i]} reads {columns} only, and sees their plane from the machine's -{'xyz'[unread]}: "
                "if it does not stand there, one column of commands or readings has the wrong sign (a mirrored axis)"
            )
    return found


def _instrument(machine: Machine, data: Measurements, given: Instrument | None) -> tuple[Instrument, tuple[str, ...]]:
    """Return what read the data, and notices of what had to be assumed.

    An empty field is a coordinate that was not measured (contract §2): a scale beside a stage reads x alone. A tracking
    interferometer's length stands in x_mm, too; which of them it is shows in the motion.

    Raises:
        InputError: a given instrument that does not read so; one coordinate that follows the commands in no way.
    """
    read = [i for i in range(3) if np.isfinite(data.point_mm[:, i]).any()]
    if given is not None and given.lengths_only:
        if read != [0]:
            raise data.error(
                f"{given.name} reads lengths only, and y_mm or z_mm is given",
                expected="the length in x_mm, y_mm and z_mm empty",
                row=np.flatnonzero(np.isfinite(data.point_mm[:, 1:]).any(axis=1))[0],
            )
        return given, ()
    if len(read) > 1 or np.isfinite(data.station_pose).all():
        return given or usual(lengths_only=False), ()
    column = POINT_COLUMNS[read[0]]
    if _is_coordinate(machine, data):
        notice = f"{column} alone is given: taken as the coordinate of all targets along one line"
        return given or usual(lengths_only=False), () if read == [0] else (notice,)
    unit = other_unit(machine, data, lengths_only=False)
    if unit is not None or read != [0] or given is not None or not _may_be_length(machine, data):
        named = "" if given is None else f" that {given.name} read"
        raise data.error(
            f"only {column} is given, and as a coordinate{named} it does not follow the commands{'' if unit is None else f': {unit}'}",
            expected="x_mm, y_mm and z_mm; or an interferometer's lengths, or a coordinate along one line, in x_mm",
            row=0,
            value=f"{data.point_mm[0, read[0]]:g}",
        )
    return usual(lengths_only=True), (
        f"{ASSUMED}x_mm alone is given and does not follow the commands as a coordinate; it is taken as a length from an unknown zero, "
        "read by a tracking interferometer. If it is something else, name the instrument, or give y_mm and z_mm.",
    )


def _is_coordinate(machine: Machine, data: Measurements) -> bool:
    """Whether one column alone follows the commands as a coordinate along one line."""
    try:
        _, miss = first_setup(machine, data, lengths_only=False)
    except InputError:
        return False
    return float(np.mean(miss > miss_limit(data, miss))) <= SWAPPED


def _may_be_length(machine: Machine, data: Measurements) -> bool:
    """Whether x_mm changes by a fair share of the motion of some target."""
    points = nominal(machine, data)
    for station, target in dict.fromkeys(zip(data.station, data.target, strict=True)):
        rows = (data.station == station) & (data.target == target) & np.isfinite(data.point_mm[:, 0])
        if np.count_nonzero(rows) < 2:
            continue
        off = _least_motion(points.points[rows], points.rotation[rows], data.place_mm[rows][0] * MM)
        moved = float(np.linalg.norm(np.ptp(off, axis=0)))
        if np.ptp(data.point_mm[rows, 0]) * MM >= LENGTH_CHANGES * moved:
            return True
    return False
