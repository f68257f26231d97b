"""Action of the location, the orientation and the zero of a rotary axis on the displacements that were read around it.

The nominal kinematics at the commanded positions give the places of the sphere about the axis: the linear axes follow it. The level of
the sphere along the axis does not show in the positions, so the location of the axis is that at the level of the sphere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.units import MM
from twin.machine.machine import Axis, Machine
from twin.measurement.observation import Observation
from twin.measurement.table import CARRIERS, Measurements

LETTERS: Final = "XYZABC"
TURNED_DEG: Final = 5.0
"""Travel above which a rotary axis counts as moved."""
STEP_DEG: Final = 1e-3


@final
@dataclass(frozen=True)
class AxisDesign:
    """Displacements of the tool relative to the work per unit of each quantity of a rotary axis.

    Attributes:
        axis: name of the axis.
        names: of the quantities: two locations, the shift along the axis, two orientations, the zero, the radial expansion.
        units: ``um`` or ``urad`` by name, in that order.
        matrix: (n, 3, 7) µm in X, Y, Z of the machine per unit, for every row of the record.
        radius_mm: mean distance of the spheres from the axis.
    """

    axis: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    matrix: np.ndarray
    radius_mm: float

    def select(self, rows: np.ndarray) -> AxisDesign:
        """Return the design of some rows."""
        return AxisDesign(self.axis, self.names, self.units, read_only(self.matrix[rows]), self.radius_mm)


def turning_axis(positions: np.ndarray, machine: Machine) -> Axis | None:
    """Return the only rotary axis that moves; None if none or several do."""
    turned = [i for i in machine.rotary if np.ptp(positions[:, i]) > TURNED_DEG]
    return machine.axes[turned[0]] if len(turned) == 1 else None


def axis_design(data: Measurements, machine: Machine) -> AxisDesign | None:
    """Return the design of the readings of a table, whose only moving rotary axis is the one described.

    Args:
        data: the table; its stations ride on the tool or the work.
        machine: the machine.

    Returns:
        None if no rotary axis moves or several do, or if stations stand on the base.
    """
    axis = turning_axis(data.positions, machine)
    if axis is None or str(data.station_carrier[0]) == "base":
        return None
    return design_of(axis, np.asarray(data.positions), *_parts(data), machine)


def design_of(
    axis: Axis, positions: np.ndarray, on_tool: Sequence[str], on_work: Sequence[str], machine: Machine
) -> AxisDesign:
    """Return the design of poses at which a part of the tool is at a part on the work.

    Args:
        axis: the rotary axis.
        positions: (n, axes) mm and degrees.
        on_tool: (n,) names of the parts on the tool side.
        on_work: (n,) names of the parts on the work side.
        machine: the machine.
    """
    observation, q, side = Observation(machine), positions * machine.scale, "tool" if axis.side == "tool" else "work"
    places = _places(observation, q, on_tool, on_work)[side]
    errors = np.zeros((len(q), 6 * len(machine.frames)))
    found = observation.carried(q, errors, np.full(len(q), side, dtype=object), places)
    frame = next(k for k, one in enumerate(machine.frames) if one.axis == axis.name and one.role == "location")
    by_error = found.by_error[:, :, 6 * frame : 6 * frame + 6]
    directions = by_error[:, :, :3]
    lever = -0.5 * np.sum(np.cross(directions, by_error[:, :, 3:], axis=1), axis=2)
    located = [LETTERS.index(name[2]) for name in machine.location_names if name[4] == axis.name]
    (along,) = {0, 1, 2} - set(located)
    own = directions[:, :, along]
    level = np.sum(own * lever, axis=1)
    radial = lever - own * level[:, None]
    lever = lever - own * level.mean()
    moved = positions.copy()
    index = machine.names.index(axis.name)
    moved[:, index] += STEP_DEG
    after = observation.points(moved * machine.scale, errors, np.full(len(q), side, dtype=object), places)
    about = np.cross(own, lever)
    way = np.sign(np.sum((after - found.points) * about))
    radius = float(np.mean(np.linalg.norm(radial, axis=1)))
    sign = 1.0 if side == "tool" else -1.0
    columns = [directions[:, :, k] if k < 3 else np.cross(directions[:, :, k - 3], lever) / MM * 1e-3 for k in located]
    columns = [*columns[:2], own, *columns[2:], way * about / MM * 1e-3, radial / max(radius, 1e-12)]
    first, second, third, fourth = (f"E_{LETTERS[k]}0{axis.name}" for k in located)
    names = (first, second, f"axial_{axis.name}", third, fourth, f"zero_{axis.name}", f"radial_{axis.name}")
    units = ("um", "um", "um", "urad", "urad", "urad", "um")
    return AxisDesign(axis.name, names, units, read_only(sign * np.stack(columns, axis=2)), radius / MM)


def _parts(data: Measurements) -> tuple[list[str], list[str]]:
    """Return the names (n,) of the part on the tool side and of the part on the work side of each reading."""
    tool, work = [], []
    for target, station, carrier in zip(data.target, data.station, data.carrier, strict=True):
        first, second = (f"target {target}", f"station {station}")
        tool.append(first if carrier == "tool" else second)
        work.append(second if carrier == "tool" else first)
    return tool, work


def _places(
    observation: Observation, q: np.ndarray, on_tool: Sequence[str], on_work: Sequence[str]
) -> dict[str, np.ndarray]:
    """Return the places (n, 3) of the parts on both sides, metres: those that meet at the commanded positions.

    Their level along an axis parallel to the tool is not determined; the least-squares solution of smallest length is used.
    """
    errors, zero = np.zeros((len(q), 6 * len(observation.machine.frames))), np.zeros((len(q), 3))
    blocks, origins, numbers = [], [], []
    for side, names in zip(CARRIERS, (on_tool, on_work), strict=True):
        found = observation.carried(q, errors, np.full(len(q), side, dtype=object), zero)
        every = list(dict.fromkeys(names))
        number = np.array([every.index(name) for name in names])
        block = np.zeros((len(q), 3, 3 * len(every)))
        for k in range(len(every)):
            block[number == k, :, 3 * k : 3 * k + 3] = found.rotation[number == k]
        blocks.append(block)
        origins.append(found.points)
        numbers.append(number)
    matrix = np.concatenate([blocks[0], -blocks[1]], axis=2).reshape(3 * len(q), -1)
    places = np.linalg.lstsq(matrix, (origins[1] - origins[0]).reshape(-1), rcond=1e-9)[0].reshape(-1, 3)
    split = blocks[0].shape[2] // 3
    own = places[:split], places[split:]
    return {side: own[k][numbers[k]] for k, side in enumerate(CARRIERS)}
