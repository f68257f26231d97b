"""Readings of a run: along and across an axis, their standard uncertainty, and the orientation of a station's frame.

The orientation of a station is unknown unless the table gives its pose. It is estimated from the directions in which the readings
move with two or more linear axes; with one, the frame is taken as parallel to the machine's if the direction fits within
`LARGEST_ANGLE_DEG`. Squareness and straightness do not depend on it, only their names do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
import scipy

from twin._common.units import DEG, MM, UM
from twin.machine.machine import Axis, Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements
from twin.standards.runs import MeasuredRun

LARGEST_ANGLE_DEG: Final = 10.0
SLOPE_TOLERANCE: Final = 0.01
"""Difference from 1 mm per mm up to which a length is along the axis."""
FROM_AXES: Final = "parallel to the machine's axes, found from the runs of two or more of them"
SAME_AS_MACHINE: Final = "of the station's frame, taken as parallel to the machine's"


class NotPossible(Exception):
    """The readings of a run do not allow an evaluation; the message says why."""


def reading_uncertainty_mm(data: Measurements, instrument: Instrument | None) -> np.ndarray:
    """Return (n, 3) standard uncertainties of the readings, mm; NaN if unknown.

    Args:
        data: the table.
        instrument: the instrument whose noise model gives them where the table does not; None for unknown.
    """
    if instrument is None:
        return np.asarray(data.u_mm)
    points = np.nan_to_num(np.asarray(data.point_mm)) * MM
    far = np.linalg.norm(points, axis=1) > 0.0
    model = np.full(points.shape, np.nan)
    if far.any():
        covariance = instrument.covariance(points[far])
        model[far] = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)) / MM
    return np.where(np.isfinite(data.u_mm), data.u_mm, np.where(np.isfinite(data.point_mm), model, np.nan))


@final
@dataclass(frozen=True)
class StationFrame:
    """Orientation of a station's frame in the machine frame.

    Attributes:
        rotation: (3, 3) turns readings into directions parallel to the machine's axes.
        known: how it is known, in words; empty if it is unknown.
    """

    rotation: np.ndarray
    known: str


def relative_direction(run: MeasuredRun, machine: Machine) -> np.ndarray:
    """Return (3,) the nominal direction, in the machine frame, in which the readings move with a linear axis; zero if they do not.

    Args:
        run: a run of one linear axis.
        machine: the machine.
    """
    axis = machine.axes[run.axes[0]]
    target, station = carried_sides(run, axis)
    return (float(target) - float(station)) * axis.machine_direction


def carried_sides(run: MeasuredRun, axis: Axis) -> tuple[bool, bool]:
    """Return whether the axis carries the target, and whether it carries the station."""
    return axis.side in ("both", run.data.carrier[0]), axis.side in ("both", run.data.station_carrier[0])


def station_frame(runs: Sequence[MeasuredRun], machine: Machine) -> StationFrame:
    """Return the orientation of one station.

    Args:
        runs: its runs of one linear axis, of which those with three coordinates are used.
        machine: the machine.
    """
    pairs = [
        (measured_direction(run), relative_direction(run, machine))
        for run in runs
        if run.read.all() and len(run.data) > 1
    ]
    pairs = [(d / np.linalg.norm(d), e) for d, e in pairs if abs(np.linalg.norm(d) - 1.0) < SLOPE_TOLERANCE and e.any()]
    pose = runs[0].data.station_pose[0] if runs else np.full(6, np.nan)
    base = (
        scipy.spatial.transform.Rotation.from_rotvec(pose[3:] * DEG)
        if np.isfinite(pose).all()
        else scipy.spatial.transform.Rotation.identity()
    )
    if not pairs:
        return StationFrame(base.as_matrix(), SAME_AS_MACHINE)
    measured, nominal = (np.array(side) for side in zip(*pairs, strict=True))
    if np.linalg.matrix_rank(nominal, tol=0.5) >= 2:
        turned, _ = scipy.spatial.transform.Rotation.align_vectors(nominal, measured)
        off = np.arccos(np.clip(np.sum(turned.apply(measured) * nominal, axis=1), -1.0, 1.0)).max() / DEG
        return StationFrame(
            turned.as_matrix(),
            "parallel to the machine's axes, found from the runs of two or more of them"
            if off < LARGEST_ANGLE_DEG
            else "",
        )
    off = np.arccos(np.clip(base.apply(measured[0]) @ nominal[0], -1.0, 1.0)) / DEG
    words = "as given by the station's pose" if np.isfinite(pose).all() else SAME_AS_MACHINE
    return StationFrame(base.as_matrix(), words if off < LARGEST_ANGLE_DEG else "")


def measured_direction(run: MeasuredRun) -> np.ndarray:
    """Return (3,) the change of the readings, mm per mm or per degree of the axis, by least squares; NaN where nothing was read."""
    q = run.positions[:, 0] - run.positions[:, 0].mean()
    return np.asarray(q @ (run.data.point_mm - run.data.point_mm.mean(axis=0)) / (q @ q))


def along_axis_mm(run: MeasuredRun, axis: Axis, u_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return the measured position along a linear axis, mm, its standard uncertainty (n,), and whether its zero is the axis's own.

    A length counts as along the axis if it changes by 1 mm per mm, with either sign. From three coordinates it is the component along
    the least-squares line of the points.

    Args:
        run: a run of one linear axis.
        axis: the axis.
        u_mm: (n, 3) standard uncertainties of the readings.

    Raises:
        NotPossible: the readings do not follow the axis.
    """
    slope = measured_direction(run)
    read = np.flatnonzero(run.read)
    if len(read) == 3:
        length = float(np.linalg.norm(slope))
        direction = slope / length if length > 0.0 else slope
    else:
        lengths = np.abs(slope[read]) if len(read) else np.zeros(1)
        length = float(lengths.max())
        direction = np.zeros(3)
        if len(read):
            column = int(read[int(np.argmax(lengths))])
            direction[column] = np.sign(slope[column])
    if abs(length - 1.0) > SLOPE_TOLERANCE:
        raise NotPossible(f"the readings change by {length:.3g} mm per mm of {axis.name}: they are not along the axis")
    used = direction != 0.0
    position = run.data.point_mm[:, used] @ direction[used]
    u = np.sqrt(np.sum((u_mm[:, used] * direction[used]) ** 2, axis=1))
    own_zero = len(read) < 3 and float(np.abs(position - run.positions[:, 0]).max()) < 0.5
    return np.asarray(position), np.asarray(u), own_zero


def across_axis_um(run: MeasuredRun, frame: StationFrame, machine: Machine) -> dict[str, np.ndarray]:
    """Return the readings across a linear axis, µm, by the ISO 230-1 name of the error motion (``E_YX``).

    Args:
        run: a run of one linear axis.
        frame: orientation of its station.
        machine: the machine.

    Raises:
        NotPossible: the frame's orientation is unknown, or the axis is not parallel to an axis of the machine frame.
    """
    axis, direction = machine.axes[run.axes[0]], relative_direction(run, machine)
    along = int(np.argmax(np.abs(direction)))
    if abs(direction[along]) < 1.0 - SLOPE_TOLERANCE:
        raise NotPossible(f"{axis.name} is not parallel to an axis of the machine frame, or does not move the readings")
    sign = 1.0 if axis.machine_direction @ direction > 0.0 else -1.0  # of the moved side's error in the readings
    points = run.data.point_mm
    if run.read.all():
        if not frame.known:
            raise NotPossible(
                "the orientation of the station is unknown: measure a second linear axis, or give its pose"
            )
        points = points @ frame.rotation.T
    lateral = [k for k in range(3) if k != along and np.isfinite(points[:, k]).all()]
    if not run.read.all():
        slopes = np.abs(measured_direction(run))
        lateral = [k for k in lateral if slopes[k] < SLOPE_TOLERANCE]
    if not lateral:
        raise NotPossible("no coordinate across the travel was read")
    return {f"E_{'XYZ'[k]}{axis.name}": sign * (points[:, k] - points[0, k]) * (MM / UM) for k in lateral}
