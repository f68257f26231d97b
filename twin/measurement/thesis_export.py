"""The tracker export of the thesis: lines of a name and three coordinates, one block of lines for each target."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from twin._common.arrays import read_only
from twin._common.counts import count_with_noun
from twin._common.errors import InputError
from twin._common.files import read_lines
from twin.machine.machine import Machine
from twin.measurement.table import CARRIERS, Measurements, without_unusable_rows


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

    Args:
        path: the file; mm, no header.
        machine: the machine.
        positions: (p, axes) commanded positions of the lines of every block, mm and degrees.
        targets: names of the targets in the order of the blocks.
        carrier: the side on which they sit.
        round_name: name of the round that this file contains.

    Raises:
        InputError: a number of lines that is not blocks times positions, or a line that is not a name and three numbers.
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
