"""Positions of the linear axes, from the nominal kinematics."""

from __future__ import annotations

import numpy as np

from twin._common.errors import InputError
from twin._common.units import MM
from twin.machine.machine import Machine
from twin.measurement.observation import observation_of
from twin.measurement.table import CARRIERS


def linear_positions(
    machine: Machine,
    positions: np.ndarray,
    tip_mm: tuple[float, float, float],
    places_mm: np.ndarray,
    offset_mm: np.ndarray,
) -> np.ndarray:
    """Return positions (n, axes) at which a part of the tool is at given places, from the nominal kinematics.

    Args:
        machine: the machine.
        positions: (n, axes) mm and degrees; those of the linear axes are replaced.
        tip_mm: the part on the tool side, in the frame of the spindle nose.
        places_mm: (n, 3) places in the work frame.
        offset_mm: (n, 3) of the tool's part from the place, base frame.

    Raises:
        InputError: the machine does not have three linear axes that move the tool in all directions.
    """
    linear = list(machine.linear)
    q = np.array(positions, dtype=float)
    middle = [np.mean(machine.axes[i].domain) for i in linear]
    q[:, linear] = middle
    tips = np.broadcast_to(np.array(tip_mm), (len(q), 3))

    def gap(at: np.ndarray) -> np.ndarray:
        tool, work = (
            carried_points_mm(machine, at, side, place) for side, place in zip(CARRIERS, (tips, places_mm), strict=True)
        )
        return np.asarray(tool - work - offset_mm)

    here = gap(q)
    # Linear axes translate: the gap is an affine function of their positions.
    step = np.stack([gap(q + np.eye(len(machine.axes))[i]) - here for i in linear], axis=2)
    if len(q) and np.abs(np.linalg.det(step)).min() < 1e-6:
        raise InputError("the linear axes do not move the tool in all directions", expected="three independent axes")
    q[:, linear] -= np.linalg.solve(step, here[:, :, None])[:, :, 0]
    return q


def carried_points_mm(machine: Machine, positions: np.ndarray, side: str, places_mm: np.ndarray) -> np.ndarray:
    """Return (n, 3) points on the tool side or the work side of the nominal machine, base frame, mm.

    Args:
        machine: the machine.
        positions: (n, axes) mm and degrees.
        side: ``tool`` or ``work``.
        places_mm: (n, 3) in the frame of that side.
    """
    n = len(positions)
    errors, carrier = np.zeros((n, 6 * len(machine.frames))), np.full(n, side, dtype=object)
    return observation_of(machine).points(positions * machine.scale, errors, carrier, places_mm * MM) / MM
