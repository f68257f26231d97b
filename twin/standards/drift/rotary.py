"""The test of thermal distortion caused by rotary motion of components: the axis's location, orientation and zero over time.

Readings at the same positions of the axis are repeated while it turns in between. The changes of one cycle of readings since the first
reading at each position are a rigid motion of the axis and a radial expansion of the table or head that it carries, by least squares.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from twin.measurement.evaluation.drift import drift_series
from twin.standards.drift.axis_design import AxisDesign
from twin.standards.drift.record import DriftRecord
from twin.standards.readings import NotPossible
from twin.standards.result import StandardTest, StandardValue

SAME_POSE: Final = 1.0
"""Difference in mm or degrees up to which positions are one pose."""
FEWEST_POSES: Final = 3
RANK_TOLERANCE: Final = 1e-3
"""Singular value, relative to the largest, up to which the positions do not separate the quantities."""
DIRECTIONS: Final = "XYZ"
WORDS: Final = {
    "axial": "shift of the carried side along {axis}",
    "zero": "zero of {axis}",
    "radial": "radial expansion of the side carried by {axis}",
}
REMARKS: Final = (
    "the public scope of ISO 230-3:2020 names this test; positions, figures and signs are choices of twin, as is usual in R-tests of "
    "thermal errors: the standard's text was not read",
    "locations are those at the level of the sphere along the axis",
    "locations and shifts contain drifts of the spindle and the linear axes; the zero contains a tangential shift of the sphere",
)


def rotary_test(record: DriftRecord, rows: np.ndarray, standard: str) -> StandardTest:
    """Evaluate the test of a moving rotary axis.

    Args:
        record: the record, with the design of the axis.
        rows: rows of the test.
        standard: name of the standard.

    Raises:
        NotPossible: no design, a direction that was not read, fewer than three positions, positions that do not separate the
            quantities, or no repeated cycle.
    """
    if record.design is None or any(name not in record.displacement for name in DIRECTIONS):
        raise NotPossible(
            "a rotary axis moves: its test needs a measurement table of a touch probe or an R-test, with X, Y and Z at three or more "
            "positions of the axis"
        )
    design = record.design.select(rows)
    pose = _poses(record, rows)
    if pose.max() + 1 < FEWEST_POSES:
        raise NotPossible(f"{design.axis} was read at {pose.max() + 1} positions: three or more are needed")
    values = np.stack([record.displacement[name][rows] for name in DIRECTIONS], axis=1)
    cycles = _cycles(pose)
    change, factor, residual, dof = _fitted(design, values, pose, cycles)
    kept = np.flatnonzero(np.isfinite(change[:, 0]))
    if len(kept) < 2:
        raise NotPossible(f"the positions of {design.axis} were not repeated, or do not separate its errors")
    from_residuals = float(np.sqrt(residual / (2.0 * dof))) if dof > 0 else np.nan
    u_um = float(np.fmax(record.u_um, from_residuals))
    time = np.array([record.time_s[rows[cycle]].mean() for cycle in cycles])[kept]
    found = drift_series(
        "rotary axis",
        time,
        {name: change[kept, k] for k, name in enumerate(design.names)},
        units=dict(zip(design.names, design.units, strict=True)),
        temperature_degC={
            name: np.array([values[rows[cycle]].mean() for cycle in cycles])[kept]
            for name, values in record.temperature_degC.items()
        },
    )
    return StandardTest(
        kind="moving rotary axis",
        name=design.axis,
        standard=standard,
        axes=(design.axis,),
        place=f"{pose.max() + 1} positions, {len(kept)} cycles of readings, sphere {design.radius_mm:.0f} mm from the axis",
        values=tuple(_values(design, change[kept], np.sqrt(2.0) * u_um * factor)),
        remarks=(*REMARKS, *record.remarks, *_noise_remarks(record, from_residuals, len(cycles) - len(kept))),
        detail=found,
    )


def _poses(record: DriftRecord, rows: np.ndarray) -> np.ndarray:
    """Return the number (n,) of the pose of each row, from 0: the same parts at the same positions."""
    seen: list[tuple[str, np.ndarray]] = []
    found = np.zeros(len(rows), dtype=int)
    for k, row in enumerate(rows):
        spot, at = str(record.spot[row]), record.positions[row]
        same = [n for n, (name, q) in enumerate(seen) if name == spot and np.abs(at - q).max() <= SAME_POSE]
        found[k] = same[0] if same else len(seen)
        if not same:
            seen.append((spot, at))
    return found


def _cycles(pose: np.ndarray) -> list[np.ndarray]:
    """Return the rows of each cycle: one ends where a pose is read again."""
    starts, inside = [0], set[int]()
    for k, number in enumerate(pose.tolist()):
        if number in inside:
            starts.append(k)
            inside = set()
        inside.add(number)
    return np.split(np.arange(len(pose)), starts[1:])


def _fitted(
    design: AxisDesign, values_um: np.ndarray, pose: np.ndarray, cycles: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, float, int]:
    """Return the changes (cycles, 7), their uncertainty per that of a change of one reading (7,), and the residuals.

    The last two results are the sum of squares of the residuals and the degrees of freedom.
    """
    first = np.array([values_um[np.flatnonzero(pose == number)[0]] for number in range(pose.max() + 1)])
    since = values_um - first[pose]
    count = len(design.names)
    change, factors = np.full((len(cycles), count), np.nan), []
    residual, dof = 0.0, 0
    for k, rows in enumerate(cycles):
        read = np.isfinite(since[rows]).reshape(-1)
        matrix, change_um = design.matrix[rows].reshape(-1, count)[read], since[rows].reshape(-1)[read]
        size = np.linalg.norm(matrix, axis=0)
        if len(matrix) < count or not np.all(size > 0.0):
            continue
        singular = np.linalg.svd(matrix / size, compute_uv=False)
        if singular[-1] < RANK_TOLERANCE * singular[0]:
            continue
        inverse = np.linalg.pinv(matrix)
        change[k] = inverse @ change_um
        factors.append(np.linalg.norm(inverse, axis=1))
        if k:
            off = change_um - matrix @ change[k]
            residual, dof = residual + float(off @ off), dof + len(matrix) - count
    return change, np.max(factors, axis=0) if factors else np.full(count, np.nan), residual, dof


def _values(design: AxisDesign, change: np.ndarray, u: np.ndarray) -> Iterator[StandardValue]:
    for k, (name, unit) in enumerate(zip(design.names, design.units, strict=True)):
        what = WORDS[name.partition("_")[0]].format(axis=design.axis) if name[:2] != "E_" else name
        symbol, own, uncertainty = name.replace("_", " ") if name[:2] != "E_" else name, change[:, k], float(u[k])
        yield StandardValue(
            f"Δ({symbol})end",
            f"{name}_end",
            float(own[-1] - own[0]),
            unit,
            f"change of {what} until the end",
            uncertainty,
        )
        yield StandardValue(
            f"Δ({symbol})t", f"{name}_t", float(np.ptp(own)), unit, f"range of {what} over the test", uncertainty
        )


def _noise_remarks(record: DriftRecord, from_residuals: float, incomplete: int) -> Iterator[str]:
    if np.isfinite(from_residuals):
        source = "larger than" if not from_residuals <= record.u_um else "within"
        stated = f"{source} the {record.u_um:.1f} µm stated" if np.isfinite(record.u_um) else "none is stated"
        used = ", and gives U" if source != "within" else ""
        yield f"standard uncertainty of a reading from the residuals: {from_residuals:.2f} µm ({stated}){used}"
    else:
        yield "no degrees of freedom: more positions of the axis would check the rigid motion"
    if incomplete:
        yield f"{incomplete} cycles without enough positions were not used"
