"""Tracker exports: the thesis's lines ``name, x, y, z``, one block of lines for each target.

The plan gives what the export lacks: targets, their sides, and the commanded positions, in the order of the plan. Each file is a round.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.files import read_lines
from twin._common.units import count_with_noun
from twin.machine.machine import Machine
from twin.measurement.columns import CARRIERS
from twin.measurement.formats.base import Conversion, FormatSpecification, Given, MeasuredFormat, file_lines
from twin.measurement.table import Measurements, without_unusable_rows


def load_export(
    path: str | Path,
    machine: Machine,
    positions: Any,
    *,
    targets: Sequence[str],
    carrier: str = "tool",
    round_name: str = "1",
) -> Measurements:
    """Read the thesis's tracker export: lines ``name, x, y, z``, one block of lines for each target, one line for each position.

    ``path``: the file; mm, no header; ``positions``: (p, axes) commanded positions of the lines of every block, mm and degrees;
    ``targets``: names of the targets in the order of the blocks.

    Raises `InputError`: a number of lines that is not blocks times positions, or a line that is not a name and three numbers.
    """
    path = Path(path)
    commands = np.atleast_2d(np.asarray(positions, dtype=float))
    if commands.shape[1] != len(machine.axes):
        raise InputError("positions have the wrong shape", expected=f"(p, {len(machine.axes)})", value=commands.shape)
    if carrier not in CARRIERS:
        raise InputError("unknown carrier", expected=" or ".join(CARRIERS), value=carrier)
    lines, points = [], []
    for number, text in enumerate(read_lines(path), start=1):
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        cells = [cell.strip() for cell in text.split(",")]
        try:
            points.append([float(cell) for cell in cells[1:]])
        except ValueError:
            points.append([])
        if len(cells) != 4 or len(points[-1]) != 3:
            raise InputError("not a measured point", expected="name, x, y, z", file=path, line=number, value=text)
        lines.append(number)
    wanted = len(commands) * len(targets)
    if len(points) != wanted:
        raise InputError(
            count_with_noun(len(points), "point"),
            expected=f"{wanted}: {len(targets)} targets at {len(commands)} positions",
            file=path,
        )
    words = partial(np.full, len(points), dtype=object)
    table = Measurements(
        source=str(path),
        lines=read_only(np.array(lines)),
        positions=read_only(np.tile(commands, (len(targets), 1))),
        target=read_only(np.repeat(np.array(targets, dtype=object), len(commands))),
        carrier=read_only(words(carrier)),
        round=read_only(words(round_name)),
        point_mm=read_only(np.array(points)),
    )
    return without_unusable_rows(table, machine)


# --- Tracker export of the thesis: lines ``name, x, y, z``, one block of lines for each target, read by `twin.measurement.the

LINE: Final = re.compile(r"[^,]*(,\s*[-+.\deE]+\s*){3}")


@final
class TrackerExport(MeasuredFormat):
    """Tracker export of the thesis."""

    specification = FormatSpecification(
        name="tracker",
        title="tracker export: name, x, y, z",
        suffixes=(".csv", ".txt"),
        gives="coordinates of reflectors",
        instrument="tracker",
        needs="a plan: targets in blocks, with the commanded positions of every line",
        source="the thesis whose data twin reproduces",
        unverified=("that the lines are in mm and in the order of the plan: the export states neither",),
    )

    def recognises(self, text: str) -> bool:
        """See `MeasuredFormat.recognises`."""
        lines = (line.strip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#"))
        return LINE.fullmatch(next(lines, "")) is not None

    def read(self, path: Path, machine: Machine, given: Given, round_name: str) -> Conversion:
        """See `MeasuredFormat.read`."""
        if given.plan is None:
            raise InputError(
                "a tracker export has no positions", expected="a plan with one row for each line", setting="plan"
            )
        targets, carrier, positions = _blocks(given.plan)
        table = load_export(path, machine, positions, targets=targets, carrier=carrier, round_name=round_name)
        points = [line for line, text in file_lines(path) if not text.startswith("#")]
        rows = np.searchsorted(points, table.lines)  # lines that cannot be used are missing in the table
        plan = given.plan
        table = replace(
            table,
            station=read_only(plan.station[rows]),
            station_carrier=read_only(plan.station_carrier[rows]),
            approach=read_only(plan.approach[rows]),
        )
        return Conversion(table, (f"assumed: the lines are in the order of the plan {plan.source}",))


def _blocks(plan: Measurements) -> tuple[list[str], str, np.ndarray]:
    """Return the targets of a plan, their side, and (p, axes) the positions that all of them share.

    Raises `InputError`: the targets are not in blocks of the same positions, or sit on both sides.
    """
    targets = list(dict.fromkeys(map(str, plan.target)))
    first = np.asarray(plan.positions[plan.target == targets[0]])
    expected = np.repeat(np.array(targets, dtype=object), len(first))
    if len(plan) != len(expected) or np.any(plan.target != expected):
        raise InputError(
            "the plan's targets are not in blocks of the same length",
            expected="all rows of one target, then all of the next",
            file=plan.source,
        )
    if not np.array_equal(plan.positions, np.tile(first, (len(targets), 1))):
        raise InputError(
            "the plan's targets have different positions", expected="one list of positions for all", file=plan.source
        )
    sides = sorted(set(map(str, plan.carrier)))
    if len(sides) > 1:
        raise InputError("the plan's targets sit on both sides", expected="one carrier", file=plan.source)
    return targets, sides[0], first
