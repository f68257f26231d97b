"""Simulated readings of a multi-axis interferometer on one linear axis: true poses of the carriage, true installation, noise."""

from __future__ import annotations

import numpy as np

from twin._common.arrays import read_only
from twin._common.units import MM
from twin.identification.axis_run.layout import AxisLayout
from twin.identification.axis_run.readings import BeamReadings
from twin.machine.calibration import Calibration
from twin.machine.effects import assemble
from twin.machine.machine import Machine
from twin.numerics.spatial import rotation_exp, rotation_log


def carriage_poses(
    layout: AxisLayout,
    machine: Machine,
    calibration: Calibration,
    positions_mm: np.ndarray,
    approach: np.ndarray | None = None,
) -> np.ndarray:
    """Return the true poses of the carriage; the other axes are in the middle of their ranges.

    Args:
        layout: layout in whose coordinates they are.
        machine: the machine.
        calibration: its errors.
        positions_mm: (n,) commanded.
        approach: (n,) +1, −1, 0 of that axis; unknown if None. The reference position has none.

    Returns:
        (n, 6) relative to the pose at the reference position: translation of its origin, metres, and rotation vector, radians.

    Raises:
        InputError: a position outside the domain of a curve, or a missing channel that an effect needs.
    """
    q = np.concatenate([[layout.reference_mm], np.asarray(positions_mm, dtype=float)])
    full: dict[str, np.ndarray] = {}
    for axis in machine.axes:
        middle = 0.0 if axis.lower is None or axis.upper is None else (axis.lower + axis.upper) / 2.0
        full[axis.name] = np.full(len(q), middle)
    full[layout.axis.name] = q
    if approach is not None:
        full[f"approach_{layout.axis.name}"] = np.concatenate([[0.0], np.asarray(approach, dtype=float)])
    calibration.check(np.stack([full[name] for name in machine.names], axis=1))
    frame = next(i for i, f in enumerate(machine.frames) if (f.axis, f.role) == (layout.axis.name, "motion"))
    row = assemble(calibration.effects, machine.frames, full)[frame]
    errors = np.stack([np.broadcast_to(np.asarray(v, dtype=float), len(q)) for v in row], axis=1)
    turned = np.asarray(rotation_exp(errors[:, 3:]))
    # Motion, then error, then the translation to the carriage's point.
    point = layout.travel(q) + errors[:, :3] + turned @ layout.place
    back = turned[0].T
    return np.concatenate([(point[1:] - point[0]) @ back.T, rotation_log(back @ turned[1:])], axis=1)


def simulate_run(
    layout: AxisLayout,
    machine: Machine,
    calibration: Calibration,
    positions_mm: np.ndarray,
    rng: np.random.Generator,
    *,
    rounds: np.ndarray | None = None,
    approach: np.ndarray | None = None,
    installation: np.ndarray | None = None,
    noise: bool = True,
) -> tuple[BeamReadings, np.ndarray]:
    """Simulate the readings of a run.

    Args:
        layout: nominal, with its standard uncertainties.
        machine: the machine.
        calibration: its errors.
        positions_mm: (n,) commanded.
        rng: random generator for the noise and the installation.
        rounds: (n,) names; one round if None.
        approach: (n,) +1, −1, 0 of that axis; unknown if None.
        installation: (p,) true deviations from the layout; drawn with its standard uncertainties if None.
        noise: whether measurement noise is added.

    Returns:
        The readings, and the installation.

    Raises:
        InputError: as `carriage_poses`.
    """
    positions = np.atleast_1d(np.asarray(positions_mm, dtype=float))
    n = len(positions)
    poses = carriage_poses(layout, machine, calibration, positions, approach)
    true_installation = layout.installation_u * rng.standard_normal(len(layout.installation_u))
    if installation is not None:
        true_installation = np.array(installation, dtype=float)
    change = layout.beams.readings(poses, true_installation)
    noise_draw = layout.noise * rng.standard_normal(change.shape)
    change = change + noise_draw if noise else change
    readings = BeamReadings(
        source="simulated",
        lines=read_only(np.arange(1, n + 1)),
        position_mm=read_only(positions),
        change_mm=read_only(change / MM / (2.0 if layout.halved else 1.0)),
        round=read_only(np.full(n, "1", dtype=object) if rounds is None else np.array(rounds, dtype=object)),
        approach=read_only(np.zeros(n) if approach is None else np.array(approach, dtype=float)),
        time_s=read_only(np.full(n, np.nan)),
        simulated=True,
    )
    return readings, read_only(true_installation)
