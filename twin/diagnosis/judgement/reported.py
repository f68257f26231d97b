"""Where the control reported other positions than it was told: which of the two the measurement follows.

With s the share of the difference that shows in the readings, everything else that was found beside it: s = 0, they follow the
command, and the report was taken before the axis had settled (contract §5, ``read_back``); s = 1, the axis stood where the
control said, and that is a cause like any other (``following_error``), sought and paid for with the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twin._common.arrays import locked
from twin._common.distributions import normal_sf
from twin.diagnosis.candidates.following_error import FOLLOWING_ERROR, READ_BACK
from twin.diagnosis.problem.pool import Form, Pool
from twin.diagnosis.problem.problem import unwhitened
from twin.diagnosis.result import Cause, Quantity
from twin.machine.machine import Machine
from twin.measurement.table import Measurements

FINER: Final = 0.01
"""Least increments by which a position may be off a whole number of them for rounding."""
MOST: Final = 0.5
"""Share of the positions that no control can command, above which they are taken for reported ones."""
RULED_OUT: Final = 5.0
"""Standard uncertainties from one at which the readings do not follow the report: 1 in 10⁶."""
COMPATIBLE: Final = 3.0
"""Standard uncertainties from nothing within which they follow the command."""


def reported(pool: Pool, forms: Sequence[Form]) -> tuple[list[Cause], list[str]]:
    """Axes whose reported positions the measurement does not follow, and in words those of which nothing can be said.

    Args:
        pool: what was tried.
        forms: what was found.
    """
    data, machine = pool.problem.network.data, pool.problem.network.machine
    causes, silent = [], []
    tried = [form for form in pool.forms if form.candidate.specification is FOLLOWING_ERROR and form not in forms]
    for form in tried:
        axis = machine.by_name[form.candidate.where]
        off = largest_off(data, machine.names.index(axis.name))
        text = f"the positions reported for {axis.name} differ from the commands by up to {off:.3g} {axis.unit}"
        columns, values, inverse = pool.fitted([form, *forms])
        at, scale = int(np.searchsorted(columns, form.columns[0])), form.cell.columns[0].scale
        share, u = float(values[at] * scale), float(scale * np.sqrt(inverse[at, at]))
        if pool.scan([one for one in forms if one is not form])[1][form.index] == 0 or u == 0.0:
            if pool.scan([])[1][form.index] > 0:
                silent.append(
                    f"{text}; beside what was found, these data cannot tell which of them the measurement follows"
                )
            continue
        if abs(share - 1.0) > RULED_OUT * u and abs(share) < COMPATIBLE * u:
            causes.append(
                Cause(
                    effect=READ_BACK.name,
                    where=axis.name,
                    origin="instrument",
                    parameters=(Quantity("share", share, "1", u),),
                    p_value=float(min(2.0 * normal_sf(abs(share - 1.0) / u) * len(tried), 1.0)),
                    share=0.0,
                    equivalent=(),
                    evidence=f"{text}, and the measurement follows the commands: they were read before {axis.name} had settled",
                    pattern_um=locked(
                        unwhitened(pool.problem, pool.problem.signature(form.cell.columns)[:, 0] / scale)
                    ),
                )
            )
        elif abs(share - 1.0) < COMPATIBLE * u and abs(share) < COMPATIBLE * u:
            silent.append(f"{text}; these data cannot tell which of them the measurement follows")
    return causes, silent


def largest_off(data: Measurements, axis: int) -> float:
    """How far the control's report is from its command at most, mm or degrees."""
    return float(np.nanmax(np.abs(data.readback[:, axis] - data.positions[:, axis])))


def unsettled(data: Measurements, machine: Machine, where: str) -> str:
    """Why a reversal of an axis may be none; empty where nothing speaks against it.

    Positions finer than the least increment are no commands. Reported before the axis had settled, they are off by the side it came
    from, as lost motion is.
    """
    axis = machine.by_name.get(where)
    if axis is None or np.any(np.isfinite(data.readback[:, machine.names.index(where)])):
        return ""
    steps = data.positions[:, machine.names.index(where)] / axis.increment
    if np.mean(np.abs(steps - np.round(steps)) > FINER) <= MOST:
        return ""
    return (
        f"the positions of {where} are finer than its least increment, so not as commanded: if they were reported before {where} had "
        f"settled, this is no lost motion; commanded positions with a column readback_{where}_{axis.unit} would settle it"
    )
