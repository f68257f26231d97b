"""What a joint that gives way does to the readings: under the machine's own weight, and under a payload of any kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from twin.diagnosis.bounds import FARTHEST_MM, heaviest_kg
from twin.diagnosis.functions import given
from twin.diagnosis.signatures import Column, along_command, of_components
from twin.machine.effects import Payload
from twin.machine.effects.load import PAYLOAD_NUMBERS, SIDES, Side, loads
from twin.machine.machine import Axis, Machine

MASS: Final = PAYLOAD_NUMBERS[0]
UNLOADED: Final = 1e-6
"""N or N·m: rounding of a load that is none."""


def yielding(
    machine: Machine, axis: Axis, load: np.ndarray, known: Sequence[Payload]
) -> tuple[Column, tuple[Column, ...]]:
    """The column of a joint under its own weight and the payloads that are known, and its columns under a payload that is not.

    Any payload is four numbers to each joint: its mass and its first moments, times the joint's compliance, here as shares of the
    largest (`twin.diagnosis.bounds`). That it is the same to all joints, and how heavy it can be, is seen to where several are found
    (`twin.diagnosis.payload`). No columns for that where the joint's own weight does not load it: nothing tells compliance and payload
    apart.

    Args:
        machine: the machine.
        axis: of the joint.
        load: (n, 9) loads along it (`twin.machine.chain.gravity_load`).
        known: payloads of the calibration.
    """
    first = 1 + 4 * SIDES.index(side_of(axis))
    payload = load[:, first : first + 4] * heaviest_kg(machine) * [1.0, *[1e-3 * FARTHEST_MM] * 3]
    functions = given(np.column_stack([load @ loads(known), load[:, 0], payload]))
    along = along_command(machine, axis)
    own, *free = (of_components([(i, functions, k, part) for i, part in along]) for k in range(functions.count))
    return own, tuple(free) if np.any(np.abs(load[:, 0]) > UNLOADED) else ()


def side_of(axis: Axis) -> Side:
    """The side whose payload an axis carries."""
    return "tool" if axis.side == "tool" else "work"


def payloads_of(axis: Axis, fixed: Mapping[str, float]) -> tuple[Payload, ...]:
    """The payload that a form was refined with; none if it was not."""
    return (Payload.of(side_of(axis), fixed),) if fixed.get(MASS) else ()


def free_payload(machine: Machine, axis: Axis, values: np.ndarray) -> tuple[Payload, ...]:
    """The payload that a joint would need by itself; none where its mass comes to nothing.

    Args:
        machine: the machine.
        axis: of the joint.
        values: (5,) of the columns of `yielding` under a payload that is not known.
    """
    if values[0] == 0.0 or values[1] == 0.0:
        return ()
    return (payload_of(side_of(axis), heaviest_kg(machine), [values[1] / values[0], *(values[2:] / values[1])]),)


def payload_of(side: Side, heaviest: float, four: Sequence[float] | np.ndarray) -> Payload:
    """The payload of four numbers: its mass as a share of the heaviest, its centre as a share of the farthest."""
    share, x, y, z = (float(one) for one in four)
    return Payload(side, heaviest * share, (FARTHEST_MM * x, FARTHEST_MM * y, FARTHEST_MM * z))
