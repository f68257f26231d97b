"""Generate ``thesis_plan.csv`` in this folder: run ``python -m twin.samples.thesis_plan``.

The measurement by which Ellingsdalen (2021) identified the errors of the DMU 50 (3.1, 3.2, appendix B 3.2), as a plan that can be
simulated. From the thesis: one laser tracker; three reflectors on the spindle for the linear axes and three on the table for the rotary
axes, at three heights each; 11 positions over X, Y and Z, B every 10°, C every 20°, the other axes at rest; each target measured at all
positions before the next, in one direction, four rounds per axis. The run starts from 0, for Z too, downwards (listing 3.1 steps to a
negative end).

Chosen here, because the thesis shows them only as pictures: the reflectors' places (heights and azimuths for which its six equations
are well-conditioned at every position, eq. 32, 36, 37, 3.6), the place of the tracker, the rest positions of the linear axes, and 15 s
per point.

Examples:
    >>> machine = twin.Machine.load("dmu50")
    >>> plan = twin.thesis_plan.plan(machine)
    >>> len(plan), sorted(set(plan.target))
    (840, ['K', 'KT', 'P', 'PT', 'Q', 'QT'])

References:
    - S. H. Ellingsdalen: Improving the Accuracy of a Five-Axis Machine Tool by Laser Tracker Calibration, master's thesis, NTNU, 2021.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

import numpy as np

from twin._common.arrays import read_only
from twin._common.files import write_atomic
from twin._common.units import DEG
from twin.machine.machine import Machine
from twin.measurement.simulate import Station
from twin.measurement.table import Measurements
from twin.samples import PLANS

ROUNDS: Final = 4
POSITIONS: Final = MappingProxyType(
    {
        "X": np.linspace(0.0, 500.0, 11),
        "Y": np.linspace(0.0, 450.0, 11),
        "Z": np.linspace(0.0, -400.0, 11),
        "B": np.arange(0.0, 181.0, 10.0),
        "C": np.arange(0.0, 341.0, 20.0),
    }
)
"""Measured positions of each axis, mm and degrees, in the order of the run."""
AT_REST: Final = MappingProxyType({"Y": 450.0})
"""Rest positions of linear axes other than 0 while a rotary axis is measured: away from the tracker."""
TOOL_PLACES_MM: Final = MappingProxyType(
    {"K": (-100.0, 70.0, 180.0), "P": (30.0, -70.0, 10.0), "Q": (110.0, 60.0, 150.0)}
)
"""Reflectors on the spindle head, above the spindle nose."""
WORK_PLACES_MM: Final = MappingProxyType(
    {"KT": (-60.0, 130.0, 170.0), "PT": (-100.0, -200.0, 30.0), "QT": (60.0, 90.0, 140.0)}
)
"""Reflectors on the table, above its surface."""
SECONDS_A_POINT: Final = 15.0
DISTANCE_MM: Final = 2000.0
"""Distance from the table's centre to the tracker, along an axis of the base frame."""
EYE_MM: Final = 200.0
"""Height of the beam above the table: half of Z's range."""
NOTE: Final = """plan of Ellingsdalen (2021), 3.1 and 3.2: the geometric errors of the DMU 50 with a laser tracker
the thesis's: three targets on the spindle for X, Y, Z at 11 positions each, three on the table for B (every 10 deg) and C
(every 20 deg), at three heights, each through all positions before the next, in one direction, four rounds, one station (Pos. 1)
ours: the targets' places, the station's (2 m in front of the table's centre), Y at rest for B and C, 15 s a point"""


def thesis_stations() -> tuple[Station, Station, Station]:
    """Return tracker positions 1, 2 and 3 of figure 5.1 (tables 5.1, 5.2); x of each station's frame points at the machine.

    Pos. 1 looks along Y, so that y (E_YX, E_YZ, E_YY) depends least on the tracker's angle measurement. Pos. 2 looks along X, Pos. 3
    along Z from above. The distances are chosen here.
    """
    return (
        Station((0.0, -DISTANCE_MM, EYE_MM), (0.0, 0.0, 90.0 * DEG)),
        Station((DISTANCE_MM, 0.0, EYE_MM), (0.0, 0.0, 180.0 * DEG)),
        Station((0.0, 0.0, DISTANCE_MM + EYE_MM), (0.0, 90.0 * DEG, 0.0)),
    )


def plan(machine: Machine, station: Station | None = None) -> Measurements:
    """Return the plan as a table without coordinates, in measuring order.

    Args:
        machine: the DMU 50, or one with the same axis names and ranges.
        station: place of the tracker; `thesis_stations` Pos. 1 if None.
    """
    pose = (thesis_stations()[0] if station is None else station).pose
    positions, approach, names, places, carriers, rounds = [], [], [], [], [], []
    for moving, values in POSITIONS.items():
        linear = machine.by_name[moving].linear
        targets = TOOL_PLACES_MM if linear else WORK_PLACES_MM
        rest = np.array([0.0 if linear else AT_REST.get(name, 0.0) for name in machine.names])
        column = machine.names.index(moving)
        for number in range(1, ROUNDS + 1):
            for target, place in targets.items():
                for value in values:
                    positions.append(np.where(np.arange(len(rest)) == column, value, rest))
                    approach.append(np.sign(values[-1] - values[0]) * (np.arange(len(rest)) == column))
                    names.append(target)
                    places.append(place)
                    carriers.append("tool" if linear else "work")
                    rounds.append(str(number))
    n = len(names)
    return Measurements(
        source="thesis plan",
        lines=read_only(np.arange(1, n + 1)),
        positions=read_only(np.array(positions)),
        readback=read_only(np.full((n, len(machine.axes)), np.nan)),
        target=read_only(np.array(names, dtype=object)),
        carrier=read_only(np.array(carriers, dtype=object)),
        station=read_only(np.full(n, "1", dtype=object)),
        round=read_only(np.array(rounds, dtype=object)),
        point_mm=read_only(np.full((n, 3), np.nan)),
        u_mm=read_only(np.full((n, 3), np.nan)),
        time_s=read_only(SECONDS_A_POINT * np.arange(n)),
        approach=read_only(np.array(approach) + 0.0),
        place_mm=read_only(np.array(places)),
        station_pose=read_only(np.tile(pose, (n, 1))),
        temperature_degC=MappingProxyType({}),
    )


def text() -> str:
    """Return the content of the file."""
    machine = Machine.load("dmu50")
    return plan(machine).to_csv(machine, comment=NOTE)


if __name__ == "__main__":
    write_atomic(PLANS[0], text())
