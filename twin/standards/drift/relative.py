"""Displacements of the tool relative to the work from a measurement table: probe, R-test or tracker, repeated over time."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

import numpy as np
import scipy

from twin._common.arrays import read_only
from twin._common.records import SPEED
from twin._common.units import DEG, MM, UM
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.observation import Observation
from twin.measurement.state import of_angles
from twin.measurement.table import Measurements
from twin.standards.drift.axis_design import axis_design
from twin.standards.drift.record import DriftRecord
from twin.standards.readings import SAME_AS_MACHINE, reading_uncertainty_mm

PARALLEL: Final = f"directions {SAME_AS_MACHINE}"
UNTURNED: Final = (
    "x, y and z are those of the station, whose orientation is unknown: give its pose for directions of the machine"
)
NOT_RELATIVE: Final = "motions of the station and of the table are contained: no target on the work was read"
WORK_REMOVED: Final = "the displacement of target {} on the work, interpolated over time, is subtracted"


def relative_displacements(
    data: Measurements, machine: Machine, instrument: Instrument | None, ambient: str
) -> DriftRecord:
    """Return the displacements of the tool relative to the work.

    The nominal motion between the commanded positions is subtracted: for a touch probe the displacements are those of the recorded
    positions. Only changes at one pose count, so unknown places of station and target have no influence.

    Args:
        data: the table, of one side of the station.
        machine: the machine.
        instrument: instrument whose noise model gives the uncertainty where the table does not; None for unknown.
        ambient: sensor of the ambient temperature; empty if unknown.

    Raises:
        InputError: times are missing or equal, angles or lengths instead of coordinates, stations on different sides.
    """
    _check(data)
    data = data.select(np.argsort(data.time_s, kind="stable"))
    base = str(data.station_carrier[0]) == "base"
    posed = bool(np.isfinite(data.station_pose).all())
    deviation = _deviation_um(data, machine)
    on_work = data.carrier == "work"
    signed = np.where(on_work[:, None], -1.0, 1.0) * deviation
    remarks = [] if posed else [UNTURNED if base else PARALLEL]
    rows = np.arange(len(data))
    if base:
        signed, rows, more = _without_work(data, deviation, on_work)
        remarks.append(more)
    data, names = data.select(rows), ("x", "y", "z") if base and not posed else ("X", "Y", "Z")
    used = {name: read_only(signed[rows, k]) for k, name in enumerate(names)}
    u = _uncertainty_mm(data, instrument)
    speed = data.channels.get(SPEED, np.full(len(data), np.nan))
    return DriftRecord(
        source=data.source,
        time_s=data.time_s,
        part=data.round,
        spot=read_only(
            np.array([f"target {t}, station {s}" for t, s in zip(data.target, data.station, strict=True)], dtype=object)
        ),
        positions=data.positions,
        displacement=MappingProxyType(used),
        units=MappingProxyType(dict.fromkeys(used, "um")),
        temperature_degC=data.temperature_degC,
        ambient=ambient,
        speed_rpm=read_only(np.abs(speed)) if np.isfinite(speed).any() else None,
        u_um=float(np.sqrt(np.nanmean(u**2))) * (MM / UM) if np.isfinite(u).any() else float("nan"),
        remarks=tuple(remarks),
        notices=data.notices,
        set_aside=data.set_aside,
        simulated=data.simulated,
        design=axis_design(data, machine),
    )


def _uncertainty_mm(data: Measurements, instrument: Instrument | None) -> np.ndarray:
    """Return (n, 3) standard uncertainties of the readings, mm, those of a touch probe at its zero; NaN if unknown."""
    if instrument is None or instrument.specification.reads != "null":
        return reading_uncertainty_mm(data, instrument)
    model = np.diagonal(instrument.covariance(np.zeros((len(data), 3))), axis1=1, axis2=2)
    return np.where(np.isfinite(data.u_mm), data.u_mm, np.sqrt(model) / MM)


def _check(data: Measurements) -> None:
    missing = np.flatnonzero(~np.isfinite(data.time_s))
    if len(missing):
        raise data.error("no time in this row", expected="time_s in every row", row=missing[0])
    unread = np.flatnonzero(~np.isfinite(data.point_mm).all(axis=1) | of_angles(data))
    if len(unread):
        raise data.error(
            "no three coordinates in this row",
            expected="x_mm, y_mm and z_mm: touch probe, R-test or tracker",
            row=unread[0],
        )
    other = np.flatnonzero(data.station_carrier != data.station_carrier[0])
    if len(other):
        raise data.error(
            "stations on different sides",
            expected=f"station_carrier {data.station_carrier[0]} in every row",
            row=other[0],
            value=data.station_carrier[other[0]],
        )


def _deviation_um(data: Measurements, machine: Machine) -> np.ndarray:
    """Return (n, 3) the readings minus the nominal motion, along the axes of the machine frame, µm.

    Where the station stands on the base without a pose, along those of the station; the nominal motion is then left in.
    """
    q = np.asarray(data.positions) * machine.scale
    observation = Observation(machine)
    errors = observation.errors(Calibration.zero(machine), data, check=False)
    places = np.nan_to_num(np.asarray(data.place_mm)) * MM
    carried = observation.carried(q, errors, data.carrier, places, data.station_carrier)
    posed = np.isfinite(data.station_pose).all(axis=1)
    if data.station_carrier[0] == "base" and not posed.all():
        return np.asarray(data.point_mm) * (MM / UM)
    turn = scipy.spatial.transform.Rotation.from_rotvec(np.where(posed[:, None], data.station_pose[:, 3:], 0.0) * DEG)
    deviation = turn.apply(np.array(data.point_mm)) * MM - carried.points
    return np.asarray(np.einsum("nij,nj->ni", carried.ride, deviation)) / UM


def _without_work(
    data: Measurements, deviation_um: np.ndarray, on_work: np.ndarray
) -> tuple[np.ndarray, np.ndarray, str]:
    """Return the displacements (n, 3) of tool targets relative to a target on the work, the rows of tool targets, and a remark."""
    tool = np.flatnonzero(~on_work)
    if not on_work.any():
        return deviation_um, tool, NOT_RELATIVE
    if not len(tool):
        return (
            -deviation_um,
            np.arange(len(data)),
            NOT_RELATIVE.replace("table", "tool").replace("the work", "the tool"),
        )
    name = data.target[on_work][0]
    work = np.flatnonzero(on_work & (data.target == name))
    found = deviation_um.copy()
    for k in range(3):
        found[:, k] -= np.interp(data.time_s, data.time_s[work], deviation_um[work, k])
    return found, tool, WORK_REMOVED.format(name)
