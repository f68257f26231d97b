"""Where the control reported other positions than it was told: which of the two the measurement follows.

With s the share of the difference that shows in the readings, everything else that was found beside it: s = 0, they follow the
command, and the report was taken before the axis had settled (contract §5, ``read_back``); s = 1, the axis stood where the
control said, and that is a cause like any other (``following_error``), sought and paid for with the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from twin.arrays import locked
from twin.diagnosis.pool import Form, Pool
from twin.diagnosis.result import Cause, Quantity
from twin.distributions import normal_sf
from twin.measurement import Measurements

EFFECT: Final = "following_error"
RULED_OUT: Final = 5.0
"""Standard uncertainties from one at which the readings do not follow the report: 1 in 10⁶."""
COMPATIBLE: Final = 3.0
"""Standard uncertainties from nothing within which they follow the command."""


def reported(
    pool: Pool, forms: Sequence[Form], pattern_um: Callable[[np.ndarray], np.ndarray]
) -> tuple[list[Cause], list[str]]:
    """Axes whose reported positions the measurement does not follow, and in words those of which nothing can be said.

    Args:
        pool: what was tried.
        forms: what was found.
        pattern_um: (3n,) whitened → (n, 3) µm.
    """
    data, machine = pool.problem.network.data, pool.problem.network.machine
    causes, silent = [], []
    tried = [form for form in pool.forms if form.candidate.effect == EFFECT and form not in forms]
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
                    effect="read_back",
                    where=axis.name,
                    origin="instrument",
                    parameters=(Quantity("share", share, "1", u),),
                    p_value=float(min(2.0 * normal_sf(abs(share - 1.0) / u) * len(tried), 1.0)),
                    share=0.0,
                    equivalent=(),
                    evidence=f"{text}, and the measurement follows the commands: they were read before {axis.name} had settled",
                    pattern_um=locked(pattern_um(pool.problem.signature(form.cell.columns)[:, 0] / scale)),
                )
            )
        elif abs(share - 1.0) < COMPATIBLE * u and abs(share) < COMPATIBLE * u:
            silent.append(f"{text}; these data cannot tell which of them the measurement follows")
    return causes, silent


def largest_off(data: Measurements, axis: int) -> float:
    """How far the control's report is from its command at most, mm or degrees."""
    return float(np.nanmax(np.abs(data.readback[:, axis] - data.positions[:, axis])))
