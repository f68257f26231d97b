"""Rows that do not belong: commands that miss the measured motion, columns in the wrong order, readings far from all others."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import Final

import numpy as np

from twin.arrays import locked
from twin.errors import InputError
from twin.identification.setup import SetUp
from twin.identification.start import FITS, first_setup
from twin.instruments import Instrument, LaserTracker, TrackingInterferometer
from twin.machine import Machine
from twin.measurement import Measurements, RowNote
from twin.units import MM

SWAPPED: Final = 0.2
"""Share of rows that miss by centimetres beyond which it is not rows but columns."""
ASKED: Final = 0.02
"""Share beyond which it is asked whether it is columns."""
DRAWN: Final = 0.01
"""Share of the measured motion that a machine may differ from its drawing by."""
STANDS_OUT: Final = 10.0
"""Times the typical miss beyond which a row does not belong."""


def instrument_of(machine: Machine, data: Measurements, given: Instrument | None) -> Instrument:
    """What read the data: as given, else a laser tracker, or a tracking interferometer where only x_mm is read and is no coordinate.

    An empty field is a coordinate that was not measured (contract §2): a scale beside a stage reads x alone. A tracking
    interferometer's length stands in x_mm, too; which of them it is shows in the motion.

    Raises:
        InputError: a given instrument that does not read so.
    """
    only_x = bool(np.isnan(data.point_mm[:, 1:]).all())
    if given is None:
        return TrackingInterferometer() if only_x and not _is_coordinate(machine, data) else LaserTracker()
    lengths = given.lengths_only
    if lengths and not only_x:
        raise InputError(
            f"{given.name} reads lengths only, and y_mm or z_mm is given",
            expected="the length in x_mm, y_mm and z_mm empty",
            file=data.source,
            line=int(data.lines[np.flatnonzero(np.isfinite(data.point_mm[:, 1:]).any(axis=1))[0]]),
        )
    if only_x and not lengths and not _is_coordinate(machine, data):
        raise InputError(
            f"only x_mm is given, and as a coordinate that {given.name} read it does not follow the commands",
            expected="x_mm, y_mm and z_mm, or an interferometer's lengths",
            file=data.source,
            line=int(data.lines[0]),
        )
    return given


def _is_coordinate(machine: Machine, data: Measurements) -> bool:
    """Whether x_mm alone follows the commands as a coordinate along one line."""
    try:
        _, miss = first_setup(machine, data, lengths_only=False)
    except InputError:
        return False
    return float(np.mean(miss > _limit(data, miss))) <= SWAPPED


def fitting(machine: Machine, data: Measurements, *, lengths_only: bool) -> tuple[Measurements, SetUp]:
    """The rows whose command fits the measured motion, and the set-up as it follows from the machine as drawn.

    Args:
        machine: the machine.
        data: the measurements.
        lengths_only: whether only lengths were read.

    Raises:
        InputError: more than a fifth of the rows do not fit, or fewer that one change of the columns would make fit; named with what
            would.
    """
    try:
        setup, miss = first_setup(machine, data, lengths_only=lengths_only)
    except InputError:
        # A machine seen as in a mirror may be one command column that is wrong; several that would do are the mirror itself.
        likely = _one_change(machine, data, 1.0, lengths_only)
        if len(likely) != 1:
            raise
        raise InputError(
            f"the commands do not fit the measured motion: {likely[0][1]}",
            expected=f"commands that the readings follow on {machine.name}",
            file=data.source,
            line=int(data.lines[0]),
        ) from None
    limit = _limit(data, miss)
    bad = miss > limit
    share = float(np.mean(bad))
    likely = _one_change(machine, data, share, lengths_only) if share > ASKED else []
    if likely or share > SWAPPED:
        worst = int(np.argmax(miss))
        raise InputError(
            f"the commands do not fit the measured motion: {min(likely)[1] if likely else _where(machine, data, miss, limit)}",
            expected=f"commands that the readings follow within {limit / MM:.2g} mm on {machine.name}",
            file=data.source,
            line=int(data.lines[worst]),
            value=f"{miss[worst] / MM:.1f} mm off",
        )
    if not np.any(bad):
        return data, setup
    notes = tuple(
        RowNote(
            int(data.lines[row]),
            f"the commanded position misses the measured motion by {miss[row] / MM:.1f} mm (target {data.target[row]}, "
            f"round {data.round[row]}): another position, another target or a lost beam",
            kind="the commanded position misses the measured motion: another position, another target or a lost beam",
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


def _limit(data: Measurements, miss: np.ndarray) -> float:
    """How far a reading may be from the machine as drawn, metres.

    A machine drawn a little wrong everywhere (a robot before its calibration) misses by millimetres in every row, by about as much in
    each; rows that do not belong stand out from the others. A typical miss that is no small part of the motion is neither.
    """
    typical = float(np.median(miss))
    read = data.point_mm[:, np.isfinite(data.point_mm).any(axis=0)]
    span = float(np.linalg.norm(np.nanmax(read, axis=0) - np.nanmin(read, axis=0))) * MM
    return max(FITS, STANDS_OUT * typical) if typical < DRAWN * span else FITS


def _one_change(machine: Machine, data: Measurements, share: float, lengths_only: bool) -> list[tuple[float, str]]:
    """What would make most of the rows fit that do not: two columns swapped, or one with the other sign.

    Args:
        machine: the machine.
        data: the measurements.
        share: of rows that do not fit.
        lengths_only: whether only lengths were read.

    Returns:
        Typical miss and words of each.
    """
    few = data.select(np.linspace(0, len(data) - 1, min(len(data), 600)).astype(int))
    names = [f"{axis.name}_{axis.unit}" for axis in machine.axes]
    found: list[tuple[float, str]] = []

    def attempt(positions: np.ndarray, text: str) -> None:
        changed = replace(few, positions=locked(positions))
        try:
            miss = first_setup(machine, changed, lengths_only=lengths_only)[1]
        except InputError:
            return
        if np.mean(miss > _limit(changed, miss)) < share / 5.0:
            found.append((float(np.median(miss)), text))

    moving = _moving(few)
    for i, j in combinations(range(len(names)), 2):
        if i in moving or j in moving:
            swapped = np.array(few.positions)
            swapped[:, [i, j]] = swapped[:, [j, i]]
            attempt(swapped, f"columns {names[i]} and {names[j]} look swapped")
    for i in moving:
        turned = np.array(few.positions)
        turned[:, i] = -turned[:, i]
        attempt(turned, f"column {names[i]} looks as if its sign were wrong")
    return found


def _where(machine: Machine, data: Measurements, miss: np.ndarray, limit: float) -> str:
    """How many rows miss, and the motion of which axis most of them share."""
    by_axis = [
        (float(np.median(miss[data.positions[:, i] != np.median(data.positions[:, i])])), i) for i in _moving(data)
    ]
    _, worst = max(by_axis, default=(0.0, 0))
    axis = machine.axes[worst]
    share = f"{np.mean(miss > limit):.0%} of all readings are more than {limit / MM:.2g} mm off"
    return f"{share}, most where {axis.name}_{axis.unit} moves"


def _moving(data: Measurements) -> list[int]:
    return [i for i in range(data.positions.shape[1]) if np.ptp(data.positions[:, i]) > 0.0]
