"""A run of one linear axis, read by a multi-axis interferometer: the carriage's real pose, the layout as it really stands, noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from twin._common.arrays import locked
from twin._common.errors import InputError
from twin._common.units import MM
from twin.identification.axis_run.layout import AxisLayout
from twin.identification.axis_run.readings import Readings
from twin.machine.calibration import Calibration
from twin.machine.effects import assemble
from twin.machine.machine import Machine
from twin.numerics.spatial import rotation_exp, rotation_log


def carriage_poses(
    layout: AxisLayout,
    machine: Machine,
    calibration: Calibration,
    positions_mm: np.ndarray,
    *,
    state: Mapping[str, np.ndarray | float] | None = None,
) -> np.ndarray:
    """Where the carriage really is.

    Args:
        layout: whose coordinates they are in.
        machine: the machine.
        calibration: its errors.
        positions_mm: (n,) commanded.
        state: what else the errors depend on: other axes (mm, degrees; the middle of their range if not given), ``approach_X``,
            ``time_s``, ``T_X_degC``; a number each or (n,). At the reference position the first of each holds, and no approach.

    Returns:
        (n, 6) from its pose at the reference position: translation of its origin, metres, and rotation vector, radians.

    Raises:
        InputError: a position no curve covers, or a channel that an effect needs and nobody gave.
    """
    given = dict(state or {})
    q = np.concatenate([[layout.reference_mm], np.asarray(positions_mm, dtype=float)])
    full: dict[str, np.ndarray] = {}
    for axis in machine.axes:
        middle = 0.0 if axis.lower is None or axis.upper is None else (axis.lower + axis.upper) / 2.0
        full[axis.name] = _with_reference(given.pop(axis.name, middle), q)
    full[layout.axis.name] = q
    for name, value in given.items():
        full[name] = _with_reference(value, q)
        if name.startswith("approach_"):
            full[name][0] = 0.0
    calibration.check(np.stack([full[name] for name in machine.names], axis=1))
    frame = next(i for i, f in enumerate(machine.frames) if (f.axis, f.role) == (layout.axis.name, "motion"))
    row = assemble(calibration.effects, machine.frames, full)[frame]
    errors = np.stack([np.broadcast_to(np.asarray(v, dtype=float), len(q)) for v in row], axis=1)
    turned = np.asarray(rotation_exp(errors[:, 3:]))
    # Motion, then error (contract §1), then out to the carriage's point.
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
    time_s: np.ndarray | None = None,
    state: Mapping[str, np.ndarray | float] | None = None,
    installation: np.ndarray | None = None,
    noise: bool = True,
) -> tuple[Readings, np.ndarray]:
    """Readings of a run.

    Args:
        layout: nominal, with its standard uncertainties.
        machine: the machine.
        calibration: its errors.
        positions_mm: (n,) commanded.
        rng: of the noise, and of the installation.
        rounds: (n,) names; one round if None.
        approach: (n,) +1, −1, 0 of that axis; unknown if None.
        time_s: (n,), or None.
        state: as of `carriage_poses`, beside these.
        installation: (p,) how the layout really stands; drawn with its standard uncertainties if None.
        noise: whether the readings err.

    Returns:
        The readings, and the installation.

    Raises:
        InputError: as `carriage_poses`.
    """
    positions = np.atleast_1d(np.asarray(positions_mm, dtype=float))
    n = len(positions)
    channels = dict(state or {})
    if approach is not None:
        channels[f"approach_{layout.axis.name}"] = np.asarray(approach, dtype=float)
    if time_s is not None:
        channels["time_s"] = np.asarray(time_s, dtype=float)
    poses = carriage_poses(layout, machine, calibration, positions, state=channels)
    stands = layout.installation_u * rng.standard_normal(len(layout.installation_u))
    if installation is not None:
        stands = np.array(installation, dtype=float)
    change = layout.beams.readings(poses, stands)
    drawn = layout.noise * rng.standard_normal(change.shape)
    change = change + drawn if noise else change
    readings = Readings(
        source="simulated",
        lines=locked(np.arange(1, n + 1)),
        position_mm=locked(positions),
        change_mm=locked(change / MM / (2.0 if layout.halved else 1.0)),
        round=locked(np.full(n, "1", dtype=object) if rounds is None else np.array(rounds, dtype=object)),
        approach=locked(np.zeros(n) if approach is None else np.array(approach, dtype=float)),
        time_s=locked(np.full(n, np.nan) if time_s is None else np.array(time_s, dtype=float)),
        simulated=True,
    )
    return readings, locked(stands)


def _with_reference(value: np.ndarray | float, q: np.ndarray) -> np.ndarray:
    values = np.atleast_1d(np.asarray(value, dtype=float))
    if len(values) not in (1, len(q) - 1):
        raise InputError("a channel of the wrong length", expected=f"{len(q) - 1} values", value=len(values))
    return np.concatenate([values[:1], np.broadcast_to(values, len(q) - 1)])
