"""What is refused because it leaves the range of an axis."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.errors import InputError
from twin.kinematics.inverse import SLACK
from twin.machine.machine import Machine

ARC_POINTS: Final = 64
"""Points of an arc at which it is compared with the ranges, for the message."""


def refuse_arc(machine: Machine, commands: np.ndarray, source: str, line: int) -> None:
    """Refuse an arc that cannot be compensated whole.

    Left as written it would begin elsewhere than the compensated block before it ends, and its radius would not fit.

    Args:
        machine: the machine.
        commands: (n, axes) along the arc, mm and degrees; the last one is its end.
        source: the program's name.
        line: the arc's line number.

    Raises:
        InputError: always; with the axis, the place and the limit.
    """
    limits = machine.limits / machine.scale[:, None]
    beyond = np.maximum(limits[:, 0] - commands, commands - limits[:, 1])
    ends = bool(np.any(beyond[-1] > SLACK))
    row = len(commands) - 1 if ends else int(np.argmax(beyond.max(axis=1)))
    i = int(np.argmax(beyond[row]))
    axis, place = machine.axes[i], commands[row, i]
    below = place < limits[i, 0]
    raise InputError(
        f"the arc {'ends at' if ends else 'passes'} {axis.name} {place:.6g}, {'below' if below else 'above'} the axis's "
        f"{'minimum' if below else 'maximum'} {limits[i, 0 if below else 1]:g}",
        expected="arcs within the range of every axis: is the work offset missing?",
        file=source,
        line=int(line),
        setting="work offset",
    )
